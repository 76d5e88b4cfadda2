//! What glossy faces reflect of others, gathered along rays: a row of U for each visible point, with the BRDF at the exact directions of
//! source and eye, in place of one for each face that is read from bins.
//!
//! Half vectors are chosen in proportion to the lobe of a power q, so that with n rays the radiance is
//! σ N(p) 8π/(q + 1) Σ ⟨h, n⟩^(p - q) ⟨e, h⟩ cosθ L(ω) / n, where rays below the surface bring nothing. q is p, or near it where rays must not move with p. A ray brings what the face that it
//! meets emits, unless that is a lamp, whose highlight is exact; what it reflects diffusely, interpolated; and what it reflects specularly,
//! out of bins.

use super::sights::Sights;
use antirad_core::direct::{Lamp, barycentric, mixed, sobol};
use antirad_core::model::{Bins, Facet, Taps, rays_among};
use antirad_core::{Engine, EngineError, Solution};
use antirad_scene::{Material, Patterns, Rays};
use glam::DVec3;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};

/// Number of rays of a point: at first, and at most. Powers of two fill the unit square most evenly.
pub const AS_NEEDED: [u32; 2] = [16, 512];

/// Number of rays of a point, where all points have the same: at first, and at most.
pub const FIXED: [u32; 2] = [64, 64];

/// Standard error, relative to what is seen of the point, up to which there are more.
const ERROR: f64 = 0.01;

/// Parts of a point's rays, one after the other, whose means tell the error.
const PARTS: u32 = 4;

/// Largest number of rays to hold: 200 MB.
const MOST_KEPT: usize = 5_000_000;

/// What rays see of the faces of a solution.
pub struct Surroundings {
    rays: Arc<Rays>,
    /// Per face, W/(m² sr); of lamps zero.
    emission: Vec<DVec3>,
    /// Per face, δρ/π, and the irradiance at its corners, W/m².
    reflectance: Vec<DVec3>,
    irradiance: Vec<[DVec3; 3]>,
    bins: Bins,
    /// Specular radiance per bin, of the faces that have one, W/(m² sr).
    specular: Vec<DVec3>,
    /// Per face, where its bins begin.
    begin: Vec<Option<usize>>,
    /// Rays of a point: at first, and at most.
    counts: [u32; 2],
}

impl std::fmt::Debug for Surroundings {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.debug_struct("Surroundings").field("faces", &self.emission.len()).finish_non_exhaustive()
    }
}

/// Faces, and how their light varies within them.
#[derive(Clone, Copy)]
pub struct Faces<'a> {
    pub facets: &'a [Facet],
    pub patterns: &'a Patterns,
}

/// A point of a glossy face, and the eye that looks at it.
#[derive(Clone, Copy)]
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

/// A ray that meets the front of a face.
#[derive(Clone, Copy, Debug)]
pub struct Ray {
    face: u32,
    /// Number of the ray among those of the point.
    number: u32,
    /// The first two barycentric coordinates of the point where it meets the face.
    at: [f64; 2],
    /// 8π/(q + 1) ⟨e, h⟩ cosθ.
    weight: f64,
    /// ⟨h, n⟩.
    cosine: f64,
}

/// The rays of a point that meet fronts.
#[derive(Clone, Debug, Default)]
pub struct Sample {
    pub rays: Vec<Ray>,
    /// All rays.
    count: u32,
    /// q.
    power: f64,
}

/// Radiance and its standard error, W/(m² sr).
#[derive(Clone, Copy, Debug, Default, serde::Deserialize, serde::Serialize)]
pub struct Estimate {
    pub mean: DVec3,
    pub error: DVec3,
}

/// Derivatives of a loss through what rays bring of a face.
#[derive(Clone, Debug, Default, serde::Deserialize, serde::Serialize)]
pub struct OfFace {
    pub emission: DVec3,
    /// Derivative by δρ.
    pub albedo: DVec3,
    /// Derivative by the irradiance at the corners.
    pub irradiance: [DVec3; 3],
    /// Derivative by the specular radiance per bin; empty where the face has none.
    pub specular: Vec<DVec3>,
}

impl Surroundings {
    /// `irradiance`: at the corners of each face, of all light, W/m².
    ///
    /// # Errors
    /// Fails if the solution belongs to another engine or to other materials, or if the backend fails.
    pub fn new(
        engine: &mut Engine,
        solution: &Solution,
        irradiance: impl Fn(usize) -> [DVec3; 3],
        counts: [u32; 2],
    ) -> Result<Self, EngineError> {
        let (mut specular, mut begin) = (Vec::new(), vec![None; solution.irradiance.len()]);
        engine.check_own(solution)?;
        engine.each_specular(&solution.state, &mut |face, bins| {
            begin[face] = Some(specular.len());
            specular.extend_from_slice(bins);
        })?;
        let (plan, materials) = (engine.plan(), &engine.materials);
        let facets = plan.facets();
        let mut emission: Vec<DVec3> = materials.iter().map(|material| material.emission.into()).collect();
        for &i in engine.direct.light.lamps().iter().flat_map(Lamp::triangles) {
            emission[i as usize] = DVec3::ZERO;
        }
        let reflectance = |material: &Material| DVec3::from(material.diffuse_albedo()) / PI;
        Ok(Self {
            rays: rays_among(facets),
            emission,
            reflectance: materials.iter().map(reflectance).collect(),
            irradiance: (0..facets.len()).map(irradiance).collect(),
            bins: plan.bins().clone(),
            specular,
            begin,
            counts,
        })
    }

