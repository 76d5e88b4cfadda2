//! The engine: a planned scene on a device, solved.

use crate::backend::Backend;
use crate::direct::{DirectError, DirectLight, Lamp, Openness};
use crate::engine_direct::{Direct, lamps_of};
use crate::model::rays_among;
use crate::plan::{NearField, PADDING, Plan, PlanError, PlanOptions, PlannedSolver, RankWeights, Residency};
use crate::revision::{Difference, Revision};
use crate::rows::{self, RayError};
use crate::solve::{
    FixedPointParams, GmresParams, SolveError, SolveInfo, SolveProgress, fixed_point_from, gmres_from,
};
use crate::transport::{self, Operators, PassCallback, State, TransportError};
use antirad_base::ranks::RankError;
use antirad_base::setters;
use antirad_gpu::GpuError;
use antirad_scene::{BackendKind, BinLayout, Material, Precision, Scene, SceneError, SolveSettings};
use antirad_scene::{Movable, Rays};
use glam::DVec3;
use std::f64::consts::PI;
use std::fmt;
use std::ops::{ControlFlow, Range};
use std::sync::Arc;

/// Why an operation of the engine failed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EngineError {
    /// The device, or a call into it, failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// There is no plan for the scene.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// A solve failed or was stopped. [`SolveError::NoConvergence`] holds the last iterate, and device memory with
    /// it, except from [`Engine::backward`].
    #[error(transparent)]
    Solve(#[from] SolveError<TransportError, Option<Box<Solution>>>),
    /// A pass outside of a solve failed, or was stopped.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The engine allocated a different size than the plan counts.
    #[error(
        "the plan counts {planned} bytes of \"{label}\" and the engine allocated {allocated}: a bug in antirad"
    )]
    #[doc(hidden)]
    Miscounted {
        /// Label of the buffers.
        label: String,
        /// Bytes that the plan counts.
        planned: u64,
        /// Bytes that this engine allocated.
        allocated: u64,
    },
    /// Derivatives that were not planned.
    #[error(
        "gradients{}{} were not planned: request them in PlanOptions::gradients and plan again",
        if kinds.is_empty() { "" } else { " of " },
        kinds.join(", ")
    )]
    NotPlanned {
        /// Names of the kinds; empty where the plan has no gradients at all.
        kinds: Vec<&'static str>,
    },
    /// A cotangent does not fit the scene.
    #[error(
        "the cotangent of {what} has {given} entries, but the scene has {triangles} triangles: give one each"
    )]
    CotangentLength {
        /// The result that the cotangent belongs to.
        what: &'static str,
        /// Number of entries given.
        given: usize,
        /// Number of entries required.
        triangles: usize,
    },
    /// A cotangent has another number of bins than the plan.
    #[error(
        "the cotangent of specular radiance has {given} bins at triangle {triangle}, and the plan {bins}: give one each, or none"
    )]
    CotangentBins {
        /// Index of the triangle in the scene.
        triangle: usize,
        /// Number of bins given.
        given: usize,
        /// Number of bins required.
        bins: usize,
    },
    /// A cotangent is infinite or not a number.
    #[error(
        "the cotangent of {what} is not finite at triangle {triangle}: look for a division by zero in the loss"
    )]
    CotangentNotFinite {
        /// The result that the cotangent belongs to.
        what: &'static str,
        /// Index of the triangle in the scene.
        triangle: usize,
    },
    /// New materials need features that were not planned.
    #[error(
        "triangle {triangle} {why}, which was not planned: call Engine::rebuilt, or plan a scene \
         that has it"
    )]
    #[doc(hidden)]
    BeyondPlan {
        /// Index of the triangle in the scene.
        triangle: usize,
        /// What the triangle has that the plan lacks.
        why: &'static str,
    },
    /// Scene and plan have different numbers of triangles.
    #[error("the plan is for {planned} triangles and the scene has {given}: plan this scene")]
    OtherScene {
        /// Triangles of the plan.
        planned: usize,
        /// Triangles of the scene.
        given: usize,
    },
    /// The plan is for another process than the device.
    #[error(
        "the plan is for process {} of {} and the device for {} of {}: make the plan with the options of the device \
         (PlanOptions::of)",
        planned.0 + 1, planned.1, given.0 + 1, given.1
    )]
    #[doc(hidden)]
    OtherRanks {
        /// Rank of the plan, from 0, and number of ranks.
        planned: (u32, u32),
        /// Rank of the device, from 0, and number of ranks.
        given: (usize, usize),
    },
    /// The plan is for another backend.
    #[error(
        "the plan is for the backend {planned} and the engine for {given}: plan with the options of the backend (PlanOptions::of)"
    )]
    OtherBackend {
        /// Backend of the plan.
        planned: BackendKind,
        /// Backend of the engine.
        given: BackendKind,
    },
    /// The geometry is not that of the plan.
    #[error(
        "triangle {triangle} has another position in the plan: plan this scene, or call \
         Engine::rebuilt"
    )]
    OtherGeometry {
        /// Index of the first such triangle in the scene.
        triangle: usize,
    },
    /// The scene cannot be solved.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A new sun needs channels that were not planned.
    #[error(
        "sun {sun} has a colour, which was not planned: call Engine::rebuilt, or plan a scene that has it"
    )]
    #[doc(hidden)]
    ColouredSun {
        /// Its place in [`Scene::suns`], from 0.
        sun: usize,
    },
    /// The solution belongs to another engine, or to this one before [`Engine::rebuilt`].
    #[error(
        "the solution belongs to another engine, which orders its values differently: use that engine, or solve here, \
         for instance starting from it (Engine::solve_from)"
    )]
    OtherEngine,
    /// The solution is older than the last [`Engine::set_materials`].
    #[error(
        "the materials have changed since this solution: solve again, for instance starting from it (Engine::solve_from)"
    )]
    OutdatedSolution,
    /// The tolerance is not between 0 and 1.
    #[error("the tolerance is {tolerance}; it must be above 0 and below 1, such as 1e-4")]
    Tolerance {
        /// The tolerance given.
        tolerance: f64,
    },
    /// The reduction is not between 0 and 1.
    #[error("the reduction is {reduction}; it must be 0, or above and below 1, such as 0.01")]
    #[doc(hidden)]
    Reduction {
        /// The reduction given.
        reduction: f64,
    },
    /// `max_passes` is 0.
    #[error("no passes are allowed: max_passes must be 1 or more")]
    NoPasses,
    /// A camera's position is infinite or not a number.
    #[error("the camera's position is {position}; it must be finite")]
    CameraPosition {
        /// The position, metres.
        position: DVec3,
    },
}

