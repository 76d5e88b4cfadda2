//! Pictures of scenes beside the truth.

use crate::Arguments;
use crate::cases::{Case, Truth};
use crate::measure::{Errors, colours, interrupted_or, is_diffuse};
use antirad::backend::Backend;
use antirad::cli::{Interrupt, Panel, Sheet, percentile, signed_heat, white_point};
use antirad::image::{ImageError, Rasterizer};
use antirad::plan::{Plan, PlanOptions};
use antirad::scene::{Camera, Lamps, LoadOptions, Scene, VisibilityChoice};
use antirad::warnings::{RefineOptions, refine};
use antirad::{Engine, SolveParams};
use antirad_render::image::Coverage;
use glam::DVec3;
use indicatif::{ProgressBar, ProgressStyle};
use std::error::Error;
use std::path::Path;
use std::time::{Duration, Instant};

/// Samples along each side of a pixel.
const SUPERSAMPLE: u32 = 2;

/// A scene or a variation of it, with computed and true values.
struct Compared {
    /// What distinguishes it from other variations.
    label: String,
    /// Paths per triangle of the truth.
    paths: u32,
    case: Case,
    /// W/m².
    found: Vec<DVec3>,
    truth: Vec<DVec3>,
    errors: Errors,
    /// Time of planning and the solve, s.
    seconds: f64,
}

/// Both as a camera sees them, W/(m² sr); `None` where it sees no face.
struct Seen {
    found: Vec<Option<DVec3>>,
    truth: Vec<Option<DVec3>>,
}

/// Draws a sheet for each scene and camera: the computed picture with light by antiradiance, the truth in the same exposure, and their
/// signed difference; below, the same for its variations, and with exact lamps. Errors go to standard output.
pub fn draw(arguments: &Arguments, backend: &Backend, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let bar = if arguments.quiet { ProgressBar::hidden() } else { ProgressBar::new_spinner() };
    bar.set_style(ProgressStyle::with_template("{spinner} {msg}, {elapsed} elapsed")?);
    bar.enable_steady_tick(Duration::from_millis(200));
    let mut table = vec![
        String::from(
            "| scene | triangles | bins | lamps | error | largest | in shadows, of what is blocked | of what is there | noise of the truth | solve, s |",
        ),
        String::from("|---|---|---|---|---|---|---|---|---|---|"),
    ];
    for path in &arguments.pictures {
        let scene = Scene::load(path, &LoadOptions::default())?;
        if !is_diffuse(&scene) {
            return Err(format!(
                "{} has glossy materials, whose radiance does not follow from the irradiance that is compared here; use \
                 diffuse ones, or `antirad trace` and `antirad compare`",
                path.display()
            )
            .into());
        }
        let selected = |camera: &Camera| arguments.camera.as_ref().is_none_or(|name| *name == camera.name);
        let cameras: Vec<Camera> = scene.cameras.iter().filter(|c| selected(c)).cloned().collect();
        if cameras.is_empty() {
            let known: Vec<&str> = scene.cameras.iter().map(|c| c.name.as_str()).collect();
            return Err(format!("{} has these cameras only: {}", path.display(), known.join(", ")).into());
        }
        let mut rows: Vec<Compared> = Vec::new();
        for (label, scene) in variations(scene, arguments, backend, interrupt)? {
            bar.set_message(format!("{}, {label}", scene.name));
            let known = rows.iter().find(|row| row.case.scene.triangles.len() == scene.triangles.len());
            let case = match known {
                Some(row) => Case { scene, ..row.case.clone() },
                None => {
                    let name = scene.name.clone();
                    Case::traced(&name, scene, arguments.paths, backend, interrupt)?
                }
            };
            let compared = Compared::new(label, case, arguments.paths, backend, interrupt)?;
            table.push(compared.line());
            rows.push(compared);
        }
        write(&rows, &cameras, backend, &arguments.output)?;
    }
    bar.finish_and_clear();
    if !arguments.quiet {
        antirad::say!("{}", table.join("\n"));
    }
    Ok(())
}

/// The scene by antiradiance, finer, and with other bins, as far as asked for, and with exact lamps, each with its label.
fn variations(
    given: Scene,
    arguments: &Arguments,
    backend: &Backend,
    interrupt: &Interrupt,
) -> Result<Vec<(String, Scene)>, Box<dyn Error>> {
    let with_lamps = |lamps: Lamps| {
        let settings = given.settings.lamps(lamps).visibility(VisibilityChoice::Implicit);
        Scene { settings, ..given.clone() }
    };
    let scene = with_lamps(Lamps::Antiradiance);
    let mut more = Vec::new();
    if arguments.refine {
        let mut finer = scene.clone();
        interrupt
            .while_computing(|| refine(&mut finer, &PlanOptions::of(backend), &RefineOptions::default()))?;
        more.push((format!("refined to {} triangles", finer.triangles.len()), finer));
    }
    if let Some(bins) = arguments.bins {
        let settings = scene.settings.bins(bins);
        more.push((format!("{bins} bins"), Scene { settings, ..scene.clone() }));
    }
    let usual = match arguments.bins {
        Some(_) => format!("{} bins", scene.settings.bins),
        None => format!("{} triangles", scene.triangles.len()),
    };
    more.insert(0, (usual, scene));
    more.push((String::from("lamps exact"), with_lamps(Lamps::Exact)));
    Ok(more)
}

