//! The renderer that solves on a device.

use super::renderer::{CostEstimate, OwnSquares, RenderError, Renderer};
use antirad_base::{Watch, parallel};
use antirad_core::backend::Backend;
use antirad_core::plan::{GradientRequest, Plan, PlanError, PlanOptions};
use antirad_core::resolve::{ResolveOptions, Resolved, resolve};
use antirad_core::{Engine, EngineError, Solution, SolveParams};
use antirad_render::image::{Coverage, FaceInPixel, ImageError, PictureOptions, Rasterizer, View};
use antirad_render::render::{self, PictureError, PullBack, RenderOptions, SceneGradient, SeenPixels, Shown};
use antirad_render::shading::{Reflections, Shading};
use antirad_scene::{Camera, Cut, Painting, Scene};
use glam::DVec3;
use std::f64::consts::PI;
use std::sync::Arc;

/// Cost of an evaluation with derivatives by materials, in solves: the adjoint solve costs as much as the forward one.
const SOLVES: f64 = 2.1;
/// Passes that derivatives by positions add, each several times as costly.
const SOLVES_OF_GEOMETRY: f64 = 1.0;

/// Pictures near the latest: relative accuracy of the difference, and the residual below which rounding rules.
const REDUCTION: f64 = 0.1;
const ROUNDING: f64 = 1e-6;
/// Relative residual of pictures near the latest where vertices have moved.
const MOVED: f64 = 1e-4;

/// Solves scenes on a device and renders their pictures.
pub struct EngineRenderer {
    backend: Backend,
    renderer: render::Renderer,
    /// Of the triangles of scenes, which are solved in parts: what goes in and comes out is that of the triangles.
    cut: Cut,
    /// The plan is made for its materials, which require as much as any later ones. Positions and cameras are those of `coverage`.
    planning: Scene,
    request: GradientRequest,
    watch: Watch,
    /// Whether every solve starts from darkness.
    independent: bool,
    /// The vertices by which derivatives are wanted; `None`: all.
    movable: Option<Vec<u32>>,
    /// Textures by whose texels derivatives are wanted.
    paintings: Vec<Painting>,
    passes: u64,
    /// Engine for the vertex positions of [`Self::planning`], with the derivatives of `planned`.
    engine: Option<Engine>,
    planned: GradientRequest,
    /// Coverage of each view at these positions; empty until computed.
    coverage: Vec<Arc<Coverage>>,
    /// State of the latest pictures. It holds device memory until the next ones have been rendered, whose solve starts from it.
    latest: Option<Latest>,
    /// Light with other vertices, to start from.
    start: Option<Solution>,
}

/// Pictures per view.
type Pictures = Vec<Vec<DVec3>>;

struct Latest {
    scene: Scene,
    solution: Solution,
    params: SolveParams,
    /// Whether the scene is a difference of scenes, whose light is no start for that of others.
    difference: bool,
    pictures: Pictures,
    /// What each view shows.
    coverage: Vec<Arc<Coverage>>,
    /// What pictures are made from.
    light: Shown,
}

impl EngineRenderer {
    /// Resolves `planning` ([`resolve`]), and renders scenes with its triangles and materials that require no more than its own
    /// ([`Parameters::planning_scene`](super::Parameters::planning_scene)), seen from the cameras of each with `supersample` x
    /// `supersample` samples per pixel, and computes the derivatives in `request`.
    ///
    /// # Errors
    /// Fails if the scene is invalid, or if the kernel of pictures cannot be compiled.
    pub fn new(
        backend: impl Into<Backend>,
        planning: Scene,
        supersample: u32,
        request: GradientRequest,
        watch: Watch,
    ) -> Result<Self, ImageError> {
        let backend = backend.into();
        let stated = planning.settings;
        let Resolved { scene: planning, cut, decisions } =
            resolve(&planning, &ResolveOptions::default().moves(request.into())).map_err(ImageError::from)?;
        if planning.settings.visibility != stated.visibility {
            let why = decisions.iter().filter(|decision| decision.setting == "visibility");
            why.for_each(|decision| tracing::warn!("visibility is {}: {}", decision.value, decision.why));
        }
        let reflections = if request.geometry() { Reflections::Bins } else { Reflections::FixedRays };
        let options = RenderOptions::default().supersample(supersample).reflections(reflections);
        Ok(Self {
            renderer: render::Renderer::new(&backend, options)?,
            backend,
            cut,
            planning,
            request,
            watch,
            independent: false,
            movable: None,
            paintings: Vec::new(),
            passes: 0,
            engine: None,
            planned: GradientRequest::default(),
            coverage: Vec::new(),
            latest: None,
            start: None,
        })
    }

