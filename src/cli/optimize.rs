//! `hydrograd optimize`.

use super::OptimizeArguments;
use crate::error::Error;
use crate::scene::load::Loaded;

pub fn run(loaded: Loaded, arguments: OptimizeArguments) -> anyhow::Result<()> {
    let _folder = arguments.folder(&loaded)?;
    Err(Error::run("not built yet", "a later version").into())
}
