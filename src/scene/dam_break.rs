//! Dam break: a column of water in the corner of a tank collapses (Colagrossi and Landrini 2003, sec. 6.2;
//! LagrangeBench's DAM data set). In 3D it is periodic along z.

use super::{tank, Exact, Scene};
use crate::config::scene::Config;
use crate::sph::Sweeps;

pub(super) fn build<R: Sweeps>(config: &Config) -> Scene<R> {
    let water = &config.water;
    tank::parts(config, [0.0; 2], [water.length, water.height], Exact::Unknown).build(|_| [0.0; 3])
}
