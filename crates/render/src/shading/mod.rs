//! Pictures with the last bounce gathered where a camera sees it: direct light at each visible point, and indirect irradiance
//! interpolated over smooth surfaces, in place of one value per face.
//!
//! The radiance of a face towards the camera (the operator S) holds the means of both over the face. Gathering adds, at each point x, the
//! diffuse reflection of the differences D(x) - D and H(x) - H, and the specular reflection of lamps at the exact directions of lamp and
//! eye. What glossy faces reflect of indirect light is gathered along rays, or that of S, which has derivatives by positions. Where albedo
//! or emission vary within a face, both are those at x: the albedo and emission of the face, times the factors of its pattern.

mod backward;
mod budget;
mod edges;
mod interpolation;
mod lamp_light;
mod near;
mod pattern;
mod reflections;
mod sights;

pub use backward::{SeenFrom, ShadingError, TexelGradient, backward};

use crate::image::{self, Coverage, FaceColours, ImageError, Picture};
use antirad_base::parallel;
use antirad_base::ranks::RankError;
use antirad_core::direct::{DirectLight, barycentric};
use antirad_core::model::Facet;
use antirad_core::plan::Placement;
use antirad_core::{Engine, EngineError, Solution};
use antirad_scene::{BackendKind, Camera, Material, Patterns, Scene};
use budget::Budget;
use glam::DVec3;
use interpolation::Interpolation;
use lamp_light::LampLight;
use near::{Lit, NearLight};
use pattern::Spot;
use reflections::{Estimate, Faces, Glossy, Held, Surroundings};
use sights::{Kept, POINTS, Points, RUNS, Sight, Sights, light_of};
use std::borrow::Cow;
use std::f64::consts::PI;
use std::sync::Arc;

/// How a picture shows the light of faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shading {
    /// One colour per face.
    Face,
    /// Direct light of exact lamps at each visible point, other light interpolated.
    #[default]
    Gathered,
}

/// How pictures with gathered light find what glossy faces reflect of other faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reflections {
    /// Rays from each visible point, as many as accuracy needs; and where edges of suns' shadows pass, as many points.
    #[default]
    Rays,
    /// Rays, the same number from each point, so that pictures are smooth functions of emission and
    /// materials.
    FixedRays,
    /// The direction bins of each face, as S does: coarser, but differentiable by everything.
    Bins,
}

/// Pixels, and how accurate they are.
#[derive(Clone, Debug)]
pub struct Gathered {
    /// Row by row from the top: linear RGB, W/(m² sr), and the share of samples that show a face.
    pub pixels: Vec<[f64; 4]>,
    /// Standard error of reflections by rays: relative L2 norm over what is reflected by the faces in view.
    pub error: f64,
}

impl Gathered {
    /// The pixels as a picture, rounded to f32. `coverage`: what they were made of.
    pub fn picture(&self, coverage: &Coverage) -> Picture {
        let pixels = self.pixels.iter().map(|pixel| pixel.map(|value| value as f32)).collect();
        Picture { width: coverage.width(), height: coverage.height(), pixels }
    }
}

/// The light of a solution towards some cameras, on the host: what pictures with gathered light are made from. It outlives its engine. Ranks
/// make pictures and their derivatives in shares, and must all ask for them.
#[derive(Clone, Debug)]
pub struct Light {
    direct: Arc<DirectLight>,
    placement: Placement,
    /// Triangles, in the engine's coordinates.
    facets: Vec<Facet>,
    materials: Vec<Material>,
    patterns: Arc<Patterns>,
    /// Means over each triangle, W/m².
    direct_irradiance: Vec<DVec3>,
    indirect_irradiance: Vec<DVec3>,
    /// Indirect irradiance, sharpened for `interpolation`, W/m².
    sharpened: Vec<DVec3>,
    interpolation: Interpolation,
    /// Indirect light from near by where it varies within faces; `None` where nothing does, and in pictures that have derivatives.
    near: Option<Arc<NearLight>>,
    /// Whether pictures are smooth functions of the scene: points are not chosen by the light there.
    is_smooth: bool,
    /// What rays meet; `None` unless glossy faces reflect by rays.
    surroundings: Option<Arc<Surroundings>>,
    views: Vec<View>,
    /// Whether derivatives by geometry are wanted.
    by_geometry: bool,
    /// Memory for what all views hold of points.
    budget: Arc<Budget>,
}

