//! Makes meshes as scans give them into meshes made for light: walls are planes, gaps are closed, lamps are planar or convex.
//!
//! All is done within one distance, a few times the error of a vertex. Surfaces that curve stay as they are, but for their gaps.
//! Triangles keep their corners and their order; only vertices move.

mod contacts;
mod lamps;
mod planes;
mod seams;

use super::{Edges, Scene, Welded, sides};
use antirad_base::parallel;
use contacts::Contacts;
use glam::DVec3;
use nalgebra::{DMatrix, DVector};
use planes::{Plane, Planes};

/// In distances: the farthest that a vertex moves.
const FARTHEST: f64 = 3.0;
/// Smallest singular value of some planes' normals, as a share of the largest, for which their intersection is found: planes that meet
/// at less than 6° have none to rely on.
const PARALLEL: f64 = 0.05;
/// A triangle whose least height shrinks to less than this share has collapsed.
const COLLAPSED: f64 = 0.05;
/// Moves below this share of the extent are rounding, and are not made.
const ROUNDING: f64 = 1e-13;
/// No neighbour.
const NONE: u32 = u32::MAX;

/// What was done to a mesh.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Snapped {
    /// Number of vertices that moved, of all.
    pub moved: usize,
    pub vertices: usize,
    /// Largest move, m.
    pub farthest: f64,
    pub planes: usize,
}

/// Triangles of points. Vertices that coincide are one point.
struct Surface {
    distance: f64,
    points: Vec<DVec3>,
    triangles: Vec<[u32; 3]>,
    /// Material of each triangle that emits light.
    emitter: Vec<Option<u32>>,
}

impl Surface {
    fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|p| self.points[p as usize])
    }

    /// Normal times twice the area.
    fn normal(&self, triangle: u32) -> DVec3 {
        normal(self.corners(triangle))
    }
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// The least height of a triangle.
fn height(corners: [DVec3; 3]) -> f64 {
    let [a, b, c] = corners;
    let longest = a.distance(b).max(b.distance(c)).max(c.distance(a));
    normal(corners).length() / longest.max(f64::MIN_POSITIVE)
}

/// The topology of a surface whose gaps are closed: points that belong together are one joint.
struct Joints {
    /// Per point.
    of: Vec<u32>,
    /// Per joint, the mean of its points.
    places: Vec<DVec3>,
    /// Per triangle, its corners.
    triangles: Vec<[u32; 3]>,
    /// Per triangle and side, the triangle on the other side.
    beyond: Vec<[u32; 3]>,
    /// Per joint, whether an edge of a single triangle ends there, gaps not closed.
    open: Vec<bool>,
}

impl Joints {
    fn new(surface: &Surface) -> Self {
        let of = seams::joined(surface);
        let count = of.iter().max().map_or(0, |&last| last as usize + 1);
        let mut sums = vec![(DVec3::ZERO, 0u32); count];
        for (&joint, &point) in of.iter().zip(&surface.points) {
            let (sum, number) = &mut sums[joint as usize];
            *sum += point;
            *number += 1;
        }
        let places = sums
            .into_iter()
            .map(|(sum, number)| if number == 1 { sum } else { sum / f64::from(number.max(1)) })
            .collect();
        let triangles: Vec<[u32; 3]> =
            surface.triangles.iter().map(|corners| corners.map(|p| of[p as usize])).collect();
        let mut beyond = vec![[NONE; 3]; triangles.len()];
        let mut open = vec![false; count];
        for edge in Edges::of(surface.triangles.iter().copied()).iter().filter(|edge| edge.len() == 1) {
            edge.ends().iter().for_each(|&point| open[of[point as usize] as usize] = true);
        }
        for edge in Edges::of(triangles.iter().copied()).iter() {
            let [low, _] = edge.ends();
            let (mut there, mut back): (Vec<u32>, Vec<u32>) = (Vec::new(), Vec::new());
            for (t, [from, _]) in edge.directed() {
                if from == low { there.push(t) } else { back.push(t) }
            }
            // Those that run opposite ways belong together; what is left over are sheets that disagree about the front.
            let both = there.len().min(back.len());
            let rest: Vec<u32> = there.drain(both..).chain(back.drain(both..)).collect();
            let pairs = there.into_iter().zip(back).chain(rest.chunks_exact(2).map(|two| (two[0], two[1])));
            for (one, other) in pairs {
                for (t, neighbour) in [(one, other), (other, one)] {
                    if let Some(side) = side_of(triangles[t as usize], edge.ends()) {
                        beyond[t as usize][side] = neighbour;
                    }
                }
            }
        }
        Self { of, places, triangles, beyond, open }
    }
}

/// Which side of a triangle has these ends.
fn side_of(corners: [u32; 3], [low, high]: [u32; 2]) -> Option<usize> {
    sides(corners).iter().position(|&[a, b]| (a.min(b), a.max(b)) == (low, high))
}

