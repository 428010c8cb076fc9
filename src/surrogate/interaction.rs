//! One round of message passing (Sanchez-Gonzalez et al. 2020, as LagrangeBench's interaction network).
//!
//! m_ij = MLP([n_j, n_i, e_ij]) for each edge from sender j to receiver i, n_i' = n_i + MLP([n_i, sum_j m_ij]),
//! e_ij' = e_ij + m_ij. The first layer of the edges' perceptron is split, W [n_j; n_i; e] = Ws n_j + Wr n_i + We e: nodes
//! are multiplied once and gathered, which halves the work, and `[E, 3 L]` is never built. Edges go through in blocks
//! that end with a receiver, so sums over a receiver's edges need no atomics.
//!
//! State: `[N + E, L]`, nodes first; the last round gives `[N, L]`, because nobody reads its edges.

use super::graph::Graph;
use super::matrix;
use super::memory::{Memory, Owned};
use super::mlp::{self, Cotangents, Kept, Layers, Shape};
use crate::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use crate::sph::step;
use candle_core::{CpuStorage, CustomOp3, Layout, Result, Tensor};
use std::ops::Range;
use std::sync::{Arc, Mutex};

/// (state, edge parameters, node parameters) -> state.
pub struct Interaction<R: Real> {
    graph: Arc<Graph>,
    edge: Shape,
    node: Shape,
    last: bool,
    parts: Vec<Range<usize>>,
    memory: Memory<R>,
    kept: Mutex<Option<KeptRound<R>>>,
}

struct KeptRound<R: Real> {
    edge: Kept<R>,
    node: Kept<R>,
    /// `[N, L]`: sums of messages.
    sums: Owned<R>,
}

/// The edges' perceptron of a latent size.
pub fn edge_shape(latent: usize, hidden: usize, linears: usize) -> Shape {
    Shape { inputs: 3 * latent, hidden, outputs: latent, linears, norm: true }
}

/// The nodes'.
pub fn node_shape(latent: usize, hidden: usize, linears: usize) -> Shape {
    Shape { inputs: 2 * latent, hidden, outputs: latent, linears, norm: true }
}

impl<R: Real> Interaction<R> {
    /// `latent`, width of the hidden layers, linear layers of each perceptron.
    pub fn new(
        graph: &Arc<Graph>,
        (latent, hidden, linears): (usize, usize, usize),
        last: bool,
        memory: &Memory<R>,
    ) -> Self {
        Self {
            parts: graph.parts(mlp::parts(graph.edges() + graph.nodes())),
            graph: graph.clone(),
            edge: edge_shape(latent, hidden, linears),
            node: node_shape(latent, hidden, linears),
            last,
            memory: memory.clone(),
            kept: Mutex::new(None),
        }
    }

    fn latent(&self) -> usize {
        self.edge.outputs
    }
}

/// What the k-th input of L numbers is multiplied with: rows k L to (k + 1) L of the first weight.
#[inline(always)]
fn weight_of(shape: &Shape, k: usize) -> Range<usize> {
    let (at, length) = (shape.weight(0).start, shape.outputs * shape.hidden);
    at + k * length..at + (k + 1) * length
}

/// Nodes times Ws and Wr, `[N, 2 H]` as two matrices behind each other; the bias goes with the receivers.
struct Project<'a, R: Real> {
    op: &'a Interaction<R>,
    state: &'a [R],
    p: &'a [R],
    projected: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Project<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (op, l, h) = (self.op, self.op.latent(), self.op.edge.hidden);
        let n = op.graph.nodes();
        for nodes in range.map(|k| op.parts[k].clone()) {
            let x = &self.state[nodes.start * l..nodes.end * l];
            for k in 0..2 {
                // SAFETY: each part's nodes belong to one iteration.
                let to = unsafe { self.projected.slice((k * n + nodes.start) * h..(k * n + nodes.end) * h) };
                matrix::multiply(to, x, &self.p[weight_of(&op.edge, k)], (nodes.len(), l, h), false);
                if k == 1 {
                    let bias = &self.p[op.edge.bias(0)];
                    for row in to.chunks_exact_mut(h) {
                        for (x, &b) in row.iter_mut().zip(bias) {
                            *x += b;
                        }
                    }
                }
            }
        }
    }
}

