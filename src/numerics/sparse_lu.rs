//! A direct solver for sparse systems whose graph lies in the plane: multifrontal LU with nested dissection.
//!
//! The unknowns come in blocks, one per particle, so that the graph has particles as nodes and is ordered once. Nested
//! dissection (George 1973) halves the particles along the longer side of their box again and again; those of one half
//! that have a neighbour in the other separate them and are eliminated last. The graph need not be planar: periodic
//! neighbours only make separators longer. Every separator is a dense *front* (Duff and Reid 1983): the rows and columns of
//! its own unknowns and of those that are eliminated later and that its subtree touches,
//!
//! ```text
//!   F = | A B |     P A = L U,   X = L^-1 P B,   Y = C U^-1,   passed on: D - Y X.
//!       | C D |
//! ```
//!
//! Rows are exchanged within A only, so the structure does not depend on the numbers; what accuracy that costs is
//! won back by one step of iterative refinement. The order of all sums is fixed, for any number of threads.

use super::lanes::{array, Lanes};
use super::sweep::{run_rows, RowKernel, Shared};
use gemm::{gemm, Parallelism};
use std::ops::Range;

/// A square sparse matrix of `blocks` x `blocks` dense blocks of `size` x `size`, by rows.
///
/// The structure is that of [`Order`] and its values are `[entries, size, size]`, each block row by row.
#[derive(Debug, Clone, Default)]
pub struct BlockMatrix {
    pub size: usize,
    /// First entry of each block row, and the number of entries.
    pub first: Vec<usize>,
    /// Block column of each entry, ascending within a row.
    pub column: Vec<u32>,
    pub values: Vec<f64>,
}

impl BlockMatrix {
    /// A matrix of zeros with a symmetric structure: the lists `[neighbours of node]`, those that they are in, and the diagonal.
    pub fn of_lists(nodes: usize, size: usize, lists: impl Fn(usize) -> Vec<u32>) -> Self {
        // In one piece, which goes back to the system afterwards; rows of their own do not.
        let pairs: Vec<[u32; 2]> = (0..nodes).flat_map(|i| lists(i).into_iter().map(move |j| [i as u32, j])).collect();
        let both = || pairs.iter().flat_map(|&[i, j]| [[i, j], [j, i]]).chain((0..nodes as u32).map(|i| [i, i]));
        let mut ends = vec![0; nodes + 1];
        both().for_each(|[i, _]| ends[i as usize + 1] += 1);
        (0..nodes).for_each(|i| ends[i + 1] += ends[i]);
        let mut all = vec![0; ends[nodes]];
        let mut next = ends.clone();
        for [i, j] in both() {
            all[next[i as usize]] = j;
            next[i as usize] += 1;
        }
        let (mut first, mut column) = (vec![0], vec![]);
        for i in 0..nodes {
            let row = &mut all[ends[i]..ends[i + 1]];
            row.sort_unstable();
            let is_new = |&k: &usize| k == 0 || row[k] != row[k - 1];
            column.extend((0..row.len()).filter(is_new).map(|k| row[k]));
            first.push(column.len());
        }
        column.shrink_to_fit();
        let values = vec![0.0; column.len() * size * size];
        Self { size, first, column, values }
    }

    pub fn nodes(&self) -> usize {
        self.first.len() - 1
    }

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.nodes() * self.size
    }

    pub fn row(&self, node: usize) -> &[u32] {
        &self.column[self.first[node]..self.first[node + 1]]
    }

    /// The entry of a row and column of blocks.
    ///
    /// # Panics
    /// If the structure has no such entry.
    pub fn entry(&self, row: usize, column: u32) -> usize {
        self.first[row] + self.row(row).binary_search(&column).expect("an entry of the structure")
    }

    /// A block, row by row.
    pub fn block_mut(&mut self, entry: usize) -> &mut [f64] {
        let area = self.size * self.size;
        &mut self.values[entry * area..(entry + 1) * area]
    }

    /// y = A x, or A^T x.
    pub fn times(&self, x: &[f64], transposed: bool) -> Vec<f64> {
        let s = self.size;
        let mut y = vec![0.0; x.len()];
        for i in 0..self.nodes() {
            for e in self.first[i]..self.first[i + 1] {
                let (j, block) = (self.column[e] as usize, &self.values[e * s * s..(e + 1) * s * s]);
                for a in 0..s {
                    for b in 0..s {
                        match transposed {
                            false => y[i * s + a] += block[a * s + b] * x[j * s + b],
                            true => y[j * s + b] += block[a * s + b] * x[i * s + a],
                        }
                    }
                }
            }
        }
        y
    }
}

