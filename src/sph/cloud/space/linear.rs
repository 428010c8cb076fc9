//! The linearised flow in space, and its solution by GMRES with a block preconditioner.
//!
//! With the rows of momentum K, G and those of continuity D, S of the four unknowns at each particle,
//!
//! ```text
//!   A = | K  G |      P = | K  G |      X^-1 = nu - (u . grad) lap^-1.
//!       | D  S |          | 0  X |
//! ```
//!
//! X is near the Schur complement S - D K^-1 G: of a slow flow this is an operator near 1 / nu, and of others the slopes nearly commute
//! with K, "pressure convection-diffusion" (Silvester and Wathen 1994; Kay, Loghin and Wathen 2002; Elman, Silvester and Wathen 2014).
//!
//! Steps in time have incomplete factors of all of A instead, whose blocks hold the velocity and the pressure of a particle: a0 / dt in K and
//! the damping S are large on its diagonal. Their iterations grow with the number of particles along a side (18, 19 and 26 with 1057,
//! 3602 and 12,760 particles, to 1e-10). With P and X^-1 = nu - a0 / dt lap^-1 (Cahouet and Chabard 1988) there are 65 to 80, each several times
//! as long, since S is up to ten times a0 / dt lap^-1 for pressures that change from point to point, and no Laplacian has that; with
//! (lap + a0 / dt tau S)^-1 there are as many, and the inner iterations do not converge.
//!
//! K^-1 and lap^-1 are GMRES again, with incomplete factors and a correction on groups of particles ([`crate::numerics::two_level`]), to a
//! third, which one or two products reach; so the outer iteration is a flexible one (Saad 1993). A pair of particles has five numbers: K's,
//! the slopes along x, y and z, and S's; which of them a row takes is a matter of its particle. Vectors are `[N, 4]`, and behind them the
//! numbers of the whole flow: lambda and a drive, as a border of the matrix.

use super::super::equations::Warmth;
use super::super::fit::{Coefficients, COEFFICIENTS_3D as C, LEFT_3D as LEFT};
use super::super::steady::dense;
use super::equations::{dot, laplacian, Condition, Derivatives, End, Equations, Motion, State, FLOW, PRESSURE};
use super::scalar::Scalar;
use crate::numerics::incomplete_lu::IncompleteLu;
use crate::numerics::krylov::gmres_restarted;
use crate::numerics::sparse_lu::{dot as product, BlockMatrix, Order, Singular, SparseLu};
use std::ops::Range;
use std::sync::Arc;

/// Products before GMRES begins anew, and at most. (The adjoint of a ball in a duct at a Reynolds number of 53 takes 475, and more than 600 if
/// GMRES begins anew after 120.)
pub(super) const PRODUCTS: (usize, usize) = (300, 1500);
/// In a step in time GMRES begins anew where its vectors take more memory than this, but not before so many products. (The first step of the flow
/// around a ball takes 67 products, those after it about 20.)
const BASIS: (usize, usize) = (200_000_000, 40);
/// Relative residual of a solution with K or the Laplacian. (A twentieth saves a tenth of the outer
/// iterations, each of which takes twice as long.)
const INNER: f64 = 0.3;

/// Which of a pair's numbers the rows of a particle take.
#[derive(Debug, Clone, Copy, Default)]
struct Takes {
    /// K's in the row of each velocity, the slopes of the pressure there, slopes of the velocity in continuity's row.
    carries: [f64; 3],
    pushes: f64,
    flows: f64,
}

/// The matrix A at a state, or its transpose, by pairs of particles.
#[derive(Debug)]
pub struct Linear {
    transposed: bool,
    first: Vec<usize>,
    column: Vec<u32>,
    /// K, x, y, z, S.
    pairs: Vec<[f64; 5]>,
    takes: Vec<Takes>,
    /// Each particle's own block, row by row.
    own: Vec<[[f64; FLOW]; FLOW]>,
    viscosity: f64,
    /// a0 / dt.
    rate: f64,
    /// Whether the pressure is given at a particle.
    given: Vec<bool>,
    /// The velocity of particles inside, 0 at others; none of a flow at rest.
    velocity: Option<Vec<[f64; 3]>>,
    /// A Laplacian of positive weights, 4.8 / h^2 times the mean of f_j - f_i by the fits' W (whose mean of s^2 is 1.25). At walls, whose
    /// neighbours are on one side, it is a slope. It only serves the preconditioner, where the fits' own would converge slowly.
    laplace: BlockMatrix,
}

