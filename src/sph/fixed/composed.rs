//! A step by ordinary candle operators with the equations of [`super`], as reference for the sweeps and their adjoint.

use super::ghosts;
use super::grid::REACH;
use super::lattice::{row, Fixed};
use super::stencil::{derivative, WIDTH};
use crate::numerics::lanes::Real;
use candle_core::{Result, Tensor};

/// The values of the i-th column to the right, periodic; `[rows, columns]`.
fn roll(f: &Tensor, i: isize) -> Result<Tensor> {
    let n = f.dim(1)?;
    match i.rem_euclid(n as isize) as usize {
        0 => Ok(f.clone()),
        i => Tensor::cat(&[f.narrow(1, i, n - i)?, f.narrow(1, 0, i)?], 1),
    }
}

/// Adds ghost rows to `[rows, columns]`; `make` maps the two rows next to a wall to its near and far ghost row.
fn extend(f: &Tensor, make: impl Fn(&Tensor, &Tensor, usize) -> Result<[Tensor; 2]>) -> Result<Tensor> {
    let n = f.dim(0)?;
    let r = |j: usize| f.narrow(0, j, 1);
    let ([b1, b2], [t1, t2]) = (make(&r(0)?, &r(1)?, 0)?, make(&r(n - 1)?, &r(n - 2)?, 1)?);
    Tensor::cat(&[&b2, &b1, f, &t1, &t2], 0)
}

fn combine(a: f64, f: &Tensor, b: f64, g: &Tensor) -> Result<Tensor> {
    f.affine(a, 0.0)? + g.affine(b, 0.0)?
}

/// Ghosts of a field that is zero on the wall.
fn parabola(f: &Tensor) -> Result<Tensor> {
    extend(f, |f, g, _| Ok([combine(-2.0, f, 1.0 / 3.0, g)?, combine(-9.0, f, 2.0, g)?]))
}

fn line(f: &Tensor) -> Result<Tensor> {
    extend(f, |f, g, _| Ok([combine(2.0, f, -1.0, g)?, combine(3.0, f, -2.0, g)?]))
}

fn odd(f: &Tensor) -> Result<Tensor> {
    extend(f, |f, g, _| Ok([f.neg()?, g.neg()?]))
}

/// The metric with ghosts, `[rows + 4, columns]`.
struct Metric {
    d: Tensor,
    s: Tensor,
    k: Tensor,
    /// D S/(1 + S^2) on both walls, `[1, columns]`.
    lean: [Tensor; 2],
}

impl<R: Real> Fixed<R> {
    /// The fluid rows of a field with ghosts.
    fn inner(&self, f: &Tensor) -> Result<Tensor> {
        f.narrow(0, REACH, self.channel.rows)
    }

    /// Velocity, pressure and temperature of the fluid of a state, `[rows, columns]` each.
    fn fluid_fields(&self, state: &Tensor) -> Result<[Tensor; 4]> {
        let (rows, columns) = (self.channel.rows, self.channel.columns);
        let field = |row: usize| state.narrow(0, row, 1)?.narrow(1, 0, rows * columns)?.reshape((rows, columns));
        Ok([field(row::U)?, field(row::V)?, field(row::P)?, field(row::T)?])
    }

    /// 1 in the columns for which a condition holds, else 0, `[1, columns]`.
    fn where_columns(&self, holds: impl Fn(usize) -> bool, like: &Tensor) -> Result<Tensor> {
        let mask: Vec<R> = (0..self.channel.columns).map(|k| R::of(f64::from(u8::from(holds(k))))).collect();
        Tensor::from_vec(mask, (1, self.channel.columns), like.device())?.to_dtype(like.dtype())
    }

    /// The sum over offsets of `term`, given their indices and a function from a field with ghosts to the neighbours.
    fn sum(
        &self,
        mut term: impl FnMut(usize, usize, &dyn Fn(&Tensor) -> Result<Tensor>) -> Result<Tensor>,
    ) -> Result<Tensor> {
        let mut total: Option<Tensor> = None;
        for j in 0..WIDTH {
            for i in 0..WIDTH {
                if (i, j) == (REACH, REACH) {
                    continue;
                }
                let shift = i as isize - REACH as isize;
                let there = |f: &Tensor| roll(&f.narrow(0, j, self.channel.rows)?, shift);
                let part = term(i, j, &there)?;
                total = Some(match total {
                    None => part,
                    Some(total) => (total + part)?,
                });
            }
        }
        total.ok_or_else(|| candle_core::Error::Msg("an empty stencil".into()))
    }

