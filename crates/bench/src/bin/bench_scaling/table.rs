//! The measurements as a table and as plots.

use antirad::backend::BackendKind;
use antirad::cli::{Curve, Drawn, LogPlot, slope};
use antirad::gpu::Bytes;
use antirad::output::{OutputError, atomic_write};
use std::error::Error;
use std::fs::File;
use std::path::Path;

/// What *Differentiable Radiosity for Inverse Rendering* states: 36 kB per triangle.
const PUBLISHED_BYTES: f64 = 36e3;

/// One size. Bytes, pairs of triangles, seconds.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub struct Row {
    pub backend: BackendKind,
    /// The Vulkan device, or the model of the CPU.
    pub device: String,
    pub threads: usize,
    /// Triangles asked for.
    pub size: u32,
    pub triangles: usize,
    pub bins: String,
    /// Memory allowed, if limited.
    #[serde(default)]
    pub budget: Option<u64>,
    /// Processes that shared the bounce; bytes and seconds are those of the first.
    #[serde(default = "one")]
    pub ranks: u32,
    /// Bytes that it received from others in a bounce.
    #[serde(default)]
    pub bytes_received: u64,
    pub bytes_planned: u64,
    pub bytes_allocated: u64,
    pub bytes_peak: u64,
    /// Bytes that do not depend on the scene: staging.
    pub bytes_fixed: u64,
    /// Size of states on the host, and traffic of a bounce between host and device; 0 where states are on the device.
    #[serde(default)]
    pub bytes_host: u64,
    #[serde(default)]
    pub bytes_moved: u64,
    pub resident_growth: u64,
    pub resident_peak: u64,
    pub pairs: u64,
    pub pairs_culled: u64,
    pub pairs_sub_sampled: u64,
    /// Receiver and source that are evaluated: without bins, and with bins at either end.
    #[serde(default)]
    pub interactions: u64,
    #[serde(default)]
    pub interactions_bins: u64,
    /// Time of planning, interaction lists included.
    pub seconds_plan: f64,
    /// Time in kernels, or in operators of the CPU.
    pub seconds_kernels: f64,
    pub seconds_wall: f64,
    pub pairs_per_second: f64,
    /// Without the fixed bytes.
    pub bytes_per_triangle: f64,
}

fn one() -> u32 {
    1
}

const FILE: &str = "scaling.csv";

/// The rows of an earlier run; none if there was none.
pub fn read(directory: &Path) -> Result<Vec<Row>, Box<dyn Error>> {
    let path = directory.join(FILE);
    if !path.exists() {
        return Ok(Vec::new());
    }
    let rows: Result<_, csv::Error> =
        csv::Reader::from_reader(File::open(&path)?).into_deserialize().collect();
    rows.map_err(|error| format!("{}: {error}; remove it, or run without --resume", path.display()).into())
}

pub fn write(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    atomic_write(&directory.join(FILE), |file| {
        let mut writer = csv::Writer::from_writer(file);
        for row in rows {
            writer.serialize(row)?;
        }
        writer.flush()
    })
}

fn points(rows: &[Row], of: impl Fn(&Row) -> f64) -> Vec<(f64, f64)> {
    rows.iter().map(|row| (row.triangles as f64, of(row))).collect()
}

fn memory(rows: &[Row]) -> Vec<(f64, f64)> {
    points(rows, |row| (row.bytes_allocated - row.bytes_fixed) as f64)
}

fn seconds(rows: &[Row]) -> Vec<(f64, f64)> {
    points(rows, |row| row.seconds_wall)
}

fn with_slope(label: &str, points: &[(f64, f64)]) -> String {
    slope(points).map_or_else(|| label.to_owned(), |s| format!("{label}, slope {s:.3}"))
}

/// The rows of each device.
fn by_device(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| (a.backend, &a.device) == (b.backend, &b.device))
}

/// A curve for each device.
fn curves(rows: &[Row], of: fn(&[Row]) -> Vec<(f64, f64)>) -> Vec<Curve> {
    let curve = |rows: &[Row]| {
        let label = format!("{} on {}, {} threads", rows[0].backend, rows[0].device, rows[0].threads);
        let points = of(rows);
        Curve { label: with_slope(&label, &points), points, drawn: Drawn::Curve }
    };
    by_device(rows).map(curve).collect()
}

pub fn plot(directory: &Path, rows: &[Row]) -> Result<(), OutputError> {
    let bins = rows.first().map_or("", |row| &row.bins);
    let mut sizes = points(rows, |row| PUBLISHED_BYTES * row.triangles as f64);
    sizes.sort_by(|a, b| a.0.total_cmp(&b.0));
    sizes.dedup();
    let published = Curve {
        label: "Differentiable Radiosity paper: 36 kB per triangle".to_owned(),
        points: sizes,
        drawn: Drawn::Line,
    };
    LogPlot {
        title: format!("Memory of one bounce, {bins} bins, every triangle a blocker"),
        x: "triangles".to_owned(),
        y: "bytes, fixed costs apart".to_owned(),
        curves: curves(rows, memory).into_iter().chain([published]).collect(),
        linear_x: false,
    }
    .write(&directory.join("memory"))?;
    LogPlot {
        title: format!("Time of one bounce, {bins} bins, every triangle a blocker"),
        x: "triangles".to_owned(),
        y: "seconds".to_owned(),
        curves: curves(rows, seconds),
        linear_x: false,
    }
    .write(&directory.join("time"))
}

pub fn print(rows: &[Row]) {
    antirad::say!(
        "{:>7} {:>9} {:>7} {:>12} {:>10} {:>12} {:>14} {:>8} {:>8} {:>8} {:>8} {:>10} {:>10} {:>12}",
        "backend",
        "triangles",
        "bins",
        "allocated",
        "B/triangle",
        "resident",
        "pairs",
        "culled",
        "plain/t",
        "bins/t",
        "plan s",
        "kernels s",
        "wall s",
        "pairs/s"
    );
    for row in rows {
        antirad::say!(
            "{:>7} {:>9} {:>7} {:>12} {:>10.0} {:>12} {:>14} {:>6.1} % {:>8.0} {:>8.0} {:>8.2} {:>10.2} {:>10.2} {:>12.3e}",
            row.backend.to_string(),
            row.triangles,
            row.bins,
            row.bytes_allocated,
            row.bytes_per_triangle,
            row.resident_growth,
            row.pairs,
            100.0 * row.pairs_culled as f64 / row.pairs as f64,
            row.interactions as f64 / row.triangles as f64,
            row.interactions_bins as f64 / row.triangles as f64,
            row.seconds_plan,
            row.seconds_kernels,
            row.seconds_wall,
            row.pairs_per_second
        );
    }
    for rows in by_device(rows) {
        let Row { backend, device, threads, bytes_peak, .. } = &rows[rows.len() - 1];
        let power = |of: Option<f64>| of.map_or_else(|| "-".to_owned(), |slope| format!("{slope:.3}"));
        antirad::say!(
            "{backend} on {device}, {threads} threads: memory grows with triangles to the power {}, fixed costs apart, time to the power {}; \
             peak of the largest: {}",
            power(slope(&memory(rows))),
            power(slope(&seconds(rows))),
            Bytes(*bytes_peak)
        );
    }
    antirad::say!("(Differentiable Radiosity paper: 36 kB per triangle)");
}
