//! Training samples: the window of each step, and the model's inputs and targets.
//!
//! All random numbers follow from seed, step and place in the batch, so a resumed training continues as if it had never
//! stopped.

use crate::config::training::{HeatModel, Settings};
use crate::dataset::{kind, Metadata, Trajectory};
use crate::error::BadInput;
use crate::numerics::random::{stream, uniform, Normal};
use crate::surrogate::evaluation::rollout::settle_temperature;
use crate::surrogate::features::{displacement, wrap, Inputs, Window};
use crate::surrogate::integrate;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::parameters::Network;
use crate::surrogate::predictor::Scenery;
use crate::surrogate::training::loss::target_acceleration;
use crate::surrogate::training::noise;
use candle_core::{Device, Result, Tensor};

/// Windows of the training split with stride 1.
pub struct Samples<'a> {
    metadata: &'a Metadata,
    trajectories: &'a [Trajectory],
    settings: &'a Settings,
    setup: &'a Setup,
    /// Number of frames in a window: inputs, target, unrolled steps.
    length: usize,
    /// Number of windows before the first of each trajectory.
    before: Vec<usize>,
    count: usize,
    /// An epoch and the order of its windows.
    order: (u64, Vec<u32>),
}

/// A sample, ready for the model.
pub struct Sample {
    pub inputs: Inputs,
    /// Normalised targets `[N, outputs]`.
    pub target: Tensor,
    /// Mask `[N, outputs]`, 1 where the loss counts.
    pub mask: Tensor,
}

impl<'a> Samples<'a> {
    /// # Errors
    /// No trajectory is long enough, or temperatures are missing.
    pub fn new(
        metadata: &'a Metadata,
        trajectories: &'a [Trajectory],
        settings: &'a Settings,
        setup: &'a Setup,
    ) -> std::result::Result<Self, BadInput> {
        let length = setup.features.frames + 1 + settings.pushforward.most();
        let mut before = Vec::with_capacity(trajectories.len());
        let mut count = 0;
        for trajectory in trajectories {
            before.push(count);
            count += (trajectory.frames + 1).saturating_sub(length);
            if setup.heat != HeatModel::None && trajectory.temperature.is_none() {
                return Err(BadInput::new(format!("trajectory {} has no temperature", trajectory.name))
                    .allowed("temperature [T, N] in every trajectory")
                    .advice("model.heat=none"));
            }
        }
        if count == 0 {
            return Err(BadInput::new(format!("no training trajectory has the {length} frames of a window"))
                .allowed(format!("trajectories of at least {length} frames"))
                .advice("generate longer ones, or fewer pushforward.unrolls"));
        }
        Ok(Self { metadata, trajectories, settings, setup, length, before, count, order: (u64::MAX, Vec::new()) })
    }

    /// Trajectory and first frame of sample `number`, counted over all steps. Every epoch orders all windows anew.
    fn window(&mut self, number: u64) -> (&'a Trajectory, usize) {
        let epoch = number / self.count as u64;
        if self.order.0 != epoch {
            let mut rng = stream(mixed(self.settings.seed, epoch), "order");
            let mut order: Vec<u32> = (0..self.count as u32).collect();
            for k in (1..order.len()).rev() {
                order.swap(k, (uniform(&mut rng) * (k + 1) as f64) as usize);
            }
            self.order = (epoch, order);
        }
        let window = self.order.1[(number % self.count as u64) as usize] as usize;
        let index = self.before.partition_point(|&before| before <= window) - 1;
        (&self.trajectories[index], window - self.before[index])
    }

