//! The error of each figure of a run: by its spacing, by the distance from the steady state, and by the sampling of moving particles.
//!
//! The part by the spacing follows from the same run at other spacings, as a rule coarser ones ([`crate::numerics::grid_convergence`]).
//! Two runs may agree in one figure by chance, so no figure has less than a third of the relative error that the run's figures have in the
//! middle (`POOLED`; all of it around bodies in three dimensions), no component of a force less than a third of the error of the force as a
//! vector, and none of heat between walls less than the ends of the hot section make (`HOT_ENDS_FIXED`, `HOT_ENDS_MOVING`).
//!
//! The error is meant as one that 19 of 20 true errors do not exceed; `python3 scripts/figures.py errors` compares it with finite
//! elements and exact solutions.

use super::flows::columns_of;
use super::record::Record;
use crate::config::scene::{Config, Family, Method};
use crate::numerics::grid_convergence::{error_at, observed_order, Point, SAFETY, SAFETY_OF_TWO};
use crate::sph::cloud::outline::Outline;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// Figures that have an error; of each shape those of `OF_SHAPES`.
const FIGURES: [&str; 17] = [
    "q",
    "objective",
    "flow_rate",
    "wall_heat_flux",
    "mean_outlet_temperature",
    "mean_temperature",
    "u_max",
    "body_force",
    "pumping_power",
    "heat_outflow",
    "pressure_drop",
    "dissipation",
    "kinetic_energy",
    "largest_velocity",
    "nusselt",
    "heat_of_shapes",
    "wall_flux",
];
const OF_SHAPES: [&str; 3] = ["force", "torque", "heat"];
/// The least relative error of a figure, in the median one of its run, and that of a component of a force, in the error of the force as a vector.
/// (With the half, errors are too large more often than with a third, and no more of them hold.)
const POOLED: f64 = 0.35;
/// The first of these around bodies in three dimensions, where spacings are so coarse that figures agree by chance more often: with
/// `ORDER_AROUND_BODIES` 14 of 16 drags and heats of a cube and of a cylinder of 4 to 6 spacings are as near to finite elements as their errors say, which are
/// 2.8 times the true ones in the middle; with 0.35 and an order of 2 it was 11 of 16. (That was before `SAFETY_OF_TWO`, which is meant for the other two.)
const POOLED_AROUND_BODIES: f64 = 1.0;
/// The relative error of heat that the ends of the hot section make, where the temperature is singular, with ten rows between the walls and 25 spacings
/// along the hot section, and its order. With fixed particles Q over the flat wall is 0.19 and 0.05 % off with ten and twenty rows, over the 51 walls of
/// data/reference 0.15 % in the middle. With moving ones it is up to 0.35 and 0.2 % off at dx = 0.02 and 0.01, in channels of other heights than 0.2.
const HOT_ENDS_FIXED: (f64, f64) = (1.5e-3, ORDER_OF_HEAT);
const HOT_ENDS_MOVING: (f64, f64) = (3.5e-3, 0.8);
/// Relative changes below this are rounding, or the tolerance of an iteration.
pub(super) const ROUNDING: f64 = 1e-7;

/// What the error of a figure consists of. The whole error is their sum.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize, Deserialize)]
pub struct Parts {
    /// By the spacing of particles, with the time step that belongs to it.
    pub discretisation: f64,
    /// By the distance from the steady state.
    pub iteration: f64,
    /// By the sampling of particles that move.
    pub sampling: f64,
}

impl Parts {
    pub fn total(&self) -> f64 {
        self.discretisation + self.iteration + self.sampling
    }

    /// Each part times a factor.
    pub fn times(&self, factor: f64) -> Self {
        Self {
            discretisation: factor * self.discretisation,
            iteration: factor * self.iteration,
            sampling: factor * self.sampling,
        }
    }

    /// The parts that are not zero, in words.
    pub fn told(&self) -> String {
        let of = [("spacing", self.discretisation), ("not yet steady", self.iteration), ("sampling", self.sampling)];
        let number = |x: f64| if x >= 0.01 { format!("{x:.2}") } else { format!("{x:.1e}") };
        let some = of.iter().filter(|(_, part)| *part > 0.0).map(|(name, part)| format!("{name} {}", number(*part)));
        some.collect::<Vec<_>>().join(", ")
    }
}

