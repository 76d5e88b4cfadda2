//! Irradiance and pictures by path tracing (Kajiya 1986) with next-event estimation, in f64 on the CPU.
//!
//! Direct light is estimated from points on lights, sampled by area (Shirley, Wang and Zimmerman 1996), and along the path,
//! combined by the balance heuristic (Veach and Guibas 1995): alone, the first has no finite variance where lights touch
//! receivers, and the second a large one where lights are small. Paths go on in proportion to the cosine and to the specular
//! lobe, so that mirrored lamps have little noise, too. Of each sun a direction is sampled, and none is met along the path.
//!
//! Textures count at each point of a path. Shares only material formulas, textures and the camera with the radiosity code, and
//! tests visibility: the ground truth for scenes without a closed form or other reference data.

mod lobe;
mod numbers;
mod picture;

use antirad_base::parallel;
use antirad_scene::{Material, Rays, Scene, Sun, bounds};
use glam::DVec3;
use lobe::Reflection;
use numbers::{Numbers, estimate};
pub use picture::{TracedPicture, TracedPixel};
use std::borrow::Cow;
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Reflections after which Russian roulette may end a path, with the throughput as the probability of survival.
const ROULETTE_AFTER: u32 = 3;
/// Largest path length: at albedo 0.99, paths carry 4e-5 of the light by then.
const LONGEST: u32 = 1000;

/// A mean and its standard error, RGB: irradiance, W/m², or radiance, W/(m² sr).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct MonteCarloEstimate {
    /// Mean over all paths.
    pub mean: DVec3,
    /// Standard error of the mean, from independent repetitions: 16 or more, or as many as there are paths.
    pub error: DVec3,
}

/// A Monte Carlo renderer.
pub struct PathTracer<'a> {
    scene: &'a Scene,
    rays: Arc<Rays>,
    normals: Vec<DVec3>,
    areas: Vec<f64>,
    /// Emitting triangles, with the cumulative probability of choosing each.
    lights: Vec<(usize, f64)>,
    /// Probability density of choosing a point on each triangle as that of a light, 1/m².
    density: Vec<f64>,
    /// Triangles behind suns, ascending.
    behind_suns: Vec<u32>,
    /// Distance beyond which nothing stands before suns, m.
    far: f64,
}

/// A point on a triangle, uniform for uniform u, v.
fn on_triangle([a, b, c]: [DVec3; 3], [u, v]: [f64; 2]) -> DVec3 {
    let root = u.sqrt();
    a * (1.0 - root) + b * (root * (1.0 - v)) + c * (root * v)
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
        let (low, high) = bounds(scene.vertices.iter().copied());
        Self {
            scene,
            rays: scene.rays(),
            normals: vectors.iter().map(|v| v.normalize_or_zero()).collect(),
            areas,
            lights,
            density,
            behind_suns: scene.behind_suns(),
            far: 2.0 * (high - low).length(),
        }
    }

    /// The mean irradiance of each triangle, W/m², from at least `samples` paths that start at stratified points on it.
    pub fn irradiance(&self, samples: u32) -> Vec<MonteCarloEstimate> {
        parallel::map(0..self.areas.len(), |j| self.irradiance_of(j, samples))
    }

    /// The mean irradiance of one triangle, W/m², from at least `samples` paths that start at stratified
    /// points on it.
    pub fn irradiance_of(&self, triangle: usize, samples: u32) -> MonteCarloEstimate {
        if self.areas[triangle] <= 0.0 || samples == 0 {
            return MonteCarloEstimate::default();
        }
        // A random stream per triangle, so that results do not depend on the order of work.
        self.irradiance_on(triangle, self.normals[triangle], samples)
    }

    /// The irradiance of the back of one triangle, which is black.
    #[doc(hidden)]
    pub fn irradiance_of_back(&self, triangle: usize, samples: u32) -> MonteCarloEstimate {
        if self.areas[triangle] <= 0.0 || samples == 0 {
            return MonteCarloEstimate::default();
        }
        self.irradiance_on(triangle, -self.normals[triangle], samples)
    }

    /// The irradiance on the side of a triangle to which `normal` points.
    fn irradiance_on(&self, triangle: usize, normal: DVec3, samples: u32) -> MonteCarloEstimate {
        estimate(samples, [0, triangle as u64], |numbers| {
            let point = on_triangle(self.scene.corners(triangle), numbers.pair());
            PI * self.reflected(triangle, point, Reflection::white(normal), numbers)
        })
    }

    /// The material at a point of a triangle, with its texture.
    fn material(&self, triangle: usize, point: DVec3) -> Cow<'a, Material> {
        let material = self.scene.material(triangle);
        if !self.scene.patterns.vary(triangle) {
            return Cow::Borrowed(material);
        }
        let normal = self.normals[triangle];
        let [a, b, c] = self.scene.corners(triangle).map(|corner| corner - point);
        let areas = DVec3::new(b.cross(c).dot(normal), c.cross(a).dot(normal), a.cross(b).dot(normal));
        let factors = self.scene.patterns.at(triangle, areas / areas.element_sum());
        let [albedo, emission] = factors.map_or([DVec3::ONE; 2], |factors| factors.value);
        Cow::Owned(Material {
            albedo: (albedo * DVec3::from(material.albedo)).to_array(),
            emission: (emission * DVec3::from(material.emission)).to_array(),
            ..material.clone()
        })
    }

    /// One sample of the light that a point reflects: direct light there and at every further vertex of a path.
    fn reflected(
        &self,
        triangle: usize,
        point: DVec3,
        mut reflection: Reflection,
        numbers: &mut Numbers,
    ) -> DVec3 {
        let (mut from, mut at) = (triangle, point);
        let (mut light, mut throughput) = (DVec3::ZERO, DVec3::ONE);
        for depth in 0..LONGEST {
            light += throughput * self.direct(from, at, &reflection, numbers);
            for sun in &self.scene.suns {
                light += throughput * self.sunlight(sun, from, at, &reflection, numbers);
            }
            let Some((direction, density)) = reflection.sample(numbers) else { break };
            throughput *= reflection.brdf(direction) * direction.dot(reflection.normal()) / density;
            let chance = match throughput.max_element() {
                0.0 => break,
                _ if depth < ROULETTE_AFTER => 1.0,
                largest => largest.min(0.99),
            };
            if numbers.next() >= chance {
                break;
            }
            throughput /= chance;
            let Some((hit, distance)) = self.rays.nearest(at, direction, Some(from)) else { break };
            let normal = self.normals[hit];
            let facing = -direction.dot(normal);
            if facing <= 0.0 {
                // Backs are black.
                break;
            }
            at += distance * direction;
            from = hit;
            let material = &self.material(hit, at);
            // Balance heuristic: density of this direction per area at the hit, over the sum with that of sampling lights.
            let along = density * facing / (distance * distance);
            light += along / (along + self.density[hit]) * throughput * DVec3::from(material.emission);
            reflection = Reflection::new(material, normal, -direction);
        }
        light
    }

    /// Reflected light from one random point on one random light.
    fn direct(&self, triangle: usize, point: DVec3, reflection: &Reflection, numbers: &mut Numbers) -> DVec3 {
        let [choice, v] = numbers.pair();
        let k =
            self.lights.partition_point(|light| light.1 <= choice).min(self.lights.len().saturating_sub(1));
        let Some(&(light, end)) = self.lights.get(k) else { return DVec3::ZERO };
        // What is left of the number that chose the light is uniform, too.
        let start = if k > 0 { self.lights[k - 1].1 } else { 0.0 };
        let u = ((choice - start) / (end - start)).min(1.0);
        let target = on_triangle(self.scene.corners(light), [u, v]);
        let way = target - point;
        let r2 = way.length_squared();
        let (here, there) = (way.dot(reflection.normal()), -way.dot(self.normals[light]));
        if light == triangle || here <= 0.0 || there <= 0.0 {
            return DVec3::ZERO;
        }
        let direction = way / r2.sqrt();
        let reflected = reflection.brdf(direction);
        if reflected == DVec3::ZERO || self.rays.blocked(point, target, |i| i == triangle || i == light) {
            return DVec3::ZERO;
        }
        let geometry = here * there / (r2 * r2);
        let along = reflection.density(direction) * there / (r2 * r2.sqrt());
        DVec3::from(self.material(light, target).emission)
            * (geometry / (self.density[light] + along))
            * reflected
    }
}

