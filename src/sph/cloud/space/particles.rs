//! A cloud of fixed particles around shapes in space, and how it depends on their numbers.
//!
//! Points on a surface follow it; the others follow by a harmonic map, see [`super::super::deformation`].

use super::super::conditions::Conditions;
use super::super::deformation::laplace;
use super::super::equations::{damping, Warmth};
use super::super::fit::{Coefficients, COEFFICIENTS_3D as C, LEFT_3D as LEFT};
use super::super::fits::Fits;
use super::super::nearest::{Nearest, Region};
use super::super::outline::{seeded, Dual};
use super::super::particles::{Fluid, Unusable};
use super::equations::{dot, Bar, Condition, Derivatives, Equations, Motion, State};
use super::fits::{fits, Where};
use super::placing::{inward, BoundaryPoint, Ground, Places};
use super::scalar::Scalar;
use super::surface::OnSurface;
use std::fmt::Debug;
use std::sync::{Arc, OnceLock};

/// Second derivatives are fits of third order up to this distance from shapes, in dx.
const REACH: f64 = 3.0;
/// A particle is next to the boundary up to this distance, in its spacing.
const NEXT_TO: f64 = 1.25;
/// With S as large as the slope across the boundary most points have 1.4 to 2.2 of their own value in their equation, times the scale of their
/// fit. Where a shape stands on a side, the particles next to that side are farther from it than elsewhere, and some have less than LEAST:
/// S is larger there, so that they have OWN. (Beside a cylinder some had -0.5, and what points had of the others' values was, in the sum of
/// magnitudes, up to 830; the flow in time was not finite after ten steps. Now it is 6 at most, and 2.2 in the middle. S eight times as large
/// at all points does the same, but makes the errors of vortices half, and that of the heat of a cavity a quarter, as large again.)
const LEAST: f64 = 1.0;
const OWN: f64 = 4.0;

/// Velocity and temperature that points of the boundary have, by place and time.
pub trait Surroundings: Debug + Send + Sync {
    fn condition(&self, point: &BoundaryPoint, place: [f64; 3], time: f64, numbers: &[Vec<f64>]) -> (Motion, Warmth);
    /// Whether conditions depend on the place of a point that moves with a shape.
    fn varies(&self, shape: usize) -> bool;
    /// Whether conditions depend on time.
    fn has_time(&self) -> bool {
        false
    }
}

/// The reference cloud: places, stencils and map.
#[derive(Debug)]
pub struct Cloud {
    pub ground: Ground,
    pub places: Places,
    pub fluid: Fluid<3>,
    pub fits: Arc<Fits<3>>,
    pub surroundings: Arc<dyn Surroundings>,
    /// Middle of the points of each shape.
    pub centre: Vec<[f64; 3]>,
    threads: usize,
    /// Laplace's equation at the reference positions, and its transpose. Only a shape that changes needs them.
    map: OnceLock<Option<[Scalar; 2]>>,
    /// See [`Self::smoothing`].
    smoothing: OnceLock<Vec<f64>>,
}

/// The cloud of one shape.
#[derive(Debug, Clone)]
pub struct Shaped {
    pub numbers: Vec<Vec<f64>>,
    /// The x and y of every shape's centre.
    pub centre: Vec<[f64; 2]>,
    /// `[3][N]`.
    pub position: [Vec<f64>; 3],
    /// Normal into the fluid times area, of each point of the boundary on a shape; zero on sides, which have tiles.
    pub area: Vec<[f64; 3]>,
    /// Volume of the fluid.
    pub volume: f64,
    pub conditions: Vec<Condition>,
    pub operators: Coefficients<C>,
}

/// State and derivatives at one shape.
pub struct At<'a> {
    pub equations: &'a Equations,
    pub shaped: &'a Shaped,
    /// What holds on the boundary at the time of the state.
    pub conditions: &'a [Condition],
    pub state: &'a State,
    pub d: &'a Derivatives,
}

fn norm(a: [f64; 3]) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}

