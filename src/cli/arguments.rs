//! Options that several commands share. Each option that overrides a configuration key becomes a [`Setting`].

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use clap::{Args, Command, ValueEnum};

use crate::config::builtin;
use crate::config::device::DeviceName;
use crate::config::layers::Setting;
use crate::config::scene::{Config, GradientMode, Kernels, Precision};
use crate::config::suggest::is_key;
use crate::error::{BadInput, Error};
use crate::scene::load::Loaded;
use crate::scene::require_design;

/// Options that stand for a key of the scene.
pub const OPTIONS: [(&str, &str); 14] = [
    ("--precision", "run.precision"),
    ("--threads", "run.threads"),
    ("--seed", "run.seed"),
    ("--kernels", "run.kernels"),
    ("--device", "run.device"),
    ("--gradient", "optimise.gradient"),
    ("--memory", "optimise.memory"),
    ("--store", "optimise.store"),
    ("--segment", "optimise.segment"),
    ("--horizon", "optimise.horizon"),
    ("--epochs", "optimise.epochs"),
    ("--dynamics", "optimise.dynamics"),
    ("--model", "surrogate.model"),
    ("--trust", "surrogate.trust"),
];

/// Options that are no key of a configuration but stand in the library's advice as if they were.
const OWN_OPTIONS: [(&str, &str); 4] =
    [("--trajectories", "trajectories"), ("--frames", "frames"), ("--skip", "skip"), ("--steps", "steps")];

/// Options of every run.
#[derive(Debug, Clone, Args)]
pub struct CommonArguments {
    /// Built-in scene (`hydrograd scenes` lists them) or TOML file [default: heated-channel].
    #[arg(value_name = "SCENE")]
    pub scene: Option<String>,
    /// Override a key of the scene, e.g. `--set time.end=1.5`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Lay a preset over the scene: report, report-jax-sph.
    #[arg(long, value_name = "NAME")]
    pub preset: Option<String>,
    /// Folder for the results [default: runs/COMMAND-SCENE].
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Particle spacing (resolution.dx) [default: the scene's].
    #[arg(long, value_name = "LENGTH", allow_hyphen_values = true)]
    pub dx: Option<String>,
    /// Time at which the run ends (time.end) [default: the scene's].
    #[arg(long, value_name = "TIME", allow_hyphen_values = true)]
    pub end: Option<String>,
    /// How the scene is solved: consistent, standard or fixed (method.name) [default: the scene's].
    #[arg(long = "method", value_name = "NAME")]
    pub method_name: Option<String>,
    /// Floating-point type (run.precision) [default: the scene's].
    #[arg(long, value_enum)]
    pub precision: Option<Precision>,
    /// Worker threads, 0 for every core that the process may use (run.threads) [default: the scene's].
    #[arg(long, value_name = "N", value_parser = threads, allow_hyphen_values = true)]
    pub threads: Option<usize>,
    /// Seed of every random number (run.seed) [default: the scene's].
    // TOML's integers are signed.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..=i64::MAX as u64))]
    pub seed: Option<u64>,
    /// Implementation of the operators (run.kernels) [default: the scene's].
    #[arg(long, value_enum)]
    pub kernels: Option<Kernels>,
    /// Where the operators run: cpu, cuda or cuda:N; a GPU takes composed ones (run.device) [default: the scene's].
    #[arg(long, value_name = "DEVICE")]
    pub device: Option<DeviceName>,
}

/// Going on with an earlier run.
#[derive(Debug, Clone, Args)]
pub struct ResumeArgument {
    /// Go on with the run in this folder, with its configuration; results go there too unless --out is given.
    #[arg(long, value_name = "DIR", conflicts_with_all = ["scene", "preset"])]
    pub resume: Option<PathBuf>,
}

/// Losing an earlier run.
#[derive(Debug, Clone, Args)]
pub struct OverwriteArgument {
    /// Begin anew in a folder that holds an earlier run of this command: its files are lost.
    #[arg(long, conflicts_with = "resume")]
    pub overwrite: bool,
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
    /// Memory that the gradient may use, such as 200MB: picks every state, every k-th or binomial (optimise.memory).
    // A negative amount is refused as one, not as an unknown option.
    #[arg(long, value_name = "SIZE", allow_hyphen_values = true)]
    pub memory: Option<String>,
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

impl CommonArguments {
    /// An error if the scene has no design, before any key of one is looked at.
    pub(super) fn require_design(&self) -> Result<(), Error> {
        // What is wrong with the scene itself may be put right by an option.
        let scene = Config::load_settings(self.scene.as_deref(), None, &[]);
        Ok(scene.map_or(Ok(()), |loaded| require_design(&loaded.config))?)
    }

