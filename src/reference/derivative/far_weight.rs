//! The derivative of the blend weight between near and far field.

/// Derivative of [`far_weight`](crate::model::far_weight), per square metre.
#[derive(Clone, Copy, Debug, Default)]
pub struct FarWeightSlope {
    /// With respect to the squared distance.
    pub r2: f64,
    /// With respect to the range of the near field.
    pub range: f64,
}

/// Derivative of a smoothstep: zero at both ends of the transition and beyond.
pub fn far_weight_slope(r2: f64, range: f64) -> FarWeightSlope {
    if range <= 0.0 {
        return FarWeightSlope::default();
    }
    let t = (2.0 * r2 / range - 1.0).clamp(0.0, 1.0);
    let slope = 6.0 * t * (1.0 - t) * 2.0 / range;
    FarWeightSlope { r2: slope, range: -slope * r2 / range }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::far_weight;

    /// Central differences with step 1e-6, whose error is 1e-9 for these slopes of up to 6.
    #[test]
    fn slopes_are_those_of_the_weight() {
        for range in [0.0, 0.5, 2.0] {
            for r2 in [0.0, 0.1, 0.3, 0.41, 1.3, 1.9, 5.0] {
                let found = far_weight_slope(r2, range);
                let r2_slope = (far_weight(r2 + 1e-6, range) - far_weight(r2 - 1e-6, range)) / 2e-6;
                assert!((found.r2 - r2_slope).abs() <= 1e-8, "{r2} {range}: {found:?} {r2_slope}");
                if range > 0.0 {
                    let slope = (far_weight(r2, range + 1e-6) - far_weight(r2, range - 1e-6)) / 2e-6;
                    assert!((found.range - slope).abs() <= 1e-8, "{r2} {range}: {found:?} {slope}");
                }
            }
        }
    }
}
