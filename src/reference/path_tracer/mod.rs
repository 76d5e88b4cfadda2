//! Irradiance by path tracing (Kajiya 1986) with next-event estimation, in f64 on the CPU.
//!
//! Direct light is estimated from points on lights, sampled by area (Shirley, Wang and Zimmerman 1996), and along the path,
//! combined by the balance heuristic (Veach and Guibas 1995): alone, the first has no finite variance where lights touch
//! receivers, and the second a large one where lights are small.
//!
//! Shares only material formulas with the radiosity code, and tests visibility: the ground truth for scenes without a closed
//! form or other reference data.

mod rays;

use super::Random;
use crate::scene::{Material, Scene};
use glam::DVec3;
use rayon::prelude::*;
use rays::Rays;
use std::f64::consts::{PI, TAU};

/// Path length from which Russian roulette may end a path, with the throughput as the probability of survival.
const ROULETTE_AFTER: u32 = 3;
/// Largest path length: at albedo 0.99, paths carry 4e-5 of the light by then.
const LONGEST: u32 = 1000;

/// A mean and its standard error, RGB, W/m².
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MonteCarloEstimate {
    /// Mean over all paths.
    pub mean: DVec3,
    /// Standard error of the mean.
    pub error: DVec3,
}

/// A Monte Carlo renderer of irradiance.
pub struct PathTracer<'a> {
    scene: &'a Scene,
    rays: Rays,
    normals: Vec<DVec3>,
    areas: Vec<f64>,
    /// Emitting triangles, with the cumulative probability of choosing each.
    lights: Vec<(usize, f64)>,
    /// Probability density of choosing a point on each triangle as that of a light, 1/m².
    density: Vec<f64>,
}

/// A point on a triangle, uniform for uniform u, v.
fn on_triangle([a, b, c]: [DVec3; 3], u: f64, v: f64) -> DVec3 {
    let root = u.sqrt();
    a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v)
}

/// A direction above the plane of `normal` with density cosθ/π.
fn cosine_direction(normal: DVec3, random: &mut Random) -> DVec3 {
    let (u, azimuth) = (random.next(), TAU * random.next());
    let x = normal.any_orthonormal_vector();
    let y = normal.cross(x);
    u.sqrt() * (azimuth.cos() * x + azimuth.sin() * y) + (1.0 - u).sqrt() * normal
}

/// The BRDF for light incident from `incident` and reflected towards `outgoing`, 1/sr.
fn brdf(material: &Material, normal: DVec3, incident: DVec3, outgoing: DVec3) -> DVec3 {
    let diffuse = DVec3::from(material.diffuse_albedo()) / PI;
    if !material.is_glossy() {
        return diffuse;
    }
    let cosine = (incident + outgoing).normalize_or_zero().dot(normal).max(0.0);
    diffuse + DVec3::from(material.specular) * material.specular_normalization() * cosine.powf(material.power)
}

impl<'a> PathTracer<'a> {
    /// Builds the bounding volume hierarchy and the light distribution.
    pub fn new(scene: &'a Scene) -> Self {
        let vectors: Vec<DVec3> = (0..scene.triangles.len()).map(|i| scene.area_vector(i)).collect();
        let areas: Vec<f64> = vectors.iter().map(|v| v.length()).collect();
        let power = |i: usize| areas[i] * scene.material(i).emission.iter().sum::<f64>();
        let total: f64 = (0..areas.len()).map(power).sum();
        let mut sum = 0.0;
        let mut lights = Vec::new();
        let mut density = vec![0.0; areas.len()];
        for i in (0..areas.len()).filter(|&i| power(i) > 0.0) {
            sum += power(i) / total;
            lights.push((i, sum));
            density[i] = power(i) / total / areas[i];
        }
        Self {
            scene,
            rays: Rays::new(scene),
            normals: vectors.iter().map(|v| v.normalize_or_zero()).collect(),
            areas,
            lights,
            density,
        }
    }

