//! From an error that is asked to settings that keep it: climbs from cheap settings to exact ones, solves each with a
//! companion of other bins and a smaller near field, and stops where the two agree. docs/accuracy.md says what the rungs were
//! chosen by.

mod estimate;
mod rungs;

pub use estimate::Estimate;
pub use rungs::{Layout, layout, usual_accuracy};

use crate::gpu::Device;
use crate::plan::{Limits, Plan, PlanError};
use crate::scene::{Accuracy, Scene};
use crate::{Engine, EngineError, Solution};
use rungs::{Rung, is_directional, mean_albedo, near_field};
use serde::Serialize;
use std::fmt;

/// What is asked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LadderOptions {
    /// Relative L2 error of irradiance over the scene, 0.05 for 5 %.
    pub error: f64,
    /// Triangles that the scene may be cut to.
    pub max_triangles: usize,
}

impl LadderOptions {
    /// What is allowed if nobody says otherwise.
    pub const MAX_TRIANGLES: usize = 200_000;

    /// With room for [`LadderOptions::MAX_TRIANGLES`].
    pub fn new(error: f64) -> Self {
        Self { error, max_triangles: Self::MAX_TRIANGLES }
    }
}

/// One rung that was tried.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// `10x13`, `concentric:12`.
    pub bins: String,
    /// How the hemisphere is cut.
    pub layout: Layout,
    /// The range of the near field.
    pub subsample: f64,
    /// The relative residual at which the solver stopped.
    pub tolerance: f64,
    /// Times that every triangle was cut into four.
    pub cuts: u32,
    /// After cutting.
    pub triangles: usize,
    /// Of the solve and its companion together.
    pub passes: u32,
    /// `None` where a solve failed.
    pub estimate: Option<Estimate>,
    /// How it failed.
    pub failure: Option<String>,
}

/// How the settings were found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Climb {
    /// What was asked.
    pub error: f64,
    /// Whether the estimate of the last step is within it.
    pub met: bool,
    /// Whole sentences: why these bins and this near field, and why it ended above the error, if it did.
    pub why: Vec<String>,
    /// In the order in which they were tried.
    pub steps: Vec<Step>,
}

/// A scene solved as well as was asked.
pub struct Solved {
    /// As it was solved: its triangles are cut, and `accuracy` are the settings found.
    pub scene: Scene,
    /// Per triangle of that scene, the one of the given scene that it is a part of.
    pub parents: Vec<u32>,
    /// Of the given triangles, m².
    areas: Vec<f64>,
    /// Of the last step.
    pub engine: Engine,
    /// Of the last step, on the triangles of `scene`.
    pub solution: Solution,
    /// How the settings were found.
    pub climb: Climb,
}

impl Solved {
    /// Values per triangle of the solved scene, as means over area on the triangles of the given one: a row for each.
    pub fn on_given(&self, values: &[[f64; 3]]) -> Vec<[f64; 3]> {
        self.scene.means_on(&self.parents, &self.areas, values)
    }
}

/// Solves `scene` to the error asked, or as near to it as memory and `max_triangles` allow: see [`Climb::met`]. The scene's own
/// bins, near field and tolerance are not used; its other settings are.
///
/// `reserve` says how many bytes of the device pictures of a scene will need; `solve` runs the solver, with what progress and
/// interruption the caller likes, to `scene.accuracy.tolerance`.
pub fn solve_within(
    device: &Device,
    scene: &Scene,
    options: &LadderOptions,
    reserve: &dyn Fn(&Scene) -> u64,
    solve: &mut Solve,
) -> Result<Solved, EngineError> {
    let ground = Ground::new(device, scene, options, reserve);
    let ladder = Rung::ladder(ground.directional);
    // Rather less exact than not at all: the start is the highest rung that fits.
    let mut number = Rung::start(ladder, options.error);
    let mut trial = loop {
        match ground.trial(&ladder[number]) {
            Err(NoRoom::Plan(error)) if number == 0 => return Err(error.into()),
            Err(_) => number -= 1,
            Ok(trial) => break trial,
        }
    };
    let (mut steps, mut why) = (Vec::new(), vec![ground.reason()]);
    let (reached, met) = loop {
        let (step, reached) = trial.run(&ground, solve)?;
        tracing::info!("{step}");
        let met = step.estimate.is_some_and(|estimate| estimate.total <= options.error);
        steps.push(step);
        number += 1;
        if met || number == ladder.len() {
            break (reached, met);
        }
        trial = match ground.trial(&ladder[number]) {
            Ok(trial) => trial,
            Err(reason) => {
                why.push(format!("the next step was left out: {reason}"));
                break (reached, met);
            }
        };
        // Its memory goes back before the next one takes its own.
        drop(reached);
    };
    let Reached { scene, parents, engine, solution } = reached?;
    let climb = Climb { error: options.error, met, why, steps };
    Ok(Solved { scene, parents, areas: ground.areas, engine, solution, climb })
}

/// Runs a solver to the tolerance of the scene.
pub type Solve<'a> = dyn FnMut(&mut Engine, &Scene) -> Result<Solution, EngineError> + 'a;

