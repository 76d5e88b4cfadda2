//! From a target error to settings that meet it: solves at refinement levels from cheap to exact, each twice, the second time
//! with other bins and a smaller near field for comparison, and stops where the two agree. docs/accuracy.md says what the
//! levels were chosen by.
//!
//! The device holds one engine at a time. What is kept of a solve lies on the host ([`Answer`]), so that no level can take the
//! memory of another, and the best answer stays if a later level fails.

mod answer;
mod estimate;
mod levels;
mod mesh;
mod pictures;

pub use answer::Answer;
pub use estimate::{ErrorEstimate, IrradianceEstimate, PictureEstimate};
pub use levels::{LayoutKind, layout, usual_plan, usual_settings};

use crate::gpu::Device;
use crate::image::ImageError;
use crate::options::setters;
use crate::plan::{Plan, PlanError, PlanOptions};
use crate::scene::{Camera, Choice, Scene, SolveSettings};
use crate::warnings::Warnings;
use crate::{Engine, EngineError, Solution};
use levels::{Level, is_directional, mean_albedo, near_field_for};
use pictures::Visible;
use serde::Serialize;
use std::fmt;

/// What is asked.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct TargetErrorOptions {
    /// Relative L2 error of irradiance over the scene, and of the pictures of `cameras`: 0.05 for 5 %.
    pub error: f64,
    /// Triangles that the scene may be cut to.
    pub max_triangles: usize,
    /// Whose pictures are to be within the error, too.
    pub cameras: Vec<Camera>,
}

setters!(TargetErrorOptions { error: f64, max_triangles: usize, cameras: Vec<Camera> });

impl TargetErrorOptions {
    /// What is allowed if nobody says otherwise.
    pub const MAX_TRIANGLES: usize = 200_000;

    /// With room for [`TargetErrorOptions::MAX_TRIANGLES`], for irradiance alone.
    pub fn new(error: f64) -> Self {
        Self { error, max_triangles: Self::MAX_TRIANGLES, cameras: Vec::new() }
    }
}

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SearchError {
    #[error(transparent)]
    Engine(#[from] EngineError),
    /// What the cameras see could not be found.
    #[error(transparent)]
    Image(#[from] ImageError),
    #[error("it takes {triangles} triangles, and {allowed} are allowed (--max-triangles)")]
    Triangles { triangles: usize, allowed: usize },
}

impl From<PlanError> for SearchError {
    fn from(error: PlanError) -> Self {
        Self::Engine(error.into())
    }
}

impl SearchError {
    /// As [`EngineError::is_interruption`].
    pub fn is_interruption(&self) -> bool {
        matches!(self, Self::Engine(error) if error.is_interruption())
    }

    /// As [`EngineError::is_without_answer`].
    pub fn is_without_answer(&self) -> bool {
        matches!(self, Self::Engine(error) if error.is_without_answer())
    }
}

/// One refinement level that was solved.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// `10x13`, `concentric:12`.
    pub bins: String,
    /// How the hemisphere is cut.
    pub layout: LayoutKind,
    /// The range of the near field.
    pub near_field: f64,
    /// The relative residual at which the solver stopped.
    pub tolerance: f64,
    /// Times that every triangle was cut into four.
    pub cuts: u32,
    /// After cutting.
    pub triangles: usize,
    /// Of the solve and its comparison together.
    pub passes: u32,
    /// `None` where a solve failed.
    pub estimate: Option<ErrorEstimate>,
    /// How it failed.
    pub failure: Option<String>,
    /// Names of the severe warnings there: of errors that the estimate does not see.
    pub severe: Vec<&'static str>,
}

impl Step {
    /// Whether the estimate is within the error, and no severe warning speaks against it.
    fn meets(&self, error: f64) -> bool {
        self.severe.is_empty() && self.estimate.as_ref().is_some_and(|estimate| estimate.total <= error)
    }

    /// No severe warning rather than some, then the smaller estimate.
    fn is_better_than(&self, other: &Self) -> bool {
        let rank = |step: &Self| {
            let estimate = step.estimate.as_ref().map_or(f64::INFINITY, |estimate| estimate.total);
            (!step.severe.is_empty(), estimate)
        };
        let ((severe, estimate), (other_severe, other_estimate)) = (rank(self), rank(other));
        severe.cmp(&other_severe).then(estimate.total_cmp(&other_estimate)).is_lt()
    }
}

/// How the settings were found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refinement {
    /// What was asked.
    pub error: f64,
    /// Whether the estimate of the answer is within it, and no severe warning speaks against it.
    pub met: bool,
    /// Whole sentences: why these bins and this near field, and why it ended above the error, if it did.
    pub why: Vec<String>,
    /// In the order in which they were tried.
    pub steps: Vec<Step>,
    /// Index of the step whose answer was taken: the best one.
    pub chosen: usize,
}

