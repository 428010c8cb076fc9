//! Finds the initial velocities of a flow from the positions of its particles n frames later, by a learned model.
//!
//! The first frames of the model follow from the initial positions x_0, which are known, and the velocities u, which
//! are not. With v = u times the time between frames, and an acceleration A per frame squared:
//!
//! ```text
//!   x_{-k} = x_0 - k v + k^2/2 A,     k = 0 ... W - 1,     A = model(x_0 - (W - 1) v ... x_0) - x_0 - v
//! ```
//!
//! A is the model's acceleration for straight paths. Without it the first displacement would correspond to the velocity
//! half a frame before the start, an error of A/2 in all velocities. No step of the solver is needed. The fewer frames
//! the model sees, the better (`features.frames = 2`), because only then does it know any initial state.
//!
//! Loss and derivative are those of [`crate::inverse::initial_state`] at the last frame. The derivative goes through
//! the rollout by [`gradient`], and through the first frames on candle's graph.

use crate::adjoint::dynamics::Dynamics;
use crate::adjoint::gradient::{gradient, value, Progress};
use crate::adjoint::run::run;
use crate::adjoint::schedule::Schedule;
use crate::adjoint::RunError;
use crate::config::difference::differences;
use crate::config::layers::Setting;
use crate::config::scene::{Config, Kernels};
use crate::dataset::extent::Extent;
use crate::dataset::recipe::Recipe;
use crate::dataset::Metadata;
use crate::error::{BadInput, Error};
use crate::inverse::initial_state::{InitialState, Unknown};
use crate::inverse::matching::Matching;
use crate::scene::load::Loaded;
use crate::sph::dynamics::Sph;
use crate::sph::Sweeps;
use crate::surrogate::dynamics::LearnedFlow;
use crate::surrogate::features::{displacement, wrap, Window};
use crate::surrogate::models::learned::Learned;
use candle_core::{Device, Tensor, Var};

/// The problem of finding initial velocities by a learned model.
pub struct LearnedVelocities<R> {
    /// The solver's problem, whose run ends with the last frame.
    pub problem: InitialState<R>,
    pub frames: usize,
    flow: LearnedFlow<R>,
    matching: Matching,
    schedule: Schedule,
    /// Initial positions `[N, D]` in the data's coordinates, and the solver's initial state `[F, N]`.
    place: Tensor,
    first: Tensor,
}

/// Keys in which a scene and that of a model's data may differ, because they do not change the flow.
const FREE: [&str; 5] = ["optimise", "surrogate", "output", "run", "time"];

/// The scene family of a model's data, and its settings that differ from the family's defaults.
///
/// # Errors
/// A model without this information.
pub fn known_scene(model: &Learned) -> Result<(&'static str, Vec<Setting>), BadInput> {
    let known = known_config(model)?;
    Ok((known.scene.name(), known.over_its_scene("the model's data", &["run", "output", "time"])))
}

fn unknown(what: &str) -> BadInput {
    BadInput::new(format!("the model does not say {what}"))
        .allowed("a model trained by this version on a data set of `hydrograd generate`")
        .advice("scripts/train_taylor_green.sh, which makes one")
}

fn known_data(model: &Learned) -> Result<&Metadata, BadInput> {
    model.setup.data.as_ref().ok_or_else(|| unknown("what data it was trained on"))
}

fn known_config(model: &Learned) -> Result<Config, BadInput> {
    known_data(model)?;
    model.setup.data_config().ok_or_else(|| unknown("which scene its data are of"))
}

