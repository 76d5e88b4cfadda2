//! The memory in which states live during a solve, and the pieces in which a pass processes them.

use super::{Group, MemoryPlan, PAIR_BACK, PAIR_FRONT, Plan, PlanError, page_tiles};
use std::ops::Range;

/// The memory in which states live.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Residency {
    /// Buffers of the device, with a page of bins for each group. Of several ranks, each has pages for what
    /// it holds of a group; the bins of the others pass by in a window of the size of a group.
    #[default]
    Device,
    /// Host memory. The device has two windows on it: one to write the bins of some tiles of receivers, one
    /// to read those of some tiles of sources.
    Host {
        /// Tiles of receivers in the window to write.
        receivers: u32,
        /// Tiles of sources in the window to read.
        sources: u32,
    },
}

/// Tiles of one group processed together as sources: all of them, or as many as the window for sources holds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    /// Index of the group.
    pub group: usize,
    /// The class of the group, and those of its tiles.
    pub part: Group,
}

/// Total size of the staging buffers where memory is short; smaller ones cost time in submissions.
const SHORT_STAGING: u64 = 2 << 20;
/// Smallest total size that is planned.
const LEAST_STAGING: u64 = 128 << 10;
/// Staging buffers are two, each a multiple of the rounding of buffer sizes.
const STAGING_STEP: u64 = 512;
/// Matrices of lobes may take one part in so many of the memory beyond the smallest windows.
const MATRIX_SHARE: u64 = 4;

/// Largest window, bytes: it is copied at once, which delays Ctrl-C.
const MOST_WINDOW_BYTES: u64 = 512 << 20;

/// What two ranges have in common; where that is nothing, a range that is empty.
pub fn overlap(a: &Range<u32>, b: &Range<u32>) -> Range<u32> {
    a.start.max(b.start)..a.end.min(b.end)
}

impl Plan {
    /// Tiles with bins: the groups that have some are contiguous, at the end.
    #[doc(hidden)]
    pub fn tiles_with_bins(&self) -> Range<u32> {
        let all = self.layout.tiles();
        let first = self.layout.groups.iter().find(|g| g.class.has_bins()).map_or(all, |g| g.tiles.start);
        first..all
    }

    /// Groups whose incident light is accumulated in one sweep over all sources: all of them, or those of which the window for receivers
    /// holds what each rank computes.
    #[doc(hidden)]
    pub fn sweeps(&self) -> Vec<Range<usize>> {
        let groups = &self.layout.groups;
        let Residency::Host { receivers, .. } = self.residency else {
            return std::iter::once(0..groups.len()).collect();
        };
        let mut sweeps: Vec<Range<usize>> = Vec::new();
        let mut held = vec![0; self.options.ranks as usize];
        for (g, group) in groups.iter().enumerate() {
            // Groups without bins need no window: they join the first sweep.
            let tiles = |slots: &Range<u32>| slots.len() as u32 / self.layout.tile;
            let more: Vec<u32> = match group.class.has_bins() {
                true => self.slots_by_rank(g).iter().map(tiles).collect(),
                false => vec![0; held.len()],
            };
            let fits = held.iter().zip(&more).all(|(held, more)| held + more <= receivers);
            match sweeps.last_mut().filter(|_| fits) {
                Some(last) => {
                    last.end = g + 1;
                    held.iter_mut().zip(more).for_each(|(held, more)| *held += more);
                }
                None => {
                    sweeps.push(g..g + 1);
                    held = more;
                }
            }
        }
        sweeps
    }

    /// Pieces of sources in the order of a sweep.
    #[doc(hidden)]
    pub fn pieces(&self) -> Vec<Piece> {
        let mut pieces = Vec::new();
        for (group, g) in self.layout.groups.iter().enumerate() {
            let step = match self.residency {
                Residency::Host { sources, .. } if g.class.has_bins() => sources,
                _ => u32::MAX,
            };
            pieces.extend(g.parts(step).map(|part| Piece { group, part }));
        }
        pieces
    }

    /// What this rank holds of each, where that is something.
    pub(crate) fn own_pieces(&self) -> impl Iterator<Item = Piece> {
        self.pieces().into_iter().filter_map(|piece| self.own_piece(&piece))
    }

