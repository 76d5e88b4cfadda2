//! Refinement of the mesh where warnings ask for it.

use super::{Kind, Warnings};
use antirad_base::setters;
use antirad_core::plan::{Plan, PlanError, PlanOptions};
use antirad_core::resolve::cut_coarse;
use antirad_scene::Scene;
use std::collections::{BTreeMap, HashSet};

/// How far to refine.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RefineOptions {
    /// Largest number of triangles of the refined scene.
    pub max_triangles: usize,
    /// How many times a triangle may be cut.
    pub levels: u32,
}

setters!(RefineOptions { max_triangles: usize, levels: u32 });

impl Default for RefineOptions {
    fn default() -> Self {
        Self { max_triangles: 100_000, levels: 4 }
    }
}

/// What [`refine`] did.
#[derive(Clone, Debug)]
pub struct Refined {
    /// Warnings of the given scene.
    pub before: Warnings,
    /// Warnings of the refined scene.
    pub after: Warnings,
    /// Per new triangle, the index of the old triangle that it is a part of.
    pub parents: Vec<u32>,
    /// Number of old triangles that were cut, by the name of their mesh.
    pub cut: BTreeMap<String, usize>,
    /// Number of rounds of cutting.
    pub rounds: u32,
    /// Whether `max_triangles` prevented further cuts.
    pub full: bool,
}

/// Why a scene could not be refined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RefineError {
    /// The scene has no plan, without which there are no warnings.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The scene already has the largest number of triangles allowed.
    #[error("the scene has {triangles} triangles already; allow more than {allowed} (--max-triangles)")]
    Full {
        /// Number of triangles it has.
        triangles: usize,
        /// Number that it may have.
        allowed: usize,
    },
}

/// What smaller triangles mend.
pub(crate) const CUT: [Kind; 3] = [Kind::CoarseBlockers, Kind::CoarseShadows, Kind::NarrowGaps];

/// Cuts coarse blockers, those of stacked layers included, triangles with shadows within them, and the larger triangles of narrow
/// gaps, the worst first, until none are left, `max_triangles` is reached, or `levels` rounds are done; see [`Scene::split`]. Materials, cameras and settings stay.
///
/// Before that it is cut, as far as `max_triangles` allows, until no triangle would receive more than 4 % of all light of lamps or has an edge
/// longer than 15 % of the scene's diagonal.
///
/// # Errors
/// Fails if the scene cannot be planned, or if triangles should be cut and the scene already has
/// `max_triangles`.
pub fn refine(
    scene: &mut Scene,
    plan_options: &PlanOptions,
    options: &RefineOptions,
) -> Result<Refined, RefineError> {
    let plan = |scene: &Scene| {
        // Warnings do not depend on whether a solve would fit into memory.
        Plan::new(scene, &plan_options.boundless(), &scene.settings)
    };
    let (count, allowed) = (scene.triangles.len(), options.max_triangles);
    let before = Warnings::with_shadows(scene, &plan(scene)?);
    let mut refined = Refined {
        after: before.clone(),
        before,
        parents: (0..count as u32).collect(),
        cut: BTreeMap::new(),
        rounds: 0,
        full: false,
    };
    if count >= allowed && !asked(&refined.after).is_empty() {
        return Err(RefineError::Full { triangles: count, allowed });
    }
    let old = scene.clone();
    refined.parents = cut_coarse(scene, allowed);
    if scene.triangles.len() > count {
        refined.after = Warnings::with_shadows(scene, &plan(scene)?);
    }
    while refined.rounds < options.levels {
        let mut chosen = scene.with_other_sides(asked(&refined.after));
        let room = allowed.saturating_sub(scene.triangles.len()) / 3;
        refined.full = chosen.len() > room;
        chosen.truncate(room);
        if chosen.is_empty() {
            break;
        }
        chosen.sort_unstable();
        let parents = scene.split(&chosen);
        refined.parents = parents.into_iter().map(|p| refined.parents[p as usize]).collect();
        refined.after = Warnings::with_shadows(scene, &plan(scene)?);
        refined.rounds += 1;
    }
    let mut pieces = vec![0; count];
    refined.parents.iter().for_each(|&p| pieces[p as usize] += 1);
    for mesh in &old.meshes {
        let cut = mesh.range.clone().filter(|&t| pieces[t as usize] > 1).count();
        if cut > 0 {
            refined.cut.insert(mesh.name.clone(), cut);
        }
    }
    Ok(refined)
}

/// The triangles to cut, the worst first, each once.
fn asked(warnings: &Warnings) -> Vec<u32> {
    let lists = CUT.map(|kind| warnings.get(kind));
    let mut seen = HashSet::new();
    lists.into_iter().flatten().flat_map(|w| &w.triangles).copied().filter(|&t| seen.insert(t)).collect()
}
