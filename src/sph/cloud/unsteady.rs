//! Flows at fixed particles in time.
//!
//! Backward differences of second order with advection extrapolated from the last two states (Ascher, Ruuth and Wetton 1995;
//! variable steps: Wang and Ruuth 2008): with r the size dt of a step over that of the last one,
//!
//! ```text
//!   momentum    (a0 u+ - a1 u + a2 u-) / dt + (1 + r) N(u) - r N(u-) + grad p+ - nu lap u+ - f - b (T+ - T0) = 0
//!   continuity  div u+ - tau S p+ + lambda = 0
//!   heat        (a0 T+ - a1 T + a2 T-) / dt + (1 + r) N(T) - r N(T-) - alpha lap T+ = 0
//!
//!   a0 = (1 + 2 r) / (1 + r),   a1 = 1 + r,   a2 = r^2 / (1 + r),   N(f) = u . grad f,   1 / tau = 1 / tau_steady + a0 / (10 dt).
//! ```
//!
//! The first two steps have r = 0, Euler's: the fields at the start need not fit to the walls. Velocity and pressure are solved
//! for together, so there is no error of splitting and walls hold to rounding. The matrix is the same for all steps of one
//! size; its factors ([`crate::numerics::sparse_lu`]) are kept, and a step is one solution with them.
//!
//! The size follows from an estimate of the error of a step, the difference from what the last three states extrapolate to, and
//! from how far the fluid may go, in spacings: advection is explicit.

use super::equations::{Bar, Condition, Equations, Motion, State, Warmth, CARRIED};
use super::fit::Coefficients;
use super::steady::{Border, Factors, FlowRate, Held, NoSteadyState, Solver};
use crate::numerics::sparse_lu::SparseLu;
use std::borrow::Cow;

/// How far the fluid may go in a step, in spacings. (Behind a cylinder steps of 0.7 are stable, of 1 they are not.)
const COURANT: f64 = 0.5;
/// Sizes of steps are those of a geometric series, so that few matrices are factorised.
const RATIO: f64 = std::f64::consts::SQRT_2;
/// The error of a step in the difference from the extrapolation.
const SHARE: f64 = 0.18;
/// Steps become no shorter for their error than this part of the limit by advection.
const SHORTEST: f64 = 0.05;
/// How many steps tau is at most. (With 1 to 5 pressures that the fits hardly see grow where particles are irregular and the viscosity
/// is small; with 20 and more they do at walls with steps a hundredth of what the flow allows.)
const LAG: f64 = 10.0;
/// Matrices whose factors are kept: so many, or more as long as they need no more than these bytes. (Where a wall turns back and forth
/// three sizes of steps take turns, each with matrices of its own after larger and smaller ones: seven.)
const KEPT: usize = 3;
const BYTES: usize = 300_000_000;

/// A step: its size, and that of the one before (0: it does not look back).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    pub dt: f64,
    pub last: f64,
}

impl Step {
    /// The step of a size after steps of these sizes. The state at the start may not fit to walls and continuity, so no step looks
    /// back to it.
    pub fn after(sizes: &[f64], dt: f64) -> Self {
        Self { dt, last: if sizes.len() > 1 { sizes[sizes.len() - 1] } else { 0.0 } }
    }

    /// r, and a0, a1, a2 over dt.
    pub fn weights(&self) -> (f64, [f64; 3]) {
        let r = if self.last > 0.0 { self.dt / self.last } else { 0.0 };
        (r, [(1.0 + 2.0 * r) / (1.0 + r), 1.0 + r, r * r / (1.0 + r)].map(|a| a / self.dt))
    }
}

/// A state with its advection, u . grad of u, v and T at particles inside.
#[derive(Debug, Clone, Default)]
pub struct Level {
    pub state: State,
    pub advection: Vec<[f64; 3]>,
}

