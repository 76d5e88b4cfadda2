//! A mesh before it joins the scene: subdivision and placement.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use glam::{DMat3, DMat4, DVec2, DVec3};

use super::Material;
use super::texture::Map;

/// A mesh as read or generated: faces in file order, the triangles of a polygon consecutive.
#[derive(Clone)]
pub(super) struct RawMesh {
    pub vertices: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    /// Per face, an index into `material_names`.
    pub face_materials: Vec<u32>,
    /// Per face, its line in the mesh's file; empty without a file.
    pub face_lines: Vec<u32>,
    /// Per face, the texture coordinates of its corners; empty without textures.
    pub uvs: Vec<[DVec2; 3]>,
    /// Per face, factors of the albedo at its corners; empty without colours.
    pub colours: Vec<[DVec3; 3]>,
    /// Names of the objects in the file, each with its first face; empty without.
    pub objects: Vec<(String, u32)>,
    pub material_names: Vec<String>,
    /// Materials from the mesh's MTL files, and grey placeholders for missing ones.
    pub materials: Vec<RawMaterial>,
}

#[derive(Clone)]
pub(super) struct RawMaterial {
    pub material: Material,
    /// File of the definition, and its line if it has lines; `None` for a grey placeholder.
    pub origin: Option<(PathBuf, Option<usize>)>,
    /// Whether its triangles have a second side.
    pub two_sided: bool,
    pub maps: Maps,
}

/// The textures of a material.
#[derive(Clone, Debug, Default)]
pub(super) struct Maps {
    pub albedo: Option<Map>,
    pub emission: Option<Map>,
}

impl RawMaterial {
    /// A material of a file without lines.
    pub fn of_file(material: Material, file: &Path) -> Self {
        Self { origin: Some((file.to_path_buf(), None)), ..Self::placeholder(material) }
    }

    /// A grey placeholder for a missing one.
    pub fn placeholder(material: Material) -> Self {
        Self { material, origin: None, two_sided: false, maps: Maps::default() }
    }
}

impl RawMesh {
    /// No faces and no materials.
    pub fn empty() -> Self {
        Self { material_names: Vec::new(), ..Self::uniform(Vec::new(), Vec::new(), "") }
    }

    /// A mesh of a single material.
    pub fn uniform(vertices: Vec<DVec3>, faces: Vec<[u32; 3]>, material: &str) -> Self {
        Self {
            face_materials: vec![0; faces.len()],
            face_lines: Vec::new(),
            uvs: Vec::new(),
            colours: Vec::new(),
            objects: Vec::new(),
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
        self.objects.iter_mut().for_each(|(_, first)| *first *= 4);
        self.uvs = self.uvs.iter().flat_map(|&corners| quarters(corners, DVec2::midpoint)).collect();
        self.colours = self.colours.iter().flat_map(|&corners| quarters(corners, DVec3::midpoint)).collect();
    }

    /// Appends another mesh.
    pub fn append(&mut self, other: Self) {
        let (first, names) = (self.vertices.len() as u32, self.material_names.len() as u32);
        // Both have values for all faces, or none.
        let (uvs, colours) = (self.uvs.len() == self.faces.len(), self.colours.len() == self.faces.len());
        let complete = |own: bool, theirs: usize| own && theirs == other.faces.len();
        match complete(uvs, other.uvs.len()) {
            true => self.uvs.extend(other.uvs),
            false => self.uvs.clear(),
        }
        match complete(colours, other.colours.len()) {
            true => self.colours.extend(other.colours),
            false => self.colours.clear(),
        }
        let first_face = self.faces.len() as u32;
        self.objects.extend(other.objects.into_iter().map(|(name, face)| (name, first_face + face)));
        self.vertices.extend(other.vertices);
        self.faces.extend(other.faces.iter().map(|face| face.map(|v| first + v)));
        self.face_materials.extend(other.face_materials.iter().map(|m| names + m));
        self.material_names.extend(other.material_names);
        self.materials.extend(other.materials);
    }

    /// Moves all vertices; fronts stay fronts where it mirrors them.
    pub fn place(&mut self, matrix: DMat4) {
        self.vertices.iter_mut().for_each(|v| *v = matrix.transform_point3(*v));
        if matrix.determinant() < 0.0 {
            self.turn();
        }
    }

    /// Area of all faces.
    pub fn area(&self) -> f64 {
        let of_face = |face: &[u32; 3]| {
            let [a, b, c] = face.map(|v| self.vertices[v as usize]);
            (b - a).cross(c - a).length() / 2.0
        };
        self.faces.iter().map(of_face).sum()
    }

    /// Turns all faces: fronts become backs.
    pub fn turn(&mut self) {
        self.faces.iter_mut().for_each(|corners| corners.swap(1, 2));
        self.uvs.iter_mut().for_each(|corners| corners.swap(1, 2));
        self.colours.iter_mut().for_each(|corners| corners.swap(1, 2));
    }
}

/// Values at the corners of the four parts of a face, in the order of [`subdivide`].
pub(super) fn quarters<T: Copy>([a, b, c]: [T; 3], mut middle: impl FnMut(T, T) -> T) -> [[T; 3]; 4] {
    let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
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
    for &face in faces {
        children.extend(quarters(face, &mut middle));
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
    pub fn apply(&self, mesh: &mut RawMesh) {
        let [x, y, z] = self.rotate_degrees.to_array().map(sin_cos_degrees);
        let rotation = about_z(z) * about_y(y) * about_x(x);
        for vertex in &mut mesh.vertices {
            *vertex = rotation * (self.scale * *vertex) + self.translate;
        }
        let mirrors = self.scale.to_array().iter().filter(|&&s| s < 0.0).count();
        if mirrors % 2 == 1 {
            // A reflection turns fronts into backs: rewind the faces.
            mesh.turn();
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
        let mut mesh = RawMesh::uniform(vec![DVec3::Y], Vec::new(), "m");
        placement.apply(&mut mesh);
        // y, about x to z, about y to x.
        assert_eq!(mesh.vertices, [DVec3::new(3., 0., 0.)]);
    }

    #[test]
    fn mirrored_meshes_keep_their_fronts() {
        let mut mesh = RawMesh::uniform(vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![[0, 1, 2]], "m");
        let mirrored = Placement { scale: DVec3::new(-1., 1., 1.), ..UNMOVED };
        mirrored.apply(&mut mesh);
        assert!(normal(&mesh.vertices, mesh.faces[0]).z > 0.0);
    }
}