impl BlockMatrix {
    /// y = A x on some threads. Each row is summed by one of them, so the result is the same for any number.
    pub fn times_on(&self, x: &[f64], threads: usize) -> Vec<f64> {
        match self.size {
            1 => self.rows_times::<1>(x, threads),
            4 => self.rows_times::<4>(x, threads),
            _ => self.times(x, false),
        }
    }

    fn rows_times<const S: usize>(&self, x: &[f64], threads: usize) -> Vec<f64> {
        let mut y = vec![0.0; x.len()];
        let share = self.nodes().div_ceil(threads.max(1)).max(1);
        let part = |first_row: usize, y: &mut [f64]| {
            for (i, y) in y.chunks_exact_mut(S).enumerate() {
                let mut sum = [0.0; S];
                for e in self.first[first_row + i]..self.first[first_row + i + 1] {
                    let (from, block) = (self.column[e] as usize * S, &self.values[e * S * S..(e + 1) * S * S]);
                    for a in 0..S {
                        for b in 0..S {
                            sum[a] += block[a * S + b] * x[from + b];
                        }
                    }
                }
                y.copy_from_slice(&sum);
            }
        };
        std::thread::scope(|scope| {
            let mut parts = y.chunks_mut(share * S).enumerate();
            let own = parts.next();
            for (k, y) in parts {
                scope.spawn(move || part(k * share, y));
            }
            if let Some((_, y)) = own {
                part(0, y);
            }
        });
        y
    }

    /// Becomes its transpose; the structure is symmetric.
    pub fn transpose(&mut self) {
        let s = self.size;
        for i in 0..self.nodes() {
            for e in self.first[i]..self.first[i + 1] {
                let j = self.column[e] as usize;
                if j < i {
                    continue;
                }
                let other = self.entry(j, i as u32);
                for a in 0..s {
                    for b in 0..s {
                        let (one, two) = (e * s * s + a * s + b, other * s * s + b * s + a);
                        if one < two {
                            self.values.swap(one, two);
                        }
                    }
                }
            }
        }
    }
}

/// A front's own nodes and the later ones that it touches, in the order of elimination.
#[derive(Debug, Clone, Default)]
struct Front {
    own: Vec<u32>,
    later: Vec<u32>,
    children: Vec<usize>,
    /// Place in the parent's front of each of `later`.
    in_parent: Vec<u32>,
    /// Number of nodes of the whole subtree.
    weight: usize,
    /// Where its own nodes begin in the order of elimination, and the place there of each of `later`.
    begin: usize,
    later_place: Vec<u32>,
    /// Where what it passes on begins among all that is passed on, in nodes.
    passed: usize,
}

/// The order of elimination of a graph, children before parents.
#[derive(Debug, Clone)]
pub struct Order {
    fronts: Vec<Front>,
    nodes: usize,
    /// Ranges of fronts that a solution takes side by side, children before parents.
    stages: Vec<Vec<Range<usize>>>,
}

/// Nodes of a part that is not divided further.
const LEAF: usize = 20;
/// Nodes of a subtree that is factorised by a thread of its own.
const OWN_THREAD: usize = 300;
/// Subtrees of a solution that are not divided further: this part of all nodes.
const PARTS: usize = 12;
/// Columns of a panel of a dense factorisation.
const PANEL: usize = 24;

impl Order {
    /// Orders the nodes of a symmetric structure by their places in the plane or in space.
    pub fn new<const D: usize>(matrix: &BlockMatrix, place: impl Fn(usize) -> [f64; D]) -> Self {
        let nodes = matrix.nodes();
        let mut order = Self { fronts: vec![], nodes, stages: vec![] };
        let mut part = vec![0u32; nodes];
        order.divide(matrix, &place, (0..nodes as u32).collect(), &mut part, &mut 0);
        order.link(matrix);
        order.stage();
        order
    }

    /// Finds what a solution can do side by side.
    fn stage(&mut self) {
        // Of each front the stage, and the first front of its subtree.
        let (mut stages, mut first): (Vec<usize>, Vec<usize>) = (vec![], vec![]);
        for (k, front) in self.fronts.iter().enumerate() {
            first.push(front.children.first().map_or(k, |&child| first[child]));
            let is_small = front.weight * PARTS <= self.nodes;
            let below = front.children.iter().map(|&child| stages[child] + 1).max();
            stages.push(if is_small { 0 } else { below.unwrap_or(0) });
        }
        self.stages = vec![vec![]; stages.iter().max().map_or(0, |most| most + 1)];
        let mut parent = vec![usize::MAX; self.fronts.len()];
        for (k, front) in self.fronts.iter().enumerate() {
            front.children.iter().for_each(|&child| parent[child] = k);
        }
        for k in 0..self.fronts.len() {
            let is_small = |k: usize| self.fronts[k].weight * PARTS <= self.nodes;
            if !is_small(k) {
                self.stages[stages[k]].push(k..k + 1);
            } else if parent[k] == usize::MAX || !is_small(parent[k]) {
                self.stages[0].push(first[k]..k + 1);
            }
        }
    }

