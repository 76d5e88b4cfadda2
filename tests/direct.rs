//! Direct light of lamps: against closed forms, path-traced data of independent origin, and rays in hard cases.

mod support;

use antirad::backend::Backend;
use antirad::path_tracer::PathTracer;
use antirad::plan::{GradientRequest, Plan, PlanError, PlanOptions};
use antirad::ranks::Ranks;
use antirad::scene::{Lamps, Material, Scene, SceneBuilder, Shape, Sky, Sun, Triangle};
use antirad::{Engine, SolveParams};
use antirad_core::direct::{DirectLight, Lamp, Visibility, lamps};
use antirad_core::model::Facet;
use glam::{DAffine3, DVec3};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;
use support::kit::Shadow;
use support::{areas, load, read_npy, relative_l2};

fn computed(scene: &Scene, facets: &[Facet], lamps: Vec<Lamp>, visibility: Visibility) -> DirectLight {
    DirectLight::new(&Ranks::default(), facets, lamps, visibility, Arc::default(), |i| scene.material(i))
        .expect("one rank")
}

/// Irradiance straight from lamps, W/m², and the number of lamps.
fn direct(scene: &Scene) -> (Vec<[f64; 3]>, usize) {
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let lamps = lamps(scene, &facets, 1e-7);
    let count = lamps.len();
    let light = computed(scene, &facets, lamps, Visibility::Exact);
    (light.irradiance(|i| scene.material(i)).into_iter().map(|h| h.to_array()).collect(), count)
}

#[test]
fn the_cornell_room_is_lit_as_by_another_path_tracer() {
    let scene = load("scenes/cornell_boxes.toml");
    let (found, count) = direct(&scene);
    assert_eq!(count, 1, "a lamp of 24 triangles");
    let truth = read_npy("tests/data/cornell_boxes.direct_irradiance.npy");
    let error = relative_l2(&found, &truth, &areas(&scene));
    println!("cornell_boxes, direct: {:.3} %", 100.0 * error);
    assert!(error <= 1.5e-3, "{error:e}");
}

/// Relative to the light that the blocker takes away.
#[test]
fn shadows_are_those_of_the_closed_form() {
    for lamp in [0.4, 0.1] {
        for height in [0.25, 1.0, 1.5] {
            let shadow = Shadow { lamp, height };
            let scene = shadow.scene().expect("a scene");
            let (found, _) = direct(&scene);
            let truth = shadow.irradiance(&scene);
            let areas = areas(&scene);
            let floor = scene.meshes.iter().find(|m| m.name == "floor").expect("a floor").range.clone();
            let (mut error, mut blocked) = (0.0, 0.0);
            for i in floor.map(|i| i as usize) {
                error += areas[i] * (found[i][0] - truth[i][0]).powi(2);
                blocked += areas[i] * (truth[i][1] - truth[i][0]).powi(2);
            }
            let error = (error / blocked).sqrt();
            println!("lamp {lamp}, height {height}: {:.3} %", 100.0 * error);
            assert!(error <= 0.01, "lamp {lamp}, height {height}: {error:e}");
        }
    }
}

