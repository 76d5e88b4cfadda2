//! Transport by rays: the rows of receivers from the fronts that they see, traced when an engine is made.
//!
//! Rays leave all over the front of a receiver, as many in each direction as its cosine asks for. Each of N rays that meets a front
//! brings π/N of its radiance; what meets a back, or nothing, is dark. So all that a receiver receives adds up to π of radiance at most,
//! and every bounce of light is weaker than the one before, however dense blockers are.
//!
//! A few rays of all triangles tell roughly what light there is, and how much of it varies from ray to ray. More follow where that leaves
//! an error (`allocation`), continuing their sequences, until the mean error of irradiance is as wanted. So rows depend on the light for which
//! they are traced, and stay as they are when materials change.

mod allocation;
mod assembly;
mod bright;
mod chunk;
mod seen;

use crate::plan::{Blocks, NearMatrix, PADDING, Plan, Row, SlicedMatrix};
use crate::transport::complete_slots;
use allocation::{FEWEST, Known, mean_errors, mean_irradiance};
use antirad_base::parallel;
use antirad_base::ranks::{RankError, Ranks};
use antirad_scene::Rays;
use bright::Bright;
use chunk::{Brought, Chunk, RECEIVERS};
use seen::Seen;
use std::f64::consts::PI;

/// Looks at the light by the rays so far at most.
const LOOKS: u32 = 8;
/// Bounces of light between two looks; the light of earlier ones is kept.
const BOUNCES: u32 = 4;
/// Neighbours in the order of slots, on both sides, whose deviations tell what few rays of a triangle may have missed.
const BESIDE: usize = 4;

/// Share of the square of an error that twice as many rays leave at least, as far as it is believed.
const LEAST_LEFT: f64 = 0.3;

/// The light for which rows are traced, by triangle, as the mean of its channels.
pub struct Light {
    /// Radiance that leaves a triangle for others, but for what it reflects of them.
    pub emitted: Vec<f64>,
    /// Share of irradiance that it reflects.
    pub albedo: Vec<f64>,
    /// Irradiance straight from lamps.
    pub direct: Vec<f64>,
}

/// Standard error of irradiance that rays between triangles leave: that of the light for which an engine was made.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
pub struct RayError {
    /// Rays of all triangles, and the number of these.
    pub rays: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Mean over the area, relative to mean irradiance.
    pub mean: f64,
    /// Mean over the area, relative to irradiance there.
    pub of_places: f64,
    /// Median over the area, relative to mean irradiance.
    pub median: f64,
    /// Mean over the tenth of the area where it is largest, relative to mean irradiance.
    pub worst_tenth: f64,
    /// Of the irradiance of each triangle, as the mean of channels, W/m².
    #[serde(skip)]
    pub of_triangles: Vec<f64>,
}

impl RayError {
    /// Rays of a triangle, on average.
    pub fn of_each(&self) -> u32 {
        (self.rays / self.triangles.max(1)) as u32
    }
}

/// Rows of what this rank computes, and what is known of all receivers.
struct Traced<'a> {
    ranks: &'a Ranks,
    plan: &'a Plan,
    light: &'a Light,
    chunks: Vec<Chunk>,
    /// By slot: radiance; rays, and the numbers of what they bring ([`Brought`]).
    radiance: Vec<f64>,
    brought: Vec<[f64; 7]>,
}

/// Traces rows until the error is as planned. All ranks call it.
///
/// # Errors
/// Fails if another rank has ended, or does not run the same program.
pub fn trace(
    ranks: &Ranks,
    plan: &Plan,
    rays: &Rays,
    light: &Light,
) -> Result<(NearMatrix, RayError), RankError> {
    let blocks = plan.blocks();
    let geometry = plan.matrix_geometry();
    let mut seen = Seen::new(&geometry, &blocks, rays, &plan.openness);
    let mut traced = Traced::new(ranks, plan, light);
    let mut wanted = vec![FEWEST; plan.layout.slots() as usize];
    let most = u64::from(plan.transport.rays().unwrap_or(FEWEST)) * plan.triangles() as u64;
    traced.extend(&seen, &wanted);
    traced.look()?;
    seen.bright = Bright::new(plan, &traced.radiance);
    if seen.bright.is_some() {
        // Other rays than those so far.
        traced.begin();
        traced.extend(&seen, &wanted);
        traced.look()?;
    }
    for _ in 0..LOOKS {
        let known = traced.known();
        let more = allocation::rays(&known, plan.transport.error(), most);
        let is_enough = known.iter().zip(&more).all(|(known, &more)| more <= known.rays);
        if is_enough {
            break;
        }
        wanted = more;
        traced.extend(&seen, &wanted);
        traced.look()?;
    }
    let error = traced.error();
    let rays_of = |slot: u32| traced.brought[slot as usize][0] as u32;
    let others = plan.options.gradients.any() && plan.options.ranks > 1;
    let all = others.then(|| {
        // The rows of own sources are columns of what their receivers, of any rank, receive.
        let slots: Vec<u32> =
            (0..plan.layout.slots()).filter(|&s| plan.layout.order[s as usize] != PADDING).collect();
        matrix_of(plan, &blocks, extended(chunks(&slots), &seen, rays_of, &traced.radiance), false)
    });
    let forward = matrix_of(plan, &blocks, std::mem::take(&mut traced.chunks), true);
    Ok((plan.with_transpose(&blocks, forward, all.as_ref()), error))
}

