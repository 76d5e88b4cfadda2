//! Every operator, kernels and those of the CPU, against its f64 twin, on random scenes with blockers, glossy and close triangles.

#[path = "support/reflect.rs"]
mod reflect;
mod support;

use antirad::backend::Backend;
use antirad::gpu::{Device, DeviceKind};
use antirad::plan::{Occlusion, Plan, PlanError, PlanOptions};
use antirad::scene::{
    BinLayout, Material, Precision, Scene, SceneBuilder, Shape, SolveSettings, VisibilityChoice,
};
use antirad::{Engine, SolveParams};
use antirad_core::plan::Residency;
use antirad_core::shaders::{self, RealShader};
use antirad_core::solve::Orthonormalised;
use antirad_core::transport::{Operators, State as Vector, vulkan};
use antirad_reference::{Exchange, Model, State, emission, observe};
use glam::{DAffine3, DVec3};
use std::process::{Command, Stdio};
use support::random::{Random, random_scene, scattered, with_own_powers};
use support::slots::{by_slot, flat, from_pages, of_class, relative, rgb_of, to_pages};
use support::{backend, device, finish, implementations, operators, same};

/// The largest error of a triangle's values, `width` each, relative to the root mean square of all lit triangles: a
/// single triangle hardly counts in the 2-norm over all.
fn worst(values: &[f64], truth: &[f64], width: usize) -> f64 {
    assert_eq!(values.len(), truth.len());
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let rows = || values.chunks(width).zip(truth.chunks(width));
    let errors = rows().map(|(v, t)| norm(&mut v.iter().zip(t).map(|(a, b)| a - b)));
    // NaN must not go unnoticed.
    let largest = errors.fold(0.0, |a: f64, e| if e.is_finite() { a.max(e) } else { f64::INFINITY });
    let lit = rows().filter(|(_, t)| t.iter().any(|t| *t != 0.0)).count().max(1);
    let mean = norm(&mut truth.iter().copied()) / (lit as f64).sqrt();
    if mean > 0.0 { largest / mean } else { largest }
}

/// Factor by which the worst error of a triangle may be larger.
const WORST: f64 = 10.0;

/// Relative error of each kernel, in the 2-norm over all its output.
fn tolerance(precision: Precision) -> f64 {
    match precision {
        Precision::F32 => 1e-4,
        Precision::F64 => 1e-12,
    }
}

/// What the CPU computes, and kernels, those for CPUs and those for GPUs.
fn compare(name: &str, scene: &Scene, settings: SolveSettings, options: impl Fn(PlanOptions) -> PlanOptions) {
    for (who, backend) in implementations() {
        compare_on(&backend, &format!("{name}, {who}"), scene, settings, &options);
    }
}

