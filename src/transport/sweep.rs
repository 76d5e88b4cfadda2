//! Walking over pairs of triangles: point to point by tiles, and over pieces for close pairs. What U, its transpose and
//! its derivatives have in common.

use super::Context;
use super::pace::{Bundle, MOST_GROUPS, Pace};
use super::watch::{TransportError, Watch};
use crate::gpu::{Bindings, Buffer, BufferSlice, Device, DeviceKind, GpuError, Pipeline, UNIFORM_BYTES};
use crate::plan::{Group, NearPairs, OTHER_BYTES, PAIR_BACK, PAIR_FRONT, PairLists, Plan};
use crate::shaders::RealShader;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::cmp::Reverse;
use std::ops::Range;

// Others of a dispatch stand in a uniform buffer.
const _: () = assert!(OTHER_BYTES <= UNIFORM_BYTES);

/// `FarPush` of glsl/far_push.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct FarPush {
    /// The first tile whose triangles own lanes.
    pub owner_tile: u32,
    /// The first tile they walk over.
    pub other_begin: u32,
    /// The one behind the last.
    pub other_end: u32,
    /// Half of the near field: pairs with r² below this times the sum of their characteristic areas are close.
    pub half_range: f32,
    /// The slot that the bins of the owners begin with in their buffer.
    pub owner_page: u32,
    /// The same of the others.
    pub other_page: u32,
    /// What may pass, of the bits of a tile pair.
    pub passing: u32,
}

/// `NearPush` of glsl/near_push.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct NearPush {
    /// Index of the first owner in the list of owners.
    pub owner_begin: u32,
    /// How many follow from there.
    pub owners: u32,
    /// The first slot of the others.
    pub other_begin: u32,
    /// The one behind the last.
    pub other_end: u32,
    /// Half of the near field: pairs with r² below this times the sum of their characteristic areas are close.
    pub half_range: f32,
    /// The slot that the bins of the owners begin with in their buffer.
    pub owner_page: u32,
    /// The same of the others.
    pub other_page: u32,
    /// 1 where antiradiance leaves the backs, else 0.
    pub backs: u32,
    /// Close others of each owner that earlier dispatches took.
    pub skip: u32,
    /// How many this one takes at most.
    pub take: u32,
}

/// Point-to-point pairs that a close one takes as long as: for the time left, nothing else.
const NEAR_COST: u64 = 100;

/// Reals of a `Facet` and of radiance, and of corners: glsl/geometry.glsl.
const SOURCE_REALS: f64 = 12.0;
const CORNER_REALS: f64 = 12.0;
/// Pairs of pieces at the first level of the near field.
const PIECES: u32 = 16;

/// What a sweep is made of.
pub struct Kernels<'a> {
    /// The kernels, with the number of their buffers. Uniform buffers of `far` hold the others of a dispatch; the last
    /// buffer of `near` is that of owners.
    pub far: (&'a RealShader, Bindings),
    pub near: (&'a RealShader, u32),
    /// Whether a lane of `far` owns one triangle, or one in each run of lanes of a tile.
    pub single: bool,
    /// Specialization of both, beyond lanes and tiles.
    pub constants: Vec<(u32, u32)>,
    /// Close others per owner and dispatch: bounded as [`Plan::other_slots`] is.
    pub take: u32,
    /// Bins of which a pair reads four at either end, so many ends: for the profile.
    pub gathers: u64,
    /// Sets of bins that a lane of `far` sums up in.
    pub deposits: u64,
    /// For the profile.
    pub shape: String,
}

/// Kernels over pairs of triangles of certain classes. A lane owns a triangle and walks over others.
pub struct Sweep {
    far: Pipeline,
    /// Workgroups of `far` per tile of owners.
    workgroups: u32,
    near: Pipeline,
    /// Lanes of a workgroup of `near`.
    lanes: u32,
    take: u32,
    far_pace: Pace,
    near_pace: Pace,
    /// Bytes that a point-to-point pair and a close pair ask of buffers.
    bytes: [f64; 2],
    shape: String,
}

/// A buffer of values per slot, of which a dispatch sees those of its others. It goes on for [`Plan::other_slots`] behind
/// the last, so that there is always that much to see.
#[derive(Clone, Copy)]
pub struct OfOthers<'a> {
    pub buffer: &'a Buffer,
    /// Per slot.
    pub bytes: u64,
}

