//! AdamW (Loshchilov and Hutter 2019) with moments that can be stored.
//!
//! m <- b1 m + (1 - b1) g, v <- b2 v + (1 - b2) g^2, x <- x - lr (m^/(sqrt(v^) + eps) + decay x), with m^ = m/(1 - b1^t) and
//! v^ = v/(1 - b2^t): as optax and LagrangeBench, b1 0.9, b2 0.999, eps 1e-8, decay 1e-8.

use crate::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use candle_core::{DType, Result, Tensor, Var};
use std::ops::Range;

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

struct Update<'a, R> {
    x: Shared<'a, R>,
    m: Shared<'a, R>,
    v: Shared<'a, R>,
    g: &'a [R],
    rate: R,
    decay: R,
    /// 1/(1 - b1^t), 1/(1 - b2^t).
    first: R,
    second: R,
}

impl<R: Real> RowKernel<R> for Update<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let range = rows.start * ROW..self.g.len().min(rows.end * ROW);
        // SAFETY: each range belongs to one iteration.
        let (x, m, v) =
            unsafe { (self.x.slice(range.clone()), self.m.slice(range.clone()), self.v.slice(range.clone())) };
        let g = &self.g[range];
        let [b1, b2, c1, c2, epsilon] =
            [FIRST_DECAY, SECOND_DECAY, 1.0 - FIRST_DECAY, 1.0 - SECOND_DECAY, EPSILON].map(R::of);
        for k in 0..g.len() {
            m[k] = b1 * m[k] + c1 * g[k];
            v[k] = b2 * v[k] + c2 * g[k] * g[k];
            let step = m[k] * self.first / ((v[k] * self.second).sqrt() + epsilon);
            x[k] = x[k] - self.rate * (step + self.decay * x[k]);
        }
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
        for ((parameter, gradient), moments) in parameters.iter().zip(gradients).zip(&mut self.moments) {
            match parameter.dtype() {
                DType::F32 => {
                    self::update::<f32>(parameter, gradient, moments, self.steps, learning_rate, self.weight_decay)?
                }
                _ => self::update::<f64>(parameter, gradient, moments, self.steps, learning_rate, self.weight_decay)?,
            }
        }
        Ok(())
    }
}

fn update<R: Real>(
    parameter: &Var,
    gradient: &Tensor,
    moments: &mut Moments,
    steps: u64,
    learning_rate: f64,
    weight_decay: f64,
) -> Result<()> {
    let numbers = |t: &Tensor| t.flatten_all()?.to_vec1::<R>();
    let (mut x, mut m, mut v) = (numbers(parameter)?, numbers(&moments.first)?, numbers(&moments.second)?);
    let g = numbers(gradient)?;
    let share = |decay: f64| R::of(1.0 / (1.0 - decay.powf(steps as f64)));
    let pass = Update {
        x: Shared::new(&mut x),
        m: Shared::new(&mut m),
        v: Shared::new(&mut v),
        g: &g,
        rate: R::of(learning_rate),
        decay: R::of(weight_decay),
        first: share(FIRST_DECAY),
        second: share(SECOND_DECAY),
    };
    run_rows(&pass, g.len().div_ceil(ROW));
    let tensor = |values: Vec<R>| Tensor::from_vec(values, parameter.shape(), parameter.device());
    parameter.set(&tensor(x)?)?;
    (moments.first, moments.second) = (tensor(m)?, tensor(v)?);
    Ok(())
}

/// max(start factor^(step/interval), least): LagrangeBench's decay.
pub fn learning_rate(start: f64, factor: f64, interval: u64, least: f64, step: u64) -> f64 {
    (start * factor.powf(step as f64 / interval as f64)).max(least)
}
