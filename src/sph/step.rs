//! One time step, written once: which operator follows which.
//!
//! ```text
//! state --drift--> moved --density--> rho --wall condition--> primitives --rates--> rates
//!                    |                                          |                     |
//!                    +--------------------------- assemble ----+---------------------+--> state
//! ```
//!
//! The order is JAX-SPH's, so that states can be compared to rounding. [`super::solver`] has three ways to carry it out: on
//! reused buffers, as fused operators on candle's graph, and composed from candle's own operators.

use crate::adjoint::RunError;

/// A way to carry out the operators of a step.
pub trait Execution {
    /// The rows of all particles that an operator takes or gives.
    type Field;

    /// state `[F, N]` -> moved `[M, N]`, over a time dt; see [`super::operators::drift`].
    fn drift(&mut self, dt: f64, state: &Self::Field) -> Result<Self::Field, RunError>;
    /// Makes sure that the neighbour list holds for the moved state.
    fn neighbours(&mut self, moved: &Self::Field) -> Result<(), RunError>;
    /// moved -> density `[1, N]`, summed ([`super::operators::density`]; 0 for walls) or evolved over a time dt
    /// ([`super::operators::evolution`]).
    fn density(&mut self, dt: f64, moved: &Self::Field) -> Result<Self::Field, RunError>;
    /// moved, density -> primitives `[C, N]`, walls included; see [`super::operators::wall_condition`].
    fn wall_condition(&mut self, moved: &Self::Field, density: &Self::Field) -> Result<Self::Field, RunError>;
    /// moved, primitives -> rates `[A, N]`; see [`super::operators::rates`].
    fn rates(&mut self, moved: &Self::Field, primitives: &Self::Field) -> Result<Self::Field, RunError>;
    /// moved, primitives (an evolved density), rates -> state `[F, N]`; see [`super::operators::assemble`].
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

/// Moved state and primitives of a state as it is, with the present list.
///
/// # Errors
/// Tensor errors.
pub fn look<E: Execution>(execution: &mut E, state: &E::Field) -> Result<(E::Field, E::Field), RunError> {
    let moved = execution.drift(0.0, state)?;
    let density = execution.density(0.0, &moved)?;
    let primitives = execution.wall_condition(&moved, &density)?;
    Ok((moved, primitives))
}