    /// Adds the fronts of a set of nodes that only nodes already separated off touch; returns the last one.
    fn divide<const D: usize>(
        &mut self,
        matrix: &BlockMatrix,
        place: &impl Fn(usize) -> [f64; D],
        mut nodes: Vec<u32>,
        part: &mut [u32],
        mark: &mut u32,
    ) -> usize {
        let weight = nodes.len();
        let (mut own, mut children) = (nodes.clone(), vec![]);
        if nodes.len() > LEAF {
            let side = |d: usize| {
                let range = nodes
                    .iter()
                    .map(|&i| place(i as usize)[d])
                    .fold((f64::MAX, f64::MIN), |(a, b), x| (a.min(x), b.max(x)));
                range.1 - range.0
            };
            let longest = (1..D).fold(0, |most, d| if side(d) > side(most) { d } else { most });
            let along = |i: &u32| -> [f64; D] { std::array::from_fn(|d| place(*i as usize)[(longest + d) % D]) };
            let middle = nodes.len() / 2;
            nodes.select_nth_unstable_by(middle, |a, b| {
                along(a).partial_cmp(&along(b)).expect("finite places").then(a.cmp(b))
            });
            let (low, high) = nodes.split_at_mut(middle);
            // Of each half the nodes that touch the other; the smaller set separates.
            let (left, right) = (*mark + 1, *mark + 2);
            *mark += 2;
            low.iter().for_each(|&i| part[i as usize] = left);
            high.iter().for_each(|&i| part[i as usize] = right);
            let touch = |half: &[u32], other: u32| -> Vec<u32> {
                half.iter()
                    .copied()
                    .filter(|&i| matrix.row(i as usize).iter().any(|&j| part[j as usize] == other))
                    .collect()
            };
            let (of_low, of_high) = (touch(low, right), touch(high, left));
            own = if of_low.len() <= of_high.len() { of_low } else { of_high };
            own.sort_unstable();
            own.iter().for_each(|&i| part[i as usize] = 0);
            for half in [low, high] {
                let mut rest: Vec<u32> = half.iter().copied().filter(|i| own.binary_search(i).is_err()).collect();
                rest.sort_unstable();
                if !rest.is_empty() {
                    children.push(self.divide(matrix, place, rest, part, mark));
                }
            }
        }
        own.sort_unstable();
        self.fronts.push(Front { own, children, weight, ..Front::default() });
        self.fronts.len() - 1
    }

    /// Finds what each front touches.
    fn link(&mut self, matrix: &BlockMatrix) {
        let mut rank = vec![0u32; self.nodes];
        let mut next = 0;
        for front in &mut self.fronts {
            front.begin = next as usize;
            for &i in &front.own {
                rank[i as usize] = next;
                next += 1;
            }
        }
        let mut passed_on = 0;
        for k in 0..self.fronts.len() {
            let front = &self.fronts[k];
            let last = front.own.last().map_or(0, |&i| rank[i as usize]);
            let touched = front.own.iter().flat_map(|&i| matrix.row(i as usize)).copied();
            let passed = front.children.iter().flat_map(|&child| self.fronts[child].later.iter().copied());
            let mut later: Vec<u32> = touched.chain(passed).filter(|&j| rank[j as usize] > last).collect();
            later.sort_unstable_by_key(|&j| rank[j as usize]);
            later.dedup();
            let places = front.own.iter().chain(&later);
            let mut by_node: Vec<(u32, u32)> = places.enumerate().map(|(place, &node)| (node, place as u32)).collect();
            by_node.sort_unstable();
            let place_of = |node: &u32| {
                let found = by_node.binary_search_by_key(node, |&(node, _)| node);
                by_node[found.expect("a parent has what its child touches")].1
            };
            for child in front.children.clone() {
                self.fronts[child].in_parent = self.fronts[child].later.iter().map(place_of).collect();
            }
            let front = &mut self.fronts[k];
            front.later_place = later.iter().map(|&j| rank[j as usize]).collect();
            front.passed = passed_on;
            passed_on += later.len();
            front.later = later;
        }
    }
}

/// The factors of a front, column by column.
#[derive(Debug, Clone, Default)]
struct Factor {
    /// L and U of A, `[p, p]`.
    lu: Vec<f64>,
    /// The row that was exchanged with each row.
    pivots: Vec<u32>,
    /// X = L^-1 P B, `[p, q]`.
    upper: Vec<f64>,
    /// Y = C U^-1, `[q, p]`.
    lower: Vec<f64>,
}

/// L and U of a matrix.
#[derive(Debug)]
pub struct SparseLu {
    order: std::sync::Arc<Order>,
    size: usize,
    factors: Vec<Factor>,
}

