//! Scenes for the loader: the range of every number, and the conditions that link them.

use crate::config::builtin::SCENES;
use crate::config::custom::{ShapeEntry, VariableEntry};
use crate::config::formula::Formula;
use crate::config::range::{Number, Range};
use crate::config::scene::{
    BodyForceRegion, Config, DensityEquation, DesignWalls, DriveName, DynamicsName, Family, FluxName, Formulation,
    GradientMode, IntegratorName, KernelName, Motion, ObjectiveKind, Precision, ShiftName, Trust,
};
use crate::config::schema::{Alternative, Schema};
use crate::error::BadInput;

/// More particles than this are a slip in `resolution.dx` rather than a wish.
pub(super) const MAX_PARTICLES: f64 = 1e8;

/// More steps than this are a slip in `time.*` rather than a wish.
const MAX_STEPS: f64 = 1e9;

/// Number of spacings counts as whole within this.
const WHOLE: f64 = 1e-6;

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
        SCENES.iter().map(|scene| scene.text).collect()
    }

    fn complete() -> Self {
        let mut config = Self::default();
        config.time.steps = Some(1);
        config.time.step = Some(1.0);
        config.shapes = vec![ShapeEntry::complete()];
        config.variables = vec![VariableEntry::default()];
        (config.region.inlet_until, config.region.outlet_from) = (Some(0.0), Some(1.0));
        config.initial.temperature = Some(Formula("1 + x".into()));
        (config.fluid.flow_rate, config.fluid.pumping_power) = (Some(1.0), Some(1.0));
        config.design.nodes = Some(vec![]);
        config.design.offsets = Some(vec![]);
        config.design.top_offsets = Some(vec![]);
        config.design.file = Some(String::new());
        config.surrogate.model = Some(String::new());
        config
    }

    fn numbers(&self) -> Vec<Number> {
        numbers(self)
    }

    fn usual(&self) -> (Self, &'static str) {
        (self.scene.defaults(), "the built-in scene's")
    }

    fn origin(&self) -> String {
        format!("default of scene {}", self.scene.name())
    }

    fn check_together(&self) -> Result<(), BadInput> {
        self.check_kernel()?;
        if self.scene == Family::Custom {
            self.check_custom()?;
            self.check_flow()?;
            self.check_steps()?;
            return self.check_variables();
        }
        if !self.scene.has_design() {
            match self.scene.has_surface() {
                true => self.check_tank()?,
                false => self.check_box()?,
            }
            self.check_flow()?;
            self.check_materials()?;
            self.check_warm_walls()?;
            self.check_methods()?;
            return self.check_steps();
        }
        self.check_spacing()?;
        self.check_channel()?;
        self.check_time()?;
        self.check_bound()?;
        self.check_formulation()?;
        if self.dimension() == 3 {
            self.check_no_rows()?;
        }
        self.check_drive()?;
        self.check_walls()?;
        self.check_objective()?;
        self.check_speed()?;
        self.check_trust()?;
        self.check_clip()?;
        self.check_store()
    }
}

