//! Custom scenes of fixed particles whose flow goes on in time: steps, and figures of each.

use super::around_shapes::{check_finite, no_flow, no_solution, tolerance, AroundShapes};
use super::periods::{Period, TooFew, Window};
use crate::config::formula::Function;
use crate::config::scene::Config;
use crate::error::Error;
use crate::numerics::curve::rises;
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
    /// NaN in a scene without one.
    pub objective: f64,
    /// What each of `limits` is about; NaN for those that are about shapes alone.
    pub limits: Vec<f64>,
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
    pub fn times(&self) -> Vec<f64> {
        self.moments.iter().map(|moment| moment.time).collect()
    }

    pub fn values(&self, value: &dyn Fn(&Moment) -> f64) -> Vec<f64> {
        self.moments.iter().map(value).collect()
    }

    /// A figure in a window; `value` takes it from a moment. Means are over time.
    pub fn course(&self, window: &Window, value: &dyn Fn(&Moment) -> f64) -> Course {
        let values = self.values(value);
        let mean = window.mean(&values);
        // Whole periods end between moments, so those beside belong to them.
        let beside = usize::from(!window.periods.is_empty());
        let last = values.len().saturating_sub(1);
        let first = self.moments.iter().position(|moment| moment.time >= window.from).unwrap_or(last);
        let end = self.moments.iter().rposition(|moment| moment.time <= window.to).unwrap_or(last);
        let first = first.saturating_sub(beside);
        let part = &values[first..=(end + beside).min(last)];
        let least = part.iter().copied().fold(f64::INFINITY, f64::min);
        let most = part.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let crossing = |j: usize| {
            let [before, after] = [&self.moments[first + j], &self.moments[first + j + 1]];
            before.time + (mean - part[j]) / (part[j + 1] - part[j]) * (after.time - before.time)
        };
        let crossings: Vec<f64> = rises(part, mean, 0.1 * (most - least)).into_iter().map(crossing).collect();
        let frequency = match (crossings.first(), crossings.last()) {
            (Some(first), Some(last)) if crossings.len() > 1 => Some((crossings.len() - 1) as f64 / (last - first)),
            _ => None,
        };
        Course { mean, least, most, frequency }
    }

    /// The mean objective in a window.
    pub fn objective(&self, window: &Window) -> f64 {
        window.mean(&self.values(&|moment| moment.objective))
    }

    /// The course of a figure by its index.
    pub fn of(&self, window: &Window, k: usize) -> Course {
        self.course(window, &|moment| moment.values[k])
    }
}

