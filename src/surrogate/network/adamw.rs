//! AdamW (Loshchilov and Hutter 2019) with moments that can be stored.
//!
//! m <- b1 m + (1 - b1) g, v <- b2 v + (1 - b2) g^2, x <- x - lr (m^/(sqrt(v^) + eps) + decay x), with m^ = m/(1 - b1^t) and
//! v^ = v/(1 - b2^t): as optax and LagrangeBench, b1 0.9, b2 0.999, eps 1e-8, decay 1e-8.

use crate::numerics::candle::update;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_parts, PartKernel};
use crate::surrogate::network::row::each;
use candle_core::{DType, Result, Tensor, Var};

pub const FIRST_DECAY: f64 = 0.9;
pub const SECOND_DECAY: f64 = 0.999;
pub const EPSILON: f64 = 1e-8;
pub const WEIGHT_DECAY: f64 = 1e-8;

/// Moments of one parameter vector.
#[derive(Debug, Clone)]
pub struct Moments {
    pub first: Tensor,
    pub second: Tensor,
}

#[derive(Debug, Clone)]
pub struct AdamW {
    /// One for each parameter.
    pub moments: Vec<Moments>,
    /// Updates so far, t.
    pub steps: u64,
    pub weight_decay: f64,
}

/// Numbers per row of the sweep.
const ROW: usize = 4096;

/// What happens to each number x of one tensor, given those of two others.
#[derive(Clone, Copy)]
enum Change<R> {
    /// x <- decay x + (1 - decay) a.
    Mean { decay: R, rest: R },
    /// x <- decay x + (1 - decay) a^2.
    Square { decay: R, rest: R },
    /// x <- x - rate (m first/(sqrt(v second) + epsilon) + decay x) with m and v the others.
    Move { rate: R, first: R, second: R, epsilon: R, decay: R },
}

struct Sweep<'a, R> {
    a: &'a [R],
    b: &'a [R],
    change: Change<R>,
}

impl<'a, R: Real> PartKernel<R> for Sweep<'a, R> {
    type Part = &'a mut [R];

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, row: usize, x: &mut &'a mut [R]) {
        let (a, b) = (&self.a[row * ROW..][..x.len()], &self.b[row * ROW..][..x.len()]);
        match self.change {
            Change::Mean { decay, rest } => {
                let (decay, rest) = (L::splat(decay), L::splat(rest));
                each::<L, 1>(x, [a], |x, [a]| decay * x + rest * a);
            }
            Change::Square { decay, rest } => {
                let (decay, rest) = (L::splat(decay), L::splat(rest));
                each::<L, 1>(x, [a], |x, [a]| decay * x + rest * a * a);
            }
            Change::Move { rate, first, second, epsilon, decay } => {
                let (rate, first, second) = (L::splat(rate), L::splat(first), L::splat(second));
                let (epsilon, decay) = (L::splat(epsilon), L::splat(decay));
                each::<L, 2>(x, [a, b], |x, [m, v]| {
                    let step = m * first / ((v * second).sqrt() + epsilon);
                    x - rate * (step + decay * x)
                });
            }
        }
    }
}

impl<R: Real> Change<R> {
    fn apply(self, x: &Tensor, a: &Tensor, b: &Tensor) -> Result<()> {
        update("adamw", x, a, b, |x: &mut [R], a, b| {
            run_parts(&Sweep { a, b, change: self }, x.chunks_mut(ROW));
        })
    }
}

impl AdamW {
    pub fn new(parameters: &[Var]) -> Result<Self> {
        let moments = parameters
            .iter()
            .map(|p| Ok(Moments { first: p.zeros_like()?.detach(), second: p.zeros_like()?.detach() }))
            .collect::<Result<_>>()?;
        Ok(Self { moments, steps: 0, weight_decay: WEIGHT_DECAY })
    }

    /// One update; `gradients` stand in the order of the parameters.
    pub fn step(&mut self, parameters: &[Var], gradients: &[Tensor], learning_rate: f64) -> Result<()> {
        self.steps += 1;
        for (k, (parameter, gradient)) in parameters.iter().zip(gradients).enumerate() {
            match parameter.dtype() {
                DType::F32 => self.update::<f32>(parameter, gradient, k, learning_rate)?,
                _ => self.update::<f64>(parameter, gradient, k, learning_rate)?,
            }
        }
        Ok(())
    }

    fn update<R: Real>(&self, parameter: &Var, gradient: &Tensor, k: usize, learning_rate: f64) -> Result<()> {
        let share = |decay: f64| R::of(1.0 / (1.0 - decay.powf(self.steps as f64)));
        let (first, second) = (share(FIRST_DECAY), share(SECOND_DECAY));
        let (rate, decay) = (R::of(learning_rate), R::of(self.weight_decay));
        let [b1, b2, c1, c2, epsilon] =
            [FIRST_DECAY, SECOND_DECAY, 1.0 - FIRST_DECAY, 1.0 - SECOND_DECAY, EPSILON].map(R::of);
        let (g, Moments { first: m, second: v }) = (gradient.contiguous()?.detach(), &self.moments[k]);
        Change::Mean { decay: b1, rest: c1 }.apply(m, &g, &g)?;
        Change::Square { decay: b2, rest: c2 }.apply(v, &g, &g)?;
        Change::Move { rate, first, second, epsilon, decay }.apply(parameter, m, v)
    }
}

/// max(start factor^(step/interval), least): LagrangeBench's decay.
pub fn learning_rate(start: f64, factor: f64, interval: u64, least: f64, step: u64) -> f64 {
    (start * factor.powf(step as f64 / interval as f64)).max(least)
}
