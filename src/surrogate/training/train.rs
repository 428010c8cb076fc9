//! The training loop.
//!
//! A step draws windows, adds noise, applies the model, and updates the parameters by the mean gradient. Random numbers
//! follow from seed and step, and a checkpoint has the rest, so an interrupted training continues bit for bit.

use crate::config::device::Compute;
use crate::config::training::Settings;
use crate::dataset::{Metadata, Trajectory};
use crate::error::Error;
use crate::io::atomic::{prepare_output_folder, write_bytes_atomically};
use crate::io::csv::{write_table, Cell};
use crate::io::tensorboard::EventFile;
use crate::report::plots::{training_curves, ErrorCurve};
use crate::report::progress::Progress;
use crate::surrogate::evaluation::scores::{evaluate_windows, Options, Scores};
use crate::surrogate::models::baselines::ConstantVelocity;
use crate::surrogate::models::learned::Learned;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::adamw::learning_rate;
use crate::surrogate::network::parameters::{Network, Parameter};
use crate::surrogate::training::batch::{Found, Team};
use crate::surrogate::training::begin::{Origin, TrainingData, LAST};
use crate::surrogate::training::checkpoint::{self, TrainingState};
use crate::surrogate::training::objective::{Errors, Pairs};
use crate::surrogate::training::samples::Samples;
use candle_core::Var;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Instant;

/// The columns of history.csv.
pub const HISTORY_COLUMNS: [&str; 4] = ["step", "seconds", "loss", "learning_rate"];
/// The columns of objective.csv: errors of the objective over pairs of the validation split, in per cent.
pub const OBJECTIVE_COLUMNS: [&str; 4] = ["step", "seconds", "value", "difference"];
/// The columns of validation.csv after `step` and `seconds`.
pub const METRICS: [&str; 7] = ["mse_1", "mse_5", "mse_10", "mse_20", "sinkhorn", "e_kin", "temperature_mse"];

pub struct Training<'a> {
    pub settings: &'a Settings,
    pub setup: &'a Setup,
    pub metadata: &'a Metadata,
    pub train: &'a [Trajectory],
    pub valid: &'a [Trajectory],
    pub network: Arc<dyn Network>,
    pub state: TrainingState,
    /// The ranks that train together.
    pub team: Team<'a>,
    pub folder: PathBuf,
    /// Whether any rank was asked to stop.
    pub is_to_stop: bool,
    /// The rows of history.csv, validation.csv and objective.csv so far.
    pub history: Vec<Vec<f64>>,
    pub validation: Vec<Vec<f64>>,
    pub objective: Vec<Vec<f64>>,
    /// Pairs of trajectories to train on their objective, and those of the validation split, if that is wanted.
    pub pairs: Option<[Pairs<'a>; 2]>,
}

impl<'a> Training<'a> {
    /// The initial state of [`Self::run`]. Nothing is written yet.
    pub fn new(
        settings: &'a Settings,
        setup: &'a Setup,
        data: &'a TrainingData,
        origin: &Origin,
        compute: impl Into<Compute>,
        team: Team<'a>,
        folder: &Path,
    ) -> anyhow::Result<Self> {
        let (network, state) = origin.network(settings, setup, compute)?;
        let rows = |name: &str| match origin.resumes() {
            true => read_rows(&folder.join(name), state.step),
            false => Vec::new(),
        };
        let of = |split| Pairs::new(&settings.objective, settings.seed, setup, &network, &data.metadata, split);
        let pairs = match settings.objective.weight > 0.0 {
            true => Some([of(&data.train)?, of(&data.valid)?]),
            false => None,
        };
        Ok(Self {
            settings,
            setup,
            metadata: &data.metadata,
            train: &data.train,
            valid: &data.valid,
            network,
            history: rows("history.csv"),
            validation: rows("validation.csv"),
            objective: rows("objective.csv"),
            pairs,
            state,
            team,
            folder: folder.to_owned(),
            is_to_stop: false,
        })
    }

    /// Number of trained values.
    pub fn parameters(&self) -> usize {
        self.network.parameters().iter().map(Parameter::count).sum()
    }

