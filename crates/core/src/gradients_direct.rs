//! Derivatives of the light that comes straight from lamps: by emission, materials and corners.

use crate::engine::Engine;
use crate::gradients::Cotangent;
use crate::model::FacetGradient;
use crate::plan::{GradientRequest, PADDING};
use antirad_base::ranks::RankError;
use antirad_scene::Material;
use glam::DVec3;
use std::f64::consts::PI;

/// Derivatives through direct light, in SI units but for lengths, which are the engine's.
pub(crate) struct DirectGradients {
    /// Per triangle; that of lamps is complete, without what is emitted into U.
    pub emission: Vec<DVec3>,
    /// Per sun, by its irradiance.
    pub suns: Vec<DVec3>,
    pub specular: Vec<DVec3>,
    pub power: Vec<f64>,
    pub facets: Vec<FacetGradient>,
    /// Per camera of [`Cotangent::colours`].
    pub cameras: Vec<DVec3>,
}

/// The derivative of a loss by what glossy triangles send out per bin: per group, by slot, bin and RGB.
pub(crate) type SpecularCotangent = Vec<Option<Vec<f64>>>;

/// Derivatives of a loss through the specular lobes of one triangle.
#[derive(serde::Deserialize, serde::Serialize)]
struct OfLobes {
    triangle: usize,
    lamps: Vec<DVec3>,
    specular: DVec3,
    power: f64,
    facets: Vec<(u32, FacetGradient)>,
    eye: DVec3,
}

impl Engine {
    /// Derivatives through direct light, from the cotangents of radiance and specular radiance, without
    /// views. `of_radiance` contains the views.
    pub(crate) fn direct_gradients(
        &self,
        cotangent: &Cotangent,
        of_radiance: &[DVec3],
        of_specular: &SpecularCotangent,
        request: GradientRequest,
    ) -> Result<DirectGradients, RankError> {
        let (triangles, positions) = (of_radiance.len(), request.positions);
        let light = &self.direct.light;
        let mut sums = DirectGradients {
            emission: vec![DVec3::ZERO; triangles],
            suns: Vec::new(),
            specular: vec![DVec3::ZERO; triangles],
            power: vec![0.0; triangles],
            facets: vec![FacetGradient::default(); triangles],
            cameras: vec![DVec3::ZERO; cotangent.colours.len()],
        };
        if light.lamps().is_empty() {
            return Ok(sums);
        }
        let of_direct = self.direct_cotangent(cotangent, of_radiance);
        let mut by_lamps = vec![DVec3::ZERO; light.lamps().len()];
        for (i, &by) in of_direct.iter().enumerate() {
            light.factors(i).iter().for_each(|factor| by_lamps[factor.lamp as usize] += by * factor.value);
        }
        if positions {
            let radiance = light.radiance(|i| &self.materials[i]);
            let by_factor = |receiver: usize, lamp: usize| of_direct[receiver].dot(radiance[lamp]);
            let movable = &self.movable;
            sums.facets = light.pull_back(self.plan().facets(), by_factor, |i| movable.triangle(i))?;
        }
        let mut lobes = self.pull_back_lobes(of_specular, positions || request.power)?;
        for (camera, (position, colours)) in cotangent.colours.iter().enumerate() {
            for of in self.pull_back_highlights(*position, colours)? {
                sums.cameras[camera] += of.eye;
                lobes.push(of);
            }
        }
        for of in lobes {
            by_lamps.iter_mut().zip(of.lamps).for_each(|(to, by)| *to += by);
            sums.specular[of.triangle] += of.specular;
            sums.power[of.triangle] += of.power;
            if positions {
                of.facets.into_iter().for_each(|(i, by)| sums.facets[i as usize] += by);
            }
        }
        self.set_lamp_emission(cotangent, &by_lamps, &mut sums.emission);
        sums.suns = light.by_suns(&by_lamps);
        Ok(sums)
    }

    /// Cotangent of the direct irradiance of each triangle: that of irradiance, and through its diffuse reflection.
    fn direct_cotangent(&self, cotangent: &Cotangent, of_radiance: &[DVec3]) -> Vec<DVec3> {
        let reflected = |(m, material): (&DVec3, &Material)| *m * DVec3::from(material.diffuse_albedo()) / PI;
        let mut of_direct: Vec<DVec3> = of_radiance.iter().zip(&self.materials).map(reflected).collect();
        let of_means = cotangent.irradiance.as_ref().map(|values| self.of_means(values));
        for values in [of_means.as_ref(), cotangent.direct_irradiance.as_ref()].into_iter().flatten() {
            of_direct.iter_mut().zip(values).for_each(|(to, own)| *to += *own);
        }
        of_direct
    }

    /// Derivatives by the emission of lamps: by what is seen of them, and by their direct light. The
    /// triangles of one lamp share the derivative by direct light in proportion to their areas.
    fn set_lamp_emission(&self, cotangent: &Cotangent, by_lamps: &[DVec3], emission: &mut [DVec3]) {
        let facets = self.plan().facets();
        for (lamp, by_light) in self.direct.light.lamps().iter().zip(by_lamps) {
            let area: f64 = lamp.triangles().iter().map(|&i| facets[i as usize].area).sum();
            for i in lamp.triangles().iter().map(|&i| i as usize) {
                let radiosity = cotangent.radiosity.as_ref().map_or(DVec3::ZERO, |values| PI * values[i]);
                emission[i] = radiosity + *by_light * (facets[i].area / area);
            }
        }
        for (camera_position, colours) in cotangent.views() {
            for i in self.lamp_triangles_facing(*camera_position) {
                emission[i] += colours[i];
            }
        }
    }

