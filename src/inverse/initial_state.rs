//! Finds the initial state of a flow from the positions of its particles n steps later.
//!
//! A part of the initial state is unknown, the rest is known. With the fluid's initial positions x_i(0) and velocities
//! u_i(0) in units of the scene, and the assumed positions g_i(0):
//!
//! | unknown | variables | | derivative of the loss |
//! |---|---|---|---|
//! | [`Unknown::Velocities`] | `[D, N_fluid]` | u_i(0) | by u_i(0) |
//! | [`Unknown::Places`] | `[D, N_fluid]` | x_i(0) | by x_i(0) |
//! | [`Unknown::Offset`] | `[D]` | s with x_i(0) = g_i(0) + s | sum over i of that by x_i(0) |
//!
//! The loss is the mean over particles of |x - x*|^2 at the end, in spacings. (JAX-SPH's notebook on inverse problems
//! finds the positions of a falling block: <https://github.com/tumaer/jax-sph>, notebooks/iclr24_inverse.ipynb.)

use super::matching::{Matching, Seen};
use crate::adjoint::gradient::{gradient, Progress};
use crate::adjoint::run::run;
use crate::adjoint::schedule::Schedule;
use crate::config::difference::differences;
use crate::config::scene::{Config, Kernels};
use crate::design::limits::Limits;
use crate::design::optimisers::{BarzilaiBorwein, LBfgsB, Optimiser};
use crate::error::{BadInput, Error};
use crate::particles::tag;
use crate::scene::Scene;
use crate::sph::divergence::told;
use crate::sph::dynamics::Sph;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::Sweeps;
use std::collections::BTreeMap;

/// What of the start is unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Unknown {
    /// Where every particle is.
    Places,
    /// How far the fluid as a whole is from where it is assumed to be.
    Offset,
    /// The velocity of every particle.
    Velocities,
}

impl Unknown {
    /// The first row of the unknown quantity in the state.
    fn row<R: Sweeps>(self, scene: &Scene<R>) -> usize {
        match self {
            Self::Places | Self::Offset => 0,
            Self::Velocities => scene.model.rows.velocity(),
        }
    }
}

/// The observed end of the run.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Target {
    /// Positions, `[D, N]`.
    pub position: Vec<f64>,
    /// Kinds of particles, `[N]`, see [`crate::particles::tag`]; none if they are those of the scene.
    pub tags: Option<Vec<u8>>,
}

/// Keys in which an assumed start may differ from the scene: those that change nothing else of the run.
pub const OF_A_START: [&str; 5] = ["water.x", "water.y", "water.speed", "time.jitter", "run.seed"];

/// The problem of finding a part of a scene's initial state.
pub struct InitialState<R> {
    /// The true scene.
    pub scene: Scene<R>,
    pub unknown: Unknown,
    dynamics: Sph<R>,
    fluid: Vec<usize>,
    /// The initial state with the assumed values, `[F, N]`.
    assumed: Vec<R>,
    matching: Matching,
    schedule: Schedule,
}

impl<R: Sweeps> InitialState<R> {
    /// `assumed`: the scene with another start; none: its positions, at rest. `target`: none: the end of the scene's
    /// own run.
    ///
    /// # Errors
    /// Velocities that are not in the state's rows, an assumed start of another run, a target of another size, a budget
    /// that is too small.
    pub fn new(
        config: &Config,
        unknown: Unknown,
        assumed: Option<&Config>,
        target: Option<Target>,
    ) -> anyhow::Result<Self> {
        let scene = Scene::<R>::from_config(config)?;
        let model = scene.model.clone();
        let (n, d) = (model.particles(), model.dimension());
        if model.steady().is_some() {
            return Err(BadInput::new("method.name = fixed: the start of particles that do not move")
                .key("method.name")
                .allowed("a method whose particles move: places at the end say nothing of fixed particles")
                .into());
        }
        let dynamics = Sph::new(model.clone(), Kernels::Fused);
        let fluid: Vec<usize> = (0..n).filter(|&i| model.is_fluid(i)).collect();
        let position = match target {
            Some(target) => target_of(target, &scene, &fluid)?,
            None => {
                let end = run(&dynamics, &scene.start, scene.steps, &mut [])?;
                end.state[..d * n].iter().map(|x| x.f64()).collect()
            }
        };
        let matching = matching(&scene, scene.steps, position);
        let costs = dynamics.costs_from(&scene.start.state)?;
        let schedule = Schedule::affordable(scene.steps, 0, costs, config.optimise.memory)?;
        let other = assumed.map(|assumed| start_of::<R>(config, assumed)).transpose()?;
        let mut state = scene.start.state.clone();
        for row in unknown.row(&scene)..unknown.row(&scene) + d {
            for (k, &i) in fluid.iter().enumerate() {
                state[row * n + i] = match (&other, unknown) {
                    (Some((other, fluid)), _) => other[row * n + fluid[k]],
                    (None, Unknown::Velocities) => R::default(),
                    (None, Unknown::Places | Unknown::Offset) => state[row * n + i],
                };
            }
        }
        Ok(Self { scene, unknown, dynamics, fluid, assumed: state, matching, schedule })
    }

