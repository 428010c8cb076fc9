//! Messages along the edges of a graph, as one operator: m_ij = MLP([n_j, n_i, e_ij]) for each edge from sender j to receiver i, with few
//! numbers e_ij of an edge (Satorras, Hoogeboom and Welling 2021, eq. 3).

use crate::numerics::candle::Operator;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::Buffers;
use crate::numerics::sweep::{cut, run_parts, PartKernel};
use crate::surrogate::network::graph::Graph;
use crate::surrogate::network::matrix;
use crate::surrogate::network::mlp::{self, since, times, Activations, Cotangents, Layers, MlpShape};
use crate::surrogate::network::split_layer::{Projected, SplitLayer};
use candle_core::{Result, Shape};
use std::sync::{Arc, Mutex, PoisonError};

/// (nodes `[N, L]`, edges `[E, F]`, parameters `[P]` of a perceptron of 2 L + F inputs with normalisation) -> messages `[E, M]`.
pub struct Messages<R: Real> {
    layer: SplitLayer<R>,
    activations: Mutex<Option<Activations<R>>>,
}

impl<R: Real> Messages<R> {
    /// `latent`: numbers of a node, L. `shape` has a normalisation.
    pub fn new(graph: &Arc<Graph>, latent: usize, shape: MlpShape, memory: &Buffers<R>) -> Self {
        assert!(shape.norm && shape.inputs > 2 * latent, "messages of {shape:?}");
        Self { layer: SplitLayer::new(graph, latent, shape, memory), activations: Mutex::new(None) }
    }

    /// Numbers of an edge, F.
    fn features(&self) -> usize {
        self.layer.shape.inputs - 2 * self.layer.latent
    }
}

struct Forward<'a, R: Real> {
    op: &'a Messages<R>,
    edges: &'a [R],
    p: &'a [R],
    projected: &'a Projected<R>,
}

impl<'a, R: Real> PartKernel<R> for Forward<'a, R> {
    /// Activations and messages of a part's edges.
    type Part = (Layers<'a, R>, &'a mut [R]);

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, k: usize, (layers, out): &mut Self::Part) {
        let (layer, p, features) = (&self.op.layer, self.p, self.op.features());
        let (shape, h) = (layer.shape, layer.shape.hidden);
        for nodes in layer.graph.stretches(layer.parts[k].clone(), layer.block) {
            let edges = layer.graph.entering(&nodes);
            let rows = since(layer.edge_parts[k].start, &edges);
            let (hidden, x) = (layers.first(&rows), &self.edges[times(&edges, features)]);
            matrix::multiply(hidden, x, &p[layer.weight_of_edge()], (edges.len(), features, h), false);
            layer.add_ends::<L>(hidden, edges, self.projected);
            mlp::forward_block::<L>(p, layers, &rows);
            layers.output::<L>(p, &rows, &mut out[times(&rows, shape.outputs)]);
        }
    }
}

struct Backward<'a, R: Real> {
    op: &'a Messages<R>,
    edges: &'a [R],
    p: &'a [R],
    activations: &'a Activations<R>,
    out_bar: &'a [R],
}

/// The cotangents of a part of the nodes and the edges into them.
struct Bars<'a, R> {
    /// Of what the edges have; empty if nobody asks for it.
    edges: &'a mut [R],
    /// Of the first layer's sums, by edge and collected by receiver.
    first: &'a mut [R],
    received: &'a mut [R],
    /// Of the parameters, the part's share.
    p: &'a mut [R],
}

