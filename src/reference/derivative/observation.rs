//! The derivative of S with respect to the triangles and the camera.

use super::reading::Reading;
use crate::model::FacetGradient;
use crate::model::pull_unit;
use crate::reference::{Model, Outgoing};
use glam::DVec3;

/// The gradient of Σ colour · cotangent (`colours`) with respect to every triangle and to the camera position, per metre, with
/// the outgoing light held fixed. Only the part that varies with direction counts: diffuse radiance is the same everywhere.
pub fn observe_derivative(
    model: &Model,
    outgoing: &Outgoing,
    camera_position: DVec3,
    colours: &[DVec3],
) -> (Vec<FacetGradient>, DVec3) {
    let mut at_camera = DVec3::ZERO;
    let gradients = model.facets.iter().zip(colours).enumerate().map(|(i, (facet, &colour))| {
        let mut gradient = FacetGradient::default();
        let offset = camera_position - facet.centroid;
        let to_camera = offset.normalize_or_zero();
        if to_camera.dot(facet.normal) > 0.0 {
            let at = Reading::of_source(model, outgoing, i, to_camera, true).pull(colour);
            let at_offset = pull_unit(to_camera, offset.length(), at.direction);
            gradient.normal = at.normal;
            gradient.add_centroid(-at_offset);
            at_camera += at_offset;
        }
        gradient
    });
    let gradients = gradients.collect();
    (gradients, at_camera)
}