fn at(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

fn sized(size: f64) -> DAffine3 {
    DAffine3::from_scale(DVec3::splat(size))
}

/// Its front looks down.
const DOWN: DAffine3 = DAffine3::from_cols(DVec3::X, DVec3::NEG_Y, DVec3::Z, DVec3::ZERO);

fn emitter() -> Material {
    Material { emission: [10.0; 3], ..Material::named("lamp") }
}

/// A floor and what `add` puts over it.
fn over_a_floor(add: impl FnOnce(&mut SceneBuilder, &Material)) -> Scene {
    let black = Material::named("black");
    let mut builder = SceneBuilder::new();
    builder.shape("floor", Shape::Quad { cells: 6 }, &black, sized(2.0));
    add(&mut builder, &black);
    builder.finish("hard").expect("a scene")
}

/// Every triangle, against 4096 rays each: within five standard errors and 0.3 % of the brightest triangle.
fn agrees(name: &str, scene: &Scene) {
    let (found, _) = direct(scene);
    let truth = PathTracer::new(scene).irradiance(4096);
    let brightest = truth.iter().map(|e| e.mean.x).fold(0.0, f64::max);
    for (i, (found, truth)) in found.iter().zip(&truth).enumerate() {
        let difference = (found[0] - truth.mean.x).abs();
        let allowed = 5.0 * truth.error.x + 3e-3 * brightest;
        assert!(difference <= allowed, "{name}, triangle {i}: {} and {:?}", found[0], truth);
    }
    println!("{name}: {} triangles, up to {brightest:.3} W/m²", scene.triangles.len());
}

/// Where penumbras are far narrower than triangles: relative L2 norm, without the noise of the truth.
fn agrees_on_average(name: &str, scene: &Scene) {
    let (found, _) = direct(scene);
    let truth = PathTracer::new(scene).irradiance(4096);
    let (mut error, mut all) = (0.0, 0.0);
    for ((found, truth), area) in found.iter().zip(&truth).zip(areas(scene)) {
        error += area * ((DVec3::from(*found) - truth.mean).length_squared() - truth.error.length_squared());
        all += area * truth.mean.length_squared();
    }
    let error = (error.max(0.0) / all).sqrt();
    println!("{name}: {:.2} %", 100.0 * error);
    assert!(error <= 0.02, "{name}: {error:e}");
}

#[test]
fn hard_lamps_and_blockers() {
    let cases: Vec<(&str, Scene)> = vec![
        (
            "a lamp in its ceiling",
            over_a_floor(|b, black| {
                b.shape("ceiling", Shape::Quad { cells: 3 }, black, at(0.0, 1.0, 0.0) * sized(2.0) * DOWN)
                    .shape(
                        "lamp",
                        Shape::Quad { cells: 1 },
                        &emitter(),
                        at(0.1, 0.999, 0.0) * sized(0.3) * DOWN,
                    );
            }),
        ),
        (
            "a lamp that touches a wall",
            over_a_floor(|b, black| {
                let wall =
                    at(1.0, 1.0, 0.0) * DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2) * sized(2.0);
                b.shape("wall", Shape::Quad { cells: 4 }, black, wall).shape(
                    "lamp",
                    Shape::Quad { cells: 1 },
                    &emitter(),
                    at(0.75, 1.2, 0.0) * sized(0.5) * DOWN,
                );
            }),
        ),
        (
            "a lamp that looks away",
            over_a_floor(|b, _| {
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.0, 1.0, 0.0) * sized(0.5));
            }),
        ),
        (
            "a blocker through the lamp",
            over_a_floor(|b, black| {
                let upright = DAffine3::from_rotation_z(1.4);
                b.shape("lamp", Shape::Quad { cells: 2 }, &emitter(), at(0.0, 1.0, 0.0) * sized(0.6) * DOWN)
                    .shape(
                        "blade",
                        Shape::Quad { cells: 1 },
                        black,
                        at(0.05, 0.9, 0.0) * upright * sized(0.5),
                    );
            }),
        ),
        (
            "a blocker on its receiver",
            over_a_floor(|b, black| {
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.3, 1.0, 0.2) * sized(0.2) * DOWN)
                    .shape("box", Shape::Box { cells: 1 }, black, at(0.0, 0.25, 0.0) * sized(0.5));
            }),
        ),
        (
            "boxes through each other",
            over_a_floor(|b, black| {
                let turned = DAffine3::from_rotation_y(0.7) * DAffine3::from_rotation_x(0.3);
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.3, 1.5, 0.2) * sized(0.3) * DOWN)
                    .shape("one", Shape::Box { cells: 2 }, black, at(0.0, 0.4, 0.0) * turned * sized(0.5))
                    .shape("two", Shape::Box { cells: 2 }, black, at(0.2, 0.5, 0.1) * sized(0.5));
            }),
        ),
        (
            "a lamp through a gap",
            over_a_floor(|b, black| {
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.0, 1.5, 0.0) * sized(0.4) * DOWN)
                    .shape("left", Shape::Quad { cells: 2 }, black, at(-0.52, 0.7, 0.0) * sized(1.0))
                    .shape("right", Shape::Quad { cells: 2 }, black, at(0.52, 0.7, 0.0) * sized(1.0));
            }),
        ),
        (
            "sheets seen from behind",
            over_a_floor(|b, black| {
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.0, 1.0, 0.0) * sized(0.4) * DOWN)
                    .shape("sheet", Shape::Quad { cells: 1 }, black, at(0.0, 0.5, 0.0) * sized(0.4) * DOWN);
            }),
        ),
        (
            "nothing emits",
            over_a_floor(|b, black| {
                b.shape("box", Shape::Box { cells: 1 }, black, at(0.0, 0.25, 0.0) * sized(0.5));
            }),
        ),
        (
            "a lamp upright on the floor",
            over_a_floor(|b, _| {
                let upright = at(0.0, 0.25, 0.0) * DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2);
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), upright * sized(0.5));
            }),
        ),
    ];
    for (name, scene) in cases {
        agrees(name, &scene);
    }
}

