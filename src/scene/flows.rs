//! Verification flows, most of which have an exact solution. `data/scenes` has their values.
//!
//! Reference velocity, density and length are 1, so the Reynolds number is 1/viscosity. Channels are periodic in x and
//! have y = 0 on the lower wall's surface. Other boxes have their corner at 0, 0.

use super::assembly::{count, Parts};
use super::composite_slab::Series;
use super::developed::{parabola, Developed};
use super::lattice::{Lattice, WallHeat};
use super::{Exact, Scene};
use crate::config::scene::{Config, Family, Method, ShiftName, UpperWall};
use crate::sph::flow::Materials;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;
use std::f64::consts::PI;
use std::sync::Arc;

/// Smallest initial displacement of the vortices in the consistent method. In an exact lattice that is stretched, each
/// particle is drawn equally from both sides, so no shift acts, and the particles stay in strings until the fit fails.
const LEAST_JITTER: f64 = 0.02;

/// How many columns channels have whose flow does not vary along them: they are as long as so many spacings.
pub(super) fn columns_of(family: Family) -> Option<usize> {
    match family {
        Family::Poiseuille | Family::Couette => Some(12),
        Family::Slab => Some(8),
        _ => None,
    }
}

pub(super) fn build<R: Sweeps>(config: &Config) -> Scene<R> {
    let kinematic_viscosity = 1.0 / config.flow.reynolds;
    let (dimension, walls) = (config.dimension(), config.wall_rows());
    let flow = |lattice: Lattice| Parts {
        density: 1.0,
        velocity: 1.0,
        viscosity: kinematic_viscosity,
        ..Parts::new(config, lattice)
    };
    let channel = |columns: usize| Lattice::channel(columns, count(config, 1.0), walls);
    let short = channel(columns_of(config.scene).unwrap_or(1));
    let parts = match config.scene {
        // Plane Poiseuille flow, started from rest by a constant force (Morris, Fox and Zhu 1997). The velocity is that
        // of the steady centre line.
        Family::Poiseuille => Parts {
            body_force: BodyForce::Uniform(8.0 * kinematic_viscosity),
            exact: Exact::Poiseuille { velocity: 1.0, kinematic_viscosity },
            ..flow(short)
        },
        // Plane Couette flow, started from rest by the moving upper wall (Morris, Fox and Zhu 1997).
        Family::Couette => {
            Parts { lid: 1.0, exact: Exact::Couette { velocity: 1.0, kinematic_viscosity }, ..flow(short) }
        }
        // Opposite forces in the two halves of a periodic box (Backer et al. 2005). The fluid is at rest at y = 0, 1, 2,
        // and each half is plane Poiseuille flow with a steady centre line of force Re / 8. In three dimensions the box
        // is half as deep as long, and periodic in z too (LagrangeBench's data set), with the same exact solution.
        Family::ReversePoiseuille | Family::ReversePoiseuille3d => {
            let (strength, per_height) = (config.fluid.body_force, count(config, 1.0));
            let velocity = strength * config.flow.reynolds / 8.0;
            let cells = [per_height, 2 * per_height, per_height / 2];
            Parts {
                body_force: BodyForce::Reversing { strength, turn: 1.0 },
                exact: Exact::ReversePoiseuille { velocity, kinematic_viscosity },
                ..flow(Lattice::new(dimension, 1.0 / per_height as f64, cells))
            }
        }
        // A square (Ghia, Ghia and Shin 1982) or cubic box of fluid whose upper wall moves along x. It is periodic in x
        // for the lid's particles; walls separate the fluid from its images.
        Family::LidDrivenCavity | Family::LidDrivenCavity3d => {
            let per_side = count(config, 1.0);
            let lattice = Lattice {
                wall_rows: [walls, walls, if dimension == 2 { 0 } else { walls }],
                periodic: [true, false, false],
                ..Lattice::new(dimension, 1.0 / per_side as f64, [per_side + 2 * walls; 3])
            };
            Parts { lid: 1.0, ..flow(lattice) }
        }
        Family::IsothermalChannel => isothermal_channel(config, flow(channel(count(config, config.channel.length)))),
        Family::Slab => slab(config, Parts { viscosity: 1.0, ..flow(short) }),
        // Decaying vortices (Taylor and Green 1937) in a periodic box. The unit box has an exact solution. In three
        // dimensions, in a box of 2 pi (Brachet et al. 1983), the energy starts to decay as exp(-6 nu t).
        _ => {
            let size = if dimension == 2 { 1.0 } else { 2.0 * PI };
            let per_side = count(config, size);
            let mut parts = flow(Lattice::new(dimension, size / per_side as f64, [per_side; 3]));
            if dimension == 2 {
                parts.exact = Exact::TaylorGreen { velocity: 1.0, kinematic_viscosity };
            }
            if let Method::Consistent(_) = config.method {
                parts.config.time.jitter = config.time.jitter.max(LEAST_JITTER);
            }
            parts
        }
    };
    parts.build(|place| start_velocity(config, place), |place| start_pressure(config, place))
}