fn compare_on(
    backend: &Backend,
    name: &str,
    scene: &Scene,
    settings: SolveSettings,
    options: &impl Fn(PlanOptions) -> PlanOptions,
) {
    // Antiradiance is what the twin has, however dense blockers are.
    let settings = settings.visibility(VisibilityChoice::Implicit);
    let scene = Scene { settings, ..scene.clone() };
    let model = Model::new(&scene);
    let kept = options(PlanOptions::of(backend)).fast_near_field(false);
    let plan = Plan::new(&scene, &kept, &settings).expect("a plan");
    let mut operators = support::operators(backend, &scene, &plan);

    // Some light everywhere: a random state, the irradiance being the sum of the bins where there are any.
    let mut random = Random::new(7);
    let mut light = |_| if plan.channels() == 1 { DVec3::splat(random.next()) } else { random.point() };
    let mut state: State = model.zero();
    for j in 0..model.facets.len() {
        state.irradiance[j] = light(());
        if let Some(range) = model.bins_of(j) {
            state.irradiance[j] = DVec3::ZERO;
            for (b, c) in range.zip(&model.bins.projected) {
                state.bins[b] = light(());
                state.irradiance[j] += *c * state.bins[b];
            }
        }
    }
    let mut x = operators.vector().expect("a vector");
    let irradiance = by_slot(&plan, |i| state.irradiance[i]);
    operators.set(&mut x, &irradiance, &to_pages(&model, &plan, &state.bins)).expect("an upload");

    let total = state.bins.len();
    let mut outgoing = model.leave(&state);
    outgoing += &emission(&model);
    let mut errors = Vec::new();
    let given = operators.outgoing(&x).expect("what leaves");
    errors.push(("reflect", rgb_of(&plan, &given.radiance), flat(&outgoing.diffuse)));
    let specular = of_class(&model, &outgoing.specular, |c| c.glossy);
    errors.push(("reflect_glossy", from_pages(&model, &plan, &given.specular, total), specular));
    let truth = Exchange::new(&model).apply(&outgoing);
    let mut transported =
        |plan: &Plan, operators: &mut dyn Operators, x: &Vector, names: [&'static str; 2]| {
            let mut y = operators.vector().expect("a vector");
            operators.pass(Some(x), true, &mut y).expect("a pass");
            let irradiance = operators.irradiance(&y).expect("irradiance");
            errors.push((names[0], rgb_of(plan, &irradiance), flat(&truth.irradiance)));
            let pages: Vec<_> =
                (0..plan.layout().groups.len()).map(|g| operators.bins(&y, g).expect("bins")).collect();
            errors.push((names[1], from_pages(&model, plan, &pages, total), flat(&truth.bins)));
        };
    transported(&plan, &mut *operators, &x, ["transport, irradiance", "transport, bins"]);
    if plan.near_field_matrix().is_some() {
        let evaluated = kept.keep_near_field(false);
        let evaluated = Plan::new(&scene, &evaluated, &settings).expect("a plan");
        assert!(evaluated.near_field_matrix().is_none());
        let mut operators = support::operators(backend, &scene, &evaluated);
        let mut x = operators.vector().expect("a vector");
        operators.set(&mut x, &irradiance, &to_pages(&model, &evaluated, &state.bins)).expect("an upload");
        let names = ["transport, irradiance, near field evaluated", "transport, bins, near field evaluated"];
        transported(&evaluated, &mut *operators, &x, names);
    }

    let camera_position = DVec3::new(3.0, 0.5, -1.0);
    let colours = operators.observe(&x, camera_position).expect("colours");
    errors.push(("observe", rgb_of(&plan, &colours), flat(&observe(&model, &outgoing, camera_position))));

    let blockers = model.classes.iter().filter(|c| c.blocker).count();
    println!(
        "{name}: {} triangles, {blockers} blockers, {} close pairs",
        model.facets.len(),
        plan.pairs().sub_sampled
    );
    let of_triangle = |kernel: &str| match kernel {
        name if name == "reflect_glossy" || name.starts_with("transport, bins") => 3 * model.bins.count(),
        _ => 3,
    };
    for (kernel, values, truth) in errors {
        let (error, worst) = (relative(&values, &truth), worst(&values, &truth, of_triangle(kernel)));
        println!("  {kernel}: {error:.2e}, at worst {worst:.2e}");
        assert!(error <= tolerance(settings.precision), "{name}, {kernel}: relative error {error:e}");
        assert!(worst <= WORST * tolerance(settings.precision), "{name}, {kernel}: worst error {worst:e}");
    }
    finish(backend);
}

#[test]
fn diffuse_and_glossy_scenes_of_all_sizes() {
    for (seed, triangles, glossy) in [(1, 50, false), (2, 131, true)] {
        compare(
            "bilinear",
            &random_scene(seed, triangles, glossy, false),
            support::implicit_settings(),
            |l| l,
        );
    }
}

#[test]
fn other_layouts() {
    let scene = random_scene(4, 150, true, false);
    let concentric = support::implicit_settings().bins(BinLayout::Concentric { n: 4 });
    compare("concentric:4", &scene, concentric, |l| l);
}

/// The other tests have each part of these once.
#[test]
#[ignore = "takes long: more triangles, and other arrangements together"]
fn more_sizes_and_arrangements() {
    let single = support::implicit_settings();
    compare("bilinear", &random_scene(3, 500, true, false), single, |l| l);
    let concentric = single.bins(BinLayout::Concentric { n: 12 });
    compare("concentric:12", &random_scene(4, 150, true, false), concentric, |l| l);
    let mixed = with_own_powers(random_scene(16, 200, true, false));
    compare("own powers, one page a tile", &mixed, single, |l| l.tile(32).page(1));
    compare("own powers, f64", &mixed, single.precision(Precision::F64), |l| l);
    let grey = with_own_powers(random_scene(18, 100, true, true));
    compare("own powers, grey", &grey, single, |l| l);
}

#[test]
fn double_precision() {
    let scene = random_scene(11, 150, true, false);
    let double = support::implicit_settings().precision(Precision::F64);
    compare("f64", &scene, double, |l| l);
    compare("f64, concentric", &scene, double.bins(BinLayout::Concentric { n: 12 }), |l| l);
}

