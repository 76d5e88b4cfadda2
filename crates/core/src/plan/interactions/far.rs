//! Pairs of tiles that exchange light point to point, as runs of partner tiles with the same bits.

use crate::plan::PlanError;
use std::ops::Range;

/// Bits of a run that say what may pass; the rest is its end, one past its last tile.
const PASSING_BITS: u32 = 4;
const PASSING: u32 = (1 << PASSING_BITS) - 1;

/// Runs of each target tile, of receivers or sources, that cover all partner tiles. A run is one word,
/// `end << 4 | passing`, and begins at the end of the one before; ends ascend to the number of tiles. Kernels
/// read the same words (crates/core/glsl/far_push.glsl).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct FarRuns {
    tiles: u32,
    /// The index of the first run of each target in these words, then the end of the last; then all runs.
    words: Vec<u32>,
}

/// The runs of one target under construction.
#[derive(Clone, Debug, Default)]
pub struct Row {
    words: Vec<u32>,
}

impl Row {
    /// Extends the row to `end` (exclusive) with `passing`.
    pub fn extend(&mut self, end: u32, passing: u32) {
        match self.words.last_mut() {
            Some(last) if *last & PASSING == passing => *last = word(end, passing),
            _ => self.words.push(word(end, passing)),
        }
    }
}

fn word(end: u32, passing: u32) -> u32 {
    end << PASSING_BITS | passing
}

impl FarRuns {
    /// Joins the rows of all targets, each of which covers all tiles.
    ///
    /// # Errors
    /// Fails if the runs are more than 32-bit indices can address.
    pub fn new(rows: &[Row]) -> Result<Self, PlanError> {
        let count = rows.len() + 1 + rows.iter().map(|row| row.words.len()).sum::<usize>();
        let mut words = Vec::with_capacity(count);
        let mut begin = rows.len() + 1;
        for row in rows {
            words.push(begin as u32);
            begin += row.words.len();
        }
        if u32::try_from(begin).is_err() {
            return Err(PlanError::TooManyPairs { what: "runs of tiles", count: begin as u64 });
        }
        words.push(begin as u32);
        rows.iter().for_each(|row| words.extend_from_slice(&row.words));
        Ok(Self { tiles: rows.len() as u32, words })
    }

    /// The words that kernels read.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    fn row(&self, target: u32) -> &[u32] {
        let [begin, end] = [target, target + 1].map(|k| self.words[k as usize] as usize);
        &self.words[begin..end]
    }

    /// The runs of a target within a range of partners, with the bits that may pass.
    pub fn of(
        &self,
        target: u32,
        partners: &Range<u32>,
    ) -> impl Iterator<Item = (Range<u32>, u32)> + use<'_> {
        let (mut begin, end) = (partners.start, partners.end);
        let row = self.row(target);
        let first = row.partition_point(|run| run >> PASSING_BITS <= begin);
        row[first..].iter().map_while(move |run| {
            let from = std::mem::replace(&mut begin, (run >> PASSING_BITS).min(end));
            (from < end).then_some((from..begin, run & PASSING))
        })
    }

    /// The bits that may pass between two tiles.
    pub fn get(&self, target: u32, partner: u32) -> u32 {
        self.of(target, &(partner..partner + 1)).next().map_or(0, |(_, passing)| passing)
    }

    /// The partner tiles in a range with any of these bits.
    pub fn passing(
        &self,
        target: u32,
        partners: &Range<u32>,
        bits: u32,
    ) -> impl Iterator<Item = u32> + use<'_> {
        self.of(target, partners).filter(move |(_, passing)| passing & bits != 0).flat_map(|(run, _)| run)
    }

    /// Whether any pair has one of these bits.
    pub fn any(&self, targets: &Range<u32>, partners: &Range<u32>, bits: u32) -> bool {
        targets.clone().any(|target| self.passing(target, partners, bits).next().is_some())
    }

    /// The pairs with targets and partners exchanged.
    ///
    /// # Errors
    /// Fails if the runs are more than 32-bit indices can address.
    pub fn transposed(&self) -> Result<Self, PlanError> {
        let all = 0..self.tiles;
        let mut rows = vec![Row::default(); self.tiles as usize];
        // Where a row differs from the one before, the runs of those partners end.
        for target in 1..self.tiles {
            for partner in self.changes(target, &all) {
                let (tile, passing) = partner;
                rows[tile as usize].extend(target, passing);
            }
        }
        if let Some(last) = self.tiles.checked_sub(1) {
            for (run, passing) in self.of(last, &all) {
                run.for_each(|tile| rows[tile as usize].extend(self.tiles, passing));
            }
        }
        Self::new(&rows)
    }

    /// The partners whose bits differ from those of the previous target, with the previous bits.
    fn changes(&self, target: u32, all: &Range<u32>) -> impl Iterator<Item = (u32, u32)> + use<'_> {
        let mut runs = self.of(target, all);
        let mut run = runs.next();
        let mut before = self.of(target - 1, all);
        let mut old = before.next();
        let mut begin = 0;
        std::iter::from_fn(move || {
            let ((new, now), (last, was)) = (run.clone()?, old.clone()?);
            let piece = begin..new.end.min(last.end);
            begin = piece.end;
            if new.end == begin {
                run = runs.next();
            }
            if last.end == begin {
                old = before.next();
            }
            Some((if now == was { 0..0 } else { piece }, was))
        })
        .flat_map(|(piece, was)| piece.map(move |tile| (tile, was)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn runs(rows: &[&[u32]]) -> FarRuns {
        let row = |states: &&[u32]| {
            let mut row = Row::default();
            states.iter().zip(1..).for_each(|(&state, end)| row.extend(end, state));
            row
        };
        FarRuns::new(&rows.iter().map(row).collect::<Vec<_>>()).expect("few runs")
    }

    fn states(runs: &FarRuns) -> Vec<Vec<u32>> {
        let all = 0..runs.tiles;
        let row = |target| runs.of(target, &all).flat_map(|(run, state)| run.map(move |_| state)).collect();
        all.clone().map(row).collect()
    }

    #[test]
    fn equal_neighbours_are_one_run_and_ranges_cut_runs() {
        let runs = runs(&[&[1, 1, 3, 3], &[0; 4], &[0, 1, 0, 1], &[7; 4]]);
        assert_eq!(
            runs.words(),
            [5, 7, 8, 12, 13, 2 << 4 | 1, 4 << 4 | 3, 4 << 4, 16, 33, 48, 65, 4 << 4 | 7]
        );
        assert_eq!(runs.of(0, &(1..3)).collect::<Vec<_>>(), [(1..2, 1), (2..3, 3)]);
        assert_eq!(runs.of(0, &(1..1)).count(), 0);
        assert_eq!(runs.passing(2, &(0..4), 5).collect::<Vec<_>>(), [1, 3]);
        assert!(runs.any(&(0..2), &(2..4), 2) && !runs.any(&(1..3), &(0..1), 7));
    }

    #[test]
    fn transposing_swaps_targets_and_partners() {
        let rows: [&[u32]; 5] = [&[1, 1, 3, 3, 0], &[0; 5], &[0, 1, 0, 1, 2], &[7; 5], &[7, 7, 3, 0, 0]];
        let list = runs(&rows);
        let turned = list.transposed().expect("few runs");
        for (r, row) in states(&turned).iter().enumerate() {
            assert_eq!(*row, rows.map(|other| other[r]));
        }
        assert_eq!(turned.transposed().expect("few runs"), list);
        assert_eq!(runs(&[]).transposed().expect("no runs"), runs(&[]));
    }
}
