//! The solver as the judge of the designs of a configuration.

use super::build_design;
use super::load::Loaded;
use crate::design::Scheduled;
use crate::error::Error;
use crate::sph::Sweeps;

/// The design problem that `optimise.search` chooses for a configuration, with the schedule of its gradient.
///
/// # Errors
/// A scene without a design, and values that are not allowed.
pub fn solver<R: Sweeps>(loaded: &Loaded) -> Result<Scheduled<R>, Error> {
    let located = |error| loaded.located_error(error);
    let (problem, _) = build_design::<R>(&loaded.for_search()?.config).map_err(located)?;
    let schedule = problem.schedule(&loaded.config.optimise, loaded.config.run.precision).map_err(located)?;
    Ok(Scheduled { problem, schedule })
}
