//! A progress bar on stderr; where stderr is not a terminal it prints nothing at all.

use super::text::shown;
use indicatif::{MultiProgress, ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal;

/// How a bar looks, in the language of `indicatif`.
pub const TEMPLATE: &str = "{prefix} [{bar:30}] {pos}/{len} {elapsed} (left {eta}) {msg}";

/// Progress of a task of known length.
#[derive(Debug)]
pub struct Progress {
    bar: ProgressBar,
}

impl Progress {
    /// Starts a bar over `total` units of work, with `label` in front.
    pub fn new(total: u64, label: &str) -> Self {
        Self::with_visibility(total, label, std::io::stderr().is_terminal())
    }

    /// A bar below those of other tasks that go on meanwhile.
    pub fn among(others: &Tasks, total: u64, label: &str) -> Self {
        let mut progress = Self::new(total, label);
        if !progress.is_hidden() {
            progress.bar = others.0.add(progress.bar);
        }
        progress
    }

    /// A bar that never prints (quiet mode, tests).
    pub fn hidden(total: u64) -> Self {
        Self::with_visibility(total, "", false)
    }

    fn with_visibility(total: u64, label: &str, visible: bool) -> Self {
        let target = if visible {
            // Ten redraws a second: a redraw must cost nothing next to a step.
            ProgressDrawTarget::stderr_with_hz(10)
        } else {
            ProgressDrawTarget::hidden()
        };
        let bar = ProgressBar::with_draw_target(Some(total), target).with_prefix(label.to_owned());
        // The template is a constant that the tests parse; the default style would still do.
        if let Ok(style) = ProgressStyle::with_template(TEMPLATE) {
            bar.set_style(style.progress_chars("=> "));
        }
        Self { bar }
    }

    pub fn done(&self, steps: u64) {
        self.bar.inc(steps);
    }

    /// Sets the units done so far (a resumed run starts above 0).
    pub fn set_position(&self, position: u64) {
        self.bar.set_position(position);
    }

    /// Units done so far.
    pub fn position(&self) -> u64 {
        self.bar.position()
    }

    /// Text behind the bar, such as `Q = 0.1234`.
    pub fn message(&self, text: impl Into<String>) {
        self.bar.set_message(shown(&text.into()));
    }

    /// Prints a line above the bar; nothing if hidden.
    pub fn line(&self, text: &str) {
        self.bar.println(shown(text));
    }

    /// Prints a line above the bar; without a terminal, on stdout: what a log of hours should hold.
    pub fn log(&self, text: &str) {
        let text = shown(text);
        if self.bar.is_hidden() {
            println!("{text}");
        } else {
            self.bar.println(text);
        }
    }

    /// Runs `print` (which may write to the terminal) with the bar out of the way.
    pub fn suspend<R>(&self, print: impl FnOnce() -> R) -> R {
        self.bar.suspend(print)
    }

    pub fn is_hidden(&self) -> bool {
        self.bar.is_hidden()
    }

    /// Removes the bar from the screen.
    pub fn finish(self) {
        self.bar.finish_and_clear();
    }
}

/// Tasks that go on at the same time, each with a bar.
#[derive(Debug, Default)]
pub struct Tasks(MultiProgress);
