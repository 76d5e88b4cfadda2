//! Invariance under translation, scale, rotation and the order of triangles.

mod support;

use antirad::scene::{BinLayout, Material, Scene, SceneBuilder, Shape, SolveSettings};
use glam::{DAffine3, DQuat, DVec3};
use support::random::Random;
use support::{areas, backend, finish, relative_l2, solve};

/// A room with a lamp and a box in it, none of it along the axes' cells.
fn room() -> Scene {
    let grey = Material { albedo: [0.6, 0.5, 0.4], ..Material::named("grey") };
    let lamp = Material { emission: [10.0, 9.0, 7.0], ..Material::named("lamp") };
    let place = |scale: DVec3, turn: f64, to: DVec3| {
        DAffine3::from_scale_rotation_translation(scale, DQuat::from_rotation_y(turn), to)
    };
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells: 4 }, &grey, DAffine3::IDENTITY);
    let lamp_place = place(DVec3::new(0.3, -1.0, 0.3), 0.2, DVec3::new(0.33, 0.9, 0.31));
    builder.shape("lamp", Shape::Quad { cells: 2 }, &lamp, lamp_place);
    let block = place(DVec3::new(0.3, 0.4, 0.3), 0.4, DVec3::new(0.27, 0.1, 0.45));
    builder.shape("box", Shape::Box { cells: 2 }, &grey, block);
    builder.finish("room").map(support::implicit).expect("a scene")
}

fn tight(scene: &Scene) -> SolveSettings {
    scene.settings.tolerance(1e-6)
}

#[test]
fn scale_place_and_order() {
    let backend = backend();
    let scene = room();
    let (_engine, truth) = solve(&backend, &scene, &tight(&scene));
    let moved = |map: &dyn Fn(DVec3) -> DVec3| {
        let mut moved = scene.clone();
        moved.vertices.iter_mut().for_each(|v| *v = map(*v));
        moved
    };
    for (name, changed) in [
        ("a thousandth of the size", moved(&|x| 1e-3 * x)),
        ("10⁴ times the size", moved(&|x| 1e4 * x)),
        ("10³⁰ times the size", moved(&|x| 1e30 * x)),
        ("10³⁰ times smaller", moved(&|x| 1e-30 * x)),
        ("moved by 10⁴", moved(&|x| x + DVec3::new(1e4, -1e4, 1e4))),
    ] {
        let (_engine, other) = solve(&backend, &changed, &tight(&scene));
        let error = relative_l2(&other.irradiance, &truth.irradiance, &areas(&scene));
        println!("{name}: {error:.1e}");
        assert!(error <= 1e-4, "{name}: {error:e}");
    }

    let mut order: Vec<usize> = (0..scene.triangles.len()).collect();
    let mut random = Random::new(7);
    for k in (1..order.len()).rev() {
        order.swap(k, (random.next() * (k + 1) as f64) as usize);
    }
    let mut shuffled = scene.clone();
    shuffled.triangles = order.iter().map(|&i| scene.triangles[i]).collect();
    // Which corner of a triangle comes first does not matter, either.
    for (k, t) in shuffled.triangles.iter_mut().enumerate() {
        t.vertices.rotate_left(k % 3);
    }
    let (_engine, other) = solve(&backend, &shuffled, &tight(&scene));
    let mut back = vec![[0.0; 3]; order.len()];
    order.iter().zip(&other.irradiance).for_each(|(&i, &h)| back[i] = h);
    let error = relative_l2(&back, &truth.irradiance, &areas(&scene));
    println!("shuffled: {error:.1e}");
    assert!(error <= 1e-4, "shuffled: {error:e}");
    finish(&backend);
}

/// Bins turn with the frames of their triangles, and frames do not turn with the scene, so that shadows change within
/// the error of the layout. Without shadows nothing changes.
#[test]
fn rotation() {
    let backend = backend();
    let mut random = Random::new(11);
    let turns: Vec<DQuat> = (0..2)
        .map(|_| {
            let (axis, angle) = ((random.point() - 0.5).normalize(), 6.0 * random.next());
            DQuat::from_axis_angle(axis, angle)
        })
        .collect();
    let with_shadows = room();
    let mut without = room();
    without.triangles.truncate(without.meshes[1].range.start as usize);
    without.meshes.truncate(1);
    without.triangles[3].material = 1;
    without.check(true).expect("a scene");
    let equal_angle = BinLayout::EqualAngle { theta: 10, phi: 13 };
    for (name, scene, bins, bound) in [
        ("no shadows", &without, equal_angle, 1e-4),
        ("10x13", &with_shadows, equal_angle, 0.02),
        ("concentric:12", &with_shadows, BinLayout::Concentric { n: 12 }, 0.02),
    ] {
        let settings = tight(scene).bins(bins);
        let (_engine, truth) = solve(&backend, scene, &settings);
        for turn in &turns {
            let mut turned = scene.clone();
            turned.vertices.iter_mut().for_each(|v| *v = *turn * *v);
            let (_engine, other) = solve(&backend, &turned, &settings);
            let error = relative_l2(&other.irradiance, &truth.irradiance, &areas(scene));
            println!("{name}, turned: {error:.2e}");
            assert!(error <= bound, "{name}: {error:e}");
        }
    }
    finish(&backend);
}
