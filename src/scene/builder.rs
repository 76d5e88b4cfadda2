//! Scenes made in memory, of shapes and grids: what a scene file says, for programs.

use glam::{DAffine3, DVec3};

use super::{Material, Mesh, Scene, SceneError, Shape, Triangle};

/// A scene in the making: meshes one after the other, each of one material.
#[derive(Clone, Debug, Default)]
pub struct SceneBuilder {
    vertices: Vec<DVec3>,
    triangles: Vec<Triangle>,
    meshes: Vec<Mesh>,
    materials: Vec<Material>,
}

impl SceneBuilder {
    /// Nothing yet.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a shape, placed by an affine map. One that mirrors keeps fronts in front.
    pub fn shape(&mut self, name: &str, shape: Shape, material: &Material, place: DAffine3) -> &mut Self {
        let (vertices, faces) = shape.mesh();
        self.mesh(name, vertices, faces, material, place)
    }

    /// Adds a mesh: vertices in metres, faces counter-clockwise seen from their front.
    pub fn mesh(
        &mut self,
        name: &str,
        vertices: Vec<DVec3>,
        faces: Vec<[u32; 3]>,
        material: &Material,
        place: DAffine3,
    ) -> &mut Self {
        let material = self.material(material);
        let first = self.vertices.len() as u32;
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

    /// The checked scene, with default accuracy and no camera.
    pub fn finish(&self, name: &str) -> Result<Scene, SceneError> {
        let Self { vertices, triangles, meshes, materials } = self.clone();
        let mut scene = Scene::new(name, vertices, triangles, materials)?;
        scene.meshes = meshes;
        scene.warnings.clear();
        scene.check(false)?;
        Ok(scene)
    }

    /// The index of a material, which stands there once.
    fn material(&mut self, material: &Material) -> u32 {
        let known = self.materials.iter().position(|m| m == material);
        known.unwrap_or_else(|| {
            self.materials.push(material.clone());
            self.materials.len() - 1
        }) as u32
    }
}
