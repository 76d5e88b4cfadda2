//! Fitted values in physical units.

use super::super::motion::{Motion, Part};
use super::{Parameters, What, get};
use antirad_scene::Scene;
use glam::DVec3;
use serde::Serialize;

/// A fitted value, for display and JSON.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Recovered {
    /// The quantity.
    pub quantity: &'static str,
    /// Material, mesh, triangle by its index, or camera.
    pub of: String,
    /// Unit of the values; "1" for dimensionless ones.
    pub unit: &'static str,
    /// The fitted value, per channel or component.
    pub value: Vec<f64>,
    /// The initial value.
    pub initial: Vec<f64>,
    /// Per channel, whether it is at a bound.
    pub at_bound: Vec<bool>,
}

impl Parameters {
    /// The fitted values at some unknowns.
    pub fn recovered(&self, x: &[f64]) -> Vec<Recovered> {
        let (found, initial) = (self.scene(x), self.scene(&self.start));
        let mut list = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let range = block.range();
            let at_bound: Vec<bool> =
                range.clone().map(|i| x[i] <= self.bounds.lower[i] || x[i] >= self.bounds.upper[i]).collect();
            let mut push = |quantity, unit, value: Vec<f64>, initial: Vec<f64>, at_bound: &[bool]| {
                let (of, at_bound) = (block.name.clone(), at_bound.to_vec());
                list.push(Recovered { quantity, of, unit, value, initial, at_bound });
            };
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let n = quantity.channels();
                    let value = |scene: &Scene| {
                        materials
                            .first()
                            .map_or(vec![], |&m| get(&scene.materials[m as usize], *quantity)[..n].to_vec())
                    };
                    push(quantity.word(), quantity.unit(), value(&found), value(&initial), &at_bound);
                }
                What::Motion { free, .. } | What::Camera { free, .. } => {
                    let of = |x: &[f64]| free.motion(&x[block.range()]);
                    let (now, before) = (of(x), of(&self.start));
                    let [translation, rotation, factor] = free.parts();
                    let [way, turn, scale] = match &block.what {
                        What::Camera { .. } => {
                            ["camera displacement", "camera rotation vector", "camera scale"]
                        }
                        _ => ["translation", "rotation vector", "scale"],
                    };
                    if let (What::Camera { views, .. }, false) = (&block.what, self.fits[block.fit].together)
                    {
                        let place = |scene: &Scene| scene.cameras[views[0]].position.to_array().to_vec();
                        push("camera position", "m", place(&found), place(&initial), &at_bound[..3]);
                    }
                    if let Some(Part { first, .. }) = translation {
                        let value = |m: &Motion| m.translation.to_array().to_vec();
                        push(way, "m", value(&now), value(&before), &at_bound[first..first + 3]);
                    }
                    if let Some(Part { first, .. }) = rotation {
                        let value = |m: &Motion| m.rotation.to_array().map(f64::to_degrees).to_vec();
                        push(turn, "degrees", value(&now), value(&before), &at_bound[first..first + 3]);
                    }
                    if let Some(Part { first, .. }) = factor {
                        let value = |m: &Motion| vec![m.log_factor.exp()];
                        push(scale, "1", value(&now), value(&before), &at_bound[first..=first]);
                    }
                    if matches!(block.what, What::Camera { .. }) && self.fits[block.fit].together {
                        let value = |m: &Motion| m.rows().concat();
                        push("camera transform", "1, m", value(&now), value(&before), &[false; 12]);
                    }
                }
                What::Texture { painting, .. } => {
                    let mean = |x: &[f64]| {
                        let texels = self.texels(block, x);
                        let (mut sum, mut all) = (DVec3::ZERO, 0.0);
                        for &(texel, weight) in self.paintings[*painting].means().iter().flatten() {
                            sum += weight * texels[texel as usize];
                            all += weight;
                        }
                        (sum / all).to_array().to_vec()
                    };
                    let some_at_bound = [0, 1, 2].map(|c| at_bound.iter().skip(c).step_by(3).any(|at| *at));
                    push("mean albedo of a texture", "1", mean(x), mean(&self.start), &some_at_bound);
                }
                What::Vertex { vertices } => {
                    let value = |scene: &Scene| {
                        vertices.first().map_or(vec![], |&v| scene.vertices[v as usize].to_array().to_vec())
                    };
                    push("position", "m", value(&found), value(&initial), &at_bound);
                }
            }
        }
        list
    }
}
