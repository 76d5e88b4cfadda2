//! Values per face, interpolated over smooth surfaces: at a corner, the area-weighted mean of the faces that meet there.

use crate::model::Facet;
use crate::scene::{Fans, Scene, Welded};
use glam::DVec3;

/// Cosine of the largest angle between faces of one smooth surface, 30°; larger ones are sharp edges.
const SAME_SURFACE: f64 = 0.866_025_403_784_438_6;

/// The faces around each corner of a scene.
#[derive(Clone, Debug)]
pub struct Interpolation {
    /// Positions of the corners of each triangle.
    corners: Vec<[u32; 3]>,
    fans: Fans,
}

impl Interpolation {
    pub fn new(scene: &Scene) -> Self {
        let welded = Welded::exactly(scene.vertices.iter().copied());
        let corners: Vec<[u32; 3]> = scene.triangles.iter().map(|t| welded.positions(t.vertices)).collect();
        Self { fans: Fans::of(welded.first.len(), corners.iter().copied()), corners }
    }

    /// The faces around a corner of a face that continue its surface, itself included.
    fn around<'a>(
        &'a self,
        facets: &'a [Facet],
        face: usize,
        corner: usize,
    ) -> impl Iterator<Item = usize> + Clone + 'a {
        let faces = self.fans.around(self.corners[face][corner]);
        let normal = facets[face].normal;
        faces.iter().map(|&i| i as usize).filter(move |&i| facets[i].normal.dot(normal) >= SAME_SURFACE)
    }

    /// The values at the corners of a face.
    pub fn corners(&self, facets: &[Facet], values: &[DVec3], face: usize) -> [DVec3; 3] {
        [0, 1, 2].map(|corner| {
            let around = self.around(facets, face, corner);
            let area: f64 = around.clone().map(|i| facets[i].area).sum();
            around.map(|i| values[i] * (facets[i].area / area)).sum()
        })
    }

    /// The transpose of [`Self::corners`], and the derivative by the area of each face around: calls `to` with a face and both.
    pub fn pull_back(
        &self,
        facets: &[Facet],
        values: &[DVec3],
        face: usize,
        cotangent: [DVec3; 3],
        to: &mut dyn FnMut(usize, DVec3, f64),
    ) {
        let means = self.corners(facets, values, face);
        for corner in 0..3 {
            let around = self.around(facets, face, corner);
            let area: f64 = around.clone().map(|i| facets[i].area).sum();
            for i in around {
                let by_area = cotangent[corner].dot(values[i] - means[corner]) / area;
                to(i, cotangent[corner] * (facets[i].area / area), by_area);
            }
        }
    }
}