/// Triangles that share a power take its matrix, which may have more columns than a dispatch binds; others do without.
#[test]
fn lobes_by_matrix_and_bin_by_bin() {
    let mixed = with_own_powers(random_scene(16, 200, true, false));
    let plan = Plan::new(&mixed, &PlanOptions::default(), &mixed.settings).expect("a plan");
    let lobes = plan.report().lobes;
    assert!(lobes.matrices > 0 && lobes.shared >= 8 && lobes.direct >= 8, "{lobes:?}");
    compare("own powers", &mixed, support::implicit_settings(), |l| l);
    let double = support::implicit_settings().precision(Precision::F64);
    let wide = double.bins(BinLayout::EqualAngle { theta: 24, phi: 23 });
    compare("f64, 552 columns", &random_scene(17, 40, true, false), wide, |l| l);
}

/// Lists of close sources longer than one dispatch takes.
#[test]
fn crowds() {
    compare("crowd", &scattered(10, 100, true, false, 0.25), support::implicit_settings(), |l| l);
}

#[test]
fn one_channel() {
    let scene = random_scene(5, 100, true, true);
    let plan = Plan::new(&scene, &PlanOptions::default(), &support::implicit_settings()).expect("a plan");
    assert_eq!(plan.channels(), 1);
    compare("grey", &scene, support::implicit_settings(), |l| l);
}

#[test]
fn small_tiles_and_pages() {
    let scene = random_scene(6, 300, true, false);
    compare("tiles of 32, one page a tile", &scene, support::implicit_settings(), |l| l.tile(32).page(1));
}

#[test]
fn without_a_near_field() {
    let scene = random_scene(8, 200, true, false);
    compare("no sub-samples", &scene, support::implicit_settings().near_field(0.0), |l| l);
}

/// Lavapipe's subgroups are as wide as the vectors of the CPU, unless a variable that it reads once says otherwise: in processes of their
/// own, kernels with half and twice the usual lanes.
#[test]
fn subgroups_of_other_widths() {
    let driver = device().info().driver.clone();
    if !driver.contains("llvmpipe") {
        println!("SKIPPED: subgroups of {driver} have one width");
        return;
    }
    let run = |bits: u32| {
        Command::new(std::env::current_exe().expect("this program"))
            .args(["--exact", "small_scenes_on_kernels_alone", "--ignored", "--nocapture"])
            .env("LP_NATIVE_VECTOR_WIDTH", bits.to_string())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("a process")
    };
    for (bits, run) in [128, 512].map(|bits| (bits, run(bits))) {
        let output = run.wait_with_output().expect("a run");
        let said = String::from_utf8_lossy(&output.stdout);
        let why = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && said.contains("1 passed"), "{bits} bits: {said}{why}");
        if !said.contains(&format!("subgroups of {} lanes", bits / 32)) {
            assert!(bits > 256, "{bits} bits: {said}");
            println!("SKIPPED: this CPU has no vectors of {bits} bits");
        }
    }
}

/// What depends on lanes: far and close pairs, with bins and without.
#[test]
#[ignore = "run by subgroups_of_other_widths"]
fn small_scenes_on_kernels_alone() {
    let glossy = random_scene(2, 100, true, false);
    let of_cpus = device();
    println!("subgroups of {} lanes", of_cpus.info().subgroup_size);
    for (name, on) in
        [("kernels", of_cpus), ("kernels for GPUs", device().with_kernels_for(DeviceKind::Discrete))]
    {
        let on = Backend::from(on);
        compare_on(&on, &format!("glossy, {name}"), &glossy, support::implicit_settings(), &|l| l);
    }
}

/// So many triangles that on a GPU those without bins have a lane each.
#[test]
#[ignore = "takes a minute: two kernels over a billion pairs, and the reference"]
fn very_many_triangles_on_kernels_for_gpus() {
    let down = DAffine3::from_scale(DVec3::new(1.0, -1.0, 1.0));
    let at = |height: f64| DAffine3::from_translation(DVec3::new(0.0, height, 0.0));
    let cells = Shape::Quad { cells: 92 };
    let mut builder = SceneBuilder::new();
    let lamp = Material { emission: [5.0, 4.0, 3.0], ..Material::named("lamp") };
    builder.shape("floor", cells, &Material::named("floor"), at(0.0)).shape(
        "lamp",
        cells,
        &lamp,
        at(1.0) * down,
    );
    let scene = builder.finish("two plates").map(support::implicit).expect("a scene");
    let settings = scene.settings;
    let device = device().with_kernels_for(DeviceKind::Discrete);
    let plan = Plan::new(&scene, &PlanOptions::of(&device), &settings).expect("a plan");
    assert!(
        plan.layout().slots() >= 1 << 15 && plan.layout().groups.iter().all(|group| !group.class.has_bins())
    );
    compare_on(&device.into(), "two plates", &scene, settings, &|l| l);
}

