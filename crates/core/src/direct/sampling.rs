//! The share of a lamp's light that reaches a point, by rays: where so much stands in between that exact visibility takes too long.
//!
//! What a point would see of the lamp without blockers stays exact; rays only tell how much of it they block. So the light of points
//! that see all of a lamp, or nothing, has no noise, and the same point always gets the same rays.

use super::guide::{CELLS, Mask, Open, middle};
use super::highlight::Lobe;
use super::lamps::Lamp;
use super::openness::Parts;
use super::surface::{Surface, spread, within};
use super::visible::Placed;
use crate::model::{Facet, orthonormal_basis, rays_among};
use antirad_scene::Rays;
use glam::DVec3;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::SplitMix64;
use std::collections::HashSet;
use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::Arc;

/// Rays that take about as long as exact visibility behind one polygon.
const PER_POLYGON: usize = 8;
/// Polygons behind which it is exact in any case.
const FEWEST: usize = 4;

/// Rays of a triangle or a point to all lamps together, about, and to each at most.
const TO_ALL: f64 = 256.0;
const TO_EACH: f64 = 128.0;
/// Rays of a point to a lamp of which something may be open, at least.
const LEAST: f64 = 4.0;
/// How many times more there are where little of lamps is open, at most.
const MORE: f64 = 4.0;

/// Steps of a sequence that fills the unit square evenly, in units of 2^-32: powers of the inverse of the real root of x³ = x + 1
/// (M. Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
pub const STEPS: [u32; 2] = [3_242_174_889, 2_447_445_414];

/// Rays among the triangles of a scene.
#[derive(Clone)]
pub struct Sampling {
    rays: Arc<Rays>,
    /// Where rays end: each lamp.
    surfaces: Arc<Vec<Surface>>,
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

/// Standard error of a share of one half by n rays from a point is about this times n^(-3/4): rays fill lamps evenly, up to the edge of a
/// shadow. In d dimensions the exponent is -(d + 1)/2d.
pub const OF_HALF: f64 = 0.5;

/// Sums of the weights of rays: of all, and of those that arrive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sums {
    /// Of all rays.
    pub all: f64,
    /// Of those that arrive.
    pub arrive: f64,
}

impl Sums {
    /// Whether some arrives, and some does not.
    pub fn is_in_part(&self) -> bool {
        self.arrive > 0.0 && self.arrive < self.all
    }

    /// The share that arrives of a number of rays, which fill so many dimensions; `None` if none has a weight.
    pub fn share(&self, rays: u32, dimensions: f64) -> Option<Share> {
        let value = self.arrive / self.all;
        let error = match rays {
            // A coin.
            1 => 0.5,
            rays => {
                let falls = f64::from(rays).powf(-0.5 - 0.5 / dimensions);
                2.0 * OF_HALF * (value * (1.0 - value)).max(0.0).sqrt() * falls
            }
        };
        (self.all > 0.0).then_some(Share { value, error })
    }
}

impl std::ops::AddAssign for Sums {
    fn add_assign(&mut self, other: Self) {
        self.all += other.all;
        self.arrive += other.arrive;
    }
}

/// The origin of rays.
#[derive(Clone, Copy)]
pub enum Origin<'a> {
    Point(DVec3),
    /// All over a triangle, by its corners and the weights of its parts.
    Triangle([DVec3; 3], Option<&'a Parts>),
}

impl Origin<'_> {
    /// Where a ray leaves, by its number, and its weight there. `shifts`: those of the sequence of places.
    pub fn of_ray(self, ray: u32, shifts: [u32; 2]) -> (DVec3, f64) {
        match self {
            Self::Point(point) => (point, 1.0),
            Self::Triangle(corners, parts) => {
                let place = |k: usize| shifts[k].wrapping_add(ray.wrapping_mul(STEPS[k]));
                let place = [0, 1].map(|k| f64::from(place(k)) / 2f64.powi(32));
                (within(corners, place), parts.map_or(1.0, |parts| parts.weight(spread(place))))
            }
        }
    }
}

impl Sampling {
    /// More rays go to lamps that light more: by radiance, and by the solid angle in which the middle of the scene would see their fronts.
    pub fn new(facets: &[Facet], lamps: &[Lamp], radiance: &[DVec3]) -> Self {
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
        Self::counted(facets, lamps, Arc::new(light.iter().map(count).collect()))
    }

    fn counted(facets: &[Facet], lamps: &[Lamp], counts: Arc<Vec<u32>>) -> Self {
        let rays = rays_among(facets);
        let surfaces = lamps.iter().map(|lamp| Surface::new(facets, lamp)).collect();
        Self { rays, surfaces: Arc::new(surfaces), counts }
    }

