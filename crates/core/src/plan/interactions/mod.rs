//! Which pairs interact: for each receiver tile, runs of source tiles with what may pass, and for each receiver the
//! close sources. Every traversal of pairs uses these lists, so that another selection changes nothing else.

mod far;
mod near;
mod passing;

pub use crate::model::{PAIR_BACK, PAIR_FRONT, PAIR_NEAR};
pub use far::FarRuns;
pub use near::NearPairs;

use super::{PlanError, TileLayout};
use crate::model::{Class, Facet, Hierarchy, coplanar_tolerance};
use far::Row;
use passing::Passing;

/// The pairs by target: receivers with sources as partners, or sources with receivers.
#[derive(Clone, Debug, Default)]
pub struct PairLists {
    /// Point-to-point pairs, by tile of targets.
    pub far: FarRuns,
    /// Close pairs, by slot of the target.
    pub near: NearPairs,
}

/// All pairs that interact, by receiver, and by source if gradients are planned.
#[derive(Clone, Debug, Default)]
pub struct Interactions {
    /// Targets are receivers.
    pub by_receiver: PairLists,
    /// Targets are sources; `None` without planned gradients.
    pub by_source: Option<PairLists>,
}

impl Interactions {
    /// Finds all pairs by their geometry. `half_range`: half of `near_field`, in units of the sum of characteristic
    /// areas;
    /// `cull`: whether tiles that cannot exchange light are omitted.
    pub(super) fn new(
        layout: &TileLayout,
        facets: &[Facet],
        classes: &[Class],
        half_range: f64,
        cull: bool,
        by_source: bool,
    ) -> Result<Self, PlanError> {
        let tolerance = coplanar_tolerance(facets);
        let tree = Hierarchy::new(facets, &layout.order, layout.tile as usize, tolerance);
        let far = Passing::new(layout, facets, &tree, half_range, tolerance, cull).runs()?;
        let near = NearPairs::of_tiles(layout, &far, facets, classes, half_range, tolerance)?;
        let by_receiver = PairLists { far, near };
        let by_source = by_source.then(|| by_receiver.transposed()).transpose()?;
        Ok(Self { by_receiver, by_source })
    }

    /// No pairs.
    pub(super) fn none(layout: &TileLayout, by_source: bool) -> Result<Self, PlanError> {
        let mut nothing = Row::default();
        nothing.extend(layout.tiles(), 0);
        let far = FarRuns::new(&vec![nothing; layout.tiles() as usize])?;
        let near = NearPairs { offsets: vec![0; layout.slots() as usize + 1], partners: Vec::new() };
        let by_receiver = PairLists { far, near };
        let by_source = by_source.then(|| by_receiver.clone());
        Ok(Self { by_receiver, by_source })
    }
}

