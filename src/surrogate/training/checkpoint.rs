//! Checkpoints of a training: one safetensors file with everything that the next step depends on.
//!
//! Tensors, all F32: `param.NAME` (weights `[in, out]`; NAME that of a perceptron's tensors behind `embed`, `enc.node`,
//! `enc.edge`, `proc.K.edge`, `proc.K.node`, `dec`), `adam.first.NAME` and `adam.second.NAME` (moments), `ema.NAME` if an
//! average is kept. Metadata, all text: `format`, `version`, `kind`, `step`, `seconds`, `best`, `losses` (JSON), `settings` (TOML), `setup`
//! (JSON: sizes, features, normalisation). Random numbers follow from seed and step, so the step is their position too.

use crate::config::training::Settings;
use crate::error::BadInput;
use crate::io::tensor_file::{write_tensors, Data, TensorFile, Tensors};
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::adamw::{AdamW, Moments};
use crate::surrogate::network::parameters::{Network, Parameter};
use candle_core::{Device, Tensor, Var};
use std::collections::BTreeMap;
use std::path::Path;

const FORMAT: &str = "hydrograd surrogate 1";
const ALLOWED: &str = "a .safetensors file written by `hydrograd train`";

pub struct TrainingState {
    /// Number of updates.
    pub step: u64,
    /// Wall-clock time so far.
    pub seconds: f64,
    /// Best validation score so far; infinite before the first.
    pub best: f64,
    /// Losses of the steps since the last row of the history.
    pub losses: Vec<f64>,
    pub optimiser: AdamW,
    /// Moving averages of the parameters, if kept.
    pub average: Option<Vec<Tensor>>,
}

/// The initial state of a training of a network.
pub fn fresh(settings: &Settings, network: &dyn Network) -> anyhow::Result<TrainingState> {
    let variables: Vec<Var> = network.parameters().iter().map(|p| p.values.clone()).collect();
    let mut optimiser = AdamW::new(&variables)?;
    optimiser.weight_decay = settings.weight_decay;
    let copy = |parameter: &Parameter| parameter.values.as_detached_tensor().copy();
    let copies = || network.parameters().iter().map(copy).collect::<candle_core::Result<Vec<_>>>();
    let average = (settings.ema > 0.0).then(copies).transpose()?;
    Ok(TrainingState { step: 0, seconds: 0.0, best: f64::INFINITY, losses: Vec::new(), optimiser, average })
}

