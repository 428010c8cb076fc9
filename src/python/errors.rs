//! Errors as Python's: a wrong configuration is a `ValueError`, a run that diverged a `Diverged`, all others `RuntimeError`.

use crate::error::{BadInput, Error, Offence};
use pyo3::create_exception;
use pyo3::exceptions::{PyKeyboardInterrupt, PyRuntimeError, PyValueError};
use pyo3::prelude::*;

create_exception!(
    hydrograd,
    Diverged,
    PyRuntimeError,
    "A run whose numbers left all bounds: its input is not one to use, but another may be.\n\n\
     ``step``, ``particle``, ``position``, ``quantity`` and ``value`` say where that was found, or are None."
);

/// An error as Python's, with the whole message.
pub fn to_python(error: anyhow::Error) -> PyErr {
    let mut message = error.to_string();
    for cause in error.chain().skip(1) {
        message.push_str(&format!("\n  cause: {cause}"));
    }
    let of_kind = || error.chain().find_map(|cause| cause.downcast_ref::<Error>());
    if error.chain().any(|cause| cause.is::<BadInput>()) {
        return PyValueError::new_err(message);
    }
    match of_kind() {
        Some(Error::Input(_)) => PyValueError::new_err(message),
        Some(Error::Stopped) => PyKeyboardInterrupt::new_err(message),
        Some(Error::Diverged { offence, .. }) => diverged(message, offence.as_deref()),
        _ => PyRuntimeError::new_err(message),
    }
}

fn diverged(message: String, offence: Option<&Offence>) -> PyErr {
    let error = Diverged::new_err(message);
    let described = Python::attach(|py| -> PyResult<()> {
        let value = error.value(py);
        value.setattr("step", offence.map(|found| found.step))?;
        value.setattr("particle", offence.map(|found| found.particle))?;
        value.setattr("position", offence.map(|found| found.position.clone()))?;
        value.setattr("quantity", offence.map(|found| found.quantity.clone()))?;
        value.setattr("value", offence.map(|found| found.value))
    });
    described.map_or_else(|other| other, |()| error)
}
