//! Flows at fixed particles in time, in the plane and in space.
//!
//! Backward differences of second order with advection extrapolated from the last two states (Ascher, Ruuth and Wetton 1995;
//! variable steps: Wang and Ruuth 2008): with r the size dt of a step over that of the last one,
//!
//! ```text
//!   momentum    (a0 u+ - a1 u + a2 u-) / dt + (1 + r) N(u) - r N(u-) + grad p+ - nu lap u+ - f - b (T+ - T0) = 0
//!   continuity  div u+ - tau S p+ + lambda = 0
//!   heat        (a0 T+ - a1 T + a2 T-) / dt + (1 + r) N(T) - r N(T-) - alpha lap T+ = 0
//!
//!   a0 = (1 + 2 r) / (1 + r),   a1 = 1 + r,   a2 = r^2 / (1 + r),   N(f) = u . grad f,   1 / tau = 1 / tau_steady + a0 / (lag dt).
//! ```
//!
//! Where flows are corrected, what the slopes of the state before a step lack is added to all three ([`super::deferred_correction`]).
//!
//! The first two steps have r = 0, Euler's: the fields at the start need not fit to the walls. Velocity and pressure are solved
//! for together, so there is no error of splitting and walls hold to rounding. The matrix is the same for all steps of one
//! size; how it is solved with is a matter of the dimension ([`super::march`], [`super::space::march`]).
//!
//! The size follows from an estimate of the error of a step, the difference from what the last three states extrapolate to, and
//! from how far the fluid may go, in spacings: advection is explicit.

use super::deferred_correction::Defect;
use super::equations::{Bar, Condition, Derivatives, Motion, State, Warmth};
use super::fit::{Coefficients, Stencils};
use super::steady::NoSteadyState;
use crate::sph::laws::buoyancy::Buoyancy;
use std::borrow::Cow;

/// How far the fluid may go in a step, in spacings. (Behind a cylinder steps of 0.7 are stable, of 1 they are not.)
const COURANT: f64 = 0.5;
/// Sizes of steps are those of a geometric series, so that few matrices are factorised.
const RATIO: f64 = std::f64::consts::SQRT_2;
/// The error of a step in the difference from the extrapolation.
const SHARE: f64 = 0.18;
/// Steps become no shorter for their error than this part of the limit by advection in D dimensions.
const fn shortest(dimension: usize) -> f64 {
    match dimension {
        2 => 0.05,
        _ => 0.2,
    }
}

/// The first steps are of first order and start from a flow that the walls do not know, so they are this part of the limit. (In space each
/// size of step needs a matrix, which is what they cost there; at t = 0.3 forces are the same within 0.4 % with 0.3, 0.6 and 1.)
const fn at_start(dimension: usize) -> f64 {
    match dimension {
        2 => 0.1,
        _ => 0.3,
    }
}

/// How many steps tau is at most in the plane, inside and on the boundary.
///
/// Without viscosity and advection a step multiplies velocities by C = 1 - G (D G + lag S)^-1 D, whose eigenvalues must lie between -0.6
/// and 1. Pressures that the fits hardly see have some a little larger than 1: they grow by about 0.003 / lag in a step, however short it
/// is, against what viscosity takes away. Where S lowers D G, as beside the corners of a polygon, eigenvalues are negative: in steps a
/// hundredth of what advection allows -1.3 with a lag of 10 inside, -0.64 with 7, -0.49 with 6 and -0.37 with 5. On the boundary S should be large,
/// but not without bounds: with a lag of 10,000 pressures grow by a tenth in a step. With 10 everywhere two of 32 flows in the plane were
/// not finite, and with steps of 2e-5 five of 25; with these all were.
pub const LAG: [f64; 2] = [6.0, 10.0];

/// Steps without slopes of third order at the start: the pressure of the first one is that of the jolt which makes the flow fit to its walls.
const UNCORRECTED: usize = 3;

