//! The plan in words and numbers.

use super::{LampsReport, MemoryItem, PADDING, PairLists, Plan, PlannedSolver, Reflectance, Residency};
use antirad_scene::BackendKind;
use std::fmt;

/// What a device does per second, for estimates of time.
struct Rates {
    /// Pairs of triangles.
    irradiance: f64,
    bins: f64,
    near: f64,
    /// Weights of a kept near field.
    weights: f64,
    /// Pairs of bins, by matrix and one by one.
    lobes: f64,
    direct_lobes: f64,
    /// Bytes between host and device.
    moved: f64,
}

/// The CPU backend on two idle cores.
const CPU: Rates = Rates {
    irradiance: 1e9,
    bins: 150e6,
    near: 2.5e6,
    weights: 2e8,
    lobes: 3e9,
    direct_lobes: 3e8,
    moved: f64::INFINITY,
};

/// Vulkan kernels on lavapipe, on two idle cores.
const LAVAPIPE: Rates = Rates {
    irradiance: 1.5e8,
    bins: 1.5e7,
    near: 2e5,
    weights: 1.5e7,
    lobes: 3e8,
    direct_lobes: 3e7,
    moved: 2e9,
};

/// Vulkan kernels on an H100, lobes apart, which were not measured. Smaller GPUs take longer, and small scenes what a submission takes.
const GPU: Rates = Rates {
    irradiance: 2e10,
    bins: 5e9,
    near: 2e7,
    weights: 5e9,
    lobes: 3e10,
    direct_lobes: 3e9,
    moved: 1e10,
};

/// Passes in addition to those due to the albedo: direct light, and the verification of the result.
const FIRST_AND_LAST: f64 = 2.0;
/// Factor on the passes where light is blocked: J is not normal, and triangles inside or close behind others slow a
/// restarted solver.
const BLOCKED: f64 = 3.0;

/// What is modelled of a class of triangles, and why.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct ClassReport {
    /// Number of triangles.
    pub triangles: usize,
    /// What the kernels compute for them, in words.
    pub modelled: String,
    /// Why that is necessary.
    pub why: String,
}

/// Pairs (receiver, source) of triangles.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PairReport {
    /// All pairs.
    pub total: u64,
    /// Culled with their tiles, exactly.
    pub culled: u64,
    /// Irradiance alone, point to point.
    pub irradiance: u64,
    /// Pairs with bins at one end or both, point to point.
    pub bins: u64,
    /// Close pairs, integrated piecewise.
    pub sub_sampled: u64,
}

/// How the lobes of glossy triangles are computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct LobeReport {
    /// Number of matrices, one for each power that enough triangles share.
    pub matrices: u32,
    /// Triangles whose lobes come from a matrix.
    pub shared: u32,
    /// Triangles whose lobes are evaluated bin by bin.
    pub direct: u32,
}

/// The memory in which states live, and what it costs to move them.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct StatesReport {
    /// "device" or "host".
    pub residency: &'static str,
    /// Largest host memory of the solver's vectors, bytes.
    pub host_bytes: u64,
    /// How often a pass streams all sources past the receivers.
    pub sweeps: usize,
    /// Tiles of receivers whose bins the device holds at a time.
    pub receiver_tiles: u32,
    /// Tiles of sources whose bins the device holds at a time.
    pub source_tiles: u32,
    /// Bytes moved between host and device per pass.
    pub bytes_moved_per_pass: u64,
}

