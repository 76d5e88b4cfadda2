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
}

/// Tiles of sources after which sums go to memory (FLUSH_TILES of glsl/far_push.glsl): dispatches end on multiples of
/// this, so that sums don't depend on how the work is cut.
const FLUSH_TILES: u32 = 64;
/// Tiles of receivers that keep any device busy; fewer only if there are no more.
const BUSY_TILES: u32 = 16;

/// Point-to-point pairs that a close one takes as long as: for the time left, nothing else.
const NEAR_COST: u64 = 100;

/// Kernels of one pair of classes: of the source, and whether the receiver has bins.
struct Kernels {
    source: (bool, bool),
    receiver_bins: bool,
    far: Pipeline,
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
        let (blocker, glossy) = (from.class.blocker, from.class.glossy);
        let receiver_bins = to.class.has_bins();
        let mut constants =
            vec![(7, u32::from(blocker)), (8, u32::from(glossy)), (9, u32::from(receiver_bins))];
        constants.extend(bin_constants(plan));
        let tiles = [(0, self.lanes), (1, plan.limits.tile)];
        let push = size_of::<FarPush>() as u32;
        let far = if from.class.has_bins() || receiver_bins {
            let constants = [&tiles[..], &constants].concat();
            Pipeline::new(device, &shaders::TRANSPORT_BINS, 8, push, &constants, Some(self.lanes))?
        } else {
            Pipeline::new(device, &shaders::TRANSPORT_IRRADIANCE, 4, push, &tiles, Some(self.lanes))?
        };
        let constants = [&[(0, WORKGROUP)][..], &constants].concat();
        let near = Pipeline::new(device, &shaders::NEAR, 10, size_of::<NearPush>() as u32, &constants, None)?;
        let source = match (blocker, glossy) {
            (false, false) => "fronts",
            (true, false) => "fronts and backs",
            (false, true) => "glossy fronts",
            (true, true) => "glossy fronts and backs",
        };
        let with_bins = from.class.has_bins() || receiver_bins;
        Ok(Kernels {
            source: (blocker, glossy),
            receiver_bins,
            far,
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
                let lanes = self.lanes;
                let kernels = &mut self.kernels[k];
                kernels.near(&bound, to, from, watch)?;
                kernels.far(&bound, to, from, lanes, watch)?;
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
        lanes: u32,
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
        let mut begin = to.tiles.start;
        while begin < to.tiles.end {
            let left = to.tiles.end - begin;
            let mut rows = left;
            let mut sources = from.tiles.start;
            while sources < from.tiles.end {
                let budget = self.far_pace.pairs() / u64::from(tile * tile);
                if sources == from.tiles.start {
                    // As many receivers as can see all sources; but enough to keep the device busy.
                    let all = u64::from(from.tiles.end - from.tiles.start);
                    rows = left.min(((budget / all) as u32).max(BUSY_TILES));
                }
                let run = source_run(sources..from.tiles.end, budget / u64::from(rows));
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
                let groups = [rows, if with_bins { tile / lanes } else { 1 }, 1];
                let mut batch = device.batch()?;
                batch.dispatch(&self.far, &self.shape, &buffers, bytes_of(&push), groups)?;
                let timing = batch.submit()?;
                let pairs = u64::from(rows * run.len() as u32) * u64::from(tile * tile);
                self.far_pace.learn(pairs, timing.wall_seconds);
                watch.done(pairs)?;
                sources = run.end;
            }
            begin += rows;
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
            let pairs = u64::from(offsets[end as usize] - offsets[begin as usize]);
            if pairs > 0 {
                let push = NearPush {
                    receiver_begin: begin,
                    receiver_end: end,
                    source_begin: sources.start,
                    source_end: sources.end,
                    half_range: 0.5 * plan.accuracy.subsample as f32,
                    receiver_page: receivers.start,
                    source_page: sources.start,
                    backs: u32::from(bound.backs),
                };
                let mut batch = device.batch()?;
                let groups = [(end - begin).div_ceil(WORKGROUP), 1, 1];
                batch.dispatch(&self.near, &self.shape, &buffers, bytes_of(&push), groups)?;
                let timing = batch.submit()?;
                self.near_pace.learn(pairs, timing.wall_seconds);
                watch.done(pairs * NEAR_COST / plan.layout.groups.len() as u64)?;
            }
            begin = end;
        }
        Ok(())
    }
}

/// The next run of source tiles: about `wanted` of them, ending on a multiple of FLUSH_TILES or at the end.
fn source_run(left: Range<u32>, wanted: u64) -> Range<u32> {
    let blocks = (wanted / u64::from(FLUSH_TILES)).clamp(1, u64::from(u32::MAX / FLUSH_TILES / 2)) as u32;
    let end = (left.start / FLUSH_TILES + blocks).saturating_mul(FLUSH_TILES);
    left.start..end.min(left.end)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn source_runs_end_on_flushes_and_cover_everything() {
        for (start, end, wanted) in [(0, 1000, 10), (37, 1000, 200), (64, 65, 1), (100, 5000, u64::MAX)] {
            let mut at = start;
            while at < end {
                let run = source_run(at..end, wanted);
                assert!(run.start == at && run.end > at);
                assert!(run.end == end || run.end % FLUSH_TILES == 0);
                at = run.end;
            }
            assert_eq!(at, end);
        }
    }
}
