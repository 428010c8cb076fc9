//! The steady state of fixed particles by Newton's method, and the adjoint of figures there.
//!
//! Each step solves the linearised flow; the heat, which does not act on the flow, is solved once at the end. The matrix is
//! factorised by [`crate::numerics::sparse_lu`]; steps and shapes after it are solved by GMRES with those factors in front,
//! as long as that takes few iterations. The numbers that hold for the whole flow are a border:
//!
//! ```text
//!   | A  B | |x|   |r|      lambda: B = 1 in every row of continuity, C x = p of particle 0
//!   | C  D | |e| = |g|      drive:  B = -1 in every row of x momentum, C x = the flow rate.
//! ```
//!
//! A is singular where only the border fixes the pressure, so A + e e^T (e: the row of that pressure) is factorised.

use super::deferred_correction::Defect;
use super::equations::{Derivatives, Equations, State};
use super::fit::Coefficients;
use crate::numerics::eigenvalues::outermost;
use crate::numerics::krylov::gmres;
use crate::numerics::sparse_lu::{dot, refined, BlockMatrix, Order, Singular, SparseLu};
use num_complex::Complex64;
use std::cell::OnceCell;
use std::sync::Arc;

/// Why there is no steady state.
#[derive(Debug, Clone, PartialEq)]
pub enum NoSteadyState {
    /// A matrix has no factors.
    Singular,
    /// Newton's method did not converge: the largest residual after its last step.
    Diverged { residual: f64 },
    /// The transposed system was not solved.
    Adjoint,
    /// The equations of a step in time were not solved.
    Unsolved,
    /// A flow in time left all bounds after this time.
    Unbounded { time: f64 },
}

impl From<Singular> for NoSteadyState {
    fn from(_: Singular) -> Self {
        Self::Singular
    }
}

/// What a drive holds.
#[derive(Debug, Clone, PartialEq)]
pub enum Held {
    /// The flow rate.
    FlowRate(f64),
    /// Flow rate times acceleration times the length of the period: power per density.
    Power { power: f64, length: f64 },
}

/// The flow rate as a linear function of the state: its value and derivative by u, v, p, `[N, 3]`.
pub trait FlowRate: Sync {
    fn value(&self, equations: &Equations, state: &State, d: &Derivatives) -> f64;
    fn by_state(&self, equations: &Equations, operators: &Coefficients) -> Vec<f64>;
}

/// Steps of Newton's method before it is given up.
const STEPS: usize = 25;
/// The largest residual of a steady state, in those of a flow at rest.
const TOLERANCE: f64 = 1e-11;
/// The residual that factors of a heat matrix leave when it is singular, in that of a cold fluid. (Others leave 1e-10 or less.)
const UNSOLVED: f64 = 1e-6;
/// Dimensions of the space in which the fastest growing disturbance is looked for.
const DISTURBANCES: usize = 60;
/// Iterations of GMRES with old factors before the matrix is factorised anew.
const ITERATIONS: usize = 14;
/// The same for an adjoint, which is solved to more digits.
const ADJOINT_ITERATIONS: usize = 40;

/// A steady solver for one cloud. With buoyancy the heat acts on the flow, and is one of its unknowns. It keeps factors from state to state and from shape to shape.
pub struct Solver {
    pub equations: Equations,
    pub threads: usize,
    order: Arc<Order>,
    flow: BlockMatrix,
    heat: BlockMatrix,
    factors: Option<Factors>,
    /// The heat's matrix that was factorised last, and its factors.
    heat_factors: Option<(Vec<f64>, SparseLu)>,
    pub counts: Counts,
}

/// How much work was done.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    pub steps: usize,
    pub factorisations: usize,
    pub iterations: usize,
    /// Bytes of the flow's factors.
    pub bytes: usize,
}

/// The border of the flow's matrix: columns B, rows C, and D.
#[derive(Debug, Clone, Default)]
pub(super) struct Border {
    pub columns: Vec<Vec<f64>>,
    rows: Vec<Vec<f64>>,
    corner: Vec<Vec<f64>>,
    /// Whether the first one is lambda.
    pub pins: bool,
}

