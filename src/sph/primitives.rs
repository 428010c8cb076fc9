//! Fields of all particles before the pair pass: the fluid's own, and the walls' extrapolated from it.
//!
//! Generalised wall boundary condition (Adami, Hu and Adams 2012, eq. 22-27): with Shepard averages over the
//! fluid neighbours j of a wall particle, <x> = sum_j x_j W_ij / (sum_j W_ij + eps),
//!
//! * velocity 2 u_wall - <u> (no slip), transport shift 2 w_wall - <w>;
//! * pressure <p>, and density from it by the equation of state;
//! * temperature wall_constant + wall_factor <T>, with T before this step's conduction as in JAX-SPH:
//!   adiabatic (0, 1), held in the dummy particles (T_hot, 0), or held on the surface (2 T_hot, -1), which
//!   puts the isotherm where the wall is instead of half a spacing behind it.
//!
//! eps = 2.2e-16 (f64's machine epsilon, in f32 too: the sums it guards have the same size there).
//! Their eq. 27 adds (g - a_wall).sum(rho r W); the scenes here have no body force across a wall.
//!
//! Adjoint: wall rows compute D = cotangents of their weighted sums; fluid rows gather them from the walls
//! that they reach.

use super::composed;
use super::pairs::{self, pack_positions, RowGeometry};
use super::step::{input, output, read, tensor, Step};
use crate::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// Guard of the Shepard sums.
const EPSILON: f64 = f64::EPSILON;

/// moved `[M, N]`, density `[1, N]` (fluid) -> primitives `[C, N]`.
pub struct Primitives<R>(pub Arc<Step<R>>);

/// Most fields that walls average: velocity 3, shift 3, pressure, temperature.
const MOST: usize = 8;

/// The fields that walls average, in this order: velocity D, [shift D], pressure, [temperature].
struct Averaged {
    count: usize,
    pressure: usize,
}

fn averaged<R: Real>(step: &Step<R>) -> Averaged {
    let l = step.model.layout;
    let pressure = l.dimension * (1 + l.transport as usize);
    Averaged { count: pressure + 1 + l.heat as usize, pressure }
}

/// Packs the averaged fields of the fluid as `[MOST, N]` rows.
fn pack_fields<R: Real>(step: &Step<R>, moved: &[R], density: &[R], fields: &mut [R]) {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let set = averaged(step);
    let mut copy = |to: usize, from: usize, count: usize| {
        fields[to * n..(to + count) * n].copy_from_slice(&moved[from * n..(from + count) * n]);
    };
    copy(0, l.velocity(), l.dimension);
    if l.transport {
        copy(l.dimension, l.moved_shift(), l.dimension);
    }
    if l.heat {
        copy(set.pressure + 1, l.moved_old_temperature(), 1);
    }
    for i in 0..n {
        fields[set.pressure * n + i] = model.equation_of_state.pressure(density[i]);
    }
}

struct Forward<'a, R, const D: usize> {
    step: &'a Step<R>,
    position: &'a [R],
    fields: &'a [R],
    moved: &'a [R],
    primitives: Shared<'a, R>,
}

/// Values of a wall particle with these averages.
#[inline(always)]
fn wall_values<R: Real>(step: &Step<R>, moved: &[R], average: &[R; MOST], i: usize, mut set: impl FnMut(usize, R)) {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let fields = averaged(step);
    let two = R::of(2.0);
    for d in 0..l.dimension {
        set(l.primitive_velocity() + d, two * moved[(l.velocity() + d) * n + i] - average[d]);
        if l.transport {
            let w = moved[(l.moved_shift() + d) * n + i];
            set(l.primitive_shift() + d, two * w - average[l.dimension + d]);
        }
    }
    set(0, model.equation_of_state.density(average[fields.pressure]));
    if let Some(heat) = &model.heat {
        let t = average[fields.pressure + 1];
        set(l.primitive_temperature(), heat.wall_constant[i] + heat.wall_factor[i] * t);
    }
}

