//! What geometry alone decides of a picture: where a camera sees each face, and how much of each lamp is seen from there.

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
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Points that share a search for blockers.
pub const POINTS: usize = 64;

/// Chunks of points whose light is asked for at once.
pub const RUNS: usize = 4096;

/// Largest number of pairs of a point and a lamp to hold: of one picture 250 MB, of all 1 GB.
const MOST_KEPT: usize = 8_000_000;
const MOST_OF_ALL: usize = 32_000_000;

/// The light of lamps at each point.
pub type LampLight<'a> = Cow<'a, [PointLight]>;

impl Points {
    /// The light of lamps at the points, computed unless held.
    pub fn light(&self, direct: &DirectLight, facets: &[Facet]) -> LampLight<'_> {
        let compute = || direct.at_points(facets, self.face, &self.at);
        match &self.light {
            Some(held) => Cow::Borrowed(held.get_or_init(|| without_room(compute()))),
            None => Cow::Owned(compute()),
        }
    }
}

/// Light that takes no more memory than it needs.
fn without_room(mut light: Vec<PointLight>) -> Vec<PointLight> {
    light.iter_mut().for_each(PointLight::shrink_to_fit);
    light
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
) -> Result<Vec<LampLight<'a>>, GpuError> {
    let held = |run: &'a Points| run.light.as_ref().and_then(|room| room.get());
    let is_unknown = |run: &&&'a Points| lit(run.face) && held(run).is_none();
    let unknown: Vec<(usize, &[DVec3])> =
        runs.iter().filter(is_unknown).map(|run| (run.face, &run.at[..])).collect();
    let mut found = direct.at_faces(facets, &unknown)?.into_iter();
    let of = |&run: &&'a Points| match (held(run), &run.light) {
        (Some(light), _) => Cow::Borrowed(&light[..]),
        _ if !lit(run.face) => Cow::Borrowed(&[][..]),
        (_, Some(room)) => {
            Cow::Borrowed(&room.get_or_init(|| without_room(found.next().unwrap_or_default()))[..])
        }
        (_, None) => Cow::Owned(found.next().unwrap_or_default()),
    };
    Ok(runs.iter().map(of).collect())
}

/// Points of a picture on one face, in the order of the picture.
#[derive(Debug)]
pub struct Points {
    pub face: usize,
    /// Indices into the faces in pixels.
    pub of: Vec<usize>,
    /// Positions in the engine's coordinates.
    pub at: Vec<DVec3>,
    /// The light of lamps at each point, once it has been asked for: a rank asks for that of its share of a picture. `None` where that is too
    /// much to hold for a whole picture.
    light: Option<Arc<OnceLock<Vec<PointLight>>>>,
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
}

impl Sight<'_> {
    /// The points of a face at spots of the picture. `hold`: whether to hold the light of lamps there.
    pub fn points(&self, face: usize, of: Vec<usize>, spots: &[Spot], hold: bool) -> Points {
        let facet = &self.facets[face];
        let point = |spot: &Spot| hit(facet, self.eye, self.view.ray(spot.middle[0], spot.middle[1]));
        let at: Vec<DVec3> = spots.iter().map(point).collect();
        Points { face, of, at, light: hold.then(Arc::default), pattern: self.pattern(face, spots) }
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
    /// Whether they hold the light of lamps, once it is known.
    held: bool,
}

impl Sights {
    /// The points of all faces seen. Of how many `lamps` a point sees light, and the number of `views`, decide whether light can be held.
    pub fn new(sight: &Sight, seen: Vec<FaceInPixel>, lamps: usize, views: usize) -> Self {
        let most = MOST_KEPT.min(MOST_OF_ALL / views.max(1));
        let held = seen.len().saturating_mul(lamps) <= most;
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
            sight.points(face, of.to_vec(), &spots, held)
        };
        let runs = parallel::map(&runs, points);
        Self { seen, runs, held }
    }

    /// The same points where patterns have changed; they share the light of lamps.
    fn with_patterns(&self, sight: &Sight) -> Self {
        let points = |points: &Points| {
            let Points { face, of, at, light, .. } = points;
            let spots: Vec<Spot> = of.iter().map(|&place| Spot::from(&self.seen[place])).collect();
            let pattern = sight.pattern(*face, &spots);
            Points { face: *face, of: of.clone(), at: at.clone(), light: light.clone(), pattern }
        };
        Self { seen: self.seen.clone(), runs: parallel::map(&self.runs, points), held: self.held }
    }
}

/// The sights of one camera, once they are known; clones share them.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Option<Known>>>);

/// Sights, and what pixels show, which they are made of.
#[derive(Debug)]
struct Known {
    /// `None`: what is seen.
    shown: Option<Vec<FaceInPixel>>,
    patterns: Arc<Patterns>,
    sights: Arc<Sights>,
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
        *kept = sights.held.then(|| Known { shown, patterns, sights: sights.clone() });
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
        for held in [true, false] {
            let (of, pattern) = (vec![0, 1], Vec::new());
            let points = Points { face: 0, of, at: at.clone(), light: held.then(Arc::default), pattern };
            for once_more in [false, true] {
                let found = points.light(&direct, &facets);
                assert_eq!(*found, light[..], "{once_more}");
                assert_eq!(matches!(found, Cow::Borrowed(_)), held);
            }
        }
    }
}
