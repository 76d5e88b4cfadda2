//! Clusters or the exact sum.

use super::{Group, Interactions, MemoryPlan, Plan, PlanError, Residency, page_tiles};
use crate::model::{Class, LIST};
use crate::scene::{Scene, Transport};
use std::f64::consts::TAU;
use std::fmt;

/// Whether clusters stand for far triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PlannedTransport {
    /// The sum over all pairs.
    Exact {
        /// Why there are no clusters.
        why: &'static str,
    },
    /// Clusters.
    Hierarchical {
        /// Error of irradiance that they may cause, relative to its mean.
        error: f64,
    },
}

impl PlannedTransport {
    /// The error of irradiance that clusters may cause, relative to its mean; none if there are none.
    pub fn error(self) -> f64 {
        match self {
            Self::Exact { .. } => 0.0,
            Self::Hierarchical { error } => error,
        }
    }
}

impl Default for PlannedTransport {
    fn default() -> Self {
        Self::Exact { why: "settings" }
    }
}

impl fmt::Display for PlannedTransport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Exact { why } => write!(f, "exact: {why}"),
            Self::Hierarchical { error } => write!(f, "clusters, error {error}"),
        }
    }
}

/// Share of all pairs above which clusters do not pay: culling leaves out about half of the pairs, too.
const WORTH: f64 = 0.4;
/// Triangles of the smallest clusters.
const LEAF: u32 = 4;
/// The bins of volumes of each kind, of two, may take one part in so many of the memory budget.
const VOLUME_SHARE: u64 = 16;
/// How often clusters are planned anew for smaller windows on states.
const REFITS: u32 = 4;
/// Largest brightness of a source, relative to the mean.
const BRIGHTEST: f64 = 1e4;
/// Brightness of backs under diffuse light, relative to the mean.
const BACKS: f64 = 2.0;
/// The same under the light of an emitter, relative to the emitter: bins spread it out.
const NARROW: f64 = 0.25;
/// Factor on the error of each cluster where derivatives by vertices are wanted: what depends on how neighbours differ errs more than light.
const OF_VERTICES: f64 = 0.1;
/// Factor on the error of each cluster where light comes from emitters straight to clusters, and is uneven there.
const UNEVEN: f64 = 0.3;

impl Plan {
    /// Chooses transport, and solver and residency for it.
    pub(super) fn choose_transport(&mut self, scene: &Scene) -> Result<(), PlanError> {
        let error = match self.settings.transport {
            Transport::Exact => Err("settings"),
            Transport::Auto if self.triangles() < Transport::FEWEST => Err("few triangles"),
            Transport::Auto => Err("no error is allowed for"),
            Transport::Hierarchical { error } => Ok(error),
        };
        let why = match error {
            Err(why) => why,
            Ok(error) => match self.with_clusters(scene, error)? {
                Ok(()) => return Ok(()),
                Err(why) => why,
            },
        };
        self.transport = PlannedTransport::Exact { why };
        let half_range = 0.5 * self.settings.near_field;
        let (cull, by_source) = (self.options.cull, self.options.gradients.any());
        let Self { layout, facets, classes, .. } = &*self;
        self.interactions = Interactions::new(layout, facets, classes, half_range, cull, by_source)?;
        self.choose_solver()
    }

