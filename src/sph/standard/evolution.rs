//! Density by evolution: rho' = rho + dt drho/dt, instead of [`super::density`].
//!
//! Its rate is that of [`crate::sph::laws::continuity`], with [`crate::sph::laws::density_diffusion`] in delta-SPH, or that of
//! [`crate::sph::laws::riemann`]. In front of a wall stands the density that the last step's wall condition gave the wall
//! ([`super::wall_condition`]): the state has a row of it. dt = 0 is the density as it is.
//!
//! Adjoint, gathered: with c_i = rho'_bar_i dt rho_i (0 for walls), e_ij = c_i V_j + c_j V_i and q = (u_i - u_j).r_ij,
//! u_bar_i = sum_j e F r_ij, r_bar_i = sum_j e (F (u_i - u_j) + q G r_ij), V_bar_i = sum_j c_j F q,
//! rho_bar_i = rho'_bar_i rho'_i/rho_i - V_bar_i V_i/rho_i and m_bar_i = V_bar_i/rho_i. A term with the factor s_i and the
//! exchange X_ij ([`DensityTerm`]) adds, with w_ij = c_i s_i V_j - c_j s_j V_i, the derivatives of w F X by r_ij, by rho_i and by its
//! vector of i, -c_j s_j F X to V_bar_i, and that of s_i.

use super::chain::{Chain, Masses, Step};
use super::model::Standard;
use super::pair_cache::PairCache;
use super::records::{FLOW as WIDTH, TERM as TERM_WIDTH};
use super::sweeps::Sweeps;
use super::{density_gradient, renormalisation};
use crate::numerics::candle::Operator;
use crate::numerics::gather::Gather;
use crate::numerics::lanes::{lanes_of_rows, Lanes, Real};
use crate::numerics::pool::Buffer;
use crate::numerics::sweep::{run_rows, RowKernel};
use crate::sph::composed::Pairs;
use crate::sph::laws::continuity::{self, ContinuityAlone, DensityTerm, Flowing, Meeting};
use crate::sph::laws::riemann::Surroundings;
use crate::sph::laws::{Faces, Flux};
use crate::sph::own::Own;
use crate::sph::pairs::{self, get, packed, splat_fields, with_dimension, Fields, Mask, Records, RowGeometry};
use candle_core::{Result, Shape, Tensor};
use std::ops::Range;
use std::sync::Arc;

/// moved `[M, N]` -> density `[1, N]`, of walls the moved one; over a time.
pub struct Evolution<R: Sweeps>(pub Arc<Chain<R>>, pub f64);

/// The packed records; in the adjoint with dt and the cotangent of the density.
fn pack<R: Real>(step: &Step<R>, moved: &[R], bar: Option<(R, &[R])>, walls_evolve: bool) -> Buffer<R> {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let (mass, d) = (Masses::new(model, moved), l.dimension);
    packed(model, WIDTH, |i, record| {
        for k in 0..d {
            record[k] = moved[k * n + i];
            record[d + k] = moved[(l.velocity() + k) * n + i];
        }
        let density = moved[l.moved_density() * n + i];
        record[2 * d] = mass.of(i) / density;
        record[2 * d + 1..].fill(R::default());
        if let Some((dt, bar)) = bar.filter(|_| walls_evolve || model.is_fluid(i)) {
            record[2 * d + 1] = dt * bar[i] * density;
        }
    })
}

