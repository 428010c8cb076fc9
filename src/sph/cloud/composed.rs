//! The residual of [`super::equations`] as candle operators over the padded neighbour lists, on its graph.
//!
//! Newton's method uses the fused residual, matrix and adjoint; this one has the same equations written once more, and candle's
//! autograd gives its derivatives by state and positions, to which those are compared.

use super::equations::{Equations, Motion, Warmth};
use super::fit::{Stencils, LEFT};
use crate::sph::consistent::composed::{factorised, solved};
use candle_core::{Device, Result, Tensor};

/// The neighbours of all particles as tensors.
struct Pairs {
    list: Tensor,
    /// `[2, N, K]` and `[N, K]`.
    shift: Tensor,
    weight: Tensor,
    /// 1 / h, `[N]`.
    inverse_scale: Tensor,
    size: (usize, usize),
}

/// x, y, xx, xy, yy and S of a field, `[N]` each.
type Derivatives = [Tensor; 6];

impl Pairs {
    fn new(stencils: &Stencils) -> Result<Self> {
        let (n, k) = (stencils.particles, stencils.neighbours);
        let all = || (0..n).flat_map(|i| (0..k).map(move |k| (i, k)));
        let list: Vec<u32> = all().map(|(i, k)| stencils.pair(i, k).0 as u32).collect();
        let weight: Vec<f64> = all().map(|(i, k)| stencils.pair(i, k).1).collect();
        let shift: Vec<f64> = (0..2).flat_map(|d| all().map(move |(i, k)| stencils.pair(i, k).2[d])).collect();
        let scale: Vec<f64> = (0..n).map(|i| 1.0 / stencils.scale(i)).collect();
        Ok(Self {
            list: Tensor::new(list, &Device::Cpu)?,
            shift: Tensor::from_vec(shift, (2, n, k), &Device::Cpu)?,
            weight: Tensor::from_vec(weight, (n, k), &Device::Cpu)?,
            inverse_scale: Tensor::new(scale, &Device::Cpu)?,
            size: (n, k),
        })
    }

    /// f_j - f_i of a field `[N]`, `[N, K]`.
    fn difference(&self, field: &Tensor) -> Result<Tensor> {
        field.index_select(&self.list, 0)?.reshape(self.size)?.broadcast_sub(&field.unsqueeze(1)?)
    }

    /// The derivatives of fields at positions `[2, N]`.
    fn derivatives(&self, position: &Tensor, fields: &[Tensor]) -> Result<Vec<Derivatives>> {
        let scaled = |d: usize| -> Result<Tensor> {
            let r = (self.difference(&position.get(d)?)? + self.shift.get(d)?)?;
            r.broadcast_mul(&self.inverse_scale.unsqueeze(1)?)
        };
        let (x, y) = (scaled(0)?, scaled(1)?);
        let q = [x.clone(), y.clone(), (x.sqr()? * 0.5)?, x.mul(&y)?, (y.sqr()? * 0.5)?];
        let weighted = q.iter().map(|q| q.mul(&self.weight)).collect::<Result<Vec<_>>>()?;
        let mut matrix = vec![];
        for row in 0..q.len() {
            for column in &q[..=row] {
                matrix.push(weighted[row].mul(column)?.sum(1)?);
            }
        }
        let factor = factorised(matrix, q.len())?;
        let square = self.weight.mul(&(x.sqr()? + y.sqr()?)?)?.sum(1)?;
        let second = self.inverse_scale.sqr()?;
        let strength = (second.mul(&square.recip()?)? * 4.0)?;
        let of = |field: &Tensor| -> Result<Derivatives> {
            let difference = self.difference(field)?;
            let right = weighted.iter().map(|q| q.mul(&difference)?.sum(1)).collect::<Result<Vec<_>>>()?;
            let d = solved(&factor, right)?;
            let mut left = difference;
            for (d, q) in d.iter().zip(&q) {
                left = left.sub(&q.broadcast_mul(&d.unsqueeze(1)?)?)?;
            }
            let left = left.mul(&self.weight)?.sum(1)?.mul(&strength)?;
            let unit = |k: usize| if k < 2 { d[k].mul(&self.inverse_scale) } else { d[k].mul(&second) };
            Ok([unit(0)?, unit(1)?, unit(2)?, unit(3)?, unit(4)?, left])
        };
        fields.iter().map(of).collect()
    }
}

