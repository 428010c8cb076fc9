//! The pair pass: acceleration, transport acceleration and temperature rate in one sweep.
//!
//! Every rate has the form x_i' = (1/m_i) sum_j P_ij with P_ij = -P_ji, so fluid-fluid pairs conserve momentum and heat:
//!
//! * acceleration: P = c e, c = (V_i^2 + V_j^2) W'(d)/d, e the sum of the laws' contributions (Adami, Hu and
//!   Adams 2013, eq. 8): [`crate::sph::laws::pressure`], [`crate::sph::laws::viscosity`], [`crate::sph::laws::transport_velocity`];
//!   or the forces of the laws that have a factor of their own, such as [`crate::sph::laws::riemann`];
//! * transport acceleration: P = c p(0) r_ij (their eq. 13);
//! * temperature: [`crate::sph::laws::conduction`] (Cleary 1998).
//!
//! The adjoint is gathered too. A pair adds l = c (alpha.e + beta.r) + gamma V_i V_j F (T_i - T_j) to the
//! scalar product of cotangent and rates, alpha = a_bar_i/m_i - a_bar_j/m_j and beta, gamma likewise; row i
//! sums the derivatives of l by i's own fields, and walls have rows as well. No scatter, no atomics.

use super::chain::{Masses, Step};
use super::pair_cache::PairCache;
use super::records::{record_fields, record_temperature};
use crate::numerics::lanes::{lanes_of_rows, Lanes, Real};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed;
use crate::sph::flow::{Heat, Materials};
use crate::sph::laws::{
    conduction, dot, with_laws, Bars, Conduction, Faces, Flux, Pair, PairBar, PairFields, PairLaw, PairTensors, Side,
    SideBar, Sums, TransportVelocity,
};
use crate::sph::masks;
use crate::sph::own::Own;
use crate::sph::pairs::{self, get, packed, splat_fields, stride, vector, Fields, Names, Records, RowGeometry};
use candle_core::{Result, Tensor};
use std::ops::Range;

#[inline(always)]
fn side<L: Lanes, W: PairLaw, const D: usize>(f: &Fields<L>) -> Side<L, D> {
    let density = get(f, D + 1);
    let half = L::splat(L::Real::of(0.5)) * density;
    let mut side = Side {
        volume: get(f, D),
        density,
        velocity: vector(f, D + 2),
        transport: [L::zero(); D],
        temperature: if W::HEAT { get(f, record_temperature(D, W::TRANSPORT)) } else { L::zero() },
        conductivity: L::zero(),
        facing: [L::zero(); D],
        crossing: L::zero(),
    };
    if W::TRANSPORT {
        for d in 0..D {
            side.transport[d] = half * get(f, 2 * D + 2 + d);
        }
    }
    side
}

/// The conductivities of particles; empty where `W` reads none.
#[inline(always)]
fn conductivities<R: Real, W: PairLaw>(step: &Step<R>) -> Records<'_, R> {
    let all = step.model.heat.as_ref().and_then(Heat::conductivities).filter(|_| W::MATERIALS);
    Records::new(all.unwrap_or_default(), W::MATERIALS as usize, step.model.particles())
}

/// Numbers of a record of [`Side::facing`] and [`Side::crossing`].
const FACE: usize = 4;

/// Records of what laws read of the particles at a wall: `facing` D, `crossing`; none where they read none.
fn faces_of<R: Real, W: PairLaw>(_: &W, step: &Step<R>, moved: &[R], kept: &PairCache<R>) -> Buffer<R> {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let (d, width) = (l.dimension, stride(record_fields(l.dimension, l.transport, l.heat)));
    packed(model, if W::FACES { FACE } else { 0 }, |i, face| {
        face.fill(R::default());
        for k in 0..if W::FACES { d } else { 0 } {
            if model.is_fluid(i) {
                let temperature = || kept.records[i * width + record_temperature(d, l.transport)].f64();
                face[k] = R::of(model.given(k, moved[n + i].f64(), temperature));
            } else {
                face[k] = model.normal(k, i);
                face[d] += face[k] * moved[(l.velocity() + k) * n + i];
            }
        }
    })
}

/// Adds the face of the neighbours to their fields.
#[inline(always)]
fn face<L: Lanes, W: PairLaw, const D: usize>(faces: Records<'_, L::Real>, names: Names<'_, L>, side: &mut Side<L, D>) {
    if W::FACES {
        let [face] = faces.groups(names);
        side.facing.copy_from_slice(&face[..D]);
        side.crossing = face[D];
    }
}

