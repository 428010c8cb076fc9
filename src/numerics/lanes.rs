//! Numbers side by side: the lane types that every pair kernel is written over.
//!
//! A kernel is one generic function; [`Real::run`] compiles it for AVX-512, AVX2 and plain Rust, and
//! [`super::sweep::run_rows`] picks one at run time, so that one binary is fast everywhere. The number of lanes changes
//! the order of a row's sum, so results agree between machines to rounding, and between thread counts of one machine to
//! the bit.

use candle_core::WithDType;
use std::mem::MaybeUninit;
use std::ops::{Add, AddAssign, Div, Mul, Neg, Range, Sub, SubAssign};
use std::sync::OnceLock;

/// An array of f(0), f(1), ... (`std::array::from_fn` and an array's `map` leave calls in kernels, because parts of them
/// are compiled in other pieces of the crate.)
#[inline(always)]
pub fn array<T: Copy, const N: usize>(mut f: impl FnMut(usize) -> T) -> [T; N] {
    let mut all = [const { MaybeUninit::uninit() }; N];
    for k in 0..N {
        all[k].write(f(k));
    }
    // SAFETY: all elements are written, and an array of them is as large.
    unsafe { std::mem::transmute_copy(&all) }
}

/// A scalar of the simulation: `f32` or `f64`.
pub trait Real:
    WithDType
    + bytemuck::Pod
    + Default
    + PartialOrd
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + Sync
    + Send
    + std::iter::Sum
    + std::fmt::Debug
{
    /// Lanes in plain Rust. Those of an instruction set have no name outside this file: a kernel meets them as its type
    /// parameter, compiled by [`Self::run`] for a processor that is known to have them.
    type Portable: Lanes<Real = Self>;
    /// Computes rows of a kernel on this thread, compiled for an instruction set.
    fn run<K: RowKernel<Self>>(kernel: &K, rows: Range<usize>, with: InstructionSet);
    fn of(value: f64) -> Self;
    fn f64(self) -> f64;
    fn sqrt(self) -> Self;
    fn floor(self) -> Self;
}

/// The most lanes of kernels that sum over neighbours in a number of dimensions. In two of them a row has about 30, and much of the second
/// vector of 16 lanes would be padding.
pub const fn lanes_of_rows(dimension: usize) -> usize {
    match dimension {
        2 => 8,
        _ => WIDEST,
    }
}

/// A kernel over rows: computes the rows of a range independently of each other, so that the result does not depend on
/// how ranges are dealt to threads.
pub trait RowKernel<R: Real>: Sync {
    /// The most lanes that it uses, where the instruction set has some as narrow: see [`lanes_of_rows`], or 4 for a kernel that computes
    /// on the four or eight numbers of one particle at a time. Kernels that share what they keep of pairs must agree.
    const MOST_LANES: usize = WIDEST;
    /// Whether it is so long that without vector instructions it is compiled for one number at a time: the compiler
    /// would take minutes to turn arrays into vectors again.
    const LARGE: bool = false;
    /// Must be `#[inline(always)]`, so that it is compiled with the features of its caller.
    fn rows<L: Lanes<Real = R>>(&self, rows: Range<usize>);
}

/// An instruction set that kernels are compiled for and that this processor has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct InstructionSet(Set);

/// Only [`InstructionSet::available`] makes those other than `Portable`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Set {
    Portable,
    #[cfg(target_arch = "x86_64")]
    Avx2,
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl InstructionSet {
    /// The instruction sets that this processor has, the best one last.
    pub fn available() -> Vec<Self> {
        let mut all = vec![Self(Set::Portable)];
        #[cfg(target_arch = "x86_64")]
        if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
            all.push(Self(Set::Avx2));
            if is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
            {
                all.push(Self(Set::Avx512));
            }
        }
        all
    }

    /// The best one of this processor. `HYDROGRAD_SIMD=portable|avx2|avx512` limits it, for tests.
    pub fn best() -> Self {
        static BEST: OnceLock<InstructionSet> = OnceLock::new();
        *BEST.get_or_init(|| {
            let all = Self::available();
            let limit = std::env::var("HYDROGRAD_SIMD").unwrap_or_default();
            let limited = all.iter().find(|set| set.name() == limit);
            *limited.unwrap_or(&all[all.len() - 1])
        })
    }

    pub fn name(self) -> &'static str {
        match self.0 {
            Set::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Set::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Set::Avx512 => "avx512",
        }
    }
}

