//! Several ranks solve one scene: here they are threads, each with a backend of its own. `scripts/mpi` does the same with processes.

mod support;

use antirad::Watch;
use antirad::backend::{Backend, BackendKind, Cpu, CpuOptions};
use antirad::fit::{
    EngineRenderer, Fit, FitError, Job, OnCheckpoint, Outcome, Renderer, RunOptions, Settings, StopRule,
    Target,
};
use antirad::gpu::{Device, DeviceOptions};
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::ranks::{Ranks, in_threads};
use antirad::render::Quantity;
use antirad::scene::{
    BinLayout, Lamps, Material, Scene, SceneBuilder, Shape, SolveSettings, VisibilityChoice,
};
use antirad::{Cotangent, Engine, EngineError, SolveParams};
use antirad_core::plan::Residency;
use glam::DVec3;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::thread;
use support::random::{random_scene, with_own_powers};
use support::{backend, finish, load, placed, relative_l2, same_to_rounding};

const BOTH: [BackendKind; 2] = [BackendKind::Cpu, BackendKind::Vulkan];

fn open(kind: BackendKind, memory_budget: Option<u64>) -> Backend {
    match kind {
        BackendKind::Vulkan => {
            let options = DeviceOptions::default().validation(true).memory_budget(memory_budget);
            Device::new(&options).expect("a Vulkan device").into()
        }
        BackendKind::Cpu => Backend::Cpu(Cpu::new(&CpuOptions::default().memory_budget(memory_budget))),
    }
}

/// Runs the same work on each of several ranks, and returns the results by rank, with the bytes that each received.
fn on_ranks<T: Send>(kind: BackendKind, count: usize, work: impl Fn(&Backend) -> T + Sync) -> Vec<(T, u64)> {
    within(kind, &vec![None; count], work)
}

/// The same for backends with these memory budgets, one for each rank.
fn within<T: Send>(
    kind: BackendKind,
    budgets: &[Option<u64>],
    work: impl Fn(&Backend) -> T + Sync,
) -> Vec<(T, u64)> {
    thread::scope(|scope| {
        let run = |ranks: Ranks| {
            let work = &work;
            scope.spawn(move || {
                let backend = open(kind, budgets[ranks.rank()]).with_ranks(ranks);
                let result = work(&backend);
                finish(&backend);
                (result, backend.ranks().moved()[1])
            })
        };
        let threads: Vec<_> = in_threads(budgets.len()).into_iter().map(run).collect();
        threads.into_iter().map(|thread| thread.join().expect("a rank")).collect()
    })
}

/// What a rank has found, and what it took.
#[derive(PartialEq)]
struct Found {
    on_host: bool,
    /// Bytes of states and of cotangents of glossy light that the rank holds, windows included.
    held: u64,
    /// Light and gradients.
    values: Vec<Vec<[f64; 3]>>,
}

fn found(backend: &Backend, scene: &Scene, settings: &SolveSettings, options: PlanOptions) -> Found {
    assert_eq!(options.ranks as usize, backend.ranks().count());
    let plan = Plan::new(scene, &options, settings).expect("a plan");
    // Some ranks may have no close pairs, and rays find theirs later.
    let kept =
        plan.near_field_matrix().is_some() || plan.transport().is_explicit() && options.keep_near_field;
    assert!(kept == options.keep_near_field || !kept && options.ranks > 1, "{}", plan.near_field());
    let on_host = plan.residency() != Residency::Device;
    let of_label = |label: &str| plan.memory().of_label(label);
    let held = match on_host {
        true => plan.report().states.host_bytes,
        false => ["state: bins", "state: irradiance", "cotangent: specular"].map(of_label).iter().sum(),
    };
    let mut engine = Engine::new(backend, scene, plan).expect("an engine");
    let params = SolveParams::from(settings);
    let solution = engine.solve(&params).expect("a solution");
    let eye = DVec3::new(0.3, 0.4, 2.6);
    let colours = engine.face_colours(&solution, eye).expect("colours");
    let mut values = vec![solution.irradiance.clone(), solution.radiosity.clone(), colours];
    if options.gradients.any() {
        let cotangent = everything_matters(scene, eye);
        let by = engine.backward(&solution, &cotangent, options.gradients, &params).expect("gradients");
        let rgb = |v: Option<Vec<DVec3>>| v.into_iter().flatten().map(|v| v.to_array()).collect();
        let one = |v: Option<Vec<f64>>| v.into_iter().flatten().map(|v| [v; 3]).collect();
        values.extend([rgb(by.emission), one(by.diffuse), rgb(by.albedo), rgb(by.specular), one(by.power)]);
        values.extend([rgb(by.vertices), rgb(by.camera_positions)]);
    }
    Found { on_host, held, values }
}

