//! The lattice, the steady flow on it, and its adjoint.

use crate::numerics::lanes::WIDEST;
use crate::numerics::sparse_lu::Order;
use crate::sph::cloud::equations::{damping, Warmth};
use crate::sph::cloud::fit::{Coefficients, Stencils, COEFFICIENTS_3D as C};
use crate::sph::cloud::fits::Fits;
use crate::sph::cloud::nearest::{Nearest, Region};
use crate::sph::cloud::space::equations::{
    Bar, Condition, Derivatives, End, Equations, Exchange, Motion, State, FLOW, TEMPERATURE,
};
use crate::sph::cloud::space::steady::{FlowRate, Solver};
use crate::sph::cloud::steady::{Held, NoSteadyState};
use crate::sph::fixed::channel::between_edges;
use std::sync::Arc;

/// Rows of a state `[8, N]`. Points of the lower wall, which is at rest, have their unit normal in the rows of the velocity.
pub mod row {
    pub const X: usize = 0;
    pub const Y: usize = 1;
    pub const Z: usize = 2;
    pub const U: usize = 3;
    pub const P: usize = 6;
    pub const T: usize = 7;
    pub const COUNT: usize = 8;
}

/// How far the fits see, in squares of the spacing: whole shells of the lattice, 32 neighbours inside, 49 on walls, where all are on
/// one side, and 123 of the slopes by which heat passes through them. (A fit of third order to 75 is right on a flat lattice. There one of them
/// alone is three rows away, and its weight is small: over a wall that is bent a little some slopes have coefficients of 30 instead of 1.)
const INSIDE: f64 = 4.0;
const ON_WALL: f64 = 6.0;
const ACROSS_WALL: f64 = 13.0;

/// Where an edge of the hot section acts on the lattice, in spacings from a column towards the hot side, if that column is as cold as those
/// before it, and if it is as hot as those behind it. In between it is linear in how hot the column is, but for 0.004 spacings.
///
/// It follows from Laplace's equation in a half disc alone, as on the [lattice of the plane](crate::sph::fixed::channel::EDGE): the values
/// r^(1/2) sin(theta/2) around it, given on the arc, hold inside too. (The test `an_edge_acts_where_it_is_in_conduction` measures it in a channel.)
const EDGE: [f64; 2] = [0.7434, -0.2565];

/// Up to so many particles the matrix of the flow is factorised; of more GMRES is faster.
const FACTORISED: usize = 7000;

/// The settings of a channel, in the scene's units.
#[derive(Debug, Clone)]
pub struct Channel {
    /// Numbers of spacings along x, y and z.
    pub cells: [usize; 3],
    pub spacing: f64,
    /// x of the first column; z of the first layer is half a spacing.
    pub first_x: f64,
    pub density: f64,
    /// Kinematic viscosity and thermal diffusivity.
    pub viscosity: f64,
    pub diffusivity: f64,
    /// Acceleration along x; about that which a drive will find, if something is held.
    pub force: f64,
    pub held: Option<Held>,
    /// A typical velocity, for the pressure's damping.
    pub velocity: f64,
    /// Where the lower wall is hot, and by how much. Temperatures are those above the inlet's.
    pub hot: [f64; 2],
    pub hot_excess: f64,
    /// Before this x the fluid has the inlet's temperature; behind the other one that of the last column before it.
    pub inlet_below: f64,
    pub outlet_above: f64,
    pub threads: usize,
}

/// The lattice of a channel, with everything that does not depend on the wall.
#[derive(Debug)]
pub struct OverRelief {
    pub channel: Channel,
    fits: Arc<Fits<3>>,
    ends: Vec<Option<End>>,
    /// Of up to [`FACTORISED`] particles.
    order: Option<Arc<Order>>,
    /// What each row of fluid counts in an integral from wall to wall, see [`row_weights`].
    row_weights: Vec<f64>,
}

/// The steady flow over a wall.
struct Flow {
    position: [Vec<f64>; 3],
    operators: Coefficients<C>,
    solver: Solver,
    state: State,
    rate: Rate,
}

/// Weights of the rows between walls, `rows - 1` of them, in an integral of what is 0 on the walls: the trapezoidal rule with the
/// slopes at the ends, h^2/12 (f'(0) - f'(H)), by f' = (4 f_1 - f_2) / 2 h. Exact for parabolas, of fourth order.
pub fn row_weights(rows: usize) -> Vec<f64> {
    let mut weights = vec![1.0; rows - 1];
    for ends in [[0, 1], [rows - 2, rows - 3]] {
        weights[ends[0]] += 1.0 / 6.0;
        weights[ends[1]] -= 1.0 / 24.0;
    }
    weights
}

