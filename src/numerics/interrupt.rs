//! Being asked to stop: by Ctrl-C (SIGINT), or by a batch system before it kills (SIGTERM).
//!
//! A command whose runs can go on later listens; its loops then ask between two steps, keep what they have, and end with
//! [`Error::Stopped`]. Nobody else is ever asked, and a signal ends the process as usual.

use crate::error::Error;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::{emulate_default_handler, signal_name};
use std::io::Write;
use std::sync::atomic::{AtomicI32, Ordering};
use std::sync::OnceLock;

/// The signal that asked, or 0.
static ASKED: AtomicI32 = AtomicI32::new(0);
/// What a user is told to do then.
static ADVICE: OnceLock<String> = OnceLock::new();

/// Listens from now on; `advice` is how the work goes on later. A second signal ends the process at once.
///
/// # Errors
/// System errors.
pub fn listen(advice: impl Into<String>) -> std::io::Result<()> {
    if ADVICE.set(advice.into()).is_err() {
        return Ok(());
    }
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let wait = move || {
        for signal in signals.forever() {
            if ASKED.swap(signal, Ordering::Relaxed) != 0 {
                let _ = emulate_default_handler(signal);
            }
            // Where stderr is closed there is nobody to tell.
            let _ = writeln!(std::io::stderr(), "{}: keeps what there is, then stops (again: at once)", name(signal));
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(wait)?;
    Ok(())
}

fn name(signal: i32) -> &'static str {
    signal_name(signal).unwrap_or("a signal")
}

/// The signal by which somebody asked to stop.
pub fn asked() -> Option<i32> {
    Some(ASKED.load(Ordering::Relaxed)).filter(|&signal| signal != 0)
}

/// What is said at the end of a command that was asked to stop.
pub fn farewell(signal: i32) -> String {
    format!("stopped by {}\n  go on: {}", name(signal), ADVICE.get().map_or("", String::as_str))
}

/// An error if somebody asked to stop.
///
/// # Errors
/// [`Error::Stopped`].
pub fn check() -> Result<(), Error> {
    match asked() {
        Some(_) => Err(Error::Stopped),
        None => Ok(()),
    }
}
