//! The share of a lamp's light that reaches a point, by rays: where so much stands in between that exact visibility takes too long.
//!
//! What a point would see of the lamp without blockers stays exact; rays only tell how much of it they block. So the light of points
//! that see all of a lamp, or nothing, has no noise, and the same point always gets the same rays.

use super::highlight::Lobe;
use super::lamps::Lamp;
use super::visible::Placed;
use crate::model::Facet;
use antirad_scene::Rays;
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::SplitMix64;
use std::collections::HashSet;
use std::sync::Arc;

/// Polygons in the way up to which visibility is exact all the same.
pub const FEW: usize = 24;

/// Rays of a triangle or a point to all lamps together, about, and to each at most.
const TO_ALL: f64 = 256.0;
const TO_EACH: f64 = 128.0;

/// Steps of a sequence that fills the unit cube of four dimensions evenly: powers of the inverse of the real root of x⁵ = x + 1
/// (M. Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
pub const STEPS: [f64; 4] =
    [0.856_674_883_854_502_9, 0.733_891_856_627_126, 0.628_706_721_037_808_7, 0.538_597_257_223_610_1];

/// Rays among the triangles of a scene.
#[derive(Clone)]
pub struct Sampling {
    rays: Arc<Rays>,
    /// Number of rays to each lamp.
    counts: Arc<Vec<u32>>,
}

impl std::fmt::Debug for Sampling {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "rays to each lamp: {:?}", self.counts)
    }
}

/// A share, from 0 to 1, and its standard error.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize, serde::Serialize)]
pub struct Share {
    pub value: f64,
    pub error: f64,
}

impl Share {
    pub const ALL: Self = Self { value: 1.0, error: 0.0 };
    pub const NOTHING: Self = Self { value: 0.0, error: 0.0 };
}

/// The origin of rays.
#[derive(Clone, Copy)]
pub enum Origin {
    Point(DVec3),
    /// All over a triangle, by its corners.
    Triangle([DVec3; 3]),
}

impl Sampling {
    /// More rays go to lamps that light more: by radiance, and by the solid angle in which the middle of the scene would see their fronts.
    pub fn new(facets: &[Facet], lamps: &[Lamp], radiance: &[DVec3]) -> Self {
        let corners = facets.iter().map(|facet| facet.corners).collect();
        let rays = Arc::new(Rays::among(corners, |i| facets[*i as usize].area > 0.0));
        let emits: HashSet<u32> = lamps.iter().flat_map(Lamp::triangles).copied().collect();
        let others = facets.iter().zip(0..).filter(|(_, i)| !emits.contains(i)).map(|(facet, _)| facet);
        let (sum, area) = others.fold((DVec3::ZERO, 0.0), |(sum, area), facet| {
            (sum + facet.area * facet.centroid, area + facet.area)
        });
        let middle = if area > 0.0 { sum / area } else { sum };
        let light = |(lamp, radiance): (&Lamp, &DVec3)| {
            let solid_angle = match lamp {
                Lamp::Sun(disc) => disc.projected(),
                Lamp::Surface(surface) => {
                    let area: f64 = surface.triangles.iter().map(|&i| facets[i as usize].area).sum();
                    // The mean silhouette of a convex solid has a quarter of its area (Cauchy).
                    let area = if surface.solid.is_some() { area / 4.0 } else { area };
                    let squared = facets[surface.first()].centroid.distance_squared(middle);
                    (area / squared.max(area)).min(1.0)
                }
            };
            radiance.element_sum() * solid_angle
        };
        let light: Vec<f64> = lamps.iter().zip(radiance).map(light).collect();
        let all = light.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let count = |light: &f64| (TO_ALL * light / all).ceil().clamp(1.0, TO_EACH) as u32;
        Self { rays, counts: Arc::new(light.iter().map(count).collect()) }
    }

    /// The sampling of moved triangles, with as many rays to each lamp.
    pub fn moved(&self, facets: &[Facet]) -> Self {
        let corners = facets.iter().map(|facet| facet.corners).collect();
        let rays = Arc::new(Rays::among(corners, |i| facets[*i as usize].area > 0.0));
        Self { rays, counts: self.counts.clone() }
    }

