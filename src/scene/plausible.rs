//! Estimates for a scene before it runs: what a configuration builds, and warnings about implausible values.

use super::custom::Geometry;
use super::flaws;
use super::warnings::Warning;
use super::Scene;
use crate::config::custom::Kind;
use crate::config::scene::{Config, Family, Method, ObjectiveKind};
use crate::config::suggest;
use crate::design::shape::Shape;
use crate::error::BadInput;
use crate::particles::tag;
use crate::sph::divergence::Cause;
use crate::sph::Sweeps;

#[derive(Debug, Clone, PartialEq)]
pub struct Criterion {
    pub name: &'static str,
    /// The formula as in the comments of the configuration.
    pub formula: &'static str,
    pub dt: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Findings {
    /// Kinds of particles, and their numbers.
    pub particles: Vec<(&'static str, usize)>,
    /// The criteria of the time step; the smallest one determines it.
    pub criteria: Vec<Criterion>,
    /// Largest expected speed, by the parameters and the geometry.
    pub speed: f64,
    /// Number of particles across the narrowest passage between walls.
    pub narrowest: Option<usize>,
    /// Number of particles across the thinnest wall with fluid on both sides.
    pub thinnest: Option<usize>,
    /// Indices of shapes without a particle.
    pub idle: Vec<usize>,
    /// See [`lift`].
    lift: [f64; 3],
    pub warnings: Vec<Warning>,
}

/// Largest resolved number of viscous or thermal diffusion lengths per spacing.
const CELL_NUMBER: f64 = 10.0;
/// Largest relative compression of the fluid, by its own weight and by its flow.
const COMPRESSION: f64 = 0.02;
/// Largest ratio of the reference velocity to the expected speed; larger ones make steps needlessly short.
const TOO_CAREFUL: f64 = 10.0;
/// Smallest radius of curvature of a wall that particles which move resolve, in spacings. Of sines in the heated channel the
/// flow rate is 0.8 % off at a radius of 1.9, 1.5 % at 1.3, 2.2 % at 1.1 and 4.1 % at 0.8 (consistent method; fixed particles
/// are within 0.2 % there).
const SHARP: f64 = 1.5;
const MANY_STEPS: usize = 2_000_000;

impl Findings {
    /// The estimates for a scene and the configuration that it was built from.
    pub fn of<R: Sweeps>(config: &Config, scene: &Scene<R>) -> Result<Self, BadInput> {
        let grid = match config.scene {
            Family::Custom => Some(Geometry::of(config)?),
            _ => None,
        };
        let speed = speed(config, scene, grid.as_ref());
        let mut findings = Self {
            particles: particles(&scene.model.tags),
            criteria: criteria(config),
            speed,
            narrowest: grid.as_ref().and_then(|grid| grid.narrowest(false)),
            thinnest: grid.as_ref().and_then(|grid| grid.narrowest(true)),
            idle: grid.map_or(vec![], |grid| grid.idle),
            lift: lift(scene),
            warnings: vec![],
        };
        findings.warnings = findings.implausible(config);
        let moves = config.method.facts().moves;
        let wall = scene.design.as_ref().filter(|_| moves).map(|design| design.first_wall());
        let wall = wall.filter(|wall| wall.across.is_none());
        findings.warnings.extend(wall.and_then(|wall| curvature(&wall, config.resolution.dx)));
        Ok(findings)
    }

    /// The name of the criterion with the smallest time step.
    pub fn rules(&self) -> &'static str {
        let smallest = self.criteria.iter().min_by(|a, b| a.dt.total_cmp(&b.dt));
        smallest.map_or("none", |criterion| criterion.name)
    }

    /// The cause of a divergence at a place, if its numbers name none and the scene has one: the nearest flaw of its walls,
    /// or layers thinner than a particle.
    ///
    /// # Errors
    /// As for building the scene.
    pub fn cause(&self, config: &Config, found: &Cause, place: &[f64]) -> Result<Option<Cause>, BadInput> {
        if !found.is_open || config.scene != Family::Custom {
            return Ok(None);
        }
        let known = self.flaw(config, place)?.map_or_else(|| flaws::nearest(config, place), |flaw| Ok(Some(flaw)))?;
        Ok(known.or_else(|| self.warned("cell-")))
    }

    /// What is likely to make a configuration's flow diverge, as far as can be told before it runs.
    pub(super) fn expected_flaw(config: &Config) -> Result<Option<Cause>, BadInput> {
        if config.is_around_shapes() {
            return Ok(None);
        }
        let is_own = config.scene == Family::Custom;
        is_own
            .then(|| Self::of(config, &super::custom::build::<f64>(config)?)?.flaw(config, &[]))
            .map_or(Ok(None), |it| it)
    }

    /// The flaw of the walls nearest to a place, or a flow that is too fast. The standard method bears flaws of walls.
    fn flaw(&self, config: &Config, place: &[f64]) -> Result<Option<Cause>, BadInput> {
        let bears = matches!(config.method, Method::Standard(_));
        Ok(if bears { None } else { flaws::nearest(config, place)? }.or_else(|| self.warned("expected-speed")))
    }

    fn warned(&self, code: &str) -> Option<Cause> {
        let warning = self.warnings.iter().find(|warning| warning.code.starts_with(code))?;
        Some(Cause { why: warning.problem.clone(), advice: warning.advice.clone(), is_open: false })
    }

    fn implausible(&self, config: &Config) -> Vec<Warning> {
        let mut all = Vec::new();
        let mut warn = |code: &str, value_and_limit: [f64; 2], problem: String, advice: String| {
            all.push(Warning::new(code, value_and_limit, problem, advice));
        };
        let (fluid, dx, u, c) = (&config.fluid, config.resolution.dx, self.speed, config.sound_speed());
        let reference = fluid.reference_velocity;
        let own = config.scene == Family::Custom || config.scene.has_design();
        if own && u > reference && (u / c).powi(2) > COMPRESSION {
            warn(
                "expected-speed",
                [u, reference],
                format!(
                    "the flow may become as fast as {u:.3}, a Mach number of {:.2}, and fluid.reference_velocity is {reference}: \
                     density would change by {:.1} %",
                    u / c,
                    100.0 * (u / c).powi(2),
                ),
                format!("fluid.reference_velocity={} (smaller steps), or a smaller force", suggest::at_least(u, u)),
            );
        }
        // How fast buoyancy makes a flow is not foreseen.
        if own && u > 0.0 && reference > TOO_CAREFUL * u && self.lift == [0.0; 3] {
            warn(
                "large-reference-velocity",
                [reference / u, TOO_CAREFUL],
                format!(
                    "fluid.reference_velocity = {reference} is {:.0} times the fastest flow that is to be expected ({u:.3}): steps \
                     are as many times smaller than need be",
                    reference / u
                ),
                format!("fluid.reference_velocity={:.2e}", 2.0 * u),
            );
        }
        let viscosity = config.model_viscosity() + config.artificial_kinematic_viscosity();
        let heat = if config.has_heat() { config.thermal_diffusivity() } else { f64::INFINITY };
        for (code, name, symbol, diffusivity, key) in [
            ("cell-reynolds-number", "Reynolds", "nu", viscosity, "fluid.viscosity"),
            ("cell-peclet-number", "Peclet", "alpha", heat, "fluid.conductivity"),
        ] {
            let cell = u * dx / diffusivity;
            if cell > CELL_NUMBER {
                warn(
                    code,
                    [cell, CELL_NUMBER],
                    format!(
                        "the cell {name} number u dx / {symbol} is {cell:.0}: layers at walls are thinner than a particle"
                    ),
                    format!("{}, or a larger {key}", config.finer(CELL_NUMBER * diffusivity / u)),
                );
            }
        }
        let support = config.support();
        if let Some(narrowest) = self.narrowest.filter(|&count| (count as f64) < 2.0 * support) {
            warn(
                "narrow-passage",
                [narrowest as f64, 2.0 * support],
                format!(
                    "the narrowest passage is {narrowest} particles wide: below {:.0} a particle's sums reach both walls, and the \
                     flow is not resolved",
                    2.0 * support
                ),
                config.finer(dx * narrowest as f64 / (2.0 * support)),
            );
        }
        let lines = config.shapes.iter().filter(|shape| shape.kind == Kind::Polyline);
        let lines = lines.filter_map(|shape| shape.thickness).map(|thickness| thickness / dx);
        let thinnest = self.thinnest.map(|count| count as f64).into_iter().chain(lines).reduce(f64::min);
        if let Some(thinnest) = thinnest.filter(|&count| count < support * (1.0 - 1e-9)) {
            warn(
                "thin-wall",
                [thinnest, support],
                format!(
                    "the thinnest wall is {thinnest:.1} particles thick, and the kernel reaches {support:.1}: fluid on one side \
                     sees the fluid on the other"
                ),
                "a thicker wall, or a smaller resolution.dx".into(),
            );
        }
        for k in &self.idle {
            warn(
                "idle-shape",
                [0.0, 1.0],
                format!("shapes[{k}] holds no particle: it lies outside of the box or behind later shapes, and has no effect"),
                format!("another place of shapes[{k}]"),
            );
        }
        if config.scene == Family::Custom {
            let region = &config.region;
            for (d, g) in region.acceleration.iter().enumerate().filter(|&(d, _)| !region.periodic[d]) {
                // Only the standard method computes the pressure from the density.
                let lift = if matches!(config.method, Method::Standard(_)) { self.lift[d] } else { 0.0 };
                let compression = (g.abs() + lift) * region.size[d] / (c * c);
                let lifted = if lift > 0.0 { format!(" with up to {lift:.3} of buoyancy") } else { String::new() };
                if compression > COMPRESSION {
                    warn(
                        "compression",
                        [compression, COMPRESSION],
                        format!(
                            "region.acceleration[{d}] = {g}{lifted} compresses the fluid by {:.0} % over region.size[{d}]",
                            100.0 * compression
                        ),
                        "a larger fluid.reference_velocity or fluid.sound_speed_factor".into(),
                    );
                }
            }
            let bare = matches!(config.method, Method::Standard(own) if own.background_pressure_factor == 0.0);
            if bare && config.has_walls() {
                warn(
                    "no-background-pressure",
                    [0.0, 0.05],
                    "without a background pressure particles behind obstacles may leave holes".into(),
                    "method.background_pressure_factor=0.05".into(),
                );
            }
            let crossing = region.size[0] / u;
            if u > 0.0 && config.duration() < crossing && region.periodic[0] && region.acceleration[0] != 0.0 {
                warn(
                    "short-run",
                    [config.duration(), crossing],
                    format!(
                        "the run ends at {:.3}, before the flow has crossed the box once ({crossing:.3})",
                        config.duration()
                    ),
                    format!("time.end={:.3}", 2.0 * crossing),
                );
            }
            if config.has_design() && !config.flows_through() && config.objective.kind != ObjectiveKind::WallHeat {
                warn(
                    "no-through-flow",
                    [0.0, 0.0],
                    "nothing flows through the section of the objective: the box is closed along x".into(),
                    "region.periodic=[true, false], or objective.kind=wall-heat".into(),
                );
            }
        }
        if config.steps() > MANY_STEPS {
            let problem = format!("{} steps are many: rounding and patience have limits", config.steps());
            let advice = "a larger time.cfl, or a smaller fluid.sound_speed_factor".into();
            warn("many-steps", [config.steps() as f64, MANY_STEPS as f64], problem, advice);
        }
        all
    }
}

/// The largest acceleration by buoyancy along each direction, by the temperatures of the start and of walls.
fn lift<R: Sweeps>(scene: &Scene<R>) -> [f64; 3] {
    let model = &scene.model;
    let (Some(buoyancy), Some(heat), Some(row)) = (model.buoyancy, &model.heat, model.rows.temperature()) else {
        return [0.0; 3];
    };
    let n = model.particles();
    let start = (0..n).filter(|&i| model.is_fluid(i)).map(|i| scene.start.state[row * n + i].f64());
    // A wall that is held at T has T = constant + factor T.
    let walls =
        heat.wall_constant.iter().zip(&heat.wall_factor).map(|(constant, factor)| (constant.f64(), factor.f64()));
    let walls = walls.filter(|(_, factor)| *factor < 1.0).map(|(constant, factor)| constant / (1.0 - factor));
    let most = start.chain(walls).map(|t| (t - buoyancy.at).abs()).fold(0.0, f64::max);
    buoyancy.by.map(|by| by.abs() * most)
}

/// Warns if a wall turns so sharply that particles do not resolve it: by its smallest radius of curvature, 1 / |y''|.
fn curvature(wall: &Shape, dx: f64) -> Option<Warning> {
    let sharpest = |offsets: &[f64]| {
        let bend = |k: usize| {
            let [a, b] = [wall.nodes[k] - wall.nodes[k - 1], wall.nodes[k + 1] - wall.nodes[k]];
            let turn = (offsets[k + 1] - offsets[k]) / b - (offsets[k] - offsets[k - 1]) / a;
            turn.abs() / (0.5 * (a + b)).max(dx)
        };
        (1..offsets.len().max(1) - 1).map(bend).fold(0.0, f64::max)
    };
    let bends = [sharpest(&wall.offsets), wall.top.as_deref().map_or(0.0, sharpest)];
    let radius = 1.0 / (bends[0].max(bends[1]) * dx);
    (radius < SHARP).then(|| {
        let problem =
            format!("the wall turns with a radius of {radius:.1} particles: its flow rate may be off by 1 to 4 %");
        Warning::new(
            "wall-curvature",
            [radius, SHARP],
            problem,
            "method.name=fixed, a smaller resolution.dx, or a gentler wall",
        )
    })
}

fn particles(tags: &[u8]) -> Vec<(&'static str, usize)> {
    let kinds = [
        (tag::FLUID, "fluid"),
        (tag::WALL, "wall at rest"),
        (tag::MOVING_WALL, "moving wall"),
        (tag::HOT_WALL, "wall of set temperature"),
        (tag::SURFACE, "point on a wall's surface"),
        (tag::HOT_SURFACE, "point of set temperature"),
    ];
    let count = |kind: u8| tags.iter().filter(|&&tag| tag == kind).count();
    kinds.into_iter().map(|(kind, name)| (name, count(kind))).filter(|(_, count)| *count > 0).collect()
}

fn criteria(config: &Config) -> Vec<Criterion> {
    let (limits, square) = (config.time_step_limits(), config.resolution.dx.powi(2));
    let viscous =
        config.time.diffusion_number * square / (config.model_viscosity() + config.artificial_kinematic_viscosity());
    let mut all = vec![
        Criterion { name: "sound", formula: "cfl dx / (c + u_ref)", dt: limits.acoustic },
        Criterion { name: "viscosity", formula: "diffusion_number dx^2 / nu", dt: viscous },
    ];
    if config.has_heat() {
        let thermal = config.time.diffusion_number * square / config.thermal_diffusivity();
        all.push(Criterion { name: "heat", formula: "diffusion_number dx^2 / alpha", dt: thermal });
    }
    if limits.growth.is_finite() {
        all.push(Criterion { name: "sound in the flow", formula: "no plane sound grows", dt: limits.growth });
    }
    if limits.force.is_finite() {
        all.push(Criterion { name: "body force", formula: "0.25 sqrt(dx / g)", dt: limits.force });
    }
    all
}

/// The largest of the initial speed and the speed that the body force may cause.
fn speed<R: Sweeps>(config: &Config, scene: &Scene<R>, grid: Option<&Geometry>) -> f64 {
    let (model, n) = (&scene.model, scene.model.particles());
    let l = model.rows;
    let is_velocity = |i: usize| model.has_velocity(i);
    let square = |i: usize| (0..l.dimension).map(|d| scene.start.state[(l.velocity() + d) * n + i].f64().powi(2)).sum();
    let start = (0..n).filter(|&i| is_velocity(i)).map(square).fold(0.0, f64::max).sqrt();
    let driven = match config.scene {
        Family::HeatedChannel | Family::HeatedChannel3d => config.plane_speed(),
        Family::Custom => grid.map_or(0.0, |grid| grid.driven(config)),
        _ => config.fluid.reference_velocity,
    };
    start.max(driven)
}

impl Geometry {
    /// Index of the cell `by` steps along direction `d`, if there is one.
    fn step(&self, i: usize, d: usize, by: isize) -> Option<usize> {
        let stride: usize = self.lattice.cells[..d].iter().product();
        let (count, row) = (self.lattice.cells[d], i / stride % self.lattice.cells[d]);
        let to = row as isize + by;
        let to = match self.lattice.periodic[d] {
            true => to.rem_euclid(count as isize),
            false if (0..count as isize).contains(&to) => to,
            false => return None,
        };
        Some(i + to as usize * stride - row * stride)
    }

