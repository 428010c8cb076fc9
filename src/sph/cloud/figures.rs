//! Figures of a steady flow: flow rate, and force, torque and heat of shapes.
//!
//! On a wall with normal n into the fluid the fluid's traction is t = -p n + nu (grad u + grad u^T) n and the heat that the
//! wall gives is -alpha n . grad T (times density and heat capacity). Sums of these over a shape's points are its *surface*
//! figures. In a steady flow they are told by *balance*, on a line around the shape ([`super::contour`]), which is more accurate
//! by far. They are what is reported and differentiated (a designer finds the errors of the surface's). Where nothing flows in or out,
//! other walls leave no doubt of the sums,
//!
//! ```text
//!   sum of forces = f area - sum_rest t length,   sum of heat = sum_rest alpha n . grad T length,
//! ```
//!
//! and shapes share what their lines differ from them by, in proportion to their lengths.

use super::contour::Contour;
use super::equations::{Bar, Condition, Derivatives, Equations, Motion, State, Warmth};
use super::fit::Coefficients;
use super::interpolation::Sample;
use super::particles::{At, Balanced, Cloud, Shaped};
use super::steady::FlowRate;
use super::traction::{unit, Patch};
use super::wall_fit::WallFit;
use std::collections::BTreeSet;

/// A figure that is a smooth function of state and shape.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Figure {
    /// Volume per time and depth through a cross-section.
    FlowRate,
    /// Force of the fluid on a body along x or y, per density.
    Force { shape: usize, along: usize },
    /// Torque of the fluid on a shape about its centre, per density.
    Torque { shape: usize },
    /// Heat that a shape gives to the fluid, per density and heat capacity.
    Heat { shape: usize },
    /// Heat that flows with the fluid through the section at [`MeasureSettings::target`].
    HeatOutflow,
    /// Mean pressure of the sides that the fluid enters by less that of those where it leaves, or of a period.
    PressureDrop,
    /// A field (u, v, p, T) at the point of a probe, by the probe's index.
    Probe { field: usize, probe: usize },
    /// Power of the driving forces less that of moving walls, per density.
    Dissipation,
}

/// Which figures are told besides those of all flows, and where.
#[derive(Debug, Clone, Copy)]
pub struct MeasureSettings<'a, const D: usize> {
    /// Points at which fields are figures.
    pub probes: &'a [[f64; D]],
    /// x of the section where the heat outflow is told; behind the end of the region it is the end.
    pub target: f64,
    pub balanced: Balanced,
}

/// What figures need beside the state.
#[derive(Debug)]
pub struct Measures {
    /// Points with their weights of the section where the flow rate is told, as far from bodies as possible.
    section: Vec<(Sample, f64)>,
    /// The same of the one where the heat outflow is told.
    target: Vec<(Sample, f64)>,
    probes: Vec<Sample>,
    wall_fits: Vec<Option<WallFit>>,
    /// Indices of boundary points by shape.
    points: Vec<Vec<usize>>,
    /// Boundary points of no body and of no shape with a line.
    rest: Vec<usize>,
    /// The line around each shape that is in the fluid; none where figures are not balanced.
    contours: Vec<Option<Contour>>,
    /// Share of each shape in what the lines' forces and heat differ from the sums of all by; 0 of those without a line, and where these sums
    /// are not known.
    share: Vec<f64>,
    has_corners: Vec<bool>,
    read_at: Vec<usize>,
    inside: usize,
    /// Area of the box that no boundary point accounts for.
    base_area: f64,
    size: [f64; 2],
    periodic_x: bool,
}