    /// Polygons in the way of a lamp up to which visibility is exact all the same: about as many as take as long as its rays.
    pub(super) fn few(&self, lamp: usize) -> usize {
        (self.counts[lamp] as usize / PER_POLYGON).max(FEWEST)
    }

    /// The sampling of moved triangles, with as many rays to each lamp.
    pub fn moved(&self, facets: &[Facet], lamps: &[Lamp]) -> Self {
        Self::counted(facets, lamps, self.counts.clone())
    }

    /// The weights of rays from a point to a lamp, by their numbers, which triangles that are `own` do not block: what kernels find.
    pub fn from_point(
        &self,
        point: DVec3,
        normal: DVec3,
        lamp: usize,
        count: u32,
        own: impl Fn(usize) -> bool,
    ) -> Sums {
        self.sums(Origin::Point(point), normal, (lamp, Open::ALL), count, None, &own, &mut |_, _| ())
    }

    /// The share of the irradiance of a lamp that arrives at a triangle, and from where. `lamp`: its number, and as the triangle sees it; `parts`:
    /// the weights of the parts of the triangle.
    pub(super) fn of_triangle(
        &self,
        receiver: usize,
        (corners, parts): ([DVec3; 3], Option<&Parts>),
        normal: DVec3,
        (number, lamp): (usize, &Placed),
    ) -> (Share, Mask) {
        let own = |i: usize| i == receiver || lamp.lamp.passes(i as u32);
        let mut mask = Mask::default();
        let each = &mut |place, arrives| mask.add(place, arrives);
        let (from, count) = (Origin::Triangle(corners, parts), self.counts[number]);
        let sums = self.sums(from, normal, (number, Open::ALL), count, None, &own, each);
        (sums.share(count, 4.0).unwrap_or(Share::NOTHING), mask)
    }

    /// The share of the irradiance of a lamp that arrives at a point of a triangle, or of what a lobe there reflects of it. `aim`: where rays go,
    /// and their number.
    pub(super) fn of_point(
        &self,
        receiver: usize,
        point: DVec3,
        normal: DVec3,
        (number, lamp): (usize, &Placed),
        lobe: Option<&Lobe>,
        (open, count): (Open, u32),
    ) -> f64 {
        if open.is_empty() {
            return 0.0;
        }
        let own = |i: usize| i == receiver || lamp.lamp.passes(i as u32);
        let share = |lobe| {
            let from = Origin::Point(point);
            let sums = self.sums(from, normal, (number, open), count, lobe, &own, &mut |_, _| ());
            Some(sums.share(count, 2.0)?.value * self.open_share(point, normal, number, open, lobe))
        };
        // Where no ray has met a narrow lobe, that of all light.
        share(lobe).or_else(|| lobe.and_then(|_| share(None))).unwrap_or_default()
    }

    /// Where rays from points of a triangle to each lamp go, and their number: as many as are saved where light is dark for sure go elsewhere. They are
    /// the more the less of lamps is open, of which the edge is a larger share.
    pub(super) fn aims(&self, facet: &Facet, open: impl Fn(usize) -> Open) -> Vec<(Open, u32)> {
        let &Facet { centroid, normal, .. } = facet;
        let of_lamp = |(lamp, &count): (usize, &u32)| {
            let open = open(lamp);
            (open, f64::from(count) * self.open_share(centroid, normal, lamp, open, None))
        };
        let of_lamps: Vec<(Open, f64)> = self.counts.iter().enumerate().map(of_lamp).collect();
        let share =
            of_lamps.iter().map(|(_, rays)| rays).sum::<f64>() / self.counts.iter().sum::<u32>() as f64;
        let more = (1.0 / share).min(MORE) / share;
        of_lamps.into_iter().map(|(open, rays)| (open, (more * rays).ceil().max(LEAST) as u32)).collect()
    }

    /// The share of the irradiance of a lamp at a point, without shadows, that is that of open cells.
    fn open_share(&self, point: DVec3, normal: DVec3, lamp: usize, open: Open, lobe: Option<&Lobe>) -> f64 {
        if open.is_all() {
            return 1.0;
        }
        let weight = |cell| (open.has(cell), self.weight(point, normal, lamp, middle(cell), lobe).0);
        let (mut all, mut arrives) = (0.0, 0.0);
        for (is_open, weight) in (0..CELLS).map(weight) {
            all += weight;
            arrives += if is_open { weight } else { 0.0 };
        }
        // A lobe may be narrower than cells, and the horizon close to all middles.
        if all > 0.0 { arrives / all } else { 1.0 }
    }

