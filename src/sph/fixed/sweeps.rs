//! The forward sweeps of a step: `Spread`, `Flux`, `Kick`, `Advance`.
//!
//! A row of a sweep is a unit of columns, from wall to wall. Sums are gathered, and every vector has its own columns whoever
//! computes it: the same bits for any number of threads.

use super::ghosts;
use super::grid::run;
use super::grid::{store_part, Fields, REACH};
use super::lattice::{row, Fixed};
use super::stencil::{Weight, WIDTH};
use super::work::{field, line, Work};
use crate::numerics::lanes::{array, lanes_of_rows, Lanes, Real, WIDEST};
use crate::numerics::sweep::RowKernel;
use crate::sph::own::Own;
use std::ops::{Deref, Range};

/// What every sweep of a step reads.
pub(super) struct Context<'a, R: Real> {
    pub fixed: &'a Fixed<R>,
    pub fields: Fields<'a, R>,
    pub constants: Constants<R>,
}

/// The channel's numbers as the formulas have them.
#[derive(Clone, Copy)]
pub(super) struct Constants<R> {
    pub dt: R,
    pub viscosity: R,
    pub diffusivity: R,
    pub body_force: R,
    /// Of p in rho = 1 + compressibility p.
    pub compressibility: R,
    /// density c^2.
    pub stiffness: R,
    /// 1 / density.
    pub lightness: R,
    /// delta c dx compressibility: of grad p in the mass flux, and of Morris' weights on differences of p.
    pub diffusion: R,
}

impl<'a, R: Real> Context<'a, R> {
    pub fn new(fixed: &'a Fixed<R>, work: &'a mut Work<R>) -> Self {
        let c = &fixed.channel;
        let stiffness = c.density * c.sound_speed * c.sound_speed;
        let constants = Constants {
            dt: R::of(c.dt),
            viscosity: R::of(c.viscosity),
            diffusivity: R::of(c.diffusivity),
            body_force: R::of(c.body_force),
            compressibility: R::of(1.0 / stiffness),
            stiffness: R::of(stiffness),
            lightness: R::of(1.0 / c.density),
            diffusion: R::of(c.delta * c.sound_speed * c.spacing / stiffness),
        };
        Self { fixed, fields: work.fields(fixed.grid), constants }
    }

    pub fn rows(&self) -> isize {
        self.fixed.grid.rows as isize
    }

    /// The first column of each vector of some units. (No callback: a closure that is too large to be inlined is compiled
    /// without the sweep's instruction set.)
    #[inline(always)]
    pub fn vectors<L: Lanes<Real = R>>(&self, units: Range<usize>) -> std::iter::StepBy<Range<usize>> {
        self.fixed.grid.columns_of(units).step_by(L::COUNT)
    }

    /// Fluid particles' numbers of a row `[N]` of a state, zeros behind the last column.
    #[inline(always)]
    pub fn of_state<L: Lanes<Real = R>>(&self, state: &[R], row: usize, j: isize, column: usize) -> L {
        let nx = self.fixed.grid.columns;
        let from = row * self.fixed.particles() + j as usize * nx;
        L::load_part(&state[from + column..from + nx])
    }

    /// Writes fluid particles' numbers in a row `[N]` of a state, in a unit's own columns.
    #[inline(always)]
    pub fn to_state<L: Lanes<Real = R>>(&self, state: &Own<'_, R>, row: usize, j: isize, column: usize, value: L) {
        let nx = self.fixed.grid.columns;
        let from = row * self.fixed.particles() + j as usize * nx;
        store_part(state, from + column, value, nx - column);
    }

    /// A constant line of the ghosts.
    #[inline(always)]
    pub fn constant<L: Lanes<Real = R>>(&self, line: &[R], column: isize) -> L {
        L::load_part(&line[self.fixed.grid.column(column)..])
    }

