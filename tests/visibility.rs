//! Explicit visibility: against closed forms, path tracing and implicit visibility, where it is chosen, and its derivatives.

mod support;

use antirad::path_tracer::PathTracer;
use antirad::plan::{GradientRequest, Plan, PlanError, PlanOptions};
use antirad::resolve::{ResolveOptions, resolve};
use antirad::scene::{
    Lamps, Material, Precision, Scene, SceneBuilder, Shape, SolveSettings, VisibilityChoice,
};
use antirad::{Cotangent, Engine, SolveParams};
use glam::{DAffine3, DQuat, DVec3};
use support::random::{Random, scattered};
use support::{areas, backend, finish, implementations, load, mean, placed, read_npy, relative_l2, solve};

fn explicit(scene: &Scene) -> SolveSettings {
    scene.settings.visibility(VisibilityChoice::Explicit)
}

fn plan(scene: &Scene, settings: &SolveSettings, gradients: GradientRequest) -> Result<Plan, PlanError> {
    Plan::new(scene, &PlanOptions::default().gradients(gradients), settings)
}

/// A room of 2 m with a lamp under its ceiling.
fn room() -> SceneBuilder {
    room_of(0.6, 1.95)
}

/// The same with walls of some albedo, and the lamp at some height.
fn room_of(albedo: f64, lamp_at: f64) -> SceneBuilder {
    let wall = Material { albedo: [albedo; 3], ..Material::named("wall") };
    let lamp = Material { emission: [10.0; 3], albedo: [0.0; 3], ..Material::named("lamp") };
    let down = DAffine3::from_rotation_x(std::f64::consts::PI);
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells: 6 }, &wall, placed([2.0; 3], [0.0; 3]));
    builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, placed([0.5; 3], [0.75, lamp_at, 1.25]) * down);
    builder
}

/// Leaves with two sides, as close to each other as they are large.
fn plant(leaves: u32) -> Scene {
    let green = Material { albedo: [0.1, 0.4, 0.1], ..Material::named("leaf") };
    let mut random = Random::new(7);
    let mut builder = room();
    for _ in 0..leaves {
        let at = DVec3::new(0.6, 0.3, 0.6) + 0.8 * random.point();
        let turned = DQuat::from_axis_angle((random.point() - 0.5).normalize(), 6.0 * random.next());
        let over = DQuat::from_rotation_x(std::f64::consts::PI);
        for side in [turned, turned * over] {
            let size = DVec3::new(0.1, 1.0, 0.06);
            let place = DAffine3::from_scale_rotation_translation(size, side, at);
            let centred = place * DAffine3::from_translation(DVec3::new(-0.5, 0.0, -0.5));
            builder.shape("leaf", Shape::Quad { cells: 1 }, &green, centred);
        }
    }
    builder.finish("plant").expect("a scene")
}

/// Cubes with gaps of a hundredth of their size.
fn pile() -> Scene {
    let wood = Material { albedo: [0.6, 0.45, 0.3], ..Material::named("wood") };
    let mut builder = room();
    for k in 0..27 {
        let [x, y, z] = [k % 3, k / 3 % 3, k / 9].map(|at| 0.303 * f64::from(at));
        let at = DAffine3::from_translation(DVec3::new(x + 0.55, y + 0.003, z + 0.55));
        builder.shape("cube", Shape::Box { cells: 2 }, &wood, at * DAffine3::from_scale(DVec3::splat(0.3)));
    }
    builder.finish("pile").expect("a scene")
}

/// Irradiance of every so many triangles against path tracing: of the mean, and the relative L2 norm without the noise of the truth.
fn errors(scene: &Scene, irradiance: &[[f64; 3]], step: usize) -> [f64; 2] {
    let (tracer, areas) = (PathTracer::new(scene), areas(scene));
    let [mut own, mut true_ones, mut squares, mut all] = [0.0; 4];
    for i in (0..areas.len()).step_by(step) {
        let estimate = tracer.irradiance_of(i, 512);
        let (h, noise) = (DVec3::from(irradiance[i]), estimate.error.length_squared());
        own += areas[i] * h.element_sum();
        true_ones += areas[i] * estimate.mean.element_sum();
        squares += areas[i] * ((h - estimate.mean).length_squared() - noise);
        all += areas[i] * estimate.mean.length_squared();
    }
    [own / true_ones - 1.0, (squares / all).max(0.0).sqrt()]
}

