//! Steps in time in the plane: solutions with the factors of one matrix for each size, see [`super::unsteady`].

use super::deferred_correction::{Defect, Lagged};
use super::equations::{Bar, Derivatives, Equations, State};
use super::fit::{Coefficients, Stencils, COEFFICIENTS};
use super::fit_adjoint::PairCotangents;
use super::steady::{Border, Factors, FlowRate, Held, NoSteadyState, Solver};
use super::unsteady::{lagged, Guess, Scheme, LAG};
use crate::numerics::sparse_lu::SparseLu;
use crate::sph::laws::buoyancy::Buoyancy;

/// Matrices whose factors are kept: so many, or more as long as they need no more than these bytes. (Where a wall turns back and forth
/// three sizes of steps take turns, each with matrices of its own after larger and smaller ones: seven.)
const KEPT: usize = 3;
const BYTES: usize = 300_000_000;

/// Solutions with the matrix of one size of step.
struct Matrices {
    rate: f64,
    flow: Factors,
    heat: Option<SparseLu>,
}

impl Matrices {
    fn bytes(&self) -> usize {
        self.flow.bytes() + self.heat.as_ref().map_or(0, SparseLu::bytes)
    }
}

/// Steps of a flow around one shape.
pub struct March<'a> {
    solver: Solver,
    operators: &'a Coefficients,
    kept: Vec<Matrices>,
    border: Border,
    drives: bool,
    /// tau of a steady flow.
    damping: Vec<f64>,
    factorisations: usize,
    correction: Option<Lagged<'a>>,
}

/// Cotangents of the coefficients of all derivatives, of those of third order, and of positions themselves.
pub struct Sums {
    second: PairCotangents,
    third: Option<PairCotangents>,
    position: [Vec<f64>; 2],
}

impl<'a> March<'a> {
    /// `held`: a flow rate that is held, and how it follows from the state.
    pub fn new(
        equations: Equations,
        places: &[[f64; 2]],
        operators: &'a Coefficients,
        held: Option<(&Held, &dyn FlowRate)>,
        threads: usize,
    ) -> Self {
        let damping = equations.damping.clone();
        let solver = Solver::of_size(equations, places, 3, threads);
        let border = solver.border_at_rest(operators, held);
        Self {
            solver,
            operators,
            kept: vec![],
            border,
            drives: held.is_some(),
            damping,
            factorisations: 0,
            correction: None,
        }
    }

    /// With what the slopes of the last state lack.
    pub fn corrected(mut self, correction: Option<Lagged<'a>>) -> Self {
        self.correction = correction;
        self
    }

    /// Gives the equations tau of steps with a0 / dt.
    fn damp(&mut self, rate: f64) {
        let inside = self.solver.equations.inside;
        self.solver.equations.damping = lagged(&self.damping, inside, LAG, rate);
    }

    /// The factors for a0 / dt.
    fn matrices(&mut self, rate: f64) -> Result<&Matrices, NoSteadyState> {
        if let Some(k) = self.kept.iter().position(|kept| (kept.rate / rate - 1.0).abs() < 1e-12) {
            let found = self.kept.remove(k);
            self.kept.push(found);
        } else {
            self.damp(rate);
            let (flow, heat) = self.solver.factors_at(rate, self.operators, &self.border)?;
            self.factorisations += 1;
            self.kept.push(Matrices { rate, flow, heat });
            while self.kept.len() > KEPT && self.kept.iter().map(Matrices::bytes).sum::<usize>() > BYTES {
                self.kept.remove(0);
            }
        }
        self.kept.last().ok_or(NoSteadyState::Singular)
    }
}

impl Scheme<2, 4, COEFFICIENTS> for March<'_> {
    fn particles(&self) -> usize {
        self.solver.equations.particles()
    }

    fn inside(&self) -> usize {
        self.solver.equations.inside
    }

    fn factorisations(&self) -> usize {
        self.factorisations
    }

    fn has_heat(&self) -> bool {
        self.solver.equations.diffusivity.is_some()
    }

    fn force(&self) -> [f64; 2] {
        self.solver.equations.force
    }

    fn buoyancy(&self) -> Option<Buoyancy> {
        self.solver.equations.buoyancy
    }

    fn extra(&self) -> [bool; 2] {
        [self.border.pins, self.drives]
    }

    fn carriers(&self) -> (&Stencils, &Coefficients) {
        (&self.solver.equations.fits.all, self.operators)
    }

    fn derivatives(&self, state: &State, everywhere: bool) -> Derivatives {
        let equations = &self.solver.equations;
        match everywhere {
            true => equations.derivatives(self.operators, state, true),
            false => equations.derivatives_at(self.operators, state, &[]),
        }
    }

    fn by_fields(&self, bar: &Bar) -> [Vec<f64>; 4] {
        self.solver.equations.by_fields(self.operators, bar)
    }

    type Sums = Sums;

    fn sums(&self) -> Sums {
        Sums {
            second: PairCotangents::zeros(&self.solver.equations.fits.all),
            third: self.correction.as_ref().map(|correction| PairCotangents::zeros(correction.stencils)),
            position: std::array::from_fn(|_| vec![0.0; self.particles()]),
        }
    }

    fn add_to(&self, sums: &mut Sums, _position: &[Vec<f64>; 2], state: &State, bar: &Bar) {
        let fields = state.in_use(self.has_heat());
        sums.second.add(&self.solver.equations.fits.all, &fields, &bar.derivatives.0[..fields.len()]);
        for (sums, bar) in sums.position.iter_mut().zip(&bar.position) {
            sums.iter_mut().zip(bar).for_each(|(sum, bar)| *sum += bar);
        }
    }

    fn by_sums(&self, position: &[Vec<f64>; 2], sums: Sums) -> [Vec<f64>; 2] {
        let mut found = sums.position;
        self.solver.equations.fits.pull_back_pairs(position, sums.second, &mut found);
        if let (Some(correction), Some(third)) = (&self.correction, &sums.third) {
            correction.stencils.pull_back_pairs(position, third, &mut found);
        }
        found
    }

    fn defect(&self, state: &State) -> Option<Defect> {
        let correction = self.correction.as_ref()?;
        Some(correction.defect((&self.solver.equations, self.operators), state))
    }

    fn pull_back_defect(
        &self,
        sums: &mut Sums,
        state: &State,
        defect: &Defect,
        fields: &mut [Vec<f64>; 4],
        bar: &mut Bar,
    ) {
        let (Some(correction), Some(third)) = (&self.correction, &mut sums.third) else { return };
        let second = (&self.solver.equations, self.operators);
        let slopes = correction.pull_back(second, state, defect, fields, &mut bar.derivatives);
        third.add(correction.stencils, &state.in_use(self.has_heat()), &slopes);
    }

    fn pull_back_linear(&mut self, rate: f64, d: &Derivatives, flow: &[f64], heat: Option<&[f64]>, bar: &mut Bar) {
        self.damp(rate);
        self.solver.equations.pull_back_linear(d, flow, heat, bar);
    }

    fn solve_flow(&mut self, rate: f64, right: &[f64], guess: Option<Guess<'_, 4>>) -> Result<Vec<f64>, NoSteadyState> {
        Ok(self.matrices(rate)?.flow.solve(right, guess.is_none(), false))
    }

    fn solve_heat(&mut self, rate: f64, right: &[f64], guess: Option<Guess<'_, 4>>) -> Result<Vec<f64>, NoSteadyState> {
        let matrices = self.matrices(rate)?;
        Ok(matrices.heat.as_ref().map_or_else(Vec::new, |heat| heat.solve(right, guess.is_none())))
    }
}
