//! Loss and gradient of a batch, whose samples may be distributed over ranks.
//!
//! With R ranks, rank r has the places r, r + R, ... of a batch. It adds the gradients of its samples. Those of the
//! last sample are sent parameter by parameter while the backward pass still continues, and MPI adds those of all
//! ranks. Single-precision numbers are added in double precision: such a sum is exact unless they differ by more than
//! 2^29, so its order hardly ever matters. (In single precision it would matter at once: AdamW's first steps are as
//! long as the rate for any gradient, so the sign of the smallest decides.) In the ordered mode the order never
//! matters: the gradients of all samples are gathered and added in the order of the places, with the same bits for any
//! number of ranks, for R times the traffic.

use crate::numerics::candle::read;
use crate::numerics::interrupt;
use crate::numerics::ranks::{Exchange, How, Ranks};
use crate::surrogate::network::parameters::{detached, tracked, Network, Parameter};
use crate::surrogate::training::loss::loss;
use crate::surrogate::training::samples::{Sample, Samples};
use candle_core::{CpuStorage, CustomOp1, DType, Device, Layout, Result, Shape, Tensor};
use std::sync::{Arc, Mutex, MutexGuard};

/// Settings that all ranks of a training share.
#[derive(Clone, Copy)]
pub struct Team<'a> {
    pub ranks: &'a Ranks,
    /// Whether gradients are added in the order of the places.
    pub is_ordered: bool,
}

impl Team<'static> {
    /// A single process.
    pub const ALONE: Self = Self { ranks: &Ranks::ALONE, is_ordered: false };
}

/// The result of a batch.
pub struct Found {
    /// Mean loss of the batch.
    pub loss: f64,
    /// Gradient of the loss, in the order of the parameters.
    pub gradients: Vec<Tensor>,
    /// Whether any rank was asked to stop.
    pub is_to_stop: bool,
}

impl Team<'_> {
    /// Mean loss and gradient of the batch of a step, the same on all ranks.
    ///
    /// # Errors
    /// Samples that cannot be made, a parameter without a gradient, tensor errors.
    pub fn gradient(
        &self,
        samples: &mut Samples,
        step: u64,
        batch_size: usize,
        network: &dyn Network,
        weight: f64,
        dimension: usize,
    ) -> anyhow::Result<Found> {
        let (rank, size) = (self.ranks.rank(), self.ranks.size());
        let (plain, share) = (detached(network), 1.0 / batch_size as f64);
        let rounds = batch_size / size;
        let mut values = Vec::with_capacity(rounds + 1);
        let mut sum = Sums::default();
        for round in 0..rounds {
            let sample = samples.sample(step, (round * size + rank) as u64, network, &plain)?;
            if size == 1 || (!self.is_ordered && round + 1 < rounds) {
                let (value, gradients) = gradient(network, &tracked(network), &sample, weight, dimension)?;
                values.push(value);
                sum.add(&gradients)?;
                continue;
            }
            let (how, before) =
                if self.is_ordered { (How::Gather, Sums::default()) } else { (How::Sum, std::mem::take(&mut sum)) };
            let taps = Taps::new(self.ranks, how, before, network)?;
            values.push(gradient(network, &taps.tensors, &sample, weight, dimension)?.0);
            for found in taps.wait(network)? {
                sum.join(found);
            }
        }
        values.push(f64::from(interrupt::asked().unwrap_or(0)));
        let all = self.ranks.all(&values);
        let of_rank = |rank: usize| &all[rank * values.len()..][..values.len()];
        let mut loss = 0.0;
        for round in 0..rounds {
            for rank in 0..size {
                loss += share * of_rank(rank)[round];
            }
        }
        let signal = (0..size).map(|rank| of_rank(rank)[rounds] as i32).find(|&signal| signal != 0);
        if let Some(signal) = signal {
            interrupt::others_answered();
            interrupt::ask(signal);
        }
        Ok(Found { loss, gradients: sum.mean(share, network)?, is_to_stop: signal.is_some() })
    }
}

/// Sums of gradients, in the order of the parameters; empty before the first.
#[derive(Default)]
struct Sums(Vec<Vec<f64>>);

impl Sums {
    fn join(&mut self, term: Vec<Vec<f64>>) {
        if self.0.is_empty() {
            self.0 = term;
            return;
        }
        for (sum, term) in self.0.iter_mut().zip(term) {
            sum.iter_mut().zip(term).for_each(|(sum, term)| *sum += term);
        }
    }

    fn add(&mut self, gradients: &[Tensor]) -> Result<()> {
        self.join(gradients.iter().map(widened).collect::<Result<_>>()?);
        Ok(())
    }

    /// The mean gradients of the parameters.
    fn mean(self, share: f64, network: &dyn Network) -> Result<Vec<Tensor>> {
        let of = |(sum, parameter): (Vec<f64>, &Parameter)| {
            let mean: Vec<f32> = sum.iter().map(|sum| (share * sum) as f32).collect();
            Tensor::from_vec(mean, parameter.values.shape(), &Device::Cpu)
        };
        self.0.into_iter().zip(network.parameters()).map(of).collect()
    }
}

