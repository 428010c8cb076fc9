//! Multilayer perceptron on blocks of rows: linear, ReLU, ..., linear, and layer normalisation behind it.
//!
//! y = LN(relu(... relu(x W0 + b0) ...) W + b), LN(z) = (z - mean z)/sqrt(var z + 1e-5) * scale + offset over each row (Ba,
//! Kiros and Hinton 2016, with the biased variance). Weights are stored `[in, out]`. Rows go through in blocks that
//! stay in a core's cache; what the adjoint needs again (activations behind each ReLU, normalised rows) is kept.

use crate::numerics::candle::Operator;
use crate::numerics::lanes::{Lanes, Real};
use crate::numerics::pool::{Buffer, Buffers};
use crate::numerics::sweep::{cut, run_parts, PartKernel};
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

    /// The rows of the first weight that some of the inputs are multiplied with.
    #[inline(always)]
    pub fn weight_of(&self, inputs: Range<usize>) -> Range<usize> {
        let at = self.weight(0).start;
        at + inputs.start * self.hidden..at + inputs.end * self.hidden
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
}

/// What the forward pass leaves for the adjoint.
#[derive(Debug)]
pub struct Activations<R: Real> {
    shape: MlpShape,
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
            shape: *shape,
            hidden: memory.buffer((shape.linears - 1) * rows * shape.hidden),
            normalised: memory.buffer(rows * shape.outputs),
            inverse: memory.buffer(if shape.norm { rows } else { 0 }),
            rows,
        }
    }

    /// The activations to be filled, in parts of rows that follow each other.
    pub fn parts(&mut self, parts: &[Range<usize>]) -> Vec<Layers<'_, R>> {
        let shape = self.shape;
        let layers = self.hidden.chunks_exact_mut((self.rows * shape.hidden).max(1));
        let mut layers: Vec<_> = layers.map(|layer| cut(layer, parts, shape.hidden).into_iter()).collect();
        let normalised = cut(&mut self.normalised, parts, shape.outputs).into_iter();
        let inverse = cut(&mut self.inverse, parts, usize::from(shape.norm));
        let part = |(normalised, inverse)| {
            let hidden = layers.iter_mut().filter_map(Iterator::next).collect();
            Layers { shape, hidden, normalised, inverse }
        };
        normalised.zip(inverse).map(part).collect()
    }

    /// All of them in one part.
    pub fn whole(&mut self) -> Layers<'_, R> {
        let all = 0..self.rows;
        self.parts(std::slice::from_ref(&all)).swap_remove(0)
    }
}

/// [`Activations`] of a part of the rows, to be filled. Rows are counted from the part's first.
pub struct Layers<'a, R> {
    shape: MlpShape,
    hidden: Vec<&'a mut [R]>,
    normalised: &'a mut [R],
    inverse: &'a mut [R],
}

impl<R: Real> Layers<'_, R> {
    /// Activations of the first hidden layer of some rows.
    #[inline(always)]
    pub fn first(&mut self, rows: &Range<usize>) -> &mut [R] {
        &mut self.hidden[0][times(rows, self.shape.hidden)]
    }

    #[inline(always)]
    pub fn normalised(&self, rows: &Range<usize>) -> &[R] {
        &self.normalised[times(rows, self.shape.outputs)]
    }

    /// What comes out for some rows: normalised ones with scale and offset.
    #[inline(always)]
    pub fn output<L: Lanes<Real = R>>(&self, p: &[R], rows: &Range<usize>, y: &mut [R]) {
        let (shape, z) = (self.shape, self.normalised(rows));
        if !shape.norm {
            return y.copy_from_slice(z);
        }
        let (scale, offset) = (&p[shape.scale()], &p[shape.offset()]);
        for (y, z) in y.chunks_exact_mut(shape.outputs).zip(z.chunks_exact(shape.outputs)) {
            row::each::<L, 3>(y, [z, scale, offset], |_, [z, scale, offset]| z * scale + offset);
        }
    }
}

/// Where rows stand in a matrix of `width` columns.
#[inline(always)]
pub fn times(rows: &Range<usize>, width: usize) -> Range<usize> {
    rows.start * width..rows.end * width
}

/// Rows counted from another one.
#[inline(always)]
pub fn since(start: usize, rows: &Range<usize>) -> Range<usize> {
    rows.start - start..rows.end - start
}