/// The unknown that is the pressure of particle 0.
const PIN: usize = 2;

pub(super) struct Factors {
    lu: SparseLu,
    /// The matrix that was factorised, for refinement.
    matrix: BlockMatrix,
    border: Border,
    /// A^-1 B, and A^-T C^T, which only adjoints need.
    columns: Vec<Vec<f64>>,
    rows: OnceCell<Vec<Vec<f64>>>,
}

pub(super) fn largest(residual: &[f64]) -> f64 {
    residual.iter().fold(0.0, |most: f64, x| most.max(x.abs()))
}

/// Solves a small dense system.
pub(super) fn dense(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let best = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap_or(k);
        a.swap(k, best);
        b.swap(k, best);
        for row in k + 1..n {
            let factor = a[row][k] / a[k][k];
            for column in k..n {
                a[row][column] -= factor * a[k][column];
            }
            b[row] -= factor * b[k];
        }
    }
    for k in (0..n).rev() {
        for later in k + 1..n {
            b[k] -= a[k][later] * b[later];
        }
        b[k] /= a[k][k];
    }
    b
}

/// Adds a rate of change of the velocity (and temperature) of particles inside.
fn add_rate(flow: &mut BlockMatrix, inside: usize, rate: f64) {
    let size = flow.size;
    for i in 0..inside {
        let entry = flow.entry(i, i as u32);
        let block = flow.block_mut(entry);
        (0..size).filter(|f| *f != 2).for_each(|f| block[f * size + f] += rate);
    }
}

impl Factors {
    fn new(order: &Arc<Order>, matrix: &BlockMatrix, border: &Border, threads: usize) -> Result<Self, Singular> {
        let mut matrix = matrix.clone();
        if border.pins {
            let (entry, size) = (matrix.entry(0, 0), matrix.size);
            matrix.block_mut(entry)[PIN * size + PIN] += 1.0;
        }
        let lu = SparseLu::new(order, &matrix, threads)?;
        let mut factors = Self { lu, matrix, border: border.clone(), columns: vec![], rows: OnceCell::new() };
        factors.columns = border.columns.iter().map(|column| factors.inner(column, false, true)).collect();
        Ok(factors)
    }

    pub fn bytes(&self) -> usize {
        self.lu.bytes() + size_of_val(self.matrix.values.as_slice())
    }

    /// (A + e e^T)^-1 b or its transpose, with one step of refinement if it shall be exact.
    fn inner(&self, b: &[f64], transposed: bool, exact: bool) -> Vec<f64> {
        match exact {
            true => self.lu.refined(&self.matrix, b, transposed),
            false => self.lu.solve(b, transposed),
        }
    }

    fn rows(&self) -> &Vec<Vec<f64>> {
        self.rows.get_or_init(|| self.border.rows.iter().map(|row| self.inner(row, true, true)).collect())
    }

    /// The solution of the bordered system, or of its transpose: `[3 N + m]`.
    pub fn solve(&self, right: &[f64], transposed: bool, exact: bool) -> Vec<f64> {
        let border = &self.border;
        let m = border.columns.len();
        let n = right.len() - m;
        let (mut r, g) = (right[..n].to_vec(), &right[n..]);
        // In A^T, what is a column is a row; the pinned pressure is 0 or g either way.
        let (against, solved, pinned) = match transposed {
            false => (&border.rows, &self.columns, border.pins),
            true => (&border.columns, self.rows(), false),
        };
        if pinned {
            r[PIN] += g[0];
        }
        let mut x = self.inner(&r, transposed, exact);
        if m == 0 {
            return x;
        }
        let schur: Vec<Vec<f64>> = (0..m)
            .map(|i| {
                let corner = |j: usize| if transposed { border.corner[j][i] } else { border.corner[i][j] };
                (0..m).map(|j| corner(j) - dot(&against[i], &solved[j])).collect()
            })
            .collect();
        let rest: Vec<f64> = (0..m).map(|i| g[i] - dot(&against[i], &x)).collect();
        let mut e = dense(schur, rest);
        for (e, column) in e.iter().zip(solved) {
            x.iter_mut().zip(column).for_each(|(x, c)| *x -= e * c);
        }
        if transposed && border.pins {
            // (A^T + e e^T) x + e e0' = r, so that the number that belongs to A^T is e0' + x of the pin.
            e[0] += x[PIN];
        }
        x.extend(e);
        x
    }
}

