//! Errors of figures from one solution, by dual-weighted residuals.

use crate::cloud::{channel, shape, solved, SIDES};
use crate::deferred_correction::corrected;
use crate::figure_errors::summary;
use crate::support::program::succeeds;
use hydrograd::scene::around_shapes::AroundShapes;
use hydrograd::scene::record::Record;
use hydrograd::scene::solution_error::SolutionErrors;
use hydrograd::sph::cloud::equations::Bar;
use hydrograd::sph::cloud::figures::Figure;
use hydrograd::sph::cloud::problem::Solution;
use hydrograd::sph::cloud::weighted_residual::Weighted;
use serde_json::{json, Value};

fn weighted(around: &mut AroundShapes, solution: &Solution, figures: &[Figure]) -> Vec<Weighted> {
    let residual = around.flow.residual(solution).unwrap();
    let of = |figure: &Figure| {
        let mut bar = Bar::new(around.flow.cloud.particles(), solution.shaped.area.len());
        around.flow.measures.pull_back(*figure, &around.flow.at(solution), 1.0, &mut bar);
        around.flow.weighted_residual(solution, &residual, &bar).unwrap()
    };
    figures.iter().map(of).collect()
}

fn errors(text: &str) -> (Record, SolutionErrors) {
    let (mut around, solution) = solved(text);
    let figures: serde_json::Map<String, Value> =
        around.summary(&solution).into_iter().map(|(name, value)| (name.to_string(), value)).collect();
    let record: Record = serde_json::from_value(json!(figures)).unwrap();
    let found = around.errors(&solution, &record).unwrap();
    (record, found)
}

/// The sum over slopes is what a deferred correction changes a figure by, but for terms of second order in the change.
#[test]
fn sums_over_slopes_are_what_a_correction_changes() {
    let (mut around, solution) = solved(&corrected(SIDES));
    let first = solution.first.as_deref().unwrap().clone();
    let figures = [
        Figure::Force { shape: 0, along: 0 },
        Figure::Force { shape: 1, along: 1 },
        Figure::Torque { shape: 0 },
        Figure::Heat { shape: 0 },
        Figure::PressureDrop,
        Figure::HeatOutflow,
    ];
    let found = weighted(&mut around, &first, &figures);
    for (figure, found) in figures.iter().zip(&found) {
        let [before, after] = [&first, &solution].map(|solution| around.flow.value(solution, *figure));
        let (change, size) = (before - after, found.magnitude.iter().sum::<f64>());
        println!("{figure:?}: {before} becomes {after}, by {change}, and {} is expected, of {size}", found.slopes);
        // A figure that hardly changes, because all of it cancels, does so by terms of second order. The heat that flows out has more of
        // these than others, for velocity and temperature change at once.
        let share = if *figure == Figure::HeatOutflow { 0.1 } else { 0.01 };
        assert!((found.slopes - change).abs() < share * change.abs() + 1e-3 * size, "{figure:?}");
    }
    // A cloud without a correction makes the same fits when they are asked for.
    let (mut plain, own) = solved(SIDES);
    for (own, found) in weighted(&mut plain, &own, &figures).iter().zip(&found) {
        let sums = [(own.slopes, found.slopes), (own.laplacians, found.laplacians)];
        let size: f64 = found.magnitude.iter().sum();
        assert!(sums.iter().all(|(own, found)| (own - found).abs() < 1e-9 * size), "{sums:?}");
        assert!(own.slopes.abs() + own.laplacians.abs() <= own.magnitude.iter().sum::<f64>());
    }
}

/// A flow whose fields are quadratic is that of its fits, and has no error.
#[test]
fn a_plane_flow_has_no_error() {
    let (record, found) = errors(&channel(0.05, ""));
    println!("{:?}", found.figures);
    assert!(record.number("flow_rate").unwrap() > 0.1);
    for one in found.figures.iter().filter(|one| one.value.abs() > 1e-6) {
        assert!(one.error < 1e-6 * one.value.abs(), "{one:?}");
    }
}

