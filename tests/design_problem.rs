//! Problems of every kind: the gradient by the variables through the solver, and the loop with its checkpoint.

use crate::support::differences::smallest_gap;
use hydrograd::adjoint::gradient::Progress;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::adjoint::{run, Dynamics};
use hydrograd::config::scene::Config;
use hydrograd::design::problem::{Derivative, Evaluation};
use hydrograd::design::{checkpoint, optimisers, Judge, Optimisation, Parametrisation, Problem, Scheduled, Search};
use hydrograd::error::Error;
use hydrograd::io::tensor_file::TensorFile;
use hydrograd::numerics::random::{stream, Normal};
use hydrograd::scene::Scene;
use std::sync::Arc;
use tempfile::TempDir;

const PARAMETRISATIONS: [&str; 2] = ["design.parametrisation=nodes", "design.parametrisation=b-spline"];
const OBJECTIVES: [&str; 2] = ["objective.kind=heat-outflow", "objective.kind=outlet-temperature"];
const METHODS: [&str; 2] = ["optimise.method=adam", "optimise.method=l-bfgs-b"];

fn problem(sets: &[&str]) -> (Config, Problem<f64>) {
    let sets: Vec<String> = sets.iter().map(|set| set.to_string()).collect();
    let config = Config::load(None, None, &sets).unwrap_or_else(|e| panic!("{e}")).config;
    let problem = Scene::from_config(&config).unwrap().design.unwrap();
    (config, problem)
}

/// Variables, parametrisation, deformation, solver, interpolation, objective over a window.
#[test]
fn the_gradient_is_the_derivative() {
    for parametrisation in PARAMETRISATIONS {
        for objective in OBJECTIVES {
            let sets = [parametrisation, objective, "time.steps=200", "time.cfl=1.0", "design.shape=sine"];
            let (_, problem) = problem(&[&sets[..], &["objective.window=0.02", "objective.samples=5"]].concat());
            let x = &problem.first;
            let schedule = Schedule::segments(problem.steps, 20);
            let Derivative { value, by_variables: gradient, .. } =
                problem.differentiate(x, &schedule, &mut |_| ()).unwrap();
            assert_eq!(value, problem.evaluate(x).unwrap(), "the gradient's run is the plain run");
            assert_eq!(gradient.len(), problem.parametrisation.variables());
            let mut normal = Normal::new(stream(5, "along"));
            let direction: Vec<f64> = x.iter().map(|_| normal.next()).collect();
            let slope: f64 = gradient.iter().zip(&direction).map(|(g, v)| g * v).sum();
            let at = |t: f64| {
                let moved: Vec<f64> = x.iter().zip(&direction).map(|(x, v)| x + t * v).collect();
                problem.evaluate(&moved).unwrap()
            };
            // Small steps meet no particle that crosses a strip; below them rounding takes over.
            let gap = |h: f64| ((at(h) - at(-h)) / (2.0 * h) / slope - 1.0).abs();
            let best = smallest_gap(&[3e-8, 1e-7, 1e-8], 1e-5, gap);
            println!("{parametrisation}, {objective}: relative error {best:.1e} of {slope:.3e}");
            assert!(best <= 1e-5, "{parametrisation}, {objective}: {best:e}");
        }
    }
}

/// The mixed outlet temperature is Q over the mass flow, in every way to look at the flow.
#[test]
fn the_outlet_temperature_is_heat_over_mass() {
    for interpolation in ["flux", "fluid", "fluid-and-walls"] {
        let interpolation = format!("objective.interpolation={interpolation}");
        let sets = ["time.steps=40", "objective.window=0", "objective.target_x=0.76", &interpolation];
        let of = |objective: &str| problem(&[&sets[..], &[objective]].concat()).1;
        let (heat, temperature) = (of(OBJECTIVES[0]), of(OBJECTIVES[1]));
        let (dynamics, start) = (temperature.dynamics(), temperature.start(&temperature.first));
        let mut end = run(&dynamics, &start, temperature.steps, &mut []).unwrap();
        let flows = temperature.outlet.numbers(&dynamics.look(&mut end).unwrap()).unwrap();
        let (q, t) = (heat.evaluate(&heat.first).unwrap(), temperature.evaluate(&temperature.first).unwrap());
        assert!(t > 0.0 && q > 0.0);
        assert!((flows.heat / flows.mass / t - 1.0).abs() < 1e-12, "{interpolation}");
        assert!((flows.heat * temperature.outlet.spacing / q - 1.0).abs() < 1e-12, "{interpolation}");
    }
}

