//! Loads models by name or file.

use crate::config::device::Compute;
use crate::config::training::{HeatModel, Kind};
use crate::dataset::Metadata;
use crate::error::BadInput;
use crate::io::tensor_file::TensorFile;
use crate::surrogate::features::{Features, Normalisation};
use crate::surrogate::models::baselines::{ConstantVelocity, Still};
use crate::surrogate::models::learned::Learned;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::models::sizes::Sizes;
use crate::surrogate::predictor::Predictor;
use crate::surrogate::training::checkpoint;
use candle_core::DType;
use std::path::Path;
use std::sync::Arc;

const ALLOWED: &str =
    "a .safetensors file written by `hydrograd train`, LagrangeBench's weights by name, `linear`, or `still`";

/// The model in a file, or the baseline `linear` or `still`.
///
/// Our files include their normalisation. Weights of LagrangeBench's GNS (tensors `param.*`, metadata `noise_std`, `features`) are
/// normalised by the data set's metadata. `compute`: kernels and device of the network.
///
/// # Errors
/// [`BadInput`] if the file cannot be read, is damaged, has no model, or the model does not fit the data.
pub fn load_predictor(
    path: &Path,
    metadata: &Metadata,
    compute: impl Into<Compute>,
) -> anyhow::Result<Box<dyn Predictor>> {
    match path.to_str() {
        Some("linear") => return Ok(Box::new(ConstantVelocity)),
        Some("still") => return Ok(Box::new(Still)),
        _ => {}
    }
    let bad = |problem: String| BadInput::new(problem).place(path.display().to_string()).allowed(ALLOWED);
    let file = TensorFile::read(path).map_err(|error| bad(error.to_string()))?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if file.metadata.contains_key("format") {
        let header = checkpoint::read(path)?;
        header.setup.fits(metadata).map_err(|bad| bad.place(path.display().to_string()))?;
        return Ok(Box::new(learned(header, name, compute, DType::F32)?));
    }
    let setup = foreign(&file, metadata)
        .map_err(|problem| bad(format!("not a model of hydrograd, nor LagrangeBench's weights: {problem}")))?;
    let network = setup.network(compute, 0, DType::F32)?;
    for parameter in network.parameters() {
        parameter.load(&file, "param.").map_err(|error| bad(error.to_string()))?;
    }
    Ok(Box::new(Learned::new(name, setup, Arc::from(network))))
}

/// A model that is compiled into the program.
#[derive(Debug, Clone, Copy)]
pub struct BuiltIn {
    pub name: &'static str,
    /// Its name in messages.
    pub file: &'static str,
    bytes: &'static [u8],
}

/// The model for shaping walls.
pub const HEATED_CHANNEL: BuiltIn = BuiltIn {
    name: "heated-channel",
    file: "models/heated-channel/model.safetensors",
    bytes: include_bytes!("../../../models/heated-channel/model.safetensors"),
};

/// The model for finding velocities.
pub const TAYLOR_GREEN: BuiltIn = BuiltIn {
    name: "taylor-green",
    file: "models/taylor-green/model.safetensors",
    bytes: include_bytes!("../../../models/taylor-green/model.safetensors"),
};

impl BuiltIn {
    /// Loads the model with precision `dtype`.
    ///
    /// # Errors
    /// A file that is not a model, which is a bug.
    pub fn load(&self, compute: impl Into<Compute>, dtype: DType) -> anyhow::Result<Learned> {
        let header = checkpoint::of_file(TensorFile::parse(Path::new(self.file), self.bytes)?)?;
        learned(header, self.name.into(), compute, dtype)
    }
}

/// Identifies a model by the checksum of its file.
pub fn identity(path: Option<&Path>) -> Result<String, BadInput> {
    let sum = |bytes: &[u8]| format!("{:08x}", crc32c::crc32c(bytes));
    match path {
        None => Ok(sum(HEATED_CHANNEL.bytes)),
        Some(path) => match std::fs::read(path) {
            Ok(bytes) => Ok(sum(&bytes)),
            Err(error) => Err(BadInput::new(error.to_string()).place(path.display().to_string()).allowed(ALLOWED)),
        },
    }
}

/// Loads one of our models from a file with precision `dtype`.
///
/// # Errors
/// [`BadInput`] if the file cannot be read, is damaged, or is not one of our models.
pub fn load_learned(path: &Path, compute: impl Into<Compute>, dtype: DType) -> anyhow::Result<Learned> {
    let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    learned(checkpoint::read(path)?, name, compute, dtype)
}

fn learned(
    header: checkpoint::Header,
    name: String,
    compute: impl Into<Compute>,
    dtype: DType,
) -> anyhow::Result<Learned> {
    let network = header.setup.network(compute, 0, dtype)?;
    header.load_into(&*network, true)?;
    Ok(Learned::new(name, header.setup, Arc::from(network)))
}

/// The setup of LagrangeBench's weights, derived from the shapes of its tensors, and from the features that its metadata names
/// (`features`, as JSON) where their number does not tell: an external force has as many columns as a pair of open ends.
fn foreign(file: &TensorFile, metadata: &Metadata) -> Result<Setup, String> {
    let side = |name: &str, k: usize| -> Result<usize, String> {
        let shape = file.shape(name).map_err(|error| error.to_string())?;
        shape.get(k).copied().ok_or_else(|| format!("{name} has shape {shape:?}, not [in, out]"))
    };
    let has = |name: &str| file.tensors.contains_key(name);
    let linears = (0..).take_while(|k| has(&format!("param.enc.edge.{k}.weight"))).count();
    let rounds = (0..).take_while(|k| has(&format!("param.proc.{k}.edge.0.weight"))).count();
    let embedding = side("param.embed.weight", 1)?;
    let node_features = side("param.enc.node.0.weight", 0)?.saturating_sub(embedding);
    let choices = match file.metadata.get("features") {
        Some(text) => vec![serde_json::from_str(text).map_err(|error| format!("its `features`: {error}"))?],
        None => [(false, false), (false, true), (true, false), (true, true)]
            .map(|(speed, boundary)| Features { speed, boundary, ..Features::default() })
            .to_vec(),
    };
    let features = choices
        .into_iter()
        .find(|features| features.count(metadata, false, 0) == node_features)
        .ok_or_else(|| format!("{node_features} node features do not belong to these data"))?;
    if features.force && metadata.external_force().is_none() {
        return Err("the external force is one of its features, and the data have none".to_owned());
    }
    let sizes = Sizes {
        node_features,
        edge_features: side("param.enc.edge.0.weight", 0)?,
        outputs: side(&format!("param.dec.{}.weight", linears.saturating_sub(1)), 1)?,
        latent: side("param.enc.edge.0.weight", 1)?,
        rounds,
        linears,
        embedding,
    };
    if sizes.edge_features != metadata.dim + 1 || sizes.outputs != metadata.dim {
        return Err(format!("its sizes {sizes:?} do not belong to {} dimensions", metadata.dim));
    }
    let noise = file.metadata.get("noise_std").and_then(|text| text.parse().ok()).unwrap_or(0.0);
    Ok(Setup {
        kind: Kind::Gns,
        sizes,
        features,
        normalisation: Normalisation::new(metadata, noise, metadata.default_connectivity_radius, None),
        heat: HeatModel::None,
        periodic: metadata.periodic()[..metadata.dim].to_vec(),
        spacing: None,
        frame_time: None,
        data: None,
    })
}
