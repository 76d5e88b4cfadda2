//! Derivatives of pictures: with respect to colours against the transpose, to geometry against differences of far finer pictures.

use antirad::image::{ImageError, PictureOptions, Rasterizer};
use antirad::ranks::Ranks;
use antirad::scene::{Camera, Material, Scene};
use antirad_render::image::{CameraGradient, GeometryGradient, geometry_gradient, geometry_gradient_of};
use glam::{DQuat, DVec3};

use crate::scenes::{Random, above, finish, flipped, grid, scene, square, together};
use crate::support::backend;

/// Width and height of the pictures whose derivatives are taken.
const SIZE: [u32; 2] = [36, 27];

/// Refinement in each direction of the pictures that differences are taken of, with 16 x 16 samples per pixel.
const FINE: u32 = 6;

/// A loss linear in the pixels, with slowly varying weights, so that differences over part of a pixel are smooth.
fn cotangent(width: u32, height: u32) -> Vec<[f64; 4]> {
    let pixel = |at: u32| {
        let (x, y) = (f64::from(at % width) / f64::from(width), f64::from(at / width) / f64::from(height));
        [0.3, 1.7, 2.9, 4.1].map(|phase: f64| 0.7 + (4.0 * x + phase).sin() * (3.0 * y - phase).cos())
    };
    (0..width * height).map(pixel).collect()
}

/// The same cotangent on a picture `times` finer in each direction.
fn finer(cotangent: &[[f64; 4]], width: u32, height: u32, times: u32) -> Vec<[f64; 4]> {
    let columns = width * times;
    let pixel = |at: u32| {
        let coarse = at / columns / times * width + at % columns / times;
        cotangent[coarse as usize].map(|value| value / f64::from(times * times))
    };
    (0..columns * height * times).map(pixel).collect()
}

/// A scene and a camera in uniform motion from time 0 to 1.
struct Motion<'a> {
    scene: Scene,
    colours: Vec<[f32; 3]>,
    camera: Camera,
    /// Velocity of each vertex.
    vertices: &'a (dyn Fn(usize) -> DVec3 + Sync),
    /// Velocity of the camera's position.
    position: DVec3,
    /// Velocity of the camera's target.
    target: DVec3,
    /// Velocity of the camera's up.
    up: DVec3,
}

impl<'a> Motion<'a> {
    fn new(scene: Scene, camera: Camera, vertices: &'a (dyn Fn(usize) -> DVec3 + Sync)) -> Self {
        let colours = Random::new(5).colours(&scene);
        let none = DVec3::ZERO;
        Self { scene, colours, camera, vertices, position: none, target: none, up: none }
    }

    /// The scene, the camera with a picture `times` finer in each direction, and the cotangent of that picture.
    fn at(&self, time: f64, times: u32) -> (Scene, Camera, Vec<[f64; 4]>) {
        let (mut scene, mut camera) = (self.scene.clone(), self.camera.clone());
        for (number, vertex) in scene.vertices.iter_mut().enumerate() {
            *vertex += time * (self.vertices)(number);
        }
        camera.position += time * self.position;
        camera.target += time * self.target;
        camera.up += time * self.up;
        let cotangent = cotangent(camera.width, camera.height);
        let cotangent = finer(&cotangent, camera.width, camera.height, times);
        (camera.width, camera.height) = (camera.width * times, camera.height * times);
        (scene, camera, cotangent)
    }

    fn loss(&self, rasterizer: &Rasterizer, time: f64) -> f64 {
        let (scene, camera, cotangent) = self.at(time, FINE);
        let pixels = rasterizer.coverage(&scene, &camera, 16).unwrap().pixels(&self.colours).unwrap();
        let adjoint =
            |(pixel, adjoint): (&[f64; 4], &[f64; 4])| (0..4).map(|i| pixel[i] * adjoint[i]).sum::<f64>();
        pixels.iter().zip(&cotangent).map(adjoint).sum()
    }

    fn gradient(&self, time: f64, side: u32, times: u32) -> GeometryGradient {
        let (scene, camera, cotangent) = self.at(time, times);
        geometry_gradient(&scene, &camera, side, &self.colours, &cotangent).unwrap()
    }