/// The unit of light on the device: the power of two at or below the brightest emission, or what a white surface reflects of a sun.
/// Transport is linear, so this changes no digit, and it keeps f32 values and their squares in range however bright the lamps are.
fn light_unit(scene: &Scene) -> f64 {
    let emissions = (0..scene.triangles.len()).flat_map(|i| scene.material(i).emission);
    let suns = scene.suns.iter().flat_map(|sun| sun.irradiance.map(|h| h / PI));
    power_of_two(emissions.chain(suns).fold(0.0, |most, value| most.max(value.abs())))
}

/// Relative rounding error of a pass: sums over thousands of pairs.
pub(crate) fn rounding(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 4.0 * f64::from(f32::EPSILON),
        Precision::F64 => 4.0 * f64::EPSILON,
    }
}

/// The power of two at or below a value; 1 for zero.
pub(crate) fn power_of_two(value: f64) -> f64 {
    if value > 0.0 && value.is_finite() { value.log2().floor().exp2() } else { 1.0 }
}

/// When a solve stops.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SolveParams {
    /// Relative residual ‖U (E + (K - J) H) - H‖ / ‖H‖ of irradiance, area-weighted.
    pub tolerance: f64,
    /// Largest number of passes; a solve that needs more fails.
    pub max_passes: u32,
    /// Stops, too, where the residual is below this fraction of that of the start: 0 for never. Useful from the solution of a
    /// similar scene, where it is the relative accuracy of the difference.
    #[doc(hidden)]
    pub reduction: f64,
}

setters!(SolveParams {
    tolerance: f64,
    max_passes: u32,
    #[doc(hidden)]
    reduction: f64
});

impl SolveParams {
    pub(crate) fn check(&self) -> Result<(), EngineError> {
        let Self { tolerance, max_passes, reduction } = *self;
        if !(tolerance > 0.0 && tolerance < 1.0) {
            return Err(EngineError::Tolerance { tolerance });
        }
        if !(0.0..1.0).contains(&reduction) {
            return Err(EngineError::Reduction { reduction });
        }
        if max_passes == 0 { Err(EngineError::NoPasses) } else { Ok(()) }
    }
}

impl Default for SolveParams {
    /// The parameters of the default settings.
    fn default() -> Self {
        Self::from(&SolveSettings::default())
    }
}

impl From<&SolveSettings> for SolveParams {
    fn from(settings: &SolveSettings) -> Self {
        Self { tolerance: settings.tolerance, max_passes: settings.max_passes, reduction: 0.0 }
    }
}

/// Energy balance, RGB, W.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Energy {
    /// Emitted by all fronts, and what fronts receive straight from suns.
    pub emitted: [f64; 3],
    /// Incident on fronts and not reflected.
    pub absorbed: [f64; 3],
    /// What falls on black backs, by rays; `None` where visibility is implicit.
    pub on_backs: Option<[f64; 3]>,
    /// What leaves an open scene, by rays. Where visibility is implicit, all that is emitted and not absorbed by fronts: light that leaves or
    /// falls on black backs, and the discretisation error.
    pub escaped: [f64; 3],
    /// Emitted, and none of these: the discretisation error. Zero where visibility is implicit.
    pub unaccounted: [f64; 3],
}

