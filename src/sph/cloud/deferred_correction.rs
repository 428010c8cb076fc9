//! Slopes of third order in a steady flow, by deferred correction.
//!
//! A flow is first solved for with fits of second order, R(x0) = 0 ([`super::equations`]), and then once more with what the slopes of
//! x0 lack,
//!
//! ```text
//!   R(x) + D(x0) = 0,   D(x0) = R3(x0) - R(x0),
//! ```
//!
//! where R3 has the slopes of velocity, pressure and temperature by fits of third order to 36 neighbours. Both solutions have the matrix
//! of second order, so the second one costs little, and its pressure does not oscillate as that of R3(x) = 0 does (Fox 1947; Stetter
//! 1978, "The defect correction principle and discretization methods").
//!
//! Laplacians stay those of second order: with those of third order figures become worse (measured around the bodies of
//! `scripts/random_bodies.py figures --count 14 --seed 4242` and `--seed 9100` with 36 neighbours).
//!
//! The derivative: with multipliers y of the second solution, R'(x)^T y = J', those of the first one are R'(x0)^T y0 = -D'(x0)^T y.

use super::equations::{Bar, Derivatives, Equations, State};
use super::fit::{Coefficients, Stencils, COEFFICIENTS};

/// Neighbours of the fits of third order. (Measured as above, without tau S p in R3: flow rates are 0.12 % off, in the root mean square,
/// with 30, and 0.07 % with 36 and 44.)
pub const NEIGHBOURS: usize = 36;

/// D of one state: what is added to the residuals of momentum and continuity, `[N, 3]`, and of heat, `[N]`.
#[derive(Debug, Clone, PartialEq)]
pub struct Defect {
    pub flow: Vec<f64>,
    pub heat: Vec<f64>,
}

/// The fits of third order at one shape.
pub struct ThirdOrder<'a> {
    pub equations: &'a Equations,
    pub stencils: &'a Stencils,
    pub operators: Coefficients,
}

impl<'a> ThirdOrder<'a> {
    /// Fits at positions `[2][N]`.
    pub fn new(equations: &'a Equations, stencils: &'a Stencils, position: &[Vec<f64>; 2]) -> Self {
        Self { equations, stencils, operators: stencils.coefficients(position) }
    }

    /// Derivatives `d` of second order with slopes of third order.
    fn derivatives(&self, state: &State, d: &Derivatives) -> Derivatives {
        let mut third = d.clone();
        let n = self.equations.particles();
        let fields = state.in_use(self.equations.diffusivity.is_some());
        let slopes = self.operators.slopes::<2>(self.stencils, &fields, n);
        for (to, slopes) in third.0.iter_mut().zip(slopes) {
            to.iter_mut().zip(slopes).for_each(|(to, slope)| to[..2].copy_from_slice(&slope));
        }
        third
    }

    /// D of a state with its derivatives.
    pub fn defect(&self, state: &State, d: &Derivatives) -> Defect {
        let third = self.derivatives(state, d);
        let minus = |a: Vec<f64>, b: Vec<f64>| a.into_iter().zip(b).map(|(a, b)| a - b).collect();
        let of = |d| (self.equations.flow_residual(state, d), self.equations.heat_residual(state, d));
        let (better, own) = (of(&third), of(d));
        Defect { flow: minus(better.0, own.0), heat: minus(better.1, own.1) }
    }

    /// The cotangents of the state, of its derivatives of second order and of the boundary, given those of D.
    pub fn pull_back(
        &self,
        position: &[Vec<f64>; 2],
        (state, d): (&State, &Derivatives),
        flow: &[f64],
        heat: Option<&[f64]>,
    ) -> Bar {
        let (equations, third) = (self.equations, self.derivatives(state, d));
        let new = || Bar::new(equations.particles(), equations.conditions.len());
        let (mut bar, mut better) = (new(), new());
        let negative = |rows: &[f64]| rows.iter().map(|row| -row).collect::<Vec<f64>>();
        equations.pull_back(state, d, &negative(flow), heat.map(negative).as_deref(), &mut bar);
        equations.pull_back(state, &third, flow, heat, &mut better);
        // What both solutions carry: the fields themselves in u . grad.
        let heat = heat.filter(|_| equations.diffusivity.is_some());
        for i in 0..equations.inside {
            let rows = [(0, flow[3 * i]), (1, flow[3 * i + 1])].into_iter().chain(heat.map(|heat| (3, heat[i])));
            for (f, row) in rows {
                (0..2).for_each(|e| bar.fields[e][i] += row * (third.0[f][i][e] - d.0[f][i][e]));
            }
        }
        bar.add_walls(&better);
        bar.viscosity += better.viscosity;
        for (own, better) in bar.derivatives.0.iter_mut().zip(&mut better.derivatives.0) {
            for (own, better) in own.iter_mut().zip(better) {
                (2..COEFFICIENTS).for_each(|k| own[k] += std::mem::take(&mut better[k]));
            }
        }
        let fields = state.in_use(equations.diffusivity.is_some());
        let by_slopes = &better.derivatives.0[..fields.len()];
        for (to, by) in bar.fields.iter_mut().zip(by_slopes) {
            self.operators.pull_back(self.stencils, by, to);
        }
        self.stencils.pull_back(position, &fields, by_slopes, &mut bar.position);
        bar
    }
}
