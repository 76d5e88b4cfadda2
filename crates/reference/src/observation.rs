//! S: the radiance of each front towards a camera; transpose and derivative. Twin of crates/core/glsl/observe.comp.

use super::lines::{Beam, Row, sent};
use super::variables::{NUMBERS, gradient, variable};
use super::{Model, Outgoing};
use antirad_core::model::{DualVector, Facet, FacetGradient, Vector};
use glam::DVec3;

/// Radiance of every triangle towards the camera, W/(m² sr); zero where the camera is behind it.
pub fn observe(model: &Model, outgoing: &Outgoing, camera_position: DVec3) -> Vec<DVec3> {
    let colour = |(i, run): (usize, Vec<DVec3>)| seen(model, i, &model.facets[i], camera_position).read(&run);
    outgoing.runs(model).into_iter().enumerate().map(colour).collect()
}

/// Sᵀ: from the cotangent of the colours of triangles, seen from `camera_position`, to that of their outgoing light.
pub fn observe_adjoint(model: &Model, camera_position: DVec3, colours: &[DVec3]) -> Outgoing {
    let mut cotangents = model.dark().runs(model);
    for (i, (cotangent, &colour)) in cotangents.iter_mut().zip(colours).enumerate() {
        seen(model, i, &model.facets[i], camera_position).add(colour, cotangent);
    }
    Outgoing::of_runs(&cotangents)
}

/// The gradient of Σ colour · cotangent (`colours`) with respect to every triangle and to the camera position, per metre, with
/// the outgoing light held fixed. Only the part that varies with direction counts: diffuse radiance is the same everywhere.
pub fn observe_derivative(
    model: &Model,
    outgoing: &Outgoing,
    camera_position: DVec3,
    colours: &[DVec3],
) -> (Vec<FacetGradient>, DVec3) {
    let mut at_camera = DVec3::ZERO;
    let runs = outgoing.runs(model).into_iter().zip(colours).enumerate();
    let gradients = runs.map(|(i, (run, &colour))| {
        let camera: DualVector<{ NUMBERS + 3 }> = DualVector::variable(camera_position, NUMBERS);
        let radiance: DualVector<_> = seen(model, i, &variable(&model.facets[i], 0), camera).read(&run);
        let slopes = radiance.dot(colour.into()).slopes;
        at_camera += DVec3::from_slice(&slopes[NUMBERS..]);
        gradient(&slopes)
    });
    (gradients.collect(), at_camera)
}

/// What a camera sees of a triangle's outgoing light.
fn seen<V: Vector>(model: &Model, i: usize, facet: &Facet<V>, camera_position: V) -> Row<V::Scalar> {
    let to_camera = camera_position - facet.centroid;
    if to_camera.value().normalize_or_zero().dot(facet.normal.value()) <= 0.0 {
        return Row::new();
    }
    let one = V::Scalar::from(1.0);
    let beam = Beam { direction: to_camera.normalize(), front: true, diffuse: one, binned: one };
    sent(&model.bins, facet, model.classes[i], &beam)
}
