//! The map from the heights of a wall over the particle columns to the initial state: positions of wall and fluid
//! particles and their masses.
//!
//! In a column where the wall is raised by s (the average of the wall's height over the column, see
//! [`super::parametrisations`]) the particles stay the same: wall particles move by s, fluid moves to y + s (1 - y/H),
//! and the column's height becomes H - s. With the mass convention `column-area` the mass of a particle is scaled with
//! the column's area, m (1 - s/H), so the density does not change; with `constant` the fluid is compressed or expanded.
//! The map is linear.

use super::relief::Relief;
use super::shapes::Shapes;
use crate::numerics::lanes::Real;

/// The map from heights `[C]` to the initial state `[F, N]`.
#[derive(Debug, Clone)]
pub struct Deformation {
    /// Number of heights, C: of particle columns, of points on the wall's surface, or at the places of a relief.
    pub columns: usize,
    /// State of the undeformed channel, `[F, N]`.
    pub base: Vec<f64>,
    pub particles: usize,
    pub map: Map,
}

/// How the heights move particles.
#[derive(Debug, Clone)]
pub enum Map {
    Columns(Columns),
    /// The bottom wall, followed by the top wall if that is shaped too.
    Surfaces(Vec<Surface>),
    /// The bottom wall as a function of x and z.
    Relief(Relief),
    /// Shapes whose numbers vary. The "heights" are the changes of these numbers.
    Shapes(Shapes),
}

/// The map of the standard method, by columns.
#[derive(Debug, Clone)]
pub struct Columns {
    /// Index of the column of each particle.
    pub column: Vec<u32>,
    /// dy/ds of each particle.
    pub by_height: Vec<f64>,
    /// The mass row of the state and dm/ds of each particle, if masses are scaled.
    pub by_mass: Option<(usize, Vec<f64>)>,
}

impl Deformation {
    /// The initial state with these heights.
    pub fn state<R: Real>(&self, heights: &[f64]) -> Vec<R> {
        let mut state = self.base.clone();
        match &self.map {
            Map::Columns(columns) => columns.deform(self.particles, heights, &mut state),
            Map::Surfaces(walls) => {
                for (surface, heights) in parts(walls, heights) {
                    surface.deform(self.particles, &self.base, heights, &mut state);
                }
            }
            Map::Relief(relief) => relief.deform(self.particles, heights, &mut state),
            Map::Shapes(shapes) => shapes.deform(self.particles, heights, &mut state),
        }
        state.into_iter().map(R::of).collect()
    }

    /// The derivative by the heights, `[C]`, given the cotangent of the initial state. Sums are in f64.
    pub fn pull_back<R: Real>(&self, heights: &[f64], state_bar: &[R]) -> Vec<f64> {
        let mut heights_bar = vec![0.0; self.columns];
        match &self.map {
            Map::Columns(columns) => columns.pull_back(self.particles, state_bar, &mut heights_bar),
            Map::Surfaces(walls) => {
                let mut rest = heights_bar.as_mut_slice();
                for (surface, heights) in parts(walls, heights) {
                    let (own, behind) = rest.split_at_mut(surface.x.len());
                    surface.pull_back(self.particles, &self.base, heights, state_bar, own);
                    rest = behind;
                }
            }
            Map::Relief(relief) => relief.pull_back(self.particles, heights, state_bar, &mut heights_bar),
            Map::Shapes(shapes) => shapes.pull_back(self.particles, &self.base, heights, state_bar, &mut heights_bar),
        }
        heights_bar
    }

    /// Sets those cotangents to zero through which a state during a run does not depend on the design directly. Wall
    /// positions and masses remain (for truncated gradients).
    pub fn keep_static<R: Real>(&self, state_bar: &mut [R], is_fluid: impl Fn(usize) -> bool) {
        let n = self.particles;
        for i in (0..n).filter(|&i| is_fluid(i)) {
            match self.map {
                Map::Columns(_) => state_bar[n + i] = R::default(),
                Map::Surfaces(_) | Map::Relief(_) | Map::Shapes(_) => {
                    state_bar.iter_mut().skip(i).step_by(n).for_each(|bar| *bar = R::default())
                }
            }
        }
    }
}

/// Each wall with its part of the heights.
fn parts<'a>(walls: &'a [Surface], heights: &'a [f64]) -> impl Iterator<Item = (&'a Surface, &'a [f64])> {
    let mut rest = heights;
    walls.iter().map(move |surface| {
        let (own, behind) = rest.split_at(surface.x.len());
        rest = behind;
        (surface, own)
    })
}

