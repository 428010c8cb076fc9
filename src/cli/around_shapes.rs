//! `simulate` and `check-gradient` of fixed particles around shapes, whose flow is steady.

use super::files::{self, write_json};
use super::run_folder::{Earlier, RunFolder};
use super::simulate_report::{print_dimensionless, warn};
use super::{figure_errors, machine, page};
use crate::config::custom::Part;
use crate::config::scene::{Config, Goal, ObjectiveKind};
use crate::design::objectives::Figure;
use crate::error::Error;
use crate::io::vtk::VtkSeries;
use crate::numerics::interrupt;
use crate::numerics::threads::{count, in_words};
use crate::report::memory::peak_memory_bytes;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::around_flow::{Around, Flowed};
use crate::scene::around_shapes::{finer, AroundShapes, Judged};
use crate::scene::load::Loaded;
use crate::scene::record::Record;
use crate::scene::solution_error::SolutionErrors;
use crate::scene::warnings::Warning;
use crate::sph::cloud::problem::Solution;
use serde_json::{json, Value};
use std::f64::consts::PI;
use std::path::Path;
use std::time::Instant;

/// Surface and balance may differ by this before there is a warning.
const IMBALANCE: f64 = 0.05;

/// More of the flow than this must not be left of continuity.
const REST: f64 = 0.03;

/// A passage between bodies and walls that is narrower than this many spacings is warned of.
const NARROW: f64 = 4.0;

/// A step of the temperature where walls meet that is larger, as a share of the range of given temperatures, is warned of.
const TEMPERATURE_STEP: f64 = 0.1;

/// Numbers of a solution that a table shows.
fn number(figures: &Figures, name: &str) -> Option<f64> {
    figures.iter().find(|(other, _)| *other == name).and_then(|(_, value)| value.as_f64())
}

