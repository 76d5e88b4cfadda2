//! Assembles a scene from its parts and records where each came from, for the messages of the check.

mod simplified;

use antirad_base::parallel;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::DVec3;

use super::check::MAX_TRIANGLES;
use super::error::{Place, SceneError, nearest};
use super::file::LoadOptions;
use super::geometry::{Maps, RawMesh};
use super::material::numbered;
use super::orient::orient;
use super::outlook::{self, Outlook};
use super::pattern::Pattern;
use super::snap::{Snapped, snap};
use super::tables::MaterialTable;
use super::{Camera, Material, Mesh, Orient, Origin, Scene, Sky, SolveSettings, Sun, Triangle, bounds};
use antirad_base::output::free_name;
use simplified::Whole;

pub(super) use simplified::Most;

/// A scene under construction.
pub(super) struct Assembly {
    /// The file that the user named.
    path: PathBuf,
    scene: Scene,
    material_indices: HashMap<String, u32>,
    material_origins: HashMap<String, (PathBuf, Option<usize>)>,
    /// Textures, by material.
    maps: HashMap<u32, Maps>,
    /// Copies of materials, by the original and the bits of the factors of albedo and emission.
    copies: HashMap<(u32, [[u64; 3]; 2]), u32>,
    /// Copies of each material so far.
    copy_counts: HashMap<u32, u64>,
    /// Materials that the scene file itself defines or overrides: they are taken at their word.
    stated: HashSet<u32>,
    /// Whether materials have a second side, where something says so.
    two_sided: HashMap<u32, bool>,
    /// Per mesh.
    mending: Vec<Mending>,
    /// Files that will be simplified.
    wholes: Vec<Whole>,
    /// Per mesh, whether it was simplified; empty if none was.
    simplified: Vec<bool>,
    camera_lines: HashMap<String, usize>,
    settings_line: Option<usize>,
    sky: Option<Sky>,
}

/// What is done to a mesh once all are read.
#[derive(Clone, Copy)]
pub(super) struct Mending {
    pub orient: Orient,
    pub two_sided: Option<bool>,
    pub snap: Option<Snap>,
    pub most: Most,
    /// Whether each object of the file is a mesh.
    pub objects: bool,
}

/// The distance, m, within which a mesh is snapped.
#[derive(Clone, Copy)]
pub(super) struct Snap {
    distance: f64,
    /// Of the scene file, where it states the distance.
    line: Option<usize>,
}

impl Snap {
    /// Largest distance, as a share of the scene's longest side.
    const LARGEST: f64 = 0.1;

    /// A distance that a scene file states.
    ///
    /// # Errors
    /// Where it is not above zero and finite.
    pub fn new(distance: f64, place: Place) -> Result<Self, SceneError> {
        match Self::sound(distance) {
            true => Ok(Self { distance, line: Some(place.line) }),
            false => Err(place.error(Self::unsound(distance))),
        }
    }

    fn sound(distance: f64) -> bool {
        distance > 0.0 && distance.is_finite()
    }

