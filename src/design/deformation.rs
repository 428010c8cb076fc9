//! From the heights of a wall over the particle columns to the initial state: positions of wall and fluid particles and
//! their masses.
//!
//! A column whose wall is raised by s (the average of the wall's height over the column, see [`super::parametrisations`])
//! keeps its number of particles: wall particles move by s, fluid is remapped to y + s (1 - y/H), so the column's height
//! becomes H - s. With the mass convention `column-area` a particle's mass is scaled with the column's area, m (1 - s/H),
//! and the density stays what it was; with `constant` it does not, and the fluid is compressed or thinned. All of it is
//! linear in the heights.

use crate::numerics::lanes::Real;

/// The map heights of columns `[C]` -> state `[F, N]`.
#[derive(Debug, Clone)]
pub struct Deformation {
    /// Columns C.
    pub columns: usize,
    /// State of the undeformed channel, `[F, N]`.
    pub base: Vec<f64>,
    /// Particles N.
    pub particles: usize,
    /// Column of each particle.
    pub column: Vec<u32>,
    /// dy/ds of each particle.
    pub by_height: Vec<f64>,
    /// dm/ds of each particle and the state's mass row, if mass is scaled.
    pub by_mass: Option<(usize, Vec<f64>)>,
}

impl Deformation {
    /// The initial state with these heights of the columns.
    pub fn state<R: Real>(&self, heights: &[f64]) -> Vec<R> {
        let n = self.particles;
        let mut state = self.base.clone();
        for i in 0..n {
            let s = heights[self.column[i] as usize];
            state[n + i] += self.by_height[i] * s;
            if let Some((row, by_mass)) = &self.by_mass {
                state[row * n + i] += by_mass[i] * s;
            }
        }
        state.into_iter().map(R::of).collect()
    }

    /// The derivative by the heights, `[C]`, from the cotangent of the state, summed in f64 in particle order.
    pub fn pull_back<R: Real>(&self, state_bar: &[R]) -> Vec<f64> {
        let n = self.particles;
        let mut heights_bar = vec![0.0; self.columns];
        for i in 0..n {
            let mut bar = self.by_height[i] * state_bar[n + i].f64();
            if let Some((row, by_mass)) = &self.by_mass {
                bar += by_mass[i] * state_bar[row * n + i].f64();
            }
            heights_bar[self.column[i] as usize] += bar;
        }
        heights_bar
    }

    /// Sets the cotangent of everything to zero that a state in the middle of a run does not take from the design
    /// directly: what remains are wall positions and masses (for truncated gradients).
    pub fn keep_static<R: Real>(&self, state_bar: &mut [R], is_fluid: impl Fn(usize) -> bool) {
        let n = self.particles;
        for i in (0..n).filter(|&i| is_fluid(i)) {
            state_bar[n + i] = R::default();
        }
    }
}