impl Measures {
    pub fn new(cloud: &Cloud, settings: MeasureSettings<'_, 2>) -> Self {
        let (plane, places) = (cloud.ground.plane, &cloud.places);
        let shapes = cloud.ground.outlines.len();
        let mut points = vec![vec![]; shapes];
        for (k, point) in places.boundary.iter().enumerate() {
            if let Some(shape) = cloud.shape_at(point, places.place[point.particle]) {
                points[shape].push(k);
            }
        }
        let (balanced, numbers) = (settings.balanced, cloud.numbers());
        let contours = (0..shapes).map(|shape| {
            let is_told = places.touching.contains(&shape);
            let line = is_told.then(|| Contour::around(cloud, shape, points[shape].clone(), balanced)).flatten()?;
            let feet: Vec<usize> = line.feet().iter().map(|foot| foot.point).collect();
            let leaves = || feet.iter().any(|&k| cloud.leaves(&places.boundary[k], &numbers));
            let is_known = || !(breathes(cloud, &points[shape]) || breathes(cloud, &feet) || leaves());
            (balanced != Balanced::InTime || is_known()).then_some(line)
        });
        let contours: Vec<Option<Contour>> = contours.collect();
        let mut is_rest = vec![true; places.boundary.len()];
        for shape in (0..shapes).filter(|shape| contours[*shape].is_some() || places.bodies.contains(shape)) {
            points[shape].iter().for_each(|&k| is_rest[k] = false);
        }
        let rest = (0..is_rest.len()).filter(|&k| is_rest[k]).collect::<Vec<_>>();
        let length = |shape: usize| -> f64 {
            let outline = &cloud.ground.outlines[shape];
            let on = |k: &usize| {
                let point = &places.boundary[*k];
                let along = outline.points(&[point.on.map_or(0.0, |on| on.1)], &outline.numbers)[0].along;
                point.weight * along[0].hypot(along[1])
            };
            points[shape].iter().map(on).sum()
        };
        let total: f64 = (0..shapes).filter(|&shape| contours[shape].is_some()).map(length).sum();
        // Where the rest is coarser than the surroundings of bodies (`resolution.far`), these know better.
        let is_fine = rest.iter().all(|&k| places.spacing[places.boundary[k].particle] < 1.5 * cloud.ground.dx);
        let is_shared = |shape: usize| settings.balanced == Balanced::Steady && is_fine && contours[shape].is_some();
        let share = (0..shapes).map(|k| if is_shared(k) { length(k) / total } else { 0.0 }).collect();
        let [low, high] = places.corners;
        // In the middle between lattice columns nothing is exact; a column is as good as any place in between.
        let cells = cloud.ground.cells(&places.corners)[0];
        let step = (high[0] - low[0]) / cells as f64;
        let distance = |x: f64| {
            let of = |k: &usize| {
                let along = |p: &[f64; 2]| plane.between([x, 0.0], [p[0], 0.0])[0].abs();
                places.polygons[*k].iter().map(along).fold(f64::MAX, f64::min)
            };
            let ends = if plane.periodic[0] { f64::MAX } else { (x - low[0]).min(high[0] - x) };
            places.bodies.iter().map(of).fold(ends, f64::min)
        };
        let columns = (0..cells).map(|k| low[0] + k as f64 * step);
        let (farthest, _) =
            columns
                .fold((low[0], f64::MIN), |best, x| if distance(x) > best.1 + 1e-9 { (x, distance(x)) } else { best });
        let near = super::nearest::Nearest::new(plane, cloud.ground.dx, &places.place);
        let sample = |p: [f64; 2]| {
            let (_, particle) = near.one(p, 2.0 * cloud.ground.far * cloud.ground.dx)?;
            let own = places.place[particle];
            let r = plane.between(own, p);
            Some(Sample { particle, place: [own[0] + r[0], own[1] + r[1]] })
        };
        let section = |x: f64| -> Vec<(Sample, f64)> {
            let rows = cloud.ground.cells(&places.corners)[1];
            let step = (high[1] - low[1]) / rows as f64;
            // Gauss's two points in each row.
            let y = |k: usize| low[1] + step * ((k / 2) as f64 + 0.5 + (k as f64 % 2.0 - 0.5) / 3f64.sqrt());
            let points = (0..2 * rows).map(|k| [x, y(k)]);
            let fluid = points.filter(|p| cloud.ground.is_in_wall(&places.polygons, *p, None).is_none());
            fluid.filter_map(|p| Some((sample(p)?, 0.5 * step))).collect()
        };
        let (section, target) = (section(farthest), section(settings.target.clamp(low[0], high[0])));
        // What is too far from particles is refused before.
        let probes: Vec<Sample> =
            settings.probes.iter().map(|p| sample(*p).unwrap_or(Sample { particle: 0, place: *p })).collect();
        let base_area = if plane.periodic[1] { plane.size[0] * plane.size[1] } else { 0.0 };
        let (inside, size, periodic_x) = (places.inside, plane.size, plane.periodic[0]);
        let wall_fits = cloud.wall_fits.clone();
        let has_corners = cloud.ground.outlines.iter().map(|outline| !outline.corners().is_empty()).collect();
        let samples = section.iter().chain(&target).map(|(sample, _)| sample).chain(&probes);
        let through = contours.iter().flatten().flat_map(Contour::particles);
        let read_at = each_once(samples.map(|sample| sample.particle).chain(through));
        Self {
            section,
            target,
            probes,
            wall_fits,
            points,
            rest,
            contours,
            share,
            has_corners,
            read_at,
            inside,
            base_area,
            size,
            periodic_x,
        }
    }

