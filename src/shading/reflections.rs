//! What glossy faces reflect of others, gathered along rays: a row of U for each visible point, with the BRDF at the exact directions of
//! source and eye, in place of one for each face that is read from bins.
//!
//! Half vectors are chosen in proportion to the lobe, so that with N rays L = σ N(p) 8π/(p + 1) Σ ⟨e, h⟩ cosθ L(ω) / N, where rays below the
//! surface bring nothing. A ray brings what the face that it meets emits, unless that is a lamp whose highlight is exact; what it reflects
//! diffusely, interpolated; and what it reflects specularly, out of bins.

use crate::direct::{barycentric, mixed};
use crate::model::{Bins, Facet};
use crate::scene::{Material, Patterns, Rays};
use crate::{Engine, EngineError, Solution};
use glam::DVec3;
use std::f64::consts::{PI, TAU};

/// Rays of a point: at first, and at most. Powers of two fill the unit square most evenly.
const RAYS: [u32; 2] = [16, 512];

/// Standard error, relative to what is seen of the point, up to which there are more.
const ERROR: f64 = 0.01;

/// Parts of a point's rays, one after the other, whose means tell the error.
const PARTS: u32 = 4;

/// What rays see of the faces of a solution.
pub struct Surroundings {
    rays: Rays,
    /// Per face, W/(m² sr).
    emission: Vec<DVec3>,
    /// Per face, diffuse radiance at its corners, W/(m² sr).
    diffuse: Vec<[DVec3; 3]>,
    bins: Bins,
    /// Specular radiance per bin, of the faces that have one, W/(m² sr).
    specular: Vec<[f32; 3]>,
    /// Per face, where its bins begin.
    begin: Vec<Option<usize>>,
}

impl std::fmt::Debug for Surroundings {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("Surroundings").field("faces", &self.emission.len()).finish_non_exhaustive()
    }
}

/// A point of a glossy face, and the eye that looks at it.
pub struct Glossy<'a> {
    pub face: usize,
    pub normal: DVec3,
    pub point: DVec3,
    /// Unit direction to it.
    pub eye: DVec3,
    pub material: &'a Material,
    /// What is seen of the point besides, W/(m² sr): accuracy is relative to all.
    pub besides: DVec3,
}

/// Radiance and its standard error, W/(m² sr).
#[derive(Clone, Copy, Debug, Default)]
pub struct Estimate {
    pub mean: DVec3,
    pub error: DVec3,
}

impl Surroundings {
    /// `irradiance`: at the corners of each face, of all light, W/m².
    pub fn new(
        engine: &mut Engine,
        solution: &Solution,
        irradiance: impl Fn(usize) -> [DVec3; 3],
    ) -> Result<Self, EngineError> {
        let (mut specular, mut begin) = (Vec::new(), vec![None; solution.irradiance.len()]);
        engine.check_own(solution)?;
        engine.each_specular(&solution.state, &mut |face, bins| {
            begin[face] = Some(specular.len());
            specular.extend(bins.iter().map(|rgb| rgb.as_vec3().to_array()));
        })?;
        let (plan, materials) = (engine.plan(), &engine.materials);
        let facets = plan.facets();
        let mut emission: Vec<DVec3> = materials.iter().map(|material| material.emission.into()).collect();
        for &i in engine.direct.light.lamps().iter().flat_map(|lamp| &lamp.triangles) {
            emission[i as usize] = DVec3::ZERO;
        }
        let diffuse = |(face, material): (usize, &Material)| {
            irradiance(face).map(|h| DVec3::from(material.diffuse_albedo()) / PI * h)
        };
        let corners = facets.iter().map(|facet| facet.corners).collect();
        Ok(Self {
            rays: Rays::among(corners, |i| facets[*i as usize].area > 0.0),
            emission,
            diffuse: materials.iter().enumerate().map(diffuse).collect(),
            bins: plan.bins().clone(),
            specular,
            begin,
        })
    }

