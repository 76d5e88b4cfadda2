//! The derivative of ⟨λ, U L⟩ by the geometry of sources or receivers on the host.

use super::close_derivative::PieceSlopes;
use super::far::{CLOSE_COST, Light, SMALL, Sources};
use super::far_adjoint::{Cotangents, Receivers};
use super::far_derivative::Slopes;
use super::on_threads;
use super::real::Real;
use super::taps::Layout;
use crate::gpu::{BufferSlice, Device, GpuError};
use crate::model::{LIST, SOURCES};
use crate::plan::Plan;
use crate::scene::Precision;
use crate::transport::exchange::Shape;
use rayon::prelude::*;
use std::ops::Range;

/// `FacetGradient` of glsl/facet_gradient.glsl.
pub(super) type Gradient<T> = [T; 16];

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
pub struct Derivative<'a> {
    pub shape: Shape,
    pub by: By<'a>,
    pub facets: BufferSlice<'a>,
    pub corners: BufferSlice<'a>,
    /// Diffuse radiance; behind that of all sources, the first moments of clusters.
    pub radiance: BufferSlice<'a>,
    /// Bins of the sources, and the index with which they begin.
    pub antiradiance: BufferSlice<'a>,
    pub specular: BufferSlice<'a>,
    pub sources_page: u32,
    /// Cotangent of irradiance.
    pub irradiance: BufferSlice<'a>,
    /// That of the receivers' bins, and the slot with which these begin.
    pub incident: BufferSlice<'a>,
    pub receivers_page: u32,
    pub gradients: BufferSlice<'a>,
}

/// Of which ends of pairs the geometry counts, in blocks of these, with the other ends.
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

    /// The triangles or clusters of a block.
    pub(super) fn own(&self, block: u32) -> Range<u32> {
        match self {
            Self::Receivers(_) => block * LIST..(block + 1) * LIST,
            Self::Sources(of) => of.sources(block),
        }
    }
}

/// What a thread reuses.
struct Scratch<T, const N: usize> {
    slopes: Slopes<T, N>,
    pieces: PieceSlopes<T>,
}

/// Both ends in memory.
pub(super) struct Memory<'a, T> {
    pub light: Light<'a, T>,
    pub cotangents: Cotangents<'a, T>,
}

impl Derivative<'_> {
    /// Adds it for some blocks. `None` where kernels must do it.
    pub fn add(&self, device: &Device, plan: &Plan, blocks: Range<u32>) -> Result<Option<()>, GpuError> {
        match plan.settings.precision {
            Precision::F32 => self.add_as::<f32>(device, plan, blocks),
            Precision::F64 => self.add_as::<f64>(device, plan, blocks),
        }
    }

    fn add_as<T: Real>(
        &self,
        device: &Device,
        plan: &Plan,
        blocks: Range<u32>,
    ) -> Result<Option<()>, GpuError> {
        match self.by {
            By::Sources(Receivers::Listed { .. }) => {
                self.add_blocks::<T, { SOURCES as usize }>(device, plan, blocks)
            }
            _ => self.add_blocks::<T, { LIST as usize }>(device, plan, blocks),
        }
    }

    /// With blocks of N sources or receivers.
    fn add_blocks<T: Real, const N: usize>(
        &self,
        device: &Device,
        plan: &Plan,
        blocks: Range<u32>,
    ) -> Result<Option<()>, GpuError> {
        let others = [
            self.facets,
            self.corners,
            self.radiance,
            self.antiradiance,
            self.specular,
            self.irradiance,
            self.incident,
        ];
        device.edit_on_host([self.gradients], others, |[gradients], others| {
            let [facets, corners, radiance, antiradiance, specular, irradiance, incident] = others;
            let layout = Layout::of(plan);
            let bins = layout.count * layout.channels;
            let half_range = T::of(0.5 * plan.settings.near_field);
            let bin_table = &[][..];
            let light = Light {
                layout,
                half_range,
                facets,
                corners,
                radiance,
                antiradiance,
                specular,
                bin_table,
                bins,
            };
            let cotangents =
                Cotangents { layout, half_range, facets, corners, irradiance, incident, bin_table, bins };
            let memory = Memory { light, cotangents };
            let state = || Scratch::<T, N> { slopes: Slopes::NONE, pieces: PieceSlopes::NONE };
            let summed = |scratch: &mut Scratch<T, N>, block: u32| match &self.by {
                by if by.close() => self.close_block(&memory, block, &mut scratch.pieces),
                By::Receivers(of) => self.by_receivers(of, &memory, block, &mut scratch.slopes),
                By::Sources(of) => self.by_sources(of, &memory, block, &mut scratch.slopes),
            };
            // A pair takes about four times as long as forwards.
            let small = SMALL / 4 / if self.by.close() { CLOSE_COST } else { 1 };
            let small = blocks.clone().map(|block| self.by.pairs(block)).sum::<u64>() <= small;
            let sums: Vec<[Gradient<T>; N]> = if small {
                let mut scratch = state();
                blocks.clone().map(|block| summed(&mut scratch, block)).collect()
            } else {
                on_threads(|| blocks.clone().into_par_iter().map_init(state, summed).collect())
            };
            for (block, sums) in blocks.zip(sums) {
                for (index, sum) in self.by.own(block).zip(sums) {
                    let to = &mut gradients[index as usize * 16..][..16];
                    to.iter_mut().zip(sum).for_each(|(to, sum)| *to += sum);
                }
            }
        })
    }
}