    fn composed_metric(&self, state: &Tensor) -> Result<Metric> {
        let (nx, fluid) = (self.channel.columns, self.fluid_particles());
        let walls = state.narrow(0, row::Y, 1)?.narrow(1, fluid, 2 * nx)?;
        let (bottom, top) = (walls.narrow(1, 0, nx)?, walls.narrow(1, nx, nx)?);
        let weights = derivative(&self.stencil);
        let slope = |f: &Tensor| -> Result<Tensor> {
            let mut sum = f.zeros_like()?;
            for (i, weight) in weights.iter().enumerate() {
                sum = (sum + roll(f, i as isize - REACH as isize)?.affine(*weight, 0.0)?)?;
            }
            Ok(sum)
        };
        let stretch = (top - &bottom)?.affine(1.0 / self.height(), 0.0)?;
        let (bottom_slope, rise) = (slope(&bottom)?, slope(&stretch)?);
        let at = |eta: f64| &bottom_slope + rise.affine(eta, 0.0)?;
        let rows: Vec<Tensor> = self.grid.all_rows().map(|r| at(self.eta(r))).collect::<Result<_>>()?;
        let s = Tensor::cat(&rows, 0)?;
        let d = stretch.broadcast_as(s.shape())?;
        let lean = |eta: f64| -> Result<Tensor> {
            let s = at(eta)?;
            s.mul(&stretch)?.div(&s.sqr()?.affine(1.0, 1.0)?)
        };
        let k = s.sqr()?.affine(1.0, 1.0)?.div(&d)?;
        Ok(Metric { lean: [lean(0.0)?, lean(self.height())?], d, s, k })
    }

    /// Constants of the columns, `[1, columns]`.
    fn constant(&self, line: &[R], like: &Tensor) -> Result<Tensor> {
        let from = self.grid.column(0);
        let values = line[from..from + self.channel.columns].to_vec();
        Tensor::from_vec(values, (1, self.channel.columns), like.device())?.to_dtype(like.dtype())
    }

    fn temperature_with_ghosts(&self, t: &Tensor, metric: &Metric) -> Result<Tensor> {
        let hot = self.constant(&self.ghosts.hot, t)?;
        extend(t, |f, g, wall| {
            let mut along = f.zeros_like()?;
            let on_wall = combine(ghosts::ON_WALL[0], f, ghosts::ON_WALL[1], g)?;
            for (k, weights) in self.ghosts.along[wall].iter().enumerate() {
                along = (along + roll(&on_wall, k as isize - 1)?.mul(&self.constant(weights, t)?)?)?;
            }
            let sign = if wall == 0 { 1.0 } else { -1.0 };
            let conormal = along.mul(&metric.lean[wall])?.affine(sign, 0.0)?;
            let hot = if wall == 0 { hot.clone() } else { hot.zeros_like()? };
            let cold = hot.affine(-1.0, 1.0)?;
            let given = self.channel.hot_excess;
            let near = combine(-2.0, f, 1.0 / 3.0, g)?.affine(1.0, 8.0 / 3.0 * given)?;
            let far = combine(-9.0, f, 2.0, g)?.affine(1.0, 8.0 * given)?;
            let near = (near.mul(&hot)? + f.mul(&cold)?)? - &conormal;
            let far = (far.mul(&hot)? + g.mul(&cold)?)? - conormal.affine(3.0, 0.0)?;
            Ok([near?, far?])
        })
    }

    /// Omega of all pairs with an offset.
    fn omega(&self, metric: &Metric, i: usize, j: usize, there: &dyn Fn(&Tensor) -> Result<Tensor>) -> Result<Tensor> {
        let both = |f: &Tensor, weight: R| (self.inner(f)? + there(f)?)?.affine(weight.f64(), 0.0);
        let w = &self.stencil[j][i];
        (both(&metric.d, w.lxx)? + both(&metric.k, w.lyy)?)? - both(&metric.s, w.lxy)?
    }

    /// Heat that conduction and ghosts bring to conducting particles with x < `until`, in units of density *
    /// temperature * volume / time, `[]`: that of the walls, and the little that is conducted along the channel.
    /// (Ghosts have a mass flux, which is zero on the wall. Its heat is included, so that in a steady flow this equals
    /// the heat that flows out.)
    pub fn heating(&self, state: &Tensor, until: f64) -> Result<Tensor> {
        let c = &self.channel;
        let [u, v, p, t] = self.fluid_fields(state)?;
        let metric = self.composed_metric(state)?;
        let (d, s) = (self.inner(&metric.d)?, self.inner(&metric.s)?);
        let rho = p.affine(1.0 / (c.density * c.sound_speed * c.sound_speed), 1.0)?;
        let ghosts = self.temperature_with_ghosts(&t, &metric)?;
        let mx = parabola(&(&d * &rho)?.mul(&u)?)?;
        let my = odd(&rho.mul(&(v - s.mul(&u)?)?)?)?;
        let outside = rho.ones_like()?.pad_with_zeros(0, REACH, REACH)?.affine(-1.0, 1.0)?;
        let heat = self.sum(|i, j, there| {
            let (w, other) = (&self.stencil[j][i], there(&ghosts)?);
            let both = |f: &Tensor, weight: R| (self.inner(f)? + there(f)?)?.affine(0.5 * weight.f64(), 0.0);
            let carried = (both(&mx, w.cx)? + both(&my, w.cy)?)?.mul(&there(&outside)?)?.mul(&(&other + &t)?)?;
            let conducted = self.omega(&metric, i, j, there)?.mul(&rho)?.mul(&(&other - &t)?)?;
            conducted.affine(c.diffusivity, 0.0)? - carried
        })?;
        let conducts = |i: usize| self.open[i].f64() > 0.0 && i <= self.outlet && c.x(i) < until;
        let here = self.where_columns(conducts, state)?;
        heat.broadcast_mul(&here)?.sum_all()?.affine(c.density * c.spacing * c.spacing, 0.0)
    }