/// Figures by name, see [`AroundShapes::summary`].
pub type Figures = [(&'static str, Value)];

/// Warnings about shapes whose surface does not agree with the balance, but for those of which that tells nothing: in the plane those that have
/// corners, where a surface always misses something, in space those with a closed surface around them.
pub fn imbalances(figures: &Figures, tells_nothing: impl Fn(usize) -> bool, advice: &str) -> Vec<Warning> {
    let shapes = figures.iter().find(|(name, _)| *name == "shapes").and_then(|(_, shapes)| shapes.as_array().cloned());
    let mut found = vec![];
    for (k, shape) in shapes.into_iter().flatten().enumerate().filter(|(k, _)| !tells_nothing(*k)) {
        for (name, by_surface) in [("force", "force_by_surface"), ("heat", "heat_by_surface")] {
            let of = |key: &str| match &shape[key] {
                Value::Array(parts) => parts.iter().filter_map(Value::as_f64).map(|x| x * x).sum::<f64>().sqrt(),
                value => value.as_f64().unwrap_or(f64::NAN),
            };
            let (balanced, own) = (of(name), of(by_surface));
            let off = (own / balanced - 1.0).abs();
            if off > IMBALANCE {
                let problem = format!(
                    "the {name} of shapes[{k}] by its own surface and by the balance of the flow differ by {:.1} %: \
                     it is not resolved",
                    100.0 * off
                );
                found.push(Warning::new("imbalance", [off, IMBALANCE], problem, advice));
            }
        }
    }
    found
}

/// Warnings about a solution and its figures: a surface that does not agree with the balance, a rest of continuity, and
/// narrow passages.
fn warnings_of(around: &AroundShapes, solution: &Solution, figures: &Figures) -> Vec<Warning> {
    let mut found = imbalances(figures, |k| around.flow.measures.has_corners(k), &around.finer_advice());
    let area = around.flow.measures.area(&around.flow.at(solution));
    // What goes round in a cavity counts as well.
    let narrowest = around.config().region.size.iter().fold(f64::MAX, |a, &b| a.min(b));
    let through = number(figures, "flow_rate").unwrap_or(0.0).abs().max(0.02 * around.fastest(solution) * narrowest);
    let rest = (solution.state.lambda * area / through).abs();
    if rest > REST {
        found.push(Warning::new(
            "volume",
            [rest, REST],
            format!("{:.1} % of the flow enters or leaves that the sides of the box do not account for", 100.0 * rest),
            format!("an outflow in region.sides, or {}", around.finer_advice()),
        ));
    }
    let steps = match around.config().initial.temperature {
        Some(_) => around.flow.cloud.temperature_steps(&around.flow.at(solution).shaped.conditions),
        None => vec![],
    };
    for (shape, step) in steps.into_iter().filter(|(_, step)| *step > TEMPERATURE_STEP) {
        let problem = format!(
            "shapes[{shape}] meets a wall of another temperature: the heat that passes between them grows without limit as \
             the spacing becomes finer, and the heat of the shape with it"
        );
        let advice = "the same temperature where they meet; the heat outflow has a limit";
        found.push(Warning::new("temperature-step", [step, TEMPERATURE_STEP], problem, advice));
    }
    let dx = around.flow.cloud.ground.dx;
    let narrowest = around.of_shapes(ObjectiveKind::Distance, &[], &around.first()).map(|judged| judged.value / dx);
    if let Some(narrowest) = narrowest.filter(|passage| *passage < NARROW) {
        found.push(Warning::new(
            "narrow",
            [narrowest, NARROW],
            format!(
                "the narrowest passage is {narrowest:.1} spacings wide: at 2.5 spacings the flow rate was 1.7 % off"
            ),
            format!("resolution.dx={:.2e}", dx * narrowest / NARROW),
        ));
    }
    found
}

/// What the objective is, in words.
pub fn of_objective(config: &Config) -> &'static str {
    match config.objective.terms.is_empty() {
        true => Figure::of_config(config).quantity,
        false => "sum of objective.terms",
    }
}

/// Prints the figures of a solution.
pub fn print_figures(config: &Config, figures: &Figures) {
    let has_heat = config.initial.temperature.is_some();
    for (name, label) in [
        ("flow_rate", "flow rate"),
        ("pressure_drop", "pressure drop"),
        ("dissipation", "dissipation"),
        ("body_force", "body force"),
        ("heat_outflow", "heat outflow"),
    ] {
        if let Some(value) = number(figures, name) {
            let mut about = vec![];
            if name == "heat_outflow" {
                about.push(format!("through x = {}", config.objective.target_x.min(config.region.size[0])));
            }
            // Of moving particles these are per depth.
            if config.dimension() == 3 && matches!(name, "flow_rate" | "heat_outflow") {
                about.push("of the whole section".to_string());
            }
            println!("{}", format!("{label:<20}{value:.6}   {}", about.join(", ")).trim_end());
        }
    }
    let mut header = vec!["shape", "drag", "lift", "torque"];
    if has_heat {
        header.extend(["heat", "heat by surface"]);
    }
    header.push("drag by surface");
    let mut table = Table::new(header);
    let shapes = figures.iter().find(|(name, _)| *name == "shapes").and_then(|(_, shapes)| shapes.as_array());
    for (k, shape) in shapes.into_iter().flatten().enumerate() {
        let of = |value: &Value| value.as_f64().map_or(String::new(), |x| format!("{x:.6}"));
        if shape["force"].is_null() {
            continue;
        }
        let mut row =
            vec![format!("shapes[{k}]"), of(&shape["force"][0]), of(&shape["force"][1]), of(&shape["torque"])];
        if has_heat {
            row.extend([of(&shape["heat"]), of(&shape["heat_by_surface"])]);
        }
        row.push(of(&shape["force_by_surface"][0]));
        table.row(row);
    }
    if shapes.is_some_and(|shapes| !shapes.is_empty()) {
        println!("{}", table.to_text());
    }
    if let Some(objective) = number(figures, "objective") {
        println!("objective           {objective:.6}   {}", of_objective(config));
    }
}

/// `hydrograd simulate`: the steady flow, with figures, their errors if these are asked for, pictures and a frame for ParaView.
pub fn simulate(loaded: &Loaded, folder: &Path, earlier: Earlier, asks_errors: bool) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let mut around = AroundShapes::new(config)?;
    let solution = around.solve(&around.first())?;
    let seconds = clock.elapsed().as_secs_f64();
    interrupt::check()?;
    let own = RunFolder::take(folder, "simulate", earlier)?;
    files::write_config(folder, loaded)?;
    let end = around.fields(&solution);
    end.write(folder, &loaded.config, &loaded.text)?;
    around.write_grid(folder, &solution, 0.0)?;
    let map = around.map(&solution);
    let heat = files::plot_maps(folder, &[("steady", &map)], false)?;
    let figures = around.summary(&solution);
    let mut record = record(loaded, &around, &solution, &figures, seconds);
    let errors = if asks_errors { Some(errors(&mut record, &mut around, &solution)?) } else { None };
    let mut more: Vec<(&str, &[f64])> = vec![];
    if let Some(SolutionErrors { figures, density }) = &errors {
        if let Some(first) = figures.first() {
            files::plot_error(folder, &first.name, &map, density)?;
            more.push(("error", density));
        }
    }
    let mut series = VtkSeries::new(&folder.join("particles"), "particles")?;
    end.with_frame_and(&more, |frame| series.write(frame))?;
    put_growth(&mut record, loaded, &mut around, &solution)?;
    files::write_summary(folder, &record)?;
    let counts = around.flow.solver.counts;
    println!(
        "{} fixed particles, steady after {} steps of Newton's method in {seconds:.2} s on {}",
        around.flow.cloud.particles(),
        counts.steps,
        in_words(count())
    );
    print_figures(config, &figures);
    print_dimensionless(config, around.fastest(&solution));
    println!(
        "files in {}: report.html, summary.json, flow.png{}{}, state.h5, particles/particles.pvd (ParaView)",
        folder.display(),
        if heat { ", temperature.png" } else { "" },
        if more.is_empty() { "" } else { ", error.png (where the error comes from)" }
    );
    suggest_search(loaded);
    warn(&record.warnings());
    if let Some(SolutionErrors { figures, .. }) = &errors {
        figure_errors::tell(figures);
    }
    page::write(folder)?;
    own.finish()
}

