//! The shape of the hot wall: a function of x that does not depend on the resolution.
//!
//! ```text
//!            0                                       x <= hot_from or x >= hot_to
//!   y(x) =   o_0                                     hot_from < x <= x_0
//!            o_i + (o_{i+1} - o_i) (x - x_i) / (x_{i+1} - x_i)    x_i <= x <= x_{i+1}
//!            o_last                                  x_last <= x < hot_to
//! ```

use std::path::Path;

use crate::config::scene::Config;
use crate::error::BadInput;

/// Largest slope between nodes. The walls of adjacent columns, one spacing apart, then differ by at most two spacings,
/// so that their three rows of dummy particles overlap.
pub const MAX_SLOPE: f64 = 2.0;

/// Ends of the hot section within this distance of a column's edge, in spacings, count as on the edge.
const EDGE: f64 = 1e-9;

/// Wall height above y = 0 at nodes, linear between them; zero outside `hot_from < x < hot_to`.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// x of the nodes, strictly increasing, in `hot_from ..= hot_to`.
    pub nodes: Vec<f64>,
    /// z of the nodes of a wall over x and z, which is given at points in any order, without interpolation.
    pub across: Option<Vec<f64>>,
    /// Heights of the nodes; positive ones narrow the channel.
    pub offsets: Vec<f64>,
    /// Depths of the top wall below y = H, if it is shaped too; positive ones narrow the channel.
    pub top: Option<Vec<f64>>,
    pub hot_from: f64,
    pub hot_to: f64,
}

/// Walls whose slope changes by more than this over a spacing are rough. (Of 19 walls and multiples of them the runs over those with at most
/// 2.0 went well, and those with 2.4 and more diverged: `python3 scripts/figures.py rough`.)
pub const ROUGH: f64 = 2.2;
/// The smoothing length in spacings with which moving particles stay between rough walls.
pub const ROUGH_SMOOTHING_LENGTH: f64 = 1.1;

impl Shape {
    /// The numbers of shapes in the place of offsets; their positions are 0, 1, 2, ..., because numbers have none.
    pub fn of_numbers(offsets: Vec<f64>) -> Self {
        let nodes = (0..offsets.len()).map(|k| k as f64).collect();
        Self { nodes, across: None, offsets, top: None, hot_from: 0.0, hot_to: 0.0 }
    }

    /// A checked shape.
    ///
    /// Errors: numbers that are not finite, lengths that differ, no node, nodes out of order or outside the hot
    /// section, neighbours steeper than [`MAX_SLOPE`].
    pub fn new(nodes: Vec<f64>, offsets: Vec<f64>, hot_from: f64, hot_to: f64) -> Result<Self, BadInput> {
        Self::of("design.offsets", nodes, offsets, hot_from, hot_to)
    }

    /// [`Self::new`] with the offsets of the configuration key `key`.
    fn of(key: &str, nodes: Vec<f64>, offsets: Vec<f64>, hot_from: f64, hot_to: f64) -> Result<Self, BadInput> {
        finite("design.nodes", &nodes)?;
        finite(key, &offsets)?;
        if nodes.is_empty() {
            let bad = BadInput::new("design.nodes is empty").key("design.nodes");
            return Err(bad.allowed("at least one node"));
        }
        if nodes.len() != offsets.len() {
            let problem = format!("{key} has {} numbers for {} nodes", offsets.len(), nodes.len());
            return Err(BadInput::new(problem)
                .key(key)
                .allowed(format!("{} offsets, one per node (default: a node per spacing)", nodes.len()))
                .advice("give design.nodes with the positions that these offsets belong to"));
        }
        for (i, x) in nodes.iter().enumerate() {
            if !(hot_from..=hot_to).contains(x) {
                return Err(BadInput::new(format!("design.nodes[{i}] = {x} is outside the hot section"))
                    .key("design.nodes")
                    .allowed(format!("{hot_from} ... {hot_to} (channel.hot_from ... channel.hot_to)")));
            }
        }
        for (i, pair) in nodes.windows(2).enumerate() {
            if pair[1] <= pair[0] {
                let problem = format!("design.nodes[{}] = {} follows {}", i + 1, pair[1], pair[0]);
                return Err(BadInput::new(problem).key("design.nodes").allowed("increasing positions"));
            }
            let limit = MAX_SLOPE * (pair[1] - pair[0]);
            let step = offsets[i + 1] - offsets[i];
            if step.abs() > limit * (1.0 + 1e-9) {
                return Err(BadInput::new(format!(
                    "{key} is too steep between [{i}] and [{}]: {} to {} over {:.6}",
                    i + 1,
                    offsets[i],
                    offsets[i + 1],
                    pair[1] - pair[0]
                ))
                .key(key)
                .allowed(format!("a step of at most {limit:.6}, twice the distance of the nodes"))
                .advice("a smoother shape, or a smaller design.amplitude or design.periods"));
            }
        }
        Ok(Self { nodes, across: None, offsets, top: None, hot_from, hot_to })
    }