/// Summary of a plan, as text and JSON; the keys of the JSON are what `antirad plan --json` prints.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct PlanReport {
    /// The backend that executes it.
    #[doc(hidden)]
    pub backend: BackendKind,
    /// Number of triangles with an area.
    #[doc(hidden)]
    pub triangles: usize,
    /// Number of triangles without area, which are omitted.
    #[doc(hidden)]
    pub degenerate: usize,
    /// 3, or 1 for a scene without colour.
    pub(crate) channels: u32,
    /// The layout of directions ("8x16"), or "none" where nothing has bins.
    #[doc(hidden)]
    pub bins: String,
    /// The solver, with the length of its basis.
    #[doc(hidden)]
    pub solver: String,
    /// All pairs, or rays: how many of a triangle, and why.
    #[doc(hidden)]
    pub transport: String,
    /// Whether the near field is kept as a matrix, and why not.
    #[doc(hidden)]
    pub near_field: String,
    /// What is modelled of each class of triangles.
    #[doc(hidden)]
    pub classes: Vec<ClassReport>,
    /// How the light that comes straight from emitters is computed.
    #[doc(hidden)]
    pub lamps: LampsReport,
    /// Triangles per tile.
    #[doc(hidden)]
    pub tile: u32,
    /// Number of tiles.
    #[doc(hidden)]
    pub tiles: u32,
    /// Number of groups with bins, one page each.
    #[doc(hidden)]
    pub pages: usize,
    /// Pairs of triangles per pass.
    #[doc(hidden)]
    pub pairs: PairReport,
    /// How lobes are computed.
    #[doc(hidden)]
    pub lobes: LobeReport,
    /// Residency of the states, and the transfers this causes.
    #[doc(hidden)]
    pub states: StatesReport,
    /// Bytes by label.
    #[doc(hidden)]
    pub memory: Vec<MemoryItem>,
    /// Bytes of all labels.
    #[doc(hidden)]
    pub memory_total: u64,
    /// Memory budget, bytes.
    #[doc(hidden)]
    pub memory_budget: u64,
    /// All memory but staging, per triangle with an area.
    #[doc(hidden)]
    pub bytes_per_triangle: f64,
    /// Least and most passes that similar scenes were seen to take, from albedo, solver and tolerance. Uniformly lit
    /// scenes take fewer; scenes that create light (interpenetrating objects) may take more.
    #[doc(hidden)]
    pub estimated_passes: [f64; 2],
    /// Rough time for the least number of passes, on two idle cores: of the CPU backend, or of lavapipe.
    #[doc(hidden)]
    pub estimated_seconds: f64,
    /// Rough time for the largest number of passes, on two idle cores: of the CPU backend, or of lavapipe.
    #[doc(hidden)]
    pub estimated_seconds_at_most: f64,
}

impl Plan {
    /// Counts pairs.
    #[doc(hidden)]
    pub fn pairs(&self) -> PairReport {
        let real = |slots: &[u32]| slots.iter().filter(|&&i| i != PADDING).count() as u64;
        let of_tile: Vec<u64> = self.layout.order.chunks(self.layout.tile as usize).map(real).collect();
        let mut ends = vec![0];
        ends.extend(of_tile.iter().scan(0, |sum, count| {
            *sum += count;
            Some(*sum)
        }));
        let PairLists { far, near } = &self.interactions.by_receiver;
        let triangles = self.triangles() as u64;
        let mut pairs = PairReport {
            total: triangles * triangles,
            sub_sampled: near.partners.len() as u64,
            ..PairReport::default()
        };
        for to in &self.layout.groups {
            for from in &self.layout.groups {
                for receiver in to.tiles.clone() {
                    for (run, passing) in far.of(receiver, &from.tiles) {
                        let sources = ends[run.end as usize] - ends[run.start as usize];
                        let count = of_tile[receiver as usize] * sources;
                        match passing {
                            0 => pairs.culled += count,
                            _ if to.class.has_bins() || from.class.has_bins() => pairs.bins += count,
                            _ => pairs.irradiance += count,
                        }
                    }
                }
            }
        }
        pairs
    }

