//! Reads OBJ files.
//!
//! Own code, because errors must name file and line, and because triangles and vertices keep the file's order in every
//! output. The crate `tobj`, which tests compare this reader with, renumbers vertices, does not report lines, and rejects
//! valid files: `what_keeps_tobj_from_reading_for_us` in tests/scene_input/against_tobj.rs shows each reason.

use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use glam::{DVec2, DVec3};

use super::error::{Place, SceneError, nearest, quoted};
use super::geometry::{Maps, RawMaterial, RawMesh};
use super::material::Material;
use super::mtl;
use super::statements::{Statement, number, read_text, statements};
use super::texture::{Encoding, Map, Texture, linear_from_srgb};
use super::triangulate::triangulate;

/// The material of faces before any `usemtl`.
const DEFAULT_MATERIAL: &str = "default";
const GREY: [f64; 3] = [0.5; 3];
/// Statements that do not affect geometry or materials.
const IGNORED: [&str; 5] = ["g", "s", "vp", "l", "p"];
const READ: [&str; 7] = ["o", "v", "vt", "vn", "f", "usemtl", "mtllib"];

/// Reads a mesh and its MTL files. A material for which `defined_elsewhere` holds needs no MTL; others that are missing are
/// grey, or with `strict` an error.
pub(super) fn read(
    path: &Path,
    strict: bool,
    defined_elsewhere: impl Fn(&str) -> bool,
    warnings: &mut Vec<String>,
) -> Result<RawMesh, SceneError> {
    let text = read_text(path).map_err(|reason| SceneError::Read { path: path.to_path_buf(), reason })?;
    let mut reader = Reader {
        path,
        strict,
        warnings,
        vertices: Vec::new(),
        colours: Vec::new(),
        coordinates: Vec::new(),
        normals: Vec::new(),
        against_normals: (0, 0),
        faces: Vec::new(),
        uvs: Vec::new(),
        textures: HashMap::new(),
        face_materials: Vec::new(),
        face_lines: Vec::new(),
        objects: Vec::new(),
        uses: Vec::new(),
        use_indices: HashMap::new(),
        current: None,
        materials: Vec::new(),
        material_indices: HashMap::new(),
        libraries: Vec::new(),
        missing: Vec::new(),
        unknown: None,
    };
    for statement in statements(&text) {
        reader.read(&statement)?;
    }
    reader.finish(defined_elsewhere)
}

/// A material name and the line of its first face or `usemtl`.
struct Use {
    name: String,
    line: usize,
    /// False for the faces before any `usemtl`.
    named: bool,
}

struct Reader<'a> {
    path: &'a Path,
    strict: bool,
    warnings: &'a mut Vec<String>,
    vertices: Vec<DVec3>,
    /// Colour of each vertex in linear light, NaN where it has none.
    colours: Vec<DVec3>,
    /// Texture coordinates of `vt` lines.
    coordinates: Vec<DVec2>,
    /// Normals of `vn` lines.
    normals: Vec<DVec3>,
    /// Number of faces whose normals point to their backs, and the line of the first.
    against_normals: (usize, usize),
    faces: Vec<[u32; 3]>,
    /// Per face, NaN where a corner has no texture coordinates.
    uvs: Vec<[DVec2; 3]>,
    /// Textures by file; `None` where a file cannot be used.
    textures: HashMap<PathBuf, Option<Arc<Texture>>>,
    face_materials: Vec<u32>,
    face_lines: Vec<u32>,
    /// Names of objects, each with its first face.
    objects: Vec<(String, u32)>,
    uses: Vec<Use>,
    use_indices: HashMap<String, u32>,
    /// Index into `uses`.
    current: Option<u32>,
    materials: Vec<RawMaterial>,
    material_indices: HashMap<String, usize>,
    libraries: Vec<PathBuf>,
    /// Files of `mtllib` lines that do not exist.
    missing: Vec<PathBuf>,
    /// Line and keyword of the first unknown statement.
    unknown: Option<(usize, String)>,
}

