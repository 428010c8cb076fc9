//! Which velocities a flow began with, from where its particles were n steps later.
//!
//! Unknown are the fluid's velocities at the start, `[D, N_fluid]`; places at the start are known. The loss is the mean over
//! particles of |x - x*|^2 at the end, in spacings. (JAX-SPH's notebook on inverse problems does the same with places.)

use super::matching::{Matching, Seen};
use crate::adjoint::gradient::{gradient, Progress};
use crate::adjoint::run::run;
use crate::adjoint::schedule::Schedule;
use crate::config::scene::{Config, Kernels};
use crate::error::{BadInput, Error};
use crate::scene::Scene;
use crate::sph::dynamics::Sph;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::Sweeps;
use std::collections::BTreeMap;

pub struct InitialVelocity<R> {
    pub scene: Scene<R>,
    dynamics: Sph<R>,
    /// Fluid particles.
    fluid: Vec<usize>,
    matching: Matching,
    schedule: Schedule,
}

impl<R: Sweeps> InitialVelocity<R> {
    /// For places `[D, N]` at the end of a scene's run; none: where the scene's own run ends.
    ///
    /// # Errors
    /// Particles whose velocities stand elsewhere, a target of another size, a budget that is too small.
    pub fn new(config: &Config, target: Option<Vec<f64>>) -> anyhow::Result<Self> {
        let scene = Scene::<R>::from_config(config)?;
        let model = scene.model.clone();
        let (n, l) = (model.particles(), model.layout);
        if model.fixed.is_some() {
            return Err(BadInput::new("fluid.motion = fixed: the velocities of particles that do not move")
                .key("fluid.motion")
                .allowed("moving: places at the end say nothing of fixed particles")
                .into());
        }
        let dynamics = Sph::new(model.clone(), Kernels::Fused);
        let position = match target {
            Some(position) if position.len() == l.dimension * n => position,
            Some(position) => {
                let problem = format!("the target has {} coordinates", position.len());
                return Err(BadInput::new(problem)
                    .allowed(format!("{} coordinates of {n} particles, in {} directions", l.dimension * n, l.dimension))
                    .into());
            }
            None => {
                let end = run(&dynamics, &scene.start, scene.steps, &mut [])?;
                end.state[..l.dimension * n].iter().map(|x| x.f64()).collect()
            }
        };
        let seen = Seen { position, temperature: None, weight: 1.0 };
        let fluid: Vec<bool> = (0..n).map(|i| model.is_fluid(i)).collect();
        let matching = Matching {
            seen: BTreeMap::from([(scene.steps, seen)]),
            domain: model.domain,
            length: scene.spacing,
            warmth: 1.0,
            fluid: fluid.clone(),
        };
        let costs = dynamics.costs_from(&scene.start.state)?;
        let schedule = Schedule::affordable(scene.steps, 0, costs, config.optimise.memory)?;
        let fluid = (0..n).filter(|&i| fluid[i]).collect();
        Ok(Self { scene, dynamics, fluid, matching, schedule })
    }

    /// The velocities that the scene begins with, `[D, N_fluid]`.
    pub fn truth(&self) -> Vec<f64> {
        self.of(&self.scene.start.state)
    }

    /// The fluid's velocities in a state `[F, N]`.
    fn of(&self, state: &[R]) -> Vec<f64> {
        let (n, l) = (self.scene.model.particles(), self.scene.model.layout);
        let rows = l.velocity()..l.velocity() + l.dimension;
        rows.flat_map(|row| self.fluid.iter().map(move |&i| state[row * n + i].f64())).collect()
    }

    /// The scene's start with other velocities.
    pub fn start(&self, velocity: &[f64]) -> Snapshot<R> {
        let (n, l) = (self.scene.model.particles(), self.scene.model.layout);
        let mut state = self.scene.start.state.clone();
        for (at, v) in velocity.iter().enumerate() {
            let (row, i) = (l.velocity() + at / self.fluid.len(), self.fluid[at % self.fluid.len()]);
            state[row * n + i] = R::of(*v);
        }
        Snapshot { state, ..self.scene.start.clone() }
    }

    /// The run's end with these velocities at its start.
    ///
    /// # Errors
    /// A run that diverges.
    pub fn end(&self, velocity: &[f64]) -> anyhow::Result<Solver<R>> {
        run(&self.dynamics, &self.start(velocity), self.scene.steps, &mut [])
    }

    /// Places `[D, N]` that are to be reached.
    pub fn target(&self) -> &[f64] {
        &self.matching.seen[&self.scene.steps].position
    }

    /// Loss and its derivative by the velocities.
    ///
    /// # Errors
    /// A run that diverges.
    pub fn evaluate(&self, velocity: &[f64], progress: Progress<'_>) -> Result<(f64, Vec<f64>), Error> {
        let found = gradient(&self.dynamics, &self.start(velocity), &self.schedule, &self.matching, progress);
        let found = found.map_err(|error| error.advised(self.scene.model.remedy()))?;
        let state = found.state.flatten_all().and_then(|state| state.to_vec1::<R>());
        let state = state.map_err(|error| Error::run(error.to_string(), "report this"))?;
        Ok((found.value, self.of(&state)))
    }

    /// The root of the mean square of a coordinate's error that a loss stands for, in units of length.
    pub fn distance(&self, loss: f64) -> f64 {
        (loss / self.scene.model.layout.dimension as f64).sqrt() * self.scene.spacing
    }
}
