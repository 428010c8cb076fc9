//! E(n)-equivariant graph network (Satorras, Hoogeboom and Welling 2021), the second model.
//!
//! Scalars h_i of each particle and a vector x_i (its acceleration so far) go through M rounds:
//! m_ij = MLP([h_j, h_i, |r_ij|/r_c]), h_i' = h_i + MLP([h_i, sum_j m_ij]),
//! x_i' = x_i + sum_j r_ij/r_c w(m_ij) + sum_k v_ik u_k(h_i'), with velocities v_ik of the window; w and u_k are
//! perceptrons. All that turns with the frame is a vector times a scalar of invariants, so a turned or mirrored
//! flow gives the turned output. Invariant inputs: speeds, the heat's features, boundary distances (which know the
//! box: with them the model is equivariant only as far as the box is), the embedding of the type.

use crate::numerics::random::stream;
use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::models::gns::Sizes;
use crate::surrogate::network::composed;
use crate::surrogate::network::gather::{gather, segment_sum, End};
use crate::surrogate::network::mlp::MlpShape;
use crate::surrogate::network::parameters::{Network, Parameter};
use candle_core::{DType, Result, Tensor};

pub struct Egnn {
    sizes: Sizes,
    /// W - 1.
    velocities: usize,
    /// Embedding, encoder, (messages, nodes, edge vectors, velocities) of each round, decoder of the scalars if any.
    parameters: Vec<Parameter>,
}

impl Egnn {
    /// A new network from a seed.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn new(sizes: Sizes, frames: usize, seed: u64, dtype: DType) -> Result<Self> {
        let mut rng = stream(seed, "weights");
        let network = Self { sizes, velocities: frames - 1, parameters: Vec::new() };
        let mut parameters = vec![Parameter::table("embed.weight", KINDS, sizes.embedding, &mut rng, dtype)?];
        let mut add = |name: String, shape: MlpShape| -> Result<()> {
            parameters.push(Parameter::perceptron(&name, &shape, &mut rng, dtype)?);
            Ok(())
        };
        add("enc.node".into(), network.encoder())?;
        for k in 0..sizes.rounds {
            add(format!("proc.{k}.edge"), network.messages())?;
            add(format!("proc.{k}.node"), network.nodes())?;
            add(format!("proc.{k}.pull"), network.head(1))?;
            add(format!("proc.{k}.drift"), network.head(network.velocities))?;
        }
        if network.scalars() > 0 {
            add("dec".into(), network.head(network.scalars()))?;
        }
        Ok(Self { parameters, ..network })
    }

    /// D.
    fn dimension(&self) -> usize {
        self.sizes.edge_features - 1
    }

    /// Outputs that do not turn with the frame.
    fn scalars(&self) -> usize {
        self.sizes.outputs - self.dimension()
    }

    fn perceptron(&self, inputs: usize, outputs: usize, norm: bool) -> MlpShape {
        MlpShape { inputs, hidden: self.sizes.latent, outputs, linears: self.sizes.linears, norm }
    }

    fn encoder(&self) -> MlpShape {
        // Of the node features the velocities are replaced by their norms.
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
}

impl Network for Egnn {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn apply(&self, inputs: &Inputs, p: &[Tensor]) -> Result<Tensor> {
        let (s, d, graph) = (&self.sizes, self.dimension(), &inputs.graph);
        let velocity = |k: usize| inputs.nodes.narrow(1, k * d, d);
        let mut scalars = Vec::new();
        for k in 0..self.velocities {
            // 1e-12 under the root: a derivative at rest.
            scalars.push((velocity(k)?.sqr()?.sum_keepdim(1)? + 1e-12)?.sqrt()?);
        }
        let others = self.velocities * d;
        if s.node_features > others {
            scalars.push(inputs.nodes.narrow(1, others, s.node_features - others)?);
        }
        scalars.push(p[0].reshape((KINDS, s.embedding))?.index_select(&inputs.kinds, 0)?);
        let mut h = composed::mlp(&self.encoder(), &Tensor::cat(&scalars, 1)?, &p[1])?;
        let (relative, length) = (inputs.edges.narrow(1, 0, d)?, inputs.edges.narrow(1, d, 1)?);
        let mut x = velocity(0)?.zeros_like()?;
        for k in 0..s.rounds {
            let p = &p[2 + 4 * k..6 + 4 * k];
            let ends = [gather(&h, graph, End::Sender)?, gather(&h, graph, End::Receiver)?, length.contiguous()?];
            let messages = composed::mlp(&self.messages(), &Tensor::cat(&ends, 1)?, &p[0])?;
            let sums = segment_sum(&messages, graph, End::Receiver)?;
            h = (&h + composed::mlp(&self.nodes(), &Tensor::cat(&[&h, &sums], 1)?, &p[1])?)?;
            let pull = relative.broadcast_mul(&composed::mlp(&self.head(1), &messages, &p[2])?)?;
            x = (x + segment_sum(&pull, graph, End::Receiver)?)?;
            let drift = composed::mlp(&self.head(self.velocities), &h, &p[3])?;
            for k in 0..self.velocities {
                x = (x + velocity(k)?.broadcast_mul(&drift.narrow(1, k, 1)?)?)?;
            }
        }
        if self.scalars() == 0 {
            return Ok(x);
        }
        let scalars = composed::mlp(&self.head(self.scalars()), &h, &p[2 + 4 * s.rounds])?;
        Tensor::cat(&[x, scalars], 1)
    }
}
