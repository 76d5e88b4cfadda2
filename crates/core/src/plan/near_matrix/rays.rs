//! Transport by rays: the rows of receivers from the fronts that they see.
//!
//! Rays leave all over the front of a receiver, as many in each direction as its cosine asks for. Each of N rays that meets a front
//! brings π/N of its radiance; what meets a back, or nothing, is dark. So all that a receiver receives adds up to π of radiance at most,
//! and every bounce of light is weaker than the one before, however dense blockers are.

use super::blocks::Blocks;
use super::rows::{Geometry, Rows};
use crate::direct::{Openness, Parts, barycentric, from_front};
use crate::model::{Facet, PADDING, Piece, orthonormal_basis};
use antirad_scene::Rays;
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::Arc;

/// What triangles see of each other.
pub struct Seen<'a> {
    geometry: &'a Geometry<'a>,
    rays: Arc<Rays>,
    /// Rays of a triangle.
    count: u32,
    openness: &'a Openness,
    /// The slot of each triangle.
    slots: Vec<u32>,
}

impl<'a> Seen<'a> {
    /// `count`: rays of a triangle.
    pub fn new(geometry: &'a Geometry<'a>, (rays, count): (Arc<Rays>, u32), openness: &'a Openness) -> Self {
        let Geometry { facets, layout, .. } = *geometry;
        let mut slots = vec![PADDING; facets.len()];
        let placed = layout.order.iter().zip(0..).filter(|(triangle, _)| **triangle != PADDING);
        placed.for_each(|(&triangle, slot)| slots[triangle as usize] = slot);
        Self { geometry, rays, count, openness, slots }
    }

    /// The rows of some receivers.
    pub fn rows(&self, blocks: &Blocks, receivers: &[u32]) -> Rows {
        let Geometry { layout, classes, facets, .. } = *self.geometry;
        Rows::by_receiver(self.geometry, blocks, receivers, |sums, slot, rows| {
            let receiver = layout.order[slot as usize] as usize;
            let basis = orthonormal_basis(facets[receiver].normal);
            for of_source in self.hits(receiver).chunk_by(|a, b| a.slot == b.slot) {
                let slot = of_source[0].slot;
                let glossy = classes[layout.order[slot as usize] as usize].glossy;
                sums.pair(slot, (receiver, &basis), |tap| {
                    let piece = |&Hit { direction, diffuse, .. }: &Hit| {
                        let binned = if glossy { diffuse } else { 0.0 };
                        Piece { direction, front: true, diffuse, binned }
                    };
                    of_source.iter().map(piece).for_each(tap);
                });
            }
            sums.finish(slot, rows);
        })
    }

    /// The fronts that the rays of a triangle meet, in ascending order of their slots.
    fn hits(&self, receiver: usize) -> Vec<Hit> {
        let facets = self.geometry.facets;
        let Facet { corners, normal, .. } = facets[receiver];
        let parts = self.openness.of(receiver);
        let (mut hits, mut all) = (Vec::new(), 0.0);
        for (origin, towards) in from_front(&facets[receiver], receiver as u64, self.count) {
            let weight = parts.map_or(1.0, |parts| parts.weight(barycentric(corners, normal, origin)));
            all += weight;
            let met = self.rays.nearest(origin, towards, Some(receiver));
            let front = met.filter(|&(source, _)| towards.dot(facets[source].normal) < 0.0);
            let hit = |(source, distance): (usize, f64)| {
                let Facet { corners, normal, .. } = facets[source];
                let leaves =
                    |parts: &Parts| parts.leaves(barycentric(corners, normal, origin + distance * towards));
                let diffuse = weight * self.openness.of(source).map_or(1.0, leaves);
                Hit { slot: self.slots[source], direction: -towards, diffuse }
            };
            hits.extend(front.map(hit));
        }
        hits.iter_mut().for_each(|hit: &mut Hit| hit.diffuse *= PI / all);
        hits.sort_by_key(|hit| hit.slot);
        hits
    }
}

/// The front of a triangle that a ray meets.
struct Hit {
    slot: u32,
    /// Unit, from the front to the receiver.
    direction: DVec3,
    /// Irradiance that it brings per radiance, sr.
    diffuse: f64,
}