struct Forward<'a, R: Real> {
    op: &'a Interaction<R>,
    state: &'a [R],
    edge_p: &'a [R],
    node_p: &'a [R],
    projected: &'a [R],
    edge: Layers<'a, R>,
    node: Layers<'a, R>,
    sums: Shared<'a, R>,
    out: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Forward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        for k in range {
            let nodes = self.op.parts[k].clone();
            for stretch in self.op.graph.stretches(nodes.clone(), self.op.edge.block::<R>()) {
                self.edges::<L>(stretch);
            }
            for block in mlp::blocks(nodes, self.op.node.block::<R>()) {
                self.nodes::<L>(block);
            }
        }
    }
}

impl<R: Real> Forward<'_, R> {
    /// Messages into a stretch of nodes, and their sums.
    #[inline(always)]
    fn edges<L: Lanes<Real = R>>(&self, nodes: Range<usize>) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.edge.hidden, self.edge_p);
        let (graph, n) = (&*op.graph, op.graph.nodes());
        let edges = graph.entering(&nodes);
        // SAFETY (all): a node, and the edges into it, belong to one iteration.
        let hidden = unsafe { self.edge.hidden(&op.edge, 0, edges.clone()) };
        let e = &self.state[(n + edges.start) * l..(n + edges.end) * l];
        matrix::multiply(hidden, e, &p[weight_of(&op.edge, 2)], (edges.len(), l, h), false);
        let zero = R::default();
        for (edge, row) in edges.clone().zip(hidden.chunks_exact_mut(h)) {
            let (j, i) = (graph.senders[edge] as usize, n + graph.receivers[edge] as usize);
            let (from, to) = (&self.projected[j * h..(j + 1) * h], &self.projected[i * h..(i + 1) * h]);
            for c in 0..h {
                let sum = row[c] + from[c] + to[c];
                row[c] = if sum > zero { sum } else { zero };
            }
        }
        unsafe { mlp::forward_block::<L>(&op.edge, p, &self.edge, edges.clone()) };
        let z = unsafe { &*self.edge.normalised(&op.edge, edges.clone()) };
        let (scale, offset) = (&p[op.edge.scale()], &p[op.edge.offset()]);
        for i in nodes {
            let sums = unsafe { self.sums.slice(i * l..(i + 1) * l) };
            sums.fill(zero);
            for edge in graph.entering(&(i..i + 1)) {
                let at = edge - edges.start;
                let z = &z[at * l..(at + 1) * l];
                if op.last {
                    for c in 0..l {
                        sums[c] += z[c] * scale[c] + offset[c];
                    }
                    continue;
                }
                let out = unsafe { self.out.slice((n + edge) * l..(n + edge + 1) * l) };
                let e = &e[at * l..(at + 1) * l];
                for c in 0..l {
                    let message = z[c] * scale[c] + offset[c];
                    sums[c] += message;
                    out[c] = e[c] + message;
                }
            }
        }
    }

    #[inline(always)]
    fn nodes<L: Lanes<Real = R>>(&self, nodes: Range<usize>) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.node.hidden, self.node_p);
        let place = nodes.start * l..nodes.end * l;
        // SAFETY (all): as for the edges.
        let (hidden, sums, out) = unsafe {
            let sums = &*self.sums.slice(place.clone());
            (self.node.hidden(&op.node, 0, nodes.clone()), sums, self.out.slice(place.clone()))
        };
        let (x, size) = (&self.state[place], (nodes.len(), l, h));
        matrix::multiply(hidden, x, &p[weight_of(&op.node, 0)], size, false);
        matrix::multiply(hidden, sums, &p[weight_of(&op.node, 1)], size, true);
        mlp::activate(hidden, &p[op.node.bias(0)]);
        unsafe { mlp::forward_block::<L>(&op.node, p, &self.node, nodes.clone()) };
        let z = unsafe { &*self.node.normalised(&op.node, nodes) };
        let (scale, offset) = (&p[op.node.scale()], &p[op.node.offset()]);
        for ((out, x), z) in out.chunks_exact_mut(l).zip(x.chunks_exact(l)).zip(z.chunks_exact(l)) {
            for c in 0..l {
                out[c] = x[c] + (z[c] * scale[c] + offset[c]);
            }
        }
    }
}

