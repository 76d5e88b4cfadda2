//! Random scenes, the same on every run.

pub use super::kit::Random;
use antirad::scene::{BinLayout, Lamps, Material, Scene, SceneBuilder, Shape, Triangle};
use glam::{DAffine3, DVec3};

/// Triangles of all sizes and directions in a box; `glossy` of the materials have a lobe.
pub fn random_scene(seed: u64, triangles: u32, glossy: bool, grey: bool) -> Scene {
    scattered(seed, triangles, glossy, grey, 2.0)
}

/// The same in a cube of side `room`: the smaller, the more close pairs.
pub fn scattered(seed: u64, triangles: u32, glossy: bool, grey: bool, room: f64) -> Scene {
    let mut random = Random::new(seed);
    let mut materials = Vec::new();
    for k in 0..4 {
        let mut material = Material::named(format!("m{k}"));
        let shade = |random: &mut Random| {
            if grey { [random.next(); 3] } else { [random.next(), random.next(), random.next()] }
        };
        material.albedo = shade(&mut random).map(|x| 0.5 * x);
        material.emission = if k == 0 { shade(&mut random).map(|x| 5.0 * x) } else { [0.0; 3] };
        if glossy && k % 2 == 1 {
            material.specular = shade(&mut random).map(|x| 0.1 * x);
            material.power = [0.0, 1.0, 20.0, 200.0][(random.next() * 4.0) as usize];
        }
        materials.push(material);
    }
    let (mut vertices, mut list) = (Vec::new(), Vec::new());
    for k in 0..triangles {
        let centre = random.point() * room;
        let size = 0.02 + 0.3 * random.next();
        for _ in 0..3 {
            vertices.push(centre + size * (random.point() - 0.5));
        }
        let first = 3 * k;
        list.push(Triangle { vertices: [first, first + 1, first + 2], material: k % 4 });
    }
    Scene::new("random", vertices, list, materials).expect("a scene")
}

/// The second half of the triangles with a power of its own each: lobes by matrix and bin by bin in one scene.
pub fn with_own_powers(mut scene: Scene) -> Scene {
    let (half, count) = (scene.triangles.len() / 2, scene.triangles.len());
    let labels: Vec<u64> = (0..count).map(|i| if i < half { 0 } else { i as u64 }).collect();
    scene.split_materials(&labels);
    for i in half..count {
        let material = &mut scene.materials[scene.triangles[i].material as usize];
        material.power += if material.is_glossy() { 0.01 * i as f64 } else { 0.0 };
    }
    scene
}

/// Balls over a floor, under a lamp, every third one glossy if asked for: objects that no cluster of one normal reaches beyond.
pub fn balls(count: u32, level: u32, glossy: bool) -> Scene {
    let albedo = [0.7, 0.6, 0.4];
    let (floor, stone) =
        (Material { albedo, ..Material::named("floor") }, Material { albedo, ..Material::named("stone") });
    let metal = Material { specular: [0.2, 0.25, 0.3], power: 4.0, ..Material::named("metal") };
    let lamp = Material { emission: [20.0, 19.0, 17.0], ..Material::named("lamp") };
    let size = DVec3::new(6.0, 3.0, 6.0);
    let mut builder = SceneBuilder::new();
    builder.shape("floor", Shape::Quad { cells: 8 }, &floor, DAffine3::from_scale(size));
    let place = DAffine3::from_translation(DVec3::new(2.0, 4.0, 2.0))
        * DAffine3::from_scale(DVec3::new(2.0, -1.0, 2.0));
    builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, place);
    let radius = 0.15 * (size.element_product() / f64::from(count)).cbrt();
    let mut random = Random::new(5);
    for k in 0..count {
        // One in each of as many slices of the floor.
        let along = (f64::from(k) + 0.5) / f64::from(count);
        let at = DVec3::new(along, random.next(), random.next()) * (size - 2.0 * radius);
        let place = DAffine3::from_translation(at + radius) * DAffine3::from_scale(DVec3::splat(radius));
        let material = if glossy && k % 3 == 0 { &metal } else { &stone };
        builder.shape(&format!("ball {k}"), Shape::Icosphere { level, inward: false }, material, place);
    }
    let mut scene = builder.finish("balls").expect("a scene");
    let bins = BinLayout::EqualAngle { theta: 6, phi: 8 };
    scene.settings = scene.settings.bins(bins).lamps(Lamps::Sampled);
    scene
}

/// The same, a part of them glossy, on a floor that is glossy and blocks nothing: triangles of all classes, and clusters and volumes of each.
pub fn balls_on_a_glossy_floor() -> Scene {
    let mut scene = balls(4, 2, true);
    let floor = scene.materials.iter_mut().find(|material| material.name == "floor").expect("a floor");
    (floor.specular, floor.power) = ([0.05; 3], 20.0);
    scene
}
