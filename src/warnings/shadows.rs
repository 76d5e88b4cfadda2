//! Triangles too coarse for the light of lamps: a shadow, or the bright spot under a lamp, lies within them.
//!
//! What such a triangle reflects leaves it evenly. Its own irradiance is right, since direct light is exact, and so is its picture,
//! where direct light is gathered; what others receive from it is not.

use crate::direct::{DirectLight, POINTS, at};
use crate::model::quarters;
use crate::plan::Plan;
use crate::scene::Scene;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Triangles whose share in the error of reflected light of lamps is above `limit`, with that share, the worst first.
///
/// The error is the relative L2 difference between what the quarters of triangles reflect and what the triangles do, weighted by area; the
/// share of a triangle is its error were it the only one.
pub fn uneven(scene: &Scene, plan: &Plan, limit: f64) -> Vec<(u32, f64)> {
    if plan.lamps().is_empty() {
        return Vec::new();
    }
    let facets = plan.facets();
    let light = DirectLight::of_points(facets, plan.lamps().to_vec());
    let radiance = light.radiance(|i| scene.material(i));
    // Mean square of what a triangle reflects, and the variance over its quarters.
    let of_triangle = |i: usize| -> [f64; 2] {
        let facet = &facets[i];
        let reflectance = DVec3::from(scene.material(i).diffuse_albedo()) / PI;
        if reflectance == DVec3::ZERO || facet.area <= 0.0 {
            return [0.0; 2];
        }
        let points: Vec<DVec3> = quarters(facet.corners)
            .into_iter()
            .flat_map(|quarter| POINTS.map(|(b, _)| at(quarter, b.into())))
            .collect();
        let irradiance: Vec<DVec3> = light
            .at_points(facets, i, &points)
            .iter()
            .map(|of_lamps| of_lamps.iter().zip(&radiance).map(|(phi, l)| phi.dot(facet.normal) * *l).sum())
            .collect();
        let mean = |quarter: &[DVec3]| -> DVec3 {
            quarter.iter().zip(&POINTS).map(|(value, (_, weight))| *weight * *value).sum::<DVec3>()
                * reflectance
        };
        let of_quarters: Vec<DVec3> = irradiance.chunks_exact(POINTS.len()).map(mean).collect();
        let whole = of_quarters.iter().sum::<DVec3>() / 4.0;
        let variance = of_quarters.iter().map(|of| (*of - whole).length_squared()).sum::<f64>() / 4.0;
        [whole.length_squared(), variance]
    };
    let all: Vec<[f64; 2]> = (0..facets.len()).into_par_iter().map(of_triangle).collect();
    let square: f64 = all.iter().zip(facets).map(|([square, _], facet)| square * facet.area).sum();
    let share = |(i, [_, variance]): (usize, &[f64; 2])| {
        (i as u32, (variance * facets[i].area / square.max(f64::MIN_POSITIVE)).sqrt())
    };
    let mut found: Vec<(u32, f64)> =
        all.iter().enumerate().map(share).filter(|(_, share)| *share > limit).collect();
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found
}
