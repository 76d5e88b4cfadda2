//! How far off an answer may be, from the answer itself and one of other settings.

use crate::scene::{Edges, Scene, Welded};
use crate::{Energy, Solution};
use glam::DVec3;
use serde::Serialize;
use std::fmt;

/// Estimated error of the irradiance: relative L2 over all triangles, weighted with area.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Estimate {
    /// Root of the sum of squares of `compared`, `mesh` and `residual`, which have different causes; at least `balance`.
    pub total: f64,
    /// Difference from a solve with other bins and a smaller near field, times what errors were over such differences in
    /// scenes whose answer is known.
    pub compared: f64,
    /// A quarter of how far triangles are off the mean of their coplanar neighbours: what the mean over a triangle
    /// differs from the value at its centroid.
    pub mesh: f64,
    /// The residual over 1 - spectral radius.
    pub residual: f64,
    /// What is emitted and not absorbed, of all that is emitted, if the scene is closed, so that it should be nothing.
    pub balance: Option<f64>,
}

impl Estimate {
    /// `irradiance` and `companion` on the triangles of the scene as it was given (`areas`), `solution` on those of the
    /// scene as it was solved; `ratio`: see [`Estimate::compared`].
    pub(super) fn new(
        [irradiance, companion]: [&[[f64; 3]]; 2],
        ratio: f64,
        areas: &[f64],
        scene: &Scene,
        solution: &Solution,
    ) -> Self {
        let all = norm(areas, |i| DVec3::from(irradiance[i]));
        let over = |error: f64| if all > 0.0 { error / all } else { 0.0 };
        let difference = |i: usize| DVec3::from(irradiance[i]) - DVec3::from(companion[i]);
        let compared = ratio * over(norm(areas, difference));
        let mesh = over(unevenness(scene, &solution.irradiance));
        let left = 1.0 - solution.info.spectral_radius.unwrap_or(0.0).clamp(0.0, 0.999);
        let residual = solution.info.residuals.last().copied().unwrap_or(0.0) / left;
        let parts = (compared * compared + mesh * mesh + residual * residual).sqrt();
        let sum = |rgb: [f64; 3]| rgb.iter().sum::<f64>();
        let escaped =
            |energy: &Energy| (sum(energy.escaped) / sum(energy.emitted).max(f64::MIN_POSITIVE)).abs();
        let balance = is_closed(scene).then(|| escaped(&solution.energy));
        Self { total: balance.map_or(parts, |balance| parts.max(balance)), compared, mesh, residual, balance }
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { total, compared, mesh, residual, balance } = self;
        write!(
            f,
            "{:.2} % (other bins and near field {:.2} %, mesh {:.2} %, residual {:.2} %",
            100.0 * total,
            100.0 * compared,
            100.0 * mesh,
            100.0 * residual
        )?;
        match balance {
            Some(balance) => write!(f, ", energy {:.2} %)", 100.0 * balance),
            None => f.write_str(")"),
        }
    }
}

fn norm(areas: &[f64], of: impl Fn(usize) -> DVec3) -> f64 {
    areas.iter().enumerate().map(|(i, area)| area * of(i).length_squared()).sum::<f64>().sqrt()
}

/// Whether no light can leave: all edges are shared by triangles that run them both ways, and the fronts enclose something.
/// A box that stands on a floor without a bottom of its own makes a room look open, which costs the check, no more.
fn is_closed(scene: &Scene) -> bool {
    let volume = |triangle: usize| {
        let [a, b, c] = scene.corners(triangle);
        a.dot(b.cross(c)) / 6.0
    };
    let volume: f64 = (0..scene.triangles.len()).map(volume).sum();
    let welded = Welded::exactly(scene.vertices.iter().copied());
    let edges = Edges::of(scene.triangles.iter().map(|t| welded.positions(t.vertices)));
    volume < 0.0 && edges.iter().all(|edge| edge.balance() == 0)
}

/// Normals of neighbours that are closer than this count as one surface.
const COPLANAR: f64 = 0.999;

/// ‖(mean of the neighbours - own value) / 4‖. For light that is smooth within an equilateral triangle of side s, its mean is
/// off the value at the centroid by s²/48 ∇²E, and the mean of the three neighbours by s²/12 ∇²E.
fn unevenness(scene: &Scene, irradiance: &[[f64; 3]]) -> f64 {
    let count = scene.triangles.len();
    let vectors: Vec<DVec3> = (0..count).map(|i| scene.area_vector(i)).collect();
    let areas: Vec<f64> = vectors.iter().map(|v| v.length()).collect();
    let mut around = vec![(DVec3::ZERO, 0.0); count];
    for edge in Edges::of(scene.triangles.iter().map(|t| t.vertices)).iter() {
        let Some([i, j]) = edge.pair().map(|pair| pair.map(|t| t as usize)) else { continue };
        if vectors[i].dot(vectors[j]) > COPLANAR * areas[i] * areas[j] {
            for (own, other) in [(i, j), (j, i)] {
                around[own].0 += DVec3::from(irradiance[other]);
                around[own].1 += 1.0;
            }
        }
    }
    norm(&areas, |i| match around[i] {
        // At the rim a slope would look like a bend.
        (sum, neighbours) if neighbours == 3.0 => 0.25 * (sum / neighbours - DVec3::from(irradiance[i])),
        _ => DVec3::ZERO,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Material, SceneBuilder, Shape, Triangle};
    use glam::DAffine3;

    fn scene(shape: Shape) -> Scene {
        let mut builder = SceneBuilder::new();
        builder.shape("shape", shape, &Material::named("grey"), DAffine3::IDENTITY);
        builder.finish("scene").expect("a scene")
    }

    #[test]
    fn rooms_are_closed_and_boxes_and_sheets_are_not() {
        assert!(is_closed(&scene(Shape::Room { cells: 3 })));
        assert!(!is_closed(&scene(Shape::Box { cells: 3 })));
        assert!(!is_closed(&scene(Shape::Quad { cells: 3 })));
        // What has no area closes nothing and opens nothing.
        let mut room = scene(Shape::Room { cells: 3 });
        room.triangles[0].vertices = [0, 1, 1];
        assert!(!is_closed(&room));
        let mut room = scene(Shape::Room { cells: 3 });
        room.triangles.extend([[0, 0, 0], [0, 1, 1]].map(|vertices| Triangle { vertices, material: 0 }));
        assert!(is_closed(&room));
    }

    /// E = x² over a square of n x n cells: the mean over a triangle with legs h is h²/18 off the value at its centroid.
    #[test]
    fn unevenness_is_that_of_the_mean_over_a_triangle() {
        for cells in [8, 32] {
            let scene = scene(Shape::Quad { cells });
            let at = |i: usize| (scene.corners(i).iter().sum::<DVec3>() / 3.0).x.powi(2);
            let values: Vec<[f64; 3]> = (0..scene.triangles.len()).map(|i| [at(i), 0.0, 0.0]).collect();
            let exact = (1.0 / f64::from(cells)).powi(2) / 18.0;
            let found = unevenness(&scene, &values);
            println!("{cells} cells: {found:.2e}, exact {exact:.2e}");
            assert!(found / exact >= 0.5 && found / exact <= 2.0, "{found} {exact}");
        }
    }
}