/// Writes a checkpoint, atomically.
pub fn write(
    path: &Path,
    settings: &Settings,
    setup: &Setup,
    network: &dyn Network,
    state: &TrainingState,
) -> anyhow::Result<()> {
    let mut tensors = Tensors::new();
    let mut add = |prefix: &str, parameter: &Parameter, values: &Tensor| -> candle_core::Result<()> {
        let values = values.flatten_all()?.to_vec1::<f32>()?;
        for (name, at, shape) in &parameter.parts {
            let data = Data::F32(values[at.clone()].to_vec());
            tensors.insert(format!("{prefix}{name}"), (shape.clone(), data));
        }
        Ok(())
    };
    for (k, parameter) in network.parameters().iter().enumerate() {
        add("param.", parameter, parameter.values.as_tensor())?;
        add("adam.first.", parameter, &state.optimiser.moments[k].first)?;
        add("adam.second.", parameter, &state.optimiser.moments[k].second)?;
        if let Some(average) = &state.average {
            add("ema.", parameter, &average[k])?;
        }
    }
    let metadata = [
        ("format", FORMAT.to_owned()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("kind", format!("{:?}", setup.kind).to_lowercase()),
        ("step", state.step.to_string()),
        ("seconds", state.seconds.to_string()),
        ("best", state.best.to_string()),
        ("losses", serde_json::to_string(&state.losses)?),
        ("settings", settings.text()),
        ("setup", serde_json::to_string(setup)?),
    ];
    let metadata: BTreeMap<String, String> = metadata.into_iter().map(|(k, v)| (k.to_owned(), v)).collect();
    Ok(write_tensors(path, &tensors, &metadata)?)
}

/// The content of a checkpoint's metadata.
pub struct Header {
    pub file: TensorFile,
    pub setup: Setup,
    pub settings: Settings,
    pub step: u64,
    pub seconds: f64,
    pub best: f64,
    /// See [`TrainingState::losses`].
    pub losses: Vec<f64>,
}

/// Reads a checkpoint of a training.
///
/// # Errors
/// [`BadInput`]: the file is missing, damaged, or not a checkpoint of a training.
pub fn read(path: &Path) -> Result<Header, BadInput> {
    let bad = |problem: String| BadInput::new(problem).place(path.display().to_string()).allowed(ALLOWED);
    of_file(TensorFile::read(path).map_err(|error| bad(error.to_string()))?)
}

/// Reads the header of a file that is a checkpoint.
pub fn of_file(file: TensorFile) -> Result<Header, BadInput> {
    let path = file.path.clone();
    let bad = |problem: String| BadInput::new(problem).place(path.display().to_string()).allowed(ALLOWED);
    let text = |key: &str| file.text(key).map_err(|error| bad(format!("not a model of hydrograd: {error}")));
    if text("format")? != FORMAT {
        return Err(bad(format!("its format is `{}`, not `{FORMAT}`", text("format")?)));
    }
    let number = |key: &str| -> Result<f64, BadInput> {
        text(key)?.parse().map_err(|_| bad(format!("its `{key}` is not a number")))
    };
    let mut setup: Setup =
        serde_json::from_str(text("setup")?).map_err(|error| bad(format!("its `setup`: {error}")))?;
    if let Some(problem) = setup.sizes.beyond(&file) {
        return Err(bad(format!("its `setup`: {problem}")));
    }
    // Models without information on their data were trained before this choice existed.
    setup.features.unset_walls |= setup.data.is_none();
    let settings = toml::from_str(text("settings")?).map_err(|error| bad(format!("its `settings`: {error}")))?;
    let (step, seconds, best) = (number("step")? as u64, number("seconds")?, number("best")?);
    // Earlier versions did not store the losses.
    let losses = match file.metadata.get("losses") {
        Some(losses) => serde_json::from_str(losses).map_err(|error| bad(format!("its `losses`: {error}")))?,
        None => Vec::new(),
    };
    Ok(Header { setup, settings, step, seconds, best, losses, file })
}

impl Header {
    /// The optimiser and averages of the file, for the parameters of `network`.
    pub fn state(&self, network: &dyn Network) -> anyhow::Result<TrainingState> {
        let tensor = |parameter: &Parameter, prefix: &str| -> anyhow::Result<Tensor> {
            let values = parameter.read(&self.file, prefix);
            let values = values.map_err(|error| BadInput::new(error.to_string()).allowed(ALLOWED))?;
            let values: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
            Ok(Tensor::new(values, &Device::Cpu)?)
        };
        let mut moments = Vec::new();
        let mut average = Vec::new();
        for parameter in network.parameters() {
            moments
                .push(Moments { first: tensor(parameter, "adam.first.")?, second: tensor(parameter, "adam.second.")? });
            if self.settings.ema > 0.0 {
                average.push(tensor(parameter, "ema.")?);
            }
        }
        let optimiser = AdamW { moments, steps: self.step, weight_decay: self.settings.weight_decay };
        let average = (self.settings.ema > 0.0).then_some(average);
        let (step, seconds, best, losses) = (self.step, self.seconds, self.best, self.losses.clone());
        Ok(TrainingState { step, seconds, best, losses, optimiser, average })
    }

    /// Loads the file's parameters into a network of the same sizes, or with `averaged` their averages if they exist.
    pub fn load_into(&self, network: &dyn Network, averaged: bool) -> anyhow::Result<()> {
        let prefix = if averaged && self.settings.ema > 0.0 { "ema." } else { "param." };
        let loaded = network.parameters().iter().try_for_each(|parameter| parameter.load(&self.file, prefix));
        loaded.map_err(|error| BadInput::new(error.to_string()).allowed(ALLOWED).into())
    }
}
