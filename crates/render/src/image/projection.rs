//! Projection onto the picture plane, in f64: prepares the functions that kernels evaluate per sample.
//!
//! Points of the picture are (x, y) in -1..1, y upwards. The frame of the view has axes X, Y, Z to the right, up and along the
//! line of sight, with X and Y scaled by the tangents of half the fields of view: a corner at (X, Y, Z) projects to (X/Z, Y/Z).
//! For corners a, b, c in that frame, the function (b × c)·(x, y, 1) changes sign where the ray crosses the edge bc. It has the
//! sign of det = a·(b × c) on the triangle's side; divided by det it is the barycentric weight of corner a at the hit, over the
//! depth there. All this holds for corners behind the camera too; nothing is clipped.

use glam::{DVec2, DVec3};

use antirad_scene::Camera;

/// Bound on the error of an f32 kernel that evaluates a function of the picture whose absolute coefficients sum to 1: eight
/// roundings. Edges are moved outwards by as much, so that every sample on a shared edge or corner lies on at least one of the
/// faces and there are no cracks. Where faces overlap the nearest wins, then the first.
pub(super) const ROUNDING: f64 = 8.0 / (1 << 24) as f64;

/// Below this sine of the angle between line of sight and plane, f64 cannot tell front from back.
const EDGE_ON: f64 = 1e-13;

/// Position and orthonormal frame of a camera.
#[derive(Clone, Debug)]
pub struct View {
    /// Position of the camera, m.
    pub position: DVec3,
    /// Unit vector to the right of the picture.
    pub right: DVec3,
    /// Unit vector to the top of the picture.
    pub up: DVec3,
    /// Unit vector along the line of sight.
    pub forward: DVec3,
    /// Tangent of half the horizontal field of view.
    pub tan_half_x: f64,
    /// Tangent of half the vertical field of view: `tan_half_x` times height over width.
    pub tan_half_y: f64,
    width: f64,
    height: f64,
}

impl View {
    /// The camera must be valid, see [`Camera::check`].
    pub fn new(camera: &Camera) -> Self {
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let forward = (camera.target - camera.position).normalize();
        let right = forward.cross(camera.up.normalize()).normalize();
        let tan_half_x = (camera.fov_x_degrees.to_radians() / 2.0).tan();
        Self {
            position: camera.position,
            right,
            up: right.cross(forward),
            forward,
            tan_half_x,
            tan_half_y: tan_half_x * height / width,
            width,
            height,
        }
    }

    /// The unit direction of the ray through a point of the picture, in pixels from the left and from the top edge.
    pub fn ray(&self, column: f64, row: f64) -> DVec3 {
        let x = (2.0 * column / self.width - 1.0) * self.tan_half_x;
        let y = (1.0 - 2.0 * row / self.height) * self.tan_half_y;
        (x * self.right + y * self.up + self.forward).normalize()
    }

    /// How far in front of the camera a point is along the line of sight, m.
    pub fn depth(&self, point: DVec3) -> f64 {
        (point - self.position).dot(self.forward)
    }

    /// Where a point in front of the camera is in the picture, in pixels from the left and from the top edge.
    pub fn place(&self, point: DVec3) -> DVec2 {
        let DVec3 { x, y, z } = self.to_frame(point);
        0.5 * DVec2::new((1.0 + x / z) * self.width, (1.0 - y / z) * self.height)
    }

    fn to_frame(&self, point: DVec3) -> DVec3 {
        let from_camera = point - self.position;
        DVec3::new(
            from_camera.dot(self.right) / self.tan_half_x,
            from_camera.dot(self.up) / self.tan_half_y,
            from_camera.dot(self.forward),
        )
    }

    /// `None` if the triangle is invisible: behind the camera, outside the picture, edge-on, or without area.
    pub(super) fn project(&self, number: u32, corners: [DVec3; 3]) -> Option<Projected> {
        let corners @ [a, b, c] = corners.map(|corner| self.to_frame(corner));
        let normal = (b - a).cross(c - a);
        let det = normal.dot(a);
        if a.z.max(b.z).max(c.z) <= 0.0 || det.abs() <= EDGE_ON * normal.length() * a.length() {
            return None;
        }
        let edges = [b.cross(c), c.cross(a), a.cross(b)].map(|edge| edge * det.signum());
        // The frame is left-handed, so the sign is opposite to that in the scene.
        let front = det > 0.0;
        let bounds = Bounds::of(corners)?;
        Some(Projected { number, front, bounds, corners, edges, inverse_depth: normal / det })
    }
}

/// A projected triangle. A function of the picture, a x + b y + c, is stored as (a, b, c).
#[derive(Clone, Debug)]
pub(super) struct Projected {
    /// Index in the scene.
    pub number: u32,
    pub front: bool,
    pub bounds: Bounds,
    /// Corners in the frame of the view.
    pub corners: [DVec3; 3],
    /// Edge functions, non-negative on the triangle: for the edge opposite each corner, the cross product of the two others.
    pub edges: [DVec3; 3],
    pub inverse_depth: DVec3,
}

impl Projected {
    /// This face for an f32 kernel: edge functions are normalised to absolute coefficients of sum 1, and
    /// moved by [`ROUNDING`].
    pub fn rounded(mut self) -> Self {
        self.edges = self.edges.map(|edge| {
            let size = l1(edge);
            let mut unit = if size > 0.0 { edge / size } else { edge };
            unit.z += ROUNDING;
            unit
        });
        if self.front {
            // Of the two sides of a sheet, whose depths differ by rounding only, the front wins.
            self.inverse_depth.z += ROUNDING * l1(self.inverse_depth);
        }
        self
    }
}

/// A rectangle of the picture.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub x: [f64; 2],
    pub y: [f64; 2],
}

impl Bounds {
    const PICTURE: Self = Self { x: [-1.0, 1.0], y: [-1.0, 1.0] };

    /// The bounds of the triangle after its edges are moved outwards; `None` if they are outside the picture. A triangle that
    /// reaches behind the camera is bounded by its edges only.
    fn of(corners: [DVec3; 3]) -> Option<Self> {
        const MARGIN: f64 = 1e-5;
        if corners.iter().any(|corner| corner.z <= 0.0) {
            return Some(Self::PICTURE);
        }
        let range = |seen: [f64; 3]| {
            let low = seen.into_iter().fold(f64::INFINITY, f64::min) - MARGIN;
            let high = seen.into_iter().fold(f64::NEG_INFINITY, f64::max) + MARGIN;
            (low <= 1.0 && high >= -1.0).then(|| [low.max(-1.0), high.min(1.0)])
        };
        Some(Self { x: range(corners.map(|p| p.x / p.z))?, y: range(corners.map(|p| p.y / p.z))? })
    }
}

fn l1(v: DVec3) -> f64 {
    v.abs().element_sum()
}
