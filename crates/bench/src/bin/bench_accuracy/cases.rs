//! Scenes with a known solution.

use crate::Interrupted;
use antirad::backend::Backend;
use antirad::cli::Interrupt;
use antirad::path_tracer::{MonteCarloEstimate, PathTracer};
use antirad::plan::{Occlusion, Plan, PlanOptions};
use antirad::scene::{LoadOptions, Material, Scene};
use antirad::{Engine, SolveParams};
use antirad_kit::{Plates, Shadow};
use glam::DVec3;
use rayon::prelude::*;
use std::error::Error;
use std::path::Path;

pub const NAMES: [&str; 13] = [
    "parallel",
    "perpendicular",
    "sphere_l3_r80",
    "cornell_empty_closed",
    "cornell_boxes",
    "glossy_floor",
    "shadow_0.4_0.25",
    "shadow_0.4_1",
    "shadow_0.4_1.5",
    "shadow_0.1_0.25",
    "shadow_0.1_1",
    "shadow_0.1_1.5",
    "plates_2",
];

/// Paths for each triangle of a scene without a reference.
pub const SAMPLES: u32 = 1024;
/// Paths for each triangle for direct light alone, from which shadows are determined.
const SHADOW_SAMPLES: u32 = 256;
/// A triangle is in shadow if it receives less than this fraction of the lamps' light.
const SHADOW: f64 = 0.5;

/// The true irradiance.
#[derive(Clone)]
pub enum Truth {
    /// True irradiance of each triangle of the unrefined scene, W/m².
    Triangles(Vec<DVec3>),
    /// The mean over triangles of a material.
    Mean { material: &'static str, irradiance: f64 },
}

#[derive(Clone)]
pub struct Case {
    pub name: String,
    pub scene: Scene,
    pub truth: Truth,
    /// Relative L2 of the standard errors of the truth, where it was path-traced here.
    pub noise: Option<f64>,
    /// m².
    pub areas: Vec<f64>,
    /// Irradiance from lamps without blockers, W/m², and which triangles are in shadow.
    pub blocked: Vec<DVec3>,
    pub in_shadow: Vec<bool>,
}

impl Case {
    /// One of [`NAMES`].
    pub fn new(
        name: &str,
        root: &Path,
        backend: &Backend,
        interrupt: &Interrupt,
    ) -> Result<Self, Box<dyn Error>> {
        let load = |path: &str| Scene::load(&root.join(path), &LoadOptions::default());
        let data = |name: &str| read(&root.join(format!("tests/data/{name}.irradiance.npy")));
        let square = |name: &str, form_factor: f64| -> Result<_, Box<dyn Error>> {
            let scene = load(&format!("tests/data/{name}.obj"))?;
            let exitance = brightest(&scene) * std::f64::consts::PI;
            Ok((scene, Truth::Mean { material: "recv", irradiance: form_factor * exitance }))
        };
        let (scene, truth) = match name {
            "parallel" => square(name, 0.199_824_895_698)?,
            "perpendicular" => square(name, 0.200_043_776_075)?,
            // Exitance 1 and albedo 0.8 everywhere: E = 1 / (1 - ρ).
            "sphere_l3_r80" => {
                let scene = load("tests/data/sphere_l3_r80.obj")?;
                let truth = Truth::Triangles(vec![DVec3::splat(5.0); scene.triangles.len()]);
                (scene, truth)
            }
            "cornell_empty_closed" => {
                (load("tests/data/cornell_empty_closed.obj")?, Truth::Triangles(data(name)?))
            }
            "cornell_boxes" => (load("scenes/cornell_boxes.toml")?, Truth::Triangles(data(name)?)),
            "plates_2" => {
                let plates = Plates { count: 2, ..Default::default() };
                return Self::traced(name, plates.scene()?, SAMPLES, backend, interrupt);
            }
            "glossy_floor" => {
                return Self::traced(name, load("scenes/glossy_floor.toml")?, SAMPLES, backend, interrupt);
            }
            _ => {
                let mut numbers = name.split('_').skip(1).map(str::parse::<f64>);
                let (Some(Ok(lamp)), Some(Ok(height))) = (numbers.next(), numbers.next()) else {
                    return Err(format!("{name} is not a shadow scene").into());
                };
                let shadow = Shadow { lamp, height };
                let scene = shadow.scene()?;
                let exact = shadow.irradiance(&scene);
                let truth = exact.iter().map(|[shaded, _]| DVec3::splat(*shaded)).collect();
                let blocked = exact.iter().map(|[shaded, open]| DVec3::splat(open - shaded)).collect();
                let case = Self::with_truth(name, scene, Truth::Triangles(truth), backend, interrupt)?;
                return Ok(Self { blocked, ..case });
            }
        };
        Self::with_truth(name, scene, truth, backend, interrupt)
    }

