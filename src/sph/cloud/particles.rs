//! A cloud of fixed particles around shapes, and how it depends on their numbers.

use super::conditions::Conditions;
use super::deferred_correction::{self, Defect, Lagged};
use super::deformation::Deformation;
use super::equations::{damping, Bar, BoundaryBar, Condition, Derivatives, Equations, Motion, State, Warmth};
use super::fit::{Coefficients, Stencils};
use super::fits::Fits;
use super::nearest::{Nearest, Plane};
use super::outline::{cross, seeded, Dual, Scalar};
use super::placing::{BoundaryPoint, Ground, Places, Unplaceable};
use super::sliding::{End, Footing, OnSide, Stretch};
use super::smoothing::Smoothing;
use super::wall_fit::{self, WallFit};
use crate::numerics::sparse_lu::dot;
use crate::sph::laws::buoyancy::Buoyancy;
use std::fmt::Debug;
use std::sync::Arc;

/// Neighbours of the fits. (Measured around ten bodies in a channel, dx = 0.02. With 16 to 18 the heat is at most 0.6, 0.4 and 0.3 % off
/// finite elements; its gradient by the radii of a spline is along theirs with a cosine of 0.983, 0.981, 0.980. Flow and drag are best
/// with 16.)
pub const NEIGHBOURS: usize = 16;

/// Velocity and temperature that points of the boundary have, by place. The flow's material constants.
pub trait Surroundings: Debug + Send + Sync {
    /// `numbers`: those of all shapes.
    fn condition(&self, point: &BoundaryPoint, place: [f64; 2], time: f64, numbers: &[Vec<f64>]) -> (Motion, Warmth);
    /// The shape that a point on a side of the box belongs to, if one is behind it.
    fn shape_behind(&self, point: &BoundaryPoint, place: [f64; 2]) -> Option<usize>;
    /// Whether the conditions of a point, which is there, depend on the place.
    fn varies(&self, point: &BoundaryPoint, place: [f64; 2]) -> bool;
    /// Whether conditions depend on time.
    fn has_time(&self) -> bool;
}

/// Materials and forces of a flow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fluid<const D: usize = 2> {
    pub viscosity: f64,
    pub diffusivity: Option<f64>,
    pub force: [f64; D],
    pub buoyancy: Option<Buoyancy>,
    /// A typical velocity, for the pressure's damping.
    pub velocity: f64,
}

/// What is wrong with a cloud.
#[derive(Debug, Clone, PartialEq)]
pub enum Unusable<const D: usize = 2> {
    Placing(Unplaceable),
    /// A particle has too few neighbours that it sees.
    Lonely([f64; D]),
    /// Walls cut the fluid into parts, and nothing gives the pressure of the one around this place.
    Parts([f64; D]),
    /// The map of a shape turns the cloud inside out here.
    Folded([f64; D]),
    Singular,
}

/// The reference cloud: places, stencils and map.
#[derive(Debug)]
pub struct Cloud {
    pub ground: Ground,
    pub places: Places,
    pub fluid: Fluid,
    pub deformation: Deformation,
    pub fits: Arc<Fits>,
    /// Fits of third order, where flows are corrected by their slopes.
    pub third: Option<Stencils>,
    /// Means among particles inside, and among all, with them.
    pub means: Option<[Smoothing; 2]>,
    /// Of each point of the boundary that is on no body, with heat.
    pub wall_fits: Vec<Option<WallFit>>,
    pub surroundings: Arc<dyn Surroundings>,
}

/// The cloud of one shape.
#[derive(Debug, Clone)]
pub struct Shaped {
    /// The numbers of every shape.
    pub numbers: Vec<Vec<f64>>,
    /// The centre of every shape.
    pub centre: Vec<[f64; 2]>,
    /// `[2][N]`.
    pub position: [Vec<f64>; 2],
    /// Normal into the fluid times length, of each point of the boundary.
    pub area: Vec<[f64; 2]>,
    pub conditions: Vec<Condition>,
    pub operators: Coefficients,
    /// Those of the fits of third order.
    pub third: Option<Coefficients>,
}

/// In which flow figures of bodies follow from what the flow around them conserves, instead of sums over their surfaces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Balanced {
    /// Forces, torques and heat do.
    Steady,
    /// In an incompressible flow that goes on in time forces and heat do.
    InTime,
    /// The same in one with sound.
    WithSound,
}

