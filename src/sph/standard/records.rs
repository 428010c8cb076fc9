//! Packed records of the fields that the pair pass reads of a particle.

/// Number of fields of a record in `[N, stride]`: position D, volume, density, velocity D, [transport shift D],
/// [temperature, temperature before this step's conduction].
pub const fn record_fields(d: usize, transport: bool, heat: bool) -> usize {
    2 * d + 2 + if transport { d } else { 0 } + if heat { 2 } else { 0 }
}

/// Index of the temperatures in a record.
pub const fn record_temperature(d: usize, transport: bool) -> usize {
    record_fields(d, transport, false)
}

/// Numbers of a record of what the rate of the density reads: position D, velocity D, volume, c (of the adjoint).
pub const FLOW: usize = 8;

/// Numbers of a record of what a [term](crate::sph::laws::continuity::DensityTerm) of that rate reads: density, vector D.
pub const TERM: usize = 4;

/// Calls a macro with a layout's dimension, transport velocity and heat as literals.
macro_rules! dispatch {
    ($layout:expr, $go:ident) => {
        match ($layout.dimension, $layout.transport, $layout.heat) {
            (2, false, false) => $go!(2, false, false),
            (2, false, true) => $go!(2, false, true),
            (2, true, false) => $go!(2, true, false),
            (2, true, true) => $go!(2, true, true),
            (_, false, false) => $go!(3, false, false),
            (_, false, true) => $go!(3, false, true),
            (_, true, false) => $go!(3, true, false),
            (_, true, true) => $go!(3, true, true),
        }
    };
}
pub(super) use dispatch;
