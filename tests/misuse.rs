//! Misuse of the API is an error: it does not panic, does not return a result, and leaves the engine intact.

mod support;

use antirad::backend::Backend;
use antirad::glam::{DAffine3, DVec3};
use antirad::plan::{GradientRequest, Plan, PlanError, PlanOptions};
use antirad::scene::{Material, Scene, SceneBuilder, SceneError, Shape, Triangle};
use antirad::target_error::{SearchError, Stage, TargetErrorOptions, solve_within};
use antirad::{Cotangent, Engine, EngineError, Solution, SolveParams};
use std::ops::ControlFlow;
use support::{backend, device, finish};

/// A room with a luminous ceiling, grey and diffuse.
fn room(cells: u32) -> Scene {
    let (vertices, faces) = Shape::Room { cells }.mesh();
    let ceiling = |face: &[u32; 3]| face.iter().all(|&v| vertices[v as usize].y == 1.0);
    let triangles =
        faces.iter().map(|&vertices| Triangle { vertices, material: ceiling(&vertices).into() }).collect();
    let wall = Material { albedo: [0.5; 3], ..Material::named("wall") };
    let lamp = Material { emission: [1.0; 3], ..Material::named("lamp") };
    Scene::new("room", vertices, triangles, vec![wall, lamp]).map(support::implicit).expect("a scene")
}

fn options(backend: &Backend) -> PlanOptions {
    PlanOptions::of(backend).gradients(GradientRequest::NOTHING.albedo(true).camera(true))
}

fn plan(backend: &Backend, scene: &Scene) -> Plan {
    Plan::new(scene, &options(backend), &scene.settings).expect("a plan")
}

fn engine(backend: &Backend, scene: &Scene) -> Engine {
    Engine::new(backend, scene, plan(backend, scene)).expect("an engine")
}

fn params() -> SolveParams {
    SolveParams::from(&support::implicit_settings())
}

/// The derivatives of the sum of all irradiance.
fn backward(
    engine: &mut Engine,
    solution: &Solution,
    params: &SolveParams,
) -> Result<Vec<DVec3>, EngineError> {
    let triangles = solution.irradiance.len();
    let cotangent = Cotangent::default().irradiance(Some(vec![DVec3::ONE; triangles]));
    let request = GradientRequest::NOTHING.albedo(true);
    engine.backward(solution, &cotangent, request, params).map(|g| g.albedo.expect("requested"))
}

const INSIDE: DVec3 = DVec3::new(0.4, 0.5, 0.6);

/// Plans count the memory of one backend, and are parted by what it can do.
#[test]
fn a_plan_is_for_one_backend() {
    let scene = room(2);
    let backends = [Backend::cpu(), device().into()];
    for [one, other] in [[0, 1], [1, 0]].map(|pair| pair.map(|k: usize| &backends[k])) {
        let refused = Engine::new(one, &scene, plan(other, &scene)).err().expect("another backend");
        let named = matches!(
            refused,
            EngineError::OtherBackend { planned, given } if planned == other.kind() && given == one.kind()
        );
        assert!(named, "{refused}");
        assert!(refused.to_string().contains("PlanOptions::of"), "{refused}");
    }
    backends.iter().for_each(finish);
}

/// A solution of the other backend is no start.
#[test]
fn a_solution_stays_on_its_backend() {
    let scene = room(2);
    let backends = [Backend::cpu(), device().into()];
    let [mut one, mut other] = backends.each_ref().map(|backend| engine(backend, &scene));
    let of_other = other.solve(&params()).expect("a solution");
    let mut from =
        |start| one.solve_from(start, &params(), &mut |_, _| ControlFlow::Continue(())).expect("a solution");
    assert_eq!(from(Some(&of_other)).irradiance, from(None).irradiance);
    drop((of_other, other));
    backends.iter().for_each(finish);
}

