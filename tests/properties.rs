//! Laws that hold for any scene, over random ones: the same on every run, more of them with PROPTEST_CASES.
//!
//! Cases that fail are kept in tests/data/properties.regressions and tried first from then on.

mod support;

use antirad::backend::Backend;
use antirad::plan::{GradientRequest, Plan, PlanError, PlanOptions};
use antirad::scene::{BinLayout, Material, Scene, SceneBuilder, Shape, SolveSettings, SolverChoice};
use glam::{DAffine3, DQuat, DVec3};
use proptest::prelude::*;
use proptest::test_runner::{FileFailurePersistence, RngSeed};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};
use support::kit::Random;
use support::{areas, relative_l2, solve, solve_within};

fn config(cases: u32) -> ProptestConfig {
    let usual = ProptestConfig::default();
    ProptestConfig {
        // PROPTEST_CASES asks for more.
        cases: if std::env::var_os("PROPTEST_CASES").is_some() { usual.cases } else { cases },
        failure_persistence: Some(Box::new(FileFailurePersistence::Direct(
            "tests/data/properties.regressions",
        ))),
        rng_seed: RngSeed::Fixed(20_260_729),
        max_shrink_iters: 50,
        ..usual
    }
}

/// One for all cases, so that kernels are compiled once, and for one test at a time: an engine counts what its
/// backend allocates meanwhile.
fn backend() -> MutexGuard<'static, Backend> {
    static BACKEND: OnceLock<Mutex<Backend>> = OnceLock::new();
    let backend = BACKEND.get_or_init(|| Mutex::new(support::backend()));
    backend.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Any material; of glossy ones with the energy-conserving factor.
fn material() -> impl Strategy<Value = Material> {
    let rgb = |most: f64| prop::array::uniform3(0.0..most);
    let specular = prop_oneof![3 => Just([0.0; 3]), 1 => rgb(0.1)];
    let emission = prop_oneof![Just([0.0; 3]), rgb(5.0)];
    (rgb(0.85), specular, 0.0..200.0, emission).prop_map(|(albedo, specular, power, emission)| Material {
        albedo,
        specular,
        power,
        emission,
        normalization: antirad::scene::Normalization::Energy,
        ..Material::named("m")
    })
}

/// A closed object in one of the eight corners of a room, in any orientation.
fn thing() -> impl Strategy<Value = (Shape, DAffine3)> {
    let shape = prop_oneof![
        (1u32..3).prop_map(|cells| Shape::Box { cells }),
        (0u32..2).prop_map(|level| Shape::Icosphere { level, inward: false }),
        (1u32..4).prop_map(|cells| Shape::Slab { cells }),
    ];
    (shape, prop::array::uniform3(0.05..0.25), prop::array::uniform4(-1.0..1.0)).prop_map(
        |(shape, size, turn)| {
            let turn = DQuat::from_array(turn).normalize();
            let turn = if turn.is_finite() { turn } else { DQuat::IDENTITY };
            let centre = match shape {
                Shape::Icosphere { .. } => DVec3::ZERO,
                _ => DVec3::splat(0.5),
            };
            let size = match shape {
                Shape::Icosphere { .. } => 0.5 * DVec3::from(size),
                _ => size.into(),
            };
            (
                shape,
                DAffine3::from_scale_rotation_translation(size, turn, DVec3::ZERO)
                    * DAffine3::from_translation(-centre),
            )
        },
    )
}

/// A closed room with up to two closed objects that do not touch, and some light.
#[derive(Clone, Debug)]
struct Recipe {
    cells: u32,
    walls: Material,
    light: [f64; 3],
    /// Each with its corner of the room.
    things: Vec<(u32, (Shape, DAffine3), Material)>,
}

fn recipe() -> impl Strategy<Value = Recipe> {
    let things = prop::collection::vec((0u32..8, thing(), material()), 0..3);
    (2u32..4, material(), prop::array::uniform3(0.1..5.0), things)
        .prop_map(|(cells, walls, light, things)| Recipe { cells, walls, light, things })
}

impl Recipe {
    fn scene(&self) -> Scene {
        let mut builder = SceneBuilder::new();
        let walls = Material { emission: self.light, ..self.walls.clone() };
        builder.shape("room", Shape::Room { cells: self.cells }, &walls, DAffine3::IDENTITY);
        let mut taken = [false; 8];
        for &(corner, (shape, place), ref material) in &self.things {
            if !std::mem::replace(&mut taken[corner as usize], true) {
                let at =
                    DVec3::new(f64::from(corner & 1), f64::from(corner >> 1 & 1), f64::from(corner >> 2));
                let there = DAffine3::from_translation(0.25 + 0.5 * at);
                builder.shape("thing", shape, material, there * place);
            }
        }
        builder.finish("random").map(support::implicit).expect("a scene")
    }
}

fn tight(scene: &Scene) -> SolveSettings {
    scene.settings.tolerance(1e-6)
}

proptest! {
    #![proptest_config(config(6))]

    /// Absorbed power is at most the emitted, within the error of meshes as coarse as these: 2 %.
    #[test]
    fn energy_is_not_created(recipe in recipe()) {
        let (backend, scene) = (backend(), recipe.scene());
        let (_engine, solution) = solve(&*backend, &scene, &scene.settings);
        prop_assert!(solution.irradiance.iter().chain(&solution.radiosity).flatten().all(|h| h.is_finite()));
        for c in 0..3 {
            let share = solution.energy.absorbed[c] / solution.energy.emitted[c];
            println!("absorbed {share:.4} of {} triangles", scene.triangles.len());
            prop_assert!(share <= 1.02, "channel {c}: {share} of what is emitted is absorbed");
            let whole = solution.energy.absorbed[c] + solution.energy.escaped[c];
            prop_assert!((whole / solution.energy.emitted[c] - 1.0).abs() <= 1e-12);
        }
    }
}

