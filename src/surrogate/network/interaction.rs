//! Rounds of message passing (Sanchez-Gonzalez et al. 2020, as LagrangeBench's interaction networks).
//!
//! m_ij = MLP([n_j, n_i, e_ij]) for each edge from sender j to receiver i, n_i' = n_i + MLP([n_i, sum_j m_ij]),
//! e_ij' = e_ij + m_ij. The first layer of the edges' perceptron is [split](super::split_layer). Edges go through in blocks
//! that end with a receiver, so sums over a receiver's edges need no atomics.
//!
//! All rounds are one operator: between operators candle clears, adds and copies a cotangent `[N + E, L]` each time, which
//! took a fifth of a training step. Here it is one buffer from the last round to the first.

use crate::numerics::candle::Operator;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::{Buffer, Buffers};
use crate::numerics::sweep::{cut, run_parts, PartKernel};
use crate::surrogate::network::graph::Graph;
use crate::surrogate::network::matrix;
use crate::surrogate::network::mlp::{self, since, times, Activations, Cotangents, Layers, MlpShape};
use crate::surrogate::network::row::{self, each};
use crate::surrogate::network::split_layer::{Projected, SplitLayer};
use candle_core::{Device, Result, Tensor};
use std::ops::Range;
use std::sync::{Arc, Mutex};

/// (nodes `[N, L]`, edges `[E, L]`, parameters of all rounds, each round's edges' before its nodes') -> nodes `[N, L]`.
pub struct Rounds<R: Real> {
    edge: SplitLayer<R>,
    node: MlpShape,
    rounds: usize,
    /// Whether the adjoint may be asked for.
    keeps: bool,
    /// Most nodes that go through together.
    node_block: usize,
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
        Self {
            edge: SplitLayer::new(graph, latent, edge, memory),
            node,
            rounds,
            keeps,
            node_block: node.block::<R>(),
            activations: Mutex::new(Vec::new()),
            trace,
        }
    }

    /// Where the parameters of a round's edges and nodes stand.
    fn parameters(&self, round: usize) -> (Range<usize>, Range<usize>) {
        let (edge, node) = (self.edge.shape.parameters(), self.node.parameters());
        let at = round * (edge + node);
        (at..at + edge, at + edge..at + edge + node)
    }

    /// Whether somebody reads the edges behind a round.
    fn gives_edges(&self, round: usize) -> bool {
        round + 1 < self.rounds || self.trace.is_some()
    }

    fn latent(&self) -> usize {
        self.edge.latent
    }
}

/// What each sweep of a round needs.
#[derive(Clone, Copy)]
struct Round<'a, R: Real> {
    op: &'a Rounds<R>,
    /// Nodes before the round.
    nodes: &'a [R],
    /// Parameters of the edges' perceptron and of the nodes'.
    edge_p: &'a [R],
    node_p: &'a [R],
}

struct Forward<'a, R: Real> {
    round: Round<'a, R>,
    /// None if they stand where those behind the round are put: half the memory to go through.
    edges: Option<&'a [R]>,
    projected: &'a Projected<R>,
    gives_edges: bool,
}

/// What the forward pass of a round gives for a part of the nodes and the edges into them.
struct Given<'a, R> {
    /// Of edges and nodes; none if no adjoint follows.
    activations: Option<(Layers<'a, R>, Layers<'a, R>)>,
    sums: &'a mut [R],
    nodes: &'a mut [R],
    /// Empty if nobody reads them.
    edges: &'a mut [R],
}

impl<'a, R: Real> PartKernel<R> for Forward<'a, R> {
    type Part = Given<'a, R>;

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, k: usize, given: &mut Self::Part) {
        let op = self.round.op;
        // Without an adjoint a block's activations stay in the core's cache, and the next block's go over them.
        let mut room = (!op.keeps).then(|| {
            let activations = |shape, rows| Activations::new(&op.edge.memory, shape, rows);
            (activations(&op.edge.shape, op.edge.room), activations(&op.node, op.node_block))
        });
        let room = room.as_mut().map(|(edge, node)| (edge.whole(), node.whole()));
        let Some((mut edge, mut node)) = given.activations.take().or(room) else { return };
        for nodes in op.edge.graph.stretches(op.edge.parts[k].clone(), op.edge.block) {
            self.edges::<L>(k, nodes, given, &mut edge);
        }
        for nodes in mlp::blocks(op.edge.parts[k].clone(), op.node_block) {
            self.nodes::<L>(k, nodes, given, &mut node);
        }
    }
}