impl Linear {
    /// `rate`: a0 / dt of a step in time, of which `state` is one at rest; 0 of a steady flow.
    pub fn new(equations: &Equations, state: &State, d: &Derivatives, operators: &Coefficients<C>, rate: f64) -> Self {
        let n = equations.particles();
        let most = equations.fits.all.list.len();
        let (mut first, mut column, mut pairs) = (vec![0], Vec::with_capacity(most), Vec::with_capacity(most));
        let (mut takes, mut own) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let is_at_rest = state.fields[..3].iter().flatten().all(|&u| u == 0.0);
        let mut laplace = if is_at_rest { BlockMatrix::default() } else { equations.fits.all.matrix(1) };
        for i in 0..n {
            let condition = equations.condition(i);
            let motion = condition.map(|condition| condition.motion);
            let u = state.velocity(i);
            let mut sum = [0.0; 5];
            let scale = equations.fits.all.scale(i);
            let weights: f64 = (0..equations.fits.all.count(i)).map(|k| equations.fits.all.pair(i, k).1).sum();
            for k in 0..equations.fits.all.count(i) {
                let (j, c) = (equations.fits.all.neighbour(i, k), operators.of(i, k));
                if j == i {
                    continue;
                }
                let carried = match condition {
                    None => dot(u, &c) - equations.viscosity * laplacian(&c),
                    Some(Condition { motion: Motion::Given(_), .. }) => 0.0,
                    Some(condition) => -condition.across(&c, equations.smoothing(i)),
                };
                let pair = [carried, c[0], c[1], c[2], -equations.damping[i] * c[LEFT]];
                sum.iter_mut().zip(&pair).for_each(|(sum, x)| *sum -= x);
                column.push(j as u32);
                pairs.push(pair);
                if !is_at_rest && !matches!(motion, Some(Motion::Outflow(_))) {
                    let value = 4.8 * equations.fits.all.pair(i, k).1 / (weights * scale * scale);
                    let (entry, diagonal) = (laplace.entry(i, j as u32), laplace.entry(i, i as u32));
                    laplace.values[entry] += value;
                    laplace.values[diagonal] -= value;
                }
            }
            if !is_at_rest {
                // Where no pressure is given, a constant is left; this is small beside all others.
                let diagonal = laplace.entry(i, i as u32);
                laplace.values[diagonal] -= match motion {
                    Some(Motion::Outflow(_)) => 1.0 / (scale * scale),
                    None => 1e-6 / (scale * scale),
                    Some(_) => 0.0,
                };
            }
            first.push(column.len());
            let mut take = Takes { carries: [1.0; 3], pushes: 0.0, flows: 1.0 };
            match motion {
                None => take.pushes = 1.0,
                Some(Motion::Given(_)) => take.carries = [0.0; 3],
                Some(Motion::Symmetry(along)) => take.carries[along] = 0.0,
                Some(Motion::Outflow(_)) => take.flows = 0.0,
            }
            let mut block = [[0.0; FLOW]; FLOW];
            for e in 0..3 {
                block[e][e] = take.carries[e] * sum[0];
                block[e][PRESSURE] = take.pushes * sum[1 + e];
                block[PRESSURE][e] = take.flows * sum[1 + e];
                match motion {
                    None => {
                        block[e][e] += rate;
                        (0..3).for_each(|along| block[e][along] += d.0[e][i][along]);
                    }
                    Some(Motion::Given(_)) => block[e][e] = 1.0,
                    Some(Motion::Symmetry(along)) if along == e => block[e][e] = 1.0,
                    Some(_) => {}
                }
            }
            block[PRESSURE][PRESSURE] = if take.flows == 0.0 { 1.0 } else { sum[4] };
            takes.push(take);
            own.push(block);
        }
        let given = takes.iter().map(|take| take.flows == 0.0).collect();
        let moving = |i: usize| if i < equations.inside { state.velocity(i) } else { [0.0; 3] };
        let velocity = (!is_at_rest).then(|| (0..n).map(moving).collect());
        let viscosity = equations.viscosity;
        Self { transposed: false, first, column, pairs, takes, own, viscosity, rate, given, velocity, laplace }
    }

