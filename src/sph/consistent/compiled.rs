//! The sweeps of the consistent method, compiled in this crate for `f32` and `f64`.

use super::blocks::Blocks;
use super::geometry::Geometry;
use super::kept::Kept;
use super::sweeps::{sweeps, Sweeps};
use super::{advance, continuity, operators, wall_values};
use crate::particles::NeighbourList;
use crate::sph::precisions::implement;

sweeps!(implement);
