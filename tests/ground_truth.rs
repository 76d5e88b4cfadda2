//! Default settings against closed forms and path-traced irradiance (of independent origin; see tests/data/README.md).

mod support;

use antirad::plan::{Occlusion, PlanOptions};
use antirad::resolve::Cut;
use support::{areas, backend, finish, load, mean, read_npy, relative_l2, solve, solve_within};

/// Mean radiosity of a closed sphere whose faces all emit exitance 1: 1 / (1 - albedo), whatever the facets.
fn sphere(name: &str, truth: f64, tolerance: f64) {
    let backend = backend();
    let scene = load(&format!("tests/data/{name}.obj"));
    let (_engine, solution) = solve(&backend, &scene, &scene.settings);
    let radiosity = mean(&solution.radiosity, &areas(&scene), |_| true);
    let error = radiosity / truth - 1.0;
    println!("{name}: mean radiosity {radiosity:.4}, {:+.3} %", 100.0 * error);
    assert!(error.abs() <= tolerance, "{name}: {radiosity} instead of {truth}");
    finish(&backend);
}

#[test]
fn sphere_of_albedo_80() {
    sphere("sphere_l3_r80", 5.0, 0.01);
}

#[test]
fn sphere_of_albedo_95() {
    sphere("sphere_l3_r95", 20.0, 0.02);
}

/// Form factor of two squares.
fn squares(name: &str, truth: f64, tolerance: f64) {
    let backend = backend();
    let scene = load(&format!("tests/data/{name}.obj"));
    let (_engine, solution) = solve(&backend, &scene, &scene.settings);
    let exitance = solution.radiosity.iter().map(|b| b[0]).fold(0.0, f64::max);
    let receives = |i: usize| scene.material(i).name == "recv";
    let form_factor = mean(&solution.irradiance, &areas(&scene), receives) / exitance;
    let error = form_factor / truth - 1.0;
    println!("{name}: form factor {form_factor:.6}, {:+.3} %", 100.0 * error);
    assert!(error.abs() <= tolerance, "{name}: {form_factor} instead of {truth}");
    finish(&backend);
}

#[test]
fn parallel_squares() {
    squares("parallel", 0.199824895698, 0.003);
}

#[test]
fn perpendicular_squares() {
    squares("perpendicular", 0.200043776075, 0.005);
}

#[test]
fn closed_box() {
    let backend = backend();
    let scene = load("tests/data/cornell_empty_closed.obj");
    let (engine, solution) = solve(&backend, &scene, &scene.settings);
    let classes = engine.plan().classes();
    assert!(classes.iter().all(|c| !c.has_bins()), "nothing hides anything: no bins, no J");
    let truth = read_npy("tests/data/cornell_empty_closed.irradiance.npy");
    let error = relative_l2(&solution.irradiance, &truth, &areas(&scene));
    println!("cornell_empty_closed: relative L2 {:.3} %", 100.0 * error);
    assert!(error <= 0.01, "{error}");
    for c in 0..3 {
        let balance = solution.energy.absorbed[c] / solution.energy.emitted[c] - 1.0;
        println!("  absorbed / emitted - 1 = {:+.4} %", 100.0 * balance);
        assert!(balance.abs() <= 0.005, "channel {c}: {balance}");
    }
    finish(&backend);
}

#[test]
fn cornell_boxes() {
    let backend = backend();
    let scene = load("scenes/cornell_boxes.toml");
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let (_engine, solution) = solve(&backend, &scene, &scene.settings);
    let error = relative_l2(&solution.irradiance, &truth, &areas(&scene));
    println!("cornell_boxes: relative L2 {:.3} %, {:?}", 100.0 * error, solution.info);
    for row in backend.profile() {
        println!("  {row:?}");
    }
    assert!(error <= 0.01, "{error}");
    finish(&backend);
}

/// The boxes have no bottom, and stand within triangles of the floor.
#[test]
fn cornell_boxes_cut_where_the_boxes_stand() {
    let backend = backend();
    let given = load("scenes/cornell_boxes.toml");
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let mut scene = given.clone();
    let parents = scene.cut_along_contacts(usize::MAX);
    assert!(parents.len() > given.triangles.len() && parents.len() < given.triangles.len() + 200);
    let (_engine, solution) = solve(&backend, &scene, &scene.settings);
    let means = Cut::between(&given, &scene, &parents).on_given(&solution.irradiance);
    let error = relative_l2(&means, &truth, &areas(&given));
    println!("cornell_boxes, cut along contacts: relative L2 {:.3} %", 100.0 * error);
    assert!(error <= 0.005, "{error}");
    finish(&backend);
}

