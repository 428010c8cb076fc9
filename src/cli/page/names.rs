//! Names of keys and units of their values on a page.

use crate::report::page::{short, Cell};
use crate::report::text::{bytes, counted};
use crate::scene::record::FIGURES;

/// Keys whose names are other words than their own.
const NAMES: [(&str, &str); 26] = [
    ("exact_kinetic_energy", "kinetic energy, exact"),
    ("e_kin", "kinetic energy, squared error"),
    ("velocity_error", "velocity error, relative"),
    ("temperature_error", "temperature error, relative"),
    ("nusselt", "Nusselt number"),
    ("wall_seconds", "seconds"),
    ("seconds_f32", "seconds in f32"),
    ("peak_memory_bytes", "peak memory"),
    ("predicted_memory_bytes", "predicted memory"),
    ("q_first", "Q of the first design"),
    ("q_sum", "Q, sum over the targets"),
    ("error_f32", "error in f32"),
    ("mse", "position MSE over all steps"),
    ("mae", "position error, mean absolute"),
    ("sinkhorn", "Sinkhorn divergence"),
    ("sinkhorn_failures", "Sinkhorn failures"),
    ("temperature_mse", "temperature MSE"),
    ("outflow_error", "outflow, relative error"),
    ("ms_per_step_median", "ms per step, median"),
    ("ns_per_particle_step", "ns per particle and step"),
    ("adjoint_over_forward", "adjoint / forward"),
    ("dx", "spacing"),
    ("cfl", "CFL number"),
    ("resumed_from", "went on from step"),
    ("reynolds", "Reynolds number"),
    ("data", "data set"),
];

/// The name of a key. A figure has its own name, and one of a nested object is prefixed by the object's.
pub fn label(key: &str) -> String {
    let known = FIGURES.iter().chain(&NAMES).find(|(name, _)| *name == key);
    if let Some((_, label)) = known {
        return label.to_string();
    }
    if let Some((of, steps)) = key.rsplit_once("mse_") {
        if let ("" | "best_", Ok(steps)) = (of, steps.parse::<usize>()) {
            let least = if of.is_empty() { "" } else { "least " };
            return format!("{least}position MSE over {}", counted(steps, "step"));
        }
    }
    for mark in [": ", "."] {
        if let Some((of, rest)) = key.split_once(mark) {
            return format!("{}: {}", of.replace('_', " "), label(rest));
        }
    }
    key.replace('_', " ")
}

/// The cell of a key; bytes are converted to a suitable unit.
pub fn sized(key: &str, cell: Cell) -> Cell {
    match cell.number_shown() {
        Some(size) if key.ends_with("_bytes") => Cell { text: bytes(size as usize), ..cell },
        _ => cell,
    }
}

/// A cell with a limited number of significant digits, except for whole numbers.
pub fn rounded(cell: Cell, digits: usize) -> Cell {
    match cell.number_shown() {
        Some(value) if value.fract() != 0.0 && value.is_finite() => {
            let text = match value.abs() {
                size if size >= 10f64.powi(digits as i32) => format!("{value:.0}"),
                size if size < 1e-4 => format!("{value:.0$e}", digits.saturating_sub(1)),
                _ => short(format!("{value:.0$e}", digits.saturating_sub(1)).parse().unwrap_or(value)),
            };
            Cell { text, ..cell }
        }
        _ => cell,
    }
}
