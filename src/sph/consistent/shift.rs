//! The shift velocity w: what keeps particles evenly spread besides the flow.
//!
//! * `chain`, where particles stand in rows along a channel and stay in them: a particle knows its two neighbours in its row
//!   and the rows above and below from the start, and is drawn to the middle of each:
//!   w_x = k U (x_+ + x_- - 2x)/(2 dx), w_y = k U (Y_up(x) + Y_down(x) - 2y)/(2 dx), Y linear along the row beside it, and
//!   2 y_wall(x) - y beyond a wall. Smooth and linear, and nothing swaps neighbours: so the flow does not turn chaotic.
//! * `rows`: as `chain`, but particles go along their row instead of with the flow across it, w_y gaining (u + w_x) s - v with
//!   the row's slope s = (y_+ - y_-)/(x_+ - x_-): rows stay where they are while the flow passes through them.
//! * `isotropic`, anywhere: w = -k U dx sum_j dx^D grad W_ij (Lind et al. 2012), |w| <= limit U, and away from the wall's
//!   surface where it is nearer than dx/2.
//! * `none`.

use super::arrangement::{Chain, Isotropic, Shift};
use super::blocks::Place;
use super::geometry::Geometry;
use super::kept::Kept;
use super::kinds::rows;
use super::layout::Layout;
use super::stencil::monomials;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_each, run_rows, RowKernel};
use crate::particles::Domain;
use crate::sph::own::Own;
use std::ops::Range;

/// Where a place lies between two particles of a row: the places of both in it, and how far they are to the right of it.
struct Between<R> {
    left: usize,
    right: usize,
    before: R,
    behind: R,
}

/// Everything that a chain's sums need.
struct Rows<'a, R> {
    chain: &'a Chain,
    x: &'a [R],
    y: &'a [R],
    known: &'a [R],
    domain: &'a Domain,
}

impl<'a, R: Real> Rows<'a, R> {
    fn new(geometry: &Geometry<'a, R>, chain: &'a Chain, known: &'a [R]) -> Self {
        let n = geometry.model.particles();
        Self { chain, x: &known[..n], y: &known[n..2 * n], known, domain: &geometry.model.domain }
    }

    /// A row's slope between two of its particles, and 1 / their distance along x; `x` is between them.
    #[inline(always)]
    fn slope(&self, x: R, previous: u32, next: u32) -> (R, R) {
        let inverse = R::of(1.0) / (self.toward(x, next) - self.toward(x, previous));
        ((self.y[next as usize] - self.y[previous as usize]) * inverse, inverse)
    }

    #[inline(always)]
    fn toward(&self, from: R, particle: u32) -> R {
        self.domain.nearest_image(0, self.x[particle as usize] - from)
    }

    /// The two particles of a row between which x is; `hint` is where to begin.
    #[inline(always)]
    fn between(&self, row: usize, x: R, hint: usize) -> Between<R> {
        let row = &self.chain.rows[row];
        let count = row.len();
        let next = |k: usize| if k + 1 == count { 0 } else { k + 1 };
        let mut left = hint.min(count - 1);
        let mut before = self.toward(x, row[left]);
        for _ in 0..count {
            if before > R::default() {
                left = if left == 0 { count - 1 } else { left - 1 };
                before = self.toward(x, row[left]);
                continue;
            }
            let behind = self.toward(x, row[next(left)]);
            // A particle far to the left is one to the right, round the other way.
            if behind <= R::default() && behind > before {
                left = next(left);
                before = behind;
                continue;
            }
            break;
        }
        let right = next(left);
        Between { left, right, before, behind: self.toward(x, row[right]) }
    }

    /// The share of the right one, and 1 / distance of both (0 where they have changed sides).
    #[inline(always)]
    fn share(&self, at: &Between<R>) -> (R, R) {
        let distance = at.behind - at.before;
        if distance > R::of(1e-9) && at.before <= R::default() && at.behind >= R::default() {
            (-at.before / distance, R::of(1.0) / distance)
        } else {
            (R::default(), R::default())
        }
    }
}