/// tau of each particle in steps with a0 / dt = `rate`, given that of the steady flow and how many steps it is at most, inside and on the
/// boundary.
pub fn lagged(damping: &[f64], inside: usize, lag: [f64; 2], rate: f64) -> Vec<f64> {
    damping.iter().enumerate().map(|(i, tau)| 1.0 / (1.0 / tau + rate / lag[usize::from(i >= inside)])).collect()
}

/// A step: its size, and that of the one before (0: it does not look back).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step {
    pub dt: f64,
    pub last: f64,
    /// Whether slopes of third order of the state before it are used, where there are such.
    pub is_corrected: bool,
}

impl Step {
    /// The step of a size after steps of these sizes. The state at the start may not fit to walls and continuity, so no step looks
    /// back to it.
    pub fn after(sizes: &[f64], dt: f64) -> Self {
        let last = if sizes.len() > 1 { sizes[sizes.len() - 1] } else { 0.0 };
        Self { dt, last, is_corrected: sizes.len() >= UNCORRECTED }
    }

    /// r, and a0, a1, a2 over dt.
    pub fn weights(&self) -> (f64, [f64; 3]) {
        let r = if self.last > 0.0 { self.dt / self.last } else { 0.0 };
        (r, [(1.0 + 2.0 * r) / (1.0 + r), 1.0 + r, r * r / (1.0 + r)].map(|a| a / self.dt))
    }
}

/// A state with its advection, u . grad of each field that is carried, at particles inside, and with what its slopes lack, if steps have it.
#[derive(Debug, Clone)]
pub struct Level<const F: usize = 4> {
    pub state: State<F>,
    pub advection: Vec<[f64; F]>,
    pub defect: Option<Defect>,
}

/// A state that a flow came to, and what its slopes lack, if steps have it.
#[derive(Clone, Copy)]
pub struct Reached<'a, const F: usize> {
    pub state: &'a State<F>,
    pub defect: Option<&'a Defect>,
}

impl<'a, const F: usize> From<&'a State<F>> for Reached<'a, F> {
    fn from(state: &'a State<F>) -> Self {
        Self { state, defect: None }
    }
}

impl<const F: usize> Level<F> {
    pub fn reached(&self) -> Reached<'_, F> {
        Reached { state: &self.state, defect: self.defect.as_ref() }
    }

    /// What is before the start: nothing looks back to it.
    pub fn none() -> Self {
        Self { state: State::at_rest(0), advection: vec![], defect: None }
    }
}

/// What the boundary is at a time, `[boundary]`, in D dimensions with F fields and fits of C coefficients.
pub trait InTime<const D: usize, const F: usize, const C: usize> {
    fn conditions(&self, time: f64) -> Vec<Condition<D>>;
    /// Whether they change with time.
    fn changes(&self) -> bool;
    /// The conditions at a time, given those at the start.
    fn at<'a>(&self, time: f64, start: &'a [Condition<D>]) -> Cow<'a, [Condition<D>]> {
        if self.changes() {
            Cow::Owned(self.conditions(time))
        } else {
            Cow::Borrowed(start)
        }
    }
    /// What cotangents of given velocities and temperatures at a time are of positions and of the parameters of formulas.
    fn pull_back(&self, time: f64, bar: &Bar<D, F, C>, position: &mut [Vec<f64>; D], parameters: &mut [f64]);
    /// What those of the first state's fields, `[F][N]`, are of the boundary and of positions.
    fn of_start(&self, fields: &[Vec<f64>; F], bar: &mut Bar<D, F, C>, position: &mut [Vec<f64>; D]);
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

/// What an iteration for a step's result may begin with.
#[derive(Clone, Copy)]
pub struct Guess<'a, const F: usize> {
    pub now: &'a State<F>,
    pub before: &'a State<F>,
    pub ratio: f64,
}

impl<const F: usize> Guess<'_, F> {
    /// A number of the result, extrapolated from the last two.
    pub fn of(&self, number: impl Fn(&State<F>) -> f64) -> f64 {
        let now = number(self.now);
        if self.ratio > 0.0 {
            now + self.ratio * (now - number(self.before))
        } else {
            now
        }
    }
}

