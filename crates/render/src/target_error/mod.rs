//! From a target error to settings that meet it. Each step is solved twice, the second time with fewer bins and half the rays. Where the
//! two differ too much, the next step has finer settings, the next level; where light varies too much within triangles, these are cut. The
//! search stops at the first step that meets the target. docs/accuracy.md explains the choice of levels.
//!
//! The device holds one engine at a time. Results are kept on the host ([`Answer`]), so that no level takes memory from another
//! and the best answer survives if a later level fails.

mod answer;
mod estimate;
mod levels;
mod mesh;
mod pictures;
mod search;
mod surface;

pub use answer::Answer;
pub use estimate::{ErrorEstimate, IrradianceEstimate, PictureEstimate};

use crate::image::ImageError;
use crate::shading::{Reflections, Shading};
use antirad_base::setters;
use antirad_core::backend::Backend;
use antirad_core::plan::PlanError;
use antirad_core::{Engine, EngineError, Solution};
use antirad_scene::{Camera, Cut, Scene, VisibilityChoice, check_target_error};
use mesh::Mesh;
use search::{Search, Tried};
use serde::Serialize;
use std::fmt;

/// A target error, and the bounds of the search for settings that meet it.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TargetErrorOptions {
    /// Relative L2 error of irradiance over the scene, and of the pictures of `cameras`: 0.05 for 5 %.
    pub error: f64,
    /// Largest number of triangles to which the scene may be subdivided.
    pub max_triangles: usize,
    /// Cameras whose pictures must be within the error, too.
    pub cameras: Vec<Camera>,
    /// How these pictures are made.
    pub shading: Shading,
    /// What they show that glossy faces mirror.
    pub reflections: Reflections,
}

setters!(TargetErrorOptions {
    error: f64,
    max_triangles: usize,
    cameras: Vec<Camera>,
    shading: Shading,
    reflections: Reflections
});

impl TargetErrorOptions {
    /// Default of `max_triangles`.
    pub const MAX_TRIANGLES: usize = 200_000;

    /// A target for irradiance alone, with at most [`TargetErrorOptions::MAX_TRIANGLES`].
    pub fn new(error: f64) -> Self {
        Self {
            error,
            max_triangles: Self::MAX_TRIANGLES,
            cameras: Vec::new(),
            shading: Shading::default(),
            reflections: Reflections::default(),
        }
    }
}

/// Why the search has no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SearchError {
    /// A scene could not be planned or solved.
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// The visible triangles of a camera could not be determined.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Visibility is implicit, of which no level has an error that is known.
    #[error(
        "a target error takes explicit visibility, and the scene states visibility = \"implicit\": leave out one of the two"
    )]
    Implicit,
    /// The step would exceed [`TargetErrorOptions::max_triangles`].
    #[error("it takes {triangles} triangles, and {allowed} are allowed (--max-triangles)")]
    Triangles {
        /// Number of triangles of the step.
        triangles: usize,
        /// Largest number allowed.
        allowed: usize,
    },
}

impl From<PlanError> for SearchError {
    fn from(error: PlanError) -> Self {
        Self::Engine(error.into())
    }
}

impl SearchError {
    /// Whether a callback stopped the search, which is no failure.
    pub fn is_interruption(&self) -> bool {
        matches!(self, Self::Engine(error) if error.is_interruption())
    }

    /// Whether a solver ran but found no solution.
    pub fn is_without_answer(&self) -> bool {
        matches!(self, Self::Engine(error) if error.is_without_answer())
    }
}

/// One step of the search, which was solved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Layout of the bins as text, such as `10x13` or `concentric:12`.
    pub bins: String,
    /// Rays of a triangle; `None` where no solve has an answer.
    pub rays: Option<u32>,
    /// The relative residual at which the solver stopped.
    pub tolerance: f64,
    /// Number of triangles, parts included.
    pub triangles: usize,
    /// Passes of the solve and its comparison together.
    pub passes: u32,
    /// The estimated error; `None` where a solve failed.
    pub estimate: Option<ErrorEstimate>,
    /// The message of the solve that failed.
    pub failure: Option<String>,
    /// Names of the warnings whose effect is above the target error or 1 %: of errors that the estimate does not include.
    pub beyond: Vec<&'static str>,
}

impl Step {
    /// Whether the estimate is within the error, without a warning of more.
    fn meets(&self, error: f64) -> bool {
        self.beyond.is_empty() && self.estimate.as_ref().is_some_and(|estimate| estimate.total <= error)
    }