/// The matrix of some rows; `moved`: with the rows of bins as this rank holds them.
fn matrix_of(plan: &Plan, blocks: &Blocks, chunks: Vec<Chunk>, moved: bool) -> SlicedMatrix {
    let scale = |row: &Row| plan.factor_of(blocks, row);
    let index = |row: &Row| if moved { plan.held_row(blocks, row) } else { row.index };
    assembly::matrix(chunks, blocks, plan.settings.precision, scale, index)
}

fn chunks(slots: &[u32]) -> Vec<Chunk> {
    slots.chunks(RECEIVERS).map(Chunk::new).collect()
}

fn extended(
    chunks: Vec<Chunk>,
    seen: &Seen,
    wanted: impl Fn(u32) -> u32 + Sync,
    radiance: &[f64],
) -> Vec<Chunk> {
    parallel::map(chunks, |chunk| chunk.extended(seen, &wanted, radiance))
}

impl<'a> Traced<'a> {
    fn new(ranks: &'a Ranks, plan: &'a Plan, light: &'a Light) -> Self {
        let brought = vec![[0.0; 7]; plan.layout.slots() as usize];
        let mut traced = Self { ranks, plan, light, chunks: Vec::new(), radiance: Vec::new(), brought };
        traced.begin();
        traced.radiance = traced.reflected();
        traced
    }

    /// Forgets all rays.
    fn begin(&mut self) {
        let own = |&slot: &u32| self.plan.layout.order[slot as usize] != PADDING && self.plan.owns(slot);
        let own: Vec<u32> = (0..self.plan.layout.slots()).filter(own).collect();
        self.chunks = chunks(&own);
    }

    fn extend(&mut self, seen: &Seen, wanted: &[u32]) {
        let chunks = std::mem::take(&mut self.chunks);
        self.chunks = extended(chunks, seen, |slot| wanted[slot as usize], &self.radiance);
    }

    /// Finds the light by the rows of now.
    fn look(&mut self) -> Result<(), RankError> {
        for _ in 0..BOUNCES {
            let of_chunk = |chunk: &Chunk| -> Vec<(u32, [f64; 7])> {
                let brought = chunk.brought(&self.radiance);
                let values = |(receiver, brought): (&chunk::Receiver, Brought)| {
                    let Brought { irradiance, variance, effective, last, halves, quarters } = brought;
                    let rays = f64::from(receiver.rays);
                    (receiver.slot, [rays, irradiance, variance, effective, last, halves, quarters])
                };
                brought.map(values).collect()
            };
            for (slot, values) in parallel::map(&self.chunks, of_chunk).into_iter().flatten() {
                self.brought[slot as usize] = values;
            }
            complete_slots(self.ranks, self.plan, &mut self.brought, 1)?;
            self.radiance = self.reflected();
        }
        Ok(())
    }

    /// The radiance of slots.
    fn reflected(&self) -> Vec<f64> {
        let Light { emitted, albedo, .. } = self.light;
        let of_slot = |(&triangle, &[_, irradiance, ..]): (&u32, &[f64; 7])| match triangle {
            PADDING => 0.0,
            i => emitted[i as usize] + albedo[i as usize] / PI * irradiance,
        };
        self.plan.layout.order.iter().zip(&self.brought).map(of_slot).collect()
    }

