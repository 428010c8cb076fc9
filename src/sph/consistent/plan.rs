//! The plan of a step of the consistent method, which `--explain` prints.

use super::arrangement::Shift;
use super::model::Consistent;
use super::stencil::monomials;
use super::sweeps::Sweeps;
use crate::particles::NeighbourList;
use crate::sph::inventory::{words, Operator};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::pairs::stride;

/// The operators of a step, in order.
pub fn operators<R: Sweeps>(model: &Consistent<R>, list: &NeighbourList) -> Vec<Operator> {
    let (l, n, number) = (model.layout, model.particles(), std::mem::size_of::<R>());
    let (d, terms) = (l.dimension, monomials(l.dimension));
    let row = |rows: usize| rows * n * number;
    let (fluid, walls) = (list.fluid_rows.len(), list.wall_rows.len());
    let fluid_pairs: usize = list.fluid_rows.iter().map(|&i| list.count[i as usize] as usize).sum();
    let fits = &model.fits;
    let has_dummies = !fits.dummies.is_empty();
    let of_points: usize = fits.surface.iter().map(|&i| list.count[i as usize] as usize).sum();
    let derivatives = |fields: usize| (fields * terms + 1 + d) * fluid * number;
    let record = |fields: usize| stride(fields) * number;
    let operator = |name, does, rows, pairs, bytes_read, bytes_written, gathered: usize| {
        Operator::new(name, does, [rows, pairs], [bytes_read, bytes_written, gathered * pairs])
    };
    let text = |texts: &[&str]| texts.iter().map(|text| text.to_string()).collect::<Vec<String>>();
    let shift = match &fits.shift {
        Shift::None => "no shift",
        Shift::Chain(_) => "shift along rows",
        Shift::Isotropic(_) => "shift away from crowds",
    };
    let mut all = vec![Operator::neighbours::<R>(n, d)];
    if has_dummies {
        let does = text(&["dummy particles: the fluid's values at their mirror images"]);
        let points = fits.surface.len();
        all.push(operator("wall values", does, points, of_points, row(l.state_rows()), row(1), record(d + 2)));
    }
    let mut fitted = text(&["second-order fits of velocity, pressure", "volumes", shift]);
    if l.heat {
        fitted[0].push_str(", temperature");
    }
    let (known, gathered) = (row(l.state_rows()), record(d + l.fields()));
    all.push(operator("derivatives", fitted, fluid, fluid_pairs, known, derivatives(l.fields()), gathered));
    let does = text(&["pressure from the divergence of the velocity", "delta diffusion", "its mean subtracted"]);
    let read = known + derivatives(l.fields());
    all.push(operator("continuity", does, fluid, fluid_pairs, read, row(1), record(2 * d + 3)));
    if has_dummies {
        let does = text(&["dummy particles: the new pressure"]);
        let points = fits.surface.len();
        all.push(operator("wall pressure", does, points, of_points, row(d + 1), row(1), record(d + 1)));
    }
    let does = text(&["fits of the new pressure, with the matrices that there are"]);
    all.push(operator("pressure gradient", does, fluid, fluid_pairs, row(d + 1), derivatives(1), record(d + 1)));
    let does = words(&[
        (true, "kick"),
        (true, "move"),
        (true, "periodic wrap"),
        (l.heat, "conduction"),
        (l.heat, "inlet temperature"),
        (model.body_force != BodyForce::None, "body force"),
        (model.buoyancy.is_some(), "buoyancy"),
    ]);
    let read = known + derivatives(l.fields()) + derivatives(1);
    all.push(operator("advance", does, fluid + walls, 0, read, known, 0));
    all
}