impl<R: Real, const D: usize> RowKernel<R> for Forward<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let n = model.particles();
        for row in rows {
            let i = list.wall_rows[row] as usize;
            let (_, average) = wall_averages::<R, L, D>(self.step, self.position, self.fields, i);
            // SAFETY: each wall row writes its own particle.
            wall_values(self.step, self.moved, &average, i, |field, value| unsafe {
                self.primitives.set(field * n + i, value)
            });
        }
    }
}

/// Weight and averages of a wall particle's row.
#[inline(always)]
fn wall_averages<R: Real, L: Lanes<Real = R>, const D: usize>(
    step: &Step<R>,
    position: &[R],
    fields: &[R],
    i: usize,
) -> (R, [R; MOST]) {
    let (model, list) = (&*step.model, &*step.list);
    let n = model.particles();
    let kernel = model.kernel.lanes::<L>();
    let geometry = RowGeometry::<L, D>::new(&model.domain);
    let count = averaged(step).count;
    let here = geometry.splat(position, i);
    let mut weight = L::zero();
    let mut sums = [L::zero(); MOST];
    for (index, mask) in pairs::row::<L>(list, i) {
        // SAFETY: `row` gives COUNT valid particle numbers.
        unsafe {
            let there = L::gather4(position.as_ptr(), 4, index);
            let w = mask.apply(kernel.value(geometry.difference(&here, &there).1));
            weight += w;
            for (q, sum) in sums.iter_mut().enumerate().take(count) {
                *sum = w.mul_add(L::gather(fields[q * n..].as_ptr(), index), *sum);
            }
        }
    }
    let weight = weight.sum();
    (weight, averages(step, weight, &std::array::from_fn(|q| sums[q].sum())))
}

/// Sums over their guarded weight. The guard acts on the absolute temperature in JAX-SPH, hence its
/// reference here, where temperatures are differences to it.
#[inline(always)]
fn averages<R: Real>(step: &Step<R>, weight: R, sums: &[R; MOST]) -> [R; MOST] {
    let inverse = R::of(1.0) / (weight + R::of(EPSILON));
    let set = averaged(step);
    let mut average: [R; MOST] = std::array::from_fn(|q| sums[q] * inverse);
    if let Some(heat) = &step.model.heat {
        average[set.pressure + 1] -= R::of(EPSILON * heat.reference) * inverse;
    }
    average
}

/// The forward pass, on plain numbers.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], density: &[R], primitives: &mut [R]) {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let d = l.dimension;
    primitives[..n].copy_from_slice(&density[..n]);
    let mut copy = |to: usize, from: usize, count: usize| {
        primitives[to * n..(to + count) * n].copy_from_slice(&moved[from * n..(from + count) * n]);
    };
    copy(l.primitive_velocity(), l.velocity(), d);
    if l.transport {
        copy(l.primitive_shift(), l.moved_shift(), d);
    }
    if l.heat {
        copy(l.primitive_temperature(), l.moved_temperature(), 1);
    }
    if !model.has_walls() {
        return;
    }
    // Walls that no fluid reaches: averages of nothing.
    let nothing = averages(step, R::default(), &[R::default(); MOST]);
    for i in 0..n {
        if !model.is_fluid(i) && step.list.count[i] == 0 {
            wall_values(step, moved, &nothing, i, |field, value| primitives[field * n + i] = value);
        }
    }
    let mut position = model.scratch.take(4 * n);
    pack_positions(model, moved, None, &mut position);
    let mut fields = model.scratch.take(MOST * n);
    pack_fields(step, moved, density, &mut fields);
    macro_rules! go {
        ($d:literal) => {
            run_rows(
                &Forward::<R, $d> {
                    step,
                    position: &position,
                    fields: &fields,
                    moved,
                    primitives: Shared::new(primitives),
                },
                step.list.wall_rows.len(),
            )
        };
    }
    if d == 2 {
        go!(2)
    } else {
        go!(3)
    }
    model.scratch.give_back(position);
    model.scratch.give_back(fields);
}

