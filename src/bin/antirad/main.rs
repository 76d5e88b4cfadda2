//! The command-line tool `antirad`.

mod ambiguity;
mod cameras;
mod check;
mod compare;
mod compare_pictures;
mod devices;
mod export;
mod fit;
mod lamps;
mod plan;
mod refine;
mod render;
mod report;
mod settings;
mod status;
mod together;
mod trace;

use antirad::cli::{self, Interrupt};
use clap::{Parser, Subcommand};
use std::process::ExitCode;
use together::Together;

/// Display order of the global options: after those of each command, which count from 0.
const LAST: usize = 100;

/// Render scenes with global illumination, and recover scenes from pictures, by differentiable radiosity.
#[derive(Parser)]
#[command(version, about, after_help = EXAMPLES)]
struct Arguments {
    /// Print errors only: no progress, summary or warnings
    #[arg(short, long, global = true, display_order = LAST)]
    quiet: bool,
    /// Print more: once for the main steps, twice for everything
    #[arg(short, long, global = true, display_order = LAST, action = clap::ArgAction::Count)]
    verbose: u8,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  antirad render scenes/cornell_boxes.toml --output out/cornell
  antirad render bunny.obj --bins concentric:12 --tolerance 1e-3
  antirad trace scenes/cornell_boxes.toml --samples 256
  antirad fit jobs/ --output out/fits --resume
  antirad status out/fits --watch
  antirad ambiguity scenes/two_rooms.toml --camera main
  antirad compare scenes/cornell_boxes.toml out/fits/cornell/scene.toml
  antirad plan scenes/statue.toml --memory-budget 256MiB
  antirad check scenes/two_rooms.toml
  antirad refine scenes/two_rooms.toml --output out/fine
  antirad export scenes/two_rooms.toml --format gltf
  antirad devices";

#[derive(Subcommand)]
enum Command {
    /// Solve a scene and render pictures of it
    ///
    /// Started several times by `mpirun`, where it was built with MPI, the processes share the work on one scene.
    Render(render::Arguments),
    /// Path-trace pictures of a scene: the ground truth, with noise
    ///
    /// Unbiased, on all cores of the CPU, without a Vulkan device. Settings of the solve do not matter. Each picture comes
    /// with the standard error of its pixels.
    Trace(trace::Arguments),
    /// Fit scenes to pictures (inverse rendering), in one job or many
    Fit(fit::Arguments),
    /// Show how far the fits in a folder are, in whatever process or on whatever machine they run
    Status(status::Arguments),
    /// Examine what pictures leave undetermined: which other lights would look the same
    Ambiguity(ambiguity::Arguments),
    /// List the triangles of a scene that will cause errors, without solving it
    Check(check::Arguments),
    /// Subdivide the triangles that `check` warns of, and write the finer scene
    Refine(refine::Arguments),
    /// Compare a fitted scene with the true one, or a picture with the true one
    Compare(compare::Arguments),
    /// Print the memory and work that a solve needs, without using a device
    Plan(plan::Arguments),
    /// Write a scene for other programs: glTF, Mitsuba 3, PLY
    Export(export::Arguments),
    /// List Vulkan devices, and what each lacks for antirad
    Devices(devices::Arguments),
}

/// Why a command ended without a result.
enum Failure {
    Error(Box<dyn std::error::Error>),
    Interrupted,
    /// Already reported.
    Code(u8),
}

impl<E: std::error::Error + 'static> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Error(Box::new(error))
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let json = matches!(&arguments.command, Command::Fit(fit) if fit.json());
    let together = Together::join();
    // Of several processes one speaks.
    let quiet = arguments.quiet || !together.speaks();
    cli::start_logging(quiet, arguments.verbose, json);
    let interrupt = Interrupt::catch();
    let result = run(arguments.command, quiet, arguments.verbose, &interrupt, &together);
    match result {
        Ok(()) => together.end(0, false),
        // Where results were written, the others have come to their end.
        Err(Failure::Code(code)) => together.end(code, code != cli::EXIT_UNRELIABLE),
        Err(failure) => {
            let code = report(failure, &interrupt);
            together.end(code, true)
        }
    }
}

/// Says why a command failed, and returns the exit code.
fn report(failure: Failure, interrupt: &Interrupt) -> u8 {
    match failure {
        Failure::Code(code) => code,
        Failure::Interrupted => {
            eprintln!("antirad: interrupted; nothing was written");
            interrupt.exit_code()
        }
        Failure::Error(error) => {
            eprintln!("antirad: {}", cli::plain(&error.to_string()));
            cli::EXIT_FAILURE
        }
    }
}

fn run(
    command: Command,
    quiet: bool,
    verbose: u8,
    interrupt: &Interrupt,
    together: &Together,
) -> Result<(), Failure> {
    match &command {
        Command::Render(_) | Command::Fit(_) => together.check()?,
        _ => together.alone()?,
    }
    match command {
        Command::Render(render) => render::run(&render, quiet, verbose, interrupt, together),
        Command::Trace(trace) => trace::run(&trace, quiet, interrupt),
        Command::Fit(fit) => fit::run(&fit, quiet, verbose, interrupt, together),
        Command::Status(status) => status::run(&status, interrupt),
        Command::Ambiguity(ambiguity) => ambiguity::run(&ambiguity, quiet, interrupt),
        Command::Check(check) => check::run(&check, interrupt),
        Command::Refine(refine) => refine::run(&refine, quiet, interrupt),
        Command::Compare(compare) => compare::run(&compare),
        Command::Plan(plan) => plan::run(&plan, interrupt),
        Command::Export(export) => export::run(&export, quiet),
        Command::Devices(arguments) => devices::run(&arguments),
    }
}
