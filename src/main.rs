//! The command line of hydrograd.

use std::process::ExitCode;

use clap::Parser;
use hydrograd::cli;

/// Big tensors come and go: 2 to 25 times faster in candle's backward than with glibc.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    cli::install_panic_hook();
    ExitCode::from(cli::guarded(|| cli::run(cli::Cli::parse())))
}
