//! One size: a scene, a plan, one bounce.

use crate::Arguments;
use crate::table::Row;
use antirad::backend::Backend;
use antirad::backend::BackendKind;
use antirad::cli::Interrupt;
use antirad::gpu::DeviceOptions;
use antirad::plan::{Occlusion, Plan, PlanOptions};
use antirad::ranks::Ranks;
use antirad::scene::{
    Lamps, LoadOptions, Material, Scene, SceneError, Shape, SolveSettings, SolverChoice, Triangle,
    VisibilityChoice,
};
use antirad_core::transport::{self, TransportError};
use glam::DVec3;
use std::error::Error;
use std::io::{BufRead, BufReader, Read};
use std::ops::ControlFlow;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::{Duration, Instant};

/// How often interrupts are checked.
const POLL: Duration = Duration::from_millis(100);

/// Triangles of the smallest statue.
pub const SMALLEST: u32 = 1000;

pub enum Outcome {
    Done,
    Interrupted,
}

pub enum Size {
    Measured(Box<Row>),
    Failed(String),
    Interrupted,
}

/// What the measuring process prints, one line each.
#[derive(serde::Serialize, serde::Deserialize)]
enum Message {
    Progress(f64),
    Row(Box<Row>),
}

/// A statue on a floor under a lamp; the statue gets all triangles that floor and lamp leave.
fn statue(triangles: u32) -> Result<Scene, SceneError> {
    // A tenth of the triangles for the floor.
    let cells = (f64::from(triangles) / 20.0).sqrt().round().max(1.0) as u32;
    let lamp_cells = 2;
    let body = triangles - 2 * cells * cells - 2 * lamp_cells * lamp_cells;
    let parts: [(Shape, &dyn Fn(DVec3) -> DVec3); 3] = [
        (Shape::Quad { cells }, &|x| DVec3::new(6.0 * x.x - 3.0, 0.0, 6.0 * x.z - 3.0)),
        (Shape::Statue { triangles: body }, &|x| x),
        // Turned over: it faces down.
        (Shape::Quad { cells: lamp_cells }, &|x| DVec3::new(1.6 * x.x - 0.8, 3.5, 1.8 - 1.6 * x.z)),
    ];
    let grey = |name: &str, albedo| Material {
        albedo: [albedo, 0.95 * albedo, 0.9 * albedo],
        ..Material::named(name)
    };
    let lamp = Material { emission: [20.0, 19.0, 17.0], ..grey("lamp", 0.5) };
    let (mut vertices, mut list) = (Vec::new(), Vec::new());
    for ((shape, place), material) in parts.into_iter().zip(0..) {
        let (points, faces) = shape.mesh();
        let first = vertices.len() as u32;
        vertices.extend(points.into_iter().map(place));
        list.extend(faces.into_iter().map(|f| Triangle { vertices: f.map(|v| v + first), material }));
    }
    Scene::new("statue", vertices, list, vec![grey("floor", 0.4), grey("marble", 0.7), lamp])
}

/// A scene of a file, each triangle cut into four until there are as many.
fn refined(file: &Path, triangles: u32) -> Result<Scene, SceneError> {
    let mut scene = Scene::load(file, &LoadOptions::default())?;
    while scene.triangles.len() < triangles as usize {
        scene.split_all(1);
    }
    Ok(scene)
}

/// Measures the one size of the command line, with other processes that mpirun has started, if it has.
#[cfg(feature = "mpi")]
pub fn only(arguments: &Arguments, interrupt: &Interrupt) -> Result<Outcome, Box<dyn Error>> {
    let Some(world) = antirad::ranks::World::join() else {
        return bounce(arguments, interrupt, &Ranks::default());
    };
    let checked = world.check().map_err(Box::from);
    checked.and_then(|()| bounce(arguments, interrupt, &world.ranks())).inspect_err(|error| {
        eprintln!("bench_scaling: {error}");
        // The others would wait for this one.
        world.abort(antirad::cli::EXIT_FAILURE);
    })
}

/// Measures the one size of the command line.
#[cfg(not(feature = "mpi"))]
pub fn only(arguments: &Arguments, interrupt: &Interrupt) -> Result<Outcome, Box<dyn Error>> {
    bounce(arguments, interrupt, &Ranks::default())
}

