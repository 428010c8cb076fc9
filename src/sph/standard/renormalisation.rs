//! Renormalisation of an evolved density.
//!
//! rho'_i = S_i / min(1, f_i) with S_i = sum_j m_j W_ij, f_i = sum_j V_j W_ij and j = i included, over fluid and wall
//! particles (Zhang, Hu and Adams 2017, eq. 16; JAX-SPH's `rho_renorm_fn`). At a free surface, where the kernel's support is not filled,
//! this is a Shepard average, elsewhere the plain sum. Walls keep their density,
//! but those in the sums have evolved ([`super::evolution`]).
//!
//! Adjoint, gathered: with s_i = rho'_bar_i / min(1, f_i) and q_i = -s_i rho'_i where f_i < 1, else 0 (both 0 for walls), m_bar_i =
//! sum_j s_j W, V_bar_i = sum_j q_j W and r_bar_i = sum_j (s_i m_j + s_j m_i + q_i V_j + q_j V_i) F r_ij.

use super::chain::{Masses, Step};
use crate::numerics::lanes::{lanes_of_rows, Lanes, Real};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed::Pairs;
use crate::sph::own::Own;
use crate::sph::pairs::{self, get, packed, splat_fields, with_dimension, Records, RowGeometry};
use candle_core::{Result, Tensor};
use std::ops::Range;

/// Numbers of a record: position D, mass, volume, s, q (of the adjoint).
const WIDTH: usize = 8;

/// Sums of W times two fields, j = i included.
struct Sums<'a, R, const D: usize> {
    step: &'a Step<R>,
    records: Records<'a, R>,
    /// The first of the fields: the mass before the volume, or s before q.
    from: usize,
    sums: [Own<'a, R>; 2],
    /// In the adjoint, which has the walls' rows too.
    moved_bar: Option<Own<'a, R>>,
}

impl<R: Real, const D: usize> RowKernel<R> for Sums<'_, R, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list, from) = (&*self.step.model, &*self.step.list, self.from);
        let geometry = RowGeometry::<L, D>::new(model);
        let at_zero = R::of(model.kernel.at_zero());
        let (mass, volume, s, q) = (D, D + 1, D + 2, D + 3);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let record = self.records.of(i);
            let here = splat_fields::<L>(record, WIDTH);
            let (mut first, mut second, mut position) = (L::zero(), L::zero(), [L::zero(); D]);
            for (names, mask) in pairs::row::<L>(list, i) {
                let there = self.records.fields(WIDTH, names);
                let (r, square) = geometry.difference::<true>(&here[0][..D], &there[0][..D]);
                let (w, slope, _) = geometry.kernel.all(square);
                let w = mask.apply(w);
                first = w.mul_add(get(&there, from), first);
                second = w.mul_add(get(&there, from + 1), second);
                if self.moved_bar.is_some() {
                    let own = get(&here, s).mul_add(get(&there, mass), get(&here, q) * get(&there, volume));
                    let other = get(&there, s).mul_add(get(&here, mass), get(&there, q) * get(&here, volume));
                    let along = mask.apply(slope * (own + other));
                    for d in 0..D {
                        position[d] = along.mul_add(r[d], position[d]);
                    }
                }
            }
            self.sums[0].set(i, first.sum() + at_zero * record[from]);
            self.sums[1].set(i, second.sum() + at_zero * record[from + 1]);
            if let Some(moved_bar) = &self.moved_bar {
                (0..D).for_each(|d| moved_bar.add(d * model.particles() + i, position[d].sum()));
            }
        }
    }
}

/// Two sums for each particle with a row, `[N]` each.
fn sums<R: Real>(step: &Step<R>, records: &[R], is_adjoint: bool, moved_bar: Option<&mut [R]>) -> [Buffer<R>; 2] {
    let (model, list, n) = (&*step.model, &*step.list, step.model.particles());
    let mut sums = [model.scratch.buffers.buffer(n), model.scratch.buffers.buffer(n)];
    let rows = if is_adjoint { pairs::all_rows(list) } else { list.fluid_rows.len() };
    let from = model.layout.dimension + if is_adjoint { 2 } else { 0 };
    {
        let [first, second] = &mut sums;
        let (sums, moved_bar) = ([Own::new(first), Own::new(second)], moved_bar.map(Own::new));
        let records = Records::new(records, WIDTH, n);
        with_dimension!(model.layout.dimension, |D| run_rows(
            &Sums::<R, D> { step, records, from, sums, moved_bar },
            rows,
        ));
    }
    sums
}

/// The packed records; s and q are 0.
fn pack<R: Real>(step: &Step<R>, moved: &[R], density: &[R]) -> Buffer<R> {
    let (mass, n, d) = (Masses::new(&step.model, moved), step.model.particles(), step.model.layout.dimension);
    packed(&step.model, WIDTH, |i, record| {
        record.fill(R::default());
        (0..d).for_each(|k| record[k] = moved[k * n + i]);
        record[d] = mass.of(i);
        record[d + 1] = mass.of(i) / density[i];
    })
}

/// The forward pass, on plain numbers, in place.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], density: &mut [R]) {
    let [mass, filled] = sums(step, &pack(step, moved, density), false, None);
    for &i in &step.list.fluid_rows {
        let i = i as usize;
        density[i] = if filled[i] < R::of(1.0) { mass[i] / filled[i] } else { mass[i] };
    }
}

/// The adjoint, on plain numbers: adds to `moved_bar`, and writes the cotangent of the evolved density `[N]`.
pub fn backward<R: Real>(
    step: &Step<R>,
    moved: &[R],
    density: &[R],
    bar: &[R],
    density_bar: &mut [R],
    moved_bar: &mut [R],
) {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let (own_mass, d) = (Masses::new(model, moved), l.dimension);
    let mut records = pack(step, moved, density);
    let [mass, filled] = sums(step, &records, false, None);
    for &i in &step.list.fluid_rows {
        let (i, record) = (i as usize, &mut records[i as usize * WIDTH..][..WIDTH]);
        let open = filled[i] < R::of(1.0);
        record[d + 2] = if open { bar[i] / filled[i] } else { bar[i] };
        record[d + 3] = if open { -(record[d + 2] * mass[i] / filled[i]) } else { R::default() };
    }
    // s and q.
    model.refresh_records(&mut records, WIDTH, d + 2, 2);
    let [mass_bar, volume_bar] = sums(step, &records, true, Some(moved_bar));
    for i in 0..n {
        density_bar[i] = R::default();
        if model.is_fluid(i) || step.list.count[i] > 0 {
            density_bar[i] -= volume_bar[i] * own_mass.of(i) / (density[i] * density[i]);
            if l.mass {
                moved_bar[l.moved_mass() * n + i] += mass_bar[i] + volume_bar[i] / density[i];
            }
        }
    }
}

/// The renormalised density `[1, N]`, by candle's operators.
pub fn composed<R: Real>(step: &Step<R>, pairs: &Pairs, mass: &Tensor, density: &Tensor) -> Result<Tensor> {
    let kernel = &step.model.kernel;
    let w = kernel.composed(&pairs.distance)?.0.mul(&pairs.mask)?;
    let volume = mass.div(density)?;
    let sum = |x: &Tensor| pairs.other(x)?.mul(&w)?.sum(2)? + x.affine(kernel.at_zero(), 0.0)?;
    let filled = sum(&volume)?;
    sum(mass)?.div(&filled.minimum(&filled.ones_like()?)?)
}