/// Negative irradiance: discretised antiradiance may subtract slightly more light than there is.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Negative {
    /// Number of triangles with a negative channel.
    pub triangles: usize,
    /// The lowest irradiance, W/m²; 0 if none is negative.
    pub minimum: f64,
}

/// Memory layout of a state: states of the same arrangement can be added.
#[derive(Clone, Debug, PartialEq)]
struct Arrangement {
    backend: BackendKind,
    bins: BinLayout,
    channels: u32,
    precision: Precision,
    residency: Residency,
    /// Tiles of each group, and whether they have bins.
    groups: Vec<(Range<u32>, bool)>,
    /// Triangle of each slot.
    order: Vec<u32>,
}

impl Arrangement {
    fn of(plan: &Plan) -> Self {
        Self {
            backend: plan.options.backend,
            bins: plan.settings.bins,
            channels: plan.channels,
            precision: plan.settings.precision,
            residency: plan.residency,
            groups: plan.layout.groups.iter().map(|g| (g.tiles.clone(), g.class.has_bins())).collect(),
            order: plan.layout.order.clone(),
        }
    }
}

/// A solved scene. Holds device memory until it is dropped. It is valid for the engine that computed it, until that
/// engine takes other materials.
pub struct Solution {
    /// Irradiance per triangle of the scene, RGB, W/m²: the mean over the triangle; zero for triangles without area.
    pub irradiance: Vec<[f64; 3]>,
    /// The same of where triangles lie open ([`Openness`](crate::direct::Openness)): what pictures interpolate.
    #[doc(hidden)]
    pub in_the_open: Vec<[f64; 3]>,
    /// Emitted and reflected power per area, per triangle of the scene, RGB, W/m².
    pub radiosity: Vec<[f64; 3]>,
    /// How the solve went.
    pub info: SolveInfo,
    /// Energy balance.
    pub energy: Energy,
    /// Negative irradiance.
    pub negative: Negative,
    /// Incident light on the backend, from which the next solve starts.
    #[doc(hidden)]
    pub state: State,
    arrangement: Arrangement,
    revision: Revision,
    /// Unit of light in the state, W/m².
    unit: f64,
}

impl fmt::Debug for Solution {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("Solution").field("info", &self.info).finish_non_exhaustive()
    }
}

impl EngineError {
    /// Whether the solver ran but found no solution; the engine remains usable.
    pub fn is_without_answer(&self) -> bool {
        matches!(self, Self::Solve(error) if error.is_without_answer())
    }

    /// The last iterate of a solve that did not converge, as accurate as its last residual.
    ///
    /// # Errors
    /// Returns the error itself, if it holds no iterate.
    #[doc(hidden)]
    pub fn into_best(self) -> Result<Box<Solution>, Self> {
        match self {
            Self::Solve(SolveError::NoConvergence { best: Some(best), .. }) => Ok(best),
            other => Err(other),
        }
    }

    /// This error without the last iterate of the solver, and so without device memory.
    #[doc(hidden)]
    pub fn without_best(mut self) -> Self {
        if let Self::Solve(SolveError::NoConvergence { best, .. }) = &mut self {
            *best = None;
        }
        self
    }

    /// The error of the device behind this one, if it is one.
    #[doc(hidden)]
    pub fn of_device(&self) -> Option<&GpuError> {
        match self {
            Self::Gpu(error)
            | Self::Transport(TransportError::Gpu(error))
            | Self::Solve(SolveError::Operator(TransportError::Gpu(error))) => Some(error),
            _ => None,
        }
    }

    /// Whether the device is gone: nothing else works on it any more.
    pub fn is_device_lost(&self) -> bool {
        matches!(self.of_device(), Some(GpuError::DeviceLost(_)))
    }

    /// Whether the same calls may succeed at another time, on another device, or where all ranks are started again.
    pub fn may_pass(&self) -> bool {
        match self {
            Self::Gpu(error) => error.may_pass(),
            Self::Transport(error) | Self::Solve(SolveError::Operator(error)) => error.may_pass(),
            _ => false,
        }
    }

    /// Whether a callback stopped the work, which is no failure.
    pub fn is_interruption(&self) -> bool {
        if matches!(self.of_device(), Some(GpuError::Interrupted)) {
            return true;
        }
        matches!(
            self,
            Self::Solve(SolveError::Interrupted { .. } | SolveError::Operator(TransportError::Interrupted))
                | Self::Transport(TransportError::Interrupted)
        )
    }
}