    /// Loads the scene with `defaults` below and `options` above what the user set.
    pub(super) fn load(
        &self,
        resume: Option<&Path>,
        defaults: Vec<Setting>,
        options: Vec<Setting>,
    ) -> Result<Loaded, Error> {
        let mut settings = defaults;
        settings.extend(self.sets.iter().map(|text| set_option(text)));
        let plain = [
            ("--dx", "resolution.dx", &self.dx),
            ("--end", "time.end", &self.end),
            ("--method", "method.name", &self.method_name),
        ];
        settings.extend(given(plain));
        settings.extend(self.precision.map(|value| option("run.precision", name_of(value))));
        settings.extend(self.threads.map(|value| option("run.threads", value)));
        settings.extend(self.seed.map(|value| option("run.seed", value)));
        settings.extend(self.kernels.map(|value| option("run.kernels", name_of(value))));
        settings.extend(self.device.map(|value| option("run.device", value)));
        settings.extend(options);
        let Some(folder) = resume else {
            check_preset(self.preset.as_deref())?;
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
    pub(super) fn folder(&self, resume: Option<&Path>, subcommand: &str, loaded: &Loaded) -> Result<PathBuf, Error> {
        let given = self.out.as_deref().or(resume).map(Path::to_path_buf);
        let folder = given.unwrap_or_else(|| Path::new("runs").join(format!("{subcommand}-{}", loaded.source.name())));
        check_writable(&folder)?;
        Ok(folder)
    }
}

/// Checks that the name of `out` is text.
pub(super) fn check_text(out: &Path) -> Result<(), BadInput> {
    let bad = || BadInput::new("a name that is not text (UTF-8), which files of results could not hold");
    let bad = || bad().place(format!("--out {}", out.display())).allowed("a name of UTF-8 text");
    out.to_str().map(drop).ok_or_else(bad)
}

/// Checks that `folder` is one or can be created, without leaving anything behind.
pub(super) fn check_writable(folder: &Path) -> Result<(), BadInput> {
    let bad = |problem: String| {
        BadInput::new(problem)
            .place(format!("--out {}", folder.display()))
            .allowed("a folder that can be written to, or a new one")
    };
    check_text(folder)?;
    let existing = folder.ancestors().find(|path| path.exists()).unwrap_or(Path::new("."));
    if !existing.is_dir() {
        return Err(bad(format!("{} is a file", existing.display())));
    }
    let trial = tempfile::tempfile_in(existing);
    trial.map(drop).map_err(|error| bad(format!("can not write to {}: {error}", existing.display())))
}

impl GradientArguments {
    pub(super) fn settings(&self) -> Vec<Setting> {
        let settings = [
            self.method.map(|value| option("optimise.gradient", name_of(value))),
            self.memory.as_ref().map(|size| option("optimise.memory", size)),
            self.store.map(|value| option("optimise.store", name_of(value))),
            self.segment.map(|value| option("optimise.segment", value)),
            self.horizon.map(|value| option("optimise.horizon", value)),
        ];
        settings.into_iter().flatten().collect()
    }
}

/// The option that stands for a key.
fn option_of(key: &str) -> Option<&'static str> {
    OPTIONS.iter().chain(&OWN_OPTIONS).find(|(_, own)| *own == key).map(|(option, _)| *option)
}

/// The options of the command that runs.
static OF_COMMAND: OnceLock<Vec<String>> = OnceLock::new();

/// Remembers which options there are: advice names no others.
pub(super) fn runs(command: &Command) {
    let options = command.get_arguments().filter_map(|argument| Some(format!("--{}", argument.get_long()?)));
    // The first call counts.
    let _ = OF_COMMAND.set(options.collect());
}

fn is_there(option: &str) -> bool {
    OF_COMMAND.get().is_none_or(|all| all.iter().any(|one| one == option))
}

/// The setting of a key that has an option of its own.
pub(super) fn option(key: &str, value: impl std::fmt::Display) -> Setting {
    Setting::option(option_of(key).expect("the key has an option"), key, value)
}

/// The settings of options that are values of keys as they were written: option, key, value.
pub(super) fn given(plain: [(&str, &str, &Option<String>); 3]) -> Vec<Setting> {
    let setting = |(option, key, value): (&str, &str, &Option<String>)| {
        value.as_ref().map(|value| Setting::option(option, key, value))
    };
    plain.into_iter().filter_map(setting).collect()
}

/// The setting of `--set`, which names itself so in messages.
pub(super) fn set_option(assignment: &str) -> Setting {
    Setting { label: format!("--set {assignment}"), ..Setting::set(assignment) }
}

/// An error if there is no such preset.
pub(super) fn check_preset(name: Option<&str>) -> Result<(), BadInput> {
    let Some(name) = name else { return Ok(()) };
    builtin::preset(name).map(drop).map_err(|bad| bad.place(format!("--preset {name}")))
}

/// The library's advice names keys (`time.cfl=1`); here each such assignment becomes the option to give
/// (`--set time.cfl=1`, `--memory 20MB`). The other lines of a message stay.
pub fn with_options(message: &str) -> String {
    let lines = message.split('\n').map(|line| match line.strip_prefix(ADVICE) {
        Some(advice) => format!("{ADVICE}{}", options_in(advice)),
        None => line.to_string(),
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// What the line of advice in a message begins with.
const ADVICE: &str = "  try: ";

fn options_in(advice: &str) -> String {
    let (mut words, mut before) = (Vec::new(), "");
    for word in advice.split(' ') {
        // `(time.cfl=1)` begins with a bracket.
        let bare = word.trim_start_matches(['(', '`']);
        let shown = match bare.split_once('=') {
            Some((key, value)) if is_key(key) && !before.starts_with("--") => {
                match option_of(key).filter(|it| is_there(it)) {
                    Some(option) => format!("{option} {value}"),
                    None => format!("--set {bare}"),
                }
            }
            _ => bare.to_string(),
        };
        words.push(format!("{}{shown}", &word[..word.len() - bare.len()]));
        before = word;
    }
    words.join(" ")
}

/// The name of a value as the command line and the configuration spell it.
pub(super) fn name_of(value: impl ValueEnum) -> String {
    let value = value.to_possible_value().expect("no value is hidden");
    value.get_name().to_string()
}

/// Most threads that can be asked for: beyond this it is a slip of the pen.
const MOST_THREADS: usize = 1024;

/// A number of threads, for every command the same.
pub(super) fn threads(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count <= MOST_THREADS => Ok(count),
        _ => Err(format!("allowed: whole numbers from 0 (every core that the process may use) to {MOST_THREADS}")),
    }
}

pub(super) fn at_least_one(text: &str) -> Result<usize, String> {
    match text.parse() {
        Ok(count) if count >= 1 => Ok(count),
        _ => Err("allowed: a whole number, at least 1".into()),
    }
}
