//! The adjoint of a step: sweeps `Pull`, `PullBack`, `Finish`, gathered like the step's own.
//!
//! Cotangents of the next state, over what divides the sums: A = -dt density c^2 p_bar/D, B = dt T_bar/(rho D) and, once the
//! mass flux behind the kick has given its share to u_bar and v_bar, U = dt u_bar/(rho D), V likewise; all 0 in ghosts. A
//! pair's flux M_ab = -M_ba then has the cotangent (that by M_ab less that by M_ba)
//!
//! * behind the kick N = A_a - A_b as it moves mass, and -(B_a + B_b)(T_b - T_a)/2 as it carries heat, by the weights c;
//! * before it N = -[(U_a + U_b)(u_b - u_a) + (V_a + V_b)(v_b - v_a)]/2;
//!
//! and m_a gets sum g N (and sum c N), p_a gets delta c dx/c^2 sum w N, T_a gets sum alpha Omega (rho_b B_b - rho_a B_a) + M (B_a + B_b)/2
//! and u_a, v_a the like; ghosts are rows of these sums too, and hand on what they get to the rows they are made of. The
//! metric gets l alpha (rho_a B_a - rho_b B_b)(T_b - T_a) and the like: sums over columns, see [`super::metric`].

use super::ghosts;
use super::grid::run;
use super::grid::REACH;
use super::lattice::{row, Fixed};
use super::stencil::{Weight, WIDTH};
use super::sweeps::{along, hot, Context, End, Pairs, WALLS};
use super::work::{field, line, Work};
use crate::numerics::lanes::{array, lanes_of_rows, Lanes, Real};
use crate::numerics::sweep::RowKernel;
use crate::sph::own::Own;
use std::ops::Range;

/// Cotangents of the metric's columns.
struct Metric<L> {
    d: L,
    s: L,
    eta_s: L,
}

impl<L: Lanes> Metric<L> {
    #[inline(always)]
    fn zero() -> Self {
        Self { d: L::zero(), s: L::zero(), eta_s: L::zero() }
    }
    #[inline(always)]
    fn add(&mut self, eta: L, d: L, s: L) {
        self.d += d;
        self.s += s;
        self.eta_s = eta.mul_add(s, self.eta_s);
    }
    #[inline(always)]
    fn put(self, c: &Context<'_, L::Real>, set: usize, at: usize) {
        for (k, bar) in [self.d, self.s, self.eta_s].into_iter().enumerate() {
            c.put_line(line::BARS + 3 * set + k, at, bar);
        }
    }
}

/// Sums over the pairs of a particle that both pair sweeps make.
struct Sums<L> {
    /// sum g N over fluid neighbours, over ghosts, and over the row of neighbours at hand.
    inside: [L; 2],
    ghost: [L; 2],
    row: [L; 2],
    /// Of p through the diffusion.
    p: L,
    /// Of D, S and K_yy through Omega.
    d: L,
    s: L,
    k: L,
}

impl<L: Lanes> Sums<L> {
    #[inline(always)]
    fn zero() -> Self {
        let zero = L::zero();
        Self { inside: [zero; 2], ghost: [zero; 2], row: [zero; 2], p: zero, d: zero, s: zero, k: zero }
    }
    /// The cotangent of a pair's flux by the weights for what the flow carries, besides what [`Self::add`] is given.
    #[inline(always)]
    fn carry(&mut self, weight: &Weight<L::Real>, flux_bar: L, diffusion: L) {
        self.row[0] = L::splat(weight.cx).mul_add(flux_bar, self.row[0]);
        self.row[1] = L::splat(weight.cy).mul_add(flux_bar, self.row[1]);
        self.p = (L::splat(weight.laplacian) * diffusion).mul_add(flux_bar, self.p);
    }
    /// A pair's N, and the factor z of its l in the metric's cotangent.
    #[inline(always)]
    fn add<const METRIC: bool>(&mut self, weight: &Weight<L::Real>, flux_bar: L, diffusion: L, z: L) {
        self.row[0] = L::splat(weight.gx).mul_add(flux_bar, self.row[0]);
        self.row[1] = L::splat(weight.gy).mul_add(flux_bar, self.row[1]);
        self.p = (L::splat(weight.laplacian) * diffusion).mul_add(flux_bar, self.p);
        if METRIC {
            self.d = L::splat(weight.lxx).mul_add(z, self.d);
            self.s = (-L::splat(weight.lxy)).mul_add(z, self.s);
            self.k = L::splat(weight.lyy).mul_add(z, self.k);
        }
    }
    /// A row of neighbours is done.
    #[inline(always)]
    fn end_row(&mut self, fluid: bool) {
        let to = if fluid { &mut self.inside } else { &mut self.ghost };
        for k in 0..2 {
            to[k] += self.row[k];
            self.row[k] = L::zero();
        }
    }
    #[inline(always)]
    fn flux(&self) -> [L; 2] {
        [self.inside[0] + self.ghost[0], self.inside[1] + self.ghost[1]]
    }
    /// Of D and S, with K_yy = (1 + S^2)/D.
    #[inline(always)]
    fn metric(&self, own: &End<L>) -> [L; 2] {
        let over = self.k / own.d;
        [self.d - own.k * over, (own.s + own.s).mul_add(over, self.s)]
    }
}