/// The most lanes of any [`Lanes`].
pub const WIDEST: usize = 16;

/// Added to a whole number, this leaves that number plus the exponent's bias in the low bits of the sum: the exponent of
/// its power of two, once shifted to its place.
const EXPONENT_F64: f64 = (3u64 << 51) as f64 + 1023.0;
const EXPONENT_F32: f32 = (3u32 << 22) as f32 + 127.0;

/// What [`Lanes::out_of_line`] calls.
pub trait Rare {
    type Output;
    /// Must be `#[inline(always)]`, so that it is compiled with the features of its caller.
    fn call(self) -> Self::Output;
}

/// Counts the operations of one lane of f64, as what the instruction set `portable` computes with on x86-64. There it counts what a step
/// must compute, without padding, for the bench's roofline; the compiler adds up the counts of a piece of code, so they cost little.
mod counted {
    use std::cell::Cell;
    use std::sync::atomic::{AtomicU64, Ordering};

    thread_local!(static NOW: Cell<u64> = const { Cell::new(0) });
    static BEFORE: AtomicU64 = AtomicU64::new(0);

    #[inline(always)]
    pub fn count(operations: u64) {
        if cfg!(target_arch = "x86_64") {
            NOW.set(NOW.get() + operations);
        }
    }
    #[inline(always)]
    pub fn ignore(_: u64) {}

    /// Adds up what this thread has counted.
    pub fn collect() {
        BEFORE.fetch_add(NOW.take(), Ordering::Relaxed);
    }
    pub fn total() -> u64 {
        BEFORE.load(Ordering::Relaxed)
    }
}

/// Additions, multiplications, divisions and square roots of kernels in f64 so far; 0 unless they run with `HYDROGRAD_SIMD=portable` on
/// x86-64. What is outside of lanes (the end of a row, plain loops over particles) is not in it.
pub fn counted_operations() -> u64 {
    counted::total()
}

