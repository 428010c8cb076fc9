//! The linearised flow in space, and its solution by iterations: of a steady flow by GMRES with a block preconditioner, of a step in time by
//! induced dimension reduction with incomplete factors.
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
//! the damping S are large on its diagonal. The same preconditioner for all products lets [IDR](crate::numerics::krylov::idr) solve with it,
//! in the memory of twenty vectors; its products grow with the number of particles along a side (GMRES takes 18, 19, 26 and 70 with
//! 1057, 3602, 12,760 and 84,169 particles, to 1e-10, and IDR a tenth more). With P and X^-1 = nu - a0 / dt lap^-1 (Cahouet and Chabard
//! 1988) GMRES takes 65 to 80 for few particles, each several times as long, since S is up to ten times a0 / dt lap^-1 for pressures that
//! change from point to point, and no Laplacian has that; with (lap + a0 / dt tau S)^-1 it takes as many, and the inner iterations do not
//! converge.
//!
//! K^-1 and lap^-1 are GMRES again, with incomplete factors and a correction on groups of particles ([`crate::numerics::two_level`]), to a
//! third, which one or two products reach; so the outer iteration is a flexible one (Saad 1993). A pair of particles has five numbers: K's,
//! the slopes along x, y and z, and S's; which of them a row takes is a matter of its particle. All five are sums of the pair's coefficients
//! ([`super::super::fit`]), from which products make them anew: a table of them would take as much memory as half the coefficients. Only
//! the transpose has one. Vectors are `[N, 4]`, and behind them the numbers of the whole flow: lambda and a drive, as a border of the matrix.

use super::super::equations::Warmth;
use super::super::fit::{Coefficients, COEFFICIENTS_3D as C, LEFT_3D as LEFT};
use super::super::fits::Fits;
use super::super::steady::dense;
use super::equations::{dot, laplacian, Condition, Derivatives, End, Equations, Motion, State, FLOW, PRESSURE};
use super::scalar::Scalar;
use crate::numerics::incomplete_lu::{Half, IncompleteLu};
use crate::numerics::krylov::{gmres_restarted, idr, Operator};
use crate::numerics::lanes::{array, Lanes, WIDEST};
use crate::numerics::sparse_lu::{dot as product, BlockMatrix, Order, Singular, SparseLu};
use crate::numerics::sweep::{run_parts, PartKernel};
use std::ops::{Add, Mul, Range};
use std::sync::Arc;

/// Products before GMRES begins anew, and at most. (The adjoint of a ball in a duct at a Reynolds number of 53 takes 475, and more than 600 if
/// GMRES begins anew after 120.)
const PRODUCTS: (usize, usize) = (300, 1500);
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

/// What a particle's K and S have of the coefficients of its pairs: K those of the slopes, of the Laplacian and of S, S that of itself.
type Shares = [f64; 6];

/// K, x, y, z, S of a pair, given its slopes, Laplacian and S.
#[inline(always)]
fn numbers<T>(share: &[T; 6], [x, y, z, laplacian, left]: [T; 5]) -> [T; 5]
where
    T: Copy + Add<Output = T> + Mul<Output = T>,
{
    let carried = share[0] * x + share[1] * y + share[2] * z + share[3] * laplacian + share[4] * left;
    [carried, x, y, z, share[5] * left]
}

/// The numbers of all pairs.
#[derive(Debug)]
enum Pairs<'a> {
    /// Those of a matrix, from the coefficients.
    Made { fits: Arc<Fits<3>>, operators: &'a Coefficients<C>, shares: Vec<Shares> },
    /// Those of its transpose, by the second particle of a pair: where those of each begin, the first particle, and K, x, y, z, S.
    Kept { first: Vec<usize>, column: Vec<u32>, value: Vec<[f64; 5]> },
}

impl Pairs<'_> {
    /// The number of a particle's pairs.
    fn count(&self, i: usize) -> usize {
        match self {
            Self::Made { fits, .. } => fits.of_flow(i),
            Self::Kept { first, .. } => first[i + 1] - first[i],
        }
    }

    /// The other particle of a pair, and its numbers.
    fn of(&self, i: usize, k: usize) -> (usize, [f64; 5]) {
        match self {
            Self::Made { fits, operators, shares } => {
                let c = operators.of(i, k);
                let sums = [c[0], c[1], c[2], laplacian(&c), c[LEFT]];
                (fits.all.neighbour(i, k), numbers(&shares[i], sums))
            }
            Self::Kept { first, column, value } => (column[first[i] + k] as usize, value[first[i] + k]),
        }
    }

    fn of_all(&self, i: usize) -> impl Iterator<Item = (usize, [f64; 5])> + '_ {
        (0..self.count(i)).map(move |k| self.of(i, k))
    }

    fn bytes(&self) -> usize {
        match self {
            Self::Made { shares, .. } => size_of_val(&shares[..]),
            Self::Kept { value, .. } => 44 * value.len(),
        }
    }
}

