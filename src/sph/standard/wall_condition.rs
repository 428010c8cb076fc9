//! Fields of all particles before the pair pass: the fluid's own, and the walls' extrapolated from it.
//!
//! Generalised wall boundary condition (Adami, Hu and Adams 2012, eq. 22-27): with Shepard averages over the
//! fluid neighbours j of a wall particle, `<x> = sum_j x_j W_ij / (sum_j W_ij + eps)`,
//!
//! * velocity `2 u_wall - <u>` (no slip), transport shift `2 w_wall - <w>`;
//! * pressure `<p>`, and density from it by the equation of state;
//! * temperature `wall_constant + wall_factor <T>`, with T before this step's conduction as in JAX-SPH:
//!   adiabatic (0, 1), held in the dummy particles (T_hot, 0), or held on the surface (2 T_hot, -1), which
//!   puts the isotherm where the wall is instead of half a spacing behind it.
//!
//! eps = 2.2e-16 (f64's machine epsilon, in f32 too: the sums it guards have the same size there).
//! A body force across walls, which gravity with buoyancy is, adds sum_j rho_j g_j.r_ij W_ij to the sum of pressures (their eq. 27). Where
//! the flow slips along the walls, `<u> + 2 n n.(u_wall - <u>)` with the wall's normal n: only what crosses the wall turns
//! around. In Riemann problems walls keep their own density, see [`crate::sph::laws::riemann`].
//!
//! Adjoint: wall rows compute D = cotangents of their weighted sums; fluid rows gather them from the walls
//! that they reach.

