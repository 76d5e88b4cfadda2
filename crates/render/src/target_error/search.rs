//! The steps of the search: which settings and which mesh come next.

use super::estimate::ErrorEstimate;
use super::levels::{LEVELS, Level};
use super::mesh::{Mesh, MeshError, added, cuts};
use super::pictures::Visible;
use super::{Answer, SearchError, Solve, Stage, Step, TargetErrorOptions};
use crate::warnings::{CUT, Warnings, told_from};
use antirad_core::backend::Backend;
use antirad_core::plan::{Plan, PlanOptions};
use antirad_core::{Engine, EngineError, RayError};
use antirad_scene::{Scene, SolveSettings};

/// Share of the target error that each cause may have before something is done about it: rays and bins, the mesh. The squares of both
/// are then seven tenths of that of the target.
const PART: f64 = 0.6;

/// Most steps: what has not come down to the target by then will not.
const MOST_STEPS: usize = 12;

/// Longest edge at the start, as a share of the scene's diagonal. A wall needs several triangles: only the differences between
/// neighbours show how light varies within them.
const WIDEST: f64 = 0.22;

/// What all steps have in common.
pub(super) struct Search<'a> {
    backend: &'a Backend,
    options: &'a TargetErrorOptions,
    reserve: &'a dyn Fn(&Scene) -> u64,
    /// The given scene with its wide triangles cut, and all where others touch them.
    start: Mesh,
    /// Number of the given triangles.
    given: usize,
}

/// What a step is made with.
pub(super) struct Next {
    /// Number of the level of its settings.
    level: usize,
    mesh: Mesh,
}

/// A step that can be planned.
struct Planned {
    mesh: Mesh,
    plan: Plan,
    comparison: SolveSettings,
    comparison_plan: Plan,
}

/// A step that was solved.
pub(super) struct Ran {
    step: Step,
    /// The error of the solve, if it has no answer.
    answer: Result<Answer, EngineError>,
    last: Last,
}

/// The steps solved so far.
pub(super) struct Tried {
    /// At least one.
    pub steps: Vec<Step>,
    /// Index of the step of `best`.
    pub chosen: usize,
    /// The best answer, or the error of the first solve.
    pub best: Result<(Mesh, Answer), EngineError>,
    /// Number of the first level, and why higher ones cannot be run, if the search should have begun with one.
    first: usize,
    barrier: Option<SearchError>,
    last: Last,
}

/// What the next step is decided by.
struct Last {
    level: usize,
    mesh: Mesh,
    /// Of irradiance, and of each picture; empty without an estimate.
    of_mesh: Vec<MeshError>,
    /// Triangles under warnings of errors that the estimate does not include, and that smaller triangles mend.
    beyond: Vec<u32>,
}

impl Tried {
    fn new(Ran { step, answer, last }: Ran, barrier: Option<SearchError>) -> Self {
        let best = answer.map(|answer| (last.mesh.clone(), answer));
        Self { steps: vec![step], chosen: 0, best, first: last.level, barrier, last }
    }

    pub fn add(&mut self, Ran { step, answer, last }: Ran) {
        self.last = last;
        if answer.is_ok() && (self.best.is_err() || !self.steps[self.chosen].is_better_than(&step)) {
            self.chosen = self.steps.len();
            self.best = answer.map(|answer| (self.last.mesh.clone(), answer));
        }
        self.steps.push(step);
    }

    pub fn last_meets(&self, error: f64) -> bool {
        self.steps.last().is_some_and(|step| step.meets(error))
    }
}

impl<'a> Search<'a> {
    pub fn new(
        backend: &'a Backend,
        given: &Scene,
        options: &'a TargetErrorOptions,
        reserve: &'a dyn Fn(&Scene) -> u64,
    ) -> Self {
        let mut scene = given.clone();
        let parents = scene.split_wide(WIDEST, options.max_triangles);
        let touched = scene.cut_along_contacts(options.max_triangles);
        let parents = touched.into_iter().map(|part| parents[part as usize]).collect();
        Self { backend, options, reserve, start: Mesh { scene, parents }, given: given.triangles.len() }
    }

