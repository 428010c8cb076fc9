//! The linearised flow whose temperature acts on it by buoyancy, solved by GMRES.
//!
//! With A of the flow's unknowns z ([`super::linear`]) and H of the temperature's,
//!
//! ```text
//!   | A  -B | |z|   |r|        B T = b T in the rows of momentum,   C u = u . grad T in those of heat,
//!   | C   H | |T| = |q|        P = | A  -B |
//!                                  | 0   H |.
//! ```
//!
//! The preconditioner is P with the flow's own for A and a few iterations for H, or its transpose. Vectors are those of the flow with its
//! border, and behind them `[N]`.

use super::equations::{Derivatives, Equations, FLOW, PRESSURE, TEMPERATURE};
use super::linear::{solve_scaled, Method, System};
use super::scalar::Scalar;

/// Relative residual of the heat in the preconditioner.
const HEAT: f64 = 0.05;

/// The coupled system at a state, or its transpose.
pub struct Coupled<'a> {
    pub flow: &'a System<'a>,
    pub heat: &'a Scalar,
    /// b.
    push: [f64; 3],
    /// grad T at particles inside that conduct.
    slopes: Vec<[f64; 3]>,
    transposed: bool,
}

impl<'a> Coupled<'a> {
    /// `flow` and `heat`: systems at the state that `d` belongs to, or both transposed.
    pub fn new(
        equations: &Equations,
        d: &Derivatives,
        flow: &'a System<'a>,
        heat: &'a Scalar,
        transposed: bool,
    ) -> Self {
        let push = equations.buoyancy.map_or([0.0; 3], |buoyancy| buoyancy.by);
        let of = |i: usize| match equations.end(i) {
            None => std::array::from_fn(|e| d.0[TEMPERATURE][i][e]),
            Some(_) => [0.0; 3],
        };
        Self { flow, heat, push, slopes: (0..equations.inside).map(of).collect(), transposed }
    }

    /// Adds B T to z, or in the transpose B^T z to T.
    fn push_by(&self, z: &mut [f64], t: &mut [f64]) {
        for i in 0..self.slopes.len() {
            let own = &mut z[FLOW * i..FLOW * i + 3];
            match self.transposed {
                false => (0..3).for_each(|e| own[e] += self.push[e] * t[i]),
                true => t[i] += (0..3).map(|e| self.push[e] * own[e]).sum::<f64>(),
            }
        }
    }

    fn times(&self, x: &[f64]) -> Vec<f64> {
        let (z, t) = x.split_at(x.len() - self.heat.size());
        let (mut y, mut q) = (self.flow.times(z), self.heat.times(t));
        for (i, slope) in self.slopes.iter().enumerate() {
            for e in 0..3 {
                match self.transposed {
                    false => {
                        y[FLOW * i + e] -= self.push[e] * t[i];
                        q[i] += slope[e] * z[FLOW * i + e];
                    }
                    true => {
                        q[i] -= self.push[e] * z[FLOW * i + e];
                        y[FLOW * i + e] += slope[e] * t[i];
                    }
                }
            }
        }
        y.extend(q);
        y
    }

    fn precondition(&self, x: &[f64]) -> Vec<f64> {
        let (z, t) = x.split_at(x.len() - self.heat.size());
        let (mut z, mut t) = (z.to_vec(), t.to_vec());
        if self.transposed {
            z = self.flow.precondition(&z);
            self.push_by(&mut z, &mut t);
            t = self.heat.nearly(&t, HEAT);
        } else {
            t = self.heat.nearly(&t, HEAT);
            self.push_by(&mut z, &mut t);
            z = self.flow.precondition(&z);
        }
        z.extend(t);
        z
    }

    /// The solution to a relative residual, in which rows of continuity count `continuity` times and those of heat `heat` times; adds
    /// the products that it took.
    pub fn solve(
        &self,
        right: &[f64],
        tolerance: f64,
        [continuity, heat]: [f64; 2],
        products: &mut usize,
    ) -> Option<Vec<f64>> {
        let (n, whole) = (self.heat.size(), right.len());
        let scale = |x: &mut [f64], back: bool| {
            let [continuity, heat] = if back { [1.0 / continuity, 1.0 / heat] } else { [continuity, heat] };
            x[..FLOW * n].chunks_exact_mut(FLOW).for_each(|row| row[PRESSURE] *= continuity);
            x[whole - n..].iter_mut().for_each(|x| *x *= heat);
        };
        let (times, precondition) = (|x: &[f64]| self.times(x), |x: &[f64]| self.precondition(x));
        solve_scaled(right, tolerance, Method::Gmres, [&times, &precondition], &scale, products)
    }
}
