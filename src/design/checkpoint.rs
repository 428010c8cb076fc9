//! The checkpoint of an optimisation: a safetensors file from which the optimisation continues to the bit.
//!
//! ```text
//!   offsets [K]                 the design that the next epoch evaluates
//!   offsets_best [K]            the best one
//!   history.offsets [E, K]      of each epoch: variables,
//!   history.q, .loss, .gradient_norm, .seconds [E]      objective, loss, norm of its gradient, time
//!   history.gradient_error [E]  of gradients that are averaged over an ensemble, see [`super::problem::Evaluation`]
//!   history.truth_q, .truth_loss, .predicted_q, .solver_steps [E]     by solver and surrogate; NaN where not evaluated
//!   adam.*                      what the optimiser adds, see [`Optimiser::save`]
//! ```
//!
//! The metadata have the kind of file, `epochs`, `best_epoch`, the configuration and the program's version.

use super::optimise::{Epoch, Optimisation};
use super::optimisers::{count, unreadable, Optimiser, Record};
use super::parametrisations::Parametrisation;
use super::problem::Truth;
use crate::error::BadInput;
use crate::io::tensor_file::{write_tensors, TensorFile};
use crate::io::FileError;
use std::path::Path;

/// The kind of file in the metadata.
pub const KIND: &str = "hydrograd optimisation";

/// Writes a checkpoint after at least one epoch. `notes` (the configuration, the version, ...) go into its metadata.
pub fn write(path: &Path, optimisation: &Optimisation, notes: &[(&str, String)]) -> Result<(), FileError> {
    let (history, x) = (&optimisation.history, optimisation.optimiser.ask());
    let (k, epochs) = (x.len(), history.len());
    let mut record = Record::default();
    record.put("offsets", &[k], x.to_vec());
    record.put("offsets_best", &[k], history[optimisation.best].variables.clone());
    let variables = history.iter().flat_map(|epoch| epoch.variables.iter().copied()).collect();
    record.put("history.offsets", &[epochs, k], variables);
    record.put("history.q", &[epochs], optimisation.column(|e| e.figure));
    record.put("history.loss", &[epochs], optimisation.column(|e| e.loss));
    record.put("history.gradient_norm", &[epochs], optimisation.column(|e| e.gradient_norm));
    if history.iter().any(|epoch| epoch.gradient_error > 0.0) {
        record.put("history.gradient_error", &[epochs], optimisation.column(|e| e.gradient_error));
    }
    record.put("history.seconds", &[epochs], optimisation.column(|e| e.seconds));
    let truth = |of: fn(&Truth) -> f64| optimisation.column(|e| e.truth.as_ref().map_or(f64::NAN, of));
    record.put("history.truth_q", &[epochs], truth(|truth| truth.figure));
    record.put("history.truth_loss", &[epochs], truth(|truth| truth.loss));
    record.put("history.predicted_q", &[epochs], optimisation.column(|e| e.predicted.unwrap_or(f64::NAN)));
    record.put("history.solver_steps", &[epochs], optimisation.column(|e| e.solver_steps as f64));
    if let Some(epoch) = optimisation.solver_from {
        record.note("solver_from", epoch);
    }
    record.note("kind", KIND);
    record.note("epochs", epochs);
    record.note("best_epoch", optimisation.best);
    notes.iter().for_each(|(key, text)| record.note(key, text));
    optimisation.optimiser.save(&mut record);
    write_tensors(path, &record.tensors, &record.metadata)
}

/// Reads the optimisation of a checkpoint. `begin` makes the optimiser at a point.
///
/// # Errors
/// Values that no optimisation could have written.
pub fn restore(
    file: &TensorFile,
    parametrisation: &dyn Parametrisation,
    begin: impl FnOnce(&[f64]) -> Box<dyn Optimiser>,
) -> Result<Optimisation, BadInput> {
    let k = parametrisation.variables();
    let epochs = count(file, "epochs")?;
    let best = count(file, "best_epoch")?;
    if best >= epochs.max(1) {
        let problem = format!("{}: best_epoch = {best} of {epochs} epochs", file.path.display());
        return Err(BadInput::new(problem).allowed("a checkpoint written by this version"));
    }
    let column = |name: &str| file.f64(name, &[epochs]).map_err(unreadable);
    let variables = file.f64("history.offsets", &[epochs, k]).map_err(unreadable)?;
    let (q, loss) = (column("history.q")?, column("history.loss")?);
    let (norm, seconds) = (column("history.gradient_norm")?, column("history.seconds")?);
    let has_errors = file.tensors.contains_key("history.gradient_error");
    let error = has_errors.then(|| column("history.gradient_error")).transpose()?;
    // Earlier versions had no surrogate, so all their results are the solver's.
    let judged = file.tensors.contains_key("history.truth_q");
    let (truth_q, truth_loss) = match judged {
        true => (column("history.truth_q")?, column("history.truth_loss")?),
        false => (q, loss),
    };
    let (predicted, steps) = match judged {
        true => (Some(column("history.predicted_q")?), Some(column("history.solver_steps")?)),
        false => (None, None),
    };
    let is_known = |e: usize| !truth_q[e].is_nan() || truth_loss[e] == f64::INFINITY;
    let history = (0..epochs)
        .map(|e| Epoch {
            variables: variables[e * k..(e + 1) * k].to_vec(),
            figure: q[e],
            loss: loss[e],
            gradient_norm: norm[e],
            gradient_error: error.map_or(0.0, |error| error[e]),
            seconds: seconds[e],
            truth: is_known(e).then(|| Truth { figure: truth_q[e], loss: truth_loss[e] }),
            predicted: predicted.map(|q| q[e]).filter(|q| !q.is_nan()),
            solver_steps: steps.map_or(0, |steps| steps[e] as usize),
            ..Epoch::default()
        })
        .collect();
    let x = file.f64("offsets", &[k]).map_err(unreadable)?;
    parametrisation.check(x).map_err(|bad| bad.place(file.path.display().to_string()))?;
    let mut optimiser = begin(x);
    optimiser.restore(file)?;
    let solver_from = file.metadata.contains_key("solver_from").then(|| count(file, "solver_from")).transpose()?;
    Ok(Optimisation { optimiser, history, best, solver_from })
}
