//! A row of the results, bench.json, and ratios against that of an earlier run.

use super::case::{label, Case, Group, Kind, Measured};
use crate::config::device::DeviceName;
use crate::error::BadInput;
use crate::numerics::roofline::Roofline;
use crate::report::VERSION;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// A measured case. Times are those of the best repeat unless stated otherwise; a gradient's include its forward run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Row {
    pub group: Group,
    pub scene: String,
    pub dimension: usize,
    /// Number of particles, including those of walls.
    pub particles: usize,
    /// Directed pairs (i, j) within the cut-off with i fluid, at the start of the timing; for networks the graph's
    /// edges.
    pub pairs: usize,
    pub precision: String,
    pub threads: usize,
    pub kind: Kind,
    pub steps: usize,
    pub ms_per_step: f64,
    pub ns_per_particle_step: f64,
    pub ns_per_pair: f64,
    /// Peak memory of the measuring process, including the program; the largest of the repeats.
    pub peak_memory_bytes: u64,
    /// Device, if it is not the CPU.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub device: Option<String>,
    /// How states are kept, or whether the plan or every field is used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ms_per_step_median: Option<f64>,
    /// Number of timed runs for best and median.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeats: Option<usize>,
    /// Ratio of backward to forward time in the fastest gradient.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub adjoint_over_forward: Option<f64>,
    /// Predicted memory of a gradient's schedule, without the program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub predicted_memory_bytes: Option<usize>,
    /// Relative difference between the results with every field and with the plan.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub difference: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub time_step: Option<f64>,
    /// Work of a step, work per second, and for networks that of the machine's sgemm with the same shapes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gflop_per_step: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gflops: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sgemm_gflops: Option<f64>,
    /// For flows: bytes of the arrays of a step, each once, what the machine can do, and the time that it would need for them at least.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bytes_per_step: Option<usize>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub peak_gflops: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gigabytes_per_second: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub roofline_ms_per_step: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub instruction_set: Option<String>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub version: Option<String>,
}

impl Row {
    /// The row of a case with measurements. Empty `all` is a bug.
    /// `gflop` is the work of a step of a flow, where it was counted.
    pub fn new(case: &Case, all: &[Measured], gflop: Option<f64>) -> Self {
        let first = &all[0];
        let gflop = first.gflop.or(gflop);
        let most = |of: fn(&Measured) -> Option<f64>| all.iter().filter_map(of).reduce(f64::max);
        let (peak_gflops, gigabytes_per_second) = (most(|m| m.peak_gflops), most(|m| m.gigabytes_per_second));
        let roofline = || -> Option<f64> {
            let roofline = Roofline { operations: 1e9 * peak_gflops?, bytes: 1e9 * gigabytes_per_second? };
            Some(1e3 * roofline.seconds(1e9 * gflop?, first.bytes_per_step? as f64))
        };
        // Repeats choose their own numbers of steps, so times are compared per step.
        let runs = || {
            all.iter().flat_map(|m| {
                let forward = m.forward_seconds.iter().copied().map(Some).chain(std::iter::repeat(None));
                m.seconds.iter().copied().zip(forward).map(|(seconds, forward)| (m.steps, seconds, forward))
            })
        };
        let mut per_step: Vec<f64> = runs().map(|(steps, seconds, _)| 1e3 * seconds / steps as f64).collect();
        per_step.sort_by(f64::total_cmp);
        let speed = |(steps, seconds, _): &(usize, f64, Option<f64>)| seconds / *steps as f64;
        let fastest = runs().min_by(|a, b| speed(a).total_cmp(&speed(b)));
        let adjoint = fastest.and_then(|(_, seconds, forward)| forward.map(|forward| (seconds - forward) / forward));
        let ms = per_step[0];
        Self {
            group: case.group,
            scene: case.scene.clone(),
            dimension: first.dimension,
            particles: case.particles,
            pairs: first.pairs,
            precision: case.precision.name().into(),
            threads: case.threads,
            kind: case.kind,
            steps: fastest.map_or(first.steps, |(steps, ..)| steps),
            ms_per_step: ms,
            ns_per_particle_step: 1e6 * ms / case.particles as f64,
            ns_per_pair: 1e6 * ms / first.pairs as f64,
            peak_memory_bytes: all.iter().map(|m| m.peak_memory_bytes).max().unwrap_or(0),
            device: (case.device != DeviceName::Cpu).then(|| case.device.to_string()),
            mode: case.mode.clone(),
            ms_per_step_median: Some(median(&per_step)),
            repeats: Some(per_step.len()),
            adjoint_over_forward: adjoint,
            predicted_memory_bytes: first.predicted_bytes,
            difference: first.difference,
            time_step: Some(first.time_step),
            gflop_per_step: gflop,
            gflops: gflop.map(|gflop| 1e3 * gflop / ms),
            sgemm_gflops: most(|m| m.sgemm_gflops),
            bytes_per_step: first.bytes_per_step,
            peak_gflops,
            gigabytes_per_second,
            roofline_ms_per_step: roofline(),
            instruction_set: Some(first.instruction_set.clone()),
            version: Some(VERSION.into()),
        }
    }

