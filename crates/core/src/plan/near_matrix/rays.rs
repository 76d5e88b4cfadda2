//! Transport by rays: the rows of receivers from the fronts that they see.
//!
//! Rays leave all over the front of a receiver, as many in each direction as its cosine asks for. Each of N rays that meets a front
//! brings π/N of its radiance; what meets a back, or nothing, is dark. So all that a receiver receives adds up to π of radiance at most,
//! and every bounce of light is weaker than the one before, however dense blockers are.

use super::blocks::Blocks;
use super::rows::{Geometry, Rows};
use crate::model::{PADDING, Piece, orthonormal_basis, rays_among};
use crate::plan::visibility::rays_of;
use antirad_scene::Rays;
use glam::DVec3;
use std::f64::consts::PI;

/// What triangles see of each other.
pub struct Seen<'a> {
    geometry: &'a Geometry<'a>,
    rays: Rays,
    /// Rays of a triangle.
    count: u32,
    /// The slot of each triangle.
    slots: Vec<u32>,
}

impl<'a> Seen<'a> {
    pub fn new(geometry: &'a Geometry<'a>, count: u32) -> Self {
        let Geometry { facets, layout, .. } = *geometry;
        let mut slots = vec![PADDING; facets.len()];
        let placed = layout.order.iter().zip(0..).filter(|(triangle, _)| **triangle != PADDING);
        placed.for_each(|(&triangle, slot)| slots[triangle as usize] = slot);
        Self { geometry, rays: rays_among(facets), count, slots }
    }

    /// The rows of some receivers.
    pub fn rows(&self, blocks: &Blocks, receivers: &[u32]) -> Rows {
        let Geometry { layout, classes, facets, .. } = *self.geometry;
        Rows::by_receiver(self.geometry, blocks, receivers, |sums, slot, rows| {
            let receiver = layout.order[slot as usize] as usize;
            let basis = orthonormal_basis(facets[receiver].normal);
            for of_source in self.hits(receiver).chunk_by(|a, b| a.slot == b.slot) {
                let slot = of_source[0].slot;
                let diffuse = PI / f64::from(self.count);
                let glossy = classes[layout.order[slot as usize] as usize].glossy;
                let binned = if glossy { diffuse } else { 0.0 };
                sums.pair(slot, (receiver, &basis), |tap| {
                    let piece = |hit: &Hit| Piece { direction: hit.direction, front: true, diffuse, binned };
                    of_source.iter().map(piece).for_each(tap);
                });
            }
            sums.finish(slot, rows);
        })
    }

    /// The fronts that the rays of a triangle meet, in ascending order of their slots.
    fn hits(&self, receiver: usize) -> Vec<Hit> {
        let facets = self.geometry.facets;
        let mut hits = Vec::new();
        for (origin, towards) in rays_of(&facets[receiver], receiver as u64, self.count) {
            let met = self.rays.nearest(origin, towards, Some(receiver));
            let front = met.filter(|&(source, _)| towards.dot(facets[source].normal) < 0.0);
            hits.extend(front.map(|(source, _)| Hit { slot: self.slots[source], direction: -towards }));
        }
        hits.sort_by_key(|hit| hit.slot);
        hits
    }
}

/// The front of a triangle that a ray meets.
struct Hit {
    slot: u32,
    /// Unit, from the front to the receiver.
    direction: DVec3,
}
