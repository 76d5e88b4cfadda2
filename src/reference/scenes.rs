//! Scenes with a solution in closed form.

use crate::model::projected_solid_angle;
use crate::model::{centroid, quarters};
use crate::scene::{Material, Scene, SceneBuilder, SceneError, Shape};
use glam::{DAffine3, DVec2, DVec3};
use rayon::prelude::*;

/// A lamp above thin closed plates above a floor, all black but the lamp. With plates as large as the floor and a small lamp, the
/// irradiance of the floor is zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plates {
    /// Number of plates.
    pub count: u32,
    /// Squares along each side of a plate and of the floor.
    pub cells: u32,
    /// Side of the plates, m; that of the floor is 1 m.
    pub side: f64,
    /// Thickness of each plate, m.
    pub thickness: f64,
    /// Distance between two plates, m.
    pub gap: f64,
    /// Height of the lowest plate above the floor, m.
    pub height: f64,
    /// Side of the lamp, which is 2 m above the floor, m.
    pub lamp: f64,
}

/// Transforms the unit square of the ground into one of the given side, m, centred over the origin at the given height, m.
fn square(side: f64, height: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(-0.5 * side, height, -0.5 * side))
        * DAffine3::from_scale(DVec3::new(side, 1.0, side))
}

/// Turns a square that faces up to face down.
const DOWN: DAffine3 = DAffine3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::ZERO);

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

impl Default for Plates {
    fn default() -> Self {
        Self { count: 2, cells: 12, side: 1.0, thickness: 0.01, gap: 0.05, height: 0.25, lamp: 0.4 }
    }
}

impl Plates {
    /// Meshes "floor", "lamp", "plate 1" (the lowest), "plate 2" and so on.
    pub fn scene(&self) -> Result<Scene, SceneError> {
        let black = Material::named("black");
        let lamp = Material { emission: [10.0; 3], ..Material::named("lamp") };
        let mut builder = SceneBuilder::new();
        builder.shape("floor", Shape::Quad { cells: self.cells }, &black, square(1.0, 0.0));
        builder.shape("lamp", Shape::Quad { cells: 2 }, &lamp, square(self.lamp, 2.0) * DOWN);
        for k in 0..self.count {
            let bottom = self.height + f64::from(k) * (self.thickness + self.gap);
            let place =
                square(self.side, bottom) * DAffine3::from_scale(DVec3::new(1.0, self.thickness, 1.0));
            let slab = Shape::Slab { cells: self.cells };
            builder.shape(&format!("plate {}", k + 1), slab, &black, place);
        }
        builder.finish(&format!("plates_{}", self.count))
    }
}
