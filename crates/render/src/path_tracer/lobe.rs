//! Reflection towards one direction, and random directions of incidence in proportion to it.

use super::numbers::Numbers;
use antirad_scene::Material;
use glam::DVec3;
use std::f64::consts::{FRAC_1_PI, PI, TAU};

/// How a surface reflects light from all directions towards one.
pub struct Reflection {
    normal: DVec3,
    outgoing: DVec3,
    /// δρ/π, 1/sr.
    diffuse: DVec3,
    /// σ N(p), 1/sr.
    specular: DVec3,
    power: f64,
    /// Probability of choosing a direction by the specular lobe.
    share: f64,
}

impl Reflection {
    pub fn new(material: &Material, normal: DVec3, outgoing: DVec3) -> Self {
        let diffuse = FRAC_1_PI * DVec3::from(material.diffuse_albedo());
        let specular = DVec3::from(material.specular) * material.specular_normalization();
        // In proportion to the albedo of either part at normal incidence; the wider a lobe, the more by the cosine alone. Any
        // share is right, but others have more noise.
        let p = material.power;
        let by_lobe = 8.0 * PI * (p + (-p / 2.0).exp2()) / ((p + 2.0) * (p + 4.0)) * specular.element_sum();
        let both = by_lobe + PI * diffuse.element_sum();
        let share = if both > 0.0 { p / (p + 2.0) * by_lobe / both } else { 0.0 };
        Self { normal, outgoing, diffuse, specular, power: p, share }
    }

    /// A white diffuse surface, whose radiance is E/π.
    pub fn white(normal: DVec3) -> Self {
        let white = Material { albedo: [1.0; 3], ..Material::named("white") };
        Self::new(&white, normal, normal)
    }

    pub fn normal(&self) -> DVec3 {
        self.normal
    }

    /// ⟨h,n⟩ and ⟨ω,h⟩ of the half vector h between a direction and the outgoing one.
    fn half(&self, incident: DVec3) -> (f64, f64) {
        let half = (incident + self.outgoing).normalize_or_zero();
        (half.dot(self.normal).max(0.0), half.dot(self.outgoing))
    }

    /// The BRDF for light from a direction, 1/sr.
    pub fn brdf(&self, incident: DVec3) -> DVec3 {
        if self.specular == DVec3::ZERO {
            return self.diffuse;
        }
        self.diffuse + self.specular * self.half(incident).0.powf(self.power)
    }

    /// Probability density with which [`sample`](Self::sample) chooses a direction, 1/sr.
    pub fn density(&self, incident: DVec3) -> f64 {
        let by_cosine = (1.0 - self.share) * FRAC_1_PI * incident.dot(self.normal).max(0.0);
        if self.share <= 0.0 {
            return by_cosine;
        }
        let (cosine, along) = self.half(incident);
        // Half vectors have density (p + 1)/(2π) ⟨h,n⟩^p, and dω = 4⟨ω,h⟩ dh.
        by_cosine + self.share * (self.power + 1.0) / TAU * cosine.powf(self.power) / (4.0 * along)
    }

    /// A random direction of incidence and its density, 1/sr: about the normal with density cosθ/π, or mirrored at a half vector
    /// about the normal with density (p + 1)/(2π) ⟨h,n⟩^p. `None` if the mirrored one lies below the surface.
    pub fn sample(&self, numbers: &mut Numbers) -> Option<(DVec3, f64)> {
        let [choice, v] = numbers.pair();
        let direction = if choice < self.share {
            let cosine = (choice / self.share).powf(1.0 / (self.power + 1.0));
            let half = self.around_normal(cosine, v);
            2.0 * self.outgoing.dot(half) * half - self.outgoing
        } else {
            let u = (choice - self.share) / (1.0 - self.share);
            self.around_normal((1.0 - u).max(0.0).sqrt(), v)
        };
        let density = self.density(direction);
        let above = direction.dot(self.normal) > 0.0 && (direction + self.outgoing).dot(self.normal) > 0.0;
        (above && density > 0.0).then_some((direction, density))
    }