/// Stopped after every epoch and resumed from the file: the same bits, for every optimiser and parametrisation.
#[test]
fn a_checkpoint_goes_on_to_the_bit() {
    let folder = TempDir::new().unwrap();
    for method in METHODS {
        for parametrisation in PARAMETRISATIONS {
            let sets = [method, parametrisation, OBJECTIVES[0], "time.steps=30", "objective.window=0"];
            let near = ["objective.target_x=0.76", "optimise.learning_rate=2e-3", "design.control_points=5"];
            let nodes: &[&str] = match parametrisation == PARAMETRISATIONS[0] {
                true => &["design.nodes=[0.6, 0.65, 0.7]", "design.offsets=[0.0, 0.001, 0.0]"],
                false => &["channel.hot_from=0.6"],
            };
            let (config, problem) = problem(&[&sets[..], &near, nodes].concat());
            let solver = Scheduled { schedule: Schedule::segments(problem.steps, 5), problem };
            let search = Search { config: &config, solver: &solver, surrogate: None };
            let mut whole = Optimisation::new(search.optimiser(&solver.problem.first));
            search.run(&mut whole, 8, &mut |_: &Optimisation| Ok(())).unwrap();
            let path = folder.path().join("checkpoint.safetensors");
            let mut parts = Optimisation::new(search.optimiser(&solver.problem.first));
            for epochs in 1..=8 {
                let mut keep = |now: &Optimisation| Ok(checkpoint::write(&path, now, &[])?);
                search.run(&mut parts, epochs, &mut keep).unwrap();
                let file = TensorFile::read(&path).unwrap();
                parts = checkpoint::restore(&file, solver.parametrisation(), |x| search.optimiser(x)).unwrap();
            }
            let name = format!("{method}, {parametrisation}");
            assert_eq!(whole.history.len(), parts.history.len(), "{name}");
            for (one, two) in whole.history.iter().zip(&parts.history) {
                assert_eq!((&one.variables, one.figure, one.loss), (&two.variables, two.figure, two.loss), "{name}");
            }
            assert_eq!(format!("{:?}", whole.optimiser), format!("{:?}", parts.optimiser), "{name}");
            assert!(whole.history[whole.best].loss < whole.history[0].loss, "{name} gained nothing");
        }
    }
}

/// A checkpoint as it was written before there was more than one optimiser.
#[test]
fn earlier_checkpoints_are_read() {
    let (config, problem) = problem(&[METHODS[0], "design.nodes=[0.4, 0.5]", "design.offsets=[0.0, 0.0]"]);
    let mut record = optimisers::Record::default();
    record.put("offsets", &[2], vec![0.001, 0.002]);
    record.put("offsets_best", &[2], vec![0.0, 0.0]);
    record.put("adam.first_moment", &[2], vec![0.1, 0.2]);
    record.put("adam.second_moment", &[2], vec![0.3, 0.4]);
    record.put("history.offsets", &[1, 2], vec![0.0, 0.0]);
    for (name, value) in [("q", 0.04), ("loss", -0.04), ("gradient_norm", 0.5), ("seconds", 1.0)] {
        record.put(&format!("history.{name}"), &[1], vec![value]);
    }
    for (key, text) in [("kind", checkpoint::KIND), ("epochs", "1"), ("best_epoch", "0"), ("adam.steps", "1")] {
        record.note(key, text);
    }
    let (tensors, metadata) = (record.tensors.clone(), record.metadata.clone());
    let file = TensorFile { path: "checkpoint.safetensors".into(), tensors, metadata };
    let new = |x: &[f64]| optimisers::of_config(&config.optimise, x);
    let found = checkpoint::restore(&file, &*problem.parametrisation, new).unwrap();
    assert_eq!(found.optimiser.ask(), [0.001, 0.002]);
    assert_eq!((found.history.len(), found.history[0].figure, found.best), (1, 0.04, 0));
    let mut again = optimisers::Record::default();
    found.optimiser.save(&mut again);
    assert!(again.tensors.contains_key("adam.last_good"));
    again.tensors.remove("adam.last_good");
    assert!(again.tensors.iter().all(|(name, tensor)| record.tensors[name] == *tensor));
    // What no run could have written.
    for (name, values, expected) in [
        ("offsets", vec![f64::NAN, 0.0], "design.offsets[0] = NaN"),
        ("offsets", vec![0.03, 0.0], "design.offsets[0] = 0.03 is out of bounds"),
        ("adam.first_moment", vec![f64::INFINITY, 0.0], "adam.first_moment[0] = inf"),
        ("adam.second_moment", vec![0.0], "adam.second_moment"),
        ("adam.last_good", vec![f64::NAN, 0.0], "adam.last_good[0] = NaN"),
    ] {
        let mut broken = file.clone();
        let mut record = optimisers::Record::default();
        record.put(name, &[values.len()], values);
        broken.tensors.extend(record.tensors);
        let error = checkpoint::restore(&broken, &*problem.parametrisation, new).unwrap_err().to_string();
        assert!(error.contains(expected) && error.contains("checkpoint.safetensors"), "{error}");
    }
}