    /// Positions or velocities of the fluid, whichever are unknown, in a state `[F, N]`; `[D, N_fluid]`.
    fn of(&self, state: &[R]) -> Vec<f64> {
        let (n, d) = (self.scene.model.particles(), self.scene.model.dimension());
        let first = self.unknown.row(&self.scene);
        (first..first + d).flat_map(|row| self.fluid.iter().map(move |&i| state[row * n + i].f64())).collect()
    }

    /// The assumed values of the unknowns.
    pub fn first(&self) -> Vec<f64> {
        match self.unknown {
            Unknown::Offset => vec![0.0; self.scene.model.dimension()],
            Unknown::Places | Unknown::Velocities => self.of(&self.assumed),
        }
    }

    /// True initial positions or velocities of the fluid, `[D, N_fluid]`.
    pub fn truth(&self) -> Vec<f64> {
        self.of(&self.scene.start.state)
    }

    /// The initial state for values of the unknowns.
    pub fn start(&self, x: &[f64]) -> Snapshot<R> {
        let (n, domain) = (self.scene.model.particles(), &self.scene.model.domain);
        let (count, first) = (self.fluid.len(), self.unknown.row(&self.scene));
        let mut state = self.scene.start.state.clone();
        for d in 0..domain.dimension {
            for (k, &i) in self.fluid.iter().enumerate() {
                let at = (first + d) * n + i;
                let place = |x: f64| {
                    let x = R::of(domain.wrapped(d, x));
                    // A position just below the end of the box may be rounded to the end, which is the beginning.
                    match domain.periodic[d] && x >= R::of(domain.size[d]) {
                        true => R::default(),
                        false => x,
                    }
                };
                state[at] = match self.unknown {
                    Unknown::Velocities => R::of(x[d * count + k]),
                    Unknown::Places => place(x[d * count + k]),
                    Unknown::Offset => place(self.assumed[at].f64() + x[d]),
                };
            }
        }
        Snapshot::first(&self.scene.model, state)
    }

    /// The end of the run for values of the unknowns.
    pub fn end(&self, x: &[f64]) -> anyhow::Result<Solver<R>> {
        self.end_of(&self.start(x))
    }

    /// The end of a run from a start.
    pub fn end_of(&self, start: &Snapshot<R>) -> anyhow::Result<Solver<R>> {
        run(&self.dynamics, start, self.scene.steps, &mut [])
    }

    /// The target positions, `[D, N]`.
    pub fn target(&self) -> &[f64] {
        &self.matching.seen[&self.scene.steps].position
    }

    /// Limits of the unknowns: the fluid must be between the walls.
    pub fn limits(&self) -> Limits {
        let (domain, count, places) = (&self.scene.model.domain, self.fluid.len(), self.of(&self.assumed));
        let anywhere = [f64::NEG_INFINITY, f64::INFINITY];
        let mut all = Vec::new();
        for d in 0..domain.dimension {
            let [low, high] = if domain.periodic[d] { anywhere } else { self.scene.inside[d] };
            match self.unknown {
                Unknown::Velocities => all.extend(vec![anywhere; count]),
                Unknown::Places => all.extend(vec![[low, high]; count]),
                Unknown::Offset => {
                    let places = places[d * count..(d + 1) * count].iter().copied();
                    let (least, most) =
                        (places.clone().fold(f64::INFINITY, f64::min), places.fold(f64::NEG_INFINITY, f64::max));
                    all.push([low - least, high - most]);
                }
            }
        }
        Limits::within(all.iter().map(|[low, _]| *low).collect(), all.iter().map(|[_, high]| *high).collect())
    }

    /// The optimiser. For positions it is L-BFGS-B, whose first step is the mean distance from the target, which is
    /// exact for water in free fall. For velocities it is Barzilai and Borwein's method, which finds the same in as
    /// many epochs (20 x 20 particles, 40 steps: 0.00126 and 0.00127 away).
    pub fn optimiser(&self) -> anyhow::Result<Box<dyn Optimiser>> {
        let first = self.first();
        if self.unknown == Unknown::Velocities {
            return Ok(Box::new(BarzilaiBorwein::new(0.5 * self.scene.reference_velocity, &first)));
        }
        let count = self.fluid.len();
        let missed = self.missed(&self.end(&first)?);
        let whole = missed.chunks(count).map(|row| (row.iter().sum::<f64>() / count as f64).abs());
        // With a mean distance of zero, particles may still be a fraction of a spacing away.
        let most = whole.fold(0.1 * self.scene.spacing, f64::max);
        Ok(Box::new(LBfgsB::new(most, &first)))
    }

    /// The distance of an end from the target, `[D, N_fluid]`.
    fn missed(&self, end: &Solver<R>) -> Vec<f64> {
        self.apart(&end.state, |at| self.target()[at])
    }

