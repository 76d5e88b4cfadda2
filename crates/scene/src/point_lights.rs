//! Lights without size, as small lamps of the same power.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::DVec3;

use crate::geometry::{RawMaterial, RawMesh};
use crate::material::Material;
use crate::mesh_file::Contents;
use crate::{Shape, bounds};

/// Radius of a lamp, relative to the diagonal of the scene.
const RADIUS: f64 = 0.005;
/// Corners of the disc of a spot light.
const CORNERS: u32 = 8;

/// A light from a point.
pub(super) struct PointLight {
    pub name: String,
    pub position: DVec3,
    /// Where a spot light shines; `None` for light in all directions.
    pub axis: Option<DVec3>,
    /// W, RGB.
    pub power: DVec3,
}

/// Adds lamps in proportion to the meshes, and says so.
pub(super) fn add(lights: &[PointLight], contents: &mut Contents, path: &Path, warnings: &mut Vec<String>) {
    let (low, high) = bounds(contents.meshes.iter().flat_map(|(_, mesh)| mesh.vertices.iter().copied()));
    let size = (high - low).length();
    if lights.is_empty() || !(size > 0.0 && size.is_finite()) {
        return;
    }
    warnings.push(format!(
        "{}: {} point and spot light(s) are lamps of the same power, icosahedra and discs {:.3e} m wide.",
        path.display(),
        lights.len(),
        2.0 * RADIUS * size
    ));
    contents.meshes.extend(lights.iter().map(|light| light.lamp(RADIUS * size, path)));
}

impl PointLight {
    /// An icosahedron, which shines alike in all directions within 5 %, or a disc towards the axis.
    fn lamp(&self, radius: f64, path: &Path) -> (String, RawMesh) {
        let (vertices, faces) = match self.axis {
            None => Shape::Icosphere { level: 0, inward: false }.mesh(),
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
        let vertices = vertices.into_iter().map(|v| self.position + radius * v).collect();
        let mut mesh = RawMesh::uniform(vertices, faces, &self.name);
        let emission = self.power / (PI * mesh.area());
        let material = Material { emission: emission.max(DVec3::ZERO).into(), ..Material::named(&self.name) };
        mesh.materials.push(RawMaterial::of_file(material, path));
        (self.name.clone(), mesh)
    }
}