    /// The mean irradiance of each triangle, W/m², from `samples` paths that start at stratified points on it.
    pub fn irradiance(&self, samples: u32) -> Vec<MonteCarloEstimate> {
        (0..self.areas.len()).into_par_iter().map(|j| self.irradiance_of(j, samples)).collect()
    }

    /// The same for one triangle.
    pub fn irradiance_of(&self, triangle: usize, samples: u32) -> MonteCarloEstimate {
        if self.areas[triangle] <= 0.0 || self.lights.is_empty() || samples == 0 {
            return MonteCarloEstimate::default();
        }
        // A random stream per triangle, so that results do not depend on the order of work.
        let mut random = Random::new((triangle as u64 + 1).wrapping_mul(0x2545_f491_4f6c_dd1d));
        let (mut sum, mut squares) = (DVec3::ZERO, DVec3::ZERO);
        // Stratified in √n x √n cells; the remaining points are uniform.
        let side = f64::from(samples).sqrt().floor().max(1.0) as u32;
        for k in 0..samples {
            let (mut u, mut v) = (random.next(), random.next());
            if k < side * side {
                u = (f64::from(k % side) + u) / f64::from(side);
                v = (f64::from(k / side) + v) / f64::from(side);
            }
            let point = on_triangle(self.scene.corners(triangle), u, v);
            let value = self.path(triangle, point, &mut random);
            sum += value;
            squares += value * value;
        }
        let n = f64::from(samples);
        let mean = sum / n;
        let variance = (squares / n - mean * mean).max(DVec3::ZERO) / (n - 1.0).max(1.0);
        MonteCarloEstimate { mean, error: variance.map(f64::sqrt) }
    }

    /// One sample of the irradiance at a point: direct light there and at every vertex of a path.
    fn path(&self, triangle: usize, point: DVec3, random: &mut Random) -> DVec3 {
        let mut irradiance = self.direct(triangle, point, &|_| DVec3::ONE, random);
        // Directions with density cosθ/π: irradiance is π times the mean radiance.
        let mut throughput = DVec3::splat(PI);
        let (mut from, mut at) = (triangle, point);
        let mut direction = cosine_direction(self.normals[from], random);
        for depth in 1..LONGEST {
            let Some((hit, distance)) = self.rays.nearest(at, direction, from) else { break };
            let normal = self.normals[hit];
            if direction.dot(normal) >= 0.0 {
                // Backs are black.
                break;
            }
            let material = self.scene.material(hit);
            // Balance heuristic: density of this direction per area at the hit, over the sum with that of sampling lights.
            let along =
                self.normals[from].dot(direction) / PI * -direction.dot(normal) / (distance * distance);
            let weight = along / (along + self.density[hit]);
            irradiance += weight * throughput * DVec3::from(material.emission);
            at += distance * direction;
            from = hit;
            let outgoing = -direction;
            let reflected = |incident: DVec3| brdf(material, normal, incident, outgoing);
            irradiance += throughput * self.direct(hit, at, &reflected, random);
            direction = cosine_direction(normal, random);
            throughput *= PI * reflected(direction);
            if depth >= ROULETTE_AFTER {
                let chance = (throughput.max_element() / PI).clamp(0.0, 0.99);
                if random.next() >= chance {
                    break;
                }
                throughput /= chance;
            }
        }
        irradiance
    }

