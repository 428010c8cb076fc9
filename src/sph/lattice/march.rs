//! Steps of a flow on a periodic lattice.
//!
//! Viscosity and conduction are integrated exactly, by E = exp(-nu K h / 2), and the rest by Runge and Kutta's method of
//! fourth order between them (Lawson 1967, SIAM Journal on Numerical Analysis 4, 372). With the rates N,
//!
//! ```text
//!   k1 = N(u),  k2 = N(a2),  k3 = N(a3),  k4 = N(a4)
//!   a2 = E (u + h k1 / 2),   a3 = E u + h k2 / 2,   a4 = E (E u + h k3)
//!   u' = E^2 u + h (E^2 k1 + 2 E k2 + 2 E k3 + k4) / 6,   k5 = N(u') is k1 of the next step.
//! ```
//!
//! The result of third order with the same rates differs from u' by h (k4 - k5) / 10, which is the estimated error (Balac
//! and Mahe 2013, Computer Physics Communications 184, 1211). Steps are parts of the run whose sizes are those of a
//! geometric series, so that flows that differ little take the same ones.

use super::equations::{Equations, State};
use super::transform::Spectrum;
use num_complex::Complex64;
use thiserror::Error;

/// Ratio of two sizes that follow each other.
const RATIO: f64 = 1.189_207_115_002_721; // 2^(1/4)
/// The largest step in spacings that the fluid goes; from 0.9 on steps are unstable.
const COURANT: f64 = 0.8;
/// How much larger a step may be than the last one, in sizes of the series.
const GROWTH: i32 = 4;
/// Sizes in a row that may be refused.
const REFUSED: usize = 60;

/// Why a flow does not go on.
#[derive(Debug, Clone, Copy, PartialEq, Error)]
pub enum Diverged {
    #[error("the flow is not finite at t = {time}")]
    NotFinite { time: f64 },
    #[error("steps become ever shorter at t = {time} (the last one: {size})")]
    NoStep { time: f64, size: f64 },
}

/// How steps are chosen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Control {
    /// The error of a step, root mean square, over `velocity` or `temperature`.
    pub tolerance: f64,
    pub velocity: f64,
    pub temperature: f64,
    /// A size for all steps instead.
    pub fixed: Option<f64>,
}

/// A state between two steps.
#[derive(Debug, Clone)]
pub struct Level {
    pub state: State,
    /// Its rates.
    pub rates: State,
    /// The largest sum over directions of the speed at a particle.
    pub speed: f64,
}

/// The factors E of steps of a size, of the velocity and of the temperature.
#[derive(Debug, Clone)]
pub struct Decay {
    pub size: f64,
    of: Vec<Vec<f64>>,
}

impl Decay {
    pub fn new(equations: &Equations, size: f64) -> Self {
        let of = |diffusion: f64| {
            let symbol = equations.symbols.laplacian.iter();
            symbol.map(|k| (-0.5 * size * diffusion * k).exp()).collect()
        };
        let all = std::iter::once(equations.materials.viscosity).chain(equations.materials.diffusivity);
        Self { size, of: all.map(of).collect() }
    }

    /// Those of another size.
    pub fn change(&mut self, equations: &Equations, size: f64) {
        if self.size != size {
            *self = Self::new(equations, size);
        }
    }

    /// The spectra that `of` makes of each field, E and mode.
    pub fn fields(&self, equations: &Equations, of: impl Fn(usize, f64, usize) -> Complex64 + Sync) -> State {
        equations.transform.each(equations.fields(), |f| {
            self.of(equations, f).iter().enumerate().map(|(k, e)| of(f, *e, k)).collect::<Spectrum>()
        })
    }

    /// E of a field.
    pub fn of(&self, equations: &Equations, field: usize) -> &[f64] {
        &self.of[usize::from(field >= equations.dimension())]
    }
}

/// A step's stages a2, a3 and a4, the state after it, and k4.
pub struct Taken {
    pub stages: [State; 3],
    pub after: State,
    last: State,
}

impl Level {
    pub fn new(equations: &Equations, state: State) -> Self {
        let (rates, speed) = equations.rates(&state);
        Self { state, rates, speed }
    }

    /// A step.
    pub fn step(&self, equations: &Equations, decay: &Decay) -> Taken {
        let (h, u, k1) = (decay.size, &self.state, &self.rates);
        let a2 = decay.fields(equations, |f, e, k| e * (u[f][k] + 0.5 * h * k1[f][k]));
        let (k2, _) = equations.rates(&a2);
        let a3 = decay.fields(equations, |f, e, k| e * u[f][k] + 0.5 * h * k2[f][k]);
        let (k3, _) = equations.rates(&a3);
        let a4 = decay.fields(equations, |f, e, k| e * (e * u[f][k] + h * k3[f][k]));
        let (k4, _) = equations.rates(&a4);
        let after = decay.fields(equations, |f, e, k| {
            let outer = e * (e * (u[f][k] + h / 6.0 * k1[f][k]) + h / 3.0 * (k2[f][k] + k3[f][k]));
            outer + h / 6.0 * k4[f][k]
        });
        Taken { stages: [a2, a3, a4], after, last: k4 }
    }
}

