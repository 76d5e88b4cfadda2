//! Memory and time of one light bounce over the number of triangles.

mod measure;
mod table;

use antirad::backend::BackendKind;
use antirad::cli::{self, Interrupt, parse_size};
use antirad::output::prepare_directory;
use antirad::scene::BinLayout;
use clap::Parser;
use indicatif::{ProgressBar, ProgressStyle};
use measure::{Outcome, Size};
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure memory and time of one light bounce over the number of triangles
///
/// A bounce is one application of (K - J) U, with light in every bin and every triangle a blocker, on a statue over a
/// floor. Neither the shadows of lamps, which a render computes before the first bounce, nor the near field as a matrix, which it keeps on a
/// CPU, are part of it.
#[derive(Parser)]
#[command(version, about, after_help = EXAMPLES)]
struct Arguments {
    /// Numbers of triangles
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "10000,20000,50000,100000,200000",
          value_parser = clap::value_parser!(u32).range(i64::from(measure::SMALLEST)..=1_000_000))]
    triangles: Vec<u32>,
    /// Direction bins per hemisphere: 10x13 (polar x azimuth) or concentric:12
    #[arg(long, value_name = "LAYOUT", default_value = "10x13")]
    bins: BinLayout,
    /// A scene file, cut until it has as many triangles, in place of the statue
    #[arg(long, value_name = "FILE")]
    scene: Option<PathBuf>,
    /// Bounces per size; the fastest counts
    #[arg(long, value_name = "NUMBER", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    repeats: u32,
    /// Limit of the backend's memory, e.g. 512MiB [default: what the device has; on the CPU three quarters of the system's]
    #[arg(long, value_name = "SIZE", value_parser = parse_size)]
    memory_budget: Option<u64>,
    /// Processes that share each bounce, started by mpirun (feature `mpi`)
    #[arg(long, value_name = "NUMBER", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..))]
    ranks: u32,
    /// Folder for scaling.csv and the plots
    #[arg(long, short, value_name = "DIR", default_value = "out/scaling")]
    output: PathBuf,
    /// Skip sizes that DIR/scaling.csv already has of the same device, with the same bins, memory budget and ranks; keep those of
    /// other devices and backends, also of other machines
    #[arg(long)]
    resume: bool,
    /// Where bounces are computed: vulkan, by kernels on whatever Vulkan device there is; cpu; or both, one after the other
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "vulkan")]
    backend: Vec<BackendKind>,
    /// Vulkan device, by its number or a part of its name [env: ANTIRAD_DEVICE]
    #[arg(long, value_name = "INDEX|NAME")]
    device: Option<String>,
    /// Print errors only: no progress, no table
    #[arg(short, long)]
    quiet: bool,
    /// Print seconds and rates of each kernel, too
    #[arg(short, long, action = clap::ArgAction::Count)]
    verbose: u8,
    /// Measure one size in this process, and print the row: each size has a process of its own, so that its memory is
    /// not mixed with that of others
    #[arg(long, hide = true)]
    only: bool,
}

const EXAMPLES: &str = "Examples:
  bench_scaling
  bench_scaling --backend vulkan,cpu
  bench_scaling --triangles 10000,20000 --repeats 3 --output out/small
  bench_scaling --ranks 2 --triangles 20000
  bench_scaling --resume";

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    cli::start_logging(arguments.quiet, arguments.verbose, false);
    let interrupt = Interrupt::catch();
    if cfg!(not(feature = "mpi")) && arguments.ranks > 1 {
        eprintln!(
            "bench_scaling: it was built without MPI: build it with `--features mpi`, or leave out --ranks"
        );
        return ExitCode::from(cli::EXIT_FAILURE);
    }
    // Each would measure everything, and all would write the same files. It starts the processes of a measurement itself.
    if let Some(name) = cli::started_together().filter(|_| !(arguments.only && cfg!(feature = "mpi"))) {
        eprintln!(
            "bench_scaling: several processes were started together ({name}): start one, with --ranks NUMBER, and it starts mpirun itself"
        );
        return ExitCode::from(cli::EXIT_FAILURE);
    }
    let result =
        if arguments.only { measure::only(&arguments, &interrupt) } else { all(&arguments, &interrupt) };
    match result {
        Ok(Outcome::Done) => ExitCode::SUCCESS,
        Ok(Outcome::Interrupted) => ExitCode::from(interrupt.exit_code()),
        Err(error) => {
            eprintln!("bench_scaling: {error}");
            ExitCode::from(cli::EXIT_FAILURE)
        }
    }
}