    /// Plans clusters, or says why they are not worth it.
    fn with_clusters(&mut self, scene: &Scene, error: f64) -> Result<Result<(), &'static str>, PlanError> {
        let brightness = self.brightness(scene);
        let uneven = brightness.iter().any(|&bright| bright > 1.0);
        let each = if uneven { UNEVEN * error } else { error };
        let each = if self.options.gradients.geometry() { OF_VERTICES * each } else { each };
        self.list_clusters(&brightness, each)?;
        self.transport = PlannedTransport::Hierarchical { error };
        if !self.clusters_pay() {
            return Ok(Err("clusters would save too little"));
        }
        let planned = self.layout.groups.clone();
        let chosen =
            self.choose_solver().and_then(|()| self.fit_clusters_to_windows(planned, &brightness, each));
        let why = match chosen {
            Ok(()) if self.clusters_pay() => return Ok(Ok(())),
            Ok(()) | Err(PlanError::OverBudget { .. }) => "clusters do not fit the memory budget",
            Err(PlanError::BufferTooLarge { .. }) => {
                "the lists of clusters do not fit a buffer of the device"
            }
            Err(other) => return Err(other),
        };
        self.residency = Residency::Device;
        self.layout.cut(page_tiles(&self.options, self.tile_bytes()));
        Ok(Err(why))
    }

    /// Whether lists are short enough.
    fn clusters_pay(&self) -> bool {
        let triangles = self.triangles() as f64;
        let entries = self.clusters().map_or(0, |clusters| clusters.sources().count());
        entries as f64 * f64::from(LIST) <= WORTH * triangles * triangles
    }

    /// Clusters of the groups as they are now, and their lists; `error`: of each.
    fn list_clusters(&mut self, brightness: &[f64], error: f64) -> Result<(), PlanError> {
        let half_range = 0.5 * self.settings.near_field;
        let bin = TAU / self.bins.count() as f64;
        let lists = (self.options.cull, self.options.gradients.any());
        let backs = brightness.iter().fold(BACKS, |most, &bright| most.max(NARROW * bright));
        let (limits, lit) = ((LEAF, self.most_volumes(), error), (brightness, backs, bin));
        let Self { layout, facets, classes, .. } = &*self;
        self.interactions =
            Interactions::hierarchical(layout, facets, classes, half_range, lists, limits, lit)?;
        Ok(())
    }

    /// Where states live on the host, those of a window are a group, so that there are other clusters, and other lists, for which windows
    /// may have to be smaller. `planned`: groups of the clusters so far.
    fn fit_clusters_to_windows(
        &mut self,
        mut planned: Vec<Group>,
        brightness: &[f64],
        error: f64,
    ) -> Result<(), PlanError> {
        for _ in 0..REFITS {
            if self.residency == Residency::Device || self.layout.groups == planned {
                return Ok(());
            }
            self.list_clusters(brightness, error)?;
            planned.clone_from(&self.layout.groups);
            self.memory = MemoryPlan::of(self);
            if self.memory.total() <= self.options.memory_budget {
                return self.memory.check_buffers(self.options.max_buffer);
            }
            self.stream()?;
        }
        Err(PlanError::OverBudget { budget: self.options.memory_budget, needed: self.memory.total() })
    }

    /// Bytes of the bins of the clusters of a group, the most that one of some classes has: those of one group are held at a time.
    pub(crate) fn cluster_page_bytes(&self, wanted: fn(&Class) -> bool) -> u64 {
        if self.clusters().is_none() {
            return 0;
        }
        let groups = self.layout.groups.iter().filter(|group| wanted(&group.class));
        let largest = groups.map(|group| self.layout.slots_of(&group.tiles).len() as u64).max();
        // Every cut of a tree adds a branch.
        largest.map_or(0, |slots| 2 * slots / u64::from(LEAF) - 1) * self.bin_bytes()
    }

    /// How many volumes fit a buffer and their part of the budget with their bins. None where derivatives are wanted, which go through
    /// clusters of one normal alone.
    fn most_volumes(&self) -> Option<usize> {
        let bytes = (self.options.memory_budget / VOLUME_SHARE).min(self.options.max_buffer);
        (!self.options.gradients.any()).then(|| (bytes / self.bin_bytes()) as usize)
    }

    /// Brightness of the fronts, relative to the mean: 1, and more where light is emitted into U.
    fn brightness(&self, scene: &Scene) -> Vec<f64> {
        let emitted = |i: usize| scene.material(i).emission.into_iter().fold(0.0, |m: f64, e| m.max(e.abs()));
        let (mut flux, mut area) = (0.0, 0.0);
        for (i, facet) in self.facets.iter().enumerate() {
            flux += facet.area * emitted(i);
            area += facet.area;
        }
        let mean = if area > 0.0 { flux / area } else { 0.0 };
        let relative = |i: usize| if mean > 0.0 { (1.0 + emitted(i) / mean).min(BRIGHTEST) } else { 1.0 };
        let mut brightness: Vec<f64> = (0..self.facets.len()).map(relative).collect();
        // Direct light of lamps does not pass through U.
        self.lamps.iter().flat_map(|lamp| &lamp.triangles).for_each(|&i| brightness[i as usize] = 1.0);
        brightness
    }
}