/// A matrix that has no factors: a pivot vanished.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Singular;

/// A solution of A x = b by `solve` and one step of refinement by `correct`, given `times`, the product with A.
pub fn refined(
    b: &[f64],
    times: impl Fn(&[f64]) -> Vec<f64>,
    solve: impl Fn(&[f64]) -> Vec<f64>,
    correct: impl Fn(&[f64]) -> Vec<f64>,
) -> Vec<f64> {
    let mut x = solve(b);
    let rest: Vec<f64> = b.iter().zip(times(&x)).map(|(b, product)| b - product).collect();
    x.iter_mut().zip(correct(&rest)).for_each(|(x, more)| *x += more);
    x
}

/// The scalar product, as eight sums side by side, which a processor adds at once.
pub fn dot(a: &[f64], b: &[f64]) -> f64 {
    const SIDE: usize = 8;
    let mut sums = [0.0; SIDE];
    let (whole_a, whole_b) = (a.chunks_exact(SIDE), b.chunks_exact(SIDE));
    let rest: f64 = whole_a.remainder().iter().zip(whole_b.remainder()).map(|(a, b)| a * b).sum();
    for (a, b) in whole_a.zip(whole_b) {
        for k in 0..SIDE {
            sums[k] += a[k] * b[k];
        }
    }
    sums.iter().sum::<f64>() + rest
}

/// C -= A B of columns; `lda`, `ldb`, `ldc`: lengths of their columns.
#[allow(clippy::too_many_arguments)]
fn subtract_product(
    [m, n, k]: [usize; 3],
    a: (*const f64, usize),
    b: (*const f64, usize),
    c: (*mut f64, usize),
    threads: usize,
) {
    if m == 0 || n == 0 || k == 0 {
        return;
    }
    let parallel = if threads > 1 && m * n * k > 1 << 21 { Parallelism::Rayon(threads) } else { Parallelism::None };
    // SAFETY: the callers' matrices have these sizes and c overlaps neither a nor b.
    unsafe {
        gemm(
            m,
            n,
            k,
            c.0,
            c.1 as isize,
            1,
            true,
            a.0,
            a.1 as isize,
            1,
            b.0,
            b.1 as isize,
            1,
            1.0,
            -1.0,
            false,
            false,
            false,
            parallel,
        );
    }
}

/// B <- L^-1 B with a unit lower triangle, `n` columns, by halves.
fn solve_lower(l: *const f64, ldl: usize, p: usize, b: *mut f64, ldb: usize, n: usize, threads: usize) {
    if p > PANEL {
        let half = p / 2;
        solve_lower(l, ldl, half, b, ldb, n, threads);
        // SAFETY: within the triangle and the p rows of b.
        unsafe {
            subtract_product([p - half, n, half], (l.add(half), ldl), (b, ldb), (b.add(half), ldb), threads);
            solve_lower(l.add(half * ldl + half), ldl, p - half, b.add(half), ldb, n, threads);
        }
        return;
    }
    for column in 0..n {
        // SAFETY: p rows of each of the n columns.
        let x = unsafe { std::slice::from_raw_parts_mut(b.add(column * ldb), p) };
        for k in 0..p {
            let pivot = x[k];
            // SAFETY: column k of the triangle.
            let of_l = unsafe { std::slice::from_raw_parts(l.add(k * ldl), p) };
            for row in k + 1..p {
                x[row] -= of_l[row] * pivot;
            }
        }
    }
}

/// B <- B U^-1, `n` rows, by halves.
fn solve_upper_right(u: *const f64, ldu: usize, p: usize, b: *mut f64, ldb: usize, n: usize, threads: usize) {
    if p > PANEL {
        let half = p / 2;
        solve_upper_right(u, ldu, half, b, ldb, n, threads);
        // SAFETY: within the triangle and the p columns of b.
        unsafe {
            let right = b.add(half * ldb);
            subtract_product([n, p - half, half], (b, ldb), (u.add(half * ldu), ldu), (right, ldb), threads);
            solve_upper_right(u.add(half * ldu + half), ldu, p - half, right, ldb, n, threads);
        }
        return;
    }
    for k in 0..p {
        // SAFETY: column k of the triangle, and columns up to k of b, which are disjoint.
        unsafe {
            let of_u = std::slice::from_raw_parts(u.add(k * ldu), p);
            let x = std::slice::from_raw_parts_mut(b.add(k * ldb), n);
            for (before, factor) in of_u[..k].iter().enumerate() {
                let from = std::slice::from_raw_parts(b.add(before * ldb), n);
                x.iter_mut().zip(from).for_each(|(x, from)| *x -= factor * from);
            }
            let inverse = 1.0 / of_u[k];
            x.iter_mut().for_each(|x| *x *= inverse);
        }
    }
}