/// The same of a row's own particle.
#[inline(always)]
fn own_face<L: Lanes, W: PairLaw, const D: usize>(faces: Records<'_, L::Real>, i: usize, side: &mut Side<L, D>) {
    if W::FACES {
        let face = faces.of(i);
        for d in 0..D {
            side.facing[d] = L::splat(face[d]);
        }
        side.crossing = L::splat(face[D]);
    }
}

/// The records of a step.
#[inline(always)]
fn records<'a, R: Real, W: PairLaw, const D: usize>(step: &Step<R>, kept: &'a PairCache<R>) -> Records<'a, R> {
    let width = stride(const { record_fields(D, W::TRANSPORT, W::HEAT) });
    Records::new(&kept.records, width, step.model.particles())
}

struct Forward<'a, R, W, const D: usize> {
    step: &'a Step<R>,
    laws: W,
    kept: &'a PairCache<R>,
    faces: Records<'a, R>,
    mass: Masses<'a, R>,
    rates: Own<'a, R>,
}

impl<R: Real, W: PairLaw, const D: usize> Forward<'_, R, W, D> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> Sums<L, D> {
        let list = &*self.step.list;
        let fields = const { record_fields(D, W::TRANSPORT, W::HEAT) };
        let (records, conductivities) = (records::<R, W, D>(self.step, self.kept), conductivities::<R, W>(self.step));
        let own = splat_fields::<L>(records.of(i), fields);
        let (here, mut a): ([L; D], _) = (vector(&own, 0), side::<L, W, D>(&own));
        if W::MATERIALS {
            a.conductivity = L::splat(conductivities.of(i)[0]);
        }
        own_face::<L, W, D>(self.faces, i, &mut a);
        let prepared = self.laws.prepare(&a);
        let volume2 = a.volume * a.volume;
        let zero = [L::zero(); D];
        let mut sums = Sums { common: zero, force: zero, spread: zero, warmth: L::zero() };
        let fluids = list.fluid_count[i] as usize;
        for (k, (names, mask, slope)) in pairs::row_with::<L>(list, i, &self.kept.slope).enumerate() {
            let other = records.fields(fields, names);
            let (there, mut b): ([L; D], _) = (vector(&other, 0), side::<L, W, D>(&other));
            if W::MATERIALS {
                b.conductivity = conductivities.numbers(names);
            }
            face::<L, W, D>(self.faces, names, &mut b);
            let (difference, square) = geometry.difference::<EDGE>(&here, &there);
            let weight = b.volume.mul_add(b.volume, volume2) * slope;
            let fluid = mask.up_to(k * L::COUNT, fluids);
            let pair = Pair { own: &a, other: &b, difference, square, slope, weight, fluid, own_is_fluid: true };
            sums.common = zero;
            self.laws.add(&prepared, &pair, &mut sums);
            for d in 0..D {
                sums.force[d] = weight.mul_add(sums.common[d], sums.force[d]);
            }
        }
        sums
    }
}

impl<R: Real, W: PairLaw, const D: usize> RowKernel<R> for Forward<'_, R, W, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let n = model.particles();
        let geometry = RowGeometry::<L, D>::new(model);
        let records = records::<R, W, D>(self.step, self.kept);
        let vacuum = R::of(model.equation_of_state.at_vacuum());
        let conduction = R::of(conduction::factor(model));
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let record = records.of(i);
            let sums = match geometry.at_edge(record) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            let inverse_mass = R::of(1.0) / self.mass.of(i);
            for d in 0..D {
                let temperature = || record[record_temperature(D, W::TRANSPORT)].f64();
                let given = R::of(model.given(d, record[1].f64(), temperature));
                self.rates.set(d * n + i, sums.force[d].sum() * inverse_mass + given);
                if W::TRANSPORT {
                    self.rates.set((D + d) * n + i, vacuum * sums.spread[d].sum() * inverse_mass);
                }
            }
            if W::HEAT {
                let rate = conduction * inverse_mass * sums.warmth.sum() / conduction::capacity(model, i);
                let open = conduction::conducts(model, record[0]);
                self.rates.set(model.layout.rate_temperature() * n + i, if open { rate } else { R::default() });
            }
        }
    }
}

/// The forward pass, on plain numbers, from [`PairCache`]'s pairs and records. `rates` must be zero for walls.
pub fn forward<R: Real>(step: &Step<R>, moved: &[R], kept: &PairCache<R>, rates: &mut [R]) {
    let (mass, n) = (Masses::new(&step.model, moved), step.model.particles());
    let rates = Own::new(rates);
    with_laws!(&*step.model, |laws, D| {
        let faces = faces_of(&laws, step, moved, kept);
        let faces = Records::new(&faces, faces.len() / n.max(1), n);
        let kernel = Forward::<R, _, D> { step, laws, kept, faces, mass, rates };
        step.model.sweep(&step.list, &kernel, &kernel.rates, step.model.layout.rate_rows());
    })
}

