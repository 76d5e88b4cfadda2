//! Ray casting against triangles with a bounding volume hierarchy.

use super::{Scene, bounds};
use glam::DVec3;

/// Triangles in a leaf.
const LEAF: usize = 4;
/// Levels of the hierarchy, at most: each halves up to 2³² triangles.
const LEVELS: usize = 33;
/// Hits closer than this share of the scene's diagonal to either end of a ray count as its ends.
const EPSILON: f64 = 1e-9;

struct Node {
    low: DVec3,
    high: DVec3,
    /// Start of a leaf's range of `order`. In inner nodes, the second child; the first is the next node.
    first: u32,
    /// Triangles of a leaf; 0 in inner nodes.
    count: u32,
    /// The axis along which the second child lies behind the first.
    axis: usize,
}

/// The intersection of a ray with a triangle.
struct Hit {
    distance: f64,
    /// Whether the ray comes from the front of the triangle.
    front: bool,
}

/// A bounding volume hierarchy of the triangles of a scene, except those without area.
pub struct Rays {
    nodes: Vec<Node>,
    order: Vec<u32>,
    corners: Vec<[DVec3; 3]>,
    /// [`EPSILON`] of the scene, m.
    epsilon: f64,
}

impl Rays {
    /// Builds the tree of a scene.
    pub fn new(scene: &Scene) -> Self {
        let corners = (0..scene.triangles.len()).map(|i| scene.corners(i)).collect();
        Self::among(corners, |i| scene.degenerate.binary_search(i).is_err())
    }

    /// Builds the hierarchy of those triangles that are `solid`.
    pub fn among(corners: Vec<[DVec3; 3]>, solid: impl Fn(&u32) -> bool) -> Self {
        let mut order: Vec<u32> = (0..corners.len() as u32).filter(solid).collect();
        let mut nodes = Vec::new();
        if !order.is_empty() {
            build(&corners, &mut order, 0, &mut nodes);
        }
        let size = nodes.first().map_or(1.0, |root: &Node| (root.high - root.low).length());
        Self { nodes, order, corners, epsilon: EPSILON * size }
    }

    /// The nearest triangle along a unit direction and its distance, m; never `from`, where the ray starts. Of the two sides of a sheet it
    /// is the one that faces the ray.
    pub fn nearest(&self, origin: DVec3, direction: DVec3, from: Option<usize>) -> Option<(usize, f64)> {
        let mut best: Option<(usize, Hit)> = None;
        self.visit(origin, direction, f64::INFINITY, |triangle, limit| {
            let Some(hit) = self.hit(triangle, origin, direction).filter(|_| Some(triangle) != from) else {
                return limit;
            };
            let nearer = best.as_ref().is_none_or(|(_, best)| {
                let coincide = (hit.distance - best.distance).abs() <= self.epsilon;
                if coincide { hit.front && !best.front } else { hit.distance < best.distance }
            });
            if !nearer {
                return limit;
            }
            let limit = hit.distance + self.epsilon;
            best = Some((triangle, hit));
            limit
        });
        best.map(|(triangle, hit)| (triangle, hit.distance))
    }

    /// Whether any triangle lies between two points, front or back, that is not an exception.
    pub fn blocked(&self, from: DVec3, to: DVec3, exception: impl Fn(usize) -> bool) -> bool {
        let length = from.distance(to);
        let direction = (to - from) / length;
        let mut found = false;
        self.visit(from, direction, length, |triangle, limit| {
            let hit = self.hit(triangle, from, direction).filter(|_| !exception(triangle));
            if hit.is_some_and(|hit| hit.distance < length - self.epsilon) {
                found = true;
                // No other hit matters.
                return f64::NEG_INFINITY;
            }
            limit
        });
        found
    }

    /// Calls `call` with every triangle of the leaves that the ray meets within the limit that the last call returned, roughly
    /// from near to far.
    fn visit(
        &self,
        origin: DVec3,
        direction: DVec3,
        mut limit: f64,
        mut call: impl FnMut(usize, f64) -> f64,
    ) {
        let inverse = direction.recip();
        // At each level at most one child waits for its sibling.
        let mut stack = [0u32; LEVELS + 1];
        let mut waiting = usize::from(!self.nodes.is_empty());
        while waiting > 0 {
            waiting -= 1;
            let index = stack[waiting];
            let node = &self.nodes[index as usize];
            let (a, b) = ((node.low - origin) * inverse, (node.high - origin) * inverse);
            let (near, far) = (a.min(b).max_element(), a.max(b).min_element());
            if !(near <= far && far >= 0.0 && near <= limit) {
                continue;
            }
            if node.count == 0 {
                let children = [index + 1, node.first];
                let [near, far] = if direction[node.axis] < 0.0 { [1, 0] } else { [0, 1] };
                stack[waiting] = children[far];
                stack[waiting + 1] = children[near];
                waiting += 2;
                continue;
            }
            for &triangle in &self.order[node.first as usize..(node.first + node.count) as usize] {
                limit = call(triangle as usize, limit);
            }
        }
    }

    /// The intersection of a ray with a triangle, if there is one (Möller and Trumbore 1997).
    fn hit(&self, triangle: usize, origin: DVec3, direction: DVec3) -> Option<Hit> {
        let [a, b, c] = self.corners[triangle];
        let (ab, ac) = (b - a, c - a);
        let p = direction.cross(ac);
        let determinant = ab.dot(p);
        if determinant == 0.0 {
            return None;
        }
        let s = origin - a;
        let u = s.dot(p) / determinant;
        let q = s.cross(ab);
        let v = direction.dot(q) / determinant;
        let distance = ac.dot(q) / determinant;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > self.epsilon)
            .then_some(Hit { distance, front: determinant > 0.0 })
    }
}

/// Builds the hierarchy by median splits of the centroids along the longest side of their bounds.
fn build(corners: &[[DVec3; 3]], order: &mut [u32], first: usize, nodes: &mut Vec<Node>) {
    let points = order.iter().flat_map(|&i| corners[i as usize]);
    let (low, high) = bounds(points);
    // Flat boxes need some thickness for rays.
    let grown = 1e-12 * (high - low).length().max(f64::MIN_POSITIVE);
    let index = nodes.len();
    let leaf = order.len() <= LEAF;
    let count = if leaf { order.len() as u32 } else { 0 };
    nodes.push(Node { low: low - grown, high: high + grown, first: first as u32, count, axis: 0 });
    if leaf {
        return;
    }
    let centroid = |i: u32| corners[i as usize].iter().sum::<DVec3>() / 3.0;
    let (low, high) = bounds(order.iter().map(|&i| centroid(i)));
    let sides = high - low;
    let axis = (0..3).max_by(|&a, &b| sides[a].total_cmp(&sides[b])).unwrap_or(0);
    let half = order.len() / 2;
    order.select_nth_unstable_by(half, |&a, &b| centroid(a)[axis].total_cmp(&centroid(b)[axis]));
    let (left, right) = order.split_at_mut(half);
    build(corners, left, first, nodes);
    nodes[index].first = nodes.len() as u32;
    nodes[index].axis = axis;
    build(corners, right, first + half, nodes);
}
