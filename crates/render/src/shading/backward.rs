//! Derivatives of a loss of pictures with gathered light.

use super::Light;
use super::pattern::{self, Spot};
use super::reflections::{OfFace, Sample};
use super::sights::{Points, Sights};
use crate::image::{CameraGradient, Coverage, ImageError, View, camera_gradient};
use antirad_core::direct::{Lamp, barycentric};
use antirad_core::model::FacetGradient;
use antirad_core::plan::GradientRequest;
use antirad_core::solve::SolveProgress;
use antirad_core::{Cotangent, Engine, EngineError, Gradients, Solution, SolveParams};
use antirad_scene::{Factors, Painting};
use glam::DVec3;
use std::collections::{BTreeMap, BTreeSet};
use std::f64::consts::PI;

/// What a camera of a [`Light`] sees, and the derivative of a loss by the pixels of its picture.
pub struct SeenFrom<'a> {
    /// What it sees.
    pub coverage: &'a Coverage,
    /// Derivative of the loss by RGB and alpha of each pixel, row by row from the top; alpha does not depend
    /// on light.
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
    /// The pictures are not differentiable by what is requested.
    #[error(
        "reflections by rays have derivatives by materials and emission alone, and with the same number of rays for all points: \
         make the light with Reflections::Bins, or with Reflections::FixedRays"
    )]
    Rays,
}

/// Derivatives of a loss through what gathering adds to the colours of faces.
struct Differences {
    /// Per triangle, by δρ.
    reflectance: Vec<DVec3>,
    /// Per triangle, by the means of irradiance over it.
    direct: Vec<DVec3>,
    indirect: Vec<DVec3>,
    /// Per triangle, by the sharpened indirect irradiance.
    sharpened: Vec<DVec3>,
    /// Derivatives through what rays bring, by the face that they meet.
    brought: BTreeMap<usize, OfFace>,
    /// Per lamp, by its radiance.
    emission: Vec<DVec3>,
    /// Per triangle, by its own emission, through its pattern.
    own_emission: Vec<DVec3>,
    /// Per triangle, by σ and p.
    specular: Vec<DVec3>,
    power: Vec<f64>,
    facets: Vec<FacetGradient>,
    /// Per camera, per unit of length of the engine.
    cameras: Vec<OfCamera>,
    /// Derivatives by textures that are fitted.
    texels: TexelGradient,
}

/// Derivatives of a loss by the albedo of texels where pictures show it, with light held fixed.
#[derive(Clone, Debug, Default)]
pub struct TexelGradient {
    /// Per [`Painting`] and texel.
    pub shown: Vec<Vec<DVec3>>,
    /// Per triangle, by its albedo with its pattern held fixed: what `shown` stands for of it.
    pub of_triangles: Vec<DVec3>,
}

/// Derivatives of a loss by a camera's position, with its axes held fixed, and by its axes.
#[derive(Clone, Copy, Default, serde::Deserialize, serde::Serialize)]
struct OfCamera {
    position: DVec3,
    axes: [DVec3; 3],
}

/// Derivatives of a loss through what gathering adds at the points on one face.
#[derive(serde::Deserialize, serde::Serialize)]
struct OfPoints {
    reflectance: DVec3,
    means: DVec3,
    emission: Vec<DVec3>,
    own_emission: DVec3,
    specular: DVec3,
    power: f64,
    /// Derivatives by the sharpened indirect irradiance of triangles.
    sharpened: Vec<(usize, DVec3)>,
    /// Derivatives through what rays bring, by the face that they meet.
    brought: BTreeMap<usize, OfFace>,
    facets: Vec<(u32, FacetGradient)>,
    camera: OfCamera,
    /// Derivatives by texels, by painting and texel, and by the triangle's albedo through these.
    texels: Vec<([u32; 2], DVec3)>,
    textured: DVec3,
}

