//! The report of `hydrograd simulate` on a finished run: plots, `summary.json`, text.

use super::files;
use super::guard;
use crate::config::scene::{Config, Family, ObjectiveKind};
use crate::design::diagnostics::Diagnostics;
use crate::design::objectives::Figure;
use crate::design::Problem;
use crate::report::plots::compare;
use crate::scene::figures::FlowFigures;
use crate::scene::load::Loaded;
use crate::scene::particle_fields::ParticleFields;
use crate::scene::plausible::Findings;
use crate::scene::record::{Record, Recovery};
use crate::scene::tank::pressure_error;
use crate::scene::warnings::{self, Warning};
use crate::scene::{Exact, Scene};
use crate::sph::division::Divided;
use crate::sph::spread::Shares;
use crate::sph::Sweeps;
use std::path::Path;

/// Number of points in the curve of the exact profile.
const PROFILE: usize = 100;

pub struct Finished<'a, R> {
    pub loaded: &'a Loaded,
    pub folder: &'a Path,
    pub scene: &'a Scene<R>,
    pub history: &'a [Vec<f64>],
    pub end: &'a ParticleFields,
    pub seconds: f64,
    pub divided: Divided,
    pub recovered: &'a [Recovery],
    /// How several ranks shared the run.
    pub shares: Option<&'a Shares>,
    /// Mean heat of each shape; empty where none is known.
    pub shape_heat: Vec<f64>,
    /// Text about ParaView frames.
    pub pictures: String,
}

pub fn report_design<R: Sweeps>(
    finished: &Finished<R>,
    design: &Problem<R>,
    d: &Diagnostics,
    start: &ParticleFields,
) -> anyhow::Result<()> {
    let Finished { loaded, folder, history, .. } = finished;
    plot_outflow(folder, history)?;
    let panels = [("start", start), ("end", finished.end)];
    files::plot_temperature(folder, &loaded.config, &panels)?;
    files::plot_flow(folder, &loaded.config, &panels)?;
    let mut record = Record::of_design(loaded, d, finished.scene.steps, finished.seconds);
    if let Some(across) = design.parametrisation.across() {
        // For a wall over x and z these are its control points.
        record.put("nodes", design.parametrisation.positions());
        record.put("nodes_z", across);
        record.put("offsets", &design.first);
    } else {
        let wall = design.first_wall();
        record.put("nodes", wall.nodes);
        record.put("offsets", wall.offsets);
        if let Some(top) = wall.top {
            record.put("top_offsets", top);
        }
    }
    let mut warnings = finished.warnings()?;
    warnings.extend(warnings::of_measured(&loaded.config, d));
    record.put_warnings(loaded, warnings);
    record.put("recovered", finished.recovered);
    if let Some(shares) = finished.shares {
        record.put("ranks", shares);
    }
    files::write_summary(folder, &record)?;
    let is_deep = loaded.config.dimension() == 3;
    print_measured(&loaded.config, d);
    print_dimensionless(&loaded.config, d.u_max);
    println!(
        "files in {}: report.html, summary.json, temperature.png, flow.png, history.csv, history.png, state.h5{}{}",
        folder.display(),
        if is_deep { ", wall.png, wall.vtp" } else { "" },
        finished.pictures
    );
    let scene = if is_deep { format!(" {}", loaded.config.scene.name()) } else { String::new() };
    println!("next: hydrograd optimize{scene}    shapes the wall so that Q grows");
    warn(&record.warnings());
    Ok(())
}