/// P A = L U of the p x p matrix in the first columns of `a`, with rows exchanged over its columns only, by halves.
fn factorise(
    a: *mut f64,
    lda: usize,
    rows: usize,
    p: usize,
    pivots: &mut [u32],
    threads: usize,
) -> Result<(), Singular> {
    if p > PANEL {
        let half = p / 2;
        let (low, high) = pivots.split_at_mut(half);
        factorise(a, lda, rows, half, low, threads)?;
        // SAFETY: all within the rows x p part of a.
        unsafe {
            let right = a.add(half * lda);
            exchange(right, lda, p - half, low);
            solve_lower(a, lda, half, right, lda, p - half, threads);
            subtract_product(
                [rows - half, p - half, half],
                (a.add(half), lda),
                (right, lda),
                (right.add(half), lda),
                threads,
            );
            factorise(right.add(half), lda, rows - half, p - half, high, threads)?;
            exchange(a.add(half), lda, half, high);
        }
        high.iter_mut().for_each(|pivot| *pivot += half as u32);
        return Ok(());
    }
    for k in 0..p {
        // SAFETY: columns of a, each of `rows` rows, disjoint.
        unsafe {
            let column = std::slice::from_raw_parts_mut(a.add(k * lda), rows);
            let mut best = k;
            for row in k + 1..rows {
                if column[row].abs() > column[best].abs() {
                    best = row;
                }
            }
            // The diagonal is kept where it is not much smaller, which keeps the fields of a particle together.
            if column[k].abs() >= 0.1 * column[best].abs() {
                best = k;
            }
            pivots[k] = best as u32;
            let pivot = column[best];
            if pivot == 0.0 || !pivot.is_finite() {
                return Err(Singular);
            }
            if best != k {
                for c in 0..p {
                    std::ptr::swap(a.add(c * lda + k), a.add(c * lda + best));
                }
            }
            let inverse = 1.0 / pivot;
            column[k + 1..].iter_mut().for_each(|x| *x *= inverse);
            for c in k + 1..p {
                let other = std::slice::from_raw_parts_mut(a.add(c * lda), rows);
                let factor = other[k];
                if factor != 0.0 {
                    other[k + 1..].iter_mut().zip(&column[k + 1..]).for_each(|(x, l)| *x -= factor * l);
                }
            }
        }
    }
    Ok(())
}

/// Exchanges rows of `columns` columns.
unsafe fn exchange(a: *mut f64, lda: usize, columns: usize, pivots: &[u32]) {
    for column in 0..columns {
        for (k, &with) in pivots.iter().enumerate() {
            // SAFETY: the caller's columns have all rows that are named.
            unsafe { std::ptr::swap(a.add(column * lda + k), a.add(column * lda + with as usize)) };
        }
    }
}

impl SparseLu {
    /// Factorises a matrix of the order's structure.
    ///
    /// # Errors
    /// A matrix with a pivot that vanishes.
    pub fn new(order: &std::sync::Arc<Order>, matrix: &BlockMatrix, threads: usize) -> Result<Self, Singular> {
        let mut factors = vec![Factor::default(); order.fronts.len()];
        let mut passed: Vec<Vec<f64>> = vec![vec![]; order.fronts.len()];
        if let Some(root) = order.fronts.len().checked_sub(1) {
            let mut work = Work { order, matrix, place: vec![u32::MAX; order.nodes] };
            work.subtree(root, 0, &mut factors, &mut passed, threads)?;
        }
        Ok(Self { order: order.clone(), size: matrix.size, factors })
    }

    /// Bytes of the factors.
    pub fn bytes(&self) -> usize {
        self.factors.iter().map(|f| 8 * (f.lu.len() + f.upper.len() + f.lower.len())).sum()
    }

    /// The same as [`Self::solve`], and one step of iterative refinement with the matrix that was factorised.
    pub fn refined(&self, matrix: &BlockMatrix, b: &[f64], transposed: bool) -> Vec<f64> {
        refined(b, |x| matrix.times(x, transposed), |r| self.solve(r, transposed), |r| self.solve(r, transposed))
    }

    /// x = A^-1 b, or A^-T b, on all threads.
    pub fn solve(&self, b: &[f64], transposed: bool) -> Vec<f64> {
        let (order, s) = (&self.order, self.size);
        let nodes = || order.fronts.iter().flat_map(|front| &front.own).map(|&i| i as usize);
        let mut by_place: Vec<f64> = nodes().flat_map(|i| &b[i * s..(i + 1) * s]).copied().collect();
        let all_passed = order.fronts.last().map_or(0, |root| root.passed + root.later.len());
        let mut passed = vec![0.0; all_passed * s];
        let system = System { lu: self, x: Shared::new(&mut by_place), passed: Shared::new(&mut passed) };
        for stage in &order.stages {
            run_rows(&Sweep { system: &system, stage, transposed, is_forward: true }, stage.len());
        }
        for stage in order.stages.iter().rev() {
            run_rows(&Sweep { system: &system, stage, transposed, is_forward: false }, stage.len());
        }
        let mut x = vec![0.0; b.len()];
        for (i, part) in nodes().zip(by_place.chunks_exact(s)) {
            x[i * s..(i + 1) * s].copy_from_slice(part);
        }
        x
    }
}

