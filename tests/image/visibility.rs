//! The visible face of each sample.

use antirad::image::{ImageError, PictureOptions, Rasterizer};
use antirad::scene::{Camera, Material, Scene, SceneError};
use antirad_render::image::{View, geometry_gradient};
use glam::DVec3;

use crate::scenes::{Random, above, flipped, grid, on_each, rays, scene, square, together, trace};

const NONE: u32 = u32::MAX;

/// Compares every sample with the ray tracer; returns the share of samples where that is ambiguous.
fn compare(rasterizer: &Rasterizer, scene: &Scene, camera: &Camera, side: u32) -> f64 {
    let samples = rasterizer.visible_samples(scene, camera, side).unwrap();
    assert_eq!(samples.len(), (camera.width * camera.height * side * side) as usize);
    let mut doubtful = 0;
    for (at, (ray, seen)) in rays(camera, side).zip(&samples).enumerate() {
        let (hit, doubt) = trace(scene, camera.position, ray);
        doubtful += usize::from(doubt);
        assert!(doubt || hit.map_or(NONE, |hit| hit.face) == *seen, "sample {at}: {seen}, not {hit:?}");
    }
    doubtful as f64 / samples.len() as f64
}

#[test]
fn random_triangles_are_seen_as_a_ray_tracer_sees_them() {
    on_each(|rasterizer, _| {
        let mut random = Random::new(7);
        // All around the camera: some cross its plane, some are behind it.
        let mut point = |size: f64| DVec3::from_array([0; 3].map(|_| (random.next() - 0.5) * size));
        let mut vertices = Vec::new();
        for _ in 0..150 {
            let centre = point(6.0);
            vertices.extend([0; 3].map(|_| centre + point(2.5)));
        }
        let triangles: Vec<[u32; 3]> = (0..150).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let scene = scene(vertices, &triangles);
        for (target, fov_x_degrees) in [(DVec3::X, 60.0), (DVec3::new(-1.0, 2.0, 0.5), 150.0)] {
            let camera = Camera { target, fov_x_degrees, position: DVec3::splat(0.1), ..above(61, 43) };
            assert!(compare(rasterizer, &scene, &camera, 2) < 0.05);
        }
    });
}

#[test]
fn a_floor_reaches_from_behind_the_camera_to_the_horizon() {
    on_each(|rasterizer, _| {
        let floor = grid(3, 3, |x, y| DVec3::new(x * 80.0 - 100.0, -1.0, 110.0 - y * 70.0));
        let camera = Camera { position: DVec3::ZERO, target: -DVec3::Z, ..above(64, 64) };
        assert!(compare(rasterizer, &floor, &camera, 2) < 0.05);
        // Exactly in the plane of the floor nothing is visible.
        let camera = Camera { position: -DVec3::Y, target: DVec3::new(0.0, -1.0, -1.0), ..camera };
        let samples = rasterizer.visible_samples(&floor, &camera, 1).unwrap();
        assert!(samples.iter().all(|&face| face == NONE));
    });
}

#[test]
fn subdivided_surfaces_have_no_cracks() {
    on_each(|rasterizer, _| {
        let tilt = glam::DQuat::from_rotation_x(0.7) * glam::DQuat::from_rotation_z(0.4);
        let surface = grid(37, 29, |x, y| tilt * DVec3::new(x / 37.0 - 0.5, y / 29.0 - 0.5, 0.0));
        let outline = grid(1, 1, |x, y| tilt * DVec3::new(x - 0.5, y - 0.5, 0.0));
        // Far from the origin too, where coordinates have few digits left.
        for offset in [DVec3::ZERO, DVec3::new(1e4, -2e4, 3e4)] {
            let camera = Camera { up: DVec3::new(0.3, 1.0, 0.0), ..above(200, 150) };
            let moved = Camera {
                position: camera.position + offset,
                target: camera.target + offset,
                ..camera.clone()
            };
            let mut scene = surface.clone();
            scene.vertices.iter_mut().for_each(|vertex| *vertex += offset);
            let samples = rasterizer.visible_samples(&scene, &moved, 4).unwrap();
            let mut inside = 0;
            for (ray, face) in rays(&camera, 4).zip(samples) {
                let hit = trace(&outline, camera.position, ray).0;
                if hit.is_some_and(|hit| hit.weights.iter().all(|&weight| weight > 1e-4)) {
                    inside += 1;
                    assert_ne!(face, NONE);
                }
            }
            assert!(inside > 50_000, "{inside}");
        }
        // A rough surface with a vertex behind every sample: the edges around it all pass through the sample.
        let camera =
            Camera { up: DVec3::new(0.3, 1.0, 0.2), position: DVec3::new(3.0, 0.7, -2.0), ..above(97, 61) };
        let view = View::new(&camera);
        let mut random = Random::new(2);
        let mut rough = grid(96, 60, |x, y| view.ray(x + 0.5, y + 0.5));
        for vertex in &mut rough.vertices {
            *vertex = camera.position + *vertex * (2.0 + random.next());
        }
        let samples = rasterizer.visible_samples(&rough, &camera, 1).unwrap();
        assert!(samples.iter().all(|&face| face != NONE));
    });
}

