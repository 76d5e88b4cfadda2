//! Random numbers, and scenes with a solution in closed form: for integration tests, unit tests and benchmarks alike.
#![allow(dead_code, unused_imports, reason = "each of them uses a part")]

mod plates;
mod random;
mod shadow;

pub use plates::Plates;
pub use random::Random;
pub use shadow::Shadow;

use glam::{DAffine3, DVec3};

/// Transforms the unit square of the ground into one of the given side, m, centred over the origin at the given height, m.
fn square(side: f64, height: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(-0.5 * side, height, -0.5 * side))
        * DAffine3::from_scale(DVec3::new(side, 1.0, side))
}

/// Turns a square that faces up to face down.
const DOWN: DAffine3 = DAffine3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::ZERO);