impl<R: Real> Forward<'_, R> {
    /// Messages into a stretch of a part's nodes, and their sums.
    #[inline(always)]
    fn edges<L: Lanes<Real = R>>(&self, k: usize, nodes: Range<usize>, given: &mut Given<R>, layers: &mut Layers<R>) {
        let Round { op, edge_p: p, .. } = self.round;
        let (layer, l, h) = (&op.edge, op.latent(), op.edge.shape.hidden);
        let edges = layer.graph.entering(&nodes);
        let own = since(layer.edge_parts[k].start, &edges);
        let rows = if op.keeps { own.clone() } else { 0..edges.len() };
        let hidden = layers.first(&rows);
        let e = self.edges.map(|all| &all[times(&edges, l)]);
        let before = e.unwrap_or_else(|| &given.edges[times(&own, l)]);
        matrix::multiply(hidden, before, &p[layer.weight_of_edge()], (edges.len(), l, h), false);
        layer.add_ends::<L>(hidden, edges.clone(), self.projected);
        mlp::forward_block::<L>(p, layers, &rows);
        let z = layers.normalised(&rows);
        let (scale, offset) = (&p[layer.shape.scale()], &p[layer.shape.offset()]);
        let sums = &mut given.sums[times(&since(layer.parts[k].start, &nodes), l)];
        for (i, sums) in nodes.zip(sums.chunks_exact_mut(l)) {
            let into = layer.graph.entering(&(i..i + 1));
            sums.fill(R::default());
            row::add_rows::<L, 1>(sums, [&z[times(&since(edges.start, &into), l)]], |[z]| z);
            let count = L::splat(R::of(into.len() as f64));
            each::<L, 2>(sums, [scale, offset], |sum, [scale, offset]| sum * scale + count * offset);
        }
        if self.gives_edges {
            let out = given.edges[times(&own, l)].chunks_exact_mut(l);
            for (row, (out, z)) in out.zip(z.chunks_exact(l)).enumerate() {
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
    fn nodes<L: Lanes<Real = R>>(&self, k: usize, nodes: Range<usize>, given: &mut Given<R>, layers: &mut Layers<R>) {
        let Round { op, node_p: p, .. } = self.round;
        let (l, h) = (op.latent(), op.node.hidden);
        let own = since(op.edge.parts[k].start, &nodes);
        let rows = if op.keeps { own.clone() } else { 0..nodes.len() };
        let (hidden, place) = (layers.first(&rows), times(&own, l));
        let (x, size) = (&self.round.nodes[times(&nodes, l)], (nodes.len(), l, h));
        matrix::multiply(hidden, x, &p[op.node.weight_of(0..l)], size, false);
        matrix::multiply(hidden, &given.sums[place.clone()], &p[op.node.weight_of(l..2 * l)], size, true);
        row::activate::<L>(hidden, &p[op.node.bias(0)]);
        mlp::forward_block::<L>(p, layers, &rows);
        let z = layers.normalised(&rows);
        let (scale, offset) = (&p[op.node.scale()], &p[op.node.offset()]);
        for ((out, x), z) in given.nodes[place].chunks_exact_mut(l).zip(x.chunks_exact(l)).zip(z.chunks_exact(l)) {
            each::<L, 4>(out, [x, z, scale, offset], |_, [x, z, scale, offset]| x + (z * scale + offset));
        }
    }
}

/// First pass of the adjoint: through the nodes' perceptron and the edges', to the sums of the edges' first layer.
struct Backward<'a, R: Real> {
    round: Round<'a, R>,
    edges: &'a [R],
    activations: &'a RoundActivations<R>,
    /// Whether anything comes back through the edges that the round gave.
    had_edges: bool,
}

/// The cotangents of a part of the nodes and the edges into them.
struct Bars<'a, R> {
    /// Of what the round gave, and then of what it was given.
    nodes: &'a mut [R],
    edges: &'a mut [R],
    /// `[E, H]`: of the first layer's sums; the second pass collects it by sender.
    first: &'a mut [R],
    /// `[N, H]`: the same collected by receiver.
    received: &'a mut [R],
    /// Of the parameters, the part's share.
    edge_p: &'a mut [R],
    node_p: &'a mut [R],
}

