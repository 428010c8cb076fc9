//! Rounds of message passing (Sanchez-Gonzalez et al. 2020, as LagrangeBench's interaction networks).
//!
//! m_ij = MLP([n_j, n_i, e_ij]) for each edge from sender j to receiver i, n_i' = n_i + MLP([n_i, sum_j m_ij]),
//! e_ij' = e_ij + m_ij. The first layer of the edges' perceptron is split, W [n_j; n_i; e] = Ws n_j + Wr n_i + We e: nodes
//! are multiplied once and gathered, which halves the work, and `[E, 3 L]` is never built. Edges go through in blocks
//! that end with a receiver, so sums over a receiver's edges need no atomics.
//!
//! All rounds are one operator: between operators candle clears, adds and copies a cotangent `[N + E, L]` each time, which
//! took a fifth of a training step. Here it is one buffer from the last round to the first.

use crate::numerics::candle::Operator;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::{Buffer, Buffers};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::surrogate::network::graph::Graph;
use crate::surrogate::network::matrix;
use crate::surrogate::network::mlp;
use crate::surrogate::network::mlp::{Activations, Cotangents, MlpShape, SharedActivations};
use crate::surrogate::network::row;
use crate::surrogate::network::row::each;
use candle_core::{Device, Result, Tensor};
use std::ops::Range;
use std::sync::{Arc, Mutex};

/// (nodes `[N, L]`, edges `[E, L]`, parameters of all rounds, each round's edges' before its nodes') -> nodes `[N, L]`.
pub struct Rounds<R: Real> {
    graph: Arc<Graph>,
    edge: MlpShape,
    node: MlpShape,
    rounds: usize,
    /// Whether the adjoint may be asked for.
    keeps: bool,
    parts: Vec<Range<usize>>,
    /// About how many edges go through together, and how many at most.
    edge_block: usize,
    edge_room: usize,
    /// Most nodes that go through together.
    node_block: usize,
    memory: Buffers<R>,
    activations: Mutex<Vec<RoundActivations<R>>>,
    trace: Option<Trace>,
}

/// The state `[N + E, L]` behind each round.
pub type Trace = Arc<Mutex<Vec<Tensor>>>;

struct RoundActivations<R: Real> {
    /// `[N, L]` and `[E, L]` before the round; none before the first, where they are the operator's inputs.
    before: Option<(Buffer<R>, Buffer<R>)>,
    edge: Activations<R>,
    node: Activations<R>,
    /// `[N, L]`: sums of messages.
    sums: Buffer<R>,
}

/// The edges' perceptron of a latent size.
pub fn edge_shape(latent: usize, hidden: usize, linears: usize) -> MlpShape {
    MlpShape { inputs: 3 * latent, hidden, outputs: latent, linears, norm: true }
}

/// The nodes'.
pub fn node_shape(latent: usize, hidden: usize, linears: usize) -> MlpShape {
    MlpShape { inputs: 2 * latent, hidden, outputs: latent, linears, norm: true }
}

impl<R: Real> Rounds<R> {
    /// `latent`, width of the hidden layers, linear layers of each perceptron; `keeps`: whether the adjoint may be asked for.
    pub fn new(
        graph: &Arc<Graph>,
        (latent, hidden, linears): (usize, usize, usize),
        rounds: usize,
        keeps: bool,
        memory: &Buffers<R>,
        trace: Option<Trace>,
    ) -> Self {
        let (edge, node) = (edge_shape(latent, hidden, linears), node_shape(latent, hidden, linears));
        let most = (0..graph.nodes()).map(|i| graph.entering(&(i..i + 1)).len()).max().unwrap_or(0);
        Self {
            parts: graph.parts(mlp::parts(graph.edges() + graph.nodes())),
            graph: graph.clone(),
            edge,
            node,
            rounds,
            keeps,
            edge_block: edge.block::<R>(),
            edge_room: edge.block::<R>() + most,
            node_block: node.block::<R>(),
            memory: memory.clone(),
            activations: Mutex::new(Vec::new()),
            trace,
        }
    }

    /// Where the parameters of a round's edges and nodes stand.
    fn parameters(&self, round: usize) -> (Range<usize>, Range<usize>) {
        let (edge, node) = (self.edge.parameters(), self.node.parameters());
        let at = round * (edge + node);
        (at..at + edge, at + edge..at + edge + node)
    }

