//! The derivatives of a picture with respect to geometry: moving edges.
//!
//! A pixel is the mean of the colours in it, so a moving edge changes it by the jump of the colour across the edge times the
//! area that the edge sweeps. With x* the intersection of a row of the picture with an edge, that area is the integral of dx*
//! over y; for edges closer to horizontal than to vertical, that of dy* over x, along columns. Each edge is integrated along the
//! direction that crosses it at the larger angle, where the integrand is bounded. x* is the root of the edge function e of the
//! picture, e · (x, y, 1) = 0, hence ∂x*/∂e = -(x*, y, 1) / e_x.
//!
//! Lines run through the centres of the samples; the visible faces along them are found exactly ([`super::sweep`]).

use std::collections::HashMap;
use std::ops::{AddAssign, Range};

use glam::DVec3;

use super::ImageError;
use super::coverage::{check_colours, check_cotangent};
use super::faces;
use super::projection::{Projected, View};
use super::raster::grid;
use super::sweep::{Axis, Cause, Change, Sweep};
use antirad_base::ranks::Ranks;
use antirad_scene::Movable;
use antirad_scene::{Camera, Scene};

/// Lines that are swept together. This determines the order of sums, so it must not depend on the host.
const BLOCK: u32 = 16;

/// Blocks whose lists of faces and sums are in memory at a time.
const BLOCKS: u32 = 64;

/// Derivatives of a loss by a camera: by each of its three vectors with the two others held fixed.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CameraGradient {
    /// By [`Camera::position`], per metre: the camera turns as it moves.
    pub position: DVec3,
    /// By [`Camera::target`], per metre.
    pub target: DVec3,
    /// By [`Camera::up`], per unit of its length: zero within the plane of up and the line of sight, where only its turning about that line
    /// changes the picture.
    pub up: DVec3,
}

impl AddAssign for CameraGradient {
    fn add_assign(&mut self, other: Self) {
        self.position += other.position;
        self.target += other.target;
        self.up += other.up;
    }
}

/// The derivatives of a loss with respect to positions of vertices, per metre, and the camera.
#[derive(Clone, Debug, PartialEq)]
pub struct GeometryGradient {
    /// With respect to each vertex of the scene.
    pub vertices: Vec<DVec3>,
    /// With respect to the camera.
    pub camera: CameraGradient,
}

/// The derivatives of a loss with respect to the positions of vertices and camera, through visibility: silhouettes, occlusion,
/// edges between colours, and intersections of faces. The picture that is differentiated has one colour per face, and its pixels
/// are exact means over their areas, integrated along `supersample` lines per pixel in each direction, a power of two. The
/// dependence of the colours themselves on geometry is not included.
///
/// `colours`: radiance of the front of each triangle, in the scene's order. `cotangent`: the derivative of
/// the loss with respect to each pixel's RGB and alpha, row by row from the top.
///
/// The result is reproducible to the last bit. No device is used.
///
/// # Errors
/// Fails if the scene, the camera or `supersample` is invalid, if the number of colours or cotangents is
/// wrong, or if a cotangent is not finite.
pub fn geometry_gradient<C>(
    scene: &Scene,
    camera: &Camera,
    supersample: u32,
    colours: &[[C; 3]],
    cotangent: &[[f64; 4]],
) -> Result<GeometryGradient, ImageError>
where
    C: Copy + Into<f64> + Sync,
{
    check_colours(colours.len(), scene.triangles.len())?;
    let shown = |face: usize, places: &[[f64; 2]]| vec![colours[face].map(C::into); places.len()];
    geometry_gradient_of(&Ranks::default(), scene, camera, supersample, &shown, cotangent, None)
}

/// What the fronts of triangles show.
pub trait FaceColours: Sync {
    /// The colours of a triangle at places of the picture, column and row in pixels from its upper left corner.
    fn at(&self, triangle: usize, places: &[[f64; 2]]) -> Vec<[f64; 3]>;

    /// Whether two triangles have the same colours wherever one ends and the other begins.
    fn is_seamless(&self, _triangles: [usize; 2]) -> bool {
        false
    }
}

impl<F: Fn(usize, &[[f64; 2]]) -> Vec<[f64; 3]> + Sync> FaceColours for F {
    fn at(&self, triangle: usize, places: &[[f64; 2]]) -> Vec<[f64; 3]> {
        self(triangle, places)
    }
}

