//! Rigid motions and scalings, and their derivatives.

use glam::{DMat3, DVec3};
use std::ops::AddAssign;

/// x ↦ centre + factor · R(rotation) (x - centre) + translation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Motion {
    pub centre: DVec3,
    /// Metres.
    pub translation: DVec3,
    /// Rotation vector: the axis times the angle in radians.
    pub rotation: DVec3,
    /// Natural logarithm of the factor, so that every value is valid.
    pub log_factor: f64,
}

/// Derivatives of a loss by a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct MotionGradient {
    pub translation: DVec3,
    pub rotation: DVec3,
    pub log_factor: f64,
}

impl AddAssign for MotionGradient {
    fn add_assign(&mut self, other: Self) {
        self.translation += other.translation;
        self.rotation += other.rotation;
        self.log_factor += other.log_factor;
    }
}

/// A motion of which parts are unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct FreeMotion {
    pub centre: DVec3,
    /// What one unit of the unknowns is of the translation in metres, the rotation vector in radians, and the logarithm of the factor; `None`
    /// for what stays as it is.
    pub units: [Option<f64>; 3],
}

/// A part of a motion that is unknown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Part {
    /// Its first unknown.
    pub first: usize,
    /// What one unit of its unknowns is.
    pub unit: f64,
}

impl FreeMotion {
    /// Numbers of unknowns of translation, rotation and factor.
    const NUMBERS: [usize; 3] = [3, 3, 1];

    /// Number of unknowns.
    pub fn unknowns(&self) -> usize {
        self.units
            .iter()
            .zip(Self::NUMBERS)
            .map(|(unit, number)| if unit.is_some() { number } else { 0 })
            .sum()
    }

    /// Translation, rotation and factor, as far as they are unknown.
    pub fn parts(&self) -> [Option<Part>; 3] {
        let mut next = 0;
        [0, 1, 2].map(|k| {
            let first = next;
            self.units[k].map(|unit| {
                next += Self::NUMBERS[k];
                Part { first, unit }
            })
        })
    }

    /// The motion for some unknowns.
    pub fn motion(&self, x: &[f64]) -> Motion {
        let [translation, rotation, factor] = self.parts();
        let vector = |part: Option<Part>| {
            part.map_or(DVec3::ZERO, |Part { first, unit }| unit * DVec3::from_slice(&x[first..]))
        };
        Motion {
            centre: self.centre,
            translation: vector(translation),
            rotation: vector(rotation),
            log_factor: factor.map_or(0.0, |Part { first, unit }| unit * x[first]),
        }
    }

    /// Derivatives by the unknowns, from those by the motion.
    pub fn by_unknowns(&self, by: &MotionGradient) -> Vec<f64> {
        let [translation, rotation, factor] = self.units;
        let vector =
            |unit: Option<f64>, by: DVec3| unit.into_iter().flat_map(move |unit| (unit * by).to_array());
        let vectors = vector(translation, by.translation).chain(vector(rotation, by.rotation));
        vectors.chain(factor.map(|unit| unit * by.log_factor)).collect()
    }
}

impl Motion {
    pub fn at_rest(centre: DVec3) -> Self {
        Self { centre, translation: DVec3::ZERO, rotation: DVec3::ZERO, log_factor: 0.0 }
    }

    fn matrix(&self) -> DMat3 {
        DMat3::from_quat(glam::DQuat::from_scaled_axis(self.rotation))
    }

    /// Maps points by the motion.
    pub fn apply<'a>(&'a self, points: impl Iterator<Item = DVec3> + 'a) -> impl Iterator<Item = DVec3> + 'a {
        let linear = self.log_factor.exp() * self.matrix();
        // The identity leaves every point unchanged to the last bit.
        let rests = *self == Self::at_rest(self.centre);
        points
            .map(move |x| if rests { x } else { self.centre + linear * (x - self.centre) + self.translation })
    }

    /// Its matrix, which acts on columns: three rows.
    pub fn rows(&self) -> [[f64; 4]; 3] {
        let linear = self.log_factor.exp() * self.matrix();
        let rest = self.centre - linear * self.centre + self.translation;
        [0, 1, 2].map(|i| [linear.col(0)[i], linear.col(1)[i], linear.col(2)[i], rest[i]])
    }

    /// Where a point goes.
    pub fn place(&self, point: DVec3) -> DVec3 {
        self.apply(std::iter::once(point)).next().unwrap_or(point)
    }

