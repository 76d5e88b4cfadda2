//! Clusters in place of far triangles: their error against the exact sum, and where they give way to it.

mod support;

use antirad::gpu::{Device, DeviceKind};
use antirad::model::{LIST, Parts, VolumeParts, classify, share};
use antirad::plan::{GradientRequest, Plan, PlanError, PlanOptions, PlannedTransport, Residency};
use antirad::reference::Model;
use antirad::scene::{Lamps, Precision, Scene, SolveSettings, Transport};
use antirad::{Cotangent, Engine, Gradients, SolveParams};
use glam::DVec3;
use std::time::Instant;
use support::random::balls;
use support::{areas, device, finish, load, relative_l2, solve, solve_within};

/// Bytes of bins in one buffer: of all triangles of a class in small scenes, or of some hundred.
const PAGE: u64 = 128 << 20;
const SMALL_PAGE: u64 = 512 << 10;

fn hierarchical(scene: &Scene, error: f64) -> SolveSettings {
    scene.settings.transport(Transport::Hierarchical { error })
}

fn planned(scene: &Scene, settings: &SolveSettings, options: PlanOptions) -> Plan {
    Plan::new(scene, &options, settings).expect("a plan")
}

fn why(plan: &Plan) -> &'static str {
    match plan.transport() {
        PlannedTransport::Exact { why } => why,
        PlannedTransport::Hierarchical { .. } => "",
    }
}

/// The whole solve, fixed point against fixed point, with both ways to compute the light of lamps.
#[test]
fn the_error_is_at_most_the_one_asked_for() {
    let device = device();
    let cases = [
        ("scenes/cornell_boxes.toml", 0, Lamps::Exact, [0.03, 0.01]),
        ("scenes/cornell_boxes.toml", 0, Lamps::Antiradiance, [0.1, 0.03]),
        ("scenes/closed_box.toml", 1, Lamps::Exact, [0.03, 0.01]),
    ];
    for (name, cuts, lamps, errors) in cases {
        let mut scene = load(name);
        scene.split_all(cuts);
        scene.settings = scene.settings.lamps(lamps);
        let areas = areas(&scene);
        let exact = solve(&device, &scene, &scene.settings.transport(Transport::Exact)).1.irradiance;
        for error in errors {
            let (engine, solution) = solve(&device, &scene, &hierarchical(&scene, error));
            let pairs = engine.plan().pairs();
            let found = relative_l2(&solution.irradiance, &exact, &areas);
            let evaluated = pairs.irradiance + pairs.bins;
            println!("{name}, {lamps:?}, {error}: {found:.5}, {evaluated} of {} pairs", pairs.total);
            assert_eq!(engine.plan().transport(), PlannedTransport::Hierarchical { error });
            assert!(found <= error, "{name}: {found}");
            assert!(found > 0.0 && pairs.clusters > 0);
        }
    }
    finish(&device);
}

/// Many small objects: the error is at most the one asked for, with volumes and fewer interactions than without, which plans with derivatives
/// do not have.
#[test]
fn volumes_stand_for_objects() {
    let device = device();
    for (scene, errors) in [(balls(4, 3, false), [0.1, 0.03]), (balls(4, 3, true), [0.3, 0.1])] {
        let exact = solve(&device, &scene, &scene.settings.transport(Transport::Exact)).1.irradiance;
        for error in errors {
            let settings = hierarchical(&scene, error);
            let (engine, solution) = solve(&device, &scene, &settings);
            let options = PlanOptions::of(&device).gradients(GradientRequest::NOTHING.albedo(true));
            let without = planned(&scene, &settings, options);
            assert!(without.clusters().is_none_or(|clusters| clusters.volumes().is_none()));
            let found = relative_l2(&solution.irradiance, &exact, &areas(&scene));
            let evaluated = |plan: &Plan| plan.pairs().irradiance + plan.pairs().bins;
            let pairs = [engine.plan(), &without].map(evaluated);
            println!("balls, {error}: {found:.5}, {pairs:?} pairs");
            assert!(engine.plan().clusters().is_some_and(|clusters| clusters.volumes().is_some()));
            assert!(pairs[0] < pairs[1], "{pairs:?}");
            assert!(found <= error && found > 0.0, "{found}");
        }
    }
    finish(&device);
}

