//! Triangles too coarse for the light of lamps: a shadow, or the bright spot under a lamp, lies within them.
//!
//! What such a triangle reflects leaves it evenly. Its own irradiance is right, since direct light is exact, and so is its picture,
//! where direct light is gathered; what others receive from it is not.

use antirad_base::parallel;
use antirad_core::direct::{DirectLight, Lamp, POINTS, Polygon, at, vector_irradiance};
use antirad_core::model::{Facet, quarters};
use antirad_core::plan::{Plan, direct_lamps};
use antirad_scene::Scene;
use glam::DVec3;
use std::f64::consts::PI;

/// Share of a triangle in the error of reflected light of lamps from which it is coarse by any standard, and that error, by such triangles,
/// from which a mesh is.
const COARSE_TRIANGLE: f64 = 0.03;
const COARSE_MESH: f64 = 0.1;

/// Share of the light of lamps that one triangle may receive, and from which a mesh is far too coarse: those of triangles about half as wide
/// as they are far from the only lamp, and as wide.
const MOST_OF_THE_LIGHT: f64 = 0.04;
const FAR_TOO_MUCH_LIGHT: f64 = 0.12;

/// Rays from a point, where they are distributed over many lamps: several points tell the light of a quarter.
const RAYS: u32 = 32;

/// Points and weights within each quarter of a triangle, in barycentric coordinates.
type Points<'a> = &'a [([f64; 3], f64)];

/// What triangles reflect of the light of lamps.
struct Reflected<'a> {
    scene: &'a Scene,
    facets: &'a [Facet],
    light: DirectLight,
    /// Radiance of each lamp, W/(m² sr).
    radiance: Vec<DVec3>,
}

impl<'a> Reflected<'a> {
    fn new(scene: &'a Scene, facets: &'a [Facet], light: DirectLight) -> Self {
        let radiance = light.radiance(|i| scene.material(i));
        Self { scene, facets, light, radiance }
    }

    /// Square of the mean of what a triangle reflects, and its variance over the quarters of the triangle.
    fn mean_and_variance(&self, triangle: usize, points: Points) -> [f64; 2] {
        let facet = &self.facets[triangle];
        let reflectance = DVec3::from(self.scene.material(triangle).diffuse_albedo()) / PI;
        if reflectance == DVec3::ZERO || facet.area <= 0.0 {
            return [0.0; 2];
        }
        let places: Vec<DVec3> = quarters(facet.corners)
            .into_iter()
            .flat_map(|quarter| points.iter().map(move |(b, _)| at(quarter, (*b).into())))
            .collect();
        let irradiance: Vec<DVec3> = self
            .light
            .at_points(self.facets, triangle, &places)
            .iter()
            .map(|of_lamps| {
                of_lamps.iter().map(|(l, phi)| phi.dot(facet.normal) * self.radiance[*l as usize]).sum()
            })
            .collect();
        let mean = |quarter: &[DVec3]| -> DVec3 {
            quarter.iter().zip(points).map(|(value, (_, weight))| *weight * *value).sum::<DVec3>()
                * reflectance
        };
        let of_quarters: Vec<DVec3> = irradiance.chunks_exact(points.len()).map(mean).collect();
        let whole = of_quarters.iter().sum::<DVec3>() / 4.0;
        let variance = of_quarters.iter().map(|of| (*of - whole).length_squared()).sum::<f64>() / 4.0;
        [whole.length_squared(), variance]
    }
}

/// Triangles whose share in the error of reflected light of lamps is above `limit`, with that share, the worst first.
///
/// The error is the relative L2 difference between what the quarters of triangles reflect and what the triangles do, weighted by area; the
/// share of a triangle is its error were it the only one.
pub fn uneven(scene: &Scene, plan: &Plan, limit: f64) -> Vec<(u32, f64)> {
    if plan.lamps().is_empty() {
        return Vec::new();
    }
    let facets = plan.facets();
    let light =
        DirectLight::of_points(facets, plan.lamps().to_vec(), plan.visibility(), |i| scene.material(i));
    let reflected = Reflected::new(scene, facets, light.with_rays(RAYS));
    let all: Vec<[f64; 2]> = parallel::map(0..facets.len(), |i| reflected.mean_and_variance(i, &POINTS));
    let square: f64 = all.iter().zip(facets).map(|([square, _], facet)| square * facet.area).sum();
    let share = |(i, [_, variance]): (usize, &[f64; 2])| {
        (i as u32, (variance * facets[i].area / square.max(f64::MIN_POSITIVE)).sqrt())
    };
    let mut found: Vec<(u32, f64)> =
        all.iter().enumerate().map(share).filter(|(_, share)| *share > limit).collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found
}

/// Triangles that would receive more than 4 % of all light of lamps other than suns if nothing stood between, ascending.
pub fn flooded(scene: &Scene) -> Vec<u32> {
    let (facets, lamps, _) = direct_lamps(scene);
    let emitted = Emitted::new(scene, &facets, &lamps);
    let all = 0..facets.len() as u32;
    parallel::filter(all, |&i| emitted.share(i as usize) > MOST_OF_THE_LIGHT)
}

/// The light that lamps other than suns emit, as if nothing stood in its way.
struct Emitted<'a> {
    scene: &'a Scene,
    facets: &'a [Facet],
    lamps: Vec<Source>,
    power: f64,
}

/// A lamp as points between its centre and its corners, or as its centre alone if it is a solid.
struct Source {
    /// None of a solid, which shines all around.
    normal: Option<DVec3>,
    power: f64,
    points: Vec<DVec3>,
}

