//! Where regions touch: borders that end at a plane, and regions that share a plane.

use super::planes::Planes;
use super::{Joints, NONE, Surface, normal};
use antirad_base::parallel;
use antirad_rays::Boxes;
use glam::DVec3;

/// In distances: how far apart touching surfaces may be.
const TOUCH: f64 = 1.5;
/// Cosine between normals of planes that may be one.
const SAME: f64 = 0.98;
/// Cosine between the normals of a sheet and a plane, from which that sheet lies along the plane and does not end there.
const ALONG: f64 = 0.9;
/// In distances: how deep a solid may be in another that it stands on.
const SUNK: f64 = 0.25;
/// Share of the corners of a region that touch another for it to stand on that.
const STANDS: f64 = 0.25;

/// Which planes joints touch without belonging to a triangle there.
pub(super) struct Contacts {
    /// Per joint.
    pub touched: Vec<Vec<u32>>,
}

impl Contacts {
    /// Finds the contacts. Regions that share a plane get a common one.
    pub fn new(surface: &Surface, joints: &Joints, planes: &mut Planes) -> Self {
        let near = Near::new(surface, joints, planes);
        let own = own_planes(joints, planes);
        let found: Vec<Vec<Touch>> = parallel::map(0..joints.places.len() as u32, |joint| near.of(joint));
        let group = merge(surface, joints, planes, &found, &own);
        let leaning = leaning(surface, joints);
        let touched = |joint: usize| {
            if !joints.open[joint] {
                return Vec::new();
            }
            let ends_at = |touch: &&Touch| {
                let normal = planes.planes[group[touch.plane as usize] as usize].normal;
                let along = |other: DVec3| normal.dot(other).abs() > ALONG;
                let own = &own[joint];
                match own.is_empty() {
                    true => !along(leaning[joint]),
                    false => !own.iter().any(|&p| along(planes.planes[group[p as usize] as usize].normal)),
                }
            };
            let mut all: Vec<u32> =
                found[joint].iter().filter(ends_at).map(|touch| group[touch.plane as usize]).collect();
            all.sort_unstable();
            all.dedup();
            all
        };
        let touched = (0..joints.places.len()).map(touched).collect();
        planes.regroup(surface, &group);
        Self { touched }.renumbered(&group)
    }

    /// With planes numbered without those that became part of others.
    fn renumbered(mut self, group: &[u32]) -> Self {
        let numbers = numbers(group);
        self.touched.iter_mut().flatten().for_each(|plane| *plane = numbers[*plane as usize]);
        self
    }
}

/// Of planes that are the first of their group, their number among these.
fn numbers(group: &[u32]) -> Vec<u32> {
    let mut next = 0;
    (0..)
        .zip(group)
        .map(|(plane, &first)| {
            let own = next;
            next += u32::from(plane == first);
            if plane == first { own } else { NONE }
        })
        .collect()
}

impl Planes {
    /// Gives planes of one group a common one.
    fn regroup(&mut self, surface: &Surface, group: &[u32]) {
        let numbers = numbers(group);
        let old = std::mem::take(&mut self.planes);
        let regions = std::mem::take(&mut self.triangles);
        let count = numbers.iter().filter(|n| **n != NONE).count();
        self.triangles = vec![Vec::new(); count];
        let mut alone = vec![true; count];
        for (region, (k, &first)) in regions.into_iter().zip(group.iter().enumerate()) {
            let number = numbers[first as usize] as usize;
            alone[number] &= k == first as usize;
            region.iter().for_each(|&t| self.of[t as usize] = number as u32);
            self.triangles[number].extend(region);
        }
        let firsts =
            old.into_iter().zip(&numbers).filter(|(_, number)| **number != NONE).map(|(plane, _)| plane);
        for ((plane, triangles), alone) in firsts.zip(&mut self.triangles).zip(alone) {
            triangles.sort_unstable();
            self.planes.push(if alone { plane } else { super::planes::Plane::fitted(surface, triangles) });
        }
        for (t, &plane) in self.of.iter().enumerate() {
            if plane != NONE {
                let front = surface.normal(t as u32);
                self.turned[t] = front.dot(self.planes[plane as usize].normal) < 0.0;
            }
        }
    }
}

/// A region near a joint that is no part of it.
#[derive(Clone, Copy)]
struct Touch {
    plane: u32,
    apart: f64,
    /// Whether the nearest place is on the border of the region.
    at_border: bool,
}

/// The triangles of all regions, found from a place.
struct Near<'a> {
    surface: &'a Surface,
    joints: &'a Joints,
    planes: &'a Planes,
    triangles: Vec<u32>,
    boxes: Boxes,
    own: Vec<Vec<u32>>,
}

impl<'a> Near<'a> {
    fn new(surface: &'a Surface, joints: &'a Joints, planes: &'a Planes) -> Self {
        let triangles: Vec<u32> = planes.triangles.iter().flatten().copied().collect();
        let corners: Vec<[DVec3; 3]> = triangles.iter().map(|&t| surface.corners(t)).collect();
        Self {
            surface,
            joints,
            planes,
            triangles,
            boxes: Boxes::around(&corners),
            own: own_planes(joints, planes),
        }
    }

