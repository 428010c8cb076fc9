//! How this program is started again: `study` and `bench` do, and what `slurm` writes.

use std::ffi::OsString;
use std::process::Command;
use std::sync::OnceLock;

/// The words of another program that runs this command line.
static OTHER: OnceLock<Vec<OsString>> = OnceLock::new();

/// Said by a program of another name that runs this command line, as Python does: the words that start it, arguments behind them.
pub fn is_started_by(words: Vec<OsString>) {
    // Whoever said so first is still there.
    let _ = OTHER.set(words);
}

/// What starts this program: its path, and what comes before the arguments.
///
/// # Errors
/// System errors.
pub fn words() -> std::io::Result<Vec<OsString>> {
    match OTHER.get() {
        Some(words) if !words.is_empty() => Ok(words.clone()),
        _ => Ok(vec![std::env::current_exe()?.into()]),
    }
}

/// A process of the program that some words start.
pub fn command(words: &[OsString]) -> Command {
    let mut command = Command::new(words.first().map(OsString::as_os_str).unwrap_or_default());
    command.args(words.get(1..).unwrap_or_default());
    command
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_before_the_arguments_stay_there() {
        // Nobody else said so: it is the test itself.
        assert_eq!(words().unwrap(), [std::env::current_exe().unwrap().into_os_string()]);
        let words = ["echo", "-m", "hydrograd"].map(OsString::from);
        let output = command(&words).arg("study").output().unwrap();
        assert_eq!(String::from_utf8(output.stdout).unwrap().trim(), "-m hydrograd study");
    }
}