    /// Runs up to `settings.steps`. All files go to the folder, including the settings as config.toml.
    ///
    /// # Errors
    /// A request to stop, a loss or gradient that is not finite, files, tensors.
    pub fn run(&mut self, bar: &Progress) -> anyhow::Result<Outcome> {
        let settings = self.settings;
        prepare_output_folder(&self.folder)?;
        write_bytes_atomically(&self.folder.join("config.toml"), settings.text().as_bytes())?;
        let mut events = EventFile::create(&self.folder)?;
        let mut samples = Samples::new(self.metadata, self.train, settings, self.setup)?;
        let variables = self.variables();
        let linear = self.score(&ConstantVelocity)?;
        let before = self.state.seconds;
        let clock = Instant::now();
        let (mut working, mut steps) = (0.0, 0);
        let mut scores = None;
        bar.set_position(self.state.step);
        while self.state.step < settings.steps {
            let update = Instant::now();
            let rate = self.learning_rate();
            let value = self.update(&mut samples, &variables, rate)?;
            self.state.losses.push(value);
            working += update.elapsed().as_secs_f64();
            steps += 1;
            self.state.step += 1;
            self.state.seconds = before + clock.elapsed().as_secs_f64();
            bar.done(1);
            let last = self.state.step == settings.steps;
            if self.state.step.is_multiple_of(settings.log_every) || last {
                let losses = std::mem::take(&mut self.state.losses);
                let mean = losses.iter().sum::<f64>() / losses.len() as f64;
                self.history.push(vec![self.state.step as f64, self.state.seconds, mean, rate]);
                events.scalars(self.state.step, &[("loss", mean), ("learning_rate", rate)])?;
                bar.message(format!("loss {mean:.4}"));
                write_rows(&self.folder.join("history.csv"), &HISTORY_COLUMNS, &self.history)?;
            }
            if self.state.step.is_multiple_of(settings.validate_every) || last {
                scores = Some(self.validate(&linear, &mut events, bar)?);
            }
            if self.state.step.is_multiple_of(settings.store_every) || last || self.is_to_stop {
                self.store(LAST)?;
            }
            self.check_for_stop()?;
        }
        let scores = match scores {
            Some(scores) => scores,
            None => self.score(&self.predictor())?,
        };
        Ok(Outcome { scores, linear, best_step: self.best_step(), seconds_per_step: working / f64::from(steps.max(1)) })
    }

    /// Runs the same updates on all ranks but the first, which writes the results.
    pub fn follow(&mut self) -> anyhow::Result<()> {
        let mut samples = Samples::new(self.metadata, self.train, self.settings, self.setup)?;
        let variables = self.variables();
        while self.state.step < self.settings.steps {
            let rate = self.learning_rate();
            self.update(&mut samples, &variables, rate)?;
            self.state.step += 1;
            self.check_for_stop()?;
        }
        Ok(())
    }

    fn variables(&self) -> Vec<Var> {
        self.network.parameters().iter().map(|p| p.values.clone()).collect()
    }

    /// The learning rate of the next step.
    fn learning_rate(&self) -> f64 {
        let settings = self.settings;
        learning_rate(
            settings.learning_rate,
            settings.learning_rate_factor,
            settings.learning_rate_steps,
            settings.learning_rate_least,
            self.state.step,
        )
    }

    /// Returns an error if any rank was asked to stop before the end.
    fn check_for_stop(&self) -> Result<(), Error> {
        match self.is_to_stop && self.state.step < self.settings.steps {
            true => Err(Error::Stopped),
            false => Ok(()),
        }
    }