impl Columns {
    fn deform(&self, n: usize, heights: &[f64], state: &mut [f64]) {
        for i in 0..n {
            let s = heights[self.column[i] as usize];
            state[n + i] += self.by_height[i] * s;
            if let Some((row, by_mass)) = &self.by_mass {
                state[row * n + i] += by_mass[i] * s;
            }
        }
    }

    fn pull_back<R: Real>(&self, n: usize, state_bar: &[R], heights_bar: &mut [f64]) {
        for i in 0..n {
            let mut bar = self.by_height[i] * state_bar[n + i].f64();
            if let Some((row, by_mass)) = &self.by_mass {
                bar += by_mass[i] * state_bar[row * n + i].f64();
            }
            heights_bar[self.column[i] as usize] += bar;
        }
    }
}

/// The map of the consistent method. The wall is a polyline, whose vertices have the heights, into the channel. Fluid
/// moves by s(x) times its distance from the other wall over H. Dummy particles keep their depth below their vertex,
/// and their mirror images are those in the nearest point of the polyline.
#[derive(Debug, Clone)]
pub struct Surface {
    /// x of the vertices, increasing, within one period.
    pub x: Vec<f64>,
    pub length: f64,
    /// Height H of the channel.
    pub height: f64,
    /// Whether this is the wall at y = H, where heights point down.
    pub is_top: bool,
    /// Particle index of each vertex.
    pub points: Vec<usize>,
    /// Indices of other wall points, with a temperature, or with a no-flux condition and a normal.
    pub hot: Vec<usize>,
    pub cold: Vec<usize>,
    /// The length over which the slope of a normal is taken.
    pub slope_over: f64,
    pub fluid: Vec<usize>,
    /// Index of each dummy particle behind this wall, and its vertex.
    pub dummies: Vec<(usize, usize)>,
    /// The first of the two rows of the state that hold mirror images and normals.
    pub vector: usize,
}

/// A place on the polyline between the vertices `left` and `right`.
#[derive(Debug, Clone, Copy)]
struct On {
    left: usize,
    right: usize,
    share: f64,
    /// Distance along x between both vertices.
    width: f64,
}

impl Surface {
    fn on(&self, x: f64) -> On {
        let count = self.x.len();
        let x = x.rem_euclid(self.length);
        let right = self.x.partition_point(|&at| at <= x) % count;
        let left = (right + count - 1) % count;
        let width = (self.x[right] - self.x[left]).rem_euclid(self.length);
        On { left, right, share: (x - self.x[left]).rem_euclid(self.length) / width, width }
    }

    /// The difference along x to the nearest periodic image.
    fn near(&self, difference: f64) -> f64 {
        difference - self.length * (difference / self.length).round()
    }

    /// Height of the wall at x.
    fn level(&self, x: f64, heights: &[f64]) -> f64 {
        let on = self.on(x);
        heights[on.left] + on.share * (heights[on.right] - heights[on.left])
    }

    /// The adjoint of [`Self::level`].
    fn level_bar(&self, x: f64, bar: f64, heights_bar: &mut [f64]) {
        let on = self.on(x);
        heights_bar[on.left] += (1.0 - on.share) * bar;
        heights_bar[on.right] += on.share * bar;
    }

    /// Slope of the wall at x.
    fn slope(&self, x: f64, heights: &[f64]) -> f64 {
        let half = 0.5 * self.slope_over;
        (self.level(x + half, heights) - self.level(x - half, heights)) / self.slope_over
    }

    /// The nearest point of the polyline to a dummy particle, and whether it lies between the ends of its segment.
    fn nearest(&self, x: f64, y: f64, heights: &[f64]) -> (On, bool) {
        let count = self.x.len();
        let mut best = (On { left: 0, right: 0, share: 0.0, width: 0.0 }, false);
        let mut least = f64::INFINITY;
        for left in 0..count {
            let right = (left + 1) % count;
            let width = (self.x[right] - self.x[left]).rem_euclid(self.length);
            let (a, b) = (self.near(x - self.x[left]), y - heights[left]);
            // Skips segments that are far away.
            if a.abs() > 0.25 * self.length {
                continue;
            }
            let rise = heights[right] - heights[left];
            let free = (a * width + b * rise) / (width * width + rise * rise);
            let share = free.clamp(0.0, 1.0);
            let distance = (a - share * width).powi(2) + (b - share * rise).powi(2);
            if distance < least {
                least = distance;
                best = (On { left, right, share, width }, share == free);
            }
        }
        best
    }