    /// Adds a top wall, with the same checks.
    pub fn with_top(self, top: Option<Vec<f64>>) -> Result<Self, BadInput> {
        let Some(offsets) = top else { return Ok(self) };
        let top = Self::of("design.top_offsets", self.nodes.clone(), offsets, self.hot_from, self.hot_to)?;
        Ok(Self { top: Some(top.offsets), ..self })
    }

    /// The top wall as a shape, whose heights are depths below y = H.
    pub fn top_wall(&self) -> Self {
        let offsets = self.top.clone().unwrap_or_else(|| vec![0.0; self.nodes.len()]);
        Self { offsets, top: None, ..self.clone() }
    }

    /// The name of the heights' column in files.
    pub fn column(&self) -> &'static str {
        if self.across.is_some() { SURFACE } else { PROFILE }.1
    }

    /// The same shape without heights.
    pub fn flat(&self) -> Self {
        let top = self.top.as_ref().map(|top| vec![0.0; top.len()]);
        Self { offsets: vec![0.0; self.nodes.len()], top, ..self.clone() }
    }

    /// Checks |offset| <= bound.
    pub fn check_bound(&self, bound: f64) -> Result<(), BadInput> {
        let top = self.top.as_deref().unwrap_or_default();
        for (key, offsets) in [("design.offsets", self.offsets.as_slice()), ("design.top_offsets", top)] {
            if let Some(i) = offsets.iter().position(|o| o.abs() > bound * (1.0 + 1e-12)) {
                return Err(BadInput::new(format!("{key}[{i}] = {} is out of bounds", offsets[i]))
                    .key(key)
                    .allowed(format!("-{bound} ... {bound} (design.bound)"))
                    .advice("a smaller design.amplitude, or a larger design.bound"));
            }
        }
        Ok(())
    }

    /// Wall height at x (length units).
    pub fn height(&self, x: f64) -> f64 {
        if x <= self.hot_from || x >= self.hot_to {
            return 0.0;
        }
        self.between_nodes(x)
    }

    /// The height at x by the nodes beside it, or by the one if x is before or behind all.
    fn between_nodes(&self, x: f64) -> f64 {
        let last = self.nodes.len() - 1;
        match self.nodes.partition_point(|node| *node <= x) {
            0 => self.offsets[0],
            right if right > last => self.offsets[last],
            right => {
                let (a, b) = (self.nodes[right - 1], self.nodes[right]);
                let fraction = (x - a) / (b - a);
                self.offsets[right - 1] * (1.0 - fraction) + self.offsets[right] * fraction
            }
        }
    }

    /// The height of a wall without steps. It equals [`Self::height`], but rises from 0 before the hot section, over
    /// the same distance as from its beginning to the first node (at least half the distance of two nodes), and falls
    /// in the same way behind it. The area is the same.
    pub fn surface(&self, x: f64) -> f64 {
        let last = self.nodes.len() - 1;
        let half = |a: usize, b: usize| 0.5 * (self.nodes[b] - self.nodes[a]);
        let (first_gap, last_gap) = (self.nodes[0] - self.hot_from, self.hot_to - self.nodes[last]);
        let (before, behind) = match last {
            0 => (first_gap, last_gap),
            _ => (first_gap.max(half(0, 1)), last_gap.max(half(last - 1, last))),
        };
        let (from, to) = (self.hot_from - before, self.hot_to + behind);
        if x <= from || x >= to {
            0.0
        } else if x < self.nodes[0] {
            self.offsets[0] * (x - from) / (self.nodes[0] - from)
        } else if x > self.nodes[last] {
            self.offsets[last] * (to - x) / (to - self.nodes[last])
        } else {
            self.between_nodes(x)
        }
    }

    /// How much the slope of a wall changes over one spacing, at most: |y(x - dx) - 2 y(x) + y(x + dx)| / dx, at nodes, between them, and at
    /// the ends of the hot section.
    pub fn sharpest_turn(&self, dx: f64) -> f64 {
        let top = self.top.as_ref().map(|_| self.top_wall());
        let turn =
            |wall: &Self, x: f64| (wall.surface(x - dx) - 2.0 * wall.surface(x) + wall.surface(x + dx)).abs() / dx;
        let all: Vec<f64> =
            [self.hot_from].into_iter().chain(self.nodes.iter().copied()).chain([self.hot_to]).collect();
        let between = all.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        let places: Vec<f64> = all.iter().copied().chain(between).collect();
        let walls = std::iter::once(self).chain(&top);
        walls.flat_map(|wall| places.iter().map(move |&x| turn(wall, x))).fold(0.0, f64::max)
    }

    /// For each particle column c, which covers `c dx ..= (c + 1) dx`, the linear map from the offsets to the average
    /// of y(x) over the column as pairs (node, weight). It is exact, see [`HotSection::weights`].
    pub fn column_weights(&self, dx: f64, length: f64) -> Vec<Vec<(usize, f64)>> {
        let section = HotSection { from: self.hot_from, to: self.hot_to, dx, length };
        section.weights(|from, to| self.integrals(from, to, dx))
    }

    /// Integrals over `from ..= to` of the nodes' hat functions, divided by dx.
    fn integrals(&self, from: f64, to: f64, dx: f64) -> Vec<(usize, f64)> {
        let mut weights: Vec<(usize, f64)> = vec![];
        let mut add = |node: usize, weight: f64| match weights.last_mut() {
            _ if weight == 0.0 => {}
            Some((last, sum)) if *last == node => *sum += weight,
            _ => weights.push((node, weight)),
        };
        let last = self.nodes.len() - 1;
        let mut right = self.nodes.partition_point(|node| *node <= from);
        let mut start = from;
        while start < to {
            // The nodes satisfy nodes[right - 1] <= start < nodes[right], where they exist.
            let end = self.nodes.get(right).map_or(to, |node| node.min(to));
            let width = (end - start) / dx;
            if right == 0 || right > last {
                add(right.min(last), width);
            } else {
                let (a, b) = (self.nodes[right - 1], self.nodes[right]);
                let fraction = ((0.5 * (start + end) - a) / (b - a)).clamp(0.0, 1.0);
                add(right - 1, width * (1.0 - fraction));
                add(right, width * fraction);
            }
            start = end;
            right += 1;
        }
        weights
    }
}

