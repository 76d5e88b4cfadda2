//! Lamps with few faces to compute: planar ones get straight borders, closed ones become convex.

use super::planes::Planes;
use super::{Joints, NONE, Surface, height, normal};
use glam::{DVec2, DVec3};
use std::collections::{BTreeMap, HashSet};

/// In distances: how far a border may be from its convex hull.
const DENT: f64 = 1.5;
/// In distances: how far a corner of a closed lamp moves at most.
const FARTHEST: f64 = 3.0;
/// As a share of the size of a lamp: dents that count as none, and how far an edge that is mended bulges.
const ROUNDING: f64 = 1e-9;
const CONVEX: f64 = 1e-6;
/// Shares of the way to the mean of its neighbours that a corner goes, in turn, and how often.
const SMOOTHING: [f64; 2] = [0.5, -0.53];
const SMOOTHED: usize = 30;
/// Rounds over all edges in which a lamp becomes convex or stays as it is.
const ROUNDS: usize = 4000;
/// A triangle whose height shrinks to less than this share of the distance has collapsed.
const THIN: f64 = 0.01;

/// Emitting triangles of one material and, where `same` holds, connected along edges; by their first triangles.
fn parts(surface: &Surface, joints: &Joints, same: impl Fn(u32, u32) -> bool) -> Vec<Vec<u32>> {
    let mut seen = vec![false; surface.triangles.len()];
    let mut parts = Vec::new();
    for first in 0..surface.triangles.len() as u32 {
        if seen[first as usize] || surface.emitter[first as usize].is_none() {
            continue;
        }
        seen[first as usize] = true;
        let mut part = vec![first];
        let mut next = 0;
        while let Some(&t) = part.get(next) {
            for other in joints.beyond[t as usize] {
                if other != NONE
                    && !seen[other as usize]
                    && surface.emitter[other as usize] == surface.emitter[t as usize]
                    && same(t, other)
                {
                    seen[other as usize] = true;
                    part.push(other);
                }
            }
            next += 1;
        }
        parts.push(part);
    }
    parts
}

/// Moves the borders of planar lamps onto their convex hulls, where these are near.
pub(super) fn straighten(
    surface: &Surface,
    joints: &Joints,
    planes: &Planes,
    of_joint: &[Vec<u32>],
    places: &mut [DVec3],
) {
    let plane_of = |t: u32| planes.of[t as usize];
    for part in parts(surface, joints, |t, other| plane_of(t) == plane_of(other)) {
        let inside: HashSet<u32> = part.iter().copied().collect();
        let plane = plane_of(part[0]);
        if plane == NONE {
            continue;
        }
        let supporting = &planes.planes[plane as usize];
        let (u, v) = supporting.normal.any_orthonormal_pair();
        let mut border: Vec<u32> = Vec::new();
        for &t in &part {
            for (side, beyond) in joints.beyond[t as usize].iter().enumerate() {
                if !inside.contains(beyond) {
                    let corners = joints.triangles[t as usize];
                    border.extend([corners[side], corners[(side + 1) % 3]]);
                }
            }
        }
        border.sort_unstable();
        border.dedup();
        let flat = |joint: u32| {
            let from = places[joint as usize] - supporting.centre;
            DVec2::new(from.dot(u), from.dot(v))
        };
        let points: Vec<DVec2> = border.iter().map(|&joint| flat(joint)).collect();
        let hull = hull(points.clone());
        let size = supporting.widths[0].max(supporting.widths[1]);
        let moved: Vec<(u32, DVec2)> = border
            .iter()
            .zip(&points)
            .map(|(&joint, &point)| (joint, nearest_on(&hull, point) - point))
            .filter(|(_, step)| step.length() > ROUNDING * size)
            .collect();
        // A border that another plane holds does not move.
        let free = |joint: u32| of_joint[joint as usize].len() == 1;
        let near = |(joint, step): &(u32, DVec2)| free(*joint) && step.length() <= DENT * surface.distance;
        if hull.len() >= 3 && moved.iter().all(near) {
            moved.iter().for_each(|(joint, step)| places[*joint as usize] += u * step.x + v * step.y);
        }
    }
}