/// Every number with its own range (the wall's arrays are checked as a shape).
fn numbers(config: &Config) -> Vec<Number> {
    use Range::{Above, Finite, NotNegative, Positive, Within};
    let Config {
        scene: _,
        region,
        shapes: _,
        variables: _,
        initial: _,
        resolution,
        channel,
        flow,
        heat,
        tank,
        water,
        fluid,
        wall,
        time,
        objective,
        design,
        optimise,
        surrogate,
        run,
        output,
    } = config;
    // The other scenes have no such key: they choose for themselves.
    let least_rows = if config.scene.has_design() { config.least_wall_rows() as f64 } else { 0.0 };
    vec![
        ("region.inlet_until", region.inlet_until.unwrap_or(0.0), NotNegative),
        ("region.outlet_from", region.outlet_from.unwrap_or(0.0), NotNegative),
        ("resolution.dx", resolution.dx, Positive),
        ("resolution.smoothing_length", resolution.smoothing_length, Within(0.5, 3.0)),
        ("channel.length", channel.length, Positive),
        ("channel.height", channel.height, Positive),
        ("channel.span", channel.span, Positive),
        ("channel.wall_rows", channel.wall_rows as f64, Within(least_rows, 100.0)),
        ("channel.hot_from", channel.hot_from, NotNegative),
        ("channel.hot_to", channel.hot_to, NotNegative),
        ("channel.inlet_length", channel.inlet_length, NotNegative),
        ("channel.outlet_length", channel.outlet_length, NotNegative),
        ("flow.reynolds", flow.reynolds, Positive),
        ("heat.conductivity_ratio", heat.conductivity_ratio, Within(1e-6, 1e6)),
        ("heat.capacity_ratio", heat.capacity_ratio, Within(1e-6, 1e6)),
        ("heat.prandtl", heat.prandtl, Within(1e-3, 1e3)),
        ("tank.length", tank.length, Positive),
        ("tank.height", tank.height, Positive),
        ("tank.depth", tank.depth, Positive),
        ("water.length", water.length, Positive),
        ("water.height", water.height, Positive),
        ("water.x", water.x, NotNegative),
        ("water.y", water.y, NotNegative),
        ("water.speed", water.speed, Finite),
        ("fluid.density", fluid.density, Positive),
        ("fluid.viscosity", fluid.viscosity, Positive),
        ("fluid.body_force", fluid.body_force, NotNegative),
        ("fluid.flow_rate", fluid.flow_rate.unwrap_or(1.0), Positive),
        ("fluid.pumping_power", fluid.pumping_power.unwrap_or(1.0), Positive),
        ("fluid.conductivity", fluid.conductivity, Positive),
        ("fluid.heat_capacity", fluid.heat_capacity, Positive),
        ("fluid.inlet_temperature", fluid.inlet_temperature, Finite),
        ("fluid.reference_velocity", fluid.reference_velocity, Positive),
        ("fluid.sound_speed_factor", fluid.sound_speed_factor, Within(1.0, 1000.0)),
        ("fluid.background_pressure_factor", fluid.background_pressure_factor, Within(0.0, 1.0)),
        ("fluid.transport_velocity", fluid.transport_velocity, Within(0.0, 1.0)),
        ("fluid.artificial_viscosity", fluid.artificial_viscosity, Within(0.0, 10.0)),
        ("fluid.equation_of_state_exponent", fluid.equation_of_state_exponent, Within(1.0, 20.0)),
        ("fluid.density_diffusion", fluid.density_diffusion, Within(0.0, 1.0)),
        ("fluid.velocity_diffusion", fluid.velocity_diffusion, Within(0.0, 10.0)),
        ("fluid.riemann_limiter", fluid.riemann_limiter, Within(0.0, 1000.0)),
        ("fluid.shift_strength", fluid.shift_strength, Within(0.0, 10.0)),
        ("fluid.pressure_diffusion", fluid.pressure_diffusion, Within(0.0, 1.0)),
        ("wall.hot_temperature", wall.hot_temperature, Finite),
        ("time.end", time.end, Positive),
        ("time.steps", time.steps.unwrap_or(1) as f64, Within(1.0, MAX_STEPS)),
        ("time.step", time.step.unwrap_or(1.0), Positive),
        ("time.cfl", time.cfl, Above(0.0, 4.0)),
        ("time.diffusion_number", time.diffusion_number, Above(0.0, 1.0)),
        ("time.jitter", time.jitter, Within(0.0, 0.3)),
        ("time.skin", time.skin, Above(0.0, 2.0)),
        ("objective.target_x", objective.target_x, NotNegative),
        ("objective.window", objective.window, NotNegative),
        ("objective.samples", objective.samples as f64, Within(1.0, MAX_STEPS)),
        ("design.control_points", design.control_points as f64, Within(4.0, 1000.0)),
        ("design.control_points_across", design.control_points_across as f64, Within(1.0, 1000.0)),
        ("design.amplitude", design.amplitude, Finite),
        ("design.periods", design.periods, Positive),
        ("design.periods_across", design.periods_across as f64, Within(0.0, 1000.0)),
        ("design.bound", design.bound, NotNegative),
        ("optimise.epochs", optimise.epochs as f64, Within(1.0, 1e6)),
        ("optimise.learning_rate", optimise.learning_rate, Positive),
        ("optimise.smoothing", optimise.smoothing, NotNegative),
        ("optimise.segment", optimise.segment as f64, Within(0.0, MAX_STEPS)),
        ("optimise.difference", optimise.difference, Within(1e-6, 0.5)),
        ("optimise.clip", optimise.clip, NotNegative),
        ("optimise.horizon", optimise.horizon as f64, Within(1.0, MAX_STEPS)),
        ("surrogate.settle", surrogate.settle as f64, Within(1.0, MAX_STEPS)),
        ("surrogate.steps", surrogate.steps as f64, Within(1.0, 10_000.0)),
        ("surrogate.window", surrogate.window, NotNegative),
        ("surrogate.check_every", surrogate.check_every as f64, Within(1.0, 1e6)),
        ("surrogate.radius", surrogate.radius, Positive),
        ("surrogate.inner_epochs", surrogate.inner_epochs as f64, Within(1.0, 1e6)),
        ("surrogate.epochs", surrogate.epochs as f64, Within(1.0, 1e6)),
        ("run.threads", run.threads as f64, Within(0.0, 1024.0)),
        ("output.frames", output.frames as f64, Within(0.0, 1e5)),
    ]
}

/// A weakly compressible flow is slower than this part of the sound speed.
const FASTEST: f64 = 0.5;

impl Config {
    /// Fluid rows needed between the walls: one support radius from each, so that no particle's sums reach both.
    fn fluid_rows(&self) -> f64 {
        2.0 * self.support()
    }

    /// Two materials are for one formulation.
    fn check_materials(&self) -> Result<(), BadInput> {
        let heat = &self.heat;
        for (key, ratio) in
            [("heat.conductivity_ratio", heat.conductivity_ratio), ("heat.capacity_ratio", heat.capacity_ratio)]
        {
            if ratio != 1.0 && self.fluid.formulation == Formulation::Consistent {
                return Err(BadInput::new(format!("{key} = {ratio} in the consistent formulation"))
                    .key(key)
                    .allowed("1: its fits know no jump; any other with fluid.formulation = standard")
                    .advice("fluid.formulation=standard"));
            }
        }
        Ok(())
    }

