//! A shadow in closed form.

use super::{DOWN, square};
use antirad_core::model::projected_solid_angle;
use antirad_scene::{Material, Scene, SceneBuilder, SceneError, Shape};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// A square lamp 2 m above a floor of 2 x 2 m, with a square blocker of 0.8 x 0.8 m in 12 x 12 cells between them, all black but
/// the lamp.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shadow {
    /// Side of the lamp, m.
    pub lamp: f64,
    /// Height of the blocker above the floor, m.
    pub height: f64,
}

impl Shadow {
    const LAMP_HEIGHT: f64 = 2.0;
    const RADIANCE: f64 = 10.0;
    /// Half the side of the blocker, m.
    const BLOCKER: f64 = 0.4;

    /// Meshes "floor", "blocker" and "lamp".
    pub fn scene(&self) -> Result<Scene, SceneError> {
        let black = Material::named("black");
        let light = Material { emission: [Self::RADIANCE; 3], ..Material::named("lamp") };
        let mut builder = SceneBuilder::new();
        builder
            .shape("floor", Shape::Quad { cells: 24 }, &black, square(2.0, 0.0))
            .shape("blocker", Shape::Quad { cells: 12 }, &black, square(2.0 * Self::BLOCKER, self.height))
            .shape("lamp", Shape::Quad { cells: 2 }, &light, square(self.lamp, Self::LAMP_HEIGHT) * DOWN);
        builder.finish("shadow")
    }

    /// Irradiance with and without the blocker, means over each triangle of [`Shadow::scene`], W/m². Exact at a point: the lamp
    /// minus the part that the blocker occludes, both rectangles, by Lambert's polygon formula. Means are over 256 points.
    pub fn irradiance(&self, scene: &Scene) -> Vec<[f64; 2]> {
        let of = |triangle: usize| {
            if scene.area_vector(triangle).y <= 0.0 {
                return [0.0; 2];
            }
            let mut pieces = vec![scene.corners(triangle)];
            for _ in 0..4 {
                pieces = pieces.into_iter().flat_map(quarters).collect();
            }
            let sum = pieces
                .iter()
                .map(|&piece| self.at(centroid(piece)))
                .fold([0.0; 2], |s, e| [s[0] + e[0], s[1] + e[1]]);
            sum.map(|e| e / pieces.len() as f64)
        };
        (0..scene.triangles.len()).into_par_iter().map(of).collect()
    }

    /// Irradiance at a point of a surface that faces up, with and without the blocker.
    fn at(&self, point: DVec3) -> [f64; 2] {
        let half = 0.5 * self.lamp;
        let seen = |low: DVec2, high: DVec2| {
            let corner = |x: f64, z: f64| DVec3::new(x, Self::LAMP_HEIGHT, z);
            let [a, b, c, d] =
                [corner(low.x, low.y), corner(high.x, low.y), corner(high.x, high.y), corner(low.x, high.y)];
            [[a, b, c], [a, c, d]].map(|t| projected_solid_angle(point, DVec3::Y, t)).iter().sum::<f64>()
        };
        let open = Self::RADIANCE * seen(DVec2::splat(-half), DVec2::splat(half));
        if point.y >= self.height {
            return [open; 2];
        }
        // The part of the lamp's plane that the blocker occludes.
        let stretch = (Self::LAMP_HEIGHT - point.y) / (self.height - point.y);
        let here = DVec2::new(point.x, point.z);
        let edge = |side: f64| here + stretch * (DVec2::splat(side * Self::BLOCKER) - here);
        let (low, high) = (edge(-1.0).max(DVec2::splat(-half)), edge(1.0).min(DVec2::splat(half)));
        let hidden = if low.x < high.x && low.y < high.y { Self::RADIANCE * seen(low, high) } else { 0.0 };
        [open - hidden, open]
    }
}

fn centroid([a, b, c]: [DVec3; 3]) -> DVec3 {
    (a + b + c) / 3.0
}

fn quarters([a, b, c]: [DVec3; 3]) -> [[DVec3; 3]; 4] {
    let (ab, bc, ca) = (a.midpoint(b), b.midpoint(c), c.midpoint(a));
    [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
}
