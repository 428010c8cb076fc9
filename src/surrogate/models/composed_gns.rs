//! The graph network simulator of [`crate::surrogate::models::gns`] from candle-nn's layers.

use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::graph::Ends;
use crate::surrogate::network::layers::{embedded, Perceptron, Round};
use crate::surrogate::network::mlp::MlpShape;
use candle_core::{Result, Tensor};
use candle_nn::{embedding, Module, VarBuilder};

/// Encoder, M rounds of message passing and decoder by candle only, on any device: as
/// [`crate::surrogate::network::parameters::Network::apply`], `[N, outputs]`.
///
/// Names and shapes of the tensors are those in a checkpoint after `param.`, so a checkpoint can be opened without
/// hydrograd: `VarBuilder::from_buffered_safetensors(bytes, ..)?.pp("param")`.
pub fn composed_gns(sizes: &Sizes, builder: &VarBuilder, inputs: &Inputs) -> Result<Tensor> {
    let apply = |name: &str, shape: MlpShape, x: &Tensor| Perceptron::new(&shape, builder.pp(name))?.forward(x);
    let ends = Ends::new(&inputs.graph, inputs.nodes.device())?;
    let embedded = embedded(&embedding(KINDS, sizes.embedding, builder.pp("embed"))?, &inputs.kinds)?;
    let mut nodes = apply("enc.node", sizes.node_encoder(), &Tensor::cat(&[&inputs.nodes, &embedded], 1)?)?;
    let mut edges = apply("enc.edge", sizes.edge_encoder(), &inputs.edges)?;
    let (edge, node) = sizes.round();
    for k in 0..sizes.rounds {
        let round = Round::new(&edge, &node, builder.pp("proc").pp(k))?;
        (nodes, edges) = round.forward(&ends, &nodes, &edges)?;
    }
    apply("dec", sizes.decoder(), &nodes)
}