/// Measures one size; the first rank prints messages.
fn bounce(arguments: &Arguments, interrupt: &Interrupt, ranks: &Ranks) -> Result<Outcome, Box<dyn Error>> {
    let size = arguments.triangles[0];
    let options = DeviceOptions::asked(&arguments.device, arguments.memory_budget);
    let backend = Backend::open(Some(arguments.backend[0].into()), &options)?.with_ranks(ranks.clone());
    let speaks = ranks.rank() == 0;
    let scene = match &arguments.scene {
        Some(file) => refined(file, size)?,
        None => statue(size)?,
    };
    let settings = SolveSettings::default().bins(arguments.bins).solver(SolverChoice::FixedPoint);
    // A bounce does not use the shadows of lamps.
    let settings = settings.visibility(VisibilityChoice::Implicit).lamps(Lamps::Antiradiance);
    // Of the statue all triangles block, so that its cost does not depend on its shape.
    let occlusion = if arguments.scene.is_none() { Occlusion::Everything } else { Occlusion::Exact };
    // The least memory, and the kernels of close pairs.
    let options = PlanOptions::of(&backend).occlusion(occlusion).keep_near_field(false);
    let start = Instant::now();
    let plan = Plan::new(&scene, &options, &settings)?;
    let seconds_plan = start.elapsed().as_secs_f64();
    let report = plan.report();
    let staging = plan.staging();

    let resident_before = resident("VmRSS:");
    let emitted: Vec<_> = (0..scene.triangles.len()).map(|i| scene.material(i).emission).collect();
    let mut operators = transport::operators(&backend, &scene, plan, &emitted, 1.0)?;
    let mut x = operators.vector()?;
    let mut y = operators.vector()?;
    operators.fill(&mut x, 1.0)?;
    let stop = interrupt.clone();
    let (repeats, mut last) = (arguments.repeats, Instant::now());
    let (mut bounce, mut before) = (0, 0);
    operators.set_pass_callback(Some(Box::new(move |done, total| {
        if done < before {
            bounce += 1;
        }
        before = done;
        if speaks && last.elapsed().as_secs_f64() > 0.2 {
            last = Instant::now();
            let share = (f64::from(bounce) + done as f64 / total.max(1) as f64) / f64::from(repeats);
            if print(&Message::Progress(share)).is_err() {
                return ControlFlow::Break(());
            }
        }
        stop.flow()
    })));
    let (mut wall, mut kernels, mut received) = (f64::INFINITY, f64::INFINITY, 0);
    for _ in 0..repeats {
        backend.reset_profile();
        let [_, before] = ranks.moved();
        let start = Instant::now();
        match operators.pass(Some(&x), true, &mut y).and_then(|()| operators.finish()) {
            Err(TransportError::Interrupted) => return Ok(Outcome::Interrupted),
            other => other?,
        }
        wall = wall.min(start.elapsed().as_secs_f64());
        received = ranks.moved()[1] - before;
        kernels = kernels.min(backend.profile().iter().map(|row| row.seconds).sum());
    }
    // A user reads the result, too, which allocates the staging buffer.
    if operators.irradiance(&y)?.iter().flatten().any(|h| !h.is_finite()) {
        return Err("the bounce gave irradiance that is not finite: a bug in antirad".into());
    }
    let memory = backend.memory();
    let planned: u64 = report.memory.iter().map(|item| item.bytes).sum();
    if memory.in_use != planned {
        return Err(format!("planned {planned} bytes, allocated {}: a bug in antirad", memory.in_use).into());
    }
    if arguments.verbose > 0 {
        for row in backend.profile() {
            eprintln!("{size}: {row}");
        }
    }
    drop((x, y));
    if !speaks {
        return Ok(Outcome::Done);
    }
    let pairs = report.pairs;
    print(&Message::Row(Box::new(Row {
        backend: backend.kind(),
        device: backend.device_name().to_owned(),
        threads: backend.threads(),
        size,
        triangles: report.triangles,
        bins: arguments.bins.to_string(),
        budget: arguments.memory_budget,
        ranks: arguments.ranks,
        bytes_received: received,
        bytes_planned: planned,
        bytes_allocated: memory.in_use,
        bytes_peak: memory.peak,
        bytes_fixed: staging,
        bytes_host: report.states.host_bytes,
        bytes_moved: report.states.bytes_moved_per_pass,
        resident_growth: resident("VmRSS:").saturating_sub(resident_before),
        resident_peak: resident("VmHWM:"),
        pairs: pairs.total,
        pairs_culled: pairs.culled,
        pairs_sub_sampled: pairs.sub_sampled,
        interactions: pairs.irradiance,
        interactions_bins: pairs.bins,
        seconds_plan,
        seconds_kernels: kernels,
        seconds_wall: wall,
        pairs_per_second: pairs.total as f64 / wall,
        bytes_per_triangle: (memory.in_use - staging) as f64 / report.triangles as f64,
    })))?;
    Ok(Outcome::Done)
}

