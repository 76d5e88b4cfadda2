//! Albedo textures over the texture coordinates of meshes.

use super::super::selection::Selected;
use super::{ParameterBlock, ParameterError, Parameters, Per, What, get, to_unknown};
use antirad_render::render::Quantity;
use antirad_scene::Scene;
use glam::DVec3;

/// Columns and rows of a texture unless stated.
const RESOLUTION: u32 = 64;
/// Largest number of columns and rows.
const MOST: u32 = 4096;

impl Parameters {
    /// Adds the texels of a texture for each selected mesh.
    pub(super) fn add_textures(&mut self, fit: usize, selected: &Selected) -> Result<(), ParameterError> {
        let refuse = |message: String| ParameterError { fit, message };
        let what = &self.fits[fit];
        if what.quantity != Quantity::Albedo {
            let word = what.quantity.word();
            return Err(refuse(format!("per = \"texel\" is for albedo, not for {word}; use \"triangle\"")));
        }
        let side = what.resolution.unwrap_or(RESOLUTION);
        if side == 0 || side > MOST {
            return Err(refuse(format!("resolution = {side}; it must lie in 1 to {MOST}")));
        }
        self.request.albedo = true;
        for (name, triangles) in &selected.groups {
            let (painting, texels) = self.base.paint(triangles, [side; 2]).map_err(|t| {
                refuse(format!(
                    "triangle {t} of \"{name}\" has no texture coordinates, which per = \"texel\" needs; unwrap the mesh, or \
                     use per = \"triangle\""
                ))
            })?;
            let what = What::Texture { painting: self.paintings.len(), texels: texels.len() };
            let first = self.start.len();
            self.start.extend(texels.iter().flat_map(|texel| texel.to_array()));
            self.blocks.push(ParameterBlock { fit, name: name.clone(), first, scale: 1.0, what });
            self.paintings.push(painting);
        }
        Ok(())
    }

    /// Whether textures are fitted.
    pub fn has_textures(&self) -> bool {
        !self.paintings.is_empty()
    }

    /// The first unknown, columns and rows of each texture.
    pub(in super::super) fn textures(&self) -> Vec<(usize, [u32; 2])> {
        let of = |block: &ParameterBlock| match &block.what {
            What::Texture { painting, .. } => Some((block.first, self.paintings[*painting].size())),
            _ => None,
        };
        self.blocks.iter().filter_map(of).collect()
    }

    /// These parameters at a point, with one albedo for each texture.
    pub(in super::super) fn without_textures(&self, x: &[f64]) -> Result<Self, ParameterError> {
        let fit = |fit: &super::Fit| match fit.per {
            Per::Texel => fit.clone().per(Per::Mesh).resolution(None),
            _ => fit.clone(),
        };
        // What is stated of initial values is in the scene already.
        let fits: Vec<super::Fit> = self.fits.iter().map(|of| fit(of).initial(None)).collect();
        Self::new(&self.scene(x), &fits, self.scale(Quantity::Emission))
    }

    /// The unknowns of these parameters at a scene of [`Self::without_textures`]: texels have the albedo of their triangles.
    pub(in super::super) fn unknowns_at(&self, scene: &Scene) -> Vec<f64> {
        let mut x = self.start.clone();
        for block in &self.blocks {
            let to = &mut x[block.first..block.first + block.unknowns()];
            match &block.what {
                What::Material { quantity, triangles, .. } => {
                    let Some(&t) = triangles.first() else { continue };
                    let value = get(scene.material(t as usize), *quantity);
                    for (to, value) in to.iter_mut().zip(value) {
                        *to = to_unknown(*quantity, value, block.scale);
                    }
                }
                What::Texture { painting, .. } => {
                    let painting = &self.paintings[*painting];
                    let texels = painting.texels_of(|t| DVec3::from(scene.material(t).albedo));
                    to.iter_mut().zip(texels.iter().flat_map(|t| t.to_array())).for_each(|(to, v)| *to = v);
                }
                What::Camera { .. } | What::Motion { .. } | What::Vertex { .. } => {}
            }
        }
        self.bounds.project(&mut x);
        x
    }
}
