//! Transport as a sparse matrix, whose weights depend on geometry alone: that of close pairs, kept instead of being
//! evaluated in each pass, or all of it by rays.

mod blocks;
mod rows;
mod sliced;

pub(crate) use blocks::Blocks;
pub use blocks::{IncidentPart, OutgoingPart};
pub(crate) use rows::{Geometry, Row, Rows, Sums};
pub use sliced::{Block, NO_ROW, SLICE, SlicedMatrix, Weights};

use super::{MemoryPlan, NearPairs, Plan, PlanError, PlanOptions, PlannedTransport, Residency};
use crate::model::{Class, PADDING};
use antirad_scene::{BackendKind, Precision};
use std::fmt;
use std::sync::Arc;

/// Bytes of the matrix by array; twice where gradients are planned, which need its transpose.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct NearMatrixBytes {
    pub starts: u64,
    pub rows: u64,
    pub columns: u64,
    pub weights: u64,
}

/// Whether the near field is kept, and why not.
#[derive(Clone, Debug)]
pub enum NearField {
    /// Evaluated in each pass.
    Evaluated {
        /// Why it is not kept.
        why: &'static str,
    },
    /// Rows by rays, which are traced when an engine is made.
    Traced {
        /// Rays at most.
        rays: u64,
        /// Weights at most, about.
        entries: u64,
    },
    /// Kept as a matrix.
    Kept(NearMatrix),
}

impl Default for NearField {
    fn default() -> Self {
        Self::Evaluated { why: "not asked for" }
    }
}

/// The near field as a matrix on incident and outgoing light.
#[derive(Clone, Debug)]
pub struct NearMatrix {
    /// The matrix from outgoing to incident light.
    pub forward: Arc<SlicedMatrix>,
    /// The matrix from the cotangent of incident light to that of outgoing light; with gradients.
    pub transposed: Option<Arc<SlicedMatrix>>,
    /// Whether that is without the block from diffuse radiance to irradiance, whose transpose is applied from the forward matrix.
    pub scatters: bool,
    /// Number of weights, without those that fill up slices.
    pub weights: u64,
}

impl NearMatrix {
    /// The matrices that exist.
    pub fn matrices(&self) -> impl Iterator<Item = &SlicedMatrix> {
        [Some(&self.forward), self.transposed.as_ref()].into_iter().flatten().map(Arc::as_ref)
    }
}

impl fmt::Display for NearField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Evaluated { why } => write!(f, "evaluated in each pass: {why}"),
            Self::Traced { rays, .. } => write!(f, "at most {rays} rays"),
            Self::Kept(NearMatrix { forward, transposed, scatters, weights }) => {
                let transposed = if transposed.is_some() && !scatters { ", and its transpose" } else { "" };
                write!(
                    f,
                    "kept as a matrix of {weights} weights in {} blocks{transposed}",
                    forward.blocks.len()
                )
            }
        }
    }
}

const FAST: &str = "kernels are faster at that than the matrix is made";
const NO_ROOM: &str = "its matrix does not fit the memory budget";
const TOO_LARGE: &str = "its matrix is larger than a buffer may be";
/// Receivers whose rows are evaluated to estimate the size of the whole matrix.
const SAMPLE: usize = 64;
/// Most receivers that are evaluated without such an estimate, as a multiple of [`SAMPLE`].
const FEW: usize = 16;
/// Smallest fraction of its estimated size that the whole matrix may take.
const LEAST: f64 = 0.5;
/// What slices of rows by rays are filled up with, as a factor.
const FILLED: f64 = 1.1;
/// Most weights: kernels index them by 32 bits.
const MOST_WEIGHTS: u64 = 1 << 30;

/// Some of many receivers, by which the size of the whole matrix is estimated.
fn sampled(own: &[u32]) -> Option<Vec<u32>> {
    let step = own.len().div_ceil(SAMPLE);
    (own.len() > FEW * SAMPLE).then(|| own.iter().copied().step_by(step).collect())
}

