//! Fitted values of triangles that no view shows.

use super::{Parameters, What};
use antirad_render::render::Quantity;
use std::fmt;

/// Counts the values of one [`Fit`](super::Fit) whose triangles no view shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unseen {
    /// The quantity.
    pub quantity: Quantity,
    /// Number of values out of view.
    pub unseen: usize,
    /// Number of all values.
    pub values: usize,
}

impl fmt::Display for Unseen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { quantity, unseen, values } = *self;
        write!(
            f,
            "{unseen} of {values} fitted values of {} belong to triangles that no view shows: ",
            quantity.word()
        )?;
        f.write_str(match quantity {
            Quantity::Emission => {
                "their emission looks the same as emission of the surfaces that they illuminate; `antirad ambiguity` shows \
                 what the pictures leave undetermined, and a regulariser (sparsity, prior) resolves it"
            }
            _ => "only the light that they reflect elsewhere determines them; a regulariser (prior) constrains the rest",
        })
    }
}

impl Parameters {
    /// One entry per fit with unseen values. `seen`: per triangle of the scene, whether a view shows it.
    pub fn unseen(&self, seen: &[bool]) -> Vec<Unseen> {
        let triangle_seen = |t: &u32| seen[*t as usize];
        let mut vertex_seen = vec![false; self.base.vertices.len()];
        for (triangle, _) in self.base.triangles.iter().zip(seen).filter(|(_, seen)| **seen) {
            triangle.vertices.iter().for_each(|&v| vertex_seen[v as usize] = true);
        }
        let shown = |what: &What| match what {
            What::Material { triangles, .. } => triangles.iter().any(triangle_seen),
            What::Texture { painting, .. } => self.paintings[*painting].triangles().iter().any(triangle_seen),
            What::Motion { vertices, .. } | What::Vertex { vertices } => {
                vertices.iter().any(|&v| vertex_seen[v as usize])
            }
            // It shows itself.
            What::Camera { .. } => true,
        };
        let of = |(fit, what): (usize, &super::Fit)| {
            let blocks = || self.blocks.iter().filter(move |block| block.fit == fit);
            let unseen = blocks().filter(|block| !shown(&block.what)).count();
            Unseen { quantity: what.quantity, unseen, values: blocks().count() }
        };
        self.fits.iter().enumerate().map(of).filter(|found| found.unseen > 0).collect()
    }
}
