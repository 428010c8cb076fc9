//! The flow around shapes, steady or in time, in two or three dimensions, as a function of their numbers: objective and limits with
//! their gradients.

use super::around_bodies::AroundBodies;
use super::around_shapes::{has_objective, AroundShapes, Judged};
use super::history::{Derivative, History, Of, Watch};
use super::particle_fields::ParticleFields;
use super::periods::{Period, TooFew, Window};
use crate::config::custom::Part;
use crate::config::scene::{Asked, Config, LimitEntry, ObjectiveKind};
use crate::error::{BadInput, Error};
use crate::sph::cloud::figures::Figure;

/// A flow as a function of the variables of its configuration.
pub trait Designed {
    /// The variables of the configuration.
    fn first(&self) -> Vec<f64>;
    /// The objective. `progress` gets the share of a flow in time that is done.
    ///
    /// # Errors
    /// A flow that cannot be had.
    fn value(&mut self, variables: &[f64], progress: &mut dyn FnMut(f64)) -> Result<f64, Error>;
    /// The objective, and what each of `limits` is about, with their derivatives.
    ///
    /// # Errors
    /// A flow or an adjoint that cannot be had.
    fn judge(
        &mut self,
        variables: &[f64],
        limits: &[usize],
        progress: &mut dyn FnMut(f64),
    ) -> Result<(Judged, Vec<Judged>), Error>;
    /// What a variable is, and a typical length of its shape.
    fn part(&self, variable: usize) -> (Part, f64);
}

impl dyn Designed {
    /// That of a configuration of fixed particles around shapes.
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn of_config(config: &Config) -> Result<Box<Self>, Error> {
        Ok(match config.is_around_bodies() {
            true => Box::new(AroundBodies::new(config)?),
            false => Box::new(AroundShapes::new(config)?),
        })
    }
}

impl<A: Around> Designed for A {
    fn first(&self) -> Vec<f64> {
        Around::first(self)
    }

    fn value(&mut self, variables: &[f64], progress: &mut dyn FnMut(f64)) -> Result<f64, Error> {
        let flow = self.flow(variables, None, progress)?;
        self.objective_of(&flow, variables)
    }

    fn judge(
        &mut self,
        variables: &[f64],
        limits: &[usize],
        progress: &mut dyn FnMut(f64),
    ) -> Result<(Judged, Vec<Judged>), Error> {
        let flow = self.flow(variables, None, progress)?;
        let objective = self.judged(&flow, variables)?;
        let limits = limits.iter().map(|&limit| self.judged_limit(&flow, variables, limit));
        Ok((objective, limits.collect::<Result<_, _>>()?))
    }

    fn part(&self, variable: usize) -> (Part, f64) {
        Around::part(self, variable)
    }
}

/// The flow for some variables: a steady one, or one in time.
pub enum Flowed<S> {
    Steady(Box<S>),
    InTime(History),
}

/// The flow around the shapes of a configuration in two or three dimensions.
pub trait Around {
    /// A flow at one time.
    type Solution;