/// By default what stalls antiradiance converges as in an empty room, and is right.
#[test]
fn dense_blockers_converge_and_are_right() {
    let backend = backend();
    for (scene, bounds) in [(plant(400), [0.01, 0.04]), (pile(), [0.01, 0.04])] {
        let (engine, solution) = solve(&backend, &scene, &scene.settings);
        let report = engine.plan().report().transport;
        assert!(report.contains("explicit visibility"), "{}: {report}", scene.name);
        let [of_mean, l2] = errors(&scene, &solution.irradiance, 7);
        println!("{}: mean {of_mean:+.4}, L2 {l2:.4}, {} passes", scene.name, solution.info.passes);
        assert!(solution.info.passes <= 12, "{}: {} passes", scene.name, solution.info.passes);
        assert!(of_mean.abs() <= bounds[0] && l2 <= bounds[1], "{}: {of_mean}, {l2}", scene.name);
        assert!(solution.irradiance.iter().flatten().all(|&h| h >= 0.0));
    }
    finish(&backend);
}

/// Rods as high as the room is wide, of two triangles a side: what light there is falls off along them.
fn rods() -> Scene {
    let wood = Material { albedo: [0.6, 0.45, 0.3], ..Material::named("wood") };
    let mut builder = room();
    for k in 0..49 {
        let [x, z] = [k % 7, k / 7].map(|at| 0.4 + 0.18 * f64::from(at));
        let at = DAffine3::from_translation(DVec3::new(x, 0.0, z));
        builder.shape("rod", Shape::Box { cells: 1 }, &wood, at * placed([0.05, 1.3, 0.05], [0.0; 3]));
    }
    builder.finish("rods").expect("a scene")
}

/// Rods of long triangles are too dark where the room sees them, unless these are cut.
#[test]
fn long_triangles_among_dense_blockers_are_cut() {
    let backend = backend();
    let given = rods();
    let resolved = resolve(&given, &ResolveOptions::default()).expect("a scene");
    let (scene, parents) = (resolved.scene, resolved.cut.parents().collect::<Vec<u32>>());
    let of_rods = given.meshes.iter().find(|mesh| mesh.name == "rod").expect("a rod").range.clone();
    assert!(of_rods.filter(|t| parents.iter().filter(|p| *p == t).count() > 2).count() >= 4, "a rod is cut");
    let found = [&given, &scene].map(|scene| {
        let (_, solution) = solve(&backend, scene, &scene.settings);
        let means = errors(scene, &solution.irradiance, 11);
        println!("{} triangles: mean {:+.4}, L2 {:.4}", scene.triangles.len(), means[0], means[1]);
        means
    });
    assert!(found[1][0].abs() <= 0.01 && found[1][1] <= 0.7 * found[0][1], "{found:?}");
    finish(&backend);
}

/// In a closed sphere every triangle sees nothing but fronts, so that no light is lost, whatever rays meet.
#[test]
fn a_closed_sphere_loses_nothing() {
    let backend = backend();
    let scene = load("tests/data/sphere_l3_r80.obj");
    let (_, solution) = solve(&backend, &scene, &explicit(&scene));
    let radiosity = mean(&solution.radiosity, &areas(&scene), |_| true);
    assert!((radiosity / 5.0 - 1.0).abs() <= 0.002, "{radiosity}");
    finish(&backend);
}

#[test]
fn both_ways_agree_where_both_are_right() {
    let backend = backend();
    let scene = load("scenes/cornell_boxes.toml");
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let (_, solution) = solve(&backend, &scene, &explicit(&scene));
    // Half of it is under a box.
    let [own, path_traced] = [solution.irradiance[237][0], truth[237][0]];
    assert!((own / path_traced - 1.0).abs() <= 0.2, "{own} in place of {path_traced}");
    let error = relative_l2(&solution.irradiance, &truth, &areas(&scene));
    println!("cornell_boxes: relative L2 {:.3} %", 100.0 * error);
    assert!(error <= 0.01, "{error}");
    // Two rooms, one lit by the other; a floor that is glossy.
    for (name, bound) in [("two_rooms", 0.02), ("glossy_floor", 0.02)] {
        let scene = load(&format!("scenes/{name}.toml"));
        let (_, implicit) = solve(&backend, &scene, &scene.settings.visibility(VisibilityChoice::Implicit));
        let (_, own) = solve(&backend, &scene, &explicit(&scene));
        let difference = relative_l2(&own.irradiance, &implicit.irradiance, &areas(&scene));
        println!("{name}: {:.3} %", 100.0 * difference);
        assert!(difference <= bound, "{name}: {difference}");
    }
    finish(&backend);
}

