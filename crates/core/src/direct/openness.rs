//! How open the parts of a triangle lie, by which its light is spread over it.
//!
//! The irradiance of a triangle is a mean. Where a part is covered, as a board is by books, that part is dark, and draws the plain mean down;
//! but what leaves the triangle for the rest of the scene leaves from the other parts. So light is taken to vary as the openness o_p of
//! parts p: of the rays that leave a part, as many in each direction as the cosine asks for, the share that meets nothing close by, and
//! no back. With one number E per triangle (Galerkin's method),
//!
//! E = Σ_p o_p E_p / Σ_p o_p,    E_p = φ_p E,    φ_p = o_p Σo / Σo².
//!
//! What a triangle sends far away is then right to first order, and what its covered parts send is little. The two o_p are by rays of their
//! own, so that their noise has no part in the mean of Σo². Triangles whose parts are equally open have even light, and so have emitters.

use super::sampling::from_front;
use crate::model::{Facet, quarters};
use antirad_base::parallel;
use antirad_scene::Rays;
use glam::{DVec3, Vec3Swizzles};

/// Times that a triangle is cut into quarters, and its parts.
const CUTS: u32 = 2;
const PARTS: usize = 1 << (2 * CUTS);
/// What is closer than this many sizes of the triangle covers it.
const CLOSE: f64 = 0.5;
/// Rays of a part: a few for all; more where these meet something close by, and still more, twice, where some parts are covered.
const FEW: [u32; 2] = [2, 4];
const MORE: u32 = 8;
/// Openness of parts that are wholly covered: these have to count where all are.
const LEAST: f64 = 0.02;
/// (Σo)² / (n Σo²) from which parts count as equally open.
const EVEN: f64 = 0.9;

/// Openness of the parts of triangles, and what is lost of the light that these send.
#[derive(Clone, Debug, Default)]
pub struct Openness {
    /// Of each triangle; `None` where its light is even.
    parts: Vec<Option<Parts>>,
    lost: Vec<Lost>,
}

/// Shares of the light that a triangle sends.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lost {
    /// What falls on backs.
    pub on_backs: f64,
    /// What meets nothing.
    pub escaped: f64,
}

/// What the parts of a triangle count, in the order of [`quarters`].
#[derive(Clone, Debug)]
pub struct Parts {
    /// o_p over its mean.
    weights: [f64; PARTS],
    /// φ_p.
    leaves: [f64; PARTS],
}

/// What rays from the parts of a triangle meet, as shares of those of each part.
struct Met {
    open: [f64; PARTS],
    backs: [f64; PARTS],
    nothing: [f64; PARTS],
}

impl Openness {
    /// Looks around from all triangles. `emits`: those that do.
    pub fn new(facets: &[Facet], rays: &Rays, emits: impl Fn(usize) -> bool + Sync) -> Self {
        let of = |i: usize| match facets[i].area > 0.0 {
            true => looked(facets, rays, i, emits(i)),
            false => (None, Lost::default()),
        };
        let (parts, lost) = parallel::map(0..facets.len(), of).into_iter().unzip();
        Self { parts, lost }
    }

    /// What the parts of a triangle count; `None` where its light is even.
    pub fn of(&self, triangle: usize) -> Option<&Parts> {
        self.parts.get(triangle)?.as_ref()
    }

    /// What is lost of the light that a triangle sends, by few rays.
    pub fn lost(&self, triangle: usize) -> Lost {
        self.lost.get(triangle).copied().unwrap_or_default()
    }

    /// The mean of φ: the area that receives and sends E, as a share of that of the triangle.
    pub fn share(&self, triangle: usize) -> f64 {
        self.of(triangle).map_or(1.0, |parts| mean(&parts.leaves))
    }
}

impl Parts {
    /// The weight of what arrives at a point, by its barycentric coordinates.
    pub fn weight(&self, barycentric: DVec3) -> f64 {
        self.weights[part(barycentric)]
    }

    /// What leaves from a point, as a share of the radiance of the triangle.
    pub fn leaves(&self, barycentric: DVec3) -> f64 {
        self.leaves[part(barycentric)]
    }
}

fn looked(facets: &[Facet], rays: &Rays, triangle: usize, emits: bool) -> (Option<Parts>, Lost) {
    let look = |count: u32, seed: usize| Met::new(facets, rays, triangle, (count, seed));
    let [few, some] = FEW;
    let few = look(few, 0);
    let even = (None, few.lost(&[1.0; PARTS]));
    // No parts are less even than those of which as many are wholly open, and the others covered.
    if emits || mean(&few.open) >= EVEN {
        return even;
    }
    let some = look(some, 1).open;
    if share(&some, &some) >= EVEN {
        return even;
    }
    let [first, second] = [2, 3].map(|seed| look(MORE, seed));
    let share = share(&first.open, &second.open);
    if share >= EVEN {
        return even;
    }
    let scaled = |open: [f64; PARTS], by: f64| open.map(|o| by * o / mean(&open));
    let leaves = scaled(second.open, share);
    (Some(Parts { weights: scaled(first.open, 1.0), leaves }), second.lost(&leaves))
}