    /// Stores ghosts, those next to the wall first: below the bottom or above the top wall.
    #[inline(always)]
    pub fn put_ghosts<L: Lanes<Real = R>>(&self, field: usize, wall: Wall, column: usize, ghosts: [L; REACH]) {
        for (k, ghost) in ghosts.into_iter().enumerate() {
            self.put(field, self.ghost(wall, k), column, ghost);
        }
    }

    /// The k-th row of ghosts beyond a wall.
    #[inline(always)]
    pub fn ghost(&self, wall: Wall, k: usize) -> isize {
        match wall {
            Wall::Bottom => -1 - k as isize,
            Wall::Top => self.rows() + k as isize,
        }
    }

    /// The k-th row of fluid from a wall.
    #[inline(always)]
    pub fn near(&self, wall: Wall, k: usize) -> isize {
        match wall {
            Wall::Bottom => k as isize,
            Wall::Top => self.rows() - 1 - k as isize,
        }
    }

    /// The two rows of fluid next to a wall.
    #[inline(always)]
    pub fn near_rows<L: Lanes<Real = R>>(&self, field: usize, wall: Wall, column: usize) -> [L; 2] {
        array(|k| self.get(field, self.near(wall, k), column as isize))
    }

    /// The two rows of ghosts beyond a wall.
    #[inline(always)]
    pub fn ghost_rows<L: Lanes<Real = R>>(&self, field: usize, wall: Wall, column: usize) -> [L; 2] {
        array(|k| self.get(field, self.ghost(wall, k), column as isize))
    }

    /// rho of a pressure.
    #[inline(always)]
    pub fn density<L: Lanes<Real = R>>(&self, p: L) -> L {
        L::splat(self.constants.compressibility).mul_add(p, L::splat(R::of(1.0)))
    }

    #[inline(always)]
    pub fn weights(&self, j: isize, other: isize) -> &[Weight<R>; WIDTH] {
        &self.fixed.stencil[(other - j + REACH as isize) as usize]
    }
}

impl<'a, R: Real> Deref for Context<'a, R> {
    type Target = Fields<'a, R>;

    #[inline(always)]
    fn deref(&self) -> &Fields<'a, R> {
        &self.fields
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Wall {
    Bottom,
    Top,
}

pub(super) const WALLS: [Wall; 2] = [Wall::Bottom, Wall::Top];

impl Wall {
    /// Which way eta grows, seen from the wall.
    pub fn inward(self) -> f64 {
        match self {
            Wall::Bottom => 1.0,
            Wall::Top => -1.0,
        }
    }
}

/// A temperature's dx df/dxi along a wall from its values on the wall in three columns.
#[inline(always)]
pub(super) fn along<R: Real, L: Lanes<Real = R>>(context: &Context<'_, R>, wall: Wall, at: isize, f: [L; 3]) -> L {
    let weights = &context.fixed.ghosts.along[wall as usize];
    let w = |k: usize| context.constant::<L>(&weights[k], at);
    w(0).mul_add(f[0], w(1).mul_add(f[1], w(2) * f[2]))
}

/// The hot share of a wall.
#[inline(always)]
pub(super) fn hot<R: Real, L: Lanes<Real = R>>(context: &Context<'_, R>, wall: Wall, at: usize) -> L {
    match wall {
        Wall::Bottom => context.constant(&context.fixed.ghosts.hot, at as isize),
        Wall::Top => L::zero(),
    }
}

/// A and B of a fluid row, and T_bar as it is before the inlet and the outlet are set.
#[inline(always)]
fn prepare<R: Real, L: Lanes<Real = R>>(c: &Context<'_, R>, next_bar: &[R], j: isize, at: usize, rho: L, d: L) {
    let n = &c.constants;
    let over = L::splat(n.dt) / d;
    let p_bar = c.of_state::<L>(next_bar, row::P, j, at);
    c.put(field::BAR_P, j, at, -(L::splat(n.stiffness) * over * p_bar));
    let mut t_bar = c.of_state::<L>(next_bar, row::T, j, at) * L::load_part(&c.fixed.open[at..]);
    let outlet = c.fixed.outlet;
    if at + L::COUNT > outlet {
        let mut lanes = t_bar.numbers();
        for (k, lane) in lanes[..L::COUNT].iter_mut().enumerate() {
            if at + k == outlet {
                let from = row::T * c.fixed.particles() + j as usize * c.fixed.grid.columns;
                *lane = next_bar[from + outlet..from + c.fixed.grid.columns].iter().copied().sum::<R>()
                    * c.fixed.open[outlet];
            } else if at + k > outlet {
                *lane = R::default();
            }
        }
        t_bar = L::load_part(&lanes);
    }
    c.put(field::T_BAR, j, at, t_bar);
    c.put(field::BAR_T, j, at, over * t_bar / rho);
}

/// State -> fields p, u, v, T with ghosts and copies.
struct Spread<'a, R: Real> {
    context: &'a Context<'a, R>,
    state: &'a [R],
}

