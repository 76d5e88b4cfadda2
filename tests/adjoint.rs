//! The transposes and derivatives of the f64 reference, against its forward operators.

mod support;

use antirad::reference::{
    Adjoint, Facet, Leaving, Model, State, emission, observe, observe_adjoint, observe_derivative,
    reflect_adjoint, reflect_derivative, transport, transport_adjoint, transport_derivative,
};
use antirad::scene::{Accuracy, BinLayout, Scene, Weights};
use antirad::solve::{GmresParams, gmres};
use glam::DVec3;
use std::ops::ControlFlow;
use support::random::{Random, random_scene, scattered};

/// Both layouts with both weights, coarse: the more directions share a bin, the more of a bin's edge cases are met.
fn accuracies() -> [Accuracy; 4] {
    let with = |bins, weights| Accuracy { bins, weights, ..Accuracy::default() };
    let (equal_angle, concentric) =
        (BinLayout::EqualAngle { theta: 4, phi: 7 }, BinLayout::Concentric { n: 6 });
    [
        with(equal_angle, Weights::Bilinear),
        with(equal_angle, Weights::Smoothstep),
        with(concentric, Weights::Bilinear),
        with(concentric, Weights::Smoothstep),
    ]
}

fn model(scene: &Scene, accuracy: Accuracy) -> Model {
    Model::new(&Scene { accuracy, ..scene.clone() })
}

fn random_values(random: &mut Random, count: usize) -> Vec<DVec3> {
    (0..count).map(|_| random.point() - 0.3).collect()
}

fn random_state(model: &Model, random: &mut Random) -> State {
    let zero = model.zero();
    State {
        irradiance: random_values(random, zero.irradiance.len()),
        bins: random_values(random, zero.bins.len()),
    }
}

fn random_leaving(model: &Model, random: &mut Random) -> Leaving {
    let dark = model.dark();
    Leaving {
        diffuse: random_values(random, dark.diffuse.len()),
        specular: random_values(random, dark.specular.len()),
        antiradiance: random_values(random, dark.antiradiance.len()),
    }
}

fn dot(x: &[DVec3], y: &[DVec3]) -> f64 {
    assert_eq!(x.len(), y.len());
    x.iter().zip(y).map(|(x, y)| x.dot(*y)).sum()
}

fn dot_states(x: &State, y: &State) -> f64 {
    dot(&x.irradiance, &y.irradiance) + dot(&x.bins, &y.bins)
}

fn dot_leaving(x: &Leaving, y: &Leaving) -> f64 {
    dot(&x.diffuse, &y.diffuse) + dot(&x.specular, &y.specular) + dot(&x.antiradiance, &y.antiradiance)
}

/// Two ways to the same number. A NaN fails.
fn assert_same(what: &str, one: f64, other: f64, tolerance: f64) {
    let error = (one - other).abs() / one.abs().max(other.abs());
    assert!(error <= tolerance, "{what}: {one:e} and {other:e}, relative error {error:e}");
}

/// Scenes with glossy, blocking, far and close triangles; and accuracies.
fn cases() -> impl Iterator<Item = (String, Model)> {
    let scenes = [
        ("sparse", random_scene(1, 60, true, false)),
        ("diffuse", random_scene(2, 60, false, false)),
        ("crowded", scattered(3, 30, true, false, 0.4)),
    ];
    scenes.into_iter().flat_map(|(name, scene)| {
        accuracies().map(|a| (format!("{name}, {} {:?}", a.bins, a.weights), model(&scene, a)))
    })
}

/// ⟨A x, y⟩ = ⟨x, Aᵀ y⟩ of U, K - J and S: rounding of some 1e5 additions, below 1e-12.
#[test]
fn operators_and_their_transposes_agree() {
    let mut random = Random(11);
    for (name, model) in cases() {
        let (state, importance) = (random_state(&model, &mut random), random_state(&model, &mut random));
        let (leaving, cotangent) = (random_leaving(&model, &mut random), random_leaving(&model, &mut random));
        assert_same(
            &format!("U, {name}"),
            dot_states(&transport(&model, &leaving), &importance),
            dot_leaving(&leaving, &transport_adjoint(&model, &importance)),
            1e-12,
        );
        assert_same(
            &format!("K - J, {name}"),
            dot_leaving(&model.leave(&state), &cotangent),
            dot_states(&state, &reflect_adjoint(&model, &cotangent)),
            1e-12,
        );
        let (eye, colours) = (3.0 * random.point(), random_values(&mut random, model.facets.len()));
        assert_same(
            &format!("S, {name}"),
            dot(&observe(&model, &leaving, eye), &colours),
            dot_leaving(&leaving, &observe_adjoint(&model, eye, &colours)),
            1e-12,
        );
    }
}

