//! Planning, before any device is used: the class and order of triangles, the tiles that exchange light, and the
//! memory and pairs that a solve takes. Pure host code.

mod error;
mod gradient_request;
mod interactions;
mod lamps;
mod lobes;
mod memory;
mod near_matrix;
mod report;
mod residency;
mod shares;
mod tiles;
mod transport;
mod weights;

pub use crate::model::PADDING;
pub use error::PlanError;
pub use gradient_request::GradientRequest;
pub use interactions::{FarRuns, Interactions, NearPairs, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, PairLists};
pub use lamps::LampsReport;
pub use lamps::direct_lamps;
pub use lobes::{LOBE_BYTES, LOBE_ROWS, LobeSlots, PlannedLobes};
pub use memory::{ALL_SUMS, LAMP_PAIRS, LAMP_STAGING, PARTIAL_SUMS, lamp_rays_room};
pub use memory::{MemoryItem, MemoryPlan};
pub use near_matrix::{
    Block, IncidentPart, NO_ROW, NearField, NearMatrix, OutgoingPart, SLICE, SlicedMatrix, Weights,
};
pub(crate) use near_matrix::{Blocks, Geometry, Row, Rows, Sums};
pub use report::{ClassReport, LobeReport, PairReport, PlanReport, StatesReport};
pub use residency::overlap;
pub use residency::{Piece, Residency};
pub use shares::Shares;
pub use tiles::{Group, TileLayout};
pub use transport::PlannedTransport;
pub use weights::RankWeights;

use crate::direct::{Lamp, Openness, Visibility};
use crate::model::{Bins, Class, Facet, classify, spatial_order};
use antirad_base::setters;
use antirad_scene::{BackendKind, Precision, Scene, SolveSettings, SolverChoice, Sun, bounds};
use glam::DVec3;
use lamps::Chosen;
use std::sync::Arc;

/// Bytes of the facets of partners that a dispatch binds.
pub(crate) const PARTNER_BYTES: u32 = 1 << 16;

/// Limits of a device, and choices that change the work but not the result.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct PlanOptions {
    /// Bytes that all buffers together may take.
    pub memory_budget: u64,
    /// Largest buffer that a kernel can bind, bytes.
    #[doc(hidden)]
    pub max_buffer: u64,
    /// Bytes of staging buffers for transfers; the plan uses fewer where memory is short.
    #[doc(hidden)]
    pub staging: u64,
    /// Bytes of the budget to reserve for pictures.
    #[doc(hidden)]
    pub pictures: u64,
    /// Triangles per tile: 32 or 64.
    #[doc(hidden)]
    pub tile: u32,
    /// Largest page of state, bytes; at most `max_buffer`.
    #[doc(hidden)]
    pub page: u64,
    /// Whether to omit pairs of tiles that cannot exchange light.
    #[doc(hidden)]
    pub cull: bool,
    /// Which triangles block light.
    pub occlusion: Occlusion,
    /// Kinds of derivatives to plan for.
    pub gradients: GradientRequest,
    /// Whether to keep the near field as a matrix where the memory suffices: it takes as long as one pass, and saves
    /// most of the near field of all others.
    #[doc(hidden)]
    pub keep_near_field: bool,
    /// Whether kernels evaluate the near field in a hundredth of that time, so that it is kept for derivatives alone: those are asked for
    /// many times of one plan.
    #[doc(hidden)]
    pub fast_near_field: bool,
    /// The backend that executes the plan.
    pub backend: BackendKind,
    /// Whether its kernels trace rays to lamps: direct light then comes by rays, unless stated otherwise or differentiated by positions.
    #[doc(hidden)]
    pub trace_lamps: bool,
    /// Number of this process among those that solve the scene together, from 0.
    pub rank: u32,
    /// How many processes solve the scene together: each computes its share of every pass.
    pub ranks: u32,
    /// How much of the work each of them does.
    #[doc(hidden)]
    pub weights: RankWeights,
}

