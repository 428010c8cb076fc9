//! Fluxes from a Riemann problem between the particles of each pair (Zhang, Hu and Adams 2017).
//!
//! Along the line from i (left) to j (right), u_L = -u_i . e and u_R = -u_j . e with e = r_ij/d. The linear solver's
//! state between them is U* = (u_L + u_R)/2 + (p_L - p_R)/(2 rho c), P* = (p_L + p_R)/2 + beta rho (u_L - u_R)/2, with
//! the mean density rho and the dissipation limiter beta = min(eta max(u_L - u_R, 0), c) (their eq. 10 and 11). Then
//!
//! * drho_i/dt = 2 rho_i sum_j V_j (u_i - v*) . grad_i W, v* = (u_i + u_j)/2 - (U* - (u_L + u_R)/2) e (eq. 8);
//! * du_i/dt = -2 sum_j m_j P*/(rho_i rho_j) grad_i W + 2 sum_j m_j eta/(rho_i rho_j) (u_i - u_j) F with the viscosity
//!   eta (eq. 9, and Zhang, Hu and Adams 2019, eq. 6).
//!
//! The state on a wall's side follows from the fluid's: u_L = -u_i . n, u_R = -u_L + 2 u_wall . n, the pressure p_R =
//! p_L - rho_L g . r_ij and its density, with the wall's normal n into the fluid (Zhang et al. 2017, eq. 12 and 13;
//! Yang, Rakhsha, Hu and Negrut 2020, eq. 15). The signs of u_R are those of JAX-SPH, whose walls do not move along n.

use super::continuity::{DensityTerm, Exchange, Flowing, Meeting};
use super::equation_of_state::EquationOfState;
use super::pair_law::{dot, Bars, Faces, Pair, PairBar, PairFields, PairLaw, PairTensors, Side, Sums};
use crate::numerics::lanes::{Lanes, Real};
use crate::sph::composed::Pairs;
use candle_core::{Result, Tensor};

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Riemann {
    /// Speed of sound c.
    pub sound_speed: f64,
    /// eta of the dissipation limiter. 3 is usual; larger values dissipate more.
    pub limiter: f64,
}

/// The fluxes of a fluid: a pair law of the momentum, and a term of the density's rate.
#[derive(Debug, Clone, Copy)]
pub struct Fluxes {
    law: Riemann,
    state: EquationOfState,
    viscosity: f64,
}

impl Riemann {
    /// Those of a fluid.
    pub fn fluxes(self, state: EquationOfState, viscosity: f64) -> Fluxes {
        Fluxes { law: self, state, viscosity }
    }
}

/// The states on both sides of a Riemann problem, in lanes: inside, of the pair's fluid particle (i, if it is fluid), and
/// outside, of the other one or of the wall as the fluid inside makes it.
struct Across<L, const D: usize> {
    pressure: [L; 2],
    density: [L; 2],
    /// dp/drho inside.
    slope: L,
    /// drho/dp of the wall's state, 0 where both are fluid.
    outside: L,
    /// 1 at walls, 0 where both are fluid.
    wall: L,
    /// g and g . r, r from the outside to the inside.
    force: [L; D],
    lift: L,
    /// r = sign (r_i - r_j); not 1 in the rows of walls.
    sign: L,
}

/// Derivatives of a number that follows from the two states, by the fields of i.
struct ByOwn<L, const D: usize> {
    density: L,
    difference: [L; D],
    force: [L; D],
}

impl<L: Lanes, const D: usize> Across<L, D> {
    #[inline(always)]
    fn of(state: &EquationOfState, at: &Meeting<L, D>) -> Self {
        let number = |x: f64| L::splat(L::Real::of(x));
        let (inside, outside) = if at.own_is_fluid { (0, 1) } else { (1, 0) };
        let sign = number(if at.own_is_fluid { 1.0 } else { -1.0 });
        let density = at.density[inside];
        let pressure = state.pressure_lanes(density);
        let other = at.density[outside];
        let mut across = Self {
            pressure: [pressure, state.pressure_lanes(other)],
            density: [density, other],
            slope: state.slope_lanes(density),
            outside: L::zero(),
            wall: L::zero(),
            force: at.vector[inside],
            lift: L::zero(),
            sign,
        };
        if !at.fluid.is_whole() {
            across.lift = sign * dot(&across.force, at.difference);
            let of_wall = pressure - density * across.lift;
            let there = state.density_lanes(of_wall, density);
            let compressible = number(1.0) / state.slope_lanes(there);
            across.pressure[1] = at.fluid.choose(across.pressure[1], of_wall);
            across.density[1] = at.fluid.choose(other, there);
            across.outside = at.fluid.choose(L::zero(), compressible);
            across.wall = at.fluid.choose(L::zero(), number(1.0));
        }
        across
    }

