//! Models by name or file.

use super::linear::Linear;
use super::predictor::Predictor;
use super::still::Still;
use crate::dataset::Metadata;
use crate::error::BadInput;
use crate::io::tensor_file::TensorFile;
use std::path::Path;

const ALLOWED: &str = "a .safetensors file written by `hydrograd train`, or `linear`, or `still`";

/// The model in a file, or the baseline `linear` or `still`.
///
/// # Errors
/// [`BadInput`] if the file can not be read, is damaged, or holds no model of ours.
pub fn load_predictor(path: &Path, _metadata: &Metadata) -> anyhow::Result<Box<dyn Predictor>> {
    match path.to_str() {
        Some("linear") => return Ok(Box::new(Linear)),
        Some("still") => return Ok(Box::new(Still)),
        _ => {}
    }
    let bad = |problem: String| BadInput::new(problem).place(format!("--model {}", path.display())).allowed(ALLOWED);
    let file = TensorFile::read(path).map_err(|error| bad(error.to_string()))?;
    let found = file.metadata.get("kind").map_or("no kind of it in the metadata", String::as_str);
    Err(bad(format!("not a model of hydrograd: it has {found}")).into())
}