    /// Whether somebody reads the edges behind a round.
    fn gives_edges(&self, round: usize) -> bool {
        round + 1 < self.rounds || self.trace.is_some()
    }

    fn latent(&self) -> usize {
        self.edge.outputs
    }
}

/// What the k-th input of L numbers is multiplied with: rows k L to (k + 1) L of the first weight.
#[inline(always)]
fn weight_of(shape: &MlpShape, k: usize) -> Range<usize> {
    let (at, length) = (shape.weight(0).start, shape.outputs * shape.hidden);
    at + k * length..at + (k + 1) * length
}

/// Nodes times Ws and Wr, `[N, 2 H]` as two matrices behind each other; the bias goes with the receivers.
struct Project<'a, R: Real> {
    op: &'a Rounds<R>,
    nodes: &'a [R],
    p: &'a [R],
    projected: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Project<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (op, l, h) = (self.op, self.op.latent(), self.op.edge.hidden);
        let n = op.graph.nodes();
        for nodes in range.map(|k| op.parts[k].clone()) {
            let x = &self.nodes[nodes.start * l..nodes.end * l];
            for k in 0..2 {
                // SAFETY: each part's nodes belong to one iteration.
                let to = unsafe { self.projected.slice((k * n + nodes.start) * h..(k * n + nodes.end) * h) };
                matrix::multiply(to, x, &self.p[weight_of(&op.edge, k)], (nodes.len(), l, h), false);
                if k == 1 {
                    let bias = &self.p[op.edge.bias(0)];
                    for row in to.chunks_exact_mut(h) {
                        each::<L, 1>(row, [bias], |x, [b]| x + b);
                    }
                }
            }
        }
    }
}

struct Forward<'a, R: Real> {
    op: &'a Rounds<R>,
    nodes: &'a [R],
    /// None if they stand in `edges_out` and are changed there: half the memory to go through.
    edges: Option<&'a [R]>,
    edge_p: &'a [R],
    node_p: &'a [R],
    projected: &'a [R],
    /// Of edges and nodes; none if no adjoint follows.
    activations: Option<(SharedActivations<'a, R>, SharedActivations<'a, R>)>,
    sums: Shared<'a, R>,
    nodes_out: Shared<'a, R>,
    /// Empty if nobody reads them.
    edges_out: Shared<'a, R>,
    gives_edges: bool,
}

impl<R: Real> RowKernel<R> for Forward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let op = self.op;
        // Without an adjoint a block's activations stay in the core's cache, and the next block's go over them.
        let mut room = (self.activations.is_none()).then(|| {
            let activations = |shape, rows| Activations::new(&op.memory, shape, rows);
            (activations(&op.edge, op.edge_room), activations(&op.node, op.node_block))
        });
        let room = room.as_mut().map(|(edge, node)| (edge.shared(), node.shared()));
        let Some((edge, node)) = self.activations.as_ref().or(room.as_ref()) else { return };
        for k in range {
            let nodes = op.parts[k].clone();
            for stretch in op.graph.stretches(nodes.clone(), op.edge_block) {
                self.edges::<L>(stretch, edge);
            }
            for block in mlp::blocks(nodes, op.node_block) {
                self.nodes::<L>(block, node);
            }
        }
    }
}

