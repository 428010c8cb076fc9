//! Fixed particles around shapes whose flow goes on in time, in two or three dimensions: steps, figures of each, and the exact
//! derivative of their means.

use super::around_flow::Around;
use super::around_shapes::{check_finite, no_flow, tolerance};
use super::history::{Derivative, History, Moment, Of, Watch};
use crate::config::formula::Function;
use crate::config::scene::ObjectiveKind;
use crate::error::Error;
use crate::numerics::grid_field::GridVelocity;
use crate::numerics::interrupt;
use crate::sph::cloud::conditions::Conditions;
use crate::sph::cloud::equations::{Bar, Condition, Motion, State, Warmth};
use crate::sph::cloud::figures::Figure;
use crate::sph::cloud::sound::{self, Medium, WithSound};
use crate::sph::cloud::sound_adjoint::Heard;
use crate::sph::cloud::steady::{Held, NoSteadyState};
use crate::sph::cloud::unsteady::{Control, Flow, InTime, Reached, Scheme};
use crate::sph::cloud::unsteady_adjoint::Taken;
use std::sync::Arc;

/// A cloud for some numbers of its shapes.
#[derive(Clone, Copy)]
pub struct View<'a, const D: usize> {
    pub numbers: &'a [Vec<f64>],
    /// `[D][N]`.
    pub position: &'a [Vec<f64>; D],
    /// What holds on the boundary at the start.
    pub conditions: &'a [Condition<D>],
}

impl<const D: usize> View<'_, D> {
    /// A particle's place, as formulas take it.
    fn place(&self, i: usize) -> [f64; 3] {
        std::array::from_fn(|d| if d < D { self.position[d][i] } else { 0.0 })
    }
}

/// A flow around shapes in D dimensions that can go on in time, with F = D + 2 fields and fits of C coefficients.
pub trait Marching<const D: usize, const F: usize, const C: usize>: Around {
    type Cloud: Conditions<D>;
    type Shaped;
    type March<'a>: Scheme<D, F, C>
    where
        Self: 'a;

