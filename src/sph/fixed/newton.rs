//! Newton's method for the steady state of fixed particles, by the factors of the matrix of one step.
//!
//! A steady state is a fixed point of a step, X = F(X). With A = dF/dX and K near I - A,
//!
//! ```text
//!   X <- X + K^-1 (F(X) - X)            finds it, and
//!   K^-T (I - A^T) lambda = K^-T b      has its adjoint in few iterations of GMRES.
//! ```
//!
//! K is I - A over flat walls at their developed flow, and is factorised once for all walls ([`crate::numerics::sparse_lu`]); where it is
//! too far from a wall's own, that one's is. So what is found depends on the wall alone, and not on those before it. The rows of A
//! are products with A^T, of many particles at once: those that are too far apart to have neighbours in common (Curtis, Powell and
//! Reid 1974). Flow and temperature have factors each, because the temperature does not act on the flow.
//!
//! The mass is conserved, so K is singular: the pressure of particle 0 is pinned by adding 1 to its entry, and the flow that this leaves
//! open, `idle`, is added so that the mass stays. A drive that holds a flow rate acts on all particles at once: its step has
//! A + a d^T, with the change a of a step by the kick, and the derivative d of the kick by the state, and its K follows by Sherman and
//! Morrison's formula.

use super::channel::Channel;
use super::factors::{Factors, Kicked};
use super::grid;
use super::lattice::{row, Fixed};
use crate::numerics::interrupt::is_asked_here;
use crate::numerics::krylov::gmres;
use crate::numerics::lanes::Real;
use crate::numerics::sparse_lu::{dot, BlockMatrix, Order, Singular, SparseLu};
use crate::numerics::threads;
use crate::sph::laws::drive::Drive;
use std::sync::Arc;

/// How far K reaches: from the pressure to the velocity behind the kick, to the pressure behind that. (The diffusion of the density reaches
/// farther and does little there.)
const REACH: usize = 2 * grid::REACH;
/// How far the temperature's part of a step reaches: a ghost has the slope from both of its sides.
const REACH_OF_HEAT: usize = grid::REACH + 1;
/// The largest number of particles that have factors: those of 8000 take a minute and 1.4 GB, of 2000 a second and 0.2 GB.
const MOST: usize = 4000;
/// Iterations with the same factors, and how often there are new ones.
const ITERATIONS: usize = 30;
const RENEWALS: usize = 3;
/// Iterations of an adjoint with the same factors.
const ADJOINT: usize = 60;
/// Iterations whose secants accelerate the next one.
const DEPTH: usize = 8;

/// x += factor * y
fn add_times(x: &mut [f64], factor: f64, y: &[f64]) {
    x.iter_mut().zip(y).for_each(|(x, y)| *x += factor * y);
}

impl<R: Real> Fixed<R> {
    /// The factors over flat walls; none without viscosity, and none of many particles.
    pub(super) fn reference(&self) -> Option<&Factors> {
        let new = || {
            if self.channel.viscosity <= 0.0 || self.fluid_particles() > MOST {
                return None;
            }
            let flat = vec![0.0; self.channel.columns];
            self.factors(&self.developed(self.state(&flat, &flat, &|_| 0.0))).ok()
        };
        self.reference.get_or_init(new).as_ref()
    }

    /// A state with the walls of another one, and the flow of flat walls that has nowhere to develop: a parabola without pressure
    /// and heat.
    fn developed(&self, mut state: Vec<R>) -> Vec<R> {
        let (n, nx, c) = (self.particles(), self.channel.columns, &self.channel);
        for row in row::U..row::COUNT {
            state[row * n..(row + 1) * n].fill(R::default());
        }
        let resistance = 12.0 * c.viscosity / (c.density * nx as f64 * c.spacing * self.height().powi(3));
        let force = match c.drive {
            None => c.body_force,
            Some(Drive::Momentum(momentum)) => resistance * momentum,
            Some(Drive::Power(power)) => (resistance * power).sqrt(),
        };
        for i in 0..self.fluid_particles() {
            let eta = self.eta((i / nx) as isize);
            state[row::U * n + i] = R::of(0.5 * force / c.viscosity * eta * (self.height() - eta));
        }
        state
    }

    /// Scales of u, v, p and T.
    fn scales(&self) -> [f64; 4] {
        let c = &self.channel;
        let heat = if c.hot_excess == 0.0 { 1.0 } else { c.hot_excess.abs() };
        [1.0, 1.0, c.density * c.sound_speed, heat]
    }

