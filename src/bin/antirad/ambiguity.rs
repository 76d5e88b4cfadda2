//! `antirad ambiguity`.

use crate::Failure;
use crate::cameras;
use crate::settings::SceneSettings;
use antirad::Watch;
use antirad::ambiguity::{
    AmbiguityError, DirectLight, FirstBounce, Given, Interval, LightMatrix, Polytope, Views,
};
use antirad::backend::Backend;
use antirad::cli::Interrupt;
use antirad::gpu::Bytes;
use antirad::image::{Exposure, Rasterizer, ToneMap};
use antirad::output::{FileNames, atomic_write, prepare_directory, write_array, write_json};
use antirad::resolve::ResolveOptions;
use antirad::scene::{Camera, Scene};
use clap::Args;
use glam::DVec3;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad ambiguity scenes/two_rooms.toml
  antirad ambiguity scenes/two_rooms.toml --camera main --triangle 17 --triangle 40 --noise 1e-2")]
pub struct Arguments {
    #[command(flatten)]
    settings: SceneSettings,
    /// Camera of which there is a picture; may be given several times [default: all cameras of the scene]
    #[arg(long, value_name = "NAME")]
    camera: Vec<String>,
    /// Triangle whose emission is bounded, by its index from 0; may be given several times [default: all that no camera
    /// sees, and the three brightest lights that one sees]
    #[arg(long, value_name = "NUMBER")]
    triangle: Vec<usize>,
    /// Allowed difference of visible radiance, relative to its mean
    #[arg(long, value_name = "FRACTION", default_value_t = 1e-3, value_parser = parse_noise)]
    noise: f64,
    /// Leave out intervals and the pictures of determination beyond this many unseen triangles: each takes a third of a
    /// solve
    #[arg(long, value_name = "NUMBER", default_value_t = 2000)]
    max_unseen: usize,
    /// Folder for the results [default: out/SCENE/ambiguity]
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
}

/// Seen lights whose intervals are found by default: each takes linear programs.
const LIGHTS: usize = 3;
/// Samples along each side of a pixel.
const SUPERSAMPLE: u32 = 4;

fn parse_noise(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(noise) if (0.0..1.0).contains(&noise) => Ok(noise),
        _ => Err(String::from("expected a number from 0 to below 1")),
    }
}

#[derive(Serialize)]
struct Report {
    scene: String,
    version: &'static str,
    cameras: Vec<String>,
    triangles: usize,
    seen: usize,
    unseen: usize,
    without_area: usize,
    /// Dimension of the space of emissions that give the same pictures, per channel.
    kernel_dimension: usize,
    /// Absent if no light is hidden.
    first_bounce: Option<FirstBounce>,
    /// Why there are no intervals.
    left_out: Option<String>,
    noise: f64,
    intervals: Vec<Row>,
    /// Area-weighted means.
    determination_of_seen: Option<f64>,
    determination_of_unseen: Option<f64>,
    /// Lowest emission of a seen triangle if no unseen one emitted, relative to the mean: negative by discretisation
    /// error.
    lowest: Option<f64>,
}

/// The emissions of one triangle that explain the pictures, by channel.
#[derive(Serialize)]
struct Row {
    triangle: usize,
    mesh: String,
    material: String,
    seen: bool,
    emission: [f64; 3],
    explained_by: [Interval; 3],
}

