//! Incomplete factors of a sparse matrix of blocks, as a preconditioner (Meijerink and van der Vorst 1977; Saad 2003, 10.3).
//!
//! The factors have the blocks of the matrix and no others (ILU(0)); blocks are inverted whole, so velocity and pressure of a
//! particle are eliminated together. Rows are in the order of Cuthill and McKee (1969), from one end of the graph to the other. The
//! factors are applied in single precision, and stored in it or, with the range of single precision, in eight bits: they are approximate
//! anyway, and memory bounds their speed.

use super::sparse_lu::{BlockMatrix, Singular};

/// How a number of the factors is stored.
pub trait Stored: Copy + Send + Sync + std::fmt::Debug {
    fn of(value: f32) -> Self;
    fn f32(self) -> f32;
}

impl Stored for f32 {
    fn of(value: f32) -> Self {
        value
    }
    fn f32(self) -> f32 {
        self
    }
}

/// The upper half of a number of single precision ("bfloat16"): sign, exponent and eight bits.
#[derive(Debug, Clone, Copy)]
pub struct Half(u16);

impl Stored for Half {
    fn of(value: f32) -> Self {
        let bits = value.to_bits();
        // To the nearest, and if there are two to the even one. Numbers that are not finite stay so.
        Self(if value.is_finite() { (bits + 0x7fff + (bits >> 16 & 1)) >> 16 } else { bits >> 16 } as u16)
    }
    #[inline(always)]
    fn f32(self) -> f32 {
        f32::from_bits(u32::from(self.0) << 16)
    }
}

/// Rows of a triangle without its diagonal, which follow each other in memory: a solution reads each triangle once, from one end to the
/// other.
#[derive(Debug)]
struct Triangle<const S: usize, T> {
    first: Vec<usize>,
    column: Vec<u32>,
    /// Blocks by columns, so that a product adds multiples of columns.
    value: Vec<[[T; S]; S]>,
}

impl<const S: usize, T: Stored> Triangle<S, T> {
    fn with_capacity(entries: usize) -> Self {
        Self { first: vec![0], column: Vec::with_capacity(entries), value: Vec::with_capacity(entries) }
    }

    fn add_row(&mut self, columns: &[u32], blocks: &[[[f32; S]; S]]) {
        self.column.extend(columns);
        self.value.extend(blocks.iter().map(stored::<S, T>));
        self.first.push(self.column.len());
    }

    /// The columns and blocks of a row.
    fn row(&self, i: usize) -> impl Iterator<Item = (usize, &[[T; S]; S])> {
        let entries = self.first[i]..self.first[i + 1];
        self.column[entries.clone()].iter().map(|&column| column as usize).zip(&self.value[entries])
    }

    /// What is left of a row of x, given the numbers of others.
    fn rest(&self, i: usize, x: &[f32]) -> [f32; S] {
        let mut sums = [[0.0; S]; S];
        for (column, block) in self.row(i) {
            add_times(&mut sums, block, &x[column * S..(column + 1) * S]);
        }
        std::array::from_fn(|a| x[i * S + a] - sums.iter().map(|sum| sum[a]).sum::<f32>())
    }
}

/// Incomplete factors of a [`BlockMatrix`] with blocks of S x S.
#[derive(Debug)]
pub struct IncompleteLu<const S: usize, T: Stored = f32> {
    /// Block row of the matrix at each place of the order.
    order: Vec<u32>,
    lower: Triangle<S, T>,
    upper: Triangle<S, T>,
    /// The inverted blocks of the diagonal.
    diagonal: Vec<[[T; S]; S]>,
}

