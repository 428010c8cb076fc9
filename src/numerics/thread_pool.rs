//! The threads that share a sweep.
//!
//! A sweep of a thousand particles takes some ten microseconds, so threads that wait for the next one spin for a while
//! before they sleep. On a machine that others use too, a thread may have no core when it is wanted. Nobody waits for
//! such a thread: work is dealt in pieces to whoever is there, a sweep ends when all pieces are done, and a thread that
//! comes later finds the sweep closed. Where threads keep missing sweeps, the next ones are made without them.

use std::any::Any;
use std::cell::UnsafeCell;
use std::hint::spin_loop;
use std::panic::{catch_unwind, resume_unwind, AssertUnwindSafe};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread::{park, Builder, Thread};
use std::time::{Duration, Instant};

/// How long a thread spins for the next sweep before it sleeps.
const SPIN_FOR_WORK: Duration = Duration::from_micros(200);
/// How long the caller spins for pieces that other threads have begun before it sleeps: so long, or so much of the time that it has worked
/// itself, whichever is longer. Who takes longer has lost its core: a piece is a small part of that time.
const SPIN_FOR_END: (Duration, u32) = (Duration::from_micros(50), 4);
/// When no other thread has come for this long, the next sweeps are made alone.
const PATIENCE: Duration = Duration::from_millis(1);
/// How long sweeps are made alone: the first time, and, as it doubles each time, at most.
const ALONE: (Duration, Duration) = (Duration::from_millis(1), Duration::from_millis(64));
/// So many sweeps in a row to which others came make the next time without them the first one again.
const RELIABLE: usize = 256;

/// Bits of [`ThreadPool::state`]: the number of threads at work, whether one has come, whether others may join, and the
/// number of the sweep.
const AT_WORK: usize = (1 << 14) - 1;
const CAME: usize = 1 << 14;
const OPEN: usize = 1 << 15;
const SWEEP: usize = 1 << 16;

/// What a thread does in a sweep, by its number.
type Work<'a> = &'a (dyn Fn(usize) + Sync);

/// Threads that wait for work. The caller of [`Self::run`] is one more.
pub struct ThreadPool {
    state: AtomicUsize,
    /// The work of the present sweep; valid while the sweep is open or somebody is at work.
    work: UnsafeCell<Work<'static>>,
    helpers: Vec<Helper>,
    /// The caller, if it sleeps until the others are done.
    caller: Mutex<Option<Thread>>,
    panic: Mutex<Option<Box<dyn Any + Send>>>,
    /// Held by the caller whose sweep it is.
    calls: Mutex<Attendance>,
}

/// A thread besides the caller.
struct Helper {
    thread: OnceLock<Thread>,
    sleeps: AtomicBool,
}

/// Whether the other threads come to the sweeps.
#[derive(Default)]
struct Attendance {
    /// When the first of the last sweeps began to which nobody came.
    missed_since: Option<Instant>,
    /// Until when sweeps are made alone.
    alone_until: Option<Instant>,
    /// How long that will be the next time.
    next: Duration,
    /// Sweeps in a row to which somebody came in time.
    came: usize,
}

/// How the other threads took part in a sweep.
enum Part {
    Came,
    Missed,
    /// Somebody came, and then had to be waited for.
    Late,
}

// SAFETY: `work` is written by the holder of `calls` while the sweep is closed and nobody is at work, and read by threads
// that have joined an open sweep.
unsafe impl Sync for ThreadPool {}

