//! `render --refine`: a scene with a finer mesh, and results for the triangles of the given one.

use crate::Failure;
use antirad::cli::{Interrupt, Working};
use antirad::plan::PlanOptions;
use antirad::scene::Scene;
use antirad::target_error::usual_settings;
use antirad::warnings::{RefineOptions, refine, too_coarse};

/// Triangles that may be added where nobody asked for a finer mesh.
const UNASKED: usize = 4000;

/// How the triangles of a scene were cut.
pub struct Finer {
    /// Per triangle, the index of the given triangle that it is a part of.
    parents: Vec<u32>,
    /// Areas of the given triangles, m².
    areas: Vec<f64>,
}

impl Finer {
    /// Cuts triangles if the mesh is [far too coarse](too_coarse), which adds at most [`UNASKED`]; else
    /// `None`.
    pub fn where_coarse(
        scene: &mut Scene,
        max_triangles: usize,
        interrupt: &Interrupt,
    ) -> Result<Option<Self>, Failure> {
        let looking = Working::on("looking for shadows");
        let given = scene.triangles.len();
        let coarse = given < max_triangles && interrupt.while_computing(|| too_coarse(scene));
        drop(looking);
        let cut = || Ok(Self::cut(scene, max_triangles.min(given + UNASKED), interrupt)?.0);
        coarse.then(cut).transpose()
    }

    /// Cuts triangles where the mesh is too coarse for shadows: see [`refine`]. Settings stay as they are.
    pub fn of(scene: &mut Scene, max_triangles: usize, interrupt: &Interrupt) -> Result<Self, Failure> {
        let (finer, full) = Self::cut(scene, max_triangles, interrupt)?;
        if full {
            tracing::warn!("the mesh would be finer, but for --max-triangles {max_triangles}");
        }
        Ok(finer)
    }

    /// Cuts triangles where the mesh is too coarse for shadows, and tells whether `max_triangles` prevented
    /// further cuts.
    fn cut(scene: &mut Scene, max_triangles: usize, interrupt: &Interrupt) -> Result<(Self, bool), Failure> {
        let _working = Working::on("refining the mesh");
        let areas: Vec<f64> = (0..scene.triangles.len()).map(|t| scene.area_vector(t).length()).collect();
        let settings = scene.settings;
        let refined = interrupt.while_computing(|| {
            scene.settings = usual_settings(scene);
            let options = RefineOptions::default().max_triangles(max_triangles);
            refine(scene, &PlanOptions::default(), &options)
        })?;
        scene.settings = settings;
        tracing::info!(
            "{} triangles instead of {}, after {} rounds",
            scene.triangles.len(),
            areas.len(),
            refined.rounds
        );
        Ok((Self { parents: refined.parents, areas }, refined.full))
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