    /// Factors of K at a state.
    pub(super) fn factors(&self, state: &[R]) -> Result<Factors, Singular> {
        if self.channel.drive.is_none() {
            return self.factors_of_force(state);
        }
        let (mut next, mut other, mut work) = (state.to_vec(), state.to_vec(), self.work());
        let force = self.forward(state, &mut next, &mut work).f64();
        let pushed = |body_force: f64| {
            Self::new(Channel { drive: None, body_force, ..self.channel.clone() }).map_err(|_| Singular)
        };
        // The same with the acceleration that the drive has, and with another.
        let (free, step) = (pushed(force)?, force.abs().max(f64::MIN_POSITIVE));
        let harder = pushed(force + step)?;
        let mut factors = free.factors_of_force(state)?;
        free.forward(state, &mut next, &mut free.work());
        harder.forward(state, &mut other, &mut harder.work());
        other.iter_mut().zip(&next).for_each(|(other, next)| *other = R::of((other.f64() - next.f64()) / step));
        let (flow, mut heat) = self.unknowns(&other, -1);
        // A^T a with the drive and without it differ by d (a . a).
        let mut seed = vec![R::default(); state.len()];
        self.add(&mut seed, (&flow, &heat), -1);
        let (mut with, mut without) = (state.to_vec(), state.to_vec());
        self.backward_of_flow(state, &seed, &mut with, &mut work);
        free.backward_of_flow(state, &seed, &mut without, &mut free.work());
        self.done(work);
        let [with, without] = [with, without].map(|bar| self.unknowns(&bar, 1).0);
        let square = dot(&flow, &flow) + dot(&heat, &heat);
        let of_kick: Vec<f64> = with.iter().zip(&without).map(|(with, without)| (with - without) / square).collect();
        self.behind_outlets(&mut heat);
        let solved = (factors.flow.solve(&flow, false), factors.heat.solve(&heat, false));
        let back = factors.flow.solve(&of_kick, true);
        factors.drive = Some(Kicked { by_kick: [(flow, heat), solved], of_kick: [of_kick, back] });
        Ok(factors)
    }

    /// The same without a drive.
    fn factors_of_force(&self, state: &[R]) -> Result<Factors, Singular> {
        let grid = self.grid;
        let near = |reach: usize| {
            move |k: usize| -> Vec<u32> {
                let (j, i) = (k / grid.columns, k % grid.columns);
                let rows = j.saturating_sub(reach)..(j + reach + 1).min(grid.rows);
                let wide = (2 * reach + 1).min(grid.columns);
                let columns = (0..wide).map(move |k| (i + grid.columns - reach + k) % grid.columns);
                rows.flat_map(|j| columns.clone().map(move |i| (j * grid.columns + i) as u32)).collect()
            }
        };
        let fluid = self.fluid_particles();
        let mut flow = BlockMatrix::of_lists(fluid, 3, near(REACH));
        let of_heat = near(REACH_OF_HEAT);
        let mut heat = BlockMatrix::of_lists(fluid, 1, |k| {
            let mut list = of_heat(k);
            if k % grid.columns > self.outlet {
                list.push((k / grid.columns * grid.columns + self.outlet) as u32);
            }
            list
        });
        self.fill(state, &mut flow, 0..3, REACH);
        self.fill(state, &mut heat, 3..4, REACH_OF_HEAT);
        let pin = flow.entry(0, 0);
        flow.block_mut(pin)[8] += 1.0;
        let place = |k: usize| [(k % grid.columns) as f64, (k / grid.columns) as f64];
        let factorised =
            |matrix: &BlockMatrix| SparseLu::new(&Arc::new(Order::new(matrix, place)), matrix, threads::count());
        let (flow, heat) = (factorised(&flow)?, factorised(&heat)?);
        let mut pinned = vec![0.0; 3 * fluid];
        pinned[2] = 1.0;
        let idle = flow.solve(&pinned, false);
        Ok(Factors { flow, heat, idle, drive: None })
    }

