//! The renderer that solves on a device.

use super::gradient::SceneGradient;
use super::renderer::{Estimate, RenderError, Renderer};
use crate::gpu::Device;
use crate::image::{ImageError, PictureOptions, Rasterizer};
use crate::plan::{Limits, Plan, Wanted};
use crate::scene::{Camera, Scene};
use crate::solve::SolveError;
use crate::transport::TransportError;
use crate::{Cotangent, Engine, EngineError, Gradients, Solution, SolveParams};
use glam::DVec3;
use std::ops::ControlFlow;
use std::sync::Arc;

/// Asked often during a solve: whether to go on.
pub type Watch = Arc<dyn Fn() -> ControlFlow<()> + Send + Sync>;

/// Work of an evaluation with derivatives by materials, in solves: the adjoint solve is like the first one.
const SOLVES: f64 = 2.1;
/// Passes of [`SOLVES`] that derivatives by positions add, each of them several times as costly.
const SOLVES_OF_GEOMETRY: f64 = 1.0;

/// Solves scenes on a device, and takes their pictures.
pub struct EngineRenderer {
    device: Device,
    rasterizer: Rasterizer,
    cameras: Vec<Camera>,
    supersample: u32,
    wanted: Wanted,
    watch: Watch,
    passes: u64,
    /// Of the latest pictures. It holds device memory until the next ones are made.
    latest: Option<Latest>,
}

struct Latest {
    engine: Engine,
    solution: Solution,
    params: SolveParams,
    vertices: Vec<DVec3>,
    seen: Vec<Seen>,
}

impl EngineRenderer {
    /// For pictures by some cameras, of `supersample` x `supersample` samples a pixel, and derivatives of some kinds.
    pub fn new(
        device: &Device,
        cameras: Vec<Camera>,
        supersample: u32,
        wanted: Wanted,
        watch: Watch,
    ) -> Result<Self, ImageError> {
        let (device, rasterizer) = (device.clone(), Rasterizer::new(device)?);
        Ok(Self { device, rasterizer, cameras, supersample, wanted, watch, passes: 0, latest: None })
    }

    fn plan(&self, scene: &Scene) -> Result<Plan, RenderError> {
        let options = PictureOptions { supersample: self.supersample, smooth: false };
        let mut pictures = 0;
        for camera in &self.cameras {
            let bytes = Rasterizer::bytes(scene.triangles.len(), camera, &options).map_err(failed)?;
            pictures = pictures.max(bytes);
        }
        // Derivatives by positions are not taken from here, see `pull_back`.
        let gradients = Wanted { positions: false, ..self.wanted };
        let limits = Limits { pictures, gradients, ..Limits::of(&self.device) };
        Plan::new(scene, &limits, &scene.accuracy).map_err(failed)
    }

    /// What the cameras see: anew only if something has moved.
    fn look(
        &self,
        scene: &Scene,
        earlier: Option<(Vec<DVec3>, Vec<Seen>)>,
    ) -> Result<Vec<Seen>, RenderError> {
        match earlier {
            Some((vertices, seen)) if vertices == scene.vertices => Ok(seen),
            _ => self
                .cameras
                .iter()
                .map(|camera| {
                    let samples = self.rasterizer.visible_samples(scene, camera, self.supersample);
                    Ok(Seen::new(scene, camera, self.supersample, samples.map_err(failed)?))
                })
                .collect(),
        }
    }

    fn solve(&mut self, scene: &Scene) -> Result<(Engine, Solution, SolveParams), RenderError> {
        let plan = self.plan(scene)?;
        let mut engine = Engine::new(&self.device, scene, plan).map_err(failed)?;
        let watch = self.watch.clone();
        engine.set_watcher(Some(Box::new(move |_, _| watch())));
        let params = SolveParams::from(&scene.accuracy);
        let (watch, passes) = (self.watch.clone(), &mut self.passes);
        let solved = engine.solve_with(&params, &mut |_, _| {
            *passes += 1;
            watch()
        });
        Ok((engine, solved.map_err(sort_out)?, params))
    }
}

impl Renderer for EngineRenderer {
    fn estimate(&mut self, planning: &Scene) -> Result<Estimate, RenderError> {
        let plan = self.plan(planning)?;
        let solves = SOLVES + if self.wanted.positions { SOLVES_OF_GEOMETRY } else { 0.0 };
        Ok(Estimate {
            device_bytes: plan.memory().total(),
            device_budget: plan.limits.memory_budget,
            seconds: solves * plan.report().estimated_seconds,
        })
    }

