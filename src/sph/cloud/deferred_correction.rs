//! Slopes of third order, by deferred correction.
//!
//! A steady flow is first solved for with fits of second order, R(x0) = 0 ([`super::equations`]), and then once more with what the slopes of
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
//! In time ([`super::unsteady`]) a step has D of the state before it, in momentum and heat inside and in continuity everywhere, smoothed:
//! with A x+ = b(x, x-) the step of second order and G the means of [`super::smoothing`],
//!
//! ```text
//!   A x+ = b(x, x-) - G D(x),
//! ```
//!
//! and a flow that becomes steady solves R(x) + G D(x) = 0. Without G what changes from particle to particle grows, for R hardly sees it.
//! D is of second order, so G and the state before change it by less than the other errors of a step are.
//!
//! The derivative of steady flows: with multipliers y of the second solution, R'(x)^T y = J', those of the first one are R'(x0)^T y0 = -D'(x0)^T y.

use super::equations::{Bar, Derivatives, Equations, State};
use super::fit::{Coefficients, Stencils, COEFFICIENTS};
use super::smoothing::Smoothing;

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
    pub operators: &'a Coefficients,
}

impl ThirdOrder<'_> {
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

/// What steps in time lack: that of the last state in momentum and heat inside and in continuity, smoothed.
pub struct Lagged<'a> {
    pub stencils: &'a Stencils,
    pub operators: &'a Coefficients,
    /// Means among particles inside, and among all.
    pub smoothing: &'a [Smoothing; 2],
}

/// The equations, and the coefficients of their fits of second order.
type Second<'a> = (&'a Equations, &'a Coefficients);

impl Lagged<'_> {
    /// What the slopes of second order of u, v, p and, with heat, T lack, `[fields][N]`.
    fn lacking(&self, (equations, second): Second<'_>, state: &State) -> Vec<Vec<[f64; 2]>> {
        let (n, fields) = (equations.particles(), state.in_use(equations.diffusivity.is_some()));
        let mut found = self.operators.slopes::<2>(self.stencils, &fields, n);
        for (field, own) in found.iter_mut().zip(second.slopes::<2>(&equations.fits.all, &fields, n)) {
            for (to, own) in field.iter_mut().zip(own) {
                (0..2).for_each(|e| to[e] -= own[e]);
            }
        }
        found
    }

    /// D of a state.
    pub fn defect(&self, second: Second<'_>, state: &State) -> Defect {
        let ((equations, _), [u, v, ..]) = (second, &state.fields);
        let (n, lacking) = (equations.particles(), self.lacking(second, state));
        let carried = |f: usize, i: usize| u[i] * lacking[f][i][0] + v[i] * lacking[f][i][1];
        let heat = |i: usize| if equations.diffusivity.is_some() { carried(3, i) } else { 0.0 };
        let momentum = |i: usize, e: usize| carried(e, i) + lacking[2][i][e];
        let mut inside: Vec<_> = (0..equations.inside).map(|i| [momentum(i, 0), momentum(i, 1), heat(i)]).collect();
        let mut continuity: Vec<_> = (0..n).map(|i| [lacking[0][i][0] + lacking[1][i][1]]).collect();
        self.smoothing[0].apply(&mut inside);
        self.smoothing[1].apply(&mut continuity);
        let mut found = Defect { flow: vec![0.0; 3 * n], heat: vec![0.0; n] };
        continuity.iter().enumerate().for_each(|(i, [continuity])| found.flow[3 * i + 2] = *continuity);
        for (i, [x, y, heat]) in inside.into_iter().enumerate() {
            (found.flow[3 * i], found.flow[3 * i + 1], found.heat[i]) = (x, y, heat);
        }
        found
    }

    /// Adds the cotangents of the state's fields and of its slopes of second order, given those of D, and returns those of the
    /// slopes of third order, `[fields][N]`.
    pub fn pull_back(
        &self,
        second: Second<'_>,
        state: &State,
        bar: &Defect,
        fields: &mut [Vec<f64>; 4],
        derivatives: &mut Derivatives,
    ) -> Vec<Vec<[f64; 2]>> {
        let ((equations, operators), [u, v, ..]) = (second, &state.fields);
        let (n, lacking) = (equations.particles(), self.lacking(second, state));
        let heat = |i: usize| bar.heat.get(i).copied().unwrap_or(0.0);
        let mut inside: Vec<_> =
            (0..equations.inside).map(|i| [bar.flow[3 * i], bar.flow[3 * i + 1], heat(i)]).collect();
        let mut continuity: Vec<_> = (0..n).map(|i| [bar.flow[3 * i + 2]]).collect();
        self.smoothing[0].transposed(&mut inside);
        self.smoothing[1].transposed(&mut continuity);
        let mut slopes = vec![vec![[0.0; 2]; n]; lacking.len()];
        for (i, [continuity]) in continuity.into_iter().enumerate() {
            slopes[0][i][0] += continuity;
            slopes[1][i][1] += continuity;
        }
        for (i, [x, y, heat]) in inside.into_iter().enumerate() {
            for (f, row) in [(0, x), (1, y), (3, heat)].into_iter().filter(|(f, _)| *f < lacking.len()) {
                for (e, along) in [u[i], v[i]].into_iter().enumerate() {
                    slopes[f][i][e] += row * along;
                    fields[e][i] += row * lacking[f][i][e];
                }
            }
            slopes[2][i][0] += x;
            slopes[2][i][1] += y;
        }
        let third = self.operators.slopes_back(self.stencils, &slopes);
        let own = operators.slopes_back(&equations.fits.all, &slopes);
        for (f, (third, own)) in third.into_iter().zip(own).enumerate() {
            fields[f].iter_mut().zip(third.iter().zip(own)).for_each(|(to, (third, own))| *to += third - own);
            for (to, slopes) in derivatives.0[f].iter_mut().zip(&slopes[f]) {
                (0..2).for_each(|e| to[e] -= slopes[e]);
            }
        }
        slopes
    }
}
