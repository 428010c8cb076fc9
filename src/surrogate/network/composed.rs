//! The perceptron and the round of messages from ordinary candle operators: slow and readable, the oracle of the fused
//! ones, and what further models are built from.

use crate::surrogate::network::gather::{gather, segment_sum, End};
use crate::surrogate::network::graph::Graph;
use crate::surrogate::network::layer_norm::layer_norm;
use crate::surrogate::network::mlp::{MlpShape, EPSILON};
use candle_core::{Result, Tensor};
use std::sync::Arc;

/// x `[rows, inputs]`, parameters `[P]` -> `[rows, outputs]`.
pub fn mlp(shape: &MlpShape, x: &Tensor, p: &Tensor) -> Result<Tensor> {
    let part = |range: std::ops::Range<usize>| p.narrow(0, range.start, range.len());
    let mut y = x.clone();
    for k in 0..shape.linears {
        let weight = part(shape.weight(k))?;
        let outputs = shape.bias(k).len();
        let weight = weight.reshape((weight.elem_count() / outputs, outputs))?;
        y = y.matmul(&weight)?.broadcast_add(&part(shape.bias(k))?)?;
        if k + 1 < shape.linears {
            y = y.relu()?;
        }
    }
    if shape.norm {
        y = layer_norm(&y, &part(shape.scale())?, &part(shape.offset())?, EPSILON)?;
    }
    Ok(y)
}

/// See [`crate::surrogate::network::interaction`]; nodes `[N, L]` and edges `[E, L]` -> the same.
pub fn interaction(
    graph: &Arc<Graph>,
    (edge, node): (&MlpShape, &MlpShape),
    (nodes, edges): (&Tensor, &Tensor),
    (edge_p, node_p): (&Tensor, &Tensor),
) -> Result<(Tensor, Tensor)> {
    let ends = [gather(nodes, graph, End::Sender)?, gather(nodes, graph, End::Receiver)?, edges.clone()];
    let messages = mlp(edge, &Tensor::cat(&ends, 1)?, edge_p)?;
    let sums = segment_sum(&messages, graph, End::Receiver)?;
    let change = mlp(node, &Tensor::cat(&[nodes, &sums], 1)?, node_p)?;
    Ok(((nodes + change)?, (edges + messages)?))
}
