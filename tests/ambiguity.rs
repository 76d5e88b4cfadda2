//! What pictures leave undetermined, checked by rendering the other explanations.

mod support;

use antirad::Watch;
use antirad::ambiguity::{DirectLight, FirstBounce, Given, Polytope, Views};
use antirad::backend::Backend;
use antirad::image::Rasterizer;
use antirad::scene::{Camera, Lamps, LoadOptions, Scene, VisibilityChoice};
use std::fs;
use std::ops::ControlFlow;
use std::sync::Arc;
use support::{areas, backend, finish, solve};

/// A room with a closed screen; the lamp lies behind it, so that the camera sees its light on the walls alone.
const ROOM: &str = r#"[[mesh]]
shape = { kind = "room", cells = 3 }
material = "wall"

[[mesh]]
shape = { kind = "box", cells = 1 }
material = "screen"
scale = [0.7, 0.75, 0.05]
translate = [0.15, 0, 0.55]

[[mesh]]
shape = { kind = "quad", cells = 1 }
material = "lamp"
scale = 0.3
translate = [0.35, 0.2, 0.68]

[material.wall]
albedo = [0.7, 0.5, 0.3]

[material.screen]
albedo = [0.4, 0.6, 0.5]

[material.lamp]
emission = [20, 15, 10]

[camera.main]
position = [0.5, 0.3, 0.02]
target = [0.5, 0.3, 1]
fov_x_degrees = 100
width = 48
height = 48

[settings]
tolerance = 1e-6
"#;

fn room() -> Scene {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("room.toml");
    fs::write(&path, ROOM).expect("written");
    let mut scene = Scene::load(&path, &LoadOptions::default()).expect("a scene");
    // All emitters take the same way.
    scene.settings = scene.settings.lamps(Lamps::Antiradiance).visibility(VisibilityChoice::Implicit);
    scene
}

/// Relative to the mean radiance: shadows of this coarse room are no better.
const NOISE: f64 = 0.02;

struct Case {
    backend: Backend,
    scene: Scene,
    views: Views,
    direct: DirectLight,
    watch: Watch,
}

impl Case {
    fn new() -> Self {
        let (backend, scene) = (backend(), room());
        let rasterizer = Rasterizer::new(&backend).expect("a rasterizer");
        let cameras: Vec<&Camera> = scene.cameras.iter().collect();
        let views = Views::new(&rasterizer, &scene, &cameras, 4).expect("views");
        let watch: Watch = Arc::new(|| ControlFlow::Continue(()));
        let direct = DirectLight::new(&backend, &scene, &watch).expect("direct light");
        Self { backend, scene, views, direct, watch }
    }

    /// Colours of seen faces with other emissions.
    fn seen_colours(&self, emission: &[[f64; 3]]) -> Vec<[f64; 3]> {
        // Light is linear in emission, and a scene admits no negative emission.
        let part = |sign: f64| {
            let part: Vec<[f64; 3]> = emission.iter().map(|e| e.map(|e| (sign * e).max(0.0))).collect();
            let scene = self.scene.with_emission(&part);
            let (mut engine, solution) = solve(&self.backend, &scene, &scene.settings);
            engine.face_colours(&solution, scene.cameras[0].position).expect("colours")
        };
        let colours = part(1.0).into_iter().zip(part(-1.0)).map(|(a, b)| [0, 1, 2].map(|c| a[c] - b[c]));
        colours.zip(&self.views.seen).filter(|(_, seen)| **seen).map(|(c, _)| c).collect()
    }

    fn emission(&self) -> Vec<[f64; 3]> {
        (0..self.scene.triangles.len()).map(|i| self.scene.material(i).emission).collect()
    }
}

/// The largest difference, relative to the largest value.
fn difference(a: &[[f64; 3]], b: &[[f64; 3]]) -> f64 {
    assert!(!a.is_empty() && a.len() == b.len());
    let flat = |x: &[[f64; 3]]| x.iter().flatten().copied().collect::<Vec<f64>>();
    let (a, b) = (flat(a), flat(b));
    let most = a.iter().copied().fold(0.0, f64::max);
    a.iter().zip(&b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max) / most
}