/// The mass flux's cotangent of a fluid row, with what its ghosts hand on.
#[inline(always)]
fn flux_bar<R: Real, L: Lanes<Real = R>>(c: &Context<'_, R>, j: isize, at: usize) -> [L; 2] {
    let of = |field| c.get::<L>(field, j, at as isize);
    let mut bar = [of(field::MX_BAR), of(field::MY_BAR)];
    for wall in WALLS {
        for k in 0..REACH {
            if j == c.near(wall, k) {
                bar[0] += ghosts::parabola_bar(c.ghost_rows::<L>(field::MX_BAR, wall, at))[k];
                bar[1] = bar[1] - c.ghost_rows::<L>(field::MY_BAR, wall, at)[k];
            }
        }
    }
    bar
}

/// From the next state's cotangent through pressure and temperature to the kicked velocities.
struct Pull<'a, R: Real, const METRIC: bool> {
    context: &'a Context<'a, R>,
    next_bar: &'a [R],
}

impl<R: Real, const METRIC: bool> RowKernel<R> for Pull<'_, R, METRIC> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let n = &c.constants;
        let half = L::splat(R::of(0.5));
        let (alpha, dt) = (L::splat(n.diffusivity), L::splat(n.dt));
        const FLUX: [usize; 2] = [field::KICKED_MX, field::KICKED_MY];
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let mut metric = Metric::<L>::zero();
            for j in c.fixed.grid.all_rows() {
                let own = End::<L>::own(c, FLUX, j, here);
                let get = |field| c.get::<L>(field, j, here);
                let (t, a, b) = (get(field::T), get(field::BAR_P), get(field::BAR_T));
                let rho = c.density(own.p);
                let e = alpha * rho * b;
                let mut sums = Sums::<L>::zero();
                let (mut t_bar, mut advected, mut conducted, mut mass) = (L::zero(), L::zero(), L::zero(), L::zero());
                for other in c.fixed.grid.reach_of(j) {
                    let pairs = Pairs::new(c, &own, FLUX, j, other, here);
                    for i in 0..WIDTH {
                        let pair = pairs.pair(c, &own, i);
                        let there = |field| c.get::<L>(field, other, pair.column);
                        let (b_there, difference) = (there(field::BAR_T), there(field::T) - t);
                        let both = half * (b + b_there);
                        let flux_bar = a - there(field::BAR_P);
                        let spread = e - alpha * c.density(pair.p) * b_there;
                        t_bar = pair.carrying.mul_add(both, t_bar) - pair.omega * spread;
                        advected = pair.carrying.mul_add(difference, advected);
                        if METRIC {
                            conducted = pair.omega.mul_add(difference, conducted);
                            mass += pair.flux;
                        }
                        sums.add::<METRIC>(pair.weight, flux_bar, pairs.diffusion, spread * difference);
                        sums.carry(pair.weight, -(both * difference), pairs.diffusion);
                    }
                    sums.end_row(c.fixed.grid.is_fluid(other));
                }
                let [mx_bar, my_bar] = sums.flux();
                c.put(field::MX_BAR, j, at, mx_bar);
                c.put(field::MY_BAR, j, at, my_bar);
                if c.fixed.grid.is_fluid(j) {
                    c.put(field::GX_BAR, j, at, sums.inside[0]);
                    c.put(field::GY_BAR, j, at, sums.inside[1]);
                    c.put(field::T_BAR, j, at, get(field::T_BAR) + t_bar);
                    let through_density = L::splat(n.compressibility) * b * half * advected / rho;
                    let p_bar = c.of_state::<L>(self.next_bar, row::P, j, at) + sums.p + through_density;
                    c.put(field::P_BAR, j, at, p_bar);
                } else {
                    c.put(field::T_BAR, j, at, t_bar);
                }
                if METRIC {
                    let [mut d_bar, s_bar] = sums.metric(&own);
                    let heat = e * conducted - b * half * advected;
                    d_bar = d_bar - (a * mass + heat) / own.d;
                    metric.add(L::splat(R::of(c.fixed.eta(j))), d_bar, s_bar);
                }
            }
            for j in 0..c.rows() {
                let own = End::<L>::own(c, FLUX, j, here);
                let get = |field| c.get::<L>(field, j, here);
                let (rho, bar) = (c.density(own.p), flux_bar::<R, L>(c, j, at));
                let (u, v) = (get(field::KICKED_U), get(field::KICKED_V));
                let (of_u, of_v) = (row::U, row::V);
                let u_bar = c.of_state::<L>(self.next_bar, of_u, j, at) + rho * (own.d * bar[0] - own.s * bar[1]);
                let v_bar = rho.mul_add(bar[1], c.of_state::<L>(self.next_bar, of_v, j, at));
                let over = dt / (rho * own.d);
                c.put(field::BAR_U, j, at, over * u_bar);
                c.put(field::BAR_V, j, at, over * v_bar);
                c.put(field::U_BAR, j, at, u_bar);
                c.put(field::V_BAR, j, at, v_bar);
                // The kick is divided by rho D.
                let kick = u_bar * (u - get(field::U) - L::splat(n.dt * n.body_force)) + v_bar * (v - get(field::V));
                let rho_bar = own.d * u * bar[0] + (v - own.s * u) * bar[1] - kick / rho;
                c.put(field::P_BAR, j, at, L::splat(n.compressibility).mul_add(rho_bar, get(field::P_BAR)));
                if METRIC {
                    let d_bar = rho * u * bar[0] - kick / own.d;
                    metric.add(L::splat(R::of(c.fixed.eta(j))), d_bar, -(rho * u * bar[1]));
                }
            }
            for wall in WALLS {
                let (near, conormal) =
                    ghosts::temperature_bar(c.ghost_rows::<L>(field::T_BAR, wall, at), hot::<R, L>(c, wall, at));
                for (k, bar) in near.into_iter().enumerate() {
                    let j = c.near(wall, k);
                    c.put(field::T_BAR, j, at, c.get::<L>(field::T_BAR, j, here) + bar);
                }
                let conormal = conormal * L::splat(R::of(wall.inward()));
                c.put_line(line::ALONG[wall as usize], at, conormal * c.line(line::LEAN[wall as usize], here));
                if METRIC {
                    let there = |row: usize, k: usize| c.get::<L>(field::T, c.near(wall, row), here + k as isize - 1);
                    let [first, second] = ghosts::ON_WALL.map(|weight| L::splat(R::of(weight)));
                    let sides = array(|k| first.mul_add(there(0, k), second * there(1, k)));
                    c.put_line(line::LEAN_BAR[wall as usize], at, conormal * along(c, wall, here, sides));
                }
            }
            if METRIC {
                metric.put(c, 0, at);
            }
        }
    }
}