/// Cosine of the angle between normals of faces of one plane, and relative difference of equal albedos.
const COPLANAR: f64 = 1.0 - 1e-12;
const ROUNDING: f64 = 1e-9;

/// Most bytes that all views of a light hold of their points.
const MOST_HELD: u64 = 1 << 30;

/// What gathering adds at points, from the light of lamps there, with room for the rays of each.
type Difference<'a> = dyn Fn(&Points, &LampLight, Option<&Held>) -> Vec<Estimate> + Sync + 'a;

/// A camera, and the radiance of each face towards it without highlights, W/(m² sr).
#[derive(Clone, Debug)]
struct View {
    camera: Camera,
    colours: Vec<[f64; 3]>,
    sights: Kept,
    /// Rays of each point, held if all points have the same number.
    samples: reflections::Kept,
}

/// What the faces of a light show in one of its views: that by which moving silhouettes change the picture.
pub(crate) struct ShownIn<'a> {
    light: &'a Light,
    view: &'a View,
}

impl FaceColours for ShownIn<'_> {
    fn at(&self, face: usize, places: &[[f64; 2]]) -> Vec<[f64; 3]> {
        let Self { light, view } = *self;
        let sight = light.sight(&view.camera);
        let of_run = |places: &[[f64; 2]]| {
            let spots: Vec<Spot> = places.iter().map(|&middle| Spot { middle, side: 0.0 }).collect();
            let points = sight.points(face, (0..places.len()).collect(), &spots, false);
            light.difference(view, &points, &points.light(&light.direct, &light.facets), None)
        };
        let more = places.chunks(POINTS).flat_map(of_run);
        more.map(|more| (DVec3::from(view.colours[face]) + more.mean).to_array()).collect()
    }

    fn is_seamless(&self, faces: [usize; 2]) -> bool {
        self.light.is_seamless(faces)
    }
}

