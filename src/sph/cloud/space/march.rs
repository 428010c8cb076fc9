//! Steps in time in space: iterations with the matrix of each size of step, see [`super::super::unsteady`].
//!
//! The matrix of a step is that of a flow at rest with a0 / dt in the rows of momentum. Iterations solve with the incomplete factors of it
//! ([`super::linear`]), or of few particles with exact ones, from what the last two states extrapolate to. (With 3602 particles exact
//! factors take 18 s and 370 MB, and a step 0.4 s instead of 1.6, in the quick profile on a busy machine: they pay after a dozen of steps of one
//! size, and there are about six sizes.) It ends at 1e-10 of the residual that the state before the step leaves, far below the error of the step, so that derivatives by
//! the transposed iteration agree with differences.

use super::super::fit::{Coefficients, Stencils, COEFFICIENTS_3D as C};
use super::super::steady::NoSteadyState;
use super::super::unsteady::{lagged, Guess, Scheme};
use super::equations::{Bar, Derivatives, Equations, State, FLOW, TEMPERATURE};
use super::linear::{heat_matrix, Border, Linear, System};
use super::scalar::Scalar;
use super::steady::{Drive, Solver};
use crate::numerics::sparse_lu::Order;
use crate::sph::laws::buoyancy::Buoyancy;
use std::sync::Arc;

/// The part of the residual of the state before a step that its iterations leave.
const TOLERANCE: f64 = 1e-10;
/// The part of the right-hand side that rounding leaves.
const ROUNDING: f64 = 1e-13;
/// The relative residual of adjoints and of temperatures.
const ADJOINT: f64 = 1e-11;
/// How many steps tau is at most, inside and on the boundary, as [in the plane](super::super::unsteady::LAG).
///
/// In a step of any length the pressure that makes the flow fit to continuity is (D G + lag S)^-1 D u, and the velocity loses the part
/// G (D G + lag S)^-1 D of itself, whose eigenvalues should be between 0 and 1 and must be below 1.6. In ducts with cylinders of 2.5 to 3.5 spacings, seven
/// spacings wide, the largest is 1.9 to 2.1 with seven steps everywhere, 1.7 to 2.0 with six inside and ten on the boundary, and 1.5 to 1.65 with these;
/// in ducts of twelve spacings it is 1.3, 1.25 and 1.2. The less tau is, the less it smooths pressures: the drag of a ball of three spacings by its surface is
/// 0.9, 1.0 and 1.2 % above the steady flow's.
pub const LAG: [f64; 2] = [5.0, 7.0];
/// Up to so many particles the whole matrix is factorised exactly.
const FACTORISED: usize = 2000;
/// Memory of the matrices that are kept, of sizes of steps and their transposes; one is kept in any case.
const BYTES: usize = 1_000_000_000;

/// The systems of one size of step, or their transposes.
struct Matrices<'a> {
    rate: f64,
    transposed: bool,
    flow: System<'a>,
    heat: Option<Scalar>,
}

impl Matrices<'_> {
    fn bytes(&self) -> usize {
        self.flow.bytes() + self.heat.as_ref().map_or(0, Scalar::bytes)
    }
}

/// Steps of a flow around one set of shapes.
pub struct March<'a> {
    solver: Solver,
    operators: &'a Coefficients<C>,
    kept: Vec<Matrices<'a>>,
    border: Border,
    extra: [bool; 2],
    /// tau of a steady flow.
    damping: Vec<f64>,
    factorisations: usize,
}

impl<'a> March<'a> {
    /// `held`: a flow rate that is held, and how it follows from the state.
    pub fn new(
        equations: Equations,
        places: &[[f64; 3]],
        operators: &'a Coefficients<C>,
        held: Drive<'_>,
        threads: usize,
    ) -> Self {
        let n = equations.particles();
        let (damping, extra) = (equations.damping.clone(), [!equations.gives_pressure(), held.is_some()]);
        let order = (n <= FACTORISED).then(|| Arc::new(Order::new(&equations.fits.flow_matrix(FLOW), |i| places[i])));
        let solver = Solver { order, ..Solver::new(equations, threads) };
        let border = solver.border(&State::at_rest(n), &Derivatives::zeros(n), operators, held);
        Self { solver, operators, kept: vec![], border, extra, damping, factorisations: 0 }
    }

    /// The same without exact factors of few particles.
    pub fn without_factors(self) -> Self {
        Self { solver: Solver { order: None, ..self.solver }, ..self }
    }

    /// Iterations of all solutions with the flow's matrices.
    pub fn iterations(&self) -> usize {
        self.solver.counts.iterations
    }

    /// Memory of the matrices that are kept.
    pub fn bytes(&self) -> usize {
        self.kept.iter().map(Matrices::bytes).sum()
    }

    /// Gives the equations tau of steps with a0 / dt.
    fn damp(&mut self, rate: f64) {
        let inside = self.solver.equations.inside;
        self.solver.equations.damping = lagged(&self.damping, inside, LAG, rate);
    }

