//! Options that several commands share.

use crate::Failure;
use antirad::cli::{
    BackendArguments, Interrupt, LAMPS, ORIENTATIONS, PRECISIONS, SOLVERS, VISIBILITIES, Working, parse_size,
    word,
};
use antirad::resolve::{ResolveOptions, Resolved, resolve};
use antirad::scene::{
    BinLayout, Lamps, LoadOptions, Orient, Precision, Scene, Sky, SolverChoice, VisibilityChoice,
};
use clap::Args;
use std::path::{Path, PathBuf};

/// A scene, and how to read it.
#[derive(Args)]
pub struct SceneFile {
    /// Scene in TOML, or a file of another program: OBJ, PLY, glTF, Mitsuba XML
    pub scene: PathBuf,
    /// Refuse what is otherwise mended or left out with a warning: triangles without area, materials of mesh files that
    /// reflect all light or more, missing materials
    #[arg(long)]
    strict: bool,
    /// Turn faces of mesh files where their closed shell says which way they should face (auto), or keep all as they are
    #[arg(long, value_name = "HOW", value_parser = word::<Orient>(ORIENTATIONS), default_value = "auto")]
    orient: Orient,
    /// Give open sheets a second side, which reflects and blocks light like the first
    #[arg(long)]
    two_sided: bool,
    /// Make mesh files as scans give them fit for light, within this distance in metres, a few times the error of a vertex: walls become
    /// planes, gaps close, lamps become planar or convex
    #[arg(long, value_name = "METRES")]
    snap: Option<f64>,
    /// Most triangles of a mesh file: those with more are simplified; 0 keeps all [default: 10000 with --snap, else 0]
    #[arg(long, value_name = "TRIANGLES")]
    simplify: Option<u32>,
    /// Light from all around: a radiance in W/(m² sr), one number or R,G,B, or an equirectangular picture (HDR, EXR, PNG, JPEG)
    #[arg(long, value_name = "RADIANCE|FILE", value_parser = parse_sky)]
    sky: Option<Sky>,
}

impl SceneFile {
    /// Reads the scene, and says what it warns of.
    pub fn load(&self) -> Result<Scene, Failure> {
        let _working = Working::on("reading the scene");
        let options = LoadOptions::default()
            .strict(self.strict)
            .orient(self.orient)
            .two_sided(self.two_sided)
            .snap(self.snap)
            .simplify(self.simplify)
            .sky(self.sky.clone());
        let scene = Scene::load(&self.scene, &options)?;
        for warning in &scene.warnings {
            tracing::warn!("{warning}");
        }
        Ok(scene)
    }
}

/// A scene, and what decides which of its triangles are too coarse.
#[derive(Args)]
pub struct MeshSettings {
    #[command(flatten)]
    pub file: SceneFile,
    /// Direction bins per hemisphere: 10x13 (polar x azimuth) or concentric:12 [default: 10x13, or concentric:10 where
    /// blockers are coarse]
    #[arg(long, value_name = "LAYOUT")]
    bins: Option<BinLayout>,
    /// Light that comes straight from emitters: sampled, by rays where much stands in between; exact; by antiradiance through bins; or
    /// auto: sampled, but exact where visibility is implicit and that is affordable
    #[arg(long, value_name = "HOW", value_parser = word::<Lamps>(LAMPS))]
    lamps: Option<Lamps>,
    /// How blockers keep light from what is behind them: by rays (explicit), or by antiradiance (implicit) [default: explicit]
    #[arg(long, value_name = "HOW", value_parser = word::<VisibilityChoice>(VISIBILITIES))]
    visibility: Option<VisibilityChoice>,
}

impl MeshSettings {
    /// The scene, with the settings of its file where the command line states none.
    fn load(&self) -> Result<Scene, Failure> {
        let mut scene = self.file.load()?;
        let file = scene.settings;
        scene.settings = file
            .bins(self.bins.unwrap_or(file.bins))
            .lamps(self.lamps.unwrap_or(file.lamps))
            .visibility(self.visibility.unwrap_or(file.visibility));
        if self.bins.is_some() {
            scene.target_error = None;
        }
        Ok(scene)
    }