impl Light {
    /// Reads what is needed of the latest solution of an engine for a scene.
    ///
    /// # Errors
    /// Fails if the solution belongs to another engine or to other materials, if a camera's position is not
    /// finite, or if the backend fails.
    #[doc(hidden)]
    pub fn new(
        engine: &mut Engine,
        solution: &Solution,
        scene: &Scene,
        cameras: &[Camera],
        reflections: Reflections,
    ) -> Result<Self, EngineError> {
        let view = |camera: &Camera| {
            let colours = engine.colours_without_highlights(solution, camera.position)?;
            Ok(View {
                camera: camera.clone(),
                colours,
                sights: Kept::default(),
                samples: reflections::Kept::default(),
            })
        };
        let views: Vec<View> = cameras.iter().map(view).collect::<Result<_, EngineError>>()?;
        let direct_irradiance = engine.direct.irradiance.clone();
        let total = solution.irradiance.iter().map(|h| DVec3::from(*h));
        let indirect_irradiance: Vec<DVec3> = total.zip(&direct_irradiance).map(|(h, d)| h - *d).collect();
        let interpolation = Interpolation::new(scene);
        let facets = engine.plan().facets().to_vec();
        let sharpened = interpolation.sharpened(&facets, &indirect_irradiance);
        let counts = match reflections {
            Reflections::Rays => Some(reflections::AS_NEEDED),
            Reflections::FixedRays => Some(reflections::FIXED),
            Reflections::Bins => None,
        };
        let mirrors = !views.is_empty() && engine.materials.iter().any(Material::is_glossy);
        let surroundings = counts.filter(|_| mirrors).map(|counts| {
            let direct = interpolation.sharpened(&facets, &direct_irradiance);
            let all: Vec<DVec3> = direct.iter().zip(&sharpened).map(|(d, h)| *d + *h).collect();
            let corners = |face| interpolation.corners(&facets, &all, face);
            Surroundings::new(engine, solution, corners, counts).map(Arc::new)
        });
        let surroundings = surroundings.transpose()?;
        let options = engine.plan().options();
        let differentiable = options.gradients.any();
        let by_geometry = options.gradients.geometry();
        // The CPU has one memory for all: the rest of the budget is for pictures.
        let budget = match options.backend {
            BackendKind::Cpu => options.memory_budget.saturating_sub(engine.plan().memory().total()) / 2,
            BackendKind::Vulkan => MOST_HELD,
        };
        let near = if reflections == Reflections::Rays && !differentiable && !views.is_empty() {
            NearLight::new(&Lit {
                facets: &facets,
                materials: &engine.materials,
                direct: &engine.direct.light,
                interpolation: &interpolation,
                direct_irradiance: &direct_irradiance,
                indirect_irradiance: &indirect_irradiance,
            })?
        } else {
            None
        };
        Ok(Self {
            direct: engine.direct.light.clone(),
            near: near.map(Arc::new),
            placement: engine.plan().placement(),
            materials: engine.materials.clone(),
            patterns: scene.patterns.clone(),
            facets,
            sharpened,
            indirect_irradiance,
            direct_irradiance,
            interpolation,
            is_smooth: reflections != Reflections::Rays,
            surroundings,
            views,
            by_geometry,
            budget: Budget::new(budget.min(MOST_HELD)),
        })
    }

    /// Takes over what geometry alone decides of the pictures of another light, for the same geometry and cameras, so that it is not computed
    /// again.
    #[doc(hidden)]
    pub fn like(mut self, other: &Self) -> Self {
        self.budget = other.budget.clone();
        if Arc::ptr_eq(&self.direct, &other.direct) {
            let same_rays =
                Arc::ptr_eq(&self.patterns, &other.patterns) && self.densities() == other.densities();
            for (own, other) in self.views.iter_mut().zip(&other.views) {
                if own.camera == other.camera {
                    own.sights = other.sights.clone();
                    if same_rays {
                        own.samples = other.samples.clone();
                    }
                }
            }
        }
        self
    }

    /// What decides the rays of points, beside these: of each face that has some, the power of their density.
    fn densities(&self) -> Option<Vec<Option<f64>>> {
        let surroundings = self.surroundings.as_ref().filter(|surroundings| surroundings.is_fixed())?;
        let of = |material: &Material| material.is_glossy().then(|| surroundings.density(material.power));
        Some(self.materials.iter().map(of).collect())
    }

    /// The pixels of a camera's picture. `view`: number of the camera; `coverage`: what it sees.
    ///
    /// # Errors
    /// Fails if the coverage is of a scene with another number of faces, or if ranks can no longer work
    /// together.
    #[doc(hidden)]
    pub fn gathered(&self, view: usize, coverage: &Coverage) -> Result<Gathered, ImageError> {
        let view = &self.views[view];
        let mut pixels = coverage.pixels(&view.colours)?;
        let difference = |points: &Points, light: &LampLight, held: Option<&Held>| {
            self.difference(view, points, light, held)
        };
        let error = self.add(view, coverage, &mut pixels, &difference)?;
        Ok(Gathered { pixels, error })
    }

    /// [`Gathered::pixels`] alone.
    ///
    /// # Errors
    /// Fails as [`Self::gathered`] does.
    pub fn pixels(&self, view: usize, coverage: &Coverage) -> Result<Vec<[f64; 4]>, ImageError> {
        Ok(self.gathered(view, coverage)?.pixels)
    }