/// The rates from the state at the step's end, which has them.
pub fn known<R: Real>(step: &Step<R>, state: &[R], rates: &mut [R]) {
    let (n, l) = (step.model.particles(), step.model.layout);
    let accelerations = l.rate_temperature() * n;
    rates[..accelerations].copy_from_slice(&state[l.acceleration() * n..][..accelerations]);
    if l.heat {
        rates[accelerations..].copy_from_slice(&state[l.temperature_rate() * n..][..n]);
    }
}

struct Backward<'a, R, W, const D: usize> {
    step: &'a Step<R>,
    laws: W,
    kept: &'a PairCache<R>,
    faces: Records<'a, R>,
    /// Cotangents of the rates over mass, `[N, 4 or 8]`: acceleration D, [p(0) transport D], [K temperature].
    bars: Records<'a, R>,
    mass: Masses<'a, R>,
    moved_bar: Own<'a, R>,
    primitives_bar: Own<'a, R>,
}

const fn bar_fields(d: usize, transport: bool, heat: bool) -> usize {
    d + if transport { d } else { 0 } + heat as usize
}

/// The cotangents of a pair from the records of both sides.
#[inline(always)]
fn bars_of<L: Lanes, W: PairLaw, const D: usize>(own: &Fields<L>, other: &Fields<L>, along: &[L; D]) -> Bars<L, D> {
    let difference = |q: usize| get(own, q) - get(other, q);
    let zero = [L::zero(); D];
    let mut bars = Bars { acceleration: zero, along: L::zero(), transport: zero, temperature: L::zero() };
    for d in 0..D {
        bars.acceleration[d] = difference(d);
        if W::TRANSPORT {
            bars.transport[d] = difference(D + d);
        }
    }
    bars.along = dot(&bars.acceleration, along);
    if W::HEAT {
        bars.temperature = difference(if W::TRANSPORT { 2 * D } else { D });
    }
    bars
}

impl<R: Real, W: PairLaw, const D: usize> Backward<'_, R, W, D> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> SideBar<L, D> {
        let list = &*self.step.list;
        let fields = const { record_fields(D, W::TRANSPORT, W::HEAT) };
        let bar_fields = const { bar_fields(D, W::TRANSPORT, W::HEAT) };
        let two = L::splat(R::of(2.0));
        let (records, conductivities) = (records::<R, W, D>(self.step, self.kept), conductivities::<R, W>(self.step));
        let own = splat_fields::<L>(records.of(i), fields);
        let (here, mut a): ([L; D], _) = (vector(&own, 0), side::<L, W, D>(&own));
        if W::MATERIALS {
            a.conductivity = L::splat(conductivities.of(i)[0]);
        }
        own_face::<L, W, D>(self.faces, i, &mut a);
        let prepared = self.laws.prepare(&a);
        let own_bar = splat_fields::<L>(self.bars.of(i), bar_fields);
        let volume2 = a.volume * a.volume;
        let (zero, none) = ([L::zero(); D], L::zero());
        let own = SideBar {
            volume: none,
            density: none,
            velocity: zero,
            transport: zero,
            temperature: none,
            facing: zero,
            crossing: none,
            position: zero,
        };
        let mut bar = PairBar { scalar: none, by_difference: zero, by_slope: none, own };
        let own_is_fluid = self.step.model.is_fluid(i);
        let fluids = if own_is_fluid { list.fluid_count[i] as usize } else { 0 };
        for (k, (names, mask)) in pairs::row::<L>(list, i).enumerate() {
            let (other, other_bar) = (records.fields(fields, names), self.bars.fields(bar_fields, names));
            let (there, mut b): ([L; D], _) = (vector(&other, 0), side::<L, W, D>(&other));
            if W::MATERIALS {
                b.conductivity = conductivities.numbers(names);
            }
            face::<L, W, D>(self.faces, names, &mut b);
            let (difference, square) = geometry.difference::<EDGE>(&here, &there);
            let (_, slope, curvature) = geometry.kernel.all(square);
            let (slope, curvature) = (mask.apply(slope), mask.apply(curvature));
            let volumes2 = b.volume.mul_add(b.volume, volume2);
            let weight = volumes2 * slope;
            let bars = bars_of::<L, W, D>(&own_bar, &other_bar, &difference);
            let fluid = mask.up_to(k * L::COUNT, fluids);
            let pair = Pair { own: &a, other: &b, difference, square, slope, weight, fluid, own_is_fluid };
            bar = PairBar { scalar: none, by_difference: zero, by_slope: none, ..bar };
            self.laws.adjoint(&prepared, &pair, &bars, &mut bar);
            bar.own.volume = (slope * bar.scalar).mul_add(two * a.volume, bar.own.volume);
            let radial = volumes2.mul_add(bar.scalar, bar.by_slope) * curvature;
            for d in 0..D {
                bar.own.position[d] += radial.mul_add(difference[d], weight * bar.by_difference[d]);
            }
        }
        bar.own
    }
}

