//! Albedo textures over the texture coordinates of meshes.

use super::super::selection::Selected;
use super::{ParameterBlock, ParameterError, Parameters, What};
use antirad_render::render::Quantity;

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
}
