//! Options of `hydrograd bench`.

use super::case::{Group, Size};
use crate::cli::arguments::{at_least_one, threads};
use crate::config::builtin;
use crate::config::device::DeviceName;
use crate::config::memory_size::MemorySize;
use crate::config::scene::{Kernels, Precision};
use crate::error::BadInput;
use crate::numerics::threads::available;
use clap::{Args, ValueEnum};
use std::path::{Path, PathBuf};

/// Time steps and gradients, with peak memory: best and median of several repeats, each in a process of its own.
///
/// Groups: step, gradient, scaling, plan (these four run if none is named), kernels, surrogate and accuracy. Variants that are compared
/// take turns, so that a machine that gets slower hits all of them.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd bench --quick
      step, gradient, scaling and plan in under a minute
  hydrograd bench step gradient --threads 2 --precision f64
      the heated channel only, one variant
  hydrograd bench scaling --sizes 100^2,1000^2,40^3 --filter /f32/2/
      Taylor-Green vortices of three sizes; rows whose label contains the text
  hydrograd bench step my.toml --set time.steps=400 --repeats 9
      a scene of your own (a gradient is that of a scene with a design)
  hydrograd bench step --compare runs/before/bench.json --out runs/after
      ratios against an earlier run
  hydrograd bench kernels --threads 2
      what fused operators save against those composed of candle's own, step and gradient
  hydrograd bench surrogate --threads 2
      GNS-10-128 and GNS-5-64 on 950 particles, f32: training step and prediction, GFLOP/s against sgemm
  hydrograd bench accuracy --peers jax-sph.json
      run time against error, with another code's points in the same pictures")]
pub struct BenchArguments {
    /// Groups (step, gradient, scaling, plan, kernels, surrogate, accuracy) and at most one scene (name or TOML file) for step and
    /// gradient [default: step gradient scaling plan].
    #[arg(value_name = "GROUP|SCENE")]
    pub words: Vec<String>,
    /// Override a key of the heated channel, e.g. `--set time.steps=400`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Preset of the scene for step and gradient: report.
    #[arg(long, value_name = "NAME")]
    pub preset: Option<String>,
    /// Folder for bench.json, accuracy.json and the pictures.
    #[arg(long, value_name = "DIR", default_value = "runs/bench")]
    pub out: PathBuf,
    /// Floating-point types, separated by commas.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "f64,f32")]
    pub precision: Vec<Precision>,
    /// Numbers of threads, separated by commas; 0 for every core that the process may use [default: 1,2].
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = threads, allow_hyphen_values = true)]
    pub threads: Vec<usize>,
    /// Implementation of the operators (`kernels` measures both).
    #[arg(long, value_enum, default_value = "fused")]
    pub kernels: Kernels,
    /// Where the operators run: cpu, cuda or cuda:N; a GPU takes composed ones (`kernels`: those, with fused ones on the CPU).
    #[arg(long, value_name = "DEVICE", default_value_t)]
    pub device: DeviceName,
    /// Repeats of each row, each in a new process [default: 3; with --quick 1].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub repeats: Option<usize>,
    /// Only rows whose label group/scene/particles/precision/threads/kind/mode contains this.
    #[arg(long, value_name = "TEXT", default_value = "", hide_default_value = true)]
    pub filter: String,
    /// Fewer and shorter repeats, fewer sizes and variants: under a minute.
    #[arg(long)]
    pub quick: bool,
    /// The bench.json of an earlier run: adds the ratio new/old.
    #[arg(long, value_name = "FILE")]
    pub compare: Option<PathBuf>,
    /// Taylor-Green sizes of `scaling`, particles per side ^ dimension, separated by commas, e.g. 100^2,20^3.
    #[arg(long, value_name = "SIZES", value_delimiter = ',', value_parser = Size::parse)]
    pub sizes: Vec<Size>,
    /// A further row of `gradient`: the fastest schedule within this memory, such as 20MB.
    #[arg(long, value_name = "SIZE")]
    pub memory: Option<MemorySize>,
    /// Leave out gradients predicted to take more than this.
    #[arg(long, value_name = "SIZE", default_value = "4GB")]
    pub memory_limit: MemorySize,
    /// Other codes' points for `accuracy`: a JSON array of {code, scene, dx, cfl, precision, seconds, error, stable};
    /// an earlier accuracy.json will do.
    #[arg(long, value_name = "FILE")]
    pub peers: Option<PathBuf>,
    /// Runs one case, given as JSON, and prints what it measured as JSON: what the bench starts for each row.
    #[arg(long, hide = true, value_name = "JSON", conflicts_with = "words")]
    pub case: Option<String>,
}

impl BenchArguments {
    /// The groups to run and the scene of step and gradient, if one is named among the words.
    pub fn groups_and_scene(&self) -> Result<(Vec<Group>, Option<String>), BadInput> {
        let (mut groups, mut scene) = (Vec::new(), None);
        for word in &self.words {
            if let Ok(group) = Group::from_str(word, false) {
                if !groups.contains(&group) {
                    groups.push(group);
                }
            } else if scene.is_some() {
                return Err(BadInput::new(format!("`{word}` is a second scene"))
                    .place(format!("bench {}", self.words.join(" ")))
                    .allowed("groups and at most one scene"));
            } else if builtin::scene_or_example(word).is_some() || Path::new(word).is_file() || word.ends_with(".toml")
            {
                scene = Some(word.clone());
            } else {
                let groups: Vec<String> = Group::value_variants().iter().map(|group| group.name()).collect();
                return Err(BadInput::new(format!("`{word}` is neither a group nor a scene"))
                    .place(format!("bench {}", self.words.join(" ")))
                    .allowed(format!("{}; a built-in scene or a TOML file", groups.join(", "))));
            }
        }
        if groups.is_empty() {
            groups.extend(Group::DEFAULT);
        }
        Ok((groups, scene))
    }

    /// The threads to measure with.
    pub fn threads(&self) -> Vec<usize> {
        let cores = available();
        each_once(match self.threads.is_empty() {
            false => self.threads.iter().map(|&count| if count == 0 { cores } else { count }).collect(),
            true if self.quick => vec![cores.min(2)],
            true => vec![1, cores.min(2)],
        })
    }

    /// The threads of groups that measure with one number of them.
    pub fn last_threads(&self) -> usize {
        self.threads().last().copied().unwrap_or(1)
    }

    /// The floating-point types to measure.
    pub fn precisions(&self) -> Vec<Precision> {
        each_once(self.precision.clone())
    }

    pub fn repeats(&self) -> usize {
        self.repeats.unwrap_or(if self.quick { 1 } else { 3 })
    }
}

fn each_once<T: Copy + PartialEq>(mut values: Vec<T>) -> Vec<T> {
    let mut seen = Vec::new();
    values.retain(|value| !seen.contains(value) && (seen.push(*value), true).1);
    values
}
