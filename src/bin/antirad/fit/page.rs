//! `index.html`: the jobs of a folder in a table, with pictures, in one file that needs neither server nor network.

use antirad::fit::{State, Status, results};
use antirad::output::{OutputError, atomic_write};
use base64::Engine;
use base64::prelude::BASE64_STANDARD;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use percent_encoding::{AsciiSet, NON_ALPHANUMERIC, utf8_percent_encode};
use serde_json::Value;
use std::collections::HashMap;
use std::io::{Cursor, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const STYLE: &str = include_str!("page.css");
const SCRIPT: &str = include_str!("page.js");

/// Width of a thumbnail of target, fitted picture and error side by side, pixels.
const WIDTH: u32 = 360;
/// Quality of JPEG, of 100.
const QUALITY: u8 = 80;
/// Width of a texture, pixels.
const TEXTURE: u32 = 120;
/// Views, textures, lamps and other values shown of a job; the rest is in its folder.
const VIEWS: usize = 4;
const TEXTURES: usize = 6;
const LAMPS: usize = 6;
const VALUES: usize = 6;
/// A curve, pixels.
const CURVE: (f64, f64) = (160.0, 48.0);
/// Side of the plot of a response, pixels.
const RESPONSE: f64 = 96.0;

/// The page of a folder, written again and again while jobs end.
pub struct Page {
    path: PathBuf,
    /// What does not change any more, by the job's folder.
    finished: HashMap<PathBuf, Details>,
    written: Option<(Instant, Duration)>,
}

/// What a finished job shows.
#[derive(Clone, Default)]
struct Details {
    curve: Vec<f64>,
    lamps: Vec<String>,
    values: Vec<String>,
    more_values: usize,
    views: Vec<Thumbnail>,
    textures: Vec<Thumbnail>,
    responses: Vec<Response>,
}

/// The response of a camera that was found.
#[derive(Clone)]
struct Response {
    caption: String,
    /// Numbers in the picture against those that sRGB would have there, of 1.
    curve: Vec<[f64; 2]>,
}

/// A small picture within the page, which leads to the file.
#[derive(Clone)]
struct Thumbnail {
    file: String,
    caption: String,
    /// The picture as a part of the page.
    data: String,
    width: u32,
    height: u32,
}

impl Page {
    pub fn new(folder: &Path) -> Self {
        Self { path: folder.join("index.html"), finished: HashMap::new(), written: None }
    }

    /// Whether to write it now: a page of many pictures shall not take more than a small part of the time.
    pub fn is_due(&self) -> bool {
        self.written.is_none_or(|(when, took)| when.elapsed() > (20 * took).max(Duration::from_secs(2)))
    }

    /// Writes the page of these jobs.
    pub fn write(&mut self, jobs: &[(PathBuf, Status)]) -> Result<(), OutputError> {
        let start = Instant::now();
        let rows: Vec<Markup> = jobs
            .iter()
            .map(|(folder, status)| match status.state {
                State::Finished => {
                    let details =
                        self.finished.entry(folder.clone()).or_insert_with(|| Details::read(folder));
                    row(folder, status, details)
                }
                _ => {
                    self.finished.remove(folder);
                    row(folder, status, &Details { curve: curve(folder), ..Details::default() })
                }
            })
            .collect();
        let page = document(jobs, &rows).into_string();
        atomic_write(&self.path, |file| file.write_all(page.as_bytes()))?;
        self.written = Some((Instant::now(), start.elapsed()));
        Ok(())
    }
}

impl Details {
    /// Whatever of the results can be read: a page with gaps is better than none.
    fn read(folder: &Path) -> Self {
        let json = |name: &str| -> Option<Value> {
            serde_json::from_slice(&antirad_base::input::read(&folder.join(name)).ok()?).ok()
        };
        let recovered = json("parameters.json");
        let recovered = recovered.as_ref().and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let (emission, others): (Vec<&Value>, Vec<&Value>) =
            recovered.iter().partition(|recovered| recovered["quantity"] == "emission");
        let report = json(results::REPORT).unwrap_or_default();
        let list = |key: &str| report[key].as_array().map_or(&[][..], Vec::as_slice);
        let view = |view: &Value| {
            let name = view["name"].as_str()?;
            Thumbnail::read(folder, &format!("{name}.png"), format!("{name}{}", gain(view)), WIDTH)
        };
        let texture = |texture: &Value| {
            let caption = texture["name"].as_str().unwrap_or_default().to_owned();
            Thumbnail::read(folder, texture["file"].as_str()?, caption, TEXTURE)
        };
        let lamps = brightest(&emission);
        Self {
            curve: curve(folder),
            values: others.iter().take(VALUES).map(|recovered| value(recovered)).collect(),
            more_values: recovered.len() - lamps.len() - others.len().min(VALUES),
            lamps,
            views: list("views").iter().take(VIEWS).filter_map(view).collect(),
            textures: list("textures").iter().take(TEXTURES).filter_map(texture).collect(),
            responses: list("responses").iter().filter_map(Response::of).collect(),
        }
    }
}

impl Response {
    fn of(found: &Value) -> Option<Self> {
        let views = found["views"].as_array()?;
        let number = |at: &Value| at.as_f64();
        let point = |point: &Value| Some([number(&point[0])?, number(&point[1])?]);
        let curve = found["curve"].as_array()?.iter().map(point).collect::<Option<_>>()?;
        let first = views.first()?.as_str()?;
        let more = views.len() - 1;
        let of = if more > 0 { format!("{first} and {more} more") } else { first.to_owned() };
        Some(Self { caption: format!("response of the camera of {of}"), curve })
    }

    /// The curve over that of sRGB, which is a diagonal.
    fn drawn(&self) -> Markup {
        let place = |[x, y]: &[f64; 2]| format!("{:.1},{:.1}", RESPONSE * x, RESPONSE * (1.0 - y));
        let path: Vec<String> = self.curve.iter().map(place).collect();
        html! {
            svg viewBox=(format!("0 0 {RESPONSE} {RESPONSE}")) width=(RESPONSE) height=(RESPONSE) role="img" {
                title { (self.caption) ": numbers in the picture over those of sRGB" }
                polyline.usual points=(format!("0,{RESPONSE} {RESPONSE},0")) {}
                polyline points=(path.join(" ")) {}
            }
            (self.caption)
        }
    }
}

impl Thumbnail {
    fn read(folder: &Path, file: &str, caption: String, width: u32) -> Option<Self> {
        let picture = image::open(folder.join(file)).ok()?.to_rgb8();
        let height = (picture.height() * width).div_ceil(picture.width());
        let small = image::imageops::thumbnail(&picture, width, height);
        let mut bytes = Cursor::new(Vec::new());
        image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, QUALITY).encode_image(&small).ok()?;
        let data = format!("data:image/jpeg;base64,{}", BASE64_STANDARD.encode(bytes.into_inner()));
        Some(Self { file: file.to_owned(), caption, data, width, height })
    }
}

