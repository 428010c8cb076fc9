//! The recipe of a data set: its scene, its trajectories, and the steps that are kept as frames.
//!
//! `every` and `skip` count reference steps. These are the steps of JAX-SPH at its Courant number C (0.25 for the
//! heated channel, 0.22 for LagrangeBench's flows), dt_ref = C min(dx/(c + U), dx^2/max(nu, alpha)). The run uses the
//! largest steps that `time.cfl` and `time.diffusion_number` allow and that divide the time between two frames, so this
//! time does not depend on the time step.

use super::trajectory::Split;
use super::walls::{neighbour, wall, Section, Walls};
use crate::config::layers::Setting;
use crate::config::scene::{Config, Family, Method};
use crate::design::shape::default_nodes;
use crate::error::{BadInput, Error};
use crate::numerics::random::{new_seed, numbered, uniform};
use crate::scene::load::Loaded;
use serde::{Deserialize, Serialize};

/// Standard deviation of the fluid particles from the lattice, in spacings, before a relaxation (as in LagrangeBench).
const RELAXED_JITTER: f64 = 0.25;

/// The settings of a data set besides the scene's configuration.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// Numbers of trajectories for training, validation and test.
    pub trajectories: [usize; 3],
    /// Number of frames per trajectory, T.
    pub frames: usize,
    /// Number of reference steps between frames.
    pub every: usize,
    /// Number of reference steps before the first frame.
    pub skip: usize,
    /// Number of reference steps that relax a random start before time 0; for flows only.
    pub relax: usize,
    pub walls: Walls,
    /// The initial state of the flows.
    #[serde(default)]
    pub starts: Starts,
    /// If greater than 0, every second trajectory is the one before it over a neighbouring wall, whose nodes differ by
    /// at most this: both begin alike, so the difference of what flows out is the effect of the walls.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub pairs: f64,
    /// Whether trajectories get the heat that flows out of their steady flow, and its derivative by the wall's nodes.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub objective: bool,
    /// Offsets for [`Walls::File`], which the trajectories of all splits use in turns.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub given: Vec<Vec<f64>>,
}

fn is_zero(number: &f64) -> bool {
    *number == 0.0
}

/// How the flows of a data set begin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, clap::ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Starts {
    /// As the scene does: time.start.
    #[default]
    Scene,
    /// At random: half of them from rest, half with the developed flow.
    Mix,
}

/// A trajectory of a data set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Job {
    pub split: Split,
    /// Its index in the split, from 0.
    pub index: usize,
}

/// The steps of a run, and which of them are kept.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pace {
    /// Time of a reference step.
    pub reference: f64,
    /// Time of a step of the run.
    pub dt: f64,
    /// Number of the run's steps between frames.
    pub every: usize,
    /// Number of the run's steps before the first frame.
    pub skip: usize,
    /// Number of all steps.
    pub total: usize,
}

/// A trajectory that is ready to run.
#[derive(Debug, Clone)]
pub struct Ready {
    pub job: Job,
    /// The configuration with the trajectory's seed, wall and number of steps.
    pub config: Config,
    /// Name of its wall; empty for flows.
    pub wall: String,
    /// Configuration and number of steps of the relaxation, if there is one.
    pub relaxation: Option<(Config, usize)>,
    pub pace: Pace,
}

impl Recipe {
    /// The default recipe of a scene. That of the heated channel is the report's; those of flows are LagrangeBench's
    /// with fewer trajectories (and where LagrangeBench cuts one long run, with more and shorter ones).
    pub fn of(scene: Family) -> Self {
        let (trajectories, frames, skip, relax) = match scene {
            Family::HeatedChannel => ([100, 50, 50], 147, 300, 0),
            Family::TaylorGreen => ([20, 10, 10], 126, 0, 5000),
            Family::TaylorGreen3d => ([4, 2, 2], 61, 0, 5000),
            Family::Poiseuille | Family::Couette => ([4, 2, 2], 147, 0, 0),
            Family::ReversePoiseuille | Family::ReversePoiseuille3d => ([4, 2, 2], 500, 20_000, 5000),
            Family::LidDrivenCavity | Family::LidDrivenCavity3d => ([4, 2, 2], 500, 50_000, 5000),
            Family::Slab | Family::IsothermalChannel | Family::HeatedChannel3d => ([4, 2, 2], 147, 0, 0),
            Family::Custom => ([4, 2, 2], 147, 0, 0),
            // The blocks differ by time.jitter, because water with a free surface does not relax without gravity.
            Family::DamBreak => ([4, 2, 2], 401, 0, 0),
            Family::DamBreak3d | Family::FallingBlock | Family::HydrostaticTank => ([4, 2, 2], 101, 0, 0),
        };
        Self { trajectories, frames, every: 100, skip, relax, ..Self::default() }
    }

