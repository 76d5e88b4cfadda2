//! A lamp as triangles, and places on it that fill it evenly.

use super::lamps::Lamp;
use crate::model::{BoundedRun, Facet};
use glam::DVec3;

/// A triangle, with its unit normal.
#[derive(Clone, Copy, Debug)]
pub struct Flat {
    /// Counter-clockwise, seen from the front.
    pub corners: [DVec3; 3],
    /// Towards the front.
    pub normal: DVec3,
}

impl Flat {
    /// Its area.
    pub fn area(&self) -> f64 {
        let [a, b, c] = self.corners;
        0.5 * (b - a).cross(c - a).length()
    }
}

impl From<&Facet> for Flat {
    fn from(&Facet { corners, normal, .. }: &Facet) -> Self {
        Self { corners, normal }
    }
}

/// The triangles of a lamp: the fan of a polygon, or all of a solid.
#[derive(Clone, Debug)]
pub struct Surface {
    /// Without overlap.
    pub triangles: Vec<Flat>,
    /// Area up to the end of each, as a share of the whole, in units of 2^-32.
    pub ends: Vec<u32>,
    /// Whether it goes along with each point that looks at it, as a sun does: its corners are then seen from the origin.
    pub(super) goes_along: bool,
}

/// Distance to suns, in sizes of the scene: beyond everything.
const BEYOND: f64 = 4.0;

impl Surface {
    /// The surface of a lamp.
    pub fn new(facets: &[Facet], lamp: &Lamp) -> Self {
        let fan = |corners: &[DVec3], normal: DVec3| -> Vec<Flat> {
            let pairs = corners[1..].windows(2);
            pairs.map(|pair| Flat { corners: [corners[0], pair[0], pair[1]], normal }).collect()
        };
        let triangles: Vec<Flat> = match lamp {
            Lamp::Surface(surface) if surface.solid.is_some() => {
                surface.triangles.iter().map(|&i| Flat::from(&facets[i as usize])).collect()
            }
            Lamp::Surface(surface) => {
                let corner = |&[i, k]: &[u32; 2]| facets[i as usize].corners[k as usize];
                let corners: Vec<DVec3> = surface.corners.iter().map(corner).collect();
                fan(&corners, facets[surface.first()].normal)
            }
            Lamp::Sun(disc) => {
                let bounds = BoundedRun::around(facets.iter());
                let distance = BEYOND * (bounds.max - bounds.min).length();
                let corners: Vec<DVec3> = disc.corners().iter().map(|&corner| distance * corner).collect();
                fan(&corners, disc.normal())
            }
        };
        let all: f64 = triangles.iter().map(Flat::area).sum();
        let mut sum = 0.0;
        let mut end = |triangle: &Flat| {
            sum += triangle.area();
            (sum / all * 2f64.powi(32)) as u32
        };
        let mut ends: Vec<u32> = triangles.iter().map(&mut end).collect();
        // Rounding leaves nothing beyond the last.
        if let Some(last) = ends.last_mut() {
            *last = u32::MAX;
        }
        Self { triangles, ends, goes_along: lamp.sun().is_some() }
    }

    /// [`Self::at`], where it is for a point that looks at it.
    pub fn from_point(&self, point: DVec3, place: [u32; 2]) -> (DVec3, DVec3) {
        let (at, normal) = self.at(place);
        (if self.goes_along { point + at } else { at }, normal)
    }

    /// The point at a place of the unit square, in units of 2^-32, and the normal there: areas are kept up to a factor.
    pub fn at(&self, [s, t]: [u32; 2]) -> (DVec3, DVec3) {
        let which = self.ends.partition_point(|end| *end <= s).min(self.ends.len() - 1);
        let begin = which.checked_sub(1).map_or(0, |before| self.ends[before]);
        let Flat { corners, normal } = self.triangles[which];
        let share = f64::from(s - begin) / f64::from(self.ends[which] - begin).max(1.0);
        (within(corners, [share, f64::from(t) / 2f64.powi(32)]), normal)
    }
}

/// The barycentric coordinates of [`within`].
pub fn spread([s, t]: [f64; 2]) -> DVec3 {
    let s = s.min(1.0).sqrt();
    DVec3::new(1.0 - s, s * (1.0 - t), s * t)
}

/// The point of a triangle at a place of the unit square: areas are kept up to a factor.
pub fn within([a, b, c]: [DVec3; 3], [s, t]: [f64; 2]) -> DVec3 {
    a + s.min(1.0).sqrt() * ((b - a) + t * (c - b))
}

#[cfg(test)]
mod tests {
    use super::super::polygon::Polygon;
    use super::super::sampling::sobol;
    use super::*;

    #[test]
    fn points_fill_a_polygon_evenly() {
        let corners = [[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [1.0, 2.0], [0.0, 1.0]];
        let [a, b, c, d, e] = corners.map(|[x, y]| DVec3::new(x, y, 0.0));
        let facets = [[a, b, c], [a, c, d], [a, d, e]].map(Facet::new);
        let around = vec![[0, 0], [0, 1], [0, 2], [1, 2], [2, 2]];
        let surface = Surface::new(&facets, &Lamp::Surface(Polygon::around(vec![0, 1, 2], around)));
        let (mut mean, mut low) = (DVec3::ZERO, 0);
        let count = 4000;
        for index in 0..count {
            let (point, normal) = surface.at(sobol(index));
            assert_eq!(normal, DVec3::Z);
            mean += point / f64::from(count);
            low += i32::from(point.y < 1.0);
        }
        // A square of 2 x 1 below a triangle of area 1, whose centroid is at height 4/3.
        assert!((mean - DVec3::new(1.0, (2.0 * 0.5 + 4.0 / 3.0) / 3.0, 0.0)).length() < 1e-2, "{mean}");
        assert!((f64::from(low) / f64::from(count) - 2.0 / 3.0).abs() < 1e-2, "{low}");
    }
}