    /// Whether all points have as many rays.
    pub fn is_fixed(&self) -> bool {
        self.counts[0] == self.counts[1]
    }

    /// q: where all points have as many rays, these are the same for lobes of similar power, so that pictures are smooth functions of it.
    pub fn density(&self, power: f64) -> f64 {
        if self.is_fixed() { (power + 1.0).log2().round().exp2() - 1.0 } else { power }
    }

    /// Whether the rays of a number of points can be held: all have as many, and these are not too many.
    pub fn holds(&self, points: usize) -> bool {
        self.is_fixed() && points.saturating_mul(self.counts[1] as usize) <= MOST_KEPT
    }

    /// What the lobe of a point reflects towards the eye of all that rays meet, and these.
    pub fn reflected(&self, faces: Faces, at: &Glossy) -> (Estimate, Sample) {
        let [mut count, most] = self.counts;
        let mut sample = Sample { power: self.density(at.material.power), ..Sample::default() };
        loop {
            sample.rays.extend(
                (sample.count..count).filter_map(|number| self.ray(faces.facets, at, sample.power, number)),
            );
            sample.count = count;
            let found = self.along(faces, at, &sample);
            let seen = (found.mean + at.besides).abs().element_sum();
            if count >= most || found.error.element_sum() <= ERROR * seen {
                return (found, sample);
            }
            count *= 2;
        }
    }

    /// What the lobe of a point reflects towards the eye of all that given rays meet, W/(m² sr).
    pub fn along(&self, faces: Faces, at: &Glossy, sample: &Sample) -> Estimate {
        let scale = DVec3::from(at.material.lobe_scale()) / f64::from(sample.count);
        let mut parts = [DVec3::ZERO; PARTS as usize];
        for ray in &sample.rays {
            let weight = ray.weight(at.material.power, sample.power);
            parts[(ray.number * PARTS / sample.count) as usize] +=
                weight * self.radiance(faces, at.point, ray);
        }
        let mean = scale * parts.iter().sum::<DVec3>();
        let of_parts = parts.map(|part| f64::from(PARTS) * scale * part - mean);
        let squares: DVec3 = of_parts.iter().map(|off| off * off).sum();
        Estimate { mean, error: (squares / f64::from(PARTS * (PARTS - 1))).map(f64::sqrt) }
    }

    /// A ray of a point by its number; `None` where it goes below the surface or meets no front.
    fn ray(&self, facets: &[Facet], at: &Glossy, power: f64, number: u32) -> Option<Ray> {
        let Glossy { face, normal, point, eye, .. } = *at;
        let coordinates = point.to_array().map(f64::to_bits);
        let seed = coordinates.into_iter().fold(face as u64, |seed, bits| mixed(seed ^ bits));
        let [u, v] = place(number, [seed as u32, (seed >> 32) as u32]);
        let across = normal.any_orthonormal_pair();
        let cosine = u.powf(1.0 / (power + 1.0));
        let (sin, cos) = (TAU * v).sin_cos();
        let level = (1.0 - cosine * cosine).max(0.0).sqrt();
        let half = cosine * normal + level * (cos * across.0 + sin * across.1);
        let along = eye.dot(half);
        let direction = 2.0 * along * half - eye;
        let incident = direction.dot(normal);
        if along <= 0.0 || incident <= 0.0 {
            return None;
        }
        let (met, distance) = self.rays.nearest(point, direction, Some(face))?;
        let facet = &facets[met];
        // Backs are black.
        (direction.dot(facet.normal) < 0.0).then(|| {
            let b = barycentric(facet.corners, facet.normal, point + distance * direction);
            let weight = 8.0 * PI / (power + 1.0) * along * incident;
            Ray { face: met as u32, number, at: [b.x, b.y], weight, cosine }
        })
    }

    /// What a ray brings to a point, W/(m² sr).
    fn radiance(&self, Faces { facets, patterns }: Faces, point: DVec3, ray: &Ray) -> DVec3 {
        let (face, b) = (ray.face as usize, ray.barycentric());
        let irradiance = self.irradiance[face];
        let irradiance = irradiance[0] * b.x + irradiance[1] * b.y + irradiance[2] * b.z;
        let [of_albedo, of_emission] = factors(patterns, face, b);
        let specular = |begin: usize| -> DVec3 {
            self.taps(&facets[face], b, point)
                .iter()
                .map(|&(bin, weight)| weight * self.specular[begin + bin])
                .sum()
        };
        of_emission * self.emission[face]
            + of_albedo * self.reflectance[face] * irradiance
            + self.begin[face].map_or(DVec3::ZERO, specular)
    }

