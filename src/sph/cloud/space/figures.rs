//! Figures of a steady flow in space: flow rate, and force and heat of shapes.
//!
//! As in the plane ([`super::super::figures`]): sums of traction and heat flux over a shape's points are its *surface* figures. By *balance* they
//! are told on a closed surface around the shape ([`super::control_surface`]), which is reported and differentiated. Where nothing flows in or
//! out and shapes have most of the boundary, the driving force leaves no doubt of the sum over all shapes, and what the surfaces differ from it by is shared among the shapes
//! by their areas. Where passages are too narrow for any such surface, sums over the points of shapes and over those of the rest of the boundary
//! are balanced so.

use super::super::equations::Warmth;
use super::super::figures::{each_once, Figure, MeasureSettings};
use super::super::fit::{Coefficients, COEFFICIENTS_3D as C};
use super::super::nearest::Nearest;
use super::super::particles::Balanced;
use super::super::traction::{unit, Patch};
use super::control_surface::{around_all, ControlSurface};
use super::equations::{Bar, Condition, Derivatives, Equations, Motion, State, PRESSURE, TEMPERATURE};
use super::particles::{At, Cloud, Shaped};
use super::steady::FlowRate;
use crate::io::stl::dot;
use crate::numerics::sparse_lu::dot as product;
use crate::sph::consistent::stencil::{monomials, quadratic};

/// A place of a cross-section: nearest particle, position and weight.
#[derive(Debug, Clone, Copy)]
struct Sample {
    particle: usize,
    place: [f64; 3],
    weight: f64,
}

/// What figures need beside the state.
#[derive(Debug)]
pub struct Measures {
    /// Where the flow rate is told, as far from bodies as possible.
    section: Vec<Sample>,
    /// Where the heat outflow is told.
    target: Vec<Sample>,
    probes: Vec<Sample>,
    /// Indices of boundary points by shape.
    points: Vec<Vec<usize>>,
    /// Parts of the sides of the box: boundary point, and normal into the fluid times area.
    rest: Vec<(usize, [f64; 3])>,
    /// The closed surface around each shape that has room for it.
    around: Vec<Option<ControlSurface>>,
    /// Whether sides of the region have less than SIDES times the area of the shapes.
    sides_are_small: bool,
    read_at: Vec<usize>,
    /// Share of each shape in what all of them differ from the sum by; 0 where that is not known.
    share: Vec<f64>,
    inside: usize,
    size: [f64; 3],
    periodic_x: bool,
}

const Q: usize = monomials(3);
/// See [`Measures::balances`].
const SIDES: f64 = 6.0;

