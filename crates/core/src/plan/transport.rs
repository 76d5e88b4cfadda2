//! Clusters or the exact sum.

use super::{ClusterChoice, Group, Interactions, MemoryPlan, Plan, PlanError, Residency, page_tiles};
use crate::model::{Class, LIST};
use antirad_scene::{SolveSettings, Transport};
use std::f64::consts::TAU;
use std::fmt;
use std::sync::Arc;

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
    /// Rays: visibility is explicit.
    Rays {
        /// Standard error of irradiance that they may cause, relative to its mean.
        error: f64,
        /// Rays of a triangle at most, on average over all.
        rays: u32,
        /// Why visibility is explicit.
        why: &'static str,
    },
}

impl PlannedTransport {
    /// Whether visibility is explicit: light goes by rays.
    pub fn is_explicit(self) -> bool {
        matches!(self, Self::Rays { .. })
    }

    /// Rays: as many as the error asks for.
    pub(super) fn by_rays(settings: &SolveSettings, triangles: usize, why: &'static str) -> Self {
        let rays = (ALL_RAYS / triangles.max(1) as f64).max(USUAL_RAYS) * times_as_many(settings);
        let rays = rays.clamp(f64::from(FEWEST_RAYS), f64::from(MOST_RAYS)) as u32;
        Self::Rays { error: error_of_rays(settings), rays, why }
    }

    /// Rays of a triangle at most, on average over all, where visibility is explicit.
    pub fn rays(self) -> Option<u32> {
        match self {
            Self::Rays { rays, .. } => Some(rays),
            _ => None,
        }
    }

    /// The error of irradiance that clusters may cause, relative to its mean, or rays.
    pub fn error(self) -> f64 {
        match self {
            Self::Exact { .. } => 0.0,
            Self::Rays { error, .. } | Self::Hierarchical { error } => error,
        }
    }
}

/// Standard error of irradiance by rays, relative to its mean, that the settings ask for.
fn error_of_rays(settings: &SolveSettings) -> f64 {
    match settings.transport {
        Transport::Hierarchical { error } => error,
        Transport::Auto | Transport::Exact => USUAL_ERROR,
    }
}

/// How many times as many rays as usual an error asks for.
fn times_as_many(settings: &SolveSettings) -> f64 {
    (USUAL_ERROR / error_of_rays(settings)).powi(2)
}

/// About how many rays of a triangle the settings ask for.
pub(super) fn rays_for(settings: &SolveSettings) -> f64 {
    (USUAL_RAYS * times_as_many(settings)).clamp(f64::from(FEWEST_RAYS), f64::from(MOST_RAYS))
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
            Self::Rays { error, rays, why } => {
                write!(f, "explicit visibility, error {error}, at most {rays} rays a triangle: {why}")
            }
        }
    }
}

/// Standard error of irradiance by rays where none is asked for.
const USUAL_ERROR: f64 = 0.005;
/// Rays of a triangle for that, on average over all, and rays of all triangles of small meshes, at most.
const USUAL_RAYS: f64 = 512.0;
const ALL_RAYS: f64 = (1 << 24) as f64;
/// Fewest and most of these averages.
const FEWEST_RAYS: u32 = 64;
const MOST_RAYS: u32 = 1 << 14;
/// Share of all pairs above which clusters do not pay: culling leaves out about half of the pairs, too.
const WORTH: f64 = 0.4;
/// Triangles of the smallest clusters.
const LEAF: u32 = 4;
/// The bins of volumes of each kind, of two, may take one part in so many of the memory budget.
const VOLUME_SHARE: u64 = 16;
/// How often clusters are planned anew for smaller windows on states.
const REFITS: u32 = 4;

impl Plan {
    /// Chooses transport, and solver and residency for it.
    pub(super) fn choose_transport(&mut self, choice: Option<&Arc<ClusterChoice>>) -> Result<(), PlanError> {
        if self.transport.is_explicit() {
            self.cut_for_ranks();
            self.interactions = Interactions::none(&self.layout, self.options.gradients.any())?;
            return self.choose_solver();
        }
        let why = match (self.settings.transport.usual(self.facets.len()), choice) {
            (Transport::Hierarchical { error }, Some(choice)) => match self.with_clusters(choice, error)? {
                Ok(()) => {
                    self.choice = Some(choice.clone());
                    return Ok(());
                }
                Err(why) => why,
            },
            (Transport::Auto, _) => "few triangles",
            _ => "settings",
        };
        self.transport = PlannedTransport::Exact { why };
        self.cut_for_ranks();
        let half_range = 0.5 * self.settings.near_field;
        let (cull, by_source) = (self.options.cull, self.options.gradients.any());
        let Self { layout, facets, classes, .. } = &*self;
        self.interactions = Interactions::new(layout, facets, classes, half_range, cull, by_source)?;
        self.choose_solver()
    }

    /// Plans clusters, or says why they are not worth it.
    fn with_clusters(
        &mut self,
        choice: &ClusterChoice,
        error: f64,
    ) -> Result<Result<(), &'static str>, PlanError> {
        self.list_clusters(choice)?;
        self.transport = PlannedTransport::Hierarchical { error };
        if !self.clusters_pay() {
            return Ok(Err("clusters would save too little"));
        }
        let planned = self.layout.groups.clone();
        let chosen = self.choose_solver().and_then(|()| self.fit_clusters_to_windows(planned, choice));
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

    /// Clusters of the groups as they are now, and their lists.
    fn list_clusters(&mut self, choice: &ClusterChoice) -> Result<(), PlanError> {
        let bin = TAU / self.bins.count() as f64;
        let limits = (LEAF, self.most_volumes(choice));
        let Self { layout, facets, .. } = &*self;
        let by_source = self.options.gradients.any();
        self.interactions = Interactions::hierarchical(layout, facets, choice, limits, bin, by_source)?;
        Ok(())
    }

    /// Fits clusters to windows where states live on the host. The receivers of a window are a group there,
    /// so that there are other clusters, and other lists, for which windows may have to be smaller.
    /// `planned`: groups of the clusters so far.
    fn fit_clusters_to_windows(
        &mut self,
        mut planned: Vec<Group>,
        choice: &ClusterChoice,
    ) -> Result<(), PlanError> {
        for _ in 0..REFITS {
            if self.residency == Residency::Device || self.layout.groups == planned {
                return Ok(());
            }
            self.list_clusters(choice)?;
            planned.clone_from(&self.layout.groups);
            self.memory = MemoryPlan::of(self, self.options.rank);
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

    /// How many volumes fit a buffer and their share of the budget with their bins. `None` where derivatives
    /// are wanted, which go through clusters of one normal alone.
    fn most_volumes(&self, choice: &ClusterChoice) -> Option<usize> {
        let bytes = (self.options.memory_budget / VOLUME_SHARE).min(self.options.max_buffer);
        (!choice.derivatives).then(|| (bytes / self.bin_bytes()) as usize)
    }
}
