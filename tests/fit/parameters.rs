//! The map from unknowns to scenes and the pullback of derivatives.

use crate::{says, scene};
use antirad::fit::{Fit, MotionKind, Parameters, Per, Regulariser, Regularisers};
use antirad::render::{CameraGradient, Quantity, SceneGradient};
use antirad::scene::{Camera, Scene};
use glam::{DQuat, DVec3};

fn fit(quantity: Quantity) -> Fit {
    Fit::new(quantity)
}

fn of(quantity: Quantity, materials: &[&str], per: Per) -> Fit {
    let materials = Some(materials.iter().map(|m| m.to_string()).collect());
    fit(quantity).materials(materials).per(per)
}

fn moving(motion: MotionKind, meshes: &[&str]) -> Fit {
    fit(Quantity::Position).motion(motion).meshes(Some(meshes.iter().map(|m| m.to_string()).collect()))
}

/// Everything that can be fitted at once.
fn everything() -> Vec<Fit> {
    vec![
        fit(Quantity::Emission).per(Per::Triangle),
        of(Quantity::Albedo, &["wall"], Per::Triangle),
        of(Quantity::Albedo, &["gloss", "lamp"], Per::Material),
        of(Quantity::Diffuse, &["red"], Per::Triangle),
        of(Quantity::Specular, &["gloss"], Per::Triangle),
        of(Quantity::Power, &["gloss"], Per::Triangle),
        moving(MotionKind::Rigid, &["box"]),
        moving(MotionKind::Similarity, &["table"]),
        moving(MotionKind::Vertices, &["lamp"]),
        moving(MotionKind::Scale, &["room", "shelf"]).together(true),
        fit(Quantity::Camera),
    ]
}

/// Deterministic numbers in -1 to 1.
fn wave(n: usize, a: f64) -> Vec<f64> {
    (0..n).map(|i| (a * (i as f64 + 1.0)).sin()).collect()
}

/// A smooth function of all quantities of a scene, and its derivatives.
fn toy(scene: &Scene, request: antirad::plan::GradientRequest) -> (f64, SceneGradient) {
    let mut gradient = SceneGradient::zeros(scene, request);
    let mut sum = 0.0;
    for t in 0..scene.triangles.len() {
        let m = scene.material(t);
        for (quantity, value) in [
            (Quantity::Emission, m.emission),
            (Quantity::Albedo, m.albedo),
            (Quantity::Specular, m.specular),
            (Quantity::Diffuse, [m.diffuse, 0.0, 0.0]),
            (Quantity::Power, [m.power, 0.0, 0.0]),
        ] {
            let weight = [0.3, 0.7, 1.1].map(|a| (a * (t as f64 + 2.0 + quantity as usize as f64)).sin());
            sum += (0..3).map(|c| weight[c] * (value[c] + 0.1 * value[c] * value[c])).sum::<f64>();
            gradient.add_to_triangle(quantity, t, [0, 1, 2].map(|c| weight[c] * (1.0 + 0.2 * value[c])));
        }
    }
    for (v, x) in scene.vertices.iter().enumerate() {
        let weight = DVec3::new((v as f64).sin(), (v as f64).cos(), 0.5);
        sum += weight.dot(*x) + 0.3 * x.length_squared();
        if let Some(positions) = &mut gradient.positions {
            positions[v] += weight + 0.6 * *x;
        }
    }
    let mut by_cameras = Vec::new();
    for (view, camera) in scene.cameras.iter().enumerate() {
        let weight = |a: f64| DVec3::from([0.4, 1.3, 2.2].map(|phase: f64| (a + phase + view as f64).sin()));
        let mut by = CameraGradient::default();
        for (of, vector, by) in [
            (weight(0.1), camera.position, &mut by.position),
            (weight(0.7), camera.target, &mut by.target),
            (weight(1.9), camera.up, &mut by.up),
        ] {
            sum += of.dot(vector) + 0.3 * vector.length_squared();
            *by = of + 0.6 * vector;
        }
        by_cameras.push(by);
    }
    gradient.cameras = Some(by_cameras);
    (sum, gradient)
}

/// A point well within the bounds, but near the limits of σ.
fn inside(parameters: &Parameters, a: f64) -> Vec<f64> {
    let bounds = parameters.bounds();
    let random = wave(parameters.len(), a);
    (0..parameters.len())
        .map(|i| {
            let (lower, upper) = (bounds.lower[i].max(-1.5), bounds.upper[i].min(1.5));
            lower + (upper - lower) * (0.5 + 0.45 * random[i])
        })
        .collect()
}

