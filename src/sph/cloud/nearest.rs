//! Nearest neighbours in a periodic box of two or three dimensions, by cells.

/// A box with its corner at 0, periodic or not along each direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Region<const D: usize> {
    pub size: [f64; D],
    pub periodic: [bool; D],
}

pub type Plane = Region<2>;

impl<const D: usize> Region<D> {
    /// The vector from a to the nearest image of b.
    pub fn between(&self, a: [f64; D], b: [f64; D]) -> [f64; D] {
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
    pub fn images(&self) -> impl Iterator<Item = [f64; D]> + '_ {
        let steps = move |index: usize, d: usize| (index / 3usize.pow(d as u32) % 3) as f64 - 1.0;
        let all = (0..3usize.pow(D as u32)).map(move |index| std::array::from_fn(|d| steps(index, D - 1 - d)));
        let is_there = |step: &[f64; D]| (0..D).all(|d| self.periodic[d] || step[d] == 0.0);
        all.filter(is_there).map(|step| std::array::from_fn(|d| step[d] * self.size[d]))
    }

    pub fn distance(&self, a: [f64; D], b: [f64; D]) -> f64 {
        self.between(a, b).iter().map(|x| x * x).sum::<f64>().sqrt()
    }

    /// The image of a place within the box.
    pub fn wrapped(&self, p: [f64; D]) -> [f64; D] {
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

/// The division of a box into cells that are at least of a width.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cells<const D: usize = 2> {
    pub plane: Region<D>,
    counts: [usize; D],
}

impl<const D: usize> Cells<D> {
    pub fn new(plane: Region<D>, width: f64) -> Self {
        let most = if D == 2 { 4096 } else { 256 };
        Self { plane, counts: std::array::from_fn(|d| ((plane.size[d] / width) as usize).clamp(1, most)) }
    }

    pub fn count(&self) -> usize {
        self.counts.iter().product()
    }

    /// Column and row of the cell of a place. Outside of the box it is that of the place's periodic image or, along directions that are
    /// not periodic, the nearest one.
    pub fn index(&self, p: [f64; D]) -> [i64; D] {
        std::array::from_fn(|d| {
            let (k, count) =
                ((p[d] / self.plane.size[d] * self.counts[d] as f64).floor() as i64, self.counts[d] as i64);
            if self.plane.periodic[d] {
                k.rem_euclid(count)
            } else {
                k.clamp(0, count - 1)
            }
        })
    }

    /// The cell at a column and row, or its periodic image; none outside of the box.
    pub fn at(&self, index: [i64; D]) -> Option<usize> {
        let mut cell = 0;
        for d in 0..D {
            let (k, count) = (index[d], self.counts[d] as i64);
            let k = if self.plane.periodic[d] { k.rem_euclid(count) } else { k };
            cell = cell * self.counts[d] + (0..count).contains(&k).then_some(k as usize)?;
        }
        Some(cell)
    }

    /// The cell of a place.
    pub fn of(&self, p: [f64; D]) -> usize {
        let index = self.index(p);
        (0..D).fold(0, |cell, d| cell * self.counts[d] + index[d] as usize)
    }

    /// Whether cells that are this many columns and rows from each other are no nearer the other way round.
    fn is_nearest_image(&self, steps: [i64; D]) -> bool {
        (0..D).all(|d| {
            let count = self.counts[d] as i64;
            !self.plane.periodic[d] || 2 * steps[d].abs() < count || 2 * steps[d] == count
        })
    }

    fn width(&self) -> f64 {
        (0..D).map(|d| self.plane.size[d] / self.counts[d] as f64).fold(f64::MAX, f64::min)
    }
}

/// Places sorted into cells.
#[derive(Debug)]
pub struct Nearest<const D: usize = 2> {
    cells: Cells<D>,
    /// First member of each cell.
    first: Vec<u32>,
    members: Vec<u32>,
    places: Vec<[f64; D]>,
}

impl<const D: usize> Nearest<D> {
    /// Sorts places, of which some may be just outside of the box, into cells of a width.
    pub fn new(plane: Region<D>, width: f64, places: &[[f64; D]]) -> Self {
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
    fn ring(&self, centre: [i64; D], ring: i64, found: &mut Vec<u32>) -> bool {
        let mut any = false;
        let width = 2 * ring + 1;
        for before in 0..width.pow(D as u32 - 1) {
            let mut steps = [0; D];
            for d in 0..D - 1 {
                steps[d] = before / width.pow((D - 2 - d) as u32) % width - ring;
            }
            let is_outside = steps[..D - 1].iter().any(|step| step.abs() == ring);
            let stride = if is_outside { 1 } else { (2 * ring).max(1) };
            for last in (-ring..=ring).step_by(stride as usize) {
                steps[D - 1] = last;
                // Every cell once, also where rings are wider than the box.
                let cell = self.cells.at(std::array::from_fn(|d| centre[d] + steps[d]));
                if let Some(cell) = cell.filter(|_| self.cells.is_nearest_image(steps)) {
                    any = true;
                    found.extend_from_slice(&self.members[self.first[cell] as usize..self.first[cell + 1] as usize]);
                }
            }
        }
        any
    }

    /// The nearest `count` places that `wanted` accepts, with their distances, nearest first; equally near ones by number.
    pub fn of(&self, p: [f64; D], count: usize, wanted: impl Fn(usize, f64) -> bool) -> Vec<(f64, u32)> {
        self.within(p, count, f64::INFINITY, wanted)
    }

    /// Those of [`Self::of`] that are at most `most` away.
    fn within(&self, p: [f64; D], count: usize, most: f64, wanted: impl Fn(usize, f64) -> bool) -> Vec<(f64, u32)> {
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
    pub fn distance(&self, p: [f64; D], most: f64) -> f64 {
        self.one(p, most).map_or(f64::INFINITY, |found| found.0)
    }

    /// The nearest place, if it is at most `most` away.
    pub fn one(&self, p: [f64; D], most: f64) -> Option<(f64, usize)> {
        self.within(p, 1, most, |_, _| true).first().map(|&(distance, i)| (distance, i as usize))
    }
}