    fn particles(&self) -> usize {
        self.takes.len()
    }

    /// The transpose: pairs by their second particle.
    pub fn transposed(mut self) -> Self {
        let n = self.particles();
        if self.velocity.is_some() {
            self.laplace.transpose();
        }
        let mut first = vec![0; n + 1];
        self.column.iter().for_each(|&j| first[j as usize + 1] += 1);
        (0..n).for_each(|j| first[j + 1] += first[j]);
        let mut next = first.clone();
        let (mut column, mut pairs) = (vec![0; self.column.len()], vec![[0.0; 5]; self.column.len()]);
        for i in 0..n {
            for e in self.first[i]..self.first[i + 1] {
                let to = &mut next[self.column[e] as usize];
                (column[*to], pairs[*to]) = (i as u32, self.pairs[e]);
                *to += 1;
            }
        }
        let turned = |block: &[[f64; FLOW]; FLOW]| std::array::from_fn(|a| std::array::from_fn(|b| block[b][a]));
        let own = self.own.iter().map(turned).collect();
        Self { transposed: !self.transposed, first, column, pairs, own, ..self }
    }

    /// y = A x of some particles.
    fn rows(&self, x: &[f64], rows: Range<usize>, y: &mut [f64]) {
        for (i, y) in rows.zip(y.chunks_exact_mut(FLOW)) {
            let mut sum = [0.0; FLOW];
            let mut push = [0.0; 3];
            let (mut carried, mut flow) = ([0.0; 3], 0.0);
            let takes = self.takes[i];
            for e in self.first[i]..self.first[i + 1] {
                let j = self.column[e] as usize;
                let (x, [k, gx, gy, gz, s]) = (&x[FLOW * j..FLOW * (j + 1)], self.pairs[e]);
                if self.transposed {
                    let from = self.takes[j];
                    let pressure = from.flows * x[PRESSURE];
                    (0..3).for_each(|e| carried[e] += k * from.carries[e] * x[e]);
                    (0..3).for_each(|e| push[e] += [gx, gy, gz][e] * pressure);
                    flow += from.pushes * (gx * x[0] + gy * x[1] + gz * x[2]) + s * pressure;
                } else {
                    (0..3).for_each(|e| carried[e] += k * x[e]);
                    (0..3).for_each(|e| push[e] += [gx, gy, gz][e] * x[PRESSURE]);
                    flow += gx * x[0] + gy * x[1] + gz * x[2] + s * x[PRESSURE];
                }
            }
            let own = &x[FLOW * i..FLOW * (i + 1)];
            for a in 0..FLOW {
                sum[a] = (0..FLOW).map(|b| self.own[i][a][b] * own[b]).sum();
            }
            if self.transposed {
                (0..3).for_each(|e| y[e] = sum[e] + carried[e] + push[e]);
                y[PRESSURE] = sum[PRESSURE] + flow;
            } else {
                (0..3).for_each(|e| y[e] = sum[e] + takes.carries[e] * carried[e] + takes.pushes * push[e]);
                y[PRESSURE] = sum[PRESSURE] + takes.flows * flow;
            }
        }
    }

