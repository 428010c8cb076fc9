//! What makes a run that gets to its end one not to trust.
//!
//! ```text
//!   density    root mean square of rho / rho_0 - 1 over the fluid   above 3 %: three times what Mach 0.1 makes
//!   speed      fastest particle                                     above 1.5 times the flow's own
//!   energy     kinetic energy of decaying vortices against the exact one, kinetic and potential energy of water
//!              against the first: off, or above, by more than 10 % of the first
//!   heat       balance of a channel's heat over its window          open by more than 5 %
//! ```
//!
//! They are looked at a hundred times a run, from its tenth part on: before, a disordered start settles.

use crate::adjoint::run::Observer;
use crate::config::scene::Config;
use crate::design::diagnostics::Diagnostics;
use crate::scene::observers::EvenSteps;
use crate::scene::Scene;
use crate::sph::dynamics::Sph;
use crate::sph::solver::Solver;
use crate::sph::Sweeps;
use serde::{Deserialize, Serialize};

const DENSITY: f64 = 0.03;
const SPEED: f64 = 1.5;
const ENERGY: f64 = 0.1;
const HEAT: f64 = 0.05;
/// Looks per run.
const LOOKS: usize = 100;
/// Part of a run in which nothing is asked.
const SETTLING: f64 = 0.1;

/// What was wrong first.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Fault {
    pub step: usize,
    pub time: f64,
    pub quantity: String,
    pub value: f64,
    /// Of a criterion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub limit: Option<f64>,
    /// Of a run that diverged: the particle that was found, what it is, and where it was in the last good state.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub particle: Option<usize>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tag: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position: Option<Vec<f64>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cause: Option<String>,
}

/// Looks at a run on its way, and keeps the first thing that is wrong.
pub struct Watch<'a, R> {
    scene: &'a Scene<R>,
    steps: EvenSteps,
    /// Of the flow itself.
    speed: f64,
    /// Of water with a free surface, downwards.
    gravity: Option<f64>,
    first_energy: Option<f64>,
    pub fault: Option<Fault>,
}

impl<'a, R: Sweeps> Watch<'a, R> {
    pub fn new(config: &Config, scene: &'a Scene<R>) -> Self {
        let gravity = config.scene.has_surface().then(|| -config.fluid.gravity[1]);
        let speed = match gravity {
            // Twice what falls from the water's height: a front on a dry bed.
            Some(gravity) => 2.0 * (gravity * config.water.height).sqrt(),
            None if config.scene.has_design() => config.plane_speed().max(config.fluid.reference_velocity),
            None => scene.reference_velocity,
        };
        Self { scene, steps: EvenSteps::new(scene.steps, LOOKS), speed, gravity, first_energy: None, fault: None }
    }

    /// What is wrong with a state: a quantity, its value, its limit.
    fn wrong(&mut self, solver: &mut Solver<R>) -> Option<(&'static str, f64, f64)> {
        if let Err(error) = solver.look() {
            log::warn!("{error}");
            return None;
        }
        let (model, n) = (&self.scene.model, self.scene.model.particles());
        let fluid: Vec<usize> = (0..n).filter(|&i| model.is_fluid(i)).collect();
        let reference = model.equation_of_state.reference_density;
        let square: f64 = fluid.iter().map(|&i| (solver.looked.density[i].f64() / reference - 1.0).powi(2)).sum();
        let density = (square / fluid.len() as f64).sqrt();
        let time = solver.step as f64 * model.dt;
        let figures = self.scene.figures(&solver.state, time);
        let height = |&i: &usize| solver.mass(i) * solver.state[n + i].f64();
        let potential = self.gravity.map(|gravity| gravity * fluid.iter().map(height).sum::<f64>());
        let energy = figures.kinetic_energy + potential.unwrap_or(0.0);
        let first = *self.first_energy.get_or_insert(energy);
        // Those of a flow that something drives may grow.
        let excess = match (potential, figures.exact_kinetic_energy) {
            (Some(_), _) => (energy - first) / first,
            (None, Some(exact)) if first > 0.0 => (energy - exact).abs() / first,
            _ => 0.0,
        };
        let speed = figures.largest_velocity / self.speed;
        [
            ("density deviation", density, DENSITY),
            ("speed over the flow's own", speed, SPEED),
            ("excess energy", excess, ENERGY),
        ]
        .into_iter()
        .find(|(_, value, limit)| value > limit)
    }
}

impl<R: Sweeps> Observer<Sph<R>> for Watch<'_, R> {
    fn see(&mut self, _: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        if self.fault.is_some() || !self.steps.contains(solver.step) {
            return Ok(());
        }
        let wrong = self.wrong(solver);
        if solver.step as f64 >= SETTLING * self.scene.steps as f64 {
            let (step, time) = (solver.step, solver.step as f64 * self.scene.model.dt);
            self.fault = wrong.map(|(quantity, value, limit)| fault(step, time, quantity, value, limit));
        }
        Ok(())
    }
}

fn fault(step: usize, time: f64, quantity: &str, value: f64, limit: f64) -> Fault {
    Fault { step, time, quantity: quantity.into(), value, limit: Some(limit), ..Fault::default() }
}

/// A heat balance that is open, over the window at the end of a run.
pub fn heat_balance(config: &Config, steps: usize, found: &Diagnostics) -> Option<Fault> {
    let open = found.energy_imbalance.abs();
    let (end, window) = (config.duration(), config.objective.window);
    (open.is_nan() || open > HEAT).then(|| fault(steps, (end - window).max(0.0), "open heat balance", open, HEAT))
}
