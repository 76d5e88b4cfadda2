//! `antirad fit` of many jobs: at once, in parts, and what other processes see of it.

use crate::fits::{JOB, folder, same_results};
use crate::{Folder, names, run, says};
use std::collections::BTreeSet;
use std::fs;
use std::process::Stdio;

/// A folder `jobs` with jobs that differ in their initial values.
fn jobs(names: &[&str], iterations: u32) -> Folder {
    let folder = folder(&[]);
    fs::create_dir(folder.path("jobs")).expect("a folder");
    let job = JOB.replace("iterations = 12", &format!("iterations = {iterations}"));
    let job = job.replace("room.toml", "../room.toml").replace("out/", "../out/");
    for (k, name) in names.iter().enumerate() {
        let text = job.replace("initial = 0.5", &format!("initial = 0.{}", 30 + k));
        fs::write(folder.path("jobs").join(format!("{name}.toml")), text).expect("written");
    }
    folder
}

fn summary(folder: &Folder, output: &str) -> Vec<String> {
    let text = String::from_utf8(folder.read(&format!("{output}/summary.csv"))).expect("text");
    text.lines().skip(1).map(str::to_owned).collect()
}

/// Without its times, which differ from run to run.
fn timeless(stdout: &str) -> Vec<String> {
    let table = stdout.lines().position(|line| line.starts_with("job ")).expect("a table");
    let before_time = |line: &str| line.split(" iterations in ").next().unwrap_or(line).to_owned();
    let shown: Vec<String> = stdout.lines().take(table).map(before_time).collect();
    shown.iter().map(|line| line.replace("many/", "one/")).collect()
}

#[test]
fn jobs_at_once_give_the_bytes_of_jobs_one_by_one() {
    let names = ["a", "b", "c", "d", "e"];
    let folder = jobs(&names, 3);
    let broken = "scene = \"../room.toml\"\n[[target]]\npicture = \"none.exr\"\n";
    fs::write(folder.path("jobs/bad.toml"), broken).expect("written");
    let one = folder.run("fit jobs --output one");
    let mut tool = folder.tool(["fit", "jobs", "--output", "many", "--parallel", "4"]);
    let many = run(tool.env("ANTIRAD_VALIDATION", "1"));
    assert_eq!((one.code, many.code), (Some(1), Some(1)), "{many:?}");
    for name in names {
        same_results(&folder.path("one").join(name), &folder.path("many").join(name));
    }
    assert_eq!(timeless(&one.stdout), timeless(&many.stdout));
    // Every line belongs to a job.
    let job_of = |line: &str| {
        let line = line.strip_prefix("antirad: ").unwrap_or(line);
        line.split([':', ' ']).next().unwrap_or_default().to_owned()
    };
    let told: BTreeSet<String> = many.stderr.lines().map(job_of).collect();
    assert_eq!(told, BTreeSet::from(["a", "b", "bad", "c", "d", "e"].map(str::to_owned)), "{}", many.stderr);
    let jobs: Vec<String> =
        summary(&folder, "many").iter().map(|row| job_of(&row.replace(',', ":"))).collect();
    assert_eq!(jobs, ["a", "b", "bad", "c", "d", "e"]);
}

/// A budget that holds one of the jobs at a time is enough for any number at once.
#[test]
fn jobs_wait_for_memory() {
    let folder = jobs(&["a", "b", "c"], 2);
    folder.run("fit jobs/a.toml --output one").succeeded();
    let needed = |name: &str| folder.json(name)["estimate"]["device_bytes"].clone();
    // Far pairs are kept where they take a small part of the budget.
    let with_far_pairs = needed("one/a/report.json");
    folder.run(&format!("fit jobs/a.toml --output least --memory-budget {with_far_pairs}")).succeeded();
    let needed = needed("least/a/report.json");
    let budget = needed.as_u64().expect("bytes") * 3 / 2;
    let run =
        folder.run(&format!("fit jobs --output many --parallel 3 --memory-budget {budget}")).succeeded();
    says(&run.stdout, &["3 of 3 jobs are done"]);
    // The iterations of one job are not mixed with those of another.
    let told: Vec<&str> =
        run.stderr.lines().filter_map(|line| line.split_once(" iteration ")).map(|l| l.0).collect();
    let changes = told.windows(2).filter(|pair| pair[0] != pair[1]).count();
    assert_eq!((told.len(), changes), (9, 2), "{}", run.stderr);
    same_results(&folder.path("one/a"), &folder.path("many/a"));
    // A job leaves nothing behind that the next one on the same device would lack.
    let budget = needed.as_u64().expect("bytes");
    folder.run(&format!("fit jobs --output tight --memory-budget {budget}")).succeeded();
    for name in ["a", "b", "c"] {
        same_results(&folder.path("many").join(name), &folder.path("tight").join(name));
    }
}

/// Each process does its part, and the summary has all of them.
#[test]
fn processes_share_a_batch() {
    let names = ["a", "b", "c", "d", "e"];
    let folder = jobs(&names, 1);
    let start = |shard: &str| {
        let arguments = ["fit", "jobs", "--output", "fits", "--resume", "--shard", shard];
        let mut tool = folder.tool(arguments);
        tool.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool runs")
    };
    for child in ["1/2", "2/2"].map(start) {
        crate::Run::from(child.wait_with_output().expect("the tool ends")).succeeded();
    }
    let rows = summary(&folder, "fits");
    assert_eq!(rows.len(), 5, "{rows:?}");
    for (row, name) in rows.iter().zip(names) {
        assert!(row.starts_with(&format!("{name},finished,1,")), "{rows:?}");
    }
    assert!(crate::names(&folder.path("fits")).iter().all(|name| !name.starts_with(".antirad")));
}

#[test]
fn schedulers_say_which_part() {
    let folder = jobs(&["a", "b", "c"], 1);
    let task = |id: &str| {
        let mut tool = folder.tool(["fit", "jobs", "--output", "fits", "--resume"]);
        tool.env("SLURM_ARRAY_TASK_ID", id)
            .env("SLURM_ARRAY_TASK_MIN", "5")
            .env("SLURM_ARRAY_TASK_COUNT", "2");
        run(&mut tool)
    };
    let first = task("5").succeeded();
    says(&first.stderr, &["shard 1/2: 2 of 3 jobs", "a iteration 1", "c iteration 1"]);
    assert!(!first.stderr.contains("b iteration"), "{}", first.stderr);
    // The other part is known to be waiting.
    assert!(summary(&folder, "fits")[1].starts_with("b,not-started,"), "{:?}", summary(&folder, "fits"));
    says(&task("6").succeeded().stderr, &["shard 2/2: 1 of 3 jobs", "b iteration 1"]);
    task("9").refused(&["task 9 of a Slurm array of 2 tasks from 5", "--shard K/N"]);
    // A file by name is not shared out, since scripts choose it by the number of the task.
    let mut tool = folder.tool(["fit", "jobs/b.toml", "--output", "named"]);
    run(tool.env("SLURM_ARRAY_TASK_ID", "7")).succeeded();
    let mut tool = folder.tool(["fit", "jobs", "--output", "pods"]);
    let run = run(tool.env("JOB_COMPLETION_INDEX", "3").env("ANTIRAD_SHARDS", "4")).succeeded();
    says(&run.stderr, &["shard 4/4: 0 of 3 jobs"]);
    assert_eq!(names(&folder.path("pods/a")), ["status.json"]);
}
