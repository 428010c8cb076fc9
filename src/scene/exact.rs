//! Exact solutions for verification flows.

use super::composite_slab::Series;
use super::developed::{parabola, Developed};
use crate::config::formula::Function;
use std::f64::consts::PI;
use std::sync::Arc;

/// The exact solution of the incompressible Navier-Stokes equations, and of the heat equation.
#[derive(Debug, Clone)]
pub enum Exact {
    /// The plane vortices of Taylor and Green (1937) in the unit box:
    /// u = -U exp(-8 pi^2 nu t) cos(2 pi x) sin(2 pi y), v = U exp(-8 pi^2 nu t) sin(2 pi x) cos(2 pi y).
    TaylorGreen {
        velocity: f64,
        kinematic_viscosity: f64,
    },
    /// Flow between plane walls at y = 0 and 1, started from rest by a constant force (Morris, Fox and Zhu 1997, eq. 19).
    /// `velocity` is that of the steady centre line, F/(8 nu).
    Poiseuille {
        velocity: f64,
        kinematic_viscosity: f64,
    },
    /// Two Poiseuille flows, at 0 < y < 1 and with the opposite sign at 1 < y < 2.
    ReversePoiseuille {
        velocity: f64,
        kinematic_viscosity: f64,
    },
    /// Flow between plane walls, started from rest by the upper one, which moves with `velocity` (their eq. 22).
    Couette {
        velocity: f64,
        kinematic_viscosity: f64,
    },
    /// A slab at rest that is heated.
    Slab(Arc<Series>),
    /// Developed flow between warm plane walls: its velocity and its rate of heat transfer.
    IsothermalChannel(Developed),
    /// The formulas that the configuration of a custom scene states.
    Stated(Arc<Stated>),
    Unknown,
}

/// An exact solution by formulas of the place and of the time.
#[derive(Debug, Clone)]
pub struct Stated {
    /// Components of the velocity; empty: unknown.
    pub velocity: Vec<Function>,
    /// Temperature, and the reference that states count it from.
    pub temperature: Option<(Function, f64)>,
    /// `fluid.reference_velocity`, which errors of the velocity are measured against.
    pub reference_velocity: f64,
}

/// Wave numbers pi n, and what is left of their modes after a time, exp(-(pi n)^2 nu t): those of which enough is left to count.
fn modes(n: impl Iterator<Item = u32>, diffused: f64) -> impl Iterator<Item = (f64, f64)> {
    let all = n.map(|n| PI * f64::from(n)).map(move |k| (k, (-k * k * diffused).exp()));
    all.take_while(|(_, left)| *left > 1e-17)
}

impl Exact {
    /// The velocity at a point, if it is known.
    pub fn velocity(&self, position: [f64; 3], time: f64) -> Option<[f64; 3]> {
        let [x, y, _] = position;
        match *self {
            Self::TaylorGreen { .. } => {
                let amplitude = self.amplitude(time)?;
                let ((sin_x, cos_x), (sin_y, cos_y)) = ((2.0 * PI * x).sin_cos(), (2.0 * PI * y).sin_cos());
                Some([-amplitude * cos_x * sin_y, amplitude * sin_x * cos_y, 0.0])
            }
            Self::Poiseuille { velocity, kinematic_viscosity } => {
                // In terms of the steady centre line U, u = 4 U y (1 - y) - sum over odd k of 32 U/(pi k)^3 ...
                let left = modes((1..200).step_by(2), kinematic_viscosity * time);
                let transient: f64 = left.map(|(k, decay)| 32.0 / (k * k * k) * (k * y).sin() * decay).sum();
                Some([velocity * (4.0 * y * (1.0 - y) - transient), 0.0, 0.0])
            }
            Self::ReversePoiseuille { velocity, kinematic_viscosity } => {
                let half = Self::Poiseuille { velocity, kinematic_viscosity };
                if y < 1.0 {
                    half.velocity(position, time)
                } else {
                    half.velocity([x, y - 1.0, position[2]], time).map(|u| u.map(|u| -u))
                }
            }
            Self::Couette { velocity, kinematic_viscosity } if time > 0.0 => {
                // (-1)^n sin(pi n y) is sin(pi n (y - 1)).
                let left = modes(1..200, kinematic_viscosity * time);
                let transient: f64 = left.map(|(k, decay)| 2.0 / k * (k * (y - 1.0)).sin() * decay).sum();
                Some([velocity * (y + transient), 0.0, 0.0])
            }
            // The series does not converge at the start.
            Self::Couette { .. } | Self::Slab(_) => Some([0.0; 3]),
            Self::IsothermalChannel(_) => Some([parabola(y), 0.0, 0.0]),
            Self::Stated(ref stated) => {
                let component = |d: usize| stated.velocity.get(d).map_or(0.0, |u| u.at_time(position, time));
                (!stated.velocity.is_empty()).then(|| std::array::from_fn(component))
            }
            Self::Unknown => None,
        }
    }

    /// The temperature at a point above the reference, if it is known.
    pub fn temperature(&self, position: [f64; 3], time: f64) -> Option<f64> {
        match self {
            Self::Slab(series) => Some(if time > 0.0 { series.temperature(position[1], time) } else { 0.0 }),
            Self::Stated(stated) => {
                stated.temperature.as_ref().map(|(of, reference)| of.at_time(position, time) - reference)
            }
            _ => None,
        }
    }

    /// The height of the profile, if the solution depends only on y.
    pub fn profile_height(&self) -> Option<f64> {
        match *self {
            Self::Poiseuille { .. } | Self::Couette { .. } | Self::Slab(_) | Self::IsothermalChannel(_) => Some(1.0),
            Self::ReversePoiseuille { .. } => Some(2.0),
            Self::TaylorGreen { .. } | Self::Stated(_) | Self::Unknown => None,
        }
    }

    /// The scale of velocity errors: the vortices' present amplitude, the channel's steady centre line (the flow starts
    /// from zero), the moving wall, or the reference velocity. None for scenes at rest.
    pub fn amplitude(&self, time: f64) -> Option<f64> {
        match *self {
            Self::TaylorGreen { velocity, kinematic_viscosity } => {
                Some(velocity * (-8.0 * PI * PI * kinematic_viscosity * time).exp())
            }
            Self::Poiseuille { velocity, .. }
            | Self::ReversePoiseuille { velocity, .. }
            | Self::Couette { velocity, .. } => Some(velocity),
            Self::IsothermalChannel(_) => Some(1.0),
            Self::Stated(ref stated) => Some(stated.reference_velocity),
            Self::Slab(_) | Self::Unknown => None,
        }
    }

    /// What the amplitude is, in words.
    pub fn amplitude_name(&self) -> &'static str {
        match self {
            Self::Couette { .. } => "the moving wall's velocity",
            Self::Poiseuille { .. } | Self::ReversePoiseuille { .. } | Self::IsothermalChannel(_) => {
                "the steady centre line"
            }
            Self::Stated(_) => "fluid.reference_velocity",
            Self::TaylorGreen { .. } | Self::Slab(_) | Self::Unknown => "the exact amplitude",
        }
    }
}
