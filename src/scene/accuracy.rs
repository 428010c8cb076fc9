//! Measures run time against error: scenes with a known solution, over spacing, time step and precision.

use super::Scene;
use crate::adjoint::run::run;
use crate::adjoint::RunError;
use crate::config::scene::{Config, Family, Kernels, Precision};
use crate::design::diagnostics::Measurement;
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use serde::Serialize;
use std::f64::consts::{LN_2, PI};
use std::time::Instant;

/// Outflowing heat of the heated channel with a flat wall by finite elements (data/reference/README.md).
const HEATED_CHANNEL_Q: f64 = 0.0234715;
/// The time at which the channel is steady.
const HEATED_CHANNEL_END: f64 = 2.5;
/// End time over the viscous time height^2/nu. The centre line then has 86 % of its final velocity.
const POISEUILLE_END: f64 = 0.2;

/// The result of one run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AccuracyPoint {
    /// Name of the program and the method.
    pub code: String,
    pub scene: &'static str,
    pub dx: f64,
    /// The time step as an acoustic number, dt (c + U)/dx. It is far below 1 where diffusion limits it (Poiseuille).
    pub cfl: f64,
    pub precision: Precision,
    pub particles: usize,
    pub steps: usize,
    pub time_step: f64,
    /// Wall-clock time of the steps.
    pub seconds: f64,
    /// The error; none if the run did not reach its end. For flows it is the root mean square of the particles'
    /// velocity errors over the exact amplitude, for the vortices at their half-life, for the channel at a fifth of its
    /// viscous time. For the heated channel it is |Q / Q_FEM - 1|.
    pub error: Option<f64>,
    /// Whether the run reached its end with an error below 1.
    pub stable: bool,
}

/// A run to be done.
pub struct Run {
    /// Name of the program and the method.
    pub code: String,
    pub config: Config,
}

/// Runs all cases. `progress` is called with the completed fraction of the predicted work.
///
/// Taylor-Green 2D over particles per side and CFL, Poiseuille over rows and diffusion number, the heated channel over
/// spacing and CFL, each with every method that can solve it, in f64 and f32. With `quick` only coarse ones run.
pub fn points(quick: bool, progress: &mut dyn FnMut(f64)) -> anyhow::Result<Vec<AccuracyPoint>> {
    let runs = runs(quick)?;
    let total: f64 = runs.iter().map(|run| 2.0 * run.work()).sum();
    let mut done = 0.0;
    let mut points = Vec::new();
    for run in &runs {
        for precision in [Precision::F64, Precision::F32] {
            points.push(match precision {
                Precision::F64 => run.point::<f64>(precision)?,
                Precision::F32 => run.point::<f32>(precision)?,
            });
            done += run.work();
            progress(done / total);
        }
    }
    Ok(points)
}