impl<R: Real> RowKernel<R> for Spread<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let nx = c.fixed.grid.columns;
        for at in c.vectors::<L>(units) {
            for (to, row) in [(field::P, row::P), (field::U, row::U), (field::V, row::V), (field::T, row::T)] {
                for j in 0..c.rows() {
                    c.put(to, j, at, c.of_state::<L>(self.state, row, j, at));
                }
            }
            for wall in WALLS {
                c.put_ghosts::<L>(field::P, wall, at, ghosts::line(c.near_rows(field::P, wall, at)));
                for field in [field::U, field::V] {
                    c.put_ghosts::<L>(field, wall, at, ghosts::parabola(c.near_rows(field, wall, at)));
                }
                // The columns at either side may be another unit's, so they come from the state.
                let rows: [&[R]; 2] = array(|k| {
                    let from = row::T * c.fixed.particles() + c.near(wall, k) as usize * nx;
                    &self.state[from..from + nx]
                });
                let [first, second] = ghosts::ON_WALL.map(R::of);
                let mut around = [R::default(); WIDEST + 2];
                for (k, value) in around[..L::COUNT + 2].iter_mut().enumerate() {
                    let column = at + k + nx - 1;
                    let column = if column < 2 * nx { column % nx } else { 0 };
                    *value = first * rows[0][column] + second * rows[1][column];
                }
                // SAFETY: two numbers more than a vector are there.
                let sides = array(|k| unsafe { L::load(around.as_ptr().add(k)) });
                let slope = along(c, wall, at as isize, sides) * c.line(line::LEAN[wall as usize], at as isize);
                let conormal = L::splat(R::of(wall.inward())) * slope;
                let given = L::splat(R::of(c.fixed.channel.hot_excess));
                let near = c.near_rows::<L>(field::T, wall, at);
                c.put_ghosts(field::T, wall, at, ghosts::temperature(near, hot(c, wall, at), given, conormal));
            }
        }
    }
}

/// Mass flux at a particle: D rho u, rho (v - S u).
#[inline(always)]
pub(super) fn mass_flux<L: Lanes>(d: L, s: L, rho: L, u: L, v: L) -> [L; 2] {
    [d * rho * u, rho * (v - s * u)]
}

/// p, u, v -> delta c dx grad rho, and the mass flux before the kick.
struct Flux<'a, R: Real>(&'a Context<'a, R>);

impl<R: Real> RowKernel<R> for Flux<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.0;
        let diffusion = L::splat(c.constants.diffusion);
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let d = c.line::<L>(line::D, here);
            for j in 0..c.rows() {
                let (mut gx, mut gy) = (L::zero(), L::zero());
                for other in c.fixed.grid.reach_of(j) {
                    let weights = c.weights(j, other);
                    for i in 0..WIDTH {
                        let p = c.get::<L>(field::P, other, here + i as isize - REACH as isize);
                        gx = L::splat(weights[i].gx).mul_add(p, gx);
                        gy = L::splat(weights[i].gy).mul_add(p, gy);
                    }
                }
                (gx, gy) = (gx * diffusion, gy * diffusion);
                let own = |field| c.get::<L>(field, j, here);
                let m = mass_flux(d, own(field::S), c.density(own(field::P)), own(field::U), own(field::V));
                c.put(field::GX, j, at, gx);
                c.put(field::GY, j, at, gy);
                put_flux(c, [field::MX, field::MY], j, at, m, [gx, gy]);
            }
        }
    }
}

