//! Skies of scene files, of options and of Mitsuba's scenes.

use super::{Folder, assert_refused, assert_says, good};
use antirad::scene::{LoadOptions, Scene, Sky};
use glam::DVec3;

const PLAIN: &str = "[[mesh]]\npath = \"m.obj\"\n";

/// The radiance of each triangle of the mesh "sky".
fn radiance(scene: &Scene) -> Vec<[f64; 3]> {
    let mesh = scene.meshes.iter().find(|mesh| mesh.name == "sky").expect("a sky");
    mesh.range.clone().map(|i| scene.material(i as usize).emission).collect()
}

#[test]
fn a_sky_surrounds_scene_and_cameras() {
    let scene = good(
        "s.toml",
        &[(
            "s.toml",
            &format!(
                "{PLAIN}[sky]\nradiance = [1, 2, 3]\n[camera.far]\nposition = [0, 40, 5]\n\
        target = [0, 0, 0]\nup = [1, 0, 0]\nfov_x_degrees = 40\nwidth = 64\nheight = 48\n"
            ),
        )],
    );
    assert_eq!(radiance(&scene), [[1.0, 2.0, 3.0]; 12]);
    assert_eq!(scene.triangles.len(), 14);
    let mesh = scene.meshes.last().expect("meshes");
    let inside = scene.cameras.iter().map(|c| c.position).chain(scene.vertices[..4].iter().copied());
    for point in inside.collect::<Vec<DVec3>>() {
        for i in mesh.range.clone().map(|i| i as usize) {
            assert!((point - scene.corners(i)[0]).dot(scene.area_vector(i)) > 0.0, "{point} is outside");
        }
    }
    assert!(scene.warnings.iter().all(|w| !w.contains("no light")), "{:?}", scene.warnings);
    // Written and read again, it is an ordinary mesh.
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("again.toml");
    scene.save(&path).expect("a file");
    let again = Scene::load(&path, &LoadOptions::default()).expect("a scene");
    assert_eq!(radiance(&again), radiance(&scene));
}

/// `--sky` takes the place of the file's.
#[test]
fn an_option_takes_precedence() {
    let folder = Folder::with(&[("s.toml", &format!("{PLAIN}[sky]\nradiance = 1\n"))]);
    let options = LoadOptions::default().sky(Some(Sky::uniform([7.0; 3])));
    let scene = Scene::load(&folder.0.path().join("s.toml"), &options).expect("a scene");
    assert_eq!(radiance(&scene), [[7.0; 3]; 12]);
    let bare = Scene::load(&folder.0.path().join("m.obj"), &options).expect("a scene");
    assert_eq!(radiance(&bare), [[7.0; 3]; 12]);
}

#[test]
fn a_constant_emitter_of_mitsuba_is_a_sky() {
    let xml = "<scene version=\"3.0.0\"><emitter type=\"constant\"><rgb name=\"radiance\" value=\"0.5, 1, 2\"/></emitter>\
               <shape type=\"rectangle\"/></scene>";
    let scene = good("s.xml", &[("s.xml", xml)]);
    assert_eq!(radiance(&scene), [[0.5, 1.0, 2.0]; 12]);
}

#[test]
fn skies_that_are_none_are_refused() {
    let sky = |rest: &str| format!("{PLAIN}[sky]\n{rest}\n");
    assert_refused("s.toml", &sky(""), &["s.toml:3", "`radiance = NUMBER`"]);
    assert_refused("s.toml", &sky("radiance = -1"), &["radiance", "-1"]);
    assert_refused("s.toml", &sky("radiance = 1e308"), &["radiance", "1e308", "larger unit"]);
    assert_refused("s.toml", &sky("radiance = nan"), &["NaN"]);
    assert_refused("s.toml", &sky("image = \"no.hdr\""), &["s.toml:4", "no.hdr", "cannot be read"]);
    assert_refused("s.toml", &sky("image = \"m.obj\""), &["m.obj", "no readable picture"]);
    assert_refused("s.toml", &sky("color = 1"), &["color", "radiance"]);
    let error = Sky::read(std::path::Path::new("/dev/null"), [1.0; 3]).expect_err("no picture");
    assert_says(&error, &["device or a pipe"]);
}