/// First pass of the adjoint: through the nodes' perceptron and the edges', to the sums of the edges' first layer.
struct Backward<'a, R: Real> {
    op: &'a Interaction<R>,
    state: &'a [R],
    edge_p: &'a [R],
    node_p: &'a [R],
    edge: Layers<'a, R>,
    node: Layers<'a, R>,
    sums: &'a [R],
    out_bar: &'a [R],
    /// `[E, H]`: cotangent of the first layer's sums; the second pass collects it by sender.
    first_bar: Shared<'a, R>,
    /// `[N, H]`: the same collected by receiver.
    received_bar: Shared<'a, R>,
    state_bar: Shared<'a, R>,
    edge_p_bar: Shared<'a, R>,
    node_p_bar: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Backward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (op, l) = (self.op, self.op.latent());
        let (node_block, edge_block) = (op.node.block::<R>(), op.edge.block::<R>());
        let mut node_room = Cotangents::new(&op.node, node_block);
        let mut room = Cotangents::new(&op.edge, edge_block);
        let mut z_bar = vec![R::default(); node_block.max(edge_block) * l];
        for k in range {
            let nodes = op.parts[k].clone();
            let mut sums_bar = vec![R::default(); nodes.len() * l];
            let (edge_length, node_length) = (op.edge.parameters(), op.node.parameters());
            // SAFETY: each part belongs to one iteration.
            let (edge_g, node_g) = unsafe {
                (
                    self.edge_p_bar.slice(k * edge_length..(k + 1) * edge_length),
                    self.node_p_bar.slice(k * node_length..(k + 1) * node_length),
                )
            };
            for block in mlp::blocks(nodes.clone(), node_block) {
                let sums_bar = &mut sums_bar[(block.start - nodes.start) * l..(block.end - nodes.start) * l];
                self.nodes::<L>(block, node_g, &mut z_bar, &mut node_room, sums_bar);
            }
            for stretch in op.graph.stretches(nodes.clone(), edge_block) {
                let count = op.graph.entering(&stretch).len();
                if count > edge_block {
                    // One node with more edges than a block: rare enough to pay for.
                    room = Cotangents::new(&op.edge, count);
                    z_bar.resize(count.max(node_block) * l, R::default());
                }
                let sums_bar = &sums_bar[(stretch.start - nodes.start) * l..(stretch.end - nodes.start) * l];
                self.edges::<L>(stretch, edge_g, &mut z_bar, &mut room, sums_bar);
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
        z_bar: &mut [R],
        room: &mut Cotangents<R>,
        sums_bar: &mut [R],
    ) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.node.hidden, self.node_p);
        let (count, place) = (nodes.len(), nodes.start * l..nodes.end * l);
        let out_bar = &self.out_bar[place.clone()];
        let z_bar = &mut z_bar[..count * l];
        z_bar.copy_from_slice(out_bar);
        // SAFETY (all): a node, and the edges into it, belong to one iteration.
        unsafe { mlp::backward_block::<L>(&op.node, p, &self.node, nodes, z_bar, g, room) };
        let first = &room.first[..count * h];
        let (own, of_sums) = (weight_of(&op.node, 0), weight_of(&op.node, 1));
        matrix::add_transposed(&mut g[own.clone()], &self.state[place.clone()], first, (l, count, h));
        matrix::add_transposed(&mut g[of_sums.clone()], &self.sums[place.clone()], first, (l, count, h));
        let state_bar = unsafe { self.state_bar.slice(place) };
        state_bar.copy_from_slice(out_bar);
        matrix::multiply_by_transposed(state_bar, first, &p[own], (count, h, l), true);
        matrix::multiply_by_transposed(sums_bar, first, &p[of_sums], (count, h, l), false);
    }

    #[inline(always)]
    fn edges<L: Lanes<Real = R>>(
        &self,
        nodes: Range<usize>,
        g: &mut [R],
        z_bar: &mut [R],
        room: &mut Cotangents<R>,
        sums_bar: &[R],
    ) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.edge.hidden, self.edge_p);
        let (graph, n) = (&*op.graph, op.graph.nodes());
        let edges = graph.entering(&nodes);
        let count = edges.len();
        let z_bar = &mut z_bar[..count * l];
        let place = (n + edges.start) * l..(n + edges.end) * l;
        for (bar, i) in sums_bar.chunks_exact(l).zip(nodes.clone()) {
            for edge in graph.entering(&(i..i + 1)) {
                let at = edge - edges.start;
                let z_bar = &mut z_bar[at * l..(at + 1) * l];
                if op.last {
                    z_bar.copy_from_slice(bar);
                } else {
                    let out_bar = &self.out_bar[(n + edge) * l..(n + edge + 1) * l];
                    for c in 0..l {
                        z_bar[c] = out_bar[c] + bar[c];
                    }
                }
            }
        }
        // SAFETY (all): as for the nodes.
        unsafe { mlp::backward_block::<L>(&op.edge, p, &self.edge, edges.clone(), z_bar, g, room) };
        let first = &room.first[..count * h];
        let own = weight_of(&op.edge, 2);
        matrix::add_transposed(&mut g[own.clone()], &self.state[place.clone()], first, (l, count, h));
        let state_bar = unsafe { self.state_bar.slice(place.clone()) };
        if !op.last {
            state_bar.copy_from_slice(&self.out_bar[place]);
        }
        matrix::multiply_by_transposed(state_bar, first, &p[own], (count, h, l), !op.last);
        unsafe { self.first_bar.slice(edges.start * h..edges.end * h) }.copy_from_slice(first);
        for i in nodes {
            let received = unsafe { self.received_bar.slice(i * h..(i + 1) * h) };
            received.fill(R::default());
            let into = graph.entering(&(i..i + 1));
            mlp::add_rows(received, &first[(into.start - edges.start) * h..(into.end - edges.start) * h]);
        }
    }
}

