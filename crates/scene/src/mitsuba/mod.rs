//! Reads a subset of the scenes of Mitsuba 3 (`.xml`): shapes, diffuse and glossy BSDFs, area, constant and
//! environment emitters, perspective sensors.
//!
//! What cannot be represented is named in one warning; what stands in for it is said in docs/scenes.md.

mod bsdf;
mod spectrum;
mod transform;
mod values;

use std::collections::{HashMap, HashSet};
use std::f64::consts::PI;
use std::path::Path;

use glam::{DMat4, DVec3};
use roxmltree::{Document, Node};

use self::spectrum::Of;
use self::values::Values;
use super::error::{Place, SceneError};
use super::geometry::{RawMaterial, RawMesh};
use super::material::Material;
use super::mesh_file::Contents;
use super::{Camera, Shape, Sky, obj, ply};

/// Most bytes of a file.
const MOST_BYTES: u64 = 1 << 28;
/// Squares along a side of rectangles and cubes, whose indirect light is one value for each triangle.
const CELLS: u32 = 8;
/// Subdivisions of an icosahedron that stands for a sphere: 1280 triangles.
const SPHERE: u32 = 3;
/// Subdivisions of an icosahedron that stands for a sphere that shines: few faces, so that its light can be
/// exact.
const LAMP: u32 = 0;
/// Corners of a disk.
const DISK: u32 = 32;

/// Reads a file. `warnings` takes what is left out or represented otherwise.
pub(super) fn read(path: &Path, strict: bool, warnings: &mut Vec<String>) -> Result<Contents, SceneError> {
    let bytes = antirad_base::input::read_at_most(path, MOST_BYTES)
        .map_err(|reason| SceneError::Read { path: path.to_path_buf(), reason })?;
    let text = String::from_utf8(bytes).map_err(|_| SceneError::File {
        path: path.to_path_buf(),
        message: String::from("is not in UTF-8"),
    })?;
    let document = Document::parse(&text).map_err(|error| {
        let line = error.pos().row as usize;
        Place { path, line }.error(format!("is no XML: {error}"))
    })?;
    let root = document.root_element();
    let values = Values::new(path, root)?;
    if !root.has_tag_name("scene") {
        return Err(values.wrong(root, format!("expected <scene>, not <{}>", root.tag_name().name())));
    }
    let named = root.descendants().filter(|node| !node.has_tag_name("ref"));
    let by_id = named.filter_map(|node| Some((node.attribute("id")?, node))).collect();
    let mut reader = Reader {
        path,
        strict,
        values,
        by_id,
        contents: Contents::default(),
        materials: HashMap::new(),
        names: HashSet::new(),
        ignored: Vec::new(),
    };
    for node in root.children().filter(Node::is_element) {
        match node.tag_name().name() {
            "shape" => reader.shape(node, warnings)?,
            "sensor" => reader.sensor(node)?,
            "emitter" => reader.emitter(node)?,
            "bsdf" | "texture" | "default" | "integrator" | "path" => {}
            name => reader.ignore(format!("<{name} type=\"{}\">", node.attribute("type").unwrap_or(""))),
        }
    }
    if !reader.ignored.is_empty() {
        warnings.push(format!("{}: ignored or approximated: {}.", path.display(), reader.ignored.join(", ")));
    }
    Ok(reader.contents)
}

struct Reader<'a, 'i> {
    path: &'a Path,
    strict: bool,
    values: Values<'a>,
    by_id: HashMap<&'a str, Node<'a, 'i>>,
    contents: Contents,
    /// Material and whether it has two sides, by the node of the BSDF and the emission.
    materials: HashMap<String, (Material, bool)>,
    names: HashSet<String>,
    ignored: Vec<String>,
}

impl<'a, 'i> Reader<'a, 'i> {
    fn ignore(&mut self, what: String) {
        if !self.ignored.contains(&what) {
            self.ignored.push(what);
        }
    }

    /// A child of a kind, in place or referred to.
    fn child(&self, node: Node<'a, 'i>, kind: &str) -> Option<Node<'a, 'i>> {
        let resolve = |child: Node<'a, 'i>| match child.has_tag_name("ref") {
            true => child.attribute("id").and_then(|id| self.by_id.get(id)).copied(),
            false => Some(child),
        };
        node.children().filter(Node::is_element).filter_map(resolve).find(|child| child.has_tag_name(kind))
    }