    /// The isothermal channel: inlet, warm walls and outlet in this order, in whole spacings.
    fn check_warm_walls(&self) -> Result<(), BadInput> {
        if self.scene != Family::IsothermalChannel {
            return Ok(());
        }
        let (channel, dx) = (&self.channel, self.resolution.dx);
        let shortest = 2.0 * (self.support() + self.time.skin) * dx;
        if channel.length < shortest || !is_whole(channel.length / dx) {
            return Err(BadInput::new(format!("channel.length = {} does not hold whole spacings", channel.length))
                .key("channel.length")
                .allowed(format!("multiples of resolution.dx = {dx}, at least {shortest}"))
                .advice(format!("channel.length={}", (channel.length / dx).round().max((shortest / dx).ceil()) * dx)));
        }
        let (low, high) = (channel.inlet_length, channel.length - channel.outlet_length - dx);
        if channel.hot_from < low || channel.hot_from > high {
            return Err(BadInput::new(format!("channel.hot_from = {} is out of place", channel.hot_from))
                .key("channel.hot_from")
                .allowed(format!(
                    "channel.inlet_length <= channel.hot_from <= channel.length - channel.outlet_length - dx, here {low} ... \
                     {high}"
                )));
        }
        Ok(())
    }

    /// A kernel that is negative somewhere belongs where nothing divides by a part of its sum (see
    /// [`crate::sph::kernels::super_gaussian`]).
    fn check_kernel(&self) -> Result<(), BadInput> {
        let periodic = match self.scene {
            Family::Custom => !self.has_walls(),
            _ => matches!(
                self.scene,
                Family::TaylorGreen | Family::TaylorGreen3d | Family::ReversePoiseuille | Family::ReversePoiseuille3d
            ),
        };
        let place = match (periodic, self.fluid.formulation) {
            (_, Formulation::Consistent) => "in the consistent formulation, whose fits need positive weights",
            (false, Formulation::Standard) => "with walls, whose averages over the fluid divide by its sum",
            (true, Formulation::Standard) => return Ok(()),
        };
        if self.resolution.kernel != KernelName::SuperGaussian {
            return Ok(());
        }
        Err(BadInput::new(format!("resolution.kernel = super-gaussian {place}: it is negative in its outer part"))
            .key("resolution.kernel")
            .allowed("another kernel; super-gaussian in the standard formulation of a scene without walls")
            .advice("resolution.kernel=gaussian"))
    }

    /// What only the heated channel has.
    fn check_flow(&self) -> Result<(), BadInput> {
        let fluid = &self.fluid;
        if fluid.drive != DriveName::BodyForce {
            return Err(BadInput::new("fluid.drive without a heated channel")
                .key("fluid.drive")
                .allowed("body-force, or scene heated-channel"));
        }
        if fluid.motion == Motion::Fixed {
            return Err(BadInput::new("fluid.motion = fixed without a heated channel")
                .key("fluid.motion")
                .allowed("moving, or scene heated-channel"));
        }
        // (What is at rest needs no shift, and has none.)
        if fluid.formulation == Formulation::Consistent && self.scene != Family::Slab {
            return self.check_no_rows();
        }
        Ok(())
    }

    /// A shift for particles that stand in no rows.
    fn check_no_rows(&self) -> Result<(), BadInput> {
        if matches!(self.fluid.shift, ShiftName::Chain | ShiftName::Rows) {
            return Err(BadInput::new("fluid.shift = chain or rows without rows of particles that stay rows")
                .key("fluid.shift")
                .allowed("isotropic or none, or scene heated-channel")
                .advice("fluid.shift=isotropic"));
        }
        Ok(())
    }