/// Derivatives of a loss of pictures made by [`Light::pixels`]: through the radiance of faces, as [`Engine::backward_with`] returns them, for
/// each camera those through the points that it sees, which add to them, and those by the texels of `paintings` that it shows. The light must
/// be that of the solution. Where rays tell what glossy faces mirror, there are none by positions. The movement of silhouettes is not included
/// ([`crate::image::geometry_gradient`]).
///
/// # Errors
/// Fails if reflections by rays have no derivatives of the requested kinds ([`ShadingError::Rays`]), if a
/// cotangent does not fit its picture, or if the adjoint solve fails or is stopped.
#[expect(clippy::too_many_arguments, reason = "what pictures were made of, and what is wanted of them")]
pub fn backward(
    engine: &mut Engine,
    solution: &Solution,
    light: &Light,
    views: &[SeenFrom],
    request: GradientRequest,
    paintings: &[Painting],
    params: &SolveParams,
    progress: &mut SolveProgress,
) -> Result<(Gradients, Vec<CameraGradient>, TexelGradient), ShadingError> {
    if light.surroundings.as_ref().is_some_and(|rays| !rays.is_fixed() || request.geometry()) {
        return Err(ShadingError::Rays);
    }
    let mut sums = Differences::new(light, paintings);
    let mut colours = Vec::new();
    for (view, seen) in light.views.iter().zip(views) {
        let mut by_colours = seen.coverage.colour_gradient(seen.by_pixels)?;
        if light.surroundings.is_some() {
            // Of glossy faces, pictures show nothing of these colours.
            let faces = by_colours.iter_mut().zip(&light.materials);
            faces.filter(|(_, material)| material.is_glossy()).for_each(|(by, _)| *by = DVec3::ZERO);
        }
        colours.push((view.camera.position, by_colours));
        let movable = &engine.movable;
        let moves = |face| request.positions && movable.triangle(face) || request.camera;
        light.pull_back(view, seen, &Wanted { request, moves: &moves, paintings }, &mut sums)?;
    }
    let specular = sums.pull_back_brought(light);
    sums.pull_back_sharpened(light);
    let cotangent = Cotangent::default()
        .colours_without_highlights(colours)
        .direct_irradiance(Some(std::mem::take(&mut sums.direct)))
        .indirect_irradiance(Some(std::mem::take(&mut sums.indirect)))
        .specular_radiance(specular);
    let mut gradients = engine.backward_with(solution, &cotangent, request, params, progress)?;
    sums.add_to(&mut gradients, light, engine);
    let cameras = sums.by_cameras(light);
    Ok((gradients, cameras, std::mem::take(&mut sums.texels)))
}

/// Which derivatives are wanted.
struct Wanted<'a> {
    request: GradientRequest,
    /// Whether points on a triangle need derivatives by positions: those of movable triangles, and all where
    /// cameras move.
    moves: &'a (dyn Fn(u32) -> bool + Sync),
    /// Textures by whose texels derivatives are wanted.
    paintings: &'a [Painting],
}

impl Differences {
    fn new(light: &Light, paintings: &[Painting]) -> Self {
        let none = || vec![DVec3::ZERO; light.facets.len()];
        let texels = TexelGradient {
            shown: paintings.iter().map(|painting| vec![DVec3::ZERO; painting.texels()]).collect(),
            of_triangles: if paintings.is_empty() { Vec::new() } else { none() },
        };
        Self {
            reflectance: none(),
            direct: none(),
            indirect: none(),
            sharpened: none(),
            brought: BTreeMap::new(),
            emission: vec![DVec3::ZERO; light.direct.lamps().len()],
            own_emission: none(),
            specular: none(),
            power: vec![0.0; light.facets.len()],
            facets: vec![FacetGradient::default(); light.facets.len()],
            cameras: Vec::new(),
            texels,
        }
    }