/// Sheets in the plane of a lamp block nothing of it: another emitter back to back with it, and a ceiling that holds it.
#[test]
fn what_lies_in_the_plane_of_a_lamp_does_not_block_it() {
    let lit = |more: &dyn Fn(&mut SceneBuilder, &Material)| {
        let scene = over_a_floor(|b, black| {
            b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.1, 1.0, 0.0) * sized(0.5) * DOWN);
            more(b, black);
        });
        direct(&scene).0[..72].to_vec()
    };
    let alone = lit(&|_, _| {});
    assert!(alone.iter().all(|h| h[0] > 0.01));
    let with_back = lit(&|b, _| {
        b.shape("other side", Shape::Quad { cells: 1 }, &emitter(), at(0.1, 1.0, 0.0) * sized(0.5));
    });
    let in_ceiling = lit(&|b, black| {
        b.shape("ceiling", Shape::Quad { cells: 3 }, black, at(0.0, 1.0, 0.0) * sized(2.0) * DOWN);
    });
    // Cells are cut by the light that is usual in a scene, which a ceiling changes.
    for (found, expected) in with_back.iter().chain(&in_ceiling).zip(alone.iter().cycle()) {
        assert!((found[0] / expected[0] - 1.0).abs() <= 1e-6, "{found:?} {expected:?}");
    }
}

/// Of four plates under a lamp nothing comes through, whatever the gap.
#[test]
fn stacked_plates_let_nothing_through() {
    for gap in [0.24, 0.05] {
        for count in [1, 2, 4, 8] {
            let scene = over_a_floor(|b, black| {
                b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.0, 3.0, 0.0) * sized(0.5) * DOWN);
                for plate in 0..count {
                    let height = 0.3 + gap * f64::from(plate);
                    b.shape("plate", Shape::Quad { cells: 3 }, black, at(0.0, height, 0.0) * sized(3.0));
                }
            });
            let (found, _) = direct(&scene);
            let floor = scene.meshes[0].range.clone();
            let most = floor.map(|i| found[i as usize][0]).fold(0.0, f64::max);
            let open = found.iter().map(|h| h[0]).fold(0.0, f64::max);
            println!("{count} plates, gap {gap}: {most:e} of {open}");
            assert!(open > 0.1 && most <= 1e-9 * open, "{count} plates, gap {gap}: {most:e} of {open}");
        }
    }
}

/// Lamps of needles merge like any others; a disc is one lamp, a bent one is not.
#[test]
fn coplanar_emitters_are_one_lamp() {
    let fan = |bend: f64| {
        let mut vertices = vec![DVec3::ZERO];
        let mut triangles = Vec::new();
        for k in 0..32u32 {
            let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 32.0).sin_cos();
            vertices.push(DVec3::new(cos, bend * f64::from(k % 2), sin));
            triangles.push(Triangle { vertices: [0, 1 + (k + 1) % 32, 1 + k], material: 0 });
        }
        Scene::new("fan", vertices, triangles, vec![emitter()]).expect("a scene")
    };
    assert_eq!(direct(&fan(0.0)).1, 1);
    assert_eq!(direct(&fan(0.1)).1, 32);
}

/// Rays are distributed over hundreds of emitters, and the plan says so; where nothing casts shadows, these take the way of antiradiance.
#[test]
fn many_emitters_share_rays() {
    let lit_by = |shape: Shape| {
        over_a_floor(|b, _| {
            b.shape("globe", shape, &emitter(), at(0.0, 1.0, 0.0) * sized(0.2));
        })
    };
    let plan =
        |scene: &Scene, settings| Plan::new(scene, &PlanOptions::default(), &settings).expect("a plan");
    let statue = lit_by(Shape::Statue { triangles: 1500 });
    let auto = plan(&statue, statue.settings);
    assert_eq!(auto.visibility(), Visibility::Distributed);
    assert!(auto.lamps().len() > 1024);
    let report = auto.report().lamps;
    assert_eq!((report.exact, report.sampled), (0, auto.lamps().len()));
    assert!(report.why.contains("distributed"), "{}", report.why);
    let ball = Shape::Icosphere { level: 3, inward: true };
    let mut builder = SceneBuilder::new();
    let closed = builder.shape("ball", ball, &emitter(), DAffine3::IDENTITY).finish("ball").expect("a scene");
    let auto = plan(&closed, closed.settings);
    assert!(auto.lamps().is_empty());
    assert!(auto.report().lamps.why.contains("by antiradiance"), "{}", auto.report().lamps.why);
    // A globe is one lamp, its silhouette.
    let globe = lit_by(Shape::Icosphere { level: 3, inward: false });
    assert_eq!(plan(&globe, globe.settings).lamps().len(), 1);
}

