//! `simulate`, `scenes check` and `check-gradient` of fixed particles in three dimensions.

use super::around_shapes::{goal, imbalances, of_objective, print_figures, Figures};
use super::files::{self, write_json};
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::{print_dimensionless, warn};
use super::{machine, page};
use crate::config::custom::Part;
use crate::error::Error;
use crate::io::vtk::VtkSeries;
use crate::numerics::interrupt;
use crate::numerics::threads::{count, in_words};
use crate::report::memory::peak_memory_bytes;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Designed;
use crate::scene::around_shapes::{finer, Judged};
use crate::scene::load::Loaded;
use crate::scene::record::Record;
use crate::scene::warnings::Warning;
use crate::sph::cloud::space::problem::Solution;
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// More of the flow than this must not be left of continuity.
const REST: f64 = 0.03;

fn warnings_of(around: &AroundBodies, solution: &Solution, figures: &Figures) -> Vec<Warning> {
    let mut found = imbalances(figures, &finer(around.config()));
    let rest = around.rest(solution);
    if rest > REST {
        let problem =
            format!("{:.1} % of the flow enters or leaves that the sides of the box do not account for", 100.0 * rest);
        found.push(Warning::new("volume", [rest, REST], problem, finer(around.config())));
    }
    found
}

/// The summary of a flow.
pub fn record(loaded: &Loaded, around: &AroundBodies, solution: &Solution, figures: &Figures, seconds: f64) -> Record {
    let mut record = Record::of_steady(loaded, around.fastest(solution), seconds);
    for (name, value) in figures {
        record.put(name, value);
    }
    record.put_warnings(loaded, warnings_of(around, solution, figures));
    record
}

/// `hydrograd simulate`: the steady flow, with figures, a picture of the middle and a frame for ParaView.
pub fn simulate(loaded: &Loaded, folder: &Path, earlier: Earlier) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let mut around = AroundBodies::new(config)?;
    let placed = clock.elapsed().as_secs_f64();
    let solution = around.solve(&around.first())?;
    let seconds = clock.elapsed().as_secs_f64();
    interrupt::check()?;
    let own = RunFolder::take(folder, "simulate", earlier)?;
    files::write_config(folder, loaded)?;
    let end = around.fields(&solution);
    end.write(folder, config, &loaded.text)?;
    let mut series = VtkSeries::new(&folder.join("particles"), "particles")?;
    end.with_frame(|frame| series.write(frame))?;
    let heat = files::plot_flow_and_heat(folder, &[("steady", &end)], config.resolution.dx)?;
    let figures = around.summary(&solution);
    let record = record(loaded, &around, &solution, &figures, seconds);
    files::write_summary(folder, &record)?;
    let counts = around.flow.solver.counts;
    println!(
        "{} fixed particles, steady after {} steps of Newton's method ({} iterations) in {seconds:.2} s ({placed:.2} s to place them) on {}",
        around.flow.cloud.particles(),
        counts.steps,
        counts.iterations,
        in_words(count())
    );
    print_figures(config, &figures);
    print_dimensionless(config, around.fastest(&solution));
    println!(
        "files in {}: report.html, summary.json, flow.png{}, state.h5, particles/particles.pvd (ParaView)",
        folder.display(),
        if heat { ", temperature.png" } else { "" }
    );
    if !config.variables.is_empty() {
        println!(
            "next: hydrograd optimize {}    changes its variables so that the objective becomes {}",
            loaded.source.argument(),
            goal(config)
        );
    }
    warn(&record.warnings());
    page::write(folder)?;
    own.finish()
}

/// `hydrograd scenes check`: particles and what they cost.
pub fn check(loaded: &Loaded, folder: &Path) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let around = AroundBodies::new(config)?;
    let placed = clock.elapsed().as_secs_f64();
    let _own = RunFolder::take(folder, "scenes check", Earlier::Replaced)?;
    let places = &around.flow.cloud.places;
    let least = places.spacing.iter().copied().fold(f64::INFINITY, f64::min);
    println!("{}: scene {}, 3 dimensions, dx {}", loaded.source, config.scene.name(), config.resolution.dx);
    println!(
        "particles           {} in all: {} fluid, {} on walls; spacing {least:.2e} at least",
        places.place.len(),
        places.inside,
        places.boundary.len()
    );
    println!("method              fixed: a steady flow, no steps in time");
    println!("run time            {placed:.2} s to place the particles; the flow is not solved here");
    println!("memory              {:.0} MB at the peak", peak_memory_bytes() as f64 / 1e6);
    machine::answer(&json!({
        "scene": config.scene,
        "dimensions": 3,
        "dx": config.resolution.dx,
        "particles": {
            "all": places.place.len(),
            "kinds": { "fluid": places.inside, "on walls": places.boundary.len() },
        },
        "least_spacing": least,
        "peak_memory_bytes": peak_memory_bytes(),
        "warnings": [],
    }));
    Ok(())
}

