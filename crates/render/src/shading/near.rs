//! Indirect light from near by, where it varies within faces: what a point receives from each sender close to it, in place of what
//! interpolation shows of that.
//!
//! The irradiance of a face far from all that lights it is smooth, and interpolation serves. Beside a sunlit patch, at the foot of a wall, it
//! varies within a face. Let N(x) be what point x receives from senders i nearby,
//!
//! N(x) = Σ_i w(|x − c_i| / R_i) V(x, i) L_i F(x, i),
//!
//! with F the projected solid angle, V visibility by rays, w a window from 1 to 0 at the range R_i, and L_i the radiance of parts of the
//! sender, whose direct light is looked up where the edge of a shadow crosses it. A point shows N(x), and what interpolation shows of the
//! means of H − N: N is smooth where faces are small beside the distance of senders, and there both are the same.

use super::interpolation::Interpolation;
use antirad_base::parallel;
use antirad_core::direct::{DirectLight, Lamp, PointLight, barycentric};
use antirad_core::model::{Facet, centroid, projected_solid_angle, quarters, rays_among};
use antirad_gpu::GpuError;
use antirad_scene::{Material, Rays};
use glam::DVec3;
use std::collections::BTreeSet;
use std::f64::consts::PI;
use std::sync::Arc;

/// How far the mean over a face of what interpolation shows may be from its irradiance, as a share of that, before points look around.
const ROUGH: f64 = 0.1;
/// One face in so many may be rough: where more are, as in dense or coarse meshes, points take longer than the rest, for little.
const FEW: usize = 50;
/// Range of senders, in sizes of the rough face that they light.
const RANGE: f64 = 3.0;
/// Share of the irradiance of a face from which on a sender counts.
const LEAST: f64 = 5e-4;
/// Rings of faces around rough ones whose points look around; and whose means interpolation reads for these, with its steps of sharpening.
const RINGS: [usize; 2] = [1, 5];
/// Pairs of faces looked at, at most: one second on a core.
const MOST_PAIRS: usize = 300_000_000;
/// Faces with a sender near by, at most, of which those where rays tell what is in between take so many times as long: some seconds on a core.
const MOST_WORK: usize = 1_000_000;
const BY_RAYS: usize = 10;
/// Times that senders are cut into quarters, at most, and square of the distance over the area beyond which a part counts as a point.
const CUTS: usize = 3;
const POINT: f64 = 16.0;
/// Times where something is in between.
const SEEN_CUTS: usize = 1;
/// Difference of direct light within a sender, over its largest, from which on parts have their own.
const UNEVEN: f64 = 0.05;
/// Times that the light from near by is found: the second time, senders vary as the first has told.
const PASSES: usize = 2;

/// Light from near by.
pub struct NearLight {
    rays: Arc<Rays>,
    /// Whether points of each face look around.
    looks: Vec<bool>,
    /// Near senders of each face.
    near: Vec<Vec<Near>>,
    senders: Vec<Sender>,
    /// What interpolation is to show of each face besides, sharpened, W/m².
    rest: Vec<DVec3>,
}

impl std::fmt::Debug for NearLight {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("NearLight").field("senders", &self.senders.len()).finish_non_exhaustive()
    }
}

struct Sender {
    face: u32,
    /// R.
    range: f64,
    /// Radiance of its parts by cut, W/(m² sr): 1, 4, 16, 64. Nothing beyond the first where they are alike.
    radiance: Vec<Vec<DVec3>>,
}

/// A sender near a face.
struct Near {
    sender: u32,
    /// Whether nothing is in between; otherwise rays tell.
    clear: bool,
}

/// What is known of the faces of a solution.
pub struct Lit<'a> {
    pub facets: &'a [Facet],
    pub materials: &'a [Material],
    pub direct: &'a DirectLight,
    pub interpolation: &'a Interpolation,
    /// Means over each face, W/m².
    pub direct_irradiance: &'a [DVec3],
    pub indirect_irradiance: &'a [DVec3],
}