/// The derivatives of [`geometry_gradient`] for colours that vary over faces, in shares of some ranks, which
/// must all call it. `movable`: indices of the vertices by which derivatives are wanted; those by the camera,
/// to which all edges contribute, are then left out. `None`: all derivatives. What is not wanted is zero.
///
/// # Errors
/// Fails if the scene, the camera or `supersample` is invalid, if the number of cotangents is wrong or one is
/// not finite, or if ranks can no longer work together.
pub fn geometry_gradient_of(
    ranks: &Ranks,
    scene: &Scene,
    camera: &Camera,
    supersample: u32,
    colours: &dyn FaceColours,
    cotangent: &[[f64; 4]],
    movable: Option<&[u32]>,
) -> Result<GeometryGradient, ImageError> {
    let grid = grid(camera, supersample)?;
    check_cotangent(cotangent, camera.width as usize * camera.height as usize)?;
    let faces = faces::project(scene, camera)?;
    let view = View::new(camera);
    let triangles = scene.triangles.iter().map(|triangle| triangle.vertices);
    let whole = movable.is_none();
    let movable = Movable::of(scene.vertices.len(), movable, triangles);
    let moves = |face: &Projected| movable.triangle(face.number);

    // In the frame of the view, see the module `projection`.
    let mut vertices = vec![DVec3::ZERO; scene.vertices.len()];
    let size = [camera.width, camera.height];
    for (axis, lines) in [(Axis::Rows, grid.height), (Axis::Columns, grid.width)] {
        let lines = Lines { axis, count: lines, side: supersample, size };
        for first in (0..lines.count).step_by((BLOCK * BLOCKS) as usize) {
            let lists = lines.faces_of_blocks(first, &faces);
            let corners = |number: usize| {
                let first = first + number as u32 * BLOCK;
                let block = first..lines.count.min(first + BLOCK);
                lines.sweep(block, &lists[number], &faces, &moves, colours, cotangent)
            };
            for (face, corners) in ranks.map(lists.len(), corners)?.into_iter().flatten() {
                let triangle = scene.triangles[faces[face as usize].number as usize];
                for (vertex, gradient) in triangle.vertices.into_iter().zip(corners) {
                    vertices[vertex as usize] += gradient;
                }
            }
        }
    }
    for (vertex, gradient) in (0..).zip(&mut vertices) {
        *gradient = if movable.vertex(vertex) { *gradient } else { DVec3::ZERO };
    }
    let gradient = to_metres(scene, camera, &view, vertices);
    Ok(if whole { gradient } else { GeometryGradient { camera: CameraGradient::default(), ..gradient } })
}

/// The lines in one direction.
struct Lines {
    axis: Axis,
    /// Lines per picture.
    count: u32,
    /// Lines per pixel.
    side: u32,
    /// Width and height of the picture in pixels.
    size: [u32; 2],
}

impl Lines {
    /// Coordinate of a line, counted from the top or from the left.
    fn across(&self, line: u32) -> f64 {
        let place = f64::from(2 * line + 1) / f64::from(self.count) - 1.0;
        if self.axis == Axis::Rows { -place } else { place }
    }

    /// The faces that each of the [`BLOCKS`] blocks from line `first` on may cross, in ascending order.
    fn faces_of_blocks(&self, first: u32, faces: &[Projected]) -> Vec<Vec<u32>> {
        let blocks = (self.count - first).div_ceil(BLOCK).min(BLOCKS);
        let mut lists = vec![Vec::new(); blocks as usize];
        for (number, face) in (0..).zip(faces) {
            // Conversions saturate.
            let line = |place: f64| ((place + 1.0) / 2.0 * f64::from(self.count)) as u32;
            let [low, high] = self.range(face).map(line);
            if high >= first {
                let block = |line: u32| (line.max(first) - first) / BLOCK;
                let listed = block(low)..(block(high) + 1).min(blocks);
                for block in listed {
                    lists[block as usize].push(number);
                }
            }
        }
        lists
    }

    /// Range of a face across the lines, in the order of the lines.
    fn range(&self, face: &Projected) -> [f64; 2] {
        match self.axis {
            Axis::Rows => {
                let [low, high] = face.bounds.y;
                [-high, -low]
            }
            Axis::Columns => face.bounds.x,
        }
    }

