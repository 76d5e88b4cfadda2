//! From a target error to settings that meet it. Each refinement level, from cheap to accurate, is solved twice, the second time
//! with other bins and a smaller near field; the search stops where the two agree. docs/accuracy.md explains the choice of
//! levels.
//!
//! The device holds one engine at a time. Results are kept on the host ([`Answer`]), so that no level takes memory from another
//! and the best answer survives if a later level fails.

mod answer;
mod estimate;
mod levels;
mod pictures;

pub use answer::Answer;
pub use estimate::{ErrorEstimate, IrradianceEstimate, PictureEstimate};
pub use levels::{LayoutKind, layout, usual_plan, usual_settings};

use crate::image::ImageError;
use crate::shading::{Reflections, Shading};
use crate::warnings::{Warnings, mean_albedo, told_from};
use antirad_base::setters;
use antirad_core::backend::Backend;
use antirad_core::plan::{Plan, PlanError, PlanOptions, has_direct_lamps};
use antirad_core::{Engine, EngineError, Solution};
use antirad_scene::{Camera, Choice, Scene, SolveSettings};
use levels::{Level, is_directional, near_field_for};
use pictures::Visible;
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
    /// The level would exceed [`TargetErrorOptions::max_triangles`].
    #[error("it takes {triangles} triangles, and {allowed} are allowed (--max-triangles)")]
    Triangles {
        /// Number of triangles of the level.
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

/// One refinement level that was solved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Layout of the bins as text, such as `10x13` or `concentric:12`.
    pub bins: String,
    /// Layout of the bins.
    pub layout: LayoutKind,
    /// The range of the near field.
    pub near_field: f64,
    /// The relative residual at which the solver stopped.
    pub tolerance: f64,
    /// How many times every triangle was cut into four.
    pub cuts: u32,
    /// Number of triangles after cutting.
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
    /// The levels, in the order in which they were solved.
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
    /// Per triangle of `scene`, the index of the given triangle that it is a part of.
    pub parents: Vec<u32>,
    /// Areas of the given triangles, m².
    areas: Vec<f64>,
    /// The result on the triangles of `scene`.
    pub answer: Answer,
    /// The course of the search.
    pub refinement: Refinement,
}

impl Solved {
    /// Averages values per triangle of the solved scene over the triangles of the given one, by area.
    pub fn on_given(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        self.scene.means_on(&self.parents, &self.areas, values)
    }
}

/// One solve of the search, for reporting progress.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// Name of the solve, such as `level 2 of at most 5, comparison`.
    pub name: String,
    /// Share of the work of the whole search that is done before this solve, 0 to 1.
    pub begin: f64,
    /// Share of the work of the whole search that is done after this solve, 0 to 1.
    pub end: f64,
}

/// Runs a solver to the tolerance of the scene.
pub type Solve<'a> = dyn FnMut(&mut Engine, &Scene, &Stage) -> Result<Solution, EngineError> + 'a;

/// Solves `scene` to the target error, or as close to it as memory and `max_triangles` allow: see
/// [`Refinement::met`]. The scene's own bins, near field and tolerance are ignored; its other settings are
/// used.
///
/// `reserve` returns the bytes of device memory to set aside for pictures of a scene. `solve` runs the solver to
/// `scene.settings.tolerance`; progress and interruption are up to it.
///
/// # Errors
/// Fails if the scene or the target error is invalid, if a solve is interrupted, or if no level has an
/// answer.
pub fn solve_within(
    backend: &Backend,
    scene: &Scene,
    options: &TargetErrorOptions,
    reserve: &dyn Fn(&Scene) -> u64,
    solve: &mut Solve,
) -> Result<Solved, SearchError> {
    scene.validate().map_err(EngineError::from)?;
    Choice::Within(options.error).check().map_err(EngineError::from)?;
    let search = Search::new(backend, scene, options, reserve);
    let mut why = search.reasons();
    // Start at the level that usually suffices, or at the highest below it that can be run.
    let (mut number, mut barrier) = (Level::start(search.levels, options.error), None);
    let mut tried = loop {
        match search.run(number, number, solve) {
            Ok((step, best)) => break Tried { steps: vec![step], chosen: 0, best },
            Err(error) if number == 0 || error.is_interruption() => return Err(error),
            Err(error) => {
                tracing::info!("level {} cannot be run: {error}", number + 1);
                barrier = Some(error);
                number -= 1;
            }
        }
    };
    let first = number;
    while !tried.last_meets(options.error) {
        number += 1;
        if number == search.levels.len() {
            why.push("there is no finer level".to_owned());
            break;
        }
        match barrier.take().map_or_else(|| search.run(number, first, solve), Err) {
            Ok((step, found)) => tried.add(step, found),
            Err(error) if error.is_interruption() => return Err(error),
            Err(error) => {
                why.push(format!("the next level was skipped: {error}"));
                break;
            }
        }
    }
    // Where no solve has converged, one with fewer bins may.
    for number in (0..first).rev() {
        if tried.best.is_ok() {
            break;
        }
        let (step, found) = search.run(number, number, solve)?;
        tried.add(step, found);
    }
    let Tried { steps, chosen, best } = tried;
    let Found { scene, parents, answer } = best?;
    let Step { beyond, .. } = &steps[chosen];
    if !beyond.is_empty() {
        why.push(format!("there are errors that the estimate does not include: {}", beyond.join(", ")));
    }
    let met = steps[chosen].meets(options.error);
    let refinement = Refinement { error: options.error, met, why, steps, chosen };
    Ok(Solved { scene, parents, areas: search.areas, answer, refinement })
}