    /// The pixels without what the visible faces emit themselves, and [`Gathered::error`].
    #[doc(hidden)]
    pub fn reflected(&self, view: usize, coverage: &Coverage) -> Result<(Vec<DVec3>, f64), ImageError> {
        let view = &self.views[view];
        let colour = |(face, colour)| (self.without_emission(view, face, colour)).to_array();
        let colours: Vec<[f64; 3]> = view.colours.iter().copied().enumerate().map(colour).collect();
        let mut pixels = coverage.pixels(&colours)?;
        let difference = |points: &Points, light: &LampLight, held: Option<&Held>| {
            self.reflected_difference(view, points, light, held)
        };
        let error = self.add(view, coverage, &mut pixels, &difference)?;
        Ok((pixels.into_iter().map(|[r, g, b, _]| DVec3::new(r, g, b)).collect(), error))
    }

    fn without_emission(&self, view: &View, face: usize, colour: [f64; 3]) -> DVec3 {
        let facet = &self.facets[face];
        let faces_eye = facet.normal.dot(self.eye(view) - facet.corners[0]) > 0.0;
        let emission = if faces_eye { DVec3::from(self.materials[face].emission) } else { DVec3::ZERO };
        DVec3::from(colour) - emission
    }

    /// The position of the camera, in the engine's coordinates.
    fn eye(&self, view: &View) -> DVec3 {
        self.placement.apply(view.camera.position)
    }

    /// Adds differences at each visible point to the pixels of a view; returns [`Gathered::error`].
    fn add(
        &self,
        view: &View,
        coverage: &Coverage,
        pixels: &mut [[f64; 4]],
        difference: &Difference,
    ) -> Result<f64, ImageError> {
        let sights = self.sights(view, coverage)?;
        let samples = self.samples(view, &sights);
        let (ranks, count) = (self.direct.ranks(), sights.runs.len());
        let is_diffuse = |face: usize| self.materials[face].diffuse_albedo() != [0.0; 3];
        let mut found = Vec::new();
        for numbers in ranks.own(count).chunks(RUNS) {
            let runs: Vec<&Points> = numbers.iter().map(|&k| &sights.runs[k]).collect();
            let light = light_of(&runs, &self.direct, &self.facets, is_diffuse)?;
            let of_run = |((&k, run), light): ((&usize, &&Points), &Cow<LampLight>)| {
                difference(run, light, samples.as_ref().map(|of_runs| &of_runs[k]))
            };
            found.extend(parallel::map(numbers.iter().zip(&runs).zip(&light), of_run));
        }
        let found = ranks.merged(count, found)?;
        let (mut errors, mut all) = (0.0, 0.0);
        for (run, found) in sights.runs.iter().zip(found) {
            let mean = self.without_emission(view, run.face, view.colours[run.face]);
            for (&place, more) in run.of.iter().zip(found) {
                let seen = &sights.seen[place];
                for (to, more) in pixels[seen.pixel].iter_mut().zip(more.mean.to_array()) {
                    *to += seen.share * more;
                }
                errors += (seen.share * more.error).length_squared();
                all += (seen.share * (mean + more.mean)).length_squared();
            }
        }
        Ok(if all > 0.0 { (errors / all).sqrt() } else { 0.0 })
    }

    /// How far the mean of the radiance that interpolation alone, without sharpening, shows of each face is from that of the face,
    /// W/(m² sr): a measure of how light varies at the scale of the mesh.
    pub(crate) fn blur(&self) -> Vec<DVec3> {
        let blurred = self.interpolation.means(&self.facets, &self.indirect_irradiance);
        let faces = self.materials.iter().zip(self.indirect_irradiance.iter().zip(blurred));
        faces
            .map(|(material, (h, blurred))| DVec3::from(material.diffuse_albedo()) / PI * (*h - blurred))
            .collect()
    }