pub fn run(arguments: &Arguments, quiet: bool, interrupt: &Interrupt) -> Result<(), Failure> {
    let scene = arguments.settings.load_resolved(&ResolveOptions::default().cut(false), interrupt)?.scene;
    let cameras = cameras::choose(&scene, &arguments.camera)?;
    if let Some(wrong) = arguments.triangle.iter().find(|&&i| i >= scene.triangles.len()) {
        let message = format!(
            "there is no triangle {wrong}: {} has {}, counted from 0",
            arguments.settings.mesh.file.scene.display(),
            scene.triangles.len()
        );
        return Err(Failure::Error(message.into()));
    }
    let directory =
        arguments.output.clone().unwrap_or_else(|| Path::new("out").join(&scene.name).join("ambiguity"));
    prepare_directory(&directory)?;
    let options = arguments.settings.backend.options(arguments.settings.memory_budget);
    let backend = Backend::open(Some(scene.settings.backend), &options)?;
    let asked = interrupt.clone();
    let watch: Watch = Arc::new(move || asked.flow());

    let rasterizer = Rasterizer::new(&backend)?;
    let views = Views::new(&rasterizer, &scene, &cameras, SUPERSAMPLE)?;
    let unseen = views.unseen(&scene);
    let mut direct = DirectLight::new(&backend, &scene, &watch).map_err(failure)?;
    let first_bounce =
        FirstBounce::new(&backend, &scene, &cameras, &views, &mut direct, &watch).map_err(failure)?;
    let mut report = Report {
        scene: arguments.settings.mesh.file.scene.display().to_string(),
        version: env!("CARGO_PKG_VERSION"),
        cameras: cameras.iter().map(|c| c.name.clone()).collect(),
        triangles: scene.triangles.len(),
        seen: views.seen.iter().filter(|&&seen| seen).count(),
        unseen: unseen.len(),
        without_area: scene.degenerate.len(),
        kernel_dimension: unseen.len(),
        first_bounce,
        left_out: reason_to_leave_out(arguments, &scene, &unseen),
        noise: arguments.noise,
        intervals: Vec::new(),
        determination_of_seen: None,
        determination_of_unseen: None,
        lowest: None,
    };
    let mut files = vec![directory.join("ambiguity.json")];
    if report.left_out.is_none() {
        let bar = if quiet { ProgressBar::hidden() } else { ProgressBar::new(unseen.len() as u64) };
        if let Ok(style) = ProgressStyle::with_template(
            "light of {pos}/{len} unseen triangles [{bar:30}] {elapsed} elapsed, {eta} left",
        ) {
            bar.set_style(style.progress_chars("=> "));
        }
        let light = direct.columns(&unseen, &mut |done| bar.set_position(done as u64)).map_err(failure)?;
        bar.finish_and_clear();
        let channels = polytopes(arguments, &scene, &views, &unseen, &light)?;
        report.intervals = intervals(arguments, &scene, &views, &unseen, &channels, interrupt)?;
        report.lowest = Some(channels.iter().map(|c| c.lowest).fold(0.0, f64::min));
        let determined = mean_determination(&channels);
        let areas = areas(&scene);
        report.determination_of_seen = mean(&determined, &areas, |i| views.seen[i]);
        report.determination_of_unseen = mean(&determined, &areas, |i| !views.seen[i]);
        files.extend(write_determination(&directory, &rasterizer, &scene, &determined)?);
        files.push(write_intervals(&directory, &report.intervals)?);
    }
    write_json(&files[0], &report)?;
    if !quiet {
        summarise(&report, &files);
    }
    Ok(())
}

fn failure(error: AmbiguityError) -> Failure {
    match error {
        AmbiguityError::Interrupted => Failure::Interrupted,
        other => other.into(),
    }
}

fn reason_to_leave_out(arguments: &Arguments, scene: &Scene, unseen: &[usize]) -> Option<String> {
    let glossy: Vec<&str> = (0..scene.triangles.len())
        .map(|i| scene.material(i))
        .filter(|m| m.is_glossy())
        .map(|m| m.name.as_str())
        .collect();
    if let Some(name) = glossy.first() {
        return Some(format!(
            "{} triangles are glossy (material \"{name}\"): intervals are for diffuse scenes",
            glossy.len()
        ));
    }
    (unseen.len() > arguments.max_unseen).then(|| {
        let bytes = Bytes((8 * unseen.len() * scene.triangles.len()) as u64);
        format!(
            "{} triangles are unseen, more than {}: raising --max-unseen takes {bytes} of memory and {} solves",
            unseen.len(),
            arguments.max_unseen,
            unseen.len().div_ceil(3)
        )
    })
}

fn areas(scene: &Scene) -> Vec<f64> {
    (0..scene.triangles.len()).map(|i| scene.area_vector(i).length()).collect()
}

/// One per channel.
fn polytopes(
    arguments: &Arguments,
    scene: &Scene,
    views: &Views,
    unseen: &[usize],
    direct: &LightMatrix,
) -> Result<Vec<Polytope>, Failure> {
    let areas = areas(scene);
    let of = |channel: usize| {
        let pick = |f: &dyn Fn(usize) -> [f64; 3]| -> Vec<f64> {
            (0..scene.triangles.len()).map(|i| f(i)[channel]).collect()
        };
        let albedo = pick(&|i| scene.material(i).diffuse_albedo());
        let emission = pick(&|i| scene.material(i).emission);
        Ok(Polytope::new(&Given {
            direct,
            albedo: &albedo,
            emission: &emission,
            areas: &areas,
            seen: &views.seen,
            unseen,
            noise: arguments.noise,
        })?)
    };
    (0..3).map(of).collect()
}