    fn pictures(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        if (self.watch)().is_break() {
            return Err(RenderError::Interrupted);
        }
        // This also frees the device memory of the last engine, before the next one takes its own.
        let earlier = self.latest.take().map(|latest| (latest.vertices, latest.seen));
        let seen = self.look(scene, earlier)?;
        let (mut engine, solution, params) = self.solve(scene)?;
        let mut pictures = Vec::with_capacity(seen.len());
        for (camera, seen) in self.cameras.iter().zip(&seen) {
            let colours = engine.face_colours(&solution, camera.position).map_err(failed)?;
            pictures.push(seen.pixels(&colours));
        }
        self.latest = Some(Latest { engine, solution, params, vertices: scene.vertices.clone(), seen });
        Ok(pictures)
    }

    fn pull_back(
        &mut self,
        by_pixels: &[Vec<DVec3>],
        wanted: Wanted,
    ) -> Result<Option<SceneGradient>, RenderError> {
        let Some(latest) = &mut self.latest else { return Ok(None) };
        // Silhouettes that move have no derivative here.
        if wanted.positions {
            return Ok(None);
        }
        let triangles = latest.engine.plan().facets.len();
        let colours = self
            .cameras
            .iter()
            .zip(&latest.seen)
            .zip(by_pixels)
            .map(|((camera, seen), by_pixels)| (camera.position, seen.colour_gradient(by_pixels, triangles)))
            .collect();
        let cotangent = Cotangent { colours, ..Cotangent::default() };
        let (watch, passes) = (self.watch.clone(), &mut self.passes);
        let gradients =
            latest.engine.backward_with(&latest.solution, &cotangent, wanted, &latest.params, &mut |_, _| {
                *passes += 1;
                watch()
            });
        gradients.map(|gradients| Some(gradients.into())).map_err(sort_out)
    }

    fn passes(&self) -> u64 {
        self.passes
    }
}

fn failed(error: impl std::error::Error + Send + Sync + 'static) -> RenderError {
    RenderError::Failed(Box::new(error))
}

/// What a solver says: that it was interrupted, that this scene has no answer, or that nothing works any more.
fn sort_out(error: EngineError) -> RenderError {
    match error {
        EngineError::Solve(
            SolveError::Interrupted { .. } | SolveError::Operator(TransportError::Interrupted),
        )
        | EngineError::Transport(TransportError::Interrupted) => RenderError::Interrupted,
        EngineError::Solve(SolveError::Diverged { .. } | SolveError::NoConvergence { .. }) => {
            RenderError::NoAnswer(error.to_string())
        }
        other => failed(other),
    }
}

impl From<Gradients> for SceneGradient {
    fn from(gradients: Gradients) -> Self {
        Self {
            emission: gradients.emission,
            diffuse: gradients.diffuse,
            albedo: gradients.albedo,
            specular: gradients.specular,
            power: gradients.power,
            positions: gradients.vertices,
        }
    }
}

/// The faces behind the samples of a camera's picture, one colour a face; backs are black.
struct Seen {
    width: usize,
    supersample: usize,
    /// Row by row of samples; `NOTHING` where there is no front.
    faces: Vec<u32>,
}

const NOTHING: u32 = u32::MAX;

impl Seen {
    fn new(scene: &Scene, camera: &Camera, supersample: u32, mut faces: Vec<u32>) -> Self {
        for face in faces.iter_mut().filter(|face| **face != NOTHING) {
            let [a, b, c] = scene.corners(*face as usize);
            if (b - a).cross(c - a).dot(camera.position - a) <= 0.0 {
                *face = NOTHING;
            }
        }
        Self { width: camera.width as usize, supersample: supersample as usize, faces }
    }

    /// Pairs of pixel and face, sample by sample.
    fn samples(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let row = self.width * self.supersample;
        self.faces.iter().enumerate().filter(|(_, face)| **face != NOTHING).map(move |(at, &face)| {
            let pixel = (at / row / self.supersample) * self.width + at % row / self.supersample;
            (pixel, face as usize)
        })
    }

    fn share(&self) -> f64 {
        1.0 / (self.supersample * self.supersample) as f64
    }

    /// The picture of some colours, per face.
    fn pixels(&self, colours: &[[f64; 3]]) -> Vec<DVec3> {
        let mut pixels = vec![DVec3::ZERO; self.faces.len() / (self.supersample * self.supersample)];
        for (pixel, face) in self.samples() {
            pixels[pixel] += DVec3::from(colours[face]);
        }
        pixels.iter_mut().for_each(|pixel| *pixel *= self.share());
        pixels
    }

    /// The transpose of [`Self::pixels`].
    fn colour_gradient(&self, by_pixels: &[DVec3], triangles: usize) -> Vec<DVec3> {
        let mut by_colours = vec![DVec3::ZERO; triangles];
        for (pixel, face) in self.samples() {
            by_colours[face] += self.share() * by_pixels[pixel];
        }
        by_colours
    }
}
