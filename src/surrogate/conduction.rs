//! The solver's heat conduction along a given motion, such as that of a learned model.
//!
//! dT_i/dt = (1/m_i) (2 k/c_p) sum_j V_i V_j F_ij (T_i - T_j), as in [`crate::sph::laws::conduction`], over the time
//! between two frames in stable explicit steps, with positions on straight lines between the frames. The density is a
//! sum over fluid and walls, as in the solver; all particles have the mass rho dx^D of the flat channel. Walls have
//! their set temperature according to the data; other walls take the mean of their fluid neighbours (Adami, Hu and
//! Adams 2012), so they are adiabatic. Fluid at x < `inlet_length` keeps the inlet's temperature; fluid in the outlet
//! does not conduct.

use super::predictor::{Frame, Scenery};
use crate::dataset::extent::Extent;
use crate::dataset::{kind, Heat, Metadata};
use crate::numerics::gather::Gather;
use crate::particles::neighbour_list::NeighbourList;
use crate::particles::{tag, Domain};
use crate::sph::kernels::{Kernel, KernelName};
use crate::sph::laws::conduction;
use candle_core::{Device, Result, Tensor};

/// dt <= this h^2/alpha, the solver's default time.diffusion_number.
const DIFFUSION_NUMBER: f64 = 0.25;

pub struct Conduction<'a> {
    scenery: Scenery<'a>,
    heat: &'a Heat,
    domain: Domain,
    kernel: Kernel,
    tags: Vec<u8>,
}

impl<'a> Conduction<'a> {
    /// # Errors
    /// The data have no temperature.
    pub fn new(scenery: &Scenery<'a>) -> anyhow::Result<Self> {
        let metadata: &'a Metadata = scenery.metadata;
        let Some(heat) = &metadata.heat else { anyhow::bail!("the data set has no heat, so nothing conducts") };
        let domain = metadata.domain();
        let tags = scenery.kind.iter().map(|&k| if k == kind::FLUID { tag::FLUID } else { tag::WALL }).collect();
        Ok(Self {
            scenery: *scenery,
            heat,
            domain,
            kernel: Kernel::new(KernelName::QuinticSpline, metadata.dim, metadata.dx),
            tags,
        })
    }

    /// Temperatures `[N]` one frame later, when the particles are at `next` `[N, D]`.
    ///
    /// # Errors
    /// Lost or clumped particles, a frame without temperature.
    pub fn advance(&self, from: &Frame, next: &[f64]) -> anyhow::Result<Vec<f64>> {
        let metadata = self.scenery.metadata;
        let Some(mut temperature) = from.temperature.clone() else { anyhow::bail!("a frame has no temperature") };
        let (steps, dt) = self.steps();
        let (d, n, extent) = (metadata.dim, temperature.len(), Extent::of(metadata));
        for step in 0..steps {
            // The positions half way through the step.
            let part = (step as f64 + 0.5) / steps as f64;
            let mut position = vec![0.0; d * n];
            for i in 0..n {
                for k in 0..d {
                    let x = from.position[i * d + k];
                    position[k * n + i] = extent.from_corner(k, x + part * extent.shortest(k, next[i * d + k] - x));
                }
            }
            let rate = self.rate(&position, &temperature)?;
            for i in 0..n {
                temperature[i] += dt * rate[i];
                if self.is_inlet(i, position[i]) {
                    temperature[i] = self.heat.inlet_temperature;
                }
            }
        }
        Ok(temperature)
    }

    /// Number of steps between two frames, and their length.
    fn steps(&self) -> (usize, f64) {
        let metadata = self.scenery.metadata;
        let time = metadata.dt * metadata.write_every as f64;
        let most = DIFFUSION_NUMBER * metadata.dx * metadata.dx / self.heat.diffusivity;
        let steps = (time / most).ceil().max(1.0) as usize;
        (steps, time / steps as f64)
    }

    /// Whether a particle at x, relative to the box's corner, is fluid at the inlet.
    fn is_inlet(&self, i: usize, x: f64) -> bool {
        self.tags[i] == tag::FLUID && x < self.heat.inlet_length - self.scenery.metadata.bounds[0][0]
    }

    /// Whether a particle at x is fluid that conducts.
    fn conducts(&self, i: usize, x: f64) -> bool {
        let (heat, [low, high]) = (self.heat, self.scenery.metadata.bounds[0]);
        self.tags[i] == tag::FLUID && x + low >= heat.inlet_length && x + low <= high - heat.outlet_length
    }