/// What the boundary is at a time, `[boundary]`.
pub trait InTime {
    fn conditions(&self, time: f64) -> Vec<Condition>;
    /// Whether they change with time.
    fn changes(&self) -> bool;
    /// The conditions at a time, given those at the start.
    fn at<'a>(&self, time: f64, start: &'a [Condition]) -> Cow<'a, [Condition]> {
        if self.changes() {
            Cow::Owned(self.conditions(time))
        } else {
            Cow::Borrowed(start)
        }
    }
    /// What cotangents of given velocities and temperatures at a time are of positions and of the parameters of formulas.
    fn pull_back(&self, _time: f64, _bar: &Bar, _position: &mut [Vec<f64>; 2], _parameters: &mut [f64]) {}
    /// What those of the first state's fields, `[4][N]`, are of the boundary and of positions.
    fn of_start(&self, _fields: &[Vec<f64>; 4], _bar: &mut Bar, _position: &mut [Vec<f64>; 2]) {}
}

/// How large steps are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Control {
    /// Error of a step, in `velocity`.
    pub tolerance: f64,
    pub velocity: f64,
    /// A size for all steps instead.
    pub fixed: Option<f64>,
    pub end: f64,
}

/// Solutions with the matrix of one size of step.
struct Matrices {
    rate: f64,
    flow: Factors,
    heat: Option<SparseLu>,
}

impl Matrices {
    fn bytes(&self) -> usize {
        self.flow.bytes() + self.heat.as_ref().map_or(0, SparseLu::bytes)
    }
}

/// Steps of a flow around one shape.
pub struct March {
    solver: Solver,
    kept: Vec<Matrices>,
    border: Border,
    /// tau of a steady flow.
    damping: Vec<f64>,
    pub factorisations: usize,
}

impl March {
    /// `held`: a flow rate that is held, and how it follows from the state.
    pub fn new(
        equations: Equations,
        places: &[[f64; 2]],
        operators: &Coefficients,
        held: Option<(&Held, &dyn FlowRate)>,
        threads: usize,
    ) -> Self {
        let damping = equations.damping.clone();
        let solver = Solver::of_size(equations, places, 3, threads);
        let border = solver.border_at_rest(operators, held);
        Self { solver, kept: vec![], border, damping, factorisations: 0 }
    }

    pub fn equations(&self) -> &Equations {
        &self.solver.equations
    }

    /// A state as a level.
    pub fn level(&self, operators: &Coefficients, state: State) -> Level {
        let advection = self.equations().advection(operators, &state);
        Level { state, advection }
    }

    /// The factors for a0 / dt.
    fn matrices(&mut self, rate: f64, operators: &Coefficients) -> Result<&Matrices, NoSteadyState> {
        // Also of use for the adjoint, which takes the matrices' derivatives.
        let damping = self.damping.iter().map(|tau| 1.0 / (1.0 / tau + rate / LAG));
        self.solver.equations.damping = damping.collect();
        if let Some(k) = self.kept.iter().position(|kept| (kept.rate / rate - 1.0).abs() < 1e-12) {
            let found = self.kept.remove(k);
            self.kept.push(found);
        } else {
            let (flow, heat) = self.solver.factors_at(rate, operators, &self.border)?;
            self.factorisations += 1;
            self.kept.push(Matrices { rate, flow, heat });
            while self.kept.len() > KEPT && self.kept.iter().map(Matrices::bytes).sum::<usize>() > BYTES {
                self.kept.remove(0);
            }
        }
        self.kept.last().ok_or(NoSteadyState::Singular)
    }

    /// The multipliers of a step's flow, `[3 N + m]`, given the cotangents of the fields of its result and of the drive.
    pub(super) fn transposed(
        &mut self,
        rate: f64,
        operators: &Coefficients,
        fields: &[Vec<f64>],
        drive: f64,
    ) -> Result<Vec<f64>, NoSteadyState> {
        let extra = self.border.columns.len();
        let is_held = extra > usize::from(self.border.pins);
        let mut right: Vec<f64> =
            (0..fields[0].len()).flat_map(|i| [fields[0][i], fields[1][i], fields[2][i]]).collect();
        right.resize(right.len() + extra, 0.0);
        if let (true, Some(last)) = (is_held, right.last_mut()) {
            *last = drive;
        }
        Ok(self.matrices(rate, operators)?.flow.solve(&right, true, false))
    }

    /// The same of its heat, `[N]`.
    pub(super) fn transposed_heat(
        &mut self,
        rate: f64,
        operators: &Coefficients,
        right: &[f64],
    ) -> Result<Vec<f64>, NoSteadyState> {
        let matrices = self.matrices(rate, operators)?;
        Ok(matrices.heat.as_ref().map_or_else(Vec::new, |heat| heat.solve(right, true)))
    }

