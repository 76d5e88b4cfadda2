//! Invariance of results: tiles, pages, culling, repetition, solvers, residency.

mod support;

use antirad::backend::{Backend, BackendKind, Cpu, CpuOptions};
use antirad::gpu::{Device, DeviceOptions};
use antirad::plan::{GradientRequest, Plan, PlanError, PlanOptions};
use antirad::scene::{
    BinLayout, Lamps, Material, Precision, Scene, Shape, SolveSettings, SolverChoice, Triangle,
    VisibilityChoice,
};
use antirad::{Cotangent, Engine, EngineError, SolveParams};
use antirad_core::plan::Residency;
use antirad_core::solve::{FixedPointParams, SolveError, fixed_point};
use antirad_gpu::{Buffer, BufferKind};
use antirad_reference::{Exchange, Model, emission};
use glam::DVec3;
use std::any::Any;
use std::ops::ControlFlow;
use std::sync::Barrier;
use support::{areas, backend, device, finish, load, relative_l2, same, solve, solve_within};

/// A room with a lamp under the ceiling and a box on the floor.
fn room(cells: u32, albedo: f64) -> Scene {
    let grey = Material { albedo: [albedo; 3], ..Material::named("grey") };
    let red = Material { albedo: [albedo, 0.3 * albedo, 0.2 * albedo], ..Material::named("red") };
    let lamp = Material { emission: [10.0, 9.0, 7.0], ..Material::named("lamp") };
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    let mut add = |shape: Shape, material: u32, place: &dyn Fn(DVec3) -> DVec3| {
        let (points, faces) = shape.mesh();
        let first = vertices.len() as u32;
        vertices.extend(points.into_iter().map(place));
        triangles.extend(faces.into_iter().map(|f| Triangle { vertices: f.map(|v| v + first), material }));
    };
    add(Shape::Room { cells }, 0, &|x| x);
    add(Shape::Box { cells: cells.div_ceil(2) }, 1, &|x| {
        x * DVec3::new(0.3, 0.4, 0.3) + DVec3::new(0.35, 0.001, 0.3)
    });
    // Facing down.
    add(Shape::Quad { cells: 2 }, 2, &|x| DVec3::new(0.3 + 0.4 * x.x, 0.95, 0.7 - 0.4 * x.z));
    let mut scene = Scene::new("room", vertices, triangles, vec![grey, red, lamp])
        .map(support::implicit)
        .expect("a scene");
    // A quad facing up, turned over.
    let turned: Vec<Triangle> = scene.triangles.clone();
    for (i, t) in turned.iter().enumerate().filter(|(_, t)| t.material == 2) {
        let [a, b, c] = scene.corners(i);
        if (b - a).cross(c - a).y > 0.0 {
            scene.triangles[i].vertices = [t.vertices[0], t.vertices[2], t.vertices[1]];
        }
    }
    // What holds of few bins holds of many.
    scene.settings = scene.settings.bins(BinLayout::EqualAngle { theta: 4, phi: 6 }).near_field(10.0);
    scene
}

fn tight(scene: &Scene) -> SolveSettings {
    scene.settings.tolerance(1e-6)
}

#[test]
fn culling_tiles_and_pages_change_nothing() {
    let backend = backend();
    let scene = load("scenes/cornell_boxes.toml");
    let settings = tight(&scene).bins(BinLayout::Concentric { n: 4 }).near_field(10.0);
    let usual = PlanOptions::of(&backend);
    let (engine, truth) = solve_within(&backend, &scene, &settings, &usual);
    assert!(engine.plan().pairs().culled > 0);
    let areas = areas(&scene);
    for (name, plan_options) in [
        ("no culling", usual.cull(false)),
        ("tiles of 32", usual.tile(32)),
        ("pages of 128 KiB", usual.page(1 << 17)),
    ] {
        let (engine, other) = solve_within(&backend, &scene, &settings, &plan_options);
        let error = relative_l2(&other.irradiance, &truth.irradiance, &areas);
        println!("{name}: {error:.2e}, {} groups", engine.plan().layout().groups.len());
        assert!(error <= 1e-5, "{name}: {error:e}");
    }
    finish(&backend);
}

#[test]
fn the_same_run_twice_gives_the_same_bytes() {
    let scene = load("scenes/cornell_boxes.toml");
    let run = || {
        let backend = backend();
        let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
        let colours = engine.face_colours(&solution, scene.cameras[0].position).expect("colours");
        finish(&backend);
        (solution.irradiance.clone(), solution.radiosity.clone(), colours)
    };
    let (first, second) = (run(), run());
    let bytes = |v: &[[f64; 3]]| bytemuck::cast_slice::<_, u8>(v).to_vec();
    assert!(bytes(&first.0) == bytes(&second.0));
    assert!(bytes(&first.1) == bytes(&second.1));
    assert!(bytes(&first.2) == bytes(&second.2));
}