/// A figure with its error.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct FigureError {
    pub name: String,
    pub value: f64,
    pub error: f64,
    pub parts: Parts,
    /// The order of convergence that the spacings show; none where the figure does not approach a limit from one side.
    pub observed_order: Option<f64>,
}

/// The orders with which figures of fixed particles in the plane converge: heat, which has root singularities where a wall's temperature
/// jumps, and the flow between two walls. (Over the 51 walls of data/reference, from 6 to 12 rows: 1.9 and 2.9. Around shapes the flow's is not
/// as sure.)
const ORDER_OF_HEAT: f64 = 1.8;
const ORDER_OF_FLOW: f64 = 3.0;
/// That of all figures around shapes with corners, which are rounded in proportion to the spacing. (The flow rate past a triangle is 0.45, 0.33,
/// 0.21 and 0.18 % above that of finite elements with dx = 1/40, 1/50, 1/100 and 1/133. With an order of 1 six of 88 true errors around polygons at
/// random are larger than those that are told.)
const ORDER_OF_CORNERS: f64 = 0.75;
/// That of heat around shapes. (From some spacings on it is two, but the changes between two coarse ones say little: of 35 bodies at random with
/// three spacings on a radius 29 true errors are within those by an order of 1.8, and nearly all within those by 1.)
const ORDER_OF_SHAPES_HEAT: f64 = 1.0;
/// That of all figures around bodies in three dimensions.
const ORDER_AROUND_BODIES: f64 = 1.5;

/// Those with which errors from one solution fall around shapes in the plane, which are shares of weighted residuals. (Of 28 channels with smooth
/// bodies at random and 12 with polygons 1.6 to 2.0 and 1.1 to 1.4 in the middle, between 0.025 and 0.015.)
const ORDER_OF_RESIDUALS: f64 = 1.8;
const ORDER_OF_RESIDUALS_AT_CORNERS: f64 = 1.2;

/// Whether a figure is about heat.
fn is_of_heat(config: &Config, figure: &str) -> bool {
    let names = ["heat", "temperature", "nusselt", "wall_flux"];
    let is_objective = ["q", "objective"].contains(&figure);
    names.iter().any(|name| figure.contains(name))
        || is_objective && (config.scene.has_design() || config.initial.temperature.is_some())
}

/// Whether fluid meets a corner of a shape. A shape that is as long as the box is periodic has none along it.
fn has_corners(config: &Config) -> bool {
    let (size, periodic) = (&config.region.size, &config.region.periodic);
    config.shapes.iter().filter_map(|entry| Outline::new(entry, 0.0)).any(|outline| {
        let corners = outline.corners();
        let spans = |d: usize| {
            let of = |pick: fn(f64, f64) -> f64, from: f64| corners.iter().map(|corner| corner[d]).fold(from, pick);
            of(f64::max, f64::MIN) - of(f64::min, f64::MAX) >= size[d]
        };
        let is_in = |corner: &[f64; 2], d: usize| match periodic[d] {
            true => !spans(d),
            false => corner[d] > 0.0 && corner[d] < size[d],
        };
        corners.iter().any(|corner| (0..2).all(|d| is_in(corner, d)))
    })
}

/// The order at which a figure of a configuration converges with the spacing.
pub fn order(config: &Config, figure: &str) -> f64 {
    let facts = config.method.facts();
    match is_of_heat(config, figure) {
        _ if config.knows_its_errors() && has_corners(config) => ORDER_OF_RESIDUALS_AT_CORNERS,
        _ if config.knows_its_errors() => ORDER_OF_RESIDUALS,
        _ if config.is_around_bodies() => ORDER_AROUND_BODIES,
        _ if facts.moves || config.dimension() != 2 => facts.order,
        _ if config.is_around_shapes() && has_corners(config) => ORDER_OF_CORNERS,
        true if config.is_around_shapes() => ORDER_OF_SHAPES_HEAT,
        true => ORDER_OF_HEAT,
        false if config.is_around_shapes() => facts.order,
        false => ORDER_OF_FLOW,
    }
}

/// The least relative error of a figure of heat between two walls in the plane; 0 for others. Three spacings that agree do not show it.
fn of_hot_ends(config: &Config, figure: &str) -> f64 {
    if config.scene != Family::HeatedChannel || !is_of_heat(config, figure) {
        return 0.0;
    }
    let (channel, dx) = (&config.channel, config.resolution.dx);
    let (over_rows, along) = (10.0 * dx / channel.height, 25.0 * dx / (channel.hot_to - channel.hot_from));
    let (least, order, coarse) = match config.method {
        Method::Fixed(_) => (HOT_ENDS_FIXED.0, HOT_ENDS_FIXED.1, along.max(over_rows)),
        Method::Consistent(_) => (HOT_ENDS_MOVING.0, HOT_ENDS_MOVING.1, along),
        Method::Standard(_) => return 0.0,
    };
    least * coarse.powf(order)
}

