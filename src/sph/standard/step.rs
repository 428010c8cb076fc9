//! The order of the operators of a time step, for every way to execute them.
//!
//! ```text
//! state --drift--> moved --density--> rho --wall condition--> primitives --rates--> rates
//!                    |                                          |                     |
//!                    +--------------------------- assemble ----+---------------------+--> state
//! ```
//!
//! The order is that of JAX-SPH, so that states agree to rounding. A step is executed on reused buffers, as fused
//! operators on candle's graph, or composed of candle's own operators, see [`crate::sph::solver`].

use crate::adjoint::RunError;

/// A way to execute the operators of a step.
pub trait Execution {
    /// The type of a field of all particles that operators take and return.
    type Field;

    /// state `[F, N]` -> moved `[M, N]`, over a time dt; see [`super::drift`].
    fn drift(&mut self, dt: f64, state: &Self::Field) -> Result<Self::Field, RunError>;
    /// Makes the neighbour list valid for the moved state.
    fn neighbours(&mut self, moved: &Self::Field) -> Result<(), RunError>;
    /// moved -> density `[1, N]`, summed ([`super::density`]; 0 for walls) or evolved over dt ([`super::evolution`]).
    fn density(&mut self, dt: f64, moved: &Self::Field) -> Result<Self::Field, RunError>;
    /// moved, density -> primitives `[C, N]`, also of walls; see [`super::wall_condition`].
    fn wall_condition(&mut self, moved: &Self::Field, density: &Self::Field) -> Result<Self::Field, RunError>;
    /// moved, primitives -> rates `[A, N]`; see [`super::rates`].
    fn rates(&mut self, moved: &Self::Field, primitives: &Self::Field) -> Result<Self::Field, RunError>;
    /// moved, primitives (an evolved density), rates -> state `[F, N]`; see [`super::assemble`].
    fn assemble(
        &mut self,
        moved: &Self::Field,
        primitives: &Self::Field,
        rates: &Self::Field,
    ) -> Result<Self::Field, RunError>;
}

/// The state after one step.
///
/// # Errors
/// Particles that are lost or too fast; tensor errors.
pub fn advance<E: Execution>(execution: &mut E, dt: f64, state: &E::Field) -> Result<E::Field, RunError> {
    let moved = execution.drift(dt, state)?;
    execution.neighbours(&moved)?;
    let density = execution.density(dt, &moved)?;
    let primitives = execution.wall_condition(&moved, &density)?;
    let rates = execution.rates(&moved, &primitives)?;
    execution.assemble(&moved, &primitives, &rates)
}

/// Moved state and primitives of a state that is not advanced, by the present neighbour list.
pub fn look<E: Execution>(execution: &mut E, state: &E::Field) -> Result<(E::Field, E::Field), RunError> {
    let moved = execution.drift(0.0, state)?;
    let density = execution.density(0.0, &moved)?;
    let primitives = execution.wall_condition(&moved, &density)?;
    Ok((moved, primitives))
}