    /// Heat that pairs of particles carry through the section at `x`, above the inlet's temperature, in units of density *
    /// temperature * volume / time, `[]`: the sum of M (T_a + T_b)/2 over the pairs on both sides of the section. In a steady
    /// flow it is the heat of the walls, but for what is conducted through the section. (A sum of rho u T over particles is
    /// not: it differs from these means by second derivatives across the channel, 0.9 % of the heat at ten rows.)
    pub fn carried(&self, state: &Tensor, x: f64) -> Result<Tensor> {
        let c = &self.channel;
        let [u, v, p, t] = self.fluid_fields(state)?;
        let metric = self.composed_metric(state)?;
        let (d, s) = (self.inner(&metric.d)?, self.inner(&metric.s)?);
        let rho = p.affine(1.0 / (c.density * c.sound_speed * c.sound_speed), 1.0)?;
        let pad = |f: &Tensor| f.pad_with_zeros(0, REACH, REACH);
        let (mx, my) = (pad(&(&d * &rho)?.mul(&u)?)?, pad(&rho.mul(&(v - s.mul(&u)?)?)?)?);
        let (inside, padded) = (pad(&rho.ones_like()?)?, pad(&t)?);
        // The first column behind the section. (By its number, because a section may lie on a column but for rounding.)
        let behind = ((x - c.first_column_x) / c.spacing - 1e-6).ceil() as isize;
        let heat = self.sum(|i, j, there| {
            let ahead = i as isize - REACH as isize;
            let crosses = |k: usize| (k as isize) < behind && k as isize + ahead >= behind;
            let crossing = self.where_columns(crosses, state)?;
            let w = &self.stencil[j][i];
            let both = |f: &Tensor, weight: R| (self.inner(f)? + there(f)?)?.affine(0.5 * weight.f64(), 0.0);
            let carried = (both(&mx, w.cx)? + both(&my, w.cy)?)?.mul(&(there(&padded)? + &t)?)?;
            carried.mul(&there(&inside)?)?.broadcast_mul(&crossing)
        })?;
        heat.sum_all()?.affine(c.density * c.spacing * c.spacing, 0.0)
    }