/// State and derivatives at one shape.
pub struct At<'a> {
    pub equations: &'a Equations,
    pub shaped: &'a Shaped,
    pub state: &'a State,
    pub d: &'a Derivatives,
    /// What slopes lack, in a flow in time whose steps have it.
    pub defect: Option<&'a Defect>,
}

impl At<'_> {
    pub fn velocity(&self, i: usize) -> [f64; 2] {
        [self.state.fields[0][i], self.state.fields[1][i]]
    }

    /// The particle at a point of the boundary.
    pub fn on(&self, k: usize) -> usize {
        self.equations.inside + k
    }

    /// The place of a point of the boundary.
    pub fn place_on(&self, k: usize) -> [f64; 2] {
        [self.shaped.position[0][self.on(k)], self.shaped.position[1][self.on(k)]]
    }
}

/// Whether two segments cross.
fn crosses(a: [f64; 2], b: [f64; 2], c: [f64; 2], d: [f64; 2]) -> bool {
    let minus = |p: [f64; 2], q: [f64; 2]| [p[0] - q[0], p[1] - q[1]];
    let side = |p, q, r| cross(minus(q, p), minus(r, p));
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}

/// Decides whether particles can be neighbours: no shape is between them.
struct Sight<'a> {
    plane: Plane,
    places: &'a Places,
    /// The points on shapes, and of each the place in the boundary and the two next to it along its outline; itself at the end of one that
    /// leaves the fluid.
    points: Nearest,
    boundary: Vec<[usize; 3]>,
    /// Distance of every particle from the nearest point on a shape.
    distance: Vec<f64>,
}

/// Particles farther than this from shapes, in dx, are hidden from nobody.
const HIDES: f64 = 6.0;
/// Points of an outline that are farther from each other, in their spacing, have a part of it between them that is not in the fluid.
const NEXT: f64 = 2.0;
/// Points on shapes around the middle of a segment whose edges it may cross.
const EDGES: usize = 12;

impl<'a> Sight<'a> {
    fn new(ground: &Ground, places: &'a Places) -> Self {
        // The points of each shape in order along its outline.
        let mut lines: Vec<Vec<usize>> = vec![vec![]; ground.outlines.len()];
        for (k, point) in places.boundary.iter().enumerate() {
            if let Some((shape, _)) = point.on {
                lines[shape].push(k);
            }
        }
        let place = |k: usize| places.place[places.boundary[k].particle];
        let spacing = |k: usize| places.spacing[places.boundary[k].particle];
        let distance = |k: usize, next: usize| ground.plane.distance(place(k), place(next));
        let turn = |k: usize, next: usize| {
            let [a, b] = [k, next].map(|k| places.boundary[k].normal);
            a[0] * b[0] + a[1] * b[1]
        };
        let is_near = |k: usize, next: usize| distance(k, next) < NEXT * spacing(k).max(spacing(next));
        let is_whole = |k: usize| places.boundary[k].on.is_some_and(|(shape, _)| places.bodies.contains(&shape));
        let is_next = |k: usize, next: usize| is_whole(k) || (is_near(k, next) && turn(k, next) > -0.5);
        let mut boundary: Vec<[usize; 3]> = vec![];
        for line in &mut lines {
            let t = |k: usize| places.boundary[k].on.map_or(0.0, |on| on.1);
            line.sort_by(|&a, &b| t(a).total_cmp(&t(b)));
            let n = line.len();
            for (i, &k) in line.iter().enumerate() {
                let [before, after] = [line[(i + n - 1) % n], line[(i + 1) % n]];
                // The end of a wall along a whole period has its beginning next to it.
                let across_period = || {
                    let may = |&next: &usize| {
                        let [a, b] = [place(k), place(next)];
                        let is_wrapped = (a[0] - b[0]).hypot(a[1] - b[1]) > 1.5 * distance(k, next);
                        is_wrapped && is_near(k, next) && turn(k, next) > 0.5
                    };
                    let found = line.iter().copied().filter(may);
                    found.min_by(|&a, &b| distance(k, a).total_cmp(&distance(k, b))).unwrap_or(k)
                };
                let next = |next: usize| if is_next(k, next) { next } else { across_period() };
                boundary.push([k, next(before), next(after)]);
            }
        }
        let on_shapes: Vec<[f64; 2]> = boundary.iter().map(|[k, ..]| place(*k)).collect();
        let points = Nearest::new(ground.plane, ground.dx, &on_shapes);
        let distance = match boundary.is_empty() {
            true => vec![f64::INFINITY; places.place.len()],
            false => places.place.iter().map(|p| points.distance(*p, HIDES * ground.dx)).collect(),
        };
        Self { plane: ground.plane, places, points, boundary, distance }
    }