    /// The particles at which derivatives are read, besides those on the boundary.
    pub fn read_at(&self) -> &[usize] {
        &self.read_at
    }

    /// Whether a shape has corners, at which a sum over its surface misses something.
    pub fn has_corners(&self, shape: usize) -> bool {
        self.has_corners[shape]
    }

    /// Whether a shape has a point on the boundary of the fluid.
    pub fn is_seen(&self, shape: usize) -> bool {
        !self.points[shape].is_empty()
    }

    fn sampled(sample: &Sample, at: &At<'_>, field: usize) -> f64 {
        sample.value(&at.shaped.position, &at.state.fields[field], &at.d.0[field])
    }

    /// The places, with their shares, whose mean is the zero of a field: of the pressure where no side gives one, which is then known but
    /// for a constant. They are those of the section that is as far from bodies as possible; empty for all other fields.
    fn level(&self, field: usize, at: &At<'_>) -> impl Iterator<Item = (&Sample, f64)> {
        let is_free = field == 2 && !at.equations.gives_pressure();
        let places: &[(Sample, f64)] = if is_free { &self.section } else { &[] };
        let total: f64 = places.iter().map(|(_, length)| length).sum();
        places.iter().map(move |(sample, length)| (sample, length / total))
    }

    /// Adds the cotangents of a field at a sample, given its own.
    pub fn sampled_back(sample: &Sample, at: &At<'_>, field: usize, weight: f64, bar: &mut Bar) {
        let (i, q) = (sample.particle, sample.monomials(&at.shaped.position));
        let slope = sample.slope(&at.shaped.position, &at.d.0[field]);
        bar.fields[field][i] += weight;
        (0..5).for_each(|a| bar.derivatives.0[field][i][a] += weight * q[a]);
        (0..2).for_each(|d| bar.position[d][i] -= weight * slope[d]);
    }

    /// Area of the fluid.
    pub fn area(&self, at: &At<'_>) -> f64 {
        let of = |(k, area): (usize, &[f64; 2])| at.place_on(k)[1] * area[1];
        self.base_area - at.shaped.area.iter().enumerate().map(of).sum::<f64>()
    }

    fn area_back(&self, at: &At<'_>, weight: f64, bar: &mut Bar) {
        for (k, area) in at.shaped.area.iter().enumerate() {
            let i = self.inside + k;
            bar.position[1][i] -= weight * area[1];
            bar.boundary[k].area[1] -= weight * at.place_on(k)[1];
        }
    }

    /// The gradient of the temperature at a point of the boundary.
    fn heat_slope(&self, at: &At<'_>, k: usize) -> [f64; 2] {
        match &self.wall_fits[k] {
            Some(fit) => fit.gradient(&at.shaped.position, &at.state.fields[3]),
            None => {
                let d = &at.d.0[3][self.inside + k];
                [d[0], d[1]]
            }
        }
    }

