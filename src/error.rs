//! Errors that a user sees: bad input (exit code 2), failed runs (1), and runs that diverged (3).

use std::fmt;

/// Exit code of a run that started and failed (full disk, a gradient check that does not pass).
pub const EXIT_RUN: u8 = 1;
/// Exit code of bad input: nothing was computed and nothing was written.
pub const EXIT_INPUT: u8 = 2;
/// Exit code of a run whose numbers left all bounds.
pub const EXIT_DIVERGED: u8 = 3;
/// Exit code of a panic, which is a bug in hydrograd (`EX_SOFTWARE` of sysexits.h).
pub const EXIT_INTERNAL: u8 = 70;

/// What went wrong, in words for the user.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Detected before anything is computed or written.
    #[error("{0}")]
    Input(Box<BadInput>),
    /// Detected while running.
    #[error("{problem}{}", tried(advice))]
    Run { problem: String, advice: String },
    /// A run whose numbers left all bounds: its input is not one to use, but another may be.
    #[error("{problem}{}", tried(advice))]
    Diverged { problem: String, advice: String, offence: Option<Box<Offence>> },
    /// Somebody asked to stop, see [`crate::numerics::interrupt`].
    #[error("stopped by a signal")]
    Stopped,
}

/// The particle whose numbers left all bounds first, as far as a check saw it.
#[derive(Debug, Clone, PartialEq)]
pub struct Offence {
    pub step: usize,
    pub particle: usize,
    /// In the last state that was good.
    pub position: Vec<f64>,
    pub quantity: String,
    pub value: f64,
}

/// The last line of an error or a warning, where something can be tried.
pub fn tried(advice: &str) -> String {
    if advice.is_empty() {
        String::new()
    } else {
        format!("\n  try: {advice}")
    }
}

impl Error {
    /// A run that failed, with advice on what to try.
    pub fn run(problem: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::Run { problem: problem.into(), advice: advice.into() }
    }

    /// A run that diverged, with advice on what to try.
    pub fn diverged(problem: impl Into<String>, advice: impl Into<String>) -> Self {
        Self::Diverged { problem: problem.into(), advice: advice.into(), offence: None }
    }

    /// The same with the particle that was found, if it is a divergence.
    pub fn by(self, found: Offence) -> Self {
        match self {
            Self::Diverged { problem, advice, .. } => {
                Self::Diverged { problem, advice, offence: Some(Box::new(found)) }
            }
            other => other,
        }
    }

    /// The same of one of several runs.
    pub fn of(self, run: impl fmt::Display) -> Self {
        match self {
            Self::Run { problem, advice } => Self::run(format!("{run}: {problem}"), advice),
            Self::Diverged { problem, advice, offence } => {
                Self::Diverged { problem: format!("{run}: {problem}"), advice, offence }
            }
            input => input,
        }
    }
}

impl From<BadInput> for Error {
    fn from(bad: BadInput) -> Self {
        Self::Input(Box::new(bad))
    }
}

/// The exit code for an error: bad input anywhere in the chain of causes is 2, a divergence 3, everything else 1.
pub fn exit_code(error: &anyhow::Error) -> u8 {
    let bad_input = error
        .chain()
        .any(|cause| cause.is::<BadInput>() || matches!(cause.downcast_ref::<Error>(), Some(Error::Input(_))));
    let diverged = || error.chain().any(|cause| matches!(cause.downcast_ref(), Some(Error::Diverged { .. })));
    match bad_input {
        true => EXIT_INPUT,
        false if diverged() => EXIT_DIVERGED,
        false => EXIT_RUN,
    }
}

/// One piece of input that cannot be used: where it is, what it is, what is allowed, what to try.
///
/// ```
/// use hydrograd::error::BadInput;
/// let bad = BadInput::new("time.cfl = 9 is out of range")
///     .place("channel.toml, line 3")
///     .allowed("0 < time.cfl <= 4")
///     .advice("--set time.cfl=1");
/// let text = "channel.toml, line 3: time.cfl = 9 is out of range\n  \
///             allowed: 0 < time.cfl <= 4\n  try: --set time.cfl=1";
/// assert_eq!(bad.to_string(), text);
/// ```
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BadInput {
    place: Option<String>,
    pub(crate) key: Option<String>,
    problem: String,
    allowed: Option<String>,
    pub(crate) advice: Option<String>,
}

impl BadInput {
    /// `problem` names the key or thing and the offending value.
    pub fn new(problem: impl Into<String>) -> Self {
        Self { place: None, key: None, problem: problem.into(), allowed: None, advice: None }
    }

    /// A problem with the value of a configuration key, from which the loader finds the place.
    pub fn at(key: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::new(problem).key(key)
    }

    /// File and line, or the command-line text.
    pub fn place(mut self, place: impl Into<String>) -> Self {
        self.place = Some(place.into());
        self
    }

    /// The configuration key; the loader turns it into a place (it knows which file or option set it).
    pub fn key(mut self, key: impl Into<String>) -> Self {
        self.key = Some(key.into());
        self
    }

    /// Whether this is the key at fault.
    pub fn is_about(&self, key: &str) -> bool {
        self.key.as_deref() == Some(key)
    }

    pub fn allowed(mut self, allowed: impl Into<String>) -> Self {
        self.allowed = Some(allowed.into());
        self
    }

    pub fn advice(mut self, advice: impl Into<String>) -> Self {
        self.advice = Some(advice.into());
        self
    }

    /// Changes the advice; an empty one is left out.
    pub fn readvised(mut self, change: impl Fn(&str) -> String) -> Self {
        self.advice = self.advice.map(|advice| change(&advice)).filter(|advice| !advice.is_empty());
        self
    }

    /// Fills in the place from the key, unless a place is known already.
    pub fn located(mut self, place_of: impl Fn(&str) -> Option<String>) -> Self {
        if let (None, Some(key)) = (&self.place, &self.key) {
            self.place = place_of(key);
        }
        self
    }
}

impl std::error::Error for BadInput {}

impl fmt::Display for BadInput {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(place) = &self.place {
            write!(out, "{place}: ")?;
        }
        write!(out, "{}", self.problem)?;
        if let Some(allowed) = &self.allowed {
            write!(out, "\n  allowed: {allowed}")?;
        }
        if let Some(advice) = &self.advice {
            write!(out, "\n  try: {advice}")?;
        }
        Ok(())
    }
}
