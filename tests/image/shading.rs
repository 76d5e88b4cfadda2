//! Values of pixels.

use antirad::image::{Picture, PictureOptions, Rasterizer};
use antirad::scene::{Camera, Scene};
use glam::{DVec2, DVec3};

use crate::scenes::{Random, above, flipped, grid, on_each, square, together};

const RED: [f32; 3] = [1.0, 0.0, 0.0];
const BLUE: [f32; 3] = [0.0, 0.0, 2.0];

fn flat(rasterizer: &Rasterizer, scene: &Scene, camera: &Camera, colours: &[[f32; 3]]) -> Picture {
    rasterizer.render(scene, camera, colours, &PictureOptions::default()).unwrap()
}

#[test]
fn a_square_covers_its_pixels() {
    on_each(|rasterizer, _| {
        let picture = flat(rasterizer, &square(0.5, 0.0), &above(64, 48), &[RED; 2]);
        assert_eq!((picture.width, picture.height), (64, 48));
        for (at, pixel) in picture.pixels.iter().enumerate() {
            let (x, y) = (at % 64, at / 64);
            let inside = (16..48).contains(&x) && (8..40).contains(&y);
            assert_eq!(*pixel, if inside { [1.0, 0.0, 0.0, 1.0] } else { [0.0; 4] }, "({x}, {y})");
        }
        // Right is right and up is up: only the face below the diagonal, to the right.
        let picture = flat(rasterizer, &square(1.0, 0.0), &above(64, 64), &[RED, BLUE]);
        assert_eq!(picture.pixels[50 * 64 + 40], [1.0, 0.0, 0.0, 1.0]);
        assert_eq!(picture.pixels[10 * 64 + 20], [0.0, 0.0, 2.0, 1.0]);

        // Looking away.
        let away = Camera { target: 2.0 * DVec3::Z, ..above(64, 64) };
        let picture = flat(rasterizer, &square(0.5, 0.0), &away, &[RED; 2]);
        assert!(picture.pixels.iter().all(|pixel| *pixel == [0.0; 4]));
    });
}

#[test]
fn near_faces_hide_far_ones_and_backs_are_black() {
    on_each(|rasterizer, _| {
        let colours = [RED, RED, BLUE, BLUE];
        // A small square in front of a large one, in either order of the list.
        let (far, near) = (square(0.9, 0.0), square(0.2, 0.5));
        let centre = |scene: &Scene, colours: &[[f32; 3]]| {
            let picture = flat(rasterizer, scene, &above(32, 32), colours);
            (picture.pixels[15 * 32 + 15], picture.pixels[6 * 32 + 6])
        };
        let (inner, outer) = ([0.0, 0.0, 2.0, 1.0], [1.0, 0.0, 0.0, 1.0]);
        assert_eq!(centre(&together(&[far.clone(), near.clone()]), &colours), (inner, outer));
        let exchanged = [BLUE, BLUE, RED, RED];
        assert_eq!(centre(&together(&[near.clone(), far.clone()]), &exchanged), (inner, outer));
        let back = together(&[far, flipped(near)]);
        assert_eq!(centre(&back, &colours), ([0.0, 0.0, 0.0, 1.0], outer));
    });
}

#[test]
fn every_face_of_a_large_scene_has_its_colour() {
    on_each(|rasterizer, _| {
        let surface = grid(300, 300, |x, y| DVec3::new(x / 150.0 - 1.0, y / 150.0 - 1.0, 0.0));
        let camera = above(60, 60);
        let colours = Random::new(4).colours(&surface);
        let options = PictureOptions::default().supersample(1);
        let picture = rasterizer.render(&surface, &camera, &colours, &options).unwrap();
        let faces = rasterizer.visible_samples(&surface, &camera, 1).unwrap();
        assert!(faces.iter().any(|&face| face < 2000) && faces.iter().any(|&face| face > 178_000));
        for (pixel, face) in picture.pixels.iter().zip(faces) {
            assert_eq!(pixel[..3], colours[face as usize]);
        }
    });
}

#[test]
fn coverage_of_an_edge_is_its_area() {
    on_each(|rasterizer, _| {
        // The half plane right of a line through the picture, seen from above.
        let normal = DVec2::from_angle(0.4);
        let along = normal.perp();
        let corner = |across: f64, up: f64| {
            let at = 0.1 * normal + across * normal + up * along;
            at.extend(0.0)
        };
        let half_plane = grid(1, 1, |x, y| corner(9.0 * x, 18.0 * y - 9.0));
        for supersample in [2, 4, 16] {
            let options = PictureOptions::default().supersample(supersample);
            let picture = rasterizer.render(&half_plane, &above(32, 32), &[RED; 2], &options).unwrap();
            for (at, pixel) in picture.pixels.iter().enumerate() {
                let low =
                    DVec2::new((at % 32) as f64 / 16.0 - 1.0, 1.0 - (at / 32) as f64 / 16.0 - 1.0 / 16.0);
                // By a much finer grid than that of the picture.
                let fine = 200;
                let place = |i: i32| (f64::from(i) + 0.5) / f64::from(fine) / 16.0;
                let inside = |i: i32| {
                    let at = low + DVec2::new(place(i % fine), place(i / fine));
                    usize::from(at.dot(normal) > 0.1)
                };
                let area = (0..fine * fine).map(inside).sum::<usize>() as f64 / f64::from(fine * fine);
                let error = (f64::from(pixel[3]) - area).abs();
                assert!(error <= 1.0 / f64::from(supersample), "{supersample}: {} for {area}", pixel[3]);
                assert_eq!(pixel[0], pixel[3]);
            }
        }
    });
}
