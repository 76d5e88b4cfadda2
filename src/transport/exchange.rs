//! U: light from every triangle to every other. Point to point by tiles, and over pieces for close pairs.

use super::pace::Pace;
use super::state::State;
use super::watch::{TransportError, Watch};
use super::{Context, WORKGROUP, bin_constants};
use crate::gpu::{BufferSlice, Device, GpuError, Pipeline};
use crate::plan::{Group, PAIR_BACK, PAIR_FRONT, PAIR_NEAR, Plan};
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `FarPush` of glsl/far_push.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct FarPush {
    pub receiver_tile: u32,
    pub source_begin: u32,
    pub source_end: u32,
    pub row_words: u32,
    pub half_range: f32,
    pub receiver_page: u32,
    pub source_page: u32,
    pub passing: u32,
}

/// `NearPush` of glsl/near.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct NearPush {
    pub receiver_begin: u32,
    pub receiver_end: u32,
    pub source_begin: u32,
    pub source_end: u32,
    pub half_range: f32,
    pub receiver_page: u32,
    pub source_page: u32,
    pub backs: u32,
    pub skip: u32,
    pub take: u32,
}

/// Tiles of sources per dispatch, after which sums go to memory: always the same, so that sums don't depend on how the
/// work is cut. Few enough for lavapipe, which leaves every loop of an invocation after 65535 iterations of all its loops
/// together, without a word: a tile of 64 takes at most 1 + 8 + 64 · 14 of them, even if its compiler
/// unrolls nothing.
const SOURCE_TILES: u32 = 16;
/// Close sources per receiver and dispatch, for the same reason: one takes at most 1 + 16 · (20 + 16 · 19) iterations.
const NEAR_SOURCES: u32 = 8;
/// The same where sources have no bins, and nothing is cut twice: 1 + 16 · 20 iterations.
const PLAIN_NEAR_SOURCES: u32 = 128;

/// Point-to-point pairs that a close one takes as long as: for the time left, nothing else.
const NEAR_COST: u64 = 100;

/// Kernels of one pair of classes: of the source, and whether the receiver has bins.
struct Kernels {
    source: (bool, bool),
    receiver_bins: bool,
    far: Pipeline,
    /// Workgroups of `far` per tile of receivers.
    workgroups: u32,
    near: Pipeline,
    far_pace: Pace,
    near_pace: Pace,
    /// For the profile.
    shape: String,
}

pub struct Exchange {
    lanes: u32,
    kernels: Vec<Kernels>,
}