    /// The derivative of the loss with respect to time.
    fn slope(&self, time: f64, side: u32, times: u32) -> f64 {
        let gradient = self.gradient(time, side, times);
        let vertices = gradient.vertices.iter().enumerate();
        vertices.map(|(number, of_vertex)| of_vertex.dot((self.vertices)(number))).sum::<f64>()
            + gradient.camera.position.dot(self.position)
            + gradient.camera.target.dot(self.target)
            + gradient.camera.up.dot(self.up)
    }

    /// A relative error, which must be finite: maxima ignore NaN.
    fn error(value: f64, right: f64, size: f64) -> f64 {
        let error = (value - right).abs() / size;
        assert!(error.is_finite(), "{value} {right} {size}");
        error
    }

    /// With 8 lines per pixel, relative to the size of the slope: the mean slope over each quarter of the time against the
    /// difference of the loss, and the slope at a time against that with far more lines.
    fn check(&self, rasterizer: &Rasterizer, mean_bound: f64, single_bound: f64) {
        let losses = [0.0, 0.25, 0.5, 0.75, 1.0].map(|time| self.loss(rasterizer, time));
        let slopes: Vec<f64> = losses.windows(2).map(|pair| (pair[1] - pair[0]) / 0.25).collect();
        let size = (slopes.iter().map(|slope| slope * slope).sum::<f64>() / 4.0).sqrt();
        assert!(size > 1.0, "{size}");
        let (mut of_mean, mut of_single) = (0.0, 0.0);
        for (quarter, slope) in (0..).zip(slopes) {
            let time = |step: u32| f64::from(quarter) / 4.0 + (f64::from(step) + 0.5) / 64.0;
            let single: Vec<f64> = (0..16).map(|step| self.slope(time(step), 8, 1)).collect();
            let mean = single.iter().sum::<f64>() / 16.0;
            of_mean = f64::max(of_mean, Self::error(mean, slope, size));
            for (step, single) in (0..).zip(single).step_by(5) {
                let right = self.slope(time(step), 16, FINE);
                of_single = f64::max(of_single, Self::error(single, right, size));
            }
        }
        println!("mean {of_mean:.1e}, single {of_single:.1e}, of {size:.2}");
        assert!(of_mean <= mean_bound, "{of_mean:e}");
        assert!(of_single <= single_bound, "{of_single:e}");
    }
}

/// Runs checks on the backend under test.
fn on_backend(checks: impl FnOnce(&Rasterizer)) {
    let backend = backend();
    let rasterizer = Rasterizer::new(&backend).unwrap();
    checks(&rasterizer);
    drop(rasterizer);
    finish(backend);
}

fn camera() -> Camera {
    Camera {
        up: DVec3::new(0.1, 1.0, 0.0),
        position: DVec3::new(0.2, 0.1, 1.2),
        fov_x_degrees: 60.0,
        ..above(SIZE[0], SIZE[1])
    }
}

/// The six sides of a cube, fronts outwards: 24 vertices, 12 triangles.
fn cube(half: f64, turn: DQuat, centre: DVec3) -> Scene {
    let side = |normal: DVec3, across: DVec3| {
        let up = normal.cross(across);
        grid(1, 1, move |x, y| {
            centre + turn * (half * (normal + (2.0 * x - 1.0) * across + (2.0 * y - 1.0) * up))
        })
    };
    let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
    together(&[side(x, y), side(-x, z), side(y, z), side(-y, x), side(z, x), side(-z, y)])
}

/// A cube in the air.
fn flying() -> Scene {
    let turn = DQuat::from_rotation_x(0.5) * DQuat::from_rotation_y(0.7) * DQuat::from_rotation_z(0.2);
    cube(0.2, turn, DVec3::new(-0.05, 0.05, 0.0))
}

/// Behind the cube.
fn wall() -> Scene {
    grid(1, 1, |x, y| DVec3::new(3.0 * x - 1.5, 3.0 * y - 1.5, -0.5 - 0.2 * x))
}