impl Refinement {
    /// The step whose answer was taken.
    pub fn answer(&self) -> Option<&Step> {
        self.steps.get(self.chosen)
    }
}

/// A scene solved as well as was asked.
pub struct Solved {
    /// As it was solved: its triangles are cut, and `settings` are the settings found.
    pub scene: Scene,
    /// Per triangle of that scene, the one of the given scene that it is a part of.
    pub parents: Vec<u32>,
    /// Of the given triangles, m².
    areas: Vec<f64>,
    /// On the triangles of that scene.
    pub answer: Answer,
    /// How the settings were found.
    pub refinement: Refinement,
}

impl Solved {
    /// Values per triangle of the solved scene, as means over area on the triangles of the given one: a row for each.
    pub fn on_given(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        self.scene.means_on(&self.parents, &self.areas, values)
    }
}

/// A solve among those that may come.
#[derive(Clone, Debug, PartialEq)]
pub struct Stage {
    /// `level 2 of at most 5, comparison`.
    pub name: String,
    /// Shares of the work of all levels that may come, 0 to 1, before and after this solve.
    pub begin: f64,
    pub end: f64,
}

/// Runs a solver to the tolerance of the scene.
pub type Solve<'a> = dyn FnMut(&mut Engine, &Scene, &Stage) -> Result<Solution, EngineError> + 'a;

/// Solves `scene` to the error asked, or as near to it as memory and `max_triangles` allow: see [`Refinement::met`]. The scene's own
/// bins, near field and tolerance are not used; its other settings are. Fails only if no level has an answer.
///
/// `reserve` says how many bytes of the device pictures of a scene will need; `solve` runs the solver, with what progress and
/// interruption the caller likes, to `scene.settings.tolerance`.
pub fn solve_within(
    device: &Device,
    scene: &Scene,
    options: &TargetErrorOptions,
    reserve: &dyn Fn(&Scene) -> u64,
    solve: &mut Solve,
) -> Result<Solved, SearchError> {
    scene.validate().map_err(EngineError::from)?;
    Choice::Within(options.error).check().map_err(EngineError::from)?;
    let search = Search::new(device, scene, options, reserve);
    let mut why = search.reasons();
    // Rather less exact than not at all: the first level is the highest that can be run, up to the one that usually suffices.
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
                why.push(format!("the next level was left out: {error}"));
                break;
            }
        }
    }
    // Where no solver has found an answer, one may with fewer bins.
    for number in (0..first).rev() {
        if tried.best.is_ok() {
            break;
        }
        let (step, found) = search.run(number, number, solve)?;
        tried.add(step, found);
    }
    let Tried { steps, chosen, best } = tried;
    let Found { scene, parents, answer } = best?;
    let Step { severe, .. } = &steps[chosen];
    if !severe.is_empty() {
        why.push(format!("there are errors that the estimate does not see: {}", severe.join(", ")));
    }
    let met = steps[chosen].meets(options.error);
    let refinement = Refinement { error: options.error, met, why, steps, chosen };
    Ok(Solved { scene, parents, areas: search.areas, answer, refinement })
}

