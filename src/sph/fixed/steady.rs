//! Steady states and their gradients. A fixed point needs one state and no checkpoints.
//!
//! With X = F(X, walls), b = dQ/dX and A = dF/dX, dQ/dwalls = (dF/dwalls)^T lambda, where lambda = A^T lambda + b
//! (Christianson 1994). Two modifications make this equation solvable in few steps:
//!
//! * A step conserves mass, so A^T w = w for the cotangent w of the mass, and lambda would grow by a multiple of w
//!   without bound. So lambda is projected to be free of w, which does not contribute to dQ/dwalls. The multiple,
//!   dQ/dmass, is computed at the end. It is the value of the fluid that a wall displaces, because a run starts with
//!   p = 0 and keeps the mass that it then has.
//! * The iteration lambda = sum (A^T)^k b converges as slowly as the flow settles. Generalised minimal residuals
//!   (GMRES, Saad and Schultz 1986) on blocks of steps, lambda = (A^T)^m lambda + b_m, need a fraction of the steps: a
//!   block damps sound, and the Krylov space takes the few slow modes that remain.

use super::factors::Factors;
use super::lattice::{row, Fixed};
use super::work::Work;
use crate::numerics::interrupt::is_asked_here;
use crate::numerics::lanes::Real;
use candle_core::DType;
use std::cell::RefCell;

/// The gradient of a quantity of a steady state.
#[derive(Debug, Clone)]
pub struct SteadyGradient {
    /// With respect to the heights of the points of the bottom and of the top wall, `[2 columns]`.
    pub walls: Vec<f64>,
    /// Number of adjoint steps.
    pub steps: usize,
    /// Residual of the equation for lambda, relative to its right-hand side.
    pub residual: f64,
}

/// The residual of a gradient in double precision, with the factors of a step.
const EXACT: f64 = 1e-10;

/// How the equation for lambda is solved.
#[derive(Debug, Clone, Copy)]
pub struct SteadyOptions {
    /// Adjoint steps per Krylov vector.
    pub block: usize,
    /// Largest number of Krylov vectors.
    pub vectors: usize,
    /// The residual at which the iteration ends.
    pub tolerance: f64,
}

impl Default for SteadyOptions {
    fn default() -> Self {
        Self { block: 5, vectors: 400, tolerance: 1e-4 }
    }
}

impl<R: Real> Fixed<R> {
    /// The rate at which a step changes a state, 1/time: the largest of |du/dt| and |dv/dt| over the fastest |u|,
    /// |dp/dt| over density c times that, and |dT/dt| over the hot wall's excess.
    pub fn residual(&self, state: &[R], next: &[R]) -> f64 {
        let (n, c) = (self.particles(), &self.channel);
        let most = |row: usize, f: &dyn Fn(usize) -> f64| {
            (row * n..(row + 1) * n).fold(0.0, |m: f64, k| {
                let value = f(k).abs();
                // A NaN must not count as a steady state.
                if value.is_nan() {
                    f64::INFINITY
                } else {
                    m.max(value)
                }
            })
        };
        let fastest = most(row::U, &|k| state[k].f64()).max(1e-12);
        let change = |row: usize| most(row, &|k| next[k].f64() - state[k].f64()) / c.dt;
        let heat = if c.hot_excess == 0.0 { 0.0 } else { change(row::T) / c.hot_excess.abs() };
        let flow = change(row::U).max(change(row::V)).max(change(row::P) / (c.density * c.sound_speed));
        heat.max(flow / fastest)
    }