/// The errors of a solution's figures, which are added to its record.
fn errors(record: &mut Record, around: &mut AroundShapes, solution: &Solution) -> Result<SolutionErrors, Error> {
    let clock = Instant::now();
    let found = around.errors(solution, record)?;
    figure_errors::put(record, &found.figures);
    record.put("error_seconds", clock.elapsed().as_secs_f64());
    Ok(found)
}

/// Prints how many particles of given spacings there are, `inside` of them in the fluid. Returns the least spacing.
pub fn print_particles(loaded: &Loaded, spacing: &[f64], inside: usize) -> f64 {
    let config = &loaded.config;
    let least = spacing.iter().copied().fold(f64::INFINITY, f64::min);
    println!(
        "{}: scene {}, {} dimensions, dx {}",
        loaded.source,
        config.scene.name(),
        config.dimension(),
        config.resolution.dx
    );
    println!(
        "particles           {} in all: {inside} fluid, {} on walls; spacing {least:.2e} at least",
        spacing.len(),
        spacing.len() - inside
    );
    least
}

/// Says how a scene with variables goes on.
pub fn suggest_search(loaded: &Loaded) {
    if !loaded.config.variables.is_empty() {
        println!(
            "next: hydrograd optimize {}    changes its variables so that the objective becomes {}",
            loaded.source.argument(),
            goal(&loaded.config)
        );
    }
}

/// `hydrograd scenes check`: particles and what they cost, and what looks implausible.
pub fn check(loaded: &Loaded, folder: &Path) -> anyhow::Result<()> {
    let config = &loaded.config;
    let clock = Instant::now();
    let mut around = AroundShapes::new(config)?;
    let placed = clock.elapsed().as_secs_f64();
    if config.unsteady().is_some() {
        let places = &around.flow.cloud.places;
        print_particles(loaded, &places.spacing, places.inside);
        println!(
            "method              fixed: a flow in time to t = {}, whose steps are chosen on the way",
            config.time.end
        );
        println!("placing             {placed:.2} s; a step is not tried here");
        return Ok(());
    }
    let solution = around.solve(&around.first())?;
    let seconds = clock.elapsed().as_secs_f64();
    let _own = RunFolder::take(folder, "scenes check", Earlier::Replaced)?;
    let fields = around.fields(&solution);
    let (label, values) = match &fields.temperature {
        Some(temperature) => (files::TEMPERATURE, temperature.clone()),
        None => (files::SPEED, files::speeds(&fields)),
    };
    files::plot_scene(folder, ("particles", label), &[("steady", &fields)], &[values], config.resolution.dx)?;
    let places = &around.flow.cloud.places;
    let on_walls = places.boundary.len();
    let least = print_particles(loaded, &places.spacing, places.inside);
    println!("method              fixed: a steady flow, no steps in time");
    println!("run time            {seconds:.2} s, of which {placed:.2} s place the particles");
    println!(
        "memory              {:.0} MB at the peak, {:.0} MB of factors",
        peak_memory_bytes() as f64 / 1e6,
        around.flow.solver.counts.bytes as f64 / 1e6
    );
    println!("picture             {}", folder.join("particles.png").display());
    let mut warnings = warnings_of(&around, &solution, &around.summary(&solution));
    warnings.iter_mut().for_each(|warning| warning.advice = loaded.possible(&warning.advice));
    machine::answer(&json!({
        "scene": config.scene,
        "dimensions": 2,
        "dx": config.resolution.dx,
        "particles": { "all": places.place.len(), "kinds": { "fluid": places.inside, "on walls": on_walls } },
        "least_spacing": least,
        "peak_memory_bytes": peak_memory_bytes(),
        "expected_seconds": seconds,
        "warnings": warnings,
        "files": machine::paths_in(folder, ["particles.png", "particles.svg"]),
    }));
    match warnings.len() {
        0 => println!("\nnothing looks implausible"),
        count => println!("\n{count} to look at:"),
    }
    warnings.iter().for_each(|one| println!("  - {}; try {}", one.problem, one.advice));
    Ok(())
}

