//! A step by ordinary candle operators over the padded neighbour list, as reference for the fused kernels.

use super::arrangement::Shift;
use super::arrangement::{Chain, Isotropic};
use super::kinds::{kind, KINDS, NO_FLUX, PRESSURE, TEMPERATURE};
use super::model::Consistent;
use super::stencil::{at, monomials as monomials_of, packed, quadratic};
use crate::numerics::gather::Gather;
use crate::numerics::lanes::Real;
use crate::particles::NeighbourList;
use crate::sph::composed::Pairs;
use crate::sph::laws::conduction;
use crate::sph::masks::{below, per_particle};
use crate::sph::pace::TimeSteps;
use candle_core::{DType, Result, Tensor};

/// The evaluated fields of a state, on the graph.
pub struct Known {
    /// The state with the values of dummy particles filled in, `[F, N]`.
    pub known: Tensor,
    /// Masses of the fluid particles in sums over a cross-section, `[1, N]`.
    pub masses: Tensor,
    /// Heat flux of the walls, see [`crate::adjoint::Fields::wall_heat`].
    pub wall_heat: Option<Tensor>,
}

/// Data that the operators of a step share.
struct Around<'a, R> {
    model: &'a Consistent<R>,
    pairs: Pairs,
    /// W and F, 0 in the padding, `[1, N, K]`.
    value: Tensor,
    slope: Tensor,
    /// Weights of the neighbours in each kind of fit, `[1, N, K]`.
    weights: Vec<Tensor>,
    /// Monomials of the neighbours' relative positions, `[Q, N, K]`.
    monomials: Tensor,
    /// Derivatives of the monomials along the neighbours' normals, and the weights of these conditions, with heat.
    no_flux: Option<(Tensor, Tensor)>,
    fluid: Tensor,
}

/// The weights of one kind of fit, `[1, N]`.
fn weights<R: Real>(model: &Consistent<R>, kind: usize, like: &Tensor) -> Result<Tensor> {
    per_particle(model.fits.weights.iter().skip(kind).step_by(4).copied().collect(), like)
}

impl<'a, R: Real> Around<'a, R> {
    fn new(model: &'a Consistent<R>, list: &NeighbourList, state: &Tensor) -> Result<Self> {
        let d = model.layout.dimension;
        let position = &state.narrow(0, 0, d)?;
        let pairs = Pairs::new(&model.flow, list, position)?;
        let (value, slope) = model.kernel.composed(&pairs.distance)?;
        let (value, slope) = (value.mul(&pairs.mask)?, slope.mul(&pairs.mask)?);
        let others = |kind: usize| pairs.other(&weights(model, kind, position)?);
        let weights = (0..KINDS).map(others).collect::<Result<Vec<_>>>()?;
        let s = pairs.difference.affine(-1.0 / model.fits.spacing, 0.0)?;
        let mut q: Vec<Option<Tensor>> = vec![None; monomials_of(d)];
        for a in 0..d {
            let along = s.narrow(0, a, 1)?;
            for b in a..d {
                let factor = if a == b { 0.5 } else { 1.0 };
                q[quadratic(d, a, b)] = Some(along.mul(&s.narrow(0, b, 1)?)?.affine(factor, 0.0)?);
            }
            q[a] = Some(along);
        }
        let q: Vec<Tensor> = q.into_iter().flatten().collect();
        let monomials = Tensor::cat(&q, 0)?;
        let mut no_flux = None;
        if model.heat.is_some() {
            let n = pairs.other(&state.narrow(0, model.layout.velocity(), d)?)?;
            let mut q: Vec<Option<Tensor>> = vec![None; monomials_of(d)];
            for a in 0..d {
                let (s_a, n_a) = (s.narrow(0, a, 1)?, n.narrow(0, a, 1)?);
                q[quadratic(d, a, a)] = Some(n_a.mul(&s_a)?);
                for b in a + 1..d {
                    let crossed = n.narrow(0, b, 1)?.mul(&s_a)?;
                    q[quadratic(d, a, b)] = Some((n_a.mul(&s.narrow(0, b, 1)?)? + crossed)?);
                }
                q[a] = Some(n_a);
            }
            let q: Vec<Tensor> = q.into_iter().flatten().collect();
            no_flux = Some((Tensor::cat(&q, 0)?, others(NO_FLUX)?));
        }
        let fluid = pairs.is_fluid.clone();
        Ok(Self { model, pairs, value, slope, weights, monomials, no_flux, fluid })
    }