/// The discrete equations of flows in time around one shape in D dimensions, with F = D + 2 fields (velocity, pressure, temperature) and
/// fits of C coefficients. Vectors of the flow are `[N, D + 1]`, and behind them lambda (where no pressure is given) and the drive
/// (where a flow rate is held).
pub trait Scheme<const D: usize, const F: usize, const C: usize> {
    fn particles(&self) -> usize;
    fn inside(&self) -> usize;
    fn boundary(&self) -> usize {
        self.particles() - self.inside()
    }
    /// How many matrices were prepared so far.
    fn factorisations(&self) -> usize;
    fn has_heat(&self) -> bool;
    fn force(&self) -> [f64; D];
    fn buoyancy(&self) -> Option<Buoyancy>;
    /// Whether lambda is an unknown, and the drive.
    fn extra(&self) -> [bool; 2];
    /// Stencils and coefficients of the slopes of what the flow carries.
    fn carriers(&self) -> (&Stencils<D>, &Coefficients<C>);
    /// Derivatives at the boundary, or everywhere.
    fn derivatives(&self, state: &State<F>, everywhere: bool) -> Derivatives<F, C>;
    /// See [`super::equations::Equations::by_fields`].
    fn by_fields(&self, bar: &Bar<D, F, C>) -> [Vec<f64>; F];
    /// What is known of the cotangents of positions while steps are gone through.
    type Sums;
    /// Nothing.
    fn sums(&self) -> Self::Sums;
    /// Adds what the derivatives of a state know of them, given their cotangents in `bar`.
    fn add_to(&self, sums: &mut Self::Sums, position: &[Vec<f64>; D], state: &State<F>, bar: &Bar<D, F, C>);
    /// The cotangents of positions.
    fn by_sums(&self, position: &[Vec<f64>; D], sums: Self::Sums) -> [Vec<f64>; D];
    /// See [`super::equations::Equations::pull_back_linear`]; `rate`: a0 / dt.
    fn pull_back_linear(
        &mut self,
        rate: f64,
        d: &Derivatives<F, C>,
        flow: &[f64],
        heat: Option<&[f64]>,
        bar: &mut Bar<D, F, C>,
    );
    /// The flow that solves the equations with a0 / dt = `rate` for a right-hand side, or without a guess their transpose.
    ///
    /// # Errors
    /// A matrix without factors, or iterations that do not converge.
    fn solve_flow(&mut self, rate: f64, right: &[f64], guess: Option<Guess<'_, F>>) -> Result<Vec<f64>, NoSteadyState>;
    /// The same of the temperature, `[N]`.
    ///
    /// # Errors
    /// As [`Self::solve_flow`].
    fn solve_heat(&mut self, rate: f64, right: &[f64], guess: Option<Guess<'_, F>>) -> Result<Vec<f64>, NoSteadyState>;

    /// What the slopes of a state lack ([`super::deferred_correction`]), if steps have it.
    fn defect(&self, _state: &State<F>) -> Option<Defect> {
        None
    }
    /// Adds what a state's fields, its derivatives in `bar` and positions have of what its slopes lack, given the cotangents of that.
    fn pull_back_defect(
        &self,
        _sums: &mut Self::Sums,
        _state: &State<F>,
        _defect: &Defect,
        _fields: &mut [Vec<f64>; F],
        _bar: &mut Bar<D, F, C>,
    ) {
    }

    /// The fields that the flow carries: the velocity, and T with heat.
    fn carried(&self) -> Vec<usize> {
        (0..D).chain(self.has_heat().then_some(D + 1)).collect()
    }

    /// The slopes of what is carried at particles inside, `[carried][inside]`.
    fn carried_slopes(&self, state: &State<F>) -> Vec<Vec<[f64; D]>> {
        let (stencils, coefficients) = self.carriers();
        let fields: Vec<&[f64]> = self.carried().into_iter().map(|field| &state.fields[field][..]).collect();
        coefficients.slopes(stencils, &fields, self.inside())
    }

    /// A state as a level.
    fn level(&self, state: State<F>) -> Level<F> {
        let slopes = self.carried_slopes(&state);
        let mut advection = vec![[0.0; F]; self.inside()];
        for (slopes, field) in slopes.iter().zip(self.carried()) {
            for (i, (to, slope)) in advection.iter_mut().zip(slopes).enumerate() {
                to[field] = (0..D).map(|e| state.fields[e][i] * slope[e]).sum();
            }
        }
        let defect = self.defect(&state);
        Level { state, advection, defect }
    }

    /// The state after a step from `now`, `before` it, with the conditions of its end. `flow_rate`: the one that is held.
    ///
    /// # Errors
    /// Those of [`Self::solve_flow`].
    fn step(
        &mut self,
        step: Step,
        now: &Level<F>,
        before: &Level<F>,
        conditions: &[Condition<D>],
        flow_rate: Option<f64>,
    ) -> Result<State<F>, NoSteadyState> {
        let (r, [a0, a1, a2]) = step.weights();
        let (n, inside, force, buoyancy) = (self.particles(), self.inside(), self.force(), self.buoyancy());
        let [pins, drives] = self.extra();
        let carried = |i: usize, field: usize| {
            let last = if r > 0.0 { r * before.advection[i][field] - a2 * before.state.fields[field][i] } else { 0.0 };
            a1 * now.state.fields[field][i] - (1.0 + r) * now.advection[i][field] + last
        };
        let guess = Some(Guess { now: &now.state, before: &before.state, ratio: r });
        let defect = now.defect.as_ref().filter(|_| step.is_corrected);
        let mut state = State::at_rest(n);
        if self.has_heat() {
            let mut right: Vec<f64> = (0..n)
                .map(|i| match i.checked_sub(inside).map(|k| conditions[k].warmth) {
                    None => carried(i, D + 1),
                    Some(Warmth::Given(given)) => given,
                    Some(Warmth::Flux(flux)) => -flux,
                })
                .collect();
            if let Some(Defect { heat, .. }) = defect {
                right.iter_mut().zip(heat).for_each(|(right, heat)| *right -= heat);
            }
            state.fields[D + 1] = self.solve_heat(a0, &right, guess)?;
        }
        let size = D + 1;
        let mut right = vec![0.0; size * n + usize::from(pins) + usize::from(drives)];
        for i in 0..n {
            for e in 0..D {
                right[size * i + e] = match i.checked_sub(inside).map(|k| conditions[k].motion) {
                    None => {
                        let lift = buoyancy.map_or(0.0, |buoyancy| buoyancy.along(e, state.fields[D + 1][i]));
                        carried(i, e) + force[e] + lift
                    }
                    Some(Motion::Given(given)) => given[e],
                    Some(_) => 0.0,
                };
            }
        }
        if let Some(Defect { flow, .. }) = defect {
            right.iter_mut().zip(flow).for_each(|(right, flow)| *right -= flow);
        }
        if let (Some(flow_rate), Some(last)) = (flow_rate, right.last_mut()) {
            *last = flow_rate;
        }
        let x = self.solve_flow(a0, &right, guess)?;
        for i in 0..n {
            (0..size).for_each(|f| state.fields[f][i] = x[size * i + f]);
        }
        let mut more = x[size * n..].iter();
        if pins {
            state.lambda = more.next().copied().unwrap_or(0.0);
        }
        state.drive = more.next().copied().unwrap_or(0.0);
        Ok(state)
    }
}

/// A flow that goes on in time, with steps whose size it chooses.
pub struct Flow<'a, M, const D: usize, const F: usize, const C: usize> {
    pub march: &'a mut M,
    pub boundary: &'a dyn InTime<D, F, C>,
    pub flow_rate: Option<f64>,
    /// Spacing of each particle.
    pub spacing: &'a [f64],
}

/// Root mean square of the difference of two velocities, over particles inside.
fn difference<const D: usize, const F: usize>(inside: usize, a: &State<F>, b: &[Vec<f64>; D]) -> f64 {
    let square = |e: usize| (0..inside).map(|i| (a.fields[e][i] - b[e][i]).powi(2)).sum::<f64>();
    ((0..D).map(square).sum::<f64>() / inside as f64).sqrt()
}

impl<M: Scheme<D, F, C>, const D: usize, const F: usize, const C: usize> Flow<'_, M, D, F, C> {
    fn speed(state: &State<F>, i: usize) -> f64 {
        (0..D).map(|e| state.fields[e][i].powi(2)).sum::<f64>().sqrt()
    }