fn print(message: &Message) -> Result<(), Box<dyn Error>> {
    use std::io::Write;
    writeln!(std::io::stdout().lock(), "{}", serde_json::to_string(message)?)?;
    Ok(())
}

/// A line of /proc/self/status in bytes; 0 where there is none.
fn resident(line: &str) -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let value = status.lines().find_map(|l| l.strip_prefix(line));
    let kilobytes = value.and_then(|v| v.trim().trim_end_matches(" kB").parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}

/// Measures one size in a process of its own.
pub fn in_child(
    arguments: &Arguments,
    (backend, size): (BackendKind, u32),
    interrupt: &Interrupt,
    progress: &dyn Fn(f64),
) -> Result<Size, Box<dyn Error>> {
    let mut command = match arguments.ranks {
        1 => Command::new(std::env::current_exe()?),
        ranks => {
            let mut command = Command::new("mpirun");
            command.args(["--oversubscribe", "--bind-to", "none", "-n", &ranks.to_string()]);
            command.arg(std::env::current_exe()?).args(["--ranks", &ranks.to_string()]);
            command
        }
    };
    command.args(["--only", "--triangles", &size.to_string(), "--bins", &arguments.bins.to_string()]);
    command.args(["--backend", &backend.to_string(), "--repeats", &arguments.repeats.to_string()]);
    if let Some(budget) = arguments.memory_budget {
        command.args(["--memory-budget", &budget.to_string()]);
    }
    if let Some(device) = arguments.device.as_ref().filter(|_| backend == BackendKind::Vulkan) {
        command.args(["--device", device]);
    }
    if let Some(scene) = &arguments.scene {
        command.arg("--scene").arg(scene);
    }
    if arguments.verbose > 0 {
        command.arg("-v");
    }
    let mut child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn()?;
    let (Some(output), Some(mut errors)) = (child.stdout.take(), child.stderr.take()) else {
        return Err("the measuring process has no output".into());
    };
    // Both pipes are read on threads of their own: neither can fill up and stop the process, and an interrupt need not
    // wait for the next message.
    let errors = std::thread::spawn(move || {
        let mut text = String::new();
        let _ = errors.read_to_string(&mut text);
        text
    });
    let (sender, lines) = mpsc::channel();
    std::thread::spawn(move || BufReader::new(output).lines().try_for_each(|line| sender.send(line)));
    let mut row = None;
    loop {
        if interrupt.is_set() {
            // It writes no files.
            child.kill()?;
            child.wait()?;
            return Ok(Size::Interrupted);
        }
        match lines.recv_timeout(POLL) {
            Ok(line) => match serde_json::from_str(&line?)? {
                Message::Progress(share) => progress(share),
                Message::Row(measured) => row = Some(measured),
            },
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => break,
        }
    }
    let status = child.wait()?;
    let errors = errors.join().unwrap_or_default();
    match row {
        _ if interrupt.is_set() => Ok(Size::Interrupted),
        Some(row) if status.success() => {
            eprint!("{errors}");
            Ok(Size::Measured(row))
        }
        _ => {
            // What mpirun says has many lines, of which the last may tell nothing.
            let said = match arguments.ranks {
                1 => errors.lines().last().unwrap_or_default().trim_start_matches("bench_scaling: "),
                _ => errors.trim(),
            };
            Ok(Size::Failed(if said.is_empty() { status.to_string() } else { said.to_owned() }))
        }
    }
}
