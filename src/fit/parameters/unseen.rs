//! What is fitted although no view shows it.

use super::super::gradient::Quantity;
use super::{Parameters, What};
use std::fmt;

/// Values of one [`Fit`](super::Fit) none of whose triangles any view shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unseen {
    /// Which one no picture tells.
    pub quantity: Quantity,
    /// Out of view.
    pub unseen: usize,
    /// In all.
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
                "what they emit looks the same as the walls that they light emitting it; `antirad ambiguity` shows how \
                 far the pictures leave it open, and a regulariser (sparsity, prior) decides"
            }
            _ => "they are found by the light that they send elsewhere alone; a regulariser (prior) holds what that leaves open",
        })
    }
}

impl Parameters {
    /// By fit; `seen`: per triangle of the scene, whether a view shows it.
    pub fn unseen(&self, seen: &[bool]) -> Vec<Unseen> {
        let triangle_seen = |t: &u32| seen[*t as usize];
        let mut vertex_seen = vec![false; self.base.vertices.len()];
        for (triangle, _) in self.base.triangles.iter().zip(seen).filter(|(_, seen)| **seen) {
            triangle.vertices.iter().for_each(|&v| vertex_seen[v as usize] = true);
        }
        let shown = |what: &What| match what {
            What::Material { triangles, .. } => triangles.iter().any(triangle_seen),
            What::Motion { vertices, .. } | What::Vertex { vertices } => {
                vertices.iter().any(|&v| vertex_seen[v as usize])
            }
        };
        let of = |(fit, what): (usize, &super::Fit)| {
            let blocks = || self.blocks.iter().filter(move |block| block.fit == fit);
            let unseen = blocks().filter(|block| !shown(&block.what)).count();
            Unseen { quantity: what.quantity, unseen, values: blocks().count() }
        };
        self.fits.iter().enumerate().map(of).filter(|found| found.unseen > 0).collect()
    }
}