    /// The gradient of a quantity of the steady state `state` `[6, N]` with respect to the walls. `bar` `[6, N]` is the
    /// derivative of the quantity by the state, in which the y rows of boundary points are for a fixed flow.
    ///
    /// The run is assumed to begin with p = 0, so fluid that a wall displaces is not pressed into the rest.
    pub fn steady_gradient(&self, state: &[R], bar: &[R], options: &SteadyOptions) -> SteadyGradient {
        let mut work = self.work();
        let (n, fluid) = (self.particles(), self.fluid_particles());
        let mut solve = Solve::new(self, state, &mut work);
        let mut flow = bar.to_vec();
        flow[..row::U * n].fill(R::default());
        // b_m = sum of (A^T)^k b, k < m.
        let b = solve.project(flow).0;
        let (lambda, residual) = match solve.by_factors(&b, options) {
            Some(found) => found,
            None => {
                let mut right = b.clone();
                for _ in 1..options.block {
                    right = solve.step(&right, Some(&b));
                }
                solve.gmres(&right, options)
            }
        };
        // One more step with the walls gives (dF/dwalls)^T lambda and the multiple of w that remains.
        let (steps, scale) = (solve.steps + 1, solve.mass_scale());
        let mut last = vec![R::default(); state.len()];
        self.backward(state, &lambda, &mut last, &mut work);
        let heights = row::Y * n + fluid..(row::Y + 1) * n;
        let mut walls: Vec<f64> = heights.clone().map(|k| last[k].f64() + bar[k].f64()).collect();
        let left = |p: usize| last[p].f64() + bar[p].f64() - lambda[p].f64();
        let by_mass = (row::P * n..row::P * n + fluid).map(left).sum::<f64>() / scale;
        let (nx, stiffness) = (self.channel.columns, self.stiffness());
        for i in 0..nx {
            let excess: f64 = (0..self.channel.rows).map(|j| state[row::P * n + j * nx + i].f64() / stiffness).sum();
            walls[i] += by_mass * excess / self.height();
            walls[nx + i] -= by_mass * excess / self.height();
        }
        self.done(work);
        SteadyGradient { walls, steps, residual }
    }

    /// Advances a state until [`Self::residual`] is at most `tolerance`, or for `most` steps. Returns the number of
    /// steps and the residual. Blocks of steps are accelerated by Anderson's (1965) method with `depth` previous blocks
    /// (0: plain steps). Mass is conserved, because averages of states of equal mass have that mass.
    pub fn settle(&self, state: &mut Vec<R>, block: usize, depth: usize, tolerance: f64, most: usize) -> (usize, f64) {
        let (mut work, mut next) = (self.work(), state.clone());
        let found = self.accelerated(state, depth, tolerance, most, &mut |state| {
            for _ in 0..block.max(1) {
                self.forward(state, &mut next, &mut work);
                std::mem::swap(state, &mut next);
            }
            (block.max(1), self.residual(&next, state))
        });
        self.done(work);
        found
    }

    /// Repeats `advance`, which returns the steps that it took and their residual, until that is at most `tolerance`, or for `most` steps, with
    /// Anderson's acceleration.
    pub(super) fn accelerated(
        &self,
        state: &mut Vec<R>,
        depth: usize,
        tolerance: f64,
        most: usize,
        advance: &mut dyn FnMut(&mut Vec<R>) -> (usize, f64),
    ) -> (usize, f64) {
        let mut from = state.clone();
        let (mut steps, mut residual) = (0, f64::INFINITY);
        // Differences between the ends of blocks, and between their increments.
        let (mut ends, mut ways) = (Vec::<Vec<R>>::new(), Vec::<Vec<R>>::new());
        let mut last: Option<(Vec<R>, Vec<R>)> = None;
        let minus = |a: &[R], b: &[R]| -> Vec<R> { a.iter().zip(b).map(|(a, b)| *a - *b).collect() };
        let sizes = self.sizes().map(|size| 1.0 / size.max(1e-300));
        while steps < most && !is_asked_here() {
            from.copy_from_slice(state);
            let found = advance(state);
            steps += found.0;
            residual = found.1;
            if residual <= tolerance || !residual.is_finite() {
                break;
            }
            if depth == 0 {
                continue;
            }
            let way = minus(state, &from);
            if let Some((end_before, way_before)) = last.replace((state.clone(), way.clone())) {
                if ends.len() == depth {
                    ends.remove(0);
                    ways.remove(0);
                }
                ends.push(minus(state, &end_before));
                ways.push(minus(&way, &way_before));
            }
            // Projects the increment onto the previous ones by Gram-Schmidt orthogonalisation.
            let (mut rest, mut bases) = (way, Vec::<(Vec<R>, Vec<R>)>::new());
            for (way, end) in ways.iter().zip(&ends).rev() {
                let (mut way, mut end) = (way.clone(), end.clone());
                let before = self.weighted(&sizes, &way, &way);
                for (base, base_end) in &bases {
                    let share = R::of(self.weighted(&sizes, base, &way));
                    way.iter_mut().zip(base).for_each(|(x, b)| *x -= share * *b);
                    end.iter_mut().zip(base_end).for_each(|(x, b)| *x -= share * *b);
                }
                let square = self.weighted(&sizes, &way, &way);
                // A remainder this small is rounding: the newer increments already span this one.
                if square.is_nan() || square <= 1e-12 * before {
                    continue;
                }
                let scale = R::of(1.0 / square.sqrt());
                way.iter_mut().chain(end.iter_mut()).for_each(|x| *x *= scale);
                let share = R::of(self.weighted(&sizes, &way, &rest));
                rest.iter_mut().zip(&way).for_each(|(x, b)| *x -= share * *b);
                state.iter_mut().zip(&end).for_each(|(x, b)| *x -= share * *b);
                bases.push((way, end));
            }
        }
        (steps, residual)
    }