impl Cloud {
    /// Places particles around the shapes of `ground`.
    ///
    /// # Errors
    /// Shapes that cannot be resolved.
    pub fn new(
        ground: Ground,
        fluid: Fluid<3>,
        surroundings: Arc<dyn Surroundings>,
        threads: usize,
    ) -> Result<Self, Unusable<3>> {
        let places = ground.fill().map_err(Unusable::Placing)?;
        let kinds: Vec<Where> = (0..places.place.len()).map(|i| kind(&ground, &places, i)).collect();
        let near = neighbours(&ground, &places, &kinds, threads);
        let fits = fits(ground.region, &places.place, &kinds, |i| near.of(i));
        let fits = Arc::new(fits.map_err(|i| Unusable::Lonely(places.place[i]))?);
        drop(near);
        let centre = (0..ground.surfaces.len())
            .map(|shape| {
                let surface = &ground.surfaces[shape];
                let own = places.boundary.iter().filter_map(|point| point.on.filter(|on| on.0 == shape));
                let all: Vec<[f64; 3]> = own.map(|(_, spot)| surface.at(&spot, &surface.numbers).place).collect();
                std::array::from_fn(|d| all.iter().map(|p| p[d]).sum::<f64>() / all.len().max(1) as f64)
            })
            .collect();
        Ok(Self {
            ground,
            places,
            fluid,
            fits,
            surroundings,
            centre,
            threads,
            map: OnceLock::new(),
            smoothing: OnceLock::new(),
        })
    }

    /// The equations of the map, and their transpose.
    fn map(&self) -> Result<&[Scalar; 2], Unusable<3>> {
        let make = || {
            let operators = self.fits.coefficients(&self.reference());
            let laplace = laplace(&self.fits.all, &operators, self.places.inside);
            let mut transposed = laplace.clone();
            transposed.transpose();
            Some([Scalar::new(laplace, self.threads).ok()?, Scalar::new(transposed, self.threads).ok()?])
        };
        self.map.get_or_init(make).as_ref().ok_or(Unusable::Singular)
    }

    /// Reference positions, `[3][N]`.
    fn reference(&self) -> [Vec<f64>; 3] {
        std::array::from_fn(|d| self.places.place.iter().map(|p| p[d]).collect())
    }

    pub fn particles(&self) -> usize {
        self.places.place.len()
    }

    /// The numbers of all shapes in the reference cloud.
    pub fn numbers(&self) -> Vec<Vec<f64>> {
        self.ground.surfaces.iter().map(|surface| surface.numbers.clone()).collect()
    }

    /// A sum over the coefficients of a particle's pairs.
    fn sum(&self, operators: &Coefficients<C>, i: usize, of: impl Fn(&[f64; C]) -> f64) -> f64 {
        (0..self.fits.all.count(i)).map(|pair| of(&operators.of(i, pair))).sum()
    }

