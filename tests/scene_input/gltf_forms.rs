//! The forms in which glTF files hold the same mesh.

use antirad::scene::Scene;
use glam::DVec3;
use serde_json::{Value, json};

use super::assert_says;
use super::gltf::{document, good, load, with_data};
use super::gltf_extensions::HALF;

fn floats(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn shorts(numbers: &[u16]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

fn corners(scene: &Scene) -> Vec<[DVec3; 3]> {
    (0..4).map(|t| scene.corners(t)).collect()
}

#[test]
fn strips_fans_and_meshes_without_indices() {
    let plain = good(&document());
    let area = |scene: &Scene, triangles: std::ops::Range<usize>| -> DVec3 {
        triangles.map(|t| scene.area_vector(t)).sum()
    };
    for (mode, indices) in [(5, [0u16, 1, 3, 2]), (6, [0, 1, 2, 3])] {
        let mut strip = with_data(&shorts(&indices));
        strip["accessors"][1] =
            json!({ "bufferView": 2, "componentType": 5123, "count": 4, "type": "SCALAR" });
        strip["meshes"][0]["primitives"][0]["mode"] = json!(mode);
        let strip = good(&strip);
        assert_eq!(strip.triangles.len(), plain.triangles.len());
        for triangle in 0..4 {
            assert!(strip.area_vector(triangle).z > 0.0, "mode {mode}: all face the front");
        }
        assert!(area(&strip, 0..2).abs_diff_eq(area(&plain, 0..2), 1e-9), "mode {mode}");
    }
    let mut soup =
        with_data(&floats(&[0., 0., 0., 1., 0., 0., 1., 1., 0., 0., 0., 0., 1., 1., 0., 0., 1., 0.]));
    soup["accessors"][0] = json!({ "bufferView": 2, "componentType": 5126, "count": 6, "type": "VEC3" });
    let primitive = soup["meshes"][0]["primitives"][0].as_object_mut().expect("a primitive");
    primitive.remove("indices");
    assert_eq!(corners(&good(&soup)), corners(&plain));
}

#[test]
fn sparse_accessors_replace_rows() {
    let bytes = [shorts(&[1, 3]), floats(&[5., 0., 0., 0., 7., 0.])].concat();
    let mut sparse = with_data(&bytes);
    let replaced = json!({
        "count": 2,
        "indices": { "bufferView": 2, "byteOffset": 0, "componentType": 5123 },
        "values": { "bufferView": 2, "byteOffset": 4 },
    });
    sparse["accessors"][0]["sparse"] = replaced.clone();
    let scene = good(&sparse);
    assert_eq!(scene.corners(0), [[0., 0., 2.], [10., 0., 2.], [2., 2., 2.]].map(DVec3::from));
    assert_eq!(scene.corners(1)[2], DVec3::new(0., 14., 2.));
    // Without data the other rows are zeros.
    sparse["accessors"][0] = json!({ "componentType": 5126, "count": 4, "type": "VEC3", "sparse": replaced });
    assert_eq!(good(&sparse).corners(0), [[0., 0., 2.], [10., 0., 2.], [0., 0., 2.]].map(DVec3::from));
    for (pointer, value, part) in [
        ("/accessors/0/sparse/count", json!(3), "accessor 0 reads past the end"),
        ("/accessors/0/sparse/indices/byteOffset", json!(u32::MAX), "accessor 0 reads past the end"),
        ("/accessors/0/count", json!(3), "accessor 0 has sparse values past its last row"),
        ("/accessors/0/count", json!(4_000_000_000_u32), "rows without data"),
    ] {
        let mut wrong = sparse.clone();
        *wrong.pointer_mut(pointer).expect("a place") = value;
        assert_says(&load(&wrong).expect_err(part), &["s.gltf", part]);
    }
}

/// The square with texture coordinates and colours, whose picture is white on the left.
fn painted() -> Value {
    let uvs = floats(&[0., 0., 1., 0., 1., 1., 0., 1.]);
    let colours = floats(&[1., 0.5, 0.5, 1., 0.5, 0.5, 1., 0.5, 0.5, 1., 0.5, 0.5]);
    let mut document = with_data(&[uvs, colours].concat());
    let accessors = document["accessors"].as_array_mut().expect("accessors");
    accessors.push(json!({ "bufferView": 2, "componentType": 5126, "count": 4, "type": "VEC2" }));
    accessors.push(
        json!({ "bufferView": 2, "byteOffset": 32, "componentType": 5126, "count": 4, "type": "VEC3" }),
    );
    let attributes = &mut document["meshes"][0]["primitives"][0]["attributes"];
    (attributes["TEXCOORD_0"], attributes["COLOR_0"]) = (json!(2), json!(3));
    document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = json!({ "index": 0 });
    document["textures"] = json!([{ "source": 0 }]);
    document["images"] = json!([{ "uri": HALF }]);
    document
}

/// The base colour is 0.5, 0.25, 0.125; a quarter of the first triangle and three of the second are white.
#[test]
fn colours_of_vertices_multiply_textures() {
    let scene = good(&painted());
    for (triangle, share) in [(0, 0.25), (1, 0.75)] {
        let expected = [0.5 * share, 0.125 * share, 0.0625 * share];
        let found = scene.material(triangle).albedo;
        assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 0.01), "{found:?}, not {expected:?}");
    }
}