    /// The derivative by the motion, from points before it and the derivatives by the points after it.
    ///
    /// d(R v)/dω = -R [v]× J(ω), with the right Jacobian J of rotation vectors: exact at any ω, not only at 0.
    pub fn pull_back(&self, pairs: impl Iterator<Item = (DVec3, DVec3)>) -> MotionGradient {
        let (matrix, factor) = (self.matrix(), self.log_factor.exp());
        let mut gradient = MotionGradient::default();
        for (point, by_position) in pairs {
            let arm = point - self.centre;
            // The derivative rotated back into the frame before the rotation.
            let local = factor * (matrix.transpose() * by_position);
            gradient.translation += by_position;
            gradient.rotation += arm.cross(local);
            gradient.log_factor += arm.dot(local);
        }
        gradient.rotation = right_jacobian(self.rotation).transpose() * gradient.rotation;
        gradient
    }
}

/// J(ω) = I - (1 - cos θ)/θ² [ω]× + (θ - sin θ)/θ³ [ω]×².
fn right_jacobian(rotation: DVec3) -> DMat3 {
    let angle2 = rotation.length_squared();
    let angle = angle2.sqrt();
    let (a, b) = if angle < 1e-3 {
        // The first terms of the series; the rest is below rounding.
        (0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0)
    } else {
        let half = (angle / 2.0).sin();
        (2.0 * half * half / angle2, (angle - angle.sin()) / (angle2 * angle))
    };
    let DVec3 { x, y, z } = rotation;
    let cross = DMat3::from_cols(DVec3::new(0.0, z, -y), DVec3::new(-z, 0.0, x), DVec3::new(y, -x, 0.0));
    DMat3::IDENTITY - a * cross + b * (cross * cross)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_those_of_finite_differences_at_any_rotation() {
        let points: Vec<DVec3> =
            (0..7).map(|i| DVec3::new(f64::from(i).sin(), f64::from(i) * 0.3, 1.0)).collect();
        let weights: Vec<DVec3> =
            (0..7).map(|i| DVec3::new(f64::from(i).cos(), 0.5, f64::from(i) * 0.1)).collect();
        let value = |motion: &Motion| -> f64 {
            motion.apply(points.iter().copied()).zip(&weights).map(|(x, w)| x.dot(*w)).sum()
        };
        for rotation in [
            DVec3::ZERO,
            DVec3::new(1e-6, 0.0, 2e-7),
            DVec3::new(9e-4, 2e-4, 0.0),
            DVec3::new(0.3, -0.8, 1.1),
            DVec3::new(3.0, 0.0, 0.2),
        ] {
            let motion = Motion {
                centre: DVec3::new(0.2, 0.1, 0.9),
                translation: DVec3::new(0.4, 0.0, 2.0),
                rotation,
                log_factor: -0.3,
            };
            let gradient = motion.pull_back(points.iter().copied().zip(weights.iter().copied()));
            let h = 1e-5;
            let numeric = |change: &dyn Fn(&mut Motion, f64)| {
                let at = |step: f64| {
                    let mut moved = motion;
                    change(&mut moved, step);
                    value(&moved)
                };
                (at(h) - at(-h)) / (2.0 * h)
            };
            for axis in 0..3 {
                let by_rotation = numeric(&|m, step| m.rotation[axis] += step);
                assert!((by_rotation - gradient.rotation[axis]).abs() < 1e-8, "{rotation} {axis}");
                let by_translation = numeric(&|m, step| m.translation[axis] += step);
                assert!((by_translation - gradient.translation[axis]).abs() < 1e-8);
            }
            assert!((numeric(&|m, step| m.log_factor += step) - gradient.log_factor).abs() < 1e-8);
        }
    }

    #[test]
    fn rows_place_points_as_the_motion_does() {
        let motion = Motion {
            centre: DVec3::new(0.2, 0.1, 0.9),
            translation: DVec3::new(0.4, 0.0, 2.0),
            rotation: DVec3::new(0.3, -0.8, 1.1),
            log_factor: -0.3,
        };
        let point = DVec3::new(-1.0, 2.0, 0.5);
        let by_rows = motion.rows().map(|[a, b, c, d]| DVec3::new(a, b, c).dot(point) + d);
        assert!((DVec3::from(by_rows) - motion.place(point)).length() < 1e-12);
    }

    #[test]
    fn at_rest_nothing_moves() {
        let point = DVec3::new(0.1, 1e-17, 1e9);
        let moved = Motion::at_rest(DVec3::new(0.7, 0.3, 0.0)).apply(std::iter::once(point)).next();
        assert_eq!(moved, Some(point));
    }
}