/// Light on a back stays there, as in pictures and in the shadows of lamps.
#[test]
fn backs_are_opaque() {
    let black = Material { albedo: [0.0; 3], ..Material::named("black") };
    let mut builder = room();
    // Cuts the room in two; its back is below.
    builder.shape("sheet", Shape::Quad { cells: 1 }, &black, placed([2.0; 3], [0.0, 1.0, 0.0]));
    let mut scene = builder.finish("sheet").expect("a scene");
    scene.materials.iter_mut().for_each(|material| material.emission = [0.0; 3]);
    scene.materials.push(Material { emission: [1.0; 3], ..Material::named("glow") });
    let on_floor = |i: &usize| scene.corners(*i).iter().all(|corner| corner.y < 0.01);
    let floor = (0..scene.triangles.len()).find(on_floor).expect("a floor");
    scene.triangles[floor].material = scene.materials.len() as u32 - 1;
    let backend = backend();
    let (_, solution) = solve(&backend, &scene, &explicit(&scene).lamps(Lamps::Antiradiance));
    let above = |i: usize| scene.corners(i).iter().all(|corner| corner.y > 0.99);
    let (above, below) = (
        mean(&solution.irradiance, &areas(&scene), above),
        mean(&solution.irradiance, &areas(&scene), |i| !above(i)),
    );
    assert!(below > 0.0 && above == 0.0, "{above} above, {below} below");
    finish(&backend);
}

/// Light falls on the back of a lamp that hangs below a white ceiling, and antiradiance lets it pass. Rays do not.
#[test]
fn backs_that_matter_are_opaque() {
    let backend = backend();
    let scene = room_of(0.9, 1.85).finish("white room").expect("a scene");
    let mean = |visibility: VisibilityChoice| {
        let (_, solution) = solve(&backend, &scene, &scene.settings.visibility(visibility));
        errors(&scene, &solution.irradiance, 3)[0]
    };
    let [own, implicit] = [VisibilityChoice::Explicit, VisibilityChoice::Implicit].map(mean);
    println!("white room: mean {own:+.4}, by antiradiance {implicit:+.4}");
    assert!(own.abs() <= 0.006 && implicit >= 0.01, "{own}, by antiradiance {implicit}");
    finish(&backend);
}

/// The room is closed: what fronts do not absorb falls on the back of the lamp, and nothing escapes.
#[test]
fn light_on_backs_has_not_escaped() {
    let backend = backend();
    let scene = room_of(0.9, 1.85).finish("white room").expect("a scene");
    let (_, solution) = solve(&backend, &scene, &explicit(&scene));
    let energy = solution.energy;
    let emitted = energy.emitted[0];
    let on_backs = energy.on_backs.expect("rays")[0] / emitted;
    let [absorbed, escaped, unaccounted] =
        [energy.absorbed, energy.escaped, energy.unaccounted].map(|watts| watts[0] / emitted);
    println!("{absorbed} absorbed, {on_backs} on backs, {escaped} escaped, {unaccounted:+} unaccounted for");
    assert!((absorbed + on_backs + escaped + unaccounted - 1.0).abs() <= 1e-9);
    assert!(escaped.abs() <= 1e-4 && unaccounted.abs() <= 0.01, "{escaped}, {unaccounted}");
    assert!((0.01..0.2).contains(&on_backs), "{on_backs}");
    let implicit = scene.settings.visibility(VisibilityChoice::Implicit);
    let (_, solution) = solve(&backend, &scene, &implicit);
    assert!(solution.energy.on_backs.is_none() && solution.energy.unaccounted == [0.0; 3]);
    finish(&backend);
}

/// A sheet that lies on half of a board does not change the light of the other half, so that the board receives half, straight from a lamp and by
/// rays.
#[test]
fn covered_parts_do_not_darken_the_others() {
    let backend = backend();
    let board = |covered: bool| {
        let [white, black] =
            [0.8, 0.0].map(|albedo| Material { albedo: [albedo; 3], ..Material::named(format!("{albedo}")) });
        let mut builder = room();
        builder.shape("board", Shape::Quad { cells: 1 }, &white, placed([1.0; 3], [0.5, 0.5, 0.5]));
        if covered {
            let place = placed([0.5, 0.002, 1.0], [0.5, 0.501, 0.5]);
            builder.shape("sheet", Shape::Box { cells: 1 }, &black, place);
        }
        builder.finish("board").expect("a scene")
    };
    for lamps in [Lamps::Exact, Lamps::Antiradiance] {
        let [open, covered] = [false, true].map(|covered| {
            let scene = board(covered);
            let (_, solution) = solve(&backend, &scene, &explicit(&scene).lamps(lamps));
            let of_board = |i: &usize| scene.corners(*i).iter().all(|corner| (corner.y - 0.5).abs() < 1e-6);
            (0..scene.triangles.len()).filter(of_board).map(|i| solution.irradiance[i][0]).collect::<Vec<_>>()
        });
        assert_eq!((open.len(), covered.len()), (2, 2));
        let [open, covered]: [f64; 2] = [open, covered].map(|of| of.iter().sum());
        println!("{lamps:?}: {open} W/m², {covered} W/m² half covered");
        assert!((covered / open - 0.5).abs() <= 0.06, "{covered}, {open} without the sheet");
    }
    finish(&backend);
}

