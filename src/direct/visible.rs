//! The part of a lamp that a point sees, exactly: its cone of directions less those of all blockers.

use super::blockers::{Blockers, CORNERS, OUTLINE};
use super::cone::{Side, cut, extent};
use super::derivative::Sight;
use super::lamps::Lamp;
use super::polygon::Polygon;
use crate::model::Facet;
use glam::DVec3;
use std::ops::Range;

/// What shadows are computed from: triangles, in any unit of length, and what they block.
#[derive(Clone, Copy)]
pub struct Geometry<'a> {
    pub facets: &'a [Facet],
    pub blockers: &'a Blockers,
}

/// A lamp in place.
pub struct Placed<'a> {
    pub lamp: &'a Lamp,
    pub corners: Vec<DVec3>,
    pub outline: Vec<DVec3>,
    pub normal: DVec3,
}

impl Geometry<'_> {
    /// Height up to which a point counts as in a plane.
    pub fn tolerance(&self) -> f64 {
        self.blockers.tolerance()
    }

    /// A corner of a triangle.
    pub fn corner(&self, [triangle, corner]: [u32; 2]) -> DVec3 {
        self.facets[triangle as usize].corners[corner as usize]
    }

    /// The corners of a polygon.
    pub fn corners(&self, polygon: &Polygon) -> impl Iterator<Item = DVec3> + Clone {
        polygon.corners.iter().map(|&corner| self.corner(corner))
    }

    /// What may stand between some points of a plane and a lamp: [`Blockers::between`].
    pub fn between(&self, points: &[DVec3], normal: DVec3, lamp: &Placed) -> Vec<u32> {
        self.blockers.between(self, points, normal, lamp)
    }

    pub fn place<'b>(&self, lamp: &'b Lamp) -> Placed<'b> {
        let at = |&corner: &[u32; 2]| self.corner(corner);
        Placed {
            lamp,
            corners: lamp.corners.iter().map(at).collect(),
            outline: lamp.outline.iter().map(at).collect(),
            normal: self.facets[lamp.first()].normal,
        }
    }

    /// Whether a triangle and the front of a lamp can see each other.
    pub fn faces(&self, receiver: usize, lamp: &Placed) -> bool {
        let facet = &self.facets[receiver];
        let above =
            |plane: DVec3, normal: DVec3, corner: &DVec3| (*corner - plane).dot(normal) > self.tolerance();
        facet.area > 0.0
            && lamp.corners.iter().any(|c| above(facet.centroid, facet.normal, c))
            && facet.corners.iter().any(|c| above(lamp.corners[0], lamp.normal, c))
    }
}

/// The number of the plane through the point and a side of a lamp's outline.
pub fn lamp_side(side: usize) -> u32 {
    side as u32
}

/// The number of the plane of the point's horizon.
pub const HORIZON: u32 = u32::MAX;

/// Planes of blockers begin here, so many for each: through the pieces of its outline, its edges from corner to corner, and through the
/// line in which it crosses the lamp's plane.
const BLOCKERS: u32 = 1 << 16;
const PLANES: u32 = 1 << 10;

/// The first plane of a blocker through an edge.
pub const EDGES: usize = OUTLINE;

/// The last plane of a blocker, through the line in which it crosses the lamp's plane.
pub const CROSSING: usize = PLANES as usize - 1;
const _: () = assert!(EDGES + CORNERS <= CROSSING);

/// The number of plane `which` of the blocker at a place in the list.
pub fn blocker_plane(place: usize, which: usize) -> u32 {
    BLOCKERS + PLANES * place as u32 + which as u32
}

/// The place of a blocker in the list, and which of its planes, from a plane's number.
pub fn of_blocker(plane: u32) -> Option<(usize, usize)> {
    (BLOCKERS..HORIZON).contains(&plane).then(|| {
        let at = plane - BLOCKERS;
        ((at / PLANES) as usize, (at % PLANES) as usize)
    })
}

/// A blocker as seen from a point.
#[derive(Clone, Copy)]
pub struct View {
    /// Normal of its plane, as a product of differences of corners, not unit.
    pub area_vector: DVec3,
    /// Height of the point over that plane, times the length of `area_vector`.
    pub height: f64,
    /// What products of corners, as seen from the point, are multiplied by to point into the cone of the blocker: 1 where the point sees
    /// its back, -1 where it sees its front.
    pub sign: f64,
}