/// Of the emissions found those that shine most.
fn brightest(emission: &[&Value]) -> Vec<String> {
    let brightness = |found: &Value| {
        found["value"].as_array().into_iter().flatten().filter_map(Value::as_f64).sum::<f64>()
    };
    let mut lit: Vec<(f64, &Value)> =
        emission.iter().map(|found| (brightness(found), *found)).filter(|(sum, _)| *sum > 0.0).collect();
    lit.sort_by(|a, b| b.0.total_cmp(&a.0));
    lit.iter().take(LAMPS).map(|(_, found)| value(found)).collect()
}

/// ", exposure 1.2000 1.1000 0.9000" of a view for which it was found.
fn gain(view: &Value) -> String {
    let numbers = view["gain"].as_array().into_iter().flatten().filter_map(Value::as_f64);
    let numbers: Vec<String> = numbers.map(|number| format!("{number:.4}")).collect();
    if numbers.is_empty() { String::new() } else { format!(", exposure {}", numbers.join(" ")) }
}

/// The loss of each iteration.
fn curve(folder: &Path) -> Vec<f64> {
    let Ok(mut table) = csv::Reader::from_path(folder.join("history.csv")) else { return Vec::new() };
    let column = table.headers().ok().and_then(|names| names.iter().position(|name| name == "loss"));
    let Some(column) = column else { return Vec::new() };
    table.records().filter_map(|row| row.ok()?.get(column)?.parse().ok()).collect()
}

/// "albedo of wall: 0.7 0.5 0.3".
fn value(recovered: &Value) -> String {
    let text = |key: &str| recovered[key].as_str().unwrap_or_default();
    let numbers = recovered["value"].as_array().into_iter().flatten().filter_map(Value::as_f64);
    let numbers: Vec<String> = numbers.map(|number| format!("{number:.4}")).collect();
    let unit = if text("unit") == "1" { String::new() } else { format!(" {}", text("unit")) };
    let at_bound = recovered["at_bound"].as_array().into_iter().flatten().any(|at| at == true);
    let bound = if at_bound { ", at a bound" } else { "" };
    format!("{} of {}: {}{unit}{bound}", text("quantity"), text("of"), numbers.join(" "))
}