/// From the kicked velocities to those of the state.
struct PullBack<'a, R: Real, const METRIC: bool> {
    context: &'a Context<'a, R>,
    state_bar: Own<'a, R>,
}

impl<R: Real, const METRIC: bool> RowKernel<R> for PullBack<'_, R, METRIC> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let n = &c.constants;
        let half = L::splat(R::of(0.5));
        let viscosity = L::splat(n.viscosity);
        let lightness = L::splat(n.lightness);
        const FLUX: [usize; 2] = [field::MX, field::MY];
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let mut metric = Metric::<L>::zero();
            for j in c.fixed.grid.all_rows() {
                let own = End::<L>::own(c, FLUX, j, here);
                let get = |field| c.get::<L>(field, j, here);
                let (u, v, a, b) = (get(field::U), get(field::V), get(field::BAR_U), get(field::BAR_V));
                let mut sums = Sums::<L>::zero();
                let zero = L::zero();
                let (mut u_bar, mut v_bar, mut pushed, mut gy_v) = (zero, zero, zero, zero);
                let (mut d_bar, mut s_bar) = (zero, zero);
                for other in c.fixed.grid.reach_of(j) {
                    let pairs = Pairs::new(c, &own, FLUX, j, other, here);
                    for i in 0..WIDTH {
                        let pair = pairs.pair(c, &own, i);
                        let there = |field| c.get::<L>(field, other, pair.column);
                        let (a_there, b_there) = (there(field::BAR_U), there(field::BAR_V));
                        let (du, dv) = (there(field::U) - u, there(field::V) - v);
                        let (both_a, both_b) = (half * (a + a_there), half * (b + b_there));
                        let flux_bar = -(both_a.mul_add(du, both_b * dv));
                        let factor = viscosity * pair.omega;
                        let (spread_a, spread_b) = (a - a_there, b - b_there);
                        u_bar = pair.flux.mul_add(both_a, u_bar) - factor * spread_a;
                        v_bar = pair.flux.mul_add(both_b, v_bar) - factor * spread_b;
                        pushed = both_a.mul_add(pair.push, pushed);
                        if METRIC {
                            let by_metric = both_a * (own.p - pair.p);
                            d_bar = L::splat(pair.weight.gx).mul_add(by_metric, d_bar);
                            s_bar = (-L::splat(pair.weight.gy)).mul_add(by_metric, s_bar);
                        }
                        gy_v = L::splat(pair.weight.gy).mul_add(b_there, gy_v);
                        let z = viscosity * spread_a.mul_add(du, spread_b * dv);
                        sums.add::<METRIC>(pair.weight, flux_bar, pairs.diffusion, z);
                    }
                    sums.end_row(c.fixed.grid.is_fluid(other));
                }
                let [mx_bar, my_bar] = sums.flux();
                c.put(field::MX_BAR, j, at, mx_bar);
                c.put(field::MY_BAR, j, at, my_bar);
                let by_pressure = lightness * (pushed + gy_v);
                let (mut p_bar, mut u_total, mut v_total) = (sums.p + by_pressure, u_bar, v_bar);
                if c.fixed.grid.is_fluid(j) {
                    p_bar += get(field::P_BAR);
                    u_total += get(field::U_BAR);
                    v_total += get(field::V_BAR);
                    c.put(field::GX_BAR, j, at, get(field::GX_BAR) + sums.inside[0]);
                    c.put(field::GY_BAR, j, at, get(field::GY_BAR) + sums.inside[1]);
                }
                c.put(field::P_BAR, j, at, p_bar);
                c.put(field::U_BAR, j, at, u_total);
                c.put(field::V_BAR, j, at, v_total);
                if METRIC {
                    let [by_d, by_s] = sums.metric(&own);
                    let eta = L::splat(R::of(c.fixed.eta(j)));
                    metric.add(eta, lightness.mul_add(d_bar, by_d), lightness.mul_add(s_bar, by_s));
                }
            }
            for j in 0..c.rows() {
                let own = End::<L>::own(c, FLUX, j, here);
                let get = |field| c.get::<L>(field, j, here);
                let (rho, bar) = (c.density(own.p), flux_bar::<R, L>(c, j, at));
                let (u, v) = (get(field::U), get(field::V));
                let mut u_bar = get(field::U_BAR) + rho * (own.d * bar[0] - own.s * bar[1]);
                let mut v_bar = rho.mul_add(bar[1], get(field::V_BAR));
                for wall in WALLS {
                    for k in 0..REACH {
                        if j == c.near(wall, k) {
                            u_bar += ghosts::parabola_bar(c.ghost_rows::<L>(field::U_BAR, wall, at))[k];
                            v_bar += ghosts::parabola_bar(c.ghost_rows::<L>(field::V_BAR, wall, at))[k];
                        }
                    }
                }
                c.to_state(&self.state_bar, row::U, j, at, u_bar);
                c.to_state(&self.state_bar, row::V, j, at, v_bar);
                let rho_bar = own.d * u * bar[0] + (v - own.s * u) * bar[1];
                c.put(field::P_BAR, j, at, L::splat(n.compressibility).mul_add(rho_bar, get(field::P_BAR)));
                if METRIC {
                    metric.add(L::splat(R::of(c.fixed.eta(j))), rho * u * bar[0], -(rho * u * bar[1]));
                }
            }
            if METRIC {
                metric.put(c, 1, at);
            }
        }
    }
}

