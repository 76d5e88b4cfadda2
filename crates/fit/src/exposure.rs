//! Exposure, white balance and response of photos: what is unknown between radiance and the numbers of a picture.
//!
//! All of it is projected out (Golub and Pereyra 1973): gains and responses minimise the loss for the pictures that there are, so that the
//! objective depends on the scene alone. Since they are a minimum, its derivative is that with them held fixed.

use super::loss::PictureLoss;
use super::median::median;
use super::response::{ByRise, RISES, ResponseCurve};
use super::target::Target;
use antirad_base::parallel;
use glam::DVec3;
use nalgebra::SMatrix;
use serde::{Deserialize, Serialize};

/// What of the factors between radiance and the numbers of a picture is unknown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Exposure {
    /// A factor for all channels.
    #[doc(hidden)]
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
    #[doc(hidden)]
    pub fn is_fitted(self) -> bool {
        self.gain || self.white_balance
    }

    /// The channels that each unknown factor acts on.
    fn unknowns(self) -> &'static [DVec3] {
        match (self.gain, self.white_balance) {
            (true, true) => &DVec3::AXES,
            (true, false) => &[DVec3::ONE],
            (false, true) => &[DVec3::X, DVec3::Z],
            (false, false) => &[],
        }
    }
}

/// How a camera makes the numbers of a picture from radiance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensor {
    /// Factors of radiance, per channel; 1 where exposure is known.
    pub gain: DVec3,
    /// The response, if it was unknown.
    pub curve: Option<ResponseCurve>,
    /// Radiance of white at a gain of 1, W/(m² sr).
    pub white: f64,
}

impl Sensor {
    /// One that shows radiance as it is, or by a response like that of sRGB where it is unknown.
    pub fn usual(target: &Target) -> Self {
        let curve = target.response.map(|_| ResponseCurve::default());
        Self { gain: DVec3::ONE, curve, white: target.response.map_or(1.0, |response| response.white) }
    }

    /// Whether the numbers are the radiance.
    pub(super) fn is_identity(&self) -> bool {
        self.gain == DVec3::ONE && self.curve.is_none()
    }

    /// A picture, W/(m² sr), in the numbers of its target.
    pub fn numbers(&self, picture: &[DVec3]) -> Vec<DVec3> {
        let exposed = picture.iter().map(|radiance| self.gain * radiance);
        let Some(rising) = self.curve.map(|curve| curve.rising()) else { return exposed.collect() };
        exposed.map(|light| light.map(|light| self.white * rising.at(light / self.white).value)).collect()
    }

    /// Derivatives of the numbers by radiance.
    pub(super) fn slopes(&self, picture: &[DVec3]) -> Vec<DVec3> {
        let Some(rising) = self.curve.map(|curve| curve.rising()) else {
            return vec![self.gain; picture.len()];
        };
        let slope = |radiance: &DVec3| {
            self.gain * (self.gain * radiance).map(|light| rising.at(light / self.white).slope)
        };
        picture.iter().map(slope).collect()
    }
}

/// The loss of being unlike sRGB, for each curve: what pictures tell of a curve outweighs it by far.
const UNLIKE_SRGB: f64 = 1e-5;

/// Curves that were found, each with its views.
pub fn curves(targets: &[Target], sensors: &[Sensor]) -> Vec<(ResponseCurve, Vec<usize>)> {
    let unknown = (0..targets.len()).filter(|&view| targets[view].response.is_some());
    let cameras = grouped(unknown, |a, b| targets[a].response == targets[b].response);
    let curve = |views: Vec<usize>| Some((sensors[*views.first()?].curve?, views));
    cameras.into_iter().filter_map(curve).collect()
}

/// The part of the objective by which responses stay near sRGB where pictures leave them open; `None` without responses.
pub fn unlike_srgb(targets: &[Target], sensors: &[Sensor]) -> Option<f64> {
    let curves = curves(targets, sensors);
    let sum = curves.iter().map(|(curve, _)| UNLIKE_SRGB * curve.departure()).sum();
    (!curves.is_empty()).then_some(sum)
}