    /// Why the mesh is cut before the first step.
    pub fn reasons(&self) -> Vec<String> {
        let (given, cut) = (self.given, self.start.parents.len());
        let why = || {
            format!(
                "wide triangles, and those that others touch, hide the shadows within them: the {given} triangles were first cut into {cut}"
            )
        };
        (cut > given).then(why).into_iter().collect()
    }

    /// The step at the level that usually suffices, or at the highest below it that can be run.
    ///
    /// # Errors
    /// Fails if none can be run, or if the solve is interrupted.
    pub fn first(&self, solve: &mut Solve) -> Result<Tried, SearchError> {
        let (mut level, mut barrier) = (Level::start(self.options.error), None);
        loop {
            match self.run(0, Next { level, mesh: self.start.clone() }, solve) {
                Ok(ran) => return Ok(Tried::new(ran, barrier)),
                Err(error) if level == 0 || error.is_interruption() => return Err(error),
                Err(error) => {
                    tracing::info!("level {} cannot be run: {error}", level + 1);
                    barrier = Some(error);
                    level -= 1;
                }
            }
        }
    }

    /// What the step after those so far is made with: finer settings where these cause more than their part of the target error, a finer mesh
    /// where that does, and finer settings if neither does. Else why there is none.
    pub fn after(&self, tried: &Tried) -> Result<Next, String> {
        if tried.steps.len() == MOST_STEPS {
            return Err(format!("the search ended after {MOST_STEPS} steps"));
        }
        let Last { level, mesh, of_mesh, beyond } = &tried.last;
        let allowed = PART * self.options.error;
        let room = self.options.max_triangles.saturating_sub(mesh.parents.len());
        let (mut times, more) = cuts(of_mesh, allowed, room);
        times.resize(mesh.parents.len(), 0);
        for &t in beyond {
            if times[t as usize] == 0 && added(&times) + 3 <= room {
                times[t as usize] = 1;
            }
        }
        let coarse_mesh = of_mesh.iter().any(|error| error.total() > allowed);
        let finer_mesh = times.iter().any(|&times| times > 0);
        let coarse_settings = tried.steps.last().is_none_or(|step| self.are_coarse(step, allowed));
        let wanted = level + usize::from(coarse_settings || !coarse_mesh);
        let skipped = |error: &SearchError| format!("the next step was skipped: {error}");
        let last = tried.barrier.as_ref().map_or(LEVELS.len() - 1, |_| tried.first);
        let next = wanted.min(last);
        if next == *level && !finer_mesh {
            let (triangles, allowed) = (mesh.parents.len() + more, self.options.max_triangles);
            return Err(match &tried.barrier {
                Some(error) if wanted > last => skipped(error),
                _ if coarse_mesh => skipped(&SearchError::Triangles { triangles, allowed }),
                _ => "there is no finer level".to_owned(),
            });
        }
        let mut mesh = mesh.clone();
        mesh.cut(&times);
        Ok(Next { level: next, mesh })
    }

    /// Whether rays, bins or tolerance of a step cause more than they may.
    fn are_coarse(&self, step: &Step, allowed: f64) -> bool {
        let Some(ErrorEstimate { irradiance, pictures, .. }) = &step.estimate else { return true };
        let compared = pictures.iter().map(|picture| picture.compared).fold(irradiance.compared, f64::max);
        let balance = irradiance.balance.unwrap_or(0.0);
        !step.beyond.is_empty() || compared.max(irradiance.residual) > allowed || balance > self.options.error
    }