    /// This renderer with another shading: gathered unless stated.
    pub fn shading(self, shading: Shading) -> Self {
        let Self { renderer, .. } = self;
        Self { renderer: renderer.shading(shading), ..self }
    }

    /// Solves every scene from darkness, so that pictures are functions of the scene alone. Otherwise solves start from the light of the
    /// pictures before, which saves passes, and pictures depend on those within the tolerance.
    pub fn independent(self) -> Self {
        Self { independent: true, ..self }
    }

    /// Derivatives by positions are those of some vertices alone, by their indices in the scene: by others they are zero.
    pub fn movable(self, vertices: Vec<u32>) -> Self {
        Self { movable: Some(self.cut.moved_by(&vertices)), ..self }
    }

    /// Derivatives by albedo include those by the texels of these textures.
    pub fn paintings(self, paintings: Vec<Painting>) -> Self {
        Self { paintings: paintings.iter().map(|painting| self.cut.paint(painting)).collect(), ..self }
    }

    fn plan(&self, scene: &Scene, gradients: GradientRequest) -> Result<Plan, RenderError> {
        let options = PictureOptions::default().supersample(self.renderer.options().supersample);
        let mut pictures = 0;
        for camera in &scene.cameras {
            let bytes = Rasterizer::bytes(self.backend.kind(), scene.triangles.len(), camera, &options)
                .map_err(failed)?;
            pictures = pictures.max(bytes);
        }
        let options = PlanOptions::of(&self.backend).pictures(pictures).gradients(gradients);
        Plan::new(scene, &options, &scene.settings).map_err(|error| sort_out(error.into()))
    }

    /// Per triangle, whether any view shows it, at the latest positions or else those of the planning scene.
    ///
    /// # Errors
    /// Fails if the scene or a camera is invalid, or if the device fails.
    pub fn seen(&mut self) -> Result<Vec<bool>, RenderError> {
        self.look(&self.planning.clone())?;
        let parts = Coverage::seen(self.coverage.iter().map(Arc::as_ref), self.planning.triangles.len());
        let mut seen = vec![false; self.cut.given()];
        self.cut.parents().zip(parts).for_each(|(triangle, is_seen)| seen[triangle as usize] |= is_seen);
        Ok(seen)
    }

    /// The parts of the triangles of a scene, with the resolved settings but for tolerance and passes.
    fn parts(&self, scene: &Scene) -> Scene {
        let mut parts = self.cut.apply(scene);
        let SolveParams { tolerance, max_passes, .. } = SolveParams::from(&scene.settings);
        parts.settings = self.planning.settings.tolerance(tolerance).max_passes(max_passes);
        parts
    }

    /// Computes the coverage at the positions and from the cameras of a scene, as far as they have changed.
    fn look(&mut self, scene: &Scene) -> Result<(), RenderError> {
        let has_moved = self.planning.vertices != scene.vertices;
        if !has_moved && self.planning.cameras == scene.cameras && !self.coverage.is_empty() {
            return Ok(());
        }
        let positions = std::mem::replace(&mut self.planning.vertices, scene.vertices.clone());
        self.planning.degenerate.clone_from(&scene.degenerate);
        let cameras = std::mem::replace(&mut self.planning.cameras, scene.cameras.clone());
        let coverage = std::mem::take(&mut self.coverage);
        let before = |view: usize| {
            let same = cameras.get(view) == scene.cameras.get(view);
            coverage.get(view).filter(|_| same)
        };
        let look = |(view, camera)| match before(view) {
            Some(coverage) if !has_moved => Ok(coverage.clone()),
            Some(coverage) => {
                let before = (&positions[..], &**coverage);
                self.renderer.coverage_of_moved(&self.planning, camera, before).map(Arc::new)
            }
            None => self.renderer.coverage(&self.planning, camera).map(Arc::new),
        };
        let views = scene.cameras.iter().enumerate().map(look);
        self.coverage = views.collect::<Result<_, _>>().map_err(failed)?;
        Ok(())
    }