/// Relative change of a gain, and change of a curve, at which they are found; most steps, and most halvings of one.
const FOUND: f64 = 1e-8;
const STEPS: usize = 60;
const HALVINGS: i32 = 10;
/// Relative error of a loss by rounding.
const ROUNDING: f64 = 1e-12;

/// Gains and responses of each view: those that minimise the loss, with [`unlike_srgb`]. `None` if the loss is not smooth.
pub fn sensors(
    targets: &[Target],
    pictures: &[Vec<DVec3>],
    loss: &(dyn PictureLoss + Sync),
) -> Option<Vec<Sensor>> {
    let mut sensors: Vec<Sensor> = targets.iter().map(Sensor::usual).collect();
    let same_gain = |a: usize, b: usize| {
        let [a, b] = [a, b].map(|view| targets[view].exposure);
        a.shared.is_some() && a == b
    };
    let same_camera = |a: usize, b: usize| match [a, b].map(|view| targets[view].response) {
        [None, None] => same_gain(a, b),
        [of_a, of_b] => of_a == of_b,
    };
    let is_open = |target: &Target| target.exposure.is_fitted() || target.response.is_some();
    let open = (0..targets.len()).filter(|&view| is_open(&targets[view]));
    let cameras: Vec<Camera> = grouped(open, same_camera)
        .into_iter()
        .map(|views| Camera { gains: grouped(views.into_iter(), same_gain), targets, pictures, loss })
        .collect();
    let found: Option<Vec<_>> = parallel::map(&cameras, Camera::found).into_iter().collect();
    for (view, sensor) in found?.into_iter().flatten() {
        sensors[view] = sensor;
    }
    Some(sensors)
}

/// Views in groups of the same kind as their first.
fn grouped(views: impl Iterator<Item = usize>, same: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for view in views {
        match groups.iter_mut().find(|group| group.first().is_some_and(|&first| same(first, view))) {
            Some(group) => group.push(view),
            None => groups.push(vec![view]),
        }
    }
    groups
}

/// Views with one response, in groups that share their gains.
struct Camera<'a> {
    gains: Vec<Vec<usize>>,
    targets: &'a [Target],
    pictures: &'a [Vec<DVec3>],
    loss: &'a (dyn PictureLoss + Sync),
}

/// A parabola by the gains of a group and the response that touches the loss; where the response is known, it lies above the loss.
#[derive(Clone, Copy, Default)]
struct Parabola {
    value: f64,
    by_gain: DVec3,
    by_gain_twice: DVec3,
    by_curve: ByRise,
    by_both: [ByRise; 3],
    by_curve_twice: SMatrix<f64, RISES, RISES>,
}

impl Parabola {
    fn add(&mut self, more: &Self) {
        self.value += more.value;
        self.by_gain += more.by_gain;
        self.by_gain_twice += more.by_gain_twice;
        self.by_curve += more.by_curve;
        self.by_both.iter_mut().zip(more.by_both).for_each(|(to, more)| *to += more);
        self.by_curve_twice += more.by_curve_twice;
    }

    /// The derivatives by a factor on some channels: once, twice, and once by the curve.
    fn along(&self, channels: DVec3) -> (f64, f64, ByRise) {
        let by_both = (0..3).map(|c| self.by_both[c] * channels[c]).sum();
        (channels.dot(self.by_gain), channels.dot(self.by_gain_twice), by_both)
    }
}