/// Which mean over a window: that of the objective, or of what a limit is about, by its index.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Of {
    Objective,
    Limit(usize),
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
        let shaped =
            cloud.shaped(&self.numbers(variables)).map_err(|why| no_solution(config, &NoSolution::from(why)))?;
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
            let limits = self.config().limits.iter().map(|limit| match limit.kind.is_of_outlines() {
                true => f64::NAN,
                false => self.terms_at(&at, &limit.asked()).0,
            });
            let moment = Moment { time, values, objective, limits: limits.collect() };
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
            Failure::Flow(why) => no_flow(config, &why),
            Failure::Other(error) => error,
        })?;
        history.factorisations = march.factorisations;
        history.moments = moments;
        let last = last.ok_or_else(|| Error::run("no step was taken".to_string(), "time.end above 0"))?;
        Ok((history, last))
    }

    /// The part of a run over which the objective is averaged.
    ///
    /// # Errors
    /// Fewer whole periods than `objective.periods`.
    pub fn window(&self, variables: &[f64], history: &History) -> Result<Window, Error> {
        let (config, times) = (self.config(), history.times());
        let end = config.time.end;
        let Some(count) = config.objective.periods else {
            return Ok(Window::since(&times, end - config.objective.window.min(end)));
        };
        let period = self.period(variables)?;
        let found = match &period {
            Some(period) => Window::of_length(&times, count, period),
            None => Window::of_course(&times, &history.values(&|moment| moment.objective), count),
        };
        found.map_err(|TooFew(most)| {
            let (what, otherwise) = match period {
                Some(Period { length, .. }) => (format!("only {most} of {length:.6} fit into the run"), ""),
                None => (
                    format!("the objective rises through its mean only so often that the run has {most}"),
                    ", or objective.period where a force gives it, or objective.window",
                ),
            };
            let advice = format!("time.end={}{otherwise}", 2.0 * end);
            Error::run(format!("there are no {count} whole periods (objective.periods): {what}"), advice)
        })
    }

    /// The whole last half of a run, where there is no other window.
    pub fn last_half(&self, history: &History) -> Window {
        Window::since(&history.times(), 0.5 * self.config().time.end)
    }

    /// `objective.period` for these variables.
    fn period(&self, variables: &[f64]) -> Result<Option<Period>, Error> {
        let config = self.config();
        let at = |variables: &[f64]| config.period(&config.with_shape_values(variables).shapes);
        let Some(length) = at(variables)? else { return Ok(None) };
        let mut by_variables = vec![0.0; variables.len()];
        for (k, by) in by_variables.iter_mut().enumerate() {
            if !self.flow.cloud.is_parameter(self.wanted[k]) {
                continue;
            }
            let step = 1e-5 * variables[k].abs().max(1e-3);
            let moved = |sign: f64| {
                let mut moved = variables.to_vec();
                moved[k] += sign * step;
                at(&moved).map(|length| length.unwrap_or(f64::NAN))
            };
            *by = (moved(1.0)? - moved(-1.0)?) / (2.0 * step);
        }
        Ok(Some(Period { length, by_variables }))
    }

    /// The derivative of the mean of the window by the variables, along the steps of a history.
    ///
    /// # Errors
    /// As [`Self::march`] and [`Self::window`].
    pub fn march_gradient(&self, variables: &[f64], history: &History, of: Of) -> Result<Vec<f64>, Error> {
        let window = self.window(variables, history)?;
        let values = history.values(&|moment| match of {
            Of::Objective => moment.objective,
            Of::Limit(k) => moment.limits[k],
        });
        let slopes = window.slopes(&history.times(), &values);
        let Begun { shaped, first, mut march, flow_rate, start } = self.begin(variables)?;
        let cloud = &self.flow.cloud;
        let boundary = Boundary { cloud, shaped: &shaped, start, wanted: &self.wanted };
        let (equations, read_at) = (march.equations().clone(), self.flow.measures.read_at());
        let mut figures = |k: usize, state: &State, bar: &mut Bar| {
            let by_objective = slopes.by_objective.get(k).copied().unwrap_or(0.0);
            let by_value = slopes.by_values[k];
            if by_value == 0.0 && by_objective == 0.0 {
                return;
            }
            let derivatives = equations.derivatives_at(&shaped.operators, state, &read_at);
            let at = At { equations: &equations, shaped: &shaped, state, d: &derivatives };
            let mut pull_back = |terms: Vec<(Figure, f64)>, by: f64| {
                for (figure, weight) in terms.into_iter().filter(|_| by != 0.0) {
                    self.flow.measures.pull_back(figure, &at, by * weight, bar);
                }
            };
            match of {
                Of::Objective => pull_back(self.objective_at(&at).1, by_value + by_objective),
                Of::Limit(limit) => {
                    pull_back(self.terms_at(&at, &self.config().limits[limit].asked()).1, by_value);
                    pull_back(self.objective_at(&at).1, by_objective);
                }
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
        let found =
            taken.pull_back(&mut march, &mut figures, self.wanted.len()).map_err(|why| no_flow(self.config(), &why))?;
        let mut all = cloud.by_numbers(&shaped, &found.position, &found.bar, &self.wanted, None);
        all.iter_mut().zip(found.parameters).for_each(|(all, by)| *all += by);
        all.iter_mut().zip(slopes.by_variables).for_each(|(all, by)| *all += by);
        check_finite(self.config(), &all)?;
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