    /// Weight of S beside the slope across the boundary at each of its points, in scales of the fit.
    pub fn smoothing(&self, shaped: &Shaped) -> &[f64] {
        let of = |operators: &Coefficients<C>| {
            let of = |(k, point): (usize, &BoundaryPoint)| {
                let i = self.places.inside + k;
                let normal = if point.on.is_some() { point.normal } else { shaped.conditions[k].normal };
                let scale = self.fits.all.scale(i);
                let slope = scale * self.sum(operators, i, |c| dot(normal, c));
                let seen = scale * scale * self.sum(operators, i, |c| c[LEFT]);
                if slope + seen >= LEAST {
                    1.0
                } else {
                    (OWN - slope) / seen
                }
            };
            self.places.boundary.iter().enumerate().map(of).collect()
        };
        // Those of the reference cloud, so that they do not change with the shape.
        self.smoothing.get_or_init(|| {
            let reference = self.reference();
            match shaped.position == reference {
                true => of(&shaped.operators),
                false => of(&self.fits.coefficients(&reference)),
            }
        })
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
            exchange: vec![],
            conditions: shaped.conditions.clone(),
            ends: vec![],
            smoothing: self.smoothing(shaped).to_vec(),
            fits: Arc::clone(&self.fits),
        }
    }

    /// The points on shapes: place in the boundary, shape, and what is there for its numbers.
    fn on_shapes<'a>(&'a self, numbers: &'a [Vec<f64>]) -> impl Iterator<Item = (usize, usize, OnSurface<f64>)> + 'a {
        self.places.boundary.iter().enumerate().filter_map(|(k, point)| {
            let (shape, spot) = point.on?;
            Some((k, shape, self.ground.surfaces[shape].at(&spot, &numbers[shape])))
        })
    }

    /// The cloud for numbers of every shape.
    ///
    /// # Errors
    /// A map that folds the cloud.
    pub fn shaped(&self, numbers: &[Vec<f64>]) -> Result<Shaped, Unusable<3>> {
        let (n, inside) = (self.particles(), self.places.inside);
        let stands_elsewhere =
            |shape: &usize| self.ground.surfaces[*shape].stands_elsewhere(&self.ground.region, &numbers[*shape]);
        if let Some(shape) = (0..numbers.len()).find(stands_elsewhere) {
            return Err(Unusable::Folded(self.centre[shape]));
        }
        let mut area = vec![[0.0; 3]; n - inside];
        let mut normal: Vec<[f64; 3]> = self.places.boundary.iter().map(|point| point.normal).collect();
        let mut volume: f64 = self.ground.region.size.iter().product();
        let mut moved: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; n]);
        let reference = self.numbers();
        for ((k, shape, new), (.., old)) in self.on_shapes(numbers).zip(self.on_shapes(&reference)) {
            (0..3).for_each(|d| moved[d][inside + k] = new.place[d] - old.place[d]);
            area[k] = new.area;
            normal[k] = new.area.map(|x| x / norm(new.area));
            volume -= self.ground.surfaces[shape].volume(&new, self.centre[shape]);
        }
        let mut position = self.reference();
        for d in 0..3 {
            if moved[d].iter().any(|&x| x != 0.0) {
                let moved = self.map()?[0].solve(&moved[d]).ok_or(Unusable::Singular)?;
                position[d].iter_mut().zip(moved).for_each(|(x, moved)| *x += moved);
            }
        }
        if let Some(place) = self.fits.all.folded(&self.places.place, &position, 6) {
            return Err(Unusable::Folded(place));
        }
        let mut conditions = self.conditions_at(&position, normal.into_iter(), 0.0, numbers);
        // On an edge of the box the normal is that of the side whose condition holds, across which there is no slope.
        for (condition, point) in conditions.iter_mut().zip(&self.places.boundary) {
            if let Motion::Symmetry(along) | Motion::Outflow(along) = condition.motion {
                if let Some(&side) = point.sides.iter().find(|&side| side / 2 == along) {
                    condition.normal = inward(side);
                }
            }
        }
        let operators = self.fits.coefficients(&position);
        let centre = self.ground.surfaces.iter().zip(numbers).map(|(surface, s)| surface.centre(s)).collect();
        Ok(Shaped { numbers: numbers.to_vec(), centre, position, area, volume, conditions, operators })
    }

    /// The volume of a shape, with its derivative by one of its numbers.
    pub fn volume_of(&self, shape: usize, numbers: &[f64], by: Option<usize>) -> Dual {
        let surface = &self.ground.surfaces[shape];
        let numbers = seeded(numbers, by);
        let own = self.places.boundary.iter().filter_map(|point| point.on.filter(|on| on.0 == shape));
        let of =
            |(_, spot): (usize, super::surface::Spot)| surface.volume(&surface.at(&spot, &numbers), self.centre[shape]);
        own.map(of).fold(Dual::new(0.0, 0.0), |sum, x| sum + x)
    }

    /// The derivative by the numbers `wanted` (shape, number), given all cotangents of positions and boundary. `time`: of conditions that
    /// depend on the place; none if their cotangents are in those of positions.
    ///
    /// # Errors
    /// A map whose transposed equations are not solved.
    pub fn by_numbers(
        &self,
        shaped: &Shaped,
        position_bar: &[Vec<f64>; 3],
        bar: &Bar,
        wanted: &[(usize, usize)],
        time: Option<f64>,
    ) -> Result<Vec<f64>, Unusable<3>> {
        let inside = self.places.inside;
        let mut place_bar = self.conditions_back(&shaped.position, &shaped.numbers, &bar.boundary, time);
        for d in 0..3 {
            let of_boundary = self.map()?[1].solve(&position_bar[d]).ok_or(Unusable::Singular)?;
            place_bar.iter_mut().zip(&of_boundary[inside..]).for_each(|(to, x)| to[d] += *x);
        }
        let of = |&(shape, number): &(usize, usize)| {
            if self.is_parameter((shape, number)) {
                let of = |time: f64| {
                    self.by_parameter(&shaped.position, &shaped.numbers, &bar.boundary, (shape, number), time)
                };
                return time.map_or(0.0, of);
            }
            let surface = &self.ground.surfaces[shape];
            let numbers = seeded(&shaped.numbers[shape], Some(number));
            let mut sum = bar.by_centre(shape, || surface.centre(&numbers));
            for (k, point) in self.places.boundary.iter().enumerate() {
                let Some((_, spot)) = point.on.filter(|on| on.0 == shape) else { continue };
                let on = surface.at(&spot, &numbers);
                sum -= bar.volume * surface.volume(&on, self.centre[shape]).slope;
                let (area, n) = (shaped.area[k], shaped.conditions[k].normal);
                let along: f64 = (0..3).map(|d| n[d] * on.area[d].slope).sum();
                for d in 0..3 {
                    sum += on.place[d].slope * place_bar[k][d] + on.area[d].slope * bar.boundary[k].area[d];
                    sum += bar.boundary[k].normal[d] * (on.area[d].slope - n[d] * along) / norm(area);
                }
            }
            sum
        };
        Ok(wanted.iter().map(of).collect())
    }
}

