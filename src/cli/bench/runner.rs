//! Runs the cases of a family in turns, each repeat in its own process.

use super::accuracy::ComparedRun;
use super::case::{Case, Kind, Measured, Outcome, Request, Source};
use super::rows::Row;
use crate::cli::program;
use crate::error::{Error, EXIT_DIVERGED};
use crate::report::progress::Progress;
use serde::de::DeserializeOwned;
use std::process::Stdio;

/// The label of a case that was left out, and why.
pub type LeftOut = (String, String);

/// Runs every case `repeats` times in turns, A B C A B C.
pub fn run(family: &[Case], repeats: usize, bar: &Progress) -> anyhow::Result<(Vec<Row>, Vec<LeftOut>)> {
    let mut measured: Vec<Result<Vec<Measured>, String>> = vec![Ok(vec![]); family.len()];
    for _ in 0..repeats {
        for (case, found) in family.iter().zip(&mut measured) {
            bar.message(case.label());
            if let Ok(all) = found {
                match ask::<Outcome>(&case.label(), &Request::Row(Box::new(case.clone())), case.threads)? {
                    Ok(one) => all.push(one),
                    Err(reason) => *found = Err(reason),
                }
            }
            bar.done(1);
        }
    }
    let (mut rows, mut left_out, mut counted) = (vec![], vec![], Counted::default());
    for (case, found) in family.iter().zip(measured) {
        match found {
            Ok(all) => rows.push(Row::new(case, &all, counted.of(case)?)),
            Err(reason) => left_out.push((case.label(), reason)),
        }
    }
    Ok((rows, left_out))
}

/// The operations of steps that were counted, in 1e9: those of a scene do not depend on precision and threads.
#[derive(Default)]
struct Counted(Vec<((Source, Kind), f64)>);

impl Counted {
    /// None where nothing counts them.
    fn of(&mut self, case: &Case) -> anyhow::Result<Option<f64>> {
        if !case.has_roofline() || !cfg!(target_arch = "x86_64") {
            return Ok(None);
        }
        let of = (case.source.clone(), case.kind);
        if let Some((_, known)) = self.0.iter().find(|(known, _)| *known == of) {
            return Ok(Some(*known));
        }
        let operations: f64 = ask(&case.label(), &Request::Count(Box::new(case.clone())), 1)?;
        self.0.push((of, 1e-9 * operations));
        Ok(Some(1e-9 * operations))
    }
}

/// Measures all points of run time against error in a separate process.
pub fn accuracy(quick: bool, threads: usize) -> anyhow::Result<Vec<ComparedRun>> {
    let mut points: Vec<ComparedRun> = ask("accuracy", &Request::Accuracy { quick, threads }, threads)?;
    points.iter_mut().for_each(|point| point.threads = Some(threads));
    Ok(points)
}

/// Advice for a case that fails.
const ADVICE: &str = "leave it out with --filter, or change the scene with --set";

/// Starts this program again with a number of threads and a request, and reads the answer.
fn ask<T: DeserializeOwned>(name: &str, request: &Request, threads: usize) -> anyhow::Result<T> {
    let failed = |problem: String| Error::run(format!("{name}: {problem}"), ADVICE);
    let words = program::words().map_err(|error| failed(format!("can not find the program: {error}")))?;
    let mut command = program::command(&words);
    if let Request::Count(_) = request {
        command.env("HYDROGRAD_SIMD", "portable");
    }
    let output = command
        .args(["bench", "--case", &serde_json::to_string(request)?])
        .env("CANDLE_NUM_THREADS", threads.to_string())
        .env("RAYON_NUM_THREADS", threads.to_string())
        .stdin(Stdio::null())
        .output()
        .map_err(|error| failed(format!("can not start the program again: {error}")))?;
    if !output.status.success() {
        let message = String::from_utf8_lossy(&output.stderr);
        // The process names the case itself; its advice is dropped.
        let message = message.lines().next().unwrap_or("it said nothing");
        let message = message.trim_start_matches("error: ").trim_start_matches(&format!("{name}: "));
        let problem = format!("{name}: {message} ({})", output.status);
        return Err(match output.status.code() == Some(i32::from(EXIT_DIVERGED)) {
            true => Error::diverged(problem, ADVICE),
            false => Error::run(problem, ADVICE),
        }
        .into());
    }
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.trim()).map_err(|error| failed(format!("can not read `{}`: {error}", text.trim())).into())
}
