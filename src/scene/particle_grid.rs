//! Moving particles on the points of a grid, `output.grid`.
//!
//! As around fixed particles ([`crate::sph::cloud::interpolation`]) a point has the Taylor polynomial of second order of the nearest
//! particle, with derivatives by a fit to those near it. It is exact for quadratic fields on any arrangement, for every method: those whose
//! walls have points of their own are interpolated up to these.

use super::custom::{shapes, surroundings};
use super::distance::Walls;
use super::particle_fields::ParticleFields;
use crate::config::scene::Config;
use crate::io::grid_file::write_grid as write;
use crate::io::vtk::Image;
use crate::numerics::lanes::{Lanes, SingleF64};
use crate::particles::tag;
use crate::sph::cloud::fit::{Coefficients, Stencils, COEFFICIENTS, COEFFICIENTS_3D};
use crate::sph::cloud::nearest::{Nearest, Region};
use crate::sph::cloud::particles::NEIGHBOURS;
use crate::sph::consistent::stencil::{monomials, values};
use crate::sph::{Model, Sweeps};
use std::path::Path;

/// Neighbours of a fit in space, which has nine unknowns where one in the plane has five.
const NEIGHBOURS_3D: usize = 32;
/// In spacings, how deep in a wall the middle between two particles is that do not see each other. Those between points of the same
/// round surface are not that deep.
const DEEP: f64 = 0.5;
/// Particles farther than this from walls see all others of their fits. In spacings.
const HIDES: f64 = 4.0;
/// Points farther than this from every particle are not in the fluid. In spacings.
const FAR: f64 = 2.0;

/// Writes velocity, pressure and temperature at the points i L / N of the grid, if the configuration has one; not a number inside of
/// walls. Returns whether there is one.
///
/// # Errors
/// Formulas that cannot be read; HDF5's and the system's.
pub fn write_grid<R: Sweeps>(
    folder: &Path,
    config: &Config,
    model: &Model<R>,
    fields: &ParticleFields,
) -> anyhow::Result<bool> {
    let (grid, n) = (&config.output.grid, fields.tag.len());
    if grid.is_empty() {
        return Ok(false);
    }
    let shapes = shapes(config)?;
    let walls = surroundings(config, &shapes);
    let on_grid = |known: &dyn Fn(usize) -> bool, of: &[&[f64]]| {
        let known: Vec<usize> = (0..n).filter(|&i| known(i)).collect();
        match fields.dimension {
            3 => interpolated::<3, { monomials(3) }, COEFFICIENTS_3D>(
                config,
                &walls,
                &fields.position,
                &known,
                of,
                (NEIGHBOURS_3D, Stencils::<3>::coefficients),
            ),
            _ => interpolated::<2, { monomials(2) }, COEFFICIENTS>(
                config,
                &walls,
                &fields.position,
                &known,
                of,
                (NEIGHBOURS, Stencils::<2>::coefficients),
            ),
        }
    };
    let components: Vec<&[f64]> = fields.velocity.chunks_exact(n).collect();
    let velocity = on_grid(&|i| model.knows_velocity(i), &components);
    let mut scalars = vec![("pressure", on_grid(&|i| model.is_fluid(i), &[&fields.pressure]))];
    if let Some(temperature) = &fields.temperature {
        let is_known = |i: usize| model.is_fluid(i) || fields.tag[i] == tag::HOT_SURFACE;
        scalars.push(("temperature", on_grid(&is_known, &[temperature])));
    }
    let scalars: Vec<(&str, &[f64])> = scalars.iter().map(|(name, field)| (*name, field[0].as_slice())).collect();
    let (size, time) = (&config.region.size, fields.time);
    write(folder, &Image { shape: grid, size, time, velocity: &velocity, scalars: &scalars })?;
    Ok(true)
}

/// The coefficients of stencils at positions `[D][N]`.
type Fitting<const D: usize, const C: usize> = fn(&Stencils<D>, &[Vec<f64>; D]) -> Coefficients<C>;

/// Fields `[N]` of the particles that know them at the points of the grid, by fits of a number of neighbours.
fn interpolated<const D: usize, const Q: usize, const C: usize>(
    config: &Config,
    walls: &Walls,
    position: &[f64],
    known: &[usize],
    fields: &[&[f64]],
    (neighbours, coefficients): (usize, Fitting<D, C>),
) -> Vec<Vec<f64>> {
    let (grid, dx, n) = (&config.output.grid, config.resolution.dx, position.len() / D);
    let (size, periodic) = (&config.region.size, &config.region.periodic);
    let region = Region { size: std::array::from_fn(|d| size[d]), periodic: std::array::from_fn(|d| periodic[d]) };
    let depth = |p: [f64; D]| -walls.distance(std::array::from_fn(|d| if d < D { p[d] } else { 0.0 }));
    let places: Vec<[f64; D]> =
        known.iter().map(|&i| region.wrapped(std::array::from_fn(|d| position[d * n + i]))).collect();
    let all = Nearest::new(region, dx, &places);
    let near = |i: usize| {
        let is_open = depth(places[i]) < -HIDES * dx;
        let sees = |j: usize| {
            let r = region.between(places[i], places[j]);
            is_open || depth(region.wrapped(std::array::from_fn(|d| places[i][d] + 0.5 * r[d]))) < DEEP * dx
        };
        let found = all.of(places[i], neighbours + 1, |j, _| j != i && sees(j));
        match found.len() > neighbours {
            true => found,
            // Enclosed by walls, with few others.
            false => all.of(places[i], neighbours + 1, |j, _| j != i),
        }
    };
    let near: Vec<Vec<(f64, u32)>> = (0..places.len()).map(near).collect();
    let points: usize = grid.iter().product();
    let Ok(stencils) = Stencils::new(region, &places, |_| neighbours, |_| false, |i| &near[i]) else {
        // Fewer particles than a fit needs.
        return vec![vec![f64::NAN; points]; fields.len()];
    };
    let coefficients = coefficients(&stencils, &std::array::from_fn(|d| places.iter().map(|p| p[d]).collect()));
    let fields: Vec<Vec<f64>> = fields.iter().map(|field| known.iter().map(|&i| field[i]).collect()).collect();
    let mut found = vec![Vec::with_capacity(points); fields.len()];
    for k in 0..points {
        let index = |d: usize| k / grid[d + 1..].iter().product::<usize>() % grid[d];
        let p: [f64; D] = std::array::from_fn(|d| index(d) as f64 * size[d] / grid[d] as f64);
        let nearest = if depth(p) > 1e-9 * dx { None } else { all.one(p, FAR * dx) };
        let of = |i: usize, field: &[f64]| {
            let q: [SingleF64; Q] = values(&region.between(places[i], p).map(SingleF64::splat));
            let slopes = coefficients.derivatives(&stencils, i, field);
            field[i] + q.iter().zip(slopes).map(|(q, slope)| q.sum() * slope).sum::<f64>()
        };
        for (field, to) in fields.iter().zip(&mut found) {
            to.push(nearest.map_or(f64::NAN, |(_, i)| of(i, field)));
        }
    }
    found
}
