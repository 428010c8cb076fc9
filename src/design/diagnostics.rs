//! Measurements of a flow through a section, which can be checked against each other.

use super::deformation::Map;
use super::objectives::outlet::{Flows, Outlet};
use super::problem::{mean, Problem};
use crate::adjoint::run::{run, Observer};
use crate::adjoint::Dynamics;
use crate::config::device::Compute;
use crate::config::scene::{Config, ObjectiveKind};
use crate::sph::dynamics::Sph;
use crate::sph::solver::{Snapshot, Solver};
use crate::sph::{Model, Sweeps};
use serde::Serialize;
use std::collections::BTreeSet;

/// Largest number of samples in the averages.
const SAMPLES: usize = 100;

/// Averages over the window of the objective. Heat is in units of density * velocity * temperature * length, as Q in
/// flux form; times the heat capacity it is power per depth.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Diagnostics {
    /// Outflowing heat Q at the targets: the sum of rho u (T - T_in) times their spacing.
    pub q: f64,
    /// Flow rate: the sum of u times the spacing.
    pub flow_rate: f64,
    /// Mixed temperature of the outflow: T_in + Q / (sum of rho u times the spacing).
    pub mean_outlet_temperature: f64,
    /// Mean temperature of all fluid, weighted by mass.
    pub mean_temperature: f64,
    /// Heat from the walls into the fluid upstream of the targets.
    pub wall_heat_flux: f64,
    /// Change of the heat in that fluid per time.
    pub stored_heat_rate: f64,
    /// (wall_heat_flux - q - stored_heat_rate) / wall_heat_flux.
    pub energy_imbalance: f64,
    pub mean_density: f64,
    /// Fastest fluid particle along x.
    pub u_max: f64,
    /// The acceleration that drives the flow: the given one, or that which holds the flow rate or the power.
    pub body_force: f64,
    /// Pumping power per depth: body_force times the momentum of the fluid.
    pub pumping_power: f64,
    /// Change of Q and of the flow rate from the first half of the window to the second, relative to their means; none
    /// for few samples, and for a mean of 0.
    pub q_drift: Option<f64>,
    pub flow_rate_drift: Option<f64>,
    /// What the scatter of their samples leaves open of the means of Q and of the flow rate, for 19 of 20 windows; none for few samples.
    pub q_sampling: Option<f64>,
    pub flow_rate_sampling: Option<f64>,
    pub unsettled: Unsettled,
}

/// How far means over the window are from the values that the figures go to, see [`unsettled`]; none for few samples.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Unsettled {
    pub q: Option<f64>,
    pub flow_rate: Option<f64>,
    pub wall_heat_flux: Option<f64>,
    pub mean_outlet_temperature: Option<f64>,
    pub mean_temperature: Option<f64>,
    pub u_max: Option<f64>,
    pub pumping_power: Option<f64>,
}

impl Diagnostics {
    /// The objective's value.
    pub fn objective(&self, config: &Config) -> f64 {
        match config.objective.kind {
            ObjectiveKind::HeatOutflow => self.q,
            ObjectiveKind::WallHeat => self.wall_heat_flux,
            ObjectiveKind::FlowRate => self.flow_rate,
            ObjectiveKind::OutletTemperature => self.mean_outlet_temperature - config.fluid.inlet_temperature,
            // Of fixed particles around shapes, which are not measured here.
            _ => f64::NAN,
        }
    }
}

pub struct Finished<R> {
    pub diagnostics: Diagnostics,
    pub solver: Solver<R>,
    pub seconds: f64,
}

/// Runs a design and measures it. The observers see each state after it was measured.
pub fn simulate<R: Sweeps>(
    design: &Problem<R>,
    compute: impl Into<Compute>,
    start: &Snapshot<R>,
    observers: &mut [&mut dyn Observer<Sph<R>>],
) -> anyhow::Result<Finished<R>> {
    let clock = std::time::Instant::now();
    let dynamics = Sph::new(design.model.clone(), compute);
    let mut measurement = Measurement::of(design);
    let mut all: Vec<&mut dyn Observer<Sph<R>>> = vec![&mut measurement];
    for observer in observers {
        all.push(&mut **observer);
    }
    let solver = run(&dynamics, start, design.steps, &mut all)?;
    Ok(Finished { diagnostics: measurement.diagnostics(), solver, seconds: clock.elapsed().as_secs_f64() })
}

/// Where and when a flow is measured.
#[derive(Debug, Clone)]
pub struct Section {
    /// The targets that the flow passes; none in a closed box, where heat is that of all walls and all fluid.
    pub outlet: Option<Outlet>,
    /// Depth of the simulated domain; 1 in two dimensions.
    pub depth: f64,
    /// The steps after which is measured.
    pub steps: BTreeSet<usize>,
}

