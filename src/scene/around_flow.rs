//! The flow around shapes, steady or in time, in two or three dimensions, as a function of their numbers: objective and limits with
//! their gradients.

use super::around_bodies::AroundBodies;
use super::around_in_time::{History, Of};
use super::around_shapes::{AroundShapes, Judged};
use crate::config::custom::Part;
use crate::config::scene::{Config, LimitEntry};
use crate::error::Error;
use crate::sph::cloud::problem::Solution;
use std::f64::consts::PI;

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

impl Designed for AroundShapes {
    fn first(&self) -> Vec<f64> {
        self.first()
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
        let ((shape, number), cloud) = (self.wanted[variable], &self.flow.cloud);
        (cloud.ground.outlines[shape].parts[number], (cloud.places.polygons[shape].area() / PI).sqrt())
    }
}

impl Designed for AroundBodies {
    fn first(&self) -> Vec<f64> {
        self.first()
    }

    fn value(&mut self, variables: &[f64], _: &mut dyn FnMut(f64)) -> Result<f64, Error> {
        let solution = self.solve(variables)?;
        Ok(self.objective(&solution).0)
    }

    fn judge(
        &mut self,
        variables: &[f64],
        limits: &[usize],
        _: &mut dyn FnMut(f64),
    ) -> Result<(Judged, Vec<Judged>), Error> {
        let solution = self.solve(variables)?;
        let objective = self.judged(&solution)?;
        let limits = limits.iter().map(|&limit| self.judged_limit(&solution, variables, limit));
        Ok((objective, limits.collect::<Result<_, _>>()?))
    }

    fn part(&self, variable: usize) -> (Part, f64) {
        let ((shape, number), ground) = (self.wanted[variable], &self.flow.cloud.ground);
        (ground.surfaces[shape].parts[number], ground.surfaces[shape].size())
    }
}

/// The flow for some variables.
pub enum Flowed {
    Steady(Box<Solution>),
    InTime(History),
}

impl AroundShapes {
    /// The flow for these variables. One in time begins with `[initial]` in each case, so that it is a function of them alone, and takes
    /// steps of the given sizes, or of those that it chooses. `progress` gets the share of the run that is done.
    ///
    /// # Errors
    /// A cloud that folds, a flow that diverges or does not become steady.
    pub fn flow(
        &mut self,
        variables: &[f64],
        sizes: Option<&[f64]>,
        progress: &mut dyn FnMut(f64),
    ) -> Result<Flowed, Error> {
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
    pub fn objective_of(&self, flow: &Flowed, variables: &[f64]) -> Result<f64, Error> {
        match flow {
            Flowed::Steady(solution) => Ok(self.objective(solution).0),
            Flowed::InTime(history) => Ok(history.objective(&self.window(variables, history)?)),
        }
    }

    /// The objective of a flow with its gradient.
    ///
    /// # Errors
    /// A flow without whole periods, an adjoint that cannot be solved, a derivative that is not finite.
    pub fn judged(&mut self, flow: &Flowed, variables: &[f64]) -> Result<Judged, Error> {
        let value = self.objective_of(flow, variables)?;
        let by_variables = match flow {
            Flowed::Steady(solution) => {
                let (_, terms) = self.objective(solution);
                self.gradient(solution, &terms)?
            }
            Flowed::InTime(history) => self.march_gradient(variables, history, Of::Objective)?,
        };
        Ok(Judged { value, by_variables })
    }

    /// The same of what a limit is about.
    ///
    /// # Errors
    /// As [`Self::judged`].
    pub fn judged_limit(&mut self, flow: &Flowed, variables: &[f64], limit: usize) -> Result<Judged, Error> {
        let LimitEntry { kind, ref shapes, .. } = self.config().limits[limit];
        if let Some(judged) = self.of_shapes(kind, shapes, variables) {
            return Ok(judged);
        }
        let asked = self.config().limits[limit].asked();
        Ok(match flow {
            Flowed::Steady(solution) => {
                let (value, terms) = self.terms(solution, &asked);
                Judged { value, by_variables: self.gradient(solution, &terms)? }
            }
            Flowed::InTime(history) => {
                let window = self.window(variables, history)?;
                let value = window.mean(&history.values(&|moment| moment.limits[limit]));
                Judged { value, by_variables: self.march_gradient(variables, history, Of::Limit(limit))? }
            }
        })
    }
}