    /// Derivatives through the light of lamps that glossy triangles send into U. `shape`: also by power and
    /// geometry.
    fn pull_back_lobes(
        &self,
        of_specular: &SpecularCotangent,
        shape: bool,
    ) -> Result<Vec<OfLobes>, RankError> {
        let plan = self.plan();
        let (bins, facets) = (&plan.bins().centre, plan.facets());
        let (light, known, materials) = (&self.direct.light, &self.direct.lobes, &self.materials);
        let radiance = light.radiance(|i| &materials[i]);
        // The values of each glossy triangle, by bin.
        let mut of_triangles: Vec<(usize, Vec<DVec3>)> = Vec::new();
        for (group, values) in plan.layout().groups.iter().zip(of_specular) {
            let slots = plan.layout().slots_of(&group.tiles);
            for (slot, values) in slots.zip(values.iter().flat_map(|values| values.chunks(3 * bins.len()))) {
                let triangle = plan.layout().order[slot as usize];
                if triangle != PADDING {
                    let by_bin = values.chunks(3).map(DVec3::from_slice).collect();
                    of_triangles.push((triangle as usize, by_bin));
                }
            }
        }
        let of_triangle = |number: usize| {
            let (triangle, by_bin) = &of_triangles[number];
            let at = known.binary_search_by_key(triangle, |lobes| lobes.triangle).ok()?;
            let (material, values) = (&materials[*triangle], &known[at].values);
            let (scale, normalization) =
                (DVec3::from(material.lobe_scale()), material.specular_normalization());
            let of_lamp = |l: usize| -> DVec3 { values[l].iter().zip(by_bin).map(|(&s, &by)| s * by).sum() };
            let lamps: Vec<DVec3> = (0..radiance.len()).map(of_lamp).collect();
            let light_of_lobe: DVec3 = lamps.iter().zip(&radiance).map(|(&by, &l)| by * l).sum();
            let mut of = OfLobes {
                triangle: *triangle,
                specular: normalization * light_of_lobe,
                power: DVec3::from(material.specular).dot(light_of_lobe)
                    * material.specular_normalization_derivative(),
                lamps: lamps.into_iter().map(|by| by * scale).collect(),
                facets: Vec::new(),
                eye: DVec3::ZERO,
            };
            if shape {
                let by = |l: usize, b: usize| (by_bin[b] * scale).dot(radiance[l]);
                let (facets, by_power) = light.pull_back_lobes(facets, *triangle, bins, material.power, by);
                of.facets = facets;
                of.power += by_power;
            }
            Some(of)
        };
        Ok(light.ranks().map(of_triangles.len(), of_triangle)?.into_iter().flatten().collect())
    }

    /// Derivatives through the highlights of faces towards a camera.
    fn pull_back_highlights(
        &self,
        camera_position: DVec3,
        colours: &[DVec3],
    ) -> Result<Vec<OfLobes>, RankError> {
        let facets = self.plan().facets();
        let eye = self.plan().placement().apply(camera_position);
        let (light, materials) = (&self.direct.light, &self.materials);
        let radiance = light.radiance(|i| &materials[i]);
        let highlighted = self.highlighted(camera_position);
        let of_triangle = |number: usize| {
            let (triangle, points, shares) = &highlighted[number];
            let cotangent: Vec<DVec3> = shares.iter().map(|share| *share * colours[*triangle]).collect();
            let material = &materials[*triangle];
            let scale = DVec3::from(material.lobe_scale());
            let values = light.highlights(facets, *triangle, points, eye, material.power);
            let of_lamp =
                |l: usize| -> DVec3 { values.iter().zip(&cotangent).map(|(h, &by)| h[l] * by).sum() };
            let lamps: Vec<DVec3> = (0..radiance.len()).map(of_lamp).collect();
            let light_of_lobe: DVec3 = lamps.iter().zip(&radiance).map(|(&by, &l)| by * l).sum();
            let by = |k: usize, l: usize| (cotangent[k] * scale).dot(radiance[l]);
            let mut gradient = light.pull_back_highlights(facets, *triangle, points, eye, material.power, by);
            let mut own = FacetGradient::default();
            for (sample, by) in light.whole_samples().iter().zip(&gradient.points) {
                own.corners.iter_mut().zip(sample.barycentric.to_array()).for_each(|(to, b)| *to += b * *by);
            }
            gradient.facets.push((*triangle as u32, own));
            OfLobes {
                triangle: *triangle,
                specular: material.specular_normalization() * light_of_lobe,
                power: DVec3::from(material.specular).dot(light_of_lobe)
                    * material.specular_normalization_derivative()
                    + gradient.power,
                lamps: lamps.into_iter().map(|by| by * scale).collect(),
                facets: gradient.facets,
                eye: gradient.eye,
            }
        };
        light.ranks().map(highlighted.len(), of_triangle)
    }
}