    /// The unit vector at an angle to the normal, given by its cosine, and at an azimuth in turns.
    fn around_normal(&self, cosine: f64, turns: f64) -> DVec3 {
        let (sin, cos) = (TAU * turns).sin_cos();
        let x = self.normal.any_orthonormal_vector();
        let y = self.normal.cross(x);
        (1.0 - cosine * cosine).max(0.0).sqrt() * (cos * x + sin * y) + cosine * self.normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::path_tracer::numbers::estimate;
    use antirad_scene::Normalization;

    /// δρ/π + σ N(p) ⟨h,n⟩^p integrated with cosθ over directions by brute force, in polar coordinates about the mirrored
    /// direction, where sharp lobes are smooth.
    fn albedo(material: &Material, outgoing: DVec3) -> DVec3 {
        let n = DVec3::Z;
        let mirrored = DVec3::new(-outgoing.x, -outgoing.y, outgoing.z);
        let (x, y) = (mirrored.any_orthonormal_vector(), mirrored.cross(mirrored.any_orthonormal_vector()));
        let (rings, sectors) = (4000, 400);
        let mut sum = DVec3::ZERO;
        for i in 0..rings {
            let theta = PI * (f64::from(i) + 0.5) / f64::from(rings);
            let area = theta.sin() * PI / f64::from(rings) * TAU / f64::from(sectors);
            for j in 0..sectors {
                let (sin, cos) = (TAU * (f64::from(j) + 0.5) / f64::from(sectors)).sin_cos();
                let incident = theta.cos() * mirrored + theta.sin() * (cos * x + sin * y);
                if incident.z > 0.0 {
                    let half = (incident + outgoing).normalize();
                    let lobe = material.specular_normalization() * half.dot(n).powf(material.power);
                    sum += area
                        * incident.z
                        * (DVec3::from(material.diffuse_albedo()) / PI
                            + lobe * DVec3::from(material.specular));
                }
            }
        }
        sum
    }

    #[test]
    fn sampled_directions_integrate_to_the_directional_albedo() {
        for (power, normalization) in [
            (0.0, Normalization::Phong),
            (3.0, Normalization::Phong),
            (20.0, Normalization::Energy),
            (200.0, Normalization::Phong),
        ] {
            for (degrees, albedo_of_diffuse) in [(0.0_f64, 0.0), (40.0, 0.3), (80.0, 0.3), (88.0, 0.0)] {
                let material = Material {
                    albedo: [albedo_of_diffuse, 0.5 * albedo_of_diffuse, 0.0],
                    specular: [0.2, 0.1, 0.05],
                    power,
                    normalization,
                    ..Material::named("glossy")
                };
                let (sin, cos) = degrees.to_radians().sin_cos();
                let outgoing = DVec3::new(0.6 * sin, 0.8 * sin, cos);
                let reflection = Reflection::new(&material, DVec3::Z, outgoing);
                let found = estimate(1 << 16, [1, 2], |numbers| {
                    // The first stratified pair is the place on the surface.
                    let _ = numbers.pair();
                    let weight = |(direction, density): (DVec3, f64)| {
                        reflection.brdf(direction) * direction.z / density
                    };
                    reflection.sample(numbers).map_or(DVec3::ZERO, weight)
                });
                let truth = albedo(&material, outgoing);
                // The quadrature cuts rings at the horizon: its own error is below 1e-4 of the truth.
                let bound = 4.5 * found.error + 1e-4 * truth;
                let case = format!("p = {power}, {degrees}°: {found:?}, not {truth}");
                assert!((found.mean - truth).abs().cmple(bound).all(), "{case}");
                assert!(found.error.cmple(0.004 * truth).all(), "{case}");
            }
        }
    }

    /// The density integrates to the probability that a direction is found at all.
    #[test]
    fn densities_are_those_of_the_samples() {
        let material =
            Material { albedo: [0.2; 3], specular: [0.1; 3], power: 12.0, ..Material::named("glossy") };
        let outgoing = DVec3::new(0.7, 0.0, (1.0_f64 - 0.49).sqrt());
        let reflection = Reflection::new(&material, DVec3::Z, outgoing);
        // Of directions left, right and near the mirrored one, against uniform directions.
        let parts = |d: DVec3| DVec3::new(f64::from(d.x > 0.0), f64::from(d.y > 0.3), f64::from(d.x < -0.6));
        let sampled = estimate(1 << 16, [3, 0], |numbers| {
            reflection.sample(numbers).map_or(DVec3::ZERO, |(d, _)| parts(d))
        });
        let uniform = estimate(1 << 16, [3, 1], |numbers| {
            let [z, turns] = numbers.pair();
            let (sin, cos) = (TAU * turns).sin_cos();
            let d = DVec3::new((1.0 - z * z).sqrt() * cos, (1.0 - z * z).sqrt() * sin, z);
            TAU * reflection.density(d) * parts(d)
        });
        let bound = 4.5 * (sampled.error + uniform.error);
        assert!((sampled.mean - uniform.mean).abs().cmple(bound).all(), "{sampled:?}, {uniform:?}");
        assert!(bound.max_element() <= 0.02, "{bound}");
    }
}
