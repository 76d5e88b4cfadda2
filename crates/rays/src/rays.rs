//! Rays among triangles.

#[cfg(target_arch = "x86_64")]
use super::avx2::Avx2;
use super::binned::Boxed;
use super::frame::Frame;
use super::lanes::Portable;
use super::leaf::Leaf;
use super::nodes::{self, Hierarchy, Node};
use super::numbering;
use super::ray::{Hit, Way};
use super::traverse::{Among, traverse};
use glam::DVec3;

/// Hits closer than this share of the diagonal to either end of a ray count as its ends.
const EPSILON: f64 = 1e-9;
/// A hierarchy whose cost grew by this factor since it was built is built anew. Rays take time in proportion to the cost, and building takes that of
/// about three rays a triangle: whoever traces more than ten or so gains.
const WORN: f64 = 1.3;

/// A side of a triangle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// The front of this triangle.
    Front(usize),
    /// The back of any.
    Back,
}

/// A hierarchy of triangles, through which rays pass.
#[derive(Clone)]
pub struct Rays {
    nodes: Vec<Node>,
    leaves: Vec<Leaf>,
    /// Of all triangles, in the order given.
    corners: Vec<[[f64; 3]; 3]>,
    /// The triangles that stop no rays, in ascending order.
    open: Vec<u32>,
    frame: Frame,
    /// [`EPSILON`] of the diagonal, m.
    epsilon: f64,
    /// [`nodes::cost`] when it was built.
    cost: f64,
    #[cfg(target_arch = "x86_64")]
    avx2: Option<Avx2>,
}

impl Rays {
    /// Builds the hierarchy of those triangles that are `solid`; the others stop no rays, nor do those with a corner that is not finite.
    pub fn among(corners: Vec<[DVec3; 3]>, solid: impl Fn(&u32) -> bool) -> Self {
        let (open, triangles) = (0..corners.len() as u32).partition(|&i| is_open(&corners, &solid, i));
        Self::build(&corners, triangles, open)
    }

    /// Whether refits make it what [`Self::among`] makes of these.
    pub(super) fn fits(&self, corners: &[[DVec3; 3]], solid: impl Fn(&u32) -> bool) -> bool {
        let open = (0..corners.len() as u32).filter(|&i| is_open(corners, &solid, i));
        self.corners.len() == corners.len() && open.eq(self.open.iter().copied())
    }

    /// Whether the triangles are where these are.
    pub(super) fn is_at(&self, corners: &[[DVec3; 3]]) -> bool {
        self.corners.iter().zip(corners).all(|(own, other)| *own == other.map(|corner| corner.to_array()))
    }

    fn build(corners: &[[DVec3; 3]], triangles: Vec<u32>, open: Vec<u32>) -> Self {
        let frame = Frame::of(triangles.iter().flat_map(|&i| corners[i as usize]));
        let item = |&index: &u32| Boxed { bounds: frame.bounds(&corners[index as usize]), index };
        let Hierarchy { nodes, groups } = Hierarchy::new(triangles.iter().map(item).collect());
        Self {
            cost: nodes::cost(&nodes),
            leaves: groups.iter().map(|&group| Leaf::new(group, corners, &frame)).collect(),
            nodes,
            corners: corners.iter().map(|corners| corners.map(|corner| corner.to_array())).collect(),
            open,
            epsilon: EPSILON * frame.size(),
            frame,
            #[cfg(target_arch = "x86_64")]
            avx2: Avx2::found(),
        }
    }

    /// Moves the triangles, of which there are as many as before and the same are solid. The boxes follow; where they fit badly the hierarchy is built
    /// anew. Hits are those of a new one.
    pub fn refit(&mut self, corners: &[[DVec3; 3]]) {
        let solid = || self.leaves.iter().flat_map(Leaf::held);
        self.frame = Frame::of(solid().flat_map(|i| corners[i]).filter(|corner| corner.is_finite()));
        self.epsilon = EPSILON * self.frame.size();
        self.leaves.iter_mut().for_each(|leaf| leaf.place(corners, &self.frame));
        let of_leaf = |leaf: usize| {
            let held = self.leaves[leaf].held().flat_map(|i| corners[i]).filter(|corner| corner.is_finite());
            self.frame.bounds(&held.collect::<Vec<_>>())
        };
        nodes::refit(&mut self.nodes, of_leaf);
        self.corners = corners.iter().map(|corners| corners.map(|corner| corner.to_array())).collect();
        if nodes::cost(&self.nodes) > WORN * self.cost {
            let mut triangles: Vec<u32> = self.leaves.iter().flat_map(Leaf::held).map(|i| i as u32).collect();
            triangles.sort_unstable();
            let new = Self::build(corners, triangles, std::mem::take(&mut self.open));
            *self = Self {
                #[cfg(target_arch = "x86_64")]
                avx2: self.avx2,
                ..new
            };
        }
    }

    /// The same with instructions that all processors have, for tests and measurements: hits are the same.
    pub fn portable(self) -> Self {
        Self {
            #[cfg(target_arch = "x86_64")]
            avx2: None,
            ..self
        }
    }