/// From the activations of the first hidden layer on: fills the further ones and the normalised rows.
#[inline(always)]
pub fn forward_block<L: Lanes>(p: &[L::Real], layers: &mut Layers<L::Real>, rows: &Range<usize>) {
    let (shape, count, place) = (layers.shape, rows.len(), times(rows, layers.shape.hidden));
    for k in 1..shape.linears - 1 {
        let (before, after) = layers.hidden.split_at_mut(k);
        let (before, after) = (&before[k - 1][place.clone()], &mut after[0][place.clone()]);
        matrix::multiply(after, before, &p[shape.weight(k)], (count, shape.hidden, shape.hidden), false);
        row::activate::<L>(after, &p[shape.bias(k)]);
    }
    let last = shape.linears - 1;
    let (hidden, z) = (&layers.hidden[last - 1][place], &mut layers.normalised[times(rows, shape.outputs)]);
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
            layers.inverse[rows.start + r] = scale;
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
#[inline(always)]
pub fn backward_block<L: Lanes>(
    p: &[L::Real],
    layers: &Activations<L::Real>,
    rows: &Range<usize>,
    z_bar: &mut [L::Real],
    g: &mut [L::Real],
    first: &mut [L::Real],
    between: &mut [L::Real],
) {
    let (shape, count) = (layers.shape, rows.len());
    let last = shape.linears - 1;
    let width = L::Real::of(1.0 / shape.outputs as f64);
    let normalised = &layers.normalised[times(rows, shape.outputs)];
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
            let (mean, along, inverse) = (L::splat(mean), L::splat(along), L::splat(layers.inverse[rows.start + r]));
            row::each::<L, 1>(y_bar, [x], |y, [x]| (y - mean - x * along) * inverse);
        }
    }
    row::add_rows::<L, 1>(&mut g[shape.bias(last)], [z_bar], |[bar]| bar);
    for k in (1..=last).rev() {
        let behind = (k - 1) * layers.rows;
        let hidden = &layers.hidden[times(&(behind + rows.start..behind + rows.end), shape.hidden)];
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

/// A range in so many even pieces.
#[inline(always)]
fn pieces(range: Range<usize>, pieces: usize) -> impl Iterator<Item = Range<usize>> {
    let length = range.len();
    (0..pieces).map(move |k| range.start + length * k / pieces..range.start + length * (k + 1) / pieces)
}

/// A range in even pieces of at most `block`: a small rest would be multiplied at half the speed.
#[inline(always)]
pub fn blocks(range: Range<usize>, block: usize) -> impl Iterator<Item = Range<usize>> {
    let count = range.len().div_ceil(block);
    pieces(range, count)
}

/// Numbers per row of the sweep over a gradient.
const ROW: usize = 4096;

struct Sum<'a, R> {
    length: usize,
    parts: &'a [R],
}

impl<'a, R: Real> PartKernel<R> for Sum<'a, R> {
    type Part = &'a mut [R];

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, row: usize, sum: &mut &'a mut [R]) {
        for (k, part) in self.parts.chunks_exact(self.length).enumerate() {
            let part = &part[row * ROW..][..sum.len()];
            if k == 0 {
                sum.copy_from_slice(part);
            } else {
                row::each::<L, 1>(sum, [part], |sum, [x]| sum + x);
            }
        }
    }
}

/// `sum` <- the gradients of the parts added up in their order.
pub fn sum_of_parts<R: Real>(sum: &mut [R], parts: &[R]) {
    let length = sum.len();
    run_parts(&Sum { length, parts }, sum.chunks_mut(ROW));
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
    rows: &'a [Range<usize>],
}

impl<'a, R: Real> PartKernel<R> for Forward<'a, R> {
    /// Activations and output.
    type Part = (Layers<'a, R>, &'a mut [R]);

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, k: usize, (layers, y): &mut Self::Part) {
        let (shape, p) = (self.shape, self.p);
        let x = &self.x[times(&self.rows[k], shape.inputs)];
        for rows in blocks(0..self.rows[k].len(), shape.block::<R>()) {
            let (x, y) = (&x[times(&rows, shape.inputs)], &mut y[times(&rows, shape.outputs)]);
            let hidden = layers.first(&rows);
            matrix::multiply(hidden, x, &p[shape.weight(0)], (rows.len(), shape.inputs, shape.hidden), false);
            row::activate::<L>(hidden, &p[shape.bias(0)]);
            forward_block::<L>(p, layers, &rows);
            layers.output::<L>(p, &rows, y);
        }
    }
}

