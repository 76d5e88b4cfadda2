//! Every kernel on the device against its f64 twin, on random scenes with blockers, glossy and close triangles.

#[path = "support/reflect.rs"]
mod reflect;
mod support;

use antirad::plan::{Class, Limits, PADDING, Plan};
use antirad::reference::{Model, State, observe, transport};
use antirad::scene::{Accuracy, BinLayout, Scene, Weights};
use antirad::solve::LightOperator;
use antirad::transport::{Operators, SceneBuffers};
use antirad::{Engine, SolveParams, shaders, transport as device_side};
use glam::DVec3;
use support::random::{Random, random_scene, scattered};
use support::{device, finish};

/// Relative error of each kernel, in the 2-norm over all its output.
const TOLERANCE: f64 = 1e-4;

fn relative(values: &[f64], truth: &[f64]) -> f64 {
    assert_eq!(values.len(), truth.len());
    let norm = |v: &mut dyn Iterator<Item = f64>| v.map(|x| x * x).sum::<f64>().sqrt();
    let size = norm(&mut truth.iter().copied());
    let error = norm(&mut values.iter().zip(truth).map(|(a, b)| a - b));
    if size > 0.0 { error / size } else { error }
}

/// RGB values per slot, of the triangles that take part.
fn by_slot(plan: &Plan, values: impl Fn(usize) -> DVec3) -> Vec<[f32; 4]> {
    let value = |&i: &u32| if i == PADDING { DVec3::ZERO } else { values(i as usize) };
    plan.layout.order.iter().map(|i| value(i).as_vec3().extend(0.0).to_array()).collect()
}

/// Flattens what the device holds per slot, in the order of the scene.
fn rgb_of(plan: &Plan, slots: &[[f32; 4]]) -> Vec<f64> {
    let mut all = vec![0.0; plan.facets.len() * 3];
    for (&i, value) in plan.layout.order.iter().zip(slots).filter(|(i, _)| **i != PADDING) {
        for c in 0..3 {
            all[i as usize * 3 + c] = f64::from(value[c]);
        }
    }
    all
}

/// Pages of bins as the device holds them, from bins of the reference.
fn to_pages(model: &Model, plan: &Plan, bins: &[DVec3]) -> Vec<Option<Vec<f32>>> {
    let channels = plan.channels as usize;
    let width = model.bins.count() * channels;
    plan.layout
        .groups
        .iter()
        .map(|group| {
            group.class.has_bins().then(|| {
                let slots = plan.layout.slots_of(&group.tiles);
                let mut page = vec![0.0; slots.len() * width];
                for (row, slot) in page.chunks_mut(width).zip(slots) {
                    let i = plan.layout.order[slot as usize];
                    if i == PADDING {
                        continue;
                    }
                    let Some(range) = model.bins_of(i as usize) else { continue };
                    for (value, rgb) in row.chunks_mut(channels).zip(&bins[range]) {
                        for (c, v) in value.iter_mut().enumerate() {
                            *v = rgb[c] as f32;
                        }
                    }
                }
                page
            })
        })
        .collect()
}

/// Flattens pages of the device, in the order of the reference; groups that have none count as zero.
fn from_pages(model: &Model, plan: &Plan, pages: &[Option<Vec<f32>>], total: usize) -> Vec<f64> {
    let channels = plan.channels as usize;
    let width = model.bins.count() * channels;
    let mut all = vec![0.0; total * 3];
    for (group, page) in plan.layout.groups.iter().zip(pages) {
        let Some(page) = page else { continue };
        for (row, slot) in page.chunks(width).zip(plan.layout.slots_of(&group.tiles)) {
            let i = plan.layout.order[slot as usize];
            let Some(range) = (i != PADDING).then(|| model.bins_of(i as usize)).flatten() else { continue };
            for (b, value) in range.zip(row.chunks(channels)) {
                for c in 0..3 {
                    all[b * 3 + c] = f64::from(value[if channels == 1 { 0 } else { c }]);
                }
            }
        }
    }
    all
}

fn flat(rgb: &[DVec3]) -> Vec<f64> {
    rgb.iter().flat_map(|v| v.to_array()).collect()
}

/// Masks bins by class: the reference computes both kinds for every triangle with bins.
fn of_class(model: &Model, bins: &[DVec3], wanted: impl Fn(Class) -> bool) -> Vec<f64> {
    let mut kept = vec![DVec3::ZERO; bins.len()];
    for (i, &class) in model.classes.iter().enumerate() {
        if let Some(range) = model.bins_of(i).filter(|_| wanted(class)) {
            kept[range.clone()].copy_from_slice(&bins[range]);
        }
    }
    flat(&kept)
}

