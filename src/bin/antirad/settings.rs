//! Options that several commands share.

use crate::Failure;
use antirad::cli::{Interrupt, Working, parse_size};
use antirad::plan::{Plan, PlanOptions};
use antirad::scene::{BinLayout, Choice, LoadOptions, Precision, Scene, SolverChoice};
use antirad::target_error::{usual_plan, usual_settings};
use clap::Args;
use std::path::PathBuf;

#[derive(Args)]
pub struct SceneSettings {
    /// A scene in TOML, or a bare OBJ
    pub scene: PathBuf,
    /// Find bins, near field, mesh and tolerance for a relative error of irradiance, e.g. 0.02
    /// and of the pictures
    #[arg(long, value_name = "ERROR", value_parser = parse_error, conflicts_with_all = ["bins", "tolerance"])]
    target_error: Option<f64>,
    /// The former name of --target-error
    #[arg(long, hide = true, value_parser = parse_error, conflicts_with_all = ["target_error", "bins", "tolerance"])]
    settings: Option<f64>,
    /// Direction bins per hemisphere: 10x13 (polar x azimuth) or concentric:12 [default: 10x13, or concentric:10 where
    /// blockers are coarse]
    #[arg(long, value_name = "LAYOUT")]
    bins: Option<BinLayout>,
    /// Relative residual at which the solve stops
    #[arg(long, value_name = "NUMBER", value_parser = parse_tolerance)]
    tolerance: Option<f64>,
    /// Passes after which the solve gives up
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..))]
    max_passes: Option<u32>,
    /// Which solver to run
    #[arg(long, value_name = "SOLVER", value_enum)]
    solver: Option<SolverChoice>,
    /// Numbers of the device: packed is faster where much is hidden, f64 is for validation and needs a device that has it
    #[arg(long, value_name = "NUMBERS", value_enum)]
    precision: Option<Precision>,
    /// Device memory to use at most, e.g. 512MiB [default: what the device has]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub memory_budget: Option<u64>,
    /// Refuse triangles without area instead of leaving them out
    #[arg(long)]
    strict: bool,
}

impl SceneSettings {
    /// The scene, with the accuracy of its file where the command line has none. A target error stays an open choice, as do
    /// bins and near field that nobody states.
    pub fn load(&self) -> Result<Scene, Failure> {
        let _working = Working::on("reading the scene");
        let mut scene = Scene::load(&self.scene, &LoadOptions::default().strict(self.strict))?;
        let file = scene.settings;
        scene.settings = file
            .bins(self.bins.unwrap_or(file.bins))
            .tolerance(self.tolerance.unwrap_or(file.tolerance))
            .max_passes(self.max_passes.unwrap_or(file.max_passes))
            .solver(self.solver.unwrap_or(file.solver))
            .precision(self.precision.unwrap_or(file.precision));
        if self.settings.is_some() {
            tracing::warn!(
                "--accuracy is called --target-error now; the old name will go with the next version"
            );
        }
        let stated = self.bins.is_some();
        scene.choice = match (self.target_error.or(self.settings), scene.choice) {
            (Some(error), _) => Choice::Within(error),
            (None, Choice::Within(_)) if stated || self.tolerance.is_some() => {
                Choice::Open { bins: !stated, near_field: true }
            }
            (None, Choice::Open { bins, near_field }) => Choice::Open { bins: bins && !stated, near_field },
            (None, within) => within,
        };
        for warning in &scene.warnings {
            tracing::warn!("{warning}");
        }
        Ok(scene)
    }

    /// For commands that do not solve to a target error: says that they take the usual settings.
    pub fn load_settled(&self, interrupt: &Interrupt) -> Result<Scene, Failure> {
        let mut scene = self.load_usual()?;
        let _working = Working::on("choosing bins");
        scene.settings = interrupt.while_computing(|| usual_settings(&scene));
        Ok(scene)
    }

    /// The same with its plan.
    pub fn load_planned(
        &self,
        options: &PlanOptions,
        interrupt: &Interrupt,
    ) -> Result<(Scene, Plan), Failure> {
        let mut scene = self.load_usual()?;
        let _working = Working::on("planning");
        let (settings, plan) = interrupt.while_computing(|| usual_plan(&scene, options))?;
        scene.settings = settings;
        Ok((scene, plan))
    }

    fn load_usual(&self) -> Result<Scene, Failure> {
        let mut scene = self.load()?;
        if let Choice::Within(error) = scene.choice {
            tracing::warn!(
                "settings for an error of {error} are found while `antirad render` solves; these are the usual ones"
            );
            scene.choice = Choice::default();
        }
        Ok(scene)
    }
}

fn parse_error(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(error) if error > 0.0 && error < 1.0 => Ok(error),
        Ok(_) => Err("an error lies between 0 and 1; 0.02 is 2 %".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(tolerance) if (1e-13..1.0).contains(&tolerance) => Ok(tolerance),
        Ok(_) => Err("a tolerance lies between 1e-13 (f32 can tell 1e-7) and 1".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}