#[test]
fn the_builder_makes_the_same_engine() {
    let backend = backend();
    let scene = room(3, 0.5);
    let settings = scene.settings.tolerance(1e-3);
    let (long, expected) = solve(&backend, &scene, &settings);
    let (options, irradiance) = (*long.plan().options(), expected.irradiance.clone());
    // The options of a device are what engines and solutions have left of it.
    drop((long, expected));
    let mut short = Engine::builder(&backend, &scene).settings(settings).build().expect("an engine");
    assert_eq!((short.plan().options(), short.plan().settings()), (&options, &settings));
    let solution = short.solve(&SolveParams::from(&settings)).expect("a solution");
    assert_eq!(solution.irradiance, irradiance);
    let small = PlanOptions::of(&backend).tile(32);
    let request = antirad::plan::GradientRequest::NOTHING.albedo(true);
    let other =
        Engine::builder(&backend, &scene).options(small).gradients(request).build().expect("an engine");
    assert_eq!(other.plan().options(), &small.gradients(request));
    finish(&backend);
}

#[test]
fn solving_again_on_the_same_engine_gives_the_same() {
    let backend = backend();
    let scene = room(4, 0.5);
    let (mut engine, first) = solve(&backend, &scene, &scene.settings);
    let second = engine.solve(&SolveParams::from(&scene.settings)).expect("a solution");
    assert_eq!(first.irradiance, second.irradiance);
    finish(&backend);
}

#[test]
fn solvers_agree_with_each_other_and_with_the_reference() {
    let backend = backend();
    let scene = room(3, 0.7);
    let model = Model::new(&scene);
    let mut operator = &model;
    let params = FixedPointParams::new(1e-9, 200);
    let (truth, info) =
        fixed_point(&mut operator, &params, &mut |_, _| ControlFlow::Continue(())).expect("a reference");
    let expected = info.spectral_radius.expect("an estimate");
    assert!(expected > 0.1 && expected < 1.0, "{info:?}");
    let truth: Vec<[f64; 3]> = truth.irradiance.iter().map(|h| h.to_array()).collect();
    for solver in [SolverChoice::FixedPoint, SolverChoice::Gmres] {
        let settings = scene.settings.solver(solver).tolerance(1e-6).lamps(Lamps::Antiradiance);
        let (_engine, solution) = solve(&backend, &scene, &settings);
        let error = relative_l2(&solution.irradiance, &truth, &areas(&scene));
        let radius = solution.info.spectral_radius.expect("an estimate");
        println!("{solver:?}: {} passes, {error:.2e}, radius {radius:.3}", solution.info.passes);
        assert!(error <= 1e-5, "{solver:?}: {error:e}");
        assert!((radius / expected - 1.0).abs() <= 0.15, "{solver:?}: {radius} instead of {expected}");
        assert!(solution.info.residuals.iter().all(|r| r.is_finite()));
    }
    finish(&backend);
}

/// Triangles that the plan gives no bins change nothing when they get some.
#[test]
fn classes_are_exact() {
    let scene = room(3, 0.6);
    let planned = Model::new(&scene);
    let without = planned.classes.iter().filter(|c| !c.has_bins()).count();
    assert!(without > 50 && without < planned.classes.len(), "{without}");
    let everything =
        planned.classes.iter().map(|&c| antirad_core::model::Class { blocker: true, ..c }).collect();
    let everything = Model::with_classes(&scene, everything);
    let bounces = |model: &Model| {
        let exchange = Exchange::new(model);
        let mut state = exchange.apply(&emission(model));
        for _ in 0..3 {
            state = exchange.apply(&model.leave(&state));
        }
        state.irradiance
    };
    for (a, b) in bounces(&planned).iter().zip(bounces(&everything)) {
        assert!((*a - b).length() <= 1e-12 * (1.0 + b.length()), "{a} {b}");
    }
}

#[test]
fn a_grey_scene_has_one_channel_and_the_same_answer() {
    let backend = backend();
    let mut scene = room(4, 0.5);
    scene.materials[1].albedo = [0.5; 3];
    scene.materials[2].emission = [5.0; 3];
    let (engine, grey) = solve(&backend, &scene, &tight(&scene));
    assert_eq!(engine.plan().channels(), 1);
    // Any colour takes three channels.
    scene.materials[2].emission = [5.0, 5.0, 4.999_999];
    let (engine, coloured) = solve(&backend, &scene, &tight(&scene));
    assert_eq!(engine.plan().channels(), 3);
    assert!(relative_l2(&grey.irradiance, &coloured.irradiance, &areas(&scene)) <= 1e-5);
    finish(&backend);
}

