//! Wall shapes of a data set of the heated channel: the report's ten functions and two random families.
//!
//! With s = (x - hot_from) / (hot_to - hot_from) and an amplitude A up to `design.bound`. All have |offset| <= bound
//! and a slope between nodes of at most 1 (steeper functions are scaled down).

use super::trajectory::Split;
use crate::config::scene::ShapeName;
use crate::design::start_shape::height;
use crate::error::BadInput;
use crate::numerics::random::{uniform, Normal};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;
use std::path::Path;

/// Largest slope between two nodes, half of that of a design. Moving particles are stable over all of these functions
/// up to it, and unstable over some beyond.
const STEEPEST: f64 = 1.0;
/// Largest slope of walls with independent random nodes. 120 of 120 such walls within 0.03 ran for 147 frames, and 119
/// with a slope of 0.75.
const ROUGHEST: f64 = 0.5;

/// Which walls the trajectories get.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Walls {
    /// A third each of report, columns and smooth, in turns.
    #[default]
    Mix,
    /// The report's ten functions in turns: flat, uniform, four sines, three cosines, linear.
    Report,
    /// Random: every node uniform within the limits.
    Columns,
    /// Random: sums of a few waves.
    Smooth,
    /// The scene's own design: design.shape, design.offsets or design.file.
    Scene,
    /// In turns from a table (--walls-file).
    #[value(skip)]
    File,
}

/// The report's functions, with their numbers of periods.
const REPORT: [(ShapeName, f64); 10] = [
    (ShapeName::Flat, 0.0),
    (ShapeName::Uniform, 0.0),
    (ShapeName::Sine, 0.5),
    (ShapeName::Sine, 1.0),
    (ShapeName::Sine, 2.0),
    (ShapeName::Sine, 4.0),
    (ShapeName::Cosine, 1.0),
    (ShapeName::Cosine, 2.0),
    (ShapeName::Cosine, 3.0),
    (ShapeName::Linear, 0.0),
];

/// Number of waves in a smooth random wall. The k-th has k half periods and a standard deviation of 1/k.
const WAVES: usize = 6;

/// The hot section and the limits of its wall.
#[derive(Debug, Clone, Copy)]
pub struct Section<'a> {
    /// Positions of the nodes, increasing, at least one.
    pub nodes: &'a [f64],
    pub hot_from: f64,
    pub hot_to: f64,
    /// |offset| <= bound.
    pub bound: f64,
}

/// Reads walls, one per line, as offsets separated by commas. The scene checks whether they fit the design.
///
/// # Errors
/// A missing file, no line, or something that is not a number.
pub fn read_walls(path: &Path) -> Result<Vec<Vec<f64>>, BadInput> {
    let bad = |problem: String| {
        BadInput::new(problem)
            .place(path.display().to_string())
            .allowed("a line per wall: its offsets at the nodes, separated by commas, for example 0.0, 0.005, 0.01")
    };
    let text = std::fs::read_to_string(path).map_err(|error| bad(format!("cannot read it: {error}")))?;
    let mut walls = Vec::new();
    for (number, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let offset = |cell: &str| match cell.trim().parse::<f64>() {
            Ok(offset) if offset.is_finite() => Ok(offset),
            _ => Err(bad(format!("line {}: `{}` is not a finite number", number + 1, cell.trim()))),
        };
        walls.push(line.split(',').map(offset).collect::<Result<Vec<_>, _>>()?);
    }
    if walls.is_empty() {
        return Err(bad("there is no wall in it".into()));
    }
    Ok(walls)
}