impl Exchange {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let mut exchange =
            Self { lanes: device.info().subgroup_size.min(plan.limits.tile), kernels: Vec::new() };
        for to in &plan.layout.groups {
            for from in &plan.layout.groups {
                if exchange.find(to, from).is_none() {
                    let kernels = exchange.compile(device, plan, to, from)?;
                    exchange.kernels.push(kernels);
                }
            }
        }
        Ok(exchange)
    }

    fn find(&self, to: &Group, from: &Group) -> Option<usize> {
        let source = (from.class.blocker, from.class.glossy);
        self.kernels.iter().position(|k| k.source == source && k.receiver_bins == to.class.has_bins())
    }

    fn compile(&self, device: &Device, plan: &Plan, to: &Group, from: &Group) -> Result<Kernels, GpuError> {
        let precision = plan.accuracy.precision;
        let (blocker, glossy) = (from.class.blocker, from.class.glossy);
        let receiver_bins = to.class.has_bins();
        let mut constants =
            vec![(7, u32::from(blocker)), (8, u32::from(glossy)), (9, u32::from(receiver_bins))];
        constants.extend(bin_constants(plan));
        let tiles = [(0, self.lanes), (1, plan.limits.tile)];
        let push = size_of::<FarPush>() as u32;
        let with_bins = from.class.has_bins() || receiver_bins;
        let far = if with_bins {
            let constants = [&tiles[..], &constants].concat();
            Pipeline::new(
                device,
                shaders::TRANSPORT_BINS.of(precision),
                8,
                push,
                &constants,
                Some(self.lanes),
            )?
        } else {
            Pipeline::new(
                device,
                shaders::TRANSPORT_IRRADIANCE.of(precision),
                4,
                push,
                &tiles,
                Some(self.lanes),
            )?
        };
        let constants = [&[(0, WORKGROUP)][..], &constants].concat();
        let near = Pipeline::new(
            device,
            shaders::NEAR.of(precision),
            10,
            size_of::<NearPush>() as u32,
            &constants,
            None,
        )?;
        let source = match (blocker, glossy) {
            (false, false) => "fronts",
            (true, false) => "fronts and backs",
            (false, true) => "glossy fronts",
            (true, true) => "glossy fronts and backs",
        };
        Ok(Kernels {
            source: (blocker, glossy),
            receiver_bins,
            far,
            workgroups: if with_bins { plan.limits.tile / self.lanes } else { 1 },
            near,
            far_pace: Pace::new(if with_bins { 2e6 } else { 5e7 }),
            near_pace: Pace::new(1e5),
            shape: format!("{source} to {}", if receiver_bins { "bins" } else { "irradiance" }),
        })
    }

    /// y += U (leaving - J x); without `x` nothing leaves the backs.
    pub fn run(
        &mut self,
        context: &Context,
        x: Option<&State>,
        y: &State,
        watch: &mut Watch,
    ) -> Result<(), TransportError> {
        let Context { plan, scene, leaving, .. } = context;
        let slots = u64::from(plan.layout.slots());
        watch.begin(slots * slots + plan.near.sources.len() as u64 * NEAR_COST);
        for (t, to) in plan.layout.groups.iter().enumerate() {
            for (s, from) in plan.layout.groups.iter().enumerate() {
                let Some(k) = self.find(to, from) else { continue };
                let none = &scene.no_bins;
                let bound = Bound {
                    context,
                    irradiance: y.irradiance.whole(),
                    antiradiance: x.and_then(|x| x.bins[s].as_ref()).unwrap_or(none).whole(),
                    backs: x.is_some(),
                    specular: leaving.specular[s].as_ref().unwrap_or(none).whole(),
                    arriving: y.bins[t].as_ref().unwrap_or(none).whole(),
                };
                let kernels = &mut self.kernels[k];
                kernels.near(&bound, to, from, watch)?;
                kernels.far(&bound, to, from, watch)?;
            }
        }
        Ok(())
    }
}

/// The buffers of one pair of groups.
struct Bound<'a> {
    context: &'a Context,
    irradiance: BufferSlice<'a>,
    antiradiance: BufferSlice<'a>,
    /// Whether there is antiradiance.
    backs: bool,
    specular: BufferSlice<'a>,
    arriving: BufferSlice<'a>,
}

