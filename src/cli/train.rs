//! `hydrograd train`: a surrogate from a data set.

use super::arguments::{check_own, check_writable};
use super::model_data::unreadable;
use super::prepare::use_threads;
use crate::config::training::Settings;
use crate::dataset::{read_split, Metadata, Split};
use crate::error::BadInput;
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use crate::io::FileError;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::surrogate::evaluation::rollout;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::training::checkpoint;
use crate::surrogate::training::train::{fresh, read_rows, Training};
use candle_core::DType;
use clap::Args;
use serde_json::json;
use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};
use std::sync::Arc;

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
    /// Begin with the parameters of another training; without --config its model.* and features.* hold too.
    #[arg(long, value_name = "FILE")]
    pub init: Option<PathBuf>,
    /// Worker threads, 0 for every core.
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Seed of every random number (seed).
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Print the settings and stop.
    #[arg(long)]
    pub print_config: bool,
}

pub fn run(arguments: TrainArguments) -> anyhow::Result<()> {
    let mut sets = arguments.sets.clone();
    sets.extend(arguments.steps.map(|steps| format!("steps={steps}")));
    sets.extend(arguments.seed.map(|seed| format!("seed={seed}")));
    let folder = arguments.out.clone();
    let last = folder.join("last.safetensors");
    let kept = folder.join("config.toml");
    let config = match &arguments.config {
        None if arguments.resume && kept.is_file() => Some(kept.as_path()),
        given => given.as_deref(),
    };
    let init = match &arguments.init {
        Some(from) => {
            Some((from, checkpoint::read(from).map_err(|bad| bad.place(format!("--init {}", from.display())))?))
        }
        None => None,
    };
    let settings = Settings::load(config, init.as_ref().map(|(_, header)| &header.settings), &sets)?;
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
    check_writable(&folder)?;
    check_own(
        &folder,
        &["metadata.json", "generate.json", "study.csv", "summary.json"],
        "a new folder, or with --resume that of a training",
    )?;
    use_threads(arguments.threads.unwrap_or(0));
    let metadata = Metadata::read(data).map_err(unreadable(data))?;
    let setup = Setup::new(&settings, &metadata)?;
    let header = match arguments.resume {
        true => Some(checkpoint::read(&last).map_err(|bad| {
            bad.advice(match last.exists() {
                true => "another --out; --init best.safetensors takes over what is still good",
                false => "train without --resume to begin",
            })
        })?),
        false => None,
    };
    if let Some(header) = &header {
        resumes(&header.settings, &settings, header.setup == setup)?;
        if settings.steps < header.step {
            return Err(BadInput::new(format!(
                "steps = {}, but the training is at step {}",
                settings.steps, header.step
            ))
            .place(format!("--out {}", folder.display()))
            .allowed(format!("--steps {} or more", header.step))
            .into());
        }
    } else if last.exists() {
        return Err(BadInput::new(format!("{} holds a training already", folder.display()))
            .place(format!("--out {}", folder.display()))
            .allowed("a new folder")
            .advice("--resume to go on with it, or another --out")
            .into());
    }
    let train = read_split(data, &metadata, Split::Train).map_err(unreadable(data))?;
    let valid = read_split(data, &metadata, Split::Valid).map_err(unreadable(data))?;
    for (split, trajectories) in [("train.h5", &train), ("valid.h5", &valid)] {
        if trajectories.is_empty() {
            return Err(BadInput::new(format!("{split} holds no trajectory"))
                .place(format!("--data {}", data.display()))
                .allowed("at least one for training and one for validation")
                .advice("hydrograd generate --trajectories 4/2/2")
                .into());
        }
    }
    if let Some(longest) = valid.iter().max_by_key(|t| t.frames) {
        rollout::check_length(longest, 0, settings.validation_steps)
            .map_err(|bad| bad.advice("a smaller --set validation_steps"))?;
    }
    let model = setup.model(settings.seed, DType::F32)?;
    let state = match &header {
        Some(header) => {
            header.load_into(&*model, false)?;
            header.state(&*model)?
        }
        None => {
            if let Some((from, header)) = &init {
                if header.setup.sizes != setup.sizes || header.setup.kind != setup.kind {
                    let own = |setup: &Setup| {
                        let serde_json::Value::Object(mut all) = json!(setup.sizes) else { return Vec::new() };
                        all.insert("kind".into(), json!(setup.kind));
                        all.into_iter().collect::<Vec<_>>()
                    };
                    let differing: Vec<String> = own(&header.setup)
                        .into_iter()
                        .zip(own(&setup))
                        .filter(|(theirs, ours)| theirs != ours)
                        .map(|((key, theirs), (_, ours))| format!("{key} = {theirs}, not {ours}"))
                        .collect();
                    return Err(BadInput::new(format!("its model has {}", differing.join(", ")))
                    .place(format!("--init {}", from.display()))
                    .allowed("a model of the same kind and sizes")
                    .advice("leave --config and --set model.* out: the sizes are the file's then; data with heat for a model with heat")
                    .into());
                }
                header.load_into(&*model, true)?;
            }
            fresh(&settings, &*model)?
        }
    };
    prepare_output_folder(&folder)?;
    let lock = alone(&folder)?;
    write_bytes_atomically(&kept, settings.text().as_bytes())?;
    let step = state.step;
    let (history, validation) =
        (read_rows(&folder.join("history.csv"), step)?, read_rows(&folder.join("validation.csv"), step)?);
    let (history, validation) = if header.is_some() { (history, validation) } else { (Vec::new(), Vec::new()) };
    let bar = Progress::new(settings.steps, "train");
    let parameters: usize = model.parameters().iter().map(|p| p.count()).sum();
    bar.line(&format!("{parameters} parameters, {} training trajectories of {} frames", train.len(), train[0].frames));
    let mut training = Training {
        settings: &settings,
        setup: &setup,
        metadata: &metadata,
        train: &train,
        valid: &valid,
        model: Arc::from(model),
        state,
        folder: folder.clone(),
        history,
        validation,
    };
    let outcome = training.run(&bar)?;
    bar.finish();

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
        "{} steps, {:.1} s in all, {:.1} ms per update; best validation at step {}",
        settings.steps,
        training.state.seconds,
        1e3 * outcome.seconds_per_step,
        outcome.best_step.map_or("none".to_owned(), |step| step.to_string())
    );
    println!("best.safetensors, last.safetensors, history.csv, validation.csv, curves.png in {}", folder.display());
    // Best effort: a lock that nobody holds is in nobody's way.
    drop(lock);
    let _ = std::fs::remove_file(folder.join(LOCK));
    println!(
        "next: hydrograd evaluate --model {} --data {} --split test",
        folder.join("best.safetensors").display(),
        data.display()
    );
    Ok(())
}

