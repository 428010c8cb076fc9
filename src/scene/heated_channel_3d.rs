//! The heated channel in three dimensions in the consistent method: the points on its walls, its dummy particles, and
//! its deformation by the height of the lower wall over x and z.

use super::assembly::{Assembled, Parts};
use super::surface::{Dummy, Knows, Point, Settings, Surface};
use crate::config::scene::Config;
use crate::design::deformation::Map;
use crate::design::relief::Relief;
use crate::design::shape::HotSection;
use crate::design::Deformation;
use crate::particles::tag;
use crate::sph::consistent::Consistent;
use crate::sph::Sweeps;

/// Points along x at one height, repeated in each layer of particles.
struct Line<'a> {
    x: &'a [f64],
    y: f64,
    knows: Knows,
}

/// The channel, and its deformation by the heights of its lower wall. Each layer of particles along z has the wall
/// points of the channel in two dimensions: two per spacing on the lower wall and one on the upper one with the wall's
/// velocity, and those with thermal conditions.
pub(super) fn consistent<R: Sweeps>(
    config: &Config,
    parts: &Parts<R>,
    mut assembled: Assembled<R>,
) -> (Consistent<R>, Deformation) {
    let (channel, lattice) = (&config.channel, &parts.lattice);
    let (dx, height, columns, layers) = (config.resolution.dx, channel.height, config.columns(), config.layers());
    let section = HotSection::of(config);
    let vertices = section.vertices();
    let (hot, cold) = section.heat_points();
    let centres: Vec<f64> = (0..columns).map(|c| (c as f64 + 0.5) * dx).collect();
    let excess = config.wall.hot_temperature - config.fluid.inlet_temperature;
    let still = Knows::Velocity([0.0; 3]);
    let lines = [
        Line { x: &vertices, y: 0.0, knows: still },
        Line { x: &hot, y: 0.0, knows: Knows::Temperature(excess) },
        Line { x: &cold, y: 0.0, knows: Knows::NoHeatFlux },
        Line { x: &centres, y: height, knows: still },
        Line { x: &centres, y: height, knows: Knows::NoHeatFlux },
    ];
    let mut points = Vec::new();
    // Index of each line's first point.
    let mut first = [0; 5];
    for (line, first) in lines.iter().zip(&mut first) {
        *first = points.len();
        let up = if line.y > 0.0 { -1.0 } else { 1.0 };
        for layer in 0..layers {
            let z = (layer as f64 + 0.5) * dx;
            let at = |&x: &f64| Point { position: [x, line.y, z], normal: [0.0, up, 0.0], knows: line.knows };
            points.extend(line.x.iter().map(at));
        }
    }
    let n = assembled.model.particles();
    let (mut dummies, mut below) = (Vec::new(), Vec::new());
    for i in 0..n {
        let [column, _, layer] = lattice.rows(i);
        let (y, z) = (assembled.base[n + i], assembled.base[2 * n + i]);
        if lattice.is_below(i, 1) {
            // Dummy particles are behind every second vertex, not in the columns of fluid.
            let x = vertices[2 * column];
            assembled.base[i] = x;
            let point = first[0] + layer * vertices.len() + 2 * column;
            dummies.push(Dummy { particle: i, point, mirror: [x, -y, z] });
            below.push(i);
            let is_hot = x > channel.hot_from && x < channel.hot_to;
            assembled.model.flow.tags[i] = if is_hot { tag::HOT_WALL } else { tag::WALL };
        } else if lattice.is_above(i, 1) {
            let mirror = [assembled.base[i], 2.0 * height - y, z];
            dummies.push(Dummy { particle: i, point: first[3] + layer * columns + column, mirror });
        }
    }
    let surface = Surface { points, dummies, rows: None };
    let settings = Settings::from_config(config).unwrap_or_default();
    let (model, base) = assembled.with_surface(&surface, &parts.numerics, dx, parts.velocity, settings);
    let particles = model.particles();
    let place = |i: usize| [base[i], base[2 * particles + i]];
    let mut relief = Relief::new(0.5 * dx, model.rows.velocity());
    for i in n..n + first[3] {
        relief.moves(i, place(i), 1.0);
    }
    for i in n + first[2]..n + first[3] {
        relief.leans(i, place(i), None);
    }
    for i in (0..n).filter(|&i| model.is_fluid(i)) {
        relief.moves(i, place(i), 1.0 - base[particles + i] / height);
    }
    for i in below {
        relief.moves(i, place(i), 1.0);
        relief.leans(i, place(i), Some(-base[particles + i]));
    }
    let columns = relief.places.len();
    (model, Deformation { columns, particles, map: Map::Relief(relief), base })
}
