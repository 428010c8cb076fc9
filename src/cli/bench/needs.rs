//! Scenes that lack something, with their own plan and with every field forced on without effect.

use super::case::Lacking;
use crate::sph::flow::Heat;
use crate::sph::standard::{Layout, Standard};
use crate::sph::Model;
use crate::sph::Sweeps;

/// A viscosity below rounding (that does not underflow in f32), so that the viscous terms are computed without effect.
const NO_VISCOSITY: f64 = 1e-20;

impl Lacking {
    /// The scene with its own plan, or with every field, made from the scene as it was built.
    pub fn apply<R: Sweeps>(self, model: Standard<R>, state: &mut Vec<R>, forced: bool) -> Standard<R> {
        let Standard { mut flow, mut laws, .. } = model.clone();
        let has = model.layout;
        let own = match self {
            Self::Heat => Layout { heat: false, ..has },
            Self::Walls => Layout { heat: false, mass: false, ..has },
            Self::Viscosity => has,
            Self::TransportVelocity => Layout { transport: false, ..has },
            Self::Masses => Layout { mass: false, ..has },
        };
        let layout = if forced { Layout { transport: true, heat: true, mass: true, ..has } } else { own };
        *state = repacked(&model, state, layout);
        if layout.heat && (!own.heat || flow.heat.is_none()) {
            flow.heat = Some(no_heat(&model));
            let (row, n) = (layout.temperature(), model.particles());
            state[row * n..(row + 2) * n].fill(R::default());
        }
        if !layout.heat {
            flow.heat = None;
        }
        if !own.transport {
            laws.transport = 0.0;
        }
        if self == Self::Viscosity {
            flow.viscosity = if forced { NO_VISCOSITY } else { 0.0 };
        }
        Standard::new(flow, layout, laws)
    }
}

/// Conduction without temperature differences: every temperature is the reference.
fn no_heat<R: Sweeps>(model: &Standard<R>) -> Heat<R> {
    let n = model.particles();
    Heat {
        conductivity: 1.0,
        capacity: 100.0,
        reference: 1.0,
        // No particle is in the strips at the ends.
        inlet_below: f64::MIN,
        outlet_above: f64::MAX,
        wall_constant: vec![R::default(); n],
        wall_factor: vec![R::of(1.0); n],
        materials: None,
    }
}

/// The rows of a state in another layout. Missing rows are zero, masses are the model's.
fn repacked<R: Sweeps>(model: &Standard<R>, state: &[R], to: Layout) -> Vec<R> {
    let (from, n) = (model.layout, model.particles());
    let mut packed = vec![R::default(); to.state_rows() * n];
    let mut copy = |target: usize, source: usize, rows: usize| {
        packed[target * n..(target + rows) * n].copy_from_slice(&state[source * n..(source + rows) * n]);
    };
    copy(0, 0, 3 * to.dimension);
    if to.transport && from.transport {
        copy(to.transport_acceleration(), from.transport_acceleration(), to.dimension);
    }
    if to.heat && from.heat {
        copy(to.temperature(), from.temperature(), 2);
    }
    if to.mass && from.mass {
        copy(to.state_mass(), from.state_mass(), 1);
    }
    if to.mass && !from.mass {
        packed[to.state_mass() * n..][..n].fill(R::of(model.mass));
    }
    packed
}

/// Largest difference between two states in the rows of both layouts, over the largest value of each row.
pub fn difference<R: Sweeps>(n: usize, (a, from): (&[R], Layout), (b, to): (&[R], Layout)) -> f64 {
    let d = from.dimension;
    let mut fields = vec![(0, 0, d), (d, d, d)];
    if from.heat && to.heat {
        fields.push((from.temperature(), to.temperature(), 1));
    }
    let worst = |(x, y, rows): &(usize, usize, usize)| {
        let (x, y) = (&a[x * n..(x + rows) * n], &b[y * n..(y + rows) * n]);
        let largest = x.iter().chain(y).fold(0.0, |most: f64, v| most.max(v.f64().abs()));
        let apart = x.iter().zip(y).map(|(x, y)| (x.f64() - y.f64()).abs());
        // `max` would ignore a NaN.
        let apart = apart.fold(0.0, |most: f64, v| if v <= most { most } else { v });
        apart / largest.max(f64::MIN_POSITIVE)
    };
    fields.iter().map(worst).fold(0.0, |most: f64, v| if v <= most { most } else { v })
}

/// The standard method of a scene.
pub fn standard<R: Sweeps>(model: &Model<R>) -> &Standard<R> {
    model.of_type().expect("scenes that lack something are of the standard method")
}
