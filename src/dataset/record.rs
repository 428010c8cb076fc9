//! Runs a trajectory of a data set and keeps its frames.
//!
//! Positions are relative to the lower corner of [`Enclosure`], so that all are within 0 ... size, as LagrangeBench's
//! readers need; `origin` is the position of that corner in the scene.

use super::recipe::Ready;
use super::trajectory::{kind, Trajectory};
use crate::adjoint::run::{run, Observer};
use crate::adjoint::{Dynamics, RunError};
use crate::config::device::DeviceName;
use crate::config::scene::{Config, Family, Kernels};
use crate::error::Error;
use crate::numerics::ranks::Ranks;
use crate::particles::tag;
use crate::scene::flows;
use crate::scene::Scene;
use crate::sph::divergence::{told, Cause};
use crate::sph::dynamics::Sph;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::spread;
use crate::sph::{Model, Sweeps};

/// The box that contains every particle of a data set, including walls.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Enclosure {
    pub dimension: usize,
    /// Position of its lower corner in the scene.
    pub origin: [f64; 3],
    pub size: [f64; 3],
    pub periodic: [bool; 3],
    /// Number of written particles.
    pub particles: usize,
}

/// A scene and its written particles.
struct Stage<R> {
    scene: Scene<R>,
    enclosure: Enclosure,
    /// Indices of the written particles.
    kept: Vec<usize>,
}

impl Enclosure {
    /// The box of a scene.
    pub fn of(config: &Config) -> Result<Self, Error> {
        Ok(stage::<f32>(config)?.enclosure)
    }
}

fn stage<R: Sweeps>(config: &Config) -> Result<Stage<R>, Error> {
    let scene = Scene::<R>::from_config(config)?;
    let (model, mut origin) = (&scene.model, scene.corner);
    // Points on a wall's surface are not written: the dummy particles behind it represent the wall.
    let is_particle = |i: usize| !tag::is_on_surface(model.tags[i]);
    let written = |&i: &usize| is_particle(i) && (!is_cavity(config) || is_inner(config, &scene, i));
    let kept: Vec<usize> = (0..model.particles()).filter(written).collect();
    let mut size = model.domain.size;
    if scene.design.is_some() {
        // The box includes the dummy particles of the lowest wall.
        origin[1] -= config.design.bound;
        size[1] += config.design.bound;
    }
    let (periodic, dimension) = (model.domain.periodic, model.dimension());
    let enclosure = Enclosure { dimension, origin, size, periodic, particles: kept.len() };
    Ok(Stage { scene, enclosure, kept })
}

fn is_cavity(config: &Config) -> bool {
    matches!(config.scene, Family::LidDrivenCavity | Family::LidDrivenCavity3d)
}

/// Whether a particle is in the cavity's fluid or the innermost row of its walls, as in LagrangeBench: 2708 particles
/// of 3136. The lid's row is as long as the box.
fn is_inner<R: Sweeps>(config: &Config, scene: &Scene<R>, i: usize) -> bool {
    let (model, state, dx) = (&scene.model, &scene.start.state, scene.spacing);
    let n = model.particles();
    // Distance outside of the fluid's square, which the walls surround.
    let walls = config.wall_rows() as f64 * dx;
    let outside = |d: usize| {
        let x = state[d * n + i].f64();
        (walls - x).max(x - (model.domain.size[d] - walls))
    };
    let deep = model.dimension() < 3 || outside(2) < dx;
    deep && outside(1) < dx && (outside(0) < dx || model.tags[i] == tag::MOVING_WALL)
}

/// Particles of the flows of a data set, if several ranks could share each of them.
///
/// # Errors
/// A scene that cannot be built.
pub fn shared_particles(config: &Config, ranks: &Ranks) -> Result<Option<usize>, Error> {
    let model = stage::<f32>(config)?.scene.model;
    let is_fused = config.run.kernels == Kernels::Fused && config.run.device == DeviceName::Cpu;
    let can_share = is_fused && spread::sharing(&model, ranks).is_ok();
    Ok(can_share.then(|| model.particles()))
}

