//! Fits of albedo textures, and of what photos leave unknown.

use super::scenes::watch;
use crate::support::{backend, finish};
use antirad::backend::Backend;
use antirad::export::{Format, export};
use antirad::fit::{
    EngineRenderer, Exposure, Fit, Job, JobFile, LossKind, Outcome, Per, Regulariser, Renderer, RunOptions,
    Settings, StopRule, Target, UnknownResponse,
};
use antirad::image::Picture;
use antirad::render::Quantity;
use antirad::scene::{BinLayout, Camera, LoadOptions, Material, Mesh, Orient, Scene, SceneBuilder, Shape};
use antirad_scene::{linear_from_srgb, srgb_from_linear};
use glam::{DAffine3, DVec3};
use std::f64::consts::TAU;
use std::fmt::Write;
use std::ops::ControlFlow;

/// Texels along a side.
const SIDE: u32 = 4;

/// A floor with texture coordinates in front of a wall without, under a lamp.
fn scene() -> Scene {
    let mut obj = String::from("mtllib s.mtl\no floor\nusemtl grey\n");
    for row in 0..4 {
        for column in 0..4 {
            let (x, z) = (f64::from(column) / 3.0, f64::from(row) / 3.0);
            writeln!(obj, "v {x} 0 {z}\nvt {} {}", 0.05 + 0.9 * x, 0.05 + 0.9 * z).expect("a string");
        }
    }
    for row in 0..3 {
        for column in 0..3 {
            let a = 4 * row + column + 1;
            let [b, c, d] = [a + 1, a + 5, a + 4];
            writeln!(obj, "f {a}/{a} {d}/{d} {c}/{c}\nf {a}/{a} {c}/{c} {b}/{b}").expect("a string");
        }
    }
    obj.push_str("o wall\nusemtl grey\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2\nf -4 -2 -1\n");
    obj.push_str("o lamp\nusemtl lamp\nv .3 1 .3\nv .7 1 .3\nv .7 1 .7\nv .3 1 .7\nf -4 -3 -2\nf -4 -2 -1\n");
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("s.obj"), obj).expect("written");
    std::fs::write(
        folder.path().join("s.mtl"),
        "newmtl grey\nKd .5 .5 .5\nnewmtl lamp\nKd 0 0 0\nKe 5 5 5\n",
    )
    .expect("written");
    let toml = "[[mesh]]\npath = \"s.obj\"\nobjects = true\norient = \"keep\"\n[settings]\nbins = { concentric = 4 }\n";
    let path = folder.path().join("s.toml");
    std::fs::write(&path, toml).expect("written");
    Scene::load(&path, &LoadOptions::default()).expect("a scene")
}

fn cameras() -> Vec<Camera> {
    let at = |name: &str, position: [f64; 3], target: [f64; 3]| Camera {
        name: name.into(),
        position: position.into(),
        target: target.into(),
        up: DVec3::Y,
        fov_x_degrees: 50.0,
        width: 32,
        height: 24,
    };
    // The second one sees the lamp, too.
    vec![at("above", [0.2, 1.2, 1.4], [0.5, 0.1, 0.4]), at("below", [0.9, 0.4, 2.2], [0.5, 0.5, 0.4])]
}

fn fits() -> Vec<Fit> {
    let meshes = |name: &str| Some(vec![name.to_owned()]);
    vec![
        Fit::new(Quantity::Albedo).per(Per::Texel).resolution(Some(SIDE)).meshes(meshes("floor")),
        // Its material is that of the floor, too.
        Fit::new(Quantity::Albedo).per(Per::Mesh).meshes(meshes("wall")).materials(meshes("grey")),
        Fit::new(Quantity::Emission).per(Per::Mesh).meshes(meshes("lamp")).initial(Some([3.0; 3])),
    ]
}

/// Unknowns of a scene with a pattern on its floor, a wall of .7 and the lamp as it is.
fn truth(job: &Job) -> Vec<f64> {
    let parameters = &job.problem().parameters;
    let mut x = parameters.start().to_vec();
    let texels = 3 * (SIDE * SIDE) as usize;
    for (k, x) in x[..texels].iter_mut().enumerate() {
        *x = 0.5 + 0.3 * (1.9 * k as f64).sin();
    }
    x[texels..texels + 3].fill(0.7);
    for (unknown, value) in parameters.unknowns_of(Quantity::Emission).into_iter().zip([5.0; 3]) {
        x[unknown] = value / parameters.scale(Quantity::Emission);
    }
    x
}