    /// The share of the irradiance of the lamp with a number that arrives at a triangle or a point of it, or of what a lobe there reflects of it.
    pub fn share(
        &self,
        receiver: usize,
        from: Origin,
        normal: DVec3,
        (number, lamp): (usize, &Placed),
        lobe: Option<&Lobe>,
    ) -> Share {
        let start: DVec3 = match from {
            Origin::Point(point) => point,
            Origin::Triangle(corners) => corners.iter().sum(),
        };
        let first = lamp.lamp.triangles().first();
        let mut state = start
            .to_array()
            .into_iter()
            .fold(first.map_or(number as u64, |&i| i.into()), |state, x| mixed(state ^ x.to_bits()));
        let mut at = STEPS.map(|_| {
            state = mixed(state);
            state as f64 / 2f64.powi(64)
        });
        // Of every other ray, for the error: all light, and what arrives.
        let (mut all, mut arrives) = ([0.0; 2], [0.0; 2]);
        let lamp_fan = Fan::new(&lamp.corners);
        for ray in 0..self.counts[number] as usize {
            let point = match &from {
                Origin::Point(point) => *point,
                Origin::Triangle(corners) => Fan::new(corners).at([at[2], at[3]]),
            };
            let to = lamp_fan.at([at[0], at[1]])
                + match &from {
                    // A sun, in place as the centroid sees it, goes along with each point.
                    Origin::Triangle(_) if lamp.lamp.sun().is_some() => point - start / 3.0,
                    _ => DVec3::ZERO,
                };
            let (towards, squared) = (to - point, to.distance_squared(point));
            // cos θ cos θ' / r², up to a factor.
            let cosines = [towards.dot(normal), -towards.dot(lamp.normal)].map(|cosine| cosine.max(0.0));
            let reflected = lobe.map_or(1.0, |lobe| lobe.at(towards));
            let weight = reflected * cosines[0] * cosines[1] / (squared * squared);
            if weight > 0.0 {
                all[ray % 2] += weight;
                let passes = |i: usize| i == receiver || lamp.lamp.passes(i as u32);
                if !self.rays.blocked(point, to, passes) {
                    arrives[ray % 2] += weight;
                }
            }
            for (x, step) in at.iter_mut().zip(STEPS) {
                *x = (*x + step).fract();
            }
        }
        let sum = all[0] + all[1];
        if sum.is_nan() || sum <= 0.0 {
            // No ray has met a narrow lobe.
            return lobe.map_or(Share::NOTHING, |_| self.share(receiver, from, normal, (number, lamp), None));
        }
        let error = match all.iter().all(|half| *half > 0.0) {
            true => 0.5 * (arrives[0] / all[0] - arrives[1] / all[1]).abs(),
            // One ray is a coin.
            false => 0.5,
        };
        Share { value: (arrives[0] + arrives[1]) / sum, error }
    }
}

/// A number that mixes all bits of another: the first of the generator SplitMix64 (Steele, Lea and Flood 2014), the same on every machine.
pub fn mixed(seed: u64) -> u64 {
    SplitMix64::seed_from_u64(seed).random()
}

/// A convex polygon as a fan of triangles.
struct Fan<'a> {
    corners: &'a [DVec3],
    /// Areas of the triangles up to each, as shares of the polygon's.
    sums: Vec<f64>,
}

impl<'a> Fan<'a> {
    fn new(corners: &'a [DVec3]) -> Self {
        let mut sum = 0.0;
        let area = |pair: &[DVec3]| (pair[0] - corners[0]).cross(pair[1] - corners[0]).length();
        let mut sums: Vec<f64> = corners[1..]
            .windows(2)
            .map(|pair| {
                sum += area(pair);
                sum
            })
            .collect();
        sums.iter_mut().for_each(|s| *s /= sum);
        Self { corners, sums }
    }

    /// The point at a place of the unit square: areas are kept up to a factor.
    fn at(&self, [s, t]: [f64; 2]) -> DVec3 {
        let patch = self.sums.partition_point(|sum| *sum <= s).min(self.sums.len() - 1);
        let before = patch.checked_sub(1).map_or(0.0, |before| self.sums[before]);
        let root = ((s - before) / (self.sums[patch] - before)).clamp(0.0, 1.0).sqrt();
        let [a, b, c] = [0, patch + 1, patch + 2].map(|k| self.corners[k]);
        a + root * ((b - a) + t * (c - b))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_fill_a_polygon_evenly() {
        let corners: Vec<DVec3> = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 2.0], [0.0, 1.0]]
            .map(|[x, y]| DVec3::new(x, y, 0.0))
            .into();
        let fan = Fan::new(&corners);
        let (mut at, mut mean, mut low) = ([0.0; 4], DVec3::ZERO, 0);
        let count = 4000;
        for _ in 0..count {
            let point = fan.at([at[0], at[1]]);
            mean += point / f64::from(count);
            low += i32::from(point.y < 1.0);
            for (x, step) in at.iter_mut().zip(STEPS) {
                *x = (*x + step).fract();
            }
        }
        // A square of 2 x 1 below a triangle of area 1, whose centroid is at height 4/3.
        assert!((mean - DVec3::new(1.0, (2.0 * 0.5 + 4.0 / 3.0) / 3.0, 0.0)).length() < 1e-2, "{mean}");
        assert!((f64::from(low) / f64::from(count) - 2.0 / 3.0).abs() < 1e-2, "{low}");
    }
}