    fn cloud(&self) -> &Self::Cloud;
    /// Shape and number of each variable.
    fn wanted(&self) -> &[(usize, usize)];
    /// Whether the derivative is wanted by the viscosity, too.
    fn by_viscosity(&self) -> bool;
    /// Spacing of each particle.
    fn spacing(&self) -> &[f64];
    fn held(&self) -> Option<&Held>;
    /// The velocity at the start where a grid gives it instead of formulas.
    fn start(&self) -> Option<&GridVelocity> {
        None
    }
    /// Adds the cotangents of a state, given those of its velocity on `output.grid`, `[points, D]`.
    fn grid_back(&self, _shaped: &Arc<Self::Shaped>, _state: &State<F>, _by: &[f64], _bar: &mut Bar<D, F, C>) {}
    /// Numbers of shapes of which a history has figures.
    fn shapes_of_history(&self) -> Vec<usize>;
    /// The cloud for these variables.
    ///
    /// # Errors
    /// A cloud that folds.
    fn shaped(&self, variables: &[f64]) -> Result<Self::Shaped, Error>;
    fn view(shaped: &Self::Shaped) -> View<'_, D>;
    fn scheme<'a>(&'a self, shaped: &'a Self::Shaped) -> Self::March<'a>;
    /// What a flow with sound needs of the cloud.
    fn medium<'a>(&'a self, shaped: &'a Self::Shaped) -> Medium<'a, D, C>;
    /// A state with its derivatives at the boundary and where figures are read.
    fn seen(&self, shaped: &Arc<Self::Shaped>, time: f64, reached: Reached<'_, F>) -> Self::Solution;
    /// Adds the cotangents of a figure times a weight.
    fn pull_back(&self, figure: Figure, solution: &Self::Solution, weight: f64, bar: &mut Bar<D, F, C>);
    /// The derivative by the variables, given the cotangents of positions and boundary, but for conditions.
    ///
    /// # Errors
    /// A map whose transposed equations are not solved.
    fn by_variables(
        &self,
        shaped: &Self::Shaped,
        position: &[Vec<f64>; D],
        bar: &Bar<D, F, C>,
    ) -> Result<Vec<f64>, Error>;

    /// The figures of a history by name: forces, torque and heat of each shape, flow rate, heat outflow, pressure drop.
    fn named_figures(&self) -> Vec<(String, Figure)> {
        let has_heat = self.config().initial.temperature.is_some();
        let mut all = vec![];
        for shape in self.shapes_of_history() {
            let name = |what: &str| format!("shapes[{shape}].{what}");
            for (along, what) in ["drag", "lift", "side_force"].into_iter().enumerate().take(D) {
                all.push((name(what), Figure::Force { shape, along }));
            }
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
        if !self.cloud().has_time() {
            all.push(("pressure_drop".into(), Figure::PressureDrop));
        }
        all
    }

    /// What a flow begins with.
    ///
    /// # Errors
    /// Formulas that cannot be read, and a cloud that folds.
    fn begin(&self, variables: &[f64]) -> Result<Begun<'_, Self::Shaped, F>, Error> {
        let shaped = self.shaped(variables)?;
        let (velocity, temperature) = self.config().initial.at_start(D)?;
        let reference = self.config().fluid.inlet_temperature;
        let by_formula = |field: usize, function: Function, reference: f64| {
            let varies = !function.is_constant();
            Start { field, varies, at: Box::new(move |place| function.at(place) - reference) }
        };
        let mut start: Vec<Start<'_>> = match self.start() {
            Some(GridVelocity { grid, velocity }) => (velocity.iter().enumerate())
                .map(|(e, field)| Start { field: e, varies: true, at: Box::new(|[x, y, _]| grid.value(field, [x, y])) })
                .collect(),
            None => velocity.into_iter().enumerate().map(|(e, function)| by_formula(e, function, 0.0)).collect(),
        };
        start.extend(temperature.map(|function| by_formula(D + 1, function, reference)));
        let first = first_state(Self::view(&shaped), self.cloud().inside(), &start);
        let flow_rate = self.held().map(|held| match held {
            Held::FlowRate(rate) => *rate,
            // Refused for flows in time.
            Held::Power { .. } => f64::NAN,
        });
        Ok(Begun { shaped: Arc::new(shaped), first, flow_rate, start })
    }