    /// Puts the systems for a0 / dt to the end of those that are kept.
    fn find(&mut self, rate: f64, transposed: bool) -> Result<(), NoSteadyState> {
        let is_it = |kept: &Matrices<'_>| kept.transposed == transposed && (kept.rate / rate - 1.0).abs() < 1e-12;
        if let Some(k) = self.kept.iter().position(is_it) {
            let found = self.kept.remove(k);
            self.kept.push(found);
            return Ok(());
        }
        // Each needs as much as the last one.
        while self.kept.last().is_some_and(|last| self.bytes() + last.bytes() > BYTES) {
            self.kept.remove(0);
        }
        self.damp(rate);
        let Solver { equations, threads, order, .. } = &self.solver;
        let n = equations.particles();
        let rest = State::at_rest(n);
        let linear = Linear::new(equations, &rest, &Derivatives::zeros(n), self.operators, rate);
        let [columns, rows, corner] = self.border.clone();
        let (linear, border) = match transposed {
            false => (linear, [columns, rows, corner]),
            // The corner is 0.
            true => (linear.transposed(), [rows, columns, corner]),
        };
        let flow = System::new(linear, border, *threads, order.as_ref())?;
        let heat = equations.diffusivity.map(|_| {
            let mut matrix = heat_matrix(equations, &rest, self.operators);
            for i in 0..equations.inside {
                let entry = matrix.entry(i, i as u32);
                matrix.values[entry] += rate;
            }
            if transposed {
                matrix.transpose();
            }
            Scalar::new(matrix, *threads)
        });
        self.factorisations += 1;
        self.kept.push(Matrices { rate, transposed, flow, heat: heat.transpose()? });
        Ok(())
    }
}

/// The flow as a vector, with lambda and the drive where they are unknown, given `of` a function of states.
fn packed(n: usize, [lambda, drive]: [bool; 2], of: impl Fn(&dyn Fn(&State) -> f64) -> f64) -> Vec<f64> {
    let mut x: Vec<f64> = (0..FLOW * n).map(|k| of(&|state| state.fields[k % FLOW][k / FLOW])).collect();
    x.extend(lambda.then(|| of(&|state| state.lambda)));
    x.extend(drive.then(|| of(&|state| state.drive)));
    x
}

impl Scheme<3, 5, C> for March<'_> {
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

    fn force(&self) -> [f64; 3] {
        self.solver.equations.force
    }

    fn buoyancy(&self) -> Option<Buoyancy> {
        self.solver.equations.buoyancy
    }

    fn extra(&self) -> [bool; 2] {
        self.extra
    }

    fn carriers(&self) -> (&Stencils<3>, &Coefficients<C>) {
        (&self.solver.equations.fits.all, self.operators)
    }

    fn derivatives(&self, state: &State, everywhere: bool) -> Derivatives {
        let equations = &self.solver.equations;
        match everywhere {
            true => equations.derivatives(self.operators, state),
            false => equations.derivatives_at(self.operators, state, &[]),
        }
    }

    fn by_fields(&self, bar: &Bar) -> [Vec<f64>; 5] {
        self.solver.equations.by_fields(self.operators, bar)
    }

    /// The cotangents themselves: a step costs far more than they do.
    type Sums = [Vec<f64>; 3];

    fn sums(&self) -> [Vec<f64>; 3] {
        std::array::from_fn(|_| vec![0.0; self.particles()])
    }

    fn add_to(&self, sums: &mut [Vec<f64>; 3], position: &[Vec<f64>; 3], state: &State, bar: &Bar) {
        let found = self.solver.equations.by_positions(position, state, bar);
        for (sums, found) in sums.iter_mut().zip(&found) {
            sums.iter_mut().zip(found).for_each(|(sum, found)| *sum += found);
        }
    }

    fn by_sums(&self, _position: &[Vec<f64>; 3], sums: [Vec<f64>; 3]) -> [Vec<f64>; 3] {
        sums
    }

    fn pull_back_linear(&mut self, rate: f64, d: &Derivatives, flow: &[f64], heat: Option<&[f64]>, bar: &mut Bar) {
        self.damp(rate);
        self.solver.equations.pull_back_linear(d, flow, heat, bar);
    }

    fn solve_flow(&mut self, rate: f64, right: &[f64], guess: Option<Guess<'_, 5>>) -> Result<Vec<f64>, NoSteadyState> {
        self.find(rate, guess.is_none())?;
        let Self { kept, solver, extra, .. } = self;
        let Solver { equations, counts, .. } = solver;
        let flow = &kept.last().ok_or(NoSteadyState::Singular)?.flow;
        // Over a stencil momenta change and diffuse at these rates.
        let scale = equations.fits.all.scale(0);
        let weight = rate * scale + equations.viscosity / scale;
        let Some(guess) = guess else {
            let found = flow.solve(right, ADJOINT, weight, &mut counts.iterations);
            return found.ok_or(NoSteadyState::Adjoint);
        };
        let n = equations.particles();
        let known = packed(n, *extra, |number| number(guess.now));
        let first = packed(n, *extra, |number| guess.of(number));
        let accuracy = (TOLERANCE, ROUNDING);
        let found = flow.solve_from(right, [&first, &known], accuracy, weight, &mut counts.iterations);
        found.ok_or(NoSteadyState::Unsolved)
    }

    fn solve_heat(&mut self, rate: f64, right: &[f64], guess: Option<Guess<'_, 5>>) -> Result<Vec<f64>, NoSteadyState> {
        self.find(rate, guess.is_none())?;
        let n = self.solver.equations.particles();
        let Some(heat) = self.kept.last().and_then(|kept| kept.heat.as_ref()) else { return Ok(vec![]) };
        let first = match guess {
            Some(guess) => (0..n).map(|i| guess.of(|state| state.fields[TEMPERATURE][i])).collect(),
            None => vec![0.0; n],
        };
        let why = if guess.is_some() { NoSteadyState::Unsolved } else { NoSteadyState::Adjoint };
        heat.solve_from(right, &first, ADJOINT).ok_or(why)
    }
}