/// A planned scene on a backend.
pub struct Engine {
    backend: Backend,
    pub(crate) operators: Box<dyn Operators>,
    /// The light that comes straight from lamps.
    #[doc(hidden)]
    pub direct: Direct,
    /// Per triangle of the scene.
    #[doc(hidden)]
    pub materials: Vec<Material>,
    /// Unit of incident and outgoing light on the device: W/m², W/(m² sr).
    pub(crate) unit: f64,
    /// Vertices of each triangle of the scene.
    #[doc(hidden)]
    pub triangles: Vec<[u32; 3]>,
    /// Number of vertices of the scene.
    pub(crate) vertices: usize,
    /// Vertices by which the engine is differentiated.
    #[doc(hidden)]
    pub movable: Movable,
    ray_error: Option<RayError>,
    revision: Revision,
}

impl PlanOptions {
    /// The limits of a backend, less the memory in use by other engines, held solutions and pictures; with several ranks, which must all
    /// ask at once, the smallest limits of all, since they do the same steps, and work in proportion to the memory budgets of their devices.
    pub fn of(backend: impl Into<Backend>) -> Self {
        let backend = backend.into();
        let (memory, ranks) = (backend.memory(), backend.ranks());
        let info = backend.vulkan().map(|device| device.info());
        let own = [
            memory.budget.saturating_sub(memory.in_use),
            info.map_or(u64::MAX, |info| info.largest_buffer()),
            memory.budget,
        ];
        // Where ranks can no longer work together, the next pass says so.
        let of_all = ranks.each(own).unwrap_or_else(|_| vec![own]);
        let [free, max_buffer, _] =
            of_all.iter().fold(own, |least, of| std::array::from_fn(|k| least[k].min(of[k])));
        let budgets: Vec<u64> = of_all.iter().map(|&[.., budget]| budget).collect();
        Self {
            memory_budget: free,
            max_buffer,
            staging: if info.is_some() { antirad_gpu::staging_bytes() } else { 0 },
            page: if info.is_some() { max_buffer } else { Self::default().page },
            backend: backend.kind(),
            fast_near_field: backend.gpu().is_some(),
            trace_lamps: backend.gpu().is_some(),
            rank: ranks.rank() as u32,
            ranks: ranks.count() as u32,
            weights: RankWeights::of_budgets(&budgets),
            ..Self::default()
        }
    }
}

impl From<RankError> for EngineError {
    fn from(error: RankError) -> Self {
        Self::Transport(error.into())
    }
}

impl From<DirectError> for EngineError {
    fn from(error: DirectError) -> Self {
        match error {
            DirectError::Gpu(error) => error.into(),
            DirectError::Ranks(error) => error.into(),
        }
    }
}

/// The light of lamps, which ranks compute together.
fn direct_light(
    backend: &Backend,
    scene: &Scene,
    plan: &Plan,
    lamps: Vec<Lamp>,
) -> Result<DirectLight, DirectError> {
    let (ranks, facets, material) = (backend.ranks(), &plan.facets, |i| scene.material(i));
    let open = plan.openness.clone();
    match transport::tracer(backend, plan) {
        Some(tracer) => DirectLight::traced(ranks, facets, lamps, open, material, tracer),
        None => Ok(DirectLight::new(ranks, facets, lamps, plan.visibility, open, material)?),
    }
}

/// Looks how open triangles lie, where their light goes by rays, which are then to be traced.
fn look_around(scene: &Scene, plan: &mut Plan) -> Option<Arc<Rays>> {
    let NearField::Traced { .. } = plan.near_field else { return None };
    let rays = rays_among(&plan.facets);
    plan.openness = Openness::new(&plan.facets, &rays, |i| scene.material(i).emits()).into();
    Some(rays)
}

/// The light for which rays are traced.
fn light_of(scene: &Scene, direct: &Direct) -> rows::Light {
    let grey = |rgb: [f64; 3]| rgb.iter().sum::<f64>() / 3.0;
    let albedo = |i: usize| {
        let material = scene.material(i);
        let all = grey(material.diffuse_albedo()) + grey(material.specular);
        all.min(MOST_REFLECTED)
    };
    rows::Light {
        emitted: direct.emitted(scene).into_iter().map(grey).collect(),
        albedo: (0..scene.triangles.len()).map(albedo).collect(),
        direct: direct.irradiance.iter().map(|h| grey(h.to_array())).collect(),
    }
}

/// What triangles are taken to reflect at most, where rays are allotted: so that light decays.
const MOST_REFLECTED: f64 = 0.99;

