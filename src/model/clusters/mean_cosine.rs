//! The cosine at a receiver for a cluster. Twin of glsl/spread.glsl and glsl/spread_gradient.glsl.

/// How a receiver sees a cluster.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// The mean of max(cos_j, 0) cos_i / r² over the triangles of a cluster, spread evenly in its plane around its centroid,
    /// to second order, as another cos_j, in place of max(cos_j, 0).
    pub cosine: f64,
    /// The share of the triangles above the receiver's horizon.
    pub above: f64,
    /// The mean of max(cos_j, 0), to first order.
    pub mean: f64,
}

impl Spread {
    /// Of the cosines `to` and `from` at the receiver and the cluster, and `tilt` between the normals of the two sides that face
    /// each other. `angle2`: variance of the triangles over r². Where they lie on both sides of the receiver's horizon, their
    /// heights count as uniformly distributed.
    pub fn new(to: f64, from: f64, tilt: f64, angle2: f64) -> Self {
        let width = (1.5 * angle2 * (1.0 - tilt * tilt)).max(0.0).sqrt();
        let above = if width > 0.0 {
            (0.5 + 0.5 * to / width).clamp(0.0, 1.0)
        } else {
            f64::from(u8::from(to > 0.0))
        };
        let mean = if to > width { to } else { above * above * width };
        let cosine = mean + above * 2.0 * angle2 * (mean - tilt * from - 3.0 * mean * from * from);
        if cosine > 0.0 { Self { cosine, above, mean } } else { Self::default() }
    }

    /// The same of a volume, whose triangles lie all around its centroid: there, cos_j / r² is harmonic, so that to second order the
    /// mean is that of the centroid.
    pub fn in_space(to: f64, angle2: f64) -> Self {
        let width = angle2.sqrt();
        let above = (0.5 + 0.5 * to / width.max(1e-12)).clamp(0.0, 1.0);
        let mean = if to > width { to } else { above * above * width };
        Self { cosine: mean, above, mean }
    }

    /// From the derivatives by these values to those by the four arguments of [`Self::new`]; zero where there is no light.
    pub fn pull(by: Self, to: f64, from: f64, tilt: f64, angle2: f64) -> [f64; 4] {
        let width = (1.5 * angle2 * (1.0 - tilt * tilt)).max(0.0).sqrt();
        let straddles = width > 0.0 && to.abs() <= width;
        let per_width = if straddles { 1.0 / width } else { 0.0 };
        let above = if straddles { 0.5 + 0.5 * to * per_width } else { f64::from(u8::from(to > 0.0)) };
        let mean = if straddles { above * above * width } else { to.max(0.0) };
        let second = mean - tilt * from - 3.0 * mean * from * from;
        let value = mean + above * 2.0 * angle2 * second;
        if value.is_nan() || value <= 0.0 {
            return [0.0; 4];
        }
        let by_mean = by.mean + by.cosine * (1.0 + above * 2.0 * angle2 * (1.0 - 3.0 * from * from));
        let by_above = by.above + by.cosine * 2.0 * angle2 * second;
        let by_width = match straddles {
            true => by_mean * above * (1.0 - above) - by_above * 0.5 * to * per_width * per_width,
            false => 0.0,
        };
        [
            by_mean * above + by_above * 0.5 * per_width,
            -by.cosine * above * 2.0 * angle2 * (tilt + 6.0 * mean * from),
            -by.cosine * above * 2.0 * angle2 * from - by_width * 1.5 * angle2 * tilt * per_width,
            by.cosine * above * 2.0 * second + by_width * 0.75 * (1.0 - tilt * tilt) * per_width,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central differences with step 1e-6, whose error is below 1e-8 for these slopes.
    #[test]
    fn the_gradient_is_that_of_the_mean() {
        for to in [-0.2, -0.05, 0.02, 0.08, 0.4] {
            for (from, tilt, angle2) in
                [(0.3, 0.2, 0.01), (0.9, -0.7, 0.02), (0.05, 0.99, 0.03), (0.5, 1.0, 0.01)]
            {
                let by = Spread { cosine: 1.0, above: 0.3, mean: -0.7 };
                let at = |x: [f64; 4]| {
                    let Spread { cosine, above, mean } = Spread::new(x[0], x[1], x[2], x[3]);
                    by.cosine * cosine + by.above * above + by.mean * mean
                };
                let found = Spread::pull(by, to, from, tilt, angle2);
                for k in 0..4 {
                    let moved = |step: f64| {
                        let mut x = [to, from, tilt, angle2];
                        x[k] += step;
                        at(x)
                    };
                    // A cosine of 1 can only decrease; there the width has no slope.
                    if tilt < 1.0 || k != 2 {
                        let slope = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                        assert!(
                            (found[k] - slope).abs() <= 1e-7,
                            "{to} {from} {tilt}, {k}: {} {slope}",
                            found[k]
                        );
                    }
                }
            }
        }
    }
}