/// The matrix A at a state, or its transpose, by pairs of particles.
#[derive(Debug)]
pub struct Linear<'a> {
    pairs: Pairs<'a>,
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

impl<'a> Linear<'a> {
    /// `rate`: a0 / dt of a step in time, of which `state` is one at rest; 0 of a steady flow.
    pub fn new(
        equations: &Equations,
        state: &State,
        d: &Derivatives,
        operators: &'a Coefficients<C>,
        rate: f64,
    ) -> Self {
        let n = equations.particles();
        let share = |i: usize| -> Shares {
            let ([x, y, z], laplacian, left) = match equations.condition(i) {
                None => (state.velocity(i), -equations.viscosity, 0.0),
                Some(Condition { motion: Motion::Given(_), .. }) => ([0.0; 3], 0.0, 0.0),
                Some(condition) => (condition.normal.map(|n| -n), 0.0, -equations.smoothing(i)),
            };
            [x, y, z, laplacian, left, -equations.damping[i]]
        };
        let shares = (0..n).map(share).collect();
        let pairs = Pairs::Made { fits: Arc::clone(&equations.fits), operators, shares };
        let (mut takes, mut own) = (Vec::with_capacity(n), Vec::with_capacity(n));
        let is_at_rest = state.fields[..3].iter().flatten().all(|&u| u == 0.0);
        let mut laplace = if is_at_rest { BlockMatrix::default() } else { equations.fits.all.matrix(1) };
        for i in 0..n {
            let motion = equations.condition(i).map(|condition| condition.motion);
            let mut sum = [0.0; 5];
            for (_, pair) in pairs.of_all(i) {
                sum.iter_mut().zip(&pair).for_each(|(sum, x)| *sum -= x);
            }
            if !is_at_rest {
                let scale = equations.fits.all.scale(i);
                let diagonal = laplace.entry(i, i as u32);
                if !matches!(motion, Some(Motion::Outflow(_))) {
                    let weighted = || (0..equations.fits.all.count(i)).map(|k| equations.fits.all.pair(i, k));
                    let weights: f64 = weighted().map(|(_, weight, _)| weight).sum();
                    for (j, weight, _) in weighted() {
                        let value = 4.8 * weight / (weights * scale * scale);
                        let entry = laplace.entry(i, j as u32);
                        laplace.values[entry] += value;
                        laplace.values[diagonal] -= value;
                    }
                }
                // Where no pressure is given, a constant is left; this is small beside all others.
                laplace.values[diagonal] -= match motion {
                    Some(Motion::Outflow(_)) => 1.0 / (scale * scale),
                    None => 1e-6 / (scale * scale),
                    Some(_) => 0.0,
                };
            }
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
        Self { pairs, takes, own, viscosity, rate, given, velocity, laplace }
    }

    fn is_transposed(&self) -> bool {
        matches!(self.pairs, Pairs::Kept { .. })
    }

    fn particles(&self) -> usize {
        self.takes.len()
    }

    /// The transpose: pairs by their second particle.
    ///
    /// # Panics
    /// If it is one already.
    pub fn transposed(mut self) -> Self {
        assert!(!self.is_transposed());
        let n = self.particles();
        if self.velocity.is_some() {
            self.laplace.transpose();
        }
        let mut first = vec![0; n + 1];
        let others = |i: usize| self.pairs.of_all(i).filter(move |(j, _)| *j != i);
        (0..n).flat_map(others).for_each(|(j, _)| first[j + 1] += 1);
        (0..n).for_each(|j| first[j + 1] += first[j]);
        let mut next = first.clone();
        let (mut column, mut value) = (vec![0; first[n]], vec![[0.0; 5]; first[n]]);
        for i in 0..n {
            for (j, pair) in others(i) {
                (column[next[j]], value[next[j]]) = (i as u32, pair);
                next[j] += 1;
            }
        }
        let turned = |block: &[[f64; FLOW]; FLOW]| std::array::from_fn(|a| std::array::from_fn(|b| block[b][a]));
        let own = self.own.iter().map(turned).collect();
        Self { pairs: Pairs::Kept { first, column, value }, own, ..self }
    }

    /// y = A^T x of some particles.
    fn rows_transposed(&self, x: &[f64], rows: Range<usize>, y: &mut [f64]) {
        for (i, y) in rows.zip(y.chunks_exact_mut(FLOW)) {
            let own = &x[FLOW * i..FLOW * (i + 1)];
            for a in 0..FLOW {
                y[a] = (0..FLOW).map(|b| self.own[i][a][b] * own[b]).sum();
            }
            for (j, [k, gx, gy, gz, s]) in self.pairs.of_all(i) {
                let (x, from) = (&x[FLOW * j..FLOW * (j + 1)], self.takes[j]);
                let pressure = from.flows * x[PRESSURE];
                (0..3).for_each(|e| y[e] += k * from.carries[e] * x[e] + [gx, gy, gz][e] * pressure);
                y[PRESSURE] += from.pushes * (gx * x[0] + gy * x[1] + gz * x[2]) + s * pressure;
            }
        }
    }

    /// y = A x, by threads with rows of their own.
    fn times(&self, x: &[f64], threads: usize) -> Vec<f64> {
        let n = self.particles();
        let mut y = vec![0.0; FLOW * n];
        if let Pairs::Made { fits, operators, shares } = &self.pairs {
            let product = Product { linear: self, fits, operators, shares, x };
            run_parts(&product, y.chunks_mut(FLOW * WIDEST));
            return y;
        }
        let share = n.div_ceil(threads.max(1)).max(1);
        std::thread::scope(|scope| {
            for (part, y) in y.chunks_mut(FLOW * share).enumerate() {
                let rows = part * share..n.min((part + 1) * share);
                scope.spawn(move || self.rows_transposed(x, rows, y));
            }
        });
        y
    }

    /// (u . grad) f of a field, or its transpose.
    fn carried(&self, velocity: &[[f64; 3]], f: &[f64]) -> Vec<f64> {
        let along = |u: [f64; 3], [_, gx, gy, gz, _]: [f64; 5]| u[0] * gx + u[1] * gy + u[2] * gz;
        let mut found = vec![0.0; f.len()];
        for i in 0..f.len() {
            for (j, pair) in self.pairs.of_all(i) {
                let from = if self.is_transposed() { j } else { i };
                let by = along(velocity[from], pair);
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
        let list = |i: usize| self.pairs.of_all(i).map(|(j, _)| j as u32).collect();
        BlockMatrix::of_lists(self.particles(), size, list)
    }

    /// The blocks of a row of all of the matrix, each with its column. Where no pressure is given, a constant is left; one particle's is
    /// held.
    fn blocks(&self, i: usize, add: &mut dyn FnMut(u32, &[f64])) {
        for (j, [k, gx, gy, gz, s]) in self.pairs.of_all(i) {
            let takes = self.takes[if self.is_transposed() { j } else { i }];
            let (to_momentum, to_continuity) =
                if self.is_transposed() { (takes.flows, takes.pushes) } else { (takes.pushes, takes.flows) };
            let mut block = [[0.0; FLOW]; FLOW];
            for (a, slope) in [gx, gy, gz].into_iter().enumerate() {
                block[a][a] = takes.carries[a] * k;
                block[a][PRESSURE] = to_momentum * slope;
                block[PRESSURE][a] = to_continuity * slope;
            }
            block[PRESSURE][PRESSURE] = takes.flows * s;
            add(j as u32, block.as_flattened());
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
    fn nearly(&self) -> Result<IncompleteLu<FLOW, Half>, Singular> {
        IncompleteLu::of_rows(&self.zeros(0), |i, add| self.blocks(i, add))
    }

    /// K of a component of the velocity, without what the flow's own slopes add.
    fn carrying(&self, component: usize) -> BlockMatrix {
        let mut matrix = self.zeros(1);
        for i in 0..self.particles() {
            for (j, pair) in self.pairs.of_all(i) {
                let from = if self.is_transposed() { j } else { i };
                let value = self.takes[from].carries[component] * pair[0];
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

/// y = A x of the particles of a block, see [`Pairs::Made`].
struct Product<'a> {
    linear: &'a Linear<'a>,
    fits: &'a Fits<3>,
    operators: &'a Coefficients<C>,
    shares: &'a [Shares],
    /// `[N, 4]`.
    x: &'a [f64],
}

impl<'a> PartKernel<f64> for Product<'a> {
    /// `[WIDEST, 4]`; fewer in the last block.
    type Part = &'a mut [f64];

    #[inline(always)]
    fn part<L: Lanes<Real = f64>>(&self, block: usize, part: &mut Self::Part) {
        let (particles, stencils) = (part.len() / FLOW, &self.fits.all);
        for l in (0..particles).step_by(L::COUNT) {
            let here = L::COUNT.min(particles - l);
            let share: [L; 6] = array(|a| stencils.lanes(block, l, |i| self.shares[i][a]));
            // Momentum by what is carried and by the slopes of the pressure, and continuity.
            let (mut carried, mut pushed, mut flow) = ([L::zero(); 3], [L::zero(); 3], L::zero());
            for k in 0..self.fits.of_flow(block * WIDEST) {
                // SAFETY: the list names particles, each with four numbers of x.
                let x = unsafe { L::gather4(self.x.as_ptr(), FLOW, stencils.neighbours_from((block, l, k))) };
                let [own, gx, gy, gz, s] = numbers(&share, self.operators.sums_from::<L, 3, 5>((block, l, k)));
                for (e, slope) in [gx, gy, gz].into_iter().enumerate() {
                    carried[e] = own.mul_add(x[e], carried[e]);
                    pushed[e] = slope.mul_add(x[PRESSURE], pushed[e]);
                    flow = slope.mul_add(x[e], flow);
                }
                flow = s.mul_add(x[PRESSURE], flow);
            }
            let (carried, pushed, flow) = (carried.map(L::numbers), pushed.map(L::numbers), flow.numbers());
            for k in 0..here {
                let i = block * WIDEST + l + k;
                let (own, takes, y) = (&self.x[FLOW * i..], &self.linear.takes[i], &mut part[FLOW * (l + k)..]);
                for a in 0..FLOW {
                    let mut sum = 0.0;
                    for b in 0..FLOW {
                        sum += self.linear.own[i][a][b] * own[b];
                    }
                    y[a] = sum
                        + match a {
                            PRESSURE => takes.flows * flow[k],
                            _ => takes.carries[a] * carried[a][k] + takes.pushes * pushed[a][k],
                        };
                }
            }
        }
    }
}

/// A matrix with its border, and the preconditioner.
pub struct System<'a> {
    pub linear: Linear<'a>,
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
    Nearly(IncompleteLu<FLOW, Half>),
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

impl<'a> System<'a> {
    /// With an order of elimination the whole matrix is factorised, which pays for few particles; that of a step in time is otherwise so
    /// incompletely.
    ///
    /// # Errors
    /// A particle without a diagonal entry, or a matrix without factors.
    pub fn new(
        mut linear: Linear<'a>,
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
        whole + self.linear.pairs.bytes() + parts.sum::<usize>()
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
            (Some(velocity), Some(laplace)) if linear.is_transposed() => {
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
        let (times, precondition) = (|x: &[f64]| self.times(x), |x: &[f64]| self.precondition(x));
        let method = if matches!(self.whole, Some(Whole::Nearly(_))) { Method::Reduction } else { Method::Gmres };
        solve_scaled(right, tolerance, method, [&times, &precondition], &scale, products)
    }
}

/// How a system is solved by iterations.
#[derive(Debug, Clone, Copy)]
pub(super) enum Method {
    /// For any preconditioner; keeps two vectors for each product.
    Gmres,
    /// For one that is always the same.
    Reduction,
}

/// A solution whose rows count by a scale, given the products with the matrix and with its preconditioner. `scale` multiplies
/// numbers of rows, or divides by the same if it shall take them `back`. Adds the products that it took.
pub(super) fn solve_scaled(
    right: &[f64],
    tolerance: f64,
    method: Method,
    [times, precondition]: [Operator<'_>; 2],
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
    let found = match method {
        Method::Gmres => gmres_restarted(&right, tolerance, PRODUCTS, &times, &precondition),
        Method::Reduction => idr(&right, tolerance, PRODUCTS.1, &times, &precondition),
    };
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
        matrix.values[diagonal] -= equations.exchange(i).coefficient;
        for k in 0..equations.fits.all.count(i) {
            let c = operators.of(i, k);
            let value = match equations.condition(i) {
                None => dot(state.velocity(i), &c) - alpha * laplacian(&c),
                Some(condition) => alpha * condition.across_by(equations.fits.across(), &c, equations.smoothing(i)),
            };
            let entry = matrix.entry(i, equations.fits.all.neighbour(i, k) as u32);
            matrix.values[entry] += value;
            matrix.values[diagonal] -= value;
        }
    }
    matrix
}