    /// From the derivatives by the pressures and densities inside and outside to those by the fields of i. Of a wall i, none by its density
    /// and its force, which the states do not read.
    #[inline(always)]
    fn by_own(&self, pressure: [L; 2], density: [L; 2], at: &Meeting<L, D>) -> ByOwn<L, D> {
        // By the pressure of the wall's state, on which its density depends.
        let outside = self.wall * pressure[1] + self.outside * density[1];
        let by_lift = -(outside * self.density[0]);
        let mut by = ByOwn { density: L::zero(), difference: [L::zero(); D], force: [L::zero(); D] };
        for d in 0..D {
            by.difference[d] = by_lift * self.sign * self.force[d];
        }
        if at.own_is_fluid {
            by.density = pressure[0].mul_add(self.slope, density[0]) + outside * (self.slope - self.lift);
            for d in 0..D {
                by.force[d] = by_lift * at.difference[d];
            }
        }
        by
    }
}

impl DensityTerm for Fluxes {
    #[inline(always)]
    fn share<L: Lanes>(&self, _: L) -> (L, L) {
        (L::splat(L::Real::of(1.0)), L::zero())
    }

    /// X = (p_L - p_R) d/(rho c), with the fluid on the left.
    #[inline(always)]
    fn exchange<L: Lanes, const D: usize>(&self, at: &Meeting<L, D>) -> Exchange<L, D> {
        let across = Across::of(&self.state, at);
        let mut square = L::zero();
        for d in 0..D {
            square = at.difference[d].mul_add(at.difference[d], square);
        }
        let inverse = L::splat(L::Real::of(1.0)) / (across.density[0] + across.density[1]);
        // dX/dp_L, over the distance.
        let by_pressure = across.sign * inverse * L::splat(L::Real::of(2.0 / self.law.sound_speed));
        let per_distance = by_pressure * (across.pressure[0] - across.pressure[1]);
        let distance = square * at.inverse;
        let (value, by_pressure) = (per_distance * distance, by_pressure * distance);
        let by_density = -(value * inverse);
        let by = across.by_own([by_pressure, -by_pressure], [by_density; 2], at);
        let mut by_difference = by.difference;
        for d in 0..D {
            by_difference[d] = (per_distance * at.inverse).mul_add(at.difference[d], by_difference[d]);
        }
        Exchange { value, by_density: by.density, by_difference, by_vector: by.force }
    }
}

/// P* of a pair, and derivatives.
struct Star<L, const D: usize> {
    pressure: L,
    by: ByOwn<L, D>,
    /// By the velocity u_i of fluid.
    velocity: [L; D],
    /// By u . n of a wall i.
    crossing: L,
}

impl Fluxes {
    #[inline(always)]
    fn star<L: Lanes, const D: usize>(&self, pair: &Pair<L, D>) -> Star<L, D> {
        let number = |x: f64| L::splat(L::Real::of(x));
        let (a, b, fluid) = (pair.own, pair.other, &pair.fluid);
        let inverse = fluid.apply(pair.square.inverse_sqrt());
        let at = Meeting {
            density: [a.density, b.density],
            vector: [a.facing, b.facing],
            difference: &pair.difference,
            inverse,
            fluid,
            own_is_fluid: pair.own_is_fluid,
        };
        let across = Across::of(&self.state, &at);
        // u_L - u_R, with its derivatives by u_i and r_ij: -(u_i - u_j) . e between fluids.
        let mut parting = L::zero();
        for d in 0..D {
            parting = (a.velocity[d] - b.velocity[d]).mul_add(pair.difference[d], parting);
        }
        let mut closing = -(parting * inverse);
        let (mut by_velocity, mut by_difference) = ([L::zero(); D], [L::zero(); D]);
        for d in 0..D {
            by_velocity[d] = -(inverse * pair.difference[d]);
            let turned = closing * inverse * pair.difference[d];
            by_difference[d] = -(inverse * (a.velocity[d] - b.velocity[d] + turned));
        }
        if !fluid.is_whole() {
            // -2 (u + u_wall) . n at walls.
            let minus_two = number(-2.0);
            let (inside, normal, crossing) = match pair.own_is_fluid {
                true => (a, &b.facing, b.crossing),
                false => (b, &a.facing, a.crossing),
            };
            closing = fluid.choose(closing, minus_two * (dot(&inside.velocity, normal) + crossing));
            for d in 0..D {
                by_velocity[d] = fluid.choose(by_velocity[d], minus_two * normal[d]);
            }
        }
        // beta = min(eta max(u_L - u_R, 0), c), and the derivative of beta (u_L - u_R).
        let (most, limited) = (number(self.law.sound_speed), number(self.law.limiter) * closing.positive());
        let beta = limited.select_less(most, limited, most);
        let by_closing = limited.select_less(most, beta + beta, beta);
        let sum = across.density[0] + across.density[1];
        let quarter = number(0.25);
        let by_density = quarter * closing * beta;
        let half = number(0.5);
        let pressure = half.mul_add(across.pressure[0] + across.pressure[1], sum * by_density);
        let mut by = across.by_own([half; 2], [by_density; 2], &at);
        let by_closing = quarter * sum * by_closing;
        let mut velocity = [L::zero(); D];
        for d in 0..D {
            by.difference[d] = by_closing.mul_add(by_difference[d], by.difference[d]);
            if pair.own_is_fluid {
                velocity[d] = by_closing * by_velocity[d];
            }
        }
        let crossing = if pair.own_is_fluid { L::zero() } else { number(-2.0) * by_closing };
        Star { pressure, by, velocity, crossing }
    }