/// A system that is solved: its unknowns in the order of elimination, and what each front passes on.
struct System<'a> {
    lu: &'a SparseLu,
    x: Shared<'a, f64>,
    passed: Shared<'a, f64>,
}

/// A stage of its solution.
struct Sweep<'a> {
    system: &'a System<'a>,
    stage: &'a [Range<usize>],
    transposed: bool,
    is_forward: bool,
}

impl RowKernel<f64> for Sweep<'_> {
    #[inline(always)]
    fn rows<L: Lanes<Real = f64>>(&self, rows: Range<usize>) {
        for fronts in &self.stage[rows] {
            // Loops, because an iterator's `for_each` is a function of its own, without the instruction set of this one.
            for k in 0..fronts.len() {
                match (self.is_forward, self.transposed) {
                    (true, false) => self.system.forward::<L, false>(fronts.start + k),
                    (true, true) => self.system.forward::<L, true>(fronts.start + k),
                    (false, false) => self.system.backward::<L, false>(fronts.end - 1 - k),
                    (false, true) => self.system.backward::<L, true>(fronts.end - 1 - k),
                }
            }
        }
    }
}

/// Columns of a matrix that are taken at once.
const AT_ONCE: usize = 4;

/// y -= A x for C columns of A, which begin `length` numbers apart.
#[inline(always)]
fn subtract_some<L: Lanes<Real = f64>, const C: usize>(y: &mut [f64], a: &[f64], length: usize, x: &[f64]) {
    let m = y.len();
    assert!(m == 0 || (a.len() >= (C - 1) * length + m && x.len() >= C));
    let whole = m - m % L::COUNT;
    let factors: [L; C] = array(|c| L::splat(-x[c]));
    for r in (0..whole).step_by(L::COUNT) {
        // SAFETY: COUNT numbers of y and of each column.
        unsafe {
            let mut sum = L::load(y.as_ptr().add(r));
            for c in 0..C {
                sum = L::load(a.as_ptr().add(c * length + r)).mul_add(factors[c], sum);
            }
            sum.store(y.as_mut_ptr().add(r));
        }
    }
    for r in whole..m {
        for c in 0..C {
            y[r] -= a[c * length + r] * x[c];
        }
    }
}

/// y -= A x for the columns of A, which begin `length` numbers apart.
#[inline(always)]
fn subtract_columns<L: Lanes<Real = f64>>(y: &mut [f64], a: &[f64], length: usize, x: &[f64]) {
    let whole = x.len() - x.len() % AT_ONCE;
    for c in (0..whole).step_by(AT_ONCE) {
        subtract_some::<L, AT_ONCE>(y, &a[c * length..], length, &x[c..]);
    }
    for c in whole..x.len() {
        subtract_some::<L, 1>(y, &a[c * length..], length, &x[c..]);
    }
}

/// x <- L^-1 x with the unit lower triangle of `lu`, `[p, p]`.
#[inline(always)]
fn solve_unit_lower<L: Lanes<Real = f64>>(lu: &[f64], x: &mut [f64]) {
    let p = x.len();
    for from in (0..p).step_by(AT_ONCE) {
        let to = p.min(from + AT_ONCE);
        for k in from..to {
            for row in k + 1..to {
                let share = lu[k * p + row] * x[k];
                x[row] -= share;
            }
        }
        let (known, rest) = x.split_at_mut(to);
        if !rest.is_empty() {
            subtract_columns::<L>(rest, &lu[from * p + to..], p, &known[from..]);
        }
    }
}

/// x <- U^-1 x with the upper triangle of `lu`, `[p, p]`.
#[inline(always)]
fn solve_upper<L: Lanes<Real = f64>>(lu: &[f64], x: &mut [f64]) {
    let p = x.len();
    for from in (0..p).step_by(AT_ONCE).rev() {
        let to = p.min(from + AT_ONCE);
        for k in (from..to).rev() {
            x[k] /= lu[k * p + k];
            for row in from..k {
                let share = lu[k * p + row] * x[k];
                x[row] -= share;
            }
        }
        let (rest, known) = x.split_at_mut(from);
        if !rest.is_empty() {
            subtract_columns::<L>(rest, &lu[from * p..], p, &known[..to - from]);
        }
    }
}

