//! J: what a triangle blocks leaves its back as antiradiance. Twin of glsl/go_through.comp.

use super::{Model, State};
use glam::DVec3;

/// A(b) = H(b) / c_b, W/(m² sr), for every triangle with bins; only blockers let it out.
pub fn go_through(model: &Model, state: &State) -> Vec<DVec3> {
    let projected = model.bins.projected.iter().cycle();
    state.bins.iter().zip(projected).map(|(&h, &c)| h / c).collect()
}