    /// What this rank holds of a piece, if that is something.
    pub(crate) fn own_piece(&self, &Piece { group, ref part }: &Piece) -> Option<Piece> {
        let tiles = overlap(&part.tiles, &self.own(group).tiles);
        (!tiles.is_empty()).then_some(Piece { group, part: Group { tiles, class: part.class } })
    }

    /// Whether light can pass from any of the sources to any of the receivers.
    #[doc(hidden)]
    pub fn anything_passes(&self, receivers: &Range<u32>, sources: &Range<u32>) -> bool {
        let far = &self.interactions.by_receiver.far;
        self.transport.is_explicit() || far.any(receivers, sources, PAIR_FRONT | PAIR_BACK)
    }

    /// Whether the device holds states whole, of which kernels access any part. Otherwise they access one after the other in windows.
    pub(crate) fn states_are_whole(&self) -> bool {
        self.residency == Residency::Device && self.options.ranks == 1
    }

    /// Tiles in the window for specular radiance: of sources, and where states are on the host, of its cotangents, which a pass of the
    /// adjoint accumulates like bins.
    pub(crate) fn specular_window(&self) -> u32 {
        match self.residency {
            Residency::Device => self.largest_group(|group| group.class.glossy),
            Residency::Host { receivers, sources } if self.options.gradients.any() => receivers.max(sources),
            Residency::Host { sources, .. } => sources,
        }
    }

    /// Tiles of the largest of some groups.
    pub(crate) fn largest_group(&self, wanted: impl Fn(&Group) -> bool) -> u32 {
        let groups = self.layout.groups.iter().filter(|group| wanted(group));
        groups.map(|group| group.tiles.len() as u32).max().unwrap_or(0)
    }

    /// Cuts groups to the size of a rank's share where there are several, so that a window takes no more than that.
    pub(super) fn cut_for_ranks(&mut self) {
        if self.options.ranks > 1 {
            let part = (self.tiles_with_bins().len() as u32).div_ceil(self.options.ranks).max(1);
            let page = page_tiles(&self.options, self.tile_bytes());
            // A whole number of dispatches, as on a single rank.
            self.layout.cut(part.next_multiple_of(self.partner_tiles()).min(page));
        }
    }

    /// Largest host memory of the solver's vectors and of cotangents of specular radiance, bytes; of several ranks, of this one.
    #[doc(hidden)]
    pub fn host_bytes(&self) -> u64 {
        if self.residency == Residency::Device {
            return 0;
        }
        let own = |wanted: fn(&Group) -> bool| self.own_pages(wanted).sum::<u64>();
        let states = u64::from(self.vectors()) * (self.irradiance_bytes() + own(|g| g.class.has_bins()));
        let cotangents = if self.options.gradients.any() { 2 } else { 0 };
        states + cotangents * own(|g| g.class.glossy)
    }

    /// Bytes moved between host and device per pass.
    #[doc(hidden)]
    pub fn moved_bytes(&self) -> u64 {
        if self.residency == Residency::Device {
            let own: u64 = self.own_pages(|group| group.class.has_bins()).sum();
            let all = self.state_bytes() - self.irradiance_bytes();
            return if self.states_are_whole() { 0 } else { own + all };
        }
        let bins = |tiles: &Range<u32>| tiles.len() as u64 * self.tile_bytes();
        let pieces = self.pieces();
        let sources = pieces.iter().map(|piece| &piece.part).filter(|part| part.class.has_bins());
        let sources: Vec<&Range<u32>> = sources.map(|part| &part.tiles).collect();
        let shown = |sweep: &Range<usize>| {
            let receivers = &self.layout.groups[sweep.clone()];
            let reached = |s: &&&Range<u32>| receivers.iter().any(|to| self.anything_passes(&to.tiles, s));
            sources.iter().filter(reached).map(|s| bins(s)).sum::<u64>()
        };
        let up: u64 = self.sweeps().iter().map(shown).sum();
        up + self.state_bytes() + self.irradiance_bytes()
    }

    /// Bytes of the bins that a rank holds of each group, 0 of those that are not wanted.
    fn pages(&self, rank: u32, wanted: impl Fn(&Group) -> bool) -> impl Iterator<Item = u64> {
        let held = move |group| self.page_bytes(&self.part_of(group, rank));
        let groups = self.layout.groups.iter().enumerate();
        groups.map(move |(g, group)| if wanted(group) { held(g) } else { 0 })
    }

