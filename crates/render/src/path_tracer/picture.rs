//! Path-traced pictures.

use super::lobe::Reflection;
use super::numbers::{Numbers, estimate};
use super::{MonteCarloEstimate, PathTracer};
use crate::image::{Picture, View};
use antirad_base::parallel;
use antirad_scene::Camera;
use glam::DVec3;
use rayon::prelude::*;
use std::ops::ControlFlow;

/// A pixel: the mean over its area.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TracedPixel {
    /// Radiance, linear RGB, W/(m² sr).
    pub radiance: MonteCarloEstimate,
    /// The share of the pixel that shows a face.
    pub coverage: f64,
}

/// A path-traced picture with its standard errors.
#[derive(Clone, Debug, PartialEq)]
pub struct TracedPicture {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// Row by row from the top.
    pub pixels: Vec<TracedPixel>,
}

impl TracedPicture {
    fn with(&self, value: impl Fn(&TracedPixel) -> DVec3) -> Picture {
        let pixel = |pixel: &TracedPixel| value(pixel).extend(pixel.coverage).as_vec4().to_array();
        Picture { width: self.width, height: self.height, pixels: self.pixels.iter().map(pixel).collect() }
    }

    /// Radiance, rounded to f32.
    pub fn picture(&self) -> Picture {
        self.with(|pixel| pixel.radiance.mean)
    }

    /// The standard error of each pixel. From 16 repetitions, it is itself uncertain by 18 % or more.
    pub fn standard_error(&self) -> Picture {
        self.with(|pixel| pixel.radiance.error)
    }

    /// Relative L2 of the standard errors: what a comparison with this picture cannot resolve. 0 of a black picture.
    pub fn noise(&self) -> f64 {
        let squares = |of: fn(&MonteCarloEstimate) -> DVec3| -> f64 {
            self.pixels.iter().map(|pixel| of(&pixel.radiance).length_squared()).sum()
        };
        let signal = squares(|e| e.mean);
        if signal > 0.0 { (squares(|e| e.error) / signal).sqrt() } else { 0.0 }
    }
}

