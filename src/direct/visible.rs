//! The part of a lamp that a point sees, exactly: its cone of directions less those of all blockers.

use super::cone::{Side, cut, extent};
use super::derivative::Sight;
use super::lamps::Lamp;
use super::shaft::Shaft;
use crate::model::{Facet, Hierarchy, coplanar_tolerance, spatial_order};
use glam::DVec3;
use std::ops::Range;

/// Triangles per leaf of the search for blockers.
const LEAF: usize = 4;

/// A tree over the triangles with an area, all of which block light from both sides.
#[derive(Clone, Debug)]
pub struct Tree {
    order: Vec<u32>,
    tree: Hierarchy,
    /// Height up to which a point counts as in a plane.
    tolerance: f64,
}

impl Tree {
    pub fn new(facets: &[Facet]) -> Self {
        let (order, tolerance) = (spatial_order(facets), coplanar_tolerance(facets));
        let tree = Hierarchy::new(facets, &order, LEAF, tolerance);
        Self { order, tree, tolerance }
    }
}

/// What shadows are computed from: triangles, in any unit of length, and the tree over them.
#[derive(Clone, Copy)]
pub struct Geometry<'a> {
    pub facets: &'a [Facet],
    pub tree: &'a Tree,
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
        self.tree.tolerance
    }

    pub fn place<'b>(&self, lamp: &'b Lamp) -> Placed<'b> {
        let at = |&[i, k]: &[u32; 2]| self.facets[i as usize].corners[k as usize];
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

    /// The triangles that may stand between some points of a plane and a lamp, the widest first. `points[0]` and `normal` give the
    /// plane.
    pub fn blockers(&self, points: &[DVec3], normal: DVec3, lamp: &Placed) -> Vec<u32> {
        let shaft = Shaft::new(points, normal, &lamp.corners, lamp.normal, self.tolerance());
        let mut found = Vec::new();
        self.tree.tree.walk(|_, node| {
            let enter = !shaft.misses_box(&node.bounds);
            if enter && node.is_leaf() {
                let slots = node.slots(LEAF, &self.tree.order).iter().copied();
                found.extend(slots.filter(|&i| !shaft.misses(&self.facets[i as usize].corners)));
            }
            enter
        });
        let centre = points.iter().sum::<DVec3>() / points.len() as f64;
        let width = |&i: &u32| {
            let f = &self.facets[i as usize];
            f.area / (f.centroid - centre).length_squared().max(f64::MIN_POSITIVE)
        };
        // A wide blocker that comes first leaves less to cut.
        found.sort_by(|a, b| width(b).total_cmp(&width(a)).then(a.cmp(b)));
        found
    }
}

/// The number of the plane through the point and a side of a lamp's outline.
pub fn lamp_side(side: usize) -> u32 {
    side as u32
}

/// The number of the plane of the point's horizon.
pub const HORIZON: u32 = u32::MAX;

/// Planes of blockers begin here: four each, through the three edges, and through the line in which it crosses the lamp's plane.
pub const BLOCKERS: u32 = 1 << 16;

/// The place of a blocker in the list, and which of its planes, from a plane's number.
pub fn blocker_plane(plane: u32) -> Option<(usize, usize)> {
    (BLOCKERS..HORIZON).contains(&plane).then(|| {
        let at = (plane - BLOCKERS) as usize;
        (at / 4, at % 4)
    })
}

/// Normals of the planes through a point and the edges of a triangle, whose corners are given from the point; they point to the
/// triangle. The fourth counts where the triangle crosses the plane of the lamp: it points to the directions in which the triangle
/// is nearer than that plane.
pub struct Planes {
    /// As products of differences of corners, not unit.
    pub normals: [DVec3; 4],
    pub count: usize,
    /// What the products are multiplied by: 1 where the point sees the triangle's back, -1 where it sees its front.
    pub sign: f64,
}

impl Planes {
    /// `None` where the point lies in the triangle's plane.
    pub fn new(corners: &[DVec3; 3], lamp_corner: DVec3, lamp_normal: DVec3, tolerance: f64) -> Option<Self> {
        let [a, b, c] = *corners;
        let area_vector = (b - a).cross(c - a);
        let height = -area_vector.dot(a);
        if height.abs() <= 1e-12 * area_vector.length() {
            return None;
        }
        // Seen from the front, corners run counter-clockwise, so that the normals of the edges' planes point outwards.
        let sign = if height > 0.0 { -1.0 } else { 1.0 };
        let edges = [a.cross(b), b.cross(c), c.cross(a)].map(|normal| sign * normal);
        let over_lamp = |c: &DVec3| (*c - lamp_corner).dot(lamp_normal);
        let crosses = corners.iter().any(|c| over_lamp(c) < -tolerance);
        let lamp_height = -lamp_corner.dot(lamp_normal);
        let before = sign * (lamp_height * area_vector - height * lamp_normal);
        Some(Self {
            normals: [edges[0], edges[1], edges[2], before],
            count: if crosses { 4 } else { 3 },
            sign,
        })
    }
}

/// Finds the visible parts of lamps; keeps its memory between points.
#[derive(Default)]
pub struct Visible {
    /// Cones, one after the other.
    stack: Vec<Side>,
    /// Per blocker that a point sees before the lamp: its place in the list, and unit normals.
    planes: Vec<(u32, Planes)>,
    /// Places in `planes`, one run after the other: what may hide some of a cone.
    candidates: Vec<u32>,
    /// Blockers tested against cones so far.
    pub tests: u64,
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
        self.candidates.extend(0..self.planes.len() as u32);
        self.subtract(0..self.stack.len(), 0..self.planes.len(), emit);
    }

    /// Lists the blockers whose cones meet that of the lamp, which is all of the stack.
    fn see_blockers(&mut self, geometry: &Geometry, point: DVec3, lamp: &Placed, blockers: &[u32]) {
        self.planes.clear();
        let cone = &self.stack;
        let lamp_corner = lamp.corners[0] - point;
        self.tests += blockers.len() as u64;
        for (place, &i) in (0..).zip(blockers) {
            let corners = geometry.facets[i as usize].corners.map(|c| c - point);
            let beside = |k: usize| {
                let normal = cone[k].corner.cross(cone[(k + 1) % cone.len()].corner);
                corners.iter().all(|c| c.dot(normal) <= 0.0)
            };
            let beyond = |c: &DVec3| (*c - lamp_corner).dot(lamp.normal) <= geometry.tolerance();
            if corners.iter().all(beyond) || (0..cone.len()).any(beside) {
                continue;
            }
            let Some(mut planes) = Planes::new(&corners, lamp_corner, lamp.normal, geometry.tolerance())
            else {
                continue;
            };
            planes.normals = planes.normals.map(DVec3::normalize_or_zero);
            if planes.normals[..planes.count].iter().all(|&n| extent(cone, n)[0]) {
                self.planes.push((place, planes));
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
            for n in 0..self.planes[k].1.count {
                let (place, planes) = &self.planes[k];
                let (normal, plane) = (planes.normals[n], BLOCKERS + 4 * place + n as u32);
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
        let planes = &self.planes[k].1;
        planes.normals[..planes.count].iter().all(|&normal| extent(&self.stack[cone.clone()], normal)[0])
    }

    /// Whether blocker `k` hides some of a cone.
    fn meets(&mut self, cone: Range<usize>, k: usize) -> bool {
        self.tests += 1;
        let planes = &self.planes[k].1;
        let normals = &planes.normals[..planes.count];
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
