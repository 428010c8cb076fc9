//! A learned model as [`Dynamics`], with frames as steps, for gradients and objectives.
//!
//! The state `[W (D + 1) + F, N]` (f64; `[W D + F, N]` without heat) has the W input frames of the model, oldest first:
//! their positions in the data's coordinates, then their temperatures. The last F rows are the solver's constant state
//! of the walls, whose positions, mirror images and normals connect a design to the fields of an objective.
//!
//! ```text
//!   x_{k+1}, T_{k+1} = model(x_{k-W+1} ... x_k, T_{k-W+1} ... T_k),     u_k = (x_k - x_{k-1}) / (time between frames)
//! ```
//!
//! An objective gets the fields that the solver would show for these particles, by the same interpolation.

use crate::adjoint::dynamics::{Bytes, Dynamics, Fields, RunError};
use crate::adjoint::schedule::Costs;
use crate::dataset::extent::Extent;
use crate::dataset::record::kind_of;
use crate::dataset::Metadata;
use crate::numerics::candle::read;
use crate::particles::neighbour_list::NeighbourError;
use crate::particles::neighbourhood::Neighbourhood;
use crate::particles::tag;
use crate::sph::dynamics::Sph;
use crate::sph::solver::TensorSolver;
use crate::sph::Sweeps;
use crate::surrogate::differentiable_rollout::DifferentiableRollout;
use crate::surrogate::features::{displacement, Window};
use crate::surrogate::models::learned::Learned;
use crate::surrogate::predictor::Scenery;
use candle_core::{DType, Device, Tensor, Var};

/// A learned model for the particles of a scene.
pub struct LearnedFlow<R> {
    pub model: Learned,
    /// Metadata of the model's data.
    pub metadata: Metadata,
    /// The solver, which computes fields.
    pub sph: Sph<R>,
    /// Indices of the solver's particles that the data have.
    pub kept: Vec<u32>,
    /// Kinds and wall temperatures of these particles, `[n]`.
    pub kind: Vec<i32>,
    pub wall_temperature: Vec<f32>,
    /// Position of the data's origin in the scene.
    pub origin: Vec<f64>,
    /// The time of the last frame of the solver.
    pub begin: f64,
}

/// A particle has left an open box if it is this many box lengths outside.
const FAR: f64 = 0.5;

/// The state of a run without a graph, which is also the kept state of a schedule.
#[derive(Debug, Clone)]
pub struct At {
    pub step: usize,
    pub state: Tensor,
}

impl<R: Sweeps> LearnedFlow<R> {
    /// A model for the particles of a scene. `hot` is the temperature of its hot walls.
    pub fn new(model: Learned, metadata: Metadata, sph: Sph<R>, origin: Vec<f64>, hot: f32, begin: f64) -> Self {
        let tags = &sph.model.tags;
        let kept = (0..tags.len() as u32).filter(|&i| !tag::is_on_surface(tags[i as usize]));
        let (kept, tags): (Vec<u32>, Vec<u8>) = kept.map(|i| (i, tags[i as usize])).unzip();
        let kind = tags.iter().map(|&tag| kind_of(tag)).collect();
        let wall_temperature = tags.iter().map(|&tag| if tag == tag::HOT_WALL { hot } else { f32::NAN }).collect();
        Self { model, metadata, sph, kept, kind, wall_temperature, origin, begin }
    }

    fn frames(&self) -> usize {
        self.model.setup.features.frames
    }

    fn dimension(&self) -> usize {
        self.metadata.dim
    }

    /// Time between frames.
    pub fn frame_time(&self) -> f64 {
        self.metadata.dt * self.metadata.write_every as f64
    }

    /// Whether the frames have temperatures.
    fn is_warm(&self) -> bool {
        self.metadata.heat.is_some()
    }

    /// The first row of a frame's positions, and the row of its temperatures, if there is heat.
    pub fn rows(&self, frame: usize) -> (usize, usize) {
        (frame * self.dimension(), self.frames() * self.dimension() + frame)
    }

