//! Binary glTF 2.0.

use antirad_base::output::{OutputError, atomic_write};
use antirad_scene::{Camera, Material, Normalization, Scene, Sun};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::io::{BufWriter, Error, Write};
use std::path::Path;

/// Component types, targets of views.
const FLOAT: u32 = 5126;
const UNSIGNED: u32 = 5125;

/// The binary part of a file, with its views and accessors.
#[derive(Default)]
struct Binary {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Binary {
    /// Adds rows of numbers of four bytes each; returns the index of their accessor.
    fn add(&mut self, bytes: impl Iterator<Item = [u8; 4]>, mut accessor: Value) -> usize {
        let start = self.bytes.len();
        bytes.for_each(|number| self.bytes.extend(number));
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start }));
        accessor["bufferView"] = json!(self.views.len() - 1);
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn vectors(&mut self, rows: &[[f32; 3]], bounded: bool) -> usize {
        let mut accessor = json!({ "componentType": FLOAT, "count": rows.len(), "type": "VEC3" });
        if bounded {
            let axis = |k: usize| rows.iter().map(move |row| row[k]);
            accessor["min"] = json!([0, 1, 2].map(|k| axis(k).fold(f32::INFINITY, f32::min)));
            accessor["max"] = json!([0, 1, 2].map(|k| axis(k).fold(f32::NEG_INFINITY, f32::max)));
        }
        self.add(rows.as_flattened().iter().map(|x| x.to_le_bytes()), accessor)
    }

    fn indices(&mut self, indices: &[u32]) -> usize {
        let accessor = json!({ "componentType": UNSIGNED, "count": indices.len(), "type": "SCALAR" });
        self.add(indices.iter().map(|x| x.to_le_bytes()), accessor)
    }
}

