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

use super::blocks::{store, vectors, width, OfParticles, Place};
use super::geometry::{Around, Geometry};
use super::kept::Kept;
use super::kinds::{rows, PRESSURE};
use super::stencil::monomials;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::sweep::{clear, run_each, run_rows, RowKernel, STRETCH};
use crate::numerics::total::Total;
use crate::sph::own::Own;
use crate::sph::pairs::{get, stride, with_dimension, Records};
use std::ops::Range;

/// Records: position D, p, V, grad p D, and for the adjoint D_bar.
const fn record_fields(d: usize) -> usize {
    2 * d + 3
}

struct Pass<'a, R, const D: usize, const G: usize> {
    geometry: Geometry<'a, R>,
    records: Records<'a, R>,
    /// F of the fluid's pairs.
    slope: &'a [R],
    /// Sums D_i, `[blocks, width]`; backward: cotangents of p, V, grad p, r of the fluid, `[blocks, 2 + 2 D, width]`.
    sums: Own<'a, R>,
    /// Cotangents of p and r of dummy particles.
    known_bar: OfParticles<'a, R>,
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
    fn forward<L: Lanes<Real = R>>(&self, place: usize) {
        let around = Around::<L, D>::new(&self.geometry);
        let (fluid, wall) = (&self.geometry.blocks.fluid, &self.geometry.blocks.wall);
        let half = L::splat(R::of(0.5));
        let own = self.records.groups::<L, G>(fluid.own(place));
        let mut sum = L::zero();
        for (pair, f) in fluid.pairs_with::<L>(place, self.slope) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, _) = around.towards(&other, &own);
            let mut along = L::zero();
            for d in 0..D {
                along = (get(&own, D + 2 + d) + get(&other, D + 2 + d)).mul_add(r[d], along);
            }
            let bracket = half.mul_add(along, get(&other, D) - get(&own, D));
            sum = (-(get(&other, D + 1) * f)).mul_add(bracket, sum);
        }
        for pair in wall.pairs_of::<L>(place) {
            let other = self.records.groups::<L, G>(pair.names);
            let (_, r2) = around.towards(&other, &own);
            // Points on the surface have no volume.
            let weight = get(&other, D + 1) * around.kernel.slope(r2);
            sum = (-weight).mul_add(get(&other, D) - get(&own, D), sum);
        }
        store(&self.sums, Place::of::<R>(place, 1), 0, [sum]);
    }

    #[inline(always)]
    fn fluid<L: Lanes<Real = R>>(&self, place: usize) {
        let around = Around::<L, D>::new(&self.geometry);
        let (fluid, wall) = (&self.geometry.blocks.fluid, &self.geometry.blocks.wall);
        let half = L::splat(R::of(0.5));
        let own = self.records.groups::<L, G>(fluid.own(place));
        let own_bar = get(&own, 2 * D + 2);
        let (mut p_bar, mut v_bar) = (L::zero(), L::zero());
        let (mut g_bar, mut r_bar) = ([L::zero(); D], [L::zero(); D]);
        for pair in fluid.pairs_of::<L>(place) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, r2) = around.towards(&other, &own);
            let (_, f, g) = around.kernel.all(r2);
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
        let counts = wall.counts::<L>(place);
        for pair in wall.pairs_of::<L>(place) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, r2) = around.towards(&other, &own);
            let (_, f, g) = around.kernel.all(r2);
            // Where a particle stands in for the neighbours that it lacks, nothing may be counted.
            let x = pair.there(counts, own_bar * get(&other, D + 1));
            p_bar = (x * f) + p_bar;
            let radial = -(x * (get(&other, D) - get(&own, D)) * g);
            for d in 0..D {
                r_bar[d] = radial.mul_add(r[d], r_bar[d]);
            }
        }
        let to = Place::of::<R>(place, 2 + 2 * D);
        store(&self.sums, to, 0, [p_bar, v_bar]);
        store(&self.sums, to, 2, g_bar);
        store(&self.sums, to, 2 + D, r_bar);
    }

    #[inline(always)]
    fn solid<L: Lanes<Real = R>>(&self, place: usize) {
        let around = Around::<L, D>::new(&self.geometry);
        let (n, table) = (self.geometry.model.particles(), &self.geometry.blocks.solid);
        let own = self.records.groups::<L, G>(table.own(place));
        let (mut p_bar, mut r_bar) = (L::zero(), [L::zero(); D]);
        for pair in table.pairs_of::<L>(place) {
            let other = self.records.groups::<L, G>(pair.names);
            let (r, r2) = around.towards(&other, &own);
            let (_, f, g) = around.kernel.all(r2);
            let x = get(&other, 2 * D + 2) * get(&own, D + 1);
            p_bar = p_bar - x * f;
            let radial = -(x * (get(&own, D) - get(&other, D)) * g);
            for d in 0..D {
                r_bar[d] = radial.mul_add(r[d], r_bar[d]);
            }
        }
        for d in 0..D {
            self.known_bar.add(table, place, d * n, r_bar[d]);
        }
        self.known_bar.add(table, place, self.geometry.model.layout.pressure() * n, p_bar);
    }
}

