//! Training samples: which window belongs to a step, and what the model sees and should say.
//!
//! All that is random follows from seed, step and place in the batch, so a resumed training goes on as if it had never
//! stopped.

use crate::config::training::{HeatModel, Settings};
use crate::dataset::{kind, Metadata, Trajectory};
use crate::error::BadInput;
use crate::numerics::random::{stream, uniform, Normal};
use crate::surrogate::features::{wrap, Inputs, Window};
use crate::surrogate::integrate;
use crate::surrogate::models::setup::Setup;
use crate::surrogate::network::parameters::Network;
use crate::surrogate::predictor::Scenery;
use crate::surrogate::training::loss::target_acceleration;
use crate::surrogate::training::noise;
use candle_core::{Device, Tensor};

/// Windows of the training split, stride 1.
pub struct Samples<'a> {
    metadata: &'a Metadata,
    trajectories: &'a [Trajectory],
    settings: &'a Settings,
    setup: &'a Setup,
    /// Frames of a window: inputs, target, unrolled steps.
    length: usize,
    /// Windows before each trajectory's first.
    before: Vec<usize>,
    count: usize,
    /// The epoch whose order is known, and the order.
    order: (u64, Vec<u32>),
}

/// One sample, ready for the model.
pub struct Sample {
    pub inputs: Inputs,
    /// `[N, outputs]`, normalised.
    pub target: Tensor,
    /// `[N, outputs]`: 1 where the loss counts.
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
    ) -> Result<Self, BadInput> {
        let length = setup.features.frames + 1 + settings.pushforward.most();
        let mut before = Vec::with_capacity(trajectories.len());
        let mut count = 0;
        for trajectory in trajectories {
            before.push(count);
            count += (trajectory.frames + 1).saturating_sub(length);
            if setup.heat != HeatModel::None && trajectory.temperature.is_none() {
                return Err(BadInput::new(format!("trajectory {} has no temperature", trajectory.name))
                    .allowed("temperature [T, N] in every trajectory")
                    .advice("--set model.heat=none"));
            }
        }
        if count == 0 {
            return Err(BadInput::new(format!("no training trajectory has the {length} frames of a window"))
                .allowed(format!("trajectories of at least {length} frames"))
                .advice("generate longer ones, or fewer pushforward.unrolls"));
        }
        Ok(Self { metadata, trajectories, settings, setup, length, before, count, order: (u64::MAX, Vec::new()) })
    }

    /// How many windows there are.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Trajectory and first frame of the sample `number`, counted over all steps: every epoch goes through all windows, in
    /// an order of its own.
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

    /// The sample of a step and a place in its batch. `parameters` are detached: for the unrolled steps.
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
        let (trajectory, start) = self.window(number);
        let (metadata, setup, settings) = (self.metadata, self.setup, self.settings);
        let (n, d, frames) = (trajectory.particles, metadata.dim, setup.features.frames);
        let scenery = Scenery::of(metadata, trajectory);
        let tensor = |values: Vec<f64>| Tensor::from_vec(values, (n, d), &Device::Cpu);
        let widen = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect::<Vec<f64>>();

        let mut chance = stream(mixed(settings.seed, number), "unrolls");
        let unrolls = settings.pushforward.unrolls(step, uniform(&mut chance));
        let clean: Vec<Vec<f64>> =
            (start..start + self.length).map(|frame| widen(trajectory.position_of(frame))).collect();
        let mut noisy = clean.clone();
        let mut normal = Normal::new(stream(mixed(settings.seed, number), "noise"));
        if settings.noise > 0.0 {
            let z: Vec<f64> = (0..n * (frames - 1) * d).map(|_| normal.next()).collect();
            noise::walk(&mut noisy, &trajectory.kind, &z, settings.noise, frames);
        }
        let noisy: Vec<Tensor> =
            noisy.into_iter().map(|p| wrap(&tensor(p)?, metadata)).collect::<candle_core::Result<_>>()?;
        let heat = setup.heat == HeatModel::Learned;
        let mut temperature = Vec::new();
        if heat {
            let of = |frame| widen(trajectory.temperature_of(frame).unwrap_or_default());
            temperature = (start..start + self.length).map(of).collect::<Vec<_>>();
            let sigma = settings.temperature_noise * setup.normalisation.change.map_or(0.0, |[_, scale]| scale);
            noise::warm(&mut temperature[..frames], &trajectory.kind, sigma, || normal.next());
        }
        let warm = |values: &Vec<f64>| Tensor::from_slice(values, n, &Device::Cpu);

        let mut window = Window {
            position: noisy[..frames].to_vec(),
            temperature: temperature.iter().take(frames).map(warm).collect::<candle_core::Result<_>>()?,
        };
        let dtype = parameters[0].dtype();
        let mut inputs = setup.features.inputs(&scenery, &setup.normalisation, &window, None, dtype)?;
        // As LagrangeBench: the first unrolled step sees the noisy frames and moves the true ones.
        let mut moved = clean[..frames].iter().map(|p| tensor(p.clone())).collect::<candle_core::Result<Vec<_>>>()?;
        for k in 0..unrolls {
            let output = network.apply(&inputs, parameters)?;
            let last_position = moved[frames - 1].clone();
            let velocity = crate::surrogate::features::displacement(&last_position, &moved[frames - 2], metadata)?;
            let from = Inputs { velocity, ..inputs.clone() };
            let next = integrate::position(&last_position, &from, &output, &setup.normalisation, metadata)?;
            let mut next = next.flatten_all()?.to_vec1::<f64>()?;
            let truth = &clean[frames + k];
            for (i, _) in trajectory.kind.iter().enumerate().filter(|(_, &k)| kind::is_kinematic(k)) {
                next[i * d..(i + 1) * d].copy_from_slice(&truth[i * d..(i + 1) * d]);
            }
            if heat {
                let last = &window.temperature[frames - 1];
                let warmer = integrate::temperature(last, &output, &setup.normalisation, metadata)?;
                let mut warmer = warmer.to_vec1::<f64>()?;
                let before = last_position.flatten_all()?.to_vec1::<f64>()?;
                crate::surrogate::evaluation::rollout::settle_temperature(
                    &scenery,
                    &before,
                    &next,
                    Some(&temperature[frames + k]),
                    &mut warmer,
                );
                window.temperature.remove(0);
                window.temperature.push(warm(&warmer)?);
            }
            moved.remove(0);
            moved.push(tensor(next)?);
            window.position = moved.clone();
            inputs = setup.features.inputs(&scenery, &setup.normalisation, &window, None, dtype)?;
        }

        let at = frames - 2 + unrolls;
        let target = target_acceleration([&noisy[at], &noisy[at + 1], &noisy[at + 2]], &setup.normalisation, metadata)?;
        let outputs = setup.sizes.outputs;
        let mut mask = vec![0.0; n * outputs];
        for (i, &k) in trajectory.kind.iter().enumerate() {
            if !kind::is_kinematic(k) {
                mask[i * outputs..(i + 1) * outputs].fill(1.0);
            }
        }
        let mut columns = vec![target];
        if let (true, Some([mean, scale])) = (heat, setup.normalisation.change) {
            let truth = &temperature[frames + unrolls];
            let last = window.temperature[frames - 1].to_vec1::<f64>()?;
            let change: Vec<f64> = (0..n).map(|i| (truth[i] - last[i] - mean) / scale).collect();
            columns.push(Tensor::from_vec(change, (n, 1), &Device::Cpu)?);
            if let Some(heat) = &metadata.heat {
                // What the inlet resets is no work of the flow; the rollout does it too.
                for i in 0..n {
                    let (from, to) = (clean[frames + unrolls - 1][i * d], clean[frames + unrolls][i * d]);
                    if heat.resets(from, to, metadata.bounds[0]) {
                        mask[i * outputs + d] = 0.0;
                    }
                }
            }
        }
        Ok(Sample {
            inputs,
            target: Tensor::cat(&columns, 1)?.to_dtype(dtype)?,
            mask: Tensor::from_vec(mask, (n, outputs), &Device::Cpu)?.to_dtype(dtype)?,
        })
    }
}

/// A seed of its own for each number (splitmix64's increment).
fn mixed(seed: u64, number: u64) -> u64 {
    seed.wrapping_add(number.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}
