//! What geometry alone decides of a picture: where a camera sees each face, and how much of each lamp is seen from there.

use super::pattern::Spot;
use crate::direct::DirectLight;
use crate::direct::barycentric;
use crate::image::{FaceInPixel, View};
use crate::model::Facet;
use crate::scene::Patterns;
use glam::DVec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Points that share a search for blockers.
pub const POINTS: usize = 64;

/// Largest number of pairs of a point and a lamp to keep for further pictures: 200 MB.
const MOST_KEPT: usize = 8_000_000;

/// Points of a picture on one face, in the order of the picture.
#[derive(Debug)]
pub struct Points {
    pub face: usize,
    /// Indices into the faces in pixels.
    pub of: Vec<usize>,
    /// Engine's coordinates.
    pub at: Vec<DVec3>,
    /// Vector irradiance of each lamp at each point by its radiance, sr.
    pub light: Vec<Vec<DVec3>>,
    /// Where the face has a pattern, its factors of albedo and emission around each point.
    pub pattern: Vec<[DVec3; 2]>,
}

/// What is seen, and from where.
pub struct Sight<'a> {
    pub direct: &'a DirectLight,
    pub facets: &'a [Facet],
    pub patterns: &'a Patterns,
    pub view: View,
    /// Of the view, in the engine's coordinates.
    pub eye: DVec3,
}

impl Sight<'_> {
    /// The points of a face at spots of the picture.
    pub fn points(&self, face: usize, of: Vec<usize>, spots: &[Spot]) -> Points {
        let facet = &self.facets[face];
        let point = |spot: &Spot| hit(facet, self.eye, self.view.ray(spot.middle[0], spot.middle[1]));
        let at: Vec<DVec3> = spots.iter().map(point).collect();
        let light = self.direct.at_points(self.facets, face, &at);
        let pattern =
            |spot: &Spot| Spot::mean(&spot.samples(self.patterns, facet, face, self.eye, &self.view));
        let pattern = if self.patterns.vary(face) { spots.iter().map(pattern).collect() } else { Vec::new() };
        Points { face, of, at, light, pattern }
    }
}

/// All points of a picture.
#[derive(Debug)]
pub struct Sights {
    pub seen: Vec<FaceInPixel>,
    /// Runs of points on one face that are close in the picture.
    pub runs: Vec<Points>,
}

impl Sights {
    pub fn new(sight: &Sight, seen: Vec<FaceInPixel>) -> Self {
        let mut by_face: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (place, seen) in seen.iter().enumerate() {
            by_face.entry(seen.face).or_default().push(place);
        }
        let runs: Vec<(usize, &[usize])> = by_face
            .iter()
            .flat_map(|(&face, places)| places.chunks(POINTS).map(move |run| (face, run)))
            .collect();
        let points = |&(face, of): &(usize, &[usize])| {
            let spots: Vec<Spot> = of.iter().map(|&place| Spot::from(&seen[place])).collect();
            sight.points(face, of.to_vec(), &spots)
        };
        let runs = runs.par_iter().map(points).collect();
        Self { seen, runs }
    }
}

/// The sights of one camera, once they are known; clones share them.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Option<Arc<Sights>>>>);

impl Kept {
    /// Those of the faces seen, which are computed unless known.
    pub fn of(
        &self,
        seen: Vec<FaceInPixel>,
        compute: impl FnOnce(Vec<FaceInPixel>) -> Sights,
    ) -> Arc<Sights> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sights) = kept.as_ref().filter(|sights| sights.seen == seen) {
            return sights.clone();
        }
        let sights = Arc::new(compute(seen));
        let lamps = sights.runs.first().and_then(|run| run.light.first()).map_or(0, Vec::len);
        *kept = (sights.seen.len() * lamps <= MOST_KEPT).then(|| sights.clone());
        sights
    }
}

/// Where a ray meets the plane of a face.
pub fn on_plane(facet: &Facet, eye: DVec3, ray: DVec3) -> DVec3 {
    let distance = (facet.centroid - eye).dot(facet.normal) / ray.dot(facet.normal);
    eye + distance * ray
}

/// Where a ray meets a face, or the point of the face next to it: the mean of its visible samples may lie outside.
pub fn hit(facet: &Facet, eye: DVec3, ray: DVec3) -> DVec3 {
    let point = on_plane(facet, eye, ray);
    let inside = barycentric(facet.corners, facet.normal, point).max(DVec3::ZERO);
    let sum = inside.element_sum();
    if !(sum.is_finite() && sum > 0.0) {
        return facet.centroid;
    }
    let [a, b, c] = facet.corners;
    (a * inside.x + b * inside.y + c * inside.z) / sum
}