#[test]
fn textures_are_moved_scaled_and_turned() {
    let shares = |transform: Value| {
        let mut document = painted();
        let info = &mut document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"];
        info["extensions"] = json!({ "KHR_texture_transform": transform });
        let scene = good(&document);
        [0, 1].map(|t| 2.0 * scene.material(t).albedo[0])
    };
    // The first triangle lies below the diagonal from the left upper corner of the picture, the second above it.
    for (transform, expected) in [
        (json!({}), [0.25, 0.75]),
        (json!({ "offset": [0.5, 0] }), [0.75, 0.25]),
        // Only the left half, which is white.
        (json!({ "scale": [0.5, 1] }), [1.0, 1.0]),
        (json!({ "scale": [0.5, 1], "offset": [0.5, 0] }), [0.0, 0.0]),
        // Scaled first, then turned, then moved: u becomes v and back, so that the upper half is white; or the other one.
        (json!({ "rotation": std::f64::consts::FRAC_PI_2 }), [0.75, 0.25]),
        (json!({ "rotation": std::f64::consts::PI }), [0.75, 0.25]),
        // Other coordinates that the primitive lacks are all 0.
        (json!({ "texCoord": 5 }), [1.0, 1.0]),
    ] {
        let found = shares(transform.clone());
        assert!(
            (0..2).all(|t| (found[t] - expected[t]).abs() < 0.02),
            "{transform}: {found:?}, not {expected:?}"
        );
    }
}

#[test]
fn cameras_without_an_aspect_ratio_have_a_usual_one() {
    let mut free = document();
    free["cameras"][0]["perspective"].as_object_mut().expect("a lens").remove("aspectRatio");
    let scene = good(&free);
    let eye = scene.camera("eye").expect("a camera");
    assert_eq!((eye.width, eye.height), (640, 480));
    let tangent = |degrees: f64| (degrees / 2.0).to_radians().tan();
    assert!((tangent(eye.fov_x_degrees) - 4.0 / 3.0 * 0.5f64.tan()).abs() < 1e-6);
}

/// Names may have blanks, and positions be far from the origin: nodes move meshes in double precision.
#[test]
fn names_with_blanks_and_places_far_away() {
    let mut far = document();
    far["nodes"][1]["name"] = json!("left wall (old)");
    far["materials"][0]["name"] = json!(" red paint ");
    far["nodes"][0]["translation"] = json!([4_500_000.0, 0, 4_500_000.0]);
    far["scenes"][0]["nodes"] = json!([0]);
    let scene = good(&far);
    assert_eq!(
        (scene.meshes[0].name.as_str(), scene.material(0).name.as_str()),
        ("left wall (old)", "red paint")
    );
    assert_eq!(scene.corners(0)[1] - scene.corners(0)[0], 2.0 * DVec3::X);
    assert_eq!(scene.corners(0)[0], DVec3::new(4.5e6, 0.0, 4.5e6));
}

/// A face has one set of coordinates, that of its colour.
#[test]
fn emission_with_coordinates_of_its_own_takes_its_mean() {
    let emission = |set: u32| {
        let mut document = painted();
        document["materials"][0]["emissiveTexture"] = json!({ "index": 0, "texCoord": set });
        good(&document)
    };
    let same = emission(0);
    for (triangle, share) in [(0, 0.25), (1, 0.75)] {
        assert!((same.material(triangle).emission[0] - 8.0 * share).abs() < 0.1);
    }
    let own = emission(1);
    assert!((0..2).all(|t| own.material(t).emission == [4.0, 2.0, 0.0]));
    assert!(own.warnings.iter().any(|w| w.contains("coordinates of their own")), "{:?}", own.warnings);
}

/// Two instances of the left square: one moved, one turned by a quarter about x, mirrored and twice as large along y.
#[test]
fn instances_by_rows_of_accessors() {
    let half = 0.5f32.sqrt();
    let translations = floats(&[0., 0., 1., 5., 0., 0.]);
    let rotations = floats(&[0., 0., 0., 1., half, 0., 0., half]);
    let scales = floats(&[1., 1., 1., -1., 2., 1.]);
    let mut instanced = with_data(&[translations, rotations, scales].concat());
    for (offset, kind) in [(0, "VEC3"), (24, "VEC4"), (56, "VEC3")] {
        let accessor =
            json!({ "bufferView": 2, "byteOffset": offset, "componentType": 5126, "count": 2, "type": kind });
        instanced["accessors"].as_array_mut().expect("a list").push(accessor);
    }
    instanced["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let attributes = json!({ "TRANSLATION": 2, "ROTATION": 3, "SCALE": 4 });
    instanced["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"] = json!({ "attributes": attributes });
    let scene = good(&instanced);
    // The node doubles all, at z = 2.
    let near = |triangle: usize, corner: usize, place: [f64; 3]| {
        let off = (scene.corners(triangle)[corner] - DVec3::from(place)).length();
        assert!(off < 1e-6, "triangle {triangle}, corner {corner}: {:?}", scene.corners(triangle));
    };
    near(0, 0, [0., 0., 4.]);
    near(0, 2, [2., 2., 4.]);
    near(2, 0, [10., 0., 2.]);
    assert!(
        scene.corners(2).iter().any(|c| c.abs_diff_eq(DVec3::new(8., 0., 6.), 1e-6)),
        "{:?}",
        scene.corners(2)
    );
    // A mirrored instance faces where one does that is turned alone.
    assert!(scene.area_vector(2).y < 0.0 && scene.area_vector(0).z > 0.0);
    instanced["accessors"][4]["count"] = json!(1);
    assert_says(
        &load(&instanced).expect_err("lengths differ"),
        &["node 1", "EXT_mesh_gpu_instancing", "2 and 1"],
    );
    instanced["nodes"][1]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"]["SCALE"] = json!(9);
    assert_says(&load(&instanced).expect_err("no accessor"), &["accessor 9"]);
}
