//! `hydrograd train`: a surrogate from a data set.

use super::arguments::{set_option, threads, OverwriteArgument};
use super::model_data::unreadable;
use super::page;
use super::prepare::use_threads;
use super::run_folder::{is_unfinished, Earlier, RunFolder};
use crate::config::layers::Setting;
use crate::config::scene::Kernels;
use crate::config::training::Settings;
use crate::dataset::Metadata;
use crate::error::BadInput;
use crate::numerics::interrupt;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::training::begin::{Origin, TrainingData, LAST};
use crate::surrogate::training::checkpoint;
use crate::surrogate::training::checkpoint::Header;
use crate::surrogate::training::train::{Outcome, Training};
use clap::Args;
use std::path::{Path, PathBuf};

/// Train a surrogate (graph network) on a data set of `generate`'s or in LagrangeBench's layout.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd train --data data/heated --steps 20000 --out runs/gns
      a graph network of 5 rounds and 64 numbers per particle
  hydrograd train --data data/heated --out runs/gns --resume --steps 40000
      go on with it, as if it had never stopped
  hydrograd train --data data/heated --set model.latent=128 --set model.rounds=10 --set noise=1e-3 --out runs/large
      LagrangeBench's GNS-10-128
  hydrograd train --data data/heated --set model.kind=egnn --out runs/egnn
      the equivariant network
  hydrograd train --data data/other --init runs/gns/best.safetensors --out runs/other
      begin with another training's parameters
  hydrograd train --print-config > train.toml
      every setting, to change and give as --config train.toml

last.safetensors and best.safetensors open in PyTorch: safetensors.torch.load_file; weights are [in, out].")]
pub struct TrainArguments {
    /// Folder with train.h5, valid.h5 and metadata.json.
    #[arg(long, value_name = "DIR")]
    pub data: Option<PathBuf>,
    /// Folder for checkpoints, tables and plots.
    #[arg(long, value_name = "DIR", default_value = "runs/train")]
    pub out: PathBuf,
    /// Updates in all (steps).
    #[arg(long, value_name = "N")]
    pub steps: Option<u64>,
    /// Settings as TOML; `--print-config` shows them all.
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override a setting, e.g. `--set noise=1e-3`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Go on with the training in --out.
    #[arg(long, conflicts_with = "init")]
    pub resume: bool,
    #[command(flatten)]
    pub overwrite: OverwriteArgument,
    /// Begin with the parameters of another training; without --config its model.* and features.* hold too.
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,
    /// Worker threads, 0 for every core.
    #[arg(long, value_name = "N", value_parser = threads, allow_hyphen_values = true)]
    pub threads: Option<usize>,
    /// Implementation of the network; a training can go on with the other one.
    #[arg(long, value_enum, default_value_t)]
    pub kernels: Kernels,
    /// Seed of every random number (seed).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Print the settings and stop.
    #[arg(long)]
    pub print_config: bool,
}

/// What its folders are marked with.
const KIND: &str = "train";

pub fn run(arguments: TrainArguments) -> anyhow::Result<()> {
    let folder = &arguments.out;
    let init = arguments.init.as_deref().map(|from| checkpoint::read(from).map_err(of_init(from))).transpose()?;
    let settings = arguments.settings(init.as_ref())?;
    if arguments.print_config {
        print!("{}", settings.shown());
        return Ok(());
    }
    let Some(data) = &arguments.data else {
        return Err(BadInput::new("--data is missing")
            .allowed("the folder of a data set")
            .advice("--data data/heated")
            .into());
    };
    let earlier = Earlier::of_options(arguments.resume, arguments.overwrite.overwrite);
    RunFolder::check(folder, KIND, earlier)?;
    use_threads(arguments.threads.unwrap_or(0));
    let metadata = Metadata::read(data).map_err(unreadable(data))?;
    let setup = Setup::new(&settings, &metadata)?;
    let origin = arguments.origin(init, &settings, &setup)?;
    let data_set = TrainingData::read(data, metadata).map_err(unreadable(data))?;
    data_set.check(&settings).map_err(|bad| bad.place(format!("--data {}", data.display())))?;
    let mut training = Training::new(&settings, &setup, &data_set, &origin, arguments.kernels, folder)?;
    let bar = Progress::new(settings.steps, "train");
    let (trajectories, frames) = (data_set.train.len(), data_set.train[0].frames);
    bar.line(&format!("{} parameters, {trajectories} training trajectories of {frames} frames", training.parameters()));
    let own = RunFolder::take(folder, KIND, earlier)?;
    interrupt::listen(format!("hydrograd train --data {} --out {} --resume", data.display(), folder.display()))?;
    let outcome = training.run(&bar)?;
    page::write(folder)?;
    own.finish()?;
    bar.finish();
    show(&outcome, &settings, training.state.seconds);
    println!("best.safetensors, last.safetensors, history.csv, validation.csv, curves.png in {}", folder.display());
    println!(
        "next: hydrograd evaluate --model {} --data {} --split test",
        folder.join("best.safetensors").display(),
        data.display()
    );
    Ok(())
}

