//! What rays of a receiver meet, summed up by rows of the matrix.

use super::bright::{Bright, EVERY};
use crate::direct::{Openness, Parts, barycentric, from_front};
use crate::model::{Facet, PADDING, Piece, orthonormal_basis};
use crate::plan::{Blocks, Geometry, Row, Rows, Sums};
use antirad_scene::Rays;
use glam::DVec3;
use std::ops::Range;

/// What triangles see of each other.
pub struct Seen<'a> {
    geometry: &'a Geometry<'a>,
    pub blocks: &'a Blocks,
    rays: &'a Rays,
    openness: &'a Openness,
    /// Where some rays go; `None`: all go by the cosine.
    pub bright: Option<Bright>,
    /// The slot of each triangle.
    slots: Vec<u32>,
    /// Whether some triangles are glossy, so that directions matter.
    glossy: bool,
}

/// What some rays of one receiver meet.
#[derive(Default)]
pub struct Found {
    /// Sums of the weights of rays, by row in ascending order of block and index.
    pub rows: Rows,
    /// Sums of the weights of all rays, and of their squares.
    pub all: f64,
    pub squares: f64,
    /// What rays in all directions bring of the light of now, and those that are aimed.
    pub moments: [Moments; 2],
    /// What a ray of each quarter of the sequence brings on average.
    pub quarters: [f64; 4],
}

/// Sums over rays.
#[derive(Clone, Copy, Default)]
pub struct Moments {
    pub rays: u32,
    /// What each brings, and the square of that.
    pub sum: f64,
    pub squares: f64,
}

impl Moments {
    fn add(&mut self, brought: f64) {
        self.rays += 1;
        self.sum += brought;
        self.squares += brought * brought;
    }

    /// Sum of the squares of deviations from the mean.
    pub fn deviations(&self) -> f64 {
        (self.squares - self.sum * self.sum / f64::from(self.rays.max(1))).max(0.0)
    }
}

impl std::ops::AddAssign for Moments {
    fn add_assign(&mut self, other: Self) {
        self.rays += other.rays;
        self.sum += other.sum;
        self.squares += other.squares;
    }
}

/// The front of a triangle that a ray meets.
struct Hit {
    slot: u32,
    /// Unit, from the front to the receiver.
    direction: DVec3,
    /// What the receiver counts of its radiance.
    weight: f64,
}

impl<'a> Seen<'a> {
    pub fn new(
        geometry: &'a Geometry<'a>,
        blocks: &'a Blocks,
        rays: &'a Rays,
        openness: &'a Openness,
    ) -> Self {
        let Geometry { facets, layout, classes, .. } = *geometry;
        let mut slots = vec![PADDING; facets.len()];
        let placed = layout.order.iter().zip(0..).filter(|(triangle, _)| **triangle != PADDING);
        placed.for_each(|(&triangle, slot)| slots[triangle as usize] = slot);
        let glossy = classes.iter().any(|class| class.glossy);
        Self { geometry, blocks, rays, openness, bright: None, slots, glossy }
    }