    /// The nearest of all particles that a particle sees, with their distances.
    fn nearest(&self, all: &Nearest, i: usize, count: usize) -> Vec<(f64, u32)> {
        all.of(self.places.place[i], count, |j, _| j != i && self.sees(i, j))
    }

    /// `j` is nearer to `i` than it is far.
    fn sees(&self, i: usize, j: usize) -> bool {
        let places = self.places;
        let a = places.place[i];
        let r = self.plane.between(a, places.place[j]);
        let length = (r[0] * r[0] + r[1] * r[1]).sqrt();
        let finest = places.spacing[i].max(places.spacing[j]);
        if self.distance[i] + self.distance[j] > length + finest {
            return true;
        }
        let of = |i: usize| (i >= places.inside).then(|| places.boundary[i - places.inside]);
        let (of_i, of_j) = (of(i), of(j));
        let middle = [a[0] + 0.5 * r[0], a[1] + 0.5 * r[1]];
        if let (Some(p), Some(q)) = (of_i, of_j) {
            // Both sides of a thin body, whose inside is between them.
            let facing = p.normal[0] * q.normal[0] + p.normal[1] * q.normal[1];
            let out = (p.normal[0] * r[0] + p.normal[1] * r[1]) / length;
            if facing < -0.2 && out < 0.3 {
                return false;
            }
            // A side of the box behind a shape that stands on it.
            let is_behind = |own: BoundaryPoint, other: BoundaryPoint| {
                let Some((shape, _)) = own.on.filter(|(shape, _)| other.on.is_none_or(|other| other.0 != *shape))
                else {
                    return false;
                };
                let off = 0.05 * places.spacing[own.particle];
                let off_it = std::array::from_fn(|d| middle[d] + off * own.normal[d]);
                places.polygons[shape].covers(&self.plane, self.plane.wrapped(off_it))
            };
            if is_behind(p, q) || is_behind(q, p) {
                return false;
            }
        }
        let (from, to) = ([-0.5 * r[0], -0.5 * r[1]], [0.5 * r[0], 0.5 * r[1]]);
        let place = |k: usize| self.plane.between(middle, places.place[places.boundary[k].particle]);
        for (_, found) in self.points.of(self.plane.wrapped(middle), EDGES, |_, _| true) {
            let [k, before, after] = self.boundary[found as usize];
            for (next, other) in [(before, after), (after, before)] {
                let own =
                    |p: Option<BoundaryPoint>| p.is_some_and(|p| [k, next].contains(&(p.particle - places.inside)));
                let at = place(k);
                // An outline that leaves the fluid ends up to a spacing before it does.
                let end = if next == k { std::array::from_fn(|d| 2.0 * at[d] - place(other)[d]) } else { place(next) };
                if !own(of_i) && !own(of_j) && crosses(from, to, at, end) {
                    return false;
                }
            }
        }
        // A point on the far side of a tip.
        let wall = if of_i.is_none() != of_j.is_none() { of_i.or(of_j) } else { None };
        if let Some((wall, (body, _))) = wall.and_then(|wall| Some((wall, wall.on?))) {
            let sign = if of_i.is_some() { 1.0 } else { -1.0 };
            let out = sign * (wall.normal[0] * r[0] + wall.normal[1] * r[1]) / length;
            if out < -0.5 && places.polygons[body].covers(&self.plane, self.plane.wrapped(middle)) {
                return false;
            }
        }
        true
    }
}

impl Conditions<2> for Cloud {
    fn inside(&self) -> usize {
        self.places.inside
    }

    fn points(&self) -> usize {
        self.places.boundary.len()
    }

    fn dx(&self) -> f64 {
        self.ground.dx
    }

    fn condition(&self, point: usize, place: [f64; 2], time: f64, numbers: &[Vec<f64>]) -> (Motion, Warmth) {
        self.surroundings.condition(&self.places.boundary[point], place, time, numbers)
    }

