//! A steady flow around shapes as a function of their numbers: figures, and their exact derivatives.

use super::deferred_correction::{Defect, ThirdOrder};
use super::equations::{Bar, Derivatives, State};
use super::figures::{Figure, MeasureSettings, Measures, Rate};
use super::particles::{At, Cloud, Shaped, Unusable};
use super::steady::{Held, NoSteadyState, Solver};
use super::weighted_residual::{Residual, Weighted};
use std::sync::Arc;

/// A cloud with its solver, which keeps factors and the last state from shape to shape.
pub struct SteadyFlow {
    pub cloud: Cloud,
    pub solver: Solver,
    pub measures: Measures,
    pub held: Option<Held>,
    last: Option<State>,
}

/// The steady flow around one shape.
#[derive(Debug, Clone)]
pub struct Solution {
    pub shaped: Arc<Shaped>,
    pub state: State,
    pub derivatives: Derivatives,
    /// The solution that it corrects, where slopes are of third order ([`super::deferred_correction`]).
    pub first: Option<Box<Solution>>,
    /// What slopes lack, in a flow in time whose steps have it.
    pub defect: Option<Defect>,
}

/// The derivative of figures of a flow.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// By the numbers of shapes that are wanted.
    pub by_numbers: Vec<f64>,
    /// By the kinematic viscosity.
    pub by_viscosity: f64,
}

/// Why there is no solution.
#[derive(Debug, Clone, PartialEq)]
pub enum NoSolution<const D: usize = 2> {
    Cloud(Unusable<D>),
    Flow(NoSteadyState),
}

impl<const D: usize> From<Unusable<D>> for NoSolution<D> {
    fn from(why: Unusable<D>) -> Self {
        Self::Cloud(why)
    }
}

impl<const D: usize> From<NoSteadyState> for NoSolution<D> {
    fn from(why: NoSteadyState) -> Self {
        Self::Flow(why)
    }
}

/// Viscosities of the continuation, in the flow's own, where Newton's method does not converge from rest.
pub(super) const CONTINUATION: [f64; 4] = [8.0, 4.0, 2.0, 1.0];

impl SteadyFlow {
    /// # Errors
    /// A map of the reference shape that folds, which cannot be.
    pub fn new(
        cloud: Cloud,
        held: Option<Held>,
        settings: MeasureSettings<'_, 2>,
        threads: usize,
    ) -> Result<Self, Unusable> {
        let shaped = cloud.shaped(&cloud.numbers())?;
        let solver = Solver::new(cloud.equations(&shaped), &cloud.places.place, threads);
        let measures = Measures::new(&cloud, settings);
        Ok(Self { cloud, solver, measures, held, last: None })
    }

    /// The steady flow around shapes with these numbers.
    ///
    /// # Errors
    /// A cloud that folds, and a flow that does not become steady.
    pub fn solve(&mut self, numbers: &[Vec<f64>]) -> Result<Solution, NoSolution> {
        let shaped = Arc::new(self.cloud.shaped(numbers)?);
        self.solver.equations.conditions = shaped.conditions.clone();
        let mut state = self.last.clone().unwrap_or_else(|| State::at_rest(self.cloud.particles()));
        self.begin_drive(&shaped, &mut state)?;
        let mut found = self.settle(&shaped, &mut state, None);
        if found.is_err() {
            // From rest, with a viscosity that becomes smaller.
            let own = self.solver.equations.viscosity;
            state = State::at_rest(self.cloud.particles());
            self.begin_drive(&shaped, &mut state)?;
            for factor in CONTINUATION {
                self.solver.equations.viscosity = factor * own;
                self.solver.forget();
                found = self.settle(&shaped, &mut state, None);
                if found.is_err() {
                    break;
                }
            }
            self.solver.equations.viscosity = own;
        }
        found?;
        self.last = Some(state.clone());
        let derivatives = self.solver.equations.derivatives(&shaped.operators, &state, true);
        self.corrected(Solution { shaped, state, derivatives, first: None, defect: None })
    }

    /// The solution with slopes of third order that follows from one with slopes of second order, if the cloud has such fits.
    fn corrected(&mut self, first: Solution) -> Result<Solution, NoSolution> {
        let shaped = Arc::clone(&first.shaped);
        let Some(third) = self.third(&shaped) else { return Ok(first) };
        let defect = third.defect(&first.state, &first.derivatives);
        let mut state = first.state.clone();
        self.settle(&shaped, &mut state, Some(&defect))?;
        let derivatives = self.solver.equations.derivatives(&shaped.operators, &state, true);
        Ok(Solution { shaped, state, derivatives, first: Some(Box::new(first)), defect: None })
    }

    fn third<'a>(&'a self, shaped: &'a Shaped) -> Option<ThirdOrder<'a>> {
        let (stencils, operators) = (self.cloud.third.as_ref()?, shaped.third.as_ref()?);
        Some(ThirdOrder { equations: &self.solver.equations, stencils, operators })
    }

    /// A flow at rest takes no power, so it gets the force that a plane channel would need, and its flow.
    fn begin_drive(&mut self, shaped: &Shaped, state: &mut State) -> Result<(), NoSteadyState> {
        let Some(Held::Power { power, length }) = self.held.clone() else { return Ok(()) };
        if state.drive != 0.0 {
            return Ok(());
        }
        let [low, high] = self.cloud.places.corners;
        let width = high[1] - low[1];
        let push = (12.0 * self.solver.equations.viscosity * power / (length * width.powi(3))).sqrt();
        state.drive = push - self.solver.equations.force[0];
        self.solver.settle(&shaped.operators, state, None, None)
    }

