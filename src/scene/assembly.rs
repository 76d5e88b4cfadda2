//! Puts a scene together from its parts, remembering where each came from for the check's complaints.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::check::MAX_TRIANGLES;
use super::error::{Place, SceneError, nearest};
use super::file::LoadOptions;
use super::geometry::RawMesh;
use super::tables::MaterialTable;
use super::{Camera, Choice, Material, Mesh, Origin, Scene, SolveSettings, Triangle};

/// A scene in the making.
pub(super) struct Assembly {
    /// The file that the user named.
    path: PathBuf,
    scene: Scene,
    material_indices: HashMap<String, u32>,
    material_origins: HashMap<String, (PathBuf, usize)>,
    camera_lines: HashMap<String, usize>,
    accuracy_line: Option<usize>,
}

impl Assembly {
    pub fn new(path: &Path, name: String) -> Self {
        Self {
            path: path.to_path_buf(),
            scene: Scene {
                name,
                vertices: Vec::new(),
                triangles: Vec::new(),
                meshes: Vec::new(),
                origins: Vec::new(),
                materials: Vec::new(),
                cameras: Vec::new(),
                settings: SolveSettings::default(),
                choice: Default::default(),
                degenerate: Vec::new(),
                warnings: Vec::new(),
            },
            material_indices: HashMap::new(),
            material_origins: HashMap::new(),
            camera_lines: HashMap::new(),
            accuracy_line: None,
        }
    }

    pub fn warnings(&mut self) -> &mut Vec<String> {
        &mut self.scene.warnings
    }

    /// Takes over the materials of a mesh. Meshes may share materials, but not disagree about them.
    pub fn add_materials(&mut self, mesh: &mut RawMesh) -> Result<(), SceneError> {
        for raw in mesh.materials.drain(..) {
            let name = &raw.material.name;
            if let Some(&index) = self.material_indices.get(name) {
                let before = &mut self.scene.materials[index as usize];
                match (self.material_origins.get(name), &raw.origin) {
                    _ if *before == raw.material => {}
                    // A grey stand-in gives way to a definition, whichever comes first.
                    (_, None) => {}
                    (None, Some(origin)) => {
                        self.material_origins.insert(name.clone(), origin.clone());
                        *before = raw.material;
                    }
                    (Some((first, first_line)), Some((path, line))) => {
                        return Err(Place { path, line: *line }.error(format!(
                            "material \"{name}\" is defined otherwise at {}:{first_line}; rename one of the two",
                            first.display()
                        )));
                    }
                }
                continue;
            }
            if let Some(origin) = raw.origin {
                self.material_origins.insert(name.clone(), origin);
            }
            self.push_material(raw.material);
        }
        Ok(())
    }

    fn push_material(&mut self, material: Material) -> usize {
        let index = self.scene.materials.len();
        self.material_indices.insert(material.name.clone(), index as u32);
        self.scene.materials.push(material);
        index
    }

    /// Applies a `[material.NAME]` table to the material of that name, or to a new black one.
    pub fn override_material(&mut self, name: &str, table: &MaterialTable, place: Place) {
        let origin = (place.path.to_path_buf(), place.line);
        self.material_origins.insert(name.to_owned(), origin);
        let index = match self.material_indices.get(name) {
            Some(&index) => index as usize,
            None => self.push_material(Material::named(name)),
        };
        table.apply(&mut self.scene.materials[index]);
    }

    /// Warns of a `[material.NAME]` table that changes nothing: most likely a misspelt name. After all meshes.
    pub fn warn_if_unused(&mut self, name: &str, place: Place) {
        let scene = &mut self.scene;
        let index = self.material_indices.get(name).copied();
        if scene.triangles.iter().any(|t| Some(t.material) == index) {
            return;
        }
        let others = scene.materials.iter().map(|m| m.name.as_str()).filter(|other| *other != name);
        let hint = nearest(name, others).map_or(String::new(), |near| format!("; did you mean \"{near}\"?"));
        scene.warnings.push(format!("{place}: no triangle uses [material.{name}]{hint}."));
    }

