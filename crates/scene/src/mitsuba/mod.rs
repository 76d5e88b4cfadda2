//! Reads a subset of the scenes of Mitsuba (`.xml`): shapes and instances, diffuse and glossy BSDFs, bitmaps, emitters, perspective sensors.
//!
//! What cannot be represented is named in one warning; what stands in for it is said in docs/scenes.md.

mod bsdf;
mod document;
mod element;
mod emitters;
mod shapes;
mod spectrum;
mod transform;
mod values;

use std::collections::{HashMap, HashSet};
use std::path::Path;

use glam::{DMat4, DVec3};

use self::bsdf::Surface;
use self::document::Source;
use self::element::Element;
use self::spectrum::Of;
use self::values::{Coloured, Values, note};
use super::error::SceneError;
use super::geometry::{Maps, RawMaterial, RawMesh};
use super::mesh_file::{Contents, MOST_TRIANGLES};
use super::point_lights::{self, PointLight};
use super::{Camera, obj, ply};
use antirad_base::output::free_name;

/// Reads a file. `warnings` takes what is left out or represented otherwise.
pub(super) fn read(path: &Path, strict: bool, warnings: &mut Vec<String>) -> Result<Contents, SceneError> {
    let source = Source::read(path)?;
    let mut reader = Reader {
        path,
        strict,
        values: Values::new(&source),
        contents: Contents::default(),
        surfaces: HashMap::new(),
        parts: HashMap::new(),
        names: HashSet::new(),
        lights: Vec::new(),
        triangles: 0,
        ignored: Vec::new(),
    };
    for node in &source.root.children {
        match node.tag.as_str() {
            "shape" => reader.shape(node, warnings)?,
            "sensor" => reader.sensor(node)?,
            "emitter" => reader.emitter(node)?,
            "alias" | "bsdf" | "texture" | "default" | "integrator" => {}
            tag => reader.ignore(format!("<{tag} type=\"{}\">", node.kind())),
        }
    }
    source.root.unread().into_iter().for_each(|unread| reader.ignore(unread));
    point_lights::add(&reader.lights, &mut reader.contents, path, warnings);
    if !reader.ignored.is_empty() {
        warnings.push(format!("{}: ignored or approximated: {}.", path.display(), reader.ignored.join(", ")));
    }
    Ok(reader.contents)
}

/// A BSDF, emission and its texture, which make a material.
type Look = (Option<*const Element>, [u64; 3], Option<*const Element>);

struct Reader<'a> {
    path: &'a Path,
    strict: bool,
    values: Values<'a>,
    contents: Contents,
    /// Surfaces with their emission and names.
    surfaces: HashMap<Look, RawMaterial>,
    /// Meshes of groups, before they are placed.
    parts: HashMap<*const Element, RawMesh>,
    names: HashSet<String>,
    lights: Vec<PointLight>,
    triangles: usize,
    ignored: Vec<String>,
}

impl<'a> Reader<'a> {
    fn ignore(&mut self, what: String) {
        note(&mut self.ignored, what);
    }

    /// A shape, or the shapes of the group that an instance places. Groups stand where their instances do.
    fn shape(&mut self, node: &'a Element, warnings: &mut Vec<String>) -> Result<(), SceneError> {
        match node.kind() {
            "shapegroup" => Ok(()),
            "instance" => {
                let outer = self.place(node)?;
                let group = self.values.object(node, "shape").filter(|group| group.kind() == "shapegroup");
                let group = group.ok_or_else(|| node.wrong("has no <shape type=\"shapegroup\">"))?;
                for child in &group.children {
                    let Some(part) = self.values.resolved(child).filter(|part| part.is("shape")) else {
                        self.ignore(format!("<{}> of <shape type=\"shapegroup\">", child.tag));
                        continue;
                    };
                    let name = node.attribute("id").or(part.attribute("id")).unwrap_or(part.kind());
                    let mesh = match self.parts.remove(&std::ptr::from_ref(part)) {
                        Some(known) => Some(known),
                        None => self.mesh(part, warnings)?,
                    };
                    if let Some(mesh) = mesh {
                        let placed = mesh.clone();
                        self.parts.insert(part, mesh);
                        self.add(name, placed, outer, part)?;
                    }
                }
                Ok(())
            }
            kind => match self.mesh(node, warnings)? {
                Some(mesh) => self.add(node.attribute("id").unwrap_or(kind), mesh, DMat4::IDENTITY, node),
                None => Ok(()),
            },
        }
    }

