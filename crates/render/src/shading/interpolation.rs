//! Values per face, interpolated over smooth surfaces: at a corner, the area-weighted mean of the faces that meet there, on one side of what
//! stands on them.
//!
//! The mean A v of the interpolated values over each face is a blurred v: at the border of a surface, corners take the value of the faces
//! inside. Iterating v <- v + (b - A v) from the means b sharpens it again (van Cittert 1931), until the mean of what is interpolated is
//! nearly b. The eigenvalues of A are between 0 and 1 on flat surfaces, so that [`STEPS`] steps amplify nothing more than 1 + [`STEPS`] times.

use antirad_base::parallel;
use antirad_core::model::Facet;
use antirad_scene::{Edges, Fans, SAME_SURFACE, Scene, Welded, sides};
use glam::DVec3;
use std::collections::HashMap;

/// Steps of sharpening. In pictures of `cornell_boxes` two bring most of what many bring.
const STEPS: usize = 2;

/// The faces around each corner of a scene.
#[derive(Clone, Debug)]
pub struct Interpolation {
    /// Positions of the corners of each triangle; one is several where creases separate the faces around it.
    corners: Vec<[u32; 3]>,
    fans: Fans,
}

impl Interpolation {
    pub fn new(scene: &Scene) -> Self {
        let welded = Welded::exactly(scene.vertices.iter().copied());
        let mut corners: Vec<[u32; 3]> =
            scene.triangles.iter().map(|t| welded.positions(t.vertices)).collect();
        let mut positions = welded.first.len();
        if !scene.creases.is_empty() {
            positions = torn(scene, &mut corners, positions);
        }
        Self { fans: Fans::of(positions, corners.iter().copied()), corners }
    }

    /// The faces around a corner of a face that continue its surface, itself included.
    pub fn around<'a>(
        &'a self,
        facets: &'a [Facet],
        face: usize,
        corner: usize,
    ) -> impl Iterator<Item = usize> + Clone + 'a {
        let faces = self.fans.around(self.corners[face][corner]);
        let normal = facets[face].normal;
        faces.iter().map(|&i| i as usize).filter(move |&i| facets[i].normal.dot(normal) >= SAME_SURFACE)
    }

    /// Of both ends of the edge that two faces share, the corner of each; `None` if they share none.
    pub fn shared_edge(&self, [a, b]: [usize; 2]) -> Option<[[usize; 2]; 2]> {
        let corner_of_b = |i: usize| self.corners[b].iter().position(|corner| *corner == self.corners[a][i]);
        let mut shared = (0..3).filter_map(|i| Some([i, corner_of_b(i)?]));
        Some([shared.next()?, shared.next()?])
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
        parallel::map(0..values.len(), mean)
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

/// Tears a mesh open along the creases of a scene: faces around a position on one keep a corner in common only if a way leads from one to the
/// other, over edges of their surface. Returns the number of positions.
fn torn(scene: &Scene, corners: &mut [[u32; 3]], mut positions: usize) -> usize {
    let normals: Vec<DVec3> = (0..corners.len()).map(|t| scene.area_vector(t).normalize_or_zero()).collect();
    let edges = Edges::of(corners.iter().copied());
    let is_marked = |(t, ends): (u32, [u32; 2])| {
        let marked = scene.creases.get(t as usize).copied().unwrap_or_default();
        marked.iter().zip(sides(corners[t as usize])).any(|(marked, side)| *marked && side == ends)
    };
    let (creases, others): (Vec<_>, Vec<_>) = edges.iter().partition(|edge| edge.directed().any(is_marked));
    let mut at_crease = vec![false; positions];
    creases.iter().flat_map(|edge| edge.ends()).for_each(|position| at_crease[position as usize] = true);

    // Corners of faces, numbered face by face, and what they are joined with.
    let mut joined = Joined::none(3 * corners.len());
    for edge in others {
        let faces: Vec<u32> = edge.triangles().collect();
        for position in edge.ends().into_iter().filter(|&position| at_crease[position as usize]) {
            let corner = |face: u32| {
                let of_face = corners[face as usize].iter().position(|&own| own == position);
                3 * face as usize + of_face.unwrap_or(0)
            };
            for (k, &a) in faces.iter().enumerate() {
                let same = |b: &&u32| normals[a as usize].dot(normals[**b as usize]) >= SAME_SURFACE;
                faces[..k].iter().filter(same).for_each(|&b| joined.join(corner(a), corner(b)));
            }
        }
    }
    let mut known = HashMap::new();
    for corner in 0..3 * corners.len() {
        let position = &mut corners[corner / 3][corner % 3];
        if at_crease[*position as usize] {
            *position = *known.entry(joined.first(corner)).or_insert_with(|| {
                positions += 1;
                positions as u32 - 1
            });
        }
    }
    positions
}

/// Disjoint sets of numbers (Galler and Fischer 1964).
struct Joined(Vec<usize>);

impl Joined {
    fn none(count: usize) -> Self {
        Self((0..count).collect())
    }

    /// The least number in the set of one.
    fn first(&mut self, mut number: usize) -> usize {
        while self.0[number] != number {
            self.0[number] = self.0[self.0[number]];
            number = self.0[number];
        }
        number
    }

    fn join(&mut self, a: usize, b: usize) {
        let [a, b] = [a, b].map(|number| self.first(number));
        self.0[a.max(b)] = a.min(b);
    }
}
