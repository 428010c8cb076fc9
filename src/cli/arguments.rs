//! Options of every subcommand. Each option that overrides a configuration key becomes a [`Setting`].

use std::path::{Path, PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};

use super::generate::{parse_trajectories, Shard};
use super::prepare::require_design;
use crate::cli::bench::BenchArguments;
use crate::config::layers::Setting;
use crate::config::scene::{Config, GradientMode, Kernels, Precision, ShapeName};
use crate::dataset::recipe::Recipe;
use crate::dataset::trajectory::Split;
use crate::dataset::walls::{read_walls, Walls};
use crate::error::{BadInput, Error};
use crate::scene::load::Loaded;

/// Steps that `check-gradient` differentiates unless told otherwise.
const CHECK_STEPS: usize = 500;

/// Differentiable particle flow: simulate a fluid by SPH and shape its walls by exact gradients.
#[derive(Debug, Parser)]
#[command(name = "hydrograd", version, arg_required_else_help = true)]
#[command(after_help = "Begin with `hydrograd optimize`. `hydrograd help COMMAND` has examples.")]
pub struct Cli {
    #[command(subcommand)]
    pub command: Command,
}

#[derive(Debug, Subcommand)]
pub enum Command {
    Simulate(SimulateArguments),
    #[command(visible_alias = "optimise")]
    Optimize(OptimizeArguments),
    CheckGradient(CheckGradientArguments),
    Train(TrainArguments),
    Evaluate(super::EvaluateArguments),
    Rollout(super::RolloutArguments),
    Study(super::StudyArguments),
    Bench(BenchArguments),
    Generate(GenerateArguments),
    Merge(MergeArguments),
    /// Look at a data set.
    Dataset {
        #[command(subcommand)]
        command: DatasetCommand,
    },
    Scenes(ScenesArguments),
}

/// Simulate a scene with its start shape; writes figures, plots and ParaView frames.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd simulate
      the heated channel with a flat wall
  hydrograd simulate --set design.shape=sine --set design.amplitude=0.02 --out runs/sine
      with a sine-shaped wall
  hydrograd simulate --set design.file=runs/optimize-heated-channel/shape.csv --set resolution.dx=0.01
      the optimum of a run again, at half the spacing
  hydrograd simulate --explain
      what a step would do, and nothing is run
  hydrograd simulate taylor-green --set resolution.dx=0.01
      a flow with an exact solution (`hydrograd scenes` lists more), and how far from it the particles end
  hydrograd simulate my.toml --precision f32 --threads 2
      a scene of your own: `hydrograd scenes heated-channel > my.toml` to begin with")]
pub struct SimulateArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
}

/// Shape the hot wall so that the fluid carries out more heat (the main job).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd optimize
      the heated channel from a flat wall, in less than a minute on two cores
  hydrograd optimize --start all --out runs/starts
      from four start shapes, compared in one plot
  hydrograd optimize --preset report --start random --seed 7
      the original report's settings, from a random wall
  hydrograd optimize --memory 20MB --explain
      the schedule that fits into 20 MB, with its storage and the steps run again
  hydrograd optimize --resume runs/optimize-heated-channel --epochs 80
      go on with a run, up to 80 epochs in all")]
pub struct OptimizeArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub resume: ResumeArgument,
    #[command(flatten)]
    pub explain: ExplainArgument,
    #[command(flatten)]
    pub gradient: GradientArguments,
    /// Start shape (design.shape); `all` runs flat, random, linear and sine and compares them.
    #[arg(long, value_enum)]
    pub start: Option<StartName>,
    /// Optimiser steps (optimise.epochs).
    #[arg(long, value_name = "N")]
    pub epochs: Option<usize>,
}

/// Compare the design gradient with central differences; fails (exit code 1) if they disagree.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd check-gradient
      500 steps of the heated channel, objective at the last step
  hydrograd check-gradient --steps 100 --directions 5
      quicker, along five random directions
  hydrograd check-gradient --precision f32 --set design.shape=sine
      in single precision, at a sine-shaped wall
  hydrograd check-gradient --steps 500 --set objective.window=0.2
      with an objective averaged over a window")]
pub struct CheckGradientArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    #[command(flatten)]
    pub gradient: GradientArguments,
    /// Steps to differentiate. The objective is then taken at the last step, unless
    /// `--set objective.window=...` says otherwise.
    #[arg(long, value_name = "N", default_value_t = CHECK_STEPS)]
    pub steps: usize,
    /// Random directions to compare along.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = at_least_one)]
    pub directions: usize,
}

