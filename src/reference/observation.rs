//! S: the radiance of each front towards a camera. Twin of glsl/observe.comp.

use super::{Model, Outgoing};
use glam::DVec3;

/// Radiance of every triangle towards the camera, W/(m² sr); zero where the camera is behind it.
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
