//! `antirad plan`.

use crate::Failure;
use crate::settings::SceneSettings;
use antirad::backend::{Backend, BackendChoice};
use antirad::cli::Interrupt;
use antirad::plan::{Plan, PlanOptions, PlanReport};
use antirad::resolve::{Decision, ResolveOptions};
use antirad::scene::Scene;
use clap::Args;
use serde::Serialize;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad plan scenes/statue.toml --memory-budget 256MiB
  antirad plan room.obj --bins concentric:12 --json")]
pub struct Arguments {
    #[command(flatten)]
    settings: SceneSettings,
    /// Print the plan as JSON
    #[arg(long)]
    json: bool,
}

/// A plan, and the decisions that it follows.
#[derive(Serialize)]
struct Planned<'a> {
    resolved: &'a [Decision],
    #[serde(flatten)]
    plan: PlanReport,
}

pub fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Failure> {
    let SceneSettings { backend, memory_budget, .. } = &arguments.settings;
    let options = |scene: &Scene| {
        let stated = Some(scene.settings.backend).filter(|choice| *choice != BackendChoice::Auto);
        let usual = match stated.or_else(BackendChoice::of_environment) {
            Some(BackendChoice::Vulkan) => PlanOptions::lavapipe(),
            None | Some(BackendChoice::Auto) if backend.device.is_some() => PlanOptions::lavapipe(),
            _ => PlanOptions::of(Backend::cpu()),
        };
        usual.memory_budget(memory_budget.unwrap_or(usual.memory_budget))
    };
    let resolved = arguments.settings.load_resolved(&ResolveOptions::default(), interrupt)?;
    let scene = &resolved.scene;
    let plan = Plan::new(scene, &options(scene), &scene.settings)?;
    let report = plan.report();
    if arguments.json {
        let all = Planned { resolved: &resolved.decisions, plan: report };
        antirad::say!("{}", serde_json::to_string_pretty(&all)?);
    } else {
        for decision in &resolved.decisions {
            antirad::say!("{decision}");
        }
        antirad::say!("\n{report}");
    }
    Ok(())
}