    /// The first row of the solver's state.
    pub fn solver_row(&self) -> usize {
        self.frames() * (self.dimension() + usize::from(self.is_warm()))
    }

    /// The constant inputs of the model.
    pub fn scenery(&self) -> Scenery<'_> {
        Scenery { metadata: &self.metadata, kind: &self.kind, wall_temperature: Some(&self.wall_temperature) }
    }

    /// The state `[W (D + 1) + F, N]` made from frames of the solver, oldest first, and the solver's initial state.
    /// Each frame has a state `[F, N]` and temperatures `[N]` as in the data.
    pub fn state(&self, frames: &[(Vec<f64>, Vec<f64>)], first: &[f64]) -> candle_core::Result<Tensor> {
        let (d, n, extent) = (self.dimension(), self.sph.model.particles(), Extent::of(&self.metadata));
        let mut state = Vec::with_capacity((self.solver_row() * n) + first.len());
        for (solver, _) in frames {
            for k in 0..d {
                let place = |x: &f64| extent.wrapped(k, x - self.origin[k]);
                state.extend(solver[k * n..(k + 1) * n].iter().map(place));
            }
        }
        frames.iter().for_each(|(_, temperature)| state.extend(temperature));
        state.extend(first);
        Tensor::from_vec(state, (self.solver_row() + first.len() / n, n), &Device::Cpu)
    }

    /// The input window of the model.
    fn window(&self, state: &Tensor) -> candle_core::Result<Window> {
        let kept = Tensor::from_slice(&self.kept, self.kept.len(), &Device::Cpu)?;
        let mut window = Window::default();
        for frame in 0..self.frames() {
            let (place, warmth) = self.rows(frame);
            window.position.push(state.narrow(0, place, self.dimension())?.index_select(&kept, 1)?.t()?.contiguous()?);
            if self.is_warm() {
                window.temperature.push(state.narrow(0, warmth, 1)?.index_select(&kept, 1)?.squeeze(0)?);
            }
        }
        Ok(window)
    }

    /// Extends rows of the kept particles, `[rows, n]`, to all, `[rows, N]`. The others get finite, unused values.
    fn spread(&self, rows: &Tensor) -> candle_core::Result<Tensor> {
        let mut place = vec![0_u32; self.sph.model.particles()];
        self.kept.iter().enumerate().for_each(|(k, &i)| place[i as usize] = k as u32);
        rows.contiguous()?.index_select(&Tensor::from_vec(place, self.sph.model.particles(), &Device::Cpu)?, 1)
    }

    fn next(&self, step: usize, state: &Tensor) -> Result<Tensor, RunError> {
        let failed = |error: anyhow::Error| match error.downcast::<NeighbourError>() {
            Ok(source) => RunError::Neighbours { step, source },
            Err(error) => RunError::Tensor { step, source: candle_core::Error::Msg(format!("{error:#}")) },
        };
        let go = || -> anyhow::Result<Tensor> {
            let window = self.window(state)?;
            let next = DifferentiableRollout::new(&self.model, self.scenery())?.advance(&window, None)?;
            let Some(position) = next.position.last() else { anyhow::bail!("a window without frames") };
            let (d, frames) = (self.dimension(), self.frames());
            let behind = |first: usize, count: usize| state.narrow(0, first, count);
            let mut rows = vec![behind(d, (frames - 1) * d)?, self.spread(&position.t()?)?];
            if let Some(temperature) = next.temperature.last() {
                rows.extend([behind(frames * d + 1, frames - 1)?, self.spread(&temperature.unsqueeze(0)?)?]);
            }
            rows.push(behind(self.solver_row(), state.dim(0)? - self.solver_row())?);
            Ok(Tensor::cat(&rows, 0)?)
        };
        go().map_err(failed)
    }

    /// The solver's state `[F, N]` for the last frame, on the graph if the state is.
    fn shown(&self, state: &Tensor) -> candle_core::Result<Tensor> {
        let (d, model) = (self.dimension(), &self.sph.model);
        let l = model.rows;
        let n = model.particles();
        let moves: Vec<f64> = (0..n).map(|i| if model.is_fluid(i) { 1.0 } else { 0.0 }).collect();
        let moves = Tensor::from_vec(moves, (1, n), &Device::Cpu)?;
        let stays = moves.affine(-1.0, 1.0)?;
        let (solver, last) = (self.solver_row(), self.frames() - 1);
        let frame = |k: usize| state.narrow(0, self.rows(k).0, d);
        // `displacement` needs `[N, D]`.
        let step =
            displacement(&frame(last)?.t()?.contiguous()?, &frame(last - 1)?.t()?.contiguous()?, &self.metadata)?;
        let velocity = step.t()?.contiguous()?.affine(1.0 / self.frame_time(), 0.0)?;
        let reference = model.heat.as_ref().map_or(0.0, |heat| heat.reference);
        let warmth = || state.narrow(0, self.rows(last).1, 1)?.affine(1.0, -reference);
        let temperature = self.is_warm().then(warmth).transpose()?;
        let mut rows = Vec::with_capacity(l.count());
        for row in 0..l.count() {
            let still = state.narrow(0, solver + row, 1)?;
            let moved = match (row, &temperature) {
                (row, _) if row < d => Some(frame(last)?.narrow(0, row, 1)?.affine(1.0, self.origin[row])?),
                (row, _) if (l.velocity()..l.velocity() + d).contains(&row) => {
                    Some(velocity.narrow(0, row - l.velocity(), 1)?)
                }
                (row, Some(temperature)) if Some(row) == l.temperature() => Some(temperature.clone()),
                _ => None,
            };
            rows.push(match moved {
                Some(moved) => (moved.broadcast_mul(&moves)? + still.broadcast_mul(&stays)?)?,
                None => still,
            });
        }
        Tensor::cat(&rows, 0)?.to_dtype(R::DTYPE)
    }

    /// The fields of a state, on the graph if it is.
    fn fields_at(&self, step: usize, state: &Tensor) -> Result<Fields, RunError> {
        let failed = RunError::tensor(step);
        let shown = self.shown(state).and_then(|shown| shown.contiguous()).map_err(&failed)?;
        let build = |numbers: &[R]| Ok(Neighbourhood::build(&self.sph.model.reach(), numbers));
        let list = read(&shown.detach(), build).map_err(&failed)?;
        let list = list.map_err(|source| RunError::Neighbours { step, source })?;
        let mut tape = TensorSolver::new(self.sph.model.clone(), list, step, 1, self.sph.compute.clone());
        let fields = self.sph.fields(&mut tape, &shown)?;
        Ok(Fields { step, time: self.begin + step as f64 * self.frame_time(), ..fields })
    }

    /// Memory of a state and of a taped step, estimated from the network's sizes and `pairs` of the graph (activations
    /// of the layers of each perceptron for nodes and edges, and features in double precision).
    pub fn costs(&self, pairs: usize) -> Costs {
        let (n, sizes) = (self.sph.model.particles(), &self.model.setup.sizes);
        let kept = self.kept.len();
        let state = (self.solver_row() + self.sph.model.rows.count()) * n * 8;
        let width = match self.model.parameters.first().map(Tensor::dtype) {
            Some(DType::F64) => 8,
            _ => 4,
        };
        let layers = (sizes.rounds + 1) * (sizes.linears + 1) * sizes.latent;
        let network = layers * (kept + pairs) * width;
        let features = 8 * (sizes.node_features * kept + sizes.edge_features * pairs) * 3;
        let tape_step = network + features + state;
        Costs {
            state,
            rounded_state: state / 2,
            shared: 0,
            shared_steps: 1,
            tape_step,
            tape_shared: 0,
            // The network of the plain run, the cotangents, and the fields of the objective.
            working: network + 4 * state,
        }
    }

    /// Approximate number of pairs in the model's graph.
    pub fn pairs(&self) -> usize {
        let reach = self.model.setup.normalisation.radius / (1.45 * self.metadata.dx);
        (PAIRS * reach.max(1.0).powi(self.dimension() as i32) * self.kept.len() as f64) as usize
    }
}

