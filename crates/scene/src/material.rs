//! The Blinn-Phong material.

use glam::DVec3;
use serde::Deserialize;

/// How the specular lobe is scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Normalization {
    /// (p+2)/(2π), the factor of the modified Phong lobe (E. Lafortune and Y. Willems, *Using the Modified Phong Reflectance
    /// Model for Physically Based Rendering*, 1994). With a half vector it gains energy for large p: the albedo is checked
    /// when a scene is loaded.
    #[default]
    Phong,
    /// (p+2)(p+4)/(8π(2^(-p/2)+p)), which keeps the lobe's normal-incidence albedo near σ.
    Energy,
}

/// f = δρ/π + σ N(p) ⟨h,n⟩^p, in 1/sr.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, by which fits and messages refer to it.
    pub name: String,
    /// Diffuse constant δ.
    pub diffuse: f64,
    /// Albedo ρ, RGB.
    pub albedo: [f64; 3],
    /// Specular constant σ, RGB.
    pub specular: [f64; 3],
    /// Power p >= 0.
    pub power: f64,
    /// Emitted radiance L_e, RGB, W/(m² sr), the same in all directions.
    pub emission: [f64; 3],
    /// How the specular lobe is normalised.
    pub normalization: Normalization,
}

impl Material {
    /// A black Lambertian material.
    pub fn named(name: impl Into<String>) -> Self {
        Self {
            name: name.into(),
            diffuse: 1.0,
            albedo: [0.0; 3],
            specular: [0.0; 3],
            power: 0.0,
            emission: [0.0; 3],
            normalization: Normalization::Phong,
        }
    }

    /// True if the specular lobe reflects any light.
    pub fn is_glossy(&self) -> bool {
        self.specular.iter().any(|&s| s > 0.0)
    }

    /// True if it emits light.
    pub fn emits(&self) -> bool {
        self.emission != [0.0; 3]
    }

    /// True if it emits light and reflects none, as skies and most lamps do.
    #[doc(hidden)]
    pub fn only_emits(&self) -> bool {
        self.emits() && !self.is_glossy() && self.diffuse_albedo() == [0.0; 3]
    }

    /// True if it reflects in its lobe alone.
    pub(super) fn is_metal(&self) -> bool {
        self.is_glossy() && self.diffuse_albedo() == [0.0; 3]
    }

    /// This material with factors of its albedo, which colours the lobe of a metal, and of its emission, under another name.
    pub(super) fn scaled(&self, name: String, [albedo, emission]: [DVec3; 2]) -> Self {
        let by = |rgb: [f64; 3], factor: DVec3| (DVec3::from(rgb) * factor).to_array();
        Self {
            name,
            albedo: by(self.albedo, albedo),
            specular: if self.is_metal() { by(self.specular, albedo) } else { self.specular },
            emission: by(self.emission, emission),
            ..self.clone()
        }
    }

    /// True if all its RGB values are grey.
    #[doc(hidden)]
    pub fn is_grey(&self) -> bool {
        [self.albedo, self.specular, self.emission].iter().all(|&[r, g, b]| r == g && g == b)
    }

    /// δρ, RGB: the albedo of the diffuse part.
    pub fn diffuse_albedo(&self) -> [f64; 3] {
        self.albedo.map(|rho| self.diffuse * rho)
    }

    /// N(p), the factor of the specular lobe, 1/sr.
    #[doc(hidden)]
    pub fn specular_normalization(&self) -> f64 {
        use std::f64::consts::PI;
        let p = self.power;
        match self.normalization {
            Normalization::Phong => (p + 2.0) / (2.0 * PI),
            Normalization::Energy => (p + 2.0) * (p + 4.0) / (8.0 * PI * ((-p / 2.0).exp2() + p)),
        }
    }

    /// σ N(p), RGB, 1/sr.
    #[doc(hidden)]
    pub fn lobe_scale(&self) -> [f64; 3] {
        self.specular.map(|sigma| sigma * self.specular_normalization())
    }

    /// dN/dp, 1/sr.
    #[doc(hidden)]
    pub fn specular_normalization_derivative(&self) -> f64 {
        use std::f64::consts::{LN_2, PI};
        let p = self.power;
        match self.normalization {
            Normalization::Phong => 1.0 / (2.0 * PI),
            Normalization::Energy => {
                let decay = (-p / 2.0).exp2();
                let (above, below) = ((p + 2.0) * (p + 4.0), decay + p);
                let (above_slope, below_slope) = (2.0 * p + 6.0, 1.0 - 0.5 * LN_2 * decay);
                (above_slope * below - above * below_slope) / (8.0 * PI * below * below)
            }
        }
    }
}

/// The first of `{name}.1`, `{name}.2` … after a count that is not taken; counts on.
pub(super) fn numbered(name: &str, count: &mut u64, taken: impl Fn(&String) -> bool) -> String {
    loop {
        *count += 1;
        let numbered = format!("{name}.{count}");
        if !taken(&numbered) {
            return numbered;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Central difference at a step of 1e-5: its error is about 1e-11 of N.
    #[test]
    fn the_derivative_of_the_normalization_is_its_slope() {
        for normalization in [Normalization::Phong, Normalization::Energy] {
            for power in [0.0, 0.3, 1.0, 20.0, 1000.0] {
                let at = |power| Material { power, normalization, ..Material::named("m") };
                let step = 1e-5;
                let [above, below] = [step, -step].map(|d| at(power + d).specular_normalization());
                let slope = (above - below) / (2.0 * step);
                let error = at(power).specular_normalization_derivative() - slope;
                assert!(error.abs() <= 1e-10 * above.max(1.0), "{normalization:?} {power}: {error:e}");
            }
        }
    }
}
