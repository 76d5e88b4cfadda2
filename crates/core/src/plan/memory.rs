//! Memory by label, computed before allocation. The engine checks that it allocates exactly this.

use super::near_matrix::NearMatrixBytes;
use super::{NearMatrix, PairLists, Plan, PlanError, Residency};
use crate::model::Bins;
use antirad_scene::{BackendKind, Precision};

/// Every buffer's size is rounded up to a multiple of this.
const ROUNDING: u64 = 256;
/// Reals of one triangle in the arrays of the same name (crates/core/glsl/geometry.glsl, crates/core/glsl/surface.glsl).
pub(super) const FACET: u64 = 8;
const CORNERS: u64 = 12;
const SURFACE: u64 = 12;
pub(super) const RGB: u64 = 4;
/// Reals of a gradient (crates/core/glsl/facet_gradient.glsl).
const FACET_GRADIENT: u64 = 16;
/// Lanes of the kernel that sums vectors: enough for any device, few enough for the host to add up.
pub const PARTIAL_SUMS: u64 = 4096;
/// Two slices of partial sums, and the coefficients of a step of GMRES with the norm of what they leave.
pub const ALL_SUMS: u64 = 2 * PARTIAL_SUMS + super::LONGEST_RESTART as u64 + 1;

/// Pairs of a point and a lamp whose rays are traced at a time.
pub const LAMP_PAIRS: u64 = 1 << 17;
/// Bytes of the staging buffers for them.
pub const LAMP_STAGING: u64 = 4 << 20;
/// Reals of a box, of a triangle that blocks or emits, and of what is known of a pair or found of it; bytes of a node and of a pair
/// (crates/core/glsl/lamp_rays.comp).
const BOX: u64 = 8;
const FLAT: u64 = 12;
const PAIR: u64 = 8;
const NODE_BYTES: u64 = 16;
const PAIR_BYTES: u64 = 16;

/// Labels of memory that is counted here and allocated elsewhere.
const STAGING: &str = "staging";
const PICTURES: &str = "pictures";
const LAMP_RAYS: &str = "lamp rays";

/// One kind of buffer.
#[derive(Clone, Debug, PartialEq, Eq, serde::Serialize)]
pub struct MemoryItem {
    /// Label of the buffers in errors, reports and debuggers.
    pub label: String,
    /// Bytes of all buffers of this label together.
    pub bytes: u64,
    /// Number of buffers.
    pub count: u32,
    /// Bytes of the largest of them.
    #[serde(skip)]
    largest: u64,
}

/// All device memory of an engine.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MemoryPlan {
    /// One item per label.
    pub items: Vec<MemoryItem>,
}

/// Bytes of the bins of one triangle.
pub(super) fn bin_bytes(bins: &Bins, channels: u32, precision: Precision) -> u64 {
    bins.count() as u64 * u64::from(channels) * precision.bytes()
}

impl Plan {
    /// Bytes of the buffers of the kernel of rays to lamps: [`lamp_rays_room`].
    pub(crate) fn lamp_rays_room(&self) -> [u64; 9] {
        let emitters = self.lamps.iter().map(|lamp| lamp.triangles().len()).sum();
        lamp_rays_room(self.settings.precision, self.facets.len(), emitters, self.lamps.len())
    }
}

/// Bytes of the buffers of the kernel of rays to lamps, in the order of its bindings, for a scene of so many triangles and lamps of so many
/// triangles together. Blockers have no more triangles than the scene, but for those that fill up a leaf, and a tree over leaves of four less
/// than half as many nodes.
pub fn lamp_rays_room(precision: Precision, triangles: usize, emitters: usize, lamps: usize) -> [u64; 9] {
    let real = precision.bytes();
    let [triangles, emitters, lamps] = [triangles + 4, emitters, lamps].map(|count| count as u64);
    [
        triangles / 2 * BOX * real,
        triangles / 2 * NODE_BYTES,
        triangles * FLAT * real,
        (lamps + 1) * 4,
        emitters * FLAT * real,
        emitters * 4,
        LAMP_PAIRS * PAIR * real,
        LAMP_PAIRS * PAIR_BYTES,
        LAMP_PAIRS * PAIR * real,
    ]
}

