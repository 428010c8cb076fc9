//! Flow in a periodic box from a velocity field to a velocity field, as Python has it.

use super::arrays::shaped_as;
use super::errors::to_python;
use super::watch::watched;
use crate::config::method::fixed::Derivatives;
use crate::error::BadInput;
use crate::scene::periodic_flow::{Gone, PeriodicFlow};
use crate::sph::lattice::equations::Materials;
use crate::sph::lattice::march::Control;
use crate::sph::laws::buoyancy::Buoyancy;
use numpy::{PyReadonlyArrayDyn, PyUntypedArrayMethods};
use pyo3::prelude::*;
use pyo3::types::PyDict;

/// A flow that has gone on to its end: see ``hydrograd.Flow``.
#[pyclass(module = "hydrograd._native", frozen)]
pub struct Flow {
    flow: PeriodicFlow,
    gone: Gone,
}

/// `[points * D]` with the component last, as `[D][points]`.
pub fn components(values: &[f64], d: usize) -> Vec<Vec<f64>> {
    (0..d).map(|a| values[a..].iter().step_by(d).copied().collect()).collect()
}

/// The reverse.
fn joined(fields: &[Vec<f64>]) -> Vec<f64> {
    (0..fields[0].len()).flat_map(|i| fields.iter().map(move |field| field[i])).collect()
}

/// The numbers of an array in C order.
pub fn numbers(array: &PyReadonlyArrayDyn<'_, f64>) -> Vec<f64> {
    array.as_slice().map_or_else(|_| array.as_array().iter().copied().collect(), <[f64]>::to_vec)
}

fn bad(problem: String, allowed: &str) -> PyErr {
    to_python(BadInput::new(problem).allowed(allowed).into())
}

#[pymethods]
impl Flow {
    /// Velocity `[N, N, 2]` or `[N, N, N, 3]`, temperature `[N, N(, N)]`.
    #[new]
    #[pyo3(signature = (velocity, temperature, size, time, numbers_of, force, buoyancy, fits))]
    #[allow(clippy::too_many_arguments)]
    fn new(
        py: Python<'_>,
        velocity: PyReadonlyArrayDyn<'_, f64>,
        temperature: Option<PyReadonlyArrayDyn<'_, f64>>,
        size: Vec<f64>,
        time: f64,
        numbers_of: [f64; 4],
        force: Vec<f64>,
        buoyancy: Option<(Vec<f64>, f64)>,
        fits: bool,
    ) -> PyResult<Self> {
        let [viscosity, diffusivity, tolerance, step] = numbers_of;
        let shape = velocity.shape();
        let d = shape.len().saturating_sub(1);
        if !(2..=3).contains(&d) || shape[d] != d {
            return Err(bad(format!("velocity of shape {shape:?}"), "[N, N, 2] or [N, N, N, 3]"));
        }
        let mut fields = components(&numbers(&velocity), d);
        if let Some(temperature) = &temperature {
            if temperature.shape() != &shape[..d] {
                return Err(bad(
                    format!("temperature of shape {:?}", temperature.shape()),
                    "the velocity's without its last",
                ));
            }
            fields.push(numbers(temperature));
        }
        if !(time >= 0.0 && time.is_finite()) {
            return Err(bad(format!("time = {time}"), "a finite number, 0 or more"));
        }
        if !(tolerance > 0.0 && tolerance < 1.0) {
            return Err(bad(format!("tolerance = {tolerance}"), "above 0 and below 1"));
        }
        if !(step >= 0.0 && step.is_finite()) {
            return Err(bad(format!("step = {step}"), "a finite number above 0, or None"));
        }
        let buoyancy = match buoyancy {
            Some((by, _)) if by.len() != d => {
                return Err(bad(format!("buoyancy with {} components", by.len()), "a number for each dimension"));
            }
            Some((by, at)) => {
                Some(Buoyancy { by: std::array::from_fn(|a| by.get(a).copied().unwrap_or_default()), at })
            }
            None => None,
        };
        let materials =
            Materials { viscosity, diffusivity: temperature.is_some().then_some(diffusivity), force, buoyancy };
        let derivatives = if fits { Derivatives::Fits } else { Derivatives::Spectral };
        let flow = PeriodicFlow::new(&shape[..d], &size, materials, derivatives);
        let flow = flow.map_err(|bad| to_python(bad.into()))?;
        let gone = watched(py, None, |_| {
            let (velocity, temperature) = flow.scales(&fields, time);
            let control = Control { tolerance, velocity, temperature, fixed: (step > 0.0).then_some(step) };
            let stops = if time > 0.0 { vec![time] } else { vec![] };
            Ok(flow.run(&fields, &stops, &control, &mut |_, _| Ok(()))?)
        })?;
        Ok(Self { flow, gone })
    }

    /// The fields at the end, and the sizes of steps.
    fn end<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let equations = &self.flow.equations;
        let (shape, d) = (&equations.transform.shape, equations.dimension());
        let (fields, pressure) =
            py.detach(|| (equations.at_particles(&self.gone.last), equations.pressure(&self.gone.last)));
        let all = PyDict::new(py);
        all.set_item("velocity", shaped_as(py, joined(&fields[..d]), &[shape.as_slice(), &[d]].concat())?)?;
        all.set_item("pressure", shaped_as(py, pressure, shape)?)?;
        let temperature = fields.get(d).map(|t| shaped_as(py, t.clone(), shape)).transpose()?;
        all.set_item("temperature", temperature)?;
        all.set_item("sizes", shaped_as(py, self.gone.sizes.clone(), &[self.gone.sizes.len()])?)?;
        Ok(all)
    }

    /// The derivative of an objective, given that by the velocity and the temperature at the end.
    fn vjp<'py>(
        &self,
        py: Python<'py>,
        velocity: PyReadonlyArrayDyn<'_, f64>,
        temperature: Option<PyReadonlyArrayDyn<'_, f64>>,
    ) -> PyResult<Bound<'py, PyDict>> {
        let equations = &self.flow.equations;
        let (shape, d) = (&equations.transform.shape, equations.dimension());
        let whole = [shape.as_slice(), &[d]].concat();
        if velocity.shape() != whole {
            return Err(bad(
                format!("velocity of shape {:?}", velocity.shape()),
                &format!("that of the flow, {whole:?}"),
            ));
        }
        let mut by_fields = components(&numbers(&velocity), d);
        match (&temperature, equations.fields() > d) {
            (Some(given), true) if given.shape() == shape => by_fields.push(numbers(given)),
            (None, true) => by_fields.push(vec![0.0; equations.transform.points()]),
            (None, false) => {}
            (Some(given), _) => {
                let problem = format!("temperature of shape {:?}", given.shape());
                return Err(bad(problem, "that of the flow's temperature, and none without heat"));
            }
        }
        let found = watched(py, None, |_| Ok(self.flow.gradient(&self.gone, &by_fields)?))?;
        let all = PyDict::new(py);
        all.set_item("velocity", shaped_as(py, joined(&found.fields[..d]), &whole)?)?;
        let by_temperature = found.fields.get(d).map(|t| shaped_as(py, t.clone(), shape)).transpose()?;
        all.set_item("temperature", by_temperature)?;
        all.set_item("viscosity", found.materials.viscosity)?;
        all.set_item("diffusivity", found.materials.diffusivity)?;
        all.set_item("force", shaped_as(py, found.materials.force, &[d])?)?;
        all.set_item("time", found.time)?;
        Ok(all)
    }
}
