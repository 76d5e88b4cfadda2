//! `antirad plan`.

use crate::Failure;
use crate::settings::SceneSettings;
use antirad::backend::{Backend, BackendChoice};
use antirad::cli::Interrupt;
use antirad::plan::PlanOptions;
use clap::Args;

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

pub fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Failure> {
    let stated = arguments.settings.backend.backend.or_else(BackendChoice::of_environment);
    let usual = match stated {
        Some(BackendChoice::Vulkan) => PlanOptions::lavapipe(),
        _ => PlanOptions::of(Backend::cpu()),
    };
    let options = usual.memory_budget(arguments.settings.memory_budget.unwrap_or(usual.memory_budget));
    let (_, plan) = arguments.settings.load_planned(&options, interrupt)?;
    let report = plan.report();
    if arguments.json {
        antirad::say!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        antirad::say!("{report}");
    }
    Ok(())
}