    /// See [`Around::march`].
    ///
    /// # Errors
    /// As there.
    fn go(
        &self,
        variables: &[f64],
        sizes: Option<&[f64]>,
        watch: Watch<'_, Self::Solution>,
    ) -> Result<(History, Self::Solution), Error> {
        let config = self.config();
        let Begun { shaped, first, flow_rate, start } = self.begin(variables)?;
        let mut history = History { figures: self.named_figures(), ..History::default() };
        let boundary = Boundary { cloud: self.cloud(), view: Self::view(&shaped), start, wanted: &[] };
        let (mut last, mut moments) = (None, vec![]);
        let mut seen = |time: f64, reached: Reached<'_, F>| -> Result<(), Failure> {
            interrupt::check().map_err(Failure::Other)?;
            let solution = self.seen(&shaped, time, reached);
            let values = history.figures.iter().map(|(_, figure)| self.value(&solution, *figure)).collect();
            let objective = if self.has_objective() { self.objective(&solution).0 } else { f64::NAN };
            let limits = config.limits.iter().map(|limit| match limit.kind {
                kind if kind.is_of_outlines() || kind == ObjectiveKind::Volume => f64::NAN,
                _ => self.terms(&solution, &limit.asked()).0,
            });
            let moment = Moment { time, values, objective, limits: limits.collect() };
            watch(&moment, &solution).map_err(Failure::Other)?;
            moments.push(moment);
            last = Some(solution);
            Ok(())
        };
        let control = Control {
            tolerance: tolerance(config),
            velocity: config.fluid.reference_velocity,
            fixed: config.time.step,
            end: config.time.end,
        };
        let taken = if config.has_sound() {
            let chosen = sound::sizes(control, self.spacing());
            let sizes = sizes.unwrap_or(&chosen);
            self.with_sound(&shaped, first, &boundary, sizes, &mut seen).map(|count| (sizes.to_vec(), count))
        } else {
            let mut march = self.scheme(&shaped);
            let mut flow = Flow { march: &mut march, boundary: &boundary, flow_rate, spacing: self.spacing() };
            let taken = match sizes {
                Some(sizes) => flow.repeat(first, sizes, &mut seen).map(|()| sizes.to_vec()),
                None => flow.run(first, control, &mut seen),
            };
            taken.map(|sizes| (sizes, march.factorisations()))
        };
        (history.sizes, history.factorisations) = taken.map_err(|failure| match failure {
            Failure::Flow(why) => no_flow(config, &why),
            Failure::Other(error) => error,
        })?;
        history.moments = moments;
        let last = last.ok_or_else(|| Error::run("no step was taken".to_string(), "time.end above 0"))?;
        Ok((history, last))
    }

    /// Takes steps of these sizes from `first` on, the first ones of an incompressible fluid and the others with sound. Returns how many
    /// matrices the first ones took.
    ///
    /// # Errors
    /// A flow that is not finite, and those of `seen`.
    fn with_sound<E: From<NoSteadyState>>(
        &self,
        shaped: &Self::Shaped,
        first: State<F>,
        boundary: &dyn InTime<D, F, C>,
        sizes: &[f64],
        seen: &mut dyn FnMut(f64, Reached<'_, F>) -> Result<(), E>,
    ) -> Result<usize, E> {
        let (at_first, others) = sizes.split_at(sound::FIRST.min(sizes.len()));
        let mut last = (0.0, first.clone());
        let factorisations = {
            let mut march = self.scheme(shaped);
            let mut flow = Flow { march: &mut march, boundary, flow_rate: None, spacing: self.spacing() };
            flow.repeat(first, at_first, &mut |time, reached| {
                last = (time, reached.state.clone());
                seen(time, reached)
            })?;
            march.factorisations()
        };
        if !others.is_empty() {
            let flow = WithSound::new(self.medium(shaped))?;
            flow.run((last.0, &last.1), boundary, self.config().fluid.reference_velocity, others, seen)?;
        }
        Ok(factorisations)
    }

    /// See [`Around::march_gradient`]. `memory`: bytes for states; with fewer more of them are made again.
    ///
    /// # Errors
    /// As there.
    fn go_back(&self, variables: &[f64], history: &History, of: Of<'_>, memory: usize) -> Result<Derivative, Error> {
        let (times, last) = (history.times(), history.sizes.len().saturating_sub(1));
        let slopes = match of {
            Of::Grid(_) => None,
            Of::Objective => Some(history.values(&|moment| moment.objective)),
            Of::Limit(k) => Some(history.values(&|moment| moment.limits[k])),
        };
        let slopes = slopes.map(|values| Ok::<_, Error>(self.window(variables, history)?.slopes(&times, &values)));
        let slopes = slopes.transpose()?;
        let Begun { shaped, first, flow_rate, start } = self.begin(variables)?;
        let view = Self::view(&shaped);
        let boundary = Boundary { cloud: self.cloud(), view, start, wanted: self.wanted() };
        let mut figures = |k: usize, reached: Reached<'_, F>, bar: &mut Bar<D, F, C>| {
            let Some(slopes) = &slopes else {
                match of {
                    Of::Grid(by) if k == last => self.grid_back(&shaped, reached.state, by, bar),
                    _ => {}
                }
                return;
            };
            let by_objective = slopes.by_objective.get(k).copied().unwrap_or(0.0);
            let by_value = slopes.by_values[k];
            if by_value == 0.0 && by_objective == 0.0 {
                return;
            }
            let solution = self.seen(&shaped, times[k], reached);
            let mut pull_back = |terms: Vec<(Figure, f64)>, by: f64| {
                for (figure, weight) in terms.into_iter().filter(|_| by != 0.0) {
                    self.pull_back(figure, &solution, by * weight, bar);
                }
            };
            match of {
                Of::Objective => pull_back(self.objective(&solution).1, by_value + by_objective),
                Of::Grid(_) => {}
                Of::Limit(limit) => {
                    pull_back(self.terms(&solution, &self.config().limits[limit].asked()).1, by_value);
                    pull_back(self.objective(&solution).1, by_objective);
                }
            }
        };
        let flow_rate_back = |state: &State<F>, weight: f64, bar: &mut Bar<D, F, C>| {
            self.pull_back(Figure::FlowRate, &self.seen(&shaped, 0.0, state.into()), weight, bar);
        };
        let (sizes, wanted) = (history.sizes.as_slice(), self.wanted().len());
        let taken = |sizes| Taken {
            position: view.position,
            boundary: &boundary,
            flow_rate,
            first: &first,
            sizes,
            memory,
            by_viscosity: self.by_viscosity(),
            flow_rate_back: &flow_rate_back,
        };
        let failed = |why| no_flow(self.config(), &why);
        let found = if self.config().has_sound() {
            let count = sound::FIRST.min(sizes.len());
            let mut at_first = (0.0, first.clone());
            let mut last = |time: f64, reached: Reached<'_, F>| {
                at_first = (time, reached.state.clone());
                Ok::<_, NoSteadyState>(())
            };
            self.with_sound(&shaped, first.clone(), &boundary, &sizes[..count], &mut last).map_err(failed)?;
            let heard = Heard {
                boundary: &boundary,
                first: (at_first.0, &at_first.1),
                sizes: &sizes[count..],
                memory,
                velocity: self.config().fluid.reference_velocity,
                by_positions: self.cloud().moves(self.wanted()),
            };
            let flow = WithSound::new(self.medium(&shaped)).map_err(failed)?;
            let mut later = heard.pull_back(&flow, &mut |k, reached, bar| figures(count + k, reached, bar), wanted);
            let start = std::mem::replace(&mut later.start, std::array::from_fn(|_| vec![]));
            let mut of_first = |k: usize, reached: Reached<'_, F>, bar: &mut Bar<D, F, C>| {
                figures(k, reached, bar);
                if k + 1 == count {
                    for (to, from) in bar.fields.iter_mut().zip(&start) {
                        to.iter_mut().zip(from).for_each(|(to, from)| *to += from);
                    }
                }
            };
            let found = taken(&sizes[..count]).pull_back(&mut self.scheme(&shaped), &mut of_first, wanted);
            let mut found = found.map_err(failed)?;
            found.add(later);
            found
        } else {
            taken(sizes).pull_back(&mut self.scheme(&shaped), &mut figures, wanted).map_err(failed)?
        };
        let mut all = self.by_variables(&shaped, &found.position, &found.bar)?;
        all.iter_mut().zip(found.parameters).for_each(|(all, by)| *all += by);
        if let Some(slopes) = slopes {
            all.iter_mut().zip(slopes.by_variables).for_each(|(all, by)| *all += by);
        }
        check_finite(self.config(), &all)?;
        let by_start = self.start().map(|given| {
            let mut by_start = vec![0.0; 2 * given.velocity[0].len()];
            for i in 0..view.position[0].len() {
                let motion = i.checked_sub(self.cloud().inside()).map(|k| view.conditions[k].motion);
                let [x, y, _] = view.place(i);
                for (k, weight) in given.grid.weights([x, y]) {
                    for e in 0..2 {
                        match motion {
                            Some(Motion::Given(_)) => {}
                            Some(Motion::Symmetry(d)) if d == e => {}
                            _ => by_start[2 * k + e] += weight * found.start[e][i],
                        }
                    }
                }
            }
            by_start
        });
        let by_viscosity = self.by_viscosity().then(|| found.bar.viscosity / self.config().fluid.density);
        Ok(Derivative { by_variables: all, by_viscosity, by_start })
    }
}