/// Stores a mass flux of a fluid row, with its diffusion, and the ghosts made of it.
#[inline(always)]
pub(super) fn put_flux<R: Real, L: Lanes<Real = R>>(
    c: &Context<'_, R>,
    fields: [usize; 2],
    j: isize,
    at: usize,
    m: [L; 2],
    diffusion: [L; 2],
) {
    c.put(fields[0], j, at, m[0] + diffusion[0]);
    c.put(fields[1], j, at, m[1] + diffusion[1]);
    for wall in WALLS {
        // The odd ghosts are one row's each.
        for k in 0..REACH {
            if j == c.near(wall, k) {
                c.put(fields[1], c.ghost(wall, k), at, -m[1]);
            }
        }
        // The parabola's need both rows: made with the second one, without the diffusion that the first was stored with.
        let (first, second) = (c.near(wall, 0), c.near(wall, 1));
        let later = first.max(second);
        if j == later {
            let earlier = first.min(second);
            let stored = c.get::<L>(fields[0], earlier, at as isize) - c.get::<L>(field::GX, earlier, at as isize);
            let near = if first == later { [m[0], stored] } else { [stored, m[0]] };
            c.put_ghosts(fields[0], wall, at, ghosts::parabola(near));
        }
    }
}

/// One end of the pairs of a particle: its mass flux with and without diffusion, its metric.
#[derive(Clone, Copy)]
pub(super) struct End<L> {
    pub m: [L; 2],
    /// For pairs with ghosts, which nothing diffuses to.
    pub bare: [L; 2],
    pub p: L,
    pub d: L,
    pub s: L,
    pub k: L,
}

impl<L: Lanes> End<L> {
    /// A fluid particle.
    #[inline(always)]
    pub fn own(c: &Context<'_, L::Real>, flux: [usize; 2], j: isize, at: isize) -> Self {
        let get = |field| c.get::<L>(field, j, at);
        let m = [get(flux[0]), get(flux[1])];
        // Ghosts have no diffusion in what is stored.
        let bare = match c.fixed.grid.is_fluid(j) {
            true => [m[0] - get(field::GX), m[1] - get(field::GY)],
            false => m,
        };
        Self { m, bare, p: get(field::P), d: c.line(line::D, at), s: get(field::S), k: get(field::K) }
    }
}

/// The pairs of a particle with one other row: who diffuses, and the weights.
pub(super) struct Pairs<'a, L: Lanes> {
    weights: &'a [Weight<L::Real>; WIDTH],
    flux: [usize; 2],
    m: [L; 2],
    /// Diffusion of p, 0 where one of both is a ghost.
    pub diffusion: L,
    /// The row's particles are ghosts: what is stored of their neighbours has diffusion that these pairs do not.
    of_ghost: bool,
    other: isize,
    here: isize,
}

/// What a pair is made of.
pub(super) struct Pair<'a, L: Lanes> {
    pub weight: &'a Weight<L::Real>,
    /// M_ab.
    pub flux: L,
    /// M_ab with the weights for what the flow carries.
    pub carrying: L,
    /// Omega_ab.
    pub omega: L,
    /// g_x (D_a + D_b) - g_y (S_a + S_b).
    pub push: L,
    pub p: L,
    /// Of the other particle.
    pub column: isize,
}

impl<'a, L: Lanes> Pairs<'a, L> {
    #[inline(always)]
    pub fn new(
        c: &'a Context<'_, L::Real>,
        own: &End<L>,
        flux: [usize; 2],
        j: isize,
        other: isize,
        here: isize,
    ) -> Self {
        let grid = &c.fixed.grid;
        let inside = grid.is_fluid(other) && grid.is_fluid(j);
        Self {
            weights: c.weights(j, other),
            flux,
            m: if inside { own.m } else { own.bare },
            diffusion: if inside { L::splat(c.constants.diffusion) } else { L::zero() },
            of_ghost: !grid.is_fluid(j),
            other,
            here,
        }
    }