/// The hot section `from < x < to` of a wall of some length, and the particle columns over it, each dx wide.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HotSection {
    pub from: f64,
    pub to: f64,
    pub dx: f64,
    pub length: f64,
}

impl HotSection {
    /// The hot section of the bottom wall.
    pub fn of(config: &Config) -> Self {
        let channel = &config.channel;
        Self { from: channel.hot_from, to: channel.hot_to, dx: config.resolution.dx, length: channel.length }
    }

    /// Number of columns over the whole wall.
    pub fn columns(&self) -> usize {
        (self.length / self.dx).round() as usize
    }

    /// For each column, pairs (variable, weight) that give the column average of a wall. The wall is linear in its
    /// variables, zero outside the section, and one if all variables are one. `integrals` gives, for each variable, the
    /// integral of its contribution over `from ..= to`, up to a common factor: a column's weights sum to its hot
    /// fraction. So the fluid's area is the same at every resolution.
    pub fn weights(&self, integrals: impl Fn(f64, f64) -> Vec<(usize, f64)>) -> Vec<Vec<(usize, f64)>> {
        let share = self.share();
        (0..self.columns())
            .map(|column| {
                let Some((from, to)) = self.part(column) else {
                    return vec![];
                };
                let mut weights = integrals(from, to);
                // Rounding of the column edges c dx costs 1e-14 of a narrow column, which would make a uniform shape
                // slightly rough.
                let sum: f64 = weights.iter().map(|(_, weight)| weight).sum();
                weights.iter_mut().for_each(|(_, weight)| *weight *= share[column] / sum);
                weights
            })
            .collect()
    }

