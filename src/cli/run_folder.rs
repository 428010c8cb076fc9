//! The folder of a run, which is for one kind of command and is written by one process at a time.
//!
//! A file in it, [`MARKER`], has the kind of the run and whether the run is finished. The process that writes to the
//! folder holds a lock on that file, which the system releases when the process ends in any way.

use super::arguments::check_writable;
use super::shard::Shard;
use crate::error::BadInput;
use crate::io::atomic::{is_temporary, prepare_output_folder};
use crate::io::FileError;
use crate::report::page::PAGE;
use std::fs::{File, TryLockError};
use std::io::{ErrorKind, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// The marker file: the name of the command, and `finished` in a second line once the run is.
pub const MARKER: &str = ".hydrograd";
const FINISHED: &str = "finished";

/// How an earlier run of the same kind is treated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Earlier {
    /// Its files are replaced.
    Replaced,
    /// It is kept, because it took long: a new run is an error.
    Kept,
    Resumed,
    /// It may be of any kind, and a file is added to it.
    Visited,
}

impl Earlier {
    /// The treatment by the options of a command whose runs take long.
    pub fn of_options(resumes: bool, overwrite: bool) -> Self {
        match (resumes, overwrite) {
            (true, _) => Self::Resumed,
            (false, true) => Self::Replaced,
            (false, false) => Self::Kept,
        }
    }
}

/// A folder that this process may write to.
#[derive(Debug)]
pub struct RunFolder {
    kind: &'static str,
    path: PathBuf,
    /// None in a visited folder without a marker.
    marker: Option<File>,
}

#[derive(Debug, PartialEq, Eq)]
enum Content {
    Nothing,
    Run {
        kind: String,
        finished: bool,
    },
    /// A file as written by runs, of an unknown kind.
    Unknown(&'static str),
}

/// Files that identify runs in folders without a marker, from earlier versions or other programs.
const TELLTALES: [(&str, Option<&str>); 7] = [
    ("generate.json", Some("generate")),
    ("last.safetensors", Some("train")),
    ("study.csv", Some("study")),
    ("metadata.json", None),
    ("checkpoint.safetensors", None),
    ("summary.json", None),
    ("config.toml", None),
];

impl Content {
    fn of(folder: &Path) -> Self {
        // Before the marker is read: who begins at the same time writes it before all other files.
        let telltale = TELLTALES.iter().find(|(file, _)| folder.join(file).exists());
        let text = std::fs::read_to_string(folder.join(MARKER)).unwrap_or_default();
        let mut lines = text.lines();
        // A process that was killed at its start leaves an empty marker.
        if let Some(kind) = lines.next() {
            return Self::Run { kind: kind.to_string(), finished: lines.next() == Some(FINISHED) };
        }
        match telltale {
            None => Self::Nothing,
            Some((_, Some(kind))) => Self::Run { kind: kind.to_string(), finished: false },
            Some((file, None)) => Self::Unknown(file),
        }
    }
}

pub fn is_finished(folder: &Path) -> bool {
    matches!(Content::of(folder), Content::Run { finished: true, .. })
}

/// The kind of a folder's run; none if it is unknown.
pub fn kind_of(folder: &Path) -> Option<String> {
    match Content::of(folder) {
        Content::Run { kind, .. } => Some(kind),
        _ => None,
    }
}

pub fn is_unfinished(folder: &Path, kind: &str) -> bool {
    Content::of(folder) == Content::Run { kind: kind.to_string(), finished: false }
}

impl RunFolder {
    /// Checks whether [`Self::take`] is possible, without changing anything.
    ///
    /// # Errors
    /// A folder that is not writable, of another command, or with a run that must not be discarded.
    pub fn check(folder: &Path, kind: &'static str, earlier: Earlier) -> Result<(), BadInput> {
        check_writable(folder)?;
        if earlier == Earlier::Visited {
            return Ok(());
        }
        let problem = match Content::of(folder) {
            Content::Run { kind: theirs, .. } if theirs != kind => {
                format!("the folder belongs to another command: it holds a run of `hydrograd {theirs}`")
            }
            Content::Run { finished, .. } if earlier == Earlier::Kept && holds_results(folder) => {
                let how_far = if finished { "a finished" } else { "an unfinished" };
                let resume = if kind == "train" { "--resume".into() } else { format!("--resume {}", folder.display()) };
                return Err(BadInput::new(format!("the folder holds {how_far} run of `hydrograd {kind}` already"))
                    .place(format!("--out {}", folder.display()))
                    .allowed("a new folder, unless the run goes on or is to be lost")
                    .advice(format!("{resume} to go on with it, --overwrite to lose it, or another --out")));
            }
            // A resumed run checks its files itself.
            Content::Unknown(file) if earlier != Earlier::Resumed => {
                format!("the folder holds {file}, which `hydrograd {kind}` did not make")
            }
            _ => return Ok(()),
        };
        let option = if earlier == Earlier::Resumed { "" } else { "--out " };
        Err(BadInput::new(problem)
            .place(format!("{option}{}", folder.display()))
            .allowed(format!("a new folder, or one that `hydrograd {kind}` began"))
            .advice("another --out"))
    }

