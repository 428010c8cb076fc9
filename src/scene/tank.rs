//! Water in a tank with walls on all sides and gravity: dam break, falling block and still water.
//!
//! The lower corner of the tank's inside is at 0, 0; in 3D it is periodic along z. Above the water there is nothing.

use super::assembly::{count, Parts};
use super::lattice::Lattice;
use super::particle_fields::ParticleFields;
use super::Scene;
use crate::config::scene::{Config, Family};
use crate::particles::tag;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::rows::Quantity;
use crate::sph::Sweeps;

pub(super) fn build<R: Sweeps>(config: &Config) -> Scene<R> {
    let (tank, water, spacing) = (&config.tank, &config.water, config.resolution.dx);
    let (dimension, walls) = (config.dimension(), config.wall_rows());
    // Two corners of the block of water, and its velocity.
    let (from, to, velocity) = match config.scene {
        // A block of water that falls into an empty tank (JAX-SPH's CW, the cube of water of its inverse problem).
        Family::FallingBlock => {
            let to = [water.x + water.length, water.y + water.height];
            ([water.x, water.y], to, [0.0, -water.speed, 0.0])
        }
        Family::HydrostaticTank => ([0.0; 2], [tank.length, water.height], [0.0; 3]),
        // A column of water in the corner of a tank collapses (Colagrossi and Landrini 2003, sec. 6.2; LagrangeBench's
        // DAM data set).
        _ => ([0.0; 2], [water.length, water.height], [0.0; 3]),
    };
    let inside = [tank.length, tank.height, tank.depth].map(|extent| count(config, extent));
    let first = [count(config, from[0]), count(config, from[1]), 0];
    let behind = [count(config, to[0]), count(config, to[1]), inside[2]];
    let periodic = [false, false, dimension == 3];
    let lattice = Lattice::between([walls, walls, 0], dimension, spacing, inside, periodic);
    let parts = Parts::new(config, lattice.with_block(first, behind));
    let mut scene =
        Parts { body_force: BodyForce::Gravity(config.fluid.gravity), ..parts }.build(|_| velocity, |_| 0.0);
    if config.scene == Family::HydrostaticTank {
        fill_with_still_water(config, &mut scene);
    }
    scene
}

/// Root mean square of the error of still water's pressure over its fluid particles, over the pressure at the bottom; none in
/// other scenes.
pub fn pressure_error(config: &Config, end: &ParticleFields) -> Option<f64> {
    let weight = -config.fluid.density * config.fluid.gravity[1];
    let (n, height) = (end.tag.len(), config.water.height);
    let fluid = (0..n).filter(|&i| end.tag[i] == tag::FLUID);
    let square = |i: usize| (end.pressure[i] - weight * (height - end.position[n + i])).powi(2);
    let (sum, count) = fluid.fold((0.0, 0.0), |(sum, count), i| (sum + square(i), count + 1.0));
    (config.scene == Family::HydrostaticTank).then(|| (sum / count).sqrt() / (weight * height))
}

/// Gives still water, whose pressure is rho g times the depth, the density that the equation of state has for this
/// pressure, if the density evolves.
fn fill_with_still_water<R: Sweeps>(config: &Config, scene: &mut Scene<R>) {
    let (model, n) = (&scene.model, scene.model.particles());
    let Some(row) = model.rows.row(Quantity::Density) else { return };
    for i in (0..n).filter(|&i| model.is_fluid(i)) {
        let depth = config.water.height - scene.start.state[n + i].f64();
        let pressure = -config.fluid.density * config.fluid.gravity[1] * depth;
        scene.start.state[row * n + i] = model.equation_of_state.density(R::of(pressure));
    }
}
