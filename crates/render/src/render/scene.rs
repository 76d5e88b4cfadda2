//! From a scene to its light and its pictures in one call.

use super::{PictureError, RenderOptions, Renderer};
use crate::image::Picture;
use antirad_core::backend::Backend;
use antirad_core::plan::{Plan, PlanOptions};
use antirad_core::resolve::{Decision, ResolveOptions, Resolved, resolve};
use antirad_core::solve::SolveInfo;
use antirad_core::{Energy, Engine, EngineError, RayError, SolveParams};
use antirad_gpu::DeviceOptions;
use antirad_scene::Scene;

/// The light of a scene, and its pictures.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Irradiance per triangle of the given scene, RGB, W/m²: the mean over the triangle.
    pub irradiance: Vec<[f64; 3]>,
    /// Emitted and reflected power per area, per triangle of the given scene, RGB, W/m².
    pub radiosity: Vec<[f64; 3]>,
    /// What the cameras of the scene see, in their order.
    pub pictures: Vec<Picture>,
    /// What the scene left open, as it was decided.
    pub decisions: Vec<Decision>,
    /// Standard error of irradiance by rays; `None` where visibility is implicit.
    pub ray_error: Option<RayError>,
    /// Passes and residuals of the solver.
    pub info: SolveInfo,
    /// The balance of power.
    pub energy: Energy,
}

/// Computes all light of a scene as its settings say, on the backend that they say, and the pictures of its cameras: what `antirad render` writes
/// without options. [`resolve`], [`Engine`] and [`Renderer`] are the long way.
///
/// # Errors
/// Fails if the scene is invalid, if the backend cannot be opened or has too little memory, or if the solver does not converge.
pub fn render(scene: &Scene) -> Result<Rendered, PictureError> {
    let backend =
        Backend::open(Some(scene.settings.backend), &DeviceOptions::default()).map_err(EngineError::from)?;
    let resolved = resolve(scene, &ResolveOptions::default()).map_err(EngineError::from)?;
    let own = &resolved.scene;
    let plan = Plan::new(own, &PlanOptions::of(&backend), &own.settings).map_err(EngineError::from)?;
    let mut engine = Engine::new(&backend, own, plan)?;
    let solution = engine.solve(&SolveParams::from(&own.settings))?;
    let renderer = Renderer::new(&backend, RenderOptions::default())?;
    let pictures = renderer.pictures(&mut engine, &solution, own, &own.cameras)?;
    let [irradiance, radiosity] =
        [&solution.irradiance, &solution.radiosity].map(|values| resolved.on_given(values));
    let Resolved { decisions, .. } = resolved;
    let ray_error = engine.ray_error().cloned();
    Ok(Rendered {
        irradiance,
        radiosity,
        pictures,
        decisions,
        ray_error,
        info: solution.info,
        energy: solution.energy,
    })
}