fn gradients(device: &Device, scene: &Scene, settings: &SolveSettings, page: u64) -> Gradients {
    let request = GradientRequest::default().emission(true).albedo(true).positions(true);
    let options = PlanOptions::of(device).gradients(request).page(page);
    let plan = planned(scene, settings, options);
    let clusters = plan.clusters().is_some();
    assert_eq!(clusters, settings.transport != Transport::Exact, "{}", plan.transport());
    let mut engine = Engine::new(device, scene, plan).expect("an engine");
    let params = SolveParams::from(settings);
    let start = Instant::now();
    let solution = engine.solve(&params).expect("a solution");
    let forward = start.elapsed().as_secs_f64();
    // More light near the origin, less elsewhere: a loss with large gradients everywhere.
    let weight = |(i, area): (usize, f64)| {
        let height = scene.corners(i)[0].y;
        area * DVec3::new(1.0, 0.5 + height, (7.0 * height).sin())
    };
    let irradiance = areas(scene).into_iter().enumerate().map(weight).collect();
    let cotangent = Cotangent::default().irradiance(Some(irradiance));
    let start = Instant::now();
    let found = engine.backward(&solution, &cotangent, request, &params).expect("gradients");
    println!("forward {forward:.2} s, backward {:.2} s", start.elapsed().as_secs_f64());
    found
}

fn relative(found: &[DVec3], truth: &[DVec3]) -> f64 {
    let norm =
        |values: &mut dyn Iterator<Item = DVec3>| values.map(|v| v.length_squared()).sum::<f64>().sqrt();
    norm(&mut found.iter().zip(truth).map(|(f, t)| *f - *t)) / norm(&mut truth.iter().copied())
}

/// Gradients of a loss through clusters, against those of the exact sum: as accurate as irradiance, those by each triangle, too, since
/// the importance of light is linear within a cluster.
#[test]
fn gradients_are_those_of_the_exact_sum() {
    let device = device();
    let scene = load("scenes/cornell_boxes.toml");
    let values = |g: &Gradients| {
        let by_material = g.by_material(&scene);
        let corners = g.corners.as_ref().expect("what was asked for");
        let of_boxes = corners.iter().zip(classify(&scene)).filter(|(_, class)| class.blocker);
        let moved: DVec3 = of_boxes.flat_map(|(corners, _)| corners).sum();
        let each = |values: &Option<Vec<DVec3>>| values.clone().expect("what was asked for");
        [
            by_material.iter().map(|m| m.emission).collect(),
            by_material.iter().map(|m| m.albedo).collect(),
            vec![moved],
            each(&g.emission),
            each(&g.albedo),
            each(&g.vertices),
        ]
    };
    let names = ["emission", "albedo", "boxes moved", "each emission", "each albedo", "each vertex"];
    let truth = values(&gradients(&device, &scene, &scene.settings.transport(Transport::Exact), PAGE));
    // With derivatives by vertices clusters are those of a tenth of the error.
    let clusters = hierarchical(&scene, 0.1);
    let bounds = [0.003, 0.005, 0.005, 0.0125, 0.01, 0.0125];
    let within_bounds = |found: &[Vec<DVec3>]| {
        for (((name, found), truth), bound) in names.iter().zip(found).zip(&truth).zip(bounds) {
            let off = relative(found, truth);
            println!("{name}: {off:.5}");
            assert!(off <= bound, "{name}: {off}");
        }
    };
    within_bounds(&values(&gradients(&device, &scene, &clusters, PAGE)));
    let in_pages = values(&gradients(&device, &scene, &clusters, SMALL_PAGE));
    within_bounds(&in_pages);
    // Where the device is a CPU the host computed these.
    for kind in [DeviceKind::Cpu, DeviceKind::Discrete] {
        let by_kernels = device.clone().with_kernels_for(kind);
        let by_kernels = values(&gradients(&by_kernels, &scene, &clusters, SMALL_PAGE));
        for ((name, found), by_kernels) in names.iter().zip(&in_pages).zip(&by_kernels) {
            let off = relative(found, by_kernels);
            println!("{name} of the host and of kernels for {kind}: {off:.1e}");
            assert!(off <= 1e-4, "{name}: {off}");
        }
    }
    finish(&device);
}

#[test]
fn the_same_input_gives_the_same_bytes() {
    let device = device();
    for (scene, error) in [(load("scenes/cornell_boxes.toml"), 0.01), (balls(4, 3, true), 0.1)] {
        let solved = || solve(&device, &scene, &hierarchical(&scene, error)).1.irradiance;
        assert!(solved() == solved(), "the results differ");
    }
    finish(&device);
}