    fn varies(&self, point: usize) -> bool {
        let Places { boundary, on_sides, place, .. } = &self.places;
        let on = &boundary[point];
        let moves = on.on.is_some() || on_sides.binary_search_by_key(&point, |on| on.point).is_ok();
        moves && self.surroundings.varies(on, place[on.particle])
    }

    fn has_time(&self) -> bool {
        self.surroundings.has_time()
    }

    fn depends(&self, point: usize, place: [f64; 2], shape: usize) -> bool {
        self.shape_at(&self.places.boundary[point], place) == Some(shape)
    }

    fn is_parameter(&self, (shape, number): (usize, usize)) -> bool {
        number >= self.ground.outlines[shape].geometry
    }
}

/// Fits of second or third order to so many of the particles `near` each.
fn stencils_of(
    ground: &Ground,
    places: &Places,
    near: &[Vec<(f64, u32)>],
    count: usize,
    is_third: bool,
) -> Result<Stencils, Unusable> {
    let stencils = Stencils::new(ground.plane, &places.place, |_| count, |_| is_third, |i| &near[i]);
    stencils.map_err(|i| Unusable::Lonely(places.place[i]))
}

impl Cloud {
    /// Places particles around the shapes of `ground`, with fits of third order if flows are corrected by their slopes.
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn new(
        ground: Ground,
        fluid: Fluid,
        surroundings: Arc<dyn Surroundings>,
        is_corrected: bool,
        threads: usize,
    ) -> Result<Self, Unusable> {
        let places = ground.fill().map_err(Unusable::Placing)?;
        let (near, wall_fits) = {
            let (all, sight) = (Nearest::new(ground.plane, ground.dx, &places.place), Sight::new(&ground, &places));
            let of = |i: usize, count: usize| sight.nearest(&all, i, count);
            let on_wall = |point: &BoundaryPoint| {
                let is_on_body = point.on.is_some_and(|(shape, _)| places.bodies.contains(&shape));
                let near = (!is_on_body && fluid.diffusivity.is_some())
                    .then(|| of(point.particle, wall_fit::NEIGHBOURS + 1))?;
                WallFit::new(ground.plane, &places.place, point.particle, &near)
            };
            let most = if is_corrected { deferred_correction::NEIGHBOURS } else { NEIGHBOURS };
            let near: Vec<_> = (0..places.place.len()).map(|i| of(i, most + 1)).collect();
            (near, places.boundary.iter().map(on_wall).collect())
        };
        let stencils = stencils_of(&ground, &places, &near, NEIGHBOURS, false)?;
        let of_third_order = || stencils_of(&ground, &places, &near, deferred_correction::NEIGHBOURS, true);
        let third = is_corrected.then(of_third_order).transpose()?;
        let position = std::array::from_fn(|d| places.place.iter().map(|p| p[d]).collect());
        let operators = stencils.coefficients(&position);
        let deformation = Deformation::new(&stencils, &operators, &places.place, places.inside, threads)
            .map_err(|_| Unusable::Singular)?;
        let counts = [places.inside, places.place.len()];
        let means = third.as_ref().map(|_| counts.map(|count| Smoothing::new(&stencils, count)));
        let fits = Arc::new(Fits::of_one(stencils));
        let cloud = Self { ground, places, fluid, deformation, fits, third, means, wall_fits, surroundings };
        match cloud.without_pressure() {
            Some(lost) => Err(Unusable::Parts(cloud.places.place[lost])),
            None => Ok(cloud),
        }
    }

    /// A particle of a part of the fluid, of several, in which no point gives the pressure.
    fn without_pressure(&self) -> Option<usize> {
        let (places, stencils, n) = (&self.places, &self.fits.all, self.particles());
        // Of each particle one of the same part, and so on to the first.
        let mut same: Vec<usize> = (0..n).collect();
        let first = |same: &mut Vec<usize>, mut i: usize| {
            while same[i] != i {
                same[i] = same[same[i]];
                i = same[i];
            }
            i
        };
        for i in 0..n {
            for k in 0..stencils.count(i) {
                let (a, b) = (first(&mut same, i), first(&mut same, stencils.neighbour(i, k)));
                same[a.max(b)] = a.min(b);
            }
        }
        let parts: Vec<usize> = (0..n).filter(|&i| same[i] == i).collect();
        if parts.len() == 1 {
            return None;
        }
        let numbers = self.numbers();
        let out: Vec<&BoundaryPoint> = places.boundary.iter().filter(|point| self.leaves(point, &numbers)).collect();
        let with: Vec<usize> = out.into_iter().map(|point| first(&mut same, point.particle)).collect();
        parts.into_iter().find(|part| !with.contains(part))
    }