    /// Methods of the standard formulation that fit together.
    fn check_methods(&self) -> Result<(), BadInput> {
        let (fluid, wall, usual) = (&self.fluid, &self.wall, Self::default());
        let exponent = fluid.equation_of_state_exponent;
        if exponent.fract() != 0.0 {
            return Err(BadInput::new(format!("fluid.equation_of_state_exponent = {exponent} is no whole number"))
                .key("fluid.equation_of_state_exponent")
                .allowed("1 ... 20, whole numbers")
                .advice("fluid.equation_of_state_exponent=7 for water"));
        }
        let (evolves, delta) = (fluid.density_equation == DensityEquation::Evolution, fluid.flux == FluxName::Delta);
        let riemann = fluid.flux == FluxName::Riemann;
        let without = |key: &'static str, problem: &str, advice: &str| {
            Err(BadInput::new(format!("{key} {problem}")).key(key).allowed("its default there").advice(advice))
        };
        if fluid.formulation == Formulation::Consistent {
            let others = [
                ("fluid.density_equation", evolves),
                ("fluid.flux", fluid.flux != usual.fluid.flux),
                ("fluid.equation_of_state_exponent", exponent != usual.fluid.equation_of_state_exponent),
                ("wall.slip", wall.slip != usual.wall.slip),
            ];
            if let Some((key, _)) = others.into_iter().find(|(_, given)| *given) {
                let advice = "fluid.formulation=standard, or leave it out";
                return without(key, "is a setting of the standard formulation", advice);
            }
        }
        if fluid.density_renormalisation && !evolves {
            let problem = "= true with a density that is summed";
            return without("fluid.density_renormalisation", problem, "fluid.density_equation=evolution");
        }
        if !delta && fluid.density_gradient != usual.fluid.density_gradient {
            return without("fluid.density_gradient", "without diffusion of density", "fluid.flux=delta");
        }
        if riemann && fluid.transport_velocity != 0.0 {
            let advice = "fluid.transport_velocity=0, or fluid.flux=pair";
            return without(
                "fluid.transport_velocity",
                "with Riemann problems, whose states have no such stress",
                advice,
            );
        }
        if fluid.artificial_viscosity == 0.0
            && fluid.artificial_viscosity_pairs != usual.fluid.artificial_viscosity_pairs
        {
            let advice = "fluid.artificial_viscosity=0.1, or leave it out";
            return without("fluid.artificial_viscosity_pairs", "without an artificial viscosity", advice);
        }
        Ok(())
    }

    /// A tank whose walls and water stand on the lattice.
    fn check_tank(&self) -> Result<(), BadInput> {
        let (dx, tank, water) = (self.resolution.dx, &self.tank, &self.water);
        let (deep, block) = (self.dimension() == 3, self.scene == Family::FallingBlock);
        let still = self.scene == Family::HydrostaticTank;
        let particles = tank.length / dx * tank.height / dx * if deep { tank.depth / dx } else { 1.0 };
        if particles > MAX_PARTICLES {
            return Err(BadInput::new(format!("resolution.dx = {dx} makes {particles:.1e} particles"))
                .key("resolution.dx")
                .allowed(format!("at most {MAX_PARTICLES:.0e} particles")));
        }
        let extents = [
            ("tank.length", tank.length, true),
            ("tank.height", tank.height, true),
            ("tank.depth", tank.depth, deep),
            ("water.length", water.length, !still),
            ("water.height", water.height, true),
            ("water.x", water.x, block),
            ("water.y", water.y, block),
        ];
        for (key, extent, _) in extents.into_iter().filter(|(_, _, has)| *has) {
            let count = (extent / dx).round();
            if (extent / dx - count).abs() > WHOLE {
                return Err(BadInput::new(format!("resolution.dx = {dx} does not divide {key} = {extent}"))
                    .key(key)
                    .allowed("whole numbers of spacings")
                    .advice(format!("{key}={}", (1e9 * count * dx).round() / 1e9)));
            }
        }
        let (support, rows) = (self.support(), self.fluid_rows());
        for (key, extent) in [("tank.length", tank.length), ("tank.height", tank.height)] {
            if extent < rows * dx * (1.0 - WHOLE) {
                return Err(BadInput::new(format!("{key} = {extent} is too small"))
                    .key(key)
                    .allowed(format!("at least {}: no particle sees two walls", spacings(rows)))
                    .advice("a smaller resolution.dx"));
            }
        }
        let shortest = 2.0 * (support + self.time.skin) * dx;
        if deep && tank.depth < shortest {
            return Err(BadInput::new(format!("tank.depth = {} is too short", tank.depth))
                .key("tank.depth")
                .allowed(format!("at least 2 ({support} + time.skin) dx = {shortest}"))
                .advice("a smaller resolution.dx"));
        }
        let (length, x, y) = (
            if still { tank.length } else { water.length },
            if block { water.x } else { 0.0 },
            if block { water.y } else { 0.0 },
        );
        let slack = WHOLE * dx;
        for (key, from, extent, key_of_tank, most) in [
            ("water.length", x, length, "tank.length", tank.length),
            ("water.height", y, water.height, "tank.height", tank.height),
        ] {
            if from + extent > most + slack {
                return Err(BadInput::new(format!("{key} = {extent} reaches out of the tank"))
                    .key(key)
                    .allowed(format!("up to {}, {key_of_tank} less where the water begins", most - from))
                    .advice(format!("a larger {key_of_tank}")));
            }
        }
        let gravity = self.fluid.gravity;
        let flat = !deep && gravity[2] != 0.0;
        if flat || gravity.iter().any(|g| !g.is_finite()) || (still && (gravity[0] != 0.0 || gravity[1] >= 0.0)) {
            return Err(BadInput::new(format!("fluid.gravity = {gravity:?} is no acceleration of this tank"))
                .key("fluid.gravity")
                .allowed(match still {
                    true => "downwards: [0, less than 0, 0]",
                    false if deep => "three finite numbers",
                    false => "three finite numbers, the last one 0",
                })
                .advice("fluid.gravity=[0.0, -1.0, 0.0]"));
        }
        if self.fluid.formulation == Formulation::Consistent {
            return Err(BadInput::new("fluid.formulation = consistent with a free surface")
                .key("fluid.formulation")
                .allowed("standard: the consistent formulation's fits have no condition there")
                .advice("fluid.formulation=standard"));
        }
        Ok(())
    }

    /// A flow that the sound speed allows.
    fn check_speed(&self) -> Result<(), BadInput> {
        let (fastest, sound) = (self.plane_speed(), self.sound_speed());
        if fastest <= FASTEST * sound {
            return Ok(());
        }
        Err(BadInput::new(format!(
            "the plane channel's flow would be as fast as {fastest:.3}, with a sound speed of {sound:.3}"
        ))
        .key("fluid.reference_velocity")
        .allowed(format!("flows up to {FASTEST} of the sound speed, reference_velocity * sound_speed_factor"))
        .advice(format!("fluid.reference_velocity={:.2} (smaller steps), or a smaller fluid.body_force", fastest)))
    }

    /// A flow rate or a power that something holds.
    fn check_drive(&self) -> Result<(), BadInput> {
        let fluid = &self.fluid;
        let given = [
            ("fluid.flow_rate", fluid.flow_rate, DriveName::FlowRate, "flow-rate"),
            ("fluid.pumping_power", fluid.pumping_power, DriveName::PumpingPower, "pumping-power"),
        ];
        for (key, value, drive, name) in given {
            if value.is_some() && fluid.drive != drive {
                return Err(BadInput::new(format!("{key} without what holds it"))
                    .key(key)
                    .allowed(format!("fluid.drive = {name} with it"))
                    .advice(format!("fluid.drive={name}")));
            }
        }
        if fluid.drive == DriveName::BodyForce {
            return Ok(());
        }
        if fluid.formulation == Formulation::Standard {
            return Err(BadInput::new("fluid.drive in the standard formulation")
                .key("fluid.drive")
                .allowed("body-force; flow-rate and pumping-power with fluid.formulation = consistent")
                .advice("fluid.formulation=consistent, or fluid.drive=body-force"));
        }
        if fluid.body_force_region != BodyForceRegion::Fluid {
            return Err(BadInput::new("fluid.body_force_region = original-channel with a force that is found")
                .key("fluid.body_force_region")
                .allowed("fluid, or fluid.drive = body-force"));
        }
        if self.plane_force() == 0.0 {
            return Err(BadInput::new("fluid.drive without a flow rate or a power to hold")
                .key("fluid.drive")
                .allowed("a body force above 0, or fluid.flow_rate or fluid.pumping_power"));
        }
        Ok(())
    }

    /// An objective that only one formulation can differentiate.
    fn check_objective(&self) -> Result<(), BadInput> {
        match (self.objective.kind, self.fluid.formulation) {
            (ObjectiveKind::WallHeat, Formulation::Standard) => {
                Err(BadInput::new("objective.kind = wall-heat in the standard formulation")
                    .key("objective.kind")
                    .allowed("heat-outflow or outlet-temperature; wall-heat with fluid.formulation = consistent")
                    .advice("fluid.formulation=consistent, or objective.kind=heat-outflow"))
            }
            _ => Ok(()),
        }
    }

    /// A top wall that is shaped too.
    fn check_walls(&self) -> Result<(), BadInput> {
        let design = &self.design;
        if design.walls == DesignWalls::Bottom {
            return match design.top_offsets {
                None => Ok(()),
                Some(_) => Err(BadInput::new("design.top_offsets with a top wall that is not shaped")
                    .key("design.top_offsets")
                    .allowed("design.walls = both with them")
                    .advice("design.walls=both")),
            };
        }
        match self.fluid.formulation {
            Formulation::Consistent => Ok(()),
            Formulation::Standard => Err(BadInput::new("design.walls = both in the standard formulation")
                .key("design.walls")
                .allowed("bottom; both with fluid.formulation = consistent")
                .advice("fluid.formulation=consistent, or design.walls=bottom")),
        }
    }

    /// What one formulation has and the other has no equivalent of.
    fn check_formulation(&self) -> Result<(), BadInput> {
        let fixed = self.fluid.motion == Motion::Fixed;
        if fixed && self.fluid.formulation == Formulation::Standard {
            return Err(BadInput::new("fluid.motion = fixed in the standard formulation")
                .key("fluid.motion")
                .allowed("moving; fixed with fluid.formulation = consistent")
                .advice("fluid.formulation=consistent, or fluid.motion=moving"));
        }
        if self.time.integrator == IntegratorName::Verlet && (fixed || self.fluid.formulation == Formulation::Standard)
        {
            let whose = if fixed { "particles that do not move" } else { "the standard formulation" };
            return Err(BadInput::new(format!("time.integrator = verlet with {whose}"))
                .key("time.integrator")
                .allowed("symplectic-euler; verlet for moving particles of the consistent formulation")
                .advice("time.integrator=symplectic-euler"));
        }
        if self.time.adaptive && fixed {
            return Err(BadInput::new("time.adaptive = true with particles that do not move")
                .key("time.adaptive")
                .allowed("false; true with fluid.motion = moving"));
        }
        if fixed && self.fluid.body_force_region != BodyForceRegion::Fluid {
            return Err(BadInput::new("fluid.body_force_region = original-channel with particles that do not move")
                .key("fluid.body_force_region")
                .allowed("fluid, or fluid.motion = moving"));
        }
        if self.optimise.gradient == GradientMode::Differences {
            return Err(BadInput::new("optimise.gradient = differences for a wall of many variables")
                .key("optimise.gradient")
                .allowed("segments, taped, truncated or steady; differences for `variables` of a scene of your own"));
        }
        if self.optimise.gradient == GradientMode::Steady && !fixed {
            let all = "segments, taped or truncated";
            return Err(BadInput::new("optimise.gradient = steady with particles that move")
                .key("optimise.gradient")
                .allowed(match self.dimension() {
                    2 => format!("{all}, or fluid.motion = fixed"),
                    _ => format!("{all}: there are no fixed particles in three dimensions"),
                })
                .advice("optimise.gradient=segments"));
        }
        if self.fluid.formulation == Formulation::Standard {
            return Ok(());
        }
        let (fluid, wall) = (&self.fluid, &self.wall);
        let usual = self.usual().0;
        let others = [
            (
                "fluid.background_pressure_factor",
                fluid.background_pressure_factor != usual.fluid.background_pressure_factor,
            ),
            ("fluid.transport_velocity", fluid.transport_velocity != usual.fluid.transport_velocity),
            ("fluid.artificial_viscosity", fluid.artificial_viscosity != usual.fluid.artificial_viscosity),
            ("wall.hot_isotherm", wall.hot_isotherm != usual.wall.hot_isotherm),
            ("wall.mass", wall.mass != usual.wall.mass),
        ];
        match others.into_iter().find(|(_, given)| *given) {
            Some((key, _)) => Err(BadInput::new(format!("{key} is a setting of the standard formulation"))
                .key(key)
                .allowed("its default, in the consistent formulation")
                .advice("fluid.formulation=standard, or leave it out")),
            None => Ok(()),
        }
    }

    /// A surrogate's settings belong to a search that asks one.
    fn check_trust(&self) -> Result<(), BadInput> {
        let (dynamics, trust) = (self.optimise.dynamics, self.surrogate.trust);
        let bad = |problem: &str| BadInput::new(problem).key("surrogate.trust");
        match (dynamics, trust) {
            (DynamicsName::Solver, Trust::Check | Trust::Region) => Err(bad("surrogate.trust without a surrogate")
                .allowed("none where the solver judges every wall")
                .advice("optimise.dynamics=surrogate")),
            (DynamicsName::Both, Trust::Region) => Err(bad("surrogate.trust = region with optimise.dynamics = both")
                .allowed("none or check: in a trust region the solver has its say in every epoch")
                .advice("optimise.dynamics=surrogate")),
            _ => Ok(()),
        }
    }

    /// Clipping belongs to gradients that go back through a run.
    pub(super) fn check_clip(&self) -> Result<(), BadInput> {
        let has_none = matches!(self.optimise.gradient, GradientMode::Steady | GradientMode::Differences);
        match has_none && self.optimise.clip > 0.0 {
            true => Err(BadInput::new("optimise.clip with a gradient that does not go back through a run")
                .key("optimise.clip")
                .allowed("0 with optimise.gradient = steady or differences")
                .advice("optimise.gradient=segments")),
            false => Ok(()),
        }
    }

    /// Rounded states belong to schedules that keep every state.
    pub(super) fn check_store(&self) -> Result<(), BadInput> {
        let optimise = &self.optimise;
        let every_state = optimise.gradient != GradientMode::Taped && optimise.segment <= 1;
        if optimise.store == Precision::F32 && self.run.precision == Precision::F64 && !every_state {
            return Err(BadInput::new("optimise.store = f32 with states that steps are run again from")
                .key("optimise.store")
                .allowed("f32 only where every state is kept: a run from a rounded state is another run")
                .advice(
                    "optimise.segment=0 (chosen by memory) and a gradient that is not taped, or optimise.store=f64",
                ));
        }
        Ok(())
    }

    /// dx divides length and height, and the particles can be counted.
    fn check_spacing(&self) -> Result<(), BadInput> {
        let (dx, channel) = (self.resolution.dx, &self.channel);
        let span = (self.dimension() == 3).then_some(("channel.span", channel.span));
        let layers = span.map_or(1.0, |(_, span)| span / dx);
        let particles = channel.length / dx * (channel.height / dx + 2.0 * channel.wall_rows as f64) * layers;
        if particles > MAX_PARTICLES {
            return Err(BadInput::new(format!("resolution.dx = {dx} makes {particles:.1e} particles"))
                .key("resolution.dx")
                .allowed(format!("at most {MAX_PARTICLES:.0e} particles")));
        }
        let across = [Some(("channel.height", channel.height)), span].into_iter().flatten();
        let across: Vec<(&str, f64)> = across.collect();
        for &(key, extent) in [("channel.length", channel.length)].iter().chain(&across) {
            if !is_whole(extent / dx) {
                let problem = format!("resolution.dx = {dx} does not divide {key} = {extent}");
                let bad = BadInput::new(problem).key("resolution.dx").allowed(match span {
                    None => "whole numbers of spacings in channel.length and channel.height",
                    Some(_) => "whole numbers of spacings in channel.length, channel.height and channel.span",
                });
                let near = nearest_spacings(dx, channel.length, &across);
                let near: Vec<String> = near.iter().map(|dx| format!("resolution.dx={dx}")).collect();
                return Err(match near.is_empty() {
                    true => bad.advice("another channel.height: a simple fraction of channel.length"),
                    false => bad.advice(near.join(" or ")),
                });
            }
        }
        // Periodic images: a particle may see each neighbour once only.
        let support = self.support();
        let shortest = 2.0 * (support + self.time.skin) * dx;
        for (key, extent) in [("channel.length", channel.length)].into_iter().chain(span) {
            if extent < shortest {
                return Err(BadInput::new(format!("{key} = {extent} is too short"))
                    .key(key)
                    .allowed(format!("at least 2 ({support} + time.skin) dx = {shortest}"))
                    .advice("a smaller resolution.dx"));
            }
        }
        Ok(())
    }

    /// A spacing to compare with: half; in three dimensions the largest of at most four fifths that divides all extents.
    pub fn finer_spacing(&self) -> f64 {
        let (dx, channel) = (self.resolution.dx, &self.channel);
        if self.dimension() == 2 {
            return 0.5 * dx;
        }
        if self.scene == Family::Custom {
            let size = &self.region.size;
            let divides = |finer: f64| size.iter().all(|size| is_whole(size / finer));
            let first = (size[0] / (0.8 * dx) - 1e-9).ceil() as usize;
            let finer = (first..=2 * (size[0] / dx).round() as usize).map(|count| size[0] / count as f64);
            return finer.into_iter().find(|&finer| divides(finer)).unwrap_or(0.5 * dx);
        }
        let across = [("channel.height", channel.height), ("channel.span", channel.span)];
        // A millionth finer than what is asked for first: the search is for what is below or above a spacing.
        let near = nearest_spacings(0.8 * dx * (1.0 + 1e-6), channel.length, &across);
        near.into_iter().find(|&finer| finer <= 0.8 * dx * (1.0 + 1e-9)).unwrap_or(0.5 * dx)
    }

    /// Inlet, hot section, target and outlet in this order.
    fn check_channel(&self) -> Result<(), BadInput> {
        let channel = &self.channel;
        let outlet = channel.length - channel.outlet_length;
        let target = self.objective.target_x;
        let dx = self.resolution.dx;
        // Sums such as hot_from + dx are rounded; a billionth of a spacing is no difference.
        let slack = 1e-9 * dx;
        let order = [
            (
                "channel.hot_from",
                channel.hot_from,
                channel.inlet_length,
                channel.hot_to - dx,
                "channel.inlet_length <= channel.hot_from <= channel.hot_to - dx",
            ),
            (
                "channel.hot_to",
                channel.hot_to,
                channel.hot_from + dx,
                outlet,
                "channel.hot_from + dx <= channel.hot_to <= channel.length - channel.outlet_length",
            ),
            (
                "objective.target_x",
                target,
                channel.hot_to,
                outlet,
                "channel.hot_to <= objective.target_x <= channel.length - channel.outlet_length",
            ),
        ];
        for (key, value, low, high, rule) in order {
            if value < low - slack || value > high + slack {
                return Err(BadInput::new(format!("{key} = {value} is out of place"))
                    .key(key)
                    .allowed(format!("{rule}, here {low} ... {high}")));
            }
        }
        Ok(())
    }

    /// dx divides the box of a verification flow, which is large enough for it.
    fn check_box(&self) -> Result<(), BadInput> {
        let dx = self.resolution.dx;
        // Of the box, or the part of it that has to hold whole spacings; where there are walls; how many such parts there are.
        let (size, text, dimension, walls, parts) = match self.scene {
            Family::TaylorGreen3d => (std::f64::consts::TAU, "2 pi, the side of the box", 3, false, 1.0),
            Family::Poiseuille | Family::Couette => (1.0, "1, the height of the channel", 1, true, 1.0),
            Family::IsothermalChannel => (1.0, "1, the height of the channel", 2, true, self.channel.length),
            Family::ReversePoiseuille => (1.0, "1, the length of the box", 2, false, 2.0),
            Family::ReversePoiseuille3d => (0.5, "0.5, the depth of the box", 3, false, 8.0),
            Family::LidDrivenCavity => (1.0, "1, the side of the cavity", 2, true, 1.0),
            Family::LidDrivenCavity3d => (1.0, "1, the side of the cavity", 3, true, 1.0),
            Family::Slab => (0.5, "0.5, half of the slab", 1, true, 2.0),
            _ => (1.0, "1, the side of the box", 2, false, 1.0),
        };
        let bad = |problem: String| BadInput::new(problem).key("resolution.dx");
        let particles = parts * (size / dx).powi(dimension);
        if particles > MAX_PARTICLES {
            return Err(bad(format!("resolution.dx = {dx} makes {particles:.1e} particles"))
                .allowed(format!("at most {MAX_PARTICLES:.0e} particles")));
        }
        // Periodic images: a particle may see each neighbour once only. Walls: it may reach one of them only.
        let support = self.support();
        let fewest = match (walls, self.scene) {
            // Half of a slab has one wall.
            (true, Family::Slab) => support.max(8.0),
            (true, _) => self.fluid_rows(),
            (false, _) => 2.0 * (support + self.time.skin),
        };
        let count = (size / dx).round();
        if count < fewest {
            let rule = match walls {
                true => spacings(fewest),
                false => format!("2 ({} + time.skin) spacings", (support * 1e6).round() / 1e6),
            };
            return Err(bad(format!("resolution.dx = {dx} is too coarse"))
                .allowed(format!("at least {rule} in {text}"))
                .advice(format!("resolution.dx={}", size / fewest.ceil())));
        }
        if !is_whole(size / dx) {
            return Err(bad(format!("resolution.dx = {dx} does not divide {text}"))
                .allowed(format!("{size} over a whole number"))
                .advice(format!("resolution.dx={}", size / count)));
        }
        Ok(())
    }

    fn check_time(&self) -> Result<(), BadInput> {
        self.check_steps()?;
        self.check_window()
    }

    /// The objective's window is a part of the run with enough steps.
    ///
    /// # Errors
    /// One that is not.
    pub fn check_window(&self) -> Result<(), BadInput> {
        let (window, duration) = (self.objective.window, self.duration());
        if window > duration * (1.0 + 1e-9) {
            return Err(BadInput::new(format!("objective.window = {window} is longer than the run"))
                .key("objective.window")
                .allowed(format!("0 (last step) ... {duration:.6}, the simulated time"))
                .advice("objective.window=0, or a larger time.end or time.steps"));
        }
        let steps = (window / self.time_step() - 1e-9).ceil().max(0.0) as usize;
        if window > 0.0 && self.objective.samples > steps {
            return Err(BadInput::new(format!(
                "objective.samples = {} is more than the steps in objective.window = {window}",
                self.objective.samples
            ))
            .key("objective.samples")
            .allowed(format!("1 ... {steps}")));
        }
        Ok(())
    }

    /// The time step is a number, and the steps can be counted.
    fn check_steps(&self) -> Result<(), BadInput> {
        let limit = self.time_step_limit();
        if !(limit > 0.0 && limit.is_finite()) {
            return Err(BadInput::new(format!("the fluid's numbers allow a time step of {limit}"))
                .allowed("a sound speed, viscosity and thermal diffusivity whose time step is a positive number")
                .advice(format!("`hydrograd scenes {}` shows usual values", self.scene.name())));
        }
        if let Some(step) = self.time.step.filter(|&step| step > limit * (1.0 + WHOLE)) {
            return Err(BadInput::new(format!("time.step = {step} is too large"))
                .key("time.step")
                .allowed(format!("steps of at most {limit:.4e}, which time.cfl and time.diffusion_number allow"))
                .advice("leave time.step out: the largest steps are taken then"));
        }
        let needed = self.time.end / self.time.step.unwrap_or(limit);
        if self.time.steps.is_none() && needed > MAX_STEPS {
            let limits = self.time_step_limits();
            // A usual time is not to blame for tiny steps.
            let (key, value) = match self.time.step {
                _ if self.time.end > 1e3 * self.scene.defaults().time.end => ("time.end", self.time.end),
                Some(step) => ("time.step", step),
                None if limits.diffusive < limits.acoustic => ("time.diffusion_number", self.time.diffusion_number),
                None => ("time.cfl", self.time.cfl),
            };
            let problem = format!("{key} = {value}: the run to t = {} needs {needed:.1e} steps", self.time.end);
            return Err(BadInput::new(problem).key(key).allowed(format!("at most {MAX_STEPS:.0e} steps")));
        }
        Ok(())
    }

    /// How far the wall may move.
    fn check_bound(&self) -> Result<(), BadInput> {
        let (bound, dx, channel) = (self.design.bound, self.resolution.dx, &self.channel);
        let fail = |limit: f64, why: &str, advice: String| {
            Err(BadInput::new(format!("design.bound = {bound} is too large: {why}"))
                .key("design.bound")
                .allowed(format!("0 ... {limit:.6}"))
                .advice(advice))
        };
        let whole = 1.0 + 1e-9;
        // The number of rows is constant, so the fluid between a raised wall and the top is squeezed; what
        // counts for the walls' sums is its height.
        let fewest = self.fluid_rows();
        let walls = if self.design.walls == DesignWalls::Both { 2.0 } else { 1.0 };
        let limit = (channel.height - fewest * dx) / walls;
        if limit < -1e-9 * dx {
            let lowest = fewest * dx;
            return Err(BadInput::new(format!("channel.height = {} is too low", channel.height))
                .key("channel.height")
                .allowed(format!("at least {}, {lowest:.6}", spacings(fewest)))
                .advice("a smaller resolution.dx"));
        }
        if bound > limit.max(0.0) * whole {
            let advice = "a smaller resolution.dx, or a smaller design.bound";
            let why = format!("the channel keeps {} of fluid", spacings(fewest));
            return fail(limit.max(0.0), &why, advice.into());
        }
        // Dummy particles move with the surface of their column. At the ends of the hot section the surface
        // steps to y = 0, and the face of that step consists of the rows of the higher column: rows that end
        // above the foot of the step leave a hole. (Within the section the slope limit sees to it.)
        let limit = channel.wall_rows as f64 * dx;
        // (In the consistent formulation the wall has no steps.)
        if bound > limit * whole && self.fluid.formulation == Formulation::Standard {
            let rows = (bound / dx - 1e-9).ceil();
            let why = format!("the {} wall rows must cover it", channel.wall_rows);
            return fail(limit, &why, format!("channel.wall_rows={rows}"));
        }
        // Neighbouring control points of a wall over x and z may differ by twice the bound: a slope of 2 at most.
        if self.dimension() == 3 {
            let limit = self.control_distances().into_iter().fold(f64::INFINITY, f64::min);
            if bound > limit * whole {
                let advice = "a smaller design.bound, or fewer design.control_points or design.control_points_across";
                return fail(
                    limit,
                    "no more than the control points' distance, for a slope of 2 at most",
                    advice.into(),
                );
            }
        }
        // In a dip the constant number of rows is stretched to (1 + bound / height) dx; beyond 1.5 dx fewer
        // than two rows lie within the usual support of 3 dx.
        let limit = 0.5 * channel.height / walls;
        if bound > limit * whole {
            return fail(limit, "half the channel's height at most", "a smaller design.bound".into());
        }
        Ok(())
    }
}

