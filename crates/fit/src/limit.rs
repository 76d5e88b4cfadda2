//! Keeps the total albedo of fitted materials below 1 for all values of the unknowns.
//!
//! Box constraints cannot: the bound of σ depends on albedo and power, which are fitted too. The unknown σ therefore passes
//! through a soft limit before it becomes the material's. With S = σ ℓ(p), where ℓ is the lobe's albedo for σ = 1, and
//! R = LIMIT - δρ, the budget that the diffuse part leaves, the material gets σ' = S'/ℓ(p), where S' = S up to 0.9 R and
//! then approaches R asymptotically. For nearly all materials σ' = σ; derivatives are exact in either case.

use antirad_scene::{Material, Normalization};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};

/// Upper limit of the total albedo, with the lobe's albedo from [`lobe`], which is accurate to 0.1 %.
pub(super) const LIMIT: f64 = 0.998;
/// Fraction of the budget R below which S is unchanged.
const KNEE: f64 = 0.9;
/// Spacing of the nodes of ℓ, in ln(1 + p).
const SPACING: f64 = 0.1;

/// ℓ(p) and its derivative: cubic interpolation of [`Material::specular_albedo_per_sigma`], which is too slow to integrate
/// per triangle.
pub(super) fn lobe(power: f64, normalization: Normalization) -> (f64, f64) {
    let at = power.ln_1p() / SPACING;
    let first = at.floor();
    let t = at - first;
    let [a, b, c, d] = [-1.0, 0.0, 1.0, 2.0].map(|k| node((first + k) as i32, normalization));
    let (mb, mc) = ((c - a) / 2.0, (d - b) / 2.0);
    let (t2, t3) = (t * t, t * t * t);
    let value = (2.0 * t3 - 3.0 * t2 + 1.0) * b
        + (t3 - 2.0 * t2 + t) * mb
        + (3.0 * t2 - 2.0 * t3) * c
        + (t3 - t2) * mc;
    let slope = (6.0 * t2 - 6.0 * t) * (b - c) + (3.0 * t2 - 4.0 * t + 1.0) * mb + (3.0 * t2 - 2.0 * t) * mc;
    (value, slope / (SPACING * (1.0 + power)))
}

/// The largest ℓ between two powers.
pub(super) fn largest_lobe(powers: [f64; 2], normalization: Normalization) -> f64 {
    let [low, high] = powers.map(|p| (p.ln_1p() / SPACING).floor() as i32);
    let nodes = (low..=high + 1).map(|k| node(k, normalization));
    nodes.fold(powers.map(|p| lobe(p, normalization).0).into_iter().fold(0.0, f64::max), f64::max)
}

fn node(k: i32, normalization: Normalization) -> f64 {
    static NODES: Mutex<Option<HashMap<(i32, Normalization), f64>>> = Mutex::new(None);
    // Beyond power 0 the curve continues by point reflection.
    if k < 0 {
        let (end, next) = (node(0, normalization), node(-k, normalization));
        return 2.0 * end - next;
    }
    let known = |k| {
        let nodes = NODES.lock().unwrap_or_else(PoisonError::into_inner);
        nodes.as_ref().and_then(|nodes| nodes.get(&(k, normalization)).copied())
    };
    known(k).unwrap_or_else(|| {
        let power = (f64::from(k) * SPACING).exp_m1();
        let value = Material { power, normalization, ..Material::named("") }.specular_albedo_per_sigma();
        let mut nodes = NODES.lock().unwrap_or_else(PoisonError::into_inner);
        nodes.get_or_insert_default().insert((k, normalization), value);
        value
    })
}

/// Derivatives of the limited σ' of one channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Limited {
    /// σ'.
    pub specular: f64,
    pub by_specular: f64,
    pub by_power: f64,
    /// Derivative of σ' by δρ.
    pub by_diffuse_albedo: f64,
}