impl<R: Real> Forward<'_, R> {
    /// Messages into a stretch of nodes, and their sums.
    #[inline(always)]
    fn edges<L: Lanes<Real = R>>(&self, nodes: Range<usize>, layers: &SharedActivations<R>) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.edge.hidden, self.edge_p);
        let (graph, n) = (&*op.graph, op.graph.nodes());
        let edges = graph.entering(&nodes);
        let rows = if self.activations.is_some() { edges.clone() } else { 0..edges.len() };
        // SAFETY (all): a node, and the edges into it, belong to one iteration.
        let hidden = unsafe { layers.hidden(&op.edge, 0, rows.clone()) };
        let place = edges.start * l..edges.end * l;
        let e = self.edges.map(|edges| &edges[place.clone()]);
        let given = e.unwrap_or_else(|| unsafe { &*self.edges_out.slice(place.clone()) });
        matrix::multiply(hidden, given, &p[weight_of(&op.edge, 2)], (edges.len(), l, h), false);
        for (edge, row) in edges.clone().zip(hidden.chunks_exact_mut(h)) {
            let (j, i) = (graph.senders[edge] as usize, n + graph.receivers[edge] as usize);
            let (from, to) = (&self.projected[j * h..(j + 1) * h], &self.projected[i * h..(i + 1) * h]);
            each::<L, 2>(row, [from, to], |x, [from, to]| (x + from + to).positive());
        }
        unsafe { mlp::forward_block::<L>(&op.edge, p, layers, rows.clone()) };
        let z = unsafe { &*layers.normalised(&op.edge, rows) };
        let (scale, offset) = (&p[op.edge.scale()], &p[op.edge.offset()]);
        for i in nodes {
            let into = graph.entering(&(i..i + 1));
            let sums = unsafe { self.sums.slice(i * l..(i + 1) * l) };
            sums.fill(R::default());
            let of_node = &z[(into.start - edges.start) * l..(into.end - edges.start) * l];
            row::add_rows::<L, 1>(sums, [of_node], |[z]| z);
            let count = L::splat(R::of(into.len() as f64));
            each::<L, 2>(sums, [scale, offset], |sum, [scale, offset]| sum * scale + count * offset);
        }
        if self.gives_edges {
            let out = unsafe { self.edges_out.slice(place) };
            for (row, (out, z)) in out.chunks_exact_mut(l).zip(z.chunks_exact(l)).enumerate() {
                match e {
                    Some(e) => {
                        let e = &e[row * l..(row + 1) * l];
                        each::<L, 4>(out, [e, z, scale, offset], |_, [e, z, scale, offset]| e + (z * scale + offset))
                    }
                    None => each::<L, 3>(out, [z, scale, offset], |e, [z, scale, offset]| e + (z * scale + offset)),
                }
            }
        }
    }

    #[inline(always)]
    fn nodes<L: Lanes<Real = R>>(&self, nodes: Range<usize>, layers: &SharedActivations<R>) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.node.hidden, self.node_p);
        let place = nodes.start * l..nodes.end * l;
        let rows = if self.activations.is_some() { nodes.clone() } else { 0..nodes.len() };
        // SAFETY (all): as for the edges.
        let (hidden, sums, out) = unsafe {
            let sums = &*self.sums.slice(place.clone());
            (layers.hidden(&op.node, 0, rows.clone()), sums, self.nodes_out.slice(place.clone()))
        };
        let (x, size) = (&self.nodes[place], (nodes.len(), l, h));
        matrix::multiply(hidden, x, &p[weight_of(&op.node, 0)], size, false);
        matrix::multiply(hidden, sums, &p[weight_of(&op.node, 1)], size, true);
        row::activate::<L>(hidden, &p[op.node.bias(0)]);
        unsafe { mlp::forward_block::<L>(&op.node, p, layers, rows.clone()) };
        let z = unsafe { &*layers.normalised(&op.node, rows) };
        let (scale, offset) = (&p[op.node.scale()], &p[op.node.offset()]);
        for ((out, x), z) in out.chunks_exact_mut(l).zip(x.chunks_exact(l)).zip(z.chunks_exact(l)) {
            each::<L, 4>(out, [x, z, scale, offset], |_, [x, z, scale, offset]| x + (z * scale + offset));
        }
    }
}

/// First pass of the adjoint: through the nodes' perceptron and the edges', to the sums of the edges' first layer.
struct Backward<'a, R: Real> {
    op: &'a Rounds<R>,
    nodes: &'a [R],
    edges: &'a [R],
    edge_p: &'a [R],
    node_p: &'a [R],
    edge: SharedActivations<'a, R>,
    node: SharedActivations<'a, R>,
    sums: &'a [R],
    /// Cotangents of what the round gave, and then of what it was given.
    nodes_bar: Shared<'a, R>,
    edges_bar: Shared<'a, R>,
    /// Whether anything comes back through the edges that the round gave.
    had_edges: bool,
    /// `[E, H]`: cotangent of the first layer's sums; the second pass collects it by sender.
    first_bar: Shared<'a, R>,
    /// `[N, H]`: the same collected by receiver.
    received_bar: Shared<'a, R>,
    /// `[parts, P]`.
    edge_p_bar: Shared<'a, R>,
    node_p_bar: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Backward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (op, l) = (self.op, self.op.latent());
        let (node_block, edge_block) = (op.node_block, op.edge_block);
        let mut node_room = Cotangents::new(&op.memory, &op.node, node_block, true);
        // The edges' first cotangents have a place of their own.
        let mut edge_room = Cotangents::new(&op.memory, &op.edge, op.edge_room, false);
        for k in range {
            let nodes = op.parts[k].clone();
            let mut sums_bar = op.memory.buffer(nodes.len() * l);
            let (edge_length, node_length) = (op.edge.parameters(), op.node.parameters());
            // SAFETY: each part belongs to one iteration.
            let (edge_g, node_g) = unsafe {
                (
                    self.edge_p_bar.slice(k * edge_length..(k + 1) * edge_length),
                    self.node_p_bar.slice(k * node_length..(k + 1) * node_length),
                )
            };
            edge_g.fill(R::default());
            node_g.fill(R::default());
            for block in mlp::blocks(nodes.clone(), node_block) {
                let sums_bar = &mut sums_bar[(block.start - nodes.start) * l..(block.end - nodes.start) * l];
                self.nodes::<L>(block, node_g, &mut node_room, sums_bar);
            }
            for stretch in op.graph.stretches(nodes.clone(), edge_block) {
                let sums_bar = &sums_bar[(stretch.start - nodes.start) * l..(stretch.end - nodes.start) * l];
                self.edges::<L>(stretch, edge_g, &mut edge_room, sums_bar);
            }
        }
    }
}