use super::chain::{Chain, Masses, Step};
use super::model::Standard;
use super::pair_cache::PairCache;
use super::records::{dispatch, record_fields, record_temperature};
use super::sweeps::Sweeps;
use crate::numerics::candle::Operator;
use crate::numerics::lanes::{array, lanes_of_rows, Lanes, Real};
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed;
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::{dot, Flux, Slip};
use crate::sph::masks;
use crate::sph::own::Own;
use crate::sph::pairs::{
    self, gather_fields, get, pack_positions, splat_fields, stride, vector, Fields, Records, RowGeometry,
};
use candle_core::{Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// Guard of the Shepard sums.
const EPSILON: f64 = f64::EPSILON;

/// moved `[M, N]`, density `[1, N]` (fluid) -> primitives `[C, N]`.
pub struct WallCondition<R: Sweeps>(pub Arc<Chain<R>>);

/// What walls average over their fluid neighbours.
#[derive(Clone, Copy)]
struct Averages<T, const D: usize> {
    velocity: [T; D],
    shift: [T; D],
    pressure: T,
    temperature: T,
}

impl<T: Copy, const D: usize> Averages<T, D> {
    fn all(value: T) -> Self {
        Self { velocity: [value; D], shift: [value; D], pressure: value, temperature: value }
    }

    /// Each field through `f`.
    #[inline(always)]
    fn map<U: Copy>(&self, mut f: impl FnMut(T) -> U) -> Averages<U, D> {
        let pressure = f(self.pressure);
        let mut mapped = Averages::all(pressure);
        for d in 0..D {
            mapped.velocity[d] = f(self.velocity[d]);
            mapped.shift[d] = f(self.shift[d]);
        }
        mapped.temperature = f(self.temperature);
        mapped
    }
}

/// What is averaged of a fluid particle, from its record.
#[inline(always)]
fn averaged<R: Real, L: Lanes<Real = R>, const D: usize, const TRANSPORT: bool, const HEAT: bool>(
    step: &Step<R>,
    f: &Fields<L>,
) -> Averages<L, D> {
    let mut fields = Averages::all(L::zero());
    fields.velocity = vector(f, D + 2);
    if TRANSPORT {
        fields.shift = vector(f, 2 * D + 2);
    }
    fields.pressure = step.model.equation_of_state.pressure_lanes(get(f, D + 1));
    if HEAT {
        fields.temperature = get(f, record_temperature(D, TRANSPORT) + 1);
    }
    fields
}

/// A body force that is felt across walls: gravity, and buoyancy by the temperature of each fluid particle.
struct AcrossWalls<L> {
    gravity: [L; 3],
    /// `by` and `at`, see [`crate::sph::laws::buoyancy`].
    buoyancy: Option<([L; 3], L)>,
}

impl<R: Real, L: Lanes<Real = R>> AcrossWalls<L> {
    #[inline(always)]
    fn of(step: &Step<R>) -> Option<Self> {
        let BodyForce::Gravity(gravity) = step.model.body_force else { return None };
        let vector = |v: [f64; 3]| [L::splat(R::of(v[0])), L::splat(R::of(v[1])), L::splat(R::of(v[2]))];
        let buoyancy = step.model.buoyancy.map(|buoyancy| (vector(buoyancy.by), L::splat(R::of(buoyancy.at))));
        Some(Self { gravity: vector(gravity), buoyancy })
    }

    /// The acceleration of fluid.
    #[inline(always)]
    fn at<const D: usize, const TRANSPORT: bool, const HEAT: bool>(&self, f: &Fields<L>) -> [L; D] {
        let mut felt = [L::zero(); D];
        felt.copy_from_slice(&self.gravity[..D]);
        if let (Some((by, at)), true) = (&self.buoyancy, HEAT) {
            let excess = get(f, record_temperature(D, TRANSPORT)) - *at;
            for d in 0..D {
                felt[d] = by[d].mul_add(excess, felt[d]);
            }
        }
        felt
    }
}

/// rho_j g . r for r from fluid j to a wall, and p_j with it.
#[inline(always)]
fn lifted<L: Lanes, const D: usize>(gravity: &[L; D], r: &[L; D], there: &Fields<L>, pressure: L) -> L {
    get(there, D + 1).mul_add(dot(gravity, r), pressure)
}

/// Sums of W and of W times the fields over a wall particle's row. `records` are those of the step, of fluid at least.
#[inline(always)]
fn wall_sums<R: Real, L: Lanes<Real = R>, const D: usize, const TRANSPORT: bool, const HEAT: bool>(
    step: &Step<R>,
    geometry: &RowGeometry<L, D>,
    position: Records<'_, R>,
    records: *const R,
    i: usize,
) -> (L, Averages<L, D>) {
    let here = splat_fields::<L>(position.of(i), 4);
    let across = AcrossWalls::<L>::of(step);
    let mut weight = L::zero();
    let mut sums = Averages::<L, D>::all(L::zero());
    for (names, mask) in pairs::row::<L>(&step.list, i) {
        // SAFETY: `row` gives particles of fluid, whose records are packed.
        let there = unsafe { gather_fields::<L>(records, record_fields(D, TRANSPORT, HEAT), names) };
        let (dr, r2) = geometry.difference::<true>(&here[0], &there[0]);
        let w = mask.apply(geometry.kernel.value(r2));
        weight += w;
        let mut fields = averaged::<R, L, D, TRANSPORT, HEAT>(step, &there);
        if let Some(across) = &across {
            let gravity = across.at::<D, TRANSPORT, HEAT>(&there);
            fields.pressure = lifted::<L, D>(&gravity, &dr, &there, fields.pressure);
        }
        for d in 0..D {
            sums.velocity[d] = w.mul_add(fields.velocity[d], sums.velocity[d]);
            sums.shift[d] = w.mul_add(fields.shift[d], sums.shift[d]);
        }
        sums.pressure = w.mul_add(fields.pressure, sums.pressure);
        sums.temperature = w.mul_add(fields.temperature, sums.temperature);
    }
    (weight, sums)
}

/// Sums over their guarded weight. The guard acts on the absolute temperature in JAX-SPH, hence its
/// reference here, where temperatures are differences to it.
#[inline(always)]
fn averages<R: Real, const D: usize>(step: &Step<R>, weight: R, sums: &Averages<R, D>) -> Averages<R, D> {
    let inverse = R::of(1.0) / (weight + R::of(EPSILON));
    let mut average = sums.map(|sum| sum * inverse);
    if let Some(heat) = &step.model.heat {
        average.temperature -= R::of(EPSILON * heat.reference) * inverse;
    }
    average
}

/// n n.x, the part of a vector at a wall particle that crosses the wall.
#[inline(always)]
fn across<R: Real, const D: usize>(model: &Standard<R>, i: usize, x: &[R; D]) -> [R; D] {
    let mut along = R::default();
    for d in 0..D {
        along += x[d] * model.normal(d, i);
    }
    array(|d| along * model.normal(d, i))
}

/// A wall particle's own fields, from the averages: density, velocity, shift, temperature.
struct WallValues<R, const D: usize> {
    density: R,
    velocity: [R; D],
    shift: [R; D],
    temperature: R,
}

#[inline(always)]
fn wall_values<R: Real, const D: usize>(
    step: &Step<R>,
    moved: &[R],
    average: &Averages<R, D>,
    i: usize,
) -> WallValues<R, D> {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let two = R::of(2.0);
    let mut values = WallValues {
        density: match (model.laws.flux, l.density) {
            (Flux::Riemann(_), true) => moved[l.moved_density() * n + i],
            (Flux::Riemann(_), false) => R::of(model.equation_of_state.reference_density),
            _ => model.equation_of_state.density(average.pressure),
        },
        velocity: [R::default(); D],
        shift: [R::default(); D],
        temperature: R::default(),
    };
    let mirrored = |row: usize, average: &[R; D]| {
        let own: [R; D] = array(|d| moved[(row + d) * n + i]);
        if model.laws.slip == Slip::None {
            return array(|d| two * own[d] - average[d]);
        }
        let across: [R; D] = across(model, i, &array(|d| own[d] - average[d]));
        array(|d| average[d] + two * across[d])
    };
    values.velocity = mirrored(l.velocity(), &average.velocity);
    if l.transport {
        values.shift = mirrored(l.moved_shift(), &average.shift);
    }
    if let Some(heat) = &model.heat {
        values.temperature = heat.wall_constant[i] + heat.wall_factor[i] * average.temperature;
    }
    values
}

/// Where a wall particle's fields go.
fn store_rows<R: Real, const D: usize>(
    step: &Step<R>,
    values: &WallValues<R, D>,
    i: usize,
    mut set: impl FnMut(usize, R),
) {
    let (n, l) = (step.model.particles(), step.model.layout);
    set(i, values.density);
    for d in 0..D {
        set((l.primitive_velocity() + d) * n + i, values.velocity[d]);
        if l.transport {
            set((l.primitive_shift() + d) * n + i, values.shift[d]);
        }
    }
    if l.heat {
        set(l.primitive_temperature() * n + i, values.temperature);
    }
}

/// Packs the fluid's records.
struct FluidRecords<'a, R> {
    step: &'a Step<R>,
    particles: &'a [u32],
    moved: &'a [R],
    density: &'a [R],
    mass: Masses<'a, R>,
    records: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for FluidRecords<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let l = self.step.model.layout;
        let width = stride(record_fields(l.dimension, l.transport, l.heat));
        for row in rows {
            let i = self.particles[row] as usize;
            // SAFETY: each row writes its own record.
            let record = unsafe { self.records.slice(i * width..(i + 1) * width) };
            pack_fluid(self.step, self.moved, self.mass.of(i), self.density[i], i, record);
        }
    }
}

