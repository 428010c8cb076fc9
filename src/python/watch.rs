//! Work that Python waits for: on a thread of its own, without the interpreter's lock, while the thread that called looks ten
//! times a second for Ctrl-C and tells Python's callback how far the work is.

use super::errors::to_python;
use crate::cli::guard::message;
use crate::numerics::interrupt::Stop;
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use std::cell::Cell;
use std::panic::{catch_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{channel, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

/// How long Python's callback and Ctrl-C wait at most, and how often the callback is called.
const INTERVAL: Duration = Duration::from_millis(100);
/// Of the working thread. (A long tape has another thread of its own.)
const STACK: usize = 64 << 20;

/// Whether something has run: from then on the number of threads is what it is.
static BEGUN: AtomicBool = AtomicBool::new(false);

pub fn has_begun() -> bool {
    BEGUN.load(Ordering::Relaxed)
}

/// How far some work is.
#[derive(Debug, Clone, Copy)]
pub enum Told {
    Share(f64),
    Steps(usize, usize),
    /// Epochs done, of how many, and the last one's figure.
    Epoch(usize, usize, f64),
}

/// What the work tells who waits for it.
pub struct Teller {
    to: Option<Sender<Told>>,
    last: Cell<Instant>,
}

impl Teller {
    /// Told if nothing was for a while.
    pub fn often(&self, told: Told) {
        if self.to.is_some() && self.last.get().elapsed() >= INTERVAL {
            self.always(told);
        }
    }

    /// Told in any case.
    pub fn always(&self, told: Told) {
        if let Some(to) = &self.to {
            self.last.set(Instant::now());
            // Who does not wait any more has asked the work to stop.
            let _ = to.send(told);
        }
    }
}

/// Does some work; `progress` is a Python function or None.
///
/// # Errors
/// Those of the work, of the callback and of Python's signal handlers: after one of the latter the work ends soon.
pub fn watched<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Teller) -> anyhow::Result<T> + Send,
) -> PyResult<T> {
    BEGUN.store(true, Ordering::Relaxed);
    let (stop, (sender, mut receiver)) = (Stop::default(), channel());
    let own = Some(stop.clone());
    let listens = progress.is_some();
    let begin = move || {
        // Kept to the end even if nothing is told: that it is gone says that the work is done.
        let last = Cell::new(Instant::now());
        let teller = Teller { to: listens.then(|| sender.clone()), last };
        let done = catch_unwind(AssertUnwindSafe(|| Stop::ends(own, || work(&teller))));
        drop(sender);
        done
    };
    std::thread::scope(|scope| {
        let builder = std::thread::Builder::new().name("hydrograd".into()).stack_size(STACK);
        let worker = builder.spawn_scoped(scope, begin)?;
        let mut wrong = None;
        while wrong.is_none() {
            let from = &mut receiver;
            let told = py.detach(move || from.recv_timeout(INTERVAL));
            let call = || match (told, progress) {
                (Ok(Told::Share(share)), Some(progress)) => progress.call1((share, 1.0)).map(drop),
                (Ok(Told::Steps(step, steps)), Some(progress)) => progress.call1((step, steps)).map(drop),
                (Ok(Told::Epoch(epoch, epochs, q)), Some(progress)) => progress.call1((epoch, epochs, q)).map(drop),
                _ => Ok(()),
            };
            if let Err(error) = py.check_signals().and_then(|()| call()) {
                stop.ask();
                wrong = Some(error);
            } else if matches!(told, Err(RecvTimeoutError::Disconnected)) {
                break;
            }
        }
        let done = py.detach(move || worker.join()).and_then(|done| done);
        match (wrong, done) {
            (Some(error), _) => Err(error),
            (None, Ok(result)) => result.map_err(to_python),
            (None, Err(panic)) => {
                let text = message(&*panic);
                let version = env!("CARGO_PKG_VERSION");
                let message = format!("internal error: {text}; this is a bug in hydrograd {version}: please report it");
                Err(PyRuntimeError::new_err(message))
            }
        }
    })
}