/// What point-to-point kernels read of others: geometry, and `light`, one RGB value of each.
pub fn of_others<'a>(context: &'a Context, light: &'a Buffer) -> [OfOthers<'a>; 2] {
    let Context { plan, scene, .. } = context;
    [
        OfOthers { buffer: &scene.facets, bytes: plan.facet_bytes() },
        OfOthers { buffer: light, bytes: plan.rgb_bytes() },
    ]
}

/// Who owns the lanes, and over whom they walk.
#[derive(Clone, Copy)]
pub struct Between<'a> {
    pub owners: &'a Group,
    pub others: &'a Group,
    /// By owner, receivers or sources.
    pub lists: &'a PairLists,
    /// The slot whose bins come first in the buffers of the owners.
    pub first_slot: u32,
}

impl<'a> Between<'a> {
    /// Receivers whose bins begin with those of `first_slot`, and sources.
    pub fn receivers(plan: &'a Plan, owners: &'a Group, others: &'a Group, first_slot: u32) -> Self {
        Self { owners, others, lists: &plan.interactions().by_receiver, first_slot }
    }

    /// Of groups whose bins stand in pages of their own.
    pub fn groups(plan: &Plan, lists: &'a PairLists, owners: &'a Group, others: &'a Group) -> Self {
        Self { owners, others, lists, first_slot: plan.layout.slots_of(&owners.tiles).start }
    }
}

impl Sweep {
    pub fn new(device: &Device, plan: &Plan, kernels: Kernels) -> Result<Self, GpuError> {
        let precision = plan.accuracy.precision;
        let lanes = device.info().subgroup_size.min(plan.limits.tile);
        let Kernels { far, near, single, constants, take, gathers, deposits, shape } = kernels;
        let real = precision.bytes() as f64;
        let gathered = gathers as f64 * 4.0 * f64::from(plan.channels) * real;
        // What is read of a source serves all the triangles that a subgroup owns.
        let owned = f64::from(if single { lanes } else { plan.limits.tile });
        let shared = u32::from(shares_deposits(device, plan, lanes, deposits));
        let of_far = [&[(0, lanes), (1, plan.limits.tile), (11, shared)][..], &constants].concat();
        let of_near = [&[(0, lanes), (11, shared)][..], &constants].concat();
        let far_push = size_of::<FarPush>() as u32;
        let near_push = size_of::<NearPush>() as u32;
        Ok(Self {
            far: Pipeline::new(device, far.0.of(precision), far.1, far_push, &of_far, Some(lanes))?,
            workgroups: if single { plan.limits.tile / lanes } else { 1 },
            near: Pipeline::new(device, near.0.of(precision), near.1, near_push, &of_near, None)?,
            lanes,
            take,
            far_pace: Pace::new(if single { 2e6 } else { 5e7 }),
            near_pace: Pace::new(1e5),
            bytes: [
                SOURCE_REALS * real / owned + gathered,
                (SOURCE_REALS + CORNER_REALS) * real + f64::from(PIECES) * gathered,
            ],
            shape,
        })
    }

    /// Pairs of two groups, point to point.
    pub fn far_pairs(plan: &Plan, one: &Group, other: &Group) -> u64 {
        let tiles = one.tiles.len() as u64 * other.tiles.len() as u64;
        tiles * u64::from(plan.layout.tile * plan.layout.tile)
    }

