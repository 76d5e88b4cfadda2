//! Interpolation of bins at one end of a line of light, with its derivative with respect to geometry.

use super::taps::TapSlopes;
use crate::model::{FrameGradient, orthonormal_basis, pull_local};
use crate::reference::{Model, Outgoing, State};
use glam::DVec3;

/// RGB values interpolated between the four taps of a direction, differentiable.
#[derive(Clone, Copy)]
pub struct Reading {
    /// Σ weight · value.
    pub value: DVec3,
    /// The taps and the values of their bins; `None` where there are no bins.
    taps: Option<(TapSlopes, [DVec3; 4])>,
    /// The world direction that is looked up in the frame of the normal.
    direction: DVec3,
    normal: DVec3,
    /// 1 if the direction looked up is that of the line, -1 if it is the opposite.
    sign: f64,
}

impl Reading {
    /// The directional part of the radiance of source `i` in `direction`, that of travel, from its front or its back.
    pub fn of_source(model: &Model, outgoing: &Outgoing, i: usize, direction: DVec3, front: bool) -> Self {
        let class = model.classes[i];
        let (kept, bins) =
            if front { (class.glossy, &outgoing.specular) } else { (class.blocker, &outgoing.antiradiance) };
        let bins = model.bins_of(i).filter(|_| kept).map_or(&[][..], |range| &bins[range]);
        Self::of_bins(model, model.facets[i].normal, bins, direction, front)
    }

    /// The same from the bins of that side, specular radiance or antiradiance; of none if there are none.
    pub fn of_bins(model: &Model, normal: DVec3, bins: &[DVec3], direction: DVec3, front: bool) -> Self {
        match front {
            _ if bins.is_empty() => Self::none(),
            true => Self::new(model, normal, direction, 1.0, |b| bins[b]),
            // Antiradiance stems from light incident on the front from the opposite direction.
            false => Self::new(model, normal, direction, -1.0, |b| -bins[b]),
        }
    }

    /// Importance of the bins of receiver `j`, λ_A(b) / c_b, for light that travels in `direction`.
    pub fn of_receiver(model: &Model, importance: &State, j: usize, direction: DVec3) -> Self {
        let normal = model.facets[j].normal;
        match model.bins_of(j) {
            Some(range) => Self::new(model, normal, direction, -1.0, |b| {
                importance.bins[range.start + b] / model.bins.projected[b]
            }),
            None => Self::none(),
        }
    }

    fn none() -> Self {
        let zero = DVec3::ZERO;
        Self { value: zero, taps: None, direction: zero, normal: zero, sign: 1.0 }
    }

    fn new(model: &Model, normal: DVec3, direction: DVec3, sign: f64, bin: impl Fn(usize) -> DVec3) -> Self {
        let direction = sign * direction;
        let local = orthonormal_basis(normal).transpose() * direction;
        let taps = TapSlopes::new(&model.bins, local);
        let values = taps.index.map(bin);
        let value = taps.weights().into_iter().zip(values).map(|(w, v)| w * v).sum();
        Self { value, taps: Some((taps, values)), direction, normal, sign }
    }

    /// From the cotangent of the value to the gradients with respect to the line's direction and the normal.
    pub fn pull(&self, cotangent: DVec3) -> FrameGradient {
        let Some((taps, values)) = self.taps else {
            return FrameGradient { direction: DVec3::ZERO, normal: DVec3::ZERO };
        };
        let local = taps.gradient(values.map(|v| v.dot(cotangent)));
        let FrameGradient { direction, normal } = pull_local(self.normal, self.direction, local);
        FrameGradient { direction: self.sign * direction, normal }
    }
}