/// Every receiver gets each other triangle once: as itself, within a cluster, or not at all where light cannot pass.
#[test]
fn no_triangle_is_missing_or_there_twice() {
    let scene = load("scenes/cornell_boxes.toml");
    let runs = [PAGE, SMALL_PAGE].map(|page| {
        let options = PlanOptions::default().boundless().cull(false).page(page);
        let plan = planned(&scene, &hierarchical(&scene, 0.03), options);
        each_triangle_is_there_once(&scene, &plan);
        plan.clusters().map_or(0, |clusters| clusters.runs().len())
    });
    assert!(runs[0] < runs[1], "{runs:?}");
    let scene = balls(4, 3, true);
    let options = PlanOptions::default().boundless().cull(false).page(SMALL_PAGE);
    let plan = planned(&scene, &hierarchical(&scene, 0.1), options);
    assert!(plan.clusters().is_some_and(|clusters| clusters.volumes().is_some()));
    each_triangle_is_there_once(&scene, &plan);
}

fn each_triangle_is_there_once(scene: &Scene, plan: &Plan) {
    let clusters = plan.clusters().expect("clusters");
    let first = clusters.first();
    let mut members: Vec<Vec<usize>> = Vec::new();
    for parts in clusters.parts() {
        members.push(match parts {
            Parts::Triangles(slots) => clusters.triangles(slots).collect(),
            Parts::Clusters(both) => {
                both.iter().flat_map(|part| members[(part - first) as usize].clone()).collect()
            }
        });
    }
    if let Some(volumes) = clusters.volumes() {
        let begin = volumes.run().range().start;
        for parts in volumes.parts() {
            members.push(match parts {
                VolumeParts::Triangles(at) => {
                    let slots = &volumes.slots()[at.start as usize..at.end as usize];
                    slots.iter().map(|&slot| clusters.order()[slot as usize] as usize).collect()
                }
                VolumeParts::Volumes(both) => {
                    assert!(both.iter().all(|&part| part >= begin));
                    both.iter().flat_map(|part| members[(part - first) as usize].clone()).collect()
                }
            });
        }
    }
    for list in 0..clusters.sources().lists() {
        let mut seen = vec![0; scene.triangles.len()];
        for (index, _) in clusters.sources().sources(list) {
            match clusters.order().get(index as usize) {
                Some(&i) => seen[i as usize] += 1,
                None => members[(index - first) as usize].iter().for_each(|&i| seen[i] += 1),
            }
        }
        let triangles = clusters.triangles(&(list * LIST..(list + 1) * LIST));
        if triangles.count() > 0 {
            assert!(seen.iter().all(|&count| count == 1), "list {list}");
        }
    }
}

/// The mean triangle sends what its triangles send, far away.
#[test]
fn a_cluster_has_the_vector_area_of_its_triangles() {
    let scene = load("scenes/cornell_boxes.toml");
    let plan = planned(&scene, &hierarchical(&scene, 0.03), PlanOptions::default().boundless());
    let clusters = plan.clusters().expect("clusters");
    let model = Model::new(&scene);
    let facets = clusters.facets(&model.facets);
    for (parts, mean) in clusters.parts().iter().zip(&facets) {
        let Parts::Triangles(slots) = parts else { continue };
        let of = || clusters.triangles(slots).map(|i| &model.facets[i]);
        let sum: DVec3 = of().map(|f| f.area * f.normal).sum();
        let own: f64 = of().map(|f| share(f, mean)).sum::<f64>() * mean.area;
        let area: f64 = of().map(|f| f.area).sum();
        // Of triangles that face away from each other it may be rounding alone.
        assert!((own - sum.length()).abs() <= 1e-12 * area, "{own} {}", sum.length());
        if area > 0.0 {
            let centre = of().map(|f| f.area * f.centroid).sum::<DVec3>() / area;
            assert!((mean.centroid - centre).length() <= 1e-9);
        }
    }
}

