//! The heat that walls give to the fluid in the standard method.

use super::chain::{Masses, Step};
use crate::numerics::lanes::Real;
use crate::sph::flow::Heat;
use crate::sph::laws::conduction::{conducts, factor, flow};

/// Heat that walls give to conducting fluid with x < `until`, in units of density * temperature * volume / time (times
/// the heat capacity: power): the sum over fluid i and walls j of the pair flow (2 k/c_p) V_i V_j F_ij (T_i - T_j).
pub fn wall_flux<R: Real>(step: &Step<R>, moved: &[R], primitives: &[R], until: f64) -> f64 {
    let (model, list) = (&*step.model, &*step.list);
    let (n, l) = (model.particles(), model.layout);
    let mass = Masses::new(model, moved);
    let volume = |i: usize| (mass.of(i) / primitives[i]).f64();
    let conductivities = model.heat.as_ref().and_then(Heat::conductivities);
    let conductivity = |i: usize, j: usize| match conductivities {
        Some(all) => 2.0 * all[i].f64() * all[j].f64() / (all[i].f64() + all[j].f64()),
        None => 1.0,
    };
    let temperature = |i: usize| primitives[l.primitive_temperature() * n + i].f64();
    let mut sum = 0.0;
    for &i in &list.fluid_rows {
        let i = i as usize;
        if !conducts(model, moved[i]) || moved[i].f64() >= until {
            continue;
        }
        for &j in &list.row(i)[list.fluid_count[i] as usize..list.count[i] as usize] {
            let j = j as usize;
            let mut r2 = 0.0;
            for d in 0..l.dimension {
                let dr = model.domain.nearest(d, moved[d * n + i].f64() - moved[d * n + j].f64());
                r2 += dr * dr;
            }
            let (_, slope) = model.kernel.pair(r2);
            sum += conductivity(i, j) * flow([volume(i), volume(j)], slope, [temperature(i), temperature(j)]);
        }
    }
    factor(model) * sum
}
