//! Checks whether the gain of a design is a property of its wall, by changing conditions that it must not depend on.
//!
//! A wall is given by nodes and offsets, so it is the same at every spacing. Both the best and the reference wall are
//! run under each [`Check`]; the gain is Q of the best over Q of the reference, minus one, and is told at the finest spacing. The
//! surviving gain is the gain less its error, see [`Verified::error`]. A gain of a few tenths of a percent that was found at one spacing, or at the
//! end of one run, may be an error of the solver that the optimiser has exploited.

use super::around_flow::Designed;
use super::figure_error::{order, Parts};
use super::load::Loaded;
use super::record::{relative_change, Record};
use super::Scene;
use crate::adjoint::RunError;
use crate::config::layers::Setting;
use crate::config::scene::{
    Config, DesignWalls, DriveName, Family, Goal, GradientMode, Method, ObjectiveKind, Precision,
};
use crate::config::schema::values;
use crate::design::objectives::Figure;
use crate::design::parametrisations::SplineSurface;
use crate::design::shape::Shape;
use crate::error::{BadInput, Error};
use crate::numerics::grid_convergence::{error_at, Point};
use crate::sph::Sweeps;
use std::time::Instant;

/// The condition that a check changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Check {
    AsOptimised,
    /// Half of `resolution.dx`; in three dimensions, where that is 16 times the work, the largest fit up to 4/5 of it.
    FinerSpacing,
    /// Fixed particles instead of moving ones, or the reverse.
    OtherMotion,
    /// Twice the end time, with a window of the same length at the end.
    TwiceTime,
    /// The next `run.seed`, with moving particles; fixed ones use no random numbers.
    OtherSeed,
}

impl Check {
    pub const EACH: [Self; 5] =
        [Self::AsOptimised, Self::FinerSpacing, Self::OtherMotion, Self::TwiceTime, Self::OtherSeed];

    /// Whether the check applies to a scene: in three dimensions moving particles are not compared with fixed ones, which were not asked
    /// for; a steady flow that is found at once has no time; a custom scene without random numbers does not depend on the seed.
    fn is_for(self, config: &Config) -> bool {
        match self {
            // In three dimensions particles that move take hours.
            Self::OtherMotion if config.is_around_bodies() => false,
            Self::OtherMotion if config.is_around_shapes() => config.unsteady().is_none() && config.counterpart_moves(),
            Self::OtherMotion => config.scene.has_design() && (config.dimension() == 2 || config.is_over_relief()),
            Self::TwiceTime if config.is_around_shapes() => config.unsteady().is_some(),
            Self::TwiceTime => config.optimise.gradient != GradientMode::Steady,
            Self::OtherSeed if config.is_around_shapes() => false,
            Self::OtherSeed => config.scene.has_design() || config.time.jitter > 0.0,
            _ => true,
        }
    }
}

/// A configuration and the walls that are compared.
#[derive(Debug, Clone)]
pub struct Verification {
    /// The configuration with which the best wall was found.
    pub loaded: Loaded,
    pub reference: Shape,
    pub best: Shape,
    /// The reference in words, such as `the flat wall`.
    pub reference_name: &'static str,
    /// Whether checks that take minutes are left out.
    pub quick: bool,
}

#[derive(Debug, Clone, PartialEq)]
pub struct Verified {
    pub figure: Figure,
    /// The spacing of [`Check::FinerSpacing`] in that of the search.
    pub finer: f64,
    /// The order at which figures converge with the spacing.
    pub order: f64,
    /// Whether the search's particles move.
    pub moves: bool,
    /// The least error of the gain, in the gain and as it is.
    pub least: [f64; 2],
    pub reference_name: &'static str,
    pub checks: Vec<Finding>,
    pub seconds: f64,
}

/// What a check found.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    pub kind: Check,
    pub check: String,
    /// The figures of the reference and of the best wall, or the error.
    pub figures: Result<(f64, f64), String>,
    /// Whether the figure was to become smaller.
    pub smaller: bool,
}

impl Finding {
    /// The change from reference to best over the reference, positive where it is better; none if the check failed.
    pub fn gain(&self) -> Option<f64> {
        let sign = if self.smaller { -1.0 } else { 1.0 };
        self.figures.as_ref().ok().map(|(reference, best)| sign * relative_change(*reference, *best))
    }