impl Solver {
    /// A solver for particles at these places of the reference cloud.
    pub fn new(equations: Equations, places: &[[f64; 2]], threads: usize) -> Self {
        let size = if equations.buoyancy.is_some() { 4 } else { 3 };
        Self::of_size(equations, places, size, threads)
    }

    /// A solver whose flow has three unknowns, or four with the temperature.
    pub(super) fn of_size(equations: Equations, places: &[[f64; 2]], size: usize, threads: usize) -> Self {
        let (flow, heat) = (equations.fits.all.matrix(size), equations.fits.all.matrix(1));
        let order = Arc::new(Order::new(&flow, |i| places[i]));
        Self { equations, threads, order, flow, heat, factors: None, heat_factors: None, counts: Counts::default() }
    }

    /// Whether the temperature is among the unknowns of the flow.
    fn is_coupled(&self) -> bool {
        self.flow.size == 4
    }

    fn border(
        &self,
        state: &State,
        d: &Derivatives,
        operators: &Coefficients,
        held: Option<(&Held, &dyn FlowRate)>,
    ) -> Border {
        let (equations, n, s) = (&self.equations, self.equations.particles(), self.flow.size);
        let mut border = Border { pins: !equations.gives_pressure(), ..Border::default() };
        if border.pins {
            let mut row = vec![0.0; s * n];
            row[PIN] = 1.0;
            border.columns.push((0..s * n).map(|k| if k % s == 2 { 1.0 } else { 0.0 }).collect());
            border.rows.push(row);
        }
        if let Some((held, rate)) = held {
            let column = (0..s * n).map(|k| if k % s == 0 && k / s < equations.inside { -1.0 } else { 0.0 });
            border.columns.push(column.collect());
            let by_state = rate.by_state(equations, operators);
            let mut row: Vec<f64> =
                (0..s * n).map(|k| if k % s < 3 { by_state[k / s * 3 + k % s] } else { 0.0 }).collect();
            if let Held::Power { .. } = held {
                let push = equations.force[0] + state.drive;
                row.iter_mut().for_each(|x| *x *= push);
            }
            border.rows.push(row);
        }
        let m = border.rows.len();
        border.corner = vec![vec![0.0; m]; m];
        if let Some((Held::Power { .. }, rate)) = held {
            border.corner[m - 1][m - 1] = rate.value(equations, state, d);
        }
        border
    }

    /// Residual of the heat with what is added to it, `[N]`.
    fn heat_residual(&self, state: &State, d: &Derivatives, defect: Option<&Defect>) -> Vec<f64> {
        let mut residual = self.equations.heat_residual(state, d);
        residual.iter_mut().zip(defect.iter().flat_map(|defect| &defect.heat)).for_each(|(r, more)| *r += more);
        residual
    }

    /// Residuals of flow (and heat), with what is added to them, and border, `[3 N + m]` or `[4 N + m]`.
    fn residual(
        &self,
        state: &State,
        d: &Derivatives,
        held: Option<(&Held, &dyn FlowRate)>,
        defect: Option<&Defect>,
    ) -> Vec<f64> {
        let mut residual = self.equations.flow_residual(state, d);
        residual.iter_mut().zip(defect.iter().flat_map(|defect| &defect.flow)).for_each(|(r, more)| *r += more);
        if self.is_coupled() {
            let heat = self.heat_residual(state, d, defect);
            residual = residual.chunks_exact(3).zip(heat).flat_map(|(row, t)| [row[0], row[1], row[2], t]).collect();
        }
        if !self.equations.gives_pressure() {
            residual.push(state.fields[2][0]);
        }
        if let Some((held, rate)) = held {
            let flow = rate.value(&self.equations, state, d);
            residual.push(match held {
                Held::FlowRate(wanted) => flow - wanted,
                Held::Power { power, length } => (self.equations.force[0] + state.drive) * flow - power / length,
            });
        }
        residual
    }

