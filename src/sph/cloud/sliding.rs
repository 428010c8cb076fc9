//! How points follow the ends of an outline that goes into other walls, as shapes change.
//!
//! Let an outline r(t; s) with the numbers s go into a side x = X at t = a. The end stays on the side, which is an equation for a(s),
//!
//! ```text
//!   x(a; s) = X,   so   da/ds = -(dx/ds) / (dx/dt).
//! ```
//!
//! Where it goes into another outline q(u; s), at u = b, the end is at r(a; s) = q(b; s), two equations for a and b.
//!
//! Points of the outline are at frozen parameters t; those between an end and the next corner, or the other end, keep their place
//! relative to both, so that t is linear in a. Points of the side do the same between the outlines' ends and the corners of the box. Weights
//! grow as the distances do. (As a mesh does whose nodes slide along the boundary of a domain.)

use super::nearest::Plane;
use super::outline::{cross, length, Outline, Scalar};

/// The least sine of the angle between an outline and the wall that it goes into.
const SLANT: f64 = 1e-3;
const STEPS: usize = 60;
/// An outline ends on a side that is nearer than this, in dx.
pub const AT_SIDE: f64 = 1e-6;
/// The same of another outline, which is drawn with straight lines to find where it ends.
const AT_SHAPE: f64 = 0.1;
/// Places per piece of an outline among which the nearest one is looked for.
const SAMPLES: usize = 64;

/// What an outline goes into.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Footing {
    /// A side of the box, see [`super::placing::BoundaryPoint::side`].
    Side(usize),
    /// Another shape, at a parameter of its outline.
    Shape(usize, f64),
    /// None that is known, or one that it touches at a small angle.
    Nothing,
}

/// The end of a part of an outline that is in the fluid.
#[derive(Debug, Clone, Copy)]
pub struct End {
    pub t: f64,
    pub place: [f64; 2],
    pub footing: Footing,
}

impl End {
    /// The end of a shape's outline at t, among all outlines, given the spacing.
    pub fn new(outlines: &[Outline], shape: usize, plane: &Plane, t: f64, dx: f64) -> Self {
        let on = outlines[shape].points(&[t], &outlines[shape].numbers)[0];
        let distance = |side: usize| (on.place[side / 2] - (side % 2) as f64 * plane.size[side / 2]).abs();
        let is_on = |side: &usize| {
            let d = side / 2;
            !plane.periodic[d] && distance(*side) < AT_SIDE * dx && on.along[d].abs() > SLANT * length(on.along)
        };
        if let Some(side) = (0..4).filter(is_on).min_by(|a, b| distance(*a).total_cmp(&distance(*b))) {
            return Self { t, place: on.place, footing: Footing::Side(side) };
        }
        let goes_into = |other: usize| {
            let outline = &outlines[other];
            let u = nearest(outline, plane, on.place);
            let there = outline.points(&[u], &outline.numbers)[0];
            let slant = cross(on.along, there.along).abs() / (length(on.along) * length(there.along));
            let is_there = length(plane.between(on.place, there.place)) < AT_SHAPE * dx && slant > SLANT;
            is_there.then_some(Footing::Shape(other, u))
        };
        let footing = (0..outlines.len()).filter(|&other| other != shape).find_map(goes_into);
        Self { t, place: on.place, footing: footing.unwrap_or(Footing::Nothing) }
    }

    /// Its parameter for other numbers of all shapes. (By Newton's method; the last step, where nothing is left, gives slopes.)
    fn parameter<S: Scalar>(&self, outlines: &[Outline], shape: usize, numbers: &[Vec<S>]) -> S {
        let (outline, first) = (&outlines[shape], self.place);
        let mut t = S::of(self.t);
        let mut steps = |step: &mut dyn FnMut(S) -> S| {
            for _ in 0..STEPS {
                let by = step(t);
                t = t - by;
                if by.value().abs() < 1e-15 {
                    break;
                }
            }
            t
        };
        match self.footing {
            Footing::Nothing => t,
            Footing::Side(side) => steps(&mut |t| {
                let on = outline.points_at(&[t], &numbers[shape])[0];
                (on.place[side / 2] - S::of(first[side / 2])) / on.along[side / 2]
            }),
            Footing::Shape(other, u) => {
                let wall = &outlines[other];
                let there = wall.points(&[u], &wall.numbers)[0].place;
                let mut u = S::of(u);
                steps(&mut |t| {
                    let a = outline.points_at(&[t], &numbers[shape])[0];
                    let b = wall.points_at(&[u], &numbers[other])[0];
                    // Images may be a period from each other.
                    let apart = [0, 1].map(|d| a.place[d] - b.place[d] - S::of(first[d] - there[d]));
                    let area = cross(a.along, b.along);
                    u = u - cross(apart, a.along) / area;
                    cross(apart, b.along) / area
                })
            }
        }
    }
}

/// The parameter of the point of an outline that is nearest to a place.
fn nearest(outline: &Outline, plane: &Plane, p: [f64; 2]) -> f64 {
    let samples = outline.samples(SAMPLES);
    let points = outline.points(&samples, &outline.numbers);
    let distance = |k: usize| length(plane.between(p, points[k].place));
    let first = (0..samples.len()).min_by(|a, b| distance(*a).total_cmp(&distance(*b))).unwrap_or(0);
    let mut u = samples[first];
    for _ in 0..STEPS {
        let on = outline.points(&[u], &outline.numbers)[0];
        let r = plane.between(on.place, p);
        let step = (r[0] * on.along[0] + r[1] * on.along[1]) / (on.along[0].powi(2) + on.along[1].powi(2));
        u += step;
        if step.abs() < 1e-15 {
            break;
        }
    }
    u.rem_euclid(1.0)
}

/// A part of an outline that is in the fluid, between the ends at which it goes into walls.
#[derive(Debug, Clone)]
pub struct Stretch {
    pub shape: usize,
    /// The second one behind the first one, so that it may be above 1.
    pub ends: [End; 2],
}

impl Stretch {
    /// A parameter within 0 and 1 as one between those of the ends, if it is in it.
    pub fn between(&self, t: f64) -> Option<f64> {
        let [from, to] = self.ends.map(|end| end.t);
        [t, t + 1.0, t - 1.0].into_iter().find(|t| (from..=to).contains(t))
    }

    /// The parameters of its ends for numbers of all shapes.
    pub fn parameters<S: Scalar>(&self, outlines: &[Outline], numbers: &[Vec<S>]) -> [S; 2] {
        self.ends.map(|end| end.parameter(outlines, self.shape, numbers))
    }

    /// Whether its points move with the numbers of a shape.
    pub fn follows(&self, shape: usize) -> bool {
        let is_in = |end: &End| matches!(end.footing, Footing::Shape(other, _) if other == shape);
        self.shape == shape || self.ends.iter().any(is_in)
    }

    /// The parameter of a point of it, given those of the ends, and its derivative by the one that it has in the cloud, see [`Self::between`].
    pub fn slid<S: Scalar>(&self, outline: &Outline, to: [S; 2], t: f64) -> (S, S) {
        if self.ends.iter().all(|end| end.footing == Footing::Nothing) {
            return (S::of(t), S::of(1.0));
        }
        let [a, b] = self.ends.map(|end| end.t);
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
