//! `hydrograd simulate`.

use super::SimulateArguments;
use crate::error::Error;
use crate::scene::load::Loaded;

pub fn run(loaded: Loaded, arguments: SimulateArguments) -> anyhow::Result<()> {
    let _folder = arguments.folder(&loaded)?;
    Err(Error::run("not built yet", "a later version").into())
}