/// Block rows from one end of the graph to the other: each one's neighbours follow it, those with few neighbours first.
pub(super) fn from_end_to_end(matrix: &BlockMatrix) -> Vec<u32> {
    let nodes = matrix.nodes();
    let degree = |i: u32| matrix.row(i as usize).len();
    let walk = |start: u32, seen: &mut [bool]| {
        let mut order = vec![start];
        seen[start as usize] = true;
        let mut done = 0;
        while done < order.len() {
            let row = matrix.row(order[done] as usize);
            let mut next: Vec<u32> = row.iter().copied().filter(|&j| !seen[j as usize]).collect();
            next.sort_unstable_by_key(|&j| (degree(j), j));
            next.iter().for_each(|&j| seen[j as usize] = true);
            order.extend(next);
            done += 1;
        }
        order
    };
    let mut order: Vec<u32> = vec![];
    let mut seen = vec![false; nodes];
    for start in 0..nodes as u32 {
        if !seen[start as usize] {
            // The last one that is reached is at an end.
            let reached = walk(start, &mut seen.clone());
            order.extend(walk(reached[reached.len() - 1], &mut seen));
        }
    }
    order
}

/// The inverse of a block by elimination with exchange of rows.
fn inverse<const S: usize>(mut a: [[f64; S]; S]) -> Result<[[f64; S]; S], Singular> {
    let mut b = [[0.0; S]; S];
    (0..S).for_each(|k| b[k][k] = 1.0);
    for k in 0..S {
        let best = (k..S).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).unwrap_or(k);
        a.swap(k, best);
        b.swap(k, best);
        if a[k][k] == 0.0 || !a[k][k].is_finite() {
            return Err(Singular);
        }
        let pivot = 1.0 / a[k][k];
        (0..S).for_each(|c| (a[k][c], b[k][c]) = (a[k][c] * pivot, b[k][c] * pivot));
        for row in (0..S).filter(|&row| row != k) {
            let factor = a[row][k];
            for c in 0..S {
                a[row][c] -= factor * a[k][c];
                b[row][c] -= factor * b[k][c];
            }
        }
    }
    Ok(b)
}

/// C -= A B, blocks by columns.
#[inline(always)]
fn subtract_product<const S: usize, T: Stored>(c: &mut [[f32; S]; S], a: &[[f32; S]; S], b: &[[T; S]; S]) {
    for column in 0..S {
        for k in 0..S {
            let factor = b[column][k].f32();
            (0..S).for_each(|row| c[column][row] -= a[k][row] * factor);
        }
    }
}

/// Adds column k of A times x_k to sum k, so that no product waits for another.
#[inline(always)]
fn add_times<const S: usize, T: Stored>(sums: &mut [[f32; S]; S], a: &[[T; S]; S], x: &[f32]) {
    for k in 0..S {
        (0..S).for_each(|row| sums[k][row] += a[k][row].f32() * x[k]);
    }
}

/// The block by columns, as it is stored.
fn stored<const S: usize, T: Stored>(block: &[[f32; S]; S]) -> [[T; S]; S] {
    block.map(|column| column.map(T::of))
}

impl<const S: usize, T: Stored> IncompleteLu<S, T> {
    /// # Errors
    /// A diagonal block that has no inverse.
    ///
    /// # Panics
    /// If the matrix has blocks of another size.
    pub fn new(matrix: &BlockMatrix) -> Result<Self, Singular> {
        assert_eq!(matrix.size, S, "blocks of the preconditioner's size");
        Self::of_rows(matrix, |i, add| {
            let from = matrix.first[i];
            for (e, &j) in matrix.row(i).iter().enumerate() {
                add(j, &matrix.values[(from + e) * S * S..(from + e + 1) * S * S]);
            }
        })
    }