impl Reader<'_> {
    fn read(&mut self, statement: &Statement) -> Result<(), SceneError> {
        let line = statement.line;
        let place = Place { path: self.path, line };
        match statement.keyword() {
            "v" => {
                let (position, colour) = vertex(statement, place)?;
                self.vertices.push(position);
                self.colours.push(colour);
            }
            // One that is no number matters to textures alone.
            "vt" => {
                let mut words = statement.words().map(|word| word.parse().unwrap_or(f64::NAN));
                let mut next = || words.next().unwrap_or(0.0);
                self.coordinates.push(DVec2::new(next(), next()));
            }
            // One that is no number points nowhere.
            "vn" => {
                let mut words = statement.words().map(|word| word.parse().unwrap_or(0.0));
                let mut next = || words.next().unwrap_or(0.0);
                self.normals.push(DVec3::new(next(), next(), next()));
            }
            "f" => self.face(statement, place)?,
            "usemtl" if statement.rest().is_empty() => {
                return Err(place.error("`usemtl` without a name; expected `usemtl NAME`"));
            }
            "usemtl" => self.current = Some(self.use_index(statement.rest(), line, true)),
            "mtllib" => self.library(statement.rest(), place)?,
            "o" => self.objects.push((statement.rest().to_owned(), self.faces.len() as u32)),
            key if IGNORED.contains(&key) => {}
            key => {
                self.unknown.get_or_insert_with(|| (line, key.to_owned()));
            }
        }
        Ok(())
    }

    fn use_index(&mut self, name: &str, line: usize, named: bool) -> u32 {
        if let Some(&index) = self.use_indices.get(name) {
            return index;
        }
        let index = self.uses.len() as u32;
        self.use_indices.insert(name.to_owned(), index);
        self.uses.push(Use { name: name.to_owned(), line, named });
        index
    }

    fn face(&mut self, statement: &Statement, place: Place) -> Result<(), SceneError> {
        let corners = statement
            .words()
            .map(|word| corner(word, self.vertices.len(), place))
            .collect::<Result<Vec<u32>, _>>()?;
        if corners.len() < 3 {
            return Err(place.error(format!("a face with {} corner(s); it needs at least 3", corners.len())));
        }
        let material = match self.current {
            Some(material) => material,
            None => self.use_index(DEFAULT_MATERIAL, place.line, false),
        };
        let positions: Vec<DVec3> = corners.iter().map(|&c| self.vertices[c as usize]).collect();
        let uvs: Vec<DVec2> = statement.words().map(|word| self.texture_coordinates(word)).collect();
        let normal: DVec3 = statement.words().map(|word| self.normal(word)).sum();
        let mut front = DVec3::ZERO;
        for triangle in triangulate(&positions) {
            let [a, b, c] = triangle.map(|at| positions[at]);
            front += (b - a).cross(c - a);
            self.faces.push(triangle.map(|at| corners[at]));
            self.uvs.push(triangle.map(|at| uvs[at]));
            self.face_materials.push(material);
            self.face_lines.push(u32::try_from(place.line).unwrap_or(u32::MAX));
        }
        if normal.dot(front) < 0.0 {
            let (count, first) = self.against_normals;
            self.against_normals = (count + 1, if count == 0 { place.line } else { first });
        }
        Ok(())
    }

    /// Normal of a corner `v//vn` or `v/vt/vn`, or zero.
    fn normal(&self, word: &str) -> DVec3 {
        listed(&self.normals, word.split('/').nth(2)).unwrap_or_default()
    }

    /// Texture coordinates of a corner `v/vt`, or NaN.
    fn texture_coordinates(&self, word: &str) -> DVec2 {
        listed(&self.coordinates, word.split('/').nth(1)).unwrap_or(DVec2::NAN)
    }

    /// A texture that an MTL file names. One that is missing, or of a kind that is not read, is left out with a warning.
    fn map(&mut self, named: Option<mtl::TextureFile>, mtl: &Path) -> Result<Option<Map>, SceneError> {
        let Some(mtl::TextureFile { name, place, wrap, line }) = named else { return Ok(None) };
        let file = mtl.parent().unwrap_or(Path::new("")).join(&name);
        let at = Place { path: mtl, line };
        let texture = match self.textures.get(&file) {
            Some(known) => known.clone(),
            None => {
                let texture = if file.exists() {
                    let read = Texture::read(&file, Encoding::Srgb);
                    read.map_err(|message| at.error(format!("texture {} {message}", file.display())))?
                } else {
                    None
                };
                if texture.is_none() {
                    let why = if file.exists() { "is neither PNG nor JPEG" } else { "is missing" };
                    self.warnings.push(format!("{at}: texture {} {why} and is left out.", file.display()));
                }
                let texture = texture.map(Arc::new);
                self.textures.insert(file, texture.clone());
                texture
            }
        };
        Ok(texture.map(|texture| Map { texture, place, wrap: [wrap; 2] }))
    }

    /// `mtllib` may list several files, but a file name may also contain blanks: a file with the whole name takes precedence.
    fn library(&mut self, names: &str, place: Place) -> Result<(), SceneError> {
        if names.is_empty() {
            return Err(place.error("`mtllib` without a file; expected `mtllib FILE.mtl`"));
        }
        let folder = self.path.parent().unwrap_or(Path::new(""));
        let whole = folder.join(names);
        let files = if whole.is_file() {
            vec![whole]
        } else {
            names.split_whitespace().map(|name| folder.join(name)).collect()
        };
        for file in files {
            if self.libraries.contains(&file) || self.missing.contains(&file) {
                continue;
            }
            let text = match read_text(&file) {
                Ok(text) => text,
                Err(reason) if self.strict || reason.kind() != std::io::ErrorKind::NotFound => {
                    let (path, line) = (self.path.to_path_buf(), place.line);
                    return Err(SceneError::MaterialFile { path, line, mtl: file, reason });
                }
                Err(_) => {
                    self.missing.push(file);
                    continue;
                }
            };
            for mtl::MtlMaterial { material, line, albedo, emission } in
                mtl::parse(&text, &file, self.warnings)?
            {
                if let Some(&first) = self.material_indices.get(&material.name) {
                    let before = self.materials[first]
                        .origin
                        .as_ref()
                        .and_then(|(path, line)| Some(format!(" at {}:{}", path.display(), (*line)?)))
                        .unwrap_or_default();
                    return Err(Place { path: &file, line }.error(format!(
                        "material \"{}\" is already defined{before}; rename one of the two",
                        material.name
                    )));
                }
                self.material_indices.insert(material.name.clone(), self.materials.len());
                let origin = Some((file.clone(), Some(line)));
                let maps = Maps { albedo: self.map(albedo, &file)?, emission: self.map(emission, &file)? };
                self.materials.push(RawMaterial { material, origin, two_sided: false, maps });
            }
            self.libraries.push(file);
        }
        Ok(())
    }

    /// Albedos of the faces' corners from the colours of vertices, where no material is stated; empty where there are none.
    fn colours_of_faces(
        &mut self,
        known: &HashSet<&str>,
        defined_elsewhere: impl Fn(&str) -> bool,
    ) -> Vec<[DVec3; 3]> {
        let Some(first) = self.colours.iter().position(|colour| !colour.is_nan()) else { return Vec::new() };
        let stated = |used: &Use| known.contains(used.name.as_str()) || defined_elsewhere(&used.name);
        if self.uses.iter().any(stated) {
            self.warnings.push(format!(
                "{}: vertices have colours (vertex {} is the first), which are ignored since there are materials.",
                self.path.display(),
                first + 1
            ));
            return Vec::new();
        }
        let of = |&corner: &u32| Some(self.colours[corner as usize]).filter(|colour| !colour.is_nan());
        let colours = |face: &[u32; 3]| [0, 1, 2].map(|at| of(&face[at]).unwrap_or(DVec3::from(GREY)));
        self.faces.iter().map(colours).collect()
    }

    /// Resolved at the end, because an `mtllib` may come after the faces that need it.
    fn finish(mut self, defined_elsewhere: impl Fn(&str) -> bool) -> Result<RawMesh, SceneError> {
        let known: Vec<String> = self.materials.iter().map(|m| m.material.name.clone()).collect();
        let known = || known.iter().map(String::as_str);
        let is_known: HashSet<&str> = known().collect();
        let list = |files: &[PathBuf]| {
            files.iter().map(|file| file.display().to_string()).collect::<Vec<_>>().join(", ")
        };
        let colours = self.colours_of_faces(&is_known, &defined_elsewhere);
        let coloured = !colours.is_empty();
        let mut grey = Vec::new();
        for used in &self.uses {
            let place = Place { path: self.path, line: used.line };
            let name = &used.name;
            if is_known.contains(name.as_str()) || defined_elsewhere(name) {
                continue;
            }
            let hint = nearest(name, known()).map(|near| format!("; did you mean \"{near}\"?"));
            if used.named && self.strict && !self.libraries.is_empty() {
                let (files, hint) = (list(&self.libraries), hint.unwrap_or("; define it there".to_owned()));
                return Err(place.error(format!("material \"{name}\" is not defined in {files}{hint}")));
            }
            match (used.named, hint) {
                _ if coloured => {}
                (false, _) => self.warnings.push(format!(
                    "{place}: faces before any usemtl have the material \"{name}\": grey, albedo 0.5."
                )),
                (true, Some(hint)) => self.warnings.push(format!(
                    "{place}: material \"{name}\" is not defined in {} and is grey, albedo 0.5{hint}",
                    list(&self.libraries)
                )),
                (true, None) => grey.push((place, name.as_str())),
            }
            let albedo = if coloured { [1.0; 3] } else { GREY };
            let material = Material { albedo, ..Material::named(name) };
            self.materials.push(RawMaterial::placeholder(material));
        }
        if let Some((place, _)) = grey.first() {
            let names = quoted(grey.iter().map(|(_, name)| *name));
            let why = match (self.missing.is_empty(), self.libraries.is_empty()) {
                (false, _) => format!("{} is missing, so", list(&self.missing)),
                (true, false) => format!("{} does not define them, so", list(&self.libraries)),
                (true, true) => String::from("no mtllib defines them, so"),
            };
            self.warnings.push(format!(
                "{place}: {why} the materials {names} are grey, albedo 0.5, unless another file defines them."
            ));
        } else if !self.missing.is_empty() {
            self.warnings.push(format!("{}: {} is missing.", self.path.display(), list(&self.missing)));
        }
        if let (count @ 1.., line) = self.against_normals {
            self.warnings.push(format!(
                "{}: the normals (`vn`) of this and {} other face(s) point to their backs; fronts are where corners run \
                 counter-clockwise. Turn them where they come out black, or give them a second side (--two-sided).",
                Place { path: self.path, line },
                count - 1
            ));
        }
        if let Some((line, key)) = &self.unknown {
            let place = Place { path: self.path, line: *line };
            let hint = nearest(key, READ).map_or(String::new(), |near| format!("; did you mean `{near}`?"));
            self.warnings
                .push(format!("{place}: `{key}` and other statements unknown here are ignored{hint}."));
        }
        Ok(RawMesh {
            vertices: self.vertices,
            faces: self.faces,
            face_materials: self.face_materials,
            face_lines: self.face_lines,
            uvs: self.uvs,
            colours,
            objects: self.objects,
            material_names: self.uses.into_iter().map(|used| used.name).collect(),
            materials: self.materials,
        })
    }
}

