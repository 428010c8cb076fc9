//! The design problem: maps variables to an objective and its derivative.

use super::deformation::Deformation;
use super::objectives::{Figure, Outlet};
use super::parametrisations::Parametrisation;
use super::shape::Shape;
use super::team::{Order, Team};
use crate::adjoint::gradient::{gradient, value, value_of_run, Gradient, Progress};
use crate::adjoint::schedule::{rounded_up, Costs, Schedule};
use crate::adjoint::{Objective, RunError};
use crate::config::device::Compute;
use crate::config::scene::{GradientMode, Kernels, Optimise, Precision};
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::numerics::lanes::Real;
use crate::numerics::ranks::Ranks;
use crate::sph::divergence::told;
use crate::sph::dynamics::Sph;
use crate::sph::method::Steady;
use crate::sph::solver::Snapshot;
use crate::sph::{Model, Sweeps};
use candle_core::{DType, Device, Tensor, Var};
use std::sync::Arc;

/// A wall to be shaped, the flow over it, and the objective to be maximised.
#[derive(Clone)]
pub struct Problem<R> {
    pub model: Model<R>,
    /// Kernels and device of the steps.
    pub compute: Compute,
    pub deformation: Arc<Deformation>,
    pub parametrisation: Arc<dyn Parametrisation>,
    pub objective: Arc<dyn Objective + Send>,
    pub figure: Figure,
    /// Weight of the roughness penalty.
    pub smoothing: f64,
    pub steps: usize,
    /// The initial variables.
    pub first: Vec<f64>,
    /// Where the flow is measured, for any objective.
    pub outlet: Outlet,
    /// Depth of the simulated domain; 1 in two dimensions.
    pub depth: f64,
    /// Length of the objective's window at the end of the run, in steps.
    pub window: usize,
    /// Whether gradients are those of the steady state.
    pub is_steady: bool,
    /// Step of central differences by which gradients are computed, if they are not adjoint gradients.
    pub differences: Option<f64>,
    /// The same problem from other starts, over which values and such gradients are averaged; none without an ensemble.
    pub members: Vec<Problem<R>>,
    /// The ranks that share the flow, see [`Problem::shared`].
    pub team: Option<Team>,
}

/// A state is steady when no field changes by more than this per time.
const STEADY: f64 = 1e-6;
/// The same in single precision, where rounding alone changes a state this much.
const STEADY_SINGLE: f64 = 3e-4;

/// The tolerance of a steady state in the precision R.
fn steady_tolerance<R: Real>() -> f64 {
    match R::DTYPE {
        DType::F32 => STEADY_SINGLE,
        _ => STEADY,
    }
}

fn unexpected(error: impl std::fmt::Display) -> Error {
    Error::run(error.to_string(), "report this")
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// The standard error of the mean of independent values; none of a single one.
fn standard_error(values: &[f64]) -> Option<f64> {
    let (count, mean) = (values.len() as f64, mean(values));
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / (count - 1.0);
    (values.len() > 1).then(|| (variance / count).sqrt())
}

const UNSTEADY: &str = "optimise.gradient=segments, or a smaller time.cfl or design.bound";

impl<R> std::fmt::Debug for Problem<R> {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.debug_struct("Problem")
            .field("parametrisation", &self.parametrisation)
            .field("figure", &self.figure)
            .field("steps", &self.steps)
            .field("first", &self.first)
            .finish_non_exhaustive()
    }
}

/// Loss and gradient of a design.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Evaluation {
    /// The reported objective.
    pub figure: f64,
    /// Loss to be minimised: penalty - objective.
    pub loss: f64,
    /// Gradient of the loss by the variables, `[K]`.
    pub gradient: Vec<f64>,
    /// Norm of the gradient's standard error; 0 unless it is averaged over an ensemble.
    pub gradient_error: f64,
    /// Number of solver steps; an adjoint step counts as [`ADJOINT`].
    pub solver_steps: usize,
    /// The solver's result, if the solver evaluated the design.
    pub truth: Option<Truth>,
    /// The objective predicted by a surrogate, if one evaluated the design.
    pub predicted: Option<f64>,
}

/// The solver's result for a design: the reported objective and the loss.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Truth {
    pub figure: f64,
    pub loss: f64,
}

/// Cost of an adjoint step in steps forward.
pub const ADJOINT: usize = 3;