/// A field at the start.
struct Start<'a> {
    /// Its number.
    field: usize,
    /// Whether it depends on the place.
    varies: bool,
    at: Box<dyn Fn([f64; 3]) -> f64 + 'a>,
}

/// What a flow begins with.
pub struct Begun<'a, S, const F: usize> {
    shaped: Arc<S>,
    first: State<F>,
    flow_rate: Option<f64>,
    start: Vec<Start<'a>>,
}

/// The boundary of one shape in time.
struct Boundary<'a, K, const D: usize> {
    cloud: &'a K,
    view: View<'a, D>,
    start: Vec<Start<'a>>,
    /// Numbers by which derivatives are wanted: shape and number.
    wanted: &'a [(usize, usize)],
}

impl<K: Conditions<D>, const D: usize, const F: usize, const C: usize> InTime<D, F, C> for Boundary<'_, K, D> {
    fn conditions(&self, time: f64) -> Vec<Condition<D>> {
        let View { numbers, position, conditions } = self.view;
        self.cloud.conditions_at(position, conditions.iter().map(|condition| condition.normal), time, numbers)
    }

    fn changes(&self) -> bool {
        self.cloud.has_time()
    }

    fn pull_back(&self, time: f64, bar: &Bar<D, F, C>, position: &mut [Vec<f64>; D], parameters: &mut [f64]) {
        let View { numbers, position: places, .. } = self.view;
        for (to, &wanted) in parameters.iter_mut().zip(self.wanted).filter(|(_, &w)| self.cloud.is_parameter(w)) {
            *to += self.cloud.by_parameter(places, numbers, &bar.boundary, wanted, time);
        }
        if !self.cloud.moves(self.wanted) {
            return;
        }
        let inside = self.cloud.inside();
        let by_places = self.cloud.conditions_back(places, numbers, &bar.boundary, Some(time));
        for (k, by_place) in by_places.iter().enumerate() {
            (0..D).for_each(|d| position[d][inside + k] += by_place[d]);
        }
    }

    fn of_start(&self, fields: &[Vec<f64>; F], bar: &mut Bar<D, F, C>, position: &mut [Vec<f64>; D]) {
        let inside = self.cloud.inside();
        for (k, condition) in self.view.conditions.iter().enumerate() {
            let to = &mut bar.boundary[k];
            if let Motion::Given(_) = condition.motion {
                (0..D).for_each(|e| to.velocity[e] += fields[e][inside + k]);
            }
            if let Warmth::Given(_) = condition.warmth {
                to.temperature += fields[D + 1][inside + k];
            }
        }
        // What the start is by place knows where particles are.
        let step = 1e-5 * self.cloud.dx();
        for Start { field, at: value, .. } in self.start.iter().filter(|start| start.varies) {
            for i in 0..inside {
                for d in 0..D {
                    let at = |sign: f64| {
                        let mut place = self.view.place(i);
                        place[d] += sign * step;
                        value(place)
                    };
                    position[d][i] += fields[*field][i] * (at(1.0) - at(-1.0)) / (2.0 * step);
                }
            }
        }
    }
}

/// The state that a scene begins with, by its fields and what walls are.
fn first_state<const D: usize, const F: usize>(view: View<'_, D>, inside: usize, start: &[Start<'_>]) -> State<F> {
    let n = view.position[0].len();
    let mut state = State::at_rest(n);
    for i in 0..n {
        let place = view.place(i);
        start.iter().for_each(|start| state.fields[start.field][i] = (start.at)(place));
        let Some(condition) = i.checked_sub(inside).map(|k| view.conditions[k]) else { continue };
        match condition.motion {
            Motion::Given(given) => (0..D).for_each(|e| state.fields[e][i] = given[e]),
            Motion::Symmetry(d) => state.fields[d][i] = 0.0,
            Motion::Outflow(_) => {}
        }
        if let Warmth::Given(given) = condition.warmth {
            state.fields[D + 1][i] = given;
        }
    }
    state
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
