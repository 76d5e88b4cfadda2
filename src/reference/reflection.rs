//! K: reflection. Twin of glsl/reflect.comp and glsl/reflect_glossy.comp.

use super::{Model, Outgoing, State};
use crate::model::Bins;
use crate::scene::Material;
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// E: emission as outgoing light.
pub fn emission(model: &Model) -> Outgoing {
    let diffuse = model.materials.iter().map(|m| DVec3::from(m.emission)).collect();
    Outgoing { diffuse, ..model.dark() }
}

/// K: diffuse radiance (δρ/π) Σ_b H(b), and per outgoing bin o of glossy triangles Σ_b σ N(p) ⟨h(b,o),n⟩^p H(b), W/(m² sr).
pub fn reflect(model: &Model, state: &State) -> Outgoing {
    let mut outgoing = emission(model);
    outgoing.diffuse = (0..model.facets.len())
        .map(|i| DVec3::from(model.materials[i].diffuse_albedo()) / PI * state.irradiance[i])
        .collect();
    let lobes: Vec<(usize, Vec<DVec3>)> = (0..model.facets.len())
        .into_par_iter()
        .filter(|&i| model.classes[i].glossy)
        .filter_map(|i| model.bins_of(i).map(|range| (range.start, specular(model, i, &state.bins[range]))))
        .collect();
    for (first, lobe) in lobes {
        outgoing.specular[first..first + lobe.len()].copy_from_slice(&lobe);
    }
    outgoing
}

fn specular(model: &Model, i: usize, incident: &[DVec3]) -> Vec<DVec3> {
    let material = &model.materials[i];
    let scale = specular_scale(material);
    let light = spread(&model.bins, material.power, |b| model.bins.projected[b] * incident[b]);
    light.into_iter().map(|light| scale * light).collect()
}

/// σ N(p), RGB, 1/sr.
pub(super) fn specular_scale(material: &Material) -> DVec3 {
    DVec3::from(material.specular) * material.specular_normalization()
}

/// Σ_b ⟨h(b,o),n⟩^p value(b), per outgoing bin o.
pub(super) fn spread(bins: &Bins, power: f64, value: impl Fn(usize) -> DVec3) -> Vec<DVec3> {
    let sum = |o: usize| (0..bins.count()).map(|b| bins.half_cosine(b, o).powf(power) * value(b)).sum();
    (0..bins.count()).map(sum).collect()
}
