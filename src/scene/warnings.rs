//! Warnings about doubtful results of a finished run.
//!
//! They do not stop a run, and use only its measurements and its last state. What can be said of a scene before it runs is
//! in [`super::plausible`].

use super::figures::FlowFigures;
use super::particle_fields::ParticleFields;
use crate::config::scene::{Config, Family};
use crate::config::suggest;
use crate::design::diagnostics::Diagnostics;
use crate::design::optimise::{Epoch, Optimisation};
use crate::design::shape::{Shape, ROUGH};
use crate::particles::tag;
use serde::{Deserialize, Serialize};
use std::collections::HashMap;

#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Warning {
    /// The kind of warning, for programs: `heat-balance`, `not-steady`, ...
    pub code: String,
    /// The number that is doubtful, and the limit that it exceeds (or falls below).
    pub value: Option<f64>,
    pub limit: Option<f64>,
    pub problem: String,
    pub advice: String,
}

/// Largest ratio of the flow's speed to the reference velocity, for which the sound speed allows.
const FASTER: f64 = 1.5;
/// Largest Mach number of a weakly compressible flow, whose density changes by its square.
const MACH: f64 = 0.3;
/// Largest relative deviation of the mean density.
const DENSER: f64 = 0.02;
/// Largest imbalance of heat relative to the walls' heat.
const OPEN: f64 = 0.015;
/// Largest relative change of averages over the window.
const DRIFT: f64 = 0.01;

/// Largest deviation from an exact solution, relative, that is no surprise: built-in scenes with their own settings are
/// within half of it.
const KNOWN: f64 = 0.01;

/// Particles nearer to each other than this, in spacings, are crowded; in reliable runs the smallest distance is 0.6.
const CROWDED: f64 = 0.5;
/// Largest fraction of crowded particles.
const CROWD: f64 = 0.01;
/// Largest change of the objective between the limits by its gradient, relative to the objective.
const EXPLODED: f64 = 10.0;

impl Warning {
    pub fn new(code: &str, [value, limit]: [f64; 2], problem: String, advice: impl Into<String>) -> Self {
        let finite = |x: f64| Some(x).filter(|x| x.is_finite());
        Self { code: code.into(), value: finite(value), limit: finite(limit), problem, advice: advice.into() }
    }
}

/// Warns about a flow that is faster than its reference velocity.
pub fn speed(config: &Config, fastest: f64) -> Option<Warning> {
    let (reference, sound) = (config.fluid.reference_velocity, config.sound_speed());
    let mach = fastest / sound;
    let advice = format!("fluid.reference_velocity={} (the sound speed follows)", suggest::at_least(fastest, fastest));
    if mach > MACH {
        let problem = format!("the flow reaches Mach {mach:.2} ({fastest:.4} of a sound speed of {sound:.4}): it is not weakly compressible");
        return Some(Warning::new("mach-number", [mach, MACH], problem, advice));
    }
    (fastest > FASTER * reference).then(|| {
        let problem = format!(
            "the flow is {:.1} times as fast as fluid.reference_velocity = {reference}: Mach {mach:.2}",
            fastest / reference
        );
        Warning::new("reference-velocity", [fastest / reference, FASTER], problem, advice)
    })
}

/// The warnings of a verification flow or a custom scene; rows of the history are (time, energy, velocity).
pub fn of_flow(config: &Config, found: &FlowFigures, history: &[Vec<f64>]) -> Vec<Warning> {
    let mut all = Vec::new();
    if found.wall_flux.is_none() {
        let fastest = history.iter().filter_map(|row| row.get(2)).fold(found.largest_velocity, |most, u| most.max(*u));
        all.extend(speed(config, fastest));
    }
    all.extend(exact(config, found));
    all
}