    /// Squares of the scales by which u, v, p and T are compared.
    fn sizes(&self) -> [f64; row::COUNT] {
        let c = &self.channel;
        [0.0, 0.0, 1.0, 1.0, c.density * c.sound_speed, c.hot_excess].map(|size| size * size)
    }

    /// Weighted scalar product of the flow rows of two states.
    fn weighted(&self, weights: &[f64; row::COUNT], a: &[R], b: &[R]) -> f64 {
        let n = self.particles();
        (row::U..row::COUNT)
            .map(|r| {
                let rows = r * n..(r + 1) * n;
                weights[r] * a[rows.clone()].iter().zip(&b[rows]).map(|(x, y)| x.f64() * y.f64()).sum::<f64>()
            })
            .sum()
    }

    fn stiffness(&self) -> f64 {
        self.channel.density * self.channel.sound_speed * self.channel.sound_speed
    }
}

/// The equation for lambda at a state.
struct Solve<'a, R: Real> {
    fixed: &'a Fixed<R>,
    state: &'a [R],
    work: &'a mut Work<R>,
    /// w: the derivative of the mass, sum D (1 + p/(density c^2)), with respect to p.
    mass: Vec<R>,
    /// Squares of the scales of u, v, p and T, which make their cotangents comparable.
    sizes: [f64; row::COUNT],
    steps: usize,
}

impl<'a, R: Real> Solve<'a, R> {
    fn new(fixed: &'a Fixed<R>, state: &'a [R], work: &'a mut Work<R>) -> Self {
        let c = &fixed.channel;
        let square = c.spacing * c.spacing;
        let mass = fixed.volumes(state).iter().map(|v| R::of(v / square / fixed.stiffness())).collect();
        Self { fixed, state, work, mass, sizes: fixed.sizes(), steps: 0 }
    }

    /// The sum of w over all particles.
    fn mass_scale(&self) -> f64 {
        self.mass.iter().map(|w| w.f64()).sum()
    }

    /// Projects lambda to be free of w, and returns the multiple of w that was removed.
    fn project(&self, mut lambda: Vec<R>) -> (Vec<R>, f64) {
        let from = row::P * self.fixed.particles();
        let p = &mut lambda[from..from + self.mass.len()];
        let multiple = p.iter().map(|x| x.f64()).sum::<f64>() / self.mass_scale();
        p.iter_mut().zip(&self.mass).for_each(|(x, w)| *x -= R::of(multiple) * *w);
        (lambda, multiple)
    }

    /// A^T lambda (+ b), projected to be free of w.
    fn step(&mut self, lambda: &[R], b: Option<&[R]>) -> Vec<R> {
        self.steps += 1;
        let mut pulled = vec![R::default(); lambda.len()];
        self.fixed.backward_of_flow(self.state, lambda, &mut pulled, self.work);
        if let Some(b) = b {
            pulled.iter_mut().zip(b).for_each(|(x, b)| *x += *b);
        }
        self.project(pulled).0
    }

    fn product(&self, a: &[R], b: &[R]) -> f64 {
        self.fixed.weighted(&self.sizes, a, b)
    }

