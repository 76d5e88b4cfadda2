//! The gradient at the start of a fit against central differences of path-traced pictures.

use crate::{Arguments, Interrupted, backend};
use antirad::Watch;
use antirad::cli::{Interrupt, PartsBar};
use antirad::fit::{EngineRenderer, JobFile, Problem, Renderer, Target};
use antirad::path_tracer::PathTracer;
use antirad::scene::{Camera, Scene};
use glam::DVec3;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;

/// Pixels of each view.
type Pictures = Vec<Vec<DVec3>>;

/// Pictures of scenes near each other, path-traced.
struct Traced<'a> {
    problem: &'a Problem,
    samples: u32,
    bar: PartsBar,
    interrupt: &'a Interrupt,
}

impl Traced<'_> {
    /// The views of a scene. Equal seeds have common random numbers.
    fn pictures(&self, scene: &Scene, seed: u64) -> Result<Pictures, Interrupted> {
        let tracer = PathTracer::new(scene);
        let (bar, interrupt) = (&self.bar, self.interrupt);
        let of_view = |camera: &Camera| {
            let row_done = || {
                bar.part_done();
                interrupt.flow()
            };
            let traced = tracer.picture_with(camera, self.samples, seed, &row_done).ok_or(Interrupted)?;
            Ok(traced.pixels.iter().map(|pixel| pixel.radiance.mean).collect())
        };
        self.problem.targets.iter().map(|target| of_view(&target.camera)).collect()
    }

    /// The derivative of the pictures by an unknown: a central difference of half width `step`.
    fn derivative(&self, unknown: usize, step: f64, seed: u64) -> Result<Pictures, Interrupted> {
        let at = |step: f64| {
            let mut x = self.problem.parameters.start().to_vec();
            x[unknown] += step;
            self.pictures(&self.problem.parameters.scene(&x), seed)
        };
        let (above, below) = (at(step)?, at(-step)?);
        let pixels = |(a, b): (Vec<DVec3>, Vec<DVec3>)| {
            a.into_iter().zip(b).map(|(a, b)| (a - b) / (2.0 * step)).collect()
        };
        Ok(above.into_iter().zip(below).map(pixels).collect())
    }
}

/// The derivatives of the loss by the pixels of each view.
fn cotangent(problem: &Problem, pictures: &Pictures) -> Pictures {
    let weights: f64 = problem.targets.iter().map(|target| target.weight).sum();
    let of_view = |(view, picture): (usize, &Vec<DVec3>)| {
        let target = &problem.targets[view];
        let (_, by_pixel) = problem.loss.evaluate(view, picture, target);
        by_pixel.into_iter().map(|g| target.weight / weights * g).collect()
    };
    pictures.iter().enumerate().map(of_view).collect()
}

fn product(a: &Pictures, b: &Pictures) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a.dot(*b)).sum()
}

/// Mean and standard error.
fn mean(values: &[f64]) -> (f64, f64) {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, (variance / n).sqrt())
}

/// The names of the unknowns.
fn names(problem: &Problem) -> Vec<String> {
    let of_value = |value: antirad::fit::Recovered| {
        let components: &[&str] = match (value.value.len(), value.unit) {
            (1, _) => &[""],
            (_, "m" | "°") => &[" x", " y", " z"],
            _ => &[" red", " green", " blue"],
        };
        let name = format!("{} of {}", value.quantity, value.of);
        components.iter().map(|component| format!("{name}{component}")).collect::<Vec<_>>()
    };
    problem.parameters.recovered(problem.parameters.start()).into_iter().flat_map(of_value).collect()
}

/// Prints, for each unknown of a fit, the derivative of the loss where the fit starts: of path-traced pictures, and antirad's.
///
/// The loss is quadratic in the pictures, so its derivative is the product of two quantities that are linear in them: its
/// cotangent, and the derivative of the pictures. Both are estimated from different seeds, hence their product has no bias.
pub fn run(arguments: &Arguments, path: &Path, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let file = JobFile::load(path)?;
    let problem = file.job.problem();
    let is_plain = |target: &Target| target.clip.is_none() && !target.exposure.is_fitted();
    if !problem.loss.is_quadratic() || !problem.targets.iter().all(is_plain) {
        return Err(format!(
            "{}: the loss must be l2 or relative-l2, whose derivatives are linear, and exposures known",
            path.display()
        )
        .into());
    }
    let (parameters, step) = (&problem.parameters, arguments.step);
    let rows: u64 = problem.targets.iter().map(|target| u64::from(target.camera.height)).sum();
    let pictures = u64::from(arguments.repetitions) * (1 + 2 * parameters.len() as u64);
    let bar = PartsBar::new(rows * pictures, arguments.quiet);
    let traced = Traced { problem, samples: arguments.samples, bar, interrupt };
    let start = parameters.scene(parameters.start());
    let mut products = vec![Vec::new(); parameters.len()];
    let mut cotangents = Vec::new();
    for repetition in 0..u64::from(arguments.repetitions) {
        traced.bar.begin(&format!("repetition {}", repetition + 1));
        cotangents.push(cotangent(problem, &traced.pictures(&start, 2 * repetition)?));
        for (unknown, products) in products.iter_mut().enumerate() {
            let derivative = traced.derivative(unknown, step, 2 * repetition + 1)?;
            products.push(product(&cotangents[cotangents.len() - 1], &derivative));
        }
    }
    traced.bar.finish();
    let true_cotangent: Pictures = (0..problem.targets.len())
        .map(|view| {
            let n = cotangents.len() as f64;
            let of_pixel = |pixel: usize| cotangents.iter().map(|c| c[view][pixel]).sum::<DVec3>() / n;
            (0..problem.targets[view].pixels.len()).map(of_pixel).collect()
        })
        .collect();

    let stop = interrupt.clone();
    let watch: Watch = Arc::new(move || stop.flow());
    let supersample = file.job.settings().supersample;
    let request = parameters.gradient_request();
    let planning = parameters.planning_scene();
    let mut renderer = EngineRenderer::new(backend(arguments)?, planning, supersample, request, watch)?;
    let own_cotangent = cotangent(problem, &renderer.pictures(&start)?);
    let mut gradient = |by_pixels: &Pictures| -> Result<Vec<f64>, Box<dyn Error>> {
        let by_scene = renderer.pull_back(by_pixels, request)?;
        Ok(parameters.pull_back(parameters.start(), &by_scene.ok_or("this renderer has no derivatives")?))
    };
    let (of_pictures, of_loss) = (gradient(&true_cotangent)?, gradient(&own_cotangent)?);

    antirad::say!("{}: the derivative of its loss where it starts, per unit of each unknown", file.job.name);
    antirad::say!(
        "path traced: {} pairs of pictures at ± {step}, {} samples a pixel",
        arguments.repetitions,
        arguments.samples
    );
    antirad::say!(
        "antirad's pictures: the same cotangent by the pixels, times the derivative of its pictures"
    );
    antirad::say!("antirad's loss: its own cotangent, too");
    antirad::say!("{:<28} {:>24} {:>22} {:>22}", "", "path traced", "antirad's pictures", "antirad's loss");
    let off = |found: f64, truth: f64| format!("{found:.4e} {:+.1} %", 100.0 * (found / truth - 1.0));
    for (k, name) in names(problem).iter().enumerate() {
        let (truth, error) = mean(&products[k]);
        antirad::say!(
            "{name:<28} {:>24} {:>22} {:>22}",
            format!("{truth:.4e} ± {:.1} %", 100.0 * error / truth.abs()),
            off(of_pictures[k], truth),
            off(of_loss[k], truth)
        );
    }
    Ok(())
}