    /// The fraction (0 ... 1) of each column's width in the section.
    pub fn share(&self) -> Vec<f64> {
        let dx = self.dx;
        (0..self.columns())
            .map(|column| match self.part(column) {
                // Exactly 1, where (to - from) / dx would be off by rounding.
                Some((from, to)) if from == column as f64 * dx && to == (column + 1) as f64 * dx => 1.0,
                Some((from, to)) => (to - from) / dx,
                None => 0.0,
            })
            .collect()
    }

    /// x of the wall's vertices, two per spacing: 0, dx/2, dx, ...
    pub fn vertices(&self) -> Vec<f64> {
        (0..2 * self.columns()).map(|k| k as f64 * 0.5 * self.length / self.columns() as f64).collect()
    }

    /// x in 0 ... length of points about dx apart with the wall's temperature, evenly from dx/8 inside the hot section
    /// to dx/8 before its end, and of points with a no-flux condition, from 7/8 dx behind its end on.
    pub fn heat_points(&self) -> (Vec<f64>, Vec<f64>) {
        const INSIDE: f64 = 0.125;
        const OUTSIDE: f64 = 0.875;
        let evenly = |from: f64, length: f64| -> Vec<f64> {
            let count = (length / self.dx).round().max(1.0) as usize;
            (0..=count).map(|k| (from + length * k as f64 / count as f64).rem_euclid(self.length)).collect()
        };
        let (from, width) = (self.from + INSIDE * self.dx, self.to - self.from - 2.0 * INSIDE * self.dx);
        let rest = self.length - (self.to - self.from) - 2.0 * OUTSIDE * self.dx;
        let cold = if rest > 0.0 { evenly(self.to + OUTSIDE * self.dx, rest) } else { vec![] };
        (evenly(from, width.max(0.0)), cold)
    }

    /// The part of a column in the section.
    pub fn part(&self, column: usize) -> Option<(f64, f64)> {
        let dx = self.dx;
        let (left, right) = (column as f64 * dx, (column + 1) as f64 * dx);
        let from = if self.from - left > EDGE * dx { self.from } else { left };
        let to = if right - self.to > EDGE * dx { self.to } else { right };
        (to - from > EDGE * dx).then_some((from, to))
    }
}

/// x of the default nodes, one per spacing in the hot section: hot_from + (k + 1/2) dx.
pub fn default_nodes(hot_from: f64, hot_to: f64, dx: f64) -> Vec<f64> {
    // The small term keeps rounding from placing a node on hot_to.
    let count = ((hot_to - hot_from) / dx + 0.5 - 1e-9).floor() as usize;
    (0..count).map(|k| hot_from + (k as f64 + 0.5) * dx).collect()
}

fn finite(key: &str, numbers: &[f64]) -> Result<(), BadInput> {
    match numbers.iter().position(|number| !number.is_finite()) {
        None => Ok(()),
        Some(i) => Err(BadInput::new(format!("{key}[{i}] = {} is not a number to compute with", numbers[i]))
            .key(key)
            .allowed("finite numbers")),
    }
}

/// The name of the column of the top wall in a shape file.
pub const TOP: &str = "top";

