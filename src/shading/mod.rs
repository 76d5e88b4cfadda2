//! Pictures with the last bounce gathered where a camera sees it: direct light at each visible point, and indirect irradiance
//! interpolated over smooth surfaces, in place of one value per face.
//!
//! The radiance of a face towards the camera ([`Engine::face_colours`]) holds the means of both over the face. Gathering adds, at each
//! point x, the diffuse reflection of the differences D(x) - D and H(x) - H.

mod backward;
mod interpolation;

pub use backward::{SeenFrom, ShadingError, backward};

use crate::direct::DirectLight;
use crate::image::{Coverage, FaceInPixel, ImageError, Picture, View};
use crate::model::Facet;
use crate::plan::Placement;
use crate::scene::{Camera, Material, Scene};
use crate::{Engine, Solution};
use glam::DVec3;
use interpolation::Interpolation;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::PI;
use std::sync::Arc;

/// How a picture shows the light of faces.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Shading {
    /// One colour per face.
    Face,
    /// Interpolated between the corners of faces.
    Smooth,
    /// Direct light at each visible point, indirect light interpolated.
    #[default]
    Gathered,
}

/// Points that share a search for blockers.
const POINTS: usize = 64;

/// The light of a solution on the host, which outlives its engine: what pictures with gathered light are made from.
#[derive(Clone, Debug)]
pub struct Light {
    direct: Arc<DirectLight>,
    placement: Placement,
    /// In the engine's coordinates.
    facets: Vec<Facet>,
    materials: Vec<Material>,
    /// Means over each triangle, W/m².
    direct_irradiance: Vec<DVec3>,
    indirect_irradiance: Vec<DVec3>,
    interpolation: Interpolation,
}

/// Points of a picture on one face, in the order of the picture.
struct Points {
    face: usize,
    /// Indices into the faces in pixels.
    of: Vec<usize>,
    /// Engine's coordinates.
    at: Vec<DVec3>,
}

impl Light {
    /// Copies what is needed of the latest solution of an engine for a scene.
    pub fn new(engine: &Engine, solution: &Solution, scene: &Scene) -> Self {
        let direct_irradiance = engine.direct_irradiance.clone();
        let total = solution.irradiance.iter().map(|h| DVec3::from(*h));
        Self {
            direct: engine.direct.clone(),
            placement: engine.plan().placement(),
            facets: engine.plan().facets().to_vec(),
            materials: engine.materials.clone(),
            indirect_irradiance: total.zip(&direct_irradiance).map(|(h, d)| h - *d).collect(),
            direct_irradiance,
            interpolation: Interpolation::new(scene),
        }
    }

    /// The pixels of a picture, row by row from the top: linear RGB, and the share of samples that show a face. `colours`: radiance of each
    /// face towards the camera.
    pub fn pixels(
        &self,
        scene: &Scene,
        camera: &Camera,
        coverage: &Coverage,
        colours: &[[f64; 3]],
    ) -> Result<Vec<[f64; 4]>, ImageError> {
        let mut pixels = coverage.pixels(colours)?;
        let seen: Vec<FaceInPixel> = coverage.faces_in_pixels().collect();
        for (seen, more) in seen.iter().zip(self.differences(scene, camera, &seen)) {
            for (to, more) in pixels[seen.pixel].iter_mut().zip(more.to_array()) {
                *to += seen.share * more;
            }
        }
        Ok(pixels)
    }

    /// The same as a picture, rounded to f32.
    pub fn picture(
        &self,
        scene: &Scene,
        camera: &Camera,
        coverage: &Coverage,
        colours: &[[f64; 3]],
    ) -> Result<Picture, ImageError> {
        let round = |pixel: [f64; 4]| pixel.map(|value| value as f32);
        let pixels = self.pixels(scene, camera, coverage, colours)?.into_iter().map(round).collect();
        Ok(Picture { width: coverage.width(), height: coverage.height(), pixels })
    }

