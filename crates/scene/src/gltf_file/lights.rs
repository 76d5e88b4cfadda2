//! Lights of KHR_lights_punctual as small lamps of the same power. A candela counts as a W/sr.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::{DMat4, DVec3};
use gltf::khr_lights_punctual::Kind;

use crate::geometry::{RawMaterial, RawMesh};
use crate::material::Material;

/// Radius of a lamp, relative to the diagonal of the scene.
pub(super) const RADIUS: f64 = 0.005;
/// Corners of the disc of a spot light.
const CORNERS: u32 = 8;

pub(super) struct Light {
    name: String,
    position: DVec3,
    /// The axis of a spot light.
    axis: Option<DVec3>,
    /// W, RGB.
    power: DVec3,
}

impl Light {
    /// `None` for a directional light.
    pub fn new(name: String, light: &gltf::khr_lights_punctual::Light, place: DMat4) -> Option<Self> {
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
        Some(Self {
            name,
            position: place.transform_point3(DVec3::ZERO),
            axis,
            power: intensity * solid_angle,
        })
    }

    /// A lamp in a scene of a size: an octahedron, or a disc towards the axis.
    pub fn lamp(&self, size: f64, path: &Path) -> (String, RawMesh) {
        let radius = RADIUS * size;
        let (vertices, faces) = match self.axis {
            None => {
                let axes = [DVec3::X, DVec3::Y, DVec3::Z];
                let vertices: Vec<DVec3> = axes.into_iter().flat_map(|axis| [axis, -axis]).collect();
                let faces = (0..8u32).map(|k| {
                    let [x, y, z] = [k & 1, 2 + (k >> 1 & 1), 4 + (k >> 2 & 1)];
                    if k.count_ones() % 2 == 0 { [x, y, z] } else { [x, z, y] }
                });
                (vertices, faces.collect::<Vec<_>>())
            }
            Some(axis) => {
                let (u, v) = axis.any_orthonormal_pair();
                let corner = |k: u32| {
                    let (sin, cos) = (TAU * f64::from(k) / f64::from(CORNERS)).sin_cos();
                    u * cos + v * sin
                };
                let faces = (1..CORNERS - 1).map(|k| [0, k, k + 1]);
                ((0..CORNERS).map(corner).collect(), faces.collect())
            }
        };
        let vertices: Vec<DVec3> = vertices.into_iter().map(|v| self.position + radius * v).collect();
        let at = |v: u32| vertices[v as usize];
        let area: f64 =
            faces.iter().map(|&[a, b, c]| (at(b) - at(a)).cross(at(c) - at(a)).length() / 2.0).sum();
        let emission = self.power / (PI * area);
        let material = Material { emission: emission.max(DVec3::ZERO).into(), ..Material::named(&self.name) };
        let mut mesh = RawMesh::uniform(vertices, faces, &self.name);
        mesh.materials.push(RawMaterial::of_file(material, path));
        (self.name.clone(), mesh)
    }
}
