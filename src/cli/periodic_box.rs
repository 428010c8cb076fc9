//! Commands for fixed particles in a periodic box without shapes.

use super::files::{self, write_json};
use super::machine;
use super::page;
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::print_dimensionless;
use crate::adjoint::check::check as compare;
use crate::error::Error;
use crate::io::csv::{write_table, Cell};
use crate::io::vtk::VtkSeries;
use crate::numerics::interrupt;
use crate::numerics::random::{stream, uniform};
use crate::numerics::threads::{count, in_words};
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::load::Loaded;
use crate::scene::periodic_box::{Moment, PeriodicBox};
use crate::scene::periodic_flow::Gradient;
use crate::scene::record::Record;
use crate::sph::lattice::equations::{Equations, State};
use crate::sph::lattice::march::{largest_step, repeat, Level};
use serde_json::json;
use std::path::Path;
use std::time::Instant;

/// Ticks of the progress bar.
const TICKS: f64 = 1000.0;

/// `hydrograd simulate`: the flow to `time.end`, its figures over time, and frames for ParaView.
pub fn simulate(loaded: &Loaded, folder: &Path, earlier: Earlier) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let own_box = PeriodicBox::new(config)?;
    let own = RunFolder::take(folder, "simulate", earlier)?;
    files::write_config(folder, loaded)?;
    let mut series = VtkSeries::new(&folder.join("particles"), "particles")?;
    let (end, frames) = (config.time.end, config.output.frames);
    let bar = Progress::new(TICKS as u64, "simulate");
    let (mut moments, mut next, mut step) = (vec![], 1, 0);
    let gone = own_box.run(frames, &mut |moment, state| {
        bar.set_position((TICKS * moment.time / end) as u64);
        step += 1;
        if frames > 0 && moment.time >= end * next as f64 / frames as f64 * (1.0 - 1e-12) {
            let written = own_box.particle_fields(moment.time, step, state).with_frame(|frame| series.write(frame));
            written.map_err(|error| Error::run(error.to_string(), "another --out".to_string()))?;
            next += 1;
        }
        moments.push(*moment);
        Ok(())
    })?;
    bar.finish();
    let seconds = clock.elapsed().as_secs_f64();
    let fields = own_box.particle_fields(end, gone.sizes.len(), &gone.last);
    fields.write(folder, config, &loaded.text)?;
    let has_grid = own_box.write_grid(folder, &fields)?;
    let heat = files::plot_flow_and_heat(folder, &[("end", &fields)], config.resolution.dx)?;
    moments.insert(0, own_box.moment(0.0, &gone.first));
    write_history(folder, &moments)?;
    let (velocity_error, temperature_error) = own_box.errors(&fields)?;
    let n = own_box.particles();
    let speed = |i: usize| fields.velocity.iter().skip(i).step_by(n).map(|u| u * u).sum::<f64>();
    let fastest = (0..n).map(speed).fold(0.0, f64::max).sqrt();
    let last = own_box.moment(end, &gone.last);
    let volume = config.region.size.iter().product::<f64>() * config.fluid.density;
    let mut record = Record::of_steady(loaded, fastest, seconds);
    record.put("particles", n);
    record.put("steps", gone.sizes.len());
    record.put("time", end);
    record.put("kinetic_energy", volume * last.kinetic_energy);
    record.put("dissipation", volume * last.dissipation);
    record.put("largest_velocity", fastest);
    if let Some(mean) = last.mean_temperature {
        record.put("mean_temperature", mean);
    }
    record.put("velocity_error", velocity_error);
    record.put("temperature_error", temperature_error);
    files::write_summary(folder, &record)?;
    let (least, most) = gone.sizes.iter().fold((f64::MAX, 0.0f64), |(a, b), x| (a.min(*x), b.max(*x)));
    println!(
        "{n} fixed particles, {} steps of {least:.2e} to {most:.2e} in {seconds:.2} s on {} ({:.2} ms a step)",
        gone.sizes.len(),
        in_words(count()),
        1e3 * seconds / gone.sizes.len() as f64
    );
    println!(
        "kinetic energy      {:.6e}, of {:.6e} at the start; dissipation {:.3e} per time",
        volume * last.kinetic_energy,
        volume * moments[0].kinetic_energy,
        volume * last.dissipation
    );
    for (name, error) in [("velocity", velocity_error), ("temperature", temperature_error)] {
        if let Some(error) = error {
            println!("{:<20}{error:.3e}, root mean square", format!("{name} error"));
        }
    }
    print_dimensionless(config, fastest);
    println!(
        "files in {}: report.html, summary.json, history.csv, flow.png{}, state.h5{}, particles/particles.pvd (ParaView)",
        folder.display(),
        if heat { ", temperature.png" } else { "" },
        if has_grid { ", grid.h5, grid.vti (ParaView)" } else { "" }
    );
    page::write(folder)?;
    own.finish()
}