fn compare(name: &str, scene: &Scene, accuracy: Accuracy, limits: impl Fn(Limits) -> Limits) {
    let device = device();
    let scene = Scene { accuracy, ..scene.clone() };
    let model = Model::new(&scene);
    let plan = Plan::new(&scene, &limits(Limits::of(&device)), &accuracy).expect("a plan");
    let buffers = SceneBuffers::new(&device, &scene, &plan).expect("buffers");
    let mut operators = Operators::new(&device, plan.clone(), buffers).expect("operators");

    // Some light everywhere: a random state, the irradiance being the sum of the bins where there are any.
    let mut random = Random(7);
    let mut light = |_| if plan.channels == 1 { DVec3::splat(random.next()) } else { random.point() };
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
    let x = operators.vector().expect("a vector");
    let irradiance = by_slot(&plan, |i| state.irradiance[i]);
    operators.set(&x, &irradiance, &to_pages(&model, &plan, &state.bins)).expect("an upload");

    let total = state.bins.len();
    let mut leaving = model.leave(&state);
    for (l, e) in leaving.diffuse.iter_mut().zip(antirad::reference::emission(&model).diffuse) {
        *l += e;
    }
    let mut errors = Vec::new();
    let given = operators.leaving(&x).expect("what leaves");
    errors.push(("reflect", relative(&rgb_of(&plan, &given.radiance), &flat(&leaving.diffuse))));
    let specular = of_class(&model, &leaving.specular, |c| c.glossy);
    errors.push(("reflect_glossy", relative(&from_pages(&model, &plan, &given.specular, total), &specular)));
    let mut y = operators.vector().expect("a vector");
    operators.pass(Some(&x), true, &mut y).expect("a pass");
    let arriving = transport(&model, &leaving);
    let irradiance = operators.irradiance(&y).expect("irradiance");
    errors
        .push(("transport, irradiance", relative(&rgb_of(&plan, &irradiance), &flat(&arriving.irradiance))));
    let pages: Vec<_> = (0..plan.layout.groups.len()).map(|g| operators.bins(&y, g).expect("bins")).collect();
    errors.push((
        "transport, bins",
        relative(&from_pages(&model, &plan, &pages, total), &flat(&arriving.bins)),
    ));

    let eye = DVec3::new(3.0, 0.5, -1.0);
    let colours = operators.observe(&x, eye).expect("colours");
    errors.push(("observe", relative(&rgb_of(&plan, &colours), &flat(&observe(&model, &leaving, eye)))));

    let blockers = model.classes.iter().filter(|c| c.blocker).count();
    println!(
        "{name}: {} triangles, {blockers} blockers, {} close pairs",
        model.facets.len(),
        plan.near.sources.len()
    );
    for (kernel, error) in errors {
        println!("  {kernel}: {error:.2e}");
        assert!(error <= TOLERANCE, "{name}, {kernel}: relative error {error:e}");
    }
    finish(&device);
}

#[test]
fn diffuse_and_glossy_scenes_of_all_sizes() {
    for (seed, triangles, glossy) in [(1, 50, false), (2, 131, true), (3, 500, true)] {
        compare("bilinear", &random_scene(seed, triangles, glossy, false), Accuracy::default(), |l| l);
    }
}

#[test]
fn other_weights_and_layouts() {
    let scene = random_scene(4, 150, true, false);
    let smooth = Accuracy { weights: Weights::Smoothstep, ..Accuracy::default() };
    compare("smoothstep", &scene, smooth, |l| l);
    let concentric = Accuracy { bins: BinLayout::Concentric { n: 12 }, ..Accuracy::default() };
    compare("concentric", &scene, concentric, |l| l);
    let both = Accuracy {
        weights: Weights::Smoothstep,
        bins: BinLayout::Concentric { n: 4 },
        ..Accuracy::default()
    };
    compare("concentric, smoothstep", &scene, both, |l| l);
}

/// Lists of close sources longer than one dispatch takes.
#[test]
fn crowds() {
    compare("crowd", &scattered(10, 150, true, false, 0.3), Accuracy::default(), |l| l);
}

#[test]
fn one_channel() {
    let scene = random_scene(5, 100, true, true);
    let device = device();
    let plan = Plan::new(&scene, &Limits::of(&device), &Accuracy::default()).expect("a plan");
    assert_eq!(plan.channels, 1);
    compare("grey", &scene, Accuracy::default(), |l| l);
}