impl Engine {
    /// Traces the rays of a plan that has some. Allocates exactly the memory that the plan counts, and compiles the kernels.
    ///
    /// # Errors
    /// Fails if the scene is invalid or not that of the plan, if the plan is for another backend or other
    /// ranks, or if the backend lacks memory or a feature.
    #[doc(hidden)]
    pub fn new(backend: impl Into<Backend>, scene: &Scene, plan: Plan) -> Result<Self, EngineError> {
        let backend = &backend.into();
        scene.validate()?;
        check_planned(&plan, scene)?;
        let mut plan = plan;
        let rays = look_around(scene, &mut plan);
        let direct = direct_light(backend, scene, &plan, lamps_of(scene, &plan.lamps))?;
        Self::with_direct(backend, scene, (plan, rays), direct)
    }

    fn with_direct(
        backend: &Backend,
        scene: &Scene,
        (mut plan, rays): (Plan, Option<Arc<Rays>>),
        direct: DirectLight,
    ) -> Result<Self, EngineError> {
        let (planned, given) = ((plan.options.rank, plan.options.ranks), backend.ranks());
        if planned != (given.rank() as u32, given.count() as u32) {
            return Err(EngineError::OtherRanks { planned, given: (given.rank(), given.count()) });
        }
        let (planned, given) = (plan.options.backend, backend.kind());
        if planned != given {
            return Err(EngineError::OtherBackend { planned, given });
        }
        let unit = light_unit(scene);
        let direct = Direct::new(Arc::new(direct), scene, &plan, &[])?;
        let traced = rays.map(|rays| rows::trace(backend.ranks(), &plan, &rays, &light_of(scene, &direct)));
        let ray_error = match traced.transpose()? {
            Some((rows, error)) => {
                plan.keep_rows(rows)?;
                Some(error)
            }
            None => None,
        };
        let mut operators = transport::operators(backend, scene, plan, &direct.emitted(scene), unit)?;
        let first_bounce = direct.first_bounce(scene, operators.plan(), unit);
        operators.set_first_bounce(&first_bounce)?;
        let allocated = operators.allocated();
        for item in operators.plan().memory().own() {
            let row = allocated.iter().find(|row| row.label == item.label);
            let allocated = row.map_or(0, |row| row.bytes);
            if allocated != item.bytes {
                return Err(EngineError::Miscounted {
                    label: item.label.clone(),
                    planned: item.bytes,
                    allocated,
                });
            }
        }
        Ok(Self {
            backend: backend.clone(),
            operators,
            unit,
            direct,
            materials: (0..scene.triangles.len()).map(|i| scene.material(i).clone()).collect(),
            triangles: scene.triangles.iter().map(|t| t.vertices).collect(),
            vertices: scene.vertices.len(),
            movable: Movable::All,
            ray_error,
            revision: Revision::first(),
        })
    }

    /// Replaces the materials by those of `scene`, whose geometry must be that of the plan. Lobes and colours that
    /// were not planned are an error. Earlier solutions become outdated; only [`Engine::solve_from`] accepts them, as
    /// a start.
    ///
    /// # Errors
    /// Fails if the scene is invalid, has other triangles than the plan, or has lobes or colours that were
    /// not planned; and if the backend fails.
    pub fn set_materials(&mut self, scene: &Scene) -> Result<(), EngineError> {
        scene.validate()?;
        self.replace_materials(scene)
    }

    /// Replaces the materials as [`Engine::set_materials`] does, but accepts negative emission and negative irradiance
    /// by suns. Light is linear in both, so that differences of scenes can be solved, too (finite differences, least
    /// squares).
    ///
    /// # Errors
    /// Fails as [`Engine::set_materials`] does, except for negative light.
    #[doc(hidden)]
    pub fn set_linear_materials(&mut self, scene: &Scene) -> Result<(), EngineError> {
        scene.validate_linear()?;
        self.replace_materials(scene)
    }

    fn replace_materials(&mut self, scene: &Scene) -> Result<(), EngineError> {
        check_planned(self.plan(), scene)?;
        let other = self.triangles.iter().zip(&scene.triangles).position(|(own, t)| *own != t.vertices);
        if let Some(triangle) = other {
            return Err(EngineError::OtherGeometry { triangle });
        }
        // First, since a failed transfer may be partial.
        self.revision = self.revision.next();
        self.unit = light_unit(scene);
        let lamps = lamps_of(scene, self.direct.light.lamps());
        let plan = self.operators.plan();
        self.direct = match self.direct.light.relit(&lamps) {
            Some(light) => Direct::new(light, scene, plan, &self.direct.lobes),
            None => Direct::new(Arc::new(direct_light(&self.backend, scene, plan, lamps)?), scene, plan, &[]),
        }?;
        let emitted = self.direct.emitted(scene);
        let first_bounce = self.direct.first_bounce(scene, plan, self.unit);
        self.operators.set_materials(scene, &emitted, self.unit)?;
        self.operators.set_first_bounce(&first_bounce)?;
        self.materials = (0..scene.triangles.len()).map(|i| scene.material(i).clone()).collect();
        Ok(())
    }

