//! Extensions of glTF: quantized and compressed meshes, specular-glossiness materials, and what is said of others.

use antirad::scene::{Normalization, Scene};
use glam::DVec3;
use serde_json::{Value, json};

use super::assert_says;
use super::gltf::{document, good, load, with_data};

/// Left half white, right half black.
pub const HALF: &str = "data:image/png;base64,iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAAAAABX3VL4AAAADklEQVR42mP4z8DwnwEABv8B/xpDwIAAAAAASUVORK5CYII=";

/// As gltfpack and glTF-Transform write them, in each type, with positions and coordinates that are fractions and that are not.
#[test]
fn quantized_meshes_are_read() {
    let corners = [[0i32, 0], [1, 0], [1, 1], [0, 1]];
    // The component type, its bytes, and the largest number, by which fractions are multiplied.
    for (kind, size, most) in [(5120, 1, 127), (5121, 1, 255), (5122, 2, 32767), (5123, 2, 65535)] {
        for fraction in [true, false] {
            let one = if fraction { most } else { 100 };
            let numbers = corners.iter().flat_map(|&[x, y]| [one * x, one * y, 0, 0, one * x, one * y, 0, 0]);
            let bytes: Vec<u8> =
                numbers.flat_map(|number| number.to_le_bytes().into_iter().take(size)).collect();
            let accessor = |offset: usize, of: &str| json!({ "bufferView": 2, "byteOffset": offset, "componentType": kind, "normalized": fraction, "count": 4, "type": of });
            let mut document = with_data(&bytes);
            document["bufferViews"][2]["byteStride"] = json!(8 * size);
            document["accessors"][0] = accessor(0, "VEC3");
            document["accessors"].as_array_mut().expect("a list").push(accessor(4 * size, "VEC2"));
            document["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_0"] = json!(2);
            document["extensionsUsed"] = json!(["KHR_mesh_quantization", "KHR_texture_transform"]);
            document["extensionsRequired"] = document["extensionsUsed"].clone();
            let material = &mut document["materials"][0];
            material["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
            document["textures"] = json!([{ "source": 0 }]);
            document["images"] = json!([{ "uri": HALF }]);
            if !fraction {
                document["nodes"][1]["scale"] = json!([0.02, 0.02, 0.02]);
                let moved = json!({ "KHR_texture_transform": { "scale": [0.01, 0.01] } });
                document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] = moved;
            }
            let scene = good(&document);
            let expected = [[0., 0., 2.], [2., 0., 2.], [2., 2., 2.]].map(DVec3::from);
            for (corner, expected) in scene.corners(0).into_iter().zip(expected) {
                assert!(corner.abs_diff_eq(expected, 1e-6), "{kind} {fraction}: {corner}");
            }
            // A quarter of the lower right triangle is white, and three quarters of the other.
            for (triangle, share) in [(0, 0.25), (1, 0.75)] {
                let albedo = scene.material(triangle).albedo[0];
                assert!((albedo - 0.5 * share).abs() < 0.02, "{kind} {fraction}: {albedo}");
            }
        }
    }
}

/// What gltfpack 1.3 makes of three triangles with `-cc`: attributes, normals behind a filter, and triangles, without a fallback.
#[test]
fn compressed_views_are_read() {
    let compressed = |view: Value| json!({ "EXT_meshopt_compression": view });
    let document = json!({
        "asset": { "version": "2.0" },
        "extensionsUsed": ["KHR_mesh_quantization", "EXT_meshopt_compression"],
        "extensionsRequired": ["KHR_mesh_quantization", "EXT_meshopt_compression"],
        "buffers": [
            { "byteLength": 132, "uri": "data:;base64,oAEQgAAAATDAAAB+fQEEAAAAAQwAAAB+AQGAAAABA8AAAH59AAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAoAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAAB/AAAAAOHwECAAdodWZ3iphmWJaJgBaQAA" },
            { "byteLength": 80, "extensions": compressed(json!({ "fallback": true })) },
        ],
        "bufferViews": [
            { "buffer": 1, "byteOffset": 0, "byteLength": 40, "byteStride": 8, "extensions": compressed(json!(
                { "buffer": 0, "byteOffset": 0, "byteLength": 70, "byteStride": 8, "mode": "ATTRIBUTES", "count": 5 })) },
            { "buffer": 1, "byteOffset": 40, "byteLength": 20, "byteStride": 4, "extensions": compressed(json!(
                { "buffer": 0, "byteOffset": 72, "byteLength": 37, "byteStride": 4, "mode": "ATTRIBUTES", "filter": "OCTAHEDRAL", "count": 5 })) },
            { "buffer": 1, "byteOffset": 60, "byteLength": 18, "extensions": compressed(json!(
                { "buffer": 0, "byteOffset": 112, "byteLength": 20, "byteStride": 2, "mode": "TRIANGLES", "count": 9 })) },
        ],
        "accessors": [
            { "bufferView": 0, "componentType": 5123, "count": 5, "type": "VEC3", "min": [0, 0, 0], "max": [16383, 16383, 16383] },
            { "bufferView": 1, "componentType": 5120, "count": 5, "type": "VEC3", "normalized": true },
            { "bufferView": 2, "componentType": 5123, "count": 9, "type": "SCALAR" },
        ],
        "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0, "NORMAL": 1 }, "indices": 2 }] }],
        "nodes": [{ "mesh": 0, "scale": [6.10388815e-05, 6.10388815e-05, 6.10388815e-05] }],
        "scenes": [{ "nodes": [0] }],
        "scene": 0,
    });
    let scene = good(&document);
    // Two triangles of the unit square, and one beside it that leans; the packer puts them in an order of its own.
    let mut areas: Vec<DVec3> = (0..scene.triangles.len()).map(|t| scene.area_vector(t)).collect();
    areas.sort_by(|a, b| a.x.total_cmp(&b.x));
    let expected = [[-0.5, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, 0.5]].map(DVec3::from);
    for (area, expected) in areas.iter().zip(expected) {
        assert!(area.abs_diff_eq(expected, 1e-4), "{areas:?}");
    }
    assert_eq!(areas.len(), 3);
    for (pointer, value, part) in [
        ("/bufferViews/0/extensions/EXT_meshopt_compression/byteLength", json!(60), "buffer view 0"),
        ("/bufferViews/2/extensions/EXT_meshopt_compression/count", json!(8), "has malformed data"),
        (
            "/bufferViews/0/extensions/EXT_meshopt_compression/count",
            json!(1_u64 << 40),
            "more than 2147483648 bytes",
        ),
        ("/bufferViews/0/extensions/EXT_meshopt_compression/buffer", json!(7), "buffer view 0"),
        ("/bufferViews/0/extensions/EXT_meshopt_compression/mode", json!("MESHLETS"), "buffer view 0"),
    ] {
        let mut changed = document.clone();
        *changed.pointer_mut(pointer).expect("a place") = value;
        assert_says(&load(&changed).expect_err(pointer), &["s.gltf", part]);
    }
}

