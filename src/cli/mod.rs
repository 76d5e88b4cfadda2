//! What the command-line tools share: sizes, interruption, progress, logging, plots, sheets of pictures.

mod backend;
mod comparison;
mod draw_fit;
mod interrupt;
mod plot;
mod progress;
mod sheet;
mod size;
mod values;
pub use values::{LAMPS, ORIENTATIONS, PRECISIONS, REFLECTIONS, SHADINGS, SOLVERS, VISIBILITIES, word};

pub use backend::BackendArguments;
pub use draw_fit::draw_fit;
pub use interrupt::Interrupt;
pub use plot::{Curve, Drawn, LogPlot, slope};
pub use progress::{PartsBar, SolveBar, Working};
pub use sheet::{Panel, Sheet, heat, percentile, signed_heat, white_point};
pub use size::parse_size;

use std::borrow::Cow;

/// Exit code for bad input and for work that failed.
pub const EXIT_FAILURE: u8 = 2;
/// Exit code if results were written but are unreliable: the solve did not converge, or its solution is not physical.
pub const EXIT_UNRELIABLE: u8 = 3;
/// Exit code after Ctrl-C, as shells expect it: 128 and the number of the signal.
pub const EXIT_INTERRUPTED: u8 = 130;
/// Exit code of a batch in which some jobs failed, and would fail again.
pub const EXIT_PARTLY: u8 = 1;
/// Exit code of a batch in which some jobs failed for reasons that may pass: EX_TEMPFAIL of sysexits.h.
pub const EXIT_RETRY: u8 = 75;
/// Exit code of a look at jobs that are running.
pub const EXIT_RUNNING: u8 = 4;

/// Variables by which launchers tell the number of processes: Open MPI; MPICH and Slurm's PMI; `srun` without either.
const COUNTS: [&str; 3] = ["OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "SLURM_STEP_NUM_TASKS"];

/// The variable by which a launcher such as `mpirun` says that it has started several processes together, this one among them.
pub fn started_together() -> Option<&'static str> {
    let several = |name: &&str| {
        let count: Option<u32> = std::env::var(name).ok().and_then(|text| text.parse().ok());
        count.is_some_and(|count| count > 1)
    };
    COUNTS.into_iter().find(several)
}

/// A line on standard output. Where nobody reads on (`antirad check scene.toml | head -1`), work goes on without it, and its exit code stays.
#[macro_export]
#[doc(hidden)]
macro_rules! say {
    ($($arguments:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stdout(), "{}", $crate::cli::plain(&format!($($arguments)*)));
    }};
}

/// Text for a terminal: names in files may hold control characters, which would move its cursor or change its colours. All but line ends and tabs
/// are written as Rust does.
pub fn plain(text: &str) -> Cow<'_, str> {
    let is_bad = |c: char| c.is_control() && c != '\n' && c != '\t';
    if !text.contains(is_bad) {
        return Cow::Borrowed(text);
    }
    let escaped = |c: char| if is_bad(c) { c.escape_default().to_string() } else { c.to_string() };
    Cow::Owned(text.chars().map(escaped).collect())
}

/// Log lines on standard error: warnings, with `verbose` more; with `json` one JSON object a line.
pub fn start_logging(quiet: bool, verbose: u8, json: bool) {
    let level = match (quiet, verbose) {
        (true, _) => tracing::Level::ERROR,
        (_, 0) => tracing::Level::WARN,
        (_, 1) => tracing::Level::INFO,
        _ => tracing::Level::DEBUG,
    };
    let colours = std::io::IsTerminal::is_terminal(&std::io::stderr());
    let lines = tracing_subscriber::fmt()
        .with_max_level(level)
        .with_writer(std::io::stderr)
        .with_ansi(colours && !json)
        .with_target(false)
        .without_time();
    // An existing logger stays: tests call this more than once.
    let _ = if json { lines.json().flatten_event(true).try_init() } else { lines.try_init() };
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_terminals_obey_is_escaped() {
        assert_eq!(plain("a \u{1b}[31mred\u{7}\u{9b}2J\r\n\tü"), "a \\u{1b}[31mred\\u{7}\\u{9b}2J\\r\n\tü");
        assert!(matches!(plain("Küche 1\n"), Cow::Borrowed(_)));
    }
}
