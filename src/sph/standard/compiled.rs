//! The sweeps of the standard method, compiled in this crate for `f32` and `f64`.

use super::chain::Step;
use super::model::Standard;
use super::pair_cache::PairCache;
use super::sweeps::{sweeps, Sweeps};
use super::{assemble, density, drift, evolution, rates, wall_condition};
use crate::sph::precisions::implement;

sweeps!(implement);
