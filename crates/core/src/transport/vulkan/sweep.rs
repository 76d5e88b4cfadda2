//! Traversal of pairs of triangles: point to point by tiles, and piecewise for close pairs. Shared by U, its
//! transpose and its derivatives.

use super::Context;
use super::bundle::PassMonitor;
use super::bundle::{Bundle, MOST_GROUPS};
use crate::plan::{Group, NearPairs, PADDING, PAIR_BACK, PAIR_FRONT, PARTNER_BYTES, PairLists, Plan};
use crate::shaders::RealShader;
use crate::transport::TransportError;
use crate::transport::pace::Pace;
use crate::transport::work::NEAR_COST;
use antirad_gpu::{Bindings, Buffer, BufferSlice, Device, DeviceKind, GpuError, Pipeline, UNIFORM_BYTES};
use antirad_scene::Movable;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::cmp::Reverse;
use std::ops::Range;

// The partners of a dispatch are in a uniform buffer.
const _: () = assert!(PARTNER_BYTES <= UNIFORM_BYTES);

/// `FarPush` of crates/core/glsl/far_push.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct FarPush {
    /// First tile of targets.
    pub target_tile: u32,
    /// First tile of partners.
    pub partner_begin: u32,
    /// One past the last tile of partners.
    pub partner_end: u32,
    /// Half of `near_field`: pairs with r² below this times the sum of their characteristic areas are close.
    pub half_range: f32,
    /// First slot of the buffer of the targets' bins.
    pub target_page: u32,
    /// First slot of the buffer of the partners' bins.
    pub partner_page: u32,
    /// Bits of a tile pair to consider.
    pub passing: u32,
}

/// `NearPush` of crates/core/glsl/near_push.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct NearPush {
    /// Index of the first target in the list of targets.
    pub target_begin: u32,
    /// Number of targets from `target_begin` on.
    pub targets: u32,
    /// First slot of the partners.
    pub partner_begin: u32,
    /// One past the last slot of the partners.
    pub partner_end: u32,
    /// Half of `near_field`: pairs with r² below this times the sum of their characteristic areas are close.
    pub half_range: f32,
    /// First slot of the buffer of the targets' bins.
    pub target_page: u32,
    /// First slot of the buffer of the partners' bins.
    pub partner_page: u32,
    /// 1 if backs emit antiradiance, else 0.
    pub backs: u32,
    /// Close partners of each target that earlier dispatches covered.
    pub skip: u32,
    /// Largest number of close partners of each target that this dispatch covers.
    pub take: u32,
}

/// Reals of a `Facet` and of radiance, and of corners: crates/core/glsl/geometry.glsl.
const SOURCE_REALS: f64 = 12.0;
const CORNER_REALS: f64 = 12.0;
/// Pairs of pieces at the first level of the near field.
const PIECES: u32 = 16;

/// Bytes of partners' bins that stay in the second-level cache of a CPU's core while a dispatch reads them.
const CACHED_BYTES: u64 = 1 << 20;

/// Close partners per target and dispatch where a driver does not count iterations.
const TAKE_OF_GPUS: u32 = 256;

/// The kernels of a sweep, with what they are compiled for.
pub struct Kernels<'a> {
    /// The kernels, with the number of their buffers. Uniform buffers of `far` hold the partners of a dispatch; the last buffer of `near`
    /// lists the targets.
    pub far: (&'a RealShader, Bindings),
    /// `None` where the near field is kept as a matrix.
    pub near: Option<(&'a RealShader, u32)>,
    /// Whether a lane of `far` has one triangle as its target, rather than one in each range of lanes of a
    /// tile.
    pub single: bool,
    /// Specialization of both, beyond lanes and tiles.
    pub constants: Vec<(u32, u32)>,
    /// Close partners per target and dispatch, bounded for the same reason as [`Plan::partner_slots`].
    pub take: u32,
    /// Ends of a pair, 0 to 2, at which four bins are read; for the profile.
    pub gathers: u64,
    /// Sets of bins that are accumulated of a target; `None` where that is something else, and lanes cannot share a target.
    pub scattered: Option<u64>,
    /// Slots of all triangles that are targets.
    pub slots: u32,
    /// Name of the shape in the profile.
    pub shape: String,
}

/// Kernels over pairs of triangles of certain classes. A lane owns a triangle and walks over partners.
pub struct Sweep {
    far: Pipeline,
    /// Workgroups of `far` per tile of targets.
    workgroups: u32,
    /// Tiles of partners per dispatch of `far`.
    run_tiles: u32,
    near: Option<Pipeline>,
    /// Targets of a workgroup of `near`.
    near_targets: u32,
    take: u32,
    far_pace: Pace,
    near_pace: Pace,
    /// Bytes read from buffers by a point-to-point pair and by a close pair.
    bytes: [f64; 2],
    shape: String,
}

/// A buffer of values per slot, of which a dispatch binds those of its partners. It extends [`Plan::partner_slots`]
/// past the last slot, so that the bound range always exists.
#[derive(Clone, Copy)]
pub struct OfPartners<'a> {
    pub buffer: &'a Buffer,
    /// Bytes per slot.
    pub bytes: u64,
}