/// Through the gradient of the density and the ghosts to pressure and temperature.
struct Finish<'a, R: Real> {
    context: &'a Context<'a, R>,
    state_bar: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for Finish<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let diffusion = L::splat(c.constants.diffusion);
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            for j in c.fixed.grid.all_rows() {
                let mut sum = L::zero();
                for other in c.fixed.grid.reach_of(j).filter(|&other| c.fixed.grid.is_fluid(other)) {
                    let weights = c.weights(j, other);
                    for i in 0..WIDTH {
                        let column = here + i as isize - REACH as isize;
                        let there = |field| c.get::<L>(field, other, column);
                        sum = L::splat(weights[i].gx).mul_add(there(field::GX_BAR), sum);
                        sum = L::splat(weights[i].gy).mul_add(there(field::GY_BAR), sum);
                    }
                }
                c.put(field::P_BAR, j, at, c.get::<L>(field::P_BAR, j, here) - diffusion * sum);
            }
            for j in 0..c.rows() {
                let mut p_bar = c.get::<L>(field::P_BAR, j, here);
                let mut t_bar = c.get::<L>(field::T_BAR, j, here);
                for (wall, along_line) in WALLS.into_iter().zip(line::ALONG) {
                    for k in 0..REACH {
                        if j == c.near(wall, k) {
                            p_bar += ghosts::line_bar(c.ghost_rows::<L>(field::P_BAR, wall, at))[k];
                        }
                    }
                    for row in (0..REACH).filter(|&row| j == c.near(wall, row)) {
                        let on_wall = L::splat(R::of(ghosts::ON_WALL[row]));
                        for (k, weights) in c.fixed.ghosts.along[wall as usize].iter().enumerate() {
                            // The column that sees this one as its k-th.
                            let other = here + 1 - k as isize;
                            let weight = on_wall * c.constant::<L>(weights, other);
                            t_bar = weight.mul_add(c.line(along_line, other), t_bar);
                        }
                    }
                }
                c.to_state(&self.state_bar, row::P, j, at, p_bar);
                c.to_state(&self.state_bar, row::T, j, at, t_bar);
            }
        }
    }
}