    /// Checks that the recipe is valid for the scene.
    pub fn check(&self, loaded: &Loaded) -> Result<(), BadInput> {
        let config = &loaded.config;
        if matches!(config.scene, Family::Slab | Family::IsothermalChannel | Family::HeatedChannel3d) {
            // The walls in a frame describe a heated channel only.
            return Err(BadInput::new(format!("there are no data sets of scene {}", config.scene.name()))
                .place("generate")
                .allowed("heated-channel, and flows without heat")
                .advice("hydrograd generate heated-channel"));
        }
        let bad = |key: &str, problem: String, allowed: &str| BadInput::new(problem).key(key).allowed(allowed);
        if self.trajectories[0] == 0 {
            let allowed = "TRAIN/VALID/TEST, at least one for training";
            let bad = bad("trajectories", "there is no training trajectory".into(), allowed);
            return Err(bad.advice("trajectories=4/2/2"));
        }
        let most = 99_999;
        if let Some(many) = self.trajectories.iter().find(|count| **count > most) {
            return Err(bad("trajectories", format!("{many} trajectories"), &format!("at most {most} per split")));
        }
        if self.frames < 3 {
            let allowed = "at least 3: an acceleration takes three frames";
            return Err(bad("frames", format!("frames = {} is too few", self.frames), allowed));
        }
        if self.every == 0 {
            return Err(bad("every", "every = 0: frames would not differ".into(), "at least 1"));
        }
        if config.scene.has_design() && self.relax > 0 {
            let problem = format!("relax = {}: the heated channel has no relaxation", self.relax);
            return Err(bad("relax", problem, "0").advice(format!("skip={}", self.skip + self.relax)));
        }
        if config.scene.has_surface() && self.relax > 0 {
            let problem = format!("relax = {}: water with a free surface does not relax", self.relax);
            return Err(bad("relax", problem, "0").advice("time.jitter=0.1"));
        }
        if !config.scene.has_design() && self.walls != Walls::default() {
            let option = if self.walls == Walls::File { "walls-file" } else { "walls" };
            let problem = format!("scene {} has no walls to shape", config.scene.name());
            return Err(bad(option, problem, "walls with scene heated-channel only"));
        }
        if self.starts == Starts::Mix && config.scene != Family::HeatedChannel {
            let problem = format!("scene {} has one way to begin", config.scene.name());
            return Err(bad("starts", problem, "starts = mix with scene heated-channel only"));
        }
        self.check_walls(config)?;
        let usual = config.scene.defaults().time;
        // The length in a preset is for its own runs.
        let wish = |key: &str| loaded.place(key).is_some_and(|place| !place.starts_with("preset "));
        if (config.time.steps != usual.steps && wish("time.steps"))
            || (config.time.end != usual.end && wish("time.end"))
        {
            return Err(BadInput::new("the length of a trajectory is given in frames")
                .place("time.end or time.steps")
                .allowed("frames, every and skip")
                .advice(format!("leave time.end and time.steps out; frames={} or another number", self.frames)));
        }
        let steps = self.pace(config).total as f64;
        if steps > 1e9 {
            return Err(bad("frames", format!("a trajectory of {steps:.1e} steps"), "at most 1e9 steps"));
        }
        Ok(())
    }

    /// Checks what is about walls beyond their choice.
    fn check_walls(&self, config: &Config) -> Result<(), BadInput> {
        let bad = |key: &str, problem: String, allowed: String| Err(BadInput::new(problem).key(key).allowed(allowed));
        if (self.pairs > 0.0 || self.objective) && !config.scene.has_design() {
            let key = if self.objective { "objective" } else { "pairs" };
            let problem = format!("scene {} has no walls to shape", config.scene.name());
            return bad(key, problem, format!("{key} with scene heated-channel only"));
        }
        if !(0.0..config.design.bound).contains(&self.pairs) {
            let allowed = format!("0 (no pairs) ... less than design.bound = {}", config.design.bound);
            return bad("pairs", format!("pairs = {} is out of range", self.pairs), allowed);
        }
        if self.pairs > 0.0 && self.walls == Walls::Scene {
            let allowed = "walls = mix, report, columns or smooth, or a table of walls";
            return bad("pairs", "pairs of the scene's own wall".into(), allowed.into());
        }
        if self.pairs > 0.0 && self.trajectories.iter().any(|count| count % 2 != 0) {
            let [train, valid, test] = self.trajectories;
            let problem = format!("trajectories = {train}/{valid}/{test} with pairs");
            return bad("trajectories", problem, "even numbers".into());
        }
        Ok(())
    }

