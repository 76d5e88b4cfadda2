//! Hard cases, each with an expectation: correct within a bound, refused, or warned of by name. docs/accuracy.md has
//! the table of all, including those of other tests.
//!
//! Most are furnaces: where all surfaces of a closed scene emit the same exitance E, have the same albedo ρ, and no
//! back is visible, the radiosity is E / (1 - ρ) on all of them, whatever their shape.

mod support;

use antirad::backend::Backend;
use antirad::image::{PictureOptions, Rasterizer};
use antirad::plan::{Occlusion, Plan, PlanOptions};
use antirad::scene::{
    BinLayout, Camera, Lamps, Material, Scene, SceneBuilder, Shape, SolveSettings, SolverChoice, Triangle,
    VisibilityChoice,
};
use antirad::warnings::{Kind, Warnings};
use antirad::{Engine, EngineError, Solution, SolveParams};
use antirad_core::solve::{GmresParams, SolveError, gmres};
use antirad_reference::Model;
use glam::{DAffine3, DVec3};
use std::f64::consts::PI;
use std::ops::ControlFlow;
use support::kit::Plates;
use support::{areas, backend, finish, mean, placed, relative_l2, solve};

/// A material of exitance 1 W/m².
fn glowing(albedo: f64) -> Material {
    Material { albedo: [albedo; 3], emission: [1.0 / PI; 3], ..Material::named("glowing") }
}

/// A unit room in which everything emits, with objects in it.
fn furnace(cells: u32, albedo: f64, add: impl FnOnce(&mut SceneBuilder, &Material)) -> Scene {
    let material = glowing(albedo);
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells }, &material, DAffine3::IDENTITY);
    add(&mut builder, &material);
    builder.finish("furnace").map(support::implicit).expect("a scene")
}

/// Of radiosity: the error of the mean, and the relative root mean square error.
fn furnace_error(scene: &Scene, solution: &Solution, albedo: f64) -> (f64, f64) {
    let truth = 1.0 / (1.0 - albedo);
    let exact: Vec<[f64; 3]> =
        areas(scene).iter().map(|&a| if a > 0.0 { [truth; 3] } else { [0.0; 3] }).collect();
    let areas = areas(scene);
    let mean = mean(&solution.radiosity, &areas, |_| true) / truth - 1.0;
    (mean, relative_l2(&solution.radiosity, &exact, &areas))
}

fn warned(scene: &Scene, settings: &SolveSettings) -> Warnings {
    // Of antiradiance, also where it is not taken by itself.
    let settings = settings.visibility(VisibilityChoice::Implicit);
    Warnings::of(scene, &Plan::new(scene, &PlanOptions::default(), &settings).expect("a plan"))
}

fn with_solver(scene: &Scene, solver: SolverChoice) -> SolveSettings {
    // What is compared with the reference takes its way.
    let settings = scene.settings.solver(solver).tolerance(1e-6).max_passes(4000);
    settings.lamps(Lamps::Antiradiance).visibility(VisibilityChoice::Implicit)
}

/// Correct within 1.5 % at albedo 0.95, and within 1 % up to 0.99 with a near field of 400, which a warning recommends.
#[test]
fn closed_boxes_of_high_albedo() {
    let backend = backend();
    for (albedo, near_field, bound) in [(0.95, 30.0, 0.015), (0.95, 400.0, 0.01), (0.99, 400.0, 0.01)] {
        let scene = furnace(8, albedo, |_, _| {});
        let settings = with_solver(&scene, SolverChoice::Gmres).near_field(near_field);
        let (_engine, solution) = solve(&backend, &scene, &settings);
        let (mean, rms) = furnace_error(&scene, &solution, albedo);
        println!(
            "albedo {albedo}, near field {near_field}: mean {:+.3} %, rms {:.3} %",
            100.0 * mean,
            100.0 * rms
        );
        assert!(rms <= bound, "albedo {albedo}, near field {near_field}: {rms}");
        assert!(scene.warnings.iter().any(|w| w.contains("\"glowing\"") && w.contains("near_field = 400")));
    }
    finish(&backend);
}