setters!(PlanOptions {
    memory_budget: u64,
    #[doc(hidden)]
    max_buffer: u64,
    #[doc(hidden)]
    staging: u64,
    #[doc(hidden)]
    pictures: u64,
    #[doc(hidden)]
    tile: u32,
    #[doc(hidden)]
    page: u64,
    #[doc(hidden)]
    cull: bool,
    occlusion: Occlusion,
    gradients: GradientRequest,
    #[doc(hidden)]
    keep_near_field: bool,
    #[doc(hidden)]
    fast_near_field: bool,
    backend: BackendKind,
    #[doc(hidden)]
    trace_lamps: bool,
    rank: u32,
    ranks: u32,
    #[doc(hidden)]
    weights: RankWeights,
});

/// Which triangles block light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Occlusion {
    /// Triangles behind which another could receive the light that they block.
    #[default]
    Exact,
    /// No triangle: light passes through everything. Only useful to show the effect of occlusion; suns are left out.
    Nothing,
    /// All triangles, whether it matters or not: the same result with the most work, to measure its cost.
    Everything,
}

impl PlanOptions {
    /// Without limits of memory: for plans that are inspected and never run.
    #[doc(hidden)]
    pub fn boundless(self) -> Self {
        Self { memory_budget: u64::MAX, max_buffer: u64::MAX, keep_near_field: false, ..self }
    }
}

impl PlanOptions {
    /// Whether the near field is to be kept as a matrix.
    pub(crate) fn keeps_near_field(&self) -> bool {
        self.keep_near_field && (!self.fast_near_field || self.gradients.any())
    }

    /// The options of lavapipe, the Vulkan driver for CPUs: a heap of 2 GiB, 128 MiB per storage buffer.
    #[doc(hidden)]
    pub fn lavapipe() -> Self {
        Self {
            memory_budget: 2 << 30,
            max_buffer: 128 << 20,
            staging: 16 << 20,
            backend: BackendKind::Vulkan,
            ..Self::default()
        }
    }
}

impl Default for PlanOptions {
    /// The CPU with 4 GiB.
    fn default() -> Self {
        Self {
            memory_budget: 4 << 30,
            max_buffer: u64::MAX,
            staging: 0,
            pictures: 0,
            tile: 64,
            page: 128 << 20,
            cull: true,
            occlusion: Occlusion::Exact,
            gradients: GradientRequest::NOTHING,
            keep_near_field: true,
            fast_near_field: false,
            backend: BackendKind::Cpu,
            trace_lamps: false,
            rank: 0,
            ranks: 1,
            weights: RankWeights::EVEN,
        }
    }
}

/// The map to the engine's coordinates: x_engine = (x - centre) · scale, so that the scene lies within the unit ball
/// and f32 is as accurate for a scene in millimetres far from the origin as for any other. Irradiance does not depend
/// on the scale.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Metres.
    pub centre: DVec3,
    /// 1/m.
    pub scale: f64,
}

impl Placement {
    /// Centres the box around the vertices in use at the origin.
    pub fn of(scene: &Scene) -> Self {
        let used = scene.triangles.iter().flat_map(|t| t.vertices).map(|v| scene.vertices[v as usize]);
        let (min, max) = bounds(used);
        let radius = 0.5 * (max - min).length();
        Self { centre: 0.5 * (min + max), scale: if radius > 0.0 { 1.0 / radius } else { 1.0 } }
    }

    /// Maps a point in metres to the engine's coordinates.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        (point - self.centre) * self.scale
    }

    /// Maps a point in the engine's coordinates to metres.
    pub fn metres(&self, point: DVec3) -> DVec3 {
        point / self.scale + self.centre
    }

    /// The triangles of a scene, in the engine's coordinates.
    #[doc(hidden)]
    pub fn facets(&self, scene: &Scene) -> Arc<[Facet]> {
        let placed = |i: usize| Facet::new(scene.corners(i).map(|c| self.apply(c)));
        (0..scene.triangles.len()).map(placed).collect()
    }
}

/// Rough albedo of the scene, of the brightest channel.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reflectance {
    /// Mean over area.
    mean: f64,
    most: f64,
}

impl Reflectance {
    fn of(scene: &Scene) -> Self {
        // That of a lobe is taken as σ: its integral would take longer than the plan.
        let albedo = |m: &antirad_scene::Material| {
            let channels = m.diffuse_albedo().into_iter().zip(m.specular);
            channels.map(|(diffuse, sigma)| diffuse + sigma).fold(0.0, f64::max).min(0.99)
        };
        let (mut reflecting, mut all, mut most) = (0.0, 0.0, 0.0_f64);
        for i in 0..scene.triangles.len() {
            let (area, albedo) = (scene.area_vector(i).length(), albedo(scene.material(i)));
            reflecting += area * albedo;
            all += area;
            most = if area > 0.0 { most.max(albedo) } else { most };
        }
        Self { mean: if all > 0.0 { reflecting / all } else { 0.0 }, most }
    }
}