    /// Pairs of a whole pass, weighted by what they cost.
    pub fn pairs(plan: &Plan) -> u64 {
        let slots = u64::from(plan.layout.slots());
        slots * slots + plan.interactions().by_receiver.near.others.len() as u64 * NEAR_COST
    }

    /// Pairs of tiles. `passing`: what may pass, of the bits that the plan keeps for them.
    pub fn far(
        &mut self,
        context: &Context,
        between: Between,
        buffers: &[BufferSlice],
        uniforms: &[OfOthers],
        passing: u32,
        watch: &mut Watch,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let Between { owners, others, lists, first_slot } = between;
        let tile = plan.layout.tile;
        let Self { far, far_pace, workgroups, bytes, shape, .. } = self;
        let mut passed = 0;
        let mut bundle = Bundle::new(device, far_pace, watch);
        for run in tile_runs(&others.tiles, plan.other_tiles()) {
            let pairs_of_row = u64::from(tile * tile) * run.len() as u64;
            let mut begin = owners.tiles.start;
            while begin < owners.tiles.end {
                let rows = bundle.share(owners.tiles.end - begin, pairs_of_row);
                let push = FarPush {
                    owner_tile: begin,
                    other_begin: run.start,
                    other_end: run.end,
                    half_range: 0.5 * plan.accuracy.subsample as f32,
                    owner_page: first_slot,
                    other_page: others.tiles.start * tile,
                    passing,
                };
                let from = u64::from(run.start * tile);
                let seen = uniforms
                    .iter()
                    .map(|of| of.buffer.slice(from * of.bytes, u64::from(plan.other_slots()) * of.bytes));
                let buffers: Vec<_> = buffers.iter().copied().chain(seen).collect();
                let groups = [rows, *workgroups, 1];
                passed += passing_tiles(lists, begin..begin + rows, &run, passing);
                let pairs = pairs_of_row * u64::from(rows);
                bundle.add(pairs, pairs, |batch| {
                    batch.dispatch(far, shape, &buffers, bytes_of(&push), groups)
                })?;
                begin += rows;
            }
        }
        bundle.submit()?;
        let pairs = passed * u64::from(tile * tile);
        device.credit(far.kernel(), shape, pairs, (pairs as f64 * bytes[0]) as u64);
        Ok(())
    }

    /// The close pairs. `backs`: whether there is antiradiance.
    pub fn near(
        &mut self,
        context: &Context,
        between: Between,
        buffers: &[BufferSlice],
        backs: bool,
        watch: &mut Watch,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        let others = plan.layout.slots_of(&between.others.tiles);
        let owners = busy_owners(&between.lists.near, plan.layout.slots_of(&between.owners.tiles), &others);
        if owners.is_empty() {
            return Ok(());
        }
        let slots: Vec<u32> = owners.iter().map(|owner| owner.slot).collect();
        device.upload_slice(&scene.near_owners, 0, &slots)?;
        let buffers = [buffers, &[scene.near_owners.whole()]].concat();
        let Self { near, near_pace, lanes, take, bytes, shape, .. } = self;
        let mut bundle = Bundle::new(device, near_pace, watch);
        let longest = owners.iter().map(|owner| owner.others).max().unwrap_or(0);
        for skip in (0..longest).step_by(*take as usize) {
            let left = |owner: &Owner| u64::from(owner.others.saturating_sub(skip).min(*take));
            let end = owners.iter().rposition(|owner| left(owner) > 0).map_or(0, |last| last + 1);
            let mut begin = 0;
            while begin < end {
                // As many whole workgroups as make a submission, at least one.
                let mut pairs = 0;
                let workgroups = owners[begin..end].chunks(*lanes as usize).take(MOST_GROUPS as usize);
                let workgroups = workgroups.take_while(|group| {
                    let more = group.iter().map(left).sum::<u64>();
                    let fits = pairs == 0 || pairs + more <= bundle.affordable();
                    pairs += if fits { more } else { 0 };
                    fits
                });
                let workgroups = workgroups.count() as u32;
                let count = (workgroups * *lanes).min((end - begin) as u32);
                let push = NearPush {
                    owner_begin: begin as u32,
                    owners: count,
                    other_begin: others.start,
                    other_end: others.end,
                    half_range: 0.5 * plan.accuracy.subsample as f32,
                    owner_page: between.first_slot,
                    other_page: others.start,
                    backs: u32::from(backs),
                    skip,
                    take: *take,
                };
                bundle.add(pairs, pairs * NEAR_COST, |batch| {
                    batch.dispatch(near, shape, &buffers, bytes_of(&push), [workgroups, 1, 1])
                })?;
                begin += count as usize;
            }
        }
        bundle.submit()?;
        let pairs = owners.iter().map(|owner| u64::from(owner.others)).sum();
        device.credit(near.kernel(), shape, pairs, (pairs as f64 * bytes[1]) as u64);
        Ok(())
    }
}

