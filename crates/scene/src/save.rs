//! Writes a scene to files from which [`Scene::load`] restores it to the last bit.

use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs::File;
use std::io::{BufWriter, Error, Write};
use std::path::Path;
use std::sync::Arc;

use glam::DVec2;
use serde::Serialize;

use super::texture::Texture;
use super::{BinLayout, Material, Normalization, Scene, SolveSettings, SolverChoice, Sun, free_name};
use antirad_base::output::{OutputError, atomic_write};

#[derive(Serialize)]
struct SceneTable<'a> {
    mesh: Vec<MeshTable<'a>>,
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    material: BTreeMap<&'a str, MaterialTable>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    sun: Vec<SunTable>,
    settings: SettingsTable,
}

#[derive(Serialize)]
struct MeshTable<'a> {
    name: &'a str,
    path: String,
    orient: &'static str,
}

/// Properties that MTL cannot express.
#[derive(Serialize)]
struct MaterialTable {
    diffuse: f64,
    normalization: &'static str,
}

#[derive(Serialize)]
struct SunTable {
    direction: [f64; 3],
    irradiance: [f64; 3],
    angular_diameter: f64,
}

#[derive(Serialize)]
struct CameraTable {
    position: [f64; 3],
    target: [f64; 3],
    up: [f64; 3],
    fov_x_degrees: f64,
    width: u32,
    height: u32,
}

#[derive(Serialize)]
struct SettingsTable {
    #[serde(skip_serializing_if = "Option::is_none")]
    error: Option<f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    bins: Option<BTreeMap<&'static str, Bins>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    near_field: Option<f64>,
    lamps: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    tolerance: Option<f64>,
    max_passes: u32,
    solver: &'static str,
    precision: String,
    backend: String,
    visibility: String,
    ray_error: f64,
}

#[derive(Serialize)]
#[serde(untagged)]
enum Bins {
    Two([u32; 2]),
    One(u32),
}