    /// Bytes of the bins that this rank holds of each group, 0 of those that are not wanted.
    pub(crate) fn own_pages(&self, wanted: impl Fn(&Group) -> bool) -> impl Iterator<Item = u64> {
        self.pages(self.options.rank, wanted)
    }

    /// Bytes of each page that a rank has.
    pub(super) fn held_pages(&self, rank: u32, wanted: impl Fn(&Group) -> bool) -> impl Iterator<Item = u64> {
        self.pages(rank, wanted).filter(|&bytes| bytes > 0)
    }

    fn state_bytes(&self) -> u64 {
        self.irradiance_bytes() + self.tiles_with_bins().len() as u64 * self.tile_bytes()
    }

    /// Bytes of the smaller staging buffers, used where they leave room for another state.
    pub(super) fn short_staging(&self) -> u64 {
        self.options.staging.min(SHORT_STAGING)
    }

    /// Moves all states to the host, with the largest windows on them that the budget allows.
    ///
    /// Windows for receivers matter most: each pass streams all sources past each of them. Larger windows for sources
    /// move no fewer bytes, but split the lists of close sources less often.
    pub(super) fn stream(&mut self) -> Result<(), PlanError> {
        let budget = self.options.memory_budget;
        let matrices = std::mem::take(&mut self.lobes.matrices);
        self.set_windows(1, 1, self.options.staging.min(LEAST_STAGING));
        let (least_staging, needed) = (self.staging, self.memory.total());
        // Matrices make K several times faster, but windows need the memory more.
        let bytes = self.lobe_buffer_bytes(matrices) * (1 + u64::from(self.lobe_gradients()[0]));
        if matrices > 0 && bytes <= budget.saturating_sub(needed) / MATRIX_SHARE {
            self.lobes.matrices = matrices;
        }
        self.set_windows(1, 1, self.staging);
        let needed = self.memory.total();
        self.memory.check_buffers(self.options.max_buffer)?;
        if needed > budget {
            return Err(PlanError::OverBudget { budget, needed });
        }
        // Memory beyond the smallest windows, less what rounding may take.
        let free = budget - needed;
        let more_staging = (free / 16).min(self.short_staging().saturating_sub(least_staging));
        let more_staging = more_staging / STAGING_STEP * STAGING_STEP;
        // A glossy source takes two tiles, of incident and specular radiance, and with gradients whatever is written, too.
        let glossy = self.layout.groups.iter().any(|g| g.class.glossy);
        let (each, all) = match (glossy, self.options.gradients.any()) {
            (false, _) => (1, 1),
            (true, false) => (2, 1),
            (true, true) => (1, 2),
        };
        let tiles = free.saturating_sub(more_staging + 1024) / self.tile_bytes() / all;
        let page = self.options.page.min(self.options.max_buffer);
        let most = |bytes: u64| (bytes / self.tile_bytes()).clamp(1, u64::from(u32::MAX)) as u32;
        let total = (self.tiles_with_bins().len() as u32).max(1);
        let most = most(page.min(MOST_WINDOW_BYTES)).min(total);
        // First the fewest sweeps that leave an eighth for sources, or the sources of a dispatch; then as many
        // sources as fit beside. The sizes are evened out, so that no window at the end is short.
        let dispatch = self.partner_tiles();
        let reserved = (tiles / 8).max((tiles / 2).min(each * u64::from(dispatch)));
        let receivers = u64::from(most).min(1 + tiles - reserved) as u32;
        let receivers = total.div_ceil(total.div_ceil(receivers));
        let left = tiles.saturating_sub(u64::from(receivers - 1)) / each;
        let sources = u64::from(most).min(1 + left) as u32;
        let step = if sources < dispatch { 1 } else { dispatch };
        let sources = sources / step * step;
        let sources = total.div_ceil(total.div_ceil(sources)).next_multiple_of(step).min(sources);
        self.set_windows(receivers, sources, least_staging + more_staging);
        if self.memory.total() > budget {
            self.set_windows(1, 1, least_staging);
        }
        Ok(())
    }

    fn set_windows(&mut self, receivers: u32, sources: u32, staging: u64) {
        self.residency = Residency::Host { receivers, sources };
        self.staging = staging;
        self.layout.cut(receivers);
        self.memory = MemoryPlan::of(self, self.options.rank);
    }
}