/// Who has close others, and how many.
struct Owner {
    slot: u32,
    others: u32,
}

/// Those of a range of slots with close ones among `others`: who has many comes first, so that lanes that work together
/// have about as much to do; who has about as many stand by slot, so that they share what they read.
fn busy_owners(list: &NearPairs, owners: Range<u32>, others: &Range<u32>) -> Vec<Owner> {
    let of = |slot| Owner { slot, others: list.of(slot, others).len() as u32 };
    let mut owners: Vec<Owner> = owners.map(of).filter(|owner| owner.others > 0).collect();
    // Steps of a ninth.
    owners.sort_by_key(|owner| Reverse((8.0 * f64::from(owner.others).log2()) as u32));
    owners
}

/// Whether `lanes` gather so many sets of bins in memory of their workgroup. CPU drivers are quicker at that; on GPUs it
/// would leave room for a few workgroups only.
fn shares_deposits(device: &Device, plan: &Plan, lanes: u32, sets: u64) -> bool {
    let info = device.info();
    // Drivers may align a vec3 like a vec4.
    let bytes = sets * u64::from(lanes) * plan.bins.count() as u64 * plan.rgb_bytes();
    info.kind == DeviceKind::Cpu && plan.channels == 3 && bytes <= u64::from(info.shared_memory_bytes)
}

/// Pairs of tiles between which something may pass.
fn passing_tiles(lists: &PairLists, owners: Range<u32>, others: &Range<u32>, passing: u32) -> u64 {
    let wanted = passing & (PAIR_FRONT | PAIR_BACK);
    owners.map(|owner| lists.far.passing(owner, others, wanted).count() as u64).sum()
}

/// Runs of at most so many tiles, one a dispatch.
fn tile_runs(tiles: &Range<u32>, most: u32) -> impl Iterator<Item = Range<u32>> + use<> {
    let end = tiles.end;
    (tiles.start..end).step_by(most as usize).map(move |start| start..(start + most).min(end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn owners_with_many_others_come_first() {
        // Others of slots 0 to 3: 2, none, 9, 2 of which one is out of range.
        let others = [vec![1, 2], vec![], (0..9).collect(), vec![3, 20]].concat();
        let list = NearPairs { offsets: vec![0, 2, 2, 11, 13], others };
        let owners = busy_owners(&list, 0..4, &(0..10));
        let found: Vec<_> = owners.iter().map(|owner| (owner.slot, owner.others)).collect();
        assert_eq!(found, [(2, 9), (0, 2), (3, 1)]);
    }

    #[test]
    fn tile_runs_cover_everything_once() {
        for (start, end) in [(0, 1000), (37, 1000), (64, 65), (100, 5000)] {
            let all: Vec<u32> = tile_runs(&(start..end), 32).flatten().collect();
            assert_eq!(all, (start..end).collect::<Vec<_>>());
            assert!(tile_runs(&(start..end), 32).all(|run| run.len() <= 32));
        }
    }
}
