//! Incomplete factors of a sparse matrix of blocks, as a preconditioner (Meijerink and van der Vorst 1977; Saad 2003, 10.3).
//!
//! The factors have the blocks of the matrix and no others (ILU(0)); blocks are inverted whole, so velocity and pressure of a
//! particle are eliminated together. Rows are in the order of Cuthill and McKee (1969), from one end of the graph to the other. The
//! factors are stored, and applied, in single precision: they are approximate anyway, and memory bounds their speed.

use super::sparse_lu::{BlockMatrix, Singular};

/// Incomplete factors of a [`BlockMatrix`] with blocks of S x S.
#[derive(Debug)]
pub struct IncompleteLu<const S: usize> {
    /// Block row of the matrix at each place of the order.
    order: Vec<u32>,
    /// Entries of each row: those of L, that of the inverted diagonal, those of U.
    first: Vec<usize>,
    diagonal: Vec<usize>,
    column: Vec<u32>,
    /// Blocks by columns, so that a product adds multiples of columns.
    value: Vec<[[f32; S]; S]>,
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
fn subtract_product<const S: usize>(c: &mut [[f32; S]; S], a: &[[f32; S]; S], b: &[[f32; S]; S]) {
    for column in 0..S {
        for k in 0..S {
            let factor = b[column][k];
            (0..S).for_each(|row| c[column][row] -= a[k][row] * factor);
        }
    }
}

/// y -= A x, the block by columns.
#[inline(always)]
fn subtract_times<const S: usize>(y: &mut [f32; S], a: &[[f32; S]; S], x: &[f32]) {
    for k in 0..S {
        (0..S).for_each(|row| y[row] -= a[k][row] * x[k]);
    }
}

impl<const S: usize> IncompleteLu<S> {
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
        let entries = pattern.first[nodes];
        let (mut column, mut value) = (Vec::with_capacity(entries), Vec::with_capacity(entries));
        let (mut first, mut diagonal) = (vec![0], vec![]);
        let mut own = vec![];
        for (k, &i) in order.iter().enumerate() {
            let (i, from) = (i as usize, pattern.first[i as usize]);
            own.clear();
            own.resize(pattern.row(i).len(), [[0.0; S]; S]);
            blocks(i, &mut |j, block| {
                let to = own[pattern.entry(i, j) - from].as_flattened_mut();
                to.iter_mut().zip(block).for_each(|(to, x)| *to += x);
            });
            let mut row: Vec<(u32, usize)> =
                pattern.row(i).iter().enumerate().map(|(e, &j)| (place[j as usize], e)).collect();
            row.sort_unstable();
            for (to, e) in row {
                if to as usize == k {
                    diagonal.push(column.len());
                }
                column.push(to);
                value.push(std::array::from_fn(|b| std::array::from_fn(|a| own[e][a][b] as f32)));
            }
            first.push(column.len());
        }
        let mut all = Self { order, first, diagonal, column, value };
        all.factorise()?;
        Ok(all)
    }

    fn factorise(&mut self) -> Result<(), Singular> {
        let nodes = self.order.len();
        // Place of the entry with a column in the present row.
        let mut entry_of = vec![usize::MAX; nodes];
        for i in 0..nodes {
            let (from, to) = (self.first[i], self.first[i + 1]);
            (from..to).for_each(|e| entry_of[self.column[e] as usize] = e);
            for e in from..self.diagonal[i] {
                let k = self.column[e] as usize;
                // L_ik = A_ik U_kk^-1
                let mut left = [[0.0; S]; S];
                subtract_product(&mut left, &self.value[e], &self.value[self.diagonal[k]]);
                let left = left.map(|column| column.map(|x| -x));
                self.value[e] = left;
                for other in self.diagonal[k] + 1..self.first[k + 1] {
                    let own = entry_of[self.column[other] as usize];
                    if own != usize::MAX {
                        let above = self.value[other];
                        subtract_product(&mut self.value[own], &left, &above);
                    }
                }
            }
            let block = self.value[self.diagonal[i]];
            let inverted = inverse::<S>(std::array::from_fn(|a| std::array::from_fn(|b| f64::from(block[b][a]))))?;
            self.value[self.diagonal[i]] = std::array::from_fn(|b| std::array::from_fn(|a| inverted[a][b] as f32));
            (from..to).for_each(|e| entry_of[self.column[e] as usize] = usize::MAX);
        }
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
        let subtract = |own: &mut [f32; S], x: &[f32], entries: std::ops::Range<usize>| {
            for e in entries {
                let from = self.column[e] as usize * S;
                subtract_times(own, &self.value[e], &x[from..from + S]);
            }
        };
        for i in 0..nodes {
            let mut own: [f32; S] = std::array::from_fn(|a| x[i * S + a]);
            subtract(&mut own, &x, self.first[i]..self.diagonal[i]);
            x[i * S..(i + 1) * S].copy_from_slice(&own);
        }
        for i in (0..nodes).rev() {
            let mut own: [f32; S] = std::array::from_fn(|a| x[i * S + a]);
            subtract(&mut own, &x, self.diagonal[i] + 1..self.first[i + 1]);
            let mut solved = [0.0; S];
            subtract_times(&mut solved, &self.value[self.diagonal[i]], &own);
            (0..S).for_each(|a| x[i * S + a] = -solved[a]);
        }
        let mut found = vec![0.0; nodes * S];
        for (k, &i) in self.order.iter().enumerate() {
            (0..S).for_each(|a| found[i as usize * S + a] = unit * f64::from(x[k * S + a]));
        }
        found
    }

    /// Memory of the factors.
    pub fn bytes(&self) -> usize {
        self.value.len() * (4 * S * S + 4)
    }
}
