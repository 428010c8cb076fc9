//! Both walls with the same parametrisation. The variables of the bottom wall come first, then those of the top wall.

use super::{Parametrisation, Variables};
use crate::design::shape::Shape;
use crate::error::BadInput;

#[derive(Debug)]
pub struct TwoWalls<P> {
    one: P,
    facts: Variables,
}

impl<P: Parametrisation> TwoWalls<P> {
    pub fn new(one: P) -> Self {
        let facts = Variables {
            name: one.facts().name,
            positions: [one.positions(), one.positions()].concat(),
            limits: one.limits().twice(),
            averages: one.facts().averages.twice(),
        };
        Self { one, facts }
    }

    fn each<'a>(&self, variables: &'a [f64]) -> (&'a [f64], &'a [f64]) {
        variables.split_at(self.one.variables())
    }
}

impl<P: Parametrisation> Parametrisation for TwoWalls<P> {
    fn facts(&self) -> &Variables {
        &self.facts
    }

    /// Height of the bottom wall.
    fn height(&self, variables: &[f64], x: f64, z: f64) -> f64 {
        self.one.height(self.each(variables).0, x, z)
    }

    fn check(&self, variables: &[f64]) -> Result<(), BadInput> {
        let (bottom, top) = self.each(variables);
        self.one.check(bottom)?;
        self.one.check(top).map_err(|bad| bad.place("the top wall"))
    }

    fn sampled(&self, variables: &[f64]) -> Shape {
        let (bottom, top) = self.each(variables);
        Shape { top: Some(self.one.sampled(top).offsets), ..self.one.sampled(bottom) }
    }

    fn penalty(&self, weight: f64, variables: &[f64]) -> (f64, Vec<f64>) {
        let (bottom, top) = self.each(variables);
        let (found, above) = (self.one.penalty(weight, bottom), self.one.penalty(weight, top));
        (found.0 + above.0, [found.1, above.1].concat())
    }
}