    /// The sample of a step and a place in its batch. `parameters` are detached; the unrolled steps use them.
    ///
    /// # Errors
    /// Lost or clumped particles, tensor errors.
    pub fn sample(
        &mut self,
        step: u64,
        place: u64,
        network: &dyn Network,
        parameters: &[Tensor],
    ) -> anyhow::Result<Sample> {
        let number = step * self.settings.batch_size as u64 + place;
        let mut chance = stream(mixed(self.settings.seed, number), "unrolls");
        let unrolls = self.settings.pushforward.unrolls(step, uniform(&mut chance));
        let draw = self.draw(number)?;
        let (inputs, last_temperature) = self.unroll(&draw, unrolls, network, parameters)?;
        let dtype = parameters[0].dtype();
        let target = self.target(&draw, unrolls, last_temperature.as_ref())?.to_dtype(dtype)?;
        let mask = self.mask(&draw, unrolls)?.to_dtype(dtype)?;
        Ok(Sample { inputs, target, mask })
    }

    /// The frames of sample `number`, true and with noise.
    fn draw(&mut self, number: u64) -> anyhow::Result<Draw<'a>> {
        let (trajectory, start) = self.window(number);
        let (setup, settings, frames) = (self.setup, self.settings, self.setup.features.frames);
        let window = start..start + self.length;
        let clean: Vec<Vec<f64>> = window.clone().map(|frame| widen(trajectory.position_of(frame))).collect();
        let mut normal = Normal::new(stream(mixed(settings.seed, number), "noise"));
        let mut noisy = clean.clone();
        if settings.noise > 0.0 {
            let numbers = trajectory.particles * (frames - 1) * self.metadata.dim;
            let z: Vec<f64> = (0..numbers).map(|_| normal.next()).collect();
            noise::walk(&mut noisy, &trajectory.kind, &z, settings.noise, frames);
        }
        let noisy = noisy.iter().map(|p| wrap(&self.positions(p)?, self.metadata)).collect::<Result<_>>()?;
        let mut temperature = Vec::new();
        if setup.heat == HeatModel::Learned {
            temperature = window.map(|frame| widen(trajectory.temperature_of(frame).unwrap_or_default())).collect();
            let sigma = settings.temperature_noise * setup.normalisation.change.map_or(0.0, |[_, scale]| scale);
            noise::warm(&mut temperature[..frames], &trajectory.kind, sigma, || normal.next());
        }
        Ok(Draw { trajectory, clean, noisy, temperature })
    }

    /// Positions as a tensor `[N, D]`.
    fn positions(&self, values: &[f64]) -> Result<Tensor> {
        let d = self.metadata.dim;
        Tensor::from_slice(values, (values.len() / d, d), &Device::Cpu)
    }

    /// The network's inputs after `unrolls` steps of its own, and the last temperatures `[N]` then, if it learns them.
    fn unroll(
        &self,
        draw: &Draw,
        unrolls: usize,
        network: &dyn Network,
        parameters: &[Tensor],
    ) -> anyhow::Result<(Inputs, Option<Tensor>)> {
        let (metadata, setup, frames) = (self.metadata, self.setup, self.setup.features.frames);
        let (scenery, dtype) = (Scenery::of(metadata, draw.trajectory), parameters[0].dtype());
        let mut window = Window {
            position: draw.noisy[..frames].to_vec(),
            temperature: draw.temperature.iter().take(frames).map(|t| column(t)).collect::<Result<_>>()?,
        };
        let mut inputs = setup.features.inputs(&scenery, &setup.normalisation, &window, None, dtype)?;
        // As in LagrangeBench: the first unrolled step sees the noisy frames and moves the true ones.
        let mut moved = draw.clean[..frames].iter().map(|p| self.positions(p)).collect::<Result<Vec<_>>>()?;
        for k in 0..unrolls {
            let output = network.apply(&inputs, parameters)?;
            let [.., before, last] = &moved[..] else { anyhow::bail!("a window of fewer than two frames") };
            let from = Inputs { velocity: displacement(last, before, metadata)?, ..inputs };
            let next = integrate::position(last, &from, &output, &setup.normalisation, metadata)?;
            let mut next = next.flatten_all()?.to_vec1::<f64>()?;
            hold(&mut next, &draw.clean[frames + k], &draw.trajectory.kind);
            if let Some(warm) = window.temperature.last() {
                let warmer = integrate::temperature(warm, &output, &setup.normalisation, metadata)?;
                let mut warmer = warmer.to_vec1::<f64>()?;
                let (before, truth) = (last.flatten_all()?.to_vec1::<f64>()?, &draw.temperature[frames + k]);
                settle_temperature(&scenery, &before, &next, Some(truth), &mut warmer);
                window.temperature.remove(0);
                window.temperature.push(column(&warmer)?);
            }
            moved.remove(0);
            moved.push(self.positions(&next)?);
            window.position = moved.clone();
            inputs = setup.features.inputs(&scenery, &setup.normalisation, &window, None, dtype)?;
        }
        Ok((inputs, window.temperature.pop()))
    }

    /// The normalised targets `[N, outputs]`, measured from the noisy frames, so that the network learns to remove the
    /// noise.
    fn target(&self, draw: &Draw, unrolls: usize, last_temperature: Option<&Tensor>) -> anyhow::Result<Tensor> {
        let (normalisation, frames) = (&self.setup.normalisation, self.setup.features.frames);
        let [before, last, next] = [2, 1, 0].map(|back| &draw.noisy[frames + unrolls - back]);
        let acceleration = target_acceleration([before, last, next], normalisation, self.metadata)?;
        let (Some(last), Some([mean, scale])) = (last_temperature, normalisation.change) else {
            return Ok(acceleration);
        };
        let (truth, last) = (&draw.temperature[frames + unrolls], last.to_vec1::<f64>()?);
        let change: Vec<f64> = truth.iter().zip(&last).map(|(truth, last)| (truth - last - mean) / scale).collect();
        Ok(Tensor::cat(&[acceleration, column(&change)?.unsqueeze(1)?], 1)?)
    }

    /// The mask `[N, outputs]`, 1 where the loss counts, that is where the network changes a particle.
    fn mask(&self, draw: &Draw, unrolls: usize) -> Result<Tensor> {
        let (kinds, outputs, d) = (&draw.trajectory.kind, self.setup.sizes.outputs, self.metadata.dim);
        let next = self.setup.features.frames + unrolls;
        let mut mask = vec![0.0; kinds.len() * outputs];
        for (i, _) in kinds.iter().enumerate().filter(|(_, &k)| !kind::is_kinematic(k)) {
            mask[i * outputs..(i + 1) * outputs].fill(1.0);
        }
        if let Some(heat) = self.metadata.heat.as_ref().filter(|_| self.setup.heat == HeatModel::Learned) {
            // A reset by the inlet is not an effect of the flow; the rollout applies it too.
            for i in 0..kinds.len() {
                let (from, to) = (draw.clean[next - 1][i * d], draw.clean[next][i * d]);
                if heat.resets(from, to, self.metadata.bounds[0]) {
                    mask[i * outputs + d] = 0.0;
                }
            }
        }
        Tensor::from_vec(mask, (kinds.len(), outputs), &Device::Cpu)
    }
}

/// The frames of a sample: inputs, target and unrolled steps.
struct Draw<'a> {
    trajectory: &'a Trajectory,
    /// Positions `[N, D]`.
    clean: Vec<Vec<f64>>,
    noisy: Vec<Tensor>,
    /// Temperatures `[N]`, the inputs with noise; empty where the network learns none.
    temperature: Vec<Vec<f64>>,
}

fn widen(values: &[f32]) -> Vec<f64> {
    values.iter().map(|&v| f64::from(v)).collect()
}

/// `[N]`.
fn column(values: &[f64]) -> Result<Tensor> {
    Tensor::from_slice(values, values.len(), &Device::Cpu)
}

/// Gives kinematic particles their true positions `[N, D]`.
fn hold(next: &mut [f64], truth: &[f64], kinds: &[i32]) {
    let d = truth.len() / kinds.len();
    for (i, _) in kinds.iter().enumerate().filter(|(_, &k)| kind::is_kinematic(k)) {
        next[i * d..(i + 1) * d].copy_from_slice(&truth[i * d..(i + 1) * d]);
    }
}

/// A different seed for each number (splitmix64's increment).
fn mixed(seed: u64, number: u64) -> u64 {
    seed.wrapping_add(number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}
