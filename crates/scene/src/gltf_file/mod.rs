//! Reads glTF 2.0, `.gltf` and `.glb`: meshes, instances, materials, cameras and lights of the default scene.
//!
//! The crate `gltf` parses and validates the document. Buffers and accessors are read here, where every offset is checked
//! and every error names the file.

mod accessor;
mod buffers;
mod extensions;
mod instancing;
mod lights;
mod materials;
mod meshopt;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use glam::{DMat4, DVec2, DVec3};
use gltf::mesh::{Mode, Semantic};
use serde::Deserialize;
use serde_json::json;

use self::accessor::Accessors;
use self::buffers::Buffers;
use self::lights::Represented;
use self::materials::Materials;
use super::Camera;
use super::error::SceneError;
use super::geometry::RawMesh;
use super::mesh_file::{Contents, MOST_TRIANGLES};
use super::point_lights::{self, PointLight};
use antirad_base::output::free_name;

/// Rows of the picture of a camera.
const HEIGHT: u32 = 480;

/// Reads a file. `warnings` takes what is left out or represented otherwise.
///
/// The crate panics at some malformed documents; that ends here, as an error.
pub(super) fn read(path: &Path, warnings: &mut Vec<String>) -> Result<Contents, SceneError> {
    let read = std::panic::AssertUnwindSafe(|| read_document(path, warnings));
    std::panic::catch_unwind(read).unwrap_or_else(|_| {
        let message = String::from("is no valid glTF 2.0: its parts do not fit together");
        Err(SceneError::File { path: path.to_path_buf(), message })
    })
}

fn read_document(path: &Path, warnings: &mut Vec<String>) -> Result<Contents, SceneError> {
    let bytes = antirad_base::input::read_at_most(path, buffers::MOST_BYTES)
        .map_err(|reason| SceneError::Read { path: path.to_path_buf(), reason })?;
    let invalid = |message: String| SceneError::File { path: path.to_path_buf(), message };
    let (document, blob) =
        parse(&bytes).map_err(|message| invalid(format!("is no glTF 2.0 that can be read: {message}")))?;
    drop(bytes);
    let buffers = Buffers::read(&document, blob, path).map_err(invalid)?;
    let Some(scene) = document.default_scene().or_else(|| document.scenes().next()) else {
        return Err(invalid(String::from("has no scene")));
    };
    let accessors = Accessors::new(&buffers);
    let mut reader = Reader {
        document: &document,
        materials: Materials::new(path, &buffers),
        accessors,
        contents: Contents::default(),
        lights: Vec::new(),
        ignored: extensions::notes(&document.as_json().extensions_used).collect(),
        triangles: 0,
    };
    // Every node has one parent at most, so that one met twice belongs to a cycle or to two parents.
    let mut seen = HashSet::new();
    let mut waiting: Vec<(gltf::Node, DMat4)> = scene.nodes().map(|node| (node, DMat4::IDENTITY)).collect();
    waiting.reverse();
    while let Some((node, parent)) = waiting.pop() {
        if !seen.insert(node.index()) {
            return Err(invalid(format!("node {} is a child twice, or its own ancestor", node.index())));
        }
        let place = parent * matrix(&node);
        reader.node(&node, place).map_err(|message| invalid(format!("node {}: {message}", node.index())))?;
        let children: Vec<_> = node.children().map(|child| (child, place)).collect();
        waiting.extend(children.into_iter().rev());
    }
    if document.animations().len() > 0 {
        reader.ignore("animations");
    }
    reader.finish(path, warnings)
}

/// The document, with all indices in range, and the binary part of the file.
fn parse(bytes: &[u8]) -> Result<(gltf::Document, Option<Vec<u8>>), String> {
    let one_line = |error: gltf::Error| error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
    let (text, blob) = chunks(bytes)?;
    let mut json: gltf::json::Root =
        gltf::json::deserialize::from_slice(text).map_err(|error| error.to_string())?;
    // The crate would refuse those that it leaves to its callers, and positions without bounds, which nothing here reads.
    extensions::check(&std::mem::take(&mut json.extensions_required))?;
    for accessor in &mut json.accessors {
        (accessor.min, accessor.max) = (Some(json!([0, 0, 0])), Some(json!([0, 0, 0])));
    }
    // The validation of the crate relies on this itself.
    let primitives = json.meshes.iter().flat_map(|mesh| &mesh.primitives);
    let accessors = primitives.flat_map(|primitive| primitive.attributes.values());
    if let Some(off) = accessors.map(|index| index.value()).find(|&index| index >= json.accessors.len()) {
        return Err(format!("accessor {off} is past the end of {}", json.accessors.len()));
    }
    let no_data = |image: &gltf::json::Image| {
        image.uri.is_none() && (image.buffer_view.is_none() || image.mime_type.is_none())
    };
    if let Some(image) = json.images.iter().position(no_data) {
        return Err(format!("image {image} has neither an address nor a view with a type"));
    }
    Ok((gltf::Document::from_json(json).map_err(one_line)?, blob))
}

