//! Multilayer perceptron on blocks of rows: linear, ReLU, ..., linear, and layer normalisation behind it.
//!
//! y = LN(relu(... relu(x W0 + b0) ...) W + b), LN(z) = (z - mean z)/sqrt(var z + 1e-5) * scale + offset over each row (Ba,
//! Kiros and Hinton 2016, with the biased variance). Weights are stored `[in, out]`. Rows go through in blocks that
//! stay in a core's cache; what the adjoint needs again (activations behind each ReLU, normalised rows) is kept.

use crate::numerics::candle::Operator;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::{Buffer, Buffers};
use crate::numerics::sweep::{run_rows, RowKernel, Shared};
use crate::surrogate::network::matrix;
use crate::surrogate::network::row;
use candle_core::Result;
use std::ops::Range;
use std::sync::Mutex;

/// Of the layer normalisation, as haiku's and PyTorch's.
pub const EPSILON: f64 = 1e-5;
/// Bytes of one matrix of a block: half a dozen of them stay in a second-level cache of 1 MB.
const BLOCK_BYTES: usize = 1 << 17;

/// Sizes of a perceptron, and where its parameters stand in its flat vector.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MlpShape {
    pub inputs: usize,
    pub hidden: usize,
    pub outputs: usize,
    /// Linear layers, at least 2.
    pub linears: usize,
    /// Whether a layer normalisation follows.
    pub norm: bool,
}

impl MlpShape {
    /// Inputs and outputs of layer k.
    pub fn size(&self, k: usize) -> (usize, usize) {
        let inputs = if k == 0 { self.inputs } else { self.hidden };
        (inputs, if k + 1 == self.linears { self.outputs } else { self.hidden })
    }

    /// Where layer k begins.
    fn layer(&self, k: usize) -> usize {
        (0..k).map(|k| self.size(k)).map(|(inputs, outputs)| (inputs + 1) * outputs).sum()
    }

    /// Weight `[in, out]` of layer k.
    pub fn weight(&self, k: usize) -> Range<usize> {
        let (inputs, outputs) = self.size(k);
        let at = self.layer(k);
        at..at + inputs * outputs
    }

    pub fn bias(&self, k: usize) -> Range<usize> {
        let at = self.weight(k).end;
        at..at + self.size(k).1
    }

    /// Scale of the normalisation; empty without one.
    pub fn scale(&self) -> Range<usize> {
        let at = self.layer(self.linears);
        at..at + if self.norm { self.outputs } else { 0 }
    }

    pub fn offset(&self) -> Range<usize> {
        let at = self.scale().end;
        at..at + self.scale().len()
    }

    /// Length of the parameter vector.
    pub fn parameters(&self) -> usize {
        self.offset().end
    }

    /// Names (behind a prefix), places and shapes of the parameters, as PyTorch or haiku would list them.
    pub fn names(&self) -> Vec<(String, Range<usize>, Vec<usize>)> {
        let mut names = Vec::new();
        for k in 0..self.linears {
            let (inputs, outputs) = self.size(k);
            names.push((format!("{k}.weight"), self.weight(k), vec![inputs, outputs]));
            names.push((format!("{k}.bias"), self.bias(k), vec![outputs]));
        }
        if self.norm {
            names.push(("ln.scale".to_owned(), self.scale(), vec![self.outputs]));
            names.push(("ln.offset".to_owned(), self.offset(), vec![self.outputs]));
        }
        names
    }

    /// Rows that go through together.
    pub fn block<R>(&self) -> usize {
        (BLOCK_BYTES / (self.hidden * std::mem::size_of::<R>())).clamp(32, 1024)
    }

    /// Matrices of hidden activations per row.
    pub fn hidden_per_row(&self) -> usize {
        (self.linears - 1) * self.hidden
    }
}

/// What the forward pass leaves for the adjoint.
#[derive(Debug)]
pub struct Activations<R: Real> {
    /// `[linears - 1, rows, hidden]`: behind each ReLU.
    hidden: Buffer<R>,
    /// `[rows, outputs]`: normalised, before scale and offset; without normalisation the output.
    normalised: Buffer<R>,
    /// `[rows]`: 1/sqrt(var + epsilon).
    inverse: Buffer<R>,
    rows: usize,
}