/// The error of a step over the tolerance.
fn error(equations: &Equations, control: &Control, size: f64, last: &[Spectrum], next: &[Spectrum]) -> f64 {
    let d = equations.dimension();
    let left = |f: usize| -> Spectrum { last[f].iter().zip(&next[f]).map(|(a, b)| (a - b) * (0.1 * size)).collect() };
    let left: Vec<Spectrum> = (0..last.len()).map(left).collect();
    let of = |part: &[Spectrum], scale: f64| equations.mean_square(part, |_| 1.0).sqrt() / scale;
    let heat = if left.len() > d { of(&left[d..], control.temperature) } else { 0.0 };
    of(&left[..d], control.velocity).max(heat) / control.tolerance
}

/// The largest step by how far the fluid goes, given the largest sum over directions of the speed at a particle.
pub fn largest_step(equations: &Equations, speed: f64) -> f64 {
    COURANT * equations.dx / speed.max(f64::MIN_POSITIVE)
}

/// The state after steps of given sizes.
pub fn repeat(equations: &Equations, first: State, sizes: &[f64]) -> State {
    let (mut level, mut decay) = (Level::new(equations, first), Decay::new(equations, 0.0));
    for &size in sizes {
        decay.change(equations, size);
        level = Level::new(equations, level.step(equations, &decay).after);
    }
    level.state
}

/// Goes on from `first` through the times of `stops`, in order; `watch` gets the time, the state and the size of each step
/// taken, and may end the run. Returns the sizes.
///
/// # Errors
/// A flow that diverges, and those of `watch`.
pub fn run<E: From<Diverged>>(
    equations: &Equations,
    first: State,
    stops: &[f64],
    control: &Control,
    watch: &mut dyn FnMut(f64, &State) -> Result<(), E>,
) -> Result<Vec<f64>, E> {
    let Some(&end) = stops.last() else { return Ok(vec![]) };
    let (mut time, mut sizes, mut refused) = (0.0, vec![], 0);
    let mut level = Level::new(equations, first);
    let number_of = |most: f64| ((end / most).ln() / RATIO.ln()).ceil().max(0.0) as i32;
    let courant = |speed: f64| largest_step(equations, speed);
    let mut number = number_of(courant(level.speed));
    // The size, and how many steps of it are left to the next stop.
    let mut plan: Option<(f64, usize)> = None;
    let mut decay = Decay::new(equations, 0.0);
    let mut stop = 0;
    while stop < stops.len() {
        let (size, left) = *plan.get_or_insert_with(|| {
            let most = control.fixed.unwrap_or_else(|| end * RATIO.powi(-number));
            let left = ((stops[stop] - time) / most * (1.0 - 1e-9)).ceil().max(1.0);
            ((stops[stop] - time) / left, left as usize)
        });
        decay.change(equations, size);
        let Taken { after, last, .. } = level.step(equations, &decay);
        let next = Level::new(equations, after);
        let error = error(equations, control, size, &last, &next.rates);
        if control.fixed.is_none() && !(error <= 1.0 && size <= 1.5 * courant(next.speed)) {
            refused += 1;
            if refused > REFUSED {
                return Err(Diverged::NoStep { time, size }.into());
            }
            let smaller = if error.is_finite() { (error.log2().ceil() as i32).clamp(1, 2 * GROWTH) } else { GROWTH };
            number = number_of(size * (1.0 + 1e-9)).max(number) + smaller;
            plan = None;
            continue;
        }
        if !error.is_finite() {
            return Err(Diverged::NotFinite { time }.into());
        }
        (level, refused) = (next, 0);
        sizes.push(size);
        plan = if left > 1 { Some((size, left - 1)) } else { None };
        time = if left > 1 { time + size } else { stops[stop] };
        stop += usize::from(left == 1);
        watch(time, &level.state)?;
        // The error of a step goes with the fourth power of its size: a factor of 2 for each number of the series.
        let least = number_of(courant(level.speed));
        let wanted = (number - ((-error.max(1e-9).log2() - 0.6).floor() as i32).clamp(-1, GROWTH)).max(least);
        if control.fixed.is_none() && wanted != number {
            (number, plan) = (wanted, None);
        }
    }
    Ok(sizes)
}
