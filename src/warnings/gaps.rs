//! Layers that face each other closer than their triangles are wide: light between them leaks past.

use super::distance::between;
use crate::model::{Facet, Hierarchy, Node, coplanar_tolerance, reaches};
use crate::plan::{PADDING, Plan};
use glam::DVec3;
use rayon::prelude::*;

/// A gap counts below this share of the size √s of the larger triangle.
const NARROW: f64 = 0.5;
/// Least cosine of the gap with both normals: what meets at an angle is an edge, not a gap.
const FACING: f64 = 0.7;

/// Two triangles that face each other. Index = triangle of the scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gap {
    /// The larger one.
    pub wide: u32,
    pub other: u32,
    /// Width over the size √s of the larger triangle.
    pub share: f64,
}

/// Of each triangle the narrowest gap to a smaller one, if light or antiradiance passes it.
pub fn gaps(plan: &Plan) -> Vec<Gap> {
    let tile = plan.layout.tile as usize;
    let facets = &plan.facets;
    let real =
        |t: usize| plan.layout.order[t * tile..(t + 1) * tile].iter().copied().filter(|&i| i != PADDING);
    let size = |i: u32| facets[i as usize].extent.sqrt();
    let tolerance = coplanar_tolerance(facets);
    let tree = Hierarchy::new(facets, &plan.layout.order, tile, tolerance);
    let tiles: Vec<&Node> = tree.leaf_nodes().collect();
    let far = &plan.interactions().by_receiver.far;
    let passes = |i: usize, j: usize| {
        reaches(&facets[i], &facets[j], 1.0, tolerance)
            || plan.classes[i].blocker && reaches(&facets[i], &facets[j], -1.0, tolerance)
    };
    let narrow = |wide: u32, other: u32| -> Option<Gap> {
        let (i, j) = (wide as usize, other as usize);
        if size(other) > size(wide) || wide == other {
            return None;
        }
        let most = NARROW * size(wide);
        let gap = near(&facets[i], &facets[j], most)?;
        let width = gap.length();
        (width > tolerance && width < most && facing(gap, &facets[i]) && facing(gap, &facets[j]))
            .then_some(())
            .filter(|()| passes(i, j) || passes(j, i))
            .map(|()| Gap { wide, other, share: width / size(wide) })
    };
    (0..tiles.len())
        .into_par_iter()
        .flat_map_iter(|t| {
            let range = NARROW * tiles[t].extent.sqrt();
            let mut near = tree.leaves(|o| tiles[t].bounds.distance_squared(&o.bounds) < range * range);
            near.retain(|&o| far.get(t as u32, o as u32) | far.get(o as u32, t as u32) != 0);
            real(t)
                .filter_map(|wide| {
                    near.iter()
                        .flat_map(|&o| real(o))
                        .filter_map(|other| narrow(wide, other))
                        .min_by(|a, b| a.share.total_cmp(&b.share))
                })
                .collect::<Vec<_>>()
        })
        .collect()
}

/// The shortest vector between two facets of like planes, or `None` where it is surely longer than `most`.
fn near(a: &Facet, b: &Facet, most: f64) -> Option<DVec3> {
    if a.normal.dot(b.normal).abs() < FACING {
        return None;
    }
    let within = |x: &Facet, y: &Facet| {
        y.corners.iter().any(|&c| (c - x.centroid).dot(x.normal).abs() <= most * (1.0 + 1.0 / FACING))
    };
    let reach = |x: &Facet| x.corners.iter().map(|&c| c.distance(x.centroid)).fold(0.0, f64::max);
    if a.centroid.distance(b.centroid) > most + reach(a) + reach(b) || !within(a, b) {
        return None;
    }
    Some(between(a.corners, b.corners))
}

fn facing(gap: DVec3, facet: &Facet) -> bool {
    gap.dot(facet.normal).abs() >= FACING * gap.length()
}