impl<R: Real> Backward<'_, R> {
    #[inline(always)]
    fn nodes<L: Lanes<Real = R>>(
        &self,
        nodes: Range<usize>,
        g: &mut [R],
        room: &mut Cotangents<R>,
        sums_bar: &mut [R],
    ) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.node.hidden, self.node_p);
        let (count, place) = (nodes.len(), nodes.start * l..nodes.end * l);
        // SAFETY (all): a node, and the edges into it, belong to one iteration.
        let nodes_bar = unsafe { self.nodes_bar.slice(place.clone()) };
        let (z_bar, first) = (&mut room.z[..count * l], &mut room.first[..count * h]);
        z_bar.copy_from_slice(nodes_bar);
        unsafe { mlp::backward_block::<L>(&op.node, p, &self.node, nodes, z_bar, g, first, &mut room.between) };
        let (own, of_sums) = (weight_of(&op.node, 0), weight_of(&op.node, 1));
        matrix::add_transposed(&mut g[own.clone()], &self.nodes[place.clone()], first, (l, count, h));
        matrix::add_transposed(&mut g[of_sums.clone()], &self.sums[place], first, (l, count, h));
        matrix::multiply_by_transposed(nodes_bar, first, &p[own], (count, h, l), true);
        matrix::multiply_by_transposed(sums_bar, first, &p[of_sums], (count, h, l), false);
    }

    #[inline(always)]
    fn edges<L: Lanes<Real = R>>(&self, nodes: Range<usize>, g: &mut [R], room: &mut Cotangents<R>, sums_bar: &[R]) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.edge.hidden, self.edge_p);
        let graph = &*op.graph;
        let edges = graph.entering(&nodes);
        let count = edges.len();
        let z_bar = &mut room.z[..count * l];
        let place = edges.start * l..edges.end * l;
        // SAFETY (all): as for the nodes.
        let edges_bar = unsafe { self.edges_bar.slice(place.clone()) };
        for (bar, i) in sums_bar.chunks_exact(l).zip(nodes.clone()) {
            for edge in graph.entering(&(i..i + 1)) {
                let at = edge - edges.start;
                let z_bar = &mut z_bar[at * l..(at + 1) * l];
                if self.had_edges {
                    let edge_bar = &edges_bar[at * l..(at + 1) * l];
                    each::<L, 2>(z_bar, [edge_bar, bar], |_, [edge, node]| edge + node);
                } else {
                    z_bar.copy_from_slice(bar);
                }
            }
        }
        let first = unsafe { self.first_bar.slice(edges.start * h..edges.end * h) };
        unsafe { mlp::backward_block::<L>(&op.edge, p, &self.edge, edges.clone(), z_bar, g, first, &mut room.between) };
        let own = weight_of(&op.edge, 2);
        matrix::add_transposed(&mut g[own.clone()], &self.edges[place], first, (l, count, h));
        matrix::multiply_by_transposed(edges_bar, first, &p[own], (count, h, l), self.had_edges);
        for i in nodes {
            let received = unsafe { self.received_bar.slice(i * h..(i + 1) * h) };
            received.fill(R::default());
            let into = graph.entering(&(i..i + 1));
            row::add_rows::<L, 1>(
                received,
                [&first[(into.start - edges.start) * h..(into.end - edges.start) * h]],
                |[bar]| bar,
            );
        }
    }
}