/// Snaps those triangles of a scene for which `within` holds.
pub(super) fn snap(scene: &mut Scene, distance: f64, within: impl Fn(usize) -> bool) -> Snapped {
    let has_area = |t: &usize| scene.degenerate.binary_search(&(*t as u32)).is_err();
    let chosen: Vec<usize> = (0..scene.triangles.len()).filter(|&t| within(t)).filter(has_area).collect();
    let mut used: Vec<u32> = chosen.iter().flat_map(|&t| scene.triangles[t].vertices).collect();
    used.sort_unstable();
    used.dedup();
    let welded = Welded::exactly(used.iter().map(|&v| scene.vertices[v as usize]));
    let mut point_of = vec![NONE; scene.vertices.len()];
    used.iter().zip(&welded.position).for_each(|(&v, &point)| point_of[v as usize] = point);
    let surface = Surface {
        distance,
        points: welded.first.iter().map(|&k| scene.vertices[used[k as usize] as usize]).collect(),
        triangles: chosen
            .iter()
            .map(|&t| scene.triangles[t].vertices.map(|v| point_of[v as usize]))
            .collect(),
        emitter: chosen.iter().map(|&t| scene.shines(t).then_some(scene.triangles[t].material)).collect(),
    };
    let (places, planes) = snapped(&surface);
    let mut report = Snapped { vertices: used.len(), planes, ..Snapped::default() };
    for v in used {
        let (from, to) = (scene.vertices[v as usize], places[point_of[v as usize] as usize]);
        if from != to {
            report.moved += 1;
            report.farthest = report.farthest.max(from.distance(to));
            scene.vertices[v as usize] = to;
        }
    }
    report
}

/// Where the points of a surface go, and the number of planes found.
fn snapped(surface: &Surface) -> (Vec<DVec3>, usize) {
    let joints = Joints::new(surface);
    let mut planes = Planes::of(surface, &joints);
    let contacts = Contacts::new(surface, &joints, &mut planes);
    let of_joint = planes_of_joints(&joints, &planes, &contacts);
    let mut places = parallel::map(joints.places.iter().zip(&of_joint), |(&place, own)| {
        on_planes(place, own, &planes.planes, surface.distance)
    });
    lamps::straighten(surface, &joints, &planes, &of_joint, &mut places);
    let before = places.clone();
    let convex = lamps::make_convex(surface, &joints, &of_joint, &mut places);
    let places = without_collapse(surface, &joints, &planes, [&places, &before], &convex);
    (places, planes.planes.len())
}

/// Per joint, the planes that it belongs on, ascending: those of its triangles, then those that it touches.
fn planes_of_joints(joints: &Joints, planes: &Planes, contacts: &Contacts) -> Vec<Vec<u32>> {
    let mut of_joint = contacts.touched.clone();
    for (corners, &plane) in joints.triangles.iter().zip(&planes.of) {
        if plane != NONE {
            corners.iter().for_each(|&joint| of_joint[joint as usize].push(plane));
        }
    }
    for own in &mut of_joint {
        own.sort_unstable();
        own.dedup();
    }
    of_joint
}

/// The point of some planes' intersection that is nearest to a place; the place itself where that is too far.
fn on_planes(place: DVec3, own: &[u32], planes: &[Plane], distance: f64) -> DVec3 {
    if own.is_empty() {
        return place;
    }
    let of = |k: usize| &planes[own[k] as usize];
    let normals = DMatrix::from_fn(own.len(), 3, |row, column| of(row).normal[column]);
    let heights = DVector::from_fn(own.len(), |row, _| -of(row).height(place));
    let decomposition = normals.svd(true, true);
    let least = PARALLEL * decomposition.singular_values.max();
    let Ok(step) = decomposition.solve(&heights, least) else { return place };
    let step = DVec3::new(step[0], step[1], step[2]);
    let size = own.iter().map(|&p| planes[p as usize].extent).fold(place.abs().max_element(), f64::max);
    if step.length() > ROUNDING * size && step.length() <= FARTHEST * distance { place + step } else { place }
}

/// Where points go: to the first of some places of their joints at which no triangle turns over, collapses or has a corner moved too far,
/// else to the mean of their joint, else nowhere. Triangles that are faces of a convex lamp in the first places may turn.
fn without_collapse(
    surface: &Surface,
    joints: &Joints,
    planes: &Planes,
    tried: [&[DVec3]; 2],
    convex: &[bool],
) -> Vec<DVec3> {
    let at = |stage: u8, point: u32| {
        let joint = joints.of[point as usize] as usize;
        match stage {
            0 | 1 => tried[stage as usize][joint],
            2 => joints.places[joint],
            _ => surface.points[point as usize],
        }
    };
    let mut stages = vec![0u8; joints.places.len()];
    let stage_of = |stages: &[u8], point: u32| stages[joints.of[point as usize] as usize];
    let is_sound = |stages: &[u8], t: u32| {
        let corners = surface.triangles[t as usize];
        let before = surface.corners(t);
        let after = corners.map(|p| at(stage_of(stages, p), p));
        if before == after {
            return true;
        }
        let (old, new) = (normal(before), normal(after));
        let upright = match planes.of[t as usize] {
            _ if convex[t as usize] && stage_of(stages, corners[0]) == 0 => true,
            // Noise turns small triangles anyhow.
            NONE => height(before) < surface.distance || old.dot(new) > 0.0,
            plane => {
                let normal = planes.planes[plane as usize].normal;
                new.dot(if planes.turned[t as usize] { -normal } else { normal }) > 0.0
            }
        };
        let near = |p: u32| {
            at(stage_of(stages, p), p).distance(surface.points[p as usize]) <= FARTHEST * surface.distance
        };
        upright && height(after) >= COLLAPSED * height(before) && corners.iter().all(|&p| near(p))
    };
    loop {
        let all = 0..surface.triangles.len() as u32;
        let bad = parallel::filter(all, |&t| !is_sound(&stages, t));
        let mut changed = false;
        for &joint in bad.iter().flat_map(|&t| &joints.triangles[t as usize]) {
            let stage = &mut stages[joint as usize];
            changed |= *stage < 3;
            *stage = (*stage + 1).min(3);
        }
        if !changed {
            break;
        }
    }
    (0..surface.points.len() as u32).map(|p| at(stage_of(&stages, p), p)).collect()
}

#[cfg(test)]
mod tests;
