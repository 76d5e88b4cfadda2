//! `antirad refine`.

use crate::Failure;
use crate::settings::MeshSettings;
use antirad::cli::{Interrupt, Working};
use antirad::output::prepare_directory;
use antirad::plan::PlanOptions;
use antirad::scene::TextureRefined;
use antirad::warnings::{RefineOptions, Warnings, refine};
use clap::Args;
use std::path::PathBuf;

#[derive(Args)]
#[command(
    after_help = "Cuts triangles into four at the midpoints of their edges where `antirad check` finds them too \
large: coarse blockers, and the wide sides of narrow gaps. Their neighbours stay whole: the new vertices lie on their \
edges, so no cracks open. With --texture also where textures and colours of corners vary: the parts get materials with their own \
means, and the finer scene has these in place of the texture.

Examples:
  antirad refine scenes/two_rooms.toml --output out/fine
  antirad render out/fine/two_rooms.toml
  antirad refine room.glb --texture 0.05 --output out/fine"
)]
pub struct Arguments {
    #[command(flatten)]
    settings: MeshSettings,
    /// Folder for the finer scene: SCENE.toml, with its meshes and materials beside it
    #[arg(long, short, value_name = "DIR")]
    output: PathBuf,
    /// Maximum number of triangles of the finer scene
    #[arg(long, value_name = "NUMBER", default_value_t = RefineOptions::default().max_triangles)]
    max_triangles: usize,
    /// Maximum number of times that a triangle is cut
    #[arg(long, value_name = "NUMBER", default_value_t = RefineOptions::default().levels)]
    levels: u32,
    /// Also cut triangles over which a texture varies: by more than TOLERANCE of albedo, or as much of the brightest emission
    #[arg(long, value_name = "TOLERANCE", num_args = 0..=1, default_missing_value = "0.1", value_parser = tolerance)]
    texture: Option<f64>,
}

fn tolerance(text: &str) -> Result<f64, String> {
    match text.parse() {
        Ok(tolerance) if tolerance > 0.0 && tolerance < 1.0 => Ok(tolerance),
        _ => Err(String::from("a number between 0 and 1 is expected")),
    }
}

pub fn run(arguments: &Arguments, quiet: bool, interrupt: &Interrupt) -> Result<(), Failure> {
    let mut scene = arguments.settings.load_resolved(interrupt)?.scene;
    let triangles = scene.triangles.len();
    let options = RefineOptions::default().max_triangles(arguments.max_triangles).levels(arguments.levels);
    let working = Working::on("refining");
    let textured = arguments.texture.map(|tolerance| {
        interrupt.while_computing(|| scene.refine_textures(tolerance, options.max_triangles, options.levels))
    });
    let refined = interrupt.while_computing(|| refine(&mut scene, &PlanOptions::default(), &options))?;
    drop(working);
    prepare_directory(&arguments.output)?;
    let path = arguments.output.join(format!("{}.toml", scene.name));
    scene.save(&path)?;
    if quiet {
        return Ok(());
    }
    antirad::say!(
        "triangles   {triangles} before, {} after {} rounds",
        scene.triangles.len(),
        refined.rounds
    );
    if let Some(TextureRefined { parents, rounds, full }) = &textured {
        antirad::say!("textures    {} triangles after {rounds} rounds", parents.len());
        if *full {
            antirad::say!("            more would be cut, but for --max-triangles {}", options.max_triangles);
        }
    }
    for (mesh, cut) in &refined.cut {
        antirad::say!("            {cut} triangles of mesh \"{mesh}\" were cut");
    }
    antirad::say!("warnings    before: {}", summary(&refined.before));
    antirad::say!("            after: {}", summary(&refined.after));
    if refined.full {
        antirad::say!("            more would be cut, but for --max-triangles {}", options.max_triangles);
    }
    antirad::say!("written     {}", path.display());
    Ok(())
}

fn summary(warnings: &Warnings) -> String {
    let each = warnings
        .list
        .iter()
        .map(|w| format!("{} {} ({:.2} % of the area)", w.count, w.kind.name(), 100.0 * w.area_share));
    let all = each.collect::<Vec<_>>().join(", ");
    if all.is_empty() { "none".to_owned() } else { all }
}