    /// The factors of a matrix that is not stored: of each row `blocks` gives columns and blocks, row by row, whose sums it has; all are
    /// entries of the pattern. (In double precision a matrix takes more memory than its factors and all else of a step in space.)
    ///
    /// # Errors
    /// A diagonal block that has no inverse.
    ///
    /// # Panics
    /// If the pattern has no such entry.
    pub fn of_rows(
        pattern: &BlockMatrix,
        blocks: impl Fn(usize, &mut dyn FnMut(u32, &[f64])),
    ) -> Result<Self, Singular> {
        let order = from_end_to_end(pattern);
        let nodes = order.len();
        let mut place = vec![0u32; nodes];
        order.iter().enumerate().for_each(|(k, &i)| place[i as usize] = k as u32);
        let triangle = || Triangle::with_capacity(pattern.first[nodes] / 2);
        let mut all = Self { order: vec![], lower: triangle(), upper: triangle(), diagonal: Vec::with_capacity(nodes) };
        let mut entry_of = vec![usize::MAX; nodes];
        let mut given = vec![];
        for &i in &order {
            let (i, from) = (i as usize, pattern.first[i as usize]);
            given.clear();
            given.resize(pattern.row(i).len(), [[0.0; S]; S]);
            blocks(i, &mut |j, block| {
                let to = given[pattern.entry(i, j) - from].as_flattened_mut();
                to.iter_mut().zip(block).for_each(|(to, x)| *to += x);
            });
            let mut row: Vec<(u32, usize)> =
                pattern.row(i).iter().enumerate().map(|(e, &j)| (place[j as usize], e)).collect();
            row.sort_unstable();
            let by_columns =
                |&(_, e): &(u32, usize)| std::array::from_fn(|b| std::array::from_fn(|a| given[e][a][b] as f32));
            let columns: Vec<u32> = row.iter().map(|&(to, _)| to).collect();
            all.eliminate(&columns, row.iter().map(by_columns).collect(), &mut entry_of)?;
        }
        Ok(Self { order, ..all })
    }

    /// Adds the factors of the next row, given its columns in the order and its blocks. `entry_of`: memory for the place of the entry with
    /// a column, `[nodes]`, none before and after.
    fn eliminate(
        &mut self,
        columns: &[u32],
        mut own: Vec<[[f32; S]; S]>,
        entry_of: &mut [usize],
    ) -> Result<(), Singular> {
        let middle = columns.partition_point(|&column| (column as usize) < self.diagonal.len());
        columns.iter().enumerate().for_each(|(e, &column)| entry_of[column as usize] = e);
        for e in 0..middle {
            let above = columns[e] as usize;
            // L_ik = A_ik U_kk^-1
            let mut left = [[0.0; S]; S];
            subtract_product(&mut left, &own[e], &self.diagonal[above]);
            let left = left.map(|column| column.map(|x| -x));
            own[e] = left;
            for (column, block) in self.upper.row(above) {
                let to = entry_of[column];
                if to != usize::MAX {
                    subtract_product(&mut own[to], &left, block);
                }
            }
        }
        columns.iter().for_each(|&column| entry_of[column as usize] = usize::MAX);
        let inverted = inverse::<S>(std::array::from_fn(|a| std::array::from_fn(|b| f64::from(own[middle][b][a]))))?;
        let inverted = std::array::from_fn(|b| std::array::from_fn(|a| inverted[a][b] as f32));
        self.diagonal.push(stored(&inverted));
        self.lower.add_row(&columns[..middle], &own[..middle]);
        self.upper.add_row(&columns[middle + 1..], &own[middle + 1..]);
        Ok(())
    }

    /// An approximate solution of A x = b.
    pub fn solve(&self, b: &[f64]) -> Vec<f64> {
        let nodes = self.order.len();
        // In the order, and in units of the largest, so that single precision holds all.
        let most = b.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let unit = if most > 0.0 { most } else { 1.0 };
        let mut x = vec![0.0f32; nodes * S];
        for (k, &i) in self.order.iter().enumerate() {
            (0..S).for_each(|a| x[k * S + a] = (b[i as usize * S + a] / unit) as f32);
        }
        for i in 0..nodes {
            let own = self.lower.rest(i, &x);
            x[i * S..(i + 1) * S].copy_from_slice(&own);
        }
        for i in (0..nodes).rev() {
            let own = self.upper.rest(i, &x);
            let mut sums = [[0.0; S]; S];
            add_times(&mut sums, &self.diagonal[i], &own);
            (0..S).for_each(|a| x[i * S + a] = sums.iter().map(|sum| sum[a]).sum());
        }
        let mut found = vec![0.0; nodes * S];
        for (k, &i) in self.order.iter().enumerate() {
            (0..S).for_each(|a| found[i as usize * S + a] = unit * f64::from(x[k * S + a]));
        }
        found
    }

    /// Memory of the factors.
    pub fn bytes(&self) -> usize {
        let pairs = self.lower.value.len() + self.upper.value.len();
        (pairs + self.diagonal.len()) * std::mem::size_of::<[[T; S]; S]>() + 4 * pairs
    }
}
