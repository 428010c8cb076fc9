//! Checks of the consistency of a scene's sections, by family. Each section is checked alone in its own file.

pub mod channel;
mod custom;
mod flows;
mod steps;
mod tank;

use crate::config::builtin::SCENES;
use crate::config::custom::{ShapeEntry, Side, Sides, VariableEntry};
use crate::config::formula::Formula;
use crate::config::method::fixed::PressureKind;
use crate::config::method::kind::Facts;
use crate::config::method::Method;
use crate::config::range::{Number, Range};
use crate::config::scene::{Config, Family, Goal, GradientMode, KernelName, LimitEntry, Term};
use crate::config::schema::{values, Alternative, Schema};
use crate::error::BadInput;
use std::collections::BTreeMap;
use toml_edit::Value;

impl Schema for Config {
    const ALTERNATIVES: &'static [Alternative] = &[
        (&["time.end"], &["time.steps"]),
        (&["objective.window"], &["objective.periods", "objective.period"]),
        (&["objective.periods"], &["objective.window"]),
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
        config.shapes = vec![ShapeEntry::default()];
        config.variables = vec![VariableEntry::default()];
        config.limits = vec![LimitEntry::default()];
        (config.objective.shapes, config.objective.terms) = (vec![0], vec![Term::default()]);
        (config.resolution.surface, config.resolution.far) = (Some(0.01), Some(1.0));
        config.resolution.growth = Some(0.1);
        config.objective.goal = Goal::Smaller;
        config.objective.at = Some(vec![0.0; 2]);
        (config.objective.periods, config.objective.period) = (Some(1), Some(Formula("2*PI".into())));
        let side = Some(Side {
            velocity: Some(vec![]),
            temperature: Some(Formula("1".into())),
            heat_flux: Some(Formula("1".into())),
            ..Side::default()
        });
        let [back, front] = [side.clone(), side.clone()];
        config.region.sides =
            Sides { left: side.clone(), right: side.clone(), bottom: side.clone(), top: side, back, front };
        (config.region.inlet_until, config.region.outlet_from) = (Some(0.0), Some(1.0));
        config.initial.temperature = Some(Formula("1 + x".into()));
        config.initial.file = Some(String::new());
        config.output.grid = vec![1];
        config.exact.temperature = Some(Formula("1 + x".into()));
        (config.fluid.expansion, config.fluid.reference_temperature) = (1.0, Some(1.0));
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
        self.check_periods()?;
        match self.scene {
            Family::Custom if self.is_around_shapes() => {
                self.check_custom()?;
                self.check_around_shapes()?;
                self.check_variables()
            }
            Family::Custom => {
                self.check_custom()?;
                self.check_no_figures_of_shapes()?;
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
                self.check_over_relief()?;
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

/// A key, a value that needs a capability of the method, the values that need none, and the capability.
type Demand = (&'static str, &'static str, &'static str, fn(&Facts) -> bool);

/// Any number but the one that needs no capability.
const ANOTHER: &str = "another";

const DEMANDS: [Demand; 13] = [
    ("resolution.kernel", "super-gaussian", "gaussian, any other with positive weights", |can| can.negative_kernel),
    ("heat.conductivity_ratio", ANOTHER, "1", |can| can.two_materials),
    ("heat.capacity_ratio", ANOTHER, "1", |can| can.two_materials),
    ("fluid.drive", "flow-rate", "body-force", |can| can.holds_drive),
    ("fluid.drive", "pumping-power", "body-force", |can| can.holds_drive),
    ("fluid.body_force_region", "original-channel", "fluid", |can| can.force_region),
    ("wall.slip", "free-slip", "no-slip", |can| can.wall_keys),
    ("wall.mass", "constant", "column-area", |can| can.wall_keys),
    ("wall.hot_isotherm", "dummy", "surface", |can| can.wall_keys),
    ("time.adaptive", "true", "false", |can| can.divides_steps),
    ("objective.kind", "wall-heat", "heat-outflow, outlet-temperature, flow-rate", |can| can.wall_heat),
    ("design.walls", "both", "bottom", |can| can.shapes_both_walls),
    ("optimise.gradient", "steady", "segments, taped, truncated", |can| can.steady),
];

/// Demands that a custom scene does not make.
const NOT_OF_CUSTOM: [&str; 2] = ["wall.hot_isotherm", "objective.kind"];

impl Config {
    /// Number of fluid rows needed between the walls: one support radius from each, so that no particle reaches both.
    pub(super) fn fluid_rows(&self) -> f64 {
        2.0 * self.support()
    }

    fn is_periodic(&self) -> bool {
        match self.scene {
            Family::Custom => !self.has_walls(),
            _ => matches!(
                self.scene,
                Family::TaylorGreen | Family::TaylorGreen3d | Family::ReversePoiseuille | Family::ReversePoiseuille3d
            ),
        }
    }

    /// Checks that the method can solve the scene, has consistent keys, and has the needed capabilities.
    fn check_method(&self) -> Result<(), BadInput> {
        let (name, methods) = (self.method.name(), self.scene.built_in().methods());
        if !methods.contains(&name) {
            return Err(BadInput::at(
                "method.name",
                format!("method.name = {name} can not solve scene {}", self.scene.name()),
            )
            .allowed(methods.join(", ")));
        }
        self.method.check(matches!(self.scene, Family::HeatedChannel | Family::Slab))?;
        let sound = matches!(self.method, Method::Fixed(fixed) if fixed.pressure == PressureKind::WeaklyCompressible);
        if sound && !self.has_sound() {
            let problem =
                "method.pressure = weakly-compressible, which a flow in time around shapes can be, and this is none";
            let can_be = self.is_around_shapes() && !self.is_periodic_box();
            return Err(BadInput::at("method.pressure", problem)
                .allowed("incompressible; weakly-compressible with method.flow = unsteady in a scene of your own that is not all periodic")
                .advice(format!("{}method.pressure=incompressible", if can_be { "method.flow=unsteady, or " } else { "" })));
        }
        if self.is_corrected() && (!self.is_around_shapes() || self.has_sound() || self.dimension() != 2) {
            let problem =
                "method.deferred_correction = true, which an incompressible flow around shapes in the plane can have, and this is none";
            return Err(BadInput::at("method.deferred_correction", problem)
                .allowed("false; true with method.pressure = incompressible in a scene of your own in two dimensions")
                .advice("method.deferred_correction=false"));
        }
        if self.resolution.kernel == KernelName::SuperGaussian && !self.is_periodic() {
            let problem =
                "resolution.kernel = super-gaussian with walls: it is negative in its outer part, and averages beside \
                           walls need positive weights";
            return Err(BadInput::at("resolution.kernel", problem)
                .allowed("another kernel; super-gaussian with method.name = standard in a scene without walls")
                .advice("resolution.kernel=gaussian"));
        }
        let (now, custom) = (BTreeMap::from_iter(values(self)), self.scene == Family::Custom);
        for (key, needing, instead, can) in DEMANDS {
            let what = match &now[key] {
                Value::String(text) => text.value().clone(),
                Value::Float(number) => number.value().to_string(),
                other => other.to_string().trim().to_string(),
            };
            let asks = if needing == ANOTHER { what != instead } else { what == needing };
            let no_steps = self.is_around_shapes() && ["time.adaptive", "optimise.gradient"].contains(&key);
            if !asks || can(self.method.facts()) || (custom && NOT_OF_CUSTOM.contains(&key)) || no_steps {
                continue;
            }
            let more = if custom && key == "optimise.gradient" { "differences, ensemble, " } else { "" };
            let instead = format!("{more}{instead}");
            let able: Vec<&str> = Method::that(can).into_iter().filter(|name| methods.contains(name)).collect();
            let first = instead.split(',').next().unwrap_or_default();
            let bad = BadInput::at(key, format!("{key} = {what} with method.name = {name}"));
            return Err(match able.first() {
                None => bad.allowed(&instead).advice(format!("{key}={first}")),
                Some(one) => bad
                    .allowed(format!("{instead}; {what} with method.name = {}", able.join(" or ")))
                    .advice(format!("method.name={one}, or {key}={first}")),
            });
        }
        if self.scene.has_design() && self.optimise.gradient.is_of_runs() {
            let mode = now["optimise.gradient"].as_str().unwrap_or_default();
            let problem = format!("optimise.gradient = {mode} for a wall of many variables");
            return Err(BadInput::at("optimise.gradient", problem).allowed(
                "segments, taped, truncated or steady; differences or ensemble for `variables` of a scene of your own",
            ));
        }
        let moves = self.method.facts().moves;
        if custom && moves && self.optimise.gradient == GradientMode::Ensemble && self.time.jitter == 0.0 {
            return Err(BadInput::at("optimise.gradient", "optimise.gradient = ensemble with time.jitter = 0")
                .allowed("a jitter above 0: the members of the ensemble differ in the disorder that they begin with")
                .advice("time.jitter=0.05"));
        }
        Ok(())
    }
}
