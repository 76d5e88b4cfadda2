//! S: the radiance that each face sends to a camera. Twin of glsl/observe.comp.

use super::{Model, Outgoing};
use glam::DVec3;

/// L_i(direction to the camera) of every face whose front the camera sees; zero for the others. W/(m² sr).
pub fn observe(model: &Model, outgoing: &Outgoing, camera_position: DVec3) -> Vec<DVec3> {
    let colour = |(i, facet): (usize, &super::Facet)| {
        let to_camera = (camera_position - facet.centroid).normalize_or_zero();
        if to_camera.dot(facet.normal) > 0.0 {
            outgoing.radiance(model, i, to_camera, true)
        } else {
            DVec3::ZERO
        }
    };
    model.facets.iter().enumerate().map(colour).collect()
}