impl Plan {
    /// Decides whether the near field is kept, and evaluates it if so. Everything else has been planned.
    ///
    /// # Errors
    /// Fails if light goes by rays and their matrix does not fit.
    pub(super) fn choose_near_field(&mut self) -> Result<(), PlanError> {
        if self.transport.is_explicit() {
            self.expect_rays();
            return self.check_near_matrix();
        }
        let evaluated = |why| NearField::Evaluated { why };
        self.near_field = self.near_matrix().map_or_else(evaluated, NearField::Kept);
        let memory = MemoryPlan::of(self, self.options.rank);
        if memory.total() > self.options.memory_budget {
            self.near_field = evaluated(NO_ROOM);
        } else if memory.check_buffers(self.options.max_buffer).is_err() {
            self.near_field = evaluated(TOO_LARGE);
        } else {
            self.memory = memory;
        }
        Ok(())
    }

    /// Estimates the matrix of the rays that all light goes by, which an engine traces, if it does.
    pub(super) fn expect_rays(&mut self) {
        let PlannedTransport::Rays { rays, .. } = self.transport else { return };
        let (triangles, own) = (self.triangles() as u64, self.own_triangles());
        let sources = self.share_of(|class| class.glossy);
        let receivers = self.share_of(|class| class.has_bins());
        // Directions have bilinear weights.
        let of_a_ray = (1.0 + 4.0 * sources) * (1.0 + 4.0 * receivers);
        let entries = own as f64 * (f64::from(rays) * of_a_ray).min(triangles as f64 * of_a_ray);
        self.near_field =
            NearField::Traced { rays: own * u64::from(rays), entries: (FILLED * entries) as u64 };
    }

    /// Triangles that this rank computes.
    fn own_triangles(&self) -> u64 {
        let own = |&slot: &u32| self.layout.order[slot as usize] != PADDING && self.owns(slot);
        (0..self.layout.slots()).filter(own).count() as u64
    }

    /// Share of the area of triangles of some classes.
    fn share_of(&self, has: impl Fn(&Class) -> bool) -> f64 {
        let area = |has: &dyn Fn(&Class) -> bool| -> f64 {
            let of = self.facets.iter().zip(&self.classes).filter(|(_, class)| has(class));
            of.map(|(facet, _)| facet.area).sum()
        };
        area(&has) / area(&|_| true).max(f64::MIN_POSITIVE)
    }

    /// Keeps the rows that an engine has traced.
    ///
    /// # Errors
    /// Fails if they do not fit.
    pub(crate) fn keep_rows(&mut self, matrix: NearMatrix) -> Result<(), PlanError> {
        self.near_field = NearField::Kept(matrix);
        self.check_near_matrix()
    }

    fn check_near_matrix(&mut self) -> Result<(), PlanError> {
        self.memory = MemoryPlan::of(self, self.options.rank);
        self.memory.check_buffers(self.options.max_buffer)?;
        let (budget, needed) = (self.options.memory_budget, self.memory.total());
        if needed > budget { Err(PlanError::TooManyRays { budget, needed }) } else { Ok(()) }
    }

