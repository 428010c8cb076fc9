//! Warnings about figures that cannot be trusted.

use hydrograd::config::layers::Setting;
use hydrograd::config::method::Method;
use hydrograd::config::scene::{Config, Family};
use hydrograd::config::suggest::assignments;
use hydrograd::design::diagnostics::simulate;
use hydrograd::design::diagnostics::{drift, unsettled, Diagnostics};
use hydrograd::design::optimise::{Epoch, Optimisation};
use hydrograd::design::optimisers::of_config;
use hydrograd::error::Error;
use hydrograd::particles::tag;
use hydrograd::scene::figures::FlowFigures;
use hydrograd::scene::load::Loaded;
use hydrograd::scene::particle_fields::ParticleFields;
use hydrograd::scene::plausible::Findings;
use hydrograd::scene::warnings::{of_flow, of_measured, of_particles, of_search};
use hydrograd::scene::Scene;

fn quiet(config: &Config) -> Diagnostics {
    Diagnostics {
        q: 0.0235,
        wall_heat_flux: 0.0235,
        mean_density: config.fluid.density,
        u_max: config.fluid.reference_velocity,
        ..Diagnostics::default()
    }
}

#[test]
fn a_run_that_can_be_trusted_gets_no_warning() {
    let config = Config::default();
    assert_eq!(of_measured(&config, &quiet(&config)), []);
}

/// A row of fluid particles at these positions.
fn row(places: Vec<f64>) -> ParticleFields {
    let n = places.len();
    let zeros = vec![0.0; 2 * n];
    ParticleFields {
        dimension: 2,
        box_size: vec![1.0; 2],
        position: [places, vec![0.0; n]].concat(),
        velocity: zeros.clone(),
        temperature: None,
        density: zeros[..n].to_vec(),
        pressure: zeros[..n].to_vec(),
        mass: zeros[..n].to_vec(),
        tag: vec![tag::FLUID; n],
        time: 0.0,
        step: 0,
    }
}

/// What is in force already, what the scene refuses, and longer steps are not suggested.
#[test]
fn advice_is_what_is_left_to_do() {
    let load = |scene: &str, sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
        Config::load(Some(scene), None, &sets).unwrap()
    };
    let diverged = |loaded: &Loaded, advice: &str| match loaded.advised(Error::diverged("it diverged", advice)) {
        Error::Diverged { advice, .. } => advice,
        other => panic!("{other}"),
    };
    let advice = "resolution.smoothing_length=0.9 (more neighbours), a smaller time.jitter, or time.cfl=0.5";
    assert_eq!(diverged(&load("taylor-green", &[]), advice), advice);
    let at_most = load("taylor-green", &["resolution.smoothing_length=0.9"]);
    assert_eq!(diverged(&at_most, advice), "a smaller time.jitter, or time.cfl=0.5");
    // Neither longer steps nor those that another limit rules.
    let small = load("taylor-green", &["time.cfl=0.2", "resolution.smoothing_length=0.9"]);
    let found = diverged(&small, advice);
    let half = found.strip_suffix(", or a smaller time.jitter").unwrap();
    let after = small.with(&[Setting::set(half)]).unwrap().config;
    assert!((after.time_step() / small.config.time_step() - 0.5).abs() < 0.01, "{half}");
    // Keys of another scene.
    assert_eq!(at_most.possible("design.bound=0.01, or a flat wall"), "a flat wall");
    // The default start of the heated channel.
    let channel = load("heated-channel", &[]);
    let found = of_measured(&channel.config, &Diagnostics { q_drift: Some(0.2), ..quiet(&channel.config) });
    let [drifts] = &found[..] else { panic!("{found:?}") };
    assert!(drifts.advice.contains("time.start=developed"));
    assert!(
        channel.possible(&drifts.advice).starts_with("time.end=")
            && !channel.possible(&drifts.advice).contains("start")
    );
}