#[test]
fn no_light_is_black() {
    let backend = backend();
    let mut scene = room(3, 0.5);
    scene.materials[2].emission = [0.0; 3];
    for solver in [SolverChoice::FixedPoint, SolverChoice::Gmres] {
        let (_engine, solution) = solve(&backend, &scene, &scene.settings.solver(solver));
        assert!(solution.irradiance.iter().flatten().all(|&h| h == 0.0));
    }
    finish(&backend);
}

/// Light is linear: emission and cotangents far beyond the range of f32, or below it, scale the result and change none
/// of its digits.
#[test]
fn light_of_any_brightness() {
    let backend = backend();
    let mut scene = room(3, 0.6);
    scene.materials[0].specular = [0.05; 3];
    scene.materials[0].power = 10.0;
    let request = GradientRequest::NOTHING.emission(true).albedo(true).specular(true).positions(true);
    let plan_options = PlanOptions::of(&backend).gradients(request);
    let base = scene.materials[2].emission;
    let mut run = |brightness: f64, steepness: f64| {
        scene.materials[2].emission = base.map(|e| brightness * e);
        let (mut engine, solution) = solve_within(&backend, &scene, &scene.settings, &plan_options);
        let camera_position = DVec3::new(0.5, 0.5, 0.2);
        let ones = || vec![DVec3::splat(steepness); scene.triangles.len()];
        let cotangent = Cotangent::default()
            .irradiance(Some(ones()))
            .radiosity(Some(ones()))
            .colours(vec![(camera_position, ones())]);
        let params = SolveParams::from(&scene.settings);
        let gradients = engine.backward(&solution, &cotangent, request, &params).expect("gradients");
        let colours = engine.face_colours(&solution, camera_position).expect("colours");
        (solution.irradiance, solution.radiosity, colours, gradients)
    };
    let vectors = |values: &Option<Vec<DVec3>>| -> Vec<[f64; 3]> {
        values.iter().flatten().map(|v| v.to_array()).collect()
    };
    let (irradiance, radiosity, colours, gradients) = run(1.0, 1.0);
    for (brightness, steepness) in [(126_f64, -140_f64), (-140.0, 126.0), (0.0, -100.0)] {
        let (brightness, steepness) = (brightness.exp2(), steepness.exp2());
        let (h, b, c, g) = run(brightness, steepness);
        let light = brightness * steepness;
        for (name, of_one, here, factor) in [
            ("irradiance", &irradiance, &h, brightness),
            ("radiosity", &radiosity, &b, brightness),
            ("colours", &colours, &c, brightness),
            ("by emission", &vectors(&gradients.emission), &vectors(&g.emission), steepness),
            ("by albedo", &vectors(&gradients.albedo), &vectors(&g.albedo), light),
            ("by specular", &vectors(&gradients.specular), &vectors(&g.specular), light),
            ("by vertices", &vectors(&gradients.vertices), &vectors(&g.vertices), light),
        ] {
            assert!(of_one.iter().flatten().any(|v| *v != 0.0), "{name}");
            let expected: Vec<[f64; 3]> = of_one.iter().map(|v| v.map(|x| factor * x)).collect();
            assert!(*here == expected, "{name} at 2^{} and 2^{}", brightness.log2(), steepness.log2());
        }
    }
    finish(&backend);
}

/// The start may be a solution in other units of light.
#[test]
fn a_start_from_another_brightness_is_brought_along() {
    let backend = backend();
    let mut scene = room(3, 0.6);
    let (mut engine, first) = solve(&backend, &scene, &scene.settings);
    scene.materials[2].emission = scene.materials[2].emission.map(|e| 9.0 * e);
    engine.set_materials(&scene).expect("materials that fit the plan");
    let params = SolveParams::from(&scene.settings);
    let solution =
        engine.solve_from(Some(&first), &params, &mut |_, _| ControlFlow::Continue(())).expect("a solution");
    // Eight ninths of the light are missing at the start.
    let residual = solution.info.residuals[0];
    assert!(residual > 0.2 && residual <= 1.0, "{residual}");
    let expected: Vec<[f64; 3]> = first.irradiance.iter().map(|h| h.map(|h| 9.0 * h)).collect();
    assert!(relative_l2(&solution.irradiance, &expected, &areas(&scene)) <= 1e-3);
    finish(&backend);
}