impl Scene {
    /// Writes `path`, a TOML scene file, and next to it the meshes as OBJ and the materials as one MTL, all named after it.
    /// Numbers have all their digits: [`Scene::load`] restores the same vertices, triangles, meshes, materials, suns, cameras
    /// and settings, except for the sign of zeros.
    ///
    /// Textures that were fitted become PNG files of 16 bits, and their triangles a material, or several if they
    /// differ in more than albedo. Other textures are not written: pictures of
    /// the file show the means of triangles.
    ///
    /// The formats impose two changes. Characters of a material name that MTL would misread (a line break, a `#` after a
    /// blank) become `_`. Meshes that share vertices get copies of their own.
    ///
    /// Returns the names of the textures' files.
    ///
    /// # Errors
    /// Fails if a file cannot be written.
    pub fn save(&self, path: &Path) -> Result<Vec<String>, OutputError> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let stem = readable(&stem);
        let names = self.readable_names();
        let mtl = format!("{stem}.mtl");
        let textures = self.saved_textures(&stem, &names);
        for texture in textures.iter().filter(|texture| texture.is_first) {
            let png = texture.image.png().map_err(Error::other);
            atomic_write(&path.with_file_name(&texture.file), |file| file.write_all(&png?))?;
        }
        let mut vertices = self.vertex_runs();
        let mut tables = Vec::with_capacity(self.meshes.len());
        for (k, mesh) in self.meshes.iter().enumerate() {
            let obj =
                if self.meshes.len() == 1 { format!("{stem}.obj") } else { format!("{stem}_{}.obj", k + 1) };
            atomic_write(&path.with_file_name(&obj), |file| {
                self.write_obj(file, &mtl, &names, &textures, mesh.range.clone(), &mut vertices[k])
            })?;
            tables.push(MeshTable { name: &mesh.name, path: obj, orient: "keep" });
        }
        atomic_write(&path.with_file_name(&mtl), |file| self.write_mtl(file, &names, &textures))?;
        let text = self.toml(tables, &names);
        atomic_write(path, |file| file.write_all(text.map_err(Error::other)?.as_bytes()))?;
        Ok(textures.into_iter().filter(|texture| texture.is_first).map(|texture| texture.file).collect())
    }

    /// Per mesh, the vertices to write: consecutive runs that cover all vertices if the meshes use them in order, else those
    /// that the mesh uses.
    fn vertex_runs(&self) -> Vec<Vec<u32>> {
        let used = |range: &std::ops::Range<u32>| {
            let triangles = &self.triangles[range.start as usize..range.end as usize];
            let mut used: Vec<u32> = triangles.iter().flat_map(|t| t.vertices).collect();
            used.sort_unstable();
            used.dedup();
            used
        };
        let used: Vec<Vec<u32>> = self.meshes.iter().map(|mesh| used(&mesh.range)).collect();
        let mut runs = Vec::with_capacity(used.len());
        let mut next = 0;
        for (k, used_here) in used.iter().enumerate() {
            let end = match used_here.last() {
                _ if k + 1 == used.len() => self.vertices.len() as u32,
                Some(last) => last + 1,
                None => next,
            };
            if used_here.first().is_some_and(|&first| first < next) {
                return used;
            }
            runs.push((next..end.max(next)).collect());
            next = end.max(next);
        }
        runs
    }

    /// Distinct names of materials that an MTL file can represent.
    fn readable_names(&self) -> Vec<String> {
        let mut taken: HashSet<String> =
            self.materials.iter().map(|m| &m.name).filter(|name| readable(name) == **name).cloned().collect();
        let name = |material: &Material| {
            let name = readable(&material.name);
            if name == material.name {
                return name;
            }
            let mut numbered = std::iter::once(name.clone()).chain((2u64..).map(|n| format!("{name}_{n}")));
            // Some number is unused.
            numbered.find(|name| taken.insert(name.clone())).unwrap_or_default()
        };
        self.materials.iter().map(name).collect()
    }

    fn write_obj(
        &self,
        file: &mut File,
        mtl: &str,
        names: &[String],
        textures: &[SavedTexture],
        range: std::ops::Range<u32>,
        vertices: &mut [u32],
    ) -> Result<(), Error> {
        let mut file = BufWriter::new(file);
        writeln!(file, "mtllib {mtl}")?;
        for &mut v in vertices.iter_mut() {
            let [x, y, z] = self.vertices[v as usize].to_array();
            writeln!(file, "v {x:?} {y:?} {z:?}")?;
        }
        let numbers: HashMap<u32, usize> = vertices.iter().zip(1..).map(|(&v, number)| (v, number)).collect();
        let (mut current, mut coordinates) = (None, 0);
        for t in range {
            let triangle = &self.triangles[t as usize];
            let texture = textures.iter().find_map(|texture| Some((texture, texture.uvs(self, t)?)));
            let name = texture.map_or(&names[triangle.material as usize], |(texture, _)| &texture.material);
            if current != Some(name) {
                writeln!(file, "usemtl {name}")?;
                current = Some(name);
            }
            let [a, b, c] = triangle.vertices.map(|v| numbers.get(&v).copied().unwrap_or(0));
            if let Some((_, uvs)) = texture {
                for uv in uvs {
                    // OBJ counts from the lower left corner.
                    writeln!(file, "vt {:?} {:?}", uv.x, 1.0 - uv.y)?;
                }
                let [i, j, k] = [1, 2, 3].map(|corner| coordinates + corner);
                coordinates += 3;
                writeln!(file, "f {a}/{i} {b}/{j} {c}/{k}")?;
            } else {
                writeln!(file, "f {a} {b} {c}")?;
            }
        }
        file.flush()
    }

    fn write_mtl(&self, file: &mut File, names: &[String], textures: &[SavedTexture]) -> Result<(), Error> {
        let mut file = BufWriter::new(file);
        let write =
            |file: &mut BufWriter<&mut File>, name: &String, material: &Material, albedo: [f64; 3]| {
                writeln!(file, "newmtl {name}")?;
                for (key, [r, g, b]) in [("Kd", albedo), ("Ks", material.specular), ("Ke", material.emission)]
                {
                    writeln!(file, "{key} {r:?} {g:?} {b:?}")?;
                }
                writeln!(file, "Ns {:?}", material.power)
            };
        for (material, name) in self.materials.iter().zip(names) {
            write(&mut file, name, material, material.albedo)?;
        }
        for texture in textures {
            write(&mut file, &texture.material, &self.materials[texture.like as usize], [1.0; 3])?;
            writeln!(file, "map_Kd {}", texture.file)?;
        }
        file.flush()
    }

    fn toml(&self, mesh: Vec<MeshTable>, names: &[String]) -> Result<String, toml::ser::Error> {
        let special = |m: &Material| m.diffuse != 1.0 || m.normalization != Normalization::Phong;
        let material = self.materials.iter().zip(names).filter(|(m, _)| special(m));
        let table = |m: &Material| MaterialTable {
            diffuse: m.diffuse,
            normalization: match m.normalization {
                Normalization::Phong => "phong",
                Normalization::Energy => "energy",
            },
        };
        let (error, usual) = (self.target_error, SolveSettings::default());
        let bins = BTreeMap::from([match self.settings.bins {
            BinLayout::EqualAngle { theta, phi } => ("equal_angle", Bins::Two([theta, phi])),
            BinLayout::Concentric { n } => ("concentric", Bins::One(n)),
        }]);
        let settings = SettingsTable {
            error,
            bins: (error.is_none() && self.settings.bins != usual.bins).then_some(bins),
            near_field: (error.is_none() && self.settings.near_field != usual.near_field)
                .then_some(self.settings.near_field),
            lamps: self.settings.lamps.to_string(),
            tolerance: error.is_none().then_some(self.settings.tolerance),
            max_passes: self.settings.max_passes,
            solver: match self.settings.solver {
                SolverChoice::Auto => "auto",
                SolverChoice::FixedPoint => "fixed-point",
                SolverChoice::Gmres => "gmres",
            },
            precision: self.settings.precision.to_string(),
            backend: self.settings.backend.to_string(),
            visibility: self.settings.visibility.to_string(),
            ray_error: self.settings.ray_error,
        };
        let sun = |sun: &Sun| SunTable {
            direction: sun.direction.into(),
            irradiance: sun.irradiance,
            angular_diameter: sun.angular_diameter,
        };
        let scene = SceneTable {
            mesh,
            material: material.map(|(m, name)| (name.as_str(), table(m))).collect(),
            sun: self.suns.iter().map(sun).collect(),
            settings,
        };
        let mut text = toml::to_string(&scene)?;
        // One by one: the order of cameras matters, and maps have none.
        for camera in &self.cameras {
            let table = CameraTable {
                position: camera.position.into(),
                target: camera.target.into(),
                up: camera.up.into(),
                fov_x_degrees: camera.fov_x_degrees,
                width: camera.width,
                height: camera.height,
            };
            let named = BTreeMap::from([("camera", BTreeMap::from([(&camera.name, table)]))]);
            text.push('\n');
            text.push_str(&toml::to_string(&named)?);
        }
        Ok(text)
    }
}