impl<R: Sweeps> Finished<'_, R> {
    /// The sum of the heat of those shapes that the objective names, or of all.
    fn objective_of_shapes(&self) -> Option<f64> {
        let objective = &self.loaded.config.objective;
        let is_wanted = objective.kind == ObjectiveKind::ShapeHeat && !self.shape_heat.is_empty();
        let heat = self.shape_heat.iter().enumerate();
        let of = heat.filter(|(k, _)| objective.shapes.is_empty() || objective.shapes.contains(k));
        is_wanted.then(|| of.map(|(_, heat)| heat).sum()).filter(|heat: &f64| heat.is_finite())
    }

    /// The warnings of the scene, and of its particles at the end.
    fn warnings(&self) -> anyhow::Result<Vec<Warning>> {
        let config = &self.loaded.config;
        let mut all = Findings::of(config, self.scene)?.warnings;
        all.extend(warnings::of_particles(config, self.end));
        Ok(all)
    }
}

/// Prints the measurements of a flow that have a meaning in its scene.
fn print_measured(config: &Config, d: &Diagnostics) {
    let per_depth = if config.dimension() == 3 { ", per depth" } else { "" };
    if config.flows_through() && config.has_heat() {
        println!(
            "Q                   {:.6}   outflowing heat, rho u (T - T_in) integrated over the outlet{per_depth}",
            d.q
        );
    }
    if config.has_heat() {
        let (flux, stored) = (d.wall_heat_flux, d.stored_heat_rate);
        let balance = match config.heat_passes() {
            true => format!(", imbalance {:+.2} %", 100.0 * d.energy_imbalance),
            false => String::new(),
        };
        println!("wall heat flux      {flux:.6}   stored {stored:+.6}{balance}");
    }
    if config.flows_through() {
        let depth = if config.dimension() == 3 { "per depth; " } else { "" };
        println!("flow rate           {:.6}   {depth}fastest particle along x {:.4}", d.flow_rate, d.u_max);
        println!("body force          {:.6}   pumping power {:.6}", d.body_force, d.pumping_power);
        if config.has_heat() {
            println!(
                "outlet temperature  {:.6}   mixed; mean of all fluid {:.6}",
                d.mean_outlet_temperature, d.mean_temperature
            );
        }
    } else if config.has_heat() {
        println!("mean temperature    {:.6}", d.mean_temperature);
    }
    println!("mean density        {:.6}", d.mean_density);
    if config.scene == Family::Custom && config.flows_through() && config.objective.kind != ObjectiveKind::ShapeHeat {
        let Figure { symbol, quantity, .. } = Figure::of_config(config);
        println!("objective           {:.6}   {symbol}, {quantity}, mean of its samples", d.objective(config));
    }
}

