//! Evaluation of designs by a surrogate: after the solver has adapted the flow to the wall, a learned model predicts
//! the rest.
//!
//! ```text
//!   variables --deformation--> first state --solver--> W frames --model, frame by frame--> fields --objective--> value
//! ```
//!
//! The model knows the wall by its particles in every frame. The gradient by the variables has two parts: through the
//! wall's particles in the frames of the model and the fields of the objective, and through the solver that made the
//! first frames ([`FirstFrames::Differentiable`]; otherwise the fluid's first frames are constant). Each part is a
//! [`gradient`] with its own schedule, within the memory budget.

use crate::adjoint::dynamics::{Dynamics, Fields, Objective};
use crate::adjoint::gradient::{gradient, value, Progress};
use crate::adjoint::run::run;
use crate::adjoint::schedule::Schedule;
use crate::adjoint::RunError;
use crate::config::difference::differences;
use crate::config::layers::Setting;
use crate::config::scene::{
    Config, DesignWalls, DynamicsName, FirstFrames, GradientMode, Kernels, Optimise, Precision,
};
use crate::config::training::HeatModel;
use crate::dataset::recipe::Recipe;
use crate::dataset::Metadata;
use crate::design::objectives::{self, Samples};
use crate::design::problem::{check_gradient, Derivative, Evaluation, ADJOINT};
use crate::design::{Judge, Parametrisation, Problem};
use crate::error::{BadInput, Error};
use crate::scene::load::Loaded;
use crate::scene::Scene;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use crate::surrogate::dynamics::LearnedFlow;
use crate::surrogate::models::learned::Learned;
use crate::surrogate::{load_learned, HEATED_CHANNEL};
use candle_core::{DType, Device, Tensor};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// A design problem that is evaluated by a learned model.
pub struct SurrogateProblem<R> {
    /// The solver's part, which ends with the last frame that is given to the model.
    pub problem: Problem<R>,
    pub flow: LearnedFlow<R>,
    /// Objective of the predicted frames.
    pub objective: Arc<dyn Objective + Send>,
    /// Number of frames to predict.
    pub steps: usize,
    /// Steps of the solver after which frames are given to the model.
    pub looks: Vec<usize>,
    pub first_frames: FirstFrames,
    solver_schedule: Schedule,
    model_schedule: Schedule,
}

/// Keys in which a scene and that of a model's data may differ, because they do not change the flow.
const FREE: [&str; 7] = ["design", "optimise", "surrogate", "objective", "output", "run", "time"];

/// The path of a configuration's model; none for the built-in one.
pub fn model_of(config: &Config) -> Option<&Path> {
    config.surrogate.model.as_deref().map(Path::new)
}

impl<R: Sweeps> SurrogateProblem<R> {
    /// The surrogate of a configuration, if it has one.
    ///
    /// # Errors
    /// A model that cannot be read, and those of [`Self::new`].
    pub fn of_config(loaded: &Loaded) -> anyhow::Result<Option<Self>> {
        if loaded.config.optimise.dynamics == DynamicsName::Solver {
            return Ok(None);
        }
        let dtype = match loaded.config.surrogate.precision {
            Precision::F32 => DType::F32,
            Precision::F64 => DType::F64,
        };
        let model = match model_of(&loaded.config) {
            Some(path) => load_learned(path, Kernels::Fused, dtype)?,
            None => HEATED_CHANNEL.load(Kernels::Fused, dtype)?,
        };
        Ok(Some(Self::new(loaded, model).map_err(|error| loaded.located_error(error))?))
    }