    /// y = A x, by threads with rows of their own.
    fn times(&self, x: &[f64], threads: usize) -> Vec<f64> {
        let n = self.particles();
        let mut y = vec![0.0; FLOW * n];
        let share = n.div_ceil(threads.max(1)).max(1);
        std::thread::scope(|scope| {
            for (part, y) in y.chunks_mut(FLOW * share).enumerate() {
                let rows = part * share..n.min((part + 1) * share);
                scope.spawn(move || self.rows(x, rows, y));
            }
        });
        y
    }

    /// (u . grad) f of a field, or its transpose.
    fn carried(&self, velocity: &[[f64; 3]], f: &[f64]) -> Vec<f64> {
        let along = |u: [f64; 3], [_, gx, gy, gz, _]: [f64; 5]| u[0] * gx + u[1] * gy + u[2] * gz;
        let mut found = vec![0.0; f.len()];
        for i in 0..f.len() {
            for e in self.first[i]..self.first[i + 1] {
                let j = self.column[e] as usize;
                let from = if self.transposed { j } else { i };
                let by = along(velocity[from], self.pairs[e]);
                found[i] += by * f[j];
                found[from] -= by * f[from];
            }
        }
        found
    }

    /// What the pressures push in the rows of momentum: G p, or D^T p.
    fn pushed(&self, p: &[f64], threads: usize) -> Vec<f64> {
        let x: Vec<f64> = p.iter().flat_map(|p| [0.0, 0.0, 0.0, *p]).collect();
        self.times(&x, threads)
    }

    /// Whether K is the same for two components of the velocity.
    fn is_alike(&self, a: usize, b: usize) -> bool {
        self.takes.iter().all(|take| take.carries[a] == take.carries[b])
    }

    /// A matrix of zeros with blocks of a size where this one has them.
    fn zeros(&self, size: usize) -> BlockMatrix {
        let list = |i: usize| self.column[self.first[i]..self.first[i + 1]].to_vec();
        BlockMatrix::of_lists(self.particles(), size, list)
    }

    /// The blocks of a row of all of the matrix, each with its column. Where no pressure is given, a constant is left; one particle's is
    /// held.
    fn blocks(&self, i: usize, add: &mut dyn FnMut(u32, &[f64])) {
        for e in self.first[i]..self.first[i + 1] {
            let (j, [k, gx, gy, gz, s]) = (self.column[e], self.pairs[e]);
            let takes = self.takes[if self.transposed { j as usize } else { i }];
            let (to_momentum, to_continuity) =
                if self.transposed { (takes.flows, takes.pushes) } else { (takes.pushes, takes.flows) };
            let mut block = [[0.0; FLOW]; FLOW];
            for (a, slope) in [gx, gy, gz].into_iter().enumerate() {
                block[a][a] = takes.carries[a] * k;
                block[a][PRESSURE] = to_momentum * slope;
                block[PRESSURE][a] = to_continuity * slope;
            }
            block[PRESSURE][PRESSURE] = takes.flows * s;
            add(j, block.as_flattened());
        }
        let mut own = self.own[i];
        if i == 0 && !self.given.contains(&true) {
            own[PRESSURE][PRESSURE] *= 2.0;
        }
        add(i as u32, own.as_flattened());
    }

    /// All of the matrix.
    fn whole(&self) -> BlockMatrix {
        let mut matrix = self.zeros(FLOW);
        for i in 0..self.particles() {
            self.blocks(i, &mut |j, block| {
                let entry = matrix.entry(i, j);
                matrix.block_mut(entry).iter_mut().zip(block).for_each(|(to, x)| *to += x);
            });
        }
        matrix
    }

    /// Incomplete factors of all of the matrix.
    ///
    /// # Errors
    /// A particle whose own block has no inverse.
    fn nearly(&self) -> Result<IncompleteLu<FLOW>, Singular> {
        IncompleteLu::of_rows(&self.zeros(0), |i, add| self.blocks(i, add))
    }