    fn add_to(&self, gradients: &mut Gradients, light: &Light, engine: &Engine) {
        for (i, (material, by)) in light.materials.iter().zip(&self.reflectance).enumerate() {
            if let Some(albedo) = &mut gradients.albedo {
                albedo[i] += material.diffuse * *by;
            }
            if let Some(diffuse) = &mut gradients.diffuse {
                diffuse[i] += by.dot(material.albedo.into());
            }
        }
        if let Some(specular) = &mut gradients.specular {
            specular.iter_mut().zip(&self.specular).for_each(|(to, by)| *to += *by);
        }
        if let Some(power) = &mut gradients.power {
            power.iter_mut().zip(&self.power).for_each(|(to, by)| *to += by);
        }
        if let Some(emission) = &mut gradients.emission {
            emission.iter_mut().zip(&self.own_emission).for_each(|(to, by)| *to += *by);
            for (lamp, by) in light.direct.lamps().iter().zip(&self.emission) {
                let area: f64 = lamp.triangles().iter().map(|&i| light.facets[i as usize].area).sum();
                for &i in lamp.triangles() {
                    emission[i as usize] += *by * (light.facets[i as usize].area / area);
                }
            }
        }
        if let Some(suns) = &mut gradients.suns {
            suns.iter_mut().zip(light.direct.by_suns(&self.emission)).for_each(|(to, by)| *to += by);
        }
        let corners = |(gradient, facet): (&FacetGradient, &antirad_core::model::Facet)| {
            gradient.to_corners(facet).map(|by| by * light.placement.scale)
        };
        if let (Some(all), Some(vertices)) = (&mut gradients.corners, &mut gradients.vertices) {
            let mut own: Vec<[DVec3; 3]> = self.facets.iter().zip(&light.facets).map(corners).collect();
            engine.keep_movable(&mut own);
            for ((to, own), triangle) in all.iter_mut().zip(own).zip(&engine.triangles) {
                for ((to, own), &vertex) in to.iter_mut().zip(own).zip(triangle) {
                    *to += own;
                    vertices[vertex as usize] += own;
                }
            }
        }
    }
}

impl Differences {
    /// What rays bring, by emission, materials and irradiance; returns the derivatives by the specular radiance of each triangle per bin.
    fn pull_back_brought(&mut self, light: &Light) -> Option<Vec<Vec<DVec3>>> {
        if self.brought.is_empty() {
            return None;
        }
        let mut specular = vec![Vec::new(); light.facets.len()];
        let mut by_all = vec![DVec3::ZERO; light.facets.len()];
        let lamps: BTreeSet<u32> = light.direct.lamps().iter().flat_map(Lamp::triangles).copied().collect();
        for (face, of) in std::mem::take(&mut self.brought) {
            if !lamps.contains(&(face as u32)) {
                self.own_emission[face] += of.emission;
            }
            self.reflectance[face] += of.albedo;
            specular[face] = of.specular;
            let to_corners = of.irradiance;
            let values = &light.sharpened;
            light
                .interpolation
                .pull_back(&light.facets, values, face, to_corners, &mut |i, by, _| by_all[i] += by);
        }
        for (to, by) in self.sharpened.iter_mut().zip(&by_all) {
            *to += *by;
        }
        let (direct, _) =
            light.interpolation.pull_back_sharpened(&light.facets, &light.direct_irradiance, by_all);
        self.direct.iter_mut().zip(direct).for_each(|(to, by)| *to += by);
        Some(specular)
    }

    fn pull_back_sharpened(&mut self, light: &Light) {
        let (by_means, by_areas) = light.interpolation.pull_back_sharpened(
            &light.facets,
            &light.indirect_irradiance,
            std::mem::take(&mut self.sharpened),
        );
        self.indirect.iter_mut().zip(by_means).for_each(|(to, by)| *to += by);
        self.facets.iter_mut().zip(by_areas).for_each(|(to, by)| to.area += by);
    }

    fn by_cameras(&self, light: &Light) -> Vec<CameraGradient> {
        let of_view = |(view, of): (&super::View, &OfCamera)| {
            camera_gradient(&view.camera, of.position * light.placement.scale, of.axes)
        };
        light.views.iter().zip(&self.cameras).map(of_view).collect()
    }
}