/// A few [`Real`]s that are computed on together.
pub trait Lanes:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
{
    type Real: Real;
    const COUNT: usize;
    fn splat(value: Self::Real) -> Self;
    #[inline(always)]
    fn zero() -> Self {
        Self::splat(Self::Real::default())
    }
    /// 0, 1, 2, ... as numbers.
    fn ramp() -> Self;
    /// Loads `COUNT` numbers.
    ///
    /// # Safety
    /// `from` must be readable for `COUNT` numbers.
    unsafe fn load(from: *const Self::Real) -> Self;
    /// The first numbers of a slice, zeros behind its end.
    #[inline(always)]
    fn load_part(from: &[Self::Real]) -> Self {
        if from.len() >= Self::COUNT {
            // SAFETY: COUNT numbers are there.
            return unsafe { Self::load(from.as_ptr()) };
        }
        let mut part = [Self::Real::default(); WIDEST];
        part[..from.len()].copy_from_slice(from);
        // SAFETY: no lane type is wider than WIDEST.
        unsafe { Self::load(part.as_ptr()) }
    }
    /// The lanes as numbers, zeros behind them.
    #[inline(always)]
    fn numbers(self) -> [Self::Real; WIDEST] {
        let mut numbers = [Self::Real::default(); WIDEST];
        // SAFETY: no lane type is wider than WIDEST.
        unsafe { self.store(numbers.as_mut_ptr()) };
        numbers
    }
    /// The largest lane.
    #[inline(always)]
    fn largest(self) -> Self::Real {
        let numbers = self.numbers();
        numbers[..Self::COUNT].iter().fold(numbers[0], |most, &x| if x > most { x } else { most })
    }
    /// Stores `COUNT` numbers.
    ///
    /// # Safety
    /// `to` must be writable for `COUNT` numbers.
    unsafe fn store(self, to: *mut Self::Real);
    /// `self * factor + term`, rounded once where the machine can.
    fn mul_add(self, factor: Self, term: Self) -> Self;
    fn sqrt(self) -> Self;
    /// 1/sqrt(self) to a few units in the last place; anything at 0. Where the machine can, without its divider, which
    /// needs 40 cycles for the square root and the division of eight f64: a third of a pair pass.
    fn inverse_sqrt(self) -> Self;
    /// max(self, 0).
    fn positive(self) -> Self;
    fn round(self) -> Self;
    /// 2^self of lanes that are whole numbers whose power is neither infinite nor subnormal.
    fn power_of_two(self) -> Self;
    /// Lane by lane: `if self < limit { below } else { above }`.
    fn select_less(self, limit: Self, below: Self, above: Self) -> Self;
    /// Bit `lane` is set where `self < limit`.
    fn bits_less(self, limit: Self) -> u32;
    /// Copies those of `COUNT` entries whose bit is set to the front of `to`, in order; the places behind them get anything.
    ///
    /// # Safety
    /// `from` must be readable and `to` writable for `COUNT` entries.
    unsafe fn compress(from: *const u32, bits: u32, to: *mut u32) {
        let mut kept = 0;
        for lane in 0..Self::COUNT {
            // SAFETY: lane and kept are below COUNT.
            unsafe { *to.add(kept) = *from.add(lane) };
            kept += (bits >> lane & 1) as usize;
        }
    }
    /// Sum of the lanes.
    fn sum(self) -> Self::Real;
    /// Calls a function that is compiled once, with this lane type's instructions, and not copied into the caller: what is rare
    /// must not make every loop longer.
    fn out_of_line<F: Rare>(function: F) -> F::Output;
    /// `fields[q][lane] = records[index[lane] * stride + q]` for q = 0..4.
    ///
    /// # Safety
    /// `index` must be readable for `COUNT` entries; every record that it names must hold at least 4
    /// numbers from `records` on.
    unsafe fn gather4(records: *const Self::Real, stride: usize, index: *const u32) -> [Self; 4];
    /// `values[index[lane]]`.
    ///
    /// # Safety
    /// `index` must be readable for `COUNT` entries, each a valid position in `values`.
    unsafe fn gather(values: *const Self::Real, index: *const u32) -> Self;
}

/// Operators between lanes: `$value` is what is made of the raw numbers `$a` and `$b`.
macro_rules! operators {
    ($name:ident, |$a:ident, $b:ident| $($operator:ident $method:ident $value:expr,)* -$c:ident $negative:expr, $counts:path) => {
        $(impl $operator for $name {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                $counts(1);
                let ($a, $b) = (self.0, other.0);
                Self($value)
            }
        })*
        impl Neg for $name {
            type Output = Self;
            #[inline(always)]
            fn neg(self) -> Self {
                let $c = self;
                $negative
            }
        }
        impl AddAssign for $name {
            #[inline(always)]
            fn add_assign(&mut self, other: Self) {
                *self = *self + other;
            }
        }
    };
}

