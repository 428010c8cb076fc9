//! The first layer of a perceptron on the edges of a graph, split: W [n_j; n_i; e] = Ws n_j + Wr n_i + We e.
//!
//! Nodes are multiplied once and gathered, which halves the work where an edge has as many numbers as a node, and `[E, 3 L]` is never built.

use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::{Buffer, Buffers};
use crate::numerics::sweep::{cut, run_parts, PartKernel};
use crate::surrogate::network::graph::Graph;
use crate::surrogate::network::matrix;
use crate::surrogate::network::mlp::{self, since, times, MlpShape};
use crate::surrogate::network::row::{self, each};
use std::ops::Range;
use std::sync::Arc;

/// A perceptron on edges, whose inputs are the L numbers of the sender, those of the receiver, and those of the edge.
pub struct SplitLayer<R: Real> {
    pub graph: Arc<Graph>,
    pub shape: MlpShape,
    /// Numbers of a node, L.
    pub latent: usize,
    /// The nodes of each part, and the edges into them.
    pub parts: Vec<Range<usize>>,
    pub edge_parts: Vec<Range<usize>>,
    /// About how many edges go through together, and how many at most.
    pub block: usize,
    pub room: usize,
    pub memory: Buffers<R>,
}

/// Nodes times Ws and Wr, `[N, H]` each; the bias goes with the receivers.
pub struct Projected<R: Real> {
    numbers: Buffer<R>,
    half: usize,
}

impl<R: Real> SplitLayer<R> {
    pub fn new(graph: &Arc<Graph>, latent: usize, shape: MlpShape, memory: &Buffers<R>) -> Self {
        let most = (0..graph.nodes()).map(|i| graph.entering(&(i..i + 1)).len()).max().unwrap_or(0);
        let parts = graph.parts(mlp::parts(graph.edges() + graph.nodes()));
        Self {
            edge_parts: parts.iter().map(|nodes| graph.entering(nodes)).collect(),
            parts,
            graph: graph.clone(),
            shape,
            latent,
            block: shape.block::<R>(),
            room: shape.block::<R>() + most,
            memory: memory.clone(),
        }
    }

    /// The rows of the first weight that multiply the sender (0) or the receiver (1).
    #[inline(always)]
    fn weight_of_node(&self, k: usize) -> Range<usize> {
        self.shape.weight_of(k * self.latent..(k + 1) * self.latent)
    }

    /// Those that multiply what the edge itself has.
    #[inline(always)]
    pub fn weight_of_edge(&self) -> Range<usize> {
        self.shape.weight_of(2 * self.latent..self.shape.inputs)
    }

    /// What the nodes `[N, L]` give to their edges, by the parameters `p` of the perceptron.
    pub fn project(&self, nodes: &[R], p: &[R]) -> Projected<R> {
        let (n, h) = (self.graph.nodes(), self.shape.hidden);
        let mut numbers = self.memory.buffer(2 * n * h);
        let (sent, received) = numbers.split_at_mut(n * h);
        let ends = cut(sent, &self.parts, h).into_iter().zip(cut(received, &self.parts, h));
        run_parts(&Project { layer: self, nodes, p }, ends.map(|(sent, received)| [sent, received]));
        Projected { numbers, half: n * h }
    }

    /// `hidden` of some edges, which has We e: adds what their nodes give, and rectifies.
    #[inline(always)]
    pub fn add_ends<L: Lanes<Real = R>>(&self, hidden: &mut [R], edges: Range<usize>, projected: &Projected<R>) {
        let h = self.shape.hidden;
        let (sent, received) = projected.numbers.split_at(projected.half);
        for (edge, row) in edges.zip(hidden.chunks_exact_mut(h)) {
            let (j, i) = (self.graph.senders[edge] as usize, self.graph.receivers[edge] as usize);
            let (from, to) = (&sent[j * h..(j + 1) * h], &received[i * h..(i + 1) * h]);
            each::<L, 2>(row, [from, to], |x, [from, to]| (x + from + to).positive());
        }
    }

