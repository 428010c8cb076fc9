//! Being asked to stop: by Ctrl-C (SIGINT), or by a batch system before it kills (SIGTERM).
//!
//! A command whose runs can go on later listens; its loops then ask between two steps, keep what they have, and end with
//! [`Error::Stopped`]. Nobody else is ever asked, and a signal ends the process as usual.
//!
//! Where runs are part of a larger program, which has its own way with signals, [`Stop`] ends one piece of work and no other:
//! gradients and searches for a steady state look at it too, as there is nothing to keep.

use crate::error::Error;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::iterator::Signals;
use signal_hook::low_level::{emulate_default_handler, signal_name};
use std::cell::RefCell;
use std::io::Write;
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};

/// The signal that asked, or 0.
static ASKED: AtomicI32 = AtomicI32::new(0);
/// Whether this process tells the user so, and whether it has.
static SPEAKS: AtomicBool = AtomicBool::new(false);
static HAS_SPOKEN: AtomicBool = AtomicBool::new(false);
/// What a user is told to do then.
static ADVICE: OnceLock<String> = OnceLock::new();

/// Whether other processes must answer before the work can stop in an orderly way, and whether they have.
static NEEDS_OTHERS: AtomicBool = AtomicBool::new(false);
static OTHERS_ANSWERED: AtomicBool = AtomicBool::new(false);
/// mpirun ends the others with SIGTERM when one has ended, and kills those that are still there a second later.
const PATIENCE: Duration = Duration::from_millis(600);

/// SIGTERMs that come so soon after one another are one: a batch system tells all processes of a job, and the job's shell, which tells
/// its own once more.
const TOGETHER: Duration = Duration::from_secs(1);

/// Listens from now on; `advice` is how the work goes on later. A second signal ends the process at once.
pub fn listen(advice: impl Into<String>) -> std::io::Result<()> {
    if ADVICE.set(advice.into()).is_err() {
        return Ok(());
    }
    SPEAKS.store(true, Ordering::Relaxed);
    begin()
}

/// The same for a process that another one speaks for.
pub fn listen_quietly() -> std::io::Result<()> {
    begin()
}

fn begin() -> std::io::Result<()> {
    let mut signals = Signals::new([SIGINT, SIGTERM])?;
    let wait = move || {
        let mut first = None;
        for signal in signals.forever() {
            // Not by what was asked: another rank may have told this one what its own signal says a moment later.
            let is_first = first.is_none();
            let since = first.get_or_insert_with(Instant::now).elapsed();
            if !is_first && signal == SIGTERM && since < TOGETHER {
                continue;
            }
            if !is_first {
                let _ = emulate_default_handler(signal);
            }
            ask(signal);
            if SPEAKS.load(Ordering::Relaxed) && NEEDS_OTHERS.load(Ordering::Relaxed) {
                std::thread::sleep(PATIENCE);
                if !OTHERS_ANSWERED.load(Ordering::Relaxed) {
                    let _ = writeln!(std::io::stderr(), "{}", unanswered());
                }
            }
        }
    };
    std::thread::Builder::new().name("signals".into()).spawn(wait)?;
    Ok(())
}

/// Says that the work needs the answers of other processes to stop in an orderly way; [`others_answered`] that they have come.
pub fn needs_others() {
    NEEDS_OTHERS.store(true, Ordering::Relaxed);
}

/// See [`needs_others`].
pub fn others_answered() {
    OTHERS_ANSWERED.store(true, Ordering::Relaxed);
}

/// What is said where other processes do not answer.
fn unanswered() -> String {
    let advice = ADVICE.get().map_or("", String::as_str);
    format!("a rank does not answer: it has ended, as mpirun says, or its step takes long\n  go on from what was kept last: {advice}")
}

fn name(signal: i32) -> &'static str {
    signal_name(signal).unwrap_or("a signal")
}

/// The signal by which somebody asked to stop.
pub fn asked() -> Option<i32> {
    Some(ASKED.load(Ordering::Relaxed)).filter(|&signal| signal != 0)
}

/// As if this process had got the signal, which another one may have got.
pub fn ask(signal: i32) {
    if SPEAKS.load(Ordering::Relaxed) && !HAS_SPOKEN.swap(true, Ordering::Relaxed) {
        // Before the work sees the signal, because it may be at its end at once. Where stderr is closed there is nobody to tell.
        let _ = writeln!(std::io::stderr(), "{}: keeps what there is, then stops (again: at once)", name(signal));
    }
    ASKED.store(signal, Ordering::Relaxed);
}

/// What is said at the end of a command that was asked to stop.
pub fn farewell(signal: i32) -> String {
    format!("stopped by {}\n  go on: {}", name(signal), ADVICE.get().map_or("", String::as_str))
}

/// An error if somebody asked to stop: the process, or the work of this thread.
pub fn check() -> Result<(), Error> {
    match asked() {
        Some(_) => Err(Error::Stopped),
        None => check_own(),
    }
}

/// An error if the work of this thread shall stop, whatever the process shall do.
pub fn check_own() -> Result<(), Error> {
    match is_asked_here() {
        true => Err(Error::Stopped),
        false => Ok(()),
    }
}

/// Whether the work of this thread shall stop.
pub fn is_asked_here() -> bool {
    OWN.with_borrow(|stop| stop.as_ref().is_some_and(Stop::is_asked))
}

thread_local! {
    /// What ends the work of this thread.
    static OWN: RefCell<Option<Stop>> = const { RefCell::new(None) };
}

/// Ends one piece of work, from another thread.
#[derive(Debug, Clone, Default)]
pub struct Stop(Arc<AtomicBool>);

impl Stop {
    /// From now on the work ends as soon as it looks.
    pub fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    pub fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// What ends the work of this thread; for another one that does a part of it.
    pub fn of_this_thread() -> Option<Self> {
        OWN.with_borrow(Clone::clone)
    }

    /// Does some work on this thread that this one ends.
    pub fn ends<T>(stop: Option<Self>, work: impl FnOnce() -> T) -> T {
        /// What it was before, also after a panic.
        struct Before(Option<Stop>);
        impl Drop for Before {
            fn drop(&mut self) {
                OWN.set(self.0.take());
            }
        }
        let _before = Before(OWN.replace(stop));
        work()
    }
}