proptest! {
    #![proptest_config(config(3))]

    /// Light of two lamps is the sum of the light of each.
    #[test]
    fn light_is_linear_in_emission(recipe in recipe(), other in prop::array::uniform3(0.1..5.0), factor in 0.1..10.0) {
        let (backend, scene) = (backend(), recipe.scene());
        let settings = tight(&scene);
        let irradiance = |emission: &dyn Fn(usize, [f64; 3]) -> [f64; 3]| {
            let mut lit = scene.clone();
            for (k, m) in lit.materials.iter_mut().enumerate() {
                m.emission = emission(k, m.emission);
            }
            solve(&*backend, &lit, &settings).1.irradiance.clone()
        };
        // The walls are the first material.
        let walls = |k: usize, _| if k == 0 { other } else { [0.0; 3] };
        let first = irradiance(&|_, e| e);
        let second = irradiance(&walls);
        let both = irradiance(&|k, e| std::array::from_fn(|c| e[c] + factor * walls(k, e)[c]));
        let sum: Vec<[f64; 3]> = first.iter().zip(&second)
            .map(|(a, b)| std::array::from_fn(|c| a[c] + factor * b[c]))
            .collect();
        let error = relative_l2(&both, &sum, &areas(&scene));
        prop_assert!(error <= 1e-5, "{error:e}");
    }

    /// Culled pairs of tiles exchange no light.
    #[test]
    fn culling_changes_nothing(recipe in recipe(), concentric in any::<bool>()) {
        let (backend, scene) = (backend(), recipe.scene());
        let bins = if concentric { BinLayout::Concentric { n: 8 } } else { scene.settings.bins };
        let settings = tight(&scene).bins(bins);
        let usual = PlanOptions::of(&*backend).tile(32);
        let run = |cull| solve_within(&*backend, &scene, &settings, &usual.cull(cull)).1.irradiance.clone();
        let error = relative_l2(&run(true), &run(false), &areas(&scene));
        prop_assert!(error <= 1e-5, "{error:e}");
    }
}

proptest! {
    #![proptest_config(config(100))]

    /// A plan, made without a backend, keeps to its budget and to the largest buffer, and adds up. Where it is refused,
    /// the budget that the error names suffices.
    #[test]
    fn plans_keep_to_their_budget(
        recipe in recipe(),
        budget in (12.0..31.0f64).prop_map(|bits| bits.exp2() as u64),
        max_buffer in (14.0..28.0f64).prop_map(|bits| bits.exp2() as u64),
        page in (10.0..28.0f64).prop_map(|bits| bits.exp2() as u64),
        staging in (12.0..25.0f64).prop_map(|bits| bits.exp2() as u64),
        small_tiles in any::<bool>(),
        gradients in any::<bool>(),
        solver in prop_oneof![Just(SolverChoice::Auto), Just(SolverChoice::FixedPoint), Just(SolverChoice::Gmres)],
        n in 1u32..8,
        vulkan in any::<bool>(),
    ) {
        let scene = recipe.scene();
        let settings = scene.settings.bins(BinLayout::Concentric { n: 2 * n }).solver(solver);
        let usual = if vulkan { PlanOptions::lavapipe() } else { PlanOptions::default() };
        let options = usual.memory_budget(budget).max_buffer(max_buffer).page(page).staging(staging).tile(if small_tiles { 32 } else { 64 }).gradients(if gradients { GradientRequest::EVERYTHING } else { GradientRequest::NOTHING });
        let keeps = |plan: &Plan, options: &PlanOptions| {
            let memory = plan.memory();
            prop_assert!(memory.total() <= options.memory_budget);
            prop_assert_eq!(memory.items.iter().map(|item| item.bytes).sum::<u64>(), memory.total());
            Ok(())
        };
        match Plan::new(&scene, &options, &settings) {
            Ok(plan) => keeps(&plan, &options)?,
            Err(PlanError::OverBudget { budget: said, needed }) => {
                prop_assert!(said == budget && needed > budget);
                let enough = options.memory_budget(needed);
                match Plan::new(&scene, &enough, &settings) {
                    Ok(plan) => keeps(&plan, &enough)?,
                    Err(error) => prop_assert!(false, "{} bytes do not suffice: {}", needed, error),
                }
            }
            Err(PlanError::BufferTooLarge { bytes, limit, .. }) => prop_assert!(bytes > limit && limit == max_buffer),
            Err(error) => prop_assert!(false, "{}", error),
        }
    }
}

#[test]
fn directions_are_spread_evenly() {
    let mut random = Random::new(1);
    let found: Vec<DVec3> = (0..10_000).map(|_| random.direction()).collect();
    assert!(found.iter().all(|d| (d.length() - 1.0).abs() <= 1e-12));
    let mean = found.iter().sum::<DVec3>() / 1e4;
    let squares = found.iter().map(|d| d * d).sum::<DVec3>() / 1e4;
    // Four standard errors: of a component 0.58 %, of its square 0.30 %.
    assert!(mean.abs().max_element() <= 0.023 && (squares - 1.0 / 3.0).abs().max_element() <= 0.012);
}
