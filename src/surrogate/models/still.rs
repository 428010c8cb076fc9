//! The baseline without any change, which repeats the last frame.

use crate::surrogate::predictor::{Frame, Predictor, Scenery};

#[derive(Debug, Clone, Copy, Default)]
pub struct Still;

impl Predictor for Still {
    fn name(&self) -> String {
        "no change".into()
    }

    fn window(&self) -> usize {
        1
    }

    fn next(&self, _: &Scenery, window: &[Frame]) -> anyhow::Result<Frame> {
        window.last().cloned().ok_or_else(|| anyhow::anyhow!("no change needs one frame"))
    }
}
