//! Extensions of glTF: quantized meshes.

use glam::DVec3;
use serde_json::json;

use super::gltf::{good, with_data};

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