pub fn report_flow<R: Sweeps>(
    finished: &Finished<R>,
    found: &FlowFigures,
    measured: Option<&Diagnostics>,
) -> anyhow::Result<()> {
    let Finished { loaded, folder, scene, .. } = finished;
    let rests = found.wall_flux.is_some();
    if !rests {
        plot_energy(folder, finished.history)?;
    }
    let profile = scene.exact.profile_height();
    if let Some(height) = profile {
        plot_profile(folder, scene, finished.end, height)?;
    }
    let mut pictures = String::new();
    if loaded.config.scene == Family::Custom {
        let title = format!("t = {:.4}", finished.end.time);
        pictures.push_str(", flow.png");
        if files::plot_flow_and_heat(folder, &[(&title, finished.end)], scene.spacing)? {
            pictures.push_str(", temperature.png");
        }
    }
    let mut warnings = finished.warnings()?;
    warnings.extend(warnings::of_flow(&loaded.config, found, finished.history));
    warnings.extend(measured.into_iter().flat_map(|measured| warnings::of_section(&loaded.config, measured)));
    let mut record = Record::of_flow(loaded, scene, found, measured, finished.divided, finished.seconds);
    let pressure_error = pressure_error(&loaded.config, finished.end);
    if let Some(error) = pressure_error {
        record.put("pressure_error", error);
    }
    if !finished.shape_heat.is_empty() {
        record.put("heat_of_shapes", &finished.shape_heat);
    }
    let objective = finished.objective_of_shapes();
    if let Some(objective) = objective {
        record.put("objective_kind", loaded.config.objective.recorded_kind());
        record.put("objective", objective);
    }
    record.put_warnings(loaded, warnings);
    record.put("recovered", finished.recovered);
    if let Some(shares) = finished.shares {
        record.put("ranks", shares);
    }
    files::write_summary(folder, &record)?;
    println!("time                {:.6}", found.time);
    if !rests {
        let energy = found.kinetic_energy;
        println!("kinetic energy      {energy:.6}{}", against(energy, found.exact_kinetic_energy));
        println!("fastest particle    {:.6}", found.largest_velocity);
    }
    if let Some(measured) = measured {
        print_measured(&loaded.config, measured);
    }
    for (k, heat) in
        finished.shape_heat.iter().enumerate().filter(|(k, _)| loaded.config.shapes[*k].temperature.is_some())
    {
        match heat.is_finite() {
            true => println!(
                "heat of shapes[{k}]   {heat:.6}   given to the fluid through its surface, mean of the samples"
            ),
            false => println!(
                "heat of shapes[{k}]   unknown: a `where` has no outline, and the standard method tells that of plane walls only"
            ),
        }
    }
    if let Some(objective) = objective {
        println!("objective           {objective:.6}   {}", Figure::of_config(&loaded.config).quantity);
    }
    if let Some(error) = found.velocity_error {
        let over = format!(", over {}", scene.exact.amplitude_name());
        println!("velocity error      {}", mean_error(error, &over));
    } else if !rests {
        println!("velocity error      unknown: this flow has no closed form");
    }
    if let Some(error) = pressure_error {
        println!("pressure error      {}", mean_error(error, ", over the exact pressure at the bottom"));
    }
    if let Some(error) = found.temperature_error {
        let over = if rests { ", over the walls' difference" } else { "" };
        println!("temperature error   {}", mean_error(error, over));
    }
    if let (Some(flux), Some(exact)) = (found.wall_flux, found.exact_wall_flux) {
        for (wall, flux, exact) in [("lower", flux[0], exact[0]), ("upper", flux[1], exact[1])] {
            println!("flux, {wall} wall    {flux:.6}{}", against(flux, Some(exact)));
        }
    }
    if let Some(nusselt) = found.nusselt {
        println!("Nusselt number      {nusselt:.4}{}", against(nusselt, found.exact_nusselt));
    } else if let Some(exact) = found.exact_nusselt {
        println!(
            "Nusselt number      exact {exact:.4}, not measured: the warm walls end before the profile is developed \
             (a larger channel.length)"
        );
    }
    print_dimensionless(&loaded.config, found.largest_velocity);
    println!(
        "files in {}: report.html, summary.json, history.csv{}{pictures}{}, state.h5{}",
        folder.display(),
        if rests { "" } else { ", kinetic_energy.png" },
        if profile.is_some() { ", profile.png" } else { "" },
        finished.pictures
    );
    println!("next: --set resolution.dx={:?}    the same at half the spacing", 0.5 * loaded.config.resolution.dx);
    warn(&record.warnings());
    Ok(())
}

/// Prints the dimensionless numbers, and what they take.
pub fn print_dimensionless(config: &Config, fastest: f64) {
    let all = config.dimensionless(fastest);
    let value = |x: f64| if x < 0.1 { format!("{x:.2e}") } else { format!("{x:.4}") };
    let mut text = String::new();
    for (k, one) in all.iter().enumerate() {
        text.push_str(&format!("{}{} {}", if k > 0 { ", " } else { "" }, one.name, value(one.value)));
        let next = all.get(k + 1).map(|next| (next.length, next.speed));
        // Numbers that take the same length and speed share the remark.
        let parts = [one.length, one.speed].into_iter().flatten().map(|it| format!("{} {}", it.of, value(it.value)));
        let remark = parts.collect::<Vec<_>>().join(", ");
        if !remark.is_empty() && next != Some((one.length, one.speed)) {
            text.push_str(&format!(" ({remark})"));
        }
    }
    if !all.is_empty() {
        println!("dimensionless       {text}");
    }
}

