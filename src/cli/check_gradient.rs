//! `hydrograd check-gradient`: checks the design gradient against differences.

use super::arguments::{at_least_one, CommonArguments, GradientArguments};
use super::files::{self, write_json};
use super::page;
use super::periodic_box;
use super::prepare::{build, open_device, use_threads_of};
use super::ranks::check_design;
use super::run_folder::{Earlier, RunFolder};
use super::{around_bodies, around_shapes, ensemble_gradient};
use crate::adjoint::check::{check, cosine, Direction};
use crate::config::layers::Setting;
use crate::config::scene::{Config, GradientMode, Precision};
use crate::design::problem::Derivative;
use crate::design::Problem;
use crate::error::Error;
use crate::numerics::random::{stream, uniform};
use crate::numerics::ranks::Ranks;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::around_bodies::AroundBodies;
use crate::scene::around_shapes::AroundShapes;
use crate::scene::load::Loaded;
use crate::sph::Sweeps;
use clap::Args;
use serde_json::json;

/// Default number of differentiated steps.
const CHECK_STEPS: usize = 500;

/// Compare the design gradient with central differences; fails (exit code 1) if they disagree.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd check-gradient
      500 steps of the heated channel, objective at the last step
  hydrograd check-gradient --steps 100 --directions 5
      quicker, along five random directions
  hydrograd check-gradient --precision f32 --set design.shape=sine
      in single precision, at a sine-shaped wall
  hydrograd check-gradient --steps 500 --set objective.window=0.2
      with an objective averaged over a window
  hydrograd check-gradient data/scenes/examples/wake.toml --set optimise.gradient=ensemble
      of shapes among moving particles, over a long time: the mean over several starts, and its error")]
pub struct CheckGradientArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub gradient: GradientArguments,
    /// Steps to differentiate. The objective is then taken at the last step, unless
    /// `--set objective.window=...` says otherwise.
    #[arg(long, value_name = "N", default_value_t = CHECK_STEPS)]
    pub steps: usize,
    /// Random directions to compare along.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = at_least_one)]
    pub directions: usize,
}

impl CheckGradientArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        // Flows around shapes, steady or in time, and ensembles are looked at as they are: over their own time and window.
        let own = self.common.load(None, vec![], self.gradient.settings());
        // A periodic box is differentiated by its start.
        if own.as_ref().is_ok_and(|own| own.config.is_periodic_box()) {
            return own;
        }
        self.common.require_design()?;
        let is_whole =
            |own: &Loaded| own.config.is_around_shapes() || own.config.optimise.gradient == GradientMode::Ensemble;
        if own.as_ref().is_ok_and(is_whole) {
            return own;
        }
        // These defaults are below the user's settings, such as `--set objective.window=...`. The scene's window may be
        // longer than the checked steps.
        let defaults = vec![Setting::option("--steps", "time.steps", self.steps), Setting::set("objective.window=0")];
        self.common.load(None, defaults, self.gradient.settings())
    }
}

const KIND: &str = "check-gradient";
/// Largest error of a directional derivative, relative to the lengths of gradient and direction.
const TOLERANCE_F64: f64 = 1e-5;
/// The error of a steady state's derivative over the residual to which its adjoint equation is solved, at most.
const AMPLIFIED: f64 = 10.0;
/// The same in f32. Differences are still taken in f64, so this is the error of the f32 gradient.
const TOLERANCE_F32: f64 = 1e-3;
/// Growth of the derivative by the state that indicates chaos. Over 10,000 steps of a channel it stays below ten.
const EXPLODED: f64 = 1e3;
/// Steps of the differences, in offset units times a direction with components +-1.
const STEPS: [f64; 9] = [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11];

