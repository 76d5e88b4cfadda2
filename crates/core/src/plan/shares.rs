//! Shares: the targets that each of several ranks computes, a range of every group with work in proportion to
//! weights.

use super::{Group, PAIR_BACK, PAIR_FRONT, Plan, PlanOptions, PlannedTransport};
use std::ops::Range;

/// Work of a close pair in point-to-point pairs, where it is evaluated and where its weights are kept.
const NEAR_WORK: [u64; 2] = [100, 8];

/// Contiguous ranges of each group, one for each rank. Within a group pairs cost
/// the same, so that nothing has to be known of what those of different classes cost.
#[derive(Clone, Debug, Default)]
pub struct Shares {
    /// Ranges of tiles by group, then by rank.
    groups: Vec<Vec<Range<u32>>>,
}

impl Shares {
    pub(super) fn of(plan: &Plan) -> Self {
        let weights = plan.options.weights.of_all(plan.options.ranks);
        let mut parts_of_class = Parts::new(&weights);
        let groups = &plan.layout.groups;
        let group = |(g, group): (usize, &Group)| {
            if g > 0 && groups[g - 1].class != group.class {
                parts_of_class = Parts::new(&weights);
            }
            let work: Vec<u64> = group.tiles.clone().map(|tile| plan.work_of_tile(tile)).collect();
            let first = group.tiles.start;
            let parts = parts_of_class.next(&work).into_iter();
            parts.map(|part| first + part.start..first + part.end).collect()
        };
        let groups = groups.iter().enumerate().map(group).collect();
        Self { groups }
    }
}

/// Cuts sequences, one after the other, into contiguous ranges with sums about in proportion to weights. The
/// total over all sequences is in proportion, too: what a rank gets too much of one that cannot be cut as
/// wanted, it gets less of the next.
struct Parts {
    /// Sum of the weights of the ranks before each boundary of ranges.
    weights: Vec<u128>,
    /// What the ranks before each boundary have got of the sequences so far.
    got: Vec<i128>,
    /// The sum of these sequences.
    total: i128,
}

impl Parts {
    fn new(weights: &[u32]) -> Self {
        let mut sums = vec![0];
        sums.extend(weights.iter().scan(0, |sum, &weight| {
            *sum += u128::from(weight);
            Some(*sum)
        }));
        Self { got: vec![0; sums.len()], weights: sums, total: 0 }
    }

    fn next(&mut self, work: &[u64]) -> Vec<Range<u32>> {
        let mut sums: Vec<i128> = vec![0];
        // One more for each, so that what has no work is distributed by number.
        sums.extend(work.iter().scan(0, |sum, &work| {
            *sum += i128::from(work) + 1;
            Some(*sum)
        }));
        self.total += sums[work.len()];
        let (total, of_all) = (self.total.unsigned_abs(), self.weights.last().copied().unwrap_or(0).max(1));
        let mut before = 0;
        let cut = |(weight, got): (&u128, &mut i128)| {
            let wanted = (total * weight / of_all) as i128 - *got;
            let above = sums.partition_point(|&sum| sum < wanted).min(work.len());
            let below = above.saturating_sub(1);
            let nearer =
                if wanted.abs_diff(sums[below]) < wanted.abs_diff(sums[above]) { below } else { above };
            before = nearer.max(before);
            *got += sums[before];
            before as u32
        };
        let cuts: Vec<u32> = self.weights.iter().zip(&mut self.got).map(cut).collect();
        cuts.windows(2).map(|cut| cut[0]..cut[1]).collect()
    }
}

impl Plan {
    /// The tiles of a group that this rank computes, and whose bins it holds: all of it where the rank is
    /// alone.
    #[doc(hidden)]
    pub fn own(&self, group: usize) -> Group {
        self.part_of(group, self.options.rank)
    }

    /// The tiles of a group that a rank computes, and whose bins it holds.
    pub(super) fn part_of(&self, group: usize, rank: u32) -> Group {
        let Group { class, .. } = self.layout.groups[group];
        Group { class, tiles: self.shares.groups[group][rank as usize].clone() }
    }

    /// The slots of a group that each rank computes.
    pub(crate) fn slots_by_rank(&self, group: usize) -> Vec<Range<u32>> {
        self.shares.groups[group].iter().map(|tiles| self.layout.slots_of(tiles)).collect()
    }

    /// About how much this rank does of some work that is distributed over all.
    pub(crate) fn own_share(&self, work: u64) -> u64 {
        let PlanOptions { weights, rank, ranks, .. } = self.options;
        weights.share(work, rank, ranks)
    }

    /// Whether this rank computes a slot.
    pub(crate) fn owns(&self, slot: u32) -> bool {
        let tile = slot / self.layout.tile;
        self.shares.groups.iter().any(|group| group[self.options.rank as usize].contains(&tile))
    }

