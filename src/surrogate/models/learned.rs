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
    /// Parameters of the network, detached unless a gradient is needed.
    pub parameters: Vec<Tensor>,
}

impl Learned {
    /// A network with its own parameters.
    pub fn new(name: String, setup: Setup, network: Arc<dyn Network>) -> Self {
        let parameters = detached(&*network);
        Self { name, setup, network, parameters }
    }

    /// Positions `[N, D]` and, if the network learns them, temperatures `[N]` one frame after a window, with kinematic
    /// particles not yet restored. They are on candle's graph if the window or the parameters are. `force`: external
    /// force `[N, D]`, if any.
    ///
    /// # Errors
    /// Lost or clumped particles, tensor errors.
    pub fn predict(
        &self,
        scenery: &Scenery,
        window: &Window,
        force: Option<&Tensor>,
    ) -> anyhow::Result<(Tensor, Option<Tensor>)> {
        let (metadata, normalisation) = (scenery.metadata, &self.setup.normalisation);
        let dtype = self.parameters[0].dtype();
        let inputs = self.setup.features.inputs(scenery, normalisation, window, force, dtype)?;
        let output = self.network.apply(&inputs, &self.parameters)?;
        let last = &window.position[window.position.len() - 1];
        let position = integrate::position(last, &inputs, &output, normalisation, metadata)?;
        let temperature = match (self.setup.heat, window.temperature.last()) {
            (HeatModel::Learned, Some(last)) => Some(integrate::temperature(last, &output, normalisation, metadata)?),
            _ => None,
        };
        Ok((position, temperature))
    }
}

/// Converts frames to tensors.
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
        let window = window(frames, scenery.metadata.dim)?;
        let (position, temperature) = self.predict(scenery, &window, None)?;
        let position = position.flatten_all()?.to_vec1::<f64>()?;
        let temperature = match (self.setup.heat, temperature, frames.last()) {
            (_, Some(temperature), _) => Some(temperature.to_vec1::<f64>()?),
            (HeatModel::Conduction, None, Some(last)) if last.temperature.is_some() => {
                Some(Conduction::new(scenery)?.advance(last, &position)?)
            }
            (_, None, last) => last.and_then(|last| last.temperature.clone()),
        };
        Ok(Frame { position, temperature })
    }
}
