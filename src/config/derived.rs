//! Quantities that follow from a configuration.

use crate::config::method::kind::PlaneChannel;
use crate::config::scene::{Config, DriveName, Family};
use crate::config::stability::{CflLimit, FREE_SURFACE};
use serde::Serialize;

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeStepLimits {
    pub acoustic: f64,
    /// Part of the acoustic limit: above it sound grows in the flow of a plane channel.
    pub growth: f64,
    pub diffusive: f64,
    /// Limit by the body force of a custom scene; infinite for others.
    pub force: f64,
}

/// A dimensionless number of a run, and the length and the speed that it takes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Dimensionless {
    pub name: &'static str,
    pub value: f64,
    pub length: Option<Scale>,
    pub speed: Option<Scale>,
}

/// A length or a speed of a run, and what it is of.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Scale {
    pub value: f64,
    pub of: &'static str,
}

/// dt <= 0.25 sqrt(dx / |g|) (Monaghan 1992, sec. 11; Morris, Fox and Zhu 1997, eq. 19).
const FORCE_NUMBER: f64 = 0.25;

impl Config {
    /// Speed of sound, c = sound_speed_factor * reference_velocity.
    pub fn sound_speed(&self) -> f64 {
        self.fluid.sound_speed_factor * self.fluid.reference_velocity
    }

    /// alpha = conductivity / (density * heat_capacity); for verification flows the largest one, in their own units.
    pub fn thermal_diffusivity(&self) -> f64 {
        match self.scene {
            // That of the lower half is 1.
            Family::Slab => (self.heat.conductivity_ratio / self.heat.capacity_ratio).max(1.0),
            Family::IsothermalChannel => 1.0 / (self.flow.reynolds * self.heat.prandtl),
            _ => self.fluid.conductivity / (self.fluid.density * self.fluid.heat_capacity),
        }
    }

    /// Kinematic viscosity nu = viscosity / density.
    pub fn kinematic_viscosity(&self) -> f64 {
        self.fluid.viscosity / self.fluid.density
    }

    /// The kinematic viscosity of the scene, which verification flows have from their Reynolds number.
    pub fn model_viscosity(&self) -> f64 {
        match self.scene {
            Family::HeatedChannel | Family::HeatedChannel3d | Family::Custom => self.kinematic_viscosity(),
            _ if self.scene.has_surface() => self.kinematic_viscosity(),
            // The slab is at rest; its model has this value.
            Family::Slab => 1.0,
            _ => 1.0 / self.flow.reynolds,
        }
    }

    pub fn has_heat(&self) -> bool {
        match self.scene {
            Family::Custom => self.initial.temperature.is_some(),
            scene => scene.has_design() || matches!(scene, Family::Slab | Family::IsothermalChannel),
        }
    }

    /// The acceleration g that drives the plane channel: the body force, or that which gives its flow rate or power.
    pub fn plane_force(&self) -> f64 {
        let (fluid, channel) = (&self.fluid, &self.channel);
        let stiff = 12.0 * self.kinematic_viscosity() / channel.height.powi(3);
        let given = match fluid.drive {
            DriveName::BodyForce => None,
            DriveName::FlowRate => fluid.flow_rate.map(|rate| stiff * rate),
            DriveName::PumpingPower => {
                fluid.pumping_power.map(|power| (stiff * power / (fluid.density * channel.length)).sqrt())
            }
        };
        given.unwrap_or(fluid.body_force)
    }

    /// The plane channel's flow rate, g H^3 / (12 nu) (plane Poiseuille flow), a volume per time and depth.
    pub fn plane_flow_rate(&self) -> f64 {
        self.plane_force() * self.channel.height.powi(3) / (12.0 * self.kinematic_viscosity())
    }

    /// The largest velocity of the plane channel, on its centre line.
    pub fn plane_speed(&self) -> f64 {
        1.5 * self.plane_flow_rate() / self.channel.height
    }

    fn plane_channel(&self) -> PlaneChannel {
        PlaneChannel {
            length: self.channel.length,
            height: self.channel.height,
            speed: self.plane_speed().abs(),
            sound_speed: self.sound_speed(),
            kinematic_viscosity: self.kinematic_viscosity(),
            spacing: self.resolution.dx,
        }
    }

    /// The power that drives the plane channel, density g length times the flow rate, per depth.
    pub fn plane_power(&self) -> f64 {
        self.fluid.density * self.plane_force() * self.channel.length * self.plane_flow_rate()
    }

