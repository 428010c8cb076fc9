//! Custom scenes of fixed particles whose flow goes on in time: steps, and figures of each.

use super::around_shapes::{no_solution, tolerance, AroundShapes};
use crate::config::formula::Function;
use crate::config::scene::Config;
use crate::error::Error;
use crate::numerics::{interrupt, threads};
use crate::sph::cloud::equations::{Bar, Condition, Motion, State, Warmth};
use crate::sph::cloud::figures::{At, Figure, Rate};
use crate::sph::cloud::particles::{Cloud, Shaped};
use crate::sph::cloud::problem::{NoSolution, Solution};
use crate::sph::cloud::steady::{Held, NoSteadyState};
use crate::sph::cloud::unsteady::{Control, Flow, InTime, March};
use crate::sph::cloud::unsteady_adjoint::Taken;
use std::sync::Arc;

/// The figures of one time, in the order of [`History::figures`].
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
        let part: Vec<(f64, f64)> = self.moments[self.first(from)..].iter().map(|m| (m.time, value(m))).collect();
        let mean = self.mean(from, value);
        let least = part.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let most = part.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
        // Crossings of a band around the mean, so that noise makes none.
        let band = 0.1 * (most - least);
        let (mut is_low, mut crossings) = (false, vec![]);
        for pair in part.windows(2) {
            is_low |= pair[0].1 < mean - band;
            if is_low && pair[0].1 < mean && pair[1].1 >= mean {
                let share = (mean - pair[0].1) / (pair[1].1 - pair[0].1);
                crossings.push(pair[0].0 + share * (pair[1].0 - pair[0].0));
                is_low = false;
            }
        }
        let frequency = match (crossings.first(), crossings.last()) {
            (Some(first), Some(last)) if crossings.len() > 1 => Some((crossings.len() - 1) as f64 / (last - first)),
            _ => None,
        };
        Course { mean, least, most, frequency }
    }

    /// The first moment from a time on; the last one if rounding has put it before that.
    fn first(&self, from: f64) -> usize {
        let found = self.moments.iter().position(|moment| moment.time >= from);
        found.unwrap_or(self.moments.len().saturating_sub(1))
    }

    /// Of each moment its weight in a mean over time from `from` on, by trapezes.
    pub fn weights(&self, from: f64) -> Vec<f64> {
        let mut weights = vec![0.0; self.moments.len()];
        for k in self.first(from) + 1..self.moments.len() {
            let half = 0.5 * (self.moments[k].time - self.moments[k - 1].time);
            weights[k - 1] += half;
            weights[k] += half;
        }
        let total: f64 = weights.iter().sum();
        match weights.last_mut() {
            Some(last) if total == 0.0 => *last = 1.0,
            _ => weights.iter_mut().for_each(|weight| *weight /= total),
        }
        weights
    }

    fn mean(&self, from: f64, value: &dyn Fn(&Moment) -> f64) -> f64 {
        self.weights(from).iter().zip(&self.moments).filter(|(w, _)| **w != 0.0).map(|(w, m)| w * value(m)).sum()
    }

    /// The mean objective from `from` on.
    pub fn objective(&self, from: f64) -> f64 {
        self.mean(from, &|moment| moment.objective)
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
    /// The formulas of fields at the start that depend on the place.
    start: Vec<(usize, Function)>,
    /// Numbers by which derivatives are wanted: shape and number.
    wanted: &'a [(usize, usize)],
}