    /// Writes I - A of some fields of u, v, p, T, scaled, for the particles whose structure the matrix has.
    fn fill(&self, state: &[R], matrix: &mut BlockMatrix, fields: std::ops::Range<usize>, reach: usize) {
        let (n, fluid, nx, ny) = (self.particles(), self.fluid_particles(), self.channel.columns, self.channel.rows);
        let (scales, size, is_heat) = (self.scales(), matrix.size, fields.start == 3);
        // Columns that are far enough apart, around the period too; those that are left over are alone.
        let width = 2 * reach + 1;
        let count = (nx / width).max(1);
        let wide = nx / count;
        let together = |class: usize| -> Vec<usize> {
            if class < wide {
                (0..count).map(|k| class + k * wide).collect()
            } else {
                vec![class + (count - 1) * wide]
            }
        };
        let classes = wide + nx - count * wide;
        let high = width.min(ny);
        let mut work = self.work();
        let (mut seed, mut found) = (vec![R::default(); state.len()], vec![R::default(); state.len()]);
        for (class, field) in (0..classes * high).flat_map(|class| fields.clone().map(move |field| (class, field))) {
            let columns = together(class / high);
            let rows = (class % high..ny).step_by(high);
            let seeds = || rows.clone().flat_map(|j| columns.iter().map(move |i| j * nx + i));
            seed.fill(R::default());
            seeds().for_each(|k| seed[(row::U + field) * n + k] = R::of(1.0));
            self.backward_of_flow(state, &seed, &mut found, &mut work);
            for k in seeds().filter(|k| !is_heat || k % nx <= self.outlet) {
                for entry in matrix.first[k]..matrix.first[k + 1] {
                    let other = matrix.column[entry] as usize;
                    for to in fields.clone() {
                        let of = (field - fields.start) * size + to - fields.start;
                        let same = f64::from(u8::from(k == other && field == to));
                        let by = found[(row::U + to) * n + other].f64() * scales[to] / scales[field];
                        matrix.block_mut(entry)[of] = same - by;
                    }
                }
            }
        }
        self.done(work);
        if !is_heat {
            return;
        }
        // Behind the outlet T is what it is there, so an equation less the outlet's.
        for k in (0..fluid).filter(|k| k % nx > self.outlet) {
            let (own, outlet) = (matrix.entry(k, k as u32), matrix.entry(k, (k / nx * nx + self.outlet) as u32));
            (matrix.values[own], matrix.values[outlet]) = (1.0, -1.0);
        }
    }

    /// The flow of a state, scaled, `[fluid, 3]`, and its temperature; `by`: the power of the scales.
    fn unknowns(&self, state: &[R], by: i32) -> (Vec<f64>, Vec<f64>) {
        let (n, fluid, scales) = (self.particles(), self.fluid_particles(), self.scales());
        let of = |field: usize, k: usize| state[(row::U + field) * n + k].f64() * scales[field].powi(by);
        let flow = (0..fluid).flat_map(|k| (0..3).map(move |field| (field, k))).map(|(field, k)| of(field, k));
        (flow.collect(), (0..fluid).map(|k| of(3, k)).collect())
    }

    /// Adds unknowns to a state.
    fn add(&self, state: &mut [R], (flow, heat): (&[f64], &[f64]), by: i32) {
        let (n, scales) = (self.particles(), self.scales().map(|scale| scale.powi(by)));
        for (k, (flow, heat)) in flow.chunks_exact(3).zip(heat).enumerate() {
            for (field, x) in flow.iter().chain([heat]).enumerate() {
                state[(row::U + field) * n + k] += R::of(x * scales[field]);
            }
        }
    }