macro_rules! portable {
    ($name:ident, $real:ty, $count:expr, $exponent:expr, $counts:path) => {
        #[derive(Clone, Copy)]
        pub struct $name([$real; $count]);
        operators!($name, |a, b|
            Add add array(|l| a[l] + b[l]),
            Sub sub array(|l| a[l] - b[l]),
            Mul mul array(|l| a[l] * b[l]),
            Div div array(|l| a[l] / b[l]),
            -c Self(array(|l| -c.0[l])),
            $counts
        );
        impl Lanes for $name {
            type Real = $real;
            const COUNT: usize = $count;
            #[inline(always)]
            fn splat(value: $real) -> Self {
                Self([value; $count])
            }
            #[inline(always)]
            fn ramp() -> Self {
                Self(array(|l| l as $real))
            }
            #[inline(always)]
            unsafe fn load(from: *const $real) -> Self {
                // SAFETY: the caller promises COUNT readable numbers.
                Self(unsafe { from.cast::<[$real; $count]>().read_unaligned() })
            }
            #[inline(always)]
            unsafe fn store(self, to: *mut $real) {
                // SAFETY: the caller promises COUNT writable numbers.
                unsafe { to.cast::<[$real; $count]>().write_unaligned(self.0) }
            }
            #[inline(always)]
            fn mul_add(self, factor: Self, term: Self) -> Self {
                self * factor + term
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                $counts(1);
                Self(array(|l| self.0[l].sqrt()))
            }
            #[inline(always)]
            fn inverse_sqrt(self) -> Self {
                $counts(2);
                Self(array(|l| 1.0 / self.0[l].sqrt()))
            }
            #[inline(always)]
            fn positive(self) -> Self {
                Self(array(|l| if self.0[l] > 0.0 { self.0[l] } else { 0.0 }))
            }
            #[inline(always)]
            fn round(self) -> Self {
                Self(array(|l| self.0[l].round_ties_even()))
            }
            #[inline(always)]
            fn power_of_two(self) -> Self {
                let power = |a: $real| <$real>::from_bits((a + $exponent).to_bits() << (<$real>::MANTISSA_DIGITS - 1));
                Self(array(|l| power(self.0[l])))
            }
            #[inline(always)]
            fn select_less(self, limit: Self, below: Self, above: Self) -> Self {
                Self(array(|l| if self.0[l] < limit.0[l] { below.0[l] } else { above.0[l] }))
            }
            #[inline(always)]
            fn bits_less(self, limit: Self) -> u32 {
                (0..$count).fold(0, |bits, l| bits | ((self.0[l] < limit.0[l]) as u32) << l)
            }
            #[inline(always)]
            fn sum(self) -> $real {
                self.0.iter().sum()
            }
            #[inline(never)]
            fn out_of_line<F: Rare>(function: F) -> F::Output {
                function.call()
            }
            #[inline(always)]
            unsafe fn gather4(records: *const $real, stride: usize, index: *const u32) -> [Self; 4] {
                // SAFETY: the caller promises valid indices and records of at least 4 numbers.
                array(|q| {
                    Self(array(|l| unsafe { *records.add(*index.add(l) as usize * stride + q) }))
                })
            }
            #[inline(always)]
            unsafe fn gather(values: *const $real, index: *const u32) -> Self {
                // SAFETY: the caller promises valid indices.
                Self(array(|l| unsafe { *values.add(*index.add(l) as usize) }))
            }
        }
    };
}

portable!(SingleF64, f64, 1, EXPONENT_F64, counted::count);
portable!(SingleF32, f32, 1, EXPONENT_F32, counted::ignore);
portable!(PortableF64, f64, 4, EXPONENT_F64, counted::ignore);
portable!(PortableF32, f32, 8, EXPONENT_F32, counted::ignore);

#[cfg(target_arch = "x86_64")]
mod x86 {
    use super::*;
    use std::arch::x86_64::*;

