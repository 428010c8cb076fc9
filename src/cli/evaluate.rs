//! `hydrograd evaluate`: compares a model with the truth and with two baselines.

use super::arguments::at_least_one;
use super::files::{write_json, VERSION};
use super::machine;
use super::model_data::{ModelData, ModelDataArguments};
use super::page;
use super::run_folder::{Earlier, RunFolder};
use crate::report::plots::compare;
use crate::report::progress::Progress;
use crate::report::table::Table;
use crate::report::text::shown;
use crate::surrogate::evaluation::scores::{chosen_windows, evaluate_windows, Curves, Options, Scores};
use crate::surrogate::models::baselines::{ConstantVelocity, Still};
use crate::surrogate::predictor::Predictor;
use clap::Args;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Measure a model's rollouts against the truth, beside constant velocity and no change.
#[derive(Debug, Clone, Args)]
#[command(after_long_help = "\
Examples:
  hydrograd evaluate --model runs/train/best.safetensors --data data/channel
      20 steps from every window of the validation split
  hydrograd evaluate --model runs/train/best.safetensors --data data/channel --split test --out runs/test
      the test split
  hydrograd evaluate --model linear --data data/channel --steps 5 --windows 10
      how good constant velocity is, over 5 steps of 10 windows
  hydrograd evaluate --model runs/ldc/best.safetensors --data data/ldc --steps 400 --relax 5
      long rollouts with five pseudo-steps of SPH after each frame (Neural SPH), beside the model alone")]
pub struct EvaluateArguments {
    #[command(flatten)]
    pub source: ModelDataArguments,
    /// Folder for the results.
    #[arg(long, value_name = "DIR", default_value = "runs/evaluate")]
    pub out: PathBuf,
    /// Frames to predict.
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = at_least_one)]
    pub steps: usize,
    /// At most so many windows, spread evenly [default: all].
    #[arg(long, value_name = "N", value_parser = at_least_one)]
    pub windows: Option<usize>,
}