    /// # Errors
    /// A model that cannot be used, or of another flow; a schedule that exceeds `optimise.memory`.
    pub fn new(loaded: &Loaded, model: Learned) -> Result<Self, Error> {
        let config = &loaded.config;
        let metadata = known_data(config, &model)?.clone();
        let wanted = &config.surrogate;
        let frames = model.setup.features.frames;
        let recipe = Recipe { every: metadata.write_every, skip: wanted.settle, frames, ..Recipe::of(config.scene) };
        let pace = recipe.pace(config);
        // The time step of the data, and a run that ends with the last given frame.
        let cfl = pace.dt / config.time_step_limits().acoustic * config.time.cfl;
        let set = |key: &str, value: String| Setting::option("the surrogate's first frames", key, value);
        let settings = [
            set("time.cfl", format!("{cfl:?}")),
            set("time.steps", pace.total.to_string()),
            set("objective.window", "0.0".into()),
            set("objective.samples", "1".into()),
        ];
        let own = loaded.with(&settings)?;
        let scene = Scene::<R>::from_config(&own.config)?;
        let Some(problem) = scene.design else {
            return Err(Error::run("a scene with a design has none", "report this"));
        };
        let origin = metadata.origin().ok_or_else(|| unknown("where its data's 0, 0 is"))?;
        let (hot, begin) = (config.wall.hot_temperature as f32, pace.dt * pace.total as f64);
        let flow = LearnedFlow::new(model, metadata, problem.dynamics(), origin, hot, begin);
        let time = flow.frame_time();
        let window = ((wanted.window / time).round() as usize).clamp(1, wanted.steps);
        let samples = Samples::window(wanted.steps, window, window);
        let objective = objectives::of_config(config, problem.outlet.clone(), samples);
        let schedule = |steps: usize, costs| schedule(&config.optimise, steps, costs);
        let model_schedule = schedule(wanted.steps, flow.costs(flow.pairs()))?;
        let solver_schedule = schedule(pace.total, problem.costs()?)?;
        let looks = (0..frames).map(|frame| pace.skip + frame * pace.every).collect();
        let (steps, first_frames) = (wanted.steps, wanted.first_frames);
        Ok(Self { problem, flow, objective, steps, looks, first_frames, solver_schedule, model_schedule })
    }

    /// The time of the last predicted frame.
    pub fn end(&self) -> f64 {
        self.flow.begin + self.steps as f64 * self.flow.frame_time()
    }

    /// The model's initial state over a design's wall: the frames that the solver makes.
    pub fn begin(&self, variables: &[f64]) -> anyhow::Result<Tensor> {
        let start = self.problem.start(variables);
        let first: Vec<f64> = start.state.iter().map(|x| x.f64()).collect();
        let (model, mut frames) = (&self.problem.model, Vec::new());
        let reference = model.heat.as_ref().map_or(0.0, |heat| heat.reference);
        // As in the data, walls have their set temperature; that of others is not used.
        let mut walls = vec![reference; model.particles()];
        for (&i, &set) in self.flow.kept.iter().zip(&self.flow.wall_temperature) {
            if set.is_finite() {
                walls[i as usize] = f64::from(set);
            }
        }
        let mut keep = |dynamics: &Sph<R>, solver: &mut Solver<R>| -> anyhow::Result<()> {
            if self.looks.contains(&solver.step) {
                let fields = dynamics.look(solver)?;
                let warmth = fields.temperature.as_ref().map(|t| t.flatten_all()?.to_vec1::<R>()).transpose()?;
                let warmth = warmth.unwrap_or_default();
                let own = |(i, t): (usize, &R)| if model.is_fluid(i) { t.f64() + reference } else { walls[i] };
                let state = solver.state.iter().map(|x| x.f64()).collect();
                frames.push((state, warmth.iter().enumerate().map(own).collect()));
            }
            Ok(())
        };
        run(&self.problem.dynamics(), &start, self.problem.steps, &mut [&mut keep])?;
        Ok(self.flow.state(&frames, &first)?)
    }

    /// The predicted objective of a design.
    ///
    /// # Errors
    /// A run of the solver or the model that diverges.
    pub fn evaluate(&self, variables: &[f64]) -> anyhow::Result<f64> {
        let mut sum = 0.0;
        let mut measure = |flow: &LearnedFlow<R>, at: &mut _| -> anyhow::Result<()> {
            if let Some(weight) = self.objective.weight(flow.step(at)) {
                let fields = flow.look(at)?;
                sum += weight * value(&*self.objective, &fields).map_err(RunError::tensor(flow.step(at)))?;
            }
            Ok(())
        };
        run(&self.flow, &self.begin(variables)?, self.steps, &mut [&mut measure])?;
        Ok(sum)
    }