/// Measures every size in a process of its own, and rewrites the table after each.
fn all(arguments: &Arguments, interrupt: &Interrupt) -> Result<Outcome, Box<dyn std::error::Error>> {
    prepare_directory(&arguments.output)?;
    let mut rows = if arguments.resume { table::read(&arguments.output)? } else { Vec::new() };
    let bins = arguments.bins.to_string();
    rows.retain(|row| {
        row.bins == bins && row.budget == arguments.memory_budget && row.ranks == arguments.ranks
    });
    let bar = if arguments.quiet { ProgressBar::hidden() } else { ProgressBar::new(1000) };
    if let Ok(style) = ProgressStyle::with_template("{msg} [{bar:30}] {elapsed} elapsed, {eta} left") {
        bar.set_style(style.progress_chars("=> "));
    }
    // Time grows with the square of the size.
    let cost = |size: u32| f64::from(size).powi(2);
    let of_backend = |&backend: &BackendKind| arguments.triangles.iter().map(move |&size| (backend, size));
    // Which device measures, and how it fares: drivers cache compiled kernels, which then take no time of the measurements.
    bar.set_message("compiling kernels");
    let mut devices = Vec::new();
    for &backend in &arguments.backend {
        match measure::in_child(arguments, (backend, measure::SMALLEST), interrupt, &|_| ())? {
            Size::Measured(row) => devices.push((backend, row.device)),
            Size::Failed(why) => return Err(format!("{backend}: {why}").into()),
            Size::Interrupted => return Ok(Outcome::Interrupted),
        }
    }
    let of_here =
        |row: &table::Row| devices.iter().any(|(of, device)| row.backend == *of && row.device == *device);
    rows.retain(|row| !of_here(row) || arguments.triangles.contains(&row.size));
    let known = |&(backend, size): &(BackendKind, u32)| {
        rows.iter().any(|row| of_here(row) && row.backend == backend && row.size == size)
    };
    let todo: Vec<(BackendKind, u32)> =
        arguments.backend.iter().flat_map(of_backend).filter(|of| !known(of)).collect();
    let total: f64 = todo.iter().map(|&(_, size)| cost(size)).sum();
    let mut done = 0.0;
    let mut failures = Vec::new();
    for (backend, size) in todo {
        bar.set_message(format!("{backend}, {size} triangles"));
        let progress = |share: f64| bar.set_position(((done + share * cost(size)) / total * 1000.0) as u64);
        match measure::in_child(arguments, (backend, size), interrupt, &progress)? {
            Size::Measured(row) => {
                rows.push(*row);
                rows.sort_by_key(|row| (row.backend.to_string(), row.device.clone(), row.size));
                table::write(&arguments.output, &rows)?;
            }
            Size::Failed(why) => failures.push(format!("{size} triangles: {why}")),
            Size::Interrupted => {
                bar.finish_and_clear();
                eprintln!("bench_scaling: interrupted; go on with --resume");
                return Ok(Outcome::Interrupted);
            }
        }
        done += cost(size);
    }
    bar.finish_and_clear();
    if !rows.is_empty() {
        table::plot(&arguments.output, &rows)?;
        if !arguments.quiet {
            table::print(&rows);
            antirad::say!("written to {}", arguments.output.display());
        }
    }
    if failures.is_empty() { Ok(Outcome::Done) } else { Err(failures.join("; ").into()) }
}