    /// The bins of a face towards a point, from a place of it.
    fn taps(&self, facet: &Facet, b: DVec3, point: DVec3) -> Taps {
        let [x, y, z] = facet.corners;
        let towards = point - (x * b.x + y * b.y + z * b.z);
        self.bins.taps(facet.to_local(towards.normalize_or_zero()))
    }

    /// Derivatives of a loss by all that rays bring to a point, where `cotangent` is that by what the lobe reflects, W/(m² sr): adds those by
    /// the faces that they meet, and returns those by σ and p.
    pub fn pull_back(
        &self,
        faces: Faces,
        at: &Glossy,
        sample: &Sample,
        cotangent: DVec3,
        to: &mut BTreeMap<usize, OfFace>,
    ) -> (DVec3, f64) {
        let material = at.material;
        let n = material.specular_normalization();
        let sigma = DVec3::from(material.specular);
        let (mut by_sigma, mut by_power) = (DVec3::ZERO, 0.0);
        // σ N(p) ⟨h, n⟩^p, the rays and their density held fixed.
        let slope = material.specular_normalization_derivative() / n;
        for ray in &sample.rays {
            let weight = ray.weight(material.power, sample.power) / f64::from(sample.count);
            let brought = n * weight * cotangent * self.radiance(faces, at.point, ray);
            by_sigma += brought;
            by_power += sigma.dot(brought) * (slope + ray.cosine.max(1e-20).ln());
            let by_radiance = n * weight * sigma * cotangent;
            let (face, b) = (ray.face as usize, ray.barycentric());
            let [of_albedo, of_emission] = factors(faces.patterns, face, b);
            let of_face = to.entry(face).or_default();
            of_face.emission += of_emission * by_radiance;
            let irradiance = self.irradiance[face];
            let by_reflected = of_albedo * by_radiance;
            for (k, b) in b.to_array().into_iter().enumerate() {
                of_face.albedo += b * irradiance[k] / PI * by_reflected;
                of_face.irradiance[k] += b * self.reflectance[face] * by_reflected;
            }
            if self.begin[face].is_some() {
                of_face.specular.resize(self.bins.count(), DVec3::ZERO);
                for (bin, weight) in self.taps(&faces.facets[face], b, at.point) {
                    of_face.specular[bin] += weight * by_radiance;
                }
            }
        }
        (by_sigma, by_power)
    }
}

/// The rays of each point of a run, once they are known.
pub type Held = OnceLock<Vec<Sample>>;

/// The samples of all points of a picture, by its runs; clones share them.
#[derive(Clone, Debug, Default)]
pub struct Kept(Arc<Mutex<Option<OfPicture>>>);

type OfPicture = (Arc<Sights>, Arc<Vec<Held>>);

impl Kept {
    /// Room for those of the points of a picture, with what is known of them.
    pub fn of(&self, sights: &Arc<Sights>) -> Arc<Vec<Held>> {
        let mut kept = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let known = kept.take().filter(|(of, _)| Arc::ptr_eq(of, sights)).map(|(_, samples)| samples);
        let samples = known.unwrap_or_else(|| Arc::new(vec![Held::new(); sights.runs.len()]));
        *kept = Some((sights.clone(), samples.clone()));
        samples
    }
}

impl Ray {
    /// What it brings to a lobe of power p counts as much, over the number of rays.
    fn weight(&self, p: f64, q: f64) -> f64 {
        self.weight * self.cosine.powf(p - q)
    }

    fn barycentric(&self) -> DVec3 {
        let [x, y] = self.at;
        DVec3::new(x, y, 1.0 - x - y)
    }
}

impl OfFace {
    pub fn add(&mut self, other: Self) {
        self.emission += other.emission;
        self.albedo += other.albedo;
        self.irradiance.iter_mut().zip(other.irradiance).for_each(|(to, by)| *to += by);
        self.specular.resize(self.specular.len().max(other.specular.len()), DVec3::ZERO);
        self.specular.iter_mut().zip(other.specular).for_each(|(to, by)| *to += by);
    }
}

/// Factors of albedo and of emission at a place of a face; 1 where they do not vary.
fn factors(patterns: &Patterns, face: usize, b: DVec3) -> [DVec3; 2] {
    patterns.at(face, b).map_or([DVec3::ONE; 2], |factors| factors.value)
}

/// A point of the sequence in the unit square, digits shifted.
fn place(index: u32, shift: [u32; 2]) -> [f64; 2] {
    let [x, y] = sobol(index);
    [x ^ shift[0], y ^ shift[1]].map(|x| (f64::from(x) + 0.5) / 2f64.powi(32))
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::BinLayout;

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
            rays: Rays::among(corners, |_| true).into(),
            emission,
            reflectance: vec![DVec3::ZERO; count],
            irradiance: vec![[DVec3::ZERO; 3]; count],
            bins: Bins::new(BinLayout::Concentric { n: 2 }),
            specular: Vec::new(),
            begin: vec![None; count],
            counts: AS_NEEDED,
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
                        let [x, y] = place(i, shift);
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
                let faces = Faces { facets: &facets, patterns: &patterns };
                let (Estimate { mean, error }, _) = surroundings.reflected(faces, &at);
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
