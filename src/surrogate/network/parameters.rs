//! The interface of networks: named parameters, and an output per particle.

use crate::io::tensor_file::TensorFile;
use crate::io::FileError;
use crate::numerics::random::uniform;
use crate::surrogate::features::Inputs;
use crate::surrogate::network::mlp::MlpShape;
use candle_core::{DType, Device, Result, Tensor, Var};
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// A vector of parameters that belong together, such as those of a perceptron, and the names of its parts.
#[derive(Debug, Clone)]
pub struct Parameter {
    pub values: Var,
    /// Name, range in the vector and shape of each part.
    pub parts: Vec<(String, Range<usize>, Vec<usize>)>,
}

impl Parameter {
    /// The initial parameters of a perceptron, as in haiku: weights from a normal distribution with standard deviation
    /// 1/sqrt(inputs), truncated at two standard deviations; biases and offsets 0, scales 1.
    pub fn perceptron(prefix: &str, shape: &MlpShape, rng: &mut ChaCha8Rng, dtype: DType) -> Result<Self> {
        Self::perceptrons(&[(prefix.to_owned(), *shape)], rng, dtype)
    }

    /// The initial parameters of several perceptrons, each with its prefix, in one vector.
    pub fn perceptrons(shapes: &[(String, MlpShape)], rng: &mut ChaCha8Rng, dtype: DType) -> Result<Self> {
        let (mut all, mut parts) = (Vec::new(), Vec::new());
        for (prefix, shape) in shapes {
            let (mut values, start) = (vec![0.0; shape.parameters()], all.len());
            for k in 0..shape.linears {
                let deviation = 1.0 / ((shape.weight(k).len() / shape.bias(k).len()) as f64).sqrt();
                values[shape.weight(k)].iter_mut().for_each(|w| *w = deviation * cut_normal(rng));
            }
            values[shape.scale()].fill(1.0);
            let place = |at: Range<usize>| start + at.start..start + at.end;
            parts.extend(
                shape.names().into_iter().map(|(name, at, shape)| (format!("{prefix}.{name}"), place(at), shape)),
            );
            all.extend(values);
        }
        Self::new(all, parts, dtype)
    }

    /// A table `[rows, columns]` of truncated normal numbers.
    pub fn table(name: &str, rows: usize, columns: usize, rng: &mut ChaCha8Rng, dtype: DType) -> Result<Self> {
        let values = (0..rows * columns).map(|_| cut_normal(rng)).collect();
        Self::new(values, vec![(name.to_owned(), 0..rows * columns, vec![rows, columns])], dtype)
    }

    fn new(values: Vec<f64>, parts: Vec<(String, Range<usize>, Vec<usize>)>, dtype: DType) -> Result<Self> {
        let values = Var::from_tensor(&Tensor::new(values, &Device::Cpu)?.to_dtype(dtype)?)?;
        Ok(Self { values, parts })
    }

    /// Number of values.
    pub fn count(&self) -> usize {
        self.values.elem_count()
    }

    /// Loads the values from a file's tensors, whose names are `prefix` + those of the parts.
    pub fn load(&self, file: &TensorFile, prefix: &str) -> anyhow::Result<()> {
        let values = self.read(file, prefix)?;
        let values = Tensor::new(values, &Device::Cpu)?.to_dtype(self.values.dtype())?;
        Ok(self.values.set(&values)?)
    }

    /// The values of all parts in a file, in order.
    ///
    /// # Errors
    /// A tensor that is missing, of another shape, or not finite, which rectifiers would hide.
    pub fn read(&self, file: &TensorFile, prefix: &str) -> std::result::Result<Vec<f64>, FileError> {
        let mut values = vec![0.0; self.count()];
        for (name, at, shape) in &self.parts {
            let name = format!("{prefix}{name}");
            let (of, numbers) = file.numbers(&name)?;
            let mismatch = |found: String, allowed: String, hint| {
                Err(FileError::Mismatch { path: file.path.clone(), name: name.clone(), found, allowed, hint })
            };
            if of != shape {
                let (found, allowed) = (format!("of shape {of:?}"), format!("of shape {shape:?}"));
                return mismatch(found, allowed, "the file belongs to a model of other sizes");
            }
            if let Some(k) = numbers.iter().position(|x| !x.is_finite()) {
                let (found, allowed) = (format!("{} at place {k}", numbers[k]), "of finite numbers".to_owned());
                return mismatch(found, allowed, "its training failed: take an earlier checkpoint");
            }
            values[at.clone()].copy_from_slice(&numbers);
        }
        Ok(values)
    }
}

/// A standard normal number, truncated at two standard deviations (rejection; Box and Muller).
fn cut_normal(rng: &mut ChaCha8Rng) -> f64 {
    loop {
        let radius = (-2.0 * (1.0 - uniform(rng)).ln()).sqrt();
        let z = radius * (std::f64::consts::TAU * uniform(rng)).cos();
        if z.abs() <= 2.0 {
            return z;
        }
    }
}

/// A trainable network: maps features to normalised acceleration (and temperature change).
pub trait Network: Send + Sync {
    fn parameters(&self) -> &[Parameter];

    /// The normalised acceleration `[N, D]`, with learned heat followed by a column of the temperature's change.
    ///
    /// `parameters` are those of [`Self::parameters`], tracked or not.
    fn apply(&self, inputs: &Inputs, parameters: &[Tensor]) -> Result<Tensor>;
}

/// Parameters for gradients.
pub fn tracked(network: &dyn Network) -> Vec<Tensor> {
    network.parameters().iter().map(|p| p.values.as_tensor().clone()).collect()
}

/// Parameters for predictions only, without a graph.
pub fn detached(network: &dyn Network) -> Vec<Tensor> {
    network.parameters().iter().map(|p| p.values.as_detached_tensor()).collect()
}
