//! Slopes of third order by deferred correction: what is added, its adjoint, and finite elements beside flows with and without it.

use crate::cloud::{channel, loaded, shape, SIDES};
use crate::support::noise::noise;
use hydrograd::config::scene::Config;
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::sph::cloud::deferred_correction::ThirdOrder;
use hydrograd::sph::cloud::equations::{Equations, State};
use hydrograd::sph::cloud::figures::Figure;
use hydrograd::sph::cloud::particles::{Cloud, Shaped};
use hydrograd::sph::cloud::smoothing::Smoothing;

/// A scene's text with the correction.
pub(crate) fn corrected(text: &str) -> String {
    format!("method.deferred_correction = true\n{text}")
}

/// The scene with all kinds of sides, its reference cloud and equations.
fn sides() -> (AroundShapes, Shaped, Equations) {
    let around = AroundShapes::new(&loaded(&corrected(SIDES))).unwrap();
    let cloud = &around.flow.cloud;
    let shaped = cloud.shaped(&cloud.numbers()).unwrap();
    let equations = cloud.equations(&shaped);
    (around, shaped, equations)
}

fn third_order<'a>(cloud: &'a Cloud, equations: &'a Equations, shaped: &'a Shaped) -> ThirdOrder<'a> {
    ThirdOrder { equations, stencils: cloud.third.as_ref().unwrap(), operators: shaped.third.as_ref().unwrap() }
}

/// What is added to the equations of a flow whose fields are cubic makes advection, pressure and continuity exact.
#[test]
fn slopes_of_cubic_flows_become_exact() {
    let (around, shaped, equations) = sides();
    let cloud = &around.flow.cloud;
    let [x, y] = &shaped.position;
    let cubic = |a: f64, b: f64, c: f64| -> (Vec<f64>, Vec<[f64; 2]>) {
        let at = |x: f64, y: f64| {
            (a * x * x * x + b * x * y * y + c * x * x, [3.0 * a * x * x + b * y * y + 2.0 * c * x, 2.0 * b * x * y])
        };
        x.iter().zip(y).map(|(x, y)| at(*x, *y)).unzip()
    };
    let fields = [cubic(1.0, -2.0, 0.5), cubic(0.3, 1.5, -1.0), cubic(-0.7, 0.4, 0.2), cubic(0.9, -0.6, 1.1)];
    let mut state = State::at_rest(cloud.particles());
    state.fields = fields.clone().map(|(value, _)| value);
    let d = equations.derivatives(&shaped.operators, &state, true);
    let third = third_order(cloud, &equations, &shaped);
    let defect = third.defect(&state, &d);
    let lacks = |f: usize, i: usize, e: usize| fields[f].1[i][e] - d.0[f][i][e];
    let mut largest = 0.0f64;
    for i in 0..cloud.particles() {
        let continuity = lacks(0, i, 0) + lacks(1, i, 1);
        largest = largest.max(continuity.abs());
        assert!((defect.flow[3 * i + 2] - continuity).abs() < 1e-9, "continuity of particle {i}");
        if i >= equations.inside {
            continue;
        }
        let along = |f: usize| state.fields[0][i] * lacks(f, i, 0) + state.fields[1][i] * lacks(f, i, 1);
        for e in 0..2 {
            let momentum = along(e) + lacks(2, i, e);
            assert!((defect.flow[3 * i + e] - momentum).abs() < 1e-9, "momentum {e} of particle {i}");
        }
        assert!((defect.heat[i] - along(3)).abs() < 1e-9, "heat of particle {i}");
    }
    // There is something to add.
    assert!(largest > 1e-3, "{largest}");
}

/// In time the same is added, smoothed, but for the rows of walls.
#[test]
fn what_is_added_in_time_is_the_same_smoothed() {
    let (around, shaped, equations) = sides();
    let cloud = &around.flow.cloud;
    let (n, inside) = (cloud.particles(), equations.inside);
    let mut draw = noise(5);
    let mut state = State::at_rest(n);
    state.fields.iter_mut().flatten().for_each(|x| *x = draw());
    let d = equations.derivatives(&shaped.operators, &state, true);
    let own = third_order(cloud, &equations, &shaped).defect(&state, &d);
    let found = cloud.lagged(&shaped).unwrap().defect((&equations, &shaped.operators), &state);
    let of = |count: usize, row: &dyn Fn(usize) -> f64| {
        let smoothing = Smoothing::new(&cloud.fits.all, count);
        let mut rows: Vec<_> = (0..count).map(|i| [row(i)]).collect();
        smoothing.apply(&mut rows);
        rows.resize(n, [0.0]);
        rows
    };
    let close = |name: &str, found: &dyn Fn(usize) -> f64, expected: &[[f64; 1]]| {
        let size = expected.iter().map(|[x]| x.abs()).fold(0.0, f64::max);
        assert!(size > 1.0, "{name}: there is something to add");
        for (i, [expected]) in expected.iter().enumerate() {
            assert!((found(i) - expected).abs() < 1e-11 * size, "{name} of {i}: {} and {expected}", found(i));
        }
    };
    for e in 0..2 {
        close("momentum", &|i| found.flow[3 * i + e], &of(inside, &|i| own.flow[3 * i + e]));
    }
    close("continuity", &|i| found.flow[3 * i + 2], &of(n, &|i| own.flow[3 * i + 2]));
    close("heat", &|i| found.heat[i], &of(inside, &|i| own.heat[i]));
}