fn runs(quick: bool) -> anyhow::Result<Vec<Run>> {
    let one_over = |counts: &[f64]| counts.iter().map(|count| 1.0 / count).collect::<Vec<f64>>();
    let vortices = one_over(if quick { &[20.0, 32.0, 50.0] } else { &[20.0, 32.0, 50.0, 64.0, 100.0] });
    let poiseuille = one_over(if quick { &[10.0, 20.0] } else { &[10.0, 20.0, 30.0, 40.0, 60.0] });
    let channel = if quick { vec![0.02] } else { vec![0.02, 0.01] };
    let vortices_end = half_life(Family::TaylorGreen.defaults().flow.reynolds);
    let poiseuille_end = POISEUILLE_END * Family::Poiseuille.defaults().flow.reynolds;
    // Scene, method, spacings, the key of the time step, its value in a quick measurement and all values, and the end.
    let cases: [(_, _, _, _, f64, &[f64], _); 7] = [
        ("taylor-green", "consistent", &vortices, "cfl", 1.0, &[0.25, 1.0], vortices_end),
        ("taylor-green", "standard", &vortices, "cfl", 1.0, &[0.25, 1.0, 2.0], vortices_end),
        ("poiseuille", "consistent", &poiseuille, "diffusion_number", 0.25, &[0.0625, 0.25], poiseuille_end),
        ("poiseuille", "standard", &poiseuille, "diffusion_number", 0.25, &[0.0625, 0.25], poiseuille_end),
        ("heated-channel", "consistent", &channel, "cfl", 1.5, &[0.25, 1.0, 1.5], HEATED_CHANNEL_END),
        ("heated-channel", "fixed", &channel, "cfl", 1.2, &[0.6, 1.2], HEATED_CHANNEL_END),
        ("heated-channel", "standard", &channel, "cfl", 2.0, &[0.5, 1.0, 2.0], HEATED_CHANNEL_END),
    ];
    let mut runs = Vec::new();
    for (scene, method, spacings, key, usual, all, end) in cases {
        let values = if quick { &[usual] } else { all };
        for (dx, value) in spacings.iter().flat_map(|dx| values.iter().map(move |value| (dx, value))) {
            let sets = [
                format!("method.name={method}"),
                format!("resolution.dx={dx}"),
                format!("time.{key}={value}"),
                format!("time.end={end}"),
            ];
            let config = Config::load(Some(scene), None, &sets)?.config;
            runs.push(Run { code: format!("hydrograd, {method}"), config });
        }
    }
    Ok(runs)
}

/// The time at which the exact amplitude of the plane vortices is half the initial one.
pub fn half_life(reynolds: f64) -> f64 {
    LN_2 * reynolds / (8.0 * PI * PI)
}

impl Run {
    /// Estimated work: particles times steps.
    fn work(&self) -> f64 {
        let config = &self.config;
        let particles = match config.scene.has_design() {
            true => (config.columns() * config.rows() * config.layers()) as f64,
            false => config.resolution.dx.powi(-(config.dimension() as i32)),
        };
        particles * config.steps() as f64
    }

    /// Runs it and measures time and error.
    ///
    /// # Errors
    /// Bad input; not a run that diverges.
    pub fn point<R: Sweeps>(&self, precision: Precision) -> anyhow::Result<AccuracyPoint> {
        let scene = Scene::<R>::from_config(&self.config)?;
        let dt = scene.model.dt;
        let clock = Instant::now();
        let found = error(&scene);
        let seconds = clock.elapsed().as_secs_f64();
        let error = found.or_else(diverged)?;
        Ok(AccuracyPoint {
            code: self.code.clone(),
            scene: scene.name,
            dx: scene.spacing,
            cfl: dt * (scene.sound_speed() + scene.reference_velocity) / scene.spacing,
            precision,
            particles: scene.model.particles(),
            steps: scene.steps,
            time_step: dt,
            seconds,
            error,
            stable: error.is_some_and(|error| error < 1.0),
        })
    }
}

/// Runs a scene and returns the velocity error of a flow at its end, or the error of a channel's Q.
fn error<R: Sweeps>(scene: &Scene<R>) -> anyhow::Result<Option<f64>> {
    let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
    match &scene.design {
        Some(design) => {
            let mut measured = Measurement::of(design);
            run(&dynamics, &scene.start, scene.steps, &mut [&mut measured])?;
            Ok(Some((measured.diagnostics().q / HEATED_CHANNEL_Q - 1.0).abs()))
        }
        None => {
            let end = run(&dynamics, &scene.start, scene.steps, &mut [])?;
            Ok(scene.figures(&end.state, scene.steps as f64 * scene.model.dt).velocity_error)
        }
    }
}

/// Divergence is a result of a run; other errors are returned.
fn diverged(error: anyhow::Error) -> anyhow::Result<Option<f64>> {
    match error.downcast::<RunError>()? {
        error if error.is_divergence() => Ok(None),
        error => Err(error.into()),
    }
}
