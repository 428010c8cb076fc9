//! Training on what a design problem asks of a model: the objective of a rollout, and its change with the wall.
//!
//! In a data set of pairs (`hydrograd generate --pairs`) trajectories 2k and 2k + 1 begin alike and differ by their
//! walls only. For a pair of windows at the same frames the model predicts `steps` frames of each, and the objective is
//! averaged over some of them, measured as in a search by the model ([`crate::surrogate::design`]). With the relative errors
//! e = (Q_predicted - Q_true) / Q_true in per cent of both windows the loss is
//!
//! ```text
//!   L = weight ( (e_a^2 + e_b^2) / 2 + gradient (e_b - e_a)^2 )
//! ```
//!
//! The second term is the error of the directional derivative from one wall to its neighbour: Sobolev training
//! (Czarnecki et al. 2017, arXiv:1706.04859), with differences instead of a derivative of the rollout. Q_true is that
//! of the true frames.

use crate::adjoint::dynamics::{Dynamics, Objective};
use crate::adjoint::gradient::value;
use crate::config::scene::ParametrisationName;
use crate::config::training::ObjectiveLoss;
use crate::dataset::{Metadata, Trajectory};
use crate::design::objectives::{self, Samples};
use crate::design::Problem;
use crate::error::{BadInput, Error};
use crate::numerics::random::{numbered, uniform};
use crate::scene::Scene;
use crate::surrogate::dynamics::{At, LearnedFlow};
use crate::surrogate::models::learned::Learned;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::parameters::{detached, tracked, Network};
use crate::surrogate::training::batch::unreached;
use candle_core::{DType, Tensor};
use std::collections::HashMap;
use std::sync::Arc;

/// Number of frames at which the objective is measured: each costs more than a step of the model.
const SAMPLES: usize = 5;

/// Pairs of trajectories, and the design problem that their walls belong to.
pub struct Pairs<'a> {
    settings: ObjectiveLoss,
    seed: u64,
    trajectories: &'a [Trajectory],
    problem: Problem<f64>,
    flow: LearnedFlow<f64>,
    objective: Arc<dyn Objective + Send>,
    /// The true objective of single frames, by trajectory and frame.
    known: HashMap<(usize, usize), f64>,
}

/// Errors of the objective in per cent, root mean squares over pairs: of both values, and of their difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Errors {
    pub values: [f64; 2],
    pub difference: f64,
}

impl<'a> Pairs<'a> {
    /// # Errors
    /// Data without pairs, or of a scene without a design; too few frames.
    pub fn new(
        settings: &ObjectiveLoss,
        seed: u64,
        setup: &Setup,
        network: &Arc<dyn Network>,
        metadata: &Metadata,
        trajectories: &'a [Trajectory],
    ) -> Result<Self, Error> {
        let bad = |problem: String| {
            BadInput::new(problem)
                .key("objective.weight")
                .allowed("a data set of pairs of walls, as generate makes it with pairs=0.004")
                .advice("objective.weight=0")
        };
        let (Some(mut config), Some(origin)) = (setup.data_config(), metadata.origin()) else {
            return Err(bad("the data do not say which scene they are of".into()).into());
        };
        let alike = |pair: &[Trajectory]| {
            let [a, b] = pair else { return false };
            a.wall_x == b.wall_x && !a.wall_x.is_empty() && a.kind == b.kind && a.frames == b.frames
        };
        let is_paired = metadata.other.get("pairs").and_then(|pairs| pairs.as_f64()).is_some_and(|pairs| pairs > 0.0);
        if !is_paired || !trajectories.chunks(2).all(alike) {
            return Err(bad("the trajectories are no pairs of neighbouring walls".into()).into());
        }
        let needed = settings.first + setup.features.frames + settings.steps;
        if let Some(short) = trajectories.iter().find(|trajectory| trajectory.frames < needed) {
            let problem = format!("trajectory {} has {} frames", short.name, short.frames);
            let allowed =
                format!("{needed} frames or more: objective.first, those that the model sees, objective.steps");
            return Err(BadInput::new(problem).key("objective.steps").allowed(allowed).into());
        }
        config.design.parametrisation = ParametrisationName::Nodes;
        let scene = Scene::<f64>::from_config(&config)?;
        let Some(problem) = scene.design else {
            return Err(bad("the data are of a scene without a wall to shape".into()).into());
        };
        let model = Learned::new("training".into(), setup.clone(), network.clone());
        let hot = config.wall.hot_temperature as f32;
        let flow = LearnedFlow::new(model, metadata.clone(), problem.dynamics(), origin, hot, 0.0);
        if let Some(other) = trajectories.iter().find(|t| t.particles != flow.kept.len()) {
            let problem = format!("trajectory {} has {} particles", other.name, other.particles);
            return Err(bad(problem).allowed(format!("{} particles, as its scene has", flow.kept.len())).into());
        }
        let samples = Samples::window(settings.steps, settings.steps, SAMPLES);
        let objective = objectives::of_config(&config, problem.outlet.clone(), samples);
        Ok(Self { settings: *settings, seed, trajectories, problem, flow, objective, known: HashMap::new() })
    }

    /// Number of pairs.
    pub fn count(&self) -> usize {
        self.trajectories.len() / 2
    }

    /// The number of the first frame of the windows of a pair that is drawn for a step.
    fn draw(&self, step: u64) -> (usize, usize) {
        let mut rng = numbered(self.seed, "pair", step as u32);
        let pair = (uniform(&mut rng) * self.count() as f64) as usize;
        (pair, self.first(pair, uniform(&mut rng)))
    }

