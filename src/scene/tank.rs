//! Water in a tank with walls on all sides and gravity: the common part of dam break, falling block and still water.
//!
//! The lower corner of the tank's inside is at 0, 0; in 3D it is periodic along z. Above the water there is nothing.

use super::assembly::{count, Numerics, Parts};
use super::lattice::Lattice;
use super::Exact;
use crate::config::scene::Config;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;

/// The parts of a scene with a block of water between two corners.
pub(super) fn parts<R: Sweeps>(config: &Config, from: [f64; 2], to: [f64; 2], exact: Exact) -> Parts<R> {
    let (tank, spacing, numerics) = (&config.tank, config.resolution.dx, Numerics::from_config(config));
    let (dimension, walls) = (config.dimension(), numerics.wall_rows);
    let inside = [count(config, tank.length), count(config, tank.height), count(config, tank.depth)];
    let first = [count(config, from[0]), count(config, from[1]), 0];
    let behind = [count(config, to[0]), count(config, to[1]), inside[2]];
    let offset = -(walls as f64) * spacing;
    let lattice = Lattice {
        wall_rows: [walls, walls, 0],
        periodic: [false, false, dimension == 3],
        corner: [offset, offset, 0.0],
        ..Lattice::new(dimension, spacing, [inside[0] + 2 * walls, inside[1] + 2 * walls, inside[2]])
    };
    Parts {
        name: config.scene.name(),
        lattice: lattice.with_block(first, behind),
        numerics,
        density: config.fluid.density,
        velocity: config.fluid.reference_velocity,
        viscosity: config.fluid.viscosity,
        body_force: BodyForce::Gravity(config.fluid.gravity),
        drive: None,
        lid: 0.0,
        own_mass: false,
        heat: None,
        heat_walls: None,
        exact,
    }
}
