//! `antirad status`: how far the fits in a folder are.

use crate::Failure;
use antirad::cli::{self, Interrupt};
use antirad::fit::{State, Status, now};
use clap::Args;
use std::fmt::Write;
use std::io::IsTerminal;
use std::path::PathBuf;
use std::time::Duration;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad status out/fits
  antirad status out/fits --watch
  antirad status out/fits --json | jq '.[] | select(.state == \"failed\") | .message'

Exit code: 0 all jobs are finished; 1 some failed, and would fail again; 4 some are running; 75 the rest can be done by
running the batch again with --resume.")]
pub struct Arguments {
    /// Folder of results: the --output of `antirad fit`
    folder: PathBuf,
    /// Print it again whenever it changes, until no job is running
    #[arg(long, conflicts_with = "json")]
    watch: bool,
    /// Print all that is known as JSON
    #[arg(long)]
    json: bool,
}

/// Between two looks at the folder.
const PERIOD: Duration = Duration::from_secs(1);

pub fn run(arguments: &Arguments, interrupt: &Interrupt) -> Result<(), Failure> {
    let mut shown = String::new();
    loop {
        let jobs = read(arguments)?;
        if arguments.json {
            antirad::say!("{}", serde_json::to_string_pretty(&jobs)?);
        } else {
            let table = table(&jobs, now());
            if table != shown {
                show(&table, arguments.watch && !shown.is_empty());
                shown = table;
            }
        }
        let code = exit_code(&jobs);
        if !arguments.watch || code != cli::EXIT_RUNNING {
            return if code == 0 { Ok(()) } else { Err(Failure::Code(code)) };
        }
        std::thread::sleep(PERIOD);
        if interrupt.is_set() {
            return Err(Failure::Code(interrupt.exit_code()));
        }
    }
}

fn read(arguments: &Arguments) -> Result<Vec<Status>, Failure> {
    let refuse = |reason: String| Failure::Error(format!("{}: {reason}", arguments.folder.display()).into());
    let jobs =
        Status::of_folder(&arguments.folder).map_err(|error| refuse(format!("cannot be read: {error}")))?;
    if jobs.is_empty() {
        return Err(refuse(String::from("no job in it; give the --output of `antirad fit`")));
    }
    Ok(jobs.into_iter().map(|(_, status)| status).collect())
}

/// On a terminal in place of what was shown before.
fn show(table: &str, again: bool) {
    let clear = if again && std::io::stdout().is_terminal() { "\x1b[H\x1b[2J" } else { "" };
    antirad::say!("{clear}{table}");
}

fn exit_code(jobs: &[Status]) -> u8 {
    let any = |is: &dyn Fn(&Status) -> bool| jobs.iter().any(is);
    let unfinished = |job: &Status| match job.state {
        State::NotStarted | State::Interrupted => true,
        State::Failed => job.may_pass,
        State::Running | State::Finished => false,
    };
    if any(&|job| job.state == State::Running) {
        cli::EXIT_RUNNING
    } else if any(&unfinished) {
        cli::EXIT_RETRY
    } else if any(&|job| job.state == State::Failed) {
        cli::EXIT_PARTLY
    } else {
        0
    }
}

fn table(jobs: &[Status], now: u64) -> String {
    let width = jobs.iter().map(|job| job.job.chars().count()).max().unwrap_or(0).max(3);
    let mut text = format!(
        "{:<width$}  {:<11} {:>10} {:>12} {:>13} {:>9} {:>9}  ",
        "job", "state", "iteration", "loss", "picture error", "time", "left"
    );
    for job in jobs {
        // Writing into a string does not fail.
        let _ = write!(text, "\n{}", row(job, width, now));
    }
    let count = |state| jobs.iter().filter(|job| job.state == state).count();
    let counted = [
        (State::Finished, "finished"),
        (State::Running, "running"),
        (State::Failed, "failed"),
        (State::Interrupted, "interrupted"),
        (State::NotStarted, "not started"),
    ];
    let counted = counted.map(|(state, word)| (count(state), word));
    let counted: Vec<String> =
        counted.iter().filter(|(n, _)| *n > 0).map(|(n, word)| format!("{n} {word}")).collect();
    let s = if jobs.len() == 1 { "" } else { "s" };
    text + &format!("\n{} job{s}: {}", jobs.len(), counted.join(", "))
}

