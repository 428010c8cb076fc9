//! Scenes: geometry, start states, wall shapes.
pub mod accuracy;
pub mod flow;
pub mod heated_channel;
pub mod lid_driven_cavity;
pub mod load;
pub mod poiseuille;
pub mod reverse_poiseuille;
pub mod taylor_green;