impl Camera<'_> {
    /// The sensor of each view, by steps to the minimum of parabolas (Gauss-Newton), halved until the loss falls.
    fn found(&self) -> Option<Vec<(usize, Sensor)>> {
        let mut sensors: Vec<Sensor> = self.gains.iter().map(|views| self.first_guess(views)).collect();
        let mut here = self.parabolas(&sensors)?;
        for _ in 0..STEPS {
            let steps = self.steps(&sensors, &here);
            let moved = |part: f64| -> Vec<Sensor> {
                sensors.iter().zip(&steps).map(|(sensor, step)| sensor.moved(step, part)).collect()
            };
            if sensors.iter().zip(&steps).all(|(sensor, (gain, curve))| {
                gain.abs().cmple(FOUND * sensor.gain).all() && curve.amax() <= FOUND
            }) {
                sensors = moved(1.0);
                break;
            }
            let value = self.value(&sensors, &here);
            let lower = (0..HALVINGS).find_map(|halvings| {
                let next = moved(0.5_f64.powi(halvings));
                let there = self.parabolas(&next)?;
                let falls = self.value(&next, &there) <= value + ROUNDING * value.abs();
                falls.then_some((next, there))
            });
            let Some(lower) = lower else { break };
            (sensors, here) = lower;
        }
        let of_views = self.gains.iter().zip(sensors);
        Some(of_views.flat_map(|(views, sensor)| views.iter().map(move |&view| (view, sensor))).collect())
    }

    fn parabolas(&self, sensors: &[Sensor]) -> Option<Vec<Parabola>> {
        let of_group = |(views, sensor): (&Vec<usize>, &Sensor)| {
            let of_views: Option<Vec<Parabola>> =
                parallel::map(views, |&view| self.parabola(view, sensor)).into_iter().collect();
            let mut sum = Parabola::default();
            of_views?.iter().for_each(|more| sum.add(more));
            Some(sum)
        };
        parallel::map(self.gains.iter().zip(sensors), of_group).into_iter().collect()
    }

    fn parabola(&self, view: usize, sensor: &Sensor) -> Option<Parabola> {
        let (picture, target) = (&self.pictures[view], &self.targets[view]);
        let numbers = sensor.numbers(picture);
        let (value, first) = self.loss.evaluate(view, &numbers, target);
        let second = self.loss.curvature(view, &numbers, target)?;
        let mut sum = Parabola { value: target.weight * value, ..Parabola::default() };
        let rising = sensor.curve.map(|curve| curve.rising());
        for ((radiance, first), second) in picture.iter().zip(first).zip(second) {
            let (first, second) = (target.weight * first, target.weight * second);
            let Some(rising) = &rising else {
                sum.by_gain += first * radiance;
                sum.by_gain_twice += second * radiance * radiance;
                continue;
            };
            for c in 0..3 {
                let at = rising.at(sensor.gain[c] * radiance[c] / sensor.white);
                let (by_gain, by_curve) = (at.slope * radiance[c], at.by_rise * sensor.white);
                sum.by_gain[c] += first[c] * by_gain;
                sum.by_gain_twice[c] += second[c] * by_gain * by_gain;
                sum.by_curve += by_curve * first[c];
                sum.by_both[c] += by_curve * (second[c] * by_gain);
                sum.by_curve_twice.ger(second[c], &by_curve, &by_curve, 1.0);
            }
        }
        Some(sum)
    }

    /// What is minimised: the sum of the weighted losses of these views, and the prior of their curve in that unit.
    fn value(&self, sensors: &[Sensor], parabolas: &[Parabola]) -> f64 {
        let curve = sensors.first().and_then(|sensor| sensor.curve).unwrap_or_default();
        parabolas.iter().map(|parabola| parabola.value).sum::<f64>() + self.prior() * curve.departure()
    }

    fn prior(&self) -> f64 {
        UNLIKE_SRGB * self.targets.iter().map(|target| target.weight).sum::<f64>()
    }

    /// Changes of gains and curve to the minimum of the parabolas. Gains are eliminated from the equations, as each has its own.
    fn steps(&self, sensors: &[Sensor], parabolas: &[Parabola]) -> Vec<(DVec3, ByRise)> {
        let unknowns = |group: &Vec<usize>| {
            group.first().map_or(&[][..], |&view| self.targets[view].exposure.unknowns())
        };
        let curve = match sensors.first().and_then(|sensor| sensor.curve) {
            Some(curve) => {
                let mut by_curve = ByRise::from(curve.logarithms) * (2.0 * self.prior());
                let mut twice = SMatrix::from_diagonal_element(2.0 * self.prior());
                for (group, parabola) in self.gains.iter().zip(parabolas) {
                    by_curve += parabola.by_curve;
                    twice += parabola.by_curve_twice;
                    for (once, squared, both) in unknowns(group).iter().map(|c| parabola.along(*c)) {
                        if squared > 0.0 {
                            by_curve -= both * (once / squared);
                            twice.ger(-1.0 / squared, &both, &both, 1.0);
                        }
                    }
                }
                twice.cholesky().map_or_else(ByRise::zeros, |twice| -twice.solve(&by_curve))
            }
            None => ByRise::zeros(),
        };
        let of_group = |(group, parabola): (&Vec<usize>, &Parabola)| {
            let mut gain = DVec3::ZERO;
            for &channels in unknowns(group) {
                let (once, squared, both) = parabola.along(channels);
                // Nothing is known of a channel that is dark or clipped all over.
                if squared > 0.0 {
                    gain -= channels * ((once + both.dot(&curve)) / squared);
                }
            }
            (gain, curve)
        };
        self.gains.iter().zip(parabolas).map(of_group).collect()
    }

    /// A gain from medians of the ratios of pixels, and the usual response.
    fn first_guess(&self, views: &[usize]) -> Sensor {
        let Some(target) = views.first().map(|&view| &self.targets[view]) else {
            return Sensor { gain: DVec3::ONE, curve: None, white: 1.0 };
        };
        Sensor {
            gain: first_guess(views, self.targets, self.pictures, target.exposure),
            ..Sensor::usual(target)
        }
    }
}

