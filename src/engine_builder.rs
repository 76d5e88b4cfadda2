//! From a device and a scene to an engine in one expression.

use crate::gpu::Device;
use crate::plan::{GradientRequest, Plan, PlanOptions};
use crate::scene::{Scene, SolveSettings};
use crate::{Engine, EngineError};

/// Builds an [`Engine`], by default with the whole memory budget of the device and the settings of the scene.
#[derive(Clone, Debug)]
pub struct EngineBuilder<'a> {
    device: &'a Device,
    scene: &'a Scene,
    options: PlanOptions,
    settings: SolveSettings,
}

impl Engine {
    /// Plans a scene and makes the engine for it:
    ///
    /// ```no_run
    /// # use antirad::gpu::{Device, DeviceOptions};
    /// # fn solve(scene: &antirad::scene::Scene) -> Result<(), Box<dyn std::error::Error>> {
    /// let device = Device::new(&DeviceOptions::default())?;
    /// let mut engine = antirad::Engine::builder(&device, scene).build()?;
    /// let solution = engine.solve(&antirad::SolveParams::from(&scene.settings))?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// To inspect the plan first, use [`Plan::new`] and [`Engine::new`].
    pub fn builder<'a>(device: &'a Device, scene: &'a Scene) -> EngineBuilder<'a> {
        EngineBuilder { device, scene, options: PlanOptions::of(device), settings: scene.settings }
    }
}

impl EngineBuilder<'_> {
    /// Sets the options; by default those of the device ([`PlanOptions::of`]).
    #[must_use]
    pub fn options(self, options: PlanOptions) -> Self {
        Self { options, ..self }
    }

    /// Sets the settings; by default those of the scene.
    #[must_use]
    pub fn settings(self, settings: SolveSettings) -> Self {
        Self { settings, ..self }
    }

    /// Sets the kinds of derivatives to plan for; by default none.
    #[must_use]
    pub fn gradients(self, request: GradientRequest) -> Self {
        Self { options: self.options.gradients(request), ..self }
    }

    /// Plans the scene and makes the engine.
    pub fn build(self) -> Result<Engine, EngineError> {
        let Self { device, scene, options, settings } = self;
        Engine::new(device, scene, Plan::new(scene, &options, &settings)?)
    }
}
