//! What a point sees of a lamp, exactly: its cone of directions less those of all blockers.

use super::blockers::{Blockers, CORNERS, NO_TWIN, OUTLINE};
use super::cone::{Side, cut, extent, sides};
use super::derivative::Sight;
use super::lamps::Lamp;
use super::polygon::Polygon;
use super::subtraction::Subtraction;
use super::sun::Disc;
use super::trapezoids::{Edge, Trapezoid, Trapezoids};
use crate::model::{Facet, orthonormal_basis};
use glam::{DMat3, DVec2, DVec3};
use std::borrow::Cow;
use std::ops::Range;

/// What shadows are computed from: triangles, in any unit of length, and what they block.
#[derive(Clone, Copy)]
pub struct Geometry<'a> {
    pub facets: &'a [Facet],
    pub blockers: &'a Blockers,
}

/// A lamp in place. A sun is in place as some point sees it.
#[derive(Clone)]
pub struct Placed<'a> {
    /// Of a solid, its silhouette from a point.
    pub lamp: Cow<'a, Lamp>,
    pub corners: Vec<DVec3>,
    pub outline: Vec<DVec3>,
    pub normal: DVec3,
    /// The triangle that has this normal; none has that of a silhouette or a sun.
    pub plane: Option<u32>,
    /// Axes: two along its plane, and one away from its front. Edges of a scene are rarely parallel to the first two.
    pub frame: DMat3,
}

/// The angle about its normal by which a lamp's frame is turned.
const TURN: f64 = 0.618_033_988_75;

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

    /// What may stand between some points of a plane and a lamp, if it is not more than `most`: [`Blockers::between`].
    pub fn between(
        &self,
        points: &[DVec3],
        normal: DVec3,
        lamp: &Placed,
        most: Option<usize>,
    ) -> Option<Vec<u32>> {
        self.blockers.between(self, points, normal, lamp, most)
    }

    pub fn place<'b>(&self, lamp: &'b Lamp) -> Placed<'b> {
        match lamp {
            Lamp::Surface(surface) => {
                let normal = self.facets[surface.first()].normal;
                self.placed(Cow::Borrowed(lamp), normal, Some(surface.first() as u32))
            }
            Lamp::Sun(disc) => self.sun_from(lamp, disc, DVec3::ZERO),
        }
    }

    /// A lamp as a point sees it: a solid has another silhouette from each, and suns go along.
    pub fn seen_from<'b>(&self, lamp: &'b Placed, point: DVec3) -> Cow<'b, Placed<'b>> {
        if let Some(disc) = lamp.lamp.sun() {
            return Cow::Owned(self.sun_from(&lamp.lamp, disc, point));
        }
        match lamp.lamp.solid().and_then(|solid| solid.seen_from(self.facets, point)) {
            Some((silhouette, normal)) => {
                Cow::Owned(self.placed(Cow::Owned(Lamp::Surface(silhouette)), normal, None))
            }
            None => Cow::Borrowed(lamp),
        }
    }

    fn placed<'b>(&self, lamp: Cow<'b, Lamp>, normal: DVec3, plane: Option<u32>) -> Placed<'b> {
        let at = |&corner: &[u32; 2]| self.corner(corner);
        Placed {
            corners: lamp.surface().iter().flat_map(|surface| &surface.corners).map(at).collect(),
            outline: lamp.surface().iter().flat_map(|surface| &surface.outline).map(at).collect(),
            normal,
            plane,
            frame: frame(normal),
            lamp,
        }
    }

    /// A sun as a point sees it, beyond everything.
    fn sun_from<'b>(&self, lamp: &'b Lamp, disc: &Disc, point: DVec3) -> Placed<'b> {
        let far = self.blockers.far();
        let corners: Vec<DVec3> = disc.corners().iter().map(|&corner| point + far * corner).collect();
        let (lamp, normal) = (Cow::Borrowed(lamp), disc.normal());
        Placed { outline: corners.clone(), corners, normal, plane: None, frame: frame(normal), lamp }
    }

    /// Whether a triangle and the front of a lamp can see each other.
    pub fn faces(&self, receiver: usize, lamp: &Placed) -> bool {
        let facet = &self.facets[receiver];
        let above =
            |plane: DVec3, normal: DVec3, corner: &DVec3| (*corner - plane).dot(normal) > self.tolerance();
        if let Some(disc) = lamp.lamp.sun() {
            return facet.area > 0.0 && disc.corners().iter().any(|c| c.dot(facet.normal) > 0.0);
        }
        facet.area > 0.0
            && lamp.corners.iter().any(|c| above(facet.centroid, facet.normal, c))
            && facet.corners.iter().any(|c| match lamp.lamp.solid() {
                Some(solid) => solid.is_seen_from(self.facets, *c, self.tolerance()),
                None => above(lamp.corners[0], lamp.normal, c),
            })
    }
}