/// What point-to-point kernels read of partners: geometry, and `light`, one RGB value of each.
pub fn of_partners<'a>(context: &'a Context, light: &'a Buffer) -> [OfPartners<'a>; 2] {
    let Context { plan, scene, .. } = context;
    [
        OfPartners { buffer: &scene.facets, bytes: plan.facet_bytes() },
        OfPartners { buffer: light, bytes: plan.rgb_bytes() },
    ]
}

/// Targets and partners of a sweep.
pub struct Between<'a> {
    pub targets: Group,
    pub partners: &'a Group,
    /// Pairs by target, receivers or sources.
    pub lists: &'a PairLists,
    /// First slot of the buffers of the targets' bins.
    pub first_slot: u32,
}

impl<'a> Between<'a> {
    /// Targets are receivers, with bins from `first_slot` on.
    pub fn receivers(plan: &'a Plan, targets: &Group, partners: &'a Group, first_slot: u32) -> Self {
        Self { targets: targets.clone(), partners, lists: &plan.interactions().by_receiver, first_slot }
    }

    /// Targets are the tiles of a group, by its number, that this rank computes, and whose bins its buffers
    /// hold.
    pub fn held(plan: &Plan, group: usize, partners: &'a Group, lists: &'a PairLists) -> Self {
        let first_slot = plan.layout.slots_of(&plan.own(group).tiles).start;
        Self { targets: plan.own(group), partners, lists, first_slot }
    }

    /// The ranges of whole tiles that contain `movable` targets.
    pub fn movable_targets(self, plan: &Plan, movable: &Movable) -> Vec<Self> {
        let moves = |&tile: &u32| {
            let slots = plan.layout.slots_of(&(tile..tile + 1));
            let triangles = slots.map(|slot| plan.layout.order[slot as usize]);
            triangles.into_iter().any(|i| i != PADDING && movable.triangle(i))
        };
        let tiles: Vec<u32> = self.targets.tiles.clone().filter(moves).collect();
        let part = |run: &[u32]| {
            let targets = Group { tiles: run[0]..run[run.len() - 1] + 1, ..self.targets };
            Self { targets, ..self }
        };
        tiles.chunk_by(|a, b| a + 1 == *b).map(part).collect()
    }
}