    /// Frees the memory of the engine before that of the next one is allocated, but for the light to start from, where there is room for
    /// both.
    fn retire(&mut self) {
        self.start = self.latest.take().and_then(Latest::start);
        let planned = self.engine.take().map_or(0, |engine| engine.plan().memory().total());
        let memory = self.backend.memory();
        if memory.budget.saturating_sub(memory.in_use) < planned + planned / 4 {
            self.start = None;
        }
    }

    /// Updates engine and coverage to the positions and cameras of a scene; an engine that is made for it has the derivatives of `gradients`.
    fn prepare(&mut self, scene: &Scene, gradients: GradientRequest) -> Result<Engine, RenderError> {
        if self.planning.vertices != scene.vertices {
            self.retire();
        }
        self.look(scene)?;
        let mut engine = match self.engine.take() {
            Some(engine) => engine,
            None => {
                let plan = self.plan(&self.planning, gradients)?;
                self.planned = gradients;
                let mut engine = Engine::new(&self.backend, &self.planning, plan).map_err(sort_out)?;
                let watch = self.watch.clone();
                engine.set_movable(self.movable.as_deref());
                engine.set_pass_callback(Some(Box::new(move |_, _| watch())));
                engine
            }
        };
        // The scene of a linear least-squares step is a difference of scenes.
        engine.set_linear_materials(scene).map_err(sort_out)?;
        Ok(engine)
    }
}

impl Latest {
    /// The light to start other solves from.
    fn start(self) -> Option<Solution> {
        (!self.difference).then_some(self.solution)
    }

    /// Whether this is the light of a scene; scenes differ in materials, textures, positions and cameras only.
    fn is_light_of(&self, scene: &Scene) -> bool {
        let same_patterns = Arc::ptr_eq(&self.scene.patterns, &scene.patterns);
        let same = self.scene.materials == scene.materials && self.scene.vertices == scene.vertices;
        !self.difference && same && (same_patterns || self.scene.patterns.same_texels(&scene.patterns))
    }

    /// Whether these are the pictures of a scene.
    fn is_of(&self, scene: &Scene) -> bool {
        self.is_light_of(scene) && self.scene.cameras == scene.cameras
    }
}

impl EngineRenderer {
    /// Solves a scene, starting from the light of the latest one where that is alike, and renders its pictures.
    fn render(
        &mut self,
        scene: &Scene,
        params: SolveParams,
        difference: bool,
        gradients: GradientRequest,
    ) -> Result<Latest, RenderError> {
        if (self.watch)().is_break() {
            return Err(RenderError::Interrupted);
        }
        let mut engine = self.prepare(scene, gradients)?;
        let moved = self.start.take();
        let latest = self.latest.as_ref().filter(|latest| !latest.difference);
        let start = latest.map(|latest| &latest.solution).or(moved.as_ref());
        let start = start.filter(|_| !(self.independent || difference));
        let (watch, passes) = (self.watch.clone(), &mut self.passes);
        let solved = engine.solve_from(start, &params, &mut |_, _| {
            *passes += 1;
            watch()
        });
        let engine = self.engine.insert(engine);
        let solution = solved.map_err(sort_out)?;
        let before = self.latest.as_ref().map(|latest| &latest.light);
        let light =
            self.renderer.light(engine, &solution, scene, &scene.cameras, before).map_err(sort_out)?;
        let pictures =
            (0..scene.cameras.len()).map(|view| self.picture(&light, view)).collect::<Result<_, _>>()?;
        let coverage = self.coverage.clone();
        Ok(Latest { scene: scene.clone(), solution, params, difference, pictures, coverage, light })
    }

    fn picture(&self, light: &Shown, view: usize) -> Result<Vec<DVec3>, RenderError> {
        let pixels = self.renderer.pixels(light, view, &self.coverage[view]).map_err(failed)?.pixels;
        Ok(pixels.iter().map(|&[r, g, b, _]| DVec3::new(r, g, b)).collect())
    }