/// Up to a cliff, beyond which runs diverge; the minimum lies behind it.
fn cliff(x: &[f64]) -> Result<Evaluation, Error> {
    if x[0] > 0.01 {
        return Err(Error::diverged("step 7: the run has diverged", "time.cfl=0.5"));
    }
    let loss: f64 = x.iter().map(|x| (x - 0.015) * (x - 0.015)).sum();
    Ok(Evaluation {
        figure: -loss,
        loss,
        gradient: x.iter().map(|x| 2.0 * (x - 0.015)).collect(),
        ..Evaluation::default()
    })
}

/// Judges by a function of the variables.
struct By<F> {
    function: F,
    parametrisation: Arc<dyn Parametrisation>,
}

impl<F: Fn(&[f64]) -> Result<Evaluation, Error>> Judge for By<F> {
    fn gradient(&self, variables: &[f64], _: Progress<'_>) -> Result<Evaluation, Error> {
        (self.function)(variables)
    }
    fn value(&self, variables: &[f64]) -> Result<Evaluation, Error> {
        (self.function)(variables)
    }
    fn figure(&self, _: &[f64], loss: f64) -> f64 {
        -loss
    }
    fn parametrisation(&self) -> &dyn Parametrisation {
        &*self.parametrisation
    }
}

/// Goes on by a function until there are so many epochs.
fn go_on(
    config: &Config,
    problem: &Problem<f64>,
    function: impl Fn(&[f64]) -> Result<Evaluation, Error>,
    now: &mut Optimisation,
    epochs: usize,
) -> anyhow::Result<()> {
    let judge = By { function, parametrisation: problem.parametrisation.clone() };
    Search { config, solver: &judge, surrogate: None }.run(now, epochs, &mut |_: &Optimisation| Ok(()))
}

#[test]
fn a_design_that_diverges_is_a_rejected_step() {
    for method in METHODS {
        let (config, problem) =
            problem(&[method, "design.nodes=[0.4, 0.6]", "design.offsets=[0.0, 0.0]", "optimise.learning_rate=0.004"]);
        let new = |x: &[f64]| optimisers::of_config(&config.optimise, x);
        let mut whole = Optimisation::new(new(&problem.first));
        go_on(&config, &problem, cliff, &mut whole, 30).unwrap();
        assert!(whole.rejected() > 0, "{method}: the test does not test");
        assert!(!whole.history[whole.best].is_rejected());
        let best = &whole.history[whole.best].variables;
        // As near to the cliff as steps that know nothing of it come, and on to the minimum along it.
        assert!(best[0] > 0.006 && best[0] <= 0.01 && (best[1] - 0.015).abs() < 6e-3, "{method}: {best:?}");
        for epoch in whole.history.iter().filter(|epoch| epoch.is_rejected()) {
            assert!(epoch.figure.is_nan() && epoch.gradient_norm.is_nan() && epoch.loss == f64::INFINITY);
            assert_eq!(epoch.failure.as_deref(), Some("step 7: the run has diverged"));
        }
        // Kept and read between any two epochs, rejected ones too.
        let folder = TempDir::new().unwrap();
        let path = folder.path().join("checkpoint.safetensors");
        let mut parts = Optimisation::new(new(&problem.first));
        while !parts.is_finished(30) {
            let epochs = parts.history.len() + 1;
            go_on(&config, &problem, cliff, &mut parts, epochs).unwrap();
            checkpoint::write(&path, &parts, &[]).unwrap();
            parts = checkpoint::restore(&TensorFile::read(&path).unwrap(), &*problem.parametrisation, new).unwrap();
        }
        assert_eq!(parts.column(|e| e.loss), whole.column(|e| e.loss), "{method}");
        assert_eq!(parts.rejected(), whole.rejected());
        // Of the first design there is nothing to step back to.
        let mut broken = Optimisation::new(new(&[0.012, 0.0]));
        let error = go_on(&config, &problem, cliff, &mut broken, 3).unwrap_err().to_string();
        assert!(error.contains("has diverged") && broken.history.is_empty(), "{error}");
        // Other errors are errors wherever they happen.
        let mut failed = Optimisation::new(new(&problem.first));
        go_on(&config, &problem, cliff, &mut failed, 2).unwrap();
        let full = |_: &[f64]| Err(Error::run("full disk", "space"));
        assert!(go_on(&config, &problem, full, &mut failed, 9).is_err() && failed.history.len() == 2);
    }
}