    fn unsound(distance: f64) -> String {
        format!(
            "snap = {distance} is no distance; state metres above zero, a few times the error of a vertex, or leave it out"
        )
    }
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
                patterns: Default::default(),
                suns: Vec::new(),
                cameras: Vec::new(),
                settings: SolveSettings::default(),
                target_error: None,
                degenerate: Vec::new(),
                creases: Vec::new(),
                warnings: Vec::new(),
                given: None,
            },
            material_indices: HashMap::new(),
            material_origins: HashMap::new(),
            maps: HashMap::new(),
            copies: HashMap::new(),
            copy_counts: HashMap::new(),
            stated: HashSet::new(),
            two_sided: HashMap::new(),
            mending: Vec::new(),
            wholes: Vec::new(),
            simplified: Vec::new(),
            camera_lines: HashMap::new(),
            settings_line: None,
            sky: None,
        }
    }

    /// The distance that options state for mesh files.
    ///
    /// # Errors
    /// Where it is not above zero and finite.
    pub fn snap(&self, options: &LoadOptions) -> Result<Option<Snap>, SceneError> {
        let Some(distance) = options.snap else { return Ok(None) };
        match Snap::sound(distance) {
            true => Ok(Some(Snap { distance, line: None })),
            false => Err(SceneError::File { path: self.path.clone(), message: Snap::unsound(distance) }),
        }
    }

    pub fn warnings(&mut self) -> &mut Vec<String> {
        &mut self.scene.warnings
    }

    /// Adds the materials of a mesh. Meshes may share materials, but must define them alike.
    ///
    /// # Errors
    /// Fails if a text file defines a material otherwise than a file before it.
    pub fn add_materials(&mut self, mesh: &mut RawMesh) -> Result<(), SceneError> {
        let mut renamed = HashMap::new();
        for mut raw in std::mem::take(&mut mesh.materials) {
            let name = raw.material.name.clone();
            if let Some(&index) = self.material_indices.get(&name) {
                let before = &mut self.scene.materials[index as usize];
                match (self.material_origins.get(&name), &raw.origin) {
                    _ if *before == raw.material => continue,
                    // A definition replaces a grey placeholder, whichever comes first.
                    (_, None) => continue,
                    (None, Some(origin)) => {
                        self.material_origins.insert(name, origin.clone());
                        *before = raw.material;
                        self.maps.insert(index, raw.maps);
                        continue;
                    }
                    (Some((first, first_line)), Some((path, Some(line)))) => {
                        let first_line = first_line.map_or(String::new(), |line| format!(":{line}"));
                        return Err(Place { path, line: *line }.error(format!(
                            "material \"{name}\" is defined otherwise at {}{first_line}; rename one of the two",
                            first.display()
                        )));
                    }
                    // Names in binary files are hardly chosen, and cannot be changed with an editor.
                    (Some(_), Some((_, None))) => {
                        raw.material.name = self.free_name(&name, "_");
                        renamed.insert(name, raw.material.name.clone());
                    }
                }
            }
            if let Some(origin) = raw.origin {
                self.material_origins.insert(raw.material.name.clone(), origin);
            }
            let index = self.push_material(raw.material) as u32;
            self.maps.insert(index, raw.maps);
            if raw.two_sided {
                self.two_sided.insert(index, true);
            }
        }
        for name in &mut mesh.material_names {
            if let Some(other) = renamed.get(name) {
                name.clone_from(other);
            }
        }
        Ok(())
    }

    /// The name with the first number, from 2, that no material has.
    fn free_name(&self, name: &str, between: &str) -> String {
        let numbered = (2u64..).map(|n| format!("{name}{between}{n}"));
        let mut free = numbered.filter(|name| !self.material_indices.contains_key(name));
        free.next().unwrap_or_default()
    }

    fn push_material(&mut self, material: Material) -> usize {
        let index = self.scene.materials.len();
        self.material_indices.insert(material.name.clone(), index as u32);
        self.scene.materials.push(material);
        index
    }

    /// Applies a `[material.NAME]` table to the material of that name, or to a new black one.
    pub fn override_material(&mut self, name: &str, table: &MaterialTable, place: Place) {
        let origin = (place.path.to_path_buf(), Some(place.line));
        self.material_origins.insert(name.to_owned(), origin);
        let index = match self.material_indices.get(name) {
            Some(&index) => index as usize,
            None => self.push_material(Material::named(name)),
        };
        table.apply(&mut self.scene.materials[index]);
        self.stated.insert(index as u32);
        if let Some(maps) = self.maps.get_mut(&(index as u32)) {
            maps.albedo.take_if(|_| table.albedo.is_some());
            maps.emission.take_if(|_| table.emission.is_some());
        }
        if let Some(two_sided) = table.two_sided {
            self.two_sided.insert(index as u32, two_sided);
        }
    }

    /// Warns of a `[material.NAME]` table that changes nothing, most likely a misspelt name. Call after all meshes.
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

    /// Appends a mesh. The error for an undefined material names `place`.
    ///
    /// # Errors
    /// Fails if a material is not defined, or if there are more vertices or triangles than indices allow.
    pub fn add_mesh(
        &mut self,
        name: String,
        file: &Path,
        mut mesh: RawMesh,
        mending: Mending,
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
        let too_fine = mending.most.0.filter(|&most| mesh.faces.len() > most as usize);
        let of_file = materials;
        let (materials, patterns) = match too_fine {
            Some(_) => (mesh.face_materials.iter().map(|&m| of_file[m as usize]).collect(), Vec::new()),
            None => self.face_materials(&mesh, &of_file),
        };

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
        scene.vertices.extend_from_slice(&mesh.vertices);
        if patterns.iter().any(Option::is_some) {
            Arc::make_mut(&mut scene.patterns).extend(first, patterns);
        }
        if mesh.uvs.len() == mesh.faces.len() && too_fine.is_none() {
            Arc::make_mut(&mut scene.patterns).extend_uvs(first, &mesh.uvs);
        }
        scene.triangles.extend(
            mesh.faces
                .iter()
                .zip(materials)
                .map(|(face, material)| Triangle { vertices: face.map(|v| first_vertex + v), material }),
        );
        let mut starts = if mending.objects { std::mem::take(&mut mesh.objects) } else { Vec::new() };
        let first_mesh = scene.meshes.len();
        if starts.first().is_none_or(|(_, first)| *first > 0) {
            starts.insert(0, (name.clone(), 0));
        }
        for (k, (object, start)) in starts.iter().enumerate() {
            let faces = *start..starts.get(k + 1).map_or((end - first) as u32, |(_, next)| *next);
            if faces.is_empty() && starts.len() > 1 {
                continue;
            }
            let object = if object.is_empty() { &name } else { object };
            let free = free_name(object, |name| scene.meshes.iter().all(|m| m.name != name));
            let range = first as u32 + faces.start..first as u32 + faces.end;
            scene.meshes.push(Mesh { name: free, range });
            self.mending.push(mending);
            let lines = mesh.face_lines.get(faces.start as usize..faces.end as usize).unwrap_or_default();
            scene.origins.push(Origin { file: file.to_path_buf(), lines: lines.to_vec() });
        }
        if let Some(most) = too_fine {
            self.wholes.push(Whole {
                file: file.to_path_buf(),
                most,
                meshes: first_mesh..scene.meshes.len(),
                triangles: first..end,
                vertices: first_vertex..vertex_count as u32,
                raw: mesh,
                materials: of_file,
            });
        }
        Ok(())
    }

    /// The material of each face: that of the file, or where textures or colours change it over the faces, a copy with their mean. Faces
    /// with the same means share a copy. And how it varies within each face, empty if nothing does.
    fn face_materials(&mut self, mesh: &RawMesh, materials: &[u32]) -> (Vec<u32>, Vec<Option<Pattern>>) {
        let has_maps = |index: &u32| {
            self.maps.get(index).is_some_and(|maps| maps.albedo.is_some() || maps.emission.is_some())
        };
        let textured = materials.iter().any(has_maps);
        if !textured && mesh.colours.is_empty() {
            return (mesh.face_materials.iter().map(|&m| materials[m as usize]).collect(), Vec::new());
        }
        let all = Arc::make_mut(&mut self.scene.patterns);
        let maps: Vec<(Maps, u32)> = materials
            .iter()
            .map(|index| {
                let maps = self.maps.get(index).cloned().unwrap_or_default();
                let index = all.add_maps(maps.clone());
                (maps, index)
            })
            .collect();
        let of_face = |face: usize| {
            let (maps, index) = &maps[mesh.face_materials[face] as usize];
            Pattern::new(maps, *index, mesh.uvs.get(face).copied(), mesh.colours.get(face).copied())
        };
        let (patterns, factors): (Vec<_>, Vec<[DVec3; 2]>) =
            parallel::map(0..mesh.faces.len(), of_face).into_iter().unzip();
        let mut of_faces = Vec::with_capacity(factors.len());
        for (&m, factors) in mesh.face_materials.iter().zip(factors) {
            let base = materials[m as usize];
            if factors == [DVec3::ONE; 2] {
                of_faces.push(base);
                continue;
            }
            let key = (base, factors.map(|factor| factor.to_array().map(f64::to_bits)));
            let index = self.copies.get(&key).copied().unwrap_or_else(|| {
                let material = &self.scene.materials[base as usize];
                let count = self.copy_counts.entry(base).or_insert(0);
                let name = numbered(&material.name, count, |name| self.material_indices.contains_key(name));
                let copy = material.scaled(name, factors);
                let index = self.push_material(copy) as u32;
                if self.stated.contains(&base) {
                    self.stated.insert(index);
                }
                if let Some(&two_sided) = self.two_sided.get(&base) {
                    self.two_sided.insert(index, two_sided);
                }
                index
            });
            self.copies.insert(key, index);
            of_faces.push(index);
        }
        (of_faces, patterns)
    }

    pub fn add_camera(&mut self, camera: Camera, line: usize) {
        self.camera_lines.insert(camera.name.clone(), line);
        self.scene.cameras.push(camera);
    }

    pub fn set_sky(&mut self, sky: Sky) {
        self.sky = Some(sky);
    }

    pub fn add_sun(&mut self, sun: Sun) {
        self.scene.suns.push(sun);
    }

    pub fn set_settings(&mut self, settings: SolveSettings, target_error: Option<f64>, line: usize) {
        self.scene.settings = settings;
        self.scene.target_error = target_error;
        self.settings_line = Some(line);
    }

    /// Mends what can be mended, adds a camera if there is none, and checks the scene.
    ///
    /// # Errors
    /// Fails if the scene does not pass [`Scene::check`]; the error names the file and, where known, the
    /// line.
    pub fn finish(mut self, options: &LoadOptions) -> Result<Scene, SceneError> {
        if !options.strict {
            self.limit_energy();
        }
        // Otherwise the check says what is wrong.
        let sound = !self.scene.triangles.is_empty() && self.scene.vertices.iter().all(|v| v.is_finite());
        if sound {
            if !options.strict {
                self.leave_out_repeats();
            }
            self.scene.update_degenerate();
            self.snap_meshes()?;
            self.turn_faces();
            if self.simplify_files() {
                // Small planes stand out where triangles are large against noise.
                self.snap_meshes()?;
            }
            self.add_second_sides(options);
            self.scene.update_degenerate();
        }
        let outlook =
            (sound && self.scene.triangles.len() <= outlook::MOST).then(|| Outlook::new(&self.scene));
        let missing = self.scene.cameras.is_empty();
        if missing {
            let vertices = &self.scene.vertices;
            let camera = outlook.as_ref().map_or_else(|| Camera::framing(vertices), Outlook::camera);
            self.scene.warnings.push(format!(
                "No camera is given; \"auto\" looks from ({:.3}, {:.3}, {:.3}) to ({:.3}, {:.3}, {:.3}).",
                camera.position.x,
                camera.position.y,
                camera.position.z,
                camera.target.x,
                camera.target.y,
                camera.target.z
            ));
            self.scene.cameras.push(camera);
        }
        // Around the camera, too.
        if let Some(sky) = options.sky.as_ref().or(self.sky.as_ref()).filter(|_| sound) {
            self.scene.add_sky(sky);
            self.scene.origins.iter_mut().rev().take(1).for_each(|origin| origin.file.clone_from(&self.path));
        }
        self.scene.check(options.strict).map_err(|problem| {
            let (path, line) = self.origin(&problem);
            SceneError::In { path, line, problem: Box::new(problem) }
        })?;
        if self.scene.triangles.len() <= outlook::MOST {
            let warnings = Outlook::new(&self.scene).warnings();
            self.scene.warnings.extend(warnings);
        }
        Ok(self.scene)
    }

    /// Materials of mesh files that reflect all light or more are limited, with one warning for all.
    fn limit_energy(&mut self) {
        let mut limited = Vec::new();
        let used: HashSet<u32> = self.scene.triangles.iter().map(|t| t.material).collect();
        for (index, material) in (0..).zip(&mut self.scene.materials) {
            if self.stated.contains(&index) || !used.contains(&index) {
                continue;
            }
            if let Some(before) = material.limit_energy() {
                limited.push(format!(
                    "\"{}\" ({before:.2} to {:.2})",
                    material.name,
                    material.total_albedo()
                ));
            }
        }
        if limited.is_empty() {
            return;
        }
        const SHOWN: usize = 8;
        let count = limited.len();
        let more = if count > SHOWN { format!(" and {} more", count - SHOWN) } else { String::new() };
        limited.truncate(SHOWN);
        self.scene.warnings.push(format!(
            "{}: {count} material(s) reflect all light or more and are limited, total albedo: {}{more}. \
             [material.NAME] of a scene file states other values; --strict refuses them.",
            self.path.display(),
            limited.join(", ")
        ));
    }

    /// Takes the area of triangles that stand there twice: each would emit, reflect and block light once more.
    fn leave_out_repeats(&mut self) {
        let repeated = self.scene.repeated();
        let Some(&first) = repeated.first() else { return };
        self.scene.warnings.push(format!(
            "{}: {} triangle(s) have the same corners and front as one before and are left out: their rows stay, without area; the \
             first is triangle {first} of mesh \"{}\".",
            self.path.display(),
            repeated.len(),
            self.scene.mesh_name(first)
        ));
        for t in repeated {
            let vertices = &mut self.scene.triangles[t].vertices;
            *vertices = [vertices[0]; 3];
        }
    }

    /// Snaps meshes that ask for it, those with the same distance together.
    fn snap_meshes(&mut self) -> Result<(), SceneError> {
        let (low, high) = bounds(self.scene.vertices.iter().copied());
        let size = (high - low).max_element();
        let mut all: Vec<Snap> = self.mending.iter().filter_map(|mending| mending.snap).collect();
        all.sort_by(|a, b| a.distance.total_cmp(&b.distance));
        all.dedup_by_key(|snap| snap.distance);
        for Snap { distance, line } in all {
            if distance > Snap::LARGEST * size {
                let message = format!(
                    "snap = {distance} is more than a tenth of the scene, which measures {size:.3} m; state a few times the error of a vertex"
                );
                let path = &self.path;
                return Err(match line {
                    Some(line) => Place { path, line }.error(message),
                    None => SceneError::File { path: path.clone(), message },
                });
            }
            let asks = |mending: &Mending| mending.snap.is_some_and(|snap| snap.distance == distance);
            let mut within: Vec<bool> = self.per_triangle(asks);
            if !self.simplified.is_empty() {
                let meshes =
                    self.scene.meshes.iter().zip(&self.simplified).filter(|(_, simplified)| !**simplified);
                meshes.for_each(|(mesh, _)| {
                    within[mesh.range.start as usize..mesh.range.end as usize].fill(false)
                });
                if !within.contains(&true) {
                    continue;
                }
            }
            let Snapped { moved, vertices, farthest, planes } =
                snap(&mut self.scene, distance, |t| within[t]);
            self.scene.update_degenerate();
            let millimetres = 1e3 * farthest;
            self.scene.warnings.push(format!(
                "{}: snap = {distance} found {planes} planes and moved {moved} of {vertices} vertices, by {millimetres:.3} mm at most.",
                self.path.display()
            ));
        }
        Ok(())
    }

    fn turn_faces(&mut self) {
        if self.mending.iter().all(|mending| mending.orient == Orient::Keep) {
            return;
        }
        let keep: Vec<bool> = self.per_triangle(|mending| mending.orient == Orient::Keep);
        let turned = orient(&mut self.scene, |t| keep[t]);
        if turned.is_empty() {
            return;
        }
        let each: Vec<String> =
            turned.iter().map(|(mesh, count)| format!("{count} of mesh \"{mesh}\"")).collect();
        self.scene.warnings.push(format!(
            "{}: triangles that faced the wrong way in their closed shells were turned: {}; --orient keep leaves them.",
            self.path.display(),
            each.join(", ")
        ));
    }

    fn add_second_sides(&mut self, options: &LoadOptions) {
        let of_mesh: Vec<Option<bool>> = self.per_triangle(|mending| mending.two_sided);
        let two_sided: Vec<bool> = self
            .scene
            .triangles
            .iter()
            .zip(of_mesh)
            .map(|(t, mesh)| mesh.or(self.two_sided.get(&t.material).copied()).unwrap_or(options.two_sided))
            .collect();
        self.scene.add_second_sides(|t| two_sided[t]);
    }

    fn per_triangle<T: Clone>(&self, of: impl Fn(&Mending) -> T) -> Vec<T> {
        let meshes = self.scene.meshes.iter().zip(&self.mending);
        meshes.flat_map(|(mesh, mending)| std::iter::repeat_n(of(mending), mesh.range.len())).collect()
    }

    /// The file, and the line if the error belongs to one.
    fn origin(&self, problem: &SceneError) -> (PathBuf, Option<usize>) {
        let scene_file = |line| (self.path.clone(), line);
        match problem {
            SceneError::Material { name, .. } => match self.material_origins.get(name) {
                Some((path, line)) => (path.clone(), *line),
                None => scene_file(None),
            },
            SceneError::Camera { name, .. } => scene_file(self.camera_lines.get(name).copied()),
            SceneError::SolveSettings { .. } => scene_file(self.settings_line),
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