impl<R: Real, W: PairLaw, const D: usize> RowKernel<R> for Backward<'_, R, W, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let geometry = RowGeometry::<L, D>::new(model);
        let records = records::<R, W, D>(self.step, self.kept);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let record = records.of(i);
            let bar = match geometry.at_edge(record) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            // From the record's fields back to the operator's inputs, all of them particle i's own.
            let (volume, density) = (record[D], record[D + 1]);
            let mut density_bar = bar.density.sum();
            let volume_bar = bar.volume.sum();
            density_bar -= volume_bar * volume / density;
            for d in 0..D {
                self.moved_bar.add(d * n + i, bar.position[d].sum());
                self.primitives_bar.set((l.primitive_velocity() + d) * n + i, bar.velocity[d].sum());
                if W::TRANSPORT {
                    // transport = rho w / 2
                    let t = bar.transport[d].sum();
                    let half = R::of(0.5) * t;
                    density_bar += half * record[2 * D + 2 + d];
                    self.primitives_bar.set((l.primitive_shift() + d) * n + i, half * density);
                }
            }
            if W::HEAT {
                let mut temperature_bar = bar.temperature.sum();
                if let Some(buoyancy) = &model.buoyancy {
                    // (The records have the cotangents over the mass, zeros for walls.)
                    for d in 0..D {
                        let mut force_bar = self.bars.of(i)[d] * self.mass.of(i);
                        if W::FACES && model.is_fluid(i) {
                            force_bar += bar.facing[d].sum();
                        }
                        temperature_bar += R::of(buoyancy.by[d]) * force_bar;
                    }
                }
                self.primitives_bar.set(l.primitive_temperature() * n + i, temperature_bar);
            }
            if W::FACES && !model.is_fluid(i) {
                let crossing = bar.crossing.sum();
                for d in 0..D {
                    self.moved_bar.add((l.velocity() + d) * n + i, crossing * model.normal(d, i));
                }
            }
            self.primitives_bar.set(i, density_bar);
            if l.mass {
                self.moved_bar.add(l.moved_mass() * n + i, volume_bar * volume / self.mass.of(i));
            }
        }
    }
}

/// Packs the cotangents, and adds the share of the factor 1/m_i to the cotangent of the mass. `rates` are read where particles have masses
/// of their own.
fn pack_bars<R: Real>(
    step: &Step<R>,
    moved: &[R],
    rates: &[R],
    rates_bar: &[R],
    moved_bar: &Own<'_, R>,
    mass: Masses<'_, R>,
) -> Buffer<R> {
    let model = &*step.model;
    let (n, l) = (model.particles(), model.layout);
    let d = l.dimension;
    let vacuum = R::of(model.equation_of_state.at_vacuum());
    let conduction = R::of(conduction::factor(model));
    packed(model, stride(bar_fields(d, l.transport, l.heat)), |i, bar| {
        bar.fill(R::default());
        if !model.is_fluid(i) {
            return;
        }
        let inverse_mass = R::of(1.0) / mass.of(i);
        // Cotangent . (pair part of the rates).
        let mut power = R::default();
        for k in 0..d {
            let a = rates_bar[k * n + i];
            bar[k] = a * inverse_mass;
            let temperature = l.moved_temperature() * n + i;
            let given = R::of(model.given(k, moved[n + i].f64(), || moved[temperature].f64()));
            if l.mass {
                power += a * (rates[k * n + i] - given);
            }
            if l.transport {
                let b = rates_bar[(d + k) * n + i];
                bar[d + k] = vacuum * b * inverse_mass;
                if l.mass {
                    power += b * rates[(d + k) * n + i];
                }
            }
        }
        if l.heat && conduction::conducts(model, moved[i]) {
            let t = rates_bar[l.rate_temperature() * n + i];
            bar[if l.transport { 2 * d } else { d }] = conduction * t * inverse_mass / conduction::capacity(model, i);
            if l.mass {
                power += t * rates[l.rate_temperature() * n + i];
            }
        }
        if l.mass {
            moved_bar.add(l.moved_mass() * n + i, -power * inverse_mass);
        }
    })
}