impl Measures {
    pub fn new(cloud: &Cloud, settings: MeasureSettings<'_, 3>) -> Self {
        let (region, places) = (cloud.ground.region, &cloud.places);
        let shapes = cloud.ground.surfaces.len();
        let mut points = vec![vec![]; shapes];
        for (k, point) in places.boundary.iter().enumerate() {
            if let Some((shape, _)) = point.on {
                points[shape].push(k);
            }
        }
        let tile = |tile: &super::placing::Tile| {
            let mut area = [0.0; 3];
            area[tile.side / 2] = if tile.side.is_multiple_of(2) { tile.area } else { -tile.area };
            (tile.point, area)
        };
        let rest = places.tiles.iter().map(tile).collect();
        let numbers = cloud.numbers();
        let area = |shape: usize| -> f64 {
            let surface = &cloud.ground.surfaces[shape];
            let of = |k: &usize| {
                let on = places.boundary[*k].on.map(|(_, spot)| surface.at(&spot, &numbers[shape]).area);
                on.map_or(0.0, |area| dot(area, area).sqrt())
            };
            points[shape].iter().map(of).sum()
        };
        let areas: Vec<f64> = (0..shapes).map(area).collect();
        let total: f64 = areas.iter().sum();
        let share =
            areas.iter().map(|area| if settings.balanced == Balanced::Steady { area / total } else { 0.0 }).collect();
        let sides: f64 = places.tiles.iter().map(|tile| tile.area).sum();
        let sides_are_small = sides < SIDES * total;
        let near = Nearest::new(region, cloud.ground.dx, &places.place);
        let sample = |p: [f64; 3], weight: f64| {
            let (_, particle) = near.one(p, 3.0 * cloud.ground.dx)?;
            let own = places.place[particle];
            let r = region.between(own, p);
            Some(Sample { particle, place: std::array::from_fn(|d| own[d] + r[d]), weight })
        };
        let cells = cloud.ground.cells();
        let step: [f64; 3] = std::array::from_fn(|d| region.size[d] / cells[d] as f64);
        let distance = |x: f64| {
            // Columns across the stream are met at several heights.
            let of = |k: usize| {
                let p = |a: usize, b: usize| {
                    [x, region.size[1] * (a as f64 + 0.5) / 8.0, region.size[2] * (b as f64 + 0.5) / 8.0]
                };
                cloud.ground.distance(p(k / 8, k % 8), None)
            };
            let ends = if region.periodic[0] { f64::INFINITY } else { x.min(region.size[0] - x) };
            (0..64).map(of).fold(ends, f64::min)
        };
        let columns = (0..cells[0]).map(|k| k as f64 * step[0]);
        let (farthest, _) =
            columns
                .map(|x| (x, distance(x)))
                .fold((0.0, f64::MIN), |best, one| if one.1 > best.1 + 1e-9 { one } else { best });
        // Gauss's two points along each edge of a cell.
        let gauss = |k: usize, d: usize| step[d] * ((k / 2) as f64 + 0.5 + (k as f64 % 2.0 - 0.5) / 3f64.sqrt());
        let section = |x: f64| -> Vec<Sample> {
            let points =
                (0..4 * cells[1] * cells[2]).map(|k| [x, gauss(k / (2 * cells[2]), 1), gauss(k % (2 * cells[2]), 2)]);
            let fluid = points.filter(|p| cloud.ground.distance(*p, None) > 0.0);
            fluid.filter_map(|p| sample(p, 0.25 * step[1] * step[2])).collect()
        };
        let (section, target) = (section(farthest), section(settings.target.min(region.size[0])));
        let probes: Vec<Sample> = settings
            .probes
            .iter()
            .map(|p| sample(*p, 1.0).unwrap_or(Sample { particle: 0, place: *p, weight: 1.0 }))
            .collect();
        let (inside, size, periodic_x) = (places.inside, region.size, region.periodic[0]);
        let around = around_all(cloud, &points, settings.balanced);
        let samples = section.iter().chain(&target).chain(&probes).map(|sample| sample.particle);
        let read_at = each_once(samples.chain(around.iter().flatten().flat_map(ControlSurface::particles)));
        Self {
            section,
            target,
            probes,
            points,
            rest,
            around,
            read_at,
            sides_are_small,
            share,
            inside,
            size,
            periodic_x,
        }
    }

    /// Particles at which figures need derivatives, beside those of the boundary.
    pub fn read_at(&self) -> &[usize] {
        &self.read_at
    }

    /// The Taylor polynomial's monomials from a sample's particle to its place.
    fn monomials(sample: &Sample, position: &[Vec<f64>; 3]) -> ([f64; 3], [f64; Q]) {
        let s: [f64; 3] = std::array::from_fn(|d| sample.place[d] - position[d][sample.particle]);
        let mut q = [0.0; Q];
        for a in 0..3 {
            q[a] = s[a];
            (a..3).for_each(|b| q[quadratic(3, a, b)] = if a == b { 0.5 * s[a] * s[a] } else { s[a] * s[b] });
        }
        (s, q)
    }

    fn sampled(sample: &Sample, at: &At<'_>, field: usize) -> f64 {
        let (_, q) = Self::monomials(sample, &at.shaped.position);
        at.state.fields[field][sample.particle] + product(&q, &at.d.0[field][sample.particle][..Q])
    }

    /// The places, with their shares, whose mean is the zero of a field, as in the plane.
    fn level(&self, field: usize, at: &At<'_>) -> impl Iterator<Item = (&Sample, f64)> {
        let is_free = field == PRESSURE && !at.equations.gives_pressure();
        let places: &[Sample] = if is_free { &self.section } else { &[] };
        let total: f64 = places.iter().map(|sample| sample.weight).sum();
        places.iter().map(move |sample| (sample, sample.weight / total))
    }

