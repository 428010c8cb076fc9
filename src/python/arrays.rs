//! Numbers as NumPy arrays, without a copy: the array takes the memory over.

use numpy::ndarray::{IntoDimension, IxDyn};
use numpy::{Element, PyArray1, PyArrayMethods};
use pyo3::prelude::*;

/// `[n]`.
pub fn vector<'py, T: Element>(py: Python<'py>, values: Vec<T>) -> Bound<'py, PyAny> {
    PyArray1::from_vec(py, values).into_any()
}

/// `[n, d]` of numbers that lie as `[d, n]`: a view with other strides.
pub fn columns<'py>(py: Python<'py>, values: Vec<f64>, d: usize) -> PyResult<Bound<'py, PyAny>> {
    let n = values.len() / d;
    PyArray1::from_vec(py, values).reshape([d, n])?.into_any().getattr("T")
}

/// `[t, n, d]` of numbers that lie as `[t, d, n]`.
pub fn frames_of_columns<'py>(py: Python<'py>, values: Vec<f64>, t: usize, d: usize) -> PyResult<Bound<'py, PyAny>> {
    let n = values.len() / (t * d).max(1);
    PyArray1::from_vec(py, values).reshape([t, d, n])?.into_any().call_method1("swapaxes", (1, 2))
}

/// An array of numbers that lie as it has them.
pub fn shaped<T: Element>(py: Python<'_>, values: Vec<T>, shape: impl IntoDimension) -> PyResult<Bound<'_, PyAny>> {
    Ok(PyArray1::from_vec(py, values).reshape(shape)?.into_any())
}

/// The same of a shape whose number of dimensions is not known before.
pub fn shaped_as<'py>(py: Python<'py>, values: Vec<f64>, shape: &[usize]) -> PyResult<Bound<'py, PyAny>> {
    shaped(py, values, IxDyn(shape))
}