/// The objective of a design and its derivative.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Derivative {
    pub value: f64,
    /// Derivative by the variables, `[K]`.
    pub by_variables: Vec<f64>,
    /// Their standard errors, `[K]`; empty unless they are averaged over an ensemble.
    pub errors: Vec<f64>,
    /// See [`Evaluation::solver_steps`].
    pub solver_steps: usize,
    /// See [`Gradient::growth`]; only for the adjoint of a run.
    pub growth: Vec<(usize, f64)>,
    /// See [`Gradient::clipped`].
    pub clipped: usize,
    /// Residual of the adjoint equation of a steady state, relative to its right-hand side.
    pub residual: f64,
}

impl Evaluation {
    /// The evaluation of a design whose run diverged: an infinite loss and no gradient.
    pub fn rejected(variables: usize) -> Self {
        Self { figure: f64::NAN, loss: f64::INFINITY, gradient: vec![0.0; variables], ..Self::default() }
    }
}

impl<R: Real> Problem<R> {
    pub fn start(&self, variables: &[f64]) -> Snapshot<R> {
        let heights = self.parametrisation.column_heights(variables);
        Snapshot::first(&self.model, self.deformation.state::<R>(&heights))
    }

    /// The initial wall, sampled at points.
    pub fn first_wall(&self) -> Shape {
        self.parametrisation.sampled(&self.first)
    }
}

impl<R: Sweeps> Problem<R> {
    pub fn dynamics(&self) -> Sph<R> {
        Sph::new(self.model.clone(), self.compute.clone())
    }

    /// The objective of a design without a gradient, by fused steps, which equal composed ones to rounding.
    pub fn evaluate(&self, variables: &[f64]) -> anyhow::Result<f64> {
        self.evaluate_watched(variables, &mut |_| ())
    }

    /// [`Self::evaluate`]. `progress` is called with the completed fraction of the run.
    pub fn evaluate_watched(&self, variables: &[f64], progress: Progress<'_>) -> anyhow::Result<f64> {
        Ok(mean(&self.evaluate_each(variables, progress)?))
    }

    /// The objective of each member of the ensemble.
    fn evaluate_each(&self, variables: &[f64], progress: Progress<'_>) -> anyhow::Result<Vec<f64>> {
        let count = 1 + self.members.len();
        let all = std::iter::once(self).chain(&self.members).enumerate();
        all.map(|(k, of)| of.evaluate_alone(variables, &mut |part| progress((k as f64 + part) / count as f64)))
            .collect()
    }

    /// The objective of a design from the problem's own start.
    fn evaluate_alone(&self, variables: &[f64], progress: Progress<'_>) -> anyhow::Result<f64> {
        if let Some(team) = &self.team {
            team.tell(Order::Value, variables);
            let (spread, start) = (team.spread(&self.model), self.start(variables));
            return value_of_run(&spread, &start, self.steps, &*self.objective, progress);
        }
        let dynamics = Sph::new(self.model.clone(), Kernels::Fused);
        value_of_run(&dynamics, &self.start(variables), self.steps, &*self.objective, progress)
    }

    /// The objective of a design and its derivative by the variables.
    ///
    /// # Errors
    /// [`Error::Diverged`] for a run that diverges and for a gradient that is not finite; others.
    pub fn differentiate(
        &self,
        variables: &[f64],
        schedule: &Schedule,
        progress: Progress<'_>,
    ) -> Result<Derivative, Error> {
        if self.is_steady {
            return self.differentiate_steady(variables, progress);
        }
        if let Some(step) = self.differences {
            return self.differentiate_by_runs(variables, step, progress);
        }
        let start = self.start(variables);
        let found = match &self.team {
            Some(team) => {
                team.tell(Order::Gradient(*schedule), variables);
                self.differentiate_shared(team, &start, schedule, progress)
            }
            None => gradient(&self.dynamics(), &start, schedule, &*self.objective, progress),
        };
        let found = found.map_err(|error| told(&error, &self.model, &start))?;
        let mut state_bar: Vec<R> = found
            .state
            .flatten_all()
            .and_then(|s| s.to_vec1::<R>())
            .map_err(|e| Error::run(e.to_string(), "report this: the gradient has the wrong type"))?;
        if schedule.first > 0 {
            self.deformation.keep_static(&mut state_bar, |i| self.model.is_fluid(i));
        }
        let by_variables = self.by_variables(variables, &state_bar);
        check_gradient(&by_variables)?;
        let solver_steps = found.plain_steps + (1 + ADJOINT) * found.differentiated_steps;
        let Gradient { value, growth, clipped, .. } = found;
        Ok(Derivative { value, by_variables, solver_steps, growth, clipped, ..Derivative::default() })
    }

