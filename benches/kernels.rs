//! Rates of the transport operators in pairs per second, forward, transposed and with derivatives, minima of time over many
//! repeats, with nothing culled within the measured shape: those of the backend that ANTIRAD_BACKEND names, by default kernels on a Vulkan
//! device. `LP_NUM_THREADS=1 cargo bench --bench kernels` gives rates per core of lavapipe, with `ANTIRAD_BACKEND=cpu` and
//! `RAYON_NUM_THREADS=1` those of the CPU; `-- adjoint` and `-- derivative` those of gradients alone.
//!
//! The harness is its own, since it measures the time of one shape of one kernel within a pass, by the fastest
//! repeat. `divan` reports fastest times, but only of whole calls; `criterion` accepts given times (`iter_custom`), but
//! reports means, which on a busy machine stay far below the rate: 11 to 15 million pairs/s for diffuse fronts to bins
//! in three runs that alternated with this harness, which found 15, 46 and 29; a quiet machine gives 44.

use antirad::backend::{Backend, BackendChoice};
use antirad::gpu::DeviceOptions;
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::scene::{Material, Movable, Scene, SceneBuilder, Shape, SolveSettings, VisibilityChoice};
use antirad_core::transport::{self, Operators, State};
use glam::{DAffine3, DQuat, DVec3};
use std::time::{Duration, Instant};

/// Repeats; the fastest counts, since other programs may use the machine.
const REPEATS: usize = 40;
/// Of one row of the table. Slow kernels have fewer repeats, at least three.
const PATIENCE: Duration = Duration::from_secs(20);

struct Case {
    name: &'static str,
    shape: &'static str,
    scene: Scene,
    /// Material of the sources and of the receivers of the shape.
    pairs: (u32, u32),
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

/// What runs the kernels, and which of them.
#[derive(Clone, Copy)]
enum Run {
    Forward,
    Adjoint,
    /// With respect to the geometry of the sources, or of the receivers; the CPU counts both together.
    Derivative(&'static str),
}

impl Run {
    fn all(backend: &Backend) -> Vec<Self> {
        let ends: &[_] = if backend.vulkan().is_some() { &["source", "receiver"] } else { &["both"] };
        let derivatives = ends.iter().copied().map(Self::Derivative);
        [Self::Forward, Self::Adjoint].into_iter().chain(derivatives).collect()
    }

    fn name(self, case: &Case) -> String {
        match self {
            Self::Forward => case.name.to_owned(),
            Self::Adjoint => format!("{}, adjoint", case.name),
            Self::Derivative(by) => format!("{}, derivative by {by}", case.name),
        }
    }

    /// Whether a row of the profile is about it.
    fn measures(self, case: &Case, kernel: &str, shape: &str) -> bool {
        let of_shape = match self {
            Self::Derivative(by) if by != "both" => shape == format!("{}, by {by}", case.shape),
            _ => shape == case.shape,
        };
        of_shape && (kernel.starts_with("transport") || kernel.starts_with("far"))
    }
}

/// A case on a backend.
struct Bench {
    backend: Backend,
    operators: Box<dyn Operators>,
    /// Light in every bin, and where a pass puts its result.
    x: State,
    y: State,
}

impl Bench {
    fn new(backend: &Backend, case: &Case) -> Self {
        // The near field is a kernel of its own.
        let settings = SolveSettings::default().near_field(0.0).visibility(VisibilityChoice::Implicit);
        let options = PlanOptions::of(backend).gradients(GradientRequest::EVERYTHING);
        let plan = Plan::new(&case.scene, &options, &settings).expect("a plan");
        let emission = |i: usize| case.scene.material(i).emission;
        let emitted: Vec<[f64; 3]> = (0..case.scene.triangles.len()).map(emission).collect();
        let mut operators =
            transport::operators(backend, &case.scene, plan, &emitted, 1.0).expect("operators");
        let mut x = operators.vector().expect("a vector");
        let y = operators.vector().expect("a vector");
        operators.pass(None, true, &mut x).expect("a pass");
        Self { backend: backend.clone(), operators, x, y }
    }

    fn pass(&mut self, run: Run) {
        let Self { operators, x, y, .. } = self;
        match run {
            Run::Forward => operators.pass(Some(x), true, y).expect("a pass"),
            Run::Adjoint => {
                operators.adjoint().expect("gradients").pass(Some(x), false, y).expect("a pass");
            }
            Run::Derivative(_) => {
                let mut adjoint = operators.adjoint().expect("gradients");
                adjoint.geometry(x, x, &[], Some(&Movable::All)).expect("gradients");
            }
        }
        // Times are known once the work is done, and reading results waits for that.
        operators.irradiance(y).expect("a result");
    }

    /// Seconds of the kernels of one run, at best.
    fn fastest(&mut self, case: &Case, run: Run) -> f64 {
        let start = Instant::now();
        let mut fastest = f64::INFINITY;
        for repeat in 0..REPEATS {
            if repeat >= 3 && start.elapsed() > PATIENCE {
                break;
            }
            self.backend.reset_profile();
            self.pass(run);
            let rows = self.backend.profile().into_iter();
            let seconds: f64 =
                rows.filter(|row| run.measures(case, &row.kernel, &row.shape)).map(|row| row.seconds).sum();
            assert!(seconds > 0.0, "no kernel of {} has run", run.name(case));
            fastest = fastest.min(seconds);
        }
        fastest
    }
}

fn main() {
    let choice = BackendChoice::of_environment().unwrap_or(BackendChoice::Vulkan);
    let backend = Backend::open(Some(choice), &DeviceOptions::default()).expect("a backend");
    println!("{backend:?}, {} threads", backend.threads());
    let cases = [
        Case {
            name: "irradiance alone",
            shape: "fronts to irradiance",
            scene: sheets(64, &[2.0, 0.0]),
            pairs: (0, 1),
        },
        Case {
            name: "diffuse fronts to bins",
            shape: "fronts to bins",
            scene: sheets(32, &[2.0, 1.0, 0.0]),
            pairs: (0, 1),
        },
        Case {
            name: "bins to irradiance",
            shape: "fronts and backs to irradiance",
            scene: sheets(32, &[2.0, 1.0, 0.0]),
            pairs: (1, 2),
        },
        Case {
            name: "bins at both ends",
            shape: "fronts and backs to bins",
            scene: sheets(32, &[3.0, 2.0, 1.0, 0.0]),
            pairs: (1, 2),
        },
    ];
    // An argument filters by name, as in cargo's own harness.
    let wanted: Vec<String> = std::env::args().skip(1).filter(|arg| !arg.starts_with('-')).collect();
    let matches = |name: &str| wanted.is_empty() || wanted.iter().any(|part| name.contains(part));
    for case in cases {
        let runs: Vec<Run> = Run::all(&backend).into_iter().filter(|run| matches(&run.name(&case))).collect();
        if runs.is_empty() {
            continue;
        }
        let of =
            |material: u32| case.scene.triangles.iter().filter(|t| t.material == material).count() as f64;
        let pairs = of(case.pairs.0) * of(case.pairs.1);
        let mut bench = Bench::new(&backend, &case);
        for run in runs {
            let rate = pairs / bench.fastest(&case, run);
            println!("{:48} {:8.1} million pairs/s", run.name(&case), 1e-6 * rate);
        }
    }
}
