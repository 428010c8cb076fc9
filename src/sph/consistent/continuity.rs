//! The pressure after a step: weakly compressible continuity, with diffusion.
//!
//! ```text
//!   p_i' = -c^2 rho div u + w.grad p + 2 delta c dx sum_j V_j (-F_ij) [p_j - p_i + (grad p_i + grad p_j).(r_i - r_j) / 2]
//! ```
//!
//! (Antuono, Colagrossi, Marrone and Molteni 2010, eq. 9, for the pressure; the bracket leaves the smooth part of p alone; for a
//! dummy particle j it is p_j - p_i), p_i += dt p_i', and the mean over the fluid is subtracted: only differences of p act.
//!
//! The bracket of (j, i) is that of (i, j) with the other sign, so with D_i the sum and x_ij = D_bar_i V_j - D_bar_j V_i the
//! pair adds x_ij (-F_ij) bracket_ij to the scalar product, and row i sums its derivatives by i's own fields.

use super::blocks::{counts, gather, get, position, width, Place};
use super::geometry::Geometry;
use super::kept::Kept;
use super::kinds::{rows, PRESSURE};
use super::stencil::monomials;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::sph::pairs::{stride, RowGeometry};
use std::ops::Range;

/// Records: position D, p, V, grad p D, and for the adjoint D_bar.
const fn record_fields(d: usize) -> usize {
    2 * d + 3
}

struct Pass<'a, R, const D: usize, const G: usize> {
    geometry: Geometry<'a, R>,
    records: &'a [R],
    slope: &'a [R],
    /// Sums D_i, `[blocks, width]`; backward: cotangents of p, V, grad p, r of the fluid, `[blocks, 2 + 2 D, width]`.
    sums: Shared<'a, R>,
    /// Cotangents of p and r of dummy particles.
    known_bar: Shared<'a, R>,
    mode: Mode,
}

#[derive(Clone, Copy, PartialEq)]
enum Mode {
    Forward,
    Fluid,
    Solid,
}