    /// State `[6, N]` -> next `[6, N]`.
    pub fn composed(&self, state: &Tensor) -> Result<Tensor> {
        let c = &self.channel;
        let (nx, ny, n, fluid) = (c.columns, c.rows, self.particles(), self.fluid_particles());
        let [u, v, p, t] = self.fluid_fields(state)?;
        let metric = self.composed_metric(state)?;
        let stiffness = c.density * c.sound_speed * c.sound_speed;
        let rho = p.affine(1.0 / stiffness, 1.0)?;
        let with_ghosts = line(&rho)?;
        let (d, s) = (self.inner(&metric.d)?, self.inner(&metric.s)?);
        let w = |i: usize, j: usize| &self.stencil[j][i];
        let gradient = [
            self.sum(|i, j, there| there(&with_ghosts)?.affine(w(i, j).gx.f64(), 0.0))?,
            self.sum(|i, j, there| there(&with_ghosts)?.affine(w(i, j).gy.f64(), 0.0))?,
        ];
        // Only pairs of fluid particles diffuse.
        let pad = |f: &Tensor| f.pad_with_zeros(0, REACH, REACH);
        let inside = pad(&rho.ones_like()?)?;
        let (padded, gradients) = (pad(&rho)?, [pad(&gradient[0])?, pad(&gradient[1])?]);
        let omega = |i: usize, j: usize, there: &dyn Fn(&Tensor) -> Result<Tensor>| self.omega(&metric, i, j, there);
        // The mass flux M of all offsets for velocities u and v, with the weights for the mass or for what it carries.
        let fluxes = |u: &Tensor, v: &Tensor, carrying: bool| -> Result<Vec<Tensor>> {
            let mx = parabola(&(&d * &rho)?.mul(u)?)?;
            let my = odd(&rho.mul(&(v - s.mul(u)?)?)?)?;
            let mut fluxes = Vec::new();
            self.sum(|i, j, there| {
                let w = w(i, j);
                let both = |f: &Tensor, weight: f64| (self.inner(f)? + there(f)?)?.affine(weight, 0.0);
                let [x, y] = if carrying { [w.cx, w.cy] } else { [w.gx, w.gy] };
                let convected = (both(&mx, x.f64())? + both(&my, y.f64())?)?;
                // The gradients' part of the diffusion has the same weights: g . r/2 (grad_a + grad_b) of rho, w r/2 = g.
                let slope = (both(&gradients[0], x.f64())? + both(&gradients[1], y.f64())?)?;
                let rise = ((there(&padded)? - &rho)?.affine(w.laplacian.f64(), 0.0)? - slope)?;
                let diffused = rise.affine(c.delta * c.spacing * c.sound_speed, 0.0)?;
                let flux = (convected - diffused.mul(&there(&inside)?)?)?;
                fluxes.push(flux.clone());
                Ok(flux)
            })?;
            Ok(fluxes)
        };
        // Index of an offset in a list without the centre.
        let number = |i: usize, j: usize| {
            let k = j * WIDTH + i;
            k - (k > WIDTH * WIDTH / 2) as usize
        };
        let mass = (&rho * &d)?;
        let before = fluxes(&u, &v, false)?;
        let kick = |f: &Tensor| -> Result<Tensor> {
            let ghosts = parabola(f)?;
            self.sum(|i, j, there| {
                let factor =
                    (omega(i, j, there)?.affine(c.viscosity, 0.0)? - before[number(i, j)].affine(0.5, 0.0)?)?;
                factor.mul(&(there(&ghosts)? - f)?)
            })
        };
        let pressure = line(&p.affine(1.0 / c.density, 0.0)?)?;
        let push_u = self.sum(|i, j, there| {
            let both = |f: &Tensor, weight: R| (self.inner(f)? + there(f)?)?.affine(0.5 * weight.f64(), 0.0);
            let push = (both(&metric.s, w(i, j).gy)? - both(&metric.d, w(i, j).gx)?)?;
            (there(&pressure)? - self.inner(&pressure)?)?.mul(&push)
        })?;
        let push_v = self.sum(|i, j, there| there(&pressure)?.affine(-w(i, j).gy.f64(), 0.0))?;
        let u = (&u + (kick(&u)? + push_u)?.div(&mass)?.affine(c.dt, c.dt * c.body_force)?)?;
        let v = (&v + (kick(&v)? + push_v)?.div(&mass)?.affine(c.dt, 0.0)?)?;
        let u = match c.drive {
            None => u,
            Some(drive) => {
                let weights: Vec<R> = self.section_weights().into_iter().map(R::of).collect();
                let weights = Tensor::from_vec(weights, (ny, nx), u.device())?.to_dtype(u.dtype())?;
                let masses = mass.mul(&weights)?.affine(c.density * c.spacing * c.spacing, 0.0)?;
                let sum = |f: &Tensor| f.sum_keepdim(0)?.sum_keepdim(1);
                u.broadcast_add(&drive.composed(c.dt, &sum(&masses.mul(&u)?)?, &sum(&masses)?)?)?
            }
        };
        let [behind, carrying] = [fluxes(&u, &v, false)?, fluxes(&u, &v, true)?];
        let out = self.sum(|i, j, _| Ok(behind[number(i, j)].clone()))?;
        let p = (&p - out.div(&d)?.affine(c.dt * stiffness, 0.0)?)?;
        let ghosts = self.temperature_with_ghosts(&t, &metric)?;
        let heat = self.sum(|i, j, there| {
            let conduction = omega(i, j, there)?.mul(&rho)?.affine(c.diffusivity, 0.0)?;
            let factor = (conduction - carrying[number(i, j)].affine(0.5, 0.0)?)?;
            factor.mul(&(there(&ghosts)? - &t)?)
        })?;
        let t = (&t + heat.div(&mass)?.affine(c.dt, 0.0)?)?;
        let open = Tensor::from_vec(self.open[..nx].to_vec(), (1, nx), t.device())?.to_dtype(t.dtype())?;
        let t = t.broadcast_mul(&open)?;
        let last = t.narrow(1, self.outlet, 1)?;
        let mut columns = vec![t.narrow(1, 0, self.outlet + 1)?];
        columns.extend((self.outlet + 1..nx).map(|_| last.clone()));
        let t = Tensor::cat(&columns, 1)?;
        let rows = [u, v, p, t].map(|f| f.reshape((1, fluid))?.pad_with_zeros(1, 0, n - fluid));
        let mut next = vec![state.narrow(0, row::X, 2)?];
        for row in rows {
            next.push(row?);
        }
        Tensor::cat(&next, 0)
    }
}