/// At most a third of Neumann's passes to 1e-6, with one lit wall so that there is something to iterate on.
#[test]
fn closed_boxes_take_a_third_of_the_passes() {
    let backend = backend();
    for albedo in [0.95, 0.99] {
        let mut scene = furnace(4, albedo, |_, _| {});
        let lamp = scene.materials[0].clone();
        scene.materials = vec![Material { emission: [0.0; 3], ..lamp.clone() }, lamp];
        for (i, triangle) in scene.triangles.iter_mut().enumerate() {
            triangle.material = u32::from(i < 16);
        }
        scene.check(true).expect("a scene");
        let (_engine, solution) = solve(&backend, &scene, &with_solver(&scene, SolverChoice::Gmres));
        let error = relative_l2(&solution.irradiance, &reference(&scene), &areas(&scene));
        let passes = solution.info.passes;
        println!("albedo {albedo}: {passes} passes of GMRES, {error:.1e} from the reference");
        assert!(error <= 1e-4, "{error:e}");

        let settings = with_solver(&scene, SolverChoice::FixedPoint).max_passes(3 * passes - 1);
        let plan = Plan::new(&scene, &PlanOptions::of(&backend), &settings).expect("a plan");
        let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
        match engine.solve(&SolveParams::from(&settings)) {
            Err(EngineError::Solve(SolveError::NoConvergence { residual, .. })) => {
                println!("  Neumann is at {residual:.1e} after {} passes", 3 * passes - 1);
            }
            other => panic!("Neumann is as quick: {:?}", other.map(|solution| solution.info)),
        }
    }
    finish(&backend);
}

/// Irradiance by the f64 twin.
fn reference(scene: &Scene) -> Vec<[f64; 3]> {
    let model = Model::new(scene);
    let params = GmresParams::new(1e-9, 200, 30);
    let (truth, _) = gmres(&mut &model, &params, &mut |_, _| ControlFlow::Continue(())).expect("a reference");
    truth.irradiance.iter().map(|h| h.to_array()).collect()
}

/// Form factor of two parallel unit squares, by Howell's catalogue of configuration factors (C-11).
fn squares_form_factor(distance: f64) -> f64 {
    let x = 1.0 / distance;
    let y = (1.0 + x * x).sqrt();
    2.0 / (PI * x * x)
        * ((y * y / (1.0 + 2.0 * x * x).sqrt()).ln() + 2.0 * x * y * (x / y).atan() - 2.0 * x * x.atan())
}

/// Correct within 1.5 %.
#[test]
fn plates_with_narrow_gaps() {
    assert!((squares_form_factor(1.0) - 0.199_824_895_698).abs() <= 1e-11);
    let backend = backend();
    for gap in [0.01, 0.03, 0.1] {
        let black = Material::named("black");
        let mut builder = SceneBuilder::new();
        builder.shape("up", Shape::Quad { cells: 8 }, &glowing(0.0), DAffine3::IDENTITY);
        builder.shape("down", Shape::Quad { cells: 8 }, &black, placed([1.0, -1.0, 1.0], [0.0, gap, 0.0]));
        let scene = builder.finish("plates").map(support::implicit).expect("a scene");
        let (_engine, solution) = solve(&backend, &scene, &scene.settings);
        let found = mean(&solution.irradiance, &areas(&scene), |i| scene.material(i).name == "black");
        let error = found / squares_form_factor(gap) - 1.0;
        println!("gap {gap}: {:+.3} %", 100.0 * error);
        assert!(error.abs() <= 0.015, "gap {gap}: {error}");
        let named = warned(&scene, &scene.settings).get(Kind::NarrowGaps).is_some();
        assert_eq!(named, gap < 0.04, "cells of 1/8 have the size .095");
    }
    finish(&backend);
}