impl Light {
    fn pull_back(
        &self,
        view: &super::View,
        loss: &SeenFrom,
        wanted: &Wanted,
        sums: &mut Differences,
    ) -> Result<(), ImageError> {
        let sights = self.sights(view, loss.coverage)?;
        let Sights { seen, runs, .. } = &*sights;
        let by_seen = |place: &usize| {
            let [r, g, b, _] = loss.by_pixels[seen[*place].pixel];
            seen[*place].share * DVec3::new(r, g, b)
        };
        let camera = View::new(&view.camera);
        let mut by_camera = OfCamera::default();
        let samples = self.samples(view, &sights);
        let of_run = |k: usize| {
            let run = &runs[k];
            let rays = samples.as_ref().and_then(|of_runs| of_runs[k].get()).map(|rays| &rays[..]);
            let cotangent: Vec<DVec3> = run.of.iter().map(by_seen).collect();
            let spots: Vec<Spot> = run.of.iter().map(|&place| Spot::from(&seen[place])).collect();
            self.pull_back_points(run, &camera, &cotangent, &spots, rays, wanted)
        };
        let all = self.direct.ranks().map(runs.len(), of_run)?;
        // One after the other, so that sums are the same from run to run.
        for (run, of) in runs.iter().zip(all).filter_map(|(run, of)| Some((run, of?))) {
            sums.reflectance[run.face] += of.reflectance;
            sums.specular[run.face] += of.specular;
            sums.power[run.face] += of.power;
            sums.own_emission[run.face] += of.own_emission;
            sums.direct[run.face] += of.means;
            sums.indirect[run.face] += of.means;
            sums.emission.iter_mut().zip(of.emission).for_each(|(to, by)| *to += by);
            of.sharpened.into_iter().for_each(|(face, by)| sums.sharpened[face] += by);
            of.brought.into_iter().for_each(|(face, by)| sums.brought.entry(face).or_default().add(by));
            of.facets.into_iter().for_each(|(face, by)| sums.facets[face as usize] += by);
            let texels = of.texels.into_iter();
            texels.for_each(|([p, texel], by)| sums.texels.shown[p as usize][texel as usize] += by);
            if let Some(to) = sums.texels.of_triangles.get_mut(run.face) {
                *to += of.textured;
            }
            by_camera.position += of.camera.position;
            by_camera.axes.iter_mut().zip(of.camera.axes).for_each(|(to, by)| *to += by);
        }
        sums.cameras.push(by_camera);
        Ok(())
    }