/// Writes the record of a fluid particle, whose primitives are its own.
#[inline(always)]
pub fn pack_fluid<R: Real>(step: &Step<R>, moved: &[R], mass: R, density: R, i: usize, record: &mut [R]) {
    let (n, l) = (step.model.particles(), step.model.layout);
    let d = l.dimension;
    for k in 0..d {
        record[k] = moved[k * n + i];
        record[d + 2 + k] = moved[(l.velocity() + k) * n + i];
        if l.transport {
            record[2 * d + 2 + k] = moved[(l.moved_shift() + k) * n + i];
        }
    }
    record[d] = mass / density;
    record[d + 1] = density;
    if l.heat {
        let at = record_temperature(d, l.transport);
        record[at] = moved[l.moved_temperature() * n + i];
        record[at + 1] = moved[l.moved_old_temperature() * n + i];
    }
}

/// Extrapolates to the walls in reach of fluid. Reads records of fluid, writes records of walls.
struct Walls<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    position: Records<'a, R>,
    moved: &'a [R],
    mass: Masses<'a, R>,
    records: Own<'a, R>,
    primitives: Option<Own<'a, R>>,
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for Walls<'_, R, D, TRANSPORT, HEAT>
{
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (step, model, list) = (self.step, &*self.step.model, &*self.step.list);
        let n = model.particles();
        let geometry = RowGeometry::<L, D>::new(model);
        let width = stride(record_fields(D, TRANSPORT, HEAT));
        for row in rows {
            let i = list.wall_rows[row] as usize;
            let records = self.records.as_ptr();
            let (weight, sums) = wall_sums::<R, L, D, TRANSPORT, HEAT>(step, &geometry, self.position, records, i);
            let average = averages(step, weight.sum(), &sums.map(|sum| sum.sum()));
            let values = wall_values(step, self.moved, &average, i);
            // SAFETY: each wall row writes its own record.
            let record = unsafe { self.records.slice(i * width..(i + 1) * width) };
            for d in 0..D {
                record[d] = self.moved[d * n + i];
                record[D + 2 + d] = values.velocity[d];
                if TRANSPORT {
                    record[2 * D + 2 + d] = values.shift[d];
                }
            }
            record[D] = self.mass.of(i) / values.density;
            record[D + 1] = values.density;
            if HEAT {
                record[record_temperature(D, TRANSPORT)] = values.temperature;
            }
            if let Some(primitives) = &self.primitives {
                store_rows(step, &values, i, |place, value| primitives.set(place, value));
            }
        }
    }
}

