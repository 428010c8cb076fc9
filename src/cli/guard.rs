//! Reports errors with their causes to the user, and panics as a bug to report, each in clear lines.

use std::any::Any;
use std::io::Write;
use std::panic::{catch_unwind, AssertUnwindSafe};

use super::arguments::with_options;
use super::machine;
use crate::error::{exit_code, tried, Error, EXIT_INTERNAL};
use crate::numerics::interrupt;
use crate::report::text::shown;
use crate::report::VERSION;

/// The message of std when the reader of a pipe has closed it, as in `hydrograd ... | head`.
const BROKEN_PIPE: &str = "failed printing to std";

/// 128 + SIGPIPE, the exit code that a shell reports for a closed pipe.
const EXIT_BROKEN_PIPE: u8 = 141;

/// Replaces Rust's panic message by one line that asks to report it.
pub fn install_panic_hook() {
    std::panic::set_hook(Box::new(|info| {
        let message = message(info.payload());
        if message.starts_with(BROKEN_PIPE) {
            return;
        }
        let place = info.location().map(|location| format!(" at {}:{}", location.file(), location.line()));
        // Keeps the message on one line.
        let (message, place) = (message.replace('\n', " "), place.unwrap_or_default());
        complain(&format!(
            "error: internal error{place}: {message}; this is a bug in hydrograd {VERSION}: please report it with the \
             command line"
        ));
    }));
}

/// Runs a command, prints its error and the causes to stderr, and returns the exit code: 0, 1 for a failed
/// run, 2 for bad input, 3 for a run that diverged, 70 for a panic, 130 and 143 for one that SIGINT and SIGTERM stopped.
pub fn guarded(command: impl FnOnce() -> anyhow::Result<()>) -> u8 {
    let code = match catch_unwind(AssertUnwindSafe(command)) {
        Ok(Ok(())) => 0,
        Ok(Err(error)) => match stopped_by(&error) {
            Some(signal) => {
                tell(&interrupt::farewell(signal));
                // As a shell reports a program that was ended by the signal.
                u8::try_from(128 + signal).unwrap_or(EXIT_INTERNAL)
            }
            None => tell_error(&error),
        },
        Err(payload) if message(&*payload).starts_with(BROKEN_PIPE) => EXIT_BROKEN_PIPE,
        Err(panic) => {
            machine::fail(&format!("internal error: {}", message(&*panic)));
            EXIT_INTERNAL
        }
    };
    machine::end(code);
    code
}

/// The signal that ended a command, if the error is due to one.
pub(super) fn stopped_by(error: &anyhow::Error) -> Option<i32> {
    let is_stop =
        |cause: &(dyn std::error::Error + 'static)| matches!(cause.downcast_ref::<Error>(), Some(Error::Stopped));
    interrupt::asked().filter(|_| error.chain().any(is_stop))
}

/// Prints an error and its causes, and returns the exit code.
pub(super) fn tell_error(error: &anyhow::Error) -> u8 {
    let causes: String = error.chain().skip(1).map(|cause| format!("\n  cause: {cause}")).collect();
    tell(&with_options(&format!("error: {error}{causes}")));
    exit_code(error)
}

/// Prints to stderr, and to the document of `--json`.
fn tell(text: &str) {
    let text = shown(text);
    machine::fail(&text);
    complain(&text);
}

/// Prints a warning with advice to stderr.
pub(super) fn warn(problem: &str, advice: &str) {
    complain(&shown(&with_options(&format!("warning: {problem}{}", tried(advice)))));
}

/// Prints a line to stderr. If stderr is closed the line is lost (`eprintln!` would panic).
fn complain(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}

/// The text of a panic.
pub(crate) fn message(payload: &(dyn Any + Send)) -> &str {
    payload
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| payload.downcast_ref::<&str>().copied())
        .unwrap_or("panic")
}