/// The harness fails against the reference of another scene, as it must.
#[test]
#[should_panic(expected = "relative error")]
fn a_wrong_kernel_would_be_found() {
    let scene = random_scene(9, 60, false, false);
    let backend = backend();
    let settings = support::implicit_settings();
    let plan = Plan::new(&scene, &PlanOptions::of(&backend), &settings).expect("a plan");
    let mut other = scene.clone();
    other.materials[1].albedo = [0.9, 0.1, 0.2];
    let mut engine = Engine::new(&backend, &other, plan).expect("an engine");
    let solution = engine.solve(&SolveParams::default().tolerance(1e-6).max_passes(100)).expect("a solution");
    let model = Model::new(&scene);
    let mut operator = &model;
    let params = antirad_core::solve::FixedPointParams::new(1e-6, 100);
    let (truth, _) = antirad_core::solve::fixed_point(&mut operator, &params, &mut |_, _| {
        std::ops::ControlFlow::Continue(())
    })
    .expect("a reference");
    let values: Vec<f64> = solution.irradiance.iter().flatten().copied().collect();
    let error = relative(&values, &flat(&truth.irradiance));
    assert!(error <= tolerance(settings.precision), "relative error {error:e}");
}

/// Structures shared with the shaders have the shaders' layout.
#[test]
fn layouts_agree_with_the_shaders() {
    macro_rules! check {
        ($shader:expr, $name:literal, $type:ty, [$($glsl:literal = $field:ident),* $(,)?]) => {
            let offsets = reflect::member_offsets($shader.spirv(), $name);
            let expected = [$(($glsl.to_owned(), std::mem::offset_of!($type, $field) as u32)),*];
            assert_eq!(offsets, expected, "{} of {}", $name, $shader.name());
        };
    }
    use vulkan::*;
    // Reals, then words, in both precisions: offsets in numbers of reals and of words.
    let laid_out = |shader: &RealShader, name: &str, reals: &[(&str, u32)], words: &[&str]| {
        for precision in [Precision::F32, Precision::F64] {
            let (shader, bytes) = (shader.of(precision), precision.bytes() as u32);
            let first = |(name, at): &(&str, u32)| ((*name).to_owned(), at * bytes);
            let mut expected: Vec<(String, u32)> = reals.iter().map(first).collect();
            let (total, reals) = reals.split_last().map_or((0, reals), |((_, total), reals)| (*total, reals));
            expected.truncate(reals.len());
            expected
                .extend(words.iter().zip(0..).map(|(name, k)| ((*name).to_owned(), total * bytes + 4 * k)));
            assert_eq!(
                reflect::member_offsets(shader.spirv(), name),
                expected,
                "{name} of {}",
                shader.name()
            );
        }
    };
    let facet = [("centre", 0), ("area", 3), ("normal", 4), ("characteristic_area", 7), ("", 8)];
    laid_out(&shaders::NEAR, "Facet", &facet, &[]);
    let surface = [
        ("diffuse", 0),
        ("power", 3),
        ("emission", 4),
        ("unused_emission", 7),
        ("specular", 8),
        ("unused_specular", 11),
        ("", 12),
    ];
    laid_out(&shaders::REFLECT, "Surface", &surface, &[]);
    let gradient = [
        ("a", 0),
        ("area", 3),
        ("b", 4),
        ("characteristic_area", 7),
        ("c", 8),
        ("unused_corner", 11),
        ("normal", 12),
        ("unused_normal", 15),
        ("", 16),
    ];
    laid_out(&shaders::NEAR_DERIVATIVE, "FacetGradient", &gradient, &[]);
    laid_out(
        &shaders::OBSERVE_DERIVATIVE,
        "ObservePush",
        &[("camera_position", 0), ("", 3)],
        &["begin", "end"],
    );
    laid_out(&shaders::OBSERVE, "ObservePush", &[("camera_position", 0), ("", 3)], &["begin", "end"]);
    laid_out(&shaders::COMBINE, "Push", &[("a", 0), ("b", 1), ("", 2)], &["count"]);
    for shader in [
        shaders::TRANSPORT_IRRADIANCE.of(Precision::F64),
        shaders::TRANSPORT_BINS.of(Precision::F32),
        shaders::TRANSPORT_BINS_ADJOINT.of(Precision::F64),
        shaders::TRANSPORT_DERIVATIVE.of(Precision::F64),
    ] {
        check!(
            shader,
            "FarPush",
            FarPush,
            [
                "target_tile" = target_tile,
                "partner_begin" = partner_begin,
                "partner_end" = partner_end,
                "half_range" = half_range,
                "target_page" = target_page,
                "partner_page" = partner_page,
                "passing" = passing,
            ]
        );
    }
    for shader in [
        shaders::NEAR.of(Precision::F64),
        shaders::NEAR_ADJOINT.of(Precision::F32),
        shaders::NEAR_DERIVATIVE.of(Precision::F64),
    ] {
        check!(
            shader,
            "NearPush",
            NearPush,
            [
                "target_begin" = target_begin,
                "targets" = targets,
                "partner_begin" = partner_begin,
                "partner_end" = partner_end,
                "half_range" = half_range,
                "target_page" = target_page,
                "partner_page" = partner_page,
                "backs" = backs,
                "skip" = skip,
                "take" = take,
            ]
        );
    }
    check!(
        shaders::REFLECT.of(Precision::F64),
        "ReflectPush",
        ReflectPush,
        ["count" = count, "emission" = emission, "reflection" = reflection]
    );
    check!(
        shaders::REFLECT_GLOSSY.of(Precision::F64),
        "GlossyPush",
        GlossyPush,
        ["page" = page, "list" = list, "first" = first, "count" = count]
    );
    for shader in [
        shaders::REFLECT_LOBES.of(Precision::F32),
        shaders::REFLECT_LOBES_ADJOINT.of(Precision::F64),
        shaders::REFLECT_LOBES_DERIVATIVE.of(Precision::F64),
    ] {
        check!(
            shader,
            "LobePush",
            LobePush,
            [
                "page" = page,
                "first" = first,
                "count" = count,
                "first_row" = first_row,
                "blocks" = blocks,
                "begin" = begin,
                "end" = end,
            ]
        );
    }
    check!(
        shaders::REFLECT_ADJOINT.of(Precision::F64),
        "ReflectAdjointPush",
        ReflectAdjointPush,
        ["count" = count, "given" = given]
    );
    check!(
        shaders::REFLECT_GLOSSY_DERIVATIVE.of(Precision::F64),
        "GlossyDerivativePush",
        GlossyDerivativePush,
        ["page" = page, "list" = list, "count" = count, "bin_begin" = bin_begin, "bin_end" = bin_end]
    );
    check!(
        shaders::REFLECT_GLOSSY_ADJOINT.of(Precision::F64),
        "GlossyPush",
        GlossyPush,
        ["page" = page, "list" = list, "first" = first, "count" = count]
    );
    check!(
        shaders::NEAR_MATRIX.of(Precision::F64),
        "NearMatrixPush",
        NearMatrixPush,
        ["first_slice" = first_slice, "skip" = skip, "take" = take]
    );
    check!(shaders::DOT.of(Precision::F64), "DotPush", DotPush, ["count" = count, "add" = add]);
    check!(
        shaders::PROJECT.of(Precision::F64),
        "ProjectPush",
        ProjectPush,
        ["count" = count, "add" = add, "norm" = norm, "number" = number]
    );
}