/// The solver to run, and its length of basis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PlannedSolver {
    /// Fixed-point iteration, one bounce per pass.
    FixedPoint,
    /// Restarted GMRES.
    Gmres {
        /// Length of the Krylov basis.
        restart: u32,
    },
}

impl PlannedSolver {
    /// Number of states that it needs.
    #[doc(hidden)]
    pub fn vectors(self) -> u32 {
        match self {
            Self::FixedPoint => 2,
            // Its basis, the right-hand side and the iterate: `solve::gmres_scratch`.
            Self::Gmres { restart } => restart + 2,
        }
    }
}

/// The longest Krylov basis worth its memory: rooms need 10 to 14 passes for 1e-4.
pub(crate) const LONGEST_RESTART: u32 = 16;
/// The shortest one that is still faster than the fixed point.
const SHORTEST_RESTART: u32 = 4;

/// Triangles per tile that kernels support.
const TILES: [u32; 2] = [32, 64];

/// The smallest relative residual that a precision resolves.
fn least_tolerance(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1e-7,
        Precision::F64 => 0.0,
    }
}

/// All decisions that the engine follows.
#[derive(Clone, Debug)]
pub struct Plan {
    /// The options it follows.
    pub(crate) options: PlanOptions,
    /// The settings it follows.
    pub(crate) settings: SolveSettings,
    /// The bins of a hemisphere.
    pub(crate) bins: Bins,
    /// 3, or 1 for a scene without colour.
    pub(crate) channels: u32,
    /// Triangles in the engine's coordinates; index = triangle of the scene.
    pub(crate) facets: Arc<[Facet]>,
    /// From the scene's coordinates to the engine's.
    pub(crate) placement: Placement,
    /// Classes; index = triangle of the scene.
    pub(crate) classes: Vec<Class>,
    /// Emitters whose direct light is exact; that of others takes part in U. All suns.
    pub(crate) lamps: Vec<Lamp>,
    pub(crate) visibility: Visibility,
    /// How many lamps there are, exact or not.
    pub(crate) emitters: usize,
    /// The order of triangles.
    pub(crate) layout: TileLayout,
    pub(crate) interactions: Interactions,
    pub(crate) transport: PlannedTransport,
    pub(crate) lobes: PlannedLobes,
    pub(crate) solver: PlannedSolver,
    pub(crate) residency: Residency,
    pub(crate) near_field: NearField,
    /// How open the parts of triangles lie, where visibility is explicit: it weights what they receive. An engine looks.
    pub(crate) openness: Arc<Openness>,
    pub(crate) shares: Shares,
    /// Bytes that the staging buffers are to have, where the device has buffers as large.
    staging: u64,
    memory: MemoryPlan,
    reflectance: Reflectance,
}

impl Plan {
    /// Plans a solve of a scene, which is checked first.
    ///
    /// # Errors
    /// Fails if the scene, the settings or the options are invalid, or if the plan fits neither the memory
    /// budget nor 32-bit indices.
    pub fn new(scene: &Scene, options: &PlanOptions, settings: &SolveSettings) -> Result<Self, PlanError> {
        match Self::with(scene, options, settings) {
            // Hierarchies that kernels trace rays through may not fit where the others do: those of a CPU do.
            Err(
                PlanError::OverBudget { .. }
                | PlanError::TooManyRays { .. }
                | PlanError::BufferTooLarge { .. },
            ) if options.trace_lamps => Self::with(scene, &options.trace_lamps(false), settings),
            plan => plan,
        }
    }