    fn reference(&self) -> Option<f64> {
        self.figures.as_ref().ok().map(|(reference, _)| *reference)
    }

    fn best(&self) -> Option<f64> {
        self.figures.as_ref().ok().map(|(_, best)| *best)
    }
}

/// How much of the relative change of one wall's figure with the spacing counts where the other's changes less: it may do so by chance.
const ALIKE: f64 = 0.5;
/// The least error of a gain, in the gain: that it hardly changes with the spacing may be chance.
const LEAST: f64 = 0.1;
/// The same where the error at the ends of the hot section is known.
const LEAST_BETWEEN: f64 = 0.06;
/// The same of steady flows of fixed particles around shapes in the plane. (In 18 searches at random, for the drag or the heat of an ellipse or a spline
/// in a channel, 17 gains of 2 to 32 % are within 0.6 % of those of finite elements, and one, which the finer spacing changes by a fifth, is 3 % off:
/// `scripts/random_bodies.py gain`.)
const LEAST_AROUND: f64 = 0.02;
/// The error of heat by the slope of the wall at each end of the hot section, which other spacings do not show, where it rises towards the hot
/// section and where it falls. (Kinks a spacing or two beside the edge of a hot wall move the place where it acts: `scripts/peers/hot_edge.py`. Chosen
/// beside the 51 walls of data/reference, all of whose gains from dx = 0.02 and 0.01 are then inside.)
const RISING: f64 = 0.9e-3;
const FALLING: f64 = 2.2e-3;
/// The distance from the steady state in the change over twice the time, as if half of that distance were left then.
const LATER: f64 = 2.0;
/// The order of gains over walls of a channel, whose kinks lie between particles in another way at each spacing, so that changes are not smooth. (With
/// the second order half of the true errors of the 51 walls of data/reference are larger than those that it finds, with the first, and a tenth of the gain at least, a twenty-fifth.)
const ORDER_OF_WALLS: f64 = 1.0;

impl Verified {
    /// A figure of the checks that ran.
    fn of(&self, check: Check, value: &dyn Fn(&Finding) -> Option<f64>) -> Option<f64> {
        self.checks.iter().find(|finding| finding.kind == check).and_then(value)
    }

    /// The gain at the finest spacing that was tried, which is nearest to the truth; none if the checks failed.
    pub fn gain(&self) -> Option<f64> {
        self.of(Check::FinerSpacing, &Finding::gain).or_else(|| self.of(Check::AsOptimised, &Finding::gain))
    }

    /// Whether the gain is that of a finer spacing than the search's.
    pub fn is_finer(&self) -> bool {
        self.of(Check::FinerSpacing, &Finding::gain).is_some()
    }

    /// The changes from the spacing of the search to the finer one: of the gain, and relative ones of the figures of both walls.
    fn changes(&self) -> Option<[f64; 3]> {
        let both = |value: &dyn Fn(&Finding) -> Option<f64>| {
            Some((self.of(Check::AsOptimised, value)?, self.of(Check::FinerSpacing, value)?))
        };
        let relative = |(here, finer): (f64, f64)| (here / finer - 1.0).abs();
        let (here, finer) = both(&Finding::gain)?;
        Some([(here - finer).abs(), relative(both(&Finding::reference)?), relative(both(&Finding::best)?)])
    }

    /// The error that is left at the finer spacing, over the change to it.
    fn left(&self) -> Option<f64> {
        let point = |spacing, value| Point { spacing, value };
        error_at(point(self.finer, 0.0), &[point(1.0, 1.0)], self.order)
    }

    /// The parts of the error of a number that each check has, given that by the spacing.
    fn parts(&self, discretisation: Option<f64>, value: &dyn Fn(&Finding) -> Option<f64>) -> Option<Parts> {
        let here = self.of(Check::AsOptimised, value)?;
        let other = self.of(Check::OtherMotion, value);
        let longer = self.of(Check::TwiceTime, value);
        // Another seed is one of moving particles.
        let sampled = if self.moves { Some(here) } else { other };
        let seed = self.of(Check::OtherSeed, value).zip(sampled);
        Some(Parts {
            discretisation: discretisation.or_else(|| other.map(|other| (other - here).abs()))?,
            iteration: longer.map_or(0.0, |longer| LATER * (longer - here).abs()),
            sampling: seed.map_or(0.0, |(one, other)| (one - other).abs()),
        })
    }