/// The forward pass, on plain numbers: fills [`PairCache`]'s records, and `primitives` if somebody wants to read them.
pub fn forward<R: Real>(
    step: &Step<R>,
    moved: &[R],
    density: &[R],
    kept: &mut PairCache<R>,
    mut primitives: Option<&mut [R]>,
) {
    let (model, list) = (&*step.model, &*step.list);
    let (n, l) = (model.particles(), model.layout);
    if let Some(primitives) = &mut primitives {
        primitives[..n].copy_from_slice(&density[..n]);
        let mut copy = |to: usize, from: usize, count: usize| {
            primitives[to * n..(to + count) * n].copy_from_slice(&moved[from * n..(from + count) * n]);
        };
        copy(l.primitive_velocity(), l.velocity(), l.dimension);
        if l.transport {
            copy(l.primitive_shift(), l.moved_shift(), l.dimension);
        }
        if l.heat {
            copy(l.primitive_temperature(), l.moved_temperature(), 1);
        }
    }
    let mass = Masses::new(model, moved);
    let mut records = std::mem::take(&mut kept.records);
    records.resize(stride(record_fields(l.dimension, l.transport, l.heat)) * n, R::default());
    let own: &[u32] = if kept.has_fluid_records { &[] } else { &list.fluid_rows };
    for particles in [own, &list.fluid_copies] {
        let records = Own::new(&mut records);
        run_rows(&FluidRecords { step, particles, moved, density, mass, records }, particles.len());
    }
    if list.fluid_rows.len() < n && !kept.has_pairs {
        pack_positions(model, moved, None, &mut kept.position);
    }
    macro_rules! go {
        ($d:literal, $transport:literal, $heat:literal) => {{
            if let Some(primitives) = &mut primitives {
                // Walls that no fluid reaches: averages of nothing.
                let nothing = averages(step, R::default(), &Averages::<R, $d>::all(R::default()));
                for i in 0..n {
                    if !model.is_fluid(i) && list.count[i] == 0 {
                        let values = wall_values(step, moved, &nothing, i);
                        store_rows(step, &values, i, |place, value| primitives[place] = value);
                    }
                }
            }
            let walls = Walls::<R, $d, $transport, $heat> {
                step,
                position: Records::new(&kept.position, 4, n),
                moved,
                mass,
                records: Own::new(&mut records),
                primitives: primitives.map(Own::new),
            };
            run_rows(&walls, list.wall_rows.len())
        }};
    }
    if list.fluid_rows.len() < n {
        dispatch!(l, go);
    }
    kept.records = records;
}

const fn bar_fields(d: usize, transport: bool, heat: bool) -> usize {
    2 + d + if transport { d } else { 0 } + heat as usize
}