    /// Makes one update and returns the mean loss of its batch.
    ///
    /// # Errors
    /// A loss or gradient that is not finite, tensors.
    pub fn update(&mut self, samples: &mut Samples, variables: &[Var], rate: f64) -> anyhow::Result<f64> {
        let (settings, step) = (self.settings, self.state.step);
        let (network, weight) = (&*self.network, settings.temperature_weight);
        let Found { mut loss, gradients: mut sum, is_to_stop } =
            self.team.gradient(samples, step, settings.batch_size, network, weight, self.metadata.dim)?;
        self.is_to_stop = is_to_stop;
        if let Some([pairs, _]) = self.pairs.as_mut().filter(|_| step.is_multiple_of(settings.objective.every)) {
            let (more, gradients) = pairs.gradient(step, network)?;
            loss += more;
            sum = sum.iter().zip(&gradients).map(|(a, b)| a + b).collect::<candle_core::Result<_>>()?;
        }
        let mut square = 0.0;
        for gradient in &sum {
            square += f64::from(gradient.sqr()?.sum_all()?.to_scalar::<f32>()?);
        }
        if !loss.is_finite() || !square.is_finite() {
            return Err(Error::run(
                format!("step {step}: the loss is {loss}, the gradient's norm {}: the training has diverged", square.sqrt()),
                "a smaller learning rate (learning_rate=1e-4) or clipping (clip=1); a resumed training begins at the last checkpoint",
            )
            .into());
        }
        if settings.clip > 0.0 && square.sqrt() > settings.clip {
            let factor = settings.clip / square.sqrt();
            sum = sum.iter().map(|g| g.affine(factor, 0.0)).collect::<candle_core::Result<_>>()?;
        }
        self.state.optimiser.step(variables, &sum, rate)?;
        if let Some(average) = &mut self.state.average {
            for (average, parameter) in average.iter_mut().zip(self.network.parameters()) {
                let now = parameter.values.as_detached_tensor();
                *average = (average.affine(settings.ema, 0.0)? + now.affine(1.0 - settings.ema, 0.0)?)?;
            }
        }
        Ok(loss)
    }

    /// The trained model, with averaged parameters if there are any.
    pub fn predictor(&self) -> Learned {
        let mut learned =
            Learned::new(format!("{:?}", self.setup.kind).to_lowercase(), self.setup.clone(), self.network.clone());
        if let Some(average) = &self.state.average {
            learned.parameters = average.clone();
        }
        learned
    }

    fn score(&self, predictor: &dyn crate::surrogate::predictor::Predictor) -> anyhow::Result<Scores> {
        let options = Options {
            steps: self.settings.validation_steps,
            windows: Some(self.settings.validation_windows),
            ..Options::default()
        };
        evaluate_windows(predictor, self.metadata, self.valid, &options, &mut || ())
    }

    /// The error of a model: position MSE, and with heat temperature MSE, over those of the linear baseline.
    fn merit(scores: &Scores, linear: &Scores) -> f64 {
        let heat = match (scores.temperature_mse, linear.temperature_mse) {
            (Some(ours), Some(linear)) if linear > 0.0 => ours / linear,
            _ => 0.0,
        };
        scores.mse / linear.mse.max(f64::MIN_POSITIVE) + heat
    }

