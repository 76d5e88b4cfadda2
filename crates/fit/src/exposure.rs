//! Exposure and white balance of photos: unknown factors between radiance and the numbers of a picture.
//!
//! The gains are projected out (Golub and Pereyra 1973): for each set of pictures they minimise the loss, so that the objective
//! depends on the scene alone. Since they are a minimum, its derivative is that with gains held fixed.

use super::loss::PictureLoss;
use super::median::median;
use super::target::Target;
use glam::DVec3;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// What of the factors between radiance and the numbers of a picture is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exposure {
    /// A factor for all channels.
    pub gain: bool,
    /// Factors of red and blue relative to green.
    pub white_balance: bool,
    /// Pictures with the same number share their factors.
    pub shared: Option<u32>,
}

impl Exposure {
    /// A factor for each picture, the same in all channels.
    pub const GAIN: Self = Self { gain: true, white_balance: false, shared: None };
    /// A factor for each picture and channel.
    pub const GAIN_AND_WHITE_BALANCE: Self = Self { gain: true, white_balance: true, shared: None };

    /// Whether anything is unknown.
    pub fn is_fitted(self) -> bool {
        self.gain || self.white_balance
    }

    /// Sums over the channels that have one factor, in all of these.
    fn joined(self, by_channel: DVec3) -> DVec3 {
        match (self.gain, self.white_balance) {
            (true, true) => by_channel,
            (true, false) => DVec3::splat(by_channel.element_sum()),
            (false, true) => DVec3::new(by_channel.x, 0.0, by_channel.z),
            (false, false) => DVec3::ZERO,
        }
    }
}

/// Relative change of a gain at which it is found, and most steps.
const FOUND: f64 = 1e-8;
const STEPS: usize = 60;

/// The gains of each picture, per channel: those that minimise the loss, or 1 where nothing is unknown. `None` if the loss is not
/// smooth.
pub fn gains(
    targets: &[Target],
    pictures: &[Vec<DVec3>],
    loss: &(dyn PictureLoss + Sync),
) -> Option<Vec<DVec3>> {
    let mut gains = vec![DVec3::ONE; targets.len()];
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for (view, target) in targets.iter().enumerate().filter(|(_, target)| target.exposure.is_fitted()) {
        let same = |group: &&mut Vec<usize>| {
            target.exposure.shared.is_some()
                && group.first().is_some_and(|&first| targets[first].exposure == target.exposure)
        };
        match groups.iter_mut().find(same) {
            Some(group) => group.push(view),
            None => groups.push(vec![view]),
        }
    }
    let found: Option<Vec<DVec3>> =
        groups.par_iter().map(|views| shared_gain(views, targets, pictures, loss)).collect();
    for (views, gain) in groups.iter().zip(found?) {
        views.iter().for_each(|&view| gains[view] = gain);
    }
    Some(gains)
}

/// The gain of some views, by steps to the minimum of a parabola that touches the loss and lies above it.
fn shared_gain(
    views: &[usize],
    targets: &[Target],
    pictures: &[Vec<DVec3>],
    loss: &(dyn PictureLoss + Sync),
) -> Option<DVec3> {
    let exposure = targets[*views.first()?].exposure;
    let mut gain = first_guess(views, targets, pictures, exposure);
    for _ in 0..STEPS {
        let (mut slope, mut curvature) = (DVec3::ZERO, DVec3::ZERO);
        for &view in views {
            let (picture, target) = (&pictures[view], &targets[view]);
            let exposed: Vec<DVec3> = picture.iter().map(|radiance| gain * radiance).collect();
            let (_, by_pixels) = loss.evaluate(view, &exposed, target);
            let curvatures = loss.curvature(view, &exposed, target)?;
            for ((radiance, by), second) in picture.iter().zip(by_pixels).zip(curvatures) {
                slope += target.weight * by * radiance;
                curvature += target.weight * second * radiance * radiance;
            }
        }
        let (slope, curvature) = (exposure.joined(slope), exposure.joined(curvature));
        // Nothing is known of a channel that is dark or clipped all over.
        let step = DVec3::select(curvature.cmpgt(DVec3::ZERO), slope / curvature, DVec3::ZERO);
        let next = (gain - step).max(0.1 * gain);
        let done = (next - gain).abs().cmple(FOUND * gain).all();
        gain = next;
        if done {
            break;
        }
    }
    Some(gain)
}

