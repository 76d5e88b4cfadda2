//! Losses between a picture and its target: value and gradient per pixel, in linear RGB.

use super::Target;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A loss between pictures. Implement it for a custom loss.
pub trait PictureLoss {
    /// The loss of a view, and its derivative by every pixel. `picture` and [`Target::pixels`]: row by row from the top.
    fn evaluate(&self, view: usize, picture: &[DVec3], target: &Target) -> (f64, Vec<DVec3>);

    /// The second derivative by every pixel if the loss is quadratic, as bounded least squares requires.
    fn curvature(&self, _view: usize, _target: &Target) -> Option<Vec<DVec3>> {
        None
    }
}

/// Kind of loss.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum LossKind {
    /// |d|, with d the difference: robust against outliers. Its derivative is discontinuous at d = 0 and taken as 0 there.
    L1,
    /// d²: smooth everywhere; bright pixels dominate.
    #[default]
    L2,
    /// d² / (t² + ε²), with t the target: dark pixels count as much as bright ones. Quadratic too, since ε is constant.
    RelativeL2,
    /// |s(v) - s(t)| with s(v) = sign(v) ln(1 + |v|/ε): compares ratios, is robust against outliers, and admits slightly
    /// negative v, which antiradiance can cause. Its derivative is discontinuous at v = t and taken as 0 there.
    LogL1,
}

/// A built-in loss: the mean over channels and pixels, weighted by the mask.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Loss {
    /// Loss per channel of a pixel.
    pub kind: LossKind,
    /// Radiance below which relative losses stop being relative, W/(m² sr).
    pub epsilon: f64,
}

/// Default ε as a fraction of the mean target.
const EPSILON: f64 = 0.01;

impl Loss {
    /// The loss with the default ε for the targets: a hundredth of their mean.
    pub fn new(kind: LossKind, targets: &[Target]) -> Self {
        let (mut sum, mut weight) = (0.0, 0.0);
        for target in targets {
            for (at, pixel) in target.pixels.iter().enumerate().filter(|(at, _)| target.mask_at(*at) > 0.0) {
                sum += target.mask_at(at) * pixel.abs().element_sum() / 3.0;
                weight += target.mask_at(at);
            }
        }
        let mean = sum / weight;
        Self { kind, epsilon: if mean > 0.0 { EPSILON * mean } else { EPSILON } }
    }

    /// Value and derivative for one channel of one pixel.
    pub fn channel(&self, value: f64, target: f64) -> (f64, f64) {
        let d = value - target;
        let sign = if d == 0.0 { 0.0 } else { d.signum() };
        match self.kind {
            LossKind::L1 => (d.abs(), sign),
            LossKind::L2 => (d * d, 2.0 * d),
            LossKind::RelativeL2 => {
                let scale = target * target + self.epsilon * self.epsilon;
                (d * d / scale, 2.0 * d / scale)
            }
            LossKind::LogL1 => {
                let log = |v: f64| (v.abs() / self.epsilon).ln_1p().copysign(v);
                ((log(value) - log(target)).abs(), sign / (self.epsilon + value.abs()))
            }
        }
    }
}

impl PictureLoss for Loss {
    fn evaluate(&self, _view: usize, picture: &[DVec3], target: &Target) -> (f64, Vec<DVec3>) {
        let norm = 1.0 / (3.0 * target.mask_sum());
        let mut sum = 0.0;
        let gradient = picture
            .iter()
            .zip(&target.pixels)
            .enumerate()
            .map(|(at, (value, expected))| {
                let weight = norm * target.mask_at(at);
                // Masked pixels may hold any value, even NaN.
                if weight == 0.0 {
                    return DVec3::ZERO;
                }
                let channels = [0, 1, 2].map(|c| self.channel(value[c], expected[c]));
                sum += weight * channels.iter().map(|(value, _)| value).sum::<f64>();
                weight * DVec3::from(channels.map(|(_, derivative)| derivative))
            })
            .collect();
        (sum, gradient)
    }