/// The packed records of a [`DensityTerm`]; none where the flux has none. The vectors of fluid are the body force for Riemann problems, and
/// the gradients of the density in delta-SPH, the inverses of whose matrices are written where they are wanted.
fn pack_term<R: Real>(step: &Step<R>, moved: &[R], records: &[R], inverse: Option<&mut [R]>) -> Buffer<R> {
    let (model, n, l) = (&*step.model, step.model.particles(), step.model.layout);
    let width = if model.laws.flux == Flux::Pair { 0 } else { TERM_WIDTH };
    let is_riemann = matches!(model.laws.flux, Flux::Riemann(_));
    let mut of_term = packed(model, width, |i, record| {
        record.fill(R::default());
        if let Some(density) = record.first_mut() {
            *density = moved[l.moved_density() * n + i];
        }
        for d in 0..if is_riemann && model.is_fluid(i) { l.dimension } else { 0 } {
            let temperature = || moved[l.moved_temperature() * n + i].f64();
            record[1 + d] = R::of(model.given(d, moved[n + i].f64(), temperature));
        }
    });
    if let Flux::Delta(_) = model.laws.flux {
        let density = &moved[l.moved_density() * n..][..n];
        density_gradient::forward(step, records, density, &mut of_term, inverse);
    }
    of_term
}

/// Calls `$go` with the [`DensityTerm`] of a model's flux.
macro_rules! with_term {
    ($model:expr, |$term:ident| $go:expr) => {
        match $model.laws.flux {
            Flux::Pair => {
                let $term = ContinuityAlone;
                $go
            }
            Flux::Delta($term) => $go,
            Flux::Riemann(law) => {
                let $term = law.fluxes($model.equation_of_state, $model.viscosity);
                $go
            }
        }
    };
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

/// The densities and vectors of a pair for a [`DensityTerm`].
#[inline(always)]
fn meeting<'a, L: Lanes, const D: usize>(
    apart: &'a Apart<L, D>,
    own: &[L; 4],
    other: &[L; 4],
    [all, fluid]: [&'a Mask<L>; 2],
    own_is_fluid: bool,
) -> Meeting<'a, L, D> {
    let mut vector = [[L::zero(); D]; 2];
    vector[0].copy_from_slice(&own[1..=D]);
    vector[1].copy_from_slice(&other[1..=D]);
    let inverse = all.apply(apart.square.inverse_sqrt());
    Meeting { density: [own[0], other[0]], vector, difference: &apart.difference, inverse, fluid, own_is_fluid }
}

struct Forward<'a, R, T, const D: usize> {
    step: &'a Step<R>,
    dt: f64,
    term: T,
    records: Records<'a, R>,
    of_term: Records<'a, R>,
    before: &'a [R],
    density: Own<'a, R>,
    slope: Own<'a, R>,
}

impl<R: Real, T: DensityTerm, const D: usize> Forward<'_, R, T, D> {
    /// sum of V_j F (q + s_i X) over a row, whose F are kept on the way.
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> L {
        let list = &*self.step.list;
        let here = splat_fields::<L>(self.records.of(i), WIDTH);
        let own = splat_fields::<L>(self.of_term.of(i), self.of_term.width())[0];
        let share = if T::ACTS { self.term.share(own[0]).0 } else { L::zero() };
        let own_is_fluid = self.step.model.is_fluid(i);
        let fluids = if own_is_fluid { list.fluid_count[i] as usize } else { 0 };
        let from = i * list.capacity;
        let mut sum = L::zero();
        for (k, (names, mask)) in pairs::row::<L>(list, i).enumerate() {
            let there = self.records.fields(WIDTH, names);
            let apart = apart::<L, D, EDGE>(geometry, &here, &there);
            let f = mask.apply(geometry.kernel.slope(apart.square));
            let weight = get(&there, 2 * D) * f;
            sum = weight.mul_add(apart.parting, sum);
            if T::ACTS {
                let [other] = self.of_term.groups(names);
                let fluid = mask.up_to(k * L::COUNT, fluids);
                let exchange = self.term.exchange(&meeting(&apart, &own, &other, [&mask, &fluid], own_is_fluid));
                sum = (weight * share).mul_add(exchange.value, sum);
            }
            self.slope.store(from + k * L::COUNT, f);
        }
        sum
    }
}

