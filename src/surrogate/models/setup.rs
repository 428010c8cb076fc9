//! The data of a trained model besides its parameters (sizes, features, normalisation), which its checkpoint contains.

use crate::config::device::Compute;
use crate::config::scene::Config;
use crate::config::training::{HeatModel, Kind, Settings};
use crate::dataset::store::CONFIGURATION;
use crate::dataset::{Heat, Metadata};
use crate::error::BadInput;
use crate::surrogate::features::{Features, Normalisation};
use crate::surrogate::models::egnn::Egnn;
use crate::surrogate::models::gns::Gns;
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::network::parameters::Network;
use candle_core::DType;
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    pub kind: Kind,
    pub sizes: Sizes,
    pub features: Features,
    pub normalisation: Normalisation,
    pub heat: HeatModel,
    /// Periodic directions of the box, on which the features depend.
    pub periodic: Vec<bool>,
    /// Particle spacing and time between frames of the data; unknown for foreign models.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub spacing: Option<f64>,
    #[serde(rename = "frame", default, skip_serializing_if = "Option::is_none")]
    pub frame_time: Option<f64>,
    /// Metadata of the training data; unknown for foreign models and for those before version 0.2.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub data: Option<Metadata>,
}

impl Setup {
    /// The setup for training on a data set.
    ///
    /// # Errors
    /// Settings that do not fit the data.
    pub fn new(settings: &Settings, metadata: &Metadata) -> Result<Self, BadInput> {
        let model = &settings.model;
        let heat: Option<&Heat> = metadata.heat.as_ref().filter(|_| model.heat != HeatModel::None);
        if model.heat == HeatModel::Conduction && heat.is_none() {
            return Err(BadInput::new("model.heat = \"conduction\", but the data have no temperature")
                .allowed("data made by `hydrograd generate` from a scene with heat")
                .advice("model.heat=none"));
        }
        if settings.features.force && metadata.external_force().is_none() {
            return Err(BadInput::new("features.force = true, but the data have no external force")
                .key("features.force")
                .allowed("data of reverse-poiseuille or dam-break, with `case` and `g_ext_magnitude` in metadata.json")
                .advice("features.force=false"));
        }
        let radius = model.radius.map_or(metadata.default_connectivity_radius, |r| r * metadata.dx);
        // Conduction is computed, so the network does not need temperatures.
        let seen = heat.filter(|_| model.heat == HeatModel::Learned);
        let sizes = Sizes {
            node_features: settings.features.count(metadata, seen.is_some(), 0),
            edge_features: metadata.dim + 1,
            outputs: metadata.dim + usize::from(seen.is_some()),
            latent: model.latent,
            rounds: model.rounds,
            linears: model.linears,
            embedding: model.embedding,
        };
        let mut normalisation = Normalisation::new(metadata, settings.noise, radius, seen);
        if model.kind == Kind::Egnn {
            normalisation.make_isotropic();
        }
        Ok(Self {
            kind: model.kind,
            sizes,
            features: settings.features,
            normalisation,
            heat: if heat.is_some() { model.heat } else { HeatModel::None },
            periodic: metadata.periodic()[..metadata.dim].to_vec(),
            spacing: Some(metadata.dx),
            frame_time: Some(metadata.dt * metadata.write_every as f64),
            data: Some(metadata.clone()),
        })
    }

    /// The configuration of the scene that the training data are of, if it is known.
    pub fn data_config(&self) -> Option<Config> {
        Config::from_record(self.data.as_ref()?.other.get(CONFIGURATION)?.as_str()?).ok()
    }

    /// A network of these sizes.
    pub fn network(
        &self,
        compute: impl Into<Compute>,
        seed: u64,
        dtype: DType,
    ) -> candle_core::Result<Box<dyn Network>> {
        let (sizes, compute) = (self.sizes, compute.into());
        Ok(match self.kind {
            Kind::Gns => Box::new(Gns::new(sizes, compute, seed, dtype)?),
            Kind::Egnn => Box::new(Egnn::new(sizes, self.features.frames, compute, seed, dtype)?),
        })
    }

    /// How a data set differs from the model's data in spacing and time between frames, which no network can notice.
    pub fn unlike(&self, metadata: &Metadata) -> Option<String> {
        let frame = metadata.dt * metadata.write_every as f64;
        let pairs = [("a spacing of", self.spacing, metadata.dx), ("frames apart by", self.frame_time, frame)];
        let differing: Vec<String> = pairs
            .into_iter()
            .filter_map(|(what, known, here)| {
                let known = known?;
                ((known / here - 1.0).abs() > 0.01).then(|| format!("{what} {known:.4}, these have {here:.4}"))
            })
            .collect();
        (!differing.is_empty()).then(|| format!("the model was trained on data with {}", differing.join("; ")))
    }

    /// Checks that the frames of a data set fit the model.
    pub fn fits(&self, metadata: &Metadata) -> Result<(), BadInput> {
        let periodic = &metadata.periodic()[..metadata.dim];
        if self.periodic != periodic {
            return Err(BadInput::new(format!(
                "the model was trained on data with periodic directions {:?}, these have {periodic:?}",
                self.periodic
            ))
            .allowed("data of the same dimension and boundaries"));
        }
        if self.heat != HeatModel::None && metadata.heat.is_none() {
            return Err(BadInput::new("the model wants temperatures, but the data have none")
                .allowed("data of a scene with heat")
                .advice("train with model.heat=none for such data"));
        }
        Ok(())
    }
}
