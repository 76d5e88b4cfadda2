//! The transposes and derivatives of the f64 reference, against its forward operators.

mod support;

use antirad::scene::{BinLayout, Material, Normalization, Scene, SolveSettings, Triangle};
use antirad_core::model::{Class, Facet};
use antirad_core::solve::{GmresParams, gmres};
use antirad_reference::{
    AdjointEquation, Exchange, Model, Outgoing, State, emission, observe, observe_adjoint,
    observe_derivative, reflect_adjoint, reflect_derivative,
};
use glam::DVec3;
use std::ops::ControlFlow;
use support::random::{Random, random_scene, scattered};

/// Both layouts, coarse: the more directions share a bin, the more of its edge cases occur.
fn all_settings() -> [SolveSettings; 2] {
    [BinLayout::EqualAngle { theta: 4, phi: 7 }, BinLayout::Concentric { n: 6 }]
        .map(|bins| support::implicit_settings().bins(bins))
}

fn model(scene: &Scene, settings: SolveSettings) -> Model {
    Model::new(&Scene { settings, ..scene.clone() })
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

fn random_outgoing(model: &Model, random: &mut Random) -> Outgoing {
    let dark = model.dark();
    Outgoing {
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

fn dot_outgoing(x: &Outgoing, y: &Outgoing) -> f64 {
    dot(&x.diffuse, &y.diffuse) + dot(&x.specular, &y.specular) + dot(&x.antiradiance, &y.antiradiance)
}

/// Compares two computations of the same number. NaN fails.
fn assert_same(what: &str, one: f64, other: f64, tolerance: f64) {
    let error = (one - other).abs() / one.abs().max(other.abs());
    assert!(error <= tolerance, "{what}: {one:e} and {other:e}, relative error {error:e}");
}

/// Scenes with glossy, blocking, far and close triangles, under all settings.
fn cases() -> impl Iterator<Item = (String, Model)> {
    let scenes = [
        ("sparse", random_scene(1, 60, true, false)),
        ("diffuse", random_scene(2, 60, false, false)),
        ("crowded", scattered(3, 30, true, false, 0.4)),
    ];
    scenes
        .into_iter()
        .flat_map(|(name, scene)| all_settings().map(|a| (format!("{name}, {}", a.bins), model(&scene, a))))
}

/// ⟨A x, y⟩ = ⟨x, Aᵀ y⟩ of U, K - J and S: rounding of some 1e5 additions, below 1e-12.
#[test]
fn operators_and_their_transposes_agree() {
    let mut random = Random::new(11);
    for (name, model) in cases() {
        let (state, importance) = (random_state(&model, &mut random), random_state(&model, &mut random));
        let (outgoing, cotangent) =
            (random_outgoing(&model, &mut random), random_outgoing(&model, &mut random));
        let exchange = Exchange::new(&model);
        assert_same(
            &format!("U, {name}"),
            dot_states(&exchange.apply(&outgoing), &importance),
            dot_outgoing(&outgoing, &exchange.transpose(&importance)),
            1e-12,
        );
        assert_same(
            &format!("K - J, {name}"),
            dot_outgoing(&model.leave(&state), &cotangent),
            dot_states(&state, &reflect_adjoint(&model, &cotangent)),
            1e-12,
        );
        let (camera_position, colours) =
            (3.0 * random.point(), random_values(&mut random, model.facets.len()));
        assert_same(
            &format!("S, {name}"),
            dot(&observe(&model, &outgoing, camera_position), &colours),
            dot_outgoing(&outgoing, &observe_adjoint(&model, camera_position, &colours)),
            1e-12,
        );
    }
}

fn solve<O: antirad_core::solve::LightOperator>(operator: &mut O) -> O::Vector
where
    O::Error: std::fmt::Debug,
{
    let params = GmresParams::new(1e-13, 400, 60);
    gmres(operator, &params, &mut |_, _| ControlFlow::Continue(())).expect("a solution").0
}

/// F = ⟨λ0, H⟩ + ⟨μ0, C⟩ is ⟨μ, E⟩: the whole solve and the solve of the adjoint give the same number. Both are solved
/// to 1e-13 of their own size.
#[test]
fn the_solve_and_its_adjoint_agree() {
    let mut random = Random::new(12);
    for (name, model) in cases() {
        let state = solve(&mut &model);
        let emitted = emission(&model);
        let mut outgoing = model.leave(&state);
        outgoing += &emitted;
        let mut adjoint = AdjointEquation {
            model: &model,
            incident: random_state(&model, &mut random),
            outgoing: random_outgoing(&model, &mut random),
        };
        let loss = dot_states(&state, &adjoint.incident) + dot_outgoing(&outgoing, &adjoint.outgoing);
        let importance = solve(&mut adjoint);
        assert_same(&name, loss, dot_outgoing(&adjoint.outgoing(&importance), &emitted), 1e-10);
    }
}

/// A model whose triangles can be moved independently, all else fixed, classes too: what the plan leaves out adds
/// nothing.
struct Moved(Model);

/// A corner of a triangle.
type Corner = (usize, usize);

impl Moved {
    fn shifted(&mut self, corners: &[Corner], shift: DVec3, loss: &dyn Fn(&Model) -> f64) -> f64 {
        let kept = self.0.facets.clone();
        for &(triangle, corner) in corners {
            let mut moved = self.0.facets[triangle].corners;
            moved[corner] += shift;
            self.0.facets[triangle] = Facet::new(moved);
        }
        let value = loss(&self.0);
        self.0.facets = kept;
        value
    }

    /// The slope of `loss` along x, y and z, by central differences of fourth order.
    fn slope(&mut self, corners: &[Corner], step: f64, loss: &dyn Fn(&Model) -> f64) -> DVec3 {
        DVec3::from_array(DVec3::AXES.map(|axis| {
            let mut difference = |step: f64| {
                self.shifted(corners, step * axis, loss) - self.shifted(corners, -step * axis, loss)
            };
            (8.0 * difference(step) - difference(2.0 * step)) / (12.0 * step)
        }))
    }
}

/// In the 2-norm over all entries.
fn relative(found: &[DVec3], truth: &[DVec3]) -> f64 {
    let difference: Vec<DVec3> = found.iter().zip(truth).map(|(f, t)| *f - *t).collect();
    (dot(&difference, &difference) / dot(truth, truth)).sqrt()
}

/// The gradient with respect to every corner against differences, at the best of three steps: the kinks of bilinear
/// weights within a step differ. The bounds are of the error of the whole vector, and of the worst corner by the size
/// of its own gradient. A NaN fails.
fn assert_slopes(name: &str, model: Model, found: &[[DVec3; 3]], loss: &dyn Fn(&Model) -> f64) {
    let mut moved = Moved(model);
    let flat: Vec<DVec3> = found.iter().flatten().copied().collect();
    assert!(flat.iter().all(|f| f.is_finite()), "{name}");
    let errors: Vec<(f64, f64)> = [1e-6, 3e-7, 1e-7]
        .into_iter()
        .map(|step| {
            let mut truth = Vec::new();
            for triangle in 0..found.len() {
                truth.extend((0..3).map(|corner| moved.slope(&[(triangle, corner)], step, loss)));
            }
            let own =
                |(f, t): (&DVec3, &DVec3)| f.distance(*t) / t.length().max(1e-6 * dot(&truth, &truth).sqrt());
            (relative(&flat, &truth), flat.iter().zip(&truth).map(own).fold(0.0, f64::max))
        })
        .collect();
    println!("{name}: {errors:?}");
    let all = median(errors.iter().map(|e| e.0));
    let worst = median(errors.iter().map(|e| e.1));
    assert!(all <= 1e-9 && worst <= 1e-7, "{name}: {errors:?}");
}

/// Of three steps: kinks of bilinear weights may lie within one of them, but not within most.
fn median(errors: impl Iterator<Item = f64>) -> f64 {
    let mut errors: Vec<f64> = errors.collect();
    errors.sort_by(f64::total_cmp);
    errors[errors.len() / 2]
}

/// Scenes in which all pairs are far, some are close, and most are close: (name, side of the box, triangles, near
/// field).
const ROOMS: [(&str, f64, u32, f64); 3] =
    [("far", 2.0, 12, 0.0), ("mixed", 1.0, 12, 30.0), ("near", 0.3, 8, 30.0)];

#[test]
fn transport_changes_with_every_corner_as_its_derivative_says() {
    let mut random = Random::new(21);
    for (name, room, count, near_field) in ROOMS {
        for settings in all_settings() {
            let settings = settings.near_field(near_field);
            let model = model(&scattered(31, count, true, false, room), settings);
            let (outgoing, importance) =
                (random_outgoing(&model, &mut random), random_state(&model, &mut random));
            let gradients = Exchange::new(&model).derivative(&outgoing, &importance);
            let found: Vec<_> = gradients.iter().zip(&model.facets).map(|(g, f)| g.to_corners(f)).collect();
            let name = format!("{name}, {}", settings.bins);
            assert_slopes(&name, model, &found, &|model| {
                dot_states(&Exchange::new(model).apply(&outgoing), &importance)
            });
        }
    }
}

/// A triangle that moves as a whole keeps normal, area and characteristic area: only its centroid and the pieces move.
#[test]
fn transport_changes_with_every_centroid_as_its_derivative_says() {
    let mut random = Random::new(22);
    for settings in all_settings() {
        let model = model(&scattered(32, 10, true, false, 0.8), settings);
        let (outgoing, importance) =
            (random_outgoing(&model, &mut random), random_state(&model, &mut random));
        let found: Vec<DVec3> = Exchange::new(&model)
            .derivative(&outgoing, &importance)
            .iter()
            .map(|gradient| gradient.corners.iter().sum())
            .collect();
        let mut moved = Moved(model);
        let loss = |model: &Model| dot_states(&Exchange::new(model).apply(&outgoing), &importance);
        let errors = [1e-6, 3e-7, 1e-7].map(|step| {
            let slope = |i| moved.slope(&[(i, 0), (i, 1), (i, 2)], step, &loss);
            relative(&found, &(0..found.len()).map(slope).collect::<Vec<_>>())
        });
        println!("{}: {errors:?}", settings.bins);
        assert!(median(errors.into_iter()) <= 1e-9, "{}: {errors:?}", settings.bins);
    }
}

#[test]
fn colours_change_with_corners_and_camera_as_their_derivative_says() {
    let mut random = Random::new(23);
    for settings in all_settings() {
        let model = model(&scattered(33, 12, true, false, 0.8), settings);
        let outgoing = random_outgoing(&model, &mut random);
        let (camera_position, colours) =
            (DVec3::new(0.3, 0.5, 1.1), random_values(&mut random, model.facets.len()));
        let (gradients, at_eye) = observe_derivative(&model, &outgoing, camera_position, &colours);
        let found: Vec<_> = gradients.iter().zip(&model.facets).map(|(g, f)| g.to_corners(f)).collect();
        let loss =
            |model: &Model, camera_position| dot(&observe(model, &outgoing, camera_position), &colours);
        let slope = DVec3::from_array(DVec3::AXES.map(|axis| {
            let at = |step: f64| loss(&model, camera_position + step * axis);
            (at(1e-6) - at(-1e-6)) / 2e-6
        }));
        assert!(relative(&[at_eye], &[slope]) <= 1e-8, "{at_eye} {slope}");
        let name = settings.bins.to_string();
        assert_slopes(&name, model, &found, &|model| loss(model, camera_position));
    }
}

/// Linear in all but the power, so that a step of 1e-3 leaves only rounding; of fourth order in the power, at 1e-3 too.
#[test]
fn reflection_changes_with_materials_as_its_derivative_says() {
    let mut random = Random::new(24);
    for (k, settings) in all_settings().into_iter().enumerate() {
        let mut model = model(&scattered(34, 16, true, false, 0.8), settings);
        let glossy = (0..16).filter(|&i| model.classes[i].glossy).collect::<Vec<_>>();
        for (power, &i) in [0.0, 0.4, 1.0, 7.0, 50.0, 300.0].into_iter().zip(&glossy) {
            model.materials[i].power = power;
            model.materials[i].diffuse = 0.7;
            model.materials[i].normalization = [Normalization::Phong, Normalization::Energy][k % 2];
        }
        let (state, cotangent) = (random_state(&model, &mut random), random_outgoing(&model, &mut random));
        let gradients = reflect_derivative(&model, &state, &cotangent);
        let (mut found, mut truth) = (Vec::new(), Vec::new());
        for (i, gradient) in gradients.iter().enumerate() {
            let mut slope = |change: &dyn Fn(&mut Material, f64)| {
                let kept = model.materials[i].clone();
                let mut at = |step: f64| {
                    change(&mut model.materials[i], step);
                    let value = dot_outgoing(&model.leave(&state), &cotangent)
                        + dot_outgoing(&emission(&model), &cotangent);
                    model.materials[i] = kept.clone();
                    value
                };
                let mut difference = |step: f64| at(step) - at(-step);
                (8.0 * difference(1e-3) - difference(2e-3)) / 12e-3
            };
            for c in 0..3 {
                found.push(DVec3::new(gradient.emission[c], gradient.albedo[c], gradient.specular[c]));
                let specular = if glossy.contains(&i) { slope(&|m, d| m.specular[c] += d) } else { 0.0 };
                let albedo = slope(&|m, d| m.albedo[c] += d);
                truth.push(DVec3::new(slope(&|m, d| m.emission[c] += d), albedo, specular));
            }
            found.push(DVec3::new(gradient.diffuse, gradient.power, 0.0));
            truth.push(DVec3::new(slope(&|m, d| m.diffuse += d), slope(&|m, d| m.power += d), 0.0));
        }
        assert!(found.iter().all(|f| f.is_finite()));
        assert!(relative(&found, &truth) <= 1e-10, "{}", relative(&found, &truth));
    }
}

/// The derivative of a loss through the whole solve, along directions in which everything moves at once.
#[test]
fn losses_of_solutions_change_as_the_adjoint_says() {
    let mut random = Random::new(25);
    for settings in all_settings() {
        let base = model(&scattered(35, 10, true, false, 0.9), settings);
        let camera_position = DVec3::new(0.4, 0.3, 1.3);
        let colours = random_values(&mut random, base.facets.len());
        let (at_state, at_leaving) = (random_state(&base, &mut random), random_outgoing(&base, &mut random));
        let light = |model: &Model| {
            let state = solve(&mut &*model);
            let mut outgoing = model.leave(&state);
            outgoing += &emission(model);
            (state, outgoing)
        };
        let loss = |model: &Model| {
            let (state, outgoing) = light(model);
            dot_states(&state, &at_state)
                + dot_outgoing(&outgoing, &at_leaving)
                + dot(&observe(model, &outgoing, camera_position), &colours)
        };

        let (state, outgoing) = light(&base);
        let mut seen = observe_adjoint(&base, camera_position, &colours);
        seen += &at_leaving;
        let mut adjoint = AdjointEquation { model: &base, incident: at_state.clone(), outgoing: seen };
        let importance = solve(&mut adjoint);
        let cotangent = adjoint.outgoing(&importance);
        let materials = reflect_derivative(&base, &state, &cotangent);
        let (observed, _) = observe_derivative(&base, &outgoing, camera_position, &colours);
        let corners: Vec<[DVec3; 3]> = Exchange::new(&base)
            .derivative(&outgoing, &importance)
            .into_iter()
            .zip(observed)
            .zip(&base.facets)
            .map(|((mut gradient, observed), facet)| {
                gradient += observed;
                gradient.to_corners(facet)
            })
            .collect();

        let name = settings.bins.to_string();
        for _ in 0..3 {
            let shifts: Vec<[DVec3; 3]> =
                corners.iter().map(|_| std::array::from_fn(|_| random.point() - 0.5)).collect();
            let shades = random_values(&mut random, corners.len());
            let mut expected = 0.0;
            for i in 0..corners.len() {
                expected += (0..3).map(|k| corners[i][k].dot(shifts[i][k])).sum::<f64>();
                let m = &materials[i];
                expected += (m.emission + m.albedo).dot(shades[i]) + (m.diffuse + m.power) * shades[i].x;
            }
            let at = |step: f64| {
                let mut model = Model::with_classes(
                    &Scene { settings, ..scattered(35, 10, true, false, 0.9) },
                    base.classes.clone(),
                );
                for i in 0..corners.len() {
                    let moved = std::array::from_fn(|k| model.facets[i].corners[k] + step * shifts[i][k]);
                    model.facets[i] = Facet::new(moved);
                    let m = &mut model.materials[i];
                    m.emission = (DVec3::from(m.emission) + step * shades[i]).to_array();
                    m.albedo = (DVec3::from(m.albedo) + step * shades[i]).to_array();
                    m.diffuse += step * shades[i].x;
                    m.power += step * shades[i].x;
                }
                loss(&model)
            };
            let errors = [1e-5, 3e-6, 1e-6].map(|step| {
                let slope =
                    (8.0 * (at(step) - at(-step)) - (at(2.0 * step) - at(-2.0 * step))) / (12.0 * step);
                (slope - expected).abs() / expected.abs()
            });
            println!("{name}: {expected:e} {errors:?}");
            assert!(median(errors.into_iter()) <= 1e-8, "{name}: {expected:e} {errors:?}");
        }
    }
}

/// Where derivatives do not exist or no light is exchanged, all are finite and none is out of proportion. Triangles and
/// distances are of size 1, light and cotangents too: the gradients at the room's edge really are some tens.
#[test]
fn special_geometry_has_finite_gradients() {
    let (o, x, y, z) = (DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z);
    let up = [o, x, y];
    let at = |t: [DVec3; 3], shift: DVec3| t.map(|c| c + shift);
    let cases: [(&str, Vec<[DVec3; 3]>); 8] = [
        ("sheet", vec![up, [o, y, x], at(up, 2.0 * z), at([o, y, x], 3.0 * z)]),
        ("duplicate", vec![up, up, at([o, y, x], z)]),
        ("without area", vec![up, [x, x, x], [o, x + z, 2.0 * (x + z)], at([o, y, x], z)]),
        ("on the pole", vec![up, at([o, y, x], z), at(up, 5.0 * z), at([o, y, x], 9.0 * z)]),
        ("room's edge", vec![up, [o, z, x], [o, y, z], [x, z, y]]),
        ("coplanar", vec![up, [x, x + y, y], at(up, 3.0 * x), at([o, y, x], x + 0.4 * z)]),
        ("almost touching", vec![up, at([o, y, x], 1e-9 * z), at(up, -1e-9 * z)]),
        ("needle", vec![[o, x, 0.5 * x + 1e-7 * y], at([o, y, x], 0.3 * z), at(up, -0.01 * z)]),
    ];
    let mut random = Random::new(26);
    for (name, triangles) in cases {
        for (settings, near_field) in all_settings().into_iter().flat_map(|a| [(a, 30.0), (a, 0.0)]) {
            let vertices = triangles.iter().flatten().copied().collect();
            let list = (0..triangles.len() as u32)
                .map(|k| Triangle { vertices: [3 * k, 3 * k + 1, 3 * k + 2], material: 0 })
                .collect();
            let mut material = Material::named("m");
            (material.albedo, material.specular, material.emission) = ([0.5; 3], [0.1; 3], [1.0; 3]);
            let mut scene = Scene::new("special", vertices, list, vec![material])
                .map(support::implicit)
                .expect("a scene");
            scene.settings = settings.near_field(near_field);
            let both =
                |class: Class| if class.has_bins() { Class { blocker: true, glossy: true } } else { class };
            let model =
                Model::with_classes(&scene, Model::new(&scene).classes.into_iter().map(both).collect());
            let (outgoing, importance) =
                (random_outgoing(&model, &mut random), random_state(&model, &mut random));
            let colours = random_values(&mut random, triangles.len());
            let camera_position = DVec3::new(1.0 / 3.0, 1.0 / 3.0, 0.0);
            let mut size: f64 = 0.0;
            let (observed, at_eye) = observe_derivative(&model, &outgoing, camera_position, &colours);
            for gradients in [Exchange::new(&model).derivative(&outgoing, &importance), observed] {
                for (gradient, facet) in gradients.iter().zip(&model.facets) {
                    assert!(gradient.normal.is_finite() && gradient.area.is_finite(), "{name}: {gradient:?}");
                    assert!(gradient.to_corners(facet).iter().all(|g| g.is_finite()), "{name}: {gradient:?}");
                    size = size.max(gradient.corners.iter().map(|g| g.length()).fold(0.0, f64::max));
                }
            }
            assert!(at_eye.is_finite());
            assert!(size <= 100.0, "{name}, {}, {near_field}: {size:e}", settings.bins);
        }
    }
}
