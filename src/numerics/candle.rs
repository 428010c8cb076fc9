//! The bridge to candle: what is computed on plain slices becomes a node of candle's graph.

use super::lanes::Real;
use candle_core::backend::BackendStorage;
use candle_core::{
    CpuStorage, CudaStorage, CustomOp1, CustomOp2, CustomOp3, DType, Device, InplaceOp3, Layout, Result, Shape,
    Storage, Tensor, WithDType,
};
use std::marker::PhantomData;
use std::sync::{Mutex, PoisonError};

/// An operator with N tensor inputs and one output, on plain numbers, and its adjoint. Everything else that it knows (a
/// list, constants) is a constant as far as derivatives go.
pub trait Operator<const N: usize>: Send + Sync + 'static {
    type Real: Real;
    const NAME: &'static str;

    /// The output's numbers and shape.
    fn forward(&self, inputs: [&[Self::Real]; N], shapes: [&Shape; N]) -> Result<(Vec<Self::Real>, Shape)>;

    /// The inputs' cotangents from that of the output. `wanted` says which of them somebody asks for; none of the others
    /// need be given.
    fn adjoint(
        &self,
        inputs: [&[Self::Real]; N],
        output: &[Self::Real],
        output_bar: &[Self::Real],
        wanted: [bool; N],
    ) -> Result<[Option<Vec<Self::Real>>; N]>;
}

/// x -> y on candle's graph.
///
/// # Errors
/// Those of the operator; a tensor of another type or on another device.
pub fn apply1<O: Operator<1>>(operator: O, x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(Node(operator))
}

/// (a, b) -> y on candle's graph.
pub fn apply2<O: Operator<2>>(operator: O, a: &Tensor, b: &Tensor) -> Result<Tensor> {
    a.contiguous()?.apply_op2(&b.contiguous()?, Node(operator))
}

/// (a, b, c) -> y on candle's graph.
pub fn apply3<O: Operator<3>>(operator: O, a: &Tensor, b: &Tensor, c: &Tensor) -> Result<Tensor> {
    a.contiguous()?.apply_op3(&b.contiguous()?, &c.contiguous()?, Node(operator))
}

/// An [`Operator`] as candle wants it.
struct Node<O>(O);

impl<O> Node<O> {
    fn run<const N: usize>(&self, inputs: [(&CpuStorage, &Layout); N]) -> Result<(CpuStorage, Shape)>
    where
        O: Operator<N>,
    {
        let mut numbers: [&[O::Real]; N] = [&[]; N];
        for (numbers, (storage, layout)) in numbers.iter_mut().zip(inputs) {
            *numbers = slice(storage, layout)?;
        }
        let (output, shape) = self.0.forward(numbers, inputs.map(|(_, layout)| layout.shape()))?;
        Ok((O::Real::to_cpu_storage_owned(output), shape))
    }

    fn back<const N: usize>(&self, inputs: [&Tensor; N], output: &Tensor, bar: &Tensor) -> Result<[Option<Tensor>; N]>
    where
        O: Operator<N>,
    {
        back(inputs, output, bar, &|numbers, output, bar| {
            self.0.adjoint(numbers, output, bar, inputs.map(Tensor::track_op))
        })
    }
}

/// From numbers of the inputs, the output and its cotangent to cotangents of the inputs.
type Adjoint<'a, R, const N: usize> = &'a dyn Fn([&[R]; N], &[R], &[R]) -> Result<[Option<Vec<R>>; N]>;

/// [`Node::back`], compiled once for all operators of so many inputs.
fn back<R: Real, const N: usize>(
    inputs: [&Tensor; N],
    output: &Tensor,
    bar: &Tensor,
    adjoint: Adjoint<R, N>,
) -> Result<[Option<Tensor>; N]> {
    let bar = bar.contiguous()?;
    let guards = inputs.map(Tensor::storage_and_layout);
    let mut numbers: [&[R]; N] = [&[]; N];
    for (numbers, (storage, layout)) in numbers.iter_mut().zip(&guards) {
        *numbers = slice(on_cpu(storage)?, layout)?;
    }
    let found = read(output, |output| read(&bar, |bar| adjoint(numbers, output, bar)))?;
    let mut bars = [const { None }; N];
    for ((to, found), input) in bars.iter_mut().zip(found).zip(inputs) {
        *to = found.map(|bar| Tensor::from_vec(bar, input.shape(), &Device::Cpu)).transpose()?;
    }
    Ok(bars)
}

impl<O: Operator<1>> CustomOp1 for Node<O> {
    fn name(&self) -> &'static str {
        O::NAME
    }
    fn cpu_fwd(&self, s: &CpuStorage, l: &Layout) -> Result<(CpuStorage, Shape)> {
        self.run([(s, l)])
    }
    fn bwd(&self, x: &Tensor, y: &Tensor, y_bar: &Tensor) -> Result<Option<Tensor>> {
        self.back([x], y, y_bar).map(|[x]| x)
    }
}

impl<O: Operator<2>> CustomOp2 for Node<O> {
    fn name(&self) -> &'static str {
        O::NAME
    }
    fn cpu_fwd(&self, s1: &CpuStorage, l1: &Layout, s2: &CpuStorage, l2: &Layout) -> Result<(CpuStorage, Shape)> {
        self.run([(s1, l1), (s2, l2)])
    }
    fn bwd(&self, a: &Tensor, b: &Tensor, y: &Tensor, y_bar: &Tensor) -> Result<(Option<Tensor>, Option<Tensor>)> {
        self.back([a, b], y, y_bar).map(|[a, b]| (a, b))
    }
}