fn write_history(folder: &Path, moments: &[Moment]) -> anyhow::Result<()> {
    let mut header = vec!["time", "kinetic_energy_per_mass", "dissipation_per_mass"];
    header.extend(moments[0].mean_temperature.map(|_| "mean_temperature"));
    let row = |moment: &Moment| -> Vec<Cell> {
        let all = [Some(moment.time), Some(moment.kinetic_energy), Some(moment.dissipation), moment.mean_temperature];
        all.into_iter().flatten().map(Cell::from).collect()
    };
    Ok(write_table(&folder.join("history.csv"), &header, &moments.iter().map(row).collect::<Vec<_>>())?)
}

/// `hydrograd scenes check`: particles, and what they cost.
pub fn check(loaded: &Loaded, folder: &Path) -> anyhow::Result<()> {
    let config = &loaded.config;
    let own_box = PeriodicBox::new(config)?;
    let _own = RunFolder::take(folder, "scenes check", Earlier::Replaced)?;
    let equations = &own_box.flow.equations;
    let (shape, end) = (&equations.transform.shape, config.time.end);
    let first = equations.state(&own_box.fields);
    let fields = own_box.particle_fields(0.0, 0, &first);
    let speed = Level::new(equations, first.clone()).speed.max(config.fluid.reference_velocity);
    let step = config.time.step.unwrap_or_else(|| largest_step(equations, speed)).min(end);
    let steps = (end / step).ceil().max(config.output.frames as f64);
    let clock = Instant::now();
    repeat(equations, first, &[step; TRIED]);
    let seconds = clock.elapsed().as_secs_f64() / TRIED as f64 * steps;
    let (label, values) = match &fields.temperature {
        Some(temperature) => (files::TEMPERATURE, temperature.clone()),
        None => (files::SPEED, files::speeds(&fields)),
    };
    files::plot_scene(folder, ("particles", label), &[("start", &fields)], &[values], config.resolution.dx)?;
    println!("{}: scene custom, {} dimensions, dx {}", loaded.source, shape.len(), config.resolution.dx);
    println!("particles           {} on a periodic lattice {shape:?}", own_box.particles());
    println!("method              fixed: a flow in time to t = {end}, whose steps are chosen on the way");
    println!("run time            {seconds:.2} s in about {steps} steps, which may be more for method.tolerance");
    println!("picture             {}", folder.join("particles.png").display());
    machine::answer(&json!({
        "scene": config.scene,
        "dimensions": shape.len(),
        "dx": config.resolution.dx,
        "particles": { "all": own_box.particles(), "kinds": { "fluid": own_box.particles() } },
        "expected_seconds": seconds,
        "warnings": [],
        "files": machine::paths_in(folder, ["particles.png", "particles.svg"]),
    }));
    Ok(())
}

/// Steps that the check of a scene takes.
const TRIED: usize = 3;

/// Largest error of a derivative along a direction, relative to the lengths of gradient and direction.
const TOLERANCE: f64 = 1e-7;
/// Steps of the differences, in parts of the largest number.
const STEPS: [f64; 5] = [1e-2, 1e-3, 1e-4, 1e-5, 1e-6];

