//! Files that are either complete or absent: written under a temporary name beside the target, then renamed.
//!
//! A reader (or a restarted run) never sees half a file, and an old file survives until the new one is whole.
//! Data are flushed to the operating system, not forced to disk (no fsync): a killed process loses nothing, a
//! power cut may.

use super::FileError;
use std::fs::{self, File};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// Writes `path` through `write`; the file appears only when `write` and the last flush succeeded.
///
/// # Errors
/// What `write` returns, and system errors, as [`FileError::Write`]; the temporary file is removed and an
/// existing `path` is left as it was.
pub fn write_atomically<F>(path: &Path, write: F) -> Result<(), FileError>
where
    F: FnOnce(&mut BufWriter<File>) -> std::io::Result<()>,
{
    let target = resolve_target(path)?;
    let (file, temporary) = temporary_beside(&target)?.into_parts();
    let mut writer = BufWriter::with_capacity(1 << 16, file);
    write(&mut writer).and_then(|()| writer.flush()).map_err(|source| FileError::write(path, source))?;
    drop(writer);
    persist(temporary, &target)
}

/// Writes `bytes` to `path` in one go; see [`write_atomically`].
pub fn write_bytes_atomically(path: &Path, bytes: &[u8]) -> Result<(), FileError> {
    write_atomically(path, |writer| writer.write_all(bytes))
}

/// As [`write_atomically`], for libraries that want a path of their own (HDF5, image encoders): `write` gets the
/// temporary path, which has the same extension as `path`.
///
/// # Errors
/// As [`write_atomically`], and whatever `write` returns.
pub fn write_path_atomically<F>(path: &Path, write: F) -> Result<(), FileError>
where
    F: FnOnce(&Path) -> Result<(), FileError>,
{
    let target = resolve_target(path)?;
    let temporary = temporary_beside(&target)?.into_temp_path();
    write(&temporary)?;
    persist(temporary, &target)
}

/// Creates the folder `path` (and its parents) if needed and makes sure that files can be created in it.
///
/// # Errors
/// [`FileError::WrongKind`] if `path` is a file, [`FileError::Write`] if it cannot be created or written to.
pub fn prepare_output_folder(path: &Path) -> Result<(), FileError> {
    if path.exists() && !path.is_dir() {
        return Err(FileError::WrongKind {
            path: path.to_owned(),
            found: "a file",
            wanted: "a folder",
            hint: "choose another output folder or move the file away",
        });
    }
    fs::create_dir_all(path).map_err(|source| FileError::write(path, source))?;
    // Permission bits do not tell (root, read-only mounts, quotas), so try it.
    tempfile::Builder::new()
        .prefix(TRIAL)
        .tempfile_in(path)
        .map(drop)
        .map_err(|error| FileError::write(path, without_temporary_path(error)))
}

/// What the names of unfinished files have between that of the target and a random part.
const PARTIAL: &str = ".partial-";
/// What that of [`prepare_output_folder`]'s trial begins with.
const TRIAL: &str = ".write-test-";

/// Whether a name is that of a file that was to be renamed, or removed, and was not: its process was killed.
pub fn is_temporary(name: &str) -> bool {
    name.starts_with(TRIAL) || (name.starts_with('.') && name.contains(PARTIAL))
}

/// The file that a rename must replace: behind symbolic links, and never a folder or a device.
fn resolve_target(path: &Path) -> Result<PathBuf, FileError> {
    let wrong_kind = |found| FileError::WrongKind {
        path: path.to_owned(),
        found,
        wanted: "a regular file",
        hint: "give the name of a file",
    };
    if path.file_name().is_none() {
        return Err(wrong_kind("a folder"));
    }
    match fs::metadata(path) {
        Err(_) => Ok(path.to_owned()),
        Ok(metadata) if metadata.is_dir() => Err(wrong_kind("a folder")),
        // Renaming onto /dev/null would replace the device.
        Ok(metadata) if !metadata.is_file() => Err(wrong_kind("a device or a pipe")),
        // A link stays a link: its target is what gets replaced.
        Ok(_) if path.is_symlink() => fs::canonicalize(path).map_err(|source| FileError::write(path, source)),
        Ok(_) => Ok(path.to_owned()),
    }
}

/// A hidden temporary file in the folder of `target` (same disk, so that the rename is atomic).
fn temporary_beside(target: &Path) -> Result<tempfile::NamedTempFile, FileError> {
    let folder = match target.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    let stem = target.file_stem().unwrap_or_default().to_string_lossy();
    let suffix = match target.extension() {
        Some(extension) => format!(".{}", extension.to_string_lossy()),
        None => String::new(),
    };
    let prefix = format!(".{stem}{PARTIAL}");
    let mut builder = tempfile::Builder::new();
    builder.prefix(&prefix).suffix(&suffix);
    // Temporary files are private by default; results are to be shared as far as the umask allows.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.tempfile_in(folder).map_err(|error| FileError::write(target, without_temporary_path(error)))
}

/// The kind of error alone where it says enough: tempfile adds the random name, which tells a reader nothing.
fn without_temporary_path(error: std::io::Error) -> std::io::Error {
    use std::io::ErrorKind;
    match error.kind() {
        kind @ (ErrorKind::NotFound
        | ErrorKind::NotADirectory
        | ErrorKind::PermissionDenied
        | ErrorKind::ReadOnlyFilesystem
        | ErrorKind::StorageFull) => kind.into(),
        _ => error,
    }
}

/// Renames the finished temporary file onto its target.
fn persist(temporary: TempPath, target: &Path) -> Result<(), FileError> {
    temporary.persist(target).map_err(|error| FileError::write(target, error.error))?;
    log::debug!("wrote {}", target.display());
    Ok(())
}
