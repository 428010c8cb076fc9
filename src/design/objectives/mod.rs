//! Objectives of designs, which are maximised: the mean of a quantity of the flow over some states of a run. They use
//! fields and do not depend on the solver.
//!
//! A new objective is a [`Quantity`], with a line in [`of_config`] and in [`Figure::of_config`].

pub mod outlet;

pub use outlet::Outlet;

use crate::adjoint::{Fields, Objective};
use crate::config::scene::{Config, ObjectiveForm, ObjectiveKind};
use candle_core::{Result, Tensor};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// The sampled states of a run: the weight of the state after each of these steps.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Samples(pub BTreeMap<usize, f64>);

impl Samples {
    /// `count` evenly spaced samples among the last `window` steps of `steps`, the last step among them, equally weighted.
    pub fn window(steps: usize, window: usize, count: usize) -> Self {
        let count = count.min(window.max(1)).max(1);
        let chosen: BTreeSet<usize> = (0..count).map(|k| steps - k * window / count).filter(|&s| s > 0).collect();
        let weight = 1.0 / chosen.len().max(1) as f64;
        Self(chosen.into_iter().map(|s| (s, weight)).collect())
    }
}

/// What an objective averages.
#[derive(Debug, Clone)]
pub enum Quantity {
    /// The outflowing heat.
    ///
    /// Q = sum over the targets of rho u_x (T - T_in) (eq. 12 of the original report), times the spacing of the
    /// targets, which makes it the flux integral over the outlet section in units of rho u T, comparable between
    /// resolutions. It is taken at the last step, or averaged over evenly spaced steps of a window at the end of the
    /// run. `scale` is the factor on the sum: the spacing for the flux form, 1 for the report's sum.
    HeatOutflow { outlet: Outlet, scale: f64 },
    /// The mixed temperature of the outflow relative to the inlet, in units of temperature:
    ///
    /// T_mix - T_in = sum over the targets of rho u_x (T - T_in) / sum over the targets of rho u_x,
    ///
    /// which is the outflowing heat per mass (times the heat capacity: enthalpy). A wall that lets less fluid through,
    /// but heats it more, is good by this objective and bad by [`Self::HeatOutflow`].
    OutletTemperature { outlet: Outlet },
    /// The heat per time that the walls give to the fluid, see [`crate::sph::solver::Solver::wall_heat_flux`]: the heat
    /// that conduction brings to the particles upstream of the targets, in units of density * temperature * area per
    /// time. `depth` is that of the simulated domain, because heat is per depth.
    ///
    /// In a steady flow it equals the outflowing heat, [`Self::HeatOutflow`], up to the error of the heat balance;
    /// otherwise it includes stored heat. (A fit of the temperature's slope at the wall itself is no suitable
    /// objective: it misses 5 to 8 % at the ends of the hot section, and an optimiser finds walls that exploit the
    /// fit.)
    WallHeat { depth: f64 },
    /// The volume that flows through the targets per time (and depth). In a driven flow it is larger if the walls
    /// resist less.
    FlowRate { outlet: Outlet },
}

/// The mean of a quantity over the samples.
#[derive(Debug, Clone)]
pub struct Mean {
    pub of: Quantity,
    pub samples: Samples,
}

impl Objective for Mean {
    fn weight(&self, step: usize) -> Option<f64> {
        self.samples.0.get(&step).copied()
    }

    fn value(&self, fields: &Fields) -> Result<Tensor> {
        match &self.of {
            Quantity::HeatOutflow { outlet, scale } => outlet.flows(fields)?.heat.affine(*scale, 0.0),
            Quantity::OutletTemperature { outlet } => {
                let flows = outlet.flows(fields)?;
                flows.heat.div(&flows.mass)
            }
            Quantity::WallHeat { depth } => match &fields.wall_heat {
                Some(heat) => heat.affine(1.0 / depth, 0.0),
                None => candle_core::bail!("fields without the walls' heat"),
            },
            Quantity::FlowRate { outlet } => outlet.flows(fields)?.volume.affine(outlet.spacing, 0.0),
        }
    }
}

