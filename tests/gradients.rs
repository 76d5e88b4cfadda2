//! Adjoint operators and derivatives, kernels and those of the CPU, against their f64 twins.

mod support;

use antirad::backend::Backend;
use antirad::plan::{GradientRequest, Plan, PlanOptions};
use antirad::scene::{BinLayout, Movable, Precision, Scene, SolveSettings};
use antirad_core::model::FacetGradient;
use antirad_core::transport::Operators;
use antirad_reference::{
    Exchange, Model, Outgoing, State, emission, observe_adjoint, observe_derivative, reflect_adjoint,
    reflect_derivative,
};
use glam::DVec3;
use support::random::{Random, random_scene, scattered, with_own_powers};
use support::slots::{by_slot, flat, from_pages, of_class, relative, rgb_of, to_pages};
use support::{device, finish};

/// Relative error of each kernel, in the 2-norm over all its output.
fn tolerance(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1e-3,
        Precision::F64 => 1e-10,
    }
}

/// Random values of both signs, irradiance and bins independent of each other.
fn cotangent(model: &Model, random: &mut Random) -> State {
    let mut state = model.zero();
    for value in state.irradiance.iter_mut().chain(&mut state.bins) {
        *value = random.point() - 0.4;
    }
    state
}

/// Bins of a state divided by c_b: from cotangents of H(b)/c_b, as the reference holds them, to those of H(b).
fn per_irradiance(model: &Model, bins: &[DVec3]) -> Vec<DVec3> {
    let count = model.bins.count();
    bins.iter().enumerate().map(|(k, v)| *v / model.bins.projected[k % count]).collect()
}

fn numbers(gradient: &FacetGradient, scale: f64) -> Vec<f64> {
    let corners = gradient.corners.iter().flat_map(|c| (*c * scale).to_array());
    corners
        .chain(gradient.normal.to_array())
        .chain([gradient.area, gradient.characteristic_area].map(|x| x * scale * scale))
        .collect()
}

/// What the CPU computes, and kernels.
fn compare(name: &str, scene: &Scene, settings: SolveSettings, adjust: impl Fn(PlanOptions) -> PlanOptions) {
    for backend in [Backend::cpu(), device().into()] {
        compare_on(&backend, &format!("{name}, {}", backend.kind()), scene, settings, &adjust);
    }
}

