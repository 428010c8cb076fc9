//! Rows of a tensor by number, and sums of rows by number: each the other's adjoint.

use crate::numerics::candle::{apply1, Operator};
use crate::numerics::lanes::{run_rows, Lanes, Real, RowKernel, Shared};
use crate::surrogate::network::graph::Graph;
use candle_core::{DType, Result, Shape, Tensor};
use std::marker::PhantomData;
use std::ops::Range;
use std::sync::Arc;

/// Which end of an edge.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum End {
    Sender,
    Receiver,
}

struct Op<R> {
    graph: Arc<Graph>,
    end: End,
    /// Gather, `[N, C]` -> `[E, C]`; or sum, `[E, C]` -> `[N, C]`.
    gathers: bool,
    real: PhantomData<R>,
}

/// `y[e] = x[end of e]`: `[N, C]` -> `[E, C]`.
pub fn gather(x: &Tensor, graph: &Arc<Graph>, end: End) -> Result<Tensor> {
    apply(x, graph, end, true)
}

/// `y[i] = sum of x[e] over the edges with this end at i`: `[E, C]` -> `[N, C]`.
pub fn segment_sum(x: &Tensor, graph: &Arc<Graph>, end: End) -> Result<Tensor> {
    apply(x, graph, end, false)
}

fn apply(x: &Tensor, graph: &Arc<Graph>, end: End, gathers: bool) -> Result<Tensor> {
    let graph = graph.clone();
    match x.dtype() {
        DType::F32 => apply1(Op::<f32> { graph, end, gathers, real: PhantomData }, x),
        _ => apply1(Op::<f64> { graph, end, gathers, real: PhantomData }, x),
    }
}

struct Pass<'a, R> {
    op: &'a Op<R>,
    x: &'a [R],
    width: usize,
    y: Shared<'a, R>,
}

impl<R: Real> RowKernel<R> for Pass<'_, R> {
    #[inline(always)]
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>) {
        let (graph, width) = (&*self.op.graph, self.width);
        for row in rows {
            // SAFETY: each row is written by its own iteration.
            let y = unsafe { self.y.slice(row * width..(row + 1) * width) };
            let x = |k: usize| &self.x[k * width..(k + 1) * width];
            let mut add = |edge: usize| y.iter_mut().zip(x(edge)).for_each(|(y, &x)| *y += x);
            match (self.op.gathers, self.op.end) {
                (true, End::Sender) => y.copy_from_slice(x(graph.senders[row] as usize)),
                (true, End::Receiver) => y.copy_from_slice(x(graph.receivers[row] as usize)),
                (false, End::Sender) => graph.out_of(row).iter().for_each(|&edge| add(edge as usize)),
                (false, End::Receiver) => graph.entering(&(row..row + 1)).for_each(add),
            }
        }
    }
}

impl<R: Real> Operator<1> for Op<R> {
    type Real = R;
    const NAME: &'static str = "gather or segment sum";

    fn forward(&self, [x]: [&[R]; 1], [shape]: [&Shape; 1]) -> Result<(Vec<R>, Shape)> {
        let (from, width) = shape.dims2()?;
        let (nodes, edges) = (self.graph.nodes(), self.graph.edges());
        let (wanted, rows) = if self.gathers { (nodes, edges) } else { (edges, nodes) };
        if from != wanted {
            candle_core::bail!("{}: {from} rows, but the graph has {wanted}", Self::NAME);
        }
        let y = self.pass(x, rows, width);
        Ok((y, (rows, width).into()))
    }

    fn adjoint(&self, [x]: [&[R]; 1], _: &[R], bar: &[R], _: [bool; 1]) -> Result<[Option<Vec<R>>; 1]> {
        let (nodes, edges) = (self.graph.nodes(), self.graph.edges());
        let rows = if self.gathers { nodes } else { edges };
        let other = Self { graph: self.graph.clone(), end: self.end, gathers: !self.gathers, real: PhantomData };
        Ok([Some(other.pass(bar, rows, x.len() / rows.max(1)))])
    }
}

impl<R: Real> Op<R> {
    /// `[rows, width]`.
    fn pass(&self, x: &[R], rows: usize, width: usize) -> Vec<R> {
        let mut y = vec![R::default(); rows * width];
        run_rows(&Pass { op: self, x, width, y: Shared::new(&mut y) }, rows);
        y
    }
}
