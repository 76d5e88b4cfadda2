//! What several tests need: backends, devices with validation, reference data, errors.
#![allow(dead_code, reason = "every test crate uses a part")]

pub use antirad_kit as kit;
pub mod random;
pub mod slots;

use antirad::backend::{Backend, BackendChoice};
use antirad::gpu::{Device, DeviceKind, DeviceOptions};
use antirad::plan::{Plan, PlanOptions};
use antirad::scene::{LoadOptions, Scene, SolveSettings, VisibilityChoice};
use antirad::{Engine, Solution, SolveParams};
use antirad_core::transport::{self, Operators};
use glam::{DAffine3, DQuat};
use std::path::{Path, PathBuf};

/// The Vulkan device under test, for what is Vulkan's alone. Every message of the validation layers fails the test that calls [`finish`].
pub fn device() -> Device {
    Device::new(&DeviceOptions::default().validation(true)).expect("a Vulkan device")
}

/// The backend under test: the CPU, or where the environment variable ANTIRAD_BACKEND is `vulkan` that [`device`].
pub fn backend() -> Backend {
    match BackendChoice::of_environment() {
        Some(BackendChoice::Vulkan) => device().into(),
        _ => Backend::cpu(),
    }
}

/// All implementations of the operators, with their names: the CPU, kernels for drivers of CPUs, and those for GPUs.
pub fn implementations() -> [(&'static str, Backend); 3] {
    [
        ("CPU", Backend::cpu()),
        ("kernels for CPUs", device().into()),
        ("kernels for GPUs", device().with_kernels_for(DeviceKind::Discrete).into()),
    ]
}

/// Ends a test: a Vulkan device has said nothing against its use.
pub fn finish(backend: impl Into<Backend>) {
    if let Some(device) = backend.into().vulkan() {
        assert_eq!(device.validation_messages(), Vec::<String>::new());
    }
}

/// Whether numbers are the same: to the bit, or to rounding on a GPU, whose compiler contracts products and sums in one kernel and not in
/// another.
pub fn same(backend: impl Into<Backend>, found: &[f64], expected: &[f64]) -> bool {
    let gpu = backend.into().vulkan().is_some_and(|device| device.info().kind != DeviceKind::Cpu);
    if gpu { same_to_rounding(found, expected) } else { found == expected }
}

/// Whether numbers are the same but for rounding of single precision.
pub fn same_to_rounding(found: &[f64], expected: &[f64]) -> bool {
    slots::relative(found, expected) <= 1e-6
}

/// The operators of a backend for a planned scene, whose triangles emit what their materials do.
pub fn operators(backend: &Backend, scene: &Scene, plan: &Plan) -> Box<dyn Operators> {
    let emission: Vec<[f64; 3]> = (0..scene.triangles.len()).map(|i| scene.material(i).emission).collect();
    transport::operators(backend, scene, plan.clone(), &emission, 1.0).expect("operators")
}

pub fn path(relative: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(relative)
}

/// A scene of the project with implicit visibility, which most tests are of.
pub fn load(relative: &str) -> Scene {
    implicit(as_given(relative))
}

/// A scene of the project.
pub fn as_given(relative: &str) -> Scene {
    Scene::load(&path(relative), &LoadOptions::default()).expect("a scene of the project")
}

/// Settings of implicit visibility.
pub fn implicit_settings() -> SolveSettings {
    SolveSettings::default().visibility(VisibilityChoice::Implicit)
}

/// A scene with implicit visibility.
pub fn implicit(scene: Scene) -> Scene {
    Scene { settings: scene.settings.visibility(VisibilityChoice::Implicit), ..scene }
}

pub fn placed(scale: [f64; 3], to: [f64; 3]) -> DAffine3 {
    DAffine3::from_scale_rotation_translation(scale.into(), DQuat::IDENTITY, to.into())
}

/// Solves with the options of a backend.
pub fn solve(backend: impl Into<Backend>, scene: &Scene, settings: &SolveSettings) -> (Engine, Solution) {
    let backend = backend.into();
    solve_within(&backend, scene, settings, &PlanOptions::of(&backend))
}

pub fn solve_within(
    backend: impl Into<Backend>,
    scene: &Scene,
    settings: &SolveSettings,
    options: &PlanOptions,
) -> (Engine, Solution) {
    let plan = Plan::new(scene, options, settings).expect("a plan");
    let mut engine = Engine::new(backend, scene, plan).expect("an engine");
    let solution = engine.solve(&SolveParams::from(settings)).expect("a solution");
    (engine, solution)
}

/// Rows of a float32 array [n, 3].
pub fn read_npy(relative: &str) -> Vec<[f64; 3]> {
    let bytes = std::fs::read(path(relative)).expect("reference data");
    let flat: Vec<f32> = npyz::NpyFile::new(&bytes[..]).expect("npy").into_vec().expect("f32");
    flat.chunks_exact(3).map(|c| [c[0], c[1], c[2]].map(f64::from)).collect()
}

/// Triangle areas, m².
pub fn areas(scene: &Scene) -> Vec<f64> {
    let area = |i| {
        let [a, b, c] = scene.corners(i);
        0.5 * (b - a).cross(c - a).length()
    };
    (0..scene.triangles.len()).map(area).collect()
}

/// Root of the area-weighted sum of squared differences over that of `truth`.
pub fn relative_l2(values: &[[f64; 3]], truth: &[[f64; 3]], areas: &[f64]) -> f64 {
    assert_eq!(values.len(), truth.len());
    let square = |f: &dyn Fn(usize, usize) -> f64| -> f64 {
        (0..truth.len()).map(|i| areas[i] * (0..3).map(|c| f(i, c).powi(2)).sum::<f64>()).sum()
    };
    let difference = square(&|i, c| values[i][c] - truth[i][c]);
    (difference / square(&|i, c| truth[i][c])).sqrt()
}

/// Area-weighted mean of one channel over the triangles that `of` picks.
pub fn mean(values: &[[f64; 3]], areas: &[f64], of: impl Fn(usize) -> bool) -> f64 {
    let picked = || (0..values.len()).filter(|&i| of(i));
    picked().map(|i| areas[i] * values[i][0]).sum::<f64>() / picked().map(|i| areas[i]).sum::<f64>()
}

/// Every triangle for itself, and smaller: where corners touch the plane of a neighbour, rounding decides what is in its horizon.
pub fn apart(scene: &Scene) -> Scene {
    let mut apart = scene.clone();
    apart.vertices.clear();
    for i in 0..scene.triangles.len() {
        let corners = scene.corners(i);
        let centre = corners.iter().sum::<glam::DVec3>() / 3.0;
        let first = apart.vertices.len() as u32;
        apart.vertices.extend(corners.map(|corner| centre.lerp(corner, 0.9)));
        apart.triangles[i].vertices = [first, first + 1, first + 2];
    }
    apart
}