impl MemoryPlan {
    /// The memory of the engine of a rank, by label.
    pub(super) fn of(plan: &Plan, rank: u32) -> Self {
        let real = plan.settings.precision.bytes();
        let slots = u64::from(plan.layout.slots());
        let mut memory = Self::default();
        let padded = slots + u64::from(plan.partner_padding());
        memory.add("facets", padded * FACET * real, 1);
        memory.add("corners", slots * CORNERS * real, 1);
        memory.add("surfaces", slots * SURFACE * real, 1);
        memory.add("radiance", plan.radiance_bytes(), 1);
        memory.add("bin table", plan.bins.count() as u64 * RGB * real, 1);
        memory.add_states(plan, rank);
        for (_, group) in plan.glossy_groups().filter(|_| plan.has_first_bounce()) {
            memory.add("first bounce", plan.page_bytes(group), 1);
        }
        memory.add_lobes(plan);
        memory.add_gradients(plan, slots, rank);
        for matrix in plan.near_field_matrix().into_iter().flat_map(NearMatrix::matrices) {
            let NearMatrixBytes { starts, rows, columns, weights } = plan.near_matrix_bytes(matrix);
            memory.add("near matrix: starts", starts, 1);
            memory.add("near matrix: rows", rows, 1);
            memory.add("near matrix: columns", columns, 1);
            memory.add("near matrix: weights", weights, 1);
        }
        if plan.options.backend == BackendKind::Vulkan {
            memory.add_for_kernels(plan, slots);
        }
        if plan.options.pictures > 0 {
            memory.add(PICTURES, plan.options.pictures, 1);
        }
        if plan.traces_lamps() {
            plan.lamp_rays_room().into_iter().for_each(|bytes| memory.add(LAMP_RAYS, bytes, 1));
            memory.add(LAMP_RAYS, LAMP_STAGING, 1);
        }
        memory
    }

    /// What Vulkan kernels need beside that: lists of pairs, which the CPU reads where the plan has them, and room for results in transfer.
    fn add_for_kernels(&mut self, plan: &Plan, slots: u64) {
        let real = plan.settings.precision.bytes();
        let bytes = |words: &[u32]| size_of_val(words) as u64;
        let PairLists { far, near } = &plan.interactions.by_receiver;
        self.add("far runs", bytes(far.words()), 1);
        self.add("near offsets", bytes(&near.offsets), 1);
        self.add("near sources", bytes(&near.partners), 1);
        self.add("near targets", slots * 4, 1);
        if let Some(PairLists { far, near }) = &plan.interactions.by_source {
            self.add("far runs, by source", bytes(far.words()), 1);
            self.add("near offsets, by source", bytes(&near.offsets), 1);
            self.add("near receivers", bytes(&near.partners), 1);
            let padded = slots + u64::from(plan.partner_padding());
            self.add("cotangent: receivers", padded * plan.rgb_bytes(), 1);
        }
        let glossy: usize = plan.glossy_groups().map(|(_, g)| plan.layout.slots_of(&g.tiles).len()).sum();
        if glossy > 0 {
            self.add("lobe slots", glossy as u64 * 4, 1);
        }
        self.add("face colours", slots * plan.rgb_bytes(), 1);
        self.add("partial sums", ALL_SUMS * real, 1);
        self.add("no bins", real, 1);
        // Two buffers, no larger than others.
        let most = (plan.options.max_buffer / ROUNDING * ROUNDING).saturating_mul(2);
        self.add(STAGING, plan.staging.min(most), 1);
    }

    /// Vectors of the solver, the windows on them, and the specular radiance.
    fn add_states(&mut self, plan: &Plan, rank: u32) {
        let bins = |tiles: u32| u64::from(tiles) * plan.tile_bytes();
        match plan.residency {
            Residency::Device => {
                self.add("state: irradiance", plan.irradiance_bytes(), plan.vectors());
                let pages = plan.held_pages(rank, |group| group.class.has_bins());
                pages.for_each(|bytes| self.add("state: bins", bytes, plan.vectors()));
                let largest = plan.largest_group(|group| group.class.has_bins());
                if !plan.states_are_whole() && largest > 0 {
                    self.add("state: bins", bins(largest), 1);
                }
            }
            Residency::Host { receivers, sources } => {
                self.add("state: irradiance", plan.irradiance_bytes(), 2);
                if !plan.tiles_with_bins().is_empty() {
                    self.add("state: bins", bins(receivers), 1);
                    self.add("state: bins", bins(sources), 1);
                }
            }
        }
        if plan.states_are_whole() {
            let pages = plan.held_pages(rank, |group| group.class.glossy);
            pages.for_each(|bytes| self.add("specular radiance", bytes, 1));
        } else if plan.glossy_groups().next().is_some() {
            self.add("specular radiance", bins(plan.specular_window()), 1);
        }
    }