/// The name of a trajectory's wall and its offsets at the nodes; none for [`Walls::Scene`] and [`Walls::File`].
pub fn wall(
    walls: Walls,
    split: Split,
    index: usize,
    rng: &mut ChaCha8Rng,
    section: Section,
) -> Option<(String, Vec<f64>)> {
    let (family, turn) = match walls {
        Walls::Mix => ([Walls::Report, Walls::Columns, Walls::Smooth][index % 3], index / 3),
        one => (one, index),
    };
    let bound = section.bound;
    match family {
        Walls::Report => {
            let function = REPORT[turn % REPORT.len()];
            // The first ten of the training split are the report's own; others have a random amplitude.
            let share = 0.25 + 0.75 * uniform(rng);
            let sign = if uniform(rng) < 0.5 { -1.0 } else { 1.0 };
            let own = split == Split::Train && turn < REPORT.len();
            let amplitude = if own { bound } else { sign * share * bound };
            Some(section.function(function, amplitude))
        }
        Walls::Columns => Some(("columns".into(), section.columns(rng))),
        Walls::Smooth => {
            let amplitude = (0.2 + 0.8 * uniform(rng)) * bound;
            let mut normal = Normal::new(rng.clone());
            let level = normal.next();
            let waves: Vec<[f64; 2]> =
                (1..=WAVES).map(|k| [normal.next() / k as f64, normal.next() / k as f64]).collect();
            let mut offsets = section.sample(|s| {
                let wave = |(k, [a, b]): (usize, &[f64; 2])| {
                    let (sin, cos) = (PI * (k + 1) as f64 * s).sin_cos();
                    a * sin + b * cos
                };
                level + waves.iter().enumerate().map(wave).sum::<f64>()
            });
            let highest = offsets.iter().fold(0.0_f64, |high, offset| high.max(offset.abs()));
            if highest > 0.0 {
                offsets.iter_mut().for_each(|offset| *offset = (*offset * amplitude / highest).clamp(-bound, bound));
            }
            Some((format!("smooth, amplitude {amplitude:.4}"), section.gentle(offsets)))
        }
        Walls::Mix | Walls::Scene | Walls::File => None,
    }
}

/// The change from a wall to its neighbour in a data set of pairs, within the section's bound: random nodes and random
/// smooth walls in turns.
pub fn neighbour(number: usize, rng: &mut ChaCha8Rng, section: Section) -> Vec<f64> {
    let family = [Walls::Smooth, Walls::Columns][number % 2];
    wall(family, Split::Train, number, rng, section).map_or_else(Vec::new, |(_, change)| change)
}

impl Section<'_> {
    fn sample(&self, f: impl Fn(f64) -> f64) -> Vec<f64> {
        self.nodes.iter().map(|x| f((x - self.hot_from) / (self.hot_to - self.hot_from))).collect()
    }

    fn function(&self, (shape, periods): (ShapeName, f64), amplitude: f64) -> (String, Vec<f64>) {
        let offsets = self.sample(|s| height(shape, amplitude, periods, s));
        let name = match shape {
            ShapeName::Flat | ShapeName::Random => return ("flat".into(), offsets),
            ShapeName::Uniform => "uniform".into(),
            ShapeName::Sine => format!("sine ({periods} periods)"),
            ShapeName::Cosine => format!("cosine ({periods} periods)"),
            ShapeName::Linear => "linear".into(),
        };
        (format!("{name}, amplitude {amplitude:.4}"), self.gentle(offsets))
    }

    /// Scales offsets down until no slope is too large.
    fn gentle(&self, mut offsets: Vec<f64>) -> Vec<f64> {
        let steps = offsets.windows(2).zip(self.nodes.windows(2));
        let steepness = |(o, x): (&[f64], &[f64])| (o[1] - o[0]).abs() / (STEEPEST * (x[1] - x[0]));
        let worst = steps.map(steepness).fold(1.0, f64::max);
        offsets.iter_mut().for_each(|offset| *offset /= worst);
        offsets
    }

    /// Each node is uniform within the bound and the slope from the node before.
    fn columns(&self, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let mut offsets: Vec<f64> = Vec::with_capacity(self.nodes.len());
        for (i, x) in self.nodes.iter().enumerate() {
            let (mut low, mut high) = (-self.bound, self.bound);
            if i > 0 {
                let reach = ROUGHEST * (x - self.nodes[i - 1]);
                low = low.max(offsets[i - 1] - reach);
                high = high.min(offsets[i - 1] + reach);
            }
            offsets.push(low + (high - low) * uniform(rng));
        }
        offsets
    }
}
