//! Lights of KHR_lights_punctual. A candela counts as a W/sr, a lux as a W/m².

use std::f64::consts::TAU;

use glam::{DMat4, DVec3};
use gltf::khr_lights_punctual::{Kind, Light};
use serde::Deserialize;

use crate::Sun;
use crate::point_lights::PointLight;

/// A light, as it is represented.
pub(super) enum Represented {
    Lamp(PointLight),
    Sun(Sun),
}

pub(super) fn read(name: String, light: &Light, place: DMat4) -> Represented {
    let intensity = DVec3::from(light.color().map(f64::from)) * f64::from(light.intensity());
    let ahead = place.transform_vector3(DVec3::NEG_Z).normalize_or(DVec3::NEG_Z);
    let (solid_angle, axis) = match light.kind() {
        Kind::Directional => {
            let angular_diameter =
                light.extras().as_ref().and_then(|extras| diameter(extras.get())).unwrap_or(Sun::DIAMETER);
            let irradiance = intensity.to_array();
            return Represented::Sun(Sun { direction: ahead, irradiance, angular_diameter });
        }
        Kind::Point => (2.0 * TAU, None),
        // The intensity is constant within the inner cone and falls off to the outer one.
        Kind::Spot { inner_cone_angle, outer_cone_angle } => {
            let cone = |angle: f32| TAU * (1.0 - f64::from(angle).cos());
            ((cone(inner_cone_angle) + cone(outer_cone_angle)) / 2.0, Some(ahead))
        }
    };
    let position = place.transform_point3(DVec3::ZERO);
    Represented::Lamp(PointLight { name, position, axis, power: intensity * solid_angle })
}

/// The angular diameter, degrees, of a sun that was exported from here, in `extras` of its light.
fn diameter(extras: &str) -> Option<f64> {
    #[derive(Deserialize)]
    struct Extras {
        antirad: Disc,
    }
    #[derive(Deserialize)]
    struct Disc {
        angular_diameter: f64,
    }
    serde_json::from_str::<Extras>(extras).ok().map(|extras| extras.antirad.angular_diameter)
}
