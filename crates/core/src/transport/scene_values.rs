//! The scene as operators read it, in the order and the coordinates of the plan.

use crate::model::Facet;
use crate::plan::{PADDING, Plan};
use antirad_scene::{Material, Scene};

/// Reals of a `Facet` of crates/core/glsl/geometry.glsl: centre, area, normal, characteristic area.
pub const FACET: usize = 8;
/// Reals of the corners of a triangle: three vec4.
pub const CORNERS: usize = 12;
/// Reals of a `Surface` of crates/core/glsl/surface.glsl: δρ, p; L_e, unused; σ N(p), unused.
pub const SURFACE: usize = 12;
/// Offset of σ N(p) in a `Surface`, in reals.
pub const SPECULAR: usize = 8;

fn facet_reals(f: &Facet) -> [f64; FACET] {
    let ([x, y, z], [u, v, w]) = (f.centroid.to_array(), f.normal.to_array());
    [x, y, z, f.area, u, v, w, f.characteristic_area]
}

fn corner_reals(f: &Facet) -> [f64; CORNERS] {
    let [[a, b, c], [d, e, g], [h, i, j]] = f.corners.map(|c| c.to_array());
    [a, b, c, 0.0, d, e, g, 0.0, h, i, j, 0.0]
}

fn surface_reals(m: &Material, emitted: [f64; 3], unit: f64) -> [f64; SURFACE] {
    let normalization = m.specular_normalization();
    let ([a, b, c], [d, e, f]) = (m.diffuse_albedo(), emitted.map(|l| l / unit));
    let [g, h, i] = m.specular.map(|sigma| sigma * normalization);
    [a, b, c, m.power, d, e, f, 0.0, g, h, i, 0.0]
}

/// Values of every slot, zero in padding.
fn by_slot<const N: usize>(plan: &Plan, value: impl Fn(usize) -> [f64; N]) -> Vec<f64> {
    let slot = |&i: &u32| if i == PADDING { [0.0; N] } else { value(i as usize) };
    plan.layout.order.iter().flat_map(slot).collect()
}

/// The facet of every slot.
pub fn facets(plan: &Plan) -> Vec<f64> {
    by_slot(plan, |i| facet_reals(&plan.facets[i]))
}

/// The corners of every slot.
pub fn corners(plan: &Plan) -> Vec<f64> {
    by_slot(plan, |i| corner_reals(&plan.facets[i]))
}

/// The material of every slot, with the radiance that each triangle of the scene emits, W/(m² sr), in units of `unit`.
pub fn surfaces(scene: &Scene, plan: &Plan, emitted: &[[f64; 3]], unit: f64) -> Vec<f64> {
    by_slot(plan, |i| surface_reals(scene.material(i), emitted[i], unit))
}

/// Centre of each bin, and c_b.
pub fn bin_table(plan: &Plan) -> Vec<f64> {
    let bins = plan.bins.centre.iter().zip(&plan.bins.projected);
    bins.flat_map(|(c, &p)| [c.x, c.y, c.z, p]).collect()
}