    /// The state after a step from `now`, `before` it, with the conditions of its end. `flow_rate`: the one that is held.
    ///
    /// # Errors
    /// A matrix without factors.
    pub fn step(
        &mut self,
        step: Step,
        now: &Level,
        before: &Level,
        conditions: &[Condition],
        flow_rate: Option<f64>,
        operators: &Coefficients,
    ) -> Result<State, NoSteadyState> {
        let (r, [a0, a1, a2]) = step.weights();
        let Equations { inside, force, buoyancy, diffusivity, .. } = *self.equations();
        let n = self.equations().particles();
        let pins = self.border.pins;
        let extra = self.border.columns.len();
        let carried = |i: usize, f: usize| {
            let field = CARRIED[f];
            let last = if r > 0.0 { r * before.advection[i][f] + -a2 * before.state.fields[field][i] } else { 0.0 };
            a1 * now.state.fields[field][i] - (1.0 + r) * now.advection[i][f] + last
        };
        let mut state = State::at_rest(n);
        let matrices = self.matrices(a0, operators)?;
        if let (Some(_), Some(heat)) = (diffusivity, &matrices.heat) {
            let right: Vec<f64> = (0..n)
                .map(|i| match i.checked_sub(inside).map(|k| conditions[k].warmth) {
                    None => carried(i, 2),
                    Some(Warmth::Given(given)) => given,
                    Some(Warmth::Flux(flux)) => -flux,
                })
                .collect();
            state.fields[3] = heat.solve(&right, false);
        }
        let mut right = vec![0.0; 3 * n + extra];
        for i in 0..n {
            for e in 0..2 {
                right[3 * i + e] = match i.checked_sub(inside).map(|k| conditions[k].motion) {
                    None => {
                        let lift = buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, state.fields[3][i]));
                        carried(i, e) + force[e] + lift
                    }
                    Some(Motion::Given(given)) => given[e],
                    Some(_) => 0.0,
                };
            }
        }
        if let Some(flow_rate) = flow_rate {
            right[3 * n + extra - 1] = flow_rate;
        }
        let x = matrices.flow.solve(&right, false, false);
        for i in 0..n {
            (0..3).for_each(|f| state.fields[f][i] = x[3 * i + f]);
        }
        let mut more = x[3 * n..].iter();
        if pins {
            state.lambda = more.next().copied().unwrap_or(0.0);
        }
        state.drive = more.next().copied().unwrap_or(0.0);
        Ok(state)
    }
}

/// A flow that goes on in time, with steps whose size it chooses.
pub struct Flow<'a> {
    pub march: &'a mut March,
    pub operators: &'a Coefficients,
    pub boundary: &'a dyn InTime,
    pub flow_rate: Option<f64>,
    /// Spacing of each particle.
    pub spacing: &'a [f64],
}

/// Root mean square of the difference of two velocities in a third field's, over particles inside.
fn difference(inside: usize, a: &State, b: &[Vec<f64>; 2]) -> f64 {
    let square = |e: usize| (0..inside).map(|i| (a.fields[e][i] - b[e][i]).powi(2)).sum::<f64>();
    ((square(0) + square(1)) / inside as f64).sqrt()
}

