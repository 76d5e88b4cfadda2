//! Specular reflection of lamps at the exact directions of lamp and eye: ∫ ⟨h, n⟩^p cosθ dω over the visible part.

use super::cone::{Side, arc, sides};
use super::quadrature::POINTS;
use glam::DVec3;
use std::f64::consts::PI;

/// The Blinn-Phong lobe of a point towards an eye, without its factor.
#[derive(Clone, Copy, Debug)]
pub struct Lobe {
    pub normal: DVec3,
    /// Unit direction to the eye.
    pub eye: DVec3,
    pub power: f64,
    /// Cosine of the half vector below which the lobe counts as zero, [`LEAST`] of its peak: most of a lamp is there.
    least: f64,
}

const LEAST: f64 = 1e-12;

/// Derivatives of a loss by a lobe and its integral's parameters.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LobeGradient {
    pub normal: DVec3,
    /// Three free numbers.
    pub eye: DVec3,
    pub power: f64,
}

/// Places and weights of four points that integrate polynomials of degree seven over 0..1 exactly (Gauss and Legendre).
const LINE: [[f64; 2]; 4] = [
    [0.069_431_844_202_973_71, 0.173_927_422_568_726_93],
    [0.330_009_478_207_571_87, 0.326_072_577_431_273_07],
    [0.669_990_521_792_428_1, 0.326_072_577_431_273_07],
    [0.930_568_155_797_026_3, 0.173_927_422_568_726_93],
];

/// Angle of a cell as a fraction of the lobe's width, 2/√p for the half vector's doubled angle: integrals are off by 1e-7 of themselves.
const CELL: f64 = 0.7;
/// Widest cell of broad lobes, radians.
const WIDEST: f64 = 0.2;
/// Cells along a side at most: a lamp that fills the hemisphere at p = 10 000.
const MOST: u32 = 256;

impl Lobe {
    /// `eye`: the unit direction to it.
    pub fn new(normal: DVec3, eye: DVec3, power: f64) -> Self {
        let least = if power > 0.0 { LEAST.powf(1.0 / power) } else { 0.0 };
        Self { normal, eye, power, least }
    }

    /// The lobe of a point towards an eye.
    pub fn towards(eye: DVec3, point: DVec3, normal: DVec3, power: f64) -> Self {
        Self::new(normal, (eye - point).normalize_or_zero(), power)
    }

    /// ⟨h, n⟩^p for a direction of any length.
    pub fn at(&self, to_lamp: DVec3) -> f64 {
        self.value(to_lamp.normalize_or_zero())
    }

    fn half_vector(&self, to_lamp: DVec3) -> (DVec3, f64) {
        let sum = to_lamp + self.eye;
        let length = sum.length().max(1e-12);
        (sum / length, length)
    }

    /// ⟨h, n⟩^p.
    fn value(&self, to_lamp: DVec3) -> f64 {
        let cosine = self.half_vector(to_lamp).0.dot(self.normal).max(1e-20);
        match self.power > 0.0 {
            true if cosine < self.least => 0.0,
            true => cosine.powf(self.power),
            false => 1.0,
        }
    }

    /// ln ⟨h, n⟩ ⟨h, n⟩^p, the derivative of [`Self::at`] by p.
    pub fn by_power(&self, to_lamp: DVec3) -> f64 {
        let to_lamp = to_lamp.normalize_or_zero();
        self.half_vector(to_lamp).0.dot(self.normal).max(1e-20).ln() * self.value(to_lamp)
    }

    /// About the largest value in directions up to an angle from one; never zero.
    pub fn highest(&self, direction: DVec3, angle: f64) -> f64 {
        let (half, length) = self.half_vector(direction.normalize_or_zero());
        let moves = angle / (length - angle).max(0.1);
        let nearest = (half.angle_between(self.normal) - moves).clamp(0.0, 0.5 * PI);
        nearest.cos().powf(self.power).max(LEAST)
    }