fn widened(numbers: &Tensor) -> Result<Vec<f64>> {
    read(&numbers.contiguous()?, |numbers: &[f32]| Ok(numbers.iter().map(|&x| f64::from(x)).collect()))
}

/// Loss and gradient of one sample, in the order of the parameters. `parameters` are the network's, tracked.
///
/// # Errors
/// A parameter without a gradient, tensor errors.
fn gradient(
    network: &dyn Network,
    parameters: &[Tensor],
    sample: &Sample,
    weight: f64,
    dimension: usize,
) -> anyhow::Result<(f64, Vec<Tensor>)> {
    let output = network.apply(&sample.inputs, parameters)?;
    let dynamics = |t: &Tensor| t.narrow(1, 0, dimension);
    let mut total = loss(&dynamics(&output)?, &dynamics(&sample.target)?, &dynamics(&sample.mask)?)?;
    let outputs = output.dim(1)?;
    if outputs > dimension {
        let heat = |t: &Tensor| t.narrow(1, dimension, outputs - dimension);
        total = (total + (loss(&heat(&output)?, &heat(&sample.target)?, &heat(&sample.mask)?)? * weight)?)?;
    }
    let value = total.to_dtype(DType::F64)?.to_scalar::<f64>()?;
    let mut store = total.backward()?;
    let mut gradients = Vec::new();
    for parameter in network.parameters() {
        gradients.push(store.remove(&parameter.values).ok_or_else(|| unreached(parameter))?);
    }
    Ok((value, gradients))
}

/// The error for a parameter that the loss does not depend on.
pub(super) fn unreached(parameter: &Parameter) -> anyhow::Error {
    let names: Vec<&str> = parameter.parts.iter().map(|(name, ..)| name.as_str()).collect();
    anyhow::anyhow!("no gradient reached {}: this is a bug of hydrograd's, please report it", names.join(", "))
}

/// The parameters with taps. A tap sends the gradient of a parameter as soon as the backward pass has completed it.
struct Taps {
    /// In the order of the parameters.
    tensors: Vec<Tensor>,
    sent: Arc<Mutex<Vec<Option<Exchange>>>>,
}

impl Taps {
    /// `before` is added to the gradients that are sent, if there is any.
    fn new(ranks: &Ranks, how: How, before: Sums, network: &dyn Network) -> Result<Self> {
        let sent = Arc::new(Mutex::new(network.parameters().iter().map(|_| None).collect()));
        let mut before = before.0.into_iter();
        let tensors = tracked(network).into_iter().enumerate().map(|(parameter, tensor)| {
            let before = Mutex::new(before.next());
            // A tap is part of candle's graph, which needs a static lifetime.
            tensor.apply_op1(Tap { ranks: ranks.clone(), how, before, parameter, sent: sent.clone() })
        });
        Ok(Self { tensors: tensors.collect::<Result<_>>()?, sent })
    }

    /// The sums of all ranks, or the gradients that each of them sent.
    fn wait(self, network: &dyn Network) -> anyhow::Result<Vec<Vec<Vec<f64>>>> {
        drop(self.tensors);
        let sent: Vec<_> = lock(&self.sent).drain(..).collect();
        let mut found: Vec<Vec<Vec<f64>>> = Vec::new();
        for (parameter, exchange) in network.parameters().iter().zip(sent) {
            let numbers = exchange.ok_or_else(|| unreached(parameter))?.wait();
            let count = parameter.count();
            found.resize_with(numbers.len() / count, Vec::new);
            for (found, numbers) in found.iter_mut().zip(numbers.chunks(count)) {
                found.push(numbers.to_vec());
            }
        }
        Ok(found)
    }
}

struct Tap {
    ranks: Ranks,
    how: How,
    before: Mutex<Option<Vec<f64>>>,
    parameter: usize,
    sent: Arc<Mutex<Vec<Option<Exchange>>>>,
}

impl CustomOp1 for Tap {
    fn name(&self) -> &'static str {
        "tap"
    }

    fn cpu_fwd(&self, storage: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let numbers = storage.as_slice::<f32>()?;
        let Some((from, to)) = layout.contiguous_offsets() else {
            candle_core::bail!("a tap needs contiguous parameters")
        };
        Ok((CpuStorage::F32(numbers[from..to].to_vec()), layout.shape().clone()))
    }

    fn bwd(&self, _: &Tensor, _: &Tensor, bar: &Tensor) -> Result<Option<Tensor>> {
        let mut numbers = widened(bar)?;
        if let Some(before) = lock(&self.before).take() {
            numbers.iter_mut().zip(before).for_each(|(sum, before)| *sum += before);
        }
        let mut sent = lock(&self.sent);
        sent.iter_mut().flatten().for_each(Exchange::go_on);
        sent[self.parameter] = self.ranks.begin(numbers, self.how);
        Ok(Some(bar.clone()))
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(|broken| broken.into_inner())
}
