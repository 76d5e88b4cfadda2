//! The near field as a matrix that the device keeps: its contribution to U and, transposed, to Uᵀ.

use super::bundle::PassMonitor;
use super::bundle::{Bundle, MOST_GROUPS};
use crate::plan::{Block, IncidentPart, OutgoingPart, Plan, SLICE, SlicedMatrix};
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::pace::Pace;
use antirad_gpu::{Buffer, BufferKind, BufferSlice, Device, DeviceKind, GpuError, Pipeline};
use antirad_scene::Precision;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::sync::Arc;

/// `NearMatrixPush` of crates/core/glsl/near_matrix.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct NearMatrixPush {
    /// First slice.
    pub first_slice: u32,
    /// Steps of each slice that earlier dispatches covered.
    pub skip: u32,
    /// Largest number of steps of each slice that this dispatch covers.
    pub take: u32,
}

/// Steps of a slice per dispatch: lavapipe bounds the iterations of all loops of an invocation together by 65535.
const TAKE: u32 = 32_768;

/// Cooperative lanes of a GPU for each row of irradiance.
const LONG_ROW_LANES: u32 = 16;

/// The matrix from outgoing to incident light, or its transpose.
pub struct NearMatrix {
    matrix: Arc<SlicedMatrix>,
    transposed: bool,
    starts: Buffer,
    rows: Buffer,
    columns: Buffer,
    weights: Buffer,
    /// Kernels by whether the block reads bins, then by whether it writes bins.
    kernels: [[Pipeline; 2]; 2],
    pace: Pace,
    precision: Precision,
}

impl NearMatrix {
    /// The matrix from outgoing to incident light; `None` where the plan keeps none.
    ///
    /// # Errors
    /// Fails if the device cannot compile a kernel, or has no memory for the matrix.
    pub fn forward(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let matrix = plan.near_field_matrix().map(|matrix| &matrix.forward);
        matrix.map(|matrix| Self::new(device, plan, matrix, false)).transpose()
    }

    /// The matrix from the cotangent of incident light to that of outgoing light; `None` where the plan keeps
    /// none.
    ///
    /// # Errors
    /// Fails if the device cannot compile a kernel, or has no memory for the matrix.
    pub fn transposed(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let matrix = plan.near_field_matrix().and_then(|matrix| matrix.transposed.as_ref());
        matrix.map(|matrix| Self::new(device, plan, matrix, true)).transpose()
    }

    fn new(
        device: &Device,
        plan: &Plan,
        matrix: &Arc<SlicedMatrix>,
        transposed: bool,
    ) -> Result<Self, GpuError> {
        let precision = plan.settings.precision;
        let words = |label: &str, words: &[u32]| -> Result<Buffer, GpuError> {
            let buffer = Buffer::new(device, label, size_of_val(words) as u64, BufferKind::Storage)?;
            device.upload_slice(&buffer, 0, words)?;
            Ok(buffer)
        };
        let weights =
            Buffer::new(device, "near matrix: weights", matrix.weights.bytes(), BufferKind::Storage)?;
        device.upload(&weights, 0, matrix.weights.as_bytes())?;
        Ok(Self {
            matrix: matrix.clone(),
            transposed,
            starts: words("near matrix: starts", &matrix.starts)?,
            rows: words("near matrix: rows", &matrix.rows)?,
            columns: words("near matrix: columns", &matrix.columns)?,
            weights,
            kernels: Self::kernels(device, plan)?,
            pace: Pace::new(1e7),
            precision,
        })
    }

    /// Compiles the kernels, by whether a block reads bins, then by whether it writes bins.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<[[Pipeline; 2]; 2], GpuError> {
        let most = device.info().max_workgroup_invocations / SLICE;
        let kernel = |from_bins: u32, to_bins: u32| {
            // Rows of irradiance have an entry for each bin of each close source: one lane would wait for thousands of words in turn.
            let long = to_bins == 0 && device.kernels_for() != DeviceKind::Cpu;
            let cooperative = if long { LONG_ROW_LANES.min(most).max(1) } else { 1 };
            let lanes = SLICE * cooperative;
            let constants = [
                (0, lanes),
                (6, plan.channels),
                (8, from_bins),
                (9, to_bins),
                (13, lanes),
                (15, cooperative),
            ];
            let (shader, push) = (&shaders::NEAR_MATRIX, size_of::<NearMatrixPush>() as u32);
            Pipeline::new(device, shader.of(plan.settings.precision), 6, push, &constants)
        };
        Ok([[kernel(0, 0)?, kernel(0, 1)?], [kernel(1, 0)?, kernel(1, 1)?]])
    }

    /// Adds the near field to incident light; or its transpose to the cotangent of outgoing light. `ends`: outgoing and incident light, or
    /// their cotangents, of the blocks that take part.
    ///
    /// # Errors
    /// Fails if `ends` or the device does, or if the callback stops the pass.
    pub fn run<'a>(
        &mut self,
        device: &Device,
        ends: impl Fn(&Block) -> Result<Option<[BufferSlice<'a>; 2]>, TransportError>,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Self { matrix, transposed, starts, rows, columns, weights, kernels, pace, precision } = self;
        let shape = if *transposed { "transposed" } else { "forward" };
        let mut passed = 0;
        let mut bundle = Bundle::new(device, pace, monitor);
        for block in &matrix.blocks {
            let Some(ends) = ends(block)? else { continue };
            let bins = [
                !matches!(block.outgoing, OutgoingPart::Diffuse),
                !matches!(block.incident, IncidentPart::Irradiance),
            ];
            let [from, to] = if *transposed { [1, 0] } else { [0, 1] };
            passed += matrix.entries(block);
            let kernel = &kernels[usize::from(bins[from])][usize::from(bins[to])];
            let buffers =
                [starts.whole(), rows.whole(), columns.whole(), weights.whole(), ends[from], ends[to]];
            // Slices come in descending order of their width.
            for skip in (0..matrix.width(block.slices.start)).step_by(TAKE as usize) {
                let wider = block.slices.clone().take_while(|&slice| matrix.width(slice) > skip);
                let mut begin = block.slices.start;
                let end = begin + wider.count() as u32;
                while begin < end {
                    let mut entries = 0;
                    let count = (begin..end).take(MOST_GROUPS as usize).take_while(|&slice| {
                        let more = u64::from((matrix.width(slice) - skip).min(TAKE)) * u64::from(SLICE);
                        let fits = entries == 0 || entries + more <= bundle.affordable();
                        entries += if fits { more } else { 0 };
                        fits
                    });
                    let slices = count.count() as u32;
                    let push = NearMatrixPush { first_slice: begin, skip, take: TAKE };
                    bundle.add(entries, entries, |batch| {
                        batch.dispatch(kernel, shape, &buffers, bytes_of(&push), [slices, 1, 1])
                    })?;
                    begin += slices;
                }
            }
        }
        bundle.end()?;
        // A column, a weight, and three channels.
        device.credit(kernels[0][0].kernel(), shape, passed, passed * (4 + 4 * precision.bytes()));
        Ok(())
    }
}