/// Runs a trajectory, or a share of it: the first of several ranks has the result. `progress` is called after each frame.
///
/// # Errors
/// The run diverges, or a particle leaves the box.
pub fn record<R: Sweeps>(ready: &Ready, progress: &dyn Fn(), ranks: &Ranks) -> anyhow::Result<Option<Trajectory>> {
    let config = &ready.config;
    let mut stage = stage::<R>(config)?;
    if let Some((rest, steps)) = &ready.relaxation {
        let relaxed = relaxed::<R>(rest, *steps, ranks).map_err(|error| failed(ready, &stage.scene, error))?;
        restart(config, &stage.scene.model, &mut stage.scene.start, &relaxed);
    }
    let dynamics = Sph::new(stage.scene.model.clone(), config.run.compute()?);
    let mut recorder = Recorder::new(ready, &stage, progress);
    let ran = run_over(&dynamics, &stage.scene.start, ready.pace.total, &mut [&mut recorder], ranks);
    let solver = ran.map_err(|error| failed(ready, &stage.scene, error))?;
    Ok(solver.map(|_| recorder.trajectory))
}

/// A run by all ranks, of which the first one has the end.
fn run_over<R: Sweeps>(
    dynamics: &Sph<R>,
    start: &Snapshot<R>,
    steps: usize,
    observers: &mut [&mut dyn Observer<Sph<R>>],
    ranks: &Ranks,
) -> anyhow::Result<Option<Solver<R>>> {
    if ranks.size() == 1 {
        return run(dynamics, start, steps, observers).map(Some);
    }
    let shared = (spread::sharing(&dynamics.model, ranks)?, ranks);
    match ranks.rank() {
        0 => spread::lead(dynamics, start, steps, observers, None, shared).map(|(solver, _)| Some(solver)),
        _ => spread::follow(dynamics.model.clone(), start.clone(), None, shared).map(|()| None),
    }
}

/// An observer that keeps the frames of a trajectory.
struct Recorder<'a, R> {
    ready: &'a Ready,
    stage: &'a Stage<R>,
    progress: &'a dyn Fn(),
    trajectory: Trajectory,
    /// The last temperature of each particle, `[N]`.
    last: Vec<f64>,
}

impl<'a, R: Sweeps> Recorder<'a, R> {
    fn new(ready: &'a Ready, stage: &'a Stage<R>, progress: &'a dyn Fn()) -> Self {
        let (model, kept) = (&stage.scene.model, &stage.kept);
        let (frames, n) = ((ready.pace.total - ready.pace.skip) / ready.pace.every + 1, kept.len());
        let mut trajectory = Trajectory {
            name: ready.job.group(),
            frames,
            particles: n,
            position: Vec::with_capacity(frames * n * stage.enclosure.dimension),
            kind: kept.iter().map(|&i| kind_of(model.tags[i])).collect(),
            ..Default::default()
        };
        if let Some(shape) = stage.scene.design.as_ref().map(|design| design.first_wall()) {
            (trajectory.wall_x, trajectory.wall_offset) = (shape.nodes, shape.offsets);
        }
        let mut last = Vec::new();
        if let Some(heat) = &model.heat {
            let hot = ready.config.wall.hot_temperature;
            let set = |&i: &usize| if model.tags[i] == tag::HOT_WALL { hot as f32 } else { f32::NAN };
            trajectory.wall_temperature = Some(kept.iter().map(set).collect());
            trajectory.temperature = Some(Vec::with_capacity(frames * n));
            last = vec![heat.reference; model.particles()];
        }
        Self { ready, stage, progress, trajectory, last }
    }
}

impl<R: Sweeps> Observer<Sph<R>> for Recorder<'_, R> {
    fn see(&mut self, dynamics: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        let pace = &self.ready.pace;
        if solver.step < pace.skip || !(solver.step - pace.skip).is_multiple_of(pace.every) {
            return Ok(());
        }
        dynamics.check(solver)?;
        write_positions(self.ready, self.stage, solver, &mut self.trajectory.position)?;
        if let Some(all) = &mut self.trajectory.temperature {
            look_at_temperatures(&self.ready.config, solver, &mut self.last)?;
            all.extend(self.stage.kept.iter().map(|&i| self.last[i] as f32));
        }
        (self.progress)();
        Ok(())
    }
}

/// The particle type of LagrangeBench for a tag.
pub fn kind_of(tag: u8) -> i32 {
    match tag {
        tag::FLUID => kind::FLUID,
        tag::MOVING_WALL => kind::MOVING_WALL,
        // Also for a hot wall: an unknown type would be a rigid body for LagrangeBench.
        _ => kind::SOLID_WALL,
    }
}