/// What the objective is to become.
pub fn goal(config: &Config) -> &'static str {
    match config.objective.goal {
        Goal::Larger => "larger",
        Goal::Smaller => "smaller",
    }
}

/// Says whether a real flow would leave this steady state.
fn put_growth(
    record: &mut Record,
    loaded: &Loaded,
    around: &mut AroundShapes,
    solution: &Solution,
) -> Result<(), Error> {
    let fastest = around.fastest(solution);
    let Some((growth, frequency)) = around.growth(solution, fastest)? else { return Ok(()) };
    record.put("growth_rate", growth);
    record.put("growth_frequency", frequency / (2.0 * PI));
    if growth > 0.0 {
        let mut warnings = record.warnings();
        let problem = format!(
            "the flow is steady but unstable: disturbances grow at a rate of {growth:.2e}; a real flow would oscillate, \
             with a frequency of about {:.2e}",
            frequency / (2.0 * PI)
        );
        let advice = format!("fluid.viscosity={}, or a smaller body", 2.0 * loaded.config.fluid.viscosity);
        warnings.push(Warning::new("unstable", [growth, 0.0], problem, advice));
        record.put_warnings(loaded, warnings);
    }
    Ok(())
}

/// The summary of a steady flow.
pub fn record(loaded: &Loaded, around: &AroundShapes, solution: &Solution, figures: &Figures, seconds: f64) -> Record {
    let mut record = Record::of_steady(loaded, around.fastest(solution), seconds);
    for (name, value) in figures {
        record.put(name, value);
    }
    record.put_warnings(loaded, warnings_of(around, solution, figures));
    record
}

/// Largest relative difference of gradient and differences.
pub const TOLERANCE: f64 = 1e-6;
/// Steps of differences: in spacings of the surface, and in degrees.
const STEP: f64 = 0.04;
const DEGREES: f64 = 0.05;
/// How often a step is halved, at most. (Below, rounding and what iterations leave would be seen.)
const HALVINGS: i32 = 5;
/// In radians, at the end of a flow in time.
const PHASE: f64 = 0.02;

/// An objective with its gradient, to be compared with differences.
pub struct Checked {
    pub objective: Judged,
    pub particles: usize,
    /// Spacing on surfaces.
    pub surface: f64,
    pub solve_seconds: f64,
    pub gradient_seconds: f64,
    /// Largest difference, in the gradient's length.
    pub tolerance: f64,
}