    /// 2 eta.
    fn shear<L: Lanes>(&self) -> L {
        L::splat(L::Real::of(2.0 * self.viscosity))
    }
}

impl PairLaw for Fluxes {
    const FACES: bool = true;
    type Own<L: Lanes, const D: usize> = ();

    #[inline(always)]
    fn prepare<L: Lanes, const D: usize>(&self, _: &Side<L, D>) {}

    /// The force on i gains V_i V_j F (2 eta (u_i - u_j) - 2 P* r).
    #[inline(always)]
    fn add<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, sums: &mut Sums<L, D>) {
        let (a, b, star) = (pair.own, pair.other, self.star(pair));
        let weight = a.volume * b.volume * pair.slope;
        let (shear, twice) = (self.shear::<L>(), star.pressure + star.pressure);
        for d in 0..D {
            let of_pair = shear * (a.velocity[d] - b.velocity[d]) - twice * pair.difference[d];
            sums.force[d] = weight.mul_add(of_pair, sums.force[d]);
        }
    }

    /// l gains V_i V_j F (2 eta alpha.(u_i - u_j) - 2 P* alpha.r).
    #[inline(always)]
    fn adjoint<L: Lanes, const D: usize>(&self, _: &(), pair: &Pair<L, D>, bars: &Bars<L, D>, to: &mut PairBar<L, D>) {
        let (a, b, star) = (pair.own, pair.other, self.star(pair));
        let (shear, twice) = (self.shear::<L>(), star.pressure + star.pressure);
        let mut bracket = -(twice * bars.along);
        for d in 0..D {
            bracket = (shear * bars.acceleration[d]).mul_add(a.velocity[d] - b.velocity[d], bracket);
        }
        let volumes = a.volume * b.volume;
        let weight = volumes * pair.slope;
        to.own.volume = (b.volume * pair.slope).mul_add(bracket, to.own.volume);
        to.by_slope = volumes.mul_add(bracket, to.by_slope);
        // By P*.
        let by_star = -(weight * (bars.along + bars.along));
        to.own.density = by_star.mul_add(star.by.density, to.own.density);
        to.own.crossing = by_star.mul_add(star.crossing, to.own.crossing);
        for d in 0..D {
            let by_position = by_star * star.by.difference[d] - weight * twice * bars.acceleration[d];
            to.own.position[d] += by_position;
            to.own.facing[d] = by_star.mul_add(star.by.force[d], to.own.facing[d]);
            let by_velocity = by_star * star.velocity[d] + weight * shear * bars.acceleration[d];
            to.own.velocity[d] += by_velocity;
        }
    }

    fn composed(&self, pairs: &Pairs, fields: &PairFields, sums: &mut PairTensors) -> Result<()> {
        let around = Surroundings { pairs, state: self.state, faces: &fields.faces };
        PairTensors::add(&mut sums.force, self.law.force(&around, fields, self.viscosity)?)
    }

    fn name(&self, names: &mut Vec<&'static str>) {
        names.push("pressure and viscosity by Riemann problems");
    }
}