    /// The pair with the i-th column of the stencil.
    #[inline(always)]
    pub fn pair(&self, c: &Context<'_, L::Real>, own: &End<L>, i: usize) -> Pair<'a, L> {
        let weight = &self.weights[i];
        let column = self.here + i as isize - REACH as isize;
        let get = |field| c.get::<L>(field, self.other, column);
        let (p, d, s, k) = (get(field::P), c.line::<L>(line::D, column), get(field::S), get(field::K));
        let (mut mx, mut my) = (self.m[0] + get(self.flux[0]), self.m[1] + get(self.flux[1]));
        if self.of_ghost {
            (mx, my) = (mx - get(field::GX), my - get(field::GY));
        }
        let diffused = L::splat(weight.laplacian) * self.diffusion * (own.p - p);
        let flux = L::splat(weight.gx).mul_add(mx, L::splat(weight.gy).mul_add(my, diffused));
        let carrying = L::splat(weight.cx).mul_add(mx, L::splat(weight.cy).mul_add(my, diffused));
        let (d, s, k) = (own.d + d, own.s + s, own.k + k);
        let omega = L::splat(weight.lxx).mul_add(d, L::splat(weight.lyy).mul_add(k, -(L::splat(weight.lxy) * s)));
        let push = L::splat(weight.gx).mul_add(d, -(L::splat(weight.gy) * s));
        Pair { weight, flux, carrying, omega, push, p, column }
    }
}

/// u, v -> the velocities behind the kick and their mass flux.
struct Kick<'a, R: Real> {
    context: &'a Context<'a, R>,
    /// Where the velocities go: the next state.
    next: Option<&'a Own<'a, R>>,
    /// Or fields, with what the adjoint wants of the next state's cotangent.
    bar: Option<&'a [R]>,
}

impl<R: Real> RowKernel<R> for Kick<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let n = &c.constants;
        let (viscosity, half, dt) = (L::splat(n.viscosity), L::splat(R::of(-0.5)), L::splat(n.dt));
        let lightness = L::splat(n.lightness);
        const FLUX: [usize; 2] = [field::MX, field::MY];
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            for j in 0..c.rows() {
                let own = End::<L>::own(c, FLUX, j, here);
                let (u, v) = (c.get::<L>(field::U, j, here), c.get::<L>(field::V, j, here));
                // Sums of pairs, and the pressure's.
                let (mut su, mut sv, mut pu, mut pv) = (L::zero(), L::zero(), L::zero(), L::zero());
                for other in c.fixed.grid.reach_of(j) {
                    let pairs = Pairs::new(c, &own, FLUX, j, other, here);
                    for i in 0..WIDTH {
                        let pair = pairs.pair(c, &own, i);
                        let factor = pair.omega.mul_add(viscosity, pair.flux * half);
                        su = factor.mul_add(c.get::<L>(field::U, other, pair.column) - u, su);
                        sv = factor.mul_add(c.get::<L>(field::V, other, pair.column) - v, sv);
                        pu = (own.p - pair.p).mul_add(pair.push, pu);
                        pv = pair.p.mul_add(-L::splat(pair.weight.gy), pv);
                    }
                }
                let rho = c.density(own.p);
                let over = dt / (rho * own.d);
                let u = (lightness * -half).mul_add(pu, su).mul_add(over, L::splat(n.dt * n.body_force) + u);
                let v = lightness.mul_add(pv, sv).mul_add(over, v);
                if let Some(next) = &self.next {
                    c.to_state(next, row::U, j, at, u);
                    c.to_state(next, row::V, j, at, v);
                }
                if self.bar.is_some() || c.fixed.channel.drive.is_some() {
                    c.put(field::KICKED_U, j, at, u);
                    c.put(field::KICKED_V, j, at, v);
                }
                if let Some(bar) = self.bar {
                    prepare(c, bar, j, at, rho, own.d);
                }
                let m = mass_flux(own.d, own.s, rho, u, v);
                let diffusion = [c.get::<L>(field::GX, j, here), c.get::<L>(field::GY, j, here)];
                put_flux(c, [field::KICKED_MX, field::KICKED_MY], j, at, m, diffusion);
            }
        }
    }
}

