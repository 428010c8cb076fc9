//! A trained model as a [`Predictor`].

use crate::config::training::HeatModel;
use crate::dataset::Metadata;
use crate::surrogate::conduction::Conduction;
use crate::surrogate::features::Window;
use crate::surrogate::integrate;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::parameters::{detached, Network};
use crate::surrogate::predictor::{Frame, Predictor, Scenery};
use candle_core::{Device, Tensor};
use std::sync::Arc;

pub struct Learned {
    pub name: String,
    pub setup: Setup,
    pub network: Arc<dyn Network>,
    /// Detached.
    pub parameters: Vec<Tensor>,
}

impl Learned {
    /// The network with its own parameters.
    pub fn new(name: String, setup: Setup, network: Arc<dyn Network>) -> Self {
        let parameters = detached(&*network);
        Self { name, setup, network, parameters }
    }
}

/// Frames as tensors.
pub fn window(frames: &[Frame], dimension: usize) -> candle_core::Result<Window> {
    let mut window = Window::default();
    for frame in frames {
        let n = frame.position.len() / dimension;
        window.position.push(Tensor::from_slice(&frame.position, (n, dimension), &Device::Cpu)?);
        if let Some(temperature) = &frame.temperature {
            window.temperature.push(Tensor::from_slice(temperature, n, &Device::Cpu)?);
        }
    }
    Ok(window)
}

impl Predictor for Learned {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn window(&self) -> usize {
        self.setup.features.frames
    }

    fn unlike(&self, metadata: &Metadata) -> Option<String> {
        self.setup.unlike(metadata)
    }

    fn next(&self, scenery: &Scenery, frames: &[Frame]) -> anyhow::Result<Frame> {
        let (metadata, normalisation) = (scenery.metadata, &self.setup.normalisation);
        let window = window(frames, metadata.dim)?;
        let dtype = self.parameters[0].dtype();
        let inputs = self.setup.features.inputs(scenery, normalisation, &window, None, dtype)?;
        let output = self.network.apply(&inputs, &self.parameters)?;
        let last = &window.position[window.position.len() - 1];
        let position = integrate::position(last, &inputs, &output, normalisation, metadata)?;
        let position = position.flatten_all()?.to_vec1::<f64>()?;
        let temperature = match (self.setup.heat, window.temperature.last(), frames.last()) {
            (HeatModel::Learned, Some(last), _) => {
                Some(integrate::temperature(last, &output, normalisation, metadata)?.to_vec1::<f64>()?)
            }
            (HeatModel::Conduction, Some(_), Some(last)) => Some(Conduction::new(scenery)?.advance(last, &position)?),
            (_, _, Some(last)) => last.temperature.clone(),
            _ => None,
        };
        Ok(Frame { position, temperature })
    }
}