/// A texture that was fitted, as it is written on triangles whose materials differ in albedo alone.
struct SavedTexture {
    maps: u32,
    image: Arc<Texture>,
    file: String,
    /// Whether no other one of the same file is before it.
    is_first: bool,
    /// Name of the material of its triangles, and one that it is like but for the albedo.
    material: String,
    like: u32,
}

impl SavedTexture {
    /// The texture coordinates of a triangle that it covers.
    fn uvs(&self, scene: &Scene, triangle: u32) -> Option<[DVec2; 3]> {
        let (maps, uvs) = scene.patterns.textured(triangle as usize)?;
        let alike = || alike(scene.material(triangle as usize), &scene.materials[self.like as usize]);
        (maps == self.maps && alike()).then_some(uvs)
    }
}

/// Whether materials differ in nothing but name and albedo.
fn alike(a: &Material, b: &Material) -> bool {
    *a == Material { name: a.name.clone(), albedo: a.albedo, ..b.clone() }
}

impl Scene {
    /// The textures that were fitted, in the order of the scene's.
    fn saved_textures(&self, stem: &str, names: &[String]) -> Vec<SavedTexture> {
        let mut taken: HashSet<String> = names.iter().cloned().collect();
        let mut saved: Vec<SavedTexture> = Vec::new();
        let mut number = 0u64;
        for (maps, image) in self.patterns.fitted() {
            let first = loop {
                number += 1;
                let name = format!("texture_{number}");
                if taken.insert(name.clone()) {
                    break name;
                }
            };
            let file = format!("{stem}_{first}.png");
            let before = saved.len();
            for t in 0..self.triangles.len() as u32 {
                let on_it = self.patterns.textured(t as usize).is_some_and(|(own, _)| own == maps);
                if on_it && saved[before..].iter().all(|known| known.uvs(self, t).is_none()) {
                    let is_first = saved.len() == before;
                    let material = match is_first {
                        true => first.clone(),
                        false => free_name(&first, |name| taken.insert(name.to_owned())),
                    };
                    let like = self.triangles[t as usize].material;
                    let (image, file) = (image.clone(), file.clone());
                    saved.push(SavedTexture { maps, image, file, is_first, material, like });
                }
            }
        }
        saved
    }

    /// Names of materials in the files that [`Self::save`] writes.
    pub(super) fn saved_names(&self) -> Vec<String> {
        let mut names = self.readable_names();
        let textures = self.saved_textures("", &names);
        for (t, triangle) in (0..).zip(&self.triangles) {
            if let Some(texture) = textures.iter().find(|texture| texture.uvs(self, t).is_some()) {
                names[triangle.material as usize].clone_from(&texture.material);
            }
        }
        names
    }
}

/// A name in a form that the line syntax of OBJ and MTL can represent.
fn readable(name: &str) -> String {
    let mut before = ' ';
    let mut readable: String = name
        .trim()
        .chars()
        .map(|c| {
            let comment = c == '#' && before.is_whitespace();
            before = c;
            if comment || c.is_control() || c == '\u{feff}' { '_' } else { c }
        })
        .collect();
    if readable.ends_with('\\') {
        readable.pop();
        readable.push('_');
    }
    if readable.is_empty() { String::from("_") } else { readable }
}
