//! The blocks of the near-field matrix: each connects one array of outgoing light with one of incident light.

use crate::plan::TileLayout;

/// An array of incident light: what rows are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum IncidentPart {
    /// Irradiance, by slot.
    Irradiance,
    /// The bins of a group, by triangle and bin.
    Bins {
        /// Index of the group.
        group: usize,
    },
}

/// An array of outgoing light: what columns are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OutgoingPart {
    /// Diffuse radiance of the fronts, by slot.
    Diffuse,
    /// Antiradiance of the backs of a group: its bins.
    Antiradiance {
        /// Index of the group.
        group: usize,
    },
    /// Specular radiance of the fronts of a group, by triangle and bin.
    Specular {
        /// Index of the group.
        group: usize,
    },
}

/// Numbers blocks, rows and columns.
pub struct Blocks {
    bins: u32,
    /// First slot of each group.
    first: Vec<u32>,
}

impl Blocks {
    pub fn new(layout: &TileLayout, bins: usize) -> Self {
        let first = layout.groups.iter().map(|group| layout.slots_of(&group.tiles).start).collect();
        Self { bins: bins as u32, first }
    }

    /// Index of the group of a slot.
    pub fn group_of(&self, slot: u32) -> usize {
        self.first.partition_point(|&first| first <= slot).saturating_sub(1)
    }

    /// Number of arrays of outgoing light.
    pub fn outgoing(&self) -> u32 {
        1 + 2 * self.first.len() as u32
    }

    /// What the block with an index connects.
    pub fn parts(&self, block: u32) -> (IncidentPart, OutgoingPart) {
        let (to, from) = (block / self.outgoing(), block % self.outgoing());
        let incident = match to.checked_sub(1) {
            None => IncidentPart::Irradiance,
            Some(group) => IncidentPart::Bins { group: group as usize },
        };
        let outgoing = match from.checked_sub(1).map(|k| (k as usize / 2, k % 2)) {
            None => OutgoingPart::Diffuse,
            Some((group, 0)) => OutgoingPart::Antiradiance { group },
            Some((group, _)) => OutgoingPart::Specular { group },
        };
        (incident, outgoing)
    }

    /// Block and row of a slot's irradiance, or of one of its bins, for an array of outgoing light.
    pub fn row(&self, group: usize, slot: u32, bin: Option<u32>, from: u32) -> (u32, u32) {
        match bin {
            None => (from, slot),
            Some(bin) => ((1 + group as u32) * self.outgoing() + from, self.place(group, slot, bin)),
        }
    }

    /// Array and column of a slot's diffuse radiance, or of a bin of its back (0) or its front (1).
    pub fn column(&self, group: usize, slot: u32, of_side: Option<(usize, usize)>) -> (u32, u32) {
        match of_side {
            None => (0, slot),
            Some((side, bin)) => (1 + (2 * group + side) as u32, self.place(group, slot, bin as u32)),
        }
    }

    /// The slot of the source that a column belongs to.
    pub fn source(&self, outgoing: OutgoingPart, column: u32) -> u32 {
        match outgoing {
            OutgoingPart::Diffuse => column,
            OutgoingPart::Antiradiance { group } | OutgoingPart::Specular { group } => {
                self.first[group] + column / self.bins
            }
        }
    }

    fn place(&self, group: usize, slot: u32, bin: u32) -> u32 {
        (slot - self.first[group]) * self.bins + bin
    }
}
