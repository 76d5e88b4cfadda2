//! The total albedo of a material.

use std::f64::consts::PI;

use super::material::Material;

/// Angles of incidence sampled, in degrees from the normal. Closer to grazing a lobe loses light below the horizon; a
/// constant one (p = 0) reflects the same at all angles.
const INCIDENCES: std::ops::RangeInclusive<u32> = 0..=17;
const INCIDENCE_STEP: f64 = 5.0;
const POLAR_STEPS: u32 = 256;
const AZIMUTH_STEPS: u32 = 48;

impl Material {
    /// Albedo of the specular lobe for σ = 1, the maximum over angles of incidence. It scales with σ.
    ///
    /// ∫ N(p) ⟨h,n⟩^p cosθ dω over the reflected directions, to about 1 % for p up to 1e5.
    #[doc(hidden)]
    pub fn specular_albedo_per_sigma(&self) -> f64 {
        INCIDENCES
            .map(|step| self.lobe_albedo((f64::from(step) * INCIDENCE_STEP).to_radians()))
            .fold(0.0, f64::max)
    }

    /// An upper bound of [`Self::specular_albedo_per_sigma`]: ⟨ω,h⟩ cosθ ≤ 1 in the integral over half vectors.
    pub(super) fn specular_albedo_bound(&self) -> f64 {
        8.0 * PI * self.specular_normalization() / (self.power + 1.0)
    }

    /// The largest albedo over channels and directions of incidence: diffuse plus specular.
    ///
    /// At 1 and above, the solve of a closed room of this material diverges.
    #[doc(hidden)]
    pub fn total_albedo(&self) -> f64 {
        let lobe = if self.is_glossy() { self.specular_albedo_per_sigma() } else { 0.0 };
        self.total_albedo_with(lobe)
    }

    /// [`Self::total_albedo`], given [`Self::specular_albedo_per_sigma`].
    pub(super) fn total_albedo_with(&self, lobe: f64) -> f64 {
        let channels = self.diffuse_albedo().into_iter().zip(self.specular);
        channels.map(|(diffuse, sigma)| diffuse + sigma * lobe).fold(0.0, f64::max)
    }

    /// Integrated over half vectors, dω = 4⟨ω,h⟩ dh, with u = ⟨h,n⟩^(p+1): the lobe itself is constant in u, so that sharp
    /// lobes need no more steps than wide ones.
    fn lobe_albedo(&self, incidence: f64) -> f64 {
        let (sin_i, cos_i) = incidence.sin_cos();
        let mut sum = 0.0;
        for polar in 0..POLAR_STEPS {
            let u = (f64::from(polar) + 0.5) / f64::from(POLAR_STEPS);
            let cos_h = u.powf(1.0 / (self.power + 1.0));
            let sin_h = (1.0 - cos_h * cos_h).max(0.0).sqrt();
            // The other half of the azimuths is the mirror image of this one.
            for azimuth in 0..AZIMUTH_STEPS {
                let phi = PI * (f64::from(azimuth) + 0.5) / f64::from(AZIMUTH_STEPS);
                let along = sin_i * sin_h * phi.cos() + cos_i * cos_h;
                let cos_o = 2.0 * along * cos_h - cos_i;
                sum += along.max(0.0) * cos_o.max(0.0);
            }
        }
        let mean = sum / f64::from(POLAR_STEPS * AZIMUTH_STEPS);
        self.specular_albedo_bound() * mean
    }
}

#[cfg(test)]
mod tests {
    use super::super::Normalization;
    use super::*;

    fn lobe(power: f64) -> Material {
        Material { power, specular: [1.0; 3], ..Material::named("lobe") }
    }

    #[test]
    fn published_factor_at_normal_incidence() {
        for (power, expected) in [(5., 2.30), (20., 3.33), (50., 3.70), (100., 3.84), (1e5, 4.0)] {
            let albedo = lobe(power).lobe_albedo(0.0);
            assert!((albedo - expected).abs() < 0.01, "p = {power}: {albedo}");
        }
    }

    #[test]
    fn energy_factor_stays_at_or_below_one() {
        for power in [0., 1., 5., 20., 100., 1000., 1e5] {
            let material = Material { normalization: Normalization::Energy, ..lobe(power) };
            let albedo = material.specular_albedo_per_sigma();
            assert!(albedo < 1.01, "p = {power}: {albedo}");
            assert!(albedo <= material.specular_albedo_bound(), "p = {power}: {albedo}");
        }
    }

    #[test]
    fn a_constant_lobe_reflects_sigma_at_every_incidence() {
        for step in INCIDENCES {
            let albedo = lobe(0.0).lobe_albedo((f64::from(step) * INCIDENCE_STEP).to_radians());
            assert!((albedo - 1.0).abs() < 0.01, "{step}: {albedo}");
        }
    }

    /// The albedo of a lobe against the plain integral over outgoing directions: that is slow for sharp
    /// lobes, but needs no change of variables.
    #[test]
    fn agrees_with_a_plain_integral_over_directions() {
        for (power, degrees) in [(1., 30.), (5., 60.), (20., 80.), (100., 45.)] {
            let material = lobe(power);
            let incidence = f64::to_radians(degrees);
            let n = 1000;
            let mut sum = 0.0;
            for i in 0..n {
                // Uniform in cos²θ, which is cosθ dω.
                let cos2 = (f64::from(i) + 0.5) / f64::from(n);
                for j in 0..n {
                    let phi = 2.0 * PI * (f64::from(j) + 0.5) / f64::from(n);
                    let sin_o = (1.0 - cos2).sqrt();
                    let out = glam::DVec3::new(sin_o * phi.cos(), sin_o * phi.sin(), cos2.sqrt());
                    let half = out + glam::DVec3::new(incidence.sin(), 0.0, incidence.cos());
                    sum += half.normalize().z.powf(power);
                }
            }
            let plain = material.specular_normalization() * PI * sum / f64::from(n * n);
            let albedo = material.lobe_albedo(incidence);
            assert!((albedo - plain).abs() < 0.01 * plain, "p = {power} at {degrees}: {albedo}, {plain}");
        }
    }
}