#[test]
fn a_finished_optimiser_ends_the_run() {
    let (config, problem) = problem(&["design.nodes=[0.4, 0.6]", "design.offsets=[0.0, 0.0]", METHODS[1]]);
    let mut optimisation = Optimisation::new(optimisers::of_config(&config.optimise, &problem.first));
    let square = |x: &[f64]| {
        let loss: f64 = x.iter().map(|x| (x - 0.005) * (x - 0.005)).sum();
        Ok(Evaluation {
            figure: -loss,
            loss,
            gradient: x.iter().map(|x| 2.0 * (x - 0.005)).collect(),
            ..Evaluation::default()
        })
    };
    go_on(&config, &problem, square, &mut optimisation, 1000).unwrap();
    assert!(optimisation.optimiser.is_done() && optimisation.history.len() < 60, "{}", optimisation.history.len());
}

/// An ensemble's gradient that is not larger than its error ends the search, also of one that is resumed.
#[test]
fn a_gradient_within_its_error_ends_the_run() {
    let (config, problem) = problem(&["design.nodes=[0.4, 0.6]", "design.offsets=[0.0, 0.0]", METHODS[0]]);
    let new = |x: &[f64]| optimisers::of_config(&config.optimise, x);
    let bowl = |x: &[f64]| {
        let loss: f64 = x.iter().map(|x| (x - 0.005) * (x - 0.005)).sum();
        let gradient = x.iter().map(|x| 2.0 * (x - 0.005)).collect();
        Ok(Evaluation { figure: -loss, loss, gradient, gradient_error: 5e-3, ..Evaluation::default() })
    };
    let mut found = Optimisation::new(new(&problem.first));
    go_on(&config, &problem, bowl, &mut found, 1000).unwrap();
    let (last, before) = (&found.history[found.history.len() - 1], &found.history[found.history.len() - 2]);
    assert!(last.gradient_norm <= 5e-3 && before.gradient_norm > 5e-3, "{:?}", found.column(|e| e.gradient_norm));
    assert!(!found.optimiser.is_done());
    let folder = TempDir::new().unwrap();
    let path = folder.path().join("checkpoint.safetensors");
    checkpoint::write(&path, &found, &[]).unwrap();
    let restored = checkpoint::restore(&TensorFile::read(&path).unwrap(), &*problem.parametrisation, new).unwrap();
    assert!(restored.is_finished(1000));
    assert_eq!(restored.history, found.history);
}

/// What the walls give to the fluid is what flows out of it, once the flow is steady; and a wall that is better by one figure
/// is better by the other.
#[test]
fn the_walls_heat_is_what_flows_out() {
    let steady = |kind: &str, amplitude: f64, periods: f64| {
        let shape = [
            "method.name=fixed".to_string(),
            "design.shape=cosine".into(),
            format!("objective.kind={kind}"),
            format!("design.amplitude={amplitude}"),
            format!("design.periods={periods}"),
        ];
        let config = Config::load(None, None, &shape).unwrap().config;
        let problem = Scene::<f64>::from_config(&config).unwrap().design.unwrap();
        problem.evaluate_steady(&problem.first, 1e-8).unwrap()
    };
    let ratio = |(amplitude, periods): (f64, f64)| {
        let (outflow, walls) = (steady("heat-outflow", amplitude, periods), steady("wall-heat", amplitude, periods));
        println!("{amplitude}, {periods}: {outflow:.6} flows out, {walls:.6} comes in");
        walls / outflow
    };
    let flat = ratio((0.0, 1.0));
    // But for what is conducted through the section.
    assert!((flat - 1.0).abs() < 1e-3, "{flat}");
    // The weights of what the flow carries are not those of its continuity: over curved walls they differ by up to 0.7 % of the
    // heat at this spacing, and by 0.2 % at half of it.
    for wall in [(0.01, 1.0), (-0.015, 2.0), (0.02, 3.0)] {
        let found = ratio(wall);
        assert!((found / flat - 1.0).abs() < 8e-3, "{wall:?}: {found} {flat}");
    }
}
