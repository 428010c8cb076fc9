//! The pair pass: acceleration, transport acceleration and temperature rate in one sweep.
//!
//! Every rate has the form x_i' = (1/m_i) sum_j P_ij with P_ij = -P_ji, so fluid-fluid pairs conserve momentum and heat:
//!
//! * acceleration: P = c e, c = (V_i^2 + V_j^2) W'(d)/d, e the sum of the laws' contributions (Adami, Hu and
//!   Adams 2013, eq. 8): [`super::pressure`], [`super::viscosity`], [`super::transport_velocity`];
//! * transport acceleration: P = c p(0) r_ij (their eq. 13);
//! * temperature: [`super::heat`] (Cleary 1998).
//!
//! The adjoint is gathered too. A pair adds l = c (alpha.e + beta.r) + gamma V_i V_j F (T_i - T_j) to the
//! scalar product of cotangent and rates, alpha = a_bar_i/m_i - a_bar_j/m_j and beta, gamma likewise; row i
//! sums the derivatives of l by i's own fields, and walls have rows as well. No scatter, no atomics.

use super::pairs::{self, Masses, RowGeometry};
use super::pressure::Pressure;
use super::step::{input, output, read, tensor, Step};
use super::{composed, heat, transport_velocity, viscosity};
use crate::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use candle_core::{CpuStorage, CustomOp2, Layout, Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]`, primitives `[C, N]` -> rates `[A, N]`, zero for walls.
pub struct Rates<R>(pub Arc<Step<R>>);

/// One particle of a pair: what its record holds.
#[derive(Clone, Copy)]
pub struct Side<L, const D: usize> {
    pub volume: L,
    pub density: L,
    pub velocity: [L; D],
    /// rho w / 2, w the transport velocity's shift.
    pub transport: [L; D],
    pub temperature: L,
}

/// Derivatives by the fields of the row's own side, summed over the row.
#[derive(Clone, Copy)]
pub struct SideBar<L, const D: usize> {
    pub volume: L,
    pub density: L,
    pub velocity: [L; D],
    pub transport: [L; D],
    pub temperature: L,
    pub position: [L; D],
}

/// Scalar product over dimensions.
#[inline(always)]
pub fn dot<L: Lanes, const D: usize>(a: &[L; D], b: &[L; D]) -> L {
    let mut sum = a[0] * b[0];
    for d in 1..D {
        sum = a[d].mul_add(b[d], sum);
    }
    sum
}

/// Records `[N, stride]`: position D, volume, density, velocity D, [transport D], [temperature].
fn stride(fields: usize) -> usize {
    fields.next_multiple_of(4)
}

const fn record_fields(d: usize, transport: bool, heat: bool) -> usize {
    2 * d + 2 + if transport { d } else { 0 } + heat as usize
}

fn pack_records<R: Real>(step: &Step<R>, moved: &[R], primitives: &[R], records: &mut [R]) {
    let (n, l) = (step.model.particles(), step.model.layout);
    let d = l.dimension;
    let width = stride(record_fields(d, l.transport, l.heat));
    let mass = Masses::new(&step.model, moved);
    for i in 0..n {
        let record = &mut records[i * width..(i + 1) * width];
        let density = primitives[i];
        for k in 0..d {
            record[k] = moved[k * n + i];
            record[d + 2 + k] = primitives[(l.primitive_velocity() + k) * n + i];
            if l.transport {
                record[2 * d + 2 + k] = R::of(0.5) * density * primitives[(l.primitive_shift() + k) * n + i];
            }
        }
        record[d] = mass.of(i) / density;
        record[d + 1] = density;
        if l.heat {
            record[record_fields(d, l.transport, true) - 1] = primitives[l.primitive_temperature() * n + i];
        }
    }
}

/// A record's fields: up to three groups of 4, of which the compiler keeps those that are used.
type Fields<L> = [[L; 4]; 3];

#[inline(always)]
fn gather_fields<L: Lanes>(records: &[L::Real], fields: usize, index: *const u32) -> Fields<L> {
    let width = stride(fields);
    // SAFETY: `index` comes from `row`; records are `width` long, a multiple of 4.
    unsafe {
        let base = records.as_ptr();
        [
            L::gather4(base, width, index),
            L::gather4(base.add(4), width, index),
            if fields > 8 { L::gather4(base.add(8), width, index) } else { [L::zero(); 4] },
        ]
    }
}

#[inline(always)]
fn splat_fields<L: Lanes>(records: &[L::Real], fields: usize, i: usize) -> Fields<L> {
    let width = stride(fields);
    let record = &records[i * width..(i + 1) * width];
    std::array::from_fn(|b| {
        std::array::from_fn(|q| if 4 * b + q < width { L::splat(record[4 * b + q]) } else { L::zero() })
    })
}

#[inline(always)]
fn side<L: Lanes, const D: usize, const TRANSPORT: bool, const HEAT: bool>(f: &Fields<L>) -> Side<L, D> {
    let get = |q: usize| f[q / 4][q % 4];
    Side {
        volume: get(D),
        density: get(D + 1),
        velocity: std::array::from_fn(|d| get(D + 2 + d)),
        transport: std::array::from_fn(|d| if TRANSPORT { get(2 * D + 2 + d) } else { L::zero() }),
        temperature: if HEAT { get(record_fields(D, TRANSPORT, HEAT) - 1) } else { L::zero() },
    }
}

#[inline(always)]
fn position<L: Lanes, const D: usize>(f: &Fields<L>) -> [L; D] {
    std::array::from_fn(|d| f[d / 4][d % 4])
}

struct Forward<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    records: &'a [R],
    mass: Masses<'a, R>,
    rates: Shared<'a, R>,
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for Forward<'_, R, D, TRANSPORT, HEAT>
{
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let n = model.particles();
        let kernel = model.kernel.lanes::<L>();
        let geometry = RowGeometry::<L, D>::new(&model.domain);
        let fields = record_fields(D, TRANSPORT, HEAT);
        let pressure = Pressure(model.equation_of_state);
        let eta = L::splat(R::of(model.viscosity));
        let vacuum = R::of(model.equation_of_state.at_vacuum());
        let conduction = R::of(heat::factor(model));
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let own = splat_fields::<L>(self.records, fields, i);
            let (here, a) = (position::<L, D>(&own), side::<L, D, TRANSPORT, HEAT>(&own));
            let own_pressure = pressure.prepare(&a);
            let volume2 = a.volume * a.volume;
            let mut force = [L::zero(); D];
            let mut spread = [L::zero(); D];
            let mut warmth = L::zero();
            for (index, mask) in pairs::row::<L>(list, i) {
                let other = gather_fields::<L>(self.records, fields, index);
                let (there, b) = (position::<L, D>(&other), side::<L, D, TRANSPORT, HEAT>(&other));
                let (dr, r2) = geometry.difference(&here, &there);
                let slope = mask.apply(kernel.slope(r2));
                let c = b.volume.mul_add(b.volume, volume2) * slope;
                let mut e = [L::zero(); D];
                pressure.add(&a, &own_pressure, &b, &dr, &mut e);
                viscosity::add(eta, &a, &b, &mut e);
                if TRANSPORT {
                    transport_velocity::add(&a, &b, &dr, &mut e);
                }
                for d in 0..D {
                    force[d] = c.mul_add(e[d], force[d]);
                    if TRANSPORT {
                        spread[d] = c.mul_add(dr[d], spread[d]);
                    }
                }
                if HEAT {
                    warmth = heat::add(&a, &b, slope, warmth);
                }
            }
            let inverse_mass = R::of(1.0) / self.mass.of(i);
            // SAFETY (all writes): each fluid row writes its own particle.
            unsafe {
                let y = self.records[i * stride(fields) + 1].f64();
                for d in 0..D {
                    let given = if d == 0 { R::of(model.body_force.at(y)) } else { R::default() };
                    self.rates.set(d * n + i, force[d].sum() * inverse_mass + given);
                    if TRANSPORT {
                        self.rates.set((D + d) * n + i, vacuum * spread[d].sum() * inverse_mass);
                    }
                }
                if HEAT {
                    let x = self.records[i * stride(fields)];
                    let rate = conduction * inverse_mass * warmth.sum();
                    let open = heat::conducts(model, x);
                    self.rates.set(model.layout.rate_temperature() * n + i, if open { rate } else { R::default() });
                }
            }
        }
    }
}

macro_rules! dispatch {
    ($layout:expr, $go:ident) => {
        match ($layout.dimension, $layout.transport, $layout.heat) {
            (2, false, false) => $go!(2, false, false),
            (2, false, true) => $go!(2, false, true),
            (2, true, false) => $go!(2, true, false),
            (2, true, true) => $go!(2, true, true),
            (_, false, false) => $go!(3, false, false),
            (_, false, true) => $go!(3, false, true),
            (_, true, false) => $go!(3, true, false),
            (_, true, true) => $go!(3, true, true),
        }
    };
}

/// The forward pass, on plain numbers. `rates` must be zero for walls.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], primitives: &[R], rates: &mut [R]) {
    let model = &*step.model;
    let l = model.layout;
    let width = stride(record_fields(l.dimension, l.transport, l.heat));
    let mut records = model.scratch.take(width * model.particles());
    pack_records(step, moved, primitives, &mut records);
    let mass = Masses::new(model, moved);
    macro_rules! go {
        ($d:literal, $transport:literal, $heat:literal) => {
            run_rows(
                &Forward::<R, $d, $transport, $heat> { step, records: &records, mass, rates: Shared::new(rates) },
                step.list.fluid_rows.len(),
            )
        };
    }
    dispatch!(l, go);
    model.scratch.give_back(records);
}

struct Backward<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    records: &'a [R],
    /// Cotangents of the rates over mass, `[N, 4 or 8]`: acceleration D, [p(0) transport D], [K temperature].
    bars: &'a [R],
    mass: Masses<'a, R>,
    moved_bar: Shared<'a, R>,
    primitives_bar: Shared<'a, R>,
}

const fn bar_width(transport: bool) -> usize {
    if transport {
        8
    } else {
        4
    }
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for Backward<'_, R, D, TRANSPORT, HEAT>
{
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let kernel = model.kernel.lanes::<L>();
        let geometry = RowGeometry::<L, D>::new(&model.domain);
        let fields = record_fields(D, TRANSPORT, HEAT);
        let width = bar_width(TRANSPORT);
        let pressure = Pressure(model.equation_of_state);
        let eta = L::splat(R::of(model.viscosity));
        let two = L::splat(R::of(2.0));
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let own = splat_fields::<L>(self.records, fields, i);
            let (here, a) = (position::<L, D>(&own), side::<L, D, TRANSPORT, HEAT>(&own));
            let own_pressure = pressure.prepare(&a);
            let own_bar: [L; 8] =
                std::array::from_fn(|q| if q < width { L::splat(self.bars[i * width + q]) } else { L::zero() });
            let volume2 = a.volume * a.volume;
            let mut bar = SideBar {
                volume: L::zero(),
                density: L::zero(),
                velocity: [L::zero(); D],
                transport: [L::zero(); D],
                temperature: L::zero(),
                position: [L::zero(); D],
            };
            for (index, mask) in pairs::row::<L>(list, i) {
                let other = gather_fields::<L>(self.records, fields, index);
                let (there, b) = (position::<L, D>(&other), side::<L, D, TRANSPORT, HEAT>(&other));
                // SAFETY: `index` comes from `row`; records of the cotangents are `width` long.
                let other_bar: [[L; 4]; 2] = unsafe {
                    let base = self.bars.as_ptr();
                    [
                        L::gather4(base, width, index),
                        if TRANSPORT { L::gather4(base.add(4), width, index) } else { [L::zero(); 4] },
                    ]
                };
                let difference = |q: usize| own_bar[q] - other_bar[q / 4][q % 4];
                let alpha: [L; D] = std::array::from_fn(difference);
                let (dr, r2) = geometry.difference(&here, &there);
                let (slope, curvature) = kernel.slope_and_curvature(r2);
                let (slope, curvature) = (mask.apply(slope), mask.apply(curvature));
                let volumes2 = b.volume.mul_add(b.volume, volume2);
                let c = volumes2 * slope;

                // s = alpha.e + beta.r, and its derivative by r_ij.
                let mut s = L::zero();
                let mut by_position = [L::zero(); D];
                let along = dot(&alpha, &dr);
                pressure.adjoint(&a, &own_pressure, &b, along, &alpha, c, &mut s, &mut by_position, &mut bar);
                viscosity::adjoint(eta, &a, &b, &alpha, c, &mut s, &mut bar);
                if TRANSPORT {
                    let beta: [L; D] = std::array::from_fn(|d| difference(D + d));
                    transport_velocity::adjoint(&a, &b, &dr, &alpha, &beta, c, &mut s, &mut by_position, &mut bar);
                }
                bar.volume = (slope * s).mul_add(two * a.volume, bar.volume);
                let mut by_slope = volumes2 * s;
                if HEAT {
                    let gamma = difference(if TRANSPORT { 2 * D } else { D });
                    heat::adjoint(&a, &b, gamma, slope, &mut by_slope, &mut bar);
                }
                let radial = by_slope * curvature;
                for d in 0..D {
                    bar.position[d] += radial.mul_add(dr[d], c * by_position[d]);
                }
            }
            // From the record's fields back to the operator's inputs, all of them particle i's own.
            let density = self.records[i * stride(fields) + D + 1];
            let volume = self.records[i * stride(fields) + D];
            let mut density_bar = bar.density.sum();
            let volume_bar = bar.volume.sum();
            density_bar -= volume_bar * volume / density;
            // SAFETY (all writes): each row writes its own particle.
            unsafe {
                for d in 0..D {
                    self.moved_bar.set(d * n + i, bar.position[d].sum());
                    self.primitives_bar.set((l.primitive_velocity() + d) * n + i, bar.velocity[d].sum());
                    if TRANSPORT {
                        // transport = rho w / 2
                        let t = bar.transport[d].sum();
                        let transport = self.records[i * stride(fields) + 2 * D + 2 + d];
                        density_bar += t * transport / density;
                        self.primitives_bar.set((l.primitive_shift() + d) * n + i, t * density * R::of(0.5));
                    }
                }
                if HEAT {
                    self.primitives_bar.set(l.primitive_temperature() * n + i, bar.temperature.sum());
                }
                self.primitives_bar.set(i, density_bar);
                if l.mass {
                    let place = l.moved_mass() * n + i;
                    // Already there: the share of the factor 1/m_i.
                    self.moved_bar.set(place, self.moved_bar.get(place) + volume_bar * volume / self.mass.of(i));
                }
            }
        }
    }
}

/// The adjoint, on plain numbers: adds nothing, overwrites the rows of particles in pairs; `moved_bar` and
/// `primitives_bar` must be zero.
pub fn backward<R: Real>(
    step: &Step<R>,
    moved: &[R],
    primitives: &[R],
    rates: &[R],
    rates_bar: &[R],
    moved_bar: &mut [R],
    primitives_bar: &mut [R],
) {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let d = l.dimension;
    let width = stride(record_fields(d, l.transport, l.heat));
    let mut records = model.scratch.take(width * n);
    pack_records(step, moved, primitives, &mut records);
    let mass = Masses::new(model, moved);
    let wide = bar_width(l.transport);
    let mut bars = model.scratch.take(wide * n);
    bars.fill(R::default());
    let vacuum = R::of(model.equation_of_state.at_vacuum());
    let conduction = R::of(heat::factor(model));
    for &i in &step.list.fluid_rows {
        let i = i as usize;
        let m = mass.of(i);
        let bar = &mut bars[i * wide..(i + 1) * wide];
        let mut power = R::default(); // cotangent . (pair part of the rates): the factor 1/m_i's share
        for k in 0..d {
            let a = rates_bar[k * n + i];
            bar[k] = a / m;
            let given = if k == 0 { R::of(model.body_force.at(moved[n + i].f64())) } else { R::default() };
            power += a * (rates[k * n + i] - given);
            if l.transport {
                let b = rates_bar[(d + k) * n + i];
                bar[d + k] = vacuum * b / m;
                power += b * rates[(d + k) * n + i];
            }
        }
        if l.heat && heat::conducts(model, moved[i]) {
            let t = rates_bar[l.rate_temperature() * n + i];
            bar[if l.transport { 2 * d } else { d }] = conduction * t / m;
            power += t * rates[l.rate_temperature() * n + i];
        }
        if l.mass {
            moved_bar[l.moved_mass() * n + i] = -power / m;
        }
    }
    macro_rules! go {
        ($d:literal, $transport:literal, $heat:literal) => {
            run_rows(
                &Backward::<R, $d, $transport, $heat> {
                    step,
                    records: &records,
                    bars: &bars,
                    mass,
                    moved_bar: Shared::new(moved_bar),
                    primitives_bar: Shared::new(primitives_bar),
                },
                pairs::all_rows(&step.list),
            )
        };
    }
    dispatch!(l, go);
    model.scratch.give_back(records);
    model.scratch.give_back(bars);
}

impl<R: Real> CustomOp2 for Rates<R> {
    fn name(&self) -> &'static str {
        "rates"
    }
    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        let (rows, n) = (self.0.model.layout.rate_rows(), self.0.model.particles());
        let mut rates = vec![R::default(); rows * n];
        forward(&self.0, input(s1, l1)?, input(s2, l2)?, &mut rates);
        Ok(output(rates, (rows, n)))
    }
    fn bwd(
        &self,
        moved: &Tensor,
        primitives: &Tensor,
        rates: &Tensor,
        rates_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>)> {
        let (l, n) = (self.0.model.layout, self.0.model.particles());
        let mut moved_bar = vec![R::default(); l.moved_rows() * n];
        let mut primitives_bar = vec![R::default(); l.primitive_rows() * n];
        read(moved, |m| {
            read(primitives, |p| {
                read(rates, |a| {
                    read(&rates_bar.contiguous()?, |bar| {
                        backward(&self.0, m, p, a, bar, &mut moved_bar, &mut primitives_bar);
                        Ok(())
                    })
                })
            })
        })?;
        Ok((Some(tensor(moved_bar, l.moved_rows(), n)?), Some(tensor(primitives_bar, l.primitive_rows(), n)?)))
    }
}

/// The same from ordinary candle ops: the oracle.
pub fn composed<R: Real>(
    step: &Step<R>,
    pairs: &composed::Pairs,
    moved: &Tensor,
    primitives: &Tensor,
) -> Result<Tensor> {
    let model = &*step.model;
    let (l, d) = (model.layout, model.layout.dimension);
    let mass = composed::mass(step, moved)?;
    let density = primitives.narrow(0, 0, 1)?;
    let volume = mass.div(&density)?;
    let (volume_i, volume_j) = (pairs.own(&volume)?, pairs.other(&volume)?);
    let slope = composed::quintic_slope(&model.kernel, &pairs.distance)?.mul(&pairs.mask)?;
    let c = (volume_i.sqr()? + volume_j.sqr()?)?.mul(&slope)?;
    let velocity = primitives.narrow(0, l.primitive_velocity(), d)?;
    let mut force = Pressure(model.equation_of_state).composed(pairs, &density)?;
    let viscous = viscosity::composed(model.viscosity, pairs, &velocity)?;
    force = (force + viscous)?;
    if l.transport {
        let shift = primitives.narrow(0, l.primitive_shift(), d)?;
        force = (force + transport_velocity::composed(pairs, &density, &velocity, &shift)?)?;
    }
    let only_fluid = pairs.is_fluid.clone();
    let per_mass = |sum: Tensor| sum.broadcast_div(&mass)?.broadcast_mul(&only_fluid);
    let mut acceleration = per_mass(force.broadcast_mul(&c)?.sum(2)?)?;
    let given: Vec<R> = read(&moved.narrow(0, 1, 1)?.contiguous()?, |y: &[R]| {
        Ok(y.iter()
            .enumerate()
            .map(|(i, y)| if model.is_fluid(i) { R::of(model.body_force.at(y.f64())) } else { R::default() })
            .collect())
    })?;
    let mut rows = vec![R::default(); d * model.particles()];
    rows[..model.particles()].copy_from_slice(&given);
    acceleration = (acceleration + Tensor::from_vec(rows, (d, model.particles()), moved.device())?)?;
    let mut rates = vec![acceleration];
    if l.transport {
        let spread = pairs.difference.broadcast_mul(&c)?.sum(2)?;
        rates.push(per_mass(spread.affine(model.equation_of_state.at_vacuum(), 0.0)?)?);
    }
    if l.heat {
        let temperature = primitives.narrow(0, l.primitive_temperature(), 1)?;
        let warmth = heat::composed(pairs, &volume, &temperature, &slope)?;
        let open: Vec<R> = read(&moved.narrow(0, 0, 1)?.contiguous()?, |x: &[R]| {
            Ok(x.iter().map(|x| R::of(heat::conducts(model, *x) as u8 as f64)).collect())
        })?;
        let open = Tensor::from_vec(open, (1, model.particles()), moved.device())?;
        rates.push(per_mass(warmth.affine(heat::factor(model), 0.0)?)?.mul(&open)?);
    }
    Tensor::cat(&rates, 0)
}