/// Residuals of x momentum, y momentum, continuity and heat, `[4, N]`, for positions `[2, N]` and a state `[4, N]` of u, v, p
/// and T. lambda and the drive are 0.
///
/// # Errors
/// Tensor errors.
pub fn residual(equations: &Equations, position: &Tensor, state: &Tensor) -> Result<Tensor> {
    let (n, inside) = (equations.particles(), equations.inside);
    let fields = (0..4).map(|f| state.get(f)).collect::<Result<Vec<_>>>()?;
    let all = Pairs::new(&equations.fits.all)?.derivatives(position, &fields)?;
    let [u, v, p, t] = [&fields[0], &fields[1], &fields[2], &fields[3]];
    let [du, dv, dp, dt] = [&all[0], &all[1], &all[2], &all[3]];
    let alpha = equations.diffusivity.unwrap_or(0.0);
    let carried = |d: &Derivatives| u.mul(&d[0])? + v.mul(&d[1])?;
    let diffused = |d: &Derivatives, by: f64| (&d[2] + &d[4])? * by;
    let moved = |d: &Derivatives, push: &Tensor, force: f64| -> Result<Tensor> {
        ((carried(d)? - diffused(d, equations.viscosity)?)? + push)?.affine(1.0, -force)
    };
    let damping = Tensor::new(equations.damping.clone(), &Device::Cpu)?;
    let lifted = |row: Tensor, e: usize| match equations.buoyancy {
        Some(lift) => row - t.affine(lift.by[e], -lift.by[e] * lift.at)?,
        None => Ok(row),
    };
    let within = [
        lifted(moved(du, &dp[0], equations.force[0])?, 0)?,
        lifted(moved(dv, &dp[1], equations.force[1])?, 1)?,
        ((&du[0] + &dv[1])? - dp[LEFT].mul(&damping)?)?,
        (carried(dt)? - diffused(dt, alpha)?)?,
    ];
    // On the boundary each row is a weighted sum of values and derivatives, given by constant weights.
    let rows = |of: &dyn Fn(usize) -> f64| -> Result<Tensor> {
        Tensor::new((0..n).map(|i| if i < inside { 0.0 } else { of(i - inside) }).collect::<Vec<f64>>(), &Device::Cpu)
    };
    let is_inside =
        Tensor::new((0..n).map(|i| if i < inside { 1.0 } else { 0.0 }).collect::<Vec<f64>>(), &Device::Cpu)?;
    let motion = |k: usize| equations.conditions[k].motion;
    let is = |on: bool| if on { 1.0 } else { 0.0 };
    // Slopes along x and y, and S: what each is multiplied with in n . grad f + h S f.
    let across = |k: usize, derivative: usize| match derivative {
        LEFT => equations.smoothing(inside + k),
        along => equations.conditions[k].normal[along],
    };
    let mut residual = vec![];
    for e in 0..2 {
        let (own, slopes) = ([u, v][e], [du, dv][e]);
        let value = rows(&|k| is(matches!(motion(k), Motion::Given(_)) || motion(k) == Motion::Symmetry(e)))?;
        let given = rows(&|k| if let Motion::Given(given) = motion(k) { given[e] } else { 0.0 })?;
        let mut row = (within[e].mul(&is_inside)? + (own.mul(&value)? - given)?)?;
        for derivative in [0, 1, LEFT] {
            let free = rows(&|k| match motion(k) {
                Motion::Outflow(along) if along == e => equations.viscosity * is(derivative == along),
                Motion::Symmetry(along) | Motion::Outflow(along) if along != e => -across(k, derivative),
                _ => 0.0,
            })?;
            row = (row + slopes[derivative].mul(&free)?)?;
        }
        residual.push((row - p.mul(&rows(&|k| is(motion(k) == Motion::Outflow(e)))?)?)?);
    }
    residual.push(within[2].clone());
    let warmth = |k: usize| equations.conditions[k].warmth;
    let value = rows(&|k| is(matches!(warmth(k), Warmth::Given(_))))?;
    let given = rows(&|k| match warmth(k) {
        Warmth::Given(given) => -given,
        Warmth::Flux(flux) => flux,
    })?;
    let mut row = (within[3].mul(&is_inside)? + (t.mul(&value)? + given)?)?;
    for derivative in [0, 1, LEFT] {
        let free = rows(&|k| match warmth(k) {
            Warmth::Given(_) => 0.0,
            Warmth::Flux(_) => alpha * across(k, derivative),
        })?;
        row = (row + dt[derivative].mul(&free)?)?;
    }
    residual.push(row);
    Tensor::stack(&residual, 0)
}