    fn settle(&mut self, shaped: &Shaped, state: &mut State, defect: Option<&Defect>) -> Result<(), NoSteadyState> {
        let rate = Rate { measures: &self.measures, shaped };
        let held = self.held.as_ref().map(|held| (held, &rate as _));
        self.solver.settle(&shaped.operators, state, held, defect)
    }

    /// See [`Solver::growth`].
    ///
    /// # Errors
    /// A matrix without factors.
    pub fn growth(&mut self, solution: &Solution, rate: f64) -> Result<Option<(f64, f64)>, NoSolution> {
        let Solution { shaped, state, .. } = solution;
        self.solver.equations.conditions = shaped.conditions.clone();
        let flow_rate = Rate { measures: &self.measures, shaped };
        let held = self.held.as_ref().map(|held| (held, &flow_rate as _));
        let found = self.solver.growth(&shaped.operators, state, held, rate);
        Ok(found.map_err(NoSteadyState::from)?)
    }

    /// What figures are read from.
    pub fn at<'a>(&'a self, solution: &'a Solution) -> At<'a> {
        let Solution { shaped, state, derivatives: d, defect, .. } = solution;
        At { equations: &self.solver.equations, shaped, state, d, defect: defect.as_ref() }
    }

    pub fn value(&self, solution: &Solution, figure: Figure) -> f64 {
        self.measures.value(figure, &self.at(solution))
    }

    /// The derivative of a weighted sum of figures by numbers (shape, number) and the viscosity.
    ///
    /// # Errors
    /// A transposed system that cannot be solved.
    pub fn gradient(
        &mut self,
        solution: &Solution,
        terms: &[(Figure, f64)],
        wanted: &[(usize, usize)],
    ) -> Result<Gradient, NoSolution> {
        let mut bar = Bar::new(self.cloud.particles(), solution.shaped.area.len());
        for &(figure, weight) in terms {
            self.measures.pull_back(figure, &self.at(solution), weight, &mut bar);
        }
        self.pull_back(solution, bar, wanted)
    }

    /// The multipliers of flow and heat of what has these cotangents, see [`Solver::adjoint`].
    fn multipliers(&mut self, solution: &Solution, bar: &Bar) -> Result<(Vec<f64>, Option<Vec<f64>>), NoSteadyState> {
        let Solution { shaped, state, .. } = solution;
        self.solver.equations.conditions = shaped.conditions.clone();
        let fields = self.solver.equations.by_fields(&shaped.operators, bar);
        let rate = Rate { measures: &self.measures, shaped };
        let held = self.held.as_ref().map(|held| (held, &rate as _));
        self.solver.adjoint(&shaped.operators, state, &fields, bar.drive, held)
    }

    /// The residual of a solution in fits of third order, for [`Self::weighted_residual`] of its figures.
    ///
    /// # Errors
    /// A cloud without such fits.
    pub fn residual(&mut self, solution: &Solution) -> Result<Residual, NoSolution> {
        let Solution { shaped, state, derivatives, .. } = solution;
        self.solver.equations.conditions = shaped.conditions.clone();
        // The figures have one matrix, whose own factors serve better than those of a step before.
        self.solver.forget();
        if let Some(third) = self.third(shaped) {
            return Ok(Residual::new(&third, state, derivatives));
        }
        let stencils = &self.cloud.third_order()?;
        let operators = &stencils.coefficients(&shaped.position);
        Ok(Residual::new(&ThirdOrder { equations: &self.solver.equations, stencils, operators }, state, derivatives))
    }

    /// The weighted residual of what has these cotangents, see [`super::weighted_residual`].
    ///
    /// # Errors
    /// A transposed system that cannot be solved.
    pub fn weighted_residual(
        &mut self,
        solution: &Solution,
        residual: &Residual,
        bar: &Bar,
    ) -> Result<Weighted, NoSolution> {
        let (flow, heat) = self.multipliers(solution, bar)?;
        Ok(residual.weighted(&flow, heat.as_deref()))
    }

    /// The derivative by numbers (shape, number) and the viscosity of what has these cotangents.
    ///
    /// # Errors
    /// As [`Self::gradient`].
    pub fn pull_back(
        &mut self,
        solution: &Solution,
        mut bar: Bar,
        wanted: &[(usize, usize)],
    ) -> Result<Gradient, NoSolution> {
        let Solution { shaped, state, derivatives, first, .. } = solution;
        let n = self.cloud.particles();
        let (flow, heat) = self.multipliers(solution, &bar)?;
        let against: Vec<f64> = flow[..3 * n].iter().map(|x| -x).collect();
        let heat = heat.map(|heat| heat.iter().map(|x| -x).collect::<Vec<f64>>());
        let equations = &self.solver.equations;
        equations.pull_back(state, derivatives, &against, heat.as_deref(), &mut bar);
        if let (Some(held), Some(multiplier)) = (&self.held, flow.last()) {
            // The held flow rate depends on the positions too.
            let factor = match held {
                Held::FlowRate(_) => 1.0,
                Held::Power { .. } => equations.force[0] + state.drive,
            };
            self.measures.pull_back(Figure::FlowRate, &self.at(solution), -multiplier * factor, &mut bar);
        }
        let positions = equations.by_positions(&shaped.position, state, &bar);
        let by_numbers = self.cloud.by_numbers(shaped, &positions, &bar, wanted, Some(0.0));
        let mut found = Gradient { by_numbers, by_viscosity: bar.viscosity };
        if let (Some(first), Some(third)) = (first, self.third(shaped)) {
            let before = (&first.state, &first.derivatives);
            let bar = third.pull_back(&shaped.position, before, &against, heat.as_deref());
            let more = self.pull_back(first, bar, wanted)?;
            found.by_numbers.iter_mut().zip(more.by_numbers).for_each(|(to, more)| *to += more);
            found.by_viscosity += more.by_viscosity;
        }
        Ok(found)
    }
}
