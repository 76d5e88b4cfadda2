//! Rates of the transport kernels in pairs per second, minima of time over many repeats, with nothing culled within the
//! measured shape. `LP_NUM_THREADS=1 cargo bench --bench kernels` gives rates per core of lavapipe.

use antirad::gpu::{Device, DeviceOptions};
use antirad::plan::{Limits, Plan};
use antirad::scene::{Accuracy, Material, Scene, Shape, Triangle};
use antirad::solve::LightOperator;
use antirad::transport::{Operators, SceneBuffers};
use glam::DVec3;

/// Repeats; the fastest counts, the machine being shared with others.
const REPEATS: usize = 12;

struct Case {
    name: &'static str,
    shape: &'static str,
    scene: Scene,
    /// Material of the sources and of the receivers that the shape stands for.
    pairs: (u32, u32),
}

/// Horizontal sheets of 2 · cells² triangles each, facing up (or down), one material each.
fn sheets(name: &str, cells: u32, sheets: &[(f64, bool)]) -> Scene {
    let (mut vertices, mut triangles, mut materials) = (Vec::new(), Vec::new(), Vec::new());
    for (k, &(height, up)) in sheets.iter().enumerate() {
        let (points, faces) = Shape::Quad { cells }.mesh();
        let first = vertices.len() as u32;
        vertices.extend(points.iter().map(|x| DVec3::new(x.x + 0.01 * k as f64, height, x.z)));
        for [a, b, c] in faces {
            let corners = if up { [a, b, c] } else { [a, c, b] };
            triangles.push(Triangle { vertices: corners.map(|v| v + first), material: k as u32 });
        }
        let emission = if k == 0 { [1.0, 0.8, 0.6] } else { [0.0; 3] };
        materials.push(Material {
            albedo: [0.5, 0.4, 0.3],
            emission,
            ..Material::named(format!("sheet {k}"))
        });
    }
    Scene::new(name, vertices, triangles, materials).expect("a scene")
}

fn main() {
    let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
    println!("{}", device.info().name);
    let cases = [
        Case {
            name: "irradiance alone",
            shape: "fronts to irradiance",
            scene: sheets("two sheets", 64, &[(2.0, false), (0.0, true)]),
            pairs: (0, 1),
        },
        Case {
            name: "diffuse fronts to bins",
            shape: "fronts to bins",
            scene: sheets("lamp over a sheet over a floor", 40, &[(2.0, false), (1.0, true), (0.0, true)]),
            pairs: (0, 1),
        },
        Case {
            name: "bins to irradiance",
            shape: "fronts and backs to irradiance",
            scene: sheets("lamp over a sheet over a floor", 40, &[(2.0, false), (1.0, true), (0.0, true)]),
            pairs: (1, 2),
        },
        Case {
            name: "bins at both ends",
            shape: "fronts and backs to bins",
            scene: sheets(
                "lamp over two sheets over a floor",
                40,
                &[(3.0, false), (2.0, true), (1.0, true), (0.0, true)],
            ),
            pairs: (1, 2),
        },
    ];
    for case in cases {
        // The near field is a kernel of its own.
        let accuracy = Accuracy { subsample: 0.0, ..Accuracy::default() };
        let plan = Plan::new(&case.scene, &Limits::of(&device), &accuracy).expect("a plan");
        let of =
            |material: u32| case.scene.triangles.iter().filter(|t| t.material == material).count() as f64;
        let pairs = of(case.pairs.0) * of(case.pairs.1);
        let buffers = SceneBuffers::new(&device, &case.scene, &plan).expect("buffers");
        let mut operators = Operators::new(&device, plan, buffers).expect("operators");
        let mut x = operators.vector().expect("a vector");
        let mut y = operators.vector().expect("a vector");
        operators.pass(None, true, &mut x).expect("a pass");
        let mut fastest = f64::INFINITY;
        for _ in 0..REPEATS {
            device.reset_profile();
            operators.pass(Some(&x), true, &mut y).expect("a pass");
            let rows = device.profile().into_iter();
            let rows = rows.filter(|row| row.shape == case.shape && row.kernel.starts_with("transport"));
            fastest = fastest.min(rows.map(|row| row.seconds).sum());
        }
        println!("{:24} {:8.1} million pairs/s", case.name, 1e-6 * pairs / fastest);
    }
}
