//! Which of several ranks computes the bins of which clusters.

use crate::model::{ClusterRun, Clusters};
use crate::plan::Plan;
use std::ops::Range;

/// The clusters of a group by the rank that computes their bins.
pub struct BinShares {
    /// Clusters whose triangles all belong to one rank, which computes their bins: index ranges by rank and
    /// height.
    pub by_rank: Vec<Vec<Range<u32>>>,
    /// All other clusters: index ranges by height. Every rank computes their bins from those in `by_rank`.
    pub by_all: Vec<Vec<Range<u32>>>,
}

impl BinShares {
    pub fn of(plan: &Plan, group: usize, clusters: &Clusters, run: &ClusterRun) -> Self {
        if plan.options.ranks == 1 {
            let by_all = run.heights.iter().map(|of| vec![of.clone()]).collect();
            return Self { by_rank: Vec::new(), by_all };
        }
        let slots = plan.slots_by_rank(group);
        let by_rank: Vec<_> = slots.iter().map(|slots| clusters.within(run, slots)).collect();
        let others = |(height, of): (usize, &Range<u32>)| {
            // Shares follow one another.
            let begins = std::iter::once(of.start).chain(by_rank.iter().map(|shares| shares[height].end));
            let ends = by_rank.iter().map(|shares| shares[height].start).chain([of.end]);
            begins.zip(ends).map(|(begin, end)| begin..end).filter(|left| !left.is_empty()).collect()
        };
        let by_all = run.heights.iter().enumerate().map(others).collect();
        Self { by_rank, by_all }
    }
}