/// Walls that are glossy and block nothing, about a box that does.
fn room_of_glossy_walls() -> Scene {
    let wall = Material {
        albedo: [0.4, 0.3, 0.2],
        emission: [1.0; 3],
        specular: [0.05; 3],
        power: 20.0,
        ..Material::named("wall")
    };
    let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
    let mut builder = SceneBuilder::new();
    builder.shape("walls", Shape::Room { cells: 3 }, &wall, placed([1.0; 3], [0.0; 3]));
    builder.shape("box", Shape::Box { cells: 1 }, &grey, placed([0.3; 3], [0.4, 0.2, 0.3]));
    let mut scene = builder.finish("glossy walls").map(support::implicit).expect("a scene");
    // All light passes through U.
    scene.settings = scene.settings.lamps(Lamps::Antiradiance);
    scene
}

/// A scene for which each rank holds the bins of its own triangles.
struct Case<'a> {
    name: &'a str,
    scene: &'a Scene,
    /// Close pairs are kept, in place of evaluated in each pass.
    keep: bool,
    gradients: GradientRequest,
    /// What makes states stay in host memory.
    budget: Option<u64>,
    ranks: usize,
    /// Results are compared with those of another run.
    twice: bool,
}

/// Each rank holds the bins of its own triangles, on its device or where these do not fit in host memory, and all see those of the others
/// pass by: the same light and gradients as on one device but for the rounding of sums, and from run to run the same bytes.
fn each_holds_its_own(case: &Case) {
    let Case { scene, keep, gradients, budget, ranks, .. } = *case;
    // What holds of few bins holds of many.
    let settings = scene.settings.tolerance(0.1).near_field(10.0);
    let settings = settings.bins(BinLayout::EqualAngle { theta: 4, phi: 6 });
    let solved = |backend: &Backend, budget: Option<u64>| {
        let options = PlanOptions::of(backend).keep_near_field(keep).tile(32).gradients(gradients);
        let options = budget.map_or(options, |budget| options.memory_budget(budget));
        found(backend, scene, &settings, options)
    };
    // The CPU has no states elsewhere.
    for kind in BOTH.into_iter().filter(|kind| budget.is_none() || *kind == BackendKind::Vulkan) {
        let name = &format!("{}, {kind}", case.name);
        let alone = solved(&open(kind, None), budget);
        assert_eq!(alone.on_host, budget.is_some(), "{name}");
        if budget.is_some() {
            let resident = solved(&open(kind, None), None);
            assert!(!resident.on_host, "{name}");
            close_to(name, &alone.values, &resident.values);
        }
        let several = on_ranks(kind, ranks, |backend| solved(backend, budget));
        if case.twice {
            let again = on_ranks(kind, ranks, |backend| solved(backend, budget));
            assert!(again == several, "{name}: another run");
        }
        for (rank, (found, received)) in several.iter().enumerate() {
            let share = found.held as f64 / alone.held as f64;
            println!("{name}, rank {rank} of {ranks}: holds {share:.3}, received {received}");
            assert_eq!(found.on_host, budget.is_some(), "{name}");
            close_to(name, &found.values, &alone.values);
            assert!(*received > 0, "{name}: rank {rank} of {ranks}");
        }
    }
}

const NOTHING: GradientRequest = GradientRequest::NOTHING;

/// 150 triangles anywhere, glossy ones of own powers among them.
fn glossy() -> Scene {
    with_own_powers(random_scene(5, 150, true, false))
}

/// A case that keeps its close pairs, without gradients, on three devices.
fn case<'a>(name: &'a str, scene: &'a Scene) -> Case<'a> {
    Case { name, scene, keep: true, gradients: NOTHING, budget: None, ranks: 3, twice: false }
}

