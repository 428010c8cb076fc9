//! What holds at the points of the boundary of a cloud, by place, time and numbers of shapes, and its derivatives by these.

use super::equations::{BoundaryBar, Condition, Motion, Warmth};

/// Steps of central differences: along places in dx, and of numbers in their size.
const STEP: f64 = 1e-5;

/// The cotangents of a point of the boundary times the difference of two conditions.
pub fn difference<const D: usize>(bar: &BoundaryBar<D>, up: (Motion<D>, Warmth), down: (Motion<D>, Warmth)) -> f64 {
    let number = |warmth: Warmth| match warmth {
        Warmth::Given(x) | Warmth::Flux(x) => x,
    };
    let moves = match (up.0, down.0) {
        (Motion::Given(a), Motion::Given(b)) => (0..D).map(|e| bar.velocity[e] * (a[e] - b[e])).sum(),
        _ => 0.0,
    };
    moves + bar.temperature * (number(up.1) - number(down.1))
}

/// The boundary of a cloud in D dimensions. Points are named by their index in it.
pub trait Conditions<const D: usize> {
    /// Number of particles inside, which are before those of the boundary.
    fn inside(&self) -> usize;
    fn points(&self) -> usize;
    fn dx(&self) -> f64;
    /// What holds at a point, by its place, the time and the numbers of all shapes.
    fn condition(&self, point: usize, place: [f64; D], time: f64, numbers: &[Vec<f64>]) -> (Motion<D>, Warmth);
    /// Whether a point moves with a shape whose conditions depend on the place.
    fn varies(&self, point: usize) -> bool;
    /// Whether conditions depend on time.
    fn has_time(&self) -> bool;
    /// Whether what holds at a point, which is there, may depend on the numbers of a shape.
    fn depends(&self, point: usize, place: [f64; D], shape: usize) -> bool;
    /// Whether a number (shape, number) is a parameter of formulas on a wall, and not of a surface.
    fn is_parameter(&self, number: (usize, usize)) -> bool;

    /// Whether the temperature of a point, which is there, is given and does not change in time.
    fn stays(&self, point: usize, place: [f64; D], numbers: &[Vec<f64>]) -> bool {
        !self.has_time() && matches!(self.condition(point, place, 0.0, numbers).1, Warmth::Given(_))
    }

    /// Whether any of these numbers moves particles: those of surfaces do, and not parameters of what a wall does.
    fn moves(&self, numbers: &[(usize, usize)]) -> bool {
        numbers.iter().any(|&number| !self.is_parameter(number))
    }

    fn place(&self, position: &[Vec<f64>; D], point: usize) -> [f64; D] {
        std::array::from_fn(|d| position[d][self.inside() + point])
    }

    /// What holds at a time at all points, with these unit normals.
    fn conditions_at(
        &self,
        position: &[Vec<f64>; D],
        normals: impl Iterator<Item = [f64; D]>,
        time: f64,
        numbers: &[Vec<f64>],
    ) -> Vec<Condition<D>> {
        let of = |(k, normal): (usize, [f64; D])| {
            let (motion, warmth) = self.condition(k, self.place(position, k), time, numbers);
            Condition { motion, warmth, normal }
        };
        normals.enumerate().map(of).collect()
    }

    /// Of each point the cotangent of its place that those of its given velocity and temperature make at a time; zeros without a
    /// time.
    fn conditions_back(
        &self,
        position: &[Vec<f64>; D],
        numbers: &[Vec<f64>],
        bar: &[BoundaryBar<D>],
        time: Option<f64>,
    ) -> Vec<[f64; D]> {
        let of = |k: usize| {
            let Some(time) = time.filter(|_| self.varies(k)) else { return [0.0; D] };
            let place = self.place(position, k);
            let step = STEP * self.dx();
            std::array::from_fn(|d| {
                let at = |sign: f64| {
                    let mut p = place;
                    p[d] += sign * step;
                    self.condition(k, p, time, numbers)
                };
                difference(&bar[k], at(1.0), at(-1.0)) / (2.0 * step)
            })
        };
        (0..self.points()).map(of).collect()
    }

    /// The derivative by a parameter of the formulas on a shape, given the cotangents of velocities and temperatures at a time.
    fn by_parameter(
        &self,
        position: &[Vec<f64>; D],
        numbers: &[Vec<f64>],
        bar: &[BoundaryBar<D>],
        (shape, number): (usize, usize),
        time: f64,
    ) -> f64 {
        let step = STEP * numbers[shape][number].abs().max(1e-3);
        let with = |sign: f64| {
            let mut numbers = numbers.to_vec();
            numbers[shape][number] += sign * step;
            numbers
        };
        let (up, down) = (with(1.0), with(-1.0));
        let of = |k: usize| {
            let place = self.place(position, k);
            let at = |numbers: &[Vec<f64>]| self.condition(k, place, time, numbers);
            self.depends(k, place, shape).then(|| difference(&bar[k], at(&up), at(&down)) / (2.0 * step))
        };
        (0..self.points()).filter_map(of).sum()
    }
}
