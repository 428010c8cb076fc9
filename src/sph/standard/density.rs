//! Density by summation.
//!
//! rho_i = m_i sum_j W(|r_i - r_j|), j = i included, over fluid and wall particles (Hu and Adams 2007,
//! eq. 5; JAX-SPH's `rho_summation`). Only fluid particles have a row; walls get theirs from
//! [`super::wall_condition`]. Adjoint, gathered: with b_i = rho_bar_i m_i (0 for walls),
//! r_bar_i = sum_j (b_i + b_j) F_ij r_ij and m_bar_i = rho_bar_i rho_i / m_i.

use super::chain::{Chain, Masses, Step};
use super::pair_cache::PairCache;
use super::records::record_fields;
use super::sweeps::Sweeps;
use super::wall_condition::pack_fluid;
use crate::numerics::candle::Operator;
use crate::numerics::lanes::{lanes_of_rows, Lanes, Real};
use crate::numerics::pool::fit;
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed;
use crate::sph::own::Own;
use crate::sph::pairs::{self, pack_positions, stride, with_dimension, Records, RowGeometry};
use candle_core::{Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]` -> density `[1, N]`, 0 for walls.
pub struct Density<R: Sweeps>(pub Arc<Chain<R>>);

struct Forward<'a, R, const D: usize> {
    step: &'a Step<R>,
    position: Records<'a, R>,
    mass: Masses<'a, R>,
    density: Own<'a, R>,
    slope: Own<'a, R>,
    moved: &'a [R],
    records: Own<'a, R>,
}

impl<R: Real, const D: usize> Forward<'_, R, D> {
    /// Sum of W over a row, whose F are kept on the way.
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> L {
        let list = &*self.step.list;
        let here = pairs::splat_fields::<L>(self.position.of(i), 4);
        let from = i * list.capacity;
        let mut sum = L::zero();
        for (k, (names, mask)) in pairs::row::<L>(list, i).enumerate() {
            let [there] = self.position.groups(names);
            let (_, r2) = geometry.difference::<EDGE>(&here[0], &there);
            let (w, f, _) = geometry.kernel.all(r2);
            sum += mask.apply(w);
            self.slope.store(from + k * L::COUNT, mask.apply(f));
        }
        sum
    }
}

impl<R: Real, const D: usize> RowKernel<R> for Forward<'_, R, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let geometry = RowGeometry::<L, D>::new(model);
        let own = R::of(model.kernel.at_zero());
        let width = stride(record_fields(D, model.layout.transport, model.layout.heat));
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let sum = match geometry.at_edge(self.position.of(i)) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            let (mass, sum) = (self.mass.of(i), own + sum.sum());
            self.density.set(i, mass * sum);
            // SAFETY: each row writes its own record.
            let record = unsafe { self.records.slice(i * width..(i + 1) * width) };
            pack_fluid(self.step, self.moved, mass, mass * sum, i, record);
        }
    }
}

/// The forward pass, on plain numbers; keeps F, and the fluid's records while they are at hand. `density` must be zero for walls. Copies have
/// what their owners have found.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], kept: &mut PairCache<R>, density: &mut [R]) {
    let (model, list) = (&*step.model, &*step.list);
    kept.make_room(model, list, moved);
    let (mass, l) = (Masses::new(model, moved), model.layout);
    let width = stride(record_fields(l.dimension, l.transport, l.heat));
    fit(&mut kept.records, width * model.particles(), model.part.is_some());
    kept.has_fluid_records = true;
    let (position, density) = (Records::new(&kept.position, 4, model.particles()), Own::new(density));
    let (slope, records) = (Own::new(&mut kept.slope), Own::new(&mut kept.records));
    with_dimension!(l.dimension, |D| {
        let kernel = Forward::<R, D> { step, position, mass, density, slope, moved, records };
        model.sweep(list, &kernel, &kernel.density, 1);
    });
}

struct Backward<'a, R, const D: usize> {
    step: &'a Step<R>,
    /// Positions and b, `[N, 4]`: x y [z] b.
    position: Records<'a, R>,
    moved_bar: Own<'a, R>,
}

impl<R: Real, const D: usize> Backward<'_, R, D> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> [L; D] {
        let here = pairs::splat_fields::<L>(self.position.of(i), 4);
        let mut sum = [L::zero(); D];
        for (names, mask) in pairs::row::<L>(&self.step.list, i) {
            let [there] = self.position.groups(names);
            let (dr, r2) = geometry.difference::<EDGE>(&here[0], &there);
            let factor = (here[0][3] + there[3]) * mask.apply(geometry.kernel.slope(r2));
            for d in 0..D {
                sum[d] = factor.mul_add(dr[d], sum[d]);
            }
        }
        sum
    }
}

impl<R: Real, const D: usize> RowKernel<R> for Backward<'_, R, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let n = model.particles();
        let geometry = RowGeometry::<L, D>::new(model);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let sum = match geometry.at_edge(self.position.of(i)) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            for d in 0..D {
                self.moved_bar.add(d * n + i, sum[d].sum());
            }
        }
    }
}

/// The adjoint, on plain numbers: adds to `moved_bar`.
pub fn backward<R: Real>(step: &Step<R>, moved: &[R], density: &[R], density_bar: &[R], moved_bar: &mut [R]) {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let mut position = model.scratch.buffers.buffer(4 * n);
    let mass = Masses::new(model, moved);
    let b = |i: usize| if model.is_fluid(i) { density_bar[i] * mass.of(i) } else { R::default() };
    pack_positions(model, moved, Some(&b), &mut position);
    let (position, rows) = (Records::new(&position, 4, n), pairs::all_rows(&step.list));
    let shared = Own::new(moved_bar);
    with_dimension!(l.dimension, |D| run_rows(&Backward::<R, D> { step, position, moved_bar: shared }, rows));
    if l.mass {
        for i in 0..n {
            if model.is_fluid(i) {
                moved_bar[l.moved_mass() * n + i] += density_bar[i] * density[i] / mass.of(i);
            }
        }
    }
}

impl<R: Sweeps> Operator<1> for Density<R> {
    type Real = R;
    const NAME: &'static str = "density";

    fn forward(&self, [moved]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let step = &self.0.step;
        let n = step.model.particles();
        let mut density = vec![R::default(); n];
        R::density(step, moved, &mut self.0.kept(), &mut density);
        Ok((density, (1, n).into()))
    }

    fn adjoint(&self, [moved]: [&[R]; 1], density: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let mut moved_bar = self.0.moved_bar();
        R::density_bar(&self.0.step, moved, density, bar, &mut moved_bar);
        Ok([Some(moved_bar)])
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(step: &Step<R>, pairs: &composed::Pairs, moved: &Tensor) -> Result<Tensor> {
    let w = step.model.kernel.composed(&pairs.distance)?.0.mul(&pairs.mask)?;
    let sum = w.sum(2)?.affine(1.0, step.model.kernel.at_zero())?;
    let mass = step.mass(moved)?;
    mass.mul(&sum)?.mul(&pairs.is_fluid)
}