    /// Lanes of an instruction set; the raw operations come in the order of the trait's methods.
    macro_rules! vector {
        ($name:ident, $features:literal, $real:ty, $count:expr, $raw:ty,
         $add:path, $sub:path, $mul:path, $div:path, $set1:path, $loadu:path, $storeu:path, $fma:path, $sqrt:path, $max:path;
         inverse_sqrt |$i:ident| $inverse_sqrt:expr;
         round |$r:ident| $round:expr;
         power_of_two |$p:ident| $power_of_two:expr;
         select |$s:ident, $limit:ident, $below:ident, $above:ident| $select:expr;
         bits |$t:ident, $most:ident| $bits:expr;
         compress |$from:ident, $mask:ident, $to:ident| $compress:expr;
         sum |$u:ident| $sum:expr;
         gather4 |$record:ident| $gather4:expr) => {
            #[derive(Clone, Copy)]
            pub struct $name($raw);
            // SAFETY, of every block of this macro: a value of this type, or a call of its functions, means that the
            // processor has its instructions, because only `Real::run` names the type, for an `InstructionSet` that was
            // detected. Pointers are as the contract of the trait says.
            operators!($name, |a, b|
                Add add unsafe { $add(a, b) },
                Sub sub unsafe { $sub(a, b) },
                Mul mul unsafe { $mul(a, b) },
                Div div unsafe { $div(a, b) },
                -c Self::zero() - c,
                counted::ignore
            );
            impl $name {
                #[inline(always)]
                fn from_array(a: [$real; $count]) -> Self {
                    // SAFETY: plain data of the same size.
                    Self(unsafe { std::mem::transmute::<[$real; $count], $raw>(a) })
                }
            }
            impl Lanes for $name {
                type Real = $real;
                const COUNT: usize = $count;
                #[inline(always)]
                fn splat(value: $real) -> Self {
                    Self(unsafe { $set1(value) })
                }
                #[inline(always)]
                fn ramp() -> Self {
                    Self::from_array(array(|l| l as $real))
                }
                #[inline(always)]
                unsafe fn load(from: *const $real) -> Self {
                    Self(unsafe { $loadu(from) })
                }
                #[inline(always)]
                unsafe fn store(self, to: *mut $real) {
                    unsafe { $storeu(to, self.0) }
                }
                #[inline(always)]
                fn mul_add(self, factor: Self, term: Self) -> Self {
                    Self(unsafe { $fma(self.0, factor.0, term.0) })
                }
                #[inline(always)]
                fn sqrt(self) -> Self {
                    Self(unsafe { $sqrt(self.0) })
                }
                #[inline(always)]
                fn inverse_sqrt(self) -> Self {
                    let $i = self;
                    $inverse_sqrt
                }
                #[inline(always)]
                fn positive(self) -> Self {
                    Self(unsafe { $max(self.0, Self::zero().0) })
                }
                #[inline(always)]
                fn round(self) -> Self {
                    let $r = self.0;
                    Self(unsafe { $round })
                }
                #[inline(always)]
                fn power_of_two(self) -> Self {
                    let $p = self.0;
                    Self(unsafe { $power_of_two })
                }
                #[inline(always)]
                fn select_less(self, limit: Self, below: Self, above: Self) -> Self {
                    let ($s, $limit, $below, $above) = (self.0, limit.0, below.0, above.0);
                    Self(unsafe { $select })
                }
                #[inline(always)]
                fn bits_less(self, limit: Self) -> u32 {
                    let ($t, $most) = (self.0, limit.0);
                    unsafe { $bits as u32 }
                }
                #[inline(always)]
                unsafe fn compress($from: *const u32, $mask: u32, $to: *mut u32) {
                    unsafe { $compress }
                }
                #[inline(always)]
                fn sum(self) -> $real {
                    let $u = self.0;
                    unsafe { $sum }
                }
                #[inline(always)]
                fn out_of_line<F: Rare>(function: F) -> F::Output {
                    #[target_feature(enable = $features)]
                    #[inline(never)]
                    fn call<F: Rare>(function: F) -> F::Output {
                        function.call()
                    }
                    unsafe { call(function) }
                }
                #[inline(always)]
                unsafe fn gather4(records: *const $real, stride: usize, index: *const u32) -> [Self; 4] {
                    let $record = |l: usize| unsafe { records.add(*index.add(l) as usize * stride) };
                    // (An array's own `map` is not inlined.)
                    let [a, b, c, d] = unsafe { $gather4 };
                    [Self(a), Self(b), Self(c), Self(d)]
                }
                #[inline(always)]
                unsafe fn gather(values: *const $real, index: *const u32) -> Self {
                    Self::from_array(array(|l| unsafe { *values.add(*index.add(l) as usize) }))
                }
            }
        };
    }

    const NEAREST: i32 = _MM_FROUND_TO_NEAREST_INT | _MM_FROUND_NO_EXC;

    /// Where the set bits of a byte stand, for a permutation of eight entries. Entries are compressed in a register and
    /// stored whole, because compressing stores are slow on some machines.
    const PLACES: [[u32; 8]; 256] = {
        let mut table = [[0; 8]; 256];
        let mut bits = 0;
        while bits < 256 {
            let (mut kept, mut lane) = (0, 0);
            while lane < 8 {
                if bits >> lane & 1 == 1 {
                    table[bits][kept] = lane as u32;
                    kept += 1;
                }
                lane += 1;
            }
            bits += 1;
        }
        table
    };

    // In `gather4`, records are loaded whole (128 or 256 bits each) and transposed in registers: measured 3.2 times faster
    // than the gathers of the hardware.