    /// An engine for a changed scene, planned anew with the same options and settings. Frees the memory of this one
    /// first, except for held solutions; compiled kernels stay with the device. Where only vertices have moved, direct light is
    /// sampled at the same points of each triangle, so that results are smooth functions of the vertices.
    ///
    /// # Errors
    /// Fails if the scene is invalid or cannot be planned within the memory budget, or if the backend fails.
    #[doc(hidden)]
    pub fn rebuilt(self, scene: &Scene) -> Result<Self, EngineError> {
        let Self { backend, operators, direct, .. } = self;
        let (options, settings) = (operators.plan().options, operators.plan().settings);
        drop(operators);
        let mut plan = Plan::new(scene, &options, &settings)?;
        let rays = look_around(scene, &mut plan);
        let lamps = lamps_of(scene, &plan.lamps);
        let light = direct.light.relit(&lamps).filter(|light| light.receivers() == plan.facets.len());
        // What is explicit looks around anew.
        let moves = |light: &Arc<DirectLight>| !light.is_traced() && !plan.transport.is_explicit();
        let direct = match light.filter(moves) {
            Some(light) => light.moved(&plan.facets)?,
            None => direct_light(&backend, scene, &plan, lamps)?,
        };
        Self::with_direct(&backend, scene, (plan, rays), direct)
    }

    /// Standard error of irradiance by the rays that light goes by, for the materials that the engine was made for; `None` where
    /// visibility is implicit.
    pub fn ray_error(&self) -> Option<&RayError> {
        self.ray_error.as_ref()
    }

    /// The backend that it runs on.
    pub fn backend(&self) -> &Backend {
        &self.backend
    }

    /// The plan that it executes.
    pub fn plan(&self) -> &Plan {
        self.operators.plan()
    }

    /// Solves H = U (E + (K - J) H).
    ///
    /// # Errors
    /// Fails if the parameters are out of range, if the solve diverges or does not converge within
    /// `max_passes`, if a callback stops it, or if the backend fails.
    pub fn solve(&mut self, params: &SolveParams) -> Result<Solution, EngineError> {
        self.solve_with(params, &mut |_, _| ControlFlow::Continue(()))
    }

    /// Solves, and calls `progress` with the number of passes and the relative residual after each pass.
    ///
    /// # Errors
    /// Fails as [`Engine::solve`] does, and if `progress` stops the solve.
    #[doc(hidden)]
    pub fn solve_with(
        &mut self,
        params: &SolveParams,
        progress: &mut SolveProgress,
    ) -> Result<Solution, EngineError> {
        self.solve_from(None, params, progress)
    }

    /// Solves starting from the solution of a similar scene (a few parameters have changed, a vertex has moved),
    /// which takes fewer passes. Starts from zero if the plan of that scene orders triangles differently, or is for the other
    /// backend. The start may come from any engine on the same device, with any materials.
    ///
    /// # Errors
    /// Fails as [`Engine::solve_with`] does.
    pub fn solve_from(
        &mut self,
        start: Option<&Solution>,
        params: &SolveParams,
        progress: &mut SolveProgress,
    ) -> Result<Solution, EngineError> {
        params.check()?;
        let SolveParams { tolerance, max_passes, reduction } = *params;
        let arrangement = Arrangement::of(self.plan());
        let guess = match start.filter(|start| start.arrangement == arrangement) {
            Some(start) => {
                let mut guess = self.operators.vector()?;
                self.operators.combine(start.unit / self.unit, &start.state, 0.0, &mut guess)?;
                Some(guess)
            }
            None => None,
        };
        let solved = match self.plan().solver {
            PlannedSolver::FixedPoint => {
                let params = FixedPointParams { tolerance, max_passes, reduction };
                fixed_point_from(&mut *self.operators, guess, &params, progress)
            }
            PlannedSolver::Gmres { restart } => {
                let params = GmresParams::new(tolerance, max_passes, restart)
                    .rounding(rounding(self.plan().settings.precision))
                    .reduction(reduction);
                gmres_from(&mut *self.operators, guess, &params, progress)
            }
        };
        match solved {
            Ok((state, info)) => self.solution(state, info),
            Err(error) => {
                let best = |state, info| self.solution(state, info).map(|best| Some(Box::new(best)));
                Err(error.map_best(best)?.into())
            }
        }
    }

