//! The rows of the standard method's packed tensors `[rows, N]`.

use crate::sph::rows::{Quantity, Rows};

/// Which fields a scene needs, and in which rows of the packed tensors `[rows, N]` they are.
///
/// Without heat there is no row for temperature, without a transport velocity no second acceleration, and with one
/// constant mass of all particles no row for mass. D is the dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    pub dimension: usize,
    pub transport: bool,
    pub heat: bool,
    pub mass: bool,
    /// Whether the density evolves as a row of the state; otherwise each step sums it.
    pub density: bool,
}

impl Layout {
    fn d(&self) -> usize {
        self.dimension
    }
    fn w(&self) -> usize {
        self.dimension * self.transport as usize
    }

    /// State: position D, velocity D, acceleration D, (transport acceleration D), (temperature, its rate), (mass),
    /// (density).
    pub fn rows(&self) -> Rows {
        let further = [
            (true, Quantity::Acceleration),
            (self.transport, Quantity::TransportAcceleration),
            (self.heat, Quantity::Temperature),
            (self.heat, Quantity::TemperatureRate),
            (self.mass, Quantity::Mass),
            (self.density, Quantity::Density),
        ];
        let further: Vec<Quantity> =
            further.into_iter().filter(|(wanted, _)| *wanted).map(|(_, quantity)| quantity).collect();
        Rows::new(self.dimension, &further)
    }
    pub fn state_rows(&self) -> usize {
        self.state_density() + self.density as usize
    }
    pub fn velocity(&self) -> usize {
        self.d()
    }
    pub fn acceleration(&self) -> usize {
        2 * self.d()
    }
    pub fn transport_acceleration(&self) -> usize {
        3 * self.d()
    }
    pub fn temperature(&self) -> usize {
        3 * self.d() + self.w()
    }
    pub fn temperature_rate(&self) -> usize {
        self.temperature() + 1
    }
    pub fn state_mass(&self) -> usize {
        self.temperature() + 2 * self.heat as usize
    }
    pub fn state_density(&self) -> usize {
        self.state_mass() + self.mass as usize
    }

    /// Rows of the moved state, after the drift: position D, velocity D, (transport velocity - velocity D),
    /// (temperature before, temperature after), (mass), (density before).
    pub fn moved_rows(&self) -> usize {
        self.moved_density() + self.density as usize
    }
    pub fn moved_shift(&self) -> usize {
        2 * self.d()
    }
    pub fn moved_old_temperature(&self) -> usize {
        2 * self.d() + self.w()
    }
    pub fn moved_temperature(&self) -> usize {
        self.moved_old_temperature() + 1
    }
    pub fn moved_mass(&self) -> usize {
        self.moved_old_temperature() + 2 * self.heat as usize
    }
    pub fn moved_density(&self) -> usize {
        self.moved_mass() + self.mass as usize
    }

    /// Primitives, also of walls: density, velocity D, (transport velocity - velocity D), (temperature).
    pub fn primitive_rows(&self) -> usize {
        self.primitive_temperature() + self.heat as usize
    }
    pub fn primitive_velocity(&self) -> usize {
        1
    }
    pub fn primitive_shift(&self) -> usize {
        1 + self.d()
    }
    pub fn primitive_temperature(&self) -> usize {
        1 + self.d() + self.w()
    }

    /// Rows of the rates: acceleration D, (transport acceleration D), (temperature rate).
    pub fn rate_rows(&self) -> usize {
        self.rate_temperature() + self.heat as usize
    }
    pub fn rate_temperature(&self) -> usize {
        self.d() + self.w()
    }
}