    /// The regions near a joint, the nearest place of each, by ascending plane.
    fn of(&self, joint: u32) -> Vec<Touch> {
        let place = self.joints.places[joint as usize];
        let reach = TOUCH * self.surface.distance;
        let mut found: Vec<Touch> = Vec::new();
        self.boxes.meet(&[place - reach, place + reach], |k| {
            let t = self.triangles[k as usize];
            let plane = self.planes.of[t as usize];
            if self.own[joint as usize].contains(&plane) {
                return true;
            }
            let (nearest, weights) = nearest_on(self.surface.corners(t), place);
            let apart = nearest.distance(place);
            let at_border = (0..3).any(|side| {
                let beyond = self.joints.beyond[t as usize][side];
                let border = beyond == NONE || self.planes.of[beyond as usize] != plane;
                border && weights[(side + 2) % 3] == 0.0
            });
            let touch = Touch { plane, apart, at_border };
            match found.iter_mut().find(|known| known.plane == plane) {
                _ if apart.is_nan() || apart > reach => {}
                Some(known) if apart < known.apart => *known = touch,
                Some(_) => {}
                None => found.push(touch),
            }
            true
        });
        found.sort_by_key(|touch| touch.plane);
        found
    }
}

/// Per joint, the planes of its triangles.
fn own_planes(joints: &Joints, planes: &Planes) -> Vec<Vec<u32>> {
    let mut own = vec![Vec::new(); joints.places.len()];
    for (corners, &plane) in joints.triangles.iter().zip(&planes.of) {
        for &joint in corners.iter().filter(|_| plane != NONE) {
            let known: &mut Vec<u32> = &mut own[joint as usize];
            if !known.contains(&plane) {
                known.push(plane);
            }
        }
    }
    own
}

/// Per joint, the mean normal of its triangles.
fn leaning(surface: &Surface, joints: &Joints) -> Vec<DVec3> {
    let mut sums = vec![DVec3::ZERO; joints.places.len()];
    for (t, corners) in joints.triangles.iter().enumerate() {
        let own = normal(surface.corners(t as u32));
        corners.iter().for_each(|&joint| sums[joint as usize] += own);
    }
    sums.into_iter().map(DVec3::normalize_or_zero).collect()
}

/// Per plane, the first of its group: regions that continue each other across a gap, and those of solids that stand on one another.
fn merge(
    surface: &Surface,
    joints: &Joints,
    planes: &Planes,
    found: &[Vec<Touch>],
    own: &[Vec<u32>],
) -> Vec<u32> {
    let mut group: Vec<u32> = (0..planes.planes.len() as u32).collect();
    let mut members: Vec<Vec<u32>> = planes.triangles.clone();
    let mut corners = vec![0usize; planes.planes.len()];
    // By pair of planes: joints of the first at the border of the second, and those over the second; the sum of their heights.
    let mut pairs: std::collections::BTreeMap<[u32; 2], (usize, usize, f64)> = Default::default();
    for (joint, touches) in found.iter().enumerate() {
        for &plane in &own[joint] {
            corners[plane as usize] += 1;
            for touch in touches {
                let (border, over, height) = pairs.entry([plane, touch.plane]).or_default();
                *border += usize::from(touch.at_border && joints.open[joint]);
                *over += 1;
                *height += planes.planes[touch.plane as usize].height(joints.places[joint]);
            }
        }
    }
    for ([one, other], (border, over, height)) in pairs {
        let cosine = planes.planes[one as usize].normal.dot(planes.planes[other as usize].normal);
        let continues = cosine >= SAME && border >= 2;
        let stands = cosine <= -SAME
            && over as f64 >= STANDS * corners[one as usize] as f64
            && height >= -SUNK * surface.distance * over as f64;
        let [a, b] = [group[one as usize], group[other as usize]];
        if a == b || !continues && !stands {
            continue;
        }
        let both: Vec<u32> = members[a as usize].iter().chain(&members[b as usize]).copied().collect();
        if Planes::fit(surface, &both).is_some() {
            members[a.max(b) as usize].clear();
            members[a.min(b) as usize] = both;
            group.iter_mut().filter(|g| **g == a.max(b)).for_each(|g| *g = a.min(b));
        }
    }
    group
}

/// The place on a triangle that is nearest to another, and its barycentric coordinates (C. Ericson, *Real-Time Collision Detection*, 2005).
fn nearest_on([a, b, c]: [DVec3; 3], place: DVec3) -> (DVec3, [f64; 3]) {
    let (ab, ac) = (b - a, c - a);
    let dots = |from: DVec3| (ab.dot(place - from), ac.dot(place - from));
    let ((d1, d2), (d3, d4), (d5, d6)) = (dots(a), dots(b), dots(c));
    let at = |weights: [f64; 3]| (a * weights[0] + b * weights[1] + c * weights[2], weights);
    if d1 <= 0.0 && d2 <= 0.0 {
        return at([1.0, 0.0, 0.0]);
    }
    if d3 >= 0.0 && d4 <= d3 {
        return at([0.0, 1.0, 0.0]);
    }
    if d6 >= 0.0 && d5 <= d6 {
        return at([0.0, 0.0, 1.0]);
    }
    let (of_c, of_b, of_a) = (d1 * d4 - d3 * d2, d5 * d2 - d1 * d6, d3 * d6 - d5 * d4);
    if of_c <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        let s = d1 / (d1 - d3);
        return at([1.0 - s, s, 0.0]);
    }
    if of_b <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        let s = d2 / (d2 - d6);
        return at([1.0 - s, 0.0, s]);
    }
    if of_a <= 0.0 && d4 >= d3 && d5 >= d6 {
        let s = (d4 - d3) / ((d4 - d3) + (d5 - d6));
        return at([0.0, 1.0 - s, s]);
    }
    let sum = of_a + of_b + of_c;
    at([of_a / sum, of_b / sum, of_c / sum])
}
