//! Input features of a model: features of nodes and edges from a window of frames.
//!
//! Node features, in this order (those of LagrangeBench, Toshev et al. 2023, then ours): W - 1 velocities (v -
//! mean)/s_v, oldest first; optionally their norms; clip([p - lo, hi - p]/r_c, -1, 1) in directions that are not
//! periodic; the external force if one is given, and that of the data's flow with `force`; with heat: W - 1 temperature changes and the temperature (normalised; 0 for
//! walls without a set temperature unless `unset_walls`), the set temperature of a wall (normalised, 0 where none is
//! set) and whether one is set, and the clipped distances to inlet and outlet. The model appends the embedding of the
//! particle's type. Edge features: displacement from sender to receiver over r_c, and its length (gradient 0 where it
//! is 0). s = sqrt(std^2 + noise^2) for velocity and acceleration.

use super::predictor::Scenery;
pub use crate::config::training::Features;
use crate::dataset::extent::Extent;
use crate::dataset::{kind, Heat, Metadata};
use crate::surrogate::network::graph::{Ends, Graph};
use candle_core::{DType, Device, Result, Tensor};
use serde::{Deserialize, Serialize};
use std::sync::Arc;

/// Number of particle types with an embedding, as in LagrangeBench. Type -1 (padding) has the last one, as in numpy.
pub const KINDS: usize = kind::COUNT as usize;

/// Means and standard deviations with which a model was trained; stored in its checkpoint.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Normalisation {
    /// `[D]`.
    pub velocity_mean: Vec<f64>,
    /// `[D]`, including noise.
    pub velocity_scale: Vec<f64>,
    pub acceleration_mean: Vec<f64>,
    pub acceleration_scale: Vec<f64>,
    /// Connectivity radius r_c.
    pub radius: f64,
    /// With heat: mean and standard deviation of the temperature and of its change per frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub temperature: Option<[f64; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change: Option<[f64; 2]>,
}

impl Normalisation {
    /// The normalisation of a data set, for training with this noise. `radius` is in units of length.
    pub fn new(metadata: &Metadata, noise: f64, radius: f64, heat: Option<&Heat>) -> Self {
        let scale = |std: &[f64]| std.iter().take(metadata.dim).map(|s| (s * s + noise * noise).sqrt()).collect();
        let first = |values: &[f64]| values[..metadata.dim].to_vec();
        Self {
            velocity_mean: first(&metadata.vel_mean),
            velocity_scale: scale(&metadata.vel_std),
            acceleration_mean: first(&metadata.acc_mean),
            acceleration_scale: scale(&metadata.acc_std),
            radius,
            temperature: heat.map(|h| [h.temperature_mean, h.temperature_std]),
            change: heat.map(|h| [h.change_mean, h.change_std]),
        }
    }

    /// Removes the means and uses one scale for all directions, so that rotated flows have rotated normalised values.
    pub fn make_isotropic(&mut self) {
        for (mean, scale) in [
            (&mut self.velocity_mean, &mut self.velocity_scale),
            (&mut self.acceleration_mean, &mut self.acceleration_scale),
        ] {
            let square: f64 = mean.iter().zip(scale.iter()).map(|(m, s)| m * m + s * s).sum();
            let root = (square / mean.len() as f64).sqrt();
            mean.fill(0.0);
            scale.fill(root);
        }
    }
}

/// The inputs of one prediction.
#[derive(Debug, Clone)]
pub struct Inputs {
    pub graph: Arc<Graph>,
    /// Node features `[N, F]` without the embedding.
    pub nodes: Tensor,
    /// Edge features `[E, D + 1]`.
    pub edges: Tensor,
    /// Indices into the embedding, `[N]` u32.
    pub kinds: Tensor,
    /// Last velocities, `[N, D]`, in units of length per frame, not normalised.
    pub velocity: Tensor,
}

/// Positions `[N, D]` (f64) and temperatures `[N]` of each frame of a window, oldest first.
#[derive(Debug, Clone, Default)]
pub struct Window {
    pub position: Vec<Tensor>,
    pub temperature: Vec<Tensor>,
}

impl Features {
    /// Number of node features without the embedding. `force`: components of an external force.
    pub fn count(&self, metadata: &Metadata, heat: bool, force: usize) -> usize {
        let (steps, open) = (self.frames - 1, metadata.periodic().iter().take(metadata.dim).filter(|p| !**p).count());
        steps * metadata.dim
            + if self.speed { steps } else { 0 }
            + if self.boundary { 2 * open } else { 0 }
            + force
            + if self.force { metadata.dim } else { 0 }
            + if heat { steps + 5 } else { 0 }
    }

