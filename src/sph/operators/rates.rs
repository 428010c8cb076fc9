//! The pair pass: acceleration, transport acceleration and temperature rate in one sweep.
//!
//! Every rate has the form x_i' = (1/m_i) sum_j P_ij with P_ij = -P_ji, so fluid-fluid pairs conserve momentum and heat:
//!
//! * acceleration: P = c e, c = (V_i^2 + V_j^2) W'(d)/d, e the sum of the laws' contributions (Adami, Hu and
//!   Adams 2013, eq. 8): [`crate::sph::laws::pressure`], [`crate::sph::laws::viscosity`], [`crate::sph::laws::transport_velocity`];
//! * transport acceleration: P = c p(0) r_ij (their eq. 13);
//! * temperature: [`crate::sph::laws::conduction`] (Cleary 1998).
//!
//! The adjoint is gathered too. A pair adds l = c (alpha.e + beta.r) + gamma V_i V_j F (T_i - T_j) to the
//! scalar product of cotangent and rates, alpha = a_bar_i/m_i - a_bar_j/m_j and beta, gamma likewise; row i
//! sums the derivatives of l by i's own fields, and walls have rows as well. No scatter, no atomics.

use crate::numerics::candle::{read, Operator};
use crate::numerics::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use crate::sph::chain::{Chain, Step};
use crate::sph::laws::pressure::Pressure;
use crate::sph::laws::{conduction, transport_velocity, viscosity};
use crate::sph::operators::pairs;
use crate::sph::operators::pairs::{gather_fields, splat_fields, stride, Fields, Masses, PairCache, RowGeometry};
use crate::sph::operators::{composed, density};
use crate::sph::sweeps::Sweeps;
use candle_core::{Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]`, primitives `[C, N]` -> rates `[A, N]`, zero for walls.
pub struct Rates<R: Sweeps>(pub Arc<Chain<R>>);

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

/// Records `[N, stride]`: position D, volume, density, velocity D, [transport shift D], [temperature, temperature before
/// this step's conduction].
pub const fn record_fields(d: usize, transport: bool, heat: bool) -> usize {
    2 * d + 2 + if transport { d } else { 0 } + if heat { 2 } else { 0 }
}

/// Where temperatures stand in a record.
pub const fn record_temperature(d: usize, transport: bool) -> usize {
    record_fields(d, transport, false)
}

/// Packs the records of particles whose primitives are known.
struct Packing<'a, R> {
    step: &'a Step<R>,
    moved: &'a [R],
    primitives: &'a [R],
    mass: Masses<'a, R>,
    records: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Packing<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (n, l) = (self.step.model.particles(), self.step.model.layout);
        let d = l.dimension;
        let width = stride(record_fields(d, l.transport, l.heat));
        for i in rows {
            // SAFETY: each row writes its own record.
            let record = unsafe { self.records.slice(i * width..(i + 1) * width) };
            let density = self.primitives[i];
            for k in 0..d {
                record[k] = self.moved[k * n + i];
                record[d + 2 + k] = self.primitives[(l.primitive_velocity() + k) * n + i];
                if l.transport {
                    record[2 * d + 2 + k] = self.primitives[(l.primitive_shift() + k) * n + i];
                }
            }
            record[d] = self.mass.of(i) / density;
            record[d + 1] = density;
            if l.heat {
                let at = record_temperature(d, l.transport);
                record[at] = self.primitives[l.primitive_temperature() * n + i];
                record[at + 1] = self.moved[l.moved_old_temperature() * n + i];
            }
        }
    }
}

/// [`PairCache`]'s records for an operator that is used without the primitives in front of it.
pub fn keep_records<R: Real>(step: &Step<R>, moved: &[R], primitives: &[R], kept: &mut PairCache<R>) {
    if !kept.has_records {
        let (n, l) = (step.model.particles(), step.model.layout);
        kept.records.resize(stride(record_fields(l.dimension, l.transport, l.heat)) * n, R::default());
        let mass = Masses::new(&step.model, moved);
        run_rows(&Packing { step, moved, primitives, mass, records: Shared::new(&mut kept.records) }, n);
        kept.has_records = true;
    }
}

#[inline(always)]
fn side<L: Lanes, const D: usize, const TRANSPORT: bool, const HEAT: bool>(f: &Fields<L>) -> Side<L, D> {
    let get = |q: usize| f[q / 4][q % 4];
    let density = get(D + 1);
    let half = L::splat(L::Real::of(0.5)) * density;
    let mut side = Side {
        volume: get(D),
        density,
        velocity: [L::zero(); D],
        transport: [L::zero(); D],
        temperature: if HEAT { get(record_temperature(D, TRANSPORT)) } else { L::zero() },
    };
    for d in 0..D {
        side.velocity[d] = get(D + 2 + d);
        if TRANSPORT {
            side.transport[d] = half * get(2 * D + 2 + d);
        }
    }
    side
}

/// The position stands first in a record.
#[inline(always)]
fn position<L: Lanes, const D: usize>(f: &Fields<L>) -> [L; D] {
    let mut position = [L::zero(); D];
    position.copy_from_slice(&f[0][..D]);
    position
}

struct Forward<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    kept: &'a PairCache<R>,
    mass: Masses<'a, R>,
    rates: Shared<'a, R>,
}

/// Sums over a row of the pair pass.
struct Sums<L, const D: usize> {
    force: [L; D],
    spread: [L; D],
    warmth: L,
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> Forward<'_, R, D, TRANSPORT, HEAT> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(
        &self,
        geometry: &RowGeometry<L, D>,
        own: &Fields<L>,
        i: usize,
    ) -> Sums<L, D> {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let fields = record_fields(D, TRANSPORT, HEAT);
        let pressure = Pressure(model.equation_of_state);
        let eta = L::splat(R::of(model.viscosity));
        let (here, a) = (position::<L, D>(own), side::<L, D, TRANSPORT, HEAT>(own));
        let own_pressure = pressure.prepare(&a);
        let volume2 = a.volume * a.volume;
        let from = i * list.capacity;
        let mut sums = Sums { force: [L::zero(); D], spread: [L::zero(); D], warmth: L::zero() };
        for (k, (index, _)) in pairs::row::<L>(list, i).enumerate() {
            // SAFETY: `row` gives valid particle numbers; F is kept for every pair of the list, 0 in the padding.
            let (other, slope) = unsafe {
                let slope = L::load(self.kept.slope.as_ptr().add(from + k * L::COUNT));
                (gather_fields::<L>(self.kept.records.as_ptr(), fields, index), slope)
            };
            let (there, b) = (position::<L, D>(&other), side::<L, D, TRANSPORT, HEAT>(&other));
            let (dr, _) = geometry.difference::<EDGE>(&here, &there);
            let c = b.volume.mul_add(b.volume, volume2) * slope;
            let mut e = [L::zero(); D];
            pressure.add(&a, &own_pressure, &b, &dr, &mut e);
            viscosity::add(eta, &a, &b, &mut e);
            if TRANSPORT {
                transport_velocity::add(&a, &b, &dr, &mut e);
            }
            for d in 0..D {
                sums.force[d] = c.mul_add(e[d], sums.force[d]);
                if TRANSPORT {
                    sums.spread[d] = c.mul_add(dr[d], sums.spread[d]);
                }
            }
            if HEAT {
                sums.warmth = conduction::add(&a, &b, slope, sums.warmth);
            }
        }
        sums
    }
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for Forward<'_, R, D, TRANSPORT, HEAT>
{
    const SHORT: bool = D == 2;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let n = model.particles();
        let geometry = RowGeometry::<L, D>::new(&model.domain, model.kernel.cutoff());
        let fields = record_fields(D, TRANSPORT, HEAT);
        let vacuum = R::of(model.equation_of_state.at_vacuum());
        let conduction = R::of(conduction::factor(model));
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let record = &self.kept.records[i * stride(fields)..(i + 1) * stride(fields)];
            let own = splat_fields::<L>(record, fields);
            let sums = if geometry.at_edge(record) {
                self.row::<L, true>(&geometry, &own, i)
            } else {
                self.row::<L, false>(&geometry, &own, i)
            };
            let inverse_mass = R::of(1.0) / self.mass.of(i);
            // SAFETY (all writes): each fluid row writes its own particle.
            unsafe {
                for d in 0..D {
                    let given = if d == 0 { R::of(model.body_force.at(record[1].f64())) } else { R::default() };
                    self.rates.set(d * n + i, sums.force[d].sum() * inverse_mass + given);
                    if TRANSPORT {
                        self.rates.set((D + d) * n + i, vacuum * sums.spread[d].sum() * inverse_mass);
                    }
                }
                if HEAT {
                    let rate = conduction * inverse_mass * sums.warmth.sum();
                    let open = conduction::conducts(model, record[0]);
                    self.rates.set(model.layout.rate_temperature() * n + i, if open { rate } else { R::default() });
                }
            }
        }
    }
}

/// Calls a macro with the laws of a layout as literals.
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
pub(super) use dispatch;

/// The forward pass, on plain numbers, from [`PairCache`]'s pairs and records. `rates` must be zero for walls.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], kept: &PairCache<R>, rates: &mut [R]) {
    let l = step.model.layout;
    let mass = Masses::new(&step.model, moved);
    macro_rules! go {
        ($d:literal, $transport:literal, $heat:literal) => {
            run_rows(
                &Forward::<R, $d, $transport, $heat> { step, kept, mass, rates: Shared::new(rates) },
                step.list.fluid_rows.len(),
            )
        };
    }
    dispatch!(l, go);
}

/// The rates from the state at the step's end, which has them.
fn known<R: Real>(step: &Step<R>, state: &[R], rates: &mut [R]) {
    let (n, l) = (step.model.particles(), step.model.layout);
    let accelerations = l.rate_temperature() * n;
    rates[..accelerations].copy_from_slice(&state[l.acceleration() * n..][..accelerations]);
    if l.heat {
        rates[accelerations..].copy_from_slice(&state[l.temperature_rate() * n..][..n]);
    }
}

struct Backward<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    kept: &'a PairCache<R>,
    /// Cotangents of the rates over mass, `[N, 4 or 8]`: acceleration D, [p(0) transport D], [K temperature].
    bars: &'a [R],
    mass: Masses<'a, R>,
    moved_bar: Shared<'a, R>,
    primitives_bar: Shared<'a, R>,
}

const fn bar_fields(d: usize, transport: bool, heat: bool) -> usize {
    d + if transport { d } else { 0 } + heat as usize
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> Backward<'_, R, D, TRANSPORT, HEAT> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(
        &self,
        geometry: &RowGeometry<L, D>,
        own: &Fields<L>,
        i: usize,
    ) -> SideBar<L, D> {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let fields = record_fields(D, TRANSPORT, HEAT);
        let bar_fields = bar_fields(D, TRANSPORT, HEAT);
        let width = stride(bar_fields);
        let pressure = Pressure(model.equation_of_state);
        let eta = L::splat(R::of(model.viscosity));
        let two = L::splat(R::of(2.0));
        let (here, a) = (position::<L, D>(own), side::<L, D, TRANSPORT, HEAT>(own));
        let own_pressure = pressure.prepare(&a);
        let own_bar = splat_fields::<L>(&self.bars[i * width..(i + 1) * width], bar_fields);
        let volume2 = a.volume * a.volume;
        let from = i * list.capacity;
        let mut bar = SideBar {
            volume: L::zero(),
            density: L::zero(),
            velocity: [L::zero(); D],
            transport: [L::zero(); D],
            temperature: L::zero(),
            position: [L::zero(); D],
        };
        for (k, (index, _)) in pairs::row::<L>(list, i).enumerate() {
            // SAFETY: `row` gives valid particle numbers; F and G are kept for every pair of the list, 0 in the padding.
            let (other, other_bar, slope, curvature) = unsafe {
                (
                    gather_fields::<L>(self.kept.records.as_ptr(), fields, index),
                    gather_fields::<L>(self.bars.as_ptr(), bar_fields, index),
                    L::load(self.kept.slope.as_ptr().add(from + k * L::COUNT)),
                    L::load(self.kept.curvature.as_ptr().add(from + k * L::COUNT)),
                )
            };
            let (there, b) = (position::<L, D>(&other), side::<L, D, TRANSPORT, HEAT>(&other));
            let difference = |q: usize| own_bar[q / 4][q % 4] - other_bar[q / 4][q % 4];
            let mut alpha = [L::zero(); D];
            for d in 0..D {
                alpha[d] = difference(d);
            }
            let (dr, _) = geometry.difference::<EDGE>(&here, &there);
            let volumes2 = b.volume.mul_add(b.volume, volume2);
            let c = volumes2 * slope;

            // s = alpha.e + beta.r, and its derivative by r_ij.
            let mut s = L::zero();
            let mut by_position = [L::zero(); D];
            let along = dot(&alpha, &dr);
            pressure.adjoint(&a, &own_pressure, &b, along, &alpha, c, &mut s, &mut by_position, &mut bar);
            viscosity::adjoint(eta, &a, &b, &alpha, c, &mut s, &mut bar);
            if TRANSPORT {
                let mut beta = [L::zero(); D];
                for d in 0..D {
                    beta[d] = difference(D + d);
                }
                transport_velocity::adjoint(&a, &b, &dr, &alpha, &beta, c, &mut s, &mut by_position, &mut bar);
            }
            bar.volume = (slope * s).mul_add(two * a.volume, bar.volume);
            let mut by_slope = volumes2 * s;
            if HEAT {
                let gamma = difference(if TRANSPORT { 2 * D } else { D });
                conduction::adjoint(&a, &b, gamma, slope, &mut by_slope, &mut bar);
            }
            let radial = by_slope * curvature;
            for d in 0..D {
                bar.position[d] += radial.mul_add(dr[d], c * by_position[d]);
            }
        }
        bar
    }
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for Backward<'_, R, D, TRANSPORT, HEAT>
{
    const SHORT: bool = D == 2;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let geometry = RowGeometry::<L, D>::new(&model.domain, model.kernel.cutoff());
        let fields = record_fields(D, TRANSPORT, HEAT);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let record = &self.kept.records[i * stride(fields)..(i + 1) * stride(fields)];
            let own = splat_fields::<L>(record, fields);
            let bar = if geometry.at_edge(record) {
                self.row::<L, true>(&geometry, &own, i)
            } else {
                self.row::<L, false>(&geometry, &own, i)
            };
            // From the record's fields back to the operator's inputs, all of them particle i's own.
            let (volume, density) = (record[D], record[D + 1]);
            let mut density_bar = bar.density.sum();
            let volume_bar = bar.volume.sum();
            density_bar -= volume_bar * volume / density;
            // SAFETY (all writes): each row writes its own particle.
            unsafe {
                for d in 0..D {
                    self.moved_bar.add(d * n + i, bar.position[d].sum());
                    self.primitives_bar.set((l.primitive_velocity() + d) * n + i, bar.velocity[d].sum());
                    if TRANSPORT {
                        // transport = rho w / 2
                        let t = bar.transport[d].sum();
                        let half = R::of(0.5) * t;
                        density_bar += half * record[2 * D + 2 + d];
                        self.primitives_bar.set((l.primitive_shift() + d) * n + i, half * density);
                    }
                }
                if HEAT {
                    self.primitives_bar.set(l.primitive_temperature() * n + i, bar.temperature.sum());
                }
                self.primitives_bar.set(i, density_bar);
                if l.mass {
                    self.moved_bar.add(l.moved_mass() * n + i, volume_bar * volume / self.mass.of(i));
                }
            }
        }
    }
}

/// Packs the cotangents, and adds the share of the factor 1/m_i to the cotangent of the mass.
struct PackingBars<'a, R> {
    step: &'a Step<R>,
    moved: &'a [R],
    rates: &'a [R],
    rates_bar: &'a [R],
    mass: Masses<'a, R>,
    bars: Shared<'a, R>,
    moved_bar: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for PackingBars<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let model = &*self.step.model;
        let (n, l) = (model.particles(), model.layout);
        let d = l.dimension;
        let width = stride(bar_fields(d, l.transport, l.heat));
        let vacuum = R::of(model.equation_of_state.at_vacuum());
        let conduction = R::of(conduction::factor(model));
        for i in rows {
            // SAFETY: each row writes its own record.
            let bar = unsafe { self.bars.slice(i * width..(i + 1) * width) };
            bar.fill(R::default());
            if !model.is_fluid(i) {
                continue;
            }
            let inverse_mass = R::of(1.0) / self.mass.of(i);
            // Cotangent . (pair part of the rates).
            let mut power = R::default();
            for k in 0..d {
                let a = self.rates_bar[k * n + i];
                bar[k] = a * inverse_mass;
                let given = if k == 0 { R::of(model.body_force.at(self.moved[n + i].f64())) } else { R::default() };
                power += a * (self.rates[k * n + i] - given);
                if l.transport {
                    let b = self.rates_bar[(d + k) * n + i];
                    bar[d + k] = vacuum * b * inverse_mass;
                    power += b * self.rates[(d + k) * n + i];
                }
            }
            if l.heat && conduction::conducts(model, self.moved[i]) {
                let t = self.rates_bar[l.rate_temperature() * n + i];
                bar[if l.transport { 2 * d } else { d }] = conduction * t * inverse_mass;
                power += t * self.rates[l.rate_temperature() * n + i];
            }
            if l.mass {
                // SAFETY: each row writes its own particle.
                unsafe { self.moved_bar.add(l.moved_mass() * n + i, -power * inverse_mass) };
            }
        }
    }
}

/// The adjoint, on plain numbers: adds to `moved_bar`; `primitives_bar` must be zero.
pub fn backward<R: Real>(
    step: &Step<R>,
    moved: &[R],
    kept: &PairCache<R>,
    rates: &[R],
    rates_bar: &[R],
    moved_bar: &mut [R],
    primitives_bar: &mut [R],
) {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let mass = Masses::new(model, moved);
    let mut bars = model.scratch.take(stride(bar_fields(l.dimension, l.transport, l.heat)) * n);
    let packing = PackingBars {
        step,
        moved,
        rates,
        rates_bar,
        mass,
        bars: Shared::new(&mut bars),
        moved_bar: Shared::new(moved_bar),
    };
    run_rows(&packing, n);
    macro_rules! go {
        ($d:literal, $transport:literal, $heat:literal) => {
            run_rows(
                &Backward::<R, $d, $transport, $heat> {
                    step,
                    kept,
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
    model.scratch.give_back(bars);
}

impl<R: Sweeps> Operator<2> for Rates<R> {
    type Real = R;
    const NAME: &'static str = "rates";

    fn forward(&self, [moved, primitives]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let step = &self.0.step;
        let (rows, n) = (step.model.layout.rate_rows(), step.model.particles());
        let mut rates = vec![R::default(); rows * n];
        let mut kept = self.0.kept();
        density::keep_pairs(step, moved, &mut kept);
        R::keep_records(step, moved, primitives, &mut kept);
        match self.0.after() {
            Some(after) => read(after, |state| {
                known(step, state, &mut rates);
                Ok(())
            })?,
            None => R::rates(step, moved, &kept, &mut rates),
        }
        Ok((rates, (rows, n).into()))
    }

    fn adjoint(&self, [moved, _]: [&[R]; 2], rates: &[R], bar: &[R], _: [bool; 2]) -> Result<[Option<Vec<R>>; 2]> {
        let step = &self.0.step;
        let mut moved_bar = self.0.moved_bar();
        let mut primitives_bar = vec![R::default(); step.model.layout.primitive_rows() * step.model.particles()];
        R::rates_bar(step, moved, &self.0.kept(), rates, bar, &mut moved_bar, &mut primitives_bar);
        Ok([self.0.pass_on(moved_bar), Some(primitives_bar)])
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
    let pair_forces = per_mass(force.broadcast_mul(&c)?.sum(2)?)?;
    let given = model.body_force.composed(&moved.narrow(0, 1, 1)?)?.mul(&only_fluid)?;
    let acceleration = Tensor::cat(&[(pair_forces.narrow(0, 0, 1)? + given)?, pair_forces.narrow(0, 1, d - 1)?], 0)?;
    let mut rates = vec![acceleration];
    if l.transport {
        let spread = pairs.difference.broadcast_mul(&c)?.sum(2)?;
        rates.push(per_mass(spread.affine(model.equation_of_state.at_vacuum(), 0.0)?)?);
    }
    if l.heat {
        let temperature = primitives.narrow(0, l.primitive_temperature(), 1)?;
        let warmth = conduction::composed(pairs, &volume, &temperature, &slope)?;
        let open = conduction::conducts_composed(model, &moved.narrow(0, 0, 1)?)?;
        rates.push(per_mass(warmth.affine(conduction::factor(model), 0.0)?)?.mul(&open)?);
    }
    Tensor::cat(&rates, 0)
}