/// Axes of a lamp with a normal: [`Placed::frame`].
fn frame(normal: DVec3) -> DMat3 {
    orthonormal_basis(-normal) * DMat3::from_rotation_z(TURN)
}

/// The number of the plane through the point and a side of a lamp's outline.
pub fn lamp_side(side: usize) -> u32 {
    side as u32
}

/// The number of the plane of the point's horizon.
pub const HORIZON: u32 = u32::MAX;

/// The number of planes in which parts only touch each other.
pub const UPRIGHT: u32 = u32::MAX - 1;

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
    (BLOCKERS..UPRIGHT).contains(&plane).then(|| {
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
    /// The view from the point of a triangle of the blocker, by its corners relative to the point; `None`
    /// where the point lies in its plane.
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

/// A blocker before the lamp, in the frame of the lamp as seen from the point.
struct Seen {
    /// Place of the blocker in the list, and its number.
    place: usize,
    number: u32,
    /// Range of its corners among those of all blockers.
    corners: Range<usize>,
    /// Whether its corners run counter-clockwise.
    counter_clockwise: bool,
    /// Whether it reaches beyond the plane of the lamp or behind the point, and must be clipped.
    clipped: bool,
}

/// What a lamp fills of the plane on which directions are drawn: intervals of both coordinates.
struct Window {
    s: [f64; 2],
    t: [f64; 2],
}

/// Finds what is visible of lamps; keeps its memory between points.
///
/// Directions are drawn on the plane of the lamp, where lines stay lines: what is visible there are the trapezoids of the lamp that no
/// blocker covers. Edges between two neighbouring blockers that the point sees from the same side are none of their union, so that the
/// work grows with what is in front of the lamp, but the number of parts with its silhouettes alone.
#[derive(Default)]
pub struct Visible {
    trapezoids: Trapezoids,
    subtraction: Subtraction,
    /// The lamp's cone, and a cone while it is cut.
    cone: Vec<Side>,
    to: Vec<Side>,
    seen: Vec<Seen>,
    /// Corners in the frame of the lamp.
    corners: Vec<DVec3>,
    /// When each polygon was last seen whole, and whether its corners ran counter-clockwise then.
    sides: Vec<(u64, bool)>,
    now: u64,
    /// Blockers and edges looked at so far.
    pub tests: u64,
}

/// Edges up to which a sweep is fast however they cross.
const FEW: usize = 24;

/// Blockers, the widest first, of which each may hide the whole lamp: in full shadow, one often does.
const WIDEST: usize = 4;

/// Distance from the point along the axis of the lamp's frame, relative to that of the lamp, below which blockers are ignored.
const NEAREST: f64 = 1e-7;

impl Visible {
    /// Calls `emit` with convex cones without overlap, which are what is visible of the lamp above the
    /// horizon. `outline`: whether sides end at all vertices of the lamp's outline, or only at its corners.
    pub fn parts(&mut self, sight: &Sight, outline: bool, emit: &mut dyn FnMut(&[Side])) {
        let &Sight { ref geometry, point, normal, ref lamp, blockers, .. } = sight;
        // Within a solid there is no silhouette.
        if lamp.lamp.solid().is_some() {
            return;
        }
        let corners = if outline { &lamp.outline } else { &lamp.corners };
        if (point - corners[0]).dot(lamp.normal) <= geometry.tolerance() {
            return;
        }
        self.cone.clear();
        // The lamp's front is seen clockwise, so its corners are taken in reverse.
        let count = corners.len();
        let side = |k: usize| Side {
            corner: corners[count - 1 - k] - point,
            plane: lamp_side((2 * count - 2 - k) % count),
        };
        self.cone.extend((0..count).map(side));
        match extent(&self.cone, normal) {
            [false, _] => return,
            [true, false] => {}
            [true, true] => {
                self.to.clear();
                cut(&self.cone, normal, HORIZON, &mut self.to);
                std::mem::swap(&mut self.cone, &mut self.to);
            }
        }
        let local = lamp.frame.transpose();
        let mut window = Window { s: EMPTY, t: EMPTY };
        for side in &self.cone {
            let at = on_plane(local * side.corner);
            window.s = [window.s[0].min(at.x), window.s[1].max(at.x)];
            window.t = [window.t[0].min(at.y), window.t[1].max(at.y)];
        }
        let edges = &mut self.trapezoids.edges;
        edges.clear();
        let of_lamp = |(plane, ends): (u32, [DVec3; 2])| {
            window.edge(ends.map(|end| local * end), true, plane).map(|edge| Edge { frame: true, ..edge })
        };
        edges.extend(sides(&self.cone).filter_map(of_lamp));
        let frame_edges = edges.len();
        self.tests += blockers.len() as u64;
        if !self.see_blockers(geometry, point, lamp, blockers, &window) {
            return;
        }
        self.add_edges(geometry, point, lamp, &window);
        if self.trapezoids.edges.len() == frame_edges {
            emit(&self.cone);
            return;
        }
        // Of blockers that share few edges, most are hidden by others, and their edges would cross all the same.
        let edges = self.trapezoids.edges.len() - frame_edges;
        if edges > FEW.max(self.seen.len()) {
            let before = self.subtraction.tests;
            self.subtraction.parts(sight, &self.cone, self.seen.iter().map(|seen| seen.place), emit);
            self.tests += self.subtraction.tests - before;
            return;
        }
        let before = self.trapezoids.visits;
        let mut part = Vec::with_capacity(4);
        self.trapezoids.emit(&mut |trapezoid| {
            let Trapezoid { s, low: (low, below), high: (high, above) } = *trapezoid;
            let at = |s: f64, t: f64| lamp.frame * DVec3::new(s, t, 1.0);
            part.clear();
            part.push(Side { corner: at(s[0], low[0]), plane: below });
            if low[1] < high[1] {
                part.push(Side { corner: at(s[1], low[1]), plane: UPRIGHT });
            }
            part.push(Side { corner: at(s[1], high[1]), plane: above });
            if low[0] < high[0] {
                part.push(Side { corner: at(s[0], high[0]), plane: UPRIGHT });
            }
            emit(&part);
        });
        self.tests += self.trapezoids.visits - before;
    }

    /// Lists the blockers that may hide some of the lamp. `false` if one hides it all.
    fn see_blockers(
        &mut self,
        geometry: &Geometry,
        point: DVec3,
        lamp: &Placed,
        blockers: &[u32],
        window: &Window,
    ) -> bool {
        self.seen.clear();
        self.corners.clear();
        self.now += 1;
        self.sides.resize(self.sides.len().max(geometry.blockers.numbers()), (0, false));
        let local = lamp.frame.transpose();
        let lamp_height = (local * (lamp.corners[0] - point)).z;
        let behind = lamp_height - geometry.tolerance();
        let nearest = NEAREST * lamp_height;
        for (place, &number) in blockers.iter().enumerate() {
            let polygon = geometry.blockers.polygon(number);
            let first = self.corners.len();
            self.corners.extend(geometry.corners(polygon).map(|corner| local * (corner - point)));
            let corners = &self.corners[first..];
            let clipped = corners.iter().any(|c| c.z <= nearest || c.z > lamp_height + geometry.tolerance());
            let hides_nothing = corners.iter().all(|c| c.z >= behind)
                || corners.iter().all(|c| c.z <= nearest)
                || !clipped && window.misses(corners);
            let triangle = geometry.facets[polygon.first()].corners.map(|c| c - point);
            match View::new(triangle).filter(|_| !hides_nothing) {
                Some(View { sign, .. }) => {
                    let (counter_clockwise, corners) = (sign > 0.0, first..self.corners.len());
                    if !clipped {
                        let hides = |k: usize| {
                            let (a, b) = (
                                self.corners[k],
                                self.corners[if k + 1 < corners.end { k + 1 } else { first }],
                            );
                            let inwards = lamp.frame * (sign * a.cross(b));
                            self.cone.iter().all(|side| side.corner.dot(inwards) >= 0.0)
                        };
                        if place < WIDEST && corners.clone().all(hides) {
                            return false;
                        }
                        self.sides[number as usize] = (self.now, counter_clockwise);
                    }
                    self.seen.push(Seen { place, number, corners, counter_clockwise, clipped });
                }
                None => self.corners.truncate(first),
            }
        }
        true
    }

    /// Adds the boundary of what the blockers hide.
    fn add_edges(&mut self, geometry: &Geometry, point: DVec3, lamp: &Placed, window: &Window) {
        let lamp_height = -(lamp.corners[0] - point).dot(lamp.normal);
        let mut outline = Vec::new();
        let mut from = Vec::new();
        for Seen { place, number, corners, counter_clockwise, clipped } in &self.seen {
            let corners = &self.corners[corners.clone()];
            let plane = |k: usize| blocker_plane(*place, EDGES + k);
            if *clipped {
                from.clear();
                from.extend(corners.iter().enumerate().map(|(k, &corner)| Side { corner, plane: plane(k) }));
                clip(&from, |c| c.z - NEAREST * lamp_height, UPRIGHT, &mut outline);
                clip(&outline, |c| lamp_height - c.z, blocker_plane(*place, CROSSING), &mut from);
                let edges = sides(&from);
                let edges = edges.filter_map(|(plane, ends)| window.edge(ends, *counter_clockwise, plane));
                self.trapezoids.edges.extend(edges);
                continue;
            }
            let twins = geometry.blockers.twins(*number);
            for (k, &corner) in corners.iter().enumerate() {
                let twin = twins
                    .get(k)
                    .copied()
                    .filter(|&twin| twin != NO_TWIN && self.sides[twin as usize].0 == self.now);
                let times = match twin.map(|twin| (self.sides[twin as usize].1 == *counter_clockwise, twin)) {
                    None => 1,
                    // Between two that are seen from one side; or where a surface turns away, and both are on one side of the edge.
                    Some((true, _)) => continue,
                    Some((false, twin)) if twin < *number => continue,
                    Some((false, _)) => 2,
                };
                let ends = [corner, corners[(k + 1) % corners.len()]];
                let edge = window.edge(ends, *counter_clockwise, plane(k));
                self.trapezoids.edges.extend(edge.map(|edge| Edge { step: times * edge.step, ..edge }));
            }
        }
    }
}

const EMPTY: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];

fn on_plane(at: DVec3) -> DVec2 {
    at.truncate() / at.z
}

impl Window {
    /// Whether a polygon before the point lies beside the window.
    fn misses(&self, corners: &[DVec3]) -> bool {
        // s > s1 is x > s1 z, which takes no division.
        let all = |beside: &dyn Fn(&DVec3) -> bool| corners.iter().all(beside);
        all(&|c| c.x <= self.s[0] * c.z)
            || all(&|c| c.x >= self.s[1] * c.z)
            || all(&|c| c.y <= self.t[0] * c.z)
            || all(&|c| c.y >= self.t[1] * c.z)
    }

    /// The edge from one corner of a polygon to the next, as far as it lies in or below the window.
    fn edge(&self, ends: [DVec3; 2], counter_clockwise: bool, plane: u32) -> Option<Edge> {
        let [a, b] = ends.map(on_plane);
        let step = if (a.x < b.x) == counter_clockwise { 1 } else { -1 };
        let [a, b] = if a.x < b.x { [a, b] } else { [b, a] };
        let [least, most] = self.s;
        if !(b.x > least && a.x < most && a.x < b.x) || a.y.min(b.y) >= self.t[1] {
            return None;
        }
        let (mut s, mut t) = ([a.x, b.x], [a.y, b.y]);
        if a.y.max(b.y) <= self.t[0] {
            // Where exactly does not matter, and edges at one height do not cross.
            t = [self.t[0] - 1.0; 2];
            s = [a.x.max(least), b.x.min(most)];
        } else {
            // By the plane of the edge, whose ends may be far away.
            let normal = ends[0].cross(ends[1]);
            let at = |s: f64| -(normal.x * s + normal.z) / normal.y;
            if a.x < least {
                (s[0], t[0]) = (least, at(least));
            }
            if b.x > most {
                (s[1], t[1]) = (most, at(most));
            }
        }
        Some(Edge { s, t, step, frame: false, plane })
    }
}

/// Clips a polygon to where `height` is not negative; the new side is in `plane`.
fn clip(polygon: &[Side], height: impl Fn(DVec3) -> f64, plane: u32, part: &mut Vec<Side>) {
    part.clear();
    for (side, [a, b]) in polygon.iter().zip(sides(polygon).map(|(_, ends)| ends)) {
        let (from, to) = (height(a), height(b));
        if from >= 0.0 {
            part.push(*side);
        }
        if from >= 0.0 && to < 0.0 || from < 0.0 && to > 0.0 {
            let corner = a.lerp(b, from / (from - to));
            part.push(Side { corner, plane: if to < 0.0 { plane } else { side.plane } });
        }
    }
}