impl<'a> Emitted<'a> {
    fn new(scene: &'a Scene, facets: &'a [Facet], lamps: &[Lamp]) -> Self {
        // Suns light all of a triangle alike.
        let source = |lamp: &Polygon| {
            let corner = |&[i, k]: &[u32; 2]| facets[i as usize].corners[k as usize];
            let corners: Vec<DVec3> = lamp.corners.iter().map(corner).collect();
            let centre = corners.iter().sum::<DVec3>() / corners.len() as f64;
            let area: f64 = lamp.triangles.iter().map(|&i| facets[i as usize].area).sum();
            let solid = lamp.solid.is_some();
            Source {
                normal: (!solid).then(|| facets[lamp.first()].normal),
                power: area * scene.material(lamp.first()).emission.iter().sum::<f64>(),
                points: match solid {
                    true => vec![centre],
                    false => corners.iter().map(|corner| 0.5 * (corner + centre)).collect(),
                },
            }
        };
        let lamps: Vec<Source> = lamps.iter().filter_map(Lamp::surface).map(source).collect();
        Self { scene, facets, power: lamps.iter().map(|lamp| lamp.power).sum(), lamps }
    }

    /// The share that a triangle receives, by form factors from the points of lamps; none if it reflects nothing.
    fn share(&self, triangle: usize) -> f64 {
        let receiver = &self.facets[triangle];
        if self.lamps.is_empty() || self.scene.material(triangle).diffuse_albedo() == [0.0; 3] {
            return 0.0;
        }
        let form_factor = |point: DVec3, normal: Option<DVec3>| {
            let sides = (0..3).map(|k| (0, [k, (k + 1) % 3].map(|k| receiver.corners[k] - point)));
            // Seen from its front, a triangle runs the other way than the cone that it closes.
            let flux = vector_irradiance(sides);
            normal.map_or(flux.length() / (4.0 * PI), |normal| (-flux.dot(normal) / PI).max(0.0))
        };
        let from = |lamp: &Source| {
            let faces = |point: &&DVec3| (**point - receiver.centroid).dot(receiver.normal) > 0.0;
            let sum: f64 = lamp.points.iter().filter(faces).map(|p| form_factor(*p, lamp.normal)).sum();
            lamp.power * sum / lamp.points.len() as f64
        };
        self.lamps.iter().map(from).sum::<f64>() / self.power
    }
}

/// Whether the mesh of a scene is so coarse for the light of its exact lamps that it is better cut before a solve: one triangle would receive
/// 12 % of all light of lamps, or what the worst triangles reflect, evenly, is off by 10 % of all reflected light of lamps or
/// more (relative L2 norm).
///
/// Far quicker than [`Warnings::with_shadows`](super::Warnings::with_shadows): it looks at one point of each quarter of those
/// triangles alone that may have a share of 3 % in that error, by the light that would reach them without shadows.
pub fn too_coarse(scene: &Scene) -> bool {
    const CENTROIDS: [([f64; 3], f64); 1] = [([1.0 / 3.0; 3], 1.0)];
    let (facets, lamps, visibility) = direct_lamps(scene);
    if lamps.is_empty() {
        return false;
    }
    let emitted = Emitted::new(scene, &facets, &lamps);
    let is_flooded = |i: usize| emitted.share(i) > FAR_TOO_MUCH_LIGHT;
    if parallel::map(0..facets.len(), is_flooded).contains(&true) {
        return true;
    }
    let light = DirectLight::of_points(&facets, lamps, visibility, |i| scene.material(i)).with_rays(RAYS);
    let unoccluded = Reflected::new(scene, &facets, light.clone().unblocked(&facets));
    let square = |i: usize| unoccluded.mean_and_variance(i, &CENTROIDS)[0] * facets[i].area;
    let squares: Vec<f64> = parallel::map(0..facets.len(), square);
    let all: f64 = squares.iter().sum();
    // A triangle of which one quarter alone is lit has a variance of three times its squared mean.
    let may_be_coarse = |i: &usize| 3.0 * squares[*i] > COARSE_TRIANGLE * COARSE_TRIANGLE * all;
    let candidates: Vec<usize> = (0..facets.len()).filter(may_be_coarse).collect();
    let reflected = Reflected::new(scene, &facets, light);
    let of_candidate = |&i: &usize| reflected.mean_and_variance(i, &CENTROIDS).map(|x| x * facets[i].area);
    let found: Vec<[f64; 2]> = parallel::map(&candidates, of_candidate);
    let of_candidates: f64 = candidates.iter().map(|&i| squares[i]).sum();
    let lit = found.iter().map(|[square, _]| square).sum::<f64>() / of_candidates;
    let coarse = |variance: &f64| *variance > COARSE_TRIANGLE * COARSE_TRIANGLE * lit * all;
    let error: f64 = found.iter().map(|[_, variance]| *variance).filter(coarse).sum();
    error > COARSE_MESH * COARSE_MESH * lit * all
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::{Lamps, LoadOptions};
    use std::path::Path;

    #[test]
    fn walls_of_two_triangles_are_too_coarse() {
        let load = |name: &str| {
            let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(name);
            Scene::load(&path, &LoadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
        };
        assert!(too_coarse(&load("coarse_cornell.toml")));
        assert!(!too_coarse(&load("cornell_boxes.toml")));
        // Where lamps go through bins, nothing is known of their shadows.
        let mut blurred = load("coarse_cornell.toml");
        blurred.settings.lamps = Lamps::Antiradiance;
        assert!(!too_coarse(&blurred));
    }
}