/// Heat transfer to developed flow between parallel plates, both with one temperature or one adiabatic (Shah and London
/// 1978, chapter VI).
///
/// The walls' temperature is 1; fluid enters with temperature 0. The channel is periodic in x, and fluid that leaves
/// enters again, cold. Behind `hot_from` the walls are warm. There the temperature profile develops, and then keeps its
/// shape while the difference to the walls decays as exp(-b x). The rate of heat transfer is the Nusselt number by the
/// hydraulic diameter 2.
fn isothermal_channel<R: Sweeps>(config: &Config, parts: Parts<R>) -> Parts<R> {
    let (channel, upper_wall) = (&config.channel, config.heat.upper_wall);
    let outlet = channel.length - channel.outlet_length;
    let diffusivity = parts.viscosity / config.heat.prandtl;
    let warm = WallHeat { temperature: 1.0, from: channel.hot_from, to: outlet };
    let upper = match upper_wall {
        UpperWall::Isothermal => warm,
        UpperWall::Adiabatic => WallHeat::ADIABATIC,
    };
    let developed = Developed::new(diffusivity, upper_wall, [channel.hot_from, outlet]);
    let body_force = BodyForce::Uniform(8.0 * parts.viscosity);
    Parts { body_force, exact: Exact::IsothermalChannel(developed), ..parts }.warm(
        diffusivity,
        [channel.inlet_length, outlet],
        [warm, upper],
        None,
    )
}

/// Heat conduction in a slab at rest between two walls with different temperatures, of one material or of two with a
/// jump of conductivity half way (Cleary and Monaghan 1999, section 5).
///
/// The lower half's conductivity and heat capacity are 1, so times are in width^2 over its diffusivity. The slab starts
/// with the upper wall's temperature 0, while the lower wall has temperature 1.
fn slab<R: Sweeps>(config: &Config, mut parts: Parts<R>) -> Parts<R> {
    // Without motion neither a shift nor dissipation is needed.
    parts.config.time.jitter = 0.0;
    match &mut parts.config.method {
        Method::Consistent(own) => own.shift = ShiftName::None,
        Method::Standard(own) => {
            (own.background_pressure_factor, own.transport_velocity, own.artificial_viscosity) = (0.0, 0.0, 0.0);
        }
        Method::Fixed(_) => {}
    }
    let (conductivity, capacity, lattice) =
        (config.heat.conductivity_ratio, config.heat.capacity_ratio, &parts.lattice);
    let is_upper = |i: usize| 2 * lattice.rows(i)[1] >= lattice.cells[1];
    let of = |ratio: f64| (0..lattice.particles()).map(|i| R::of(if is_upper(i) { ratio } else { 1.0 })).collect();
    let materials = (conductivity != 1.0 || capacity != 1.0)
        .then(|| Materials { conductivity: of(conductivity), capacity: of(capacity) });
    parts.exact = Exact::Slab(Arc::new(Series::new(conductivity, capacity)));
    let (walls, nowhere) = ([1.0, 0.0].map(WallHeat::isothermal), [f64::NEG_INFINITY, f64::INFINITY]);
    parts.warm(1.0, nowhere, walls, materials)
}

/// The initial velocity at a place.
pub fn start_velocity(config: &Config, [x, y, z]: [f64; 3]) -> [f64; 3] {
    match config.scene {
        Family::TaylorGreen => {
            let ((sin_x, cos_x), (sin_y, cos_y)) = ((2.0 * PI * x).sin_cos(), (2.0 * PI * y).sin_cos());
            [-cos_x * sin_y, sin_x * cos_y, 0.0]
        }
        Family::TaylorGreen3d => [x.sin() * y.cos() * z.cos(), -x.cos() * y.sin() * z.cos(), 0.0],
        Family::IsothermalChannel => [parabola(y), 0.0, 0.0],
        _ => [0.0; 3],
    }
}

/// The initial pressure, which is that of the incompressible flow.
fn start_pressure(config: &Config, [x, y, z]: [f64; 3]) -> f64 {
    match config.scene {
        Family::TaylorGreen => -0.25 * ((4.0 * PI * x).cos() + (4.0 * PI * y).cos()),
        Family::TaylorGreen3d => ((2.0 * x).cos() + (2.0 * y).cos()) * ((2.0 * z).cos() + 2.0) / 16.0,
        _ => 0.0,
    }
}
