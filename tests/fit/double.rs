//! A renderer without light transport: one pixel per triangle, from a formula with all parameters.

use antirad::fit::{CostEstimate, RenderError, Renderer, Target};
use antirad::plan::GradientRequest;
use antirad::render::SceneGradient;
use antirad::scene::{Camera, Scene};
use glam::DVec3;
use std::f64::consts::PI;

/// A factor of a triangle's incident light that depends on its position.
const SLOPE: DVec3 = DVec3::new(0.1, -0.2, 0.15);

#[derive(Default)]
pub struct Double {
    pub pictures: u64,
    /// Interrupts at this call of `pictures`, counted from 1.
    pub interrupt_at: Option<u64>,
    /// Fails there instead.
    pub fails: bool,
    /// Scenes with albedos above this have no solution.
    pub limit: Option<f64>,
    /// Whether derivatives are unavailable.
    pub without_derivatives: bool,
    pub views: usize,
    pub latest: Option<Scene>,
    /// Share of the latest pictures that the next ones keep, like solves that start from earlier ones.
    pub memory: f64,
    pub kept: DVec3,
}

impl Double {
    pub fn new(views: usize) -> Self {
        Self { views, ..Self::default() }
    }

    pub fn camera(scene: &Scene, name: &str) -> Camera {
        let size = scene.triangles.len() as u32;
        Camera { name: name.to_owned(), width: size, height: 1, ..Camera::framing(&scene.vertices) }
    }

    /// Targets rendered from a scene.
    pub fn targets(scene: &Scene, views: usize) -> Vec<Target> {
        let pictures = Self::new(views).pictures(scene).expect("pictures");
        let target = |(k, pixels): (usize, Vec<DVec3>)| {
            Target::new(Self::camera(scene, &format!("view {k}")), pixels, None, 1.0 + k as f64)
                .expect("a target")
        };
        pictures.into_iter().enumerate().map(target).collect()
    }
}

/// Transport from s to t.
fn share(t: usize, s: usize) -> f64 {
    0.3 / (1.0 + (t as f64 - s as f64).powi(2) / 50.0)
}

fn place(scene: &Scene, t: usize) -> f64 {
    let [a, b, c] = scene.corners(t);
    1.0 + SLOPE.dot((a + b + c) / 3.0)
}

fn emitted(scene: &Scene, t: usize) -> DVec3 {
    (0..scene.triangles.len()).map(|s| share(t, s) * DVec3::from(scene.material(s).emission)).sum()
}

/// Views differ in the weight of emitted light.
fn direct(view: usize) -> f64 {
    1.0 / (1.0 + view as f64)
}

impl Renderer for Double {
    fn estimate(&mut self, planning: &Scene) -> Result<CostEstimate, RenderError> {
        let device_bytes = planning.triangles.len() as u64;
        Ok(CostEstimate { device_bytes, device_budget: 1 << 20, seconds: 0.1 })
    }

    fn pictures(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        self.pictures += 1;
        if Some(self.pictures) == self.interrupt_at {
            return Err(match self.fails {
                true => RenderError::Failed("a device is lost".into()),
                false => RenderError::Interrupted,
            });
        }
        let brightest = scene.materials.iter().flat_map(|m| m.albedo).fold(0.0, f64::max);
        if self.limit.is_some_and(|limit| brightest > limit) {
            return Err(RenderError::NoAnswer(String::from("too bright")));
        }
        self.latest = Some(scene.clone());
        let incident: Vec<DVec3> =
            (0..scene.triangles.len()).map(|t| place(scene, t) * emitted(scene, t)).collect();
        let kept = self.memory * self.kept;
        let pixel = |view: usize, t: usize| {
            let m = scene.material(t);
            let reflected = DVec3::from(m.diffuse_albedo()) / PI
                + 0.2 * m.specular_normalization() * DVec3::from(m.specular);
            kept + direct(view) * DVec3::from(m.emission) + reflected * incident[t]
        };
        let pictures: Vec<Vec<DVec3>> =
            (0..self.views).map(|v| (0..scene.triangles.len()).map(|t| pixel(v, t)).collect()).collect();
        self.kept = pictures.iter().flatten().sum();
        Ok(pictures)
    }

    fn pictures_near(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        let (latest, kept) = (self.latest.clone(), self.kept);
        let pictures = self.pictures(scene);
        (self.latest, self.kept) = (latest, kept);
        pictures
    }

    fn pictures_of_difference(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        self.kept = DVec3::ZERO;
        let pictures = self.pictures(scene);
        self.kept = DVec3::ZERO;
        pictures
    }

    fn forget(&mut self) {
        self.kept = DVec3::ZERO;
    }

    fn pull_back(
        &mut self,
        by_pixels: &[Vec<DVec3>],
        request: GradientRequest,
    ) -> Result<Option<SceneGradient>, RenderError> {
        if self.without_derivatives {
            return Ok(None);
        }
        let scene = self.latest.as_ref().expect("pictures come first");
        let n = scene.triangles.len();
        let mut gradient = SceneGradient::zeros(scene, request);
        let mut by_emission = vec![DVec3::ZERO; n];
        for t in 0..n {
            let m = scene.material(t);
            let by_pixel: DVec3 = by_pixels.iter().map(|view| view[t]).sum();
            let incident = place(scene, t) * emitted(scene, t);
            let (rho, sigma) = (DVec3::from(m.albedo), DVec3::from(m.specular));
            let lobe = 0.2 * m.specular_normalization();
            let by_reflected = by_pixel * incident;
            if let Some(by) = &mut gradient.albedo {
                by[t] += m.diffuse / PI * by_reflected;
            }
            if let Some(by) = &mut gradient.diffuse {
                by[t] += rho.dot(by_reflected) / PI;
            }
            if let Some(by) = &mut gradient.specular {
                by[t] += lobe * by_reflected;
            }
            if let Some(by) = &mut gradient.power {
                by[t] += 0.2 * m.specular_normalization_derivative() * sigma.dot(by_reflected);
            }
            let by_incident = by_pixel * (m.diffuse * rho / PI + lobe * sigma);
            for (s, by) in by_emission.iter_mut().enumerate() {
                *by += place(scene, t) * share(t, s) * by_incident;
            }
            for (view, pixels) in by_pixels.iter().enumerate() {
                by_emission[t] += direct(view) * pixels[t];
            }
            if let Some(by) = &mut gradient.positions {
                let by_place = by_incident.dot(emitted(scene, t));
                for v in scene.triangles[t].vertices {
                    by[v as usize] += by_place / 3.0 * SLOPE;
                }
            }
        }
        if let Some(by) = &mut gradient.emission {
            by.iter_mut().zip(by_emission).for_each(|(by, e)| *by += e);
        }
        Ok(Some(gradient))
    }

    fn passes(&self) -> u64 {
        10 * self.pictures
    }
}