    /// The steps of a run.
    pub fn pace(&self, config: &Config) -> Pace {
        let limits = config.time_step_limits();
        let courant = match config.scene {
            Family::HeatedChannel
            | Family::HeatedChannel3d
            | Family::Poiseuille
            | Family::Couette
            | Family::Slab
            | Family::IsothermalChannel
            | Family::Custom
            | Family::FallingBlock
            | Family::HydrostaticTank => 0.25,
            // LagrangeBench's: 4e-4 at a spacing of 0.02, 5e-4 at 0.025.
            Family::TaylorGreen | Family::ReversePoiseuille | Family::LidDrivenCavity => 0.22,
            // 3e-4 at a spacing of 0.02.
            Family::DamBreak | Family::DamBreak3d => 0.233,
            // 5e-3 at a spacing of 2 pi/20.
            Family::TaylorGreen3d | Family::ReversePoiseuille3d | Family::LidDrivenCavity3d => 0.175,
        };
        let longest = (limits.acoustic / config.time.cfl).min(limits.diffusive / config.time.diffusion_number);
        let reference = courant * longest;
        let frame = self.every as f64 * reference;
        let every = (frame / config.time_step_limit() - 1e-9).ceil().max(1.0);
        let dt = frame / every;
        let skip = (self.skip as f64 * reference / dt).round();
        let total = skip + every * (self.frames.max(1) - 1) as f64;
        Pace { reference, dt, every: every as usize, skip: skip as usize, total: total as usize }
    }

    /// All trajectories, by split.
    pub fn jobs(&self) -> Vec<Job> {
        let of = |(split, count): (Split, usize)| (0..count).map(move |index| Job { split, index });
        Split::ALL.into_iter().zip(self.trajectories).flat_map(of).collect()
    }

    /// The wall of a trajectory in the table, if there is one. Both of a pair take the same line.
    fn given(&self, job: Job) -> Option<(String, Vec<f64>)> {
        let place = self.jobs().iter().position(|other| *other == job)?;
        let line = if self.pairs > 0.0 { place / 2 } else { place } % self.given.len().max(1);
        Some((format!("line {} of the table", line + 1), self.given.get(line)?.clone()))
    }

    /// The configuration of a trajectory, which depends only on the seed, the split and the index.
    pub fn ready(&self, loaded: &Loaded, job: Job) -> Result<Ready, Error> {
        let pace = self.pace(&loaded.config);
        let config = &loaded.config;
        let is_paired = self.pairs > 0.0;
        let first = if is_paired { job.index - job.index % 2 } else { job.index };
        let of = |index: usize| numbered(config.run.seed, job.split.name(), index as u32);
        let mut rng = of(first);
        let option = |key: &str, value: String| Setting::option(&format!("trajectory {job}"), key, value);
        let mut settings = vec![
            option("run.seed", new_seed(&mut rng).to_string()),
            // The time step itself.
            option("time.cfl", format!("{:?}", pace.dt / config.time_step_limits().acoustic * config.time.cfl)),
            option("time.steps", pace.total.max(1).to_string()),
        ];
        let mut name = String::new();
        if config.scene.has_design() {
            let (channel, design) = (&config.channel, &config.design);
            let default = || default_nodes(channel.hot_from, channel.hot_to, config.resolution.dx);
            let nodes = design.nodes.clone().unwrap_or_else(default);
            let (hot_from, hot_to, bound) = (channel.hot_from, channel.hot_to, design.bound);
            let section = Section { nodes: &nodes, hot_from, hot_to, bound: bound - self.pairs };
            name = "the scene's".into();
            let number = if is_paired { first / 2 } else { first };
            let drawn = wall(self.walls, job.split, number, &mut rng, section);
            if let Some((mut wall, mut offsets)) = drawn.or_else(|| self.given(job)) {
                if job.index != first {
                    let change = neighbour(number, &mut of(job.index), Section { bound: self.pairs, ..section });
                    // A wall of the table may reach the bound.
                    let moved = |(offset, change): (&mut f64, f64)| *offset = (*offset + change).clamp(-bound, bound);
                    offsets.iter_mut().zip(change).for_each(moved);
                    wall += ", its neighbour";
                }
                settings.push(option("design.offsets", format!("{offsets:?}")));
                name = wall;
            }
        }
        if self.starts == Starts::Mix {
            let start = if uniform(&mut rng) < 0.5 { "rest" } else { "developed" };
            settings.push(option("time.start", format!("{start:?}")));
        }
        let mut ready = loaded.with(&settings)?.config;
        // The number of threads does not change the result, so it must not be in the file.
        ready.run.threads = 0;
        let relaxation = (self.relax > 0).then(|| {
            let mut rest = ready.clone();
            if let Method::Standard(own) = &mut rest.method {
                own.transport_velocity = 1.0;
            }
            rest.time.jitter = RELAXED_JITTER;
            (rest, (self.relax as f64 * pace.reference / pace.dt).ceil() as usize)
        });
        Ok(Ready { job, config: ready, wall: name, relaxation, pace })
    }
}

impl Job {
    /// The trajectory's group in its file.
    pub fn group(&self) -> String {
        format!("{:05}", self.index)
    }
}

impl std::fmt::Display for Job {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{}-{:05}", self.split.name(), self.index)
    }
}