impl<R: Real, T: DensityTerm, const D: usize> RowKernel<R> for Forward<'_, R, T, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (model, list) = (&*self.step.model, &*self.step.list);
        let geometry = RowGeometry::<L, D>::new(model);
        let dt = R::of(self.dt);
        for row in rows {
            let i = pairs::particle_of_row(list, row);
            let sum = match geometry.at_edge(self.records.of(i)) {
                true => self.row::<L, true>(&geometry, i),
                false => self.row::<L, false>(&geometry, i),
            };
            let before = self.before[i];
            self.density.set(i, before + dt * (before * sum.sum()));
        }
    }
}

/// The forward pass, on plain numbers; keeps F. Copies have what their owners have found.
pub fn forward<R: Real>(step: &Step<R>, dt: f64, moved: &[R], kept: &mut PairCache<R>, density: &mut [R]) {
    kept.make_room(&step.model, &step.list, moved);
    evolve(step, dt, moved, &mut kept.slope, density);
    let (model, n) = (&*step.model, step.model.particles());
    if model.laws.renormalises && dt != 0.0 {
        renormalisation::forward(step, moved, density);
        for i in (0..n).filter(|&i| !model.is_fluid(i)) {
            density[i] = moved[model.layout.moved_density() * n + i];
        }
        model.refresh(density);
    }
}

/// Whether the density of walls evolves too, which only the renormalisation reads: as in JAX-SPH, but in Riemann problems.
fn walls_evolve<R: Real>(model: &Standard<R>, dt: f64) -> bool {
    model.laws.renormalises && dt != 0.0 && !matches!(model.laws.flux, Flux::Riemann(_))
}

/// The forward pass before renormalisation.
fn evolve<R: Real>(step: &Step<R>, dt: f64, moved: &[R], slope: &mut [R], density: &mut [R]) {
    let (model, list, n) = (&*step.model, &*step.list, step.model.particles());
    let records = pack(step, moved, None, false);
    let before = &moved[model.layout.moved_density() * n..][..n];
    density[..n].copy_from_slice(before);
    let of_term = pack_term(step, moved, &records, None);
    let (records, of_term) = (Records::new(&records, WIDTH, n), Records::new(&of_term, of_term.len() / n.max(1), n));
    let walls_evolve = walls_evolve(model, dt);
    {
        let (density, slope) = (Own::new(&mut *density), Own::new(slope));
        with_term!(model, |term| with_dimension!(model.layout.dimension, |D| {
            let kernel = Forward::<R, _, D> { step, dt, term, records, of_term, before, density, slope };
            match walls_evolve {
                true => run_rows(&kernel, pairs::all_rows(list)),
                false => model.sweep(list, &kernel, &kernel.density, 1),
            }
        }));
    }
    if walls_evolve {
        model.refresh(density);
    }
}

struct Backward<'a, R, T, const D: usize> {
    step: &'a Step<R>,
    term: T,
    records: Records<'a, R>,
    of_term: Records<'a, R>,
    /// Gets the cotangents of the term's vectors, in records as theirs.
    term_bar: Own<'a, R>,
    mass: Masses<'a, R>,
    before: &'a [R],
    density: &'a [R],
    density_bar: &'a [R],
    walls_evolve: bool,
    moved_bar: Own<'a, R>,
}

/// Sums of a row of the adjoint.
struct RowBar<L, const D: usize> {
    position: [L; D],
    velocity: [L; D],
    volume: L,
    density: L,
    vector: [L; D],
}