/// Wall rows of the adjoint: cotangents of the weighted sums, `[1 + MOST, N]`, the weight's first; and the walls' own
/// position.
struct WallRows<'a, R, const D: usize> {
    step: &'a Step<R>,
    position: &'a [R],
    fields: &'a [R],
    primitives_bar: &'a [R],
    primitives: &'a [R],
    sums_bar: Shared<'a, R>,
    moved_bar: Shared<'a, R>,
}

impl<R: Real, const D: usize> RowKernel<R> for WallRows<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let kernel = model.kernel.lanes::<L>();
        let geometry = RowGeometry::<L, D>::new(&model.domain);
        let set = averaged(self.step);
        let bar = |field: usize, i: usize| self.primitives_bar[field * n + i];
        for row in rows {
            let i = list.wall_rows[row] as usize;
            let here = geometry.splat(self.position, i);
            // Cotangents of the averages.
            let mut average_bar = [R::default(); MOST];
            for d in 0..D {
                average_bar[d] = -bar(l.primitive_velocity() + d, i);
                if l.transport {
                    average_bar[D + d] = -bar(l.primitive_shift() + d, i);
                }
            }
            average_bar[set.pressure] = bar(0, i) / model.equation_of_state.slope(self.primitives[i]);
            if let Some(heat) = &model.heat {
                average_bar[set.pressure + 1] = heat.wall_factor[i] * bar(l.primitive_temperature(), i);
            }
            // The averages again: weight first, since everything is divided by it.
            let (weight, average) = wall_averages::<R, L, D>(self.step, self.position, self.fields, i);
            let inverse = R::of(1.0) / (weight + R::of(EPSILON));
            let mut weight_bar = R::default();
            for q in 0..set.count {
                weight_bar -= average_bar[q] * average[q] * inverse;
                // SAFETY: each wall row writes its own particle.
                unsafe { self.sums_bar.set((1 + q) * n + i, average_bar[q] * inverse) };
            }
            // SAFETY: as above.
            unsafe { self.sums_bar.set(i, weight_bar) };
            // The wall particle's position: e_ij = weight_bar + sum_q sums_bar_q x_q(j), r_bar = sum_j e_ij F r_ij.
            let mut sum = [L::zero(); D];
            for (index, mask) in pairs::row::<L>(list, i) {
                // SAFETY: as above.
                unsafe {
                    let there = L::gather4(self.position.as_ptr(), 4, index);
                    let (dr, r2) = geometry.difference(&here, &there);
                    let mut e = L::splat(weight_bar);
                    for (q, a) in average_bar.iter().enumerate().take(set.count) {
                        e = L::splat(*a * inverse).mul_add(L::gather(self.fields[q * n..].as_ptr(), index), e);
                    }
                    let factor = mask.apply(e * kernel.slope(r2));
                    for d in 0..D {
                        sum[d] = factor.mul_add(dr[d], sum[d]);
                    }
                }
            }
            for d in 0..D {
                // SAFETY: as above.
                unsafe { self.moved_bar.set(d * n + i, sum[d].sum()) };
            }
        }
    }
}

/// Fluid rows of the adjoint: gather from the walls in reach.
struct FluidRows<'a, R, const D: usize> {
    step: &'a Step<R>,
    position: &'a [R],
    fields: &'a [R],
    density: &'a [R],
    sums_bar: &'a [R],
    moved_bar: Shared<'a, R>,
    density_bar: Shared<'a, R>,
}