    /// The largest size of a step by advection.
    fn courant(&self, state: &State<F>) -> f64 {
        let rates = (0..self.march.inside()).map(|i| Self::speed(state, i) / self.spacing[i]);
        COURANT / rates.fold(f64::MIN_POSITIVE, f64::max)
    }

    /// Takes steps of given sizes from `first` on.
    ///
    /// # Errors
    /// Those of [`Self::run`].
    pub fn repeat<E: From<NoSteadyState>>(
        &mut self,
        first: State<F>,
        sizes: &[f64],
        watch: &mut dyn FnMut(f64, Reached<'_, F>) -> Result<(), E>,
    ) -> Result<(), E> {
        let start = self.boundary.conditions(0.0);
        let (mut time, mut before, mut now) = (0.0, Level::none(), self.march.level(first));
        for (k, &dt) in sizes.iter().enumerate() {
            let step = Step::after(&sizes[..k], dt);
            time += dt;
            let conditions = self.boundary.at(time, &start);
            let state = self.march.step(step, &now, &before, &conditions, self.flow_rate)?;
            let next = self.march.level(state);
            watch(time, next.reached())?;
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
        first: State<F>,
        control: Control,
        watch: &mut dyn FnMut(f64, Reached<'_, F>) -> Result<(), E>,
    ) -> Result<Vec<f64>, E> {
        let Control { tolerance, velocity, fixed, end } = control;
        let inside = self.march.inside();
        let level_of = |number: i32| end * RATIO.powi(-number);
        // The number of the largest size that is at most `most`.
        let number_of = |most: f64| ((end / most).ln() / RATIO.ln()).ceil().max(0.0) as i32;
        let start = self.boundary.conditions(0.0);
        let mut time = 0.0;
        let mut now = self.march.level(first);
        let mut before = Level::none();
        let mut earlier: Option<(State<F>, f64)> = None;
        let mut sizes: Vec<f64> = vec![];
        let mut number = number_of(
            at_start(D) * self.courant(&now.state).min(self.spacing.iter().fold(f64::MAX, |a, &b| a.min(b)) / velocity),
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
            let state = self.march.step(step, &now, &before, &conditions, self.flow_rate)?;
            let fastest = (0..inside).map(|i| Self::speed(&state, i)).fold(0.0, f64::max);
            if fastest > 1e3 * velocity || state.fields.iter().flatten().any(|x| !x.is_finite()) {
                return Err(NoSteadyState::Unbounded { time }.into());
            }
            if fixed.is_none() {
                // Of second order from the last three states.
                let error = earlier.as_ref().map(|(earlier, size)| {
                    let (a, b) = (step.last, step.last + size);
                    let weights =
                        [(dt + a) * (dt + b) / (a * b), -dt * (dt + b) / (a * (b - a)), dt * (dt + a) / (b * (b - a))];
                    let expected: [Vec<f64>; D] = std::array::from_fn(|e| {
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
                let may_shrink = dt > shortest(D) * courant;
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
            let next = self.march.level(state);
            watch(time, next.reached())?;
            let gone = std::mem::replace(&mut before, std::mem::replace(&mut now, next));
            earlier = (sizes.len() > 3).then_some((gone.state, step.last));
        }
        Ok(sizes)
    }
}