impl NearLight {
    /// `None` where interpolation serves everywhere, or where too many faces are rough.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn new(lit: &Lit) -> Result<Option<Self>, GpuError> {
        let rough = lit.rough();
        let looks = lit.dilated(rough.clone(), RINGS[0]);
        let read = lit.dilated(looks.clone(), RINGS[1] - RINGS[0]);
        let is = |which: &[bool]| (0..which.len()).filter(|&i| which[i]).collect::<Vec<_>>();
        let (rough, read) = (is(&rough), is(&read));
        if rough.is_empty()
            || rough.len() * FEW > lit.facets.len()
            || read.len() * lit.facets.len() > MOST_PAIRS
        {
            return Ok(None);
        }
        let ranges = lit.ranges(&rough);
        let candidates: Vec<u32> =
            (0..).zip(&ranges).filter(|(_, range)| **range > 0.0).map(|(i, _)| i).collect();
        let rays = rays_among(lit.facets);
        let mut near: Vec<Vec<Near>> = vec![];
        near.resize_with(lit.facets.len(), Vec::new);
        let found: Vec<Vec<Near>> = parallel::map(&read, |&face| lit.near(&rays, &ranges, &candidates, face));
        let work: usize = found.iter().flatten().map(|near| if near.clear { 1 } else { BY_RAYS }).sum();
        if work > MOST_WORK {
            return Ok(None);
        }
        read.iter().zip(found).for_each(|(&face, found)| near[face] = found);
        let used: BTreeSet<u32> = near.iter().flatten().map(|near| near.sender).collect();
        let used: Vec<u32> = used.into_iter().collect();
        for near in near.iter_mut().flatten() {
            near.sender = used.partition_point(|&face| face < near.sender) as u32;
        }
        let senders = lit.senders(&used, &ranges)?;
        let mut all = Self { rays, looks, near, senders, rest: Vec::new() };
        for pass in 0..PASSES {
            let received: Vec<[DVec3; 16]> = parallel::map(&read, |&face| {
                middles(&lit.facets[face]).map(|p| all.received(lit.facets, face, p))
            });
            let mut rest = lit.indirect_irradiance.to_vec();
            for (&face, received) in read.iter().zip(&received) {
                rest[face] -= received.iter().sum::<DVec3>() / 16.0;
            }
            all.rest = lit.interpolation.sharpened(lit.facets, &rest);
            if pass + 1 < PASSES {
                all.spread(lit, &read, &received);
            }
        }
        Ok(Some(all))
    }

    /// Lets the radiance of senders vary as the irradiance does that their points find.
    fn spread(&mut self, lit: &Lit, read: &[usize], received: &[[DVec3; 16]]) {
        for sender in &mut self.senders {
            let face = sender.face as usize;
            let Some(received_index) = read.binary_search(&face).ok().filter(|_| self.looks[face]) else {
                continue;
            };
            let facet = &lit.facets[face];
            let corners = lit.interpolation.corners(lit.facets, &self.rest, face);
            let mut found = middles(facet).map(|point| {
                let b = barycentric(facet.corners, facet.normal, point);
                corners[0] * b.x + corners[1] * b.y + corners[2] * b.z
            });
            found.iter_mut().zip(received[received_index]).for_each(|(to, more)| *to += more);
            let mean = found.iter().sum::<DVec3>() / 16.0;
            let reflectance = DVec3::from(lit.materials[face].diffuse_albedo()) / PI;
            found.iter_mut().for_each(|h| *h = reflectance * (*h - mean));
            let mut leaves = sender.radiance.pop().unwrap_or_default();
            if leaves.len() == 1 {
                let varies = found.iter().any(|h| h.abs().element_sum() > UNEVEN * leaves[0].element_sum());
                if !varies {
                    sender.radiance.push(leaves);
                    continue;
                }
                leaves = vec![leaves[0]; 16];
            }
            let each = leaves.len() / 16;
            leaves
                .iter_mut()
                .enumerate()
                .for_each(|(k, leaf)| *leaf = (*leaf + found[k / each]).max(DVec3::ZERO));
            sender.radiance = pyramid(leaves);
        }
    }

    /// What to interpolate over a face, and to add [`Self::received`] to; `None` where interpolation alone serves.
    pub fn rest(&self, face: usize) -> Option<&[DVec3]> {
        self.looks[face].then_some(&self.rest[..])
    }

    /// N(x) at a point of a face, W/m².
    pub fn received(&self, facets: &[Facet], face: usize, point: DVec3) -> DVec3 {
        let mut sum = DVec3::ZERO;
        for near in &self.near[face] {
            let sender = &self.senders[near.sender as usize];
            let at = At { rays: (!near.clear).then_some(&self.rays), facets, face, point, sender };
            sum += at.of_part(facets[sender.face as usize].corners, 0, 0);
        }
        sum
    }
}