    /// Whether these lines cross the zeros of a function at the larger angle.
    fn own(&self, function: DVec3) -> bool {
        let [width, height] = self.size.map(f64::from);
        let rows = function.x.abs() * height >= function.y.abs() * width;
        rows == (self.axis == Axis::Rows)
    }

    /// Quadrature weight of the crossing of a line and an edge, in units of the line spacing: the edge up to halfway to the next
    /// line, or to its end if that comes before the next line. So an edge counts with its length wherever the lines lie. If it is
    /// shorter than their spacing it counts 1 where it is crossed, which is right on average.
    fn lines_near(&self, face: &Projected, edge: usize, across: f64) -> f64 {
        let mut reach = [f64::INFINITY; 2];
        for corner in [face.corners[(edge + 1) % 3], face.corners[(edge + 2) % 3]] {
            // Behind the camera there is no end.
            if corner.z > 0.0 {
                let [_, end, _] = self.axis.coefficients(corner / corner.z);
                let distance = end.clamp(-1.0, 1.0) - across;
                reach[usize::from(distance > 0.0)] = distance.abs();
            }
        }
        let lines = f64::from(self.count) / 2.0;
        let [before, after] = reach.map(|distance| distance * lines);
        let stands_for = |reach: f64| if reach < 1.0 { reach } else { 0.5 };
        if before + after < 1.0 { 1.0 } else { stands_for(before) + stands_for(after) }
    }

    /// Column and row of a point of a line.
    fn place(&self, along: f64, across: f64) -> [f64; 2] {
        let [width, height] = self.size.map(f64::from);
        let [x, y] = match self.axis {
            Axis::Rows => [along, across],
            Axis::Columns => [across, along],
        };
        [0.5 * (x + 1.0) * width, 0.5 * (1.0 - y) * height]
    }

    /// The pixel at a point.
    fn pixel(&self, along: f64, line: u32) -> usize {
        let [width, height] = self.size;
        let cell = |place: f64, cells: u32| (((place + 1.0) / 2.0 * f64::from(cells)) as u32).min(cells - 1);
        let (column, row) = match self.axis {
            Axis::Rows => (cell(along, width), line / self.side),
            Axis::Columns => (line / self.side, cell(-along, height)),
        };
        row as usize * width as usize + column as usize
    }