impl Flow<'_> {
    /// The largest size of a step by advection.
    fn courant(&self, state: &State) -> f64 {
        let [u, v, ..] = &state.fields;
        let rates = (0..self.march.equations().inside).map(|i| u[i].hypot(v[i]) / self.spacing[i]);
        COURANT / rates.fold(f64::MIN_POSITIVE, f64::max)
    }

    /// Takes steps of given sizes from `first` on.
    ///
    /// # Errors
    /// Those of [`Self::run`].
    pub fn repeat<E: From<NoSteadyState>>(
        &mut self,
        first: State,
        sizes: &[f64],
        watch: &mut dyn FnMut(f64, &State) -> Result<(), E>,
    ) -> Result<(), E> {
        let start = self.boundary.conditions(0.0);
        let (mut time, mut before, mut now) = (0.0, Level::default(), self.march.level(self.operators, first));
        for (k, &dt) in sizes.iter().enumerate() {
            let step = Step::after(&sizes[..k], dt);
            time += dt;
            let conditions = self.boundary.at(time, &start);
            let state = self.march.step(step, &now, &before, &conditions, self.flow_rate, self.operators)?;
            watch(time, &state)?;
            let next = self.march.level(self.operators, state);
            before = std::mem::replace(&mut now, next);
        }
        Ok(())
    }

    /// Goes on from `first` to the end; `watch` gets the time and state after each step, and may stop it. Returns the
    /// sizes of all steps.
    ///
    /// # Errors
    /// A flow that is not finite, and those of `watch`.
    pub fn run<E: From<NoSteadyState>>(
        &mut self,
        first: State,
        control: Control,
        watch: &mut dyn FnMut(f64, &State) -> Result<(), E>,
    ) -> Result<Vec<f64>, E> {
        let Control { tolerance, velocity, fixed, end } = control;
        let inside = self.march.equations().inside;
        let level_of = |number: i32| end * RATIO.powi(-number);
        // The number of the largest size that is at most `most`.
        let number_of = |most: f64| ((end / most).ln() / RATIO.ln()).ceil().max(0.0) as i32;
        let start = self.boundary.conditions(0.0);
        let mut time = 0.0;
        let mut now = self.march.level(self.operators, first);
        let mut before = Level::default();
        let mut earlier: Option<(State, f64)> = None;
        let mut sizes: Vec<f64> = vec![];
        // The first steps are of first order and start from a flow that the walls do not know, so they are small.
        let mut number = number_of(
            0.1 * self.courant(&now.state).min(self.spacing.iter().fold(f64::MAX, |a, &b| a.min(b)) / velocity),
        );
        while time < end * (1.0 - 1e-12) {
            let mut dt = fixed.unwrap_or_else(|| level_of(number));
            let rest = end - time;
            // The last steps are alike: pressures of a much shorter one would not be those of the flow.
            let left = (rest / dt * (1.0 - 1e-9)).ceil();
            if left < 5.0 {
                dt = rest / left;
            }
            let step = Step::after(&sizes, dt);
            let conditions = self.boundary.at(time + dt, &start);
            let state = self.march.step(step, &now, &before, &conditions, self.flow_rate, self.operators)?;
            let fastest = (0..inside).map(|i| state.fields[0][i].hypot(state.fields[1][i])).fold(0.0, f64::max);
            if fastest > 1e3 * velocity || state.fields.iter().flatten().any(|x| !x.is_finite()) {
                return Err(NoSteadyState::Unbounded { time }.into());
            }
            if fixed.is_none() {
                // Of second order from the last three states.
                let error = earlier.as_ref().map(|(earlier, size)| {
                    let (a, b) = (step.last, step.last + size);
                    let weights =
                        [(dt + a) * (dt + b) / (a * b), -dt * (dt + b) / (a * (b - a)), dt * (dt + a) / (b * (b - a))];
                    let expected: [Vec<f64>; 2] = std::array::from_fn(|e| {
                        (0..inside)
                            .map(|i| {
                                weights[0] * now.state.fields[e][i]
                                    + weights[1] * before.state.fields[e][i]
                                    + weights[2] * earlier.fields[e][i]
                            })
                            .collect()
                    });
                    SHARE * difference(inside, &state, &expected) / velocity
                });
                let courant = self.courant(&state);
                let is_last = left < 5.0;
                // A step also makes the flow fit to continuity, by as much however short it is: just after the start an error may be no
                // less in shorter steps.
                let may_shrink = dt > SHORTEST * courant;
                if may_shrink && (error.is_some_and(|error| error > 2.0 * tolerance) || dt > 1.6 * courant) {
                    number += 1;
                    continue;
                }
                let grown = level_of(number - 1);
                let may = error.is_none_or(|error| error * RATIO.powi(3) < 0.7 * tolerance) && grown < courant;
                if dt > courant || (may_shrink && error.is_some_and(|error| error > tolerance)) {
                    number += 1;
                } else if may && !is_last && sizes.len() % 4 == 3 {
                    number -= 1;
                }
            }
            time += dt;
            sizes.push(dt);
            watch(time, &state)?;
            let next = self.march.level(self.operators, state);
            let gone = std::mem::replace(&mut before, std::mem::replace(&mut now, next));
            earlier = (sizes.len() > 3).then_some((gone.state, step.last));
        }
        Ok(sizes)
    }
}