    /// The predicted objective of a design and its derivative by the variables.
    ///
    /// # Errors
    /// [`Error::Diverged`] for a run that diverges and for a gradient that is not finite; others.
    pub fn differentiate(&self, variables: &[f64], progress: Progress<'_>) -> Result<Derivative, Error> {
        let failed = |error: RunError| error.advised(ADVICE);
        let broken = |error: candle_core::Error| Error::run(error.to_string(), "report this");
        let begin = self.begin(variables).map_err(told)?;
        let mut own = |share: f64| progress(0.2 + 0.6 * share);
        let found = gradient(&self.flow, &begin, &self.model_schedule, &*self.objective, &mut own).map_err(&failed)?;
        let mut steps = self.problem.steps;
        let rows = found.state.to_vec2::<f64>().map_err(broken)?;
        let n = self.problem.model.particles();
        let is_wall = |i: usize| !self.problem.model.is_fluid(i);
        let mut bar: Vec<f64> = rows[self.flow.solver_row()..].concat();
        let (mut frames, dimension) = (BTreeMap::new(), self.flow.metadata.dim);
        for (frame, &step) in self.looks.iter().enumerate() {
            let (place, warmth) = self.flow.rows(frame);
            for (k, row) in rows[place..place + dimension].iter().enumerate() {
                (0..n).filter(|&i| is_wall(i)).for_each(|i| bar[k * n + i] += row[i]);
            }
            let mut taken: Vec<Vec<f64>> = rows[place..place + dimension].to_vec();
            taken.push(rows[warmth].clone());
            taken.iter_mut().for_each(|row| (0..n).filter(|&i| is_wall(i)).for_each(|i| row[i] = 0.0));
            frames.insert(step, taken);
        }
        if self.first_frames == FirstFrames::Differentiable {
            let objective = GivenCotangents { frames };
            let start = self.problem.start(variables);
            let mut own = |share: f64| progress(0.8 + 0.2 * share);
            let dynamics = self.problem.dynamics();
            let found = gradient(&dynamics, &start, &self.solver_schedule, &objective, &mut own).map_err(&failed)?;
            steps += found.plain_steps + (1 + ADJOINT) * found.differentiated_steps;
            let state = found.state.flatten_all().and_then(|state| state.to_vec1::<R>()).map_err(broken)?;
            bar.iter_mut().zip(&state).for_each(|(bar, more)| *bar += more.f64());
        }
        let bar: Vec<R> = bar.into_iter().map(R::of).collect();
        let by_variables = self.problem.by_variables(variables, &bar);
        check_gradient(&by_variables)?;
        progress(1.0);
        let (value, growth) = (found.value, found.growth);
        Ok(Derivative { value, by_variables, solver_steps: steps, growth, ..Derivative::default() })
    }
}

/// Evaluates designs by the model; the results are predictions.
impl<R: Sweeps> Judge for SurrogateProblem<R> {
    fn gradient(&self, variables: &[f64], progress: Progress<'_>) -> Result<Evaluation, Error> {
        let found = self.problem.evaluation(variables, &self.differentiate(variables, progress)?);
        Ok(Evaluation { predicted: Some(found.figure), ..found })
    }

    fn value(&self, variables: &[f64]) -> Result<Evaluation, Error> {
        let (value, solver_steps) = (self.evaluate(variables).map_err(told)?, self.problem.steps);
        let found = Derivative { value, solver_steps, ..Derivative::default() };
        let found = self.problem.evaluation(variables, &found);
        Ok(Evaluation { predicted: Some(found.figure), ..found })
    }

    fn figure(&self, variables: &[f64], loss: f64) -> f64 {
        self.problem.figure_of(variables, loss)
    }

    fn parametrisation(&self) -> &dyn Parametrisation {
        &*self.problem.parametrisation
    }
}

const ADVICE: &str = "a gentler wall (a smaller design.amplitude or design.bound), or fewer surrogate.steps";

/// The error for the user of a failed run, with advice.
fn told(error: anyhow::Error) -> Error {
    match error.downcast::<RunError>() {
        Ok(error) => error.advised(ADVICE),
        Err(error) => Error::run(error.to_string(), "report this"),
    }
}