/// A cube, a wall behind it, and two strips in front of it, one of which shows its black back.
fn hidden() -> Scene {
    let strip = |low: f64, z: f64| {
        grid(1, 1, move |x, y| DVec3::new(0.3 * x - 0.2, low + 0.1 * y + 0.03 * x, z - 0.1 * x))
    };
    together(&[flying(), wall(), strip(0.0, 0.5), flipped(strip(0.14, 0.4))])
}

/// Moves only the first mesh, a cube.
fn cube_moves(by: DVec3) -> impl Fn(usize) -> DVec3 {
    move |vertex| if vertex < 24 { by } else { DVec3::ZERO }
}

const FLIGHT: DVec3 = DVec3::new(0.06, 0.04, 0.05);

#[test]
fn colours_have_the_transpose_of_the_picture() {
    on_backend(|rasterizer| {
        let scene = hidden();
        // Several bands, and a size that is not a multiple of tiles.
        let camera = Camera { width: 701, height: 333, ..camera() };
        let mut random = Random::new(3);
        let colours = random.colours(&scene);
        let adjoint: Vec<[f64; 4]> = (0..701 * 333).map(|_| [0; 4].map(|_| random.next() - 0.5)).collect();
        for side in [1, 2, 8] {
            let coverage = rasterizer.coverage(&scene, &camera, side).unwrap();
            let pixels = coverage.pixels(&colours).unwrap();
            let picture = coverage.picture(&colours).unwrap();
            let options = PictureOptions::default().supersample(side);
            assert_eq!(picture, rasterizer.render(&scene, &camera, &colours, &options).unwrap());

            // Samples, one by one.
            let samples = rasterizer.visible_samples(&scene, &camera, side).unwrap();
            let mut alpha = vec![0u32; pixels.len()];
            for (at, &face) in (0..).zip(&samples) {
                let (row, column) = (at / (701 * side), at % (701 * side));
                alpha[(row / side * 701 + column / side) as usize] += u32::from(face != u32::MAX);
            }
            for (pixel, alpha) in pixels.iter().zip(alpha) {
                assert_eq!(pixel[3], f64::from(alpha) / f64::from(side * side));
            }

            let gradient = coverage.colour_gradient(&adjoint).unwrap();
            assert_eq!(gradient, coverage.clone().colour_gradient(&adjoint).unwrap());
            let rgb = |pixel: &[f64; 4]| DVec3::new(pixel[0], pixel[1], pixel[2]);
            let there: f64 = pixels.iter().zip(&adjoint).map(|(a, b)| rgb(a).dot(rgb(b))).sum();
            let back: f64 = gradient.iter().zip(&colours).map(|(a, b)| a.dot(b.map(f64::from).into())).sum();
            let size: f64 = pixels.iter().zip(&adjoint).map(|(a, b)| rgb(a).dot(rgb(b)).abs()).sum();
            assert!((there - back).abs() <= 1e-13 * size, "{there} {back}");
            // Backs are black whatever their colour; the last strip shows its back.
            assert!(gradient[gradient.len() - 2..].iter().all(|of_back| *of_back == DVec3::ZERO));
            assert!(gradient[gradient.len() - 4].length() > 0.0);
        }
    });
}