fn row(job: &Status, width: usize, now: u64) -> String {
    let state = match job.state {
        State::NotStarted => "not started",
        State::Running => "running",
        State::Finished => "finished",
        State::Interrupted => "interrupted",
        State::Failed => "FAILED",
    };
    let iteration = match (job.iteration, job.most_iterations) {
        (Some(done), Some(most)) => format!("{done} of {most}"),
        (Some(done), None) => done.to_string(),
        _ => String::new(),
    };
    let known = |value: Option<f64>, show: fn(f64) -> String| value.map_or_else(String::new, show);
    let left = job.seconds_left.filter(|_| job.state == State::Running);
    let about = match job.state {
        State::Running => {
            let since = duration(now.saturating_sub(job.began) as f64);
            let silent = now.saturating_sub(job.written) as f64;
            let silence = if silent > SILENT {
                format!(", last heard of {} ago", duration(silent))
            } else {
                String::new()
            };
            format!("process {} on {} since {since}{silence}", job.process, job.host)
        }
        State::Failed if job.may_pass => format!("{} (may pass: try again)", job.message),
        State::Finished => job.stop.map_or("", |stop| stop.reason()).to_owned(),
        _ => job.message.clone(),
    };
    let line = format!(
        "{:<width$}  {state:<11} {iteration:>10} {:>12} {:>13} {:>9} {:>9}  {about}",
        job.job,
        known(job.loss, |loss| format!("{loss:.4e}")),
        known(job.picture_error, |error| format!("{:.3} %", 100.0 * error)),
        known(job.seconds, duration),
        known(left, |left| format!("< {}", duration(left))),
    );
    line.trim_end().to_owned()
}

/// Silence that is worth a mention, s: an iteration may take minutes.
const SILENT: f64 = 60.0;

/// "7 s", "3 min", "2.5 h".
fn duration(seconds: f64) -> String {
    match seconds {
        s if s < 90.0 => format!("{:.0} s", s.max(0.0)),
        s if s < 5400.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn job(name: &str, state: State) -> Status {
        Status {
            host: String::from("node7"),
            process: 42,
            began: 1000,
            written: 1100,
            ..Status::new(name, state)
        }
    }

    #[test]
    fn tables() {
        let running = Status {
            iteration: Some(5),
            most_iterations: Some(20),
            loss: Some(0.25),
            seconds: Some(100.0),
            seconds_left: Some(300.0),
            ..job("long name", State::Running)
        };
        let failed =
            Status { message: String::from("out of disk"), may_pass: true, ..job("b", State::Failed) };
        let text = table(&[running, failed, job("c", State::NotStarted)], 1130);
        let lines: Vec<&str> = text.lines().collect();
        let words: Vec<&str> = lines[1].split_whitespace().collect();
        let expected = "long name running 5 of 20 2.5000e-1 2 min < 5 min process 42 on node7 since 2 min";
        assert_eq!(words.join(" "), expected, "{text}");
        assert!(lines[2].ends_with("out of disk (may pass: try again)"), "{text}");
        assert_eq!(lines[3], "c          not started");
        assert_eq!(lines[4], "3 jobs: 1 running, 1 failed, 1 not started");
        let silent = table(&[job("a", State::Running)], 8200);
        assert!(silent.contains("since 2.0 h, last heard of 2.0 h ago"), "{silent}");
    }

    #[test]
    fn exit_codes_say_what_to_do() {
        use State::*;
        let of =
            |states: &[State]| exit_code(&states.iter().map(|state| job("a", *state)).collect::<Vec<_>>());
        assert_eq!(of(&[Finished, Finished]), 0);
        assert_eq!(of(&[Finished, Failed]), 1);
        assert_eq!(of(&[Finished, Failed, Running]), 4);
        assert_eq!(of(&[Failed, Interrupted]), 75);
        assert_eq!(of(&[NotStarted, Finished]), 75);
        assert_eq!(exit_code(&[Status { may_pass: true, ..job("a", Failed) }]), 75);
    }
}
