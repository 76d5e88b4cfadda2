//! Random scenes, the same on every run.

pub use super::kit::Random;
use antirad::scene::{Material, Scene, Triangle};

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
    Scene::new("random", vertices, list, materials).map(super::implicit).expect("a scene")
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