/// What a chain's search begins from, two for each particle.
fn hints<'a>(chain: &Chain, hints: &'a mut Vec<u32>) -> &'a mut [u32] {
    if hints.len() != 2 * chain.seat.len() {
        *hints = chain.seat.iter().flat_map(|&(_, place)| [place, place]).collect();
    }
    hints
}

/// Where component k of c_i, then of w, of a place stands in the derivatives.
#[inline(always)]
fn at<R>(l: Layout, place: usize, k: usize) -> usize {
    let (d, fields) = (l.dimension, l.fields());
    Place::of::<R>(place, rows(d, fields)).row(fields * monomials(d) + 1 + k)
}

/// Replaces the derivatives' last rows (c_i) by w.
pub fn forward<R: Real>(geometry: &Geometry<'_, R>, known: &[R], kept: &mut Kept<R>, derivatives: &mut [R]) {
    let (model, fits) = (geometry.model, &geometry.model.fits);
    let (d, fluid) = (model.layout.dimension, &geometry.blocks.fluid);
    let row = |place: usize, k: usize| at::<R>(model.layout, place, k);
    match &fits.shift {
        Shift::None => {}
        Shift::Isotropic(isotropic) => {
            // The adjoint needs c where w is limited.
            kept.spread.resize(d * fluid.places, R::default());
            let factor = R::of(-isotropic.strength * fits.velocity * fits.spacing.powi(d as i32 + 1));
            let limit = R::of(isotropic.limit * fits.velocity);
            let (spread, shifts) = (Own::new(&mut kept.spread), Own::new(derivatives));
            run_each(fluid.places, |place| {
                let mut square = R::default();
                for k in 0..d {
                    let c = shifts.get(row(place, k));
                    spread.set(place * d + k, c);
                    square += factor * c * factor * c;
                }
                let size = square.sqrt();
                let factor = if size > limit { factor * limit / size } else { factor };
                (0..d).for_each(|k| shifts.set(row(place, k), shifts.get(row(place, k)) * factor));
            });
            push(geometry, isotropic, known, |place, k, push| derivatives[row(place, k)] += push);
        }
        Shift::Chain(chain) => {
            let at = Rows::new(geometry, chain, known);
            let hints = Own::new(hints(chain, &mut kept.hints));
            let sweep = ChainSweep { geometry: *geometry, at, hints, derivatives: Own::new(derivatives) };
            run_rows(&sweep, fluid.places);
        }
    }
}

/// w of a chain.
struct ChainSweep<'a, R> {
    geometry: Geometry<'a, R>,
    at: Rows<'a, R>,
    hints: Own<'a, u32>,
    derivatives: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for ChainSweep<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, places: Range<usize>) {
        let (geometry, at) = (&self.geometry, &self.at);
        let (model, fits, chain) = (geometry.model, &geometry.model.fits, at.chain);
        let (n, l) = (model.particles(), model.layout);
        let factor = R::of(0.5 * chain.strength * fits.velocity / fits.spacing);
        let two = R::of(2.0);
        let last = chain.rows.len() - 1;
        for place in places {
            let i = geometry.blocks.fluid.particle(place);
            let (r, previous, next) = chain.beside(i);
            let (x, y) = (at.x[i], at.y[i]);
            let along = at.toward(x, previous) + at.toward(x, next);
            let mut across = -two * y;
            for (side, beside) in [r - 1, r + 1].into_iter().enumerate() {
                let between = at.between(beside, x, self.hints.get(2 * i + side) as usize);
                self.hints.set(2 * i + side, between.left as u32);
                let (share, _) = at.share(&between);
                let height = |place: usize| at.y[chain.rows[beside][place] as usize];
                let (low, high) = (height(between.left), height(between.right));
                let level = low + share * (high - low);
                across += if beside == 0 || beside == last { two * level - y } else { level };
            }
            let mut w = [factor * along, factor * across];
            if chain.is_still {
                let (u, v) = (at.known[l.velocity() * n + i], at.known[(l.velocity() + 1) * n + i]);
                let (slope, _) = at.slope(x, previous, next);
                w[1] += (u + w[0]) * slope - v;
            }
            for (k, w) in w.into_iter().enumerate() {
                self.derivatives.set(self::at::<R>(l, place, k), w);
            }
        }
    }
}