impl<R: Real> Activations<R> {
    pub fn new(memory: &Buffers<R>, shape: &MlpShape, rows: usize) -> Self {
        Self {
            hidden: memory.buffer(rows * shape.hidden_per_row()),
            normalised: memory.buffer(rows * shape.outputs),
            inverse: memory.buffer(if shape.norm { rows } else { 0 }),
            rows,
        }
    }

    pub fn shared(&mut self) -> SharedActivations<'_, R> {
        SharedActivations {
            hidden: Shared::new(&mut self.hidden),
            normalised: Shared::new(&mut self.normalised),
            inverse: Shared::new(&mut self.inverse),
            rows: self.rows,
        }
    }
}

/// [`Activations`], written and read by several threads, each its own rows.
pub struct SharedActivations<'a, R> {
    hidden: Shared<'a, R>,
    normalised: Shared<'a, R>,
    inverse: Shared<'a, R>,
    rows: usize,
}

impl<R: Real> SharedActivations<'_, R> {
    /// Hidden activations of layer k of some rows.
    ///
    /// # Safety
    /// No other thread may access these rows, and no other slice of them may be alive.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn hidden(&self, shape: &MlpShape, k: usize, rows: Range<usize>) -> &mut [R] {
        let at = k * self.rows;
        // SAFETY: by the contract.
        unsafe { self.hidden.slice((at + rows.start) * shape.hidden..(at + rows.end) * shape.hidden) }
    }

    /// Normalised rows.
    ///
    /// # Safety
    /// As for `hidden`.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    pub unsafe fn normalised(&self, shape: &MlpShape, rows: Range<usize>) -> &mut [R] {
        // SAFETY: by the contract.
        unsafe { self.normalised.slice(rows.start * shape.outputs..rows.end * shape.outputs) }
    }

    /// # Safety
    /// As for `hidden`.
    #[inline(always)]
    #[allow(clippy::mut_from_ref)]
    unsafe fn inverse(&self, shape: &MlpShape, rows: Range<usize>) -> &mut [R] {
        // SAFETY: by the contract.
        unsafe { self.inverse.slice(if shape.norm { rows } else { 0..0 }) }
    }
}

/// From the activations of the first hidden layer on: fills the further ones and the normalised rows.
///
/// # Safety
/// No other thread may access these rows of `layers`.
#[inline(always)]
pub unsafe fn forward_block<L: Lanes>(
    shape: &MlpShape,
    p: &[L::Real],
    layers: &SharedActivations<L::Real>,
    rows: Range<usize>,
) {
    let count = rows.len();
    for k in 1..shape.linears - 1 {
        // SAFETY: by the contract; the layers k - 1 and k are different places.
        let (before, after) =
            unsafe { (layers.hidden(shape, k - 1, rows.clone()), layers.hidden(shape, k, rows.clone())) };
        matrix::multiply(after, before, &p[shape.weight(k)], (count, shape.hidden, shape.hidden), false);
        row::activate::<L>(after, &p[shape.bias(k)]);
    }
    let last = shape.linears - 1;
    // SAFETY: by the contract.
    let (hidden, z, inverse) = unsafe {
        (
            layers.hidden(shape, last - 1, rows.clone()),
            layers.normalised(shape, rows.clone()),
            layers.inverse(shape, rows.clone()),
        )
    };
    matrix::multiply(z, hidden, &p[shape.weight(last)], (count, shape.hidden, shape.outputs), false);
    let bias = &p[shape.bias(last)];
    let width = L::Real::of(1.0 / shape.outputs as f64);
    for (r, z) in z.chunks_exact_mut(shape.outputs).enumerate() {
        row::each::<L, 1>(z, [bias], |z, [b]| z + b);
        if shape.norm {
            let mean = row::sum::<L>(z, z, |z, _| z) * width;
            let middle = L::splat(mean);
            let variance = row::sum::<L>(z, z, |z, _| (z - middle) * (z - middle)) * width;
            let scale = L::Real::of(1.0) / (variance + L::Real::of(EPSILON)).sqrt();
            inverse[r] = scale;
            let scale = L::splat(scale);
            row::each::<L, 0>(z, [], |z, []| (z - middle) * scale);
        }
    }
}