/// A job whose targets are pictures of the truth, times such gains, as a camera takes them.
fn job(
    settings: Settings,
    gains: [DVec3; 2],
    taken: &dyn Fn(Target) -> Target,
) -> (Job, EngineRenderer, Vec<f64>) {
    let backend = backend();
    let blank = |camera: Camera, pixels| Target::new(camera, pixels, None, 1.0).expect("a target");
    let black = |camera: Camera| blank(camera, vec![DVec3::ZERO; 32 * 24]);
    let draft = Job::new("draft", scene(), cameras().into_iter().map(black).collect(), settings.clone());
    let draft = draft.expect("a job");
    let seen = Scene { cameras: cameras(), ..draft.problem().parameters.scene(&truth(&draft)) };
    let mut renderer =
        EngineRenderer::new(&backend, seen.clone(), settings.supersample, Default::default(), watch())
            .expect("a renderer");
    let pictures = renderer.pictures(&seen).expect("pictures");
    drop(renderer);
    let exposed = |((camera, picture), gain): ((Camera, Vec<DVec3>), DVec3)| {
        taken(blank(camera, picture.iter().map(|radiance| gain * *radiance).collect()))
    };
    let targets = cameras().into_iter().zip(pictures).zip(gains).map(exposed).collect();
    let job = Job::new("textures", scene(), targets, settings).expect("a job");
    let parameters = &job.problem().parameters;
    let renderer = EngineRenderer::new(
        &backend,
        parameters.planning_scene(),
        job.settings().supersample,
        parameters.gradient_request(),
        watch(),
    );
    let renderer = renderer.expect("a renderer").paintings(parameters.paintings());
    let x = truth(&job);
    finish(&backend);
    (job, renderer, x)
}

/// Radiance of white.
const WHITE: f64 = 2.0;

/// What decoding by sRGB makes of exposure, of that of white, by a camera with an exponent of 1.8 and more contrast.
fn contrasty(exposure: f64) -> f64 {
    let number = exposure.clamp(0.0, 1.0).powf(1.0 / 1.8);
    linear_from_srgb(number - 0.4 / TAU * (TAU * number).sin())
}

/// A picture of such a camera, clipped at white; whether its response is to be found.
fn photo(target: Target, unknown: bool) -> Target {
    let pixels = target.pixels.iter().map(|light| light.map(|light| WHITE * contrasty(light / WHITE)));
    let response = unknown.then_some(UnknownResponse { white: WHITE, shared: 0 });
    let photo = Target { pixels: pixels.collect(), response, ..target };
    photo.exposed(Exposure::GAIN_AND_WHITE_BALANCE).clipped_from(0.99 * WHITE)
}

/// Through the pictures, the means over triangles that light transport sees, and the gains and responses that are projected out.
#[test]
fn derivatives_by_texels_are_those_of_central_differences() {
    let cameras: [&dyn Fn(Target) -> Target; 3] =
        [&|target| target, &|target| target.exposed(Exposure::GAIN_AND_WHITE_BALANCE), &|target| {
            photo(target, true)
        }];
    for (camera, taken) in cameras.into_iter().enumerate() {
        let even = Regulariser::TotalVariation { weight: 0.1 };
        let settings =
            Settings::new(fits()).loss(LossKind::Huber).tolerance(Some(1e-7)).regularisers(vec![even]);
        let gains = [DVec3::new(1.3, 0.7, 1.0), DVec3::splat(0.5)];
        let (job, mut renderer, x) = job(settings, gains, taken);
        let problem = job.problem();
        let here: Vec<f64> =
            x.iter().enumerate().map(|(k, x)| x * (1.0 + 0.2 * (0.7 * k as f64).cos())).collect();
        let gradient = problem.evaluate(&here, &mut renderer).expect("an evaluation").gradient;
        let largest = gradient.iter().fold(0.0, |largest: f64, g| largest.max(g.abs()));
        for k in (0..here.len()).step_by(7).chain(here.len() - 6..here.len()) {
            let mut at = |step: f64| {
                let mut moved = here.clone();
                moved[k] += step;
                renderer.forget();
                problem.judge(&moved, &mut renderer).expect("a value").value
            };
            let step = 1e-3;
            let difference = (at(step) - at(-step)) / (2.0 * step);
            let off = (gradient[k] - difference).abs();
            assert!(off <= 2e-3 * largest, "camera {camera}, unknown {k}: {}, not {difference}", gradient[k]);
        }
    }
}