#[test]
fn small_tiles_and_pages() {
    let scene = random_scene(6, 300, true, false);
    compare("tiles of 32, one page a tile", &scene, Accuracy::default(), |l| Limits {
        tile: 32,
        page: 1,
        ..l
    });
}

#[test]
fn without_a_near_field() {
    let scene = random_scene(8, 200, true, false);
    compare("no sub-samples", &scene, Accuracy { subsample: 0.0, ..Accuracy::default() }, |l| l);
}

/// The harness can fail: against the reference of another scene it does.
#[test]
#[should_panic(expected = "relative error")]
fn a_wrong_kernel_would_be_found() {
    let scene = random_scene(9, 60, false, false);
    let device = device();
    let accuracy = Accuracy::default();
    let plan = Plan::new(&scene, &Limits::of(&device), &accuracy).expect("a plan");
    let mut other = scene.clone();
    other.materials[1].albedo = [0.9, 0.1, 0.2];
    let mut engine = Engine::new(&device, &other, plan).expect("an engine");
    let solution = engine.solve(&SolveParams { tolerance: 1e-6, max_passes: 100 }).expect("a solution");
    let model = Model::new(&scene);
    let mut operator = &model;
    let params = antirad::solve::FixedPointParams { tolerance: 1e-6, max_passes: 100 };
    let (truth, _) =
        antirad::solve::fixed_point(&mut operator, &params, &mut |_, _| std::ops::ControlFlow::Continue(()))
            .expect("a reference");
    let values: Vec<f64> = solution.irradiance.iter().flatten().map(|&x| f64::from(x)).collect();
    let error = relative(&values, &flat(&truth.irradiance));
    assert!(error <= TOLERANCE, "relative error {error:e}");
}

/// Structures shared with the shaders lie in memory as the shaders see them.
#[test]
fn layouts_agree_with_the_shaders() {
    macro_rules! check {
        ($shader:expr, $name:literal, $type:ty, [$($glsl:literal = $field:ident),* $(,)?]) => {
            let offsets = reflect::member_offsets($shader.spirv, $name);
            let expected = [$(($glsl.to_owned(), std::mem::offset_of!($type, $field) as u32)),*];
            assert_eq!(offsets, expected, "{} of {}", $name, $shader.name);
        };
    }
    use device_side::*;
    check!(
        shaders::NEAR,
        "Facet",
        FacetData,
        ["centre" = centre, "area" = area, "normal" = normal, "extent" = extent]
    );
    check!(
        shaders::REFLECT,
        "Surface",
        SurfaceData,
        [
            "diffuse" = diffuse,
            "power" = power,
            "emission" = emission,
            "unused_emission" = unused_emission,
            "specular" = specular,
            "unused_specular" = unused_specular,
        ]
    );
    for shader in [&shaders::TRANSPORT_IRRADIANCE, &shaders::TRANSPORT_BINS] {
        check!(
            shader,
            "FarPush",
            FarPush,
            [
                "receiver_tile" = receiver_tile,
                "source_begin" = source_begin,
                "source_end" = source_end,
                "row_words" = row_words,
                "half_range" = half_range,
                "receiver_page" = receiver_page,
                "source_page" = source_page,
                "passing" = passing,
            ]
        );
    }
    check!(
        shaders::NEAR,
        "NearPush",
        NearPush,
        [
            "receiver_begin" = receiver_begin,
            "receiver_end" = receiver_end,
            "source_begin" = source_begin,
            "source_end" = source_end,
            "half_range" = half_range,
            "receiver_page" = receiver_page,
            "source_page" = source_page,
            "backs" = backs,
            "skip" = skip,
            "take" = take,
        ]
    );
    check!(
        shaders::REFLECT,
        "ReflectPush",
        ReflectPush,
        ["count" = count, "emission" = emission, "reflection" = reflection]
    );
    check!(
        shaders::REFLECT_GLOSSY,
        "GlossyPush",
        GlossyPush,
        ["page" = page, "first" = first, "count" = count]
    );
    check!(shaders::OBSERVE, "ObservePush", ObservePush, ["eye" = eye, "begin" = begin, "end" = end]);
    check!(shaders::COMBINE, "Push", CombinePush, ["count" = count, "a" = a, "b" = b]);
    check!(shaders::DOT, "DotPush", DotPush, ["count" = count]);
}
