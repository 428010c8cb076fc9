//! Fixed particles around shapes in three dimensions: the steady flow and that in time, figures and their exact derivatives.
//!
//! The same method as in the plane ([`super`]), with [two fits](fits) of each particle to more neighbours. Its systems are too large for direct
//! factors; they are solved by GMRES with a block preconditioner ([`linear`]).
pub mod control_surface;
pub mod coupled;
pub mod equations;
pub mod facets;
pub mod figures;
pub mod fits;
pub mod linear;
pub mod march;
pub mod particles;
pub mod placing;
pub mod problem;
pub mod scalar;
pub mod steady;
pub mod surface;
