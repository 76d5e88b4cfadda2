//! Binary trees of boxes by the surface area heuristic over bins (Wald 2007, "On fast construction of SAH-based bounding volume hierarchies").

use super::frame::Bounds;
use super::numbering::{NONE, WIDTH};

/// Parts of the extent of a set of boxes, between which it may be split.
const BINS: usize = 32;
/// Levels of a tree. A set is split into halves by number where the heuristic would leave more to a side than the levels below hold, 8 · 2^levels.
///
/// Rays keep at most 7 branches of each level for later, in a stack of 256.
pub const LEVELS: u32 = 36;
/// Sets of at least so many are split on several threads: less than .1 ms of work otherwise.
const PARALLEL: usize = 1024;

/// A box to put into a tree.
#[derive(Clone, Copy)]
pub struct Boxed {
    pub bounds: Bounds,
    pub index: u32,
}

/// A node of a binary tree.
pub struct Branch {
    pub bounds: Bounds,
    pub below: Below,
}

pub enum Below {
    Leaf([u32; WIDTH]),
    Inner(Box<[Branch; 2]>),
}

/// The tree of some boxes, whose order changes.
pub fn tree(items: &mut [Boxed]) -> Branch {
    branch(items, LEVELS)
}

fn branch(items: &mut [Boxed], levels: u32) -> Branch {
    let bounds = Bounds::union_of(items.iter().map(|item| item.bounds));
    if items.len() <= WIDTH {
        let mut group = [NONE; WIDTH];
        group.iter_mut().zip(&*items).for_each(|(index, item)| *index = item.index);
        return Branch { bounds, below: Below::Leaf(group) };
    }
    let below = levels.saturating_sub(1);
    let held = |count: usize| count as u64 <= (WIDTH as u64) << below;
    let count = items.len();
    let (left, right) = match best(items).map(|split| split.apart(items)) {
        Some(at) if held(at) && held(count - at) => items.split_at_mut(at),
        _ => halves(items),
    };
    let (left, right) = if count >= PARALLEL {
        rayon::join(|| branch(left, below), || branch(right, below))
    } else {
        (branch(left, below), branch(right, below))
    };
    Branch { bounds, below: Below::Inner(Box::new([left, right])) }
}

/// As many on either side of the middle of the longest extent.
fn halves(items: &mut [Boxed]) -> (&mut [Boxed], &mut [Boxed]) {
    let size = Extent::of(items).size;
    let axis = size.max_position();
    let half = items.len() / 2;
    items.select_nth_unstable_by(half, |a, b| a.bounds.middle()[axis].total_cmp(&b.bounds.middle()[axis]));
    items.split_at_mut(half)
}

/// The box around the middles of boxes.
struct Extent {
    low: glam::Vec3,
    size: glam::Vec3,
}

impl Extent {
    fn of(items: &[Boxed]) -> Self {
        let middles = items.iter().map(|item| item.bounds.middle());
        let around = Bounds::union_of(middles.map(|middle| Bounds { low: middle, high: middle }));
        Self { low: around.low, size: around.high - around.low }
    }
}

/// A plane between bins of an axis.
struct Split {
    axis: usize,
    low: f32,
    /// Bins in a unit of length.
    scale: f32,
    bin: usize,
}

impl Split {
    fn bin_of(&self, item: &Boxed) -> usize {
        (((item.bounds.middle()[self.axis] - self.low) * self.scale) as usize).min(BINS - 1)
    }

    /// Puts those before the plane first, and counts them.
    fn apart(&self, items: &mut [Boxed]) -> usize {
        let mut at = 0;
        for i in 0..items.len() {
            if self.bin_of(&items[i]) < self.bin {
                items.swap(i, at);
                at += 1;
            }
        }
        at
    }
}

/// The plane with the least sum of areas times numbers; `None` if all are in one place.
fn best(items: &[Boxed]) -> Option<Split> {
    let extent = Extent::of(items);
    let mut best = (f32::INFINITY, None);
    for axis in 0..3 {
        let scale = BINS as f32 / extent.size[axis];
        if !scale.is_finite() {
            continue;
        }
        let mut split = Split { axis, low: extent.low[axis], scale, bin: 0 };
        let mut bins = [(Bounds::EMPTY, 0u32); BINS];
        for item in items {
            let (bounds, count) = &mut bins[split.bin_of(item)];
            *bounds = bounds.union(item.bounds);
            *count += 1;
        }
        let add = |sum: &mut (Bounds, u32), bin: &(Bounds, u32)| {
            *sum = (sum.0.union(bin.0), sum.1 + bin.1);
            Some((sum.0.area() * sum.1 as f32, sum.1))
        };
        let mut above = [0.0; BINS];
        let suffixes = bins.iter().rev().scan((Bounds::EMPTY, 0), add);
        above.iter_mut().rev().zip(suffixes).for_each(|(above, (cost, _))| *above = cost);
        let prefixes = bins.iter().scan((Bounds::EMPTY, 0), add);
        for (bin, (below, count)) in prefixes.enumerate().take(BINS - 1) {
            let cost = below + above[bin + 1];
            if cost < best.0 && count > 0 && (count as usize) < items.len() {
                split.bin = bin + 1;
                best = (cost, Some(Split { ..split }));
            }
        }
    }
    best.1
}