/// Make a data set of trajectories, to train a surrogate with (LagrangeBench's layout, with temperature).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Frames are --every reference steps apart, the first one after --skip of them. A reference step is that of JAX-SPH at its
Courant number (0.25; 0.22 for LagrangeBench's flows): 4.5e-4 in the heated channel. The run itself takes larger ones, as
large as time.cfl allows, and gives the same physical times; --set time.cfl=0.25 takes the reference's own.

Each trajectory is a file in DIR/parts until all are there; then they are merged into train.h5, valid.h5, test.h5 and
metadata.json. A run that was stopped goes on where it was: give the same command again. The same seed gives the same
bytes whatever the shards and threads.

Examples:
  hydrograd generate heated-channel --out data/heated
      100/50/50 trajectories of the heated channel, each with a wall of its own
  hydrograd generate heated-channel --trajectories 8/2/2 --frames 60 --walls smooth --set design.bound=0.04
      fewer, with smooth random walls up to 0.04
  hydrograd generate heated-channel --set design.file=shape.csv --out data/one-wall
      one wall for all, from a file (or --set design.offsets=[0.0,0.01,...])
  hydrograd generate heated-channel --walls-file walls.csv --trajectories 4/1/1 --out data/given
      six walls of your own: six lines of 25 offsets
  hydrograd generate taylor-green --seed 7
      LagrangeBench's 2D Taylor-Green vortices
  hydrograd generate heated-channel --out data/heated --shard 0/4
      the first of four shares, perhaps on another machine with the same disk; in a Slurm job array
      (sbatch --array=0-3) --shard follows from the array")]
pub struct GenerateArguments {
    #[command(flatten)]
    pub common: CommonArguments,
    /// Trajectories for training, validation and test [default: 100/50/50 for the heated channel].
    #[arg(long, value_name = "TRAIN/VALID/TEST", value_parser = parse_trajectories)]
    pub trajectories: Option<[usize; 3]>,
    /// Frames per trajectory [default: 147 for the heated channel].
    #[arg(long, value_name = "N")]
    pub frames: Option<usize>,
    /// Reference steps from frame to frame [default: 100].
    #[arg(long, value_name = "N")]
    pub every: Option<usize>,
    /// Reference steps before the first frame [default: 300 for the heated channel].
    #[arg(long, value_name = "N")]
    pub skip: Option<usize>,
    /// Flows: reference steps in which a random start comes to rest before time 0 [default: 5000 where LagrangeBench has
    /// them].
    #[arg(long, value_name = "N")]
    pub relax: Option<usize>,
    /// Walls of the heated channel [default: mix, or scene where the scene's own design is given].
    #[arg(long, value_enum)]
    pub walls: Option<Walls>,
    /// Walls from a file: a line per wall, its offsets at the design's nodes, separated by commas; trajectories take them in
    /// turns.
    #[arg(long, value_name = "FILE", conflicts_with = "walls")]
    pub walls_file: Option<PathBuf>,
    /// Make the I-th of N shares only, I from 0 [default: from a Slurm job array, else all].
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
}

/// Put the trajectories of all shards together (`generate` does it itself when the last one is there).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd merge data/heated
      train.h5, valid.h5, test.h5 and metadata.json from data/heated/parts")]
pub struct MergeArguments {
    /// The --out of `hydrograd generate`.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
}

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

/// What to do with a data set.
#[derive(Debug, Clone, Subcommand)]
pub enum DatasetCommand {
    Inspect(InspectArguments),
}

/// Print what a data set holds (trajectories, particles, statistics, heat, walls) and plot a few frames.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd dataset inspect data/heated
      a summary, and three frames of the first trajectory in data/heated/frames.png
  hydrograd dataset inspect 2D_TGV_2500_10kevery100 --split test --trajectory 3 --out pictures
      LagrangeBench's own data sets too")]
pub struct InspectArguments {
    /// A folder with train.h5, valid.h5, test.h5 and metadata.json.
    #[arg(value_name = "DIR")]
    pub folder: PathBuf,
    /// The file that the plotted trajectory is in.
    #[arg(long, value_enum, default_value = "train")]
    pub split: Split,
    /// Its number in the file.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub trajectory: usize,
    /// Frames to plot, evenly spaced.
    #[arg(long, value_name = "N", default_value_t = 3, value_parser = at_least_one)]
    pub frames: usize,
    /// Folder for frames.png and frames.svg [default: DIR].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
}

/// List the built-in scenes and presets, or print a scene as TOML.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd scenes
      what there is
  hydrograd scenes heated-channel > my.toml
      every key with its meaning, unit and range, to change and run
  hydrograd scenes heated-channel --preset report
      the same with a preset's values")]
pub struct ScenesArguments {
    /// Scene to print.
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Lay a preset over it.
    #[arg(long, value_name = "NAME", requires = "scene")]
    pub preset: Option<String>,
}

/// Options of every run.
#[derive(Debug, Clone, Args)]
pub struct CommonArguments {
    /// Built-in scene (`hydrograd scenes` lists them) or TOML file [default: heated-channel].
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Override a key of the scene, e.g. `--set time.end=1.5`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Lay a preset over the scene: report.
    #[arg(long, value_name = "NAME")]
    pub preset: Option<String>,
    /// Folder for the results [default: runs/COMMAND-SCENE].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Floating-point type (run.precision).
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Worker threads, 0 for every core (run.threads).
    #[arg(long, value_name = "N")]
    pub threads: Option<usize>,
    /// Seed of every random number (run.seed).
    // TOML's integers are signed.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Implementation of the operators (run.kernels).
    #[arg(long, value_enum)]
    pub kernels: Option<Kernels>,
}

/// Going on with an earlier run.
#[derive(Debug, Clone, Args)]
pub struct ResumeArgument {
    /// Go on with the run in this folder, with its configuration; results go there too unless --out is given.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scene", "preset"])]
    pub resume: Option<PathBuf>,
}

/// What gradients may use.
#[derive(Debug, Clone, Args)]
pub struct MemoryArgument {
    /// Memory that the gradient may use, such as 200MB: picks every state, every k-th or binomial (optimise.memory).
    // A negative amount is refused as one, not as an unknown option.
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true)]
    pub memory: Option<String>,
}

