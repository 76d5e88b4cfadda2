//! The command-line tool `antirad`.

mod ambiguity;
mod cameras;
mod check;
mod compare;
mod devices;
mod fit;
mod plan;
mod refine;
mod render;
mod report;
mod settings;

use antirad::cli::{self, Interrupt};
use clap::{Parser, Subcommand};
use std::process::ExitCode;

/// Help lists these options behind those of each command, which count from 0.
const LAST: usize = 100;

/// What a scene is made of, from pictures of it; and pictures of a scene, with full global illumination.
#[derive(Parser)]
#[command(version, about, after_help = EXAMPLES)]
struct Arguments {
    /// No progress, no summary, no warnings: errors alone
    #[arg(short, long, global = true, display_order = LAST)]
    quiet: bool,
    /// More to read: once for what is done, twice for everything
    #[arg(short, long, global = true, display_order = LAST, action = clap::ArgAction::Count)]
    verbose: u8,
    #[command(subcommand)]
    command: Command,
}

const EXAMPLES: &str = "Examples:
  antirad render scenes/cornell_boxes.toml --output out/cornell
  antirad render bunny.obj --bins concentric:12 --tolerance 1e-3
  antirad fit jobs/ --output out/fits --resume
  antirad ambiguity scenes/two_rooms.toml --camera main
  antirad compare scenes/cornell_boxes.toml out/fits/cornell/scene.toml
  antirad plan scenes/statue.toml --memory-budget 256MiB
  antirad check scenes/two_rooms.toml
  antirad refine scenes/two_rooms.toml --output out/fine
  antirad devices";

#[derive(Subcommand)]
enum Command {
    /// Solve a scene and make its pictures
    Render(render::Arguments),
    /// Fit scenes to pictures: jobs, one or many
    Fit(fit::Arguments),
    /// What pictures of a scene leave open: which other lights would look the same
    Ambiguity(ambiguity::Arguments),
    /// List what of a scene will come out wrong, with the triangles to blame, without solving
    Check(check::Arguments),
    /// Cut triangles where the warnings of `check` ask for it, and write the finer scene
    Refine(refine::Arguments),
    /// Say how a fitted scene differs from the true one
    Compare(compare::Arguments),
    /// Print what a solve would take, without touching a device
    Plan(plan::Arguments),
    /// List Vulkan devices, with what antirad needs of each
    Devices,
}

/// How a command ends without its result.
enum Failure {
    Error(Box<dyn std::error::Error>),
    Interrupted,
    /// All was said already.
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
    cli::start_logging(arguments.quiet, arguments.verbose, json);
    let interrupt = Interrupt::catch();
    let result = match arguments.command {
        Command::Render(render) => render::run(&render, arguments.quiet, arguments.verbose, &interrupt),
        Command::Fit(fit) => fit::run(&fit, arguments.quiet, arguments.verbose, &interrupt),
        Command::Ambiguity(ambiguity) => ambiguity::run(&ambiguity, arguments.quiet, &interrupt),
        Command::Check(check) => check::run(&check, &interrupt),
        Command::Refine(refine) => refine::run(&refine, arguments.quiet, &interrupt),
        Command::Compare(compare) => compare::run(&compare),
        Command::Plan(plan) => plan::run(&plan, &interrupt),
        Command::Devices => devices::run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Code(code)) => ExitCode::from(code),
        Err(Failure::Interrupted) => {
            eprintln!("antirad: interrupted; nothing was written");
            ExitCode::from(interrupt.exit_code())
        }
        Err(Failure::Error(error)) => {
            eprintln!("antirad: {error}");
            ExitCode::from(cli::EXIT_FAILURE)
        }
    }
}