/// Needles of 1 : 10⁴, triangles without area, and sheets whose two sides have one centroid: correct within 2 %.
/// Duplicate triangles are warned of, since they create light.
#[test]
fn awkward_triangles() {
    let backend = backend();
    let solved = |scene: &Scene| {
        let (_engine, solution) = solve(&backend, scene, &scene.settings);
        assert!(solution.irradiance.iter().chain(&solution.radiosity).flatten().all(|h| h.is_finite()));
        solution
    };
    // The floor's first square, cut so that a needle of 1 : 10⁴ lies in it, and next to it a triangle without area.
    let mut scene = furnace(4, 0.5, |_, _| {});
    let [a, b, c] = scene.triangles[0].vertices;
    let at = scene.vertices.len() as u32;
    let (from, to) = (scene.vertices[a as usize], scene.vertices[b as usize]);
    let middle = from.lerp(to, 0.5);
    let aside = middle + 5e-5 * (scene.vertices[c as usize] - middle).normalize() * from.distance(to);
    scene.vertices.extend([aside, middle]);
    let material = scene.triangles[0].material;
    scene.triangles[0].vertices = [a, at, c];
    scene
        .triangles
        .extend([[a, b, at], [at, b, c], [a, at + 1, b]].map(|vertices| Triangle { vertices, material }));
    scene.meshes[0].range.end = scene.triangles.len() as u32;
    scene.check(false).expect("a scene");
    assert_eq!(scene.degenerate, [scene.triangles.len() as u32 - 1]);
    let needle = scene.triangles.len() - 3;
    let solution = solved(&scene);
    let (mean, rms) = furnace_error(&scene, &solution, 0.5);
    let of_needle = solution.radiosity[needle][0] / 2.0 - 1.0;
    println!(
        "needle: mean {:+.3} %, rms {:.3} %, itself {:+.2} %",
        100.0 * mean,
        100.0 * rms,
        100.0 * of_needle
    );
    assert!(rms <= 0.02 && of_needle.abs() <= 0.05, "{rms} {of_needle}");
    assert_eq!(solution.irradiance[needle + 2], [0.0; 3], "no area, no light");

    // A sheet: two quads with the same corners, back to back.
    let sheet = furnace(6, 0.5, |builder, material| {
        for side in [1.0, -1.0] {
            builder.shape(
                "sheet",
                Shape::Quad { cells: 4 },
                material,
                placed([0.5, side, 0.5], [0.25, 0.5, 0.25]),
            );
        }
    });
    let (mean, rms) = furnace_error(&sheet, &solved(&sheet), 0.5);
    println!("sheet: mean {:+.3} %, rms {:.3} %", 100.0 * mean, 100.0 * rms);
    assert!(rms <= 0.02, "{rms}");

    let mut twice = furnace(4, 0.5, |_, _| {});
    let again = twice.triangles[5];
    twice.triangles.push(again);
    twice.meshes[0].range.end += 1;
    twice.check(true).expect("a scene");
    solved(&twice);
    let found = warned(&twice, &twice.settings);
    let named = found.get(Kind::DuplicateTriangles).expect("a warning");
    assert_eq!((named.count, named.triangles.as_slice()), (1, &[twice.triangles.len() as u32 - 1][..]));
    finish(&backend);
}

/// A lamp just under the ceiling and a block just above the floor: warned of, and correct within 10 % (3 % in the
/// mean).
#[test]
fn gaps_below_the_size_of_triangles() {
    let backend = backend();
    for gap in [1e-3, 1e-2] {
        let scene = furnace(6, 0.5, |builder, material| {
            let lamp = Shape::Slab { cells: 3 };
            builder.shape("lamp", lamp, material, placed([0.4, 0.01, 0.4], [0.3, 0.99 - gap, 0.3]));
            builder.shape("block", Shape::Box { cells: 3 }, material, placed([0.3; 3], [0.1, gap, 0.5]));
        });
        let found = warned(&scene, &scene.settings);
        let gaps = found.get(Kind::NarrowGaps).expect("a warning");
        let (_engine, solution) = solve(&backend, &scene, &scene.settings);
        let (mean, rms) = furnace_error(&scene, &solution, 0.5);
        println!("gap {gap}: {} gaps, mean {:+.3} %, rms {:.3} %", gaps.count, 100.0 * mean, 100.0 * rms);
        assert!(mean.abs() <= 0.03 && rms <= 0.1, "{mean} {rms}");
    }
    finish(&backend);
}

/// Settings for blockers that are coarse: bins of equal size, and a wider near field.
fn layered(scene: &Scene) -> SolveSettings {
    let settings = scene.settings.visibility(VisibilityChoice::Implicit);
    settings.bins(BinLayout::Concentric { n: 10 }).near_field(60.0)
}

/// Irradiance of a floor that plates shadow entirely, relative to the one without plates.
fn under(backend: &Backend, plates: &Plates) -> Result<f64, EngineError> {
    let scene = plates.scene().expect("a scene");
    let floor = scene.meshes[0].range.start as usize..scene.meshes[0].range.end as usize;
    let settings = layered(&scene);
    let run = |occlusion| {
        let options = PlanOptions::of(backend).occlusion(occlusion);
        let plan = Plan::new(&scene, &options, &settings)?;
        let mut engine = Engine::new(backend, &scene, plan)?;
        let solution = engine.solve(&SolveParams::from(&settings))?;
        let squares = |i: usize| solution.irradiance[i][0].powi(2);
        Ok::<_, EngineError>(floor.clone().map(squares).sum::<f64>().sqrt())
    };
    Ok(run(Occlusion::Exact)? / run(Occlusion::Nothing)?)
}

