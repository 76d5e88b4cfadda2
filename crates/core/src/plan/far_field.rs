//! Whether what passes between far triangles is kept from pass to pass.

use super::{Group, MemoryPlan, Plan};
use crate::model::LIST;
use antirad_scene::BackendKind;

/// Most of the memory budget that an engine may take with what is kept, as one of so many parts.
const SHARE: u64 = 4;
/// Bytes of the entry of a source in a block of receivers, which has one for each that it may send light to.
const SOURCE_BYTES: u64 = 16;
/// Reals of the bins that a pair takes light from, or brings it to: two weights, and the place of four bins.
const TAP: u64 = 3;

impl Plan {
    /// Decides whether far pairs are kept. Everything else has been planned. They are what most of a pass of the CPU is spent on; kernels of
    /// GPUs evaluate them faster than they would read them.
    pub(super) fn choose_far_field(&mut self) {
        let options = &self.options;
        let few_bins = self.bins.count() <= usize::from(u16::MAX);
        let wanted = options.keep_near_field && options.backend == BackendKind::Cpu && options.ranks == 1;
        if !wanted || !few_bins || self.transport.is_explicit() {
            return;
        }
        self.keeps_far = true;
        let memory = MemoryPlan::of(self, options.rank);
        match self.kept_far_bytes().is_some() && memory.total() <= options.memory_budget / SHARE {
            true => self.memory = memory,
            false => self.keeps_far = false,
        }
    }

    /// Most bytes of the far pairs that are kept: those of which a triangle has bins. `None` where none are.
    pub(crate) fn kept_far_bytes(&self) -> Option<u64> {
        let real = self.settings.precision.bytes();
        let mut bytes = 0;
        for to in self.layout.groups.iter().filter(|_| self.keeps_far) {
            for from in &self.layout.groups {
                let ends = [to, from].map(|group| u64::from(group.class.has_bins()));
                if ends != [0; 2] {
                    let pair = real * (1 + TAP * (ends[0] + ends[1]));
                    let [pairs, entries] = self.far_pairs_of(to, from);
                    bytes += pairs * pair + entries * SOURCE_BYTES;
                }
            }
        }
        Some(bytes).filter(|bytes| *bytes > 0)
    }

    /// Far pairs of triangles of two groups, and how often a source is among those of [`LIST`] receivers.
    fn far_pairs_of(&self, to: &Group, from: &Group) -> [u64; 2] {
        let entries = match self.clusters() {
            Some(clusters) => {
                let [receivers, sources] = [to, from].map(|group| self.layout.slots_of(&group.tiles));
                let lists = receivers.start / LIST..receivers.end / LIST;
                lists.map(|list| clusters.sources().of(list, &sources).len() as u64).sum()
            }
            None => {
                let far = &self.interactions.by_receiver.far;
                let sources = |tile: u32| {
                    let passing = far.of(tile, &from.tiles).filter(|(_, passing)| *passing != 0);
                    passing.map(|(run, _)| run.len() as u64).sum::<u64>() * u64::from(self.layout.tile)
                };
                u64::from(self.layout.tile / LIST) * to.tiles.clone().map(sources).sum::<u64>()
            }
        };
        [entries * u64::from(LIST), entries]
    }
}
