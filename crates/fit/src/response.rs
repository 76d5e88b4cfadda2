//! Responses of cameras: from exposure, which is proportional to radiance, to the numbers of a picture.

use nalgebra::SVector;
use serde::{Deserialize, Serialize};

/// How the numbers of an integer format follow from exposure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Response {
    /// By the curve of sRGB.
    #[default]
    Srgb,
    /// In proportion.
    Linear,
    /// Exposure to the power of one over this.
    Gamma(f64),
    /// By a [`ResponseCurve`] that is found with the scene.
    Fit,
}

impl Response {
    /// Exposure, of that of white, from what decoding by sRGB gives.
    pub(super) fn light_of(self, decoded: f64) -> f64 {
        let number = || antirad_scene::srgb_from_linear(decoded);
        match self {
            Self::Srgb | Self::Fit => decoded,
            Self::Linear => number(),
            Self::Gamma(gamma) => number().powf(gamma),
        }
    }
}

/// A response of a target that is to be found.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnknownResponse {
    /// Radiance of white at a gain of 1, W/(m² sr).
    pub white: f64,
    /// Targets with the same number share their curve.
    pub shared: u32,
}

/// Pieces that a curve rises by.
pub(super) const RISES: usize = 6;

/// One number for each rise.
pub(super) type ByRise = SVector<f64, RISES>;

/// A response as it differs from that of sRGB: from exposure x to what decoding the picture by sRGB gives, both 1 for white.
///
/// The curve is T(√x)², with T a Bernstein polynomial of degree 6 from T(0) = 0 to T(1) = 1. Its coefficients rise by the softmax of six
/// numbers, so that it is monotone for any of them; where all are the same, it is x. Beyond black and white it goes on as a line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ResponseCurve {
    /// Logarithms of the rises, up to a sum.
    pub logarithms: [f64; RISES],
}

/// A curve at some exposure.
#[derive(Clone, Copy, Debug)]
pub(super) struct At {
    pub value: f64,
    /// By exposure.
    pub slope: f64,
    /// By the logarithms of the rises.
    pub by_rise: ByRise,
}

/// A curve with its rises, ready to be evaluated.
#[derive(Clone, Copy, Debug)]
pub(super) struct Rising {
    rises: ByRise,
}

impl ResponseCurve {
    /// The value at an exposure of that of white.
    pub fn value(&self, exposure: f64) -> f64 {
        self.rising().at(exposure).value
    }

    pub(super) fn rising(&self) -> Rising {
        let logarithms = ByRise::from(self.logarithms);
        let rises = logarithms.map(|z| (z - logarithms.max()).exp());
        Rising { rises: rises / rises.sum() }
    }

    /// The squared distance from sRGB, which has no other meaning.
    pub(super) fn departure(&self) -> f64 {
        ByRise::from(self.logarithms).norm_squared()
    }

    /// Numbers in the picture against those that sRGB would have there, both of 0 to 1, at even steps of the latter.
    pub fn table(&self, steps: u32) -> Vec<[f64; 2]> {
        let encoded = |k: u32| {
            let usual = f64::from(k) / f64::from(steps.max(1));
            let value = self.value(antirad_scene::linear_from_srgb(usual));
            [usual, antirad_scene::srgb_from_linear(value)]
        };
        (0..=steps).map(encoded).collect()
    }
}

impl Rising {
    /// The curve at an exposure of that of white, which may be below black.
    pub fn at(&self, exposure: f64) -> At {
        let n = RISES as f64;
        let (first, last) = (self.rises[0], self.rises[RISES - 1]);
        // What a rise takes from all others as it grows.
        let alone = |k: usize| ByRise::from_fn(|j, _| f64::from(u8::from(j == k)) - self.rises[j]);
        if exposure <= 0.0 {
            let slope = (n * first).powi(2);
            return At { value: slope * exposure, slope, by_rise: alone(0) * (2.0 * slope * exposure) };
        }
        if exposure >= 1.0 {
            let (slope, beyond) = (n * last, exposure - 1.0);
            let by_rise = alone(RISES - 1) * (slope * beyond);
            return At { value: 1.0 + slope * beyond, slope, by_rise };
        }
        let root = exposure.sqrt();
        let (basis, reached) = bernstein(root);
        let (t, slope) = (self.rises.dot(&reached), n * self.rises.dot(&basis));
        let by_rise = self.rises.component_mul(&reached.add_scalar(-t));
        At { value: t * t, slope: t * slope / root, by_rise: by_rise * (2.0 * t) }
    }
}

