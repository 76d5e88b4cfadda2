//! From a backend and a scene to an engine in one expression.

use crate::backend::Backend;
use crate::plan::{GradientRequest, Plan, PlanOptions};
use crate::{Engine, EngineError};
use antirad_scene::{Scene, SolveSettings};

/// Builds an [`Engine`], by default with the whole memory budget of the backend and the settings of the scene.
#[derive(Clone, Debug)]
pub struct EngineBuilder<'a> {
    backend: Backend,
    scene: &'a Scene,
    options: PlanOptions,
    settings: SolveSettings,
}

impl Engine {
    /// Plans a scene and makes the engine for it:
    ///
    /// To inspect the plan first, use [`Plan::new`] and [`Engine::new`].
    pub fn builder(backend: impl Into<Backend>, scene: &Scene) -> EngineBuilder<'_> {
        let backend = backend.into();
        EngineBuilder { options: PlanOptions::of(&backend), backend, scene, settings: scene.settings }
    }
}

impl EngineBuilder<'_> {
    /// Sets the options; by default those of the backend ([`PlanOptions::of`]).
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
    ///
    /// # Errors
    /// Fails if the scene cannot be planned ([`Plan::new`]), or the engine cannot be made ([`Engine::new`]).
    pub fn build(self) -> Result<Engine, EngineError> {
        let Self { backend, scene, options, settings } = self;
        Engine::new(backend, scene, Plan::new(scene, &options, &settings)?)
    }
}