/// Coverage of moved vertices is that computed anew, to the last sample.
#[test]
fn coverage_follows_what_moves() {
    on_backend(|rasterizer| {
        let mut before = hidden();
        // The cube and all else; lit, then dark.
        before.materials.push(Material { emission: [1.0; 3], ..before.materials[0].clone() });
        before.triangles[..12].iter_mut().for_each(|triangle| triangle.material = 1);
        // Several bands, and a size that is not a multiple of tiles.
        let camera = Camera { width: 301, height: 203, ..camera() };
        let mut random = Random::new(5);
        let mut jump = || DVec3::from_array([0; 3].map(|_| random.next() - 0.5));
        let all: Vec<DVec3> = before.vertices.iter().map(|_| 0.2 * jump()).collect();
        let moves: [&dyn Fn(usize) -> DVec3; 6] = [
            &cube_moves(FLIGHT),
            &cube_moves(DVec3::ZERO),
            // Out of the picture, and around the camera.
            &cube_moves(DVec3::new(40.0, 0.0, 0.0)),
            &cube_moves(camera.position - before.vertices[0]),
            &|vertex| if vertex == 3 { DVec3::new(0.1, -0.05, 0.0) } else { DVec3::ZERO },
            &|vertex| all[vertex],
        ];
        for side in [1, 4, 16] {
            let old = rasterizer.coverage(&before, &camera, side).unwrap();
            for (number, by) in moves.iter().enumerate() {
                let mut scene = before.clone();
                scene.vertices.iter_mut().enumerate().for_each(|(vertex, at)| *at += by(vertex));
                let new = rasterizer.coverage(&scene, &camera, side).unwrap();
                let moved = |from: &Scene, coverage| {
                    rasterizer.coverage_of_moved(&scene, &camera, side, (&from.vertices, coverage)).unwrap()
                };
                assert!(moved(&before, &old) == new, "move {number}, {side} samples");
                assert_eq!(number != 1, old != new, "move {number}");
                // A coverage of something else is of no use, and does no harm.
                let other =
                    rasterizer.coverage(&before, &Camera { width: 64, ..camera.clone() }, side).unwrap();
                assert!(moved(&before, &other) == new);
            }
        }
    });
}

/// Pixels at edges of lamps have the shares that 16 x 16 samples give, others those of the samples asked for.
#[test]
fn edges_of_lamps_have_more_samples() {
    on_backend(|rasterizer| {
        let dark = hidden();
        let camera = Camera { width: 150, height: 101, ..camera() };
        let mut lit = dark.clone();
        lit.materials.push(Material { emission: [1.0; 3], ..dark.materials[0].clone() });
        lit.triangles[..12].iter_mut().for_each(|triangle| triangle.material = 1);
        let colours: Vec<[f32; 3]> =
            (0..lit.triangles.len()).map(|t| if t < 12 { [1.0; 3] } else { [0.0; 3] }).collect();
        let pixels = |scene: &Scene, side| {
            rasterizer.coverage(scene, &camera, side).unwrap().pixels(&colours).unwrap()
        };
        let [coarse, fine, found] = [pixels(&dark, 4), pixels(&dark, 16), pixels(&lit, 4)];
        let edges = fine.iter().filter(|pixel| pixel[0] > 0.0 && pixel[0] < 1.0).count();
        let differ = coarse.iter().zip(&fine).filter(|(coarse, fine)| coarse[0] != fine[0]).count();
        assert!(differ > edges / 2 && edges > 100, "{differ} of {edges}");
        for (found, fine) in found.iter().zip(&fine) {
            assert_eq!(found[0], fine[0]);
        }
        // A lamp smaller than a pixel, between samples, before nothing.
        let mut small = lit.clone();
        small.triangles.truncate(12);
        let centre = small.vertices[..24].iter().sum::<DVec3>() / 24.0;
        small.vertices[..24].iter_mut().for_each(|at| *at = centre + 0.02 * (*at - centre));
        let colours = [[1.0f32; 3]; 12];
        let pixels = |side| rasterizer.coverage(&small, &camera, side).unwrap().pixels(&colours).unwrap();
        let all = |side| pixels(side).iter().map(|pixel| pixel[0]).sum::<f64>();
        assert!(all(16) > 0.0);
        assert_eq!(all(4), all(16));
    });
}

/// Derivatives by some vertices are those among all.
#[test]
fn edges_of_what_moves_are_those_of_all() {
    let (scene, camera) = (hidden(), camera());
    let mut random = Random::new(8);
    let colours = random.colours(&scene);
    let pixels = (camera.width * camera.height) as usize;
    let adjoint: Vec<[f64; 4]> = (0..pixels).map(|_| [0; 4].map(|_| random.next() - 0.5)).collect();
    let shown = |face: usize, places: &[[f64; 2]]| vec![colours[face].map(f64::from); places.len()];
    let gradient = |movable: Option<&[u32]>| {
        geometry_gradient_of(&Ranks::default(), &scene, &camera, 4, &shown, &adjoint, movable).unwrap()
    };
    let all = gradient(None);
    assert_eq!(all, geometry_gradient(&scene, &camera, 4, &colours, &adjoint).unwrap());
    let cube: Vec<u32> = (0..24).collect();
    let of_cube = gradient(Some(&cube));
    assert_eq!(of_cube.vertices[..24], all.vertices[..24]);
    assert!(all.vertices[24..].iter().any(|by| *by != DVec3::ZERO));
    assert!(of_cube.vertices[24..].iter().all(|by| *by == DVec3::ZERO));
    assert_eq!(of_cube.camera, CameraGradient::default());
    assert!(all.camera.position != DVec3::ZERO);
}

