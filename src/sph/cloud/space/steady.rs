//! The steady flow in space by Newton's method, whose linear systems are solved by GMRES with incomplete factors.
//!
//! The numbers of the whole flow (lambda, a drive) and what fixes them (the mean of the pressure, a flow rate) are a border of the
//! matrix, see [`super::super::steady`]. Heat is solved for behind the flow; with buoyancy it acts on it, and both are solved for together
//! ([`super::coupled`]).

use super::super::fit::{Coefficients, COEFFICIENTS_3D as C};
use super::super::steady::{largest, Held, NoSteadyState};
use super::coupled::Coupled;
use super::equations::{Derivatives, Equations, State, FLOW, PRESSURE, TEMPERATURE};
use super::linear::{heat_matrix, Border, Linear, System};
use super::scalar::Scalar;
use crate::numerics::sparse_lu::Order;
use std::sync::Arc;

/// The flow rate as a linear function of the state: its value and derivative by u, v, w, p, `[N, 4]`.
pub trait FlowRate {
    fn value(&self, equations: &Equations, state: &State, d: &Derivatives) -> f64;
    fn by_state(&self, equations: &Equations, operators: &Coefficients<C>) -> Vec<f64>;
}

const STEPS: usize = 25;
/// The largest residual of a steady state, in that of a flow at rest.
const TOLERANCE: f64 = 1e-9;
/// Relative residual of an adjoint.
const ADJOINT: f64 = 1e-10;

/// How much work was done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    pub steps: usize,
    pub iterations: usize,
    /// Bytes of the flow's matrix and its incomplete factors.
    pub bytes: usize,
}

/// A steady solver for one cloud.
pub struct Solver {
    pub equations: Equations,
    pub threads: usize,
    /// The order in which the whole matrix is factorised; none: its parts are, approximately.
    pub order: Option<Arc<Order>>,
    pub counts: Counts,
}

pub(super) type Drive<'a> = Option<(&'a Held, &'a dyn FlowRate)>;

impl Solver {
    pub fn new(equations: Equations, threads: usize) -> Self {
        Self { equations, threads, order: None, counts: Counts::default() }
    }

    /// The weight of continuity beside momentum in the norm of residuals: momenta diffuse at this rate over a stencil.
    fn weight(&self) -> f64 {
        self.equations.viscosity / self.equations.fits.all.scale(0)
    }

    /// The same of heat with buoyancy: the acceleration by the temperature that a residual makes over a stencil, and farther.
    fn heat_weight(&self) -> f64 {
        let (Some(buoyancy), Some(alpha)) = (self.equations.buoyancy, self.equations.diffusivity) else { return 1.0 };
        let size = buoyancy.by.iter().map(|x| x * x).sum::<f64>().sqrt();
        size * self.equations.fits.all.scale(0).powi(2) / alpha
    }

    /// Columns, rows and corner of the border.
    pub(super) fn border(
        &self,
        state: &State,
        d: &Derivatives,
        operators: &Coefficients<C>,
        held: Drive<'_>,
    ) -> Border {
        let (equations, n) = (&self.equations, self.equations.particles());
        let (mut columns, mut rows) = (vec![], vec![]);
        if !equations.gives_pressure() {
            let of = |value: f64| -> Vec<f64> {
                (0..FLOW * n).map(|k| if k % FLOW == PRESSURE { value } else { 0.0 }).collect()
            };
            columns.push(of(1.0));
            rows.push(of(1.0 / n as f64));
        }
        if let Some((held, rate)) = held {
            let column = (0..FLOW * n).map(|k| if k % FLOW == 0 && k / FLOW < equations.inside { -1.0 } else { 0.0 });
            columns.push(column.collect());
            let mut row = rate.by_state(equations, operators);
            if let Held::Power { .. } = held {
                let push = equations.push(state, 0);
                row.iter_mut().for_each(|x| *x *= push);
            }
            rows.push(row);
        }
        let m = rows.len();
        let mut corner = vec![vec![0.0; m]; m];
        if let Some((Held::Power { .. }, rate)) = held {
            corner[m - 1][m - 1] = rate.value(equations, state, d);
        }
        [columns, rows, corner]
    }

