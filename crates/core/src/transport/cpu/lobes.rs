//! Specular lobes ⟨h(b,o),n⟩^p between bins, of triangles that share a power as products of matrices. Twin of crates/core/glsl/reflect_lobes.comp,
//! reflect_glossy.comp, their adjoints and derivatives.

use super::real::Real;
use crate::backend::{Cpu, Lease};
use crate::plan::{LobeSlots, Plan};
use crate::transport::scene_values::{SPECULAR, SURFACE};
use antirad_base::parallel;
use antirad_base::usage::OverBudget;
use antirad_scene::Scene;
use nalgebra::DMatrix;
use std::ops::Range;

/// Triangles whose bins are multiplied at once: enough for the speed of large matrices, few enough to be cached.
const TOGETHER: usize = 16;
/// Batches of [`TOGETHER`] triangles whose results are held at a time.
const PARTS: usize = 64;
/// The power in a `Surface` of crates/core/glsl/surface.glsl.
const POWER: usize = 3;

/// Lobes of all powers.
pub struct Lobes<T> {
    /// ⟨h(b,o),n⟩^p of each power that many triangles share, by row o and column b, which are symmetric.
    matrices: Vec<DMatrix<T>>,
    /// ln⟨h(b,o),n⟩, where something is glossy.
    logarithms: DMatrix<T>,
    /// c_b.
    projected: Vec<T>,
    channels: usize,
    by_power: LobeSlots,
    _leases: Vec<Lease>,
}

/// Which product with a lobe.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// K: to(o) = σ N Σ_b lobe(b, o) c_b from(b).
    Forward,
    /// Kᵀ: to(b) += σ N Σ_o lobe(b, o) from(o).
    Transposed,
}

impl<T: Real> Lobes<T> {
    pub fn new(cpu: &Cpu, scene: &Scene, plan: &Plan) -> Result<Self, OverBudget> {
        let glossy = plan.glossy_groups().next().is_some();
        let bins = if glossy { plan.bins.count() } else { 0 };
        let mut leases = Vec::new();
        if plan.lobes.matrices > 0 {
            leases
                .push(cpu.lease("lobe matrices", u64::from(plan.lobes.matrices) * plan.lobe_square_bytes())?);
        }
        if glossy {
            leases.push(cpu.lease("lobe logarithms", plan.lobe_square_bytes())?);
        }
        let mut lobes = Self {
            matrices: Vec::new(),
            logarithms: DMatrix::from_fn(bins, bins, |o, b| T::of(logarithm(plan.bins.half_cosine(b, o)))),
            projected: plan.bins.projected.iter().map(|&c| T::of(c)).collect(),
            channels: plan.channels as usize,
            by_power: LobeSlots::default(),
            _leases: leases,
        };
        lobes.set(scene, plan);
        Ok(lobes)
    }

    /// Computes the matrices for the materials of a scene. Powers beyond those planned have none.
    pub fn set(&mut self, scene: &Scene, plan: &Plan) {
        if self.logarithms.is_empty() {
            return;
        }
        let known = std::mem::replace(&mut self.by_power, plan.lobe_slots(scene)).powers;
        let mut old: Vec<_> = known.into_iter().zip(std::mem::take(&mut self.matrices)).collect();
        let bins = &plan.bins;
        for &power in &self.by_power.powers {
            let kept = old.iter().position(|(known, _)| *known == power);
            let new = || {
                DMatrix::from_fn(bins.count(), bins.count(), |o, b| T::of(bins.half_cosine(b, o).powf(power)))
            };
            self.matrices.push(kept.map_or_else(new, |at| old.swap_remove(at).1));
        }
    }

    /// The product with the lobe of each glossy triangle among `slots`, of pages that begin with `page`.
    pub fn multiply(
        &self,
        side: Side,
        surfaces: &[T],
        (slots, page): (&Range<u32>, u32),
        from: &[T],
        to: &mut [T],
    ) {
        for (k, matrix) in self.matrices.iter().enumerate() {
            let parts: Vec<&[u32]> = self.slots(k, slots).chunks(TOGETHER).collect();
            for parts in parts.chunks(PARTS) {
                let products = parallel::map(parts, |slots| matrix * self.columns(side, slots, page, from));
                for (slots, product) in parts.iter().zip(products) {
                    let columns = product.as_slice().chunks_exact(self.projected.len() * self.channels);
                    for (&slot, values) in slots.iter().zip(columns) {
                        self.store(side, surfaces, slot, values, self.page(to, slot, page));
                    }
                }
            }
        }
        let own = self.slots(self.matrices.len(), slots);
        for slots in own.chunks(PARTS * TOGETHER) {
            let product = |&slot: &u32| {
                let column = self.columns(side, &[slot], page, from);
                self.lobe_of(surfaces, slot).map(|lobe| lobe * column)
            };
            let products = parallel::map(slots, product);
            for (&slot, product) in slots.iter().zip(products) {
                let zero = || DMatrix::zeros(self.projected.len(), self.channels);
                let product = product.unwrap_or_else(zero);
                self.store(side, surfaces, slot, product.as_slice(), self.page(to, slot, page));
            }
        }
    }