/// A globe that is seen whole lights a point with E = π L (r/d)² cos θ.
#[test]
fn a_globe_lights_by_the_square_of_its_distance() {
    let scene = over_a_floor(|b, _| {
        let globe = Shape::Icosphere { level: 4, inward: false };
        b.shape("globe", globe, &emitter(), at(0.1, 1.0, 0.2) * sized(0.2));
    });
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let lamps = lamps(&scene, &facets, 1e-7);
    let area: f64 = lamps[0].triangles().iter().map(|&i| facets[i as usize].area).sum();
    let light = DirectLight::of_points(&facets, lamps, Visibility::Exact, |i| scene.material(i));
    // The silhouette of a convex solid has a quarter of its area, on average over all directions.
    let squared = area / (4.0 * PI);
    for i in scene.meshes[0].range.clone() {
        let point = facets[i as usize].centroid;
        let way = DVec3::new(0.1, 1.0, 0.2) - point;
        let truth = PI * squared / way.length_squared() * way.y / way.length();
        let found = light.at_points(&facets, i as usize, &[point])[0][0].1.dot(facets[i as usize].normal);
        assert!((found / truth - 1.0).abs() <= 3e-3, "{found}, not {truth}");
    }
}

/// A globe that stands on a floor, is sunk into it, or hangs close over a plate.
#[test]
fn globes_that_touch_others() {
    for (name, height, plate) in [("stands", 0.2, None), ("sunk", 0.1, None), ("close", 0.6, Some(0.38))] {
        let scene = over_a_floor(|b, black| {
            let globe = Shape::Icosphere { level: 2, inward: false };
            b.shape("globe", globe, &emitter(), at(0.1, height, 0.2) * sized(0.2));
            if let Some(at_height) = plate {
                let wide = DAffine3::from_scale(DVec3::new(0.9, 1.0, 0.5));
                b.shape("plate", Shape::Quad { cells: 2 }, black, at(-0.3, at_height, -0.05) * wide);
            }
        });
        agrees(name, &scene);
    }
}

/// Nine balls over a floor, each of 80 triangles, under a lamp and a sky.
fn balls() -> Scene {
    let mut scene = over_a_floor(|b, m| {
        b.shape("lamp", Shape::Quad { cells: 1 }, &emitter(), at(0.0, 3.0, 0.0) * sized(0.6) * DOWN);
        for k in 0..9 {
            let place =
                at(0.3 * f64::from(k % 3) - 0.3, 0.12 + 0.04 * f64::from(k), 0.3 * f64::from(k / 3) - 0.3);
            b.shape(
                &format!("ball {k}"),
                Shape::Icosphere { level: 1, inward: false },
                m,
                place * sized(0.13),
            );
        }
    });
    scene.add_sky(&Sky::uniform([0.5; 3]));
    scene
}

