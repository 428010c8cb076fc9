//! The method `standard`: moving particles with a summed or evolved density, and pair forces with a background
//! pressure, as in JAX-SPH; see [`crate::sph::laws`].

use crate::config::method::kind::{Facts, Given, Kind, Usual};
use crate::config::range::{Number, Range::Within};
use crate::config::section::section;
use crate::config::stability::{CflLimit, STANDARD};
use crate::error::BadInput;
use serde::{Deserialize, Serialize};

pub const FACTS: Facts = Facts {
    name: "standard",
    about: "particles that move with the flow, pair forces, density summation or continuity, a background pressure: as JAX-SPH",
    text: include_str!("../../../data/methods/standard.toml"),
    moves: true,
    counterpart: None,
    steady: false,
    divides_steps: true,
    wall_cells: true,
    wall_keys: true,
    holds_drive: false,
    shapes_both_walls: false,
    wall_heat: false,
    force_region: true,
    two_materials: true,
    negative_kernel: true,
    lines_up: true,
    against_crowds: "method.transport_velocity=1, or method.name=consistent",
    first_particle: 0.0,
    order: 1.0,
};

section! {
    #[derive(Copy)]
    "method.": Standard {
        background_pressure_factor: f64 = 0.05, Within(0.0, 1.0);
        transport_velocity: f64 = 0.0, Within(0.0, 1.0);
        artificial_viscosity: f64 = 0.0, Within(0.0, 10.0);
        artificial_viscosity_pairs: ViscousPairs = ViscousPairs::Approaching;
        density_equation: DensityEquation = DensityEquation::Summation;
        density_renormalisation: bool = false;
        flux: FluxName = FluxName::Pair;
        density_diffusion: f64 = 0.1, Within(0.0, 1.0);
        density_gradient: DensityGradient = DensityGradient::Renormalised;
        velocity_diffusion: f64 = 0.01, Within(0.0, 10.0);
        riemann_limiter: f64 = 3.0, Within(0.0, 1000.0);
        equation_of_state_exponent: f64 = 1.0, Within(1.0, 20.0);
    }
}

/// The pairs on which the artificial viscosity acts, see [`crate::sph::laws::artificial_viscosity`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ViscousPairs {
    /// Pairs that approach each other (Monaghan 1992).
    Approaching,
    /// All pairs of fluid particles, as in JAX-SPH.
    All,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityEquation {
    /// A sum over the neighbours.
    Summation,
    /// Continuity, which needs no neighbours beyond a free surface, see [`crate::sph::standard::evolution`].
    Evolution,
}

/// The form of the flux between two particles, see [`crate::sph::laws::Flux`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FluxName {
    /// Mean pressure and shear stress.
    Pair,
    /// Mean pressure and shear stress, with diffusion of density and velocity.
    Delta,
    /// From the Riemann problem between both particles.
    Riemann,
}

/// The gradients g_i and g_j in the diffusion of the density, see [`crate::sph::laws::density_diffusion`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DensityGradient {
    Renormalised,
    /// As in JAX-SPH, for comparison: g_j is replaced by -V_j sum_k (rho_k - rho_j) A_k^-1 grad_j W_jk, which has the
    /// neighbours' matrices and the opposite sign, and no determinant is too small.
    JaxSph,
}

impl Kind for Standard {
    fn facts(&self) -> &'static Facts {
        &FACTS
    }

    fn numbers(&self) -> Vec<Number> {
        Self::numbers(self)
    }

    fn check(&self, _rows: bool) -> Result<(), BadInput> {
        let (exponent, usual) = (self.equation_of_state_exponent, Self::default());
        if exponent.fract() != 0.0 {
            return Err(BadInput::at(
                "method.equation_of_state_exponent",
                format!("method.equation_of_state_exponent = {exponent} is no whole number"),
            )
            .allowed("1 ... 20, whole numbers")
            .advice("method.equation_of_state_exponent=7 for water"));
        }
        let pairs = self.artificial_viscosity_pairs != usual.artificial_viscosity_pairs;
        let wrong = [
            (
                self.density_renormalisation && self.density_equation != DensityEquation::Evolution,
                "method.density_renormalisation",
                "= true with a density that is summed",
                "method.density_equation=evolution",
            ),
            (
                self.flux != FluxName::Delta && self.density_gradient != usual.density_gradient,
                "method.density_gradient",
                "without diffusion of density",
                "method.flux=delta",
            ),
            (
                self.flux == FluxName::Riemann && self.transport_velocity != 0.0,
                "method.transport_velocity",
                "with Riemann problems, whose states have no such stress",
                "method.transport_velocity=0, or method.flux=pair",
            ),
            (
                self.artificial_viscosity == 0.0 && pairs,
                "method.artificial_viscosity_pairs",
                "without an artificial viscosity",
                "method.artificial_viscosity=0.1, or leave it out",
            ),
        ];
        match wrong.into_iter().find(|(is_wrong, ..)| *is_wrong) {
            None => Ok(()),
            Some((_, key, problem, advice)) => {
                Err(BadInput::at(key, format!("{key} {problem}")).allowed("its default there").advice(advice))
            }
        }
    }

    fn cfl_limit(&self, _jitter: f64) -> CflLimit {
        STANDARD
    }

    fn artificial_viscosity(&self) -> f64 {
        self.artificial_viscosity
    }

    fn usual(&self, has_design: bool) -> Vec<Usual> {
        let usual = |key: &'static str, value: f64| Usual { key, value, unless: Given::AtAll };
        let mut all = vec![usual("resolution.smoothing_length", 1.0)];
        if has_design {
            all.extend([usual("time.cfl", 2.0), usual("optimise.smoothing", 5.0)]);
        }
        all
    }
}