    fn validate(&mut self, linear: &Scores, events: &mut EventFile, bar: &Progress) -> anyhow::Result<Scores> {
        let scores = self.score(&self.predictor())?;
        let Scores { mse_1, mse_5, mse_10, mse_20, sinkhorn, e_kin, temperature_mse, .. } = scores;
        let metrics = [mse_1, mse_5, mse_10, mse_20, sinkhorn, e_kin, temperature_mse];
        let times = [self.state.step as f64, self.state.seconds];
        let row = [&times[..], &metrics.map(|metric| metric.unwrap_or(f64::NAN))].concat();
        let tags = METRICS.iter().zip(&row[2..]).filter(|(_, v)| v.is_finite());
        let tags: Vec<(String, f64)> = tags.map(|(name, &value)| (format!("validation/{name}"), value)).collect();
        events.scalars(self.state.step, &tags.iter().map(|(name, v)| (name.as_str(), *v)).collect::<Vec<_>>())?;
        self.validation.push(row);
        let header = [&["step", "seconds"], &METRICS[..]].concat();
        write_rows(&self.folder.join("validation.csv"), &header, &self.validation)?;
        let of_objective = self.validate_objective()?;
        let merit = Self::merit(&scores, linear);
        if merit < self.state.best {
            self.state.best = merit;
            self.store("best.safetensors")?;
        }
        let broken =
            if scores.broken.is_empty() { String::new() } else { format!(", {} windows broke", scores.broken.len()) };
        let digits = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.2e}"));
        bar.log(&format!(
            "step {}: MSE_1 {} MSE_5 {} MSE_20 {}{}{of_objective}{broken} ({:.2} of linear, {:.0} s)",
            self.state.step,
            digits(scores.mse_1),
            digits(scores.mse_5),
            digits(scores.mse_20),
            scores.temperature_mse.map_or(String::new(), |t| format!(" temperature {t:.2e}")),
            merit,
            self.state.seconds,
        ));
        self.plot(linear)?;
        Ok(scores)
    }

    /// Adds a row to objective.csv, if the training has an objective, and returns it as text.
    fn validate_objective(&mut self) -> anyhow::Result<String> {
        let Some([_, pairs]) = &mut self.pairs else { return Ok(String::new()) };
        let average = self.state.average.as_deref();
        let Errors { values: [a, b], difference } =
            pairs.validate(self.settings.validation_windows, average, &*self.network)?;
        let value = (0.5 * (a * a + b * b)).sqrt();
        self.objective.push(vec![self.state.step as f64, self.state.seconds, value, difference]);
        write_rows(&self.folder.join("objective.csv"), &OBJECTIVE_COLUMNS, &self.objective)?;
        Ok(format!(" objective {value:.2} %, from wall to wall {difference:.2} %"))
    }

    /// Plots `curves.png` and `.svg` from the rows of both tables.
    fn plot(&self, linear: &Scores) -> anyhow::Result<()> {
        let column = |rows: &[Vec<f64>], k: usize| rows.iter().map(|row| (row[0], row[k])).collect::<Vec<_>>();
        let errors = [
            ("MSE_1", "mse_1", linear.mse_1),
            ("MSE_5", "mse_5", linear.mse_5),
            ("MSE_20", "mse_20", linear.mse_20),
            ("temperature", "temperature_mse", linear.temperature_mse),
        ];
        let place = |metric: &str| METRICS.iter().position(|name| *name == metric);
        let errors: Vec<ErrorCurve> = errors
            .into_iter()
            .filter_map(|(name, metric, baseline)| {
                Some(ErrorCurve { name, points: column(&self.validation, 2 + place(metric)?), baseline })
            })
            .collect();
        training_curves(&self.folder.join("curves"), &column(&self.history, 2), &errors, &linear.model)?;
        Ok(())
    }

    fn best_step(&self) -> Option<u64> {
        Some(checkpoint::read(&self.folder.join("best.safetensors")).ok()?.step)
    }

    fn store(&self, name: &str) -> anyhow::Result<()> {
        checkpoint::write(&self.folder.join(name), self.settings, self.setup, &*self.network, &self.state)
    }
}

/// The result of a training.
pub struct Outcome {
    /// Scores of the last validation.
    pub scores: Scores,
    pub linear: Scores,
    /// Step of the best validation; none if no validation was completed.
    pub best_step: Option<u64>,
    /// Wall-clock time per update, without validation.
    pub seconds_per_step: f64,
}

/// Writes rows of numbers as a table; the first number is an integer.
fn write_rows(path: &Path, header: &[&str], rows: &[Vec<f64>]) -> anyhow::Result<()> {
    let cell = |(k, &v): (usize, &f64)| match k {
        0 => Cell::Integer(v as i64),
        _ if v.is_nan() => Cell::Text(String::new()),
        _ => Cell::Number(v),
    };
    let rows: Vec<Vec<Cell>> = rows.iter().map(|row| row.iter().enumerate().map(cell).collect()).collect();
    Ok(write_table(path, header, &rows)?)
}

/// Reads the rows of a table up to a step, to resume a training. Empty cells are NaN.
fn read_rows(path: &Path, up_to: u64) -> Vec<Vec<f64>> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let row = |line: &str| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect::<Vec<f64>>();
    text.lines().skip(1).map(row).filter(|row| row[0] <= up_to as f64).collect()
}