    vector!(
        Avx2F64, "avx2,fma", f64, 4, __m256d,
        _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_div_pd, _mm256_set1_pd, _mm256_loadu_pd, _mm256_storeu_pd,
        _mm256_fmadd_pd, _mm256_sqrt_pd, _mm256_max_pd;
        inverse_sqrt |a| Self::splat(1.0) / a.sqrt();
        round |a| _mm256_round_pd::<NEAREST>(a);
        power_of_two |a| _mm256_castsi256_pd(_mm256_slli_epi64::<52>(_mm256_castpd_si256(_mm256_add_pd(
            a,
            _mm256_set1_pd(EXPONENT_F64),
        ))));
        select |a, limit, below, above| _mm256_blendv_pd(above, below, _mm256_cmp_pd::<_CMP_LT_OQ>(a, limit));
        bits |a, limit| _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_LT_OQ>(a, limit));
        compress |from, bits, to| {
            let four = _mm256_castsi128_si256(_mm_loadu_si128(from.cast()));
            let places = _mm256_loadu_si256(PLACES[(bits & 15) as usize].as_ptr().cast());
            _mm_storeu_si128(to.cast(), _mm256_castsi256_si128(_mm256_permutevar8x32_epi32(four, places)));
        };
        sum |a| {
            let a: [f64; 4] = std::mem::transmute(a);
            (a[0] + a[2]) + (a[1] + a[3])
        };
        gather4 |record| {
            let row = |l: usize| _mm256_loadu_pd(record(l));
            let (r0, r1, r2, r3) = (row(0), row(1), row(2), row(3));
            let (t0, t1) = (_mm256_unpacklo_pd(r0, r1), _mm256_unpackhi_pd(r0, r1));
            let (t2, t3) = (_mm256_unpacklo_pd(r2, r3), _mm256_unpackhi_pd(r2, r3));
            [
                _mm256_permute2f128_pd::<0x20>(t0, t2),
                _mm256_permute2f128_pd::<0x20>(t1, t3),
                _mm256_permute2f128_pd::<0x31>(t0, t2),
                _mm256_permute2f128_pd::<0x31>(t1, t3),
            ]
        }
    );
    vector!(
        Avx2F32, "avx2,fma", f32, 8, __m256,
        _mm256_add_ps, _mm256_sub_ps, _mm256_mul_ps, _mm256_div_ps, _mm256_set1_ps, _mm256_loadu_ps, _mm256_storeu_ps,
        _mm256_fmadd_ps, _mm256_sqrt_ps, _mm256_max_ps;
        inverse_sqrt |a| Self::splat(1.0) / a.sqrt();
        round |a| _mm256_round_ps::<NEAREST>(a);
        power_of_two |a| _mm256_castsi256_ps(_mm256_slli_epi32::<23>(_mm256_castps_si256(_mm256_add_ps(
            a,
            _mm256_set1_ps(EXPONENT_F32),
        ))));
        select |a, limit, below, above| _mm256_blendv_ps(above, below, _mm256_cmp_ps::<_CMP_LT_OQ>(a, limit));
        bits |a, limit| _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LT_OQ>(a, limit));
        compress |from, bits, to| {
            let places = _mm256_loadu_si256(PLACES[(bits & 255) as usize].as_ptr().cast());
            _mm256_storeu_si256(to.cast(), _mm256_permutevar8x32_epi32(_mm256_loadu_si256(from.cast()), places));
        };
        sum |a| {
            let a: [f32; 8] = std::mem::transmute(a);
            ((a[0] + a[4]) + (a[2] + a[6])) + ((a[1] + a[5]) + (a[3] + a[7]))
        };
        gather4 |record| {
            let row = |l: usize| _mm_loadu_ps(record(l));
            let two = |l: usize| _mm256_insertf128_ps::<1>(_mm256_castps128_ps256(row(l)), row(l + 4));
            let (z0, z1, z2, z3) = (two(0), two(1), two(2), two(3));
            let a = _mm256_castps_pd(_mm256_unpacklo_ps(z0, z1));
            let b = _mm256_castps_pd(_mm256_unpackhi_ps(z0, z1));
            let c = _mm256_castps_pd(_mm256_unpacklo_ps(z2, z3));
            let d = _mm256_castps_pd(_mm256_unpackhi_ps(z2, z3));
            [
                _mm256_castpd_ps(_mm256_unpacklo_pd(a, c)),
                _mm256_castpd_ps(_mm256_unpackhi_pd(a, c)),
                _mm256_castpd_ps(_mm256_unpacklo_pd(b, d)),
                _mm256_castpd_ps(_mm256_unpackhi_pd(b, d)),
            ]
        }
    );
    vector!(
        Avx512F64, "avx512f,avx512vl,avx512dq,avx2,fma", f64, 8, __m512d,
        _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_div_pd, _mm512_set1_pd, _mm512_loadu_pd, _mm512_storeu_pd,
        _mm512_fmadd_pd, _mm512_sqrt_pd, _mm512_max_pd;
        inverse_sqrt |a| {
            // The machine's estimate y has 14 binary digits. The series of 1/sqrt(1 - e), e = 1 - a y^2, to its fourth term
            // gives 56 at once, in fewer operations than two Newton steps.
            let y = Self(unsafe { _mm512_rsqrt14_pd(a.0) });
            let error = (a * y).mul_add(-y, Self::splat(1.0));
            let series = error.mul_add(Self::splat(0.3125), Self::splat(0.375)).mul_add(error, Self::splat(0.5));
            (y * error).mul_add(series, y)
        };
        round |a| _mm512_roundscale_pd::<NEAREST>(a);
        power_of_two |a| _mm512_castsi512_pd(_mm512_slli_epi64::<52>(_mm512_castpd_si512(_mm512_add_pd(
            a,
            _mm512_set1_pd(EXPONENT_F64),
        ))));
        select |a, limit, below, above| _mm512_mask_blend_pd(_mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, limit), above, below);
        bits |a, limit| _mm512_cmp_pd_mask::<_CMP_LT_OQ>(a, limit);
        compress |from, bits, to| {
            let eight = _mm256_loadu_si256(from.cast());
            _mm256_storeu_si256(to.cast(), _mm256_maskz_compress_epi32(bits as u8, eight));
        };
        sum |a| _mm512_reduce_add_pd(a);
        gather4 |record| {
            let row = |l: usize| _mm256_loadu_pd(record(l));
            let two = |l: usize, m: usize| _mm512_insertf64x4::<1>(_mm512_castpd256_pd512(row(l)), row(m));
            let (a, b, c, d) = (two(0, 2), two(1, 3), two(4, 6), two(5, 7));
            let (t0, t1) = (_mm512_unpacklo_pd(a, b), _mm512_unpackhi_pd(a, b));
            let (t2, t3) = (_mm512_unpacklo_pd(c, d), _mm512_unpackhi_pd(c, d));
            [
                _mm512_shuffle_f64x2::<0x88>(t0, t2),
                _mm512_shuffle_f64x2::<0x88>(t1, t3),
                _mm512_shuffle_f64x2::<0xDD>(t0, t2),
                _mm512_shuffle_f64x2::<0xDD>(t1, t3),
            ]
        }
    );
    vector!(
        Avx512F32, "avx512f,avx512vl,avx512dq,avx2,fma", f32, 16, __m512,
        _mm512_add_ps, _mm512_sub_ps, _mm512_mul_ps, _mm512_div_ps, _mm512_set1_ps, _mm512_loadu_ps, _mm512_storeu_ps,
        _mm512_fmadd_ps, _mm512_sqrt_ps, _mm512_max_ps;
        inverse_sqrt |a| {
            // One Newton step y + y/2 e, e = 1 - a y^2, doubles the 14 binary digits of the machine's estimate.
            let y = Self(unsafe { _mm512_rsqrt14_ps(a.0) });
            let error = (a * y).mul_add(-y, Self::splat(1.0));
            (y * Self::splat(0.5)).mul_add(error, y)
        };
        round |a| _mm512_roundscale_ps::<NEAREST>(a);
        power_of_two |a| _mm512_castsi512_ps(_mm512_slli_epi32::<23>(_mm512_castps_si512(_mm512_add_ps(
            a,
            _mm512_set1_ps(EXPONENT_F32),
        ))));
        select |a, limit, below, above| _mm512_mask_blend_ps(_mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, limit), above, below);
        bits |a, limit| _mm512_cmp_ps_mask::<_CMP_LT_OQ>(a, limit);
        compress |from, bits, to| {
            let sixteen = _mm512_loadu_si512(from.cast());
            _mm512_storeu_si512(to.cast(), _mm512_maskz_compress_epi32(bits as u16, sixteen));
        };
        sum |a| _mm512_reduce_add_ps(a);
        gather4 |record| {
            let row = |l: usize| _mm_loadu_ps(record(l));
            // Lanes l, l+4, l+8, l+12 in the four 128-bit blocks.
            let four = |l: usize| {
                let z = _mm512_castps128_ps512(row(l));
                let z = _mm512_insertf32x4::<1>(z, row(l + 4));
                let z = _mm512_insertf32x4::<2>(z, row(l + 8));
                _mm512_insertf32x4::<3>(z, row(l + 12))
            };
            let (z0, z1, z2, z3) = (four(0), four(1), four(2), four(3));
            let a = _mm512_castps_pd(_mm512_unpacklo_ps(z0, z1));
            let b = _mm512_castps_pd(_mm512_unpackhi_ps(z0, z1));
            let c = _mm512_castps_pd(_mm512_unpacklo_ps(z2, z3));
            let d = _mm512_castps_pd(_mm512_unpackhi_ps(z2, z3));
            [
                _mm512_castpd_ps(_mm512_unpacklo_pd(a, c)),
                _mm512_castpd_ps(_mm512_unpackhi_pd(a, c)),
                _mm512_castpd_ps(_mm512_unpacklo_pd(b, d)),
                _mm512_castpd_ps(_mm512_unpackhi_pd(b, d)),
            ]
        }
    );
}

