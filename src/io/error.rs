//! The error of everything that touches files: which file, what is wrong, what is allowed, what to try.

use std::path::{Path, PathBuf};

/// A file could not be written or read, or does not hold what it should.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    #[error("cannot write {}: {source}; {}", path.display(), hint_for(source))]
    Write { path: PathBuf, source: std::io::Error },
    #[error("cannot read {}: {source}; {}", path.display(), hint_for(source))]
    Read { path: PathBuf, source: std::io::Error },
    /// The path is of the wrong kind: a folder where a file is wanted, or the reverse.
    #[error("{} is {found}, but {wanted} is needed there; {hint}", path.display())]
    WrongKind { path: PathBuf, found: &'static str, wanted: &'static str, hint: &'static str },
    #[error(
        "{} is not a readable {format}: {what}; \
         it may be cut short (a run killed while copying?) or of another format: {hint}",
        path.display()
    )]
    Damaged { path: PathBuf, format: &'static str, what: String, hint: &'static str },
    /// Another program holds HDF5's lock on the file, or its disk has no locks.
    #[error(
        "{} is locked: another program writes it; wait until it has finished, \
         or, where the disk cannot lock files (some network disks), set HDF5_USE_FILE_LOCKING=FALSE",
        path.display()
    )]
    Locked { path: PathBuf },
    /// A named part (dataset, attribute, tensor, column) is not in the file.
    #[error("{} has no {kind} `{name}`; it has: {}; {hint}", path.display(), list(present))]
    Missing { path: PathBuf, kind: &'static str, name: String, present: Vec<String>, hint: &'static str },
    /// A named part is there but has another shape, type or length.
    #[error("{}: `{name}` is {found}, but must be {allowed}; {hint}", path.display())]
    Mismatch { path: PathBuf, name: String, found: String, allowed: String, hint: &'static str },
    #[error(
        "{}, line {line}, column `{column}`: `{value}` is {what}; \
         allowed: finite numbers such as -0.02 or 1.5e-3; correct the cell or remove the row",
        path.display()
    )]
    Cell { path: PathBuf, line: usize, column: String, value: String, what: &'static str },
    /// The caller's data do not fit together; nothing was written.
    #[error("cannot write {}: {what}; allowed: {allowed}; nothing was written", path.display())]
    Input { path: PathBuf, what: String, allowed: String },
    #[error("{}: HDF5 failed to {action}: {source}; check free space and that no other program holds the file open", path.display())]
    Hdf5 { path: PathBuf, action: String, source: hdf5::Error },
    #[error("cannot draw {}: {what}; {hint}", path.display())]
    Plot { path: PathBuf, what: String, hint: &'static str },
}

impl FileError {
    /// The system error `source` while writing `path`.
    pub fn write(path: &Path, source: std::io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }

    /// The system error `source` while reading `path`.
    pub fn read(path: &Path, source: std::io::Error) -> Self {
        Self::Read { path: path.to_owned(), source }
    }

    /// Data given for `path` that do not fit together.
    pub fn input(path: &Path, what: impl Into<String>, allowed: impl Into<String>) -> Self {
        Self::Input { path: path.to_owned(), what: what.into(), allowed: allowed.into() }
    }

    /// Checks arrays of `count` particles for `path`: name of each, length that it must have, and that it has.
    pub(super) fn check_lengths(
        path: &Path,
        dimension: usize,
        count: usize,
        arrays: &[(&str, usize, usize)],
    ) -> Result<(), Self> {
        if !(1..=3).contains(&dimension) {
            return Err(Self::input(path, format!("dimension is {dimension}"), "1, 2 or 3"));
        }
        arrays.iter().find(|(_, wanted, found)| wanted != found).map_or(Ok(()), |(name, wanted, found)| {
            let allowed = format!("{wanted} for {count} particles in {dimension} dimensions");
            Err(Self::input(path, format!("{name} has {found} values"), allowed))
        })
    }
}

/// What to try after a system error.
fn hint_for(error: &std::io::Error) -> &'static str {
    use std::io::ErrorKind;
    match error.kind() {
        ErrorKind::NotFound => "check the spelling of the path and that its folder exists",
        ErrorKind::PermissionDenied => "choose a place where you may write and read, or change the permissions",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "free some space or choose another disk",
        ErrorKind::ReadOnlyFilesystem => "the disk is read-only: choose another place",
        ErrorKind::IsADirectory => "this is a folder: give the name of a file",
        ErrorKind::NotADirectory => "a part of the path is a file: give a path through folders",
        _ => "check the path and the disk",
    }
}

/// So many names are shown of a file's; a checkpoint has hundreds.
const MOST_NAMES: usize = 20;

/// Names in a row, or "nothing".
fn list(names: &[String]) -> String {
    match names.len() {
        0 => "nothing".to_owned(),
        1..=MOST_NAMES => names.join(", "),
        count => format!("{}, ... ({count} in all)", names[..MOST_NAMES].join(", ")),
    }
}