fn intervals(
    arguments: &Arguments,
    scene: &Scene,
    views: &Views,
    unseen: &[usize],
    channels: &[Polytope],
    interrupt: &Interrupt,
) -> Result<Vec<Row>, Failure> {
    let hidden: Vec<Vec<Interval>> = channels.iter().map(Polytope::unseen_intervals).collect();
    let sum = |i: &usize| scene.material(*i).emission.iter().sum::<f64>();
    let chosen: Vec<usize> = match arguments.triangle.is_empty() {
        false => arguments.triangle.clone(),
        true => {
            let mut lights: Vec<usize> =
                (0..scene.triangles.len()).filter(|i| views.seen[*i] && sum(i) > 0.0).collect();
            lights.sort_by(|a, b| sum(b).total_cmp(&sum(a)));
            lights.truncate(LIGHTS);
            // Of unseen triangles, lights first: the table shows the first rows.
            let (emitting, dark): (Vec<usize>, Vec<usize>) = unseen.iter().partition(|i| sum(i) > 0.0);
            lights.into_iter().chain(emitting).chain(dark).collect()
        }
    };
    let mut rows = Vec::new();
    for i in chosen {
        if interrupt.is_set() {
            return Err(Failure::Interrupted);
        }
        let found: Vec<Interval> = match unseen.binary_search(&i) {
            Ok(k) => hidden.iter().map(|channel| channel[k]).collect(),
            Err(_) if !views.seen[i] => {
                tracing::warn!("triangle {i} has no area, emits nothing and is left out");
                continue;
            }
            Err(_) => {
                let channel = |c: &Polytope| c.seen_interval(i);
                channels.iter().map(channel).collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect()
            }
        };
        let Ok(explained_by) = <[Interval; 3]>::try_from(found) else { continue };
        let mesh = scene.meshes.iter().find(|mesh| mesh.range.contains(&(i as u32)));
        rows.push(Row {
            triangle: i,
            mesh: mesh.map_or_else(String::new, |mesh| mesh.name.clone()),
            material: scene.material(i).name.clone(),
            seen: views.seen[i],
            emission: scene.material(i).emission,
            explained_by,
        });
    }
    Ok(rows)
}

fn mean_determination(channels: &[Polytope]) -> Vec<f64> {
    let of: Vec<Vec<f64>> = channels.iter().map(Polytope::determination).collect();
    (0..of[0].len()).map(|i| of.iter().map(|c| c[i]).sum::<f64>() / of.len() as f64).collect()
}

fn mean(values: &[f64], areas: &[f64], of: impl Fn(usize) -> bool) -> Option<f64> {
    let picked = || (0..values.len()).filter(|&i| of(i) && values[i].is_finite());
    let area: f64 = picked().map(|i| areas[i]).sum();
    (area > 0.0).then(|| picked().map(|i| areas[i] * values[i]).sum::<f64>() / area)
}

/// Writes the numbers and pictures of them: from all cameras of the scene, and from outside, with back faces left out.
fn write_determination(
    directory: &Path,
    rasterizer: &Rasterizer,
    scene: &Scene,
    determined: &[f64],
) -> Result<Vec<PathBuf>, Failure> {
    let numbers = directory.join("determination.npy");
    write_array(&numbers, &[determined.len() as u64], determined.iter().copied())?;
    let colours: Vec<[f64; 3]> = determined.iter().map(|&share| false_colour(share)).collect();
    let mut files = vec![numbers];
    let mut names = FileNames::default();
    let mut shoot = |scene: &Scene, camera: &Camera, colours: &[[f64; 3]]| -> Result<(), Failure> {
        let path = directory.join(format!("{}.png", names.of(&camera.name)));
        let picture = rasterizer.coverage(scene, camera, SUPERSAMPLE)?.picture(colours)?;
        picture.write_png(&path, &ToneMap::default().exposure(Exposure::Stops(0.0)).srgb(false))?;
        files.push(path);
        Ok(())
    };
    for camera in &scene.cameras {
        shoot(scene, camera, &colours)?;
    }
    for (name, side) in [("outside-1", 1.0), ("outside-2", -1.0)] {
        let framing = Camera::framing(&scene.vertices);
        let way = (framing.position - framing.target) * DVec3::new(side, 1.0, side);
        let camera = Camera { name: String::from(name), position: framing.target + way, ..framing };
        let faces: Vec<usize> = (0..scene.triangles.len())
            .filter(|&i| scene.area_vector(i).dot(camera.position - scene.corners(i)[0]) > 0.0)
            .collect();
        let facing = Scene {
            triangles: faces.iter().map(|&i| scene.triangles[i]).collect(),
            meshes: Vec::new(),
            degenerate: Vec::new(),
            creases: Vec::new(),
            ..scene.clone()
        };
        let colours: Vec<[f64; 3]> = faces.iter().map(|&i| colours[i]).collect();
        shoot(&facing, &camera, &colours)?;
    }
    Ok(files)
}

