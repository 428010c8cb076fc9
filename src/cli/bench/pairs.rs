//! How many pairs of particles interact, counted from the positions alone (not from a neighbour list with its skin).

use crate::sph::model::Model;
use crate::sph::Sweeps;

/// Directed pairs (i, j), i fluid, j any other particle within the cut-off: what the force on the fluid sums.
pub fn count<R: Sweeps>(model: &Model<R>, position: &[R]) -> usize {
    let (n, dimension) = (model.particles(), model.domain.dimension);
    let cutoff = model.kernel.cutoff();
    let (size, inverse) = (model.domain.size, model.domain.inverse_period());
    let at =
        |i: usize| -> [f64; 3] { std::array::from_fn(|d| if d < dimension { position[d * n + i].f64() } else { 0.0 }) };
    let mut low = [0.0; 3];
    let mut cells = [1_usize; 3];
    for d in 0..dimension {
        let (mut least, mut most) = (0.0, size[d]);
        if !model.domain.periodic[d] {
            least = (0..n).map(|i| at(i)[d]).fold(f64::INFINITY, f64::min);
            most = (0..n).map(|i| at(i)[d]).fold(f64::NEG_INFINITY, f64::max);
        }
        low[d] = least;
        cells[d] = (((most - least) / cutoff) as usize).max(1);
    }
    // Cells are at least a cut-off wide, the last one in a direction without period possibly wider.
    let cell = |r: [f64; 3]| -> [usize; 3] {
        std::array::from_fn(|d| {
            if model.domain.periodic[d] {
                let share = (r[d] / size[d]).rem_euclid(1.0);
                ((share * cells[d] as f64) as usize).min(cells[d] - 1)
            } else {
                (((r[d] - low[d]) / cutoff) as usize).min(cells[d] - 1)
            }
        })
    };
    let number = |c: [usize; 3]| c[0] + cells[0] * (c[1] + cells[1] * c[2]);
    let mut first = vec![0_u32; cells.iter().product::<usize>() + 1];
    let places: Vec<u32> = (0..n).map(|i| number(cell(at(i))) as u32).collect();
    for &place in &places {
        first[place as usize + 1] += 1;
    }
    for c in 1..first.len() {
        first[c] += first[c - 1];
    }
    let mut next = first.clone();
    let mut sorted = vec![[0.0; 3]; n];
    for i in 0..n {
        let place = &mut next[places[i] as usize];
        sorted[*place as usize] = at(i);
        *place += 1;
    }
    // The cells within one of c in direction d, each once.
    let around = |c: usize, d: usize| {
        let mut near = vec![];
        for step in [cells[d] - 1, 0, 1] {
            let reached = (c + step) % cells[d];
            let straight = reached.abs_diff(c) <= 1;
            if (straight || model.domain.periodic[d]) && !near.contains(&reached) {
                near.push(reached);
            }
        }
        near
    };
    let mut pairs = 0;
    for i in (0..n).filter(|&i| model.is_fluid(i)) {
        let (r, c) = (at(i), cell(at(i)));
        for z in around(c[2], 2) {
            for y in around(c[1], 1) {
                for x in around(c[0], 0) {
                    let place = number([x, y, z]);
                    for other in &sorted[first[place] as usize..first[place + 1] as usize] {
                        let mut r2 = 0.0;
                        for d in 0..dimension {
                            let dr = r[d] - other[d];
                            r2 += (dr - size[d] * (dr * inverse[d]).round()).powi(2);
                        }
                        pairs += (r2 < cutoff * cutoff) as usize;
                    }
                }
            }
        }
        // Itself was among them.
        pairs -= 1;
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::taylor_green::TaylorGreen;

    #[test]
    fn as_many_as_all_against_all() {
        for (dimension, per_side) in [(2, 8), (2, 13), (3, 8)] {
            let mut scene = TaylorGreen { dimension, per_side, ..TaylorGreen::default() };
            scene.numerics.jitter = 0.2;
            let flow = scene.build::<f64>();
            let (model, n) = (&flow.model, flow.model.particles());
            let mut expected = 0;
            for i in 0..n {
                for j in (0..n).filter(|&j| j != i) {
                    let r2: f64 = (0..dimension)
                        .map(|d| {
                            let dr = flow.start.state[d * n + i] - flow.start.state[d * n + j];
                            let size = model.domain.size[d];
                            (dr - size * (dr / size).round()).powi(2)
                        })
                        .sum();
                    expected += (r2 < model.kernel.cutoff().powi(2)) as usize;
                }
            }
            assert_eq!(count(model, &flow.start.state), expected);
        }
    }
}