    /// Creates the folder if needed, and locks it until this is dropped.
    pub fn take(folder: &Path, kind: &'static str, earlier: Earlier) -> anyhow::Result<Self> {
        Self::locked(folder, kind, earlier, false)
    }

    /// As [`Self::take`], shared with other processes of this kind. Nothing is removed.
    pub fn share(folder: &Path, kind: &'static str) -> anyhow::Result<Self> {
        Self::locked(folder, kind, Earlier::Replaced, true)
    }

    /// [`Self::share`] for a share of a command's work, else [`Self::take`].
    pub fn for_work(share: Option<Shard>, folder: &Path, kind: &'static str, earlier: Earlier) -> anyhow::Result<Self> {
        match share {
            Some(_) => Self::share(folder, kind),
            None => Self::take(folder, kind, earlier),
        }
    }

    fn locked(folder: &Path, kind: &'static str, earlier: Earlier, is_shared: bool) -> anyhow::Result<Self> {
        Self::check(folder, kind, earlier)?;
        prepare_output_folder(folder)?;
        let (path, visits) = (folder.join(MARKER), earlier == Earlier::Visited);
        let marker = match File::options().read(true).write(true).create(!visits).truncate(false).open(&path) {
            Err(error) if visits && error.kind() == ErrorKind::NotFound => None,
            marker => Some(marker.map_err(|source| FileError::write(&path, source))?),
        };
        let lock = marker.as_ref().map(|marker| if is_shared { marker.try_lock_shared() } else { marker.try_lock() });
        // Some file systems have no locks.
        if let Some(Err(TryLockError::WouldBlock)) = lock {
            return Err(BadInput::new("another hydrograd is writing to this folder")
                .place(folder.display().to_string())
                .allowed("one run at a time")
                .advice("wait until it ends, stop it, or another --out")
                .into());
        }
        // Another process may have finished since.
        Self::check(folder, kind, earlier)?;
        let own = Self { kind, path, marker };
        log::debug!("{} is ours, for `hydrograd {kind}`", folder.display());
        if !visits {
            let is_replaced = earlier == Earlier::Replaced && Content::of(folder) != Content::Nothing;
            own.write("")?;
            if is_replaced && !is_shared {
                remove_outputs(folder, kind);
            }
            if !is_shared {
                remove_temporaries(folder);
            }
        }
        Ok(own)
    }

    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new("."))
    }

    /// Marks the run as finished. What an earlier process left unfinished is removed, unless others still share the folder.
    pub fn finish(&self) -> anyhow::Result<()> {
        self.write(&format!("{FINISHED}\n"))?;
        // The lock of a shared folder has to be given up before it can be had alone.
        let is_alone = |marker: &File| marker.unlock().is_ok() && marker.try_lock().is_ok();
        if self.marker.as_ref().is_some_and(is_alone) {
            remove_temporaries(self.folder());
        }
        Ok(())
    }

    /// Writes the kind and further text in place, because the lock is on the file (empty, or with the same first line).
    fn write(&self, more: &str) -> anyhow::Result<()> {
        let Some(mut marker) = self.marker.as_ref() else { return Ok(()) };
        let text = format!("{}\n{more}", self.kind);
        let written = marker.seek(SeekFrom::Start(0)).and_then(|_| marker.write_all(text.as_bytes()));
        let written = written.and_then(|()| marker.set_len(text.len() as u64));
        Ok(written.map_err(|source| FileError::write(&self.path, source))?)
    }
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
}

