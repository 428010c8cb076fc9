//! `--json`: one JSON document on stdout, for programs; what is meant for people goes to stderr then.
//!
//! ```json
//! { "version": "0.1.0", "exit_code": 0, "error": null, "result": { "q": 0.0237 } }
//! ```
//!
//! `result` is what the command writes as its JSON file (`summary.json`, `validation.json`, ...), or what it says at its end: counts, figures,
//! and which files it wrote.

use crate::report::VERSION;
use serde_json::{json, Value};
use std::fs::File;
use std::io::Write;
use std::os::fd::FromRawFd;
use std::path::Path;
use std::sync::Mutex;

/// What is said at the end.
struct Machine {
    /// stdout, before it became stderr.
    out: File,
    result: Value,
    error: Option<String>,
}

static MACHINE: Mutex<Option<Machine>> = Mutex::new(None);

fn with(change: impl FnOnce(&mut Machine)) {
    if let Some(machine) = MACHINE.lock().unwrap_or_else(|broken| broken.into_inner()).as_mut() {
        change(machine);
    }
}

/// From now on what is printed goes to stderr.
pub fn begin() -> std::io::Result<()> {
    // SAFETY: both are open (std opens /dev/null where they are closed), and the new descriptor is ours alone.
    let out = unsafe {
        let out = libc::dup(1);
        if out < 0 || libc::fcntl(out, libc::F_SETFD, libc::FD_CLOEXEC) < 0 || libc::dup2(2, 1) < 0 {
            return Err(std::io::Error::last_os_error());
        }
        File::from_raw_fd(out)
    };
    let mut machine = MACHINE.lock().unwrap_or_else(|broken| broken.into_inner());
    *machine = Some(Machine { out, result: Value::Null, error: None });
    Ok(())
}

/// Nothing is said after all: another process speaks for this one.
pub fn be_silent() {
    *MACHINE.lock().unwrap_or_else(|broken| broken.into_inner()) = None;
}

/// What the command has found; the last one counts.
pub fn answer(result: &Value) {
    with(|machine| machine.result = result.clone());
}

/// The error that is told, whole.
pub fn fail(error: &str) {
    with(|machine| machine.error = Some(error.to_string()));
}

/// A path as programs are told it.
pub fn path(path: &Path) -> Value {
    path.display().to_string().into()
}

/// Those of some files in a folder that are there.
pub fn paths_in<'a>(folder: &Path, names: impl IntoIterator<Item = &'a str>) -> Value {
    names.into_iter().map(|name| folder.join(name)).filter(|file| file.exists()).map(|file| path(&file)).collect()
}

pub fn end(exit_code: u8) {
    with(|machine| {
        let (result, error) = (machine.result.take(), machine.error.take());
        let document = json!({ "version": VERSION, "exit_code": exit_code, "error": error, "result": result });
        // Where stdout is closed there is nobody to tell.
        let _ = writeln!(machine.out, "{document:#}");
    });
}
