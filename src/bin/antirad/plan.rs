//! `antirad plan`.

use crate::Failure;
use crate::settings::SceneSettings;
use antirad::cli::{Interrupt, Working};
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

pub fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Failure> {
    let scene = arguments.settings.load_settled(interrupt)?;
    let usual = Limits::default();
    let limits = usual.memory_budget(arguments.settings.memory_budget.unwrap_or(usual.memory_budget));
    let working = Working::on("planning");
    let report = Plan::new(&scene, &limits, &scene.accuracy)?.report();
    drop(working);
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        println!("{report}");
    }
    Ok(())
}