impl Kernels {
    fn far(
        &mut self,
        bound: &Bound,
        to: &Group,
        from: &Group,
        watch: &mut Watch,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, leaving } = bound.context;
        let with_bins = self.receiver_bins || self.source != (false, false);
        let tile = plan.layout.tile;
        let mut buffers =
            vec![scene.facets.whole(), leaving.radiance.whole(), scene.tile_pairs.whole(), bound.irradiance];
        if with_bins {
            buffers.extend([bound.antiradiance, bound.specular, bound.arriving, scene.bin_table.whole()]);
        }
        for run in source_runs(&from.tiles) {
            let mut begin = to.tiles.start;
            while begin < to.tiles.end {
                let affordable = self.far_pace.pairs() / u64::from(tile * tile) / run.len() as u64;
                let rows = (to.tiles.end - begin).min(affordable.clamp(1, u64::from(u32::MAX)) as u32);
                let push = FarPush {
                    receiver_tile: begin,
                    source_begin: run.start,
                    source_end: run.end,
                    row_words: plan.tile_pairs.row_words,
                    half_range: 0.5 * plan.accuracy.subsample as f32,
                    receiver_page: to.tiles.start * tile,
                    source_page: from.tiles.start * tile,
                    passing: PAIR_FRONT | PAIR_NEAR | if bound.backs { PAIR_BACK } else { 0 },
                };
                let groups = [rows, self.workgroups, 1];
                let mut batch = device.batch()?;
                batch.dispatch(&self.far, &self.shape, &buffers, bytes_of(&push), groups)?;
                let timing = batch.submit()?;
                let pairs = u64::from(rows * run.len() as u32) * u64::from(tile * tile);
                self.far_pace.learn(pairs, timing.wall_seconds);
                watch.done(pairs)?;
                begin += rows;
            }
        }
        Ok(())
    }

    fn near(
        &mut self,
        bound: &Bound,
        to: &Group,
        from: &Group,
        watch: &mut Watch,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, leaving } = bound.context;
        let buffers = [
            scene.facets.whole(),
            leaving.radiance.whole(),
            scene.corners.whole(),
            bound.irradiance,
            bound.antiradiance,
            bound.specular,
            bound.arriving,
            scene.near_offsets.whole(),
            scene.near_sources.whole(),
            scene.bin_table.whole(),
        ];
        let (receivers, sources) = (plan.layout.slots_of(&to.tiles), plan.layout.slots_of(&from.tiles));
        let offsets = &plan.near.offsets;
        let mut begin = receivers.start;
        while begin < receivers.end {
            // Whole workgroups of receivers, at least one.
            let wanted = u64::from(offsets[begin as usize]) + self.near_pace.pairs();
            let run = &offsets[begin as usize..receivers.end as usize];
            let count = run.partition_point(|&o| u64::from(o) <= wanted) as u32;
            let end = (begin + count.next_multiple_of(WORKGROUP).max(WORKGROUP)).min(receivers.end);
            let longest = run_lengths(offsets, begin..end).max().unwrap_or(0);
            let take = if self.source == (false, false) { PLAIN_NEAR_SOURCES } else { NEAR_SOURCES };
            for skip in (0..longest).step_by(take as usize) {
                let push = NearPush {
                    receiver_begin: begin,
                    receiver_end: end,
                    source_begin: sources.start,
                    source_end: sources.end,
                    half_range: 0.5 * plan.accuracy.subsample as f32,
                    receiver_page: receivers.start,
                    source_page: sources.start,
                    backs: u32::from(bound.backs),
                    skip,
                    take,
                };
                let taken = run_lengths(offsets, begin..end);
                let taken: u64 = taken.map(|n| u64::from(n.saturating_sub(skip).min(take))).sum();
                let mut batch = device.batch()?;
                let groups = [(end - begin).div_ceil(WORKGROUP), 1, 1];
                batch.dispatch(&self.near, &self.shape, &buffers, bytes_of(&push), groups)?;
                let timing = batch.submit()?;
                self.near_pace.learn(taken, timing.wall_seconds);
                watch.done(taken * NEAR_COST / plan.layout.groups.len() as u64)?;
            }
            begin = end;
        }
        Ok(())
    }
}

/// Lengths of the lists of some receivers.
fn run_lengths(offsets: &[u32], receivers: Range<u32>) -> impl Iterator<Item = u32> {
    offsets[receivers.start as usize..=receivers.end as usize].windows(2).map(|pair| pair[1] - pair[0])
}

/// Runs of source tiles, one a dispatch.
fn source_runs(tiles: &Range<u32>) -> impl Iterator<Item = Range<u32>> + use<> {
    let end = tiles.end;
    (tiles.start..end).step_by(SOURCE_TILES as usize).map(move |start| start..(start + SOURCE_TILES).min(end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn source_runs_cover_everything_once() {
        for (start, end) in [(0, 1000), (37, 1000), (64, 65), (100, 5000)] {
            let all: Vec<u32> = source_runs(&(start..end)).flatten().collect();
            assert_eq!(all, (start..end).collect::<Vec<_>>());
            assert!(source_runs(&(start..end)).all(|run| run.len() <= SOURCE_TILES as usize));
        }
    }
}
