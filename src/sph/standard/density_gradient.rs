//! The renormalised gradient of the density, which delta-SPH diffuses beside ([`crate::sph::laws::density_diffusion`]).
//!
//! g_i = A_i^-1 b_i with b_i = sum_j V_j (rho_j - rho_i) F r_ij and A_i = -sum_j V_j F r_ij (x) r_ij over fluid and wall
//! particles j; 0 where the determinant of A is too small, and for walls.
//!
//! Adjoint, gathered: h_i = A_i^-1 g_bar_i (A is symmetric), and then the derivatives of l = F (V_j (h_i.r) (D + g_i.r) +
//! V_i (h_j.r) (D + g_j.r)) with D = rho_j - rho_i, r = r_ij and constant g and h.

use super::chain::{Masses, Step};
use super::records::{FLOW as WIDTH, TERM as TERM_WIDTH};
use crate::numerics::lanes::{array, lanes_of_rows, Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::laws::density_diffusion::LEAST_DETERMINANT;
use crate::sph::laws::dot;
use crate::sph::own::Own;
use crate::sph::pairs::{self, get, packed, splat_fields, vector, with_dimension, Records, RowGeometry};
use std::ops::Range;

/// Numbers of an inverse matrix, by rows of three.
pub const SQUARE: usize = 9;

struct Forward<'a, R, const D: usize> {
    step: &'a Step<R>,
    /// Of [`super::evolution`].
    records: Records<'a, R>,
    density: Records<'a, R>,
    of_term: Own<'a, R>,
    inverse: Option<Own<'a, R>>,
}

impl<R: Real, const D: usize> RowKernel<R> for Forward<'_, R, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let list = &*self.step.list;
        let geometry = RowGeometry::<L, D>::new(&self.step.model);
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let here = splat_fields::<L>(self.records.of(i), WIDTH);
            let own = L::splat(self.density.of(i)[0]);
            let (mut matrix, mut climb) = ([[L::zero(); D]; D], [L::zero(); D]);
            for (names, mask) in pairs::row::<L>(list, i) {
                let there = self.records.fields(WIDTH, names);
                let (r, square) = geometry.difference::<true>(&here[0][..D], &there[0][..D]);
                let weight = get(&there, 2 * D) * mask.apply(geometry.kernel.slope(square));
                let rise = weight * (self.density.numbers(names) - own);
                for a in 0..D {
                    climb[a] = rise.mul_add(r[a], climb[a]);
                    let along = -(weight * r[a]);
                    for b in a..D {
                        matrix[a][b] = along.mul_add(r[b], matrix[a][b]);
                    }
                }
            }
            let matrix: [[f64; D]; D] = array(|a| array(|b| matrix[a.min(b)][a.max(b)].sum().f64()));
            let climb: [f64; D] = array(|a| climb[a].sum().f64());
            let inverse = inverse(&matrix);
            for a in 0..D {
                let gradient = (0..D).map(|b| inverse[a][b] * climb[b]).sum();
                self.of_term.set(i * TERM_WIDTH + 1 + a, R::of(gradient));
                if let Some(to) = &self.inverse {
                    (0..D).for_each(|b| to.set(i * SQUARE + 3 * a + b, R::of(inverse[a][b])));
                }
            }
        }
    }
}

/// The inverse of a symmetric matrix by cofactors; 0 where its determinant is too small.
#[inline(always)]
fn inverse<const D: usize>(matrix: &[[f64; D]; D]) -> [[f64; D]; D] {
    let m = |a: usize, b: usize| matrix[a % D][b % D];
    // The cyclic indices give the sign in 3D.
    let cofactors: [[f64; D]; D] = array(|a| {
        array(|b| match D {
            2 if a == b => m(a + 1, b + 1),
            2 => -m(a, b),
            _ => m(a + 1, b + 1) * m(a + 2, b + 2) - m(a + 1, b + 2) * m(a + 2, b + 1),
        })
    });
    let determinant: f64 = (0..D).map(|b| matrix[0][b] * cofactors[0][b]).sum();
    let factor = if determinant > LEAST_DETERMINANT { 1.0 / determinant } else { 0.0 };
    array(|a| array(|b| factor * cofactors[a][b]))
}

/// Writes the gradients into the records of the density's term, and the inverses of A where they are wanted.
pub fn forward<R: Real>(
    step: &Step<R>,
    records: &[R],
    density: &[R],
    of_term: &mut [R],
    mut inverse: Option<&mut [R]>,
) {
    let (n, d) = (step.model.particles(), step.model.layout.dimension);
    {
        let (records, density) = (Records::new(records, WIDTH, n), Records::new(density, 1, n));
        let (of_term, inverse) = (Own::new(&mut *of_term), inverse.as_mut());
        let inverse = inverse.map(|inverse| Own::new(inverse));
        with_dimension!(d, |D| run_rows(
            &Forward::<R, D> { step, records, density, of_term, inverse },
            step.list.fluid_rows.len(),
        ));
    }
    step.model.refresh_records(of_term, TERM_WIDTH, 1, d);
}

