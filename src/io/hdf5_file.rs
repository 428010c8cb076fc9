//! Reading and writing parts of an HDF5 file, with errors that name the file and the part.

use super::FileError;
use hdf5::types::VarLenUnicode;
use hdf5::H5Type;
use std::path::Path;

const HINT: &str = "the file may come from another program or version; write it again with this one";
/// Rows per compressed chunk: large enough to compress, small enough to read a part.
const CHUNK: usize = 16_384;

/// Opens a file for reading.
///
/// # Errors
/// The file is missing, locked or not HDF5.
pub fn open(path: &Path, format: &'static str) -> Result<hdf5::File, FileError> {
    // HDF5's own message for a missing file is a page long.
    std::fs::File::open(path).map_err(|source| FileError::read(path, source))?;
    hdf5::File::open(path).map_err(|error| {
        let (path, what) = (path.to_owned(), error.to_string());
        if what.contains("unable to lock file") {
            return FileError::Locked { path };
        }
        FileError::Damaged { path, format, what, hint: "take another file, or write it again" }
    })
}

/// Maps an HDF5 failure to an error that says during what: `failed(path, "write")("position")`.
pub fn failed<'a>(
    path: &'a Path,
    action: &'a str,
) -> impl Fn(&'a str) -> Box<dyn FnOnce(hdf5::Error) -> FileError + 'a> {
    move |what| {
        Box::new(move |source| match system_error(&source.to_string()) {
            Some(error) if ["write", "create"].contains(&action) => FileError::write(path, error),
            Some(error) => FileError::read(path, error),
            None => FileError::Hdf5 { path: path.to_owned(), action: format!("{action} {what}"), source },
        })
    }
}

/// The system's error that a message of HDF5's is about (a full disk, ...), which says in some words what that says in many lines.
fn system_error(message: &str) -> Option<std::io::Error> {
    let (_, rest) = message.split_once("errno = ")?;
    let digits = rest.split(|c: char| !c.is_ascii_digit()).next()?;
    digits.parse().ok().map(std::io::Error::from_raw_os_error)
}

pub fn missing(path: &Path, kind: &'static str, name: &str, present: Vec<String>) -> FileError {
    FileError::Missing { path: path.to_owned(), kind, name: name.to_owned(), present, hint: HINT }
}

pub fn mismatch(path: &Path, name: &str, found: String, allowed: &str) -> FileError {
    FileError::Mismatch { path: path.to_owned(), name: name.to_owned(), found, allowed: allowed.to_owned(), hint: HINT }
}

pub fn write_dataset<T: H5Type>(
    path: &Path,
    group: &hdf5::Group,
    name: &str,
    shape: &[usize],
    values: &[T],
) -> Result<(), FileError> {
    let mut chunk = shape.to_vec();
    chunk[0] = chunk[0].min(CHUNK);
    write_chunked(path, group, name, shape, &chunk, values)
}

/// The same in chunks of a shape, each with a checksum. No time of writing is stored: equal values give equal bytes.
pub fn write_chunked<T: H5Type>(
    path: &Path,
    group: &hdf5::Group,
    name: &str,
    shape: &[usize],
    chunk: &[usize],
    values: &[T],
) -> Result<(), FileError> {
    let builder = group.new_dataset::<T>().shape(shape).obj_track_times(false);
    // A chunk of no particles is not allowed. Shuffle before deflate: HDF5 refuses the other order.
    let builder = if values.is_empty() { builder } else { builder.chunk(chunk).shuffle().deflate(4).fletcher32() };
    builder.create(name).and_then(|dataset| dataset.write_raw(values)).map_err(failed(path, "write")(name))
}

pub fn read_dataset<T: H5Type>(
    path: &Path,
    group: &hdf5::Group,
    present: &[String],
    name: &str,
    shape: &[usize],
) -> Result<Option<Vec<T>>, FileError> {
    if !present.iter().any(|other| other == name) {
        return Ok(None);
    }
    let dataset = group.dataset(name).map_err(failed(path, "open")(name))?;
    let found = dataset.shape();
    if found != shape {
        return Err(mismatch(path, name, format!("of shape {found:?}"), &format!("of shape {shape:?}")));
    }
    dataset.read_raw().map(Some).map_err(failed(path, "read")(name))
}

pub fn write_attribute<T: H5Type>(
    path: &Path,
    group: &hdf5::Group,
    name: &str,
    shape: &[usize],
    values: &[T],
) -> Result<(), FileError> {
    group.new_attr::<T>().shape(shape).create(name).and_then(|attribute| attribute.write_raw(values)).map_err(failed(
        path, "write",
    )(
        name
    ))
}

pub fn read_attribute<T: H5Type>(
    path: &Path,
    group: &hdf5::Group,
    name: &str,
    shape: &[usize],
) -> Result<Vec<T>, FileError> {
    let present = group.attr_names().map_err(failed(path, "read")("the list of attributes"))?;
    if !present.iter().any(|other| other == name) {
        return Err(missing(path, "attribute", name, present));
    }
    let attribute = group.attr(name).map_err(failed(path, "open")(name))?;
    let found = attribute.shape();
    if found != shape {
        return Err(mismatch(path, name, format!("of shape {found:?}"), &format!("of shape {shape:?}")));
    }
    attribute.read_raw().map_err(failed(path, "read")(name))
}

pub fn read_number<T: H5Type + Copy>(path: &Path, group: &hdf5::Group, name: &str) -> Result<T, FileError> {
    Ok(read_attribute::<T>(path, group, name, &[])?[0])
}

pub fn read_text(path: &Path, group: &hdf5::Group, name: &str) -> Result<String, FileError> {
    Ok(read_attribute::<VarLenUnicode>(path, group, name, &[])?[0].to_string())
}

pub fn write_text(path: &Path, group: &hdf5::Group, name: &str, text: &str) -> Result<(), FileError> {
    let text: VarLenUnicode = text
        .parse()
        .map_err(|_| FileError::input(path, format!("{name} holds a NUL character"), "text without NUL"))?;
    write_attribute(path, group, name, &[], &[text])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_disk_is_one_line() {
        let text = "H5F__close_cb(): can't close file: file write failed: time = Mon Nov 23 00:54:54 2026\n, filename = 'a.h5', \
                    file descriptor = 3, errno = 28, error message = 'No space left on device', buf = 0x55f0";
        let found = system_error(text).unwrap();
        assert_eq!(found.kind(), std::io::ErrorKind::StorageFull);
        assert!(system_error("no such dataset").is_none());
    }
}