impl Compared {
    fn new(
        label: String,
        case: Case,
        paths: u32,
        backend: &Backend,
        interrupt: &Interrupt,
    ) -> Result<Self, Box<dyn Error>> {
        let scene = &case.scene;
        let begun = Instant::now();
        let plan = Plan::new(scene, &PlanOptions::of(backend), &scene.settings)?;
        let mut engine = Engine::new(backend, scene, plan)?;
        let stop = interrupt.clone();
        engine.set_pass_callback(Some(Box::new(move |_, _| stop.flow())));
        let solution = engine
            .solve(&SolveParams::from(&scene.settings))
            .map_err(|error| interrupted_or(error, interrupt))?;
        let found: Vec<DVec3> = solution.irradiance.iter().copied().map(DVec3::from).collect();
        let seconds = begun.elapsed().as_secs_f64();
        let Truth::Triangles(truth) = &case.truth else {
            return Err(format!("{} was not traced", case.name).into());
        };
        let (errors, truth) = (Errors::new(&case, &found, truth), truth.clone());
        Ok(Self { label, paths, case, found, truth, errors, seconds })
    }

    /// A row of the table.
    fn line(&self) -> String {
        let Errors { relative, largest, shadow, dark, .. } = self.errors;
        let share = |value: f64| format!("{:.1} %", 100.0 * value);
        let cells = [
            format!("`{}`", self.case.name),
            self.found.len().to_string(),
            self.case.scene.settings.bins.to_string(),
            String::from(match self.case.scene.settings.lamps {
                Lamps::Antiradiance => "by antiradiance",
                _ => "exact",
            }),
            share(relative),
            share(largest),
            shadow.map_or_else(|| String::from("none"), share),
            dark.map_or_else(|| String::from("none"), share),
            share(self.case.noise.unwrap_or(0.0)),
            format!("{:.1}", self.seconds),
        ];
        format!("| {} |", cells.join(" | "))
    }

    fn seen(&self, coverage: &Coverage) -> Result<Seen, ImageError> {
        let seen = |irradiance: &[DVec3]| -> Result<Vec<Option<DVec3>>, ImageError> {
            let pixels = coverage.pixels(&colours(&self.case.scene, irradiance))?;
            Ok(pixels.into_iter().map(|[r, g, b, a]| (a > 0.0).then(|| DVec3::new(r, g, b))).collect())
        };
        Ok(Seen { found: seen(&self.found)?, truth: seen(&self.truth)? })
    }
}

/// A sheet for each camera.
fn write(
    rows: &[Compared],
    cameras: &[Camera],
    backend: &Backend,
    directory: &Path,
) -> Result<(), Box<dyn Error>> {
    let rasterizer = Rasterizer::new(backend)?;
    for camera in cameras {
        let view = |row: &Compared| -> Result<Seen, ImageError> {
            row.seen(&rasterizer.coverage(&row.case.scene, camera, SUPERSAMPLE)?)
        };
        let views = rows.iter().map(view).collect::<Result<Vec<_>, _>>()?;
        let white = white_point(views[0].truth.iter().flatten().copied());
        let differences = views.iter().flat_map(Seen::differences);
        let limit = rounded(percentile(differences.map(f64::abs), 99).unwrap_or(white));
        let sheet = Sheet {
            width: camera.width,
            height: camera.height,
            rows: rows.iter().zip(&views).map(|(row, view)| panels(row, view, white, limit)).collect(),
            limit: Some(limit),
        };
        let name = format!("{}_{}_against_truth.png", rows[0].case.name, camera.name);
        sheet.write(&directory.join(name))?;
    }
    Ok(())
}

impl Seen {
    /// Computed minus true, mean over RGB; 0 where there is no face.
    fn differences(&self) -> impl Iterator<Item = f64> {
        let mean = |pixel: &Option<DVec3>| pixel.map_or(0.0, |p| p.element_sum() / 3.0);
        self.found.iter().zip(&self.truth).map(move |(found, truth)| mean(found) - mean(truth))
    }
}

fn panels(row: &Compared, view: &Seen, white: f64, limit: f64) -> Vec<Panel> {
    // Not black, which would look like a face in the dark.
    let background = DVec3::splat(0.02);
    let shown = |pixels: &[Option<DVec3>]| -> Vec<DVec3> {
        pixels.iter().map(|pixel| pixel.map_or(background, |p| p / white)).collect()
    };
    let coloured = view.differences().zip(&view.truth);
    let difference = coloured.map(|(d, t)| if t.is_some() { signed_heat(d / limit) } else { background });
    let Compared { label, paths, case, errors, .. } = row;
    vec![
        Panel {
            caption: format!("ours, {label}: error {:.1} %", 100.0 * errors.relative),
            pixels: shown(&view.found),
        },
        Panel {
            caption: format!("path traced, {paths} paths: noise {:.1} %", 100.0 * case.noise.unwrap_or(0.0)),
            pixels: shown(&view.truth),
        },
        Panel {
            caption: format!("ours − path traced, W/(m² sr); white = {white:.2}"),
            pixels: difference.collect(),
        },
    ]
}

/// The next of 1, 2, 4, 10, 20, …, of which the half is round, too.
fn rounded(limit: f64) -> f64 {
    let power = 10.0_f64.powi(limit.log10().floor() as i32);
    [1.0, 2.0, 4.0, 10.0]
        .into_iter()
        .map(|factor| factor * power)
        .find(|round| *round >= limit)
        .unwrap_or(limit)
}