    fn sights(&self, view: &View, coverage: &Coverage) -> Result<Arc<Sights>, RankError> {
        let sight = self.sight(&view.camera);
        view.sights.of(coverage.faces_in_pixels().collect(), &self.patterns, &sight, |seen| {
            let whole = Sights::new(&sight, seen.to_vec());
            if self.is_smooth || !self.direct.has_sharp_shadows() {
                return Ok(whole);
            }
            let of_run = |k: usize| self.direct.sunlit(&self.facets, whole.runs[k].face, &whole.runs[k].at);
            let mut sunlit = vec![Vec::new(); seen.len()];
            for (run, found) in whole.runs.iter().zip(self.direct.ranks().map(whole.runs.len(), of_run)?) {
                run.of.iter().zip(found).for_each(|(&place, shares)| sunlit[place] = shares);
            }
            let is_glossy = |face: usize| self.materials[face].is_glossy();
            Ok(Sights::new(&sight, edges::cut(&sight, seen, &sunlit, coverage.width() as usize, is_glossy)))
        })
    }

    /// The rays of each run of points, where there are some and these are held.
    fn samples(&self, view: &View, sights: &Arc<Sights>) -> Option<Arc<Vec<Held>>> {
        let holds = |surroundings: &Arc<Surroundings>| surroundings.holds(sights.seen.len());
        self.surroundings.as_ref().filter(|of| holds(of)).map(|_| view.samples.of(sights))
    }