/// The JSON of a file, and the binary part of a `.glb`. The crate's own reader relies on the lengths in the file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<Vec<u8>>), String> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| {
        let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok()).map(u32::from_le_bytes);
        word.ok_or_else(|| String::from("it is cut short"))
    };
    if word(4)? != 2 {
        return Err(format!("it is of version {}", word(4)?));
    }
    let chunk = |at: usize| -> Result<&[u8], String> {
        let length = word(at)? as usize;
        bytes.get(at + 8..at + 8 + length).ok_or_else(|| String::from("it is cut short"))
    };
    let text = chunk(12)?;
    let next = 12 + 8 + text.len();
    let blob = if next < bytes.len() { Some(chunk(next)?.to_vec()) } else { None };
    Ok((text, blob))
}

fn matrix(node: &gltf::Node) -> DMat4 {
    DMat4::from_cols_array_2d(&node.transform().matrix().map(|column| column.map(f64::from)))
}

/// The size of a picture that was exported from here, in `extras` of its camera.
#[derive(Deserialize)]
struct Pixels {
    width: u32,
    height: u32,
}

impl Pixels {
    fn of(extras: &str) -> Option<(u32, u32)> {
        #[derive(Deserialize)]
        struct Extras {
            antirad: Pixels,
        }
        serde_json::from_str::<Extras>(extras)
            .ok()
            .map(|extras| (extras.antirad.width, extras.antirad.height))
    }
}

struct Reader<'a> {
    document: &'a gltf::Document,
    accessors: Accessors<'a>,
    materials: Materials<'a>,
    contents: Contents,
    lights: Vec<PointLight>,
    /// What is left out, each once.
    ignored: Vec<String>,
    triangles: usize,
}