/// Wall rows of the adjoint: cotangents of the sums as records (of the weight, velocity D, [shift D], pressure,
/// [temperature]), and of the walls' own position.
struct WallRows<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    kept: &'a PairCache<R>,
    primitives_bar: &'a [R],
    sums_bar: Own<'a, R>,
    moved_bar: Own<'a, R>,
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for WallRows<'_, R, D, TRANSPORT, HEAT>
{
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (step, model, list, kept) = (self.step, &*self.step.model, &*self.step.list, self.kept);
        let (n, l) = (model.particles(), model.layout);
        let geometry = RowGeometry::<L, D>::new(model);
        let fields = record_fields(D, TRANSPORT, HEAT);
        let width = stride(bar_fields(D, TRANSPORT, HEAT));
        let (position, records) = kept.seen(n, fields);
        let bar = |field: usize, i: usize| self.primitives_bar[field * n + i];
        for row in rows {
            let i = list.wall_rows[row] as usize;
            let pointer = kept.records.as_ptr();
            let (weight, sums) = wall_sums::<R, L, D, TRANSPORT, HEAT>(step, &geometry, position, pointer, i);
            let weight = weight.sum();
            let average = averages(step, weight, &sums.map(|sum| sum.sum()));
            // Cotangents of the averages, over the weight: of the sums; and of the weight, which divides them all.
            let inverse = R::of(1.0) / (weight + R::of(EPSILON));
            let mut sums_bar = Averages::<R, D>::all(R::default());
            let mut weight_bar = R::default();
            // SAFETY: each wall row writes its own record.
            let record = unsafe { self.sums_bar.slice(i * width..(i + 1) * width) };
            // <x> - 2 n n.<x> where the flow slips, else -<x>.
            let turned = |row: usize| {
                let bar: [R; D] = array(|d| bar(row + d, i));
                if model.laws.slip == Slip::None {
                    return array(|d| -bar[d]);
                }
                let across = across(model, i, &bar);
                array(|d| bar[d] - R::of(2.0) * across[d])
            };
            let velocity_bar: [R; D] = turned(l.primitive_velocity());
            let shift_bar: [R; D] = if TRANSPORT { turned(l.primitive_shift()) } else { velocity_bar };
            for d in 0..D {
                sums_bar.velocity[d] = velocity_bar[d] * inverse;
                weight_bar -= sums_bar.velocity[d] * average.velocity[d];
                record[1 + d] = sums_bar.velocity[d];
                if TRANSPORT {
                    sums_bar.shift[d] = shift_bar[d] * inverse;
                    weight_bar -= sums_bar.shift[d] * average.shift[d];
                    record[1 + D + d] = sums_bar.shift[d];
                }
            }
            let at = 1 + D * (1 + TRANSPORT as usize);
            let own_density = records.of(i)[D + 1];
            if !matches!(model.laws.flux, Flux::Riemann(_)) {
                sums_bar.pressure = bar(0, i) / model.equation_of_state.slope(own_density) * inverse;
            }
            weight_bar -= sums_bar.pressure * average.pressure;
            record[at] = sums_bar.pressure;
            if let Some(heat) = &model.heat {
                sums_bar.temperature = heat.wall_factor[i] * bar(l.primitive_temperature(), i) * inverse;
                weight_bar -= sums_bar.temperature * average.temperature;
                record[at + 1] = sums_bar.temperature;
            }
            record[0] = weight_bar;
            // The wall particle's position: e_ij = weight_bar + sum_q sums_bar_q x_q(j), r_bar = sum_j e_ij F r_ij.
            let here = splat_fields::<L>(position.of(i), 4);
            let by_field = sums_bar.map(|bar| L::splat(bar));
            let across = AcrossWalls::<L>::of(step);
            let mut sum = [L::zero(); D];
            for (names, mask) in pairs::row::<L>(list, i) {
                let there = records.fields(fields, names);
                let (dr, r2) = geometry.difference::<true>(&here[0], &there[0]);
                let mut x = averaged::<R, L, D, TRANSPORT, HEAT>(step, &there);
                if let Some(across) = &across {
                    let gravity = across.at::<D, TRANSPORT, HEAT>(&there);
                    x.pressure = lifted::<L, D>(&gravity, &dr, &there, x.pressure);
                    // d(rho_j g.r)/dr = rho_j g.
                    let density = get(&there, D + 1);
                    let share = mask.apply(geometry.kernel.value(r2)) * by_field.pressure * density;
                    for d in 0..D {
                        sum[d] = share.mul_add(gravity[d], sum[d]);
                    }
                }
                let mut e = by_field.pressure.mul_add(x.pressure, L::splat(weight_bar));
                e = by_field.temperature.mul_add(x.temperature, e);
                for d in 0..D {
                    e = by_field.velocity[d].mul_add(x.velocity[d], e);
                    e = by_field.shift[d].mul_add(x.shift[d], e);
                }
                let factor = mask.apply(e * geometry.kernel.slope(r2));
                for d in 0..D {
                    sum[d] = factor.mul_add(dr[d], sum[d]);
                }
            }
            for d in 0..D {
                self.moved_bar.add(d * n + i, sum[d].sum());
            }
        }
    }
}

