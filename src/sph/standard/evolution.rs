//! Density by evolution: rho' = rho + dt drho/dt, instead of [`super::density`].
//!
//! Its rate is that of [`crate::sph::laws::continuity`], with [`crate::sph::laws::density_diffusion`] in delta-SPH, or that of
//! [`crate::sph::laws::riemann`]. In front of a wall stands the density that the last step's wall condition gave the wall
//! ([`super::wall_condition`]): the state has a row of it. dt = 0 is the density as it is.
//!
//! Fused where the rate is continuity's alone. Adjoint, gathered: with c_i = rho'_bar_i dt rho_i (0 for walls),
//! e_ij = c_i V_j + c_j V_i and q = (u_i - u_j).r_ij, u_bar_i = sum_j e F r_ij, r_bar_i = sum_j e (F (u_i - u_j) + q G r_ij),
//! V_bar_i = sum_j c_j F q, rho_bar_i = rho'_bar_i rho'_i/rho_i - V_bar_i V_i/rho_i and m_bar_i = V_bar_i/rho_i.

use super::chain::{Chain, Masses, Step};
use super::pair_cache::PairCache;
use super::renormalisation;
use super::sweeps::Sweeps;
use crate::numerics::candle::Operator;
use crate::numerics::gather::Gather;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed::Pairs;
use crate::sph::laws::continuity::{self, Flowing};
use crate::sph::laws::riemann::Surroundings;
use crate::sph::laws::Flux;
use crate::sph::own::Own;
use crate::sph::pairs::{self, get, splat_fields, with_dimension, Fields, Records, RowGeometry};
use candle_core::{Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]` -> density `[1, N]`, of walls the moved one; over a time.
pub struct Evolution<R: Sweeps>(pub Arc<Chain<R>>, pub f64);

/// Numbers of a record: position D, velocity D, volume, c (of the adjoint).
const WIDTH: usize = 8;

/// Packs the records.
struct Packing<'a, R> {
    step: &'a Step<R>,
    moved: &'a [R],
    mass: Masses<'a, R>,
    /// dt times the cotangent of the density, in the adjoint.
    bar: Option<(R, &'a [R])>,
    records: Own<'a, R>,
}

/// The packed records, in a buffer of the model.
fn pack<R: Real>(step: &Step<R>, moved: &[R], bar: Option<(R, &[R])>) -> Buffer<R> {
    let (model, n) = (&*step.model, step.model.particles());
    let mut records = model.scratch.buffers.buffer(WIDTH * n);
    let mass = Masses::new(model, moved);
    run_rows(&Packing { step, moved, mass, bar, records: Own::new(&mut records) }, n);
    records
}

impl<R: Real> RowKernel<R> for Packing<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, n, l) = (&*self.step.model, self.step.model.particles(), self.step.model.layout);
        let d = l.dimension;
        for i in rows {
            // SAFETY: each row writes its own record.
            let record = unsafe { self.records.slice(i * WIDTH..(i + 1) * WIDTH) };
            for k in 0..d {
                record[k] = self.moved[k * n + i];
                record[d + k] = self.moved[(l.velocity() + k) * n + i];
            }
            let density = self.moved[l.moved_density() * n + i];
            record[2 * d] = self.mass.of(i) / density;
            record[2 * d + 1..].fill(R::default());
            if let Some((dt, bar)) = self.bar.filter(|_| model.is_fluid(i)) {
                record[2 * d + 1] = dt * bar[i] * density;
            }
        }
    }
}

/// What both passes need of a pair.
struct Apart<L, const D: usize> {
    difference: [L; D],
    square: L,
    velocity: [L; D],
    /// (u_i - u_j) . r_ij.
    parting: L,
}

#[inline(always)]
fn apart<L: Lanes, const D: usize, const EDGE: bool>(
    geometry: &RowGeometry<L, D>,
    here: &Fields<L>,
    there: &Fields<L>,
) -> Apart<L, D> {
    let (difference, square) = geometry.difference::<EDGE>(&here[0][..D], &there[0][..D]);
    let mut velocity = [L::zero(); D];
    let mut parting = L::zero();
    for d in 0..D {
        velocity[d] = get(here, D + d) - get(there, D + d);
        parting = velocity[d].mul_add(difference[d], parting);
    }
    Apart { difference, square, velocity, parting }
}

struct Forward<'a, R, const D: usize> {
    step: &'a Step<R>,
    dt: f64,
    records: Records<'a, R>,
    before: &'a [R],
    density: Own<'a, R>,
    slope: Own<'a, R>,
}

impl<R: Real, const D: usize> Forward<'_, R, D> {
    /// sum of V_j F q over a row, whose F are kept on the way.
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> L {
        let list = &*self.step.list;
        let here = splat_fields::<L>(self.records.of(i), WIDTH);
        let from = i * list.capacity;
        let mut sum = L::zero();
        for (k, (names, mask)) in pairs::row::<L>(list, i).enumerate() {
            let there = self.records.fields(WIDTH, names);
            let apart = apart::<L, D, EDGE>(geometry, &here, &there);
            let f = mask.apply(geometry.kernel.slope(apart.square));
            sum = (get(&there, 2 * D) * f).mul_add(apart.parting, sum);
            self.slope.store(from + k * L::COUNT, f);
        }
        sum
    }
}

impl<R: Real, const D: usize> RowKernel<R> for Forward<'_, R, D> {
    const SHORT: bool = D == 2;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let geometry = RowGeometry::<L, D>::new(model);
        let dt = R::of(self.dt);
        for row in rows {
            let i = list.fluid_rows[row] as usize;
            let sum = match geometry.at_edge(self.records.of(i)) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            let before = self.before[i];
            self.density.set(i, before + dt * (before * sum.sum()));
        }
    }
}

/// The forward pass, on plain numbers; keeps F.
pub fn forward<R: Real>(step: &Step<R>, dt: f64, moved: &[R], kept: &mut PairCache<R>, density: &mut [R]) {
    let (model, list, n) = (&*step.model, &*step.list, step.model.particles());
    kept.make_room(model, list, moved);
    let records = pack(step, moved, None);
    let before = &moved[model.layout.moved_density() * n..][..n];
    density[..n].copy_from_slice(before);
    let (density, slope) = (Own::new(density), Own::new(&mut kept.slope));
    let records = Records::new(&records, WIDTH, n);
    with_dimension!(model.layout.dimension, |D| run_rows(
        &Forward::<R, D> { step, dt, records, before, density, slope },
        list.fluid_rows.len(),
    ));
}

struct Backward<'a, R, const D: usize> {
    step: &'a Step<R>,
    records: Records<'a, R>,
    mass: Masses<'a, R>,
    before: &'a [R],
    density: &'a [R],
    density_bar: &'a [R],
    moved_bar: Own<'a, R>,
}

/// Sums of a row of the adjoint.
struct RowBar<L, const D: usize> {
    position: [L; D],
    velocity: [L; D],
    volume: L,
}

impl<R: Real, const D: usize> Backward<'_, R, D> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> RowBar<L, D> {
        let here = splat_fields::<L>(self.records.of(i), WIDTH);
        let mut sums = RowBar { position: [L::zero(); D], velocity: [L::zero(); D], volume: L::zero() };
        for (names, mask) in pairs::row::<L>(&self.step.list, i) {
            let there = self.records.fields(WIDTH, names);
            let apart = apart::<L, D, EDGE>(geometry, &here, &there);
            let (_, slope, curvature) = geometry.kernel.all(apart.square);
            let (slope, curvature) = (mask.apply(slope), mask.apply(curvature));
            let (volume, c) = (2 * D, 2 * D + 1);
            let e = get(&here, c).mul_add(get(&there, volume), get(&there, c) * get(&here, volume));
            let (along, radial) = (e * slope, e * apart.parting * curvature);
            sums.volume = (get(&there, c) * slope).mul_add(apart.parting, sums.volume);
            for d in 0..D {
                sums.velocity[d] = along.mul_add(apart.difference[d], sums.velocity[d]);
                sums.position[d] += along.mul_add(apart.velocity[d], radial * apart.difference[d]);
            }
        }
        sums
    }
}

impl<R: Real, const D: usize> RowKernel<R> for Backward<'_, R, D> {
    const SHORT: bool = D == 2;

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let (n, l) = (model.particles(), model.layout);
        let geometry = RowGeometry::<L, D>::new(model);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let record = self.records.of(i);
            let sums = match geometry.at_edge(record) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            let (before, volume_bar) = (self.before[i], sums.volume.sum());
            let own = match model.is_fluid(i) {
                true => self.density_bar[i] * self.density[i] / before,
                // The moved density of a wall is handed on.
                false => self.density_bar[i],
            };
            let add = |field: usize, value: R| self.moved_bar.add(field * n + i, value);
            for d in 0..D {
                add(d, sums.position[d].sum());
                add(l.velocity() + d, sums.velocity[d].sum());
            }
            add(l.moved_density(), own - volume_bar * record[2 * D] / before);
            if l.mass {
                add(l.moved_mass(), volume_bar * record[2 * D] / self.mass.of(i));
            }
        }
    }
}

/// The adjoint, on plain numbers: adds to `moved_bar`.
pub fn backward<R: Real>(step: &Step<R>, dt: f64, moved: &[R], density: &[R], density_bar: &[R], moved_bar: &mut [R]) {
    let (model, list, n) = (&*step.model, &*step.list, step.model.particles());
    let l = model.layout;
    let records = pack(step, moved, Some((R::of(dt), density_bar)));
    // Walls without a row only hand their density on.
    for i in (0..n).filter(|&i| !model.is_fluid(i) && list.count[i] == 0) {
        moved_bar[l.moved_density() * n + i] += density_bar[i];
    }
    let before = &moved[l.moved_density() * n..][..n];
    let (records, mass, moved_bar) = (Records::new(&records, WIDTH, n), Masses::new(model, moved), Own::new(moved_bar));
    with_dimension!(l.dimension, |D| run_rows(
        &Backward::<R, D> { step, records, mass, before, density, density_bar, moved_bar },
        pairs::all_rows(list),
    ));
}

impl<R: Sweeps> Operator<1> for Evolution<R> {
    type Real = R;
    const NAME: &'static str = "evolution";

    fn forward(&self, [moved]: [&[R]; 1], _: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let step = &self.0.step;
        let n = step.model.particles();
        let mut density = vec![R::default(); n];
        R::evolution(step, self.1, moved, &mut self.0.kept(), &mut density);
        Ok((density, (1, n).into()))
    }

    fn adjoint(&self, [moved]: [&[R]; 1], density: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let mut moved_bar = self.0.moved_bar();
        R::evolution_bar(&self.0.step, self.1, moved, density, bar, &mut moved_bar);
        Ok([Some(moved_bar)])
    }
}

/// moved `[M, N]` -> drho/dt, `[1, N]`, from candle's operators.
pub fn rate<R: Real>(step: &Step<R>, pairs: &Pairs, moved: &Tensor) -> Result<Tensor> {
    let (model, l) = (&*step.model, step.model.layout);
    let density = moved.narrow(0, l.moved_density(), 1)?;
    let velocity = moved.narrow(0, l.velocity(), l.dimension)?;
    let volume = step.mass(moved)?.div(&density)?;
    let slope = model.kernel.composed(&pairs.distance)?.1.mul(&pairs.mask)?;
    let flowing = Flowing { pairs, density: &density, volume: &volume, velocity: &velocity, slope: &slope };
    match &model.laws.flux {
        Flux::Pair => continuity::composed(&flowing),
        Flux::Delta(diffusion, _) => {
            let among_walls = || pairs_of_walls(step, moved, &volume);
            // Walls get their density from the fluid's pressure: nothing diffuses into them.
            continuity::composed(&flowing)? + diffusion.composed(&flowing, among_walls)?.mul(&pairs.is_fluid)?
        }
        Flux::Riemann(law) => {
            let position = moved.narrow(0, 0, l.dimension)?;
            let given = model.given_composed(&position, moved, l.moved_temperature())?;
            let normals = normals(step, moved)?;
            let (state, velocity) = (model.equation_of_state, &velocity);
            law.density_rate(&Surroundings { pairs, state, given: &given, normals: &normals, velocity }, &flowing)
        }
    }
}

/// moved `[M, N]` -> density `[1, N]`, of walls the moved one, from candle's operators: the oracle.
pub fn composed<R: Real>(step: &Step<R>, pairs: &Pairs, dt: f64, moved: &Tensor) -> Result<Tensor> {
    let (model, l) = (&*step.model, step.model.layout);
    let before = moved.narrow(0, l.moved_density(), 1)?;
    if dt == 0.0 {
        return Ok(before);
    }
    let density = (&before + rate(step, pairs, moved)?.affine(dt, 0.0)?)?;
    let density = match model.laws.renormalises {
        true => renormalisation::composed(step, pairs, &step.mass(moved)?, &density)?,
        false => density,
    };
    density.mul(&pairs.is_fluid)? + before.mul(&pairs.is_fluid.affine(-1.0, 1.0)?)?
}

/// The walls' normals `[D, N]`; 0 where the scene has none.
pub(super) fn normals<R: Real>(step: &Step<R>, like: &Tensor) -> Result<Tensor> {
    let (n, d) = (step.model.particles(), step.model.layout.dimension);
    let normals = step.model.laws.normals.clone().unwrap_or_else(|| vec![R::default(); d * n]);
    Tensor::from_vec(normals, (d, n), like.device())?.to_dtype(like.dtype())
}

/// -sum V_j F r_ij (x) r_ij over pairs of two wall particles, `[D D, N]`, 0 for fluid: every wall particle with every other
/// one, since nothing but a comparison with JAX-SPH asks for it.
fn pairs_of_walls<R: Real>(step: &Step<R>, moved: &Tensor, volume: &Tensor) -> Result<Tensor> {
    let (model, device) = (&*step.model, moved.device());
    let (n, d) = (model.particles(), model.layout.dimension);
    let walls: Vec<u32> = (0..n as u32).filter(|&i| !model.is_fluid(i as usize)).collect();
    let count = walls.len();
    if count == 0 {
        return Tensor::zeros((d * d, n), moved.dtype(), device);
    }
    let chosen = Gather::new(&walls, n, device)?;
    let of_walls = |x: &Tensor| chosen.rows(x, 1);
    let position = of_walls(&moved.narrow(0, 0, d)?)?;
    let raw = position.unsqueeze(2)?.broadcast_sub(&position.unsqueeze(1)?)?;
    let images = (0..d).map(|c| model.domain.nearest_of(c, &raw.narrow(0, c, 1)?)).collect::<Result<Vec<_>>>()?;
    let difference = Tensor::cat(&images, 0)?;
    // Each with itself is moved far away: distance 0 has no derivative.
    let far = Tensor::eye(count, moved.dtype(), device)?.unsqueeze(0)?;
    let far = far.affine((10.0 * model.kernel.smoothing_length).powi(2), 0.0)?;
    let distance = (difference.sqr()?.sum_keepdim(0)? + far)?.sqrt()?;
    let slope = model.kernel.composed(&distance)?.1;
    let weight = slope.broadcast_mul(&of_walls(volume)?.unsqueeze(1)?)?.neg()?;
    let mut rows = Vec::new();
    for a in 0..d {
        rows.push(difference.broadcast_mul(&difference.narrow(0, a, 1)?.mul(&weight)?)?.sum(2)?);
    }
    chosen.sums(&Tensor::cat(&rows, 0)?, 1)
}
