//! The graph network simulator of [`crate::surrogate::models::gns`] from candle-nn's layers.

use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::graph::Ends;
use crate::surrogate::network::layers::{embedded, Perceptron, Round};
use candle_core::{Result, Tensor};
use candle_nn::{embedding, Embedding, Module, VarBuilder};

/// Encoder, M rounds of message passing and decoder by candle only, on any device.
///
/// Names and shapes of the tensors are those in a checkpoint after `param.`, so a checkpoint can be opened without
/// hydrograd: `VarBuilder::from_buffered_safetensors(bytes, ..)?.pp("param")`.
#[derive(Debug, Clone)]
pub struct ComposedGns {
    embedding: Embedding,
    nodes: Perceptron,
    edges: Perceptron,
    rounds: Vec<Round>,
    decoder: Perceptron,
}

impl ComposedGns {
    /// Builds the network from named tensors.
    ///
    /// # Errors
    /// A tensor that is missing or of another shape.
    pub fn new(sizes: &Sizes, builder: VarBuilder) -> Result<Self> {
        let (edge, node) = sizes.round();
        let rounds = (0..sizes.rounds).map(|k| Round::new(&edge, &node, builder.pp("proc").pp(k)));
        Ok(Self {
            embedding: embedding(KINDS, sizes.embedding, builder.pp("embed"))?,
            nodes: Perceptron::new(&sizes.node_encoder(), builder.pp("enc.node"))?,
            edges: Perceptron::new(&sizes.edge_encoder(), builder.pp("enc.edge"))?,
            rounds: rounds.collect::<Result<_>>()?,
            decoder: Perceptron::new(&sizes.decoder(), builder.pp("dec"))?,
        })
    }

    /// As [`crate::surrogate::network::parameters::Network::apply`]: `[N, outputs]`.
    pub fn forward(&self, inputs: &Inputs) -> Result<Tensor> {
        let ends = Ends::new(&inputs.graph, inputs.nodes.device())?;
        let embedded = embedded(&self.embedding, &inputs.kinds)?;
        let mut nodes = self.nodes.forward(&Tensor::cat(&[&inputs.nodes, &embedded], 1)?)?;
        let mut edges = self.edges.forward(&inputs.edges)?;
        for round in &self.rounds {
            (nodes, edges) = round.forward(&ends, &nodes, &edges)?;
        }
        self.decoder.forward(&nodes)
    }
}