    /// The factorised matrix sum_j W q_a q_b of a kind of fit, each entry `[1, N]`; the identity for walls.
    fn factor(&self, kind: usize) -> Result<Vec<Tensor>> {
        let q = self.monomials.dim(0)?;
        let w = self.value.mul(&self.weights[kind])?;
        let walls = self.fluid.affine(-1.0, 1.0)?;
        let mut matrix = Vec::with_capacity(packed(q));
        for row in 0..q {
            let weighted = w.mul(&self.monomials.narrow(0, row, 1)?)?;
            for column in 0..=row {
                let mut sum = weighted.mul(&self.monomials.narrow(0, column, 1)?)?.sum(2)?;
                if let (Some((q, weight)), TEMPERATURE) = (&self.no_flux, kind) {
                    let crossed = q.narrow(0, row, 1)?.mul(&q.narrow(0, column, 1)?)?;
                    sum = (sum + self.value.mul(weight)?.mul(&crossed)?.sum(2)?)?;
                }
                let sum = sum.mul(&self.fluid)?;
                matrix.push(if row == column { (sum + &walls)? } else { sum });
            }
        }
        factorised(matrix, q)
    }

    /// The derivatives d of a field `[1, N]`, `[Q, N]`.
    fn fit(&self, factor: &[Tensor], kind: usize, field: &Tensor) -> Result<Tensor> {
        let w = self.value.mul(&self.weights[kind])?;
        let difference = (self.pairs.other(field)? - self.pairs.own(field)?)?.mul(&w)?;
        let right = self.monomials.broadcast_mul(&difference)?.sum(2)?.broadcast_mul(&self.fluid)?;
        let right = (0..right.dim(0)?).map(|a| right.narrow(0, a, 1)).collect::<Result<Vec<_>>>()?;
        Tensor::cat(&solved(factor, right)?, 0)
    }

    /// Volume V, `[1, N]`.
    fn volume(&self) -> Result<Tensor> {
        let sum = self.value.mul(&self.weights[PRESSURE])?.sum(2)?;
        sum.affine(1.0, self.model.kernel.at_zero())?.recip()
    }

    /// [`super::operators::masses`], `[1, N]`.
    fn masses(&self, like: &Tensor) -> Result<Tensor> {
        let density = self.model.equation_of_state.reference_density;
        let quadrature = per_particle(self.model.fits.quadrature.clone(), like)?;
        self.volume()?.mul(&quadrature)?.mul(&self.fluid)?.affine(density, 0.0)
    }

    /// The shift velocity, `[D, N]`, 0 for walls.
    fn shift(&self, state: &Tensor) -> Result<Tensor> {
        let position = &state.narrow(0, 0, self.model.layout.dimension)?;
        let w = match &self.model.fits.shift {
            Shift::None => position.zeros_like()?,
            Shift::Chain(chain) => self.chain(chain, state)?,
            Shift::Isotropic(isotropic) => self.isotropic(isotropic, position)?,
        };
        w.broadcast_mul(&self.fluid)
    }

