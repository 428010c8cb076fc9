//! Every lane type that this processor can run.

use hydrograd::numerics::lanes::{InstructionSet, Lanes, PortableF32, PortableF64, Real, RowKernel};
use std::ops::Range;

/// What is done with a lane type.
pub trait Visit: Sync {
    /// `epsilon`: the rounding error of its numbers.
    fn visit<L: Lanes>(&self, name: &str, epsilon: f64);
}

struct Visiting<'a, V> {
    visit: &'a V,
    name: String,
    epsilon: f64,
}

impl<R: Real, V: Visit> RowKernel<R> for Visiting<'_, V> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, _: Range<usize>) {
        self.visit.visit::<L>(&self.name, self.epsilon);
    }
}

/// Visits the portable lanes, and those of each instruction set in f64 and f32.
pub fn each_lane_type(visit: &impl Visit) {
    visit.visit::<PortableF64>("portable f64", f64::EPSILON);
    visit.visit::<PortableF32>("portable f32", f32::EPSILON as f64);
    for set in InstructionSet::available() {
        let visiting = |precision: &str, epsilon: f64| {
            let name = format!("{} {precision}", set.name());
            Visiting { visit, name, epsilon }
        };
        f64::run(&visiting("f64", f64::EPSILON), 0..1, set);
        f32::run(&visiting("f32", f32::EPSILON as f64), 0..1, set);
    }
}
