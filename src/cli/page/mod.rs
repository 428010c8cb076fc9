//! `report.html` of a folder: one page of what its run left, made from the files alone.
//!
//! So a run that was ended and goes on, `verify`, and `compare` make the same of the same files.

pub mod compare;
mod designs;
mod folder;
mod leads;
mod names;
mod others;
mod series;
mod tables;

pub use compare::CompareArguments;

use super::run_folder::kind_of;
use crate::report::page::{Page, PAGE};
use folder::Folder;
use std::path::Path;

/// Writes the page of a folder, which its run has otherwise finished.
///
/// # Errors
/// Files of the run that cannot be read, and system errors.
pub fn write(folder: &Path) -> anyhow::Result<()> {
    let Some(kind) = kind_of(folder) else { return Ok(()) };
    page_of(&Folder::new(folder, &kind))?.write(&folder.join(PAGE))
}

/// Writes the page of a folder anew, if it has one: a file was added.
///
/// # Errors
/// As for [`write`].
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
        _ => others::page(folder)?,
    };
    page.title = folder.name();
    page.subtitle = folder.subtitle();
    page.texts.extend(folder.configuration());
    page.files = folder.files();
    Ok(page)
}