/// Prints warnings to stderr at the end, apart from the figures.
pub fn warn(warnings: &[Warning]) {
    for Warning { problem, advice, .. } in warnings {
        guard::warn(problem, advice);
    }
}

/// An error with its significant digits.
fn mean_error(error: f64, over: &str) -> String {
    let digits = if error < 1e-4 { format!("{error:.2e}") } else { format!("{error:.6}") };
    format!("{digits}   root mean square over the particles{over}")
}

fn against(value: f64, exact: Option<f64>) -> String {
    match exact {
        None => String::new(),
        // There is no relative error of zero.
        Some(exact) if exact.abs() < f64::MIN_POSITIVE => format!("   exact {exact:.6}"),
        Some(exact) => format!("   exact {exact:.6} ({:+.2} %)", 100.0 * (value / exact - 1.0)),
    }
}

/// Plots `history.png` and `.svg`.
fn plot_outflow(folder: &Path, history: &[Vec<f64>]) -> anyhow::Result<()> {
    let curve = |column: usize, factor: f64| history.iter().map(|row| (row[0], factor * row[column])).collect();
    let curves = [("Q".to_string(), curve(1, 1.0)), ("flow rate / 10".to_string(), curve(2, 0.1))];
    let (title, y) = ("Outflowing heat and flow rate", "Q, flow rate / 10 (scene units)");
    compare(&folder.join("history"), title, "time (scene units)", y, &curves, false, false)?;
    Ok(())
}

/// Plots `kinetic_energy.png` and `.svg`.
fn plot_energy(folder: &Path, history: &[Vec<f64>]) -> anyhow::Result<()> {
    let curve = |column: usize| history.iter().map(|row| (row[0], row[column])).collect::<Vec<_>>();
    let mut curves = vec![("simulated".to_string(), curve(1))];
    if history.iter().all(|row| row.len() > 4) {
        curves.push(("exact".to_string(), curve(3)));
    }
    let (x, y) = ("time (scene units)", "kinetic energy (scene units)");
    compare(&folder.join("kinetic_energy"), "Kinetic energy", x, y, &curves, false, false)?;
    Ok(())
}

/// Plots `profile.png` and `.svg`: velocity along the channel, or temperature in a scene at rest, over the height.
fn plot_profile<R: Sweeps>(folder: &Path, flow: &Scene<R>, fields: &ParticleFields, top: f64) -> anyhow::Result<()> {
    let n = flow.model.particles();
    let temperature = fields.temperature.as_ref().filter(|_| matches!(flow.exact, Exact::Slab(_)));
    let (what, unit) = match temperature {
        Some(_) => ("Temperature profile", "temperature (scene units)"),
        None => ("Velocity profile", "velocity along x (scene units)"),
    };
    let value = |i: usize| temperature.map_or(fields.velocity[i], |temperature| temperature[i]);
    let fluid = (0..n).filter(|&i| flow.model.is_fluid(i));
    let mut simulated: Vec<(f64, f64)> = fluid.map(|i| (fields.position[n + i], value(i))).collect();
    simulated.sort_by(|a, b| a.0.total_cmp(&b.0));
    let height = |k: usize| top * k as f64 / PROFILE as f64;
    let known = |y: f64| match temperature {
        Some(_) => flow.exact.temperature([0.0, y, 0.0], fields.time),
        None => flow.exact.velocity([0.0, y, 0.0], fields.time).map(|u| u[0]),
    };
    let exact = (0..=PROFILE).filter_map(|k| Some((height(k), known(height(k))?))).collect();
    let title = format!("{what} at t = {:.4}", fields.time);
    let curves = [("simulated".to_string(), simulated), ("exact".to_string(), exact)];
    compare(&folder.join("profile"), &title, "y (scene units)", unit, &curves, false, false)?;
    Ok(())
}