/// Medians of the ratios of pixels; 1 where there are none.
fn first_guess(views: &[usize], targets: &[Target], pictures: &[Vec<DVec3>], exposure: Exposure) -> DVec3 {
    let ratio = |channels: &[usize]| {
        let mut ratios = Vec::new();
        for &view in views {
            let target = &targets[view];
            for (at, (value, radiance)) in target.pixels.iter().zip(&pictures[view]).enumerate() {
                let counts = target.mask_at(at) > 0.0;
                for &c in channels.iter().filter(|_| counts) {
                    if !target.is_bound(at, value[c]) && value[c] > 0.0 && radiance[c] > 0.0 {
                        ratios.push(value[c] / radiance[c]);
                    }
                }
            }
        }
        median(ratios).unwrap_or(1.0)
    };
    match (exposure.gain, exposure.white_balance) {
        (true, true) => DVec3::new(ratio(&[0]), ratio(&[1]), ratio(&[2])),
        (true, false) => DVec3::splat(ratio(&[0, 1, 2])),
        (false, true) => DVec3::new(ratio(&[0]), 1.0, ratio(&[2])),
        (false, false) => DVec3::ONE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::loss::{Loss, LossKind};
    use antirad_scene::Camera;

    fn radiance(view: usize) -> Vec<DVec3> {
        let value = |i: usize, c: usize| 1.2 + ((view + 1) as f64 * i as f64 * 0.7 + c as f64).sin();
        (0..64).map(|i| DVec3::new(value(i, 0), value(i, 1), value(i, 2))).collect()
    }

    fn photo(view: usize, gain: DVec3, exposure: Exposure) -> Target {
        let camera = Camera { width: 8, height: 8, ..Camera::framing(&[]) };
        let pixels = radiance(view).iter().map(|r| (gain * r).min(DVec3::splat(2.0))).collect();
        Target::new(camera, pixels, None, 1.0).expect("a target").clipped_from(2.0).exposed(exposure)
    }

    #[test]
    fn gains_are_found_where_pictures_are_clipped() {
        let truth = [DVec3::new(0.5, 0.7, 1.1), DVec3::splat(1.3), DVec3::new(1.2, 1.0, 0.8), DVec3::ONE];
        let of_red_and_blue = Exposure { gain: false, white_balance: true, shared: None };
        let exposures =
            [Exposure::GAIN_AND_WHITE_BALANCE, Exposure::GAIN, of_red_and_blue, Exposure::default()];
        let targets: Vec<Target> = (0..4).map(|k| photo(k, truth[k], exposures[k])).collect();
        let pictures: Vec<Vec<DVec3>> = (0..4).map(radiance).collect();
        for kind in [LossKind::L2, LossKind::RelativeL2, LossKind::Huber] {
            let found = gains(&targets, &pictures, &Loss::new(kind, &targets)).expect("smooth");
            for (found, truth) in found.iter().zip(truth) {
                assert!(found.abs_diff_eq(truth, 1e-6), "{kind:?}: {found} {truth}");
            }
        }
        assert!(gains(&targets, &pictures, &Loss::new(LossKind::L1, &targets)).is_none());
    }

    /// The derivative of the loss by a gain vanishes, with outliers, and for pictures that share it.
    #[test]
    fn shared_gains_are_a_minimum() {
        let exposure = Exposure { shared: Some(3), ..Exposure::GAIN };
        let mut targets: Vec<Target> = (0..3).map(|k| photo(k, DVec3::splat(0.4), exposure)).collect();
        targets[1].pixels.iter_mut().step_by(9).for_each(|p| *p = DVec3::splat(1.9));
        let pictures: Vec<Vec<DVec3>> = (0..3).map(radiance).collect();
        let loss = Loss::new(LossKind::Huber, &targets);
        let found = gains(&targets, &pictures, &loss).expect("smooth");
        assert!(found[0] == found[1] && found[1] == found[2], "{found:?}");
        let at = |gain: f64| {
            let exposed = |k: usize| pictures[k].iter().map(|r| gain * r).collect::<Vec<_>>();
            (0..3).map(|k| loss.evaluate(k, &exposed(k), &targets[k]).0).sum::<f64>()
        };
        let best = at(found[0].x);
        assert!(best < at(found[0].x * 1.0001) && best < at(found[0].x * 0.9999), "{found:?}");
        assert!((found[0].x - 0.4).abs() < 0.03, "{found:?}");
    }

    #[test]
    fn black_pictures_have_some_gain() {
        let targets = [photo(0, DVec3::ONE, Exposure::GAIN)];
        let loss = Loss::new(LossKind::Huber, &targets);
        let found = gains(&targets, &[vec![DVec3::ZERO; 64]], &loss).expect("smooth");
        assert_eq!(found, [DVec3::ONE]);
    }
}