/// The convex hull of points, counter-clockwise (A. Andrew, *Information Processing Letters* 9, 1979).
fn hull(mut points: Vec<DVec2>) -> Vec<DVec2> {
    points.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
    let mut hull: Vec<DVec2> = Vec::new();
    for upper in [false, true] {
        let start = hull.len();
        let chain: Vec<DVec2> = if upper { points.iter().rev().copied().collect() } else { points.clone() };
        for point in chain {
            while hull.len() >= start + 2 {
                let [.., a, b] = hull[..] else { break };
                if (b - a).perp_dot(point - b) > 0.0 {
                    break;
                }
                hull.pop();
            }
            hull.push(point);
        }
        hull.pop();
    }
    hull
}

/// The place on the border of a polygon nearest to a point.
fn nearest_on(polygon: &[DVec2], point: DVec2) -> DVec2 {
    let sides = (0..polygon.len()).map(|k| [polygon[k], polygon[(k + 1) % polygon.len()]]);
    let nearest = sides.map(|[a, b]| {
        let along = b - a;
        a + along * ((point - a).dot(along) / along.length_squared().max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
    });
    nearest.min_by(|a, b| a.distance(point).total_cmp(&b.distance(point))).unwrap_or(point)
}

/// Makes closed lamps convex that nearly are. Returns per triangle whether it is part of such a one.
pub(super) fn make_convex(
    surface: &Surface,
    joints: &Joints,
    of_joint: &[Vec<u32>],
    places: &mut [DVec3],
) -> Vec<bool> {
    let mut convex = vec![false; surface.triangles.len()];
    for part in parts(surface, joints, |_, _| true) {
        let Some(shell) = Shell::new(joints, of_joint, &part) else {
            continue;
        };
        let Some(mended) = shell.mended(surface, joints, places) else { continue };
        part.iter().for_each(|&t| convex[t as usize] = true);
        mended.into_iter().for_each(|(joint, place)| places[joint as usize] = place);
    }
    convex
}

/// A closed surface of the topology of a ball.
struct Shell {
    /// Ascending.
    joints: Vec<u32>,
    /// Corners of triangles, as places in the list of joints.
    triangles: Vec<[usize; 3]>,
    /// The corners of both triangles of an edge: its ends, and the other corner of either.
    edges: Vec<[usize; 4]>,
    /// Per joint, whether it may move: not where it is held in a plane.
    free: Vec<bool>,
}

impl Shell {
    fn new(joints: &Joints, of_joint: &[Vec<u32>], part: &[u32]) -> Option<Self> {
        let mut own: Vec<u32> = part.iter().flat_map(|&t| joints.triangles[t as usize]).collect();
        own.sort_unstable();
        own.dedup();
        let place = |joint: u32| own.binary_search(&joint).unwrap_or_default();
        let triangles: Vec<[usize; 3]> =
            part.iter().map(|&t| joints.triangles[t as usize].map(place)).collect();
        let mut half: BTreeMap<[usize; 2], usize> = BTreeMap::new();
        for corners in &triangles {
            for k in 0..3 {
                let [a, b, c] = [0, 1, 2].map(|step| corners[(k + step) % 3]);
                if half.insert([a, b], c).is_some() {
                    return None;
                }
            }
        }
        let mut edges = Vec::with_capacity(half.len() / 2);
        for (&[a, b], &c) in &half {
            let &d = half.get(&[b, a])?;
            if a < b {
                edges.push([a, b, c, d]);
            }
        }
        let ball = own.len() + triangles.len() == edges.len() + 2;
        let free = own.iter().map(|&joint| of_joint[joint as usize].is_empty()).collect();
        ball.then_some(Self { joints: own, triangles, edges, free })
    }

    /// New places of its joints, in which it is convex; none where that takes far moves or no move.
    fn mended(&self, surface: &Surface, joints: &Joints, places: &[DVec3]) -> Option<Vec<(u32, DVec3)>> {
        let mut at: Vec<DVec3> = self.joints.iter().map(|&joint| places[joint as usize]).collect();
        let centre = at.iter().sum::<DVec3>() / at.len() as f64;
        let size = at.iter().map(|place| place.distance(centre)).fold(0.0, f64::max);
        if self.worst(&at) <= ROUNDING * size {
            return None;
        }
        self.smooth(&mut at);
        let done = (0..ROUNDS).any(|_| {
            self.push_out(&mut at, CONVEX * size);
            self.worst(&at) <= ROUNDING * size
        });
        let near = |(place, &joint): (&DVec3, &u32)| {
            place.distance(joints.places[joint as usize]) <= FARTHEST * surface.distance
        };
        let centre = at.iter().sum::<DVec3>() / at.len() as f64;
        let sound = |corners: &[usize; 3]| {
            let corners = corners.map(|k| at[k]);
            (corners[0] - centre).dot(normal(corners)) > 0.0 && height(corners) >= THIN * surface.distance
        };
        let good = done && at.iter().zip(&self.joints).all(near) && self.triangles.iter().all(sound);
        good.then(|| self.joints.iter().copied().zip(at).collect())
    }

    /// Averages noise out, within the same volume (G. Taubin, *A signal processing approach to fair surface design*, 1995).
    fn smooth(&self, at: &mut [DVec3]) {
        let before = self.volume(at);
        for share in SMOOTHING.into_iter().cycle().take(SMOOTHING.len() * SMOOTHED) {
            let mut sums = vec![(DVec3::ZERO, 0.0); at.len()];
            for &[a, b, ..] in &self.edges {
                for (k, other) in [(a, b), (b, a)] {
                    sums[k].0 += at[other];
                    sums[k].1 += 1.0;
                }
            }
            for (k, (sum, count)) in sums.into_iter().enumerate() {
                if self.free[k] {
                    at[k] += share * (sum / count - at[k]);
                }
            }
        }
        let scale = (before / self.volume(at)).cbrt();
        if scale.is_finite() {
            let centre = at.iter().sum::<DVec3>() / at.len() as f64;
            let free = at.iter_mut().zip(&self.free).filter(|(_, free)| **free);
            free.for_each(|(place, _)| *place = centre + scale * (*place - centre));
        }
    }

    fn volume(&self, at: &[DVec3]) -> f64 {
        // From a place nearby, for rounding.
        let part = |corners: &[usize; 3]| {
            let [a, b, c] = corners.map(|k| at[k] - at[0]);
            a.dot(b.cross(c)) / 6.0
        };
        self.triangles.iter().map(part).sum()
    }

    /// The deepest dent: height of a triangle's far corner over the plane of its neighbour.
    fn worst(&self, at: &[DVec3]) -> f64 {
        let dent = |edge: &[usize; 4]| {
            let [a, b, c, d] = edge.map(|k| at[k]);
            let normal = normal([a, b, c]);
            (d - a).dot(normal) / normal.length()
        };
        self.edges
            .iter()
            .map(dent)
            .fold(f64::NEG_INFINITY, |worst, dent| if dent > worst { dent } else { worst })
    }

    /// Moves the corners at each edge that dents by the least that turns it outwards (position-based dynamics: Müller, Heidelberger,
    /// Hennix, Ratcliff, 2007).
    fn push_out(&self, at: &mut [DVec3], margin: f64) {
        for edge in &self.edges {
            let [a, b, c, d] = edge.map(|k| at[k]);
            // Six times the volume of the tetrahedron, which is negative where the edge is convex, and its derivatives.
            let up = normal([a, b, c]);
            let volume = (d - a).dot(up) + margin * up.length();
            if volume.is_nan() || volume <= 0.0 {
                continue;
            }
            let slopes = [(d - b).cross(c - b), (c - a).cross(d - a), (d - a).cross(b - a), up];
            let total: f64 = edge
                .iter()
                .zip(slopes)
                .filter(|(k, _)| self.free[**k])
                .map(|(_, s)| s.length_squared())
                .sum();
            if total.is_nan() || total <= 0.0 {
                continue;
            }
            for (&k, slope) in edge.iter().zip(slopes) {
                if self.free[k] {
                    at[k] -= slope * (volume / total);
                }
            }
        }
    }
}
