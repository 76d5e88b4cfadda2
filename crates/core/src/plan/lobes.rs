//! Lobes by matrix. In the frame of a triangle ⟨h(b,o),n⟩^p depends on the power p alone, so that triangles that share
//! it share the matrix of all pairs of bins. Other lobes are evaluated directly, pair by pair.

use super::{GradientRequest, PADDING, Plan, TileLayout};
use antirad_scene::Scene;
use std::collections::HashMap;
use std::ops::Range;

/// Rows that a lane sums at a time (crates/core/glsl/lobe_rows.glsl).
pub const LOBE_ROWS: u32 = 16;
/// Bytes of a matrix that a dispatch binds.
pub const LOBE_BYTES: u32 = 1 << 16;
/// Fewest triangles that share a matrix: fewer would leave lanes of a vector idle.
const SHARED: u32 = 8;
/// Largest fraction of the budget for matrices: one in so many.
const BUDGET_SHARE: u64 = 8;
/// Columns of a matrix are padded to a multiple of this, which aligns its blocks of rows in either precision.
const COLUMN_STEP: u64 = 4;

/// How the lobes of a plan are computed.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PlannedLobes {
    /// Number of matrices.
    pub matrices: u32,
    /// Triangles of each power (each material, if powers may change) that is worth a matrix, in descending order.
    worth: Vec<u32>,
    /// Glossy triangles.
    triangles: u32,
}

impl PlannedLobes {
    /// The matrices that a scene is worth.
    pub fn new(scene: &Scene, layout: &TileLayout, request: GradientRequest) -> Self {
        let power = |i: u32| scene.material(i as usize).power.to_bits();
        let material = |i: u32| u64::from(scene.triangles[i as usize].material);
        // Materials of one power may get powers of their own when powers are fitted.
        let sets = if request.power { by_key(layout, material) } else { by_key(layout, power) };
        let of_set = |(_, slots): &(u64, Vec<u32>)| real(layout, slots);
        let counts: Vec<u32> = sets.iter().map(of_set).collect();
        let worth: Vec<u32> = counts.iter().copied().filter(|&count| count >= SHARED).collect();
        Self { matrices: worth.len() as u32, worth, triangles: counts.iter().sum() }
    }

    /// Glossy triangles, and those of them whose lobes come from a matrix.
    pub fn triangles(&self) -> [u32; 2] {
        [self.triangles, self.worth.iter().take(self.matrices as usize).sum()]
    }
}

/// The slots of the glossy triangles by power.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LobeSlots {
    /// Powers with a matrix.
    pub powers: Vec<f64>,
    /// Slots, ascending within each range of `ranges`.
    pub slots: Vec<u32>,
    /// Ranges in `slots`: one for each power with a matrix, then one for all other powers.
    pub ranges: Vec<Range<usize>>,
}

impl LobeSlots {
    /// The entries of range `k` whose slots lie in a page or window.
    pub fn within(&self, k: usize, slots: &Range<u32>) -> Range<u32> {
        let range = self.ranges[k].clone();
        let before = |end: u32| self.slots[range.clone()].partition_point(|&slot| slot < end);
        (range.start + before(slots.start)) as u32..(range.start + before(slots.end)) as u32
    }
}

impl Plan {
    /// The slots of the glossy triangles by the powers of `scene`. The most frequent powers get the matrices.
    pub(crate) fn lobe_slots(&self, scene: &Scene) -> LobeSlots {
        let layout = &self.layout;
        let sets = by_key(layout, |i| scene.material(i as usize).power.to_bits());
        let shared = |(_, slots): &&(u64, Vec<u32>)| real(layout, slots) >= SHARED;
        let shared = sets.iter().take_while(shared).count().min(self.lobes.matrices as usize);
        let (matrices, others) = sets.split_at(shared);
        let mut others: Vec<u32> = others.iter().flat_map(|(_, slots)| slots).copied().collect();
        others.sort_unstable();
        let mut found = LobeSlots::default();
        for slots in matrices.iter().map(|(_, slots)| slots).chain([&others]) {
            let start = found.slots.len();
            found.slots.extend(slots);
            found.ranges.push(start..found.slots.len());
        }
        found.powers = matrices.iter().map(|&(power, _)| f64::from_bits(power)).collect();
        found
    }

    /// Bytes of the matrix of a lobe on the CPU, of all pairs of bins.
    pub(crate) fn lobe_square_bytes(&self) -> u64 {
        (self.bins.count() as u64).pow(2) * self.settings.precision.bytes()
    }

    /// Bytes of a block of rows of a matrix.
    pub(crate) fn lobe_block_bytes(&self) -> u64 {
        let columns = (self.bins.count() as u64).next_multiple_of(COLUMN_STEP);
        columns * u64::from(LOBE_ROWS) * self.settings.precision.bytes()
    }

    /// Blocks of rows of a matrix.
    pub(crate) fn lobe_blocks(&self) -> u32 {
        (self.bins.count() as u32).div_ceil(LOBE_ROWS)
    }

    /// Bytes of a matrix.
    pub(crate) fn lobe_matrix_bytes(&self) -> u64 {
        u64::from(self.lobe_blocks()) * self.lobe_block_bytes()
    }

    /// Bytes of a buffer of matrices, which extends as far past the last as a dispatch binds.
    pub(crate) fn lobe_buffer_bytes(&self, matrices: u32) -> u64 {
        u64::from(matrices) * self.lobe_matrix_bytes() + u64::from(LOBE_BYTES)
    }

    /// Whether the adjoint needs matrices of its own, and whether there are derivatives by powers to be summed.
    pub(crate) fn lobe_gradients(&self) -> [bool; 2] {
        let request = self.options.gradients;
        [request.any(), request.lobes()]
    }

    /// The most matrices that fit their share of the budget and a buffer.
    pub(super) fn affordable_lobes(&self) -> u32 {
        let buffers = 1 + u64::from(self.lobe_gradients()[0]);
        let share = self.options.memory_budget / (BUDGET_SHARE * buffers);
        let most = self.options.max_buffer.min(share);
        let most = most.saturating_sub(u64::from(LOBE_BYTES)) / self.lobe_matrix_bytes();
        u64::from(self.lobes.matrices).min(most) as u32
    }
}

/// The glossy slots by a key of their triangles: sets in descending order of their size, then by key. Padding goes with
/// the triangle before it.
fn by_key(layout: &TileLayout, key: impl Fn(u32) -> u64) -> Vec<(u64, Vec<u32>)> {
    let mut sets: HashMap<u64, Vec<u32>> = HashMap::new();
    let mut last = 0;
    for group in layout.groups.iter().filter(|group| group.class.glossy) {
        for slot in layout.slots_of(&group.tiles) {
            let i = layout.order[slot as usize];
            last = if i == PADDING { last } else { key(i) };
            sets.entry(last).or_default().push(slot);
        }
    }
    let mut sets: Vec<_> = sets.into_iter().collect();
    sets.sort_unstable_by_key(|(key, slots)| (std::cmp::Reverse(real(layout, slots)), *key));
    sets
}

/// How many of the slots hold a triangle.
fn real(layout: &TileLayout, slots: &[u32]) -> u32 {
    slots.iter().filter(|&&slot| layout.order[slot as usize] != PADDING).count() as u32
}