/// Scalar products of C columns, each as long as y, with y.
#[inline(always)]
fn products<L: Lanes<Real = f64>, const C: usize>(a: &[f64], y: &[f64]) -> [f64; C] {
    let m = y.len();
    assert!(a.len() >= C * m);
    let whole = m - m % L::COUNT;
    let mut sums = [L::zero(); C];
    for r in (0..whole).step_by(L::COUNT) {
        // SAFETY: COUNT numbers of y and of each column.
        unsafe {
            let y = L::load(y.as_ptr().add(r));
            for c in 0..C {
                sums[c] = L::load(a.as_ptr().add(c * m + r)).mul_add(y, sums[c]);
            }
        }
    }
    let mut all = [0.0; C];
    for c in 0..C {
        let mut sum = sums[c].sum();
        for r in whole..m {
            sum += a[c * m + r] * y[r];
        }
        all[c] = sum;
    }
    all
}

/// x -= A^T y for the columns of A, each as long as y.
#[inline(always)]
fn subtract_products<L: Lanes<Real = f64>>(x: &mut [f64], a: &[f64], y: &[f64]) {
    let m = y.len();
    let whole = x.len() - x.len() % AT_ONCE;
    for c in (0..whole).step_by(AT_ONCE) {
        let found = products::<L, AT_ONCE>(&a[c * m..], y);
        for (x, found) in x[c..].iter_mut().zip(found) {
            *x -= found;
        }
    }
    for c in whole..x.len() {
        x[c] -= products::<L, 1>(&a[c * m..], y)[0];
    }
}

impl System<'_> {
    /// The own unknowns of a front, and what it passes on.
    ///
    /// # Safety
    /// Nobody else is at this front.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    unsafe fn of_front(&self, front: &Front) -> (&mut [f64], &mut [f64]) {
        let s = self.lu.size;
        // SAFETY: the caller's promise.
        unsafe {
            let own = self.x.slice(front.begin * s..(front.begin + front.own.len()) * s);
            (own, self.passed.slice(front.passed * s..(front.passed + front.later.len()) * s))
        }
    }

    /// y of L y = b, or of U^T y = b, at a front whose children have theirs.
    #[inline(always)]
    fn forward<L: Lanes<Real = f64>, const TRANSPOSED: bool>(&self, k: usize) {
        let (fronts, s) = (&self.lu.order.fronts, self.lu.size);
        let (front, Factor { lu, pivots, upper, lower }) = (&fronts[k], &self.lu.factors[k]);
        // SAFETY: every front is in one row of one stage, and children are done.
        let (own, later) = unsafe { self.of_front(front) };
        let p = own.len();
        for &child in &front.children {
            // SAFETY: as above.
            let (_, from_child) = unsafe { self.of_front(&fronts[child]) };
            for (&to, values) in fronts[child].in_parent.iter().zip(from_child.chunks_exact(s)) {
                let to = to as usize * s;
                let to = if to < p { &mut own[to..to + s] } else { &mut later[to - p..to - p + s] };
                for (to, value) in to.iter_mut().zip(values) {
                    *to += *value;
                }
            }
        }
        if TRANSPOSED {
            for k in 0..p {
                let (before, from) = own.split_at_mut(k);
                subtract_products::<L>(&mut from[..1], &lu[k * p..k * p + k], before);
                from[0] /= lu[k * p + k];
            }
            subtract_products::<L>(later, upper, own);
        } else {
            for (k, &with) in pivots.iter().enumerate() {
                own.swap(k, with as usize);
            }
            solve_unit_lower::<L>(lu, own);
            subtract_columns::<L>(later, lower, later.len(), own);
        }
    }

    /// x of U x = y, or of L^T x = y, at a front whose later unknowns are known.
    #[inline(always)]
    fn backward<L: Lanes<Real = f64>, const TRANSPOSED: bool>(&self, k: usize) {
        let s = self.lu.size;
        let (front, Factor { lu, pivots, upper, lower }) = (&self.lu.order.fronts[k], &self.lu.factors[k]);
        // SAFETY: every front is in one row of one stage, and later unknowns are done.
        let (own, known) = unsafe { self.of_front(front) };
        let p = own.len();
        for (&from, known) in front.later_place.iter().zip(known.chunks_exact_mut(s)) {
            for (c, known) in known.iter_mut().enumerate() {
                // SAFETY: as above.
                *known = unsafe { self.x.get(from as usize * s + c) };
            }
        }
        if TRANSPOSED {
            subtract_products::<L>(own, lower, known);
            for k in (0..p).rev() {
                let (before, from) = own.split_at_mut(k + 1);
                subtract_products::<L>(&mut before[k..], &lu[k * p + k + 1..(k + 1) * p], from);
            }
            for (k, &with) in pivots.iter().enumerate().rev() {
                own.swap(k, with as usize);
            }
        } else {
            subtract_columns::<L>(own, upper, p, known);
            solve_upper::<L>(lu, own);
        }
    }
}