    /// What the lobe of a point reflects towards the eye of all that rays meet.
    pub fn reflected(&self, facets: &[Facet], patterns: &Patterns, at: &Glossy) -> Estimate {
        let Glossy { face, normal, point, eye, material, besides } = *at;
        let power = material.power;
        let scale = DVec3::from(material.lobe_scale()) * (8.0 * PI / (power + 1.0));
        let across = normal.any_orthonormal_pair();
        let coordinates = point.to_array().map(f64::to_bits);
        let seed = coordinates.into_iter().fold(face as u64, |seed, bits| mixed(seed ^ bits));
        let shift = [seed as u32, (seed >> 32) as u32];
        let along_ray = |ray: u32| {
            let [u, v] = sobol(ray, shift);
            let cosine = u.powf(1.0 / (power + 1.0));
            let (sin, cos) = (TAU * v).sin_cos();
            let level = (1.0 - cosine * cosine).max(0.0).sqrt();
            let half = cosine * normal + level * (cos * across.0 + sin * across.1);
            let along = eye.dot(half);
            let direction = 2.0 * along * half - eye;
            let incident = direction.dot(normal);
            match along > 0.0 && incident > 0.0 {
                true => along * incident * self.seen(facets, patterns, face, point, direction),
                false => DVec3::ZERO,
            }
        };
        let [mut count, most] = RAYS;
        // Of parts of the first rays, and of as many rays more.
        let (length, mut sums) = (count / PARTS, Vec::new());
        loop {
            let begins = (sums.len() as u32 * length..count).step_by(length as usize);
            sums.extend(begins.map(|begin| (begin..begin + length).map(along_ray).sum::<DVec3>()));
            let of_part = scale * f64::from(PARTS) / f64::from(count);
            let parts = sums.chunks(sums.len() / PARTS as usize);
            let means = parts.map(|part| of_part * part.iter().sum::<DVec3>());
            let mean = means.clone().sum::<DVec3>() / f64::from(PARTS);
            let squares: DVec3 = means.map(|of_part| (of_part - mean).powf(2.0)).sum();
            let error = (squares / f64::from(PARTS * (PARTS - 1))).map(f64::sqrt);
            let seen = (mean + besides).abs().element_sum();
            if count >= most || error.element_sum() <= ERROR * seen {
                return Estimate { mean, error };
            }
            count *= 2;
        }
    }

    /// Radiance that arrives at a point of a face from a direction, exact lamps left out.
    fn seen(
        &self,
        facets: &[Facet],
        patterns: &Patterns,
        from: usize,
        point: DVec3,
        direction: DVec3,
    ) -> DVec3 {
        let Some((face, distance)) = self.rays.nearest(point, direction, Some(from)) else {
            return DVec3::ZERO;
        };
        let facet = &facets[face];
        if direction.dot(facet.normal) >= 0.0 {
            // Backs are black.
            return DVec3::ZERO;
        }
        let b = barycentric(facet.corners, facet.normal, point + distance * direction);
        let diffuse = self.diffuse[face];
        let diffuse = diffuse[0] * b.x + diffuse[1] * b.y + diffuse[2] * b.z;
        let [of_albedo, of_emission] = patterns.at(face, b).map_or([DVec3::ONE; 2], |factors| factors.value);
        let specular = |begin: usize| -> DVec3 {
            let taps = self.bins.taps(facet.to_local(-direction));
            taps.iter()
                .map(|&(bin, weight)| weight * DVec3::from(self.specular[begin + bin].map(f64::from)))
                .sum()
        };
        of_emission * self.emission[face]
            + of_albedo * diffuse
            + self.begin[face].map_or(DVec3::ZERO, specular)
    }
}

