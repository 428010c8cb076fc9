//! The command line of hydrograd.

use std::process::ExitCode;

use clap::Parser;
use hydrograd::cli;

/// Big tensors come and go: 2 to 25 times faster in candle's backward than with glibc.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// The allocator gives unused pages back to the system after a moment, and gets them again, cleared, for the next step's
/// tensors: from 100 000 particles on that took a quarter to a half of a gradient. It shall keep them.
fn keep_freed_memory() {
    /// `mi_option_purge_delay` of mimalloc.h; milliseconds, -1 for never.
    const PURGE_DELAY: libmimalloc_sys::mi_option_t = 15;
    // SAFETY: sets a number of the allocator's; not thread safe, and there is no other thread yet.
    unsafe { libmimalloc_sys::mi_option_set(PURGE_DELAY, -1) }
}

fn main() -> ExitCode {
    keep_freed_memory();
    cli::install_panic_hook();
    ExitCode::from(cli::guarded(|| cli::run(cli::Cli::parse())))
}