    fn sampled_back(sample: &Sample, at: &At<'_>, field: usize, weight: f64, bar: &mut Bar) {
        let i = sample.particle;
        let (s, q) = Self::monomials(sample, &at.shaped.position);
        bar.fields[field][i] += weight;
        (0..Q).for_each(|a| bar.derivatives.0[field][i][a] += weight * q[a]);
        let d = &at.d.0[field][i];
        for a in 0..3 {
            let by_place = d[a] + (0..3).map(|b| d[quadratic(3, a.min(b), a.max(b))] * s[b]).sum::<f64>();
            bar.position[a][i] -= weight * by_place;
        }
    }

    /// What pushes through an area at a point of the boundary.
    fn patch(&self, at: &At<'_>, k: usize, area: [f64; 3]) -> Patch<3> {
        let i = self.inside + k;
        let gradient = std::array::from_fn(|e| std::array::from_fn(|b| at.d.0[e][i][b]));
        Patch { velocity: at.state.velocity(i), gradient, pressure: at.state.fields[PRESSURE][i], area }
    }

    /// The traction times area at a point of the boundary, less the momentum that the fluid carries in, along e.
    fn push(&self, at: &At<'_>, k: usize, a: [f64; 3], e: usize) -> f64 {
        self.patch(at, k, a).push(at.equations.viscosity, e)
    }

    /// Adds the cotangents of [`Self::push`], given those of its components; those of the area, which only shapes change, are returned.
    fn push_back(&self, at: &At<'_>, k: usize, a: [f64; 3], weight: [f64; 3], bar: &mut Bar) -> [f64; 3] {
        let (back, viscosity) = self.patch(at, k, a).push_back(at.equations.viscosity, weight);
        let i = self.inside + k;
        for e in 0..3 {
            bar.fields[e][i] += back.velocity[e];
            (0..3).for_each(|b| bar.derivatives.0[e][i][b] += back.gradient[e][b]);
        }
        bar.fields[PRESSURE][i] += back.pressure;
        bar.viscosity += viscosity;
        back.area
    }

    /// The heat that enters at a point of the boundary, by conduction (the given flux, where one is given) and with the fluid.
    fn warmth(&self, at: &At<'_>, k: usize, a: [f64; 3]) -> f64 {
        let (i, alpha) = (self.inside + k, at.equations.diffusivity.unwrap_or(0.0));
        let carried = at.state.fields[TEMPERATURE][i] * dot(at.state.velocity(i), a);
        if let Warmth::Flux(flux) = at.conditions[k].warmth {
            return carried + flux * dot(a, a).sqrt();
        }
        let slope: [f64; 3] = std::array::from_fn(|b| at.d.0[TEMPERATURE][i][b]);
        carried - alpha * dot(slope, a)
    }

    fn warmth_back(&self, at: &At<'_>, k: usize, a: [f64; 3], weight: f64, bar: &mut Bar) -> [f64; 3] {
        let (i, alpha) = (self.inside + k, at.equations.diffusivity.unwrap_or(0.0));
        let (u, t) = (at.state.velocity(i), at.state.fields[TEMPERATURE][i]);
        bar.fields[TEMPERATURE][i] += weight * dot(u, a);
        let mut area = [0.0; 3];
        (0..3).for_each(|b| bar.fields[b][i] += weight * t * a[b]);
        if let Warmth::Flux(flux) = at.conditions[k].warmth {
            let size = dot(a, a).sqrt();
            bar.boundary[k].temperature += weight * size;
            return std::array::from_fn(|b| weight * (t * u[b] + flux * a[b] / size));
        }
        for b in 0..3 {
            bar.derivatives.0[TEMPERATURE][i][b] -= weight * alpha * a[b];
            area[b] = weight * (t * u[b] - alpha * at.d.0[TEMPERATURE][i][b]);
        }
        area
    }

    /// Where a point of a shape is from the line along z through the shape's centre.
    fn arm(&self, at: &At<'_>, shape: usize, k: usize) -> [f64; 2] {
        std::array::from_fn(|d| at.shaped.position[d][self.inside + k] - at.shaped.centre[shape][d])
    }