/// More pairs of tile and face than one dispatch takes.
#[test]
fn the_nearest_of_many_layers_is_seen() {
    on_each(|rasterizer, _| {
        let layers: Vec<Scene> = (0..40).map(|i| square(3.0, -f64::from((i * 17 + 5) % 40) / 20.0)).collect();
        let nearest = (0..40).find(|i| (i * 17 + 5) % 40 == 0).unwrap();
        let samples = rasterizer.visible_samples(&together(&layers), &above(160, 160), 4).unwrap();
        assert!(samples.iter().all(|&face| face / 2 == nearest));
    });
}

#[test]
fn the_front_of_a_two_sided_sheet_is_seen() {
    on_each(|rasterizer, _| {
        let turn = glam::DQuat::from_rotation_y(0.9) * glam::DQuat::from_rotation_x(0.3);
        let sheet = grid(7, 5, |x, y| turn * DVec3::new(x / 7.0 - 0.5, y / 5.0 - 0.5, 0.0));
        let front = sheet.triangles.len() as u32;
        let scene = together(&[flipped(sheet.clone()), sheet.clone(), sheet]);
        let samples = rasterizer.visible_samples(&scene, &above(100, 80), 2).unwrap();
        assert!(samples.iter().any(|&face| face != NONE));
        assert!(samples.iter().all(|&face| face == NONE || (front..2 * front).contains(&face)));
    });
}

/// A picture of several bands, of a size that is not a multiple of tiles; and the memory that it takes.
#[test]
fn bands_do_not_show() {
    on_each(|rasterizer, backend| {
        let scene = together(&[
            square(0.4, 0.2),
            grid(2, 2, |x, y| DVec3::new(1.2 * x - 1.5, 0.7 * y - 0.5, 0.3 * x - 1.0)),
        ]);
        let camera = Camera { up: DVec3::new(0.2, 1.0, 0.0), ..above(1001, 167) };
        assert!(compare(rasterizer, &scene, &camera, 4) < 0.01);

        let options = PictureOptions::default().supersample(4);
        let mut lit = scene.clone();
        lit.materials.push(Material { emission: [1.0; 3], ..lit.materials[0].clone() });
        lit.triangles[0].material = 1;
        rasterizer.coverage(&lit, &camera, 4).unwrap();
        let kind = backend.kind();
        let planned = Rasterizer::bytes(kind, scene.triangles.len(), &camera, &options).unwrap();
        assert!(planned < 64 << 20);
        assert_eq!(backend.memory().peak, planned);
        assert_eq!(backend.memory().in_use, 0);
        for supersample in [1, 2, 4, 8, 16] {
            let camera = Camera { width: 16384, height: 16384, ..camera.clone() };
            let options = PictureOptions::default().supersample(supersample);
            assert!(Rasterizer::bytes(kind, 10_000_000, &camera, &options).unwrap() < 64 << 20);
        }
    });
}

#[test]
fn invalid_input_is_refused() {
    on_each(|rasterizer, _| {
        let scene = square(1.0, 0.0);
        for supersample in [0, 3, 32] {
            let error = rasterizer.visible_samples(&scene, &above(8, 8), supersample).unwrap_err();
            assert!(matches!(error, ImageError::Supersample(given) if given == supersample));
        }
        let options = PictureOptions::default();
        let error = rasterizer.render(&scene, &above(8, 8), &[[1.0; 3]], &options).unwrap_err();
        assert!(matches!(error, ImageError::Colours { given: 1, wanted: 2 }));
        let nowhere = Camera { target: DVec3::Z, ..above(8, 8) };
        let error = rasterizer.render(&scene, &nowhere, &[[1.0; 3]; 2], &options).unwrap_err();
        assert!(matches!(error, ImageError::Scene(SceneError::Camera { .. })));

        // Cameras and scenes built by code.
        let sound = above(8, 8);
        let cameras = [
            Camera { position: DVec3::NAN, ..sound.clone() },
            Camera { up: sound.target - sound.position, ..sound.clone() },
            Camera { fov_x_degrees: f64::NAN, ..sound.clone() },
            Camera { width: 0, ..sound.clone() },
        ];
        let pictures = |scene: &Scene, camera: &Camera| -> [Option<ImageError>; 4] {
            let (colours, pixels) =
                ([[1.0_f32; 3]; 2], vec![[1.0; 4]; (camera.width * camera.height) as usize]);
            [
                rasterizer.render(scene, camera, &colours, &options).err(),
                rasterizer.coverage(scene, camera, 1).err(),
                rasterizer.visible_samples(scene, camera, 1).err(),
                geometry_gradient(scene, camera, 1, &colours, &pixels).err(),
            ]
        };
        for camera in &cameras {
            for refused in pictures(&scene, camera) {
                let named = matches!(refused, Some(ImageError::Scene(SceneError::Camera { .. })));
                assert!(named, "{camera:?}: {refused:?}");
            }
        }
        let [mut indices, mut places] = [scene.clone(), scene.clone()];
        indices.triangles[1].vertices[2] = 99;
        places.vertices[0].x = f64::NAN;
        for scene in [&indices, &places] {
            for refused in pictures(scene, &sound) {
                assert!(matches!(refused, Some(ImageError::Scene(_))), "{refused:?}");
            }
        }
    });
}
