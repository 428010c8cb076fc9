//! Calibration of viscosity and conductivity by an observed trajectory.
//!
//! The unknowns are logarithms of the parameters over their assumed values. The loss is that of [`super::matching`].
//! Its derivative by a parameter is the sum over the steps of
//!
//! ```text
//!   (cotangent of the state behind the step) . (derivative of the step by the parameter),
//! ```
//!
//! all at the same state. A step is a polynomial of first or second degree in viscosity and conductivity, so the
//! central difference of two steps with a slightly larger and smaller parameter is this derivative to rounding.

use super::matching::{Matching, Seen};
use crate::adjoint::gradient::{gradient, value_of_run, Progress};
use crate::adjoint::schedule::Schedule;
use crate::adjoint::RunError;
use crate::config::layers::Setting;
use crate::config::scene::{Config, Kernels, Start};
use crate::dataset::extent::Extent;
use crate::dataset::{Metadata, Trajectory};
use crate::error::{BadInput, Error};
use crate::numerics::candle::read;
use crate::particles::tag;
use crate::scene::load::Loaded;
use crate::scene::Scene;
use crate::sph::divergence::told;
use crate::sph::dynamics::{self, Sph};
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::{Model, Sweeps};
use candle_core::{CpuStorage, CustomOp1, Layout, Shape, Tensor};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

/// A parameter that can be found.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Parameter {
    Viscosity,
    Conductivity,
}

impl Parameter {
    pub fn key(self) -> &'static str {
        match self {
            Self::Viscosity => "fluid.viscosity",
            Self::Conductivity => "fluid.conductivity",
        }
    }

    pub fn of(self, config: &Config) -> f64 {
        match self {
            Self::Viscosity => config.fluid.viscosity,
            Self::Conductivity => config.fluid.conductivity,
        }
    }
}

/// Relative change of a parameter in its difference. As a step is a polynomial, it need not be small.
const MOVE: f64 = 1e-3;

/// An observed trajectory, its scene, and the parameters to be found.
pub struct Calibration<R> {
    loaded: Loaded,
    pub parameters: Vec<Parameter>,
    /// Initially assumed values.
    pub assumed: Vec<f64>,
    pub steps: usize,
    /// Time step of the trajectory, which does not depend on the parameters.
    time_step: f64,
    objective: Matching,
    schedule: Schedule,
    start: Snapshot<R>,
}