    fn near_matrix(&self) -> Result<NearMatrix, &'static str> {
        let near = &self.interactions.by_receiver.near;
        if !self.options.keeps_near_field() {
            return Err(if self.options.keep_near_field { FAST } else { "not asked for" });
        }
        if self.residency != Residency::Device {
            return Err("the solver's vectors do not fit the memory budget");
        }
        if near.partners.is_empty() {
            return Err("no close pairs");
        }
        let free = self.options.memory_budget.saturating_sub(self.memory.total());
        let blocks = self.blocks();
        let geometry = self.matrix_geometry();
        let own: Vec<u32> = with_close_sources(near).filter(|&slot| self.owns(slot)).collect();
        if own.is_empty() {
            return Err("no close pairs");
        }
        // Not computed in vain where it is far too large.
        if let Some(sample) = sampled(&own) {
            let [weights, bytes] =
                self.estimate(&Rows::of(&geometry, &blocks, near, &sample), near, &own, &sample);
            if LEAST * bytes > free as f64 {
                return Err(NO_ROOM);
            }
            let largest = LEAST * weights * self.settings.precision.bytes() as f64;
            if weights > MOST_WEIGHTS as f64 || largest > self.options.max_buffer as f64 {
                return Err(TOO_LARGE);
            }
        }
        let rows = Rows::of(&geometry, &blocks, near, &own);
        if rows.weights.is_empty() {
            return Err("no light between close triangles");
        }
        Ok(self.matrix(&blocks, &rows, || {
            // The rows of own sources are columns of what their receivers, of any rank, receive.
            let lit = |&slot: &u32| {
                near.of(slot, &(0..self.layout.slots())).iter().any(|&source| self.owns(source))
            };
            let lit: Vec<u32> = with_close_sources(near).filter(lit).collect();
            Rows::of(&geometry, &blocks, near, &lit)
        }))
    }

    /// Numbers of blocks, rows and columns.
    pub(crate) fn blocks(&self) -> Blocks {
        Blocks::new(&self.layout, self.bins.count())
    }

    pub(crate) fn matrix_geometry(&self) -> Geometry<'_> {
        let [coincident, pole] = rounding(self.settings.precision);
        Geometry {
            layout: &self.layout,
            facets: &self.facets,
            classes: &self.classes,
            bins: &self.bins,
            half_range: 0.5 * self.settings.near_field,
            coincident,
            pole,
        }
    }

    /// The matrix of the rows of own receivers, with gradients also the transposed one. `lit`: the rows of all that own
    /// sources send light to, where there are several ranks.
    fn matrix(&self, blocks: &Blocks, rows: &Rows, lit: impl FnOnce() -> Rows) -> NearMatrix {
        let precision = self.settings.precision;
        let per_bin = |row: &Row| self.per_bin(row.index);
        let before = |group: usize| self.before(group);
        let forward =
            SlicedMatrix::new(rows, blocks, precision, |row| self.factor_of(blocks, row)).moved(|block| {
                match block.incident {
                    IncidentPart::Irradiance => 0,
                    IncidentPart::Bins { group } => before(group),
                }
            });
        let transposed = self.options.gradients.any().then(|| {
            let turned = match self.options.ranks {
                1 => rows.transposed(),
                _ => {
                    let mut turned = lit().transposed();
                    turned.rows.retain(|row| self.owns(blocks.source(blocks.parts(row.block).1, row.index)));
                    turned
                }
            };
            let turned = SlicedMatrix::new(&turned, blocks, precision, |row| match blocks.parts(row.block) {
                (_, OutgoingPart::Diffuse | OutgoingPart::Specular { .. }) => 1.0,
                (_, OutgoingPart::Antiradiance { .. }) => per_bin(row),
            });
            Arc::new(turned.moved(|block| match block.outgoing {
                OutgoingPart::Diffuse => 0,
                OutgoingPart::Antiradiance { group } | OutgoingPart::Specular { group } => before(group),
            }))
        });
        let weights = rows.weights.len() as u64;
        NearMatrix { forward: Arc::new(forward), transposed, scatters: false, weights }
    }

    /// What light of a bin counts there: bins of a state hold H(b) / c_b.
    fn per_bin(&self, row: u32) -> f64 {
        1.0 / self.bins.projected[row as usize % self.bins.count()]
    }

    /// What weights of a row count in a state.
    pub(crate) fn factor_of(&self, blocks: &Blocks, row: &Row) -> f64 {
        match blocks.parts(row.block).0 {
            IncidentPart::Irradiance => 1.0,
            IncidentPart::Bins { .. } => self.per_bin(row.index),
        }
    }

    /// Bins of a group before those that this rank holds.
    fn before(&self, group: usize) -> u32 {
        let [all, own] = [&self.layout.groups[group], &self.own(group)]
            .map(|group| self.layout.slots_of(&group.tiles).start);
        (own - all) * self.bins.count() as u32
    }

    /// A row as this rank holds it.
    pub(crate) fn held_row(&self, blocks: &Blocks, row: &Row) -> u32 {
        match blocks.parts(row.block).0 {
            IncidentPart::Irradiance => row.index,
            IncidentPart::Bins { group } => row.index - self.before(group),
        }
    }

    /// The matrix of rows by rays, with gradients with what of its transpose is not read from itself. `all`: the rows of all receivers,
    /// where there are several ranks.
    pub(crate) fn with_transpose(
        &self,
        blocks: &Blocks,
        forward: SlicedMatrix,
        all: Option<&SlicedMatrix>,
    ) -> NearMatrix {
        let PlanOptions { gradients, backend, ranks, .. } = self.options;
        // Almost all is diffuse.
        let scatters = gradients.any() && backend == BackendKind::Cpu && ranks == 1;
        let transposed = gradients.any().then(|| {
            let wanted = |block: &Block| !(scatters && block.is_diffuse());
            let factor = |block: &Block, row: u32| match block.incident {
                IncidentPart::Irradiance => 1.0,
                IncidentPart::Bins { .. } => 1.0 / self.per_bin(row),
            };
            let own = |block: &Block, column: u32| self.owns(blocks.source(block.outgoing, column));
            let turned = all.unwrap_or(&forward).transposed(wanted, factor, own);
            Arc::new(turned.moved(|block| match block.outgoing {
                OutgoingPart::Diffuse => 0,
                OutgoingPart::Antiradiance { group } | OutgoingPart::Specular { group } => self.before(group),
            }))
        });
        let weights = forward.weights.count();
        NearMatrix { forward: Arc::new(forward), transposed, scatters, weights }
    }

    /// Weights and bytes of the whole matrix for own receivers, from the rows of some of them.
    fn estimate(&self, rows: &Rows, near: &NearPairs, own: &[u32], sample: &[u32]) -> [f64; 2] {
        let pairs = |slot: &u32| u64::from(near.offsets[*slot as usize + 1] - near.offsets[*slot as usize]);
        let of = |slots: &[u32]| slots.iter().map(pairs).sum::<u64>();
        let share = of(own) as f64 / of(sample).max(1) as f64;
        let (weight, word) = (self.settings.precision.bytes() as f64, size_of::<u32>() as f64);
        let bytes = rows.weights.len() as f64 * (word + weight) + rows.rows.len() as f64 * word;
        let matrices = if self.options.gradients.any() { 2.0 } else { 1.0 };
        [share * rows.weights.len() as f64, matrices * share * bytes]
    }

    /// Bytes of one matrix on the device.
    pub(super) fn near_matrix_bytes(&self, matrix: &SlicedMatrix) -> NearMatrixBytes {
        NearMatrixBytes {
            starts: size_of_val(&matrix.starts[..]) as u64,
            rows: size_of_val(&matrix.rows[..]) as u64,
            columns: size_of_val(&matrix.columns[..]) as u64,
            weights: matrix.weights.bytes(),
        }
    }

    /// The near field as a matrix, if it is kept.
    #[doc(hidden)]
    pub fn near_field_matrix(&self) -> Option<&NearMatrix> {
        match &self.near_field {
            NearField::Kept(matrix) => Some(matrix),
            NearField::Evaluated { .. } | NearField::Traced { .. } => None,
        }
    }
}

/// Slots with close partners.
fn with_close_sources(near: &NearPairs) -> impl Iterator<Item = u32> {
    (0..).zip(near.offsets.windows(2)).filter(|(_, run)| run[0] < run[1]).map(|(slot, _)| slot)
}

/// `COINCIDENT` of crates/core/glsl/pieces.glsl and `POLE` of crates/core/glsl/bins.glsl.
fn rounding(precision: Precision) -> [f64; 2] {
    match precision {
        Precision::F32 => [1e-12, 1e-5],
        Precision::F64 => [1e-24, 1e-12],
    }
}