impl<'a, R: Real> PartKernel<R> for Backward<'a, R> {
    type Part = Bars<'a, R>;

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, k: usize, bars: &mut Self::Part) {
        let (op, l) = (self.round.op, self.round.op.latent());
        let memory = &op.edge.memory;
        let mut node_room = Cotangents::new(memory, &op.node, op.node_block, true);
        // The edges' first cotangents have a place of their own.
        let mut edge_room = Cotangents::new(memory, &op.edge.shape, op.edge.room, false);
        let nodes = &op.edge.parts[k];
        let mut sums_bar = memory.buffer(nodes.len() * l);
        bars.edge_p.fill(R::default());
        bars.node_p.fill(R::default());
        for block in mlp::blocks(nodes.clone(), op.node_block) {
            let own = since(nodes.start, &block);
            self.nodes::<L>(block, &own, bars, &mut node_room, &mut sums_bar[times(&own, l)]);
        }
        for stretch in op.edge.graph.stretches(nodes.clone(), op.edge.block) {
            let own = since(nodes.start, &stretch);
            self.edges::<L>(k, stretch, bars, &mut edge_room, &sums_bar[times(&own, l)]);
        }
    }
}

impl<R: Real> Backward<'_, R> {
    #[inline(always)]
    fn nodes<L: Lanes<Real = R>>(
        &self,
        nodes: Range<usize>,
        own: &Range<usize>,
        bars: &mut Bars<R>,
        room: &mut Cotangents<R>,
        sums_bar: &mut [R],
    ) {
        let Round { op, node_p: p, .. } = self.round;
        let (l, h, count, place) = (op.latent(), op.node.hidden, nodes.len(), times(&nodes, op.latent()));
        let (nodes_bar, g) = (&mut bars.nodes[times(own, l)], &mut *bars.node_p);
        let (z_bar, first) = (&mut room.z[..count * l], &mut room.first[..count * h]);
        z_bar.copy_from_slice(nodes_bar);
        mlp::backward_block::<L>(p, &self.activations.node, &nodes, z_bar, g, first, &mut room.between);
        let (own, of_sums) = (op.node.weight_of(0..l), op.node.weight_of(l..2 * l));
        matrix::add_transposed(&mut g[own.clone()], &self.round.nodes[place.clone()], first, (l, count, h));
        matrix::add_transposed(&mut g[of_sums.clone()], &self.activations.sums[place], first, (l, count, h));
        matrix::multiply_by_transposed(nodes_bar, first, &p[own], (count, h, l), true);
        matrix::multiply_by_transposed(sums_bar, first, &p[of_sums], (count, h, l), false);
    }

    #[inline(always)]
    fn edges<L: Lanes<Real = R>>(
        &self,
        k: usize,
        nodes: Range<usize>,
        bars: &mut Bars<R>,
        room: &mut Cotangents<R>,
        sums_bar: &[R],
    ) {
        let Round { op, edge_p: p, .. } = self.round;
        let (layer, l, h) = (&op.edge, op.latent(), op.edge.shape.hidden);
        let edges = layer.graph.entering(&nodes);
        let (count, own) = (edges.len(), since(layer.edge_parts[k].start, &edges));
        let z_bar = &mut room.z[..count * l];
        let (edges_bar, g) = (&mut bars.edges[times(&own, l)], &mut *bars.edge_p);
        for (bar, i) in sums_bar.chunks_exact(l).zip(nodes.clone()) {
            for at in since(edges.start, &layer.graph.entering(&(i..i + 1))) {
                let z_bar = &mut z_bar[at * l..(at + 1) * l];
                if self.had_edges {
                    let edge_bar = &edges_bar[at * l..(at + 1) * l];
                    each::<L, 2>(z_bar, [edge_bar, bar], |_, [edge, node]| edge + node);
                } else {
                    z_bar.copy_from_slice(bar);
                }
            }
        }
        let first = &mut bars.first[times(&own, h)];
        mlp::backward_block::<L>(p, &self.activations.edge, &edges, z_bar, g, first, &mut room.between);
        let weight = layer.weight_of_edge();
        matrix::add_transposed(&mut g[weight.clone()], &self.edges[times(&edges, l)], first, (l, count, h));
        matrix::multiply_by_transposed(edges_bar, first, &p[weight], (count, h, l), self.had_edges);
        let received = &mut bars.received[times(&since(layer.parts[k].start, &nodes), h)];
        layer.collect_received::<L>(nodes, first, received);
    }
}