    /// K of a component of the velocity, without what the flow's own slopes add.
    fn carrying(&self, component: usize) -> BlockMatrix {
        let mut matrix = self.zeros(1);
        for i in 0..self.particles() {
            for e in self.first[i]..self.first[i + 1] {
                let j = self.column[e] as usize;
                let from = if self.transposed { j } else { i };
                let value = self.takes[from].carries[component] * self.pairs[e][0];
                let entry = matrix.entry(i, j as u32);
                matrix.values[entry] += value;
                let diagonal = matrix.entry(from, from as u32);
                matrix.values[diagonal] -= value;
            }
            if self.takes[i].carries[component] == 0.0 {
                let diagonal = matrix.entry(i, i as u32);
                matrix.values[diagonal] = 1.0;
            }
        }
        matrix
    }
}

/// A matrix with its border, and the preconditioner.
pub struct System {
    pub linear: Linear,
    columns: Vec<Vec<f64>>,
    rows: Vec<Vec<f64>>,
    corner: Vec<Vec<f64>>,
    threads: usize,
    /// K of each component of the velocity (by index), each on one thread.
    carrying: Vec<Scalar>,
    which: [usize; 3],
    /// The Laplacian, where the flow is not at rest.
    laplace: Option<Scalar>,
    /// Solutions of the preconditioner with each column.
    solved: Vec<Vec<f64>>,
    /// Factors of all of the matrix, instead of those of its parts.
    whole: Option<Whole>,
}

/// Factors of all of a matrix.
enum Whole {
    Exact(SparseLu),
    Nearly(IncompleteLu<FLOW>),
}

impl Whole {
    fn solve(&self, right: &[f64]) -> Vec<f64> {
        match self {
            Self::Exact(factors) => factors.solve(right, false),
            Self::Nearly(factors) => factors.solve(right),
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Self::Exact(factors) => factors.bytes(),
            Self::Nearly(factors) => factors.bytes(),
        }
    }
}

/// Columns, rows and corner of a border.
pub type Border = [Vec<Vec<f64>>; 3];

impl System {
    /// With an order of elimination the whole matrix is factorised, which pays for few particles; that of a step in time is otherwise so
    /// incompletely.
    ///
    /// # Errors
    /// A particle without a diagonal entry, or a matrix without factors.
    pub fn new(
        mut linear: Linear,
        [columns, rows, corner]: Border,
        threads: usize,
        order: Option<&Arc<Order>>,
    ) -> Result<Self, Singular> {
        let whole = match order {
            Some(order) => Some(Whole::Exact(SparseLu::new(order, &linear.whole(), threads)?)),
            None if linear.rate > 0.0 => Some(Whole::Nearly(linear.nearly()?)),
            None => None,
        };
        let parts = if whole.is_some() { 0 } else { 3 };
        let mut which = [0; 3];
        let mut carrying: Vec<Scalar> = vec![];
        for e in 0..parts {
            if let Some(other) = (0..e).find(|&other| linear.is_alike(e, other)) {
                which[e] = which[other];
                continue;
            }
            which[e] = carrying.len();
            carrying.push(Scalar::new(linear.carrying(e), 1)?);
        }
        let has_laplace = whole.is_none() && !linear.laplace.values.is_empty();
        let laplace = has_laplace.then(|| Scalar::new(std::mem::take(&mut linear.laplace), threads)).transpose()?;
        let solved = vec![];
        let mut system = Self { linear, columns, rows, corner, threads, carrying, which, laplace, solved, whole };
        system.solved = system.columns.iter().map(|column| system.inner(column)).collect();
        Ok(system)
    }

    /// Memory of matrices and factors.
    pub fn bytes(&self) -> usize {
        let whole = self.whole.as_ref().map_or(0, Whole::bytes);
        let parts = self.carrying.iter().chain(&self.laplace).map(Scalar::bytes);
        whole + 44 * self.linear.pairs.len() + parts.sum::<usize>()
    }

    /// A x, with its border.
    pub fn times(&self, x: &[f64]) -> Vec<f64> {
        let (own, extra) = x.split_at(x.len() - self.columns.len());
        let mut y = self.linear.times(own, self.threads);
        for (column, e) in self.columns.iter().zip(extra) {
            y.iter_mut().zip(column).for_each(|(y, c)| *y += c * e);
        }
        for (row, corner) in self.rows.iter().zip(&self.corner) {
            y.push(product(row, own) + product(corner, extra));
        }
        y
    }

