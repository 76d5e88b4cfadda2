//! `render --refine`: a scene whose triangles are cut, and results for the triangles of the given one.

use crate::Failure;
use antirad::cli::{Interrupt, Working};
use antirad::plan::PlanOptions;
use antirad::scene::{Choice, Scene, VisibilityChoice};
use antirad::target_error::usual_settings;
use antirad::warnings::{RefineOptions, cut_for_rays, refine, too_coarse};

/// Triangles that may be added where nobody asked for a finer mesh.
const UNASKED: usize = 4000;
/// The same among dense blockers, where the time of a solve grows with their number alone.
const AMONG_DENSE: usize = 20_000;

/// How the triangles of a scene were cut.
pub struct Finer {
    /// Per triangle, the index of the given triangle that it is a part of.
    parents: Vec<u32>,
    /// Areas of the given triangles, m².
    areas: Vec<f64>,
}

impl Finer {
    /// A scene as it is.
    fn whole(scene: &Scene) -> Self {
        let count = scene.triangles.len();
        Self {
            parents: (0..count as u32).collect(),
            areas: (0..count).map(|t| scene.area_vector(t).length()).collect(),
        }
    }

    /// Cuts triangles where others touch them or pass through them, and then for explicit visibility, at most [`AMONG_DENSE`] more, or if the mesh
    /// is [far too coarse](too_coarse), at most [`UNASKED`] more. `None` if the scene stays as it is.
    pub fn where_needed(
        scene: &mut Scene,
        max_triangles: usize,
        interrupt: &Interrupt,
    ) -> Result<Option<Self>, Failure> {
        let mut finer = Self::whole(scene);
        let given = scene.clone();
        let touched = finer.cut_contacts(scene, max_triangles, interrupt);
        if let Some(cut) = finer.cut_for_rays(scene, max_triangles, interrupt) {
            let changed = touched || cut;
            if changed {
                // By the mesh as given: blockers of small triangles do not look dense.
                scene.settings = scene.settings.visibility(VisibilityChoice::Explicit);
            }
            return Ok(changed.then_some(finer));
        }
        let looking = Working::on("looking for shadows");
        let count = scene.triangles.len();
        let coarse = count < max_triangles && interrupt.while_computing(|| too_coarse(scene));
        if touched && !coarse {
            // Bins and near field are chosen by the mesh as given: seen from a part at its foot, each blocker is large.
            scene.settings = interrupt.while_computing(|| usual_settings(&given));
            scene.choice = Choice::Open { bins: false, near_field: false };
        }
        drop(looking);
        if coarse {
            finer.cut(scene, max_triangles.min(count + UNASKED), interrupt)?;
        }
        Ok((touched || coarse).then_some(finer))
    }

    /// Cuts triangles where others touch them or pass through them, and where the mesh is too coarse for shadows: see [`refine`]. Settings
    /// stay as they are.
    pub fn of(scene: &mut Scene, max_triangles: usize, interrupt: &Interrupt) -> Result<Self, Failure> {
        let mut finer = Self::whole(scene);
        finer.cut_contacts(scene, max_triangles, interrupt);
        if finer.cut(scene, max_triangles, interrupt)? {
            tracing::warn!("the mesh would be finer, but for --max-triangles {max_triangles}");
        }
        Ok(finer)
    }

    /// Cuts triangles along contacts, see [`Scene::cut_along_contacts`], and tells whether there are any.
    fn cut_contacts(&mut self, scene: &mut Scene, max_triangles: usize, interrupt: &Interrupt) -> bool {
        let _working = Working::on("looking for contacts");
        let most = max_triangles.min(scene.triangles.len() + UNASKED);
        let parents = interrupt.while_computing(|| scene.cut_along_contacts(most));
        let touched = parents.len() != self.parents.len();
        if touched {
            tracing::info!(
                "{} triangles instead of {}, cut where others touch them",
                parents.len(),
                self.given()
            );
        }
        self.compose(&parents);
        touched
    }

    /// Cuts triangles for explicit visibility, see [`cut_for_rays`], and tells whether there are any. `None` where visibility is implicit.
    fn cut_for_rays(
        &mut self,
        scene: &mut Scene,
        max_triangles: usize,
        interrupt: &Interrupt,
    ) -> Option<bool> {
        let _working = Working::on("looking for dense blockers");
        let count = scene.triangles.len();
        let most = max_triangles.min(count + AMONG_DENSE);
        let parents = interrupt.while_computing(|| cut_for_rays(scene, most))?;
        self.compose(&parents);
        let finer = parents.len();
        if finer != count {
            tracing::info!("{finer} triangles instead of {count}, cut where light varies within them");
        }
        Some(finer != count)
    }

    /// Cuts triangles where the mesh is too coarse for shadows, and tells whether `max_triangles` prevented
    /// further cuts.
    fn cut(
        &mut self,
        scene: &mut Scene,
        max_triangles: usize,
        interrupt: &Interrupt,
    ) -> Result<bool, Failure> {
        let _working = Working::on("refining the mesh");
        let (before, settings) = (scene.triangles.len(), scene.settings);
        let refined = interrupt.while_computing(|| {
            scene.settings = usual_settings(scene);
            let options = RefineOptions::default().max_triangles(max_triangles);
            refine(scene, &PlanOptions::default(), &options)
        })?;
        scene.settings = settings;
        let (count, rounds) = (scene.triangles.len(), refined.rounds);
        tracing::info!("{count} triangles instead of {before}, after {rounds} rounds");
        self.compose(&refined.parents);
        Ok(refined.full)
    }

    /// Cuts parts further: `parents` are those of the new parts among the present ones.
    fn compose(&mut self, parents: &[u32]) {
        self.parents = parents.iter().map(|&part| self.parents[part as usize]).collect();
    }

    /// Number of the given triangles.
    pub fn given(&self) -> usize {
        self.areas.len()
    }

    /// Means over the given triangles of values per triangle of the finer scene.
    pub fn on_given(&self, scene: &Scene, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        scene.means_on(&self.parents, &self.areas, values)
    }
}
