//! Incompressible flow in a periodic box from fields on the lattice of its particles: runs, and their exact derivative.

use crate::config::method::fixed::Derivatives;
use crate::error::{BadInput, Error};
use crate::numerics::interrupt;
use crate::sph::lattice::adjoint::{pull_back, MEMORY};
use crate::sph::lattice::equations::{Equations, Materials, OfMaterials, State};
use crate::sph::lattice::march::{run, Control, Diverged};

/// Particles along an axis, at least. (Fits reach two to either side.)
const FEWEST: usize = 5;
/// Particles in the box, at most.
const MOST: usize = 1 << 28;

/// Flow in a periodic box.
#[derive(Debug, Clone)]
pub struct PeriodicFlow {
    pub equations: Equations,
}

/// A flow that has gone on to its end. Its steps are those of the derivative.
#[derive(Debug, Clone)]
pub struct Gone {
    pub first: State,
    pub last: State,
    pub sizes: Vec<f64>,
}

/// The derivative of an objective by all that a flow depends on.
#[derive(Debug, Clone, PartialEq)]
pub struct Gradient {
    /// By the fields at the start, `[D]` components of the velocity and the temperature, `[N]` each.
    pub fields: Vec<Vec<f64>>,
    pub materials: OfMaterials,
    /// By the duration, all of whose steps grow alike.
    pub time: f64,
}

impl PeriodicFlow {
    /// Particles on a lattice `shape` in a box of `size`.
    ///
    /// # Errors
    /// Lattices and numbers that cannot be.
    pub fn new(
        shape: &[usize],
        size: &[f64],
        materials: Materials,
        derivatives: Derivatives,
    ) -> Result<Self, BadInput> {
        let bad = |problem: String, allowed: &str| Err(BadInput::new(problem).allowed(allowed));
        let d = shape.len();
        if !(2..=3).contains(&d) || size.len() != d {
            return bad(format!("a lattice {shape:?} in a box {size:?}"), "two or three dimensions");
        }
        if shape.iter().any(|&n| n < FEWEST)
            || shape.iter().try_fold(1, |all: usize, &n| all.checked_mul(n)) > Some(MOST)
        {
            return bad(format!("a lattice {shape:?}"), "5 particles or more along each axis, 2^28 in all");
        }
        let spacing: Vec<f64> = size.iter().zip(shape).map(|(l, &n)| l / n as f64).collect();
        if !spacing.iter().all(|dx| *dx > 0.0 && dx.is_finite() && (dx / spacing[0] - 1.0).abs() < 1e-9) {
            return bad(format!("a lattice {shape:?} in a box {size:?}"), "the same spacing, above 0, along all axes");
        }
        let Materials { viscosity, diffusivity, force, .. } = &materials;
        for (name, value) in [("viscosity", Some(viscosity)), ("diffusivity", diffusivity.as_ref())] {
            if let Some(value) = value.filter(|value| !(**value >= 0.0 && value.is_finite())) {
                return bad(format!("{name} = {value}"), "a finite number, 0 or more");
            }
        }
        if force.len() != d || force.iter().any(|x| !x.is_finite()) {
            return bad(format!("force = {force:?}"), "a finite number for each dimension");
        }
        Ok(Self { equations: Equations::new(shape, size, materials, derivatives) })
    }

    /// Scales of velocity and temperature that errors are measured by: what the fields at the start are, and what forces
    /// make of them.
    pub fn scales(&self, fields: &[Vec<f64>], end: f64) -> (f64, f64) {
        let d = self.equations.dimension();
        let Materials { force, buoyancy, .. } = &self.equations.materials;
        let mean = |x: &[f64]| x.iter().sum::<f64>() / x.len() as f64;
        let deviation =
            |x: &[f64]| (mean(&x.iter().map(|x| x * x).collect::<Vec<f64>>()) - mean(x).powi(2)).max(0.0).sqrt();
        let square = |x: &Vec<f64>| x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64;
        let norm = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
        let warmth = fields.get(d).map_or(0.0, |t| deviation(t));
        let lift = buoyancy.as_ref().map_or(0.0, |buoyancy| norm(&buoyancy.by) * warmth);
        let speed = fields[..d].iter().map(square).sum::<f64>().sqrt();
        // Over the time, or a fall through the box.
        let length = self.equations.dx * self.equations.transform.shape.iter().copied().max().unwrap_or(1) as f64;
        let made = |acceleration: f64| (end * acceleration).min((2.0 * acceleration * length).sqrt());
        let velocity = speed + made(norm(force) + lift);
        let or_one = |x: f64| if x > 0.0 { x } else { 1.0 };
        (or_one(velocity), or_one(warmth))
    }