    /// Appends a mesh. `place` is to blame for a material that nothing defines.
    pub fn add_mesh(
        &mut self,
        name: String,
        file: &Path,
        mesh: RawMesh,
        place: Place,
    ) -> Result<(), SceneError> {
        let mut materials = Vec::with_capacity(mesh.material_names.len());
        for name in &mesh.material_names {
            let Some(&index) = self.material_indices.get(name) else {
                let known = self.scene.materials.iter().map(|m| m.name.as_str());
                let hint = nearest(name, known)
                    .map_or(format!("add [material.{name}]"), |near| format!("did you mean \"{near}\"?"));
                return Err(place.error(format!("material \"{name}\" is not defined; {hint}")));
            };
            materials.push(index);
        }

        let scene = &mut self.scene;
        let too_many = |what, count: usize, limit| SceneError::TooMany { what, count: count as u64, limit };
        let vertex_count = scene.vertices.len() + mesh.vertices.len();
        let first_vertex = match u32::try_from(vertex_count) {
            Ok(_) => scene.vertices.len() as u32,
            Err(_) => return Err(too_many("vertices", vertex_count, u32::MAX.into())),
        };
        let first = scene.triangles.len();
        let end = first + mesh.faces.len();
        if end as u64 > MAX_TRIANGLES {
            return Err(too_many("triangles", end, MAX_TRIANGLES));
        }
        scene.vertices.extend(mesh.vertices);
        scene.triangles.extend(mesh.faces.iter().zip(mesh.face_materials).map(|(face, material)| Triangle {
            vertices: face.map(|v| first_vertex + v),
            material: materials[material as usize],
        }));
        let taken = |name: &String| scene.meshes.iter().any(|m| m.name == *name);
        let numbered = (2..).map(|n| format!("{name}_{n}"));
        let unique = std::iter::once(name.clone()).chain(numbered).find(|n| !taken(n)).unwrap_or(name);
        scene.meshes.push(Mesh { name: unique, range: first as u32..end as u32 });
        scene.origins.push(Origin { file: file.to_path_buf(), lines: mesh.face_lines });
        Ok(())
    }

    pub fn add_camera(&mut self, camera: Camera, line: usize) {
        self.camera_lines.insert(camera.name.clone(), line);
        self.scene.cameras.push(camera);
    }

    pub fn set_accuracy(&mut self, settings: SolveSettings, choice: Choice, line: usize) {
        self.scene.settings = settings;
        self.scene.choice = choice;
        self.accuracy_line = Some(line);
    }

    /// Checks the scene, after adding a camera if it has none.
    pub fn finish(mut self, options: &LoadOptions) -> Result<Scene, SceneError> {
        if self.scene.cameras.is_empty() {
            let camera = Camera::framing(&self.scene.vertices);
            self.scene.warnings.push(format!(
                "No camera is given; \"auto\" frames the scene from ({:.3}, {:.3}, {:.3}).",
                camera.position.x, camera.position.y, camera.position.z
            ));
            self.scene.cameras.push(camera);
        }
        self.scene.check(options.strict).map_err(|problem| {
            let (path, line) = self.origin(&problem);
            SceneError::In { path, line, problem: Box::new(problem) }
        })?;
        Ok(self.scene)
    }

    /// The file, and the line if one is to blame.
    fn origin(&self, problem: &SceneError) -> (PathBuf, Option<usize>) {
        let scene_file = |line| (self.path.clone(), line);
        match problem {
            SceneError::Material { name, .. } => match self.material_origins.get(name) {
                Some((path, line)) => (path.clone(), Some(*line)),
                None => scene_file(None),
            },
            SceneError::Camera { name, .. } => scene_file(self.camera_lines.get(name).copied()),
            SceneError::SolveSettings { .. } => scene_file(self.accuracy_line),
            SceneError::Vertex { mesh, .. }
            | SceneError::Degenerate { mesh, .. }
            | SceneError::Outlier { mesh, .. } => {
                let at = self.scene.meshes.iter().position(|m| m.name == *mesh);
                (at.map_or(self.path.clone(), |at| self.scene.origins[at].file.clone()), None)
            }
            _ => scene_file(None),
        }
    }
}
