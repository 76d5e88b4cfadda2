//! The page of a batch in a browser, and `antirad status` beside it.

use crate::fits::{JOB, folder};
use crate::{Folder, run, says};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The name of a job that must not become a part of the page's code.
const EVIL: &str = "<script>alert(1)<b>&amp;";

fn batch() -> Folder {
    let folder = folder(&[]);
    fs::create_dir(folder.path("jobs")).expect("a folder");
    let job = JOB.replace("room.toml", "../room.toml").replace("out/", "../out/");
    for (name, iterations) in [("a", 3), ("b c#d", 1), (EVIL, 2)] {
        let text = job.replace("iterations = 12", &format!("iterations = {iterations}"));
        fs::write(folder.path("jobs").join(format!("{name}.toml")), text).expect("written");
    }
    fs::write(folder.path("jobs/z.toml"), job.replace("albedo", "<i>")).expect("written");
    assert_eq!(folder.run("fit jobs --output fits --quiet").code, Some(1));
    folder
}

/// Chromium, if this machine has it.
fn chromium() -> Option<PathBuf> {
    let folders = std::env::var_os("PATH")?;
    std::env::split_paths(&folders).map(|folder| folder.join("chromium")).find(|path| path.is_file())
}

/// Opens a page; returns what is printed.
fn open(page: &Path, profile: &Path, arguments: &[&str]) -> String {
    let mut browser = Command::new(chromium().expect("looked for before"));
    browser.args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]);
    browser.args(["--disable-background-networking", "--disable-component-update", "--disable-sync"]);
    browser.arg(format!("--user-data-dir={}", profile.display())).args(arguments);
    let output = browser.arg(format!("file://{}", page.display())).output().expect("chromium runs");
    String::from_utf8(output.stdout).expect("text")
}

/// Clicks, and notes the order of the rows, what pictures there are, and whether a name has become code.
const CLICKS: &str = r#"<script>
const order = () => [...document.querySelectorAll("tbody tr")].map((row) => row.children[0].innerText).join("|");
const click = (title) => [...document.querySelectorAll("th button")].find((b) => b.innerText === title).click();
addEventListener("load", () => {
  const said = [order()];
  for (const title of ["job", "job", "iterations", "loss", "loss"]) { click(title); said.push(order()); }
  const images = [...document.images];
  images.forEach((image) => image.loading = "eager");
  said.push(images.length, images.filter((image) => image.src.startsWith("data:image/jpeg")).length);
  said.push(document.querySelectorAll("polyline").length, document.querySelectorAll("tbody script, tbody i, tbody b").length);
  const pre = document.createElement("pre");
  pre.id = "said";
  pre.innerText = said.join("\n");
  document.body.append(pre);
});
</script>"#;

#[test]
#[ignore = "needs Chromium"]
fn the_page_of_a_batch_in_a_browser() {
    if chromium().is_none() {
        // Past the capture of the test's output.
        let _ = writeln!(std::io::stderr(), "SKIPPED the page in a browser: chromium is not installed");
        return;
    }
    let folder = batch();
    let page = String::from_utf8(folder.read("fits/index.html")).expect("text");
    assert!(!page.contains("http:") && !page.contains("https:") && !page.contains("src=\"/"), "no network");
    let clicked = folder.path("fits/clicked.html");
    fs::write(&clicked, page.replace("</body>", &format!("{CLICKS}</body>"))).expect("written");
    let profile = folder.path("profile");
    let shown = open(&clicked, &profile, &["--virtual-time-budget=5000", "--dump-dom"]);
    let said = shown.split("<pre id=\"said\">").nth(1).and_then(|rest| rest.split("</pre>").next());
    let said = said.unwrap_or_else(|| panic!("{shown}")).replace("<br>", "\n");
    let said = said.replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&");
    let lines: Vec<&str> = said.lines().collect();
    let by_name = format!("{EVIL}|a|b c#d|z");
    assert_eq!(lines[0], by_name);
    assert_eq!(lines[1].split('|').count(), 4, "{said}");
    let reversed = |line: &str| line.rsplit('|').map(str::to_owned).collect::<Vec<_>>().join("|");
    assert_eq!(reversed(lines[1]), lines[2], "{said}");
    // What has no number comes last in both directions.
    assert_eq!(lines[3], format!("b c#d|{EVIL}|a|z"), "{said}");
    assert!(lines[4].ends_with("|z") && lines[5].ends_with("|z"), "{said}");
    assert_eq!(reversed(lines[4].trim_end_matches("|z")), lines[5].trim_end_matches("|z"), "{said}");
    // Two views of three finished jobs.
    assert_eq!(&lines[6..], ["6", "6", "3", "0"], "{said}");

    let shot = folder.path("page.png");
    let size = ["--window-size=1500,900", "--hide-scrollbars"];
    let screenshot = format!("--screenshot={}", shot.display());
    open(&folder.path("fits/index.html"), &profile, &[size[0], size[1], &screenshot]);
    let picture = image::open(&shot).expect("a picture").to_rgb8();
    assert_eq!(picture.dimensions(), (1500, 900));
    // The lamp and the coloured walls of thumbnails, beside text.
    let spread =
        |p: &image::Rgb<u8>| p.0.iter().max().zip(p.0.iter().min()).map_or(0, |(most, least)| most - least);
    let coloured = picture.pixels().filter(|p| spread(p) > 40);
    assert!(coloured.count() > 5_000);
    if let Some(kept) = std::env::var_os("ANTIRAD_TEST_SCREENSHOT") {
        fs::copy(&shot, kept).expect("copied");
    }
}