impl Section {
    /// The steps at which the objective of shapes is taken, so that both are one number; else up to a hundred in the
    /// objective's window, but not the initial state, which is given.
    pub fn of<R>(design: &Problem<R>) -> Self {
        let (steps, window) = (design.steps, design.window);
        let stride = window.div_ceil(SAMPLES).max(1);
        let steps = match design.deformation.map {
            Map::Shapes(_) => (1..=steps).filter(|&step| design.objective.weight(step).is_some()).collect(),
            _ => ((steps - window).max(1)..=steps).rev().step_by(stride).collect(),
        };
        Self { outlet: Some(design.outlet.clone()), depth: design.depth, steps }
    }
}

/// An observer that measures a run in the window of the objective.
pub struct Measurement<'a, R> {
    model: &'a Model<R>,
    section: Section,
    samples: Vec<Sample>,
}

/// What is measured after a step.
struct Sample {
    step: usize,
    q: f64,
    flow: f64,
    mass_flow: f64,
    wall: f64,
    density: f64,
    u_max: f64,
    force: f64,
    power: f64,
    /// Heat upstream of the targets.
    heat: f64,
    /// Mean temperature of the fluid above the inlet's.
    temperature: f64,
}

impl<R: Sweeps> Observer<Sph<R>> for Measurement<'_, R> {
    fn wants(&self, step: usize) -> bool {
        self.section.steps.contains(&step)
    }
    fn see(&mut self, dynamics: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<()> {
        if self.section.steps.contains(&solver.step) {
            self.samples.push(self.sample(dynamics, solver)?);
        }
        Ok(())
    }
}

impl<'a, R: Sweeps> Measurement<'a, R> {
    pub fn of(design: &'a Problem<R>) -> Self {
        Self::new(&design.model, Section::of(design))
    }

    pub fn new(model: &'a Model<R>, section: Section) -> Self {
        Self { model, section, samples: Vec::new() }
    }

    /// Discards the samples from `step` on.
    pub fn go_back(&mut self, step: usize) {
        self.samples.retain(|sample| sample.step < step);
    }

    fn sample(&self, dynamics: &Sph<R>, solver: &mut Solver<R>) -> anyhow::Result<Sample> {
        let (model, depth) = (self.model, self.section.depth);
        let (n, l) = (model.particles(), model.rows);
        let fields = dynamics.look(solver)?;
        let (flows, scale, target_x) = match &self.section.outlet {
            Some(outlet) => (outlet.numbers(&fields)?, outlet.spacing, outlet.place()),
            None => (Flows { mass: 0.0, volume: 0.0, heat: 0.0 }, 0.0, f64::INFINITY),
        };
        let wall = solver.wall_heat_flux(target_x)? / depth;
        let inlet = model.heat.as_ref().map_or(0.0, |h| h.inlet_below);
        let (mut density, mut fluids, mut fastest, mut heat, mut momentum) = (0.0, 0.0, f64::NEG_INFINITY, 0.0, 0.0);
        let (mut mass, mut warmth) = (0.0, 0.0);
        for i in (0..n).filter(|&i| model.is_fluid(i)) {
            density += solver.looked.density[i].f64();
            fluids += 1.0;
            let u = solver.state[l.velocity() * n + i].f64();
            fastest = fastest.max(u);
            momentum += solver.mass(i) * u;
            let x = solver.state[i].f64();
            if let Some(row) = l.temperature() {
                let excess = solver.mass(i) * solver.state[row * n + i].f64();
                warmth += excess;
                heat += if x > inlet && x < target_x { excess } else { 0.0 };
            }
            mass += solver.mass(i);
        }
        let force = solver.driving_force();
        Ok(Sample {
            step: solver.step,
            q: scale * flows.heat,
            flow: scale * flows.volume,
            mass_flow: scale * flows.mass,
            wall,
            density: density / fluids,
            u_max: fastest,
            force,
            power: force * momentum / depth,
            heat: heat / depth,
            temperature: warmth / mass,
        })
    }

    fn series(&self, of: fn(&Sample) -> f64) -> Vec<f64> {
        self.samples.iter().map(of).collect()
    }