/// The Bernstein polynomials of degree `RISES` - 1 at a place of 0 to 1, and the share of each rise that lies below it: sums of those of
/// degree `RISES`, from the one after the rise on.
fn bernstein(at: f64) -> (ByRise, ByRise) {
    let raise = |of: &mut [f64], degree: usize| {
        of[degree] = at * of[degree - 1];
        for k in (1..degree).rev() {
            of[k] = (1.0 - at) * of[k] + at * of[k - 1];
        }
        of[0] *= 1.0 - at;
    };
    let mut all = [0.0; RISES + 1];
    all[0] = 1.0;
    (1..RISES).for_each(|degree| raise(&mut all, degree));
    let basis = ByRise::from_fn(|k, _| all[k]);
    raise(&mut all, RISES);
    let mut reached = ByRise::zeros();
    let mut sum = 0.0;
    for k in (0..RISES).rev() {
        sum += all[k + 1];
        reached[k] = sum;
    }
    (basis, reached)
}

#[cfg(test)]
mod tests {
    use super::*;

    const CURVE: ResponseCurve = ResponseCurve { logarithms: [-0.6, 0.2, 0.9, 0.4, -0.1, -0.8] };

    #[test]
    fn equal_rises_are_srgb() {
        for curve in [ResponseCurve::default(), ResponseCurve { logarithms: [3.0; RISES] }] {
            for x in [-0.5, 0.0, 1e-6, 0.2, 0.7, 1.0, 3.0] {
                assert!((curve.value(x) - x).abs() <= 1e-14, "{x}: {}", curve.value(x));
            }
            assert!(curve.table(4).iter().all(|[usual, here]| (usual - here).abs() <= 1e-12));
        }
    }

    #[test]
    fn curves_rise_from_black_to_white() {
        assert_eq!(CURVE.value(0.0), 0.0);
        assert!((CURVE.value(1.0 - 1e-12) - 1.0).abs() <= 1e-10);
        let values: Vec<f64> = (-50..300).map(|k| CURVE.value(0.01 * f64::from(k))).collect();
        assert!(values.windows(2).all(|pair| pair[1] > pair[0]));
    }

    #[test]
    fn derivatives_are_those_of_central_differences() {
        let step = 1e-6;
        for x in [-0.3, 0.01, 0.2, 0.5, 0.97, 1.4] {
            let at = CURVE.rising().at(x);
            let slope = (CURVE.value(x + step) - CURVE.value(x - step)) / (2.0 * step);
            assert!((at.slope - slope).abs() <= 1e-6 * slope, "{x}: {} {slope}", at.slope);
            for k in 0..RISES {
                let moved = |by: f64| {
                    let mut curve = CURVE;
                    curve.logarithms[k] += by;
                    curve.value(x)
                };
                let by = (moved(step) - moved(-step)) / (2.0 * step);
                assert!((at.by_rise[k] - by).abs() <= 1e-8, "{x}, {k}: {} {by}", at.by_rise[k]);
            }
        }
    }

    #[test]
    fn numbers_of_other_responses_are_decoded() {
        let decoded = antirad_scene::linear_from_srgb(0.5);
        let as_if = |response: Response| response.light_of(decoded);
        assert!((as_if(Response::Linear) - 0.5).abs() <= 1e-12);
        assert!((as_if(Response::Gamma(2.2)) - 0.5_f64.powf(2.2)).abs() <= 1e-12);
        assert_eq!((as_if(Response::Srgb), as_if(Response::Fit)), (decoded, decoded));
    }
}
