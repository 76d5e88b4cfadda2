//! Scenes with and without warnings; and refinement, which removes their causes.

mod support;

use antirad::path_tracer::PathTracer;
use antirad::plan::{Plan, PlanOptions};
use antirad::resolve::Cut;
use antirad::scene::{BinLayout, LoadOptions, Material, Scene, SceneBuilder, Shape, VisibilityChoice};
use antirad::warnings::{Kind, MATTERS, RefineError, RefineOptions, Warnings, refine};
use glam::{DAffine3, DQuat, DVec3};
use std::time::Instant;
use support::kit::Plates;
use support::{areas, backend, finish, load, solve};

fn warnings(scene: &Scene) -> Warnings {
    Warnings::of(scene, &plan(scene))
}

fn plan(scene: &Scene) -> Plan {
    // Warnings are of antiradiance, also where it is not taken by itself.
    let settings = scene.settings.visibility(VisibilityChoice::Implicit);
    Plan::new(scene, &PlanOptions::default(), &settings).expect("a plan")
}

fn kinds(warnings: &Warnings) -> Vec<Kind> {
    warnings.list.iter().map(|w| w.kind).collect()
}

fn grey() -> Material {
    Material { albedo: [0.5; 3], ..Material::named("grey") }
}

fn lamp() -> Material {
    Material { emission: [10.0; 3], ..Material::named("lamp") }
}

fn scaled(x: f64, y: f64, z: f64, to: DVec3) -> DAffine3 {
    DAffine3::from_scale_rotation_translation(DVec3::new(x, y, z), DQuat::IDENTITY, to)
}

/// A unit room with objects in it.
fn room_with(add: impl FnOnce(&mut SceneBuilder)) -> Scene {
    let mut builder = SceneBuilder::new();
    builder.shape("room", Shape::Room { cells: 8 }, &grey(), DAffine3::IDENTITY);
    add(&mut builder);
    builder.finish("room").map(support::implicit).expect("a scene")
}

#[test]
fn sound_scenes_have_no_warnings() {
    for name in ["closed_box", "integrating_sphere"] {
        let found = warnings(&load(&format!("scenes/{name}.toml")));
        assert!(found.list.is_empty(), "{name}: {found}");
    }
    // A box high enough in the room, fine enough for its bins.
    let mut scene = room_with(|builder| {
        builder.shape("box", Shape::Box { cells: 8 }, &grey(), scaled(0.2, 0.2, 0.2, DVec3::splat(0.4)));
    });
    scene.settings.bins = BinLayout::EqualAngle { theta: 4, phi: 6 };
    let found = warnings(&scene);
    assert!(found.list.is_empty(), "{found}");
}

/// The gain of a pair, computed by hand.
#[test]
fn gains_are_those_of_the_formula() {
    // One blocker of area 1/2 over one receiver, centroid above centroid, 10 apart.
    let mut builder = SceneBuilder::new();
    let up = vec![DVec3::ZERO, DVec3::X, DVec3::Y];
    builder.mesh("floor", up.clone(), vec![[0, 1, 2]], &grey(), DAffine3::IDENTITY);
    let over = DAffine3::from_translation(10.0 * DVec3::Z);
    builder.mesh("blocker", up.clone(), vec![[0, 1, 2]], &grey(), over);
    let mut scene = builder.finish("two").map(support::implicit).expect("a scene");
    let gain = |scene: &Scene| {
        let found = warnings(scene);
        found.get(Kind::CoarseBlockers).map(|w| (w.worst[0].triangle, w.worst[0].other, w.worst[0].value))
    };
    // Along the pole four bins of 64 x 64 meet, all of the same solid angle.
    scene.settings.bins = BinLayout::Concentric { n: 64 };
    let bin = std::f64::consts::TAU / 4096.0;
    let (blocker, receiver, found) = gain(&scene).expect("a coarse blocker");
    let by_hand = 0.5 / ((100.0 + 0.5 / std::f64::consts::PI) * bin);
    assert_eq!((blocker, receiver), (1, Some(0)));
    assert!((found / by_hand - 1.0).abs() <= 2e-3, "{found} instead of {by_hand}");
    // With coarser bins there is no warning.
    scene.settings.bins = BinLayout::Concentric { n: 12 };
    assert_eq!(gain(&scene), None);
}

