//! The parts of networks built from candle-nn's layers, which run on every device of candle. They are slow and
//! readable, and the reference for the fused operators.

use crate::numerics::gather::Gather;
use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::network::graph::Ends;
use crate::surrogate::network::mlp::{MlpShape, EPSILON};
use crate::surrogate::network::parameters::Parameter;
use candle_core::{Device, Result, Tensor};
use candle_nn::{Embedding, LayerNorm, Linear, Module, VarBuilder};
use std::collections::HashMap;

/// The parts of `parameters` by their names in a checkpoint, with the values `values`, in the form that candle-nn's
/// layers need. The tensors are views, so their gradients reach `values`.
pub fn builder(parameters: &[Parameter], values: &[Tensor]) -> Result<VarBuilder<'static>> {
    let mut tensors = HashMap::new();
    for (parameter, values) in parameters.iter().zip(values) {
        for (name, at, shape) in &parameter.parts {
            let part = values.narrow(0, at.start, at.len())?.reshape(shape.as_slice())?;
            tensors.insert(name.clone(), part);
        }
    }
    let Some(first) = values.first() else { candle_core::bail!("a network without parameters") };
    Ok(VarBuilder::from_tensors(tensors, first.dtype(), first.device()))
}

/// Applies a network on a device and returns its output to the device of the inputs; gradients go the same way. The
/// graph and the types of the particles are not moved.
pub fn on_device(
    device: &Device,
    inputs: &Inputs,
    parameters: &[Tensor],
    network: impl FnOnce(&Inputs, &[Tensor]) -> Result<Tensor>,
) -> Result<Tensor> {
    let here = inputs.nodes.device();
    if device.same_device(here) {
        return network(inputs, parameters);
    }
    let there = |tensor: &Tensor| tensor.to_device(device);
    let inputs = Inputs {
        nodes: there(&inputs.nodes)?,
        edges: there(&inputs.edges)?,
        velocity: there(&inputs.velocity)?,
        ..inputs.clone()
    };
    let parameters = parameters.iter().map(there).collect::<Result<Vec<_>>>()?;
    network(&inputs, &parameters)?.to_device(here)
}

/// Rows of an embedding by the particles' types, `[N, columns]`. The embedding may be on another device.
pub fn embedded(embedding: &Embedding, kinds: &Tensor) -> Result<Tensor> {
    let table = embedding.embeddings();
    match table.device().is_cpu() {
        true => embedding.forward(kinds),
        false => Gather::new(&kinds.to_vec1::<u32>()?, KINDS, table.device())?.rows(table, 0),
    }
}

/// A multilayer perceptron, see [`crate::surrogate::network::mlp`]: `[rows, inputs]` -> `[rows, outputs]`.
#[derive(Debug, Clone)]
pub struct Perceptron {
    linears: Vec<Linear>,
    /// Layer norm, and its offset apart: with both, candle-nn would use a fused operator that silently ends the
    /// gradient.
    norm: Option<(LayerNorm, Tensor)>,
}

impl Perceptron {
    /// Builds the layers from the tensors `K.weight`, `K.bias`, `ln.scale` and `ln.offset`.
    pub fn new(shape: &MlpShape, builder: VarBuilder) -> Result<Self> {
        let linear = |k: usize| {
            let (builder, (inputs, outputs)) = (builder.pp(k), shape.size(k));
            // Weights are stored as [in, out], the transpose of candle-nn's.
            let weight = builder.get((inputs, outputs), "weight")?.t()?;
            Ok(Linear::new(weight, Some(builder.get(outputs, "bias")?)))
        };
        let norm = |builder: VarBuilder| -> Result<(LayerNorm, Tensor)> {
            let scale = LayerNorm::new_no_bias(builder.get(shape.outputs, "scale")?, EPSILON);
            Ok((scale, builder.get(shape.outputs, "offset")?))
        };
        Ok(Self {
            linears: (0..shape.linears).map(linear).collect::<Result<_>>()?,
            norm: shape.norm.then(|| norm(builder.pp("ln"))).transpose()?,
        })
    }
}

/// max(x, 0) with slope 0 at 0, as in the fused operator and JAX. Candle's own has slope 1 there, and the edge of a
/// particle to itself, whose features are 0, is at the kink while the biases are 0.
fn relu(x: &Tensor) -> Result<Tensor> {
    x * x.detach().gt(0.0)?.to_dtype(x.dtype())?
}

impl Module for Perceptron {
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let mut y = x.clone();
        for (k, linear) in self.linears.iter().enumerate() {
            if k > 0 {
                y = relu(&y)?;
            }
            y = linear.forward(&y)?;
        }
        match &self.norm {
            Some((scale, offset)) => scale.forward(&y)?.broadcast_add(offset),
            None => Ok(y),
        }
    }
}

/// A round of message passing, see [`crate::surrogate::network::interaction`].
#[derive(Debug, Clone)]
pub struct Round {
    edges: Perceptron,
    nodes: Perceptron,
}

impl Round {
    /// Builds the round from the tensors `edge.*` and `node.*`.
    pub fn new(edge: &MlpShape, node: &MlpShape, builder: VarBuilder) -> Result<Self> {
        Ok(Self {
            edges: Perceptron::new(edge, builder.pp("edge"))?,
            nodes: Perceptron::new(node, builder.pp("node"))?,
        })
    }

    /// Nodes `[N, L]` and edges `[E, L]` -> nodes and edges after the round.
    pub fn forward(&self, ends: &Ends, nodes: &Tensor, edges: &Tensor) -> Result<(Tensor, Tensor)> {
        let inputs = Tensor::cat(&[&ends.of_senders(nodes)?, &ends.of_receivers(nodes)?, edges], 1)?;
        let messages = self.edges.forward(&inputs)?;
        let change = self.nodes.forward(&Tensor::cat(&[nodes, &ends.sums(&messages)?], 1)?)?;
        Ok(((nodes + change)?, (edges + messages)?))
    }
}