/// A step of GMRES on a GPU, after its pass: one submission, which the host waits for once, makes the vector orthonormal and brings its
/// column and irradiance; with vectors in host memory the same comes step by step. On the CPU there are no submissions.
#[test]
fn a_vector_is_orthonormal_after_one_submission() {
    let scene = random_scene(12, 200, true, false);
    for precision in [Precision::F32, Precision::F64] {
        let settings = support::implicit_settings().precision(precision);
        let device = Backend::from(device().with_kernels_for(DeviceKind::Discrete));
        let options = PlanOptions::of(&device);
        let run = |backend: &Backend, options: &PlanOptions| {
            let submissions = || backend.vulkan().map_or(0, Device::submissions);
            let plan = Plan::new(&scene, options, &settings).expect("a plan");
            let resident = plan.residency() == Residency::Device;
            let mut operators = operators(backend, &scene, &plan);
            let groups = operators.plan().layout().groups.len();
            let mut random = Random::new(3);
            let mut basis = Vec::new();
            let mut found = Vec::new();
            for k in 0..4 {
                let mut next = operators.vector().expect("a vector");
                let mut value = |_: &f64| random.next() - 0.3;
                let mut values = |page: Vec<f64>| page.iter().map(&mut value).collect::<Vec<_>>();
                let irradiance = operators.irradiance(&next).expect("zeros");
                let irradiance: Vec<[f64; 4]> =
                    irradiance.iter().map(|slot| std::array::from_fn(|k| values(vec![slot[k]])[0])).collect();
                let pages = (0..groups).map(|g| operators.bins(&next, g).expect("zeros").map(&mut values));
                let pages: Vec<_> = pages.collect();
                operators.set(&mut next, &irradiance, &pages).expect("random values");
                let before = submissions();
                let Orthonormalised { column, judged } =
                    operators.orthonormalise(&basis, &mut next, 0.0).expect("a vector of the basis");
                let submissions = submissions() - before;
                let expected = u64::from(backend.vulkan().is_some());
                assert!(k == 0 || !resident || submissions == expected, "{submissions} submissions");
                assert_eq!(column.len(), k + 1);
                assert_eq!(judged, operators.judged(&next).expect("irradiance"));
                basis.push(next);
                for (i, v) in basis.iter().enumerate() {
                    let product = operators.dot(v, &basis[k]).expect("a product");
                    let off = (product - f64::from(u8::from(i == k))).abs();
                    // NaN must not go unnoticed.
                    assert!(off <= 0.1 * tolerance(precision), "⟨v{i}, v{k}⟩ = {product}");
                }
                found.push((column, judged));
            }
            // What the basis spans already is zero.
            let mut spanned = operators.vector().expect("a vector");
            operators.combine(2.0, &basis[3], 0.0, &mut spanned).expect("a copy");
            operators.orthonormalise(&basis, &mut spanned, 1e-3).expect("nothing");
            assert_eq!(operators.dot(&spanned, &spanned).expect("a product"), 0.0);
            (resident, found)
        };
        let small = match Plan::new(&scene, &options.memory_budget(1), &settings) {
            Err(PlanError::OverBudget { needed, .. }) => options.memory_budget(needed + 4096),
            other => panic!("{other:?}"),
        };
        let (resident, on_device) = run(&device, &options.page(1));
        let (hosted, on_host) = run(&device, &small);
        assert!(resident && !hosted);
        let [a, b] = [&on_device, &on_host].map(|found| {
            found
                .iter()
                .flat_map(|(c, j)| [&c[..], j.as_deref().unwrap_or_default()].concat())
                .collect::<Vec<f64>>()
        });
        assert!(same(&device, &a, &b), "{precision:?}");
        let cpu = Backend::cpu();
        run(&cpu, &PlanOptions::of(&cpu));
        finish(&device);
    }
}