    /// Solves lambda = A^T lambda + b with the factors of a step, and returns the residual relative to b; none where there are no factors, or
    /// where they do not help.
    fn by_factors(&mut self, b: &[R], options: &SteadyOptions) -> Option<(Vec<R>, f64)> {
        let fixed = self.fixed;
        let reference = fixed.reference()?;
        let tolerance = if R::DTYPE == DType::F64 { options.tolerance.min(EXACT) } else { options.tolerance };
        let (state, mass) = (self.state, self.mass.clone());
        let this = RefCell::new(self);
        let step = |lambda: &[R]| this.borrow_mut().step(lambda, None);
        let solved = |factors: &Factors| fixed.adjoint_by(factors, (b, &mass), tolerance, &step);
        let found = solved(reference).or_else(|| solved(&fixed.factors(state).ok()?))?;
        let product = this.borrow_mut().step(&found, Some(b));
        let rest: Vec<R> = product.iter().zip(&found).map(|(a, b)| *a - *b).collect();
        let this = this.into_inner();
        let residual = (this.product(&rest, &rest) / this.product(b, b).max(f64::MIN_POSITIVE)).sqrt();
        Some((found, residual))
    }

    /// Solves lambda = (A^T)^m lambda + `right`, and returns the residual relative to that of lambda = `right`.
    fn gmres(&mut self, right: &[R], options: &SteadyOptions) -> (Vec<R>, f64) {
        let axpy = |y: &mut [R], a: f64, x: &[R]| y.iter_mut().zip(x).for_each(|(y, x)| *y += R::of(a) * *x);
        let scaled = |x: &[R], a: f64| -> Vec<R> { x.iter().map(|x| R::of(x.f64() * a)).collect() };
        let size = self.product(right, right).sqrt();
        if size == 0.0 {
            return (right.to_vec(), 0.0);
        }
        let mut vectors = vec![scaled(right, 1.0 / size)];
        // The triangular matrix of Arnoldi's coefficients after Givens rotations, by columns, and the rotated `right`.
        let (mut columns, mut rotations) = (Vec::<Vec<f64>>::new(), Vec::<[f64; 2]>::new());
        let mut rest = vec![size];
        while columns.len() < options.vectors && rest[columns.len()].abs() > options.tolerance * size {
            if is_asked_here() {
                break;
            }
            let k = columns.len();
            let mut next = vectors[k].clone();
            for _ in 0..options.block {
                next = self.step(&next, None);
            }
            // (I - (A^T)^m) v.
            next.iter_mut().zip(&vectors[k]).for_each(|(x, v)| *x = *v - *x);
            let mut column = Vec::with_capacity(k + 2);
            for vector in &vectors {
                let h = self.product(vector, &next);
                axpy(&mut next, -h, vector);
                column.push(h);
            }
            let length = self.product(&next, &next).sqrt();
            column.push(length);
            for (i, [c, s]) in rotations.iter().enumerate() {
                let (a, b) = (column[i], column[i + 1]);
                (column[i], column[i + 1]) = (c * a + s * b, c * b - s * a);
            }
            let hypotenuse = column[k].hypot(column[k + 1]);
            if hypotenuse.is_nan() || hypotenuse == 0.0 {
                break;
            }
            let [c, s] = [column[k] / hypotenuse, column[k + 1] / hypotenuse];
            column[k] = hypotenuse;
            rotations.push([c, s]);
            rest.push(-s * rest[k]);
            rest[k] *= c;
            columns.push(column);
            if length == 0.0 {
                break;
            }
            vectors.push(scaled(&next, 1.0 / length));
        }
        let count = columns.len();
        let mut factors = vec![0.0; count];
        for i in (0..count).rev() {
            let known: f64 = (i + 1..count).map(|j| columns[j][i] * factors[j]).sum();
            factors[i] = (rest[i] - known) / columns[i][i];
        }
        let mut lambda = vec![R::default(); right.len()];
        for (factor, vector) in factors.iter().zip(&vectors) {
            axpy(&mut lambda, *factor, vector);
        }
        (lambda, rest[count].abs() / size)
    }
}