/// Means keep what is uniform, leave little of what changes from particle to particle, and have an exact transpose.
#[test]
fn means_keep_what_is_uniform_and_take_a_checkerboard_away() {
    let text = format!("{}{}", channel(0.05, ""), shape("disc", &[0.5, 0.2, 0.07]));
    let around = AroundShapes::new(&loaded(&text)).unwrap();
    let cloud = &around.flow.cloud;
    let inside = cloud.places.inside;
    let smoothing = Smoothing::new(&cloud.fits.all, inside);
    let mut uniform = vec![[1.5, -2.0]; inside];
    smoothing.apply(&mut uniform);
    assert!(uniform.iter().all(|row| (row[0] - 1.5).abs() < 1e-14 && (row[1] + 2.0).abs() < 1e-14));
    let mut draw = noise(3);
    let mut rows = || -> Vec<[f64; 1]> { (0..inside).map(|_| [draw()]).collect() };
    let (a, b) = (rows(), rows());
    let (mut smooth, mut back) = (a.clone(), b.clone());
    smoothing.apply(&mut smooth);
    smoothing.transposed(&mut back);
    let dot = |a: &[[f64; 1]], b: &[[f64; 1]]| a.iter().zip(b).map(|(a, b)| a[0] * b[0]).sum::<f64>();
    let (forward, backward) = (dot(&smooth, &b), dot(&a, &back));
    assert!((forward - backward).abs() < 1e-12 * dot(&a, &a), "{forward} and {backward}");
    // In a periodic box, away from the disc: 0.9 % of it where the lattice is square, more where its spacing changes.
    let text = "scene = \"custom\"\nregion.size = [1.0, 1.0]\nregion.periodic = [true, true]\nregion.acceleration = [1.0, 0.0]\n\
        fluid.viscosity = 0.1\nfluid.conductivity = 0.1\nfluid.inlet_temperature = 0.0\ninitial.temperature = 0.0\nresolution.dx = 0.05\n\
        method.name = \"fixed\"\n"
        .to_string()
        + &shape("disc", &[0.5, 0.5, 0.1]);
    let around = AroundShapes::new(&loaded(&text)).unwrap();
    let cloud = &around.flow.cloud;
    let places = &cloud.places.place;
    let sign = |i: usize| match places[i].map(|x| (x / 0.05 + 0.25).floor() as i64).iter().sum::<i64>() % 2 {
        0 => [1.0],
        _ => [-1.0],
    };
    let mut checkerboard: Vec<_> = (0..cloud.places.inside).map(sign).collect();
    Smoothing::new(&cloud.fits.all, cloud.places.inside).apply(&mut checkerboard);
    let far = |i: &usize| (places[*i][0] - 0.5).hypot(places[*i][1] - 0.5) > 0.35;
    let left: Vec<f64> = (0..cloud.places.inside).filter(far).map(|i| checkerboard[i][0].abs()).collect();
    let most = left.iter().copied().fold(0.0, f64::max);
    println!("{most} of a checkerboard at {} particles", left.len());
    assert!(left.len() > 100 && most < 0.1, "{most}");
}

