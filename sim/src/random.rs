//! Chance that depends on a seed and on what it is for, never on the order of asking.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// A seed for one of many things that share a seed (the finaliser of SplitMix64: Steele, Lea and
/// Flood, Fast splittable pseudorandom number generators, OOPSLA 2014).
#[must_use]
pub(crate) fn derived_seed(seed: u64, index: u64) -> u64 {
    let mut z = seed.wrapping_add((index.wrapping_add(1)).wrapping_mul(0x9e37_79b9_7f4a_7c15));
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// Uniform in [0, 1), from the upper bits of a seed.
pub(crate) fn unit(seed: u64) -> f64 {
    (seed >> 11) as f64 / (1_u64 << 53) as f64
}

/// Uniform numbers, one after the other.
pub(crate) struct Draws(u64, u64);

impl Draws {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed, 0)
    }

    pub(crate) fn seed(&mut self) -> u64 {
        self.1 += 1;
        derived_seed(self.0, self.1)
    }

    /// In [low, high).
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * unit(self.seed())
    }

    /// 0 to `count` - 1.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        (unit(self.seed()) * count as f64) as usize
    }
}

/// Normal with mean 0 and variance 1 (Box and Muller, 1958).
pub(crate) fn standard_normal(random: &mut ChaCha8Rng) -> f64 {
    let radius = (-2.0 * (1.0 - random.random::<f64>()).ln()).sqrt();
    radius * (std::f64::consts::TAU * random.random::<f64>()).cos()
}
