//! Light of many lamps, by rays that are distributed over all of them.
//!
//! From each point goes the same number of rays, however many lamps there are. Each ray chooses a lamp with a probability in proportion to an
//! estimate of what the lamp brings without shadows, then a face of the lamp in the same way, and a point of the face by area (Shirley, Wang and
//! Zimmerman 1996, "Monte Carlo Techniques for Direct Lighting Calculations"; Conty Estevez and Kulla 2018, "Importance Sampling of Many Lights
//! with Adaptive Tree Splitting"). The mean of what arrives over the probability is the light, without bias. Of a face that is close, the light
//! without shadows is integrated, and the ray tells whether it arrives. All choices of a ray follow from one point of the sequence of Sobol', and
//! lamps stand along a Morton curve, so that rays spread evenly over both. The estimates of all lamps take less time than the rays up to some
//! thousand lamps, so that there is no hierarchy over lamps.
//!
//! Estimates hold the radiance that lamps have when this is made. Later light is linear in radiance: the rays stay, and so do their weights.

use super::cone::{Side, cut, extent, sides, vector_irradiance};
use super::highlight::Lobe;
use super::lamps::Lamp;
use super::openness::Parts;
use super::sampling::{Origin, shifts, sobol};
use super::surface::{Flat, Surface, within};
use crate::model::{BoundedRun, Facet, morton, rays_among};
use antirad_scene::Rays;
use glam::DVec3;
use std::collections::{BTreeMap, HashMap};
use std::fmt::Debug;
use std::sync::Arc;

/// Rays from a point, and from a point to what it reflects in a lobe.
const OF_POINT: u32 = 256;
const OF_LOBE: u32 = 512;
/// Rays from all over a triangle of mean area, and from the smallest. A point of a convex closed lamp has as few: what it emits outshines what
/// it reflects.
const OF_TRIANGLE: u32 = 256;
const LEAST: u32 = 64;

/// Lamps, and the triangles between them and what they light.
#[derive(Clone)]
pub struct ManyLights {
    /// `None` where nothing blocks.
    rays: Option<Arc<Rays>>,
    sources: Arc<Vec<Source>>,
    /// The lamp of each triangle of a convex closed lamp, which does not light itself.
    solid_of: Arc<HashMap<usize, u32>>,
    /// Rays from a point.
    count: u32,
    /// Mean area of triangles.
    mean_area: f64,
}

impl Debug for ManyLights {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        write!(f, "{} rays to {} lamps", self.count, self.sources.len())
    }
}

/// A lamp, as it is chosen.
struct Source {
    /// Its number.
    lamp: u32,
    /// Its radiance, summed over channels.
    radiance: f64,
    /// Area that is seen of it from its front; of a solid, on average over all directions.
    area: f64,
    /// A ball around it. Of a sun, seen from the origin.
    centre: DVec3,
    radius: f64,
    /// Towards its front; none of a solid.
    normal: Option<DVec3>,
    /// Of each face, its unit normal and its height over the origin, times its area.
    planes: Vec<(DVec3, f64)>,
    surface: Surface,
}

/// Distance to a face, in its longest sides, up to which its light is integrated; and height, as a share of the distance, down to which a corner
/// counts as above the horizon.
const NEAR: f64 = 2.0;
const ON_PLANE: f64 = 1e-9;
/// Distance, in radii of a lamp, from which all of it counts as equally far away.
const FAR: f64 = 4.0;
/// Faces of a lamp up to which its light is integrated where it is near, to tell how many rays it gets and where they go.
const FEW_FACES: usize = 4;
/// Share of the estimate from afar that counts at least: what is below the horizon of a triangle's middle is not below that of its corners.
const AT_LEAST: f64 = 0.1;

/// What a ray brings.
#[derive(Clone, Copy, Debug)]
pub struct Arrival {
    /// The lamp that it comes from.
    pub lamp: u32,
    /// Unit direction to the lamp.
    pub direction: DVec3,
    /// Solid angle that it stands for, sr.
    pub solid_angle: f64,
    /// Whether it is one of the second half of the rays.
    pub in_second_half: bool,
}

