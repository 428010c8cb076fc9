//! A velocity on a grid that a flow around shapes begins with, `initial.file`.

use crate::config::scene::Config;
use crate::error::BadInput;
use crate::io::grid_file::read_velocity;
use crate::numerics::grid_field::{Grid, GridVelocity, POINTS};
use std::path::Path;

/// A velocity `[2][points]` at the points i L / N of a grid over the region of a configuration; `name`: what gives it.
///
/// # Errors
/// Too few points, and numbers that are not finite.
pub fn on_grid(
    config: &Config,
    name: &str,
    shape: [usize; 2],
    velocity: [Vec<f64>; 2],
) -> Result<GridVelocity, BadInput> {
    let bad = |problem: String| BadInput::at("initial.file", format!("{name} has {problem}"));
    if shape.iter().any(|&n| n < POINTS) {
        return Err(
            bad(format!("a velocity at {shape:?} points")).allowed(format!("{POINTS} points or more along each axis"))
        );
    }
    if velocity.iter().flatten().any(|x| !x.is_finite()) {
        return Err(bad("a velocity at the start that is not finite everywhere".into())
            .allowed("finite numbers, inside of shapes too"));
    }
    let region = &config.region;
    let grid = Grid { shape, size: [0, 1].map(|d| region.size[d]), periodic: [0, 1].map(|d| region.periodic[d]) };
    Ok(GridVelocity { grid, velocity })
}

/// That of the file of a configuration, if it names one.
///
/// # Errors
/// Files that cannot be read, and as [`on_grid`].
pub fn of_config(config: &Config) -> Result<Option<GridVelocity>, BadInput> {
    let Some(file) = &config.initial.file else { return Ok(None) };
    let wrong = |problem: String| BadInput::at("initial.file", problem);
    let (shape, velocity) = read_velocity(Path::new(file), 2, None).map_err(|error| wrong(error.to_string()))?;
    let unshaped = |_| wrong("initial.file has a velocity without two axes".into()).allowed("[N, N, 2]");
    let velocity = velocity.try_into().map_err(unshaped)?;
    Ok(Some(on_grid(config, "initial.file", [shape[0], shape[1]], velocity)?))
}
