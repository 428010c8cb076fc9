//! The plan that `--explain` prints: that it says what the scene is.

use crate::support::random_scene::{Options, RandomScene};
use hydrograd::adjoint::schedule::{Costs, Schedule};
use hydrograd::particles::tag;
use hydrograd::particles::NeighbourList;
use hydrograd::sph::laws::body_force::BodyForce;
use hydrograd::sph::plan::Plan;
use hydrograd::sph::rows::{Quantity, Rows};
use hydrograd::sph::standard::layout::Layout;
use hydrograd::sph::Model;

fn plan_of(scene: &RandomScene) -> Plan {
    Plan::of(&Model::from(scene.model::<f64>()), &scene.state::<f64>(), None).unwrap()
}

fn has(plan: &Plan, what: &str) -> bool {
    plan.dropped.iter().any(|d| d.what.contains(what))
}

fn does(plan: &Plan, operator: &str, what: &str) -> bool {
    let operator = plan.operators.iter().find(|o| o.name == operator).unwrap();
    operator.does.iter().any(|d| d.contains(what))
}

/// Every combination of what a scene can have: fields are there exactly where the layout has rows, and what is not is
/// among what was dropped.
#[test]
fn fields_and_what_was_dropped_are_those_of_the_scene() {
    for bits in 0..32 {
        let on = |k: usize| bits >> k & 1 == 1;
        let dimension = if on(0) { 3 } else { 2 };
        let options = Options {
            walls: on(1),
            periodic: [true, !on(1), true],
            transport: on(2),
            heat: on(3),
            mass: on(4),
            ..Options::plain(dimension)
        };
        let scene = RandomScene::new(options);
        let (plan, layout) = (plan_of(&scene), options.layout());
        let rows = |name: &str| plan.fields.iter().find(|f| f.name == name).unwrap();
        for (name, count) in [
            ("state", layout.state_rows()),
            ("moved", layout.moved_rows()),
            ("density", 1),
            ("primitives", layout.primitive_rows()),
            ("rates", layout.rate_rows()),
        ] {
            assert_eq!(rows(name).rows.len(), count, "{name} of {options:?}");
            assert_eq!(rows(name).bytes, count * scene.particles() * 8);
        }
        // Names stand where the layout has the rows.
        let state = &rows("state").rows;
        assert_eq!(state[layout.velocity()], "velocity x");
        assert_eq!(state[layout.acceleration()], "acceleration x");
        if options.heat {
            assert_eq!(state[layout.temperature()], "temperature");
            assert_eq!(rows("moved").rows[layout.moved_temperature()], "temperature");
            assert_eq!(rows("primitives").rows[layout.primitive_temperature()], "temperature");
            assert_eq!(rows("rates").rows[layout.rate_temperature()], "temperature rate");
        }
        if options.mass {
            assert_eq!(state[layout.state_mass()], "mass");
        }
        assert_eq!(has(&plan, "temperature"), !options.heat);
        assert_eq!(has(&plan, "transport velocity"), !options.transport);
        assert_eq!(has(&plan, "a mass of each particle"), !options.mass);
        assert_eq!(has(&plan, "walls' extrapolation"), !options.walls);
        assert_eq!(does(&plan, "rates", "conduction"), options.heat);
        assert_eq!(does(&plan, "rates", "transport"), options.transport);
        assert_eq!(does(&plan, "wall condition", "walls"), options.walls);
        let (dry, text) = (plan.particles, plan.to_string());
        assert_eq!(dry.fluid + dry.walls + dry.walls_without_row, dry.total);
        assert_eq!(dry.fluid, scene.tags.iter().filter(|&&t| t == tag::FLUID).count());
        for part in plan.dropped.iter().flat_map(|d| [&d.what, &d.why]) {
            assert!(text.contains(part.as_str()), "{part}");
        }
    }
}

