//! Suns of scene files, glTF and Mitsuba; and what comes back of them.

use super::{Folder, assert_refused, assert_says, gltf, good, mitsuba};
use antirad::backend::Backend;
use antirad::export::{Format, export};
use antirad::scene::{LoadOptions, Scene, Sun};
use antirad::{Engine, SolveParams};
use glam::DVec3;
use serde_json::json;

const PLAIN: &str = "[[mesh]]\npath = \"m.obj\"\n[material.lamp]\nemission = 0\n";

fn scene(rest: &str) -> Scene {
    good("s.toml", &[("s.toml", &format!("{PLAIN}{rest}"))])
}

/// What comes straight from suns, W/m².
fn irradiance(scene: &Scene) -> Vec<[f64; 3]> {
    let mut engine = Engine::builder(Backend::cpu(), scene).build().expect("an engine");
    engine.solve(&SolveParams::default()).expect("a solution").irradiance
}

#[test]
fn one_sun_or_several() {
    let one = scene("[sun]\ndirection = [0, -2, 0]\nirradiance = 90\n");
    assert_eq!(one.suns, [Sun::new(DVec3::new(0.0, -2.0, 0.0), [90.0; 3])]);
    assert!(one.warnings.iter().all(|w| !w.contains("no light")), "{:?}", one.warnings);
    let two = scene(
        "[[sun]]\ndirection = [0, -2, 0]\nirradiance = [1, 2, 3]\nangular_diameter = 2\n[[sun]]\ndirection = [1, 0, 0]\n\
         irradiance = 0\n",
    );
    assert_eq!((two.suns.len(), two.suns[0].angular_diameter, two.suns[0].irradiance[1]), (2, 2.0, 2.0));
    assert_eq!(two.suns[1].angular_diameter, Sun::DIAMETER);
    let dark = scene("[sun]\ndirection = [0, -2, 0]\nirradiance = 0\n");
    assert!(dark.warnings.iter().any(|w| w.contains("no light")), "{:?}", dark.warnings);
}

#[test]
fn suns_that_are_none_are_refused() {
    let sun = |rest: &str| format!("{PLAIN}[sun]\n{rest}\n");
    let full = |direction: &str, irradiance: &str, diameter: &str| {
        sun(&format!("direction = {direction}\nirradiance = {irradiance}\nangular_diameter = {diameter}"))
    };
    let down = "[0, -1, 0]";
    assert_refused("s.toml", &full("[0, 0, 0]", "1", "1"), &["s.toml:6", "direction is (0, 0, 0)"]);
    assert_refused("s.toml", &full("1", "1", "1"), &["s.toml:6", "three numbers"]);
    assert_refused("s.toml", &full(down, "[1, -2, 1]", "1"), &["s.toml:6", "irradiance is -2"]);
    assert_refused("s.toml", &full(down, "nan", "1"), &["s.toml:7", "NaN is not finite"]);
    for diameter in ["0", "-1", "91", "nan"] {
        assert_refused(
            "s.toml",
            &full(down, "1", diameter),
            &["s.toml:6", "angular_diameter is", "0.01 to 90"],
        );
    }
    assert_refused("s.toml", &sun("direction = [0, -1, 0]"), &["s.toml:5", "irradiance"]);
    assert_refused("s.toml", &sun("irradiance = 1"), &["s.toml:5", "direction"]);
    assert_refused("s.toml", &full(down, "1", "1\ncolor = 3"), &["s.toml:9", "color"]);
    // In memory, too.
    let mut scene = scene("[sun]\ndirection = [0, -2, 0]\nirradiance = 1\n");
    let wrong = Sun::new(DVec3::Y, [f64::INFINITY; 3]);
    assert!(scene.add_sun(wrong.clone()).is_err());
    scene.suns.push(wrong);
    assert_says(&scene.validate().expect_err("refused").to_string(), &["sun 1: irradiance is inf"]);
}

