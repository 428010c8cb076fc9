//! The map from the heights of a wall over x and z to the initial state in three dimensions. The one in two dimensions
//! is [`super::deformation::Surface`].
//!
//! A wall y = s(x, z) under a plane channel 0 < y < H moves
//!
//! ```text
//!   points on it         to y = s(x, z)
//!   fluid                to y + s(x, z) (1 - y/H)
//!   dummy particles      to y + s(x, z), keeping their depth d = -y below the wall's point above them
//! ```
//!
//! With its slopes g_x, g_z there and w = 1/(1 + g_x^2 + g_z^2), a normal is sqrt(w) (-g_x, 1, -g_z), and the mirror
//! image of a dummy particle is the one in the wall's tangent plane above it, r + 2 d w (-g_x, 1, -g_z). (In two
//! dimensions it is that in the nearest point of a polyline; on a smooth wall the two differ by the depth squared times
//! the curvature.) Slopes are differences over a quarter of a spacing to both sides.

use crate::numerics::lanes::Real;

#[derive(Debug, Clone)]
pub struct Relief {
    /// Places (x, z) where heights are needed, `[C]`.
    pub places: Vec<[f64; 2]>,
    /// Half of the length over which slopes are taken.
    half: f64,
    /// The first of the three rows of the state that hold normals and mirror images.
    vector: usize,
    moved: Vec<Moved>,
    leaning: Vec<Leaning>,
}

/// A particle that the wall moves.
#[derive(Debug, Clone, Copy)]
struct Moved {
    particle: usize,
    place: usize,
    /// dy/ds of the particle.
    share: f64,
}

/// A particle with a normal or a mirror image.
#[derive(Debug, Clone, Copy)]
struct Leaning {
    particle: usize,
    /// The first of the four places around it: before and after it along x, then along z.
    around: usize,
    /// Depth of a dummy particle, which has a mirror image; none for a surface point, which has a normal.
    depth: Option<f64>,
}

impl Relief {
    /// An empty relief, with the length over which slopes are taken.
    pub fn new(slope_over: f64, vector: usize) -> Self {
        Self { places: vec![], half: 0.5 * slope_over, vector, moved: vec![], leaning: vec![] }
    }

    /// Adds a particle at (x, z) that is moved by `share` times the height there.
    pub fn moves(&mut self, particle: usize, place: [f64; 2], share: f64) {
        self.moved.push(Moved { particle, place: self.places.len(), share });
        self.places.push(place);
    }

    /// Adds a particle at (x, z) with a normal or a mirror image: a surface point, or a dummy particle at some depth.
    pub fn leans(&mut self, particle: usize, [x, z]: [f64; 2], depth: Option<f64>) {
        self.leaning.push(Leaning { particle, around: self.places.len(), depth });
        let h = self.half;
        self.places.extend([[x - h, z], [x + h, z], [x, z - h], [x, z + h]]);
    }

    /// The slopes g_x and g_z.
    fn slopes(&self, around: usize, heights: &[f64]) -> [f64; 2] {
        [0, 2].map(|k| (heights[around + k + 1] - heights[around + k]) / (2.0 * self.half))
    }

    /// Moves the particles of a state `[F, N]` of the plane channel.
    pub(super) fn deform(&self, n: usize, heights: &[f64], state: &mut [f64]) {
        for moved in &self.moved {
            state[n + moved.particle] += moved.share * heights[moved.place];
        }
        for leaning in &self.leaning {
            let [gx, gz] = self.slopes(leaning.around, heights);
            let w = 1.0 / (1.0 + gx * gx + gz * gz);
            let i = leaning.particle;
            for (k, direction) in [-gx, 1.0, -gz].into_iter().enumerate() {
                state[(self.vector + k) * n + i] = match leaning.depth {
                    None => w.sqrt() * direction,
                    Some(depth) => state[k * n + i] + 2.0 * depth * w * direction,
                };
            }
        }
    }

    /// The adjoint of [`Self::deform`]: adds to the derivative by the heights.
    pub(super) fn pull_back<R: Real>(&self, n: usize, heights: &[f64], state_bar: &[R], heights_bar: &mut [f64]) {
        let mut from_mirrors = vec![0.0; n];
        for leaning in &self.leaning {
            let [gx, gz] = self.slopes(leaning.around, heights);
            let w = 1.0 / (1.0 + gx * gx + gz * gz);
            let i = leaning.particle;
            let bar: [f64; 3] = std::array::from_fn(|k| state_bar[(self.vector + k) * n + i].f64());
            // The vector is f(w) (-g_x, 1, -g_z), plus the particle's position if it is a mirror image.
            let (size, slope) = match leaning.depth {
                None => (w.sqrt(), 0.5 / w.sqrt()),
                Some(depth) => (2.0 * depth * w, 2.0 * depth),
            };
            if leaning.depth.is_some() {
                from_mirrors[i] += bar[1];
            }
            let w_bar = slope * (bar[1] - gx * bar[0] - gz * bar[2]);
            for (k, (g, along)) in [(gx, bar[0]), (gz, bar[2])].into_iter().enumerate() {
                // dw/dg = -2 g w^2
                let slope_bar = (-size * along - 2.0 * g * w * w * w_bar) / (2.0 * self.half);
                heights_bar[leaning.around + 2 * k + 1] += slope_bar;
                heights_bar[leaning.around + 2 * k] -= slope_bar;
            }
        }
        for moved in &self.moved {
            let i = moved.particle;
            heights_bar[moved.place] += moved.share * (state_bar[n + i].f64() + from_mirrors[i]);
        }
    }
}
