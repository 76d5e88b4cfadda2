//! Finds triangles that no light reaches, because others enclose them: the foot of a wall in a box without a bottom that stands there.
//!
//! Around them are the backs of what encloses them, and the fronts of triangles that are enclosed with them.

use super::Scene;
use super::contacts::TOLERANCE;
use antirad_base::parallel;
use antirad_rays::{Rays, Side};

/// Rays of a triangle, and the share of them that must meet something if it is enclosed.
const RAYS: u32 = 64;
const MET: f64 = 0.4;
/// The share that must meet backs: in the corner of a room, behind a cupboard, floor and walls take three quarters of the view.
const BACKS: f64 = 0.2;
/// Radians.
const GOLDEN_ANGLE: f64 = 2.399_963;

impl Scene {
    /// Whether each triangle is one of these, or is seen from one, and is enclosed: by backs, and besides by nothing but others that are, too.
    pub(super) fn covered(&self, of: Vec<u32>) -> Vec<bool> {
        let rays = self.rays();
        let lift = 2.0 * TOLERANCE * self.diagonal();
        // All are taken for enclosed that are not known to be in the open.
        let mut enclosed = vec![true; self.triangles.len()];
        let mut looked = vec![false; self.triangles.len()];
        let mut suspects: Vec<(u32, Vec<usize>)> = Vec::new();
        let mut next = of;
        while !next.is_empty() {
            let around: Vec<_> = parallel::map(&next, |&t| self.fronts_around(t as usize, &rays, lift));
            for (t, fronts) in next.drain(..).zip(around) {
                looked[t as usize] = true;
                enclosed[t as usize] = fronts.is_some();
                suspects.extend(fronts.map(|fronts| (t, fronts)));
            }
            // What sees the open is in it.
            let mut known = usize::MAX;
            while known > suspects.len() {
                known = suspects.len();
                suspects.retain(|(t, fronts)| {
                    enclosed[*t as usize] = fronts.iter().all(|&front| enclosed[front]);
                    enclosed[*t as usize]
                });
            }
            next.extend(
                suspects
                    .iter()
                    .flat_map(|(_, fronts)| fronts)
                    .map(|&t| t as u32)
                    .filter(|&t| !looked[t as usize]),
            );
            next.sort_unstable();
            next.dedup();
        }
        enclosed.iter().zip(looked).map(|(enclosed, looked)| *enclosed && looked).collect()
    }

    /// The triangles whose fronts a triangle sees, if it sees enough backs and nothing that shines.
    fn fronts_around(&self, triangle: usize, rays: &Rays, lift: f64) -> Option<Vec<usize>> {
        let normal = self.area_vector(triangle).try_normalize()?;
        let (u, v) = normal.any_orthonormal_pair();
        let [a, b, c] = self.corners(triangle);
        let origin = (a + b + c) / 3.0 + lift * normal;
        let (mut backs, mut fronts) = (0.0, Vec::new());
        for k in 0..RAYS {
            // A spiral of even density over the projected hemisphere.
            let radius = ((f64::from(k) + 0.5) / f64::from(RAYS)).sqrt();
            let (sin, cos) = (f64::from(k) * GOLDEN_ANGLE).sin_cos();
            let direction = radius * (cos * u + sin * v) + (1.0 - radius * radius).sqrt() * normal;
            match rays.first_side(origin, direction, triangle) {
                Some(Side::Front(front)) if self.shines(front) => return None,
                Some(Side::Front(front)) => fronts.push(front),
                Some(Side::Back) => backs += 1.0,
                None => {}
            }
        }
        let (all, met) = (f64::from(RAYS), backs + fronts.len() as f64);
        fronts.sort_unstable();
        fronts.dedup();
        (backs >= BACKS * all && met >= MET * all).then_some(fronts)
    }
}

#[cfg(test)]
mod tests {
    use crate::{Material, Scene, SceneBuilder, Shape};
    use glam::{DAffine3, DVec3};

    /// A room of four cells a side, and in it a box that is open below and where it touches walls.
    fn cupboard(low: [f64; 3], high: [f64; 3]) -> Scene {
        let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
        let mut builder = SceneBuilder::new();
        builder.shape("room", Shape::Room { cells: 4 }, &grey, DAffine3::IDENTITY);
        let corners = (0..8).map(|k| {
            let of = |axis: usize| if k >> axis & 1 == 0 { low[axis] } else { high[axis] };
            DVec3::new(of(0), of(1), of(2))
        });
        let quads = [[0, 4, 6, 2], [1, 3, 7, 5], [2, 6, 7, 3], [0, 2, 3, 1], [4, 5, 7, 6]];
        let inner = |quad: &&[u32; 4]| {
            let at = |axis: usize, value: f64| {
                quad.iter().all(|k| [low, high][(k >> axis & 1) as usize][axis] == value)
            };
            !(at(0, 0.0) || at(2, 0.0))
        };
        let faces = quads.iter().filter(inner).flat_map(|&[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        builder.mesh("cupboard", corners.collect(), faces, &grey, DAffine3::IDENTITY);
        builder.finish("room").expect("a scene")
    }

    /// A box without a bottom: what is behind it sees the floor in it, and the floor what is behind it.
    #[test]
    fn what_a_box_encloses_is_left_out() {
        let area = |scene: &Scene| -> f64 {
            scene.meshes[0].range.clone().map(|t| scene.area_vector(t as usize).length()).sum()
        };
        for (low, high, behind) in [
            ([0.3, 0.0, 0.3], [0.7, 0.5, 0.6], 0.4 * 0.3),
            ([0.0, 0.0, 0.3], [0.3, 0.6, 0.67], 0.3 * 0.37 + 0.6 * 0.37),
            ([0.0, 0.0, 0.0], [0.3, 0.6, 0.37], 0.3 * 0.37 + 0.6 * 0.37 + 0.3 * 0.6),
        ] {
            let mut scene = cupboard(low, high);
            let before = area(&scene);
            let parents = scene.cut_along_contacts(10_000);
            assert_eq!(parents.len(), scene.triangles.len());
            let gone = before - area(&scene);
            assert!((gone - behind).abs() <= 0.01 * behind, "{low:?}: {gone} instead of {behind}");
        }
    }

    /// A lamp in it lights what it encloses.
    #[test]
    fn what_is_lit_stays() {
        let dark = cupboard([0.0, 0.0, 0.3], [0.3, 0.6, 0.67]);
        let count = |scene: &Scene| scene.clone().cut_along_contacts(10_000).len();
        let mut lit = dark.clone();
        lit.materials.push(Material { emission: [1.0; 3], ..Material::named("lamp") });
        let inside = |scene: &Scene, t: usize| {
            let middle = scene.corners(t).iter().sum::<DVec3>() / 3.0;
            middle.x == 0.0 && middle.y < 0.4 && middle.z > 0.4 && middle.z < 0.6
        };
        let lamp = (0..lit.triangles.len()).find(|&t| inside(&lit, t)).expect("a triangle of the wall");
        lit.triangles[lamp].material = lit.materials.len() as u32 - 1;
        assert!(count(&lit) > count(&dark));
    }
}
