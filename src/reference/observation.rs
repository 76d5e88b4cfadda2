//! S: the radiance that each face sends to a camera. Twin of glsl/observe.comp.

use super::{Leaving, Model};
use glam::DVec3;

/// L_i(direction to the eye) of every face whose front the eye sees; zero for the others. W/(m² sr).
pub fn observe(model: &Model, leaving: &Leaving, eye: DVec3) -> Vec<DVec3> {
    let colour = |(i, facet): (usize, &super::Facet)| {
        let to_eye = (eye - facet.centroid).normalize_or_zero();
        if to_eye.dot(facet.normal) > 0.0 { leaving.radiance(model, i, to_eye, true) } else { DVec3::ZERO }
    };
    model.facets.iter().enumerate().map(colour).collect()
}