impl View {
    /// From the corners of a triangle of the blocker, given from the point; `None` where the point lies in its plane.
    pub fn new([a, b, c]: [DVec3; 3]) -> Option<Self> {
        let area_vector = (b - a).cross(c - a);
        let height = -area_vector.dot(a);
        let in_plane = height.abs() <= 1e-12 * area_vector.length();
        // Seen from the front, corners run counter-clockwise, so that the normals of the edges' planes point outwards.
        let sign = if height > 0.0 { -1.0 } else { 1.0 };
        (!in_plane).then_some(Self { area_vector, height, sign })
    }

    /// Normal of the plane through the point and the line in which the blocker crosses the lamp's plane; it points to the directions in
    /// which the blocker is nearer. `lamp_corner` is given from the point.
    pub fn crossing(&self, lamp_corner: DVec3, lamp_normal: DVec3) -> DVec3 {
        let lamp_height = -lamp_corner.dot(lamp_normal);
        self.sign * (lamp_height * self.area_vector - self.height * lamp_normal)
    }
}

/// A blocker that a point sees before the lamp.
struct Seen {
    /// Its place in the list.
    place: usize,
    /// Its planes: unit normals that point into its cone.
    normals: Range<usize>,
    /// Whether the last of these is that of [`CROSSING`].
    crosses: bool,
}

/// Finds the visible parts of lamps; keeps its memory between points.
#[derive(Default)]
pub struct Visible {
    /// Cones, one after the other.
    stack: Vec<Side>,
    /// The blockers that a point sees before the lamp, and their planes.
    seen: Vec<Seen>,
    normals: Vec<DVec3>,
    /// Places in `seen`, one run after the other: what may hide some of a cone.
    candidates: Vec<u32>,
    /// Blockers tested against cones so far.
    pub tests: u64,
    /// The corners of a blocker, from the point.
    corners: Vec<DVec3>,
    /// A cone while it is cut.
    from: Vec<Side>,
    to: Vec<Side>,
}

impl Visible {
    /// Calls `emit` with each part of the lamp that is visible above the horizon: convex cones without overlap. `outline`: whether sides end
    /// at all vertices of the lamp's outline, or only at its corners.
    pub fn parts(&mut self, sight: &Sight, outline: bool, emit: &mut dyn FnMut(&[Side])) {
        let &Sight { ref geometry, point, normal, lamp, blockers } = sight;
        let corners = if outline { &lamp.outline } else { &lamp.corners };
        if (point - corners[0]).dot(lamp.normal) <= geometry.tolerance() {
            return;
        }
        self.stack.clear();
        // The lamp's front is seen clockwise, so its corners are taken in reverse.
        let count = corners.len();
        let side = |k: usize| Side {
            corner: corners[count - 1 - k] - point,
            plane: lamp_side((2 * count - 2 - k) % count),
        };
        self.stack.extend((0..count).map(side));
        match extent(&self.stack, normal) {
            [false, _] => return,
            [true, false] => {}
            [true, true] => {
                self.to.clear();
                cut(&self.stack, normal, HORIZON, &mut self.to);
                std::mem::swap(&mut self.stack, &mut self.to);
            }
        }
        self.see_blockers(geometry, point, lamp, blockers);
        self.candidates.clear();
        self.candidates.extend(0..self.seen.len() as u32);
        self.subtract(0..self.stack.len(), 0..self.seen.len(), emit);
    }

