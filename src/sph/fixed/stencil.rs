//! The kernel on the reference lattice, whose weights are computed once and are the same for every particle.
//!
//! With F = -W'(r)/r at the offset (i, j) dx of a neighbour, and all sums over the offsets |i|, |j| <= 2:
//!
//! * first derivatives: g = F (i, j) / (dx sum F i^2), so that sum g_x i dx = 1;
//! * what the flow carries: c = F (i (a + b i^2 + d j^2), j (a + b j^2 + d i^2)), the same for linear fields, and exact for cubic
//!   ones too: sums with i^3 and i j^2 are 0. Where temperature varies within a few spacings of a wall, g alone makes the
//!   heat some 0.5 % low at ten rows. (For the pressure's gradient c would halve the largest time step.)
//! * second derivatives: combinations of F i^2/r^2 and F j^2/r^2 (and F i j/r^2 for the mixed one) that are exact for
//!   quadratic fields: l_xx, l_yy, l_xy, in 1/length^2;
//! * diffusion of the density: Morris' weights w = 2 F / (dx^2 sum F i^2).

use super::grid::REACH;
use crate::numerics::lanes::{array, Real};
use crate::sph::kernels::Kernel;

/// Number of offsets along one direction.
pub const WIDTH: usize = 2 * REACH + 1;

/// The weights of one offset.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Weight<R> {
    /// First derivatives, 1/length.
    pub gx: R,
    pub gy: R,
    /// First derivatives for what the flow carries, 1/length.
    pub cx: R,
    pub cy: R,
    /// Half of the weights of second derivatives, 1/length^2, as they multiply sums over both ends of a pair; l_xy is
    /// not halved, because the mixed derivative counts twice.
    pub lxx: R,
    pub lyy: R,
    pub lxy: R,
    /// Morris' Laplacian, 1/length^2.
    pub laplacian: R,
}

/// The weights by offset, `[j + 2][i + 2]`; the centre is zero.
pub type Stencil<R> = [[Weight<R>; WIDTH]; WIDTH];

pub fn stencil<R: Real>(kernel: &Kernel, spacing: f64) -> Stencil<R> {
    let reach = REACH as isize;
    let offsets = || (-reach..=reach).flat_map(|j| (-reach..=reach).map(move |i| (i, j))).filter(|&o| o != (0, 0));
    let (si, sj) = (|o: (isize, isize)| (o.0 * o.0) as f64, |o: (isize, isize)| (o.1 * o.1) as f64);
    let slope = |o| -kernel.pair((si(o) + sj(o)) * spacing * spacing).1;
    let over_square = |o| slope(o) / (si(o) + sj(o));
    let sum = |f: &dyn Fn((isize, isize)) -> f64| offsets().map(f).sum::<f64>();
    let moment = sum(&|o| slope(o) * si(o));
    let [a3, b3, d3] = exact_for_cubics(&|a, b| sum(&|o| slope(o) * si(o).powi(a) * sj(o).powi(b)));
    // Summed with i^2, a F i^2/r^2 + b F j^2/r^2 gives 2; summed with j^2 it gives 0.
    let (same, cross) = (sum(&|o| over_square(o) * si(o) * si(o)), sum(&|o| over_square(o) * si(o) * sj(o)));
    let determinant = same * same - cross * cross;
    let (a, b) = (2.0 * same / determinant, -2.0 * cross / determinant);
    let square = spacing * spacing;
    let mut stencil = [[Weight::default(); WIDTH]; WIDTH];
    for o in offsets() {
        let (i, j) = (o.0 as f64, o.1 as f64);
        let (f, q) = (slope(o), over_square(o));
        stencil[(o.1 + reach) as usize][(o.0 + reach) as usize] = Weight {
            gx: R::of(f * i / moment / spacing),
            gy: R::of(f * j / moment / spacing),
            cx: R::of(f * i * (a3 + b3 * si(o) + d3 * sj(o)) / spacing),
            cy: R::of(f * j * (a3 + b3 * sj(o) + d3 * si(o)) / spacing),
            lxx: R::of(0.5 * q * (a * si(o) + b * sj(o)) / square),
            lyy: R::of(0.5 * q * (a * sj(o) + b * si(o)) / square),
            lxy: R::of(q * i * j / cross / square),
            laplacian: R::of(2.0 * f / moment / square),
        };
    }
    stencil
}

/// a, b, d for which sum F i (a + b i^2 + d j^2) times i, i^3, i j^2 is 1, 0, 0, given sums of F i^2a j^2b.
fn exact_for_cubics(moment: &dyn Fn(i32, i32) -> f64) -> [f64; 3] {
    let m = moment;
    let rows = [[m(1, 0), m(2, 0), m(1, 1)], [m(2, 0), m(3, 0), m(2, 1)], [m(1, 1), m(2, 1), m(1, 2)]];
    // The first column of the inverse, by cofactors.
    let minor = |i: usize, j: usize| rows[1][i] * rows[2][j] - rows[1][j] * rows[2][i];
    let cofactors = [minor(1, 2), -minor(0, 2), minor(0, 1)];
    let determinant: f64 = rows[0].iter().zip(cofactors).map(|(a, b)| a * b).sum();
    cofactors.map(|cofactor| cofactor / determinant)
}

/// Weights of columns -2 .. 2 in the derivative along x of a field that does not depend on y.
pub fn derivative<R: Real>(stencil: &Stencil<R>) -> [f64; WIDTH] {
    array(|i| stencil.iter().map(|row| row[i].gx.f64()).sum())
}