impl Sensor {
    /// This one after a part of a step; a gain stays above a tenth of what it was.
    fn moved(&self, (gain, curve): &(DVec3, ByRise), part: f64) -> Self {
        let moved = |of: ResponseCurve| ResponseCurve {
            logarithms: (ByRise::from(of.logarithms) + curve * part).into(),
        };
        Self {
            gain: (self.gain + part * *gain).max(0.1 * self.gain),
            curve: self.curve.map(moved),
            white: self.white,
        }
    }
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
            let found = sensors(&targets, &pictures, &Loss::new(kind, &targets)).expect("smooth");
            for (found, truth) in found.iter().zip(truth) {
                assert!(found.gain.abs_diff_eq(truth, 1e-6), "{kind:?}: {} {truth}", found.gain);
            }
        }
        assert!(sensors(&targets, &pictures, &Loss::new(LossKind::L1, &targets)).is_none());
    }

    /// The derivative of the loss by a gain vanishes, with outliers, and for pictures that share it.
    #[test]
    fn shared_gains_are_a_minimum() {
        let exposure = Exposure { shared: Some(3), ..Exposure::GAIN };
        let mut targets: Vec<Target> = (0..3).map(|k| photo(k, DVec3::splat(0.4), exposure)).collect();
        targets[1].pixels.iter_mut().step_by(9).for_each(|p| *p = DVec3::splat(1.9));
        let pictures: Vec<Vec<DVec3>> = (0..3).map(radiance).collect();
        let loss = Loss::new(LossKind::Huber, &targets);
        let found: Vec<DVec3> =
            sensors(&targets, &pictures, &loss).expect("smooth").iter().map(|sensor| sensor.gain).collect();
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
        let found = sensors(&targets, &[vec![DVec3::ZERO; 64]], &loss).expect("smooth");
        assert_eq!(found[0].gain, DVec3::ONE);
    }
}