#[test]
fn ranks_hold_their_own_states() {
    let (plain, walls, glossy) = (random_scene(4, 150, false, false), room_of_glossy_walls(), glossy());
    let mut rays = glossy.clone();
    rays.settings = rays.settings.visibility(VisibilityChoice::Explicit);
    let by_materials = NOTHING.emission(true).albedo(true).specular(true);
    let everything = GradientRequest::EVERYTHING;
    let few = NOTHING.emission(true).positions(true);
    each_holds_its_own(&Case { gradients: few, ..case("plain", &plain) });
    each_holds_its_own(&Case { gradients: everything, ranks: 4, twice: true, ..case("glossy", &glossy) });
    each_holds_its_own(&Case { gradients: by_materials, ..case("glossy, by rays", &rays) });
    each_holds_its_own(&Case { gradients: everything, keep: false, ..case("glossy walls", &walls) });
}

#[test]
fn ranks_hold_their_own_states_on_the_host() {
    let glossy = glossy();
    let everything = GradientRequest::EVERYTHING;
    let stated = case("glossy, on the host", &glossy);
    each_holds_its_own(&Case {
        gradients: everything,
        keep: false,
        budget: Some(500_000),
        twice: true,
        ..stated
    });
}

/// Together ranks hold each state once, on devices and on the host, and irradiance each; beside it, on devices, one window, of about as much as
/// a rank holds of a state.
#[test]
fn ranks_part_the_memory_of_states() {
    let scene = load("scenes/cornell_boxes_fine.toml");
    let (cpu, vulkan) = (PlanOptions::default(), PlanOptions::lavapipe());
    for (usual, budget) in [(cpu, None), (vulkan, None), (vulkan, Some(6 << 20))] {
        // Bytes of states and of the window.
        let held = |rank: u32, ranks: u32| {
            let options = usual.keep_near_field(false).tile(32);
            let options = options.rank(rank).ranks(ranks);
            let options = budget.map_or(options, |budget| options.memory_budget(budget));
            let plan = Plan::new(&scene, &options, &scene.settings).expect("a plan");
            assert_eq!(plan.residency() != Residency::Device, budget.is_some());
            let states = plan.report().states;
            let (irradiance, vectors) = (plan.irradiance_bytes(), u64::from(plan.vectors()));
            let (all, window) = match budget {
                Some(_) => (states.host_bytes, 0),
                None if ranks == 1 => (plan.memory().of_label("state: bins") + vectors * irradiance, 0),
                None => {
                    let window = u64::from(states.source_tiles) * plan.tile_bytes();
                    (plan.memory().of_label("state: bins") + vectors * irradiance - window, window)
                }
            };
            let bins = (plan.tiles_with_bins().len() as u64 * plan.tile_bytes()) as f64;
            ([all, window, vectors, irradiance], [bins, 2048.0 * plan.bin_bytes() as f64])
        };
        let ([alone, _, vectors, irradiance], [bins, dispatch]) = held(0, 1);
        for ranks in [3] {
            let of: Vec<_> = (0..ranks).map(|rank| held(rank, ranks).0).collect();
            let all: u64 = of.iter().map(|[all, ..]| all).sum();
            let once = all - u64::from(ranks - 1) * vectors * irradiance;
            assert!(once.abs_diff(alone) <= u64::from(ranks) * 64 * vectors * 256, "{once}, {alone}");
            for [own, window, ..] in of {
                println!("{}, of {ranks} ranks: {own} and {window} of {alone} bytes", usual.backend);
                // Some triangles have more close pairs, and work is parted, not triangles.
                assert!((own * u64::from(ranks)) as f64 <= 1.6 * alone as f64);
                // The part of a rank in whole dispatches, of 2048 sources.
                assert!(window as f64 <= (bins / f64::from(ranks) / dispatch).ceil() * dispatch);
            }
        }
    }
}

/// A cotangent of irradiance, radiosity and of what a camera sees.
fn everything_matters(scene: &Scene, eye: DVec3) -> Cotangent {
    let loss = |k: usize| (0..scene.triangles.len()).map(move |i| DVec3::splat(((i * k) % 7) as f64 - 2.0));
    Cotangent::default()
        .irradiance(Some(loss(3).collect()))
        .radiosity(Some(loss(5).collect()))
        .colours(vec![(eye, loss(2).collect())])
}

