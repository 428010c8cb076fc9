//! hydrograd: differentiable particle flow on candle tensors.
//!
//! ```text
//! configuration (TOML)          design variables
//!        |                             | parametrisation, deformation
//!        v                             v
//!      scene  -->  model, start  -->  [ drift, neighbours, density, walls, rates, assemble ] x steps  -->  fields
//!                                        sph: a step, written once                                       |
//!        gradient  <--  adjoint: last step to first, segment by segment, in bounded memory  <--  objective
//!           |
//!           +-->  optimiser  -->  better variables                     data set  <--  frames of many runs
//!                                                                          +-->  surrogate: learns one large step
//! ```
//!
//! # Layers
//!
//! A module imports only from those above it in this list (`tests/layers.rs` reads the imports):
//!
//! | module | what |
//! |---|---|
//! | [`error`] | what a user sees when something is wrong |
//! | [`numerics`] | lanes, sweeps over rows, memory, random numbers, the bridge to candle |
//! | [`io`] | files, written atomically |
//! | [`report`] | plots, tables, pages, progress: take numbers, know no physics |
//! | [`config`] | one loader for scenes and trainings |
//! | [`particles`] | tags, the box and its nearest images, the neighbour list |
//! | [`adjoint`] | dynamics, objectives, observers; the run loop, schedules, gradients: knows no SPH |
//! | [`sph`] | smoothing kernels, laws, operators, the step, the solver |
//! | [`design`] | parametrisations, objectives, optimisers, the loop that improves a design |
//! | [`scene`] | one scene type, and the families that build it |
//! | [`dataset`] | trajectories for training |
//! | [`inverse`] | what a flow began with, or is made of, from what was seen |
//! | [`validation`] | scenes against their exact solutions and independent references; where the solver holds |
//! | [`surrogate`] | networks, models, training, evaluation |
//! | [`cli`] | one file per command: parses, calls, prints |
//! | `python` | the Python package, with the feature of that name |
//!
//! # From a shape to a better one
//!
//! ```
//! use hydrograd::config::scene::Config;
//! use hydrograd::design::judge::{Judge, Scheduled};
//! use hydrograd::design::optimisers;
//! use hydrograd::scene::Scene;
//!
//! # fn main() -> anyhow::Result<()> {
//! // The heated channel, shorter than a user would run it.
//! let settings = ["time.end=0.3", "objective.window=0.1", "optimise.method=l-bfgs-b"].map(String::from);
//! let config = Config::load(Some("heated-channel"), None, &settings)?.config;
//! let problem = Scene::<f64>::from_config(&config)?.design.expect("this scene has a design");
//! let first = problem.first.clone();
//! let mut optimiser = optimisers::of_config(&config.optimise, &first);
//!
//! // A judge gives Q of a wall, and the loss with its gradient.
//! let schedule = problem.schedule(&config.optimise, config.run.precision)?;
//! let solver = Scheduled { problem, schedule };
//! let before = solver.value(&first)?.figure;
//!
//! // Three evaluations with gradients, each at the wall that the optimiser asks for.
//! let mut best = before;
//! for _ in 0..3 {
//!     let found = solver.gradient(optimiser.ask(), &mut |_| ())?;
//!     best = best.max(found.figure);
//!     optimiser.tell(solver.parametrisation().limits(), found.loss, &found.gradient);
//! }
//! assert!(best > before);
//! # Ok(())
//! # }
//! ```
//!
//! # A scene of one's own
//!
//! A [`sph::flow::Flow`] is all that does not change while a scene runs, whatever solves it; a method, here
//! [`sph::standard::Standard`], makes a [`sph::Model`] of it. A state is `[F, N]`: `model.rows` says what stands where.
//!
//! ```
//! use hydrograd::adjoint::{run, Dynamics};
//! use hydrograd::config::scene::Kernels;
//! use hydrograd::particles::{tag, Domain};
//! use hydrograd::sph::dynamics::Sph;
//! use hydrograd::sph::flow::Flow;
//! use hydrograd::sph::laws::equation_of_state::EquationOfState;
//! use hydrograd::sph::solver::{Snapshot, Solver};
//! use hydrograd::sph::standard::Standard;
//! use hydrograd::sph::Model;
//!
//! # fn main() -> anyhow::Result<()> {
//! // A periodic box of water with a shear wave.
//! let (side, dx) = (16, 1.0 / 16.0);
//! let domain = Domain { dimension: 2, size: [1.0; 3], periodic: [true, true, false] };
//! let water = EquationOfState { reference_density: 1.0, reference_pressure: 100.0, background_pressure: 0.0, gamma: 1 };
//! let flow = Flow { viscosity: 0.05, ..Flow::new(domain, vec![tag::FLUID; side * side], dx, water, 1e-3) };
//! let model = Model::new(Standard::plain(flow));
//! let n = model.particles();
//! let mut state = vec![0.0; model.rows.count() * n];
//! for i in 0..n {
//!     let (x, y) = ((i % side) as f64 * dx, (i / side) as f64 * dx);
//!     (state[i], state[n + i]) = (x, y);
//!     state[model.rows.velocity() * n + i] = (std::f64::consts::TAU * y).sin();
//! }
//! let start = Snapshot::first(&model, state);
//! // The wave decays as exp(-nu k^2 t); an observer sees every step.
//! let dynamics = Sph::new(model, Kernels::Fused);
//! let mut seen = 0;
//! let mut count = |_: &Sph<f64>, _: &mut Solver<f64>| -> anyhow::Result<()> {
//!     seen += 1;
//!     Ok(())
//! };
//! let end = run(&dynamics, &start, 200, &mut [&mut count])?;
//! let amplitude = end.row(end.model.rows.velocity()).iter().fold(0.0, |most: f64, u| most.max(u.abs()));
//! let exact = (-0.05 * std::f64::consts::TAU.powi(2) * 0.2).exp();
//! assert!((amplitude / exact - 1.0).abs() < 0.05, "{amplitude} is not {exact}");
//! assert_eq!((seen, dynamics.step(&end)), (201, 200));
//! # Ok(())
//! # }
//! ```
//!
//! # An objective of one's own
//!
//! ```
//! use candle_core::{Result, Tensor};
//! use hydrograd::adjoint::gradient::gradient;
//! use hydrograd::adjoint::schedule::Schedule;
//! use hydrograd::adjoint::{Fields, Objective};
//! use hydrograd::config::scene::{Config, Kernels};
//! use hydrograd::scene::Scene;
//! use hydrograd::sph::dynamics::Sph;
//!
//! /// Kinetic energy of the particles after so many steps.
//! struct KineticEnergy(usize);
//!
//! impl Objective for KineticEnergy {
//!     fn weight(&self, step: usize) -> Option<f64> {
//!         (step == self.0).then_some(1.0)
//!     }
//!     fn value(&self, fields: &Fields) -> Result<Tensor> {
//!         fields.velocity.sqr()?.broadcast_mul(&fields.mass)?.sum_all()?.affine(0.5, 0.0)
//!     }
//! }
//!
//! # fn main() -> anyhow::Result<()> {
//! let config = Config::load(Some("taylor-green"), None, &["resolution.dx=0.05".to_string()])?.config;
//! let scene = Scene::<f64>::from_config(&config)?;
//! let dynamics = Sph::new(scene.model.clone(), Kernels::Fused);
//! let found = gradient(&dynamics, &scene.start, &Schedule::segments(20, 5), &KineticEnergy(20), &mut |_| ())?;
//! // The vortices begin with 1/4 and decay; the derivative is by the whole first state, `[F, N]`.
//! assert!(found.value > 0.2 && found.value < 0.25);
//! assert_eq!(found.state.dims(), [scene.model.rows.count(), scene.model.particles()]);
//! # Ok(())
//! # }
//! ```
//!
//! # Glossary
//!
//! * **state** `[F, N]`: what a step begins and ends with: position, velocity, accelerations, temperature and its rate, mass.
//! * **moved** `[M, N]`: the state behind the drift: particles at their new places, with the velocities they came with.
//! * **primitives** `[C, N]`: density, velocity, shift, temperature of all particles, walls extrapolated: what the pair pass
//!   reads.
//! * **rates** `[A, N]`: accelerations and temperature rate.
//! * **fields**: the same in physical units, for objectives and observers: [`adjoint::Fields`].
//! * **`x_bar`**: the cotangent of x, the derivative of the objective by it.
//! * **kept**: what was put aside to be used again: a state by a schedule, slopes and records of pairs by the operators of
//!   one step ([`sph::standard::pair_cache::PairCache`]).
//! * **record**: all that the pair pass reads of one particle, side by side in memory.
//! * **F, G**: W'(d)/d and F'(d)/d of the smoothing kernel W.
//! * **sweep**: a loop over rows on all threads, compiled for several instruction sets; **row**: the pairs of one particle.
//! * **fused, composed**: an operator as one sweep with its adjoint written by hand; the same from candle's operators.
//! * **offset, height**: how far the wall is above y = 0 at a node; its average over a particle column.

pub mod adjoint;
pub mod cli;
pub mod config;
pub mod dataset;
pub mod design;
pub mod error;
pub mod inverse;
pub mod io;
pub mod numerics;
pub mod particles;
#[cfg(feature = "python")]
pub mod python;
pub mod report;
pub mod scene;
pub mod sph;
pub mod surrogate;
pub mod validation;