/// What all rungs share.
struct Ground<'a> {
    device: &'a Device,
    /// What was free before the first step: each has all of it, since the one before is given up.
    limits: Limits,
    scene: &'a Scene,
    options: &'a LadderOptions,
    reserve: &'a dyn Fn(&Scene) -> u64,
    /// Of the given triangles, m².
    areas: Vec<f64>,
    /// Whether there is shadow or gloss.
    directional: bool,
    /// Mean over area.
    albedo: f64,
    /// The least range of the near field.
    near: f64,
}

/// Why a rung cannot be tried.
#[derive(Debug, thiserror::Error)]
enum NoRoom {
    #[error(transparent)]
    Plan(#[from] PlanError),
    #[error("it takes {triangles} triangles, and {allowed} are allowed (--max-triangles)")]
    Triangles { triangles: usize, allowed: usize },
}

/// A rung, ready to be solved.
struct Trial {
    scene: Scene,
    parents: Vec<u32>,
    plan: Plan,
    companion: Accuracy,
    layout: Layout,
    cuts: u32,
}

struct Reached {
    scene: Scene,
    parents: Vec<u32>,
    engine: Engine,
    solution: Solution,
}

impl<'a> Ground<'a> {
    fn new(
        device: &'a Device,
        scene: &'a Scene,
        options: &'a LadderOptions,
        reserve: &'a dyn Fn(&Scene) -> u64,
    ) -> Self {
        let areas: Vec<f64> = (0..scene.triangles.len()).map(|i| scene.area_vector(i).length()).collect();
        Self {
            device,
            limits: Limits::of(device),
            scene,
            options,
            reserve,
            areas,
            directional: is_directional(scene),
            albedo: mean_albedo(scene),
            near: near_field(mean_albedo(scene), options.error),
        }
    }

    fn reason(&self) -> String {
        format!(
            "surfaces reflect {:.0} % on average: a near field of {} or more keeps what the bounces lose within half the \
             error",
            100.0 * self.albedo,
            self.near
        )
    }

    fn trial(&self, rung: &Rung) -> Result<Trial, NoRoom> {
        let triangles = self.scene.triangles.len().saturating_mul(4_usize.saturating_pow(rung.cuts));
        if rung.cuts > 0 && triangles > self.options.max_triangles {
            return Err(NoRoom::Triangles { triangles, allowed: self.options.max_triangles });
        }
        let mut scene = self.scene.clone();
        let parents = scene.split_all(rung.cuts);
        let given = &self.scene.accuracy;
        let layout = layout(&scene, &rung.accuracy(Layout::EqualAngle, self.near, given))?;
        scene.accuracy = rung.accuracy(layout, self.near, given);
        let plan = self.plan(&scene, &scene.accuracy)?;
        let companion = rung.companion(layout, self.near, given);
        Ok(Trial { scene, parents, plan, companion, layout, cuts: rung.cuts })
    }

    fn plan(&self, scene: &Scene, accuracy: &Accuracy) -> Result<Plan, PlanError> {
        let limits = Limits { pictures: (self.reserve)(scene), ..self.limits };
        Plan::new(scene, &limits, accuracy)
    }
}

impl Trial {
    /// Solves the companion, then the scene itself. That a solver finds no answer is a result.
    fn run(
        self,
        ground: &Ground,
        solve: &mut Solve,
    ) -> Result<(Step, Result<Reached, EngineError>), EngineError> {
        let Self { mut scene, parents, plan, companion, layout, cuts } = self;
        let own = std::mem::replace(&mut scene.accuracy, companion);
        let other = ground.plan(&scene, &companion)?;
        let other =
            Engine::new(ground.device, &scene, other).and_then(|mut engine| solve(&mut engine, &scene));
        let other = unless_stopped(other)?;
        scene.accuracy = own;
        let mut engine = Engine::new(ground.device, &scene, plan)?;
        let solved = unless_stopped(solve(&mut engine, &scene))?;
        let on_given = |s: &Solution| scene.means_on(&parents, &ground.areas, &s.irradiance);
        let estimate = match (&solved, &other) {
            (Ok(solution), Ok(other)) => Some(Estimate::new(
                [&on_given(solution), &on_given(other)],
                layout.ratio(),
                &ground.areas,
                &scene,
                solution,
            )),
            _ => None,
        };
        let passes = [&solved, &other].into_iter().flatten().map(|solution| solution.info.passes).sum();
        let step = Step {
            bins: own.bins.to_string(),
            layout,
            subsample: own.subsample,
            tolerance: own.tolerance,
            cuts,
            triangles: scene.triangles.len(),
            passes,
            estimate,
            failure: [&solved, &other].into_iter().find_map(|s| s.as_ref().err()).map(ToString::to_string),
        };
        Ok((step, solved.map(|solution| Reached { scene, parents, engine, solution })))
    }
}

/// Solvers that find no answer go into the inner result, all else into the outer.
fn unless_stopped(
    result: Result<Solution, EngineError>,
) -> Result<Result<Solution, EngineError>, EngineError> {
    match result {
        Err(error) if error.is_without_answer() => Ok(Err(error)),
        Err(error) => Err(error),
        Ok(solution) => Ok(Ok(solution)),
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bins, subsample, cuts, triangles, .. } = self;
        write!(f, "{bins} bins, near field {subsample}, {triangles} triangles")?;
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
