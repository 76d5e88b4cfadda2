//! A cone less those of blockers, one by one and plane by plane: for many blockers that share no edges, such as leaves, where the first
//! few hide most of the others. What lies outside a plane of a blocker is done with that blocker, what lies inside of all is hidden.

use super::cone::{Side, cut, extent};
use super::derivative::Sight;
use super::visible::{CROSSING, EDGES, HORIZON, View, blocker_plane};
use glam::DVec3;
use std::ops::Range;

/// A blocker that a point sees before the lamp.
struct Seen {
    /// Place of the blocker in the list.
    place: usize,
    /// Planes of the blocker: unit normals that point into its cone.
    normals: Range<usize>,
    /// Whether the last of these is that of [`CROSSING`].
    crosses: bool,
}

/// Cuts cones by blockers one by one; keeps its memory between points.
#[derive(Default)]
pub struct Subtraction {
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

impl Subtraction {
    /// Calls `emit` with what no blocker hides of a lamp's cone: convex cones without overlap. `places`:
    /// those of the blockers that may hide some of it.
    pub fn parts(
        &mut self,
        sight: &Sight,
        cone: &[Side],
        places: impl Iterator<Item = usize>,
        emit: &mut dyn FnMut(&[Side]),
    ) {
        self.stack.clear();
        self.stack.extend_from_slice(cone);
        self.see_blockers(sight, places);
        self.candidates.clear();
        self.candidates.extend(0..self.seen.len() as u32);
        self.subtract(0..self.stack.len(), 0..self.seen.len(), emit);
    }

    /// Lists the blockers whose cones meet that of the lamp, which is all of the stack.
    fn see_blockers(&mut self, sight: &Sight, places: impl Iterator<Item = usize>) {
        let &Sight { ref geometry, point, ref lamp, blockers, .. } = sight;
        self.seen.clear();
        self.normals.clear();
        let cone = &self.stack;
        let corners = &mut self.corners;
        let lamp_corner = lamp.corners[0] - point;
        for place in places {
            self.tests += 1;
            let polygon = geometry.blockers.polygon(blockers[place]);
            corners.clear();
            corners.extend(geometry.corners(polygon).map(|c| c - point));
            let beside = |k: usize| {
                let normal = cone[k].corner.cross(cone[(k + 1) % cone.len()].corner);
                corners.iter().all(|c| c.dot(normal) <= 0.0)
            };
            let over_lamp = |c: &DVec3| (*c - lamp_corner).dot(lamp.normal);
            if (0..cone.len()).any(beside) {
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

    /// Emits what the blockers `rest` of the candidates leave of the cone `cone` of the stack.
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

    /// Appends what lies of a cone of the stack on the positive side of a plane.
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