    /// Contribution of a block of lines to the derivatives with respect to the corners of the visible ones of the faces `list` of
    /// `faces`, as far as they move.
    fn sweep(
        &self,
        block: Range<u32>,
        list: &[u32],
        faces: &[Projected],
        moves: &(dyn Fn(&Projected) -> bool + Sync),
        colours: &dyn FaceColours,
        cotangent: &[[f64; 4]],
    ) -> Vec<(u32, [DVec3; 3])> {
        // From a distance in the picture, whose side is 2, to an area in pixels.
        let cells = match self.axis {
            Axis::Rows => self.size[0],
            Axis::Columns => self.size[1],
        };
        let area = f64::from(cells) / 2.0 / f64::from(self.side);
        let face = |place: u32| &faces[list[place as usize] as usize];
        let moving: Vec<u32> =
            list.iter().copied().filter(|&number| moves(&faces[number as usize])).collect();

        let mut seams: HashMap<[u32; 2], bool> = HashMap::new();
        let mut is_seamless = |before: Option<u32>, after: Option<u32>| {
            let Some((a, b)) = before.zip(after) else { return false };
            let fronts = [a.min(b), a.max(b)].map(face);
            *seams.entry([a.min(b), a.max(b)]).or_insert_with(|| {
                fronts.iter().all(|face| face.front)
                    && colours.is_seamless(fronts.map(|face| face.number as usize))
            })
        };

        let mut boundaries = Vec::new();
        let mut sweep = Sweep::default();
        for line in block {
            let across = self.across(line);
            let order = if self.axis == Axis::Rows { -across } else { across };
            let on_line = |face: &Projected| {
                let [low, high] = self.range(face);
                low <= order && order <= high
            };
            if !moving.iter().any(|&number| on_line(&faces[number as usize])) {
                continue;
            }
            let crossed = (0..).zip(list).map(|(place, &face)| (place, &faces[face as usize]));
            let crossed = crossed.filter(|(_, face)| on_line(face));
            sweep.line(crossed, self.axis, across, |Change { at, before, after, cause }| {
                let pixel = self.pixel(at, line);
                let by_pixel = cotangent[pixel];
                let function = match (cause, before, after) {
                    (Cause::Edge { face: owner, edge }, ..) if moves(face(owner)) => face(owner).edges[edge],
                    (Cause::Crossing, Some(a), Some(b)) if moves(face(a)) || moves(face(b)) => {
                        face(a).inverse_depth - face(b).inverse_depth
                    }
                    _ => return,
                };
                if by_pixel == [0.0; 4] || !self.own(function) || is_seamless(before, after) {
                    return;
                }
                let [slope, ..] = self.axis.coefficients(function);
                let lines = match cause {
                    Cause::Edge { face: owner, edge } => self.lines_near(face(owner), edge, across),
                    Cause::Crossing => 1.0,
                };
                let by_gain = -lines * area / slope * self.axis.place(at, across);
                let place = self.place(at, across);
                boundaries.push(Boundary { pixel, by_pixel, place, faces: [before, after], cause, by_gain });
            });
        }

        let gains = gains(&boundaries, face, colours);
        let mut adjoint = vec![FaceAdjoint::default(); list.len()];
        // Where nothing is gained, the derivative may not be finite: coplanar faces have no crossing.
        for (Boundary { faces, cause, by_gain, .. }, gain) in
            boundaries.iter().zip(gains).filter(|(_, gain)| *gain != 0.0)
        {
            let of_function = gain * *by_gain;
            match (cause, faces) {
                (Cause::Edge { face: owner, edge }, _) => {
                    adjoint[*owner as usize].edges[*edge] += of_function
                }
                (Cause::Crossing, [Some(a), Some(b)]) => {
                    adjoint[*a as usize].inverse_depth += of_function;
                    adjoint[*b as usize].inverse_depth -= of_function;
                }
                _ => {}
            }
        }
        let sum = |(&number, adjoint): (&u32, &FaceAdjoint)| {
            (*adjoint != FaceAdjoint::default())
                .then(|| (number, adjoint.of_corners(&faces[number as usize])))
        };
        list.iter().zip(&adjoint).filter_map(sum).collect()
    }
}

/// A place on a line where one visible face gives way to another.
struct Boundary {
    /// The pixel, and the derivative of the loss by it.
    pixel: usize,
    by_pixel: [f64; 4],
    /// Column and row.
    place: [f64; 2],
    /// Before and after it, by their places in the list of faces.
    faces: [Option<u32>; 2],
    cause: Cause,
    /// The derivative by the function that is zero here, per gain.
    by_gain: DVec3,
}

/// What the loss gains at each boundary where the face before it covers more of the pixel. The colours of a face are asked for together, once
/// for each edge within each pixel: at the mean of the places where lines cross it, as pictures show one point of a face in a pixel.
fn gains<'a>(
    boundaries: &[Boundary],
    face: impl Fn(u32) -> &'a Projected,
    colours: &dyn FaceColours,
) -> Vec<f64> {
    let mut sides = Vec::with_capacity(2 * boundaries.len());
    for (k, Boundary { faces, pixel, cause, .. }) in boundaries.iter().enumerate() {
        let edge = match cause {
            Cause::Edge { face, edge } => (*face, *edge),
            Cause::Crossing => (u32::MAX, 0),
        };
        let side = |(face, sign): (&Option<u32>, f64)| face.map(|face| ((face, *pixel, edge), k, sign));
        sides.extend(faces.iter().zip([1.0, -1.0]).filter_map(side));
    }
    sides.sort_by_key(|&(place, ..)| place);
    let mut gains = vec![0.0; boundaries.len()];
    for of_face in sides.chunk_by(|a, b| a.0.0 == b.0.0) {
        let Projected { front, number, .. } = face(of_face[0].0.0);
        let runs: Vec<_> = of_face.chunk_by(|a, b| a.0 == b.0).collect();
        let shown = match front {
            true => {
                let places: Vec<[f64; 2]> = runs.iter().map(|run| mean_place(boundaries, run)).collect();
                colours.at(*number as usize, &places)
            }
            false => vec![[0.0; 3]; runs.len()],
        };
        for (run, [r, g, b]) in runs.into_iter().zip(shown) {
            for &(_, k, sign) in run {
                let products =
                    boundaries[k].by_pixel.iter().zip([r, g, b, 1.0]).map(|(by, value)| by * value);
                gains[k] += sign * products.sum::<f64>();
            }
        }
    }
    gains
}