/// The levels solved so far.
struct Tried {
    /// The steps so far, at least one.
    steps: Vec<Step>,
    /// Index of the step of `best`.
    chosen: usize,
    /// The best answer, or the error of the first solve.
    best: Result<Found, EngineError>,
}

impl Tried {
    fn add(&mut self, step: Step, found: Result<Found, EngineError>) {
        if found.is_ok() && (self.best.is_err() || !self.steps[self.chosen].is_better_than(&step)) {
            (self.chosen, self.best) = (self.steps.len(), found);
        }
        self.steps.push(step);
    }

    fn last_meets(&self, error: f64) -> bool {
        self.steps.last().is_some_and(|step| step.meets(error))
    }
}

/// What all levels have in common.
struct Search<'a> {
    backend: &'a Backend,
    /// The given scene with its wide triangles cut.
    scene: Scene,
    /// Per triangle of `scene`, the index of the given triangle.
    parents: Vec<u32>,
    options: &'a TargetErrorOptions,
    reserve: &'a dyn Fn(&Scene) -> u64,
    levels: &'static [Level],
    /// Areas of the given triangles, m².
    areas: Vec<f64>,
    /// Area-weighted mean.
    albedo: f64,
    /// The smallest admissible range of the near field.
    near: f64,
}

/// Share of the target error that clusters may cause: squares add up, so that they add a twentieth to the estimate.
const CLUSTERS: f64 = 0.3;

/// A level that can be planned.
struct Planned {
    scene: Scene,
    parents: Vec<u32>,
    layout: LayoutKind,
    plan: Plan,
    comparison: SolveSettings,
    comparison_plan: Plan,
}

struct Found {
    scene: Scene,
    parents: Vec<u32>,
    answer: Answer,
}

/// Longest edge at the start, as a share of the scene's diagonal. A wall needs several triangles: only the differences between
/// neighbours show how light varies within them.
const WIDEST: f64 = 0.22;

impl<'a> Search<'a> {
    fn new(
        backend: &'a Backend,
        given: &Scene,
        options: &'a TargetErrorOptions,
        reserve: &'a dyn Fn(&Scene) -> u64,
    ) -> Self {
        let mut scene = given.clone();
        let parents = scene.split_wide(WIDEST, options.max_triangles);
        let albedo = mean_albedo(given);
        Self {
            backend,
            parents,
            options,
            reserve,
            levels: Level::all(is_directional(&scene), has_direct_lamps(&scene)),
            scene,
            areas: (0..given.triangles.len()).map(|i| given.area_vector(i).length()).collect(),
            albedo,
            near: near_field_for(albedo, options.error),
        }
    }

    fn reasons(&self) -> Vec<String> {
        let near = format!(
            "surfaces reflect {:.0} % on average: a near field of at least {} keeps the loss over all bounces within half \
             the error",
            100.0 * self.albedo,
            self.near
        );
        let (given, cut) = (self.areas.len(), self.scene.triangles.len());
        let wide = (cut > given).then(|| {
            format!(
                "wide triangles hide the shadows within them: the {given} triangles were first cut into {cut}"
            )
        });
        std::iter::once(near).chain(wide).collect()
    }

    /// Plans both solves of a level before either is run.
    fn plan(&self, level: &Level) -> Result<Planned, SearchError> {
        let (triangles, allowed) = (
            self.scene.triangles.len().saturating_mul(4_usize.saturating_pow(level.cuts)),
            self.options.max_triangles,
        );
        if level.cuts > 0 && triangles > allowed {
            return Err(SearchError::Triangles { triangles, allowed });
        }
        let mut scene = self.scene.clone();
        let cut = scene.split_all(level.cuts);
        let parents = cut.into_iter().map(|parent| self.parents[parent as usize]).collect();
        let mut given = scene.settings;
        given.transport = given.transport.within(CLUSTERS * self.options.error, scene.triangles.len());
        let settings = |layout| level.settings(layout, self.near, &given);
        let options = PlanOptions::of(self.backend).pictures((self.reserve)(&scene));
        let layout = layout(&scene, &settings(LayoutKind::EqualAngle));
        let own = settings(layout);
        let plan = Plan::new(&scene, &options, &own)?;
        scene.settings = own;
        let comparison = level.comparison(layout, self.near, &given);
        let comparison_plan = Plan::new(&scene, &options, &comparison)?;
        Ok(Planned { scene, parents, layout, plan, comparison, comparison_plan })
    }

