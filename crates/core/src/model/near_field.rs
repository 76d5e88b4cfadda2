//! Range and blend weight of the near field, which all kernels and their twins share. Twin of
//! crates/core/glsl/near_field.glsl.

use super::scalar::Scalar;

/// Range, as a fraction of that of the whole pair, within which two quarters are subdivided once more. With 1/4,
/// quarters would be treated as whole triangles are; a sixth of that is enough, since only touching neighbours need
/// it: without it a blocker that stands on its receiver leaks in the few directions in which it is sampled.
pub const QUARTER_RANGE: f64 = 1.0 / 24.0;

/// Blend weight of the point-to-point kernel for a pair at squared distance `r2`; the near field has the rest. Smooth, 0
/// within half the range, 1 beyond it. `range` is `near_field` · (s_i + s_j) / 2.
pub fn far_weight<S: Scalar>(r2: S, range: S) -> S {
    if range <= 0.0 {
        return 1.0.into();
    }
    let t = (r2 * 2.0 / range - 1.0).clamp(0.0, 1.0);
    t * t * (-t * 2.0 + 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::Dual;

    /// Central differences with step 1e-6, whose error is 1e-9 for these slopes of up to 6.
    #[test]
    fn slopes_are_those_of_the_weight() {
        for range in [0.0, 0.5, 2.0] {
            for r2 in [0.0, 0.1, 0.3, 0.41, 1.3, 1.9, 5.0] {
                let [by_r2, by_range] =
                    far_weight(Dual::<2>::variable(r2, 0), Dual::variable(range, 1)).slopes;
                let slope = (far_weight(r2 + 1e-6, range) - far_weight(r2 - 1e-6, range)) / 2e-6;
                assert!((by_r2 - slope).abs() <= 1e-8, "{r2} {range}: {by_r2} {slope}");
                if range > 0.0 {
                    let slope = (far_weight(r2, range + 1e-6) - far_weight(r2, range - 1e-6)) / 2e-6;
                    assert!((by_range - slope).abs() <= 1e-8, "{r2} {range}: {by_range} {slope}");
                }
            }
        }
    }
}