impl<R: Real> Fixed<R> {
    /// The adjoint of a step: the cotangent of `state` `[6, N]` from that of the next one. Positions pass through, and the
    /// heights of boundary points get what the metric gets.
    pub fn backward(&self, state: &[R], next_bar: &[R], state_bar: &mut [R], work: &mut Work<R>) {
        self.pull::<true>(state, next_bar, state_bar, work);
    }

    /// The same for walls that are constants: their heights get nothing.
    pub fn backward_of_flow(&self, state: &[R], next_bar: &[R], state_bar: &mut [R], work: &mut Work<R>) {
        self.pull::<false>(state, next_bar, state_bar, work);
    }

    fn pull<const METRIC: bool>(&self, state: &[R], next_bar: &[R], state_bar: &mut [R], work: &mut Work<R>) {
        let (n, fluid) = (self.particles(), self.fluid_particles());
        let positions = row::U * n;
        state_bar[..positions].copy_from_slice(&next_bar[..positions]);
        for row in row::U..row::COUNT {
            state_bar[row * n + fluid..(row + 1) * n].fill(R::default());
        }
        self.metric(state, work);
        {
            let context = self.kicked(state, work, None, Some(next_bar));
            let units = self.grid.units();
            run(&Pull::<R, METRIC> { context: &context, next_bar }, units);
            if let Some(drive) = self.channel.drive {
                self.push_bar(&context, drive);
            }
            run(&PullBack::<R, METRIC> { context: &context, state_bar: Own::new(state_bar) }, units);
            run(&Finish { context: &context, state_bar: Own::new(state_bar) }, units);
        }
        if METRIC {
            let walls = row::Y * n + fluid..(row::Y + 1) * n;
            self.metric_bar(work, &mut state_bar[walls]);
        }
    }
}