/// The flux behind the kick -> pressure and temperature.
struct Advance<'a, R: Real> {
    context: &'a Context<'a, R>,
    next: Own<'a, R>,
}

impl<R: Real> RowKernel<R> for Advance<'_, R> {
    const MOST_LANES: usize = lanes_of_rows(2);

    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, units: Range<usize>) {
        let c = self.context;
        let n = &c.constants;
        let (half, dt) = (L::splat(R::of(-0.5)), L::splat(n.dt));
        const FLUX: [usize; 2] = [field::KICKED_MX, field::KICKED_MY];
        let (nx, outlet) = (c.fixed.grid.columns, c.fixed.outlet);
        for at in c.vectors::<L>(units) {
            let here = at as isize;
            let open = L::load_part(&c.fixed.open[at..]);
            for j in 0..c.rows() {
                let own = End::<L>::own(c, FLUX, j, here);
                let t = c.get::<L>(field::T, j, here);
                let rho = c.density(own.p);
                let conduction = L::splat(n.diffusivity) * rho;
                let (mut mass, mut heat) = (L::zero(), L::zero());
                for other in c.fixed.grid.reach_of(j) {
                    let pairs = Pairs::new(c, &own, FLUX, j, other, here);
                    for i in 0..WIDTH {
                        let pair = pairs.pair(c, &own, i);
                        mass += pair.flux;
                        let factor = pair.omega.mul_add(conduction, pair.carrying * half);
                        heat = factor.mul_add(c.get::<L>(field::T, other, pair.column) - t, heat);
                    }
                }
                let over = dt / own.d;
                let p = (mass * over).mul_add(-L::splat(n.stiffness), own.p);
                let t = (heat * (over / rho)).mul_add(open, t * open);
                c.to_state(&self.next, row::P, j, at, p);
                let from = row::T * c.fixed.particles() + j as usize * nx;
                if at <= outlet {
                    store_part(&self.next, from + at, t, outlet + 1 - at);
                    if outlet < at + L::COUNT {
                        // The columns behind the outlet are its unit's.
                        (outlet + 1..nx).for_each(|i| self.next.set(from + i, self.next.get(from + outlet)));
                    }
                }
            }
        }
    }
}

impl<R: Real> Fixed<R> {
    /// One step: state `[6, N]` -> next `[6, N]`; returns the body force that drove it.
    ///
    /// Temperatures at the inlet and behind the outlet are set at the step's end, so a first state should have them.
    pub fn forward(&self, state: &[R], next: &mut [R], work: &mut Work<R>) -> R {
        let (n, fluid) = (self.particles(), self.fluid_particles());
        let positions = row::U * n;
        next[..positions].copy_from_slice(&state[..positions]);
        for row in row::U..row::COUNT {
            next[row * n + fluid..(row + 1) * n].fill(R::default());
        }
        let next = Own::new(next);
        self.metric(state, work);
        let context = self.kicked(state, work, Some(&next), None);
        run(&Advance { context: &context, next }, self.grid.units());
        context.constants.body_force
    }

    /// The sweeps up to the kick, which a step and its adjoint share.
    pub(super) fn kicked<'a>(
        &'a self,
        state: &'a [R],
        work: &'a mut Work<R>,
        next: Option<&Own<'_, R>>,
        bar: Option<&[R]>,
    ) -> Context<'a, R> {
        let mut context = Context::new(self, work);
        let units = self.grid.units();
        run(&Spread { context: &context, state }, units);
        run(&Flux(&context), units);
        run(&Kick { context: &context, next, bar }, units);
        if let Some(drive) = self.channel.drive {
            self.push(&mut context, drive, next);
        }
        context
    }
}
