//! Limits what materials of mesh files reflect. Such files were written for renderers that clamp: `Kd 1 1 1` and
//! `Kd .8, Ks .5, Ns 250` are common, and would gain energy here.

use super::{Material, Normalization};

/// What a limited material reflects: as much as the whitest paints.
const MOST: f64 = 0.9;
/// What a limited material may at least reflect in its lobe, as much as glass and plastics do.
const LEAST_SPECULAR: f64 = 0.05;

impl Material {
    /// Scales diffuse and specular reflection so that together they reflect at most [`MOST`], if they reflect all light or more.
    /// Returns the total albedo before.
    ///
    /// The lobe takes the normalization that keeps its albedo near σ, then what the diffuse part leaves it, but at least
    /// [`LEAST_SPECULAR`]; then the diffuse part takes the rest. Colours keep their hue.
    pub(super) fn limit_energy(&mut self) -> Option<f64> {
        let numbers = [self.albedo, self.specular, [self.diffuse, self.power, 0.0]];
        if numbers.iter().flatten().any(|x| !(x.is_finite() && *x >= 0.0)) {
            // The check refuses it and says why.
            return None;
        }
        let bound = if self.is_glossy() { self.specular_albedo_bound() } else { 0.0 };
        if self.total_albedo_with(bound) < 1.0 {
            return None;
        }
        let before = self.total_albedo();
        if before < 1.0 {
            return None;
        }
        let diffuse = largest(self.diffuse_albedo());
        let mut lobe = 0.0;
        if self.is_glossy() {
            self.normalization = Normalization::Energy;
            let per_sigma = self.specular_albedo_per_sigma();
            lobe = largest(self.specular) * per_sigma;
            let room = (MOST - diffuse).max(LEAST_SPECULAR);
            if lobe > room {
                self.specular = self.specular.map(|sigma| sigma * room / lobe);
                lobe = room;
            }
        }
        if diffuse + lobe > MOST {
            let factor = (MOST - lobe) / diffuse;
            self.albedo = self.albedo.map(|rho| rho * factor);
        }
        Some(before)
    }
}

fn largest(rgb: [f64; 3]) -> f64 {
    rgb.into_iter().fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn material(albedo: f64, specular: f64, power: f64) -> Material {
        Material { albedo: [albedo; 3], specular: [specular; 3], power, ..Material::named("m") }
    }

    #[test]
    fn what_gains_energy_is_limited_and_nothing_else() {
        for (albedo, specular, power) in
            [(1.0, 0.0, 0.0), (0.8, 0.5, 250.0), (1.0, 1.0, 0.0), (0.0, 1.0, 1e3), (2.0, 9.0, 5.0)]
        {
            let mut limited = material(albedo, specular, power);
            let before = limited.total_albedo();
            assert_eq!(limited.limit_energy(), Some(before));
            let after = limited.total_albedo();
            assert!((0.85..=0.91).contains(&after), "{albedo} {specular} {power}: {after}");
            assert!(limited.is_glossy() == (specular > 0.0));
            assert_eq!(limited.clone().limit_energy(), None, "a second time");
        }
        for (albedo, specular, power) in
            [(0.99, 0.0, 0.0), (0.5, 0.1, 100.0), (f64::NAN, 0.0, 0.0), (-1.0, 3.0, 1.0)]
        {
            let mut kept = material(albedo, specular, power);
            assert_eq!(kept.limit_energy(), None);
            assert_eq!(format!("{kept:?}"), format!("{:?}", material(albedo, specular, power)));
        }
    }

    #[test]
    fn colours_keep_their_hue() {
        let mut red = Material { albedo: [1.2, 0.6, 0.3], ..Material::named("red") };
        red.limit_energy();
        for (found, expected) in red.albedo.into_iter().zip([0.9, 0.45, 0.225]) {
            assert!((found - expected).abs() <= 1e-12, "{:?}", red.albedo);
        }
    }
}