impl OverRelief {
    /// # Panics
    /// A lattice of fewer than five spacings along a direction, which the checks of configurations exclude.
    pub fn new(channel: Channel) -> Self {
        let [_, rows, _] = channel.cells;
        let region = channel.region();
        let places: Vec<[f64; 3]> = (0..channel.particles()).map(|i| channel.place(i)).collect();
        let (inside, dx) = (channel.inside(), channel.spacing);
        let near = Nearest::new(region, 1.5 * dx, &places);
        let lists: Vec<Vec<(f64, u32)>> = (0..places.len()).map(|i| near.of(places[i], 130, |j, _| j != i)).collect();
        let count = |i: usize, on_wall: f64| {
            let reach = dx * (if i < inside { INSIDE } else { on_wall } + 1e-3).sqrt();
            lists[i].partition_point(|found| found.0 < reach)
        };
        let stencils = |count: &dyn Fn(usize) -> usize, is_third: &dyn Fn(usize) -> bool| {
            Stencils::new(region, &places, count, is_third, |i| &lists[i]).expect("enough particles for the fits")
        };
        let has_wall = |block: usize| (block + 1) * WIDEST > inside;
        let small = stencils(&|i| if has_wall(i / WIDEST) { count(i, ON_WALL) } else { 0 }, &|_| false);
        let all = stencils(&|i| count(i, ACROSS_WALL), &|i| i >= inside);
        let slack = 1e-9 * dx;
        let end = |i: usize| {
            let (x, before) = (places[i][0], channel.before(i));
            if x < channel.inlet_below - slack {
                return Some(End::Inlet);
            }
            (x > channel.outlet_above + slack).then_some(End::Outlet(before as u32))
        };
        let ends = (0..places.len()).map(end).collect();
        // Seen from the side, across the shortest direction.
        let fits = Arc::new(Fits::with_walls(small, all, inside));
        let order = || Arc::new(Order::new(&fits.flow_matrix(FLOW), |i| [places[i][0], places[i][1]]));
        let order = (places.len() <= FACTORISED).then(order);
        Self { fits, ends, order, row_weights: row_weights(rows), channel }
    }

    pub fn particles(&self) -> usize {
        self.channel.particles()
    }

    /// The volume that each particle of the fluid counts for over a flat wall, `[inside]`.
    pub fn flat_volumes(&self) -> Vec<f64> {
        let (columns, cube) = (self.channel.columns(), self.channel.spacing.powi(3));
        (0..self.channel.inside()).map(|i| self.row_weights[i / columns] * cube).collect()
    }

    /// The flow that a state holds, or that it gives the first guess of.
    fn flow(&self, state: &[f64]) -> Flow {
        let channel = &self.channel;
        let (n, inside, columns) = (channel.particles(), channel.inside(), channel.columns());
        let field = |row: usize| state[row * n..(row + 1) * n].to_vec();
        let position: [Vec<f64>; 3] = std::array::from_fn(field);
        let operators = self.fits.coefficients(&position);
        let mut fields: [Vec<f64>; 5] = std::array::from_fn(|f| field(row::U + f));
        fields[..3].iter_mut().for_each(|u| u[inside..].fill(0.0));
        let condition = |k: usize| {
            let i = inside + k;
            let normal = match k < columns {
                true => std::array::from_fn(|d| state[(row::U + d) * n + i]),
                false => [0.0, -1.0, 0.0],
            };
            let is_hot = k < columns && channel.hot_share(k) == 1.0;
            let warmth = if is_hot { Warmth::Given(channel.hot_excess) } else { Warmth::Flux(0.0) };
            Condition { motion: Motion::Given([0.0; 3]), warmth, normal }
        };
        let (nu, h) = (channel.viscosity, channel.spacing);
        let equations = Equations {
            viscosity: nu,
            diffusivity: Some(channel.diffusivity),
            force: [channel.force, 0.0, 0.0],
            buoyancy: None,
            damping: vec![damping(nu, channel.velocity, h); n],
            spacing: vec![h; n],
            inside,
            conditions: (0..2 * columns).map(condition).collect(),
            exchange: (0..2 * columns).map(|k| channel.exchange(k)).collect(),
            ends: self.ends.clone(),
            smoothing: vec![1.0; 2 * columns],
            fits: Arc::clone(&self.fits),
        };
        let height = channel.height();
        let opening: Vec<f64> =
            (0..columns).map(|c| (position[1][inside + columns + c] - position[1][inside + c]) / height).collect();
        let length = channel.spacing * channel.cells[0] as f64;
        let weight = self.flat_volumes().iter().enumerate().map(|(i, v)| v * opening[i % columns] / length).collect();
        let rate = Rate { weight };
        let mut state = State { fields, lambda: 0.0, drive: 0.0 };
        if let Some(Held::Power { power, length }) = channel.held {
            let flow = rate.of(&state);
            // Of a first guess this is about the force that it will be.
            if flow > 0.0 {
                state.drive = power / (length * flow) - channel.force;
            }
        }
        let solver = Solver { order: self.order.clone(), ..Solver::new(equations, channel.threads) };
        Flow { position, operators, solver, state, rate }
    }