/// Whether each of some quantities is the same but for rounding: light and then gradients.
fn close_to(name: &str, found: &[Vec<[f64; 3]>], wanted: &[Vec<[f64; 3]>]) {
    assert_eq!(found.len(), wanted.len(), "{name}");
    for (k, (found, wanted)) in found.iter().zip(wanted).enumerate() {
        let off = relative_l2(found, wanted, &vec![1.0; wanted.len()]);
        println!("{name}, quantity {k}: {off:.1e}");
        let most = if k < 3 { 2e-6 } else { 2e-5 };
        assert!(wanted.is_empty() || off <= most, "{name}, quantity {k}: {off}");
    }
}

/// Pictures with gathered light and their derivatives are computed in shares, too: those of one device, where rays tell what glossy faces
/// mirror, and where derivatives by everything take it from bins.
#[test]
fn ranks_share_pictures() {
    let mut scene = load("scenes/fits/glossy.toml");
    scene.settings = scene.settings.bins(BinLayout::Concentric { n: 4 }).near_field(10.0).tolerance(1e-3);
    scene.cameras.truncate(1);
    (scene.cameras[0].width, scene.cameras[0].height) = (24, 18);
    let of_materials = GradientRequest::NOTHING.emission(true).albedo(true).specular(true).power(true);
    for (name, request) in [("rays", of_materials), ("bins", GradientRequest::EVERYTHING)] {
        let made = |backend: &Backend| -> Vec<Vec<[f64; 3]>> {
            let watch: Watch = Arc::new(|| ControlFlow::Continue(()));
            let mut renderer =
                EngineRenderer::new(backend, scene.clone(), 2, request, watch).expect("a renderer");
            let pictures = renderer.pictures(&scene).expect("pictures");
            let weights = (0..pictures[0].len()).map(|k| DVec3::new(1.0, 0.5, 0.2) * (k as f64).sin());
            let by =
                renderer.pull_back(&[weights.collect()], request).expect("gradients").expect("a picture");
            let rgb = |values: &[DVec3]| values.iter().map(|value| value.to_array()).collect();
            let quantities = [Some(pictures[0].clone()), by.emission, by.albedo, by.specular, by.positions];
            let mut all: Vec<Vec<[f64; 3]>> = quantities.iter().flatten().map(|values| rgb(values)).collect();
            all.push(by.power.expect("by powers").into_iter().map(|by| [by; 3]).collect());
            all.extend(by.cameras.map(|of| of.iter().map(|by| by.position.to_array()).collect()));
            all
        };
        for kind in BOTH {
            let name = &format!("{name}, {kind}");
            let alone = made(&open(kind, None));
            assert_eq!(alone.len(), if request.positions { 7 } else { 5 });
            let lit = alone.iter().all(|values| values.iter().flatten().any(|value| *value != 0.0));
            assert!(lit, "{name}");
            for (found, received) in on_ranks(kind, 3, made) {
                close_to(name, &found, &alone);
                assert!(received > 0);
            }
        }
    }
}

/// Pairs of far triangles that a backend has evaluated.
fn far_pairs(backend: &Backend) -> u64 {
    let far = |kernel: &str| match backend.kind() {
        BackendKind::Vulkan => kernel.starts_with("transport"),
        BackendKind::Cpu => kernel == "far",
    };
    backend.profile().into_iter().filter(|row| far(&row.kernel)).map(|row| row.items).sum()
}

/// The work of a rank is its share: together they evaluate the pairs of one alone.
#[test]
fn ranks_share_the_pairs() {
    let scene = load("scenes/cornell_boxes.toml");
    let settings = scene.settings.max_passes(2).tolerance(0.9);
    let pairs = |backend: &Backend| {
        let plan = Plan::new(&scene, &PlanOptions::of(backend), &settings).expect("a plan");
        let mut engine = Engine::new(backend, &scene, plan).expect("an engine");
        engine.solve(&SolveParams::from(&settings)).expect("a solution");
        far_pairs(backend)
    };
    for kind in BOTH {
        let alone = pairs(&open(kind, None));
        let several: Vec<u64> = on_ranks(kind, 3, pairs).into_iter().map(|(pairs, _)| pairs).collect();
        assert!(alone > 0);
        assert_eq!(several.iter().sum::<u64>(), alone, "{kind}");
        for own in several {
            assert!((own as f64 / alone as f64 - 1.0 / 3.0).abs() < 0.05, "{kind}: {own} of {alone}");
        }
    }
}