    /// The memory that the hierarchy takes.
    pub fn bytes(&self) -> usize {
        size_of_val(&self.nodes[..]) + size_of_val(&self.leaves[..]) + size_of_val(&self.corners[..])
    }

    /// The nodes, the root first, in a frame: ([`Self::centre`], [`Self::scale`]). There is always one.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The leaves, to which nodes lead.
    pub fn leaves(&self) -> &[Leaf] {
        &self.leaves
    }

    /// The origin of the frame of nodes and leaves.
    pub fn centre(&self) -> DVec3 {
        self.frame.centre
    }

    /// Units of the frame of nodes and leaves in one of length.
    pub fn scale(&self) -> f64 {
        self.frame.scale
    }

    /// The nearest triangle along a unit direction and its distance, m; never `from`, where the ray starts. Of the two sides of a sheet it
    /// is the one that faces the ray.
    pub fn nearest(&self, origin: DVec3, direction: DVec3, from: Option<usize>) -> Option<(usize, f64)> {
        let [back, front] = self.nearest_sides(origin, direction, from);
        let (distance, triangle) = if front.0 <= back.0 + self.epsilon { front } else { back };
        distance.is_finite().then_some((triangle as usize, distance))
    }

    /// The side of a triangle that a ray along a unit direction meets first, `None` for nothing, or for both sides of a sheet and two
    /// surfaces that touch. Never `from`, where it starts.
    pub fn first_side(&self, origin: DVec3, direction: DVec3, from: usize) -> Option<Side> {
        let [(back, _), (front, triangle)] = self.nearest_sides(origin, direction, Some(from));
        let side = if front < back { Side::Front(triangle as usize) } else { Side::Back };
        ((back - front).abs() > self.epsilon).then_some(side)
    }

    /// All fronts along a unit direction, from near to far, with their distances, m; without `from`, where the ray starts.
    pub fn fronts(&self, origin: DVec3, direction: DVec3, from: usize) -> Vec<(usize, f64)> {
        let mut fronts = Vec::new();
        self.visit::<false>(
            Way { origin, direction },
            f64::INFINITY,
            |triangle| triangle == from as u32,
            |triangle, hit| {
                if hit.front {
                    fronts.push((triangle as usize, hit.distance));
                }
                None
            },
        );
        fronts.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        fronts
    }

    /// Whether any triangle lies between two points, front or back, that is not an exception.
    pub fn blocked(&self, from: DVec3, to: DVec3, exception: impl Fn(usize) -> bool) -> bool {
        self.blocked_but(from, to, &exception)
    }

    /// [`Self::blocked`], compiled here.
    fn blocked_but(&self, from: DVec3, to: DVec3, exception: &dyn Fn(usize) -> bool) -> bool {
        let way = to - from;
        let length = way.length();
        let mut found = false;
        self.visit::<false>(
            Way { origin: from, direction: way * (1.0 / length) },
            length,
            |triangle| exception(triangle as usize),
            |_, hit| {
                found = hit.distance < length - self.epsilon;
                // No other hit matters.
                found.then_some(f64::NEG_INFINITY)
            },
        );
        found
    }

    /// The nearest back and front that a ray meets, by distance and then by index, as far as one is not behind the other; else at ∞.
    #[inline(always)]
    fn nearest_sides(&self, origin: DVec3, direction: DVec3, from: Option<usize>) -> [(f64, u32); 2] {
        let from = from.map_or(numbering::NONE, |from| from as u32);
        let mut nearest = [(f64::INFINITY, numbering::NONE); 2];
        self.visit::<true>(
            Way { origin, direction },
            f64::INFINITY,
            #[inline(always)]
            |triangle| triangle == from,
            #[inline(always)]
            |triangle, Hit { distance, front }| {
                let side = usize::from(front);
                ((distance, triangle) < nearest[side]).then(|| {
                    nearest[side] = (distance, triangle);
                    let [(back, _), (front, _)] = nearest;
                    self.epsilon + if back < front { back } else { front }
                })
            },
        );
        nearest
    }

    /// Calls `call` with all triangles, but for some to `skip`, that a ray in a unit direction meets up to a limit, m, and maybe with others that it meets. The limit is
    /// the last that a call returned.
    #[inline(always)]
    fn visit<const ORDERED: bool>(
        &self,
        way: Way,
        limit: f64,
        skip: impl Fn(u32) -> bool,
        call: impl FnMut(u32, Hit) -> Option<f64>,
    ) {
        let among = Among {
            nodes: &self.nodes,
            leaves: &self.leaves,
            corners: &self.corners,
            frame: &self.frame,
            epsilon: self.epsilon,
        };
        #[cfg(target_arch = "x86_64")]
        if let Some(avx2) = self.avx2 {
            return avx2.traverse::<ORDERED>(among, way, limit, skip, call);
        }
        traverse::<_, ORDERED>(Portable, among, way, limit, skip, call);
    }
}

/// Whether a triangle stops no rays.
fn is_open(corners: &[[DVec3; 3]], solid: impl Fn(&u32) -> bool, triangle: u32) -> bool {
    !(corners[triangle as usize].iter().all(|corner| corner.is_finite()) && solid(&triangle))
}