/// Room for the cotangents of a block.
pub struct Cotangents<R: Real> {
    /// `[rows, outputs]`.
    pub z: Buffer<R>,
    /// `[rows, hidden]`: of the sums of the first layer.
    pub first: Buffer<R>,
    /// `[rows, hidden]` between the layers; empty where there are no more than two.
    pub between: Buffer<R>,
}

impl<R: Real> Cotangents<R> {
    /// `first`: whether the first layer's are kept here too.
    pub fn new(memory: &Buffers<R>, shape: &MlpShape, rows: usize, first: bool) -> Self {
        let hidden = |wanted: bool| memory.buffer(if wanted { rows * shape.hidden } else { 0 });
        Self { z: memory.buffer(rows * shape.outputs), first: hidden(first), between: hidden(shape.linears > 2) }
    }
}

/// From the cotangent `z_bar` of the output (which is overwritten) back to that of the first layer's sums, `first`; adds to
/// the gradient `g` of all parameters but the first weight.
///
/// # Safety
/// No other thread may access these rows of `layers`.
#[inline(always)]
#[allow(clippy::too_many_arguments)]
pub unsafe fn backward_block<L: Lanes>(
    shape: &MlpShape,
    p: &[L::Real],
    layers: &SharedActivations<L::Real>,
    rows: Range<usize>,
    z_bar: &mut [L::Real],
    g: &mut [L::Real],
    first: &mut [L::Real],
    between: &mut [L::Real],
) {
    let count = rows.len();
    let last = shape.linears - 1;
    let width = L::Real::of(1.0 / shape.outputs as f64);
    // SAFETY: by the contract.
    let (normalised, inverse) =
        unsafe { (&*layers.normalised(shape, rows.clone()), &*layers.inverse(shape, rows.clone())) };
    if shape.norm {
        let scale = &p[shape.scale()];
        let (scale_bar, offset_bar) = g[shape.scale().start..shape.offset().end].split_at_mut(shape.outputs);
        row::add_rows::<L, 2>(scale_bar, [z_bar, normalised], |[y, x]| y * x);
        row::add_rows::<L, 1>(offset_bar, [z_bar], |[y]| y);
        for r in 0..count {
            let row = r * shape.outputs..(r + 1) * shape.outputs;
            let (y_bar, x) = (&mut z_bar[row.clone()], &normalised[row]);
            row::each::<L, 1>(y_bar, [scale], |y, [scale]| y * scale);
            let mean = row::sum::<L>(y_bar, y_bar, |y, _| y) * width;
            let along = row::sum::<L>(y_bar, x, |y, x| y * x) * width;
            let [mean, along, inverse] = [mean, along, inverse[r]].map(L::splat);
            row::each::<L, 1>(y_bar, [x], |y, [x]| (y - mean - x * along) * inverse);
        }
    }
    row::add_rows::<L, 1>(&mut g[shape.bias(last)], [z_bar], |[bar]| bar);
    for k in (1..=last).rev() {
        // SAFETY: by the contract.
        let hidden = unsafe { &*layers.hidden(shape, k - 1, rows.clone()) };
        let outputs = shape.size(k).1;
        // They take turns so that layer 1 ends in `first`.
        let (to, before) = if k % 2 == 1 { (&mut *first, &*between) } else { (&mut *between, &*first) };
        let length = count * shape.hidden;
        let (to, from) = (&mut to[..length], if k == last { &*z_bar } else { &before[..length] });
        matrix::add_transposed(&mut g[shape.weight(k)], hidden, from, (shape.hidden, count, outputs));
        matrix::multiply_by_transposed(to, from, &p[shape.weight(k)], (count, outputs, shape.hidden), false);
        row::each::<L, 1>(to, [hidden], |bar, [hidden]| L::zero().select_less(hidden, bar, L::zero()));
        row::add_rows::<L, 1>(&mut g[shape.bias(k - 1)], [to], |[bar]| bar);
    }
}