impl Sweep {
    pub fn new(device: &Device, plan: &Plan, kernels: Kernels) -> Result<Self, GpuError> {
        let Kernels { far, near, single, constants, take, gathers, scattered, slots, shape } = kernels;
        let precision = plan.settings.precision;
        let info = device.info();
        let targets = plan.options.tile;
        let shared = Cooperative::far(device, plan, scattered, slots);
        let lanes = shared.map_or(info.subgroup_size.min(targets), Cooperative::in_workgroup);
        // Those of a workgroup, within a tile.
        let side = shared.map_or(lanes, |shared| shared.targets);
        let real = precision.bytes() as f64;
        let gathered = gathers as f64 * 4.0 * f64::from(plan.channels) * real;
        // A source is read once for all triangles of a subgroup.
        let single = single || shared.is_some();
        let per_target = f64::from(if single { side } else { targets });
        let in_workgroup = |lanes| u32::from(shares_deposits(device, plan, lanes, scattered.unwrap_or(0)));
        let cooperative =
            |shared: Option<Cooperative>| shared.map(|of| (15, of.lanes)).into_iter().collect::<Vec<_>>();
        let of_far = [
            &[(0, lanes), (1, targets), (11, in_workgroup(lanes)), (13, lanes)][..],
            &constants,
            &cooperative(shared),
        ]
        .concat();
        // Its targets are anywhere.
        let any_bins = gathers > 0 || scattered.is_some_and(|sets| sets > 0);
        let near_shared = Cooperative::close(device, plan, scattered, slots, any_bins);
        let near_targets =
            near_shared.map_or(info.subgroup_size.min(plan.options.tile), |shared| shared.targets);
        let near_lanes = near_shared.map_or(near_targets, Cooperative::in_workgroup);
        let of_near = [
            &[(0, near_lanes), (11, in_workgroup(near_lanes)), (13, near_lanes)][..],
            &constants,
            &cooperative(near_shared),
        ]
        .concat();
        let [far_push, near_push] = [size_of::<FarPush>(), size_of::<NearPush>()].map(|bytes| bytes as u32);
        Ok(Self {
            far: Pipeline::new(device, far.0.of(precision), far.1, far_push, &of_far)?,
            workgroups: if single { (targets / side).max(1) } else { 1 },
            run_tiles: match device.kernels_for() {
                DeviceKind::Cpu if gathers > 0 && scattered.is_none_or(|sets| sets == 0) => {
                    cached_tiles(plan)
                }
                _ => plan.partner_tiles(),
            },
            near: near
                .map(|(shader, buffers)| {
                    Pipeline::new(device, shader.of(precision), buffers, near_push, &of_near)
                })
                .transpose()?,
            near_targets,
            // Iterations are counted on CPU drivers alone.
            take: if info.kind == DeviceKind::Cpu { take } else { take.max(TAKE_OF_GPUS) },
            far_pace: Pace::new(if single { 2e6 } else { 5e7 }),
            near_pace: Pace::new(1e5),
            bytes: [
                SOURCE_REALS * real / per_target + gathered,
                (SOURCE_REALS + CORNER_REALS) * real + f64::from(PIECES) * gathered,
            ],
            shape,
        })
    }