/// What looks implausible in a scene comes with spacings that divide it.
#[test]
fn spacings_that_are_suggested_divide_the_box() {
    let sets = |more: &[&str]| more.iter().map(|set| set.to_string()).collect::<Vec<String>>();
    let disc = r#"shapes=[{ kind = "disc", centre = [0.5, 0.25], radius = 0.2 }]"#;
    let mut taken = 0;
    for given in [
        &["initial.temperature=1.0", "fluid.conductivity=1e-3"][..],
        &["fluid.viscosity=1e-3", "time.end=50"],
        &[disc],
        &[disc, "region.size=[1.1, 0.5]", "resolution.dx=0.05"],
    ] {
        let config = Config::load(Some("custom"), None, &sets(given)).unwrap().config;
        let scene = Scene::<f64>::from_config(&config).unwrap();
        for warning in Findings::of(&config, &scene).unwrap().warnings {
            for one in assignments(&warning.advice).into_iter().filter(|one| one.starts_with("resolution.dx")) {
                let after = Config::load(Some("custom"), None, &sets(&[given, &[one]].concat()));
                assert!(after.unwrap().config.resolution.dx < config.resolution.dx, "{given:?}: {warning:?}");
                taken += 1;
            }
        }
    }
    assert!(taken >= 4, "{taken}");
}

#[test]
fn crowds_and_lattices_are_told() {
    let mut config = Config::default();
    let dx = config.resolution.dx;
    let even: Vec<f64> = (0..100).map(|k| k as f64 * dx).collect();
    assert_eq!(of_particles(&config, &row(even.clone())), []);
    let mut crowd = even;
    (0..3).for_each(|k| crowd[10 * k + 1] = crowd[10 * k] + 0.4 * dx);
    let found = of_particles(&config, &row(crowd));
    assert!(found.len() == 1 && found[0].problem.starts_with("6 % of the particles"), "{found:?}");
    config = Family::TaylorGreen.defaults();
    config.method = Method::named("standard").unwrap();
    config.time.jitter = 0.0;
    let found = of_particles(&config, &row(vec![0.0]));
    assert!(found.len() == 1 && found[0].problem.contains("exact lattice"), "{found:?}");
}

#[test]
fn a_search_in_vain_is_told() {
    let epoch = |loss: f64, gradient_norm: f64| Epoch { loss, gradient_norm, figure: -loss, ..Epoch::default() };
    let search = |history: Vec<Epoch>, best: usize| {
        let optimiser = of_config(&Config::default().optimise, &[0.0]);
        of_search(&Optimisation { history, best, ..Optimisation::new(optimiser) }, 0.04)
    };
    assert_eq!(search(vec![epoch(-0.0234, 0.016), epoch(-0.0237, 0.014)], 1), []);
    let found = search(vec![epoch(-0.0234, 0.016), epoch(-0.0233, 0.014)], 0);
    assert!(found.len() == 1 && found[0].problem.contains("in 2 epochs nothing"), "{found:?}");
    let found = search(vec![epoch(-0.0234, 0.016), epoch(-0.0237, 1e6)], 1);
    assert!(found.len() == 1 && found[0].problem.contains("gradient of epoch 2"), "{found:?}");
    let found = search(vec![epoch(0.0234, 0.016), epoch(0.0231, 0.014)], 1);
    assert!(found.len() == 1 && found[0].code == "negative-objective", "{found:?}");
}

