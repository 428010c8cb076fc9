//! Gradient-based optimisers.
//!
//! An optimiser is asked for the next point to evaluate and told the result: [`Optimiser::ask`], [`Optimiser::tell`].
//! So each evaluation is an epoch that can be recorded, even a line search can be interrupted between two of them, and
//! the caller owns the loop ([`super::search`]).
//!
//! ```
//! use hydrograd::design::limits::Limits;
//! use hydrograd::design::optimisers::{LBfgsB, Optimiser};
//!
//! // (x - 3)^2 over -1 <= x <= 2.
//! let limits = Limits::within(vec![-1.0], vec![2.0]);
//! let mut optimiser = LBfgsB::new(0.1, &[0.0]);
//! while !optimiser.is_done() {
//!     let x = optimiser.ask()[0];
//!     optimiser.tell(&limits, (x - 3.0) * (x - 3.0), &[2.0 * (x - 3.0)]);
//! }
//! assert_eq!(optimiser.ask(), [2.0]);
//! ```
//!
//! A new optimiser needs a file here that implements [`Optimiser`], and a line in [`of_config`].

pub mod adam;
pub mod barzilai_borwein;
pub mod l_bfgs_b;
pub mod trust_region;

pub use adam::Adam;
pub use barzilai_borwein::BarzilaiBorwein;
pub use l_bfgs_b::LBfgsB;
pub use trust_region::TrustRegion;

use super::limits::Limits;
use crate::config::scene::{Optimise, OptimiserName};
use crate::error::BadInput;
use crate::io::tensor_file::{Data, TensorFile, Tensors};
use crate::io::FileError;
use std::collections::BTreeMap;

/// The optimiser of a configuration, starting at `x`.
pub fn of_config(wanted: &Optimise, x: &[f64]) -> Box<dyn Optimiser> {
    match wanted.method {
        OptimiserName::Adam => Box::new(Adam::new(wanted.learning_rate, x)),
        OptimiserName::LBfgsB => Box::new(LBfgsB::new(wanted.learning_rate, x).worth(WORTH)),
    }
}

/// The smallest decrease of a step of L-BFGS-B relative to the loss after which another step is worth its evaluation.
const WORTH: f64 = 1e-6;

/// Minimises a function of `[K]` variables within limits.
pub trait Optimiser: std::fmt::Debug + Send {
    /// The name in tables and files.
    fn name(&self) -> &str;

    /// The point to evaluate next, `[K]`, within the limits.
    fn ask(&self) -> &[f64];

    /// Takes the function's value and gradient at the point that was asked for, and chooses the next one. A value that
    /// is not finite means that the function has none there.
    fn tell(&mut self, limits: &Limits, value: f64, gradient: &[f64]);

    /// Whether the search has ended, because the last point cannot be improved beyond rounding.
    fn is_done(&self) -> bool {
        false
    }

    /// The expected value at the next point, if the optimiser has a model.
    fn expectation(&self) -> Option<f64> {
        None
    }

    /// This optimiser as a trust region, if it is one.
    fn trust_region(&mut self) -> Option<&mut TrustRegion> {
        None
    }

    /// Adds to `record` everything that the next points depend on, except the next point itself.
    fn save(&self, record: &mut Record);

    /// Restores what [`Self::save`] wrote into an optimiser with the same settings, made at the next point. The search
    /// continues to the bit.
    ///
    /// # Errors
    /// A value that is missing, of another size, or not finite.
    fn restore(&mut self, file: &TensorFile) -> Result<(), BadInput>;
}

/// The content of a checkpoint: tensors and texts by name.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Record {
    pub tensors: Tensors,
    pub metadata: BTreeMap<String, String>,
}

impl Record {
    pub fn put(&mut self, name: &str, shape: &[usize], values: Vec<f64>) {
        self.tensors.insert(name.into(), (shape.to_vec(), Data::F64(values)));
    }

    pub fn note(&mut self, key: &str, text: impl std::fmt::Display) {
        self.metadata.insert(key.into(), text.to_string());
    }
}

/// A tensor of finite numbers from a checkpoint.
///
/// # Errors
/// A tensor that is missing or of another shape, and the first number that is not finite.
pub fn numbers(file: &TensorFile, name: &str, shape: &[usize]) -> Result<Vec<f64>, BadInput> {
    let values = file.f64(name, shape).map_err(unreadable)?;
    match values.iter().position(|x| !x.is_finite()) {
        None => Ok(values.to_vec()),
        Some(k) => {
            let problem = format!("{}: {name}[{k}] = {}", file.path.display(), values[k]);
            Err(BadInput::new(problem).allowed("finite numbers"))
        }
    }
}

/// A whole number from a checkpoint's metadata.
///
/// # Errors
/// An entry that is missing or not a whole number.
pub fn count(file: &TensorFile, key: &str) -> Result<usize, BadInput> {
    let text = file.text(key).map_err(unreadable)?;
    text.parse().map_err(|_| {
        let problem = format!("{}: {key} = `{text}` in its metadata", file.path.display());
        BadInput::new(problem).allowed("a whole number")
    })
}

pub fn unreadable(error: FileError) -> BadInput {
    BadInput::new(error.to_string())
}