macro_rules! real {
    ($real:ty, $single:ty, $portable:ty, $avx2:ident, $avx512:ident) => {
        impl Real for $real {
            type Portable = $portable;
            fn run<K: RowKernel<Self>>(kernel: &K, rows: Range<usize>, with: InstructionSet) {
                // None of these is inlined, so a program that uses this library calls the library's own and compiles no
                // kernel again.
                #[cfg(target_arch = "x86_64")]
                #[inline(never)]
                #[target_feature(enable = "avx512f,avx512vl,avx512dq,avx2,fma")]
                fn avx512<K: RowKernel<$real>>(kernel: &K, rows: Range<usize>) {
                    if K::MOST_LANES < <x86::$avx512 as Lanes>::COUNT {
                        kernel.rows::<x86::$avx2>(rows);
                    } else {
                        kernel.rows::<x86::$avx512>(rows);
                    }
                }
                #[cfg(target_arch = "x86_64")]
                #[inline(never)]
                #[target_feature(enable = "avx2,fma")]
                fn avx2<K: RowKernel<$real>>(kernel: &K, rows: Range<usize>) {
                    kernel.rows::<x86::$avx2>(rows);
                }
                // One number at a time also on x86-64: only processors from before 2013 lack AVX2, and a third of the time
                // to compile this crate would go into turning arrays into vectors.
                #[inline(never)]
                fn portable<K: RowKernel<$real>>(kernel: &K, rows: Range<usize>) {
                    if K::LARGE || cfg!(target_arch = "x86_64") {
                        kernel.rows::<$single>(rows);
                        counted::collect();
                    } else {
                        kernel.rows::<$portable>(rows);
                    }
                }
                match with.0 {
                    // SAFETY: an instruction set is only there if this processor has it.
                    #[cfg(target_arch = "x86_64")]
                    Set::Avx512 => unsafe { avx512(kernel, rows) },
                    #[cfg(target_arch = "x86_64")]
                    Set::Avx2 => unsafe { avx2(kernel, rows) },
                    Set::Portable => portable(kernel, rows),
                }
            }
            #[inline(always)]
            fn of(value: f64) -> Self {
                value as $real
            }
            #[inline(always)]
            fn f64(self) -> f64 {
                self as f64
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn floor(self) -> Self {
                self.floor()
            }
        }
    };
}
real!(f64, SingleF64, PortableF64, Avx2F64, Avx512F64);
real!(f32, SingleF32, PortableF32, Avx2F32, Avx512F32);
