//! Custom scenes of fixed particles whose flow goes on in time: steps, and figures of each.

use super::around_shapes::{no_solution, AroundShapes};
use crate::config::scene::Config;
use crate::error::Error;
use crate::numerics::{interrupt, threads};
use crate::sph::cloud::equations::{Condition, Motion, State, Warmth};
use crate::sph::cloud::figures::{At, Figure, Rate};
use crate::sph::cloud::particles::{Cloud, Shaped};
use crate::sph::cloud::problem::{NoSolution, Solution};
use crate::sph::cloud::steady::{Held, NoSteadyState};
use crate::sph::cloud::unsteady::{Control, Flow, InTime, March};
use std::sync::Arc;

/// The figures of one time, by [`History::names`].
#[derive(Debug, Clone, PartialEq)]
pub struct Moment {
    pub time: f64,
    pub values: Vec<f64>,
    pub objective: f64,
}

/// Figures over time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct History {
    pub figures: Vec<(String, Figure)>,
    pub moments: Vec<Moment>,
    /// Sizes of steps.
    pub sizes: Vec<f64>,
    pub factorisations: usize,
}

/// How a figure goes through a part of a history.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Course {
    pub mean: f64,
    pub least: f64,
    pub most: f64,
    /// Of crossings of its mean, upwards; none with fewer than two of them.
    pub frequency: Option<f64>,
}

impl History {
    /// A figure from time `from` on; `value` takes it from a moment. Means are over time.
    pub fn course(&self, from: f64, value: &dyn Fn(&Moment) -> f64) -> Course {
        let part: Vec<(f64, f64)> =
            self.moments.iter().filter(|m| m.time >= from).map(|m| (m.time, value(m))).collect();
        let span = |pair: &[(f64, f64)]| pair[1].0 - pair[0].0;
        let total: f64 = part.windows(2).map(span).sum();
        let sum: f64 = part.windows(2).map(|pair| span(pair) * 0.5 * (pair[0].1 + pair[1].1)).sum();
        let mean = if total > 0.0 { sum / total } else { part.last().map_or(f64::NAN, |last| last.1) };
        let least = part.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let most = part.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
        // Crossings of a band around the mean, so that noise makes none.
        let band = 0.1 * (most - least);
        let (mut is_low, mut crossings) = (false, vec![]);
        for pair in part.windows(2) {
            is_low |= pair[0].1 < mean - band;
            if is_low && pair[0].1 < mean && pair[1].1 >= mean {
                let share = (mean - pair[0].1) / (pair[1].1 - pair[0].1);
                crossings.push(pair[0].0 + share * span(pair));
                is_low = false;
            }
        }
        let frequency = match (crossings.first(), crossings.last()) {
            (Some(first), Some(last)) if crossings.len() > 1 => Some((crossings.len() - 1) as f64 / (last - first)),
            _ => None,
        };
        Course { mean, least, most, frequency }
    }

    /// The course of a figure by its index.
    pub fn of(&self, from: f64, k: usize) -> Course {
        self.course(from, &|moment| moment.values[k])
    }
}

/// The boundary of one shape in time.
struct Boundary<'a> {
    cloud: &'a Cloud,
    shaped: &'a Shaped,
}

impl InTime for Boundary<'_> {
    fn conditions(&self, time: f64) -> Vec<Condition> {
        self.cloud.conditions_at(self.shaped, time)
    }

    fn changes(&self) -> bool {
        self.cloud.surroundings.has_time()
    }
}

/// The state that a scene begins with.
fn first_state(config: &Config, shaped: &Shaped, inside: usize) -> Result<State, Error> {
    let n = shaped.position[0].len();
    let mut state = State::at_rest(n);
    let (velocity, temperature) = config.initial.at_start(2)?;
    for i in 0..n {
        let place = [shaped.position[0][i], shaped.position[1][i], 0.0];
        let of_wall = i.checked_sub(inside).map(|k| shaped.conditions[k]);
        for e in 0..2 {
            state.fields[e][i] = match of_wall.map(|condition| condition.motion) {
                Some(Motion::Given(given)) => given[e],
                Some(Motion::Symmetry(d)) if d == e => 0.0,
                _ => velocity.get(e).map_or(0.0, |function| function.at(place)),
            };
        }
        state.fields[3][i] = match (of_wall.map(|condition| condition.warmth), &temperature) {
            (Some(Warmth::Given(given)), _) => given,
            (_, Some(function)) => function.at(place) - config.fluid.inlet_temperature,
            _ => 0.0,
        };
    }
    Ok(state)
}