/// The scalar product of the frames' cotangents and the frames of a run, as an objective.
struct GivenCotangents {
    /// Cotangents by step: positions `[D][N]`, temperatures `[N]`.
    frames: BTreeMap<usize, Vec<Vec<f64>>>,
}

impl Objective for GivenCotangents {
    fn weight(&self, step: usize) -> Option<f64> {
        self.frames.get(&step).map(|_| 1.0)
    }

    fn value(&self, fields: &Fields) -> candle_core::Result<Tensor> {
        let Some(rows) = self.frames.get(&fields.step) else { candle_core::bail!("no cotangent for this step") };
        let like = &fields.position;
        let tensor = |rows: &[Vec<f64>]| {
            let n = rows[0].len();
            Tensor::from_vec(rows.concat(), (rows.len(), n), &Device::Cpu)?.to_dtype(like.dtype())
        };
        let d = rows.len() - 1;
        let places = like.mul(&tensor(&rows[..d])?)?.sum_all()?;
        match &fields.temperature {
            Some(temperature) => places + temperature.mul(&tensor(&rows[d..])?)?.sum_all()?,
            None => Ok(places),
        }
    }
}

/// The checkpointing schedule for a part of the gradient.
fn schedule(wanted: &Optimise, steps: usize, costs: crate::adjoint::schedule::Costs) -> Result<Schedule, Error> {
    if wanted.gradient == GradientMode::Taped {
        return Ok(Schedule::taped(steps));
    }
    Ok(Schedule::affordable(steps, 0, costs, wanted.memory)?)
}

fn unknown(what: &str) -> BadInput {
    BadInput::new(format!("the model does not say {what}"))
        .key("surrogate.model")
        .allowed("a model trained by this version on data of this version")
        .advice("scripts/train_model.sh, which makes one")
}

/// Metadata of the data on which a model was trained, if it can be used for optimisation.
fn known_data<'a>(config: &Config, model: &'a Learned) -> Result<&'a Metadata, Error> {
    let Some(data) = &model.setup.data else { return Err(unknown("what data it was trained on").into()) };
    let refuse = |is_so: bool, key: &str, problem: &str, allowed: &str| match is_so {
        true => Err(BadInput::new(problem).key(key).allowed(allowed)),
        false => Ok(()),
    };
    let is_cold = model.setup.heat == HeatModel::None || data.heat.is_none();
    refuse(is_cold, "surrogate.model", "the model knows no temperatures", "a model with heat: learned or conduction")?;
    let problem = "the model sees the temperatures of all walls, which only data have";
    let allowed = "a model trained with features.unset_walls = false";
    refuse(model.setup.features.unset_walls, "surrogate.model", problem, allowed)?;
    let problem = "design.walls = both with a surrogate";
    let allowed = "bottom: the data have no other shaped wall";
    refuse(config.design.walls != DesignWalls::Bottom, "design.walls", problem, allowed)?;
    let is_partial = matches!(config.optimise.gradient, GradientMode::Truncated | GradientMode::Steady);
    let problem = "optimise.gradient = truncated or steady with a surrogate";
    refuse(is_partial, "optimise.gradient", problem, "segments or taped")?;
    let allowed = "0 (the exact gradient)";
    refuse(config.optimise.clip > 0.0, "optimise.clip", "optimise.clip with a surrogate", allowed)?;
    let Some(before) = model.setup.data_config() else { return Err(unknown("which scene its data are of").into()) };
    let differing = differences(&before, config, &FREE);
    if !differing.is_empty() {
        let list: Vec<String> =
            differing.iter().map(|d| format!("{} was {} and is {}", d.key, d.before, d.now)).collect();
        return Err(BadInput::new(format!("the model knows another flow: {}", list.join("; ")))
            .key("surrogate.model")
            .allowed("the scene that its data are of, with other walls, start, objective and time step")
            .advice("scripts/train_model.sh, which makes a model of a scene, or the data's own values")
            .into());
    }
    if config.design.bound > before.design.bound * (1.0 + 1e-12) {
        return Err(BadInput::new(format!("the model knows walls within {} only", before.design.bound))
            .key("design.bound")
            .allowed(format!("design.bound <= {}", before.design.bound))
            .into());
    }
    Ok(data)
}