/// From dark violet (0: free) to yellow (1: determined), as sRGB values; grey for triangles left out.
fn false_colour(share: f64) -> [f64; 3] {
    if share.is_nan() {
        return [0.5; 3];
    }
    let colour = colorous::VIRIDIS.eval_continuous(share.clamp(0.0, 1.0));
    [colour.r, colour.g, colour.b].map(|value| f64::from(value) / 255.0)
}

fn write_intervals(directory: &Path, rows: &[Row]) -> Result<PathBuf, Failure> {
    let path = directory.join("intervals.csv");
    atomic_write(&path, |file| {
        let mut table = csv::Writer::from_writer(file);
        let heads =
            ["triangle", "mesh", "material", "seen", "channel", "emission", "least", "most", "method"];
        table.write_record(heads)?;
        for row in rows {
            for (channel, interval) in row.explained_by.iter().enumerate() {
                let most = interval.most.map_or_else(|| String::from("inf"), |most| most.to_string());
                let method = match interval.method {
                    antirad::ambiguity::Method::ClosedForm => "closed form",
                    antirad::ambiguity::Method::LinearProgram => "linear program",
                };
                table.write_record([
                    &row.triangle.to_string(),
                    &row.mesh,
                    &row.material,
                    &row.seen.to_string(),
                    ["red", "green", "blue"][channel],
                    &row.emission[channel].to_string(),
                    &interval.least.to_string(),
                    &most,
                    method,
                ])?;
            }
        }
        table.flush()
    })?;
    Ok(path)
}

/// Rows of the printed table.
const SHOWN: usize = 12;

fn summarise(report: &Report, files: &[PathBuf]) {
    antirad::say!("views       {}", report.cameras.join(", "));
    antirad::say!(
        "triangles   {} seen, {} unseen{}",
        report.seen,
        report.unseen,
        match report.without_area {
            0 => String::new(),
            n => format!(", {n} without area"),
        }
    );
    antirad::say!(
        "ker V       {} dimensions per channel: one for each unseen triangle, whose emission the others can compensate",
        report.kernel_dimension
    );
    match &report.first_bounce {
        None => antirad::say!("lights      none is hidden"),
        Some(bounce) => {
            antirad::say!(
                "lights      {} emitting triangles are hidden; if the walls emit the first bounce of their light instead,\n\
                 \x20           pictures differ by {:.1e} (relative RMS), faces by {:.1e} at most",
                bounce.hidden_lights.len(),
                bounce.picture_difference,
                bounce.largest_difference
            );
            if bounce.glossy > 0 {
                antirad::say!(
                    "            {} triangles are glossy: only the diffuse part of their first bounce counts",
                    bounce.glossy
                );
            }
        }
    }
    if let Some(reason) = &report.left_out {
        antirad::say!("intervals   left out: {reason}");
    }
    if !report.intervals.is_empty() {
        antirad::say!(
            "intervals   of emissions (mean of RGB) that explain the pictures within {:.1e}: of unseen triangles in closed form,\n\
             \x20           the minimum of seen ones by linear programming",
            report.noise
        );
        antirad::say!(
            "            {:>8}  {:<24} {:>10} {:>10} {:>10}",
            "triangle",
            "material",
            "now",
            "least",
            "most"
        );
        let by_material = report.intervals.iter().fold(BTreeMap::new(), |mut sums, row| {
            *sums.entry(row.material.as_str()).or_insert(0) += 1;
            sums
        });
        for row in report.intervals.iter().take(SHOWN) {
            let mean = |of: &dyn Fn(usize) -> f64| (0..3).map(of).sum::<f64>() / 3.0;
            let most = mean(&|c| row.explained_by[c].most.unwrap_or(f64::INFINITY));
            let least = mean(&|c| row.explained_by[c].least);
            antirad::say!(
                "            {:>8}  {:<24} {:>10.4} {:>10.4} {:>10}",
                row.triangle,
                format!("{}, {}", row.material, if row.seen { "seen" } else { "unseen" }),
                mean(&|c| row.emission[c]),
                least,
                if most.is_finite() { format!("{most:.4}") } else { String::from("no bound") }
            );
        }
        if report.intervals.len() > SHOWN {
            let counts: Vec<String> = by_material.iter().map(|(name, n)| format!("{n} of {name}")).collect();
            antirad::say!(
                "            … {} in all ({}), in intervals.csv",
                report.intervals.len(),
                counts.join(", ")
            );
        }
    }
    if let (Some(seen), Some(unseen)) = (report.determination_of_seen, report.determination_of_unseen) {
        antirad::say!(
            "determined  seen triangles {:.1} %, unseen ones {:.1} % (0: free, 100: fixed by the pictures; dark to yellow\n\
             \x20           in the pictures)",
            100.0 * seen,
            100.0 * unseen
        );
    }
    for file in files {
        antirad::say!("written     {}", file.display());
    }
}