impl MemoryArgument {
    fn setting(&self) -> Option<Setting> {
        self.memory.as_ref().map(|size| Setting::option("--memory", "optimise.memory", size))
    }
}

/// Showing what would be done.
#[derive(Debug, Clone, Args)]
pub struct ExplainArgument {
    /// Print the plan (operators, fields, what was left out and why, pairs, bytes, time step, schedule) and stop.
    #[arg(long)]
    pub explain: bool,
}

/// How gradients are computed.
#[derive(Debug, Clone, Args)]
pub struct GradientArguments {
    /// Method (optimise.gradient): segments and taped are exact, truncated is not.
    #[arg(long = "gradient", value_name = "METHOD", value_enum)]
    pub method: Option<GradientMode>,
    #[command(flatten)]
    pub memory: MemoryArgument,
    /// Precision of kept states: f32 halves their memory, but the gradient is not exact then (optimise.store).
    #[arg(long, value_enum, value_name = "PRECISION")]
    pub store: Option<Precision>,
    /// Steps per segment instead of a schedule chosen by --memory, 0 to choose (optimise.segment).
    #[arg(long, value_name = "N")]
    pub segment: Option<usize>,
    /// Steps that `truncated` looks back (optimise.horizon).
    #[arg(long, value_name = "N")]
    pub horizon: Option<usize>,
}

/// Start shapes of `optimize`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum StartName {
    Flat,
    Random,
    Linear,
    Sine,
    /// Each of the others in turn.
    All,
}

impl StartName {
    /// The shapes that `--start all` compares.
    pub const EACH: [Self; 4] = [Self::Flat, Self::Random, Self::Linear, Self::Sine];

    /// The setting that selects this shape; none for `all`.
    pub fn setting(self) -> Option<Setting> {
        (self != Self::All).then(|| Setting::option("--start", "design.shape", name_of(self)))
    }
}

impl CommonArguments {
    /// An error if the scene has no design, before any key of one is looked at.
    fn require_design(&self) -> Result<(), Error> {
        Ok(require_design(&Config::load_settings(self.scene.as_deref(), None, &[])?.config)?)
    }