struct Backward<'a, R, const D: usize> {
    step: &'a Step<R>,
    records: Records<'a, R>,
    /// Density and g.
    of_term: Records<'a, R>,
    /// Nothing and h, 0 for walls.
    solved: Records<'a, R>,
    mass: Masses<'a, R>,
    moved_bar: Own<'a, R>,
}

impl<R: Real, const D: usize> RowKernel<R> for Backward<'_, R, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let geometry = RowGeometry::<L, D>::new(model);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let record = self.records.of(i);
            let here = splat_fields::<L>(record, WIDTH);
            let of_own = splat_fields::<L>(self.of_term.of(i), TERM_WIDTH);
            let solved = splat_fields::<L>(self.solved.of(i), TERM_WIDTH);
            let (own, g, h): (L, [L; D], [L; D]) = (of_own[0][0], vector(&of_own, 1), vector(&solved, 1));
            let (mut position, mut density, mut volume) = ([L::zero(); D], L::zero(), L::zero());
            for (names, mask) in pairs::row::<L>(list, i) {
                let (there, of_other) = (self.records.fields(WIDTH, names), self.of_term.groups::<L, 1>(names));
                let solved = self.solved.groups::<L, 1>(names);
                let (their_g, their_h): ([L; D], [L; D]) = (vector(&of_other, 1), vector(&solved, 1));
                let (r, square) = geometry.difference::<true>(&here[0][..D], &there[0][..D]);
                let (_, slope, curvature) = geometry.kernel.all(square);
                let (slope, curvature) = (mask.apply(slope), mask.apply(curvature));
                let rise = of_other[0][0] - own;
                // (h.r) and D + g.r of both.
                let (along, beyond) = (dot(&h, &r), rise + dot(&g, &r));
                let (their_along, their_beyond) = (dot(&their_h, &r), rise + dot(&their_g, &r));
                let (v, their_v) = (get(&here, 2 * D), get(&there, 2 * D));
                let both = their_along * their_beyond;
                volume = slope.mul_add(both, volume);
                density = density - slope * (their_v * along + v * their_along);
                let radial = curvature * (their_v * along * beyond + v * both);
                for d in 0..D {
                    let of_own = their_v * (h[d] * beyond + along * g[d]);
                    let of_other = v * (their_h[d] * their_beyond + their_along * their_g[d]);
                    position[d] += radial.mul_add(r[d], slope * (of_own + of_other));
                }
            }
            let add = |field: usize, value: R| self.moved_bar.add(field * n + i, value);
            let (own_volume, volume_bar) = (record[2 * D], volume.sum());
            for d in 0..D {
                add(d, position[d].sum());
            }
            add(l.moved_density(), density.sum() - volume_bar * own_volume / self.of_term.of(i)[0]);
            if l.mass {
                add(l.moved_mass(), volume_bar * own_volume / self.mass.of(i));
            }
        }
    }
}

/// The adjoint: adds to `moved_bar`. `[records, of_term, inverse]` are what [`forward`] read and wrote; `bar` has the cotangents of g in
/// records as theirs.
pub fn backward<R: Real>(
    step: &Step<R>,
    moved: &[R],
    [records, of_term, inverse]: [&[R]; 3],
    bar: &[R],
    moved_bar: &mut [R],
) {
    let (model, n, d) = (&*step.model, step.model.particles(), step.model.layout.dimension);
    let mut solved = packed(model, TERM_WIDTH, |i, solved| {
        solved.fill(R::default());
        for a in 0..if model.is_fluid(i) { d } else { 0 } {
            solved[1 + a] = (0..d).map(|b| inverse[i * SQUARE + 3 * a + b] * bar[i * TERM_WIDTH + 1 + b]).sum();
        }
    });
    model.refresh_records(&mut solved, TERM_WIDTH, 1, d);
    let (records, of_term) = (Records::new(records, WIDTH, n), Records::new(of_term, TERM_WIDTH, n));
    let (solved, mass) = (Records::new(&solved, TERM_WIDTH, n), Masses::new(model, moved));
    let moved_bar = Own::new(moved_bar);
    with_dimension!(d, |D| run_rows(
        &Backward::<R, D> { step, records, of_term, solved, mass, moved_bar },
        pairs::all_rows(&step.list),
    ));
}
