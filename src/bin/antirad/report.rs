//! `report.json`: everything about a run that a script or a person may need later.

use antirad::backend::{Backend, BackendKind};
use antirad::gpu::{Bytes, MemoryReport, ProfileRow};
use antirad::plan::PlanReport;
use antirad::ranks::RankError;
use antirad::resolve::Decision;
use antirad::scene::LampFactor;
use antirad::solve::SolveInfo;
use antirad::target_error::Refinement;
use antirad::warnings::Warning;
use antirad::{Energy, Negative, RayError};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;

#[derive(Serialize)]
pub struct Report {
    pub scene: String,
    pub version: &'static str,
    /// Which implementation computed: `vulkan` or `cpu`.
    pub backend: BackendKind,
    /// What it ran on.
    pub device: DeviceReport,
    /// Threads of this process.
    pub threads: usize,
    pub warnings: Vec<String>,
    /// Triangles of this scene for which the method is inaccurate.
    pub accuracy_warnings: Vec<Warning>,
    /// Units: bytes, pairs of triangles, seconds.
    pub plan: PlanReport,
    /// Standard error of the irradiance that comes straight from lamps, relative; 0 where their visibility is exact.
    pub sampling_error: f64,
    /// Standard error of irradiance by the rays that light goes by; `None` where visibility is implicit.
    pub ray_error: Option<RayError>,
    /// How the settings were found, for a target error.
    pub refinement: Option<Refinement>,
    /// What the scene left open and was decided for it, with the reason of each; empty with a target error.
    pub resolved: Vec<Decision>,
    /// Number of triangles of the given mesh, if it was cut.
    pub given_triangles: Option<usize>,
    /// Factors by which lamps were changed.
    pub lamps: Vec<LampReport>,
    pub memory: MemoryUse,
    /// Report of each process that worked on the scene.
    pub ranks: Vec<RankReport>,
    pub solve: SolveReport,
    /// RGB, W.
    pub energy: Energy,
    /// W/m².
    pub negative_irradiance: Negative,
    pub pictures: Vec<String>,
    /// Per camera, the standard error of what rays find that glossy faces mirror, relative to all that visible faces reflect; 0 without rays.
    pub reflections_error: BTreeMap<String, f64>,
    pub seconds: BTreeMap<&'static str, f64>,
    pub kernels: Vec<ProfileRow>,
}

/// A lamp whose light was changed.
#[derive(Serialize)]
pub struct LampReport {
    pub name: String,
    /// RGB.
    pub factor: [f64; 3],
}

impl From<LampFactor> for LampReport {
    fn from(LampFactor { name, factor, .. }: LampFactor) -> Self {
        Self { name, factor }
    }
}

impl fmt::Display for LampReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { name, factor: [r, g, b] } = self;
        match r == g && g == b {
            true => write!(f, "{name} x {r}"),
            false => write!(f, "{name} x {r},{g},{b}"),
        }
    }
}

#[derive(Serialize)]
pub struct DeviceReport {
    pub name: String,
    pub kind: String,
    pub driver: String,
    /// Newest version of Vulkan that the device supports; `None` on the CPU.
    pub vulkan: Option<String>,
}

#[derive(Serialize)]
pub struct MemoryUse {
    pub budget: u64,
    pub peak: u64,
    pub allocated: BTreeMap<String, u64>,
    pub peak_by_label: BTreeMap<String, u64>,
}

/// What a process did of the common work.
#[derive(Serialize)]
pub struct RankReport {
    /// Bytes of the backend's memory at the peak.
    pub peak: u64,
    /// Pairs of triangles that it evaluated.
    pub pairs: u64,
    /// Bytes that it sent, however many received them, and received.
    pub sent: u64,
    pub received: u64,
    /// Seconds of the solve, and of them those in which its operators worked.
    pub solve: f64,
    pub busy: f64,
}

impl RankReport {
    /// Reports of all processes, which must ask at once.
    pub fn of_all(backend: &Backend, solve: f64) -> Result<Vec<Self>, RankError> {
        let [sent, received] = backend.ranks().moved();
        let profile = backend.profile();
        let pairs = profile.iter().map(|row| row.items).sum();
        let busy: f64 = profile.iter().map(|row| row.seconds).sum();
        let own = [backend.memory().peak, pairs, sent, received, solve.to_bits(), busy.to_bits()];
        let of_all = backend.ranks().each(own)?.into_iter();
        Ok(of_all
            .map(|[peak, pairs, sent, received, solve, busy]| {
                let (solve, busy) = (f64::from_bits(solve), f64::from_bits(busy));
                Self { peak, pairs, sent, received, solve, busy }
            })
            .collect())
    }
}

impl fmt::Display for RankReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { peak, pairs, sent, received, solve, busy } = self;
        let (peak, sent, received) = (Bytes(*peak), Bytes(*sent), Bytes(*received));
        write!(
            f,
            "{pairs} pairs, {busy:.2} s of {solve:.2} s in operators, {peak}, {sent} sent, {received} received"
        )
    }
}

#[derive(Serialize)]
pub struct SolveReport {
    pub passes: u32,
    pub tolerance: f64,
    /// Whether the tolerance was reached.
    pub converged: bool,
    pub residuals: Vec<f64>,
    pub spectral_radius: Option<f64>,
}

impl From<&Backend> for DeviceReport {
    fn from(backend: &Backend) -> Self {
        let info = backend.vulkan().map(|device| device.info());
        Self {
            name: backend.device_name().to_owned(),
            kind: info.map_or_else(|| String::from("CPU"), |info| info.kind.to_string()),
            driver: backend.driver().to_owned(),
            vulkan: info.map(|info| info.api_version.clone()),
        }
    }
}

impl From<MemoryReport> for MemoryUse {
    fn from(report: MemoryReport) -> Self {
        let allocated = report.by_label.into_iter().map(|l| (l.label, l.bytes)).collect();
        let peak_by_label = report.peak_by_label.into_iter().collect();
        Self { budget: report.budget, peak: report.peak, allocated, peak_by_label }
    }
}

impl SolveReport {
    pub fn new(info: SolveInfo, tolerance: f64) -> Self {
        Self {
            passes: info.passes,
            tolerance,
            converged: info.converged,
            residuals: info.residuals,
            spectral_radius: info.spectral_radius,
        }
    }
}