impl InTime for Boundary<'_> {
    fn conditions(&self, time: f64) -> Vec<Condition> {
        self.cloud.conditions_at(self.shaped, time)
    }

    fn changes(&self) -> bool {
        self.cloud.surroundings.has_time()
    }

    fn pull_back(&self, time: f64, bar: &Bar, position: &mut [Vec<f64>; 2], parameters: &mut [f64]) {
        for (to, &wanted) in parameters.iter_mut().zip(self.wanted).filter(|(_, &w)| self.cloud.is_parameter(w)) {
            *to += self.cloud.by_parameter(self.shaped, bar, wanted, time);
        }
        let inside = self.cloud.places.inside;
        for (k, by_place) in self.cloud.conditions_back(self.shaped, bar, Some(time)).iter().enumerate() {
            (0..2).for_each(|d| position[d][inside + k] += by_place[d]);
        }
    }

    fn of_start(&self, fields: &[Vec<f64>; 4], bar: &mut Bar, position: &mut [Vec<f64>; 2]) {
        let inside = self.cloud.places.inside;
        for (k, condition) in self.shaped.conditions.iter().enumerate() {
            let to = &mut bar.boundary[k];
            if let Motion::Given(_) = condition.motion {
                (0..2).for_each(|e| to.velocity[e] += fields[e][inside + k]);
            }
            if let Warmth::Given(_) = condition.warmth {
                to.temperature += fields[3][inside + k];
            }
        }
        // Formulas of the start know where particles are.
        let step = 1e-5 * self.cloud.ground.dx;
        for (f, function) in &self.start {
            for i in 0..inside {
                for d in 0..2 {
                    let at = |sign: f64| {
                        let mut place = [self.shaped.position[0][i], self.shaped.position[1][i], 0.0];
                        place[d] += sign * step;
                        function.at(place)
                    };
                    position[d][i] += fields[*f][i] * (at(1.0) - at(-1.0)) / (2.0 * step);
                }
            }
        }
    }
}