    /// The torque at a point of a shape around that line.
    fn turn(&self, at: &At<'_>, shape: usize, k: usize) -> f64 {
        let ([x, y], area) = (self.arm(at, shape, k), at.shaped.area[k]);
        x * self.push(at, k, area, 1) - y * self.push(at, k, area, 0)
    }

    /// A shape's force along e by its surface alone.
    pub fn surface_force(&self, at: &At<'_>, shape: usize, e: usize) -> f64 {
        self.points[shape].iter().map(|&k| self.push(at, k, at.shaped.area[k], e)).sum()
    }

    /// A shape's heat by its surface alone.
    pub fn surface_heat(&self, at: &At<'_>, shape: usize) -> f64 {
        self.points[shape].iter().map(|&k| self.warmth(at, k, at.shaped.area[k])).sum()
    }

    /// A shape's force along e, by the closed surface around it if there is one.
    fn own_force(&self, at: &At<'_>, shape: usize, e: usize) -> f64 {
        match &self.around[shape] {
            Some(around) => {
                let feet = around.feet.iter().map(|foot| self.push(at, foot.point, foot.area(at), e));
                around.force(at, e) - feet.sum::<f64>()
            }
            None => self.surface_force(at, shape, e),
        }
    }

    fn own_force_back(&self, at: &At<'_>, shape: usize, e: usize, weight: f64, bar: &mut Bar) {
        match &self.around[shape] {
            Some(around) => {
                around.force_back(at, e, weight, bar);
                for foot in &around.feet {
                    let area = self.push_back(at, foot.point, foot.area(at), unit(e, -weight), bar);
                    foot.area_back(area, bar);
                }
            }
            None => {
                for &k in &self.points[shape] {
                    let area = self.push_back(at, k, at.shaped.area[k], unit(e, weight), bar);
                    (0..3).for_each(|d| bar.boundary[k].area[d] += area[d]);
                }
            }
        }
    }

    /// A shape's heat, by the closed surface around it if there is one.
    fn own_heat(&self, at: &At<'_>, shape: usize) -> f64 {
        match &self.around[shape] {
            Some(around) => {
                let feet = around.feet.iter().map(|foot| self.warmth(at, foot.point, foot.area(at)));
                around.heat(at) - feet.sum::<f64>()
            }
            None => self.surface_heat(at, shape),
        }
    }

    fn own_heat_back(&self, at: &At<'_>, shape: usize, weight: f64, bar: &mut Bar) {
        match &self.around[shape] {
            Some(around) => {
                around.heat_back(at, weight, bar);
                for foot in &around.feet {
                    let area = self.warmth_back(at, foot.point, foot.area(at), -weight, bar);
                    foot.area_back(area, bar);
                }
            }
            None => {
                for &k in &self.points[shape] {
                    let area = self.warmth_back(at, k, at.shaped.area[k], weight, bar);
                    (0..3).for_each(|d| bar.boundary[k].area[d] += area[d]);
                }
            }
        }
    }

    /// Whether a closed surface around a shape tells its figures.
    pub fn is_told_around(&self, shape: usize) -> bool {
        self.around[shape].is_some()
    }

    /// The sum of the forces on all shapes along e, by balance.
    pub fn balanced_force(&self, at: &At<'_>, e: usize) -> f64 {
        let rest: f64 = self.rest.iter().map(|&(k, area)| self.push(at, k, area, e)).sum();
        at.equations.push(at.state, e) * at.shaped.volume - rest
    }

    /// The sum of the heat of all shapes, by balance.
    pub fn balanced_heat(&self, at: &At<'_>) -> f64 {
        -self.rest.iter().map(|&(k, area)| self.warmth(at, k, area)).sum::<f64>()
    }

    /// Whether the sums over all shapes are known better than by the surfaces around them, of a steady flow: none of them has one, or nothing flows
    /// in or out and sides of the region, whose sums are some per cent off, are not much larger than the shapes. (In a duct of 20 times the
    /// area of a ball of 3 spacings the drag by the balance is 40 % off, in a channel of 4 times that of a cylinder of 5 spacings 0.5 %.)
    fn balances(&self, at: &At<'_>, shape: usize) -> bool {
        let is_closed = || self.rest.iter().all(|&(k, area)| Self::end_of(at, k, area).is_none());
        self.share[shape] != 0.0 && (self.around.iter().all(Option::is_none) || (self.sides_are_small && is_closed()))
    }