/// The name and the value of a figure.
type Figure = (String, f64);

/// The figures of a record by name, such as `q` and `shapes[2].force[0]`.
pub fn figures(record: &Record) -> Vec<Figure> {
    fn add(name: &str, value: &Value, to: &mut Vec<Figure>) {
        match value {
            Value::Number(number) => to.extend(number.as_f64().map(|number| (name.to_string(), number))),
            Value::Array(all) => {
                all.iter().enumerate().for_each(|(k, value)| add(&format!("{name}[{k}]"), value, to));
            }
            _ => {}
        }
    }
    let mut found = vec![];
    for name in FIGURES {
        record.0.get(name).into_iter().for_each(|value| add(name, value, &mut found));
    }
    for (k, shape) in record.rows("shapes").into_iter().flatten().enumerate() {
        for name in OF_SHAPES {
            add(&format!("shapes[{k}].{name}"), &shape[name], &mut found);
        }
    }
    found
}

/// The most important figure of a record: the objective where there is one.
pub fn main_figure(record: &Record) -> Option<String> {
    figures(record).into_iter().next().map(|(name, _)| name)
}

/// The multiple of a spacing that is nearest to a length.
pub fn length_in(length: f64, spacing: f64) -> f64 {
    (length / spacing).round() * spacing
}

/// What a figure of a coarser run is multiplied with: a sum over a channel belongs to its length, which is so many spacings in some
/// scenes, and the nearest multiple of the spacing in the heated channel.
fn same_extent(config: &Config, name: &str, spacing: f64) -> f64 {
    let (dx, length) = (config.resolution.dx, config.channel.length);
    match (name, columns_of(config.scene)) {
        ("kinetic_energy", Some(_)) => dx / spacing,
        ("pumping_power", None) if config.scene == Family::HeatedChannel => length / length_in(length, spacing),
        _ => 1.0,
    }
}

/// A run at another spacing.
struct Other<'a> {
    spacing: f64,
    record: &'a Record,
    figures: Vec<Figure>,
}

/// By what sums a figure was told in a run: those of its shape, or of all for the objective.
fn told_by(record: &Record, name: &str) -> Vec<Value> {
    let shapes = record.rows("shapes").into_iter().flatten().enumerate();
    let is_asked = |k: &usize| name == "objective" || name.starts_with(&format!("shapes[{k}]."));
    shapes.filter(|(k, _)| is_asked(k)).map(|(_, shape)| shape["told_by"].clone()).collect()
}

/// Whether no other run tells some figure of a run by the same sums.
pub fn is_told_alone(record: &Record, others: &[(f64, Record)]) -> bool {
    let is_alone = |(name, _): &Figure| {
        let own = told_by(record, name);
        others.iter().all(|(_, other)| told_by(other, name) != own)
    };
    figures(record).iter().any(is_alone)
}

/// The runs at other spacings, where a figure was told by the same sums: around a shape between walls so many coarse spacings may
/// have no room for a closed surface, and what is told otherwise differs by more than the error. All, if it was the same nowhere.
fn comparable<'a>(record: &Record, others: &'a [Other], name: &str) -> Vec<&'a Other<'a>> {
    let own = told_by(record, name);
    let same: Vec<&Other> = others.iter().filter(|one| told_by(one.record, name) == own).collect();
    if same.is_empty() {
        return others.iter().collect();
    }
    same
}

