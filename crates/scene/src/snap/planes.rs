//! Planes in a mesh: regions of triangles that lie in one, but for noise.

use super::{Joints, NONE, Surface, height};
use glam::{DMat3, DVec2, DVec3};
use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen};

/// Degrees that a triangle may lean against its plane, beyond what noise of half a distance turns it by.
const LEANING: f64 = 25.0;
/// In distances: the least width of a region that is a plane, and of one with sharp borders, a side of a box.
const WIDE: f64 = 15.0;
const NARROW: f64 = 4.0;
/// In distances: the farthest that a corner is from its plane.
const NEAR: f64 = 1.5;
/// In distances: the least height of a triangle whose normal noise leaves much of.
const RELIABLE: f64 = 2.0;
/// Borders are sharp where normals differ by more degrees, and all are if this share of their length is.
const SHARP: f64 = 60.0;
const SHARP_SHARE: f64 = 0.75;
/// In distances: the largest root mean square of heights over a plane.
const ROUGH: f64 = 0.5;
/// A region curves if a paraboloid leaves less than this share of the mean square height over its plane, apart from what it fits of
/// noise, and is steeper than this at the border.
const UNEXPLAINED: f64 = 0.8;
const STEEP: f64 = 0.05;
/// Numbers of a paraboloid, and those of them that a plane has.
const PARABOLOID: usize = 6;
const FLAT: usize = 3;
/// Heights below this share of the extent are rounding.
const ROUNDING: f64 = 1e-9;
/// How often a region is found anew from its last plane.
const POLISHED: usize = 3;

/// A plane of a region of triangles.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub normal: DVec3,
    pub centre: DVec3,
    /// Widths along the widest direction and across.
    pub widths: [f64; 2],
    /// Root mean square height of the triangles' corners, m.
    pub rough: f64,
    /// Size of the coordinates, for rounding.
    pub extent: f64,
}

impl Plane {
    pub fn height(&self, place: DVec3) -> f64 {
        (place - self.centre).dot(self.normal)
    }

    /// The plane with the least mean square height of some triangles' corners, by area. Its normal is on the side of their fronts.
    pub fn fitted(surface: &Surface, triangles: &[u32]) -> Self {
        let mut weight = 0.0;
        let (mut centre, mut upright) = (DVec3::ZERO, DVec3::ZERO);
        for &t in triangles {
            let (normal, corners) = (surface.normal(t), surface.corners(t));
            let own = normal.length();
            weight += 3.0 * own;
            upright += normal;
            corners.iter().for_each(|c| centre += own * *c);
        }
        centre /= weight;
        let mut covariance = DMat3::ZERO;
        for &t in triangles {
            let own = surface.normal(t).length() / weight;
            for corner in surface.corners(t) {
                let from = corner - centre;
                covariance += DMat3::from_cols(from * from.x, from * from.y, from * from.z) * own;
            }
        }
        let decomposition = SymmetricEigen::new(Matrix3::from_column_slice(&covariance.to_cols_array()));
        let axes: [DVec3; 3] =
            std::array::from_fn(|k| DVec3::from_slice(decomposition.eigenvectors.column(k).as_slice()));
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| decomposition.eigenvalues[b].total_cmp(&decomposition.eigenvalues[a]));
        let [along, across, normal] = order.map(|k| axes[k]);
        // Of a single triangle the normal is exact.
        let normal = if triangles.len() == 1 { upright } else { normal * normal.dot(upright).signum() };
        let mut plane = Self {
            normal: normal.normalize_or(upright.normalize_or_zero()),
            centre,
            widths: [0.0; 2],
            rough: 0.0,
            extent: 0.0,
        };
        let (mut low, mut high) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
        let mut squares = 0.0;
        for &t in triangles {
            let own = surface.normal(t).length() / weight;
            for corner in surface.corners(t) {
                let from = corner - centre;
                let flat = DVec2::new(from.dot(along), from.dot(across));
                (low, high) = (low.min(flat), high.max(flat));
                squares += own * plane.height(corner).powi(2);
                plane.extent = plane.extent.max(corner.abs().max_element());
            }
        }
        plane.rough = squares.sqrt();
        plane.widths = (high - low).to_array();
        plane
    }
}

