//! Rays towards what is bright: patches beside lamps, which few rays in all directions meet.
//!
//! One ray of [`EVERY`] goes to a point of a bright source, which is chosen by what a receiver would see of it if nothing stood between. What
//! rays of both kinds find of a source is weighted by the balance heuristic (Veach and Guibas 1995): by how densely both together meet
//! it. So no ray counts more than `EVERY / (EVERY - 1)` times.

use crate::direct::{STEPS, mixed, sobol, within};
use crate::model::{Facet, PADDING};
use crate::plan::Plan;
use glam::DVec3;
use std::f64::consts::PI;
use std::ops::Range;

/// One ray of so many goes towards what is bright.
pub const EVERY: u32 = 4;
/// Radiance of bright triangles at least, in units of its mean over the area.
const BRIGHT: f64 = 4.0;
/// Their share of the second moment of radiance at least: with less they bring little of the variance.
const WORTH: f64 = 0.25;
/// Bright sources at most: each receiver looks at all.
const MOST: usize = 512;

/// Bright sources.
pub struct Bright {
    sources: Vec<Source>,
    /// The number of the source that a triangle is.
    numbers: Vec<u32>,
}

struct Source {
    facet: Facet,
    triangle: usize,
    radiance: f64,
}

/// What a receiver aims at: the probability of sources, and of all up to each.
pub struct Aim<'a> {
    bright: &'a Bright,
    ends: Vec<f64>,
}

/// No source.
const NONE: u32 = u32::MAX;

impl Bright {
    /// The bright sources for the radiance of slots; `None` where they bring little.
    pub fn new(plan: &Plan, radiance: &[f64]) -> Option<Self> {
        let of_slot = |(&triangle, &radiance): (&u32, &f64)| {
            (triangle != PADDING).then(|| (triangle as usize, plan.facets[triangle as usize].area, radiance))
        };
        let all: Vec<(usize, f64, f64)> =
            plan.layout.order.iter().zip(radiance).filter_map(of_slot).collect();
        let moment = |power: i32| all.iter().map(|&(_, area, l)| area * l.powi(power)).sum::<f64>();
        let least = BRIGHT * moment(1) / moment(0).max(f64::MIN_POSITIVE);
        let mut bright: Vec<_> = all.iter().filter(|(.., radiance)| *radiance > least).collect();
        let square = |&&(_, area, l): &&(usize, f64, f64)| area * l * l;
        bright.sort_by(|a, b| square(b).total_cmp(&square(a)).then(a.0.cmp(&b.0)));
        bright.truncate(MOST);
        let is_worth = bright.iter().map(square).sum::<f64>() >= WORTH * moment(2) && !bright.is_empty();
        is_worth.then(|| {
            let mut numbers = vec![NONE; plan.facets.len()];
            bright.iter().zip(0..).for_each(|(of, number)| numbers[of.0] = number);
            let source =
                |&&(triangle, _, radiance): &&_| Source { facet: plan.facets[triangle], triangle, radiance };
            Self { sources: bright.iter().map(source).collect(), numbers }
        })
    }

    /// What a receiver aims at, if it may see any of it.
    pub fn aim(&self, receiver: &Facet) -> Option<Aim<'_>> {
        let mut sum = 0.0;
        let sums = self.sources.iter().map(|Source { facet, radiance, .. }| {
            let towards = facet.centroid - receiver.centroid;
            let squared = towards.length_squared();
            let cosines = [towards.dot(receiver.normal), -towards.dot(facet.normal)].map(|c| c.max(0.0));
            // As a disc of its area would be seen from the centre of the receiver.
            let size = facet.area / PI;
            sum += radiance * facet.area * cosines[0] * cosines[1]
                / (squared * (squared + size)).max(f64::MIN_POSITIVE);
            sum
        });
        let ends: Vec<f64> = sums.collect();
        (sum > 0.0).then(|| Aim { bright: self, ends: ends.iter().map(|end| end / sum).collect() })
    }
}

impl Aim<'_> {
    /// Some rays of the sequence of a receiver: origins, unit directions, and the triangles that they go to.
    pub fn rays(
        &self,
        receiver: &Facet,
        seed: u64,
        numbers: Range<u32>,
    ) -> impl Iterator<Item = (DVec3, DVec3, usize)> {
        let shifts = [2, 3].map(|k| mixed(seed ^ mixed(k)));
        let [turned, moved] = shifts.map(|shift| [shift as u32, (shift >> 32) as u32]);
        let unit = |x: u32| f64::from(x) / 2f64.powi(32);
        let corners = receiver.corners;
        numbers.map(move |ray| {
            let place = [0, 1].map(|k: usize| unit(moved[k].wrapping_add(ray.wrapping_mul(STEPS[k]))));
            let origin = within(corners, place);
            let [s, t] = sobol(ray);
            let (chosen, along) = (unit(s ^ turned[0]), unit(t ^ turned[1]));
            let number = self.ends.partition_point(|&end| end <= chosen).min(self.ends.len() - 1);
            let [begin, end] = self.interval(number);
            let across = ((chosen - begin) / (end - begin)).clamp(0.0, 1.0);
            let Source { facet, triangle, .. } = &self.bright.sources[number];
            let towards = within(facet.corners, [across, along]) - origin;
            (origin, towards.normalize_or_zero(), *triangle)
        })
    }

    /// What a hit counts in place of one by rays in all directions alone: of a triangle, at a distance, with cosines at both ends.
    pub fn balance(&self, (triangle, facet): (usize, &Facet), distance: f64, cosines: [f64; 2]) -> f64 {
        let aimed = 1.0 / f64::from(EVERY);
        let density = match self.bright.numbers[triangle] {
            NONE => 0.0,
            number => {
                let [begin, end] = self.interval(number as usize);
                let seen = facet.area * cosines[0] * cosines[1] / (PI * distance * distance);
                (end - begin) / seen.max(f64::MIN_POSITIVE)
            }
        };
        1.0 / (1.0 - aimed + aimed * density)
    }

    fn interval(&self, number: usize) -> [f64; 2] {
        [number.checked_sub(1).map_or(0.0, |before| self.ends[before]), self.ends[number]]
    }
}
