//! The kick of a [`Drive`] behind the others, and its adjoint: two sums over the fluid, and a sweep.

use super::grid::run;
use super::lattice::{row, Fixed};
use super::sweeps::{mass_flux, put_flux, Context};
use super::work::{field, line};
use crate::numerics::lanes::{lanes_of_rows, Lanes, Real};
use crate::numerics::sweep::RowKernel;
use crate::sph::laws::drive::Drive;
use crate::sph::own::Own;
use std::ops::Range;

/// Sums over columns: of the fluid's momentum and mass, rho D and rho D u times the rows' weights in a section.
struct Momentum<'a, R: Real>(&'a Context<'a, R>);

impl<R: Real> RowKernel<R> for Momentum<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.0;
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let (mut momentum, mut mass) = (L::zero(), L::zero());
            for j in 0..c.rows() {
                let share = weight::<R, L>(c, j) * c.density(c.get::<L>(field::P, j, here));
                mass += share;
                momentum = share.mul_add(c.get(field::KICKED_U, j, here), momentum);
            }
            let d = c.line::<L>(line::D, here);
            c.put_line(line::MOMENTUM, at, momentum * d);
            c.put_line(line::MASS, at, mass * d);
        }
    }
}

/// What a row counts in a section.
#[inline(always)]
fn weight<R: Real, L: Lanes<Real = R>>(c: &Context<'_, R>, j: isize) -> L {
    L::splat(R::of(c.fixed.row_weight(j as usize)))
}

/// KICKED_U += kick, and the mass flux again.
struct Push<'a, R: Real> {
    context: &'a Context<'a, R>,
    next: Option<&'a Own<'a, R>>,
    kick: R,
}

impl<R: Real> RowKernel<R> for Push<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let d = c.line::<L>(line::D, here);
            for j in 0..c.rows() {
                let get = |field| c.get::<L>(field, j, here);
                let (u, v) = (get(field::KICKED_U) + L::splat(self.kick), get(field::KICKED_V));
                c.put(field::KICKED_U, j, at, u);
                if let Some(next) = self.next {
                    c.to_state(next, row::U, j, at, u);
                }
                let m = mass_flux(d, get(field::S), c.density(get(field::P)), u, v);
                put_flux(c, [field::KICKED_MX, field::KICKED_MY], j, at, m, [get(field::GX), get(field::GY)]);
            }
        }
    }
}

/// Sums over columns of the cotangent of the velocity.
struct KickBar<'a, R: Real>(&'a Context<'a, R>);

impl<R: Real> RowKernel<R> for KickBar<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.0;
        for at in c.vectors::<L>(units) {
            let mut sum = L::zero();
            (0..c.rows()).for_each(|j| sum += c.get(field::U_BAR, j, at as isize));
            c.put_line(line::MOMENTUM, at, sum);
        }
    }
}

/// What momentum and mass hand on: to the velocities before the kick, and so to what the other forces are divided by; to
/// densities and columns.
struct PushBar<'a, R: Real> {
    context: &'a Context<'a, R>,
    kick: R,
    momentum_bar: R,
    mass_bar: R,
}

impl<R: Real> RowKernel<R> for PushBar<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let (kick, of_momentum, of_mass) = (L::splat(self.kick), L::splat(self.momentum_bar), L::splat(self.mass_bar));
        let (dt, compressibility) = (L::splat(c.constants.dt), L::splat(c.constants.compressibility));
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let d = c.line::<L>(line::D, here);
            let mut d_bar = L::zero();
            for j in 0..c.rows() {
                let get = |field| c.get::<L>(field, j, here);
                let (rho, share) = (c.density(get(field::P)), weight::<R, L>(c, j));
                let u = get(field::KICKED_U) - kick;
                let u_bar = share * rho * d * of_momentum;
                c.put(field::U_BAR, j, at, get(field::U_BAR) + u_bar);
                c.put(field::BAR_U, j, at, (dt / (rho * d)).mul_add(u_bar, get(field::BAR_U)));
                // The other forces are divided by rho D; the particle's mass is rho D.
                let forces = u_bar * (u - get(field::U));
                let mass_bar = share * of_momentum.mul_add(u, of_mass);
                let rho_bar = d.mul_add(mass_bar, -(forces / rho));
                c.put(field::P_BAR, j, at, compressibility.mul_add(rho_bar, get(field::P_BAR)));
                d_bar += rho.mul_add(mass_bar, -(forces / d));
            }
            c.put_line(line::BARS, at, c.line::<L>(line::BARS, here) + d_bar);
        }
    }
}

impl<R: Real> Fixed<R> {
    /// What a row of fluid counts in an integral from wall to wall, see [`Self::section_weights`].
    #[inline(always)]
    pub(super) fn row_weight(&self, row: usize) -> f64 {
        match row == 0 || row == self.grid.rows - 1 {
            true => 11.0 / 12.0,
            false => 1.0,
        }
    }

    /// Mass of a particle with rho D = 1.
    fn unit_mass(&self) -> f64 {
        self.channel.density * self.channel.spacing * self.channel.spacing
    }

    /// Kicks the velocities behind the other forces, in `context` and in the next state, and keeps the acceleration as the
    /// context's body force.
    pub(super) fn push(&self, context: &mut Context<'_, R>, drive: Drive, next: Option<&Own<'_, R>>) {
        let [momentum, mass] = self.momentum_and_mass(context);
        let kick = drive.kick(self.channel.dt, momentum, mass).kick;
        run(&Push { context, next, kick: R::of(kick) }, self.grid.units());
        context.constants.body_force = R::of(kick / self.channel.dt);
    }

    /// Momentum along x, by the velocities in `context`, and mass.
    fn momentum_and_mass(&self, context: &Context<'_, R>) -> [f64; 2] {
        run(&Momentum(context), self.grid.units());
        [line::MOMENTUM, line::MASS].map(|line| self.unit_mass() * context.fields.sum_of_line(line))
    }

    /// Its adjoint, between the two sweeps of the step's.
    pub(super) fn push_bar(&self, context: &Context<'_, R>, drive: Drive) {
        let units = self.grid.units();
        let kick = context.constants.body_force.f64() * self.channel.dt;
        // Sums of the velocities behind the kick give those before it.
        let [momentum, mass] = self.momentum_and_mass(context);
        let found = drive.kick(self.channel.dt, momentum - kick * mass, mass);
        run(&KickBar(context), units);
        let kick_bar = context.fields.sum_of_line(line::MOMENTUM);
        let unit = self.unit_mass();
        let (momentum_bar, mass_bar) = (unit * kick_bar * found.by_momentum, unit * kick_bar * found.by_mass);
        let of = R::of;
        run(&PushBar { context, kick: of(kick), momentum_bar: of(momentum_bar), mass_bar: of(mass_bar) }, units);
    }
}