    /// The plan in numbers.
    pub fn report(&self) -> PlanReport {
        let pairs = self.pairs();
        let triangles = self.triangles();
        let with_bins = self.classes.iter().any(|class| class.has_bins());
        let rates = match self.options.backend {
            BackendKind::Cpu => CPU,
            BackendKind::Vulkan if self.options.fast_near_field => GPU,
            BackendKind::Vulkan => LAVAPIPE,
        };
        let pass = pairs.irradiance as f64 / rates.irradiance
            + pairs.bins as f64 / rates.bins
            + match self.near_field_matrix() {
                Some(kept) => kept.weights as f64 / rates.weights,
                None => pairs.sub_sampled as f64 / rates.near,
            }
            + self.lobe_seconds(&rates)
            + self.moved_bytes() as f64 / rates.moved;
        let passes = self.estimated_passes();
        PlanReport {
            backend: self.options.backend,
            triangles,
            degenerate: self.facets.len() - triangles,
            channels: self.channels,
            bins: if with_bins { self.settings.bins.to_string() } else { "none".to_owned() },
            solver: match self.solver {
                PlannedSolver::FixedPoint => "fixed point".to_owned(),
                PlannedSolver::Gmres { restart } => format!("GMRES, restart {restart}"),
            },
            transport: self.transport.to_string(),
            near_field: self.near_field.to_string(),
            classes: self.class_reports(),
            lamps: self.lamps_report(),
            tile: self.layout.tile,
            tiles: self.layout.tiles(),
            pages: self.layout.groups.iter().filter(|g| g.class.has_bins()).count(),
            pairs,
            lobes: self.lobe_report(),
            states: self.states_report(),
            memory: self.memory.items.clone(),
            memory_total: self.memory.total(),
            memory_budget: self.options.memory_budget,
            bytes_per_triangle: self.memory.own().map(|item| item.bytes).sum::<u64>() as f64
                / triangles as f64,
            estimated_passes: passes,
            estimated_seconds: pass * passes[0],
            estimated_seconds_at_most: pass * passes[1],
        }
    }

    /// Least and most passes: from Chebyshev's bound of Krylov methods for GMRES, from the decay of bounces
    /// for the fixed point. Least for open scenes with the mean albedo, most for the largest albedo.
    fn estimated_passes(&self) -> [f64; 2] {
        let digits = (2.0 / self.settings.tolerance).ln();
        let passes = |albedo: f64| {
            let bounces = match self.solver {
                PlannedSolver::FixedPoint => digits / (1.0 / albedo.clamp(1e-3, 0.99)).ln(),
                PlannedSolver::Gmres { .. } => 0.5 * digits / (1.0 - albedo).sqrt(),
            };
            FIRST_AND_LAST + bounces
        };
        let blocked = self.classes.iter().any(|class| class.blocker);
        let Reflectance { mean, most } = self.reflectance;
        let factor = if blocked { BLOCKED } else { 1.0 };
        let limit = f64::from(self.settings.max_passes);
        [0.5 * passes(mean), factor * passes(most)].map(|passes| passes.ceil().min(limit))
    }

    /// Estimated time of specular reflection in K, seconds.
    fn lobe_seconds(&self, rates: &Rates) -> f64 {
        let LobeReport { shared, direct, .. } = self.lobe_report();
        let pairs = (self.bins.count() as f64).powi(2);
        pairs * (f64::from(shared) / rates.lobes + f64::from(direct) / rates.direct_lobes)
    }

    fn lobe_report(&self) -> LobeReport {
        let [glossy, shared] = self.lobes.triangles();
        LobeReport { matrices: self.lobes.matrices, shared, direct: glossy - shared }
    }

    fn states_report(&self) -> StatesReport {
        let (residency, receiver_tiles, source_tiles) = match self.residency {
            Residency::Device if self.states_are_whole() => {
                ("device", self.layout.tiles(), self.layout.tiles())
            }
            Residency::Device => {
                let own = |g: usize| self.own(g).tiles.len() as u32;
                let groups = 0..self.layout.groups.len();
                ("device", groups.map(own).sum(), self.largest_group(|group| group.class.has_bins()))
            }
            Residency::Host { receivers, sources } => ("host", receivers, sources),
        };
        StatesReport {
            residency,
            host_bytes: self.host_bytes(),
            sweeps: self.sweeps().len(),
            receiver_tiles,
            source_tiles,
            bytes_moved_per_pass: self.moved_bytes(),
        }
    }