/// Finite elements are within the errors around bodies, which are at most some times as large as the true ones: flow rates, forces and heat, on
/// two clouds and with a correction.
#[test]
fn finite_elements_are_within_the_errors() {
    // Flow rate, drag, lift, heat: data/reference/bodies-in-channel.csv.
    let bodies = [
        ("disc", vec![0.45, 0.17, 0.07], [0.2227744, 0.20013797, 0.0259782, 0.041327892]),
        ("ellipse", vec![0.5, 0.2, 0.08, 0.045, 20.0], [0.27231109, 0.17807685, -0.0512096, 0.039069957]),
        ("ellipse", vec![0.5, 0.22, 0.11, 0.03, -35.0], [0.22726613, 0.20137619, 0.133629, 0.040603278]),
    ];
    let names = ["flow_rate", "shapes[2].force[0]", "shapes[2].force[1]", "shapes[2].heat"];
    let mut ratios = vec![];
    for (kind, numbers, truths) in &bodies {
        for (dx, with) in [(0.03, false), (0.02, false), (0.02, true)] {
            let text = format!("{}{}", channel(dx, ""), shape(kind, numbers));
            let (_, found) = errors(&if with { corrected(&text) } else { text });
            for (name, truth) in names.iter().zip(truths) {
                let one = found.figures.iter().find(|one| one.name == *name).unwrap();
                let ratio = one.error / (one.value - truth).abs();
                println!("{kind} {dx} {with} {name}: off by {:.2e}, error {:.2e}", one.value - truth, one.error);
                ratios.push(ratio);
            }
            assert!(found.density.iter().all(|x| x.is_finite() && *x >= 0.0));
            assert!(found.density.iter().any(|x| *x > 0.0));
        }
    }
    ratios.sort_by(f64::total_cmp);
    let inside = ratios.iter().filter(|ratio| **ratio >= 1.0).count();
    let middle = ratios[ratios.len() / 2];
    println!("{inside} of {} inside, {middle} in the middle", ratios.len());
    assert!(inside * 20 >= ratios.len() * 19 && middle < 8.0, "{ratios:?}");
}

/// The command tells them, shows where the first one comes from, and chooses a spacing by them.
#[test]
fn simulate_shows_where_the_error_comes_from() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // The cylinder of Schaefer and Turek: drag 5.5795, pressures 0.11752.
    let text = succeeds(at, &["simulate", "schaefer-turek-1", "--dx", "0.0109", "--error", "--out", "run"]);
    assert!(text.contains("error.png") && text.contains("19 of 20"), "{text}");
    assert!(at.join("run/error.png").exists() && at.join("run/error.svg").exists());
    let record = summary(&at.join("run"));
    let all = record["errors"].as_array().unwrap();
    let of = |name: &str| {
        let one = all.iter().find(|one| one["name"] == name).unwrap();
        [one["value"].as_f64().unwrap(), one["error"].as_f64().unwrap()]
    };
    let [drag, error] = of("shapes[0].force[0]");
    let truth = 5.5795 * 0.5 * 0.2 * 0.2 * 0.1;
    assert!((drag - truth).abs() < error && error < 0.02 * truth, "{drag} +- {error}, {truth}");
    let [drop, error] = of("objective");
    assert!((drop - 0.11752).abs() < error && error < 0.1 * 0.11752, "{drop} +- {error}");
    assert_eq!(record["objective_error"], error);
    let frame = hydrograd::io::vtk::read_vtp(&at.join("run/particles/particles_000000.vtp")).unwrap();
    let (_, density) = frame.scalars.iter().find(|(name, _)| *name == "error").unwrap();
    assert!(density.iter().all(|x| *x >= 0.0));
    let page = std::fs::read_to_string(at.join("run/report.html")).unwrap();
    assert!(page.contains("error.svg"), "the picture is not on the page");
    // Without being asked nothing of this is made.
    succeeds(at, &["simulate", "schaefer-turek-1", "--dx", "0.0109", "--out", "plain"]);
    assert!(!at.join("plain/error.png").exists() && summary(&at.join("plain"))["errors"].is_null());
}