    fn isotropic(&self, isotropic: &Isotropic, position: &Tensor) -> Result<Tensor> {
        let fits = &self.model.fits;
        let d = self.model.layout.dimension;
        let slope = self.slope.mul(&self.weights[PRESSURE])?;
        let c = self.pairs.difference.broadcast_mul(&slope)?.sum(2)?;
        let factor = -isotropic.strength * fits.velocity * fits.spacing.powi(d as i32 + 1);
        let w = c.affine(factor, 0.0)?;
        let limit = isotropic.limit * fits.velocity;
        let size = (w.sqr()?.sum_keepdim(0)? + 1e-300)?.sqrt()?;
        let over = size.detach().gt(limit)?.to_dtype(w.dtype())?;
        let limited = w.broadcast_mul(&size.recip()?.affine(limit, 0.0)?)?;
        let w = (w.broadcast_mul(&over.affine(-1.0, 1.0)?)? + limited.broadcast_mul(&over)?)?;
        if isotropic.normals.is_empty() {
            return Ok(w);
        }
        // Repulsion from the nearest point of the surface. All other particles are moved infinitely far away.
        let n = self.model.particles();
        let mut normals = vec![R::default(); d * n];
        let mut is_point = vec![R::default(); n];
        for (&point, normal) in &isotropic.normals {
            is_point[point as usize] = R::of(1.0);
            (0..d).for_each(|k| normals[k * n + point as usize] = R::of(normal[k]));
        }
        let normals = Tensor::from_vec(normals, (d, n), position.device())?.to_dtype(position.dtype())?;
        let is_point = self.pairs.other(&per_particle(is_point, position)?)?.mul(&self.pairs.mask)?;
        let far = is_point.affine(-1e6, 1e6)?;
        let distance = (self.pairs.distance.detach() + far)?;
        let least = distance.min_keepdim(2)?;
        let nearest = distance.broadcast_eq(&least)?.to_dtype(position.dtype())?.mul(&is_point)?;
        let normal = self.pairs.other(&normals)?;
        let height = self.pairs.difference.mul(&normal)?.sum_keepdim(0)?;
        let size = height.affine(-1.0 / fits.spacing, 0.5)?.relu()?.affine(fits.velocity, 0.0)?;
        w + normal.broadcast_mul(&size.mul(&nearest)?)?.sum(2)?
    }

