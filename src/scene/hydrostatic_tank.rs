//! Still water under gravity: its pressure is rho g times the depth, and its velocity is zero.
//!
//! If the density evolves, the water starts with the density that the equation of state has for this pressure.

use super::{tank, Exact, Scene};
use crate::config::scene::Config;
use crate::sph::rows::Quantity;
use crate::sph::Sweeps;

pub(super) fn build<R: Sweeps>(config: &Config) -> Scene<R> {
    let height = config.water.height;
    let mut scene: Scene<R> =
        tank::parts(config, [0.0; 2], [config.tank.length, height], Exact::Unknown).build(|_| [0.0; 3]);
    let (model, n, l) = (scene.model.clone(), scene.model.particles(), scene.model.rows);
    if let Some(row) = l.row(Quantity::Density) {
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let depth = height - scene.start.state[n + i].f64();
            let pressure = -config.fluid.density * config.fluid.gravity[1] * depth;
            scene.start.state[row * n + i] = model.equation_of_state.density(R::of(pressure));
        }
    }
    scene
}
