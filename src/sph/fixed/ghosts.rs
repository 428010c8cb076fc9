//! Ghost values beyond the walls at -dx/2, -3 dx/2, from the values f_1, f_2 of the rows at dx/2, 3 dx/2.
//!
//! * value w given on the wall: the parabola through w, f_1, f_2, so 8/3 w - 2 f_1 + f_2/3 and 8 w - 9 f_1 + 2 f_2;
//! * nothing given: the line, so 2 f_1 - f_2 and 3 f_1 - 2 f_2;
//! * no flux through the wall: even, f_1 - dx f' and f_2 - 3 dx f', with the f' = df/deta for which the conormal derivative
//!   K_xy f_x + K_yy f_eta vanishes: f' = q df/dxi, where q = D S/(1 + S^2) is the lean of the wall;
//! * a mass flux that is zero on the wall: odd, so -f_1 and -f_2.
//!
//! In a column whose wall is hot over a part of its cell, the first and the third are averaged with that weight.
//!
//! df/dxi is the mean of the slopes to both adjacent columns, of values on the wall, which are on the line through those of the first two
//! rows. (From the first row itself, dx/2 away, the flux through the wall is wrong by K_yy q^2 f_xixi dx/2. Near an edge of the hot
//! wall, where f_xi grows as the inverse root of the distance, that adds up to dx ln(1/dx).) Towards a hot column only the part of the
//! distance along the adiabatic wall counts, which is half of it. Where an edge then acts on slopes is what `scripts/peers/hot_edge.py` shows.

use super::channel::Channel;
use super::grid::Grid;
use crate::numerics::lanes::{Lanes, Real};

/// Constants of the columns, as lines `[stride]`.
#[derive(Debug)]
pub struct Ghosts<R> {
    /// Hot fraction of the cell of the bottom wall.
    pub hot: Vec<R>,
    /// Weights of columns i - 1, i, i + 1 in dx df/dxi along the wall, times the fraction of the cell that is not hot, at bottom and top.
    pub along: [[Vec<R>; 3]; 2],
}

impl<R: Real> Ghosts<R> {
    pub fn new(channel: &Channel, grid: &Grid) -> Self {
        let (hot, cold) = (channel.hot_share(), channel.cold_cover());
        let n = hot.len();
        let line = |value: &dyn Fn(usize) -> f64| {
            let mut line = vec![R::default(); grid.stride];
            (0..n).for_each(|i| line[grid.column(i as isize)] = R::of(value(i)));
            grid.wrap(&mut line);
            line
        };
        let weights = |cold: &dyn Fn(usize) -> f64| {
            let cold = |i: usize| cold(i % n);
            // Half the slope to each side, times the fraction of the distance to that side that is not hot.
            let side = |i: usize, other: usize| 0.25 * (cold(i) + cold(other)) * cold(i);
            let (left, right) = (|i: usize| side(i, i + n - 1), |i: usize| side(i, i + 1));
            [line(&|i| -left(i)), line(&|i| left(i) - right(i)), line(&right)]
        };
        let mut bottom = weights(&|i| cold[i]);
        let conormal = R::of(channel.conormal);
        bottom.iter_mut().flatten().for_each(|weight| *weight *= conormal);
        Self { along: [bottom, weights(&|_| 1.0)], hot: line(&|i| hot[i]) }
    }
}

#[inline(always)]
fn number<L: Lanes>(value: f64) -> L {
    L::splat(L::Real::of(value))
}

/// The near and the far ghost of a field that is 0 on the wall.
#[inline(always)]
pub fn parabola<L: Lanes>(f: [L; 2]) -> [L; 2] {
    [f[0].mul_add(number(-2.0), f[1] * number(1.0 / 3.0)), f[0].mul_add(number(-9.0), f[1] + f[1])]
}

/// The cotangents of f_1, f_2, given those of their ghosts by [`parabola`].
#[inline(always)]
pub fn parabola_bar<L: Lanes>(g: [L; 2]) -> [L; 2] {
    [g[0].mul_add(number(-2.0), g[1] * number(-9.0)), g[0].mul_add(number(1.0 / 3.0), g[1] + g[1])]
}

/// Ghosts on the line through f_1, f_2.
#[inline(always)]
pub fn line<L: Lanes>(f: [L; 2]) -> [L; 2] {
    let step = f[0] - f[1];
    [f[0] + step, f[0] + step + step]
}

/// The cotangents of f_1, f_2, given those of their ghosts by [`line()`].
#[inline(always)]
pub fn line_bar<L: Lanes>(g: [L; 2]) -> [L; 2] {
    let twice = g[1] + g[1];
    [g[0] + g[0] + g[1] + twice, -(g[0] + twice)]
}

/// Ghosts of a temperature. The fraction `hot` of the wall has the temperature `given`; `conormal` is dx f' of the
/// rest.
#[inline(always)]
pub fn temperature<L: Lanes>(f: [L; 2], hot: L, given: L, conormal: L) -> [L; 2] {
    let wall = hot * given;
    let (three, third) = (number::<L>(3.0), number::<L>(1.0 / 3.0));
    // hot (8/3 w - 2 f_1 + f_2/3) + (1 - hot) f_1, and accordingly for the far ghost.
    let near = (third * f[1] - three * f[0]).mul_add(hot, f[0]) + number::<L>(8.0 / 3.0) * wall;
    let far = (f[1] - number::<L>(9.0) * f[0]).mul_add(hot, f[1]) + number::<L>(8.0) * wall;
    [near - conormal, far - three * conormal]
}

/// The value on a wall from those of the first two rows, on a line.
pub const ON_WALL: [f64; 2] = [1.5, -0.5];

/// The cotangents of f_1, f_2 and of `conormal`, given those of the ghosts by [`temperature`].
#[inline(always)]
pub fn temperature_bar<L: Lanes>(g: [L; 2], hot: L) -> ([L; 2], L) {
    let (three, third) = (number::<L>(3.0), number::<L>(1.0 / 3.0));
    let first = g[0] - hot * (three * g[0] + number::<L>(9.0) * g[1]);
    let second = g[1] + hot * (third * g[0] + g[1]);
    ([first, second], -(g[0] + three * g[1]))
}