impl<R: Real, const D: usize, const G: usize> Pass<'_, R, D, G> {
    #[inline(always)]
    fn forward<L: Lanes<Real = R>>(&self, block: usize, part: usize) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let kernel = geometry.model.kernel.lanes::<L>();
        let pairs = RowGeometry::<L, D>::new(&geometry.model.domain, geometry.model.kernel.cutoff());
        let (fluid, wall) = (&geometry.blocks.fluid, &geometry.blocks.wall);
        let half = L::splat(R::of(0.5));
        let place = block * width + part;
        // SAFETY (of every gather and load): tables name particles only; F is kept for every pair.
        let own = unsafe { gather::<L, G>(self.records.as_ptr(), fluid.members[place..].as_ptr()) };
        let mut sum = L::zero();
        let at = block * fluid.capacity * width + part;
        for k in 0..fluid.depth[block] as usize {
            let index = unsafe { fluid.index.as_ptr().add(at + k * width) };
            let f = unsafe { L::load(self.slope.as_ptr().add(at + k * width)) };
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
            let (r, _) = pairs.difference::<true>(&position::<L, D, G>(&own), &position::<L, D, G>(&other));
            let mut along = L::zero();
            for d in 0..D {
                along = (get(&own, D + 2 + d) + get(&other, D + 2 + d)).mul_add(r[d], along);
            }
            let bracket = half.mul_add(along, get(&other, D) - get(&own, D));
            sum = (-(get(&other, D + 1) * f)).mul_add(bracket, sum);
        }
        let at = block * wall.capacity * width + part;
        for k in 0..wall.depth[block] as usize {
            let index = unsafe { wall.index.as_ptr().add(at + k * width) };
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
            let (_, r2) = pairs.difference::<true>(&position::<L, D, G>(&own), &position::<L, D, G>(&other));
            // Points on the surface have no volume.
            let weight = get(&other, D + 1) * kernel.slope(r2);
            sum = (-weight).mul_add(get(&other, D) - get(&own, D), sum);
        }
        // SAFETY: each block writes its own places.
        unsafe { self.sums.store(place, sum) };
    }

    #[inline(always)]
    fn fluid<L: Lanes<Real = R>>(&self, block: usize, part: usize) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let kernel = geometry.model.kernel.lanes::<L>();
        let pairs = RowGeometry::<L, D>::new(&geometry.model.domain, geometry.model.kernel.cutoff());
        let (fluid, wall) = (&geometry.blocks.fluid, &geometry.blocks.wall);
        let half = L::splat(R::of(0.5));
        let place = block * width + part;
        // SAFETY (of every gather): tables name particles only.
        let own = unsafe { gather::<L, G>(self.records.as_ptr(), fluid.members[place..].as_ptr()) };
        let own_bar = get(&own, 2 * D + 2);
        let (mut p_bar, mut v_bar) = (L::zero(), L::zero());
        let (mut g_bar, mut r_bar) = ([L::zero(); D], [L::zero(); D]);
        let at = block * fluid.capacity * width + part;
        for k in 0..fluid.depth[block] as usize {
            let index = unsafe { fluid.index.as_ptr().add(at + k * width) };
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
            let (r, r2) = pairs.difference::<true>(&position::<L, D, G>(&own), &position::<L, D, G>(&other));
            let (_, f, g) = kernel.all(r2);
            let (mut along, mut slopes) = (L::zero(), [L::zero(); D]);
            for d in 0..D {
                slopes[d] = half * (get(&own, D + 2 + d) + get(&other, D + 2 + d));
                along = slopes[d].mul_add(r[d], along);
            }
            let bracket = along + (get(&other, D) - get(&own, D));
            let other_bar = get(&other, 2 * D + 2);
            let x = own_bar * get(&other, D + 1) - other_bar * get(&own, D + 1);
            let weight = -(x * f);
            p_bar = p_bar - weight;
            // V_i is in the other's sum, whose bracket has the other sign.
            v_bar = (other_bar * f).mul_add(bracket, v_bar);
            let radial = -(x * bracket * g);
            let half_weight = half * weight;
            for d in 0..D {
                g_bar[d] = half_weight.mul_add(r[d], g_bar[d]);
                r_bar[d] += weight.mul_add(slopes[d], radial * r[d]);
            }
        }
        let at = block * wall.capacity * width + part;
        let count = counts::<L>(&wall.count[place..]);
        for k in 0..wall.depth[block] as usize {
            let index = unsafe { wall.index.as_ptr().add(at + k * width) };
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
            let (r, r2) = pairs.difference::<true>(&position::<L, D, G>(&own), &position::<L, D, G>(&other));
            let (_, f, g) = kernel.all(r2);
            // Where a particle stands in for the neighbours that it lacks, nothing may be counted.
            let x = L::splat(R::of(k as f64)).select_less(count, own_bar * get(&other, D + 1), L::zero());
            p_bar = (x * f) + p_bar;
            let radial = -(x * (get(&other, D) - get(&own, D)) * g);
            for d in 0..D {
                r_bar[d] = radial.mul_add(r[d], r_bar[d]);
            }
        }
        let to = block * (2 + 2 * D) * width + part;
        // SAFETY: each block writes its own rows.
        unsafe {
            self.sums.store(to, p_bar);
            self.sums.store(to + width, v_bar);
            for d in 0..D {
                self.sums.store(to + (2 + d) * width, g_bar[d]);
                self.sums.store(to + (2 + D + d) * width, r_bar[d]);
            }
        }
    }

    #[inline(always)]
    fn solid<L: Lanes<Real = R>>(&self, block: usize, part: usize) {
        let (geometry, width) = (&self.geometry, width::<R>());
        let (n, l) = (geometry.model.particles(), geometry.model.layout);
        let kernel = geometry.model.kernel.lanes::<L>();
        let pairs = RowGeometry::<L, D>::new(&geometry.model.domain, geometry.model.kernel.cutoff());
        let table = &geometry.blocks.solid;
        let place = block * width + part;
        // SAFETY (of every gather): tables name particles only.
        let own = unsafe { gather::<L, G>(self.records.as_ptr(), table.members[place..].as_ptr()) };
        let (mut p_bar, mut r_bar) = (L::zero(), [L::zero(); D]);
        let at = block * table.capacity * width + part;
        for k in 0..table.depth[block] as usize {
            let index = unsafe { table.index.as_ptr().add(at + k * width) };
            let other = unsafe { gather::<L, G>(self.records.as_ptr(), index) };
            let (r, r2) = pairs.difference::<true>(&position::<L, D, G>(&own), &position::<L, D, G>(&other));
            let (_, f, g) = kernel.all(r2);
            let x = get(&other, 2 * D + 2) * get(&own, D + 1);
            p_bar = p_bar - x * f;
            let radial = -(x * (get(&own, D) - get(&other, D)) * g);
            for d in 0..D {
                r_bar[d] = radial.mul_add(r[d], r_bar[d]);
            }
        }
        // SAFETY: each place writes its own particle.
        let add = |row: usize, i: usize, bar: R| unsafe { self.known_bar.add(row * n + i, bar) };
        for d in 0..D {
            table.scatter(place, r_bar[d], |i, bar| add(d, i, bar));
        }
        table.scatter(place, p_bar, |i, bar| add(l.pressure(), i, bar));
    }
}