impl<R: Sweeps> Calibration<R> {
    /// `loaded` is the trajectory's scene with assumed parameters; `frames` of the trajectory are used.
    ///
    /// # Errors
    /// A trajectory that is not of the heated channel from rest, or has too few frames.
    pub fn new(
        loaded: Loaded,
        metadata: &Metadata,
        trajectory: &Trajectory,
        frames: usize,
        parameters: Vec<Parameter>,
    ) -> anyhow::Result<Self> {
        let config = &loaded.config;
        if !config.scene.has_design() || config.time.start != Start::Rest || !config.method.facts().moves {
            return Err(BadInput::new("a trajectory whose start depends on what is to be found")
                .place(format!("trajectory {}", trajectory.name))
                .allowed("one of the heated channel from rest, with particles that move")
                .advice("a data set made with time.start=rest")
                .into());
        }
        let number = |key: &str| metadata.other.get(key).and_then(serde_json::Value::as_f64);
        let (Some(dt), Some(every), Some(skip)) =
            (number("solver_dt"), number("solver_steps_per_frame"), number("skipped_steps"))
        else {
            return Err(BadInput::new("the data set does not say with which steps it was made")
                .place("metadata.json")
                .allowed("one made by `hydrograd generate`")
                .into());
        };
        if frames < 1 || frames > trajectory.frames {
            return Err(BadInput::new(format!("frames = {frames} of a trajectory of {}", trajectory.frames))
                .allowed(format!("1 ... {}", trajectory.frames))
                .into());
        }
        let skip = (skip * metadata.dt / dt).round() as usize;
        let step_of = |frame: usize| skip + frame * every as usize;
        let steps = step_of(frames - 1);
        let scene = scene_with::<R>(&loaded, dt, &[])?;
        let model = scene.model.clone();
        let (n, d) = (model.particles(), model.dimension());
        // The data have all particles except those on a wall's surface, in order, in their own coordinates.
        let kept: Vec<usize> = (0..n).filter(|&i| !tag::is_on_surface(model.tags[i])).collect();
        let origin = metadata.origin().filter(|origin| origin.len() == d && kept.len() == trajectory.particles);
        let Some(origin) = origin else {
            return Err(BadInput::new("the data set has other particles than its scene")
                .place(format!("trajectory {}", trajectory.name))
                .allowed("one made by this version of `hydrograd generate`")
                .into());
        };
        let reference = model.heat.as_ref().map_or(0.0, |heat| heat.reference);
        let extent = Extent::of(metadata);
        let mut seen = BTreeMap::new();
        for frame in 0..frames {
            let (places, mut position) = (trajectory.position_of(frame), vec![0.0; d * n]);
            let mut temperature = trajectory.temperature_of(frame).map(|_| vec![0.0; n]);
            for (k, &i) in kept.iter().enumerate() {
                for c in 0..d {
                    position[c * n + i] = extent.wrapped(c, f64::from(places[k * d + c])) + origin[c];
                }
                if let (Some(temperature), Some(row)) = (&mut temperature, trajectory.temperature_of(frame)) {
                    temperature[i] = f64::from(row[k]) - reference;
                }
            }
            seen.insert(step_of(frame), Seen { position, temperature, weight: 1.0 / frames as f64 });
        }
        let fluid = (0..n).map(|i| model.is_fluid(i)).collect();
        let warmth = (config.wall.hot_temperature - config.fluid.inlet_temperature).abs().max(1e-12);
        let objective = Matching { seen, domain: model.domain, fluid, length: config.resolution.dx, warmth };
        let dynamics = Sph::new(model, Kernels::Fused);
        let costs = dynamics.costs_from(&scene.start.state)?;
        let schedule = Schedule::affordable(steps, 0, costs, config.optimise.memory)?;
        let assumed = parameters.iter().map(|parameter| parameter.of(config)).collect();
        Ok(Self { parameters, assumed, steps, time_step: dt, objective, schedule, start: scene.start, loaded })
    }

    /// The parameters for given logarithms.
    pub fn values(&self, logarithms: &[f64]) -> Vec<f64> {
        self.assumed.iter().zip(logarithms).map(|(assumed, x)| assumed * x.exp()).collect()
    }

    fn model(&self, values: &[f64]) -> Result<Model<R>, Error> {
        let set = |(parameter, value): (&Parameter, &f64)| (parameter.key(), *value);
        let settings: Vec<(&str, f64)> = self.parameters.iter().zip(values).map(set).collect();
        Ok(scene_with::<R>(&self.loaded, self.time_step, &settings)?.model)
    }

    pub fn value(&self, logarithms: &[f64]) -> anyhow::Result<f64> {
        let dynamics = Sph::new(self.model(&self.values(logarithms))?, Kernels::Fused);
        value_of_run(&dynamics, &self.start, self.steps, &self.objective, &mut |_| ())
    }

    /// The loss and its derivative by the logarithms.
    pub fn evaluate(&self, logarithms: &[f64], progress: Progress<'_>) -> Result<(f64, Vec<f64>), Error> {
        let values = self.values(logarithms);
        let mut moved = Vec::new();
        for k in 0..values.len() {
            let with = |factor: f64| {
                let mut values = values.clone();
                values[k] *= factor;
                self.model(&values)
            };
            moved.push([with(1.0 + MOVE)?, with(1.0 - MOVE)?]);
        }
        let taps = Arc::new(Taps { moved, sums: Mutex::new(vec![0.0; values.len()]) });
        let mut dynamics = Sph::new(self.model(&values)?, Kernels::Fused);
        dynamics.tap = Some(tapped_by(taps.clone()));
        let found = gradient(&dynamics, &self.start, &self.schedule, &self.objective, progress);
        let found = found.map_err(|error| told(&error, &dynamics.model, &self.start))?;
        let sums = taps.sums.lock().unwrap_or_else(|e| e.into_inner()).clone();
        Ok((found.value, sums))
    }
}