    /// [`Self::advance`] on candle's graph, in f64: positions `[N, D]` and temperatures `[N]` of a frame, and the
    /// positions one frame later. Neighbours, and which particles are at the inlet, are constant.
    ///
    /// # Errors
    /// Lost or clumped particles, tensor errors.
    pub fn advance_on_graph(&self, from: &Tensor, temperature: &Tensor, next: &Tensor) -> anyhow::Result<Tensor> {
        let (steps, dt) = self.steps();
        let (n, d, extent) = (self.tags.len(), self.domain.dimension, Extent::of(self.scenery.metadata));
        let column = |of: &Tensor, k: usize| of.narrow(1, k, 1)?.t()?.contiguous();
        let mut way = Vec::with_capacity(d);
        for k in 0..d {
            let x = column(from, k)?;
            let distance = self.domain.nearest_of(k, &(column(next, k)? - &x)?)?;
            way.push((x.affine(1.0, -extent.low[k])?, distance));
        }
        let mut temperature = temperature.unsqueeze(0)?;
        for step in 0..steps {
            let part = (step as f64 + 0.5) / steps as f64;
            let at =
                |(k, (x, way)): (usize, &(Tensor, Tensor))| self.domain.wrapped_of(k, &(x + way.affine(part, 0.0)?)?);
            let position = way.iter().enumerate().map(at).collect::<Result<Vec<_>>>()?;
            let position = Tensor::cat(&position, 0)?;
            let numbers = position.detach().flatten_all()?.to_vec1::<f64>()?;
            let rate = self.rate_on_graph(&position, &numbers, &temperature)?;
            let warmed = (&temperature + rate.affine(dt, 0.0)?)?;
            let open = mask((0..n).map(|i| !self.is_inlet(i, numbers[i])))?;
            let inlet = open.affine(-self.heat.inlet_temperature, self.heat.inlet_temperature)?;
            temperature = (warmed.mul(&open)? + inlet)?;
        }
        Ok(temperature.squeeze(0)?)
    }

    /// [`Self::rate`] `[1, N]` for positions `[D, N]`, as a tensor and as numbers, and temperatures `[1, N]`.
    fn rate_on_graph(&self, position: &Tensor, numbers: &[f64], temperature: &Tensor) -> anyhow::Result<Tensor> {
        let n = self.tags.len();
        let pairs = self.pairs(numbers)?;
        let (i, j): (Vec<u32>, Vec<u32>) = pairs.iter().map(|pair| (pair.i as u32, pair.j as u32)).unzip();
        let (i, j) = (Gather::new(&i, n, &Device::Cpu)?, Gather::new(&j, n, &Device::Cpu)?);
        let (own, other, sums) =
            (|of: &Tensor| i.rows(of, 1), |of: &Tensor| j.rows(of, 1), |of: &Tensor| i.sums(of, 1));
        let square = |k: usize| {
            let x = position.narrow(0, k, 1)?;
            self.domain.nearest_of(k, &(own(&x)? - other(&x)?)?)?.sqr()
        };
        let square = (1..self.domain.dimension).try_fold(square(0)?, |sum, k| sum + square(k)?)?;
        let (weight, slope) = self.kernel.composed(&square.sqrt()?)?;
        let weights = sums(&weight)?;
        let fluid = mask(self.tags.iter().map(|&tag| tag == tag::FLUID))?;
        let walls = fluid.affine(-1.0, 1.0)?;
        let metadata = self.scenery.metadata;
        let (itself, lattice) = (self.kernel.at_zero(), metadata.dx.powi(metadata.dim as i32));
        let volume = (weights.affine(1.0, itself)?.recip()?.mul(&fluid)? + walls.affine(lattice, 0.0)?)?;
        // Walls with fluid in reach have its mean, or are mirrored at a set temperature.
        let seen = weights.detach().flatten_all()?.to_vec1::<f64>()?;
        let sees = |i: usize| self.tags[i] != tag::FLUID && seen[i] != 0.0;
        let set = |i: usize| self.scenery.wall_temperature.map_or(f32::NAN, |w| w[i]);
        let takes = mask((0..n).map(sees))?;
        let mirrors = mask((0..n).map(|i| sees(i) && set(i).is_finite()))?;
        let given = (0..n).map(|i| if sees(i) && set(i).is_finite() { 2.0 * f64::from(set(i)) } else { 0.0 });
        let given = Tensor::from_vec(given.collect::<Vec<_>>(), (1, n), &Device::Cpu)?;
        let mean = sums(&weight.mul(&other(temperature)?)?)?.mul(&takes)?;
        let mean = mean.div(&(weights.mul(&takes)? + takes.affine(-1.0, 1.0)?)?)?;
        let wall = (mean.mul(&mirrors.affine(-2.0, 1.0)?)? + given)?;
        let now = (temperature.mul(&takes.affine(-1.0, 1.0)?)? + wall)?;
        let difference = (own(&now)? - other(&now)?)?;
        let flows = sums(&own(&volume)?.mul(&other(&volume)?)?.mul(&slope)?.mul(&difference)?)?;
        let conducting = mask((0..n).map(|i| self.conducts(i, numbers[i])))?;
        Ok(flows.div(&volume)?.mul(&conducting)?.affine(2.0 * self.heat.diffusivity, 0.0)?)
    }