/// A number of spacings in words.
fn spacings(count: f64) -> String {
    match count {
        6.0 => "six spacings".into(),
        _ => format!("{} spacings", (1e6 * count).round() / 1e6),
    }
}

pub(super) fn is_whole(count: f64) -> bool {
    count.round() >= 1.0 && (count - count.round()).abs() <= WHOLE
}

/// The next larger and the next smaller spacing that divide the length and all extents across it, if there are any nearby.
fn nearest_spacings(dx: f64, length: f64, across: &[(&str, f64)]) -> Vec<f64> {
    let divides = |columns: usize, extent: f64| is_whole(extent / length * columns as f64);
    let fits = |columns: &usize| *columns > 0 && across.iter().all(|(_, extent)| divides(*columns, *extent));
    let start = (length / dx).floor() as usize;
    let larger = (start.saturating_sub(10_000)..=start).rev().find(fits);
    let smaller = (start + 1..start + 10_000).find(fits);
    let spacing = |columns: usize| length / columns as f64;
    larger.into_iter().chain(smaller).map(spacing).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nearest_spacings_divide_both() {
        let near = |dx: f64, across: &[f64]| {
            let across: Vec<(&str, f64)> = across.iter().map(|&extent| ("", extent)).collect();
            nearest_spacings(dx, 1.0, &across)
        };
        assert_eq!(near(0.03, &[0.2]), [1.0 / 30.0, 1.0 / 35.0]);
        assert_eq!(near(0.021, &[0.26]), [0.02]);
        assert_eq!(near(0.03, &[0.2, 0.25]), [1.0 / 20.0, 1.0 / 40.0]);
        assert!(near(0.02, &[std::f64::consts::FRAC_1_PI]).is_empty());
    }
}
