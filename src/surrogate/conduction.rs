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
use crate::numerics::lanes::{Lanes, PortableF64};
use crate::particles::neighbour_list::NeighbourList;
use crate::particles::{tag, Domain};
use crate::sph::kernels::{Kernel, KernelName};

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

    /// dT/dt `[N]`; also sets the walls' temperatures. `position` is `[D, N]`, from the box's corner.
    fn rate(&self, position: &[f64], temperature: &[f64]) -> anyhow::Result<Vec<f64>> {
        let (metadata, heat) = (self.scenery.metadata, self.heat);
        let n = temperature.len();
        let list = NeighbourList::build(position, &self.tags, &self.domain, 3.0 * metadata.dx, 32)?;
        let inverse = self.domain.inverse_period();
        let kernel = self.kernel.lanes::<PortableF64>();
        let value = |lanes: PortableF64| lanes.sum() / PortableF64::COUNT as f64;
        let square = |i: usize, j: usize| {
            (0..metadata.dim)
                .map(|k| {
                    let dr = position[k * n + i] - position[k * n + j];
                    let dr = dr - metadata.size()[k] * (dr * inverse[k]).round();
                    dr * dr
                })
                .sum::<f64>()
        };
        let row = |i: usize| list.row(i)[..list.count[i] as usize].iter().map(|&j| j as usize);
        let weight = |i: usize, j: usize| value(kernel.value(PortableF64::splat(square(i, j))));
        // Volumes: 1/sum_j W_ij, which is m/rho for equal masses; walls have that of the lattice, as in the solver.
        let spacing = metadata.dx.powi(metadata.dim as i32);
        let itself = value(kernel.value(PortableF64::splat(0.0)));
        let volume: Vec<f64> = (0..n)
            .map(|i| {
                if self.tags[i] == tag::FLUID {
                    1.0 / (itself + row(i).map(|j| weight(i, j)).sum::<f64>())
                } else {
                    spacing
                }
            })
            .collect();
        let mut now = temperature.to_vec();
        for &i in &list.wall_rows {
            let i = i as usize;
            let set = self.scenery.wall_temperature.map_or(f32::NAN, |w| w[i]);
            let (mut sum, mut weights) = (0.0, f64::MIN_POSITIVE);
            for j in row(i) {
                let w = weight(i, j);
                sum += w * temperature[j];
                weights += w;
            }
            let mean = sum / weights;
            // A set temperature holds on the wall's surface, midway between a dummy particle and the fluid.
            now[i] = if set.is_finite() { 2.0 * f64::from(set) - mean } else { mean };
        }
        let (low, high) = (metadata.bounds[0][0], metadata.bounds[0][1]);
        let conducts = |x: f64| x + low >= heat.inlet_length && x + low <= high - heat.outlet_length;
        let mut rate = vec![0.0; n];
        for &i in &list.fluid_rows {
            let i = i as usize;
            if !conducts(position[i]) {
                continue;
            }
            let flow: f64 = row(i)
                .map(|j| volume[j] * value(kernel.slope(PortableF64::splat(square(i, j)))) * (now[i] - now[j]))
                .sum();
            // V_i/m_i = 1/rho_i: with 2 alpha = 2 k/(c rho) at the reference density.
            rate[i] = 2.0 * heat.diffusivity * flow;
        }
        Ok(rate)
    }
}