/// The outcome of a job, and the root mean square error of the floor's albedo.
fn found(mut job: Job, mut renderer: EngineRenderer, truth: &[f64], iterations: u32) -> (Outcome, f64) {
    let stop = StopRule::default().iterations(iterations).relative_decrease(1e-6);
    let outcome = job
        .run(&mut renderer, &RunOptions::default().stop(stop), &mut |_, _| ControlFlow::Continue(()))
        .expect("an outcome");
    let parameters = &job.problem().parameters;
    let painting = &parameters.paintings()[0];
    let mut off = 0.0;
    for &t in painting.triangles() {
        let [mut found, mut expected] = [DVec3::ZERO; 2];
        for corner in DVec3::AXES.map(|corner| 0.6 * corner + DVec3::splat(0.4 / 3.0)) {
            let albedo = |scene: &Scene| {
                let factors = scene.patterns.at(t as usize, corner).expect("a pattern");
                factors.value[0] * DVec3::from(scene.material(t as usize).albedo)
            };
            found += albedo(&outcome.scene) / 3.0;
            expected += albedo(&parameters.scene(truth)) / 3.0;
        }
        off += (found - expected).length_squared() / 3.0;
    }
    let rms = (off / painting.triangles().len() as f64).sqrt();
    (outcome, rms)
}

#[test]
fn textures_lamps_and_exposures_are_found() {
    let gains = [DVec3::new(1.3, 0.7, 1.0), DVec3::new(0.5, 0.6, 0.5)];
    for (exposure, gains) in
        [(Exposure::default(), [DVec3::ONE; 2]), (Exposure::GAIN_AND_WHITE_BALANCE, gains)]
    {
        let settings = Settings::new(fits()).loss(LossKind::Huber).tolerance(Some(1e-5));
        let (job, renderer, truth) = job(settings, gains, &|target| target.exposed(exposure));
        let (outcome, rms) = found(job, renderer, &truth, 60);
        assert!(rms <= 0.02, "{exposure:?}: albedo {rms}");
        // Light and exposures share a factor for each channel.
        let emission = DVec3::from(outcome.scene.material(20).emission);
        for (found, gain) in outcome.sensors.iter().map(|sensor| sensor.gain).zip(gains) {
            let product = found * emission / (gain * 5.0);
            assert!((product - 1.0).abs().max_element() <= 0.03, "{exposure:?}: {found} {emission}");
        }
    }
}

#[test]
fn responses_of_cameras_are_found() {
    let gains = [DVec3::new(3.0, 2.0, 2.5), DVec3::new(1.5, 1.6, 1.5)];
    let fit = |unknown: bool, iterations: u32| {
        let settings = Settings::new(fits()).loss(LossKind::Huber).tolerance(Some(1e-5));
        let (job, renderer, truth) = job(settings, gains, &|target| photo(target, unknown));
        found(job, renderer, &truth, iterations)
    };
    let ((outcome, rms), (_, rms_as_srgb)) = (fit(true, 40), fit(false, 10));
    assert!(rms <= 0.03, "albedo {rms}");
    assert!(rms_as_srgb >= 3.0 * rms, "albedo {rms_as_srgb} as sRGB, {rms} otherwise");
    let curve = outcome.sensors[0].curve.expect("a response");
    assert_eq!(outcome.sensors[1].curve, Some(curve));
    // Up to a factor of exposure.
    let off = |factor: f64| {
        let off = |k: u32| {
            let exposure = 0.05 * f64::from(k);
            srgb_from_linear(curve.value(factor * exposure)) - srgb_from_linear(contrasty(exposure))
        };
        (1..=16).map(off).fold(0.0, |most: f64, off| most.max(off.abs()))
    };
    let off = (50..200).map(|k| off(0.01 * f64::from(k))).fold(f64::INFINITY, f64::min);
    assert!(off <= 0.02, "{curve:?} is {off} off");
}