    /// The colour of each face in each pixel that shows it, by which moving silhouettes change a picture. A face that no sample of a
    /// pixel shows has the colour of its mean light there.
    pub fn colours_in_pixels<'a>(
        &self,
        scene: &Scene,
        camera: &Camera,
        coverage: &Coverage,
        colours: &'a [[f64; 3]],
    ) -> impl Fn(usize, usize) -> [f64; 3] + Sync + use<'a> {
        let seen: Vec<FaceInPixel> = coverage.faces_in_pixels().collect();
        let differences = self.differences(scene, camera, &seen);
        // Ordered by pixel, then face.
        let keys: Vec<(usize, usize)> = seen.iter().map(|seen| (seen.pixel, seen.face)).collect();
        move |face, pixel| {
            let more = keys.binary_search(&(pixel, face)).map_or(DVec3::ZERO, |at| differences[at]);
            (DVec3::from(colours[face]) + more).to_array()
        }
    }

    /// What gathering adds to the radiance of each face in a pixel, W/(m² sr).
    pub(crate) fn differences(&self, scene: &Scene, camera: &Camera, seen: &[FaceInPixel]) -> Vec<DVec3> {
        let runs = self.points(camera, seen);
        let found: Vec<Vec<DVec3>> = runs.par_iter().map(|run| self.difference(scene, run)).collect();
        let mut differences = vec![DVec3::ZERO; seen.len()];
        for (run, found) in runs.iter().zip(found) {
            run.of.iter().zip(found).for_each(|(&place, found)| differences[place] = found);
        }
        differences
    }

    fn difference(&self, scene: &Scene, Points { face, at, .. }: &Points) -> Vec<DVec3> {
        let face = *face;
        let facet = &self.facets[face];
        let reflectance = DVec3::from(self.materials[face].diffuse_albedo()) / PI;
        if reflectance == DVec3::ZERO {
            return vec![DVec3::ZERO; at.len()];
        }
        let emission = self.lamp_emission();
        let corners = self.interpolation.corners(scene, &self.facets, &self.indirect_irradiance, face);
        let means = self.direct_irradiance[face] + self.indirect_irradiance[face];
        let light = self.direct.at_points(&self.facets, face, at);
        let total = |(point, of_lamps): (&DVec3, &Vec<DVec3>)| {
            let direct: DVec3 =
                of_lamps.iter().zip(&emission).map(|(phi, l)| phi.dot(facet.normal) * *l).sum();
            let b = barycentric(facet, *point);
            let indirect = corners[0] * b.x + corners[1] * b.y + corners[2] * b.z;
            reflectance * (direct + indirect - means)
        };
        at.iter().zip(&light).map(total).collect()
    }

    fn lamp_emission(&self) -> Vec<DVec3> {
        self.direct.lamps().iter().map(|lamp| self.materials[lamp.first()].emission.into()).collect()
    }

    /// Runs of points on one face that are close in the picture.
    fn points(&self, camera: &Camera, seen: &[FaceInPixel]) -> Vec<Points> {
        let view = View::new(camera);
        let eye = self.placement.apply(view.position);
        let mut by_face: BTreeMap<usize, Vec<usize>> = BTreeMap::new();
        for (place, seen) in seen.iter().enumerate() {
            by_face.entry(seen.face).or_default().push(place);
        }
        let mut runs = Vec::new();
        for (face, places) in by_face {
            let facet = &self.facets[face];
            let point = |&place: &usize| {
                let [column, row] = seen[place].place;
                hit(facet, eye, view.ray(column, row))
            };
            for of in places.chunks(POINTS) {
                runs.push(Points { face, of: of.to_vec(), at: of.iter().map(point).collect() });
            }
        }
        runs
    }
}

/// Where a ray meets the plane of a face; the mean of its visible samples may lie outside of it.
fn hit(facet: &Facet, eye: DVec3, ray: DVec3) -> DVec3 {
    let distance = (facet.centroid - eye).dot(facet.normal) / ray.dot(facet.normal);
    let point = eye + distance * ray;
    let inside = barycentric(facet, point).max(DVec3::ZERO);
    let sum = inside.element_sum();
    if !(sum.is_finite() && sum > 0.0) {
        return facet.centroid;
    }
    let [a, b, c] = facet.corners;
    (a * inside.x + b * inside.y + c * inside.z) / sum
}

/// Barycentric coordinates of a point of a face.
fn barycentric(facet: &Facet, point: DVec3) -> DVec3 {
    let [a, b, c] = facet.corners.map(|corner| corner - point);
    let areas =
        DVec3::new(b.cross(c).dot(facet.normal), c.cross(a).dot(facet.normal), a.cross(b).dot(facet.normal));
    areas / (2.0 * facet.area)
}