/// The inputs of the Riemann problems besides densities, as tensors.
pub struct Surroundings<'a> {
    pub pairs: &'a Pairs,
    pub state: EquationOfState,
    pub faces: &'a Faces,
}

/// Pressure and density on both sides of a pair, `[1, N, K]`.
struct Sides {
    pressure: [Tensor; 2],
    density: [Tensor; 2],
}

/// `of_fluid` where the mask is 1, `of_wall` where it is 0.
fn choose(is_fluid: &Tensor, of_fluid: &Tensor, of_wall: &Tensor) -> Result<Tensor> {
    of_fluid.mul(is_fluid)? + of_wall.mul(&is_fluid.affine(-1.0, 1.0)?)?
}

impl Surroundings<'_> {
    fn sides(&self, density: &Tensor) -> Result<Sides> {
        let (pairs, fluid) = (self.pairs, self.pairs.other(&self.pairs.is_fluid)?);
        let pressure = self.state.pressure_composed(density)?;
        let (p, rho) = (pairs.own(&pressure)?, pairs.own(density)?);
        let lift = pairs.own(&self.faces.given)?.mul(&pairs.difference)?.sum_keepdim(0)?.mul(&rho)?;
        let p_wall = (&p - lift)?;
        let rho_wall = self.state.density_composed(&p_wall)?;
        let (p_other, rho_other) = (pairs.other(&pressure)?, pairs.other(density)?);
        let right = (choose(&fluid, &p_other, &p_wall)?, choose(&fluid, &rho_other, &rho_wall)?);
        Ok(Sides { pressure: [p, right.0], density: [rho, right.1] })
    }
}

impl Riemann {
    /// drho/dt, `[1, N]`, by candle's operators; 0 for wall particles.
    pub fn density_rate(&self, around: &Surroundings, flowing: &Flowing) -> Result<Tensor> {
        let sides = around.sides(flowing.density)?;
        let [p_left, p_right] = sides.pressure;
        let mean = (&sides.density[0] + &sides.density[1])?.affine(0.5 * self.sound_speed, 0.0)?;
        // 2 (u_i - v*) . e d = (u_i - u_j) . r + (p_L - p_R) d/(rho c).
        let jump = (p_left - p_right)?.div(&mean)?.mul(&around.pairs.distance)?;
        let rate = flowing.weight()?.mul(&(flowing.parting()? + jump)?)?.sum(2)?;
        rate.mul(flowing.density)?.mul(&around.pairs.is_fluid)
    }

    /// The force on each particle, `[D, N]`, by candle's operators. Walls in `fields` have the velocity for the shear
    /// stress.
    fn force(&self, around: &Surroundings, fields: &PairFields, viscosity: f64) -> Result<Tensor> {
        let pairs = around.pairs;
        let sides = around.sides(&fields.density)?;
        let [p_left, p_right] = &sides.pressure;
        let (u_i, u_j) = (pairs.own(&around.faces.velocity)?, pairs.other(&around.faces.velocity)?);
        let fluid = pairs.other(&pairs.is_fluid)?;
        let unit = pairs.difference.broadcast_div(&pairs.distance)?;
        let along = |u: &Tensor, n: &Tensor| u.mul(n)?.sum_keepdim(0);
        // u_L - u_R is -(u_i - u_j) . e, and -2 (u_i + u_j) . n at walls.
        let normal = pairs.other(&around.faces.normals)?;
        let closing =
            choose(&fluid, &along(&(&u_j - &u_i)?, &unit)?, &along(&(&u_i + &u_j)?, &normal)?.affine(-2.0, 0.0)?)?;
        let most = closing.ones_like()?.affine(self.sound_speed, 0.0)?;
        let beta = closing.relu()?.affine(self.limiter, 0.0)?.minimum(&most)?;
        let mean = (&sides.density[0] + &sides.density[1])?;
        let star = ((p_left + p_right)?.affine(0.5, 0.0)? + mean.mul(&closing)?.mul(&beta)?.affine(0.25, 0.0)?)?;
        // m_i m_j/(rho_i rho_j) F = V_i V_j F.
        let weight = pairs.own(&fields.volume)?.mul(&pairs.other(&fields.volume)?)?.mul(&fields.slope)?;
        let pressing = pairs.difference.broadcast_mul(&star.affine(-2.0, 0.0)?)?;
        let shear = (pairs.own(&fields.velocity)? - pairs.other(&fields.velocity)?)?.affine(2.0 * viscosity, 0.0)?;
        (pressing + shear)?.broadcast_mul(&weight)?.sum(2)
    }
}