/// Rays tell what polygons do, but for noise of the size that is stated; without anything in the way there is none.
#[test]
fn sampled_visibility_is_the_exact_one_but_for_its_noise() {
    let scene = balls();
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let lamps = lamps(&scene, &facets, 1e-7);
    assert_eq!(lamps.len(), 7);
    let [exact, sampled] = [Visibility::Exact, Visibility::Sampled]
        .map(|visibility| computed(&scene, &facets, lamps.clone(), visibility));
    let irradiance = |light: &DirectLight| -> Vec<[f64; 3]> {
        light.irradiance(|i| scene.material(i)).into_iter().map(|h| h.to_array()).collect()
    };
    let (truth, found) = (irradiance(&exact), irradiance(&sampled));
    let lit = |i: usize| scene.material(i).emission == [0.0; 3];
    let areas: Vec<f64> =
        facets.iter().enumerate().map(|(i, facet)| if lit(i) { facet.area } else { 0.0 }).collect();
    let error = relative_l2(&found, &truth, &areas);
    let [none, stated] = [&exact, &sampled].map(|light| light.standard_error(&facets, |i| scene.material(i)));
    println!("by rays: {:.2} %, stated {:.2} %", 100.0 * error, 100.0 * stated);
    assert!(none == 0.0 && stated > 0.0);
    assert!((0.4..2.5).contains(&(error / stated)), "{error:e}, {stated:e} stated");
    assert!(error <= 0.03, "{error:e}");
    // No bias: light of many triangles is that of the exact.
    let sum = |of: &[[f64; 3]]| of.iter().zip(&areas).map(|(h, a)| h[0] * a).sum::<f64>();
    assert!((sum(&found) / sum(&truth) - 1.0).abs() <= 2e-3, "{} {}", sum(&found), sum(&truth));
    // The highest ball sees all of the lamp from its upper side.
    let top = (0..facets.len()).max_by(|&a, &b| {
        let height = |i: usize| if scene.material(i).emission[0] > 0.0 { -1.0 } else { facets[i].centroid.y };
        height(a).total_cmp(&height(b))
    });
    let top = top.expect("a triangle");
    let whole = DirectLight::without_shadows(&facets, lamps);
    let at_top = whole.at_points(&facets, top, &[facets[top].centroid]);
    let rays = sampled.at_points(&facets, top, &[facets[top].centroid]);
    // The lamp is the first, before the sky.
    let [a, b] = [at_top[0][0].1, rays[0][0].1];
    assert!(a.length() > 0.0 && (a - b).length() <= 1e-9, "{a} {b}");
}

/// 144 lamps over a floor with a box: rays tell what exact visibility does, but for noise of the size that is stated. Light is linear in the
/// radiance of each lamp, and the same from run to run.
#[test]
fn rays_to_many_lamps_bring_their_light() {
    let scene = over_a_floor(|b, black| {
        b.shape("box", Shape::Box { cells: 1 }, black, at(-0.2, 0.3, 0.1) * sized(0.4));
        for k in 0..144 {
            let lamp = Material { emission: [5.0 + f64::from(k % 7); 3], ..Material::named("lamp") };
            let place = at(f64::from(k % 12) / 6.0 - 0.95, 1.0, f64::from(k / 12) / 6.0 - 0.95);
            b.shape("lamp", Shape::Quad { cells: 1 }, &lamp, place * sized(0.04) * DOWN);
        }
    });
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let lamps = lamps(&scene, &facets, 1e-7);
    assert_eq!(lamps.len(), 144);
    let [exact, rays, again] = [Visibility::Exact, Visibility::Distributed, Visibility::Distributed]
        .map(|visibility| computed(&scene, &facets, lamps.clone(), visibility));
    let irradiance = |light: &DirectLight| -> Vec<[f64; 3]> {
        light.irradiance(|i| scene.material(i)).into_iter().map(|h| h.to_array()).collect()
    };
    let (truth, found) = (irradiance(&exact), irradiance(&rays));
    assert_eq!(found, irradiance(&again));
    let error = relative_l2(&found, &truth, &areas(&scene));
    let stated = rays.standard_error(&facets, |i| scene.material(i));
    println!("144 lamps: {:.2} %, stated {:.2} %", 100.0 * error, 100.0 * stated);
    assert!(error <= 0.03 && (0.2..2.0).contains(&(error / stated)), "{error:e}, {stated:e} stated");
    let sum = |of: &[[f64; 3]]| of.iter().zip(areas(&scene)).map(|(h, a)| h[0] * a).sum::<f64>();
    assert!((sum(&found) / sum(&truth) - 1.0).abs() <= 1e-2, "{} {}", sum(&found), sum(&truth));
    // At points of a picture, what each brings adds up to what all bring.
    let radiance = exact.radiance(|i| scene.material(i));
    let (mut difference, mut all) = (0.0, 0.0);
    for i in scene.meshes[0].range.clone().map(|i| i as usize) {
        let [truth, found] = [&exact, &rays].map(|light| -> f64 {
            let of_lamps = &light.at_points(&facets, i, &[facets[i].centroid])[0];
            assert!(of_lamps.is_sorted_by_key(|(lamp, _)| *lamp));
            of_lamps.iter().map(|(lamp, phi)| phi.dot(facets[i].normal) * radiance[*lamp as usize].x).sum()
        });
        difference += (found - truth).powi(2);
        all += truth.powi(2);
    }
    let error = (difference / all).sqrt();
    println!("at points: {:.2} %", 100.0 * error);
    assert!(error <= 0.02, "{error:e}");
}

