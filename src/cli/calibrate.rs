//! `hydrograd calibrate`: finds viscosity and conductivity from an observed trajectory.

use super::arguments::{at_least_one, set_option, threads};
use super::files;
use super::model_data::{read_data, unreadable};
use super::page;
use super::prepare::use_threads;
use super::rollout::find;
use super::run_folder::{Earlier, RunFolder};
use crate::config::scene::Config;
use crate::dataset::Split;
use crate::design::limits::Limits;
use crate::design::optimisers::{LBfgsB, Optimiser};
use crate::error::BadInput;
use crate::inverse::calibration::{Calibration, Parameter};
use crate::inverse::search::{search, Epoch};
use crate::io::atomic::write_bytes_atomically;
use crate::io::csv::write_rows;
use crate::io::hdf5_file::open;
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::scene::record::Record;
use clap::Args;
use serde_json::json;
use std::path::PathBuf;
use std::time::Instant;

/// Find viscosity and conductivity from a trajectory of a data set (an inverse problem).
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
The trajectory is run again from the same particles with what is assumed of the parameters; each epoch compares places and
temperatures with those that were seen and follows the exact gradient by the parameters' logarithms.

Examples:
  hydrograd generate heated-channel --set time.start=rest --trajectories 1/1/1 --frames 12 --out data/seen
  hydrograd calibrate --data data/seen --set fluid.viscosity=0.016 --set fluid.conductivity=5
      what the first trajectory of the training split was made with, from a wrong guess
  hydrograd calibrate --data data/seen --split test --parameters viscosity --set fluid.viscosity=0.02 --frames 6
      the viscosity alone, from six frames")]
pub struct CalibrateArguments {
    /// Folder of the data set, of the heated channel from rest.
    #[arg(long, value_name = "DIR")]
    pub data: PathBuf,
    /// Which of its files.
    #[arg(long, value_enum, default_value = "train")]
    pub split: Split,
    /// Name of the trajectory [default: the first].
    #[arg(long, value_name = "NAME")]
    pub trajectory: Option<String>,
    /// Frames to look at, from the first on.
    #[arg(long, value_name = "N", default_value_t = 12, value_parser = at_least_one)]
    pub frames: usize,
    /// What to find, separated by commas [default: viscosity,conductivity].
    #[arg(long, value_enum, value_name = "NAME,...", value_delimiter = ',', default_values = ["viscosity", "conductivity"], hide_default_value = true)]
    pub parameters: Vec<Parameter>,
    /// What is assumed at first, e.g. `--set fluid.viscosity=0.02`; may be repeated.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub sets: Vec<String>,
    /// Runs, each with its gradient, at most.
    #[arg(long, value_name = "N", default_value_t = 25, value_parser = at_least_one)]
    pub epochs: usize,
    /// Worker threads, 0 for every core.
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = threads, allow_hyphen_values = true)]
    pub threads: usize,
    /// Folder for the results.
    #[arg(long, value_name = "DIR", default_value = "runs/calibrate")]
    pub out: PathBuf,
}

const KIND: &str = "calibrate";
/// Largest ratio of a parameter to its assumed value.
const FACTOR: f64 = 10.0;