    /// Derivatives by everything that the points of a run depend on; `None` where all are zero.
    fn pull_back_points(
        &self,
        points @ Points { face, at, pattern, .. }: &Points,
        camera: &View,
        cotangent: &[DVec3],
        spots: &[Spot],
        rays: Option<&[Sample]>,
        &Wanted { request, moves, paintings }: &Wanted,
    ) -> Option<OfPoints> {
        let face = *face;
        let facet = &self.facets[face];
        let reflectance = DVec3::from(self.materials[face].diffuse_albedo()) / PI;
        if cotangent.iter().all(|by| *by == DVec3::ZERO) {
            return None;
        }
        let radiance = self.lamp_radiance();
        let light = points.light(&self.direct, &self.facets);
        let corners = self.interpolation.corners(&self.facets, &self.sharpened, face);
        let means = self.direct_irradiance[face] + self.indirect_irradiance[face];
        let mut of = OfPoints {
            reflectance: DVec3::ZERO,
            means: DVec3::ZERO,
            emission: vec![DVec3::ZERO; radiance.len()],
            own_emission: DVec3::ZERO,
            specular: DVec3::ZERO,
            power: 0.0,
            sharpened: Vec::new(),
            brought: BTreeMap::new(),
            facets: Vec::new(),
            camera: OfCamera::default(),
            texels: Vec::new(),
            textured: DVec3::ZERO,
        };
        let mut own = FacetGradient::default();
        let mut by_corners = [DVec3::ZERO; 3];
        let shown = |k: usize| pattern.get(k).map_or([DVec3::ONE; 2], |factors| *factors);
        let by_irradiance: Vec<DVec3> =
            cotangent.iter().enumerate().map(|(k, by)| reflectance * shown(k)[0] * *by).collect();
        let mut irradiances = Vec::with_capacity(at.len());
        for (k, point) in at.iter().enumerate() {
            let weights = barycentric(facet.corners, facet.normal, *point).to_array();
            let mut irradiance = DVec3::ZERO;
            for (corner, (b, value)) in weights.into_iter().zip(corners).enumerate() {
                irradiance += b * value;
                by_corners[corner] += b * by_irradiance[k];
            }
            for (l, of_lamp, phi) in light.at(k) {
                irradiance += of_lamp * radiance[l];
                of.emission[l] += by_irradiance[k] * of_lamp;
                own.normal += by_irradiance[k].dot(radiance[l]) * phi.unwrap_or_default();
            }
            of.reflectance += cotangent[k] * (shown(k)[0] * irradiance - means) / PI;
            of.means -= reflectance * cotangent[k];
            of.own_emission += cotangent[k] * (shown(k)[1] - 1.0);
            irradiances.push(irradiance);
        }
        self.interpolation.pull_back(
            &self.facets,
            &self.sharpened,
            face,
            by_corners,
            &mut |i, by, by_area| {
                of.sharpened.push((i, by));
                of.facets.push((i as u32, FacetGradient { area: by_area, ..FacetGradient::default() }));
            },
        );
        let eye = self.placement.apply(camera.position);
        if let Some((p, painting)) = (0..).zip(paintings).find(|(_, p)| p.covers(&self.patterns, face)) {
            let diffuse = self.materials[face].diffuse / PI;
            for (k, (irradiance, by)) in irradiances.iter().zip(cotangent).enumerate() {
                let by_albedo = diffuse * *irradiance * *by;
                of.textured += by_albedo * shown(k)[0];
                let samples = spots[k].samples(&self.patterns, facet, face, eye, camera);
                let share = (samples.len() as f64).recip();
                for sample in samples {
                    let b = barycentric(facet.corners, facet.normal, sample.point);
                    let weights = painting.weights(&self.patterns, face, b);
                    of.texels.extend(weights.map(|(texel, w)| ([p, texel], share * w * by_albedo)));
                }
            }
            merge(&mut of.texels);
        }
        let mut by_points = vec![DVec3::ZERO; at.len()];
        let material = &self.materials[face];
        if material.is_glossy() {
            by_points = self.pull_back_highlights(face, at, eye, cotangent, request, &mut of);
            if let Some(surroundings) = &self.surroundings {
                // In place of the colour of the face, less its emission and diffuse radiance.
                let all: DVec3 = cotangent.iter().sum();
                of.own_emission += all;
                of.reflectance += all * means / PI;
                of.means += reflectance * all;
                for (k, (&point, &by)) in at.iter().zip(cotangent).enumerate() {
                    let glossy = self.glossy(face, point, eye);
                    let found = rays.is_none().then(|| surroundings.reflected(self.faces(), &glossy).1);
                    let Some(sample) = rays.map(|rays| &rays[k]).or(found.as_ref()) else { continue };
                    let (by_sigma, by_power) =
                        surroundings.pull_back(self.faces(), &glossy, sample, by, &mut of.brought);
                    of.specular += by_sigma;
                    of.power += by_power;
                }
            }
        }
        if request.geometry() {
            let emission = DVec3::from(self.materials[face].emission);
            let mut move_point = |point: DVec3, ray: DVec3, by_light: DVec3, slope: DVec3| {
                // The point stays on its ray and in the plane: with the ray's end moved by dp and the corners by dc, dx = dp + ray ⟨n, Σ b dc
                // - dp⟩ / ⟨n, ray⟩.
                let along = facet.normal * ((by_light + slope).dot(ray) / facet.normal.dot(ray));
                let by_end = by_light + slope - along;
                let from_eye = point - eye;
                of.camera.position += by_end;
                for (to, axis) in of.camera.axes.iter_mut().zip([camera.right, camera.up, camera.forward]) {
                    *to += by_end * from_eye.dot(axis);
                }
                let weights = barycentric(facet.corners, facet.normal, point).to_array();
                for (to, b) in own.corners.iter_mut().zip(weights) {
                    *to += b * (along - slope);
                }
            };
            let by_phi = |k: usize, l: usize| by_irradiance[k].dot(radiance[l]) * facet.normal;
            let (by_others, by_light) = self.direct.pull_back_points(&self.facets, face, at, by_phi, moves);
            of.facets.extend(by_others);
            by_points.iter_mut().zip(by_light).for_each(|(to, by)| *to += by);
            let along = |values: [f64; 3]| slope(facet.corners, facet.normal, facet.area, values);
            for (k, (&point, by_point)) in at.iter().zip(by_points).enumerate() {
                // Along the face, indirect light changes with the place between the corners.
                let of_light = corners.map(|c| c.dot(by_irradiance[k]));
                let [column, row] = spots[k].middle;
                move_point(point, camera.ray(column, row), by_point, along(of_light));
                // So do albedo and emission, each sample on its own ray.
                let samples = spots[k].samples(&self.patterns, facet, face, eye, camera);
                let share = (samples.len() as f64).recip();
                let (by_albedo, by_emission) =
                    (reflectance * irradiances[k] * cotangent[k] * share, emission * cotangent[k] * share);
                for pattern::Sample { ray, point, factors } in samples {
                    let Factors { slope: [albedo, emission], .. } = factors;
                    let of_pattern =
                        [0, 1, 2].map(|c| by_albedo.dot(albedo[c]) + by_emission.dot(emission[c]));
                    move_point(point, ray, DVec3::ZERO, along(of_pattern));
                }
            }
        }
        of.facets.push((face as u32, own));
        Some(of)
    }
}