fn compare_on(
    backend: &Backend,
    name: &str,
    scene: &Scene,
    settings: SolveSettings,
    adjust: &impl Fn(PlanOptions) -> PlanOptions,
) {
    let scene = Scene { settings, ..scene.clone() };
    let model = Model::new(&scene);
    let options = adjust(PlanOptions::of(backend)).gradients(GradientRequest::EVERYTHING);
    let plan = Plan::new(&scene, &options, &settings).expect("a plan");
    let mut operators = support::operators(backend, &scene, &plan);

    let mut random = Random::new(7);
    let light = {
        let mut state = cotangent(&model, &mut random);
        for value in state.irradiance.iter_mut().chain(&mut state.bins) {
            *value = value.abs();
        }
        state
    };
    let importance = cotangent(&model, &mut random);
    let camera_position = DVec3::new(3.0, 0.5, -1.0);
    let colours: Vec<DVec3> = model.facets.iter().map(|_| random.point() - 0.5).collect();

    let upload = |operators: &mut dyn Operators, state: &State, bins: &[DVec3]| {
        let mut x = operators.vector().expect("a vector");
        let irradiance = by_slot(&plan, |i| state.irradiance[i]);
        operators.set(&mut x, &irradiance, &to_pages(&model, &plan, bins)).expect("an upload");
        x
    };
    let h = upload(&mut *operators, &light, &light.bins);
    let x = upload(&mut *operators, &importance, &per_irradiance(&model, &importance.bins));
    let none = by_slot(&plan, |_| DVec3::ZERO);
    let pages = vec![None; plan.layout().groups.len()];
    let colours_by_slot = by_slot(&plan, |i| colours[i]);

    let total = importance.bins.len();
    let mut errors: Vec<(&str, f64)> = Vec::new();
    let mut operator = operators.adjoint().expect("what was planned");
    operator.set(&none, &none, &pages).expect("cotangents");
    let exchange = Exchange::new(&model);
    let outgoing = exchange.transpose(&importance);
    let given = operator.outgoing_cotangent(&x).expect("a pass");
    errors.push((
        "transport_adjoint, radiance",
        relative(&rgb_of(&plan, &given.radiance), &flat(&outgoing.diffuse)),
    ));
    let specular = of_class(&model, &outgoing.specular, |c| c.glossy);
    errors.push((
        "transport_adjoint, specular",
        relative(&from_pages(&model, &plan, &given.specular, total), &specular),
    ));
    let lobes = operator.lobe_sums(&h).expect("sums");
    let mut y = operator.vector().expect("a vector");
    operator.pass(Some(&x), false, &mut y).expect("a pass");
    let back = reflect_adjoint(&model, &outgoing);
    // The views alone, before any transport.
    operator.set(&none, &none, &pages).expect("cotangents");
    operator.add_view(camera_position, &colours_by_slot).expect("a view");
    let mut z = operator.vector().expect("a vector");
    operator.pass(None, true, &mut z).expect("a pass");
    let seen = reflect_adjoint(&model, &observe_adjoint(&model, camera_position, &colours));
    let views = [(camera_position, colours_by_slot)];
    let (pairs, _) = operator.geometry(&h, &x, &[], Some(&Movable::All)).expect("derivatives");
    let (faces, camera_positions) = operator.geometry(&h, &x, &views, None).expect("derivatives");
    drop(operator);

    for (name, vector, truth) in [("adjoint pass", &y, &back), ("observe_adjoint", &z, &seen)] {
        let irradiance = operators.irradiance(vector).expect("values");
        errors.push((name, relative(&rgb_of(&plan, &irradiance), &flat(&truth.irradiance))));
        let groups = 0..plan.layout().groups.len();
        let pages: Vec<_> = groups.map(|g| operators.bins(vector, g).expect("bins")).collect();
        let bins = per_irradiance(&model, &truth.bins);
        errors.push((name, relative(&from_pages(&model, &plan, &pages, total), &flat(&bins))));
    }

    let mut sent: Outgoing = model.leave(&light);
    sent += &emission(&model);
    let scale = plan.placement().scale;
    let in_order = |slots: &[FacetGradient]| {
        let mut all = vec![FacetGradient::default(); model.facets.len()];
        for (&i, gradient) in plan.layout().order.iter().zip(slots) {
            if let Some(to) = all.get_mut(i as usize) {
                *to = *gradient;
            }
        }
        all
    };
    let mut geometry = |name: [&'static str; 3], given: &[FacetGradient], truth: &[FacetGradient]| {
        // The component of a normal's gradient along the normal is meaningless.
        let tangential =
            |g: &FacetGradient, n: DVec3| FacetGradient { normal: g.normal.reject_from(n), ..*g };
        let part = |g: &[FacetGradient], s: f64, range: std::ops::Range<usize>| -> Vec<f64> {
            let all = g.iter().zip(&model.facets).map(|(g, f)| tangential(g, f.normal));
            all.flat_map(|g| numbers(&g, s)[range.clone()].to_vec()).collect()
        };
        for (name, range) in name.into_iter().zip([0..9, 9..12, 12..14]) {
            let given = part(given, scale, range.clone());
            errors.push((name, relative(&given, &part(truth, 1.0, range))));
        }
    };
    geometry(
        ["derivative, corners", "derivative, normals", "derivative, areas"],
        &in_order(&pairs),
        &exchange.derivative(&sent, &importance),
    );
    let (face_truth, eye_truth) = observe_derivative(&model, &sent, camera_position, &colours);
    geometry(
        ["view derivative, corners", "view derivative, normals", "view derivative, areas"],
        &in_order(&faces),
        &face_truth,
    );
    errors.push((
        "view derivative, camera position",
        relative(&(camera_positions[0] * scale).to_array(), &eye_truth.to_array()),
    ));

    let truth = reflect_derivative(&model, &light, &outgoing);
    if let Some(lobes) = lobes {
        let mut sigma = vec![DVec3::ZERO; model.facets.len()];
        let mut power = vec![0.0; model.facets.len()];
        for (&i, [sum, logarithms]) in plan.layout().order.iter().zip(&lobes) {
            if let Some(m) = model.materials.get(i as usize) {
                let (n, slope) = (m.specular_normalization(), m.specular_normalization_derivative());
                sigma[i as usize] = n * *sum;
                power[i as usize] = DVec3::from(m.specular).dot(slope * *sum + n * *logarithms);
            }
        }
        let glossy = |i: usize| model.classes[i].glossy;
        let of_truth: Vec<DVec3> =
            truth.iter().enumerate().map(|(i, g)| if glossy(i) { g.specular } else { DVec3::ZERO }).collect();
        errors.push(("σ", relative(&flat(&sigma), &flat(&of_truth))));
        let of_truth: Vec<f64> =
            truth.iter().enumerate().map(|(i, g)| if glossy(i) { g.power } else { 0.0 }).collect();
        errors.push(("p", relative(&power, &of_truth)));
    }

    println!("{name}: {} triangles, {} close pairs", model.facets.len(), plan.pairs().sub_sampled);
    for (kernel, error) in &errors {
        println!("  {kernel}: {error:.2e}");
    }
    for (kernel, error) in errors {
        assert!(error <= tolerance(settings.precision), "{name}, {kernel}: relative error {error:e}");
    }
    finish(backend);
}

