//! Binary glTF 2.0.

use antirad_base::output::{OutputError, atomic_write};
use antirad_scene::{AlbedoTexture, Camera, Material, Normalization, Scene, Sun, Wrap, free_name};
use glam::{DMat3, DQuat, DVec2, DVec3};
use serde_json::{Value, json};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::io::{BufWriter, Error, Write};
use std::path::Path;

/// Component types.
const FLOAT: u32 = 5126;
const UNSIGNED: u32 = 5125;
/// A filter of textures: between texels, without smaller copies, in which charts of an atlas would run into each other.
const LINEAR: u32 = 9729;

/// The binary part of a file, with its views and accessors.
#[derive(Default)]
struct Binary {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Binary {
    /// Adds bytes; returns the index of their view.
    fn view(&mut self, bytes: impl IntoIterator<Item = u8>) -> usize {
        // Numbers have four bytes, and must lie at multiples of that.
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let start = self.bytes.len();
        self.bytes.extend(bytes);
        self.views.push(json!({ "buffer": 0, "byteOffset": start, "byteLength": self.bytes.len() - start }));
        self.views.len() - 1
    }

    /// Adds rows of numbers of four bytes each; returns the index of their accessor.
    fn add(&mut self, bytes: impl Iterator<Item = [u8; 4]>, mut accessor: Value) -> usize {
        accessor["bufferView"] = json!(self.view(bytes.flatten()));
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

    fn texture_coordinates(&mut self, rows: &[[f32; 2]]) -> usize {
        let accessor = json!({ "componentType": FLOAT, "count": rows.len(), "type": "VEC2" });
        self.add(rows.as_flattened().iter().map(|x| x.to_le_bytes()), accessor)
    }

    fn indices(&mut self, indices: &[u32]) -> usize {
        let accessor = json!({ "componentType": UNSIGNED, "count": indices.len(), "type": "SCALAR" });
        self.add(indices.iter().map(|x| x.to_le_bytes()), accessor)
    }
}

pub fn write(scene: &Scene, path: &Path, light: Option<&[[f64; 3]]>) -> Result<(), OutputError> {
    let mut binary = Binary::default();
    let looks = Looks::of(scene, light.is_none());
    let mut nodes = Vec::new();
    let mut meshes = Vec::new();
    let mut images = Vec::new();
    for mesh in scene.meshes.iter().filter(|mesh| !mesh.range.is_empty()) {
        nodes.push(json!({ "name": mesh.name, "mesh": meshes.len() }));
        let triangles = mesh.range.start as usize..mesh.range.end as usize;
        meshes.push(
            json!({ "name": mesh.name, "primitives": primitives(scene, triangles, light, &looks, &mut binary) }),
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
    for &(texture, _) in &looks.textures {
        let png = scene.albedo_png(texture).map_err(|reason| OutputError::new(path, Error::other(reason)));
        images.push(json!({ "bufferView": binary.view(png?), "mimeType": "image/png" }));
    }
    binary.bytes.resize(binary.bytes.len().next_multiple_of(4), 0);
    let mut document = json!({
        "asset": { "version": "2.0", "generator": "antirad" },
        "scene": 0,
        "scenes": [{ "name": scene.name, "nodes": (0..nodes.len()).collect::<Vec<_>>() }],
        "nodes": nodes,
        "meshes": meshes,
        "materials": looks.all.iter().map(material).collect::<Vec<_>>(),
        "textures": (0..images.len()).map(|k| json!({ "source": k, "sampler": k })).collect::<Vec<_>>(),
        "images": images,
        "samplers": looks.textures.iter().map(|(_, wrap)| sampler(*wrap)).collect::<Vec<_>>(),
        "cameras": scene.cameras.iter().map(lens).collect::<Vec<_>>(),
        "extensionsUsed": ["KHR_materials_emissive_strength"],
        "buffers": [{ "byteLength": binary.bytes.len() }],
        "bufferViews": binary.views,
        "accessors": binary.accessors,
    });
    // Empty lists are invalid.
    let without_textures: &[&str] =
        if looks.textures.is_empty() { &["textures", "images", "samplers"] } else { &[] };
    let without_cameras: &[&str] = if scene.cameras.is_empty() { &["cameras"] } else { &[] };
    for key in without_textures.iter().chain(without_cameras) {
        document.as_object_mut().map(|object| object.remove(*key));
    }
    if !scene.suns.is_empty() {
        document["extensionsUsed"] = json!(["KHR_materials_emissive_strength", "KHR_lights_punctual"]);
        let lights: Vec<Value> = scene.suns.iter().map(directional).collect();
        document["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights } });
    }
    atomic_write(path, |file| {
        let mut text = serde_json::to_vec(&document)?;
        text.resize(text.len().next_multiple_of(4), b' ');
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

/// A material as it is written.
struct Look {
    material: Material,
    /// Place of the texture of the albedo among those written.
    texture: Option<usize>,
}

/// The materials of a scene, with their textures.
struct Looks {
    all: Vec<Look>,
    /// Of each triangle.
    of: Vec<usize>,
    /// Indices of textures ([`AlbedoTexture::index`]), and how they go on beyond their edges.
    textures: Vec<(u32, [Wrap; 2])>,
}

impl Looks {
    /// All materials; triangles with a texture have others, named after their mesh, which they share if nothing else differs.
    fn of(scene: &Scene, textured: bool) -> Self {
        let all = scene.materials.iter().map(|material| Look { material: material.clone(), texture: None });
        let of = scene.triangles.iter().map(|triangle| triangle.material as usize).collect();
        let mut looks = Self { all: all.collect(), of, textures: Vec::new() };
        if !textured {
            return looks;
        }
        let mut names: HashSet<String> =
            scene.materials.iter().map(|material| material.name.clone()).collect();
        let mut known: HashMap<Vec<u64>, usize> = HashMap::new();
        for mesh in &scene.meshes {
            for t in mesh.range.start as usize..mesh.range.end as usize {
                let Some(AlbedoTexture { index, wrap, factor, .. }) = scene.albedo_texture(t) else {
                    continue;
                };
                // To single precision, in which the texture is: factors of one file differ by rounding.
                let albedo = factor.map(|x| f64::from(x as f32));
                let number =
                    looks.textures.iter().position(|known| *known == (index, wrap)).unwrap_or_else(|| {
                        looks.textures.push((index, wrap));
                        looks.textures.len() - 1
                    });
                let material = Material { albedo, ..scene.material(t).clone() };
                looks.of[t] = *known.entry(key(number, &material)).or_insert_with(|| {
                    let name = free_name(&mesh.name, |name| names.insert(name.to_owned()));
                    looks.all.push(Look { material: Material { name, ..material }, texture: Some(number) });
                    looks.all.len() - 1
                });
            }
        }
        if known.is_empty() {
            return looks;
        }
        let mut used = looks.of.clone();
        used.sort_unstable();
        used.dedup();
        looks.of.iter_mut().for_each(|look| *look = used.binary_search(look).unwrap_or_default());
        let all = looks.all.into_iter().enumerate().filter(|(look, _)| used.binary_search(look).is_ok());
        looks.all = all.map(|(_, look)| look).collect();
        looks
    }
}

/// What tells materials with a texture apart.
fn key(texture: usize, material: &Material) -> Vec<u64> {
    let Material { diffuse, albedo, specular, power, emission, normalization, .. } = material;
    let numbers = [*diffuse, *power].into_iter().chain(*albedo).chain(*specular).chain(*emission);
    let kind = u64::from(*normalization == Normalization::Energy);
    [texture as u64, kind].into_iter().chain(numbers.map(f64::to_bits)).collect()
}

/// One for each material of a mesh, over shared vertices; with light, whose colours change from face to face, over vertices of each
/// face's own.
fn primitives(
    scene: &Scene,
    triangles: std::ops::Range<usize>,
    light: Option<&[[f64; 3]]>,
    looks: &Looks,
    binary: &mut Binary,
) -> Vec<Value> {
    let single = |v: DVec3| v.to_array().map(|x| x as f32);
    let mut by_look: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
    for t in triangles.clone() {
        by_look.entry(looks.of[t]).or_default().push(t);
    }
    if let Some(light) = light {
        let each = by_look.into_iter().map(|(look, triangles)| {
            let corners: Vec<[f32; 3]> = triangles.iter().flat_map(|&t| scene.corners(t)).map(single).collect();
            let colours: Vec<[f32; 3]> = triangles.iter().flat_map(|&t| [light[t].map(|x| x as f32); 3]).collect();
            let attributes =
                json!({ "POSITION": binary.vectors(&corners, true), "COLOR_0": binary.vectors(&colours, false) });
            json!({ "attributes": attributes, "material": look })
        });
        return each.collect();
    }
    let plain = |t: &usize| looks.all[looks.of[*t]].texture.is_none();
    let mut used: Vec<u32> = triangles.filter(plain).flat_map(|t| scene.triangles[t].vertices).collect();
    used.sort_unstable();
    used.dedup();
    let shared: Vec<[f32; 3]> = used.iter().map(|&v| single(scene.vertices[v as usize])).collect();
    let shared = (!shared.is_empty()).then(|| binary.vectors(&shared, true));
    let number = |v: u32| used.binary_search(&v).unwrap_or(0) as u32;
    let each = by_look.into_iter().map(|(look, triangles)| {
        let (attributes, indices) = match shared {
            Some(shared) if looks.all[look].texture.is_none() => {
                let corners = triangles.iter().flat_map(|&t| scene.triangles[t].vertices);
                (json!({ "POSITION": shared }), corners.map(number).collect())
            }
            _ => mapped(scene, &triangles, binary),
        };
        json!({ "attributes": attributes, "indices": binary.indices(&indices), "material": look })
    });
    each.collect()
}

/// Attributes and indices of triangles with texture coordinates; corners that share them are one.
fn mapped(scene: &Scene, triangles: &[usize], binary: &mut Binary) -> (Value, Vec<u32>) {
    let (mut positions, mut coordinates, mut indices) = (Vec::new(), Vec::new(), Vec::new());
    let mut known: HashMap<(u32, [u32; 2]), u32> = HashMap::new();
    for &t in triangles {
        let uvs = scene.albedo_texture(t).map_or([DVec2::ZERO; 3], |texture| texture.uvs);
        for (v, uv) in scene.triangles[t].vertices.into_iter().zip(uvs) {
            let uv = uv.to_array().map(|x| x as f32);
            indices.push(*known.entry((v, uv.map(f32::to_bits))).or_insert_with(|| {
                positions.push(scene.vertices[v as usize].to_array().map(|x| x as f32));
                coordinates.push(uv);
                positions.len() as u32 - 1
            }));
        }
    }
    let attributes = json!({
        "POSITION": binary.vectors(&positions, true),
        "TEXCOORD_0": binary.texture_coordinates(&coordinates),
    });
    (attributes, indices)
}

fn sampler(wrap: [Wrap; 2]) -> Value {
    let [s, t] = wrap.map(|wrap| match wrap {
        Wrap::Repeat => 10497,
        Wrap::Clamp => 33071,
        Wrap::Mirror => 33648,
    });
    json!({ "magFilter": LINEAR, "minFilter": LINEAR, "wrapS": s, "wrapT": t })
}

/// The inverse of what the reader makes of a material, as far as glTF goes, and all of it in `extras`.
fn material(Look { material, texture }: &Look) -> Value {
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
    if let Some(texture) = texture {
        value["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": texture });
    }
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
