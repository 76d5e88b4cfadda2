//! Bits that say what may pass between sources and receivers. Twin of crates/core/glsl/passing.glsl.

/// Light of the sources' fronts can reach fronts of the receivers.
pub const PAIR_FRONT: u32 = 1;
/// Antiradiance of the sources' backs can reach fronts of the receivers.
pub const PAIR_BACK: u32 = 2;
/// Some pair may be within the near field.
pub const PAIR_NEAR: u32 = 4;
