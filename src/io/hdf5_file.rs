//! Reading and writing HDF5 files and parts of them, with errors that name the file and the part.
//!
//! A file of ours begins with a user block, 512 bytes that are not HDF5's, with the number of bytes and the CRC-32C of all that
//! follows. It is verified before HDF5 sees the file: HDF5 believes what damaged bytes say of sizes and places. (Its own
//! checksums guard numbers only, in the format that gives equal bytes for equal contents.) Readers of HDF5 skip the block;
//! one that does not begin as ours does is not looked at.

use super::atomic::write_path_atomically;
use super::FileError;
use hdf5::types::VarLenUnicode;
use hdf5::H5Type;
use hdf5_sys::h5f::H5Fget_vfd_handle;
use hdf5_sys::h5p::H5P_DEFAULT;
use std::fs;
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::Path;

/// Bytes of the user block; the smallest that HDF5 knows.
const BLOCK: usize = 512;
/// What it begins with.
const MARK: &str = "hydrograd: HDF5 from byte 512 on\n";
const HINT: &str = "the file may come from another program or version; write it again with this one";
/// Rows per compressed chunk: large enough to compress, small enough to read a part.
const CHUNK: usize = 16_384;

/// Opens a file for reading.
///
/// # Errors
/// The file is missing, locked, not HDF5, or one of ours with other bytes than were written.
pub fn open(path: &Path, format: &'static str) -> Result<hdf5::File, FileError> {
    // HDF5's own message for a missing file is a page long.
    let whole = verify(path).map_err(|source| FileError::read(path, source))?;
    if let Some(what) = whole {
        return Err(FileError::Damaged {
            path: path.to_owned(),
            format,
            what,
            hint: "take another file, or write it again (one changed on purpose is read if its first byte is made another)",
        });
    }
    hdf5::File::open(path).map_err(|error| {
        let (path, what) = (path.to_owned(), error.to_string());
        if what.contains("unable to lock file") {
            return FileError::Locked { path };
        }
        FileError::Damaged { path, format, what, hint: "take another file, or write it again" }
    })
}

/// Writes a file atomically, and its user block.
///
/// # Errors
/// What `write` returns; HDF5's and the system's errors. No file is left then, and an old one is as it was.
pub fn write_file(path: &Path, write: impl FnOnce(&hdf5::File) -> Result<(), FileError>) -> Result<(), FileError> {
    write_path_atomically(path, |temporary| {
        let file = hdf5::File::with_options()
            .with_fcpl(|properties| properties.userblock(BLOCK as u64))
            .create(temporary)
            .map_err(failed(path, "create")("the file"))?;
        unlock(&file);
        write(&file)?;
        file.close().map_err(failed(path, "write")("the end of the file"))?;
        seal(temporary).map_err(|source| FileError::write(path, source))
    })
}

/// Takes HDF5's lock off a file that is written under a temporary name, where nobody else looks for it. Programs that are started
/// meanwhile inherit the open file, and would keep the lock after we have closed it.
fn unlock(file: &hdf5::File) {
    hdf5::sync::sync(|| {
        let mut handle = std::ptr::null_mut();
        // SAFETY: the file is open, so that its driver's handle is a pointer to a descriptor, and nobody else is in HDF5.
        unsafe {
            // Where this fails the lock stays, which does no more harm than above.
            if H5Fget_vfd_handle(file.id(), H5P_DEFAULT, &mut handle) >= 0 && !handle.is_null() {
                libc::flock(*handle.cast::<libc::c_int>(), libc::LOCK_UN);
            }
        }
    });
}

/// Writes the user block.
fn seal(path: &Path) -> std::io::Result<()> {
    let mut file = fs::File::options().read(true).write(true).open(path)?;
    file.seek(SeekFrom::Start(BLOCK as u64))?;
    let mut block = block_of(&mut file)?.into_bytes();
    block.resize(BLOCK, 0);
    file.seek(SeekFrom::Start(0))?;
    file.write_all(&block)
}

/// What is wrong with a file of ours, if anything is; nothing is known of others.
fn verify(path: &Path) -> std::io::Result<Option<String>> {
    let mut file = fs::File::open(path)?;
    let mut block = Vec::with_capacity(BLOCK);
    // Nothing else is read to its end: a pipe might never have one.
    (&mut file).take(BLOCK as u64).read_to_end(&mut block)?;
    if !block.starts_with(MARK.as_bytes()) {
        return Ok(None);
    }
    let found = block_of(&mut file)?;
    let is_whole = block.len() == BLOCK && block.starts_with(found.as_bytes());
    Ok((!is_whole).then(|| "its bytes are not those that were written (checksum)".to_string()))
}

/// The text of the user block for what follows in a file.
fn block_of(rest: &mut fs::File) -> std::io::Result<String> {
    let (mut count, mut checksum, mut piece) = (0, 0, vec![0; 1 << 18]);
    loop {
        let read = match rest.read(&mut piece) {
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            read => read?,
        };
        if read == 0 {
            return Ok(format!("{MARK}bytes {count}\ncrc32c {checksum:08x}\n"));
        }
        count += read;
        checksum = crc32c::crc32c_append(checksum, &piece[..read]);
    }
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
    read_values(path, &dataset, name, shape).map(Some)
}

fn read_values<T: H5Type>(
    path: &Path,
    from: &hdf5::Container,
    name: &str,
    shape: &[usize],
) -> Result<Vec<T>, FileError> {
    let found = from.shape();
    if found != shape {
        return Err(mismatch(path, name, format!("of shape {found:?}"), &format!("of shape {shape:?}")));
    }
    from.read_raw().map_err(failed(path, "read")(name))
}

pub fn write_attribute<T: H5Type>(
    path: &Path,
    group: &hdf5::Group,
    name: &str,
    shape: &[usize],
    values: &[T],
) -> Result<(), FileError> {
    let written = group.new_attr::<T>().shape(shape).create(name).and_then(|attribute| attribute.write_raw(values));
    written.map_err(failed(path, "write")(name))
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
    read_values(path, &attribute, name, shape)
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