    /// Cells along a side of a cone with such an angle.
    fn cells(&self, angle: f64) -> u32 {
        let width = (CELL * 2.0 / self.power.max(1.0).sqrt()).min(WIDEST);
        ((angle / width).ceil() as u32).clamp(1, MOST)
    }

    /// Whether the lobe counts as zero in all directions up to an angle from one. A half vector moves by no more than the direction
    /// does, over the length of the sum that it is the direction of.
    fn misses(&self, direction: DVec3, angle: f64) -> bool {
        let (half, length) = self.half_vector(direction.normalize_or_zero());
        let moves = angle / (length - angle);
        length > angle && half.angle_between(self.normal) - moves > self.least.acos()
    }

    /// Calls `each` with unit directions and solid angles that cover a piece of a lamp, whose corners must
    /// lie in one plane.
    fn quadrature(&self, part: &[Side], each: &mut dyn FnMut(DVec3, f64)) {
        let Some(first) = part.first() else { return };
        for k in 1..part.len().saturating_sub(1) {
            let [a, b, c] = [first.corner, part[k].corner, part[k + 1].corner];
            let angle = a.angle_between(b).max(b.angle_between(c)).max(c.angle_between(a));
            if self.misses(a.normalize() + b.normalize() + c.normalize(), angle) {
                continue;
            }
            let n = self.cells(angle);
            let det = a.dot(b.cross(c));
            let step = 1.0 / f64::from(n);
            // dω = det dA / |x|³ with dA in barycentric coordinates, of which the triangle has 1/2.
            let share = det * step * step / 2.0;
            for i in 0..n {
                for j in 0..2 * (n - i) - 1 {
                    let (u, v) = (f64::from(i), f64::from(j / 2));
                    // Upright cells, and those upside down between them.
                    let (corner, sign) = if j % 2 == 0 { ((u, v), 1.0) } else { ((u + 1.0, v + 1.0), -1.0) };
                    for (weights, share_of_cell) in POINTS {
                        let s = (corner.0 + sign * weights[1]) * step;
                        let t = (corner.1 + sign * weights[2]) * step;
                        let x = a * (1.0 - s - t) + b * s + c * t;
                        let length = x.length();
                        each(x / length, share * share_of_cell / length.powi(3));
                    }
                }
            }
        }
    }

    /// ∫ ⟨h, n⟩^p cosθ dω over a part.
    pub fn integral(&self, part: &[Side]) -> f64 {
        let mut sum = 0.0;
        self.quadrature(part, &mut |direction, solid_angle| {
            sum += self.value(direction) * direction.dot(self.normal).max(0.0) * solid_angle;
        });
        sum
    }

    /// The integral, and its derivatives by the lobe while the part is held fixed.
    pub fn slopes(&self, part: &[Side]) -> (f64, LobeGradient) {
        let mut sum = 0.0;
        let mut slopes = LobeGradient::default();
        self.quadrature(part, &mut |direction, solid_angle| {
            let (half, length) = self.half_vector(direction);
            let cosine = half.dot(self.normal).max(1e-20);
            let value = self.value(direction);
            let incident = direction.dot(self.normal).max(0.0) * solid_angle;
            sum += value * incident;
            let by_cosine = self.power * value / cosine * incident;
            slopes.normal += by_cosine * half + value * solid_angle * direction;
            slopes.eye += by_cosine * (self.normal - cosine * half) / length;
            slopes.power += cosine.ln() * value * incident;
        });
        (sum, slopes)
    }

