//! The hierarchy: nodes of eight branches, made of a binary tree by opening the largest.

use super::binned::{self, Below, Boxed, Branch};
use super::frame::Bounds;
use super::numbering::{LEAF, NONE, WIDTH};
use bytemuck::{Pod, Zeroable};
use glam::Vec3;

/// Eight boxes, in units of half the diagonal about the middle of all triangles, and where they lead. In memory 56 words in this order,
/// fit for a buffer of a device.
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
#[repr(C, align(32))]
pub struct Node {
    /// Least and greatest x, then those of y and z, of each box. The box of a branch that is not there is turned inside out: ∞ to -∞.
    pub bounds: [[[f32; WIDTH]; 2]; 3],
    /// Where each leads: to a node of a higher index than this one, or with [`LEAF`] to a leaf; [`NONE`] for a branch that is not there.
    pub branches: [u32; WIDTH],
}

impl Node {
    const EMPTY: Self =
        Self { bounds: [[[f32::INFINITY; WIDTH], [f32::NEG_INFINITY; WIDTH]]; 3], branches: [NONE; WIDTH] };

    fn set(&mut self, branch: usize, bounds: Bounds) {
        for (axis, [low, high]) in self.bounds.iter_mut().enumerate() {
            (low[branch], high[branch]) = (bounds.low[axis], bounds.high[axis]);
        }
    }

    pub(crate) fn of(&self, branch: usize) -> Bounds {
        let side = |side: usize| Vec3::from([0, 1, 2].map(|axis| self.bounds[axis][side][branch]));
        Bounds { low: side(0), high: side(1) }
    }

    fn all(&self) -> Bounds {
        Bounds::union_of((0..WIDTH).map(|branch| self.of(branch)))
    }
}

/// The nodes of some boxes, the root first, and the boxes of each leaf, by their indices.
pub struct Hierarchy {
    pub nodes: Vec<Node>,
    pub groups: Vec<[u32; WIDTH]>,
}

impl Hierarchy {
    pub fn new(mut items: Vec<Boxed>) -> Self {
        let mut hierarchy = Self { nodes: vec![Node::EMPTY], groups: Vec::new() };
        if !items.is_empty() {
            hierarchy.fill(0, binned::tree(&mut items));
        }
        hierarchy
    }

    /// Fills a node with the largest branches of a binary tree. Each level of nodes is one of the tree at least, and so there are no more.
    fn fill(&mut self, node: usize, tree: Branch) {
        let mut branches = vec![tree];
        while branches.len() < WIDTH {
            let inner = branches.iter_mut().filter(|branch| matches!(branch.below, Below::Inner(_)));
            let Some(largest) = inner.max_by(|a, b| a.bounds.area().total_cmp(&b.bounds.area())) else {
                break;
            };
            let empty = Below::Leaf([NONE; WIDTH]);
            if let Below::Inner(two) = std::mem::replace(&mut largest.below, empty) {
                let [left, right] = *two;
                *largest = left;
                branches.push(right);
            }
        }
        for (k, branch) in branches.into_iter().enumerate() {
            self.nodes[node].set(k, branch.bounds);
            self.nodes[node].branches[k] = match branch.below {
                Below::Leaf(group) => {
                    self.groups.push(group);
                    (self.groups.len() - 1) as u32 | LEAF
                }
                Below::Inner(_) => {
                    self.nodes.push(Node::EMPTY);
                    let next = self.nodes.len() - 1;
                    self.fill(next, branch);
                    next as u32
                }
            };
        }
    }
}

/// Gives nodes the boxes that leaves now have.
pub fn refit(nodes: &mut [Node], of_leaf: impl Fn(usize) -> Bounds) {
    // What a node leads to comes after it.
    for at in (0..nodes.len()).rev() {
        for (k, next) in nodes[at].branches.into_iter().enumerate().filter(|(_, next)| *next != NONE) {
            let bounds = match next & LEAF {
                0 => nodes[next as usize].all(),
                _ => of_leaf((next & !LEAF) as usize),
            };
            nodes[at].set(k, bounds);
        }
    }
}

/// The boxes that a ray which meets the whole meets on average: the sum of their areas over that of the whole (Goldsmith and Salmon 1987).
pub fn cost(nodes: &[Node]) -> f64 {
    let areas = nodes.iter().flat_map(|node| (0..WIDTH).map(|k| f64::from(node.of(k).area())));
    areas.sum::<f64>() / f64::from(nodes[0].all().area()).max(f64::MIN_POSITIVE)
}
