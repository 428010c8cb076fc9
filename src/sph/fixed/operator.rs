//! A step as a node of candle's graph.

use super::lattice::Fixed;
use crate::numerics::candle::Operator;
use crate::numerics::lanes::Real;
use candle_core::{Result, Shape};
use std::sync::Arc;

/// state `[6, N]` -> next `[6, N]`.
pub struct FixedStep<R>(pub Arc<Fixed<R>>);

impl<R: Real> Operator<1> for FixedStep<R> {
    type Real = R;
    const NAME: &'static str = "fixed particles";

    fn forward(&self, [state]: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        if state.len() != self.0.state_length() {
            candle_core::bail!("a state of {} numbers where {} belong", state.len(), self.0.state_length());
        }
        let mut next = vec![R::default(); state.len()];
        let mut work = self.0.work();
        self.0.forward(state, &mut next, &mut work);
        self.0.done(work);
        Ok((next, shape.clone()))
    }

    fn adjoint(&self, [state]: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let mut state_bar = vec![R::default(); state.len()];
        let mut work = self.0.work();
        self.0.backward(state, bar, &mut state_bar, &mut work);
        self.0.done(work);
        Ok([Some(state_bar)])
    }
}
