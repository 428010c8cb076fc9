//! The Python package `hydrograd`: what the library does with NumPy arrays, see the README.md here.
//!
//! This module is its compiled part, `hydrograd._native`, with as little as possible: settings come as `key=value`, numbers
//! leave as arrays. What a user sees, and what knows PyTorch and JAX, is in `package/hydrograd/`.

mod arrays;
mod errors;
mod flow;
mod parts;
mod rollout;
mod scene;
mod simulate;
mod steady;
mod watch;

use pyo3::prelude::*;

/// As in the program; without it candle's backward is 2 to 25 times as slow. Python's own objects do not use it.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// The compiled part of the package `hydrograd`.
#[pymodule]
mod _native {
    use super::errors::to_python;
    use super::watch;
    use crate::config::builtin::{PRESETS, SCENES};
    use crate::error::BadInput;
    use crate::numerics::{memory, threads};
    use pyo3::prelude::*;
    use std::ffi::OsString;

    #[pymodule_export]
    use super::errors::Diverged;
    #[pymodule_export]
    use super::flow::Flow;
    #[pymodule_export]
    use super::rollout::{read_trajectory, rollout};
    #[pymodule_export]
    use super::scene::Scene;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        memory::keep_freed();
        module.add("__version__", env!("CARGO_PKG_VERSION"))
    }

    /// Names and descriptions of the built-in scenes.
    #[pyfunction]
    fn scenes() -> Vec<(&'static str, &'static str)> {
        SCENES.iter().map(|scene| (scene.name, scene.description)).collect()
    }

    /// Names and descriptions of the presets.
    #[pyfunction]
    fn presets() -> Vec<(&'static str, &'static str)> {
        PRESETS.iter().map(|preset| (preset.name, preset.description)).collect()
    }

    /// Sets the number of worker threads.
    #[pyfunction]
    fn set_threads(threads: usize) -> PyResult<()> {
        if watch::has_begun() {
            let bad = BadInput::new("the number of threads is fixed by the first run, and there was one already")
                .allowed("set_threads before anything runs")
                .advice("a new process, or CANDLE_NUM_THREADS and RAYON_NUM_THREADS in the environment");
            return Err(to_python(bad.into()));
        }
        threads::use_threads(threads);
        Ok(())
    }

    /// Runs the command line and returns its exit code; `program` is what starts Python with it again.
    #[pyfunction]
    fn command_line(py: Python<'_>, program: Vec<OsString>, arguments: Vec<String>) -> u8 {
        use crate::cli;
        cli::program::is_started_by(program);
        cli::install_panic_hook();
        let all = std::iter::once("hydrograd".to_string()).chain(arguments);
        py.detach(|| match cli::parse(all.map(Into::into)) {
            Ok(parsed) => cli::guarded(|| cli::run(parsed)),
            Err(error) => {
                // Where stdout or stderr is closed there is nobody to tell.
                let _ = error.print();
                u8::try_from(error.exit_code()).unwrap_or(2)
            }
        })
    }
}