/// The errors of the figures of a run, given the records of the same at other spacings.
pub fn errors(config: &Config, record: &Record, others: &[(f64, Record)]) -> Vec<FigureError> {
    let others: Vec<Other> =
        others.iter().map(|(spacing, record)| Other { spacing: *spacing, record, figures: figures(record) }).collect();
    let mut found = vec![];
    let of_run = figures(record);
    for (name, value) in of_run.clone() {
        let own = Point { spacing: config.resolution.dx, value };
        let alike = comparable(record, &others, &name);
        let factor = if alike.len() < others.len() { SAFETY_OF_TWO / SAFETY } else { 1.0 };
        let points: Vec<Point> = alike
            .iter()
            .filter_map(|one| {
                let (_, value) = one.figures.iter().find(|(other, _)| *other == name)?;
                Some(Point { spacing: one.spacing, value: value * same_extent(config, &name, one.spacing) })
            })
            .collect();
        // A figure that is given, such as the body force, does not change.
        if points.iter().all(|point| (point.value - value).abs() <= ROUNDING * value.abs()) {
            continue;
        }
        let Some(error) = error_at(own, &points, order(config, &name)) else { continue };
        let discretisation = factor * error;
        let parts = Parts { discretisation, ..of_window(config, record, &name, value) };
        found.push(FigureError { observed_order: observed_order(own, &points), error: 0.0, name, value, parts });
    }
    let relative = |one: &FigureError| one.parts.discretisation / one.value.abs();
    // A figure that is zero but for rounding, as the velocity of a slab at rest, has no relative error.
    let mut all: Vec<f64> = found.iter().map(relative).filter(|share| *share < 1.0).collect();
    all.sort_by(f64::total_cmp);
    let pooled = if config.is_around_bodies() { POOLED_AROUND_BODIES } else { POOLED };
    let least = all.get(all.len() / 2).map_or(0.0, |median| pooled * median);
    for one in &mut found {
        let least = least.max(of_hot_ends(config, &one.name));
        let of_force = of_force(config, &of_run, &comparable(record, &others, &one.name), &one.name);
        one.parts.discretisation = one.parts.discretisation.max(least * one.value.abs()).max(of_force);
    }
    // The objective may be one of the other figures.
    if let Some(objective) = found.iter().position(|one| one.name == "objective") {
        let value = found[objective].value.abs();
        let same = found.iter().filter(|one| one.value.abs() == value);
        found[objective].parts.discretisation = same.map(|one| one.parts.discretisation).fold(0.0, f64::max);
    }
    found.iter_mut().for_each(|one| one.error = one.parts.total());
    found
}

/// The least error of a component of a shape's force or of its torque in the plane; 0 for other figures. A component that is small because much
/// cancels in it, as the lift of a body does, is as far off as others are. The torque's is that of the force times the radius of a circle of the
/// shape's area.
fn of_force(config: &Config, own: &[Figure], others: &[&Other], name: &str) -> f64 {
    let Some((shape, figure)) = name.split_once('.') else { return 0.0 };
    let arm = match figure {
        "torque" => radius_of(config, shape).unwrap_or(0.0),
        _ if figure.starts_with("force[") => 1.0,
        _ => return 0.0,
    };
    let force = |of: &[Figure]| -> Vec<f64> {
        let component = |d: usize| of.iter().find(|(other, _)| *other == format!("{shape}.force[{d}]"));
        (0..3).map_while(component).map(|(_, value)| *value).collect()
    };
    let own = force(own);
    let off = |of: &[Figure]| force(of).iter().zip(&own).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
    let points: Vec<Point> =
        others.iter().map(|one| Point { spacing: one.spacing, value: off(&one.figures) }).collect();
    let error = error_at(Point { spacing: config.resolution.dx, value: 0.0 }, &points, order(config, name));
    POOLED * arm * error.unwrap_or(0.0)
}

/// The radius of a circle of the area of a shape, given as `shapes[2]`; none in three dimensions.
fn radius_of(config: &Config, shape: &str) -> Option<f64> {
    let number = shape.strip_prefix("shapes[")?.strip_suffix(']')?.parse::<usize>().ok()?;
    Some(Outline::new(config.shapes.get(number)?, 0.0)?.radius())
}

/// What the averages over the window say of their own error: how far they are from what they go to where the flow is to become steady, and
/// what their samples' scatter makes of the mean.
fn of_window(config: &Config, record: &Record, name: &str, value: f64) -> Parts {
    let unsettled = record.0.get("unsettled").and_then(Value::as_object);
    let is_it = |of: &str| of == name || (name == "objective" && record.number(of) == Some(value));
    let iteration = unsettled.and_then(|all| all.iter().find(|(of, _)| is_it(of))?.1.as_f64());
    let averaged = ["q", "flow_rate"].into_iter().find(|of| is_it(of));
    let sampling = averaged.and_then(|averaged| record.number(&format!("{averaged}_sampling")));
    Parts {
        discretisation: 0.0,
        iteration: iteration.unwrap_or(0.0),
        sampling: if config.method.facts().moves { sampling.unwrap_or(0.0) } else { 0.0 },
    }
}
