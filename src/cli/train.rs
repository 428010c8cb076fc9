//! `hydrograd train`: trains a surrogate on a data set.

use super::arguments::{set_option, threads, OverwriteArgument};
use super::machine;
use super::model_data::unreadable;
use super::page;
use super::prepare::{compute, use_threads};
use super::ranks::together;
use super::run_folder::{is_unfinished, Earlier, RunFolder};
use crate::config::device::{Compute, DeviceName};
use crate::config::layers::Setting;
use crate::config::scene::Kernels;
use crate::config::training::Settings;
use crate::dataset::Metadata;
use crate::error::BadInput;
use crate::numerics::interrupt;
use crate::numerics::ranks::Ranks;
use crate::report::page::PAGE;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::surrogate::evaluation::scores::Scores;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::training::batch::Team;
use crate::surrogate::training::begin::{Origin, TrainingData, LAST};
use crate::surrogate::training::checkpoint::{self, Header};
use crate::surrogate::training::train::{Outcome, Training, METRICS};
use clap::Args;
use serde_json::{json, Value};
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
  mpirun -n 4 hydrograd train --data data/heated --set batch_size=4 --out runs/gns
      four processes, each with a quarter of every batch (cargo build --release --features mpi)

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
    /// Begin with the parameters of another training and its normalisation; without --config its model.* and features.*
    /// hold too.
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,
    /// Worker threads, 0 for every core that the process may use.
    #[arg(long, value_name = "N", value_parser = threads, allow_hyphen_values = true)]
    pub threads: Option<usize>,
    /// Implementation of the network; a training can go on with the other one.
    #[arg(long, value_enum, default_value_t)]
    pub kernels: Kernels,
    /// Where the network runs: cpu, cuda or cuda:N; a GPU takes the composed one.
    #[arg(long, value_name = "DEVICE", default_value_t)]
    pub device: DeviceName,
    /// Seed of every random number (seed).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// With several ranks: add their gradients in the order of the batch, for the same bits whatever their number.
    #[arg(long)]
    pub deterministic: bool,
    /// Print the settings and stop.
    #[arg(long)]
    pub print_config: bool,
}

const KIND: &str = "train";

pub fn run(arguments: TrainArguments) -> anyhow::Result<()> {
    if arguments.print_config {
        let settings = arguments.settings(arguments.init()?.as_ref())?;
        machine::answer(&serde_json::to_value(&settings as &dyn erased_serde::Serialize)?);
        print!("{}", settings.shown());
        return Ok(());
    }
    together(|ranks| match ranks.rank() {
        0 => lead(&arguments, ranks),
        _ => follow(&arguments, ranks),
    })
}

/// The input of a training on every rank.
struct Begun {
    compute: Compute,
    settings: Settings,
    setup: Setup,
    data: TrainingData,
    origin: Origin,
}

impl Begun {
    fn training<'a>(&'a self, arguments: &'a TrainArguments, ranks: &'a Ranks) -> anyhow::Result<Training<'a>> {
        let Self { compute, settings, setup, data, origin } = self;
        let team = Team { ranks, is_ordered: arguments.deterministic };
        Training::new(settings, setup, data, origin, compute.clone(), team, &arguments.out)
    }
}

/// Runs the first rank, which trains, prints and writes.
fn lead(arguments: &TrainArguments, ranks: &Ranks) -> anyhow::Result<()> {
    let folder = &arguments.out;
    let begun = arguments.begin(ranks)?;
    let mut training = begun.training(arguments, ranks)?;
    let (settings, data) = (&begun.settings, &begun.data);
    let bar = Progress::new(settings.steps, "train");
    let (trajectories, frames) = (data.train.len(), data.train[0].frames);
    bar.line(&format!("{} parameters, {trajectories} training trajectories of {frames} frames", training.parameters()));
    if let Some(threads) = ranks.threads() {
        bar.log(&format!("{} ranks, {threads} threads each", ranks.size()));
    }
    let data_folder = arguments.data()?.display();
    interrupt::listen(format!("hydrograd train --data {data_folder} --out {} --resume", folder.display()))?;
    if ranks.size() > 1 {
        interrupt::needs_others();
    }
    // Until no rank reads files of the folder any more.
    ranks.wait();
    let own = RunFolder::take(folder, KIND, arguments.earlier())?;
    let outcome = training.run(&bar)?;
    page::write(folder)?;
    own.finish()?;
    bar.finish();
    machine::answer(&summary(arguments, &training, &outcome));
    show(&outcome, settings, training.state.seconds);
    println!("best.safetensors, last.safetensors, history.csv, validation.csv, curves.png in {}", folder.display());
    println!(
        "next: hydrograd evaluate --model {} --data {data_folder} --split test",
        folder.join("best.safetensors").display(),
    );
    Ok(())
}

/// Runs the other ranks, which train with their share of every batch.
fn follow(arguments: &TrainArguments, ranks: &Ranks) -> anyhow::Result<()> {
    let begun = arguments.begin(ranks)?;
    let mut training = begun.training(arguments, ranks)?;
    interrupt::listen_quietly()?;
    ranks.wait();
    training.follow()
}

