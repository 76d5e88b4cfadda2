//! How far off an answer may be, from the answer itself and one of other settings.

use crate::Solution;
use crate::scene::Scene;
use glam::DVec3;
use serde::Serialize;
use std::collections::HashMap;
use std::fmt;

/// Estimated error of the irradiance: relative L2 over all triangles, weighted with area. Root of the sum of squares of its
/// parts, which have different causes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    pub total: f64,
    /// Difference from a solve with other bins and a smaller near field: of two errors that have nothing to do with each
    /// other the root of the sum of squares, so more than that of the better one.
    pub compared: f64,
    /// A quarter of how far triangles are off the mean of their coplanar neighbours: what the mean over a triangle
    /// differs from the value at its centroid.
    pub mesh: f64,
    /// The residual over 1 - spectral radius.
    pub residual: f64,
}

impl Estimate {
    /// `irradiance` and `companion` on the triangles of the scene as it was given (`areas`), `solution` on those of the
    /// scene as it was solved.
    pub(super) fn new(
        [irradiance, companion]: [&[[f64; 3]]; 2],
        areas: &[f64],
        scene: &Scene,
        solution: &Solution,
    ) -> Self {
        let all = norm(areas, |i| DVec3::from(irradiance[i]));
        let over = |error: f64| if all > 0.0 { error / all } else { 0.0 };
        let difference = |i: usize| DVec3::from(irradiance[i]) - DVec3::from(companion[i]);
        let compared = over(norm(areas, difference));
        let mesh = over(unevenness(scene, &solution.irradiance));
        let left = 1.0 - solution.info.spectral_radius.unwrap_or(0.0).clamp(0.0, 0.999);
        let residual = solution.info.residuals.last().copied().unwrap_or(0.0) / left;
        let total = (compared * compared + mesh * mesh + residual * residual).sqrt();
        Self { total, compared, mesh, residual }
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { total, compared, mesh, residual } = self;
        write!(
            f,
            "{:.2} % (other bins and near field {:.2} %, mesh {:.2} %, residual {:.2} %)",
            100.0 * total,
            100.0 * compared,
            100.0 * mesh,
            100.0 * residual
        )
    }
}

fn norm(areas: &[f64], of: impl Fn(usize) -> DVec3) -> f64 {
    areas.iter().enumerate().map(|(i, area)| area * of(i).length_squared()).sum::<f64>().sqrt()
}

/// Normals of neighbours that are closer than this count as one surface.
const COPLANAR: f64 = 0.999;

/// ‖(mean of the neighbours - own value) / 4‖. For light that is smooth within an equilateral triangle of side s, its mean is
/// off the value at the centroid by s²/48 ∇²E, and the mean of the three neighbours by s²/12 ∇²E.
fn unevenness(scene: &Scene, irradiance: &[[f64; 3]]) -> f64 {
    let count = scene.triangles.len();
    let vectors: Vec<DVec3> = (0..count).map(|i| scene.area_vector(i)).collect();
    let areas: Vec<f64> = vectors.iter().map(|v| v.length()).collect();
    let mut sharing: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
    for (i, triangle) in scene.triangles.iter().enumerate() {
        let [a, b, c] = triangle.vertices;
        for [p, q] in [[a, b], [b, c], [c, a]] {
            sharing.entry([p.min(q), p.max(q)]).or_default().push(i);
        }
    }
    let mut around = vec![(DVec3::ZERO, 0.0); count];
    for triangles in sharing.values() {
        let &[i, j] = triangles.as_slice() else { continue };
        if vectors[i].dot(vectors[j]) > COPLANAR * areas[i] * areas[j] {
            for (own, other) in [(i, j), (j, i)] {
                around[own].0 += DVec3::from(irradiance[other]);
                around[own].1 += 1.0;
            }
        }
    }
    norm(&areas, |i| match around[i] {
        (sum, neighbours) if neighbours > 0.0 => 0.25 * (sum / neighbours - DVec3::from(irradiance[i])),
        _ => DVec3::ZERO,
    })
}