    /// Any scene, with truth path-traced by `samples` paths per triangle.
    pub fn traced(
        name: &str,
        scene: Scene,
        paths: u32,
        backend: &Backend,
        interrupt: &Interrupt,
    ) -> Result<Self, Box<dyn Error>> {
        let found = trace(&scene, paths, interrupt)?;
        let squares = |of: fn(&MonteCarloEstimate) -> DVec3| -> f64 {
            let each = found.iter().enumerate();
            each.map(|(i, estimate)| scene.area_vector(i).length() * of(estimate).length_squared()).sum()
        };
        let noise = (squares(|e| e.error) / squares(|e| e.mean)).sqrt();
        let truth = Truth::Triangles(found.into_iter().map(|estimate| estimate.mean).collect());
        Ok(Self { noise: Some(noise), ..Self::with_truth(name, scene, truth, backend, interrupt)? })
    }

    fn with_truth(
        name: &str,
        scene: Scene,
        truth: Truth,
        backend: &Backend,
        interrupt: &Interrupt,
    ) -> Result<Self, Box<dyn Error>> {
        let areas: Vec<f64> = (0..scene.triangles.len()).map(|i| scene.area_vector(i).length()).collect();
        let black = black(&scene);
        let unoccluded = without_blockers(backend, &black)?;
        let direct = trace(&black, SHADOW_SAMPLES, interrupt)?;
        let lit = unoccluded.iter().zip(&areas).map(|(e, a)| a * e.element_sum()).sum::<f64>()
            / areas.iter().sum::<f64>();
        let blocked = direct.iter().zip(&unoccluded).map(|(d, u)| *u - d.mean).collect();
        let in_shadow = direct
            .iter()
            .zip(&unoccluded)
            .map(|(d, u)| u.element_sum() > 0.05 * lit && d.mean.element_sum() < SHADOW * u.element_sum())
            .collect();
        Ok(Self { name: name.to_owned(), scene, truth, noise: None, areas, blocked, in_shadow })
    }
}

/// The irradiance of each triangle, by `samples` paths each.
fn trace(scene: &Scene, samples: u32, interrupt: &Interrupt) -> Result<Vec<MonteCarloEstimate>, Interrupted> {
    let tracer = PathTracer::new(scene);
    let one = |j| (!interrupt.is_set()).then(|| tracer.irradiance_of(j, samples));
    (0..scene.triangles.len()).into_par_iter().map(one).collect::<Option<_>>().ok_or(Interrupted)
}

fn brightest(scene: &Scene) -> f64 {
    scene.materials.iter().flat_map(|m| m.emission).fold(0.0, f64::max)
}

/// The scene with black materials, so that there is direct light only.
fn black(scene: &Scene) -> Scene {
    let mut black = scene.clone();
    for material in &mut black.materials {
        *material = Material { emission: material.emission, ..Material::named(material.name.clone()) };
    }
    black
}

fn without_blockers(backend: &Backend, scene: &Scene) -> Result<Vec<DVec3>, Box<dyn Error>> {
    let options = PlanOptions::of(backend).occlusion(Occlusion::Nothing);
    let plan = Plan::new(scene, &options, &scene.settings)?;
    let solution = Engine::new(backend, scene, plan)?.solve(&SolveParams::from(&scene.settings))?;
    Ok(solution.irradiance.into_iter().map(DVec3::from).collect())
}

/// Rows of an array [n, 3].
fn read(path: &Path) -> Result<Vec<DVec3>, Box<dyn Error>> {
    let name =
        |error: std::io::Error| format!("{}: {error}; set --root to the project's folder", path.display());
    let bytes = std::fs::read(path).map_err(name)?;
    let array = antirad_base::npy::read(&bytes)?;
    Ok(array.numbers.chunks_exact(3).map(DVec3::from_slice).collect())
}
