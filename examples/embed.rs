// A scene made in memory, solved, and its irradiance read back: cargo run --release --example embed

use antirad::gpu::{Device, DeviceOptions};
use antirad::plan::{Limits, Plan};
use antirad::scene::{Material, Scene, Shape, Triangle};
use antirad::{Engine, SolveParams};
use glam::DVec3;
use std::error::Error;
use std::ops::Range;

/// Vertices and triangles as they are put together.
#[derive(Default)]
struct Mesh {
    vertices: Vec<DVec3>,
    triangles: Vec<Triangle>,
}

impl Mesh {
    /// Adds a shape of one material, each of its vertices moved by `place`; returns its triangles' numbers.
    fn add(&mut self, shape: Shape, material: u32, place: impl Fn(DVec3) -> DVec3) -> Range<usize> {
        let (vertices, faces) = shape.mesh();
        let first = self.triangles.len();
        let base = self.vertices.len() as u32;
        self.vertices.extend(vertices.into_iter().map(place));
        self.triangles
            .extend(faces.iter().map(|face| Triangle { vertices: face.map(|v| base + v), material }));
        first..self.triangles.len()
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    const WALL: u32 = 0;
    const LAMP: u32 = 1;
    let materials = vec![
        Material { albedo: [0.7, 0.6, 0.5], ..Material::named("wall") },
        // Radiance, W/(m² sr).
        Material { emission: [10.0; 3], ..Material::named("lamp") },
    ];

    // A room of one metre; under its ceiling a lamp that faces down, and a table that shades the floor.
    let mut mesh = Mesh::default();
    let room = mesh.add(Shape::Room { cells: 8 }, WALL, |v| v);
    // The shape faces up: exchanging x and z turns it over.
    mesh.add(Shape::Quad { cells: 2 }, LAMP, |v| DVec3::new(0.3 + 0.4 * v.z, 0.95, 0.3 + 0.4 * v.x));
    mesh.add(Shape::Box { cells: 3 }, WALL, |v| DVec3::new(0.3, 0.4, 0.3) + v * DVec3::new(0.4, 0.05, 0.4));

    let scene = Scene::new("room", mesh.vertices, mesh.triangles, materials)?;
    for warning in &scene.warnings {
        eprintln!("{warning}");
    }

    let device = Device::new(&DeviceOptions::default())?;
    let plan = Plan::new(&scene, &Limits::of(&device), &scene.accuracy)?;
    println!("{}: {} triangles, {} bytes", device.info().name, plan.triangles(), plan.memory().total());
    let mut engine = Engine::new(&device, &scene, plan)?;
    let solution = engine.solve(&SolveParams::from(&scene.accuracy))?;
    println!(
        "{} passes to a residual of {:.1e}",
        solution.info.passes,
        solution.info.residuals.last().unwrap_or(&0.0)
    );
    println!("emitted  {:.3?} W", solution.energy.emitted);
    println!("absorbed {:.3?} W", solution.energy.absorbed);

    // One row per triangle, in the order in which they were given to the scene.
    let floor = |near: &dyn Fn(DVec3) -> bool| {
        let centroid = |i: usize| scene.corners(i).iter().sum::<DVec3>() / 3.0;
        let picked = room.clone().filter(|&i| centroid(i).y == 0.0 && near(centroid(i)));
        let red: Vec<f64> = picked.map(|i| solution.irradiance[i][0]).collect();
        red.iter().sum::<f64>() / red.len() as f64
    };
    let under = |x: DVec3| (x.x - 0.5).abs().max((x.z - 0.5).abs()) < 0.2;
    println!("red irradiance of the floor under the table: {:.3} W/m²", floor(&under));
    println!("                           beside the table: {:.3} W/m²", floor(&|x| !under(x)));
    Ok(())
}