/// A point of a face, and a sender.
struct At<'a> {
    /// What may be in between.
    rays: Option<&'a Rays>,
    facets: &'a [Facet],
    face: usize,
    point: DVec3,
    sender: &'a Sender,
}

impl At<'_> {
    /// What the point receives from a part of the sender, W/m². `cut`: times that it has been cut; `number`: of the part among those.
    fn of_part(&self, corners: [DVec3; 3], cut: usize, number: usize) -> DVec3 {
        let (receiver, source) = (&self.facets[self.face], &self.facets[self.sender.face as usize]);
        let middle = centroid(corners);
        let apart = middle - self.point;
        let (squared, area) = (apart.length_squared(), source.area / 4f64.powi(cut as i32));
        let is_point = squared > POINT * area;
        let least = if self.rays.is_some() { SEEN_CUTS } else { 0 };
        let last = (self.sender.radiance.len() - 1).max(least);
        if !is_point && cut < last {
            let parts = quarters(corners).into_iter().zip(4 * number..);
            return parts.map(|(corners, number)| self.of_part(corners, cut + 1, number)).sum();
        }
        let window = (1.0 - (squared / (self.sender.range * self.sender.range)).powi(2)).max(0.0).powi(2);
        let out = -apart.dot(source.normal);
        if window == 0.0 || out <= 0.0 || squared <= 0.0 {
            return DVec3::ZERO;
        }
        let solid_angle = if is_point {
            (apart.dot(receiver.normal) * out * area / (squared * squared)).max(0.0)
        } else {
            projected_solid_angle(self.point, receiver.normal, corners)
        };
        let own = [self.face, self.sender.face as usize];
        let blocked = |rays: &Rays| rays.blocked(self.point, middle, |face| own.contains(&face));
        if solid_angle.is_nan() || solid_angle <= 0.0 || self.rays.is_some_and(blocked) {
            return DVec3::ZERO;
        }
        let radiance = &self.sender.radiance;
        let level = cut.min(radiance.len() - 1);
        window * solid_angle * radiance[level][number >> (2 * (cut - level))]
    }
}

/// The middles of the sixteen parts of a face.
fn middles(facet: &Facet) -> [DVec3; 16] {
    let parts = quarters(facet.corners).map(quarters);
    std::array::from_fn(|k| centroid(parts[k / 4][k % 4]))
}

/// Values of the parts of a face and their means over those that are larger, up to that over all.
fn pyramid(parts: Vec<DVec3>) -> Vec<Vec<DVec3>> {
    let mut all = vec![parts];
    while all[0].len() > 1 {
        let means = all[0].chunks(4).map(|parts| parts.iter().sum::<DVec3>() / 4.0).collect();
        all.insert(0, means);
    }
    all
}

/// Length of the sides of the equilateral triangle that is as large.
fn size(facet: &Facet) -> f64 {
    1.52 * facet.characteristic_area.sqrt()
}