    /// What is known of the receivers of all slots.
    fn known(&self) -> Vec<Known> {
        let order = &self.plan.layout.order;
        let deviations: Vec<f64> = self.brought.iter().map(|of| of[2].sqrt()).collect();
        let deviation = |slot: usize| {
            let beside = slot.saturating_sub(BESIDE)..(slot + BESIDE + 1).min(order.len());
            // The median: small triangles at lamps see a hundred times as much vary.
            let mut beside: Vec<f64> =
                beside.filter(|&k| order[k] != PADDING).map(|k| deviations[k]).collect();
            beside.sort_unstable_by(f64::total_cmp);
            let usual = beside.get(beside.len() / 2).copied().unwrap_or_default();
            let missed = (usual - deviations[slot]).max(0.0);
            deviations[slot] + missed * f64::from(FEWEST) / self.brought[slot][0].max(f64::from(FEWEST))
        };
        let gain = self.gain();
        (0..order.len()).map(|slot| self.of_slot(slot, deviation(slot), gain)).collect()
    }

    /// How much less than random rays those of Sobol' err, as a factor, and the power of their number by which that falls.
    ///
    /// The mean of a sequence is that of its halves, and theirs are those of its quarters. With errors that fall by the same factor r of
    /// the square from each to the next, differences of halves have r of the square of those of quarters, and the mean an error of r / (1 - r)
    /// of the square of the former. Rows tell little of it one by one, but well together.
    fn gain(&self) -> [f64; 2] {
        let [mut random, mut of_halves, mut of_quarters] = [0.0; 3];
        for (&triangle, of) in self.plan.layout.order.iter().zip(&self.brought) {
            let &[_, _, variance, _, last, halves, quarters] = of;
            if triangle != PADDING && variance > 0.0 && last > 0.0 {
                let error = (variance / last).sqrt();
                let area = self.plan.facets[triangle as usize].area;
                random += area * error;
                of_halves += area * halves / error;
                of_quarters += area * quarters / error;
            }
        }
        if random <= 0.0 || of_quarters <= 0.0 {
            return [1.0, 0.5];
        }
        let falls = (of_halves / of_quarters).clamp(LEAST_LEFT, 0.5);
        [(of_halves / random * falls / (1.0 - falls)).sqrt(), -0.5 * falls.log2()]
    }

    /// What is known of the receiver of a slot, with what a ray brings deviating so much.
    fn of_slot(&self, slot: usize, deviation: f64, [gain, falls]: [f64; 2]) -> Known {
        let [rays, irradiance, _, effective, ..] = self.brought[slot];
        let triangle = self.plan.layout.order[slot];
        if triangle == PADDING || rays == 0.0 {
            return Known::default();
        }
        Known {
            // That which receives so much.
            area: self.plan.openness.share(triangle as usize) * self.plan.facets[triangle as usize].area,
            irradiance: irradiance + self.light.direct[triangle as usize],
            error: gain * deviation / (effective * rays).sqrt(),
            rays: rays as u32,
            falls,
        }
    }

    fn error(&self) -> RayError {
        let gain = self.gain();
        let own = |slot: usize| self.of_slot(slot, self.brought[slot][2].sqrt(), gain);
        let known: Vec<Known> = (0..self.brought.len()).map(own).filter(|known| known.area > 0.0).collect();
        let area: f64 = known.iter().map(|of| of.area).sum();
        let mean = mean_irradiance(&known);
        let [of_all, of_places] = mean_errors(&known, |i| f64::from(known[i].rays));
        let mut sorted: Vec<[f64; 2]> = known.iter().map(|of| [of.error, of.area]).collect();
        sorted.sort_unstable_by(|a, b| b[0].total_cmp(&a[0]));
        // The error where so much of the area has a larger one, and the mean over that.
        let beyond = |share: f64| {
            let (mut left, mut sum) = (share * area, 0.0);
            for &[error, of_area] in &sorted {
                sum += error * of_area.min(left);
                left -= of_area;
                if left <= 0.0 {
                    return [error, sum / (share * area)];
                }
            }
            [0.0; 2]
        };
        let relative = |error: f64| if mean > 0.0 { error / mean } else { 0.0 };
        let mut of_triangles = vec![0.0; self.plan.facets.len()];
        for (slot, &triangle) in self.plan.layout.order.iter().enumerate().filter(|(_, i)| **i != PADDING) {
            let i = triangle as usize;
            of_triangles[i] = self.plan.openness.share(i) * own(slot).error;
        }
        RayError {
            rays: known.iter().map(|of| u64::from(of.rays)).sum(),
            triangles: known.len() as u64,
            mean: of_all,
            of_places,
            median: relative(beyond(0.5)[0]),
            worst_tenth: relative(beyond(0.1)[1]),
            of_triangles,
        }
    }
}
