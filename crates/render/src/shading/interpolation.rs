//! Values per face, interpolated over smooth surfaces: at a corner, the area-weighted mean of the faces that meet there.
//!
//! The mean A v of the interpolated values over each face is a blurred v: at the border of a surface, corners take the value of the faces
//! inside. Iterating v <- v + (b - A v) from the means b sharpens it again (van Cittert 1931), until the mean of what is interpolated is
//! nearly b. The eigenvalues of A are between 0 and 1 on flat surfaces, so that [`STEPS`] steps amplify nothing more than 1 + [`STEPS`] times.

use antirad_core::model::Facet;
use antirad_scene::{Fans, Scene, Welded};
use glam::DVec3;
use rayon::prelude::*;

/// Cosine of the largest angle between faces of one smooth surface, 30°; larger ones are sharp edges.
const SAME_SURFACE: f64 = 0.866_025_403_784_438_6;

/// Steps of sharpening. In pictures of `cornell_boxes` two bring most of what many bring.
const STEPS: usize = 2;

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

    /// Values to interpolate, such that the means over faces are nearly `means`.
    pub fn sharpened(&self, facets: &[Facet], means: &[DVec3]) -> Vec<DVec3> {
        (0..STEPS).fold(means.to_vec(), |values, _| self.step(facets, means, &values))
    }

    fn step(&self, facets: &[Facet], means: &[DVec3], values: &[DVec3]) -> Vec<DVec3> {
        let blurred = self.means(facets, values);
        (0..values.len()).map(|i| values[i] + means[i] - blurred[i]).collect()
    }

    /// The mean of what is interpolated over each face.
    pub fn means(&self, facets: &[Facet], values: &[DVec3]) -> Vec<DVec3> {
        let mean = |face: usize| self.corners(facets, values, face).iter().sum::<DVec3>() / 3.0;
        (0..values.len()).into_par_iter().map(mean).collect()
    }

    /// The transpose of [`Self::sharpened`], and the derivative by the area of each face.
    pub fn pull_back_sharpened(
        &self,
        facets: &[Facet],
        means: &[DVec3],
        mut cotangent: Vec<DVec3>,
    ) -> (Vec<DVec3>, Vec<f64>) {
        let mut iterates = vec![means.to_vec()];
        for _ in 1..STEPS {
            iterates.push(self.step(facets, means, &iterates[iterates.len() - 1]));
        }
        let (mut by_means, mut by_areas) = (vec![DVec3::ZERO; means.len()], vec![0.0; means.len()]);
        for values in iterates.iter().rev() {
            let mut by_values = cotangent.clone();
            for (face, &by) in cotangent.iter().enumerate().filter(|(_, by)| **by != DVec3::ZERO) {
                by_means[face] += by;
                self.pull_back(facets, values, face, [by / -3.0; 3], &mut |i, by, by_area| {
                    by_values[i] += by;
                    by_areas[i] += by_area;
                });
            }
            cotangent = by_values;
        }
        by_means.iter_mut().zip(cotangent).for_each(|(to, by)| *to += by);
        (by_means, by_areas)
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