impl<R: Real, const D: usize, const G: usize> RowKernel<R> for Pass<'_, R, D, G> {
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for block in rows {
            let mut part = 0;
            while part < width::<R>() {
                match self.mode {
                    Mode::Forward => self.forward::<L>(block, part),
                    Mode::Fluid => self.fluid::<L>(block, part),
                    Mode::Solid => self.solid::<L>(block, part),
                }
                part += L::COUNT;
            }
        }
    }
}

/// Records of all particles; `bar` gives D_bar of places.
fn pack<R: Real>(geometry: &Geometry<'_, R>, known: &[R], derivatives: &[R], bar: Option<&[R]>, records: &mut [R]) {
    let (model, fits) = (geometry.model, &geometry.model.fits);
    let (n, l) = (model.particles(), model.layout);
    let (d, fields) = (l.dimension, l.fields());
    let q = monomials(d);
    let width = stride(record_fields(d));
    let volume = R::of((0..d).fold(1.0, |v, _| v * fits.spacing));
    for (i, record) in records.chunks_exact_mut(width).enumerate() {
        for k in 0..d {
            record[k] = known[k * n + i];
            record[d + 2 + k] = R::default();
        }
        record[d] = known[l.pressure() * n + i];
        // Dummy particles take part in the pressure's fit, points on the surface do not.
        record[d + 1] = volume * fits.weights[4 * i + PRESSURE];
        record[2 * d + 2] = R::default();
    }
    let scale = R::of(1.0 / fits.spacing);
    let fluid = &geometry.blocks.fluid;
    for place in 0..fluid.places {
        let at = Place::of::<R>(place, rows(d, fields));
        let record = &mut records[fluid.members[place] as usize * width..][..width];
        record[d + 1] = derivatives[at.row(fields * q)];
        for k in 0..d {
            record[d + 2 + k] = derivatives[at.row(d * q + k)] * scale;
        }
        if let Some(bar) = bar {
            record[2 * d + 2] = bar[place];
        }
    }
}

macro_rules! sizes {
    ($dimension:expr, $go:ident) => {
        match $dimension {
            2 => $go!(2, 2),
            _ => $go!(3, 3),
        }
    };
}

/// What multiplies D_i in p'.
fn diffusion<R: Real>(geometry: &Geometry<'_, R>) -> R {
    let fits = &geometry.model.fits;
    R::of(2.0 * fits.delta * fits.sound_speed * fits.spacing)
}

/// c^2 rho.
fn stiffness<R: Real>(geometry: &Geometry<'_, R>) -> R {
    let fits = &geometry.model.fits;
    R::of(geometry.model.equation_of_state.reference_density * fits.sound_speed * fits.sound_speed)
}

