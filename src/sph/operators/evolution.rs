//! Density by evolution: rho' = rho + dt drho/dt, instead of [`super::density`].
//!
//! Its rate is that of [`crate::sph::laws::continuity`], with [`crate::sph::laws::density_diffusion`] in delta-SPH, or that of
//! [`crate::sph::laws::riemann`]. In front of a wall stands the density that the last step's wall condition gave the wall
//! ([`super::wall_condition`]): the state has a row of it. dt = 0 is the density as it is.

use super::composed::{mass, Pairs};
use super::renormalisation;
use crate::numerics::lanes::Real;
use crate::sph::chain::Step;
use crate::sph::laws::continuity::{self, Flowing};
use crate::sph::laws::riemann::Surroundings;
use crate::sph::laws::Flux;
use candle_core::{Result, Tensor};

/// moved `[M, N]` -> drho/dt, `[1, N]`, from candle's operators.
///
/// # Errors
/// Tensor errors.
pub fn rate<R: Real>(step: &Step<R>, pairs: &Pairs, moved: &Tensor) -> Result<Tensor> {
    let (model, l) = (&*step.model, step.model.layout);
    let density = moved.narrow(0, l.moved_density(), 1)?;
    let velocity = moved.narrow(0, l.velocity(), l.dimension)?;
    let volume = mass(step, moved)?.div(&density)?;
    let slope = model.kernel.composed(&pairs.distance)?.1.mul(&pairs.mask)?;
    let flowing = Flowing { pairs, density: &density, volume: &volume, velocity: &velocity, slope: &slope };
    match &model.standard.flux {
        Flux::Pair => continuity::composed(&flowing),
        Flux::Delta(diffusion, _) => {
            let among_walls = || pairs_of_walls(step, moved, &volume);
            // Walls get their density from the fluid's pressure: nothing diffuses into them.
            continuity::composed(&flowing)? + diffusion.composed(&flowing, among_walls)?.mul(&pairs.is_fluid)?
        }
        Flux::Riemann(law) => {
            let position = moved.narrow(0, 0, l.dimension)?;
            let (given, normals) = (model.body_force.vector(&position)?, normals(step, moved)?);
            let (state, velocity) = (model.equation_of_state, &velocity);
            law.density_rate(&Surroundings { pairs, state, given: &given, normals: &normals, velocity }, &flowing)
        }
    }
}

/// moved `[M, N]` -> density `[1, N]` of fluid and walls, from candle's operators.
///
/// # Errors
/// Tensor errors.
pub fn composed<R: Real>(step: &Step<R>, pairs: &Pairs, dt: f64, moved: &Tensor) -> Result<Tensor> {
    let (model, l) = (&*step.model, step.model.layout);
    let density = moved.narrow(0, l.moved_density(), 1)?;
    if dt == 0.0 {
        return Ok(density);
    }
    let density = (density + rate(step, pairs, moved)?.affine(dt, 0.0)?)?;
    match model.standard.renormalises {
        true => renormalisation::composed(step, pairs, &mass(step, moved)?, &density),
        false => Ok(density),
    }
}

/// The walls' normals `[D, N]`; 0 where the scene has none.
pub(super) fn normals<R: Real>(step: &Step<R>, like: &Tensor) -> Result<Tensor> {
    let (n, d) = (step.model.particles(), step.model.layout.dimension);
    let normals = step.model.standard.normals.clone().unwrap_or_else(|| vec![R::default(); d * n]);
    Tensor::from_vec(normals, (d, n), like.device())?.to_dtype(like.dtype())
}

/// -sum V_j F r_ij (x) r_ij over pairs of two wall particles, `[D D, N]`, 0 for fluid: every wall particle with every other
/// one, since nothing but a comparison with JAX-SPH asks for it.
fn pairs_of_walls<R: Real>(step: &Step<R>, moved: &Tensor, volume: &Tensor) -> Result<Tensor> {
    let (model, device) = (&*step.model, moved.device());
    let (n, d) = (model.particles(), model.layout.dimension);
    let walls: Vec<u32> = (0..n as u32).filter(|&i| !model.is_fluid(i as usize)).collect();
    let count = walls.len();
    let nothing = Tensor::zeros((d * d, n), moved.dtype(), device)?;
    if count == 0 {
        return Ok(nothing);
    }
    let chosen = Tensor::from_vec(walls, count, device)?;
    let of_walls = |x: &Tensor| x.contiguous()?.index_select(&chosen, 1);
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
    nothing.index_add(&chosen, &Tensor::cat(&rows, 0)?, 1)
}
