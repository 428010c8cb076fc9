//! The command line: one file per subcommand.

mod arguments;
mod bench;
mod calibrate;
mod check_gradient;
mod completions;
mod dataset;
mod evaluate;
mod explain;
mod files;
mod generate;
pub mod grid;
pub(crate) mod guard;
mod machine;
mod model_data;
mod new;
mod optimize;
mod optimize_compare;
mod optimize_report;
mod optimize_search;
mod optimize_starts;
mod page;
pub(crate) mod prepare;
pub mod program;
mod recover;
mod rollout;
mod run_folder;
mod scenes;
mod shard;
mod simulate;
mod simulate_report;
mod slurm;
mod stress;
mod study;
mod train;
mod validate;
mod verify;

pub use crate::report::text::shown;
pub use guard::{guarded, install_panic_hook};

use clap::{Command as Line, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;

/// Differentiable particle flow: simulate a fluid by SPH and shape its walls by exact gradients.
#[derive(Debug, Parser)]
#[command(name = "hydrograd", version, arg_required_else_help = true)]
#[command(after_help = "\
Begin with `hydrograd optimize`. `hydrograd help COMMAND` has examples.

Exit codes: 0 done; 1 it failed (a full disk, gradients that disagree); 2 bad input, and nothing was written; 3 the run
diverged; 70 a bug in hydrograd; 130 and 143 stopped by Ctrl-C and SIGTERM, and can go on; 141 the reader of its output has gone.

RUST_LOG=hydrograd=debug (or info, trace) says on stderr what it does meanwhile.")]
pub struct Cli {
    /// One JSON document on stdout, errors too; what is meant for people goes to stderr.
    #[arg(long, global = true)]
    pub json: bool,
    #[command(subcommand)]
    pub command: Command,
}

pub fn parse(words: impl IntoIterator<Item = OsString>) -> Result<Cli, clap::Error> {
    Cli::from_arg_matches(&line().try_get_matches_from(words)?)
}

/// The command line, with paragraphs of its help as single lines, which clap wraps to the width of the terminal.
fn line() -> Line {
    // The commands share this option and its text, but not its default.
    let other = "Built-in scene (`hydrograd scenes` lists them) or TOML file [default: taylor-green]";
    unwrapped(Cli::command().mut_subcommand("recover", |recover| recover.mut_arg("scene", |scene| scene.help(other))))
}

/// Joins the paragraphs in the help of a command and its subcommands.
fn unwrapped(mut line: Line) -> Line {
    if let Some(text) = line.get_after_help().map(|text| in_paragraphs(&text.to_string())) {
        line = line.after_help(text);
    }
    if let Some(text) = line.get_after_long_help().map(|text| in_paragraphs(&text.to_string())) {
        line = line.after_long_help(text);
    }
    let names: Vec<String> = line.get_subcommands().map(|below| below.get_name().to_string()).collect();
    names.into_iter().fold(line, |line, name| line.mut_subcommand(name, unwrapped))
}

/// Joins the lines of each paragraph, and of the explanation of each example.
fn in_paragraphs(text: &str) -> String {
    let depth = |line: &str| line.len() - line.trim_start().len();
    let mut lines: Vec<String> = Vec::new();
    for line in text.lines() {
        match lines.last_mut() {
            // A line with two spaces is a command, which is not joined.
            Some(last)
                if !last.is_empty()
                    && !last.ends_with(':')
                    && !line.is_empty()
                    && depth(last) == depth(line)
                    && depth(line) != 2 =>
            {
                *last += " ";
                *last += line.trim_start();
            }
            _ => lines.push(line.to_string()),
        }
    }
    lines.join("\n")
}

#[derive(Debug, Subcommand)]
pub enum Command {
    Simulate(simulate::SimulateArguments),
    #[command(visible_alias = "optimise")]
    Optimize(optimize::OptimizeArguments),
    Verify(verify::VerifyArguments),
    Validate(validate::ValidateArguments),
    Stress(stress::StressArguments),
    CheckGradient(check_gradient::CheckGradientArguments),
    Recover(recover::RecoverArguments),
    Calibrate(calibrate::CalibrateArguments),
    Train(train::TrainArguments),
    Evaluate(evaluate::EvaluateArguments),
    Rollout(rollout::RolloutArguments),
    Study(study::StudyArguments),
    Bench(bench::BenchArguments),
    Generate(generate::GenerateArguments),
    Merge(generate::MergeArguments),
    /// Look at a data set.
    Dataset {
        #[command(subcommand)]
        command: dataset::DatasetCommand,
    },
    Compare(page::CompareArguments),
    Slurm(slurm::SlurmArguments),
    Scenes(scenes::ScenesArguments),
    New(new::NewArguments),
    Completions(completions::CompletionsArguments),
    Man(completions::ManArguments),
}

pub fn run(cli: Cli) -> anyhow::Result<()> {
    if cli.json {
        machine::begin()?;
    }
    env_logger::Builder::from_default_env().init();
    match cli.command {
        Command::Simulate(arguments) => simulate::run(arguments.load()?, arguments),
        Command::Optimize(arguments) => optimize::run(arguments.load()?, arguments),
        Command::Verify(arguments) => verify::run(arguments),
        Command::Validate(arguments) => validate::run(arguments),
        Command::Stress(arguments) => stress::run(arguments),
        Command::CheckGradient(arguments) => check_gradient::run(arguments.load()?, arguments),
        Command::Recover(arguments) => recover::run(arguments.load()?, arguments),
        Command::Calibrate(arguments) => calibrate::run(arguments),
        Command::Train(arguments) => train::run(arguments),
        Command::Evaluate(arguments) => evaluate::run(arguments),
        Command::Rollout(arguments) => rollout::run(arguments),
        Command::Study(arguments) => study::run(arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Generate(arguments) => generate::run(arguments),
        Command::Merge(arguments) => generate::merge(arguments),
        Command::Dataset { command: dataset::DatasetCommand::Inspect(arguments) } => dataset::inspect(arguments),
        Command::Compare(arguments) => page::compare::run(arguments),
        Command::Slurm(arguments) => slurm::run(&arguments),
        Command::Scenes(arguments) => scenes::run(arguments),
        Command::New(arguments) => new::run(&arguments),
        Command::Completions(arguments) => completions::run(&arguments),
        Command::Man(arguments) => completions::man(&arguments),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::scene::{Config, GradientMode, Kernels, Precision};
    use clap::CommandFactory;
    use std::path::Path;

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