/// Three coordinates, and the colour where three numbers from 0 to 1 follow: sRGB, as MeshLab and Blender write it. Anything else
/// there (a weight) is ignored.
fn vertex(statement: &Statement, place: Place) -> Result<(DVec3, DVec3), SceneError> {
    let mut words = statement.words();
    let mut coordinate = || match words.next() {
        Some(word) => number(word, place),
        None => Err(place.error("a vertex with fewer than 3 coordinates; expected `v x y z`")),
    };
    let position = DVec3::new(coordinate()?, coordinate()?, coordinate()?);
    let more: Vec<f64> = words.map(|word| word.parse().unwrap_or(f64::NAN)).collect();
    let colour = match more[..] {
        [r, g, b] if more.iter().all(|value| (0.0..=1.0).contains(value)) => {
            DVec3::from([r, g, b].map(linear_from_srgb))
        }
        _ => DVec3::NAN,
    };
    Ok((position, colour))
}

/// What an index of a corner names: counted from 1, or backwards from the last one if negative.
fn listed<T: Copy>(all: &[T], index: Option<&str>) -> Option<T> {
    let index: i64 = index?.parse().ok()?;
    let from_zero = if index > 0 { index - 1 } else { (all.len() as i64).saturating_add(index) };
    all.get(usize::try_from(from_zero).ok()?).copied()
}

/// The vertex of a corner `v`, `v/vt`, `v//vn` or `v/vt/vn`: counted from 1, or backwards from the last one if negative.
fn corner(word: &str, vertices: usize, place: Place) -> Result<u32, SceneError> {
    let index = word.split('/').next().unwrap_or_default();
    let index: i64 = index.parse().map_err(|_| {
        place.error(format!(
            "corner `{word}` is not a vertex index; expected `v`, `v/vt`, `v//vn` or `v/vt/vn`"
        ))
    })?;
    let count = vertices as i64;
    let from_zero = if index > 0 { index - 1 } else { count.saturating_add(index) };
    if count == 0 {
        return Err(place.error("a face before any vertex; put the `v` lines first"));
    }
    if index == 0 || from_zero < 0 || from_zero >= count {
        return Err(place.error(format!(
            "vertex index {index} is out of range; {count} vertices stand above this line, \
             so 1 to {count} or -{count} to -1"
        )));
    }
    u32::try_from(from_zero)
        .map_err(|_| place.error("more vertices than 32-bit indices can count; split the mesh"))
}
