//! The interface of a method's configuration.

use crate::config::range::Number;
use crate::config::stability::CflLimit;
use crate::error::BadInput;

/// Properties and capabilities of a method, for any values of its keys.
#[derive(Debug)]
pub struct Facts {
    pub name: &'static str,
    /// A description for the comment on `method.name`.
    pub about: &'static str,
    /// Its keys in TOML, each with its default and a comment.
    pub text: &'static str,
    /// Whether its particles move with the flow.
    pub moves: bool,
    /// The method with the same equations on fixed instead of moving particles, or the reverse.
    pub counterpart: Option<&'static str>,
    /// Whether it has the gradient of a steady state, `optimise.gradient = "steady"`.
    pub steady: bool,
    /// Whether its steps can be divided, `time.adaptive`.
    pub divides_steps: bool,
    /// Whether walls consist of cells of the particles' lattice; otherwise of points on their surface.
    pub wall_cells: bool,
    /// Whether it reads `wall.slip`, `wall.hot_isotherm` and `wall.mass`.
    pub wall_keys: bool,
    /// Whether it can hold a flow rate or a pumping power, `fluid.drive`.
    pub holds_drive: bool,
    /// Whether both walls of a channel can be shaped, `design.walls`.
    pub shapes_both_walls: bool,
    /// Whether the objective `wall-heat` can be differentiated.
    pub wall_heat: bool,
    /// Whether a body force can act in a part of the fluid, `fluid.body_force_region`.
    pub force_region: bool,
    /// Whether heat may flow between two materials.
    pub two_materials: bool,
    /// Whether the kernel may be negative in places, where there are no walls.
    pub negative_kernel: bool,
    /// Whether particles that start on an exact lattice line up.
    pub lines_up: bool,
    /// What to try where particles crowd.
    pub against_crowds: &'static str,
    /// Distance between a shaped wall and the nearest particle, in spacings, which shortens the kernel's reach behind
    /// it.
    pub first_particle: f64,
    /// The order at which figures converge with the spacing, as far as their errors count on it.
    pub order: f64,
}

impl Facts {
    /// The kind of its particles, for texts.
    pub fn particles(&self) -> &'static str {
        if self.moves {
            "moving"
        } else {
            "fixed"
        }
    }
}

/// A default of a method for a key outside of its section.
#[derive(Debug, Clone, PartialEq)]
pub struct Usual {
    pub key: &'static str,
    pub value: f64,
    pub unless: Given,
}

/// When a [`Usual`] value is not applied: if the key was given, or only if it was given another value than the scene's.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Given {
    AtAll,
    AnotherValue,
}

/// A flow between two flat walls, as far as sound in it goes.
#[derive(Debug, Clone, Copy)]
pub struct PlaneChannel {
    pub length: f64,
    pub height: f64,
    /// The largest speed of the flow.
    pub speed: f64,
    pub sound_speed: f64,
    pub kinematic_viscosity: f64,
    pub spacing: f64,
}

/// A method with the values of its keys.
pub trait Kind {
    fn facts(&self) -> &'static Facts;

    fn numbers(&self) -> Vec<Number>;

    /// Checks that its keys are consistent. `rows`: whether particles are in rows along a channel, or fixed.
    fn check(&self, _rows: bool) -> Result<(), BadInput> {
        Ok(())
    }

    /// The largest stable CFL numbers for an initial jitter.
    fn cfl_limit(&self, jitter: f64) -> CflLimit;

    /// The longest time step in which sound does not grow in a plane channel; infinite if `time.cfl` limits it alone.
    fn longest_step(&self, _channel: &PlaneChannel) -> f64 {
        f64::INFINITY
    }

    /// Factor of its diffusive time step relative to that of symplectic Euler.
    fn diffusive_share(&self) -> f64 {
        1.0
    }

    /// alpha of Monaghan's artificial viscosity; 0 without one.
    fn artificial_viscosity(&self) -> f64 {
        0.0
    }

    /// Defaults for keys of other sections, in a scene with a design (the heated channels) or without one.
    fn usual(&self, _has_design: bool) -> Vec<Usual> {
        vec![]
    }
}