    /// The error of the gain.
    ///
    /// * By the spacing: what is left at the finer one, from the change of the gain ([`error_at`]), and no less than a tenth of it.
    ///   Errors that both walls have cancel. Without a finer spacing, the difference from particles of the other kind. Of heat from one wall by
    ///   fixed particles a part is known (`RISING`, `FALLING`), and the least error is that, or `LEAST_BETWEEN` of the gain.
    /// * By the distance from the steady state: twice the change over twice the time.
    /// * By the sampling: the change with another seed, of moving particles.
    ///
    /// None if neither a finer spacing nor other particles were tried.
    pub fn error(&self) -> Option<Parts> {
        let change = self.changes().map(|[gain, ..]| gain);
        let error = change.zip(self.left()).zip(self.gain());
        let [share, least] = self.least;
        let by_spacing = |((change, left), gain): ((f64, f64), f64)| (left * change).max(share * gain.abs()).max(least);
        self.parts(error.map(by_spacing), &Finding::gain)
    }

    /// The best wall's figure as optimised.
    pub fn best(&self) -> Option<f64> {
        self.of(Check::AsOptimised, &Finding::best)
    }

    /// The error of the best wall's figure as optimised, with the same parts: by the spacing the change to the finer one, or half of the
    /// reference's if that is more, and what is left there.
    pub fn error_of_best(&self) -> Option<Parts> {
        let change = self.changes().map(|[_, reference, best]| best.max(ALIKE * reference));
        let error = change.zip(self.left()).zip(self.best());
        self.parts(error.map(|((change, left), best)| (1.0 + left) * change * best.abs()), &Finding::best)
    }

    /// The gain less its error; none if one of them is not known.
    pub fn survives(&self) -> Option<f64> {
        Some(self.gain()? - self.error()?.total())
    }

    /// Whether the gain is larger than its error.
    pub fn is_proved(&self) -> bool {
        self.survives().is_some_and(|gain| gain > 0.0)
    }

    /// The results as in `summary.json` and `verification.json`.
    pub fn record(&self) -> Record {
        let name = self.figure.symbol.to_lowercase();
        let of = |finding: &Finding| {
            let figures = finding.figures.as_ref().ok();
            let mut row = Record::default();
            row.put("check", &finding.check);
            row.put(&format!("{name}_reference"), figures.map(|(reference, _)| reference));
            row.put(&format!("{name}_best"), figures.map(|(_, best)| best));
            row.put("gain", finding.gain());
            row.put("error", finding.figures.as_ref().err());
            row
        };
        let mut record = Record::default();
        record.put("verification", self.checks.iter().map(of).collect::<Vec<_>>());
        record.put("verification_reference", self.reference_name);
        record.put("verification_seconds", self.seconds);
        let error = self.error();
        record.put("gain", self.gain());
        record.put("gain_error", error.map(|parts| parts.total()));
        record.put("gain_error_parts", error);
        record.put("gain_survives", self.survives());
        record.put("proved", self.is_proved());
        let of_best = self.error_of_best();
        record.put(&format!("{name}_error"), of_best.map(|parts| parts.total()));
        record.put(&format!("{name}_error_parts"), of_best);
        record
    }

    pub fn failed(&self) -> impl Iterator<Item = &Finding> {
        self.checks.iter().filter(|finding| finding.figures.is_err())
    }
}

/// The configurations of a check, with the reference and with the best wall.
pub type Pair = [Loaded; 2];

impl Verification {
    /// The checks of a best wall against the first one of its search, or else against the flat wall, with the particles
    /// of the configuration's search.
    pub fn of_search(loaded: &Loaded, first: Option<Shape>, best: Shape) -> Result<Self, Error> {
        let (reference, reference_name) = match first {
            Some(first) => (first, "the first design"),
            None => (best.flat(), "the flat wall"),
        };
        Ok(Self { loaded: loaded.for_search()?, reference, best, reference_name, quick: false })
    }

