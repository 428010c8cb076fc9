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
        if let Some(unlike) = model.unlike(&metadata) {
            guard::warn(
                &format!("{unlike}: its predictions mean little there"),
                "a model that was trained on such data",
            );
        }
        Ok(ModelData { model, metadata, trajectories })
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
