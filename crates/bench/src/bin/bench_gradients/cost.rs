//! The cost of gradients relative to that of their solve.

use crate::loss::{Loss, camera_positions};
use crate::{Arguments, backend};
use antirad::cli::Interrupt;
use antirad::gpu::Bytes;
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::scene::{LoadOptions, Scene, VisibilityChoice};
use antirad::{Engine, SolveParams};
use std::error::Error;
use std::path::Path;
use std::time::Instant;

/// The fastest counts: other programs share the machine.
const REPEATS: u32 = 3;

pub fn run(arguments: &Arguments, path: &Path, interrupt: &Interrupt) -> Result<(), Box<dyn Error>> {
    let backend = backend(arguments)?;
    let mut scene = Scene::load(path, &LoadOptions::default())?;
    scene.settings = scene.settings.bins(arguments.bins).visibility(VisibilityChoice::Implicit);
    let request = GradientRequest::NOTHING
        .emission(true)
        .diffuse(true)
        .albedo(true)
        .specular(true)
        .power(true)
        .positions(true);
    let plan = |gradients: GradientRequest| {
        Plan::new(&scene, &PlanOptions::of(&backend).gradients(gradients), &scene.settings)
    };
    let without = plan(GradientRequest::NOTHING)?.memory().total();
    let with = plan(request)?;
    let (triangles, bytes) = (with.triangles() as f64, with.memory().total());
    let staging = with.staging();
    let mut engine = Engine::new(&backend, &scene, with)?;
    let params = SolveParams::from(&scene.settings);
    let loss = Loss::new(scene.triangles.len());
    let mut cotangent = loss.cotangent(camera_positions(&scene));
    cotangent.colours.truncate(1);
    let watch = interrupt.clone();
    engine.set_pass_callback(Some(Box::new(move |_, _| watch.flow())));

    let (mut forward, mut backward) = (f64::INFINITY, f64::INFINITY);
    let (mut there, mut back) = (0, 0);
    for _ in 0..REPEATS {
        let start = Instant::now();
        let solution = engine.solve(&params)?;
        forward = forward.min(start.elapsed().as_secs_f64());
        let start = Instant::now();
        let gradients = engine.backward(&solution, &cotangent, request, &params)?;
        backward = backward.min(start.elapsed().as_secs_f64());
        (there, back) = (solution.info.passes, gradients.info.passes);
    }
    antirad::say!(
        "{}, {triangles} triangles, tolerance {:.0e}, the fastest of {REPEATS} runs",
        scene.name,
        params.tolerance
    );
    antirad::say!("  solve     {forward:8.2} s, {there} passes, {}", Bytes(without));
    antirad::say!("  gradients {backward:8.2} s, {back} passes, {} in all", Bytes(bytes));
    antirad::say!("  gradients take {:.2} times the solve (must be 4 or less)", backward / forward);
    antirad::say!("  {:.0} B per triangle in all, staging apart", (bytes - staging) as f64 / triangles);
    Ok(())
}
