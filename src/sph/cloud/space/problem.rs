//! A steady flow around shapes in space as a function of their numbers: figures, and their exact derivatives.

use super::super::figures::{Figure, MeasureSettings};
use super::super::particles::Unusable;
use super::super::problem::{Gradient, NoSolution, CONTINUATION};
use super::super::steady::{Held, NoSteadyState};
use super::equations::{Bar, Condition, Derivatives, State, FLOW};
use super::figures::{Measures, Rate};
use super::particles::{At, Cloud, Shaped};
use super::steady::Solver;
use std::sync::Arc;

/// A cloud with its solver, which keeps the last state from shape to shape.
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
    /// What holds on the boundary at the time of the state.
    pub conditions: Vec<Condition>,
    pub state: State,
    pub derivatives: Derivatives,
}

impl SteadyFlow {
    /// # Errors
    /// A map of the reference shape that folds, which cannot be.
    pub fn new(
        cloud: Cloud,
        held: Option<Held>,
        settings: MeasureSettings<'_, 3>,
        threads: usize,
    ) -> Result<Self, Unusable<3>> {
        let shaped = cloud.shaped(&cloud.numbers())?;
        let solver = Solver::new(cloud.equations(&shaped), threads);
        let measures = Measures::new(&cloud, settings);
        Ok(Self { cloud, solver, measures, held, last: None })
    }

    /// The steady flow around shapes with these numbers.
    ///
    /// # Errors
    /// A cloud that folds, and a flow that does not become steady.
    pub fn solve(&mut self, numbers: &[Vec<f64>]) -> Result<Solution, NoSolution<3>> {
        let shaped = Arc::new(self.cloud.shaped(numbers)?);
        self.solver.equations.conditions = shaped.conditions.clone();
        let rest = || State::at_rest(self.cloud.particles());
        let mut state = self.last.clone().unwrap_or_else(rest);
        self.begin_drive(&shaped, &mut state)?;
        let mut found = self.settle(&shaped, &mut state);
        if found.is_err() {
            let own = self.solver.equations.viscosity;
            state = State::at_rest(self.cloud.particles());
            self.begin_drive(&shaped, &mut state)?;
            for factor in CONTINUATION {
                self.solver.equations.viscosity = factor * own;
                found = self.settle(&shaped, &mut state);
                if found.is_err() {
                    break;
                }
            }
            self.solver.equations.viscosity = own;
        }
        found?;
        self.last = Some(state.clone());
        let derivatives = self.solver.equations.derivatives(&shaped.operators, &state);
        Ok(Solution { conditions: shaped.conditions.clone(), shaped, state, derivatives })
    }

    /// A flow at rest takes no power, so it gets the force that a plane channel would need, and its flow.
    fn begin_drive(&mut self, shaped: &Shaped, state: &mut State) -> Result<(), NoSteadyState> {
        let Some(Held::Power { power, length }) = self.held.clone() else { return Ok(()) };
        if state.drive != 0.0 {
            return Ok(());
        }
        let [_, width, depth] = self.cloud.ground.region.size;
        let push = (12.0 * self.solver.equations.viscosity * power / (length * depth * width.powi(3))).sqrt();
        state.drive = push - self.solver.equations.force[0];
        self.solver.settle(&shaped.operators, state, None)
    }

    fn settle(&mut self, shaped: &Shaped, state: &mut State) -> Result<(), NoSteadyState> {
        let rate = Rate { measures: &self.measures, shaped };
        let held = self.held.as_ref().map(|held| (held, &rate as _));
        self.solver.settle(&shaped.operators, state, held)
    }

    /// What figures are read from.
    pub fn at<'a>(&'a self, solution: &'a Solution) -> At<'a> {
        let Solution { shaped, conditions, state, derivatives: d } = solution;
        At { equations: &self.solver.equations, shaped, conditions, state, d }
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
    ) -> Result<Gradient, NoSolution<3>> {
        let Solution { shaped, state, derivatives, .. } = solution;
        self.solver.equations.conditions = shaped.conditions.clone();
        let n = self.cloud.particles();
        let mut bar = Bar::new(n, shaped.area.len());
        for &(figure, weight) in terms {
            self.measures.pull_back(figure, &self.at(solution), weight, &mut bar);
        }
        let fields = self.solver.equations.by_fields(&shaped.operators, &bar);
        let rate = Rate { measures: &self.measures, shaped };
        let held = self.held.as_ref().map(|held| (held, &rate as _));
        let (flow, heat) = self.solver.adjoint(&shaped.operators, state, &fields, bar.drive, held)?;
        let against: Vec<f64> = flow[..FLOW * n].iter().map(|x| -x).collect();
        let heat = heat.map(|heat| heat.iter().map(|x| -x).collect::<Vec<f64>>());
        let equations = &self.solver.equations;
        equations.pull_back(state, derivatives, &against, heat.as_deref(), &mut bar);
        if let (Some(held), Some(multiplier)) = (&self.held, flow.last()) {
            // The held flow rate depends on the positions too.
            let factor = match held {
                Held::FlowRate(_) => 1.0,
                Held::Power { .. } => equations.push(state, 0),
            };
            self.measures.pull_back(Figure::FlowRate, &self.at(solution), -multiplier * factor, &mut bar);
        }
        let positions = equations.by_positions(&shaped.position, state, &bar);
        let by_numbers = self.cloud.by_numbers(shaped, &positions, &bar, wanted, Some(0.0))?;
        Ok(Gradient { by_numbers, by_viscosity: bar.viscosity })
    }
}