    /// Runs the point-to-point kernel over pairs of tiles. `passing`: the bits of the pairs to consider.
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
    pub fn far(
        &mut self,
        context: &Context,
        between: &Between,
        buffers: &[BufferSlice],
        uniforms: &[OfPartners],
        passing: u32,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let Between { targets, partners, lists, first_slot } = between;
        let tile = plan.layout.tile;
        let Self { far, far_pace, workgroups, run_tiles, bytes, shape, .. } = self;
        let mut passed = 0;
        let mut bundle = Bundle::new(device, far_pace, monitor);
        for run in tile_runs(&partners.tiles, *run_tiles) {
            let pairs_of_row = u64::from(tile * tile) * run.len() as u64;
            let mut begin = targets.tiles.start;
            while begin < targets.tiles.end {
                let rows = bundle.share(targets.tiles.end - begin, pairs_of_row);
                let push = FarPush {
                    target_tile: begin,
                    partner_begin: run.start,
                    partner_end: run.end,
                    half_range: 0.5 * plan.settings.near_field as f32,
                    target_page: *first_slot,
                    partner_page: partners.tiles.start * tile,
                    passing,
                };
                let from = u64::from(run.start * tile);
                let seen = uniforms
                    .iter()
                    .map(|of| of.buffer.slice(from * of.bytes, u64::from(plan.partner_slots()) * of.bytes));
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
        bundle.end()?;
        let pairs = passed * u64::from(tile * tile);
        device.credit(far.kernel(), shape, pairs, (pairs as f64 * bytes[0]) as u64);
        Ok(())
    }

    /// Runs the near-field kernel over close pairs, if there is one. `backs`: whether there is antiradiance.
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
    pub fn near(
        &mut self,
        context: &Context,
        between: &Between,
        buffers: &[BufferSlice],
        backs: bool,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        let Self { near, near_pace, near_targets, take, bytes, shape, .. } = self;
        let Some(near) = near else { return Ok(()) };
        let partners = plan.layout.slots_of(&between.partners.tiles);
        let targets =
            close_targets(&between.lists.near, plan.layout.slots_of(&between.targets.tiles), &partners);
        if targets.is_empty() {
            return Ok(());
        }
        let slots: Vec<u32> = targets.iter().map(|target| target.slot).collect();
        let buffers = [buffers, &[scene.near_targets.whole()]].concat();
        let mut bundle = Bundle::new(device, near_pace, monitor);
        bundle.add(0, 0, |batch| batch.update(&scene.near_targets, 0, bytemuck::cast_slice(&slots)))?;
        let longest = targets.iter().map(|target| target.partners).max().unwrap_or(0);
        for skip in (0..longest).step_by(*take as usize) {
            let left = |target: &Target| u64::from(target.partners.saturating_sub(skip).min(*take));
            let end = targets.iter().rposition(|target| left(target) > 0).map_or(0, |last| last + 1);
            let mut begin = 0;
            while begin < end {
                // As many whole workgroups as fit a submission, at least one.
                let mut pairs = 0;
                let workgroups =
                    targets[begin..end].chunks(*near_targets as usize).take(MOST_GROUPS as usize);
                let workgroups = workgroups.take_while(|group| {
                    let more = group.iter().map(left).sum::<u64>();
                    let fits = pairs == 0 || pairs + more <= bundle.affordable();
                    pairs += if fits { more } else { 0 };
                    fits
                });
                let workgroups = workgroups.count() as u32;
                let count = (workgroups * *near_targets).min((end - begin) as u32);
                let push = NearPush {
                    target_begin: begin as u32,
                    targets: count,
                    partner_begin: partners.start,
                    partner_end: partners.end,
                    half_range: 0.5 * plan.settings.near_field as f32,
                    target_page: between.first_slot,
                    partner_page: partners.start,
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
        bundle.end()?;
        let pairs = targets.iter().map(|target| u64::from(target.partners)).sum();
        device.credit(near.kernel(), shape, pairs, (pairs as f64 * bytes[1]) as u64);
        Ok(())
    }
}

/// A target with close partners, and their number.
struct Target {
    slot: u32,
    partners: u32,
}

/// The targets in a range of slots with close ones among `partners`, in descending order of their number, so that the
/// lanes of a workgroup have similar work. Similar numbers are ordered by slot, so that lanes read the same partners.
fn close_targets(list: &NearPairs, targets: Range<u32>, partners: &Range<u32>) -> Vec<Target> {
    let of = |slot| Target { slot, partners: list.of(slot, partners).len() as u32 };
    let mut targets: Vec<Target> = targets.map(of).filter(|target| target.partners > 0).collect();
    // Steps of a ninth.
    targets.sort_by_key(|target| Reverse((8.0 * f64::from(target.partners).log2()) as u32));
    targets
}

/// Cooperative lanes of a GPU: lanes of a workgroup that accumulate the sum of a target together
/// (crates/core/glsl/cooperative.glsl). Targets with bins have them, whose bins would fill the memory of each lane. So have
/// others where there are so few that with a lane each most of the GPU would idle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Cooperative {
    targets: u32,
    /// Cooperative lanes per target.
    lanes: u32,
}

impl Cooperative {
    /// Lanes per target with bins: each owns every other row of one of up to three channels.
    const LANES: u32 = 8;
    /// Lanes per target of a kernel of close pairs: one for each pair of pieces, and without bins at either end, where sources are not cut,
    /// one for each piece of the receiver.
    const CLOSE_LANES: [u32; 2] = [4, PIECES];
    /// Lanes per target without bins, at most: a subgroup of most GPUs.
    const MOST_LANES: u32 = 32;
    /// Lanes of a workgroup, at most, which each device takes.
    const MOST: u32 = 128;
    /// Reals that a lane notes to be added to bins: four weights, three channels; and three more.
    const NOTED: u64 = 10;
    /// Bins that fit the 16 bits of a note.
    const BINS: u64 = 1 << 16;

    /// Triangles that are few: with a lane each, a thousand subgroups of 32.
    const FEW: u32 = 1 << 15;
    /// Lanes that occupy a large GPU: eight thousand subgroups of 32.
    const ENOUGH: u32 = 1 << 18;

    /// Cooperative lanes for a kernel of far pairs, see [`Self::new`].
    fn far(device: &Device, plan: &Plan, sets: Option<u64>, slots: u32) -> Option<Self> {
        let with_bins = sets? > 0;
        let wanted = Self::ENOUGH.div_ceil(slots.max(1)).next_power_of_two();
        let lanes = if with_bins { Self::LANES } else { wanted.clamp(Self::LANES, Self::MOST_LANES) };
        Self::new(device, plan, sets, lanes, slots)
    }

    /// Cooperative lanes for a kernel of close pairs, see [`Self::new`]. `any_bins`: whether either end has
    /// bins.
    fn close(device: &Device, plan: &Plan, sets: Option<u64>, slots: u32, any_bins: bool) -> Option<Self> {
        Self::new(device, plan, sets, Self::CLOSE_LANES[usize::from(any_bins)], slots)
    }

    /// Chooses as many targets of a tile as have room for `sets` sets of bins in
    /// workgroup memory, with `lanes` each; `slots` are those of all targets. `None` for CPU drivers, where targets without bins are
    /// many, and where there is no room for one.
    fn new(device: &Device, plan: &Plan, sets: Option<u64>, lanes: u32, slots: u32) -> Option<Self> {
        let bins = sets? * plan.bins.count() as u64;
        let many = bins == 0 && slots >= Self::FEW;
        if many || bins >= Self::BINS || device.kernels_for() == DeviceKind::Cpu {
            return None;
        }
        let real = plan.settings.precision.bytes();
        let noted = u64::from(lanes) * (Self::NOTED * real + 4);
        let fits = |targets: &u32| {
            // And a vote, with what alignment takes.
            let bytes = u64::from(*targets) * (bins * u64::from(plan.channels) * real + noted) + 64;
            bytes <= u64::from(device.info().shared_memory_bytes)
        };
        let most = (Self::MOST / lanes).min(plan.options.tile);
        let sizes = std::iter::successors(Some(most), |targets| Some(targets / 2));
        let targets = sizes.take_while(|&targets| targets > 0).find(fits)?;
        Some(Self { targets, lanes })
    }

    /// Lanes of a workgroup: of all its targets.
    fn in_workgroup(self) -> u32 {
        self.targets * self.lanes
    }
}

/// Whether `lanes` accumulate `sets` sets of bins in workgroup memory, each its own. CPU drivers are faster that way; on GPUs it would
/// leave room for few workgroups only.
fn shares_deposits(device: &Device, plan: &Plan, lanes: u32, sets: u64) -> bool {
    // Drivers may align a vec3 like a vec4.
    let bytes = sets * u64::from(lanes) * plan.bins.count() as u64 * plan.rgb_bytes();
    let fetched = u64::from(lanes) * (plan.facet_bytes() + 4 * plan.rgb_bytes() + 4);
    device.kernels_for() == DeviceKind::Cpu
        && plan.channels == 3
        && bytes + fetched <= u64::from(device.info().shared_memory_bytes)
}

/// Tiles of partners whose bins are cached together: each workgroup of a dispatch reads all of them, a few bins of each
/// triangle. Where targets have bins, too, adding the sums of a dispatch to them would cost more than that. A power of
/// two, which divides [`Plan::partner_tiles`], so that sums don't depend on where pages end.
fn cached_tiles(plan: &Plan) -> u32 {
    let fitting = (CACHED_BYTES / plan.tile_bytes()).clamp(1, plan.partner_tiles().into()) as u32;
    1 << fitting.ilog2()
}

/// Number of pairs of tiles between which light may pass.
fn passing_tiles(lists: &PairLists, targets: Range<u32>, partners: &Range<u32>, passing: u32) -> u64 {
    let wanted = passing & (PAIR_FRONT | PAIR_BACK);
    targets.map(|target| lists.far.passing(target, partners, wanted).count() as u64).sum()
}

/// Ranges of at most `most` tiles, one per dispatch.
fn tile_runs(tiles: &Range<u32>, most: u32) -> impl Iterator<Item = Range<u32>> + use<> {
    let end = tiles.end;
    (tiles.start..end).step_by(most as usize).map(move |start| start..(start + most).min(end))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn targets_with_many_partners_come_first() {
        // Partners of slots 0 to 3: 2, none, 9, 2 of which one is out of range.
        let partners = [vec![1, 2], vec![], (0..9).collect(), vec![3, 20]].concat();
        let list = NearPairs { offsets: vec![0, 2, 2, 11, 13], partners };
        let targets = close_targets(&list, 0..4, &(0..10));
        let found: Vec<_> = targets.iter().map(|target| (target.slot, target.partners)).collect();
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