/// The height of a ball over a plane; where it reaches through the plane, about that of the part above.
fn above(height: f64, radius: f64) -> f64 {
    if height > radius { height } else { 0.5 * (height + radius).max(0.0) }
}

impl Source {
    fn new(facets: &[Facet], (number, lamp): (u32, &Lamp), radiance: f64) -> Self {
        let surface = Surface::new(facets, lamp);
        let (low, high) =
            antirad_scene::bounds(surface.triangles.iter().flat_map(|Flat { corners, .. }| *corners));
        let centre = 0.5 * (low + high);
        let corners = surface.triangles.iter().flat_map(|Flat { corners, .. }| corners);
        let radius = corners.map(|corner| corner.distance(centre)).fold(0.0, f64::max);
        let all: f64 = surface.triangles.iter().map(Flat::area).sum();
        // The mean silhouette of a convex solid has a quarter of its area (Cauchy).
        let (normal, area) = match (lamp.solid(), surface.triangles.first()) {
            (None, Some(face)) => (Some(face.normal), all),
            _ => (None, all / 4.0),
        };
        let plane = |face: &Flat| {
            let vector = face.area() * face.normal;
            (vector, vector.dot(face.corners[0]))
        };
        let planes = surface.triangles.iter().map(plane).collect();
        Self { lamp: number, radiance, area, centre, radius, normal, planes, surface }
    }

    /// The way from a point to a place on it.
    fn way(&self, point: DVec3, to: DVec3) -> DVec3 {
        if self.surface.goes_along { to } else { to - point }
    }

    /// About what arrives without shadows at points up to `reach` from a point of a plane: of a small or distant lamp, L A cosθ cosθ' / r². It is
    /// positive wherever something arrives.
    fn estimate(&self, point: DVec3, normal: DVec3, reach: f64) -> f64 {
        let distant = self.at_distance(point, normal, reach);
        if self.is_far(point) || self.surface.triangles.len() > FEW_FACES {
            return distant;
        }
        let of_face = |face: &Flat| self.integral_of(face, point, normal).dot(normal).max(0.0);
        let near: f64 = self.surface.triangles.iter().map(of_face).sum();
        (self.radiance * near).max(AT_LEAST * distant)
    }

    fn is_far(&self, point: DVec3) -> bool {
        let reach = FAR * self.radius;
        self.surface.goes_along || self.centre.distance_squared(point) > reach * reach
    }

    /// What a point would receive of a face without shadows, ∫ ω dω over the part above the horizon, sr.
    fn integral_of(&self, face: &Flat, point: DVec3, normal: DVec3) -> DVec3 {
        let ways = face.corners.map(|corner| self.way(point, corner));
        if -ways[0].dot(face.normal) <= 0.0 {
            return DVec3::ZERO;
        }
        let cone = cone(ways);
        match extent(&cone, normal) {
            [false, _] => DVec3::ZERO,
            [true, false] => vector_irradiance(sides(&cone)),
            [true, true] => {
                let mut above = Vec::with_capacity(4);
                cut(&cone, normal, 0, &mut above);
                vector_irradiance(sides(&above))
            }
        }
    }

    fn at_distance(&self, point: DVec3, normal: DVec3, reach: f64) -> f64 {
        let way = self.way(point, self.centre);
        let least = self.radius.max(reach);
        let squared = way.length_squared().max(least * least).max(f64::MIN_POSITIVE);
        let received = above(way.dot(normal), self.radius);
        let sent = self.normal.map_or_else(|| squared.sqrt(), |front| above(-way.dot(front), reach));
        self.radiance * self.area * received * sent / (squared * squared)
    }