    fn with(scene: &Scene, options: &PlanOptions, settings: &SolveSettings) -> Result<Self, PlanError> {
        scene.validate()?;
        settings.check()?;
        if !TILES.contains(&options.tile) {
            return Err(PlanError::Tile(options.tile));
        }
        if options.rank >= options.ranks {
            return Err(PlanError::Rank { rank: options.rank, ranks: options.ranks });
        }
        if !options.weights.serve(options.ranks) {
            return Err(PlanError::Weights { weights: options.weights, ranks: options.ranks });
        }
        let (wanted, precision) = (settings.tolerance, settings.precision);
        let least = least_tolerance(precision);
        if wanted < least {
            return Err(PlanError::Tolerance { wanted, least, precision });
        }
        let placement = Placement::of(scene);
        let facets = placement.facets(scene);
        let mut classes = classify(scene);
        let transport = PlannedTransport::of(settings, options, facets.len())?;
        let explicit = transport.is_explicit();
        let Chosen { lamps, visibility, emitters } = match options.occlusion {
            Occlusion::Nothing => Chosen::default(),
            _ => lamps::choose(scene, &facets, settings),
        };
        if visibility != Visibility::Exact && (options.gradients.positions || options.gradients.camera) {
            return Err(PlanError::SampledLamps);
        }
        match options.occlusion {
            Occlusion::Exact => {}
            Occlusion::Nothing => classes.iter_mut().for_each(|class| class.blocker = false),
            Occlusion::Everything => {
                classes.iter_mut().zip(&facets[..]).for_each(|(class, f)| class.blocker = f.area > 0.0);
            }
        }
        if explicit {
            classes.iter_mut().for_each(|class| class.blocker = false);
        }
        let bins = Bins::new(settings.bins);
        // A loss may have colour in a scene without.
        let channels = if is_grey(scene) && !options.gradients.any() { 1 } else { 3 };

        let order = spatial_order(&facets);
        if order.is_empty() {
            return Err(PlanError::NothingToSolve);
        }
        let tile_bytes = u64::from(options.tile) * memory::bin_bytes(&bins, channels, settings.precision);
        let layout = TileLayout::new(&order, &classes, options.tile, page_tiles(options, tile_bytes));

        let lobes = PlannedLobes::new(scene, &layout, options.gradients);
        let mut plan = Self {
            options: *options,
            settings: *settings,
            bins,
            channels,
            facets,
            placement,
            classes,
            lamps,
            visibility,
            emitters,
            layout,
            interactions: Interactions::default(),
            transport,
            lobes,
            solver: PlannedSolver::FixedPoint,
            residency: Residency::Device,
            near_field: NearField::default(),
            openness: Arc::default(),
            shares: Shares::default(),
            staging: options.staging,
            memory: MemoryPlan::default(),
            reflectance: Reflectance::of(scene),
        };
        plan.lobes.matrices = plan.affordable_lobes();
        plan.choose_pairs()?;
        plan.choose_solver().map_err(|error| match error {
            PlanError::OverBudget { budget, needed } if explicit => PlanError::TooManyRays { budget, needed },
            error => error,
        })?;
        if plan.residency != Residency::Device {
            // Windows have cut groups anew.
            plan.shares = Shares::of(&plan);
        }
        plan.choose_near_field()?;
        Ok(plan)
    }

    /// Finds the pairs that exchange light: none where it goes by rays.
    fn choose_pairs(&mut self) -> Result<(), PlanError> {
        self.cut_for_ranks();
        let by_source = self.options.gradients.any();
        let Self { layout, facets, classes, settings, options, .. } = &*self;
        let half_range = 0.5 * settings.near_field;
        self.interactions = match self.transport {
            PlannedTransport::Rays { .. } => Interactions::none(layout, by_source)?,
            PlannedTransport::AllPairs => {
                Interactions::new(layout, facets, classes, half_range, options.cull, by_source)?
            }
        };
        Ok(())
    }

