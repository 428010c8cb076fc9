//! Evenly spaced streamlines of a plane field (Jobard and Lefer 1997).
//!
//! A line begins at a seed and follows the field both ways, by the midpoint rule with steps of a fixed length along the field's direction.
//! It ends where the field does, where it hardly moves, and nearer than half of the spacing to other lines or to its own beginning. New
//! seeds are beside the lines, at the spacing; the lines that are drawn first have the most to follow.

use std::collections::{HashMap, VecDeque};

/// Length of a step and distance of lines that end beside others, in spacings.
const STEP: f64 = 0.1;
const APART: f64 = 0.5;
/// Lines shorter than this are left out, in spacings.
const SHORTEST: f64 = 1.5;
/// Places beside a line where others may begin are this many steps from each other.
const BETWEEN: usize = 5;
/// Places of the same line that are as many steps apart, or less, are neighbours.
const NEXT: usize = 5;
/// Steps of the longest line.
const LONGEST: usize = 5000;

type Place = [f64; 2];

/// Places on lines by cells as wide as the spacing.
struct Taken {
    spacing: f64,
    cells: HashMap<[i64; 2], Vec<Place>>,
}

impl Taken {
    fn cell(&self, p: Place) -> [i64; 2] {
        p.map(|x| (x / self.spacing).floor() as i64)
    }

    /// Whether a place of a line is nearer than `distance`.
    fn is_near(&self, p: Place, distance: f64) -> bool {
        let [i, j] = self.cell(p);
        let near = |q: &Place| (q[0] - p[0]).hypot(q[1] - p[1]) < distance;
        (-1..=1).any(|a| (-1..=1).any(|b| self.cells.get(&[i + a, j + b]).is_some_and(|all| all.iter().any(near))))
    }

    fn add(&mut self, line: &[Place]) {
        for &p in line {
            let cell = self.cell(p);
            self.cells.entry(cell).or_default().push(p);
        }
    }
}

/// One half of a line: from its beginning along the field (`sign` 1) or against it.
fn half(
    field: &dyn Fn(Place) -> Option<Place>,
    taken: &Taken,
    from: Place,
    sign: f64,
    least: f64,
    other: &[Place],
) -> Vec<Place> {
    let (step, apart) = (STEP * taken.spacing, APART * taken.spacing);
    let direction = |p: Place| {
        let u = field(p)?;
        let size = u[0].hypot(u[1]);
        (size > least).then(|| u.map(|u| sign * u / size))
    };
    let moved = |p: Place, u: Place, by: f64| [p[0] + by * u[0], p[1] + by * u[1]];
    let mut line = vec![from];
    for _ in 0..LONGEST {
        let here = line[line.len() - 1];
        let Some(next) = direction(here)
            .and_then(|first| direction(moved(here, first, 0.5 * step)))
            .map(|middle| moved(here, middle, step))
            .filter(|next| field(*next).is_some() && !taken.is_near(*next, apart))
        else {
            break;
        };
        // A closed line ends at its beginning: its last places do not count.
        let before = line[..line.len().saturating_sub(NEXT)].iter().chain(other.iter().skip(NEXT));
        let is_closed = before.into_iter().any(|q| (q[0] - next[0]).hypot(q[1] - next[1]) < 1.3 * step);
        line.push(next);
        if is_closed {
            break;
        }
    }
    line
}

/// Lines about `spacing` apart that follow a field from some seeds on. `least`: a speed below which nothing moves.
pub fn streamlines(
    field: &dyn Fn(Place) -> Option<Place>,
    seeds: &[Place],
    spacing: f64,
    least: f64,
) -> Vec<Vec<Place>> {
    let mut taken = Taken { spacing, cells: HashMap::new() };
    let mut lines: Vec<Vec<Place>> = vec![];
    let mut waiting: VecDeque<Place> = VecDeque::new();
    for &seed in seeds {
        waiting.push_back(seed);
        while let Some(seed) = waiting.pop_front() {
            // (A little less than the spacing, which places beside a curved line have from it.)
            if field(seed).is_none() || taken.is_near(seed, 0.98 * spacing) {
                continue;
            }
            let ahead = half(field, &taken, seed, 1.0, least, &[]);
            let behind = half(field, &taken, seed, -1.0, least, &ahead);
            let line: Vec<Place> = behind.iter().skip(1).rev().chain(&ahead).copied().collect();
            if (line.len() as f64) * STEP < SHORTEST {
                continue;
            }
            taken.add(&line);
            for pair in line.windows(2).step_by(BETWEEN) {
                let along = [pair[1][0] - pair[0][0], pair[1][1] - pair[0][1]];
                let size = along[0].hypot(along[1]) / spacing;
                for sign in [-1.0, 1.0] {
                    waiting.push_back([pair[0][0] - sign * along[1] / size, pair[0][1] + sign * along[0] / size]);
                }
            }
            lines.push(line);
        }
    }
    lines
}