    /// Runs of cells of one kind along direction `d`, bounded by the other kind at both ends.
    fn runs(&self, d: usize, walls: bool) -> Vec<Vec<usize>> {
        let mut all = Vec::new();
        for i in (0..self.is_wall.len()).filter(|&i| self.is_wall[i] == walls) {
            // A run begins behind a cell of the other kind.
            if self.step(i, d, -1).is_none_or(|before| self.is_wall[before] == walls) {
                continue;
            }
            let mut run = vec![i];
            let ends = loop {
                match self.step(run[run.len() - 1], d, 1) {
                    Some(next) if self.is_wall[next] != walls => break true,
                    Some(next) => run.push(next),
                    None => break false,
                }
            };
            if ends {
                all.push(run);
            }
        }
        all
    }

    /// Number of cells across the narrowest passage or the thinnest wall. Runs with the other kind beside them, as at
    /// the caps of round shapes, do not count.
    fn narrowest(&self, walls: bool) -> Option<usize> {
        let is_through = |run: &Vec<usize>, d: usize| {
            let others = (0..self.lattice.dimension).filter(|&e| e != d);
            others.flat_map(|e| [(e, -1), (e, 1)]).all(|(e, by)| {
                run.iter().all(|&i| self.step(i, e, by).is_none_or(|beside| self.is_wall[beside] == walls))
            })
        };
        (0..self.lattice.dimension)
            .flat_map(|d| self.runs(d, walls).into_iter().filter(move |run| is_through(run, d)).map(|run| run.len()))
            .min()
    }

