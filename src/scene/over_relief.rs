//! The heated channel in three dimensions with fixed particles: its lattice, and what the heights of its wall move.

use super::assembly::Parts;
use crate::config::scene::{Config, DriveName};
use crate::design::deformation::Map;
use crate::design::relief::Relief;
use crate::design::Deformation;
use crate::numerics::threads;
use crate::sph::cloud::steady::Held;
use crate::sph::relief::lattice::row;
use crate::sph::relief::{Channel, OverRelief, ReliefParticles};
use crate::sph::standard::Standard;
use crate::sph::Sweeps;

/// x of the first column, so that one is at the beginning of the hot section and, where the spacing divides that, one at its end.
pub(super) fn first_x(config: &Config) -> f64 {
    let (hot_from, dx) = (config.channel.hot_from, config.resolution.dx);
    // A hair before the next column is that column.
    (hot_from - (hot_from / dx + 1e-9).floor() * dx).max(0.0)
}

/// The channel with fixed particles, and its deformation by the heights of the lower wall. `start_velocity` is by
/// place.
pub(super) fn fixed<R: Sweeps>(
    config: &Config,
    parts: &Parts<R>,
    model: Standard<R>,
    start_velocity: impl Fn([f64; 3]) -> [f64; 3],
) -> (ReliefParticles<R>, Deformation) {
    let (channel, fluid, dx) = (&config.channel, &config.fluid, config.resolution.dx);
    let depth = config.depth();
    let held = match fluid.drive {
        DriveName::BodyForce => None,
        DriveName::FlowRate => Some(Held::FlowRate(depth * config.plane_flow_rate())),
        DriveName::PumpingPower => {
            Some(Held::Power { power: depth * config.plane_power() / fluid.density, length: channel.length })
        }
    };
    let lattice = OverRelief::new(Channel {
        cells: [config.columns(), config.rows(), config.layers()],
        spacing: dx,
        first_x: first_x(config),
        density: fluid.density,
        viscosity: config.kinematic_viscosity(),
        diffusivity: config.thermal_diffusivity(),
        force: config.plane_force(),
        held,
        velocity: fluid.reference_velocity,
        hot: [channel.hot_from, channel.hot_to],
        hot_excess: config.wall.hot_temperature - fluid.inlet_temperature,
        inlet_below: channel.inlet_length,
        outlet_above: channel.length - channel.outlet_length,
        threads: threads::count(),
    });
    let (n, inside, columns) = (lattice.particles(), lattice.channel.inside(), lattice.channel.columns());
    let mut base = vec![0.0; row::COUNT * n];
    let mut relief = Relief::new(0.5 * dx, row::U);
    let height = parts.lattice.spacing * config.rows() as f64;
    for i in 0..n {
        let place = lattice.channel.place(i);
        (0..3).for_each(|d| base[d * n + i] = place[d]);
        let across = [place[0], place[2]];
        if i < inside {
            base[row::U * n + i] = start_velocity(place)[0];
            relief.moves(i, across, 1.0 - place[1] / height);
        } else if i < inside + columns {
            base[(row::U + 1) * n + i] = 1.0;
            relief.moves(i, across, 1.0);
            relief.leans(i, across, None);
        }
    }
    let deformation = Deformation { columns: relief.places.len(), particles: n, map: Map::Relief(relief), base };
    (ReliefParticles::new(model.flow, lattice), deformation)
}