    /// The length of the scene that dimensionless numbers take, and where it is from.
    pub fn characteristic_length(&self) -> Scale {
        let (value, of) = match self.scene {
            Family::HeatedChannel | Family::HeatedChannel3d => (self.channel.height, "channel.height"),
            Family::Custom => {
                let sides = (0..self.region.size.len()).map(|d| (self.region.periodic[d], self.region.size[d]));
                let narrowest = sides.min_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
                (narrowest.map_or(1.0, |(_, size)| size), "narrowest side of region.size between walls")
            }
            Family::HydrostaticTank => (self.tank.height, "tank.height"),
            scene if scene.has_surface() => (self.water.height, "water.height"),
            _ => (1.0, "height of the channel or side of the box"),
        };
        Scale { value, of }
    }

    /// The dimensionless numbers of a run whose fastest particle was as fast as `fastest`.
    pub fn dimensionless(&self, fastest: f64) -> Vec<Dimensionless> {
        let length = self.characteristic_length();
        let speed = Scale { value: self.fluid.reference_velocity, of: "fluid.reference_velocity" };
        let viscosity = self.model_viscosity();
        let moves = self.scene != Family::Slab;
        let by = |name, diffusivity: f64| Dimensionless {
            name,
            value: speed.value * length.value / diffusivity,
            length: Some(length),
            speed: Some(speed),
        };
        let mut all = Vec::new();
        if moves {
            all.push(by("Reynolds", viscosity));
        }
        if moves && self.has_heat() {
            all.push(by("Peclet", self.thermal_diffusivity()));
            let value = viscosity / self.thermal_diffusivity();
            all.push(Dimensionless { name: "Prandtl", value, length: None, speed: None });
        }
        // Fixed particles around shapes are incompressible.
        if moves && !self.is_around_shapes() {
            let value = fastest / self.sound_speed();
            all.push(Dimensionless {
                name: "Mach",
                value,
                length: None,
                speed: Some(Scale { value: fastest, of: "fastest particle" }),
            });
        }
        all
    }

    /// Whether fluid passes the section where flow and heat are measured: a channel, or a box that is periodic along x.
    pub fn flows_through(&self) -> bool {
        self.scene.has_design() || (self.scene == Family::Custom && self.region.periodic[0])
    }

    /// Whether heat from the walls leaves through that section, and nowhere else.
    pub fn heat_passes(&self) -> bool {
        self.scene.has_design() || (self.flows_through() && self.has_heat() && self.region.inlet_until.is_some())
    }

    /// Whether the flow should become steady. A scene that states its exact solution says what it does instead.
    pub fn settles(&self) -> bool {
        self.flows_through() && self.exact.velocity.is_empty() && self.exact.temperature.is_none()
    }

    pub fn has_design(&self) -> bool {
        self.scene.has_design() || !self.variables.is_empty()
    }

    pub fn dimension(&self) -> usize {
        match self.scene {
            Family::Custom => self.region.size.len(),
            scene if scene.name().ends_with("-3d") => 3,
            _ => 2,
        }
    }

    /// The smoothing length h, in units of length.
    pub fn smoothing_length(&self) -> f64 {
        self.resolution.smoothing_length * self.resolution.dx
    }

    /// The kernel's support radius in spacings.
    pub fn support(&self) -> f64 {
        self.resolution.kernel.support() * self.resolution.smoothing_length
    }

    pub fn cfl_limit(&self) -> CflLimit {
        match self.scene.has_surface() {
            true => FREE_SURFACE,
            false => self.method.cfl_limit(self.time.jitter),
        }
    }

    /// The smallest number of rows of dummy particles that fill the kernel's support; where walls are shaped, those
    /// that a particle next to the wall can reach.
    pub fn least_wall_rows(&self) -> usize {
        let first = if self.scene.has_design() { self.method.facts().first_particle } else { 0.0 };
        // Products such as 3 * 1.1 are rounded.
        (self.support() - first - 1e-9).ceil() as usize
    }

    /// The number of rows of dummy particles per wall in scenes without `channel.wall_rows`.
    pub fn wall_rows(&self) -> usize {
        self.least_wall_rows().max(3)
    }

    /// The kinematic viscosity of the artificial viscosity, alpha h c / (2 (d + 2)) (Monaghan 2005, eq. 8.8).
    pub fn artificial_kinematic_viscosity(&self) -> f64 {
        let alpha = self.method.artificial_viscosity();
        alpha * self.smoothing_length() * self.sound_speed() / (2.0 * (self.dimension() as f64 + 2.0))
    }