fn solve<O: antirad::solve::LightOperator>(operator: &mut O) -> O::Vector
where
    O::Error: std::fmt::Debug,
{
    let params = GmresParams { tolerance: 1e-13, max_passes: 400, restart: 60 };
    gmres(operator, &params, &mut |_, _| ControlFlow::Continue(())).expect("a solution").0
}

/// F = ⟨λ0, H⟩ + ⟨μ0, C⟩ is ⟨μ, E⟩: the whole solve and the solve of the adjoint give the same number. Both are solved
/// to 1e-13 of their own size.
#[test]
fn the_solve_and_its_adjoint_agree() {
    let mut random = Random(12);
    for (name, model) in cases() {
        let state = solve(&mut &model);
        let emitted = emission(&model);
        let mut leaving = model.leave(&state);
        leaving.diffuse.iter_mut().zip(&emitted.diffuse).for_each(|(l, e)| *l += *e);
        let mut adjoint = Adjoint {
            model: &model,
            arriving: random_state(&model, &mut random),
            leaving: random_leaving(&model, &mut random),
        };
        let loss = dot_states(&state, &adjoint.arriving) + dot_leaving(&leaving, &adjoint.leaving);
        let importance = solve(&mut adjoint);
        assert_same(&name, loss, dot_leaving(&adjoint.leaving(&importance), &emitted), 1e-10);
    }
}

/// The loss of a geometry, everything else fixed: classes too, since what the plan leaves out never matters.
struct Moved<'a> {
    scene: Scene,
    base: &'a Model,
}

impl Moved<'_> {
    /// With some vertices shifted by `step`.
    fn model(&self, vertices: &[usize], step: DVec3) -> Model {
        let mut scene = self.scene.clone();
        for &v in vertices {
            scene.vertices[v] += step;
        }
        Model::with_classes(&scene, self.base.classes.clone())
    }

    /// Central differences of `loss` along x, y and z.
    fn slope(&self, vertices: &[usize], step: f64, loss: &dyn Fn(&Model) -> f64) -> DVec3 {
        DVec3::from_array(DVec3::AXES.map(|axis| {
            let at = |step| loss(&self.model(vertices, step * axis));
            (at(step) - at(-step)) / (2.0 * step)
        }))
    }
}

fn relative(found: &[DVec3], truth: &[DVec3]) -> f64 {
    let difference: Vec<DVec3> = found.iter().zip(truth).map(|(f, t)| *f - *t).collect();
    (dot(&difference, &difference) / dot(truth, truth)).sqrt()
}

#[test]
fn explore() {
    let mut random = Random(21);
    for (name, room, count, subsample) in
        [("far", 2.0, 12, 0.0), ("mixed", 1.0, 12, 30.0), ("near", 0.3, 8, 30.0)]
    {
        for accuracy in accuracies() {
            let accuracy = Accuracy { subsample, ..accuracy };
            let scene = Scene { accuracy, ..scattered(31, count, true, false, room) };
            let base = Model::new(&scene);
            let (leaving, importance) =
                (random_leaving(&base, &mut random), random_state(&base, &mut random));
            let moved = Moved { scene, base: &base };
            let start = std::time::Instant::now();
            let found: Vec<DVec3> = transport_derivative(&base, &leaving, &importance)
                .iter()
                .zip(&base.facets)
                .flat_map(|(g, f)| g.to_corners(f))
                .collect();
            let loss = |model: &Model| dot_states(&transport(model, &leaving), &importance);
            for step in [1e-4, 1e-5, 1e-6, 1e-7] {
                let truth: Vec<DVec3> = (0..found.len()).map(|v| moved.slope(&[v], step, &loss)).collect();
                println!(
                    "{name} {} {:?} {step:e}: {:e}",
                    accuracy.bins,
                    accuracy.weights,
                    relative(&found, &truth)
                );
            }
            println!("{:?}", start.elapsed());
        }
    }
}