    /// Per glossy triangle among `slots` and per channel, Σ_ob μ(o) lobe(b, o) c_b A(b), and the same sum
    /// with the factor ln⟨h,n⟩.
    pub fn derivatives(
        &self,
        surfaces: &[T],
        (slots, page): (&Range<u32>, u32),
        incident: &[T],
        cotangent: &[T],
    ) -> Vec<(u32, [[T; 3]; 2])> {
        let of = |k: usize| self.slots(k, slots).iter().map(move |&slot| (k, slot));
        let all: Vec<(usize, u32)> = (0..=self.matrices.len()).flat_map(of).collect();
        let sums = |&(k, slot): &(usize, u32)| {
            let own = if k < self.matrices.len() { None } else { self.lobe_of(surfaces, slot) };
            let lobe = self.matrices.get(k).or(own.as_ref());
            (slot, lobe.map_or([[T::ZERO; 3]; 2], |lobe| self.sums(lobe, slot, page, incident, cotangent)))
        };
        parallel::map(&all, sums)
    }

    fn sums(&self, lobe: &DMatrix<T>, slot: u32, page: u32, incident: &[T], cotangent: &[T]) -> [[T; 3]; 2] {
        let [incident, cotangent] = [incident, cotangent].map(|of| self.page_of(of, slot, page));
        let channel = |c: usize| c.min(self.channels - 1);
        let mut sums = [[T::ZERO; 3]; 2];
        for (b, &projected) in self.projected.iter().enumerate() {
            let mut spread = [[T::ZERO; 3]; 2];
            let columns = lobe.column(b).into_iter().zip(self.logarithms.column(b));
            for (o, (&lobe, &logarithm)) in columns.enumerate() {
                for c in 0..3 {
                    let value = lobe * cotangent[o * self.channels + channel(c)];
                    spread[0][c] += value;
                    spread[1][c] += logarithm * value;
                }
            }
            for (sum, spread) in sums.iter_mut().zip(spread) {
                for c in 0..3 {
                    sum[c] += projected * spread[c] * incident[b * self.channels + channel(c)];
                }
            }
        }
        sums
    }

    /// The slots of one power within a range; those of all powers without a matrix last.
    fn slots(&self, k: usize, slots: &Range<u32>) -> &[u32] {
        if self.by_power.ranges.is_empty() {
            return &[];
        }
        let entries = self.by_power.within(k, slots);
        &self.by_power.slots[entries.start as usize..entries.end as usize]
    }

    fn first(&self, slot: u32, page: u32) -> usize {
        (slot - page) as usize * self.projected.len() * self.channels
    }

    fn page_of<'a>(&self, of: &'a [T], slot: u32, page: u32) -> &'a [T] {
        &of[self.first(slot, page)..][..self.projected.len() * self.channels]
    }

    fn page<'a>(&self, of: &'a mut [T], slot: u32, page: u32) -> &'a mut [T] {
        &mut of[self.first(slot, page)..][..self.projected.len() * self.channels]
    }

    /// What some triangles give to a product: a column for each channel of each.
    fn columns(&self, side: Side, slots: &[u32], page: u32, from: &[T]) -> DMatrix<T> {
        DMatrix::from_fn(self.projected.len(), slots.len() * self.channels, |bin, column| {
            let value = self.page_of(from, slots[column / self.channels], page)
                [bin * self.channels + column % self.channels];
            if side == Side::Forward { self.projected[bin] * value } else { value }
        })
    }

    fn store(&self, side: Side, surfaces: &[T], slot: u32, values: &[T], to: &mut [T]) {
        let scale = &surfaces[slot as usize * SURFACE + SPECULAR..][..self.channels];
        for (channel, (values, &scale)) in values.chunks_exact(self.projected.len()).zip(scale).enumerate() {
            for (to, &value) in to[channel..].iter_mut().step_by(self.channels).zip(values) {
                *to = if side == Side::Transposed { *to + scale * value } else { scale * value };
            }
        }
    }

    /// The lobe of one triangle; `None` where it is black.
    fn lobe_of(&self, surfaces: &[T], slot: u32) -> Option<DMatrix<T>> {
        let surface = &surfaces[slot as usize * SURFACE..][..SURFACE];
        let power = surface[POWER];
        let black = surface[SPECULAR..SPECULAR + 3].iter().all(|s| *s == T::ZERO);
        let lobe = |logarithm: T| if power > T::ZERO { (power * logarithm).exponential() } else { T::ONE };
        (!black).then(|| self.logarithms.map(lobe))
    }
}

/// The logarithm of a cosine. For zero, of which every lobe is zero, that of the smallest cosine that kernels
/// distinguish from it.
fn logarithm(cosine: f64) -> f64 {
    cosine.max(1e-20).ln()
}
