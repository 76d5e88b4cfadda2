//! Losses between a picture and its target: value and gradient per pixel, in linear RGB.

use super::Target;
use antirad_base::parallel;
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// A loss between pictures. Implement it for a custom loss.
pub trait PictureLoss {
    /// The loss of a view, and its derivative by every pixel. `picture` and [`Target::pixels`]: row by row from the top, in the
    /// unit of the target.
    fn evaluate(&self, view: usize, picture: &[DVec3], target: &Target) -> (f64, Vec<DVec3>);

    /// Second derivatives by every pixel at `picture`, or of a parabola that touches the loss there and lies above it; `None` if the
    /// loss is not smooth.
    fn curvature(&self, _view: usize, _picture: &[DVec3], _target: &Target) -> Option<Vec<DVec3>> {
        None
    }

    /// Whether the loss is quadratic, so that [`Self::curvature`] is the same for all pictures, as bounded least squares
    /// requires.
    #[doc(hidden)]
    fn is_quadratic(&self) -> bool {
        false
    }

    /// The same loss for other targets, such as smaller pictures of the same views; `None` if it is for its own alone. Then fits of textures
    /// have no first stage of smaller pictures.
    #[doc(hidden)]
    fn of_targets(&self, _targets: &[Target]) -> Option<Box<dyn PictureLoss + Send + Sync>> {
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
    /// u² for |u| up to a threshold k, and k (2 |u| - k) beyond, with u = d / √(m² + ε²) and m the mean of the target over the
    /// 5 x 5 pixels around, without the pixel itself: relative like [`Self::RelativeL2`], but outliers count by their size alone, and
    /// noise of the target does not decide what it counts (Huber 1964). The loss for photos.
    Huber,
}

/// A built-in loss: the mean over channels and pixels, weighted by the mask. Where a target's value is only a lower bound
/// ([`Target::clip`]), what is brighter costs nothing.
#[derive(Clone, Debug, PartialEq)]
pub struct Loss {
    /// Loss per channel of a pixel.
    pub kind: LossKind,
    /// Value below which relative losses stop being relative, in the unit of the targets.
    #[doc(hidden)]
    pub epsilon: f64,
    /// Of the Huber loss: relative difference from which on pixels count as outliers.
    #[doc(hidden)]
    pub threshold: f64,
    /// Of the Huber loss: local means of each target.
    means: Vec<Vec<DVec3>>,
}

/// Default ε as a fraction of the mean target.
const EPSILON: f64 = 0.01;
/// That of the Huber loss: where photos are dark, noise and rounding to 8 bits are large.
const EPSILON_OF_HUBER: f64 = 0.1;
/// Default threshold of the Huber loss for photos that clip, and for other pictures, whose noise is often that of path tracing: its rare
/// bright pixels are right in the mean, and would be missed if they counted for less.
const THRESHOLD: f64 = 0.3;
const THRESHOLD_OF_RENDERINGS: f64 = 10.0;
/// Relative error with which a model explains pictures without noise. Noise below it is nothing.
const EXPLAINED: f64 = 0.1;
/// Pixels to either side of a local mean.
const REACH: usize = 2;

impl Loss {
    /// The loss with the default ε for the targets: a hundredth of their mean, a tenth for the Huber loss.
    pub fn new(kind: LossKind, targets: &[Target]) -> Self {
        let (mut sum, mut weight) = (0.0, 0.0);
        for target in targets {
            for (at, pixel) in target.pixels.iter().enumerate().filter(|(at, _)| target.mask_at(*at) > 0.0) {
                sum += target.mask_at(at) * pixel.abs().element_sum() / 3.0;
                weight += target.mask_at(at);
            }
        }
        let mean = sum / weight;
        let fraction = if kind == LossKind::Huber { EPSILON_OF_HUBER } else { EPSILON };
        let means = means_of(kind, targets);
        let epsilon = if mean > 0.0 { fraction * mean } else { fraction };
        let clips = targets.iter().any(|target| target.clip.is_some());
        let threshold = if clips { THRESHOLD } else { THRESHOLD_OF_RENDERINGS };
        Self { kind, epsilon, threshold, means }
    }

