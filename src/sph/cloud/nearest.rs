//! Nearest neighbours in a periodic plane, by cells.

/// A box with its corner at 0, periodic or not along each direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    pub size: [f64; 2],
    pub periodic: [bool; 2],
}

impl Plane {
    /// The vector from a to the nearest image of b.
    pub fn between(&self, a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|d| {
            let x = b[d] - a[d];
            // Most are near.
            if self.periodic[d] && x.abs() > 0.5 * self.size[d] {
                x - self.size[d] * (x / self.size[d]).round()
            } else {
                x
            }
        })
    }

    /// The offsets of periodic images next to the box, itself among them.
    pub fn images(&self) -> impl Iterator<Item = [f64; 2]> + '_ {
        let steps = |d: usize| if self.periodic[d] { -1..=1 } else { 0..=0 };
        steps(0).flat_map(move |i| steps(1).map(move |j| [f64::from(i) * self.size[0], f64::from(j) * self.size[1]]))
    }

    pub fn distance(&self, a: [f64; 2], b: [f64; 2]) -> f64 {
        let [x, y] = self.between(a, b);
        (x * x + y * y).sqrt()
    }

    /// The image of a place within the box.
    pub fn wrapped(&self, p: [f64; 2]) -> [f64; 2] {
        std::array::from_fn(|d| {
            if self.periodic[d] {
                let x = p[d].rem_euclid(self.size[d]);
                if x < self.size[d] {
                    x
                } else {
                    0.0
                }
            } else {
                p[d]
            }
        })
    }
}

/// The division of a plane into cells that are at least of a width.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cells {
    pub plane: Plane,
    counts: [usize; 2],
}

impl Cells {
    pub fn new(plane: Plane, width: f64) -> Self {
        Self { plane, counts: std::array::from_fn(|d| ((plane.size[d] / width) as usize).clamp(1, 4096)) }
    }

    pub fn count(&self) -> usize {
        self.counts[0] * self.counts[1]
    }

    /// Column and row of the cell of a place; of the nearest one outside of the box.
    pub fn index(&self, p: [f64; 2]) -> [i64; 2] {
        std::array::from_fn(|d| {
            let k = (p[d] / self.plane.size[d] * self.counts[d] as f64).floor() as i64;
            k.clamp(0, self.counts[d] as i64 - 1)
        })
    }

    /// The cell at a column and row, or its periodic image; none outside of the box.
    pub fn at(&self, index: [i64; 2]) -> Option<usize> {
        let along = |d: usize| {
            let (k, count) = (index[d], self.counts[d] as i64);
            let k = if self.plane.periodic[d] { k.rem_euclid(count) } else { k };
            (0..count).contains(&k).then_some(k as usize)
        };
        Some(along(0)? * self.counts[1] + along(1)?)
    }

    /// The cell of a place.
    pub fn of(&self, p: [f64; 2]) -> usize {
        let [i, j] = self.index(p);
        i as usize * self.counts[1] + j as usize
    }

    /// Whether cells that are this many columns and rows from each other are no nearer the other way round.
    fn is_nearest_image(&self, steps: [i64; 2]) -> bool {
        (0..2).all(|d| {
            let count = self.counts[d] as i64;
            !self.plane.periodic[d] || 2 * steps[d].abs() < count || 2 * steps[d] == count
        })
    }

    fn width(&self) -> f64 {
        (0..2).map(|d| self.plane.size[d] / self.counts[d] as f64).fold(f64::MAX, f64::min)
    }
}

/// Places sorted into cells.
#[derive(Debug)]
pub struct Nearest {
    cells: Cells,
    /// First member of each cell.
    first: Vec<u32>,
    members: Vec<u32>,
    places: Vec<[f64; 2]>,
}

impl Nearest {
    /// Sorts places, which are within the box or just outside of sides that are not periodic, into cells of a width.
    pub fn new(plane: Plane, width: f64, places: &[[f64; 2]]) -> Self {
        let cells = Cells::new(plane, width);
        let own: Vec<usize> = places.iter().map(|p| cells.of(*p)).collect();
        let mut first = vec![0; cells.count() + 1];
        own.iter().for_each(|&cell| first[cell + 1] += 1);
        for cell in 1..first.len() {
            first[cell] += first[cell - 1];
        }
        let mut next = first.clone();
        let mut members = vec![0; places.len()];
        for (i, &cell) in own.iter().enumerate() {
            members[next[cell] as usize] = i as u32;
            next[cell] += 1;
        }
        Self { cells, first, members, places: places.to_vec() }
    }

    /// The members of the cells in the ring of a width around a cell; none when no such cell is left.
    fn ring(&self, centre: [i64; 2], ring: i64, found: &mut Vec<u32>) -> bool {
        let mut any = false;
        for i in -ring..=ring {
            let step = if i.abs() == ring { 1 } else { (2 * ring).max(1) };
            for j in (-ring..=ring).step_by(step as usize) {
                // Every cell once, also where rings are wider than the box.
                let cell = self.cells.at([centre[0] + i, centre[1] + j]);
                if let Some(cell) = cell.filter(|_| self.cells.is_nearest_image([i, j])) {
                    any = true;
                    found.extend_from_slice(&self.members[self.first[cell] as usize..self.first[cell + 1] as usize]);
                }
            }
        }
        any
    }

    /// The nearest `count` places that `wanted` accepts, with their distances, nearest first; equally near ones by number.
    pub fn of(&self, p: [f64; 2], count: usize, wanted: impl Fn(usize, f64) -> bool) -> Vec<(f64, u32)> {
        self.within(p, count, f64::INFINITY, wanted)
    }

    /// Those of [`Self::of`] that are at most `most` away.
    fn within(&self, p: [f64; 2], count: usize, most: f64, wanted: impl Fn(usize, f64) -> bool) -> Vec<(f64, u32)> {
        let (width, centre) = (self.cells.width(), self.cells.index(p));
        let mut chosen: Vec<(f64, u32)> = Vec::with_capacity(count);
        // Found, but perhaps not the next nearest.
        let mut waiting: Vec<(f64, u32)> = vec![];
        let mut members = vec![];
        for ring in 0.. {
            members.clear();
            let any = self.ring(centre, ring, &mut members);
            waiting.extend(members.iter().map(|&i| (self.cells.plane.distance(p, self.places[i as usize]), i)));
            // All within this distance are found.
            let certain = if any { ring as f64 * width } else { f64::INFINITY };
            let mut ready: Vec<(f64, u32)> =
                waiting.iter().copied().filter(|(distance, _)| *distance <= certain).collect();
            waiting.retain(|(distance, _)| *distance > certain);
            ready.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (distance, i) in ready {
                if chosen.len() < count && distance <= most && wanted(i as usize, distance) {
                    chosen.push((distance, i));
                }
            }
            if !any || chosen.len() >= count || certain > most {
                break;
            }
        }
        chosen
    }

    /// The distance from the nearest place, infinite if it is more than `most`.
    pub fn distance(&self, p: [f64; 2], most: f64) -> f64 {
        self.one(p, most).map_or(f64::INFINITY, |found| found.0)
    }

    /// The nearest place, if it is at most `most` away.
    pub fn one(&self, p: [f64; 2], most: f64) -> Option<(f64, usize)> {
        self.within(p, 1, most, |_, _| true).first().map(|&(distance, i)| (distance, i as usize))
    }
}