    /// Goes on from `fields`, `[D]` components of the velocity and the temperature, through the times of `stops`, which are
    /// increasing and end with the last one. `watch` gets the time and the state after each step.
    ///
    /// # Errors
    /// Fields that do not fit, a flow that diverges; [`Error::Stopped`].
    pub fn run(
        &self,
        fields: &[Vec<f64>],
        stops: &[f64],
        control: &Control,
        watch: &mut dyn FnMut(f64, &State) -> Result<(), Error>,
    ) -> Result<Gone, Error> {
        let (count, points) = (self.equations.fields(), self.equations.transform.points());
        if fields.len() != count || fields.iter().any(|field| field.len() != points) {
            let lengths: Vec<usize> = fields.iter().map(Vec::len).collect();
            let bad = BadInput::new(format!("fields of {lengths:?} numbers"));
            return Err(bad.allowed(format!("{count} fields of {points} numbers")).into());
        }
        if let Some(wrong) = fields.iter().flatten().find(|x| !x.is_finite()) {
            return Err(BadInput::new(format!("{wrong} in the field at the start")).allowed("finite numbers").into());
        }
        let first = self.equations.state(fields);
        let mut last = first.clone();
        let mut seen = |time: f64, state: &State| -> Result<(), Failure> {
            interrupt::check().map_err(Failure::Other)?;
            watch(time, state).map_err(Failure::Other)?;
            last.clone_from(state);
            Ok(())
        };
        let sizes =
            run(&self.equations, first.clone(), stops, control, &mut seen).map_err(|failure| match failure {
                Failure::Flow(why) => {
                    Error::diverged(why.to_string(), "a smaller time.step, or a finer lattice".to_string())
                }
                Failure::Other(error) => error,
            })?;
        Ok(Gone { first, last, sizes })
    }

    /// The derivative of an objective, given that by the fields at the end.
    ///
    /// # Errors
    /// [`Error::Stopped`].
    pub fn gradient(&self, gone: &Gone, by_fields: &[Vec<f64>]) -> Result<Gradient, Error> {
        let transform = &self.equations.transform;
        let end: State = transform.each(by_fields.len(), |f| transform.forwards(by_fields[f].clone()));
        let steps = gone.sizes.len();
        let mut figures = |k: usize, _: &State, bar: &mut State| {
            interrupt::check()?;
            if k + 1 == steps {
                bar.clone_from(&end);
            }
            Ok::<(), Error>(())
        };
        let mut found = pull_back(&self.equations, &gone.first, &gone.sizes, MEMORY, &mut figures)?;
        if steps == 0 {
            // Nothing but the projection at the start.
            found.start = end;
            self.equations.project(&mut found.start[..self.equations.dimension()]);
        }
        let end: f64 = gone.sizes.iter().sum();
        let by_sizes = found.sizes.iter().zip(&gone.sizes).map(|(by, size)| by * size).sum::<f64>();
        Ok(Gradient {
            fields: self.equations.at_particles(&found.start),
            materials: found.materials,
            time: if end > 0.0 { by_sizes / end } else { 0.0 },
        })
    }
}

/// Why a run ended early.
enum Failure {
    Flow(Diverged),
    Other(Error),
}

impl From<Diverged> for Failure {
    fn from(why: Diverged) -> Self {
        Self::Flow(why)
    }
}