impl PairLists {
    fn transposed(&self) -> Result<Self, PlanError> {
        Ok(Self { far: self.far.transposed()?, near: self.near.transposed() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::{BoundedRun, reaches};
    use crate::plan::{GradientRequest, PADDING, Plan, PlanOptions};
    use antirad_kit::Random;
    use antirad_scene::{LoadOptions, Material, Scene, SceneBuilder, Shape, Triangle};
    use glam::{DAffine3, DVec3};
    use std::path::Path;

    fn shipped(name: &str) -> Scene {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes").join(name);
        Scene::load(&path, &LoadOptions::default()).expect("a shipped scene")
    }

    fn statue(triangles: u32) -> Scene {
        let (floor, stone) = (Material::named("floor"), Material::named("stone"));
        let mut builder = SceneBuilder::new();
        let place = DAffine3::from_scale(DVec3::splat(6.0)) * DAffine3::from_translation(-DVec3::ONE / 2.0);
        builder.shape("floor", Shape::Quad { cells: 24 }, &floor, place);
        builder.shape("statue", Shape::Statue { triangles }, &stone, DAffine3::IDENTITY);
        builder.finish("statue").expect("a scene")
    }

    /// Triangles anywhere, some without area, and a wall that some of them lie in.
    fn random(seed: u64, count: u32) -> Scene {
        let mut random = Random::new(seed);
        let mut vertices = Vec::new();
        for k in 0..count {
            let (at, size) =
                (random.vector(), if k % 50 == 0 { 0.0 } else { 0.02 + 0.2 / f64::from(1 + k % 7) });
            let flat = if k % 3 == 0 { DVec3::new(1.0, 1.0, 0.0) } else { DVec3::ONE };
            vertices.extend([at, at + size * random.vector(), at + size * random.vector()].map(|x| x * flat));
        }
        let triangles = (0..count).map(|k| Triangle { vertices: [3 * k, 3 * k + 1, 3 * k + 2], material: 0 });
        Scene::new("random", vertices, triangles.collect(), vec![Material::named("grey")]).expect("a scene")
    }

    fn plan(scene: &Scene, options: PlanOptions) -> Plan {
        let settings = scene.settings.visibility(antirad_scene::VisibilityChoice::Implicit);
        Plan::new(scene, &options.boundless(), &settings).expect("a plan")
    }

    /// The bits that may pass between two tiles, from all their triangles.
    fn dense(plan: &Plan, receiver: u32, source: u32) -> u32 {
        let facets = |tile: u32| -> Vec<&Facet> {
            let slots = plan.layout.slots_of(&(tile..tile + 1));
            let order = &plan.layout.order[slots.start as usize..slots.end as usize];
            order.iter().filter(|&&i| i != PADDING).map(|&i| &plan.facets[i as usize]).collect()
        };
        let (to, from) = (facets(receiver), facets(source));
        let bounds = |of: &[&Facet]| BoundedRun::around(of.iter().copied());
        let tolerance = coplanar_tolerance(&plan.facets);
        let sees = |of: &[&Facet], other: &[&Facet], side: f64| {
            let other = bounds(other);
            let height = |f: &Facet| -other.lowest(-side * f.normal) - side * f.normal.dot(f.centroid);
            !plan.options.cull || of.iter().any(|f| height(f) > tolerance)
        };
        let characteristic_area =
            |of: &[&Facet]| of.iter().map(|f| f.characteristic_area).fold(0.0, f64::max);
        let range = 0.5 * plan.settings.near_field * (characteristic_area(&to) + characteristic_area(&from));
        let blocker = plan.layout.groups.iter().any(|g| g.class.blocker && g.tiles.contains(&source));
        let front = if sees(&from, &to, 1.0) { PAIR_FRONT } else { 0 };
        let back = if blocker && sees(&from, &to, -1.0) { PAIR_BACK } else { 0 };
        let near = if bounds(&to).distance_squared(&bounds(&from)) <= range { PAIR_NEAR } else { 0 };
        if front | back != 0 && sees(&to, &from, 1.0) { front | back | near } else { 0 }
    }

    #[test]
    fn pairs_are_those_of_the_dense_search() {
        let names = ["cornell_boxes.toml", "two_rooms.toml", "glossy_floor.toml", "closed_box.toml"];
        let mut scenes: Vec<Scene> = names.map(shipped).into();
        scenes.extend([statue(3000), random(1, 1000), random(2, 3000)]);
        for scene in &scenes {
            for (tile, cull) in [(64, true), (32, true), (64, false)] {
                let plan = plan(scene, PlanOptions { tile, cull, ..PlanOptions::default() });
                let far = &plan.interactions.by_receiver.far;
                let tiles = plan.layout.tiles();
                for (receiver, source) in (0..tiles).flat_map(|r| (0..tiles).map(move |s| (r, s))) {
                    let found = far.get(receiver, source);
                    let name = &scene.name;
                    assert_eq!(found, dense(&plan, receiver, source), "{name}: {receiver} from {source}");
                }
            }
        }
    }

    #[test]
    fn classes_and_close_pairs_are_those_of_the_dense_search() {
        for scene in [shipped("two_rooms.toml"), statue(2000), random(3, 1500)] {
            let plan = plan(
                &scene,
                PlanOptions { gradients: GradientRequest::EVERYTHING, ..PlanOptions::default() },
            );
            let (facets, count) = (&plan.facets, plan.facets.len());
            let own: Vec<Facet> = (0..count).map(|i| Facet::new(scene.corners(i))).collect();
            let tolerance = coplanar_tolerance(&own);
            let real = |i: usize| own[i].area > 0.0;
            for (i, class) in plan.classes.iter().enumerate() {
                let mut partners = (0..count).filter(|&j| j != i && real(j));
                let casts = real(i) && partners.any(|j| reaches(&own[i], &own[j], -1.0, tolerance));
                assert_eq!(class.blocker, casts, "{}: triangle {i}", scene.name);
            }
            let tolerance = coplanar_tolerance(facets);
            let order = &plan.layout.order;
            let slots: Vec<usize> = (0..order.len()).filter(|&slot| order[slot] != PADDING).collect();
            let mut sources = Vec::new();
            for &slot in &slots {
                let j = order[slot] as usize;
                let close = |&&source: &&usize| {
                    let i = order[source] as usize;
                    let apart = facets[i].centroid.distance_squared(facets[j].centroid);
                    let range = 0.5
                        * plan.settings.near_field
                        * (facets[i].characteristic_area + facets[j].characteristic_area);
                    i != j
                        && apart < range
                        && (reaches(&facets[i], &facets[j], 1.0, tolerance)
                            || plan.classes[i].blocker && reaches(&facets[i], &facets[j], -1.0, tolerance))
                };
                sources.extend(slots.iter().filter(close).map(|&source| source as u32));
            }
            let Interactions { by_receiver, by_source, .. } = &plan.interactions;
            assert_eq!(by_receiver.near.partners, sources, "{}", scene.name);
            let by_source = by_source.as_ref().expect("gradients were planned");
            assert_eq!(by_source.far, by_receiver.far.transposed().expect("few runs"));
        }
    }

    /// Equal neighbours merge into runs: the lists of a room grow no faster than the room.
    #[test]
    fn runs_of_rooms_take_a_few_bytes_a_triangle() {
        let mut scene = shipped("cornell_boxes.toml");
        for _ in 0..3 {
            let far = &plan(&scene, PlanOptions::default()).interactions.by_receiver.far;
            let bytes = size_of_val(far.words()) as f64 / scene.triangles.len() as f64;
            println!("{} triangles: {bytes:.2} bytes each", scene.triangles.len());
            assert!(bytes <= 8.0, "{} triangles: {bytes}", scene.triangles.len());
            scene.split_all(1);
        }
    }
}