    fn heat_slope_back(&self, at: &At<'_>, k: usize, slope: [f64; 2], bar: &mut Bar) {
        match &self.wall_fits[k] {
            Some(fit) => {
                let of = (&at.shaped.position, at.state.fields[3].as_slice());
                fit.pull_back(of, slope, &mut bar.position, &mut bar.fields[3]);
            }
            None => (0..2).for_each(|b| bar.derivatives.0[3][self.inside + k][b] += slope[b]),
        }
    }

    /// What pushes at a point of the boundary.
    fn patch(&self, at: &At<'_>, k: usize) -> Patch<2> {
        let i = at.on(k);
        Patch {
            velocity: at.velocity(i),
            gradient: std::array::from_fn(|e| [at.d.0[e][i][0], at.d.0[e][i][1]]),
            pressure: at.state.fields[2][i],
            area: at.shaped.area[k],
        }
    }

    /// The traction times length at a point of the boundary, less the momentum that the fluid carries in, along e.
    fn push(&self, at: &At<'_>, k: usize, e: usize) -> f64 {
        self.patch(at, k).push(at.equations.viscosity, e)
    }

    /// Adds the cotangents of [`Self::push`], given those of both components.
    fn push_back(&self, at: &At<'_>, k: usize, weight: [f64; 2], bar: &mut Bar) {
        let (back, viscosity) = self.patch(at, k).push_back(at.equations.viscosity, weight);
        let i = at.on(k);
        for e in 0..2 {
            bar.fields[e][i] += back.velocity[e];
            (0..2).for_each(|b| bar.derivatives.0[e][i][b] += back.gradient[e][b]);
            bar.boundary[k].area[e] += back.area[e];
        }
        bar.fields[2][i] += back.pressure;
        bar.viscosity += viscosity;
    }

    /// The heat that enters at a point of the boundary, by conduction and with the fluid.
    fn warmth(&self, at: &At<'_>, k: usize) -> f64 {
        let (i, a) = (self.inside + k, at.shaped.area[k]);
        let (dt, u) = (self.heat_slope(at, k), at.velocity(i));
        let alpha = at.equations.diffusivity.unwrap_or(0.0);
        at.state.fields[3][i] * (u[0] * a[0] + u[1] * a[1]) - alpha * (dt[0] * a[0] + dt[1] * a[1])
    }

    fn warmth_back(&self, at: &At<'_>, k: usize, weight: f64, bar: &mut Bar) {
        let (i, a) = (self.inside + k, at.shaped.area[k]);
        let (dt, u, t) = (self.heat_slope(at, k), at.velocity(i), at.state.fields[3][i]);
        let alpha = at.equations.diffusivity.unwrap_or(0.0);
        bar.fields[3][i] += weight * (u[0] * a[0] + u[1] * a[1]);
        for b in 0..2 {
            bar.fields[b][i] += weight * t * a[b];
            bar.boundary[k].area[b] += weight * (t * u[b] - alpha * dt[b]);
        }
        self.heat_slope_back(at, k, [-weight * alpha * a[0], -weight * alpha * a[1]], bar);
    }

    fn body_force(at: &At<'_>) -> [f64; 2] {
        [at.equations.force[0] + at.state.drive, at.equations.force[1]]
    }

    /// A shape's force along e by its surface alone.
    pub fn surface_force(&self, at: &At<'_>, shape: usize, e: usize) -> f64 {
        self.points[shape].iter().map(|&k| self.push(at, k, e)).sum()
    }

    /// A shape's heat by its surface alone.
    pub fn surface_heat(&self, at: &At<'_>, shape: usize) -> f64 {
        self.points[shape].iter().map(|&k| self.warmth(at, k)).sum()
    }

