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

    /// Uniform in [0, 1).
    #[allow(clippy::should_implement_trait, reason = "there is always a next one")]
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