/// Fluid rows of the adjoint: gather from the walls in reach.
struct FluidRows<'a, R, const D: usize, const TRANSPORT: bool, const HEAT: bool> {
    step: &'a Step<R>,
    kept: &'a PairCache<R>,
    sums_bar: Records<'a, R>,
    moved_bar: Own<'a, R>,
    density_bar: Own<'a, R>,
}

impl<R: Real, const D: usize, const TRANSPORT: bool, const HEAT: bool> RowKernel<R>
    for FluidRows<'_, R, D, TRANSPORT, HEAT>
{
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (step, model, list, kept) = (self.step, &*self.step.model, &*self.step.list, self.kept);
        let (n, l) = (model.particles(), model.layout);
        let geometry = RowGeometry::<L, D>::new(model);
        let fields = record_fields(D, TRANSPORT, HEAT);
        let bar_fields = bar_fields(D, TRANSPORT, HEAT);
        let (positions, records) = kept.seen(n, fields);
        let at = 1 + D * (1 + TRANSPORT as usize);
        for row in rows {
            let j = list.fluid_rows[row] as usize;
            let (from, to) = (list.fluid_count[j] as usize, list.count[j] as usize);
            if from == to {
                continue;
            }
            let record = records.of(j);
            let own = splat_fields::<L>(record, fields);
            let x = averaged::<R, L, D, TRANSPORT, HEAT>(step, &own);
            let here = splat_fields::<L>(positions.of(j), 4);
            let mut sums = Averages::<L, D>::all(L::zero());
            let mut position = [L::zero(); D];
            let across = AcrossWalls::<L>::of(step);
            let gravity = across.as_ref().map(|across| across.at::<D, TRANSPORT, HEAT>(&own));
            let by = across.as_ref().and_then(|across| across.buoyancy.as_ref());
            // Of rho_j and T_j, by the force across walls.
            let (mut depth, mut warmth) = (L::zero(), L::zero());
            for (names, mask) in pairs::part::<L>(list, j, from, to) {
                // Fluid particles among them are masked; their records of cotangents are zero.
                let ([there], bar) = (positions.groups(names), self.sums_bar.fields(bar_fields, names));
                let get = |q: usize| pairs::get(&bar, q);
                let (dr, r2) = geometry.difference::<true>(&here[0], &there);
                let (w, f, _) = geometry.kernel.all(r2);
                let w = mask.apply(w);
                let mut pressure = x.pressure;
                if let Some(gravity) = &gravity {
                    // From here to the wall: the other way round than dr.
                    let mut along = L::zero();
                    for d in 0..D {
                        along = along - gravity[d] * dr[d];
                    }
                    let density = pairs::get(&own, D + 1);
                    pressure = density.mul_add(along, pressure);
                    let share = w * get(at);
                    depth = share.mul_add(along, depth);
                    for d in 0..D {
                        position[d] = position[d] - share * density * gravity[d];
                    }
                    if let (Some((by, _)), true) = (by, HEAT) {
                        for d in 0..D {
                            warmth = warmth - share * density * by[d] * dr[d];
                        }
                    }
                }
                let mut e = get(at).mul_add(pressure, get(0));
                sums.pressure = w.mul_add(get(at), sums.pressure);
                for d in 0..D {
                    e = get(1 + d).mul_add(x.velocity[d], e);
                    sums.velocity[d] = w.mul_add(get(1 + d), sums.velocity[d]);
                    if TRANSPORT {
                        e = get(1 + D + d).mul_add(x.shift[d], e);
                        sums.shift[d] = w.mul_add(get(1 + D + d), sums.shift[d]);
                    }
                }
                if HEAT {
                    e = get(at + 1).mul_add(x.temperature, e);
                    sums.temperature = w.mul_add(get(at + 1), sums.temperature);
                }
                let factor = mask.apply(e * f);
                for d in 0..D {
                    position[d] = factor.mul_add(dr[d], position[d]);
                }
            }
            let add = |field: usize, value: R| self.moved_bar.add(field * n + j, value);
            for d in 0..D {
                add(d, position[d].sum());
                add(l.velocity() + d, sums.velocity[d].sum());
                if TRANSPORT {
                    add(l.moved_shift() + d, sums.shift[d].sum());
                }
            }
            if HEAT {
                add(l.moved_old_temperature(), sums.temperature.sum());
                if by.is_some() {
                    add(l.moved_temperature(), warmth.sum());
                }
            }
            let slope = model.equation_of_state.slope(record[D + 1]);
            self.density_bar.add(j, sums.pressure.sum() * slope + depth.sum());
        }
    }
}