/// What the factorisation of a subtree reads, and its own memory.
struct Work<'a> {
    order: &'a Order,
    matrix: &'a BlockMatrix,
    /// Place of each node in the present front.
    place: Vec<u32>,
}

impl Work<'_> {
    /// Factorises a front and all below it, which are the elements of `factors` and `passed` up to it, from `first` on.
    fn subtree(
        &mut self,
        root: usize,
        first: usize,
        factors: &mut [Factor],
        passed: &mut [Vec<f64>],
        threads: usize,
    ) -> Result<(), Singular> {
        let front = &self.order.fronts[root];
        match &front.children[..] {
            &[low, high] if threads > 1 && front.weight > OWN_THREAD => {
                let cut = low + 1 - first;
                let (low_factors, rest) = factors.split_at_mut(cut);
                let (low_passed, rest_passed) = passed.split_at_mut(cut);
                let (order, matrix) = (self.order, self.matrix);
                let (one, other) = std::thread::scope(|scope| {
                    let mut work = Work { order, matrix, place: vec![u32::MAX; order.nodes] };
                    let run = move || work.subtree(low, first, low_factors, low_passed, threads / 2);
                    let beside = scope.spawn(run);
                    let other = self.subtree(high, low + 1, rest, rest_passed, threads - threads / 2);
                    (beside.join().unwrap_or(Err(Singular)), other)
                });
                one?;
                other?;
            }
            children => {
                let mut from = first;
                for &child in children {
                    self.subtree(child, from, &mut factors[from - first..], &mut passed[from - first..], threads)?;
                    from = child + 1;
                }
            }
        }
        self.front(root, first, factors, passed, threads)
    }

    fn front(
        &mut self,
        k: usize,
        first: usize,
        factors: &mut [Factor],
        passed: &mut [Vec<f64>],
        threads: usize,
    ) -> Result<(), Singular> {
        let (front, s) = (&self.order.fronts[k], self.matrix.size);
        let (own, all) = (front.own.len(), front.own.len() + front.later.len());
        let (p, n) = (own * s, all * s);
        let nodes = front.own.iter().chain(&front.later);
        nodes.clone().enumerate().for_each(|(place, &i)| self.place[i as usize] = place as u32);
        let mut dense = vec![0.0; n * n];
        // Rows of own unknowns whole, and of later ones the columns of own ones.
        for (row, &i) in nodes.clone().enumerate() {
            for e in self.matrix.first[i as usize]..self.matrix.first[i as usize + 1] {
                let column = self.place[self.matrix.column[e] as usize] as usize;
                if column < all && (row < own || column < own) {
                    for (k, value) in self.matrix.values[e * s * s..(e + 1) * s * s].iter().enumerate() {
                        dense[(column * s + k % s) * n + row * s + k / s] += value;
                    }
                }
            }
        }
        nodes.for_each(|&i| self.place[i as usize] = u32::MAX);
        for &child in &front.children {
            let (from, map) = (std::mem::take(&mut passed[child - first]), &self.order.fronts[child].in_parent);
            let q = map.len() * s;
            for (c, &to) in map.iter().enumerate() {
                for b in 0..s {
                    let column = &from[(c * s + b) * q..(c * s + b + 1) * q];
                    let target = &mut dense[(to as usize * s + b) * n..(to as usize * s + b + 1) * n];
                    for (row, values) in map.iter().zip(column.chunks_exact(s)) {
                        let row = *row as usize * s;
                        target[row..row + s].iter_mut().zip(values).for_each(|(x, value)| *x += value);
                    }
                }
            }
        }
        let q = n - p;
        let mut pivots = vec![0; p];
        let a = dense.as_mut_ptr();
        factorise(a, n, p, p, &mut pivots, threads)?;
        // SAFETY: the four parts of the n x n matrix do not overlap.
        unsafe {
            let (b, c) = (a.add(p * n), a.add(p));
            exchange(b, n, q, &pivots);
            solve_lower(a, n, p, b, n, q, threads);
            solve_upper_right(a, n, p, c, n, q, threads);
            subtract_product([q, q, p], (c, n), (b, n), (b.add(p), n), threads);
        }
        let part = |columns: std::ops::Range<usize>, rows: std::ops::Range<usize>| -> Vec<f64> {
            columns.flat_map(|column| &dense[column * n + rows.start..column * n + rows.end]).copied().collect()
        };
        passed[k - first] = part(p..n, p..n);
        factors[k - first] = Factor { lu: part(0..p, 0..p), pivots, upper: part(p..n, 0..p), lower: part(0..p, p..n) };
        Ok(())
    }
}