/// The objective of a configuration.
pub fn of_config(config: &Config, outlet: Outlet, samples: Samples) -> Arc<dyn Objective + Send> {
    let of = match config.objective.kind {
        ObjectiveKind::HeatOutflow => {
            let scale = match config.objective.form {
                ObjectiveForm::Flux => outlet.spacing,
                ObjectiveForm::Sum => 1.0,
            };
            Quantity::HeatOutflow { outlet, scale }
        }
        ObjectiveKind::OutletTemperature => Quantity::OutletTemperature { outlet },
        ObjectiveKind::WallHeat => Quantity::WallHeat { depth: config.depth() },
        // The others are of fixed particles around shapes, which have no steps: see [`crate::scene::around_shapes`].
        _ => Quantity::FlowRate { outlet },
    };
    Arc::new(Mean { of, samples })
}

/// How the values of an objective are reported.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Figure {
    /// The name in tables.
    pub name: &'static str,
    pub symbol: &'static str,
    pub quantity: &'static str,
    pub unit: &'static str,
    /// The measurement that is the same number, if one is (see [`crate::design::diagnostics::Diagnostics`]).
    pub measured_as: Option<&'static str>,
    /// The reported figure over the value.
    pub factor: f64,
}

impl Figure {
    /// The name of a configuration's objective in files.
    pub fn key_of(config: &Config) -> String {
        match config.objective.terms.is_empty() {
            true => Self::of_config(config).symbol.to_lowercase(),
            false => "objective".into(),
        }
    }

    /// The figure of a configuration's objective.
    pub fn of_config(config: &Config) -> Self {
        let (name, symbol, quantity, unit) = match config.objective.kind {
            ObjectiveKind::HeatOutflow => ("heat outflow", "Q", "outflowing heat", "rho u T length"),
            ObjectiveKind::WallHeat => ("wall heat", "W", "heat from the walls", "rho u T length"),
            ObjectiveKind::FlowRate => ("flow rate", "V", "flow rate", "u length"),
            ObjectiveKind::Drag => ("drag", "drag", "force along x", "rho u^2 length"),
            ObjectiveKind::Lift => ("lift", "lift", "force along y", "rho u^2 length"),
            ObjectiveKind::LiftOverDrag => ("lift over drag", "lift_over_drag", "lift over drag", "1"),
            ObjectiveKind::Torque => ("torque", "torque", "torque", "rho u^2 length^2"),
            ObjectiveKind::ShapeHeat => ("heat of shapes", "shape_heat", "heat that leaves shapes", "power / length"),
            ObjectiveKind::PressureDrop => ("pressure drop", "pressure_drop", "pressure drop", "rho u^2"),
            ObjectiveKind::Dissipation => ("dissipation", "dissipation", "dissipated power", "power / length"),
            ObjectiveKind::Pressure => ("pressure", "pressure", "pressure at the probe", "rho u^2"),
            ObjectiveKind::Temperature => ("temperature", "temperature", "temperature at the probe", "scene units"),
            ObjectiveKind::VelocityX => ("velocity", "velocity_x", "velocity along x at the probe", "u"),
            ObjectiveKind::VelocityY => ("velocity", "velocity_y", "velocity along y at the probe", "u"),
            ObjectiveKind::VelocityZ => ("velocity", "velocity_z", "velocity along z at the probe", "u"),
            ObjectiveKind::Area => ("area", "area", "area of shapes", "length^2"),
            ObjectiveKind::Volume => ("volume", "volume", "volume of shapes", "length^3"),
            ObjectiveKind::Distance => ("distance", "distance", "smallest distance", "length"),
            ObjectiveKind::OutletTemperature => {
                ("outlet temperature", "T", "mixed outlet temperature above the inlet's", "scene units")
            }
        };
        let measured_as = match config.objective.kind {
            ObjectiveKind::HeatOutflow => Some("q"),
            ObjectiveKind::WallHeat => Some("wall_heat_flux"),
            ObjectiveKind::FlowRate => Some("flow_rate"),
            // The outlet temperature that is measured is absolute; the rest belongs to shapes.
            _ => None,
        };
        // The figure is in flux form, whatever the loss uses.
        let factor = match (config.objective.kind, config.objective.form) {
            (ObjectiveKind::HeatOutflow, ObjectiveForm::Sum) => config.resolution.dx,
            _ => 1.0,
        };
        Self { name, symbol, quantity, unit, measured_as, factor }
    }
}