    fn residual(&self, state: &State, d: &Derivatives, held: Drive<'_>) -> Vec<f64> {
        let mut residual = self.equations.flow_residual(state, d);
        if !self.equations.gives_pressure() {
            residual.push(state.fields[PRESSURE].iter().sum::<f64>() / self.equations.particles() as f64);
        }
        if let Some((held, rate)) = held {
            let flow = rate.value(&self.equations, state, d);
            residual.push(match held {
                Held::FlowRate(wanted) => flow - wanted,
                Held::Power { power, length } => self.equations.push(state, 0) * flow - power / length,
            });
        }
        residual
    }

    /// Those of all unknowns that are solved for together: with buoyancy also `[N]` of the heat.
    fn all_residuals(&self, state: &State, d: &Derivatives, held: Drive<'_>) -> Vec<f64> {
        let mut residual = self.residual(state, d, held);
        if self.equations.buoyancy.is_some() {
            residual.extend(self.equations.heat_residual(state, d));
        }
        residual
    }

    /// Finds the steady flow and its temperature, starting from `state`.
    ///
    /// # Errors
    /// No convergence.
    pub fn settle(
        &mut self,
        operators: &Coefficients<C>,
        state: &mut State,
        held: Drive<'_>,
    ) -> Result<(), NoSteadyState> {
        let n = self.equations.particles();
        let rest = State { drive: state.drive, ..State::at_rest(n) };
        let at_rest = self.all_residuals(&rest, &Derivatives::zeros(n), held);
        let scale = largest(&at_rest).max(f64::MIN_POSITIVE);
        let mut last = f64::INFINITY;
        for _ in 0..STEPS {
            let d = self.equations.derivatives(operators, state);
            let residual = self.all_residuals(state, &d, held);
            let coupled = self.equations.buoyancy.is_some();
            let largest = largest(&residual);
            if !largest.is_finite() || largest > 1e12 {
                return Err(NoSteadyState::Diverged { residual: largest });
            }
            if largest <= TOLERANCE * scale || (largest <= 1e-7 * scale && largest > 0.2 * last) {
                return if coupled { Ok(()) } else { self.settle_heat(operators, state) };
            }
            last = largest;
            log::debug!("Newton: residual {largest:.2e} after {} iterations", self.counts.iterations);
            let linear = Linear::new(&self.equations, state, &d, operators, 0.0);
            let system =
                System::new(linear, self.border(state, &d, operators, held), self.threads, self.order.as_ref())?;
            self.counts.bytes = system.bytes();
            let (weight, heat_weight) = (self.weight(), self.heat_weight());
            let right: Vec<f64> = residual.iter().map(|x| -x).collect();
            let tolerance = (0.1 * largest / scale).clamp(1e-5, 1e-2);
            let iterations = &mut self.counts.iterations;
            let change = match coupled {
                false => system.solve(&right, tolerance, weight, iterations),
                true => {
                    let heat = Scalar::new(heat_matrix(&self.equations, state, operators), self.threads)?;
                    let all = Coupled::new(&self.equations, &d, &system, &heat, false);
                    all.solve(&right, tolerance, [weight, heat_weight], iterations)
                }
            };
            let change = change.ok_or(NoSteadyState::Diverged { residual: largest })?;
            self.counts.steps += 1;
            for i in 0..n {
                (0..FLOW).for_each(|f| state.fields[f][i] += change[FLOW * i + f]);
            }
            let mut extra = change[FLOW * n..].iter();
            if !self.equations.gives_pressure() {
                state.lambda += extra.next().copied().unwrap_or(0.0);
            }
            if held.is_some() {
                state.drive += extra.next().copied().unwrap_or(0.0);
            }
            if coupled {
                state.fields[TEMPERATURE].iter_mut().zip(extra).for_each(|(t, change)| *t += change);
            }
        }
        Err(NoSteadyState::Diverged { residual: last })
    }

