//! Smoothing kernels: W(d) = sigma w(q), q = d/h, one family of shapes w per file.
//!
//! What the operators need besides W is F = W'(d)/d and, for adjoints, G = F'(d)/d. A new kernel is a
//! [`SmoothingKernel`], with its name in `with_shape`.

pub mod gaussian;
pub mod shape;
pub mod splines;
pub mod wendland;

pub use gaussian::{Gaussian, SuperGaussian};
pub use shape::SmoothingKernel;
pub use splines::{CubicSpline, QuinticSpline};
pub use wendland::{WendlandC2, WendlandC4, WendlandC6};

pub use crate::config::scene::KernelName;
use crate::numerics::lanes::{Lanes, Rare, Real};
use candle_core::{Result, Tensor};
use shape::number;

/// A kernel of a smoothing length h in a number of dimensions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Kernel {
    pub shape: KernelName,
    pub dimension: usize,
    pub smoothing_length: f64,
    pub sigma: f64,
}

/// Calls `$go` with the type of a kernel's shape, which is called as its name.
macro_rules! with_shape {
    ($shape:expr, $kernel:ident => $go:expr) => {
        with_shape!($shape, $kernel => $go, {
            QuinticSpline WendlandC2 CubicSpline WendlandC4 WendlandC6 Gaussian SuperGaussian
        })
    };
    ($shape:expr, $kernel:ident => $go:expr, { $($name:ident)* }) => {
        match $shape {
            $(KernelName::$name => {
                type $kernel = $name;
                $go
            })*
        }
    };
}

impl Kernel {
    /// A shape in `dimension` dimensions (1, 2 or 3) with smoothing length h.
    pub fn new(shape: KernelName, dimension: usize, smoothing_length: f64) -> Self {
        let sigma = with_shape!(shape, K => K::sigma(dimension, smoothing_length));
        Self { shape, dimension, smoothing_length, sigma }
    }

    /// The support radius.
    pub fn cutoff(&self) -> f64 {
        with_shape!(self.shape, K => K::SUPPORT) * self.smoothing_length
    }

    /// W(0): a particle's own share of its density sum.
    pub fn at_zero(&self) -> f64 {
        with_shape!(self.shape, K => K::at_zero(self.dimension)) * self.sigma
    }

    /// The constants in lanes.
    #[inline(always)]
    pub fn lanes<L: Lanes>(&self) -> KernelLanes<L> {
        let h = self.smoothing_length;
        let slope = with_shape!(self.shape, K => K::SLOPE) * self.sigma;
        KernelLanes {
            shape: self.shape,
            dimension: number(self.dimension as f64),
            inverse_h: L::splat(L::Real::of(1.0 / h)),
            w: L::splat(L::Real::of(self.sigma)),
            f: L::splat(L::Real::of(slope / (h * h))),
            g: L::splat(L::Real::of(slope / (h * h * h * h))),
        }
    }

    /// W and F of a squared distance: one pair at a time through the same code.
    #[inline]
    pub fn pair<R: Real>(&self, r2: R) -> (R, R) {
        // Lane 0 of the portable lanes: all of them are the same number.
        let (w, f, _) = self.lanes::<R::Portable>().all(<R::Portable as Lanes>::splat(r2));
        let count = R::of(<R::Portable as Lanes>::COUNT as f64);
        (w.sum() / count, f.sum() / count)
    }

    /// W and F of distances, from candle's operators.
    pub fn composed(&self, distance: &Tensor) -> Result<(Tensor, Tensor)> {
        let h = self.smoothing_length;
        let q = distance.affine(1.0 / h, 0.0)?;
        let (w, slope) = with_shape!(self.shape, K => K::composed(&q, self.dimension))?;
        Ok((w.affine(self.sigma, 0.0)?, slope.affine(self.sigma / (h * h), 0.0)?))
    }
}

/// [`Kernel`] over lanes, as functions of the squared distance.
#[derive(Clone, Copy)]
pub struct KernelLanes<L> {
    shape: KernelName,
    dimension: L,
    inverse_h: L,
    w: L,
    f: L,
    g: L,
}

/// A kernel that is not the usual one, at some q.
struct Other<L> {
    shape: KernelName,
    q: L,
    inverse: L,
    dimension: L,
}

impl<L: Lanes> Rare for Other<L> {
    type Output = (L, L, L);

    #[inline(always)]
    fn call(self) -> (L, L, L) {
        with_shape!(self.shape, K => K::shape(self.q, self.inverse, self.dimension))
    }
}

impl<L: Lanes> KernelLanes<L> {
    /// W, F and G from one distance; what the caller drops is not computed.
    #[inline(always)]
    pub fn all(&self, r2: L) -> (L, L, L) {
        // At d = 0, which only self pairs and padding have, q is 0 and 1/q large but finite.
        let r2 = r2 * (self.inverse_h * self.inverse_h);
        let inverse = (r2 + number(1e-30)).inverse_sqrt();
        let q = r2 * inverse;
        let (w, f, g) = match self.shape {
            KernelName::QuinticSpline => QuinticSpline::shape(q, inverse, self.dimension),
            KernelName::WendlandC2 => WendlandC2::shape(q, inverse, self.dimension),
            // Seven shapes in every loop would make all of them slower, and the compiler too; a call costs these a little.
            shape => L::out_of_line(Other { shape, q, inverse, dimension: self.dimension }),
        };
        (self.w * w, self.f * f, self.g * g)
    }

    /// W.
    #[inline(always)]
    pub fn value(&self, r2: L) -> L {
        self.all(r2).0
    }

    /// F = W'(d)/d.
    #[inline(always)]
    pub fn slope(&self, r2: L) -> L {
        self.all(r2).1
    }
}
