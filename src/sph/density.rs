//! Density by summation.
//!
//! rho_i = m_i sum_j W(|r_i - r_j|), j = i included, over fluid and wall particles (Hu and Adams 2007,
//! eq. 5; JAX-SPH's `rho_summation`). Only fluid particles have a row; walls get theirs from
//! [`super::primitives`]. Adjoint, gathered: with b_i = rho_bar_i m_i (0 for walls),
//! r_bar_i = sum_j (b_i + b_j) F_ij r_ij and m_bar_i = rho_bar_i rho_i / m_i.

use super::composed;
use super::pairs::{self, pack_positions, Masses, RowGeometry};
use super::step::{input, output, read, tensor, Step};
use crate::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]` -> density `[1, N]`, 0 for walls.
pub struct Density<R>(pub Arc<Step<R>>);

struct Forward<'a, R, const D: usize> {
    step: &'a Step<R>,
    position: &'a [R],
    mass: Masses<'a, R>,
    density: Shared<'a, R>,
}

impl<R: Real, const D: usize> RowKernel<R> for Forward<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let kernel = model.kernel.lanes::<L>();
        let geometry = RowGeometry::<L, D>::new(&model.domain);
        let own = R::of(model.kernel.at_zero());
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let here = geometry.splat(self.position, i);
            let mut sum = L::zero();
            for (index, mask) in pairs::row::<L>(list, i) {
                // SAFETY: `row` gives COUNT valid particle numbers; positions are records of 4.
                let there = unsafe { L::gather4(self.position.as_ptr(), 4, index) };
                let (_, r2) = geometry.difference(&here, &there);
                sum += mask.apply(kernel.value(r2));
            }
            // SAFETY: each fluid row writes its own particle.
            unsafe { self.density.set(i, self.mass.of(i) * (own + sum.sum())) };
        }
    }
}

/// The forward pass, on plain numbers.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], density: &mut [R]) {
    let model = &*step.model;
    let n = model.particles();
    let mut position = model.scratch.take(4 * n);
    pack_positions(model, moved, None, &mut position);
    let mass = Masses::new(model, moved);
    macro_rules! go {
        ($d:literal) => {
            run_rows(
                &Forward::<R, $d> { step, position: &position, mass, density: Shared::new(density) },
                step.list.fluid_rows.len(),
            )
        };
    }
    if model.layout.dimension == 2 {
        go!(2)
    } else {
        go!(3)
    }
    model.scratch.give_back(position);
}

struct Backward<'a, R, const D: usize> {
    step: &'a Step<R>,
    /// Positions and b, `[N, 4]`: x y [z] b.
    position: &'a [R],
    moved_bar: Shared<'a, R>,
}

impl<R: Real, const D: usize> RowKernel<R> for Backward<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let n = model.particles();
        let kernel = model.kernel.lanes::<L>();
        let geometry = RowGeometry::<L, D>::new(&model.domain);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let here = geometry.splat(self.position, i);
            let mut sum = [L::zero(); D];
            for (index, mask) in pairs::row::<L>(list, i) {
                // SAFETY: as in the forward pass.
                let there = unsafe { L::gather4(self.position.as_ptr(), 4, index) };
                let (dr, r2) = geometry.difference(&here, &there);
                let factor = mask.apply((here[D] + there[D]) * kernel.slope(r2));
                for d in 0..D {
                    sum[d] = factor.mul_add(dr[d], sum[d]);
                }
            }
            for d in 0..D {
                // SAFETY: each row writes its own particle.
                unsafe { self.moved_bar.set(d * n + i, sum[d].sum()) };
            }
        }
    }
}

/// The adjoint, on plain numbers: overwrites the position and mass rows of `moved_bar`, which must be zero elsewhere.
pub fn backward<R: Real>(step: &Step<R>, moved: &[R], density: &[R], density_bar: &[R], moved_bar: &mut [R]) {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let mut position = model.scratch.take(4 * n);
    let mass = Masses::new(model, moved);
    let b = |i: usize| if model.is_fluid(i) { density_bar[i] * mass.of(i) } else { R::default() };
    pack_positions(model, moved, Some(&b), &mut position);
    macro_rules! go {
        ($d:literal) => {
            run_rows(
                &Backward::<R, $d> { step, position: &position, moved_bar: Shared::new(moved_bar) },
                pairs::all_rows(&step.list),
            )
        };
    }
    if l.dimension == 2 {
        go!(2)
    } else {
        go!(3)
    }
    model.scratch.give_back(position);
    if l.mass {
        for i in 0..n {
            if model.is_fluid(i) {
                moved_bar[l.moved_mass() * n + i] = density_bar[i] * density[i] / mass.of(i);
            }
        }
    }
}

impl<R: Real> CustomOp1 for Density<R> {
    fn name(&self) -> &'static str {
        "density"
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        let n = self.0.model.particles();
        let mut density = vec![R::default(); n];
        forward(&self.0, input(s, l)?, &mut density);
        Ok(output(density, (1, n)))
    }
    fn bwd(&self, moved: &Tensor, density: &Tensor, density_bar: &Tensor) -> Result<Option<Tensor>> {
        let (rows, n) = (self.0.model.layout.moved_rows(), self.0.model.particles());
        let mut moved_bar = vec![R::default(); rows * n];
        read(moved, |m| {
            read(density, |rho| {
                read(&density_bar.contiguous()?, |bar| {
                    backward(&self.0, m, rho, bar, &mut moved_bar);
                    Ok(())
                })
            })
        })?;
        Ok(Some(tensor(moved_bar, rows, n)?))
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(step: &Step<R>, pairs: &composed::Pairs, moved: &Tensor) -> Result<Tensor> {
    let w = composed::quintic(&step.model.kernel, &pairs.distance)?.mul(&pairs.mask)?;
    let sum = w.sum(2)?.affine(1.0, step.model.kernel.at_zero())?;
    let mass = composed::mass(step, moved)?;
    mass.mul(&sum)?.mul(&pairs.is_fluid)
}