/// A point of the sequence of Sobol' (1967) in the unit square, digits shifted: the first 2^k fill it evenly, and so do the next ones.
fn sobol(index: u32, shift: [u32; 2]) -> [f64; 2] {
    let (mut second, mut digit, mut left) = (0, 1 << 31, index);
    while left > 0 {
        second ^= if left & 1 == 1 { digit } else { 0 };
        digit ^= digit >> 1;
        left >>= 1;
    }
    [index.reverse_bits() ^ shift[0], second ^ shift[1]].map(|x| (f64::from(x) + 0.5) / 2f64.powi(32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{BinLayout, Weights};

    /// A closed cube around the origin whose faces emit inwards: 1 below z = .2, 3 above.
    fn cube() -> (Vec<Facet>, Surroundings) {
        let mut facets = Vec::new();
        let mut emission = Vec::new();
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let [x, y] = [1, 2].map(|k| DVec3::AXES[(axis + k) % 3]);
                let z = side * DVec3::AXES[axis];
                let at = |[u, v]: [f64; 2]| z + u * x + v * y;
                // Each side in four strips, so that some lie above .2 altogether.
                let bounds = [-1.0, -0.4, 0.2, 0.6, 1.0];
                for strip in bounds.windows(2) {
                    let along_x = x == DVec3::Z;
                    let corners = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[i, j]| match along_x {
                        true => at([strip[i], [-1.0, 1.0][j]]),
                        false => at([[-1.0, 1.0][i], strip[j]]),
                    });
                    for [a, b, c] in [[0, 1, 2], [0, 2, 3]] {
                        let corners = match side < 0.0 {
                            true => [corners[a], corners[b], corners[c]],
                            false => [corners[a], corners[c], corners[b]],
                        };
                        let facet = Facet::new(corners);
                        assert!(facet.normal.dot(facet.centroid) < 0.0);
                        emission.push(DVec3::splat(if facet.centroid.z > 0.2 { 3.0 } else { 1.0 }));
                        facets.push(facet);
                    }
                }
            }
        }
        let corners = facets.iter().map(|facet| facet.corners).collect();
        let count = facets.len();
        let surroundings = Surroundings {
            rays: Rays::among(corners, |_| true),
            emission,
            diffuse: vec![[DVec3::ZERO; 3]; count],
            bins: Bins::new(BinLayout::Concentric { n: 2 }, Weights::Bilinear),
            specular: Vec::new(),
            begin: vec![None; count],
        };
        (facets, surroundings)
    }

    #[test]
    fn points_of_the_sequence_fill_the_square() {
        for (begin, shift) in [(0, [0, 0]), (64, [0, 0]), (0, [0x9e37_79b9, 0x7f4a_7c15])] {
            // One in each of 64 cells, whatever their shape.
            for rows in [1, 2, 4, 8, 16, 32, 64] {
                let columns = 64 / rows;
                let mut cells: Vec<usize> = (begin..begin + 64)
                    .map(|i| {
                        let [x, y] = sobol(i, shift);
                        (x * columns as f64) as usize * rows + (y * rows as f64) as usize
                    })
                    .collect();
                cells.sort_unstable();
                assert_eq!(cells, (0..64).collect::<Vec<_>>(), "{begin} {rows}");
            }
        }
    }

    /// Against ∫ ⟨h, n⟩^p cosθ L dω on a fine grid about the mirrored direction.
    #[test]
    fn lobes_reflect_what_surrounds_them() {
        let (facets, surroundings) = cube();
        let normal = DVec3::new(0.36, 0.48, 0.8);
        let (x, y) = normal.any_orthonormal_pair();
        let patterns = Patterns::default();
        for power in [0.0, 3.0, 40.0, 900.0] {
            for degrees in [0.0_f64, 50.0, 80.0] {
                let (sin, cos) = degrees.to_radians().sin_cos();
                let eye = cos * normal + sin * (0.6 * x + 0.8 * y);
                let mirrored = 2.0 * eye.dot(normal) * normal - eye;
                let (s, t) = mirrored.any_orthonormal_pair();
                let (rings, sectors) = (3000, 300);
                let mut expected = 0.0;
                for i in 0..rings {
                    // Finer towards the middle.
                    let angle = PI * ((f64::from(i) + 0.5) / f64::from(rings)).powi(2);
                    let width = 2.0 * PI * (f64::from(i) + 0.5) / f64::from(rings).powi(2);
                    for j in 0..sectors {
                        let (b, a) = (TAU * (f64::from(j) + 0.5) / f64::from(sectors)).sin_cos();
                        let direction = angle.cos() * mirrored + angle.sin() * (a * s + b * t);
                        let cosine = direction.dot(normal);
                        if cosine > 0.0 {
                            let out = direction / direction.abs().max_element();
                            let light = if out.z > 0.2 { 3.0 } else { 1.0 };
                            let lobe = (direction + eye).normalize().dot(normal).powf(power);
                            expected +=
                                lobe * cosine * light * angle.sin() * width * TAU / f64::from(sectors);
                        }
                    }
                }
                let material = Material { specular: [1.0; 3], power, ..Material::named("glossy") };
                expected *= material.specular_normalization();
                let besides = DVec3::ZERO;
                let point = DVec3::new(0.01, -0.02, 0.03) * 0.1;
                let at = Glossy { face: usize::MAX, normal, point, eye, material: &material, besides };
                let Estimate { mean, error } = surroundings.reflected(&facets, &patterns, &at);
                let off = (mean.x - expected).abs();
                println!(
                    "p = {power}, {degrees}°: {} ± {} {expected} {:.1e}",
                    mean.x,
                    error.x,
                    off / expected
                );
                assert!(off <= 3.0 * error.x + 0.01 * expected, "{mean} ± {error}, not {expected}");
                assert!(error.x <= 0.02 * expected, "{error} of {expected}");
            }
        }
    }
}