    /// X^-1 of residuals of continuity; where the pressure is given, themselves.
    fn pressure(&self, right: Vec<f64>) -> Vec<f64> {
        let linear = &self.linear;
        let free: Vec<f64> = right.iter().zip(&linear.given).map(|(x, given)| if *given { 0.0 } else { *x }).collect();
        let carried = match (&linear.velocity, &self.laplace) {
            (Some(velocity), Some(laplace)) if linear.transposed => {
                laplace.nearly(&linear.carried(velocity, &free), INNER)
            }
            (Some(velocity), Some(laplace)) => {
                // The slope across walls is 0.
                let inside: Vec<f64> =
                    (0..free.len()).map(|i| if linear.takes[i].pushes > 0.0 { free[i] } else { 0.0 }).collect();
                linear.carried(velocity, &laplace.nearly(&inside, INNER))
            }
            _ => vec![0.0; free.len()],
        };
        (0..free.len())
            .map(|i| if linear.given[i] { right[i] } else { linear.viscosity * free[i] - carried[i] })
            .collect()
    }

    /// P^-1 of a vector without border.
    fn inner(&self, right: &[f64]) -> Vec<f64> {
        if let Some(whole) = &self.whole {
            return whole.solve(right);
        }
        let linear = &self.linear;
        let n = linear.particles();
        let pressure = self.pressure((0..n).map(|i| right[FLOW * i + PRESSURE]).collect());
        let pushed = linear.pushed(&pressure, self.threads);
        let of = |e: usize| {
            let right: Vec<f64> = (0..n).map(|i| right[FLOW * i + e] - pushed[FLOW * i + e]).collect();
            self.carrying[self.which[e]].nearly(&right, INNER)
        };
        let velocity: [Vec<f64>; 3] = match self.threads {
            0 | 1 => std::array::from_fn(of),
            _ => std::thread::scope(|scope| {
                let others = [1, 2].map(|e| scope.spawn(move || of(e)));
                let first = of(0);
                let [second, third] = others.map(|other| other.join().unwrap_or_default());
                [first, second, third]
            }),
        };
        (0..n).flat_map(|i| [velocity[0][i], velocity[1][i], velocity[2][i], pressure[i]]).collect()
    }

    /// An approximate solution, with the border.
    pub(super) fn precondition(&self, right: &[f64]) -> Vec<f64> {
        let m = self.columns.len();
        let (own, extra) = right.split_at(right.len() - m);
        let mut x = self.inner(own);
        let entry = |i: usize, j: usize| self.corner[i][j] - product(&self.rows[i], &self.solved[j]);
        let schur: Vec<Vec<f64>> = (0..m).map(|i| (0..m).map(|j| entry(i, j)).collect()).collect();
        let rest: Vec<f64> = (0..m).map(|i| extra[i] - product(&self.rows[i], &x)).collect();
        let e = dense(schur, rest);
        for (e, column) in e.iter().zip(&self.solved) {
            x.iter_mut().zip(column).for_each(|(x, c)| *x -= e * c);
        }
        x.extend(e);
        x
    }

    /// Multiplies the rows of continuity.
    fn scale(&self, x: &mut [f64], by: f64) {
        x[..FLOW * self.linear.particles()].chunks_exact_mut(FLOW).for_each(|row| row[PRESSURE] *= by);
    }

    /// The norm of a residual, in which rows of continuity count `weight` times.
    fn norm(&self, x: &[f64], weight: f64) -> f64 {
        let mut x = x.to_vec();
        self.scale(&mut x, weight);
        product(&x, &x).sqrt()
    }