    fn chain(&self, chain: &Chain, state: &Tensor) -> Result<Tensor> {
        let model = self.model;
        let position = &state.narrow(0, 0, 2)?;
        let n = model.particles();
        let xs: Vec<f64> = position.narrow(0, 0, 1)?.detach().flatten_all()?.to_dtype(DType::F64)?.to_vec1()?;
        let near = |d: f64| model.domain.nearest(0, d);
        let last = chain.rows.len() - 1;
        let mut index: [Vec<u32>; 6] = std::array::from_fn(|_| (0..n as u32).collect());
        let mut at_wall = [vec![R::default(); n], vec![R::default(); n]];
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            let (r, c) = (chain.seat[i].0 as usize, chain.seat[i].1 as usize);
            let own = &chain.rows[r];
            index[0][i] = own[(c + own.len() - 1) % own.len()];
            index[1][i] = own[(c + 1) % own.len()];
            for (side, beside) in [r - 1, r + 1].into_iter().enumerate() {
                // The nearest particle to the left, and its successor.
                let row = &chain.rows[beside];
                let to = |k: usize| near(xs[row[k] as usize] - xs[i]);
                let left = (0..row.len()).filter(|&k| to(k) <= 0.0).max_by(|&a, &b| to(a).total_cmp(&to(b)));
                let left = left.unwrap_or(0);
                index[2 + 2 * side][i] = row[left];
                index[3 + 2 * side][i] = row[(left + 1) % row.len()];
                at_wall[side][i] = R::of((beside == 0 || beside == last) as u8 as f64);
            }
        }
        let device = position.device();
        let index = index.iter().map(|index| Gather::new(index, n, device)).collect::<Result<Vec<_>>>()?;
        let of = |row: usize, which: usize| index[which].rows(&position.narrow(0, row, 1)?, 1);
        let (x, y) = (position.narrow(0, 0, 1)?, position.narrow(0, 1, 1)?);
        let toward = |which: usize| model.domain.nearest_of(0, &(of(0, which)? - &x)?);
        let along = (toward(0)? + toward(1)?)?;
        let mut across = y.affine(-2.0, 0.0)?;
        for side in 0..2 {
            let (left, right) = (2 + 2 * side, 3 + 2 * side);
            let (before, behind) = (toward(left)?, toward(right)?);
            let width = (&behind - &before)?;
            // A particle in no row is its own neighbour.
            let none = width.detach().eq(0.0)?.to_dtype(width.dtype())?;
            let share = before.neg()?.div(&(width + none)?)?;
            let level = (of(1, left)? + share.mul(&(of(1, right)? - of(1, left)?)?)?)?;
            let wall = per_particle(at_wall[side].clone(), position)?;
            let mirrored = (level.affine(2.0, 0.0)? - &y)?;
            across = (across + level.mul(&wall.affine(-1.0, 1.0)?)? + mirrored.mul(&wall)?)?;
        }
        let factor = 0.5 * chain.strength * self.model.fits.velocity / self.model.fits.spacing;
        let w = Tensor::cat(&[along, across], 0)?.affine(factor, 0.0)?;
        if !chain.is_still {
            return Ok(w);
        }
        let l = model.layout;
        let width = (toward(1)? - toward(0)?)?;
        // A particle in no row is its own neighbour.
        let none = width.detach().eq(0.0)?.to_dtype(width.dtype())?;
        let slope = (of(1, 1)? - of(1, 0)?)?.div(&(width + none)?)?;
        let (u, v) = (state.narrow(0, l.velocity(), 1)?, state.narrow(0, l.velocity() + 1, 1)?);
        let along = w.narrow(0, 0, 1)?;
        let passing = ((u + &along)?.mul(&slope)? - v)?;
        Tensor::cat(&[along, (w.narrow(0, 1, 1)? + passing)?], 0)
    }

    /// Fills in the values of dummy particles in fields `[C, N]`.
    fn wall_values(&self, known: &Tensor, fields: &Tensor) -> Result<Tensor> {
        let (fits, l) = (&self.model.fits, self.model.layout);
        let (n, d) = (self.model.particles(), l.dimension);
        if fits.dummies.is_empty() {
            return Ok(fields.clone());
        }
        let mut is_point = vec![R::default(); n];
        fits.surface.iter().for_each(|&i| is_point[i as usize] = R::of(1.0));
        let is_point = per_particle(is_point, known)?;
        let w = self.value.mul(&self.pairs.other(&self.fluid)?)?.mul(&self.pairs.own(&is_point)?)?;
        let s = self.pairs.difference.affine(-1.0 / fits.spacing, 0.0)?;
        let q = Tensor::cat(&[s.narrow(0, 0, 1)?.ones_like()?, s], 0)?;
        let sum = w.sum(2)?;
        let others = is_point.affine(-1.0, 1.0)?;
        let mut matrix = Vec::new();
        for row in 0..=d {
            for column in 0..=row {
                let mut entry = w.mul(&q.narrow(0, row, 1)?)?.mul(&q.narrow(0, column, 1)?)?.sum(2)?;
                if row == column {
                    if row > 0 {
                        entry = (entry + sum.affine(1e-3, 0.0)?)?;
                    }
                    entry = (entry + &others)?;
                }
                matrix.push(entry);
            }
        }
        let factor = factorised(matrix, d + 1)?;
        let device = known.device();
        let mut point_of: Vec<u32> = (0..n as u32).collect();
        let mut is_dummy = vec![R::default(); n];
        for &(dummy, place) in &fits.dummies {
            point_of[dummy as usize] = fits.surface[place as usize];
            is_dummy[dummy as usize] = R::of(1.0);
        }
        let point_of = Gather::new(&point_of, n, device)?;
        let is_dummy = per_particle(is_dummy, known)?;
        let mirror = known.narrow(0, l.velocity(), d)?;
        let foot = point_of.rows(&known.narrow(0, 0, d)?, 1)?;
        let raw = (mirror - foot)?;
        let offset =
            (0..d).map(|k| self.model.domain.nearest_of(k, &raw.narrow(0, k, 1)?)).collect::<Result<Vec<_>>>()?;
        let mut filled = Vec::new();
        for c in 0..fields.dim(0)? {
            let field = fields.narrow(0, c, 1)?;
            let right = q.broadcast_mul(&w.mul(&self.pairs.other(&field)?)?)?.sum(2)?;
            let right = (0..=d).map(|a| right.narrow(0, a, 1)).collect::<Result<Vec<_>>>()?;
            let fit = solved(&factor, right)?;
            let fit = fit.iter().map(|c| point_of.rows(c, 1)).collect::<Result<Vec<_>>>()?;
            let mut value = fit[0].clone();
            for k in 0..d {
                value = (value + fit[1 + k].mul(&offset[k])?.affine(1.0 / fits.spacing, 0.0)?)?;
            }
            filled.push((field.mul(&is_dummy.affine(-1.0, 1.0)?)? + value.mul(&is_dummy)?)?);
        }
        Tensor::cat(&filled, 0)
    }
}