/// The mean of the places of some boundaries.
fn mean_place<P>(boundaries: &[Boundary], run: &[(P, usize, f64)]) -> [f64; 2] {
    let mean =
        |axis: usize| run.iter().map(|&(_, k, _)| boundaries[k].place[axis]).sum::<f64>() / run.len() as f64;
    [mean(0), mean(1)]
}

/// The derivatives of a loss with respect to the functions of a face.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct FaceAdjoint {
    edges: [DVec3; 3],
    inverse_depth: DVec3,
}

impl FaceAdjoint {
    /// The derivatives with respect to its corners, in the frame of the view.
    fn of_corners(&self, face: &Projected) -> [DVec3; 3] {
        let [a, b, c] = face.corners;
        let sign = if face.front { 1.0 } else { -1.0 };
        // d(b × c) = db × c + b × dc.
        let [bc, ca, ab] = self.edges.map(|edge| sign * edge);
        let mut of_a = ca.cross(c) + b.cross(ab);
        let mut of_b = ab.cross(a) + c.cross(bc);
        let mut of_c = bc.cross(b) + a.cross(ca);
        if self.inverse_depth != DVec3::ZERO {
            // n / (n · a), n = (b - a) × (c - a).
            let (to_b, to_c) = (b - a, c - a);
            let normal = to_b.cross(to_c);
            let det = normal.dot(a);
            let of_det = -self.inverse_depth.dot(face.inverse_depth) / det;
            let of_normal = self.inverse_depth / det + of_det * a;
            let (by_b, by_c) = (to_c.cross(of_normal), of_normal.cross(to_b));
            of_a += of_det * normal - by_b - by_c;
            of_b += by_b;
            of_c += by_c;
        }
        [of_a, of_b, of_c]
    }
}

/// Takes derivatives from the frame of the view to the scene: the transpose of the derivative of
/// [`View::new`] and of the change of frame.
fn to_metres(scene: &Scene, camera: &Camera, view: &View, in_frame: Vec<DVec3>) -> GeometryGradient {
    let mut moved = DVec3::ZERO;
    let [mut of_right, mut of_up, mut of_forward] = [DVec3::ZERO; 3];
    let per_tangent = DVec3::new(1.0 / view.tan_half_x, 1.0 / view.tan_half_y, 1.0);
    let to_scene = |(gradient, &vertex): (DVec3, &DVec3)| {
        let DVec3 { x, y, z } = gradient * per_tangent;
        let from_camera = vertex - view.position;
        of_right += x * from_camera;
        of_up += y * from_camera;
        of_forward += z * from_camera;
        let gradient = x * view.right + y * view.up + z * view.forward;
        moved += gradient;
        gradient
    };
    let vertices = in_frame.into_iter().zip(&scene.vertices).map(to_scene).collect();

    GeometryGradient { vertices, camera: camera_gradient(camera, -moved, [of_right, of_up, of_forward]) }
}

/// Derivatives of a loss by a camera, from those by its position with the axes of its [`View`] held fixed, and by these axes: right, up and
/// forward.
pub fn camera_gradient(
    camera: &Camera,
    position: DVec3,
    [of_right, of_up, of_forward]: [DVec3; 3],
) -> CameraGradient {
    // up = right × forward; right = s / |s|, s = forward × u; forward = f / |f|, f = target - position; u = up / |up|.
    let View { right, forward, .. } = View::new(camera);
    let of_right = of_right + forward.cross(of_up);
    let of_forward = of_forward + of_up.cross(right);
    let u = camera.up.normalize();
    let of_s = of_right.reject_from_normalized(right) / forward.cross(u).length();
    let of_forward = of_forward + u.cross(of_s);
    let target = of_forward.reject_from_normalized(forward) / (camera.target - camera.position).length();
    let up = of_s.cross(forward).reject_from_normalized(u) / camera.up.length();
    CameraGradient { position: position - target, target, up }
}