    /// Loads the scene with `defaults` below and `options` above what the user set.
    fn load(&self, resume: Option<&Path>, defaults: Vec<Setting>, options: Vec<Setting>) -> Result<Loaded, Error> {
        let mut settings = defaults;
        settings.extend(self.sets.iter().map(|text| Setting::set(text)));
        let own = [
            self.precision.map(|value| Setting::option("--precision", "run.precision", name_of(value))),
            self.threads.map(|value| Setting::option("--threads", "run.threads", value)),
            self.seed.map(|value| Setting::option("--seed", "run.seed", value)),
            self.kernels.map(|value| Setting::option("--kernels", "run.kernels", name_of(value))),
        ];
        settings.extend(own.into_iter().flatten());
        settings.extend(options);
        let Some(folder) = resume else {
            return Config::load_settings(self.scene.as_deref(), self.preset.as_deref(), &settings);
        };
        let file = folder.join("config.toml");
        if !file.is_file() {
            return Err(BadInput::new(format!("there is no run to resume: no file {}", file.display()))
                .place(format!("--resume {}", folder.display()))
                .allowed("the folder of an earlier run (its --out)")
                .into());
        }
        Config::load_settings(Some(&file.to_string_lossy()), None, &settings)
    }

    /// Where results go; an error if nothing can be written there.
    fn folder(&self, resume: Option<&Path>, subcommand: &str, loaded: &Loaded) -> Result<PathBuf, Error> {
        let given = self.out.as_deref().or(resume).map(Path::to_path_buf);
        let folder = given.unwrap_or_else(|| Path::new("runs").join(format!("{subcommand}-{}", loaded.source.name())));
        check_writable(&folder)?;
        Ok(folder)
    }
}

/// An error if a folder holds a file that only another command leaves.
pub(super) fn check_own(folder: &Path, others: &[&str], allowed: &str) -> Result<(), BadInput> {
    match others.iter().find(|file| folder.join(file).exists()) {
        Some(file) => Err(BadInput::new(format!("the folder holds {file}, so it belongs to another command"))
            .place(format!("--out {}", folder.display()))
            .allowed(allowed)
            .advice("another --out")),
        None => Ok(()),
    }
}

/// Checks that `folder` is one or can be created, without leaving anything behind.
pub(super) fn check_writable(folder: &Path) -> Result<(), BadInput> {
    let bad = |problem: String| {
        BadInput::new(problem)
            .place(format!("--out {}", folder.display()))
            .allowed("a folder that can be written to, or a new one")
    };
    let existing = folder.ancestors().find(|path| path.exists()).unwrap_or(Path::new(""));
    let existing = match existing.as_os_str().is_empty() {
        true => Path::new("."),
        false => existing,
    };
    if !existing.is_dir() {
        return Err(bad(format!("{} is a file", existing.display())));
    }
    match tempfile::tempfile_in(existing) {
        Ok(_) => Ok(()),
        Err(error) => Err(bad(format!("can not write to {}: {error}", existing.display()))),
    }
}

impl GradientArguments {
    fn settings(&self) -> Vec<Setting> {
        let settings = [
            self.method.map(|value| Setting::option("--gradient", "optimise.gradient", name_of(value))),
            self.memory.setting(),
            self.store.map(|value| Setting::option("--store", "optimise.store", name_of(value))),
            self.segment.map(|value| Setting::option("--segment", "optimise.segment", value)),
            self.horizon.map(|value| Setting::option("--horizon", "optimise.horizon", value)),
        ];
        settings.into_iter().flatten().collect()
    }
}

impl SimulateArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.load(self.resume.resume.as_deref(), vec![], vec![])
    }

    /// Where results go; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(self.resume.resume.as_deref(), "simulate", loaded)
    }
}

impl OptimizeArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.require_design()?;
        let mut options = self.gradient.settings();
        options.extend(self.epochs.map(|value| Setting::option("--epochs", "optimise.epochs", value)));
        options.extend(self.start.and_then(StartName::setting));
        self.common.load(self.resume.resume.as_deref(), vec![], options)
    }

    /// Where results go; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(self.resume.resume.as_deref(), "optimize", loaded)
    }
}

impl CheckGradientArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.require_design()?;
        // Below the user's own settings, so that `--set objective.window=...` wins; the scene's window may be
        // longer than the steps checked.
        let defaults = vec![Setting::option("--steps", "time.steps", self.steps), Setting::set("objective.window=0")];
        self.common.load(None, defaults, self.gradient.settings())
    }

    /// Where results go; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(None, "check-gradient", loaded)
    }
}

impl GenerateArguments {
    pub fn load(&self) -> Result<Loaded, Error> {
        self.common.load(None, vec![], vec![])
    }

    /// Where the data set goes; an error if nothing can be written there.
    pub fn folder(&self, loaded: &Loaded) -> Result<PathBuf, Error> {
        self.common.folder(None, "generate", loaded)
    }

