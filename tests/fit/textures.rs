//! Fits of albedo textures, and of what photos leave unknown.

use super::scenes::watch;
use crate::support::{backend, finish};
use antirad::fit::{
    EngineRenderer, Exposure, Fit, Job, LossKind, Per, Regulariser, Renderer, RunOptions, Settings, StopRule,
    Target,
};
use antirad::render::Quantity;
use antirad::scene::{Camera, LoadOptions, Scene};
use glam::DVec3;
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
        Fit::new(Quantity::Albedo).per(Per::Mesh).meshes(meshes("wall")),
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

/// A job whose targets are pictures of the truth, times such gains.
fn job(settings: Settings, exposure: Exposure, gains: [DVec3; 2]) -> (Job, EngineRenderer, Vec<f64>) {
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
        blank(camera, picture.iter().map(|radiance| gain * *radiance).collect()).exposed(exposure)
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

/// Through the pictures, the means over triangles that light transport sees, and the gains that are projected out.
#[test]
fn derivatives_by_texels_are_those_of_central_differences() {
    for exposure in [Exposure::default(), Exposure::GAIN_AND_WHITE_BALANCE] {
        let even = Regulariser::TotalVariation { weight: 0.1 };
        let settings =
            Settings::new(fits()).loss(LossKind::Huber).tolerance(Some(1e-7)).regularisers(vec![even]);
        let gains = [DVec3::new(1.3, 0.7, 1.0), DVec3::splat(0.5)];
        let (job, mut renderer, x) = job(settings, exposure, gains);
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
            assert!(off <= 2e-3 * largest, "{exposure:?}, unknown {k}: {}, not {difference}", gradient[k]);
        }
    }
}

#[test]
fn textures_lamps_and_exposures_are_found() {
    let gains = [DVec3::new(1.3, 0.7, 1.0), DVec3::new(0.5, 0.6, 0.5)];
    for (exposure, gains) in
        [(Exposure::default(), [DVec3::ONE; 2]), (Exposure::GAIN_AND_WHITE_BALANCE, gains)]
    {
        let settings = Settings::new(fits()).loss(LossKind::Huber).tolerance(Some(1e-5));
        let (mut job, mut renderer, truth) = job(settings, exposure, gains);
        let stop = StopRule::default().iterations(60).relative_decrease(1e-6);
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
                expected += albedo(&parameters.scene(&truth)) / 3.0;
            }
            off += (found - expected).length_squared() / 3.0;
        }
        let rms = (off / painting.triangles().len() as f64).sqrt();
        assert!(rms <= 0.02, "{exposure:?}: albedo {rms}");
        // Light and exposures share a factor for each channel.
        let emission = DVec3::from(outcome.scene.material(20).emission);
        for (found, gain) in outcome.gains.iter().zip(gains) {
            let product = *found * emission / (gain * 5.0);
            assert!((product - 1.0).abs().max_element() <= 0.03, "{exposure:?}: {found} {emission}");
        }
    }
}

#[test]
fn a_texture_needs_texture_coordinates() {
    let fits = vec![Fit::new(Quantity::Albedo).per(Per::Texel)];
    let target = Target::new(cameras()[0].clone(), vec![DVec3::ONE; 32 * 24], None, 1.0).expect("a target");
    let refused = Job::new("none", scene(), vec![target], Settings::new(fits)).map(|_| ());
    let message = refused.expect_err("no texture coordinates").to_string();
    assert!(message.contains("has no texture coordinates") && message.contains("\"wall\""), "{message}");
}
