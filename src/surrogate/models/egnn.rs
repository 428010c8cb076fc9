//! E(n)-equivariant graph network (Satorras, Hoogeboom and Welling 2021), the second model.
//!
//! Scalars h_i of each particle and a vector x_i (its acceleration so far) go through M rounds:
//! m_ij = MLP([h_j, h_i, |r_ij|/r_c]), h_i' = h_i + MLP([h_i, sum_j m_ij]),
//! x_i' = x_i + sum_j r_ij/r_c w(m_ij) + sum_k v_ik u_k(h_i'), with velocities v_ik of the window, where w and u_k are
//! perceptrons. All equivariant terms are vectors times functions of invariants, so a rotated or mirrored flow gives
//! the rotated or mirrored output. Invariant inputs are speeds, the features of heat, boundary distances (with which
//! the model is equivariant only as far as the box is) and the embedding of the type.

use crate::config::device::Compute;
use crate::config::scene::Kernels;
use crate::numerics::candle::{apply2, apply3};
use crate::numerics::lanes::Real;
use crate::numerics::pool::Buffers;
use crate::numerics::random::stream;
use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::graph::{Ends, Graph};
use crate::surrogate::network::layers::{builder, embedded, on_device, Perceptron};
use crate::surrogate::network::messages::Messages;
use crate::surrogate::network::mlp::{Mlp, MlpShape};
use crate::surrogate::network::parameters::{Network, Parameter};
use candle_core::{DType, Result, Tensor};
use candle_nn::{embedding, Module, VarBuilder};
use std::sync::Arc;

pub struct Egnn {
    sizes: Sizes,
    /// Number of velocities, W - 1.
    velocities: usize,
    dtype: DType,
    compute: Compute,
    /// Parameters: embedding, encoder, (messages, nodes, edge vectors, velocities) of each round, decoder of scalars if
    /// any.
    parameters: Vec<Parameter>,
    single: Buffers<f32>,
    double: Buffers<f64>,
}

/// What the network is made of.
trait Parts {
    /// The table of the types' embeddings, one row for each particle.
    fn embedded(&self, kinds: &Tensor) -> Result<Tensor>;
    fn perceptron(&self, part: Part, shape: MlpShape, x: &Tensor) -> Result<Tensor>;
    /// MLP([h_j, h_i, length]) of each edge.
    fn messages(&self, part: Part, shape: MlpShape, h: &Tensor, length: &Tensor) -> Result<Tensor>;
}

/// Whose parameters.
#[derive(Clone, Copy)]
enum Part {
    Encoder,
    /// Of a round: messages, nodes, edge vectors, velocities.
    Round(usize, Role),
    Decoder,
}

#[derive(Clone, Copy)]
enum Role {
    Messages,
    Nodes,
    Pull,
    Drift,
}

impl Part {
    fn name(self) -> String {
        match self {
            Self::Encoder => "enc.node".into(),
            Self::Round(k, role) => format!("proc.{k}.{}", ["edge", "node", "pull", "drift"][role as usize]),
            Self::Decoder => "dec".into(),
        }
    }

    /// Where they stand among those of a network of so many rounds.
    fn place(self, rounds: usize) -> usize {
        match self {
            Self::Encoder => 1,
            Self::Round(k, role) => 2 + 4 * k + role as usize,
            Self::Decoder => 2 + 4 * rounds,
        }
    }
}

/// Of candle-nn's layers.
struct Composed<'a> {
    embedding: usize,
    builder: VarBuilder<'static>,
    ends: &'a Ends,
}

impl Parts for Composed<'_> {
    fn embedded(&self, kinds: &Tensor) -> Result<Tensor> {
        embedded(&embedding(KINDS, self.embedding, self.builder.pp("embed"))?, kinds)
    }

    fn perceptron(&self, part: Part, shape: MlpShape, x: &Tensor) -> Result<Tensor> {
        Perceptron::new(&shape, self.builder.pp(part.name()))?.forward(x)
    }

    fn messages(&self, part: Part, shape: MlpShape, h: &Tensor, length: &Tensor) -> Result<Tensor> {
        let pairs = Tensor::cat(&[&self.ends.of_senders(h)?, &self.ends.of_receivers(h)?, length], 1)?;
        self.perceptron(part, shape, &pairs)
    }
}

/// Of fused operators.
struct Fused<'a, R: Real> {
    sizes: &'a Sizes,
    graph: &'a Arc<Graph>,
    parameters: &'a [Tensor],
    memory: &'a Buffers<R>,
}

impl<R: Real> Parts for Fused<'_, R> {
    fn embedded(&self, kinds: &Tensor) -> Result<Tensor> {
        self.parameters[0].reshape((KINDS, self.sizes.embedding))?.index_select(kinds, 0)
    }

    fn perceptron(&self, part: Part, shape: MlpShape, x: &Tensor) -> Result<Tensor> {
        apply2(Mlp::<R>::new(shape, self.memory), x, &self.parameters[part.place(self.sizes.rounds)])
    }

    fn messages(&self, part: Part, shape: MlpShape, h: &Tensor, length: &Tensor) -> Result<Tensor> {
        let messages = Messages::<R>::new(self.graph, self.sizes.latent, shape, self.memory);
        apply3(messages, h, length, &self.parameters[part.place(self.sizes.rounds)])
    }
}

