//! K of triangles that share a lobe, as products of matrices. Twin of glsl/reflect_lobes.comp and reflect_lobes_adjoint.comp.

use super::on_threads;
use super::real::Real;
use crate::gpu::{BufferSlice, Device, GpuError};
use crate::plan::{LOBE_ROWS, Plan};
use crate::scene::Precision;
use nalgebra::{DMatrix, RealField};
use rayon::prelude::*;

/// Triangles whose bins are multiplied at once: enough for the speed of large matrices, few enough to be cached.
const TOGETHER: usize = 16;
/// Such parts whose results are held at a time.
const PARTS: usize = 64;
/// Numbers of a `Surface` of glsl/surface.glsl, and where σ N(p) is.
const SURFACE: usize = 12;
const SPECULAR: usize = 8;

/// Reflection of the bins of some triangles into bins.
pub struct Reflected<'a> {
    /// As kernels read it: blocks of rows, each by column.
    pub matrix: BufferSlice<'a>,
    pub surfaces: BufferSlice<'a>,
    /// The triangles, and the slot with which `from` and `to` begin.
    pub slots: &'a [u32],
    pub page: u32,
    pub from: BufferSlice<'a>,
    pub to: BufferSlice<'a>,
    /// Whether it is added to what is there.
    pub add: bool,
}

impl Reflected<'_> {
    pub fn compute(&self, device: &Device, plan: &Plan) -> Result<Option<()>, GpuError> {
        let &Self { matrix, surfaces, from, to, .. } = self;
        let others = [matrix, surfaces, from];
        match plan.settings.precision {
            Precision::F32 => {
                device.edit_on_host([to], others, |[to], others| self.products::<f32>(plan, others, to))
            }
            Precision::F64 => {
                device.edit_on_host([to], others, |[to], others| self.products::<f64>(plan, others, to))
            }
        }
    }

    fn products<T: Real + RealField>(&self, plan: &Plan, [matrix, surfaces, from]: [&[T]; 3], to: &mut [T]) {
        let (bins, channels) = (plan.bins.count(), plan.channels as usize);
        let rows = LOBE_ROWS as usize;
        let block = (plan.lobe_block_bytes() / plan.settings.precision.bytes()) as usize;
        let entry = |row: usize, column: usize| matrix[row / rows * block + column * rows + row % rows];
        let lobe = DMatrix::from_fn(bins, bins, entry);
        let first = |slot: u32| (slot - self.page) as usize * bins * channels;
        // A column for each channel of a triangle.
        let product = |slots: &&[u32]| {
            let value = |bin: usize, column: usize| {
                from[first(slots[column / channels]) + bin * channels + column % channels]
            };
            &lobe * DMatrix::from_fn(bins, slots.len() * channels, value)
        };
        let parts: Vec<&[u32]> = self.slots.chunks(TOGETHER).collect();
        for parts in parts.chunks(PARTS) {
            let products: Vec<DMatrix<T>> = on_threads(|| parts.par_iter().map(product).collect());
            for (slots, product) in parts.iter().zip(products) {
                for (&slot, values) in slots.iter().zip(product.as_slice().chunks_exact(bins * channels)) {
                    let scale = &surfaces[slot as usize * SURFACE + SPECULAR..][..channels];
                    for (channel, (values, &scale)) in values.chunks_exact(bins).zip(scale).enumerate() {
                        let own = to[first(slot) + channel..].iter_mut().step_by(channels);
                        for (to, &value) in own.zip(values) {
                            *to = if self.add { *to + scale * value } else { scale * value };
                        }
                    }
                }
            }
        }
    }
}