    fn config(&self) -> &Config;
    /// The variables of the configuration.
    fn first(&self) -> Vec<f64>;
    fn particles(&self) -> usize;
    /// The spacing on surfaces.
    fn surface(&self) -> f64;
    /// What a variable is, and a typical length of its shape.
    fn part(&self, variable: usize) -> (Part, f64);
    /// The steady flow for these variables.
    ///
    /// # Errors
    /// A cloud that folds, and a flow that does not become steady.
    fn solve(&mut self, variables: &[f64]) -> Result<Self::Solution, Error>;
    /// The flow in time for these variables, from `[initial]` to `time.end`; `sizes`: those of the steps of an earlier run. `watch` gets
    /// each moment and its solution, whose derivatives are those at the boundary and where figures are read.
    ///
    /// # Errors
    /// A cloud that folds, a flow that diverges; [`Error::Stopped`].
    fn march(
        &self,
        variables: &[f64],
        sizes: Option<&[f64]>,
        watch: Watch<'_, Self::Solution>,
    ) -> Result<(History, Self::Solution), Error>;
    /// The derivative along the steps of a history.
    ///
    /// # Errors
    /// As [`Self::march`] and [`Self::window`].
    fn march_gradient(&self, variables: &[f64], history: &History, of: Of<'_>) -> Result<Derivative, Error>;
    /// The velocity on `output.grid`, `[points, D]`, not a number inside of shapes; none without a grid.
    fn velocity_on_grid(&self, _solution: &Self::Solution) -> Option<Vec<f64>> {
        None
    }
    /// A figure per density, heat per density and heat capacity.
    fn measured(&self, solution: &Self::Solution, figure: Figure) -> f64;
    /// Points of probes, `[probes][D]`.
    fn probes(&self) -> Vec<&[f64]>;
    /// The shapes that an objective is about which names none.
    fn judged_shapes(&self) -> Vec<usize>;
    /// The derivative of weighted figures of a steady flow.
    ///
    /// # Errors
    /// A transposed system that cannot be solved, and a derivative that is not finite.
    fn gradient(&mut self, solution: &Self::Solution, terms: &[(Figure, f64)]) -> Result<Derivative, Error>;
    /// Value and derivative of a limit that needs no flow; none for other kinds.
    fn of_shapes(&self, kind: ObjectiveKind, shapes: &[usize], variables: &[f64]) -> Option<Judged>;
    /// The fastest particle.
    fn fastest(&self, solution: &Self::Solution) -> f64;
    /// The particles with their fields, for files and pictures.
    fn fields(&self, solution: &Self::Solution) -> ParticleFields;

    /// Factors that give figures their units: forces have the density, heat has density and heat capacity.
    fn unit(&self, figure: Figure) -> f64 {
        let (fluid, pressure) = (&self.config().fluid, self.config().dimension());
        match figure {
            Figure::FlowRate => 1.0,
            Figure::Probe { field, .. } if field != pressure => 1.0,
            Figure::Heat { .. } | Figure::HeatOutflow => fluid.density * fluid.heat_capacity,
            _ => fluid.density,
        }
    }

    /// A figure in the units of the scene.
    fn value(&self, solution: &Self::Solution, figure: Figure) -> f64 {
        let temperature = self.config().dimension() + 1;
        let reference = match figure {
            Figure::Probe { field, .. } if field == temperature => self.config().fluid.inlet_temperature,
            _ => 0.0,
        };
        reference + self.unit(figure) * self.measured(solution, figure)
    }

    /// The figures whose sum a kind of objective is.
    fn figures(&self, asked: &Asked) -> Vec<Figure> {
        let pressure = self.config().dimension();
        let probe = |field: usize| {
            let probe = self.probes().into_iter().position(|place| asked.at.as_deref() == Some(place));
            probe.map(|probe| Figure::Probe { field, probe }).into_iter().collect()
        };
        let all = if asked.shapes.is_empty() { self.judged_shapes() } else { asked.shapes.clone() };
        let each = |of: &dyn Fn(usize) -> Figure| all.iter().map(|&shape| of(shape)).collect();
        match asked.kind {
            ObjectiveKind::Pressure => probe(pressure),
            ObjectiveKind::Temperature => probe(pressure + 1),
            ObjectiveKind::VelocityX => probe(0),
            ObjectiveKind::VelocityY => probe(1),
            ObjectiveKind::VelocityZ => probe(2),
            ObjectiveKind::Drag => each(&|shape| Figure::Force { shape, along: 0 }),
            ObjectiveKind::Lift => each(&|shape| Figure::Force { shape, along: 1 }),
            ObjectiveKind::Torque => each(&|shape| Figure::Torque { shape }),
            ObjectiveKind::ShapeHeat => each(&|shape| Figure::Heat { shape }),
            ObjectiveKind::HeatOutflow => vec![Figure::HeatOutflow],
            ObjectiveKind::PressureDrop => vec![Figure::PressureDrop],
            ObjectiveKind::Dissipation => vec![Figure::Dissipation],
            _ => vec![Figure::FlowRate],
        }
    }

    /// Whether the objective can be told: a scene without variables may have another scene's, which is about heat.
    fn has_objective(&self) -> bool {
        has_objective(self.config())
    }

    /// Checks that the flow is a steady one.
    ///
    /// # Errors
    /// A flow in time.
    fn check_steady(&self) -> Result<(), BadInput> {
        match self.config().unsteady() {
            None => Ok(()),
            Some(_) => {
                Err(BadInput::at("method.flow", "method.flow = unsteady, and this needs a steady flow".to_string())
                    .allowed(
                        "steady; of a flow in time simulate, optimize, verify, and check-gradient for its derivative",
                    )
                    .advice("method.flow=steady"))
            }
        }
    }

    /// The value of a kind of objective and its terms: figures with the derivative of the value by each.
    fn terms(&self, solution: &Self::Solution, asked: &Asked) -> (f64, Vec<(Figure, f64)>) {
        let sum = |asked: &Asked| -> f64 { self.figures(asked).iter().map(|&one| self.value(solution, one)).sum() };
        let part = |asked: &Asked, weight: f64| -> Vec<(Figure, f64)> {
            self.figures(asked).into_iter().map(|figure| (figure, weight * self.unit(figure))).collect()
        };
        if asked.kind == ObjectiveKind::LiftOverDrag {
            let [of_lift, of_drag] =
                [ObjectiveKind::Lift, ObjectiveKind::Drag].map(|kind| Asked { kind, ..asked.clone() });
            let (lift, drag) = (sum(&of_lift), sum(&of_drag));
            let terms = [part(&of_lift, 1.0 / drag), part(&of_drag, -lift / (drag * drag))].concat();
            return (lift / drag, terms);
        }
        (sum(asked), part(asked, 1.0))
    }

    /// The objective's value and terms.
    fn objective(&self, solution: &Self::Solution) -> (f64, Vec<(Figure, f64)>) {
        let objective = &self.config().objective;
        if objective.terms.is_empty() {
            return self.terms(solution, &objective.asked());
        }
        let mut all = (0.0, vec![]);
        for term in &objective.terms {
            let (value, terms) = self.terms(solution, &term.asked());
            all.0 += term.weight * value;
            all.1.extend(terms.into_iter().map(|(figure, weight)| (figure, term.weight * weight)));
        }
        all
    }

    /// The part of a run over which the objective is averaged.
    ///
    /// # Errors
    /// Fewer whole periods than `objective.periods`.
    fn window(&self, variables: &[f64], history: &History) -> Result<Window, Error> {
        let (config, times) = (self.config(), history.times());
        let end = config.time.end;
        let Some(count) = config.objective.periods else {
            return Ok(Window::since(&times, end - config.objective.window.min(end)));
        };
        let period = self.period(variables)?;
        let found = match &period {
            Some(period) => Window::of_length(&times, count, period),
            None => Window::of_course(&times, &history.values(&|moment| moment.objective), count),
        };
        found.map_err(|TooFew(most)| {
            let (what, otherwise) = match period {
                Some(Period { length, .. }) => (format!("only {most} of {length:.6} fit into the run"), ""),
                None => (
                    format!("the objective rises through its mean only so often that the run has {most}"),
                    ", or objective.period where a force gives it, or objective.window",
                ),
            };
            let advice = format!("time.end={}{otherwise}", 2.0 * end);
            Error::run(format!("there are no {count} whole periods (objective.periods): {what}"), advice)
        })
    }

    /// The whole last half of a run, where there is no other window.
    fn last_half(&self, history: &History) -> Window {
        Window::since(&history.times(), 0.5 * self.config().time.end)
    }

    /// `objective.period` for these variables.
    ///
    /// # Errors
    /// A period that is no length.
    fn period(&self, variables: &[f64]) -> Result<Option<Period>, Error> {
        let config = self.config();
        let at = |variables: &[f64]| config.period(&config.with_shape_values(variables).shapes);
        let Some(length) = at(variables)? else { return Ok(None) };
        let mut by_variables = vec![0.0; variables.len()];
        for (k, by) in by_variables.iter_mut().enumerate() {
            if !matches!(self.part(k).0, Part::Parameter(_)) {
                continue;
            }
            let step = 1e-5 * variables[k].abs().max(1e-3);
            let moved = |sign: f64| {
                let mut moved = variables.to_vec();
                moved[k] += sign * step;
                at(&moved).map(|length| length.unwrap_or(f64::NAN))
            };
            *by = (moved(1.0)? - moved(-1.0)?) / (2.0 * step);
        }
        Ok(Some(Period { length, by_variables }))
    }

    /// The flow for these variables. One in time begins with `[initial]` in each case, so that it is a function of them alone, and takes
    /// steps of the given sizes, or of those that it chooses. `progress` gets the share of the run that is done.
    ///
    /// # Errors
    /// A cloud that folds, a flow that diverges or does not become steady.
    fn flow(
        &mut self,
        variables: &[f64],
        sizes: Option<&[f64]>,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Flowed<Self::Solution>, Error> {
        let end = self.config().time.end;
        Ok(match self.config().unsteady() {
            None => Flowed::Steady(Box::new(self.solve(variables)?)),
            Some(_) => {
                let mut watch = |share: f64| {
                    progress(share);
                    Ok(())
                };
                Flowed::InTime(self.march(variables, sizes, &mut |moment, _| watch(moment.time / end))?.0)
            }
        })
    }

    /// The objective of a flow.
    ///
    /// # Errors
    /// A flow without whole periods.
    fn objective_of(&self, flow: &Flowed<Self::Solution>, variables: &[f64]) -> Result<f64, Error> {
        let value = match flow {
            Flowed::Steady(solution) => self.objective(solution).0,
            Flowed::InTime(history) => history.objective(&self.window(variables, history)?),
        };
        if !value.is_finite() {
            return Err(Error::run(
                "the objective is not a number: lift over drag where there is no drag?",
                "objective.kind=drag, or something that moves the fluid past the shapes",
            ));
        }
        Ok(value)
    }

    /// The objective of a flow with its gradient.
    ///
    /// # Errors
    /// A flow without whole periods, an adjoint that cannot be solved, a derivative that is not finite.
    fn judged(&mut self, flow: &Flowed<Self::Solution>, variables: &[f64]) -> Result<Judged, Error> {
        let value = self.objective_of(flow, variables)?;
        let by_variables = match flow {
            Flowed::Steady(solution) => {
                let (_, terms) = self.objective(solution);
                self.gradient(solution, &terms)?.by_variables
            }
            Flowed::InTime(history) => self.march_gradient(variables, history, Of::Objective)?.by_variables,
        };
        Ok(Judged { value, by_variables })
    }

    /// The same of what a limit is about.
    ///
    /// # Errors
    /// As [`Self::judged`].
    fn judged_limit(
        &mut self,
        flow: &Flowed<Self::Solution>,
        variables: &[f64],
        limit: usize,
    ) -> Result<Judged, Error> {
        let LimitEntry { kind, ref shapes, .. } = self.config().limits[limit];
        if let Some(judged) = self.of_shapes(kind, shapes, variables) {
            return Ok(judged);
        }
        let asked = self.config().limits[limit].asked();
        Ok(match flow {
            Flowed::Steady(solution) => {
                let (value, terms) = self.terms(solution, &asked);
                Judged { value, by_variables: self.gradient(solution, &terms)?.by_variables }
            }
            Flowed::InTime(history) => {
                let window = self.window(variables, history)?;
                let value = window.mean(&history.values(&|moment| moment.limits[limit]));
                Judged { value, by_variables: self.march_gradient(variables, history, Of::Limit(limit))?.by_variables }
            }
        })
    }
}