/// The area of a rectangle is exact wherever the lines are, hence its derivative too.
#[test]
fn a_rectangle_that_grows_gains_its_area() {
    let mut random = Random::new(9);
    for side in [1, 2, 4, 8, 16] {
        for _ in 0..20 {
            let mut place = || (random.next() - 0.5) / 10.0;
            let (centre, half) = (DVec3::new(place(), place(), 0.0), 0.5 + place());
            let mut scene = square(half, 0.0);
            scene.vertices.iter_mut().for_each(|vertex| *vertex += centre);
            let camera = above(32, 32);
            let alpha = vec![[0.0, 0.0, 0.0, 1.0]; 32 * 32];
            let colours = Random::new(1).colours(&scene);
            let gradient = geometry_gradient(&scene, &camera, side, &colours, &alpha).unwrap();
            let grown: f64 =
                gradient.vertices.iter().zip(&scene.vertices).map(|(g, &v)| g.dot(v - centre)).sum::<f64>()
                    / half;
            // 16 pixels a metre.
            let expected = 8.0 * half * 16.0 * 16.0;
            assert!((grown / expected - 1.0).abs() <= 1e-12, "{grown} {expected}");
            let moved: DVec3 = gradient.vertices.iter().sum();
            assert!(moved.x.abs().max(moved.y.abs()) <= 1e-12 * expected, "{moved}");
            // Closer by dz is larger by dz over the distance of 1 m.
            assert!((moved.z / (2.0 * half * half * 4.0 * 256.0) - 1.0).abs() <= 0.01, "{moved}");
        }
    }
}

#[test]
fn silhouettes_move_in_front_of_the_background() {
    on_backend(|rasterizer| {
        Motion::new(flying(), camera(), &|_| FLIGHT).check(rasterizer, 2e-3, 5e-3);
    });
}

#[test]
fn silhouettes_move_in_front_of_other_faces() {
    on_backend(|rasterizer| {
        let scene = together(&[flying(), wall()]);
        Motion::new(scene, camera(), &cube_moves(FLIGHT)).check(rasterizer, 1e-3, 4e-3);
    });
}

#[test]
fn hidden_parts_of_edges_do_not_count() {
    on_backend(|rasterizer| {
        Motion::new(hidden(), camera(), &cube_moves(FLIGHT)).check(rasterizer, 5e-3, 2.5e-2);
        // The occluders move.
        let strips = |vertex: usize| if vertex < 28 { DVec3::ZERO } else { FLIGHT };
        Motion::new(hidden(), camera(), &strips).check(rasterizer, 7e-3, 8e-2);
    });
}

#[test]
fn cameras_move_and_turn() {
    on_backend(|rasterizer| {
        let still = Motion::new(hidden(), camera(), &|_| DVec3::ZERO);
        let by = DVec3::new(0.1, 0.05, 0.08);
        let moving = Motion { position: by, ..still };
        moving.check(rasterizer, 8e-3, 4e-2);
        let turning = Motion { position: DVec3::ZERO, target: by, ..moving };
        turning.check(rasterizer, 5e-3, 4e-2);
        // A cube at the side, whose picture moves as the camera rolls.
        let aside = Camera { target: DVec3::new(0.5, 0.2, 0.0), ..camera() };
        let rolling = DVec3::new(0.2, 0.1, 0.1);
        Motion { up: rolling, ..Motion::new(flying(), aside, &|_| DVec3::ZERO) }
            .check(rasterizer, 2e-3, 5e-3);
    });
}

#[test]
fn edges_between_colours_move() {
    on_backend(|rasterizer| {
        let surface = grid(3, 3, |x, y| DVec3::new(x / 3.0 - 0.5, y / 3.0 - 0.5, 0.1 * x));
        let one = |vertex: usize| if vertex == 5 { 2.0 * FLIGHT } else { DVec3::ZERO };
        Motion::new(surface, camera(), &one).check(rasterizer, 2e-3, 4e-3);
    });
}