impl TrainArguments {
    /// Those of a file (a resumed training's own, if no other is named) and of the options; without a file the model is that
    /// of `init`.
    fn settings(&self, init: Option<&Header>) -> Result<Settings, BadInput> {
        let mut settings: Vec<Setting> = self.sets.iter().map(|text| set_option(text)).collect();
        settings.extend(self.steps.map(|steps| Setting::option("--steps", "steps", steps)));
        settings.extend(self.seed.map(|seed| Setting::option("--seed", "seed", seed)));
        let own = self.out.join("config.toml");
        let config = match &self.config {
            None if self.resume && own.is_file() => Some(own.as_path()),
            given => given.as_deref(),
        };
        Settings::load_settings(config, init.map(|header| &header.settings), &settings)
    }

    /// Where the parameters come from.
    fn origin(&self, init: Option<Header>, settings: &Settings, setup: &Setup) -> Result<Origin, BadInput> {
        let folder = &self.out;
        let place = format!("--out {}", folder.display());
        if self.resume && !ended_early(folder) {
            let last = folder.join(LAST);
            let header = checkpoint::read(&last).map_err(|bad| {
                bad.advice(match last.exists() {
                    true => "another --out; --init best.safetensors takes over what is still good",
                    false => "train without --resume to begin",
                })
            })?;
            return Origin::resumed(header, settings, setup).map_err(|bad| match bad.is_about("steps") {
                true => bad.place(place),
                false => bad.advice("begin anew in another --out; --init takes over the parameters"),
            });
        }
        match (init, &self.init) {
            (Some(header), Some(from)) => Origin::taken_over(header, setup)
                .map_err(of_init(from))
                .map_err(|bad| bad.advice("leave --config and --set model.* out: the sizes are the file's then")),
            _ => Ok(Origin::New),
        }
    }
}

/// Whether a folder's training was ended before its first checkpoint: then it begins with its settings.
pub(super) fn ended_early(folder: &Path) -> bool {
    is_unfinished(folder, KIND) && folder.join("config.toml").is_file() && !folder.join(LAST).exists()
}

/// An error in a file that --init names.
fn of_init(from: &Path) -> impl Fn(BadInput) -> BadInput + '_ {
    move |bad| bad.place(format!("--init {}", from.display()))
}

/// The scores of the last step beside the baseline's, and how long it took.
fn show(outcome: &Outcome, settings: &Settings, seconds: f64) {
    let mut table = Table::new(["", "MSE_1", "MSE_5", "MSE_20", "Sinkhorn", "E_kin", "temperature MSE"]);
    let digits = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3e}"));
    for (name, scores) in [("last step", &outcome.scores), ("linear", &outcome.linear)] {
        table.row([
            name.to_owned(),
            digits(scores.mse_1),
            digits(scores.mse_5),
            digits(scores.mse_20),
            digits(scores.sinkhorn),
            digits(scores.e_kin),
            digits(scores.temperature_mse),
        ]);
    }
    println!("validation, {} windows\n{}", outcome.scores.windows, table.to_text());
    println!(
        "{} steps, {seconds:.1} s in all, {:.1} ms per update; best validation at step {}",
        settings.steps,
        1e3 * outcome.seconds_per_step,
        outcome.best_step.map_or("none".to_owned(), |step| step.to_string())
    );
}
