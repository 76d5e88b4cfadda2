//! Spatial order: neighbours of similar orientation are adjacent, so that groups of them have small boxes and narrow
//! normal cones.

use super::facet::Facet;
use crate::scene::bounds;
use glam::DVec3;

/// Triangle index of the slots that pad a tile.
pub const PADDING: u32 = u32::MAX;

/// The box around the corners of some triangles.
#[derive(Clone, Debug)]
pub struct BoundedRun {
    pub min: DVec3,
    pub max: DVec3,
}

impl BoundedRun {
    /// The box around some facets; around none, its minimum is +∞ and its maximum -∞.
    pub fn around<'a>(facets: impl Iterator<Item = &'a Facet>) -> Self {
        let (min, max) = bounds(facets.flat_map(|f| f.corners));
        Self { min, max }
    }

    /// The smallest ⟨direction, x⟩ of the box.
    pub fn lowest(&self, direction: DVec3) -> f64 {
        let corner = DVec3::select(direction.cmpgt(DVec3::ZERO), self.min, self.max);
        corner.dot(direction)
    }

    /// Squared distance of two boxes.
    pub fn distance_squared(&self, other: &Self) -> f64 {
        let gap = (other.min - self.max).max(self.min - other.max);
        gap.max(DVec3::ZERO).length_squared()
    }
}

/// Indices of the facets with an area, sorted by the cube face their normal points to, then along a Morton curve.
pub fn spatial_order(facets: &[Facet]) -> Vec<u32> {
    let bounds = BoundedRun::around(facets.iter());
    let size = (bounds.max - bounds.min).max_element().max(f64::MIN_POSITIVE);
    let mut keyed: Vec<(u8, u64, u32)> = facets
        .iter()
        .zip(0u32..)
        .filter(|(facet, _)| facet.area > 0.0)
        .map(|(facet, i)| (cube_face(facet.normal), morton((facet.centroid - bounds.min) / size), i))
        .collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(_, _, i)| i).collect()
}

/// 0..6: the axis nearest to a direction, and its sign.
pub fn cube_face(direction: DVec3) -> u8 {
    let a = direction.abs();
    let (axis, value) = if a.x >= a.y && a.x >= a.z {
        (0, direction.x)
    } else if a.y >= a.z {
        (1, direction.y)
    } else {
        (2, direction.z)
    };
    axis * 2 + u8::from(value < 0.0)
}

/// 21 bits of each coordinate of a point of the unit cube, interleaved.
pub fn morton(point: DVec3) -> u64 {
    let spread = |x: f64| {
        let mut v = (x.clamp(0.0, 1.0) * 2_097_151.0) as u64;
        v = (v | v << 32) & 0x001f_0000_0000_ffff;
        v = (v | v << 16) & 0x001f_0000_ff00_00ff;
        v = (v | v << 8) & 0x100f_00f0_0f00_f00f;
        v = (v | v << 4) & 0x10c3_0c30_c30c_30c3;
        (v | v << 2) & 0x1249_2492_4924_9249
    };
    spread(point.x) | spread(point.y) << 1 | spread(point.z) << 2
}