#[test]
fn one_triangle() {
    let backend = backend();
    let lamp = Material { emission: [1.0; 3], ..Material::named("lamp") };
    let triangle = Triangle { vertices: [0, 1, 2], material: 0 };
    let scene = Scene::new("one", vec![DVec3::ZERO, DVec3::X, DVec3::Y], vec![triangle], vec![lamp])
        .map(support::implicit)
        .expect("a scene");
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    assert_eq!(solution.irradiance, [[0.0; 3]]);
    let front = engine.face_colours(&solution, DVec3::new(0.2, 0.2, 3.0)).expect("colours");
    let back = engine.face_colours(&solution, DVec3::new(0.2, 0.2, -3.0)).expect("colours");
    assert_eq!((front[0], back[0]), ([1.0; 3], [0.0; 3]));
    finish(&backend);
}

#[test]
fn too_few_passes_and_interruption_say_what_was_reached() {
    let backend = backend();
    let scene = room(3, 0.8);
    for solver in [SolverChoice::FixedPoint, SolverChoice::Gmres] {
        let settings = scene.settings.solver(solver);
        let plan = Plan::new(&scene, &PlanOptions::of(&backend), &settings).expect("a plan");
        let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
        match engine.solve(&SolveParams::default().tolerance(1e-6).max_passes(3)) {
            Err(EngineError::Solve(SolveError::NoConvergence { passes: 3, residual, residuals, .. })) => {
                assert!(residual > 1e-6 && residual < 1.0 && residuals.len() == 3);
            }
            other => panic!("{:?}", other.err()),
        }
        let mut stop =
            |passes, _| if passes < 2 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
        match engine.solve_with(&SolveParams::default().tolerance(1e-6).max_passes(100), &mut stop) {
            Err(EngineError::Solve(SolveError::Interrupted { passes: 2 })) => {}
            other => panic!("{:?}", other.err()),
        }
        // The best iterate is returned, for inspection or as a start.
        let few = SolveParams::default().tolerance(1e-5).max_passes(5);
        let stopped = engine.solve(&few).expect_err("few passes");
        let best = stopped.into_best().expect("what was reached");
        assert!(!best.info.converged && best.info.residuals.len() == 5);
        let params = few.max_passes(100);
        let full = engine.solve(&params).expect("a solution");
        let resumed = engine
            .solve_from(Some(&*best), &params, &mut |_, _| ControlFlow::Continue(()))
            .expect("a solution");
        let error = relative_l2(&best.irradiance, &full.irradiance, &areas(&scene));
        println!("{solver:?}: {error:.1e} off after 5 passes, {:?}", best.info.residuals);
        assert!(error <= 10.0 * best.info.residuals[4], "{error:e} {:?}", best.info.residuals);
        assert!(resumed.info.residuals[0] <= 2.0 * best.info.residuals[4], "{:?}", resumed.info.residuals);
        assert!(full.info.converged && resumed.info.passes < full.info.passes);
    }
    finish(&backend);
}

/// The least budget, as named by the error for a budget that is too small.
fn least_budget(scene: &Scene, settings: &SolveSettings, plan_options: &PlanOptions) -> u64 {
    match Plan::new(scene, &plan_options.memory_budget(1 << 10), settings) {
        Err(PlanError::OverBudget { needed, .. }) => needed,
        other => panic!("{:?}", other.map(|plan| plan.memory().total())),
    }
}

/// A room whose walls and box are glossy, too.
fn glossy_room(cells: u32) -> Scene {
    let mut scene = room(cells, 0.3);
    for material in &mut scene.materials[..2] {
        material.specular = [0.05, 0.04, 0.03];
        material.power = 20.0;
    }
    scene
}

/// A backend of a kind with this budget.
fn within_budget(kind: BackendKind, budget: u64) -> Backend {
    let options = DeviceOptions::default().validation(true).memory_budget(Some(budget));
    match kind {
        BackendKind::Vulkan => Device::new(&options).expect("a Vulkan device").into(),
        BackendKind::Cpu => Backend::Cpu(Cpu::new(&CpuOptions::default().memory_budget(Some(budget)))),
    }
}

/// Solves on a backend with this budget, and compares allocated with planned bytes.
fn solve_with_budget(
    scene: &Scene,
    settings: &SolveSettings,
    plan_options: &PlanOptions,
    budget: u64,
) -> (Engine, antirad::Solution) {
    let backend = within_budget(plan_options.backend, budget);
    let (mut engine, solution) = solve_within(&backend, scene, settings, &plan_options.memory_budget(budget));
    engine.face_colours(&solution, DVec3::new(0.5, 0.5, 0.2)).expect("colours");
    let memory = backend.memory();
    assert!(memory.peak <= budget, "{} of {budget}", memory.peak);
    assert_eq!(memory.in_use, engine.plan().memory().total());
    finish(&backend);
    (engine, solution)
}

