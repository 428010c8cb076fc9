//! Run time against error: scenes with a known answer over spacing, time step and precision.

use super::assembly::Numerics;
use super::poiseuille::Poiseuille;
use super::taylor_green::TaylorGreen;
use super::Scene;
use crate::adjoint::run::run;
use crate::adjoint::RunError;
use crate::config::scene::{Config, Kernels, Precision};
use crate::design::diagnostics::Measurement;
use crate::error::Error;
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use serde::Serialize;
use std::f64::consts::{LN_2, PI};
use std::time::Instant;

/// Outflowing heat of the heated channel with a flat wall, by finite elements (data/reference/README.md).
const HEATED_CHANNEL_Q: f64 = 0.0234764;
/// When the channel is steady.
const HEATED_CHANNEL_END: f64 = 2.5;
/// Of the viscous time height^2/nu: the centre line has 86 % of its final velocity.
const POISEUILLE_END: f64 = 0.2;

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AccuracyPoint {
    pub scene: &'static str,
    /// Particle spacing.
    pub dx: f64,
    /// The time step as an acoustic number, dt (c + U)/dx. Far below 1 where diffusion limits it (Poiseuille).
    pub cfl: f64,
    pub precision: Precision,
    pub particles: usize,
    pub steps: usize,
    pub time_step: f64,
    /// Wall time of the steps.
    pub seconds: f64,
    /// Flows: root mean square of the particles' velocity errors over the exact amplitude, at the time when the
    /// vortices have half of theirs, the channel at a fifth of its viscous time. Heated channel: |Q / Q_FEM - 1|.
    /// None if the run did not get to its end.
    pub error: Option<f64>,
    /// Whether it did, with an error below 1.
    pub stable: bool,
}

/// One run to do.
enum Run {
    TaylorGreen(TaylorGreen),
    Poiseuille(Poiseuille),
    HeatedChannel(Box<Config>),
}

/// Runs everything; `progress` is told the share done, by predicted work.
///
/// Taylor-Green 2D over particles per side and CFL, Poiseuille over rows and diffusion number, the heated channel over
/// spacing and CFL, each in f64 and f32. `quick`: coarse ones only.
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
    let mut runs = Vec::new();
    let sides: &[usize] = if quick { &[20, 32, 50] } else { &[20, 32, 50, 64, 100] };
    let courant: &[f64] = if quick { &[1.0] } else { &[0.25, 1.0, 2.0] };
    for &per_side in sides {
        for &cfl in courant {
            let mut scene = TaylorGreen { per_side, ..Default::default() };
            scene.numerics.cfl = cfl;
            runs.push(Run::TaylorGreen(scene));
        }
    }
    let rows: &[usize] = if quick { &[10, 20] } else { &[10, 20, 30, 40, 60] };
    let diffusion: &[f64] = if quick { &[0.25] } else { &[0.0625, 0.25] };
    for &rows in rows {
        for &diffusion_number in diffusion {
            let mut scene = Poiseuille { rows, ..Default::default() };
            scene.numerics.diffusion_number = diffusion_number;
            runs.push(Run::Poiseuille(scene));
        }
    }
    let spacings: &[f64] = if quick { &[0.02] } else { &[0.02, 0.01] };
    let courant: &[f64] = if quick { &[1.5] } else { &[0.25, 1.0, 1.5] };
    for dx in spacings {
        for cfl in courant {
            let sets =
                [format!("resolution.dx={dx}"), format!("time.cfl={cfl}"), format!("time.end={HEATED_CHANNEL_END}")];
            runs.push(Run::HeatedChannel(Box::new(Config::load(Some("heated-channel"), None, &sets)?.config)));
        }
    }
    Ok(runs)
}

impl TaylorGreen {
    /// When the exact amplitude of the plane vortices is half of what it was.
    pub fn half_life(&self) -> f64 {
        LN_2 * self.reynolds / (8.0 * PI * PI)
    }
}

/// Steps of at most `limit` that end exactly at `end`.
fn even_steps(end: f64, limit: f64) -> (usize, f64) {
    let steps = (end / limit - 1e-9).ceil().max(1.0);
    (steps as usize, end / steps)
}

impl Run {
    /// The scene; the flows' with a time step that divides the run.
    fn scene<R: Sweeps>(&self) -> Result<Scene<R>, Error> {
        Ok(match self {
            Self::TaylorGreen(scene) => {
                let (steps, dt) = even_steps(scene.half_life(), scene.time_step());
                let numerics = Numerics { time_step: Some(dt), steps, ..scene.numerics };
                TaylorGreen { numerics, ..*scene }.build()
            }
            Self::Poiseuille(scene) => {
                let (steps, dt) = even_steps(POISEUILLE_END * scene.reynolds, scene.time_step());
                let numerics = Numerics { time_step: Some(dt), steps, ..scene.numerics };
                Poiseuille { numerics, ..*scene }.build()
            }
            Self::HeatedChannel(config) => Scene::from_config(config)?,
        })
    }

    /// Particles times steps.
    fn work(&self) -> f64 {
        match self {
            Self::HeatedChannel(config) => (config.columns() * config.rows() * config.steps()) as f64,
            _ => self.scene::<f64>().map_or(0.0, |scene| (scene.model.particles() * scene.steps) as f64),
        }
    }

    fn point<R: Sweeps>(&self, precision: Precision) -> anyhow::Result<AccuracyPoint> {
        let scene = self.scene::<R>()?;
        let dt = scene.model.dt;
        let clock = Instant::now();
        let found = error(&scene);
        let seconds = clock.elapsed().as_secs_f64();
        let error = found.or_else(diverged)?;
        Ok(AccuracyPoint {
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

/// Runs a scene: the velocity error of a flow at its end, or the error of a channel's Q.
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

/// A run that diverged is a result; anything else that went wrong is not.
fn diverged(error: anyhow::Error) -> anyhow::Result<Option<f64>> {
    match error.downcast::<RunError>()? {
        error if error.is_divergence() => Ok(None),
        error => Err(error.into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_diverged_run_is_reported() {
        // Ten times beyond the limit of stability.
        let mut scene = TaylorGreen { per_side: 10, ..Default::default() };
        scene.numerics = Numerics { cfl: 20.0, diffusion_number: 100.0, ..scene.numerics };
        let point = Run::TaylorGreen(scene).point::<f64>(Precision::F64).unwrap();
        assert!(!point.stable, "{point:?}");
        assert!(serde_json::to_string(&point).unwrap().contains("\"stable\":false"));
        scene.numerics.cfl = 1.0;
        let stable = Run::TaylorGreen(scene).point::<f64>(Precision::F64).unwrap();
        assert!(stable.stable && stable.cfl <= 1.0 && stable.cfl > 0.98, "{stable:?}");
        assert!((stable.steps as f64 * stable.time_step - 0.8779).abs() < 1e-4);
    }

    #[test]
    fn error_of_the_heated_channel_is_that_of_q() {
        let sets = ["time.end=0.3".to_string(), "objective.window=0.05".into()];
        let config = Config::load(None, None, &sets).unwrap().config;
        let point = Run::HeatedChannel(Box::new(config)).point::<f32>(Precision::F32).unwrap();
        // Far from steady: the outflow has just begun to warm.
        assert!(point.stable && point.error.unwrap() > 0.1, "{point:?}");
        // Fluid and two rows of dummy particles in each wall; on the walls' surfaces vertices, hot points and such without a
        // heat flux.
        assert_eq!(point.particles, 50 * (10 + 4) + 100 + 26 + 24 + 50 + 50);
    }
}
