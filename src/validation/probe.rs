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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::scene::Config;
    use crate::scene::Scene;

    #[test]
    fn a_quadratic_flow_is_found_anywhere() {
        let loaded = Config::load(Some("taylor-green"), None, &["resolution.dx=0.05".into()]).unwrap();
        let scene = Scene::<f64>::from_config(&loaded.config).unwrap();
        let (model, mut state) = (&scene.model, scene.start.state.clone());
        let n = model.particles();
        let flow = |x: f64, y: f64| [1.0 + x - 2.0 * x * y + y * y, 0.5 * x * x - y];
        for i in 0..n {
            let u = flow(state[i], state[n + i]);
            (0..2).for_each(|d| state[(model.rows.velocity() + d) * n + i] = u[d]);
        }
        for [x, y] in [[0.5, 0.5], [0.313, 0.671], [0.7, 0.25]] {
            let found = velocity(model, &state, [x, y, 0.0]).unwrap();
            let exact = flow(x, y);
            assert!((0..2).all(|d| (found[d] - exact[d]).abs() < 1e-10) && found[2] == 0.0, "{found:?} for {exact:?}");
        }
        // Nobody is around.
        let shifted: Vec<f64> = state.iter().enumerate().map(|(k, x)| if k < n { 0.1 * x } else { *x }).collect();
        assert_eq!(velocity(model, &shifted, [0.5, 0.5, 0.0]), None);
    }

    #[test]
    fn so_it_is_in_three_dimensions() {
        let loaded = Config::load(Some("lid-driven-cavity-3d"), None, &["resolution.dx=0.125".into()]).unwrap();
        let scene = Scene::<f64>::from_config(&loaded.config).unwrap();
        let (model, mut state) = (&scene.model, scene.start.state.clone());
        let n = model.particles();
        let flow = |x: f64, y: f64, z: f64| [1.0 - 2.0 * x * z + y * y, z * z - y, x * y + 0.5 * z];
        for i in 0..n {
            let u = flow(state[i], state[n + i], state[2 * n + i]);
            (0..3).for_each(|d| state[(model.rows.velocity() + d) * n + i] = u[d]);
        }
        for [x, y, z] in [[0.9, 0.8, 0.9], [1.0, 0.6, 0.7]] {
            let found = velocity(model, &state, [x, y, z]).unwrap();
            let exact = flow(x, y, z);
            assert!((0..3).all(|d| (found[d] - exact[d]).abs() < 1e-9), "{found:?} for {exact:?}");
        }
    }
}