/// Staging buffers are no larger than the largest buffer of a device, or of the options, and are counted so.
#[test]
fn staging_beyond_the_largest_buffer_is_cut() {
    let scene = room(2, 0.5);
    let options = PlanOptions::of(device());
    for largest in [options.max_buffer, 1 << 20] {
        let options = options.max_buffer(largest).staging(u64::MAX);
        let (engine, _solution) =
            solve_with_budget(&scene, &tight(&scene), &options, 2 * largest + (64 << 20));
        assert_eq!(engine.plan().staging(), 2 * largest);
    }
}

#[test]
fn the_least_budget_does_and_a_byte_less_does_not() {
    let device = device();
    for scene in [room(4, 0.5), glossy_room(3)] {
        // The near field is kept on the device only, with other rounding, and rays to lamps take memory of it.
        let plan_options = PlanOptions::of(&device).keep_near_field(false).trace_lamps(false);
        let settings = tight(&scene);
        let needed = least_budget(&scene, &settings, &plan_options);
        let less = plan_options.memory_budget(needed - 1);
        let refused = Plan::new(&scene, &less, &settings).map(|plan| plan.memory().total());
        let (budget, least) = (needed - 1, needed);
        let named = matches!(refused, Err(PlanError::OverBudget { budget: b, needed: n }) if (b, n) == (budget, least));
        assert!(named, "{refused:?}");
        let (_engine, truth) = solve_within(&device, &scene, &settings, &plan_options);
        let (engine, other) = solve_with_budget(&scene, &settings, &plan_options, needed);
        assert_eq!(engine.plan().residency(), Residency::Host { receivers: 1, sources: 1 });
        assert_eq!(engine.plan().memory().total(), needed);
        let error = relative_l2(&other.irradiance, &truth.irradiance, &areas(&scene));
        let error_b = relative_l2(&other.radiosity, &truth.radiosity, &areas(&scene));
        println!("{needed} bytes: {error:.2e}, radiosity {error_b:.2e}");
        assert!(error <= 1e-6 && error_b <= 1e-6, "{error:e} {error_b:e}");
    }
    finish(&device);
}

#[test]
fn states_on_the_host_change_nothing() {
    on_the_host_nothing_changes([
        ("diffuse", room(6, 0.5), SolverChoice::FixedPoint, Precision::F32),
        ("glossy", glossy_room(3), SolverChoice::Auto, Precision::F64),
    ]);
}

#[test]
#[ignore = "takes long: other solvers and precisions"]
fn states_on_the_host_change_nothing_otherwise() {
    on_the_host_nothing_changes([
        ("diffuse", room(6, 0.5), SolverChoice::Auto, Precision::F32),
        ("glossy", glossy_room(4), SolverChoice::Auto, Precision::F32),
    ]);
}

/// From the least budget to the first that keeps states on the device: each is kept, and results agree.
fn on_the_host_nothing_changes(cases: [(&str, Scene, SolverChoice, Precision); 2]) {
    let device = device();
    for (name, scene, solver, precision) in cases {
        let settings = tight(&scene).solver(solver).precision(precision);
        // The near field is kept on the device only, with other rounding, and rays to lamps take memory of it.
        let plan_options = PlanOptions::of(&device).keep_near_field(false).trace_lamps(false);
        let (engine, truth) = solve_within(&device, &scene, &settings, &plan_options);
        assert_eq!(engine.plan().residency(), Residency::Device);
        let solver_of_plenty = engine.plan().solver();
        let needed = least_budget(&scene, &settings, &plan_options);
        let mut before = u64::MAX;
        for percent in [105, 250] {
            let budget = needed * percent / 100;
            let (engine, other) = solve_with_budget(&scene, &settings, &plan_options, budget);
            let plan = engine.plan();
            let error = relative_l2(&other.irradiance, &truth.irradiance, &areas(&scene));
            println!(
                "{name}, {solver:?}, {precision:?}, {budget} bytes: {error:.2e}, {:?}",
                plan.report().states
            );
            assert!(matches!(plan.residency(), Residency::Host { .. }));
            assert_eq!(plan.solver(), solver_of_plenty);
            assert!(error <= 1e-6, "{name}: {error:e}");
            assert!(plan.moved_bytes() <= before, "more memory, more moves");
            before = plan.moved_bytes();
        }
    }
    finish(&device);
}