    /// Positions of a state `[F, N]` minus others `[D, N]`, to the nearest image, `[D, N_fluid]`.
    fn apart(&self, state: &[R], others: impl Fn(usize) -> f64) -> Vec<f64> {
        let (n, domain) = (self.scene.model.particles(), &self.scene.model.domain);
        let all = (0..domain.dimension).flat_map(|d| self.fluid.iter().map(move |&i| (d, d * n + i)));
        all.map(|(d, at)| domain.nearest(d, state[at].f64() - others(at))).collect()
    }

    /// The loss and its derivative by the unknowns.
    pub fn evaluate(&self, x: &[f64], progress: Progress<'_>) -> Result<(f64, Vec<f64>), Error> {
        let start = self.start(x);
        let found = gradient(&self.dynamics, &start, &self.schedule, &self.matching, progress);
        let found = found.map_err(|error| told(&error, &self.scene.model, &start))?;
        let state = found.state.flatten_all().and_then(|state| state.to_vec1::<R>());
        let state = state.map_err(|error| Error::run(error.to_string(), "report this"))?;
        let by_particle = self.of(&state);
        Ok((
            found.value,
            match self.unknown {
                Unknown::Places | Unknown::Velocities => by_particle,
                Unknown::Offset => by_particle.chunks(self.fluid.len()).map(|row| row.iter().sum()).collect(),
            },
        ))
    }

    /// The root mean square error of a coordinate for a loss, in units of length.
    pub fn distance(&self, loss: f64) -> f64 {
        (loss / self.scene.model.dimension() as f64).sqrt() * self.scene.spacing
    }

    /// The root mean square error of a coordinate at an end.
    pub fn distance_of(&self, end: &Solver<R>) -> f64 {
        root_mean_square(&self.missed(end))
    }

    /// The error of the unknowns: |u - u*| / |u*| for velocities, the root mean square error of a coordinate for
    /// positions.
    pub fn error(&self, x: &[f64]) -> f64 {
        if self.unknown == Unknown::Velocities {
            let truth = self.truth();
            let apart: Vec<f64> = x.iter().zip(&truth).map(|(x, truth)| x - truth).collect();
            return root_mean_square(&apart) / root_mean_square(&truth);
        }
        let truth = &self.scene.start.state;
        root_mean_square(&self.apart(&self.start(x).state, |at| truth[at].f64()))
    }

    /// An objective for runs in which this problem's end is at `step`.
    pub fn matching_at(&self, step: usize) -> Matching {
        matching(&self.scene, step, self.target().to_vec())
    }
}

/// The objective for positions `[D, N]` of a scene's fluid.
fn matching<R: Sweeps>(scene: &Scene<R>, step: usize, position: Vec<f64>) -> Matching {
    let model = &scene.model;
    Matching {
        seen: BTreeMap::from([(step, Seen { position, temperature: None, weight: 1.0 })]),
        domain: model.domain,
        length: scene.spacing,
        warmth: 1.0,
        fluid: (0..model.particles()).map(|i| model.is_fluid(i)).collect(),
    }
}

/// Target positions `[D, N]` in the order of the scene's particles. Fluid that started elsewhere on the lattice has
/// other indices in the same order.
fn target_of<R: Sweeps>(target: Target, scene: &Scene<R>, fluid: &[usize]) -> Result<Vec<f64>, BadInput> {
    let (n, d) = (scene.model.particles(), scene.model.dimension());
    if target.position.len() != d * n {
        let problem = format!("the target has {} coordinates", target.position.len());
        return Err(
            BadInput::new(problem).allowed(format!("{} coordinates of {n} particles, in {d} directions", d * n))
        );
    }
    let tags = target.tags.as_ref().unwrap_or(&scene.model.tags);
    let theirs: Vec<usize> = (0..n.min(tags.len())).filter(|&i| tags[i] == tag::FLUID).collect();
    if theirs.len() != fluid.len() {
        return Err(BadInput::new(format!("the target has {} particles of fluid", theirs.len()))
            .allowed(format!("{}, as the scene has", fluid.len())));
    }
    let mut position: Vec<f64> = scene.start.state[..d * n].iter().map(|x| x.f64()).collect();
    for k in 0..d {
        fluid.iter().zip(&theirs).for_each(|(&i, &j)| position[k * n + i] = target.position[k * n + j]);
    }
    Ok(position)
}

/// The assumed initial state `[F, N]` of the same particles, and the indices of its fluid particles.
fn start_of<R: Sweeps>(config: &Config, assumed: &Config) -> Result<(Vec<R>, Vec<usize>), Error> {
    if let Some(other) = differences(config, assumed, &OF_A_START).first() {
        let problem =
            format!("what is assumed of the start has {} = {} instead of {}", other.key, other.now, other.before);
        return Err(BadInput::new(problem)
            .key(other.key.clone())
            .allowed(format!("a start of the same particles in the same flow: {}", OF_A_START.join(", ")))
            .into());
    }
    let scene = Scene::<R>::from_config(assumed)?;
    let fluid = (0..scene.model.particles()).filter(|&i| scene.model.is_fluid(i)).collect();
    Ok((scene.start.state, fluid))
}

fn root_mean_square(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len().max(1) as f64).sqrt()
}