    /// Of each row the particle at the outlet, and those behind it.
    fn outlets(&self) -> impl Iterator<Item = (usize, std::ops::Range<usize>)> + '_ {
        let nx = self.channel.columns;
        (0..self.channel.rows).map(move |j| (j * nx + self.outlet, j * nx + self.outlet + 1..(j + 1) * nx))
    }

    /// An equation of the temperature behind the outlet becomes that equation less the outlet's.
    fn behind_outlets(&self, heat: &mut [f64]) {
        for (outlet, behind) in self.outlets() {
            behind.for_each(|k| heat[k] -= heat[outlet]);
        }
    }

    /// The steady state with the walls of a state, whose flow it replaces. Returns the number of steps and the residual; none where it is
    /// not found. See the module.
    pub fn settle_by_newton(&self, state: &mut Vec<R>, tolerance: f64) -> Option<(usize, f64)> {
        let reference = self.reference()?;
        *state = self.developed(std::mem::take(state));
        let volumes = self.volumes(state);
        let (mut own, mut steps, mut next) = (None::<Factors>, 0, state.clone());
        let mut work = self.work();
        for _ in 0..=RENEWALS {
            let factors = own.as_ref().unwrap_or(reference);
            let mass = |flow: &[f64]| -> f64 { volumes.iter().zip(flow.chunks_exact(3)).map(|(v, x)| v * x[2]).sum() };
            let idle = mass(&factors.idle);
            let conserved = |mut flow: Vec<f64>| {
                let gained = mass(&flow) / idle;
                add_times(&mut flow, -gained, &factors.idle);
                flow
            };
            let drive = factors.drive.as_ref().map(|kicked| {
                let Kicked { by_kick: [_, (by_flow, by_heat)], of_kick: [of_kick, _] } = kicked;
                let by_flow = conserved(by_flow.clone());
                let resists = 1.0 - dot(of_kick, &by_flow);
                (of_kick, resists, by_flow, by_heat)
            });
            let mut newton = |state: &mut Vec<R>| {
                self.forward(state, &mut next, &mut work);
                let residual = self.residual(state, &next);
                next.iter_mut().zip(state.iter()).for_each(|(next, now)| *next -= *now);
                let (flow, mut heat) = self.unknowns(&next, -1);
                self.behind_outlets(&mut heat);
                let (mut flow, mut heat) =
                    (conserved(factors.flow.solve(&flow, false)), factors.heat.solve(&heat, false));
                if let Some((of_kick, resists, by_flow, by_heat)) = &drive {
                    let kick = dot(of_kick, &flow) / resists;
                    add_times(&mut flow, kick, by_flow);
                    add_times(&mut heat, kick, by_heat);
                }
                self.add(state, (&flow, &heat), 1);
                (1, residual)
            };
            let (more, residual) = self.accelerated(state, DEPTH, tolerance, ITERATIONS, &mut newton);
            steps += more;
            if residual <= tolerance {
                self.done(work);
                return Some((steps, residual));
            }
            if !residual.is_finite() || is_asked_here() {
                return None;
            }
            own = Some(self.factors(state).ok()?);
        }
        None
    }

    /// lambda = A^T lambda + b, given `step`, lambda to A^T lambda but for its multiple of `mass`, the cotangent of the mass, so that lambda's
    /// pressures sum up to 0. None where it is not found.
    pub(super) fn adjoint_by(
        &self,
        factors: &Factors,
        (b, mass): (&[R], &[R]),
        tolerance: f64,
        step: &dyn Fn(&[R]) -> Vec<R>,
    ) -> Option<Vec<R>> {
        let fluid = self.fluid_particles();
        let lambda = |x: &[f64]| -> Vec<R> {
            let mut lambda = vec![R::default(); self.state_length()];
            self.add(&mut lambda, x.split_at(3 * fluid), -1);
            lambda
        };
        let numbers = |lambda: &[R]| -> Vec<f64> {
            let (mut flow, heat) = self.unknowns(lambda, 1);
            flow.extend(heat);
            flow
        };
        let mut mass_bar = vec![R::default(); self.state_length()];
        mass_bar[row::P * self.particles()..][..fluid].copy_from_slice(&mass[..fluid]);
        let mass = self.unknowns(&mass_bar, 1).0;
        let pinned = factors.flow.solve(&mass, true);
        let sum = |x: &[f64]| x.chunks_exact(3).map(|x| x[2]).sum::<f64>();
        let mass_sum = sum(&mass);
        let conserved = |mut flow: Vec<f64>| {
            let multiple = flow[2] / pinned[2];
            add_times(&mut flow, -multiple, &pinned);
            let multiple = sum(&flow) / mass_sum;
            add_times(&mut flow, -multiple, &mass);
            flow
        };
        let drive = factors.drive.as_ref().map(|kicked| {
            let Kicked { by_kick: [(by_flow, by_heat), _], of_kick: [_, back] } = kicked;
            let back = conserved(back.clone());
            let resists = 1.0 - dot(by_flow, &back);
            (by_flow, by_heat, resists, back)
        });
        let precondition = |x: &[f64]| {
            let (flow, heat) = x.split_at(3 * fluid);
            let (mut flow, mut heat) = (conserved(factors.flow.solve(flow, true)), factors.heat.solve(heat, true));
            if let Some((by_flow, by_heat, resists, back)) = &drive {
                let share = (dot(by_flow, &flow) + dot(by_heat, &heat)) / resists;
                add_times(&mut flow, share, back);
            }
            for (outlet, behind) in self.outlets() {
                let from_behind: f64 = heat[behind].iter().sum();
                heat[outlet] -= from_behind;
            }
            flow.extend(heat);
            flow
        };
        let times = |x: &[f64]| {
            let product = numbers(&step(&lambda(x)));
            x.iter().zip(product).map(|(x, product)| x - product).collect()
        };
        gmres(&numbers(b), tolerance, ADJOINT, &times, &precondition).map(|x| lambda(&x))
    }
}
