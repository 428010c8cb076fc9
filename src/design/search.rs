//! The search for a better design: the optimiser proposes a design, a judge evaluates it, and the result is recorded.
//!
//! ```text
//!   optimise.dynamics   surrogate.trust   evaluation of an epoch
//!   solver              -                 by the solver
//!   surrogate           none              by the surrogate; at the end the solver evaluates the first and the best one
//!   surrogate           check             by the surrogate, and in every `check_every`-th epoch by the solver too
//!   surrogate           region            by the solver, of what the corrected surrogate proposes in a trust region
//!   both                -                 by the surrogate for `surrogate.epochs`, then by the solver
//! ```
//!
//! The command line and the Python package run this loop with different [`Watch`]es.

use super::judge::Judge;
use super::optimise::Optimisation;
use super::optimisers::{self, Optimiser, TrustRegion};
use super::problem::{Evaluation, Truth};
use crate::adjoint::gradient::Progress;
use crate::config::scene::{Config, DynamicsName, Trust};
use crate::error::Error;
use crate::numerics::interrupt;
use std::time::Instant;

/// The judges of designs, and the configuration with its keys `optimise` and `surrogate`.
#[derive(Clone, Copy)]
pub struct Search<'a> {
    pub config: &'a Config,
    pub solver: &'a dyn Judge,
    /// The surrogate, if `optimise.dynamics` needs one.
    pub surrogate: Option<&'a dyn Judge>,
}

/// Follows a search, to show it or to write files. A closure over the record is called at the end of each epoch.
pub trait Watch {
    /// Called with the completed fraction of the present epoch.
    fn share(&mut self, _now: &Optimisation, _share: f64) {}

    /// Called at the end of each epoch, which the record includes.
    fn epoch(&mut self, now: &Optimisation) -> anyhow::Result<()>;

    /// Called after the last epoch, when the solver has re-evaluated the best designs of a surrogate.
    fn confirmed(&mut self, _now: &Optimisation) -> anyhow::Result<()> {
        Ok(())
    }
}

impl<F: FnMut(&Optimisation) -> anyhow::Result<()>> Watch for F {
    fn epoch(&mut self, now: &Optimisation) -> anyhow::Result<()> {
        self(now)
    }
}

impl Search<'_> {
    /// The optimiser that starts from a design.
    pub fn optimiser(&self, from: &[f64]) -> Box<dyn Optimiser> {
        let Config { optimise, surrogate, .. } = self.config;
        match optimise.dynamics == DynamicsName::Surrogate && surrogate.trust == Trust::Region {
            true => Box::new(TrustRegion::new(surrogate.radius, surrogate.inner_epochs, from)),
            false => optimisers::of_config(optimise, from),
        }
    }

    /// Runs until the record has `epochs` epochs, the optimiser is done, or a stop is requested.
    ///
    /// # Errors
    /// Those of the judges, except for diverged runs of designs after the first; those of `watch`; [`Error::Stopped`].
    pub fn run(&self, now: &mut Optimisation, epochs: usize, watch: &mut dyn Watch) -> anyhow::Result<()> {
        // Solver steps of proposals, which count for the epoch after them.
        let mut proposals = 0;
        loop {
            let clock = Instant::now();
            if now.history.len() < epochs {
                proposals += self.prepare(now)?;
            }
            if now.is_finished(epochs) {
                break;
            }
            let variables = now.optimiser.ask().to_vec();
            let mut found = self.evaluate(now, &variables, &mut |share| watch.share(now, share));
            if let Ok(found) = &mut found {
                found.solver_steps += std::mem::take(&mut proposals);
            }
            now.record(self.solver, variables, found, clock)?;
            watch.epoch(now)?;
            interrupt::check()?;
        }
        if self.surrogate.is_some() {
            if let Some(last) = now.history.last_mut() {
                last.solver_steps += proposals;
            }
            // A surrogate's result for the first and the best wall must be confirmed by the solver.
            now.confirm(&[0, now.predicted_best()], self.solver)?;
            watch.confirmed(now)?;
        }
        Ok(())
    }

    /// Prepares an epoch by a proposal in the trust region, or the change from surrogate to solver. Returns its solver
    /// steps.
    fn prepare(&self, now: &mut Optimisation) -> Result<usize, Error> {
        let Some(surrogate) = self.surrogate else { return Ok(0) };
        let done = now.history.len();
        if self.config.optimise.dynamics == DynamicsName::Both {
            let over = done >= self.config.surrogate.epochs || now.optimiser.is_done();
            if now.solver_from.is_none() && over && done > 0 {
                now.optimiser = self.optimiser(&now.history[now.predicted_best()].variables);
                now.solver_from = Some(done);
            }
            return Ok(0);
        }
        let mut steps = 0;
        if let Some(region) = now.optimiser.trust_region() {
            region.propose(self.solver.parametrisation().limits(), |variables| {
                let found = surrogate.gradient(variables, &mut |_| ());
                steps += found.as_ref().map_or(0, |found| found.solver_steps);
                found
            })?;
        }
        Ok(steps)
    }

    /// The loss of a design and its gradient, for the optimiser.
    fn evaluate(&self, now: &Optimisation, variables: &[f64], progress: Progress<'_>) -> Result<Evaluation, Error> {
        let wanted = &self.config.surrogate;
        let is_surrogates = wanted.trust != Trust::Region && now.solver_from.is_none();
        let Some(surrogate) = self.surrogate.filter(|_| is_surrogates) else {
            let found = self.solver.gradient(variables, progress)?;
            let predicted = now.optimiser.expectation().map(|loss| self.solver.figure(variables, loss));
            return Ok(Evaluation { predicted, ..found });
        };
        let mut found = surrogate.gradient(variables, progress)?;
        if wanted.trust == Trust::Check && now.history.len().is_multiple_of(wanted.check_every) {
            let truth = self.solver.value(variables)?;
            found.truth = Some(Truth { figure: truth.figure, loss: truth.loss });
            found.solver_steps += truth.solver_steps;
        }
        Ok(found)
    }
}