    /// Places a mesh by the matrix of an instance.
    fn add(&mut self, name: &str, mut mesh: RawMesh, outer: DMat4, node: &Element) -> Result<(), SceneError> {
        self.triangles += mesh.faces.len();
        if self.triangles > MOST_TRIANGLES {
            return Err(node.wrong(format!("more than {MOST_TRIANGLES} triangles in all instances")));
        }
        mesh.place(outer);
        self.contents.meshes.push((name.to_owned(), mesh));
        Ok(())
    }

    /// The mesh of a shape, with its material.
    fn mesh(&mut self, node: &'a Element, warnings: &mut Vec<String>) -> Result<Option<RawMesh>, SceneError> {
        let place = self.place(node)?;
        let flipped = self.values.flag(node, "flip_normals")?;
        let material = self.material(node)?;
        let shines = material.material.emission != [0.0; 3];
        let mut mesh = match node.kind() {
            "obj" | "ply" => self.file(node, warnings)?,
            "rectangle" => shapes::rectangle(),
            "cube" => shapes::cube(),
            "sphere" => {
                let radius = self.values.number(node, "radius")?.unwrap_or(1.0);
                let centre = self.values.point(node, "center")?.unwrap_or(DVec3::ZERO);
                shapes::sphere(centre, radius, shines, flipped)
            }
            "disk" => shapes::disk(),
            other => {
                node.pass_over();
                self.ignore(format!("<shape type=\"{other}\">"));
                return Ok(None);
            }
        };
        mesh.place(place);
        if flipped {
            mesh.turn();
        }
        mesh.material_names = vec![material.material.name.clone()];
        mesh.face_materials = vec![0; mesh.faces.len()];
        mesh.materials = vec![material];
        Ok(Some(mesh))
    }

    fn place(&self, node: &'a Element) -> Result<DMat4, SceneError> {
        Ok(self.values.transform(node, "to_world")?.unwrap_or(DMat4::IDENTITY))
    }

    /// The geometry of an OBJ or PLY.
    fn file(&self, node: &'a Element, warnings: &mut Vec<String>) -> Result<RawMesh, SceneError> {
        let Some(name) = self.values.text(node, "filename")? else {
            return Err(node.wrong("has no <string name=\"filename\">"));
        };
        let file = self.values.beside(name);
        let is_obj = node.kind() == "obj";
        // Its own materials and colours do not count, and neither do notes about them.
        let mut unheard = Vec::new();
        let read = match is_obj {
            true => obj::read(&file, self.strict, |_| true, &mut unheard),
            false => ply::read(&file, "", false, &mut unheard),
        };
        let mesh = match read {
            Ok(mesh) => mesh,
            Err(SceneError::Read { path, reason }) => {
                return Err(node.wrong(format!("{} cannot be read: {reason}", path.display())));
            }
            Err(other) => return Err(other),
        };
        warnings.extend(unheard.into_iter().filter(|note| note.contains("statements unknown")));
        let RawMesh { vertices, faces, face_lines, mut uvs, .. } = mesh;
        let flips = self.values.text(node, "flip_tex_coords")?.map_or(is_obj, |text| text == "true");
        if flips {
            uvs.iter_mut().flatten().for_each(|uv| uv.y = 1.0 - uv.y);
        }
        Ok(RawMesh { face_lines, uvs, ..RawMesh::uniform(vertices, faces, "") })
    }

    fn free_name(&mut self, base: &str) -> String {
        free_name(base, |name| self.names.insert(name.to_owned()))
    }

