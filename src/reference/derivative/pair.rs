//! The derivative of U from one triangle to another. Twin of glsl/near_derivative.comp and glsl/transport_derivative.comp.

use super::far_weight::far_weight_slope;
use super::polygon::projected_solid_angle_gradient;
use super::reading::Reading;
use crate::model::pull_unit;
use crate::model::{Facet, FacetGradient, QUARTER_RANGE, centroid, far_weight, quarters};
use crate::reference::transport::COINCIDENT;
use crate::reference::{Model, Outgoing, State};
use glam::DVec3;
use std::f64::consts::PI;

/// The gradient of the contribution of one pair to λ·U(outgoing), with respect to its source and its receiver.
#[derive(Clone, Copy, Debug, Default)]
pub struct PairGradient {
    pub source: FacetGradient,
    pub receiver: FacetGradient,
}

impl PairGradient {
    /// Adds a gradient with respect to the vector from the source's centroid to the receiver's.
    pub fn add_between(&mut self, gradient: DVec3) {
        self.source.add_centroid(-gradient);
        self.receiver.add_centroid(gradient);
    }

    /// The same for the vector between the centroids of a piece of each.
    fn add_piece_between(&mut self, from: Piece, to: Piece, gradient: DVec3) {
        from.pull_centroid(-gradient, &mut self.source);
        to.pull_centroid(gradient, &mut self.receiver);
    }
}

/// The gradient of λ·U(outgoing) from source `i` to receiver `j`.
pub fn pair_derivative(
    model: &Model,
    outgoing: &Outgoing,
    importance: &State,
    i: usize,
    j: usize,
) -> PairGradient {
    let mut gradient = PairGradient::default();
    let (source, receiver) = (&model.facets[i], &model.facets[j]);
    if source.area == 0.0 || receiver.area == 0.0 {
        return gradient;
    }
    let pair = Pair { model, outgoing, importance, i, j, source, receiver };
    let between = receiver.centroid - source.centroid;
    let (r2, range) = (between.length_squared(), model.range(i, j));
    let weight = far_weight(r2, range);
    // Derivatives with respect to the blend weight, and to the range of the near field.
    let (mut at_weight, mut at_range) = (0.0, 0.0);
    if weight > 0.0 {
        at_weight += pair.far(between, weight, &mut gradient);
    }
    if weight < 1.0 {
        let near = pair.near(range, 1.0 - weight, &mut gradient);
        at_weight -= near.weight;
        at_range += near.range;
    }
    let slope = far_weight_slope(r2, range);
    at_range += at_weight * slope.range;
    gradient.add_between(2.0 * at_weight * slope.r2 * between);
    let at_characteristic_area = 0.5 * model.near_field * at_range;
    gradient.source.characteristic_area += at_characteristic_area;
    gradient.receiver.characteristic_area += at_characteristic_area;
    gradient
}

struct Pair<'a> {
    model: &'a Model,
    outgoing: &'a Outgoing,
    importance: &'a State,
    i: usize,
    j: usize,
    source: &'a Facet,
    receiver: &'a Facet,
}

/// Derivatives of the near field with respect to its blend weight, and to its range in m².
struct NearSlope {
    weight: f64,
    range: f64,
}

impl Pair<'_> {
    /// Centroid to centroid. Returns the derivative with respect to the blend weight: the value at weight 1.
    fn far(&self, between: DVec3, weight: f64, gradient: &mut PairGradient) -> f64 {
        let (source, receiver) = (self.source, self.receiver);
        let r2 = between.length_squared();
        let direction = between / r2.sqrt();
        let (cos_i, cos_j) = (direction.dot(source.normal), -direction.dot(receiver.normal));
        // In this form, a NaN direction exchanges nothing either.
        if !(cos_j > 0.0 && cos_i != 0.0) {
            return 0.0;
        }
        let ends = Ends::new(self, direction, cos_i > 0.0);
        let g = 1.0 / (r2 + source.area / PI);
        let projected = cos_j * cos_i.abs() * source.area * g;
        let (diffuse, binned) = (ends.diffuse_adjoint(), ends.binned_adjoint());
        let at_projected = weight * (diffuse + binned);
        let mut at_direction = ends.pull(weight * projected, weight * projected, gradient);

        let at_cos_i = at_projected * cos_j * cos_i.signum() * source.area * g;
        gradient.source.normal += at_cos_i * direction;
        at_direction += at_cos_i * source.normal;
        let at_cos_j = at_projected * cos_i.abs() * source.area * g;
        gradient.receiver.normal -= at_cos_j * direction;
        at_direction -= at_cos_j * receiver.normal;
        // d(a g)/da = g - a g²/π = r² g², and dg/dr² = -g².
        gradient.source.area += at_projected * cos_j * cos_i.abs() * r2 * g * g;
        let at_between =
            pull_unit(direction, r2.sqrt(), at_direction) - 2.0 * at_projected * projected * g * between;
        gradient.add_between(at_between);
        projected * (diffuse + binned)
    }

    /// Quarters to quarters, and sixteenths to sixteenths.
    fn near(&self, range: f64, weight: f64, gradient: &mut PairGradient) -> NearSlope {
        let has_bins = self.model.classes[self.i].has_bins();
        let mut slope = NearSlope { weight: 0.0, range: 0.0 };
        for to in Piece::whole(self.receiver).quarters() {
            for from in Piece::whole(self.source).quarters() {
                let between = to.centroid() - from.centroid();
                let (r2, range) = (between.length_squared(), range * QUARTER_RANGE);
                let far = if has_bins { far_weight(r2, range) } else { 1.0 };
                let adjoint = self.piece(from, to, weight / 4.0, weight * far / 4.0, gradient);
                slope.weight += (adjoint.diffuse + far * adjoint.binned) / 4.0;
                let mut at_far = weight * adjoint.binned / 4.0;
                if far < 1.0 {
                    for to in to.quarters() {
                        for from in from.quarters() {
                            let adjoint = self.piece(from, to, 0.0, weight * (1.0 - far) / 16.0, gradient);
                            slope.weight += (1.0 - far) * adjoint.binned / 16.0;
                            at_far -= weight * adjoint.binned / 16.0;
                        }
                    }
                }
                if has_bins {
                    let far_slope = far_weight_slope(r2, range);
                    slope.range += at_far * far_slope.range * QUARTER_RANGE;
                    gradient.add_piece_between(from, to, 2.0 * at_far * far_slope.r2 * between);
                }
            }
        }
        slope
    }

    /// From a piece of the source to the centroid of a piece of the receiver. Returns the derivatives with respect to the
    /// weights `diffuse` and `binned`.
    fn piece(
        &self,
        from: Piece,
        to: Piece,
        diffuse: f64,
        binned: f64,
        gradient: &mut PairGradient,
    ) -> PairAdjoint {
        let point = to.centroid();
        let offset = point - from.centroid();
        let side = offset.dot(self.source.normal);
        let length = offset.length();
        if side.abs() <= COINCIDENT * self.source.characteristic_area.sqrt() {
            return PairAdjoint::default();
        }
        let polygon = projected_solid_angle_gradient(point, self.receiver.normal, from.corners);
        if polygon.projected <= 0.0 {
            return PairAdjoint::default();
        }
        let direction = offset / length;
        let ends = Ends::new(self, direction, side > 0.0);
        let adjoint = PairAdjoint { diffuse: ends.diffuse_adjoint(), binned: ends.binned_adjoint() };
        let at_direction = ends.pull(diffuse * polygon.projected, binned * polygon.projected, gradient);
        gradient.add_piece_between(from, to, pull_unit(direction, length, at_direction));

        let at_projected = diffuse * adjoint.diffuse + binned * adjoint.binned;
        let corners = polygon.corners.map(|c| at_projected * c);
        gradient.receiver.normal += at_projected * polygon.normal;
        from.pull(corners, &mut gradient.source);
        to.pull_centroid(-corners.iter().sum::<DVec3>(), &mut gradient.receiver);
        PairAdjoint {
            diffuse: polygon.projected * adjoint.diffuse,
            binned: polygon.projected * adjoint.binned,
        }
    }
}