    /// The first frame of a window, for a random number in [0, 1).
    fn first(&self, pair: usize, chance: f64) -> usize {
        let (own, frames) = (&self.settings, self.flow.model.setup.features.frames);
        let choices = self.trajectories[2 * pair].frames + 1 - frames - own.steps - own.first;
        own.first + (chance * choices as f64) as usize
    }

    /// Loss and its gradient by the parameters for the pair of a step.
    ///
    /// # Errors
    /// A rollout that diverges, a parameter without a gradient, tensor errors.
    pub fn gradient(&mut self, step: u64, network: &dyn Network) -> anyhow::Result<(f64, Vec<Tensor>)> {
        let (pair, first) = self.draw(step);
        let [a, b] = self.errors_on_graph(pair, first, tracked(network))?;
        let difference = (&b - &a)?;
        let squares = ((a.sqr()? + b.sqr()?)? * 0.5)?;
        let loss = ((squares + (difference.sqr()? * self.settings.gradient)?)? * self.settings.weight)?;
        let mut found = loss.backward()?;
        let mut gradients = Vec::new();
        for parameter in network.parameters() {
            gradients.push(found.remove(&parameter.values).ok_or_else(|| unreached(parameter))?);
        }
        Ok((loss.to_scalar::<f64>()?, gradients))
    }

    /// The errors of `count` windows, spread over the pairs, for parameters without a graph.
    ///
    /// # Errors
    /// A rollout that diverges, tensor errors.
    pub fn validate(
        &mut self,
        count: usize,
        parameters: Option<&[Tensor]>,
        network: &dyn Network,
    ) -> anyhow::Result<Errors> {
        let parameters = parameters.map_or_else(|| detached(network), <[Tensor]>::to_vec);
        let count = count.clamp(1, self.count());
        let (mut values, mut differences) = ([0.0; 2], 0.0);
        for k in 0..count {
            let pair = k * self.count() / count;
            let first = self.first(pair, (k as f64 + 0.5) / count as f64);
            let [a, b] = self.errors_on_graph(pair, first, parameters.clone())?;
            let (a, b) = (a.to_scalar::<f64>()?, b.to_scalar::<f64>()?);
            values[0] += a * a;
            values[1] += b * b;
            differences += (b - a) * (b - a);
        }
        let root = |sum: f64| (sum / count as f64).sqrt();
        Ok(Errors { values: values.map(root), difference: root(differences) })
    }

    /// The relative errors of both windows of a pair, in per cent, on the graph of the parameters.
    fn errors_on_graph(&mut self, pair: usize, first: usize, parameters: Vec<Tensor>) -> anyhow::Result<[Tensor; 2]> {
        self.flow.model.parameters = parameters;
        let mut of = |which: usize| -> anyhow::Result<Tensor> {
            let (truth, predicted) = (self.truth(2 * pair + which, first)?, self.predicted(2 * pair + which, first)?);
            Ok(((predicted - truth)? * (100.0 / truth))?)
        };
        Ok([of(0)?, of(1)?])
    }

    /// The objective of the frames that the model predicts after the window that begins with frame `first`, `[]`.
    fn predicted(&self, which: usize, first: usize) -> anyhow::Result<Tensor> {
        let last = first + self.flow.model.setup.features.frames - 1;
        let mut state = self.state(which, last)?;
        let (mut tape, mut sum) = (0, None);
        for step in 1..=self.settings.steps {
            state = self.flow.advance_taped(&mut tape, &state, None)?;
            let Some(weight) = self.objective.weight(step) else { continue };
            let value = (self.objective.value(&self.flow.fields(&mut tape, &state)?)?.to_dtype(DType::F64)? * weight)?;
            sum = Some(match sum {
                None => value,
                Some(sum) => (sum + value)?,
            });
        }
        sum.ok_or_else(|| anyhow::anyhow!("an objective without a step"))
    }

    /// The objective of the true frames after the window that begins with frame `first`.
    fn truth(&mut self, which: usize, first: usize) -> anyhow::Result<f64> {
        let last = first + self.flow.model.setup.features.frames - 1;
        let mut sum = 0.0;
        for step in 1..=self.settings.steps {
            let Some(weight) = self.objective.weight(step) else { continue };
            let place = (which, last + step);
            if !self.known.contains_key(&place) {
                let mut at = At { step, state: self.state(which, last + step)? };
                self.known.insert(place, value(&*self.objective, &self.flow.look(&mut at)?)?);
            }
            sum += weight * self.known[&place];
        }
        Ok(sum)
    }

    /// The model's state with the true frames up to `last` of a trajectory.
    fn state(&self, which: usize, last: usize) -> candle_core::Result<Tensor> {
        let (trajectory, flow, d) = (&self.trajectories[which], &self.flow, self.flow.metadata.dim);
        let start = self.problem.start(&trajectory.wall_offset).state;
        let n = self.problem.model.particles();
        let reference = self.problem.model.heat.as_ref().map_or(0.0, |heat| heat.reference);
        let frames = (last + 1 - flow.model.setup.features.frames..=last).map(|frame| {
            // Particles that the data lack stay where they are; the model does not see them.
            let (mut position, mut temperature) = (start[..d * n].to_vec(), vec![reference; n]);
            let places = trajectory.position_of(frame);
            let warmth = trajectory.temperature_of(frame).unwrap_or_default();
            for (k, &i) in flow.kept.iter().enumerate() {
                for axis in 0..d {
                    position[axis * n + i as usize] = f64::from(places[k * d + axis]) + flow.origin[axis];
                }
                if let Some(&warm) = warmth.get(k) {
                    temperature[i as usize] = f64::from(warm);
                }
            }
            (position, temperature)
        });
        flow.state(&frames.collect::<Vec<_>>(), &start)
    }
}