#[test]
fn implementations_agree_and_the_same_input_gives_the_same_bytes() {
    let scene = plant(60);
    let [cpu, kernels, of_gpus] = implementations().map(|(_, backend)| {
        let (_, solution) = solve(&backend, &scene, &explicit(&scene).lamps(Lamps::Exact).tolerance(1e-6));
        finish(backend);
        solution.irradiance
    });
    let (_, again) = solve(
        antirad::backend::Backend::cpu(),
        &scene,
        &explicit(&scene).lamps(Lamps::Exact).tolerance(1e-6),
    );
    assert_eq!(cpu, again.irradiance);
    for other in [kernels, of_gpus] {
        let difference = relative_l2(&other, &cpu, &areas(&scene));
        assert!(difference <= 1e-4, "{difference}");
    }
}

/// A change of a material.
type Step = fn(&mut Material, f64);

/// By emission, albedo and specular constants, beside central differences, in f64. U is linear, so they are exact.
#[test]
fn derivatives_by_materials() {
    let scenes = [plant(30), scattered(3, 50, true, false, 0.8)];
    let request = GradientRequest::default().emission(true).albedo(true).specular(true);
    for (scene, backend) in scenes.iter().flat_map(|s| implementations().map(move |(_, b)| (s, b))) {
        let settings = explicit(scene).precision(Precision::F64).tolerance(1e-12).lamps(Lamps::Exact);
        let settings = settings.bins("4x6".parse().expect("bins"));
        let options = PlanOptions::of(&backend).gradients(request);
        let plan = Plan::new(scene, &options, &settings).expect("a plan");
        let mut engine = Engine::new(&backend, scene, plan).expect("an engine");
        let params = SolveParams::from(&settings);
        let mut random = Random::new(5);
        let weights: Vec<DVec3> = scene.triangles.iter().map(|_| random.point() - 0.3).collect();
        let mut loss = |scene: &Scene| -> f64 {
            engine.set_materials(scene).expect("materials");
            let solution = engine.solve(&params).expect("a solution");
            solution.radiosity.iter().zip(&weights).map(|(b, w)| w.dot(DVec3::from(*b))).sum()
        };
        let steps: [(&str, Step); 3] = [
            ("emission", |m, by| m.emission[1] += by),
            ("albedo", |m, by| m.albedo[1] += by),
            ("specular", |m, by| m.specular[1] += by),
        ];
        let which = |name: &str| {
            let of = |m: &Material| match name {
                "emission" => m.emission[1],
                "albedo" => m.albedo[1],
                _ => m.specular[1],
            };
            scene.materials.iter().position(|m| of(m) > 0.0)
        };
        let differences = steps.map(|(name, step)| {
            which(name).map(|material| {
                let moved = |by: f64| {
                    let mut scene = scene.clone();
                    step(&mut scene.materials[material], by);
                    scene
                };
                let h = 1e-5;
                (name, material, (loss(&moved(h)) - loss(&moved(-h))) / (2.0 * h))
            })
        });
        loss(scene);
        let solution = engine.solve(&params).expect("a solution");
        let cotangent = Cotangent::default().radiosity(Some(weights.clone()));
        let gradients = engine.backward(&solution, &cotangent, request, &params).expect("gradients");
        for (name, material, difference) in differences.into_iter().flatten() {
            let by_triangle = match name {
                "emission" => &gradients.emission,
                "albedo" => &gradients.albedo,
                _ => &gradients.specular,
            };
            let of_material = |i: &usize| scene.triangles[*i].material as usize == material;
            let own: f64 = (0..scene.triangles.len())
                .filter(of_material)
                .map(|i| by_triangle.as_ref().expect("derivatives")[i][1])
                .sum();
            println!("{} on {}, {name}: {own}, difference {difference}", scene.name, backend.kind());
            assert!(
                (own - difference).abs() <= 1e-6 * difference.abs().max(1e-3),
                "{name}: {own}, {difference}"
            );
        }
        finish(backend);
    }
}

