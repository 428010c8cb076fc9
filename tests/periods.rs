//! Means over whole periods of flows in time: windows, their derivative, and searches with them.

use crate::support::program::{hydrograd, refused, succeeds};
use hydrograd::config::scene::Config;
use hydrograd::numerics::curve::{sum, Curve};
use hydrograd::scene::around_flow::Around;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::history::{History, Of};
use hydrograd::scene::periods::{Period, Slopes, TooFew, Window};
use hydrograd::scene::shape_search::Search;

/// A disc that turns back and forth in a channel, near its bottom: its drag has the frequency of its turning.
const TURNING: &str = "scene = \"custom\"\nregion.size = [1.0, 0.5]\n\
    region.sides.left = { kind = \"inflow\", velocity = [\"4*y*(0.5 - y)/0.25\", 0] }\nregion.sides.right = { kind = \"outflow\" }\n\
    fluid.viscosity = 0.02\ninitial.velocity = [\"4*y*(0.5 - y)/0.25\", 0]\n\
    resolution.dx = 0.0625\nmethod.name = \"fixed\"\nmethod.flow = \"unsteady\"\ntime.end = 2.0\ntime.step = 0.008\n\
    objective.kind = \"drag\"\nobjective.goal = \"smaller\"\nobjective.periods = 2\n";
const DISC: &str = "[[shapes]]\nkind = \"disc\"\ncentre = [0.35, 0.2]\nradius = 0.08\nparameters = [1.0, 21.0]\n\
    velocity = [\"p0*sin(p1*t)*(0.2 - y)/0.08\", \"p0*sin(p1*t)*(x - 0.35)/0.08\"]\n";
const VARIABLES: &str = "[[variables]]\nnumber = \"shapes[0].parameters[0]\"\nlower = 0.5\nupper = 2.0\n\
    [[variables]]\nnumber = \"shapes[0].parameters[1]\"\nlower = 15.0\nupper = 30.0\n\
    [[variables]]\nnumber = \"shapes[0].radius\"\nlower = 0.07\nupper = 0.09\n";

fn turning(more: &str) -> String {
    format!("{TURNING}{more}\n{DISC}{VARIABLES}")
}

fn loaded(text: &str) -> Config {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    std::fs::write(&file, text).unwrap();
    Config::load(Some(file.to_str().unwrap()), None, &[]).unwrap_or_else(|error| panic!("{error}")).config
}

/// Times with steps of several sizes, and a periodic function with two harmonics around a mean of 1.3.
fn signal(omega: f64) -> (Vec<f64>, Vec<f64>) {
    let mut times = vec![];
    let mut time = 0.0;
    while time < 20.0 {
        time += if times.len() % 50 < 20 { 0.03 } else { 0.021 };
        times.push(time);
    }
    let value = |t: &f64| 1.3 + (omega * t + 0.4).sin() + 0.2 * (2.0 * omega * t).cos();
    let values = times.iter().map(value).collect();
    (times, values)
}

#[test]
fn a_curve_is_exact_for_parabolas_and_its_integral_is_that_of_its_values() {
    let times: Vec<f64> = (0..9).map(|k| 0.3 * k as f64 + 0.05 * (k as f64).sin()).collect();
    let curve = Curve::new(&times).unwrap();
    let parabola: Vec<f64> = times.iter().map(|t| 1.0 - 2.0 * t + 3.0 * t * t).collect();
    let integral = |t: f64| t - t * t + t * t * t;
    for time in [0.1, 0.37, 1.2, 2.0] {
        assert!((sum(&curve.value(time), &parabola) - (1.0 - 2.0 * time + 3.0 * time * time)).abs() < 1e-12);
        assert!((sum(&curve.slope(time), &parabola) - (6.0 * time - 2.0)).abs() < 1e-11);
        let weights = curve.integral(0.25, time);
        let found: f64 = weights.iter().zip(&parabola).map(|(w, v)| w * v).sum();
        assert!((found - integral(time) + integral(0.25)).abs() < 1e-12, "to {time}: {found}");
    }
    assert!(Curve::new(&times[..2]).is_none());
}

