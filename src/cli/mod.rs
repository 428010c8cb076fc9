//! The command line: one file per subcommand.

pub mod arguments;
mod around_bodies;
mod around_in_time;
mod around_optimize;
mod around_shapes;
pub mod bench;
mod calibrate;
mod check_gradient;
mod completions;
mod dataset;
mod ensemble_gradient;
mod evaluate;
mod explain;
mod figure_errors;
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
pub mod page;
mod periodic_box;
pub(crate) mod prepare;
pub mod program;
mod ranks;
mod recover;
mod rollout;
mod run_folder;
mod scenes;
mod shard;
mod simulate;
mod simulate_report;
pub mod slurm;
mod stress;
mod study;
mod train;
mod validate;
mod verify;

pub use crate::report::text::shown;
pub use guard::{guarded, install_panic_hook};

use crate::error::Error;
use crate::scene::load::Loaded;
use clap::error::{ContextKind, ContextValue};
use clap::{Command as Line, CommandFactory, FromArgMatches, Parser, Subcommand};
use std::ffi::OsString;

/// Differentiable particle flow: simulate a fluid by SPH, and shape its walls by gradients of whole runs.
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
    let matches = line().try_get_matches_from(words).map_err(|mut error| {
        // To give what looks like an option as a value, behind `--`, is never meant.
        if let Some(ContextValue::StyledStrs(mut tips)) = error.remove(ContextKind::Suggested) {
            tips.retain(|tip| !tip.to_string().contains("as a value"));
            if !tips.is_empty() {
                error.insert(ContextKind::Suggested, ContextValue::StyledStrs(tips));
            }
        }
        error
    })?;
    let mut command = (Cli::command(), &matches);
    while let Some((name, below)) = command.1.subcommand() {
        command = (command.0.find_subcommand(name).cloned().unwrap_or_default(), below);
    }
    arguments::runs(&command.0);
    Cli::from_arg_matches(&matches)
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

/// Runs a command on a scene; its error advises what the scene allows.
fn on(scene: Loaded, command: impl FnOnce(Loaded) -> anyhow::Result<()>) -> anyhow::Result<()> {
    command(scene.clone()).map_err(|error| match error.downcast::<Error>() {
        Ok(error) => scene.advised(error).into(),
        Err(error) => error,
    })
}

pub fn run(cli: Cli) -> anyhow::Result<()> {
    if cli.json {
        machine::begin()?;
    }
    env_logger::Builder::from_default_env().init();
    use Command::{CheckGradient, Generate, Optimize, Simulate, Train};
    if !matches!(cli.command, Simulate(_) | Train(_) | Optimize(_) | CheckGradient(_) | Generate(_)) {
        ranks::together(ranks::alone)?;
    }
    match cli.command {
        Command::Simulate(arguments) => {
            ranks::together(|ranks| on(arguments.load()?, |scene| simulate::run(scene, arguments, ranks)))
        }
        Command::Optimize(arguments) => {
            ranks::together(|ranks| on(arguments.load()?, |scene| optimize::run(scene, arguments, ranks)))
        }
        Command::Verify(arguments) => verify::run(arguments),
        Command::Validate(arguments) => validate::run(arguments),
        Command::Stress(arguments) => stress::run(arguments),
        Command::CheckGradient(arguments) => {
            ranks::together(|ranks| on(arguments.load()?, |scene| check_gradient::run(scene, arguments, ranks)))
        }
        Command::Recover(arguments) => on(arguments.load()?, |scene| recover::run(scene, arguments)),
        Command::Calibrate(arguments) => calibrate::run(arguments),
        Command::Train(arguments) => train::run(arguments),
        Command::Evaluate(arguments) => evaluate::run(arguments),
        Command::Rollout(arguments) => rollout::run(arguments),
        Command::Study(arguments) => study::run(arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Generate(arguments) => ranks::together(|ranks| generate::run(arguments, ranks)),
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
