//! The kinds of fits, and the rows of their results.

use super::stencil::monomials;

/// The kind of fit of a field, which is its column of [`super::Fits::weights`].
#[inline(always)]
pub const fn kind(dimension: usize, fields: usize, field: usize) -> usize {
    match field {
        _ if fields == 1 => PRESSURE,
        _ if field < dimension => VELOCITY,
        _ if field == dimension => PRESSURE,
        _ => TEMPERATURE,
    }
}
pub const VELOCITY: usize = 0;
pub const PRESSURE: usize = 1;
pub const TEMPERATURE: usize = 2;
pub const KINDS: usize = 3;
/// The column of the weights of the no-flux condition.
pub const NO_FLUX: usize = 3;

/// Number of rows of the derivatives: a fit per field, the volume, and the shift c.
pub const fn rows(dimension: usize, fields: usize) -> usize {
    fields * monomials(dimension) + 1 + dimension
}