impl PathTracer<'_> {
    /// Reflected light from a random direction of a sun, which no ray meets by chance.
    fn sunlight(
        &self,
        sun: &Sun,
        triangle: usize,
        point: DVec3,
        reflection: &Reflection,
        numbers: &mut Numbers,
    ) -> DVec3 {
        // Uniform in the projection along the axis, where the sun is a disc.
        let [u, v] = numbers.pair();
        let limb = sun.angular_radius().sin();
        let sine = limb * u.sqrt();
        let axis = -sun.travels();
        let (s, t) = axis.any_orthonormal_pair();
        let (sin, cos) = (TAU * v).sin_cos();
        let axial = (1.0 - sine * sine).sqrt();
        let direction = axis * axial + (s * cos + t * sin) * sine;
        let here = direction.dot(reflection.normal());
        if here <= 0.0 {
            return DVec3::ZERO;
        }
        let reflected = reflection.brdf(direction);
        let passes = |i: usize| i == triangle || self.behind_suns.binary_search(&(i as u32)).is_ok();
        if reflected == DVec3::ZERO || self.rays.blocked(point, point + self.far * direction, passes) {
            return DVec3::ZERO;
        }
        // Radiance is irradiance over π sin² of the radius, and so is the density, but for the cosine.
        DVec3::from(sun.irradiance) * (here / axial) * reflected
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use antirad_scene::Triangle;

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

    /// B = π L / (1 - ρ) holds everywhere in a closed room of uniform emission and albedo.
    #[test]
    fn a_furnace() {
        let (vertices, faces) = antirad_scene::Shape::Room { cells: 1 }.mesh();
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

    /// Turned away, the receiver has on its back what it had on its front.
    #[test]
    fn backs_receive_what_fronts_would() {
        let scene = squares(0.6);
        let mut turned = scene.clone();
        turned.triangles.iter_mut().take(2).for_each(|t| t.vertices.swap(1, 2));
        let tracer = PathTracer::new(&turned);
        for i in 0..2 {
            let (front, back) =
                (PathTracer::new(&scene).irradiance_of(i, 4096), tracer.irradiance_of_back(i, 4096));
            let bound = 4.5 * (front.error + back.error);
            assert!((front.mean - back.mean).abs().cmple(bound).all(), "{front:?} {back:?}");
            assert_eq!(tracer.irradiance_of(i, 16), MonteCarloEstimate::default());
        }
    }

    #[test]
    fn darkness_is_dark() {
        let mut scene = squares(0.0);
        scene.materials[1].emission = [0.0; 3];
        assert!(PathTracer::new(&scene).irradiance(4).iter().all(|e| *e == MonteCarloEstimate::default()));
    }
}