    /// Whether fluid leaves the box at a point, given the numbers of all shapes.
    pub(super) fn leaves(&self, point: &BoundaryPoint, numbers: &[Vec<f64>]) -> bool {
        let place = self.places.place[point.particle];
        matches!(self.surroundings.condition(point, place, 0.0, numbers).0, Motion::Outflow(_))
    }

    pub fn particles(&self) -> usize {
        self.places.place.len()
    }

    /// The shape that a point of the boundary, which is there, is on, or that is behind it.
    pub(super) fn shape_at(&self, point: &BoundaryPoint, place: [f64; 2]) -> Option<usize> {
        point.on.map(|(own, _)| own).or_else(|| self.surroundings.shape_behind(point, place))
    }

    /// Fits of third order for a cloud that keeps none.
    ///
    /// # Errors
    /// A particle with too few neighbours.
    pub fn third_order(&self) -> Result<Stencils, Unusable> {
        let (ground, places, count) = (&self.ground, &self.places, deferred_correction::NEIGHBOURS);
        let (all, sight) = (Nearest::new(ground.plane, ground.dx, &places.place), Sight::new(ground, places));
        let near: Vec<_> = (0..places.place.len()).map(|i| sight.nearest(&all, i, count + 1)).collect();
        stencils_of(ground, places, &near, count, true)
    }

    /// What steps in time lack, if flows are corrected.
    pub fn lagged<'a>(&'a self, shaped: &'a Shaped) -> Option<Lagged<'a>> {
        let (stencils, operators, smoothing) = (self.third.as_ref()?, shaped.third.as_ref()?, self.means.as_ref()?);
        Some(Lagged { stencils, operators, smoothing })
    }

    /// The numbers of all shapes in the reference cloud.
    pub fn numbers(&self) -> Vec<Vec<f64>> {
        self.ground.outlines.iter().map(|outline| outline.numbers.clone()).collect()
    }

    /// The equations for a shape, whose conditions they hold.
    pub fn equations(&self, shaped: &Shaped) -> Equations {
        let (nu, velocity) = (self.fluid.viscosity, self.fluid.velocity);
        Equations {
            viscosity: nu,
            diffusivity: self.fluid.diffusivity,
            force: self.fluid.force,
            buoyancy: self.fluid.buoyancy,
            damping: self.places.spacing.iter().map(|h| damping(nu, velocity, *h)).collect(),
            spacing: self.places.spacing.clone(),
            inside: self.places.inside,
            conditions: shaped.conditions.clone(),
            fits: Arc::clone(&self.fits),
        }
    }

    /// The parameters of the points of each shape, and their indices in the boundary.
    fn on_shapes(&self) -> Vec<(Vec<usize>, Vec<f64>)> {
        let mut all = vec![(vec![], vec![]); self.ground.outlines.len()];
        for (k, point) in self.places.boundary.iter().enumerate() {
            if let Some((shape, t)) = point.on {
                all[shape].0.push(k);
                all[shape].1.push(t);
            }
        }
        all
    }

    /// The parameter of a point on a shape, given those of the ends of all stretches, and its derivative by the one that it has here.
    fn slid<S: Scalar>(&self, shape: usize, t: f64, ends: &[[S; 2]]) -> (S, S) {
        let own = self.places.stretches.iter().zip(ends).filter(|(stretch, _)| stretch.shape == shape);
        let slid = |(stretch, to): (&Stretch, &[S; 2])| {
            stretch.between(t).map(|t| stretch.slid(&self.ground.outlines[shape], *to, t))
        };
        own.filter_map(slid).last().unwrap_or((S::of(t), S::of(1.0)))
    }

    /// The parameters of the ends of all stretches for numbers of the shapes.
    fn ends<S: Scalar>(&self, numbers: &[Vec<S>]) -> Vec<[S; 2]> {
        self.places.stretches.iter().map(|stretch| stretch.parameters(&self.ground.outlines, numbers)).collect()
    }