    /// The same problem with its flow shared by the ranks of which this is one. (Where there is one, nothing changes.) The others
    /// have to [`Self::follow`], until the first one [dismisses](Self::dismiss) them.
    ///
    /// # Errors
    /// [`BadInput`]: a method that they cannot share, or a gradient that is not that of a run.
    pub fn shared(self, ranks: &Ranks) -> Result<Self, BadInput> {
        if ranks.size() == 1 {
            return Ok(self);
        }
        if self.is_steady {
            return Err(BadInput::new("steady gradients over several ranks: one matrix of the whole flow is solved")
                .key("optimise.gradient")
                .allowed("segments, of a method whose particles move")
                .advice("start it without mpirun"));
        }
        Ok(Self { team: Some(Team::new(&self.model, ranks)?), ..self })
    }

    /// Tells the other ranks of a shared problem that this was all.
    pub fn dismiss(&self) {
        if let Some(team) = &self.team {
            team.tell(Order::End, &vec![0.0; self.first.len()]);
        }
    }

    /// Takes part in whatever the first rank evaluates, which also reports its errors: all ranks have them.
    pub fn follow(&self) {
        let Some(team) = &self.team else { return };
        loop {
            let (order, variables) = team.told(self.first.len());
            let failed = match order {
                Order::End => return,
                Order::Value => self.evaluate(&variables).err(),
                Order::Gradient(schedule) => {
                    let start = self.start(&variables);
                    self.differentiate_shared(team, &start, &schedule, &mut |_| ()).err().map(Into::into)
                }
            };
            if let Some(error) = failed {
                log::info!("the evaluation failed here, too: {error}");
            }
        }
    }

    /// The derivative by the initial state, by all ranks.
    fn differentiate_shared(
        &self,
        team: &Team,
        start: &Snapshot<R>,
        schedule: &Schedule,
        progress: Progress<'_>,
    ) -> Result<Gradient, RunError> {
        let spread = team.spread(&self.model);
        let mut found = gradient(&spread, start, schedule, &*self.objective, progress)?;
        found.state = spread.whole(start, &found.state).map_err(RunError::tensor(0))?;
        Ok(found)
    }

    /// [`Self::differentiate`] by central differences of runs, one-sided at a limit. Over a long time two runs from
    /// slightly different particles diverge from each other: the exact derivative of one run grows without bound, while
    /// averages are the same in both runs and smooth at finite steps. What a window is too short for, an ensemble averages;
    /// how its members differ says how far their mean is from that of many more.
    fn differentiate_by_runs(&self, variables: &[f64], step: f64, progress: Progress<'_>) -> Result<Derivative, Error> {
        let runs = 2 * variables.len() + 1;
        let mut done = 0;
        let mut values = |variables: &[f64]| {
            let found = self.evaluate_each(variables, &mut |part| progress((done as f64 + part) / runs as f64));
            done += 1;
            found.map_err(|error| self.told(error, variables))
        };
        let limits = self.parametrisation.limits();
        let middle = values(variables)?;
        let (mut by_variables, mut errors) = (Vec::with_capacity(variables.len()), vec![]);
        for k in 0..variables.len() {
            let mut at = |x: f64| {
                let mut moved = variables.to_vec();
                moved[k] = x.clamp(limits.lower[k], limits.upper[k]);
                let values = if moved[k] == variables[k] { Ok(middle.clone()) } else { values(&moved) };
                values.map(|values| (moved[k], values))
            };
            let ((above, more), (below, less)) = (at(variables[k] + step)?, at(variables[k] - step)?);
            let slopes: Vec<f64> = more.iter().zip(&less).map(|(more, less)| (more - less) / (above - below)).collect();
            by_variables.push(mean(&slopes));
            errors.extend(standard_error(&slopes));
        }
        check_gradient(&by_variables)?;
        let solver_steps = middle.len() * runs * self.steps;
        Ok(Derivative { value: mean(&middle), by_variables, errors, solver_steps, ..Derivative::default() })
    }

    /// The error for the user of a failed run, with its cause.
    fn told(&self, error: anyhow::Error, variables: &[f64]) -> Error {
        match error.downcast::<RunError>() {
            Ok(error) => told(&error, &self.model, &self.start(variables)),
            Err(error) => error.downcast::<Error>().unwrap_or_else(unexpected),
        }
    }