    fn class_reports(&self) -> Vec<ClassReport> {
        let mut present: Vec<_> = self.layout.groups.iter().map(|g| g.class).collect();
        present.dedup();
        present
            .into_iter()
            .map(|class| {
                let real = |&i: &u32| i != PADDING && self.classes[i as usize] == class;
                let explicit = self.transport.is_explicit();
                let (modelled, why) = match (class.blocker, class.glossy) {
                    (_, false) if explicit => {
                        ("irradiance alone, no bins, no J", "diffuse, and rays tell what blocks")
                    }
                    (_, true) if explicit => ("bins, specular K", "glossy, and rays tell what blocks"),
                    (false, false) => ("irradiance alone, no bins, no J", "diffuse, and no receiver behind"),
                    (true, false) => ("bins, J", "diffuse, and a receiver behind"),
                    (false, true) => ("bins, specular K", "glossy, and no receiver behind"),
                    (true, true) => ("bins, J, specular K", "glossy, and a receiver behind"),
                };
                ClassReport {
                    triangles: self.layout.order.iter().filter(|i| real(i)).count(),
                    modelled: modelled.to_owned(),
                    why: why.to_owned(),
                }
            })
            .collect()
    }
}

impl fmt::Display for PlanReport {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let percent = |part: u64| 100.0 * part as f64 / self.pairs.total.max(1) as f64;
        writeln!(f, "backend          {}", self.backend)?;
        write!(f, "triangles        {}", self.triangles)?;
        if self.degenerate > 0 {
            write!(f, " ({} without area left out)", self.degenerate)?;
        }
        writeln!(f)?;
        for class in &self.classes {
            writeln!(f, "  {:>9}      {}: {}", class.triangles, class.modelled, class.why)?;
        }
        writeln!(f, "lamps            {}", self.lamps.why)?;
        writeln!(f, "bins             {}", self.bins)?;
        writeln!(f, "channels         {}", self.channels)?;
        writeln!(f, "solver           {}", self.solver)?;
        writeln!(f, "transport        {}", self.transport)?;
        writeln!(f, "near field       {}", self.near_field)?;
        writeln!(
            f,
            "tiles            {} of {} triangles, {} pages of bins",
            self.tiles, self.tile, self.pages
        )?;
        let states = &self.states;
        if states.host_bytes == 0 {
            writeln!(f, "states           in the memory of the backend")?;
        } else {
            writeln!(f, "states           on the host, {} bytes at most", states.host_bytes)?;
            writeln!(
                f,
                "  {:>13}  bytes moved per pass: all sources, {} tiles at a time, go by {} tiles of receivers, {} \
                 times",
                states.bytes_moved_per_pass, states.source_tiles, states.receiver_tiles, states.sweeps
            )?;
        }
        let pairs = &self.pairs;
        writeln!(f, "pairs per pass   {}", pairs.total)?;
        writeln!(f, "  {:>13}  culled ({:.1} %)", pairs.culled, percent(pairs.culled))?;
        writeln!(f, "  {:>13}  irradiance alone ({:.1} %)", pairs.irradiance, percent(pairs.irradiance))?;
        writeln!(f, "  {:>13}  with bins ({:.1} %)", pairs.bins, percent(pairs.bins))?;
        writeln!(f, "  {:>13}  near field ({:.2} %)", pairs.sub_sampled, percent(pairs.sub_sampled))?;
        let LobeReport { matrices, shared, direct } = self.lobes;
        if shared + direct > 0 {
            writeln!(
                f,
                "lobes            by matrix for {shared} triangles ({matrices}), bin by bin for {direct}"
            )?;
        }
        writeln!(f, "memory           {} bytes of {}", self.memory_total, self.memory_budget)?;
        for item in &self.memory {
            writeln!(f, "  {:>13}  {} ({})", item.bytes, item.label, item.count)?;
        }
        writeln!(f, "per triangle     {:.0} bytes of the engine's own", self.bytes_per_triangle)?;
        let [least, most] = self.estimated_passes;
        write!(
            f,
            "estimated time   {:.1} to {:.1} s on two idle cores{}, {least} to {most} passes",
            self.estimated_seconds,
            self.estimated_seconds_at_most,
            if self.backend == BackendKind::Vulkan { " with lavapipe" } else { "" },
        )
    }
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        self.report().fmt(f)
    }
}
