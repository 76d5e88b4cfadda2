//! The short way to an engine.

use crate::gpu::Device;
use crate::plan::{Limits, Plan, Wanted};
use crate::scene::{Accuracy, Scene};
use crate::{Engine, EngineError};

/// An engine in the making. Unless told otherwise it may use all that the device has, and solves as the scene asks.
#[derive(Clone, Debug)]
pub struct EngineBuilder<'a> {
    device: &'a Device,
    scene: &'a Scene,
    limits: Limits,
    accuracy: Accuracy,
}

impl Engine {
    /// Plans a scene and makes the engine for it:
    ///
    /// ```no_run
    /// # use antirad::gpu::{Device, DeviceOptions};
    /// # fn solve(scene: &antirad::scene::Scene) -> Result<(), Box<dyn std::error::Error>> {
    /// let device = Device::new(&DeviceOptions::default())?;
    /// let mut engine = antirad::Engine::builder(&device, scene).build()?;
    /// let solution = engine.solve(&antirad::SolveParams::from(&scene.accuracy))?;
    /// # Ok(())
    /// # }
    /// ```
    ///
    /// [`Plan::new`] and [`Engine::new`] are the long way, for who wants to see the plan first.
    pub fn builder<'a>(device: &'a Device, scene: &'a Scene) -> EngineBuilder<'a> {
        EngineBuilder { device, scene, limits: Limits::of(device), accuracy: scene.accuracy }
    }
}

impl EngineBuilder<'_> {
    /// Limits other than those of the device.
    #[must_use]
    pub fn limits(self, limits: Limits) -> Self {
        Self { limits, ..self }
    }

    /// An accuracy other than that of the scene.
    #[must_use]
    pub fn accuracy(self, accuracy: Accuracy) -> Self {
        Self { accuracy, ..self }
    }

    /// Derivatives that will be asked for.
    #[must_use]
    pub fn gradients(self, wanted: Wanted) -> Self {
        Self { limits: self.limits.gradients(wanted), ..self }
    }

    pub fn build(self) -> Result<Engine, EngineError> {
        let Self { device, scene, limits, accuracy } = self;
        Engine::new(device, scene, Plan::new(scene, &limits, &accuracy)?)
    }
}
