//! Incomplete factors with a correction on groups of nodes, as a preconditioner of systems with one unknown a node (aggregation of two
//! levels: Notay 2010).
//!
//! Incomplete factors correct errors that change from node to node, and hardly those that are smooth over many nodes: their iterations
//! grow with the number of nodes along a side. So nodes are gathered in groups of some twenty, which first move together:
//!
//! ```text
//!   z = c P C^-1 P^T b,   x = z + L^-1 (b - A z),   C = P^T A P,
//! ```
//!
//! with P 1 for the nodes of a group and 0 elsewhere, L the incomplete factors, and C factorised exactly. A group that moves as one block
//! resists more than a smooth error does, so c is larger than 1 (Braess 1995).

use super::incomplete_lu::{from_end_to_end, IncompleteLu};
use super::sparse_lu::{BlockMatrix, Order, Singular, SparseLu};
use std::sync::Arc;

/// Fewer nodes than this have no groups: incomplete factors alone serve as well.
const LEAST: usize = 500;
/// A node is in the group of a neighbour if their entry is at least this part of its largest.
const STRONG: f64 = 0.1;
/// Groups of fewer nodes join others.
const SMALL: usize = 6;
/// c. (Iterations hardly depend on it between 1.5 and 2; with 1 there are a tenth more.)
const MORE: f64 = 1.5;
/// Belongs to no group.
const NONE: u32 = u32::MAX;

/// The preconditioner of a [`BlockMatrix`] with blocks of 1 x 1.
#[derive(Debug)]
pub struct TwoLevel {
    factors: IncompleteLu<1>,
    /// Group of each node.
    group: Vec<u32>,
    /// Number of groups.
    count: usize,
    coarse: Option<SparseLu>,
}

/// The group of each node, and their number. Nodes whose row or column has no other node (values that are given) have none.
fn groups(matrix: &BlockMatrix) -> (Vec<u32>, usize) {
    let nodes = matrix.nodes();
    let (mut by_row, mut by_column) = (vec![0.0f64; nodes], vec![0.0f64; nodes]);
    let entries = |i: usize| matrix.first[i]..matrix.first[i + 1];
    let others = |i: usize| entries(i).filter(move |&e| matrix.column[e] as usize != i);
    for i in 0..nodes {
        for e in others(i) {
            let size = matrix.values[e].abs();
            by_row[i] = by_row[i].max(size);
            let j = matrix.column[e] as usize;
            by_column[j] = by_column[j].max(size);
        }
    }
    let is_free = |i: usize| by_row[i] > 0.0 && by_column[i] > 0.0;
    let is_strong = |i: usize, e: usize| matrix.values[e].abs() >= STRONG * by_row[i];
    let mut group = vec![NONE; nodes];
    let mut members: Vec<Vec<u32>> = vec![];
    // Around nodes whose strong neighbours are all free, then around what is left.
    for all in [true, false] {
        for i in (0..nodes).filter(|&i| is_free(i)) {
            let strong = || others(i).filter(|&e| is_strong(i, e)).map(|e| matrix.column[e]);
            let is_taken = |j: u32| group[j as usize] != NONE;
            if is_taken(i as u32) || (all && strong().any(is_taken)) {
                continue;
            }
            let own: Vec<u32> = strong().filter(|&j| !is_taken(j) && is_free(j as usize)).chain([i as u32]).collect();
            own.iter().for_each(|&j| group[j as usize] = members.len() as u32);
            members.push(own);
        }
    }
    // Small groups join that of their strongest neighbour.
    for small in 0..members.len() {
        if members[small].len() >= SMALL {
            continue;
        }
        for i in std::mem::take(&mut members[small]) {
            let i = i as usize;
            let away = |e: &usize| {
                let to = group[matrix.column[*e] as usize];
                to != NONE && to as usize != small
            };
            let nearest =
                others(i).filter(away).max_by(|&a, &b| matrix.values[a].abs().total_cmp(&matrix.values[b].abs()));
            group[i] = nearest.map_or(NONE, |e| group[matrix.column[e] as usize]);
            if let Some(to) = members.get_mut(group[i] as usize) {
                to.push(i as u32);
            }
        }
    }
    let mut number = vec![NONE; members.len()];
    let mut count = 0;
    for i in 0..nodes {
        if group[i] != NONE {
            let own = &mut number[group[i] as usize];
            if *own == NONE {
                *own = count;
                count += 1;
            }
            group[i] = *own;
        }
    }
    (group, count as usize)
}

/// C.
fn gathered(matrix: &BlockMatrix, group: &[u32], count: usize) -> BlockMatrix {
    let pairs = || {
        (0..matrix.nodes()).filter(|&i| group[i] != NONE).flat_map(|i| {
            (matrix.first[i]..matrix.first[i + 1])
                .filter(|&e| group[matrix.column[e] as usize] != NONE)
                .map(move |e| (group[i], group[matrix.column[e] as usize], e))
        })
    };
    let mut lists: Vec<Vec<u32>> = vec![vec![]; count];
    for (a, b, _) in pairs() {
        lists[a as usize].push(b);
    }
    lists.iter_mut().for_each(|list| {
        list.sort_unstable();
        list.dedup();
    });
    let mut coarse = BlockMatrix::of_lists(count, 1, |a| lists[a].clone());
    for (a, b, e) in pairs() {
        let entry = coarse.entry(a as usize, b);
        coarse.values[entry] += matrix.values[e];
    }
    coarse
}

impl TwoLevel {
    /// # Errors
    /// A node without a diagonal entry.
    ///
    /// # Panics
    /// If the matrix has larger blocks.
    pub fn new(matrix: &BlockMatrix, threads: usize) -> Result<Self, Singular> {
        let factors = IncompleteLu::new(matrix)?;
        let (group, count) = if matrix.nodes() < LEAST { (vec![], 0) } else { groups(matrix) };
        let mut coarse = None;
        if count > 0 {
            let gathered = gathered(matrix, &group, count);
            // Groups have a place along the graph, by which they can be divided.
            let mut along = vec![0.0; count];
            from_end_to_end(&gathered).iter().enumerate().for_each(|(k, &i)| along[i as usize] = k as f64);
            let order = Arc::new(Order::new(&gathered, |i| [along[i]]));
            // Where C has no inverse the incomplete factors are alone.
            coarse = SparseLu::new(&order, &gathered, threads).ok();
        }
        Ok(Self { factors, group, count, coarse })
    }

    /// An approximate solution of A x = b, given A.
    pub fn solve(&self, matrix: &BlockMatrix, b: &[f64], threads: usize) -> Vec<f64> {
        let Some(coarse) = &self.coarse else { return self.factors.solve(b) };
        let mut sums = vec![0.0; self.count];
        for (x, &group) in b.iter().zip(&self.group).filter(|(_, &group)| group != NONE) {
            sums[group as usize] += x;
        }
        let moved = coarse.solve(&sums, false);
        let of = |&group: &u32| if group == NONE { 0.0 } else { MORE * moved[group as usize] };
        let z: Vec<f64> = self.group.iter().map(of).collect();
        let rest: Vec<f64> = b.iter().zip(matrix.times_on(&z, threads)).map(|(b, y)| b - y).collect();
        self.factors.solve(&rest).iter().zip(&z).map(|(x, z)| x + z).collect()
    }

    /// Memory of the factors.
    pub fn bytes(&self) -> usize {
        self.factors.bytes() + 4 * self.group.len() + self.coarse.as_ref().map_or(0, SparseLu::bytes)
    }
}
