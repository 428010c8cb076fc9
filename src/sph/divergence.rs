//! What happened to a run that diverged: where it began, and the likely cause by the run's own numbers.
//!
//! The state in which a run is found to have diverged says little: everything in it may be wrong. So the cause is read from the
//! last state that was good, whose numbers are compared with the limits of the step that was made:
//!
//! ```text
//!   Mach number            u_90 / c             of what nine tenths of the fluid keep below: particles that have gone wrong do not
//!                                               move it, and a fast front does
//!   Courant number         dt (c + u) / dx      sound and convection
//!   diffusion number       dt max(nu, alpha) / dx^2
//!   cell Reynolds number   u dx / nu            what viscosity can not smooth within a spacing
//! ```

use super::consistent::Shift;
use super::model::Model;
use super::plan::sound_speed;
use super::solver::Snapshot;
use crate::adjoint::RunError;
use crate::config::stability::{self, CflLimit};
use crate::error::{Error, Offence};
use crate::numerics::lanes::Real;
use crate::particles::tag;
use serde::Serialize;

/// Above this Mach number of the whole flow densities change by its square, and particles clump.
const MACH: f64 = 0.3;

/// The numbers of a state that decide about stability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Numbers {
    /// Of the fastest fluid particle.
    pub fastest: f64,
    pub mach: f64,
    pub courant_number: f64,
    pub diffusion_number: f64,
    pub cell_reynolds_number: f64,
}

/// The step that a scene chooses has its diffusion number to rounding.
const ROUNDING: f64 = 1.02;
/// Above this cell Reynolds number some flows fail: the cavity, not the vortices nor the channel.
const CELL_REYNOLDS: f64 = 100.0;

/// Up to which Courant and diffusion numbers the steps of a model are stable.
fn limits<R>(model: &Model<R>) -> (CflLimit, f64) {
    match &model.consistent {
        _ if model.fixed.is_some() => (stability::FIXED, 0.25),
        Some(_) if model.layout.rates => (stability::VERLET, 0.125),
        Some(_) => (stability::SYMPLECTIC_EULER, 0.25),
        None if model.layout.density => (stability::FREE_SURFACE, 0.25),
        None => (stability::STANDARD, 0.25),
    }
}

impl Numbers {
    /// Of a state, for steps in `parts`.
    pub fn of<R: Real>(model: &Model<R>, state: &Snapshot<R>) -> Self {
        let (n, l) = (model.particles(), model.layout);
        let fluid = (0..n).filter(|&i| model.is_fluid(i));
        let square = |i: usize| -> f64 {
            (l.velocity()..l.velocity() + l.dimension).map(|row| state.state[row * n + i].f64().powi(2)).sum()
        };
        let mut squares: Vec<f64> = fluid.map(square).collect();
        squares.sort_unstable_by(f64::total_cmp);
        let most = squares.last().copied().unwrap_or(0.0);
        let usual = squares.get(squares.len() * 9 / 10).copied().unwrap_or(0.0);
        let equation = &model.equation_of_state;
        let (fastest, sound, density) = (most.sqrt(), sound_speed(equation), equation.reference_density);
        let spacing = (model.mass / density).powf(1.0 / l.dimension as f64);
        let dt = model.dt / state.parts as f64;
        // The artificial one amounts to alpha h c / (2 (d + 2)) (Monaghan 2005, eq. 8.8).
        let artificial = model
            .artificial_viscosity
            .as_ref()
            .map_or(0.0, |of| of.alpha * of.smoothing_length * of.sound_speed / (2.0 * (l.dimension as f64 + 2.0)));
        let viscosity = model.viscosity / density + artificial;
        let conduction = model.heat.as_ref().map_or(0.0, |heat| heat.largest_diffusivity() / density);
        Self {
            fastest,
            mach: usual.sqrt() / sound,
            courant_number: dt * (sound + fastest) / spacing,
            diffusion_number: dt * viscosity.max(conduction) / spacing.powi(2),
            cell_reynolds_number: fastest * spacing / viscosity,
        }
    }
}

/// Why a run diverged, as far as its numbers say, and what to try.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cause {
    pub why: String,
    pub advice: String,
}

