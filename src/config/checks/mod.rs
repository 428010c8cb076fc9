//! Checks of the consistency of a scene's sections, by family. Each section is checked alone in its own file.

pub mod channel;
mod custom;
mod flows;
mod steps;
mod tank;

use crate::config::builtin::SCENES;
use crate::config::custom::{ShapeEntry, VariableEntry};
use crate::config::formula::Formula;
use crate::config::method::kind::Facts;
use crate::config::method::Method;
use crate::config::range::{Number, Range};
use crate::config::scene::{
    BodyForceRegion, Config, DesignWalls, DriveName, Family, GradientMode, HotIsotherm, KernelName, MassConvention,
    ObjectiveKind, SlipName,
};
use crate::config::schema::{Alternative, Schema};
use crate::error::BadInput;

impl Schema for Config {
    const ALTERNATIVES: &'static [Alternative] = &[
        (&["time.end"], &["time.steps"]),
        (&["design.shape"], &["design.offsets", "design.file"]),
        (&["design.offsets"], &["design.file"]),
        (&["design.file"], &["design.offsets", "design.nodes"]),
    ];
    const FORM: &'static str = "section.key=value, for example time.end=1.5";
    const HELP: &'static str = "`hydrograd scenes heated-channel` prints every key with its meaning";

    fn texts() -> Vec<&'static str> {
        SCENES.iter().map(|scene| scene.text()).collect()
    }

    fn complete() -> Vec<Self> {
        let mut config = Self::default();
        config.time.steps = Some(1);
        config.time.step = Some(1.0);
        config.shapes = vec![ShapeEntry::complete()];
        config.variables = vec![VariableEntry::default()];
        (config.region.inlet_until, config.region.outlet_from) = (Some(0.0), Some(1.0));
        config.initial.temperature = Some(Formula("1 + x".into()));
        config.exact.temperature = Some(Formula("1 + x".into()));
        (config.fluid.flow_rate, config.fluid.pumping_power) = (Some(1.0), Some(1.0));
        config.design.nodes = Some(vec![]);
        config.design.offsets = Some(vec![]);
        config.design.top_offsets = Some(vec![]);
        config.design.file = Some(String::new());
        config.surrogate.model = Some(String::new());
        let with = |name| Self { method: Method::named(name).unwrap_or_default(), ..config.clone() };
        Method::names().into_iter().map(with).collect()
    }

    fn numbers(&self) -> Vec<Number> {
        let mut all = [
            self.region.numbers(),
            self.resolution.numbers(),
            self.channel.numbers(),
            self.flow.numbers(),
            self.heat.numbers(),
            self.tank.numbers(),
            self.water.numbers(),
            self.fluid.numbers(),
            self.method.numbers(),
            self.wall.numbers(),
            self.time.numbers(),
            self.objective.numbers(),
            self.design.numbers(),
            self.optimise.numbers(),
            self.surrogate.numbers(),
            self.run.numbers(),
            self.output.numbers(),
        ]
        .concat();
        // Other scenes lack this key and choose the number themselves.
        let rows = all.iter_mut().find(|(key, ..)| *key == "channel.wall_rows").filter(|_| self.scene.has_design());
        if let Some((_, _, range)) = rows {
            *range = Range::Within(self.least_wall_rows() as f64, 100.0);
        }
        all
    }

    fn usual(&self) -> (Self, &'static str) {
        (self.scene.defaults_with(self.method.name()), "the built-in scene's")
    }

    fn origin(&self) -> String {
        format!("default of scene {}", self.scene.name())
    }

    fn check_together(&self) -> Result<(), BadInput> {
        self.check_method()?;
        match self.scene {
            Family::Custom => {
                self.check_custom()?;
                self.check_flow()?;
                self.check_steps()?;
                self.check_variables()
            }
            scene if scene.has_design() => {
                self.check_spacing()?;
                self.check_channel()?;
                self.check_steps()?;
                self.check_window()?;
                self.check_bound()?;
                self.check_drive()?;
                self.check_walls()?;
                self.check_speed()?;
                self.surrogate.check(self.optimise.dynamics)?;
                self.optimise.check(self.run.precision)
            }
            scene => {
                match scene.has_surface() {
                    true => self.check_tank()?,
                    false => self.check_box()?,
                }
                self.check_flow()?;
                self.check_warm_walls()?;
                self.check_steps()
            }
        }
    }
}

/// A key, whether it needs a capability, its value, the values that need none, and the capability.
type Demand = (&'static str, bool, String, &'static str, fn(&Facts) -> bool);

impl Config {
    /// Number of fluid rows needed between the walls: one support radius from each, so that no particle reaches both.
    pub(super) fn fluid_rows(&self) -> f64 {
        2.0 * self.support()
    }

