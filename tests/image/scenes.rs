//! The scenes of the tests, and an f64 ray tracer to compare with.

use crate::support::device;
use antirad::backend::Backend;
use antirad::image::Rasterizer;
use antirad::scene::{Camera, Material, Scene, SolveSettings, Triangle};
use antirad_render::image::View;
use glam::DVec3;

/// Runs checks on both backends.
pub fn on_each(checks: impl Fn(&Rasterizer, &Backend)) {
    for backend in [Backend::cpu(), device().into()] {
        let rasterizer = Rasterizer::new(&backend).unwrap();
        checks(&rasterizer, &backend);
        drop(rasterizer);
        finish(backend);
    }
}

/// Ends a test: fails on any message of validation, also of the end of a Vulkan device.
pub fn finish(backend: Backend) {
    let log = backend.vulkan().map(|device| device.validation_log());
    drop(backend);
    if let Some(log) = log {
        assert!(log.messages().is_empty(), "{:?}", log.messages());
    }
}

pub fn scene(vertices: Vec<DVec3>, triangles: &[[u32; 3]]) -> Scene {
    let triangle = |&vertices: &[u32; 3]| Triangle { vertices, material: 0 };
    Scene {
        name: "test".into(),
        vertices,
        triangles: triangles.iter().map(triangle).collect(),
        meshes: Vec::new(),
        origins: Vec::new(),
        materials: vec![Material::named("white")],
        suns: Vec::new(),
        patterns: Default::default(),
        cameras: Vec::new(),
        settings: SolveSettings::default(),
        given: None,
        target_error: None,
        degenerate: Vec::new(),
        creases: Vec::new(),
        warnings: Vec::new(),
    }
}

/// Faces of a grid of quads; `place` gives the position of the vertex (column, row). Fronts face along column × row.
pub fn grid(columns: u32, rows: u32, place: impl Fn(f64, f64) -> DVec3) -> Scene {
    let mut vertices = Vec::new();
    let mut triangles = Vec::new();
    for row in 0..=rows {
        for column in 0..=columns {
            vertices.push(place(f64::from(column), f64::from(row)));
        }
    }
    for row in 0..rows {
        for column in 0..columns {
            let a = row * (columns + 1) + column;
            let (b, c, d) = (a + 1, a + columns + 2, a + columns + 1);
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    scene(vertices, &triangles)
}

/// The square of side 2 `half` at height z, facing +z.
pub fn square(half: f64, z: f64) -> Scene {
    grid(1, 1, |x, y| DVec3::new((2.0 * x - 1.0) * half, (2.0 * y - 1.0) * half, z))
}

/// All the triangles of all the scenes.
pub fn together(scenes: &[Scene]) -> Scene {
    let mut all = scene(Vec::new(), &[]);
    for part in scenes {
        let first = all.vertices.len() as u32;
        all.vertices.extend(&part.vertices);
        let moved = |t: &Triangle| Triangle { vertices: t.vertices.map(|v| v + first), ..*t };
        all.triangles.extend(part.triangles.iter().map(moved));
    }
    all
}

pub fn flipped(mut scene: Scene) -> Scene {
    scene.triangles.iter_mut().for_each(|triangle| triangle.vertices.reverse());
    scene
}

/// A camera at (0, 0, 1) that looks down on z = 0, where it sees x from -1 to 1.
pub fn above(width: u32, height: u32) -> Camera {
    Camera {
        name: "above".into(),
        position: DVec3::Z,
        target: DVec3::ZERO,
        up: DVec3::Y,
        fov_x_degrees: 90.0,
        width,
        height,
    }
}

/// Reproducible random numbers in 0..1.
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub fn colours(&mut self, scene: &Scene) -> Vec<[f32; 3]> {
        scene.triangles.iter().map(|_| [0; 3].map(|_| self.next() as f32)).collect()
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Hit {
    pub face: u32,
    pub distance: f64,
    pub weights: [f64; 3],
}

/// The first hit of a ray. The flag is true where it is ambiguous: the ray passes within 1e-4 of an edge, or two faces are equally
/// far.
pub fn trace(scene: &Scene, origin: DVec3, direction: DVec3) -> (Option<Hit>, bool) {
    const CLOSE: f64 = 1e-4;
    let mut hits: Vec<Hit> = Vec::new();
    let mut doubtful = false;
    for face in 0..scene.triangles.len() {
        let [a, b, c] = scene.corners(face);
        let normal = (b - a).cross(c - a);
        let det = normal.dot(direction);
        let distance = normal.dot(a - origin) / det;
        let at = origin + distance * direction;
        let weight = |p: DVec3, q: DVec3| (p - at).cross(q - at).dot(normal) / normal.length_squared();
        let weights = [weight(b, c), weight(c, a), weight(a, b)];
        let least = weights.into_iter().fold(f64::INFINITY, f64::min);
        if distance > 0.0 && distance.is_finite() && least > -CLOSE {
            doubtful |= least < CLOSE;
            if least >= 0.0 {
                hits.push(Hit { face: face as u32, distance, weights });
            }
        }
    }
    hits.sort_by(|a, b| a.distance.total_cmp(&b.distance));
    if let [first, second, ..] = hits[..] {
        doubtful |= second.distance - first.distance < CLOSE * second.distance;
    }
    (hits.first().copied(), doubtful)
}

/// The ray through each sample of a picture, in the order of the samples.
pub fn rays(camera: &Camera, side: u32) -> impl Iterator<Item = DVec3> {
    let view = View::new(camera);
    let (width, height) = (camera.width * side, camera.height * side);
    let steps = f64::from(side * side);
    let place = move |at: u32, turned: u32| {
        f64::from(at / side) + (f64::from(side * (at % side) + turned) + 0.5) / steps
    };
    (0..height).flat_map(move |row| {
        let view = view.clone();
        (0..width)
            .map(move |column| view.ray(place(column, side - 1 - row % side), place(row, column % side)))
    })
}