#[test]
fn the_exact_sum_is_taken_where_clusters_do_not_work_or_pay() {
    let scene = load("scenes/cornell_boxes.toml");
    let settings = hierarchical(&scene, 0.01);
    let options = PlanOptions::default();
    assert_eq!(why(&planned(&scene, &settings, options)), "");
    let with_gradients = options.gradients(GradientRequest::NOTHING.emission(true).albedo(true));
    assert_eq!(why(&planned(&scene, &settings, with_gradients)), "");
    let by_vertices = options.gradients(GradientRequest::EVERYTHING);
    assert_eq!(why(&planned(&scene, &hierarchical(&scene, 0.1), by_vertices)), "");
    assert_eq!(why(&planned(&scene, &settings, by_vertices)), "clusters would save too little");
    let few = planned(&scene, &scene.settings.transport(Transport::Auto), options);
    assert_eq!(why(&few), "few triangles");
    let mut fine = scene.clone();
    fine.split_all(1);
    let automatic = fine.settings.transport(Transport::Auto);
    assert_eq!(why(&planned(&fine, &automatic, options)), "no error is allowed for");
    let strict = planned(&scene, &hierarchical(&scene, 1e-5), options);
    assert_eq!(why(&strict), "clusters would save too little");
    let stated = scene.settings.transport(Transport::Exact);
    assert_eq!(why(&planned(&scene, &stated, options)), "settings");
    let options = barely(&scene);
    let short = planned(&scene, &settings, options);
    assert_eq!(why(&short), "clusters do not fit the memory budget");
    assert_ne!(short.residency(), Residency::Device);
    assert!(short.report().to_string().contains("clusters do not fit the memory budget"));
}

/// A budget that states of the exact sum need, streamed.
fn barely(scene: &Scene) -> PlanOptions {
    let none = PlanOptions::default().memory_budget(1);
    match Plan::new(scene, &none, &scene.settings) {
        Err(PlanError::OverBudget { needed, .. }) => PlanOptions::default().memory_budget(needed + 65_536),
        other => panic!("one byte suffices: {other:?}"),
    }
}

/// Where clusters give way for lack of memory, the result is that of the exact sum, byte for byte.
#[test]
fn without_memory_for_clusters_the_result_is_exact() {
    let device = device();
    let scene = load("scenes/cornell_boxes.toml");
    let options = barely(&scene);
    let one = solve_within(&device, &scene, &hierarchical(&scene, 0.01), &options).1.irradiance;
    let other = solve_within(&device, &scene, &scene.settings, &options).1.irradiance;
    assert!(one == other, "the results differ");
    finish(&device);
}

/// Half bins are those of pairs of tiles; clusters read f32.
#[test]
fn half_bins_and_clusters_go_together() {
    let device = device();
    let scene = load("scenes/cornell_boxes.toml");
    let settings = hierarchical(&scene, 0.01);
    let half = settings.precision(Precision::HalfBins);
    let (engine, solution) = solve(&device, &scene, &half);
    assert!(!engine.plan().half_bins() && engine.plan().clusters().is_some());
    assert!(solution.irradiance == solve(&device, &scene, &settings).1.irradiance, "the results differ");
    finish(&device);
}

/// Where states live on the host, clusters are those of the groups that fit its windows, and results are those of such groups on the device,
/// byte for byte, by kernels, too.
#[test]
fn states_on_the_host_have_clusters_too() {
    let device = device();
    let scenes =
        ["scenes/cornell_boxes.toml", "scenes/glossy_floor.toml"].map(|name| (name, load(name), 3 << 20));
    for (name, scene, budget) in scenes.into_iter().chain([("balls", balls(4, 3, true), 10 << 20)]) {
        let settings = hierarchical(&scene, 0.02);
        let exact = solve(&device, &scene, &scene.settings.transport(Transport::Exact)).1.irradiance;
        let of_gpus = device.clone().with_kernels_for(DeviceKind::Discrete);
        // Two scenes have all that kernels for GPUs do otherwise, which take long here.
        let of_gpus = (name != "scenes/cornell_boxes.toml").then_some(of_gpus);
        for device in [device.clone()].into_iter().chain(of_gpus) {
            let options = PlanOptions::of(&device).keep_near_field(false);
            let (engine, hosted) = solve_within(&device, &scene, &settings, &options.memory_budget(budget));
            let plan = engine.plan();
            assert_eq!(plan.transport(), PlannedTransport::Hierarchical { error: 0.02 });
            let Residency::Host { receivers, .. } = plan.residency() else { panic!("not on the host") };
            assert!(plan.sweeps().len() > 1);
            let volumes = plan.clusters().is_some_and(|clusters| clusters.volumes().is_some());
            assert_eq!(volumes, name == "balls");
            let in_pages = options.page(u64::from(receivers) * plan.tile_bytes());
            let (engine, resident) = solve_within(&device, &scene, &settings, &in_pages);
            assert_eq!(engine.plan().residency(), Residency::Device);
            assert!(hosted.irradiance == resident.irradiance, "{name}: the results differ");
            let off = relative_l2(&hosted.irradiance, &exact, &areas(&scene));
            println!("{name}: {off:.5}");
            assert!(off <= 0.02 && off > 0.0, "{name}: {off}");
        }
    }
    finish(&device);
}