    /// The largest heat flux of a shape's surface, per density and heat capacity.
    pub fn largest_heat_flux(&self, at: &At<'_>, shape: usize) -> f64 {
        let of = |&k: &usize| self.warmth(at, k) / at.shaped.area[k][0].hypot(at.shaped.area[k][1]);
        self.points[shape].iter().map(of).fold(0.0, |most: f64, x| if x.abs() > most.abs() { x } else { most })
    }

    /// The share of a shape in what the lines' figures differ from the sum of all by; 0 where something flows in or out.
    fn share(&self, at: &At<'_>, shape: usize) -> f64 {
        let is_closed = || self.rest.iter().all(|&k| self.end_of(at, k).is_none());
        if self.share[shape] != 0.0 && is_closed() {
            self.share[shape]
        } else {
            0.0
        }
    }

    /// The same of the force; 0 with buoyancy, whose sum over all of the fluid is not known.
    fn share_of_force(&self, at: &At<'_>, shape: usize) -> f64 {
        if at.equations.buoyancy.is_none() {
            self.share(at, shape)
        } else {
            0.0
        }
    }

    /// The same of the heat; 0 where nothing but bodies lets heat through.
    fn share_of_heat(&self, at: &At<'_>, shape: usize) -> f64 {
        let lets_through = |&k: &usize| {
            let Condition { warmth, .. } = at.shaped.conditions[k];
            !matches!(warmth, Warmth::Flux(q) if q == 0.0)
        };
        if self.rest.iter().any(lets_through) {
            self.share(at, shape)
        } else {
            0.0
        }
    }

    /// The sum of the heat of all bodies, where nothing flows in or out.
    fn sum_of_heat(&self, at: &At<'_>) -> f64 {
        -self.rest.iter().map(|&k| self.warmth(at, k)).sum::<f64>()
    }

    /// The sum of the forces on all bodies along e, where nothing flows in or out.
    fn sum_of_forces(&self, at: &At<'_>, e: usize) -> f64 {
        Self::body_force(at)[e] * self.area(at) - self.rest.iter().map(|&k| self.push(at, k, e)).sum::<f64>()
    }

    /// The line that tells the torque: of a shape with corners. (With others a sum over the surface is more accurate, for its arms are shorter:
    /// in 35 channels at random 0.05 instead of 0.13 % of drag times radius in the middle.)
    fn line_of_torque(&self, at: &At<'_>, shape: usize) -> Option<&Contour> {
        let is_known = |line: &&Contour| line.is_steady() && at.equations.buoyancy.is_none();
        self.contours[shape].as_ref().filter(|line| is_known(line) && self.has_corners[shape])
    }

    /// Force and torque of a shape by a line around it.
    fn force_by(&self, line: &Contour, at: &At<'_>, shape: usize) -> [f64; 3] {
        let centre = at.shaped.centre[shape];
        let mut sum = line.force(at, Self::body_force(at), centre);
        for foot in line.feet() {
            let [x, y] = [0, 1].map(|e| foot.share * self.push(at, foot.point, e));
            let r = foot.place(at);
            let torque = (r[0] - centre[0]) * y - (r[1] - centre[1]) * x;
            (sum[0], sum[1], sum[2]) = (sum[0] - x, sum[1] - y, sum[2] - torque);
        }
        sum
    }

    /// Adds the cotangents of [`Self::force_by`], given those of its three numbers.
    fn force_by_back(&self, line: &Contour, at: &At<'_>, shape: usize, weight: [f64; 3], bar: &mut Bar) {
        let centre = at.shaped.centre[shape];
        let [of_force, mut of_centre] = line.force_back(at, Self::body_force(at), centre, weight, bar);
        for foot in line.feet() {
            let (k, share, r) = (foot.point, foot.share, foot.place(at));
            let arm = [r[0] - centre[0], r[1] - centre[1]];
            let of_push = [weight[0] - weight[2] * arm[1], weight[1] + weight[2] * arm[0]];
            self.push_back(at, k, of_push.map(|one| -share * one), bar);
            let [x, y] = [0, 1].map(|e| share * weight[2] * self.push(at, k, e));
            for (d, of) in [-y, x].into_iter().enumerate() {
                bar.position[d][at.on(k)] += of;
                of_centre[d] -= of;
            }
        }
        bar.drive += of_force[0];
        bar.add_centre(shape, of_centre);
    }

