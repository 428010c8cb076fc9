//! The command line: one file per subcommand.

mod arguments;
mod bench;
mod check_gradient;
mod dataset;
mod evaluate;
mod explain;
mod files;
mod generate;
mod guard;
mod model_data;
mod optimize;
mod prepare;
mod rollout;
mod scenes;
mod simulate;
mod simulate_flow;
mod study;
mod train;

pub use arguments::{
    CheckGradientArguments, Cli, Command, CommonArguments, DatasetCommand, ExplainArgument, GenerateArguments,
    GradientArguments, InspectArguments, MemoryArgument, MergeArguments, OptimizeArguments, ResumeArgument,
    ScenesArguments, SimulateArguments, StartName, TrainArguments,
};
pub use bench::BenchArguments;
pub use evaluate::EvaluateArguments;
pub use guard::{guarded, install_panic_hook};
pub use rollout::RolloutArguments;
pub use study::StudyArguments;

/// Runs the parsed command line.
pub fn run(cli: Cli) -> anyhow::Result<()> {
    match cli.command {
        Command::Simulate(arguments) => simulate::run(arguments.load()?, arguments),
        Command::Optimize(arguments) => optimize::run(arguments.load()?, arguments),
        Command::CheckGradient(arguments) => check_gradient::run(arguments.load()?, arguments),
        Command::Train(arguments) => train::run(arguments),
        Command::Evaluate(arguments) => evaluate::run(arguments),
        Command::Rollout(arguments) => rollout::run(arguments),
        Command::Study(arguments) => study::run(arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Generate(arguments) => generate::run(arguments.load()?, arguments),
        Command::Merge(arguments) => generate::merge(arguments),
        Command::Dataset { command: DatasetCommand::Inspect(arguments) } => dataset::inspect(arguments),
        Command::Scenes(arguments) => scenes::run(arguments),
    }
}
