//! Derivatives of a loss of pictures with gathered light.

use super::{Light, Points, barycentric};
use crate::image::{Coverage, FaceInPixel, ImageError, View};
use crate::model::FacetGradient;
use crate::plan::GradientRequest;
use crate::scene::{Camera, Scene};
use crate::solve::SolveProgress;
use crate::{Cotangent, Engine, EngineError, Gradients, Solution, SolveParams};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// A picture, and the derivative of a loss by its pixels.
pub struct SeenFrom<'a> {
    /// The camera.
    pub camera: &'a Camera,
    /// What it sees.
    pub coverage: &'a Coverage,
    /// Of RGB and alpha, row by row from the top; alpha does not depend on light.
    pub by_pixels: &'a [[f64; 4]],
}

/// Why derivatives of pictures failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShadingError {
    /// The engine failed.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The cotangent does not fit the picture.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// Derivatives of a loss through what gathering adds to the colours of faces.
struct Differences {
    /// Per triangle, by δρ.
    reflectance: Vec<DVec3>,
    /// Per triangle, by the means of irradiance over it.
    direct: Vec<DVec3>,
    indirect: Vec<DVec3>,
    /// Per lamp, by its radiance.
    emission: Vec<DVec3>,
    facets: Vec<FacetGradient>,
}

/// The same of the points on one face.
struct OfPoints {
    reflectance: DVec3,
    means: DVec3,
    emission: Vec<DVec3>,
    /// By the indirect irradiance of triangles.
    indirect: Vec<(usize, DVec3)>,
    facets: Vec<(u32, FacetGradient)>,
}

/// Derivatives of a loss of pictures made by [`Light::pixels`], as [`Engine::backward_with`] returns those of its results. The light must be
/// that of the solution. The movement of silhouettes is not included ([`crate::image::geometry_gradient`]).
pub fn backward(
    engine: &mut Engine,
    solution: &Solution,
    light: &Light,
    scene: &Scene,
    views: &[SeenFrom],
    request: GradientRequest,
    params: &SolveParams,
    progress: &mut SolveProgress,
) -> Result<Gradients, ShadingError> {
    let mut sums = Differences::new(light);
    let mut colours = Vec::new();
    for view in views {
        colours.push((view.camera.position, view.coverage.colour_gradient(view.by_pixels)?));
        light.pull_back(scene, view, request.positions, &mut sums);
    }
    let cotangent = Cotangent::default()
        .colours(colours)
        .direct_irradiance(Some(std::mem::take(&mut sums.direct)))
        .indirect_irradiance(Some(std::mem::take(&mut sums.indirect)));
    let mut gradients = engine.backward_with(solution, &cotangent, request, params, progress)?;
    sums.add_to(&mut gradients, light, scene);
    Ok(gradients)
}

impl Differences {
    fn new(light: &Light) -> Self {
        let none = || vec![DVec3::ZERO; light.facets.len()];
        Self {
            reflectance: none(),
            direct: none(),
            indirect: none(),
            emission: vec![DVec3::ZERO; light.direct.lamps().len()],
            facets: vec![FacetGradient::default(); light.facets.len()],
        }
    }

    fn add_to(&self, gradients: &mut Gradients, light: &Light, scene: &Scene) {
        for (i, (material, by)) in light.materials.iter().zip(&self.reflectance).enumerate() {
            if let Some(albedo) = &mut gradients.albedo {
                albedo[i] += material.diffuse * *by;
            }
            if let Some(diffuse) = &mut gradients.diffuse {
                diffuse[i] += by.dot(material.albedo.into());
            }
        }
        if let Some(emission) = &mut gradients.emission {
            for (lamp, by) in light.direct.lamps().iter().zip(&self.emission) {
                let area: f64 = lamp.triangles.iter().map(|&i| light.facets[i as usize].area).sum();
                for &i in &lamp.triangles {
                    emission[i as usize] += *by * (light.facets[i as usize].area / area);
                }
            }
        }
        let corners = |(gradient, facet): (&FacetGradient, &crate::model::Facet)| {
            gradient.to_corners(facet).map(|by| by * light.placement.scale)
        };
        if let (Some(all), Some(vertices)) = (&mut gradients.corners, &mut gradients.vertices) {
            let own = self.facets.iter().zip(&light.facets).map(corners);
            for ((to, own), triangle) in all.iter_mut().zip(own).zip(&scene.triangles) {
                for ((to, own), &vertex) in to.iter_mut().zip(own).zip(&triangle.vertices) {
                    *to += own;
                    vertices[vertex as usize] += own;
                }
            }
        }
    }
}