/// 3 lx straight down are 3 W/m².
#[test]
fn a_directional_light_of_gltf_is_a_sun() {
    let mut document = gltf::document();
    let half = 0.5f64.sqrt();
    document["materials"][0]["emissiveFactor"] = json!([0, 0, 0]);
    document["nodes"] = json!([
        { "mesh": 0, "rotation": [-half, 0, 0, half] },
        { "extensions": { "KHR_lights_punctual": { "light": 0 } }, "rotation": [-half, 0, 0, half], "scale": [2, 2, 2] },
    ]);
    document["scenes"] = json!([{ "nodes": [0, 1] }]);
    document["extensions"]["KHR_lights_punctual"]["lights"] =
        json!([{ "type": "directional", "intensity": 3, "color": [1, 0.5, 0.25] }]);
    let scene = gltf::good(&document);
    let [Sun { direction, irradiance: stated, angular_diameter }] = &scene.suns[..] else { panic!("a sun") };
    assert!(direction.abs_diff_eq(DVec3::NEG_Y, 1e-6), "{direction}");
    assert_eq!((*stated, *angular_diameter), ([3.0, 1.5, 0.75], Sun::DIAMETER));
    assert!(scene.warnings.iter().all(|w| !w.contains("no light")), "{:?}", scene.warnings);
    for (t, found) in irradiance(&scene).into_iter().enumerate() {
        let expected = 3.0 * scene.area_vector(t).normalize().y.max(0.0);
        assert!((found[0] - expected).abs() < 1e-6, "{found:?}, not {expected}");
    }
}

#[test]
fn a_directional_emitter_of_mitsuba_is_a_sun() {
    let floor = "<shape type=\"rectangle\"/>";
    let with = |rest: &str| mitsuba::good(&format!("{floor}<emitter type=\"directional\">{rest}</emitter>"));
    let stated = with(
        "<vector name=\"direction\" x=\"0\" y=\"3\" z=\"-4\"/><rgb name=\"irradiance\" value=\"10, 5, 0\"/>",
    );
    assert_eq!(stated.suns, [Sun::new(DVec3::new(0.0, 3.0, -4.0), [10.0, 5.0, 0.0])]);
    for found in irradiance(&stated) {
        assert!((found[0] - 8.0).abs() < 1e-5 && (found[1] - 4.0).abs() < 1e-5, "{found:?}");
    }
    // By a transform: along +z before.
    let turned = with("<transform name=\"to_world\"><rotate x=\"1\" angle=\"180\"/></transform>");
    assert!(
        turned.suns[0].direction.abs_diff_eq(DVec3::NEG_Z, 1e-9) && turned.suns[0].irradiance == [1.0; 3]
    );
    let other = mitsuba::good(&format!(
        "{floor}<emitter type=\"sunsky\"><float name=\"turbidity\" value=\"3\"/></emitter>"
    ));
    assert!(
        other.warnings.iter().any(|w| w.contains("\"sunsky\">, for which [sun]")),
        "{:?}",
        other.warnings
    );
    let message = mitsuba::load(&mitsuba::scene(&format!(
        "{floor}<emitter type=\"directional\"><vector name=\"direction\" x=\"0\"/></emitter>"
    )));
    assert_says(&message.expect_err("refused"), &["s.xml:2", "direction is (0, 0, 0)"]);
}

#[test]
fn suns_come_back() {
    let scene = scene(
        "[[sun]]\ndirection = [1, -2, 0.5]\nirradiance = [90, 80.5, 0]\nangular_diameter = 3\n[[sun]]\n\
                       direction = [0, 0, 1]\nirradiance = 1\n",
    );
    let folder = Folder::with(&[]);
    let path = |name: &str| folder.0.path().join(name);
    scene.save(&path("again.toml")).expect("written");
    assert_eq!(folder.load("again.toml", false).expect("a scene").suns, scene.suns);
    for (format, single, width) in [(Format::Gltf, 1e-6, true), (Format::Mitsuba, 1e-15, false)] {
        let path = path("out").with_extension(format.extension());
        export(&scene, format, &path, None).expect("written");
        let copy = Scene::load(&path, &LoadOptions::default()).expect("a scene");
        assert_eq!(copy.suns.len(), 2);
        for (a, b) in scene.suns.iter().zip(&copy.suns) {
            assert!(a.travels().abs_diff_eq(b.travels(), single), "{a:?} {b:?}");
            assert!(a.irradiance.iter().zip(b.irradiance).all(|(x, y)| (x - y).abs() <= single * 100.0));
            assert_eq!(b.angular_diameter, if width { a.angular_diameter } else { Sun::DIAMETER });
        }
    }
}