    /// The order of glossy triangles, and the matrices that they share.
    fn add_lobes(&mut self, plan: &Plan) {
        let matrices = plan.lobes.matrices;
        if plan.options.backend == BackendKind::Cpu {
            // Symmetric, so that the adjoint reads the same.
            self.add_if_any("lobe matrices", u64::from(matrices) * plan.lobe_square_bytes());
            if plan.glossy_groups().next().is_some() {
                self.add("lobe logarithms", plan.lobe_square_bytes(), 1);
            }
            return;
        }
        if matrices > 0 {
            let [gradients, of_powers] = plan.lobe_gradients();
            self.add("lobe matrices", plan.lobe_buffer_bytes(matrices), 1 + u32::from(gradients));
            if of_powers {
                self.add("lobe logarithms", plan.lobe_buffer_bytes(1), 1);
            }
        }
    }

    /// What [`crate::Engine::backward`] needs beyond a solve: the solution's vector, the cotangents of the loss, and
    /// the sums of gradients.
    fn add_gradients(&mut self, plan: &Plan, slots: u64, rank: u32) {
        let (request, real) = (plan.options.gradients, plan.settings.precision.bytes());
        if plan.interactions.by_source.is_none() {
            return;
        }
        let rgb = slots * plan.rgb_bytes();
        let cpu = plan.options.backend == BackendKind::Cpu;
        self.add("cotangent: irradiance", rgb, 1);
        self.add("cotangent: radiance", rgb, 1 + u32::from(cpu));
        if plan.residency == Residency::Device {
            // Those that kernels accumulate in a pass are in the pages of specular radiance, if there are such.
            let count = if plan.states_are_whole() && !cpu { 1 } else { 2 };
            let pages = plan.held_pages(rank, |group| group.class.glossy);
            pages.for_each(|bytes| self.add("cotangent: specular", bytes, count));
        }
        if request.geometry() {
            self.add("facet gradients", slots * FACET_GRADIENT * real, 1);
        }
        if request.lobes() && plan.classes.iter().any(|class| class.glossy) {
            self.add("lobe sums", 2 * rgb, 1);
        }
    }

    fn add_if_any(&mut self, label: &str, bytes: u64) {
        if bytes > 0 {
            self.add(label, bytes, 1);
        }
    }

    fn add(&mut self, label: &str, bytes: u64, count: u32) {
        let bytes = bytes.max(1).next_multiple_of(ROUNDING);
        let total = bytes * u64::from(count);
        match self.items.iter_mut().find(|item| item.label == label) {
            Some(item) => {
                item.bytes += total;
                item.count += count;
                item.largest = item.largest.max(bytes);
            }
            None => {
                self.items.push(MemoryItem { label: label.to_owned(), bytes: total, count, largest: bytes })
            }
        }
    }

    /// Total bytes.
    pub fn total(&self) -> u64 {
        self.items.iter().map(|item| item.bytes).sum()
    }

    /// Bytes of all buffers of a label; 0 if there is none.
    pub fn of_label(&self, label: &str) -> u64 {
        self.items.iter().find(|item| item.label == label).map_or(0, |item| item.bytes)
    }

    /// Bytes of both staging buffers.
    pub fn staging(&self) -> u64 {
        self.of_label(STAGING)
    }

    /// The items that the engine allocates itself.
    pub fn own(&self) -> impl Iterator<Item = &MemoryItem> {
        let elsewhere = [STAGING, PICTURES, LAMP_RAYS];
        self.items.iter().filter(move |item| !elsewhere.contains(&item.label.as_str()))
    }

    pub(super) fn check_buffers(&self, limit: u64) -> Result<(), PlanError> {
        match self.own().max_by_key(|item| item.largest) {
            Some(item) if item.largest > limit => {
                Err(PlanError::BufferTooLarge { label: item.label.clone(), bytes: item.largest, limit })
            }
            _ => Ok(()),
        }
    }
}
