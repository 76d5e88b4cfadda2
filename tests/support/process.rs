//! CPU time of processes, which unlike wall time does not depend on the load of the machine.
#![cfg(unix)]

use std::process::Child;
use std::time::Duration;

/// State and CPU time of a process on Linux; elsewhere they are unknown, and bounds on them are not checked.
struct Stat {
    ended: bool,
    worked: Duration,
}

impl Stat {
    fn of(process: u32) -> Option<Self> {
        let text = std::fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
        // The name in front may contain anything, blanks and parentheses too.
        let fields: Vec<&str> = text.rsplit_once(") ")?.1.split_whitespace().collect();
        let ticks = |k: usize| fields.get(k)?.parse::<u64>().ok();
        // Hundredths of a second on every architecture.
        let worked = Duration::from_millis(10 * (ticks(11)? + ticks(12)?));
        Some(Self { ended: fields.first() == Some(&"Z"), worked })
    }
}

/// Sends a signal, and returns the CPU time of the process from then to its end.
pub fn work_after(child: &mut Child, signal: &str) -> Option<Duration> {
    let process = child.id();
    let before = Stat::of(process).map(|stat| stat.worked);
    let sent = std::process::Command::new("kill").args([signal, &process.to_string()]).status();
    assert!(sent.expect("kill runs").success());
    // A process that has ended keeps its CPU time until it is waited for.
    let mut last = Stat::of(process)?;
    while !last.ended {
        std::thread::sleep(Duration::from_millis(10));
        last = Stat::of(process)?;
    }
    Some(last.worked - before?)
}

/// Waits until a process handles Ctrl-C.
pub fn until_caught(child: &mut Child) {
    let status = format!("/proc/{}/status", child.id());
    let catches = || {
        let text = std::fs::read_to_string(&status).ok()?;
        let mask = text.lines().find_map(|line| line.strip_prefix("SigCgt:"))?;
        Some(u64::from_str_radix(mask.trim(), 16).ok()? >> 1 & 1 == 1)
    };
    if catches().is_none() {
        std::thread::sleep(Duration::from_secs(1));
    }
    while catches() == Some(false) {
        assert!(child.try_wait().expect("a child").is_none(), "ended early");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Waits until a process has used this much CPU time.
pub fn until_worked(child: &mut Child, worked: Duration) {
    if Stat::of(child.id()).is_none() {
        std::thread::sleep(worked);
    }
    while Stat::of(child.id()).is_some_and(|stat| stat.worked < worked) {
        assert!(child.try_wait().expect("a child").is_none(), "ended early");
        std::thread::sleep(Duration::from_millis(10));
    }
}
