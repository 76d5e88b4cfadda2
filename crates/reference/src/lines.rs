//! The lines along which light travels from a source to a receiver, and with which weights. Twin of crates/core/glsl/transport_*.comp,
//! and crates/core/glsl/near.comp; with dual numbers, of crates/core/glsl/*_derivative.comp.
//!
//! A line reads a weighted sum of what its source sends, and adds it, weighted, to what arrives at its receiver: U is the sum over all
//! lines. Read the other way, the lines are Uᵀ.

use super::light::{DIFFUSE, INCIDENT, IRRADIANCE, SPECULAR};
use antirad_core::model::{
    Bins, Class, Facet, QUARTER_RANGE, Scalar, Vector, centroid, far_weight, projected_solid_angle, quarters,
};
use glam::DVec3;
use std::f64::consts::PI;

/// A sparse row: entries of a run of light with their weights.
pub struct Row<S> {
    entries: [(usize, S); 8],
    count: usize,
}

impl<S: Scalar> Row<S> {
    pub fn new() -> Self {
        Self { entries: [(0, 0.0.into()); 8], count: 0 }
    }

    fn push(&mut self, entry: usize, weight: S) {
        self.entries[self.count] = (entry, weight);
        self.count += 1;
    }

    pub fn entries(&self) -> &[(usize, S)] {
        &self.entries[..self.count]
    }

    /// The weighted sum of the entries.
    pub fn read<V: Vector<Scalar = S>>(&self, run: &[DVec3]) -> V {
        let zero = [S::from(0.0); 3];
        V::from_array(self.entries().iter().fold(zero, |sum, &(entry, weight)| {
            let rgb = run[entry].to_array();
            std::array::from_fn(|c| sum[c] + weight * rgb[c])
        }))
    }
}

impl Row<f64> {
    /// Adds a value to the entries, weighted: the transpose of [`Self::read`].
    pub fn add(&self, value: DVec3, run: &mut [DVec3]) {
        self.entries().iter().for_each(|&(entry, weight)| run[entry] += weight * value);
    }
}

/// A line of light: what it reads of the source's run, and where in the receiver's it adds that.
pub struct Line<S> {
    pub from: Row<S>,
    pub to: Row<S>,
}

/// The geometry of a line.
pub struct Beam<V: Vector> {
    /// Unit, from the source to the receiver.
    pub direction: V,
    /// Whether the receiver is on the front side of the source.
    pub front: bool,
    /// Projected solid angle for uniform radiance, sr.
    pub diffuse: V::Scalar,
    /// Projected solid angle for directional radiance, sr.
    pub binned: V::Scalar,
}

/// What a source sends along a beam: from the front diffuse and specular radiance, and from the back the negative of the radiance
/// incident on the front in the same direction of travel.
pub fn sent<V: Vector>(bins: &Bins, source: &Facet<V>, class: Class, beam: &Beam<V>) -> Row<V::Scalar> {
    let mut row = Row::new();
    if beam.front {
        row.push(DIFFUSE, beam.diffuse);
    }
    let (kept, first, direction, radiance) = match beam.front {
        true => (class.glossy, SPECULAR, beam.direction, beam.binned),
        // Antiradiance stems from light incident on the front from the opposite direction.
        false => (class.blocker, SPECULAR + bins.count(), -beam.direction, -beam.binned),
    };
    if kept {
        for (bin, weight) in bins.taps(source.to_local(direction)) {
            row.push(first + bin, radiance * weight);
        }
    }
    row
}

/// A source and a receiver.
pub struct Pair<'a, V: Vector> {
    pub bins: &'a Bins,
    /// The range of the near field: [`Model::near_field`](super::Model::near_field).
    pub near_field: f64,
    pub source: &'a Facet<V>,
    /// Class of the source.
    pub class: Class,
    pub receiver: &'a Facet<V>,
    /// Whether the receiver keeps light per bin.
    pub has_bins: bool,
}

/// Distances from a plane below this multiple of the triangle's size √s are rounding and have no side. Otherwise the two sides of
/// a sheet would illuminate each other.
const COINCIDENT: f64 = 1e-12;