/// A job of a scene with such settings, and its renderer.
fn ready(backend: &Backend, scene: Scene, targets: Vec<Target>, settings: Settings) -> (Job, EngineRenderer) {
    let job = Job::new("job", scene, targets, settings).expect("a job");
    let parameters = &job.problem().parameters;
    let (planning, request) = (parameters.planning_scene(), parameters.gradient_request());
    let renderer = EngineRenderer::new(backend, planning, job.settings().supersample, request, watch());
    let renderer = renderer.expect("a renderer").paintings(parameters.paintings());
    (job, renderer)
}

fn pictures(backend: &Backend, scene: &Scene, supersample: u32) -> Vec<Vec<DVec3>> {
    let renderer = EngineRenderer::new(backend, scene.clone(), supersample, Default::default(), watch());
    renderer.expect("a renderer").pictures(scene).expect("pictures")
}

/// A box of two tones on a floor, under a lamp; none has texture coordinates.
fn two_tones(tones: [f64; 2]) -> Scene {
    let mut builder = SceneBuilder::new();
    let grey = |name: &str, albedo: f64| Material { albedo: [albedo; 3], ..Material::named(name) };
    let place = |at: [f64; 3], size: f64| {
        DAffine3::from_translation(at.into()) * DAffine3::from_scale(DVec3::splat(size))
    };
    builder.shape("box", Shape::Box { cells: 2 }, &grey("dark", tones[0]), place([0.0; 3], 1.0));
    builder.shape("floor", Shape::Quad { cells: 2 }, &grey("floor", 0.5), place([-1.0, 0.0, -1.0], 3.0));
    let lamp = Material { emission: [20.0; 3], ..grey("lamp", 0.0) };
    let down = DAffine3::from_rotation_x(std::f64::consts::PI);
    builder.shape("lamp", Shape::Quad { cells: 1 }, &lamp, place([1.2, 2.5, 2.2], 1.0) * down);
    let mut scene = builder.finish("box").expect("a scene");
    let light = scene.materials.len() as u32;
    scene.materials.push(grey("light", tones[1]));
    for t in scene.meshes[0].range.clone() {
        let [a, b, c] = scene.corners(t as usize);
        let cell = ((a + b + c) / 1.5).floor();
        if (cell.x + cell.y + cell.z) as i64 % 2 == 0 {
            scene.triangles[t as usize].material = light;
        }
    }
    scene.settings.bins = BinLayout::Concentric { n: 4 };
    let camera = |name: &str, position: [f64; 3]| Camera {
        name: name.into(),
        position: position.into(),
        target: DVec3::splat(0.5),
        up: DVec3::Y,
        fov_x_degrees: 40.0,
        width: 48,
        height: 40,
    };
    scene.cameras = vec![camera("left", [1.5, 2.0, 3.0]), camera("right", [3.0, 2.0, 1.5])];
    scene
}