#[test]
fn a_solution_belongs_to_the_engine_that_found_it() {
    let backend = backend();
    let (small, large) = (room(2), room(3));
    let mut engines = [engine(&backend, &small), engine(&backend, &large), engine(&backend, &small)];
    let solutions = engines.each_mut().map(|engine| engine.solve(&params()).expect("a solution"));
    for (e, engine) in engines.iter_mut().enumerate() {
        for (s, solution) in solutions.iter().enumerate() {
            let colours = engine.face_colours(solution, INSIDE);
            let gradients = backward(engine, solution, &params());
            if e == s {
                assert!(colours.is_ok() && gradients.is_ok(), "{colours:?} {gradients:?}");
            } else {
                assert!(matches!(colours, Err(EngineError::OtherEngine)), "{colours:?}");
                assert!(matches!(gradients, Err(EngineError::OtherEngine)), "{gradients:?}");
            }
        }
    }
    let [first, ..] = engines;
    let mut rebuilt = first.rebuilt(&small).expect("an engine");
    let colours = rebuilt.face_colours(&solutions[0], INSIDE);
    assert!(matches!(colours, Err(EngineError::OtherEngine)), "{colours:?}");
    finish(&backend);
}

#[test]
fn a_solution_belongs_to_the_materials_it_was_found_with() {
    let backend = backend();
    let mut scene = room(2);
    let mut engine = engine(&backend, &scene);
    let old = engine.solve(&params()).expect("a solution");
    scene.materials[0].albedo = [0.6; 3];
    engine.set_materials(&scene).expect("materials that fit the plan");
    let colours = engine.face_colours(&old, INSIDE);
    assert!(matches!(colours, Err(EngineError::OutdatedSolution)), "{colours:?}");
    let gradients = backward(&mut engine, &old, &params());
    assert!(matches!(gradients, Err(EngineError::OutdatedSolution)), "{gradients:?}");
    let new = engine.solve(&params()).expect("a solution");
    assert!(engine.face_colours(&new, INSIDE).is_ok() && backward(&mut engine, &new, &params()).is_ok());
    // Refused materials leave the engine and its solutions unchanged.
    scene.materials[0].albedo = [1.5; 3];
    assert!(engine.set_materials(&scene).is_err());
    assert!(engine.face_colours(&new, INSIDE).is_ok() && backward(&mut engine, &new, &params()).is_ok());
    finish(&backend);
}

/// An earlier solution can be a start; one of an engine with another layout cannot.
#[test]
fn a_solve_starts_at_any_solution_that_can_be_one() {
    let backend = backend();
    let mut scene = room(2);
    let mut first = engine(&backend, &scene);
    let old = first.solve(&params()).expect("a solution");
    scene.materials[0].albedo = [0.501; 3];
    let mut second = engine(&backend, &scene);
    let mut from = |start| {
        second.solve_from(start, &params(), &mut |_, _| ControlFlow::Continue(())).expect("a solution")
    };
    let cold = from(None);
    let warm = from(Some(&old));
    assert!(warm.info.passes < cold.info.passes, "{} and {}", warm.info.passes, cold.info.passes);
    let other = engine(&backend, &room(3)).solve(&params()).expect("a solution");
    assert_eq!(from(Some(&other)).irradiance, cold.irradiance);
    finish(&backend);
}

/// Scenes that no file could give, each with a part of its error.
fn broken_scenes() -> Vec<(&'static str, Scene)> {
    let broken = |word: &'static str, change: &dyn Fn(&mut Scene)| {
        let mut scene = room(2);
        change(&mut scene);
        (word, scene)
    };
    vec![
        broken("vertex index 4000000000", &|s| s.triangles[5].vertices[1] = 4_000_000_000),
        broken("material index 2", &|s| s.triangles[7].material = 2),
        broken("coordinates must be finite", &|s| s.vertices[3].y = f64::NAN),
        broken("coordinates must be finite", &|s| s.vertices[3].y = f64::INFINITY),
        broken("diffuse albedo is 1.500", &|s| s.materials[0].albedo = [0.2, 1.5, 0.2]),
        broken("albedo is NaN", &|s| s.materials[0].albedo[2] = f64::NAN),
        broken("total albedo", &|s| s.materials[0].specular = [0.9; 3]),
        broken("emission is NaN", &|s| s.materials[1].emission[0] = f64::NAN),
        broken("emission is inf", &|s| s.materials[1].emission[0] = f64::INFINITY),
        broken("emission is -1", &|s| s.materials[1].emission[0] = -1.0),
        broken("power is NaN", &|s| s.materials[0].power = f64::NAN),
        broken("meshes do not cover", &|s| s.meshes.clear()),
        broken("degenerate", &|s| s.degenerate.push(1 << 20)),
        broken("no triangles", &|s| s.triangles.clear()),
    ]
}