/// A luminous figure, neither convex nor plane, over a floor: against the path tracer, less the noise of that.
#[test]
fn a_luminous_figure_lights_as_by_paths() {
    let scene = over_a_floor(|b, _| {
        b.shape("figure", Shape::Statue { triangles: 600 }, &emitter(), at(0.0, 0.1, 0.0) * sized(0.5));
    });
    let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
    let lamps = lamps(&scene, &facets, 1e-7);
    assert!(lamps.len() > 300, "{}", lamps.len());
    let light = computed(&scene, &facets, lamps, Visibility::Distributed);
    let found = light.irradiance(|i| scene.material(i));
    let truth = PathTracer::new(&scene).irradiance(1024);
    let (mut error, mut all) = (0.0, 0.0);
    for i in scene.meshes[0].range.clone().map(|i| i as usize) {
        let truth = &truth[i];
        error += (found[i] - truth.mean).length_squared() - truth.error.length_squared();
        all += truth.mean.length_squared();
    }
    let error = (error / all).abs().sqrt();
    println!("under a luminous figure: {:.2} %", 100.0 * error);
    assert!(error <= 0.1, "{error:e}");
}

#[test]
fn sampled_visibility_is_refused_where_things_move() {
    let scene = support::implicit(balls());
    let settings = scene.settings.lamps(Lamps::Sampled);
    let plan = |gradients| Plan::new(&scene, &PlanOptions::default().gradients(gradients), &settings);
    let request = GradientRequest::default();
    for moves in [request.positions(true), request.camera(true)] {
        assert!(matches!(plan(moves), Err(PlanError::SampledLamps)));
    }
    let report = plan(request.albedo(true)).expect("a plan").report().lamps;
    assert_eq!((report.exact, report.sampled), (0, 7));
    assert!(report.why.contains("by rays"), "{}", report.why);
}

/// π L on every triangle of a convex body, wherever it stands, and 1 - F of that on a square under another one like it.
#[test]
fn a_uniform_sky_lights_by_what_is_seen_of_it() {
    let radiance = [3.0, 2.0, 1.0];
    let black = Material::named("black");
    let mut ball = SceneBuilder::new()
        .shape("ball", Shape::Icosphere { level: 2, inward: false }, &black, at(5.0, -2.0, 1.0) * sized(0.3))
        .finish("ball")
        .expect("a scene");
    let count = ball.triangles.len();
    ball.add_sky(&Sky::uniform(radiance));
    let (found, lamps) = direct(&ball);
    assert_eq!((lamps, ball.triangles.len()), (6, count + 12));
    for found in &found[..count] {
        for (found, l) in found.iter().zip(radiance) {
            assert!((found / (PI * l) - 1.0).abs() < 1e-7, "{found}, not {}", PI * l);
        }
    }

    let mut squares = SceneBuilder::new()
        .shape("floor", Shape::Quad { cells: 8 }, &black, DAffine3::IDENTITY)
        .shape("over", Shape::Quad { cells: 1 }, &black, at(0.0, 1.0, 0.0))
        .finish("squares")
        .expect("a scene");
    let areas = areas(&squares);
    squares.add_sky(&Sky::uniform([1.0; 3]));
    let (found, _) = direct(&squares);
    let mean = (0..128).map(|i| areas[i] * found[i][0]).sum::<f64>() / areas[..128].iter().sum::<f64>();
    // The form factor of parallel unit squares at distance 1.
    let lit = 1.0 - 0.199_824_9;
    assert!((mean / PI - lit).abs() < 1e-4, "{}, not {lit}", mean / PI);
    agrees("squares under a sky", &squares);
}