    /// Estimate of the speed that the body force causes: by plane channels as wide as the passages, in series
    /// (lubrication), and at most that of freely accelerated fluid. A closed side stops the flow.
    fn driven(&self, config: &Config) -> f64 {
        let (nu, dx, time) = (config.model_viscosity(), config.resolution.dx, config.duration());
        let mut fastest: f64 = 0.0;
        for (d, g) in
            config.region.acceleration.iter().enumerate().filter(|(d, g)| **g != 0.0 && self.lattice.periodic[*d])
        {
            let free = g.abs() * time;
            let stride: usize = self.lattice.cells[..d].iter().product();
            let section = |i: usize| i / stride % self.lattice.cells[d];
            // Sums of width^3 over the passages of each section, and its widest passage. In three dimensions the width
            // is that in the narrower direction.
            let (mut cubes, mut widest) = (vec![0.0; self.lattice.cells[d]], vec![0.0_f64; self.lattice.cells[d]]);
            let across = |e: usize| {
                let mut width = vec![f64::INFINITY; self.is_wall.len()];
                for run in self.runs(e, false) {
                    let length = run.len() as f64 * dx;
                    run.iter().for_each(|&i| width[i] = length);
                }
                width
            };
            let widths: Vec<Vec<f64>> = (0..self.lattice.dimension).filter(|&e| e != d).map(across).collect();
            for i in (0..self.is_wall.len()).filter(|&i| !self.is_wall[i]) {
                let width = widths.iter().map(|width| width[i]).fold(f64::INFINITY, f64::min);
                // The part of a cell in its passage.
                cubes[section(i)] += width.powi(2) * dx;
                widest[section(i)] = widest[section(i)].max(width);
            }
            // A section without a passage stops the flow.
            if cubes.contains(&0.0) {
                continue;
            }
            let resistance: f64 = cubes.iter().map(|cube| 12.0 * nu * dx / cube).sum();
            let length = self.lattice.cells[d] as f64 * dx;
            let rate = g.abs() * length / resistance;
            let found = cubes.iter().zip(&widest).map(|(cube, width)| 1.5 * rate * width * width / cube);
            // An infinitely wide passage has no resistance.
            let found = found.fold(0.0, |most: f64, u| if u.is_finite() { most.max(u) } else { free });
            fastest = fastest.max(if resistance > 0.0 { found.min(free) } else { free });
        }
        fastest
    }
}
