//! A mesh before it joins the scene: subdivision and placement.

use std::collections::HashMap;
use std::path::PathBuf;

use glam::{DMat3, DVec3};

use super::Material;

/// A mesh as read or generated: faces in file order, the triangles of a polygon consecutive.
pub(super) struct RawMesh {
    pub vertices: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    /// Per face, an index into `material_names`.
    pub face_materials: Vec<u32>,
    /// Per face, its line in the mesh's file; empty without a file.
    pub face_lines: Vec<u32>,
    pub material_names: Vec<String>,
    /// Materials from the mesh's MTL files, and grey placeholders for missing ones.
    pub materials: Vec<RawMaterial>,
}

pub(super) struct RawMaterial {
    pub material: Material,
    /// File and line of the definition; `None` for a grey placeholder.
    pub origin: Option<(PathBuf, usize)>,
    /// Whether its triangles have a second side.
    pub two_sided: bool,
}

impl RawMesh {
    /// A mesh of a single material.
    pub fn uniform(vertices: Vec<DVec3>, faces: Vec<[u32; 3]>, material: &str) -> Self {
        Self {
            face_materials: vec![0; faces.len()],
            face_lines: Vec::new(),
            vertices,
            faces,
            material_names: vec![material.to_owned()],
            materials: Vec::new(),
        }
    }

    /// Halves every edge. The four parts of a face are consecutive, so that faces stay in file order.
    pub fn subdivide(&mut self) {
        self.faces = subdivide(&mut self.vertices, &self.faces);
        for each in [&mut self.face_materials, &mut self.face_lines] {
            *each = each.iter().flat_map(|&value| [value; 4]).collect();
        }
    }
}

/// Halves every edge: each face becomes four, consecutive.
///
/// Neighbours share the new vertices. Order of the parts: the three at the corners, in the corners' order, then the middle.
pub(super) fn subdivide(vertices: &mut Vec<DVec3>, faces: &[[u32; 3]]) -> Vec<[u32; 3]> {
    let mut middles: HashMap<[u32; 2], u32> = HashMap::new();
    let mut middle = |a: u32, b: u32| {
        *middles.entry([a.min(b), a.max(b)]).or_insert_with(|| {
            vertices.push((vertices[a as usize] + vertices[b as usize]) / 2.0);
            vertices.len() as u32 - 1
        })
    };
    let mut children = Vec::with_capacity(faces.len() * 4);
    for &[a, b, c] in faces {
        let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
        children.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
    }
    children
}

/// The placement of a mesh: scale, then rotation, then translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement {
    /// Factors along x, y, z.
    pub scale: DVec3,
    /// Degrees about x, then y, then z.
    pub rotate_degrees: DVec3,
    /// Metres.
    pub translate: DVec3,
}

impl Placement {
    pub fn apply(&self, vertices: &mut [DVec3], faces: &mut [[u32; 3]]) {
        let [x, y, z] = self.rotate_degrees.to_array().map(sin_cos_degrees);
        let rotation = about_z(z) * about_y(y) * about_x(x);
        for vertex in vertices {
            *vertex = rotation * (self.scale * *vertex) + self.translate;
        }
        let mirrors = self.scale.to_array().iter().filter(|&&s| s < 0.0).count();
        if mirrors % 2 == 1 {
            // A reflection turns fronts into backs: rewind the faces.
            faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
    }
}

/// Exact at quarter turns, so that walls placed by rotation meet without gaps.
fn sin_cos_degrees(degrees: f64) -> (f64, f64) {
    match degrees.rem_euclid(360.0) {
        0.0 => (0.0, 1.0),
        90.0 => (1.0, 0.0),
        180.0 => (0.0, -1.0),
        270.0 => (-1.0, 0.0),
        other => other.to_radians().sin_cos(),
    }
}

fn about_x((sin, cos): (f64, f64)) -> DMat3 {
    DMat3::from_cols(DVec3::X, DVec3::new(0.0, cos, sin), DVec3::new(0.0, -sin, cos))
}

fn about_y((sin, cos): (f64, f64)) -> DMat3 {
    DMat3::from_cols(DVec3::new(cos, 0.0, -sin), DVec3::Y, DVec3::new(sin, 0.0, cos))
}

fn about_z((sin, cos): (f64, f64)) -> DMat3 {
    DMat3::from_cols(DVec3::new(cos, sin, 0.0), DVec3::new(-sin, cos, 0.0), DVec3::Z)
}

#[cfg(test)]
mod tests {
    use super::*;

    const UNMOVED: Placement =
        Placement { scale: DVec3::ONE, rotate_degrees: DVec3::ZERO, translate: DVec3::ZERO };

    fn normal(vertices: &[DVec3], face: [u32; 3]) -> DVec3 {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        (b - a).cross(c - a)
    }

    #[test]
    fn children_tile_their_face_in_its_order() {
        let mut vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::new(1., 1., 0.)];
        let faces = [[0, 1, 2], [1, 3, 2]];
        let children = subdivide(&mut vertices, &faces);
        assert_eq!((vertices.len(), children.len()), (4 + 5, 8));
        for (at, &child) in children.iter().enumerate() {
            let parent = normal(&vertices, faces[at / 4]);
            assert!(normal(&vertices, child).abs_diff_eq(parent / 4.0, 1e-15));
        }
    }

    #[test]
    fn rotations_are_about_x_then_y_then_z() {
        let placement = Placement {
            rotate_degrees: DVec3::new(90., 90., 0.),
            scale: DVec3::splat(2.),
            translate: DVec3::X,
        };
        let mut vertices = vec![DVec3::Y];
        placement.apply(&mut vertices, &mut []);
        // y, about x to z, about y to x.
        assert_eq!(vertices, [DVec3::new(3., 0., 0.)]);
    }

    #[test]
    fn mirrored_meshes_keep_their_fronts() {
        let mut vertices = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
        let mut faces = [[0, 1, 2]];
        let mirrored = Placement { scale: DVec3::new(-1., 1., 1.), ..UNMOVED };
        mirrored.apply(&mut vertices, &mut faces);
        assert!(normal(&vertices, faces[0]).z > 0.0);
    }
}