/// The state that a scene begins with, by the formulas of its fields.
fn first_state(
    config: &Config,
    shaped: &Shaped,
    inside: usize,
    (velocity, temperature): (&[Function], Option<&Function>),
) -> State {
    let n = shaped.position[0].len();
    let mut state = State::at_rest(n);
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
        state.fields[3][i] = match (of_wall.map(|condition| condition.warmth), temperature) {
            (Some(Warmth::Given(given)), _) => given,
            (_, Some(function)) => function.at(place) - config.fluid.inlet_temperature,
            _ => 0.0,
        };
    }
    state
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
        // Which sides the fluid enters by is known of inflows that do not change.
        if !self.flow.cloud.surroundings.has_time() {
            all.push(("pressure_drop".into(), Figure::PressureDrop));
        }
        all
    }

    fn begin(&self, variables: &[f64]) -> Result<Begun, Error> {
        let (config, cloud) = (self.config(), &self.flow.cloud);
        let shaped = cloud.shaped(&self.numbers(variables)).map_err(|why| no_solution(config, &why.into()))?;
        let (velocity, temperature) = config.initial.at_start(2)?;
        let first = first_state(config, &shaped, cloud.places.inside, (&velocity, temperature.as_ref()));
        let rate = Rate { measures: &self.flow.measures, shaped: &shaped };
        let held = self.flow.held.as_ref().map(|held| (held, &rate as _));
        let march =
            March::new(cloud.equations(&shaped), &cloud.places.place, &shaped.operators, held, threads::count());
        let flow_rate = self.flow.held.as_ref().map(|held| match held {
            Held::FlowRate(rate) => *rate,
            // Refused for flows in time.
            Held::Power { .. } => f64::NAN,
        });
        let start = velocity.into_iter().enumerate().chain(temperature.map(|function| (3, function)));
        let start = start.filter(|(_, function)| !function.is_constant()).collect();
        Ok(Begun { shaped: Arc::new(shaped), first, march, flow_rate, start })
    }

    /// The flow in time for these variables, from `[initial]` to `time.end`; `sizes`: those of the steps of an earlier run. `watch` gets
    /// each moment and its solution, whose derivatives are those at the boundary and where figures are read.
    ///
    /// # Errors
    /// A cloud that folds, a flow that diverges; [`Error::Stopped`].
    pub fn march(
        &self,
        variables: &[f64],
        sizes: Option<&[f64]>,
        watch: &mut dyn FnMut(&Moment, &Solution) -> Result<(), Error>,
    ) -> Result<(History, Solution), Error> {
        let config = self.config();
        let Begun { shaped, first, mut march, flow_rate, start } = self.begin(variables)?;
        let cloud = &self.flow.cloud;
        let mut history = History { figures: self.named_figures(), ..History::default() };
        let (has_objective, read_at) = (self.has_objective(), self.flow.measures.read_at());
        let boundary = Boundary { cloud, shaped: &shaped, start, wanted: &[] };
        let equations = march.equations().clone();
        let (mut last, mut moments) = (None, vec![]);
        let mut seen = |time: f64, state: &State| -> Result<(), Failure> {
            interrupt::check().map_err(Failure::Other)?;
            let derivatives = equations.derivatives_at(&shaped.operators, state, &read_at);
            let at = At { equations: &equations, shaped: &shaped, state, d: &derivatives };
            let values = history.figures.iter().map(|(_, figure)| self.value_at(&at, *figure)).collect();
            let objective = if has_objective { self.objective_at(&at).0 } else { f64::NAN };
            let moment = Moment { time, values, objective };
            let solution = Solution { shaped: Arc::clone(&shaped), state: state.clone(), derivatives };
            watch(&moment, &solution).map_err(Failure::Other)?;
            moments.push(moment);
            last = Some(solution);
            Ok(())
        };
        let mut flow = Flow {
            march: &mut march,
            operators: &shaped.operators,
            boundary: &boundary,
            flow_rate,
            spacing: &cloud.places.spacing,
        };
        let control = Control {
            tolerance: tolerance(config),
            velocity: config.fluid.reference_velocity,
            fixed: config.time.step,
            end: config.time.end,
        };
        let taken = match sizes {
            Some(sizes) => flow.repeat(first, sizes, &mut seen).map(|()| sizes.to_vec()),
            None => flow.run(first, control, &mut seen),
        };
        history.sizes = taken.map_err(|failure| match failure {
            Failure::Flow(why) => no_solution(config, &NoSolution::Flow(why)),
            Failure::Other(error) => error,
        })?;
        history.factorisations = march.factorisations;
        history.moments = moments;
        let last = last.ok_or_else(|| Error::run("no step was taken".to_string(), "time.end above 0"))?;
        Ok((history, last))
    }

    /// The beginning of the window over which the objective is averaged.
    pub fn window(&self) -> f64 {
        let config = self.config();
        config.time.end - config.objective.window.min(config.time.end)
    }

    /// The derivative of the mean objective of the window by the variables, along the steps of a history.
    ///
    /// # Errors
    /// As [`Self::march`].
    pub fn march_gradient(&self, variables: &[f64], history: &History) -> Result<Vec<f64>, Error> {
        let Begun { shaped, first, mut march, flow_rate, start } = self.begin(variables)?;
        let cloud = &self.flow.cloud;
        let boundary = Boundary { cloud, shaped: &shaped, start, wanted: &self.wanted };
        let weights = history.weights(self.window());
        let (equations, read_at) = (march.equations().clone(), self.flow.measures.read_at());
        let mut figures = |k: usize, state: &State, bar: &mut Bar| {
            if weights[k] == 0.0 {
                return;
            }
            let derivatives = equations.derivatives_at(&shaped.operators, state, &read_at);
            let at = At { equations: &equations, shaped: &shaped, state, d: &derivatives };
            for (figure, weight) in self.objective_at(&at).1 {
                self.flow.measures.pull_back(figure, &at, weights[k] * weight, bar);
            }
        };
        let flow_rate_back = |state: &State, weight: f64, bar: &mut Bar| {
            let derivatives = equations.derivatives_at(&shaped.operators, state, &read_at);
            let at = At { equations: &equations, shaped: &shaped, state, d: &derivatives };
            self.flow.measures.pull_back(Figure::FlowRate, &at, weight, bar);
        };
        let taken = Taken {
            operators: &shaped.operators,
            position: &shaped.position,
            boundary: &boundary,
            flow_rate,
            first: &first,
            sizes: &history.sizes,
            flow_rate_back: &flow_rate_back,
        };
        let found = taken
            .pull_back(&mut march, &mut figures, self.wanted.len())
            .map_err(|why| no_solution(self.config(), &NoSolution::Flow(why)))?;
        let mut all = cloud.by_numbers(&shaped, &found.position, &found.bar, &self.wanted, None);
        all.iter_mut().zip(found.parameters).for_each(|(all, by)| *all += by);
        Ok(all)
    }
}

/// What a flow begins with.
struct Begun {
    shaped: Arc<Shaped>,
    first: State,
    march: March,
    flow_rate: Option<f64>,
    start: Vec<(usize, Function)>,
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