/// The adjoint, on plain numbers: adds to `moved_bar`; `density_bar` must be zero.
pub fn backward<R: Real>(
    step: &Step<R>,
    kept: &PairCache<R>,
    primitives_bar: &[R],
    moved_bar: &mut [R],
    density_bar: &mut [R],
) {
    let (model, list) = (&*step.model, &*step.list);
    let (n, l) = (model.particles(), model.layout);
    let d = l.dimension;
    // Fluid fields are copies; a wall's own velocity counts twice (where the flow slips, what crosses the wall), its own
    // temperature not at all.
    let slips = model.laws.slip == Slip::Free;
    let two = if slips { R::default() } else { R::of(2.0) };
    let mut copy = |to: usize, from: usize, count: usize, wall: R| {
        let from = &primitives_bar[from * n..(from + count) * n];
        let to = Own::new(&mut moved_bar[to * n..(to + count) * n]);
        run_rows(&Handing { model, from, to, wall }, n);
    };
    copy(l.velocity(), l.primitive_velocity(), d, two);
    if l.transport {
        copy(l.moved_shift(), l.primitive_shift(), d, two);
    }
    if l.heat {
        copy(l.moved_temperature(), l.primitive_temperature(), 1, R::default());
    }
    let walls = |wanted: bool| (0..if wanted { n } else { 0 }).filter(move |&i| !model.is_fluid(i));
    for i in walls(slips) {
        let vectors =
            [(l.velocity(), l.primitive_velocity(), true), (l.moved_shift(), l.primitive_shift(), l.transport)];
        for (to, from, _) in vectors.into_iter().filter(|(_, _, is_there)| *is_there) {
            let bar: [R; 3] = array(|k| if k < d { primitives_bar[(from + k) * n + i] } else { R::default() });
            let along = (0..d).map(|k| bar[k] * model.normal(k, i)).sum::<R>();
            (0..d).for_each(|k| moved_bar[(to + k) * n + i] += R::of(2.0) * along * model.normal(k, i));
        }
    }
    for i in walls(l.density && matches!(model.laws.flux, Flux::Riemann(_))) {
        moved_bar[l.moved_density() * n + i] += primitives_bar[i];
    }
    // (Where it is zero.)
    run_rows(&Handing { model, from: &primitives_bar[..n], to: Own::new(density_bar), wall: R::default() }, n);
    if list.fluid_rows.len() == n {
        return;
    }
    macro_rules! go {
        ($d:literal, $transport:literal, $heat:literal) => {{
            let width = stride(bar_fields($d, $transport, $heat));
            let mut sums_bar = model.scratch.buffers.buffer(width * n);
            sums_bar.fill(R::default());
            run_rows(
                &WallRows::<R, $d, $transport, $heat> {
                    step,
                    kept,
                    primitives_bar,
                    sums_bar: Own::new(&mut sums_bar),
                    moved_bar: Own::new(moved_bar),
                },
                list.wall_rows.len(),
            );
            run_rows(
                &FluidRows::<R, $d, $transport, $heat> {
                    step,
                    kept,
                    sums_bar: Records::new(&sums_bar, width, n),
                    moved_bar: Own::new(moved_bar),
                    density_bar: Own::new(density_bar),
                },
                list.fluid_rows.len(),
            );
        }};
    }
    dispatch!(l, go);
}

/// Adds to the cotangents of some rows `[rows, N]` those of others: the fluid's once, the walls' so many times.
struct Handing<'a, R: Real> {
    model: &'a Standard<R>,
    from: &'a [R],
    to: Own<'a, R>,
    wall: R,
}