/// The squares of a box that has no texture coordinates, and the pictures of what is written.
#[test]
fn a_pattern_is_found_on_a_mesh_without_texture_coordinates() {
    let backend = backend();
    let truth = two_tones([0.2, 0.7]);
    let box_alone = Some(vec![String::from("box")]);
    let fit = Fit::new(Quantity::Albedo).per(Per::Texel).resolution(Some(32)).meshes(box_alone);
    let even = Regulariser::TotalVariation { weight: 1e-3 };
    let settings =
        Settings::new(vec![fit]).loss(LossKind::Huber).tolerance(Some(1e-5)).regularisers(vec![even]);
    let seen = pictures(&backend, &truth, settings.supersample);
    let target = |(camera, pixels)| Target::new(camera, pixels, None, 1.0).expect("a target");
    let targets: Vec<Target> = truth.cameras.iter().cloned().zip(seen).map(target).collect();
    let (mut job, mut renderer) = ready(&backend, two_tones([0.5; 2]), targets, settings);
    let stop = StopRule::default().iterations(60);
    let outcome = job
        .run(&mut renderer, &RunOptions::default().stop(stop), &mut |_, _| ControlFlow::Continue(()))
        .expect("an outcome");
    drop(renderer);
    // The sides that both cameras see: x = 1, y = 1, z = 1.
    let is_seen = |t: &usize| truth.area_vector(*t).dot(DVec3::ONE) > 0.0;
    let of_box = truth.meshes[0].range.clone().map(|t| t as usize).filter(is_seen);
    let off = |t: usize| outcome.scene.material(t).albedo[1] - truth.material(t).albedo[1];
    let squares: Vec<f64> = of_box.map(|t| off(t).powi(2)).collect();
    let rms = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
    assert!(squares.len() == 24 && rms <= 0.04, "{rms}");

    let folder = tempfile::tempdir().expect("a folder");
    let path = |name: &str| folder.path().join(name);
    outcome.scene.save(&path("s.toml")).expect("written");
    export(&outcome.scene, Format::Gltf, &path("s.glb"), None).expect("written");
    for name in ["s.toml", "s.glb"] {
        let read = Scene::load(&path(name), &LoadOptions::default().orient(Orient::Keep)).expect("read");
        let read = Scene { cameras: outcome.scene.cameras.clone(), settings: outcome.scene.settings, ..read };
        for (before, after) in
            outcome.pictures.iter().zip(pictures(&backend, &read, job.settings().supersample))
        {
            let brightest = before.iter().fold(0.0, |most: f64, pixel| most.max(pixel.max_element()));
            for (a, b) in before.iter().zip(after) {
                // Rays follow the light of the start of the fit here, and of its end there.
                assert!((*a - b).abs().max_element() <= 5e-3 * brightest, "{name}: {a} {b}");
            }
        }
    }
    finish(&backend);
}

#[test]
fn a_texture_needs_room_for_its_charts() {
    let fits = vec![Fit::new(Quantity::Albedo).per(Per::Texel).resolution(Some(1))];
    let target = Target::new(cameras()[0].clone(), vec![DVec3::ONE; 32 * 24], None, 1.0).expect("a target");
    let refused = Job::new("none", scene(), vec![target], Settings::new(fits)).map(|_| ());
    let message = refused.expect_err("no room").to_string();
    for part in ["\"wall\" has no texture coordinates", "1 x 1", "resolution = 2", "per = \"triangle\""] {
        assert!(message.contains(part), "{message}");
    }
}

/// What a job of pictures fits if it does not say: one albedo for each mesh; a texture over all but lamps if there is one mesh alone.
#[test]
fn a_mesh_that_is_alone_gets_a_texture() {
    let objects = two_tones([0.2, 0.7]);
    let mut alone = objects.clone();
    let all = 0..objects.triangles.len() as u32;
    alone.meshes = vec![Mesh { name: "room".into(), range: all.clone() }];
    alone.origins.truncate(1);
    let lamps = all.filter(|&t| objects.material(t as usize).emission != [0.0; 3]).count();
    assert!(lamps > 0 && objects.meshes.len() == 3);
    for (scene, textures, said) in [
        (&objects, vec![], "each other mesh has one albedo"),
        (&alone, vec![objects.triangles.len() - lamps], "gets some, and a texture: room (64 x 64)"),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        scene.save(&folder.path().join("s.toml")).expect("written");
        let pixels = vec![[0.5, 0.5, 0.5, 1.0]; 64 * 48];
        Picture { width: 64, height: 48, pixels }.write_exr(folder.path().join("a.exr")).expect("written");
        // From above, the lamp aside.
        let frames = r#"{ "fl_x": 60, "fl_y": 60, "cx": 32, "cy": 24, "w": 64, "h": 48, "frames": [{ "file_path": "a.exr",
            "transform_matrix": [[1, 0, 0, 0.5], [0, 0, 1, 4], [0, -1, 0, 0.5], [0, 0, 0, 1]] }] }"#;
        std::fs::write(folder.path().join("transforms.json"), frames).expect("written");
        let path = folder.path().join("job.toml");
        std::fs::write(&path, "scene = \"s.toml\"\n[[target]]\ncameras = \"transforms.json\"\n")
            .expect("written");
        let file = JobFile::load(&path).unwrap_or_else(|error| panic!("{error}"));
        let paintings = file.job.problem().parameters.paintings();
        let sizes: Vec<usize> = paintings.iter().map(|painting| painting.triangles().len()).collect();
        assert_eq!(sizes, textures, "{:?}", file.warnings);
        assert!(file.warnings.iter().any(|warning| warning.contains(said)), "{:?}", file.warnings);
    }
}
