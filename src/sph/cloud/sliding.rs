//! How points follow the ends of an outline that goes into the sides of the box, as the shape changes.
//!
//! Let an outline r(t; s) with the numbers s go into a side x = X at t = a. The end stays on the side, which is an equation for a(s),
//!
//! ```text
//!   x(a; s) = X,   so   da/ds = -(dx/ds) / (dx/dt).
//! ```
//!
//! Points of the outline are at frozen parameters t; those between an end and the next corner, or the other end, keep their place
//! relative to both, so that t is linear in a. Points of the side do the same between the outlines' ends and the corners of the box. Weights
//! grow as the distances do. (As a mesh does whose nodes slide along the boundary of a domain.)

use super::nearest::Plane;
use super::outline::{Outline, Scalar};

/// The least part of an outline's direction that goes into the side.
const SLANT: f64 = 1e-3;
const STEPS: usize = 60;

/// The end of a part of an outline that is in the fluid.
#[derive(Debug, Clone, Copy)]
pub struct End {
    pub t: f64,
    /// The side of the box that it is on, see [`super::placing::BoundaryPoint::side`]; none on other shapes, or where it touches the side
    /// at a small angle.
    pub side: Option<usize>,
}

impl End {
    /// The end of an outline at t, which may be on a side of the box, but for `tolerance`.
    pub fn new(outline: &Outline, plane: &Plane, t: f64, tolerance: f64) -> Self {
        let on = outline.points(&[t], &outline.numbers)[0];
        let length = on.along[0].hypot(on.along[1]);
        let distance = |side: usize| (on.place[side / 2] - (side % 2) as f64 * plane.size[side / 2]).abs();
        let is_on = |side: &usize| {
            let d = side / 2;
            !plane.periodic[d] && distance(*side) < tolerance && on.along[d].abs() > SLANT * length
        };
        Self { t, side: (0..4).filter(is_on).min_by(|a, b| distance(*a).total_cmp(&distance(*b))) }
    }

    /// Its parameter for other numbers of the shape.
    fn parameter<S: Scalar>(&self, outline: &Outline, numbers: &[S]) -> S {
        let mut t = S::of(self.t);
        let Some(d) = self.side.map(|side| side / 2) else {
            return t;
        };
        let x = outline.points(&[self.t], &outline.numbers)[0].place[d];
        // Newton's method; the last step, where nothing is left, gives slopes.
        for _ in 0..STEPS {
            let on = outline.points_at(&[t], numbers)[0];
            let step = (on.place[d] - S::of(x)) / on.along[d];
            t = t - step;
            if step.value().abs() < 1e-15 {
                break;
            }
        }
        t
    }
}

/// A part of an outline that is in the fluid, between the ends at which it goes into walls.
#[derive(Debug, Clone)]
pub struct Stretch {
    pub shape: usize,
    /// The second one behind the first one, so that it may be above 1.
    pub ends: [End; 2],
}

impl Stretch {
    /// Whether a parameter within 0 and 1 is in it.
    pub fn has(&self, t: f64) -> bool {
        let [from, to] = self.ends.map(|end| end.t);
        t >= from && t <= to || t + 1.0 >= from && t + 1.0 <= to || t - 1.0 >= from && t - 1.0 <= to
    }

    /// The parameters of its ends for numbers of the shape.
    pub fn parameters<S: Scalar>(&self, outline: &Outline, numbers: &[S]) -> [S; 2] {
        self.ends.map(|end| end.parameter(outline, numbers))
    }

    /// The parameter of a point, given those of the ends, and its derivative by the one that it has in the cloud.
    pub fn slid<S: Scalar>(&self, outline: &Outline, to: [S; 2], t: f64) -> (S, S) {
        if self.ends.iter().all(|end| end.side.is_none()) {
            return (S::of(t), S::of(1.0));
        }
        let [a, b] = self.ends.map(|end| end.t);
        let t = [t, t + 1.0, t - 1.0].into_iter().find(|t| (a..=b).contains(t)).unwrap_or(t);
        // The next corners.
        let [after, before] = match outline.piece() {
            Some(width) => [(a / width).floor() * width + width, (b / width).ceil() * width - width],
            None => [b, a],
        };
        let linear = |from: f64, to: f64, [new_from, new_to]: [S; 2]| {
            let rate = (new_to - new_from) / S::of(to - from);
            (new_from + S::of(t - from) * rate, rate)
        };
        if after > before {
            linear(a, b, to)
        } else if t < after {
            linear(a, after, [to[0], S::of(after)])
        } else if t > before {
            linear(before, b, [S::of(before), to[1]])
        } else {
            (S::of(t), S::of(1.0))
        }
    }
}

/// What points of a side are between: a corner of the box, the end of an outline, or where another shape is behind the side, with what holds
/// there.
#[derive(Debug, Clone, Copy)]
pub struct Mark {
    /// Along the side.
    pub at: f64,
    /// Stretch and which of its ends; none of what stays.
    pub end: Option<(usize, usize)>,
}

/// A point of a side that moves along it.
#[derive(Debug, Clone, Copy)]
pub struct OnSide {
    /// Index of the boundary.
    pub point: usize,
    /// The direction of the side, and the place along it.
    pub along: usize,
    pub at: f64,
    pub between: [Mark; 2],
}

impl OnSide {
    /// Its place along the side and its weight's factor, given how far the ends of all stretches have moved.
    pub fn slid<S: Scalar>(&self, feet: &[[S; 2]]) -> (S, S) {
        let [low, high] = self.between.map(|mark| mark.at);
        let moved = self.between.map(|mark| mark.end.map_or(S::of(0.0), |(stretch, end)| feet[stretch][end]));
        let rate = S::of(1.0) + (moved[1] - moved[0]) / S::of(high - low);
        (S::of(low) + moved[0] + S::of(self.at - low) * rate, rate)
    }
}

/// Points of the sides that are next to ends of outlines, in the order given, as index, side and place along it; the marks on sides.
pub fn beside(plane: &Plane, points: &[(usize, usize, f64)], on_sides: &[(usize, Mark)]) -> Vec<OnSide> {
    let of = |&(point, side, at): &(usize, usize, f64)| {
        let along = 1 - side / 2;
        let (size, periodic) = (plane.size[along], plane.periodic[along]);
        let own = on_sides.iter().filter(|(other, _)| *other == side);
        let mut marks: Vec<Mark> = own.map(|(_, mark)| *mark).collect();
        if periodic {
            let again = |by: f64| marks.iter().map(move |mark| Mark { at: mark.at + by, ..*mark }).collect::<Vec<_>>();
            let images = [again(-size), again(size)].concat();
            marks.extend(images);
        } else {
            marks.extend([0.0, size].map(|at| Mark { at, end: None }));
        }
        let low = marks.iter().filter(|mark| mark.at <= at).max_by(|a, b| a.at.total_cmp(&b.at))?;
        let high = marks.iter().filter(|mark| mark.at > at).min_by(|a, b| a.at.total_cmp(&b.at))?;
        let moves = low.end.is_some() || high.end.is_some();
        moves.then_some(OnSide { point, along, at, between: [*low, *high] })
    };
    points.iter().filter_map(of).collect()
}