    /// The cotangents `first` of the first layer's sums of all edges into `nodes`, collected by receiver.
    #[inline(always)]
    pub fn collect_received<L: Lanes<Real = R>>(&self, nodes: Range<usize>, first: &[R], received: &mut [R]) {
        let h = self.shape.hidden;
        let from = self.graph.entering(&nodes).start;
        for (i, received) in nodes.zip(received.chunks_exact_mut(h)) {
            received.fill(R::default());
            let into = since(from, &self.graph.entering(&(i..i + 1)));
            row::add_rows::<L, 1>(received, [&first[times(&into, h)]], |[bar]| bar);
        }
    }

    /// Adds what comes back to the nodes through the gathered projections: to `nodes_bar` `[N, L]`, and to the parts of the parameters'
    /// gradient. `first_bar` are the cotangents of the first layer's sums, `[E, H]`; `received_bar` the same by receiver, `[N, H]`.
    pub fn collect(
        &self,
        (nodes, p): (&[R], &[R]),
        (first_bar, received_bar): (&[R], &[R]),
        nodes_bar: &mut [R],
        parts_bar: &mut [R],
    ) {
        let of_parameters = parts_bar.chunks_exact_mut(self.shape.parameters());
        let bars = cut(nodes_bar, &self.parts, self.latent).into_iter().zip(of_parameters);
        run_parts(&Collect { layer: self, nodes, p, first_bar, received_bar }, bars);
    }
}

struct Project<'a, R: Real> {
    layer: &'a SplitLayer<R>,
    nodes: &'a [R],
    p: &'a [R],
}

impl<'a, R: Real> PartKernel<R> for Project<'a, R> {
    type Part = [&'a mut [R]; 2];

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, part: usize, projected: &mut Self::Part) {
        let Self { layer, nodes, p } = self;
        let (rows, l, h) = (&layer.parts[part], layer.latent, layer.shape.hidden);
        for (k, to) in projected.iter_mut().enumerate() {
            let weight = &p[layer.weight_of_node(k)];
            matrix::multiply(to, &nodes[times(rows, l)], weight, (rows.len(), l, h), false);
        }
        for row in projected[1].chunks_exact_mut(h) {
            each::<L, 1>(row, [&p[layer.shape.bias(0)]], |x, [b]| x + b);
        }
    }
}

struct Collect<'a, R: Real> {
    layer: &'a SplitLayer<R>,
    nodes: &'a [R],
    p: &'a [R],
    first_bar: &'a [R],
    received_bar: &'a [R],
}

impl<'a, R: Real> PartKernel<R> for Collect<'a, R> {
    /// Cotangents of the nodes, and the part's share of those of the parameters.
    type Part = (&'a mut [R], &'a mut [R]);

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, part: usize, (nodes_bar, g): &mut Self::Part) {
        let Self { layer, p, .. } = self;
        let (l, h) = (layer.latent, layer.shape.hidden);
        let mut sent_bar = layer.memory.buffer(layer.block * h);
        for nodes in mlp::blocks(layer.parts[part].clone(), layer.block) {
            let count = nodes.len();
            let sent = &mut sent_bar[..count * h];
            sent.fill(R::default());
            for (sent, j) in sent.chunks_exact_mut(h).zip(nodes.clone()) {
                for &edge in layer.graph.out_of(j) {
                    let edge = edge as usize;
                    each::<L, 1>(sent, [&self.first_bar[edge * h..(edge + 1) * h]], |sum, [bar]| sum + bar);
                }
            }
            let x = &self.nodes[times(&nodes, l)];
            let nodes_bar = &mut nodes_bar[times(&since(layer.parts[part].start, &nodes), l)];
            for (k, bar) in [(0, &*sent), (1, &self.received_bar[times(&nodes, h)])] {
                let weight = layer.weight_of_node(k);
                matrix::add_transposed(&mut g[weight.clone()], x, bar, (l, count, h));
                matrix::multiply_by_transposed(nodes_bar, bar, &p[weight], (count, h, l), true);
            }
        }
    }
}
