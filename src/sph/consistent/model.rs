//! The consistent method: a flow and the settings of its fits.

use super::arrangement::Shift;
use super::kept::Kept;
use super::kinds::TEMPERATURE;
use super::layout::Layout;
use crate::numerics::lanes::Real;
use crate::numerics::pool::Pool;
use crate::sph::flow::{picked, Flow};
use std::collections::HashMap;
use std::ops::Deref;

/// The settings of a scene besides the flow.
#[derive(Debug, Clone)]
pub struct Fits<R> {
    /// Particle spacing dx, the unit of length of the fits.
    pub spacing: f64,
    pub sound_speed: f64,
    /// Reference velocity U.
    pub velocity: f64,
    /// Kinematic viscosity.
    pub viscosity: f64,
    /// Thermal diffusivity.
    pub diffusivity: f64,
    /// Strength of the pressure diffusion.
    pub delta: f64,
    pub shift: Shift,
    /// Weights of a particle in the fits of velocity, pressure and temperature, and of its no-flux condition, `[N, 4]`.
    /// Fluid particles have a weight in all fits, dummy particles in that of the pressure. Some points on the wall's
    /// surface carry the wall's velocity, some its temperature, and some the no-flux condition along its normal.
    pub weights: Vec<R>,
    /// Indices of the points on the wall's surface whose fits determine the values of dummy particles.
    pub surface: Vec<u32>,
    /// Index of each dummy particle, and the place in `surface` of the point that determines its values.
    pub dummies: Vec<(u32, u32)>,
    /// Weight of a fluid particle in sums over a section, `[N]`: 11/12 beside a wall, where the midpoint rule
    /// overestimates fields that are zero on the wall, else 1.
    pub quadrature: Vec<R>,
}

impl<R: Real> Fits<R> {
    /// Those of some particles, which are counted anew in this order. Dummy particles whose point of the surface is missing have no value.
    pub fn of(&self, some: &[u32]) -> Self {
        let new: HashMap<u32, u32> = some.iter().zip(0..).map(|(&i, k)| (i, k)).collect();
        let known = |i: &u32| new.get(i).copied();
        let points = || self.surface.iter().zip(0..).filter_map(|(i, place)| Some((known(i)?, place)));
        // New place of each point by its old one.
        let places: HashMap<u32, u32> = points().zip(0..).map(|((_, old), new)| (old, new)).collect();
        let dummy = |(dummy, at): &(u32, u32)| Some((known(dummy)?, *places.get(at)?));
        Self {
            shift: self.shift.of(some.len(), &known),
            weights: some.iter().flat_map(|&i| &self.weights[4 * i as usize..][..4]).copied().collect(),
            surface: points().map(|(i, _)| i).collect(),
            dummies: self.dummies.iter().filter_map(dummy).collect(),
            quadrature: picked(&self.quadrature, some),
            ..*self
        }
    }
}

/// Second-order operators by moving least squares and an evolved pressure, on moving particles; see [`super`].
#[derive(Debug, Clone)]
pub struct Consistent<R> {
    pub flow: Flow<R>,
    pub layout: Layout,
    pub fits: Fits<R>,
    /// A pool of the results that the operators of a step share.
    pub(super) kept: Pool<Kept<R>>,
}

impl<R: Real> Consistent<R> {
    /// The flow with these fits. `layout` chooses the fields; `flow.rows` is replaced by the rows of its state.
    pub fn new(flow: Flow<R>, layout: Layout, fits: Fits<R>) -> Self {
        Self { flow: Flow { rows: layout.rows(), ..flow }, layout, fits, kept: Pool::default() }
    }

    /// Whether particle i of a wall is not a point with a known temperature.
    pub fn holds_no_temperature(&self, i: usize) -> bool {
        self.fits.weights[4 * i + TEMPERATURE] == R::default()
    }
    /// Whether the velocity rows of particle i of a wall hold something else than a velocity.
    pub fn holds_no_velocity(&self, i: usize) -> bool {
        self.fits.weights[4 * i] == R::default()
    }
}

impl<R> Deref for Consistent<R> {
    type Target = Flow<R>;

    fn deref(&self) -> &Flow<R> {
        &self.flow
    }
}