/// Warns if a figure deviates from the exact one by more than [`KNOWN`].
fn exact(config: &Config, found: &FlowFigures) -> Option<Warning> {
    let [lower, upper] =
        [0, 1].map(|wall| (found.wall_flux.map(|of| of[wall]), found.exact_wall_flux.map(|of| of[wall])));
    let relative = [
        ("kinetic energy", (Some(found.kinetic_energy), found.exact_kinetic_energy)),
        ("heat flux at the lower wall", lower),
        ("heat flux at the upper wall", upper),
        ("Nusselt number", (found.nusselt, found.exact_nusselt)),
    ];
    // What is exactly 0 has no relative error.
    let known = |exact: &f64| exact.abs() > 1e-9;
    let relative =
        relative.into_iter().filter_map(|(name, (value, exact))| Some((name, value? / exact.filter(known)? - 1.0)));
    let errors = [("velocity", found.velocity_error), ("temperature", found.temperature_error)];
    let errors = errors.into_iter().filter_map(|(name, error)| Some((name, error?)));
    let all = relative.chain(errors);
    let (name, error) = all.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs())).filter(|(_, error)| error.abs() > KNOWN)?;
    let problem = format!(
        "the {name} is {:.1} % off the exact one: with its own settings and times a scene of this kind is within {:.0} %",
        100.0 * error,
        100.0 * KNOWN
    );
    let advice = format!("resolution.dx={:?}, a longer time.end, or run.precision=f64", 0.5 * config.resolution.dx);
    Some(Warning::new("exact-solution", [error, KNOWN], problem, advice))
}

/// The warnings of a channel, or of a search, by what was measured over the objective's window.
pub fn of_measured(config: &Config, found: &Diagnostics) -> Vec<Warning> {
    speed(config, found.u_max).into_iter().chain(of_section(config, found)).chain(rough_wall(config)).collect()
}

/// Over a rough wall moving particles see further than usual, where they are less accurate.
fn rough_wall(config: &Config) -> Option<Warning> {
    let is_longer = config.resolution.smoothing_length > Config::default().resolution.smoothing_length;
    Shape::rough_turn(config).filter(|_| is_longer).map(|turn| {
        let problem = format!(
            "the wall is rough: its slope changes by {turn:.1} over a spacing; particles see {} spacings there, at which Q over such walls \
             is 1 to 3 % off",
            config.resolution.smoothing_length
        );
        Warning::new("rough-wall", [turn, ROUGH], problem, "method.name=fixed, or a gentler wall")
    })
}

/// The warnings about density, balance and drift, but not about the speed, which [`of_flow`] judges.
pub fn of_section(config: &Config, found: &Diagnostics) -> Vec<Warning> {
    let mut all = Vec::new();
    let longer = || format!("time.end={:.3}", 2.0 * config.duration());
    let density = found.mean_density / config.fluid.density - 1.0;
    if density.abs() > DENSER {
        let problem = format!("the mean density is {:+.1} % off fluid.density", 100.0 * density);
        let advice = "a larger fluid.sound_speed_factor, or wall.mass=column-area with the standard method";
        all.push(Warning::new("mean-density", [density, DENSER], problem, advice));
    }
    if found.energy_imbalance.abs() > OPEN && config.heat_passes() {
        let problem = format!(
            "the heat balance is {:+.0} % open: walls give {:.4}, {:.4} flows out, {:+.4} is stored",
            100.0 * found.energy_imbalance,
            found.wall_heat_flux,
            found.q,
            found.stored_heat_rate
        );
        let advice = format!("{}, or a smaller resolution.dx", longer());
        all.push(Warning::new("heat-balance", [found.energy_imbalance, OPEN], problem, advice));
    }
    let steady = if config.settles() { [found.q_drift, found.flow_rate_drift] } else { [None; 2] };
    let names = ["the outflowing heat", "the flow rate"];
    let moved = names.into_iter().zip(steady).filter_map(|(name, drift)| Some((name, drift?)));
    if let Some((name, drift)) =
        moved.filter(|(_, drift)| drift.abs() > DRIFT).reduce(|a, b| if b.1.abs() > a.1.abs() { b } else { a })
    {
        let problem = format!(
            "the flow is not steady: {name} changes by {:+.1} % from the first half of the objective's window to the second",
            100.0 * drift
        );
        let advice = format!("{}, or time.start=developed", longer());
        all.push(Warning::new("not-steady", [drift, DRIFT], problem, advice));
    }
    all
}

