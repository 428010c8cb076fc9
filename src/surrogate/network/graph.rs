//! The graph along which messages pass: its edges, sorted by receiver and by sender.

use crate::numerics::gather::Gather;
use crate::particles::neighbour_list::{NeighbourError, NeighbourList};
use crate::particles::{tag, Domain};
use candle_core::{Device, Tensor};
use std::ops::Range;

/// Directed edges, sorted by receiver and within a receiver by sender.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Graph {
    /// Senders and receivers of the edges, `[E]`.
    pub senders: Vec<u32>,
    pub receivers: Vec<u32>,
    /// Start of the edges into each node, `[N + 1]`: those into node i are `start[i]..start[i + 1]`.
    pub start: Vec<u32>,
    /// The edges sorted by sender, `[E]`, and where those of each sender begin, `[N + 1]`.
    pub leaving: Vec<u32>,
    pub leaving_start: Vec<u32>,
}

impl Graph {
    /// A graph of edges in any order.
    ///
    /// # Panics
    /// If an edge has a node that does not exist.
    pub fn new(nodes: usize, edges: impl IntoIterator<Item = (u32, u32)>) -> Self {
        let mut edges: Vec<(u32, u32)> = edges.into_iter().map(|(sender, receiver)| (receiver, sender)).collect();
        edges.sort_unstable();
        let (receivers, senders): (Vec<u32>, Vec<u32>) = edges.into_iter().unzip();
        let starts = |of: &[u32]| {
            let mut start = vec![0; nodes + 1];
            of.iter().for_each(|&i| start[i as usize + 1] += 1);
            (0..nodes).for_each(|i| start[i + 1] += start[i]);
            start
        };
        let (start, leaving_start) = (starts(&receivers), starts(&senders));
        let mut next = leaving_start.clone();
        let mut leaving = vec![0; senders.len()];
        for (edge, &sender) in senders.iter().enumerate() {
            leaving[next[sender as usize] as usize] = edge as u32;
            next[sender as usize] += 1;
        }
        Self { senders, receivers, start, leaving, leaving_start }
    }

    /// The graph of all pairs closer than `radius`, in both directions, and of every node with itself.
    ///
    /// `position` is `[N, D]`.
    ///
    /// # Errors
    /// A position that is not finite, too many neighbours, or too small a box.
    pub fn build(position: &[f64], domain: &Domain, radius: f64) -> Result<Self, NeighbourError> {
        let dimension = domain.dimension;
        let nodes = position.len() / dimension;
        let by_component: Vec<f64> =
            (0..dimension).flat_map(|d| position.iter().skip(d).step_by(dimension).copied()).collect();
        // Pairs of walls are needed here, so all particles have one kind.
        let list = NeighbourList::build(&by_component, &vec![tag::FLUID; nodes], domain, radius, 16)?;
        let pairs = (0..nodes).flat_map(|i| {
            let neighbours = list.row(i)[..list.count[i] as usize].iter().copied();
            neighbours.chain(std::iter::once(i as u32)).map(move |j| (j, i as u32))
        });
        Ok(Self::new(nodes, pairs))
    }

    pub fn nodes(&self) -> usize {
        self.start.len() - 1
    }

    pub fn edges(&self) -> usize {
        self.senders.len()
    }

    /// The edges into a range of nodes.
    #[inline(always)]
    pub fn entering(&self, nodes: &Range<usize>) -> Range<usize> {
        self.start[nodes.start] as usize..self.start[nodes.end] as usize
    }

    /// The edges out of a node.
    #[inline(always)]
    pub fn out_of(&self, node: usize) -> &[u32] {
        &self.leaving[self.leaving_start[node] as usize..self.leaving_start[node + 1] as usize]
    }

    /// Divides the nodes into `parts` ranges with about the same number of edges.
    pub fn parts(&self, parts: usize) -> Vec<Range<usize>> {
        // The perceptron of a node costs about as much as four edges.
        let weight = |i: usize| self.start[i] as usize + 4 * i;
        let (nodes, total) = (self.nodes(), weight(self.nodes()));
        let end = |k: usize| (0..nodes).find(|&i| weight(i) >= total * k / parts).unwrap_or(nodes);
        (0..parts).map(|k| end(k)..end(k + 1)).collect()
    }

    /// Divides nodes into ranges with about the same number of edges, at most `edges` plus those of one node.
    pub fn stretches(&self, nodes: Range<usize>, edges: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let mut at = nodes.start;
        let all = self.entering(&nodes).len();
        let most = nodes.clone().map(|i| self.entering(&(i..i + 1)).len()).max().unwrap_or(0);
        // Each range ends at most one node's edges before its share, so there are at most as many ranges as shares.
        let edges = all.div_ceil(all.div_ceil(edges).max(1)) + most;
        std::iter::from_fn(move || {
            if at >= nodes.end {
                return None;
            }
            let limit = self.start[at] as usize + edges;
            let mut to = at + 1;
            while to < nodes.end && self.start[to + 1] as usize <= limit {
                to += 1;
            }
            let stretch = at..to;
            at = to;
            Some(stretch)
        })
    }
}

/// The ends of a graph's edges as tensors, for gathering rows and their adjoint, sums of rows.
#[derive(Debug, Clone)]
pub struct Ends {
    senders: Gather,
    receivers: Gather,
}

impl Ends {
    /// The ends on a device.
    pub fn new(graph: &Graph, device: &Device) -> candle_core::Result<Self> {
        let gather = |ends: &[u32]| Gather::new(ends, graph.nodes(), device);
        Ok(Self { senders: gather(&graph.senders)?, receivers: gather(&graph.receivers)? })
    }

    /// Rows of the senders: `[N, C]` -> `[E, C]`.
    pub fn of_senders(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        self.senders.rows(x, 0)
    }

    /// Rows of the receivers: `[N, C]` -> `[E, C]`.
    pub fn of_receivers(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        self.receivers.rows(x, 0)
    }

    /// Sums over the edges into each node: `[E, C]` -> `[N, C]`.
    pub fn sums(&self, x: &Tensor) -> candle_core::Result<Tensor> {
        self.receivers.sums(x, 0)
    }
}