    fn shape(&mut self, node: Node<'a, 'i>, warnings: &mut Vec<String>) -> Result<(), SceneError> {
        let kind = node.attribute("type").unwrap_or_default();
        let place = self.place(node)?;
        let flipped = self.values.flag(node, "flip_normals")?;
        let (material, two_sided) = self.material(node)?;
        let shines = material.emission != [0.0; 3];
        let uniform = |(vertices, faces): (Vec<DVec3>, Vec<[u32; 3]>)| RawMesh::uniform(vertices, faces, "");
        let mut mesh = match kind {
            "obj" | "ply" => self.file(node, warnings)?,
            "rectangle" => {
                // From the unit square at y = 0 that faces +y.
                let (vertices, faces) = Shape::Quad { cells: CELLS }.mesh();
                let turned = |v: DVec3| DVec3::new(2.0 * v.x - 1.0, 1.0 - 2.0 * v.z, 0.0);
                uniform((vertices.into_iter().map(turned).collect(), faces))
            }
            "cube" => {
                let (vertices, faces) = Shape::Box { cells: CELLS }.mesh();
                uniform((vertices.into_iter().map(|v| 2.0 * v - 1.0).collect(), faces))
            }
            "sphere" => {
                // From inside, such as a dome, it is better round.
                let level = if shines && !flipped { LAMP } else { SPHERE };
                let (vertices, faces) = Shape::Icosphere { level, inward: false }.mesh();
                let mut radius = self.values.number(node, "radius")?.unwrap_or(1.0);
                if shines {
                    // The same area, hence power.
                    let double_area = |face: &[u32; 3]| {
                        let [a, b, c] = face.map(|v| vertices[v as usize]);
                        (b - a).cross(c - a).length()
                    };
                    radius *= (8.0 * PI / faces.iter().map(double_area).sum::<f64>()).sqrt();
                }
                let centre = self.values.point(node, "center")?.unwrap_or(DVec3::ZERO);
                uniform((vertices.into_iter().map(|v| centre + radius * v).collect(), faces))
            }
            "disk" => {
                let corner = |k: u32| {
                    let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / f64::from(DISK)).sin_cos();
                    DVec3::new(cos, sin, 0.0)
                };
                let vertices = (0..DISK).map(corner).chain([DVec3::ZERO]).collect();
                uniform((vertices, (0..DISK).map(|k| [k, (k + 1) % DISK, DISK]).collect()))
            }
            other => {
                self.ignore(format!("<shape type=\"{other}\">"));
                return Ok(());
            }
        };
        mesh.vertices.iter_mut().for_each(|v| *v = place.transform_point3(*v));
        if (place.determinant() < 0.0) != flipped {
            mesh.turn();
        }
        let name = node.attribute("id").unwrap_or(kind).to_owned();
        mesh.material_names = vec![material.name.clone()];
        mesh.face_materials = vec![0; mesh.faces.len()];
        // Emission leaves the front alone, so that a lamp with two sides needs two materials.
        let mut front = RawMaterial::of_file(material, self.path);
        front.two_sided = two_sided && !shines;
        mesh.materials = vec![front];
        self.contents.meshes.push((name, mesh));
        Ok(())
    }

    /// An emitter that is no shape.
    fn emitter(&mut self, node: Node<'a, 'i>) -> Result<(), SceneError> {
        let kind = node.attribute("type").unwrap_or_default();
        let sky = match kind {
            "constant" => {
                let radiance = self.values.colour(node, "radiance", Of::Emission, &mut self.ignored)?;
                let sky = Sky::uniform(radiance.unwrap_or([1.0; 3]));
                sky.check().map(|()| sky).map_err(|message| self.values.wrong(node, message))?
            }
            "envmap" => {
                let Some(name) = self.values.text(node, "filename")? else {
                    return Err(self.values.wrong(node, "has no <string name=\"filename\">".to_owned()));
                };
                if self.place(node)? != DMat4::IDENTITY {
                    self.ignore("the to_world of <emitter type=\"envmap\">".to_owned());
                }
                let scale = self.values.number(node, "scale")?.unwrap_or(1.0);
                let file = self.values.beside(&name);
                Sky::read(&file, [scale; 3])
                    .map_err(|message| self.values.wrong(node, format!("{} {message}", file.display())))?
            }
            _ => {
                self.ignore(format!("<emitter type=\"{kind}\">"));
                return Ok(());
            }
        };
        if self.contents.sky.replace(sky).is_some() {
            self.ignore("all emitters from afar but the last".to_owned());
        }
        Ok(())
    }

    fn place(&self, node: Node<'a, 'i>) -> Result<DMat4, SceneError> {
        let named =
            |child: &Node| child.has_tag_name("transform") && child.attribute("name") == Some("to_world");
        match node.children().find(named) {
            Some(transform) => transform::read(transform, &self.values),
            None => Ok(DMat4::IDENTITY),
        }
    }

    /// The geometry of an OBJ or PLY.
    fn file(&self, node: Node<'a, 'i>, warnings: &mut Vec<String>) -> Result<RawMesh, SceneError> {
        let Some(name) = self.values.text(node, "filename")? else {
            return Err(self.values.wrong(node, "has no <string name=\"filename\">".to_owned()));
        };
        let file = self.values.beside(&name);
        // Its own materials and colours do not count, and neither do notes about them.
        let mut unheard = Vec::new();
        let read = match node.attribute("type") {
            Some("obj") => obj::read(&file, self.strict, |_| true, &mut unheard),
            _ => ply::read(&file, "", false, &mut unheard),
        };
        let mesh = match read {
            Ok(mesh) => mesh,
            Err(SceneError::Read { path, reason }) => {
                return Err(self.values.wrong(node, format!("{} cannot be read: {reason}", path.display())));
            }
            Err(other) => return Err(other),
        };
        warnings.extend(unheard.into_iter().filter(|note| note.contains("statements unknown")));
        let RawMesh { vertices, faces, face_lines, .. } = mesh;
        Ok(RawMesh { face_lines, ..RawMesh::uniform(vertices, faces, "") })
    }

    /// The material of a shape, and whether it has two sides.
    fn material(&mut self, shape: Node<'a, 'i>) -> Result<(Material, bool), SceneError> {
        let bsdf = self.child(shape, "bsdf");
        let emission = match self.child(shape, "emitter") {
            Some(emitter) if emitter.attribute("type") == Some("area") => {
                self.values.colour(emitter, "radiance", Of::Emission, &mut self.ignored)?.unwrap_or([1.0; 3])
            }
            Some(emitter) => {
                self.ignore(format!("<emitter type=\"{}\">", emitter.attribute("type").unwrap_or("")));
                [0.0; 3]
            }
            None => [0.0; 3],
        };
        let key = format!("{:?} {emission:?}", bsdf.map(|node| node.id()));
        if let Some(known) = self.materials.get(&key) {
            return Ok(known.clone());
        }
        let given = bsdf.and_then(|node| node.attribute("id"));
        let base = match (given, emission == [0.0; 3]) {
            (Some(id), true) => id.to_owned(),
            (Some(id), false) => format!("{id} lamp"),
            (None, true) => shape.attribute("id").map_or(String::from("material"), str::to_owned),
            (None, false) => shape.attribute("id").map_or(String::from("lamp"), str::to_owned),
        };
        let mut names = std::iter::once(base.clone()).chain((2..).map(|n| format!("{base}_{n}")));
        let name = names.find(|name| self.names.insert(name.clone())).unwrap_or(base);
        let (mut material, two_sided) = match bsdf {
            Some(bsdf) => {
                let by_id = &self.by_id;
                bsdf::read(bsdf, by_id, &self.values, &mut self.ignored)?
            }
            // The default is grey.
            None => (Material { albedo: [0.5; 3], ..Material::named("") }, false),
        };
        material.name = name;
        material.emission = emission;
        self.materials.insert(key, (material.clone(), two_sided));
        Ok((material, two_sided))
    }

    fn sensor(&mut self, node: Node<'a, 'i>) -> Result<(), SceneError> {
        let kind = node.attribute("type").unwrap_or_default();
        if !matches!(kind, "perspective" | "thinlens") {
            self.ignore(format!("<sensor type=\"{kind}\">"));
            return Ok(());
        }
        if kind == "thinlens" {
            self.ignore("the aperture of <sensor type=\"thinlens\">".to_owned());
        }
        let place = self.place(node)?;
        let film = self.child(node, "film");
        let pixels = |name: &str, usual: f64| -> Result<f64, SceneError> {
            Ok(film.map(|film| self.values.number(film, name)).transpose()?.flatten().unwrap_or(usual))
        };
        let (width, height) = (pixels("width", 768.0)?, pixels("height", 576.0)?);
        let fov = self.values.number(node, "fov")?.unwrap_or(50.0);
        let axis = self.values.text(node, "fov_axis")?.unwrap_or_else(|| "x".to_owned());
        let half = (fov / 2.0).to_radians().tan();
        let along_x = match axis.as_str() {
            "y" => half * width / height,
            "smaller" if height < width => half * width / height,
            "larger" if height > width => half * width / height,
            "diagonal" => half * width / width.hypot(height),
            _ => half,
        };
        let position = place.transform_point3(DVec3::ZERO);
        let base = node.attribute("id").unwrap_or("sensor").to_owned();
        let taken = |name: &str| self.contents.cameras.iter().any(|c| c.name == *name);
        let mut names = std::iter::once(base.clone()).chain((2..).map(|n| format!("{base}_{n}")));
        let name = names.find(|name| !taken(name)).unwrap_or(base);
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
