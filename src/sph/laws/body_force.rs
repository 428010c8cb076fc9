//! Body force: a given acceleration of the fluid.

use crate::sph::masks::{above, below};
use candle_core::{Result, Tensor};

/// An acceleration by position, along x except for gravity. It is piecewise constant, so its derivative is zero.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BodyForce {
    None,
    /// Uniform in the fluid.
    Uniform(f64),
    /// Uniform where from < y < to, else zero.
    Band {
        strength: f64,
        from: f64,
        to: f64,
    },
    /// `strength` below y = turn and `-strength` above it (reverse Poiseuille flow).
    Reversing {
        strength: f64,
        turn: f64,
    },
    /// Uniform in any direction; the pressure of the walls balances it (Adami, Hu and Adams 2012, eq. 27).
    Gravity([f64; 3]),
}

impl BodyForce {
    /// The magnitude where it acts.
    pub fn strength(&self) -> f64 {
        match *self {
            Self::None => 0.0,
            Self::Uniform(strength) | Self::Band { strength, .. } | Self::Reversing { strength, .. } => strength,
            Self::Gravity(g) => g.iter().map(|g| g * g).sum::<f64>().sqrt(),
        }
    }

    /// Component `d` of the acceleration of fluid at height y.
    #[inline(always)]
    pub fn along(&self, d: usize, y: f64) -> f64 {
        match *self {
            Self::Gravity(g) => g[d],
            _ if d > 0 => 0.0,
            _ => self.at(y),
        }
    }

    /// Component x of the acceleration of fluid at height y.
    #[inline(always)]
    pub fn at(&self, y: f64) -> f64 {
        match *self {
            Self::None => 0.0,
            Self::Gravity(g) => g[0],
            Self::Uniform(g) => g,
            Self::Band { strength, from, to } if y > from && y < to => strength,
            Self::Band { .. } => 0.0,
            Self::Reversing { strength, turn } if y > turn => -strength,
            Self::Reversing { strength, .. } => strength,
        }
    }

    /// [`Self::at`] for heights `[1, N]`. It is piecewise constant, so it has no derivative.
    pub fn composed(&self, y: &Tensor) -> Result<Tensor> {
        match *self {
            Self::None => y.zeros_like(),
            Self::Uniform(g) | Self::Gravity([g, ..]) => y.detach().affine(0.0, g),
            Self::Band { strength, from, to } => above(y, from)?.mul(&below(y, to)?)?.affine(strength, 0.0),
            Self::Reversing { strength, turn } => above(y, turn)?.affine(-2.0 * strength, strength),
        }
    }

    /// The acceleration `[D, N]` at positions `[D, N]`.
    pub fn vector(&self, position: &Tensor) -> Result<Tensor> {
        let along = |d: usize| match *self {
            Self::Gravity(g) => position.narrow(0, d, 1)?.detach().affine(0.0, g[d]),
            _ if d == 0 => self.composed(&position.narrow(0, 1, 1)?),
            _ => position.narrow(0, d, 1)?.zeros_like(),
        };
        Tensor::cat(&(0..position.dim(0)?).map(along).collect::<Result<Vec<_>>>()?, 0)
    }
}