/// Whether the folder has more than the files that a run writes at its start.
pub fn holds_results(folder: &Path) -> bool {
    names(folder).iter().any(|name| name != MARKER && name != "config.toml" && !is_temporary(name))
}

/// Names without extension of the files that a command writes, as far as another run might not replace them.
fn stems(kind: &str) -> &'static str {
    match kind {
        "simulate" => {
            "config summary history shape wall temperature flow vorticity error state checkpoint last-good kinetic_energy \
             profile"
        }
        "train" => "config last best history validation curves",
        kind if kind.starts_with("optimize") => {
            "config summary history shape shapes shapes-top wall walls walls-top starts best temperature flow state \
             checkpoint verification"
        }
        _ => "",
    }
}

/// Removes the files of an earlier run of this kind that a new one might not replace, and nothing else. Errors are
/// ignored: files that cannot be removed are overwritten, or do no harm.
fn remove_outputs(folder: &Path, kind: &str) {
    for name in names(folder) {
        let path = folder.join(&name);
        let (stem, extension) = name.rsplit_once('.').unwrap_or((&name, ""));
        let is_output = stems(kind).split_whitespace().any(|own| own == stem)
            && ["toml", "json", "csv", "png", "svg", "vtp", "h5", "safetensors"].contains(&extension);
        if path.is_dir() {
            remove_series(&path);
        } else if is_output || name == PAGE || (kind == "train" && name.starts_with("events.out.tfevents.")) {
            let _ = std::fs::remove_file(path);
        }
    }
}

/// Removes the frames of a ParaView series, and its folder if that is then empty.
fn remove_series(folder: &Path) {
    let Some(name) = folder.file_name().and_then(|name| name.to_str()) else { return };
    let Some(series) = ["particles", "predicted", "true"].into_iter().find(|series| {
        name.strip_prefix(series).is_some_and(|rest| rest.is_empty() || rest == "-before" || rest.starts_with("-from-"))
    }) else {
        return;
    };
    for name in names(folder) {
        let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
        let is_frame = name.strip_prefix(series).is_some_and(|rest| {
            rest == ".pvd" || rest.strip_prefix('_').and_then(|rest| rest.strip_suffix(".vtp")).is_some_and(is_number)
        });
        if is_frame || is_temporary(&name) {
            let _ = std::fs::remove_file(folder.join(name));
        }
    }
    let _ = std::fs::remove_dir(folder);
}

/// Removes unfinished files of a killed process, here, among frames and among the runs of maps.
fn remove_temporaries(folder: &Path) {
    for name in names(folder) {
        let path = folder.join(&name);
        if is_temporary(&name) {
            let _ = std::fs::remove_file(path);
        } else if (name.starts_with("particles") || name == "runs") && path.is_dir() {
            remove_temporaries(&path);
        }
    }
}

/// The treatment for a command with `--resume`: the folder itself is resumed, or another one from which it continues.
pub fn earlier(folder: &Path, resume: Option<&Path>, otherwise: Earlier) -> Earlier {
    let real = |path: &Path| path.canonicalize().unwrap_or_else(|_| PathBuf::from(path));
    match resume {
        Some(from) if real(from) == real(folder) => Earlier::Resumed,
        _ => otherwise,
    }
}