    /// The averages over the samples.
    pub fn diagnostics(&self) -> Diagnostics {
        let sum = |of: fn(&Sample) -> f64| self.samples.iter().map(of).fold(0.0, |sum, x| sum + x);
        let mean = |of: fn(&Sample) -> f64| sum(of) / (self.samples.len() as f64).max(1.0);
        let model = self.model;
        let inlet = model.heat.as_ref().map_or(0.0, |h| h.reference);
        let heat: Vec<(f64, f64)> = self.samples.iter().map(|it| (it.step as f64 * model.dt, it.heat)).collect();
        let stored = slope(&heat);
        let (q_series, flow_series) = (self.series(|it| it.q), self.series(|it| it.flow));
        let (q, wall) = (mean(|it| it.q), mean(|it| it.wall));
        Diagnostics {
            q,
            flow_rate: mean(|it| it.flow),
            mean_outlet_temperature: inlet + sum(|it| it.q) / sum(|it| it.mass_flow),
            mean_temperature: inlet + mean(|it| it.temperature),
            wall_heat_flux: wall,
            stored_heat_rate: stored,
            energy_imbalance: (wall - q - stored) / wall,
            mean_density: mean(|it| it.density),
            u_max: mean(|it| it.u_max),
            body_force: mean(|it| it.force),
            pumping_power: mean(|it| it.power),
            q_drift: drift(&q_series),
            flow_rate_drift: drift(&flow_series),
            q_sampling: sampling(&q_series),
            flow_rate_sampling: sampling(&flow_series),
            unsettled: Unsettled {
                q: unsettled(&q_series),
                flow_rate: unsettled(&flow_series),
                wall_heat_flux: unsettled(&self.series(|it| it.wall)),
                mean_outlet_temperature: unsettled(&self.series(|it| it.q / it.mass_flow)),
                mean_temperature: unsettled(&self.series(|it| it.temperature)),
                u_max: unsettled(&self.series(|it| it.u_max)),
                pumping_power: unsettled(&self.series(|it| it.power)),
            },
        }
    }
}

/// Change of a series from its first half to its second.
fn change_of_halves(values: &[f64]) -> f64 {
    let (first, second) = values.split_at(values.len() / 2);
    mean(second) - mean(first)
}

/// Change of a series from its first half to its second, relative to the mean; none for fewer than four values.
pub fn drift(values: &[f64]) -> Option<f64> {
    if values.len() < 4 {
        return None;
    }
    Some(change_of_halves(values) / mean(values)).filter(|drift| drift.is_finite())
}

/// How far the mean of a series is from the value that it goes to; none for fewer than eight values.
///
/// It is the change from the first half to the second. If that stands out of the samples' scatter and all four quarters m_k go the same way,
/// the value is that of m_k = m + a r^k: the halves change by d, the quarters in each by r^2 = (m_4 - m_3) / (m_2 - m_1), and the mean is
/// d (1 + r^2) / (2 (1 - r^2)) from m (Aitken 1926). Where r^2 is above 0.9, as of a figure that has only begun to change, it is taken as 0.9.
pub fn unsettled(values: &[f64]) -> Option<f64> {
    const SLOWEST: f64 = 0.9;
    let (scatter, change) = (sampling(values)?, change_of_halves(values));
    let quarters: Vec<f64> = values.chunks_exact(values.len() / 4).take(4).map(mean).collect();
    let (early, late) = (quarters[1] - quarters[0], quarters[3] - quarters[2]);
    let share = (late / early).min(SLOWEST);
    let goes_on = change.abs() > 2.0 * scatter && share > 0.0 && change * early > 0.0;
    let factor = if goes_on { 0.5 * (1.0 + share) / (1.0 - share) } else { 1.0 };
    Some(factor.max(1.0) * change.abs()).filter(|distance| distance.is_finite())
}

/// Twice the standard error of a mean of samples that depend on each other: the largest one that blocks of 1, 2, 4, ... samples show, as
/// long as there are eight blocks (Flyvbjerg and Petersen 1989, J. Chem. Phys. 91:461). None for fewer than eight samples.
pub fn sampling(values: &[f64]) -> Option<f64> {
    let mut blocks = values.to_vec();
    let mut found: Option<f64> = None;
    while blocks.len() >= 8 {
        let n = blocks.len() as f64;
        let mean = blocks.iter().sum::<f64>() / n;
        let square = blocks.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (n * (n - 1.0));
        found = Some(found.unwrap_or(0.0).max(2.0 * square.sqrt()));
        blocks = blocks.chunks_exact(2).map(|pair| 0.5 * (pair[0] + pair[1])).collect();
    }
    found
}

/// Slope of the least-squares line, 0 for fewer than two points.
fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    if points.len() < 2 {
        return 0.0;
    }
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let covariance: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    covariance / points.iter().map(|p| (p.0 - mx).powi(2)).sum::<f64>()
}
