//! Albedo textures over the texture coordinates of meshes.

use super::super::selection::Selected;
use super::{Groups, ParameterBlock, ParameterError, Parameters, Per, What};
use antirad_render::render::Quantity;
use antirad_scene::Crowded;

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
            let crowded = |crowded: Crowded| {
                let enough = crowded.enough();
                let finer =
                    if enough <= MOST { format!("state resolution = {enough}, ") } else { String::new() };
                refuse(format!(
                    "mesh \"{name}\" has no texture coordinates, and {crowded}; {finer}close its cracks with `snap`, unwrap it, or \
                     use per = \"triangle\""
                ))
            };
            let (painting, texels) = self.base.paint(triangles, [side; 2]).map_err(crowded)?;
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

    /// The first unknowns of each two neighbouring texels of textures ([`Painting::neighbours`](antirad_scene::Painting::neighbours)).
    pub(in super::super) fn neighbouring_texels(&self) -> Vec<[usize; 2]> {
        let of = |block: &ParameterBlock| match &block.what {
            What::Texture { painting, .. } => {
                let pairs = self.paintings[*painting].neighbours();
                let first = block.first;
                pairs.into_iter().map(|pair| pair.map(|texel| first + 3 * texel as usize)).collect()
            }
            _ => Vec::new(),
        };
        self.blocks.iter().flat_map(of).collect()
    }

    /// The triangles that share each value of a fit; `None` if it is not of triangles.
    fn triangles_by_name(&self, fit: usize) -> Option<Groups> {
        let triangles = |block: &ParameterBlock| match &block.what {
            What::Material { triangles, .. } => Some(triangles.clone()),
            What::Texture { painting, .. } => Some(self.paintings[*painting].triangles().to_vec()),
            What::Motion { .. } | What::Vertex { .. } | What::Camera { .. } => None,
        };
        let blocks = self.blocks.iter().filter(|block| block.fit == fit);
        blocks.map(|block| Some((block.name.clone(), triangles(block)?))).collect()
    }

    /// These parameters with one albedo for each texture, starting at a point, and with pictures of other sizes; and per unknown, the one of
    /// them that it follows.
    pub(in super::super) fn without_textures(
        &self,
        x: &[f64],
        sizes: &[[u32; 2]],
    ) -> Result<(Self, Vec<u32>), ParameterError> {
        let fit = |(number, fit): (usize, &super::Fit)| {
            // What is stated of initial values is in the point already.
            let fit = fit.clone().initial(None);
            match self.triangles_by_name(number) {
                // Materials that were split have other names by now.
                Some(groups) => {
                    fit.groups(Some(groups)).materials(None).meshes(None).per(Per::Mesh).resolution(None)
                }
                None => fit,
            }
        };
        let fits: Vec<super::Fit> = self.fits.iter().enumerate().map(fit).collect();
        // Positions and poses are relative to those of the base scene, here as there.
        let mut at_rest = x.to_vec();
        for block in &self.blocks {
            if matches!(block.what, What::Motion { .. } | What::Vertex { .. } | What::Camera { .. }) {
                at_rest[block.range()].fill(0.0);
            }
        }
        let mut base = self.scene(&at_rest);
        for (camera, size) in base.cameras.iter_mut().zip(sizes) {
            [camera.width, camera.height] = *size;
        }
        let mut coarse = Self::new(&base, &fits, self.scale(Quantity::Emission))?;
        coarse.fits.clone_from(&self.fits);
        let mut of = vec![0; self.len()];
        for (fine, block) in self.blocks.iter().zip(&coarse.blocks) {
            for (of, unknown) in of[fine.range()].iter_mut().zip(block.range().cycle()) {
                *of = unknown as u32;
            }
            if !matches!(fine.what, What::Texture { .. }) {
                coarse.start[block.range()].copy_from_slice(&x[fine.range()]);
            }
        }
        coarse.bounds.project(&mut coarse.start);
        Ok((coarse, of))
    }
}