impl<R: Real, T: DensityTerm, const D: usize> Backward<'_, R, T, D> {
    #[inline(always)]
    fn row<L: Lanes<Real = R>, const EDGE: bool>(&self, geometry: &RowGeometry<L, D>, i: usize) -> RowBar<L, D> {
        let here = splat_fields::<L>(self.records.of(i), WIDTH);
        let own = splat_fields::<L>(self.of_term.of(i), self.of_term.width())[0];
        let zero = [L::zero(); D];
        let mut sums = RowBar { position: zero, velocity: zero, volume: L::zero(), density: L::zero(), vector: zero };
        let own_is_fluid = self.step.model.is_fluid(i);
        let fluids = if own_is_fluid { self.step.list.fluid_count[i] as usize } else { 0 };
        let (share, change) = self.term.share(own[0]);
        // sum of V_j F X.
        let mut exchanged = L::zero();
        for (k, (names, mask)) in pairs::row::<L>(&self.step.list, i).enumerate() {
            let there = self.records.fields(WIDTH, names);
            let apart = apart::<L, D, EDGE>(geometry, &here, &there);
            let (_, slope, curvature) = geometry.kernel.all(apart.square);
            let (slope, curvature) = (mask.apply(slope), mask.apply(curvature));
            let (volume, c) = (2 * D, 2 * D + 1);
            let e = get(&here, c).mul_add(get(&there, volume), get(&there, c) * get(&here, volume));
            let (along, mut radial) = (e * slope, e * apart.parting * curvature);
            sums.volume = (get(&there, c) * slope).mul_add(apart.parting, sums.volume);
            if T::ACTS {
                let [other] = self.of_term.groups(names);
                let fluid = mask.up_to(k * L::COUNT, fluids);
                let x = self.term.exchange(&meeting(&apart, &own, &other, [&mask, &fluid], own_is_fluid));
                let theirs = get(&there, c) * self.term.share(other[0]).0;
                let w = (get(&here, c) * share).mul_add(get(&there, volume), -(theirs * get(&here, volume)));
                let weight = w * slope;
                radial = (w * x.value).mul_add(curvature, radial);
                sums.volume = sums.volume - theirs * slope * x.value;
                sums.density = weight.mul_add(x.by_density, sums.density);
                exchanged = (get(&there, volume) * slope).mul_add(x.value, exchanged);
                for d in 0..D {
                    sums.position[d] = weight.mul_add(x.by_difference[d], sums.position[d]);
                    sums.vector[d] = weight.mul_add(x.by_vector[d], sums.vector[d]);
                }
            }
            for d in 0..D {
                sums.velocity[d] = along.mul_add(apart.difference[d], sums.velocity[d]);
                sums.position[d] += along.mul_add(apart.velocity[d], radial * apart.difference[d]);
            }
        }
        if T::ACTS {
            // By s_i; by the factor rho_i, all of the rate is taken below.
            sums.density += get(&here, 2 * D + 1) / own[0] * change * exchanged;
        }
        sums
    }
}

impl<R: Real, T: DensityTerm, const D: usize> RowKernel<R> for Backward<'_, R, T, D> {
    const MOST_LANES: usize = lanes_of_rows(D);

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
            let own = match self.walls_evolve || model.is_fluid(i) {
                true => self.density_bar[i] * self.density[i] / before,
                // The moved density of a wall is handed on, where it does not evolve.
                false => self.density_bar[i],
            };
            let add = |field: usize, value: R| self.moved_bar.add(field * n + i, value);
            for d in 0..D {
                add(d, sums.position[d].sum());
                add(l.velocity() + d, sums.velocity[d].sum());
            }
            add(l.moved_density(), own + sums.density.sum() - volume_bar * record[2 * D] / before);
            if T::ACTS {
                for d in 0..D {
                    self.term_bar.set(i * TERM_WIDTH + 1 + d, sums.vector[d].sum());
                }
            }
            if l.mass {
                add(l.moved_mass(), volume_bar * record[2 * D] / self.mass.of(i));
            }
        }
    }
}