#[test]
fn a_scene_by_code_is_checked_like_one_from_a_file() {
    let backend = backend();
    let sound = room(2);
    let plan = plan(&backend, &sound);
    let mut engine = engine(&backend, &sound);
    let before = engine.solve(&params()).expect("a solution").irradiance;
    for (word, scene) in broken_scenes() {
        match Plan::new(&scene, &options(&backend), &sound.settings) {
            Err(PlanError::Scene(error)) => assert!(error.to_string().contains(word), "{word}: {error}"),
            other => panic!("{word}: {other:?}"),
        }
        let refused = Engine::new(&backend, &scene, plan.clone()).err();
        assert!(matches!(refused, Some(EngineError::Scene(_))), "{word}: {refused:?}");
        let refused = engine.set_materials(&scene).err();
        assert!(matches!(refused, Some(EngineError::Scene(_))), "{word}: {refused:?}");
    }
    assert_eq!(engine.solve(&params()).expect("a solution").irradiance, before);
    finish(&backend);
}

/// Faces of a mesh cannot use the vertices of the next one.
#[test]
fn a_mesh_uses_its_own_vertices() {
    let corners = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    let wall = Material::named("wall");
    for index in [3, u32::MAX] {
        let mut builder = SceneBuilder::new();
        builder
            .mesh("first", corners.clone(), vec![[0, 1, 2]], &wall, DAffine3::IDENTITY)
            .mesh("second", corners.clone(), vec![[0, 1, 2], [0, 1, index]], &wall, DAffine3::IDENTITY)
            .mesh("third", corners.clone(), vec![[0, 1, 2]], &wall, DAffine3::IDENTITY);
        let refused = builder.finish("three").expect_err("an index out of range").to_string();
        let named = ["triangle 2", "\"second\"", &index.to_string(), "there are 3"];
        assert!(named.iter().all(|word| refused.contains(word)), "{refused}");
    }
}

#[test]
fn a_target_error_is_between_zero_and_one() {
    let backend = backend();
    let scene = room(2);
    let mut solve = |engine: &mut Engine, _: &Scene, _: &Stage| engine.solve(&params());
    for error in [f64::NAN, f64::INFINITY, 0.0, -1.0, 1.0] {
        let solved = solve_within(&backend, &scene, &TargetErrorOptions::new(error), &|_| 0, &mut solve);
        let refused = solved.err();
        let named = matches!(
            refused,
            Some(SearchError::Engine(EngineError::Scene(SceneError::SolveSettings { .. })))
        );
        assert!(named, "{error}: {refused:?}");
    }
    finish(&backend);
}