    /// The objective at the steady state of fixed particles, where no field changes by more than `tolerance` per time.
    pub fn evaluate_steady(&self, variables: &[f64], tolerance: f64) -> Result<f64, Error> {
        Ok(self.evaluate_settled(variables, tolerance)?.0)
    }

    /// As [`Self::evaluate_steady`], with the number of steps.
    fn evaluate_settled(&self, variables: &[f64], tolerance: f64) -> Result<(f64, usize), Error> {
        let (steady, state, steps) = self.settled(variables, tolerance)?;
        let objective =
            |state: Tensor| value(&*self.objective, &self.dynamics().fields_of_steady(steady.shown(&state)?));
        Ok((self.tensor(&state).and_then(objective).map_err(unexpected)?, steps))
    }

    fn tensor(&self, state: &[R]) -> candle_core::Result<Tensor> {
        Tensor::from_slice(state, (self.model.rows.count(), self.model.particles()), &Device::Cpu)
    }

    /// The steady state of a design's run, and the number of steps to it.
    fn settled(&self, variables: &[f64], tolerance: f64) -> Result<(&dyn Steady<R>, Vec<R>, usize), Error> {
        let Some(steady) = self.model.steady() else {
            return Err(Error::run("there is no steady state of particles that move", "method.name=fixed"));
        };
        let mut state = self.start(variables).state;
        let (steps, residual) = steady.settle(&mut state, tolerance);
        interrupt::check_own()?;
        // A NaN must fail as well.
        if residual.is_nan() || residual > 100.0 * tolerance {
            let what = format!("the flow is not steady after {steps} steps: it changes by {residual:.1e} per time");
            return Err(Error::diverged(what, UNSTEADY));
        }
        Ok((steady, state, steps))
    }

    /// [`Self::differentiate`] at the steady state of fixed particles, which takes one state for any length of the run.
    fn differentiate_steady(&self, variables: &[f64], progress: Progress<'_>) -> Result<Derivative, Error> {
        let (steady, state, steps) = self.settled(variables, steady_tolerance::<R>())?;
        progress(0.5);
        let go = || -> candle_core::Result<(f64, Vec<R>)> {
            let variable = Var::from_tensor(&self.tensor(&state)?)?;
            let dynamics = self.dynamics();
            let fields = dynamics.fields_of_steady(steady.shown(variable.as_tensor())?);
            let value = self.objective.value(&fields)?;
            let mut gradients = value.backward()?;
            let bar = match gradients.remove(variable.as_tensor()) {
                Some(bar) => bar.flatten_all()?.to_vec1::<R>()?,
                None => vec![R::default(); state.len()],
            };
            Ok((value.to_dtype(DType::F64)?.to_scalar::<f64>()?, bar))
        };
        let (value, bar) = go().map_err(unexpected)?;
        let found = steady.gradient(&state, &bar);
        interrupt::check_own()?;
        if found.residual.is_nan() || found.residual > 1e-2 {
            let what = format!("the adjoint of the steady state does not converge: {:.1e}", found.residual);
            return Err(Error::diverged(what, UNSTEADY));
        }
        let by_variables = self.by_variables(variables, &found.state);
        check_gradient(&by_variables)?;
        progress(1.0);
        let solver_steps = steps + ADJOINT * found.steps;
        Ok(Derivative { value, by_variables, solver_steps, residual: found.residual, ..Derivative::default() })
    }

    /// The derivative by the variables, `[K]`, given the cotangent of the initial state, `[F, N]`.
    pub fn by_variables(&self, variables: &[f64], state_bar: &[R]) -> Vec<f64> {
        let heights = self.parametrisation.column_heights(variables);
        self.parametrisation.pull_back(&self.deformation.pull_back(&heights, state_bar))
    }

    /// The loss of a design without its gradient.
    pub fn value(&self, variables: &[f64]) -> Result<Evaluation, Error> {
        let (value, solver_steps) = match self.is_steady {
            true => self.evaluate_settled(variables, steady_tolerance::<R>())?,
            false => {
                let found = self.evaluate(variables).map_err(|error| self.told(error, variables));
                (found?, (1 + self.members.len()) * self.steps)
            }
        };
        Ok(self.confirmed(variables, &Derivative { value, solver_steps, ..Derivative::default() }))
    }

    /// The [`Self::evaluation`] of a result of the solver.
    pub(super) fn confirmed(&self, variables: &[f64], found: &Derivative) -> Evaluation {
        let found = self.evaluation(variables, found);
        Evaluation { truth: Some(Truth { figure: found.figure, loss: found.loss }), ..found }
    }