/// The adjoint: turns the cotangents of w in the derivatives' last rows into those of c_i, and adds to those of positions.
pub fn backward<R: Real>(
    geometry: &Geometry<'_, R>,
    known: &[R],
    kept: &mut Kept<R>,
    derivatives_bar: &mut [R],
    known_bar: &mut [R],
) {
    let Some(part) = &geometry.model.part else { return add_back(geometry, known, kept, derivatives_bar, known_bar) };
    // What particles give to the positions of others, which other ranks may own.
    let mut given = vec![R::default(); known_bar.len()];
    add_back(geometry, known, kept, derivatives_bar, &mut given);
    part.give_back(&mut given[..geometry.model.layout.dimension * geometry.model.particles()]);
    let to = Own::new(known_bar);
    run_each(given.len(), |place| to.add(place, given[place]));
}

fn add_back<R: Real>(
    geometry: &Geometry<'_, R>,
    known: &[R],
    kept: &mut Kept<R>,
    derivatives_bar: &mut [R],
    known_bar: &mut [R],
) {
    let (model, fits) = (geometry.model, &geometry.model.fits);
    let (n, l, d, fluid) = (model.particles(), model.layout, model.layout.dimension, &geometry.blocks.fluid);
    let row = |place: usize, k: usize| at::<R>(l, place, k);
    match &fits.shift {
        Shift::None => {
            for place in 0..fluid.places {
                (0..d).for_each(|k| derivatives_bar[row(place, k)] = R::default());
            }
        }
        Shift::Isotropic(isotropic) => {
            push_back(geometry, isotropic, known, |place, k| derivatives_bar[row(place, k)], known_bar);
            let factor = R::of(-isotropic.strength * fits.velocity * fits.spacing.powi(d as i32 + 1));
            let limit = R::of(isotropic.limit * fits.velocity);
            let (spread, shifts_bar) = (&kept.spread, Own::new(derivatives_bar));
            run_each(fluid.places, |place| {
                let c = &spread[place * d..(place + 1) * d];
                let bar = |k: usize| shifts_bar.get(row(place, k));
                let size = c.iter().map(|&c| factor * c * factor * c).sum::<R>().sqrt();
                if size > limit {
                    // w = limit direction(c): only what is across c has a derivative.
                    let along: R = (0..d).map(|k| bar(k) * c[k]).sum::<R>();
                    let square: R = c.iter().map(|&c| c * c).sum();
                    for k in 0..d {
                        let across = bar(k) - along * c[k] / square;
                        shifts_bar.set(row(place, k), factor * limit / size * across);
                    }
                } else {
                    (0..d).for_each(|k| shifts_bar.set(row(place, k), bar(k) * factor));
                }
            });
        }
        Shift::Chain(chain) => {
            let at = Rows::new(geometry, chain, known);
            let factor = R::of(0.5 * chain.strength * fits.velocity / fits.spacing);
            let two = R::of(2.0);
            let last = chain.rows.len() - 1;
            let hints = hints(chain, &mut kept.hints);
            for (place, i) in fluid.each() {
                let mut w_bar = [derivatives_bar[row(place, 0)], derivatives_bar[row(place, 1)]];
                // What c_i would get: nothing comes of it.
                (0..d).for_each(|k| derivatives_bar[row(place, k)] = R::default());
                let (r, previous, next) = chain.beside(i);
                if chain.is_still {
                    let (x, u) = (at.x[i], known[l.velocity() * n + i]);
                    let along = factor * (at.toward(x, previous) + at.toward(x, next));
                    let (slope, inverse) = at.slope(x, previous, next);
                    known_bar[l.velocity() * n + i] += slope * w_bar[1];
                    known_bar[(l.velocity() + 1) * n + i] -= w_bar[1];
                    w_bar[0] += slope * w_bar[1];
                    let rise_bar = (u + along) * inverse * w_bar[1];
                    known_bar[n + next as usize] += rise_bar;
                    known_bar[n + previous as usize] -= rise_bar;
                    known_bar[next as usize] -= slope * rise_bar;
                    known_bar[previous as usize] += slope * rise_bar;
                }
                let (along, across) = (factor * w_bar[0], factor * w_bar[1]);
                known_bar[previous as usize] += along;
                known_bar[next as usize] += along;
                known_bar[i] -= two * along;
                known_bar[n + i] -= two * across;
                for (side, beside) in [r - 1, r + 1].into_iter().enumerate() {
                    let between = at.between(beside, at.x[i], hints[2 * i + side] as usize);
                    let (share, inverse) = at.share(&between);
                    let (left, right) =
                        (chain.rows[beside][between.left] as usize, chain.rows[beside][between.right] as usize);
                    let wall = beside == 0 || beside == last;
                    let level_bar = if wall { two * across } else { across };
                    if wall {
                        known_bar[n + i] -= across;
                    }
                    known_bar[n + left] += (R::of(1.0) - share) * level_bar;
                    known_bar[n + right] += share * level_bar;
                    let slope = (at.y[right] - at.y[left]) * inverse * level_bar;
                    known_bar[i] += slope;
                    known_bar[left] -= (R::of(1.0) - share) * slope;
                    known_bar[right] -= share * slope;
                }
            }
        }
    }
}