/// known `[F, N]`, derivatives -> the new pressure `[1, N]`, 0 for walls.
pub fn forward<R: Real>(
    geometry: &Geometry<'_, R>,
    known: &[R],
    derivatives: &[R],
    kept: &Kept<R>,
    pressure: &mut [R],
) {
    let (model, fits) = (geometry.model, &geometry.model.fits);
    let (n, l) = (model.particles(), model.layout);
    let (d, fields) = (l.dimension, l.fields());
    let q = monomials(d);
    let fluid = &geometry.blocks.fluid;
    let buffers = &model.scratch.buffers;
    let mut records = buffers.buffer(stride(record_fields(d)) * n);
    pack(geometry, known, derivatives, None, &mut records);
    let mut sums = buffers.buffer(fluid.members.len());
    macro_rules! go {
        ($d:literal, $g:literal) => {{
            const { assert!(4 * $g == stride(record_fields($d))) };
            let (sums, known_bar) = (Shared::new(&mut sums), Shared::new(&mut []));
            let (mode, slope) = (Mode::Forward, kept.slope.as_slice());
            run_rows(
                &Pass::<R, $d, $g> { geometry: *geometry, records: &records, slope, sums, known_bar, mode },
                fluid.blocks(),
            );
        }};
    }
    sizes!(d, go);
    let (scale, dt) = (R::of(1.0 / fits.spacing), R::of(geometry.times.now));
    let (diffusion, stiffness) = (diffusion(geometry), stiffness(geometry));
    let mut mean = 0.0;
    pressure.fill(R::default());
    for place in 0..fluid.places {
        let at = Place::of::<R>(place, rows(d, fields));
        let i = fluid.members[place] as usize;
        let (mut divergence, mut carried) = (R::default(), R::default());
        for k in 0..d {
            divergence += derivatives[at.row(k * q + k)];
            carried += derivatives[at.row(fields * q + 1 + k)] * derivatives[at.row(d * q + k)];
        }
        let rate = (carried - stiffness * divergence) * scale + diffusion * sums[place];
        let p = known[l.pressure() * n + i] + dt * rate;
        mean += p.f64();
        pressure[i] = p;
    }
    let mean = R::of(mean / fluid.places.max(1) as f64);
    for place in 0..fluid.places {
        pressure[fluid.members[place] as usize] -= mean;
    }
}

/// The adjoint: adds to the cotangents of `known` and of the derivatives.
pub fn backward<R: Real>(
    geometry: &Geometry<'_, R>,
    known: &[R],
    derivatives: &[R],
    kept: &Kept<R>,
    pressure_bar: &[R],
    known_bar: &mut [R],
    derivatives_bar: &mut [R],
) {
    let (model, fits) = (geometry.model, &geometry.model.fits);
    let (n, l) = (model.particles(), model.layout);
    let (d, fields) = (l.dimension, l.fields());
    let q = monomials(d);
    let fluid = &geometry.blocks.fluid;
    let buffers = &model.scratch.buffers;
    let mut mean = 0.0;
    for place in 0..fluid.places {
        mean += pressure_bar[fluid.members[place] as usize].f64();
    }
    let mean = R::of(mean / fluid.places.max(1) as f64);
    let (scale, dt) = (R::of(1.0 / fits.spacing), R::of(geometry.times.now));
    let (diffusion, stiffness) = (diffusion(geometry), stiffness(geometry));
    let mut bar = buffers.buffer(fluid.members.len());
    bar.fill(R::default());
    for place in 0..fluid.places {
        let at = Place::of::<R>(place, rows(d, fields));
        let i = fluid.members[place] as usize;
        let p_bar = pressure_bar[i] - mean;
        known_bar[l.pressure() * n + i] += p_bar;
        let rate_bar = dt * p_bar;
        bar[place] = diffusion * rate_bar;
        let rate_bar = rate_bar * scale;
        for k in 0..d {
            derivatives_bar[at.row(k * q + k)] -= stiffness * rate_bar;
            let (shift, slope) = (at.row(fields * q + 1 + k), at.row(d * q + k));
            derivatives_bar[shift] += derivatives[slope] * rate_bar;
            derivatives_bar[slope] += derivatives[shift] * rate_bar;
        }
    }
    let mut records = buffers.buffer(stride(record_fields(d)) * n);
    pack(geometry, known, derivatives, Some(&bar), &mut records);
    let mut sums = buffers.buffer((2 + 2 * d) * fluid.members.len());
    macro_rules! go {
        ($d:literal, $g:literal) => {{
            let mut pass = Pass::<R, $d, $g> {
                geometry: *geometry,
                records: &records,
                slope: &kept.slope,
                sums: Shared::new(&mut sums),
                known_bar: Shared::new(known_bar),
                mode: Mode::Fluid,
            };
            run_rows(&pass, fluid.blocks());
            pass.mode = Mode::Solid;
            run_rows(&pass, geometry.blocks.solid.blocks());
        }};
    }
    sizes!(d, go);
    for place in 0..fluid.places {
        let (at, of) = (Place::of::<R>(place, rows(d, fields)), Place::of::<R>(place, 2 + 2 * d));
        let i = fluid.members[place] as usize;
        known_bar[l.pressure() * n + i] += sums[of.row(0)];
        derivatives_bar[at.row(fields * q)] += sums[of.row(1)];
        for k in 0..d {
            derivatives_bar[at.row(d * q + k)] += sums[of.row(2 + k)] * scale;
            known_bar[k * n + i] += sums[of.row(2 + d + k)];
        }
    }
}
