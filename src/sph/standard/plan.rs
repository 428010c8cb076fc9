//! The plan of a step of the standard method, which `--explain` prints.

use super::model::Standard;
use super::records::record_fields;
use super::sweeps::Sweeps;
use crate::particles::NeighbourList;
use crate::sph::inventory::{dropped, words, Dropped, Field, Operator};
use crate::sph::laws::body_force::BodyForce;
use crate::sph::laws::{with_laws, Flux};
use crate::sph::pairs::stride;
use crate::sph::rows::components;

/// The operators of a step, in order.
pub fn operators<R: Sweeps>(model: &Standard<R>, list: &NeighbourList) -> Vec<Operator> {
    let (l, n, number) = (model.layout, model.particles(), std::mem::size_of::<R>());
    let d = l.dimension;
    let row = |rows: usize| rows * n * number;
    let fluid_pairs: usize = list.fluid_rows.iter().map(|&i| list.count[i as usize] as usize).sum();
    let wall_pairs = list.pairs() - fluid_pairs;
    // Velocity and volume, which are read in addition to the position.
    let evolved = if l.density { d + 1 } else { 0 };
    let drift = words(&[
        (true, "kick with the old acceleration"),
        (l.transport, "transport velocity"),
        (true, "move"),
        (model.domain.periodic[..d].contains(&true), "periodic wrap"),
        (l.heat, "heat with the old rate"),
    ]);
    // Fields that walls average over the fluid: velocity, [shift], pressure, [temperature].
    let averaged = d * (1 + l.transport as usize) + 1 + l.heat as usize;
    let extrapolates = !list.wall_rows.is_empty();
    let wall_pairs = if extrapolates { wall_pairs } else { 0 };
    let walls = words(&[
        (true, "copy of the fluid's fields"),
        (extrapolates, "walls: pressure, density and velocity from the fluid (Adami 2012)"),
        (extrapolates && matches!(model.body_force, BodyForce::Gravity(_)), "walls: pressure of the depth"),
        (extrapolates && l.transport, "walls: transport shift"),
        (extrapolates && l.heat, "walls: temperature"),
    ]);
    let assemble = words(&[(true, "the new state from its parts"), (l.heat, "inlet temperature")]);
    let record = stride(record_fields(d, l.transport, l.heat));
    let (fluid, mass) = (list.fluid_rows.len(), l.mass as usize);
    let gathered = |fields: usize, pairs: usize| fields * number * pairs;
    let density_read = row(evolved + d + mass) + 4 * fluid_pairs;
    let rates_read = row(d + l.primitive_rows() + mass) + 4 * fluid_pairs;
    let walls_bytes =
        [row(l.moved_rows() + 1) + 4 * wall_pairs, row(l.primitive_rows()), gathered(d + averaged, wall_pairs)];
    vec![
        Operator::new("drift", drift, [n, 0], [row(l.state_rows()), row(l.moved_rows()), 0]),
        Operator::neighbours::<R>(n, d),
        Operator::new(
            "density",
            density(model),
            [fluid, fluid_pairs],
            [density_read, row(1), gathered(evolved + d, fluid_pairs)],
        ),
        Operator::new("wall condition", walls, [list.wall_rows.len(), wall_pairs], walls_bytes),
        Operator::new(
            "rates",
            laws(model),
            [fluid, fluid_pairs],
            [rates_read, row(l.rate_rows()), gathered(record, fluid_pairs)],
        ),
        Operator::new("assemble", assemble, [n, 0], [row(l.moved_rows() + l.rate_rows()), row(l.state_rows()), 0]),
    ]
}

/// How the density is computed.
fn density<R: Sweeps>(model: &Standard<R>) -> Vec<String> {
    if !model.layout.density {
        return vec!["summation".into()];
    }
    let mut does = vec![match model.laws.flux {
        Flux::Riemann(_) => "evolution by Riemann problems",
        _ => "evolution by continuity",
    }];
    if matches!(model.laws.flux, Flux::Delta(..)) {
        does.push("diffusion of density");
    }
    if model.laws.renormalises {
        does.push("renormalisation");
    }
    does.into_iter().map(String::from).collect()
}

/// The pair laws, and the forces that act on each particle alone.
fn laws<R: Sweeps>(model: &Standard<R>) -> Vec<String> {
    let mut names = Vec::new();
    match model.laws.flux {
        Flux::Riemann(_) if !model.is_fused() => names.push("pressure and viscosity by Riemann problems"),
        _ => with_laws!(model, |laws, _D| laws.name(&mut names)),
    }
    if model.body_force != BodyForce::None {
        names.push("body force");
    }
    if model.buoyancy.is_some() {
        names.push("buoyancy");
    }
    names.into_iter().map(String::from).collect()
}

/// The packed tensors of a step.
pub fn fields<R: Sweeps>(model: &Standard<R>) -> Vec<Field> {
    let l = model.layout;
    let vector = |name: &str| components(name, l.dimension);
    let optional = |wanted: bool, names: Vec<String>| if wanted { names } else { vec![] };
    let one = |name: &str| vec![name.to_string()];
    let moved = [
        vector("position"),
        vector("velocity"),
        optional(l.transport, vector("transport shift")),
        optional(l.heat, ["temperature before", "temperature"].map(String::from).to_vec()),
        optional(l.mass, one("mass")),
        optional(l.density, one("density before")),
    ];
    let primitives = [
        one("density"),
        vector("velocity"),
        optional(l.transport, vector("transport shift")),
        optional(l.heat, one("temperature")),
    ];
    let rates = [
        vector("acceleration"),
        optional(l.transport, vector("transport acceleration")),
        optional(l.heat, one("temperature rate")),
    ];
    let all = [
        ("state", model.rows.names()),
        ("moved", moved.concat()),
        ("density", one("density")),
        ("primitives", primitives.concat()),
        ("rates", rates.concat()),
    ];
    all.into_iter().map(|(name, rows)| Field::of::<R>(name, rows, model.particles())).collect()
}

/// What a step leaves out, and why.
pub fn left_out<R: Sweeps>(model: &Standard<R>) -> Vec<Dropped> {
    let l = model.layout;
    let mut all = Vec::new();
    if !l.transport {
        all.push(dropped("transport velocity and its acceleration", "its strength is 0"));
    }
    if !l.mass {
        all.push(dropped("a mass of each particle", format!("every particle has the mass {:.4e}", model.mass)));
    }
    all
}
