//! The cosine at a receiver for a cluster. Twin of crates/core/glsl/spread.glsl and crates/core/glsl/spread_gradient.glsl.

use crate::model::scalar::Scalar;

/// How a receiver sees a cluster.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread<S = f64> {
    /// The mean of max(cos_j, 0) cos_i / r² over the triangles of a cluster, spread evenly in its plane around its centroid,
    /// to second order, as another cos_j, in place of max(cos_j, 0).
    pub cosine: S,
    /// The share of the triangles above the receiver's horizon.
    pub above: S,
    /// The mean of max(cos_j, 0), to first order.
    pub mean: S,
}

impl<S: Scalar> Spread<S> {
    /// The mean cosine for a cluster of one normal; `None` where no light arrives. `to` and `from`: cosines
    /// at the receiver and at the cluster. `tilt`: cosine between the normals of the two sides that face each
    /// other. `angle2`: variance of the triangles over r². Where triangles lie on both sides of the
    /// receiver's horizon, their heights count as uniformly distributed.
    pub fn new(to: S, from: S, tilt: S, angle2: S) -> Option<Self> {
        let width = (angle2 * 1.5 * (-tilt * tilt + 1.0)).max(0.0).sqrt();
        let Self { above, mean, .. } = Self::over(to, width);
        let second = mean - tilt * from - mean * from * from * 3.0;
        let cosine = mean + above * angle2 * 2.0 * second;
        (cosine > 0.0).then_some(Self { cosine, above, mean })
    }

    /// The mean cosine for a volume cluster, whose triangles lie all around its centroid: there, cos_j / r²
    /// is harmonic, so that to second order the mean is that of the centroid. `to`: cosine at the receiver.
    /// `angle2`: variance of the triangles over r².
    pub fn in_space(to: S, angle2: S) -> Self {
        Self::over(to, angle2.sqrt())
    }

    /// The mean to first order, over heights from `to` - `width` to `to` + `width`.
    fn over(to: S, width: S) -> Self {
        let above = match width > 0.0 {
            true => (to / width * 0.5 + 0.5).clamp(0.0, 1.0),
            false => f64::from(u8::from(to > 0.0)).into(),
        };
        let mean = if to.value() > width.value() { to } else { above * above * width };
        Self { cosine: mean, above, mean }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Dual;

    fn weighted<S: Scalar>([to, from, tilt, angle2]: [S; 4]) -> S {
        let sum = |Spread { cosine, above, mean }| cosine + above * 0.3 - mean * 0.7;
        Spread::new(to, from, tilt, angle2).map_or(0.0.into(), sum)
    }

    /// Central differences with step 1e-6, whose error is below 1e-8 for these slopes.
    #[test]
    fn the_gradient_is_that_of_the_mean() {
        for to in [-0.2, -0.05, 0.02, 0.08, 0.4] {
            for (from, tilt, angle2) in
                [(0.3, 0.2, 0.01), (0.9, -0.7, 0.02), (0.05, 0.99, 0.03), (0.5, 1.0, 0.01)]
            {
                let at = [to, from, tilt, angle2];
                let found = weighted(std::array::from_fn(|k| Dual::<4>::variable(at[k], k))).slopes;
                for k in 0..4 {
                    let moved = |step: f64| {
                        let mut at = at;
                        at[k] += step;
                        weighted(at)
                    };
                    // A cosine of 1 can only decrease; there the width has no slope.
                    if tilt < 1.0 || k != 2 {
                        let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                        let error = found[k] - slope;
                        assert!(error.abs() <= 1e-7, "{to} {from} {tilt}, {k}: {slope} {error:e}");
                    }
                }
            }
        }
    }
}
