//! The results of a solve on the host, which outlive its engine.

use crate::shading::{Light, Reflections};
use crate::warnings::Warnings;
use antirad_core::plan::PlanReport;
use antirad_core::solve::SolveInfo;
use antirad_core::{Energy, Engine, EngineError, Negative, Solution};
use antirad_scene::{Camera, Scene};

/// A solved scene on the host.
#[derive(Clone, Debug)]
pub struct Answer {
    /// Irradiance per triangle of the scene, RGB, W/m², as in [`Solution`].
    pub irradiance: Vec<[f64; 3]>,
    /// Emitted and reflected power per area, per triangle of the scene, RGB, W/m², as in [`Solution`].
    pub radiosity: Vec<[f64; 3]>,
    /// Per camera, the radiance of each triangle towards it as [`Engine::face_colours`] returns it, W/(m² sr).
    #[doc(hidden)]
    pub colours: Vec<Vec<[f64; 3]>>,
    /// What pictures with gathered light are made from.
    #[doc(hidden)]
    pub light: Light,
    /// Passes, residuals and spectral radius of the solver.
    pub info: SolveInfo,
    /// The balance of power.
    pub energy: Energy,
    /// How much of the irradiance is negative.
    pub negative: Negative,
    /// [`Engine::sampling_error`].
    pub sampling_error: f64,
    /// The plan that the solve ran under.
    pub plan: PlanReport,
    /// Warnings of the scene before the solve, and of its solution.
    pub warnings: Warnings,
}

impl Answer {
    /// Reads the colours towards `cameras` from the device. `warnings`: [`Warnings::of`] the scene; those of the solution are
    /// added to them.
    ///
    /// # Errors
    /// Fails if the solution does not belong to the engine, if a camera's position is not finite, or if the
    /// backend fails.
    #[doc(hidden)]
    pub fn new(
        engine: &mut Engine,
        scene: &Scene,
        solution: Solution,
        cameras: &[Camera],
        reflections: Reflections,
        mut warnings: Warnings,
    ) -> Result<Self, EngineError> {
        let colours = cameras.iter().map(|camera| engine.face_colours(&solution, camera.position));
        let colours = colours.collect::<Result<_, _>>()?;
        let light = Light::new(engine, &solution, scene, cameras, reflections)?;
        let Solution { irradiance, radiosity, info, energy, negative, .. } = solution;
        let (plan, sampling_error) = (engine.plan(), engine.sampling_error());
        warnings.measure(scene, plan, &irradiance);
        warnings.list.extend(Warnings::after(scene, plan, &irradiance, info.spectral_radius).list);
        Ok(Self {
            irradiance,
            radiosity,
            colours,
            light,
            info,
            energy,
            negative,
            sampling_error,
            plan: plan.report(),
            warnings,
        })
    }
}