/// Light from above alone, and a small sun whose energy is kept.
#[test]
fn a_picture_of_a_sky_lights_from_where_it_is_bright() {
    let folder = tempfile::tempdir().expect("a folder");
    let write = |name: &str, texel: &dyn Fn(u32, u32) -> f32| {
        let path = folder.path().join(name);
        let picture = image::Rgb32FImage::from_fn(64, 32, |x, y| image::Rgb([texel(x, y); 3]));
        picture.save(&path).expect("a picture");
        path
    };
    let lit = |sky: &Sky| {
        let mut scene = SceneBuilder::new()
            .shape("box", Shape::Box { cells: 1 }, &Material::named("black"), sized(0.01))
            .finish("box")
            .expect("a scene");
        let normals: Vec<DVec3> = (0..12).map(|i| scene.area_vector(i).normalize()).collect();
        scene.add_sky(sky);
        let (found, lamps) = direct(&scene);
        assert!(lamps <= 96, "{lamps}");
        normals.into_iter().zip(found).map(|(n, h)| (n, h[0])).collect::<Vec<_>>()
    };
    let above =
        Sky::read(&write("above.hdr", &|_, y| if y < 16 { 1.0 } else { 0.0 }), [2.0; 3]).expect("a sky");
    for (normal, irradiance) in lit(&above) {
        // Half of what the sides see is bright, but for the finite distance.
        let expected = PI * (1.0 + normal.y);
        assert!((irradiance - expected).abs() < 0.04 * PI, "{normal}: {irradiance}, not {expected}");
    }
    // One texel, in the direction of +x and a little above, whose light comes from its square.
    let sun = write("sun.exr", &|x, y| if (x, y) == (48, 15) { 100.0 } else { 0.0 });
    let solid_angle = (TAU / 64.0) * ((PI * 15.0 / 32.0).cos() - (PI * 16.0 / 32.0).cos());
    for (normal, irradiance) in lit(&Sky::read(&sun, [1.0; 3]).expect("a sky")) {
        let expected = if normal.x > 0.5 { 100.0 * solid_angle } else { 0.0 };
        let spread = if normal.x > 0.5 { 0.15 * expected } else { 0.3 * 100.0 * solid_angle };
        assert!((irradiance - expected).abs() <= spread, "{normal}: {irradiance}, not {expected}");
    }
}

/// E cosθ on whatever faces it, nothing on backs.
#[test]
fn a_sun_lights_by_the_cosine() {
    for (direction, diameter) in
        [(DVec3::NEG_Y, 0.53), (DVec3::new(2.0, -1.0, 0.3), 0.01), (DVec3::new(-0.1, -0.2, 0.1), 40.0)]
    {
        let mut scene = over_a_floor(|b, black| {
            b.shape(
                "side",
                Shape::Quad { cells: 2 },
                black,
                at(0.0, -1.0, 0.0) * DAffine3::from_rotation_x(2.1),
            );
        });
        let sun = Sun { angular_diameter: diameter, ..Sun::new(direction, [7.0, 1.0, 0.0]) };
        scene.add_sun(sun).expect("a sun");
        let (found, lamps) = direct(&scene);
        assert_eq!(lamps, 1);
        for (i, found) in found.iter().enumerate() {
            let cosine = -scene.area_vector(i).normalize().dot(direction.normalize());
            // What is below the floor may be in its shadow.
            if i < 72 {
                let error = (found[0] - 7.0 * cosine).abs().max((found[1] - cosine).abs()) + found[2];
                assert!(error <= 1e-8, "{direction}: {found:?}, not {cosine}");
            } else if cosine < -0.4 {
                assert_eq!(*found, [0.0; 3]);
            }
        }
    }
}

/// Beside the edge of a roof, the part of the disc that a point sees: a great circle through the edge cuts it off.
#[test]
fn the_penumbra_of_a_sun_is_as_wide_as_its_disc() {
    let black = Material::named("black");
    for diameter in [0.53_f64, 10.0] {
        let mut scene = SceneBuilder::new()
            .shape("floor", Shape::Quad { cells: 1 }, &black, at(-2.0, 0.0, -2.0) * sized(4.0))
            .shape("roof", Shape::Quad { cells: 2 }, &black, at(-4.0, 1.0, -2.0) * sized(4.0))
            .finish("roof")
            .expect("a scene");
        scene.add_sun(Sun { angular_diameter: diameter, ..Sun::new(DVec3::NEG_Y, [1.0; 3]) }).expect("a sun");
        let facets: Vec<Facet> = (0..scene.triangles.len()).map(|i| Facet::new(scene.corners(i))).collect();
        let material = |i| scene.material(i);
        let light =
            DirectLight::of_points(&facets, lamps(&scene, &facets, 1e-7), Visibility::Exact, material);
        let radiance = light.radiance(material)[0].x;
        let limb = (0.5 * diameter).to_radians().sin();
        for step in -12..=12 {
            let x = 0.1 * f64::from(step) * limb.asin().tan();
            let found = light.at_points(&facets, 0, &[DVec3::new(x, 0.0, 0.05)])[0][0].1.y * radiance;
            // Seen along the axis, the circle is half an ellipse.
            let slope = x / x.hypot(1.0);
            let count = 4000;
            let part = |k: u32| {
                let y = limb * (2.0 * (f64::from(k) + 0.5) / f64::from(count) - 1.0);
                let [disc, edge] = [limb, 1.0].map(|radius| (radius * radius - y * y).max(0.0).sqrt());
                (disc + (slope * edge).clamp(-disc, disc)) / f64::from(count) / (0.5 * PI * limb)
            };
            let truth: f64 = (0..count).map(part).sum();
            assert!((found - truth).abs() <= 3e-3, "{diameter}°, {x}: {found}, not {truth}");
        }
    }
}