/// Second pass: what comes back to the nodes through the gathered projections.
struct Collect<'a, R: Real> {
    op: &'a Interaction<R>,
    state: &'a [R],
    p: &'a [R],
    first_bar: &'a [R],
    received_bar: &'a [R],
    state_bar: Shared<'a, R>,
    edge_p_bar: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Collect<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (op, l, h, p) = (self.op, self.op.latent(), self.op.edge.hidden, self.p);
        let mut sent_bar = vec![R::default(); op.node.block::<R>() * h];
        for k in range {
            let length = op.edge.parameters();
            // SAFETY (all): each part and its nodes belong to one iteration.
            let g = unsafe { self.edge_p_bar.slice(k * length..(k + 1) * length) };
            for nodes in mlp::blocks(op.parts[k].clone(), op.node.block::<R>()) {
                let count = nodes.len();
                let sent = &mut sent_bar[..count * h];
                sent.fill(R::default());
                for (sent, j) in sent.chunks_exact_mut(h).zip(nodes.clone()) {
                    for &edge in op.graph.out_of(j) {
                        let edge = edge as usize;
                        mlp::add_rows(sent, &self.first_bar[edge * h..(edge + 1) * h]);
                    }
                }
                let place = nodes.start * l..nodes.end * l;
                let x = &self.state[place.clone()];
                let state_bar = unsafe { self.state_bar.slice(place) };
                for (k, bar) in [(0, &*sent), (1, &self.received_bar[nodes.start * h..nodes.end * h])] {
                    let weight = weight_of(&op.edge, k);
                    matrix::add_transposed(&mut g[weight.clone()], x, bar, (l, count, h));
                    matrix::multiply_by_transposed(state_bar, bar, &p[weight], (count, h, l), true);
                }
            }
        }
    }
}

