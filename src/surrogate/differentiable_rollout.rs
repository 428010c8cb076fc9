//! A rollout on candle's graph, for gradients by the first frames, a force or the parameters.
//!
//! Positions are wrapped, kinematic particles held and the inlet's temperature set as in
//! [`crate::surrogate::evaluation::rollout`], but without a truth kinematic particles stay in place. Neighbours,
//! nearest images and which particles passed the inlet are constant in derivatives, as in the solver.

use crate::config::training::HeatModel;
use crate::dataset::kind;
use crate::surrogate::conduction::Conduction;
use crate::surrogate::features::Window;
use crate::surrogate::models::learned::Learned;
use crate::surrogate::predictor::Scenery;
use candle_core::{Device, Result, Tensor};

/// A learned model for particles that it moves and others that stay in place.
pub struct DifferentiableRollout<'a> {
    model: &'a Learned,
    scenery: Scenery<'a>,
    /// `[N, 1]`: 1 for particles that the model moves.
    moves: Tensor,
}

impl<'a> DifferentiableRollout<'a> {
    /// A rollout of a model, whose parameters may be tracked.
    pub fn new(model: &'a Learned, scenery: Scenery<'a>) -> anyhow::Result<Self> {
        let moves = scenery.kind.iter().map(|&k| if kind::is_kinematic(k) { 0.0 } else { 1.0 });
        let moves = column(moves.collect())?;
        Ok(Self { model, scenery, moves })
    }

    /// The window one frame later, with positions `[N, D]` and temperatures `[N]` in f64. `force` `[N, D]` is external.
    ///
    /// # Errors
    /// Lost or clumped particles, tensor errors.
    pub fn advance(&self, window: &Window, force: Option<&Tensor>) -> anyhow::Result<Window> {
        let Some(last) = window.position.last() else { anyhow::bail!("a window without frames") };
        let (predicted, mut temperature) = self.model.predict(&self.scenery, window, force)?;
        if let (HeatModel::Conduction, Some(before)) = (self.model.setup.heat, window.temperature.last()) {
            temperature = Some(Conduction::new(&self.scenery)?.advance_on_graph(last, before, &predicted)?);
        }
        let position = choose(&self.moves, &predicted, last)?;
        let mut next = window.clone();
        if let (Some(temperature), Some(before)) = (temperature, window.temperature.last()) {
            let temperature = choose(&self.moves, &temperature.unsqueeze(1)?, &before.unsqueeze(1)?)?;
            next.temperature.remove(0);
            next.temperature.push(self.at_inlet(last, &position, &temperature)?.squeeze(1)?);
        }
        next.position.remove(0);
        next.position.push(position);
        Ok(next)
    }

    /// Temperatures `[N, 1]` with that of the inlet for particles that passed it between `before` and `now`.
    fn at_inlet(&self, before: &Tensor, now: &Tensor, temperature: &Tensor) -> anyhow::Result<Tensor> {
        let metadata = self.scenery.metadata;
        let Some(heat) = &metadata.heat else { return Ok(temperature.clone()) };
        let x = |position: &Tensor| position.detach().narrow(1, 0, 1)?.flatten_all()?.to_vec1::<f64>();
        let (before, now) = (x(before)?, x(now)?);
        let stays = |i: usize| {
            let reset = heat.resets(before[i], now[i], metadata.bounds[0]) && !kind::is_kinematic(self.scenery.kind[i]);
            if reset {
                0.0
            } else {
                1.0
            }
        };
        let stays = column((0..now.len()).map(stays).collect())?;
        Ok(choose(&stays, temperature, &temperature.ones_like()?.affine(heat.inlet_temperature, 0.0)?)?)
    }
}

/// `[N, 1]`.
fn column(values: Vec<f64>) -> Result<Tensor> {
    let rows = values.len();
    Tensor::from_vec(values, (rows, 1), &Device::Cpu)
}

/// Rows of `one` where `which` `[N, 1]` is 1, else of `other`; both must be finite.
fn choose(which: &Tensor, one: &Tensor, other: &Tensor) -> Result<Tensor> {
    one.broadcast_mul(which)? + other.broadcast_mul(&which.affine(-1.0, 1.0)?)?
}
