//! The method `consistent`: moving particles, second-order operators and an evolved pressure, see
//! [`crate::sph::consistent`].

use crate::config::method::kind::{Facts, Kind};
use crate::config::range::{Number, Range::Within};
use crate::config::section::section;
use crate::config::stability::{CflLimit, SYMPLECTIC_EULER, VERLET, VERLET_FROM_NOISE};
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

pub const FACTS: Facts = Facts {
    name: "consistent",
    about: "particles that move with the flow, second-order operators, an evolved pressure: right over curved walls",
    text: include_str!("../../../data/methods/consistent.toml"),
    moves: true,
    counterpart: Some("fixed"),
    steady: false,
    divides_steps: true,
    wall_cells: false,
    wall_keys: false,
    holds_drive: true,
    shapes_both_walls: true,
    wall_heat: true,
    force_region: true,
    two_materials: false,
    negative_kernel: false,
    lines_up: false,
    against_crowds: "method.shift_strength=3",
    first_particle: 0.5,
    order: 2.0,
};

section! {
    #[derive(Copy)]
    "method.": Consistent {
        shift: ShiftName = ShiftName::Chain;
        shift_strength: f64 = 2.0, Within(0.0, 10.0);
        pressure_diffusion: f64 = 0.1, Within(0.0, 1.0);
        integrator: IntegratorName = IntegratorName::SymplecticEuler;
    }
}

/// How particles are kept evenly spread: see [`crate::sph::consistent::shift`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ShiftName {
    /// Along rows that stay in order, for channels.
    Chain,
    /// Along rows that stay in place while the flow passes through them, for channels.
    Rows,
    /// Away from crowded regions, for any scene.
    Isotropic,
    None,
}

/// The time integrator, see [`crate::sph::consistent::advance`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum IntegratorName {
    /// Symplectic Euler: first order in time; velocity and pressure use each other's newest value.
    SymplecticEuler,
    /// Velocity Verlet: second order, also with one evaluation per step.
    Verlet,
}

impl Kind for Consistent {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn numbers(&self) -> Vec<Number> {
        Self::numbers(self)
    }

    fn check(&self, rows: bool) -> Result<(), BadInput> {
        if !rows && matches!(self.shift, ShiftName::Chain | ShiftName::Rows) {
            return Err(BadInput::at(
                "method.shift",
                "method.shift = chain or rows without rows of particles that stay rows",
            )
            .allowed("isotropic or none, or scene heated-channel")
            .advice("method.shift=isotropic"));
        }
        Ok(())
    }

    fn cfl_limit(&self, jitter: f64) -> CflLimit {
        match self.integrator {
            IntegratorName::Verlet if jitter > 0.1 => VERLET_FROM_NOISE,
            IntegratorName::Verlet => VERLET,
            IntegratorName::SymplecticEuler => SYMPLECTIC_EULER,
        }
    }

    /// The explicit rates of Verlet are those of Adams and Bashforth, which are stable for half of Euler's step.
    fn diffusive_share(&self) -> f64 {
        if self.integrator == IntegratorName::Verlet {
            0.5
        } else {
            1.0
        }
    }
}