/// Cholesky factor of symmetric matrices. Each entry is a tensor; the diagonal holds its inverse.
pub fn factorised(matrix: Vec<Tensor>, size: usize) -> Result<Vec<Tensor>> {
    let mut c = matrix;
    for row in 0..size {
        for column in 0..row {
            let mut sum = c[at(row, column)].clone();
            for k in 0..column {
                sum = (sum - c[at(row, k)].mul(&c[at(column, k)])?)?;
            }
            c[at(row, column)] = sum.mul(&c[at(column, column)])?;
        }
        let mut pivot = c[at(row, row)].clone();
        for k in 0..row {
            pivot = (pivot - c[at(row, k)].sqr()?)?;
        }
        c[at(row, row)] = pivot.sqrt()?.recip()?;
    }
    Ok(c)
}

pub fn solved(c: &[Tensor], mut b: Vec<Tensor>) -> Result<Vec<Tensor>> {
    let size = b.len();
    for row in 0..size {
        for k in 0..row {
            b[row] = (&b[row] - c[at(row, k)].mul(&b[k])?)?;
        }
        b[row] = b[row].mul(&c[at(row, row)])?;
    }
    for row in (0..size).rev() {
        for k in row + 1..size {
            b[row] = (&b[row] - c[at(k, row)].mul(&b[k])?)?;
        }
        b[row] = b[row].mul(&c[at(row, row)])?;
    }
    Ok(b)
}

/// The state with the values of dummy particles filled in.
fn known<R: Real>(around: &Around<'_, R>, state: &Tensor) -> Result<Tensor> {
    let l = around.model.layout;
    let (places, fields) =
        (state.narrow(0, 0, l.pressure())?, state.narrow(0, l.pressure(), l.fields() - l.dimension)?);
    let behind = state.narrow(0, l.last_rates(), l.state_rows() - l.last_rates())?;
    Tensor::cat(&[places, around.wall_values(state, &fields)?, behind], 0)
}

/// The composed form of [`super::operators::look`].
pub fn look<R: Real>(model: &Consistent<R>, list: &NeighbourList, state: &Tensor) -> Result<Known> {
    let around = Around::new(model, list, state)?;
    let (known, masses) = (known(&around, state)?, around.masses(state)?);
    let heating = |until: f64| -> Result<Tensor> {
        let (l, fits) = (model.layout, &model.fits);
        let (d, dx) = (l.dimension, fits.spacing);
        let fit = around.fit(&around.factor(TEMPERATURE)?, TEMPERATURE, &known.narrow(0, l.temperature(), 1)?)?;
        let mut spread = fit.narrow(0, quadratic(d, 0, 0), 1)?;
        for a in 1..d {
            spread = (spread + fit.narrow(0, quadratic(d, a, a), 1)?)?;
        }
        let x = known.narrow(0, 0, 1)?;
        let shift = around.shift(state)?;
        let carried = shift.mul(&fit.narrow(0, 0, d)?)?.sum_keepdim(0)?.affine(1.0 / dx, 0.0)?;
        let rate = (carried + spread.affine(fits.diffusivity / (dx * dx), 0.0)?)?;
        let here = conduction::conducts_composed(model, &x)?.mul(&below(&x, until)?)?;
        rate.mul(&masses)?.mul(&here)?.sum_all()
    };
    let wall_heat = model.wall_heat_until.map(heating).transpose()?;
    Ok(Known { known, masses, wall_heat })
}

