//! `antirad trace`.

use crate::Failure;
use crate::cameras;
use crate::render::parse_exposure;
use crate::settings::SceneFile;
use antirad::cli::{Interrupt, PartsBar};
use antirad::image::{Exposure, ToneMap};
use antirad::output::{FileNames, prepare_directory, write_json};
use antirad::path_tracer::{PathTracer, TracedPicture};
use antirad::scene::Camera;
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

#[derive(Args)]
#[command(after_help = "Examples:
  antirad trace scenes/cornell_boxes.toml
  antirad trace scenes/glossy_floor.toml --samples 1024 --output out/truth
  antirad trace scenes/fits/box.toml --camera shadow --samples 4096 --seed 1")]
pub struct Arguments {
    #[command(flatten)]
    file: SceneFile,
    /// Trace this camera only; may be given several times [default: all cameras of the scene]
    #[arg(long, value_name = "NAME")]
    camera: Vec<String>,
    /// Paths per pixel, at least; 16 times a square number is best. Four times as many halve the noise, or better
    #[arg(long, value_name = "NUMBER", default_value_t = 64, value_parser = clap::value_parser!(u32).range(2..))]
    samples: u32,
    /// Pictures of another seed have other noise; of the same seed, the same bytes
    #[arg(long, value_name = "NUMBER", default_value_t = 0)]
    seed: u64,
    /// Folder for the results [default: out/traced/SCENE]
    #[arg(long, short, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Exposure of the PNG in stops (0 shows radiance 1 as white), or auto
    #[arg(long, value_name = "STOPS|auto", default_value = "auto", allow_hyphen_values = true, value_parser = parse_exposure)]
    exposure: Exposure,
    /// Write linear instead of sRGB values to the PNG
    #[arg(long)]
    linear_png: bool,
}

/// What `report.json` says.
#[derive(Serialize)]
struct Report {
    scene: String,
    version: &'static str,
    samples: u32,
    seed: u64,
    warnings: Vec<String>,
    pictures: Vec<PictureReport>,
}

#[derive(Serialize)]
struct PictureReport {
    camera: String,
    files: [String; 3],
    /// Relative L2 of the standard errors of the pixels.
    noise: f64,
    seconds: f64,
}

pub fn run(arguments: &Arguments, quiet: bool, interrupt: &Interrupt) -> Result<(), Failure> {
    let scene = arguments.file.load()?;
    let cameras = cameras::choose(&scene, &arguments.camera)?;
    let directory = arguments.output.clone().unwrap_or_else(|| Path::new("out/traced").join(&scene.name));
    prepare_directory(&directory)?;

    let tracer = PathTracer::new(&scene);
    let bar = PartsBar::new(cameras.iter().map(|camera| u64::from(camera.height)).sum(), quiet);
    let trace = |camera: &Camera| -> Result<(TracedPicture, f64), Failure> {
        bar.begin(&camera.name);
        let start = Instant::now();
        let row_done = || {
            bar.part_done();
            interrupt.flow()
        };
        let traced = tracer.picture_with(camera, arguments.samples, arguments.seed, &row_done);
        Ok((traced.ok_or(Failure::Interrupted)?, start.elapsed().as_secs_f64()))
    };
    let traced = cameras.iter().map(|camera| trace(camera)).collect::<Result<Vec<_>, _>>();
    bar.finish();
    let traced = traced?;

    let tone = ToneMap::default().exposure(arguments.exposure).srgb(!arguments.linear_png);
    let (mut pictures, mut names) = (Vec::new(), FileNames::default());
    for (Camera { name, .. }, (traced, seconds)) in cameras.iter().zip(&traced) {
        // `a.error.exr` is that of the errors of `a`.
        let file = names.of(&name.replace(".error", "_error"));
        let files = ["exr", "png", "error.exr"].map(|ending| format!("{file}.{ending}"));
        let [exr, png, error] = files.each_ref().map(|file| directory.join(file));
        let picture = traced.picture();
        picture.write_exr(exr)?;
        picture.write_png(png, &tone)?;
        traced.standard_error().write_exr(error)?;
        pictures.push(PictureReport {
            camera: name.clone(),
            files,
            noise: traced.noise(),
            seconds: *seconds,
        });
    }
    let report = Report {
        scene: arguments.file.scene.display().to_string(),
        version: env!("CARGO_PKG_VERSION"),
        samples: arguments.samples,
        seed: arguments.seed,
        warnings: scene.warnings.clone(),
        pictures,
    };
    write_json(&directory.join("report.json"), &report)?;
    if !quiet {
        for picture in &report.pictures {
            antirad::say!(
                "{}: noise {:.2} % (relative L2 of the standard errors), {:.1} s",
                picture.camera,
                100.0 * picture.noise,
                picture.seconds
            );
        }
        antirad::say!("written     {}", directory.display());
        let files = report.pictures.iter().flat_map(|picture| &picture.files).map(String::as_str);
        for file in files.chain(["report.json"]) {
            antirad::say!("            {}", directory.join(file).display());
        }
    }
    Ok(())
}