fn document(jobs: &[(PathBuf, Status)], rows: &[Markup]) -> Markup {
    let count = |state| jobs.iter().filter(|(_, status)| status.state == state).count();
    let states = [State::Finished, State::Running, State::Failed, State::Interrupted, State::NotStarted];
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (count(State::Finished)) " of " (jobs.len()) " fits" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { "Fits" }
                p {
                    (jobs.len()) " jobs: "
                    @for (place, state) in states.into_iter().filter(|state| count(*state) > 0).enumerate() {
                        @if place > 0 { ", " }
                        span class=(class(state)) { (count(state)) " " (word(state)) }
                    }
                    ". Pictures are target, fitted picture and error, from black (none) to yellow (largest)."
                }
                table {
                    thead {
                        tr {
                            @for title in TITLES { th scope="col" { button type="button" { (title) } } }
                            th scope="col" { "values found" }
                            th scope="col" { "pictures" }
                        }
                    }
                    tbody { @for row in rows { (row) } }
                }
                script { (PreEscaped(SCRIPT)) }
            }
        }
    }
}

/// Columns that the table can be sorted by.
const TITLES: [&str; 6] = ["job", "state", "iterations", "loss", "picture error", "time"];

fn row(folder: &Path, status: &Status, details: &Details) -> Markup {
    let name = folder.file_name().unwrap_or_default().to_string_lossy();
    let link = |file: &str| format!("{}/{}", encoded(&name), encoded(file));
    let sorted = |value: Option<f64>| value.map_or_else(String::new, |value| value.to_string());
    let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.4e}"));
    html! {
        tr {
            th scope="row" data-sort=(status.job) { a href=(link("")) { (status.job) } }
            td data-sort=(word(status.state)) {
                span class=(class(status.state)) { (word(status.state)) }
                @if status.state == State::Running { div { "on " (status.host) } }
                @if let Some(stop) = status.stop { div { (stop.reason()) } }
                @if !status.message.is_empty() { div.message { (status.message) } }
                @if !status.warnings.is_empty() {
                    details {
                        summary { (status.warnings.len()) " warnings" }
                        ul { @for warning in &status.warnings { li { (warning) } } }
                    }
                }
            }
            td.number data-sort=(sorted(status.iteration.map(f64::from))) {
                @if let Some(iteration) = status.iteration { (iteration) }
            }
            td.number data-sort=(sorted(status.loss)) {
                @if status.loss.is_some() { (number(status.loss_at_start)) " to " (number(status.loss)) }
                (drawn(&details.curve))
            }
            td.number data-sort=(sorted(status.picture_error)) {
                @if let Some(error) = status.picture_error { (format!("{:.3} %", 100.0 * error)) }
            }
            td.number data-sort=(sorted(status.seconds)) {
                @if let Some(seconds) = status.seconds { (format!("{seconds:.1} s")) }
            }
            td {
                @if !details.lamps.is_empty() {
                    "lamps"
                    ul { @for lamp in &details.lamps { li { (lamp) } } }
                }
                ul { @for value in &details.values { li { (value) } } }
                @if details.more_values > 0 {
                    a href=(link("parameters.json")) { "and " (details.more_values) " more" }
                }
            }
            td.pictures {
                @for response in &details.responses { (response.drawn()) }
                @for (pictures, what) in [(&details.views, "target, fitted picture and error"), (&details.textures, "texture")] {
                    @for Thumbnail { file, caption, data, width, height } in pictures {
                        a href=(link(file)) {
                            img src=(data) width=(width) height=(height) loading="lazy" alt={ (caption) ": " (what) };
                            (caption)
                        }
                    }
                }
            }
        }
    }
}

/// A logarithmic curve of those of some values that are positive.
fn drawn(values: &[f64]) -> Markup {
    let points: Vec<(f64, f64)> =
        (0..).zip(values).filter(|(_, v)| **v > 0.0).map(|(k, v)| (f64::from(k), v.ln())).collect();
    let (Some(first), Some(last)) = (points.first(), points.last()) else { return html! {} };
    let least = points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
    let most = points.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
    let (width, height) = CURVE;
    let across = (width - 4.0) / (last.0 - first.0).max(1.0);
    let down = if most > least { (height - 4.0) / (most - least) } else { 0.0 };
    let place =
        |(x, y): &(f64, f64)| format!("{:.1},{:.1}", 2.0 + across * (x - first.0), 2.0 + down * (most - y));
    let path: Vec<String> = points.iter().map(place).collect();
    html! {
        svg viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) role="img" {
            title { "loss over " (values.len().saturating_sub(1)) " iterations, logarithmic" }
            polyline points=(path.join(" ")) {}
        }
    }
}