/// The soft limit of one channel for σ and a lobe (ℓ, dℓ/dp), given the diffuse albedo.
pub(super) fn limit(specular: f64, (lobe, lobe_slope): (f64, f64), diffuse_albedo: f64) -> Limited {
    let budget = LIMIT - diffuse_albedo;
    let sum = specular * lobe;
    if sum <= KNEE * budget {
        return Limited { specular, by_specular: 1.0, by_power: 0.0, by_diffuse_albedo: 0.0 };
    }
    let width = (1.0 - KNEE) * budget;
    let q = sum + (1.0 - 2.0 * KNEE) * budget;
    let limited = budget - width * width / q;
    let by_sum = (width / q).powi(2);
    let by_room = 1.0 - (2.0 * width * (1.0 - KNEE) * q - width * width * (1.0 - 2.0 * KNEE)) / (q * q);
    Limited {
        specular: limited / lobe,
        by_specular: by_sum,
        by_power: lobe_slope * (by_sum * specular - limited / lobe) / lobe,
        by_diffuse_albedo: -by_room / lobe,
    }
}

/// Inverse of the limit: the σ that maps to `limited` if there is one, else one beyond the knee.
pub(super) fn unlimited(limited: f64, lobe: f64, diffuse_albedo: f64) -> f64 {
    let budget = LIMIT - diffuse_albedo;
    let sum = (limited * lobe).min(0.99 * budget);
    if sum <= KNEE * budget {
        return limited.min(sum / lobe);
    }
    let width = (1.0 - KNEE) * budget;
    (width * width / (budget - sum) - (1.0 - 2.0 * KNEE) * budget) / lobe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_of_lobes_is_right_to_a_thousandth() {
        for normalization in [Normalization::Phong, Normalization::Energy] {
            for power in [0.0, 0.013, 0.4, 1.0, 3.3, 19.0, 77.0, 1234.0, 9e4] {
                let truth =
                    Material { power, normalization, ..Material::named("") }.specular_albedo_per_sigma();
                let (ours, slope) = lobe(power, normalization);
                assert!((ours / truth - 1.0).abs() < 1e-3, "{power}: {ours} {truth}");
                let h = 1e-4 * (1.0 + power);
                let above = lobe(power + h, normalization).0;
                let numeric = if power > h {
                    (above - lobe(power - h, normalization).0) / (2.0 * h)
                } else {
                    (above - ours) / h
                };
                assert!(
                    (numeric - slope).abs() < 1e-3 * (numeric.abs() + 1e-3),
                    "{power}: {slope} {numeric}"
                );
            }
        }
        assert!(largest_lobe([0.0, 100.0], Normalization::Phong) > 3.8);
    }

    #[test]
    fn the_limit_holds_and_has_the_right_derivatives() {
        let lobe = (3.5, 0.02);
        for diffuse in [0.0, 0.3, 0.97] {
            let mut last = -1.0;
            for k in 0..200 {
                let sigma = f64::from(k) * 0.01;
                let of = |sigma: f64, dp: f64, diffuse: f64| {
                    limit(sigma, (lobe.0 + dp * lobe.1, lobe.1), diffuse).specular
                };
                let here = limit(sigma, lobe, diffuse);
                assert!(here.specular > last && diffuse + here.specular * lobe.0 < LIMIT);
                last = here.specular;
                let h = 1e-6;
                let slopes = [
                    (
                        here.by_specular,
                        (of(sigma + h, 0.0, diffuse) - of(sigma - h, 0.0, diffuse)) / (2.0 * h),
                    ),
                    (here.by_power, (of(sigma, h, diffuse) - of(sigma, -h, diffuse)) / (2.0 * h)),
                    (
                        here.by_diffuse_albedo,
                        (of(sigma, 0.0, diffuse + h) - of(sigma, 0.0, diffuse - h)) / (2.0 * h),
                    ),
                ];
                for (ours, numeric) in slopes {
                    assert!((ours - numeric).abs() < 1e-4, "σ {sigma} diffuse {diffuse}: {ours} {numeric}");
                }
                if here.specular * lobe.0 < 0.98 * (LIMIT - diffuse) {
                    let back = unlimited(here.specular, lobe.0, diffuse);
                    assert!((back - sigma).abs() < 1e-9 * (1.0 + sigma), "{back} {sigma}");
                }
            }
        }
    }
}