    /// Sums of what is estimated of each face at a point, up to each, in any unit.
    fn of_faces(&self, point: DVec3, normal: DVec3, to: &mut Vec<f64>) {
        if self.surface.triangles.len() == 1 {
            // There is no choice.
            sums([1.0].into_iter(), to);
        } else if self.is_far(point) {
            // What the point sees of its area.
            let start = if self.surface.goes_along { DVec3::ZERO } else { point };
            sums(self.planes.iter().map(|(vector, height)| (vector.dot(start) - height).max(0.0)), to);
        } else {
            let few = self.surface.triangles.len() <= FEW_FACES;
            let of_face = |face: &Flat| {
                let estimate = self.estimate_of(face, point, normal);
                let integral = || self.integral_of(face, point, normal).dot(normal).max(AT_LEAST * estimate);
                if few { integral() } else { estimate }
            };
            sums(self.surface.triangles.iter().map(of_face), to);
        }
    }

    /// The same as of a lamp of one of its faces at a point.
    fn estimate_of(&self, face: &Flat, point: DVec3, normal: DVec3) -> f64 {
        let ways = face.corners.map(|corner| self.way(point, corner));
        let heights = ways.map(|way| way.dot(normal));
        let highest = heights.into_iter().fold(0.0, f64::max);
        let received = (heights.iter().sum::<f64>() / 3.0).max(0.25 * highest);
        let sent = (-ways[0].dot(face.normal)).max(0.0);
        let squared = (ways.iter().sum::<DVec3>() / 3.0).length_squared().max(face.area());
        face.area() * received * sent / (squared * squared)
    }
}

/// The cone of directions to a face that is seen from its front: a triangle runs the other way than the cone that it closes.
fn cone([a, b, c]: [DVec3; 3]) -> [Side; 3] {
    [c, b, a].map(|corner| Side { corner, plane: 0 })
}

/// What a point would receive of a face without shadows, sr, if the face is near and the point sees all of its front: there cosθ cosθ' / r² varies
/// over the face, without bound where it touches the receiver.
fn of_near(ways: [DVec3; 3], normal: DVec3) -> Option<DVec3> {
    let squared = (ways.iter().sum::<DVec3>() / 3.0).length_squared();
    let is_above = |way: &DVec3| way.dot(normal) >= -ON_PLANE * squared.sqrt();
    let longest = (0..3).map(|k| ways[k].distance_squared(ways[(k + 1) % 3])).fold(0.0, f64::max);
    let near = squared < NEAR * NEAR * longest && ways.iter().all(is_above);
    let light = near.then(|| vector_irradiance(sides(&cone(ways))));
    // Of a face in the plane of the receiver, rounding alone is left.
    light.filter(|light| light.dot(normal) > 0.0)
}

/// Sums of numbers up to each, and the sum of all.
fn sums(numbers: impl Iterator<Item = f64>, to: &mut Vec<f64>) -> f64 {
    let mut sum = 0.0;
    to.clear();
    to.extend(numbers.map(|number| {
        sum += number;
        sum
    }));
    sum
}

/// The interval that holds a place among sums: its number, its share of the last sum, and where in it the place is, from 0 to 1. None if all
/// are zero.
fn chosen(sums: &[f64], place: f64) -> Option<(usize, f64, f64)> {
    let all = *sums.last()?;
    let at = place * all;
    let number = sums.partition_point(|sum| *sum <= at);
    let begin = number.checked_sub(1).map_or(0.0, |before| sums[before]);
    let width = sums.get(number)? - begin;
    Some((number, width / all, ((at - begin) / width).clamp(0.0, 1.0)))
}

const UNIT: f64 = 1.0 / 4_294_967_296.0;

impl ManyLights {
    /// `radiance`: that of each lamp, which decides how many rays it gets.
    pub fn new(facets: &[Facet], lamps: &[Lamp], radiance: &[DVec3]) -> Self {
        let radiance: Vec<f64> = radiance.iter().map(|rgb| rgb.element_sum()).collect();
        let numbered = (0..).zip(lamps).zip(radiance);
        let sources = numbered.map(|(lamp, radiance)| Source::new(facets, lamp, radiance)).collect();
        let solids = (0..).zip(lamps).filter_map(|(number, lamp)| Some((number, lamp.solid()?.triangles())));
        let solid_of =
            solids.flat_map(|(number, triangles)| triangles.iter().map(move |&i| (i as usize, number)));
        Self::among(facets, sources, Arc::new(solid_of.collect()), OF_POINT)
    }