#[test]
fn stacked_layers_are_named() {
    let two =
        warnings(&Plates { count: 2, ..Plates::default() }.scene().map(support::implicit).expect("a scene"));
    let five =
        warnings(&Plates { count: 5, ..Plates::default() }.scene().map(support::implicit).expect("a scene"));
    let [two, five] = [&two, &five].map(|w| w.get(Kind::StackedLayers).expect("a warning").clone());
    assert!(five.effect.share > 0.05 && five.worst[0].value > 100.0 * two.worst[0].value, "{two}\n{five}");
    for k in 1..=5 {
        assert!(five.message.contains(&format!("\"plate {k}\"")), "{}", five.message);
    }
    assert!(!two.message.contains("plate 3"), "{}", two.message);
    // A single layer is not a stack.
    let one =
        warnings(&Plates { count: 1, ..Plates::default() }.scene().map(support::implicit).expect("a scene"));
    assert_eq!(kinds(&one), [Kind::CoarseBlockers], "{one}");
}

#[test]
fn gaps_below_the_size_of_triangles() {
    let found = |height: f64, finer: u32| {
        let scene = room_with(|builder| {
            let lamp_below_the_ceiling = scaled(0.4, -1.0, 0.4, DVec3::new(0.3, 1.0 - height, 0.3));
            builder.shape("lamp", Shape::Quad { cells: 2 * finer }, &lamp(), lamp_below_the_ceiling);
        });
        let found = warnings(&scene);
        found.get(Kind::NarrowGaps).map(|w| (w.count, w.worst[0].value, w.worst[0].place.clone()))
    };
    let (count, share, place) = found(0.01, 1).expect("a gap");
    assert!(count >= 8 && place.contains("\"lamp\""), "{count} {place}");
    // The larger triangles are the lamp's: right ones with legs of .2, s = Σl²/(4√3).
    let size = (0.16 / (4.0 * 3f64.sqrt())).sqrt();
    assert!((share - 0.01 / size).abs() <= 1e-9, "{share}");
    assert_eq!(found(0.2, 1), None);
    // Surfaces that touch form no gap: a block on the floor, the corners of the room.
    let block = room_with(|builder| {
        builder.shape(
            "block",
            Shape::Box { cells: 2 },
            &grey(),
            scaled(0.25, 0.25, 0.25, DVec3::new(0.25, 0.0, 0.25)),
        );
    });
    assert!(warnings(&block).get(Kind::NarrowGaps).is_none());
}

#[test]
fn open_and_turned_blockers() {
    let with = |edit: &dyn Fn(&mut Vec<[u32; 3]>)| {
        room_with(|builder| {
            let (vertices, mut faces) = Shape::Box { cells: 3 }.mesh();
            edit(&mut faces);
            builder.mesh("box", vertices, faces, &grey(), scaled(0.3, 0.3, 0.3, DVec3::splat(0.35)));
        })
    };
    let bad = |scene: &Scene| {
        let found = warnings(scene);
        let of = |kind| {
            found.get(kind).map_or(Vec::new(), |w| {
                let mut all = w.triangles.clone();
                all.sort_unstable();
                all
            })
        };
        (of(Kind::OpenBlockers), of(Kind::InconsistentBlockers))
    };
    let first = 12 * 64;
    assert_eq!(bad(&with(&|_| {})), (vec![], vec![]));
    // Without one triangle, its three neighbours have an open edge.
    let open = bad(&with(&|faces| {
        faces.remove(8);
    }));
    assert_eq!((open.0.len(), open.1.len()), (3, 0), "{open:?}");
    // One turned over: it and its neighbours disagree.
    let turned = bad(&with(&|faces| faces[8].swap(0, 1)));
    assert_eq!((turned.0.len(), turned.1.len()), (0, 4), "{turned:?}");
    assert!(turned.1.contains(&(first + 8)));
    // Without its bottom, the box is closed by the floor, though vertices differ. In the air it is open.
    let standing = |height: f64| {
        room_with(|builder| {
            let (vertices, faces) = Shape::Box { cells: 3 }.mesh();
            let sides =
                faces.into_iter().filter(|f| !f.iter().all(|&v| vertices[v as usize].y == 0.0)).collect();
            let place = scaled(0.3, 0.3, 0.3, DVec3::new(0.35, height, 0.35));
            builder.mesh("box", vertices, sides, &grey(), place);
        })
    };
    assert_eq!(bad(&standing(0.0)), (vec![], vec![]));
    assert_eq!(bad(&standing(0.1)).0.len(), 12);
    // Two meshes of the same box, cut differently where they meet: closed, though no edge has two triangles.
    let halves = room_with(|builder| {
        for (cells, side) in [(2, true), (3, false)] {
            let (vertices, faces) = Shape::Box { cells }.mesh();
            let top = |f: &[u32; 3]| f.iter().all(|&v| vertices[v as usize].y == 1.0);
            let half = faces.iter().copied().filter(|f| top(f) == side).collect();
            builder.mesh("half", vertices.clone(), half, &grey(), scaled(0.3, 0.3, 0.3, DVec3::splat(0.35)));
        }
    });
    assert_eq!(bad(&halves), (vec![], vec![]));
}