/// Second pass: what comes back to the nodes through the gathered projections.
struct Collect<'a, R: Real> {
    op: &'a Rounds<R>,
    nodes: &'a [R],
    p: &'a [R],
    first_bar: &'a [R],
    received_bar: &'a [R],
    nodes_bar: Shared<'a, R>,
    edge_p_bar: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Collect<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.edge.hidden, self.p);
        let mut sent_bar = op.memory.buffer(op.node_block * h);
        for k in range {
            let length = op.edge.parameters();
            // SAFETY (all): each part and its nodes belong to one iteration.
            let g = unsafe { self.edge_p_bar.slice(k * length..(k + 1) * length) };
            for nodes in mlp::blocks(op.parts[k].clone(), op.node_block) {
                let count = nodes.len();
                let sent = &mut sent_bar[..count * h];
                sent.fill(R::default());
                for (sent, j) in sent.chunks_exact_mut(h).zip(nodes.clone()) {
                    for &edge in op.graph.out_of(j) {
                        let edge = edge as usize;
                        each::<L, 1>(sent, [&self.first_bar[edge * h..(edge + 1) * h]], |sum, [bar]| sum + bar);
                    }
                }
                let place = nodes.start * l..nodes.end * l;
                let x = &self.nodes[place.clone()];
                let nodes_bar = unsafe { self.nodes_bar.slice(place) };
                for (k, bar) in [(0, &*sent), (1, &self.received_bar[nodes.start * h..nodes.end * h])] {
                    let weight = weight_of(&op.edge, k);
                    matrix::add_transposed(&mut g[weight.clone()], x, bar, (l, count, h));
                    matrix::multiply_by_transposed(nodes_bar, bar, &p[weight], (count, h, l), true);
                }
            }
        }
    }
}

impl<R: Real> Rounds<R> {
    /// One round: nodes behind it, and what the adjoint needs. The edges behind it come to stand in `edges_out`, where those
    /// before it stand if there are no `edges`.
    fn forward_round(
        &self,
        round: usize,
        nodes: &[R],
        edges: Option<&[R]>,
        edges_out: &mut [R],
        p: &[R],
    ) -> (Buffer<R>, Option<RoundActivations<R>>) {
        let (l, n, e) = (self.latent(), self.graph.nodes(), self.graph.edges());
        let (edge_p, node_p) = self.parameters(round);
        let (edge_p, node_p, take) = (&p[edge_p], &p[node_p], |length| self.memory.buffer(length));
        let mut nodes_out = take(n * l);
        let (mut projected, mut sums) = (take(2 * n * self.edge.hidden), take(n * l));
        let activations = |shape, rows| Activations::new(&self.memory, shape, rows);
        let mut layers = self.keeps.then(|| (activations(&self.edge, e), activations(&self.node, n)));
        let pass = Project { op: self, nodes, p: edge_p, projected: Shared::new(&mut projected) };
        run_rows(&pass, self.parts.len());
        let pass = Forward {
            op: self,
            nodes,
            edges,
            edge_p,
            node_p,
            projected: &projected,
            activations: layers.as_mut().map(|(edge, node)| (edge.shared(), node.shared())),
            sums: Shared::new(&mut sums),
            nodes_out: Shared::new(&mut nodes_out),
            edges_out: Shared::new(edges_out),
            gives_edges: self.gives_edges(round),
        };
        run_rows(&pass, self.parts.len());
        let activations = layers.map(|(edge, node)| RoundActivations { before: None, edge, node, sums });
        (nodes_out, activations)
    }

