//! Rates of the transport kernels in pairs per second, minima of time over many repeats, with nothing culled within the
//! measured shape. `LP_NUM_THREADS=1 cargo bench --bench kernels` gives rates per core of lavapipe.
//!
//! The harness is its own, since it measures the device time of one shape of one kernel within a pass, by the fastest
//! repeat. `divan` reports fastest times, but only of whole calls; `criterion` accepts given times (`iter_custom`), but
//! reports means, which on a busy machine stay far below the rate: 11 to 15 million pairs/s for diffuse fronts to bins
//! in three runs that alternated with this harness, which found 15, 46 and 29; a quiet machine gives 44.

use antirad::gpu::{Device, DeviceOptions};
use antirad::plan::{Plan, PlanOptions};
use antirad::scene::{Material, Precision, Scene, SceneBuilder, Shape, SolveSettings};
use antirad::solve::LightOperator;
use antirad::transport::{Operators, SceneBuffers};
use glam::{DAffine3, DQuat, DVec3};

/// Repeats; the fastest counts, since other programs may use the machine.
const REPEATS: usize = 40;

struct Case {
    name: &'static str,
    shape: &'static str,
    scene: Scene,
    /// Material of the sources and of the receivers of the shape.
    pairs: (u32, u32),
    precision: Precision,
}

/// Horizontal squares, each of 2 · cells² triangles of a material of its own, the first a lamp that faces down over
/// others that face up.
fn sheets(cells: u32, heights: &[f64]) -> Scene {
    let mut builder = SceneBuilder::new();
    for (k, &height) in heights.iter().enumerate() {
        let (emission, up) = if k == 0 { ([1.0, 0.8, 0.6], -1.0) } else { ([0.0; 3], 1.0) };
        let material =
            Material { albedo: [0.5, 0.4, 0.3], emission, ..Material::named(format!("sheet {k}")) };
        let place = DAffine3::from_scale_rotation_translation(
            DVec3::new(1.0, up, 1.0),
            DQuat::IDENTITY,
            DVec3::new(0.01 * k as f64, height, 0.0),
        );
        builder.shape(&material.name, Shape::Quad { cells }, &material, place);
    }
    builder.finish("sheets").expect("a scene")
}

fn main() {
    let device = Device::new(&DeviceOptions::default()).expect("a Vulkan device");
    println!("{}", device.info().name);
    let cases = [
        Case {
            name: "irradiance alone",
            shape: "fronts to irradiance",
            scene: sheets(64, &[2.0, 0.0]),
            pairs: (0, 1),
            precision: Precision::F32,
        },
        Case {
            name: "diffuse fronts to bins",
            shape: "fronts to bins",
            scene: sheets(32, &[2.0, 1.0, 0.0]),
            pairs: (0, 1),
            precision: Precision::F32,
        },
        Case {
            name: "bins to irradiance",
            shape: "fronts and backs to irradiance",
            scene: sheets(32, &[2.0, 1.0, 0.0]),
            pairs: (1, 2),
            precision: Precision::F32,
        },
        Case {
            name: "bins to irradiance, half bins",
            shape: "fronts and backs to irradiance",
            scene: sheets(32, &[2.0, 1.0, 0.0]),
            pairs: (1, 2),
            precision: Precision::HalfBins,
        },
        Case {
            name: "bins at both ends",
            shape: "fronts and backs to bins",
            scene: sheets(32, &[3.0, 2.0, 1.0, 0.0]),
            pairs: (1, 2),
            precision: Precision::F32,
        },
        Case {
            name: "bins at both ends, half bins",
            shape: "fronts and backs to bins",
            scene: sheets(32, &[3.0, 2.0, 1.0, 0.0]),
            pairs: (1, 2),
            precision: Precision::HalfBins,
        },
    ];
    // An argument filters by name, as in cargo's own harness.
    let wanted: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let matches = |case: &Case| wanted.is_empty() || wanted.iter().any(|name| case.name.contains(name));
    for case in cases.into_iter().filter(matches) {
        // The near field is a kernel of its own.
        let settings = SolveSettings::default().near_field(0.0).precision(case.precision);
        let plan = Plan::new(&case.scene, &PlanOptions::of(&device), &settings).expect("a plan");
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
