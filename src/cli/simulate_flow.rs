//! `hydrograd simulate` of a verification flow: one run forward, against the exact solution where there is one.

use super::files::{self, Fields, VERSION};
use super::simulate::{check_unfinished, earlier_history, read_checkpoint, write_checkpoint, CHECKPOINTS, HISTORY};
use crate::adjoint::Dynamics;
use crate::adjoint::RunError;
use crate::error::Error;
use crate::io::atomic::prepare_output_folder;
use crate::io::vtk::VtkSeries;
use crate::report::memory::peak_memory_bytes;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::scene::figures::FlowFigures;
use crate::scene::load::Loaded;
use crate::scene::{Exact, Scene};
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use serde_json::{json, Map, Value};
use std::path::Path;

/// Points of the exact profile's curve.
const PROFILE: usize = 100;

pub fn run<R: Sweeps>(loaded: &Loaded, folder: &Path, resume: Option<&Path>) -> anyhow::Result<()> {
    let config = &loaded.config;
    let flow = Scene::<R>::from_config(config)?;
    let (model, steps) = (flow.model.clone(), flow.steps);
    let (n, dt) = (model.particles(), model.dt);
    let first = match resume {
        Some(from) => read_checkpoint::<R>(&from.join("checkpoint.safetensors"), config, &model)?,
        None => flow.start.clone(),
    };
    let resumed = first.step;
    check_unfinished(resumed, steps)?;
    prepare_output_folder(folder)?;
    files::write_config(folder, loaded)?;
    let bar = Progress::new(steps as u64, "simulate");
    let part = if resumed > 0 { format!("particles-from-{resumed}") } else { "particles".to_string() };
    let mut series = match config.output.frames {
        0 => None,
        _ => Some(VtkSeries::new(&folder.join(&part), "particles")?),
    };
    let frame_every = if config.output.frames == 0 { usize::MAX } else { steps.div_ceil(config.output.frames) };
    let (history_every, checkpoint_every) = (steps.div_ceil(HISTORY), steps.div_ceil(CHECKPOINTS));
    let columns = columns(&flow.exact);
    let mut history = resume.map_or(Vec::new(), |from| earlier_history(from, columns, resumed as f64 * dt));

    let clock = std::time::Instant::now();
    let dynamics = Sph::new(model.clone(), config.run.kernels);
    let mut solver = dynamics.start(&first).map_err(failed)?;
    loop {
        let step = solver.step;
        if step % 64 == 0 || step == steps {
            solver.check_finite().map_err(failed)?;
        }
        if let Some(series) = &mut series {
            if step % frame_every == 0 || step == steps {
                Fields::of(&mut solver).with_frame(|frame| series.write(frame))?;
            }
        }
        if step % history_every == 0 || step == steps {
            let found = flow.figures(&solver.state, step as f64 * dt);
            history.push(row(&found));
            files::write_numbers(&folder.join("history.csv"), columns, &history)?;
            bar.set_position(step as u64);
            bar.message(format!("kinetic energy {:.5}", found.kinetic_energy));
        }
        if step > resumed && (step % checkpoint_every == 0 || step == steps) {
            write_checkpoint(&folder.join("checkpoint.safetensors"), &solver, loaded)?;
        }
        if step == steps {
            break;
        }
        dynamics.advance(&mut solver).map_err(failed)?;
    }
    let seconds = clock.elapsed().as_secs_f64();
    bar.finish();
    let fields = Fields::of(&mut solver);
    fields.write(folder, loaded)?;
    let found = flow.figures(&solver.state, steps as f64 * dt);
    plot_energy(folder, &history)?;
    let profile = flow.exact.profile_height();
    if let Some(height) = profile {
        plot_profile(folder, &flow, &fields, height)?;
    }
    let profile = profile.is_some();
    files::write_summary(folder, summary(loaded, &found, n, steps, seconds))?;

    let done = steps - resumed;
    println!(
        "{n} particles, {done} steps of {dt:.3e} in {seconds:.2} s ({:.0} ns per particle and step)",
        1e9 * seconds / (done * n) as f64
    );
    println!("time                {:.6}", found.time);
    println!(
        "kinetic energy      {:.6}{}",
        found.kinetic_energy,
        against(found.kinetic_energy, found.exact_kinetic_energy)
    );
    println!("fastest particle    {:.6}", found.largest_velocity);
    match found.velocity_error {
        Some(error) => println!(
            "velocity error      {error:.6}   root mean square over the particles, over {}",
            if profile { "the steady centre line" } else { "the exact amplitude" }
        ),
        None => println!("velocity error      unknown: this flow has no closed form"),
    }
    println!(
        "files in {}: summary.json, history.csv, kinetic_energy.png{}, state.h5{}",
        folder.display(),
        if profile { ", profile.png" } else { "" },
        if config.output.frames > 0 { format!(", {part}/particles.pvd (ParaView)") } else { String::new() }
    );
    println!("next: --set resolution.dx={:?}    the same at half the spacing", 0.5 * config.resolution.dx);
    Ok(())
}