/// The composed form of [`super::operators::advance`].
pub fn advance<R: Real>(
    model: &Consistent<R>,
    list: &NeighbourList,
    times: TimeSteps,
    state: &Tensor,
) -> Result<Tensor> {
    let l = model.layout;
    let (d, fields, dt) = (l.dimension, l.fields(), times.now);
    let position = state.narrow(0, 0, d)?;
    let around = Around::new(model, list, state)?;
    let settings = &model.fits;
    let dx = settings.spacing;
    let known = known(&around, state)?;
    let factors = (0..KINDS).map(|kind| around.factor(kind)).collect::<Result<Vec<_>>>()?;
    let fit = |field: usize| {
        let kind = kind(d, fields, field);
        around.fit(&factors[kind], kind, &known.narrow(0, d + field, 1)?)
    };
    let fits = (0..fields).map(fit).collect::<Result<Vec<_>>>()?;
    let gradient = |fit: &Tensor| fit.narrow(0, 0, d)?.affine(1.0 / dx, 0.0);
    let spread = |fit: &Tensor| -> Result<Tensor> {
        let mut sum = fit.narrow(0, quadratic(d, 0, 0), 1)?;
        for a in 1..d {
            sum = (sum + fit.narrow(0, quadratic(d, a, a), 1)?)?;
        }
        sum.affine(1.0 / (dx * dx), 0.0)
    };
    let w = around.shift(state)?;
    let carried = |fit: &Tensor| w.mul(&gradient(fit)?)?.sum_keepdim(0);
    // Continuity.
    let mut divergence = gradient(&fits[0])?.narrow(0, 0, 1)?;
    for a in 1..d {
        divergence = (divergence + gradient(&fits[a])?.narrow(0, a, 1)?)?;
    }
    let p = known.narrow(0, l.pressure(), 1)?;
    let slopes = gradient(&fits[d])?;
    let pairs = &around.pairs;
    let other_fluid = pairs.other(&around.fluid)?;
    let mean_slope = (pairs.own(&slopes)? + pairs.other(&slopes)?)?.affine(0.5, 0.0)?;
    let smooth = mean_slope.mul(&pairs.difference)?.sum_keepdim(0)?.mul(&other_fluid)?;
    let bracket = ((pairs.other(&p)? - pairs.own(&p)?)? + smooth)?;
    let volume = around.volume()?;
    let of_dummies = per_particle(vec![R::of(dx.powi(d as i32)); model.particles()], state)?
        .mul(&weights(model, PRESSURE, state)?)?;
    let walls = around.fluid.affine(-1.0, 1.0)?;
    let volumes = (volume.mul(&around.fluid)? + of_dummies.mul(&walls)?)?;
    let diffused = pairs.other(&volumes)?.mul(&around.slope)?.mul(&bracket)?.sum(2)?;
    let density = model.equation_of_state.reference_density;
    let c = settings.sound_speed;
    let rate = ((carried(&fits[d])? - divergence.affine(density * c * c, 0.0)?)?
        - diffused.affine(2.0 * settings.delta * c * dx, 0.0)?)?;
    let p = (p + rate.affine(dt, 0.0)?)?.mul(&around.fluid)?;
    let count: f64 = model.tags.iter().filter(|&&tag| tag == crate::particles::tag::FLUID).count() as f64;
    let mean = p.sum_keepdim(1)?.affine(1.0 / count, 0.0)?;
    let p = p.broadcast_sub(&mean)?.mul(&around.fluid)?;
    let filled = around.wall_values(&known, &p)?;
    let slopes = gradient(&around.fit(&factors[PRESSURE], PRESSURE, &filled)?)?;
    // Advance.
    let given = model.given_composed(&position, &known, l.temperature())?;
    let (mut velocities, mut rates) = (Vec::new(), Vec::new());
    // Corrects the field by the difference between the present rate and the last one, which predicted it.
    let corrected = |field: &Tensor, rate: &Tensor, row: usize| -> Result<Tensor> {
        let gap = (rate - known.narrow(0, l.last_rates() + row, 1)?)?.mul(&around.fluid)?;
        field + gap.affine(0.5 * times.before, 0.0)?
    };
    for a in 0..d {
        let mut rate = (carried(&fits[a])? + spread(&fits[a])?.affine(settings.viscosity, 0.0)?)?;
        rate = (rate - slopes.narrow(0, a, 1)?.affine(1.0 / density, 0.0)?)?;
        rate = (rate + given.narrow(0, a, 1)?)?;
        let rate = rate.mul(&around.fluid)?;
        let before = known.narrow(0, l.velocity() + a, 1)?;
        let now = if l.rates { corrected(&before, &rate, a)? } else { before };
        velocities.push((now + rate.affine(dt, 0.0)?)?);
        rates.push(rate);
    }
    let velocity = Tensor::cat(&velocities, 0)?;
    let mut mean = velocity.clone();
    if l.rates {
        mean = (mean - Tensor::cat(&rates, 0)?.affine(0.5 * dt, 0.0)?)?;
    }
    let drift = (&mean + &w)?.broadcast_mul(&around.fluid)?;
    let moved = (&position + drift.affine(dt, 0.0)?)?;
    let wrapped = (0..d).map(|k| model.domain.wrapped_of(k, &moved.narrow(0, k, 1)?)).collect::<Result<Vec<_>>>()?;
    let is_fluid = around.fluid.broadcast_as((d, model.particles()))?;
    let moved = Tensor::cat(&wrapped, 0)?;
    let moved = (moved.mul(&is_fluid)? + position.mul(&is_fluid.affine(-1.0, 1.0)?)?)?;
    let mut kept = vec![R::of(1.0); model.particles()];
    settings.dummies.iter().for_each(|&(dummy, _)| kept[dummy as usize] = R::default());
    let kept = per_particle(kept, state)?;
    // Surface points keep their pressure.
    let stays = known.narrow(0, l.pressure(), 1)?.mul(&walls)?.mul(&kept)?;
    let mut rows = vec![moved.clone(), velocity, (p + stays)?];
    if let Some(heat) = &model.heat {
        let t = known.narrow(0, l.temperature(), 1)?;
        let open = conduction::conducts_composed(model, &known.narrow(0, 0, 1)?)?.mul(&around.fluid)?;
        let rate = (carried(&fits[d + 1])? + spread(&fits[d + 1])?.affine(settings.diffusivity, 0.0)?)?;
        let rate = rate.mul(&open)?;
        let mut after = (&t + rate.affine(dt, 0.0)?)?;
        if l.rates {
            let correction = (corrected(&t, &rate, d)? - &t)?;
            after = (after + correction.mul(&open)?)?;
        }
        let inlet = below(&moved.narrow(0, 0, 1)?, heat.inlet_below)?.mul(&around.fluid)?;
        let stays = inlet.affine(-1.0, 1.0)?;
        rows.push(after.mul(&stays)?.mul(&kept)?);
        rates.push(rate.mul(&stays)?);
    }
    if l.rates {
        let stays = known.narrow(0, l.last_rates(), rates.len())?.broadcast_mul(&walls.mul(&kept)?)?;
        rows.push((Tensor::cat(&rates, 0)? + stays)?);
    }
    let after = Tensor::cat(&rows, 0)?;
    super::drive::composed(model, dt, &around.fluid, &around.masses(state)?, &after)
}
