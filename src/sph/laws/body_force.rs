//! Body force: a given acceleration of the fluid.

use crate::sph::operators::composed::{above, below};
use candle_core::{Result, Tensor};

/// An acceleration, along x unless it is a vector, by place. It is piecewise constant, so its derivative is zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BodyForce {
    None,
    /// The same everywhere in the fluid.
    Uniform(f64),
    /// Only where from < y < to.
    Band {
        strength: f64,
        from: f64,
        to: f64,
    },
    /// `strength` below y = turn, its opposite from there on (reverse Poiseuille flow).
    Reversing {
        strength: f64,
        turn: f64,
    },
    /// The same everywhere in the fluid, in any direction.
    Vector([f64; 3]),
}

impl BodyForce {
    /// Its size where it acts.
    pub fn strength(&self) -> f64 {
        match *self {
            Self::None => 0.0,
            Self::Uniform(strength) | Self::Band { strength, .. } | Self::Reversing { strength, .. } => strength,
            Self::Vector(g) => g.iter().map(|g| g * g).sum::<f64>().sqrt(),
        }
    }

    /// Acceleration along direction `d` of fluid at height y.
    #[inline(always)]
    pub fn along(&self, d: usize, y: f64) -> f64 {
        match *self {
            Self::Vector(g) => g[d],
            _ if d > 0 => 0.0,
            Self::None => 0.0,
            Self::Uniform(g) => g,
            Self::Band { strength, from, to } => {
                if y > from && y < to {
                    strength
                } else {
                    0.0
                }
            }
            Self::Reversing { strength, turn } => {
                if y > turn {
                    -strength
                } else {
                    strength
                }
            }
        }
    }

    /// The same of heights `[1, N]`, in `dimension` directions: `[D, N]`. Piecewise constant, so without derivative.
    ///
    /// # Errors
    /// Tensor errors.
    pub fn composed(&self, y: &Tensor, dimension: usize) -> Result<Tensor> {
        let x = match *self {
            Self::None => y.zeros_like()?,
            Self::Uniform(g) | Self::Vector([g, ..]) => y.detach().affine(0.0, g)?,
            Self::Band { strength, from, to } => above(y, from)?.mul(&below(y, to)?)?.affine(strength, 0.0)?,
            Self::Reversing { strength, turn } => above(y, turn)?.affine(-2.0 * strength, strength)?,
        };
        let mut all = vec![x];
        for d in 1..dimension {
            let g = if let Self::Vector(g) = *self { g[d] } else { 0.0 };
            all.push(y.detach().affine(0.0, g)?);
        }
        Tensor::cat(&all, 0)
    }
}