/// Walls have nothing behind them, and hide a sun all the same; a sky stands behind it.
#[test]
fn a_sun_shines_through_a_window_and_before_a_sky() {
    let black = Material::named("black");
    let turned = DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2);
    let mut room = over_a_floor(|b, black| {
        b.shape("ceiling", Shape::Quad { cells: 1 }, black, at(0.0, 1.0, 0.0) * sized(2.0) * DOWN);
        for ([low, high], [near, far]) in [
            ([0.0, 0.3], [0.0, 2.0]),
            ([0.7, 1.0], [0.0, 2.0]),
            ([0.3, 0.7], [0.0, 0.8]),
            ([0.3, 0.7], [1.3, 2.0]),
        ] {
            let size = DAffine3::from_scale(DVec3::new(high - low, 1.0, far - near));
            b.shape("wall", Shape::Quad { cells: 2 }, black, at(2.0, low, near) * turned * size);
        }
    });
    let sun = |diameter: f64| Sun {
        angular_diameter: diameter,
        ..Sun::new(DVec3::new(-1.0, -0.7, 0.1), [10.0, 5.0, 2.0])
    };
    room.add_sun(sun(3.0)).expect("a sun");
    agrees_on_average("a window", &room);
    let lit = direct(&room).0.iter().filter(|h| h[0] > 0.0).count();
    assert!((10..50).contains(&lit), "{lit} triangles are lit");
    room.suns[0].angular_diameter = 0.53;
    room.add_sun(sun(20.0)).expect("another sun");
    agrees_on_average("a window and two suns", &room);

    let mut ball = SceneBuilder::new()
        .shape("floor", Shape::Quad { cells: 4 }, &black, sized(2.0))
        .shape("ball", Shape::Icosphere { level: 1, inward: false }, &black, at(1.0, 0.5, 1.0) * sized(0.3))
        .finish("ball")
        .expect("a scene");
    ball.add_sky(&Sky::uniform([0.5; 3]));
    ball.add_sun(sun(2.0)).expect("a sun");
    agrees_on_average("a sky and a sun", &ball);
    // By rays as exactly.
    let facets: Vec<Facet> = (0..ball.triangles.len()).map(|i| Facet::new(ball.corners(i))).collect();
    let [exact, sampled] = [Visibility::Exact, Visibility::Sampled]
        .map(|visibility| computed(&ball, &facets, lamps(&ball, &facets, 1e-7), visibility).sunlight());
    let brightest = exact.iter().map(|h| h.x).fold(0.0, f64::max);
    for (i, (a, b)) in exact.iter().zip(&sampled).enumerate() {
        assert!((*a - *b).abs().max_element() <= 0.1 * brightest, "{i}: {b}, not {a}");
    }
}

/// All light that arrives is accounted for, whatever else emits.
#[test]
fn light_of_suns_is_part_of_the_energy() {
    let grey = Material { albedo: [0.5; 3], ..Material::named("grey") };
    let mut scene = SceneBuilder::new()
        .shape("floor", Shape::Quad { cells: 2 }, &grey, sized(2.0))
        .finish("floor")
        .expect("a scene");
    scene.add_sun(Sun::new(DVec3::new(0.0, -3.0, 4.0), [10.0, 20.0, 0.0])).expect("a sun");
    for lamps in [Lamps::Auto, Lamps::Antiradiance] {
        let backend = Backend::cpu();
        let settings = scene.settings.lamps(lamps);
        let plan = Plan::new(&scene, &PlanOptions::of(&backend), &settings).expect("a plan");
        assert!(plan.report().to_string().contains("direct light of 1 lamp"), "{}", plan.report());
        let mut engine = Engine::new(&backend, &scene, plan).expect("an engine");
        let energy = engine.solve(&SolveParams::default()).expect("a solution").energy;
        // 4 m² at a cosine of 0.6, half of which is reflected.
        for (found, expected) in [(energy.emitted, [24.0, 48.0, 0.0]), (energy.absorbed, [12.0, 24.0, 0.0])] {
            assert!(
                found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6),
                "{found:?}, not {expected:?}"
            );
        }
    }
}
