//! Lists of receivers by group of sources: the lists of sources, transposed.

use super::sources::{ENTRY_BITS, SourceLists};
use std::ops::Range;

/// Neighbouring sources that share a list of receivers.
pub const SOURCES: u32 = 8;

/// For each group of [`SOURCES`] sources, triangles or clusters of one class, the lists that contain any of them, ascending,
/// each as two words: its number, and what may pass from each source, [`ENTRY_BITS`] bits of each. Kernels read the same
/// words (crates/core/glsl/receiver_list.glsl).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReceiverLists {
    /// Sources whose groups follow one another, with their first group.
    runs: Vec<(Range<u32>, u32)>,
    /// For each group the index of its first word in these words, then the end of the last; then all entries.
    words: Vec<u32>,
}

impl ReceiverLists {
    /// `runs`: all sources, in ascending order; no group contains sources of two runs. `None` if there are too many entries to
    /// count.
    pub fn new(lists: &SourceLists, runs: impl Iterator<Item = Range<u32>>) -> Option<Self> {
        let mut count = 0;
        let runs: Vec<(Range<u32>, u32)> = runs
            .map(|run| {
                let first = count;
                count += (run.len() as u32).div_ceil(SOURCES);
                (run, first)
            })
            .collect();
        let mut words = vec![0; count as usize + 1];
        let mut total = u64::from(count) + 1;
        for_each_entry(lists, &runs, |group, _, _| {
            words[group as usize + 1] += 2;
            total += 2;
        });
        u32::try_from(total).ok()?;
        words[0] = count + 1;
        for group in 0..count as usize {
            words[group + 1] += words[group];
        }
        let mut next = words.clone();
        words.resize(total as usize, 0);
        for_each_entry(lists, &runs, |group, list, bits| {
            let at = &mut next[group as usize];
            words[*at as usize..*at as usize + 2].copy_from_slice(&[list, bits]);
            *at += 2;
        });
        Some(Self { runs, words })
    }

    /// The words that kernels read.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// The groups of the sources of a run, or of a part of it that begins with a group.
    pub fn groups(&self, sources: &Range<u32>) -> Range<u32> {
        let run = self.runs.iter().find(|(run, _)| run.contains(&sources.start));
        run.map_or(0..0, |(run, first)| {
            let begin = first + (sources.start - run.start) / SOURCES;
            begin..begin + (sources.len() as u32).div_ceil(SOURCES)
        })
    }

    /// Number of entries of all groups.
    pub fn entries(&self) -> u64 {
        (self.words.len() as u64 - u64::from(self.words[0])) / 2
    }

    /// The entries of a group whose lists are in a range: list, and what may pass.
    pub fn of(&self, group: u32, lists: &Range<u32>) -> &[[u32; 2]] {
        let [begin, end] = [group, group + 1].map(|k| self.words[k as usize] as usize);
        let (entries, _) = self.words[begin..end].as_chunks::<2>();
        let before = |bound: u32| entries.partition_point(|[list, _]| *list < bound);
        &entries[before(lists.start)..before(lists.end)]
    }

    /// Number of entries of a group whose lists are in a range.
    pub fn count(&self, group: u32, lists: &Range<u32>) -> u32 {
        self.of(group, lists).len() as u32
    }
}

/// Visits the entries of all groups, those of each in ascending order: group, list, and the bits of its sources.
fn for_each_entry(lists: &SourceLists, runs: &[(Range<u32>, u32)], mut visit: impl FnMut(u32, u32, u32)) {
    for list in 0..lists.lists() {
        let (mut runs, mut run) = (runs.iter(), None);
        let mut open: Option<(u32, u32)> = None;
        for (source, passing) in lists.sources(list) {
            while run.is_none_or(|(of, _): &(Range<u32>, u32)| source >= of.end) {
                run = runs.next();
                if run.is_none() {
                    break;
                }
            }
            let Some((of, first)) = run else { break };
            let at = source - of.start;
            let (group, bits) = (first + at / SOURCES, passing << (ENTRY_BITS * (at % SOURCES)));
            open = match open {
                Some((same, sum)) if same == group => Some((group, sum | bits)),
                other => {
                    other.into_iter().for_each(|(group, bits)| visit(group, list, bits));
                    Some((group, bits))
                }
            };
        }
        open.into_iter().for_each(|(group, bits)| visit(group, list, bits));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_source_of_a_list_finds_the_list() {
        // Slots 0 to 15, then two runs of clusters, of 3 and 9.
        let runs = [0..16, 16..19, 19..28];
        let lists = [vec![0, 3, 9, 16, 18, 27], vec![], vec![3, 15, 19, 20, 27]];
        let passing = |source: u32| source % 7 + 1;
        let entries: Vec<Vec<u32>> = lists
            .iter()
            .map(|list: &Vec<u32>| list.iter().map(|s| s << ENTRY_BITS | passing(*s)).collect())
            .collect();
        let sources = SourceLists::new(&entries).expect("few");
        let turned = ReceiverLists::new(&sources, runs.iter().cloned()).expect("few");
        assert_eq!(turned.groups(&(8..16)), 1..2);
        assert_eq!(turned.groups(&(19..28)), 3..5);
        let mut found = vec![Vec::new(); lists.len()];
        for run in runs {
            for (group, first) in turned.groups(&run).zip(run.clone().step_by(SOURCES as usize)) {
                let [begin, end] = [group, group + 1].map(|k| turned.words()[k as usize] as usize);
                let (entries, rest) = turned.words()[begin..end].as_chunks::<2>();
                assert!(rest.is_empty());
                assert_eq!(turned.count(group, &(0..3)), entries.len() as u32);
                for &[list, bits] in entries {
                    for k in 0..SOURCES {
                        let of = bits >> (ENTRY_BITS * k) & ((1 << ENTRY_BITS) - 1);
                        if of != 0 {
                            assert_eq!(of, passing(first + k));
                            found[list as usize].push(first + k);
                        }
                    }
                }
            }
        }
        found.iter_mut().for_each(|list| list.sort_unstable());
        assert_eq!(found, lists);
    }
}