#[test]
fn means_over_whole_periods_are_those_of_the_function() {
    let omega = 2.3;
    let (times, values) = signal(omega);
    let length = 2.0 * std::f64::consts::PI / omega;
    let given = Window::of_length(&times, 3, &Period { length, by_variables: vec![] }).unwrap();
    let found = Window::of_course(&times, &values, 3).unwrap();
    for window in [&given, &found] {
        assert!((window.mean(&values) - 1.3).abs() < 1e-6, "{}", window.mean(&values));
        assert!(((window.to - window.from) / (3.0 * length) - 1.0).abs() < 1e-6);
        let off = window.irregularity(&times, &values).unwrap();
        assert!(off[0] < 1e-5 && off[1] < 1e-5, "{off:?}");
    }
    // A window of any time is some per cent off.
    let any = Window::since(&times, times[times.len() - 1] - 2.6 * length);
    assert!((any.mean(&values) - 1.3).abs() > 0.02);
    // A mean that drifts is seen, and so are periods that become longer.
    let drifts: Vec<f64> = values.iter().zip(&times).map(|(v, t)| v + 0.02 * t).collect();
    assert!(given.irregularity(&times, &drifts).unwrap()[1] > 0.03);
    let slows: Vec<f64> = times.iter().map(|t| (30.0 * t.sqrt()).sin()).collect();
    let slow = Window::of_course(&times, &slows, 4).unwrap();
    assert!(slow.irregularity(&times, &slows).unwrap()[0] > 0.03);
    assert_eq!(Window::of_course(&times, &vec![1.0; times.len()], 1), Err(TooFew(0)));
    assert_eq!(Window::of_length(&times, 9, &Period { length, by_variables: vec![] }), Err(TooFew(7)));
}

#[test]
fn the_derivative_of_a_mean_is_that_of_differences() {
    let (times, values) = signal(2.3);
    let other: Vec<f64> = times.iter().map(|t| (1.1 * t).cos() + 0.1 * t).collect();
    // By values of the objective, which say where its periods end, and of another figure.
    let window = Window::of_course(&times, &values, 3).unwrap();
    let own = window.slopes(&times, &values);
    let Slopes { by_values, by_objective, .. } = window.slopes(&times, &other);
    let around: Vec<usize> = [window.from, window.to].map(|end| times.partition_point(|t| *t < end)).to_vec();
    let near = around.iter().flat_map(|&k| k - 3..(k + 3).min(times.len()));
    for k in near.chain([5, 300, 500]) {
        let mean = |by: f64, of: &dyn Fn(&Window, &[f64]) -> f64| {
            let mut moved = values.clone();
            moved[k] += by;
            of(&Window::of_course(&times, &moved, 3).unwrap(), &moved)
        };
        let central = |of: &dyn Fn(&Window, &[f64]) -> f64| (mean(1e-5, of) - mean(-1e-5, of)) / 2e-5;
        let by_own = central(&|window, moved| window.mean(moved));
        assert!((by_own - own.by_values[k] - own.by_objective[k]).abs() < 1e-9, "{k}: {by_own}");
        let by_others = central(&|window, _| window.mean(&other));
        assert!((by_others - by_objective[k]).abs() < 1e-9, "{k}: {by_others} and {}", by_objective[k]);
        assert_eq!(by_values[k], window.weights[k]);
    }
    // By a period's length.
    let mean =
        |length: f64| Window::of_length(&times, 3, &Period { length, by_variables: vec![1.0] }).unwrap().mean(&other);
    let length = 2.6;
    let exact = Window::of_length(&times, 3, &Period { length, by_variables: vec![1.0] }).unwrap();
    let exact = exact.slopes(&times, &other).by_variables[0];
    let difference = (mean(length + 1e-5) - mean(length - 1e-5)) / 2e-5;
    assert!((exact - difference).abs() < 1e-8, "{exact} and {difference}");
}

fn run(text: &str) -> (AroundShapes, History) {
    let around = AroundShapes::new(&loaded(text)).unwrap();
    let (history, _) = around.march(&around.first(), None, &mut |_, _| Ok(())).unwrap();
    (around, history)
}