impl Light {
    fn pull_back(&self, scene: &Scene, view: &SeenFrom, positions: bool, sums: &mut Differences) {
        let seen: Vec<FaceInPixel> = view.coverage.faces_in_pixels().collect();
        let by_seen = |place: &usize| {
            let [r, g, b, _] = view.by_pixels[seen[*place].pixel];
            seen[*place].share * DVec3::new(r, g, b)
        };
        let camera = View::new(view.camera);
        let runs = self.points(view.camera, &seen);
        let of_run = |run: &Points| {
            let cotangent: Vec<DVec3> = run.of.iter().map(by_seen).collect();
            let rays: Vec<DVec3> = (run.of.iter())
                .map(|&place| camera.ray(seen[place].place[0], seen[place].place[1]))
                .collect();
            self.pull_back_points(scene, run, &cotangent, &rays, positions)
        };
        let all: Vec<Option<OfPoints>> = runs.par_iter().map(of_run).collect();
        // One after the other, so that sums are the same from run to run.
        for (run, of) in runs.iter().zip(all).filter_map(|(run, of)| Some((run, of?))) {
            sums.reflectance[run.face] += of.reflectance;
            sums.direct[run.face] += of.means;
            sums.indirect[run.face] += of.means;
            sums.emission.iter_mut().zip(of.emission).for_each(|(to, by)| *to += by);
            of.indirect.into_iter().for_each(|(face, by)| sums.indirect[face] += by);
            of.facets.into_iter().for_each(|(face, by)| sums.facets[face as usize] += by);
        }
    }

    /// Derivatives by everything that the points of a run depend on; `None` where all are zero.
    fn pull_back_points(
        &self,
        scene: &Scene,
        Points { face, at, .. }: &Points,
        cotangent: &[DVec3],
        rays: &[DVec3],
        positions: bool,
    ) -> Option<OfPoints> {
        let face = *face;
        let facet = &self.facets[face];
        let reflectance = DVec3::from(self.materials[face].diffuse_albedo()) / PI;
        if cotangent.iter().all(|by| *by == DVec3::ZERO) {
            return None;
        }
        let emission = self.lamp_emission();
        let corners = self.interpolation.corners(scene, &self.facets, &self.indirect_irradiance, face);
        let means = self.direct_irradiance[face] + self.indirect_irradiance[face];
        let light = self.direct.at_points(&self.facets, face, at);
        let mut of = OfPoints {
            reflectance: DVec3::ZERO,
            means: DVec3::ZERO,
            emission: vec![DVec3::ZERO; emission.len()],
            indirect: Vec::new(),
            facets: Vec::new(),
        };
        let mut own = FacetGradient::default();
        let mut by_corners = [DVec3::ZERO; 3];
        let by_irradiance: Vec<DVec3> = cotangent.iter().map(|by| reflectance * *by).collect();
        for (k, point) in at.iter().enumerate() {
            let weights = barycentric(facet, *point).to_array();
            let mut irradiance = -means;
            for (corner, (b, value)) in weights.into_iter().zip(corners).enumerate() {
                irradiance += b * value;
                by_corners[corner] += b * by_irradiance[k];
            }
            for (l, (phi, radiance)) in light[k].iter().zip(&emission).enumerate() {
                irradiance += phi.dot(facet.normal) * *radiance;
                of.emission[l] += by_irradiance[k] * phi.dot(facet.normal);
                own.normal += by_irradiance[k].dot(*radiance) * *phi;
            }
            of.reflectance += cotangent[k] * irradiance / PI;
            of.means -= by_irradiance[k];
        }
        let values = &self.indirect_irradiance;
        self.interpolation.pull_back(scene, &self.facets, values, face, by_corners, &mut |i, by, by_area| {
            of.indirect.push((i, by));
            of.facets.push((i as u32, FacetGradient { area: by_area, ..FacetGradient::default() }));
        });
        if positions {
            let by_phi = |k: usize, l: usize| by_irradiance[k].dot(emission[l]) * facet.normal;
            let (by_others, by_points) = self.direct.pull_back_points(&self.facets, face, at, by_phi);
            of.facets.extend(by_others);
            for (k, (&point, by_point)) in at.iter().zip(by_points).enumerate() {
                // Along the face, indirect light changes with the place between the corners.
                let slope =
                    slope(facet.corners, facet.normal, facet.area, corners.map(|c| c.dot(by_irradiance[k])));
                // The point stays on its ray: dx = ray ⟨n, Σ b dc⟩ / ⟨n, ray⟩.
                let along = facet.normal * ((by_point + slope).dot(rays[k]) / facet.normal.dot(rays[k]));
                for (to, b) in own.corners.iter_mut().zip(barycentric(facet, point).to_array()) {
                    *to += b * (along - slope);
                }
            }
        }
        of.facets.push((face as u32, own));
        Some(of)
    }
}

/// The gradient along a face of the function that has given values at its corners and is linear in between.
fn slope([a, b, c]: [DVec3; 3], normal: DVec3, area: f64, values: [f64; 3]) -> DVec3 {
    let opposite = [c - b, a - c, b - a];
    opposite.into_iter().zip(values).map(|(edge, value)| normal.cross(edge) * value).sum::<DVec3>()
        / (2.0 * area)
}