    /// Whether the scene has no walls.
    fn is_periodic(&self) -> bool {
        match self.scene {
            Family::Custom => !self.has_walls(),
            _ => matches!(
                self.scene,
                Family::TaylorGreen | Family::TaylorGreen3d | Family::ReversePoiseuille | Family::ReversePoiseuille3d
            ),
        }
    }

    /// Capabilities of the method that other sections need.
    fn demands(&self) -> Vec<Demand> {
        let (fluid, wall, heat, custom) = (&self.fluid, &self.wall, &self.heat, self.scene == Family::Custom);
        let drive = if fluid.drive == DriveName::FlowRate { "flow-rate" } else { "pumping-power" };
        let negative = self.resolution.kernel == KernelName::SuperGaussian;
        vec![
            (
                "resolution.kernel",
                negative,
                "super-gaussian".into(),
                "gaussian, any other with positive weights",
                |can| can.negative_kernel,
            ),
            (
                "heat.conductivity_ratio",
                heat.conductivity_ratio != 1.0,
                heat.conductivity_ratio.to_string(),
                "1",
                |can| can.two_materials,
            ),
            ("heat.capacity_ratio", heat.capacity_ratio != 1.0, heat.capacity_ratio.to_string(), "1", |can| {
                can.two_materials
            }),
            ("fluid.drive", fluid.drive != DriveName::BodyForce, drive.into(), "body-force", |can| can.holds_drive),
            (
                "fluid.body_force_region",
                fluid.body_force_region == BodyForceRegion::OriginalChannel,
                "original-channel".into(),
                "fluid",
                |can| can.force_region,
            ),
            ("wall.slip", wall.slip == SlipName::FreeSlip, "free-slip".into(), "no-slip", |can| can.wall_keys),
            ("wall.mass", wall.mass == MassConvention::Constant, "constant".into(), "column-area", |can| can.wall_keys),
            (
                "wall.hot_isotherm",
                wall.hot_isotherm == HotIsotherm::Dummy && !custom,
                "dummy".into(),
                "surface",
                |can| can.wall_keys,
            ),
            ("time.adaptive", self.time.adaptive, "true".into(), "false", |can| can.divides_steps),
            (
                "objective.kind",
                self.objective.kind == ObjectiveKind::WallHeat && !custom,
                "wall-heat".into(),
                "heat-outflow, outlet-temperature, flow-rate",
                |can| can.wall_heat,
            ),
            ("design.walls", self.design.walls == DesignWalls::Both, "both".into(), "bottom", |can| {
                can.shapes_both_walls
            }),
            (
                "optimise.gradient",
                self.optimise.gradient == GradientMode::Steady,
                "steady".into(),
                if custom { "differences, segments, taped, truncated" } else { "segments, taped, truncated" },
                |can| can.steady,
            ),
        ]
    }

    /// Checks that the method can solve the scene, has consistent keys, and has the needed capabilities.
    fn check_method(&self) -> Result<(), BadInput> {
        let (name, methods) = (self.method.name(), self.scene.built_in().methods());
        if !methods.contains(&name) {
            return Err(BadInput::new(format!("method.name = {name} can not solve scene {}", self.scene.name()))
                .key("method.name")
                .allowed(methods.join(", ")));
        }
        self.method.check(matches!(self.scene, Family::HeatedChannel | Family::Slab))?;
        if self.resolution.kernel == KernelName::SuperGaussian && !self.is_periodic() {
            let problem =
                "resolution.kernel = super-gaussian with walls: it is negative in its outer part, and averages beside \
                           walls need positive weights";
            return Err(BadInput::new(problem)
                .key("resolution.kernel")
                .allowed("another kernel; super-gaussian with method.name = standard in a scene without walls")
                .advice("resolution.kernel=gaussian"));
        }
        for (key, asked, what, instead, can) in self.demands() {
            if !asked || can(self.method.facts()) {
                continue;
            }
            let able: Vec<&str> = Method::that(can).into_iter().filter(|name| methods.contains(name)).collect();
            let first = instead.split(',').next().unwrap_or_default();
            let bad = BadInput::new(format!("{key} = {what} with method.name = {name}")).key(key);
            return Err(match able.first() {
                None => bad.allowed(instead).advice(format!("{key}={first}")),
                Some(one) => bad
                    .allowed(format!("{instead}; {what} with method.name = {}", able.join(" or ")))
                    .advice(format!("method.name={one}, or {key}={first}")),
            });
        }
        if self.scene.has_design() && self.optimise.gradient == GradientMode::Differences {
            return Err(BadInput::new("optimise.gradient = differences for a wall of many variables")
                .key("optimise.gradient")
                .allowed("segments, taped, truncated or steady; differences for `variables` of a scene of your own"));
        }
        Ok(())
    }
}