/// With pages of the same size on either side, not a bit depends on where they are.
#[test]
fn pages_of_the_same_size_give_the_same_bytes_wherever_they_are() {
    let device = device();
    for (solver, precision) in
        [(SolverChoice::FixedPoint, Precision::F32), (SolverChoice::Gmres, Precision::F32)]
    {
        let scene = glossy_room(4);
        let settings = scene.settings.solver(solver).precision(precision);
        // The near field is kept on the device only, and rays to lamps take memory of it.
        let plan_options = PlanOptions::of(&device).page(1).keep_near_field(false).trace_lamps(false);
        let (resident, truth) = solve_within(&device, &scene, &settings, &plan_options);
        let budget = least_budget(&scene, &settings, &plan_options) + (1 << 20);
        let (hosted, other) = solve_with_budget(&scene, &settings, &plan_options, budget);
        assert_eq!(resident.plan().residency(), Residency::Device);
        assert_eq!(hosted.plan().residency(), Residency::Host { receivers: 1, sources: 1 });
        assert!(hosted.plan().layout().groups.len() > 3);
        assert_eq!(resident.plan().layout().groups, hosted.plan().layout().groups);
        let [a, b] = [&truth, &other].map(|s| [&s.irradiance[..], &s.radiosity[..]].concat());
        assert!(same(&device, a.as_flattened(), b.as_flattened()));
        assert_eq!(truth.info.passes, other.info.passes);
    }
    finish(&device);
}

/// The near field as a matrix: the same answer, with all memory that was planned and no more; where the budget leaves
/// no room for it, the vectors of the solver come first.
#[test]
fn the_near_field_is_kept_where_the_budget_allows() {
    let scenes = [room(4, 0.5), glossy_room(3)];
    let backends = [Backend::cpu(), device().into()];
    for (backend, scene) in backends.iter().flat_map(|of| scenes.iter().map(move |scene| (of, scene))) {
        let settings = tight(scene);
        let usual = PlanOptions::of(backend).fast_near_field(false);
        let (kept, truth) = solve_within(backend, scene, &settings, &usual);
        let (evaluated, other) = solve_within(backend, scene, &settings, &usual.keep_near_field(false));
        // Far pairs, which the CPU keeps, too, where there is much room, take no part in this.
        let [with, without] = [&kept, &evaluated].map(|engine| {
            let memory = engine.plan().memory();
            memory.total() - memory.of_label("far pairs")
        });
        assert!(kept.plan().near_field_matrix().is_some() && evaluated.plan().near_field_matrix().is_none());
        assert!(with > without);
        let error = relative_l2(&other.irradiance, &truth.irradiance, &areas(scene));
        println!("{backend:?}, {}: {with} instead of {without} bytes, {error:.2e}", kept.plan().near_field());
        assert!(error <= 2e-6, "{error:e}");
        drop((kept, truth, evaluated, other));
        for budget in [without, with - 1, with] {
            let (engine, solution) = solve_with_budget(scene, &settings, &usual, budget);
            let plan = engine.plan();
            println!("{budget} bytes: {}", plan.near_field());
            assert_eq!(plan.solver(), Plan::new(scene, &usual, &settings).expect("a plan").solver());
            assert_eq!(plan.near_field_matrix().is_some(), budget == with);
            drop(solution);
        }
    }
    backends.iter().for_each(finish);
}

/// Interpenetrating triangles create light: the fixed point diverges; GMRES fails, too, or reports a
/// spectral radius of at least 1.
#[test]
fn unphysical_soup_is_not_passed_over_in_silence() {
    let backend = backend();
    let mut state = 1u64;
    let mut random = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    let mut point = || DVec3::new(random(), random(), random());
    let vertices: Vec<DVec3> = (0..300).flat_map(|_| [point(), point(), point()]).collect();
    let triangles =
        (0..300).map(|k| Triangle { vertices: [3 * k, 3 * k + 1, 3 * k + 2], material: 0 }).collect();
    let soup = Material { albedo: [0.9; 3], emission: [1.0; 3], ..Material::named("soup") };
    let scene = Scene::new("soup", vertices, triangles, vec![soup]).map(support::implicit).expect("a scene");
    let run = |solver| {
        // Without the near field, which would stabilise this soup.
        let settings = scene.settings.solver(solver).near_field(0.0).max_passes(60);
        let settings = settings.visibility(VisibilityChoice::Implicit);
        let plan = Plan::new(&scene, &PlanOptions::of(&backend), &settings).expect("a plan");
        let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
        engine.solve(&SolveParams::from(&settings)).map(|solution| solution.info)
    };
    let fixed_point = run(SolverChoice::FixedPoint);
    println!("fixed point: {fixed_point:?}");
    assert!(matches!(fixed_point, Err(EngineError::Solve(SolveError::Diverged { .. }))));
    let gmres = run(SolverChoice::Gmres);
    println!("GMRES: {gmres:?}");
    match gmres {
        Ok(info) => assert!(info.spectral_radius.is_some_and(|r| r >= 1.0), "{info:?}"),
        Err(EngineError::Solve(SolveError::Diverged { .. } | SolveError::NoConvergence { .. })) => {}
        Err(other) => panic!("{other}"),
    }
    finish(&backend);
}

