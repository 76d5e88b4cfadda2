//! Where the near field ends: the range and the blend weight that all kernels and their twins share. Twin of
//! glsl/near_field.glsl.

/// Range, as a fraction of that of the whole pair, within which two quarters are subdivided once more. With 1/4,
/// quarters would be treated as whole triangles are; a sixth of that is enough, since only touching neighbours need
/// it: without it a blocker that stands on its receiver leaks in the few directions in which it is sampled.
pub const QUARTER_RANGE: f64 = 1.0 / 24.0;

/// Blend weight of the point-to-point kernel for a pair at squared distance `r2`; the near field has the rest. Smooth, 0
/// within half the range, 1 beyond it. `range` is `near_field` · (s_i + s_j) / 2.
pub fn far_weight(r2: f64, range: f64) -> f64 {
    if range <= 0.0 {
        return 1.0;
    }
    let t = (2.0 * r2 / range - 1.0).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}