impl<R: Sweeps> LearnedVelocities<R> {
    /// The problem for a scene, given the positions `frames` frames of the model later.
    ///
    /// # Errors
    /// A model of another flow, or of one with walls or heat; a schedule that exceeds the memory budget.
    pub fn new(loaded: &Loaded, model: Learned, frames: usize) -> anyhow::Result<Self> {
        let (config, metadata) = (&loaded.config, known_data(&model)?.clone());
        if let Some(other) = differences(&known_config(&model)?, config, &FREE).first() {
            let problem =
                format!("the model knows another flow: {} was {} and is {}", other.key, other.before, other.now);
            return Err(BadInput::new(problem)
                .key(other.key.clone())
                .allowed("the scene that its data are of, with another start and time step")
                .advice("scripts/train_taylor_green.sh, which makes a model, or the data's own value")
                .into());
        }
        let recipe = Recipe { every: metadata.write_every, skip: 0, frames: frames + 1, ..Recipe::of(config.scene) };
        let pace = recipe.pace(config);
        // The time step of the data, and a run that ends with the last frame.
        let cfl = pace.dt / config.time_step_limits().acoustic * config.time.cfl;
        let set = |key: &str, value: String| Setting::option("the model's frames", key, value);
        let own = [set("time.cfl", format!("{cfl:?}")), set("time.steps", pace.total.to_string())];
        let problem = InitialState::<R>::new(&loaded.with(&own)?.config, Unknown::Velocities, None, None)?;
        let scene = &problem.scene;
        if scene.model.has_walls() || scene.model.heat.is_some() || metadata.heat.is_some() {
            return Err(BadInput::new("velocities are found by a learned model without walls and heat only")
                .place(scene.name)
                .allowed("taylor-green, taylor-green-3d, reverse-poiseuille, reverse-poiseuille-3d")
                .into());
        }
        let origin = metadata.origin().ok_or_else(|| unknown("where its data's 0, 0 is"))?;
        let (n, d, extent) = (scene.model.particles(), metadata.dim, Extent::of(&metadata));
        let state: Vec<f64> = scene.start.state.iter().map(|x| x.f64()).collect();
        let place = (0..n * d).map(|at| extent.wrapped(at % d, state[at % d * n + at / d] - origin[at % d])).collect();
        let sph = Sph::new(scene.model.clone(), Kernels::Fused);
        let flow = LearnedFlow::new(model, metadata, sph, origin, f32::NAN, 0.0);
        let schedule = Schedule::affordable(frames, 0, flow.costs(flow.pairs()), config.optimise.memory)?;
        let matching = problem.matching_at(frames);
        let first = Tensor::from_slice(&state, (state.len() / n, n), &Device::Cpu)?;
        let place = Tensor::from_vec(place, (n, d), &Device::Cpu)?;
        Ok(Self { frames, flow, matching, schedule, place, first, problem })
    }

    /// The model's initial state for velocities `[D, N]`, on the graph if they are.
    fn begin(&self, velocity: &Tensor) -> anyhow::Result<Tensor> {
        let (flow, place) = (&self.flow, &self.place);
        let v = velocity.t()?.affine(flow.frame_time(), 0.0)?;
        let back: Vec<f64> = (0..flow.model.setup.features.frames).rev().map(|k| k as f64).collect();
        let straight = back.iter().map(|k| wrap(&(place - v.affine(*k, 0.0)?)?, &flow.metadata));
        let window = Window { position: straight.collect::<Result<_, _>>()?, temperature: vec![] };
        let (next, _) = flow.model.predict(&flow.scenery(), &window, None)?;
        let acceleration = (displacement(&next, place, &flow.metadata)? - &v)?;
        let mut rows = Vec::new();
        for k in back {
            let past = ((place - v.affine(k, 0.0)?)? + acceleration.affine(0.5 * k * k, 0.0)?)?;
            rows.push(wrap(&past, &flow.metadata)?.t()?);
        }
        rows.push(self.first.clone());
        Ok(Tensor::cat(&rows, 0)?)
    }

    fn tensor(&self, velocity: &[f64]) -> candle_core::Result<Tensor> {
        let d = self.flow.metadata.dim;
        Tensor::from_slice(velocity, (d, velocity.len() / d), &Device::Cpu)
    }

    /// The loss of velocities `[D, N]` by the model.
    pub fn loss(&self, velocity: &[f64]) -> anyhow::Result<f64> {
        let begin = self.begin(&self.tensor(velocity)?)?;
        let mut end = run(&self.flow, &begin, self.frames, &mut [])?;
        Ok(value(&self.matching, &self.flow.look(&mut end)?)?)
    }

    /// The loss and its derivative by the velocities.
    ///
    /// # Errors
    /// [`Error::Diverged`] for a rollout that diverges; others.
    pub fn evaluate(&self, velocity: &[f64], progress: Progress<'_>) -> Result<(f64, Vec<f64>), Error> {
        let broken = |error: String| Error::run(error, "report this");
        let failed = |error: RunError| error.advised("fewer frames");
        let variable = self.tensor(velocity).and_then(|tensor| Var::from_tensor(&tensor));
        let variable = variable.map_err(|error| broken(error.to_string()))?;
        // A neighbour search that fails here is that of x_0, which is the same for all velocities.
        let begin = self.begin(&variable).map_err(|error| broken(format!("{error:#}")))?;
        let start = begin.detach();
        let found = gradient(&self.flow, &start, &self.schedule, &self.matching, progress).map_err(failed)?;
        let by_velocity = || -> candle_core::Result<Vec<f64>> {
            let gradients = (begin * found.state)?.sum_all()?.backward()?;
            let Some(by_velocity) = gradients.get(&variable) else { candle_core::bail!("no gradient of the frames") };
            by_velocity.contiguous()?.flatten_all()?.to_vec1::<f64>()
        };
        Ok((found.value, by_velocity().map_err(|error| broken(error.to_string()))?))
    }
}