impl<R: Real, const D: usize> RowKernel<R> for FluidRows<'_, R, D> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let kernel = model.kernel.lanes::<L>();
        let geometry = RowGeometry::<L, D>::new(&model.domain);
        let set = averaged(self.step);
        for row in rows {
            let j = list.fluid_rows[row] as usize;
            let (from, to) = (list.fluid_count[j] as usize, list.count[j] as usize);
            if from == to {
                continue;
            }
            let here = geometry.splat(self.position, j);
            let mut sums = [L::zero(); MOST];
            let mut position = [L::zero(); D];
            for (index, mask) in pairs::part::<L>(list, j, from, to) {
                // SAFETY: `part` gives COUNT valid particle numbers.
                unsafe {
                    let there = L::gather4(self.position.as_ptr(), 4, index);
                    let (dr, r2) = geometry.difference(&here, &there);
                    let w = mask.apply(kernel.value(r2));
                    let mut e = L::gather(self.sums_bar.as_ptr(), index);
                    for (q, sum) in sums.iter_mut().enumerate().take(set.count) {
                        let bar = L::gather(self.sums_bar[(1 + q) * n..].as_ptr(), index);
                        *sum = w.mul_add(bar, *sum);
                        e = bar.mul_add(L::splat(self.fields[q * n + j]), e);
                    }
                    let factor = mask.apply(e * kernel.slope(r2));
                    for d in 0..D {
                        position[d] = factor.mul_add(dr[d], position[d]);
                    }
                }
            }
            // SAFETY: each fluid row writes its own particle, on top of what the copies gave.
            unsafe {
                let add = |field: usize, value: R| {
                    let place = field * n + j;
                    self.moved_bar.set(place, self.moved_bar.get(place) + value);
                };
                for d in 0..D {
                    add(d, position[d].sum());
                    add(l.velocity() + d, sums[d].sum());
                    if l.transport {
                        add(l.moved_shift() + d, sums[D + d].sum());
                    }
                }
                if l.heat {
                    add(l.moved_old_temperature(), sums[set.pressure + 1].sum());
                }
                let slope = model.equation_of_state.slope(self.density[j]);
                let value = self.density_bar.get(j) + sums[set.pressure].sum() * slope;
                self.density_bar.set(j, value);
            }
        }
    }
}

/// The adjoint, on plain numbers; `moved_bar` and `density_bar` must be zero.
pub fn backward<R: Real>(
    step: &Step<R>,
    moved: &[R],
    density: &[R],
    primitives: &[R],
    primitives_bar: &[R],
    moved_bar: &mut [R],
    density_bar: &mut [R],
) {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let d = l.dimension;
    let two = R::of(2.0);
    for i in 0..n {
        let fluid = model.is_fluid(i);
        // Fluid fields are copies; a wall's own velocity counts twice, its own temperature not at all.
        let factor = if fluid { R::of(1.0) } else { two };
        for k in 0..d {
            moved_bar[(l.velocity() + k) * n + i] = factor * primitives_bar[(l.primitive_velocity() + k) * n + i];
            if l.transport {
                moved_bar[(l.moved_shift() + k) * n + i] = factor * primitives_bar[(l.primitive_shift() + k) * n + i];
            }
        }
        if fluid {
            density_bar[i] = primitives_bar[i];
            if l.heat {
                moved_bar[l.moved_temperature() * n + i] = primitives_bar[l.primitive_temperature() * n + i];
            }
        }
    }
    if !model.has_walls() {
        return;
    }
    let mut position = model.scratch.take(4 * n);
    pack_positions(model, moved, None, &mut position);
    let mut fields = model.scratch.take(MOST * n);
    pack_fields(step, moved, density, &mut fields);
    let mut sums_bar = model.scratch.take((1 + MOST) * n);
    macro_rules! go {
        ($d:literal) => {{
            run_rows(
                &WallRows::<R, $d> {
                    step,
                    position: &position,
                    fields: &fields,
                    primitives_bar,
                    primitives,
                    sums_bar: Shared::new(&mut sums_bar),
                    moved_bar: Shared::new(moved_bar),
                },
                step.list.wall_rows.len(),
            );
            run_rows(
                &FluidRows::<R, $d> {
                    step,
                    position: &position,
                    fields: &fields,
                    density,
                    sums_bar: &sums_bar,
                    moved_bar: Shared::new(moved_bar),
                    density_bar: Shared::new(density_bar),
                },
                step.list.fluid_rows.len(),
            );
        }};
    }
    if d == 2 {
        go!(2)
    } else {
        go!(3)
    }
    model.scratch.give_back(position);
    model.scratch.give_back(fields);
    model.scratch.give_back(sums_bar);
}