#[test]
fn each_doubt_has_its_warning() {
    let config = Config::default();
    let (reference, sound) = (config.fluid.reference_velocity, config.sound_speed());
    let of = |change: &dyn Fn(&mut Diagnostics)| {
        let mut found = quiet(&config);
        change(&mut found);
        of_measured(&config, &found)
    };
    for (found, part) in [
        (of(&|found| found.u_max = 2.0 * reference), "2.0 times as fast as fluid.reference_velocity"),
        (of(&|found| found.u_max = 0.4 * sound), "Mach 0.40"),
        (of(&|found| found.mean_density *= 1.19), "+19.0 %"),
        (of(&|found| found.energy_imbalance = 3.55), "+355 % open"),
    ] {
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].problem.contains(part) && !found[0].advice.is_empty(), "{found:?}");
    }
    let unsteady = of(&|found| found.q_drift = Some(-0.02));
    assert!(unsteady.len() == 1 && unsteady[0].problem.contains("outflowing heat changes by -2.0 %"), "{unsteady:?}");
    assert_eq!(
        (unsteady[0].code.as_str(), unsteady[0].value, unsteady[0].limit),
        ("not-steady", Some(-0.02), Some(0.01))
    );
}

#[test]
fn a_drift_is_a_change_of_means() {
    let series = |of: &dyn Fn(f64) -> f64| drift(&(0..100).map(|k| of(k as f64 / 100.0)).collect::<Vec<_>>());
    // A value that falls by 4 %, and one that oscillates about a mean.
    assert!((series(&|t| 0.0235 * (1.0 - 0.04 * t)).unwrap() + 0.02 / 0.98).abs() < 1e-3);
    assert!(series(&|t| 0.0235 * (1.0 + 0.02 * (400.0 * t).sin())).unwrap().abs() < 1e-3);
    assert_eq!((drift(&[1.0, 2.0]), drift(&[0.0; 8])), (None, None));
}

#[test]
fn what_is_left_to_a_steady_value_is_seen_in_its_last_changes() {
    let series = |of: &dyn Fn(f64) -> f64| (0..100).map(|k| of(k as f64 / 100.0)).collect::<Vec<_>>();
    // It is as far as an exponential still goes, but no less than the change of the halves; of what has only begun to change it is a large part.
    for rate in [0.7, 1.5, 2.1] {
        let values = series(&|t| 3.0 - 0.2 * (-rate * t).exp());
        let left = 3.0 - values.iter().sum::<f64>() / 100.0;
        assert!(
            (0.9999..1.03).contains(&(unsettled(&values).unwrap() / left)),
            "{rate} {left} {:?}",
            unsettled(&values)
        );
    }
    let fast = series(&|t| 3.0 - 0.2 * (-6.0 * t).exp());
    let change = fast[50..].iter().sum::<f64>() / 50.0 - fast[..50].iter().sum::<f64>() / 50.0;
    assert!((unsettled(&fast).unwrap() / change - 1.0).abs() < 1e-9);
    let begun = series(&|t| (2.0 * t).exp());
    let change = begun[50..].iter().sum::<f64>() / 50.0 - begun[..50].iter().sum::<f64>() / 50.0;
    assert!((unsettled(&begun).unwrap() / change - 9.5).abs() < 1e-9);
    // Noise, and what swings, does not go anywhere: the halves' difference is all.
    let noise = series(&|t| 1.0 + 0.1 * (1e4 * t).sin());
    let change = noise[50..].iter().sum::<f64>() / 50.0 - noise[..50].iter().sum::<f64>() / 50.0;
    assert!((unsettled(&noise).unwrap() - change.abs()).abs() < 1e-15);
    assert_eq!((unsettled(&[1.0; 7]), unsettled(&[2.0; 8])), (None, Some(0.0)));
}

/// The codes of what looks implausible in a scene.
fn codes(scene: &str, sets: &[&str]) -> Vec<String> {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    let config = Config::load(Some(scene), None, &sets).unwrap_or_else(|error| panic!("{error}")).config;
    let found = Findings::of(&config, &Scene::<f64>::from_config(&config).unwrap()).unwrap();
    found.warnings.into_iter().map(|warning| warning.code).collect()
}

