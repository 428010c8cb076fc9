//! Places particles apart from each other and from walls, by repulsion.
//!
//! A wall that cuts a lattice leaves particles at any distance from it. One that begins much nearer than half a spacing
//! is faster across that distance than the time step allows. Here such particles are moved away from the wall, and those
//! that are then too near to each other are pushed apart, so that the disorder spreads over a few rows. A sum over pairs
//! and a distance from walls is all that it needs: walls may have any shape, in two and three dimensions.

use crate::particles::neighbour_list::NeighbourError;
use crate::particles::{tag, Domain, NeighbourList};

/// Distance from walls at the start, in spacings: about that of a lattice between walls, but not exactly it, because there
/// begins the push of the particle shift, which has no derivative at its beginning.
const FROM_WALLS: f64 = 0.52;
/// Nothing is moved if no particle is nearer to a wall than this, in spacings.
const NEAR: f64 = 0.45;
/// Particles nearer to each other than this, in spacings, push each other.
const APART: f64 = 0.9;
/// Particles farther from walls than this, in spacings, stay.
const REACH: f64 = 8.0;
/// Largest number of rounds, and the largest move of the last one, in spacings.
const ROUNDS: usize = 300;
const SETTLED: f64 = 1e-3;

/// Moves particles, `[D, N]`, away from walls and from each other, as far as there is room. `wall` gives the distance of a
/// place from the nearest wall, negative inside, and `normal` the direction in which it grows.
///
/// # Errors
/// A particle that is not in the box.
pub fn keep_apart(
    position: &mut [f64],
    domain: &Domain,
    spacing: f64,
    wall: impl Fn([f64; 3]) -> f64,
    normal: impl Fn([f64; 3]) -> Option<[f64; 3]>,
) -> Result<(), NeighbourError> {
    let dimension = domain.dimension;
    let n = position.len() / dimension;
    let place = |position: &[f64], i: usize| -> [f64; 3] {
        std::array::from_fn(|d| if d < dimension { position[d * n + i] } else { 0.0 })
    };
    // A lower bound of each particle's distance from walls: it falls by what the particle has moved since it was taken.
    let mut distance: Vec<f64> = (0..n).map(|i| wall(place(position, i))).collect();
    if distance.iter().all(|&s| s >= NEAR * spacing) {
        return Ok(());
    }
    let moves: Vec<bool> = distance.iter().map(|&s| s < REACH * spacing).collect();
    let tags = vec![tag::FLUID; n];
    let mut capacity = 0;
    for _ in 0..ROUNDS {
        let list = NeighbourList::build(position, &tags, domain, APART * spacing, capacity)?;
        capacity = list.capacity;
        let before = position.to_vec();
        for i in (0..n).filter(|&i| moves[i]) {
            let own = place(&before, i);
            for &j in &list.index[i * list.capacity..][..list.count[i] as usize] {
                let other = place(&before, j as usize);
                let apart: [f64; 3] = std::array::from_fn(|d| domain.nearest(d, own[d] - other[d]));
                let r = apart.iter().map(|x| x * x).sum::<f64>().sqrt();
                let share = if moves[j as usize] { 0.5 } else { 1.0 };
                // Particles at the same place have no direction.
                let push = if r > 0.0 { share * (APART * spacing - r) / r } else { 0.0 };
                (0..dimension).for_each(|d| position[d * n + i] += push * apart[d]);
            }
            let moved = |position: &[f64]| {
                let now = place(position, i);
                (0..3).map(|d| (now[d] - own[d]).powi(2)).sum::<f64>().sqrt()
            };
            distance[i] -= moved(position);
            if distance[i] < FROM_WALLS * spacing {
                let now = place(position, i);
                distance[i] = wall(now);
                if let Some(away) = normal(now).filter(|_| distance[i] < FROM_WALLS * spacing) {
                    let by = FROM_WALLS * spacing - distance[i];
                    (0..dimension).for_each(|d| position[d * n + i] += by * away[d]);
                    distance[i] = wall(place(position, i));
                }
            }
            (0..dimension).for_each(|d| position[d * n + i] = domain.wrapped(d, position[d * n + i]));
        }
        let largest =
            (0..n * dimension).map(|k| domain.nearest(k / n, position[k] - before[k]).abs()).fold(0.0, f64::max);
        if largest < SETTLED * spacing {
            break;
        }
    }
    Ok(())
}
