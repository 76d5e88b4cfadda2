//! The derivatives of E and K with respect to materials.

use crate::model::Bins;
use crate::reference::{Model, Outgoing, State};
use glam::DVec3;
use rayon::prelude::*;
use std::f64::consts::PI;

/// Derivative of a loss with respect to the [`Material`](crate::scene::Material) of one triangle, as if it had a material of
/// its own. RGB where the material has RGB.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MaterialGradient {
    /// With respect to L_e, per W/(m² sr).
    pub emission: DVec3,
    /// With respect to δ.
    pub diffuse: f64,
    /// With respect to ρ.
    pub albedo: DVec3,
    /// With respect to σ; zero for triangles that are not glossy, which have no bins for it.
    pub specular: DVec3,
    /// With respect to p; zero for triangles that are not glossy.
    pub power: f64,
}

/// The gradient of μ·(E + K H) with respect to the material of every triangle, H (`state`) and μ (`cotangent`) held
/// fixed.
pub fn reflect_derivative(model: &Model, state: &State, cotangent: &Outgoing) -> Vec<MaterialGradient> {
    let gradient = |i: usize| {
        let material = &model.materials[i];
        let light = cotangent.diffuse[i] * state.irradiance[i] / PI;
        let mut gradient = MaterialGradient {
            emission: cotangent.diffuse[i],
            diffuse: DVec3::from(material.albedo).dot(light),
            albedo: material.diffuse * light,
            ..Default::default()
        };
        if let Some(range) = model.bins_of(i).filter(|_| model.classes[i].glossy) {
            let (incident, adjoint) = (&state.bins[range.clone()], &cotangent.specular[range]);
            let lobe = Lobe::new(&model.bins, material.power, incident, adjoint);
            let normalization = material.specular_normalization();
            gradient.specular = normalization * lobe.value;
            let slope =
                material.specular_normalization_derivative() * lobe.value + normalization * lobe.slope;
            gradient.power = DVec3::from(material.specular).dot(slope);
        }
        gradient
    };
    (0..model.facets.len()).into_par_iter().map(gradient).collect()
}

/// Σ_o μ(o) Σ_b ⟨h(b,o),n⟩^p H(b), and its derivative with respect to p.
struct Lobe {
    value: DVec3,
    slope: DVec3,
}

impl Lobe {
    fn new(bins: &Bins, power: f64, incident: &[DVec3], adjoint: &[DVec3]) -> Self {
        let mut lobe = Self { value: DVec3::ZERO, slope: DVec3::ZERO };
        for (o, adjoint) in adjoint.iter().enumerate() {
            for (b, incident) in incident.iter().enumerate() {
                let cosine = bins.half_cosine(b, o);
                let light = cosine.powf(power) * bins.projected[b] * *adjoint * *incident;
                lobe.value += light;
                // x^p ln x tends to zero with x for every p > 0, and counts as zero there for p = 0 too.
                if cosine > 0.0 {
                    lobe.slope += cosine.ln() * light;
                }
            }
        }
        lobe
    }
}