    /// Whether balance tells the force of shapes: without buoyancy, whose sum over the fluid is not known.
    fn balances_force(&self, at: &At<'_>, shape: usize) -> bool {
        at.equations.buoyancy.is_none() && self.balances(at, shape)
    }

    /// Whether balance tells the heat of shapes: the sides let heat through.
    fn balances_heat(&self, at: &At<'_>, shape: usize) -> bool {
        self.balances(at, shape)
            && self.rest.iter().any(|&(k, _)| {
                let Condition { motion, warmth, .. } = at.conditions[k];
                matches!(motion, Motion::Outflow(_)) || !matches!(warmth, Warmth::Flux(0.0))
            })
    }

    /// What tells the force of a shape and its heat: `balance`, a closed `surface` around it, or the sum over its own `points`.
    pub fn told_by(&self, at: &At<'_>, shape: usize) -> [&'static str; 2] {
        let own = if self.is_told_around(shape) { "surface" } else { "points" };
        [self.balances_force(at, shape), self.balances_heat(at, shape)]
            .map(|balances| if balances { "balance" } else { own })
    }

    /// The volume of the region in the direction of the stream: area of a cross-section times length over length.
    fn length(&self) -> f64 {
        self.size[0]
    }

    /// 0 for a point where fluid enters, 1 where it leaves; none on walls.
    fn end_of(at: &At<'_>, k: usize, a: [f64; 3]) -> Option<usize> {
        match at.conditions[k].motion {
            Motion::Outflow(_) => Some(1),
            Motion::Given(u) => {
                let through = dot(u, a);
                (through.abs() > 1e-12 * dot(a, a).sqrt()).then_some(if through > 0.0 { 0 } else { 1 })
            }
            Motion::Symmetry(_) => None,
        }
    }

    /// Mean pressures where fluid enters and leaves, as points with weights.
    fn ends(&self, at: &At<'_>) -> Vec<(usize, f64)> {
        let found: Vec<(usize, usize, f64)> =
            self.rest.iter().filter_map(|&(k, a)| Some((k, Self::end_of(at, k, a)?, dot(a, a).sqrt()))).collect();
        let total = |end: usize| found.iter().filter(|one| one.1 == end).map(|one| one.2).sum::<f64>();
        let totals = [total(0), total(1)];
        found.iter().map(|&(k, end, area)| (k, [1.0, -1.0][end] * area / totals[end])).collect()
    }

    pub fn value(&self, figure: Figure, at: &At<'_>) -> f64 {
        let shapes = 0..self.share.len();
        match figure {
            Figure::FlowRate => self.section.iter().map(|s| s.weight * Self::sampled(s, at, 0)).sum(),
            Figure::HeatOutflow => {
                self.target.iter().map(|s| s.weight * Self::sampled(s, at, 0) * Self::sampled(s, at, TEMPERATURE)).sum()
            }
            Figure::Force { shape, along } if !self.balances_force(at, shape) => self.own_force(at, shape, along),
            Figure::Force { shape, along } => {
                let all: f64 = shapes.map(|body| self.own_force(at, body, along)).sum();
                self.own_force(at, shape, along) + self.share[shape] * (self.balanced_force(at, along) - all)
            }
            Figure::Heat { shape } => {
                let own = self.own_heat(at, shape);
                if !self.balances_heat(at, shape) {
                    return own;
                }
                let all: f64 = shapes.map(|body| self.own_heat(at, body)).sum();
                own + self.share[shape] * (self.balanced_heat(at) - all)
            }
            Figure::Probe { field, probe } => {
                let level = self.level(field, at).map(|(sample, share)| share * Self::sampled(sample, at, field));
                Self::sampled(&self.probes[probe], at, field) - level.sum::<f64>()
            }
            Figure::PressureDrop if self.periodic_x => at.equations.push(at.state, 0) * self.length(),
            Figure::PressureDrop => {
                self.ends(at).iter().map(|(k, weight)| weight * at.state.fields[PRESSURE][self.inside + k]).sum()
            }
            Figure::Torque { shape } => self.points[shape].iter().map(|&k| self.turn(at, shape, k)).sum(),
            // There is none in space, see `config`.
            Figure::Dissipation => f64::NAN,
        }
    }