/// How many parts the rows are dealt in: each has its own sum of the parameters' gradients, so the number must not depend
/// on the threads. A power of two, as numbers of threads mostly are.
pub fn parts(rows: usize) -> usize {
    1 << (rows / 512).clamp(1, 16).ilog2()
}

/// Part `k` of `parts` of some rows.
pub fn part(rows: usize, parts: usize, k: usize) -> Range<usize> {
    rows * k / parts..rows * (k + 1) / parts
}

/// Numbers per row of the sweep over a gradient.
const ROW: usize = 4096;

struct Sum<'a, R> {
    sum: Shared<'a, R>,
    length: usize,
    parts: &'a [R],
}

impl<R: Real> RowKernel<R> for Sum<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        for row in rows {
            let range = row * ROW..self.length.min((row + 1) * ROW);
            // SAFETY: each range belongs to one iteration.
            let sum = unsafe { self.sum.slice(range.clone()) };
            for (k, part) in self.parts.chunks_exact(self.length).enumerate() {
                let part = &part[range.clone()];
                if k == 0 {
                    sum.copy_from_slice(part);
                } else {
                    row::each::<L, 1>(sum, [part], |sum, [x]| sum + x);
                }
            }
        }
    }
}

/// `sum` <- the gradients of the parts added up in their order.
pub fn sum_of_parts<R: Real>(sum: &mut [R], parts: &[R]) {
    let length = sum.len();
    run_rows(&Sum { sum: Shared::new(sum), length, parts }, length.div_ceil(ROW));
}

/// x `[rows, inputs]`, parameters `[P]` -> `[rows, outputs]`.
pub struct Mlp<R: Real> {
    pub shape: MlpShape,
    memory: Buffers<R>,
    activations: Mutex<Option<Activations<R>>>,
}

impl<R: Real> Mlp<R> {
    pub fn new(shape: MlpShape, memory: &Buffers<R>) -> Self {
        Self { shape, memory: memory.clone(), activations: Mutex::new(None) }
    }
}

struct Forward<'a, R: Real> {
    shape: &'a MlpShape,
    x: &'a [R],
    p: &'a [R],
    layers: SharedActivations<'a, R>,
    y: Shared<'a, R>,
    rows: usize,
    parts: usize,
}

impl<R: Real> RowKernel<R> for Forward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (shape, p) = (self.shape, self.p);
        for rows in range.flat_map(|k| blocks(part(self.rows, self.parts, k), shape.block::<R>())) {
            let size = (rows.len(), shape.inputs, shape.hidden);
            // SAFETY: each part's rows belong to one iteration.
            unsafe {
                let hidden = self.layers.hidden(shape, 0, rows.clone());
                let x = &self.x[rows.start * shape.inputs..rows.end * shape.inputs];
                matrix::multiply(hidden, x, &p[shape.weight(0)], size, false);
                row::activate::<L>(hidden, &p[shape.bias(0)]);
                forward_block::<L>(shape, p, &self.layers, rows.clone());
                let y = self.y.slice(rows.start * shape.outputs..rows.end * shape.outputs);
                let z = &*self.layers.normalised(shape, rows);
                if shape.norm {
                    let (scale, offset) = (&p[shape.scale()], &p[shape.offset()]);
                    for (y, z) in y.chunks_exact_mut(shape.outputs).zip(z.chunks_exact(shape.outputs)) {
                        row::each::<L, 3>(y, [z, scale, offset], |_, [z, scale, offset]| z * scale + offset);
                    }
                } else {
                    y.copy_from_slice(z);
                }
            }
        }
    }
}

/// A range in even pieces of at most `block`: a small rest would be multiplied at half the speed.
#[inline(always)]
pub fn blocks(range: Range<usize>, block: usize) -> impl Iterator<Item = Range<usize>> {
    let (length, pieces) = (range.len(), range.len().div_ceil(block));
    (0..pieces).map(move |k| range.start + length * k / pieces..range.start + length * (k + 1) / pieces)
}