/// Names have the file and the line of the face, for the children of a subdivided face too.
#[test]
fn triangles_are_named_by_file_and_line() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).expect("a file");
    write("m.mtl", "newmtl white\nKd .5 .5 .5\nKe 1 1 1\n");
    write("m.obj", "mtllib m.mtl\nusemtl white\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2 3\n");
    write("s.toml", "[[mesh]]\npath = \"m.obj\"\nsubdivide = 1\n");
    let scene = Scene::load(&folder.path().join("s.toml"), &LoadOptions::default()).expect("a scene");
    assert_eq!(scene.origins[0].lines, [vec![7; 8], vec![8; 4]].concat());
    assert!(scene.place_of(8).ends_with("m.obj:8 (triangle 8 of mesh \"m\")"), "{}", scene.place_of(8));
}

/// Refinement leaves fewer warnings, the same surfaces and materials, and no cracks.
#[test]
fn refinement_removes_the_causes() {
    for (name, mut scene) in [
        ("cornell_boxes", load("scenes/cornell_boxes.toml")),
        (
            "plates",
            Plates { cells: 6, gap: 0.5, ..Plates::default() }
                .scene()
                .map(support::implicit)
                .expect("a scene"),
        ),
    ] {
        let old = scene.clone();
        let refined =
            refine(&mut scene, &PlanOptions::default(), &RefineOptions::default()).expect("refined");
        let (before, after) = (&refined.before, Warnings::with_shadows(&scene, &plan(&scene)));
        println!(
            "{name}: {} to {} triangles, {} to {} of them under a warning",
            old.triangles.len(),
            scene.triangles.len(),
            before.count(),
            after.count()
        );
        assert_eq!(after, refined.after);
        assert!(before.count() > 10 && after.count() < before.count(), "{name}: {before}\n{after}");
        assert!(!refined.full && scene.triangles.len() > old.triangles.len());
        // No new holes where fine meets coarse.
        assert!(after.get(Kind::OpenBlockers).is_none(), "{name}: {after}");
        assert_eq!(refined.parents.len(), scene.triangles.len());
        let mut sum = vec![0.0; old.triangles.len()];
        for (t, (&parent, area)) in refined.parents.iter().zip(areas(&scene)).enumerate() {
            let parent = parent as usize;
            sum[parent] += area;
            assert_eq!(scene.material(t), old.material(parent));
        }
        for (sum, area) in sum.iter().zip(areas(&old)) {
            assert!((sum - area).abs() <= 1e-12 * area, "{name}: {sum} of {area}");
        }
        scene.check(true).expect("a good scene");
    }
}

/// The shadow of a plate that hangs in a room, on a mesh that cannot hold it: the irradiance of all walls against path tracing.
#[test]
fn refinement_mends_shadows_that_a_coarse_mesh_cannot_hold() {
    let scene = load("scenes/coarse_cornell.toml");
    let backend = backend();
    let truth: Vec<DVec3> = PathTracer::new(&scene).irradiance(6000).iter().map(|e| e.mean).collect();
    let given = areas(&scene);
    let error = |finer: &Scene, parents: &[u32]| {
        let cut = Cut::between(&scene, finer, parents);
        let mut scene = finer.clone();
        scene.settings = scene.settings.visibility(VisibilityChoice::Implicit);
        let (engine, solution) = solve(&backend, &scene, &scene.settings);
        let found = cut.on_given(&solution.irradiance);
        drop((engine, solution));
        let square = |of: &dyn Fn(usize) -> f64| -> f64 { (0..given.len()).map(|t| given[t] * of(t)).sum() };
        let difference = square(&|t| (DVec3::from(found[t]) - truth[t]).length_squared());
        (difference / square(&|t| truth[t].length_squared())).sqrt()
    };
    let same: Vec<u32> = (0..scene.triangles.len() as u32).collect();
    let coarse = error(&scene, &same);
    let found = Warnings::with_shadows(&scene, &plan(&scene));
    let floor = found.get(Kind::CoarseShadows).expect("a warning");
    assert!(
        floor.effect.share > 0.0 && floor.triangles.contains(&0) && floor.triangles.contains(&1),
        "{found}"
    );
    let mut fine = scene.clone();
    let options = RefineOptions::default().max_triangles(800);
    let refined = refine(&mut fine, &PlanOptions::default(), &options).expect("refined");
    let mended = error(&fine, &refined.parents);
    println!("{} triangles: {coarse:.4}; {}: {mended:.4}", scene.triangles.len(), fine.triangles.len());
    assert!(coarse > 0.03 && mended < 0.5 * coarse, "{coarse} {mended}");
    assert_eq!(fine.meshes.len(), scene.meshes.len());
    finish(&backend);
}

