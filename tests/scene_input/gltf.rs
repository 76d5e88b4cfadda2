//! glTF files.

use antirad::scene::{Normalization, Scene};
use glam::DVec3;
use serde_json::{Value, json};
use std::f64::consts::PI;

use super::{Folder, assert_says};

/// The corners of a unit square at z = 0 that faces +z, as f32, and six indices, as u16.
pub fn square() -> Vec<u8> {
    let corners = [[0.0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let mut bytes: Vec<u8> = corners.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|x| x.to_le_bytes()));
    bytes
}

/// A square with a material, seen twice, with a camera and a light.
pub fn document() -> Value {
    json!({
        "asset": { "version": "2.0" },
        "scene": 0,
        "scenes": [{ "nodes": [0, 3, 4] }],
        "nodes": [
            { "name": "pair", "children": [1, 2], "translation": [0, 0, 2] },
            { "name": "left", "mesh": 0, "scale": [2, 2, 2] },
            { "name": "mirrored", "mesh": 0, "scale": [-1, 1, 1], "translation": [-1, 0, 0] },
            { "name": "eye", "camera": 0, "translation": [0, 0, 9] },
            { "name": "bulb", "translation": [0, 3, 3], "extensions": { "KHR_lights_punctual": { "light": 0 } } },
        ],
        "meshes": [{ "name": "square", "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1, "material": 0 }] }],
        "materials": [{
            "name": "red",
            "pbrMetallicRoughness": { "baseColorFactor": [0.5, 0.25, 0.125, 1], "metallicFactor": 0, "roughnessFactor": 0.5 },
            "emissiveFactor": [1, 0.5, 0],
            "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 8 } },
        }],
        "cameras": [{ "type": "perspective", "perspective": { "yfov": 1.0, "aspectRatio": 2.0, "znear": 0.1 } }],
        "extensionsUsed": ["KHR_lights_punctual", "KHR_materials_emissive_strength"],
        "extensions": { "KHR_lights_punctual": { "lights": [{ "type": "point", "color": [1, 0.5, 0.25], "intensity": 40 }] } },
        "accessors": [
            { "bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0] },
            { "bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR" },
        ],
        "bufferViews": [
            { "buffer": 0, "byteOffset": 0, "byteLength": 48 },
            { "buffer": 0, "byteOffset": 48, "byteLength": 12 },
        ],
        "buffers": [{ "byteLength": 60, "uri": "a%20square.bin" }],
    })
}

/// The square with more bytes in a buffer of their own, view 2.
pub fn with_data(bytes: &[u8]) -> Value {
    let mut document = document();
    let mut push = |list: &str, value: Value| document[list].as_array_mut().expect("a list").push(value);
    let data: String = bytes.iter().map(|byte| format!("%{byte:02x}")).collect();
    push("buffers", json!({ "byteLength": bytes.len(), "uri": format!("data:,{data}") }));
    push("bufferViews", json!({ "buffer": 1, "byteLength": bytes.len() }));
    document
}

pub fn load(document: &Value) -> Result<Scene, String> {
    let folder = Folder::with(&[("s.gltf", &document.to_string())]);
    std::fs::write(folder.0.path().join("a square.bin"), square()).expect("written");
    folder.load("s.gltf", false).map_err(|error| error.to_string())
}

pub fn good(document: &Value) -> Scene {
    load(document).unwrap_or_else(|error| panic!("{error}"))
}

#[test]
fn instances_materials_cameras_and_lights() {
    let scene = good(&document());
    let names: Vec<&str> = scene.meshes.iter().map(|mesh| mesh.name.as_str()).collect();
    assert_eq!(names, ["left", "mirrored", "bulb"]);
    assert_eq!(scene.corners(0), [[0., 0., 2.], [2., 0., 2.], [2., 2., 2.]].map(DVec3::from));
    for triangle in 0..4 {
        assert!(scene.area_vector(triangle).z > 0.0, "a mirrored instance keeps its front");
    }
    assert_eq!(scene.vertices[4], DVec3::new(-1.0, 0.0, 2.0));
    let red = scene.material(0);
    assert_eq!((red.albedo, red.emission, red.is_glossy()), ([0.5, 0.25, 0.125], [8.0, 4.0, 0.0], false));

    let eye = scene.camera("eye").expect("a camera");
    assert_eq!((eye.width, eye.height, eye.position), (960, 480, DVec3::new(0.0, 0.0, 9.0)));
    let tangent = |degrees: f64| (degrees / 2.0).to_radians().tan();
    assert!((tangent(eye.fov_x_degrees) - 2.0 * 0.5f64.tan()).abs() < 1e-9);

    let lamp: Vec<usize> = (4..scene.triangles.len()).collect();
    assert_eq!(lamp.len(), 20);
    let middle = DVec3::new(0.0, 3.0, 3.0);
    let power: DVec3 = lamp
        .iter()
        .map(|&t| {
            let vector = scene.area_vector(t);
            assert!(vector.dot(scene.corners(t)[0] - middle) > 0.0, "fronts outside");
            DVec3::from(scene.material(t).emission) * PI * vector.length()
        })
        .sum();
    assert!(power.abs_diff_eq(4.0 * PI * 40.0 * DVec3::new(1.0, 0.5, 0.25), 1e-4), "{power}");
    assert!(scene.warnings.iter().any(|w| w.contains("1 point and spot light(s)")), "{:?}", scene.warnings);
}

#[test]
fn spot_lights_keep_their_power() {
    let mut spot = document();
    spot["extensions"]["KHR_lights_punctual"]["lights"][0] =
        json!({ "type": "spot", "intensity": 10, "spot": { "innerConeAngle": 0.5, "outerConeAngle": 0.5 } });
    let scene = good(&spot);
    let lamp = 4..scene.triangles.len();
    let power: f64 = lamp
        .map(|t| {
            assert!(scene.area_vector(t).normalize().abs_diff_eq(DVec3::NEG_Z, 1e-9));
            scene.material(t).emission[0] * PI * scene.area_vector(t).length()
        })
        .sum();
    assert!((power - 10.0 * 2.0 * PI * (1.0 - 0.5f64.cos())).abs() < 1e-4, "{power}");
}

#[test]
fn metals_and_two_sided_materials() {
    let mut metal = document();
    metal["materials"][0] = json!({
        "doubleSided": true, "alphaMode": "BLEND",
        "pbrMetallicRoughness": { "baseColorFactor": [0.8, 0.6, 0.4, 1], "metallicFactor": 1, "roughnessFactor": 0.5 },
    });
    let scene = good(&metal);
    let material = scene.material(0);
    assert_eq!((material.name.as_str(), material.albedo), ("material 0", [0.0; 3]));
    assert!((material.specular[0] - 0.8).abs() < 1e-6 && (material.power - 30.0).abs() < 1e-6);
    assert_eq!(material.normalization, Normalization::Energy);
    assert_eq!(scene.meshes[0].range, 0..4, "two triangles, and their second sides");
    assert!(scene.warnings.iter().any(|w| w.contains("ignored: transparency")), "{:?}", scene.warnings);
}

#[test]
fn binary_files_hold_their_buffer() {
    let mut document = document();
    document["buffers"] = json!([{ "byteLength": 60 }]);
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let mut glb = b"glTF".to_vec();
    let word = |x: usize| (x as u32).to_le_bytes();
    glb.extend(word(2));
    glb.extend(word(12 + 8 + text.len() + 8 + 60));
    glb.extend(word(text.len()));
    glb.extend(b"JSON");
    glb.extend(&text);
    glb.extend(word(60));
    glb.extend(b"BIN\0");
    glb.extend(square());
    let folder = Folder::with(&[]);
    std::fs::write(folder.0.path().join("s.glb"), &glb).expect("written");
    let scene = folder.load("s.glb", false).expect("a scene");
    assert_eq!(scene.triangles, good(&self::document()).triangles);
    // As a mesh of a scene file, without its cameras, with a material of that file.
    let toml = "[[mesh]]\npath = \"s.glb\"\nmaterial = \"blue\"\n[material.blue]\nemission = 3\n";
    std::fs::write(folder.0.path().join("g.toml"), toml).expect("written");
    let placed = folder.load("g.toml", false).expect("a scene");
    assert_eq!((placed.triangles.len(), placed.meshes.len()), (24, 1));
    assert!(placed.materials.iter().any(|m| m.name == "blue") && placed.material(5).emission == [3.0; 3]);
    for cut in [0, 3, 11, 19, 200, glb.len() - 1] {
        std::fs::write(folder.0.path().join("s.glb"), &glb[..cut]).expect("written");
        let error = folder.load("s.glb", false).expect_err("cut short");
        assert_says(&error.to_string(), &["s.glb"]);
    }
}

#[test]
fn textures_are_averaged_in_linear_light() {
    let mut textured = document();
    // Left half white, right half black; texture coordinates are the positions' x and y.
    let picture = image::RgbImage::from_fn(64, 64, |x, _| image::Rgb([if x < 32 { 255 } else { 0 }; 3]));
    let folder = Folder::with(&[]);
    picture.save(folder.0.path().join("half.png")).expect("written");
    let mut bytes = square();
    let uvs = [[0.0f32, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
    bytes.extend(uvs.as_flattened().iter().flat_map(|x| x.to_le_bytes()));
    std::fs::write(folder.0.path().join("a square.bin"), bytes).expect("written");
    textured["buffers"][0]["byteLength"] = json!(92);
    textured["bufferViews"]
        .as_array_mut()
        .expect("views")
        .push(json!({ "buffer": 0, "byteOffset": 60, "byteLength": 32 }));
    let uv = json!({ "bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2" });
    textured["accessors"].as_array_mut().expect("accessors").push(uv);
    textured["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(2);
    textured["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    textured["textures"] = json!([{ "source": 0 }]);
    textured["images"] = json!([{ "uri": "half.png" }]);
    let read = |document: &Value| {
        std::fs::write(folder.0.path().join("t.gltf"), document.to_string()).expect("written");
        folder.load("t.gltf", false)
    };
    let scene = read(&textured).expect("a scene");
    // The lower right triangle has a quarter of its area in the white half, the upper left three quarters.
    for (triangle, share) in [(0, 0.25), (1, 0.75)] {
        let albedo = scene.material(triangle).albedo;
        assert!(
            (albedo[0] - 0.5 * share).abs() <= 0.01 && (albedo[1] - 0.25 * share).abs() <= 0.01,
            "{albedo:?}"
        );
        assert_eq!(scene.material(triangle).emission, [8.0, 4.0, 0.0]);
    }
    assert_eq!(scene.triangles[0].material, scene.triangles[2].material, "instances share materials");
    std::fs::write(folder.0.path().join("half.png"), b"\x89PNG\r\n\x1a\n").expect("written");
    assert_says(&read(&textured).expect_err("no picture").to_string(), &["t.gltf", "image 0"]);
    std::fs::remove_file(folder.0.path().join("half.png")).expect("removed");
    assert_says(
        &read(&textured).expect_err("no file").to_string(),
        &["t.gltf", "half.png", "cannot be read"],
    );
}

#[test]
fn what_is_wrong_is_said() {
    let change = |pointer: &str, value: Value| {
        let mut changed = document();
        match changed.pointer_mut(pointer) {
            Some(place) => *place = value,
            None => {
                let (parent, key) = pointer.rsplit_once('/').expect("a key");
                changed.pointer_mut(parent).expect("a place")[key] = value;
            }
        }
        changed
    };
    for (document, parts) in [
        (
            change("/nodes/1", json!({ "mesh": 0, "children": [0] })),
            vec!["s.gltf", "node 0", "its own ancestor"],
        ),
        (change("/scenes/0/nodes", json!([0, 1])), vec!["node 1", "child twice"]),
        (
            change("/extensionsRequired", json!(["KHR_draco_mesh_compression"])),
            vec!["s.gltf", "compressed (KHR_draco_mesh_compression)", "export it without"],
        ),
        (
            change("/extensionsRequired", json!(["EXT_unheard_of"])),
            vec!["s.gltf", "requires EXT_unheard_of", "export it without"],
        ),
        (change("/buffers/0/uri", json!("lost.bin")), vec!["s.gltf", "lost.bin", "cannot be read"]),
        (change("/buffers/0/uri", json!("https://a.b/c.bin")), vec!["network"]),
        (change("/buffers/0/byteLength", json!(61)), vec!["buffer 0 has 60 bytes, of 61"]),
        (change("/buffers/0/uri", json!("data:;base64,AAAA")), vec!["buffer 0 has 3 bytes"]),
        (
            change("/accessors/0/count", json!(3)),
            vec!["node 1", "mesh 0", "index 3 is past the end of 3 vertices"],
        ),
        (change("/accessors/0/count", json!(5)), vec!["accessor 0 reads past the end"]),
        (change("/accessors/0/count", json!(4_000_000_000_u32)), vec!["accessor 0 reads past the end"]),
        (change("/accessors/1/byteOffset", json!(18_446_744_073_709_551_615_u64)), vec!["s.gltf"]),
        (
            change("/bufferViews/0/byteLength", json!(4_000_000_000_u32)),
            vec!["accessor 0 reads past the end"],
        ),
        (change("/accessors/1/componentType", json!(5126)), vec!["accessor 1", "no unsigned integers"]),
        (change("/accessors/0/type", json!("VEC2")), vec!["accessor 0 has 2 numbers a row; expected 3"]),
        (change("/meshes/0/primitives/0/indices", json!(9)), vec!["s.gltf", "no glTF 2.0 that can be read"]),
        (change("/asset/version", json!(3)), vec!["s.gltf", "no glTF 2.0 that can be read"]),
        (change("/scenes/0/nodes", json!([])), vec!["s.gltf", "no triangles"]),
    ] {
        let error = load(&document).expect_err(parts[0]);
        assert_says(&error, &parts);
    }
}