struct Backward<'a, R: Real> {
    shape: &'a MlpShape,
    memory: &'a Buffers<R>,
    x: &'a [R],
    p: &'a [R],
    layers: SharedActivations<'a, R>,
    y_bar: &'a [R],
    /// Empty if nobody asks for it.
    x_bar: Shared<'a, R>,
    wants_x: bool,
    /// `[parts, P]`.
    p_bar: Shared<'a, R>,
    rows: usize,
    parts: usize,
}

impl<R: Real> RowKernel<R> for Backward<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, range: Range<usize>) {
        let (shape, p) = (self.shape, self.p);
        let block = shape.block::<R>();
        let mut room = Cotangents::new(self.memory, shape, block, true);
        for k in range {
            // SAFETY: each part, its rows and its gradient belong to one iteration.
            let g = unsafe { self.p_bar.slice(k * shape.parameters()..(k + 1) * shape.parameters()) };
            g.fill(R::default());
            for rows in blocks(part(self.rows, self.parts, k), block) {
                let count = rows.len();
                let bar = &mut room.z[..count * shape.outputs];
                bar.copy_from_slice(&self.y_bar[rows.start * shape.outputs..rows.end * shape.outputs]);
                // SAFETY: as above.
                unsafe {
                    let (first, between) = (&mut room.first, &mut room.between);
                    backward_block::<L>(shape, p, &self.layers, rows.clone(), bar, g, first, between)
                };
                let first = &room.first[..count * shape.hidden];
                let inputs = rows.start * shape.inputs..rows.end * shape.inputs;
                let x = &self.x[inputs.clone()];
                matrix::add_transposed(&mut g[shape.weight(0)], x, first, (shape.inputs, count, shape.hidden));
                if self.wants_x {
                    // SAFETY: as above.
                    let x_bar = unsafe { self.x_bar.slice(inputs) };
                    let size = (count, shape.hidden, shape.inputs);
                    matrix::multiply_by_transposed(x_bar, first, &p[shape.weight(0)], size, false);
                }
            }
        }
    }
}

impl<R: Real> Operator<2> for Mlp<R> {
    type Real = R;
    const NAME: &'static str = "mlp";

    fn forward(&self, [x, p]: [&[R]; 2], _: [&candle_core::Shape; 2]) -> Result<(Vec<R>, candle_core::Shape)> {
        let shape = &self.shape;
        let rows = x.len() / shape.inputs;
        let mut activations = Activations::new(&self.memory, shape, rows);
        let mut y = vec![R::default(); rows * shape.outputs];
        let parts = parts(rows);
        let layers = activations.shared();
        run_rows(&Forward { shape, x, p, layers, y: Shared::new(&mut y), rows, parts }, parts);
        *self.activations.lock().unwrap_or_else(|e| e.into_inner()) = Some(activations);
        Ok((y, (rows, shape.outputs).into()))
    }

    fn adjoint(
        &self,
        [x, p]: [&[R]; 2],
        _: &[R],
        y_bar: &[R],
        // Features are data more often than not: nobody asks for their gradient then.
        [wants_x, _]: [bool; 2],
    ) -> Result<[Option<Vec<R>>; 2]> {
        let shape = &self.shape;
        let mut activations = self.activations.lock().unwrap_or_else(|e| e.into_inner());
        let Some(activations) = activations.as_mut() else {
            candle_core::bail!("mlp: the gradient was asked for without a forward pass")
        };
        let rows = activations.rows;
        let parts = parts(rows);
        let mut x_bar = vec![R::default(); if wants_x { x.len() } else { 0 }];
        let mut parts_bar = self.memory.buffer(parts * shape.parameters());
        let pass = Backward {
            shape,
            memory: &self.memory,
            x,
            p,
            layers: activations.shared(),
            y_bar,
            x_bar: Shared::new(&mut x_bar),
            wants_x,
            p_bar: Shared::new(&mut parts_bar),
            rows,
            parts,
        };
        run_rows(&pass, parts);
        let mut p_bar = vec![R::default(); shape.parameters()];
        sum_of_parts(&mut p_bar, &parts_bar);
        Ok([wants_x.then_some(x_bar), Some(p_bar)])
    }
}