/// The adjoint, on plain numbers: adds to `moved_bar`; `primitives_bar` must be zero for particles without a row. `rates` are read where
/// particles have masses of their own.
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
    let width = stride(bar_fields(l.dimension, l.transport, l.heat));
    let (moved_bar, primitives_bar) = (Own::new(moved_bar), Own::new(primitives_bar));
    let bars = pack_bars(step, moved, rates, rates_bar, &moved_bar, mass);
    let bars = Records::new(&bars, width, n);
    with_laws!(model, |laws, D| {
        let faces = faces_of(&laws, step, moved, kept);
        let faces = Records::new(&faces, faces.len() / n.max(1), n);
        let backward = Backward::<R, _, D> { step, laws, kept, faces, bars, mass, moved_bar, primitives_bar };
        run_rows(&backward, pairs::all_rows(&step.list))
    });
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
    let mass = step.mass(moved)?;
    let density = primitives.narrow(0, 0, 1)?;
    let volume = mass.div(&density)?;
    let slope = model.kernel.composed(&pairs.distance)?.1.mul(&pairs.mask)?;
    let weight = (pairs.own(&volume)?.sqr()? + pairs.other(&volume)?.sqr()?)?.mul(&slope)?;
    let optional =
        |wanted: bool, row: usize, count: usize| wanted.then(|| primitives.narrow(0, row, count)).transpose();
    let materials = model.heat.as_ref().and_then(|heat| heat.materials.as_ref());
    let of_materials = |what: fn(&Materials<R>) -> &Vec<R>| {
        materials.map(|materials| masks::per_particle(what(materials).clone(), moved)).transpose()
    };
    let given = model.given_composed(&moved.narrow(0, 0, d)?, primitives, l.primitive_temperature())?;
    let velocity = primitives.narrow(0, l.primitive_velocity(), d)?;
    let walls = pairs.is_fluid.affine(-1.0, 1.0)?;
    let of_walls = moved.narrow(0, l.velocity(), d)?.broadcast_mul(&walls)?;
    let faces = Faces {
        given: given.clone(),
        normals: model.normals(moved)?,
        velocity: (velocity.broadcast_mul(&pairs.is_fluid)? + of_walls)?,
    };
    let fields = PairFields {
        volume,
        density,
        velocity,
        shift: optional(l.transport, l.primitive_shift(), d)?,
        temperature: optional(l.heat, l.primitive_temperature(), 1)?,
        conductivity: of_materials(|materials| &materials.conductivity)?,
        slope,
        weight,
        mass: mass.clone(),
        faces,
    };
    let mut sums = PairTensors::default();
    if let Flux::Riemann(law) = &model.laws.flux {
        law.fluxes(model.equation_of_state, model.viscosity).composed(pairs, &fields, &mut sums)?;
        if l.transport {
            TransportVelocity::spread(pairs, &fields, &mut sums)?;
        }
        if l.heat {
            // (With the conductivities that the fields have.)
            Conduction::<false>.composed(pairs, &fields, &mut sums)?;
        }
        model.laws.further.composed(pairs, &fields, &mut sums)?;
    } else {
        with_laws!(model, |laws, _D| laws.composed(pairs, &fields, &mut sums))?;
    }
    if let Some(common) = &sums.common {
        PairTensors::add(&mut sums.force, common.broadcast_mul(&fields.weight)?.sum(2)?)?;
    }
    let nothing = || fields.velocity.zeros_like();
    let only_fluid = pairs.is_fluid.clone();
    let per_mass = |sum: Tensor| sum.broadcast_div(&mass)?.broadcast_mul(&only_fluid);
    let pair_forces = per_mass(sums.force.map_or_else(nothing, Ok)?)?;
    let acceleration = (pair_forces + given.broadcast_mul(&only_fluid)?)?;
    let mut rates = vec![acceleration];
    if let Some(spread) = sums.spread {
        rates.push(per_mass(spread.affine(model.equation_of_state.at_vacuum(), 0.0)?)?);
    }
    if let Some(warmth) = sums.warmth {
        let open = conduction::conducts_composed(model, &moved.narrow(0, 0, 1)?)?;
        let rate = per_mass(warmth.affine(conduction::factor(model), 0.0)?)?.mul(&open)?;
        rates.push(match of_materials(|materials| &materials.capacity)? {
            Some(capacity) => rate.div(&capacity)?,
            None => rate,
        });
    }
    Tensor::cat(&rates, 0)
}