#[test]
fn derivatives_are_those_of_finite_differences() {
    let scene = scene();
    let parameters = Parameters::new(&scene, &everything(), 10.0).expect("parameters");
    let terms = [
        Regulariser::Smoothness { of: Quantity::Albedo, weight: 0.7 },
        Regulariser::Smoothness { of: Quantity::Specular, weight: 0.7 },
        Regulariser::Smoothness { of: Quantity::Power, weight: 1.7 },
        Regulariser::Smoothness { of: Quantity::Diffuse, weight: 1.7 },
        Regulariser::Smoothness { of: Quantity::Emission, weight: 0.5 },
        Regulariser::Laplacian { weight: 2.0 },
        Regulariser::Sparsity { weight: 3.0 },
        Regulariser::Prior { of: Quantity::Albedo, names: None, value: Some([0.5; 3]), weight: 0.3 },
        Regulariser::Prior { of: Quantity::Power, names: None, value: Some([20.0; 3]), weight: 0.3 },
        Regulariser::Prior { of: Quantity::Position, names: None, value: None, weight: 0.3 },
        Regulariser::Prior { of: Quantity::Camera, names: None, value: None, weight: 0.3 },
    ];
    let regularisers = Regularisers::new(&terms, &parameters).expect("terms");
    let evaluate = |x: &[f64]| {
        let scene = parameters.scene(x);
        let (toy, mut by_scene) = toy(&scene, parameters.gradient_request());
        let mut direct = vec![0.0; x.len()];
        let values = regularisers.evaluate(&parameters, &scene, x, &mut by_scene, &mut direct);
        assert!(values.iter().all(|v| *v > 0.0), "{values:?}");
        let mut gradient = parameters.pull_back(x, &by_scene);
        gradient.iter_mut().zip(&direct).for_each(|(g, d)| *g += d);
        (toy + values.iter().sum::<f64>(), gradient)
    };
    assert!(parameters.len() > 200, "{}", parameters.len());
    for a in [0.9, 2.3] {
        let mut x = inside(&parameters, a);
        let (_, gradient) = evaluate(&x);
        for i in 0..x.len() {
            let (h, here) = (1e-5, x[i]);
            x[i] = here + h;
            let (above, _) = evaluate(&x);
            x[i] = here - h;
            let (below, _) = evaluate(&x);
            x[i] = here;
            let numeric = (above - below) / (2.0 * h);
            let error = (numeric - gradient[i]).abs();
            assert!(error <= 2e-6 * (1.0 + numeric.abs()), "unknown {i}: {} {numeric}", gradient[i]);
        }
    }
}

/// For all unknowns within the bounds, every material passes the scene's check.
#[test]
fn every_point_within_the_bounds_is_a_possible_scene() {
    let scene = scene();
    let parameters = Parameters::new(&scene, &everything(), 10.0).expect("parameters");
    let mut corners = vec![parameters.bounds().lower.clone(), parameters.bounds().upper.clone()];
    for a in [0.7, 1.9, 5.3] {
        let random = wave(parameters.len(), a);
        let bounds = parameters.bounds();
        corners.push(
            (0..random.len())
                .map(|i| if random[i] > 0.0 { bounds.upper[i] } else { bounds.lower[i] })
                .collect(),
        );
    }
    for mut x in corners {
        // Emission and displacements have no upper bound.
        x.iter_mut().for_each(|x| *x = x.clamp(-3.0, 12.0));
        let mut scene = parameters.scene(&x);
        scene.check(false).expect("a possible scene");
        for t in 0..scene.triangles.len() {
            let m = scene.material(t);
            assert!(m.total_albedo() < 1.0 && m.albedo.iter().all(|a| (0.0..1.0).contains(a)), "{m:?}");
            assert!(m.emission.iter().all(|e| *e >= 0.0));
        }
    }
}

#[test]
fn the_start_is_the_scene_as_it_was() {
    let scene = scene();
    let parameters = Parameters::new(&scene, &everything(), 10.0).expect("parameters");
    assert!(parameters.bounds().contain(parameters.start()));
    let start = parameters.scene(parameters.start());
    assert_eq!(start.vertices, scene.vertices);
    assert_eq!(start.cameras, scene.cameras);
    for t in 0..scene.triangles.len() {
        let (now, before) = (start.material(t), scene.material(t));
        let near = |a: f64, b: f64| (a - b).abs() < 1e-12 * (1.0 + b);
        assert!(
            (0..3)
                .all(|c| near(now.albedo[c], before.albedo[c]) && near(now.specular[c], before.specular[c]))
        );
        assert!((0..3).all(|c| near(now.emission[c], before.emission[c])));
        assert!(near(now.power, before.power) && near(now.diffuse, before.diffuse));
    }
    let recovered = parameters.recovered(parameters.start());
    let rigid = recovered.iter().find(|r| r.quantity == "rotation vector").expect("a rotation");
    assert_eq!((rigid.of.as_str(), rigid.value.as_slice()), ("box", &[0.0; 3][..]));
}

