//! The rows of the consistent method's state `[F, N]`.

use crate::sph::rows::{Quantity, Rows};

/// Rows of a state: position D, velocity D, pressure, (temperature), and, for integrators that use them, the last
/// step's acceleration D and (rate of temperature).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Layout {
    /// Number of dimensions, D.
    pub dimension: usize,
    pub heat: bool,
    /// Whether the state holds the rates of the last step.
    pub rates: bool,
}

impl Layout {
    pub fn rows(&self) -> Rows {
        let further = [
            (true, Quantity::Pressure),
            (self.heat, Quantity::Temperature),
            (self.rates, Quantity::Acceleration),
            (self.rates && self.heat, Quantity::TemperatureRate),
        ];
        let further: Vec<Quantity> =
            further.into_iter().filter(|(wanted, _)| *wanted).map(|(_, quantity)| quantity).collect();
        Rows::new(self.dimension, &further)
    }
    pub fn state_rows(&self) -> usize {
        self.last_rates() + self.rates as usize * (self.dimension + self.heat as usize)
    }
    /// Number of fitted fields: velocity D, pressure, (temperature).
    pub fn fields(&self) -> usize {
        self.dimension + 1 + self.heat as usize
    }
    pub fn velocity(&self) -> usize {
        self.dimension
    }
    pub fn pressure(&self) -> usize {
        2 * self.dimension
    }
    pub fn temperature(&self) -> usize {
        2 * self.dimension + 1
    }
    /// The first row of the last step's rates.
    pub fn last_rates(&self) -> usize {
        self.dimension + self.fields()
    }
}
