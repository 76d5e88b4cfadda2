//! A binary tree over ranges of neighbouring triangles: a test that holds for a whole branch skips its
//! leaves.

use super::facet::Facet;
use super::order::{BoundedRun, PADDING};
use glam::DVec3;
use std::ops::Range;

/// Fraction of the tolerance by which bounds must clear it, so that their rounding decides nothing.
const MARGIN: f64 = 1e-3;
/// Rounding of bounds as a fraction of the largest coordinate, which they must clear, too.
const ROUNDING: f64 = 1e-13;

/// Leaves of a branch that is built by one thread.
const ALONE: usize = 1024;

/// A branch of the tree, or a leaf: a range of leaves, and bounds of their triangles.
#[derive(Clone, Debug)]
pub struct Node {
    /// Its leaves.
    pub leaves: Range<usize>,
    /// The box around their triangles.
    pub bounds: BoundedRun,
    /// Largest area, and characteristic area.
    pub area: f64,
    /// Largest characteristic area, m².
    pub characteristic_area: f64,
    planes: Planes,
    /// The node at which a walk continues after this branch.
    pub next: usize,
}

/// Which of some objects extend to one side of the planes of a branch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sight {
    /// None, beyond any plane.
    Nothing,
    /// The bounds do not decide.
    Unknown,
    /// Each, beyond each plane.
    Each,
}

/// Nodes in the order of a walk: each before its branches.
#[derive(Clone, Debug)]
pub struct Hierarchy {
    nodes: Vec<Node>,
    tolerance: f64,
    margin: f64,
}

/// Input of a tree: the triangle of each slot, or [`PADDING`], and slots per leaf.
struct Source<'a> {
    facets: &'a [Facet],
    order: &'a [u32],
    leaf: usize,
}

impl Source<'_> {
    fn facets(&self, leaves: &Range<usize>) -> impl Iterator<Item = &Facet> + Clone {
        let end = (leaves.end * self.leaf).min(self.order.len());
        let slots = &self.order[leaves.start * self.leaf..end];
        slots.iter().filter(|&&i| i != PADDING).map(|&i| &self.facets[i as usize])
    }

    fn node(&self, leaves: Range<usize>) -> Node {
        let facets = self.facets(&leaves);
        Node {
            bounds: BoundedRun::around(facets.clone()),
            area: facets.clone().map(|f| f.area).fold(0.0, f64::max),
            characteristic_area: facets.clone().map(|f| f.characteristic_area).fold(0.0, f64::max),
            planes: Planes::of(facets),
            leaves,
            next: 0,
        }
    }

    fn grow(&self, leaves: Range<usize>, nodes: &mut Vec<Node>) {
        let at = nodes.len();
        nodes.push(self.node(leaves.clone()));
        if leaves.len() > 1 {
            let middle = leaves.start.midpoint(leaves.end);
            let both = [leaves.start..middle, middle..leaves.end];
            if leaves.len() > ALONE {
                self.grow_at_once(both, nodes);
            } else {
                both.into_iter().for_each(|leaves| self.grow(leaves, nodes));
            }
        }
        nodes[at].next = nodes.len();
    }

    /// Two branches in parallel.
    fn grow_at_once(&self, [first, second]: [Range<usize>; 2], nodes: &mut Vec<Node>) {
        let branch = |leaves: Range<usize>| {
            let mut nodes = Vec::with_capacity(2 * leaves.len());
            self.grow(leaves, &mut nodes);
            nodes
        };
        let (first, second) = rayon::join(|| branch(first), || branch(second));
        for branch in [first, second] {
            let before = nodes.len();
            nodes.extend(branch.into_iter().map(|node| Node { next: node.next + before, ..node }));
        }
    }
}

