//! `simulate` and `scenes check` of fixed particles in three dimensions, whose flow is steady.

use super::around_shapes::{imbalances, print_figures, print_particles, suggest_search, Figures};
use super::files;
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::{print_dimensionless, warn};
use super::{machine, page};
use crate::io::vtk::VtkSeries;
use crate::numerics::interrupt;
use crate::numerics::threads::{count, in_words};
use crate::report::memory::peak_memory_bytes;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_flow::Around;
use crate::scene::around_shapes::finer;
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
    // Sums over points are 13 to 35 % off where a surface around the shape is 1 to 2 % off, and do not say by how much it is.
    let mut found = imbalances(figures, |k| around.flow.measures.is_told_around(k), &finer(around.config()));
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
    suggest_search(loaded);
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
    let least = print_particles(loaded, &places.spacing, places.inside);
    match config.unsteady() {
        None => println!("method              fixed: a steady flow, no steps in time"),
        Some(_) => println!(
            "method              fixed: a flow in time to t = {}, whose steps are chosen on the way",
            config.time.end
        ),
    }
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

/// Largest relative difference of a steady flow's gradient and differences: what the iterations leave.
pub const TOLERANCE: f64 = 1e-5;