#[test]
fn initial_values_and_bounds_are_those_requested() {
    let albedo = of(Quantity::Albedo, &["wall", "gloss"], Per::Material)
        .initial(Some([0.5; 3]))
        .lower(Some([0.1; 3]))
        .upper(Some([0.4, 0.9, 2.0]));
    let parameters = Parameters::new(&scene(), &[albedo], 1.0).expect("parameters");
    let wall = parameters.scene(parameters.start());
    // Clamped to the upper bound.
    assert_eq!(wall.material(0).albedo, [0.4, 0.5, 0.5]);
    assert_eq!(parameters.bounds().upper[..3], [0.4, 0.9, 0.99]);
    // The budget that the fixed σ of the table leaves.
    let gloss = parameters.bounds().upper[3];
    assert!(gloss < 0.4 && gloss > 0.1, "{gloss}");
    assert_eq!(parameters.len(), 6);
}

#[test]
fn what_cannot_be_fitted() {
    let scene = scene();
    let refused = |fits: &[Fit]| {
        let error = Parameters::new(&scene, fits, 1.0).expect_err("not possible");
        (error.fit, error.message)
    };
    let twice = [fit(Quantity::Albedo), of(Quantity::Albedo, &["red"], Per::Triangle)];
    let both = [fit(Quantity::Albedo), fit(Quantity::Diffuse)];
    let named = |name: &str| fit(Quantity::Camera).cameras(Some(vec![name.to_owned()]));
    let meshed = moving(MotionKind::Rigid, &["box"]).materials(Some(vec!["red".into()]));
    for (fits, at, parts) in [
        (&twice[..], 1, vec!["albedo of triangle", "fitted twice"]),
        (&both[..], 1, vec!["product", "fit one"]),
        (&[of(Quantity::Albedo, &["wal"], Per::Mesh)], 0, vec!["material \"wal\"", "did you mean \"wall\"?"]),
        (&[moving(MotionKind::Rigid, &["bix"])], 0, vec!["mesh \"bix\"", "did you mean \"box\"?"]),
        (&[of(Quantity::Albedo, &["chrome"], Per::Mesh)], 0, vec!["it has: wall, red, gloss, lamp"]),
        (&[meshed], 0, vec!["use `meshes`"]),
        (
            &[of(Quantity::Albedo, &["lamp"], Per::Mesh).meshes(Some(vec!["box".into()]))],
            0,
            vec!["no triangle"],
        ),
        (&[fit(Quantity::Albedo).lower(Some([-1.0; 3]))], 0, vec!["albedo: bounds -1"]),
        (&[fit(Quantity::Albedo).lower(Some([0.9; 3])).upper(Some([0.1; 3]))], 0, vec!["0.9 to 0.1"]),
        (&[fit(Quantity::Albedo).lower(Some([1.0; 3]))], 0, vec!["below 0.99"]),
        (&[fit(Quantity::Albedo).initial(Some([f64::NAN; 3]))], 0, vec!["initial albedo"]),
        (&[moving(MotionKind::Vertices, &["box"]).initial(Some([1.0; 3]))], 0, vec!["translation"]),
        (&[moving(MotionKind::Scale, &["box"]).max_scale(Some(0.5))], 0, vec!["max_scale is 0.5"]),
        (&[named("mian")], 0, vec!["no target has the camera \"mian\"", "did you mean \"main\"?"]),
        (&[named("side view")], 0, vec!["they have: main"]),
        (&[fit(Quantity::Camera).cameras(Some(Vec::new()))], 0, vec!["no camera is selected"]),
        (&[fit(Quantity::Camera), named("main")], 1, vec!["camera of target 0 is fitted twice"]),
        (
            &[fit(Quantity::Camera).meshes(Some(vec!["box".into()]))],
            0,
            vec!["use `cameras` instead of `meshes`"],
        ),
        (&[fit(Quantity::Albedo).cameras(Some(vec!["main".into()]))], 0, vec!["instead of `cameras`"]),
        (&[fit(Quantity::Camera).initial(Some([0.0; 3]))], 0, vec!["leave `initial` out"]),
        (&[named("main").max_rotation_degrees(Some(f64::NAN))], 0, vec!["max_rotation_degrees is NaN"]),
        (&[named("main").lower(Some([0.1; 3])).upper(Some([0.0; 3]))], 0, vec!["camera: bounds 0.1 to 0"]),
    ] {
        let (blamed, message) = refused(fits);
        assert_eq!(blamed, at, "{message}");
        says(&message, &parts);
    }
}

