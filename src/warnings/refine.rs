//! Finer meshes where warnings ask for them.

use super::{Kind, Warnings};
use crate::options::setters;
use crate::plan::{Plan, PlanError, PlanOptions};
use crate::scene::Scene;
use std::collections::BTreeMap;

/// How far to refine.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct RefineOptions {
    /// Triangles that the scene may have in the end.
    pub max_triangles: usize,
    /// Times that a triangle may be cut.
    pub levels: u32,
}

setters!(RefineOptions { max_triangles: usize, levels: u32 });

impl Default for RefineOptions {
    fn default() -> Self {
        Self { max_triangles: 100_000, levels: 4 }
    }
}

/// What was done.
#[derive(Clone, Debug)]
pub struct Refined {
    /// Warnings of the scene as it was given.
    pub before: Warnings,
    /// Those that are left.
    pub after: Warnings,
    /// Per new triangle the one of the old scene that it is a part of.
    pub parents: Vec<u32>,
    /// Old triangles that were cut, by the name of their mesh.
    pub cut: BTreeMap<String, usize>,
    /// Times that cutting was done.
    pub rounds: u32,
    /// Some more would have been cut, had there been room below `max_triangles`.
    pub full: bool,
}

/// Why there is nothing refined.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RefineError {
    /// There is no plan to judge the scene by.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// The scene is as large as it may be before anything is cut.
    #[error("the scene has {triangles} triangles already; allow more than {allowed} (--max-triangles)")]
    Full {
        /// Number of triangles it has.
        triangles: usize,
        /// Number that it may have.
        allowed: usize,
    },
}

/// Cuts coarse blockers, those of stacked layers, and the wide sides of narrow gaps, the worst first, until there are none,
/// or no room, or each was cut `levels` times. See [`Scene::split`] for what a cut is. Materials, cameras and settings stay.
pub fn refine(
    scene: &mut Scene,
    plan_options: &PlanOptions,
    options: &RefineOptions,
) -> Result<Refined, RefineError> {
    let plan = |scene: &Scene| {
        // Only what is near matters here, not whether a solve would fit the memory.
        Plan::new(scene, &plan_options.boundless(), &scene.settings)
    };
    let (count, allowed) = (scene.triangles.len(), options.max_triangles);
    let before = Warnings::of(scene, &plan(scene)?);
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
    while refined.rounds < options.levels {
        let mut chosen = asked(&refined.after);
        let room = allowed.saturating_sub(scene.triangles.len()) / 3;
        refined.full = chosen.len() > room;
        chosen.truncate(room);
        if chosen.is_empty() {
            break;
        }
        chosen.sort_unstable();
        let parents = scene.split(&chosen);
        refined.parents = parents.into_iter().map(|p| refined.parents[p as usize]).collect();
        refined.after = Warnings::of(scene, &plan(scene)?);
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

/// The triangles that should be smaller, the worst first, each once.
fn asked(warnings: &Warnings) -> Vec<u32> {
    let lists = [Kind::CoarseBlockers, Kind::NarrowGaps].map(|kind| warnings.get(kind));
    let mut seen = std::collections::HashSet::new();
    lists.into_iter().flatten().flat_map(|w| &w.triangles).copied().filter(|&t| seen.insert(t)).collect()
}
