//! Reads PLY files, ASCII and binary, with the crate `ply-rs-bw`.
//!
//! Colours, of faces or of vertices, are the albedo (sRGB in bytes, linear in floating point); without colours a mesh is grey.

use std::io::{BufReader, Read};
use std::path::Path;

use glam::{DVec2, DVec3};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{Property, PropertyAccess, PropertyAccessResult};

use super::error::SceneError;
use super::geometry::{RawMaterial, RawMesh};
use super::material::Material;
use super::texture::linear_from_srgb;
use super::triangulate::triangulate;

/// Names of the list of a face's corners.
const CORNERS: [&str; 2] = ["vertex_indices", "vertex_index"];

/// A vertex, a face, or an element that does not matter.
#[derive(Default)]
struct Element {
    position: [Option<f64>; 3],
    colour: [Option<f64>; 3],
    coordinates: [Option<f64>; 2],
    corners: Vec<i64>,
}

impl Element {
    fn scalar(&mut self, name: &str, value: f64, colour: f64) -> PropertyAccessResult {
        match name {
            "x" => self.position[0] = Some(value),
            "y" => self.position[1] = Some(value),
            "z" => self.position[2] = Some(value),
            "red" | "r" | "diffuse_red" => self.colour[0] = Some(colour),
            "green" | "g" | "diffuse_green" => self.colour[1] = Some(colour),
            "blue" | "b" | "diffuse_blue" => self.colour[2] = Some(colour),
            "u" | "s" | "texture_u" => self.coordinates[0] = Some(value),
            "v" | "t" | "texture_v" => self.coordinates[1] = Some(value),
            _ => return PropertyAccessResult::Ignored,
        }
        PropertyAccessResult::Set
    }

    /// Texture coordinates, or NaN.
    fn uv(&self) -> DVec2 {
        let [u, v] = self.coordinates.map(|coordinate| coordinate.unwrap_or(f64::NAN));
        DVec2::new(u, v)
    }

    fn albedo(&self) -> Option<DVec3> {
        match self.colour {
            [Some(r), Some(g), Some(b)] => Some(DVec3::new(r, g, b)),
            _ => None,
        }
    }
}

impl PropertyAccess for Element {
    fn new() -> Self {
        Self::default()
    }

    fn set_property(&mut self, name: &str, property: Property) -> PropertyAccessResult {
        let whole = |value: f64, most: f64| (value, linear_from_srgb((value / most).clamp(0.0, 1.0)));
        let (value, colour) = match property {
            Property::Char(x) => whole(x.into(), 127.0),
            Property::UChar(x) => whole(x.into(), 255.0),
            Property::Short(x) => whole(x.into(), 32767.0),
            Property::UShort(x) => whole(x.into(), 65535.0),
            Property::Int(x) => whole(x.into(), 255.0),
            Property::UInt(x) => whole(x.into(), 255.0),
            Property::Float(x) => (x.into(), x.into()),
            Property::Double(x) => (x, x),
            list if CORNERS.contains(&name) => {
                self.corners = match list {
                    Property::ListChar(v) => v.into_iter().map(i64::from).collect(),
                    Property::ListUChar(v) => v.into_iter().map(i64::from).collect(),
                    Property::ListShort(v) => v.into_iter().map(i64::from).collect(),
                    Property::ListUShort(v) => v.into_iter().map(i64::from).collect(),
                    Property::ListInt(v) => v.into_iter().map(i64::from).collect(),
                    Property::ListUInt(v) => v.into_iter().map(i64::from).collect(),
                    _ => return PropertyAccessResult::UnsupportedType,
                };
                return PropertyAccessResult::Set;
            }
            _ => return PropertyAccessResult::Ignored,
        };
        self.scalar(name, value, colour)
    }
}

/// Reads a mesh of one material, named `material`.
pub(super) fn read(
    path: &Path,
    material: &str,
    defined_elsewhere: bool,
    warnings: &mut Vec<String>,
) -> Result<RawMesh, SceneError> {
    let invalid = |message: String| SceneError::File { path: path.to_path_buf(), message };
    let file = antirad_base::input::open(path)
        .map_err(|reason| SceneError::Read { path: path.to_path_buf(), reason })?;
    let bytes = file.metadata().map_or(0, |file| file.len());
    // The parser trusts the header's counts no further than the file is long.
    let mut input = BufReader::new(file.take(bytes));
    let mut ply = Parser::<Element>::new().read_ply(&mut input).map_err(|error| {
        let message = error.to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        invalid(match error.line() {
            Some(line) => format!("line {line}: {message}"),
            None => message,
        })
    })?;
    let vertices = ply.payload.shift_remove("vertex").unwrap_or_default();
    let faces = ply.payload.shift_remove("face").unwrap_or_default();
    if faces.is_empty() && ply.payload.contains_key("tristrips") {
        return Err(invalid(String::from("it has triangle strips, which are not read; save it with faces")));
    }
    let position = |(number, vertex): (usize, &Element)| match vertex.position {
        [Some(x), Some(y), Some(z)] => Ok(DVec3::new(x, y, z)),
        _ => Err(invalid(format!("vertex {number} has no x, y and z"))),
    };
    let positions: Vec<DVec3> = vertices.iter().enumerate().map(position).collect::<Result<_, _>>()?;
    let of_vertices: Option<Vec<DVec3>> = vertices.iter().map(Element::albedo).collect();
    let mapped = vertices.iter().any(|vertex| vertex.uv().is_finite());
    let mut mesh = RawMesh::uniform(positions, Vec::new(), material);
    for (number, face) in faces.iter().enumerate() {
        let mut corners = Vec::with_capacity(face.corners.len());
        for &corner in &face.corners {
            let index = u32::try_from(corner).ok().filter(|&index| (index as usize) < mesh.vertices.len());
            corners.push(index.ok_or_else(|| {
                invalid(format!(
                    "face {number} has vertex {corner}, but there are {} vertices, from 0",
                    mesh.vertices.len()
                ))
            })?);
        }
        if corners.len() < 3 {
            return Err(invalid(format!(
                "face {number} has {} corner(s); it needs at least 3",
                corners.len()
            )));
        }
        let places: Vec<DVec3> = corners.iter().map(|&corner| mesh.vertices[corner as usize]).collect();
        for triangle in triangulate(&places) {
            let triangle = triangle.map(|at| corners[at]);
            mesh.faces.push(triangle);
            mesh.face_materials.push(0);
            if mapped {
                mesh.uvs.push(triangle.map(|corner| vertices[corner as usize].uv()));
            }
            match (face.albedo(), &of_vertices) {
                (Some(albedo), _) => mesh.colours.push([albedo; 3]),
                (None, Some(of)) => mesh.colours.push(triangle.map(|corner| of[corner as usize])),
                (None, None) => {}
            }
        }
    }
    if mesh.colours.len() != mesh.faces.len() {
        mesh.colours.clear();
    }
    let albedo = if mesh.colours.is_empty() { 0.5 } else { 1.0 };
    if mesh.colours.is_empty() && !defined_elsewhere {
        warnings.push(format!("{}: no colours; the mesh is grey, albedo 0.5.", path.display()));
    }
    let material = Material { albedo: [albedo; 3], ..Material::named(material) };
    mesh.materials.push(RawMaterial::of_file(material, path));
    Ok(mesh)
}
