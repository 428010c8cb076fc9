//! The steady state as a node of candle's graph.

use super::lattice::OverRelief;
use crate::numerics::candle::Operator;
use crate::numerics::lanes::Real;
use crate::sph::cloud::steady::NoSteadyState;
use candle_core::{Result, Shape};
use std::marker::PhantomData;
use std::sync::Arc;

/// state `[8, N]` -> steady state `[8, N]`, which depends on positions and normals alone.
pub struct Settled<R> {
    pub lattice: Arc<OverRelief>,
    pub of: PhantomData<R>,
}

pub fn wide<R: Real>(numbers: &[R]) -> Vec<f64> {
    numbers.iter().map(|x| x.f64()).collect()
}

pub fn narrow<R: Real>(numbers: &[f64]) -> Vec<R> {
    numbers.iter().map(|&x| R::of(x)).collect()
}

/// Why there is no steady state, in words.
pub fn told(why: &NoSteadyState) -> String {
    match why {
        NoSteadyState::Diverged { residual } => {
            format!(
                "the flow over the wall does not become steady: Newton's method ends at a residual of {residual:.1e}"
            )
        }
        NoSteadyState::Adjoint => "the transposed equations of the steady flow are not solved".into(),
        NoSteadyState::Singular | NoSteadyState::Unsolved | NoSteadyState::Unbounded { .. } => {
            "the equations of the steady flow are singular".into()
        }
    }
}

impl<R: Real> Operator<1> for Settled<R> {
    type Real = R;
    const NAME: &'static str = "steady flow over a relief";

    fn forward(&self, [state]: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let mut found = wide(state);
        match self.lattice.settle(&mut found) {
            Ok(_) => Ok((narrow(&found), shape.clone())),
            Err(why) => candle_core::bail!("{}", told(&why)),
        }
    }

    fn adjoint(&self, _: [&[R]; 1], settled: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        match self.lattice.pull_back(&wide(settled), &wide(bar)) {
            Ok(found) => Ok([Some(narrow(&found))]),
            Err(why) => candle_core::bail!("{}", told(&why)),
        }
    }
}
