//! Our gradients against those of JAX-SPH in f64: every group of the file whose configuration we support.

use crate::support::final_sum::{FinalSum, Summed};
use crate::support::jax_sph::{field, number, reference_file, Case};
use hydrograd::adjoint::gradient::gradient;
use hydrograd::adjoint::schedule::Schedule;
use hydrograd::adjoint::Objective;
use hydrograd::config::scene::{Interpolation as Mode, Kernels};
use hydrograd::design::objectives::{Mean, Outlet, Quantity, Samples};
use hydrograd::particles::tag;
use hydrograd::sph::dynamics::Sph;
use hydrograd::sph::interpolation::Interpolation;
use hydrograd::sph::solver::Snapshot;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Relative to the gradient's largest component.
const TOLERANCE: f64 = 1e-6;

fn difference(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(0.0f64, |m, x| m.max(x.abs()));
    assert!(scale > 0.0, "the reference gradient is zero");
    ours.iter()
        .zip(theirs)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, |m: f64, x| if x.is_nan() { f64::INFINITY } else { m.max(x) })
        / scale
}

fn run<O: Objective>(case: &Case, state: Vec<f64>, steps: usize, objective: &O) -> (f64, Vec<f64>) {
    let model = Arc::new(case.model(false));
    let positions = state[..case.dimension * case.n].to_vec();
    let start = Snapshot { step: 0, parts: 1, least_parts: 1, state, reference: Arc::new(positions) };
    let dynamics = Sph::new(model, Kernels::Fused);
    let result = gradient(&dynamics, &start, &Schedule::segments(steps, 3), objective, &mut |_| ()).unwrap();
    (result.value, result.state.flatten_all().unwrap().to_vec1::<f64>().unwrap())
}

/// dL/dr of the kinetic energy after some steps.
fn kinetic_energy(group: &hdf5::Group, case: &Case) -> Result<String, String> {
    let (n, d) = (case.n, case.dimension);
    let steps = number(group, "n_steps") as usize;
    let layout = case.model(false).layout;
    let state = case.state(&layout, &group.group("start").map_err(|e| e.to_string())?);
    let objective = FinalSum { steps, of: Summed::KineticEnergy };
    // Theirs counts the walls' own motion too, which does not change.
    let own = |k: usize| if case.tags[k % n] == tag::FLUID { 0.0 } else { state[layout.velocity() * n + k] };
    let walls: f64 = (0..d * n).map(|k| 0.5 * own(k).powi(2)).sum();
    let (value, bar) = run(case, state, steps, &objective);
    let value = value + walls;
    let loss = (value / number(group, "loss") - 1.0).abs();
    let theirs = field(group, "grad", n, d).ok_or("grad is missing")?;
    let gradient = difference(&bar[..d * n], &theirs.concat());
    let report = format!("loss {loss:.1e}, gradient {gradient:.1e}");
    if loss <= TOLERANCE && gradient <= TOLERANCE {
        Ok(report)
    } else {
        Err(report)
    }
}

/// dQ and dTsum by the wall's offsets.
fn heated_channel(group: &hdf5::Group, case: &Case) -> Result<String, String> {
    let n = case.n;
    let (steps, dx) = (number(group, "n_steps") as usize, number(group, "dx"));
    let layout = case.model(false).layout;
    let base = field(group, "r_base", n, 2).ok_or("r_base is missing")?;
    let mut state = vec![0.0; layout.state_rows() * n];
    for (k, row) in field(group, "r0", n, 2).ok_or("r0 is missing")?.iter().enumerate() {
        state[k * n..(k + 1) * n].copy_from_slice(row);
    }
    let hot = 1.23 - case.reference_temperature;
    for i in 0..n {
        if case.tags[i] == tag::HOT_WALL {
            state[layout.temperature() * n + i] = hot;
        }
    }
    let (height, y0) = (case.size[1] - 6.0 * dx, 3.0 * dx);
    let targets = (0..(height / dx).round() as usize).map(|k| [0.9, y0 + (k as f64 + 0.5) * dx, 0.0]).collect();
    let interpolation = Interpolation {
        kernel: case.model(false).kernel,
        domain: case.model(false).domain,
        targets: Arc::new(targets),
        kernels: Kernels::Fused,
    };
    let samples = Samples(BTreeMap::from([(steps, 1.0)]));
    let outlet = Outlet { interpolation, mode: Mode::Fluid, spacing: dx };
    let outflow = Mean { of: Quantity::HeatOutflow { outlet, scale: 1.0 }, samples };
    let warmth = FinalSum { steps, of: Summed::Heat };
    let designs = group.dataset("off").map_err(|e| e.to_string())?.size();
    let columns = (case.size[0] / dx).round() as usize;
    // y = y0 + off + (y - y0)(H - off)/H of the fluid in a column, y + off of its hot wall.
    let by_offset = |bar: &[f64]| -> Vec<f64> {
        let mut gradient = vec![0.0; designs];
        for i in 0..n {
            let column = i % columns;
            if (13..13 + designs).contains(&column) {
                let share = match case.tags[i] {
                    tag::FLUID => 1.0 - (base[1][i] - y0) / height,
                    tag::HOT_WALL => 1.0,
                    _ => 0.0,
                };
                gradient[column - 13] += share * bar[n + i];
            }
        }
        gradient
    };
    let mut reports = Vec::new();
    let mut good = true;
    for (name, value_name, (value, bar)) in [
        ("dQ", "Q", run(case, state.clone(), steps, &outflow)),
        ("dTsum", "Tsum", run(case, state.clone(), steps, &warmth)),
    ] {
        let theirs = group.dataset(name).and_then(|d| d.read_raw::<f64>()).map_err(|e| e.to_string())?;
        let loss = (value / number(group, value_name) - 1.0).abs();
        let gradient = difference(&by_offset(&bar), &theirs);
        good &= loss <= TOLERANCE && gradient <= TOLERANCE;
        reports.push(format!("{value_name} {loss:.1e}, {name} {gradient:.1e}"));
    }
    if good {
        Ok(reports.join(", "))
    } else {
        Err(reports.join(", "))
    }
}

#[test]
fn gradients_of_jax_sph() {
    let path = reference_file("HYDROGRAD_JAX_SPH_GRADIENTS", "jax-sph-gradients.h5");
    let file = hdf5::File::open(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    let (mut compared, mut skipped, mut failures) = (0, Vec::new(), Vec::new());
    for name in file.member_names().unwrap() {
        let group = file.group(&name).unwrap();
        let case = match Case::read(&group) {
            Ok(case) => case,
            Err(reason) => {
                skipped.push(format!("{name} ({reason})"));
                continue;
            }
        };
        let result = if group.link_exists("grad") && group.link_exists("start") {
            kinetic_energy(&group, &case)
        } else if group.link_exists("dQ") {
            heated_channel(&group, &case)
        } else {
            skipped.push(format!("{name} (neither grad nor dQ)"));
            continue;
        };
        compared += 1;
        match result {
            Ok(report) => println!("{name}: {report}"),
            Err(report) => failures.push(format!("{name}: {report} (allowed {TOLERANCE:.0e})")),
        }
    }
    println!("compared {compared} groups, skipped {}: {}", skipped.len(), skipped.join(", "));
    assert!(failures.is_empty(), "{} of {compared} groups differ:\n{}", failures.len(), failures.join("\n"));
    assert!(compared > 0, "nothing was compared in {}", path.display());
}