    /// Light from one random point on one random light, times `reflected` of the direction to it.
    fn direct(
        &self,
        triangle: usize,
        point: DVec3,
        reflected: &dyn Fn(DVec3) -> DVec3,
        random: &mut Random,
    ) -> DVec3 {
        let choice = random.next();
        let k = self.lights.partition_point(|light| light.1 <= choice).min(self.lights.len() - 1);
        let light = self.lights[k].0;
        let target = on_triangle(self.scene.corners(light), random.next(), random.next());
        let way = target - point;
        let r2 = way.length_squared();
        let (here, there) = (way.dot(self.normals[triangle]), -way.dot(self.normals[light]));
        if light == triangle
            || here <= 0.0
            || there <= 0.0
            || self.rays.blocked(point, target, [triangle, light])
        {
            return DVec3::ZERO;
        }
        let geometry = here * there / (r2 * r2);
        let density = self.density[light] + geometry / PI;
        DVec3::from(self.scene.material(light).emission) * (geometry / density) * reflected(way / r2.sqrt())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Triangle;

    fn quad(vertices: &mut Vec<DVec3>, triangles: &mut Vec<Triangle>, corners: [DVec3; 4], material: u32) {
        let first = vertices.len() as u32;
        vertices.extend(corners);
        triangles
            .extend([[0, 1, 2], [0, 2, 3]].map(|f| Triangle { vertices: f.map(|v| v + first), material }));
    }

    /// Two parallel squares of side 1 at distance 1, and a square blocker of side `blocker` between them, if above 0.
    fn squares(blocker: f64) -> Scene {
        let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
        let square = |z: f64, s: f64, up: bool| {
            let c = [[-s, -s], [s, -s], [s, s], [-s, s]].map(|[x, y]| DVec3::new(x / 2.0, y / 2.0, z));
            if up { c } else { [c[0], c[3], c[2], c[1]] }
        };
        quad(&mut vertices, &mut triangles, square(0.0, 1.0, true), 0);
        quad(&mut vertices, &mut triangles, square(1.0, 1.0, false), 1);
        if blocker > 0.0 {
            quad(&mut vertices, &mut triangles, square(0.5, blocker, true), 0);
        }
        let materials =
            vec![Material::named("black"), Material { emission: [1.0, 2.0, 0.0], ..Material::named("lamp") }];
        Scene::new("squares", vertices, triangles, materials).expect("a scene")
    }

    fn on_floor(scene: &Scene) -> (DVec3, DVec3) {
        let found = PathTracer::new(scene).irradiance(4096);
        (0.5 * (found[0].mean + found[1].mean), 0.5 * (found[0].error + found[1].error))
    }

    /// The form factor of equal parallel squares whose distance is their side is 0.199824895698.
    #[test]
    fn parallel_squares() {
        let (mean, error) = on_floor(&squares(0.0));
        let truth = 0.199_824_895_698 * PI * DVec3::new(1.0, 2.0, 0.0);
        assert!((mean - truth).abs().cmple(4.0 * error + 1e-12).all(), "{mean} ± {error}, not {truth}");
        assert!(error.x <= 0.01 * truth.x && error.x > 0.0);
    }

    /// A smaller blocker lets light pass only around it; one slightly larger than the squares, none at all.
    #[test]
    fn a_blocker_blocks() {
        let (some, _) = on_floor(&squares(0.6));
        assert!(some.x > 0.0 && some.x < 0.5 * 0.2 * PI, "{some}");
        assert_eq!(on_floor(&squares(1.001)).0, DVec3::ZERO);
    }

    /// In a closed room of uniform emission and albedo, B = π L / (1 - ρ) everywhere.
    #[test]
    fn a_furnace() {
        let (vertices, faces) = crate::scene::Shape::Room { cells: 1 }.mesh();
        let triangles = faces.into_iter().map(|vertices| Triangle { vertices, material: 0 }).collect();
        let wall = Material { albedo: [0.5, 0.8, 0.0], emission: [1.0; 3], ..Material::named("wall") };
        let scene = Scene::new("furnace", vertices, triangles, vec![wall]).expect("a scene");
        for (i, found) in PathTracer::new(&scene).irradiance(4096).into_iter().enumerate() {
            let truth = DVec3::new(2.0, 5.0, 1.0) * PI;
            let bound = 4.5 * found.error;
            assert!((found.mean - truth).abs().cmple(bound).all(), "{i}: {found:?}, not {truth}");
            assert!(found.error.cmple(0.02 * truth).all());
        }
    }

    #[test]
    fn darkness_is_dark() {
        let mut scene = squares(0.0);
        scene.materials[1].emission = [0.0; 3];
        assert!(PathTracer::new(&scene).irradiance(4).iter().all(|e| *e == MonteCarloEstimate::default()));
    }
}