    fn settle_heat(&mut self, operators: &Coefficients<C>, state: &mut State) -> Result<(), NoSteadyState> {
        if self.equations.diffusivity.is_none() {
            return Ok(());
        }
        let matrix = heat_matrix(&self.equations, state, operators);
        let d = self.equations.derivatives(operators, state);
        let right: Vec<f64> = self.equations.heat_residual(state, &d).iter().map(|x| -x).collect();
        let change = Scalar::new(matrix, self.threads)?.solve(&right).ok_or(NoSteadyState::Singular)?;
        state.fields[TEMPERATURE].iter_mut().zip(change).for_each(|(t, change)| *t += change);
        Ok(())
    }

    /// The multipliers of flow `[4 N + m]` and heat `[N]`, given the cotangents of the fields: solutions of R_z^T y = z_bar.
    ///
    /// # Errors
    /// A transposed system that is not solved.
    pub fn adjoint(
        &mut self,
        operators: &Coefficients<C>,
        state: &State,
        bar: &[Vec<f64>; 5],
        drive_bar: f64,
        held: Drive<'_>,
    ) -> Result<(Vec<f64>, Option<Vec<f64>>), NoSteadyState> {
        let n = self.equations.particles();
        let d = self.equations.derivatives(operators, state);
        let mut flow_bar: Vec<f64> = (0..FLOW * n).map(|k| bar[k % FLOW][k / FLOW]).collect();
        let mut heat = None;
        let coupled = self.equations.buoyancy.is_some();
        if self.equations.diffusivity.is_some() && !coupled {
            let mut y = vec![0.0; n];
            if bar[TEMPERATURE].iter().any(|&x| x != 0.0) {
                let mut matrix = heat_matrix(&self.equations, state, operators);
                matrix.transpose();
                let system = Scalar::new(matrix, self.threads)?;
                y = system.solve(&bar[TEMPERATURE]).ok_or(NoSteadyState::Adjoint)?;
                for i in 0..n {
                    let by = self.equations.heat_by_velocity(&d, &y, i);
                    (0..3).for_each(|e| flow_bar[FLOW * i + e] -= by[e]);
                }
            }
            heat = Some(y);
        }
        let [columns, rows, corner] = self.border(state, &d, operators, held);
        let m = rows.len();
        flow_bar.resize(FLOW * n + m, 0.0);
        if let (Some(_), Some(last)) = (held, flow_bar.last_mut()) {
            *last = drive_bar;
        }
        let corner = (0..m).map(|i| (0..m).map(|j| corner[j][i]).collect()).collect();
        let linear = Linear::new(&self.equations, state, &d, operators, 0.0).transposed();
        let system = System::new(linear, [rows, columns, corner], self.threads, self.order.as_ref())?;
        let (weight, heat_weight) = (1.0 / self.equations.fits.all.scale(0), self.heat_weight());
        let iterations = &mut self.counts.iterations;
        if !coupled {
            let flow = system.solve(&flow_bar, ADJOINT, weight, iterations);
            return Ok((flow.ok_or(NoSteadyState::Adjoint)?, heat));
        }
        let mut matrix = heat_matrix(&self.equations, state, operators);
        matrix.transpose();
        let own = Scalar::new(matrix, self.threads)?;
        flow_bar.extend(&bar[TEMPERATURE]);
        let found = Coupled::new(&self.equations, &d, &system, &own, true).solve(
            &flow_bar,
            ADJOINT,
            [weight, 1.0 / heat_weight],
            iterations,
        );
        let mut flow = found.ok_or(NoSteadyState::Adjoint)?;
        let heat = flow.split_off(FLOW * n + m);
        Ok((flow, Some(heat)))
    }
}