    /// The largest residual of a flow at rest, with the drive of a state.
    fn residual_at_rest(&self, state: &State, held: Option<(&Held, &dyn FlowRate)>) -> f64 {
        let n = self.equations.particles();
        let rest = State { drive: state.drive, ..State::at_rest(n) };
        largest(&self.residual(&rest, &Derivatives::zeros(n), held, None)).max(f64::MIN_POSITIVE)
    }

    fn times(&self, border: &Border, x: &[f64], transposed: bool) -> Vec<f64> {
        let m = border.columns.len();
        let (own, extra) = x.split_at(x.len() - m);
        let mut y = self.flow.times(own, transposed);
        let (columns, rows) = match transposed {
            false => (&border.columns, &border.rows),
            true => (&border.rows, &border.columns),
        };
        for (column, e) in columns.iter().zip(extra) {
            y.iter_mut().zip(column).for_each(|(y, c)| *y += c * e);
        }
        for (i, row) in rows.iter().enumerate() {
            let corner = |j: usize| if transposed { border.corner[j][i] } else { border.corner[i][j] };
            y.push(dot(row, own) + (0..m).map(|j| corner(j) * extra[j]).sum::<f64>());
        }
        y
    }

    /// Solves with the present matrix: by GMRES with the factors that are there, or by new factors.
    fn solved(
        &mut self,
        border: &Border,
        right: &[f64],
        tolerance: f64,
        most: usize,
        transposed: bool,
    ) -> Result<Vec<f64>, Singular> {
        let count = std::cell::Cell::new(0);
        if let Some(factors) = self.factors.as_ref().filter(|_| most > 0) {
            let times = |x: &[f64]| {
                count.set(count.get() + 1);
                self.times(border, x, transposed)
            };
            let found = gmres(right, tolerance, most, &times, &|x: &[f64]| factors.solve(x, transposed, false));
            self.counts.iterations += count.get();
            if let Some(found) = found {
                return Ok(found);
            }
        }
        self.counts.factorisations += 1;
        let factors = Factors::new(&self.order, &self.flow, border, self.threads)?;
        self.counts.bytes = factors.lu.bytes();
        let exact = |r: &[f64]| factors.solve(r, transposed, true);
        let x = match transposed {
            // An adjoint must be right to rounding.
            true => refined(right, |x| self.times(border, x, true), exact, |r| factors.solve(r, true, false)),
            false => exact(right),
        };
        self.factors = Some(factors);
        Ok(x)
    }

    /// Finds the steady flow and its temperature, starting from `state`, with what is added to the residuals.
    ///
    /// # Errors
    /// No convergence.
    pub fn settle(
        &mut self,
        operators: &Coefficients,
        state: &mut State,
        held: Option<(&Held, &dyn FlowRate)>,
        defect: Option<&Defect>,
    ) -> Result<(), NoSteadyState> {
        let (n, s) = (self.equations.particles(), self.flow.size);
        // The first factors are those of a flow at rest, which are of no use for the next step.
        let is_cold = self.factors.is_none();
        let scale = self.residual_at_rest(state, held);
        let mut last = f64::INFINITY;
        for step in 0..STEPS {
            let d = self.equations.derivatives(operators, state, self.is_coupled());
            let residual = self.residual(state, &d, held, defect);
            let largest = largest(&residual);
            if !largest.is_finite() || largest > 1e12 {
                return Err(NoSteadyState::Diverged { residual: largest });
            }
            // Below this rounding of second derivatives may keep it from falling.
            if largest <= TOLERANCE * scale || (largest <= 1e-8 * scale && largest > 0.2 * last) {
                return if self.is_coupled() { Ok(()) } else { self.settle_heat(operators, state, defect) };
            }
            last = largest;
            self.equations.flow_matrix(state, &d, operators, &mut self.flow);
            let border = self.border(state, &d, operators, held);
            let right: Vec<f64> = residual.iter().map(|x| -x).collect();
            let tolerance = (1e-2 * largest / scale).clamp(1e-6, 1e-3);
            let most = if is_cold && step == 1 { 0 } else { ITERATIONS };
            let change = self.solved(&border, &right, tolerance, most, false)?;
            self.counts.steps += 1;
            for i in 0..n {
                (0..s).for_each(|f| state.fields[f][i] += change[s * i + f]);
            }
            let mut extra = change[s * n..].iter();
            if !self.equations.gives_pressure() {
                state.lambda += extra.next().copied().unwrap_or(0.0);
            }
            if held.is_some() {
                state.drive += extra.next().copied().unwrap_or(0.0);
            }
        }
        Err(NoSteadyState::Diverged { residual: last })
    }