impl<R: Real, const D: usize, const G: usize> RowKernel<R> for Pass<'_, R, D, G> {
    const LARGE: bool = true;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for place in vectors::<L>(rows) {
            match self.mode {
                Mode::Forward => self.forward::<L>(place),
                Mode::Fluid => self.fluid::<L>(place),
                Mode::Solid => self.solid::<L>(place),
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
    let records = Own::new(records);
    run_each(n, |i| {
        let set = |k: usize, value: R| records.set(i * width + k, value);
        for k in 0..d {
            set(k, known[k * n + i]);
            set(d + 2 + k, R::default());
        }
        set(d, known[l.pressure() * n + i]);
        // Dummy particles take part in the pressure's fit, points on the surface do not.
        set(d + 1, volume * fits.weights[4 * i + PRESSURE]);
        set(2 * d + 2, R::default());
    });
    let scale = R::of(1.0 / fits.spacing);
    let fluid = &geometry.blocks.fluid;
    run_each(fluid.places, |place| {
        let (i, at) = (fluid.particle(place), Place::of::<R>(place, rows(d, fields)));
        let set = |k: usize, value: R| records.set(i * width + k, value);
        set(d + 1, derivatives[at.row(fields * q)]);
        for k in 0..d {
            set(d + 2 + k, derivatives[at.row(d * q + k)] * scale);
        }
        if let Some(bar) = bar {
            set(2 * d + 2, bar[place]);
        }
    });
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

/// The mean of a value over all fluid particles of the flow.
fn mean<R: Real>(geometry: &Geometry<'_, R>, value: impl Fn(usize) -> R + Sync) -> R {
    let fluid = &geometry.blocks.fluid;
    let count = fluid.places.div_ceil(STRETCH);
    let mut parts = vec![Total::default(); count];
    let totals = Own::new(&mut parts);
    run_each(count, |part| {
        let places = part * STRETCH..fluid.places.min((part + 1) * STRETCH);
        totals.set(part, places.map(|place| value(fluid.particle(place)).f64()).collect());
    });
    let sum = parts.into_iter().fold(Total::default(), Total::plus);
    let count = Total { sum: fluid.places as f64, lost: 0.0 };
    let [sum, count] = geometry.model.over_ranks([sum, count]);
    R::of(sum / count.max(1.0))
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
    // V and grad p.
    model.refresh_records(&mut records, stride(record_fields(d)), d + 1, d + 1);
    let mut sums = buffers.buffer(fluid.blocks() * width::<R>());
    with_dimension!(d, |D| run_rows(
        &Pass::<R, D, { stride(record_fields(D)) / 4 }> {
            geometry: *geometry,
            records: Records::new(&records, stride(record_fields(D)), n),
            slope: &kept.slope,
            sums: Own::new(&mut sums),
            known_bar: OfParticles::new(&mut []),
            mode: Mode::Forward,
        },
        fluid.blocks(),
    ));
    let (scale, dt) = (R::of(1.0 / fits.spacing), R::of(geometry.times.now));
    let (diffusion, stiffness) = (diffusion(geometry), stiffness(geometry));
    clear(pressure);
    let pressures = Own::new(pressure);
    run_each(fluid.places, |place| {
        let (i, at) = (fluid.particle(place), Place::of::<R>(place, rows(d, fields)));
        let (mut divergence, mut carried) = (R::default(), R::default());
        for k in 0..d {
            divergence += derivatives[at.row(k * q + k)];
            carried += derivatives[at.row(fields * q + 1 + k)] * derivatives[at.row(d * q + k)];
        }
        let rate = (carried - stiffness * divergence) * scale + diffusion * sums[place];
        pressures.set(i, known[l.pressure() * n + i] + dt * rate);
    });
    let mean = mean(geometry, |i| pressures.get(i));
    run_each(fluid.places, |place| pressures.add(fluid.particle(place), -mean));
    model.refresh(pressure);
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
    let mean = mean(geometry, |i| pressure_bar[i]);
    let (scale, dt) = (R::of(1.0 / fits.spacing), R::of(geometry.times.now));
    let (diffusion, stiffness) = (diffusion(geometry), stiffness(geometry));
    let mut bar = buffers.buffer(fluid.blocks() * width::<R>());
    clear(&mut bar);
    {
        let (known_bar, derivatives_bar, bar) = (Own::new(known_bar), Own::new(derivatives_bar), Own::new(&mut bar));
        run_each(fluid.places, |place| {
            let (i, at) = (fluid.particle(place), Place::of::<R>(place, rows(d, fields)));
            let p_bar = pressure_bar[i] - mean;
            known_bar.add(l.pressure() * n + i, p_bar);
            let rate_bar = dt * p_bar;
            bar.set(place, diffusion * rate_bar);
            let rate_bar = rate_bar * scale;
            for k in 0..d {
                derivatives_bar.add(at.row(k * q + k), -(stiffness * rate_bar));
                let (shift, slope) = (at.row(fields * q + 1 + k), at.row(d * q + k));
                derivatives_bar.add(shift, derivatives[slope] * rate_bar);
                derivatives_bar.add(slope, derivatives[shift] * rate_bar);
            }
        });
    }
    let mut records = buffers.buffer(stride(record_fields(d)) * n);
    pack(geometry, known, derivatives, Some(&bar), &mut records);
    // V, grad p and D_bar.
    model.refresh_records(&mut records, stride(record_fields(d)), d + 1, d + 2);
    let mut sums = buffers.buffer((2 + 2 * d) * fluid.blocks() * width::<R>());
    with_dimension!(d, |D| {
        let mut pass = Pass::<R, D, { stride(record_fields(D)) / 4 }> {
            geometry: *geometry,
            records: Records::new(&records, stride(record_fields(D)), n),
            slope: &kept.slope,
            sums: Own::new(&mut sums),
            known_bar: OfParticles::new(known_bar),
            mode: Mode::Fluid,
        };
        run_rows(&pass, fluid.blocks());
        pass.mode = Mode::Solid;
        run_rows(&pass, geometry.blocks.solid.blocks());
    });
    let (known_bar, derivatives_bar) = (Own::new(known_bar), Own::new(derivatives_bar));
    run_each(fluid.places, |place| {
        let (at, of) = (Place::of::<R>(place, rows(d, fields)), Place::of::<R>(place, 2 + 2 * d));
        let i = fluid.particle(place);
        known_bar.add(l.pressure() * n + i, sums[of.row(0)]);
        derivatives_bar.add(at.row(fields * q), sums[of.row(1)]);
        for k in 0..d {
            derivatives_bar.add(at.row(d * q + k), sums[of.row(2 + k)] * scale);
            known_bar.add(k * n + i, sums[of.row(2 + d + k)]);
        }
    });
}