    /// Solves the comparison, then the scene itself. A solver that does not converge is a result (inner `Err`), not a failure of
    /// the level. `first` is the lowest level of this search.
    fn run(
        &self,
        number: usize,
        first: usize,
        solve: &mut Solve,
    ) -> Result<(Step, Result<Found, EngineError>), SearchError> {
        let level = &self.levels[number];
        let Planned { mut scene, parents, layout, plan, comparison, comparison_plan } = self.plan(level)?;
        let [comparing, solving] = self.stages(number, first);
        let own = std::mem::replace(&mut scene.settings, comparison);
        let other = self.answer(&scene, comparison_plan, Warnings::default(), &comparing, solve)?;
        scene.settings = own;
        let warnings = Warnings::of(&scene, &plan);
        let clusters = plan.transport().error();
        let answer = self.answer(&scene, plan, warnings, &solving, solve)?;
        let estimate = match (&answer, &other) {
            (Ok(answer), Ok(other)) => {
                let visible = Visible::of(self.backend, &scene, &self.options.cameras)?;
                let factors = [layout.ratio(), clusters];
                Some(ErrorEstimate::new(&scene, answer, other, factors, &visible, self.options.shading)?)
            }
            _ => None,
        };
        let both = || [&answer, &other].into_iter();
        let least = told_from(Some(self.options.error));
        let beyond = answer.iter().flat_map(|answer| answer.warnings.above(least));
        let step = Step {
            bins: own.bins.to_string(),
            layout,
            near_field: own.near_field,
            tolerance: own.tolerance,
            cuts: level.cuts,
            triangles: scene.triangles.len(),
            passes: both().flatten().map(|answer| answer.info.passes).sum(),
            estimate,
            failure: both().find_map(|answer| answer.as_ref().err()).map(ToString::to_string),
            beyond: beyond.map(|warning| warning.kind.name()).collect(),
        };
        tracing::info!("{step}");
        Ok((step, answer.map(|answer| Found { scene, parents, answer })))
    }

    /// Solvers that do not converge go into the inner result, all other errors into the outer. Releases all device memory.
    fn answer(
        &self,
        scene: &Scene,
        plan: Plan,
        warnings: Warnings,
        stage: &Stage,
        solve: &mut Solve,
    ) -> Result<Result<Answer, EngineError>, SearchError> {
        let mut engine = Engine::new(self.backend, scene, plan)?;
        match solve(&mut engine, scene, stage) {
            Ok(solution) => {
                let TargetErrorOptions { cameras, reflections, .. } = &self.options;
                Ok(Ok(Answer::new(&mut engine, scene, solution, cameras, *reflections, warnings)?))
            }
            Err(error) if error.is_without_answer() => Ok(Err(error.without_best())),
            Err(error) => Err(error.into()),
        }
    }

    /// The comparison and the solve itself.
    fn stages(&self, number: usize, first: usize) -> [Stage; 2] {
        let of = |level: &Level| level.work(self.parents.len(), self.scene.settings.transport);
        let work = |range: &[Level]| range.iter().map(of).sum::<f64>();
        let all = work(&self.levels[first..]);
        let share =
            |halves: f64| (work(&self.levels[first..number]) + 0.5 * halves * of(&self.levels[number])) / all;
        let stage = |name: &str, halves: f64| Stage {
            name: format!("level {} of at most {}{name}", number + 1, self.levels.len()),
            begin: share(halves),
            end: share(halves + 1.0),
        };
        [stage(", comparison", 0.0), stage("", 1.0)]
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bins, near_field, cuts, triangles, .. } = self;
        write!(f, "{bins} bins, near field {near_field}, {triangles} triangles")?;
        match cuts {
            0 => write!(f, ": ")?,
            1 => write!(f, " (each cut into 4): ")?,
            _ => write!(f, " (each cut into {}): ", 4_u32.pow(*cuts))?,
        }
        match (&self.estimate, &self.failure) {
            (Some(estimate), _) => write!(f, "estimated error {estimate}"),
            (None, Some(failure)) => f.write_str(failure),
            (None, None) => f.write_str("no estimate"),
        }
    }
}