    /// Value and derivative for one channel of one pixel. `mean`: the target around it. `noise`: what noise adds to that to which relative
    /// losses compare differences.
    fn channel(&self, value: f64, target: f64, mean: f64, noise: f64) -> (f64, f64) {
        let d = value - target;
        let sign = if d == 0.0 { 0.0 } else { d.signum() };
        match self.kind {
            LossKind::L1 => (d.abs(), sign),
            LossKind::L2 => (d * d, 2.0 * d),
            LossKind::RelativeL2 => {
                let scale = self.square_of_relative(target, noise);
                (d * d / scale, 2.0 * d / scale)
            }
            LossKind::LogL1 => {
                let log = |v: f64| (v.abs() / self.epsilon).ln_1p().copysign(v);
                ((log(value) - log(target)).abs(), sign / (self.epsilon + value.abs()))
            }
            LossKind::Huber => {
                let scale = self.square_of_relative(mean, noise).sqrt();
                let (u, k) = (d / scale, self.threshold);
                match u.abs() <= k {
                    true => (u * u, 2.0 * u / scale),
                    false => (k * (2.0 * u.abs() - k), 2.0 * k * sign / scale),
                }
            }
        }
    }

    /// The curvature for one channel of one pixel: for the Huber loss that of the parabola above it.
    fn channel_curvature(&self, value: f64, target: f64, mean: f64, noise: f64) -> Option<f64> {
        match self.kind {
            LossKind::L2 => Some(2.0),
            LossKind::RelativeL2 => Some(2.0 / self.square_of_relative(target, noise)),
            LossKind::L1 | LossKind::LogL1 => None,
            LossKind::Huber => {
                let scale = self.square_of_relative(mean, noise).sqrt();
                let u = ((value - target) / scale).abs();
                Some(2.0 * (self.threshold / u).min(1.0) / (scale * scale))
            }
        }
    }

    /// Of the relative L2 and the Huber loss: the square of what differences are compared to.
    fn square_of_relative(&self, level: f64, noise: f64) -> f64 {
        level * level + self.epsilon * self.epsilon + noise * noise
    }

    fn mean(&self, view: usize, pixel: usize, target: &Target) -> DVec3 {
        let means = self.means.get(view).filter(|means| means.len() == target.pixels.len());
        means.map_or(target.pixels[pixel], |means| means[pixel])
    }
}

/// The standard deviation of a target's noise over [`EXPLAINED`], where the target is such around a pixel: added to what a difference is relative
/// to, squares to squares, it gives weights in inverse proportion to the variance of noise and model together.
fn allowance(target: &Target, mean: f64) -> f64 {
    target.noise.map_or(0.0, |noise| noise.variance(mean).sqrt() / EXPLAINED)
}

/// Local means of targets, if a loss is relative to them.
fn means_of(kind: LossKind, targets: &[Target]) -> Vec<Vec<DVec3>> {
    match kind {
        LossKind::Huber => parallel::map(targets, local_means),
        _ => Vec::new(),
    }
}

/// Means of a target over the squares around its pixels, of those that count, without the pixel itself: its noise would make it count the less
/// the brighter it happens to be, and fits too dark.
fn local_means(target: &Target) -> Vec<DVec3> {
    let (width, height) = (target.camera.width as usize, target.camera.height as usize);
    let around = |at: usize, end: usize| at.saturating_sub(REACH)..(at + REACH + 1).min(end);
    let mean = |at: usize| {
        let (mut sum, mut weight) = (DVec3::ZERO, 0.0);
        for row in around(at / width, height) {
            for column in around(at % width, width) {
                let near = row * width + column;
                let counts = target.mask_at(near);
                if counts > 0.0 && near != at {
                    sum += counts * target.pixels[near];
                    weight += counts;
                }
            }
        }
        if weight > 0.0 { sum / weight } else { DVec3::ZERO }
    };
    (0..width * height).map(mean).collect()
}

impl PictureLoss for Loss {
    fn of_targets(&self, targets: &[Target]) -> Option<Box<dyn PictureLoss + Send + Sync>> {
        Some(Box::new(Self { means: means_of(self.kind, targets), ..*self }))
    }

