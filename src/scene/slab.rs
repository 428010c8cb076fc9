//! Heat conduction in a slab at rest between two walls with different temperatures, of one material or of two with a
//! jump of conductivity half way (Cleary and Monaghan 1999, section 5).
//!
//! Width, density, and the lower half's conductivity and heat capacity are 1, so times are in width^2 over the lower
//! half's diffusivity. The slab lies across y as the channel of [`super::poiseuille`]. It starts with the upper wall's
//! temperature 0, while the lower wall has temperature 1.

use super::assembly::{count, Numerics, Parts};
use super::composite_slab::Series;
use super::lattice::{Lattice, WallHeat};
use super::surface::Settings;
use super::{Exact, Scene};
use crate::config::scene::{Config, ShiftName};
use crate::sph::flow::Materials;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::Sweeps;
use std::sync::Arc;

/// The slab and its resolution.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Slab {
    /// Particles across the slab.
    pub rows: usize,
    /// Particles along the slab.
    pub columns: usize,
    /// Ratios of the upper half's properties to those of the lower half.
    pub conductivity_ratio: f64,
    pub capacity_ratio: f64,
    pub numerics: Numerics,
}

impl Slab {
    /// The slab of a checked configuration.
    pub fn from_config(config: &Config) -> Self {
        // Without motion neither a shift nor dissipation is needed.
        let usual = Numerics::from_config(config);
        let numerics = Numerics {
            consistent: usual.consistent.map(|settings| Settings { shift: ShiftName::None, ..settings }),
            background_pressure_factor: 0.0,
            transport_velocity: 0.0,
            artificial_viscosity: 0.0,
            jitter: 0.0,
            ..usual
        };
        let (conductivity_ratio, capacity_ratio) = (config.heat.conductivity_ratio, config.heat.capacity_ratio);
        Self { rows: count(config, 1.0), columns: 8, conductivity_ratio, capacity_ratio, numerics }
    }

    pub fn build<R: Sweeps>(&self) -> Scene<R> {
        let lattice = Lattice::channel(self.columns, self.rows, self.numerics.wall_rows);
        let is_upper = |i: usize| 2 * lattice.rows(i)[1] >= lattice.cells[1];
        let of = |ratio: f64| (0..lattice.particles()).map(|i| R::of(if is_upper(i) { ratio } else { 1.0 })).collect();
        let materials = (self.conductivity_ratio != 1.0 || self.capacity_ratio != 1.0)
            .then(|| Materials { conductivity: of(self.conductivity_ratio), capacity: of(self.capacity_ratio) });
        let (walls, nowhere) = ([1.0, 0.0].map(WallHeat::isothermal), [f64::NEG_INFINITY, f64::INFINITY]);
        Parts {
            name: "slab",
            lattice,
            numerics: self.numerics,
            density: 1.0,
            velocity: 1.0,
            viscosity: 1.0,
            body_force: BodyForce::None,
            drive: None,
            lid: 0.0,
            own_mass: false,
            heat: None,
            heat_walls: None,
            exact: Exact::Slab(Arc::new(Series::new(self.conductivity_ratio, self.capacity_ratio))),
        }
        .warm(1.0, nowhere, walls, materials)
        .build(|_| [0.0; 3])
    }
}
