//! The mesh: a Cornell room, welded, jittered.

use antirad::scene::{Camera, Material, Scene, SceneError, Shape, Triangle};
use antirad_kit::Random;
use glam::{DMat3, DVec3};
use std::collections::HashMap;

/// Vertices closer than this fraction of the scene are welded.
const WELD: f64 = 1e-9;

/// On a mesh as coarse as this, the default of 30 makes nearly all pairs close: it would leave the far field untested
/// and take three times as long.
const NEAR_FIELD: f64 = 10.0;

/// A room of 2 m with an open front, two boxes on its floor and a lamp below its ceiling: 182 triangles, without the
/// bottoms of the boxes. The tall box is glossy. Boxes and lamp are turned and placed so that no two triangles face
/// each other exactly, centroid above centroid: at the pole of an equal-angle layout the azimuth jumps, and the model
/// with it.
pub fn room() -> Result<Scene, SceneError> {
    let turn = |axis: DVec3, degrees: f64| DMat3::from_axis_angle(axis, degrees.to_radians());
    let boxed = |degrees: f64, size: DVec3, at: DVec3| {
        let matrix = turn(DVec3::Y, degrees) * DMat3::from_diagonal(size);
        move |x: DVec3| matrix * x + at
    };
    let cells = 4;
    let wall = Shape::Quad { cells };
    let tall = boxed(17.0, DVec3::new(0.55, 1.2, 0.5), DVec3::new(0.35, 0.0, 0.45));
    let short = boxed(-21.0, DVec3::new(0.5, 0.6, 0.55), DVec3::new(1.13, 0.0, 1.07));
    type Place<'a> = &'a dyn Fn(DVec3) -> DVec3;
    let parts: [(Shape, Place, u32); 8] = [
        (wall, &|x| 2.0 * x, 0),
        (wall, &|x| DVec3::new(2.0 * x.x, 2.0, 2.0 - 2.0 * x.z), 0),
        (wall, &|x| DVec3::new(2.0 * x.x, 2.0 - 2.0 * x.z, 0.0), 0),
        (wall, &|x| DVec3::new(0.0, 2.0 - 2.0 * x.x, 2.0 - 2.0 * x.z), 1),
        (wall, &|x| DVec3::new(2.0, 2.0 * x.x, 2.0 - 2.0 * x.z), 2),
        (Shape::Box { cells: 1 }, &tall, 3),
        (Shape::Box { cells: 1 }, &short, 0),
        (Shape::Quad { cells: 1 }, &|x| DVec3::new(0.77 + 0.5 * x.x, 1.9, 1.21 - 0.45 * x.z), 4),
    ];
    let material = |name: &str, albedo: [f64; 3]| Material { albedo, ..Material::named(name) };
    let materials = vec![
        material("white", [0.5, 0.48, 0.45]),
        material("red", [0.6, 0.1, 0.08]),
        material("green", [0.15, 0.45, 0.12]),
        Material { specular: [0.1, 0.12, 0.08], power: 6.0, ..material("gloss", [0.25, 0.3, 0.4]) },
        Material { emission: [17.0, 12.0, 8.0], ..material("lamp", [0.4; 3]) },
    ];
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for (shape, place, material) in parts {
        let (points, faces) = shape.mesh();
        let first = vertices.len() as u32;
        vertices.extend(points.iter().map(|&x| place(x)));
        // The bottom of a box lies on the floor and sees nothing.
        let kept = |face: &[u32; 3]| {
            !matches!(shape, Shape::Box { .. }) || face.iter().any(|&v| points[v as usize].y > 0.0)
        };
        triangles.extend(
            faces.into_iter().filter(kept).map(|f| Triangle { vertices: f.map(|v| v + first), material }),
        );
    }
    let mut scene = Scene::new("room", vertices, triangles, materials)?;
    scene.settings.near_field = NEAR_FIELD;
    scene.set_camera(Camera {
        name: "main".to_owned(),
        position: DVec3::new(0.9, 1.1, 4.3),
        target: DVec3::new(1.0, 1.0, 0.0),
        up: DVec3::Y,
        fov_x_degrees: 45.0,
        width: 256,
        height: 256,
    })?;
    Ok(scene)
}

/// The middle of the scene and half its diagonal, metres.
pub fn bounds(scene: &Scene) -> (DVec3, f64) {
    let corners = || scene.triangles.iter().flat_map(|t| t.vertices).map(|v| scene.vertices[v as usize]);
    let (low, high) =
        corners().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
    (low.midpoint(high), 0.5 * (high - low).length())
}

/// Welds coincident vertices, so that a mesh of several parts stays closed when it is jittered.
pub fn weld(scene: &mut Scene) {
    let (_, radius) = bounds(scene);
    let cell = (WELD * radius).max(f64::MIN_POSITIVE);
    let mut first = HashMap::new();
    let mut vertices = Vec::new();
    let index: Vec<u32> = scene
        .vertices
        .iter()
        .map(|x| {
            let key = (*x / cell).to_array().map(|c| c.round() as i64);
            *first.entry(key).or_insert_with(|| {
                vertices.push(*x);
                vertices.len() as u32 - 1
            })
        })
        .collect();
    scene.vertices = vertices;
    for triangle in &mut scene.triangles {
        triangle.vertices = triangle.vertices.map(|v| index[v as usize]);
    }
}

/// Mean edge of a triangle, metres.
pub fn mean_edge(scene: &Scene, triangle: usize) -> f64 {
    let [a, b, c] = scene.corners(triangle);
    (a.distance(b) + b.distance(c) + c.distance(a)) / 3.0
}

/// Every vertex moved by `fraction` of the mean edge around it, in a random direction.
pub fn jittered(scene: &Scene, fraction: f64) -> Result<Scene, SceneError> {
    let mut edges = vec![(0.0, 0.0); scene.vertices.len()];
    for (i, triangle) in scene.triangles.iter().enumerate() {
        for v in triangle.vertices {
            let (sum, count) = &mut edges[v as usize];
            *sum += mean_edge(scene, i);
            *count += 1.0;
        }
    }
    let mut random = Random::new(5);
    let mut scene = scene.clone();
    for (x, (sum, count)) in scene.vertices.iter_mut().zip(edges) {
        if count > 0.0 {
            *x += fraction * sum / count * random.direction();
        }
    }
    scene.check(false)?;
    Ok(scene)
}