fn glossy(extension: Value) -> Scene {
    let mut document = document();
    document["materials"][0] =
        json!({ "name": "m", "extensions": { "KHR_materials_pbrSpecularGlossiness": extension } });
    document["textures"] = json!([{ "source": 0 }]);
    document["images"] = json!([{ "uri": HALF }]);
    good(&document)
}

#[test]
fn specular_glossiness_is_read() {
    let near = |found: [f64; 3], expected: [f64; 3]| {
        assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-6), "{found:?}, not {expected:?}");
    };
    // Rough, with the default of a white specular colour.
    let rough =
        glossy(json!({ "diffuseFactor": [0.2, 0.6, 0.2, 1], "glossinessFactor": 0 })).material(0).clone();
    near(rough.albedo, [0.2, 0.6, 0.2]);
    assert!(!rough.is_glossy());
    // A polished dielectric, and a metal of roughness 0.5.
    let polished = glossy(json!({
        "diffuseFactor": [0.2, 0.6, 0.2, 1], "specularFactor": [0.04, 0.04, 0.04], "glossinessFactor": 0.8,
    }));
    let polished = polished.material(0);
    near(polished.specular, [0.04; 3]);
    assert!(
        (polished.power - 1248.0).abs() < 0.1 && polished.normalization == Normalization::Energy,
        "{polished:?}"
    );
    let metal = glossy(json!({
        "diffuseFactor": [0, 0, 0, 1], "specularFactor": [0.8, 0.6, 0.4], "glossinessFactor": 0.5,
    }));
    near(metal.material(0).albedo, [0.0; 3]);
    near(metal.material(0).specular, [0.8, 0.6, 0.4]);
    assert!((metal.material(0).power - 30.0).abs() < 1e-3);
    // What is specular is not diffuse. Textures multiply: half of the picture is white, and it is opaque.
    let textured = glossy(json!({
        "diffuseFactor": [0.8, 0.8, 0.8, 1], "specularFactor": [0.5, 0.5, 0.5], "glossinessFactor": 0.5,
        "specularGlossinessTexture": { "index": 0 },
    }));
    near(textured.material(0).specular, [0.25; 3]);
    near(textured.material(0).albedo, [0.6; 3]);
    assert!((textured.material(0).power - 30.0).abs() < 1e-3);
    assert!(textured.warnings.iter().any(|w| w.contains("variation of specular colour and glossiness")));
}

/// Each is named once, with what stands in for it.
#[test]
fn other_extensions_are_named() {
    let mut document = document();
    let used =
        json!(["KHR_materials_unlit", "KHR_materials_ior", "KHR_materials_transmission", "EXT_unheard_of"]);
    document["extensionsUsed"] = used;
    document["extensionsRequired"] = json!(["KHR_materials_unlit"]);
    document["materials"][0]["extensions"] =
        json!({ "KHR_materials_unlit": {}, "KHR_materials_ior": { "ior": 1.8 } });
    let scene = good(&document);
    let said: Vec<&String> = scene.warnings.iter().filter(|w| w.contains("KHR_")).collect();
    assert_eq!(said.len(), 1, "{:?}", scene.warnings);
    let parts = [
        "KHR_materials_unlit (surfaces reflect light like others)",
        "KHR_materials_ior (dielectrics reflect 4 % at normal incidence)",
        "KHR_materials_transmission (surfaces are opaque)",
        "EXT_unheard_of",
    ];
    assert_says(said[0], &parts);
}
