//! Fields on grids: a velocity to begin with, and what a flow is at its end (`grid.h5`, `grid.vti`).

use super::hdf5_file::{failed, mismatch, missing, open, write_dataset, write_file};
use super::npy::read_npy;
use super::vtk::{write_image, Image};
use super::FileError;
use std::path::Path;

/// Points along each of `d` axes and the components `[D][points]` of the velocity in an HDF5 or NumPy file, whose shape is `[points.., D]`.
/// `wanted`: how many points there must be.
///
/// # Errors
/// Files that cannot be read; another shape.
pub fn read_velocity(
    path: &Path,
    d: usize,
    wanted: Option<&[usize]>,
) -> Result<(Vec<usize>, Vec<Vec<f64>>), FileError> {
    const NAME: &str = "velocity";
    let (found, numbers) = if path.extension().is_some_and(|extension| extension == "npy") {
        read_npy(path)?
    } else {
        let file = open(path, "HDF5 file")?;
        let present = file.member_names().map_err(failed(path, "read")("the list of datasets"))?;
        if !present.iter().any(|name| name == NAME) {
            return Err(missing(path, "dataset", NAME, present));
        }
        let dataset = file.dataset(NAME).map_err(failed(path, "open")(NAME))?;
        (dataset.shape(), dataset.read_raw::<f64>().map_err(failed(path, "read")(NAME))?)
    };
    let allowed = match wanted {
        Some(wanted) => format!("of shape {:?}, by region.size over resolution.dx", [wanted, &[d]].concat()),
        None => format!("of shape [{}{d}]", "N, ".repeat(d)),
    };
    if found.len() != d + 1 || found[d] != d || wanted.is_some_and(|wanted| found[..d] != *wanted) {
        return Err(mismatch(path, NAME, format!("of shape {found:?}"), &allowed));
    }
    let components = (0..d).map(|a| numbers.iter().skip(a).step_by(d).copied().collect()).collect();
    Ok((found[..d].to_vec(), components))
}

/// Writes `grid.h5` and `grid.vti` into a folder.
///
/// # Errors
/// HDF5's and the system's.
pub fn write_grid(folder: &Path, grid: &Image) -> Result<(), FileError> {
    let path = folder.join("grid.h5");
    let points = grid.velocity[0].len();
    let joined: Vec<f64> = (0..points).flat_map(|i| grid.velocity.iter().map(move |field| field[i])).collect();
    write_file(&path, |file| {
        let shape = [grid.shape, &[grid.shape.len()]].concat();
        write_dataset(&path, file, "velocity", &shape, &joined)?;
        grid.scalars.iter().try_for_each(|(name, values)| write_dataset(&path, file, name, grid.shape, values))
    })?;
    write_image(&folder.join("grid.vti"), grid)
}