impl<V: Vector> Pair<'_, V> {
    /// All lines: from centroid to centroid where the two are far, from piece to piece where they are near, blended in between.
    pub fn lines(&self, visit: &mut impl FnMut(Line<V::Scalar>)) {
        let weight = self.far_weight();
        self.far(weight, visit);
        self.near(-weight + 1.0, visit);
    }

    /// R, the squared distance below which the near field takes part, m².
    fn range(&self) -> V::Scalar {
        (self.source.characteristic_area + self.receiver.characteristic_area) * (0.5 * self.near_field)
    }

    fn far_weight(&self) -> V::Scalar {
        far_weight((self.receiver.centroid - self.source.centroid).length_squared(), self.range())
    }

    fn line(&self, beam: Beam<V>, visit: &mut impl FnMut(Line<V::Scalar>)) {
        let from = sent(self.bins, self.source, self.class, &beam);
        if from.count == 0 {
            return;
        }
        let mut to = Row::new();
        to.push(IRRADIANCE, 1.0.into());
        if self.has_bins {
            for (bin, weight) in self.bins.taps(self.receiver.to_local(-beam.direction)) {
                to.push(INCIDENT + bin, weight / self.bins.projected[bin]);
            }
        }
        visit(Line { from, to });
    }

    /// Centroid to centroid: cos_j |cos_i| a_i g, with g = 1/(r² + a_i/π).
    fn far(&self, weight: V::Scalar, visit: &mut impl FnMut(Line<V::Scalar>)) {
        if weight <= 0.0 {
            return;
        }
        let (source, receiver) = (self.source, self.receiver);
        let between = receiver.centroid - source.centroid;
        let direction = between.normalize();
        let (cos_i, cos_j) = (direction.dot(source.normal), -direction.dot(receiver.normal));
        let front = cos_i > 0.0;
        // In this form, a NaN direction exchanges nothing either.
        if cos_j > 0.0 && cos_i != 0.0 {
            let kernel = self.source.area / (between.length_squared() + self.source.area / PI);
            let projected = weight * cos_j * cos_i.abs() * kernel;
            self.line(Beam { direction, front, diffuse: projected, binned: projected }, visit);
        }
    }

    /// Quarters to quarters; for directional radiance, where two quarters are close relative to their size, sixteenths to sixteenths.
    fn near(&self, weight: V::Scalar, visit: &mut impl FnMut(Line<V::Scalar>)) {
        if weight <= 0.0 || self.source.area == 0.0 || self.receiver.area == 0.0 {
            return;
        }
        let none = V::Scalar::from(0.0);
        for to in quarters(self.receiver.corners) {
            for from in quarters(self.source.corners) {
                let far = match self.class.has_bins() {
                    true => {
                        let between = centroid(to) - centroid(from);
                        far_weight(between.length_squared(), self.range() * QUARTER_RANGE)
                    }
                    false => 1.0.into(),
                };
                self.piece([from, to], [weight / 4.0, weight * far / 4.0], visit);
                if far < 1.0 {
                    let binned = weight * (-far + 1.0) / 16.0;
                    for to in quarters(to) {
                        for from in quarters(from) {
                            self.piece([from, to], [none, binned], visit);
                        }
                    }
                }
            }
        }
    }

    /// The line from a piece of the source to the centroid of a piece of the receiver, by Lambert's polygon
    /// formula, which is exact for uniform radiance. `diffuse` and `binned` are the weights of the two kinds
    /// of radiance.
    fn piece(
        &self,
        [from, to]: [[V; 3]; 2],
        [diffuse, binned]: [V::Scalar; 2],
        visit: &mut impl FnMut(Line<V::Scalar>),
    ) {
        let point = centroid(to);
        let offset = point - centroid(from);
        let side = offset.value().dot(self.source.normal.value());
        if side.abs() <= COINCIDENT * self.source.characteristic_area.value().sqrt() {
            return;
        }
        let projected = projected_solid_angle(point, self.receiver.normal, from);
        if projected > 0.0 {
            let beam = Beam {
                direction: offset.normalize(),
                front: side > 0.0,
                diffuse: diffuse * projected,
                binned: binned * projected,
            };
            self.line(beam, visit);
        }
    }
}
