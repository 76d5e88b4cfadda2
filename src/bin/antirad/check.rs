//! `antirad check`.

use crate::Failure;
use crate::settings::SceneSettings;
use antirad::cli::{Interrupt, Working};
use antirad::plan::PlanOptions;
use antirad::warnings::{Warning, Warnings};
use clap::Args;
use serde::Serialize;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad check scenes/cornell_boxes.toml
  antirad check room.obj --bins concentric:12 --json")]
pub struct Arguments {
    #[command(flatten)]
    settings: SceneSettings,
    /// Print JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    scene: &'a str,
    triangles: usize,
    bins: String,
    /// What the scene's files say that may not be meant.
    notes: &'a [String],
    warnings: &'a [Warning],
}

pub fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Failure> {
    // Whether a solve fits the memory is the matter of `antirad plan`.
    let options = PlanOptions::default().boundless();
    let (scene, plan) = arguments.settings.load_planned(&options, interrupt)?;
    let working = Working::on("looking for what will come out wrong");
    let warnings = interrupt.while_computing(|| Warnings::of(&scene, &plan));
    drop(working);
    let bins = scene.settings.bins.to_string();
    if arguments.json {
        let report = Report {
            scene: &scene.name,
            triangles: scene.triangles.len(),
            bins,
            notes: &scene.warnings,
            warnings: &warnings.list,
        };
        println!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        println!("{}: {} triangles, {bins} bins\n\n{warnings}", scene.name, scene.triangles.len());
    }
    Ok(())
}
