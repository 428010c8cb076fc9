//! The standard method: a flow, and the laws and fields that a scene chooses.

use super::layout::Layout;
use super::pair_cache::PairCache;
use crate::numerics::lanes::Real;
use crate::numerics::pool::Pool;
use crate::sph::flow::Flow;
use crate::sph::laws::{DensityGradient, Flux, Further, Slip};
use candle_core::{Result, Tensor};
use std::ops::Deref;

/// The laws that a scene chooses. The default has pair forces and no-slip walls, and no transport velocity.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Laws<R> {
    /// Strength of the transport velocity; 0 switches it off.
    pub transport: f64,
    pub further: Further,
    /// Whether an evolved density is renormalised in each step, see [`super::renormalisation`].
    pub renormalises: bool,
    pub flux: Flux,
    pub slip: Slip,
    /// Unit normals of the walls into the fluid, `[D, N]`, 0 for fluid; none where no law needs them.
    pub normals: Option<Vec<R>>,
}

impl<R> Laws<R> {
    /// Whether a flux or a boundary condition needs the walls' normals.
    pub fn asks_for_normals(flux: &Flux, slip: Slip) -> bool {
        slip == Slip::Free || matches!(flux, Flux::Riemann(_))
    }
}

/// Density by summation or continuity, pair forces, background pressure (Adami, Hu and Adams 2012, 2013), as in
/// JAX-SPH.
#[derive(Debug, Clone)]
pub struct Standard<R> {
    pub flow: Flow<R>,
    pub layout: Layout,
    pub laws: Laws<R>,
    /// A pool of the caches that the operators of a step share.
    pub(super) caches: Pool<PairCache<R>>,
}

impl<R: Real> Standard<R> {
    /// The flow with these laws. `layout` chooses the fields; `flow.rows` is replaced by the rows of its state.
    pub fn new(flow: Flow<R>, layout: Layout, laws: Laws<R>) -> Self {
        Self { flow: Flow { rows: layout.rows(), ..flow }, layout, laws, caches: Pool::default() }
    }

    /// The default laws: pair forces, summed densities, and one mass of all particles.
    pub fn plain(flow: Flow<R>) -> Self {
        let dimension = flow.dimension();
        let layout = Layout { dimension, transport: false, heat: flow.heat.is_some(), mass: false, density: false };
        Self::new(flow, layout, Laws::default())
    }

    /// Whether every operator of a step has a fused kernel. Otherwise steps use candle's operators in any case: with the
    /// density's gradients as JAX-SPH has them, and for Riemann problems with several materials or a transport velocity.
    pub fn is_fused(&self) -> bool {
        match self.laws.flux {
            Flux::Pair => true,
            Flux::Delta(diffusion) => !self.layout.density || diffusion.gradient == DensityGradient::Renormalised,
            Flux::Riemann(_) => {
                let materials = self.heat.as_ref().is_some_and(|heat| heat.materials.is_some());
                !self.layout.transport && !materials
            }
        }
    }

    /// Component `d` of the unit normal of a wall's particle; 0 where the scene has no normals.
    #[inline(always)]
    pub fn normal(&self, d: usize, i: usize) -> R {
        self.laws.normals.as_ref().map_or(R::default(), |normals| normals[d * self.particles() + i])
    }

    /// The walls' normals `[D, N]`; 0 where the scene has none.
    pub fn normals(&self, like: &Tensor) -> Result<Tensor> {
        let (n, d) = (self.particles(), self.layout.dimension);
        let normals = self.laws.normals.clone().unwrap_or_else(|| vec![R::default(); d * n]);
        Tensor::from_vec(normals, (d, n), like.device())?.to_dtype(like.dtype())
    }
}

impl<R> Deref for Standard<R> {
    type Target = Flow<R>;

    fn deref(&self) -> &Flow<R> {
        &self.flow
    }
}
