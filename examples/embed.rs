// A scene made in memory, solved, and its irradiance read back: cargo run --release --example embed

use antirad::backend::Backend;
use antirad::gpu::DeviceOptions;
use antirad::plan::{Plan, PlanOptions};
use antirad::scene::{Material, SceneBuilder, Shape};
use antirad::{Engine, SolveParams};
use glam::{DAffine3, DQuat, DVec3};
use std::error::Error;

fn main() -> Result<(), Box<dyn Error>> {
    let wall = Material { albedo: [0.7, 0.6, 0.5], ..Material::named("wall") };
    // Radiance, W/(m² sr).
    let light = Material { emission: [10.0; 3], ..Material::named("lamp") };

    // A room of one metre; under its ceiling a lamp that faces down, and a table that shades the floor.
    let place = |scale: [f64; 3], at: [f64; 3]| {
        DAffine3::from_scale_rotation_translation(scale.into(), DQuat::IDENTITY, at.into())
    };
    let mut builder = SceneBuilder::new();
    builder
        .shape("room", Shape::Room { cells: 8 }, &wall, DAffine3::IDENTITY)
        // The shape faces up; mirrored, it faces down.
        .shape("lamp", Shape::Quad { cells: 2 }, &light, place([0.4, -1.0, 0.4], [0.3, 0.95, 0.3]))
        .shape("table", Shape::Box { cells: 3 }, &wall, place([0.4, 0.05, 0.4], [0.3, 0.4, 0.3]));
    let scene = builder.finish("room")?;
    for warning in &scene.warnings {
        eprintln!("{warning}");
    }

    // A GPU if there is one, otherwise the CPU, which `Backend::cpu()` is, too.
    let backend = Backend::open(None, &DeviceOptions::default())?;
    let plan = Plan::new(&scene, &PlanOptions::of(&backend), &scene.settings)?;
    println!("{backend:?}: {} triangles, {} bytes", plan.triangles(), plan.memory().total());
    let mut engine = Engine::new(&backend, &scene, plan)?;
    let solution = engine.solve(&SolveParams::from(&scene.settings))?;
    println!(
        "{} passes to a residual of {:.1e}",
        solution.info.passes,
        solution.info.residuals.last().unwrap_or(&0.0)
    );
    println!("emitted  {:.3?} W", solution.energy.emitted);
    println!("absorbed {:.3?} W", solution.energy.absorbed);

    // One row per triangle, mesh after mesh; the room is the first.
    let room = scene.meshes[0].range.clone();
    let floor = |near: &dyn Fn(DVec3) -> bool| {
        let centroid = |i: usize| scene.corners(i).iter().sum::<DVec3>() / 3.0;
        let of_floor = |i: &usize| centroid(*i).y == 0.0 && near(centroid(*i));
        let picked = room.clone().map(|i| i as usize).filter(of_floor);
        let red: Vec<f64> = picked.map(|i| solution.irradiance[i][0]).collect();
        red.iter().sum::<f64>() / red.len() as f64
    };
    let under = |x: DVec3| (x.x - 0.5).abs().max((x.z - 0.5).abs()) < 0.2;
    println!("red irradiance of the floor under the table: {:.3} W/m²", floor(&under));
    println!("                           beside the table: {:.3} W/m²", floor(&|x| !under(x)));
    Ok(())
}