/// Largest relative difference of gradient and differences: what the iterations leave.
const TOLERANCE: f64 = 1e-5;
/// Steps of differences: in spacings of the surface, and in degrees.
const STEP: f64 = 0.04;
const DEGREES: f64 = 0.05;

/// `hydrograd check-gradient`: value and gradient of the steady objective by every variable, and differences beside it.
pub fn check_gradient(loaded: &Loaded, folder: &Path) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let mut around = AroundBodies::new(config)?;
    let first = around.first();
    let solution = around.solve(&first)?;
    let solved = clock.elapsed().as_secs_f64();
    let Judged { value, by_variables: gradient } = around.judged(&solution)?;
    let seconds = clock.elapsed().as_secs_f64() - solved;
    let own = RunFolder::take(folder, "check-gradient", Earlier::Replaced)?;
    let bar = Progress::new(first.len() as u64, "check-gradient");
    let surface = around.flow.cloud.ground.surface;
    let mut differences = vec![];
    for k in 0..first.len() {
        interrupt::check()?;
        let step = match around.part(k).0 {
            Part::Angle => DEGREES,
            Part::Parameter(_) => 4e-3 * first[k].abs().max(1e-2),
            _ => STEP * surface,
        };
        let mut central = |step: f64| -> Result<f64, Error> {
            let mut at = |x: f64| {
                let mut moved = first.clone();
                moved[k] += x;
                let solution = around.solve(&moved)?;
                Ok::<f64, Error>(around.objective(&solution).0)
            };
            Ok((at(step)? - at(-step)?) / (2.0 * step))
        };
        // Richardson's extrapolation of two central differences.
        let (wide, narrow) = (central(step)?, central(0.5 * step)?);
        differences.push((4.0 * narrow - wide) / 3.0);
        bar.done(1);
    }
    bar.finish();
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let errors: Vec<f64> = gradient.iter().zip(&differences).map(|(g, d)| (g - d).abs() / norm).collect();
    let worst = errors.iter().copied().fold(0.0, f64::max);
    let passed = worst <= TOLERANCE;
    files::write_config(folder, loaded)?;
    let mut table = Table::new(["variable", "gradient", "differences", "difference / |gradient|"]);
    for (k, variable) in config.variables.iter().enumerate() {
        table.row([
            variable.number.clone(),
            format!("{:+.9e}", gradient[k]),
            format!("{:+.9e}", differences[k]),
            format!("{:.1e}", errors[k]),
        ]);
    }
    let report = json!({
        "passed": passed,
        "tolerance": TOLERANCE,
        "worst_relative_error": worst,
        "objective_kind": config.objective.kind,
        "objective": value,
        "gradient": gradient,
        "gradient_norm": norm,
        "differences": differences,
        "variables": config.variables.iter().map(|variable| &variable.number).collect::<Vec<_>>(),
        "solve_seconds": solved,
        "gradient_seconds": seconds,
    });
    write_json(&folder.join("gradient_check.json"), &report)?;
    page::write(folder)?;
    println!(
        "{} fixed particles, {} variables, {} {value:.9}, |gradient| = {norm:.4e}; flow in {solved:.2} s, gradient in {seconds:.2} s",
        around.flow.cloud.particles(),
        first.len(),
        of_objective(config)
    );
    println!("{}", table.to_text());
    println!("files in {}: gradient_check.json, report.html", folder.display());
    if !passed {
        return Err(Error::run(
            format!(
                "the gradient check FAILED: difference {worst:.1e} of the gradient's length, allowed {TOLERANCE:.0e}"
            ),
            finer(config),
        )
        .into());
    }
    println!("PASSED: difference {worst:.1e} of the gradient's length, allowed {TOLERANCE:.0e}");
    own.finish()
}