    /// The features of a window; `force` is `[N, D]`, if there is one. They are computed in f64 and rounded to `dtype`
    /// at the end, because differences of f32 positions would lose half their digits.
    ///
    /// # Errors
    /// Lost or clumped particles, tensor errors.
    pub fn inputs(
        &self,
        scenery: &Scenery,
        normalisation: &Normalisation,
        window: &Window,
        force: Option<&Tensor>,
        dtype: DType,
    ) -> anyhow::Result<Inputs> {
        let metadata = scenery.metadata;
        let frames = &window.position[window.position.len() - self.frames..];
        let last = &frames[self.frames - 1];
        let graph = Arc::new(graph(last, metadata, normalisation.radius)?);
        let mut columns = Vec::new();
        let mut velocity = last.clone();
        let row = |values: &[f64]| Tensor::from_slice(values, (1, metadata.dim), &Device::Cpu);
        let (mean, scale) = (row(&normalisation.velocity_mean)?, row(&normalisation.velocity_scale)?);
        for pair in frames.windows(2) {
            velocity = displacement(&pair[1], &pair[0], metadata)?;
            columns.push(velocity.broadcast_sub(&mean)?.broadcast_div(&scale)?);
        }
        if self.speed {
            let speeds: Vec<Tensor> = columns.iter().map(length).collect::<Result<_>>()?;
            columns.extend(speeds);
        }
        if self.boundary {
            columns.extend(ends_of_the_box(last, metadata, normalisation.radius)?);
        }
        columns.extend(force.cloned());
        if self.force {
            columns.push(external_force(last, metadata)?);
        }
        columns.extend(self.heat(scenery, normalisation, window, last)?);
        let nodes = Tensor::cat(&columns, 1)?.to_dtype(dtype)?;

        let ends = Ends::new(&graph, last.device())?;
        let (to, from) = (ends.of_receivers(last)?, ends.of_senders(last)?);
        let relative = (displacement(&to, &from, metadata)? / normalisation.radius)?;
        let edges = Tensor::cat(&[&relative, &length(&relative)?], 1)?.to_dtype(dtype)?;
        let kinds: Vec<u32> = scenery.kind.iter().map(|&k| if k == kind::PADDING { 8 } else { k as u32 }).collect();
        Ok(Inputs { graph, nodes, edges, kinds: Tensor::new(kinds, &Device::Cpu)?, velocity })
    }

    /// The columns that exist only with heat.
    fn heat(
        &self,
        scenery: &Scenery,
        normalisation: &Normalisation,
        window: &Window,
        last: &Tensor,
    ) -> Result<Vec<Tensor>> {
        let (Some([t_mean, t_scale]), Some([c_mean, c_scale])) = (normalisation.temperature, normalisation.change)
        else {
            return Ok(Vec::new());
        };
        let temperature = &window.temperature[window.temperature.len() - self.frames..];
        let mut columns = Vec::new();
        let set = |i: usize| scenery.wall_temperature.is_some_and(|wall| wall[i].is_finite());
        let seen = |i: usize| self.unset_walls || set(i) || !kind::is_kinematic(scenery.kind[i]);
        let seen: Vec<f64> = (0..scenery.kind.len()).map(|i| if seen(i) { 1.0 } else { 0.0 }).collect();
        let seen = Tensor::from_vec(seen, (scenery.kind.len(), 1), &Device::Cpu)?;
        for pair in temperature.windows(2) {
            columns.push((&pair[1] - &pair[0])?.affine(1.0 / c_scale, -c_mean / c_scale)?.unsqueeze(1)?.mul(&seen)?);
        }
        let now = temperature[self.frames - 1].affine(1.0 / t_scale, -t_mean / t_scale)?;
        columns.push(now.unsqueeze(1)?.mul(&seen)?);
        let (mut set, mut is_set) = (vec![0.0; scenery.kind.len()], vec![0.0; scenery.kind.len()]);
        for (i, &t) in scenery.wall_temperature.unwrap_or_default().iter().enumerate() {
            if t.is_finite() {
                (set[i], is_set[i]) = ((f64::from(t) - t_mean) / t_scale, 1.0);
            }
        }
        for column in [set, is_set] {
            let n = column.len();
            columns.push(Tensor::from_vec(column, (n, 1), &Device::Cpu)?);
        }
        // For heat both ends of the channel are boundaries, although the flow is periodic there.
        let (bounds, radius) = (scenery.metadata.bounds[0], normalisation.radius);
        columns.extend([distance(last, 0, bounds, true, radius)?, distance(last, 0, bounds, false, radius)?]);
        Ok(columns)
    }
}

