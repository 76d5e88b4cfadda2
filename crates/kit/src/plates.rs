//! A scene whose floor is dark.

use super::{DOWN, square};
use antirad_scene::{Material, Scene, SceneBuilder, SceneError, Shape};
use glam::{DAffine3, DVec3};

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