    /// The scene's recipe with what was given.
    pub fn recipe(&self, loaded: &Loaded) -> Result<Recipe, Error> {
        let usual = Recipe::of(loaded.config.scene);
        let design = &loaded.config.design;
        let own = design.offsets.is_some() || design.shape != ShapeName::Flat;
        let given = self.walls_file.as_deref().map_or(Ok(Vec::new()), read_walls)?;
        Ok(Recipe {
            trajectories: self.trajectories.unwrap_or(usual.trajectories),
            frames: self.frames.unwrap_or(usual.frames),
            every: self.every.unwrap_or(usual.every),
            skip: self.skip.unwrap_or(usual.skip),
            relax: self.relax.unwrap_or(usual.relax),
            walls: match self.walls {
                None if self.walls_file.is_some() => Walls::File,
                None if own => Walls::Scene,
                walls => walls.unwrap_or(usual.walls),
            },
            given,
        })
    }

    /// The share to make.
    pub fn shard(&self) -> Result<Shard, Error> {
        match self.shard {
            Some(shard) => Ok(shard),
            None => Ok(Shard::from_slurm(|name| std::env::var(name).ok())?.unwrap_or(Shard::ALL)),
        }
    }
}

/// The name of a value as the command line and the configuration spell it.
pub(super) fn name_of(value: impl ValueEnum) -> String {
    let value = value.to_possible_value().expect("no value is hidden");
    value.get_name().to_string()
}

pub(super) fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count >= 1 => Ok(count),
        _ => Err("allowed: a whole number, at least 1".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    #[test]
    fn command_line_is_consistent() {
        Cli::command().debug_assert();
    }

    fn parse(line: &str) -> Command {
        Cli::try_parse_from(line.split(' ')).unwrap().command
    }

    #[test]
    fn options_override_keys() {
        let line = "hydrograd optimize --precision f32 --threads 2 --seed 9 --kernels composed --gradient truncated \
                    --segment 7 --memory 1.5GiB --store f32 --horizon 30 --epochs 3 --start random --set run.threads=5 --set time.end=1";
        let Command::Optimize(arguments) = parse(line) else { panic!("not optimize") };
        let loaded = arguments.load().unwrap();
        let mut expected = Config::default();
        expected.run.precision = Precision::F32;
        expected.run.threads = 2;
        expected.run.seed = 9;
        expected.run.kernels = Kernels::Composed;
        expected.optimise.gradient = GradientMode::Truncated;
        expected.optimise.segment = 7;
        expected.optimise.memory = crate::config::memory_size::MemorySize(3 << 29);
        expected.optimise.store = Precision::F32;
        expected.optimise.horizon = 30;
        expected.optimise.epochs = 3;
        expected.design.shape = crate::config::scene::ShapeName::Random;
        expected.time.end = 1.0;
        assert_eq!(loaded.config, expected);
        let folder = arguments.folder(&loaded).unwrap();
        assert_eq!(folder, Path::new("runs/optimize-heated-channel"));
    }

    #[test]
    fn check_gradient_takes_the_last_step_unless_told() {
        let Command::CheckGradient(arguments) = parse("hydrograd check-gradient --steps 20") else {
            panic!("not check-gradient")
        };
        let config = arguments.load().unwrap().config;
        assert_eq!((config.time.steps, config.objective.window), (Some(20), 0.0));
        let line = "hydrograd check-gradient --steps 200 --set objective.window=0.1";
        let Command::CheckGradient(arguments) = parse(line) else { panic!("not check-gradient") };
        let config = arguments.load().unwrap().config;
        assert_eq!((config.time.steps, config.objective.window), (Some(200), 0.1));
    }

    #[test]
    fn resume_reads_the_run_and_stays_in_its_folder() {
        let folder = tempfile::tempdir().unwrap();
        let text = Config::load(None, None, &["run.seed=4".into()]).unwrap().text;
        std::fs::write(folder.path().join("config.toml"), text).unwrap();
        let line = format!("hydrograd optimize --epochs 40 --resume {}", folder.path().display());
        let Command::Optimize(arguments) = parse(&line) else { panic!("not optimize") };
        let loaded = arguments.load().unwrap();
        assert_eq!((loaded.config.run.seed, loaded.config.optimise.epochs), (4, 40));
        assert_eq!(arguments.folder(&loaded).unwrap(), folder.path());
    }
}