    /// Adds the cotangents of a figure times `weight`.
    pub fn pull_back(&self, figure: Figure, at: &At<'_>, weight: f64, bar: &mut Bar) {
        let shapes = 0..self.share.len();
        match figure {
            Figure::FlowRate => {
                self.section.iter().for_each(|s| Self::sampled_back(s, at, 0, weight * s.weight, bar));
            }
            Figure::HeatOutflow => {
                for s in &self.target {
                    let (u, t) = (Self::sampled(s, at, 0), Self::sampled(s, at, TEMPERATURE));
                    Self::sampled_back(s, at, 0, weight * s.weight * t, bar);
                    Self::sampled_back(s, at, TEMPERATURE, weight * s.weight * u, bar);
                }
            }
            Figure::Force { shape, along } => {
                self.own_force_back(at, shape, along, weight, bar);
                if !self.balances_force(at, shape) {
                    return;
                }
                let share = weight * self.share[shape];
                shapes.for_each(|body| self.own_force_back(at, body, along, -share, bar));
                for &(k, area) in &self.rest {
                    self.push_back(at, k, area, unit(along, -share), bar);
                }
                bar.volume += share * at.equations.push(at.state, along);
                if along == 0 {
                    bar.drive += share * at.shaped.volume;
                }
            }
            Figure::Heat { shape } => {
                self.own_heat_back(at, shape, weight, bar);
                if !self.balances_heat(at, shape) {
                    return;
                }
                let share = weight * self.share[shape];
                shapes.for_each(|body| self.own_heat_back(at, body, -share, bar));
                for &(k, area) in &self.rest {
                    self.warmth_back(at, k, area, -share, bar);
                }
            }
            Figure::Probe { field, probe } => {
                Self::sampled_back(&self.probes[probe], at, field, weight, bar);
                for (sample, share) in self.level(field, at) {
                    Self::sampled_back(sample, at, field, -weight * share, bar);
                }
            }
            Figure::PressureDrop if self.periodic_x => bar.drive += weight * self.length(),
            Figure::PressureDrop => {
                for (k, share) in self.ends(at) {
                    bar.fields[PRESSURE][self.inside + k] += weight * share;
                }
            }
            Figure::Torque { shape } => {
                for &k in &self.points[shape] {
                    let [x, y] = self.arm(at, shape, k);
                    let (i, area) = (self.inside + k, at.shaped.area[k]);
                    let push = [self.push(at, k, area, 0), self.push(at, k, area, 1)];
                    let by_area = self.push_back(at, k, area, [-weight * y, weight * x, 0.0], bar);
                    (0..3).for_each(|d| bar.boundary[k].area[d] += by_area[d]);
                    bar.position[0][i] += weight * push[1];
                    bar.position[1][i] -= weight * push[0];
                    bar.add_centre(shape, [-weight * push[1], weight * push[0]]);
                }
            }
            Figure::Dissipation => bar.drive = f64::NAN,
        }
    }
}

/// The flow rate for a drive that holds it.
pub struct Rate<'a> {
    pub measures: &'a Measures,
    pub shaped: &'a Shaped,
}

impl Rate<'_> {
    fn at<'a>(&'a self, equations: &'a Equations, state: &'a State, d: &'a Derivatives) -> At<'a> {
        At { equations, shaped: self.shaped, conditions: &self.shaped.conditions, state, d }
    }
}

impl FlowRate for Rate<'_> {
    fn value(&self, equations: &Equations, state: &State, d: &Derivatives) -> f64 {
        self.measures.value(Figure::FlowRate, &self.at(equations, state, d))
    }

    fn by_state(&self, equations: &Equations, operators: &Coefficients<C>) -> Vec<f64> {
        let n = equations.particles();
        let mut bar = Bar::new(n, self.shaped.area.len());
        let (state, d) = (State::at_rest(n), Bar::new(n, 0).derivatives);
        self.measures.pull_back(Figure::FlowRate, &self.at(equations, &state, &d), 1.0, &mut bar);
        let fields = equations.by_fields(operators, &bar);
        (0..4 * n).map(|k| fields[k % 4][k / 4]).collect()
    }
}