#[test]
fn geometry_outside_the_picture_does_not_count() {
    on_backend(|rasterizer| {
        let scene = together(&[flying(), wall()]);
        let close = Camera { fov_x_degrees: 25.0, ..camera() };
        Motion::new(scene, close, &cube_moves(FLIGHT)).check(rasterizer, 1e-3, 8e-3);
    });
}

#[test]
fn edges_reach_from_behind_the_camera_to_the_horizon() {
    on_backend(|rasterizer| {
        let floor = grid(3, 3, |x, y| DVec3::new(x * 4.0 - 6.0, -1.0, 3.0 - y * 2.0));
        let camera = Camera { target: DVec3::new(0.2, -0.3, 0.0), ..above(SIZE[0], SIZE[1]) };
        Motion::new(floor, camera, &|_| DVec3::new(0.3, -0.1, 0.2)).check(rasterizer, 1.5e-3, 8e-3);
    });
}

#[test]
fn faces_pass_through_each_other() {
    on_backend(|rasterizer| {
        let mut sunk = flying();
        sunk.vertices.iter_mut().for_each(|vertex| vertex.z -= 0.6);
        let scene = together(&[sunk, wall()]);
        let out = cube_moves(DVec3::new(0.02, 0.03, 0.1));
        Motion::new(scene.clone(), camera(), &out).check(rasterizer, 1.5e-3, 2e-2);
        let into = |vertex: usize| if vertex < 24 { DVec3::ZERO } else { DVec3::new(0.0, 0.0, 0.05) };
        Motion::new(scene, camera(), &into).check(rasterizer, 1.5e-3, 2.5e-2);
    });
}

/// A cube on a floor: its lowest edges lie in the plane of the floor.
#[test]
fn a_cube_slides_on_a_floor() {
    on_backend(|rasterizer| {
        let floor = grid(1, 1, |x, y| DVec3::new(4.0 * x - 2.0, -0.2, 2.0 - 4.0 * y));
        let scene = together(&[cube(0.2, DQuat::from_rotation_y(0.3), DVec3::ZERO), floor]);
        let slide = cube_moves(DVec3::new(0.07, 0.0, 0.05));
        let camera = Camera { position: DVec3::new(0.2, 0.5, 1.1), ..camera() };
        Motion::new(scene, camera, &slide).check(rasterizer, 3e-3, 1.5e-2);
    });
}

#[test]
fn random_triangles_move_all_at_once() {
    on_backend(|rasterizer| {
        let mut random = Random::new(7);
        // All around the camera: some cross its plane, some are behind it.
        let mut point = |size: f64| DVec3::from_array([0; 3].map(|_| (random.next() - 0.5) * size));
        let mut vertices = Vec::new();
        for _ in 0..80 {
            let centre = point(6.0);
            vertices.extend([0; 3].map(|_| centre + point(2.5)));
        }
        let velocity: Vec<DVec3> = vertices.iter().map(|_| point(0.2)).collect();
        let triangles: Vec<[u32; 3]> = (0..80).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect();
        let scene = scene(vertices, &triangles);
        let camera = Camera {
            target: DVec3::X,
            fov_x_degrees: 100.0,
            position: DVec3::splat(0.1),
            ..above(SIZE[0], SIZE[1])
        };
        let velocities = |vertex: usize| velocity[vertex];
        let by = DVec3::new(-0.05, 0.08, 0.03);
        Motion { position: by, ..Motion::new(scene, camera, &velocities) }.check(rasterizer, 1.5e-2, 8e-2);
    });
}