/// What came of the levels that were solved.
struct Tried {
    /// At least one.
    steps: Vec<Step>,
    /// Index of the step that `best` is of.
    chosen: usize,
    /// The best answer, or why the first solver found none.
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

/// What all levels share.
struct Search<'a> {
    device: &'a Device,
    /// With its wide triangles cut.
    scene: Scene,
    /// Per triangle of it the one of the given scene.
    parents: Vec<u32>,
    options: &'a TargetErrorOptions,
    reserve: &'a dyn Fn(&Scene) -> u64,
    levels: &'static [Level],
    /// Of the given triangles, m².
    areas: Vec<f64>,
    /// Mean over area.
    albedo: f64,
    /// The least range of the near field.
    near: f64,
}

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

impl<'a> Search<'a> {
    fn new(
        device: &'a Device,
        given: &Scene,
        options: &'a TargetErrorOptions,
        reserve: &'a dyn Fn(&Scene) -> u64,
    ) -> Self {
        let mut scene = given.clone();
        let parents = mesh::cut_wide(&mut scene, options.max_triangles);
        let albedo = mean_albedo(given);
        Self {
            device,
            parents,
            options,
            reserve,
            levels: Level::all(is_directional(&scene)),
            scene,
            areas: (0..given.triangles.len()).map(|i| given.area_vector(i).length()).collect(),
            albedo,
            near: near_field_for(albedo, options.error),
        }
    }

    fn reasons(&self) -> Vec<String> {
        let near = format!(
            "surfaces reflect {:.0} % on average: a near field of {} or more keeps what the bounces lose within half the \
             error",
            100.0 * self.albedo,
            self.near
        );
        let (given, cut) = (self.areas.len(), self.scene.triangles.len());
        let wide = (cut > given).then(|| {
            format!("wide triangles hide shadows within them: {given} were cut to {cut} to begin with")
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
        let given = scene.settings;
        let settings = |layout| level.settings(layout, self.near, &given);
        let options = PlanOptions::of(self.device).pictures((self.reserve)(&scene));
        let layout = layout(&scene, &settings(LayoutKind::EqualAngle));
        let own = settings(layout);
        let plan = Plan::new(&scene, &options, &own)?;
        scene.settings = own;
        let comparison = level.comparison(layout, self.near, &given);
        let comparison_plan = Plan::new(&scene, &options, &comparison)?;
        Ok(Planned { scene, parents, layout, plan, comparison, comparison_plan })
    }

    /// Solves the comparison, then the scene itself. That a solver finds no answer is a result. `first` is the lowest level of
    /// this search.
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
        let answer = self.answer(&scene, plan, warnings, &solving, solve)?;
        let estimate = match (&answer, &other) {
            (Ok(answer), Ok(other)) => {
                let visible = Visible::of(self.device, &scene, &self.options.cameras)?;
                Some(ErrorEstimate::new(&scene, answer, other, layout.ratio(), &visible))
            }
            _ => None,
        };
        let both = || [&answer, &other].into_iter();
        let severe = answer.iter().flat_map(|answer| &answer.warnings.list).filter(|warning| warning.severe);
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
            severe: severe.map(|warning| warning.kind.name()).collect(),
        };
        tracing::info!("{step}");
        Ok((step, answer.map(|answer| Found { scene, parents, answer })))
    }

    /// Solvers that find no answer go into the inner result, all else into the outer. Gives back all memory of the device.
    fn answer(
        &self,
        scene: &Scene,
        plan: Plan,
        warnings: Warnings,
        stage: &Stage,
        solve: &mut Solve,
    ) -> Result<Result<Answer, EngineError>, SearchError> {
        let mut engine = Engine::new(self.device, scene, plan)?;
        match solve(&mut engine, scene, stage) {
            Ok(solution) => {
                Ok(Ok(Answer::new(&mut engine, scene, solution, &self.options.cameras, warnings)?))
            }
            Err(error) if error.is_without_answer() => Ok(Err(error.without_best())),
            Err(error) => Err(error.into()),
        }
    }

    /// Of the comparison and of the solve itself.
    fn stages(&self, number: usize, first: usize) -> [Stage; 2] {
        let work = |range: &[Level]| range.iter().map(Level::work).sum::<f64>();
        let all = work(&self.levels[first..]);
        let share = |halves: f64| {
            (work(&self.levels[first..number]) + 0.5 * halves * self.levels[number].work()) / all
        };
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
