//! Graph network simulator (Sanchez-Gonzalez et al. 2020) as in LagrangeBench: encoder, M rounds of messages, decoder.

use crate::config::device::Compute;
use crate::config::scene::Kernels;
use crate::numerics::candle::{apply2, apply3};
use crate::numerics::lanes::Real;
use crate::numerics::pool::Buffers;
use crate::numerics::random::stream;
use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::models::composed_gns::composed_gns;
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::interaction::{Rounds, Trace};
use crate::surrogate::network::layers::{builder, on_device};
use crate::surrogate::network::mlp::{Mlp, MlpShape};
use crate::surrogate::network::parameters::{Network, Parameter};
use candle_core::{DType, Result, Tensor};

pub struct Gns {
    pub sizes: Sizes,
    dtype: DType,
    compute: Compute,
    /// Parameters: embedding, encoder of nodes, encoder of edges, all rounds (edges, nodes of each), decoder.
    parameters: Vec<Parameter>,
    single: Buffers<f32>,
    double: Buffers<f64>,
}

impl Gns {
    /// A new network from a seed. Its parameters do not depend on `compute` and stay on the CPU.
    pub fn new(sizes: Sizes, compute: impl Into<Compute>, seed: u64, dtype: DType) -> Result<Self> {
        let mut rng = stream(seed, "weights");
        let mut parameters = vec![Parameter::table("embed.weight", KINDS, sizes.embedding, &mut rng, dtype)?];
        let mut add = |shapes: Vec<(String, MlpShape)>| -> Result<()> {
            parameters.push(Parameter::perceptrons(&shapes, &mut rng, dtype)?);
            Ok(())
        };
        let round = |k: usize| {
            let (edge, node) = sizes.round();
            [(format!("proc.{k}.edge"), edge), (format!("proc.{k}.node"), node)]
        };
        add(vec![("enc.node".into(), sizes.node_encoder())])?;
        add(vec![("enc.edge".into(), sizes.edge_encoder())])?;
        add((0..sizes.rounds).flat_map(round).collect())?;
        add(vec![("dec".into(), sizes.decoder())])?;
        let (compute, single, double) = (compute.into(), Buffers::default(), Buffers::default());
        Ok(Self { sizes, dtype, compute, parameters, single, double })
    }

    fn run<R: Real>(&self, inputs: &Inputs, p: &[Tensor], memory: &Buffers<R>, trace: Option<Trace>) -> Result<Tensor> {
        let s = &self.sizes;
        let embedded = p[0].reshape((KINDS, s.embedding))?.index_select(&inputs.kinds, 0)?;
        let nodes = Tensor::cat(&[&inputs.nodes, &embedded], 1)?;
        let nodes = apply2(Mlp::<R>::new(s.node_encoder(), memory), &nodes, &p[1])?;
        let edges = apply2(Mlp::<R>::new(s.edge_encoder(), memory), &inputs.edges, &p[2])?;
        if let Some(trace) = &trace {
            trace.lock().unwrap_or_else(|e| e.into_inner()).push(Tensor::cat(&[&nodes, &edges], 0)?.detach());
        }
        let keeps = [&nodes, &edges, &p[3]].iter().any(|t| t.track_op());
        let rounds = Rounds::<R>::new(&inputs.graph, (s.latent, s.latent, s.linears), s.rounds, keeps, memory, trace);
        let nodes = apply3(rounds, &nodes, &edges, &p[3])?;
        apply2(Mlp::<R>::new(s.decoder(), memory), &nodes, &p[4])
    }

    /// As [`Network::apply`] by the fused operators, with the states `[N + E, L]` after the encoder and each round.
    pub fn apply_traced(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<(Tensor, Vec<Tensor>)> {
        let trace = Trace::default();
        let out = self.apply_with(inputs, parameters, Some(trace.clone()))?;
        let states = std::mem::take(&mut *trace.lock().unwrap_or_else(|e| e.into_inner()));
        Ok((out, states))
    }

    fn apply_with(&self, inputs: &Inputs, parameters: &[Tensor], trace: Option<Trace>) -> Result<Tensor> {
        match self.dtype {
            DType::F32 => self.run(inputs, parameters, &self.single, trace),
            _ => self.run(inputs, parameters, &self.double, trace),
        }
    }
}

impl Network for Gns {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn apply(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor> {
        match self.compute.kernels() {
            Kernels::Fused => self.apply_with(inputs, parameters, None),
            Kernels::Composed => on_device(self.compute.device(), inputs, parameters, |inputs, parameters| {
                composed_gns(&self.sizes, &builder(&self.parameters, parameters)?, inputs)
            }),
        }
    }
}
