//! Graph network simulator (Sanchez-Gonzalez et al. 2020), as LagrangeBench's: encoder, M rounds of messages, decoder.

use super::features::{Inputs, KINDS};
use super::graph::Graph;
use super::interaction::{edge_shape, node_shape, Interaction};
use super::memory::Memory;
use super::mlp::{Mlp, Shape};
use super::model::{Model, Parameter};
use crate::lanes::Real;
use crate::random::stream;
use candle_core::{DType, Result, Tensor};
use std::sync::Arc;

/// Sizes of a network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Sizes {
    /// Node features without the embedding.
    pub node_features: usize,
    /// D + 1.
    pub edge_features: usize,
    pub outputs: usize,
    /// L, also the width of hidden layers.
    pub latent: usize,
    /// M.
    pub rounds: usize,
    /// Linear layers of each perceptron.
    pub linears: usize,
    /// Columns of the embedding of the particle type.
    pub embedding: usize,
}

pub struct Gns {
    pub sizes: Sizes,
    dtype: DType,
    /// Embedding, encoder of nodes, encoder of edges, (edge, node) of each round, decoder.
    parameters: Vec<Parameter>,
    single: Memory<f32>,
    double: Memory<f64>,
}

impl Sizes {
    fn encoder(&self, inputs: usize) -> Shape {
        Shape { inputs, hidden: self.latent, outputs: self.latent, linears: self.linears, norm: true }
    }

    fn decoder(&self) -> Shape {
        Shape { outputs: self.outputs, norm: false, ..self.encoder(self.latent) }
    }
}

impl Gns {
    /// A new network from a seed.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn new(sizes: Sizes, seed: u64, dtype: DType) -> Result<Self> {
        let mut rng = stream(seed, "weights");
        let Sizes { node_features, edge_features, latent, linears, embedding, .. } = sizes;
        let mut parameters = vec![Parameter::table("embed.weight", KINDS, embedding, &mut rng, dtype)?];
        let mut add = |name: String, shape: Shape| -> Result<()> {
            parameters.push(Parameter::perceptron(&name, &shape, &mut rng, dtype)?);
            Ok(())
        };
        add("enc.node".into(), sizes.encoder(node_features + embedding))?;
        add("enc.edge".into(), sizes.encoder(edge_features))?;
        for k in 0..sizes.rounds {
            add(format!("proc.{k}.edge"), edge_shape(latent, latent, linears))?;
            add(format!("proc.{k}.node"), node_shape(latent, latent, linears))?;
        }
        add("dec".into(), sizes.decoder())?;
        Ok(Self { sizes, dtype, parameters, single: Memory::default(), double: Memory::default() })
    }

    fn run<R: Real>(&self, inputs: &Inputs, p: &[Tensor], memory: &Memory<R>, trace: &mut Trace) -> Result<Tensor> {
        let s = &self.sizes;
        let embedded = p[0].reshape((KINDS, s.embedding))?.index_select(&inputs.kinds, 0)?;
        let nodes = Tensor::cat(&[&inputs.nodes, &embedded], 1)?;
        let nodes = nodes.apply_op2(&p[1], Mlp::<R>::new(s.encoder(nodes.dim(1)?), memory))?;
        let edges = inputs.edges.apply_op2(&p[2], Mlp::<R>::new(s.encoder(s.edge_features), memory))?;
        let mut state = Tensor::cat(&[nodes, edges], 0)?;
        trace.push(&state);
        for k in 0..s.rounds {
            let last = k + 1 == s.rounds && trace.0.is_none();
            let round = interaction::<R>(&inputs.graph, s, last, memory);
            state = state.apply_op3(&p[3 + 2 * k], &p[4 + 2 * k], round)?;
            trace.push(&state);
        }
        let nodes = state.narrow(0, 0, inputs.graph.nodes())?;
        nodes.apply_op2(&p[3 + 2 * s.rounds], Mlp::<R>::new(s.decoder(), memory))
    }

    /// As [`Model::apply`], with the state `[N + E, L]` behind the encoder and behind each round.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn apply_traced(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<(Tensor, Vec<Tensor>)> {
        let mut trace = Trace(Some(Vec::new()));
        let out = self.apply_with(inputs, parameters, &mut trace)?;
        Ok((out, trace.0.unwrap_or_default()))
    }

    fn apply_with(&self, inputs: &Inputs, parameters: &[Tensor], trace: &mut Trace) -> Result<Tensor> {
        match self.dtype {
            DType::F32 => self.run(inputs, parameters, &self.single, trace),
            _ => self.run(inputs, parameters, &self.double, trace),
        }
    }
}

/// States on the way, if somebody asked for them.
struct Trace(Option<Vec<Tensor>>);

impl Trace {
    fn push(&mut self, state: &Tensor) {
        if let Some(states) = &mut self.0 {
            states.push(state.detach());
        }
    }
}

fn interaction<R: Real>(graph: &Arc<Graph>, s: &Sizes, last: bool, memory: &Memory<R>) -> Interaction<R> {
    Interaction::new(graph, (s.latent, s.latent, s.linears), last, memory)
}

impl Model for Gns {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn apply(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor> {
        self.apply_with(inputs, parameters, &mut Trace(None))
    }
}
