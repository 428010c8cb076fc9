//! A velocity at any place of a flow, from the particles around it.

use crate::sph::{Model, Sweeps};

/// Monomials 1, x_d and x_d x_e: 6 in two dimensions, 10 in three.
const MOST_TERMS: usize = 10;

/// Velocity at a place of a flow: second-order moving least squares (Liu and Liu 2006) over the fluid's particles and, in the
/// consistent formulation, the points on the walls' surfaces, weighted with the scene's kernel. None with too few particles
/// around.
pub fn velocity<R: Sweeps>(model: &Model<R>, state: &[R], place: [f64; 3]) -> Option<[f64; 3]> {
    let (n, l) = (model.particles(), model.rows);
    let dimension = l.dimension;
    let terms = (dimension + 1) * (dimension + 2) / 2;
    let (reach, unit) = (model.kernel.cutoff(), model.kernel.smoothing_length);
    let mut system = [[0.0; MOST_TERMS + 3]; MOST_TERMS];
    for i in 0..n {
        if !model.knows_velocity(i) {
            continue;
        }
        let away = |d: usize| model.domain.nearest(d, state[d * n + i].f64() - place[d]);
        let x: [f64; 3] = std::array::from_fn(|d| if d < dimension { away(d) } else { 0.0 });
        let r2: f64 = x.iter().map(|x| x * x).sum();
        if r2 >= reach * reach {
            continue;
        }
        let (w, _) = model.kernel.pair(r2);
        let mut q = [1.0; MOST_TERMS];
        let mut term = 1;
        for d in 0..dimension {
            q[term] = x[d] / unit;
            term += 1;
        }
        for d in 0..dimension {
            for e in d..dimension {
                q[term] = x[d] * x[e] / (unit * unit);
                term += 1;
            }
        }
        for row in 0..terms {
            for column in 0..terms {
                system[row][column] += w * q[row] * q[column];
            }
            for d in 0..dimension {
                system[row][MOST_TERMS + d] += w * q[row] * state[(l.velocity() + d) * n + i].f64();
            }
        }
    }
    // Elimination from the last term up: only the first is asked for. The matrix is symmetric and positive.
    let scale = system[0][0];
    for pivot in (1..terms).rev() {
        if system[pivot][pivot].is_nan() || system[pivot][pivot] <= 1e-9 * scale {
            return None;
        }
        for row in 0..pivot {
            let factor = system[row][pivot] / system[pivot][pivot];
            for column in 0..MOST_TERMS + 3 {
                system[row][column] -= factor * system[pivot][column];
            }
        }
    }
    let found = [0, 1, 2].map(|d| system[0][MOST_TERMS + d] / system[0][0]);
    (system[0][0] > 1e-9 * scale && found.iter().all(|x| x.is_finite())).then_some(found)
}