    /// The reported objective of a design with this loss.
    pub fn figure_of(&self, variables: &[f64], loss: f64) -> f64 {
        let (penalty, _) = self.parametrisation.penalty(self.smoothing, variables);
        (penalty - loss) * self.figure.factor
    }

    /// The loss of a design with this objective, and its gradient if the derivative is known.
    pub fn evaluation(&self, variables: &[f64], found: &Derivative) -> Evaluation {
        // The objective enters the loss with a minus sign, because it is maximised.
        let (penalty, penalty_gradient) = self.parametrisation.penalty(self.smoothing, variables);
        let gradient = found.by_variables.iter().zip(penalty_gradient).map(|(v, p)| p - v).collect();
        Evaluation {
            figure: found.value * self.figure.factor,
            loss: penalty - found.value,
            gradient,
            gradient_error: found.errors.iter().map(|error| error * error).sum::<f64>().sqrt(),
            solver_steps: found.solver_steps,
            ..Evaluation::default()
        }
    }

    /// Memory of a kept state and of a taped step, by the first neighbour list over a flat wall.
    ///
    /// # Errors
    /// Particles without a neighbour list.
    pub fn costs(&self) -> Result<Costs, Error> {
        let state = self.deformation.state::<R>(&vec![0.0; self.deformation.columns]);
        self.dynamics().costs_from(&state).map_err(|e| Error::run(e.to_string(), "another resolution.dx or time.skin"))
    }

    /// The checkpointing schedule for values of `precision`: the fastest within `optimise.memory`, or one of given
    /// segments.
    ///
    /// # Errors
    /// A schedule that would not fit, and a budget that is too small for any.
    pub fn schedule(&self, wanted: &Optimise, precision: Precision) -> Result<Schedule, Error> {
        if self.is_steady || self.differences.is_some() {
            // One state is kept, and nothing is taped.
            return Ok(Schedule::taped(self.steps));
        }
        let (costs, steps) = (self.costs()?, self.steps);
        let budget = wanted.memory;
        let first = match wanted.gradient {
            GradientMode::Truncated => steps - wanted.horizon.min(steps),
            _ => 0,
        };
        // In f32 rounding a state does not change it.
        let rounded = wanted.store == Precision::F32 && precision == Precision::F64;
        let schedule = match (wanted.gradient, wanted.segment) {
            (GradientMode::Taped, _) => Schedule::taped(steps),
            _ if rounded => Schedule::every_state(steps, first, true),
            (_, 0) => Schedule::affordable(steps, first, costs, budget)?,
            (_, segment) => Schedule::truncated(steps, steps - first, segment),
        };
        match schedule.memory(costs) {
            needed if needed > budget.bytes() => {
                Err(does_not_fit(&schedule, costs, needed).allowed(format!("optimise.memory = {budget}")).into())
            }
            _ => Ok(schedule.clipped(wanted.clip)),
        }
    }
}

/// The error for a schedule that exceeds its memory budget.
fn does_not_fit(schedule: &Schedule, costs: Costs, needed: usize) -> BadInput {
    let counts = schedule.counts();
    let state = if schedule.is_rounded() { costs.rounded_state } else { costs.state };
    BadInput::new(format!(
        "the gradient of {} steps ({schedule}) would take about {:.1} MB: {} states of {} kB and {} taped steps of {} kB",
        schedule.steps - schedule.first,
        needed as f64 / 1e6,
        counts.stored_states,
        state / 1000,
        counts.taped_steps,
        costs.tape_step / 1000,
    ))
    .advice(format!(
        "optimise.memory={}, or optimise.gradient=segments optimise.segment=0 optimise.store=f64 (what fits is chosen)",
        rounded_up(needed)
    ))
}

/// Checks that the gradient by every design variable is finite and not zero.
pub fn check_gradient(gradient: &[f64]) -> Result<(), Error> {
    if let Some(k) = gradient.iter().position(|g| !g.is_finite()) {
        return Err(Error::diverged(
            format!("the gradient by design variable {k} is {}", gradient[k]),
            "time.cfl=0.5, a shorter time.end, optimise.clip=10, or optimise.gradient=truncated optimise.horizon=100",
        ));
    }
    if let Some(k) = gradient.iter().position(|g| *g == 0.0) {
        return Err(Error::run(
            format!("design variable {k} received no gradient: nothing that the objective sees depends on it"),
            "a longer time.end, or a later part of the run in objective.window",
        ));
    }
    Ok(())
}