/// Contribution of the two kinds of radiance to the loss at the receiver.
#[derive(Clone, Copy, Default)]
struct PairAdjoint {
    diffuse: f64,
    binned: f64,
}

/// Radiance of the source and importance of the receiver along a line.
struct Ends {
    diffuse: DVec3,
    binned: Reading,
    /// λ_E of the receiver.
    irradiance: DVec3,
    /// Importance of the receiver per bin.
    incident: Reading,
}

impl Ends {
    /// `direction`: unit, from the source to the receiver.
    fn new(pair: &Pair, direction: DVec3, front: bool) -> Self {
        Self {
            diffuse: pair.outgoing.diffuse(pair.i, front),
            binned: Reading::of_source(pair.model, pair.outgoing, pair.i, direction, front),
            irradiance: pair.importance.irradiance[pair.j],
            incident: Reading::of_receiver(pair.model, pair.importance, pair.j, direction),
        }
    }

    fn importance(&self) -> DVec3 {
        self.irradiance + self.incident.value
    }

    fn diffuse_adjoint(&self) -> f64 {
        self.importance().dot(self.diffuse)
    }

    fn binned_adjoint(&self) -> f64 {
        self.importance().dot(self.binned.value)
    }

    /// The gradient of diffuse · diffuse_adjoint + binned · binned_adjoint: adds the part through the frames to the normals, and
    /// returns that with respect to the direction.
    fn pull(&self, diffuse: f64, binned: f64, gradient: &mut PairGradient) -> DVec3 {
        let source = self.binned.pull(binned * self.importance());
        let receiver = self.incident.pull(diffuse * self.diffuse + binned * self.binned.value);
        gradient.source.normal += source.normal;
        gradient.receiver.normal += receiver.normal;
        source.direction + receiver.direction
    }
}

/// A piece of a triangle, with the barycentric coordinates of its corners in that triangle: with corners as columns of matrices,
/// piece = triangle · B. Corners are computed by halving, as in the forward pass, so that comparisons decide alike in both.
#[derive(Clone, Copy)]
struct Piece {
    corners: [DVec3; 3],
    barycentric: [DVec3; 3],
}

impl Piece {
    fn whole(facet: &Facet) -> Self {
        Self { corners: facet.corners, barycentric: DVec3::AXES }
    }

    fn quarters(self) -> [Self; 4] {
        let (corners, barycentric) = (quarters(self.corners), quarters(self.barycentric));
        std::array::from_fn(|k| Self { corners: corners[k], barycentric: barycentric[k] })
    }

    fn centroid(&self) -> DVec3 {
        centroid(self.corners)
    }

    /// Adds a gradient with respect to the corners of the piece, times Bᵀ, to that of the triangle.
    fn pull(&self, corners: [DVec3; 3], gradient: &mut FacetGradient) {
        for (corner, at) in corners.into_iter().zip(self.barycentric) {
            for k in 0..3 {
                gradient.corners[k] += at[k] * corner;
            }
        }
    }

    fn pull_centroid(&self, centre: DVec3, gradient: &mut FacetGradient) {
        let at = centroid(self.barycentric);
        for k in 0..3 {
            gradient.corners[k] += at[k] * centre;
        }
    }
}