/// For each fluid particle nearer than dx/2 to the surface: its place, the nearest point, how far it is from the surface along
/// the point's normal.
fn near<R: Real>(
    geometry: &Geometry<'_, R>,
    isotropic: &Isotropic,
    known: &[R],
    mut each: impl FnMut(usize, usize, &[f64; 3], R),
) {
    let (n, d) = (geometry.model.particles(), geometry.model.layout.dimension);
    let table = &geometry.blocks.wall;
    if isotropic.normals.is_empty() {
        return;
    }
    for (place, i) in table.each() {
        let mut best: Option<(R, u32, &[f64; 3], [R; 3])> = None;
        for j in table.neighbours(place) {
            let Some(normal) = isotropic.normals.get(&j) else { continue };
            let mut r = [R::default(); 3];
            let mut square = R::default();
            for a in 0..d {
                let raw = known[a * n + i] - known[a * n + j as usize];
                r[a] = R::of(geometry.model.domain.nearest(a, raw.f64()));
                square += r[a] * r[a];
            }
            if best.as_ref().is_none_or(|(least, ..)| square < *least) {
                best = Some((square, j, normal, r));
            }
        }
        if let Some((_, point, normal, r)) = best {
            let distance: R = (0..d).map(|a| r[a] * R::of(normal[a])).sum();
            if distance < R::of(0.5 * geometry.model.fits.spacing) {
                each(place, point as usize, normal, distance);
            }
        }
    }
}

/// Away from the surface: n U (1/2 - distance/dx).
fn push<R: Real>(geometry: &Geometry<'_, R>, isotropic: &Isotropic, known: &[R], mut add: impl FnMut(usize, usize, R)) {
    let fits = &geometry.model.fits;
    let d = geometry.model.layout.dimension;
    near(geometry, isotropic, known, |place, _, normal, distance| {
        let size = R::of(fits.velocity) * (R::of(0.5) - distance * R::of(1.0 / fits.spacing));
        (0..d).for_each(|k| add(place, k, R::of(normal[k]) * size));
    });
}

fn push_back<R: Real>(
    geometry: &Geometry<'_, R>,
    isotropic: &Isotropic,
    known: &[R],
    bar: impl Fn(usize, usize) -> R,
    known_bar: &mut [R],
) {
    let fits = &geometry.model.fits;
    let (n, d) = (geometry.model.particles(), geometry.model.layout.dimension);
    near(geometry, isotropic, known, |place, point, normal, _| {
        let i = geometry.blocks.wall.particle(place);
        let along: R = (0..d).map(|k| bar(place, k) * R::of(normal[k])).sum();
        let distance_bar = -along * R::of(fits.velocity / fits.spacing);
        for k in 0..d {
            let by_place = distance_bar * R::of(normal[k]);
            known_bar[k * n + i] += by_place;
            known_bar[k * n + point] -= by_place;
        }
    });
}
