//! Baselines that every model must beat.

use crate::dataset::extent::Extent;
use crate::surrogate::predictor::{Frame, Predictor, Scenery};

/// Constant velocity: p + (p - p_before), T + (T - T_before).
#[derive(Debug, Clone, Copy, Default)]
pub struct ConstantVelocity;

impl Predictor for ConstantVelocity {
    fn name(&self) -> String {
        "linear".into()
    }

    fn window(&self) -> usize {
        2
    }

    fn next(&self, scenery: &Scenery, window: &[Frame]) -> anyhow::Result<Frame> {
        let [.., before, last] = window else { anyhow::bail!("constant velocity needs two frames") };
        let extent = Extent::of(scenery.metadata);
        let step = extent.displacement(&last.position, &before.position);
        let position = last.position.iter().zip(step).map(|(p, v)| p + v).collect();
        // A temperature set by the inlet must not be extrapolated.
        let inlet = scenery.metadata.heat.as_ref().map_or(f64::NEG_INFINITY, |heat| heat.inlet_length);
        let at_inlet = |i: usize| last.position[i * extent.dimension()] < inlet;
        let temperature = match (&last.temperature, &before.temperature) {
            (Some(last), Some(before)) => {
                Some((0..last.len()).map(|i| if at_inlet(i) { last[i] } else { 2.0 * last[i] - before[i] }).collect())
            }
            _ => None,
        };
        Ok(Frame { position, temperature })
    }
}

/// No change: the last frame again.
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