impl TrainArguments {
    /// Reads and checks all input, before anything is written.
    fn begin(&self, ranks: &Ranks) -> anyhow::Result<Begun> {
        let compute = compute(self.kernels, self.device)?;
        let init = self.init()?;
        let settings = self.settings(init.as_ref())?;
        let data = self.data()?;
        if ranks.rank() == 0 {
            RunFolder::check(&self.out, KIND, self.earlier())?;
        }
        check_shares(&settings, ranks.size())?;
        use_threads(self.threads.or_else(|| ranks.threads()).unwrap_or(0));
        let metadata = Metadata::read(data).map_err(unreadable(data))?;
        let setup = Setup::new(&settings, &metadata)?;
        let origin = self.origin(init, &settings, &setup)?;
        let setup = origin.setup(setup);
        let data_set = TrainingData::read(data, metadata).map_err(unreadable(data))?;
        data_set.check(&settings).map_err(|bad| bad.place(format!("--data {}", data.display())))?;
        Ok(Begun { compute, settings, setup, data: data_set, origin })
    }

    fn init(&self) -> Result<Option<Header>, BadInput> {
        self.init.as_deref().map(|from| checkpoint::read(from).map_err(of_init(from))).transpose()
    }

    fn data(&self) -> Result<&Path, BadInput> {
        self.data.as_deref().ok_or_else(|| {
            BadInput::new("--data is missing").allowed("the folder of a data set").advice("--data data/heated")
        })
    }

    fn earlier(&self) -> Earlier {
        Earlier::of_options(self.resume, self.overwrite.overwrite)
    }

    /// The settings of a file (for a resumed training its own, unless another is given) and of the options; without a
    /// file the model is that of `init`.
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

    /// Origin of the parameters.
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

/// Checks that every rank has the same number of windows of a batch.
fn check_shares(settings: &Settings, ranks: usize) -> Result<(), BadInput> {
    if ranks > 1 && settings.objective.weight > 0.0 {
        return Err(BadInput::new(format!("objective.weight = {} with {ranks} ranks", settings.objective.weight))
            .key("objective.weight")
            .allowed("a single process: pairs of rollouts are not shared out"));
    }
    let (batch, next) = (settings.batch_size, settings.batch_size.next_multiple_of(ranks));
    if batch == next {
        return Ok(());
    }
    Err(BadInput::new(format!("a batch of {batch} cannot be shared out evenly among {ranks} ranks"))
        .allowed(format!("batch_size a multiple of {ranks}"))
        .advice(format!("--set batch_size={next}, or as many ranks as the batch has windows")))
}

/// Whether the training of a folder ended before its first checkpoint; it is then restarted with its settings.
pub(super) fn ended_early(folder: &Path) -> bool {
    is_unfinished(folder, KIND) && folder.join("config.toml").is_file() && !folder.join(LAST).exists()
}

/// Adds the file of --init to an error.
fn of_init(from: &Path) -> impl Fn(BadInput) -> BadInput + '_ {
    move |bad| bad.place(format!("--init {}", from.display()))
}

/// The answer to `--json`.
fn summary(arguments: &TrainArguments, training: &Training, outcome: &Outcome) -> Value {
    let folder = &arguments.out;
    let figures = |scores: &Scores| {
        let Scores { windows, mse, mse_1, mse_5, mse_10, mse_20, sinkhorn, e_kin, temperature_mse, .. } = scores;
        json!({ "windows": windows, "mse": mse, "mse_1": mse_1, "mse_5": mse_5, "mse_10": mse_10, "mse_20": mse_20,
            "sinkhorn": sinkhorn, "e_kin": e_kin, "temperature_mse": temperature_mse })
    };
    let is_best = |row: &&Vec<f64>| outcome.best_step.is_some_and(|step| row[0] == step as f64);
    let at_best = training.validation.iter().find(is_best).map(|row| {
        METRICS.iter().zip(&row[2..]).map(|(name, value)| (name.to_string(), json!(value))).collect::<Value>()
    });
    let checkpoint = |name: &str| folder.join(name).is_file().then(|| machine::path(&folder.join(name)));
    json!({
        "folder": machine::path(folder),
        "data": arguments.data.as_deref().map(machine::path),
        "parameters": training.parameters(),
        "trajectories": training.train.len(),
        "frames": training.train.first().map(|trajectory| trajectory.frames),
        "steps": training.state.step,
        "seconds": training.state.seconds,
        "seconds_per_step": outcome.seconds_per_step,
        "loss": training.history.last().map(|row| row[2]),
        "best_validation_loss": training.state.best,
        "best_step": outcome.best_step,
        "validation_at_best": at_best,
        "validation": figures(&outcome.scores),
        "linear": figures(&outcome.linear),
        "best": checkpoint("best.safetensors"),
        "last": checkpoint(LAST),
        "files": machine::paths_in(folder, ["config.toml", "history.csv", "validation.csv", "curves.png", PAGE]),
    })
}

/// Prints the scores of the last step and of the baseline, and the time.
fn show(outcome: &Outcome, settings: &Settings, seconds: f64) {
    let mut table = Table::new(["", "MSE_1", "MSE_5", "MSE_20", "Sinkhorn", "E_kin", "temperature MSE"]);
    for (name, s) in [("last step", &outcome.scores), ("linear", &outcome.linear)] {
        let figures = [s.mse_1, s.mse_5, s.mse_20, s.sinkhorn, s.e_kin, s.temperature_mse];
        let figures = figures.map(|value| value.map_or("-".to_owned(), |v| format!("{v:.3e}")));
        table.row([name.to_owned()].into_iter().chain(figures));
    }
    println!("validation, {} windows\n{}", outcome.scores.windows, table.to_text());
    println!(
        "{} steps, {seconds:.1} s in all, {:.1} ms per update; best validation at step {}",
        settings.steps,
        1e3 * outcome.seconds_per_step,
        outcome.best_step.map_or("none".to_owned(), |step| step.to_string())
    );
}