    /// The latest light towards the cameras of a scene, and its pictures; `None` if the scene has another light, or if the engine no
    /// longer has this one.
    fn look_again(&mut self, scene: &Scene) -> Result<Option<(Shown, Pictures)>, RenderError> {
        if (self.watch)().is_break() {
            return Err(RenderError::Interrupted);
        }
        let (Some(latest), Some(engine)) = (&self.latest, &self.engine) else { return Ok(None) };
        if !latest.is_light_of(scene) || engine.check_own(&latest.solution).is_err() {
            return Ok(None);
        }
        self.look(scene)?;
        let (Some(latest), Some(engine)) = (&self.latest, &mut self.engine) else { return Ok(None) };
        let light = self.renderer.light(engine, &latest.solution, scene, &scene.cameras, Some(&latest.light));
        let light = light.map_err(sort_out)?;
        let before = latest.scene.cameras.iter().zip(&latest.pictures);
        let picture = |(view, (camera, (camera_before, before)))| match camera == camera_before {
            true => Ok(Vec::clone(before)),
            false => self.picture(&light, view),
        };
        let pictures = scene.cameras.iter().zip(before).enumerate().map(picture).collect::<Result<_, _>>()?;
        Ok(Some((light, pictures)))
    }
}

impl Renderer for EngineRenderer {
    fn estimate(&mut self, _: &Scene) -> Result<CostEstimate, RenderError> {
        let plan = self.plan(&self.planning, self.request)?;
        let solves = SOLVES + if self.request.positions { SOLVES_OF_GEOMETRY } else { 0.0 };
        let report = plan.report();
        Ok(CostEstimate {
            device_bytes: plan.memory().total(),
            device_budget: plan.options().memory_budget,
            seconds: solves * (report.estimated_seconds * report.estimated_seconds_at_most).sqrt(),
        })
    }

    fn pictures(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        let scene = &self.parts(scene);
        if self.planned != self.request {
            // An engine for pictures alone.
            self.retire();
        }
        if let Some(latest) = self.latest.as_ref().filter(|latest| latest.is_of(scene)) {
            return Ok(latest.pictures.clone());
        }
        if let Some((light, pictures)) = self.look_again(scene)?
            && let Some(latest) = &mut self.latest
        {
            latest.scene.cameras.clone_from(&scene.cameras);
            (latest.light, latest.coverage) = (light, self.coverage.clone());
            latest.pictures.clone_from(&pictures);
            return Ok(pictures);
        }
        let params = SolveParams::from(&scene.settings);
        let latest = self.render(scene, params, false, self.request)?;
        Ok(self.latest.insert(latest).pictures.clone())
    }

    fn pictures_near(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        let scene = &self.parts(scene);
        if self.planning.vertices != scene.vertices {
            // No derivatives are wanted here, and other vertices need another engine anyway.
            let params = SolveParams::from(&scene.settings);
            let params = params.tolerance(params.tolerance.max(MOVED));
            let latest = self.render(scene, params, false, GradientRequest::default())?;
            return Ok(self.latest.insert(latest).pictures.clone());
        }
        if let Some((_, pictures)) = self.look_again(scene)? {
            return Ok(pictures);
        }
        let params = SolveParams::from(&scene.settings).reduction(REDUCTION);
        let params = params.tolerance(params.tolerance.min(ROUNDING));
        Ok(self.render(scene, params, false, self.planned)?.pictures)
    }

    fn pictures_of_difference(&mut self, scene: &Scene) -> Result<Vec<Vec<DVec3>>, RenderError> {
        let scene = &self.parts(scene);
        let latest = self.render(scene, SolveParams::from(&scene.settings), true, self.request)?;
        Ok(self.latest.insert(latest).pictures.clone())
    }

