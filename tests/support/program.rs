//! The program run as a user runs it, and how it must answer.

use assert_cmd::Command;
use std::path::Path;
use std::process::Output;

/// Runs `hydrograd` in a folder, on one thread unless the arguments say otherwise: the tests run side by side, and
/// spinning workers of several processes on the same cores make each other slow.
pub fn hydrograd(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::cargo_bin("hydrograd").unwrap();
    command.current_dir(folder).env("CANDLE_NUM_THREADS", "1").args(arguments).output().unwrap()
}

/// Runs `hydrograd`, expects success, and returns what it printed.
#[track_caller]
pub fn succeeds(folder: &Path, arguments: &[&str]) -> String {
    printed(arguments, hydrograd(folder, arguments))
}

/// What a run that succeeded printed. It says nothing on stderr when that is not a terminal, but for warnings about its figures:
/// the runs of tests are short and coarse.
#[track_caller]
pub fn printed(arguments: &[&str], output: Output) -> String {
    let error = String::from_utf8_lossy(&output.stderr);
    let is_of_warning = |line: &str| line.starts_with("warning: ") || line.starts_with("  try: ");
    assert!(output.status.success() && error.lines().all(is_of_warning), "{arguments:?}: {error}");
    String::from_utf8(output.stdout).unwrap()
}

/// The message of a run that refused its input: exit code 2 and exactly one error, which has every part of `expected`.
#[track_caller]
pub fn refused(arguments: &[&str], output: &Output, expected: &[&str]) -> String {
    let error = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {error}");
    assert_eq!(error.matches("error:").count(), 1, "{arguments:?}: {error}");
    for part in expected {
        assert!(error.contains(part), "{arguments:?}: no `{part}` in {error}");
    }
    error
}