fn word(state: State) -> &'static str {
    match state {
        State::NotStarted => "not started",
        State::Running => "running",
        State::Finished => "finished",
        State::Interrupted => "interrupted",
        State::Failed => "failed",
    }
}

fn class(state: State) -> &'static str {
    match state {
        State::NotStarted | State::Interrupted => "waiting",
        State::Running => "running",
        State::Finished => "finished",
        State::Failed => "failed",
    }
}

/// Everything but letters, digits and these.
const ENCODED: &AsciiSet = &NON_ALPHANUMERIC.remove(b'-').remove(b'_').remove(b'.');

/// A name as a part of an address.
fn encoded(name: &str) -> String {
    utf8_percent_encode(name, ENCODED).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_text() {
        let evil = "<script>alert(1)</script>\"'&";
        let status = Status {
            message: evil.to_owned(),
            warnings: vec![evil.to_owned()],
            ..Status::new(evil, State::Failed)
        };
        let details = Details { values: vec![evil.to_owned()], ..Details::default() };
        let text = row(Path::new("out/a#b?c%d e"), &status, &details).into_string();
        assert!(!text.contains("<script") && !text.contains("&\""), "{text}");
        assert_eq!(text.matches("&lt;script&gt;alert(1)").count(), 5, "{text}");
        assert!(text.contains("href=\"a%23b%3Fc%25d%20e/\""), "{text}");
    }

    #[test]
    fn curves() {
        let text = drawn(&[100.0, 10.0, 0.0, 0.1]).into_string();
        assert!(text.contains("points=\"2.0,2.0 54.0,16.7 158.0,46.0\""), "{text}");
        assert!(drawn(&[]).into_string().is_empty() && drawn(&[0.0, f64::NAN]).into_string().is_empty());
        assert!(drawn(&[1.0]).into_string().contains("2.0,2.0"));
    }

    #[test]
    fn lamps_exposures_and_textures() {
        let folder = tempfile::tempdir().expect("a folder");
        let found = |of: &str, value: f64| serde_json::json!({ "quantity": "emission", "of": of, "unit": "W/(m² sr)", "value": [value, value, value] });
        let albedo = serde_json::json!({ "quantity": "albedo", "of": "wall", "unit": "1", "value": [0.5] });
        let parameters =
            serde_json::json!([found("dim", 1.0), albedo, found("off", 0.0), found("bright", 9.0)]);
        let report = serde_json::json!({
            "views": [{ "name": "a", "gain": [1.5, 1.0, 0.5] }, { "name": "b" }],
            "responses": [{ "views": ["<a>", "b"], "curve": [[0.0, 0.0], [0.5, 0.25], [1.0, 1.0]] }, { "views": [] }],
            "textures": [{ "name": "<wall>", "file": "texture 1.png" }, { "name": "lost", "file": "lost.png" }],
        });
        for (name, json) in [("parameters.json", &parameters), (results::REPORT, &report)] {
            std::fs::write(folder.path().join(name), json.to_string()).expect("written");
        }
        for name in ["a.png", "b.png", "texture 1.png"] {
            image::RgbImage::new(30, 10).save(folder.path().join(name)).expect("written");
        }
        let details = Details::read(folder.path());
        let starts: Vec<_> = details.lamps.iter().map(|lamp| lamp.split(':').next()).collect();
        assert_eq!(starts, [Some("emission of bright"), Some("emission of dim")]);
        assert_eq!((details.values.len(), details.more_values), (1, 1));
        let captions: Vec<_> = details.views.iter().map(|view| view.caption.as_str()).collect();
        assert_eq!(captions, ["a, exposure 1.5000 1.0000 0.5000", "b"]);
        assert_eq!(details.textures.iter().map(|t| (t.width, t.height)).collect::<Vec<_>>(), [(120, 40)]);
        let text = row(Path::new("out/j"), &Status::new("j", State::Finished), &details).into_string();
        assert!(text.contains("j/texture%201.png") && text.contains("&lt;wall&gt;: texture"), "{text}");
        assert_eq!(details.responses.len(), 1);
        assert!(
            text.contains("0.0,96.0 48.0,72.0 96.0,0.0") && text.contains("&lt;a&gt; and 1 more"),
            "{text}"
        );
    }

    #[test]
    fn values_with_their_units() {
        let recovered = serde_json::json!({
            "quantity": "emission", "of": "lamp", "unit": "W/(m² sr)", "value": [1.0, 2.0, 0.5], "at_bound": [false, true, false]
        });
        assert_eq!(value(&recovered), "emission of lamp: 1.0000 2.0000 0.5000 W/(m² sr), at a bound");
    }
}
