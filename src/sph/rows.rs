//! The rows of a state: which quantity is in which row.

/// A quantity of a particle in a state. A vector takes one row for each dimension.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    Position,
    Velocity,
    Acceleration,
    TransportAcceleration,
    Pressure,
    Temperature,
    TemperatureRate,
    Mass,
    Density,
}

impl Quantity {
    /// The name in messages and plans.
    pub fn name(self) -> &'static str {
        match self {
            Self::Position => "position",
            Self::Velocity => "velocity",
            Self::Acceleration => "acceleration",
            Self::TransportAcceleration => "transport acceleration",
            Self::Pressure => "pressure",
            Self::Temperature => "temperature",
            Self::TemperatureRate => "temperature rate",
            Self::Mass => "mass",
            Self::Density => "density",
        }
    }

    fn is_vector(self) -> bool {
        matches!(self, Self::Position | Self::Velocity | Self::Acceleration | Self::TransportAcceleration)
    }
}

/// The largest number of quantities in a state.
const MOST: usize = 8;

/// The rows of a state `[F, N]`: position, velocity, then the further quantities of the method.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rows {
    /// Number of dimensions, D.
    pub dimension: usize,
    quantities: [Option<Quantity>; MOST],
}

impl Rows {
    /// The rows of position, velocity and the `further` quantities, in this order.
    pub fn new(dimension: usize, further: &[Quantity]) -> Self {
        let mut quantities = [None; MOST];
        let all = [Quantity::Position, Quantity::Velocity].iter().chain(further);
        quantities.iter_mut().zip(all).for_each(|(place, quantity)| *place = Some(*quantity));
        assert!(further.len() + 2 <= MOST, "a state has at most {MOST} quantities");
        Self { dimension, quantities }
    }

    fn width(&self, quantity: Quantity) -> usize {
        if quantity.is_vector() {
            self.dimension
        } else {
            1
        }
    }

    pub fn quantities(&self) -> impl Iterator<Item = Quantity> + '_ {
        self.quantities.iter().flatten().copied()
    }

    /// The number of rows, F.
    pub fn count(&self) -> usize {
        self.quantities().map(|quantity| self.width(quantity)).sum()
    }

    /// The first row of a quantity, or none if the state does not have it.
    pub fn row(&self, wanted: Quantity) -> Option<usize> {
        let mut row = 0;
        for quantity in self.quantities() {
            if quantity == wanted {
                return Some(row);
            }
            row += self.width(quantity);
        }
        None
    }

    /// The first row of the velocity.
    pub fn velocity(&self) -> usize {
        self.dimension
    }

    /// The row of the temperature relative to the reference, where the scene has heat.
    pub fn temperature(&self) -> Option<usize> {
        self.row(Quantity::Temperature)
    }

    /// The quantity that a row belongs to.
    pub fn quantity(&self, row: usize) -> Option<Quantity> {
        let mut behind = 0;
        self.quantities().find(|quantity| {
            behind += self.width(*quantity);
            row < behind
        })
    }

    /// The name of each row, such as `velocity x`.
    pub fn names(&self) -> Vec<String> {
        self.quantities().flat_map(|quantity| components(quantity.name(), self.width(quantity))).collect()
    }
}

/// The names of a vector's components, or the name itself for a scalar.
pub fn components(name: &str, width: usize) -> Vec<String> {
    match width {
        1 => vec![name.to_string()],
        _ => ["x", "y", "z"][..width].iter().map(|axis| format!("{name} {axis}")).collect(),
    }
}
