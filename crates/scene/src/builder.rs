//! Scenes built in memory from shapes and meshes: the equivalent of a scene file for programs.

use glam::{DAffine3, DVec3};

use super::{Material, Mesh, Scene, SceneError, Shape, Triangle};

/// A scene under construction: a list of meshes, each of one material.
#[derive(Clone, Debug, Default)]
pub struct SceneBuilder {
    vertices: Vec<DVec3>,
    triangles: Vec<Triangle>,
    meshes: Vec<Mesh>,
    materials: Vec<Material>,
    /// The first face with a vertex index out of range.
    out_of_range: Option<OutOfRange>,
}

#[derive(Clone, Debug)]
struct OutOfRange {
    mesh: String,
    triangle: usize,
    index: u32,
    count: usize,
}

impl SceneBuilder {
    /// An empty scene.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a shape, placed by an affine map. Under a reflection faces are rewound, so that fronts stay fronts.
    pub fn shape(&mut self, name: &str, shape: Shape, material: &Material, place: DAffine3) -> &mut Self {
        let (vertices, faces) = shape.mesh();
        self.mesh(name, vertices, faces, material, place)
    }

    /// Adds a mesh: vertices in metres, faces counter-clockwise seen from their front. [`SceneBuilder::finish`] refuses faces
    /// with vertices that the mesh does not have.
    pub fn mesh(
        &mut self,
        name: &str,
        vertices: Vec<DVec3>,
        faces: Vec<[u32; 3]>,
        material: &Material,
        place: DAffine3,
    ) -> &mut Self {
        let material = self.material(material);
        let (first, count) = (self.vertices.len() as u32, vertices.len());
        let beyond = |face: &[u32; 3]| face.iter().copied().find(|&v| v as usize >= count);
        if let Some((f, index)) = (0..).zip(&faces).find_map(|(f, face)| Some((f, beyond(face)?))) {
            let triangle = self.triangles.len() + f;
            self.out_of_range.get_or_insert(OutOfRange { mesh: name.to_owned(), triangle, index, count });
            return self;
        }
        self.vertices.extend(vertices.into_iter().map(|v| place.transform_point3(v)));
        let mirrors = place.matrix3.determinant() < 0.0;
        let start = self.triangles.len() as u32;
        self.triangles.extend(faces.into_iter().map(|[a, b, c]| {
            let face = if mirrors { [a, c, b] } else { [a, b, c] };
            Triangle { vertices: face.map(|v| first + v), material }
        }));
        self.meshes.push(Mesh { name: name.to_owned(), range: start..self.triangles.len() as u32 });
        self
    }

    /// The checked scene, with default settings and no camera.
    ///
    /// # Errors
    /// Fails if a triangle uses a vertex that its mesh does not have, or if the scene does not pass
    /// [`Scene::check`].
    pub fn finish(&self, name: &str) -> Result<Scene, SceneError> {
        let Self { vertices, triangles, meshes, materials, out_of_range } = self.clone();
        if let Some(OutOfRange { mesh, triangle, index, count }) = out_of_range {
            return Err(SceneError::Index { mesh, triangle, what: "vertex", index, count });
        }
        let mut scene = Scene::new(name, vertices, triangles, materials)?;
        scene.meshes = meshes;
        scene.warnings.clear();
        scene.check(false)?;
        Ok(scene)
    }

    /// The index of a material, added if it is new.
    fn material(&mut self, material: &Material) -> u32 {
        let known = self.materials.iter().position(|m| m == material);
        known.unwrap_or_else(|| {
            self.materials.push(material.clone());
            self.materials.len() - 1
        }) as u32
    }
}