    /// Converts a state to a solution in scene order, with its energy balance.
    fn solution(&mut self, state: State, info: SolveInfo) -> Result<Solution, EngineError> {
        let indirect = self.scaled(self.unit, &self.operators.irradiance(&state)?);
        let total = |(indirect, direct): (&[f64; 3], &DVec3)| (DVec3::from(*indirect) + *direct).to_array();
        let in_the_open: Vec<[f64; 3]> = indirect.iter().zip(&self.direct.irradiance).map(total).collect();
        let radiosity = self.radiosity(&state, &in_the_open)?;
        let energy = self.energy(&in_the_open, &radiosity);
        let openness = &self.plan().openness;
        let mean = |(i, rgb): (usize, &[f64; 3])| rgb.map(|value| openness.share(i) * value);
        let means = |values: &[[f64; 3]]| -> Vec<[f64; 3]> { values.iter().enumerate().map(mean).collect() };
        let (irradiance, radiosity) = (means(&in_the_open), means(&radiosity));
        let lowest = irradiance.iter().map(|rgb| rgb.iter().copied().fold(f64::INFINITY, f64::min));
        let negative = Negative {
            triangles: lowest.clone().filter(|&h| h < 0.0).count(),
            minimum: lowest.fold(0.0, f64::min),
        };
        let (arrangement, revision, unit) = (Arrangement::of(self.plan()), self.revision, self.unit);
        Ok(Solution {
            irradiance,
            in_the_open,
            radiosity,
            info,
            energy,
            negative,
            state,
            arrangement,
            revision,
            unit,
        })
    }

    /// Checks that a solution belongs to this engine and its current materials.
    #[doc(hidden)]
    pub fn check_own(&self, solution: &Solution) -> Result<(), EngineError> {
        match solution.revision.difference(self.revision) {
            None => Ok(()),
            Some(Difference::Engine) => Err(EngineError::OtherEngine),
            Some(Difference::Materials) => Err(EngineError::OutdatedSolution),
        }
    }

    /// Outgoing radiance of each triangle of the scene towards a point (metres), RGB, W/(m² sr): the operator S. Zero
    /// for triangles that face away from the point.
    ///
    /// # Errors
    /// Fails if the solution belongs to another engine or to other materials, if the position is not finite,
    /// or if the backend fails.
    pub fn face_colours(
        &mut self,
        solution: &Solution,
        camera_position: DVec3,
    ) -> Result<Vec<[f64; 3]>, EngineError> {
        let mut colours = self.colours_without_highlights(solution, camera_position)?;
        for (i, highlight) in self.highlights(camera_position)? {
            colours[i] = (DVec3::from(colours[i]) + highlight).to_array();
        }
        Ok(colours)
    }

    /// Face colours as [`Engine::face_colours`] returns them, W/(m² sr), but without the light of lamps that
    /// triangles reflect specularly.
    #[doc(hidden)]
    pub fn colours_without_highlights(
        &mut self,
        solution: &Solution,
        camera_position: DVec3,
    ) -> Result<Vec<[f64; 3]>, EngineError> {
        self.check_own(solution)?;
        check_position(camera_position)?;
        let colours = self.operators.observe(&solution.state, camera_position)?;
        let mut colours = self.scaled(self.unit, &colours);
        for i in self.lamp_triangles_facing(camera_position) {
            colours[i] = (DVec3::from(colours[i]) + DVec3::from(self.materials[i].emission)).to_array();
        }
        Ok(colours)
    }

    /// Sets a callback within passes. It is called after every submission with the number of pairs done and that of
    /// the whole pass, and may stop the solve, which then ends with [`TransportError::Interrupted`].
    pub fn set_pass_callback(&mut self, callback: Option<PassCallback>) {
        self.operators.set_pass_callback(callback);
    }

    /// Restricts derivatives by positions to those of some vertices, by their indices in the scene: by all others they are zero, and take
    /// little time. `None`, as at first: all vertices.
    #[doc(hidden)]
    pub fn set_movable(&mut self, vertices: Option<&[u32]>) {
        self.movable = Movable::of(self.vertices, vertices, self.triangles.iter().copied());
    }

    /// Values per slot in scene order, multiplied by a factor.
    pub(crate) fn scaled(&self, by: f64, slots: &[[f64; 4]]) -> Vec<[f64; 3]> {
        self.to_scene_order(slots).into_iter().map(|rgb| rgb.map(|value| by * value)).collect()
    }

    pub(crate) fn to_scene_order(&self, slots: &[[f64; 4]]) -> Vec<[f64; 3]> {
        let plan = self.operators.plan();
        let mut values = vec![[0.0; 3]; plan.facets.len()];
        for (&i, &[r, g, b, _]) in plan.layout.order.iter().zip(slots) {
            if i != PADDING {
                values[i as usize] = [r, g, b];
            }
        }
        values
    }

