//! Error against time, for scenes with a known solution.

mod cases;
mod measure;
mod pictures;
mod sweep;
mod table;

use antirad::backend::Backend;
use antirad::cli::{self, BackendArguments, Interrupt};
use antirad::output::prepare_directory;
use antirad::scene::BinLayout;
use cases::Case;
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use sweep::Setting;
use table::Row;

/// Measure error against cost for scenes with a known solution
///
/// Errors of irradiance, shadows and pictures, and seconds, passes and bytes, over triangles, direction bins,
/// near field, precision, solver and tolerance. The truth is a closed form, irradiance from another path tracer
/// (tests/data), or the project's own path tracer, which is checked against both.
#[derive(Parser)]
#[command(version, about, after_help = EXAMPLES)]
struct Arguments {
    /// Scene to measure; may be given several times [default: all]
    #[arg(long, value_name = "NAME")]
    scene: Vec<String>,
    /// Fewer settings, without the finest meshes: minutes instead of an hour
    #[arg(long)]
    quick: bool,
    /// Instead of measuring, draw these scenes by antiradiance and with exact lamps beside the path-traced truth,
    /// NAME_CAMERA_against_truth.png, and print a Markdown table of their errors
    #[arg(long, value_name = "SCENE", num_args = 1.., conflicts_with_all = ["scene", "quick"])]
    pictures: Vec<PathBuf>,
    /// Add a row of pictures of the scene refined as by `antirad refine`
    #[arg(long, requires = "pictures")]
    refine: bool,
    /// Add a row of pictures with these direction bins: 20x26 or concentric:12
    #[arg(long, value_name = "LAYOUT", requires = "pictures")]
    bins: Option<BinLayout>,
    /// Draw this camera only [default: all cameras of the scene]
    #[arg(long, value_name = "NAME", requires = "pictures")]
    camera: Option<String>,
    /// Paths per triangle for the truth of pictures
    #[arg(long, value_name = "NUMBER", requires = "pictures", default_value_t = cases::SAMPLES,
          value_parser = clap::value_parser!(u32).range(2..))]
    paths: u32,
    /// Folder of the project's scenes/ and tests/data/
    #[arg(long, value_name = "DIR", default_value = ".")]
    root: PathBuf,
    /// Folder for accuracy.csv and the plots
    #[arg(long, short, value_name = "DIR", default_value = "out/accuracy")]
    output: PathBuf,
    #[command(flatten)]
    backend: BackendArguments,
    /// Print errors only: no progress, no table
    #[arg(short, long)]
    quiet: bool,
    /// Print a line for each measurement, too
    #[arg(short, long, action = clap::ArgAction::Count)]
    verbose: u8,
}

const EXAMPLES: &str = "Examples:
  bench_accuracy --quick
  bench_accuracy --scene cornell_boxes --scene shadow_0.4_1 --output out/shadows
  bench_accuracy --pictures scenes/two_rooms.toml --refine --output out/pictures";

/// Stopped by Ctrl-C.
#[derive(Debug, thiserror::Error)]
#[error("interrupted; what was measured is kept")]
struct Interrupted;

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::start_logging(arguments.quiet, arguments.verbose, false);
    let interrupt = Interrupt::catch();
    match run(&arguments, &interrupt) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("bench_accuracy: {error}");
            ExitCode::from(if interrupt.is_set() { interrupt.exit_code() } else { cli::EXIT_FAILURE })
        }
    }
}

fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    if !arguments.pictures.is_empty() {
        prepare_directory(&arguments.output)?;
        let backend = Backend::open(arguments.backend.backend, &arguments.backend.options(None))?;
        return pictures::draw(arguments, &backend, interrupt);
    }
    let known = cases::NAMES;
    if let Some(unknown) = arguments.scene.iter().find(|name| !known.contains(&name.as_str())) {
        return Err(format!("there is no scene \"{unknown}\"; there are: {}", known.join(", ")).into());
    }
    let chosen = |name: &&str| arguments.scene.is_empty() || arguments.scene.iter().any(|s| s == name);
    prepare_directory(&arguments.output)?;
    let backend = Backend::open(arguments.backend.backend, &arguments.backend.options(None))?;

    let names: Vec<&str> = known.into_iter().filter(chosen).collect();
    let bar = if arguments.quiet { ProgressBar::hidden() } else { ProgressBar::new(1000) };
    if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {elapsed} elapsed, {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    let mut rows: Vec<Row> = Vec::new();
    for (k, name) in names.iter().enumerate() {
        bar.set_message(format!("{name}: truth"));
        let case = Case::new(name, &arguments.root, &backend, interrupt)?;
        let settings = sweep::settings(&case, arguments.quick);
        let asked = sweep::asked(arguments.quick);
        let total = settings.iter().map(Setting::cost).sum::<f64>() + sweep::ASKED_COST * asked.len() as f64;
        let mut done = 0.0;
        for setting in &settings {
            bar.set_message(format!("{name}: {setting}"));
            let row = measure::measure(&backend, &case, setting, interrupt)?;
            tracing::info!("{name}, {setting}: {row}");
            rows.push(row);
            // Written after each row, so that an interrupt keeps the rows so far.
            table::write(&arguments.output, &rows)?;
            done += setting.cost();
            bar.set_position(((k as f64 + done / total) / names.len() as f64 * 1000.0) as u64);
        }
        for options in &asked {
            let percent = 100.0 * options.error;
            bar.set_message(format!("{name}: settings for {percent} %"));
            let row = measure::measure_asked(&backend, &case, options, interrupt)?;
            tracing::info!("{name}, target error {percent} %: {row}");
            rows.push(row);
            table::write(&arguments.output, &rows)?;
            done += sweep::ASKED_COST;
            bar.set_position(((k as f64 + done / total) / names.len() as f64 * 1000.0) as u64);
        }
    }
    bar.finish_and_clear();
    table::plot(&arguments.output, &rows)?;
    if !arguments.quiet {
        table::print(&rows);
        antirad::say!("written to {}", arguments.output.display());
    }
    Ok(())
}
