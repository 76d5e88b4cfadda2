//! K: reflection. Twin of glsl/reflect.comp and glsl/reflect_glossy.comp.

use super::{Leaving, Model, State};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// E: what is emitted, in the form of light that leaves.
pub fn emission(model: &Model) -> Leaving {
    let dark = model.zero();
    Leaving {
        diffuse: model.materials.iter().map(|m| DVec3::from(m.emission)).collect(),
        specular: dark.bins.clone(),
        antiradiance: dark.bins,
    }
}

/// L = (δρ/π) Σ_b H(b), and per front bin of glossy triangles Σ_b σ N(p) ⟨h(b,o),n⟩^p H(b).
pub fn reflect(model: &Model, state: &State) -> Leaving {
    let mut leaving = emission(model);
    leaving.diffuse = (0..model.facets.len())
        .map(|i| DVec3::from(model.materials[i].diffuse_albedo()) / PI * state.irradiance[i])
        .collect();
    let lobes: Vec<(usize, Vec<DVec3>)> = (0..model.facets.len())
        .into_par_iter()
        .filter(|&i| model.classes[i].glossy)
        .filter_map(|i| model.bins_of(i).map(|range| (range.start, specular(model, i, &state.bins[range]))))
        .collect();
    for (first, lobe) in lobes {
        leaving.specular[first..first + lobe.len()].copy_from_slice(&lobe);
    }
    leaving
}

fn specular(model: &Model, i: usize, arriving: &[DVec3]) -> Vec<DVec3> {
    let material = &model.materials[i];
    let scale = DVec3::from(material.specular) * material.specular_normalization();
    let centre = &model.bins.centre;
    centre
        .iter()
        .map(|&out| {
            let lobe = |b: usize| (centre[b] + out).normalize_or_zero().z.max(0.0).powf(material.power);
            let irradiance = |b: usize| model.bins.projected[b] * arriving[b];
            scale * (0..centre.len()).map(|b| lobe(b) * irradiance(b)).sum::<DVec3>()
        })
        .collect()
}
