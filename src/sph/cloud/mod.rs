//! Fixed particles around any shape: the steady state of an incompressible flow in two dimensions with its exact
//! derivative by the numbers of the shapes, and flows in time ([`unsteady`], and with sound [`sound`]).
//!
//! ```text
//!   numbers -- outline --> points on walls -- deformation --> positions -- fit --> derivatives -- equations --> residual
//!      ^                                                                                                         | Newton
//!   gradient <------------------------------ the same backwards <-- multipliers <-- transposed solve <-- figure <-+
//! ```
//!
//! Particles stay; the weights of their fits are computed once per cloud, so every figure is a smooth function of the
//! numbers ([`particles`]).
pub mod composed;
pub mod conditions;
pub mod contour;
pub mod corner_fit;
pub mod deferred_correction;
pub mod deformation;
pub mod equations;
pub mod figures;
pub mod fit;
pub mod fit_adjoint;
pub mod fits;
pub mod interpolation;
pub mod march;
pub mod nearest;
pub mod outline;
pub mod particles;
pub mod placing;
pub mod problem;
pub mod sliding;
pub mod smoothing;
pub mod sound;
pub mod sound_adjoint;
pub mod space;
pub mod steady;
pub mod traction;
pub mod unsteady;
pub mod unsteady_adjoint;
pub mod wall_fit;
pub mod weighted_residual;