pub fn run(arguments: CalibrateArguments) -> anyhow::Result<()> {
    RunFolder::check(&arguments.out, KIND, Earlier::Replaced)?;
    use_threads(arguments.threads);
    let folder = &arguments.data;
    let (metadata, trajectories) = read_data(folder, arguments.split)?;
    let trajectory = find(&trajectories, arguments.trajectory.as_deref())?;
    let path = arguments.split.path(folder);
    let provenance = {
        let file = open(&path, "data set")?;
        let group = file.group(&trajectory.name)?;
        crate::dataset::store::read_provenance(&path, &group).map_err(unreadable(folder))?
    };
    let true_config = Config::from_record(&provenance.configuration).map_err(|error| {
        BadInput::new(format!("the trajectory's configuration: {error}"))
            .place(path.display().to_string())
            .allowed("a data set made by `hydrograd generate`")
    })?;
    // The trajectory's own settings, and the assumed values.
    let mut settings = true_config.over_its_scene("the trajectory", &[]);
    settings.extend(arguments.sets.iter().map(|text| set_option(text)));
    let loaded = Config::load_settings(Some(true_config.scene.name()), None, &settings)?;
    let mut parameters: Vec<Parameter> = Vec::new();
    for &parameter in &arguments.parameters {
        if !parameters.contains(&parameter) {
            parameters.push(parameter);
        }
    }
    let known: Vec<f64> = parameters.iter().map(|parameter| parameter.of(&true_config)).collect();
    let assumed = loaded.text.clone();
    let problem = Calibration::<f64>::new(loaded, &metadata, trajectory, arguments.frames, parameters.clone())?;
    let _own = RunFolder::take(&arguments.out, KIND, Earlier::Replaced)?;
    write_bytes_atomically(&arguments.out.join("config.toml"), assumed.as_bytes())?;
    let count = parameters.len();
    let limits = Limits::within(vec![-FACTOR.ln(); count], vec![FACTOR.ln(); count]);
    let mut optimiser = LBfgsB::new(0.3, &vec![0.0; count]).worth(1e-10);
    let bar = Progress::new(arguments.epochs as u64 * 100, "calibrate");
    let clock = Instant::now();
    let mut rows = Vec::<Vec<f64>>::new();
    let mut evaluate = |epoch: usize, x: &[f64]| {
        problem.evaluate(x, &mut |share| bar.set_position((100.0 * (epoch as f64 + share)) as u64))
    };
    let mut see = |epoch: Epoch<'_>| {
        let values = problem.values(epoch.at);
        let shown: Vec<String> =
            parameters.iter().zip(&values).map(|(p, value)| format!("{} {value:.6}", p.key())).collect();
        bar.line(&format!("epoch {:3}  loss {:.4e}  {}", epoch.number, epoch.loss, shown.join("  ")));
        rows.push([vec![epoch.number as f64, epoch.loss], values, vec![clock.elapsed().as_secs_f64()]].concat());
    };
    let best = search(&mut optimiser, &limits, arguments.epochs, &mut evaluate, &mut see)?;
    bar.finish();
    let found = problem.values(&best.at);
    let mut header = vec!["epoch", "loss"];
    header.extend(parameters.iter().map(|p| p.key()));
    header.push("seconds");
    write_rows(&arguments.out.join("history.csv"), &header, &rows)?;
    let curve =
        |k: usize| rows.iter().map(|row| (row[0] + 1.0, (row[2 + k] / known[k] - 1.0).abs())).collect::<Vec<_>>();
    let mut curves: Vec<(String, Vec<(f64, f64)>)> =
        parameters.iter().enumerate().map(|(k, p)| (format!("{}, relative error", p.key()), curve(k))).collect();
    curves.push(("loss".into(), rows.iter().map(|row| (row[0] + 1.0, row[1])).collect()));
    compare(&arguments.out.join("history"), "Calibration", "epoch", "", &curves, false, true)?;
    let mut table = Table::new(["", "assumed", "found", "made with", "error"]);
    let mut summary = Record::default();
    for (k, parameter) in parameters.iter().enumerate() {
        let error = found[k] / known[k] - 1.0;
        let number = |x: f64| format!("{x:.6}");
        let cells =
            [number(problem.assumed[k]), number(found[k]), number(known[k]), format!("{:+.3} %", 100.0 * error)];
        table.row([vec![parameter.key().to_string()], cells.to_vec()].concat());
        let row = json!({"assumed": problem.assumed[k], "found": found[k], "made_with": known[k], "error": error});
        summary.put(parameter.key(), row);
    }
    summary.put("loss_before", rows[0][1]);
    summary.put("loss", best.loss);
    summary.put("epochs", rows.len());
    summary.put("steps", problem.steps);
    summary.put("frames", arguments.frames);
    summary.put("seconds", clock.elapsed().as_secs_f64());
    files::write_summary(&arguments.out, &summary)?;
    page::write(&arguments.out)?;
    println!("{}", table.to_text());
    for (k, parameter) in parameters.iter().enumerate() {
        if best.at[k].abs() > 0.99 * FACTOR.ln() {
            println!(
                "WARNING: {} is as far from what was assumed as it may be: assume a value nearer to it",
                parameter.key()
            );
        }
    }
    if !optimiser.is_done() && best.loss > 1e-6 * rows[0][1] {
        println!("WARNING: not converged; --epochs {} gives it more", 2 * arguments.epochs);
    }
    println!(
        "loss {:.3e} -> {:.3e} in {} epochs of {} steps, {:.1} s",
        rows[0][1],
        best.loss,
        rows.len(),
        problem.steps,
        clock.elapsed().as_secs_f64()
    );
    println!("files in {}: summary.json, history.csv, history.png, report.html", arguments.out.display());
    Ok(())
}
