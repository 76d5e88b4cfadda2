//! Emitters of Mitsuba that are no shapes.

use antirad::scene::Scene;
use glam::DVec3;
use std::f64::consts::PI;

use super::Folder;
use super::mitsuba::{good, scene};

/// The last mesh: the sum of its power, W, and of its area vectors over its area.
fn lamp(scene: &Scene) -> (DVec3, DVec3) {
    let range = scene.meshes.last().expect("a lamp").range.clone();
    let (mut power, mut vector, mut area) = (DVec3::ZERO, DVec3::ZERO, 0.0);
    for t in range.map(|t| t as usize) {
        power += DVec3::from(scene.material(t).emission) * PI * scene.area_vector(t).length();
        vector += scene.area_vector(t);
        area += scene.area_vector(t).length();
    }
    (power, vector / area)
}

#[test]
fn points_and_spots_become_small_lamps_of_their_power() {
    let floor = "<shape type=\"rectangle\"/>";
    let with = |emitter: &str| good(&format!("{floor}<emitter {emitter}</emitter>"));
    let point = with(
        "type=\"point\"><point name=\"position\" x=\"0\" y=\"0\" z=\"3\"/><rgb name=\"intensity\" value=\"10, 5, 0\"/>",
    );
    let (power, vector) = lamp(&point);
    assert!(power.abs_diff_eq(4.0 * PI * DVec3::new(10.0, 5.0, 0.0), 1e-9), "{power}");
    assert!(vector.length() < 1e-9, "light in all directions");
    assert!(point.warnings.iter().any(|w| w.contains("1 point and spot light(s)")), "{:?}", point.warnings);
    // Its intensity is the same within 5 % in all directions: L times the area that is seen from there.
    for direction in
        [DVec3::X, DVec3::Y, DVec3::NEG_Z, DVec3::ONE.normalize(), DVec3::new(1.0, 1.0, 0.0).normalize()]
    {
        let range = point.meshes[1].range.clone().map(|t| t as usize);
        let intensity: f64 =
            range.map(|t| point.material(t).emission[0] * point.area_vector(t).dot(direction).max(0.0)).sum();
        assert!((intensity / 10.0 - 1.0).abs() < 0.05, "{direction}: {intensity}");
    }
    // Moved by a transform; the intensity is 1.
    let moved = with("type=\"point\"><transform name=\"to_world\"><translate z=\"2\"/></transform>");
    assert!((lamp(&moved).0.x - 4.0 * PI).abs() < 1e-9);
    let range = moved.meshes[1].range.clone();
    let middle: DVec3 = range.clone().map(|t| moved.corners(t as usize).iter().sum::<DVec3>() / 3.0).sum();
    assert!((middle / range.len() as f64).abs_diff_eq(2.0 * DVec3::Z, 1e-9));

    // Down, against the integral of Mitsuba's falloff, in proportion to the angle from 15 to 20 degrees.
    let spot = with(
        "type=\"spot\"><rgb name=\"intensity\" value=\"10\"/><transform name=\"to_world\"><lookat origin=\"0, 0, 3\" target=\"0, 0, 0\" \
         up=\"0, 1, 0\"/></transform>",
    );
    let (power, vector) = lamp(&spot);
    assert!(vector.abs_diff_eq(DVec3::NEG_Z, 1e-9), "{vector}");
    let falloff = |degrees: f64| ((20.0 - degrees) / 5.0).clamp(0.0, 1.0);
    let step = 1e-3;
    let integral: f64 = (0..20_000)
        .map(|k| step * (f64::from(k) + 0.5))
        .map(|degrees| 2.0 * PI * 10.0 * falloff(degrees) * degrees.to_radians().sin() * step.to_radians())
        .sum();
    assert!((power.x / integral - 1.0).abs() < 1e-6, "{power} {integral}");
    let sharp =
        "type=\"spot\"><float name=\"cutoff_angle\" value=\"30\"/><float name=\"beam_width\" value=\"30\"/>";
    let whole = 2.0 * PI * (1.0 - 30f64.to_radians().cos());
    assert!((lamp(&with(sharp)).0.x / whole - 1.0).abs() < 1e-9);
}

/// Radiance from a direction: that of the face of the sky's cube that lies there.
fn from(scene: &Scene, direction: DVec3) -> f64 {
    let sky = scene.meshes.iter().find(|mesh| mesh.name == "sky").expect("a sky");
    let middle = |t: usize| scene.corners(t).iter().sum::<DVec3>().normalize();
    let triangles = sky.range.clone().map(|t| t as usize);
    let nearest = triangles.max_by(|&a, &b| middle(a).dot(direction).total_cmp(&middle(b).dot(direction)));
    scene.material(nearest.expect("a face")).emission[0]
}

/// As Mitsuba 3.9 evaluates it: the middle of the picture is +z, and a quarter to the left of it is +x.
#[test]
fn environment_maps_stand_and_turn_as_in_mitsuba() {
    let folder = Folder::with(&[]);
    // Bright about a quarter from the left.
    let picture = image::GrayImage::from_fn(64, 32, |x, _| {
        image::Luma([if x / 8 == 1 || x / 8 == 2 { 255 } else { 0 }])
    });
    picture.save(folder.0.path().join("sky.png")).expect("a picture");
    let with = |transform: &str| {
        let text = scene(&format!(
            "<shape type=\"sphere\"/><emitter type=\"envmap\"><string name=\"filename\" value=\"sky.png\"/><float name=\"scale\" \
             value=\"4\"/><transform name=\"to_world\">{transform}</transform></emitter>"
        ));
        std::fs::write(folder.0.path().join("e.xml"), text).expect("written");
        folder.load("e.xml", false).expect("a scene")
    };
    let bright = |scene: &Scene, direction: DVec3| {
        for other in [DVec3::X, DVec3::NEG_X, DVec3::Z, DVec3::NEG_Z] {
            // Near the axis, where the squares are.
            let near = (other + 0.1 * DVec3::Y + 0.1 * DVec3::new(other.z, 0.0, other.x)).normalize();
            let expected = if other == direction { 4.0 } else { 0.0 };
            assert!(
                (from(scene, near) - expected).abs() < 1e-6,
                "{direction} {other}: {}",
                from(scene, near)
            );
        }
    };
    bright(&with(""), DVec3::X);
    bright(&with("<rotate y=\"1\" angle=\"90\"/>"), DVec3::NEG_Z);
    bright(&with("<scale x=\"-1\"/>"), DVec3::NEG_X);
    bright(&with("<scale value=\"3\"/>"), DVec3::X);
    let stretched = with("<scale x=\"2\"/>");
    assert!(
        stretched.warnings.iter().any(|w| w.contains("which is no rotation")),
        "{:?}",
        stretched.warnings
    );
}