/// Every scene of the project solves, with finite light everywhere.
#[test]
fn shipped_scenes_solve() {
    let backend = backend();
    for name in ["closed_box", "integrating_sphere", "two_rooms", "glossy_floor"] {
        let scene = load(&format!("scenes/{name}.toml"));
        let (engine, solution) = solve(&backend, &scene, &scene.settings);
        // The sphere is lit alike everywhere and takes fewer.
        let [least, most] = engine.plan().report().estimated_passes;
        let passes = f64::from(solution.info.passes);
        assert!(passes <= most && (passes >= least || name == "integrating_sphere"), "{least} to {most}");
        let share: Vec<f64> =
            (0..3).map(|c| solution.energy.absorbed[c] / solution.energy.emitted[c]).collect();
        println!("{name}: {} passes, absorbed {share:.4?}, {:?}", solution.info.passes, solution.negative);
        assert!(solution.irradiance.iter().flatten().all(|h| h.is_finite()));
        assert!(share.iter().all(|&s| s > 0.0 && s <= 1.05), "{name}: {share:?}");
    }
    finish(&backend);
}

/// Four engines at once on one backend, each in a thread of its own, with staging buffers of different sizes: each
/// counts only its own memory, and finds what it finds alone.
#[test]
fn engines_in_threads_find_what_they_find_alone() {
    for backend in [Backend::cpu(), device().into()] {
        let usual = PlanOptions::of(&backend);
        let request = GradientRequest::NOTHING.albedo(true).positions(true);
        let (plain, glossy) = (room(3, 0.5), glossy_room(3));
        let least = least_budget(&glossy, &glossy.settings, &usual);
        let jobs = [
            (&plain, plain.settings, usual.gradients(request)),
            (&glossy, glossy.settings, usual.staging(1 << 20)),
            (&glossy, glossy.settings, usual.memory_budget(least + (1 << 16))),
            (&plain, plain.settings.precision(Precision::F64), usual),
        ];
        let run = |(scene, settings, plan_options): &(&Scene, SolveSettings, PlanOptions)| {
            let (mut engine, solution) = solve_within(&backend, scene, settings, plan_options);
            let colours = engine.face_colours(&solution, DVec3::new(0.5, 0.5, 0.2)).expect("colours");
            let gradients = plan_options.gradients.any().then(|| {
                let ones = vec![DVec3::ONE; scene.triangles.len()];
                let cotangent = Cotangent::default().irradiance(Some(ones));
                let params = SolveParams::from(settings);
                let found = engine.backward(&solution, &cotangent, request, &params).expect("gradients");
                (found.albedo, found.vertices)
            });
            (
                solution.irradiance.clone(),
                solution.radiosity.clone(),
                solution.info.clone(),
                colours,
                gradients,
            )
        };
        let alone: Vec<_> = jobs.iter().map(run).collect();
        assert_eq!(backend.memory().in_use, 0);
        let start = Barrier::new(jobs.len());
        std::thread::scope(|scope| {
            for (job, alone) in jobs.iter().zip(&alone) {
                let (run, start) = (&run, &start);
                scope.spawn(move || {
                    for round in 0..2 {
                        start.wait();
                        assert!(run(job) == *alone, "{:?}, round {round}", job.2);
                    }
                });
            }
        });
        assert_eq!(backend.memory().in_use, 0);
        finish(&backend);
    }
}

