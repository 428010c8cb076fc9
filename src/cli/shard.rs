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

    /// Whether a piece belongs to this share.
    pub fn has(self, number: usize) -> bool {
        number % self.count == self.index
    }

    /// The pieces of this share.
    pub fn of<T>(self, all: &[T]) -> impl Iterator<Item = &T> {
        all.iter().skip(self.index).step_by(self.count)
    }

    /// Parses `i/n`, with i from 0.
    pub fn parse(text: &str) -> Result<Self, String> {
        let allowed = || "allowed: I/N with I = 0 ... N - 1, for example 0/4".to_string();
        let (index, count) = text.split_once('/').ok_or_else(allowed)?;
        let (index, count) = (index.parse().map_err(|_| allowed())?, count.parse().map_err(|_| allowed())?);
        if index < count {
            Ok(Self { index, count })
        } else {
            Err(allowed())
        }
    }

    /// The share of a process in Slurm's job array, if it is in one; `variable` reads an environment variable.
    pub fn from_slurm(variable: impl Fn(&str) -> Option<String>) -> Result<Option<Self>, BadInput> {
        let Some(task) = variable("SLURM_ARRAY_TASK_ID") else { return Ok(None) };
        let number = |name: &str, text: Option<String>| -> Result<usize, BadInput> {
            let shown = text.clone().unwrap_or_else(|| "nothing".into());
            text.and_then(|text| text.parse().ok()).ok_or_else(|| {
                BadInput::new(format!("{name} is {shown}"))
                    .place("environment")
                    .allowed("a whole number, as Slurm sets it in a job array (sbatch --array=0-9)")
                    .advice("--shard I/N")
            })
        };
        let optional = |name: &str, usual: usize| variable(name).map_or(Ok(usual), |text| number(name, Some(text)));
        let count = number("SLURM_ARRAY_TASK_COUNT", variable("SLURM_ARRAY_TASK_COUNT"))?;
        let task = number("SLURM_ARRAY_TASK_ID", Some(task))?;
        let (first, step) = (optional("SLURM_ARRAY_TASK_MIN", 0)?, optional("SLURM_ARRAY_TASK_STEP", 1)?);
        let index = task.saturating_sub(first) / step.max(1);
        if task < first || index >= count {
            return Err(BadInput::new(format!(
                "task {task} of a job array of {count} tasks from {first} in steps of {step}"
            ))
            .place("environment")
            .allowed("an array of evenly spaced tasks (sbatch --array=0-9)")
            .advice("--shard I/N"));
        }
        Ok(Some(Self { index, count }))
    }
}
