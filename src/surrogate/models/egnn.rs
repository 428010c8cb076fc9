//! E(n)-equivariant graph network (Satorras, Hoogeboom and Welling 2021), the second model.
//!
//! Scalars h_i of each particle and a vector x_i (its acceleration so far) go through M rounds:
//! m_ij = MLP([h_j, h_i, |r_ij|/r_c]), h_i' = h_i + MLP([h_i, sum_j m_ij]),
//! x_i' = x_i + sum_j r_ij/r_c w(m_ij) + sum_k v_ik u_k(h_i'), with velocities v_ik of the window, where w and u_k are
//! perceptrons. All equivariant terms are vectors times functions of invariants, so a rotated or mirrored flow gives
//! the rotated or mirrored output. Invariant inputs are speeds, the features of heat, boundary distances (with which
//! the model is equivariant only as far as the box is) and the embedding of the type.

use crate::numerics::random::stream;
use crate::surrogate::features::{Inputs, KINDS};
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::graph::Ends;
use crate::surrogate::network::layers::{builder, embedded, on_device, Perceptron};
use crate::surrogate::network::mlp::MlpShape;
use crate::surrogate::network::parameters::{Network, Parameter};
use candle_core::{DType, Device, Result, Tensor};
use candle_nn::{embedding, Module};

pub struct Egnn {
    sizes: Sizes,
    /// Number of velocities, W - 1.
    velocities: usize,
    device: Device,
    /// Parameters: embedding, encoder, (messages, nodes, edge vectors, velocities) of each round, decoder of scalars if
    /// any.
    parameters: Vec<Parameter>,
}

impl Egnn {
    /// A new network from a seed. Its parameters stay on the CPU.
    pub fn new(sizes: Sizes, frames: usize, seed: u64, dtype: DType) -> Result<Self> {
        let mut rng = stream(seed, "weights");
        let network = Self { sizes, velocities: frames - 1, device: Device::Cpu, parameters: Vec::new() };
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

    /// The same network, computed on a device.
    pub fn on(self, device: &Device) -> Self {
        Self { device: device.clone(), ..self }
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

    /// The invariant node features: speeds, and those after the velocities.
    fn invariants(&self, inputs: &Inputs, velocities: &[Tensor]) -> Result<Vec<Tensor>> {
        // 1e-12 under the root makes it differentiable at rest.
        let speed = |v: &Tensor| (v.sqr()?.sum_keepdim(1)? + 1e-12)?.sqrt();
        let mut invariants = velocities.iter().map(speed).collect::<Result<Vec<_>>>()?;
        let turning = self.velocities * self.dimension();
        if self.sizes.node_features > turning {
            invariants.push(inputs.nodes.narrow(1, turning, self.sizes.node_features - turning)?);
        }
        Ok(invariants)
    }

    fn apply_there(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor> {
        let builder = builder(&self.parameters, parameters)?;
        let apply = |name: &str, shape, x: &Tensor| Perceptron::new(&shape, builder.pp(name))?.forward(x);
        let ends = Ends::new(&inputs.graph, inputs.nodes.device())?;
        let d = self.dimension();
        let velocity = |k: usize| inputs.nodes.narrow(1, k * d, d);
        let velocities = (0..self.velocities).map(velocity).collect::<Result<Vec<_>>>()?;
        let (relative, length) = (inputs.edges.narrow(1, 0, d)?, inputs.edges.narrow(1, d, 1)?);

        let mut scalars = self.invariants(inputs, &velocities)?;
        scalars.push(embedded(&embedding(KINDS, self.sizes.embedding, builder.pp("embed"))?, &inputs.kinds)?);
        let mut h = apply("enc.node", self.encoder(), &Tensor::cat(&scalars, 1)?)?;
        let mut x = velocities[0].zeros_like()?;
        for k in 0..self.sizes.rounds {
            let apply = |part: &str, shape, x: &Tensor| apply(&format!("proc.{k}.{part}"), shape, x);
            let pairs = Tensor::cat(&[&ends.of_senders(&h)?, &ends.of_receivers(&h)?, &length], 1)?;
            let messages = apply("edge", self.messages(), &pairs)?;
            h = (&h + apply("node", self.nodes(), &Tensor::cat(&[&h, &ends.sums(&messages)?], 1)?)?)?;
            // w.
            let pull = apply("pull", self.head(1), &messages)?;
            x = (x + ends.sums(&relative.broadcast_mul(&pull)?)?)?;
            // All u_k in one perceptron.
            let drift = apply("drift", self.head(self.velocities), &h)?;
            for (k, velocity) in velocities.iter().enumerate() {
                x = (x + velocity.broadcast_mul(&drift.narrow(1, k, 1)?)?)?;
            }
        }
        match self.scalars() {
            0 => Ok(x),
            scalars => Tensor::cat(&[x, apply("dec", self.head(scalars), &h)?], 1),
        }
    }
}

impl Network for Egnn {
    fn parameters(&self) -> &[Parameter] {
        &self.parameters
    }

    fn apply(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor> {
        on_device(&self.device, inputs, parameters, |inputs, parameters| self.apply_there(inputs, parameters))
    }
}
