//! Inputs of the operators of a step besides fields.

use super::blocks::Blocks;
use super::model::Consistent;
use crate::sph::pace::TimeSteps;

/// The model, the tables of the neighbour list and the time steps.
#[derive(Debug)]
pub struct Geometry<'a, R> {
    pub model: &'a Consistent<R>,
    pub blocks: &'a Blocks,
    pub times: TimeSteps,
}

impl<R> Clone for Geometry<'_, R> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<R> Copy for Geometry<'_, R> {}