    /// ∫ ⟨h, n⟩^p cosθ ω ds along each arc of a part: its product with the change of the unit normal of the arc's plane, which points into
    /// the part, is the change of the integral.
    pub fn arcs<'a>(&'a self, part: &'a [Side]) -> impl Iterator<Item = (u32, [DVec3; 2], DVec3)> + 'a {
        sides(part).filter_map(|(plane, ends)| {
            let (e1, e2, angle) = arc(ends)?;
            let n = self.cells(angle);
            let step = angle / f64::from(n);
            let mut sum = DVec3::ZERO;
            for i in 0..n {
                for [place, weight] in LINE {
                    let (sin, cos) = ((f64::from(i) + place) * step).sin_cos();
                    let direction = e1 * cos + e2 * sin;
                    let incident = direction.dot(self.normal).max(0.0);
                    sum += direction * (self.value(direction) * incident * weight * step);
                }
            }
            Some((plane, ends, sum))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part() -> Vec<Side> {
        let corners = [[0.6, -0.3, 1.0], [-0.5, -0.4, 1.1], [-0.2, 0.7, 1.0], [0.5, 0.4, 0.92]];
        corners.into_iter().rev().map(|c| Side { corner: DVec3::from(c), plane: 0 }).collect()
    }

    fn lobe(power: f64) -> Lobe {
        Lobe::new(DVec3::Z, DVec3::new(0.3, -0.2, 0.9).normalize(), power)
    }

    /// A lobe is as good as zero in all cones that are left out.
    #[test]
    fn cones_that_a_lobe_misses_hold_nothing_of_it() {
        let (mut missed, mut random) = (0, 0.5_f64);
        let mut next = || {
            random = (random * 997.0 + 0.123).fract();
            2.0 * random - 1.0
        };
        for _ in 0..20_000 {
            let direction = DVec3::new(next(), next(), next().abs()).normalize();
            let (angle, lobe) = (0.3 * next().abs(), lobe(500.0 + 450.0 * next()));
            if lobe.misses(direction, angle) {
                missed += 1;
                let (s, t) = direction.any_orthonormal_pair();
                for turn in 0..8 {
                    let (sin, cos) = (f64::from(turn) * 0.785).sin_cos();
                    let edge = direction * angle.cos() + (s * cos + t * sin) * angle.sin();
                    assert_eq!(lobe.value(edge), 0.0, "{direction} {angle}");
                }
            }
        }
        assert!((2000..18_000).contains(&missed), "{missed}");
    }

    /// Against a fine grid over the sphere, a direction counting where it lies in the cone.
    #[test]
    fn integrals_are_those_of_a_grid() {
        let part = part();
        for power in [0.0, 5.0, 60.0, 500.0] {
            let lobe = lobe(power);
            let n = 1500;
            let mut sum = 0.0;
            for i in 0..n {
                for j in 0..4 * n {
                    let z = (f64::from(i) + 0.5) / f64::from(n);
                    let (sin, cos) =
                        (std::f64::consts::TAU * (f64::from(j) + 0.5) / f64::from(4 * n)).sin_cos();
                    let r = (1.0 - z * z).sqrt();
                    let direction = DVec3::new(r * cos, r * sin, z);
                    if sides(&part).all(|(_, [a, b])| a.cross(b).dot(direction) > 0.0) {
                        sum += lobe.value(direction) * z;
                    }
                }
            }
            let grid = sum * std::f64::consts::TAU / f64::from(n) / f64::from(4 * n);
            let error = lobe.integral(&part) / grid - 1.0;
            println!("{power}: {grid} {error:e}");
            assert!(error.abs() <= 1e-3, "{power}: {error:e}");
        }
    }

    #[test]
    fn slopes_are_those_of_central_differences() {
        let part = part();
        let lobe = lobe(37.0);
        let (_, slopes) = lobe.slopes(&part);
        let step = 1e-6;
        let along = |change: &dyn Fn(&mut Lobe, f64)| {
            let [above, below] = [step, -step].map(|by| {
                let mut moved = lobe;
                change(&mut moved, by);
                moved.integral(&part)
            });
            (above - below) / (2.0 * step)
        };
        for axis in 0..3 {
            let by_normal = along(&|lobe, by| lobe.normal[axis] += by);
            let by_eye = along(&|lobe, by| lobe.eye[axis] += by);
            assert!((by_normal - slopes.normal[axis]).abs() <= 1e-7, "{by_normal} {}", slopes.normal[axis]);
            assert!((by_eye - slopes.eye[axis]).abs() <= 1e-7, "{by_eye} {}", slopes.eye[axis]);
        }
        let by_power = along(&|lobe, by| lobe.power += by);
        assert!((by_power - slopes.power).abs() <= 1e-7);
    }
}
