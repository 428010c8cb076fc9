//! Where a diverged run went wrong, and the likely cause.
//!
//! In the state in which divergence is found everything may be wrong. So the cause is read from the last good state,
//! whose numbers are compared with the limits of the time step:
//!
//! ```text
//!   Mach number            u_90 / c             u_90: nine tenths of the fluid are slower, so that a few bad
//!                                               particles do not count but a fast front does
//!   Courant number         dt (c + u) / dx      sound and convection
//!   diffusion number       dt max(nu, alpha) / dx^2
//!   cell Reynolds number   u dx / nu            above its limit viscosity cannot smooth within a spacing
//! ```

use super::method::Model;
use super::solver::Snapshot;
use crate::adjoint::RunError;
use crate::error::{Error, Offence};
use crate::numerics::lanes::Real;
use crate::particles::tag;
use serde::Serialize;

/// Largest Mach number of the flow. Above it the density changes by about Ma^2 and particles clump.
const MACH: f64 = 0.3;

/// The dimensionless numbers of a state that decide about stability.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Numbers {
    /// Speed of the fastest fluid particle.
    pub fastest: f64,
    pub mach: f64,
    pub courant_number: f64,
    pub diffusion_number: f64,
    pub cell_reynolds_number: f64,
}

/// Tolerance of the limits: a time step that a scene chooses reaches its diffusion limit up to rounding.
const ROUNDING: f64 = 1.02;
/// Above this cell Reynolds number some flows fail: the cavity does, the vortices and the channel do not.
const CELL_REYNOLDS: f64 = 100.0;

impl Numbers {
    /// The numbers of a state for steps that are divided into `parts`.
    pub fn of<R: Real>(model: &Model<R>, state: &Snapshot<R>) -> Self {
        let (n, l) = (model.particles(), model.rows);
        let fluid = (0..n).filter(|&i| model.is_fluid(i));
        let square = |i: usize| -> f64 {
            (l.velocity()..l.velocity() + l.dimension).map(|row| state.state[row * n + i].f64().powi(2)).sum()
        };
        let mut squares: Vec<f64> = fluid.map(square).collect();
        squares.sort_unstable_by(f64::total_cmp);
        let most = squares.last().copied().unwrap_or(0.0);
        let usual = squares.get(squares.len() * 9 / 10).copied().unwrap_or(0.0);
        let equation = &model.equation_of_state;
        let (fastest, sound, density) = (most.sqrt(), model.sound_speed(), equation.reference_density);
        let spacing = (model.mass / density).powf(1.0 / l.dimension as f64);
        let dt = model.dt / state.parts as f64;
        let viscosity = model.viscosity / density + model.artificial_viscosity();
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

/// Why a run diverged, as far as its numbers tell, and what to try.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Cause {
    pub why: String,
    pub advice: String,
    /// Whether the numbers of the state name no cause.
    #[serde(skip)]
    pub is_open: bool,
}

impl Cause {
    /// The cause according to the last good state of a run.
    pub fn of<R: Real>(model: &Model<R>, good: &Snapshot<R>) -> Self {
        let (numbers, (cfl, most_diffusion)) = (Numbers::of(model, good), model.limits());
        let Numbers { fastest, mach, courant_number, diffusion_number, cell_reynolds_number } = numbers;
        let sound = model.sound_speed();
        if mach > MACH {
            return Self {
                why: format!("the flow is too fast for its sound speed, {sound:.3}: Mach {mach:.2}, fastest particle {fastest:.3}"),
                advice: format!("fluid.reference_velocity={fastest:.3} (the sound speed follows), or a slower flow"),
                is_open: false,
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
                    is_open: false,
                },
                false => Self {
                    why: format!(
                        "the step is too long for diffusion: its diffusion number is {diffusion_number:.3}, above {}",
                        most_diffusion
                    ),
                    advice: format!("time.diffusion_number={:.3}", 0.5 * most_diffusion),
                    is_open: false,
                },
            };
        }
        if cell_reynolds_number > CELL_REYNOLDS {
            return Self {
                why: format!(
                    "too little viscosity for the spacing: the cell Reynolds number u dx / nu is {cell_reynolds_number:.0}"
                ),
                advice: "a smaller resolution.dx, a larger viscosity or a smaller Reynolds number".into(),
                is_open: false,
            };
        }
        Self {
            why: format!(
                "the step is within its limits (Courant number {courant_number:.2}, diffusion number {diffusion_number:.3}, \
                 Mach {mach:.2}), so it is the arrangement of the particles"
            ),
            advice: model.advice().into(),
            is_open: true,
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Divergence {
    /// The step in which divergence was found.
    pub step: usize,
    /// The particle with the offending value.
    pub particle: usize,
    /// The kind of the particle, in words.
    pub tag: &'static str,
    /// Position of the particle in the last good state, after step `good_step`.
    pub position: Vec<f64>,
    pub good_step: usize,
    pub quantity: String,
    pub value: f64,
    pub cause: Cause,
    /// The message of the run's error.
    #[serde(skip)]
    message: String,
}

impl Divergence {
    /// The divergence that an error reports, given the last good state; none if the error is of another kind.
    pub fn of<R: Real>(error: &RunError, model: &Model<R>, good: &Snapshot<R>) -> Option<Self> {
        let (step, offender) = error.offender()?;
        let (n, dimension) = (model.particles(), model.rows.dimension);
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

    /// The error for the user; `more` is appended to its text.
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

/// The error for the user of a run that failed after the good state `good`.
pub fn told<R: Real>(error: &RunError, model: &Model<R>, good: &Snapshot<R>) -> Error {
    match Divergence::of(error, model, good) {
        Some(divergence) => divergence.told(""),
        None if error.is_divergence() => Error::diverged(
            error.to_string(),
            "a shorter time.end, time.cfl=0.5, optimise.clip=10, or optimise.gradient=truncated optimise.horizon=100",
        ),
        None if matches!(error, RunError::Stopped) => Error::Stopped,
        None => Error::run(error.to_string(), model.advice()),
    }
}
