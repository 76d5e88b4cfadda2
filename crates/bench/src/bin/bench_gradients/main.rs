//! Gradients against central differences, in double precision.

mod cost;
mod curves;
mod kind;
mod loss;
mod room;
mod table;
mod traced;

use antirad::backend::Backend;
use antirad::cli::{self, BackendArguments, Interrupt};
use antirad::output::prepare_directory;
use antirad::scene::{BinLayout, LoadOptions, Scene, VisibilityChoice};
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use kind::Kind;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;

/// Compare gradients with central differences, for every kind of parameter
///
/// The error over the step is e(ε) = |fd - ∇| / (|fd| + |∇|), averaged over a fixed subset of triangles. Steps are
/// relative: to the highest emission of the scene; to 1 for δ and the albedo; to σ and p themselves; to the mean edge
/// of a triangle for its position and that of its vertices, along one fixed random direction; to the distance of the
/// camera from the middle of the scene.
#[derive(Parser)]
#[command(version, about, after_help = EXAMPLES)]
struct Arguments {
    /// Scene, TOML or OBJ [default: a Cornell room with two boxes, one of them glossy, built in]
    #[arg(long, value_name = "SCENE")]
    scene: Option<PathBuf>,
    /// Triangles in the subset
    #[arg(long, value_name = "NUMBER", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    triangles: u32,
    /// Random displacement of vertices on the jittered mesh, in mean edge lengths
    #[arg(long, value_name = "FRACTION", default_value_t = 0.05, value_parser = jitter)]
    jitter: f64,
    /// Direction bins per hemisphere: 10x13 (polar x azimuth) or concentric:12
    #[arg(long, value_name = "LAYOUT", default_value = "10x13")]
    bins: BinLayout,
    /// Kinds of parameters: emission, albedo, diffuse, specular, power, centroid, vertex, camera [default: all]
    #[arg(long, value_name = "LIST", value_delimiter = ',')]
    kinds: Vec<Kind>,
    /// Instead of errors, measure time and memory of this scene's gradients against those of its solve
    #[arg(long, value_name = "SCENE", conflicts_with_all = ["scene", "kinds", "triangles", "jitter"])]
    cost: Option<PathBuf>,
    /// Instead of errors, print the gradient where this fit starts beside that of path-traced pictures, by central
    /// differences with common random numbers. Its targets must exist: see scripts/fits
    #[arg(long, value_name = "JOB", conflicts_with_all = ["scene", "kinds", "triangles", "jitter", "cost"])]
    traced: Option<PathBuf>,
    /// Paths per pixel of each path-traced picture
    #[arg(long, value_name = "NUMBER", requires = "traced", default_value_t = 256, value_parser = clap::value_parser!(u32).range(2..))]
    samples: u32,
    /// Independent repetitions, from which the standard error follows
    #[arg(long, value_name = "NUMBER", requires = "traced", default_value_t = 8, value_parser = clap::value_parser!(u32).range(2..=1000))]
    repetitions: u32,
    /// Half width of the differences, in unknowns; that of a translation is half the diagonal of its mesh
    #[arg(long, value_name = "NUMBER", requires = "traced", default_value_t = 0.01, value_parser = step)]
    step: f64,
    /// Folder for gradients.csv and the plots
    #[arg(long, short, value_name = "DIR", default_value = "out/gradients")]
    output: PathBuf,
    #[command(flatten)]
    backend: BackendArguments,
    /// Print errors only: no progress, no table
    #[arg(short, long)]
    quiet: bool,
    /// Print the errors of every step, too
    #[arg(short, long, action = clap::ArgAction::Count)]
    verbose: u8,
}

const EXAMPLES: &str = "Examples:
  bench_gradients
  bench_gradients --triangles 2 --kinds albedo,vertex
  bench_gradients --bins concentric:12 --output out/concentric
  bench_gradients --cost scenes/cornell_boxes.toml
  bench_gradients --traced scenes/fits/box_traced_shadow.toml";

fn step(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 0.1 => Ok(value),
        _ => Err("expected a number above 0, at most 0.1".to_owned()),
    }
}

fn jitter(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.0..=0.3).contains(&value) => Ok(value),
        _ => Err("expected a number from 0 to 0.3: beyond that, triangles fold over".to_owned()),
    }
}

/// Stopped by the user: not a failure.
#[derive(Debug, thiserror::Error)]
#[error("interrupted; nothing was written")]
struct Interrupted;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::start_logging(arguments.quiet, arguments.verbose, false);
    let interrupt = Interrupt::catch();
    let result = match (&arguments.cost, &arguments.traced) {
        (Some(scene), _) => cost::run(&arguments, scene, &interrupt),
        (_, Some(job)) => traced::run(&arguments, job, &interrupt),
        _ => all(&arguments, &interrupt),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bench_gradients: {error}");
            // A solve stopped by Ctrl-C returns an error of its own.
            ExitCode::from(if interrupt.is_set() { interrupt.exit_code() } else { cli::EXIT_FAILURE })
        }
    }
}

fn backend(arguments: &Arguments) -> Result<Backend, Box<dyn Error>> {
    Ok(Backend::open(arguments.backend.backend, &arguments.backend.options(None))?)
}

fn all(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    prepare_directory(&arguments.output)?;
    let backend = backend(arguments)?;
    let mut scene = match &arguments.scene {
        Some(path) => Scene::load(path, &LoadOptions::default())?,
        None => room::room()?,
    };
    scene.settings = scene.settings.bins(arguments.bins).visibility(VisibilityChoice::Implicit);
    room::weld(&mut scene);
    let selected = |kinds: &[Kind]| -> Vec<Kind> {
        let asked = |kind: &Kind| arguments.kinds.is_empty() || arguments.kinds.contains(kind);
        kinds.iter().copied().filter(asked).collect()
    };
    let geometry = [Kind::Centroid, Kind::Vertex, Kind::Camera];
    let jittered = room::jittered(&scene, arguments.jitter)?;
    let cases = [("jittered", &jittered, selected(&Kind::ALL)), ("regular", &scene, selected(&geometry))];

    let mut benches = Vec::new();
    for (mesh, scene, kinds) in cases {
        let samples = curves::samples(scene, &kinds, arguments.triangles as usize);
        benches.push(curves::Bench { mesh, scene: scene.clone(), samples, backend: &backend, interrupt });
    }
    let bar = if arguments.quiet { ProgressBar::hidden() } else { ProgressBar::new(0) };
    if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {elapsed} elapsed, {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_length(benches.iter().map(curves::Bench::cost).sum());
    let mut rows = Vec::new();
    for bench in &benches {
        rows.extend(bench.run(&bar)?);
    }
    bar.finish_and_clear();
    table::write(&arguments.output, &rows)?;
    table::plot(&arguments.output, &rows)?;
    if !arguments.quiet {
        table::print(&rows, arguments.verbose > 0);
        antirad::say!("written to {}", arguments.output.display());
    }
    Ok(())
}