/// A rank whose backend has half the memory of the other does half as much, of a pass and of states on the host, and no result changes by
/// that.
#[test]
fn a_smaller_budget_gets_less() {
    let scene = load("scenes/cornell_boxes.toml");
    let budgets = [1 << 29, 1 << 28].map(Some);
    let wanted = [2.0 / 3.0, 1.0 / 3.0];
    for (kind, on_host) in
        [(BackendKind::Cpu, None), (BackendKind::Vulkan, None), (BackendKind::Vulkan, Some(4 << 20))]
    {
        let settings = scene.settings.max_passes(2).tolerance(0.9);
        let solved = |backend: &Backend| {
            let options = PlanOptions::of(backend).keep_near_field(false).tile(32);
            let options = on_host.map_or(options, |budget| options.memory_budget(budget));
            let plan = Plan::new(&scene, &options, &settings).expect("a plan");
            assert_eq!(plan.residency() != Residency::Device, on_host.is_some());
            let held = plan.report().states.host_bytes;
            let mut engine = Engine::new(backend, &scene, plan).expect("an engine");
            let solution = engine.solve(&SolveParams::from(&settings)).expect("a solution");
            (far_pairs(backend), held, solution.irradiance)
        };
        let alone = solved(&open(kind, None));
        let several = within(kind, &budgets, solved);
        assert_eq!(several.iter().map(|((pairs, ..), _)| pairs).sum::<u64>(), alone.0);
        for (((pairs, held, irradiance), _), wanted) in several.into_iter().zip(wanted) {
            let share = pairs as f64 / alone.0 as f64;
            println!("{kind}: {share:.3} of all pairs, {held} of {} bytes on the host", alone.1);
            // Close pairs are most of the work, and tiles have different numbers of them.
            assert!((share - wanted).abs() < 0.05, "{kind}: {share}");
            match on_host {
                None => close_to("on devices", &[irradiance], std::slice::from_ref(&alone.2)),
                Some(_) => {
                    let share = held as f64 / alone.1 as f64;
                    // The same, and irradiance is everywhere; even shares would be .15 off.
                    assert!((share - wanted).abs() < 0.1, "{share} of states");
                    close_to("on the host", &[irradiance], std::slice::from_ref(&alone.2));
                }
            }
        }
    }
}

#[test]
fn a_rank_that_ends_ends_the_solves_of_the_others() {
    let scene = load("scenes/closed_box.toml");
    let solve = |ranks: Ranks| {
        let backend = backend().with_ranks(ranks);
        let plan = Plan::new(&scene, &PlanOptions::of(&backend), &scene.settings).expect("a plan");
        let stops = backend.ranks().rank() == 1;
        let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
        engine.set_pass_callback(Some(Box::new(move |_, _| match stops {
            true => ControlFlow::Break(()),
            false => ControlFlow::Continue(()),
        })));
        engine.solve(&SolveParams::from(&scene.settings)).map(drop).expect_err("a rank has left")
    };
    let errors: Vec<EngineError> = thread::scope(|scope| {
        let solve = &solve;
        let threads: Vec<_> =
            in_threads(2).into_iter().map(|ranks| scope.spawn(move || solve(ranks))).collect();
        threads.into_iter().map(|thread| thread.join().expect("a thread")).collect()
    });
    assert!(errors[1].is_interruption(), "{}", errors[1]);
    assert!(errors[0].to_string().contains("another process"), "{}", errors[0]);
    assert!(errors[0].may_pass());
}

