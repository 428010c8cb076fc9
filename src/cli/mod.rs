//! The command line: one file per subcommand.

mod arguments;
mod bench;
mod check_gradient;
mod dataset;
mod explain;
mod files;
mod generate;
mod guard;
mod optimize;
mod prepare;
mod scenes;
mod simulate;
mod simulate_flow;

pub use arguments::{
    CheckGradientArguments, Cli, Command, CommonArguments, DatasetCommand, ExplainArgument, GenerateArguments,
    GradientArguments, InspectArguments, MemoryArgument, MergeArguments, OptimizeArguments, ResumeArgument,
    ScenesArguments, SimulateArguments, StartName,
};
pub use bench::BenchArguments;
pub use guard::{guarded, install_panic_hook};

/// Runs the parsed command line.
pub fn run(cli: Cli) -> anyhow::Result<()> {
    match cli.command {
        Command::Simulate(arguments) => simulate::run(arguments.load()?, arguments),
        Command::Optimize(arguments) => optimize::run(arguments.load()?, arguments),
        Command::CheckGradient(arguments) => check_gradient::run(arguments.load()?, arguments),
        Command::Bench(arguments) => bench::run(arguments),
        Command::Generate(arguments) => generate::run(arguments.load()?, arguments),
        Command::Merge(arguments) => generate::merge(arguments),
        Command::Dataset { command: DatasetCommand::Inspect(arguments) } => dataset::inspect(arguments),
        Command::Scenes(arguments) => scenes::run(arguments),
    }
}