impl<O: Operator<3>> CustomOp3 for Node<O> {
    fn name(&self) -> &'static str {
        O::NAME
    }
    fn cpu_fwd(
        &self,
        s1: &CpuStorage,
        l1: &Layout,
        s2: &CpuStorage,
        l2: &Layout,
        s3: &CpuStorage,
        l3: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        self.run([(s1, l1), (s2, l2), (s3, l3)])
    }
    #[allow(clippy::type_complexity)] // as candle has it
    fn bwd(
        &self,
        a: &Tensor,
        b: &Tensor,
        c: &Tensor,
        y: &Tensor,
        y_bar: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        self.back([a, b, c], y, y_bar).map(|[a, b, c]| (a, b, c))
    }
}

/// A value on candle's graph, on any device, that was found from `x` in another way than its derivative is: `adjoint` takes
/// the value's cotangent to that of `x`.
pub fn with_adjoint(
    x: &Tensor,
    value: Tensor,
    adjoint: impl Fn(&Tensor) -> Result<Tensor> + Send + Sync + 'static,
) -> Result<Tensor> {
    if !x.track_op() {
        return Ok(value);
    }
    // The whole of a storage is what the node takes over.
    let value = match value.is_contiguous() && value.layout().start_offset() == 0 {
        true => value,
        false => value.force_contiguous()?,
    };
    x.apply_op1(Found { value: Mutex::new(Some(value)), adjoint })
}

/// A node whose value is there before it runs. It gives it away: the graph keeps one copy.
struct Found<F> {
    value: Mutex<Option<Tensor>>,
    adjoint: F,
}

impl<F> Found<F> {
    fn take(&self) -> Result<Tensor> {
        let value = self.value.lock().unwrap_or_else(PoisonError::into_inner).take();
        value.ok_or_else(|| candle_core::Error::Msg("a node of the graph that ran twice".into()))
    }
}

impl<F: Fn(&Tensor) -> Result<Tensor> + Send + Sync + 'static> CustomOp1 for Found<F> {
    fn name(&self) -> &'static str {
        "found"
    }
    fn cpu_fwd(&self, _: &CpuStorage, _: &Layout) -> Result<(CpuStorage, Shape)> {
        let value = self.take()?;
        let (storage, _) = value.storage_and_layout();
        match &*storage {
            Storage::Cpu(storage) => Ok((storage.clone(), value.shape().clone())),
            _ => candle_core::bail!("a value on another device than what it is a value of"),
        }
    }
    fn cuda_fwd(&self, _: &CudaStorage, _: &Layout) -> Result<(CudaStorage, Shape)> {
        let value = self.take()?;
        let (storage, layout) = value.storage_and_layout();
        match &*storage {
            Storage::Cuda(storage) => Ok((storage.try_clone(layout)?, value.shape().clone())),
            _ => candle_core::bail!("a value on another device than what it is a value of"),
        }
    }
    fn bwd(&self, _: &Tensor, _: &Tensor, bar: &Tensor) -> Result<Option<Tensor>> {
        (self.adjoint)(bar).map(Some)
    }
}

/// x <- f(x, a, b), in x's own memory: a graph that was built with x must be gone.
pub fn update<R: Real>(
    name: &'static str,
    x: &Tensor,
    a: &Tensor,
    b: &Tensor,
    f: impl Fn(&mut [R], &[R], &[R]),
) -> Result<()> {
    x.inplace_op3(a, b, &InPlace { name, f, real: PhantomData::<R> })
}

struct InPlace<R, F> {
    name: &'static str,
    f: F,
    real: PhantomData<R>,
}

impl<R: Real, F: Fn(&mut [R], &[R], &[R])> InplaceOp3 for InPlace<R, F> {
    fn name(&self) -> &'static str {
        self.name
    }
    fn cpu_fwd(
        &self,
        x: &mut CpuStorage,
        x_layout: &Layout,
        a: &CpuStorage,
        a_layout: &Layout,
        b: &CpuStorage,
        b_layout: &Layout,
    ) -> Result<()> {
        let (a, b) = (slice::<R>(a, a_layout)?, slice::<R>(b, b_layout)?);
        let x: &mut [R] = match x {
            CpuStorage::F32(x) if R::DTYPE == DType::F32 => bytemuck::cast_slice_mut(x),
            CpuStorage::F64(x) if R::DTYPE == DType::F64 => bytemuck::cast_slice_mut(x),
            _ => candle_core::bail!("{}: the types of the tensors differ", self.name),
        };
        match x_layout.contiguous_offsets() {
            Some((from, to)) if to - from == a.len() && a.len() == b.len() => {
                (self.f)(&mut x[from..to], a, b);
                Ok(())
            }
            _ => candle_core::bail!("{}: the shapes of the tensors differ", self.name),
        }
    }
}

/// A stored tensor's numbers.
fn slice<'a, R: Real>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [R]> {
    let slice = R::cpu_storage_as_slice(storage)?;
    match layout.contiguous_offsets() {
        Some((from, to)) => Ok(&slice[from..to]),
        None => candle_core::bail!("an operator needs contiguous tensors"),
    }
}

fn on_cpu(storage: &Storage) -> Result<&CpuStorage> {
    match storage {
        Storage::Cpu(storage) => Ok(storage),
        _ => candle_core::bail!("fused operators run on the CPU; composed ones run everywhere"),
    }
}

/// Reads a contiguous tensor's numbers in place, on the CPU.
///
/// # Errors
/// A tensor of another type, on another device, or not contiguous.
pub fn read<R: Real, T>(tensor: &Tensor, f: impl FnOnce(&[R]) -> Result<T>) -> Result<T> {
    let (storage, layout) = tensor.storage_and_layout();
    f(slice(on_cpu(&storage)?, layout)?)
}