impl Met {
    /// By so many rays from each part, others for another seed.
    fn new(facets: &[Facet], rays: &Rays, triangle: usize, (count, seed): (u32, usize)) -> Self {
        let close = CLOSE * facets[triangle].characteristic_area.sqrt();
        let [mut open, mut backs, mut nothing] = [[0.0; PARTS]; 3];
        let one = 1.0 / f64::from(count);
        for (part, corners) in parts(facets[triangle].corners).into_iter().enumerate() {
            let number = (seed * facets.len() + triangle) * PARTS + part;
            for (origin, towards) in from_front(&Facet::new(corners), number as u64, 0..count) {
                match rays.nearest(origin, towards, Some(triangle)) {
                    None => {
                        nothing[part] += one;
                        open[part] += one;
                    }
                    Some((met, _)) if towards.dot(facets[met].normal) >= 0.0 => backs[part] += one,
                    Some((_, distance)) if distance > close => open[part] += one,
                    Some(_) => {}
                }
            }
            open[part] = open[part].max(LEAST);
        }
        Self { open, backs, nothing }
    }

    /// What is lost where so much leaves from parts.
    fn lost(&self, leaves: &[f64; PARTS]) -> Lost {
        let of = |met: &[f64; PARTS]| mean_product(met, leaves);
        Lost { on_backs: of(&self.backs), escaped: of(&self.nothing) }
    }
}

/// (Σo)² / (n Σo²), by two estimates of o.
fn share(a: &[f64; PARTS], b: &[f64; PARTS]) -> f64 {
    mean(a) * mean(b) / mean_product(a, b)
}

fn mean(values: &[f64; PARTS]) -> f64 {
    values.iter().sum::<f64>() / PARTS as f64
}

fn mean_product(a: &[f64; PARTS], b: &[f64; PARTS]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>() / PARTS as f64
}

/// The corners of the parts of a triangle.
fn parts(corners: [DVec3; 3]) -> Vec<[DVec3; 3]> {
    (0..CUTS).fold(vec![corners], |parts, _| parts.into_iter().flat_map(quarters).collect())
}

/// The part at a point, by its barycentric coordinates.
fn part(mut barycentric: DVec3) -> usize {
    let mut part = 0;
    for _ in 0..CUTS {
        let corner = (0..3).find(|&k| barycentric[k] >= 0.5);
        part = 4 * part + corner.unwrap_or(3);
        barycentric = match corner {
            Some(k) => 2.0 * barycentric - DVec3::AXES[k],
            // The corners of the middle quarter lie opposite those of the triangle, the third first.
            None => (1.0 - 2.0 * barycentric).zxy(),
        };
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{centroid, rays_among};

    #[test]
    fn points_lie_in_their_parts() {
        let corners = [DVec3::X, DVec3::Y, DVec3::Z];
        for (number, corners) in parts(corners).into_iter().enumerate() {
            assert_eq!(part(centroid(corners)), number);
            for corner in corners {
                assert_eq!(part(0.9 * corner + 0.1 * centroid(corners)), number);
            }
        }
    }

    /// A third of a floor under a board: the rest counts, and all of it where it emits.
    #[test]
    fn covered_parts_count_little() {
        let floor = Facet::new([DVec3::ZERO, 2.0 * DVec3::X, 2.0 * DVec3::Y]);
        // Above its first corner, facing down.
        let board = [[-1.0, -1.0], [-1.0, 2.2], [2.2, -1.0]].map(|[x, y]| DVec3::new(x, y, 0.01));
        let facets = [floor, Facet::new(board)];
        let rays = rays_among(&facets);
        let openness = Openness::new(&facets, &rays, |_| false);
        let parts = openness.of(0).expect("an uneven triangle");
        let (covered, open) = (DVec3::new(0.8, 0.1, 0.1), DVec3::new(0.1, 0.45, 0.45));
        assert!(parts.weight(open) > 4.0 * parts.weight(covered));
        assert!(parts.leaves(open) > 4.0 * parts.leaves(covered));
        let galerkin = mean_product(&parts.weights, &parts.leaves);
        assert!((galerkin - 1.0).abs() <= 1e-12, "{galerkin}");
        assert!((0.2..0.9).contains(&openness.share(0)), "{}", openness.share(0));
        assert!(Openness::new(&facets, &rays, |_| true).of(0).is_none());
    }
}
