//! The derivatives of the taps with respect to their direction.

use crate::model::{Bins, Cells};
use crate::scene::BinLayout;
use glam::{DVec2, DVec3, Vec2Swizzles};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Below this sine of the polar angle the azimuth is rounding noise, and its derivative counts as zero.
const POLE: f64 = 1e-12;

/// The taps of a direction and their derivatives with respect to it, as unconstrained vectors in the frame of the triangle.
#[derive(Clone, Copy, Debug)]
pub struct TapSlopes {
    /// In the order of [`Bins::taps`].
    pub index: [usize; 4],
    /// Weight of the second row.
    row: f64,
    /// Weight of the second column.
    column: f64,
    row_slope: DVec3,
    column_slope: DVec3,
}

impl TapSlopes {
    pub fn new(bins: &Bins, direction: DVec3) -> Self {
        let (row, column) = bins.cells(direction);
        let (row_slope, column_slope) = match bins.layout {
            BinLayout::EqualAngle { theta, phi } => equal_angle(direction, theta, phi),
            BinLayout::Concentric { n } => concentric(direction, n),
        };
        Self {
            index: bins.around(row, column),
            row: row.fraction,
            column: column.fraction,
            row_slope: row_slope * weight_slope(row),
            column_slope: column_slope * weight_slope(column),
        }
    }

    /// In the order of [`Bins::taps`].
    pub fn weights(&self) -> [f64; 4] {
        let (t, s) = (self.row, self.column);
        [(1.0 - t) * (1.0 - s), (1.0 - t) * s, t * (1.0 - s), t * s]
    }

    /// The gradient of Σ weight · value over the four taps.
    pub fn gradient(&self, [a, b, c, d]: [f64; 4]) -> DVec3 {
        let along_row = (1.0 - self.column) * (c - a) + self.column * (d - b);
        let along_column = (1.0 - self.row) * (b - a) + self.row * (d - c);
        along_row * self.row_slope + along_column * self.column_slope
    }
}

/// Derivative of the weight with respect to the coordinate, per cell.
fn weight_slope(cells: Cells) -> f64 {
    if cells.clamped { 0.0 } else { 1.0 }
}

/// Gradients of row (polar angle) and column (azimuth), in cells. Below the horizon z counts as 0, so that the polar angle is
/// constant.
fn equal_angle(direction: DVec3, theta: u32, phi: u32) -> (DVec3, DVec3) {
    let sine = direction.truncate().length();
    if sine <= POLE {
        return (DVec3::ZERO, DVec3::ZERO);
    }
    let outwards = direction.truncate() / sine;
    let polar = match direction.z > 0.0 {
        true => (outwards * direction.z).extend(-sine) / direction.length_squared(),
        false => DVec3::ZERO,
    };
    let azimuth = (outwards.perp() / sine).extend(0.0);
    (polar * (f64::from(theta) / FRAC_PI_2), azimuth * (f64::from(phi) / TAU))
}

/// Gradients of v and u of the square, in cells: the concentric map (Shirley and Chiu 1997) of the disk point (x, y)/√(1+z), where
/// z counts as 0 below the horizon.
fn concentric(direction: DVec3, n: u32) -> (DVec3, DVec3) {
    let z = direction.z.max(0.0);
    let scale = 1.0 / (1.0 + z).sqrt();
    let disk = direction.truncate() * scale;
    let radius = disk.length();
    if radius <= POLE {
        return (DVec3::ZERO, DVec3::ZERO);
    }
    let along_x = disk.x.abs() >= disk.y.abs();
    let size = disk.abs();
    let (long, short) = if along_x { (size.x, size.y) } else { (size.y, size.x) };
    // With the longer axis first: (r, r ψ 4/π), ψ = atan(short / long).
    let outwards = DVec2::new(long, short) / radius;
    let longer = outwards;
    let shorter = (outwards * (short / long).atan() + outwards.perp()) * (4.0 / PI);
    let (u, v) = if along_x { (longer, shorter) } else { (shorter.yx(), longer.yx()) };
    // The signs of the quadrant: they cancel on the coordinate's own axis.
    let mixed = 1.0_f64.copysign(disk.x) * 1.0_f64.copysign(disk.y);
    let (u, v) = (DVec2::new(u.x, u.y * mixed), DVec2::new(v.x * mixed, v.y));
    let pull = |g: DVec2| {
        let along_z = if direction.z > 0.0 { -0.5 * scale * scale * g.dot(disk) } else { 0.0 };
        (g * scale).extend(along_z) * (0.5 * f64::from(n))
    };
    (pull(v), pull(u))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn every_kind() -> impl Iterator<Item = Bins> {
        let layouts = [
            BinLayout::EqualAngle { theta: 10, phi: 13 },
            BinLayout::EqualAngle { theta: 2, phi: 3 },
            BinLayout::Concentric { n: 2 },
            BinLayout::Concentric { n: 12 },
        ];
        layouts.into_iter().map(Bins::new)
    }

    fn value_of(bin: usize) -> f64 {
        (bin as f64 * 1.7).sin()
    }

    /// Along two tangents, by central differences with step 1e-6, whose error is 1e-9. Where a kink lies within the step, half the
    /// step gives another slope, and the direction is skipped; few are.
    #[test]
    fn taps_match_their_slopes() {
        for bins in every_kind() {
            let read = |d: DVec3| bins.taps(d).iter().map(|&(b, w)| w * value_of(b)).sum::<f64>();
            let (mut compared, mut kinks) = (0, 0);
            for k in 0..2000 {
                let (z, azimuth) = (-0.1 + 1.1 * (k as f64 + 0.5) / 2000.0, k as f64 * 2.399_963);
                let d = (DVec2::from_angle(azimuth) * (1.0_f64 - z * z).sqrt()).extend(z);
                let slopes = TapSlopes::new(&bins, d);
                let taps = bins.taps(d);
                assert_eq!(slopes.index, taps.map(|t| t.0));
                assert_eq!(slopes.weights(), taps.map(|t| t.1));
                let gradient = slopes.gradient(slopes.index.map(value_of));
                let (one, other) = d.any_orthonormal_pair();
                for tangent in [one, other] {
                    let slope = |step: f64| {
                        let at = |step: f64| read((d + step * tangent).normalize());
                        (at(step) - at(-step)) / (2.0 * step)
                    };
                    let (slope, half) = (slope(1e-6), slope(5e-7));
                    if (slope - half).abs() > 1e-8 * slope.abs().max(1.0) {
                        kinks += 1;
                        continue;
                    }
                    compared += 1;
                    let error = gradient.dot(tangent) - slope;
                    assert!(
                        error.abs() <= 1e-8 * slope.abs().max(1.0),
                        "{:?} {d}: {slope} {error:e}",
                        bins.layout
                    );
                }
            }
            assert!(kinks * 100 <= compared, "{kinks} kinks, {compared} compared");
        }
    }

    #[test]
    fn slopes_are_finite_everywhere() {
        let tiny = [0.0, 1e-320, 1e-160, 1e-15, 1e-9];
        for bins in every_kind() {
            for (x, y) in tiny.into_iter().flat_map(|x| tiny.map(|y| (x, -y))) {
                for z in [1.0, 0.0, -0.0, -1.0, 1e-300] {
                    for d in [DVec3::new(x, y, z), DVec3::new(z, x, y), DVec3::new(x, z, y)] {
                        let slopes = TapSlopes::new(&bins, d);
                        assert!(slopes.gradient([1.0, -2.0, 3.0, 4.0]).is_finite(), "{:?} {d}", bins.layout);
                    }
                }
            }
        }
    }
}
