//! The solver's heat conduction along a motion that somebody else made, such as a learned one.
//!
//! dT_i/dt = (1/m_i) (2 k/c_p) sum_j V_i V_j F_ij (T_i - T_j), as in [`crate::sph::laws::conduction`], over the time between two
//! frames in explicit steps that are stable, with positions on the straight way from one frame to the next. Density by
//! summation over fluid and walls, as the solver's; all particles have the mass rho dx^D of the flat channel. Walls
//! with a set temperature are at it where the data say so, other walls take their fluid neighbours' mean (Adami, Hu and
//! Adams 2012), so no heat flows through them. Fluid at x < `inlet_length` stays at the inlet's temperature, fluid behind
//! the outlet's edge does not conduct.

use super::predictor::{Frame, Scenery};
use crate::dataset::extent::Extent;
use crate::dataset::{kind, Heat, Metadata};
use crate::particles::neighbour_list::NeighbourList;
use crate::particles::{tag, Domain};
use crate::sph::kernels::{Kernel, KernelName};
use crate::sph::laws::conduction;

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

    /// Temperatures `[N]` one frame later, when particles have come to `next` `[N, D]`.
    ///
    /// # Errors
    /// Lost or clumped particles, a frame without temperature.
    pub fn advance(&self, from: &Frame, next: &[f64]) -> anyhow::Result<Vec<f64>> {
        let metadata = self.scenery.metadata;
        let Some(mut temperature) = from.temperature.clone() else { anyhow::bail!("a frame has no temperature") };
        let time = metadata.dt * metadata.write_every as f64;
        let most = DIFFUSION_NUMBER * metadata.dx * metadata.dx / self.heat.diffusivity;
        let steps = (time / most).ceil().max(1.0) as usize;
        let dt = time / steps as f64;
        let (d, n, extent) = (metadata.dim, temperature.len(), Extent::of(metadata));
        for step in 0..steps {
            // The middle of the step's stretch of the way.
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
                if self.tags[i] == tag::FLUID && position[i] < self.heat.inlet_length - extent.low[0] {
                    temperature[i] = self.heat.inlet_temperature;
                }
            }
        }
        Ok(temperature)
    }

    /// dT/dt `[N]`. `position` is `[D, N]`, from the box's corner.
    fn rate(&self, position: &[f64], temperature: &[f64]) -> anyhow::Result<Vec<f64>> {
        let n = temperature.len();
        let pairs = self.pairs(position)?;
        let sums = |of: &dyn Fn(&Pair) -> f64| {
            let mut sums = vec![0.0; n];
            pairs.iter().for_each(|pair| sums[pair.i] += of(pair));
            sums
        };
        let weights = sums(&|pair| pair.weight);
        let volume = self.volumes(&weights);
        let means = sums(&|pair| pair.weight * temperature[pair.j]);
        let now = self.with_walls(temperature, &means, &weights);
        let flows = sums(&|pair| {
            let Pair { i, j, slope, .. } = *pair;
            conduction::flow([volume[i], volume[j]], slope, [now[i], now[j]])
        });
        let (heat, [low, high]) = (self.heat, self.scenery.metadata.bounds[0]);
        let conducts = |x: f64| x + low >= heat.inlet_length && x + low <= high - heat.outlet_length;
        let conducts = |i: usize| self.tags[i] == tag::FLUID && conducts(position[i]);
        // Over m_i = rho_i V_i: with 2 alpha = 2 k/(c rho) at the reference density.
        let rate = |i: usize| if conducts(i) { 2.0 * heat.diffusivity / volume[i] * flows[i] } else { 0.0 };
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

    /// 1/sum_j W_ij, which is m/rho for equal masses, from the sums over the neighbours; walls have that of the lattice, as
    /// in the solver.
    fn volumes(&self, weights: &[f64]) -> Vec<f64> {
        let metadata = self.scenery.metadata;
        let (itself, lattice) = (self.kernel.at_zero(), metadata.dx.powi(metadata.dim as i32));
        let volume = |(&tag, sum): (&u8, &f64)| if tag == tag::FLUID { 1.0 / (itself + sum) } else { lattice };
        self.tags.iter().zip(weights).map(volume).collect()
    }

    /// Temperatures with those of the walls set, from the sums of their neighbours' temperatures by weight.
    fn with_walls(&self, temperature: &[f64], means: &[f64], weights: &[f64]) -> Vec<f64> {
        let wall = |i: usize| {
            let set = self.scenery.wall_temperature.map_or(f32::NAN, |w| w[i]);
            let mean = means[i] / weights[i];
            // A set temperature holds on the wall's surface, midway between a dummy particle and the fluid.
            if set.is_finite() {
                2.0 * f64::from(set) - mean
            } else {
                mean
            }
        };
        let now = |i: usize| if self.tags[i] == tag::FLUID || weights[i] == 0.0 { temperature[i] } else { wall(i) };
        (0..temperature.len()).map(now).collect()
    }
}

/// Two particles that see each other.
struct Pair {
    i: usize,
    j: usize,
    /// W.
    weight: f64,
    /// F = W'(d)/d.
    slope: f64,
}