    /// Whether this step is better: the one without severe warnings is, and else the one with the smaller
    /// estimate.
    fn is_better_than(&self, other: &Self) -> bool {
        let rank = |step: &Self| {
            let estimate = step.estimate.as_ref().map_or(f64::INFINITY, |estimate| estimate.total);
            (!step.beyond.is_empty(), estimate)
        };
        let ((beyond, estimate), (other_beyond, other_estimate)) = (rank(self), rank(other));
        beyond.cmp(&other_beyond).then(estimate.total_cmp(&other_estimate)).is_lt()
    }
}

/// The course of the search.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refinement {
    /// The target error.
    pub error: f64,
    /// Whether the estimate of the answer is within `error`, without a warning of more.
    pub met: bool,
    /// The reasons for this near field and mesh, and for ending above the error, if it did: a sentence each.
    pub why: Vec<String>,
    /// The steps, in the order in which they were solved.
    pub steps: Vec<Step>,
    /// Index of the step with the best answer, the one returned.
    pub chosen: usize,
}

impl Refinement {
    /// The step whose answer is returned.
    pub fn answer(&self) -> Option<&Step> {
        self.steps.get(self.chosen)
    }
}

/// The best answer that the search found.
pub struct Solved {
    /// The scene as it was solved: with its triangles cut, and with the settings found.
    pub scene: Scene,
    /// How the given triangles were cut.
    pub cut: Cut,
    /// The result on the triangles of `scene`.
    pub answer: Answer,
    /// The course of the search.
    pub refinement: Refinement,
}

impl Solved {
    /// Averages values per triangle of the solved scene over the triangles of the given one, by area.
    pub fn on_given(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        self.cut.on_given(values)
    }
}

/// One solve of the search, for reporting progress.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name of the solve, such as `step 2, comparison`.
    pub name: String,
    /// Expected share of the work of the whole search that is done before this solve, 0 to 1.
    pub begin: f64,
    /// Expected share of the work of the whole search that is done after this solve, 0 to 1.
    pub end: f64,
}

/// Runs a solver to the tolerance of the scene.
pub type Solve<'a> = dyn FnMut(&mut Engine, &Scene, &Stage) -> Result<Solution, EngineError> + 'a;

/// Solves `scene` to the target error, or as close to it as memory and `max_triangles` allow: see
/// [`Refinement::met`]. The scene's own bins, ray error and tolerance are ignored; its other settings are
/// used.
///
/// `reserve` returns the bytes of device memory to set aside for pictures of a scene. `solve` runs the solver to
/// `scene.settings.tolerance`; progress and interruption are up to it.
///
/// # Errors
/// Fails if the scene or the target error is invalid, if the scene states implicit visibility, if a solve is interrupted, or if no level has an
/// answer.
pub fn solve_within(
    backend: &Backend,
    scene: &Scene,
    options: &TargetErrorOptions,
    reserve: &dyn Fn(&Scene) -> u64,
    solve: &mut Solve,
) -> Result<Solved, SearchError> {
    scene.validate().map_err(EngineError::from)?;
    check_target_error(Some(options.error)).map_err(EngineError::from)?;
    if scene.settings.visibility == VisibilityChoice::Implicit {
        return Err(SearchError::Implicit);
    }
    let search = Search::new(backend, scene, options, reserve);
    let mut why = search.reasons();
    let mut tried = search.first(solve)?;
    while !tried.last_meets(options.error) {
        let next = match search.after(&tried) {
            Ok(next) => next,
            Err(end) => {
                why.push(end);
                break;
            }
        };
        match search.run(tried.steps.len(), next, solve) {
            Ok(ran) => tried.add(ran),
            Err(error) if error.is_interruption() => return Err(error),
            Err(error) => {
                why.push(format!("the next step was skipped: {error}"));
                break;
            }
        }
    }
    search.coarser(&mut tried, solve)?;
    let Tried { steps, chosen, best, .. } = tried;
    let (mesh, answer) = best?;
    let Step { beyond, .. } = &steps[chosen];
    if !beyond.is_empty() {
        why.push(format!("there are errors that the estimate does not include: {}", beyond.join(", ")));
    }
    let met = steps[chosen].meets(options.error);
    let refinement = Refinement { error: options.error, met, why, steps, chosen };
    let Mesh { scene: finer, parents } = mesh;
    let cut = Cut::between(scene, &finer, &parents);
    Ok(Solved { scene: finer, cut, answer, refinement })
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(rays) = self.rays {
            write!(f, "{rays} rays a triangle, ")?;
        }
        write!(f, "{} triangles: ", self.triangles)?;
        match (&self.estimate, &self.failure) {
            (Some(estimate), _) => write!(f, "estimated error {estimate}"),
            (None, Some(failure)) => f.write_str(failure),
            (None, None) => f.write_str("no estimate"),
        }
    }
}