    /// Chooses the longest basis that fits the budget, or the fixed point; if neither fits, states on the host, or an
    /// error with the number of bytes required.
    fn choose_solver(&mut self) -> Result<(), PlanError> {
        let wanted: Vec<PlannedSolver> = {
            let bases = |shortest: u32| {
                (shortest..=LONGEST_RESTART).rev().map(|restart| PlannedSolver::Gmres { restart })
            };
            match self.settings.solver {
                SolverChoice::FixedPoint => vec![PlannedSolver::FixedPoint],
                SolverChoice::Gmres => bases(1).collect(),
                SolverChoice::Auto => bases(SHORTEST_RESTART).chain([PlannedSolver::FixedPoint]).collect(),
            }
        };
        self.shares = Shares::of(self);
        // The solver has what rows of rays leave.
        self.expect_rays();
        let matrices = self.lobes.matrices;
        // Matrices take a small share of the budget: only where nothing else fits are there none.
        for matrices in [matrices, 0] {
            self.lobes.matrices = matrices;
            for &solver in &wanted {
                self.solver = solver;
                for staging in [self.options.staging, self.short_staging()] {
                    self.staging = staging;
                    if self.fits()? {
                        return Ok(());
                    }
                }
            }
        }
        if self.options.backend == BackendKind::Cpu {
            // Its memory is the host's: there is nowhere else to put vectors.
            let needed = self.memory.total();
            return Err(PlanError::OverBudget { budget: self.options.memory_budget, needed });
        }
        // Vectors on the host take no device memory, so the solver is that of an unlimited budget, and the result
        // does not depend on the budget.
        self.solver = wanted.first().copied().unwrap_or(PlannedSolver::FixedPoint);
        self.lobes.matrices = matrices;
        self.stream()
    }

    /// Plans the memory of this rank, and tells whether that of every rank fits the budget: all decide alike.
    fn fits(&mut self) -> Result<bool, PlanError> {
        let mut fits = true;
        for rank in 0..self.options.ranks {
            let memory = MemoryPlan::of(self, rank);
            memory.check_buffers(self.options.max_buffer)?;
            fits = fits && memory.total() <= self.options.memory_budget;
            if rank == self.options.rank {
                self.memory = memory;
            }
        }
        Ok(fits)
    }

    /// Which pairs exchange light.
    #[doc(hidden)]
    pub fn interactions(&self) -> &Interactions {
        &self.interactions
    }

    /// Whether light passes between all pairs, or by rays.
    #[doc(hidden)]
    pub fn transport(&self) -> PlannedTransport {
        self.transport
    }

    /// The options that the plan was made with.
    pub fn options(&self) -> &PlanOptions {
        &self.options
    }

    /// The settings of the solve.
    pub fn settings(&self) -> &SolveSettings {
        &self.settings
    }

    /// The direction bins of triangles that have some.
    #[doc(hidden)]
    pub fn bins(&self) -> &Bins {
        &self.bins
    }

    /// 3, or 1 for a scene without colour.
    #[doc(hidden)]
    pub fn channels(&self) -> u32 {
        self.channels
    }

    /// Triangles in the engine's coordinates; index = triangle of the scene.
    #[doc(hidden)]
    pub fn facets(&self) -> &[Facet] {
        &self.facets
    }

    /// How open the parts of triangles lie: those of all equally, unless visibility is explicit and this is the plan of an engine.
    #[doc(hidden)]
    pub fn openness(&self) -> &Arc<Openness> {
        &self.openness
    }

    /// The map from metres to the engine's coordinates.
    #[doc(hidden)]
    pub fn placement(&self) -> Placement {
        self.placement
    }

    /// Number of lamps, exact or not.
    #[doc(hidden)]
    pub fn emitters(&self) -> usize {
        self.emitters
    }

    /// Classes; index = triangle of the scene.
    #[doc(hidden)]
    pub fn classes(&self) -> &[Class] {
        &self.classes
    }

    /// The emitters whose direct light is computed separately, with [`Self::visibility`]. That of all others
    /// goes through U.
    #[doc(hidden)]
    pub fn lamps(&self) -> &[Lamp] {
        &self.lamps
    }

    /// How much of these lamps points see.
    #[doc(hidden)]
    pub fn visibility(&self) -> Visibility {
        self.visibility
    }

    /// The order of the triangles, their tiles and groups.
    #[doc(hidden)]
    pub fn layout(&self) -> &TileLayout {
        &self.layout
    }

    /// The solver chosen for the budget.
    #[doc(hidden)]
    pub fn solver(&self) -> PlannedSolver {
        self.solver
    }

    /// Whether the near field is kept, and why not.
    #[doc(hidden)]
    pub fn near_field(&self) -> &NearField {
        &self.near_field
    }

    /// The memory in which states live, and the size of the windows on it.
    #[doc(hidden)]
    pub fn residency(&self) -> Residency {
        self.residency
    }

    /// Bytes of both staging buffers.
    #[doc(hidden)]
    pub fn staging(&self) -> u64 {
        self.memory.staging()
    }