    /// The solution from a first guess, to the part `tolerance` of the residual that `known` leaves; see [`Self::solve`]. `rounding`: the
    /// part of the right-hand side that no iteration can improve on.
    pub fn solve_from(
        &self,
        right: &[f64],
        [first, known]: [&[f64]; 2],
        (tolerance, rounding): (f64, f64),
        weight: f64,
        products: &mut usize,
    ) -> Option<Vec<f64>> {
        let rest = |x: &[f64]| -> Vec<f64> { right.iter().zip(self.times(x)).map(|(b, y)| b - y).collect() };
        let left = rest(first);
        let least = (tolerance * self.norm(&rest(known), weight)).max(rounding * self.norm(right, weight));
        let now = self.norm(&left, weight);
        if now <= least {
            return Some(first.to_vec());
        }
        let change = self.solve(&left, least / now, weight, products)?;
        Some(first.iter().zip(change).map(|(x, change)| x + change).collect())
    }

    /// The solution to a relative residual, in which rows of continuity count `weight` times; adds the products that it took.
    pub fn solve(&self, right: &[f64], tolerance: f64, weight: f64, products: &mut usize) -> Option<Vec<f64>> {
        let scale = |x: &mut [f64], back: bool| self.scale(x, if back { 1.0 / weight } else { weight });
        let each = match self.linear.rate > 0.0 {
            // Two vectors a product.
            true => (BASIS.0 / (2 * std::mem::size_of_val(right))).clamp(BASIS.1, PRODUCTS.0),
            false => PRODUCTS.0,
        };
        let most = (each, PRODUCTS.1);
        solve_scaled(right, tolerance, most, &|x| self.times(x), &|x| self.precondition(x), &scale, products)
    }
}

/// A solution by GMRES whose rows count by a scale, given the products with the matrix and with its preconditioner. `scale` multiplies
/// numbers of rows, or divides by the same if it shall take them `back`. `most`: products before GMRES begins anew, and at most. Adds those
/// that it took.
pub(super) fn solve_scaled(
    right: &[f64],
    tolerance: f64,
    most: (usize, usize),
    times: &dyn Fn(&[f64]) -> Vec<f64>,
    precondition: &dyn Fn(&[f64]) -> Vec<f64>,
    scale: &dyn Fn(&mut [f64], bool),
    products: &mut usize,
) -> Option<Vec<f64>> {
    let count = std::cell::Cell::new(0);
    let times = |x: &[f64]| {
        count.set(count.get() + 1);
        let mut y = times(x);
        scale(&mut y, false);
        y
    };
    let precondition = |x: &[f64]| {
        let mut x = x.to_vec();
        scale(&mut x, true);
        precondition(&x)
    };
    let mut right = right.to_vec();
    scale(&mut right, false);
    let found = gmres_restarted(&right, tolerance, most, &times, &precondition);
    *products += count.get();
    found
}

/// The matrix of the heat's residual by T.
pub fn heat_matrix(equations: &Equations, state: &State, operators: &Coefficients<C>) -> BlockMatrix {
    let alpha = equations.diffusivity.unwrap_or(0.0);
    let mut matrix = equations.fits.all.matrix(1);
    for i in 0..equations.particles() {
        let diagonal = matrix.entry(i, i as u32);
        if let Some(End::Outlet(before)) = equations.end(i) {
            let entry = matrix.entry(i, before);
            (matrix.values[diagonal], matrix.values[entry]) = (1.0, -1.0);
            continue;
        }
        let is_given = matches!(equations.condition(i), Some(Condition { warmth: Warmth::Given(_), .. }));
        if is_given || equations.end(i).is_some() {
            matrix.values[diagonal] = 1.0;
            continue;
        }
        for k in 0..equations.fits.all.count(i) {
            let c = operators.of(i, k);
            let value = match equations.condition(i) {
                None => dot(state.velocity(i), &c) - alpha * laplacian(&c),
                Some(condition) => alpha * condition.across(&c, equations.smoothing(i)),
            };
            let entry = matrix.entry(i, equations.fits.all.neighbour(i, k) as u32);
            matrix.values[entry] += value;
            matrix.values[diagonal] -= value;
        }
    }
    matrix
}