/// A pass between triangles on a GPU, reflection, zeros, close pairs and all others, with what orthonormalises its result: one submission,
/// unless a busy machine takes longer for it than a submission may.
#[test]
fn a_step_of_the_solver_is_one_submission() {
    for (number, count, glossy) in [(1, 40, false), (2, 24, true)] {
        let scene = scattered(number, count, glossy, false, 1.0);
        let device = device().with_kernels_for(DeviceKind::Discrete);
        let options = PlanOptions::of(&device).keep_near_field(false).occlusion(Occlusion::Everything);
        let plan = Plan::new(&scene, &options, &support::implicit_settings()).expect("a plan");
        let mut operators = operators(&Backend::from(&device), &scene, &plan);
        let mut vectors: Vec<_> = (0..12).map(|_| operators.vector().expect("a vector")).collect();
        let (basis, next) = vectors.split_at_mut(1);
        operators.pass(None, true, &mut basis[0]).expect("a pass");
        operators.orthonormalise(&[], &mut basis[0], 0.0).expect("a vector of the basis");
        // The first ones tell how much work a submission may be.
        let mut submissions = Vec::new();
        for y in next {
            let before = device.submissions();
            operators.pass(Some(&basis[0]), false, y).expect("a pass");
            operators.orthonormalise(basis, y, 0.0).expect("a vector of the basis");
            submissions.push(device.submissions() - before);
        }
        println!("{submissions:?}");
        assert_eq!(submissions.iter().min(), Some(&1), "{submissions:?}");
        finish(&device);
    }
}