impl<'a, R: Real> PartKernel<R> for Backward<'a, R> {
    type Part = Bars<'a, R>;

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, k: usize, bars: &mut Self::Part) {
        let (layer, p, features) = (&self.op.layer, self.p, self.op.features());
        let (shape, h) = (layer.shape, layer.shape.hidden);
        let mut room = Cotangents::new(&layer.memory, &shape, layer.room, false);
        bars.p.fill(R::default());
        for nodes in layer.graph.stretches(layer.parts[k].clone(), layer.block) {
            let edges = layer.graph.entering(&nodes);
            let (count, own) = (edges.len(), since(layer.edge_parts[k].start, &edges));
            let z_bar = &mut room.z[..count * shape.outputs];
            z_bar.copy_from_slice(&self.out_bar[times(&edges, shape.outputs)]);
            let first = &mut bars.first[times(&own, h)];
            mlp::backward_block::<L>(p, self.activations, &edges, z_bar, bars.p, first, &mut room.between);
            let (weight, x) = (layer.weight_of_edge(), &self.edges[times(&edges, features)]);
            matrix::add_transposed(&mut bars.p[weight.clone()], x, first, (features, count, h));
            if !bars.edges.is_empty() {
                let edges_bar = &mut bars.edges[times(&own, features)];
                matrix::multiply_by_transposed(edges_bar, first, &p[weight], (count, h, features), false);
            }
            let received = &mut bars.received[times(&since(layer.parts[k].start, &nodes), h)];
            layer.collect_received::<L>(nodes, first, received);
        }
    }
}

impl<R: Real> Operator<3> for Messages<R> {
    type Real = R;
    const NAME: &'static str = "messages";

    fn forward(&self, [nodes, edges, p]: [&[R]; 3], _: [&Shape; 3]) -> Result<(Vec<R>, Shape)> {
        let (layer, e, width) = (&self.layer, self.layer.graph.edges(), self.layer.shape.outputs);
        let projected = &layer.project(nodes, p);
        let mut activations = Activations::new(&layer.memory, &layer.shape, e);
        let mut out = vec![R::default(); e * width];
        let parts = activations.parts(&layer.edge_parts).into_iter().zip(cut(&mut out, &layer.edge_parts, width));
        run_parts(&Forward { op: self, edges, p, projected }, parts);
        *self.activations.lock().unwrap_or_else(PoisonError::into_inner) = Some(activations);
        Ok((out, (e, width).into()))
    }

    fn adjoint(
        &self,
        [nodes, edges, p]: [&[R]; 3],
        _: &[R],
        out_bar: &[R],
        // What an edge has are data more often than not.
        [_, wants_edges, _]: [bool; 3],
    ) -> Result<[Option<Vec<R>>; 3]> {
        let activations = self.activations.lock().unwrap_or_else(PoisonError::into_inner);
        let Some(activations) = activations.as_ref() else {
            candle_core::bail!("messages: the gradient was asked for without a forward pass")
        };
        let (layer, h, length) = (&self.layer, self.layer.shape.hidden, self.layer.shape.parameters());
        let (n, e) = (layer.graph.nodes(), layer.graph.edges());
        let width = if wants_edges { self.features() } else { 0 };
        let mut edges_bar = vec![R::default(); e * width];
        let [mut first_bar, mut received_bar, mut parts_bar] =
            [e * h, n * h, layer.parts.len() * length].map(|length| layer.memory.buffer(length));
        let mut of_edges = cut(&mut edges_bar, &layer.edge_parts, width).into_iter();
        let mut first = cut(&mut first_bar, &layer.edge_parts, h).into_iter();
        let mut received = cut(&mut received_bar, &layer.parts, h).into_iter();
        let bars = parts_bar
            .chunks_exact_mut(length)
            .map_while(|p| Some(Bars { edges: of_edges.next()?, first: first.next()?, received: received.next()?, p }));
        run_parts(&Backward { op: self, edges, p, activations, out_bar }, bars);
        let mut nodes_bar = vec![R::default(); nodes.len()];
        layer.collect((nodes, p), (&first_bar, &received_bar), &mut nodes_bar, &mut parts_bar);
        let mut p_bar = vec![R::default(); p.len()];
        mlp::sum_of_parts(&mut p_bar, &parts_bar);
        Ok([Some(nodes_bar), wants_edges.then_some(edges_bar), Some(p_bar)])
    }
}