impl ThreadPool {
    /// The pool of this process, with [`super::threads::count`] threads.
    pub fn global() -> &'static Self {
        static POOL: OnceLock<&'static ThreadPool> = OnceLock::new();
        POOL.get_or_init(|| Self::start(super::threads::count()))
    }

    /// A pool of so many threads, with the caller; they live as long as the process.
    pub fn start(threads: usize) -> &'static Self {
        let helper = |_| Helper { thread: OnceLock::new(), sleeps: AtomicBool::new(false) };
        let pool: &'static Self = Box::leak(Box::new(Self {
            state: AtomicUsize::new(0),
            work: UnsafeCell::new(&|_| ()),
            helpers: (1..threads).map(helper).collect(),
            caller: Mutex::new(None),
            panic: Mutex::new(None),
            calls: Mutex::new(Attendance::default()),
        }));
        for number in 1..=pool.helpers.len() {
            // Without this thread the others do its share.
            if let Ok(handle) = Builder::new().name(format!("sweep-{number}")).spawn(move || pool.help(number)) {
                let _ = pool.helpers[number - 1].thread.set(handle.thread().clone());
            }
        }
        pool
    }

    /// Number of threads, with the caller.
    pub fn threads(&self) -> usize {
        self.helpers.len() + 1
    }

    /// Calls `work` with 0 on this thread, and with other numbers below [`Self::threads`] on those other threads that
    /// come before this call of it has returned. So the call with 0 must do whatever the others do not, and return when
    /// nothing is left to begin; `run` returns when all calls have. If the pool is in use, only this thread works.
    ///
    /// # Panics
    /// If `work` panics on any thread.
    pub fn run(&self, work: Work<'_>) {
        let Ok(mut attendance) = self.calls.try_lock() else { return work(0) };
        if self.helpers.is_empty() || attendance.is_alone() {
            return work(0);
        }
        // SAFETY: the last sweep is closed and nobody is at work in it. The reference is used only by threads that join
        // this sweep, and `close` waits for them.
        unsafe { *self.work.get() = std::mem::transmute::<Work<'_>, Work<'static>>(work) };
        let began = (self.state.load(Ordering::Relaxed) & !(SWEEP - 1)).wrapping_add(SWEEP);
        // Sequentially consistent with `sleeps`: a thread that goes to sleep sees this, or is seen to sleep.
        self.state.store(began | OPEN, Ordering::SeqCst);
        for helper in &self.helpers {
            if helper.sleeps.load(Ordering::SeqCst) {
                if let Some(thread) = helper.thread.get() {
                    thread.unpark();
                }
            }
        }
        let began = Instant::now();
        let own = catch_unwind(AssertUnwindSafe(|| work(0)));
        attendance.note(self.close(began.elapsed()));
        drop(attendance);
        let other = lock(&self.panic).take();
        if let Some(panic) = own.err().or(other) {
            resume_unwind(panic);
        }
    }

    /// Lets nobody join the sweep any more and waits for those who are at work. The caller has worked for so long.
    fn close(&self, worked: Duration) -> Part {
        let before = self.state.fetch_and(!OPEN, Ordering::AcqRel);
        let at_work = || self.state.load(Ordering::Acquire) & AT_WORK > 0;
        if before & CAME == 0 {
            return Part::Missed;
        }
        let (least, part) = SPIN_FOR_END;
        if before & AT_WORK == 0 || spin_while(least.max(worked / part), at_work) {
            return Part::Came;
        }
        *lock(&self.caller) = Some(std::thread::current());
        while at_work() {
            park();
        }
        *lock(&self.caller) = None;
        Part::Late
    }

    /// What a thread besides the caller does until the process ends.
    fn help(&self, number: usize) {
        let own = &self.helpers[number - 1];
        let mut last = 0;
        loop {
            let is_new = |state: usize| state & OPEN > 0 && state & !(SWEEP - 1) != last;
            if !spin_while(SPIN_FOR_WORK, || !is_new(self.state.load(Ordering::Acquire))) {
                own.sleeps.store(true, Ordering::SeqCst);
                while !is_new(self.state.load(Ordering::SeqCst)) {
                    park();
                }
                own.sleeps.store(false, Ordering::SeqCst);
            }
            let state = self.state.load(Ordering::Acquire);
            let join = |now: usize| is_new(now).then_some((now | CAME) + 1);
            let Ok(joined) = self.state.fetch_update(Ordering::AcqRel, Ordering::Acquire, join) else {
                // The sweep ended before this thread came.
                last = state & !(SWEEP - 1);
                continue;
            };
            last = joined & !(SWEEP - 1);
            // SAFETY: this thread has joined the sweep, so the work is there until it is done.
            let work = unsafe { *self.work.get() };
            if let Err(panic) = catch_unwind(AssertUnwindSafe(|| work(number))) {
                lock(&self.panic).get_or_insert(panic);
            }
            let before = self.state.fetch_sub(1, Ordering::AcqRel);
            if before & AT_WORK == 1 && before & OPEN == 0 {
                if let Some(caller) = &*lock(&self.caller) {
                    caller.unpark();
                }
            }
        }
    }
}

impl Attendance {
    /// Whether the next sweep is made by the caller alone.
    fn is_alone(&mut self) -> bool {
        if self.alone_until.is_some_and(|until| Instant::now() >= until) {
            self.alone_until = None;
        }
        self.alone_until.is_some()
    }

    fn note(&mut self, part: Part) {
        let give_up = match part {
            Part::Came => {
                self.missed_since = None;
                self.came += 1;
                if self.came >= RELIABLE {
                    self.next = ALONE.0;
                }
                return;
            }
            Part::Missed => self.missed_since.get_or_insert_with(Instant::now).elapsed() > PATIENCE,
            Part::Late => true,
        };
        self.came = 0;
        if give_up {
            let alone = self.next.clamp(ALONE.0, ALONE.1);
            (self.missed_since, self.alone_until, self.next) = (None, Some(Instant::now() + alone), 2 * alone);
        }
    }
}

/// Spins while a condition holds, for a limited time. Returns whether it holds no longer.
fn spin_while(limit: Duration, condition: impl Fn() -> bool) -> bool {
    let mut began = None;
    loop {
        for _ in 0..64 {
            if !condition() {
                return true;
            }
            spin_loop();
        }
        if began.get_or_insert_with(Instant::now).elapsed() > limit {
            return false;
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