    /// The same of moved triangles.
    pub fn moved(&self, facets: &[Facet], lamps: &[Lamp]) -> Self {
        let of = |source: &Source| {
            let lamp = (source.lamp, &lamps[source.lamp as usize]);
            Source::new(facets, lamp, source.radiance)
        };
        Self::among(facets, self.sources.iter().map(of).collect(), self.solid_of.clone(), self.count)
    }

    fn among(
        facets: &[Facet],
        mut sources: Vec<Source>,
        solid_of: Arc<HashMap<usize, u32>>,
        count: u32,
    ) -> Self {
        let box_of_all = BoundedRun::around(facets.iter());
        let size = (box_of_all.max - box_of_all.min).max_element().max(f64::MIN_POSITIVE);
        let place = |source: &Source| morton((source.centre - box_of_all.min) / size);
        sources.sort_by_cached_key(|source| (place(source), source.lamp));
        let area: f64 = facets.iter().map(|facet| facet.area).sum();
        Self {
            rays: Some(rays_among(facets)),
            sources: sources.into(),
            solid_of,
            count,
            mean_area: area / facets.len().max(1) as f64,
        }
    }

    /// The same where nothing stands between lamps and points.
    pub fn without_shadows(self) -> Self {
        Self { rays: None, ..self }
    }

    /// The same with so many rays from each point.
    pub fn with_rays(self, count: u32) -> Self {
        Self { count, ..self }
    }

    /// What arrives at a point of a triangle; with a lobe, distributed by what it reflects as well.
    pub fn at_point(
        &self,
        lamps: &[Lamp],
        (receiver, facet): (usize, &Facet),
        point: DVec3,
        lobe: Option<&Lobe>,
    ) -> Vec<Arrival> {
        let count = match self.solid_of.contains_key(&receiver) {
            true => self.count.min(LEAST),
            false if lobe.is_some() => self.count * OF_LOBE / OF_POINT,
            false => self.count,
        };
        self.arrivals(lamps, (receiver, facet.normal), Origin::Point(point), lobe, count)
    }

    /// What arrives at a triangle, from points all over it: smaller ones have fewer rays. `parts`: the weights of its parts.
    pub fn at_triangle(
        &self,
        lamps: &[Lamp],
        (receiver, facet): (usize, &Facet),
        parts: Option<&Parts>,
    ) -> Vec<Arrival> {
        if facet.area <= 0.0 {
            return Vec::new();
        }
        let wanted = f64::from(OF_TRIANGLE) * facet.area / self.mean_area;
        let count = (wanted as u32).clamp(LEAST, OF_TRIANGLE).next_power_of_two();
        self.arrivals(lamps, (receiver, facet.normal), Origin::Triangle(facet.corners, parts), None, count)
    }

