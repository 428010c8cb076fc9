//! Starts this program again, for `study`, `bench` and the scripts of `slurm`.

use std::ffi::OsString;
use std::process::Command;
use std::sync::OnceLock;

static OTHER: OnceLock<Vec<OsString>> = OnceLock::new();

/// Sets the words that start another program with this command line, such as Python; arguments are appended.
pub fn is_started_by(words: Vec<OsString>) {
    // The first call counts.
    let _ = OTHER.set(words);
}

/// The words that start this program: its path, and words before the arguments.
pub fn words() -> std::io::Result<Vec<OsString>> {
    match OTHER.get() {
        Some(words) if !words.is_empty() => Ok(words.clone()),
        _ => Ok(vec![std::env::current_exe()?.into()]),
    }
}

/// A process started by these words.
pub fn command(words: &[OsString]) -> Command {
    let mut command = Command::new(words.first().map(OsString::as_os_str).unwrap_or_default());
    command.args(words.get(1..).unwrap_or_default());
    command
}