    /// The heat that a shape gives by a line around it.
    fn heat_by(&self, line: &Contour, at: &At<'_>) -> f64 {
        line.heat(at) - line.feet().iter().map(|foot| foot.share * self.warmth(at, foot.point)).sum::<f64>()
    }

    fn heat_by_back(&self, line: &Contour, at: &At<'_>, weight: f64, bar: &mut Bar) {
        line.heat_back(at, weight, bar);
        line.feet().iter().for_each(|foot| self.warmth_back(at, foot.point, -weight * foot.share, bar));
    }

    /// Whether a line around a shape tells its figures.
    pub fn has_line(&self, shape: usize) -> bool {
        self.contours[shape].is_some()
    }

    /// The shapes whose figures lines tell.
    fn lines(&self) -> impl Iterator<Item = (usize, &Contour)> {
        self.contours.iter().enumerate().filter_map(|(shape, line)| Some((shape, line.as_ref()?)))
    }

    pub fn value(&self, figure: Figure, at: &At<'_>) -> f64 {
        match figure {
            Figure::FlowRate => self.section.iter().map(|(s, weight)| weight * Self::sampled(s, at, 0)).sum(),
            Figure::HeatOutflow => {
                self.target.iter().map(|(s, weight)| weight * Self::sampled(s, at, 0) * Self::sampled(s, at, 3)).sum()
            }
            Figure::Force { shape, along } => match &self.contours[shape] {
                Some(line) => {
                    let lines = || self.lines().map(|(other, line)| self.force_by(line, at, other)[along]).sum::<f64>();
                    let share = self.share_of_force(at, shape);
                    let rest = if share == 0.0 { 0.0 } else { self.sum_of_forces(at, along) - lines() };
                    self.force_by(line, at, shape)[along] + share * rest
                }
                None => self.surface_force(at, shape, along),
            },
            Figure::Heat { shape } => match &self.contours[shape] {
                Some(line) => {
                    let lines = || self.lines().map(|(_, line)| self.heat_by(line, at)).sum::<f64>();
                    let share = self.share_of_heat(at, shape);
                    let rest = if share == 0.0 { 0.0 } else { self.sum_of_heat(at) - lines() };
                    self.heat_by(line, at) + share * rest
                }
                None => self.surface_heat(at, shape),
            },
            Figure::Torque { shape } => {
                let c = at.shaped.centre[shape];
                if let Some(line) = self.line_of_torque(at, shape) {
                    return self.force_by(line, at, shape)[2];
                }
                let of = |&k: &usize| {
                    let p = at.place_on(k);
                    (p[0] - c[0]) * self.push(at, k, 1) - (p[1] - c[1]) * self.push(at, k, 0)
                };
                self.points[shape].iter().map(of).sum()
            }
            Figure::Probe { field, probe } => {
                let level = self.level(field, at).map(|(sample, share)| share * Self::sampled(sample, at, field));
                Self::sampled(&self.probes[probe], at, field) - level.sum::<f64>()
            }
            Figure::PressureDrop => {
                if self.periodic_x {
                    return Self::body_force(at)[0] * self.size[0];
                }
                let (mut sums, mut lengths) = ([0.0; 2], [0.0; 2]);
                for &k in &self.rest {
                    if let Some((end, length)) = self.end_of(at, k) {
                        sums[end] += length * at.state.fields[2][self.inside + k];
                        lengths[end] += length;
                    }
                }
                sums[0] / lengths[0].max(f64::MIN_POSITIVE) - sums[1] / lengths[1].max(f64::MIN_POSITIVE)
            }
            Figure::Dissipation => {
                let driven = Self::body_force(at)[0] * self.value(Figure::FlowRate, at) * self.size[0];
                let walls = (0..at.shaped.area.len()).map(|k| self.power(at, k));
                driven - walls.sum::<f64>()
            }
        }
    }