    /// The limits of the time step by sound and diffusion: cfl dx / (c + u_ref), and diffusion_number dx^2 / max(nu,
    /// alpha) times the method's factor, where nu includes the artificial viscosity. Verification flows have nu = 1 /
    /// Re, and most no heat. Under gravity g the first limit is at most cfl sqrt(dx / g) (Monaghan 1992, eq. 10.2).
    pub fn time_step_limits(&self) -> TimeStepLimits {
        let dx = self.resolution.dx;
        let viscous = self.model_viscosity() + self.artificial_kinematic_viscosity();
        let diffusivity = if self.has_heat() { viscous.max(self.thermal_diffusivity()) } else { viscous };
        let gravity = self.fluid.gravity.iter().map(|g| g * g).sum::<f64>().sqrt();
        let falling = match self.scene.has_surface() {
            true => self.time.cfl * (dx / gravity).sqrt(),
            false => f64::INFINITY,
        };
        let growth = match self.scene {
            Family::Custom => f64::INFINITY,
            _ => self.method.longest_step(&self.plane_channel()),
        };
        TimeStepLimits {
            acoustic: (self.time.cfl * dx / (self.sound_speed() + self.fluid.reference_velocity))
                .min(falling)
                .min(growth),
            growth,
            diffusive: self.method.diffusive_share() * self.time.diffusion_number * dx * dx / diffusivity,
            force: match self.scene {
                Family::Custom => FORCE_NUMBER * (dx / self.acceleration()).sqrt(),
                _ => f64::INFINITY,
            },
        }
    }

    /// The largest time step: the smallest of the limits.
    pub fn time_step_limit(&self) -> f64 {
        let limits = self.time_step_limits();
        limits.acoustic.min(limits.diffusive).min(limits.force)
    }

    /// The temperature without buoyancy, relative to that of the inlet.
    pub fn neutral_temperature(&self) -> f64 {
        self.fluid.reference_temperature.map_or(0.0, |neutral| neutral - self.fluid.inlet_temperature)
    }

    /// Magnitude of the body force per mass in a custom scene.
    pub fn acceleration(&self) -> f64 {
        self.region.acceleration.iter().map(|g| g * g).sum::<f64>().sqrt()
    }

    /// Whether particles are fixed over a wall that varies along x and z: a run is one step, to the steady flow.
    pub fn is_over_relief(&self) -> bool {
        self.scene == Family::HeatedChannel3d && !self.method.facts().moves
    }

    /// Number of steps: `time.steps`, or the smallest number that reaches `time.end` with the largest or the given
    /// step.
    pub fn steps(&self) -> usize {
        if self.is_over_relief() {
            return 1;
        }
        // The tolerance avoids an additional, tiny step for an exact multiple.
        let step = self.time.step.unwrap_or_else(|| self.time_step_limit());
        let needed = (self.time.end / step - 1e-9).ceil().max(1.0);
        self.time.steps.unwrap_or(needed as usize)
    }

    /// Time step: the given one; else the limit if the number of steps is given, or a smaller step with which the run
    /// ends at `time.end`.
    pub fn time_step(&self) -> f64 {
        if self.is_over_relief() {
            return self.time.end;
        }
        match (self.time.step, self.time.steps) {
            (Some(step), _) => step,
            (None, Some(_)) => self.time_step_limit(),
            (None, None) => self.time.end / self.steps() as f64,
        }
    }

    pub fn duration(&self) -> f64 {
        self.time_step() * self.steps() as f64
    }

    /// Number of particle columns along x.
    pub fn columns(&self) -> usize {
        (self.channel.length / self.resolution.dx).round() as usize
    }

    /// Number of rows of fluid particles.
    pub fn rows(&self) -> usize {
        (self.channel.height / self.resolution.dx).round() as usize
    }

    /// Number of layers of particles across the channel; one in two dimensions.
    pub fn layers(&self) -> usize {
        match self.dimension() {
            3 => (self.channel.span / self.resolution.dx).round() as usize,
            _ => 1,
        }
    }

    /// Depth of the simulated domain: the span, or 1 in two dimensions.
    pub fn depth(&self) -> f64 {
        match self.dimension() {
            3 if self.scene == Family::Custom => self.region.size[2],
            3 => self.channel.span,
            _ => 1.0,
        }
    }

    /// In three dimensions: distances between the design's control points along and across the channel. The support of
    /// the first begins, and that of the last ends, with the hot section; each is four distances wide.
    pub fn control_distances(&self) -> [f64; 2] {
        let (channel, design) = (&self.channel, &self.design);
        let along = (channel.hot_to - channel.hot_from) / (design.control_points as f64 + 3.0);
        [along, channel.span / design.control_points_across as f64]
    }
}
