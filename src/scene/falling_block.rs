//! A block of water that falls into an empty tank (JAX-SPH's CW, the cube of water of its inverse problem).

use super::{tank, Exact, Scene};
use crate::config::scene::Config;
use crate::sph::Sweeps;

pub(super) fn build<R: Sweeps>(config: &Config) -> Scene<R> {
    let water = &config.water;
    let to = [water.x + water.length, water.y + water.height];
    tank::parts(config, [water.x, water.y], to, Exact::Unknown).build(|_| [0.0, -water.speed, 0.0])
}