impl PathTracer<'_> {
    /// What a camera sees, each pixel the mean over its area of at least `samples` paths. The same for any number of threads.
    /// With the same seed, corresponding paths in scenes that differ little take corresponding turns, so that differences of
    /// pictures have far less noise than pictures. The camera must be valid, see [`Camera::check`].
    pub fn picture(&self, camera: &Camera, samples: u32, seed: u64) -> TracedPicture {
        let view = View::new(camera);
        let row = |row: u32| self.row(&view, camera.width, row, samples, seed);
        let pixels = parallel::flat_map(0..camera.height, row);
        TracedPicture { width: camera.width, height: camera.height, pixels }
    }

    /// Traces a picture as [`Self::picture`] does, and calls `progress` after each row from any thread.
    /// `None` if it breaks.
    #[doc(hidden)]
    pub fn picture_with(
        &self,
        camera: &Camera,
        samples: u32,
        seed: u64,
        progress: &(dyn Fn() -> ControlFlow<()> + Sync),
    ) -> Option<TracedPicture> {
        let view = View::new(camera);
        let row = |row: u32| {
            let pixels: Vec<TracedPixel> = self.row(&view, camera.width, row, samples, seed).collect();
            progress().is_continue().then_some(pixels)
        };
        let rows: Option<Vec<_>> = (0..camera.height).into_par_iter().map(row).collect();
        Some(TracedPicture { width: camera.width, height: camera.height, pixels: rows?.concat() })
    }

    fn row(
        &self,
        view: &View,
        width: u32,
        row: u32,
        samples: u32,
        seed: u64,
    ) -> impl Iterator<Item = TracedPixel> {
        let first = u64::from(row) * u64::from(width);
        (0..width)
            .map(move |column| self.pixel(view, [column, row], samples, [seed, first + u64::from(column)]))
    }

    fn pixel(&self, view: &View, [column, row]: [u32; 2], samples: u32, key: [u64; 2]) -> TracedPixel {
        let (mut paths, mut shown) = (0u32, 0u32);
        let radiance = estimate(samples, key, |numbers| {
            let [x, y] = numbers.pair();
            let direction = view.ray(f64::from(column) + x, f64::from(row) + y);
            let seen = self.seen(view.position, direction, numbers);
            paths += 1;
            shown += u32::from(seen.is_some());
            seen.unwrap_or_default()
        });
        TracedPixel { radiance, coverage: f64::from(shown) / f64::from(paths.max(1)) }
    }

    /// One sample of the radiance that arrives at an eye against a direction; `None` from the background.
    fn seen(&self, eye: DVec3, direction: DVec3, numbers: &mut Numbers) -> Option<DVec3> {
        let (hit, distance) = self.rays.nearest(eye, direction, None)?;
        let normal = self.normals[hit];
        if direction.dot(normal) >= 0.0 {
            // Backs are black.
            return Some(DVec3::ZERO);
        }
        let at = eye + distance * direction;
        let material = &self.material(hit, at);
        let reflection = Reflection::new(material, normal, -direction);
        Some(DVec3::from(material.emission) + self.reflected(hit, at, reflection, numbers))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{Material, Scene, SceneBuilder, Shape};
    use glam::DAffine3;
    use std::f64::consts::PI;

    const EYE: DVec3 = DVec3::new(-1.2, 1.0, 0.3);

    fn place(scale: DVec3, at: DVec3) -> DAffine3 {
        DAffine3::from_translation(at) * DAffine3::from_scale(scale)
    }

    /// A floor of 4 x 4 m and a square lamp of the given side, facing down, 1.5 m above the point (0.5, 0, 0).
    fn add_lit_floor(builder: &mut SceneBuilder, floor: &Material, side: f64) {
        let lamp = Material { emission: [5.0, 10.0, 20.0], ..Material::named("lamp") };
        builder
            .shape(
                "floor",
                Shape::Quad { cells: 1 },
                floor,
                place(DVec3::splat(4.0), DVec3::new(-2.0, 0.0, -2.0)),
            )
            .shape(
                "lamp",
                Shape::Quad { cells: 2 },
                &lamp,
                place(DVec3::new(side, -1.0, side), DVec3::new(0.5 - 0.5 * side, 1.5, -0.5 * side)),
            );
    }

    fn lit_floor(floor: &Material, side: f64) -> Scene {
        let mut builder = SceneBuilder::new();
        add_lit_floor(&mut builder, floor, side);
        builder.finish("lit floor").expect("a scene")
    }

    /// A view of nearly a point.
    fn towards(target: DVec3) -> Camera {
        let (name, up) = (String::from("point"), DVec3::Y);
        Camera { name, position: EYE, target, up, fov_x_degrees: 1e-6, width: 1, height: 1 }
    }

    /// The light of the lamp that a point of the floor reflects to the eye: a sum over points of the lamp.
    fn reflected(material: &Material, side: f64, at: DVec3) -> DVec3 {
        let n = 2000;
        let outgoing = (EYE - at).normalize();
        let mut sum = DVec3::ZERO;
        for i in 0..n * n {
            let offset = |k: i32| side * ((f64::from(k) + 0.5) / f64::from(n) - 0.5);
            let way = DVec3::new(0.5 + offset(i % n), 1.5, offset(i / n)) - at;
            let incident = way.normalize();
            let half = (incident + outgoing).normalize();
            let brdf = DVec3::from(material.diffuse_albedo()) / PI
                + DVec3::from(material.specular)
                    * material.specular_normalization()
                    * half.y.powf(material.power);
            sum += brdf * incident.y * incident.y / way.length_squared();
        }
        sum * DVec3::new(5.0, 10.0, 20.0) * side * side / f64::from(n * n)
    }

    /// A sheet with two sides is two triangles at each place; the one that faces the ray is hit.
    #[test]
    fn the_second_side_of_a_sheet_is_not_in_front_of_the_first() {
        let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
        let camera =
            Camera { fov_x_degrees: 40.0, width: 12, height: 12, ..towards(DVec3::new(0.1, 0.0, 0.2)) };
        let one = lit_floor(&grey, 0.5);
        let mut builder = SceneBuilder::new();
        let under = place(DVec3::new(4.0, -1.0, 4.0), DVec3::new(-2.0, 0.0, -2.0));
        builder.shape("under", Shape::Quad { cells: 1 }, &grey, under);
        add_lit_floor(&mut builder, &grey, 0.5);
        let two = builder.finish("two sides").expect("a scene");
        let [one, two] = [one, two].map(|scene| PathTracer::new(&scene).picture(&camera, 256, 3));
        for (one, two) in one.pixels.iter().zip(&two.pixels) {
            let apart = (one.radiance.mean - two.radiance.mean).abs();
            let allowed = 5.0 * (one.radiance.error + two.radiance.error) + 1e-9;
            assert!(apart.cmple(allowed).all(), "{one:?}, not {two:?}");
        }
    }

    /// Highlights of a lamp in their middle, at their edge and outside; lobes wider and narrower than the
    /// lamp.
    #[test]
    fn highlights_of_a_lamp() {
        for (power, side) in [(20.0, 0.5), (60.0, 0.5), (200.0, 0.5), (200.0, 0.05), (2000.0, 1.0)] {
            let floor = Material {
                albedo: [0.1, 0.2, 0.0],
                specular: [0.1, 0.15, 0.2],
                power,
                ..Material::named("floor")
            };
            let scene = lit_floor(&floor, side);
            let tracer = PathTracer::new(&scene);
            // Mirrored at the floor, the lamp is seen at x = -1.2 + 1.7 / 2.5.
            for at in [DVec3::new(-0.52, 0.0, 0.18), DVec3::new(-0.4, 0.0, 0.1), DVec3::new(0.4, 0.0, -0.5)] {
                let pixel = tracer.picture(&towards(at), 4096, 5).pixels[0];
                let truth = reflected(&floor, side, at);
                let found = pixel.radiance;
                let case = format!("p = {power}, lamp {side}, at {at}: {found:?}, not {truth}");
                assert!((found.mean - truth).abs().cmple(4.5 * found.error + 1e-6 * truth).all(), "{case}");
                assert!(found.error.cmple(0.01 * truth.max_element() * DVec3::ONE).all(), "{case}");
                assert_eq!(pixel.coverage, 1.0);
            }
        }
    }

    /// A constant lobe (p = 0) reflects σ of the light from all directions: in a closed room, L = L_e / (1 - δρ - σ).
    #[test]
    fn a_glossy_furnace() {
        let wall = Material {
            albedo: [0.3, 0.5, 0.0],
            specular: [0.2, 0.3, 0.5],
            emission: [1.0; 3],
            ..Material::named("wall")
        };
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells: 1 }, &wall, DAffine3::IDENTITY);
        let scene = builder.finish("furnace").expect("a scene");
        let camera = Camera {
            position: DVec3::splat(0.3),
            target: DVec3::new(0.9, 0.5, 0.4),
            fov_x_degrees: 90.0,
            width: 8,
            height: 6,
            ..towards(DVec3::ZERO)
        };
        let traced = PathTracer::new(&scene).picture(&camera, 1024, 0);
        let truth = DVec3::new(2.0, 5.0, 2.0);
        for TracedPixel { radiance, coverage } in traced.pixels {
            assert!(
                (radiance.mean - truth).abs().cmple(5.0 * radiance.error).all(),
                "{radiance:?}, not {truth}"
            );
            assert!(radiance.error.cmple(0.06 * truth).all() && coverage == 1.0, "{radiance:?}");
        }
    }

    /// Fronts shine, backs are black and occlude, and there is nothing else.
    #[test]
    fn fronts_and_backs() {
        let lamp = Material { emission: [3.0, 2.0, 1.0], ..Material::named("lamp") };
        let mut builder = SceneBuilder::new();
        builder
            // Faces up, towards the camera, and down, above a half of the other.
            .shape(
                "front",
                Shape::Quad { cells: 1 },
                &lamp,
                place(DVec3::splat(2.0), DVec3::new(-1.0, 0.0, -1.0)),
            )
            .shape(
                "back",
                Shape::Quad { cells: 1 },
                &lamp,
                place(DVec3::new(1.0, -1.0, 2.0), DVec3::new(0.0, 0.5, -1.0)),
            );
        let scene = builder.finish("lamps").expect("a scene");
        let camera = Camera {
            position: DVec3::new(0.0, 1000.0, 0.0),
            target: DVec3::ZERO,
            up: DVec3::Z,
            // 4 x 4 m around the lamps, half a metre a pixel.
            fov_x_degrees: 2.0 * (2.0_f64 / 1000.0).atan().to_degrees(),
            width: 8,
            height: 8,
            ..towards(DVec3::ZERO)
        };
        let traced = PathTracer::new(&scene).picture(&camera, 64, 0);
        assert_eq!((traced.width, traced.height, traced.noise()), (8, 8, 0.0));
        let seen = |column: usize, row: usize| traced.pixels[8 * row + column];
        let shine = TracedPixel {
            radiance: MonteCarloEstimate { mean: DVec3::new(3.0, 2.0, 1.0), error: DVec3::ZERO },
            coverage: 1.0,
        };
        // The picture's right is the scene's -x.
        assert_eq!((seen(4, 3), seen(5, 4)), (shine, shine));
        assert_eq!(
            (seen(3, 3), seen(2, 4)),
            (
                TracedPixel { coverage: 1.0, ..Default::default() },
                TracedPixel { coverage: 1.0, ..Default::default() }
            )
        );
        assert_eq!((seen(0, 0), seen(7, 4)), (TracedPixel::default(), TracedPixel::default()));
    }

    fn small(side: f64) -> (Scene, Camera) {
        let floor = Material { albedo: [0.5; 3], ..Material::named("floor") };
        let mut scene = lit_floor(&floor, side);
        let blocker = SceneBuilder::new()
            .shape(
                "blocker",
                Shape::Box { cells: 1 },
                &floor,
                place(DVec3::splat(0.4), DVec3::new(0.3, 0.4, -0.2)),
            )
            .finish("blocker")
            .expect("a scene");
        let first = scene.vertices.len() as u32;
        scene.vertices.extend(&blocker.vertices);
        let material = scene.triangles[0].material;
        scene.triangles.extend(
            blocker
                .triangles
                .iter()
                .map(|t| antirad_scene::Triangle { vertices: t.vertices.map(|v| v + first), material }),
        );
        let camera =
            Camera { fov_x_degrees: 60.0, width: 24, height: 18, ..towards(DVec3::new(0.3, 0.0, 0.0)) };
        (scene, camera)
    }

    #[test]
    fn the_number_of_threads_and_of_rows_does_not_matter() {
        let (scene, camera) = small(0.5);
        let tracer = PathTracer::new(&scene);
        let found = tracer.picture(&camera, 32, 9);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("a pool");
        assert_eq!(pool.install(|| tracer.picture(&camera, 32, 9)), found);
        assert_ne!(tracer.picture(&camera, 32, 10), found);
        let rows = std::sync::atomic::AtomicU32::new(0);
        let count = || {
            rows.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            ControlFlow::Continue(())
        };
        assert_eq!(tracer.picture_with(&camera, 32, 9, &count), Some(found));
        assert_eq!(rows.into_inner(), 18);
        assert_eq!(tracer.picture_with(&camera, 32, 9, &|| ControlFlow::Break(())), None);
    }

    /// Pictures of a box moved by a millimetre differ by far less than those of other seeds.
    #[test]
    fn common_random_numbers() {
        let (scene, camera) = small(0.5);
        let mut moved = scene.clone();
        moved.vertices[13..].iter_mut().for_each(|x| x.x += 1e-3);
        let picture = |scene: &Scene, seed: u64| PathTracer::new(scene).picture(&camera, 64, seed);
        let distance = |a: &TracedPicture, b: &TracedPicture| {
            let pairs = a.pixels.iter().zip(&b.pixels);
            pairs.map(|(a, b)| (a.radiance.mean - b.radiance.mean).length_squared()).sum::<f64>().sqrt()
        };
        let first = picture(&scene, 1);
        let (of_place, of_seed) =
            (distance(&first, &picture(&moved, 1)), distance(&first, &picture(&scene, 2)));
        assert!(of_place > 0.0 && of_place <= 0.25 * of_seed, "{of_place}, {of_seed}");
    }

    #[test]
    fn without_lamps_it_is_dark() {
        let (mut scene, camera) = small(0.5);
        scene.materials.iter_mut().for_each(|material| material.emission = [0.0; 3]);
        let traced = PathTracer::new(&scene).picture(&camera, 4, 0);
        assert!(traced.pixels.iter().all(|pixel| pixel.radiance == MonteCarloEstimate::default()));
        assert!(traced.pixels.iter().any(|pixel| pixel.coverage > 0.0) && traced.noise() == 0.0);
    }
}
