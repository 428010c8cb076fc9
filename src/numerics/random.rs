//! Random numbers: ChaCha8, one named stream per purpose, so that a seed gives the same run whatever else is drawn.

use rand_chacha::rand_core::{RngCore, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// The stream of a purpose: the name's bytes (at most 8) are the stream's number.
pub fn stream(seed: u64, purpose: &str) -> ChaCha8Rng {
    of_bytes(seed, purpose.bytes().take(8))
}

/// The stream of one of many: at most 4 bytes of purpose, and its number.
pub fn numbered(seed: u64, purpose: &str, number: u32) -> ChaCha8Rng {
    let purpose = purpose.bytes().chain([0; 4]).take(4);
    of_bytes(seed, purpose.chain(number.to_le_bytes()))
}

/// The stream whose number has these bytes, the lowest first.
fn of_bytes(seed: u64, bytes: impl Iterator<Item = u8>) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(bytes.zip(0..).fold(0, |number, (byte, place)| number | u64::from(byte) << (8 * place)));
    rng
}

/// A seed that TOML can hold: 63 bits.
pub fn new_seed(rng: &mut ChaCha8Rng) -> u64 {
    rng.next_u64() >> 1
}

/// Uniform in [0, 1) with 53 bits.
pub fn uniform(rng: &mut ChaCha8Rng) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// Standard normal numbers by Box and Muller, two at a time.
pub struct Normal {
    rng: ChaCha8Rng,
    spare: Option<f64>,
}

impl Normal {
    pub fn new(rng: ChaCha8Rng) -> Self {
        Self { rng, spare: None }
    }

    // Not an Iterator: it never ends, and an Option per number would say otherwise.
    #[allow(clippy::should_implement_trait)]
    pub fn next(&mut self) -> f64 {
        if let Some(z) = self.spare.take() {
            return z;
        }
        let radius = (-2.0 * (1.0 - uniform(&mut self.rng)).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * uniform(&mut self.rng)).sin_cos();
        self.spare = Some(radius * sin);
        radius * cos
    }
}