    /// Scratch space of [`Self::look`].
    pub fn sums(&self) -> Option<Sums<'_>> {
        self.glossy.then(|| Sums::new(self.geometry, self.blocks))
    }

    /// Traces the rays with some numbers of the sequence of a receiver. `radiance`: of slots, for the moments.
    pub fn look(&self, sums: &mut Option<Sums>, slot: u32, numbers: Range<u32>, radiance: &[f64]) -> Found {
        let Geometry { layout, classes, facets, .. } = *self.geometry;
        let receiver = layout.order[slot as usize] as usize;
        let (hits, mut found) = self.hits(receiver, numbers, radiance);
        let of_sources = hits.chunk_by(|a, b| a.slot == b.slot);
        let Some(sums) = sums else {
            let Rows { rows, columns, weights } = &mut found.rows;
            for of_source in of_sources {
                columns.push(of_source[0].slot);
                weights.push(of_source.iter().map(|hit| hit.weight).sum());
            }
            let (block, index) = self.blocks.row(self.blocks.group_of(slot), slot, None, 0);
            let length = columns.len() as u32;
            rows.extend((length > 0).then_some(Row { block, index, first: 0, length }));
            return found;
        };
        let basis = orthonormal_basis(facets[receiver].normal);
        for of_source in of_sources {
            let slot = of_source[0].slot;
            let glossy = classes[layout.order[slot as usize] as usize].glossy;
            sums.pair(slot, (receiver, &basis), |tap| {
                let piece = |&Hit { direction, weight, .. }: &Hit| {
                    let binned = if glossy { weight } else { 0.0 };
                    Piece { direction, front: true, diffuse: weight, binned }
                };
                of_source.iter().map(piece).for_each(tap);
            });
        }
        sums.finish(slot, &mut found.rows);
        found.rows.rows.sort_unstable_by_key(|row| (row.block, row.index));
        found
    }

    /// The fronts that rays of a triangle meet, in ascending order of their slots.
    fn hits(&self, receiver: usize, numbers: Range<u32>, radiance: &[f64]) -> (Vec<Hit>, Found) {
        let facets = self.geometry.facets;
        let Facet { corners, normal, .. } = facets[receiver];
        let parts = self.openness.of(receiver);
        let aim = self.bright.as_ref().and_then(|bright| bright.aim(&facets[receiver]));
        let (mut hits, mut found) = (Vec::with_capacity(numbers.len()), Found::default());
        let mut trace = |origin: DVec3, towards: DVec3, at: Option<usize>| {
            let weight = parts.map_or(1.0, |parts| parts.weight(barycentric(corners, normal, origin)));
            found.all += weight;
            found.squares += weight * weight;
            let cosine = towards.dot(normal);
            let met = if cosine > 0.0 { self.rays.nearest(origin, towards, Some(receiver)) } else { None };
            let met = met.filter(|&(source, _)| at.is_none_or(|aimed| aimed == source));
            let front = met.filter(|&(source, _)| towards.dot(facets[source].normal) < 0.0);
            let hit = front.map(|(source, distance)| {
                let Facet { corners, normal, .. } = facets[source];
                let leaves =
                    |parts: &Parts| parts.leaves(barycentric(corners, normal, origin + distance * towards));
                let cosines = [cosine, -towards.dot(normal)];
                let balance =
                    aim.as_ref().map_or(1.0, |aim| aim.balance((source, &facets[source]), distance, cosines));
                let weight = weight * balance * self.openness.of(source).map_or(1.0, leaves);
                Hit { slot: self.slots[source], direction: -towards, weight }
            });
            let brought = hit.as_ref().map_or(0.0, |hit| hit.weight * radiance[hit.slot as usize]);
            found.moments[usize::from(at.is_some())].add(brought);
            hits.extend(hit);
            brought
        };
        let (seed, facet, count) = (receiver as u64, &facets[receiver], numbers.len() as u32);
        let mut quarters = [0.0; 4];
        for (quarter, k) in quarters.iter_mut().zip(0..) {
            let [start, end] = [k, k + 1].map(|k| numbers.start + k * count / 4);
            let aimed = if aim.is_some() { start / EVERY..end / EVERY } else { 0..0 };
            let others = if aim.is_some() { start - aimed.start..end - aimed.end } else { start..end };
            let mut sum = 0.0;
            for (origin, towards) in from_front(facet, seed, others) {
                sum += trace(origin, towards, None);
            }
            for (origin, towards, at) in aim.iter().flat_map(|aim| aim.rays(facet, seed, aimed.clone())) {
                sum += trace(origin, towards, Some(at));
            }
            *quarter = sum / f64::from((end - start).max(1));
        }
        found.quarters = quarters;
        hits.sort_unstable_by_key(|hit| hit.slot);
        (hits, found)
    }
}