    fn settle_heat(
        &mut self,
        operators: &Coefficients,
        state: &mut State,
        defect: Option<&Defect>,
    ) -> Result<(), NoSteadyState> {
        if self.equations.diffusivity.is_none() {
            return Ok(());
        }
        self.factorise_heat(operators, state)?;
        let left = |state: &State| {
            let d = self.equations.derivatives(operators, state, true);
            self.heat_residual(state, &d, defect)
        };
        let mut before = f64::INFINITY;
        for _ in 0..2 {
            let right: Vec<f64> = left(state).iter().map(|x| -x).collect();
            let now = largest(&right);
            // Factors of a singular matrix are made of rounding, and solve nothing: a part of the fluid has no temperature given.
            if now > UNSOLVED * before {
                let mut cold = state.clone();
                cold.fields[3].fill(0.0);
                if now > UNSOLVED * largest(&left(&cold)) {
                    return Err(NoSteadyState::Singular);
                }
            }
            before = now;
            let change = self.heat_factors()?.solve(&right, false);
            state.fields[3].iter_mut().zip(change).for_each(|(t, change)| *t += change);
        }
        Ok(())
    }

    /// Makes the matrix of the heat in a flow, and its factors unless they are there.
    fn factorise_heat(&mut self, operators: &Coefficients, state: &State) -> Result<(), Singular> {
        self.equations.heat_matrix(state, operators, &mut self.heat);
        if self.heat_factors.as_ref().is_none_or(|(matrix, _)| *matrix != self.heat.values) {
            let factors = SparseLu::new(&self.order, &self.heat, self.threads)?;
            self.heat_factors = Some((self.heat.values.clone(), factors));
        }
        Ok(())
    }

    fn heat_factors(&self) -> Result<&SparseLu, Singular> {
        self.heat_factors.as_ref().map(|(_, factors)| factors).ok_or(Singular)
    }

    /// The multipliers of flow `[3 N + m]` and heat `[N]`, given the cotangents of the fields: solutions of R_z^T y = z_bar.
    ///
    /// # Errors
    /// A transposed system that cannot be solved.
    pub fn adjoint(
        &mut self,
        operators: &Coefficients,
        state: &State,
        bar: &[Vec<f64>; 4],
        drive_bar: f64,
        held: Option<(&Held, &dyn FlowRate)>,
    ) -> Result<(Vec<f64>, Option<Vec<f64>>), NoSteadyState> {
        let (n, s) = (self.equations.particles(), self.flow.size);
        let d = self.equations.derivatives(operators, state, true);
        let mut heat = None;
        let mut flow_bar: Vec<f64> = (0..s * n).map(|k| bar[k % s][k / s]).collect();
        if self.equations.diffusivity.is_some() && !self.is_coupled() {
            if bar[3].iter().any(|&x| x != 0.0) {
                self.factorise_heat(operators, state)?;
                let y = self.heat_factors()?.refined(&self.heat, &bar[3], true);
                for (i, by) in self.equations.heat_by_velocity(&d, &y).iter().enumerate() {
                    (0..2).for_each(|e| flow_bar[3 * i + e] -= by[e]);
                }
                heat = Some(y);
            } else {
                heat = Some(vec![0.0; n]);
            }
        }
        self.equations.flow_matrix(state, &d, operators, &mut self.flow);
        let border = self.border(state, &d, operators, held);
        flow_bar.resize(s * n + border.columns.len(), 0.0);
        if let (Some(_), Some(last)) = (held, flow_bar.last_mut()) {
            *last = drive_bar;
        }
        let mut flow = self.solved(&border, &flow_bar, 1e-12, ADJOINT_ITERATIONS, true)?;
        if flow.iter().any(|x| !x.is_finite()) {
            return Err(NoSteadyState::Adjoint);
        }
        if self.is_coupled() {
            let (own, extra) = flow.split_at(s * n);
            heat = Some(own.chunks_exact(s).map(|row| row[3]).collect());
            flow = own.chunks_exact(s).flat_map(|row| &row[..3]).chain(extra).copied().collect();
        }
        Ok((flow, heat))
    }

