//! The frame of a hierarchy, in which all it holds is within the unit ball, and boxes there.

use glam::{DVec3, Vec3};

/// What boxes are grown by, and limits of distances, in units of the frame.
///
/// A place along a ray where it passes through the side of a box is off by 14 roundings of at most 2⁻²⁴ each: those of origin (at most 2.3 from
/// the middle), direction, its inverse, the side and their products. That is 8e-7.
pub const GROWN: f64 = 2e-6;

/// A point becomes (point - centre) · scale.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    pub centre: DVec3,
    /// One over half the diagonal.
    pub scale: f64,
}

impl Frame {
    /// The frame of some points.
    pub fn of(points: impl Iterator<Item = DVec3>) -> Self {
        let around = |[low, high]: [DVec3; 2], point| [low.min(point), high.max(point)];
        let [low, high] = points.fold([DVec3::INFINITY, DVec3::NEG_INFINITY], around);
        // Around no points, low is above high.
        if low.x > high.x {
            return Self { centre: DVec3::ZERO, scale: 2.0 };
        }
        Self { centre: 0.5 * low + 0.5 * high, scale: 2.0 / (high - low).length().max(f64::MIN_POSITIVE) }
    }

    /// The diagonal of what the frame is of.
    pub fn size(&self) -> f64 {
        2.0 / self.scale
    }

    pub fn point(&self, point: DVec3) -> DVec3 {
        (point - self.centre) * self.scale
    }

    /// The box around some points, grown.
    pub fn bounds(&self, points: &[DVec3]) -> Bounds {
        let around = |bounds: Bounds, &point: &DVec3| {
            let point = self.point(point);
            let (low, high) = ((point - GROWN).as_vec3(), (point + GROWN).as_vec3());
            Bounds { low: bounds.low.min(low), high: bounds.high.max(high) }
        };
        points.iter().fold(Bounds::EMPTY, around)
    }
}

/// A box.
#[derive(Clone, Copy, Debug)]
pub struct Bounds {
    pub low: Vec3,
    pub high: Vec3,
}

impl Bounds {
    /// Around nothing.
    pub const EMPTY: Self = Self { low: Vec3::INFINITY, high: Vec3::NEG_INFINITY };

    pub fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    pub fn union_of(all: impl Iterator<Item = Self>) -> Self {
        all.fold(Self::EMPTY, Self::union)
    }

    /// Half the surface area; zero for the empty box.
    pub fn area(&self) -> f32 {
        let size = (self.high - self.low).max(Vec3::ZERO);
        size.x * size.y + size.y * size.z + size.z * size.x
    }

    pub fn meets(&self, other: &Self) -> bool {
        self.low.cmple(other.high).all() && other.low.cmple(self.high).all()
    }

    /// Twice the middle.
    pub fn middle(&self) -> Vec3 {
        self.low + self.high
    }
}
