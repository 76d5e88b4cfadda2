//! What is kept of a solve once its engine is gone: nothing of a device.

use crate::plan::PlanReport;
use crate::scene::{Camera, Scene};
use crate::solve::SolveInfo;
use crate::warnings::Warnings;
use crate::{Energy, Engine, EngineError, Negative, Solution};

/// A solved scene on the host.
#[derive(Clone, Debug)]
pub struct Answer {
    /// As in [`Solution`].
    pub irradiance: Vec<[f64; 3]>,
    /// As in [`Solution`].
    pub radiosity: Vec<[f64; 3]>,
    /// Per camera what [`Engine::face_colours`] says.
    pub colours: Vec<Vec<[f64; 3]>>,
    pub info: SolveInfo,
    pub energy: Energy,
    pub negative: Negative,
    pub plan: PlanReport,
    /// Before the solve and after it.
    pub warnings: Warnings,
}

impl Answer {
    /// Reads from the device what `cameras` see. `warnings`: [`Warnings::of`] the scene, to which those of the solution are added.
    pub fn new(
        engine: &mut Engine,
        scene: &Scene,
        solution: Solution,
        cameras: &[Camera],
        mut warnings: Warnings,
    ) -> Result<Self, EngineError> {
        let colours = cameras.iter().map(|camera| engine.face_colours(&solution, camera.position));
        let colours = colours.collect::<Result<_, _>>()?;
        let Solution { irradiance, radiosity, info, energy, negative, .. } = solution;
        let plan = engine.plan();
        warnings.list.extend(Warnings::after(scene, plan, &irradiance, info.spectral_radius).list);
        Ok(Self { irradiance, radiosity, colours, info, energy, negative, plan: plan.report(), warnings })
    }
}
