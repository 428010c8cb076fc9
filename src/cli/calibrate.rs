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
    /// Worker threads, 0 for every core that the process may use.
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
    let (data, folder, epochs) = (&arguments.data, &arguments.out, arguments.epochs);
    RunFolder::check(folder, KIND, Earlier::Replaced)?;
    use_threads(arguments.threads);
    let (metadata, trajectories) = read_data(data, arguments.split)?;
    let trajectory = find(&trajectories, arguments.trajectory.as_deref())?;
    let path = arguments.split.path(data);
    let provenance = {
        let file = open(&path, "data set")?;
        let group = file.group(&trajectory.name)?;
        crate::dataset::store::read_provenance(&path, &group).map_err(unreadable(data))?
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
    let given = &arguments.parameters;
    let is_first = |k: &usize| !given[..*k].contains(&given[*k]);
    let parameters: Vec<Parameter> = (0..given.len()).filter(is_first).map(|k| given[k]).collect();
    let known: Vec<f64> = parameters.iter().map(|parameter| parameter.of(&true_config)).collect();
    let assumed = loaded.text.clone();
    let problem = Calibration::<f64>::new(loaded, &metadata, trajectory, arguments.frames, parameters.clone())?;
    let _own = RunFolder::take(folder, KIND, Earlier::Replaced)?;
    write_bytes_atomically(&folder.join("config.toml"), assumed.as_bytes())?;
    let count = parameters.len();
    let limits = Limits::within(vec![-FACTOR.ln(); count], vec![FACTOR.ln(); count]);
    let mut optimiser = LBfgsB::new(0.3, &vec![0.0; count]).worth(1e-10);
    let bar = Progress::new(epochs as u64 * 100, "calibrate");
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
    let best = search(&mut optimiser, &limits, epochs, &mut evaluate, &mut see)?;
    bar.finish();
    let found = problem.values(&best.at);
    let keys = parameters.iter().map(|p| p.key());
    let header: Vec<&str> = ["epoch", "loss"].into_iter().chain(keys.clone()).chain(["seconds"]).collect();
    write_rows(&folder.join("history.csv"), &header, &rows)?;
    let curve = |of: &dyn Fn(&[f64]) -> f64| rows.iter().map(|row| (row[0] + 1.0, of(row))).collect::<Vec<_>>();
    let error = |k: usize| curve(&|row| (row[2 + k] / known[k] - 1.0).abs());
    let errors = keys.enumerate().map(|(k, key)| (format!("{key}, relative error"), error(k)));
    let curves: Vec<_> = errors.chain([("loss".into(), curve(&|row| row[1]))]).collect();
    compare(&folder.join("history"), "Calibration", "epoch", "", &curves, false, true)?;
    let mut table = Table::new(["", "assumed", "found", "made with", "error"]);
    let mut summary = Record::default();
    for (k, parameter) in parameters.iter().enumerate() {
        let (assumed, found, made_with) = (problem.assumed[k], found[k], known[k]);
        let error = found / made_with - 1.0;
        let [from, to, truth] = [assumed, found, made_with].map(|x| format!("{x:.6}"));
        table.row([parameter.key().to_string(), from, to, truth, format!("{:+.3} %", 100.0 * error)]);
        let row = json!({"assumed": assumed, "found": found, "made_with": made_with, "error": error});
        summary.put(parameter.key(), row);
    }
    summary.put("loss_before", rows[0][1]);
    summary.put("loss", best.loss);
    summary.put("epochs", rows.len());
    summary.put("steps", problem.steps);
    summary.put("frames", arguments.frames);
    summary.put("seconds", clock.elapsed().as_secs_f64());
    files::write_summary(folder, &summary)?;
    page::write(folder)?;
    println!("{}", table.to_text());
    for (parameter, _) in parameters.iter().zip(&best.at).filter(|(_, at)| at.abs() > 0.99 * FACTOR.ln()) {
        let key = parameter.key();
        println!("WARNING: {key} is as far from what was assumed as it may be: assume a value nearer to it");
    }
    if !optimiser.is_done() && best.loss > 1e-6 * rows[0][1] {
        println!("WARNING: not converged; --epochs {} gives it more", 2 * epochs);
    }
    let (before, loss, count, steps) = (rows[0][1], best.loss, rows.len(), problem.steps);
    let seconds = clock.elapsed().as_secs_f64();
    println!("loss {before:.3e} -> {loss:.3e} in {count} epochs of {steps} steps, {seconds:.1} s");
    println!("files in {}: summary.json, history.csv, history.png, report.html", folder.display());
    Ok(())
}