    /// π L_e + δρ E, and of glossy triangles Σ_o c_o L(o).
    fn radiosity(&mut self, state: &State, irradiance: &[[f64; 3]]) -> Result<Vec<[f64; 3]>, EngineError> {
        let mut radiosity: Vec<DVec3> = irradiance
            .iter()
            .zip(&self.materials)
            .map(|(h, m)| exitance(m) + DVec3::from(m.diffuse_albedo()) * DVec3::from(*h))
            .collect();
        let projected = self.plan().bins.projected.clone();
        self.each_specular(state, &mut |i, bins| {
            radiosity[i] += bins.iter().zip(&projected).map(|(rgb, c)| *c * *rgb).sum::<DVec3>();
        })?;
        let valid = |i: usize| self.operators.plan().facets[i].area > 0.0;
        let value = |(i, b): (usize, &DVec3)| if valid(i) { b.to_array() } else { [0.0; 3] };
        Ok(radiosity.iter().enumerate().map(value).collect())
    }

    /// Calls `call` with each glossy triangle of the scene and its specular radiance per bin, W/(m² sr).
    #[doc(hidden)]
    pub fn each_specular(
        &mut self,
        state: &State,
        call: &mut dyn FnMut(usize, &[DVec3]),
    ) -> Result<(), EngineError> {
        if !self.plan().classes.iter().any(|class| class.glossy) {
            return Ok(());
        }
        let specular = self.operators.outgoing(state)?.specular;
        let plan = self.operators.plan();
        let channels = plan.channels as usize;
        for (group, page) in plan.layout.groups.iter().zip(&specular) {
            let lobes = page.iter().flat_map(|page| page.chunks(plan.bins.count() * channels));
            for (slot, lobe) in plan.layout.slots_of(&group.tiles).zip(lobes) {
                let triangle = plan.layout.order[slot as usize];
                if triangle != PADDING {
                    let rgb = |bin: &[f64]| {
                        if channels == 1 { DVec3::splat(bin[0]) } else { DVec3::from_slice(bin) }
                    };
                    let bins: Vec<DVec3> = lobe.chunks(channels).map(|bin| self.unit * rgb(bin)).collect();
                    call(triangle as usize, &bins);
                }
            }
        }
        Ok(())
    }

    fn energy(&self, irradiance: &[[f64; 3]], radiosity: &[[f64; 3]]) -> Energy {
        let plan = self.operators.plan();
        let metres = 1.0 / plan.placement.scale.powi(2);
        let sunlight = self.direct.light.sunlight();
        let [mut emitted, mut absorbed, mut on_backs, mut escaped] = [DVec3::ZERO; 4];
        for (i, facet) in plan.facets.iter().enumerate().filter(|(_, f)| f.area > 0.0) {
            let area = facet.area * metres;
            let sent = DVec3::from(radiosity[i]);
            let reflected = sent - exitance(&self.materials[i]);
            emitted += area * (exitance(&self.materials[i]) + sunlight[i]);
            absorbed += area * plan.openness.share(i) * (DVec3::from(irradiance[i]) - reflected);
            let lost = plan.openness.lost(i);
            on_backs += area * lost.on_backs * sent;
            escaped += area * lost.escaped * sent;
        }
        let rest = emitted - absorbed;
        let (emitted, absorbed) = (emitted.into(), absorbed.into());
        match plan.transport.is_explicit() {
            true => Energy {
                emitted,
                absorbed,
                on_backs: Some(on_backs.into()),
                escaped: escaped.into(),
                unaccounted: (rest - on_backs - escaped).into(),
            },
            false => Energy { emitted, absorbed, escaped: rest.into(), ..Energy::default() },
        }
    }
}

/// Checks that a valid scene fits the plan: the same triangles, and no lobes or colours that were not planned.
fn check_planned(plan: &Plan, scene: &Scene) -> Result<(), EngineError> {
    let (planned, given) = (plan.facets.len(), scene.triangles.len());
    if planned != given {
        return Err(EngineError::OtherScene { planned, given });
    }
    if let Some(triangle) = plan.moved_triangle(scene) {
        return Err(EngineError::OtherGeometry { triangle });
    }
    if let Some(sun) = scene.suns.iter().position(|sun| plan.channels == 1 && !sun.is_grey()) {
        return Err(EngineError::ColouredSun { sun });
    }
    for triangle in 0..given {
        let material = scene.material(triangle);
        if plan.facets[triangle].area > 0.0 && material.is_glossy() && !plan.classes[triangle].glossy {
            return Err(EngineError::BeyondPlan { triangle, why: "has a specular lobe" });
        }
        if plan.channels == 1 && !material.is_grey() {
            return Err(EngineError::BeyondPlan { triangle, why: "has a colour" });
        }
    }
    Ok(())
}

pub(crate) fn check_position(position: DVec3) -> Result<(), EngineError> {
    if position.is_finite() { Ok(()) } else { Err(EngineError::CameraPosition { position }) }
}

/// π L_e, W/m².
fn exitance(material: &Material) -> DVec3 {
    PI * DVec3::from(material.emission)
}
