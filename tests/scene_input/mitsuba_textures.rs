//! Bitmaps of Mitsuba on shapes and files.

use antirad::scene::Scene;
use glam::DVec3;

use super::mitsuba::{LAMP, good};

/// Half of it black, on the left, and half white.
const PICTURE: &str = "<string name=\"filename\" value=\"half.png\"/>";

/// Of the second mesh: the mean over its area of something of triangles whose centroid is on a side.
fn mean(scene: &Scene, side: impl Fn(DVec3) -> bool, of: impl Fn(usize) -> f64) -> f64 {
    let all = scene.meshes[1].range.clone().map(|t| t as usize);
    let there = all.filter(|&t| side(scene.corners(t).iter().sum::<DVec3>() / 3.0));
    let (sum, area) = there.fold((0.0, 0.0), |(sum, area), t| {
        let whole = scene.area_vector(t).length();
        (sum + whole * of(t), area + whole)
    });
    sum / area
}

#[test]
fn bitmaps_are_textures() {
    let wall = |texture: &str, reference: &str| {
        let text = format!(
            "{LAMP}{texture}<shape type=\"rectangle\"><bsdf type=\"twosided\"><bsdf type=\"diffuse\">{reference}</bsdf></bsdf></shape>"
        );
        let scene = good(&text);
        assert!(scene.warnings.iter().all(|w| !w.contains("texture")), "{:?}", scene.warnings);
        let albedo = |t: usize| scene.material(t).albedo[1];
        [mean(&scene, |x| x.x < 0.0, albedo), mean(&scene, |x| x.x > 0.0, albedo)]
    };
    let inner =
        |more: &str| format!("<texture name=\"reflectance\" type=\"bitmap\">{PICTURE}{more}</texture>");
    let near = |found: [f64; 2], expected: [f64; 2]| {
        assert!((0..2).all(|k| (found[k] - expected[k]).abs() < 0.01), "{found:?}, not {expected:?}");
    };
    // Limited to 90 %.
    near(wall("", &inner("")), [0.0, 0.9]);
    let named = format!("<texture type=\"bitmap\" id=\"t\">{PICTURE}</texture>");
    near(wall(&named, "<ref name=\"reflectance\" id=\"t\"/>"), [0.0, 0.9]);
    // Moved by half of it.
    near(wall("", &inner("<transform name=\"to_uv\"><translate x=\"0.5\"/></transform>")), [0.9, 0.0]);
    // Each half shows both.
    near(wall("", &inner("<float name=\"uscale\" value=\"2\"/>")), [0.45, 0.45]);
}

#[test]
fn lamps_and_metals_have_textures() {
    let lamp = format!(
        "{LAMP}<shape type=\"rectangle\"><emitter type=\"area\"><texture name=\"radiance\" type=\"bitmap\">{PICTURE}</texture></emitter></shape>"
    );
    let scene = good(&lamp);
    let emission = |t: usize| scene.material(t).emission[0];
    let [left, right] = [mean(&scene, |x| x.x < 0.0, emission), mean(&scene, |x| x.x > 0.0, emission)];
    assert!(left == 0.0 && (right - 1.0).abs() < 1e-9, "{left} {right}");
    let metal = format!(
        "{LAMP}<shape type=\"rectangle\"><bsdf type=\"roughconductor\"><float name=\"alpha\" value=\"0.5\"/><texture \
         name=\"specular_reflectance\" type=\"bitmap\">{PICTURE}</texture></bsdf></shape>"
    );
    let scene = good(&metal);
    let specular = |t: usize| scene.material(t).specular[0];
    let sides = [mean(&scene, |x| x.x < 0.0, specular), mean(&scene, |x| x.x > 0.0, specular)];
    assert!(sides[0] == 0.0 && (sides[1] - 0.8).abs() < 1e-9, "{sides:?}");
}

/// The corners of cubes, spheres and disks, as Mitsuba 3.9 maps them: white where the first coordinate is beyond a half.
#[test]
fn shapes_have_the_coordinates_of_mitsuba() {
    let white = |kind: &str, side: fn(DVec3) -> bool| {
        let text = format!(
            "{LAMP}<shape type=\"{kind}\"><bsdf type=\"diffuse\"><texture name=\"reflectance\" type=\"bitmap\">{PICTURE}</texture></bsdf></shape>"
        );
        let scene = good(&text);
        mean(&scene, side, |t| scene.material(t).albedo[0])
    };
    // On the sides of a cube u grows with y, but on the top it falls with x, and on the bottom it grows with z.
    assert!(
        white("cube", |x| x.x > 0.99 && x.y > 0.0) > 0.89
            && white("cube", |x| x.x > 0.99 && x.y < 0.0) == 0.0
    );
    assert!(
        white("cube", |x| x.z < -0.99 && x.y < 0.0) > 0.89
            && white("cube", |x| x.z < -0.99 && x.y > 0.0) == 0.0
    );
    assert!(
        white("cube", |x| x.y > 0.99 && x.x < 0.0) > 0.89
            && white("cube", |x| x.y > 0.99 && x.x > 0.0) == 0.0
    );
    assert!(
        white("cube", |x| x.y < -0.99 && x.z > 0.0) > 0.89
            && white("cube", |x| x.y < -0.99 && x.z < 0.0) == 0.0
    );
    // Around a sphere u is the angle from +x to +y; on a disk it is the radius.
    assert!(white("sphere", |x| x.y < -0.2) > 0.89 && white("sphere", |x| x.y > 0.2) < 0.01);
    let disk = white("disk", |_| true);
    assert!((disk - 0.75).abs() < 0.01, "the outer half of the radius is white: {disk}");
}