impl<R: Sweeps> Dynamics for LearnedFlow<R> {
    /// The state of the first frames.
    type Start = Tensor;
    type Kept = At;
    type Run = At;
    type Tape = usize;

    fn start(&self, from: &Tensor) -> Result<At, RunError> {
        Ok(At { step: 0, state: from.clone() })
    }
    fn advance(&self, run: &mut At) -> Result<(), RunError> {
        run.state = self.next(run.step, &run.state)?.detach();
        run.step += 1;
        Ok(())
    }
    fn step(&self, run: &At) -> usize {
        run.step
    }
    fn check(&self, run: &At) -> Result<(), RunError> {
        let numbers =
            run.state.flatten_all().and_then(|state| state.to_vec1::<f64>()).map_err(RunError::tensor(run.step))?;
        if let Some(at) = numbers.iter().position(|x| !x.is_finite()) {
            let (particle, value) = (at % self.sph.model.particles(), numbers[at]);
            return Err(RunError::NotFinite { step: run.step, field: "a predicted number", particle, value });
        }
        let (n, extent, last) =
            (self.sph.model.particles(), Extent::of(&self.metadata), self.rows(self.frames() - 1).0);
        for k in (0..self.dimension()).filter(|&k| !extent.domain.periodic[k]) {
            let (size, low) = (extent.domain.size[k], extent.low[k]);
            for &i in &self.kept {
                let x = numbers[(last + k) * n + i as usize];
                if (x - low - 0.5 * size).abs() > (0.5 + FAR) * size {
                    let (particle, limit) = (i as usize, low + (1.0 + FAR) * size);
                    let field = ["predicted x", "predicted y", "predicted z"][k];
                    return Err(RunError::Impossible { step: run.step, field, particle, value: x, limit });
                }
            }
        }
        Ok(())
    }
    fn look(&self, run: &mut At) -> Result<Fields, RunError> {
        self.fields_at(run.step, &run.state)
    }