pub fn write(scene: &Scene, path: &Path, light: Option<&[[f64; 3]]>) -> Result<(), OutputError> {
    let mut binary = Binary::default();
    let mut nodes = Vec::new();
    let mut meshes = Vec::new();
    for mesh in scene.meshes.iter().filter(|mesh| !mesh.range.is_empty()) {
        nodes.push(json!({ "name": mesh.name, "mesh": meshes.len() }));
        let triangles = mesh.range.start as usize..mesh.range.end as usize;
        meshes.push(
            json!({ "name": mesh.name, "primitives": primitives(scene, triangles, light, &mut binary) }),
        );
    }
    for (index, camera) in scene.cameras.iter().enumerate() {
        nodes.push(json!({ "name": camera.name, "camera": index, "matrix": place(camera) }));
    }
    for (index, sun) in scene.suns.iter().enumerate() {
        nodes.push(json!({
            "name": "sun",
            "rotation": DQuat::from_rotation_arc(DVec3::NEG_Z, sun.travels()).to_array(),
            "extensions": { "KHR_lights_punctual": { "light": index } },
        }));
    }
    let mut document = json!({
        "asset": { "version": "2.0", "generator": "antirad" },
        "scene": 0,
        "scenes": [{ "name": scene.name, "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": scene.materials.iter().map(material).collect::<Vec<_>>(),
        "cameras": scene.cameras.iter().map(lens).collect::<Vec<_>>(),
        "extensionsUsed": ["KHR_materials_emissive_strength"],
        "buffers": [{ "byteLength": binary.bytes.len() }],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
    });
    // Empty lists are invalid.
    if scene.cameras.is_empty() {
        document.as_object_mut().map(|object| object.remove("cameras"));
    }
    if !scene.suns.is_empty() {
        document["extensionsUsed"] = json!(["KHR_materials_emissive_strength", "KHR_lights_punctual"]);
        let lights: Vec<Value> = scene.suns.iter().map(directional).collect();
        document["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights } });
    }
    atomic_write(path, |file| {
        let mut text = serde_json::to_vec(&document)?;
        text.resize(text.len().next_multiple_of(4), b' ');
        // Numbers have four bytes, so that the binary part needs no padding.
        let length = |bytes: usize| {
            u32::try_from(bytes).map_err(|_| Error::other("more than 4 GiB, which glTF cannot hold"))
        };
        let mut file = BufWriter::new(file);
        file.write_all(b"glTF\x02\0\0\0")?;
        file.write_all(&length(12 + 8 + text.len() + 8 + binary.bytes.len())?.to_le_bytes())?;
        file.write_all(&length(text.len())?.to_le_bytes())?;
        file.write_all(b"JSON")?;
        file.write_all(&text)?;
        file.write_all(&length(binary.bytes.len())?.to_le_bytes())?;
        file.write_all(b"BIN\0")?;
        file.write_all(&binary.bytes)?;
        file.flush()
    })
}

/// One for each material of a mesh, over shared vertices; with light, whose colours change from face to face, over vertices of each
/// face's own.
fn primitives(
    scene: &Scene,
    triangles: std::ops::Range<usize>,
    light: Option<&[[f64; 3]]>,
    binary: &mut Binary,
) -> Vec<Value> {
    let single = |v: DVec3| v.to_array().map(|x| x as f32);
    let mut by_material: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for t in triangles.clone() {
        by_material.entry(scene.triangles[t].material).or_default().push(t);
    }
    if let Some(light) = light {
        let each = by_material.into_iter().map(|(material, triangles)| {
            let corners: Vec<[f32; 3]> = triangles.iter().flat_map(|&t| scene.corners(t)).map(single).collect();
            let colours: Vec<[f32; 3]> = triangles.iter().flat_map(|&t| [light[t].map(|x| x as f32); 3]).collect();
            let attributes =
                json!({ "POSITION": binary.vectors(&corners, true), "COLOR_0": binary.vectors(&colours, false) });
            json!({ "attributes": attributes, "material": material })
        });
        return each.collect();
    }
    let mut used: Vec<u32> = triangles.flat_map(|t| scene.triangles[t].vertices).collect();
    used.sort_unstable();
    used.dedup();
    let positions: Vec<[f32; 3]> = used.iter().map(|&v| single(scene.vertices[v as usize])).collect();
    let positions = binary.vectors(&positions, true);
    let number = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
    let each = by_material.into_iter().map(|(material, triangles)| {
        let indices: Vec<u32> = triangles.iter().flat_map(|&t| scene.triangles[t].vertices).map(number).collect();
        json!({ "attributes": { "POSITION": positions }, "indices": binary.indices(&indices), "material": material })
    });
    each.collect()
}

/// The inverse of what the reader makes of a material, as far as glTF goes, and all of it in `extras`.
fn material(material: &Material) -> Value {
    let metal = material.is_glossy() && material.diffuse_albedo() == [0.0; 3];
    let [r, g, b] = if metal { material.specular } else { material.diffuse_albedo() };
    let rough = if material.is_glossy() { (2.0 / (material.power + 2.0)).powf(0.25) } else { 1.0 };
    let strength = material.emission.into_iter().fold(0.0, f64::max);
    let factor = if strength > 0.0 { material.emission.map(|e| e / strength) } else { [0.0; 3] };
    let mut value = json!({
        "name": material.name,
        "pbrMetallicRoughness": {
            "baseColorFactor": [r.min(1.0), g.min(1.0), b.min(1.0), 1.0],
            "metallicFactor": if metal { 1.0 } else { 0.0 },
            "roughnessFactor": rough,
        },
        "emissiveFactor": factor,
        "extras": { "antirad": {
            "diffuse": material.diffuse,
            "albedo": material.albedo,
            "specular": material.specular,
            "power": material.power,
            "emission": material.emission,
            "normalization": match material.normalization {
                Normalization::Phong => "phong",
                Normalization::Energy => "energy",
            },
        } },
    });
    if strength > 0.0 {
        value["extensions"] = json!({ "KHR_materials_emissive_strength": { "emissiveStrength": strength } });
    }
    value
}

/// The matrix from the camera's axes, with the view along -z, to the scene's, column by column.
fn place(camera: &Camera) -> [f64; 16] {
    let ahead = (camera.target - camera.position).normalize_or(DVec3::NEG_Z);
    let right = ahead.cross(camera.up).normalize_or(DVec3::X);
    let axes = DMat3::from_cols(right, right.cross(ahead), -ahead);
    glam::DMat4::from_cols(
        axes.x_axis.extend(0.0),
        axes.y_axis.extend(0.0),
        axes.z_axis.extend(0.0),
        camera.position.extend(1.0),
    )
    .to_cols_array()
}

fn directional(sun: &Sun) -> Value {
    let intensity = sun.irradiance.into_iter().fold(0.0, f64::max);
    let colour = if intensity > 0.0 { sun.irradiance.map(|h| h / intensity) } else { [1.0; 3] };
    json!({
        "type": "directional",
        "color": colour,
        "intensity": intensity,
        "extras": { "antirad": { "angular_diameter": sun.angular_diameter } },
    })
}

fn lens(camera: &Camera) -> Value {
    let aspect = f64::from(camera.width) / f64::from(camera.height.max(1));
    let half = (camera.fov_x_degrees / 2.0).to_radians().tan() / aspect;
    json!({
        "name": camera.name,
        "type": "perspective",
        "perspective": { "yfov": 2.0 * half.atan(), "aspectRatio": aspect, "znear": 1e-3 },
        "extras": { "antirad": { "width": camera.width, "height": camera.height } },
    })
}