#[test]
fn what_a_scene_does_not_resolve_is_known_before_it_runs() {
    let sine = ["design.shape=sine", "design.amplitude=0.02", "design.periods=5"];
    assert_eq!(codes("heated-channel", &[]), [] as [&str; 0]);
    assert_eq!(codes("heated-channel", &sine), ["wall-curvature"]);
    assert_eq!(codes("heated-channel", &[&sine[..], &["method.name=fixed"]].concat()), [] as [&str; 0]);
    assert_eq!(codes("heated-channel", &["fluid.conductivity=0.07313"]), ["cell-peclet-number"]);
    let disc = [
        r#"shapes=[{ kind = "disc", centre = [0.5, 0.25], radius = 0.05 }]"#,
        r#"variables=[{ number = "shapes[0].radius", lower = 0.04, upper = 0.06 }]"#,
    ];
    assert!(!codes("custom", &disc).contains(&"no-through-flow".to_string()));
    let closed = [&disc[..], &["region.periodic=[false, false]", "region.acceleration=[0.0, 0.0]"]].concat();
    assert!(codes("custom", &closed).contains(&"no-through-flow".to_string()));
}

#[test]
fn figures_far_from_exact_ones_are_told() {
    let found = |energy: f64| FlowFigures {
        time: 1.0,
        kinetic_energy: energy,
        exact_kinetic_energy: Some(1.0),
        largest_velocity: 0.5,
        velocity_error: Some(0.001),
        temperature_error: None,
        wall_flux: None,
        exact_wall_flux: None,
        nusselt: None,
        exact_nusselt: None,
    };
    let config = Family::Couette.defaults();
    assert_eq!(of_flow(&config, &found(1.004), &[]), []);
    let told = of_flow(&config, &found(1.12), &[]);
    assert!(told.len() == 1 && told[0].code == "exact-solution" && told[0].problem.contains("12.0 %"), "{told:?}");
    // A slab's flux at a wall whose exact one is nothing is not compared, the other one is.
    let slab = FlowFigures { wall_flux: Some([33.1, 0.0]), exact_wall_flux: Some([56.4, 0.0]), ..found(1.0) };
    let told = of_flow(&Family::Slab.defaults(), &slab, &[]);
    assert!(told.len() == 1 && told[0].problem.contains("at the lower wall is -41.3 %"), "{told:?}");
}

/// A sawtooth over which particles with the usual smoothing length diverge within 64 steps.
#[test]
fn moving_particles_see_further_over_rough_walls() {
    let wall = |height: f64| {
        let offsets: Vec<f64> = (0..25).map(|k| if k % 2 == 0 { height } else { -height }).collect();
        let nodes: Vec<f64> = (0..25).map(|k| 0.26 + 0.02 * k as f64).collect();
        [
            format!("design.offsets={offsets:?}"),
            format!("design.nodes={nodes:?}"),
            "design.bound=0.02".to_string(),
            "channel.wall_rows=3".to_string(),
        ]
    };
    let load = |height: f64, more: &[&str]| {
        let sets: Vec<String> = wall(height).into_iter().chain(more.iter().map(|set| set.to_string())).collect();
        Config::load(Some("heated-channel"), None, &sets).unwrap().config
    };
    let length = |config: &Config| config.resolution.smoothing_length;
    assert_eq!(length(&load(0.005, &[])), 0.8);
    assert_eq!(length(&load(0.02, &[])), 1.1);
    assert_eq!(length(&load(0.02, &["resolution.smoothing_length=0.9"])), 0.9);
    assert_eq!(length(&load(0.02, &["method.name=fixed"])), 0.8);
    let config = load(0.02, &["time.end=0.3", "objective.window=0.1"]);
    let codes = |config: &Config| of_measured(config, &quiet(config)).into_iter().map(|it| it.code).collect::<Vec<_>>();
    assert_eq!(codes(&config), ["rough-wall"]);
    assert!(codes(&load(0.005, &[])).is_empty());
    let scene = Scene::<f64>::from_config(&config).unwrap();
    let design = scene.design.as_ref().unwrap();
    let found = simulate(design, config.run.compute().unwrap(), &scene.start, &mut []).unwrap();
    assert!(found.diagnostics.u_max < 2.0, "{:?}", found.diagnostics);
}