/// The warnings about particles: their distribution at the end and their start. A breaking surface is crowded.
pub fn of_particles(config: &Config, end: &ParticleFields) -> Vec<Warning> {
    let mut all = Vec::new();
    let facts = config.method.facts();
    if config.scene == Family::TaylorGreen && facts.lines_up && config.time.jitter == 0.0 {
        all.push(Warning::new(
            "lattice-start",
            [0.0, 0.2],
            "particles began on an exact lattice, in which they line up: at t = 1 the error is five times that of a start with noise".into(),
            "time.jitter=0.2, or method.name=consistent",
        ));
    }
    let share = crowded(end, config.resolution.dx);
    if share > CROWD && !config.scene.has_surface() {
        let problem = format!(
            "{:.0} % of the particles have another one nearer than {CROWDED} spacings: sums over neighbours miss what lies between",
            100.0 * share
        );
        all.push(Warning::new("crowded-particles", [share, CROWD], problem, facts.against_crowds));
    }
    all
}

/// The fraction of fluid particles with another one nearby, except across periodic sides.
fn crowded(end: &ParticleFields, dx: f64) -> f64 {
    let (n, d) = (end.tag.len(), end.dimension);
    let near = CROWDED * dx;
    let place = |i: usize| -> [f64; 3] { std::array::from_fn(|e| if e < d { end.position[e * n + i] } else { 0.0 }) };
    let cell = |p: [f64; 3]| p.map(|x| (x / near).floor() as i64);
    let fluid: Vec<usize> = (0..n).filter(|&i| end.tag[i] == tag::FLUID).collect();
    let mut cells: HashMap<[i64; 3], Vec<usize>> = HashMap::new();
    fluid.iter().for_each(|&i| cells.entry(cell(place(i))).or_default().push(i));
    let has_near = |i: usize| {
        let (p, own) = (place(i), cell(place(i)));
        let steps = (0..27).map(|k| [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1]);
        let around = steps.filter_map(|step| cells.get(&std::array::from_fn(|e| own[e] + step[e]))).flatten();
        let square = |j: usize| place(j).iter().zip(p).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        around.into_iter().any(|&j| j != i && square(j) < near * near)
    };
    fluid.iter().filter(|&&i| has_near(i)).count() as f64 / fluid.len().max(1) as f64
}

/// The warnings of a search with limits `width` apart: no improvement, an objective below zero, and a gradient that has exploded.
pub fn of_search(found: &Optimisation, width: f64) -> Vec<Warning> {
    let mut all = Vec::new();
    let history = &found.history;
    if found.best == 0 && history.len() > 1 {
        all.push(Warning::new(
            "no-improvement",
            [0.0, 0.0],
            format!("in {} epochs nothing was found that is better than the first design", history.len()),
            "another start, or a smaller optimise.learning_rate",
        ));
    }
    if let Some(first) = history.first().map(Epoch::shown).filter(|first| *first < 0.0) {
        all.push(Warning::new(
            "negative-objective",
            [first, 0.0],
            format!("the objective of the first design is {first:.4}: larger is nearer to zero, for heat a wall that takes less from the fluid"),
            "to take more heat, a wall as much warmer than the inlet as it is colder now (wall.hot_temperature): what is best there takes most here",
        ));
    }
    let exploded = |epoch: &Epoch| epoch.gradient_norm * width > EXPLODED * epoch.loss.abs();
    if let Some(epoch) = history.iter().position(|epoch| epoch.loss.is_finite() && exploded(epoch)) {
        let times = history[epoch].gradient_norm * width / history[epoch].loss.abs();
        all.push(Warning::new(
            "exploding-gradient",
            [times, EXPLODED],
            format!(
                "the gradient of epoch {} says that the objective changes by {times:.0e} times itself between the limits: it follows \
                 how particles happen to meet, not the flow",
                epoch + 1
            ),
            "a shorter time.end, a smoother start, optimise.clip=10, or for shapes optimise.gradient=differences",
        ));
    }
    all
}
