//! Sheets with two sides: a triangle that is declared two-sided gets a second one with the same corners and the opposite front.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;

use glam::DVec3;

use super::orient::shells;
use super::{Scene, Triangle};

impl Scene {
    /// Per triangle, another one with the same corners and the opposite front.
    #[doc(hidden)]
    pub fn other_sides(&self) -> Vec<Option<u32>> {
        let there: HashMap<_, u32> =
            (0..).zip(&self.triangles).map(|(i, t)| (self.front(t.vertices), i)).collect();
        self.triangles.iter().map(|t| there.get(&self.front(other_side(t.vertices))).copied()).collect()
    }

    /// Chosen triangles, each once and with its [other side](Self::other_sides), if it has one: the two stay alike where they are cut.
    #[doc(hidden)]
    pub fn with_other_sides(&self, chosen: Vec<u32>) -> Vec<u32> {
        let other_sides = self.other_sides();
        let mut seen = HashSet::new();
        let both = chosen.into_iter().flat_map(|t| [Some(t), other_sides[t as usize]]);
        both.flatten().filter(|&t| seen.insert(t)).collect()
    }

    /// Triangles with an area, and the same corners and front as one before.
    pub(super) fn repeated(&self) -> Vec<usize> {
        let mut there = HashSet::new();
        let repeats = |&t: &usize| !there.insert(self.front(self.triangles[t].vertices));
        (0..self.triangles.len()).filter(|&t| self.area_vector(t) != DVec3::ZERO).filter(repeats).collect()
    }

    /// What triangles with the same corners and front have in common.
    fn front(&self, vertices: [u32; 3]) -> [[u64; 3]; 3] {
        let [a, b, c] = vertices.map(|v| self.vertices[v as usize].to_array().map(|x| (x + 0.0).to_bits()));
        [a, b, c].min([b, c, a]).min([c, a, b])
    }

    /// Appends to each mesh the second sides of those of its triangles for which `two_sided` holds, in their order, with the same
    /// corners and material. Triangles of closed shells, whose backs no light reaches, get none, nor do those that have one.
    ///
    /// Returns how many were added.
    pub(super) fn add_second_sides(&mut self, two_sided: impl Fn(usize) -> bool) -> usize {
        let mut asked: Vec<bool> = (0..self.triangles.len()).map(two_sided).collect();
        if !asked.contains(&true) {
            return 0;
        }
        for shell in shells(self).iter().filter(|shell| shell.closed && shell.against.is_empty()) {
            shell.triangles.iter().for_each(|&t| asked[t as usize] = false);
        }
        asked.iter_mut().zip(self.other_sides()).for_each(|(asked, other)| *asked &= other.is_none());
        let old = std::mem::take(&mut self.triangles);
        let mut origins = self.origins.iter_mut();
        // Per new triangle, the old one, and whether it is its second side.
        let mut rows: Vec<(u32, bool)> = Vec::new();
        for mesh in &mut self.meshes {
            let first = self.triangles.len() as u32;
            let seconds = || mesh.range.clone().map(|t| t as usize).filter(|&t| asked[t]);
            self.triangles.extend_from_slice(&old[mesh.range.start as usize..mesh.range.end as usize]);
            self.triangles
                .extend(seconds().map(|t| Triangle { vertices: other_side(old[t].vertices), ..old[t] }));
            rows.extend(mesh.range.clone().map(|t| (t, false)));
            rows.extend(seconds().map(|t| (t as u32, true)));
            if let Some(origin) = origins.next() {
                let lines = |t: usize| origin.lines.get(t - mesh.range.start as usize).copied();
                let more: Vec<u32> = seconds().filter_map(lines).collect();
                origin.lines.extend(more);
            }
            mesh.range = first..self.triangles.len() as u32;
        }
        if !self.patterns.is_bare() {
            let patterns = Arc::make_mut(&mut self.patterns);
            patterns.rearrange(rows.iter().map(|&(old, _)| (old, DVec3::AXES)));
            rows.iter().zip(0..).filter(|((_, second), _)| *second).for_each(|(_, t)| patterns.turn(t));
        }
        self.triangles.len() - old.len()
    }
}

fn other_side([a, b, c]: [u32; 3]) -> [u32; 3] {
    [a, c, b]
}