    /// The label, as [`Case::label`].
    pub fn label(&self) -> String {
        let Self { group, scene, particles, precision, threads, kind, mode, .. } = self;
        label(*group, scene, *particles, precision, *threads, *kind, mode)
    }
}

/// The median of sorted values; the mean of the middle two if their number is even.
pub fn median(sorted: &[f64]) -> f64 {
    let (low, high) = (sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2]);
    0.5 * (low + high)
}

/// Reads a JSON array by reading each of its values; an error names the number of the `noun`.
pub fn read_array<T>(
    path: &Path,
    noun: &str,
    bad: impl Fn(String) -> BadInput,
    item: impl Fn(Value) -> Result<T, String>,
) -> Result<Vec<T>, BadInput> {
    let text = std::fs::read_to_string(path).map_err(|error| bad(error.to_string()))?;
    let values: Vec<Value> =
        serde_json::from_str(&text).map_err(|error| bad(format!("not an array of JSON: {error}")))?;
    let items = values.into_iter().map(item).enumerate();
    items.map(|(number, item)| item.map_err(|problem| bad(format!("{noun} {number}: {problem}")))).collect()
}

/// Milliseconds per step of an earlier run, by label.
pub struct Earlier {
    best: BTreeMap<String, f64>,
}

impl Earlier {
    /// Reads the bench.json of an earlier run.
    pub fn read(path: &Path) -> Result<Self, BadInput> {
        let bad = |problem: String| {
            BadInput::new(problem)
                .place(format!("--compare {}", path.display()))
                .allowed("the bench.json of an earlier `hydrograd bench`: an array of rows")
        };
        let rows = read_array(path, "row", bad, |value| {
            let row: Row = serde_json::from_value(value).map_err(|error| error.to_string())?;
            match row.ms_per_step > 0.0 {
                true => Ok(row),
                false => Err(format!("ms_per_step = {} is not above 0", row.ms_per_step)),
            }
        })?;
        if rows.is_empty() {
            return Err(bad("it has no rows".into()));
        }
        Ok(Self { best: rows.iter().map(|row| (row.label(), row.ms_per_step)).collect() })
    }

    /// New time over old; `None` if the earlier run lacks the row.
    pub fn ratio(&self, row: &Row) -> Option<f64> {
        self.best.get(&row.label()).map(|old| row.ms_per_step / old)
    }

    /// One line with the number of common rows, the geometric mean of their ratios and the largest one.
    pub fn summary(&self, rows: &[Row]) -> String {
        let ratios: Vec<(f64, String)> = rows.iter().filter_map(|row| Some((self.ratio(row)?, row.label()))).collect();
        let (old, both) = (self.best.len(), ratios.len());
        let counts = format!("{both} of {} rows are in the earlier run, which has {old}", rows.len());
        let Some((worst, label)) = ratios.iter().max_by(|a, b| a.0.total_cmp(&b.0)) else { return counts };
        let mean = (ratios.iter().map(|(ratio, _)| ratio.ln()).sum::<f64>() / both as f64).exp();
        format!("{counts}; new/old: geometric mean {mean:.3}, largest {worst:.3} ({label})")
    }
}