/// Held while a training writes to a folder: two would take turns in overwriting each other's checkpoints.
const LOCK: &str = "train.lock";

fn alone(folder: &Path) -> anyhow::Result<File> {
    let path = folder.join(LOCK);
    let lock = File::create(&path).map_err(|source| FileError::write(&path, source))?;
    match lock.try_lock() {
        Err(TryLockError::WouldBlock) => Err(BadInput::new("another training is writing to this folder")
            .place(format!("--out {}", folder.display()))
            .allowed("one training at a time")
            .advice("wait until it ends, stop it, or another --out")
            .into()),
        // Some file systems have no locks: then nothing can be said.
        _ => Ok(lock),
    }
}

/// An error if the settings differ in more than how long to go on and how often to say so.
fn resumes(before: &Settings, now: &Settings, same_setup: bool) -> Result<(), BadInput> {
    let mut same = now.clone();
    same.steps = before.steps;
    same.log_every = before.log_every;
    same.validate_every = before.validate_every;
    same.store_every = before.store_every;
    same.validation_windows = before.validation_windows;
    same.validation_steps = before.validation_steps;
    if same == *before && same_setup {
        return Ok(());
    }
    let table = |settings: &Settings| settings.text().parse::<toml::Table>().unwrap_or_default();
    let (before, now) = (table(before), table(&same));
    let differing: Vec<String> = before
        .iter()
        .chain(now.iter().filter(|(key, _)| !before.contains_key(*key)))
        .filter(|(key, _)| before.get(*key) != now.get(*key))
        .map(|(key, _)| {
            let shown = |table: &toml::Table| table.get(key).map_or("nothing".to_owned(), |value| value.to_string());
            format!("{key} was {} and is {}", shown(&before), shown(&now))
        })
        .collect();
    let problem = match differing.is_empty() {
        true => "the data differ from those that the training began with".to_owned(),
        false => format!("the settings differ from those that the training began with: {}", differing.join("; ")),
    };
    Err(BadInput::new(problem)
        .allowed("the same but for steps, log_every, validate_every, store_every and validation_*")
        .advice("begin anew in another --out; --init takes over the parameters"))
}