    /// Its adjoint: `nodes_bar` and `edges_bar` go from behind the round to before it, the gradient is put into `p_bar`.
    #[allow(clippy::too_many_arguments)]
    fn backward_round(
        &self,
        round: usize,
        (nodes, edges): (&[R], &[R]),
        p: &[R],
        activations: &mut RoundActivations<R>,
        nodes_bar: &mut [R],
        edges_bar: &mut [R],
        p_bar: &mut [R],
    ) {
        let (n, e, h, parts) = (self.graph.nodes(), self.graph.edges(), self.edge.hidden, self.parts.len());
        let (edge_p, node_p) = self.parameters(round);
        let mut edge_p_bar = self.memory.buffer(parts * edge_p.len());
        let mut node_p_bar = self.memory.buffer(parts * node_p.len());
        let (mut first_bar, mut received_bar) = (self.memory.buffer(e * h), self.memory.buffer(n * h));
        let pass = Backward {
            op: self,
            nodes,
            edges,
            edge_p: &p[edge_p.clone()],
            node_p: &p[node_p.clone()],
            edge: activations.edge.shared(),
            node: activations.node.shared(),
            sums: &activations.sums,
            nodes_bar: Shared::new(nodes_bar),
            edges_bar: Shared::new(edges_bar),
            had_edges: round + 1 < self.rounds,
            first_bar: Shared::new(&mut first_bar),
            received_bar: Shared::new(&mut received_bar),
            edge_p_bar: Shared::new(&mut edge_p_bar),
            node_p_bar: Shared::new(&mut node_p_bar),
        };
        run_rows(&pass, parts);
        let pass = Collect {
            op: self,
            nodes,
            p: &p[edge_p.clone()],
            first_bar: &first_bar,
            received_bar: &received_bar,
            nodes_bar: Shared::new(nodes_bar),
            edge_p_bar: Shared::new(&mut edge_p_bar),
        };
        run_rows(&pass, parts);
        mlp::sum_of_parts(&mut p_bar[edge_p], &edge_p_bar);
        mlp::sum_of_parts(&mut p_bar[node_p], &node_p_bar);
    }
}

impl<R: Real> Operator<3> for Rounds<R> {
    type Real = R;
    const NAME: &'static str = "rounds";

    fn forward(
        &self,
        [nodes, edges, p]: [&[R]; 3],
        _: [&candle_core::Shape; 3],
    ) -> Result<(Vec<R>, candle_core::Shape)> {
        let (l, n, e) = (self.latent(), self.graph.nodes(), self.graph.edges());
        if nodes.len() != n * l || edges.len() != e * l || p.len() != self.parameters(self.rounds).0.start {
            candle_core::bail!("rounds: {} and {} numbers, not {n} x {l} and {e} x {l}", nodes.len(), edges.len());
        }
        let mut activations = Vec::with_capacity(self.rounds);
        let (mut nodes_now, mut edges_now): (Option<Buffer<R>>, Option<Buffer<R>>) = (None, None);
        for round in 0..self.rounds {
            // Without an adjoint nobody asks again for the edges before the round.
            let own = if self.keeps { None } else { edges_now.take() };
            let given = own.is_none().then(|| edges_now.as_deref().map_or(edges, |edges| edges));
            let mut edges_out =
                own.unwrap_or_else(|| self.memory.buffer(if self.gives_edges(round) { e * l } else { 0 }));
            let from = nodes_now.as_deref().map_or(nodes, |nodes| nodes);
            let (nodes_out, one) = self.forward_round(round, from, given, &mut edges_out, p);
            if let Some(trace) = &self.trace {
                let state = Tensor::from_vec([&nodes_out[..], &edges_out[..]].concat(), (n + e, l), &Device::Cpu)?;
                trace.lock().unwrap_or_else(|e| e.into_inner()).push(state);
            }
            let before = nodes_now.replace(nodes_out).zip(edges_now.replace(edges_out));
            activations.extend(one.map(|one| RoundActivations { before, ..one }));
        }
        *self.activations.lock().unwrap_or_else(|e| e.into_inner()) = activations;
        let out = nodes_now.as_deref().map_or(nodes, |nodes| nodes).to_vec();
        Ok((out, (n, l).into()))
    }

    fn adjoint(
        &self,
        [nodes, edges, p]: [&[R]; 3],
        _: &[R],
        out_bar: &[R],
        _: [bool; 3],
    ) -> Result<[Option<Vec<R>>; 3]> {
        let mut activations = self.activations.lock().unwrap_or_else(|e| e.into_inner());
        if activations.len() != self.rounds {
            candle_core::bail!("rounds: the gradient was asked for without a forward pass that keeps activations")
        }
        let mut nodes_bar = out_bar.to_vec();
        let mut edges_bar = vec![R::default(); edges.len()];
        let mut p_bar = vec![R::default(); p.len()];
        for (round, activations) in activations.iter_mut().enumerate().rev() {
            let before = activations.before.take();
            let state = before.as_ref().map_or((nodes, edges), |(nodes, edges)| (&nodes[..], &edges[..]));
            self.backward_round(round, state, p, activations, &mut nodes_bar, &mut edges_bar, &mut p_bar);
            activations.before = before;
        }
        Ok([Some(nodes_bar), Some(edges_bar), Some(p_bar)])
    }
}
