//! Derivatives by a scene, pulled back onto the unknowns.

use super::super::limit::{limit, lobe};
use super::super::motion::MotionGradient;
use super::{Parameters, What, pose};
use antirad_render::render::{Quantity, SceneGradient};
use glam::DVec3;

/// RGB derivatives per [`Quantity`]; `None` if it is not fitted.
type ByQuantity = [Option<[f64; 3]>; 6];

impl Parameters {
    /// The derivative by the unknowns, from that by the scene at the same point.
    pub fn pull_back(&self, x: &[f64], gradient: &SceneGradient) -> Vec<f64> {
        let mut by_unknowns = vec![0.0; self.len()];
        let by_material = self.by_material(x, gradient);
        for block in &self.blocks {
            let to = &mut by_unknowns[block.range()];
            match &block.what {
                What::Material { quantity, materials, .. } => {
                    let unknowns = &x[block.first..];
                    for &m in materials {
                        let by_value = by_material[m as usize][*quantity as usize].unwrap_or_default();
                        for (channel, to) in to.iter_mut().enumerate() {
                            *to += by_value[channel] * slope(*quantity, unknowns[channel], block.scale);
                        }
                    }
                }
                What::Motion { vertices, free } => {
                    let Some(by_position) = &gradient.positions else { continue };
                    let pairs =
                        vertices.iter().map(|&v| (self.base.vertices[v as usize], by_position[v as usize]));
                    let by_motion = free.motion(&x[block.range()]).pull_back(pairs);
                    to.copy_from_slice(&free.by_unknowns(&by_motion));
                }
                What::Texture { painting, .. } => {
                    let by_texels = gradient.texels.as_ref().and_then(|all| all.get(*painting));
                    let numbers = by_texels.into_iter().flatten().flat_map(|by| by.to_array());
                    to.iter_mut().zip(numbers).for_each(|(to, number)| *to += number);
                }
                What::Vertex { vertices } => {
                    let Some(by_position) = &gradient.positions else { continue };
                    let sum: DVec3 = vertices.iter().map(|&v| by_position[v as usize]).sum();
                    to.iter_mut().zip((block.scale * sum).to_array()).for_each(|(to, number)| *to += number);
                }
                What::Camera { views, free } => {
                    let Some(by_cameras) = &gradient.cameras else { continue };
                    let motion = free.motion(&x[block.range()]);
                    let mut by_motion = MotionGradient::default();
                    for &view in views {
                        by_motion += pose::pull_back(&self.base.cameras[view], &motion, &by_cameras[view]);
                    }
                    to.copy_from_slice(&free.by_unknowns(&by_motion));
                }
            }
        }
        by_unknowns
    }

    /// Sums over the triangles of each material, through the soft limit of σ.
    fn by_material(&self, x: &[f64], gradient: &SceneGradient) -> Vec<ByQuantity> {
        let mut sums: Vec<ByQuantity> = vec![Default::default(); self.base.materials.len()];
        for block in &self.blocks {
            let What::Material { quantity, triangles, .. } = &block.what else { continue };
            for &t in triangles {
                let material = self.base.triangles[t as usize].material as usize;
                let sum = sums[material][*quantity as usize].get_or_insert_default();
                let by_value = gradient.of_triangle(*quantity, t as usize);
                sum.iter_mut().zip(by_value).for_each(|(sum, g)| *sum += g);
            }
        }
        let mut raw = self.base.materials.clone();
        self.set_materials(x, &mut raw, false);
        for ((sum, material), _) in
            sums.iter_mut().zip(&raw).zip(&self.limited).filter(|(_, limited)| **limited)
        {
            let lobe = lobe(material.power, material.normalization);
            let diffuse = material.diffuse_albedo();
            let by_limited = sum[Quantity::Specular as usize].unwrap_or_default();
            let limits = [0, 1, 2].map(|c| limit(material.specular[c], lobe, diffuse[c]));
            for c in 0..3 {
                let mut add = |quantity: Quantity, channel: usize, value: f64| {
                    if let Some(sum) = &mut sum[quantity as usize] {
                        sum[channel] += value * by_limited[c];
                    }
                };
                add(Quantity::Power, 0, limits[c].by_power);
                add(Quantity::Albedo, c, limits[c].by_diffuse_albedo * material.diffuse);
                add(Quantity::Diffuse, 0, limits[c].by_diffuse_albedo * material.albedo[c]);
            }
            if let Some(sum) = &mut sum[Quantity::Specular as usize] {
                *sum = [0, 1, 2].map(|c| by_limited[c] * limits[c].by_specular);
            }
        }
        sums
    }
}

/// The derivative of the value by the unknown.
fn slope(quantity: Quantity, unknown: f64, scale: f64) -> f64 {
    if quantity == Quantity::Power { unknown.exp() } else { scale }
}