    /// Lists the blockers whose cones meet that of the lamp, which is all of the stack.
    fn see_blockers(&mut self, geometry: &Geometry, point: DVec3, lamp: &Placed, blockers: &[u32]) {
        self.seen.clear();
        self.normals.clear();
        let cone = &self.stack;
        let corners = &mut self.corners;
        let lamp_corner = lamp.corners[0] - point;
        self.tests += blockers.len() as u64;
        for (place, &blocker) in blockers.iter().enumerate() {
            let polygon = geometry.blockers.polygon(blocker);
            corners.clear();
            corners.extend(geometry.corners(polygon).map(|c| c - point));
            let beside = |k: usize| {
                let normal = cone[k].corner.cross(cone[(k + 1) % cone.len()].corner);
                corners.iter().all(|c| c.dot(normal) <= 0.0)
            };
            let over_lamp = |c: &DVec3| (*c - lamp_corner).dot(lamp.normal);
            if corners.iter().all(|c| over_lamp(c) <= geometry.tolerance()) || (0..cone.len()).any(beside) {
                continue;
            }
            let triangle = geometry.facets[polygon.first()].corners.map(|c| c - point);
            let Some(view) = View::new(triangle) else { continue };
            let first = self.normals.len();
            for (k, corner) in corners.iter().enumerate() {
                let normal = view.sign * corner.cross(corners[(k + 1) % corners.len()]);
                self.normals.push(normal.normalize_or_zero());
            }
            let crosses = corners.iter().any(|c| over_lamp(c) < -geometry.tolerance());
            if crosses {
                self.normals.push(view.crossing(lamp_corner, lamp.normal).normalize_or_zero());
            }
            if self.normals[first..].iter().all(|&normal| extent(cone, normal)[0]) {
                self.seen.push(Seen { place, normals: first..self.normals.len(), crosses });
            } else {
                self.normals.truncate(first);
            }
        }
    }

    /// Emits the parts of the cone `cone` of the stack outside of the blockers `rest` of the candidates.
    fn subtract(&mut self, cone: Range<usize>, rest: Range<usize>, emit: &mut dyn FnMut(&[Side])) {
        for at in rest.clone() {
            let k = self.candidates[at] as usize;
            if !self.meets(cone.clone(), k) {
                continue;
            }
            // Plane by plane: what is outside of it is done with this blocker, the rest goes on to the next.
            let mut inside = cone;
            for n in self.seen[k].normals.clone() {
                let Seen { place, normals, crosses } = &self.seen[k];
                let which =
                    if *crosses && n + 1 == normals.end { CROSSING } else { EDGES + n - normals.start };
                let (normal, plane) = (self.normals[n], blocker_plane(*place, which));
                match extent(&self.stack[inside.clone()], normal) {
                    [_, false] => {}
                    [false, true] => {
                        // Touched in its boundary only.
                        self.subtract(inside, at + 1..rest.end, emit);
                        return;
                    }
                    [true, true] => {
                        let outside = self.cut_off(inside.clone(), -normal, plane);
                        let candidates = self.candidates.len();
                        for next in at + 1..rest.end {
                            if self.may_meet(outside.clone(), self.candidates[next] as usize) {
                                self.candidates.push(self.candidates[next]);
                            }
                        }
                        self.subtract(outside.clone(), candidates..self.candidates.len(), emit);
                        self.candidates.truncate(candidates);
                        self.stack.truncate(outside.start);
                        inside = self.cut_off(inside, normal, plane);
                    }
                }
            }
            return;
        }
        emit(&self.stack[cone]);
    }

    /// Appends the part of a cone of the stack on the positive side of a plane.
    fn cut_off(&mut self, cone: Range<usize>, normal: DVec3, plane: u32) -> Range<usize> {
        self.to.clear();
        cut(&self.stack[cone], normal, plane, &mut self.to);
        let begin = self.stack.len();
        self.stack.append(&mut self.to);
        begin..self.stack.len()
    }

    /// Whether no plane of blocker `k` separates it from a cone.
    fn may_meet(&mut self, cone: Range<usize>, k: usize) -> bool {
        self.tests += 1;
        let normals = &self.normals[self.seen[k].normals.clone()];
        normals.iter().all(|&normal| extent(&self.stack[cone.clone()], normal)[0])
    }

    /// Whether blocker `k` hides some of a cone.
    fn meets(&mut self, cone: Range<usize>, k: usize) -> bool {
        self.tests += 1;
        let normals = &self.normals[self.seen[k].normals.clone()];
        let cone = &self.stack[cone];
        let mut cuts = 0;
        for &normal in normals {
            match extent(cone, normal) {
                [false, _] => return false,
                [true, true] => cuts += 1,
                [true, false] => {}
            }
        }
        if cuts < 2 {
            // One plane that cuts leaves something on both sides.
            return true;
        }
        self.from.clear();
        self.from.extend_from_slice(cone);
        for &normal in normals {
            match extent(&self.from, normal) {
                [false, _] => return false,
                [true, false] => {}
                [true, true] => {
                    self.to.clear();
                    cut(&self.from, normal, HORIZON, &mut self.to);
                    std::mem::swap(&mut self.from, &mut self.to);
                }
            }
        }
        true
    }
}