impl Light {
    /// Adds the derivatives of highlights; returns those by the points.
    fn pull_back_highlights(
        &self,
        face: usize,
        at: &[DVec3],
        eye: DVec3,
        cotangent: &[DVec3],
        request: GradientRequest,
        of: &mut OfPoints,
    ) -> Vec<DVec3> {
        let (material, radiance) = (&self.materials[face], self.lamp_radiance());
        let (scale, normalization) = (DVec3::from(material.lobe_scale()), material.specular_normalization());
        let highlights = self.direct.highlights(&self.facets, face, at, eye, material.power);
        for (of_lamps, &by) in highlights.iter().zip(cotangent) {
            for (l, (&highlight, &radiance)) in of_lamps.iter().zip(&radiance).enumerate() {
                of.emission[l] += by * scale * highlight;
                of.specular += by * radiance * (normalization * highlight);
            }
        }
        if !(request.geometry() || request.power) {
            return vec![DVec3::ZERO; at.len()];
        }
        let by = |k: usize, l: usize| (cotangent[k] * scale).dot(radiance[l]);
        let gradient = self.direct.pull_back_highlights(&self.facets, face, at, eye, material.power, by);
        // σ N(p): the derivative of N goes with that by σ.
        let slope = material.specular_normalization_derivative() / normalization;
        of.power += gradient.power + slope * of.specular.dot(material.specular.into());
        of.camera.position += gradient.eye;
        of.facets.extend(gradient.facets);
        gradient.points
    }
}

/// Adds up what belongs to one texel.
fn merge(texels: &mut Vec<([u32; 2], DVec3)>) {
    texels.sort_by_key(|(texel, _)| *texel);
    texels.dedup_by(|(texel, by), (last, sum)| {
        let same = texel == last;
        *sum += if same { *by } else { DVec3::ZERO };
        same
    });
}

/// The gradient along a face of the function that has given values at its corners and is linear in between.
fn slope([a, b, c]: [DVec3; 3], normal: DVec3, area: f64, values: [f64; 3]) -> DVec3 {
    let opposite = [c - b, a - c, b - a];
    opposite.into_iter().zip(values).map(|(edge, value)| normal.cross(edge) * value).sum::<DVec3>()
        / (2.0 * area)
}