impl<R: Real> CustomOp3 for Interaction<R> {
    fn name(&self) -> &'static str {
        "interaction"
    }

    fn cpu_fwd(
        &self,
        state: &CpuStorage,
        state_layout: &Layout,
        edge_p: &CpuStorage,
        edge_layout: &Layout,
        node_p: &CpuStorage,
        node_layout: &Layout,
    ) -> Result<(CpuStorage, candle_core::Shape)> {
        let (l, n, edges) = (self.latent(), self.graph.nodes(), self.graph.edges());
        let state = step::input::<R>(state, state_layout)?;
        let (edge_p, node_p) = (step::input::<R>(edge_p, edge_layout)?, step::input::<R>(node_p, node_layout)?);
        if state.len() != (n + edges) * l {
            candle_core::bail!("interaction: the state has {} numbers, not ({n} + {edges}) x {l}", state.len());
        }
        let rows = if self.last { n } else { n + edges };
        let mut out = vec![R::default(); rows * l];
        let mut projected = self.memory.take(2 * n * self.edge.hidden);
        let mut kept = KeptRound {
            edge: Kept::new(&self.memory, &self.edge, edges),
            node: Kept::new(&self.memory, &self.node, n),
            sums: self.memory.take(n * l),
        };
        run_rows(&Project { op: self, state, p: edge_p, projected: Shared::new(&mut projected) }, self.parts.len());
        let pass = Forward {
            op: self,
            state,
            edge_p,
            node_p,
            projected: &projected,
            edge: kept.edge.shared(),
            node: kept.node.shared(),
            sums: Shared::new(&mut kept.sums),
            out: Shared::new(&mut out),
        };
        run_rows(&pass, self.parts.len());
        *self.kept.lock().unwrap_or_else(|e| e.into_inner()) = Some(kept);
        Ok(step::output(out, (rows, l)))
    }

    fn bwd(
        &self,
        state: &Tensor,
        edge_p: &Tensor,
        node_p: &Tensor,
        _: &Tensor,
        out_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let mut kept = self.kept.lock().unwrap_or_else(|e| e.into_inner());
        let Some(kept) = kept.as_mut() else {
            candle_core::bail!("interaction: the gradient was asked for without a forward pass")
        };
        let (l, n, edges) = (self.latent(), self.graph.nodes(), self.graph.edges());
        let (h, parts) = (self.edge.hidden, self.parts.len());
        let mut state_bar = vec![R::default(); (n + edges) * l];
        let mut edge_p_bar = vec![R::default(); parts * self.edge.parameters()];
        let mut node_p_bar = vec![R::default(); parts * self.node.parameters()];
        let mut first_bar = self.memory.take(edges * h);
        let mut received_bar = self.memory.take(n * h);
        step::read(&out_bar.contiguous()?, |out_bar| {
            step::read(state, |state| {
                step::read(edge_p, |edge_p| {
                    step::read(node_p, |node_p| {
                        let pass = Backward {
                            op: self,
                            state,
                            edge_p,
                            node_p,
                            edge: kept.edge.shared(),
                            node: kept.node.shared(),
                            sums: &kept.sums,
                            out_bar,
                            first_bar: Shared::new(&mut first_bar),
                            received_bar: Shared::new(&mut received_bar),
                            state_bar: Shared::new(&mut state_bar),
                            edge_p_bar: Shared::new(&mut edge_p_bar),
                            node_p_bar: Shared::new(&mut node_p_bar),
                        };
                        run_rows(&pass, parts);
                        let pass = Collect {
                            op: self,
                            state,
                            p: edge_p,
                            first_bar: &first_bar,
                            received_bar: &received_bar,
                            state_bar: Shared::new(&mut state_bar),
                            edge_p_bar: Shared::new(&mut edge_p_bar),
                        };
                        run_rows(&pass, parts);
                        Ok(())
                    })
                })
            })
        })?;
        let vector = |parts: &[R], length| Tensor::from_vec(mlp::sum_of_parts(parts, length), length, state.device());
        Ok((
            Some(Tensor::from_vec(state_bar, (n + edges, l), state.device())?),
            Some(vector(&edge_p_bar, self.edge.parameters())?),
            Some(vector(&node_p_bar, self.node.parameters())?),
        ))
    }
}