/// Appends the positions `[N, D]` of a frame.
fn write_positions<R: Sweeps>(
    ready: &Ready,
    stage: &Stage<R>,
    solver: &Solver<R>,
    to: &mut Vec<f32>,
) -> Result<(), Error> {
    let (n, enclosure) = (stage.scene.model.particles(), &stage.enclosure);
    for &i in &stage.kept {
        for d in 0..enclosure.dimension {
            let x = solver.state[d * n + i].f64() - enclosure.origin[d];
            if !(0.0..=enclosure.size[d]).contains(&x) {
                let (job, step, axis) = (ready.job, solver.step, ["x", "y", "z"][d]);
                let problem = format!("{job}: particle {i} left the box in step {step}: {axis:?} = {x}");
                return Err(Error::diverged(problem, Cause::of(&stage.scene.model, &stage.scene.start).advice));
            }
            // A position just below the end of a period may be rounded to the end.
            let x = x as f32;
            to.push(if enclosure.periodic[d] && x >= enclosure.size[d] as f32 { 0.0 } else { x });
        }
    }
    Ok(())
}

/// Temperatures `[N]` of the present state. Walls have their set temperature; others have the solver's extrapolation,
/// or their last temperature if no fluid is in reach.
fn look_at_temperatures<R: Sweeps>(config: &Config, solver: &mut Solver<R>, last: &mut [f64]) -> Result<(), RunError> {
    solver.look()?;
    let model = solver.model.clone();
    let (n, Some(heat)) = (model.particles(), &model.heat) else { return Ok(()) };
    let now = |i: usize| solver.looked.temperature[i].f64() + heat.reference;
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    for i in (0..n).filter(|&i| model.is_fluid(i)) {
        last[i] = now(i);
        (low, high) = (low.min(last[i]), high.max(last[i]));
    }
    // Averages are between the fluid's temperatures, except where no fluid is in reach.
    let slack = 1e-5 * (high - low);
    for i in (0..n).filter(|&i| !model.is_fluid(i)) {
        if model.tags[i] == tag::HOT_WALL {
            last[i] = config.wall.hot_temperature;
        } else if (low - slack..=high + slack).contains(&now(i)) {
            last[i] = now(i);
        }
    }
    Ok(())
}

/// Positions `[D, N]` after a run from rest without forces, which are disordered and evenly spread. All ranks have them.
fn relaxed<R: Sweeps>(config: &Config, steps: usize, ranks: &Ranks) -> anyhow::Result<Vec<R>> {
    let scene = Scene::<R>::at_rest(config)?;
    let dynamics = Sph::new(scene.model.clone(), config.run.compute()?);
    let solver = run_over(&dynamics, &scene.start, steps, &mut [], ranks)?;
    let positions = scene.model.dimension() * scene.model.particles();
    let known = solver.map(|solver| solver.state[..positions].iter().map(|x| x.f64()).collect());
    Ok(ranks.told(known.unwrap_or_default()).into_iter().map(R::of).collect())
}

/// The initial state with the fluid at other positions, with the initial velocities there.
fn restart<R: Sweeps>(config: &Config, model: &Model<R>, start: &mut Snapshot<R>, position: &[R]) {
    let (n, l) = (model.particles(), model.rows);
    for i in (0..n).filter(|&i| model.is_fluid(i)) {
        for d in 0..l.dimension {
            start.state[d * n + i] = position[d * n + i];
        }
        if matches!(config.scene, Family::TaylorGreen | Family::TaylorGreen3d) {
            let place = std::array::from_fn(|d| if d < l.dimension { position[d * n + i].f64() } else { 0.0 });
            let velocity = flows::start_velocity(config, place);
            for d in 0..l.dimension {
                start.state[(l.velocity() + d) * n + i] = R::of(velocity[d]);
            }
        }
    }
    *start = Snapshot::first(model, std::mem::take(&mut start.state));
}

/// Adds advice to the error of a diverged run; other errors stay the same.
fn failed<R: Sweeps>(ready: &Ready, scene: &Scene<R>, error: anyhow::Error) -> anyhow::Error {
    match error.downcast::<RunError>() {
        Ok(error) => told(&error, &scene.model, &scene.start).of(ready.job).into(),
        Err(error) => error,
    }
}