#[test]
fn refining_keeps_to_its_bounds() {
    let scene = || {
        let scene = Plates { count: 4, cells: 6, ..Plates::default() }
            .scene()
            .map(support::implicit)
            .expect("a scene");
        Scene { settings: scene.settings.visibility(VisibilityChoice::Implicit), ..scene }
    };
    let count = scene().triangles.len();
    for most in [count + 1, count + 50, 4 * count] {
        let mut scene = scene();
        let options = RefineOptions::default().max_triangles(most);
        let refined = refine(&mut scene, &PlanOptions::default(), &options).expect("refined");
        assert!(refined.full && scene.triangles.len() <= most && scene.triangles.len() + 3 > most);
    }
    let none = RefineOptions::default().max_triangles(count);
    let refused = refine(&mut scene(), &PlanOptions::default(), &none).expect_err("no room");
    assert!(matches!(refused, RefineError::Full { .. }) && refused.to_string().contains("--max-triangles"));
}

/// Time grows about linearly with the number of triangles, not with its square: here by a factor of 16. Taken from the fastest
/// of several runs, since the machine may be shared.
#[test]
fn large_scenes_take_seconds() {
    let seconds = |triangles: u32, cells: u32| {
        let mut builder = SceneBuilder::new();
        builder.shape("statue", Shape::Statue { triangles }, &grey(), DAffine3::IDENTITY);
        let floor = scaled(4.0, 1.0, 4.0, DVec3::new(-2.0, 0.0, -2.0));
        builder.shape("floor", Shape::Quad { cells }, &grey(), floor);
        let scene = builder.finish("statue").map(support::implicit).expect("a scene");
        let plan = plan(&scene);
        let run = |_| {
            let begin = Instant::now();
            let found = Warnings::of(&scene, &plan);
            (begin.elapsed().as_secs_f64(), found.count())
        };
        let (seconds, warned) = (0..3).map(run).min_by(|a, b| a.0.total_cmp(&b.0)).expect("runs");
        println!("{} triangles: {seconds:.3} s, {warned} under a warning", scene.triangles.len());
        seconds
    };
    let ratio = seconds(12_500, 20) / seconds(782, 5);
    assert!(ratio <= 80.0, "{ratio:.1} times as long");
}

/// Warnings after a solve need numbers only, no device and no `Solution`.
#[test]
fn results_are_judged_without_a_device() {
    let scene = room_with(|_| ());
    let plan = plan(&scene);
    let mut irradiance = vec![[1.0, 2.0, 3.0]; scene.triangles.len()];
    let after = |irradiance: &[[f64; 3]], radius| Warnings::after(&scene, &plan, irradiance, radius);
    assert_eq!(after(&irradiance, Some(0.9)).list, []);
    assert_eq!(after(&irradiance, None).list, []);
    irradiance[3] = [1.0, -1e-3, 1.0];
    let little = after(&irradiance, Some(1.1));
    assert_eq!(kinds(&little), [Kind::Unphysical, Kind::NegativeIrradiance]);
    let negative = little.get(Kind::NegativeIrradiance).expect("a warning");
    assert_eq!((negative.triangles.as_slice(), negative.effect.exceeds(MATTERS)), (&[3][..], false));
    assert_eq!(negative.worst[0].value, -1e-3);
    irradiance[5] = [-500.0; 3];
    let much = after(&irradiance, None);
    let negative = much.get(Kind::NegativeIrradiance).expect("a warning");
    assert_eq!((negative.triangles.as_slice(), negative.effect.exceeds(MATTERS)), (&[5, 3][..], true));
}
