//! Heat transfer to developed flow between parallel plates, both with one temperature or one adiabatic (Shah and London
//! 1978, chapter VI).
//!
//! Height, centre-line velocity, density and the walls' temperature are 1; fluid enters with temperature 0. Coordinates
//! as in [`super::poiseuille`]. The channel is periodic in x, and fluid that leaves enters again, cold. Behind
//! `hot_from` the walls are warm. There the temperature profile develops, and then keeps its shape while the difference
//! to the walls decays as exp(-b x). The rate of heat transfer is the Nusselt number by the hydraulic diameter 2.

use super::assembly::{count, Numerics, Parts};
use super::developed::{parabola, Developed};
use super::lattice::{Lattice, WallHeat};
use super::{Exact, Scene};
use crate::config::scene::{Config, UpperWall};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;

/// The channel and its resolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IsothermalChannel {
    /// Fluid particles across the channel.
    pub rows: usize,
    /// Particles along the channel.
    pub columns: usize,
    /// Velocity of the centre line * height / kinematic viscosity.
    pub reynolds: f64,
    /// Kinematic viscosity over thermal diffusivity.
    pub prandtl: f64,
    pub upper_wall: UpperWall,
    /// x at which the warm walls begin.
    pub hot_from: f64,
    /// Fluid with x below `inlet` is cold; fluid with x above `outlet` keeps its temperature.
    pub inlet: f64,
    pub outlet: f64,
    pub numerics: Numerics,
}

impl IsothermalChannel {
    /// The channel of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        let channel = &config.channel;
        Self {
            rows: count(config, 1.0),
            columns: count(config, channel.length),
            reynolds: config.flow.reynolds,
            prandtl: config.heat.prandtl,
            upper_wall: config.heat.upper_wall,
            hot_from: channel.hot_from,
            inlet: channel.inlet_length,
            outlet: channel.length - channel.outlet_length,
            numerics: Numerics::from_config(config),
        }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        let viscosity = 1.0 / self.reynolds;
        let diffusivity = viscosity / self.prandtl;
        let warm = WallHeat { temperature: 1.0, from: self.hot_from, to: self.outlet };
        let upper = match self.upper_wall {
            UpperWall::Isothermal => warm,
            UpperWall::Adiabatic => WallHeat::ADIABATIC,
        };
        let developed = Developed::new(diffusivity, self.upper_wall, [self.hot_from, self.outlet]);
        Parts {
            name: "isothermal-channel",
            lattice: Lattice::channel(self.columns, self.rows, self.numerics.wall_rows),
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity,
            body_force: BodyForce::Uniform(8.0 * viscosity),
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::IsothermalChannel(developed),
        }
        .warm(diffusivity, [self.inlet, self.outlet], [warm, upper], None)
        .build(|[_, y, _]| [parabola(y), 0.0, 0.0])
    }
}