    fn sight(&self, camera: &Camera) -> Sight<'_> {
        Sight {
            facets: &self.facets,
            patterns: &self.patterns,
            view: image::View::new(camera),
            eye: self.placement.apply(camera.position),
            by_geometry: self.by_geometry,
            budget: &self.budget,
        }
    }

    /// The picture of a camera, rounded to f32. `view`: number of the camera; `coverage`: what it sees.
    ///
    /// # Errors
    /// Fails as [`Self::gathered`] does.
    #[doc(hidden)]
    pub fn picture(&self, view: usize, coverage: &Coverage) -> Result<Picture, ImageError> {
        Ok(self.gathered(view, coverage)?.picture(coverage))
    }

    /// What the faces show in a view.
    pub(crate) fn shown(&self, view: usize) -> ShownIn<'_> {
        ShownIn { light: self, view: &self.views[view] }
    }

    /// Whether two faces show the same radiance along the edge that they share: parts of one plane that continue each other.
    fn is_seamless(&self, faces @ [a, b]: [usize; 2]) -> bool {
        let [normal, other] = faces.map(|face| self.facets[face].normal);
        if faces.iter().any(|&face| self.materials[face].is_glossy()) || normal.dot(other) < COPLANAR {
            return false;
        }
        let Some(ends) = self.interpolation.shared_edge(faces) else { return false };
        let around = |face: usize, corner: usize| self.interpolation.around(&self.facets, face, corner);
        let own = |face: usize, corner: usize| {
            let material = &self.materials[face];
            let factors = self.patterns.at(face, DVec3::AXES[corner]);
            let [of_albedo, of_emission] = factors.map_or([DVec3::ONE; 2], |factors| factors.value);
            [of_albedo * DVec3::from(material.diffuse_albedo()), of_emission * DVec3::from(material.emission)]
        };
        let close = |(a, b): (DVec3, DVec3)| (a - b).abs().max_element() <= ROUNDING * a.max_element();
        self.patterns.continue_over_edge(faces, ends)
            && ends.into_iter().all(|[i, j]| {
                around(a, i).eq(around(b, j)) && own(a, i).into_iter().zip(own(b, j)).all(close)
            })
    }

    /// What gathering adds to the radiance of a face at each point, W/(m² sr). `light`: that of lamps there; `held`: room for the rays of each.
    fn difference(
        &self,
        view: &View,
        points: &Points,
        light: &LampLight,
        held: Option<&Held>,
    ) -> Vec<Estimate> {
        let mut differences = self.reflected_difference(view, points, light, held);
        let emission = DVec3::from(self.materials[points.face].emission);
        for (to, [_, of_emission]) in differences.iter_mut().zip(&points.pattern) {
            to.mean += emission * (*of_emission - 1.0);
        }
        differences
    }

    /// The reflected part of [`Self::difference`], W/(m² sr).
    fn reflected_difference(
        &self,
        view: &View,
        points: &Points,
        light: &LampLight,
        held: Option<&Held>,
    ) -> Vec<Estimate> {
        let Points { face, at, pattern, .. } = points;
        let face = *face;
        let eye = self.eye(view);
        let (facet, material) = (&self.facets[face], &self.materials[face]);
        let reflectance = DVec3::from(material.diffuse_albedo()) / PI;
        let radiance = self.lamp_radiance();
        let mut differences = vec![Estimate::default(); at.len()];
        let means = self.direct_irradiance[face] + self.indirect_irradiance[face];
        if reflectance != DVec3::ZERO {
            let near = self.near.as_ref().and_then(|near| Some((near, near.rest(face)?)));
            let interpolated = near.map_or(&self.sharpened[..], |(_, rest)| rest);
            let corners = self.interpolation.corners(&self.facets, interpolated, face);
            for (k, (to, point)) in differences.iter_mut().zip(at).enumerate() {
                let direct: DVec3 = light.at(k).map(|(l, irradiance, _)| irradiance * radiance[l]).sum();
                let b = barycentric(facet.corners, facet.normal, *point);
                let nearby = near.map(|(near, _)| near.received(&self.facets, face, *point));
                let indirect =
                    corners[0] * b.x + corners[1] * b.y + corners[2] * b.z + nearby.unwrap_or_default();
                let shown = pattern.get(k).map_or(DVec3::ONE, |[of_albedo, _]| *of_albedo);
                to.mean += reflectance * (shown * (direct + indirect) - means);
            }
        }
        if material.is_glossy() {
            let highlights = self.direct.highlights(&self.facets, face, at, eye, material.power);
            for (to, of_lamps) in differences.iter_mut().zip(&highlights) {
                let highlight: DVec3 = of_lamps.iter().zip(&radiance).map(|(&h, &l)| h * l).sum();
                to.mean += DVec3::from(material.lobe_scale()) * highlight;
            }
            if let Some(surroundings) = &self.surroundings {
                let diffuse = reflectance * means;
                let of_bins = self.without_emission(view, face, view.colours[face]) - diffuse;
                let known = held.and_then(Held::get);
                let mut samples = Vec::new();
                for (k, (to, point)) in differences.iter_mut().zip(at).enumerate() {
                    let glossy = Glossy { besides: diffuse + to.mean, ..self.glossy(face, *point, eye) };
                    let found = match known {
                        Some(known) => surroundings.along(self.faces(), &glossy, &known[k]),
                        None => {
                            let (found, sample) = surroundings.reflected(self.faces(), &glossy);
                            samples.extend(held.map(|_| sample));
                            found
                        }
                    };
                    to.mean += found.mean - of_bins;
                    to.error = found.error;
                }
                if let (Some(held), None) = (held, known) {
                    held.get_or_init(|| samples);
                }
            }
        }
        differences
    }

    fn faces(&self) -> Faces<'_> {
        Faces { facets: &self.facets, patterns: &self.patterns }
    }

    fn glossy(&self, face: usize, point: DVec3, eye: DVec3) -> Glossy<'_> {
        Glossy {
            face,
            normal: self.facets[face].normal,
            point,
            eye: (eye - point).normalize_or_zero(),
            material: &self.materials[face],
            besides: DVec3::ZERO,
        }
    }

    fn lamp_radiance(&self) -> Vec<DVec3> {
        self.direct.radiance(|i| &self.materials[i])
    }
}