#[test]
fn a_turning_disc_has_the_mean_drag_of_its_periods() {
    let (around, history) = run(&turning("objective.period = \"2*PI/p1\""));
    let window = around.window(&around.first(), &history).unwrap();
    let mean = history.objective(&window);
    let off = window.irregularity(&history.times(), &history.values(&|moment| moment.objective)).unwrap();
    assert!(off[1] < 2e-3, "not periodic: {off:?}");
    // The same by straight lines from step to step, over the two periods before the end.
    let from = 2.0 - 4.0 * std::f64::consts::PI / 21.0;
    let (mut integral, mut length) = (0.0, 0.0);
    for pair in history.moments.windows(2).filter(|pair| pair[1].time > from) {
        let [a, b] = [&pair[0], &pair[1]];
        let begin = a.time.max(from);
        let at_begin = a.objective + (begin - a.time) / (b.time - a.time) * (b.objective - a.objective);
        integral += 0.5 * (b.time - begin) * (at_begin + b.objective);
        length += b.time - begin;
    }
    assert!((mean / (integral / length) - 1.0).abs() < 2e-4, "{mean} and {}", integral / length);
    let course = history.of(&window, 0);
    assert!(course.least < mean && mean < course.most && course.most - course.least > 0.05 * mean, "{course:?}");
}

#[test]
fn the_gradient_over_whole_periods_is_that_of_differences() {
    // A period by the turning's frequency, one that is found; and a limit whose mean has the objective's periods.
    let limit = "[[limits]]\nkind = \"lift\"\nat_most = 1.0\n";
    let of_period = turning("objective.period = \"2*PI/p1\"");
    let of_course = turning("") + limit;
    for (text, of) in [(&of_period, Of::Objective), (&of_course, Of::Objective), (&of_course, Of::Limit(0))] {
        let (around, history) = run(text);
        let first = around.first();
        let exact = around.march_gradient(&first, &history, of).unwrap().by_variables;
        let norm = exact.iter().map(|x| x * x).sum::<f64>().sqrt();
        for k in 0..first.len() {
            let at = |step: f64| {
                let mut moved = first.clone();
                moved[k] += step;
                let (history, _) = around.march(&moved, Some(&history.sizes), &mut |_, _| Ok(())).unwrap();
                let window = around.window(&moved, &history).unwrap();
                window.mean(&history.values(&|moment| match of {
                    Of::Objective => moment.objective,
                    Of::Limit(limit) => moment.limits[limit],
                    Of::Grid(_) => f64::NAN,
                }))
            };
            let step = if k == 2 { 1e-5 } else { 2e-4 * first[k] };
            let central = |step: f64| (at(step) - at(-step)) / (2.0 * step);
            let difference = (4.0 * central(0.5 * step) - central(step)) / 3.0;
            // Of numbers of about one: the radius has by far the largest derivative.
            let own = exact[k].abs().max(1e-3 * norm);
            assert!((difference - exact[k]).abs() < 1e-6 * own, "{of:?} {k}: {} and {difference}", exact[k]);
        }
    }
}

#[test]
fn a_search_lowers_the_mean_drag_of_a_flow_in_time() {
    let config = loaded(&turning("objective.period = \"2*PI/p1\"\n"));
    let mut shares = vec![];
    let found = Search::new(&config).unwrap().run(4, &mut |_, _| (), &mut |share| shares.push(share)).unwrap();
    let (first, best) = (&found.history[0], &found.history[found.best]);
    assert!(best.objective < 0.97 * first.objective, "{} -> {}", first.objective, best.objective);
    assert!(shares.iter().any(|share| *share < 0.1) && shares.iter().any(|share| *share > 0.99));
    // Each design is judged from the start of the scene: the best one again has the same value, and the search takes the same way.
    let again = Search::new(&config).unwrap().run(4, &mut |_, _| (), &mut |_| ()).unwrap();
    for (a, b) in found.history.iter().zip(&again.history) {
        assert_eq!((&a.variables, a.objective), (&b.variables, b.objective));
    }
}