/// A fit that loses a rank says that another start is worth it, and that start goes on from the checkpoint, here alone, to the result of a fit
/// that nothing happened to.
#[test]
fn a_fit_that_loses_a_rank_is_gone_on_with() {
    let mut scene = load("scenes/fits/room.toml");
    scene.settings.bins = BinLayout::Concentric { n: 4 };
    scene.settings.near_field = 10.0;
    for camera in &mut scene.cameras {
        (camera.width, camera.height) = (16, 12);
    }
    let camera = scene.camera("one").expect("a camera").clone();
    scene.cameras = vec![camera.clone()];
    let goes_on: Watch = Arc::new(|| ControlFlow::Continue(()));
    let renderer = |backend: &Backend, planning: &Scene, request| {
        EngineRenderer::new(backend, planning.clone(), 2, request, goes_on.clone()).expect("a renderer")
    };
    let pictures = renderer(&backend(), &scene, GradientRequest::NOTHING).pictures(&scene).expect("pictures");
    let stop = StopRule::default().iterations(6).relative_decrease(0.0).gradient(0.0);
    let options = RunOptions::default().checkpoint_every(1).stop(stop);
    // Stops before the iteration `last` is done.
    let fit = |backend: &Backend, options: &RunOptions, last: u32| -> Result<Outcome, FitError> {
        let grey = Some(vec![String::from("grey")]);
        let fits = vec![Fit::new(Quantity::Albedo).materials(grey).initial(Some([0.3; 3]))];
        let target = Target::new(camera.clone(), pictures[0].clone(), None, 1.0).expect("a target");
        let settings = Settings::new(fits).supersample(2);
        let mut job = Job::new("test", scene.clone(), vec![target], settings).expect("a job");
        let parameters = &job.problem().parameters;
        let mut renderer = renderer(backend, &parameters.planning_scene(), parameters.gradient_request());
        job.run(&mut renderer, options, &mut |record, _| match record.iteration < last {
            true => ControlFlow::Continue(()),
            false => ControlFlow::Break(()),
        })
    };
    let folder = tempfile::tempdir().expect("a folder");
    let stored = options.clone().checkpoints(Some(folder.path().to_path_buf()));
    let errors: Vec<FitError> = thread::scope(|scope| {
        let (fit, stored, options) = (&fit, &stored, &options);
        let run = |ranks: Ranks| {
            scope.spawn(move || {
                let backend = backend().with_ranks(ranks);
                match backend.ranks().rank() {
                    0 => fit(&backend, stored, u32::MAX),
                    _ => fit(&backend, options, 3),
                }
                .expect_err("a rank has left")
            })
        };
        let threads: Vec<_> = in_threads(2).into_iter().map(run).collect();
        threads.into_iter().map(|thread| thread.join().expect("a thread")).collect()
    });
    assert!(matches!(errors[1], FitError::Interrupted { iteration: 3 }), "{}", errors[1]);
    assert!(errors[0].to_string().contains("another process"), "{}", errors[0]);
    assert!(errors[0].may_pass());

    let [alone, resumed] = [(&options, None), (&stored, Some(3))].map(|(options, from)| {
        let options = options.clone().on_checkpoint(OnCheckpoint::Resume);
        let outcome = fit(&backend(), &options, u32::MAX).expect("an outcome");
        assert_eq!(outcome.resumed_from, from);
        outcome
    });
    let values = |outcome: &Outcome| -> Vec<f64> {
        let recovered = outcome.recovered.iter().flat_map(|of| &of.value).copied();
        recovered.chain(outcome.history.iter().map(|record| record.loss)).collect()
    };
    let [found, expected] = [&resumed, &alone].map(values);
    // Two ranks add the sums of kernels in another order than one.
    let agree = match backend() {
        Backend::Vulkan(_) => same_to_rounding(&found, &expected),
        Backend::Cpu(_) => found == expected,
    };
    assert!(agree, "{found:?}, not {expected:?}");
}
#[test]
fn a_plan_for_other_ranks_is_refused() {
    let scene = load("scenes/closed_box.toml");
    let backend = backend();
    let options = PlanOptions::of(&backend).rank(1).ranks(2);
    let plan = Plan::new(&scene, &options, &scene.settings).expect("a plan");
    assert!(matches!(Engine::new(&backend, &scene, plan), Err(EngineError::OtherRanks { .. })));
    let beyond = Plan::new(&scene, &options.rank(2), &scene.settings);
    assert!(beyond.is_err_and(|error| error.to_string().contains("process 2 of 2")));
}
