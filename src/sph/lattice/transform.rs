//! The discrete Fourier transform of real fields on a lattice `[n_0, ..., n_(D-1)]`, the last index the fastest.
//!
//! A spectrum has the modes of the last axis up to n / 2 only, `[n_0, ..., n_(D-1) / 2 + 1]`: the others are complex
//! conjugates of these. Transforms to spectra are sums without a factor, those back have 1 / N.

use crate::numerics::thread_pool::ThreadPool;
use num_complex::Complex64;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::{Fft, FftPlanner};
use std::fmt;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

pub type Spectrum = Vec<Complex64>;

/// Columns that are transformed together: as many numbers as a few cache lines have.
const COLUMNS: usize = 8;
/// Modes from which on fields are shared among threads.
const SHARED: usize = 8192;

/// Transforms of fields on one lattice.
#[derive(Clone)]
pub struct Transform {
    pub shape: Vec<usize>,
    rows: (Arc<dyn RealToComplex<f64>>, Arc<dyn ComplexToReal<f64>>),
    /// Forwards and back, of all axes but the last.
    columns: Vec<[Arc<dyn Fft<f64>>; 2]>,
}

impl fmt::Debug for Transform {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "Transform({:?})", self.shape)
    }
}

impl Transform {
    pub fn new(shape: &[usize]) -> Self {
        let (mut real, mut complex) = (RealFftPlanner::new(), FftPlanner::new());
        let last = shape[shape.len() - 1];
        let columns = shape[..shape.len() - 1].iter();
        Self {
            shape: shape.to_vec(),
            rows: (real.plan_fft_forward(last), real.plan_fft_inverse(last)),
            columns: columns.map(|&n| [complex.plan_fft_forward(n), complex.plan_fft_inverse(n)]).collect(),
        }
    }

    /// Number of particles, N.
    pub fn points(&self) -> usize {
        self.shape.iter().product()
    }

    /// Modes of a row of the last axis.
    pub fn half(&self) -> usize {
        self.shape[self.shape.len() - 1] / 2 + 1
    }

    /// Number of modes in a spectrum.
    pub fn modes(&self) -> usize {
        self.points() / self.shape[self.shape.len() - 1] * self.half()
    }

    /// How often a mode is in the whole spectrum: itself, and its complex conjugate where a spectrum leaves that out.
    pub fn multiplicity(&self, mode: usize) -> f64 {
        let (last, k) = (self.shape[self.shape.len() - 1], mode % self.half());
        if k == 0 || 2 * k == last {
            1.0
        } else {
            2.0
        }
    }

    /// The sum over all particles of the product of two fields, given their spectra; term by term times `weight`.
    pub fn product(&self, a: &[Complex64], b: &[Complex64], weight: impl Fn(usize) -> f64) -> f64 {
        let term = |k: usize| self.multiplicity(k) * weight(k) * (a[k].re * b[k].re + a[k].im * b[k].im);
        // In a fixed order: the same bits for any number of threads.
        (0..self.modes()).map(term).sum::<f64>() / self.points() as f64
    }

    /// Transforms the columns of all axes but the last.
    fn columns(&self, spectrum: &mut [Complex64], way: usize) {
        let mut inner = self.half();
        for (axis, plans) in self.columns.iter().enumerate().rev() {
            let (n, plan) = (self.shape[axis], &plans[way]);
            let mut pack = vec![Complex64::default(); COLUMNS * n];
            let mut scratch = vec![Complex64::default(); plan.get_inplace_scratch_len()];
            for block in spectrum.chunks_exact_mut(n * inner) {
                for first in (0..inner).step_by(COLUMNS) {
                    let count = COLUMNS.min(inner - first);
                    for (i, row) in block.chunks_exact(inner).enumerate() {
                        (0..count).for_each(|c| pack[c * n + i] = row[first + c]);
                    }
                    plan.process_with_scratch(&mut pack[..count * n], &mut scratch);
                    for (i, row) in block.chunks_exact_mut(inner).enumerate() {
                        (0..count).for_each(|c| row[first + c] = pack[c * n + i]);
                    }
                }
            }
            inner *= n;
        }
    }