/// A figure of the table: its name and how to get it.
type Figure = (&'static str, fn(&Scores) -> Option<f64>);

const FIGURES: [Figure; 10] = [
    ("MSE_1", |s| s.mse_1),
    ("MSE_5", |s| s.mse_5),
    ("MSE_10", |s| s.mse_10),
    ("MSE_20", |s| s.mse_20),
    ("MSE over all steps", |s| Some(s.mse)),
    ("Sinkhorn divergence", |s| s.sinkhorn),
    ("E_kin, squared error", |s| s.e_kin),
    ("temperature MSE", |s| s.temperature_mse),
    ("outflow, relative error", |s| s.outflow_error),
    ("seconds per step", |s| Some(s.seconds_per_step)),
];

pub fn run(arguments: EvaluateArguments) -> anyhow::Result<()> {
    let (source, folder) = (&arguments.source, &arguments.out);
    let ModelData { model, metadata, trajectories } = source.read()?;
    let options = Options { steps: arguments.steps, windows: arguments.windows, ..Options::default() };
    let windows = chosen_windows(&trajectories, &options)?;
    let _own = RunFolder::take(folder, "evaluate", Earlier::Replaced)?;

    let mut models = vec![model];
    let baselines: [Box<dyn Predictor>; 2] = [Box::new(ConstantVelocity), Box::new(Still)];
    let first = models[0].name();
    models.extend(baselines.into_iter().filter(|baseline| baseline.name() != first));
    if source.relax.relax.is_some() {
        models.push(source.alone(&metadata)?);
    }
    let bar = Progress::new((models.len() * windows.len()) as u64, "evaluate");
    let mut scores = Vec::new();
    for model in &models {
        bar.message(model.name());
        scores.push(evaluate_windows(&**model, &metadata, &trajectories, &options, &mut || bar.done(1))?);
    }
    bar.finish();

    let file = json!({
        "model": machine::path(&source.model),
        "data": machine::path(&source.data),
        "split": source.split,
        "version": VERSION,
        "scores": scores,
    });
    write_json(&folder.join("evaluation.json"), &file)?;
    let pictures = plot(folder, &scores)?;
    page::write(folder)?;

    let (count, steps, split) = (windows.len(), options.steps, source.split.name());
    println!("{count} windows of {steps} predicted frames, {split} split of {}\n", source.data.display());
    println!("{}", table(&scores));
    for scores in scores.iter().filter(|scores| !scores.broken.is_empty()) {
        let first = &scores.broken[0];
        println!(
            "{} broke in {} of {} windows (it stands still from there on); the first: trajectory {}, frame {}, step {}: {}",
            scores.model,
            scores.broken.len(),
            scores.windows,
            shown(&first.trajectory),
            first.start,
            first.step,
            shown(&first.reason)
        );
    }
    for scores in scores.iter().filter(|scores| scores.sinkhorn_failures > 0) {
        let (model, failures) = (&scores.model, scores.sinkhorn_failures);
        println!("{model}: {failures} Sinkhorn divergences did not converge and are left out");
    }
    println!("files in {}: evaluation.json, {}, report.html", folder.display(), pictures.join(", "));
    Ok(())
}

/// Figures by model, and the ratio of constant velocity to the model.
fn table(scores: &[Scores]) -> Table {
    let names = scores.iter().map(|scores| scores.model.clone());
    let compared = scores.len() > 1 && scores[1].model == ConstantVelocity.name();
    let last = compared.then(|| format!("linear / {}", scores[0].model));
    let mut table = Table::new(std::iter::once(String::new()).chain(names).chain(last));
    for (name, figure) in FIGURES {
        let values: Vec<Option<f64>> = scores.iter().map(figure).collect();
        if values.iter().all(Option::is_none) {
            continue;
        }
        let mut row = vec![name.to_string()];
        row.extend(values.iter().map(|value| value.map_or("-".into(), |value| format!("{value:.3e}"))));
        if let (true, Some(model), Some(Some(linear))) = (compared, values[0], values.get(1)) {
            row.push(match linear / model {
                ratio if model <= 0.0 || !ratio.is_finite() => "-".into(),
                ratio if ratio < 0.01 => format!("{ratio:.1e}"),
                ratio => format!("{ratio:.3}"),
            });
        }
        table.row(row);
    }
    table
}

/// Plots curves by step and returns the names of the plots.
fn plot(folder: &Path, scores: &[Scores]) -> anyhow::Result<Vec<String>> {
    type Curve = fn(&Curves) -> Option<&Vec<f64>>;
    let energy: [Curve; 2] = [|c| Some(&c.e_kin_predicted), |c| Some(&c.e_kin_true)];
    let outflow: [Curve; 2] = [|c| c.outflow_predicted.as_ref(), |c| c.outflow_true.as_ref()];
    let pictures: [(&str, &str, &str, [Curve; 2], bool); 4] = [
        ("mse", "Position error", "MSE (length²)", [|c| Some(&c.mse), |_| None], true),
        (
            "temperature_mse",
            "Temperature error",
            "MSE (temperature²)",
            [|c| c.temperature_mse.as_ref(), |_| None],
            true,
        ),
        ("kinetic_energy", "Kinetic energy, mean over windows", "E_kin", energy, false),
        ("outflow", "Outflowing heat, mean over windows", "Q", outflow, false),
    ];
    let mut names = Vec::new();
    for (stem, title, label, [predicted, truth], log) in pictures {
        // Curves that are not shown keep their place, so that a model has the same colour in all plots.
        let shown = |values: Option<&Vec<f64>>| -> Vec<(f64, f64)> {
            values.into_iter().flatten().enumerate().map(|(k, &y)| ((k + 1) as f64, y)).collect()
        };
        let mut series: Vec<(String, Vec<(f64, f64)>)> =
            scores.iter().map(|s| (s.model.clone(), shown(predicted(&s.curves)))).collect();
        series.push(("true".to_string(), shown(truth(&scores[0].curves))));
        // A model at rest has no energy, and would distort the others' range.
        for (_, points) in series.iter_mut().filter(|(_, points)| !log && points.iter().all(|(_, y)| *y == 0.0)) {
            points.clear();
        }
        // A logarithmic axis cannot show a model without error.
        if series.iter().any(|(_, points)| points.iter().any(|&(_, y)| !log || y > 0.0)) {
            compare(&folder.join(stem), title, "step", label, &series, false, log)?;
            names.push(format!("{stem}.png"));
        }
    }
    Ok(names)
}