impl Lit<'_> {
    /// Faces over which interpolation does not keep the mean.
    fn rough(&self) -> Vec<bool> {
        let blurred = self.interpolation.means(self.facets, self.indirect_irradiance);
        let area: f64 = self.facets.iter().map(|facet| facet.area).sum();
        let all = self.facets.iter().zip(self.direct_irradiance.iter().zip(self.indirect_irradiance));
        let mean: DVec3 = all.map(|(facet, (d, h))| (*d + *h) * (facet.area / area)).sum();
        let off = |i: usize| {
            let h = self.indirect_irradiance[i];
            let shown = (self.direct_irradiance[i] + h).element_sum() + 0.1 * mean.element_sum();
            match self.materials[i].diffuse_albedo() {
                [0.0, 0.0, 0.0] => 0.0,
                _ => ((h - blurred[i]).abs().element_sum() / shown).min(1.0),
            }
        };
        (0..self.facets.len()).map(|i| off(i) > ROUGH).collect()
    }

    /// Faces and those around them on the same surface, some times.
    fn dilated(&self, mut faces: Vec<bool>, rings: usize) -> Vec<bool> {
        for _ in 0..rings {
            let mut more = faces.clone();
            for face in (0..faces.len()).filter(|&face| faces[face]) {
                let around = |corner| self.interpolation.around(self.facets, face, corner);
                (0..3).flat_map(around).for_each(|other| more[other] = true);
            }
            faces = more;
        }
        faces
    }

    /// R of each face as a sender; 0 where no rough face is near.
    fn ranges(&self, rough: &[usize]) -> Vec<f64> {
        let range = |i: usize| {
            let sender = &self.facets[i];
            let of = |&j: &usize| {
                let (receiver, own) = (&self.facets[j], size(sender));
                let range = RANGE * size(receiver).max(0.5 * own);
                let apart = sender.centroid.distance(receiver.centroid);
                if self.faces(sender, receiver) && apart < range { range } else { 0.0 }
            };
            rough.iter().map(of).fold(0.0, f64::max)
        };
        parallel::map(0..self.facets.len(), range)
    }

    /// Whether the front of one face has some of the other before it, and the other way.
    fn faces(&self, a: &Facet, b: &Facet) -> bool {
        let before = |a: &Facet, b: &Facet| {
            let highest = b.corners.iter().map(|corner| (*corner - a.centroid).dot(a.normal));
            highest.fold(f64::NEG_INFINITY, f64::max) > 1e-6 * size(a).max(size(b))
        };
        before(a, b) && before(b, a)
    }

    /// Senders near a face, by their faces.
    fn near(&self, rays: &Rays, ranges: &[f64], candidates: &[u32], face: usize) -> Vec<Near> {
        let receiver = &self.facets[face];
        let least = LEAST * (self.direct_irradiance[face] + self.indirect_irradiance[face]).element_sum();
        let places =
            |facet: &Facet| facet.corners.map(|corner| facet.centroid + 0.9 * (corner - facet.centroid));
        let from = places(receiver);
        let near = |sender: u32| {
            let i = sender as usize;
            let source = &self.facets[i];
            let apart = receiver.centroid.distance(source.centroid);
            if i == face || apart > ranges[i] + size(receiver) {
                return None;
            }
            // No more than from straight ahead of a disc.
            let most = PI * source.area / (source.area + PI * apart * apart);
            let bright = most * self.radiance(i, self.direct_irradiance[i]).element_sum() >= least;
            if !bright || !self.faces(receiver, source) {
                return None;
            }
            let to = places(source);
            let blocked = |k: usize| {
                let to = to[(k + 1) % 3];
                rays.blocked(from[k], to, |other| other == face || other == i)
            };
            Some(Near { sender, clear: !(0..3).any(blocked) })
        };
        candidates.iter().copied().filter_map(near).collect()
    }

    /// What a face sends, W/(m² sr), but for lamps, where its direct irradiance is such.
    fn radiance(&self, face: usize, direct: DVec3) -> DVec3 {
        let reflectance = DVec3::from(self.materials[face].diffuse_albedo()) / PI;
        reflectance * (direct + self.indirect_irradiance[face])
    }

    /// Senders with the radiance of their parts.
    fn senders(&self, faces: &[u32], ranges: &[f64]) -> Result<Vec<Sender>, GpuError> {
        let lamps: BTreeSet<u32> = self.direct.lamps().iter().flat_map(Lamp::triangles).copied().collect();
        let lit = |face: &u32| self.direct_irradiance[*face as usize] != DVec3::ZERO;
        let uneven: Vec<u32> = faces.iter().copied().filter(lit).collect();
        let coarse = self.direct_at(&uneven, CUTS - 1)?;
        let spread = |values: &Vec<DVec3>| {
            let sums = values.iter().map(|value| value.element_sum());
            let (low, high) = sums.fold((f64::INFINITY, 0.0f64), |(a, b), x| (a.min(x), b.max(x)));
            high - low > UNEVEN * high
        };
        let uneven: Vec<u32> =
            uneven.into_iter().zip(&coarse).filter(|(_, values)| spread(values)).map(|(i, _)| i).collect();
        let fine = self.direct_at(&uneven, CUTS)?;
        let sender = |&face: &u32| {
            let i = face as usize;
            let emission =
                if lamps.contains(&face) { DVec3::ZERO } else { self.materials[i].emission.into() };
            let direct = match uneven.binary_search(&face) {
                Ok(k) => fine[k].clone(),
                Err(_) => vec![self.direct_irradiance[i]],
            };
            let radiance = pyramid(direct.into_iter().map(|d| emission + self.radiance(i, d)).collect());
            Sender { face, range: ranges[i], radiance }
        };
        Ok(faces.iter().map(sender).collect())
    }

    /// Direct irradiance at the middle of each part of faces that are cut a number of times.
    fn direct_at(&self, faces: &[u32], cuts: usize) -> Result<Vec<Vec<DVec3>>, GpuError> {
        let points = |&face: &u32| {
            let cut = |parts: Vec<[DVec3; 3]>| parts.into_iter().flat_map(quarters).collect();
            let parts = (0..cuts).fold(vec![self.facets[face as usize].corners], |parts, _| cut(parts));
            parts.into_iter().map(centroid).collect::<Vec<DVec3>>()
        };
        let points: Vec<Vec<DVec3>> = faces.iter().map(points).collect();
        let asked: Vec<(usize, &[DVec3])> =
            faces.iter().zip(&points).map(|(&face, points)| (face as usize, &points[..])).collect();
        let radiance = self.direct.radiance(|i| &self.materials[i]);
        let found = self.direct.at_faces(self.facets, &asked)?;
        let of_face = |(&face, found): (&u32, Vec<PointLight>)| {
            let normal = self.facets[face as usize].normal;
            let sum = |light: PointLight| {
                light.iter().map(|(l, phi)| phi.dot(normal) * radiance[*l as usize]).sum::<DVec3>()
            };
            found.into_iter().map(sum).collect()
        };
        Ok(faces.iter().zip(found).map(of_face).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What a point receives from an even square before it, against the closed form for a rectangle above a corner.
    #[test]
    fn parts_of_senders_add_up() {
        let [a, b, c, d] = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]];
        let at = |[x, y]: [f64; 2], z: f64| DVec3::new(x, y, z);
        for height in [0.1_f64, 0.5, 2.0, 6.0] {
            let [x, y] = [1.0 / height; 2];
            let side = |x: f64, y: f64| x / (1.0 + x * x).sqrt() * (y / (1.0 + x * x).sqrt()).atan();
            let expected = 0.5 * (side(x, y) + side(y, x));
            let receiver = Facet::new([DVec3::ZERO, DVec3::X, DVec3::Y]);
            let square = [[a, c, b], [a, d, c]].map(|corners| Facet::new(corners.map(|p| at(p, height))));
            let facets = [receiver, square[0], square[1]];
            for parts in [1, 16, 64] {
                let received = |face: u32| {
                    let radiance = pyramid(vec![DVec3::ONE; parts]);
                    let sender = Sender { face, range: 1e3, radiance };
                    let at = At { rays: None, facets: &facets, face: 0, point: DVec3::ZERO, sender: &sender };
                    at.of_part(facets[face as usize].corners, 0, 0).x
                };
                let found = received(1) + received(2);
                assert!((found / expected - 1.0).abs() <= 0.02, "{height} {parts}: {found}, not {expected}");
            }
        }
    }
}
