//! Shares of a command's work, by `--shard I/N` or by the tasks of a Slurm job array.
//!
//! A share has every N-th piece of the work. Shares write to one folder and keep existing results; a run without a
//! share evaluates all pieces.

use crate::error::BadInput;
use clap::Args;

/// The option of all commands that can be shared out.
#[derive(Debug, Clone, Args)]
pub struct ShardArgument {
    /// Make the I-th of N shares only, I from 0 [default: from a Slurm job array, else all]. Keeps what is there.
    #[arg(long, value_name = "I/N", value_parser = Shard::parse)]
    pub shard: Option<Shard>,
}

impl ShardArgument {
    /// The requested share, or that of the job array; none for all of the work.
    pub fn share(&self) -> Result<Option<Shard>, BadInput> {
        match self.shard {
            Some(shard) => Ok(Some(shard)),
            None => Shard::from_slurm(|name| std::env::var(name).ok()),
        }
    }
}

/// A share of the work: the pieces whose number is `index` modulo `count`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// Index of the share, from 0.
    pub index: usize,
    pub count: usize,
}

impl Shard {
    pub const ALL: Self = Self { index: 0, count: 1 };

    pub fn has(self, number: usize) -> bool {
        number % self.count == self.index
    }

    pub fn of<T>(self, all: &[T]) -> impl Iterator<Item = &T> {
        all.iter().skip(self.index).step_by(self.count)
    }

    /// Parses `i/n`, with i from 0.
    pub fn parse(text: &str) -> Result<Self, String> {
        let numbers = text.split_once('/').and_then(|(index, count)| Some((index.parse().ok()?, count.parse().ok()?)));
        match numbers {
            Some((index, count)) if index < count => Ok(Self { index, count }),
            _ => Err("allowed: I/N with I = 0 ... N - 1, for example 0/4".into()),
        }
    }

    /// The share of a process in Slurm's job array, if it is in one; `variable` reads an environment variable.
    pub fn from_slurm(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, BadInput> {
        let Some(task) = variable("SLURM_ARRAY_TASK_ID") else { return Ok(None) };
        let bad = |problem: String, allowed: &str| {
            BadInput::new(problem).place("environment").allowed(allowed).advice("--shard I/N")
        };
        let number = |name: &str, text: &str| -> Result<usize, BadInput> {
            let allowed = "a whole number, as Slurm sets it in a job array (sbatch --array=0-9)";
            text.parse().map_err(|_| bad(format!("{name} is {text}"), allowed))
        };
        let read = |name: &str, usual: &str| number(name, variable(name).as_deref().unwrap_or(usual));
        let count = read("SLURM_ARRAY_TASK_COUNT", "nothing")?;
        let task = number("SLURM_ARRAY_TASK_ID", &task)?;
        let (first, step) = (read("SLURM_ARRAY_TASK_MIN", "0")?, read("SLURM_ARRAY_TASK_STEP", "1")?);
        let index = task.saturating_sub(first) / step.max(1);
        if task < first || index >= count {
            let problem = format!("task {task} of a job array of {count} tasks from {first} in steps of {step}");
            return Err(bad(problem, "an array of evenly spaced tasks (sbatch --array=0-9)"));
        }
        Ok(Some(Self { index, count }))
    }
}
