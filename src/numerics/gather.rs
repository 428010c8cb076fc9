//! Rows of a tensor by their numbers, and sums of rows by the number of where they go: each the other's adjoint.
//!
//! candle has the pair `index_select` and `index_add`, each the other's derivative. Its `index_add` is fast on the CPU; on
//! CUDA one thread adds up a whole column, number by number. There sums are taken the other way round: whoever is summed for
//! knows the places that name it (they are sorted once, when the numbers come), fetches them with `index_select`, as many as
//! the one that most places name, and adds them up in their order. No atomics, so the same bits every time.

use super::candle::with_adjoint;
use candle_core::{Device, Result, Tensor};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::Arc;

/// Numbers of rows.
#[derive(Debug, Clone)]
pub struct Gather {
    /// `[M]` u32.
    numbers: Tensor,
    /// Rows that are numbered.
    rows: usize,
    /// Who names each row; none where candle's `index_add` is fast.
    places: Option<Arc<Places>>,
}

/// The places that name each row.
#[derive(Debug)]
struct Places {
    /// `[rows most]` u32: those of row 0, of row 1 and so on, each with [`NOWHERE`] behind them where it has less than the most.
    places: Tensor,
    rows: usize,
    most: usize,
}

/// What `index_select` makes 0 of, on every device.
const NOWHERE: u32 = u32::MAX;

/// Whether sums are taken by place on the CPU, too.
static EVERYWHERE: AtomicBool = AtomicBool::new(false);

/// Takes sums on the CPU as on other devices, or does so no longer: for tests of what runs there, on machines without one.
pub fn sum_by_place_everywhere(yes: bool) {
    EVERYWHERE.store(yes, Ordering::Relaxed);
}

/// Whether sums are taken by place on a device.
pub fn sums_by_place(device: &Device) -> bool {
    !device.is_cpu() || EVERYWHERE.load(Ordering::Relaxed)
}

impl Gather {
    /// Of `rows` rows, by numbers `[M]`, on a device.
    ///
    /// # Errors
    /// A number of no row; tensor errors.
    pub fn new(numbers: &[u32], rows: usize, device: &Device) -> Result<Self> {
        let places = sums_by_place(device).then(|| Places::new(numbers, rows, device)).transpose()?.map(Arc::new);
        Ok(Self { numbers: Tensor::from_slice(numbers, numbers.len(), device)?, rows, places })
    }

    /// The rows with these numbers: the dimension `dim` of `x` goes from the rows to M.
    pub fn rows(&self, x: &Tensor, dim: usize) -> Result<Tensor> {
        let Some(places) = self.places.clone() else { return x.contiguous()?.index_select(&self.numbers, dim) };
        let value = x.detach().contiguous()?.index_select(&self.numbers, dim)?;
        with_adjoint(x, value, move |bar| places.sums(bar, dim))
    }

    /// For each row the sum of what has its number: the dimension `dim` of `x` goes from M to the rows.
    pub fn sums(&self, x: &Tensor, dim: usize) -> Result<Tensor> {
        let Some(places) = &self.places else {
            let mut shape = x.dims().to_vec();
            shape[dim] = self.rows;
            return Tensor::zeros(shape, x.dtype(), x.device())?.index_add(&self.numbers, x, dim);
        };
        let numbers = self.numbers.clone();
        with_adjoint(x, places.sums(&x.detach(), dim)?, move |bar| bar.contiguous()?.index_select(&numbers, dim))
    }
}

impl Places {
    fn new(numbers: &[u32], rows: usize, device: &Device) -> Result<Self> {
        let mut count = vec![0_usize; rows];
        for &number in numbers {
            match count.get_mut(number as usize) {
                Some(count) => *count += 1,
                None => candle_core::bail!("row {number} of {rows}"),
            }
        }
        let most = count.iter().copied().max().unwrap_or(0);
        let mut places = vec![NOWHERE; rows * most];
        count.fill(0);
        for (place, &number) in numbers.iter().enumerate() {
            let row = number as usize;
            places[row * most + count[row]] = place as u32;
            count[row] += 1;
        }
        Ok(Self { places: Tensor::from_vec(places, rows * most, device)?, rows, most })
    }

    /// See [`Gather::sums`]; without a graph.
    fn sums(&self, x: &Tensor, dim: usize) -> Result<Tensor> {
        let mut shape = x.dims().to_vec();
        shape.splice(dim..=dim, [self.rows, self.most]);
        x.contiguous()?.index_select(&self.places, dim)?.reshape(shape)?.sum(dim + 1)
    }
}
