//! Options that several commands share.

use antirad::cli::parse_size;
use antirad::scene::{Accuracy, BinLayout, LoadOptions, Precision, Scene, SceneError, SolverChoice};
use clap::Args;
use std::path::PathBuf;

#[derive(Args)]
pub struct SceneSettings {
    /// A scene in TOML, or a bare OBJ
    pub scene: PathBuf,
    /// Direction bins per hemisphere: 10x13 (polar x azimuth) or concentric:12
    #[arg(long, value_name = "LAYOUT")]
    bins: Option<BinLayout>,
    /// Relative residual at which the solve stops
    #[arg(long, value_name = "NUMBER", value_parser = parse_tolerance)]
    tolerance: Option<f64>,
    /// Passes after which the solve gives up
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..))]
    max_passes: Option<u32>,
    /// Which solver to run
    #[arg(long, value_name = "auto|fixed-point|gmres", value_parser = parse_solver)]
    solver: Option<SolverChoice>,
    /// Numbers of the device: packed is faster where much is hidden, f64 is for validation and needs a device that has it
    #[arg(long, value_name = "f32|packed|f64", value_parser = parse_precision)]
    precision: Option<Precision>,
    /// Device memory to use at most, e.g. 512MiB [default: what the device has]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub memory_budget: Option<u64>,
    /// Refuse triangles without area instead of leaving them out
    #[arg(long)]
    strict: bool,
}

impl SceneSettings {
    /// The scene, with the accuracy of its file where the command line has none.
    pub fn load(&self) -> Result<Scene, SceneError> {
        let mut scene = Scene::load(&self.scene, &LoadOptions { strict: self.strict })?;
        let file = scene.accuracy;
        scene.accuracy = Accuracy {
            bins: self.bins.unwrap_or(file.bins),
            tolerance: self.tolerance.unwrap_or(file.tolerance),
            max_passes: self.max_passes.unwrap_or(file.max_passes),
            solver: self.solver.unwrap_or(file.solver),
            precision: self.precision.unwrap_or(file.precision),
            ..file
        };
        for warning in &scene.warnings {
            tracing::warn!("{warning}");
        }
        Ok(scene)
    }
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(tolerance) if (1e-13..1.0).contains(&tolerance) => Ok(tolerance),
        Ok(_) => Err("a tolerance lies between 1e-13 (f32 can tell 1e-7) and 1".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

fn parse_precision(text: &str) -> Result<Precision, String> {
    match text {
        "f32" => Ok(Precision::F32),
        "packed" => Ok(Precision::Packed),
        "f64" => Ok(Precision::F64),
        _ => Err("f32, packed or f64".to_owned()),
    }
}

fn parse_solver(text: &str) -> Result<SolverChoice, String> {
    match text {
        "auto" => Ok(SolverChoice::Auto),
        "fixed-point" => Ok(SolverChoice::FixedPoint),
        "gmres" => Ok(SolverChoice::Gmres),
        _ => Err("auto, fixed-point or gmres".to_owned()),
    }
}