    /// The first triangle of the scene whose position differs from the plan's.
    pub(crate) fn moved_triangle(&self, scene: &Scene) -> Option<usize> {
        let moved =
            |(i, facet): (usize, &Facet)| scene.corners(i).map(|c| self.placement.apply(c)) != facet.corners;
        self.facets.iter().enumerate().position(moved)
    }

    /// Bytes by label.
    pub fn memory(&self) -> &MemoryPlan {
        &self.memory
    }

    /// Number of states: those of the solver and, if gradients are planned, the solution, which is held during the
    /// adjoint solve.
    #[doc(hidden)]
    pub fn vectors(&self) -> u32 {
        self.solver.vectors() + u32::from(self.options.gradients.any())
    }

    /// Bytes of one page of bins.
    #[doc(hidden)]
    pub fn page_bytes(&self, group: &Group) -> u64 {
        self.layout.slots_of(&group.tiles).len() as u64 * self.bin_bytes()
    }

    /// Bytes of the bins of one triangle.
    #[doc(hidden)]
    pub fn bin_bytes(&self) -> u64 {
        memory::bin_bytes(&self.bins, self.channels, self.settings.precision)
    }

    /// Bytes of the bins of one tile.
    #[doc(hidden)]
    pub fn tile_bytes(&self) -> u64 {
        u64::from(self.layout.tile) * self.bin_bytes()
    }

    /// Bytes of the irradiance of a state.
    #[doc(hidden)]
    pub fn irradiance_bytes(&self) -> u64 {
        u64::from(self.layout.slots()) * self.rgb_bytes()
    }

    /// Bytes of a `Facet` of crates/core/glsl/geometry.glsl.
    pub(crate) fn facet_bytes(&self) -> u64 {
        memory::FACET * self.settings.precision.bytes()
    }

    /// Slots of partners that a dispatch binds (crates/core/glsl/partners.glsl); buffers bound in this way extend as many slots
    /// past the last. Sums go to memory after each dispatch, so the number is constant to keep them independent of
    /// how the work is divided.
    ///
    /// Few enough for lavapipe, which silently leaves every loop of an invocation after 65535 iterations of all its
    /// loops together: 64 partners take at most 1 + 8 + 64 · 20 of them, even without unrolling.
    pub(crate) fn partner_slots(&self) -> u32 {
        PARTNER_BYTES / self.facet_bytes() as u32
    }

    /// Slots past the last of what dispatches bind; the CPU reads no further than to the last.
    pub(crate) fn partner_padding(&self) -> u32 {
        if self.options.backend == BackendKind::Vulkan { self.partner_slots() } else { 0 }
    }

    /// [`Self::partner_slots`] in tiles.
    pub(crate) fn partner_tiles(&self) -> u32 {
        self.partner_slots() / self.layout.tile
    }

    /// Bytes of one vec4 of reals.
    pub(crate) fn rgb_bytes(&self) -> u64 {
        memory::RGB * self.settings.precision.bytes()
    }

    /// Bytes of the diffuse radiance of all slots, and of what dispatches bind past the last.
    pub(crate) fn radiance_bytes(&self) -> u64 {
        u64::from(self.layout.slots() + self.partner_padding()) * self.rgb_bytes()
    }

    /// Whether glossy triangles reflect the light of lamps that does not take part in U.
    pub(crate) fn has_first_bounce(&self) -> bool {
        !self.lamps.is_empty() && self.glossy_groups().next().is_some()
    }

    /// The groups of glossy triangles, with their indices.
    pub(crate) fn glossy_groups(&self) -> impl Iterator<Item = (usize, &Group)> {
        self.layout.groups.iter().enumerate().filter(|(_, group)| group.class.glossy)
    }

    /// Number of triangles with an area.
    pub fn triangles(&self) -> usize {
        self.layout.order.iter().filter(|&&i| i != PADDING).count()
    }
}

/// Tiles whose bins fit one page.
fn page_tiles(options: &PlanOptions, tile_bytes: u64) -> u32 {
    let page = options.page.min(options.max_buffer);
    (page / tile_bytes).max(1).min(u64::from(u32::MAX)) as u32
}

fn is_grey(scene: &Scene) -> bool {
    (0..scene.triangles.len()).all(|i| scene.material(i).is_grey()) && scene.suns.iter().all(Sun::is_grey)
}
