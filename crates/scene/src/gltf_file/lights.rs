//! Lights of KHR_lights_punctual. A candela counts as a W/sr.

use std::f64::consts::TAU;

use glam::{DMat4, DVec3};
use gltf::khr_lights_punctual::{Kind, Light};

use crate::point_lights::PointLight;

/// `None` for a directional light.
pub(super) fn read(name: String, light: &Light, place: DMat4) -> Option<PointLight> {
    let intensity = DVec3::from(light.color().map(f64::from)) * f64::from(light.intensity());
    let ahead = place.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z);
    let (solid_angle, axis) = match light.kind() {
        Kind::Directional => return None,
        Kind::Point => (2.0 * TAU, None),
        // The intensity is constant within the inner cone and falls off to the outer one.
        Kind::Spot { inner_cone_angle, outer_cone_angle } => {
            let cone = |angle: f32| TAU * (1.0 - f64::from(angle).cos());
            ((cone(inner_cone_angle) + cone(outer_cone_angle)) / 2.0, Some(ahead))
        }
    };
    let position = place.transform_point3(DVec3::ZERO);
    Some(PointLight { name, position, axis, power: intensity * solid_angle })
}
