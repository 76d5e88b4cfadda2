//! Spatial order: neighbours of similar orientation are adjacent, so that groups of them have small boxes and narrow
//! normal cones, and few span two objects.

use super::facet::Facet;
use super::objects::objects;
use antirad_scene::bounds;
use glam::DVec3;

/// Triangle index of the slots that pad a tile.
pub const PADDING: u32 = u32::MAX;

/// The box around the corners of some triangles.
#[derive(Clone, Debug)]
pub struct BoundedRun {
    /// Least coordinates.
    pub min: DVec3,
    /// Largest coordinates.
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

/// Fewest triangles of an object whose triangles are kept together: a tile, so that most tiles are of one object.
const LEAST: u32 = 64;

/// Indices of the facets with an area, sorted by object, then by the cube face their normal points to, then along a Morton curve, as
/// objects are. Small objects count as one.
pub fn spatial_order(facets: &[Facet]) -> Vec<u32> {
    let bounds = BoundedRun::around(facets.iter());
    let size = (bounds.max - bounds.min).max_element().max(f64::MIN_POSITIVE);
    let place = |point: DVec3| morton((point - bounds.min) / size);
    let objects = objects(facets);
    let (mut count, mut centre) = (vec![0u32; facets.len()], vec![DVec3::ZERO; facets.len()]);
    for (facet, &object) in facets.iter().zip(&objects) {
        count[object as usize] += 1;
        centre[object as usize] += facet.centroid;
    }
    let of_object = |object: u32| {
        let triangles = count[object as usize];
        (triangles >= LEAST).then(|| (place(centre[object as usize] / f64::from(triangles)), object))
    };
    let key = |(facet, i): (&Facet, u32)| {
        let object = of_object(objects[i as usize]);
        (object, cube_face(facet.normal), place(facet.centroid), i)
    };
    let with_area = facets.iter().zip(0u32..).filter(|(facet, _)| facet.area > 0.0);
    let mut keyed: Vec<_> = with_area.map(key).collect();
    keyed.sort_unstable();
    keyed.into_iter().map(|(.., i)| i).collect()
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