impl Reader<'_> {
    fn ignore(&mut self, what: &str) {
        if !self.ignored.iter().any(|known| known == what) {
            self.ignored.push(what.to_owned());
        }
    }

    fn node(&mut self, node: &gltf::Node, place: DMat4) -> Result<(), String> {
        if !place.is_finite() {
            return Err(String::from("its place is not finite"));
        }
        if let Some(mesh) = node.mesh() {
            let name = node.name().or(mesh.name()).map_or(format!("mesh {}", mesh.index()), str::to_owned);
            let place = if node.skin().is_some() {
                self.ignore("skins");
                DMat4::IDENTITY
            } else {
                place
            };
            for instance in instancing::places(self.document, node, &self.accessors)? {
                let mesh = self.mesh(&mesh, place * instance)?;
                if !mesh.faces.is_empty() {
                    self.contents.meshes.push((name.clone(), mesh));
                }
            }
        }
        if let Some(camera) = node.camera() {
            let name =
                node.name().or(camera.name()).map_or(format!("camera {}", camera.index()), str::to_owned);
            self.camera(name, &camera, place);
        }
        if let Some(light) = node.light() {
            let name = node.name().or(light.name()).map_or(format!("light {}", light.index()), str::to_owned);
            match lights::read(name, &light, place) {
                Represented::Lamp(light) => self.lights.push(light),
                Represented::Sun(sun) => self.contents.suns.push(sun),
            }
        }
        Ok(())
    }

    fn camera(&mut self, name: String, camera: &gltf::Camera, place: DMat4) {
        let gltf::camera::Projection::Perspective(lens) = camera.projection() else {
            return self.ignore("orthographic cameras");
        };
        let aspect = lens.aspect_ratio().map_or(4.0 / 3.0, f64::from).clamp(0.05, 20.0);
        let own = camera.extras().as_ref().and_then(|extras| Pixels::of(extras.get()));
        let (width, height) = own.unwrap_or(((f64::from(HEIGHT) * aspect).round() as u32, HEIGHT));
        let position = place.transform_point3(DVec3::ZERO);
        let ahead = place.transform_vector3(DVec3::NEG_Z);
        let name = free_name(&name, |name| self.contents.cameras.iter().all(|c| c.name != name));
        self.contents.cameras.push(Camera {
            name,
            position,
            target: position + ahead,
            up: place.transform_vector3(DVec3::Y),
            fov_x_degrees: 2.0 * ((f64::from(lens.yfov()) / 2.0).tan() * aspect).atan().to_degrees(),
            width,
            height,
        });
    }

    fn mesh(&mut self, mesh: &gltf::Mesh, place: DMat4) -> Result<RawMesh, String> {
        let mut raw = RawMesh::empty();
        if mesh.weights().is_some() {
            self.ignore("morph targets");
        }
        let mut known = HashMap::new();
        for primitive in mesh.primitives() {
            self.primitive(&primitive, &mut raw, &mut known).map_err(|message| {
                format!("mesh {}, primitive {}: {message}", mesh.index(), primitive.index())
            })?;
        }
        raw.place(place);
        Ok(raw)
    }

    fn primitive(
        &mut self,
        primitive: &gltf::Primitive,
        raw: &mut RawMesh,
        known: &mut HashMap<Option<usize>, u32>,
    ) -> Result<(), String> {
        let mode = primitive.mode();
        if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            self.ignore("points and lines");
            return Ok(());
        }
        let Some(positions) = primitive.get(&Semantic::Positions) else {
            return Err(String::from("it has no positions"));
        };
        let positions = self.accessors.rows::<3>(&positions)?;
        let indices: Vec<u32> = match primitive.indices() {
            Some(indices) => self.accessors.indices(&indices)?,
            None => (0..positions.len() as u32).collect(),
        };
        if let Some(off) = indices.iter().find(|&&index| index as usize >= positions.len()) {
            return Err(format!("index {off} is past the end of {} vertices", positions.len()));
        }
        let faces = triangles(mode, &indices);
        self.triangles += faces.len();
        if self.triangles > MOST_TRIANGLES {
            return Err(format!("more than {MOST_TRIANGLES} triangles in all instances"));
        }
        let material = primitive.material();
        let index = match known.get(&material.index()) {
            Some(&index) => index,
            None => {
                let index = raw.material_names.len() as u32;
                let material = self.materials.read(&material, &mut self.ignored)?;
                raw.material_names.push(material.material.name.clone());
                raw.materials.push(material);
                known.insert(primitive.material().index(), index);
                index
            }
        };
        let first = raw.vertices.len() as u32;
        raw.vertices.extend(positions.into_iter().map(DVec3::from));
        let set = materials::texture_set(&primitive.material());
        let uvs = match set.map(|set| primitive.get(&Semantic::TexCoords(set))) {
            Some(Some(uvs)) => Some(self.accessors.rows::<2>(&uvs)?),
            _ => None,
        };
        let colours = match primitive.get(&Semantic::Colors(0)) {
            Some(colours) => Some(self.accessors.colours(&colours)?),
            None => None,
        };
        for face in &faces {
            let uv = |v: u32| {
                uvs.as_ref().and_then(|uvs| uvs.get(v as usize)).map_or(DVec2::ZERO, |&uv| uv.into())
            };
            let colour = |v: u32| {
                colours
                    .as_ref()
                    .and_then(|colours| colours.get(v as usize))
                    .map_or(DVec3::ONE, |&rgb| rgb.into())
            };
            raw.uvs.push(face.map(uv));
            raw.colours.push(face.map(colour));
            raw.faces.push(face.map(|v| first + v));
            raw.face_materials.push(index);
        }
        Ok(())
    }

    fn finish(mut self, path: &Path, warnings: &mut Vec<String>) -> Result<Contents, SceneError> {
        point_lights::add(&self.lights, &mut self.contents, path, warnings);
        if !self.ignored.is_empty() {
            warnings.push(format!("{}: ignored: {}.", path.display(), self.ignored.join(", ")));
        }
        Ok(self.contents)
    }
}

/// The triangles of indices; those that are left over make none.
fn triangles(mode: Mode, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => indices
            .windows(3)
            .enumerate()
            .map(|(k, w)| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
            .collect(),
        Mode::TriangleFan => match indices.split_first() {
            Some((&hub, rim)) => rim.windows(2).map(|w| [hub, w[0], w[1]]).collect(),
            None => Vec::new(),
        },
        _ => indices.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
    }
}