    /// The scene as given, with all settings resolved, for commands that do not solve to a target error.
    pub fn load_resolved(&self, interrupt: &Interrupt) -> Result<Resolved, Failure> {
        resolved(self.load()?, &ResolveOptions::default().cut(false), interrupt)
    }
}

/// A scene and all settings of its solve.
#[derive(Args)]
pub struct SceneSettings {
    #[command(flatten)]
    pub mesh: MeshSettings,
    /// Relative residual at which the solve stops
    #[arg(long, value_name = "NUMBER", value_parser = parse_tolerance)]
    tolerance: Option<f64>,
    /// Passes after which the solve gives up without convergence
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..))]
    max_passes: Option<u32>,
    /// Solver of the radiosity equation
    #[arg(long, value_name = "SOLVER", value_parser = word::<SolverChoice>(SOLVERS))]
    solver: Option<SolverChoice>,
    /// Arithmetic: f64 is for validation, and on a Vulkan device needs double precision
    #[arg(long, value_name = "PRECISION", value_parser = word::<Precision>(PRECISIONS))]
    precision: Option<Precision>,
    /// Standard error of the irradiance that rays bring, relative to its mean over the area [default: 0.005]
    #[arg(long, value_name = "NUMBER")]
    ray_error: Option<f64>,
    #[command(flatten)]
    pub backend: BackendArguments,
    /// Limit of the backend's memory, e.g. 512MiB [default: what the device has; on the CPU three quarters of the system's]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    pub memory_budget: Option<u64>,
}

impl SceneSettings {
    /// The scene, with the settings of its file where the command line states none.
    pub fn load(&self) -> Result<Scene, Failure> {
        let mut scene = self.mesh.load()?;
        let file = scene.settings;
        scene.settings = file
            .tolerance(self.tolerance.unwrap_or(file.tolerance))
            .max_passes(self.max_passes.unwrap_or(file.max_passes))
            .solver(self.solver.unwrap_or(file.solver))
            .precision(self.precision.unwrap_or(file.precision))
            .ray_error(self.ray_error.unwrap_or(file.ray_error))
            .backend(self.backend.backend.unwrap_or(file.backend));
        if self.tolerance.is_some() {
            scene.target_error = None;
        }
        Ok(scene)
    }

    /// The scene resolved, for commands that do not solve to a target error.
    pub fn load_resolved(
        &self,
        options: &ResolveOptions,
        interrupt: &Interrupt,
    ) -> Result<Resolved, Failure> {
        resolved(self.load()?, options, interrupt)
    }
}

/// A scene resolved, without its target error.
pub fn resolved(scene: Scene, options: &ResolveOptions, interrupt: &Interrupt) -> Result<Resolved, Failure> {
    let scene = without_target(scene);
    let _working = Working::on("cutting the mesh");
    let resolved = interrupt.while_computing(|| resolve(&scene, options))?;
    for decision in &resolved.decisions {
        tracing::info!("{decision}");
    }
    Ok(resolved)
}

/// The scene without the target error that its file states.
fn without_target(mut scene: Scene) -> Scene {
    if let Some(error) = scene.target_error.take() {
        tracing::warn!(
            "only `antirad render` finds settings for a target error of {error}; this command takes the stated ones"
        );
    }
    scene
}

fn parse_sky(text: &str) -> Result<Sky, String> {
    let numbers: Option<Vec<f64>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
    let radiance = match numbers.as_deref() {
        None => {
            let read = Sky::read(Path::new(text), [1.0; 3]);
            return read.map_err(|message| format!("the picture {message}"));
        }
        Some(&[grey]) => [grey; 3],
        Some(&[r, g, b]) => [r, g, b],
        Some(_) => return Err("one number, three numbers R,G,B, or a picture is expected".to_owned()),
    };
    let sky = Sky::uniform(radiance);
    sky.check().map(|()| sky).map_err(|message| format!("it {message}"))
}

pub fn parse_error(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(error) if error > 0.0 && error < 1.0 => Ok(error),
        Ok(_) => Err("an error must be between 0 and 1; 0.02 is 2 %".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

fn parse_tolerance(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(tolerance) if (1e-13..1.0).contains(&tolerance) => Ok(tolerance),
        Ok(_) => Err("a tolerance must be between 1e-13 (f32 resolves 1e-7) and 1".to_owned()),
        Err(error) => Err(error.to_string()),
    }
}