#[test]
fn others_see_how_far_a_batch_is() {
    let folder =
        folder(&[("a.toml", &JOB.replace("= 12", "= 1")), ("b.toml", &JOB.replace("albedo", "albido"))]);
    folder.run("status fits").refused(&["fits", "cannot be read"]);
    folder.run("status out").refused(&["no job in it", "--output"]);
    assert_eq!(folder.run("fit a.toml b.toml --output fits").code, Some(1));
    let seen = folder.run("status fits");
    assert_eq!(seen.code, Some(1), "{seen:?}");
    says(
        &seen.stdout,
        &["a    finished", "1 of 1", "b    FAILED", "did you mean `albedo`?", "2 jobs: 1 finished, 1 failed"],
    );
    let json: serde_json::Value =
        serde_json::from_str(&folder.run("status fits --json").stdout).expect("JSON");
    assert_eq!(json[0]["state"], "finished");
    assert_eq!(json[1]["may_pass"], false);
    fs::remove_dir_all(folder.path("fits/b")).expect("removed");
    folder.run("status fits --watch").succeeded();
}

#[cfg(unix)]
#[test]
fn a_running_job_is_seen_until_it_is_killed() {
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    let long = JOB.replace("iterations = 12", "iterations = 100000") + "kind = \"adam\"\n";
    let folder = folder(&[("job.toml", &long)]);
    let mut tool = folder.tool(["fit", "job.toml", "--output", "fits"]);
    let mut child = tool.stderr(Stdio::piped()).spawn().expect("the tool runs");
    let mut stderr = BufReader::new(child.stderr.take().expect("piped"));
    let mut said = String::new();
    while !said.contains("iteration 2:") {
        assert!(stderr.read_line(&mut said).expect("text") > 0, "ended early: {said}");
    }
    let seen = folder.run("status fits");
    let mut watch = folder.tool(["status", "fits", "--watch"]);
    let watch = watch.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool runs");
    child.kill().expect("killed");
    child.wait().expect("ended");
    assert_eq!(seen.code, Some(4), "{seen:?}");
    let process = format!("process {} on ", child.id());
    says(&seen.stdout, &["job  running", "of 100000", &process, " since ", "1 job: 1 running"]);
    // The watcher sees it end.
    let watched = crate::Run::from(watch.wait_with_output().expect("the tool ends"));
    assert_eq!(watched.code, Some(75), "{watched:?}");
    says(&watched.stdout, &["job  interrupted", "was killed"]);
    let resumed = JOB.replace("iterations = 12", "iterations = 100000") + "kind = \"adam\"\n";
    fs::write(folder.path("job.toml"), resumed.replace("100000", "3")).expect("written");
    let mut tool = folder.tool(["fit", "job.toml", "--output", "fits", "--resume"]);
    run(&mut tool).succeeded();
    folder.run("status fits").succeeded();
}