impl Conditions<3> for Cloud {
    fn inside(&self) -> usize {
        self.places.inside
    }

    fn points(&self) -> usize {
        self.places.boundary.len()
    }

    fn dx(&self) -> f64 {
        self.ground.dx
    }

    fn condition(&self, point: usize, place: [f64; 3], time: f64, numbers: &[Vec<f64>]) -> (Motion, Warmth) {
        self.surroundings.condition(&self.places.boundary[point], place, time, numbers)
    }

    fn varies(&self, point: usize) -> bool {
        self.places.boundary[point].on.is_some_and(|(shape, _)| self.surroundings.varies(shape))
    }

    fn has_time(&self) -> bool {
        self.surroundings.has_time()
    }

    fn depends(&self, point: usize, _: [f64; 3], shape: usize) -> bool {
        self.places.boundary[point].on.as_ref().is_some_and(|(own, _)| *own == shape)
    }

    fn is_parameter(&self, (shape, number): (usize, usize)) -> bool {
        number >= self.ground.surfaces[shape].geometry
    }
}

/// Where a particle is.
fn kind(ground: &Ground, places: &Places, i: usize) -> Where {
    if i >= places.inside {
        return Where::Boundary;
    }
    let (p, Region { size, periodic }) = (places.place[i], ground.region);
    let from_side = |d: usize| if periodic[d] { f64::INFINITY } else { p[d].min(size[d] - p[d]) };
    let from_sides = (0..3).map(from_side).fold(f64::INFINITY, f64::min);
    let from_shapes = ground.distance(p, None);
    let is_next_to = from_shapes.min(from_sides) < NEXT_TO * places.spacing[i];
    if is_next_to || from_shapes > REACH * ground.dx {
        Where::Far
    } else {
        Where::NearShape
    }
}

/// The particles near each, with their distances, nearest first: in one piece, which goes back to the system when the fits are made.
struct Near {
    first: Vec<usize>,
    counts: Vec<usize>,
    table: Vec<(f64, u32)>,
}

impl Near {
    fn of(&self, i: usize) -> &[(f64, u32)] {
        &self.table[self.first[i]..self.first[i] + self.counts[i]]
    }
}

/// The particles next to each, nearest first, that no shape hides.
fn neighbours(ground: &Ground, places: &Places, kinds: &[Where], threads: usize) -> Near {
    let all = Nearest::new(ground.region, ground.dx, &places.place);
    let distance: Vec<f64> = places.place.iter().map(|p| ground.distance(*p, None)).collect();
    let sees = |i: usize, j: usize, length: f64| {
        if distance[i] + distance[j] > length {
            return true;
        }
        let (a, r) = (places.place[i], ground.region.between(places.place[i], places.place[j]));
        let finest = places.spacing[i].min(places.spacing[j]);
        [0.25, 0.5, 0.75].iter().all(|part| {
            let p = ground.region.wrapped(std::array::from_fn(|d| a[d] + part * r[d]));
            ground.distance(p, None) > -0.6 * finest
        })
    };
    let of = |i: usize| all.of(places.place[i], kinds[i].needs(), |j, length| j != i && sees(i, j, length));
    let n = places.place.len();
    let mut first = vec![0];
    kinds.iter().for_each(|kind| first.push(first[first.len() - 1] + kind.needs()));
    let mut table = vec![(0.0, 0); first[n]];
    let share = n.div_ceil(threads.max(1)).max(1);
    let mut rest = &mut table[..];
    let mut counts = vec![0; n];
    std::thread::scope(|scope| {
        for (part, counts) in counts.chunks_mut(share).enumerate() {
            let from = part * share;
            let (own, others) = std::mem::take(&mut rest).split_at_mut(first[from + counts.len()] - first[from]);
            rest = others;
            let (of, first) = (&of, &first);
            scope.spawn(move || {
                for (k, count) in counts.iter_mut().enumerate() {
                    let found = of(from + k);
                    *count = found.len();
                    own[first[from + k] - first[from]..][..found.len()].copy_from_slice(&found);
                }
            });
        }
    });
    Near { first, counts, table }
}