    fn pull_back(
        &mut self,
        by_pixels: &[Vec<DVec3>],
        request: GradientRequest,
    ) -> Result<Option<SceneGradient>, RenderError> {
        let (Some(latest), Some(engine)) = (&self.latest, &mut self.engine) else { return Ok(None) };
        // Losses do not depend on coverage itself.
        let by_pixels: Vec<Vec<[f64; 4]>> =
            by_pixels.iter().map(|view| view.iter().map(|by| by.extend(0.0).to_array()).collect()).collect();
        let views = latest.scene.cameras.iter().zip(&latest.coverage).zip(&by_pixels);
        let views: Vec<SeenPixels> =
            views.map(|((camera, coverage), by_pixels)| SeenPixels { camera, coverage, by_pixels }).collect();
        let (watch, passes) = (self.watch.clone(), &mut self.passes);
        let mut progress = |_, _| {
            *passes += 1;
            watch()
        };
        let Latest { scene, solution, params, light, .. } = latest;
        let wanted = PullBack {
            request,
            movable: self.movable.as_deref(),
            paintings: &self.paintings,
            params: *params,
        };
        let pulled = self.renderer.pull_back(engine, solution, scene, light, &views, wanted, &mut progress);
        let pulled = pulled.map_err(|error| match error {
            PictureError::Engine(error) => sort_out(error),
            PictureError::Image(error) => failed(error),
            error => failed(error),
        })?;
        Ok(Some(pulled.by_given(&self.cut)))
    }

    fn own_squares(&mut self, weights: &[Vec<DVec3>]) -> Option<OwnSquares> {
        let Latest { scene, solution, coverage, .. } = self.latest.as_ref()?;
        let parents: Vec<u32> = self.cut.parents().collect();
        let none = vec![DVec3::ZERO; self.cut.given()];
        let (mut albedo, mut emission) = (none.clone(), none);
        for (coverage, weights) in coverage.iter().zip(weights) {
            // What a pixel shows of all parts of a triangle.
            let seen = coverage.faces_in_pixels().map(|FaceInPixel { face, pixel, share, .. }| {
                let reflected = DVec3::from(solution.in_the_open[face]) * scene.material(face).diffuse / PI;
                ((pixel, parents[face]), [share * reflected, DVec3::splat(share)])
            });
            let mut seen: Vec<((usize, u32), [DVec3; 2])> = seen.collect();
            seen.sort_by_key(|(key, _)| *key);
            for parts in seen.chunk_by(|(a, _), (b, _)| a == b) {
                let (pixel, triangle) = parts[0].0;
                let square =
                    |k: usize| weights[pixel] * parts.iter().map(|of| of.1[k]).sum::<DVec3>().powf(2.0);
                albedo[triangle as usize] += square(0);
                emission[triangle as usize] += square(1);
            }
        }
        Some(OwnSquares { albedo, emission })
    }

    fn points_in_pixels(&self) -> Option<Vec<Vec<Option<DVec3>>>> {
        let Latest { scene, coverage, .. } = self.latest.as_ref()?;
        let of_view = |(camera, coverage): (&Camera, &Arc<Coverage>)| {
            let view = View::new(camera);
            let mut nearest: Vec<(f64, Option<DVec3>)> =
                vec![(f64::INFINITY, None); (camera.width * camera.height) as usize];
            for FaceInPixel { face, pixel, place: [column, row], .. } in coverage.faces_in_pixels() {
                let [a, b, c] = scene.corners(face);
                let (ray, normal) = (view.ray(column, row), (b - a).cross(c - a));
                let point = view.position + ray * (normal.dot(a - view.position) / normal.dot(ray));
                let depth = view.depth(point);
                // Of a face that is seen edge-on, the place may be off the face.
                if depth > 0.0 && depth < nearest[pixel].0 {
                    nearest[pixel] = (depth, Some(point));
                }
            }
            nearest.into_iter().map(|(_, point)| point).collect()
        };
        Some(parallel::map(scene.cameras.iter().zip(coverage), of_view))
    }

    fn forget(&mut self) {
        (self.latest, self.start) = (None, None);
    }

    fn passes(&self) -> u64 {
        self.passes
    }
}

fn failed(error: impl std::error::Error + Send + Sync + 'static) -> RenderError {
    RenderError::Failed(Box::new(error))
}

/// Classifies an error: interrupted, no solution for this scene, or fatal.
fn sort_out(error: EngineError) -> RenderError {
    match error {
        error if error.is_interruption() => RenderError::Interrupted,
        error if error.is_without_answer() => RenderError::NoAnswer(error.to_string()),
        // A step led outside the range of valid numbers or materials.
        error @ (EngineError::Scene(_) | EngineError::Plan(PlanError::Scene(_))) => {
            RenderError::NoAnswer(error.to_string())
        }
        other => failed(other),
    }
}