    /// How far the ends of all stretches have moved along the sides that they are on.
    fn feet<S: Scalar>(&self, ends: &[[S; 2]], numbers: &[Vec<S>]) -> Vec<[S; 2]> {
        let of = |(stretch, to): (&Stretch, &[S; 2])| {
            let outline = &self.ground.outlines[stretch.shape];
            let moved = |k: usize| {
                let End { place, footing, .. } = stretch.ends[k];
                let Footing::Side(side) = footing else { return S::of(0.0) };
                let along = 1 - side / 2;
                outline.points_at(&[to[k]], &numbers[stretch.shape])[0].place[along] - S::of(place[along])
            };
            [0, 1].map(moved)
        };
        self.places.stretches.iter().zip(ends).map(of).collect()
    }

    /// Of each shape that meets other walls the largest step of the given temperature there, as a share of the range of all given
    /// temperatures.
    pub fn temperature_steps(&self, conditions: &[Condition]) -> Vec<(usize, f64)> {
        let Places { boundary, place, stretches, .. } = &self.places;
        let given = |k: usize| match conditions[k].warmth {
            Warmth::Given(temperature) => Some(temperature),
            Warmth::Flux(_) => None,
        };
        let all = || (0..boundary.len()).filter_map(given);
        let range = all().fold(f64::MIN, f64::max) - all().fold(f64::MAX, f64::min);
        let step = |stretch: &Stretch, end: &End| {
            let nearest = |is_wanted: &dyn Fn(&BoundaryPoint) -> bool| {
                let wanted = (0..boundary.len()).filter(|&k| is_wanted(&boundary[k]));
                let distance = |k: usize| self.ground.plane.distance(place[boundary[k].particle], end.place);
                wanted.min_by(|a, b| distance(*a).total_cmp(&distance(*b))).and_then(given)
            };
            let own = nearest(&|point| point.on.is_some_and(|on| on.0 == stretch.shape))?;
            let wall = nearest(&|point| match end.footing {
                Footing::Side(side) => point.side == Some(side),
                Footing::Shape(other, _) => point.on.is_some_and(|on| on.0 == other),
                Footing::Nothing => false,
            })?;
            Some((own - wall).abs() / range)
        };
        let of = |shape: usize| {
            let own = stretches.iter().filter(|stretch| stretch.shape == shape);
            let steps = own.flat_map(|stretch| stretch.ends.iter().filter_map(|end| step(stretch, end)));
            steps.filter(|step| step.is_finite()).max_by(f64::total_cmp).map(|step| (shape, step))
        };
        (0..self.ground.outlines.len()).filter_map(of).collect()
    }

    /// The cloud for numbers of every shape.
    ///
    /// # Errors
    /// A map that folds the cloud.
    pub fn shaped(&self, numbers: &[Vec<f64>]) -> Result<Shaped, Unusable> {
        let (n, inside) = (self.particles(), self.places.inside);
        let mut moved = [vec![0.0; n - inside], vec![0.0; n - inside]];
        let mut area: Vec<[f64; 2]> =
            self.places.boundary.iter().map(|p| [p.weight * p.normal[0], p.weight * p.normal[1]]).collect();
        let mut normal: Vec<[f64; 2]> = self.places.boundary.iter().map(|p| p.normal).collect();
        let ends = self.ends(numbers);
        for (shape, (points, parameters)) in self.on_shapes().iter().enumerate() {
            let outline = &self.ground.outlines[shape];
            let (slid, rates): (Vec<f64>, Vec<f64>) = parameters.iter().map(|&t| self.slid(shape, t, &ends)).unzip();
            let (old, new) = (outline.points(parameters, &outline.numbers), outline.points(&slid, &numbers[shape]));
            for (((&k, old), new), rate) in points.iter().zip(&old).zip(&new).zip(rates) {
                let weight = rate * self.places.boundary[k].weight;
                (0..2).for_each(|d| moved[d][k] = new.place[d] - old.place[d]);
                area[k] = [weight * new.along[1], -weight * new.along[0]];
                let length = area[k][0].hypot(area[k][1]);
                normal[k] = [area[k][0] / length, area[k][1] / length];
            }
        }
        let feet = self.feet(&ends, numbers);
        for on in &self.places.on_sides {
            let OnSide { point: k, along, .. } = *on;
            let (place, rate) = on.slid(&feet);
            moved[along][k] = place - on.at;
            area[k] = area[k].map(|one| rate * one);
        }
        let position: [Vec<f64>; 2] = std::array::from_fn(|d| {
            let moved = self.deformation.displacement(&moved[d]);
            self.places.place.iter().zip(moved).map(|(p, moved)| p[d] + moved).collect()
        });
        if let Some(place) = self.fits.all.folded(&self.places.place, &position, 4) {
            return Err(Unusable::Folded(place));
        }
        let conditions = self.conditions_at(&position, normal.into_iter(), 0.0, numbers);
        let operators = self.fits.coefficients(&position);
        let centre = self.ground.outlines.iter().zip(numbers).map(|(outline, s)| outline.centre(s)).collect();
        let third = self.third.as_ref().map(|stencils| stencils.coefficients(&position));
        Ok(Shaped { numbers: numbers.to_vec(), centre, position, area, conditions, operators, third })
    }