    fn evaluate(&self, view: usize, picture: &[DVec3], target: &Target) -> (f64, Vec<DVec3>) {
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
                let mean = self.mean(view, at, target);
                let channels = [0, 1, 2].map(|c| match target.keeps_bound(at, value[c], expected[c]) {
                    true => (0.0, 0.0),
                    false => self.channel(value[c], expected[c], mean[c], allowance(target, mean[c])),
                });
                sum += weight * channels.iter().map(|(value, _)| value).sum::<f64>();
                weight * DVec3::from(channels.map(|(_, derivative)| derivative))
            })
            .collect();
        (sum, gradient)
    }

    fn curvature(&self, view: usize, picture: &[DVec3], target: &Target) -> Option<Vec<DVec3>> {
        let norm = 1.0 / (3.0 * target.mask_sum());
        let pixel = |(at, (value, expected)): (usize, (&DVec3, &DVec3))| {
            let weight = norm * target.mask_at(at);
            if weight == 0.0 {
                return Some(DVec3::ZERO);
            }
            let mean = self.mean(view, at, target);
            let mut curvature = DVec3::ZERO;
            for c in 0..3 {
                if !target.keeps_bound(at, value[c], expected[c]) {
                    let noise = allowance(target, mean[c]);
                    curvature[c] = weight * self.channel_curvature(value[c], expected[c], mean[c], noise)?;
                }
            }
            Some(curvature)
        };
        picture.iter().zip(&target.pixels).enumerate().map(pixel).collect()
    }

    fn is_quadratic(&self) -> bool {
        matches!(self.kind, LossKind::L2 | LossKind::RelativeL2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::noise::Noise;
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

    const KINDS: [LossKind; 5] =
        [LossKind::L1, LossKind::L2, LossKind::RelativeL2, LossKind::LogL1, LossKind::Huber];

    #[test]
    fn gradients_are_those_of_finite_differences() {
        let n = 12;
        let mask: Vec<f64> = (0..n).map(|i| (i % 4) as f64 / 3.0).collect();
        let noise = Noise { shot: 0.02, read: 0.1 };
        for (mask, noise) in [(None, None), (Some(mask), None), (None, Some(noise))] {
            let target = Target { noise, ..target(wave(n, 0.3), mask) };
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
        let loss = Loss::new(LossKind::L2, std::slice::from_ref(&masked));
        let picture = [DVec3::ONE, DVec3::splat(2.0), DVec3::splat(9.0)];
        let (value, gradient) = loss.evaluate(0, &picture, &masked);
        assert_eq!(value, (1.0 + 0.5 * 4.0) / 1.5);
        assert_eq!(gradient[2], DVec3::ZERO);
        assert!(Loss::new(LossKind::L2, std::slice::from_ref(&masked)).epsilon.is_finite());
    }

    #[test]
    fn curvature_is_the_change_of_the_gradient() {
        let target = target(wave(6, 0.3), Some(vec![1.0, 0.2, 1.0, 0.0, 1.0, 1.0]));
        let target = target.noisy(Noise { shot: 0.02, read: 0.1 });
        for kind in KINDS {
            let loss = Loss { threshold: 0.1, ..Loss::new(kind, std::slice::from_ref(&target)) };
            let (a, b) = (wave(6, 0.1), wave(6, 1.9));
            let Some(curvature) = loss.curvature(0, &a, &target) else {
                assert!(matches!(kind, LossKind::L1 | LossKind::LogL1));
                continue;
            };
            let ((at_a, ga), (at_b, gb)) = (loss.evaluate(0, &a, &target), loss.evaluate(0, &b, &target));
            if loss.is_quadratic() {
                for i in 0..6 {
                    assert!((gb[i] - ga[i] - curvature[i] * (b[i] - a[i])).abs().max_element() < 1e-12);
                }
            } else {
                // The parabola lies above the loss.
                let along = |i: usize| {
                    let way = b[i] - a[i];
                    ga[i].dot(way) + 0.5 * (curvature[i] * way).dot(way)
                };
                let parabola: f64 = at_a + (0..6).map(along).sum::<f64>();
                assert!(at_b <= parabola * (1.0 + 1e-12), "{at_b} {parabola}");
            }
        }
    }

    /// Noise of a target and outliers move the minimum of the Huber loss less than that of the relative one.
    #[test]
    fn outliers_and_noise_hardly_move_the_huber_loss() {
        let noise = |i: usize| 0.3 * (1.7 * i as f64).sin();
        let pixels: Vec<DVec3> =
            (0..400).map(|i| DVec3::splat(if i % 40 == 0 { 30.0 } else { 1.0 + noise(i) })).collect();
        let mut camera = Camera::framing(&[]);
        (camera.width, camera.height) = (20, 20);
        let target = Target::new(camera, pixels, None, 1.0).expect("a target");
        let best = |kind| {
            let mut loss = Loss::new(kind, std::slice::from_ref(&target));
            (loss.epsilon, loss.threshold) = (0.01, 0.3);
            let at = |v: f64| loss.evaluate(0, &vec![DVec3::splat(v); 400], &target).0;
            (0..300)
                .map(|k| 0.5 + 0.005 * f64::from(k))
                .min_by(|a, b| at(*a).total_cmp(&at(*b)))
                .unwrap_or(0.0)
        };
        assert!((best(LossKind::Huber) - 1.0).abs() <= 0.03, "{}", best(LossKind::Huber));
        assert!((best(LossKind::RelativeL2) - 1.0).abs() > 0.05, "{}", best(LossKind::RelativeL2));
    }

    /// Two pictures of a constant, one of which has a hundred times the noise of the other. Where noise is stated, the estimate that
    /// minimises the loss is nearer the truth.
    #[test]
    fn noise_decides_what_pixels_count() {
        const SIDE: usize = 20;
        // Uniform in [0, 1), as far as it matters.
        let random = |at: usize| ((12.9898 * (at + 1) as f64).sin() * 43758.5453).rem_euclid(1.0);
        let mut camera = Camera::framing(&[]);
        (camera.width, camera.height) = (SIDE as u32, SIDE as u32);
        let noise = |read| Noise { shot: 0.0, read };
        let mut errors = [LossKind::Huber, LossKind::RelativeL2].map(|kind| (kind, [0.0; 2]));
        for picture in 0..20 {
            let view = |first: usize, read: f64| {
                let deviate = |at: usize| 12.0_f64.sqrt() * read * (random(first + at) - 0.5);
                let pixels = (0..SIDE * SIDE).map(|at| DVec3::splat(1.0 + deviate(at))).collect();
                Target::new(camera.clone(), pixels, None, 1.0).expect("a target").noisy(noise(read))
            };
            let first = 2 * picture * SIDE * SIDE;
            let known = [view(first, 0.02), view(first + SIDE * SIDE, 2.0)];
            let unknown = known.clone().map(|target| Target { noise: None, ..target });
            for (kind, errors) in &mut errors {
                for (targets, error) in [&unknown, &known].into_iter().zip(errors) {
                    *error += (estimate(*kind, targets) - 1.0).powi(2);
                }
            }
        }
        for (kind, [unknown, known]) in errors {
            println!("{kind:?}: {unknown:e}, with noise stated {known:e}");
            assert!(known < 0.1 * unknown, "{kind:?}: {known} {unknown}");
        }
    }

    /// The constant that minimises the loss of some targets, by Newton's method.
    fn estimate(kind: LossKind, targets: &[Target]) -> f64 {
        let loss = Loss { threshold: 100.0, ..Loss::new(kind, targets) };
        let mut value = 1.0;
        for _ in 0..3 {
            let (mut slope, mut curvature) = (0.0, 0.0);
            for (view, target) in targets.iter().enumerate() {
                let picture = vec![DVec3::splat(value); target.pixels.len()];
                slope +=
                    loss.evaluate(view, &picture, target).1.iter().map(|by| by.element_sum()).sum::<f64>();
                let curvatures = loss.curvature(view, &picture, target).expect("a smooth loss");
                curvature += curvatures.iter().map(|by| by.element_sum()).sum::<f64>();
            }
            value -= slope / curvature;
        }
        value
    }

    #[test]
    fn what_is_brighter_than_a_lower_bound_costs_nothing() {
        let bound = target(vec![DVec3::new(1.0, 0.5, 1.0)], None).clipped_from(0.99);
        for kind in KINDS {
            let loss = Loss::new(kind, std::slice::from_ref(&bound));
            let (value, gradient) = loss.evaluate(0, &[DVec3::new(7.0, 0.5, 1.0)], &bound);
            assert_eq!((value, gradient[0]), (0.0, DVec3::ZERO), "{kind:?}");
            let (value, gradient) = loss.evaluate(0, &[DVec3::new(0.3, 0.5, 1.0)], &bound);
            assert!(value > 0.0 && gradient[0].x < 0.0 && gradient[0].y == 0.0, "{kind:?}");
        }
    }
}