impl Cause {
    /// By the last good state of a run.
    pub fn of<R: Real>(model: &Model<R>, good: &Snapshot<R>) -> Self {
        let (numbers, (cfl, most_diffusion)) = (Numbers::of(model, good), limits(model));
        let Numbers { fastest, mach, courant_number, diffusion_number, cell_reynolds_number } = numbers;
        let sound = sound_speed(&model.equation_of_state);
        if mach > MACH {
            return Self {
                why: format!("the flow is too fast for its sound speed, {sound:.3}: Mach {mach:.2}, fastest particle {fastest:.3}"),
                advice: format!("fluid.reference_velocity={fastest:.3}, which makes the sound speed follow, or a slower flow"),
            };
        }
        let (sound_share, diffusion_share) = (courant_number / cfl.most, diffusion_number / most_diffusion);
        if sound_share.max(diffusion_share) > ROUNDING {
            return match sound_share > diffusion_share {
                true => Self {
                    why: format!(
                        "the step is too long for sound: its Courant number is {courant_number:.2}, above {}",
                        cfl.most
                    ),
                    advice: format!("time.cfl={}", cfl.safe),
                },
                false => Self {
                    why: format!(
                        "the step is too long for diffusion: its diffusion number is {diffusion_number:.3}, above {}",
                        most_diffusion
                    ),
                    advice: format!("time.diffusion_number={:.3}", 0.5 * most_diffusion),
                },
            };
        }
        if cell_reynolds_number > CELL_REYNOLDS {
            return Self {
                why: format!(
                    "too little viscosity for the spacing: the cell Reynolds number u dx / nu is {cell_reynolds_number:.0}"
                ),
                advice: "a smaller resolution.dx, a larger viscosity or a smaller Reynolds number".into(),
            };
        }
        Self {
            why: format!(
                "the step is within its limits (Courant number {courant_number:.2}, diffusion number {diffusion_number:.3}, \
                 Mach {mach:.2}), so it is the arrangement of the particles"
            ),
            advice: arrangement(model).into(),
        }
    }
}

/// What to try about particles whose arrangement breaks down.
fn arrangement<R>(model: &Model<R>) -> &'static str {
    if model.fixed.is_some() {
        "time.cfl=0.6 or time.diffusion_number=0.06 (a smaller time step), or a gentler wall (a smaller design.amplitude or \
         design.bound)"
    } else if model.consistent.as_ref().is_some_and(|consistent| matches!(consistent.shift, Shift::Chain(_))) {
        // Over a rough wall smaller steps do not help; more neighbours do (src/sph/README.md has the figures).
        "over a rough wall fluid.motion=fixed or resolution.smoothing_length=1.1, or a gentler one (a smaller \
         design.amplitude or design.bound); over a flat one time.cfl=0.5"
    } else if model.layout.rates {
        // A disordered start beside walls: src/validation/README.md has the figures.
        "resolution.smoothing_length=0.9 (more neighbours), a smaller time.jitter, or time.cfl=0.5"
    } else {
        "time.cfl=0.5 or time.diffusion_number=0.125 (a smaller time step); where a wall is shaped, a gentler one (a smaller \
         design.amplitude or design.bound)"
    }
}

/// A run that diverged.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Divergence {
    /// In which step it was found.
    pub step: usize,
    /// The particle that was found.
    pub particle: usize,
    /// What it is, in words.
    pub tag: &'static str,
    /// Where it was in the last good state, after step `good_step`.
    pub position: Vec<f64>,
    pub good_step: usize,
    pub quantity: String,
    pub value: f64,
    pub cause: Cause,
    /// What the run said.
    #[serde(skip)]
    message: String,
}

impl Divergence {
    /// Of an error, with the last good state of the run; none for errors of another kind.
    pub fn of<R: Real>(error: &RunError, model: &Model<R>, good: &Snapshot<R>) -> Option<Self> {
        let (step, offender) = error.offender()?;
        let (n, dimension) = (model.particles(), model.layout.dimension);
        Some(Self {
            step,
            particle: offender.particle,
            tag: tag::name(model.tags[offender.particle]),
            position: (0..dimension).map(|d| good.state[d * n + offender.particle].f64()).collect(),
            good_step: good.step,
            quantity: offender.quantity,
            value: offender.value,
            cause: Cause::of(model, good),
            message: error.to_string(),
        })
    }

    /// What a user is told; `more` goes on with what else there is to say of it.
    pub fn told(&self, more: &str) -> Error {
        let place: Vec<String> = self.position.iter().map(|x| format!("{x:.4}")).collect();
        let Self { particle, tag, good_step, message, cause, .. } = self;
        let problem = format!(
            "{message}\n  where: particle {particle} ({tag}), at ({}) after step {good_step}\n  likely cause: {}{more}",
            place.join(", "),
            cause.why
        );
        let offence = Offence {
            step: self.step,
            particle: self.particle,
            position: self.position.clone(),
            quantity: self.quantity.clone(),
            value: self.value,
        };
        Error::diverged(problem, cause.advice.as_str()).by(offence)
    }
}

/// What a user is told of a run that could not go on from a state that was good.
pub fn told<R: Real>(error: &RunError, model: &Model<R>, good: &Snapshot<R>) -> Error {
    match Divergence::of(error, model, good) {
        Some(divergence) => divergence.told(""),
        None if error.is_divergence() => Error::diverged(
            error.to_string(),
            "a shorter time.end, time.cfl=0.5, optimise.clip=10, or optimise.gradient=truncated optimise.horizon=100",
        ),
        None if matches!(error, RunError::Stopped) => Error::Stopped,
        None => Error::run(error.to_string(), arrangement(model)),
    }
}
