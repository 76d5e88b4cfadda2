//! Boxes, to look for those that are near a place.

use super::binned::Boxed;
use super::frame::{Bounds, Frame};
use super::nodes::Hierarchy;
use super::numbering::{LEAF, NONE, WIDTH};
use glam::DVec3;

/// A hierarchy of boxes.
pub struct Boxes {
    hierarchy: Hierarchy,
    bounds: Vec<Bounds>,
    frame: Frame,
}

impl Boxes {
    /// The boxes around some points each, such as corners of triangles.
    pub fn around<const N: usize>(of: &[[DVec3; N]]) -> Self {
        let frame = Frame::of(of.iter().flatten().copied());
        let bounds: Vec<Bounds> = of.iter().map(|points| frame.bounds(points)).collect();
        let items = bounds.iter().enumerate().map(|(index, &bounds)| Boxed { bounds, index: index as u32 });
        Self { hierarchy: Hierarchy::new(items.collect()), bounds, frame }
    }

    /// Calls `call` with the indices of boxes that the one around some points meets or nearly meets, until it returns false.
    pub fn meet(&self, points: &[DVec3], mut call: impl FnMut(u32) -> bool) {
        let around = self.frame.bounds(points);
        let mut next = vec![0];
        while let Some(branch) = next.pop() {
            if branch & LEAF == 0 {
                let node = &self.hierarchy.nodes[branch as usize];
                let met = (0..WIDTH).filter(|&k| node.branches[k] != NONE && node.of(k).meets(&around));
                next.extend(met.map(|k| node.branches[k]));
                continue;
            }
            let group = self.hierarchy.groups[(branch & !LEAF) as usize];
            let mut held = group.into_iter().take_while(|&index| index != NONE);
            let goes_on = held.all(|index| !self.bounds[index as usize].meets(&around) || call(index));
            if !goes_on {
                return;
            }
        }
    }
}
