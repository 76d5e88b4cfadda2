//! What geometry alone decides of a picture: where a camera sees each face, and how much of each lamp is seen from there.

use super::budget::{Budget, Lease};
use super::lamp_light::{Cache, LampLight};
use super::pattern::Spot;
use crate::image::{FaceInPixel, View};
use antirad_base::parallel;
use antirad_core::direct::{DirectLight, PointLight, barycentric};
use antirad_core::model::Facet;
use antirad_gpu::GpuError;
use antirad_scene::Patterns;
use glam::DVec3;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

/// Points that share a search for blockers.
pub const POINTS: usize = 64;

/// Chunks of points whose light is asked for at once.
pub const RUNS: usize = 4096;

impl Points {
    /// The light of lamps at the points, computed unless held.
    pub fn light(&self, direct: &DirectLight, facets: &[Facet]) -> Cow<'_, LampLight> {
        match self.cache.as_ref().and_then(Cache::get) {
            Some(held) => Cow::Borrowed(held),
            None => self.put(&direct.at_points(facets, self.face, &self.at), facets),
        }
    }

    /// Light that has been computed, held if it may be.
    fn put(&self, light: &[PointLight], facets: &[Facet]) -> Cow<'_, LampLight> {
        let light = LampLight::new(light, facets[self.face].normal, self.by_geometry);
        match &self.cache {
            Some(cache) => cache.put(light),
            None => Cow::Owned(light),
        }
    }
}

/// The light of lamps at the points of several runs, asked for at once unless held; that of faces that are not `lit` is empty.
///
/// # Errors
/// Fails if the device does.
pub fn light_of<'a>(
    runs: &[&'a Points],
    direct: &DirectLight,
    facets: &[Facet],
    lit: impl Fn(usize) -> bool,
) -> Result<Vec<Cow<'a, LampLight>>, GpuError> {
    let held = |run: &'a Points| run.cache.as_ref().and_then(Cache::get);
    let known: Vec<Option<&LampLight>> = runs.iter().map(|&run| held(run)).collect();
    let is_unknown = |(run, known): &(&&Points, &Option<&LampLight>)| lit(run.face) && known.is_none();
    let unknown = runs.iter().zip(&known).filter(is_unknown);
    let unknown: Vec<(usize, &[DVec3])> = unknown.map(|(run, _)| (run.face, &run.at[..])).collect();
    let mut found = direct.at_faces(facets, &unknown)?.into_iter();
    let of = |(&run, known): (&&'a Points, Option<&'a LampLight>)| match known {
        Some(light) => Cow::Borrowed(light),
        None if lit(run.face) => run.put(&found.next().unwrap_or_default(), facets),
        None => Cow::Owned(LampLight::default()),
    };
    Ok(runs.iter().zip(known).map(of).collect())
}

/// Points of a picture on one face, in the order of the picture.
#[derive(Debug)]
pub struct Points {
    pub face: usize,
    /// Indices into the faces in pixels.
    pub of: Vec<usize>,
    /// Positions in the engine's coordinates.
    pub at: Vec<DVec3>,
    /// Holds the light of lamps at each point, once it has been asked for: a rank asks for that of its share of a picture.
    cache: Option<Cache>,
    /// Whether derivatives by geometry are wanted.
    by_geometry: bool,
    /// Factors of albedo and emission around each point; empty if the face has no pattern.
    pub pattern: Vec<[DVec3; 2]>,
}

/// What is seen, and from where.
pub struct Sight<'a> {
    pub facets: &'a [Facet],
    pub patterns: &'a Patterns,
    pub view: View,
    /// Position of the eye, in the engine's coordinates.
    pub eye: DVec3,
    /// Whether derivatives by geometry are wanted.
    pub by_geometry: bool,
    /// Memory for what is held.
    pub budget: &'a Arc<Budget>,
}

impl Sight<'_> {
    /// The points of a face at spots of the picture. `hold`: whether to hold the light of lamps there.
    pub fn points(&self, face: usize, of: Vec<usize>, spots: &[Spot], hold: bool) -> Points {
        let facet = &self.facets[face];
        let point = |spot: &Spot| hit(facet, self.eye, self.view.ray(spot.middle[0], spot.middle[1]));
        let at: Vec<DVec3> = spots.iter().map(point).collect();
        let cache = hold.then(|| Cache::new(self.budget.clone()));
        Points { face, of, at, cache, by_geometry: self.by_geometry, pattern: self.pattern(face, spots) }
    }

    /// Factors of albedo and emission around spots of a face; empty if it has no pattern.
    fn pattern(&self, face: usize, spots: &[Spot]) -> Vec<[DVec3; 2]> {
        if !self.patterns.vary(face) {
            return Vec::new();
        }
        let facet = &self.facets[face];
        let of = |spot: &Spot| Spot::mean(&spot.samples(self.patterns, facet, face, self.eye, &self.view));
        spots.iter().map(of).collect()
    }
}

/// All points of a picture.
#[derive(Debug)]
pub struct Sights {
    pub seen: Vec<FaceInPixel>,
    /// Chunks of points on one face that are close in the picture.
    pub runs: Vec<Points>,
}

