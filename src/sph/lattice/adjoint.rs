//! The exact derivative of figures of a flow on a periodic lattice by its start, its materials and the sizes of its steps.
//!
//! It is that of the steps ([`super::march`]), whose sizes are those of the run. With E of a step and cotangents marked by a
//! dash, N*(a) being the transpose of the rates at a,
//!
//! ```text
//!   k4- = h u'-/6,  k3- = h E u'-/3,  k2- = h E u'-/3,  k1- = h E^2 u'-/6,  u- = E^2 u'-
//!   a4- = N*(a4) k4-:   u- += E^2 a4-,   k3- += h E a4-
//!   a3- = N*(a3) k3-:   u- += E a3-,     k2- += h a3-/2
//!   a2- = N*(a2) k2-:   u- += E a2-,     k1- += h E a2-/2
//!   u- += N*(u) k1-.
//! ```
//!
//! Terms with E^m depend on the viscosity by d(E^m)/d nu = -m h K E^m / 2. States are kept at the ends of segments, and
//! the stages of the steps of one segment at a time: all of them where they fit into memory, or about as many segments as
//! steps in one.

use super::equations::{Equations, OfMaterials, State};
use super::march::{Decay, Level};
use super::transform::Spectrum;
use num_complex::Complex64;

/// Bytes that the stages of a segment may have before there are more segments.
pub const MEMORY: usize = 256 << 20;

/// Cotangents of all that a flow depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Cotangents {
    /// Spectra of the cotangents of the fields at the start, before they are made free of divergence.
    pub start: State,
    pub materials: OfMaterials,
    /// The derivative by the size of each step.
    pub sizes: Vec<f64>,
}

/// A step with its stages: the state before it, a2, a3, a4, and the state after it.
struct Stages([State; 5]);

/// The cotangents of a sum of figures along steps of given `sizes` from `first` on: `figures` adds those of the state
/// after step k to a bar. `memory`: bytes for stages.
///
/// # Errors
/// Those of `figures`.
pub fn pull_back<E>(
    equations: &Equations,
    first: &State,
    sizes: &[f64],
    memory: usize,
    figures: &mut dyn FnMut(usize, &State, &mut State) -> Result<(), E>,
) -> Result<Cotangents, E> {
    let zero: State = first.iter().map(|field| vec![Complex64::default(); field.len()]).collect();
    let bytes = 4 * zero.len() * equations.transform.modes() * size_of::<Complex64>();
    let length = match sizes.len() * bytes <= memory {
        true => sizes.len().max(1),
        false => (sizes.len() as f64).sqrt().ceil() as usize,
    };
    let mut starts = vec![first.clone()];
    let last_begins = sizes.len().saturating_sub(1) / length * length;
    let mut level = (last_begins > 0).then(|| Level::new(equations, first.clone()));
    let mut decay = Decay::new(equations, 0.0);
    for (k, &size) in sizes[..last_begins].iter().enumerate() {
        decay.change(equations, size);
        if let Some(now) = level.take() {
            let next = Level::new(equations, now.step(equations, &decay).after);
            if (k + 1) % length == 0 {
                starts.push(next.state.clone());
            }
            level = Some(next);
        }
    }
    let mut found = Cotangents {
        start: zero.clone(),
        materials: OfMaterials { force: vec![0.0; equations.dimension()], ..OfMaterials::default() },
        sizes: vec![0.0; sizes.len()],
    };
    let mut bar = zero;
    for (segment, start) in starts.into_iter().enumerate().rev() {
        let from = segment * length;
        let part = &sizes[from..sizes.len().min(from + length)];
        let mut all = vec![];
        let mut now = Level::new(equations, start);
        for &size in part {
            decay.change(equations, size);
            let taken = now.step(equations, &decay);
            let [a2, a3, a4] = taken.stages;
            let next = Level::new(equations, taken.after);
            all.push(Stages([now.state, a2, a3, a4, next.state.clone()]));
            now = next;
        }
        for (k, stages) in all.into_iter().enumerate().rev() {
            figures(from + k, &stages.0[4], &mut bar)?;
            decay.change(equations, part[k]);
            found.sizes[from + k] = step_back(equations, &decay, &stages, &mut bar, &mut found.materials);
        }
    }
    equations.project(&mut bar[..equations.dimension()]);
    found.start = bar;
    Ok(found)
}

/// Turns the cotangent of the state after a step into that of the state before it; returns the derivative by the size.
fn step_back(
    equations: &Equations,
    decay: &Decay,
    Stages([u, a2, a3, a4, after]): &Stages,
    bar: &mut State,
    of: &mut OfMaterials,
) -> f64 {
    let (h, transform) = (decay.size, &equations.transform);
    let each = |make: &(dyn Fn(usize, f64, usize) -> Complex64 + Sync)| decay.fields(equations, make);
    let empty = || each(&|_, _, _| Complex64::default());
    let out = std::mem::take(bar);
    let (mut b4, mut b3, mut b2, mut b1) = (empty(), empty(), empty(), empty());
    equations.rates_back(a4, &each(&|f, _, k| h / 6.0 * out[f][k]), &mut b4, of);
    equations.rates_back(a3, &each(&|f, e, k| h * e * (out[f][k] / 3.0 + b4[f][k])), &mut b3, of);
    equations.rates_back(a2, &each(&|f, e, k| h * (e / 3.0 * out[f][k] + 0.5 * b3[f][k])), &mut b2, of);
    equations.rates_back(u, &each(&|f, e, k| h * e * (e / 6.0 * out[f][k] + 0.5 * b2[f][k])), &mut b1, of);
    *bar = each(&|f, e, k| e * (e * (out[f][k] + b4[f][k]) + b3[f][k] + b2[f][k]) + b1[f][k]);
    // Derivatives by the size: of the factors h, and of E. The terms of a stage with the rates are those without subtracted.
    let mut by_size = 0.0;
    for f in 0..u.len() {
        let e = decay.of(equations, f);
        let term = |of: &(dyn Fn(usize) -> Complex64 + Sync)| -> Spectrum { (0..transform.modes()).map(of).collect() };
        let pairs = [
            // What stands by h, and the sum of m E^m terms.
            (
                &out[f],
                term(&|k| after[f][k] - e[k] * e[k] * u[f][k]),
                term(&|k| {
                    let x1 = a2[f][k] - e[k] * u[f][k];
                    let x2 = a3[f][k] - e[k] * u[f][k];
                    let x3 = a4[f][k] - e[k] * e[k] * u[f][k];
                    e[k] * (2.0 * e[k] * u[f][k] + 2.0 / 3.0 * (x1 + x2)) + x3 / 3.0
                }),
            ),
            (&b2[f], term(&|k| a2[f][k] - e[k] * u[f][k]), a2[f].clone()),
            (&b3[f], term(&|k| a3[f][k] - e[k] * u[f][k]), term(&|k| e[k] * u[f][k])),
            (&b4[f], term(&|k| a4[f][k] - e[k] * e[k] * u[f][k]), term(&|k| a4[f][k] + e[k] * e[k] * u[f][k])),
        ];
        let mut by_exponent = 0.0;
        for (bar, with_size, with_decay) in &pairs {
            by_size += transform.product(bar, with_size, |_| 1.0) / h;
            by_exponent -= 0.5 * transform.product(bar, with_decay, |k| equations.symbols.laplacian[k]);
        }
        by_size += equations.diffusion(f) * by_exponent;
        match f < equations.dimension() {
            true => of.viscosity += h * by_exponent,
            false => of.diffusivity += h * by_exponent,
        }
    }
    by_size
}
