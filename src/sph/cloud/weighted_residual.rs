//! How far figures of a steady flow are off, found from the flow alone: by dual-weighted residuals.
//!
//! With multipliers y of a figure J, R'(x)^T y = J'(x), and the residual R3 of the solution x in finer operators,
//!
//! ```text
//!   J(x) - J  ~  sum_i y_i . R3(x)_i
//! ```
//!
//! (Becker and Rannacher 2001, "An optimal control approach to a posteriori error estimation in finite element methods"). Here R3 has
//! slopes and Laplacians of [`super::deferred_correction`]'s fits of third order to 36 neighbours, in two parts: the residual with its
//! slopes, and what its Laplacians change of that. The sum over the first is, to three digits, what a deferred correction changes a figure by.
//! That over the second is as large as the error but of either sign, for these Laplacians are hardly better than those of second order.
//!
//! Either sum may vanish by chance where its terms do not, so that the magnitudes of the terms say more: what each particle has in them
//! shows where the error comes from. (What share of all this errors are, and how often: [`crate::scene::solution_error`].)

use super::deferred_correction::ThirdOrder;
use super::equations::{Derivatives, Equations, State};
use super::fit::LEFT;

/// Residuals of momentum, continuity and, with heat, heat, `[N][4]`.
type Rows = Vec<[f64; 4]>;

/// The two parts of the residual of a state in fits of third order.
pub struct Residual {
    slopes: Rows,
    laplacians: Rows,
}

/// A residual with the multipliers of a figure.
#[derive(Debug, Clone, PartialEq)]
pub struct Weighted {
    /// Its sums over all particles, of slopes and of Laplacians.
    pub slopes: f64,
    pub laplacians: f64,
    /// The magnitudes of both at each particle, `[N]`.
    pub magnitude: Vec<f64>,
}

/// The residuals of a state with these derivatives.
fn rows(equations: &Equations, state: &State, d: &Derivatives) -> Rows {
    let heat = match equations.diffusivity {
        Some(_) => equations.heat_residual(state, d),
        None => vec![0.0; equations.particles()],
    };
    let flow = equations.flow_residual(state, d);
    flow.chunks_exact(3).zip(heat).map(|(flow, heat)| [flow[0], flow[1], flow[2], heat]).collect()
}

impl Residual {
    /// `d`: derivatives of second order of the state.
    pub fn new(third: &ThirdOrder<'_>, state: &State, d: &Derivatives) -> Self {
        let (equations, mut better) = (third.equations, d.clone());
        let fields = state.in_use(equations.diffusivity.is_some());
        let found: Vec<Vec<_>> = fields
            .iter()
            .map(|field| (0..field.len()).map(|i| third.operators.derivatives(third.stencils, i, field)).collect())
            .collect();
        // Slopes first, then second derivatives; S stays that of the fits of second order, as in R.
        let mut replace = |derivatives: std::ops::Range<usize>| {
            for (to, found) in better.0.iter_mut().zip(&found) {
                for (to, found) in to.iter_mut().zip(found) {
                    to[derivatives.clone()].copy_from_slice(&found[derivatives.clone()]);
                }
            }
            rows(equations, state, &better)
        };
        let slopes = replace(0..2);
        let both = replace(2..LEFT);
        let minus = |(a, b): ([f64; 4], &[f64; 4])| std::array::from_fn(|k| a[k] - b[k]);
        Self { laplacians: both.into_iter().zip(&slopes).map(minus).collect(), slopes }
    }

    /// With the multipliers of momentum and continuity, `[N, 3]` and more behind them, and those of heat, `[N]`.
    pub fn weighted(&self, flow: &[f64], heat: Option<&[f64]>) -> Weighted {
        let mut all = Weighted { slopes: 0.0, laplacians: 0.0, magnitude: vec![] };
        for (i, (slopes, laplacians)) in self.slopes.iter().zip(&self.laplacians).enumerate() {
            let multipliers = [flow[3 * i], flow[3 * i + 1], flow[3 * i + 2], heat.map_or(0.0, |heat| heat[i])];
            let with = |rows: &[f64; 4]| -> f64 { rows.iter().zip(multipliers).map(|(row, y)| row * y).sum() };
            let (slopes, laplacians) = (with(slopes), with(laplacians));
            all.slopes += slopes;
            all.laplacians += laplacians;
            all.magnitude.push(slopes.abs() + laplacians.abs());
        }
        all
    }
}