    fn curvature(&self, _view: usize, target: &Target) -> Option<Vec<DVec3>> {
        let norm = 2.0 / (3.0 * target.mask_sum());
        let of = |t: f64| match self.kind {
            LossKind::L2 => Some(1.0),
            LossKind::RelativeL2 => Some(1.0 / (t * t + self.epsilon * self.epsilon)),
            LossKind::L1 | LossKind::LogL1 => None,
        };
        let pixel = |(at, t): (usize, &DVec3)| {
            let weight = norm * target.mask_at(at);
            if weight == 0.0 {
                return Some(DVec3::ZERO);
            }
            Some(weight * DVec3::new(of(t.x)?, of(t.y)?, of(t.z)?))
        };
        target.pixels.iter().enumerate().map(pixel).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::Camera;

    fn target(pixels: Vec<DVec3>, mask: Option<Vec<f64>>) -> Target {
        let mut camera = Camera::framing(&[]);
        (camera.width, camera.height) = (pixels.len() as u32, 1);
        Target::new(camera, pixels, mask, 1.0).expect("a target")
    }

    fn wave(n: usize, a: f64) -> Vec<DVec3> {
        (0..n).map(|i| DVec3::new(a + i as f64, 2.0 * a, a * i as f64).map(|v| 1.1 + v.sin())).collect()
    }

    const KINDS: [LossKind; 4] = [LossKind::L1, LossKind::L2, LossKind::RelativeL2, LossKind::LogL1];

    #[test]
    fn gradients_are_those_of_finite_differences() {
        let n = 12;
        let mask: Vec<f64> = (0..n).map(|i| (i % 4) as f64 / 3.0).collect();
        for mask in [None, Some(mask)] {
            let target = target(wave(n, 0.3), mask);
            let mut picture = wave(n, 0.9);
            // Antiradiance: darker than black.
            picture[5].x = -0.02;
            for kind in KINDS {
                let loss = Loss::new(kind, std::slice::from_ref(&target));
                let (_, gradient) = loss.evaluate(0, &picture, &target);
                for pixel in 0..n {
                    for channel in 0..3 {
                        let h = 1e-5;
                        let mut at = |step: f64| {
                            picture[pixel][channel] += step;
                            let (value, _) = loss.evaluate(0, &picture, &target);
                            picture[pixel][channel] -= step;
                            value
                        };
                        let numeric = (at(h) - at(-h)) / (2.0 * h);
                        let ours = gradient[pixel][channel];
                        assert!(
                            (numeric - ours).abs() < 1e-6 * (1.0 + ours.abs()),
                            "{kind:?} {pixel}.{channel}: {ours}, {numeric}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn a_picture_like_its_target_is_a_minimum() {
        let target = target(wave(5, 0.7), None);
        for kind in KINDS {
            let loss = Loss::new(kind, std::slice::from_ref(&target));
            let (value, gradient) = loss.evaluate(0, &target.pixels, &target);
            assert_eq!(value, 0.0, "{kind:?}");
            assert!(gradient.iter().all(|g| *g == DVec3::ZERO), "{kind:?}");
        }
    }

    #[test]
    fn a_mask_is_a_mean_over_what_it_leaves() {
        let mut pixels = vec![DVec3::ZERO; 3];
        pixels[2] = DVec3::NAN;
        let masked = target(pixels, Some(vec![1.0, 0.5, 0.0]));
        let loss = Loss { kind: LossKind::L2, epsilon: 1.0 };
        let picture = [DVec3::ONE, DVec3::splat(2.0), DVec3::splat(9.0)];
        let (value, gradient) = loss.evaluate(0, &picture, &masked);
        assert_eq!(value, (1.0 + 0.5 * 4.0) / 1.5);
        assert_eq!(gradient[2], DVec3::ZERO);
        assert!(Loss::new(LossKind::L2, std::slice::from_ref(&masked)).epsilon.is_finite());
    }

    #[test]
    fn curvature_is_the_change_of_the_gradient() {
        let target = target(wave(6, 0.3), Some(vec![1.0, 0.2, 1.0, 0.0, 1.0, 1.0]));
        for kind in KINDS {
            let loss = Loss::new(kind, std::slice::from_ref(&target));
            let Some(curvature) = loss.curvature(0, &target) else {
                assert!(matches!(kind, LossKind::L1 | LossKind::LogL1));
                continue;
            };
            let (a, b) = (wave(6, 0.1), wave(6, 1.9));
            let (ga, gb) = (loss.evaluate(0, &a, &target).1, loss.evaluate(0, &b, &target).1);
            for i in 0..6 {
                assert!((gb[i] - ga[i] - curvature[i] * (b[i] - a[i])).abs().max_element() < 1e-12);
            }
        }
    }
}