#[test]
fn the_adjoint_of_what_is_added_is_that_of_differences() {
    let (around, shaped, equations) = sides();
    let cloud = &around.flow.cloud;
    let n = cloud.particles();
    let mut draw = noise(9);
    let mut state = State::at_rest(n);
    state.fields.iter_mut().flatten().for_each(|x| *x = draw());
    let mut drawn = |count: usize| -> Vec<f64> { (0..count).map(|_| draw()).collect() };
    let (flow, heat) = (drawn(3 * n), drawn(n));
    let to_state: [Vec<f64>; 4] = std::array::from_fn(|_| drawn(n));
    let to_position: [Vec<f64>; 2] = std::array::from_fn(|_| drawn(n));
    let value = |equations: &Equations, state: &State, position: &[Vec<f64>; 2]| -> f64 {
        let d = equations.derivatives(&cloud.fits.coefficients(position), state, true);
        let stencils = cloud.third.as_ref().unwrap();
        let operators = &stencils.coefficients(position);
        let defect = ThirdOrder { equations, stencils, operators }.defect(state, &d);
        let sum = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        sum(&flow, &defect.flow) + sum(&heat, &defect.heat)
    };
    let d = equations.derivatives(&shaped.operators, &state, true);
    let third = third_order(cloud, &equations, &shaped);
    let bar = third.pull_back(&shaped.position, (&state, &d), &flow, Some(&heat));
    let along =
        |a: &[Vec<f64>], b: &[Vec<f64>]| a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum::<f64>();
    let close = |name: &str, exact: f64, step: f64, at: &dyn Fn(f64) -> f64| {
        let central = |step: f64| (at(step) - at(-step)) / (2.0 * step);
        let difference = (4.0 * central(step) - central(2.0 * step)) / 3.0;
        assert!((difference / exact - 1.0).abs() < 1e-7, "{name}: {exact} and {difference}");
    };
    let plus = |from: &[Vec<f64>], step: f64, way: &[Vec<f64>]| -> Vec<Vec<f64>> {
        let sum = |from: &Vec<f64>, way: &Vec<f64>| from.iter().zip(way).map(|(x, w)| x + step * w).collect();
        from.iter().zip(way).map(|(from, way)| sum(from, way)).collect()
    };
    let by_fields = along(&equations.by_fields(&shaped.operators, &bar), &to_state);
    close("fields", by_fields, 1e-3, &|step| {
        let fields = plus(&state.fields, step, &to_state).try_into().unwrap();
        value(&equations, &State { fields, ..state.clone() }, &shaped.position)
    });
    let by_positions = along(&equations.by_positions(&shaped.position, &state, &bar), &to_position);
    close("positions", by_positions, 1e-5, &|step| {
        value(&equations, &state, &plus(&shaped.position, step, &to_position).try_into().unwrap())
    });
    close("viscosity", bar.viscosity, 1e-4, &|step| {
        value(&Equations { viscosity: equations.viscosity + step, ..equations.clone() }, &state, &shaped.position)
    });
}

/// Drag and difference of pressures of a cylinder between walls at a Reynolds number of 20 (Schaefer and Turek 1996; to more digits: Nabh 1998),
/// with 12 spacings across it: 0.5 and 1.2 % off without a correction.
#[test]
fn corrected_flows_are_closer_to_finite_elements() {
    let off = |is_corrected: bool| {
        let sets = ["resolution.dx=0.0082".to_string(), format!("method.deferred_correction={is_corrected}")];
        let config = Config::load(Some("schaefer-turek-1"), None, &sets).unwrap().config;
        let mut around = AroundShapes::new(&config).unwrap();
        let solution = around.solve(&[]).unwrap();
        let drag = around.value(&solution, Figure::Force { shape: 0, along: 0 }) / (0.5 * 0.2 * 0.2 * 0.1);
        [drag / 5.579_535_233_84 - 1.0, around.objective(&solution).0 / 0.117_520_166_97 - 1.0].map(f64::abs)
    };
    let (plain, corrected) = (off(false), off(true));
    println!("{plain:?}, corrected {corrected:?}");
    assert!(corrected[0] < 0.2 * plain[0] && corrected[0] < 1e-3, "{corrected:?} and {plain:?}");
    assert!(corrected[1] < 0.6 * plain[1], "{corrected:?} and {plain:?}");
}

/// The drag of a flow in time that has become steady.
#[test]
fn corrected_flows_in_time_settle_closer_to_finite_elements() {
    let off = |is_corrected: bool| {
        let sets = [
            "resolution.dx=0.0082",
            "method.flow=unsteady",
            "time.end=4",
            "objective.window=0.5",
            &format!("method.deferred_correction={is_corrected}"),
        ]
        .map(str::to_string);
        let config = Config::load(Some("schaefer-turek-1"), None, &sets).unwrap().config;
        let around = AroundShapes::new(&config).unwrap();
        let (_, solution) = around.march(&[], None, &mut |_, _| Ok(())).unwrap();
        let drag = around.value(&solution, Figure::Force { shape: 0, along: 0 }) / (0.5 * 0.2 * 0.2 * 0.1);
        drag / 5.579_535_233_84 - 1.0
    };
    let (plain, corrected) = (off(false), off(true));
    println!("{plain:?}, corrected {corrected:?}");
    assert!(corrected.abs() < 0.3 * plain.abs(), "{corrected} and {plain}");
}

#[test]
fn flows_that_cannot_be_corrected_are_refused_by_name() {
    for (scene, set) in
        [("schaefer-turek-2", "method.pressure=weakly-compressible"), ("sphere-array", "resolution.dx=0.1")]
    {
        let sets = [set.to_string(), "method.deferred_correction=true".to_string()];
        let error = Config::load(Some(scene), None, &sets).err().unwrap().to_string();
        assert!(
            error.contains("method.deferred_correction") && error.contains("method.deferred_correction=false"),
            "{error}"
        );
    }
}