fn failed(error: RunError) -> anyhow::Error {
    let advice = "a smaller time step: --set time.cfl=0.5, or --set time.diffusion_number=0.125";
    Error::run(error.to_string(), advice).into()
}

fn columns(exact: &Exact) -> &'static [&'static str] {
    match exact {
        Exact::Unknown => &["time", "kinetic_energy", "largest_velocity"],
        _ => &["time", "kinetic_energy", "largest_velocity", "exact_kinetic_energy", "velocity_error"],
    }
}

/// As [`columns`].
fn row(found: &FlowFigures) -> Vec<f64> {
    let known = [found.exact_kinetic_energy, found.velocity_error];
    [found.time, found.kinetic_energy, found.largest_velocity].into_iter().chain(known.into_iter().flatten()).collect()
}

fn against(value: f64, exact: Option<f64>) -> String {
    exact.map_or(String::new(), |exact| format!("   exact {exact:.6} ({:+.2} %)", 100.0 * (value / exact - 1.0)))
}

/// `kinetic_energy.png` and `.svg`.
fn plot_energy(folder: &Path, history: &[Vec<f64>]) -> anyhow::Result<()> {
    let curve = |column: usize| history.iter().map(|row| (row[0], row[column])).collect::<Vec<_>>();
    let mut curves = vec![("simulated".to_string(), curve(1))];
    if history.iter().all(|row| row.len() > 3) {
        curves.push(("exact".to_string(), curve(3)));
    }
    compare(&folder.join("kinetic_energy"), "Kinetic energy", "time", "kinetic energy", &curves, false, false)?;
    Ok(())
}

/// `profile.png` and `.svg`: the velocity along the channel over the height.
fn plot_profile<R: Sweeps>(folder: &Path, flow: &Scene<R>, fields: &Fields, highest: f64) -> anyhow::Result<()> {
    let n = flow.model.particles();
    let fluid = (0..n).filter(|&i| flow.model.is_fluid(i));
    let mut simulated: Vec<(f64, f64)> = fluid.map(|i| (fields.position[n + i], fields.velocity[i])).collect();
    simulated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let height = |k: usize| highest * k as f64 / PROFILE as f64;
    let exact = (0..=PROFILE)
        .filter_map(|k| Some((height(k), flow.exact.velocity([0.0, height(k), 0.0], fields.time)?[0])))
        .collect();
    let title = format!("Velocity profile at t = {:.4}", fields.time);
    let curves = [("simulated".to_string(), simulated), ("exact".to_string(), exact)];
    compare(&folder.join("profile"), &title, "y", "velocity along x", &curves, false, false)?;
    Ok(())
}

fn summary(loaded: &Loaded, found: &FlowFigures, particles: usize, steps: usize, seconds: f64) -> Map<String, Value> {
    let Value::Object(map) = json!({
        "scene": loaded.config.scene,
        "particles": particles,
        "steps": steps,
        "time_step": loaded.config.time_step(),
        "time": found.time,
        "kinetic_energy": found.kinetic_energy,
        "exact_kinetic_energy": found.exact_kinetic_energy,
        "largest_velocity": found.largest_velocity,
        "velocity_error": found.velocity_error,
        "wall_seconds": seconds,
        "peak_memory_bytes": peak_memory_bytes(),
        "version": VERSION,
        "seed": loaded.config.run.seed,
        "precision": loaded.config.run.precision,
    }) else {
        unreachable!("a JSON object")
    };
    map
}