impl Hierarchy {
    /// A tree whose leaves are ranges of `leaf` slots of an order, cut in the middle. `tolerance`: greatest
    /// height above a plane that counts as in it.
    pub fn new(facets: &[Facet], order: &[u32], leaf: usize, tolerance: f64) -> Self {
        let leaves = order.len().div_ceil(leaf);
        let mut nodes = Vec::with_capacity(2 * leaves);
        if leaves > 0 {
            Source { facets, order, leaf }.grow(0..leaves, &mut nodes);
        }
        let farthest = nodes.first().map_or(0.0, |root: &Node| {
            root.bounds.min.abs().max_element().max(root.bounds.max.abs().max_element())
        });
        Self { nodes, tolerance, margin: MARGIN * tolerance + ROUNDING * farthest }
    }

    /// Visits nodes, each with its number, depth first, in the order of their leaves, and descends where `enter`
    /// returns true.
    pub fn walk<'a>(&'a self, mut enter: impl FnMut(usize, &'a Node) -> bool) {
        let mut at = 0;
        while let Some(node) = self.nodes.get(at) {
            at = if enter(at, node) { at + 1 } else { node.next };
        }
    }

    /// All nodes by number, each before its branches.
    pub fn nodes(&self) -> &[Node] {
        &self.nodes
    }

    /// The leaves that pass a test together with all branches that contain them.
    pub fn leaves(&self, test: impl Fn(&Node) -> bool) -> impl Iterator<Item = &Node> {
        let mut at = 0;
        std::iter::from_fn(move || {
            while let Some(node) = self.nodes.get(at) {
                let passes = test(node);
                at = if passes { at + 1 } else { node.next };
                if passes && node.is_leaf() {
                    return Some(node);
                }
            }
            None
        })
    }

    /// The nodes of the leaves, in their order.
    pub fn leaf_nodes(&self) -> impl Iterator<Item = &Node> {
        self.nodes.iter().filter(|node| node.is_leaf())
    }

    /// Whether no part of a box lies above (`side` = 1) or below (`side` = -1) the plane of a triangle.
    pub fn misses(&self, plane: &Facet, bounds: &BoundedRun, side: f64) -> bool {
        let normal = side * plane.normal;
        -bounds.lowest(-normal) - normal.dot(plane.centroid) <= self.tolerance - self.margin
    }

    /// Which boxes extend above (`side` = 1) or below (`side` = -1) the planes of a branch. `one`: whether `bounds`
    /// is a single box, rather than one around all boxes.
    pub fn sight(&self, of: &Node, bounds: &BoundedRun, side: f64, one: bool) -> Sight {
        let [least, most] = of.planes.heights(bounds, side, one);
        if most <= self.tolerance - self.margin {
            Sight::Nothing
        } else if least > self.tolerance + self.margin {
            Sight::Each
        } else {
            Sight::Unknown
        }
    }
}

impl Node {
    /// The entries of an order with `leaf` slots per leaf that belong to this node.
    pub fn slots<'a>(&self, leaf: usize, order: &'a [u32]) -> &'a [u32] {
        &order[self.leaves.start * leaf..(self.leaves.end * leaf).min(order.len())]
    }

    /// Whether it has no children.
    pub fn is_leaf(&self) -> bool {
        self.leaves.len() == 1
    }
}

/// Bounds of planes ⟨n, x - centre⟩ = height: minimum and maximum of the normals, by component, and of the heights.
#[derive(Clone, Debug)]
struct Planes {
    centre: DVec3,
    normals: [DVec3; 2],
    heights: [f64; 2],
}

