//! Starts this program again, for `study`, `bench`, the scripts of `slurm`, and the errors of figures.

use crate::numerics::interrupt;
use std::ffi::OsString;
use std::os::unix::process::CommandExt;
use std::process::{Command, ExitStatus};
use std::sync::OnceLock;
use std::time::Duration;

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

/// Runs a process that keeps what it has and stops when this one is asked to, and does not outlive it.
pub fn attended(command: &mut Command) -> std::io::Result<ExitStatus> {
    // In a group of its own, Ctrl-C reaches it once, from here.
    command.process_group(0);
    #[cfg(target_os = "linux")]
    {
        let parent = std::process::id() as libc::pid_t;
        let with_parent = move || match unsafe { libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) } {
            // Gone since the fork: nobody will tell.
            0 if unsafe { libc::getppid() } != parent => Err(std::io::Error::from_raw_os_error(libc::ESRCH)),
            0 => Ok(()),
            _ => Err(std::io::Error::last_os_error()),
        };
        // SAFETY: two system calls are all that happens between fork and exec.
        unsafe { command.pre_exec(with_parent) };
    }
    let mut child = command.spawn()?;
    let mut is_told = false;
    loop {
        if let Some(status) = child.try_wait()? {
            return Ok(status);
        }
        if interrupt::asked().is_some() && !is_told {
            // SAFETY: sends a signal to a process that is ours and not yet waited for.
            unsafe { libc::kill(child.id() as libc::pid_t, libc::SIGTERM) };
            is_told = true;
        }
        std::thread::sleep(Duration::from_millis(10));
    }
}