/// The planes of a surface.
pub(super) struct Planes {
    pub planes: Vec<Plane>,
    /// Per triangle, its plane or [`NONE`].
    pub of: Vec<u32>,
    /// Per triangle, whether its front is on the other side of the plane than the plane's normal.
    pub turned: Vec<bool>,
    /// Per plane, its triangles, ascending.
    pub triangles: Vec<Vec<u32>>,
}

impl Planes {
    /// Grows regions from the largest triangles on, and keeps those that are planes.
    pub fn of(surface: &Surface, joints: &Joints) -> Self {
        let count = surface.triangles.len();
        let mut growth = Growth {
            surface,
            joints,
            normals: (0..count as u32).map(|t| surface.normal(t).normalize_or_zero()).collect(),
            // The cosine of the steepest lean of each triangle.
            least: (0..count as u32).map(|t| least_cosine(surface, t)).collect(),
            taken: vec![false; count],
            visited: vec![0; count],
            round: 0,
        };
        let mut seeds: Vec<u32> = (0..count as u32).collect();
        let areas: Vec<f64> = seeds.iter().map(|&t| surface.normal(t).length()).collect();
        seeds.sort_by(|&a, &b| areas[b as usize].total_cmp(&areas[a as usize]).then(a.cmp(&b)));
        let mut tried = vec![false; count];
        let mut planes = Self {
            planes: Vec::new(),
            of: vec![NONE; count],
            turned: vec![false; count],
            triangles: Vec::new(),
        };
        for seed in seeds {
            if tried[seed as usize] || growth.taken[seed as usize] {
                continue;
            }
            let (mut region, plane) = growth.region(seed);
            region.iter().for_each(|&t| tried[t as usize] = true);
            if growth.is_plane(&region, &plane) {
                region.sort_unstable();
                for &t in &region {
                    growth.taken[t as usize] = true;
                    planes.of[t as usize] = planes.planes.len() as u32;
                }
                planes.planes.push(plane);
                planes.triangles.push(region);
            }
        }
        planes
    }

    /// Whether triangles lie in one plane.
    pub fn fit(surface: &Surface, triangles: &[u32]) -> Option<Plane> {
        let plane = Plane::fitted(surface, triangles);
        (plane.rough <= ROUGH * surface.distance).then_some(plane)
    }
}

fn least_cosine(surface: &Surface, triangle: u32) -> f64 {
    let noise = (surface.distance / (2.0 * height(surface.corners(triangle)))).atan();
    (LEANING.to_radians() + noise).cos().max(0.0)
}

struct Growth<'a> {
    surface: &'a Surface,
    joints: &'a Joints,
    normals: Vec<DVec3>,
    least: Vec<f64>,
    taken: Vec<bool>,
    /// Per triangle, the last round in which it joined.
    visited: Vec<u32>,
    round: u32,
}