/// The budget of a plan excludes what others have allocated.
#[test]
fn plan_options_exclude_what_others_use() {
    let budget = 64 << 20;
    for kind in [BackendKind::Cpu, BackendKind::Vulkan] {
        let backend = within_budget(kind, budget);
        let scene = room(4, 0.5);
        // Rays to lamps would take memory only where there is much.
        let settings = scene.settings.lamps(Lamps::Exact);
        assert_eq!(PlanOptions::of(&backend).memory_budget, budget);
        let (first, solution) = solve(&backend, &scene, &settings);
        assert_eq!(PlanOptions::of(&backend).memory_budget, budget - first.plan().memory().total());
        let take = |bytes| -> Box<dyn Any> {
            match &backend {
                Backend::Vulkan(device) => {
                    Box::new(Buffer::new(device, "another's", bytes, BufferKind::Storage).expect("a buffer"))
                }
                Backend::Cpu(cpu) => Box::new(cpu.lease("another's", bytes).expect("room")),
            }
        };
        let rest = PlanOptions::of(&backend).memory_budget;
        let taken = take(rest - (4 << 20));
        let (second, other) = solve(&backend, &scene, &settings);
        assert_eq!(second.plan().options().memory_budget, 4 << 20);
        assert!(second.plan().memory().total() <= 4 << 20);
        assert!(relative_l2(&other.irradiance, &solution.irradiance, &areas(&scene)) <= 1e-4);
        drop(taken);
        // Without memory left the budget is zero, not a number that has wrapped around.
        let _all = take(PlanOptions::of(&backend).memory_budget);
        assert_eq!(PlanOptions::of(&backend).memory_budget, 0);
        finish(&backend);
    }
}

/// One plan serves all powers: the most frequent have matrices as far as they are planned, others do without.
#[test]
fn powers_beyond_the_plan_change_nothing_but_rounding() {
    for backend in [Backend::cpu(), device().into()] {
        let scene = glossy_room(3);
        let settings = tight(&scene);
        let matrices = |options: &PlanOptions| {
            let lobes = Plan::new(&scene, options, &settings).expect("a plan").report().lobes;
            assert_eq!(lobes.shared == 0, lobes.matrices == 0);
            (lobes.matrices, lobes.shared + lobes.direct)
        };
        let usual = PlanOptions::of(&backend);
        let (one, glossy) = matrices(&usual);
        assert_eq!(one, 1);
        // Each of the two materials may get a power of its own.
        assert_eq!(matrices(&usual.gradients(GradientRequest::NOTHING.power(true))), (2, glossy));
        let least = least_budget(&scene, &settings, &usual);
        assert_eq!(matrices(&usual.memory_budget(least)), (0, glossy));
        assert_eq!(matrices(&usual.memory_budget(least + (1 << 20))), (1, glossy));

        let mut other = scene.clone();
        other.materials[1].power = 50.0;
        let params = SolveParams::from(&settings);
        let (mut engine, before) = solve_within(&backend, &scene, &settings, &usual);
        engine.set_materials(&other).expect("materials that fit the plan");
        let beyond = engine.solve(&params).expect("a solution");
        let (fresh, expected) = solve_within(&backend, &other, &settings, &usual);
        assert_eq!(fresh.plan().report().lobes.matrices, 2);
        let error = relative_l2(&beyond.irradiance, &expected.irradiance, &areas(&scene));
        println!("beyond the plan: {error:.2e}");
        assert!(error <= 1e-6, "{error:e}");
        let change = relative_l2(&beyond.irradiance, &before.irradiance, &areas(&scene));
        assert!(change >= 1e-5, "the power matters: {change:e}");
        engine.set_materials(&scene).expect("materials that fit the plan");
        assert_eq!(engine.solve(&params).expect("a solution").irradiance, before.irradiance);
        finish(&backend);
    }
}

#[test]
fn new_materials_and_a_rebuilt_engine_give_what_a_new_engine_gives() {
    let backend = backend();
    let first = room(3, 0.4);
    let mut second = room(3, 0.6);
    let (mut engine, before) = solve(&backend, &first, &first.settings);
    let (_fresh, expected) = solve(&backend, &second, &second.settings);
    let params = SolveParams::from(&second.settings);
    engine.set_materials(&second).expect("materials that fit the plan");
    assert_eq!(engine.solve(&params).expect("a solution").irradiance, expected.irradiance);
    engine.set_materials(&first).expect("materials that fit the plan");
    assert_eq!(engine.solve(&params).expect("a solution").irradiance, before.irradiance);
    drop((before, expected));

    second.materials[0].specular = [0.1; 3];
    second.materials[0].power = 10.0;
    let refused = engine.set_materials(&second).expect_err("a lobe beyond the plan").to_string();
    assert!(refused.contains("specular lobe") && refused.contains("rebuilt"), "{refused}");
    let mut engine = engine.rebuilt(&second).expect("an engine");
    let glossy = engine.solve(&params).expect("a solution");
    let (_fresh, expected) = solve(&backend, &second, &second.settings);
    assert_eq!(glossy.irradiance, expected.irradiance);
    finish(&backend);
}