/// Without J the error is large: the test is sensitive to occlusion.
#[test]
fn cornell_boxes_without_occlusion() {
    let backend = backend();
    let scene = load("scenes/cornell_boxes.toml");
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let options = PlanOptions::of(&backend).occlusion(Occlusion::Nothing);
    let (_engine, solution) = solve_within(&backend, &scene, &scene.settings, &options);
    let error = relative_l2(&solution.irradiance, &truth, &areas(&scene));
    println!("cornell_boxes without J: relative L2 {:.3} %", 100.0 * error);
    assert!(error >= 0.3, "{error}");
    finish(&backend);
}

#[test]
fn cornell_boxes_fine() {
    let backend = backend();
    let scene = load("scenes/cornell_boxes_fine.toml");
    let coarse = load("scenes/cornell_boxes.toml");
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let (_engine, solution) = solve(&backend, &scene, &scene.settings);
    // The four children of a face are consecutive and of the same area.
    let means: Vec<[f64; 3]> = solution
        .irradiance
        .chunks_exact(4)
        .map(|four| std::array::from_fn(|c| four.iter().map(|h| h[c]).sum::<f64>() / 4.0))
        .collect();
    let error = relative_l2(&means, &truth, &areas(&coarse));
    println!("cornell_boxes_fine: relative L2 {:.3} %, {:?}", 100.0 * error, solution.info);
    for row in backend.profile() {
        println!("  {row:?}");
    }
    assert!(error <= 0.007, "{error}");
    finish(&backend);
}

/// The project's own path tracer against an independent one, which has errors of its own: 0.26 % at the median.
#[test]
fn path_traced_by_two() {
    let scene = load("scenes/cornell_boxes.toml");
    let truth = read_npy("tests/data/cornell_boxes.irradiance.npy");
    let tracer = antirad::path_tracer::PathTracer::new(&scene);
    let (mut sum, mut count) = (0.0, 0.0);
    for i in (0..scene.triangles.len()).step_by(61) {
        let found = tracer.irradiance_of(i, 4096);
        for c in 0..3 {
            let error = found.error[c].hypot(0.01 * truth[i][c]);
            assert!(
                (found.mean[c] - truth[i][c]).abs() <= 5.0 * error + 1e-9,
                "{i}: {found:?}, not {:?}",
                truth[i]
            );
            sum += (found.mean[c] - truth[i][c]) / truth[i][c].max(1e-9);
            count += 1.0;
        }
    }
    println!("path tracers differ by {:+.3} % on average over {count} values", 100.0 * sum / count);
    assert!((sum / count).abs() <= 0.01, "{}", sum / count);
}

/// Pictures of the project's own path tracer against an independent one, over squares of 4 x 4 pixels.
#[test]
fn pictures_path_traced_by_two() {
    let scene = load("scenes/cornell_boxes.toml");
    let truth = antirad::image::Picture::read_exr("scenes/cornell_boxes.exr").expect("a picture");
    let camera = antirad::scene::Camera { width: 64, height: 64, ..scene.cameras[0].clone() };
    let found = antirad::path_tracer::PathTracer::new(&scene).picture(&camera, 256, 0);
    let (mut squares, mut sum, mut count) = (0.0, 0.0, 0.0);
    for (k, pixel) in found.pixels.iter().enumerate() {
        let (column, row) = (4 * (k % 64), 4 * (k / 64));
        for c in 0..3 {
            let of = |i: usize| f64::from(truth.pixels[256 * (row + i / 4) + column + i % 4][c]);
            let values: Vec<f64> = (0..16).map(of).collect();
            let mean = values.iter().sum::<f64>() / 16.0;
            // The noise of the other picture, 0.68 % of a pixel at the median, is independent in each of them.
            let error = pixel.radiance.error[c].hypot(0.01 * mean / 4.0);
            if mean > 0.0 {
                squares += ((pixel.radiance.mean[c] - mean) / error).powi(2);
                sum += (pixel.radiance.mean[c] - mean) / mean;
                count += 1.0;
            } else {
                assert_eq!(pixel.radiance.mean[c], 0.0);
            }
        }
    }
    let (deviation, bias) = ((squares / count).sqrt(), sum / count);
    println!("pictures differ by {deviation:.2} standard errors, {:+.3} % on average", 100.0 * bias);
    assert!((0.7..=1.3).contains(&deviation), "{deviation}");
    assert!(bias.abs() <= 0.002, "{bias}");
}