    /// y of the flat wall, and the direction of its heights.
    fn frame(&self) -> (f64, f64) {
        match self.is_top {
            true => (self.height, -1.0),
            false => (0.0, 1.0),
        }
    }

    /// dy/ds of fluid at y.
    fn share(&self, y: f64) -> f64 {
        match self.is_top {
            true => -y / self.height,
            false => 1.0 - y / self.height,
        }
    }

    fn deform(&self, n: usize, base: &[f64], heights: &[f64], state: &mut [f64]) {
        let (flat, up) = self.frame();
        for (&i, s) in self.points.iter().zip(heights) {
            state[n + i] += up * s;
        }
        for &i in self.hot.iter().chain(&self.cold) {
            state[n + i] += up * self.level(state[i], heights);
        }
        for &i in &self.cold {
            let slope = self.slope(state[i], heights);
            let size = (1.0 + slope * slope).sqrt();
            state[self.vector * n + i] = -slope / size;
            state[(self.vector + 1) * n + i] = up / size;
        }
        for &i in &self.fluid {
            state[n + i] += self.level(state[i], heights) * self.share(base[n + i]);
        }
        for &(i, point) in &self.dummies {
            // Height above the flat wall, towards the fluid.
            let (x, y) = (state[i], up * (base[n + i] - flat) + heights[point]);
            state[n + i] = flat + up * y;
            let (on, _) = self.nearest(x, y, heights);
            let foot = [
                x - self.near(x - self.x[on.left]) + on.share * on.width,
                heights[on.left] + on.share * (heights[on.right] - heights[on.left]),
            ];
            state[self.vector * n + i] = 2.0 * foot[0] - x;
            state[(self.vector + 1) * n + i] = flat + up * (2.0 * foot[1] - y);
        }
    }

    fn pull_back<R: Real>(&self, n: usize, base: &[f64], heights: &[f64], state_bar: &[R], heights_bar: &mut [f64]) {
        let (flat, up) = self.frame();
        let bar = |row: usize, i: usize| match row == 1 || row == self.vector + 1 {
            true => up * state_bar[row * n + i].f64(),
            false => state_bar[row * n + i].f64(),
        };
        for (&i, heights_bar) in self.points.iter().zip(heights_bar.iter_mut()) {
            *heights_bar += bar(1, i);
        }
        for &i in self.hot.iter().chain(&self.cold) {
            self.level_bar(base[i], bar(1, i), heights_bar);
        }
        for &i in &self.cold {
            let slope = self.slope(base[i], heights);
            let cubed = (1.0 + slope * slope).powf(-1.5);
            let slope_bar = -cubed * bar(self.vector, i) - slope * cubed * bar(self.vector + 1, i);
            let half = 0.5 * self.slope_over;
            self.level_bar(base[i] + half, slope_bar / self.slope_over, heights_bar);
            self.level_bar(base[i] - half, -slope_bar / self.slope_over, heights_bar);
        }
        for &i in &self.fluid {
            let s_bar = up * bar(1, i) * self.share(base[n + i]);
            self.level_bar(base[i], s_bar, heights_bar);
        }
        for &(i, point) in &self.dummies {
            let (x, y) = (base[i], up * (base[n + i] - flat) + heights[point]);
            let mirror_bar = [bar(self.vector, i), bar(self.vector + 1, i)];
            let foot_bar = mirror_bar.map(|bar| 2.0 * bar);
            let mut y_bar = bar(1, i) - mirror_bar[1];
            let (on, between) = self.nearest(x, y, heights);
            let rise = heights[on.right] - heights[on.left];
            // foot = left + share (right - left)
            let mut left_bar = foot_bar[1];
            let mut rise_bar = on.share * foot_bar[1];
            if between {
                let square = on.width * on.width + rise * rise;
                let share_bar = (foot_bar[0] * on.width + foot_bar[1] * rise) / square;
                let b = y - heights[on.left];
                y_bar += share_bar * rise;
                left_bar -= share_bar * rise;
                rise_bar += share_bar * (b - 2.0 * on.share * rise);
            }
            heights_bar[on.left] += left_bar - rise_bar;
            heights_bar[on.right] += rise_bar;
            heights_bar[point] += y_bar;
        }
    }
}