/// The scene with other parameters and its previous time step.
fn scene_with<R: Sweeps>(loaded: &Loaded, dt: f64, settings: &[(&str, f64)]) -> Result<Scene<R>, Error> {
    let settings: Vec<Setting> =
        settings.iter().map(|(key, value)| Setting::option("calibration", key, format!("{value:?}"))).collect();
    let mut scene = Scene::<R>::from_config(&loaded.with(&settings)?.config)?;
    // Its design holds a model with other parameters.
    scene.design = None;
    scene.model = scene.model.with(|flow| flow.dt = dt);
    Ok(scene)
}

/// Models with each parameter slightly larger and smaller, and the derivatives by the parameters.
struct Taps<R> {
    moved: Vec<[Model<R>; 2]>,
    sums: Mutex<Vec<f64>>,
}

/// An identity at the end of a step, whose adjoint adds the step's contribution to the derivatives by the parameters.
struct Tap<R> {
    taps: Arc<Taps<R>>,
    /// The state before the step.
    before: Snapshot<R>,
}

impl<R: Sweeps> Tap<R> {
    fn after(&self, model: &Model<R>) -> candle_core::Result<Vec<R>> {
        let go = || -> Result<Vec<R>, RunError> {
            let mut solver = Solver::restore(model.clone(), &self.before)?;
            solver.advance()?;
            Ok(solver.state)
        };
        go().map_err(|error| candle_core::Error::Msg(error.to_string()))
    }
}

impl<R: Sweeps> CustomOp1 for Tap<R> {
    fn name(&self) -> &'static str {
        "parameters"
    }
    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> candle_core::Result<(CpuStorage, Shape)> {
        let Some((from, to)) = layout.contiguous_offsets() else { candle_core::bail!("a state is contiguous") };
        let copy = match storage {
            CpuStorage::F32(values) => CpuStorage::F32(values[from..to].to_vec()),
            CpuStorage::F64(values) => CpuStorage::F64(values[from..to].to_vec()),
            _ => candle_core::bail!("a state is in f32 or f64"),
        };
        Ok((copy, layout.shape().clone()))
    }
    fn bwd(&self, _: &Tensor, _: &Tensor, bar: &Tensor) -> candle_core::Result<Option<Tensor>> {
        for (k, [up, down]) in self.taps.moved.iter().enumerate() {
            let (up, down) = (self.after(up)?, self.after(down)?);
            let mut sum = 0.0;
            read(&bar.contiguous()?, |bar: &[R]| {
                for (bar, (up, down)) in bar.iter().zip(up.iter().zip(&down)) {
                    sum += bar.f64() * (up.f64() - down.f64());
                }
                Ok(())
            })?;
            // d/d(logarithm) = parameter d/d(parameter), and the difference is 2 MOVE of the parameter.
            self.taps.sums.lock().unwrap_or_else(|e| e.into_inner())[k] += sum / (2.0 * MOVE);
        }
        Ok(Some(bar.clone()))
    }
}

/// Puts a tap at the end of each step.
fn tapped_by<R: Sweeps>(taps: Arc<Taps<R>>) -> Arc<dynamics::Tap<R>> {
    Arc::new(move |tape, state, next| {
        // The neighbour list of the step may be an older one.
        let before = Snapshot {
            step: tape.step - 1,
            parts: 1,
            least_parts: 1,
            state: state.detach().flatten_all()?.to_vec1()?,
            reference: tape.neighbourhood.reference.clone(),
        };
        next.contiguous()?.apply_op1(Tap { taps: taps.clone(), before })
    })
}