/// The adjoint, on plain numbers: adds to `moved_bar`.
pub fn backward<R: Real>(step: &Step<R>, dt: f64, moved: &[R], density: &[R], density_bar: &[R], moved_bar: &mut [R]) {
    let (model, list, n) = (&*step.model, &*step.list, step.model.particles());
    if !model.laws.renormalises || dt == 0.0 {
        return backward_of_rate(step, dt, moved, density, density_bar, moved_bar);
    }
    let buffers = &model.scratch.buffers;
    let (mut evolved, mut evolved_bar) = (buffers.buffer(n), buffers.buffer(n));
    let mut slope = buffers.buffer(list.index.len());
    evolve(step, dt, moved, &mut slope, &mut evolved);
    renormalisation::backward(step, moved, &evolved, density_bar, &mut evolved_bar, moved_bar);
    model.refresh(&mut evolved_bar);
    for i in (0..n).filter(|&i| !model.is_fluid(i)) {
        moved_bar[model.layout.moved_density() * n + i] += density_bar[i];
    }
    backward_of_rate(step, dt, moved, &evolved, &evolved_bar, moved_bar);
}

/// The adjoint before renormalisation.
fn backward_of_rate<R: Real>(
    step: &Step<R>,
    dt: f64,
    moved: &[R],
    density: &[R],
    density_bar: &[R],
    moved_bar: &mut [R],
) {
    let (model, list, n) = (&*step.model, &*step.list, step.model.particles());
    let l = model.layout;
    let walls_evolve = walls_evolve(model, dt);
    let records = pack(step, moved, Some((R::of(dt), density_bar)), walls_evolve);
    // Walls without a row only hand their density on.
    for i in (0..n).filter(|&i| !model.is_fluid(i) && list.count[i] == 0) {
        moved_bar[l.moved_density() * n + i] += density_bar[i];
    }
    let before = &moved[l.moved_density() * n..][..n];
    let is_delta = matches!(model.laws.flux, Flux::Delta(_));
    let buffers = &model.scratch.buffers;
    let mut inverse = buffers.buffer(if is_delta { density_gradient::SQUARE * n } else { 0 });
    let of_term = pack_term(step, moved, &records, is_delta.then_some(inverse.as_mut_slice()));
    let mut term_bar = buffers.buffer(of_term.len());
    {
        let (of_term, term_bar) = (Records::new(&of_term, of_term.len() / n.max(1), n), Own::new(&mut term_bar));
        let (records, mass) = (Records::new(&records, WIDTH, n), Masses::new(model, moved));
        let moved_bar = Own::new(moved_bar);
        with_term!(model, |term| with_dimension!(l.dimension, |D| run_rows(
            &Backward::<R, _, D> {
                step,
                term,
                records,
                of_term,
                term_bar,
                mass,
                before,
                density,
                density_bar,
                walls_evolve,
                moved_bar
            },
            pairs::all_rows(list),
        )));
    }
    match (model.laws.flux, &model.buoyancy) {
        (Flux::Delta(_), _) => {
            density_gradient::backward(step, moved, [&records, &of_term, &inverse], &term_bar, moved_bar);
        }
        (Flux::Riemann(_), Some(buoyancy)) => {
            for &i in &list.fluid_rows {
                let (i, bar) = (i as usize, &term_bar[i as usize * TERM_WIDTH + 1..]);
                let by = (0..l.dimension).map(|d| R::of(buoyancy.by[d]) * bar[d]);
                moved_bar[l.moved_temperature() * n + i] += by.sum::<R>();
            }
        }
        _ => {}
    }
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
        Flux::Delta(diffusion) => {
            let among_walls = || pairs_of_walls(step, moved, &volume);
            // Walls get their density from the fluid's pressure: nothing diffuses into them.
            continuity::composed(&flowing)? + diffusion.composed(&flowing, among_walls)?.mul(&pairs.is_fluid)?
        }
        Flux::Riemann(law) => {
            let position = moved.narrow(0, 0, l.dimension)?;
            let given = model.given_composed(&position, moved, l.moved_temperature())?;
            let faces = Faces { given, normals: model.normals(moved)?, velocity: velocity.clone() };
            law.density_rate(&Surroundings { pairs, state: model.equation_of_state, faces: &faces }, &flowing)
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