    /// How much a place of a lamp counts at a point, cos θ cos θ' / r², up to a factor, and where it is.
    fn weight(
        &self,
        point: DVec3,
        normal: DVec3,
        lamp: usize,
        place: [u32; 2],
        lobe: Option<&Lobe>,
    ) -> (f64, DVec3) {
        let (to, lamp_normal) = self.surfaces[lamp].from_point(point, place);
        let (towards, squared) = (to - point, to.distance_squared(point));
        let cosines = [towards.dot(normal), -towards.dot(lamp_normal)].map(|cosine| cosine.max(0.0));
        let reflected = lobe.map_or(1.0, |lobe| lobe.at(towards));
        (reflected * cosines[0] * cosines[1] / (squared * squared), to)
    }

    /// The weights of so many rays to the open cells of a lamp, which triangles that are `own` do not block. `each`: told where each ray ends, and
    /// whether it arrives.
    #[expect(
        clippy::too_many_arguments,
        reason = "where rays leave, where they end, and what is told of them"
    )]
    fn sums(
        &self,
        from: Origin,
        normal: DVec3,
        (lamp, open): (usize, Open),
        count: u32,
        lobe: Option<&Lobe>,
        own: &dyn Fn(usize) -> bool,
        each: &mut dyn FnMut([u32; 2], bool),
    ) -> Sums {
        let start = match from {
            Origin::Point(point) => point,
            Origin::Triangle(corners, _) => corners.iter().sum(),
        };
        let shifts = shifts(start, lamp as u32);
        let mut sums = Sums::default();
        for ray in 0..count {
            let [s, t] = sobol(ray);
            let place = open.place([s ^ shifts[0], t ^ shifts[1]]);
            let (point, counts) = from.of_ray(ray, [shifts[2], shifts[3]]);
            let (weight, to) = self.weight(point, normal, lamp, place, lobe);
            if counts * weight > 0.0 {
                let arrives = !self.rays.blocked(point, to, own);
                sums.all += counts * weight;
                sums.arrive += if arrives { counts * weight } else { 0.0 };
                each(place, arrives);
            }
        }
        sums
    }
}

/// A point of the sequence of Sobol' (1967) in the unit square, in units of 2^-32: the first 2^k fill it evenly, and so do the next ones. So
/// they do with some digits flipped.
pub fn sobol(index: u32) -> [u32; 2] {
    // Pascal's triangle modulo 2.
    let steps = [(16, 0xffff_0000), (8, 0xff00_ff00), (4, 0xf0f0_f0f0), (2, 0xcccc_cccc), (1, 0xaaaa_aaaa)];
    let second = steps.into_iter().fold(index, |digits, (by, of)| digits ^ ((digits & of) >> by));
    [index, second].map(u32::reverse_bits)
}

/// How the sequences of a point and a lamp differ from those of others, in units of 2^-32: the same for all points that are the same in f32.
pub(super) fn shifts(point: DVec3, lamp: u32) -> [u32; 4] {
    let bits = point.to_array().map(|x| (x as f32).to_bits());
    let mut state = bits.into_iter().fold(mixed32(lamp), |state, bits| mixed32(state ^ bits));
    [0; 4].map(|_| {
        state = mixed32(state.wrapping_add(1));
        state
    })
}

/// A number that mixes all bits of another (C. Wellons 2018, "Prospecting for hash functions": lowbias32).
fn mixed32(mut x: u32) -> u32 {
    x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// A number that mixes all bits of another: the first of the generator SplitMix64 (Steele, Lea and Flood 2014), the same on every machine.
pub fn mixed(seed: u64) -> u64 {
    SplitMix64::seed_from_u64(seed).random()
}

/// Rays that leave all over the front of a triangle, as many in each direction as its cosine asks for: origins and unit directions. A seed always
/// gives the same sequence, of which these have some numbers.
pub fn from_front(facet: &Facet, seed: u64, numbers: Range<u32>) -> impl Iterator<Item = (DVec3, DVec3)> {
    let basis = orthonormal_basis(facet.normal);
    let whole = Origin::Triangle(facet.corners, None);
    let shifts = [0, 1].map(|k| mixed(seed ^ mixed(k)));
    let [turned, moved] = shifts.map(|shift| [shift as u32, (shift >> 32) as u32]);
    let unit = |x: u32| f64::from(x) / 2f64.powi(32);
    numbers.map(move |ray| {
        let [s, t] = sobol(ray);
        let (outward, turn) = (unit(s ^ turned[0]), unit(t ^ turned[1]));
        let (origin, _) = whole.of_ray(ray, moved);
        // Uniform on the unit disc below the hemisphere (Nusselt's analogue).
        let (radius, (sin, cos)) = (outward.sqrt(), (TAU * turn).sin_cos());
        let direction = basis * DVec3::new(radius * cos, radius * sin, (1.0 - outward).sqrt());
        (origin, direction)
    })
}
