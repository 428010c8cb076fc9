//! Reading arrays of NumPy's format `.npy` (versions 1 to 3): numbers of four or eight bytes in C order.

use super::FileError;
use std::path::Path;

const FORMAT: &str = ".npy file";
const HINT: &str = "write it with numpy.save of a contiguous array of float32 or float64";

/// The shape and the numbers of an array.
///
/// # Errors
/// A file that is missing, damaged, or of other numbers.
pub fn read_npy(path: &Path) -> Result<(Vec<usize>, Vec<f64>), FileError> {
    let bytes = std::fs::read(path).map_err(|source| FileError::read(path, source))?;
    let damaged =
        |what: &str| FileError::Damaged { path: path.to_owned(), format: FORMAT, what: what.into(), hint: HINT };
    let version =
        bytes.strip_prefix(b"\x93NUMPY").and_then(|rest| rest.first()).ok_or_else(|| damaged("no such file"))?;
    let (from, width): (usize, usize) = if *version == 1 { (10, 2) } else { (12, 4) };
    let length = bytes.get(8..8 + width).ok_or_else(|| damaged("its header ends early"))?;
    let length = length.iter().rev().fold(0usize, |all, byte| all << 8 | usize::from(*byte));
    let header = bytes.get(from..from.saturating_add(length)).ok_or_else(|| damaged("its header ends early"))?;
    let header = String::from_utf8_lossy(header);
    // {'descr': '<f8', 'fortran_order': False, 'shape': (64, 64, 2), }
    let value = |key: &str| {
        let rest = header.split_once(&format!("'{key}':"))?.1.trim_start();
        let end = if rest.starts_with('(') { rest.find(')')? } else { rest.find([',', '}'])? };
        Some(rest[..end].trim_matches(['(', '\'', ' ']).to_string())
    };
    let (Some(kind), Some(order), Some(shape)) = (value("descr"), value("fortran_order"), value("shape")) else {
        return Err(damaged("its header has no descr, fortran_order and shape"));
    };
    if order != "False" || !["<f4", "<f8"].contains(&kind.as_str()) {
        return Err(damaged(&format!("numbers of kind {kind}, fortran_order {order}")));
    }
    let parts = shape.split(',').map(str::trim).filter(|part| !part.is_empty());
    let shape: Vec<usize> =
        parts.map(str::parse).collect::<Result<_, _>>().map_err(|_| damaged("its shape is not numbers"))?;
    let data = &bytes[from + length..];
    let size = if kind == "<f4" { 4 } else { 8 };
    let count = shape.iter().try_fold(size, |all: usize, n| all.checked_mul(*n));
    if count != Some(data.len()) {
        return Err(damaged(&format!("{} bytes of numbers for the shape {shape:?}", data.len())));
    }
    let numbers = match size {
        4 => data.chunks_exact(4).map(|b| f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect(),
        _ => data.chunks_exact(8).map(|b| f64::from_le_bytes(std::array::from_fn(|k| b[k]))).collect(),
    };
    Ok((shape, numbers))
}