    /// 0 for a point where fluid enters, 1 where it leaves, with its length; none on walls.
    fn end_of(&self, at: &At<'_>, k: usize) -> Option<(usize, f64)> {
        let a = at.shaped.area[k];
        let length = a[0].hypot(a[1]);
        match at.shaped.conditions[k].motion {
            Motion::Outflow(_) => Some((1, length)),
            Motion::Given(u) => {
                let through = u[0] * a[0] + u[1] * a[1];
                (through.abs() > 1e-12 * length).then_some((if through > 0.0 { 0 } else { 1 }, length))
            }
            Motion::Symmetry(_) => None,
        }
    }

    /// Power that the fluid gives away at a point of the boundary, with half of the carried kinetic energy given back.
    fn power(&self, at: &At<'_>, k: usize) -> f64 {
        let (u, a) = (at.velocity(self.inside + k), at.shaped.area[k]);
        if u == [0.0; 2] {
            return 0.0;
        }
        let carried = 0.5 * (u[0] * u[0] + u[1] * u[1]) * (u[0] * a[0] + u[1] * a[1]);
        u[0] * self.push(at, k, 0) + u[1] * self.push(at, k, 1) + carried
    }

    /// Adds the cotangents of a figure times `weight`.
    pub fn pull_back(&self, figure: Figure, at: &At<'_>, weight: f64, bar: &mut Bar) {
        match figure {
            Figure::FlowRate => {
                self.section.iter().for_each(|(s, own)| Self::sampled_back(s, at, 0, weight * own, bar));
            }
            Figure::HeatOutflow => {
                for (s, own) in &self.target {
                    let (u, t) = (Self::sampled(s, at, 0), Self::sampled(s, at, 3));
                    Self::sampled_back(s, at, 0, weight * own * t, bar);
                    Self::sampled_back(s, at, 3, weight * own * u, bar);
                }
            }
            Figure::Force { shape, along } => match &self.contours[shape] {
                Some(line) => {
                    self.force_by_back(line, at, shape, unit(along, weight), bar);
                    let weight = weight * self.share_of_force(at, shape);
                    if weight == 0.0 {
                        return;
                    }
                    for (other, line) in self.lines() {
                        self.force_by_back(line, at, other, unit(along, -weight), bar);
                    }
                    self.rest.iter().for_each(|&k| self.push_back(at, k, unit(along, -weight), bar));
                    self.area_back(at, weight * Self::body_force(at)[along], bar);
                    if along == 0 {
                        bar.drive += weight * self.area(at);
                    }
                }
                None => self.points[shape].iter().for_each(|&k| self.push_back(at, k, unit(along, weight), bar)),
            },
            Figure::Heat { shape } => match &self.contours[shape] {
                Some(line) => {
                    self.heat_by_back(line, at, weight, bar);
                    let weight = weight * self.share_of_heat(at, shape);
                    if weight != 0.0 {
                        self.lines().for_each(|(_, line)| self.heat_by_back(line, at, -weight, bar));
                        self.rest.iter().for_each(|&k| self.warmth_back(at, k, -weight, bar));
                    }
                }
                None => self.points[shape].iter().for_each(|&k| self.warmth_back(at, k, weight, bar)),
            },
            Figure::Torque { shape } => {
                if let Some(line) = self.line_of_torque(at, shape) {
                    self.force_by_back(line, at, shape, [0.0, 0.0, weight], bar);
                    return;
                }
                for &k in &self.points[shape] {
                    let (i, c) = (at.on(k), at.shaped.centre[shape]);
                    let p = at.place_on(k);
                    let (x, y) = (self.push(at, k, 0), self.push(at, k, 1));
                    self.push_back(at, k, [-weight * (p[1] - c[1]), weight * (p[0] - c[0])], bar);
                    bar.position[0][i] += weight * y;
                    bar.position[1][i] -= weight * x;
                    bar.add_centre(shape, [-weight * y, weight * x]);
                }
            }
            Figure::Probe { field, probe } => {
                Self::sampled_back(&self.probes[probe], at, field, weight, bar);
                for (sample, share) in self.level(field, at) {
                    Self::sampled_back(sample, at, field, -weight * share, bar);
                }
            }
            Figure::PressureDrop => {
                if self.periodic_x {
                    bar.drive += weight * self.size[0];
                    return;
                }
                let mut lengths = [0.0; 2];
                let ends: Vec<_> = self.rest.iter().filter_map(|&k| Some((k, self.end_of(at, k)?))).collect();
                ends.iter().for_each(|(_, (end, length))| lengths[*end] += length);
                for (k, (end, length)) in ends {
                    let sign = if end == 0 { 1.0 } else { -1.0 };
                    bar.fields[2][self.inside + k] += sign * weight * length / lengths[end];
                }
            }
            Figure::Dissipation => {
                let push = Self::body_force(at)[0];
                self.pull_back(Figure::FlowRate, at, weight * push * self.size[0], bar);
                bar.drive += weight * self.value(Figure::FlowRate, at) * self.size[0];
                for k in 0..at.shaped.area.len() {
                    let (i, a) = (self.inside + k, at.shaped.area[k]);
                    let u = at.velocity(i);
                    if u == [0.0; 2] {
                        continue;
                    }
                    self.push_back(at, k, u.map(|u| -weight * u), bar);
                    for e in 0..2 {
                        bar.fields[e][i] -= weight * self.push(at, k, e);
                    }
                    let (square, through) = (u[0] * u[0] + u[1] * u[1], u[0] * a[0] + u[1] * a[1]);
                    for e in 0..2 {
                        bar.fields[e][i] -= weight * (u[e] * through + 0.5 * square * a[e]);
                        bar.boundary[k].area[e] -= weight * 0.5 * square * u[e];
                    }
                }
            }
        }
    }
}