impl Sights {
    /// The points of all faces seen.
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
            sight.points(face, of.to_vec(), &spots, true)
        };
        let runs = parallel::map(&runs, points);
        Self { seen, runs }
    }

    /// The same points where patterns have changed; they share the light of lamps.
    fn with_patterns(&self, sight: &Sight) -> Self {
        let points = |points: &Points| {
            let Points { face, of, at, cache, by_geometry, .. } = points;
            let spots: Vec<Spot> = of.iter().map(|&place| Spot::from(&self.seen[place])).collect();
            let pattern = sight.pattern(*face, &spots);
            Points {
                face: *face,
                of: of.clone(),
                at: at.clone(),
                cache: cache.clone(),
                by_geometry: *by_geometry,
                pattern,
            }
        };
        Self { seen: self.seen.clone(), runs: parallel::map(&self.runs, points) }
    }

    /// Bytes, without the light of lamps.
    fn bytes(&self) -> usize {
        let of_run = |run: &Points| {
            size_of::<Points>()
                + size_of_val(&run.of[..])
                + size_of_val(&run.at[..])
                + size_of_val(&run.pattern[..])
        };
        size_of_val(&self.seen[..]) + self.runs.iter().map(of_run).sum::<usize>()
    }
}

/// The sights of one camera, once they are known, as far as there is room; clones share them.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Option<Known>>>);

/// Sights, and what pixels show, which they are made of.
#[derive(Debug)]
struct Known {
    /// `None`: what is seen.
    shown: Option<Vec<FaceInPixel>>,
    patterns: Arc<Patterns>,
    sights: Arc<Sights>,
    _lease: Lease,
}

impl Kept {
    /// The sights of the faces that pixels show, which are computed unless known. `sight`: with these patterns.
    ///
    /// # Errors
    /// Fails if `compute` does.
    pub fn of<E>(
        &self,
        shown: Vec<FaceInPixel>,
        patterns: &Arc<Patterns>,
        sight: &Sight,
        compute: impl FnOnce(&[FaceInPixel]) -> Result<Sights, E>,
    ) -> Result<Arc<Sights>, E> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let is_of = |known: &&mut Known| *known.shown.as_ref().unwrap_or(&known.sights.seen) == shown;
        if let Some(known) = kept.as_mut().filter(is_of) {
            if !Arc::ptr_eq(&known.patterns, patterns) {
                known.sights = Arc::new(known.sights.with_patterns(sight));
                known.patterns = patterns.clone();
            }
            return Ok(known.sights.clone());
        }
        let sights = Arc::new(compute(&shown)?);
        let patterns = patterns.clone();
        let shown = (sights.seen != shown).then_some(shown);
        *kept = None;
        let bytes = sights.bytes() + shown.as_ref().map_or(0, |shown| size_of_val(&shown[..]));
        *kept = sight.budget.take(bytes).map(|lease| Known {
            shown,
            patterns,
            sights: sights.clone(),
            _lease: lease,
        });
        Ok(sights)
    }
}

/// The point where a ray meets the plane of a face.
pub fn on_plane(facet: &Facet, eye: DVec3, ray: DVec3) -> DVec3 {
    let distance = (facet.centroid - eye).dot(facet.normal) / ray.dot(facet.normal);
    eye + distance * ray
}

/// The point where a ray meets a face. Rays that miss it get a point of the face nearby: the mean of the
/// visible samples of a face may lie outside it.
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

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_core::direct::{Visibility, lamps};
    use antirad_scene::{Material, SceneBuilder, Shape};
    use glam::DAffine3;

    #[test]
    fn light_that_is_not_held_is_computed_again() {
        let lamp = Material { emission: [1.0; 3], ..Material::named("lamp") };
        let down = DAffine3::from_translation(DVec3::Y) * DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
        let mut builder = SceneBuilder::new();
        builder.shape("floor", Shape::Quad { cells: 1 }, &Material::named("floor"), DAffine3::IDENTITY);
        builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, down);
        let scene = builder.finish("lit").expect("a scene");
        let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
        let material = |i| scene.material(i);
        let direct =
            DirectLight::of_points(&facets, lamps(&scene, &facets, 1e-9), Visibility::Exact, material);
        let at = vec![facets[0].centroid, facets[0].corners[0]];
        let light = direct.at_points(&facets, 0, &at);
        assert!(light[0][0].1.y > 0.1);
        let light = LampLight::new(&light, facets[0].normal, false);
        let caches =
            [Some(1 << 20), Some(0), None].map(|bytes| bytes.map(|bytes| Cache::new(Budget::new(bytes))));
        for (cache, held) in caches.into_iter().zip([true, false, false]) {
            let (of, pattern) = (vec![0, 1], Vec::new());
            let points = Points { face: 0, of, at: at.clone(), cache, by_geometry: false, pattern };
            for once_more in [false, true] {
                let found = points.light(&direct, &facets);
                assert_eq!(*found, light, "{once_more}");
                assert_eq!(matches!(found, Cow::Borrowed(_)), held);
            }
        }
    }
}