    /// The derivative by the numbers `wanted` (shape, number), given all cotangents of positions and boundary. `time`: of conditions that
    /// depend on the place; none if their cotangents are in those of positions.
    pub fn by_numbers(
        &self,
        shaped: &Shaped,
        position_bar: &[Vec<f64>; 2],
        bar: &Bar,
        wanted: &[(usize, usize)],
        time: Option<f64>,
    ) -> Vec<f64> {
        let place_bar: [Vec<f64>; 2] = std::array::from_fn(|d| self.deformation.pull_back(&position_bar[d]));
        let on_shapes = self.on_shapes();
        let by_condition = self.conditions_back(&shaped.position, &shaped.numbers, &bar.boundary, time);
        let of = |&(shape, number): &(usize, usize)| {
            if self.is_parameter((shape, number)) {
                let of = |time: f64| {
                    self.by_parameter(&shaped.position, &shaped.numbers, &bar.boundary, (shape, number), time)
                };
                return time.map_or(0.0, of);
            }
            let outline = &self.ground.outlines[shape];
            let seeds = |k: usize| seeded(&shaped.numbers[k], Some(number).filter(|_| k == shape));
            let all: Vec<Vec<Dual>> = (0..shaped.numbers.len()).map(seeds).collect();
            let ends = self.ends(&all);
            let feet = self.feet(&ends, &all);
            let mut sum = bar.by_centre(shape, || outline.centre(&all[shape]));
            for on in &self.places.on_sides {
                let OnSide { point: k, along, .. } = *on;
                let (place, rate) = on.slid(&feet);
                let BoundaryPoint { weight, normal, .. } = self.places.boundary[k];
                sum += place.slope * (place_bar[along][k] + by_condition[k][along]);
                sum += rate.slope * weight * dot(&bar.boundary[k].area, &normal);
            }
            let follows = |other: usize| {
                other == shape || self.places.stretches.iter().any(|own| own.shape == other && own.follows(shape))
            };
            let moved = (0..all.len()).filter(|&other| follows(other)).flat_map(|other| {
                let (points, parameters) = &on_shapes[other];
                let (slid, rates): (Vec<Dual>, Vec<Dual>) =
                    parameters.iter().map(|&t| self.slid(other, t, &ends)).unzip();
                let slopes = self.ground.outlines[other].points_at(&slid, &all[other]);
                points.iter().zip(slopes).zip(rates).collect::<Vec<_>>()
            });
            for ((&k, slope), rate) in moved {
                let BoundaryBar { normal, area, .. } = bar.boundary[k];
                let weight = Dual::new(self.places.boundary[k].weight, 0.0) * rate;
                let (a, n) = (shaped.area[k], shaped.conditions[k].normal);
                let da = [(weight * slope.along[1]).slope, -(weight * slope.along[0]).slope];
                let length = a[0].hypot(a[1]);
                let along = n[0] * da[0] + n[1] * da[1];
                for d in 0..2 {
                    sum += slope.place[d].slope * (place_bar[d][k] + by_condition[k][d]);
                    sum += area[d] * da[d] + normal[d] * (da[d] - n[d] * along) / length;
                }
            }
            sum
        };
        wanted.iter().map(of).collect()
    }
}
