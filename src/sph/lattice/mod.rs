//! Fixed particles on the lattice of a box that is periodic in all directions: incompressible flow in time, in two and
//! three dimensions, with its exact derivative.
//!
//! ```text
//!   field --transform--> spectra --march (Runge-Kutta, viscosity exactly)--> spectra --transform--> field
//!                           ^            | rates: u x vorticity, projected
//!   gradient <------------- adjoint <----+
//! ```
//!
//! Every particle has the same neighbours at the same distances, so that derivatives are convolutions, which Fourier's
//! transform turns into factors ([`symbols`]): those of the fits, or the exact ones. So the pressure is solved for
//! exactly, and the velocity is free of divergence, in the same derivatives, to rounding.
pub mod adjoint;
pub mod equations;
pub mod march;
pub mod symbols;
pub mod transform;
