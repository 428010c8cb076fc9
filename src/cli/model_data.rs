//! The input of `evaluate` and `rollout`: a model and a split of a data set.

use super::arguments::threads;
use super::guard;
use super::prepare::{compute, use_threads};
use crate::config::device::DeviceName;
use crate::config::scene::Kernels;
use crate::dataset::{read_split, Metadata, Split, Trajectory};
use crate::error::BadInput;
use crate::io::FileError;
use crate::surrogate::load_predictor;
use crate::surrogate::predictor::Predictor;
use crate::surrogate::relaxation::{Relaxation, Relaxed};
use clap::Args;
use std::path::{Path, PathBuf};

#[derive(Debug, Clone, Args)]
pub struct ModelDataArguments {
    /// A model written by `hydrograd train`, or `linear` (constant velocity), or `still` (no change).
    #[arg(long, value_name = "FILE")]
    pub model: PathBuf,
    /// Folder of the data set: metadata.json, valid.h5, test.h5.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Which of its files.
    #[arg(long, value_enum, default_value = "valid")]
    pub split: Split,
    /// Implementation of the network.
    #[arg(long, value_enum, default_value_t)]
    pub kernels: Kernels,
    /// Where the network runs: cpu, cuda or cuda:N; a GPU takes the composed one.
    #[arg(long, value_name = "DEVICE", default_value_t)]
    pub device: DeviceName,
    /// Worker threads, 0 for every core that the process may use; 1 is best on a busy machine.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads, allow_hyphen_values = true)]
    pub threads: usize,
    #[command(flatten)]
    pub relax: RelaxArguments,
}

/// Relaxation of predicted particles by SPH (Neural SPH, Toshev et al. 2024), for long rollouts.
#[derive(Debug, Clone, Args)]
pub struct RelaxArguments {
    /// Pseudo-steps of SPH after each predicted frame, which keep particles from clustering (Neural SPH); 1 to 5 are usual.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100))]
    pub relax: Option<u32>,
    /// Their length.
    #[arg(long, value_name = "NUMBER", default_value_t = Relaxation::default().strength, value_parser = positive, requires = "relax")]
    pub relax_strength: f64,
    /// Their viscosity.
    #[arg(long, value_name = "NUMBER", default_value_t = Relaxation::default().viscosity, value_parser = not_negative, requires = "relax")]
    pub relax_viscosity: f64,
}

fn positive(text: &str) -> Result<f64, String> {
    number(text, |value| value > 0.0, "a number greater than 0")
}

fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |value| value >= 0.0, "a number, 0 or more")
}

fn number(text: &str, is_allowed: fn(f64) -> bool, allowed: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() && is_allowed(value) => Ok(value),
        _ => Err(format!("allowed: {allowed}")),
    }
}

impl RelaxArguments {
    /// A model whose predictions are relaxed, if that is wanted.
    fn wrap(&self, model: Box<dyn Predictor>, metadata: &Metadata) -> Result<Box<dyn Predictor>, BadInput> {
        let Some(steps) = self.relax else { return Ok(model) };
        if metadata.heat.is_some() {
            return Err(BadInput::new("--relax with data of the heated channel, whose particles differ in volume")
                .allowed("flows of particles of equal volume: taylor-green, reverse-poiseuille, lid-driven-cavity, dam-break")
                .advice("leave --relax out"));
        }
        let (strength, viscosity) = (self.relax_strength, self.relax_viscosity);
        Ok(Box::new(Relaxed { model, relaxation: Relaxation { steps: steps as usize, strength, viscosity } }))
    }
}

/// A model and the data with which it is compared.
pub struct ModelData {
    pub model: Box<dyn Predictor>,
    pub metadata: Metadata,
    pub trajectories: Vec<Trajectory>,
}

impl ModelDataArguments {
    /// Reads model and data. Errors in the input are found before anything is written.
    pub fn read(&self) -> anyhow::Result<ModelData> {
        use_threads(self.threads);
        let compute = compute(self.kernels, self.device)?;
        let (metadata, trajectories) = read_data(&self.data, self.split)?;
        let model = load_predictor(&self.model, &metadata, compute)?;
        let model = self.relax.wrap(model, &metadata)?;
        if let Some(unlike) = model.unlike(&metadata) {
            guard::warn(
                &format!("{unlike}: its predictions mean little there"),
                "a model that was trained on such data",
            );
        }
        Ok(ModelData { model, metadata, trajectories })
    }

    /// The model once more, without relaxation.
    pub fn alone(&self, metadata: &Metadata) -> anyhow::Result<Box<dyn Predictor>> {
        load_predictor(&self.model, metadata, compute(self.kernels, self.device)?)
    }
}

pub fn read_data(folder: &Path, split: Split) -> Result<(Metadata, Vec<Trajectory>), BadInput> {
    let metadata = Metadata::read(folder).map_err(unreadable(folder))?;
    let trajectories = read_split(folder, &metadata, split).map_err(unreadable(folder))?;
    Ok((metadata, trajectories))
}

/// Converts the error of an unreadable data set to one about input.
pub fn unreadable(folder: &Path) -> impl Fn(FileError) -> BadInput + '_ {
    move |error| {
        BadInput::new(error.to_string())
            .place(format!("--data {}", folder.display()))
            .allowed("the folder of a data set: metadata.json, train.h5, valid.h5, test.h5")
            .advice("hydrograd generate makes one")
    }
}