    /// Makes a state steady. Returns the number of Newton's steps and the acceleration along x.
    ///
    /// # Errors
    /// No convergence.
    pub fn settle(&self, state: &mut [f64]) -> Result<(usize, f64), NoSteadyState> {
        let (n, inside) = (self.particles(), self.channel.inside());
        let Flow { operators, mut solver, state: mut found, rate, .. } = self.flow(state);
        let held = self.channel.held.as_ref().map(|held| (held, &rate as _));
        solver.settle(&operators, &mut found, held)?;
        for (f, field) in found.fields.iter().enumerate() {
            let own = if f < 3 { inside } else { n };
            state[(row::U + f) * n..][..own].copy_from_slice(&field[..own]);
        }
        Ok((solver.counts.steps, self.channel.force + found.drive))
    }

    /// The heat that the hot wall gives to the fluid at x < `until`, by the slopes of the temperature at its points: density * temperature *
    /// volume / time.
    pub fn wall_heat(&self, state: &[f64], until: f64) -> f64 {
        let channel = &self.channel;
        let (n, inside) = (channel.particles(), channel.inside());
        let Flow { position, operators, solver, state: flow, .. } = self.flow(state);
        let of = |k: usize| {
            let (i, condition) = (inside + k, &solver.equations.conditions[k]);
            if position[0][i] >= until {
                return 0.0;
            }
            let area = channel.spacing * channel.spacing / condition.normal[1];
            let temperature = &flow.fields[TEMPERATURE];
            if let Warmth::Flux(_) = condition.warmth {
                return solver.equations.exchanged(i, temperature[i]) * area;
            }
            let slopes = operators.derivatives(&self.fits.all, i, temperature);
            -channel.diffusivity * condition.across_by(self.fits.across(), &slopes, 0.0) * area
        };
        channel.density * (0..n - inside).map(of).sum::<f64>()
    }

    /// The cotangent of the positions and normals of a steady state, given the cotangent of all of it, both `[8, N]`.
    ///
    /// # Errors
    /// A transposed system that is not solved.
    pub fn pull_back(&self, state: &[f64], state_bar: &[f64]) -> Result<Vec<f64>, NoSteadyState> {
        let channel = &self.channel;
        let (n, inside, columns) = (channel.particles(), channel.inside(), channel.columns());
        let Flow { position, operators, mut solver, state: flow, rate } = self.flow(state);
        let held = channel.held.as_ref().map(|held| (held, &rate as _));
        let mut fields: [Vec<f64>; 5] =
            std::array::from_fn(|f| state_bar[(row::U + f) * n..(row::U + f + 1) * n].to_vec());
        fields[..3].iter_mut().for_each(|u| u[inside..].fill(0.0));
        let (multipliers, heat) = solver.adjoint(&operators, &flow, &fields, 0.0, held)?;
        let against = |all: &[f64]| all.iter().map(|x| -x).collect::<Vec<f64>>();
        let derivatives = solver.equations.derivatives(&operators, &flow);
        let mut bar = Bar::new(n, 2 * columns);
        let heat = heat.as_deref().map(against);
        solver.equations.pull_back(&flow, &derivatives, &against(&multipliers[..FLOW * n]), heat.as_deref(), &mut bar);
        let positions = solver.equations.by_positions(&position, &flow, &bar);
        let mut found = state_bar.to_vec();
        found[row::P * n..].fill(0.0);
        for d in 0..3 {
            found[d * n..(d + 1) * n].iter_mut().zip(&positions[d]).for_each(|(to, x)| *to += x);
            let own = &mut found[(row::U + d) * n..(row::U + d + 1) * n];
            own[..inside].fill(0.0);
            own[inside..].iter_mut().zip(&bar.boundary).take(columns).for_each(|(to, bar)| *to += bar.normal[d]);
        }
        if let (Some(held), Some(multiplier)) = (&channel.held, multipliers.last()) {
            // The held flow rate depends on the openings of the columns too.
            let factor = match held {
                Held::FlowRate(_) => 1.0,
                Held::Power { .. } => solver.equations.push(&flow, 0),
            };
            let (height, length) = (channel.height(), channel.spacing * channel.cells[0] as f64);
            for (i, volume) in self.flat_volumes().iter().enumerate() {
                let opening_bar = -multiplier * factor * volume / length * flow.fields[0][i];
                let at = row::Y * n + inside + i % columns;
                found[at] -= opening_bar / height;
                found[at + columns] += opening_bar / height;
            }
        }
        Ok(found)
    }
}

