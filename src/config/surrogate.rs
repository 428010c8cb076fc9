//! The section `[surrogate]`: the learned model that may evaluate designs, and how its results are checked.

use crate::config::optimise::DynamicsName;
use crate::config::range::{
    Range::{NotNegative, Positive, Within},
    MAX_STEPS,
};
use crate::config::run::Precision;
use crate::config::section::section;
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

section! {
    "surrogate.": Surrogate {
        #[serde(skip_serializing_if = "Option::is_none")]
        model: Option<String> = None;
        settle: usize = 2500, Within(1.0, MAX_STEPS);
        steps: usize = 20, Within(1.0, 10_000.0);
        window: f64 = 0.9, NotNegative;
        first_frames: FirstFrames = FirstFrames::Differentiable;
        precision: Precision = Precision::F32;
        trust: Trust = Trust::None;
        check_every: usize = 5, Within(1.0, 1e6);
        radius: f64 = 5e-3, Positive;
        inner_epochs: usize = 10, Within(1.0, 1e6);
        epochs: usize = 10, Within(1.0, 1e6);
    }
}

/// How the gradient treats the first frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FirstFrames {
    /// They depend on the wall over which the solver made them.
    Differentiable,
    /// They are constant.
    Detached,
}

/// How a surrogate is kept honest.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum Trust {
    /// It is believed; only the first and the best wall are run in the solver, at the end.
    None,
    /// The solver evaluates every `check_every`th wall, and the best of those wins.
    Check,
    /// A trust region: each epoch the solver evaluates a wall that the corrected surrogate proposes near the best one, and the
    /// region shrinks where prediction and truth part.
    Region,
}

impl Surrogate {
    /// Checks that the settings of a surrogate are given only if a search uses one.
    pub fn check(&self, dynamics: DynamicsName) -> Result<(), BadInput> {
        let bad = |problem: &str| BadInput::at("surrogate.trust", problem);
        match (dynamics, self.trust) {
            (DynamicsName::Solver, Trust::Check | Trust::Region) => Err(bad("surrogate.trust without a surrogate")
                .allowed("none where the solver judges every wall")
                .advice("optimise.dynamics=surrogate")),
            (DynamicsName::Both, Trust::Region) => Err(bad("surrogate.trust = region with optimise.dynamics = both")
                .allowed("none or check: in a trust region the solver has its say in every epoch")
                .advice("optimise.dynamics=surrogate")),
            _ => Ok(()),
        }
    }
}