impl Growth<'_> {
    fn fits(&self, plane: &Plane, t: u32) -> bool {
        !self.taken[t as usize]
            && self.normals[t as usize].dot(plane.normal) >= self.least[t as usize]
            && self
                .surface
                .corners(t)
                .iter()
                .all(|corner| plane.height(*corner).abs() <= NEAR * self.surface.distance)
    }

    /// The region around a triangle, and its plane, which is fitted each time that the region has doubled.
    fn region(&mut self, seed: u32) -> (Vec<u32>, Plane) {
        let mut region = vec![seed];
        let mut plane = Plane::fitted(self.surface, &region);
        loop {
            let before = region.len();
            self.extend(&mut region, &plane, 2 * before + 2);
            if region.len() == before {
                break;
            }
            plane = Plane::fitted(self.surface, &region);
        }
        // What joined early may lean against the final plane.
        for _ in 0..POLISHED {
            if !self.fits(&plane, seed) {
                break;
            }
            let mut anew = vec![seed];
            self.extend(&mut anew, &plane, usize::MAX);
            let same = anew.len() == region.len();
            plane = Plane::fitted(self.surface, &anew);
            region = anew;
            if same {
                break;
            }
        }
        (region, plane)
    }

    /// Adds neighbours that fit, to so many triangles at most.
    fn extend(&mut self, region: &mut Vec<u32>, plane: &Plane, most: usize) {
        self.round += 1;
        region.iter().for_each(|&t| self.visited[t as usize] = self.round);
        let mut next = 0;
        while next < region.len() && region.len() < most {
            for neighbour in self.joints.beyond[region[next] as usize] {
                if neighbour != NONE
                    && self.visited[neighbour as usize] != self.round
                    && self.fits(plane, neighbour)
                {
                    self.visited[neighbour as usize] = self.round;
                    region.push(neighbour);
                }
            }
            next += 1;
        }
    }

    /// Whether a region is large, and rough by noise alone.
    fn is_plane(&self, region: &[u32], plane: &Plane) -> bool {
        let [along, across] = plane.widths.map(|width| width / self.surface.distance);
        let width = along.min(across);
        let large = width >= WIDE || width >= NARROW && self.has_sharp_borders(region, plane);
        large
            && plane.rough <= ROUGH * self.surface.distance
            && (plane.rough <= ROUNDING * along.max(across) * self.surface.distance
                || !self.curves(region, plane))
    }

    /// Whether what lies beyond most of the border is at an angle, or nothing.
    fn has_sharp_borders(&self, region: &[u32], plane: &Plane) -> bool {
        let mut inside: Vec<u32> = region.to_vec();
        inside.sort_unstable();
        let least = SHARP.to_radians().cos();
        let reliable = |t: u32| height(self.surface.corners(t)) >= RELIABLE * self.surface.distance;
        let (mut sharp, mut all) = (0.0, 0.0);
        for &t in region {
            let corners = self.surface.corners(t);
            for (side, &beyond) in self.joints.beyond[t as usize].iter().enumerate() {
                if beyond != NONE && inside.binary_search(&beyond).is_ok() {
                    continue;
                }
                let length = corners[side].distance(corners[(side + 1) % 3]);
                all += length;
                if beyond == NONE
                    || reliable(beyond) && self.normals[beyond as usize].dot(plane.normal) < least
                {
                    sharp += length;
                }
            }
        }
        sharp >= SHARP_SHARE * all
    }

    /// Whether heights over the plane are those of a paraboloid rather than noise.
    fn curves(&self, region: &[u32], plane: &Plane) -> bool {
        let (u, v) = plane.normal.any_orthonormal_pair();
        let scale = 2.0 / plane.widths[0].max(plane.widths[1]);
        let mut joints: Vec<u32> = region.iter().flat_map(|&t| self.joints.triangles[t as usize]).collect();
        joints.sort_unstable();
        joints.dedup();
        let mut squares = SMatrix::<f64, PARABOLOID, PARABOLOID>::zeros();
        let mut heights = SVector::<f64, PARABOLOID>::zeros();
        let mut terms = Vec::with_capacity(joints.len());
        for &joint in &joints {
            let place = self.joints.places[joint as usize];
            let from = (place - plane.centre) * scale;
            let (x, y) = (from.dot(u), from.dot(v));
            let term = SVector::from([1.0, x, y, x * x, x * y, y * y]);
            let height = plane.height(place) * scale;
            squares += term * term.transpose();
            heights += term * height;
            terms.push((term, height));
        }
        let solved = |size: usize| {
            let part = squares.view((0, 0), (size, size)).into_owned();
            let right = heights.rows(0, size).into_owned();
            part.svd(true, true).solve(&right, 1e-9).ok()
        };
        let (Some(flat), Some(curved)) = (solved(FLAT), solved(PARABOLOID)) else { return false };
        let rest = |size: usize, numbers: &nalgebra::DVector<f64>| -> f64 {
            terms
                .iter()
                .map(|(term, height)| (height - term.rows(0, size).dot(&numbers.rows(0, size))).powi(2))
                .sum()
        };
        let (left_flat, left) = (rest(FLAT, &flat), rest(PARABOLOID, &curved));
        // What a paraboloid fits of noise alone, three times over.
        let noise = 3.0 * (PARABOLOID - FLAT) as f64 / terms.len() as f64;
        let steep = 2.0 * (curved[3].powi(2) + curved[4].powi(2) / 2.0 + curved[5].powi(2)).sqrt();
        left < (UNEXPLAINED - noise) * left_flat && steep > STEEP
    }
}
