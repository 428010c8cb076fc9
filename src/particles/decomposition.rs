//! A box cut into one block per rank, with about as many particles in each.
//!
//! Recursive bisection (Berger and Bokhari 1987): a block for several ranks is cut across its longest side, so that both parts have
//! particles in proportion to their ranks, until every block is that of one rank. Where the cut lies follows from counts of particles
//! along the side, which may be summed over ranks: no rank needs the particles of the others.

use super::Domain;
use crate::numerics::lanes::Real;

/// Slices along a block's side in which particles are counted.
const SLICES: usize = 1024;

/// A block for some ranks in a row, cut or not.
#[derive(Debug, Clone)]
struct Block {
    first: usize,
    ranks: usize,
    range: [[f64; 2]; 3],
    /// The direction across which it is cut, where, and its lower part; the upper part follows that one.
    cut: Option<(usize, f64, usize)>,
}

/// The blocks of all ranks.
#[derive(Debug, Clone)]
pub struct Decomposition {
    domain: Domain,
    /// The whole box is the first.
    tree: Vec<Block>,
    /// Range of each rank's block; without end where it ends with a box that is not periodic.
    blocks: Vec<[[f64; 2]; 3]>,
}

impl Decomposition {
    /// Blocks for so many ranks. `positions` `[D, n]` are those of some of the particles, and `sum` adds numbers over all who have others;
    /// `bounds` is where all particles are in directions that are not periodic. `only` is the one direction that may be cut across.
    pub fn new<R: Real>(
        domain: &Domain,
        bounds: [[f64; 2]; 3],
        ranks: usize,
        only: Option<usize>,
        positions: &[R],
        sum: &dyn Fn(&[f64]) -> Vec<f64>,
    ) -> Self {
        let n = positions.len() / domain.dimension;
        let range = [0, 1, 2].map(|d| if domain.periodic[d] { [0.0, domain.size[d]] } else { bounds[d] });
        let mut tree = vec![Block { first: 0, ranks, range, cut: None }];
        // The block of each particle so far.
        let mut place = vec![0; n];
        loop {
            let open: Vec<usize> = (0..tree.len()).filter(|&k| tree[k].ranks > 1 && tree[k].cut.is_none()).collect();
            if open.is_empty() {
                break;
            }
            let longest = |block: &Block| {
                let length = |d: &usize| block.range[*d][1] - block.range[*d][0];
                let all = (0..domain.dimension).rev();
                only.or(all.max_by(|a, b| length(a).total_cmp(&length(b)))).unwrap_or(0)
            };
            let sides: Vec<usize> = open.iter().map(|&k| longest(&tree[k])).collect();
            let mut counts = vec![0.0; open.len() * SLICES];
            for i in 0..n {
                let Some(k) = open.iter().position(|&k| k == place[i]) else { continue };
                let [low, high] = tree[place[i]].range[sides[k]];
                let share = (positions[sides[k] * n + i].f64() - low) / (high - low);
                counts[k * SLICES + ((share * SLICES as f64) as usize).min(SLICES - 1)] += 1.0;
            }
            let counts = sum(&counts);
            for (k, &at) in open.iter().enumerate() {
                let (block, d) = (tree[at].clone(), sides[k]);
                let lower = block.ranks / 2;
                let [low, high] = block.range[d];
                let share = share_below(&counts[k * SLICES..(k + 1) * SLICES], lower as f64 / block.ranks as f64);
                let cut = low + share * (high - low);
                let mut parts = [block.range; 2];
                (parts[0][d][1], parts[1][d][0]) = (cut, cut);
                tree[at].cut = Some((d, cut, tree.len()));
                tree.push(Block { first: block.first, ranks: lower, range: parts[0], cut: None });
                tree.push(Block { first: block.first + lower, ranks: block.ranks - lower, range: parts[1], cut: None });
            }
            for i in 0..n {
                if let Some((d, cut, lower)) = tree[place[i]].cut {
                    place[i] = lower + usize::from(positions[d * n + i].f64() >= cut);
                }
            }
        }
        let mut blocks = vec![range; ranks];
        for block in tree.iter().filter(|block| block.cut.is_none()) {
            let mut own = block.range;
            for d in (0..3).filter(|&d| d >= domain.dimension || !domain.periodic[d]) {
                for (end, far) in [(0, f64::NEG_INFINITY), (1, f64::INFINITY)] {
                    if own[d][end] == range[d][end] {
                        own[d][end] = far;
                    }
                }
            }
            blocks[block.first] = own;
        }
        Self { domain: *domain, tree, blocks }
    }

    /// The rank in whose block a place is.
    pub fn owner(&self, place: [f64; 3]) -> usize {
        let mut at = 0;
        while let Some((d, cut, lower)) = self.tree[at].cut {
            at = lower + usize::from(self.domain.wrapped(d, place[d]) >= cut);
        }
        self.tree[at].first
    }

    /// Whether a place is nearer than `reach` to a rank's block, or in it.
    pub fn is_near(&self, rank: usize, place: [f64; 3], reach: f64) -> bool {
        let mut square = 0.0;
        for d in 0..self.domain.dimension {
            let [low, high] = self.blocks[rank][d];
            let x = self.domain.wrapped(d, place[d]);
            let mut away = (low - x).max(x - high).max(0.0);
            if self.domain.periodic[d] && away > 0.0 {
                let size = self.domain.size[d];
                away = away.min((low - (x - size)).max(0.0)).min(((x + size) - high).max(0.0));
            }
            square += away * away;
        }
        square < reach * reach
    }
}

/// The share of a side below which this share of the particles is.
fn share_below(counts: &[f64], wanted: f64) -> f64 {
    let wanted = wanted * counts.iter().sum::<f64>();
    let mut below = 0.0;
    for (k, &count) in counts.iter().enumerate() {
        if count > 0.0 && below + count >= wanted {
            return (k as f64 + (wanted - below) / count) / counts.len() as f64;
        }
        below += count;
    }
    0.5
}
