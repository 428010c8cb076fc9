//! Sizes of a graph network and the shapes of its perceptrons.

use crate::io::tensor_file::TensorFile;
use crate::surrogate::network::interaction::{edge_shape, node_shape};
use crate::surrogate::network::mlp::MlpShape;

#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Sizes {
    /// Node features without the embedding.
    pub node_features: usize,
    /// Number of edge features, D + 1.
    pub edge_features: usize,
    pub outputs: usize,
    /// Width L of latent vectors and hidden layers.
    pub latent: usize,
    /// Number M of rounds.
    pub rounds: usize,
    /// Linear layers of each perceptron.
    pub linears: usize,
    /// Size of the embedding of the particle type.
    pub embedding: usize,
}

impl Sizes {
    /// The first size that needs more values than a file has, to be checked before memory is allocated.
    pub fn beyond(&self, file: &TensorFile) -> Option<String> {
        let numbers: usize = file.tensors.values().map(|(_, data)| data.count()).sum();
        let Self { node_features, edge_features, outputs, latent, rounds, linears, embedding } = *self;
        let needed = [
            ("latent", latent, latent),
            ("rounds", rounds, latent.saturating_mul(latent)),
            ("linears", linears, latent.saturating_mul(latent)),
            ("embedding", embedding, latent),
            ("node_features", node_features, latent),
            ("edge_features", edge_features, latent),
            ("outputs", outputs, latent),
        ];
        let found = needed.into_iter().find(|(_, size, each)| size.saturating_mul(*each) > numbers);
        found.map(|(name, size, _)| format!("{name} = {size}, but the file has {numbers} numbers in all"))
    }
}

impl Sizes {
    fn encoder(&self, inputs: usize) -> MlpShape {
        MlpShape { inputs, hidden: self.latent, outputs: self.latent, linears: self.linears, norm: true }
    }

    /// The perceptron that encodes nodes.
    pub fn node_encoder(&self) -> MlpShape {
        self.encoder(self.node_features + self.embedding)
    }

    /// The perceptron that encodes edges.
    pub fn edge_encoder(&self) -> MlpShape {
        self.encoder(self.edge_features)
    }

    /// The perceptrons of a round, for edges and for nodes.
    pub fn round(&self) -> (MlpShape, MlpShape) {
        let Self { latent, linears, .. } = *self;
        (edge_shape(latent, latent, linears), node_shape(latent, latent, linears))
    }

    /// The perceptron that computes the output from the nodes.
    pub fn decoder(&self) -> MlpShape {
        MlpShape { outputs: self.outputs, norm: false, ..self.encoder(self.latent) }
    }
}
