//! `antirad plan`.

use crate::Failure;
use crate::settings::SceneSettings;
use antirad::plan::{Limits, Plan};
use clap::Args;

#[derive(Args)]
pub struct Arguments {
    #[command(flatten)]
    settings: SceneSettings,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

pub fn run(arguments: &Arguments) -> Result<(), Failure> {
    let scene = arguments.settings.load_settled()?;
    let usual = Limits::default();
    let limits =
        Limits { memory_budget: arguments.settings.memory_budget.unwrap_or(usual.memory_budget), ..usual };
    let report = Plan::new(&scene, &limits, &scene.accuracy)?.report();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        println!("{report}");
    }
    Ok(())
}