    /// Runs both walls under every check. `progress` is called with the completed fraction of the work. A check that
    /// cannot run is a result too.
    pub fn run(&self, progress: &mut dyn FnMut(f64)) -> Result<Verified, Error> {
        let clock = Instant::now();
        // A wall that is not allowed fails here and is not a result.
        for wall in [&self.reference, &self.best] {
            self.loaded.with(&wall_settings(wall, &self.loaded.config))?;
        }
        let checks = Check::EACH.into_iter().filter(|check| check.is_for(&self.loaded.config));
        let checks = checks.filter(|check| !self.quick || *check != Check::OtherMotion);
        let pairs: Vec<(Check, Result<Pair, Error>)> = checks.map(|check| (check, self.pair(check))).collect();
        let work = |pair: &Result<Pair, Error>| pair.as_ref().map_or(0.0, |[one, _]| work(one));
        let total: f64 = pairs.iter().map(|(_, pair)| work(pair)).sum();
        let mut done = 0.0;
        let mut checks = Vec::new();
        for (check, pair) in pairs {
            let share = work(&pair) / total;
            let mut name = self.describe(check);
            let mut progress = |part: f64| progress((done + part * share).min(1.0));
            let found = pair.map_err(anyhow::Error::from).and_then(|pair| match figures(&pair, &mut progress) {
                // Rough walls may need shorter steps, which the check does not concern.
                Err(error) if error.is::<RunError>() => match slower(&pair).map(|pair| figures(&pair, &mut progress)) {
                    Ok(Ok(found)) => {
                        name.push_str(", half the time step");
                        Ok(found)
                    }
                    _ => Err(error),
                },
                found => found,
            });
            done += share;
            let smaller = self.loaded.config.objective.goal == Goal::Smaller;
            checks.push(Finding { kind: check, check: name, figures: found.map_err(|e| e.to_string()), smaller });
        }
        let figure = Figure::of_config(&self.loaded.config);
        let config = &self.loaded.config;
        Ok(Verified {
            figure,
            finer: config.finer_spacing() / config.resolution.dx,
            order: if config.scene.has_design() { ORDER_OF_WALLS } else { order(config, "objective") },
            moves: config.method.facts().moves,
            least: self.least(),
            reference_name: self.reference_name,
            checks,
            seconds: clock.elapsed().as_secs_f64(),
        })
    }

    /// The least error of the gain, in the gain and as it is.
    pub fn least(&self) -> [f64; 2] {
        let config = &self.loaded.config;
        let is_known = config.scene == Family::HeatedChannel
            && !config.method.facts().moves
            && config.design.walls == DesignWalls::Bottom
            && config.fluid.drive == DriveName::BodyForce
            && config.objective.kind == ObjectiveKind::HeatOutflow;
        if !is_known {
            let is_around = config.is_around_shapes() && config.dimension() == 2 && config.unsteady().is_none();
            return [if is_around { LEAST_AROUND } else { LEAST }, 0.0];
        }
        let quarter = 0.25 * config.resolution.dx;
        let slope = |wall: &Shape, x: f64| (wall.surface(x + quarter) - wall.surface(x - quarter)) / (2.0 * quarter);
        // `towards`: 1 where the hot section has the larger x, else -1.
        let of_end = |(x, towards): (f64, f64)| {
            let [best, reference] = [&self.best, &self.reference].map(|wall| towards * slope(wall, x));
            let factor = if best.min(reference) < 0.0 { FALLING } else { RISING };
            factor * (best - reference).abs()
        };
        let ends = [(config.channel.hot_from, 1.0), (config.channel.hot_to, -1.0)];
        [LEAST_BETWEEN, ends.into_iter().map(of_end).sum()]
    }

    pub fn pair(&self, check: Check) -> Result<Pair, Error> {
        let settings = self.settings(check)?;
        let wall = |wall: &Shape| wall_settings(wall, &self.loaded.config);
        let with = |shape: &Shape| self.loaded.with(&[&settings[..], &wall(shape)].concat());
        Ok([with(&self.reference)?, with(&self.best)?])
    }

