//! The lobes of glossy triangles: matrices of those that share a power, and the order in which kernels take triangles.

use super::{WORKGROUP, real};
use crate::model::Bins;
use crate::plan::{LOBE_BYTES, LOBE_ROWS, LobeSlots, Plan};
use antirad_base::parallel;
use antirad_gpu::{Buffer, BufferKind, BufferSlice, Device, GpuError, UNIFORM_BYTES};
use antirad_scene::Scene;
use bytemuck::{Pod, Zeroable};
use std::ops::Range;

// A dispatch binds some rows or columns of a matrix as a uniform buffer.
const _: () = assert!(LOBE_BYTES <= UNIFORM_BYTES);

/// Triangles of one dispatch: some tens of milliseconds on a CPU.
const MOST_TRIANGLES: u32 = 1 << 14;

/// `LobePush` of crates/core/glsl/lobe_rows.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct LobePush {
    /// First slot of the page.
    pub page: u32,
    /// First entry of the slots by power that this dispatch computes.
    pub first: u32,
    /// Number of triangles that this dispatch computes.
    pub count: u32,
    /// The first row of the first block.
    pub first_row: u32,
    /// Blocks of rows.
    pub blocks: u32,
    /// The first column of this dispatch.
    pub begin: u32,
    /// One past the last column of this dispatch.
    pub end: u32,
}

/// One dispatch over triangles that share a matrix.
pub struct Product<'a> {
    pub push: LobePush,
    /// The range of the matrix of K, ⟨h(b,o),n⟩^p c_b, that the dispatch reads.
    pub forward: BufferSlice<'a>,
    /// The range of the matrix of Kᵀ, ⟨h(b,o),n⟩^p, that the dispatch reads; `forward` where no gradients are
    /// planned.
    pub transposed: BufferSlice<'a>,
    /// The range of the logarithms ln⟨h(b,o),n⟩ that the dispatch reads; `forward` where no derivatives of
    /// lobes are planned.
    pub logarithms: BufferSlice<'a>,
}

impl Product<'_> {
    /// Pairs of bins, over all triangles.
    pub fn pairs(&self) -> u64 {
        let LobePush { count, blocks, begin, end, .. } = self.push;
        u64::from(count) * u64::from(blocks * LOBE_ROWS) * u64::from(end - begin)
    }

    /// Workgroups, each for one block of rows.
    pub fn groups(&self) -> [u32; 3] {
        [self.push.count.div_ceil(WORKGROUP), self.push.blocks, 1]
    }
}

/// Buffers of lobes. `None` where nothing is glossy, or nothing of that kind is planned.
pub(crate) struct Lobes {
    /// ⟨h(b,o),n⟩^p c_b of each power: by block of rows o, column b, row.
    forward: Option<Buffer>,
    /// ⟨h(b,o),n⟩^p of each power: by block of rows o, column b, row.
    transposed: Option<Buffer>,
    /// ln⟨h(b,o),n⟩: by block of rows o, column b, row.
    logarithms: Option<Buffer>,
    /// The slots of the glossy triangles, by power.
    slots: Option<Buffer>,
    by_power: LobeSlots,
    /// The powers of the matrices on the device.
    computed: Vec<f64>,
}