    /// Where no solve has converged, one with fewer bins may.
    ///
    /// # Errors
    /// Fails if a level cannot be run, or if the solve is interrupted.
    pub fn coarser(&self, tried: &mut Tried, solve: &mut Solve) -> Result<(), SearchError> {
        for level in (0..tried.first).rev() {
            if tried.best.is_ok() {
                break;
            }
            tried.add(self.run(tried.steps.len(), Next { level, mesh: self.start.clone() }, solve)?);
        }
        Ok(())
    }

    /// Plans both solves of a step before either is run.
    fn plan(&self, next: Next) -> Result<Planned, SearchError> {
        let (mut mesh, level) = (next.mesh, LEVELS[next.level]);
        let level = level.with_finer(mesh.parents.len() as f64 / self.start.parents.len() as f64);
        let given = mesh.scene.settings;
        let scene = &mut mesh.scene;
        let options = PlanOptions::of(self.backend).pictures((self.reserve)(scene));
        let own = level.settings(&given);
        let plan = Plan::new(scene, &options, &own)?;
        scene.settings = own;
        let comparison = level.comparison(&given);
        let comparison_plan = Plan::new(scene, &options, &comparison)?;
        Ok(Planned { mesh, plan, comparison, comparison_plan })
    }

    /// Solves the comparison, then the scene itself. A solver that does not converge is a result, not a failure of the step. `number`: of the
    /// step, from zero.
    ///
    /// # Errors
    /// Fails if the step cannot be planned, if a solve is interrupted, or if the backend fails.
    pub fn run(&self, number: usize, next: Next, solve: &mut Solve) -> Result<Ran, SearchError> {
        let level = next.level;
        let Planned { mut mesh, plan, comparison, comparison_plan } = self.plan(next)?;
        let [comparing, solving] = stages(number);
        let scene = &mut mesh.scene;
        let own = std::mem::replace(&mut scene.settings, comparison);
        let other = self.answer(scene, comparison_plan, Warnings::default(), &comparing, solve)?;
        scene.settings = own;
        let warnings = Warnings::of(scene, &plan);
        let answer = self.answer(scene, plan, warnings, &solving, solve)?;
        let estimated = match (&answer, &other) {
            (Ok(answer), Ok(other)) => {
                let visible = Visible::of(self.backend, scene, &self.options.cameras)?;
                Some(ErrorEstimate::new(scene, answer, other, &visible, self.options.shading)?)
            }
            _ => None,
        };
        let (estimate, of_mesh) = estimated.unzip();
        let both = || [&answer, &other].into_iter();
        let least = told_from(Some(self.options.error));
        let beyond: Vec<_> = answer.iter().flat_map(|answer| answer.warnings.above(least)).collect();
        let step = Step {
            bins: own.bins.to_string(),
            rays: answer.as_ref().ok().and_then(|answer| answer.ray_error.as_ref()).map(RayError::of_each),
            tolerance: own.tolerance,
            triangles: scene.triangles.len(),
            passes: both().flatten().map(|answer| answer.info.passes).sum(),
            estimate,
            failure: both().find_map(|answer| answer.as_ref().err()).map(ToString::to_string),
            beyond: beyond.iter().map(|warning| warning.kind.name()).collect(),
        };
        let by_cuts = beyond.iter().filter(|warning| CUT.contains(&warning.kind));
        let beyond = by_cuts.flat_map(|warning| warning.triangles.iter().copied()).collect();
        tracing::info!("{step}");
        Ok(Ran { step, answer, last: Last { level, mesh, of_mesh: of_mesh.unwrap_or_default(), beyond } })
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
}

/// The comparison and the solve of a step. How many steps there will be is not known: each has half of what is left.
fn stages(number: usize) -> [Stage; 2] {
    let left = 0.5_f64.powi(number as i32);
    let stage = |name: &str, quarters: f64| Stage {
        name: format!("step {}{name}", number + 1),
        begin: 1.0 - left * (1.0 - 0.25 * quarters),
        end: 1.0 - left * (0.75 - 0.25 * quarters),
    };
    [stage(", comparison", 0.0), stage("", 1.0)]
}