#[test]
fn the_first_bounce_of_a_hidden_lamp_looks_like_the_lamp() {
    let mut case = Case::new();
    let cameras: Vec<&Camera> = case.scene.cameras.iter().collect();
    let bounce =
        FirstBounce::new(&case.backend, &case.scene, &cameras, &case.views, &mut case.direct, &case.watch)
            .expect("a first bounce")
            .expect("a hidden lamp");
    assert_eq!(bounce.hidden_lights.len(), 2);
    assert!(bounce.picture_difference <= 1e-5 && bounce.largest_difference <= 1e-5, "{bounce:?}");
    // The other explanation: the lamp is dark, the walls emit.
    assert!(bounce.hidden_lights.iter().all(|&i| bounce.emission[i].iter().all(|&e| e.abs() < 1e-6)));
    assert!(bounce.emission.iter().flatten().sum::<f64>() > 1.0);
    finish(&case.backend);
}

/// Each of some unseen triangles at its maximum, as the only hidden light: the seen faces look the same, no emission is
/// negative, and one is zero.
#[test]
fn the_ends_of_intervals_explain_the_picture() {
    let mut case = Case::new();
    let unseen = case.views.unseen(&case.scene);
    assert!(unseen.len() > 20 && unseen.len() < case.scene.triangles.len() - 20, "{}", unseen.len());
    let light = case.direct.columns(&unseen, &mut |_| ()).expect("columns");
    let truth = case.emission();
    let areas = areas(&case.scene);
    let polytopes: Vec<Polytope> = (0..3)
        .map(|channel| {
            let pick = |of: &dyn Fn(usize) -> [f64; 3]| -> Vec<f64> {
                (0..truth.len()).map(|i| of(i)[channel]).collect()
            };
            Polytope::new(&Given {
                direct: &light,
                albedo: &pick(&|i| case.scene.material(i).diffuse_albedo()),
                emission: &pick(&|i| truth[i]),
                areas: &areas,
                seen: &case.views.seen,
                unseen: &unseen,
                noise: NOISE,
            })
            .expect("a polytope")
        })
        .collect();
    let lamp = (0..unseen.len()).find(|&k| truth[unseen[k]][0] > 0.0).expect("the lamp is unseen");
    let seen = case.seen_colours(&truth);
    let mut bounded = 0;
    for k in [lamp, 0, unseen.len() / 2, unseen.len() - 1] {
        let mut emission = vec![[0.0; 3]; truth.len()];
        for (channel, polytope) in polytopes.iter().enumerate() {
            let interval = polytope.unseen_intervals()[k];
            let Some(most) = interval.most else { continue };
            assert!((interval.least..=most).contains(&truth[unseen[k]][channel]), "{interval:?}");
            bounded += 1;
            let mut of_unseen = vec![0.0; unseen.len()];
            of_unseen[k] = most;
            for (to, e) in emission.iter_mut().zip(polytope.explanation(&of_unseen)) {
                to[channel] = e;
            }
            let least = emission.iter().map(|e| e[channel]).fold(f64::INFINITY, f64::min);
            // In shadows the coarse room has negative light, of up to a third of the mean visible radiance.
            let seen = (0..truth.len()).filter(|&i| case.views.seen[i]).map(|i| emission[i][channel]);
            let mean = seen.clone().sum::<f64>() / seen.count() as f64;
            assert!(least >= -0.5 * mean.max(0.02), "{least} beside {mean}");
        }
        let difference = difference(&seen, &case.seen_colours(&emission));
        println!("triangle {}: seen faces differ by {difference:.1e}", unseen[k]);
        assert!(difference <= 1e-5, "triangle {}: {difference:.1e}", unseen[k]);
    }
    assert!(bounded >= 6);
    finish(&case.backend);
}
