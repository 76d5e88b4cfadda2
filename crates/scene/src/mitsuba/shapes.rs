//! Shapes that are no files, with the texture coordinates that Mitsuba gives them.

use std::f64::consts::{PI, TAU};

use glam::{DVec2, DVec3};

use crate::Shape;
use crate::geometry::RawMesh;

/// Squares along a side of rectangles and cubes, whose indirect light is one value for each triangle.
const CELLS: u32 = 8;
/// Subdivisions of an icosahedron that stands for a sphere: 1280 triangles.
const SPHERE: u32 = 3;
/// Subdivisions of an icosahedron that stands for a sphere that shines: few faces, so that its light can be exact.
const LAMP: u32 = 0;
/// Corners of a disk.
const DISK: u32 = 32;

/// A mesh whose texture coordinates follow from the corners of each face.
fn mesh((vertices, faces): (Vec<DVec3>, Vec<[u32; 3]>), uv: impl Fn([DVec3; 3]) -> [DVec2; 3]) -> RawMesh {
    let uvs = faces.iter().map(|face| uv(face.map(|v| vertices[v as usize]))).collect();
    RawMesh { uvs, ..RawMesh::uniform(vertices, faces, "") }
}

/// The square from -1 to 1 at z = 0 that faces +z.
pub(super) fn rectangle() -> RawMesh {
    // From the unit square at y = 0 that faces +y.
    let (vertices, faces) = Shape::Quad { cells: CELLS }.mesh();
    let turned = |v: DVec3| DVec3::new(2.0 * v.x - 1.0, 1.0 - 2.0 * v.z, 0.0);
    let square = (vertices.into_iter().map(turned).collect(), faces);
    mesh(square, |corners| corners.map(|v| (v.truncate() + 1.0) / 2.0))
}

/// The cube from -1 to 1.
pub(super) fn cube() -> RawMesh {
    let (vertices, faces) = Shape::Box { cells: CELLS }.mesh();
    let cube = (vertices.into_iter().map(|v| 2.0 * v - 1.0).collect(), faces);
    mesh(cube, |corners| {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a);
        let axis = normal.abs().max_position();
        corners.map(|DVec3 { x, y, z }| {
            let uv = match (axis, normal[axis] > 0.0) {
                (0, true) => DVec2::new(y, -z),
                (0, false) => DVec2::new(y, z),
                (1, true) => DVec2::new(-x, -z),
                (1, false) => DVec2::new(z, x),
                (_, true) => DVec2::new(y, x),
                (_, false) => DVec2::new(-y, x),
            };
            (uv + 1.0) / 2.0
        })
    })
}

/// A sphere; one that shines outwards has few faces and the same area, hence power.
pub(super) fn sphere(centre: DVec3, radius: f64, shines: bool, flipped: bool) -> RawMesh {
    // From inside, such as a dome, it is better round.
    let level = if shines && !flipped { LAMP } else { SPHERE };
    let (vertices, faces) = Shape::Icosphere { level, inward: false }.mesh();
    let mut sphere = mesh((vertices, faces), |corners| {
        let place = |v: DVec3| DVec2::new(v.y.atan2(v.x) / TAU, v.z.clamp(-1.0, 1.0).acos() / PI);
        let first = place(corners[0]);
        // Without the step from 1 to 0 in a face.
        corners.map(|v| {
            let uv = place(v);
            DVec2::new(uv.x - (uv.x - first.x).round(), uv.y)
        })
    });
    let mut scale = radius;
    if shines {
        scale *= (4.0 * PI / sphere.area()).sqrt();
    }
    sphere.vertices.iter_mut().for_each(|v| *v = centre + scale * *v);
    sphere
}

/// The disk of radius 1 at z = 0 that faces +z.
pub(super) fn disk() -> RawMesh {
    let corner = |k: u32| {
        let (sin, cos) = (TAU * f64::from(k) / f64::from(DISK)).sin_cos();
        DVec3::new(cos, sin, 0.0)
    };
    let vertices = (0..DISK).map(corner).chain([DVec3::ZERO]).collect();
    let mut disk = RawMesh::uniform(vertices, (0..DISK).map(|k| [k, (k + 1) % DISK, DISK]).collect(), "");
    // The radius, and the angle.
    let along = |k: f64| k / f64::from(DISK);
    let uvs = (0..DISK).map(f64::from).map(|k| [(1.0, k), (1.0, k + 1.0), (0.0, k + 0.5)]);
    disk.uvs = uvs.map(|corners| corners.map(|(radius, k)| DVec2::new(radius, along(k)))).collect();
    disk
}