impl Lobes {
    /// Allocates what the plan counts. [`Lobes::set`] fills it.
    ///
    /// # Errors
    /// Fails if the device has no memory for a buffer, or cannot write to it.
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let buffer = |label: &str, bytes: u64| Buffer::new(device, label, bytes, BufferKind::Storage);
        let matrices = plan.lobes.matrices;
        let [gradients, of_powers] = plan.lobe_gradients().map(|wanted| wanted && matrices > 0);
        let pages = || buffer("lobe matrices", plan.lobe_buffer_bytes(matrices));
        let glossy: u64 =
            plan.glossy_groups().map(|(_, g)| plan.layout.slots_of(&g.tiles).len() as u64).sum();
        let logarithms = || -> Result<Buffer, GpuError> {
            let buffer = buffer("lobe logarithms", plan.lobe_buffer_bytes(1))?;
            let bytes = matrix(plan, |b, o| logarithm(&plan.bins, b, o));
            device.upload(&buffer, 0, &bytes)?;
            Ok(buffer)
        };
        Ok(Self {
            forward: (matrices > 0).then(pages).transpose()?,
            transposed: gradients.then(pages).transpose()?,
            logarithms: of_powers.then(logarithms).transpose()?,
            slots: (glossy > 0).then(|| buffer("lobe slots", glossy * 4)).transpose()?,
            by_power: LobeSlots::default(),
            computed: Vec::new(),
        })
    }

    /// Computes the matrices for the materials of a scene. Powers beyond those planned have none.
    ///
    /// # Errors
    /// Fails if the device cannot write to the buffers.
    pub fn set(&mut self, device: &Device, scene: &Scene, plan: &Plan) -> Result<(), GpuError> {
        let Some(slots) = &self.slots else { return Ok(()) };
        self.by_power = plan.lobe_slots(scene);
        device.upload_slice(slots, 0, &self.by_power.slots)?;
        let bins = &plan.bins;
        for (k, &power) in self.by_power.powers.iter().enumerate() {
            if self.computed.get(k) == Some(&power) {
                continue;
            }
            self.computed.truncate(k);
            let at = k as u64 * plan.lobe_matrix_bytes();
            if let Some(buffer) = &self.forward {
                let lobe = |b, o| bins.half_cosine(b, o).powf(power) * bins.projected[b];
                device.upload(buffer, at, &matrix(plan, lobe))?;
            }
            if let Some(buffer) = &self.transposed {
                device.upload(buffer, at, &matrix(plan, |b, o| bins.half_cosine(b, o).powf(power)))?;
            }
            self.computed.push(power);
        }
        Ok(())
    }

    /// The slots by power, to bind to kernels; `none` where nothing is glossy.
    pub fn slots<'a>(&'a self, none: &'a Buffer) -> BufferSlice<'a> {
        self.slots.as_ref().unwrap_or(none).whole()
    }

    /// The entries of the slots by power, within a page, whose lobes are evaluated directly.
    pub fn direct(&self, slots: &Range<u32>) -> Range<u32> {
        self.by_power.within(self.by_power.powers.len(), slots)
    }

    /// The dispatches over all triangles of a page that share matrices. Those of one triangle come in the order of the
    /// columns, whose sums add up.
    pub fn products<'a>(&'a self, plan: &Plan, page: u32, slots: &Range<u32>) -> Vec<Product<'a>> {
        let Some(forward) = &self.forward else { return Vec::new() };
        let part =
            |buffer: &'a Option<Buffer>, at| buffer.as_ref().unwrap_or(forward).slice(at, LOBE_BYTES.into());
        let parts = parts(plan);
        let mut products = Vec::new();
        for k in 0..self.by_power.powers.len() {
            let entries = self.by_power.within(k, slots);
            for first in entries.clone().step_by(MOST_TRIANGLES as usize) {
                let count = (entries.end - first).min(MOST_TRIANGLES);
                products.extend(parts.iter().map(|&(offset, push)| {
                    let at = k as u64 * plan.lobe_matrix_bytes() + offset;
                    Product {
                        push: LobePush { page, first, count, ..push },
                        forward: part(&self.forward, at),
                        transposed: part(&self.transposed, at),
                        logarithms: part(&self.logarithms, offset),
                    }
                }));
            }
        }
        products
    }
}

/// The ranges of a matrix that dispatches bind, and the byte at which each begins: some blocks of rows, or
/// some columns of one.
fn parts(plan: &Plan) -> Vec<(u64, LobePush)> {
    let (bins, blocks) = (plan.bins.count() as u32, plan.lobe_blocks());
    let fitting = (u64::from(LOBE_BYTES) / plan.lobe_block_bytes()).max(1) as u32;
    let columns = LOBE_BYTES / (LOBE_ROWS * plan.settings.precision.bytes() as u32);
    let mut parts = Vec::new();
    for block in (0..blocks).step_by(fitting as usize) {
        for begin in (0..bins).step_by(columns as usize) {
            let end = (begin + columns).min(bins);
            let (first_row, blocks) = (block * LOBE_ROWS, (blocks - block).min(fitting));
            let column_bytes = u64::from(LOBE_ROWS) * plan.settings.precision.bytes();
            let offset = u64::from(block) * plan.lobe_block_bytes() + u64::from(begin) * column_bytes;
            parts.push((offset, LobePush { first_row, blocks, begin, end, ..LobePush::zeroed() }));
        }
    }
    parts
}

/// ln⟨h(b,o),n⟩; where the cosine is zero so is every lobe, and x^p ln x counts as zero.
fn logarithm(bins: &Bins, b: usize, o: usize) -> f64 {
    let cosine = bins.half_cosine(b, o);
    if cosine > 0.0 { cosine.ln() } else { 0.0 }
}

/// Entries (b, o) of a matrix as kernels read them: by block of rows o, column b, row. Zero in the padding.
fn matrix(plan: &Plan, entry: impl Fn(usize, usize) -> f64 + Sync) -> Vec<u8> {
    let (bins, rows) = (plan.bins.count(), LOBE_ROWS as usize);
    let reals = (plan.lobe_block_bytes() / plan.settings.precision.bytes()) as usize;
    let block = |block: usize| {
        let entry = &entry;
        let row = move |b: usize, o: usize| if b < bins && o < bins { entry(b, o) } else { 0.0 };
        let values = (0..reals).map(move |at| row(at / rows, block * rows + at % rows));
        real::encode(plan.settings.precision, &values.collect::<Vec<_>>())
    };
    let blocks: Vec<Vec<u8>> = parallel::map(0..plan.lobe_blocks() as usize, block);
    blocks.concat()
}