/// Particles without those that come again.
pub(super) fn each_once(particles: impl Iterator<Item = usize>) -> Vec<usize> {
    particles.collect::<BTreeSet<usize>>().into_iter().collect()
}

/// Whether fluid goes through the surface of a shape, by formulas that have the time.
fn breathes(cloud: &Cloud, points: &[usize]) -> bool {
    let numbers = cloud.numbers();
    // At times that belong together by no likely period.
    let times = [0.0, 0.37, 1.13, 2.71];
    cloud.surroundings.has_time()
        && points.iter().map(|&k| &cloud.places.boundary[k]).any(|point| {
            let place = cloud.places.place[point.particle];
            times.iter().any(|&time| match cloud.surroundings.condition(point, place, time, &numbers).0 {
                Motion::Given(u) => (u[0] * point.normal[0] + u[1] * point.normal[1]).abs() > 1e-9 * u[0].hypot(u[1]),
                _ => true,
            })
        })
}

/// The flow rate for a drive that holds it.
pub struct Rate<'a> {
    pub measures: &'a Measures,
    pub shaped: &'a Shaped,
}

impl FlowRate for Rate<'_> {
    fn value(&self, equations: &Equations, state: &State, d: &Derivatives) -> f64 {
        self.measures.value(Figure::FlowRate, &At { equations, shaped: self.shaped, state, d, defect: None })
    }

    fn by_state(&self, equations: &Equations, operators: &Coefficients) -> Vec<f64> {
        let n = equations.particles();
        let state = State::at_rest(n);
        let d = Derivatives::zeros(n);
        let at = At { equations, shaped: self.shaped, state: &state, d: &d, defect: None };
        let mut bar = Bar::new(n, self.shaped.area.len());
        self.measures.pull_back(Figure::FlowRate, &at, 1.0, &mut bar);
        let fields = equations.by_fields(operators, &bar);
        (0..3 * n).map(|k| fields[k % 3][k / 3]).collect()
    }
}
