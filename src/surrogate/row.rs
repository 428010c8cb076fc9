//! Arithmetic number by number along rows, in lanes.
//!
//! Written as plain loops these end, once the compiler has to check an index in them, with up to a whole unrolled vector of
//! numbers one by one: with 128 columns that was half of each row, and a tenth of a training step.

use crate::lanes::{Lanes, Real, WIDEST};

/// x <- f(x, the numbers of the other rows at the same place).
///
/// # Panics
/// The lengths differ.
#[inline(always)]
pub fn each<L: Lanes, const K: usize>(x: &mut [L::Real], others: [&[L::Real]; K], f: impl Fn(L, [L; K]) -> L) {
    let length = x.len();
    assert!(others.iter().all(|other| other.len() == length), "rows of different lengths");
    let whole = length / L::COUNT * L::COUNT;
    for at in (0..whole).step_by(L::COUNT) {
        // SAFETY: all have at least `at + COUNT` numbers.
        unsafe {
            let others = others.map(|other| L::load(other.as_ptr().add(at)));
            f(L::load(x.as_ptr().add(at)), others).store(x.as_mut_ptr().add(at));
        }
    }
    if whole < length {
        let mut lanes = [L::Real::default(); WIDEST];
        let last = f(L::load_part(&x[whole..]), others.map(|other| L::load_part(&other[whole..])));
        // SAFETY: no lane type is wider than WIDEST.
        unsafe { last.store(lanes.as_mut_ptr()) };
        x[whole..].copy_from_slice(&lanes[..length - whole]);
    }
}

/// sum of f(a, b) over two rows.
///
/// # Panics
/// The lengths differ.
#[inline(always)]
pub fn sum<L: Lanes>(a: &[L::Real], b: &[L::Real], f: impl Fn(L, L) -> L) -> L::Real {
    assert!(a.len() == b.len(), "rows of different lengths");
    let mut sum = L::zero();
    let whole = a.len() / L::COUNT * L::COUNT;
    for at in (0..whole).step_by(L::COUNT) {
        // SAFETY: both have at least `at + COUNT` numbers.
        sum += unsafe { f(L::load(a.as_ptr().add(at)), L::load(b.as_ptr().add(at))) };
    }
    if whole < a.len() {
        // Lanes behind the end are taken out again: f need not be 0 there.
        let mut lanes = [L::Real::default(); WIDEST];
        // SAFETY: no lane type is wider than WIDEST.
        unsafe { f(L::load_part(&a[whole..]), L::load_part(&b[whole..])).store(lanes.as_mut_ptr()) };
        lanes[a.len() - whole..].fill(L::Real::default());
        sum += L::load_part(&lanes);
    }
    sum.sum()
}

/// sum += every row.
#[inline(always)]
pub fn add_rows<L: Lanes>(sum: &mut [L::Real], rows: &[L::Real]) {
    for row in rows.chunks_exact(sum.len()) {
        each::<L, 1>(sum, [row], |sum, [x]| sum + x);
    }
}

/// rows <- relu(rows + bias).
#[inline(always)]
pub fn activate<L: Lanes>(rows: &mut [L::Real], bias: &[L::Real]) {
    for row in rows.chunks_exact_mut(bias.len()) {
        each::<L, 1>(row, [bias], |x, [b]| (x + b).positive());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every length around the widths of the lanes, against plain loops.
    fn check<L: Lanes>() {
        for length in [1, 2, 3, 4, 7, 8, 9, 15, 16, 17, 31, 32, 33, 128] {
            let numbers = |shift: f64| -> Vec<L::Real> {
                (0..length).map(|c| L::Real::of(((c as f64 * 0.7 + shift).sin() * 64.0).round() / 8.0)).collect()
            };
            let (mut x, a, b) = (numbers(0.1), numbers(1.3), numbers(2.9));
            let product: f64 = a.iter().zip(&b).map(|(a, b)| (a.f64() + 1.0) * (b.f64() - 2.0)).sum();
            let one = L::splat(L::Real::of(1.0));
            // Multiples of 1/8 below 10: both are exact.
            assert_eq!(sum::<L>(&a, &b, |a, b| (a + one) * (b - one - one)).f64(), product, "{length}");
            let wanted: Vec<f64> = (0..length).map(|c| x[c].f64() + a[c].f64() * b[c].f64()).collect();
            each::<L, 2>(&mut x, [&a, &b], |x, [a, b]| x + a * b);
            assert_eq!(x.iter().map(|x| x.f64()).collect::<Vec<_>>(), wanted);
            let mut rows = [a.clone(), b.clone()].concat();
            activate::<L>(&mut rows, &a);
            let wanted: Vec<f64> =
                [&a, &b].iter().flat_map(|r| r.iter().zip(&a)).map(|(x, b)| (x.f64() + b.f64()).max(0.0)).collect();
            assert_eq!(rows.iter().map(|x| x.f64()).collect::<Vec<_>>(), wanted);
            let mut total = a.clone();
            add_rows::<L>(&mut total, &rows);
            for c in 0..length {
                assert_eq!(total[c].f64(), a[c].f64() + rows[c].f64() + rows[length + c].f64());
            }
        }
    }

    #[test]
    fn rows_of_every_length() {
        check::<<f32 as Real>::Portable>();
        check::<<f64 as Real>::Portable>();
        #[cfg(target_arch = "x86_64")]
        {
            if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
                check::<<f32 as Real>::Avx2>();
                check::<<f64 as Real>::Avx2>();
            }
            if is_x86_feature_detected!("avx512f") {
                check::<<f32 as Real>::Avx512>();
                check::<<f64 as Real>::Avx512>();
            }
        }
    }
}
