//! Reproducible random numbers.

use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::SplitMix64;

/// A seeded random number generator: SplitMix64 (Steele, Lea and Flood 2014).
#[derive(Clone, Debug)]
pub struct Random(SplitMix64);

impl Random {
    /// The sequence of a seed.
    pub fn new(seed: u64) -> Self {
        Self(SplitMix64::seed_from_u64(seed))
    }

    /// The sequence of a list of numbers, unrelated to those of other lists.
    pub fn of(numbers: &[u64]) -> Self {
        // Each output of SplitMix64 is a mixture of all bits of its state.
        let mixed = |seed: u64| SplitMix64::seed_from_u64(seed).random::<u64>();
        Self::new(numbers.iter().fold(0, |seed, number| mixed(seed ^ number)))
    }

    /// Uniform in [0, 1).
    #[expect(clippy::should_implement_trait, reason = "there is always a next one")]
    pub fn next(&mut self) -> f64 {
        self.0.random()
    }

    /// Uniform in the unit cube [0, 1)³.
    pub fn point(&mut self) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next())
    }

    /// Uniform in [-1, 1)³.
    pub fn vector(&mut self) -> DVec3 {
        2.0 * self.point() - 1.0
    }

    /// Uniform on the unit sphere.
    pub fn direction(&mut self) -> DVec3 {
        loop {
            let v = self.vector();
            if (0.01..1.0).contains(&v.length_squared()) {
                return v.normalize();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first numbers of SplitMix64 for the seed 1234567. Reference data and the scenes of tests and benchmarks depend on the
    /// sequence, which must survive updates of crates.
    #[test]
    fn the_sequence_of_splitmix64() {
        let mut random = Random::new(1_234_567);
        for bits in [6_457_827_717_110_365_317_u64, 3_203_168_211_198_807_973, 9_817_491_932_198_370_423] {
            assert_eq!(random.next(), (bits >> 11) as f64 / (1u64 << 53) as f64);
        }
    }

    /// Neighbouring lists give unrelated sequences: their first numbers are uniform.
    #[test]
    fn sequences_of_lists_are_unrelated() {
        let first = |k: u64| Random::of(&[k / 100, k % 100]).next();
        let n = 10_000;
        let mean = (0..n).map(first).sum::<f64>() / n as f64;
        let products = (1..n).map(|k| (first(k) - 0.5) * (first(k - 1) - 0.5)).sum::<f64>() / n as f64;
        // Four standard errors: 0.29 % and 0.083 %.
        assert!((mean - 0.5).abs() <= 0.0116 && products.abs() <= 0.0034, "{mean}, {products}");
        assert_ne!(Random::of(&[1, 2]).next(), Random::of(&[2, 1]).next());
    }

    #[test]
    fn directions_are_spread_evenly() {
        let mut random = Random::new(1);
        let found: Vec<DVec3> = (0..10_000).map(|_| random.direction()).collect();
        assert!(found.iter().all(|d| (d.length() - 1.0).abs() <= 1e-12));
        let mean = found.iter().sum::<DVec3>() / 1e4;
        let squares = found.iter().map(|d| d * d).sum::<DVec3>() / 1e4;
        // Four standard errors: of a component 0.58 %, of its square 0.30 %.
        assert!(mean.abs().max_element() <= 0.023 && (squares - 1.0 / 3.0).abs().max_element() <= 0.012);
    }
}