impl AroundShapes {
    /// The figures of a history by name: forces, torque and heat of each shape, flow rate, heat outflow, pressure drop.
    fn named_figures(&self) -> Vec<(String, Figure)> {
        let has_heat = self.config().initial.temperature.is_some();
        let mut all = vec![];
        for &shape in &self.flow.cloud.places.touching {
            let name = |what: &str| format!("shapes[{shape}].{what}");
            all.push((name("drag"), Figure::Force { shape, along: 0 }));
            all.push((name("lift"), Figure::Force { shape, along: 1 }));
            all.push((name("torque"), Figure::Torque { shape }));
            if has_heat {
                all.push((name("heat"), Figure::Heat { shape }));
            }
        }
        all.push(("flow_rate".into(), Figure::FlowRate));
        if has_heat {
            all.push(("heat_outflow".into(), Figure::HeatOutflow));
        }
        all.push(("pressure_drop".into(), Figure::PressureDrop));
        all
    }

    /// The flow in time around the shapes as they are, from `[initial]` to `time.end`. `watch` gets each moment and its solution, whose
    /// derivatives are those at the boundary and where figures are read.
    ///
    /// # Errors
    /// A flow that diverges; [`Error::Stopped`].
    pub fn march(
        &mut self,
        watch: &mut dyn FnMut(&Moment, &Solution) -> Result<(), Error>,
    ) -> Result<(History, Solution), Error> {
        let config = self.config().clone();
        let tolerance = config.unsteady().map_or(1e-4, |fixed| fixed.tolerance);
        let cloud = &self.flow.cloud;
        let shaped = cloud.shaped(&cloud.numbers()).map_err(|why| no_solution(&config, &why.into()))?;
        let (equations, inside) = (cloud.equations(&shaped), cloud.places.inside);
        let mut state = first_state(&config, &shaped, inside)?;
        let rate = Rate { measures: &self.flow.measures, shaped: &shaped };
        let held = self.flow.held.as_ref().map(|held| (held, &rate as _));
        let mut march = March::new(equations, &cloud.places.place, &shaped.operators, held, threads::count());
        let flow_rate = self.flow.held.as_ref().map(|held| match held {
            Held::FlowRate(rate) => *rate,
            Held::Power { .. } => f64::NAN,
        });
        state.drive = 0.0;
        let figures = self.named_figures();
        let has_objective = self.has_objective();
        let read_at = self.flow.measures.read_at();
        let mut history = History { figures, ..History::default() };
        let boundary = Boundary { cloud, shaped: &shaped };
        let control = Control {
            tolerance,
            velocity: config.fluid.reference_velocity,
            fixed: config.time.step,
            end: config.time.end,
        };
        let of_figures = march.equations().clone();
        let mut last = None;
        let mut moments = vec![];
        let mut flow = Flow {
            march: &mut march,
            operators: &shaped.operators,
            boundary: &boundary,
            flow_rate,
            spacing: &cloud.places.spacing,
        };
        let around = &*self;
        let shared = Arc::new(shaped.clone());
        let mut seen = |time: f64, _: f64, state: &State| -> Result<(), Failure> {
            interrupt::check().map_err(|_| Failure::Other(Error::Stopped))?;
            let derivatives = of_figures.derivatives_at(&shared.operators, state, &read_at);
            let at = At { equations: &of_figures, shaped: &shared, state, d: &derivatives };
            let values = history.figures.iter().map(|(_, figure)| around.value_at(&at, *figure)).collect();
            let objective = if has_objective { around.objective_at(&at).0 } else { f64::NAN };
            let moment = Moment { time, values, objective };
            let solution = Solution { shaped: Arc::clone(&shared), state: state.clone(), derivatives };
            watch(&moment, &solution).map_err(Failure::Other)?;
            moments.push(moment);
            last = Some(solution);
            Ok(())
        };
        let sizes = flow.run(state, control, &mut seen).map_err(|failure| match failure {
            Failure::Flow(NoSteadyState::Diverged { residual: time }) => Error::diverged(
                format!("the flow is not finite after t = {time:.4}"),
                format!("method.tolerance={:e}, or {}", 0.1 * tolerance, self.finer_advice()),
            ),
            Failure::Flow(why) => no_solution(&config, &NoSolution::Flow(why)),
            Failure::Other(error) => error,
        })?;
        history.factorisations = march.factorisations;
        history.moments = moments;
        history.sizes = sizes;
        let last = last.ok_or_else(|| Error::run("no step was taken".to_string(), "time.end above 0"))?;
        Ok((history, last))
    }
}

enum Failure {
    Flow(NoSteadyState),
    Other(Error),
}

impl From<NoSteadyState> for Failure {
    fn from(why: NoSteadyState) -> Self {
        Self::Flow(why)
    }
}
