//! Checks of the time step, the number of steps, and the window of an objective.

use crate::config::custom::ShapeEntry;
use crate::config::range::{MAX_STEPS, WHOLE};
use crate::config::scene::Config;
use crate::error::BadInput;

impl Config {
    /// Checks that the objective's window is a part of the run with enough steps.
    pub fn check_window(&self) -> Result<(), BadInput> {
        let (window, duration) = (self.objective.window, self.duration());
        if window > duration * (1.0 + 1e-9) {
            return Err(BadInput::at(
                "objective.window",
                format!("objective.window = {window} is longer than the run"),
            )
            .allowed(format!("0 (last step) ... {duration:.6}, the simulated time"))
            .advice("objective.window=0, or a larger time.end or time.steps"));
        }
        let steps = (window / self.time_step() - 1e-9).ceil().max(0.0) as usize;
        if window > 0.0 && self.objective.samples > steps {
            return Err(BadInput::at(
                "objective.samples",
                format!(
                    "objective.samples = {} is more than the steps in objective.window = {window}",
                    self.objective.samples
                ),
            )
            .allowed(format!("1 ... {steps}"))
            .advice(format!("objective.samples={steps}")));
        }
        Ok(())
    }

    /// Checks that whole periods are asked for of a flow in time only, and fit into it.
    pub(super) fn check_periods(&self) -> Result<(), BadInput> {
        let objective = &self.objective;
        let bad = |key: &str, problem: &str| BadInput::at(key, format!("{key} {problem}"));
        let Some(count) = objective.periods else {
            return match &objective.period {
                None => Ok(()),
                Some(_) => Err(bad("objective.period", "without objective.periods")
                    .allowed("with objective.periods, the number of periods that the objective is averaged over")
                    .advice("objective.periods=4")),
            };
        };
        if self.unsteady().is_none() {
            return Err(bad("objective.periods", "of a flow that is not one of fixed particles in time")
                .allowed("with method.name = fixed and method.flow = unsteady in a scene of your own")
                .advice("method.name=fixed method.flow=unsteady"));
        }
        if objective.window != Self::default().objective.window {
            return Err(bad("objective.periods", "and objective.window are both given")
                .allowed("one of them: whole periods, or a time")
                .advice(format!("leave out objective.window, or objective.window={}", objective.window)));
        }
        let length = self.period(&self.shapes)?;
        match length.filter(|length| count as f64 * length > self.time.end) {
            Some(length) => Err(bad("objective.periods", &format!("= {count} of {length:.6} are longer than the run"))
                .allowed(format!("at most {}, in time.end = {}", (self.time.end / length) as usize, self.time.end))
                .advice(format!("time.end={}", 2.0 * count as f64 * length))),
            None => Ok(()),
        }
    }

    /// The length of a period by `objective.period` with the parameters of the first of `shapes` that has some; none if it is not given.
    ///
    /// # Errors
    /// An invalid formula, one with other parameters, or one that is not a time.
    pub fn period(&self, shapes: &[ShapeEntry]) -> Result<Option<f64>, BadInput> {
        let (key, Some(formula)) = ("objective.period", &self.objective.period) else { return Ok(None) };
        let function = formula.function_of_numbers(key)?;
        let parameters = shapes.iter().map(|shape| &shape.parameters).find(|all| !all.is_empty());
        let parameters = parameters.map_or(&[][..], Vec::as_slice);
        let bad = |problem: String| BadInput::at(key, format!("{key} = \"{}\" {problem}", formula.0));
        if function.parameters() > parameters.len() {
            return Err(bad(format!("has p{}", function.parameters() - 1))
                .allowed("p0, p1, ... of the first shape that has `parameters`"));
        }
        let length = function.with_parameters([0.0; 3], 0.0, parameters);
        match length > 0.0 && length.is_finite() {
            true => Ok(Some(length)),
            false => Err(bad(format!("is {length}")).allowed("a time above 0, such as \"2*PI/p1\"")),
        }
    }

    /// Checks that the time step is a positive number, and the number of steps.
    pub(super) fn check_steps(&self) -> Result<(), BadInput> {
        let limit = self.time_step_limit();
        if !(limit > 0.0 && limit.is_finite()) {
            return Err(BadInput::new(format!("the fluid's numbers allow a time step of {limit}"))
                .allowed("a sound speed, viscosity and thermal diffusivity whose time step is a positive number")
                .advice(format!("`hydrograd scenes {}` shows usual values", self.scene.name())));
        }
        if let Some(step) = self.time.step.filter(|&step| step > limit * (1.0 + WHOLE)) {
            return Err(BadInput::at("time.step", format!("time.step = {step} is too large"))
                .allowed(format!("steps of at most {limit:.4e}, which time.cfl and time.diffusion_number allow"))
                .advice("leave time.step out: the largest steps are taken then"));
        }
        let needed = self.time.end / self.time.step.unwrap_or(limit);
        if self.time.steps.is_none() && needed > MAX_STEPS {
            let limits = self.time_step_limits();
            // With a usual end time it is not the cause of too many steps.
            let (key, value) = match self.time.step {
                _ if self.time.end > 1e3 * self.scene.defaults().time.end => ("time.end", self.time.end),
                Some(step) => ("time.step", step),
                None if limits.diffusive < limits.acoustic => ("time.diffusion_number", self.time.diffusion_number),
                None => ("time.cfl", self.time.cfl),
            };
            let problem = format!("{key} = {value}: the run to t = {} needs {needed:.1e} steps", self.time.end);
            return Err(BadInput::at(key, problem).allowed(format!("at most {MAX_STEPS:.0e} steps")));
        }
        Ok(())
    }
}