impl Channel {
    /// Columns of particles over the whole wall.
    pub fn columns(&self) -> usize {
        self.cells[0] * self.cells[2]
    }

    /// How hot a point of the lower wall is: 1, or 0, and at both ends of the hot section the share with which they act where they are.
    pub fn hot_share(&self, point: usize) -> f64 {
        let x = self.place(self.inside() + point)[0];
        let [cold, hot] = EDGE;
        between_edges(self.hot, self.spacing, x, |place| ((cold - place) / (cold - hot)).clamp(0.0, 1.0))
    }

    /// The exchange of heat at a point of the walls, for one that is hot in part: the share of a hot wall's equation, over a spacing, beside that of
    /// an adiabatic one.
    fn exchange(&self, point: usize) -> Exchange {
        let share = if point < self.columns() { self.hot_share(point) } else { 0.0 };
        let is_part = share > 0.0 && share < 1.0;
        let coefficient = if is_part { self.diffusivity * share / ((1.0 - share) * self.spacing) } else { 0.0 };
        Exchange { coefficient, temperature: self.hot_excess }
    }

    /// Particles between the walls: row by row from below, each layer by layer along z, x fastest. Behind them are the points of the
    /// lower wall and those of the upper one.
    pub fn inside(&self) -> usize {
        self.columns() * (self.cells[1] - 1)
    }

    pub fn particles(&self) -> usize {
        self.columns() * (self.cells[1] + 1)
    }

    pub fn height(&self) -> f64 {
        self.cells[1] as f64 * self.spacing
    }

    fn region(&self) -> Region<3> {
        let size = self.cells.map(|cells| cells as f64 * self.spacing);
        Region { size, periodic: [true, false, true] }
    }

    /// The place of a particle over a flat wall.
    pub fn place(&self, i: usize) -> [f64; 3] {
        let (row, at) = (i / self.columns(), i % self.columns());
        // The rows inside are 1, 2, ..., and the walls come behind them.
        let row = match row + 1 {
            row if row < self.cells[1] => row,
            row if row == self.cells[1] => 0,
            _ => self.cells[1],
        };
        let (column, layer) = (at % self.cells[0], at / self.cells[0]);
        let h = self.spacing;
        [self.first_x + column as f64 * h, row as f64 * h, (layer as f64 + 0.5) * h]
    }

    /// The particle before this one along x, in the same row and layer.
    fn before(&self, i: usize) -> usize {
        let column = i % self.cells[0];
        i - column + (column + self.cells[0] - 1) % self.cells[0]
    }
}

/// The mean flow rate over all sections: sum of weight times u.
struct Rate {
    /// Volume over length, of each particle inside.
    weight: Vec<f64>,
}

impl Rate {
    fn of(&self, state: &State) -> f64 {
        self.weight.iter().zip(&state.fields[0]).map(|(w, u)| w * u).sum()
    }
}

impl FlowRate for Rate {
    fn value(&self, _: &Equations, state: &State, _: &Derivatives) -> f64 {
        self.of(state)
    }

    fn by_state(&self, equations: &Equations, _: &Coefficients<C>) -> Vec<f64> {
        let mut by = vec![0.0; FLOW * equations.particles()];
        self.weight.iter().enumerate().for_each(|(i, w)| by[FLOW * i] = *w);
        by
    }
}