/// The columns of a shape file.
#[derive(Debug, Clone, PartialEq)]
pub struct Columns {
    pub nodes: Vec<f64>,
    /// z of each node, for a wall over x and z.
    pub across: Option<Vec<f64>>,
    pub offsets: Vec<f64>,
}

/// Names of the columns of positions and heights, for a wall over x and for one over x and z.
const PROFILE: (&[&str], &str) = (&["x"], "offset");
const SURFACE: (&[&str], &str) = (&["x", "z"], "height");

/// Reads the columns `x` and `offset` of a CSV file with a header line; other columns, empty lines and lines
/// that begin with `#` are skipped.
pub fn read_columns(path: &Path) -> Result<Columns, BadInput> {
    read(path, PROFILE.0, PROFILE.1)
}

/// As [`read_columns`], for a wall over x and z: columns `x`, `z` and `height`.
pub fn read_surface(path: &Path) -> Result<Columns, BadInput> {
    read(path, SURFACE.0, SURFACE.1)
}

/// As [`read_columns`] or [`read_surface`], with the column `name` in place of the heights, such as a run's `first`;
/// none if the file lacks it.
pub fn read_column(path: &Path, name: &str, is_surface: bool) -> Result<Option<Columns>, BadInput> {
    let is_header = |line: &&str| !line.trim().is_empty() && !line.starts_with('#');
    let text = std::fs::read_to_string(path).unwrap_or_default();
    let has_it = text.lines().find(is_header).is_some_and(|line| line.split(',').any(|cell| cell.trim() == name));
    has_it.then(|| read(path, if is_surface { SURFACE } else { PROFILE }.0, name)).transpose()
}

/// Reads the columns of positions and the column `name`.
fn read(path: &Path, places: &[&str], name: &str) -> Result<Columns, BadInput> {
    let form = match places.len() {
        1 => "a CSV file with the header x,offset and one line of two finite numbers per node",
        _ => "a CSV file with the header x,z,height and one line of three finite numbers per point",
    };
    let file = path.display();
    let bad = |line: Option<usize>, problem: String| {
        let place = line.map_or(format!("{file}"), |line| format!("{file}, line {}", line + 1));
        BadInput::new(problem).place(place).allowed(form)
    };
    let text = std::fs::read_to_string(path).map_err(|error| match error.kind() {
        std::io::ErrorKind::NotFound => bad(None, "design.file: no such file".into()),
        _ => bad(None, format!("design.file: can not read: {error}")),
    })?;
    let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#'));
    let cells = |line: &str| -> Vec<String> { line.split(',').map(|cell| cell.trim().to_string()).collect() };
    let (header_line, header) = match lines.next() {
        Some((number, line)) => (number, cells(line)),
        None => return Err(bad(None, "the file is empty".into())),
    };
    let names: Vec<&str> = places.iter().copied().chain([name]).collect();
    let column = |name: &&str| {
        let place = header.iter().position(|cell| cell == name);
        place.ok_or_else(|| bad(Some(header_line), format!("no column `{name}` in `{}`", header.join(","))))
    };
    let wanted = names.iter().map(column).collect::<Result<Vec<usize>, _>>()?;
    let mut columns = vec![vec![]; names.len()];
    for (number, line) in lines {
        let row = cells(line);
        if row.len() != header.len() {
            let problem = format!("`{line}` has {} cells, the header {}", row.len(), header.len());
            return Err(bad(Some(number), problem));
        }
        for ((&index, name), numbers) in wanted.iter().zip(&names).zip(&mut columns) {
            match row[index].parse::<f64>() {
                Ok(value) if value.is_finite() => numbers.push(value),
                _ => return Err(bad(Some(number), format!("{name} is `{}`, not a finite number", row[index]))),
            }
        }
    }
    if columns[0].is_empty() {
        return Err(bad(None, "there are no lines after the header".into()));
    }
    let mut columns = columns.into_iter();
    let mut next = || columns.next().unwrap_or_default();
    let nodes = next();
    let across = (places.len() > 1).then(&mut next);
    Ok(Columns { nodes, across, offsets: next() })
}