#[test]
fn positions_have_implicit_visibility_alone() {
    let scene = plant(60);
    let positions = GradientRequest::default().positions(true);
    let refused = plan(&scene, &explicit(&scene), positions).expect_err("no derivatives");
    assert!(matches!(refused, PlanError::ExplicitVisibility), "{refused}");
    assert!(refused.to_string().contains("visibility = \"implicit\""), "{refused}");
    let implicit = scene.settings.visibility(VisibilityChoice::Implicit);
    assert!(!plan(&scene, &implicit, positions).expect("a plan").transport().is_explicit());
}

/// The same rows on any number of threads, for any derivatives, and after a change of materials.
#[test]
fn rows_depend_on_the_scene_alone() {
    let scene = plant(60);
    let settings = explicit(&scene);
    let on = |threads: usize, request: GradientRequest| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
        pool.install(|| {
            let backend = antirad::backend::Backend::cpu();
            let plan = plan(&scene, &settings, request).expect("a plan");
            let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
            let first = engine.solve(&SolveParams::from(&settings)).expect("a solution");
            let mut darker = scene.clone();
            darker.materials.iter_mut().for_each(|material| material.albedo = [0.2; 3]);
            engine.set_materials(&darker).expect("materials");
            engine.set_materials(&scene).expect("materials");
            let again = engine.solve(&SolveParams::from(&settings)).expect("a solution");
            assert_eq!(first.irradiance, again.irradiance);
            (first.irradiance, engine.ray_error().cloned())
        })
    };
    let one = on(1, GradientRequest::default());
    assert!(one == on(3, GradientRequest::default()), "on three threads");
    let (_, error) = on(2, GradientRequest::default().albedo(true));
    assert_eq!(error, one.1);
}

/// What the engine says of the error of its rays is what it is, beside many more rays.
#[test]
fn rays_know_their_error() {
    for scene in [load("scenes/cornell_boxes.toml"), plant(60), pile()] {
        let solved = |error: f64| {
            let settings = explicit(&scene).ray_error(error);
            let backend = antirad::backend::Backend::cpu();
            let (engine, solution) = solve(&backend, &scene, &settings.lamps(Lamps::Exact));
            (engine.ray_error().cloned().expect("rays"), solution.irradiance)
        };
        let ((error, some), (least, many)) = (solved(0.01), solved(0.001));
        let grey = |rgb: &[f64; 3]| rgb.iter().sum::<f64>() / 3.0;
        let areas = areas(&scene);
        let mean = |of: &dyn Fn(usize) -> f64| -> f64 {
            areas.iter().enumerate().map(|(i, area)| area * of(i)).sum::<f64>() / areas.iter().sum::<f64>()
        };
        // Mean deviations of normal distributions are so much less than their standard deviations.
        let measured =
            mean(&|i| (grey(&some[i]) - grey(&many[i])).abs()) * std::f64::consts::FRAC_PI_2.sqrt();
        let told = mean(&|i| error.of_triangles[i].hypot(least.of_triangles[i]));
        println!("{}: {measured:.3e} W/m², told {told:.3e}, {} rays", scene.name, error.of_each());
        assert!((measured / told - 1.0).abs() <= 0.3, "{}: {measured}, told {told}", scene.name);
        assert!(error.mean <= 0.0105, "{}: {}", scene.name, error.mean);
    }
}

#[test]
fn a_budget_that_is_too_small_is_refused() {
    let scene = plant(60);
    let options = PlanOptions::default().memory_budget(1 << 20);
    let refused = Plan::new(&scene, &options, &explicit(&scene)).expect_err("1 MiB");
    // The plan says what rows may take, and what would do.
    let PlanError::TooManyRays { needed, .. } = refused else { panic!("{refused}") };
    assert!(refused.to_string().contains(&format!("--memory-budget {needed}")), "{refused}");
    let within = |budget: u64| Plan::new(&scene, &options.memory_budget(budget), &explicit(&scene));
    assert!(within(needed).expect("a plan").memory().total() <= needed);
    assert!(matches!(within(needed - 1), Err(PlanError::TooManyRays { .. })), "a byte less");
    let planned = within(u64::MAX).expect("a plan").memory().total();
    let engine = Engine::builder(antirad::backend::Backend::cpu(), &scene).settings(explicit(&scene)).build();
    assert!(engine.expect("an engine").plan().memory().total() <= planned);
}