struct Backward<'a, R: Real> {
    shape: &'a MlpShape,
    memory: &'a Buffers<R>,
    x: &'a [R],
    p: &'a [R],
    layers: &'a Activations<R>,
    y_bar: &'a [R],
    rows: &'a [Range<usize>],
}

impl<'a, R: Real> PartKernel<R> for Backward<'a, R> {
    /// Cotangent of the input, empty if nobody asks for it, and gradient `[P]`.
    type Part = (&'a mut [R], &'a mut [R]);

    #[inline(always)]
    fn part<L: Lanes<Real = R>>(&self, k: usize, (x_bar, g): &mut Self::Part) {
        let (shape, p, layers) = (self.shape, self.p, self.layers);
        let block = shape.block::<R>();
        let mut room = Cotangents::new(self.memory, shape, block, true);
        g.fill(R::default());
        for rows in blocks(self.rows[k].clone(), block) {
            let count = rows.len();
            let bar = &mut room.z[..count * shape.outputs];
            bar.copy_from_slice(&self.y_bar[times(&rows, shape.outputs)]);
            backward_block::<L>(p, layers, &rows, bar, g, &mut room.first, &mut room.between);
            let first = &room.first[..count * shape.hidden];
            let x = &self.x[times(&rows, shape.inputs)];
            matrix::add_transposed(&mut g[shape.weight(0)], x, first, (shape.inputs, count, shape.hidden));
            if !x_bar.is_empty() {
                let x_bar = &mut x_bar[times(&since(self.rows[k].start, &rows), shape.inputs)];
                let size = (count, shape.hidden, shape.inputs);
                matrix::multiply_by_transposed(x_bar, first, &p[shape.weight(0)], size, false);
            }
        }
    }
}

impl<R: Real> Operator<2> for Mlp<R> {
    type Real = R;
    const NAME: &'static str = "mlp";

    fn forward(&self, [x, p]: [&[R]; 2], _: [&candle_core::Shape; 2]) -> Result<(Vec<R>, candle_core::Shape)> {
        let shape = &self.shape;
        let count = x.len() / shape.inputs;
        let mut activations = Activations::new(&self.memory, shape, count);
        let mut y = vec![R::default(); count * shape.outputs];
        let rows: Vec<_> = pieces(0..count, parts(count)).collect();
        let parts = activations.parts(&rows).into_iter().zip(cut(&mut y, &rows, shape.outputs));
        run_parts(&Forward { shape, x, p, rows: &rows }, parts);
        *self.activations.lock().unwrap_or_else(|e| e.into_inner()) = Some(activations);
        Ok((y, (count, shape.outputs).into()))
    }

    fn adjoint(
        &self,
        [x, p]: [&[R]; 2],
        _: &[R],
        y_bar: &[R],
        // Features are data more often than not: nobody asks for their gradient then.
        [wants_x, _]: [bool; 2],
    ) -> Result<[Option<Vec<R>>; 2]> {
        let (shape, memory) = (&self.shape, &self.memory);
        let activations = self.activations.lock().unwrap_or_else(|e| e.into_inner());
        let Some(layers) = activations.as_ref() else {
            candle_core::bail!("mlp: the gradient was asked for without a forward pass")
        };
        let rows: Vec<_> = pieces(0..layers.rows, parts(layers.rows)).collect();
        let width = if wants_x { shape.inputs } else { 0 };
        let mut x_bar = vec![R::default(); layers.rows * width];
        let mut parts_bar = memory.buffer(rows.len() * shape.parameters());
        let gradients = parts_bar.chunks_exact_mut(shape.parameters());
        let parts = cut(&mut x_bar, &rows, width).into_iter().zip(gradients);
        run_parts(&Backward { shape, memory, x, p, layers, y_bar, rows: &rows }, parts);
        let mut p_bar = vec![R::default(); shape.parameters()];
        sum_of_parts(&mut p_bar, &parts_bar);
        Ok([wants_x.then_some(x_bar), Some(p_bar)])
    }
}
