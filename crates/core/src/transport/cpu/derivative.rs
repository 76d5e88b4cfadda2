//! The derivative of ⟨λ, U L⟩ by the geometry of sources or receivers, block by block.

use super::close_derivative::PieceSlopes;
use super::far::{BLOCK, CLOSE_COST, Light, N, SMALL, Sources};
use super::far_adjoint::{Cotangents, Receivers};
use super::far_derivative::Slopes;
use super::real::Real;
use crate::transport::shape::Shape;
use antirad_base::parallel;
use std::ops::Range;

/// Numbers of the gradient by one facet.
pub const GRADIENT: usize = 16;

/// The gradient by one facet, laid out as `FacetGradient` of crates/core/glsl/facet_gradient.glsl.
pub(super) type Gradient<T> = [T; GRADIENT];

/// A `FacetGradient` of its parts.
pub(super) fn gradient<T: Real>(
    [a, b, c]: [[T; 3]; 3],
    normal: [T; 3],
    area: T,
    characteristic_area: T,
) -> Gradient<T> {
    let none = T::ZERO;
    let [u, v, w] = normal;
    [a[0], a[1], a[2], area, b[0], b[1], b[2], characteristic_area, c[0], c[1], c[2], none, u, v, w, none]
}

/// What passes from sources of one class to receivers, whose bins are in one page each.
pub struct Derivative<'a, T> {
    pub shape: Shape,
    pub by: By<'a>,
    pub light: Light<'a, T>,
    /// The index with which the bins of the sources begin.
    pub sources_page: u32,
    pub cotangents: Cotangents<'a, T>,
    /// The slot with which those of the receivers begin.
    pub receivers_page: u32,
}

/// The ends of pairs by whose geometry a pass differentiates, in blocks of these, with the other ends.
pub enum By<'a> {
    Receivers(Sources<'a>),
    Sources(Receivers<'a>),
}

impl By<'_> {
    /// Pairs of a block.
    pub fn pairs(&self, block: u32) -> u64 {
        match self {
            Self::Receivers(of) => of.pairs(block),
            Self::Sources(of) => of.pairs(block),
        }
    }

    pub fn close(&self) -> bool {
        matches!(self, Self::Receivers(Sources::Close { .. }) | Self::Sources(Receivers::Close { .. }))
    }
}

/// What a thread reuses.
struct Scratch<T> {
    slopes: Slopes<T, N>,
    pieces: PieceSlopes<T>,
}

impl<T: Real> Derivative<'_, T> {
    /// Adds the gradients of some blocks to those of all triangles.
    pub fn add(&self, blocks: Range<u32>, gradients: &mut [T]) {
        let state = || Scratch::<T> { slopes: Slopes::NONE, pieces: PieceSlopes::NONE };
        let summed = |scratch: &mut Scratch<T>, block: u32| match &self.by {
            by if by.close() => self.close_block(block, &mut scratch.pieces),
            By::Receivers(of) => self.by_receivers(of, block, &mut scratch.slopes),
            By::Sources(of) => self.by_sources(of, block, &mut scratch.slopes),
        };
        // A pair takes about four times as long as forwards.
        let small = SMALL / 4 / if self.by.close() { CLOSE_COST } else { 1 };
        let small = blocks.clone().map(|block| self.by.pairs(block)).sum::<u64>() <= small;
        let sums: Vec<[Gradient<T>; N]> = if small {
            let mut scratch = state();
            blocks.clone().map(|block| summed(&mut scratch, block)).collect()
        } else {
            parallel::map_init(blocks.clone(), state, summed)
        };
        let own = gradients[(blocks.start * BLOCK) as usize * GRADIENT..].chunks_exact_mut(GRADIENT);
        for (to, sum) in own.zip(sums.as_flattened()) {
            to.iter_mut().zip(sum).for_each(|(to, &sum)| *to += sum);
        }
    }
}