    fn tensor(&self, from: &Tensor) -> Result<Tensor, RunError> {
        Ok(from.clone())
    }
    fn advance_taped(&self, tape: &mut usize, state: &Tensor, _: Option<&Tensor>) -> Result<Tensor, RunError> {
        let next = self.next(*tape, state)?;
        *tape += 1;
        Ok(next)
    }
    fn fields(&self, tape: &mut usize, state: &Tensor) -> Result<Fields, RunError> {
        self.fields_at(*tape, state)
    }

    fn keep(&self, run: &At, rounded: bool) -> Result<At, RunError> {
        let state = match rounded {
            true => run.state.to_dtype(DType::F32).map_err(RunError::tensor(run.step))?,
            false => run.state.clone(),
        };
        Ok(At { step: run.step, state })
    }
    fn settle(&self, _: &mut At, _: &At) {}
    fn resume(&self, run: &mut At, kept: &At) -> Result<(), RunError> {
        *run = At { step: kept.step, state: kept.state.to_dtype(DType::F64).map_err(RunError::tensor(kept.step))? };
        Ok(())
    }
    fn tape(&self, kept: &At, _: Option<usize>, _: &At) -> Result<(usize, Var), RunError> {
        let state = kept.state.to_dtype(DType::F64).and_then(|state| Var::from_tensor(&state));
        Ok((kept.step, state.map_err(RunError::tensor(kept.step))?))
    }

    fn kept_bytes(&self, kept: &At) -> Bytes {
        Bytes { own: kept.state.elem_count() * kept.state.dtype().size_in_bytes(), shared: 0, identity: 0 }
    }
    fn taped_bytes(&self, _: &usize) -> Bytes {
        Bytes { own: self.costs(self.pairs()).tape_step, shared: 0, identity: 0 }
    }
}

/// Approximate number of neighbours within 1.45 spacings, including the particle itself.
const PAIRS: f64 = 9.0;