impl<R: Real> CustomOp2 for Primitives<R> {
    fn name(&self) -> &'static str {
        "primitives"
    }
    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rows, n) = (self.0.model.layout.primitive_rows(), self.0.model.particles());
        let mut primitives = vec![R::default(); rows * n];
        forward(&self.0, input(s1, l1)?, input(s2, l2)?, &mut primitives);
        Ok(output(primitives, (rows, n)))
    }
    fn bwd(
        &self,
        moved: &Tensor,
        density: &Tensor,
        primitives: &Tensor,
        primitives_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (l, n) = (self.0.model.layout, self.0.model.particles());
        let mut moved_bar = vec![R::default(); l.moved_rows() * n];
        let mut density_bar = vec![R::default(); n];
        read(moved, |m| {
            read(density, |rho| {
                read(primitives, |p| {
                    read(&primitives_bar.contiguous()?, |bar| {
                        backward(&self.0, m, rho, p, bar, &mut moved_bar, &mut density_bar);
                        Ok(())
                    })
                })
            })
        })?;
        Ok((Some(tensor(moved_bar, l.moved_rows(), n)?), Some(tensor(density_bar, 1, n)?)))
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(step: &Step<R>, pairs: &composed::Pairs, moved: &Tensor, density: &Tensor) -> Result<Tensor> {
    let model = &*step.model;
    let (l, d) = (model.layout, model.layout.dimension);
    let velocity = moved.narrow(0, l.velocity(), d)?;
    let shift = if l.transport { Some(moved.narrow(0, l.moved_shift(), d)?) } else { None };
    let fluid = &pairs.is_fluid;
    let wall = fluid.affine(-1.0, 1.0)?;
    let choose = |of_fluid: &Tensor, of_wall: &Tensor| of_fluid.broadcast_mul(fluid)? + of_wall.broadcast_mul(&wall)?;
    // Weights of fluid neighbours only.
    let w = composed::quintic(&model.kernel, &pairs.distance)?.mul(&pairs.mask)?.mul(&pairs.other(fluid)?)?;
    let inverse = w.sum(2)?.affine(1.0, EPSILON)?.recip()?;
    let average = |x: &Tensor| pairs.other(x)?.broadcast_mul(&w)?.sum(2)?.broadcast_mul(&inverse);

    let eos = model.equation_of_state;
    let ratio = density.affine(1.0 / eos.reference_density, 0.0)?;
    let power = if eos.gamma == 1 { ratio } else { ratio.powf(eos.gamma as f64)? };
    let pressure = average(&power.affine(eos.reference_pressure, eos.at_vacuum())?)?;
    let power = pressure.affine(1.0 / eos.reference_pressure, -eos.at_vacuum() / eos.reference_pressure)?;
    let power = if eos.gamma == 1 { power } else { power.powf(1.0 / eos.gamma as f64)? };
    let mut rows = vec![choose(density, &power.affine(eos.reference_density, 0.0)?)?];
    rows.push(choose(&velocity, &(velocity.affine(2.0, 0.0)? - average(&velocity)?)?)?);
    if let Some(shift) = shift {
        rows.push(choose(&shift, &(shift.affine(2.0, 0.0)? - average(&shift)?)?)?);
    }
    if let Some(heat) = &model.heat {
        let n = model.particles();
        let constant = Tensor::from_vec(heat.wall_constant.clone(), (1, n), moved.device())?;
        let factor = Tensor::from_vec(heat.wall_factor.clone(), (1, n), moved.device())?;
        let old = moved.narrow(0, l.moved_old_temperature(), 1)?;
        let guard = inverse.affine(EPSILON * heat.reference, 0.0)?;
        let of_wall = (constant + factor.mul(&(average(&old)? - guard)?)?)?;
        rows.push(choose(&moved.narrow(0, l.moved_temperature(), 1)?, &of_wall)?);
    }
    Tensor::cat(&rows, 0)
}