#[test]
fn a_plan_is_for_one_geometry() {
    let backend = backend();
    let sound = room(2);
    let mut engine = engine(&backend, &sound);
    let last = sound.triangles.len() - 1;
    let mut moved = sound.clone();
    // A corner of its own for the last triangle, a little further out.
    moved
        .vertices
        .push(1.01 * sound.vertices[sound.triangles[last].vertices[2] as usize] + 0.01 * DVec3::ONE);
    moved.triangles[last].vertices[2] = sound.vertices.len() as u32;
    let mut wide = sound.clone();
    wide.vertices.iter_mut().for_each(|vertex| vertex.x *= 2.0);
    for (scene, first) in [(&moved, last), (&wide, 0)] {
        let refused = Engine::new(&backend, scene, plan(&backend, &sound)).err();
        let named = matches!(refused, Some(EngineError::OtherGeometry { triangle }) if triangle >= first);
        assert!(named, "{refused:?}");
        let refused = engine.set_materials(scene).err();
        assert!(matches!(refused, Some(EngineError::OtherGeometry { .. })), "{refused:?}");
    }
    // The same positions under other indices: derivatives by vertices would be wrong.
    let mut renumbered = sound.clone();
    renumbered.vertices.push(sound.vertices[sound.triangles[last].vertices[2] as usize]);
    renumbered.triangles[last].vertices[2] = sound.vertices.len() as u32;
    let refused = engine.set_materials(&renumbered).err();
    assert!(
        matches!(refused, Some(EngineError::OtherGeometry { triangle }) if triangle == last),
        "{refused:?}"
    );
    let fewer = Engine::new(&backend, &room(3), plan(&backend, &sound)).err();
    assert!(matches!(fewer, Some(EngineError::OtherScene { .. })), "{fewer:?}");
    // Lobes and colours that the plan does not provide for.
    let mut glossy = sound.clone();
    glossy.materials[0].specular = [0.01; 3];
    let refused = Engine::new(&backend, &glossy, plan(&backend, &sound)).err();
    assert!(matches!(refused, Some(EngineError::BeyondPlan { .. })), "{refused:?}");
    finish(&backend);
}

#[test]
fn tiles_are_of_32_or_64() {
    let scene = room(2);
    for tile in [0, 1, 16, 48, 128, u32::MAX] {
        let refused = Plan::new(&scene, &PlanOptions::default().tile(tile), &scene.settings);
        assert!(matches!(refused, Err(PlanError::Tile(given)) if given == tile), "{tile}: {refused:?}");
    }
}

#[test]
fn a_tolerance_is_between_zero_and_one() {
    let backend = backend();
    let scene = room(2);
    let mut engine = engine(&backend, &scene);
    let solution = engine.solve(&params()).expect("a solution");
    for tolerance in [f64::INFINITY, f64::NAN, 0.0, -1.0, 1.0, -f64::INFINITY] {
        let params = params().tolerance(tolerance);
        let solved = engine.solve(&params).map(|solution| solution.irradiance);
        assert!(matches!(solved, Err(EngineError::Tolerance { .. })), "{tolerance}: {solved:?}");
        let gradients = backward(&mut engine, &solution, &params);
        assert!(matches!(gradients, Err(EngineError::Tolerance { .. })), "{tolerance}: {gradients:?}");
        let settings = scene.settings.tolerance(tolerance);
        let planned = Plan::new(&scene, &options(&backend), &settings);
        let refused = matches!(planned, Err(PlanError::Scene(SceneError::SolveSettings { .. })));
        assert!(refused, "{tolerance}: {planned:?}");
    }
    let idle = params().max_passes(0);
    let solved = engine.solve(&idle).map(|solution| solution.irradiance);
    assert!(matches!(solved, Err(EngineError::NoPasses)), "{solved:?}");
    for near_field in [f64::NAN, f64::INFINITY, -1.0] {
        let planned = Plan::new(&scene, &options(&backend), &scene.settings.near_field(near_field));
        assert!(matches!(planned, Err(PlanError::Scene(SceneError::SolveSettings { .. }))), "{planned:?}");
    }
    finish(&backend);
}

#[test]
fn a_camera_is_somewhere() {
    let backend = backend();
    let scene = room(2);
    let mut engine = engine(&backend, &scene);
    let solution = engine.solve(&params()).expect("a solution");
    for nowhere in [DVec3::NAN, DVec3::new(0.5, f64::INFINITY, 0.5)] {
        let colours = engine.face_colours(&solution, nowhere);
        assert!(matches!(colours, Err(EngineError::CameraPosition { .. })), "{colours:?}");
        let by_colours = vec![DVec3::ONE; scene.triangles.len()];
        let cotangent = Cotangent::default().colours(vec![(nowhere, by_colours)]);
        let request = GradientRequest::NOTHING.camera(true);
        let gradients =
            engine.backward(&solution, &cotangent, request, &params()).map(|g| g.camera_positions);
        assert!(matches!(gradients, Err(EngineError::CameraPosition { .. })), "{gradients:?}");
    }
    finish(&backend);
}