impl Planes {
    fn of<'a>(facets: impl Iterator<Item = &'a Facet> + Clone) -> Self {
        let bounds = BoundedRun::around(facets.clone());
        let centre = bounds.min.midpoint(bounds.max);
        let none = Self {
            centre,
            normals: [DVec3::INFINITY, DVec3::NEG_INFINITY],
            heights: [f64::INFINITY, f64::NEG_INFINITY],
        };
        facets.fold(none, |Self { normals: [low, high], heights: [least, most], .. }, facet| {
            let height = facet.normal.dot(facet.centroid - centre);
            Self {
                centre,
                normals: [low.min(facet.normal), high.max(facet.normal)],
                heights: [least.min(height), most.max(height)],
            }
        })
    }

    /// Minimum and maximum, over the planes, of the height of the farthest corner of a box, or of any box inside it.
    fn heights(&self, bounds: &BoundedRun, side: f64, one: bool) -> [f64; 2] {
        let [low, high] = self.normals;
        let (low, high) = if side > 0.0 { (low, high) } else { (-high, -low) };
        let [least, most] = self.heights;
        let (least, most) = if side > 0.0 { (least, most) } else { (-most, -least) };
        let to = bounds.min.midpoint(bounds.max) - self.centre;
        let half = 0.5 * (bounds.max - bounds.min);
        let steepest = low.abs().max(high.abs());
        let flattest = low.max(-high).max(DVec3::ZERO);
        let middle = [(low * to).min(high * to).element_sum(), (low * to).max(high * to).element_sum()];
        let (farthest, farther) = if one {
            (flattest.dot(half), steepest.dot(half))
        } else {
            (-steepest.dot(half), steepest.dot(half))
        };
        [middle[0] + farthest - most, middle[1] + farther - least]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::Shape;

    /// A sphere: neighbours have similar normals.
    fn sphere() -> Vec<Facet> {
        let (vertices, faces) = Shape::Icosphere { level: 2, inward: false }.mesh();
        faces.iter().map(|face| Facet::new(face.map(|v| vertices[v as usize]))).collect()
    }

    /// The result for a branch holds for each plane and each box in it.
    #[test]
    fn bounds_hold_for_everything_inside() {
        const TOLERANCE: f64 = 1e-6;
        let facets = sphere();
        let order = super::super::order::spatial_order(&facets);
        let tree = Hierarchy::new(&facets, &order, 4, TOLERANCE);
        let of = |node: &Node| order[node.leaves.start * 4..node.leaves.end * 4].iter();
        let mut said = [0; 3];
        for (planes, boxes) in tree.nodes.iter().flat_map(|p| tree.nodes.iter().map(move |b| (p, b))) {
            for (side, one) in [(1.0, false), (-1.0, false), (1.0, true), (-1.0, true)] {
                let sight = tree.sight(planes, &boxes.bounds, side, one);
                said[sight as usize] += 1;
                let beyond = |plane: &Facet, of: &BoundedRun| {
                    -of.lowest(-side * plane.normal) - side * plane.normal.dot(plane.centroid) > TOLERANCE
                };
                let around = |&i: &u32| BoundedRun::around([&facets[i as usize]].into_iter());
                let inside: Vec<BoundedRun> =
                    if one { vec![boxes.bounds.clone()] } else { of(boxes).map(around).collect() };
                let mut pairs = of(planes).flat_map(|&i| inside.iter().map(move |of| (i, of)));
                let holds = match sight {
                    Sight::Nothing => pairs.all(|(i, of)| !beyond(&facets[i as usize], of)),
                    Sight::Each => pairs.all(|(i, of)| beyond(&facets[i as usize], of)),
                    Sight::Unknown => true,
                };
                assert!(holds, "{:?} of {:?}: {sight:?}", boxes.leaves, planes.leaves);
            }
        }
        assert!(said.iter().all(|&count| count > 10_000), "{said:?}");
    }

    #[test]
    fn leaves_come_in_order_and_once() {
        let facets = sphere();
        let order: Vec<u32> = (0..100).collect();
        for leaf in [1, 3, 64, 200] {
            let tree = Hierarchy::new(&facets, &order, leaf, 1e-6);
            let all: Vec<usize> = (0..100usize.div_ceil(leaf)).collect();
            assert_eq!(tree.leaves(|_| true).map(|node| node.leaves.start).collect::<Vec<_>>(), all);
            assert_eq!(tree.leaf_nodes().map(|node| node.leaves.start).collect::<Vec<_>>(), all);
        }
        assert_eq!(Hierarchy::new(&[], &[], 1, 0.0).leaves(|_| true).count(), 0);
    }
}