    fn settings(&self, check: Check) -> Result<Vec<Setting>, Error> {
        let before = &self.loaded.config;
        let mut after = before.clone();
        let mut settings = Vec::new();
        let mut set = |key: &str, value: &dyn std::fmt::Display| settings.push(Setting::set(&format!("{key}={value}")));
        match check {
            Check::AsOptimised => return Ok(settings),
            Check::FinerSpacing => {
                let dx = before.finer_spacing();
                after.resolution.dx = dx;
                before.spacings_at(dx).for_each(|(key, spacing)| set(key, &spacing));
                // Walls of cells must be as deep as the bound.
                let rows = (before.design.bound / dx - 1e-9).ceil().max(0.0) as usize;
                if before.method.facts().wall_cells && rows > before.channel.wall_rows {
                    set("channel.wall_rows", &rows);
                }
            }
            Check::OtherMotion => {
                let Some(other) = before.method.facts().counterpart else {
                    let problem = format!("the {} method has moving particles only", before.method.name());
                    return Err(BadInput::new(problem).advice("method.name=consistent").into());
                };
                after.method = Method::named(other).unwrap_or_default();
                set("method.name", &other);
            }
            Check::TwiceTime => after.time.end = 2.0 * before.duration(),
            Check::OtherSeed => {
                set("run.seed", &next_seed(before.run.seed));
                if let Some(other) = before.method.facts().counterpart.filter(|_| !before.method.facts().moves) {
                    after.method = Method::named(other).unwrap_or_default();
                    set("method.name", &other);
                }
            }
        }
        // Moving particles have no steady gradient. (No gradient is taken here, but the key must be valid.)
        let moves = after.method.facts().moves;
        if moves && before.optimise.gradient == GradientMode::Steady {
            set("optimise.gradient", &"segments");
        }
        // The loader sets the time step of each method. For the samples the longer one suffices.
        if moves {
            after.time.cfl = after.time.cfl.max(Config::default().time.cfl);
        }
        // A number of steps would be another time with another time step.
        if check == Check::TwiceTime || before.time.steps.is_some() {
            if check != Check::TwiceTime {
                after.time.end = before.duration();
            }
            after.time.steps = None;
            set("time.end", &after.time.end);
        }
        // A window of the same length may have another number of steps, which limits the number of samples.
        let window = before.objective.window;
        let steps = (window / after.time_step() - 1e-9).ceil().max(1.0) as usize;
        if window > 0.0 && before.objective.periods.is_none() {
            set("objective.window", &window);
            set("objective.samples", &before.objective.samples.min(steps));
        }
        Ok(settings)
    }

    pub fn describe(&self, check: Check) -> String {
        let config = &self.loaded.config;
        match check {
            Check::AsOptimised if config.is_around_shapes() => "particles placed anew".into(),
            Check::AsOptimised => "as optimised".into(),
            Check::FinerSpacing => match config.dimension() {
                2 => format!("half the spacing ({})", rounded(config.finer_spacing())),
                _ => format!("a finer spacing ({})", rounded(config.finer_spacing())),
            },
            Check::OtherMotion => {
                if config.method.facts().moves { "fixed particles" } else { "moving particles" }.into()
            }
            Check::TwiceTime => format!("twice the time ({})", rounded(2.0 * config.duration())),
            Check::OtherSeed => match config.method.facts().moves {
                true => format!("another seed ({})", next_seed(config.run.seed)),
                false => format!("moving particles, another seed ({})", next_seed(config.run.seed)),
            },
        }
    }
}

/// The next seed that TOML can represent.
fn next_seed(seed: u64) -> u64 {
    if seed < i64::MAX as u64 {
        seed + 1
    } else {
        0
    }
}