impl<R: Real> RowKernel<R> for Handing<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let n = self.model.particles();
        for first in (0..self.from.len()).step_by(n) {
            let range = first + rows.start..first + rows.end;
            // SAFETY: each range of rows writes its own particles.
            let (to, from) = (unsafe { self.to.slice(range.clone()) }, &self.from[range]);
            for (k, i) in rows.clone().enumerate() {
                to[k] += if self.model.is_fluid(i) { from[k] } else { self.wall * from[k] };
            }
        }
    }
}

impl<R: Sweeps> Operator<2> for WallCondition<R> {
    type Real = R;
    const NAME: &'static str = "wall condition";

    fn forward(&self, [moved, density]: [&[R]; 2], _: [&Shape; 2]) -> Result<(Vec<R>, Shape)> {
        let step = &self.0.step;
        let (rows, n) = (step.model.layout.primitive_rows(), step.model.particles());
        let mut primitives = vec![R::default(); rows * n];
        R::primitives(step, moved, density, &mut self.0.kept(), Some(&mut primitives));
        Ok((primitives, (rows, n).into()))
    }

    fn adjoint(&self, _: [&[R]; 2], _: &[R], bar: &[R], _: [bool; 2]) -> Result<[Option<Vec<R>>; 2]> {
        let step = &self.0.step;
        let mut moved_bar = self.0.moved_bar();
        let mut density_bar = vec![R::default(); step.model.particles()];
        R::primitives_bar(step, &self.0.kept(), bar, &mut moved_bar, &mut density_bar);
        Ok([Some(moved_bar), Some(density_bar)])
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
    let w = model.kernel.composed(&pairs.distance)?.0.mul(&pairs.mask)?.mul(&pairs.other(fluid)?)?;
    let inverse = w.sum(2)?.affine(1.0, EPSILON)?.recip()?;
    let average = |x: &Tensor| pairs.other(x)?.broadcast_mul(&w)?.sum(2)?.broadcast_mul(&inverse);

    let state = model.equation_of_state;
    let mut pressure = average(&state.pressure_composed(density)?)?;
    if let BodyForce::Gravity(_) = model.body_force {
        let given = pairs.other(&model.given_composed(&moved.narrow(0, 0, d)?, moved, l.moved_temperature())?)?;
        let depth = given.mul(&pairs.difference)?.sum_keepdim(0)?.mul(&pairs.other(density)?)?.mul(&w)?;
        pressure = (pressure + depth.sum(2)?.mul(&inverse)?)?;
    }
    let of_wall = match (model.laws.flux, l.density) {
        (Flux::Riemann(_), true) => moved.narrow(0, l.moved_density(), 1)?,
        (Flux::Riemann(_), false) => density.ones_like()?.affine(state.reference_density, 0.0)?,
        _ => state.density_composed(&pressure)?,
    };
    let mut rows = vec![choose(density, &of_wall)?];
    let normals = match model.laws.slip {
        Slip::Free => Some(model.normals(moved)?),
        Slip::None => None,
    };
    // What a wall's particle shows of a vector field.
    let mirrored = |own: &Tensor| match &normals {
        None => own.affine(2.0, 0.0)? - average(own)?,
        Some(n) => {
            let mean = average(own)?;
            let across = (own - &mean)?.mul(n)?.sum_keepdim(0)?.affine(2.0, 0.0)?;
            mean + n.broadcast_mul(&across)?
        }
    };
    rows.push(choose(&velocity, &mirrored(&velocity)?)?);
    if let Some(shift) = shift {
        rows.push(choose(&shift, &mirrored(&shift)?)?);
    }
    if let Some(heat) = &model.heat {
        let constant = masks::per_particle(heat.wall_constant.clone(), moved)?;
        let factor = masks::per_particle(heat.wall_factor.clone(), moved)?;
        let old = moved.narrow(0, l.moved_old_temperature(), 1)?;
        let guard = inverse.affine(EPSILON * heat.reference, 0.0)?;
        let of_wall = (constant + factor.mul(&(average(&old)? - guard)?)?)?;
        rows.push(choose(&moved.narrow(0, l.moved_temperature(), 1)?, &of_wall)?);
    }
    Tensor::cat(&rows, 0)
}