#[test]
fn pairs_and_dead_walls_are_counted() {
    let scene = RandomScene::new(Options::rich(2));
    let (model, state) = (scene.model::<f64>(), scene.state::<f64>());
    let plan = plan_of(&scene);
    // By distance, of all pairs in which one is fluid.
    let n = scene.particles();
    let near = |i: usize, j: usize| {
        let square = |d: usize| {
            let mut r = state[d * n + i] - state[d * n + j];
            if model.domain.periodic[d] {
                r -= model.domain.size[d] * (r / model.domain.size[d]).round();
            }
            r * r
        };
        i != j && (0..2).map(square).sum::<f64>() < model.reach().distance().powi(2)
    };
    let fluid = |i: usize| scene.tags[i] == tag::FLUID;
    let reached: Vec<usize> =
        (0..n).map(|i| (0..n).filter(|&j| (fluid(i) || fluid(j)) && near(i, j)).count()).collect();
    assert_eq!(plan.list.directed_pairs, reached.iter().sum::<usize>());
    let dead = (0..n).filter(|&i| !fluid(i) && reached[i] == 0).count();
    assert!(dead > 0, "the scene should have walls that no fluid reaches");
    assert_eq!(plan.particles.walls_without_row, dead);
    assert!(has(&plan, &format!("rows of {dead} wall particles")));
    let list = NeighbourList::build(&state[..2 * n], &scene.tags, &model.domain, model.reach().distance(), 0).unwrap();
    assert_eq!((plan.list.bytes, plan.list.capacity), (list.bytes(), list.capacity));
    let pairs: usize = plan.operators.iter().filter(|o| o.name != "rates").map(|o| o.pairs).sum();
    assert_eq!(pairs, plan.list.directed_pairs);
}

#[test]
fn time_step_numbers_follow_from_the_model() {
    let scene = RandomScene::new(Options::rich(3));
    let (model, plan) = (scene.model::<f64>(), plan_of(&scene));
    // The scene is made with the sound speed 5, viscosity 0.3, conductivity 7.313, capacity 30.527, density 1.2.
    assert!((model.sound_speed() - 5.0).abs() < 1e-12);
    assert!((plan.time_step.acoustic_number - 1e-3 * 5.5 / 0.05).abs() < 1e-12);
    assert!((plan.time_step.diffusion_number - 1e-3 * 0.25 / 0.05f64.powi(2)).abs() < 1e-12);
}

#[test]
fn a_scene_without_body_force_says_so() {
    let mut scene = RandomScene::new(Options::plain(2));
    assert!(!has(&plan_of(&scene), "body force") && does(&plan_of(&scene), "rates", "body force"));
    scene.body_force = BodyForce::None;
    assert!(has(&plan_of(&scene), "body force") && !does(&plan_of(&scene), "rates", "body force"));
}

#[test]
fn the_part_of_the_gradient_is_that_of_its_schedule() {
    let scene = RandomScene::new(Options::rich(2));
    let costs = Costs { state: 100, tape_step: 700, working: 5000, ..Costs::default() };
    let schedule = Schedule::binomial(40, 10, 4);
    let model = Model::from(scene.model::<f64>());
    let plan = plan_of(&scene).with_gradient(&model, &schedule, costs, Some(9999));
    let gradient = plan.gradient.as_ref().unwrap();
    assert_eq!(gradient.counts, schedule.counts());
    assert_eq!((gradient.storage_bytes, gradient.memory_bytes), (4 * 100 + 700, 4 * 100 + 700 + 5000));
    assert!(gradient.dropped.iter().any(|d| d.what == "steps 0 ... 9"));
    let json = serde_json::to_value(&plan).unwrap();
    assert_eq!(json["gradient"]["recomputed_steps"], schedule.counts().recomputed_steps);
    assert_eq!(json["particles"]["total"], scene.particles());
    assert!(plan.to_string().contains("binomial"));
}

#[test]
fn rows_of_a_state_follow_each_other() {
    let rows = Rows::new(3, &[Quantity::Pressure, Quantity::Temperature, Quantity::Acceleration]);
    assert_eq!((rows.count(), rows.velocity()), (11, 3));
    assert_eq!((rows.row(Quantity::Pressure), rows.temperature()), (Some(6), Some(7)));
    assert_eq!((rows.row(Quantity::Acceleration), rows.row(Quantity::Mass)), (Some(8), None));
    assert_eq!((rows.quantity(10), rows.quantity(11)), (Some(Quantity::Acceleration), None));
    assert_eq!(rows.names()[5..9], ["velocity z", "pressure", "temperature", "acceleration x"]);
}

#[test]
fn the_rows_of_a_state_are_those_of_the_layout() {
    for bits in 0..32u8 {
        let has = |bit: u8| bits >> bit & 1 == 1;
        let dimension = if has(4) { 3 } else { 2 };
        let l = Layout { dimension, transport: has(0), heat: has(1), mass: has(2), density: has(3) };
        let rows = l.rows();
        assert_eq!((rows.count(), rows.velocity()), (l.state_rows(), l.velocity()));
        assert_eq!(rows.temperature(), l.heat.then(|| l.temperature()));
        assert_eq!(rows.row(Quantity::Mass), l.mass.then(|| l.state_mass()));
        assert_eq!(rows.row(Quantity::Density), l.density.then(|| l.state_density()));
    }
}
