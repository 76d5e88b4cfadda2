//! `antirad check`.

use crate::Failure;
use crate::settings::MeshSettings;
use antirad::cli::{Interrupt, Working};
use antirad::plan::{Plan, PlanOptions};
use antirad::warnings::{MATTERS, Warning, Warnings};
use clap::Args;
use serde::Serialize;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad check scenes/cornell_boxes.toml
  antirad check room.obj --bins concentric:12 --all")]
pub struct Arguments {
    #[command(flatten)]
    settings: MeshSettings,
    /// Print all that was found, not only what may change the answer by more than 1 % of its light
    #[arg(long)]
    all: bool,
    /// Print all that was found as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report<'a> {
    scene: &'a str,
    triangles: usize,
    bins: String,
    /// Entries of the scene's files that are probably mistakes.
    notes: &'a [String],
    warnings: &'a [Warning],
}

pub fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Failure> {
    // `antirad plan` tells whether a solve fits in memory.
    let options = PlanOptions::default().boundless();
    let scene = arguments.settings.load_resolved(interrupt)?.scene;
    let plan = Plan::new(&scene, &options, &scene.settings)?;
    let working = Working::on("looking for causes of errors");
    let warnings = interrupt.while_computing(|| Warnings::with_shadows(&scene, &plan));
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
        antirad::say!("{}", serde_json::to_string_pretty(&report)?);
    } else {
        let told = |warning: &Warning| arguments.all || warning.effect.exceeds(MATTERS);
        let (list, rest): (Vec<_>, Vec<_>) = warnings.list.into_iter().partition(told);
        let told = Warnings { list };
        antirad::say!("{}: {} triangles, {bins} bins\n\n{told}", scene.name, scene.triangles.len());
        if !rest.is_empty() {
            let kinds: Vec<&str> = rest.iter().map(|warning| warning.kind.name()).collect();
            antirad::say!("\nbelow 1 % of the light each: {} (--all)", kinds.join(", "));
        }
    }
    Ok(())
}