/// The commands around a search: its files, a simulation of its best design, and the check of its gain.
#[test]
fn a_search_in_time_leaves_its_files_and_can_be_verified() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("scene.toml"), turning("objective.period = \"2*PI/p1\"")).unwrap();
    succeeds(at, &["optimize", "scene.toml", "--epochs", "2", "--out", "found"]);
    let read = |file: &str| -> serde_json::Value {
        serde_json::from_str(&std::fs::read_to_string(at.join(file)).unwrap()).unwrap()
    };
    let found = read("found/summary.json");
    let (first, best) = (found["drag_first"].as_f64().unwrap(), found["drag"].as_f64().unwrap());
    assert!(best < first, "{first} -> {best}");
    assert!(["best.toml", "history.csv", "report.html", "flow.png"].iter().all(|f| at.join("found").join(f).exists()));
    succeeds(at, &["simulate", "found/best.toml", "--out", "best"]);
    assert_eq!(read("best/summary.json")["objective"].as_f64(), Some(best));
    succeeds(at, &["verify", "found", "--out", "verified"]);
    let verified = read("verified/verification.json");
    let checks = verified["verification"].as_array().unwrap();
    let gain = |k: usize| checks[k]["gain"].as_f64().unwrap();
    assert!(checks.len() == 3 && checks[2]["check"].as_str().unwrap().contains("twice the time"), "{checks:?}");
    assert!((gain(0) + best / first - 1.0).abs() < 1e-9 && gain(1) > 0.0 && gain(2) > 0.0, "{checks:?}");
}

#[test]
fn what_periods_cannot_be_is_refused_by_name() {
    let refuses = |text: &str, words: &[&str]| {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("scene.toml"), text).unwrap();
        let arguments = ["simulate", "scene.toml", "--out", "run"];
        refused(&arguments, &hydrograd(folder.path(), &arguments), words);
        assert!(!folder.path().join("run").exists(), "half-written output");
    };
    refuses(&turning("").replace("periods = 2", "periods = 0"), &["objective.periods = 0", "1 <= objective.periods"]);
    refuses(&turning("objective.window = 0.3"), &["objective.periods", "objective.window", "one of them"]);
    refuses(&turning("objective.period = 1.2"), &["objective.periods", "at most 1", "time.end=4.8"]);
    refuses(&turning("objective.period = \"2*PI/p2\""), &["objective.period", "p2", "first shape"]);
    refuses(&turning("objective.period = \"2*PI/x\""), &["objective.period", "`x` is unknown"]);
    refuses(&turning("objective.period = \"0 - p1\""), &["objective.period", "-21", "2*PI/p1"]);
    refuses(
        &turning("objective.period = \"2*PI/p1\"").replace("objective.periods = 2\n", ""),
        &["objective.period", "objective.periods=4"],
    );
    let steady = TURNING.replace("method.flow = \"unsteady\"", "method.flow = \"steady\"");
    refuses(&steady, &["objective.periods", "method.flow=unsteady"]);
    // A later layer decides between the two.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("scene.toml");
    std::fs::write(&file, turning("objective.period = \"2*PI/p1\"")).unwrap();
    let config =
        Config::load(Some(file.to_str().unwrap()), None, &["objective.window=0.25".to_string()]).unwrap().config;
    assert_eq!((config.objective.periods, config.objective.period, config.objective.window), (None, None, 0.25));
}

/// A run without whole periods keeps its results, and says what the figures are instead; a gradient needs the periods.
#[test]
fn a_run_without_whole_periods_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let still =
        turning("").replace("parameters = [1.0, 21.0]", "parameters = [0.5, 15.0]").replace("sin(p1*t)", "p1/30");
    std::fs::write(folder.path().join("scene.toml"), still).unwrap();
    let output = hydrograd(folder.path(), &["simulate", "scene.toml", "--out", "run"]);
    let text = String::from_utf8_lossy(&output.stdout).to_string() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && text.contains("no 2 whole periods"), "{text}");
    let output = hydrograd(folder.path(), &["check-gradient", "scene.toml", "--out", "gradient"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(1) && text.contains("objective.period"), "{text}");
}