impl<R: Real> Rounds<R> {
    fn round<'a>(&'a self, round: usize, nodes: &'a [R], p: &'a [R]) -> Round<'a, R> {
        let (edge_p, node_p) = self.parameters(round);
        Round { op: self, nodes, edge_p: &p[edge_p], node_p: &p[node_p] }
    }

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
        let layer = &self.edge;
        let (l, n, e) = (self.latent(), layer.graph.nodes(), layer.graph.edges());
        let (gives_edges, round) = (self.gives_edges(round), self.round(round, nodes, p));
        let [mut nodes_out, mut sums] = [n * l, n * l].map(|length| layer.memory.buffer(length));
        let projected = &layer.project(nodes, round.edge_p);
        let activations = |shape, rows| Activations::new(&layer.memory, shape, rows);
        let mut kept = self.keeps.then(|| (activations(&layer.shape, e), activations(&self.node, n)));
        let layers = kept.as_mut().map(|(edge, node)| (edge.parts(&layer.edge_parts), node.parts(&layer.parts)));
        let mut layers = layers.map(|(edge, node)| edge.into_iter().zip(node));
        let width = if edges_out.is_empty() { 0 } else { l };
        let nodes_parts = cut(&mut sums, &layer.parts, l).into_iter().zip(cut(&mut nodes_out, &layer.parts, l));
        let parts = nodes_parts.zip(cut(edges_out, &layer.edge_parts, width)).map(|((sums, nodes), edges)| {
            let activations = layers.as_mut().and_then(Iterator::next);
            Given { activations, sums, nodes, edges }
        });
        run_parts(&Forward { round, edges, projected, gives_edges }, parts);
        (nodes_out, kept.map(|(edge, node)| RoundActivations { before: None, edge, node, sums }))
    }

    /// Its adjoint: `nodes_bar` and `edges_bar` go from behind the round to before it, the gradient is put into `p_bar`.
    #[allow(clippy::too_many_arguments)]
    fn backward_round(
        &self,
        number: usize,
        (nodes, edges): (&[R], &[R]),
        p: &[R],
        activations: &RoundActivations<R>,
        nodes_bar: &mut [R],
        edges_bar: &mut [R],
        p_bar: &mut [R],
    ) {
        let layer = &self.edge;
        let (n, e, l, h) = (layer.graph.nodes(), layer.graph.edges(), self.latent(), layer.shape.hidden);
        let (round, count) = (self.round(number, nodes, p), layer.parts.len());
        let (edge_length, node_length) = (round.edge_p.len(), round.node_p.len());
        let [mut edge_p_bar, mut node_p_bar, mut first_bar, mut received_bar] =
            [count * edge_length, count * node_length, e * h, n * h].map(|length| layer.memory.buffer(length));
        let mut edge_bars = cut(edges_bar, &layer.edge_parts, l).into_iter();
        let mut first = cut(&mut first_bar, &layer.edge_parts, h).into_iter();
        let mut received = cut(&mut received_bar, &layer.parts, h).into_iter();
        let of_edges = edge_p_bar.chunks_exact_mut(edge_length);
        let mut of_parameters = of_edges.zip(node_p_bar.chunks_exact_mut(node_length));
        let bars = cut(nodes_bar, &layer.parts, l).into_iter().map_while(|nodes| {
            let (edges, first, received) = (edge_bars.next()?, first.next()?, received.next()?);
            let (edge_p, node_p) = of_parameters.next()?;
            Some(Bars { nodes, edges, first, received, edge_p, node_p })
        });
        let had_edges = number + 1 < self.rounds;
        run_parts(&Backward { round, edges, activations, had_edges }, bars);
        layer.collect((nodes, round.edge_p), (&first_bar, &received_bar), nodes_bar, &mut edge_p_bar);
        let (edge_p, node_p) = self.parameters(number);
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
        let (l, n, e) = (self.latent(), self.edge.graph.nodes(), self.edge.graph.edges());
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
                own.unwrap_or_else(|| self.edge.memory.buffer(if self.gives_edges(round) { e * l } else { 0 }));
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
        let activations = self.activations.lock().unwrap_or_else(|e| e.into_inner());
        if activations.len() != self.rounds {
            candle_core::bail!("rounds: the gradient was asked for without a forward pass that keeps activations")
        }
        let mut nodes_bar = out_bar.to_vec();
        let mut edges_bar = vec![R::default(); edges.len()];
        let mut p_bar = vec![R::default(); p.len()];
        for (round, activations) in activations.iter().enumerate().rev() {
            let state = activations.before.as_ref().map_or((nodes, edges), |(nodes, edges)| (&nodes[..], &edges[..]));
            self.backward_round(round, state, p, activations, &mut nodes_bar, &mut edges_bar, &mut p_bar);
        }
        Ok([Some(nodes_bar), Some(edges_bar), Some(p_bar)])
    }
}
