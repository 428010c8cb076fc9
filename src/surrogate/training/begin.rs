//! The start of a training: checks of data and settings, and the origin of the parameters.

use crate::config::device::Compute;
use crate::config::difference::differences;
use crate::config::training::{Settings, FREE};
use crate::dataset::{read_split, Metadata, Split, Trajectory};
use crate::error::BadInput;
use crate::io::FileError;
use crate::surrogate::evaluation::rollout::check_length;
use crate::surrogate::features::Normalisation;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::parameters::Network;
use crate::surrogate::training::checkpoint::{fresh, Header, TrainingState};
use candle_core::DType;
use serde_json::json;
use std::path::Path;
use std::sync::Arc;

/// The checkpoint from which a training is resumed.
pub const LAST: &str = "last.safetensors";

pub struct TrainingData {
    pub metadata: Metadata,
    pub train: Vec<Trajectory>,
    pub valid: Vec<Trajectory>,
}

impl TrainingData {
    /// Reads both splits of a folder.
    pub fn read(folder: &Path, metadata: Metadata) -> Result<Self, FileError> {
        let train = read_split(folder, &metadata, Split::Train)?;
        let valid = read_split(folder, &metadata, Split::Valid)?;
        Ok(Self { metadata, train, valid })
    }

    /// Checks that no split is empty and that trajectories are long enough for validation.
    pub fn check(&self, settings: &Settings) -> Result<(), BadInput> {
        for (split, trajectories) in [("train.h5", &self.train), ("valid.h5", &self.valid)] {
            if trajectories.is_empty() {
                return Err(BadInput::new(format!("{split} holds no trajectory"))
                    .allowed("at least one for training and one for validation")
                    .advice("a data set with trajectories=4/2/2"));
            }
        }
        match self.valid.iter().max_by_key(|t| t.frames) {
            Some(longest) => check_length(longest, 0, settings.validation_steps)
                .map_err(|bad| bad.advice("a smaller validation_steps")),
            None => Ok(()),
        }
    }
}

pub enum Origin {
    /// Random values.
    New,
    /// An earlier run of the same training, including its optimiser.
    Resumed(Box<Header>),
    /// Another training of the same kind and sizes.
    TakenOver(Box<Header>),
}

impl Origin {
    /// Resumes the training of a checkpoint.
    ///
    /// # Errors
    /// [`BadInput`]: it has other settings or data, or is beyond `settings.steps` (the error's key is then `steps`).
    pub fn resumed(header: Header, settings: &Settings, setup: &Setup) -> Result<Self, BadInput> {
        // The normalisation may be that of the parameters with which the training began.
        let setup = Setup { normalisation: header.setup.normalisation.clone(), ..setup.clone() };
        resumes(&header.settings, settings, header.setup == setup)?;
        if settings.steps < header.step {
            let problem = format!("steps = {}, but the training is at step {}", settings.steps, header.step);
            return Err(BadInput::new(problem).key("steps").allowed(format!("steps of {} or more", header.step)));
        }
        Ok(Self::Resumed(Box::new(header)))
    }

    /// Takes the parameters of another training.
    ///
    /// # Errors
    /// [`BadInput`]: a model of another kind or of other sizes.
    pub fn taken_over(header: Header, setup: &Setup) -> Result<Self, BadInput> {
        if header.setup.sizes == setup.sizes && header.setup.kind == setup.kind {
            return Ok(Self::TakenOver(Box::new(header)));
        }
        let own = |setup: &Setup| {
            let serde_json::Value::Object(mut all) = json!(setup.sizes) else { return Vec::new() };
            all.insert("kind".into(), json!(setup.kind));
            all.into_iter().collect::<Vec<_>>()
        };
        let differing: Vec<String> = own(&header.setup)
            .into_iter()
            .zip(own(setup))
            .filter(|(theirs, ours)| theirs != ours)
            .map(|((key, theirs), (_, ours))| format!("{key} = {theirs}, not {ours}"))
            .collect();
        Err(BadInput::new(format!("its model has {}", differing.join(", ")))
            .allowed("a model of the same kind and sizes; data with heat for a model with heat"))
    }

    /// Whether an earlier run is resumed.
    pub fn resumes(&self) -> bool {
        matches!(self, Self::Resumed(_))
    }

    /// The setup of the training, given that of its data. Parameters that are taken over mean what they meant with the
    /// normalisation of their own data, so that is kept.
    pub fn setup(&self, mut setup: Setup) -> Setup {
        if let Self::Resumed(header) | Self::TakenOver(header) = self {
            let radius = setup.normalisation.radius;
            setup.normalisation = Normalisation { radius, ..header.setup.normalisation.clone() };
        }
        setup
    }

    /// The network with its parameters, and the state of its training.
    pub fn network(
        &self,
        settings: &Settings,
        setup: &Setup,
        compute: impl Into<Compute>,
    ) -> anyhow::Result<(Arc<dyn Network>, TrainingState)> {
        let network: Arc<dyn Network> = Arc::from(setup.network(compute, settings.seed, DType::F32)?);
        let state = match self {
            Self::Resumed(header) => {
                header.load_into(&*network, false)?;
                header.state(&*network)?
            }
            Self::TakenOver(header) => {
                header.load_into(&*network, true)?;
                fresh(settings, &*network)?
            }
            Self::New => fresh(settings, &*network)?,
        };
        Ok((network, state))
    }
}

/// Checks that the settings differ only in the length of the training and the frequency of its output.
fn resumes(before: &Settings, now: &Settings, same_setup: bool) -> Result<(), BadInput> {
    let found = differences(before, now, &FREE);
    if found.is_empty() && same_setup {
        return Ok(());
    }
    let differing: Vec<String> = found.iter().map(|d| format!("{} was {} and is {}", d.key, d.before, d.now)).collect();
    let problem = match differing.is_empty() {
        true => "the data differ from those that the training began with".to_owned(),
        false => format!("the settings differ from those that the training began with: {}", differing.join("; ")),
    };
    Err(BadInput::new(problem)
        .allowed("the same but for steps, log_every, validate_every, store_every and validation_*")
        .advice("begin anew in another folder; its parameters can be taken over"))
}