pub fn run(loaded: Loaded, arguments: CheckGradientArguments, ranks: &Ranks) -> anyhow::Result<()> {
    let folder = arguments.common.folder(None, KIND, &loaded)?;
    use_threads_of(ranks, loaded.config.run.threads);
    open_device(&loaded)?;
    if ranks.size() > 1 {
        check_design(&loaded)?;
    }
    if ranks.rank() > 0 {
        return follow(&loaded, ranks);
    }
    RunFolder::check(&folder, KIND, Earlier::Replaced)?;
    if loaded.config.is_around_bodies() {
        let mut around = AroundBodies::new(&loaded.config)?;
        return around_shapes::check_gradient(&loaded, &mut around, around_bodies::TOLERANCE, &folder);
    }
    if loaded.config.is_periodic_box() {
        return periodic_box::check_gradient(&loaded, &folder, arguments.directions);
    }
    if loaded.config.is_around_shapes() {
        let mut around = AroundShapes::new(&loaded.config)?;
        return around_shapes::check_gradient(&loaded, &mut around, around_shapes::TOLERANCE, &folder);
    }
    if loaded.config.optimise.gradient == GradientMode::Ensemble {
        return ensemble_gradient::show(&loaded, &folder, KIND);
    }
    // The adjoint is checked, whatever gradient an optimiser uses.
    let mut config = loaded.config.clone();
    if config.optimise.gradient.is_of_runs() {
        config.optimise.gradient = GradientMode::Segments;
    }
    let config = &config;
    let Derivative { by_variables, growth, clipped, residual, .. } = match config.run.precision {
        Precision::F32 => gradient::<f32>(config, ranks)?,
        Precision::F64 => gradient::<f64>(config, ranks)?,
    };
    let problem = shared::<f64>(config, ranks)?;
    let (first, figure) = (&problem.first, problem.figure);
    let gradient: Vec<f64> = by_variables.iter().map(|g| g * figure.factor).collect();
    let mut random = stream(config.run.seed, "check");
    let directions: Vec<Vec<f64>> =
        (0..arguments.directions).map(|_| first.iter().map(|_| 2.0 * uniform(&mut random) - 1.0).collect()).collect();
    let bar = Progress::new((directions.len() * STEPS.len() * 2 + 1) as u64, "check-gradient");
    let f = |x: &[f64]| {
        bar.done(1);
        let value = match problem.is_steady {
            true => problem.evaluate_steady(x, 1e-10)?,
            false => problem.evaluate(x)?,
        };
        Ok::<f64, anyhow::Error>(value * figure.factor)
    };
    let _own = RunFolder::take(&folder, KIND, Earlier::Replaced)?;
    let value = f(first).map_err(|e| Error::run(e.to_string(), "time.cfl=0.5"))?;
    let results = check(value, &gradient, first, &directions, &STEPS, f)
        .map_err(|e| Error::run(e.to_string(), "time.cfl=0.5, or a wall further from its limits"))?;
    bar.finish();
    problem.dismiss();

    let tolerance = match config.run.precision {
        Precision::F32 => TOLERANCE_F32,
        Precision::F64 => (AMPLIFIED * residual).clamp(TOLERANCE_F64, 1e-3),
    };
    let mut table = Table::new(["direction", "gradient", "differences", "step", "relative error", "Taylor order", ""]);
    let mut worst: f64 = 0.0;
    for (k, direction) in results.iter().enumerate() {
        let Some(best) = direction.best() else { continue };
        worst = worst.max(if best.error.is_nan() { f64::INFINITY } else { best.error });
        table.row([
            k.to_string(),
            format!("{:+.9e}", direction.gradient),
            format!("{:+.9e}", best.difference),
            format!("{:.0e}", best.step),
            format!("{:.1e}", best.error),
            format!("{:.2}", direction.order(value)),
            if best.error <= tolerance { "pass" } else { "FAIL" }.to_string(),
        ]);
    }
    let passed = worst <= tolerance;
    files::write_config(&folder, &loaded)?;
    let curve = |d: &Direction| d.points.iter().map(|p| (p.step, p.error.max(1e-16))).collect();
    let curves: Vec<(String, Vec<(f64, f64)>)> =
        results.iter().enumerate().map(|(k, d)| (format!("direction {k}"), curve(d))).collect();
    let (title, x) = ("Design gradient against central differences", "step of the differences (offset units)");
    compare(&folder.join("gradient_check"), title, x, "relative error", &curves, true, true)?;
    let norm = gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    let report = json!({
        "passed": passed,
        "tolerance": tolerance,
        "worst_relative_error": worst,
        "cosine": cosine(&results),
        (figure.symbol.to_lowercase()): value,
        "gradient": gradient,
        "gradient_norm": norm,
        "clipped": clipped,
        "growth": growth.iter().map(|(step, norm)| json!({ "step": step, "norm": norm })).collect::<Vec<_>>(),
        "steps": problem.steps,
        "precision": config.run.precision,
        "directions": results.iter().zip(&directions).map(|(r, d)| json!({
            "direction": d,
            "gradient": r.gradient,
            "taylor_order": r.order(value),
            "sweep": r.points.iter().map(|p| json!({
                "step": p.step, "difference": p.difference, "relative_error": p.error, "taylor_remainder": p.remainder,
            })).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
    });
    write_json(&folder.join("gradient_check.json"), &report)?;
    page::write(&folder)?;

    let (steps, variables, symbol) = (problem.steps, first.len(), figure.symbol);
    println!("{steps} steps, {variables} design variables, {symbol} = {value:.9}, |gradient| = {norm:.4e}");
    if let (Some((end, last)), Some((begin, first))) = (growth.first(), growth.last()) {
        println!("the derivative by the state: {last:.2e} at step {end}, {first:.2e} at step {begin}");
        if let Some((step, _)) = growth.iter().find(|(_, norm)| *norm > EXPLODED * last) {
            println!(
                "WARNING: from step {step} back it is {EXPLODED:.0e} times what it was at the end: it follows how particles happen to meet"
            );
        }
    }
    let (clip, places) = (config.optimise.clip, growth.len());
    if clip > 0.0 {
        println!("it was made shorter at {clipped} of {places} places (optimise.clip = {clip})");
    }
    println!("{}", table.to_text());
    println!("cosine between gradient and differences: {:.9}", cosine(&results));
    println!("every design variable received a finite, non-zero gradient");
    // In scene units values are of the order of 1.
    if norm < f64::EPSILON * value.abs().max(1.0) {
        println!("WARNING: it is {norm:.0e} of {value:.1e}: the design has hardly reached what is measured, and little is checked; more --steps");
    }
    println!("files in {}: gradient_check.json, gradient_check.png, report.html", folder.display());
    if !passed {
        let truncated = config.optimise.gradient == GradientMode::Truncated;
        let advice = if truncated {
            "--gradient segments: a truncated gradient is not exact, this is by how much"
        } else if clipped > 0 {
            "optimise.clip=0: a clipped gradient is not exact, this is by how much"
        } else if growth.first().is_some_and(|(_, last)| growth.iter().any(|(_, norm)| *norm > EXPLODED * last)) {
            "fewer --steps: nearby runs drift apart (rough walls, long runs), and differences lose their meaning first; see gradient_check.png"
        } else {
            "see gradient_check.png: the error of a right gradient falls with the square of the step, down to rounding; if it does not, \
             please report it"
        };
        return Err(Error::run(
            format!("the gradient check FAILED: relative error {worst:.1e}, allowed {tolerance:.0e}"),
            advice,
        )
        .into());
    }
    println!("PASSED: relative error {worst:.1e}, allowed {tolerance:.0e}");
    Ok(())
}

/// The design problem of a configuration.
fn shared<R: Sweeps>(config: &Config, ranks: &Ranks) -> anyhow::Result<Problem<R>> {
    Ok(build::<R>(config)?.0.shared(ranks)?)
}

/// The gradient of the objective without the roughness penalty, which is exact and would hide errors.
fn gradient<R: Sweeps>(config: &Config, ranks: &Ranks) -> anyhow::Result<Derivative> {
    let problem = shared::<R>(config, ranks)?;
    let schedule = problem.schedule(&config.optimise, config.run.precision)?;
    let found = problem.differentiate(&problem.first, &schedule, &mut |_| ());
    problem.dismiss();
    Ok(found?)
}

/// Another rank's part of the gradient and of the runs that check it.
fn follow(loaded: &Loaded, ranks: &Ranks) -> anyhow::Result<()> {
    match loaded.config.run.precision {
        Precision::F32 => shared::<f32>(&loaded.config, ranks)?.follow(),
        Precision::F64 => shared::<f64>(&loaded.config, ranks)?.follow(),
    }
    shared::<f64>(&loaded.config, ranks)?.follow();
    Ok(())
}