/// A length or a time without digits that are rounding.
fn rounded(x: f64) -> String {
    let text = format!("{x:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_string()
}

/// The settings of a wall, or of shapes.
pub fn wall_settings(wall: &Shape, config: &Config) -> Vec<Setting> {
    if config.scene == Family::Custom {
        let changed = config.with_shape_values(&wall.offsets);
        let shapes = values(&changed).into_iter().filter(|(path, _)| path == "shapes");
        return shapes.map(|(path, value)| Setting::set(&format!("{path}={value}"))).collect();
    }
    if let Some(across) = &wall.across {
        let points = SplineSurface::of_config(config, &[]).fitted(&wall.nodes, across, &wall.offsets);
        return vec![Setting::set(&format!("design.offsets={points:?}"))];
    }
    let mut settings = at_nodes(wall).to_vec();
    settings.push("design.parametrisation=nodes".to_string());
    if wall.top.is_some() || config.design.walls == DesignWalls::Both {
        // A wall without a top has a flat one, also where the scene's is shaped.
        settings.push(format!("design.top_offsets={:?}", wall.top_wall().offsets));
        settings.push("design.walls=both".to_string());
    }
    settings.iter().map(|text| Setting::set(text)).collect()
}

/// The heights of a wall at its nodes.
fn at_nodes(wall: &Shape) -> [String; 2] {
    [format!("design.nodes={:?}", wall.nodes), format!("design.offsets={:?}", wall.offsets)]
}

/// A scene whose wall stays the same at another spacing, which would have other nodes.
///
/// # Errors
/// A wall that cannot be read.
pub fn with_its_wall(loaded: &Loaded) -> Result<Loaded, BadInput> {
    if loaded.config.scene != Family::HeatedChannel {
        return Ok(loaded.clone());
    }
    let wall = Shape::from_config(&loaded.config)?;
    if wall.offsets.iter().chain(wall.top.iter().flatten()).all(|&offset| offset == 0.0) {
        return Ok(loaded.clone());
    }
    let mut settings = at_nodes(&wall).to_vec();
    settings.extend(wall.top.map(|top| format!("design.top_offsets={top:?}")));
    loaded.with(&settings.iter().map(|text| Setting::set(text)).collect::<Vec<_>>())
}

/// The cost of a run: particles times steps.
fn work(loaded: &Loaded) -> f64 {
    let config = &loaded.config;
    if config.scene == Family::Custom {
        let region = &config.region;
        return region.size.iter().map(|size| size / config.resolution.dx).product::<f64>() * config.steps() as f64;
    }
    (config.columns() * (config.rows() + 2 * config.channel.wall_rows) * config.layers() * config.steps()) as f64
}

fn slower(pair: &Pair) -> Result<Pair, Error> {
    let half = |loaded: &Loaded| {
        let time = &loaded.config.time;
        let halves = [("time.cfl", time.cfl), ("time.diffusion_number", time.diffusion_number)];
        let halves = halves.map(|(key, value)| Setting::set(&format!("{key}={}", 0.5 * value)));
        loaded.with(&halves.into_iter().chain(loaded.same_time()).collect::<Vec<_>>())
    };
    Ok([half(&pair[0])?, half(&pair[1])?])
}

fn figures(pair: &Pair, progress: &mut dyn FnMut(f64)) -> anyhow::Result<(f64, f64)> {
    let mut half = |loaded: &Loaded, first: f64| {
        let progress: &mut dyn FnMut(f64) = &mut |part| progress(first + 0.5 * part);
        match loaded.config.run.precision {
            Precision::F32 => figure::<f32>(loaded, progress),
            Precision::F64 => figure::<f64>(loaded, progress),
        }
    };
    let (reference, best) = (half(&pair[0], 0.0)?, half(&pair[1], 0.5)?);
    if !(reference != 0.0 && reference.is_finite() && best.is_finite()) {
        anyhow::bail!("the figures are {reference} and {best}: there is no gain over these");
    }
    Ok((reference, best))
}

fn figure<R: Sweeps>(loaded: &Loaded, progress: &mut dyn FnMut(f64)) -> anyhow::Result<f64> {
    if loaded.config.is_around_shapes() {
        let mut around = <dyn Designed>::of_config(&loaded.config)?;
        let first = around.first();
        return Ok(around.value(&first, progress)?);
    }
    let design = Scene::<R>::problem(&loaded.config)?;
    let problem = design
        .ok_or_else(|| Error::run("a scene without a design has no wall to verify", "the scene heated-channel"))?;
    if problem.is_steady {
        return Ok(problem.value(&problem.first)?.figure);
    }
    Ok(problem.evaluate_watched(&problem.first, progress)? * problem.figure.factor)
}
