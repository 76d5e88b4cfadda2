//! The loss: fixed random weights on irradiance, radiosity, and what two cameras see.

use crate::room::bounds;
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::scene::{Precision, Scene};
use antirad::{Cotangent, Engine, EngineError, Gradients, Solution, SolveParams};
use antirad_kit::Random;
use glam::DVec3;

/// The smallest residual that rounding allows, which differences at the smallest step need.
const TOLERANCE: f64 = 1e-14;
const MAX_PASSES: u32 = 120;

/// Weights per triangle.
pub struct Loss {
    irradiance: Vec<DVec3>,
    radiosity: Vec<DVec3>,
    colours: [Vec<DVec3>; 2],
}

/// All values that a loss weighs, per triangle, one array after another.
pub struct Values(Vec<DVec3>);

/// Positions of two cameras, metres: that of the first camera of the scene, and one inside the scene.
pub fn camera_positions(scene: &Scene) -> [DVec3; 2] {
    let (middle, radius) = bounds(scene);
    let inside = middle + radius * DVec3::new(0.11, 0.23, 0.37);
    [scene.cameras.first().map_or(middle + radius * DVec3::new(0.7, 0.6, 2.0), |c| c.position), inside]
}

impl Loss {
    pub fn new(triangles: usize) -> Self {
        let mut random = Random::new(17);
        let mut weights = |size: f64| (0..triangles).map(|_| size * random.vector()).collect::<Vec<_>>();
        Self { irradiance: weights(1.0), radiosity: weights(1.0), colours: [weights(3.0), weights(3.0)] }
    }

    pub fn cotangent(&self, camera_positions: [DVec3; 2]) -> Cotangent {
        Cotangent::default()
            .irradiance(Some(self.irradiance.clone()))
            .radiosity(Some(self.radiosity.clone()))
            .colours(camera_positions.into_iter().zip(self.colours.clone()).collect())
    }

    /// The loss of a difference of values, per channel: the sum of small differences, not the difference of large sums.
    pub fn of_difference(&self, above: &Values, below: &Values) -> DVec3 {
        let weights = [&self.irradiance, &self.radiosity].into_iter().chain(&self.colours).flatten();
        weights.zip(above.0.iter().zip(&below.0)).map(|(w, (a, b))| *w * (*a - *b)).sum()
    }
}

impl Values {
    pub fn of(
        engine: &mut Engine,
        solution: &Solution,
        camera_positions: [DVec3; 2],
    ) -> Result<Self, EngineError> {
        let mut values = Vec::with_capacity(4 * solution.irradiance.len());
        values.extend(solution.irradiance.iter().chain(&solution.radiosity).copied().map(DVec3::from));
        for camera_position in camera_positions {
            values.extend(engine.face_colours(solution, camera_position)?.into_iter().map(DVec3::from));
        }
        Ok(Self(values))
    }
}

/// An engine in double precision.
pub fn engine(
    backend: &antirad::backend::Backend,
    scene: &Scene,
    request: GradientRequest,
) -> Result<Engine, EngineError> {
    let mut settings = scene.settings;
    (settings.precision, settings.tolerance, settings.max_passes) = (Precision::F64, TOLERANCE, MAX_PASSES);
    let plan = Plan::new(scene, &PlanOptions::of(backend).gradients(request), &settings)?;
    Engine::new(backend, scene, plan)
}

pub fn params() -> SolveParams {
    SolveParams::default().tolerance(TOLERANCE).max_passes(MAX_PASSES)
}

/// The gradients of the loss with respect to everything.
pub fn gradients(
    engine: &mut Engine,
    solution: &Solution,
    loss: &Loss,
    camera_positions: [DVec3; 2],
    progress: &mut antirad::solve::SolveProgress,
) -> Result<Gradients, EngineError> {
    let request = engine.plan().options().gradients;
    engine.backward_with(solution, &loss.cotangent(camera_positions), request, &params(), progress)
}
