//! `report.html` of a folder: a page with the results of its run, made only from the files.
//!
//! So resumed runs, `verify` and `compare` make the same page from the same files.

pub mod compare;
mod data_set;
mod designs;
mod folder;
mod leads;
mod names;
mod others;
mod series;
mod tables;

pub use compare::CompareArguments;

use super::guard::warn;
use super::run_folder::kind_of;
use crate::report::page::{Page, PAGE};
use folder::Folder;
use std::path::Path;

/// Writes the page of a folder whose run is otherwise finished. Damaged files are left out with a warning.
///
/// # Errors
/// A configuration that cannot be read, and system errors.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let Some(kind) = kind_of(folder) else { return Ok(()) };
    let folder = Folder::new(folder, &kind);
    let page = page_of(&folder)?;
    folder.damage().iter().for_each(|note| warn(&note.problem, &note.advice));
    page.write(&folder.path.join(PAGE))
}

/// Rewrites the page of a folder, if it has one, after a file was added.
pub fn refresh(folder: &Path) -> anyhow::Result<()> {
    match folder.join(PAGE).exists() {
        true => write(folder),
        false => Ok(()),
    }
}

fn page_of(folder: &Folder) -> anyhow::Result<Page> {
    let mut page = match folder.kind.as_str() {
        "optimize" => designs::optimize(folder)?,
        "simulate" => designs::simulate(folder)?,
        "optimize --start all" | "optimize --compare" => compare::parts(folder)?,
        "generate" => data_set::page(folder)?,
        _ => others::page(folder),
    };
    page.title = folder.name();
    page.subtitle = folder.subtitle();
    page.texts.extend(folder.configuration());
    page.files = folder.files();
    page.warnings.extend(folder.damage());
    Ok(page)
}