    fn arrivals(
        &self,
        lamps: &[Lamp],
        (receiver, normal): (usize, DVec3),
        origin: Origin,
        lobe: Option<&Lobe>,
        count: u32,
    ) -> Vec<Arrival> {
        let (middle, reach) = match origin {
            Origin::Point(point) => (point, 0.0),
            Origin::Triangle(corners, _) => {
                let middle = corners.iter().sum::<DVec3>() / 3.0;
                (middle, corners.map(|corner| corner.distance(middle)).into_iter().fold(0.0, f64::max))
            }
        };
        let of_lamps = self.probabilities(receiver, (middle, normal, reach), lobe);
        let shifts = shifts(middle, u32::MAX);
        let mut places: Vec<([u32; 2], u32)> = (0..count)
            .map(|ray| {
                let [s, t] = sobol(ray);
                ([s ^ shifts[0], t ^ shifts[1]], ray)
            })
            .collect();
        // One lamp after the other.
        places.sort_unstable();
        let (mut of_faces, mut last) = (Vec::new(), None);
        let mut found = Vec::with_capacity(places.len());
        for ([s, t], ray) in places {
            let Some((number, probability, rest)) = chosen(&of_lamps, UNIT * f64::from(s)) else { break };
            let source = &self.sources[number];
            let (point, counts) = origin.of_ray(ray, [shifts[2], shifts[3]]);
            let faces = &source.surface.triangles;
            if last != Some(number) || reach > 0.0 {
                source.of_faces(point, normal, &mut of_faces);
                last = Some(number);
            }
            let Some((face, share, rest)) = chosen(&of_faces, rest) else { continue };
            let face = &faces[face];
            let way = source.way(point, within(face.corners, [rest, UNIT * f64::from(t)]));
            let squared = way.length_squared();
            let (received, sent) = (way.dot(normal), -way.dot(face.normal));
            let (lamp, to) = (&lamps[source.lamp as usize], point + way);
            let own = |i: usize| i == receiver || lamp.passes(i as u32);
            let blocked = || self.rays.as_ref().is_some_and(|rays| rays.blocked(point, to, own));
            if received > 0.0 && sent > 0.0 && !blocked() {
                let ways = face.corners.map(|corner| source.way(point, corner));
                let whole = if lobe.is_none() { of_near(ways, normal) } else { None };
                // dω = cosθ' dA / r².
                let light = whole.unwrap_or_else(|| way * (sent * face.area() / (squared * squared)));
                let light = counts * light / (probability * share * f64::from(count));
                found.push(Arrival {
                    lamp: source.lamp,
                    direction: light.normalize_or_zero(),
                    solid_angle: light.length(),
                    in_second_half: ray >= count / 2,
                });
            }
        }
        found
    }

    /// Sums of what is estimated of each lamp, up to each: half of the rays, if there is a lobe, by what that reflects.
    fn probabilities(
        &self,
        receiver: usize,
        (point, normal, reach): (DVec3, DVec3, f64),
        lobe: Option<&Lobe>,
    ) -> Vec<f64> {
        let own = self.solid_of.get(&receiver);
        let estimate = |source: &Source| match own {
            Some(lamp) if *lamp == source.lamp => 0.0,
            _ => source.estimate(point, normal, reach),
        };
        let estimates: Vec<f64> = self.sources.iter().map(estimate).collect();
        let mut of_lamps = Vec::with_capacity(estimates.len());
        let all = sums(estimates.iter().copied(), &mut of_lamps);
        let Some(lobe) = lobe else { return of_lamps };
        // In steps of an octave, so that light is a smooth function of the power.
        let power = lobe.power.max(1.0).log2().floor().exp2();
        let lobe = Lobe::new(lobe.normal, lobe.eye, power);
        let highest = |source: &Source| {
            let way = source.way(point, source.centre);
            lobe.highest(way, (source.radius / way.length()).min(1.0).asin())
        };
        let reflected: Vec<f64> = self
            .sources
            .iter()
            .zip(&estimates)
            .map(|(source, estimate)| highest(source) * estimate)
            .collect();
        let all_reflected: f64 = reflected.iter().sum();
        if all_reflected > 0.0 {
            let both = estimates.iter().zip(&reflected);
            sums(both.map(|(estimate, reflected)| estimate / all + reflected / all_reflected), &mut of_lamps);
        }
        of_lamps
    }
}

/// What rays bring, added up by lamp, ascending.
pub fn by_lamp<T: Default + std::ops::AddAssign>(
    arrivals: &[Arrival],
    of: impl Fn(&Arrival) -> T,
) -> Vec<(u32, T)> {
    let mut sums = BTreeMap::<u32, T>::new();
    arrivals.iter().for_each(|arrival| *sums.entry(arrival.lamp).or_default() += of(arrival));
    sums.into_iter().collect()
}