/// The graph of all pairs within the radius, for positions `[N, D]`.
fn graph(position: &Tensor, metadata: &Metadata, radius: f64) -> anyhow::Result<Graph> {
    let mut corner = position.detach().flatten_all()?.to_vec1::<f64>()?;
    let extent = Extent::of(metadata);
    corner.iter_mut().enumerate().for_each(|(at, x)| *x = extent.from_corner(at % metadata.dim, *x));
    Ok(Graph::build(&corner, &metadata.domain(), radius)?)
}

/// The external force of a data set's flow on particles at positions `[N, D]`, constant in derivatives.
fn external_force(position: &Tensor, metadata: &Metadata) -> anyhow::Result<Tensor> {
    let Some(force) = metadata.external_force() else { anyhow::bail!("the data have no external force") };
    let numbers = position.detach().flatten_all()?.to_vec1::<f64>()?;
    let d = metadata.dim;
    let of = |place: &[f64]| force.at(place[1]).into_iter().take(d);
    let all: Vec<f64> = numbers.chunks(d).flat_map(of).collect();
    Ok(Tensor::from_vec(all, position.shape(), &Device::Cpu)?)
}

/// Distances to the lower, then to the upper ends of the directions that are not periodic.
fn ends_of_the_box(position: &Tensor, metadata: &Metadata, radius: f64) -> Result<Vec<Tensor>> {
    let open: Vec<usize> = (0..metadata.dim).filter(|&d| !metadata.periodic()[d]).collect();
    let all = [true, false].into_iter().flat_map(|low| open.iter().map(move |&d| (low, d)));
    all.map(|(low, d)| distance(position, d, metadata.bounds[d], low, radius)).collect()
}

/// Distance `[N, 1]` from the lower or upper end of the box in direction `d`, over the radius, clipped.
fn distance(position: &Tensor, d: usize, [lo, hi]: [f64; 2], low: bool, radius: f64) -> Result<Tensor> {
    let x = position.narrow(1, d, 1)?;
    let distance = if low { (x - lo)? } else { x.affine(-1.0, hi)? };
    (distance / radius)?.clamp(-1.0, 1.0)
}

/// Norm of each row, `[rows, 1]`, with gradient 0 at 0.
fn length(x: &Tensor) -> Result<Tensor> {
    let square = x.sqr()?.sum_keepdim(1)?;
    let zero = square.eq(0.0)?;
    // Adds 1 under the root where the row is 0, so that its derivative is finite, and subtracts it again.
    let one = zero.to_dtype(square.dtype())?;
    ((square + &one)?.sqrt()? - one)?.contiguous()
}

/// a - b to the nearest image in periodic directions, `[N, D]`.
pub fn displacement(a: &Tensor, b: &Tensor, metadata: &Metadata) -> Result<Tensor> {
    let domain = metadata.domain();
    by_direction(&(a - b)?, metadata, |d, difference| domain.nearest_of(d, difference))
}

/// Positions wrapped into the box in periodic directions, `[N, D]`.
pub fn wrap(position: &Tensor, metadata: &Metadata) -> Result<Tensor> {
    let domain = metadata.domain();
    by_direction(position, metadata, |d, coordinate| match (domain.periodic[d], metadata.bounds[d][0]) {
        (true, low) => domain.wrapped_of(d, &(coordinate - low)?)? + low,
        (false, _) => Ok(coordinate.clone()),
    })
}

/// Maps the columns of `x` `[N, D]` by direction, if any direction is periodic.
fn by_direction(x: &Tensor, metadata: &Metadata, f: impl Fn(usize, &Tensor) -> Result<Tensor>) -> Result<Tensor> {
    if !metadata.periodic().contains(&true) {
        return Ok(x.clone());
    }
    let columns = (0..metadata.dim).map(|d| f(d, &x.narrow(1, d, 1)?)).collect::<Result<Vec<_>>>()?;
    Tensor::cat(&columns, 1)?.contiguous()
}
