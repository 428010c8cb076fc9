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

/// Places sorted into cells.
#[derive(Debug)]
pub struct Nearest {
    plane: Plane,
    counts: [usize; 2],
    /// First member of each cell.
    first: Vec<u32>,
    members: Vec<u32>,
    places: Vec<[f64; 2]>,
}

impl Nearest {
    /// Sorts places, which are within the box or just outside of sides that are not periodic, into cells of a width.
    pub fn new(plane: Plane, width: f64, places: &[[f64; 2]]) -> Self {
        let counts: [usize; 2] = std::array::from_fn(|d| ((plane.size[d] / width) as usize).clamp(1, 4096));
        let mut all = Self { plane, counts, first: vec![], members: vec![], places: places.to_vec() };
        let cells: Vec<usize> = places.iter().map(|p| all.cell(*p)).collect();
        all.first = vec![0; counts[0] * counts[1] + 1];
        cells.iter().for_each(|&cell| all.first[cell + 1] += 1);
        for cell in 1..all.first.len() {
            all.first[cell] += all.first[cell - 1];
        }
        let mut next = all.first.clone();
        all.members = vec![0; places.len()];
        for (i, &cell) in cells.iter().enumerate() {
            all.members[next[cell] as usize] = i as u32;
            next[cell] += 1;
        }
        all
    }

    fn index(&self, p: [f64; 2]) -> [i64; 2] {
        std::array::from_fn(|d| {
            let k = (p[d] / self.plane.size[d] * self.counts[d] as f64).floor() as i64;
            k.clamp(0, self.counts[d] as i64 - 1)
        })
    }

    fn cell(&self, p: [f64; 2]) -> usize {
        let [i, j] = self.index(p);
        i as usize * self.counts[1] + j as usize
    }

    /// The members of the cells in the ring of a width around a cell; none when no such cell is left.
    fn ring(&self, centre: [i64; 2], ring: i64, found: &mut Vec<u32>) -> bool {
        let mut any = false;
        for i in -ring..=ring {
            let step = if i.abs() == ring { 1 } else { (2 * ring).max(1) };
            let mut j = -ring;
            while j <= ring {
                let at: [Option<i64>; 2] = std::array::from_fn(|d| {
                    let (k, count) = (centre[d] + [i, j][d], self.counts[d] as i64);
                    match self.plane.periodic[d] {
                        // Every cell once, also where rings are wider than the box.
                        true if 2 * [i, j][d].abs() < count || 2 * [i, j][d] == count => Some(k.rem_euclid(count)),
                        true => None,
                        false => (0..count).contains(&k).then_some(k),
                    }
                });
                if let [Some(a), Some(b)] = at {
                    any = true;
                    let cell = a as usize * self.counts[1] + b as usize;
                    found.extend_from_slice(&self.members[self.first[cell] as usize..self.first[cell + 1] as usize]);
                }
                j += step;
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
        let width = (0..2).map(|d| self.plane.size[d] / self.counts[d] as f64).fold(f64::MAX, f64::min);
        let centre = self.index(p);
        let mut chosen: Vec<(f64, u32)> = Vec::with_capacity(count);
        // Found, but perhaps not the next nearest.
        let mut waiting: Vec<(f64, u32)> = vec![];
        let mut members = vec![];
        for ring in 0.. {
            members.clear();
            let any = self.ring(centre, ring, &mut members);
            waiting.extend(members.iter().map(|&i| (self.plane.distance(p, self.places[i as usize]), i)));
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