    /// The growth rate and angular frequency of the disturbance that grows fastest, or decays slowest, in a steady flow.
    ///
    /// Disturbances x exp(sigma t) solve sigma M x = -R_z x, M the identity in the rows of momentum and 0 in the others. Arnoldi's
    /// method finds the outermost eigenvalues of (kappa M + R_z)^-1 M, which are 1 / (kappa + sigma'); the image of what grows
    /// is outside of a circle that holds all the others. `rate`: kappa, about the frequency that is expected.
    ///
    /// # Errors
    /// A matrix without factors.
    pub fn growth(
        &mut self,
        operators: &Coefficients,
        state: &State,
        held: Option<(&Held, &dyn FlowRate)>,
        rate: f64,
    ) -> Result<Option<(f64, f64)>, Singular> {
        let (n, inside, s) = (self.equations.particles(), self.equations.inside, self.flow.size);
        let d = self.equations.derivatives(operators, state, self.is_coupled());
        self.equations.flow_matrix(state, &d, operators, &mut self.flow);
        add_rate(&mut self.flow, inside, rate);
        let border = self.border(state, &d, operators, held);
        let factors = Factors::new(&self.order, &self.flow, &border, self.threads)?;
        let extra = border.columns.len();
        let mut map = |x: &[f64]| {
            let moves = |k: usize| k % s != 2 && k / s < inside;
            let mut right: Vec<f64> = (0..s * n).map(|k| if moves(k) { x[k] } else { 0.0 }).collect();
            right.resize(s * n + extra, 0.0);
            let mut found = factors.solve(&right, false, false);
            found.truncate(s * n);
            found
        };
        // Every disturbance is in it; the same in each run.
        let first: Vec<f64> = (0..s * n).map(|k| (1.0 + k as f64 * 0.754_877_666).fract() - 0.5).collect();
        let first = map(&first);
        let found = outermost(&first, DISTURBANCES, &mut map);
        let certain = found.into_iter().filter(|one| one.residual < 1e-2);
        let growth = certain.map(|one| Complex64::new(rate, 0.0) - one.value.inv());
        Ok(growth.max_by(|a, b| a.re.total_cmp(&b.re)).map(|sigma| (sigma.re, sigma.im.abs())))
    }

    /// The border of a flow at rest.
    pub(super) fn border_at_rest(&self, operators: &Coefficients, held: Option<(&Held, &dyn FlowRate)>) -> Border {
        let n = self.equations.particles();
        self.border(&State::at_rest(n), &Derivatives::zeros(n), operators, held)
    }

    /// Factors of the matrices of a flow at rest with a rate of change of velocity and temperature at particles inside.
    pub(super) fn factors_at(
        &mut self,
        rate: f64,
        operators: &Coefficients,
        border: &Border,
    ) -> Result<(Factors, Option<SparseLu>), Singular> {
        let (n, inside) = (self.equations.particles(), self.equations.inside);
        let state = State::at_rest(n);
        self.equations.flow_matrix(&state, &Derivatives::zeros(n), operators, &mut self.flow);
        add_rate(&mut self.flow, inside, rate);
        let flow = Factors::new(&self.order, &self.flow, border, self.threads)?;
        if self.equations.diffusivity.is_none() {
            return Ok((flow, None));
        }
        self.equations.heat_matrix(&state, operators, &mut self.heat);
        for i in 0..inside {
            let entry = self.heat.entry(i, i as u32);
            self.heat.values[entry] += rate;
        }
        Ok((flow, Some(SparseLu::new(&self.order, &self.heat, self.threads)?)))
    }

    /// Forgets the factors, for a state far from the last one.
    pub fn forget(&mut self) {
        self.factors = None;
    }
}