#[test]
fn assumptions_about_nothing_are_refused() {
    let parameters = Parameters::new(&scene(), &[fit(Quantity::Albedo)], 1.0).expect("parameters");
    for (term, part) in [
        (Regulariser::Smoothness { of: Quantity::Power, weight: 1.0 }, "power is not fitted"),
        (Regulariser::Smoothness { of: Quantity::Position, weight: 1.0 }, "laplacian"),
        (Regulariser::Smoothness { of: Quantity::Camera, weight: 1.0 }, "prior"),
        (
            Regulariser::Prior { of: Quantity::Camera, names: None, value: None, weight: 1.0 },
            "camera is not fitted",
        ),
        (Regulariser::Laplacian { weight: 1.0 }, "no vertices are fitted"),
        (Regulariser::Sparsity { weight: 1.0 }, "emission is not fitted"),
        (
            Regulariser::Prior { of: Quantity::Emission, names: None, value: None, weight: 1.0 },
            "emission is not fitted",
        ),
        (Regulariser::Smoothness { of: Quantity::Albedo, weight: -1.0 }, "the weight is -1"),
    ] {
        let (at, message) = Regularisers::new(std::slice::from_ref(&term), &parameters).expect_err(part);
        assert_eq!(at, 0);
        says(&message, &[part]);
    }
}

/// A prior of one name has a value at its unknowns alone.
#[test]
fn a_prior_may_be_of_a_few_names() {
    let parameters = Parameters::new(&scene(), &[fit(Quantity::Albedo)], 1.0).expect("parameters");
    let groups = parameters.groups_of(Quantity::Albedo);
    assert!(groups.len() > 1, "{groups:?}");
    let (name, unknowns) = groups[1].clone();
    let prior = |name: &str| {
        let names = Some(vec![name.to_owned()]);
        [Regulariser::Prior { of: Quantity::Albedo, names, value: Some([0.25; 3]), weight: 3.0 }]
    };
    let terms = Regularisers::new(&prior(name), &parameters).expect("a term");
    let x = vec![0.5; parameters.len()];
    let (mut by_scene, mut by_unknowns) = (SceneGradient::default(), vec![0.0; x.len()]);
    let values = terms.evaluate(&parameters, &parameters.scene(&x), &x, &mut by_scene, &mut by_unknowns);
    assert!((values[0] - 3.0 * 0.25 * 0.25).abs() < 1e-12, "{values:?}");
    for (i, by) in by_unknowns.into_iter().enumerate() {
        let expected = if unknowns.contains(&i) { 2.0 * 0.25 } else { 0.0 };
        assert!((by - expected).abs() < 1e-12, "{i}: {by}");
    }
    let (_, message) = Regularisers::new(&prior("nothing"), &parameters).expect_err("a name that is unknown");
    says(&message, &["no albedo is fitted of \"nothing\"", name]);
}

/// A camera moves as a whole, within its bounds; views of one camera move together, and others stay.
#[test]
fn cameras_move_as_they_are() {
    let mut scene = scene();
    let other = Camera { name: String::from("other"), fov_x_degrees: 50.0, ..scene.cameras[0].clone() };
    scene.cameras = vec![scene.cameras[0].clone(), other.clone(), scene.cameras[0].clone()];
    let main = fit(Quantity::Camera)
        .cameras(Some(vec!["main".into()]))
        .lower(Some([-0.1, 0.0, -0.1]))
        .upper(Some([0.1; 3]));
    let parameters = Parameters::new(&scene, &[main], 1.0).expect("parameters");
    assert_eq!(parameters.len(), 6);
    assert_eq!(parameters.scene(parameters.start()).cameras, scene.cameras);
    let moved = parameters.scene(&parameters.bounds().upper);
    assert_eq!((&moved.cameras[1], &moved.cameras[2]), (&other, &moved.cameras[0]));
    let (before, now) = (&scene.cameras[0], &moved.cameras[0]);
    assert!((now.position - before.position).abs_diff_eq(DVec3::splat(0.1), 1e-12));
    let lines = |camera: &Camera| (camera.target - camera.position, camera.up);
    let ((ahead, up), (ahead_before, up_before)) = (lines(now), lines(before));
    let turn = DQuat::from_scaled_axis(DVec3::splat(5f64.to_radians()));
    assert!(ahead.abs_diff_eq(turn * ahead_before, 1e-12) && up.abs_diff_eq(turn * up_before, 1e-12));
    let recovered = parameters.recovered(&parameters.bounds().upper);
    let found: Vec<(&str, &str, &str)> = recovered.iter().map(|r| (r.quantity, &r.of[..], r.unit)).collect();
    let expected = [
        ("camera position", "main", "m"),
        ("camera displacement", "main", "m"),
        ("camera rotation vector", "main", "degrees"),
    ];
    assert_eq!(found, expected);
    assert!(recovered.iter().all(|r| r.at_bound == [true; 3]));
    assert!(recovered[2].value.iter().all(|angle| (angle - 5.0).abs() < 1e-12), "{:?}", recovered[2]);
}