impl Checked {
    /// Compares with differences of `value`, a function of the variables, prints both and writes them into a folder.
    pub fn compare(
        self,
        loaded: &Loaded,
        folder: &Path,
        first: &[f64],
        value: &mut dyn FnMut(&[f64]) -> Result<f64, Error>,
    ) -> anyhow::Result<()> {
        let config = &loaded.config;
        let Self { objective, particles, surface, solve_seconds, gradient_seconds, tolerance } = self;
        let Judged { value: found, by_variables: gradient } = objective;
        let own = RunFolder::take(folder, "check-gradient", Earlier::Replaced)?;
        let bar = Progress::new(first.len() as u64, "check-gradient");
        let numbers = config.shape_numbers();
        let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
        let mut differences = vec![];
        for k in 0..first.len() {
            interrupt::check()?;
            let step = match numbers[k].part {
                Part::Angle => DEGREES,
                Part::Parameter(_) => 4e-3 * first[k].abs().max(1e-2),
                _ => STEP * surface,
            };
            // Differences of flows in time are not as smooth, and a parameter may be a frequency, which moves phases by so much times the
            // time.
            let step = match (config.unsteady(), numbers[k].part) {
                (None, _) => step,
                (Some(_), Part::Parameter(_)) => (0.25 * step).min(PHASE / config.time.end),
                (Some(_), _) => 0.25 * step,
            };
            let mut central = |step: f64| -> Result<f64, Error> {
                let mut at = |x: f64| {
                    let mut moved = first.to_vec();
                    moved[k] += x;
                    value(&moved)
                };
                Ok((at(step)? - at(-step)?) / (2.0 * step))
            };
            // Richardson's extrapolation of two central differences. Its error is about the square of what it adds, in parts of the gradient:
            // where that is too much the objective bends within the step, which is halved.
            let (mut wide, mut narrow) = (central(step)?, central(0.5 * step)?);
            for halvings in 2..=HALVINGS {
                if narrow == wide || ((narrow - wide) / (3.0 * norm)).powi(2) < 0.1 * tolerance {
                    break;
                }
                (wide, narrow) = (narrow, central(step * 0.5f64.powi(halvings))?);
            }
            differences.push((4.0 * narrow - wide) / 3.0);
            bar.done(1);
        }
        bar.finish();
        if norm == 0.0 && differences.iter().all(|&x| x == 0.0) {
            let problem =
                format!("the objective ({}, {found:.9}) depends on none of the variables", of_objective(config));
            return Err(Error::run(
                problem,
                "another objective.kind, or something that moves the fluid past the shapes",
            )
            .into());
        }
        let errors: Vec<f64> = gradient.iter().zip(&differences).map(|(g, d)| (g - d).abs() / norm).collect();
        let worst = errors.iter().copied().fold(0.0, f64::max);
        let passed = worst <= tolerance;
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
            "tolerance": tolerance,
            "worst_relative_error": worst,
            "objective_kind": config.objective.recorded_kind(),
            "objective": found,
            "gradient": gradient,
            "gradient_norm": norm,
            "differences": differences,
            "variables": config.variables.iter().map(|variable| &variable.number).collect::<Vec<_>>(),
            "solve_seconds": solve_seconds,
            "gradient_seconds": gradient_seconds,
        });
        write_json(&folder.join("gradient_check.json"), &report)?;
        page::write(folder)?;
        println!(
            "{particles} fixed particles, {} variables, {} {found:.9}, |gradient| = {norm:.4e}; flow in {solve_seconds:.2} s, gradient in {gradient_seconds:.2} s",
            first.len(),
            of_objective(config)
        );
        println!("{}", table.to_text());
        println!("files in {}: gradient_check.json, report.html", folder.display());
        if !passed {
            let problem = format!(
                "the gradient check FAILED: difference {worst:.1e} of the gradient's length, allowed {tolerance:.0e}"
            );
            return Err(Error::run(problem, finer(config)).into());
        }
        println!("PASSED: difference {worst:.1e} of the gradient's length, allowed {tolerance:.0e}");
        own.finish()
    }
}

/// `hydrograd check-gradient`: value and gradient of the objective by every variable, and differences beside it. `steady`: the tolerance
/// of a steady flow.
pub fn check_gradient(loaded: &Loaded, around: &mut impl Around, steady: f64, folder: &Path) -> anyhow::Result<()> {
    let clock = Instant::now();
    let first = around.first();
    let flow = around.flow(&first, None, &mut |_| ())?;
    let solve_seconds = clock.elapsed().as_secs_f64();
    let objective = around.judged(&flow, &first)?;
    // Steps of a flow in time are chosen once, for all that it is compared with.
    let (sizes, tolerance) = match flow {
        Flowed::Steady(_) => (None, steady),
        Flowed::InTime(history) => (Some(history.sizes), TOLERANCE),
    };
    let checked = Checked {
        objective,
        particles: around.particles(),
        surface: around.surface(),
        solve_seconds,
        gradient_seconds: clock.elapsed().as_secs_f64() - solve_seconds,
        tolerance,
    };
    checked.compare(loaded, folder, &first, &mut |moved| {
        let flow = around.flow(moved, sizes.as_deref(), &mut |_| ())?;
        around.objective_of(&flow, moved)
    })
}
