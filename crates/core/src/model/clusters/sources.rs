//! Lists of sources by group of receivers.

use std::ops::Range;

/// Bits of an entry that say what may pass; the rest is its index.
pub const ENTRY_BITS: u32 = 3;

/// For each group of receivers the indices of its sources, ascending, as `index << 3 | bits`. Kernels read the same
/// words (crates/core/glsl/far_list.glsl).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SourceLists {
    lists: u32,
    /// For each list the index of its first entry in these words, then the end of the last; then all entries.
    words: Vec<u32>,
}

impl SourceLists {
    /// Packs the entries of all lists into words; `None` if there are too many to count.
    pub fn new(lists: &[Vec<u32>]) -> Option<Self> {
        let head = lists.len() + 1;
        let count = head + lists.iter().map(Vec::len).sum::<usize>();
        u32::try_from(count).ok()?;
        let mut words = Vec::with_capacity(count);
        let mut begin = head as u32;
        for list in lists {
            words.push(begin);
            begin += list.len() as u32;
        }
        words.push(begin);
        lists.iter().for_each(|list| words.extend_from_slice(list));
        Some(Self { lists: lists.len() as u32, words })
    }

    /// The words that kernels read.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Number of entries of all lists.
    pub fn count(&self) -> u64 {
        self.words.len() as u64 - u64::from(self.lists) - 1
    }

    /// Number of lists.
    pub fn lists(&self) -> u32 {
        self.lists
    }

    /// The entries of a list whose indices are in a range.
    pub fn of(&self, list: u32, indices: &Range<u32>) -> &[u32] {
        let [begin, end] = [list, list + 1].map(|k| self.words[k as usize] as usize);
        let all = &self.words[begin..end];
        let before = |bound: u32| all.partition_point(|entry| entry >> ENTRY_BITS < bound);
        &all[before(indices.start)..before(indices.end)]
    }

    /// The sources of a list: index and what may pass.
    pub fn sources(&self, list: u32) -> impl Iterator<Item = (u32, u32)> + use<'_> {
        let bits = (1 << ENTRY_BITS) - 1;
        self.of(list, &(0..u32::MAX)).iter().map(move |entry| (entry >> ENTRY_BITS, entry & bits))
    }
}
