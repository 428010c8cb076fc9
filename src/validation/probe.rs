//! A velocity at any place of a flow, from the particles around it.

use crate::numerics::lanes::Real;
use crate::particles::tag;
use crate::sph::model::Model;

/// Monomials 1, x, y, x^2, x y, y^2.
const TERMS: usize = 6;

/// Velocity `[u, v]` at a place of a two-dimensional flow: second-order moving least squares (Liu and Liu 2006) over the fluid's
/// particles and, in the consistent formulation, the points on the walls' surfaces, weighted with the scene's kernel. None with
/// too few particles around.
pub fn velocity<R: Real>(model: &Model<R>, state: &[R], place: [f64; 2]) -> Option<[f64; 2]> {
    let (n, l) = (model.particles(), model.layout);
    let (reach, unit) = (model.kernel.cutoff(), model.kernel.smoothing_length);
    let mut system = [[0.0; TERMS + 2]; TERMS];
    for i in 0..n {
        let knows = match model.tags[i] {
            tag::FLUID => true,
            tag::SURFACE => model.consistent.as_ref().is_some_and(|consistent| !consistent.holds_no_velocity(i)),
            _ => false,
        };
        if !knows {
            continue;
        }
        let x: [f64; 2] = std::array::from_fn(|d| model.domain.nearest(d, state[d * n + i].f64() - place[d]));
        let r2 = x[0] * x[0] + x[1] * x[1];
        if r2 >= reach * reach {
            continue;
        }
        let (w, _) = model.kernel.pair(r2);
        let [a, b] = x.map(|x| x / unit);
        let q = [1.0, a, b, a * a, a * b, b * b];
        let u: [f64; 2] = std::array::from_fn(|d| state[(l.velocity() + d) * n + i].f64());
        for row in 0..TERMS {
            for column in 0..TERMS {
                system[row][column] += w * q[row] * q[column];
            }
            (0..2).for_each(|d| system[row][TERMS + d] += w * q[row] * u[d]);
        }
    }
    // Elimination from the last term up: only the first is asked for. The matrix is symmetric and positive.
    let scale = system[0][0];
    for pivot in (1..TERMS).rev() {
        if system[pivot][pivot].is_nan() || system[pivot][pivot] <= 1e-9 * scale {
            return None;
        }
        for row in 0..pivot {
            let factor = system[row][pivot] / system[pivot][pivot];
            for column in 0..TERMS + 2 {
                system[row][column] -= factor * system[pivot][column];
            }
        }
    }
    let found = [0, 1].map(|d| system[0][TERMS + d] / system[0][0]);
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
            (0..2).for_each(|d| state[(model.layout.velocity() + d) * n + i] = u[d]);
        }
        for [x, y] in [[0.5, 0.5], [0.313, 0.671], [0.7, 0.25]] {
            let found = velocity(model, &state, [x, y]).unwrap();
            let exact = flow(x, y);
            assert!((0..2).all(|d| (found[d] - exact[d]).abs() < 1e-10), "{found:?} for {exact:?}");
        }
        // Nobody is around.
        let shifted: Vec<f64> = state.iter().enumerate().map(|(k, x)| if k < n { 0.1 * x } else { *x }).collect();
        assert_eq!(velocity(model, &shifted, [0.5, 0.5]), None);
    }
}