    /// The material of a shape.
    fn material(&mut self, shape: &'a Element) -> Result<RawMaterial, SceneError> {
        let bsdf = self.values.object(shape, "bsdf");
        let emitter = self.values.object(shape, "emitter");
        let emission = match emitter {
            Some(emitter) if emitter.kind() == "area" => {
                let radiance = self.values.coloured(emitter, "radiance", Of::Emission, &mut self.ignored)?;
                radiance.unwrap_or(Coloured { factor: [1.0; 3], map: None })
            }
            Some(emitter) => {
                self.ignore(format!("<emitter type=\"{}\">", emitter.kind()));
                Coloured::default()
            }
            None => Coloured::default(),
        };
        let textured = emitter.filter(|_| emission.map.is_some());
        let bits = emission.factor.map(f64::to_bits);
        let key = (bsdf.map(std::ptr::from_ref), bits, textured.map(std::ptr::from_ref));
        if let Some(known) = self.surfaces.get(&key) {
            return Ok(known.clone());
        }
        let shines = emission.factor != [0.0; 3];
        let given = bsdf.and_then(|node| node.attribute("id"));
        let name = match (given, shines) {
            (Some(id), false) => id.to_owned(),
            (Some(id), true) => format!("{id} lamp"),
            (None, _) => shape.attribute("id").unwrap_or(if shines { "lamp" } else { "material" }).to_owned(),
        };
        let Surface { mut material, two_sided, map } = match bsdf {
            Some(bsdf) => bsdf::read(bsdf, &self.values, &mut self.ignored)?,
            None => Surface::grey(),
        };
        material.name = self.free_name(&name);
        material.emission = emission.factor;
        let mut raw = RawMaterial::of_file(material, self.path);
        // Emission leaves the front alone, so that a lamp with two sides needs two materials.
        raw.two_sided = two_sided && !shines;
        raw.maps = Maps { albedo: map, emission: emission.map };
        self.surfaces.insert(key, raw.clone());
        Ok(raw)
    }

    fn sensor(&mut self, node: &'a Element) -> Result<(), SceneError> {
        let kind = node.kind();
        if !matches!(kind, "perspective" | "thinlens") {
            self.ignore(format!("<sensor type=\"{kind}\">"));
            return Ok(());
        }
        if kind == "thinlens" {
            self.ignore("the aperture of <sensor type=\"thinlens\">".to_owned());
        }
        let place = self.place(node)?;
        let film = self.values.object(node, "film");
        let pixels = |name: &str, usual: f64| -> Result<f64, SceneError> {
            Ok(film.map(|film| self.values.number(film, name)).transpose()?.flatten().unwrap_or(usual))
        };
        let (width, height) = (pixels("width", 768.0)?, pixels("height", 576.0)?);
        let axis = self.values.text(node, "fov_axis")?.unwrap_or("x");
        let (fov, axis) = match self.values.number(node, "fov")? {
            Some(fov) => (fov, axis),
            None => {
                let text = self.values.text(node, "focal_length")?.unwrap_or("50mm");
                let length =
                    text.trim().trim_end_matches("mm").trim().parse::<f64>().ok().filter(|mm| *mm > 0.0);
                let length = length
                    .ok_or_else(|| node.wrong(format!("the focal length `{text}` is no length in mm")))?;
                // On a film of 36 mm by 24 mm.
                (2.0 * (36f64.hypot(24.0) / (2.0 * length)).atan().to_degrees(), "diagonal")
            }
        };
        let half = (fov / 2.0).to_radians().tan();
        let along_x = match axis {
            "y" => half * width / height,
            "smaller" if height < width => half * width / height,
            "larger" if height > width => half * width / height,
            "diagonal" => half * width / width.hypot(height),
            _ => half,
        };
        let position = place.transform_point3(DVec3::ZERO);
        let base = node.attribute("id").unwrap_or("sensor");
        let name = free_name(base, |name| self.contents.cameras.iter().all(|c| c.name != name));
        self.contents.cameras.push(Camera {
            name,
            position,
            target: position + place.transform_vector3(DVec3::Z),
            up: place.transform_vector3(DVec3::Y),
            fov_x_degrees: 2.0 * along_x.atan().to_degrees(),
            width: width.clamp(0.0, 1e6) as u32,
            height: height.clamp(0.0, 1e6) as u32,
        });
        Ok(())
    }
}