    /// The spectrum of a field; its numbers are used up.
    pub fn forwards(&self, mut field: Vec<f64>) -> Spectrum {
        let (last, plan) = (self.shape[self.shape.len() - 1], &self.rows.0);
        let mut spectrum = vec![Complex64::default(); self.modes()];
        let mut scratch = plan.make_scratch_vec();
        for (row, to) in field.chunks_exact_mut(last).zip(spectrum.chunks_exact_mut(self.half())) {
            // Fails only for slices of other lengths.
            let _ = plan.process_with_scratch(row, to, &mut scratch);
        }
        self.columns(&mut spectrum, 0);
        spectrum
    }

    /// The field of a spectrum; its numbers are used up.
    pub fn back(&self, mut spectrum: Spectrum) -> Vec<f64> {
        self.columns(&mut spectrum, 1);
        let (last, plan) = (self.shape[self.shape.len() - 1], &self.rows.1);
        let mut field = vec![0.0; self.points()];
        let mut scratch = plan.make_scratch_vec();
        for (row, to) in spectrum.chunks_exact_mut(self.half()).zip(field.chunks_exact_mut(last)) {
            // Of a real field these are real; rounding is not.
            row[0].im = 0.0;
            if last % 2 == 0 {
                row[last / 2].im = 0.0;
            }
            let _ = plan.process_with_scratch(row, to, &mut scratch);
        }
        let factor = 1.0 / self.points() as f64;
        field.iter_mut().for_each(|x| *x *= factor);
        field
    }

    /// Makes `count` things, such as a spectrum for each field, on all threads if they are large.
    pub fn each<T: Send>(&self, count: usize, make: impl Fn(usize) -> T + Sync) -> Vec<T> {
        if count < 2 || self.modes() < SHARED {
            return (0..count).map(make).collect();
        }
        let made: Vec<Mutex<Option<T>>> = (0..count).map(|_| Mutex::new(None)).collect();
        let next = AtomicUsize::new(0);
        ThreadPool::global().run(&|_| loop {
            let k = next.fetch_add(1, Ordering::Relaxed);
            let Some(place) = made.get(k) else { return };
            let thing = make(k);
            *place.lock().unwrap_or_else(PoisonError::into_inner) = Some(thing);
        });
        let taken = made.into_iter().map(|place| place.into_inner().unwrap_or_else(PoisonError::into_inner));
        taken.flatten().collect()
    }
}

/// The values of a field on a lattice `shape` at the points of another one of the same box, by the sum of modes that goes through
/// the given values; along each axis it is the product with the modes' sum at a distance, 1 at 0.
pub fn resampled(field: &[f64], shape: &[usize], other: &[usize]) -> Vec<f64> {
    let (mut field, mut shape) = (field.to_vec(), shape.to_vec());
    for axis in 0..shape.len() {
        let (n, m) = (shape[axis], other[axis]);
        if n == m {
            continue;
        }
        let kernel = |i: usize, j: usize| {
            // Whole numbers, so that points that coincide are found.
            let apart = (i * n + n * m - j * m) % (n * m);
            let half = std::f64::consts::PI * apart as f64 / (n * m) as f64;
            match (apart, n % 2) {
                (0, _) => 1.0,
                (_, 0) => (n as f64 * half).sin() * half.cos() / (n as f64 * half.sin()),
                _ => (n as f64 * half).sin() / (n as f64 * half.sin()),
            }
        };
        let weights: Vec<f64> = (0..m * n).map(|k| kernel(k / n, k % n)).collect();
        let inner: usize = shape[axis + 1..].iter().product();
        let outer: usize = shape[..axis].iter().product();
        let mut next = vec![0.0; outer * m * inner];
        for (block, to) in field.chunks_exact(n * inner).zip(next.chunks_exact_mut(m * inner)) {
            for (row, weights) in to.chunks_exact_mut(inner).zip(weights.chunks_exact(n)) {
                for (from, weight) in block.chunks_exact(inner).zip(weights) {
                    row.iter_mut().zip(from).for_each(|(to, x)| *to += weight * x);
                }
            }
        }
        (field, shape[axis]) = (next, m);
    }
    field
}
