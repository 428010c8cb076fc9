//! e^x in lanes.
//!
//! x = n ln 2 + r with a whole n and |r| <= ln(2)/2, e^x = 2^n e^r, and e^r by its Taylor polynomial, whose remainder is
//! below the rounding (4e-18 in f64, 5e-9 in f32). ln 2 is subtracted in two parts, the first with so few digits that n
//! times it is exact (Cody and Waite 1980).

use super::lanes::{Lanes, Real};

/// 1/2!, 1/3!, ... 1/13!.
const COEFFICIENTS: [f64; 12] = {
    let mut all = [0.5; 12];
    let mut k = 1;
    while k < 12 {
        all[k] = all[k - 1] / (k + 2) as f64;
        k += 1;
    }
    all
};

/// e^x to 1e-15 of itself in f64 and 1e-7 in f32, for |x| <= 700 and 87; nearer to 0 or to infinity it stays at the
/// value that it has there.
#[inline(always)]
pub fn exponential<L: Lanes>(x: L) -> L {
    let number = |value: f64| L::splat(L::Real::of(value));
    let single = std::mem::size_of::<L::Real>() == 4;
    // Terms of e^r behind 1 + r; ends of the range; ln 2 in two parts.
    let (terms, end, high) = match single {
        true => (6, 87.0, 0.693_359_375),
        false => (12, 700.0, 0.693_147_180_369_123_8),
    };
    // ln 2 - high, from more digits of ln 2 than an f64 has.
    let low = if single { -2.121_944_400_546_905_8e-4 } else { 1.908_214_929_270_587_7e-10 };
    let x = x.select_less(number(-end), number(-end), x);
    let x = x.select_less(number(end), x, number(end));
    let n = (x * number(std::f64::consts::LOG2_E)).round();
    let r = n.mul_add(number(-low), n.mul_add(number(-high), x));
    let mut sum = number(COEFFICIENTS[terms - 1]);
    for k in (0..terms - 1).rev() {
        sum = sum.mul_add(r, number(COEFFICIENTS[k]));
    }
    // e^r - 1 = r + r^2 sum is small beside the 1, so that its own rounding does not count.
    let scale = n.power_of_two();
    (r * r).mul_add(sum, r).mul_add(scale, scale)
}
