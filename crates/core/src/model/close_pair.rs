//! Light between two close triangles in f64, piece by piece: what crates/core/glsl/near_walk.glsl evaluates in each pass.

use super::polygon::{projected_quarters, projected_solid_angle};
use super::{Class, Facet, QUARTER_RANGE, centroid, far_weight, quarters};
use glam::DVec3;

/// Light along one line, from a piece of the source to a point of the receiver: irradiance per radiance.
pub struct Piece {
    /// Unit, from the source to the receiver.
    pub direction: DVec3,
    /// Whether the receiver is on the front side of the source.
    pub front: bool,
    /// Blended projected solid angle for uniform radiance, sr. Zero from the back.
    pub diffuse: f64,
    /// Blended projected solid angle for radiance that varies with direction, sr; zero where the source has
    /// none on this side.
    pub binned: f64,
}

/// A source and a receiver close to it.
pub struct ClosePair<'a> {
    /// The triangle that emits.
    pub source: &'a Facet,
    /// The triangle that receives.
    pub receiver: &'a Facet,
    /// Class of the source.
    pub class: Class,
    /// Whether the receiver keeps irradiance per bin.
    pub receiver_bins: bool,
    /// Half of `near_field`.
    pub half_range: f64,
    /// Squared distances from the plane of the source below this fraction of its characteristic area count as in the
    /// plane.
    pub coincident: f64,
}

impl ClosePair<'_> {
    /// Visits all pieces: quarter to quarter and, for radiance that varies with direction, between two quarters close
    /// for their size, quarter of a quarter to quarter of a quarter.
    pub fn pieces(&self, mut visit: impl FnMut(Piece)) {
        let Self { source, receiver, class, .. } = self;
        let range = self.half_range * (source.characteristic_area + receiver.characteristic_area);
        let near = 1.0 - far_weight((receiver.centroid - source.centroid).length_squared(), range);
        for to in quarters(receiver.corners) {
            let height = to.map(|corner| (corner - source.centroid).dot(source.normal));
            let [front, back] = [height.iter().any(|h| *h > 0.0), height.iter().any(|h| *h < 0.0)];
            let directional = class.glossy && front || class.blocker && back;
            if !front && !directional {
                continue;
            }
            let point = centroid(to);
            if !directional && !self.receiver_bins {
                // Lambert's formula is exact for the whole source.
                let projected = projected_solid_angle(point, receiver.normal, source.corners);
                self.piece(point - source.centroid, [0.25 * near * projected, 0.0], &mut visit);
                continue;
            }
            let projected = projected_quarters(point, receiver.normal, source.corners);
            for (from, projected) in quarters(source.corners).into_iter().zip(projected) {
                let offset = point - centroid(from);
                let far = match directional {
                    true => far_weight(offset.length_squared(), range * QUARTER_RANGE),
                    false => 1.0,
                };
                let weight = 0.25 * near * projected;
                self.piece(offset, [weight, far * weight], &mut visit);
                if far < 1.0 {
                    self.finer(from, to, 0.0625 * near * (1.0 - far), &mut visit);
                }
            }
        }
    }

    /// Visits the pieces from the quarters of one quarter to those of another.
    fn finer(&self, from: [DVec3; 3], to: [DVec3; 3], weight: f64, visit: &mut impl FnMut(Piece)) {
        for to in quarters(to) {
            let point = centroid(to);
            let projected = projected_quarters(point, self.receiver.normal, from);
            for (from, projected) in quarters(from).into_iter().zip(projected) {
                self.piece(point - centroid(from), [0.0, weight * projected], visit);
            }
        }
    }

    fn piece(&self, offset: DVec3, [diffuse, binned]: [f64; 2], visit: &mut impl FnMut(Piece)) {
        let side = offset.dot(self.source.normal);
        let front = side > 0.0;
        let directional = if front { self.class.glossy } else { self.class.blocker };
        let piece = Piece {
            direction: offset.normalize(),
            front,
            diffuse: if front { diffuse } else { 0.0 },
            binned: if directional { binned } else { 0.0 },
        };
        let apart = side * side > self.coincident * self.source.characteristic_area;
        if apart && (piece.diffuse > 0.0 || piece.binned > 0.0) {
            visit(piece);
        }
    }
}