    /// Work of a tile as a receiver, in point-to-point pairs.
    fn work_of_tile(&self, tile: u32) -> u64 {
        let slots = self.layout.slots_of(&(tile..tile + 1));
        if let PlannedTransport::Rays { rays, .. } = self.transport {
            return u64::from(self.layout.tile) * u64::from(rays);
        }
        let pairs = &self.interactions.by_receiver;
        let all = 0..self.layout.tiles();
        let passing = pairs.far.passing(tile, &all, PAIR_FRONT | PAIR_BACK).count() as u64;
        let far = passing * u64::from(self.layout.tile).pow(2);
        let near = pairs.near.offsets[slots.end as usize] - pairs.near.offsets[slots.start as usize];
        far + u64::from(near) * NEAR_WORK[usize::from(self.options.keeps_near_field())]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::RankWeights;
    use antirad_scene::{LoadOptions, Scene};
    use std::path::Path;

    #[test]
    fn parts_cover_everything_once_and_weigh_what_they_should() {
        let work: Vec<u64> = (0..1000).map(|k| (k * 7919) % 101 + if k < 100 { 500 } else { 0 }).collect();
        let total: u64 = work.iter().sum();
        let even = [1, 2, 3, 7, 16].map(|count| vec![1; count]);
        let uneven = [vec![1, 3], vec![3, 1], vec![16, 1, 5], vec![u32::MAX, 1, u32::MAX]];
        for weights in even.into_iter().chain(uneven) {
            let parts = Parts::new(&weights).next(&work);
            assert_eq!(parts.len(), weights.len());
            assert_eq!((parts[0].start, parts[parts.len() - 1].end), (0, 1000));
            assert!(parts.windows(2).all(|pair| pair[0].end == pair[1].start));
            let of_all: u64 = weights.iter().map(|&weight| u64::from(weight)).sum();
            for (part, &weight) in parts.into_iter().zip(&weights) {
                let own: u64 = work[part.start as usize..part.end as usize].iter().sum();
                let wanted = (u128::from(total) * u128::from(weight) / u128::from(of_all)) as u64;
                assert!(own.abs_diff(wanted) < 1500, "{own} of {total}, {weight} of {weights:?}");
            }
        }
        // The same cuts whatever the unit of weights.
        for [some, same] in [[[1, 1, 1], [16, 16, 16]], [[1, 3, 2], [5, 15, 10]]] {
            assert_eq!(Parts::new(&some).next(&work), Parts::new(&same).next(&work), "{some:?}");
        }
        // More parts than pieces: some are empty.
        let few = Parts::new(&[1; 4]).next(&[5, 5]);
        assert_eq!(few.iter().map(|part| part.len()).sum::<usize>(), 2);
        assert_eq!(Parts::new(&[1; 3]).next(&[]), [0..0, 0..0, 0..0]);
        // Sequences of one, which cannot be cut, go to one after the other, by weight.
        for weights in [&[1, 1, 1][..], &[1, 3], &[16, 5, 11, 2]] {
            let mut parts = Parts::new(weights);
            let mut got = vec![0; weights.len()];
            for _ in 0..170 {
                let of = parts.next(&[7]);
                assert_eq!((of[0].start, of[of.len() - 1].end), (0, 1));
                got.iter_mut().zip(of).for_each(|(got, part)| *got += part.len());
            }
            let all: u32 = weights.iter().sum();
            for (&got, &weight) in got.iter().zip(weights) {
                let wanted = 170.0 * f64::from(weight) / f64::from(all);
                assert!((got as f64 - wanted).abs() <= 2.0, "{weights:?}: {got}, {wanted}");
            }
        }
    }

    #[test]
    fn ranks_share_every_group_by_its_pairs() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/cornell_boxes.toml");
        let scene = Scene::load(&path, &LoadOptions::default()).expect("a shipped scene");
        let ranks = 3;
        let plans: Vec<Plan> = (0..ranks)
            .map(|rank| PlanOptions::default().rank(rank).ranks(ranks))
            .map(|options| {
                Plan::new(
                    &scene,
                    &options,
                    &scene.settings.visibility(antirad_scene::VisibilityChoice::Implicit),
                )
                .expect("a plan")
            })
            .collect();
        for (g, group) in plans[0].layout().groups.iter().enumerate() {
            let own: Vec<Range<u32>> = plans.iter().map(|plan| plan.own(g).tiles).collect();
            assert_eq!((own[0].start, own[2].end), (group.tiles.start, group.tiles.end));
            assert!(own[0].end == own[1].start && own[1].end == own[2].start, "{own:?}");
            let work = |tiles: &Range<u32>| tiles.clone().map(|t| plans[0].work_of_tile(t)).sum::<u64>();
            let largest = group.tiles.clone().map(|t| plans[0].work_of_tile(t)).max().unwrap_or(0);
            for own in &own {
                assert!(work(own).abs_diff(work(&group.tiles) / u64::from(ranks)) <= largest, "{own:?}");
            }
        }
    }

    #[test]
    fn weights_are_for_all_ranks() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes/closed_box.toml");
        let scene = Scene::load(&path, &LoadOptions::default()).expect("a shipped scene");
        for weights in [[1, 2, 3].as_slice(), &[1, 0]] {
            let options = PlanOptions::default().ranks(2).weights(RankWeights::new(weights));
            let error = Plan::new(
                &scene,
                &options,
                &scene.settings.visibility(antirad_scene::VisibilityChoice::Implicit),
            )
            .expect_err("other ranks");
            assert!(error.to_string().contains("for 2 processes"), "{error}");
        }
    }
}