/// Edges inside a surface of one colour have no derivative: between faces with common vertices, with vertices of their own, and of
/// different sizes, near the origin and far from it.
#[test]
fn edges_within_one_colour_have_no_derivative() {
    let tilt = DQuat::from_rotation_x(0.7) * DQuat::from_rotation_z(0.4);
    for offset in [DVec3::ZERO, DVec3::new(1e4, -2e4, 3e4)] {
        let half = |columns: u32, rows: u32, left: f64| {
            let (width, height) = (f64::from(columns), f64::from(rows));
            grid(columns, rows, move |x, y| {
                offset + tilt * DVec3::new(left + 0.4 * x / width, 0.8 * y / height - 0.4, 0.0)
            })
        };
        let surface = together(&[half(7, 9, -0.4), half(5, 13, 0.0)]);
        let apart = surface.triangles.iter().flat_map(|t| t.vertices.map(|v| surface.vertices[v as usize]));
        let own = scene(
            apart.collect(),
            &(0..surface.triangles.len() as u32).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect::<Vec<_>>(),
        );
        let place = above(SIZE[0], SIZE[1]);
        let camera = Camera { position: place.position + offset, target: place.target + offset, ..place };
        let cotangent = cotangent(SIZE[0], SIZE[1]);
        for scene in [&surface, &own] {
            let colours = vec![[0.9f32, 0.5, 0.2]; scene.triangles.len()];
            let gradient = geometry_gradient(scene, &camera, 8, &colours, &cotangent).unwrap();
            let mut outline = 0;
            for (of_vertex, &vertex) in gradient.vertices.iter().zip(&scene.vertices) {
                let at = tilt.inverse() * (vertex - offset);
                let inside = at.x.abs().max(at.y.abs()) < 0.399;
                outline += usize::from(of_vertex.length() > 0.1);
                assert!(!inside || *of_vertex == DVec3::ZERO, "{at} {of_vertex}");
            }
            assert!(outline > 20, "{outline}");
        }
    }
}

/// A motion of scene and camera together changes nothing; and the result depends only on the input, to the last bit.
#[test]
fn rigid_motion_and_threads_change_nothing() {
    let still = Motion::new(hidden(), camera(), &|_| DVec3::ZERO);
    let gradient = still.gradient(0.0, 8, 1);
    let sum = gradient.vertices.iter().sum::<DVec3>() + gradient.camera.position + gradient.camera.target;
    let size: f64 = gradient.vertices.iter().map(|of_vertex| of_vertex.length()).sum();
    assert!(sum.length() <= 1e-13 * size, "{sum} {size}");
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert_eq!(pool.install(|| still.gradient(0.0, 8, 1)), gradient);
    }
}

#[test]
fn mismatched_input_is_refused() {
    on_backend(|rasterizer| {
        let (scene, camera) = (square(1.0, 0.0), above(8, 8));
        let (colours, adjoint) = ([[1.0; 3]; 2], [[1.0; 4]; 64]);
        let coverage = rasterizer.coverage(&scene, &camera, 2).unwrap();
        assert_eq!((coverage.width(), coverage.height()), (8, 8));
        let error = coverage.pixels(&colours[1..]).unwrap_err();
        assert!(matches!(error, ImageError::Colours { given: 1, wanted: 2 }));
        let error = coverage.colour_gradient(&adjoint[1..]).unwrap_err();
        assert!(matches!(error, ImageError::CotangentLength { given: 63, wanted: 64 }));
        let error = geometry_gradient(&scene, &camera, 2, &colours, &adjoint[1..]).unwrap_err();
        assert!(matches!(error, ImageError::CotangentLength { given: 63, wanted: 64 }));
        let error = geometry_gradient(&scene, &camera, 2, &colours[1..], &adjoint).unwrap_err();
        assert!(matches!(error, ImageError::Colours { given: 1, wanted: 2 }));
        let error = geometry_gradient(&scene, &camera, 3, &colours, &adjoint).unwrap_err();
        assert!(matches!(error, ImageError::Supersample(3)));
        for wrong in [f64::NAN, f64::INFINITY] {
            let mut adjoint = adjoint;
            adjoint[5][2] = wrong;
            let error = coverage.colour_gradient(&adjoint).unwrap_err();
            assert!(matches!(error, ImageError::CotangentNotFinite { pixel: 5 }));
            let error = geometry_gradient(&scene, &camera, 2, &colours, &adjoint).unwrap_err();
            assert!(matches!(error, ImageError::CotangentNotFinite { pixel: 5 }));
        }
    });
}