impl Egnn {
    /// A new network from a seed. Its parameters do not depend on `compute` and stay on the CPU.
    pub fn new(sizes: Sizes, frames: usize, compute: impl Into<Compute>, seed: u64, dtype: DType) -> Result<Self> {
        let mut rng = stream(seed, "weights");
        let (compute, single, double) = (compute.into(), Buffers::default(), Buffers::default());
        let network = Self { sizes, velocities: frames - 1, dtype, compute, parameters: Vec::new(), single, double };
        let mut parameters = vec![Parameter::table("embed.weight", KINDS, sizes.embedding, &mut rng, dtype)?];
        let mut add = |part: Part, shape: MlpShape| -> Result<()> {
            debug_assert_eq!(parameters.len(), part.place(sizes.rounds));
            parameters.push(Parameter::perceptron(&part.name(), &shape, &mut rng, dtype)?);
            Ok(())
        };
        add(Part::Encoder, network.encoder())?;
        for k in 0..sizes.rounds {
            add(Part::Round(k, Role::Messages), network.messages())?;
            add(Part::Round(k, Role::Nodes), network.nodes())?;
            add(Part::Round(k, Role::Pull), network.head(1))?;
            add(Part::Round(k, Role::Drift), network.head(network.velocities))?;
        }
        if network.scalars() > 0 {
            add(Part::Decoder, network.head(network.scalars()))?;
        }
        Ok(Self { parameters, ..network })
    }

    /// Number of dimensions, D.
    fn dimension(&self) -> usize {
        self.sizes.edge_features - 1
    }

    /// Number of invariant outputs.
    fn scalars(&self) -> usize {
        self.sizes.outputs - self.dimension()
    }

    fn perceptron(&self, inputs: usize, outputs: usize, norm: bool) -> MlpShape {
        MlpShape { inputs, hidden: self.sizes.latent, outputs, linears: self.sizes.linears, norm }
    }

    fn encoder(&self) -> MlpShape {
        // The norms of the velocities replace the velocities among the node features.
        let steps = self.velocities;
        let invariant = self.sizes.node_features - steps * self.dimension() + steps;
        self.perceptron(invariant + self.sizes.embedding, self.sizes.latent, true)
    }

    fn messages(&self) -> MlpShape {
        self.perceptron(2 * self.sizes.latent + 1, self.sizes.latent, true)
    }

    fn nodes(&self) -> MlpShape {
        self.perceptron(2 * self.sizes.latent, self.sizes.latent, true)
    }

    fn head(&self, outputs: usize) -> MlpShape {
        self.perceptron(self.sizes.latent, outputs, false)
    }

    /// The invariant node features: speeds by the velocities `[N, W - 1, D]`, and those after the velocities.
    fn invariants(&self, inputs: &Inputs, velocities: &Tensor) -> Result<Vec<Tensor>> {
        // 1e-12 under the root makes it differentiable at rest.
        let mut invariants = vec![(velocities.sqr()?.sum(2)? + 1e-12)?.sqrt()?];
        let turning = self.velocities * self.dimension();
        if self.sizes.node_features > turning {
            invariants.push(inputs.nodes.narrow(1, turning, self.sizes.node_features - turning)?);
        }
        Ok(invariants)
    }

    fn run(&self, inputs: &Inputs, ends: &Ends, parts: &dyn Parts) -> Result<Tensor> {
        let (n, d, steps) = (inputs.graph.nodes(), self.dimension(), self.velocities);
        let velocities = inputs.nodes.narrow(1, 0, steps * d)?.reshape((n, steps, d))?;
        let (relative, length) = (inputs.edges.narrow(1, 0, d)?, inputs.edges.narrow(1, d, 1)?);

        let mut scalars = self.invariants(inputs, &velocities)?;
        scalars.push(parts.embedded(&inputs.kinds)?);
        let mut h = parts.perceptron(Part::Encoder, self.encoder(), &Tensor::cat(&scalars, 1)?)?;
        let mut x = Tensor::zeros((n, d), velocities.dtype(), velocities.device())?;
        for k in 0..self.sizes.rounds {
            let of = |role| Part::Round(k, role);
            let messages = parts.messages(of(Role::Messages), self.messages(), &h, &length)?;
            let given = Tensor::cat(&[&h, &ends.sums(&messages)?], 1)?;
            h = (&h + parts.perceptron(of(Role::Nodes), self.nodes(), &given)?)?;
            // w.
            let pull = parts.perceptron(of(Role::Pull), self.head(1), &messages)?;
            x = (x + ends.sums(&relative.broadcast_mul(&pull)?)?)?;
            // All u_k in one perceptron.
            let drift = parts.perceptron(of(Role::Drift), self.head(steps), &h)?.unsqueeze(2)?;
            x = (x + velocities.broadcast_mul(&drift)?.sum(1)?)?;
        }
        match self.scalars() {
            0 => Ok(x),
            scalars => Tensor::cat(&[x, parts.perceptron(Part::Decoder, self.head(scalars), &h)?], 1),
        }
    }

    fn fused<R: Real>(&self, inputs: &Inputs, parameters: &[Tensor], memory: &Buffers<R>) -> Result<Tensor> {
        let ends = Ends::new(&inputs.graph, inputs.nodes.device())?;
        self.run(inputs, &ends, &Fused { sizes: &self.sizes, graph: &inputs.graph, parameters, memory })
    }

    fn composed(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor> {
        let ends = Ends::new(&inputs.graph, inputs.nodes.device())?;
        let builder = builder(&self.parameters, parameters)?;
        self.run(inputs, &ends, &Composed { embedding: self.sizes.embedding, builder, ends: &ends })
    }
}

impl Network for Egnn {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn apply(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor> {
        match (self.compute.kernels(), self.dtype) {
            (Kernels::Fused, DType::F32) => self.fused(inputs, parameters, &self.single),
            (Kernels::Fused, _) => self.fused(inputs, parameters, &self.double),
            (Kernels::Composed, _) => on_device(self.compute.device(), inputs, parameters, |inputs, parameters| {
                self.composed(inputs, parameters)
            }),
        }
    }
}