/// Light that leaks through stacks of plates whose distance is three times their triangles' size.
#[test]
fn stacks_of_plates() {
    let backend = backend();
    for (count, bound) in [(1, 0.05), (2, 0.05), (4, 0.05), (8, 0.05)] {
        let plates = Plates { count, gap: 0.24, ..Plates::default() };
        let leak = under(&backend, &plates).expect("a solution");
        println!("{count} plates: {:.1} % of the light comes through", 100.0 * leak);
        assert!(leak <= bound, "{count} plates: {leak}");
        // With the narrow bins of the pole they are warned of.
        named_layers(&plates.scene().expect("a scene"), count);
    }
    finish(&backend);
}

/// Those behind which light must pass two gains above 1: all but a single plate.
fn named_layers(scene: &Scene, count: u32) {
    let found = warned(scene, &scene.settings);
    assert!(found.get(Kind::CoarseBlockers).is_some(), "{found}");
    let Some(layers) = found.get(Kind::StackedLayers) else {
        assert_eq!(count, 1, "{found}");
        return;
    };
    for k in 1..=count {
        assert!(layers.message.contains(&format!("\"plate {k}\"")), "{}", layers.message);
    }
}

/// Closer than a triangle's size: as above where the near field still cuts the triangles finely enough. Warned of; with
/// the narrow bins of the pole, by the names of the layers.
#[test]
fn stacks_of_plates_that_are_too_close() {
    let backend = backend();
    for (count, cells, bound) in [(2, 12, 0.05), (2, 8, 0.1), (2, 6, 0.3)] {
        let plates = Plates { count, cells, ..Plates::default() };
        let scene = plates.scene().expect("a scene");
        named_layers(&scene, count);
        let settings = layered(&scene);
        assert!(warned(&scene, &settings).get(Kind::CoarseBlockers).is_some(), "{count} plates of {cells}");
        let leak = under(&backend, &plates).expect("a solution");
        println!("{count} plates of {cells} squares: {:.1} % of the light comes through", 100.0 * leak);
        assert!(leak <= bound, "{count} plates: {leak}");
    }
    finish(&backend);
}

/// Powers from 0 to 1000 agree with the f64 reference.
#[test]
fn lobes_of_all_powers() {
    let backend = backend();
    for power in [0.0, 1.0, 1000.0] {
        let mut scene = furnace(2, 0.3, |_, _| {});
        scene.materials[0].emission = [0.0; 3];
        scene.materials[0].specular = [0.02; 3];
        scene.materials[0].power = power;
        let lamp = Material { emission: [3.0; 3], ..Material::named("lamp") };
        scene.materials.push(lamp);
        scene.triangles[0].material = 1;
        scene.check(true).expect("a scene");
        let (_engine, solution) = solve(&backend, &scene, &with_solver(&scene, SolverChoice::Auto));
        let error = relative_l2(&solution.irradiance, &reference(&scene), &areas(&scene));
        println!("power {power}: {error:.1e}");
        assert!(error <= 1e-4, "power {power}: {error:e}");
    }
    finish(&backend);
}

/// Black walls reflect nothing: radiosity equals exitance, and a closed box absorbs all of it.
#[test]
fn black_walls() {
    let backend = backend();
    let scene = furnace(6, 0.0, |_, _| {});
    let (_engine, solution) = solve(&backend, &scene, &scene.settings);
    let (mean, rms) = furnace_error(&scene, &solution, 0.0);
    let balance = solution.energy.absorbed[0] / solution.energy.emitted[0] - 1.0;
    println!("black: {mean:.1e} {rms:.1e}, balance {balance:+.2e}");
    assert!(rms <= 1e-6 && balance.abs() <= 0.01, "{rms} {balance}");
    finish(&backend);
}

/// A camera that sees nothing gives a black picture, not an error.
#[test]
fn a_camera_that_sees_nothing() {
    let backend = backend();
    let scene = furnace(2, 0.5, |_, _| {});
    let (mut engine, solution) = solve(&backend, &scene, &scene.settings);
    let away = Camera {
        position: DVec3::new(0.5, 0.5, 5.0),
        target: DVec3::new(0.5, 0.5, 9.0),
        ..Camera::framing(&scene.vertices)
    };
    // From outside there are only backs.
    let backs = Camera { target: DVec3::splat(0.5), ..away.clone() };
    for camera in [away, backs] {
        let camera = Camera { width: 16, height: 12, ..camera };
        let colours =
            antirad::output::single(&engine.face_colours(&solution, camera.position).expect("colours"));
        let rasterizer = Rasterizer::new(&backend).expect("a rasterizer");
        let picture =
            rasterizer.render(&scene, &camera, &colours, &PictureOptions::default()).expect("a picture");
        assert!(picture.pixels.iter().all(|p| p[..3] == [0.0; 3]));
    }
    finish(&backend);
}
