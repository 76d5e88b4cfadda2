//! Pictures with the last bounce gathered where a camera sees it: direct light at each visible point, and indirect irradiance
//! interpolated over smooth surfaces, in place of one value per face.
//!
//! The radiance of a face towards the camera (the operator S) holds the means of both over the face. Gathering adds, at each point x, the
//! diffuse reflection of the differences D(x) - D and H(x) - H, and the specular reflection of lamps at the exact directions of lamp and
//! eye. What glossy faces reflect of indirect light is that of S.

mod backward;
mod interpolation;

pub use backward::{SeenFrom, ShadingError, backward};

use crate::direct::{DirectLight, barycentric};
use crate::image::{self, Coverage, FaceInPixel, ImageError, Picture};
use crate::model::Facet;
use crate::plan::Placement;
use crate::scene::{Camera, Material, Scene};
use crate::{Engine, EngineError, Solution};
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

/// The light of a solution towards some cameras, on the host: what pictures with gathered light are made from. It outlives its engine.
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
    views: Vec<View>,
}

/// A camera, and the radiance of each face towards it without highlights, W/(m² sr).
#[derive(Clone, Debug)]
struct View {
    camera: Camera,
    colours: Vec<[f64; 3]>,
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
    /// Reads what is needed of the latest solution of an engine for a scene.
    pub fn new(
        engine: &mut Engine,
        solution: &Solution,
        scene: &Scene,
        cameras: &[Camera],
    ) -> Result<Self, EngineError> {
        let view = |camera: &Camera| {
            let colours = engine.colours_without_highlights(solution, camera.position)?;
            Ok(View { camera: camera.clone(), colours })
        };
        let views = cameras.iter().map(view).collect::<Result<_, EngineError>>()?;
        let direct_irradiance = engine.direct.irradiance.clone();
        let total = solution.irradiance.iter().map(|h| DVec3::from(*h));
        Ok(Self {
            direct: engine.direct.light.clone(),
            placement: engine.plan().placement(),
            facets: engine.plan().facets().to_vec(),
            materials: engine.materials.clone(),
            indirect_irradiance: total.zip(&direct_irradiance).map(|(h, d)| h - *d).collect(),
            direct_irradiance,
            interpolation: Interpolation::new(scene),
            views,
        })
    }

    /// The pixels of a camera's picture, row by row from the top: linear RGB, and the share of samples that show a face. `view`: number of the
    /// camera; `coverage`: what it sees.
    pub fn pixels(&self, view: usize, coverage: &Coverage) -> Result<Vec<[f64; 4]>, ImageError> {
        let view = &self.views[view];
        let mut pixels = coverage.pixels(&view.colours)?;
        let seen: Vec<FaceInPixel> = coverage.faces_in_pixels().collect();
        for (seen, more) in seen.iter().zip(self.differences(&view.camera, &seen)) {
            for (to, more) in pixels[seen.pixel].iter_mut().zip(more.to_array()) {
                *to += seen.share * more;
            }
        }
        Ok(pixels)
    }

    /// The same as a picture, rounded to f32.
    pub fn picture(&self, view: usize, coverage: &Coverage) -> Result<Picture, ImageError> {
        let round = |pixel: [f64; 4]| pixel.map(|value| value as f32);
        let pixels = self.pixels(view, coverage)?.into_iter().map(round).collect();
        Ok(Picture { width: coverage.width(), height: coverage.height(), pixels })
    }

    /// The colour of a face at a place of a picture, column and row in pixels: that by which moving silhouettes change it.
    pub fn colour_at(&self, view: usize, face: usize, [column, row]: [f64; 2]) -> [f64; 3] {
        let View { camera, colours } = &self.views[view];
        let ray = image::View::new(camera).ray(column, row);
        let eye = self.placement.apply(camera.position);
        let at = vec![hit(&self.facets[face], eye, ray)];
        let more = self.difference(&Points { face, of: vec![0], at }, eye)[0];
        (DVec3::from(colours[face]) + more).to_array()
    }

    /// What gathering adds to the radiance of each face in a pixel, W/(m² sr).
    fn differences(&self, camera: &Camera, seen: &[FaceInPixel]) -> Vec<DVec3> {
        let runs = self.points(camera, seen);
        let eye = self.placement.apply(camera.position);
        let found: Vec<Vec<DVec3>> = runs.par_iter().map(|run| self.difference(run, eye)).collect();
        let mut differences = vec![DVec3::ZERO; seen.len()];
        for (run, found) in runs.iter().zip(found) {
            run.of.iter().zip(found).for_each(|(&place, found)| differences[place] = found);
        }
        differences
    }

    fn difference(&self, Points { face, at, .. }: &Points, eye: DVec3) -> Vec<DVec3> {
        let face = *face;
        let (facet, material) = (&self.facets[face], &self.materials[face]);
        let reflectance = DVec3::from(material.diffuse_albedo()) / PI;
        let radiance = self.lamp_radiance();
        let mut differences = vec![DVec3::ZERO; at.len()];
        if reflectance != DVec3::ZERO {
            let corners = self.interpolation.corners(&self.facets, &self.indirect_irradiance, face);
            let means = self.direct_irradiance[face] + self.indirect_irradiance[face];
            let light = self.direct.at_points(&self.facets, face, at);
            for (to, (point, of_lamps)) in differences.iter_mut().zip(at.iter().zip(&light)) {
                let direct: DVec3 =
                    of_lamps.iter().zip(&radiance).map(|(phi, l)| phi.dot(facet.normal) * *l).sum();
                let b = barycentric(facet.corners, facet.normal, *point);
                let indirect = corners[0] * b.x + corners[1] * b.y + corners[2] * b.z;
                *to += reflectance * (direct + indirect - means);
            }
        }
        if material.is_glossy() {
            let highlights = self.direct.highlights(&self.facets, face, at, eye, material.power);
            for (to, of_lamps) in differences.iter_mut().zip(&highlights) {
                let highlight: DVec3 = of_lamps.iter().zip(&radiance).map(|(&h, &l)| h * l).sum();
                *to += DVec3::from(material.lobe_scale()) * highlight;
            }
        }
        differences
    }

    fn lamp_radiance(&self) -> Vec<DVec3> {
        self.direct.radiance(|i| &self.materials[i])
    }

    /// Runs of points on one face that are close in the picture.
    fn points(&self, camera: &Camera, seen: &[FaceInPixel]) -> Vec<Points> {
        let view = image::View::new(camera);
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
    let inside = barycentric(facet.corners, facet.normal, point).max(DVec3::ZERO);
    let sum = inside.element_sum();
    if !(sum.is_finite() && sum > 0.0) {
        return facet.centroid;
    }
    let [a, b, c] = facet.corners;
    (a * inside.x + b * inside.y + c * inside.z) / sum
}