/// Cameras that move together keep their places to each other but for a factor, and derivatives are exact.
#[test]
fn cameras_move_together() {
    let mut scene = scene();
    let first = scene.cameras[0].clone();
    let position = first.position + DVec3::new(0.5, 0.2, 0.1);
    scene.cameras.push(Camera { name: String::from("other"), position, ..first });
    let together = fit(Quantity::Camera).together(true);
    let similarity = together.clone().motion(MotionKind::Similarity);
    let parameters = Parameters::new(&scene, &[similarity], 1.0).expect("parameters");
    assert_eq!(parameters.len(), 7);
    assert_eq!(parameters.scene(parameters.start()).cameras, scene.cameras);
    let mut x = inside(&parameters, 0.7);
    let moved = parameters.scene(&x).cameras;
    let recovered = parameters.recovered(&x);
    let found: Vec<(&str, &str, usize)> =
        recovered.iter().map(|r| (r.quantity, &r.of[..], r.value.len())).collect();
    let expected = [
        ("camera displacement", "cameras", 3),
        ("camera rotation vector", "cameras", 3),
        ("camera scale", "cameras", 1),
        ("camera transform", "cameras", 12),
    ];
    assert_eq!(found, expected);
    let factor = recovered[2].value[0];
    assert!((factor - 1.0).abs() > 1e-4);
    let apart = |cameras: &[Camera]| (cameras[1].position - cameras[0].position).length();
    assert!((apart(&moved) - factor * apart(&scene.cameras)).abs() < 1e-12);
    assert!((moved[1].up.length() - scene.cameras[1].up.length()).abs() < 1e-12);
    let loss = |x: &[f64]| {
        let (value, gradient) = toy(&parameters.scene(x), parameters.gradient_request());
        (value, parameters.pull_back(x, &gradient))
    };
    let (_, gradient) = loss(&x);
    for i in 0..x.len() {
        let h = 1e-4;
        let mut at = |step: f64| {
            x[i] += step;
            let value = loss(&x).0;
            x[i] -= step;
            value
        };
        let numeric = (at(h) - at(-h)) / (2.0 * h);
        assert!(
            (numeric - gradient[i]).abs() < 1e-8 * (1.0 + numeric.abs()),
            "{i}: {numeric}, {}",
            gradient[i]
        );
    }
    let rigid = Parameters::new(&scene, std::slice::from_ref(&together), 1.0).expect("parameters");
    assert_eq!(rigid.len(), 6);
    let vertices = together.motion(MotionKind::Vertices);
    let error = Parameters::new(&scene, &[vertices], 1.0).expect_err("no vertices");
    says(&error.to_string(), &["cameras that move together", "similarity"]);
}

/// Values that no view shows are reported per fit, and no others.
#[test]
fn unseen_values_are_counted() {
    let scene = scene();
    let fits = everything();
    let parameters = Parameters::new(&scene, &fits, 10.0).expect("parameters");
    let all = parameters.unseen(&vec![false; scene.triangles.len()]);
    // All but the cameras.
    assert_eq!(all.len(), fits.len() - 1);
    assert!(all.iter().all(|unseen| unseen.unseen == unseen.values && unseen.values > 0), "{all:?}");
    assert_eq!(parameters.unseen(&vec![true; scene.triangles.len()]), []);
    // For one triangle out of view, only the values of its own.
    let mut seen = vec![true; scene.triangles.len()];
    seen[0] = false;
    let one = parameters.unseen(&seen);
    assert_eq!(
        (one[0].quantity, one[0].unseen, one[0].values),
        (Quantity::Emission, 1, scene.triangles.len())
    );
    says(&one[0].to_string(), &["1 of ", "emission", "antirad ambiguity"]);
}