/// `hydrograd check-gradient`: the derivative by the fields at the start, by viscosity and diffusivity, and by the acceleration, along
/// the steps of the run. What is differentiated is a mean over particles and fields f at the end, w (f + f^2 / 2) with random weights
/// 0 < w < 1: nothing that a flow depends on leaves it alone.
pub fn check_gradient(loaded: &Loaded, folder: &Path, directions: usize) -> anyhow::Result<()> {
    let config = &loaded.config;
    let own_box = PeriodicBox::new(config)?;
    let own = RunFolder::take(folder, "check-gradient", Earlier::Replaced)?;
    let clock = Instant::now();
    let gone = own_box.run(0, &mut |_, _| Ok(()))?;
    let (forward, clock) = (clock.elapsed().as_secs_f64(), Instant::now());
    let equations = &own_box.flow.equations;
    let n = own_box.particles();
    let mut random = stream(config.run.seed, "check");
    let weights: Vec<f64> = own_box.fields.iter().flatten().map(|_| uniform(&mut random) / n as f64).collect();
    let objective = |equations: &Equations, state: &State| -> f64 {
        let fields = equations.at_particles(state);
        fields.iter().flatten().zip(&weights).map(|(f, w)| w * (f + 0.5 * f * f)).sum()
    };
    let by_fields: Vec<Vec<f64>> = (equations.at_particles(&gone.last).iter().zip(weights.chunks_exact(n)))
        .map(|(field, weights)| field.iter().zip(weights).map(|(f, w)| w * (1.0 + f)).collect())
        .collect();
    let Gradient { fields, materials: of, .. } = own_box.flow.gradient(&gone, &by_fields)?;
    let backward = clock.elapsed().as_secs_f64();
    let value = objective(equations, &gone.last);
    let given = &equations.materials;
    let numbers: Vec<f64> = std::iter::once(given.viscosity).chain(given.diffusivity).collect();
    let by_numbers: Vec<f64> = [of.viscosity, of.diffusivity][..numbers.len()].to_vec();
    let groups = [
        ("fields at the start", own_box.fields.concat(), fields.concat()),
        ("viscosity, diffusivity", numbers.clone(), by_numbers),
        ("acceleration", given.force.clone(), of.force.clone()),
    ];
    let bar = Progress::new((groups.len() * directions * STEPS.len() * 2) as u64, "check-gradient");
    let mut table = Table::new(["by", "direction", "gradient", "differences", "step", "relative error"]);
    let (mut worst, mut rows) = (0.0f64, vec![]);
    for (k, (name, x, gradient)) in groups.iter().enumerate() {
        let scale = x.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let scale = if scale > 0.0 { scale } else { 1.0 };
        let directions: Vec<Vec<f64>> =
            (0..directions).map(|_| x.iter().map(|_| scale * (2.0 * uniform(&mut random) - 1.0)).collect()).collect();
        let found = compare(value, gradient, x, &directions, &STEPS, |moved| {
            interrupt::check()?;
            bar.done(1);
            let mut materials = given.clone();
            match k {
                0 => {}
                1 => {
                    materials.viscosity = moved[0];
                    materials.diffusivity = given.diffusivity.map(|_| moved[1]);
                }
                _ => materials.force.copy_from_slice(moved),
            }
            let fields: Vec<Vec<f64>> = match k {
                0 => moved.chunks_exact(n).map(<[f64]>::to_vec).collect(),
                _ => own_box.fields.clone(),
            };
            let other = Equations { materials, ..equations.clone() };
            Ok::<f64, Error>(objective(&other, &repeat(&other, other.state(&fields), &gone.sizes)))
        })?;
        for (number, direction) in found.iter().enumerate() {
            let Some(best) = direction.best() else { continue };
            worst = worst.max(if best.error.is_nan() { f64::INFINITY } else { best.error });
            table.row([
                name.to_string(),
                number.to_string(),
                format!("{:+.9e}", direction.gradient),
                format!("{:+.9e}", best.difference),
                format!("{:.0e}", best.step),
                format!("{:.1e}", best.error),
            ]);
            rows.push(json!({
                "by": name, "gradient": direction.gradient, "difference": best.difference, "relative_error": best.error,
            }));
        }
    }
    bar.finish();
    let passed = worst <= TOLERANCE;
    files::write_config(folder, loaded)?;
    let norm = fields.iter().flatten().map(|g| g * g).sum::<f64>().sqrt();
    let report = json!({
        "passed": passed,
        "tolerance": TOLERANCE,
        "worst_relative_error": worst,
        "objective_kind": "weighted mean of fields at the end",
        "objective": value,
        "gradient_norm": norm,
        "directions": rows,
        "steps": gone.sizes.len(),
        "solve_seconds": forward,
        "gradient_seconds": backward,
    });
    write_json(&folder.join("gradient_check.json"), &report)?;
    page::write(folder)?;
    println!(
        "{n} fixed particles, {} steps, weighted mean of fields at the end {value:.9}, |gradient| = {norm:.4e}; flow in \
         {forward:.3} s, gradient in {backward:.3} s",
        gone.sizes.len()
    );
    println!("{}", table.to_text());
    println!("files in {}: gradient_check.json, report.html", folder.display());
    if !passed {
        let problem = format!("the gradient check FAILED: relative error {worst:.1e}, allowed {TOLERANCE:.0e}");
        return Err(Error::run(problem, "a shorter time.end: nearby flows may drift apart".to_string()).into());
    }
    println!("PASSED: relative error {worst:.1e}, allowed {TOLERANCE:.0e}");
    own.finish()
}
