//! The command line of hydrograd.

use std::process::ExitCode;

use hydrograd::cli;
use hydrograd::numerics::memory;

/// Big tensors come and go: 2 to 25 times faster in candle's backward than with glibc. (The Python package has its own.)
#[cfg(not(feature = "python"))]
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    memory::keep_freed();
    cli::install_panic_hook();
    ExitCode::from(cli::guarded(|| cli::run(cli::parse(std::env::args_os()).unwrap_or_else(|error| error.exit()))))
}