fn double() -> SolveSettings {
    support::implicit_settings().precision(Precision::F64)
}

#[test]
fn double_precision() {
    compare("diffuse", &random_scene(1, 60, false, false), double(), |l| l);
    compare("glossy", &random_scene(2, 131, true, false), double(), |l| l);
    let crowd = scattered(10, 50, true, false, 0.4);
    compare("crowd", &crowd, double(), |l| l);
    compare("crowd, near field evaluated", &crowd, double(), |l| l.keep_near_field(false));
}

#[test]
fn other_layouts() {
    let scene = random_scene(4, 100, true, false);
    let concentric = double().bins(BinLayout::Concentric { n: 12 });
    compare("concentric", &scene, concentric, |l| l);
}

#[test]
fn lobes_by_matrix_and_bin_by_bin() {
    let mixed = with_own_powers(random_scene(5, 80, true, false));
    compare("own powers, f32", &mixed, support::implicit_settings(), |l| l.tile(32).page(1));
    let wide = double().bins(BinLayout::EqualAngle { theta: 24, phi: 23 });
    compare("552 columns", &random_scene(17, 40, true, false), wide, |l| l);
}

#[test]
fn single_precision() {
    let single = double().precision(Precision::F32);
    compare("f32", &random_scene(3, 100, true, false), single, |l| l);
    let far = single.near_field(0.0);
    compare("f32, no near field", &random_scene(9, 131, true, true), far, |l| l);
}

/// The other tests have each part of these once.
#[test]
#[ignore = "takes long: more triangles, and other arrangements together"]
fn more_sizes_and_arrangements() {
    let single = double().precision(Precision::F32);
    compare("f32", &random_scene(3, 300, true, false), single, |l| l);
    compare("f32, small tiles and pages", &random_scene(6, 200, true, false), single, |l| l.tile(32).page(1));
    compare("own powers", &with_own_powers(random_scene(5, 131, true, false)), double(), |l| l);
}
