//! Triangles too coarse for the light of lamps: a shadow, or the bright spot under a lamp, lies within them.
//!
//! What such a triangle reflects leaves it evenly. Its own irradiance is right, since direct light is exact, and so is its picture,
//! where direct light is gathered; what others receive from it is not.

use antirad_base::parallel;
use antirad_core::direct::{DirectLight, POINTS, at};
use antirad_core::model::{Facet, quarters};
use antirad_core::plan::Plan;
use antirad_scene::Scene;
use glam::DVec3;
use std::f64::consts::PI;

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