    /// dT/dt `[N]`. `position` is `[D, N]` relative to the box's corner.
    fn rate(&self, position: &[f64], temperature: &[f64]) -> anyhow::Result<Vec<f64>> {
        let (n, metadata) = (temperature.len(), self.scenery.metadata);
        let is_fluid = |i: usize| self.tags[i] == tag::FLUID;
        let pairs = self.pairs(position)?;
        let sums = |of: &dyn Fn(&Pair) -> f64| {
            let mut sums = vec![0.0; n];
            pairs.iter().for_each(|pair| sums[pair.i] += of(pair));
            sums
        };
        let weights = sums(&|pair| pair.weight);
        // 1/sum_j W_ij, which is m/rho for equal masses; walls have the lattice's volume.
        let (itself, lattice) = (self.kernel.at_zero(), metadata.dx.powi(metadata.dim as i32));
        let volume = |i: usize| if is_fluid(i) { 1.0 / (itself + weights[i]) } else { lattice };
        let volume: Vec<f64> = (0..n).map(volume).collect();
        let means = sums(&|pair| pair.weight * temperature[pair.j]);
        let wall = |i: usize| {
            let set = self.scenery.wall_temperature.map_or(f32::NAN, |w| w[i]);
            let mean = means[i] / weights[i];
            // A set temperature holds on the wall's surface, midway between a dummy particle and the fluid.
            match set.is_finite() {
                true => 2.0 * f64::from(set) - mean,
                false => mean,
            }
        };
        let now = |i: usize| if is_fluid(i) || weights[i] == 0.0 { temperature[i] } else { wall(i) };
        let now: Vec<f64> = (0..n).map(now).collect();
        let flows = sums(&|pair| {
            let Pair { i, j, slope, .. } = *pair;
            conduction::flow([volume[i], volume[j]], slope, [now[i], now[j]])
        });
        // Over m_i = rho_i V_i: 2 alpha = 2 k/(c rho) at the reference density.
        let rate = |i: usize| match self.conducts(i, position[i]) {
            true => 2.0 * self.heat.diffusivity / volume[i] * flows[i],
            false => 0.0,
        };
        Ok((0..n).map(rate).collect())
    }

    /// All pairs of fluid with fluid and walls, and of walls with fluid.
    fn pairs(&self, position: &[f64]) -> anyhow::Result<Vec<Pair>> {
        let (n, d) = (self.tags.len(), self.domain.dimension);
        let list = NeighbourList::build(position, &self.tags, &self.domain, self.kernel.cutoff(), 32)?;
        let mut pairs = Vec::new();
        for &i in list.fluid_rows.iter().chain(&list.wall_rows) {
            let i = i as usize;
            for &j in &list.row(i)[..list.count[i] as usize] {
                let j = j as usize;
                let apart = |k: usize| self.domain.nearest(k, position[k * n + i] - position[k * n + j]);
                let (weight, slope) = self.kernel.pair((0..d).map(|k| apart(k).powi(2)).sum::<f64>());
                pairs.push(Pair { i, j, weight, slope });
            }
        }
        Ok(pairs)
    }
}

/// 1 where a condition holds, `[1, N]`.
fn mask(of: impl Iterator<Item = bool>) -> Result<Tensor> {
    let values: Vec<f64> = of.map(|is| if is { 1.0 } else { 0.0 }).collect();
    let n = values.len();
    Tensor::from_vec(values, (1, n), &Device::Cpu)
}

/// Two neighbouring particles.
struct Pair {
    i: usize,
    j: usize,
    /// W.
    weight: f64,
    /// F = W'(d)/d.
    slope: f64,
}
