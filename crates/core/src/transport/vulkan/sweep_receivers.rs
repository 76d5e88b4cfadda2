//! Traversal of pairs by source, where clusters stand for far triangles: over groups of sources and their lists of receivers.

use super::Context;
use super::bundle::Bundle;
use super::bundle::PassMonitor;
use super::sweep::Sweep;
use crate::model::{LIST, SOURCES};
use crate::transport::TransportError;
use antirad_gpu::BufferSlice;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::cmp::Reverse;
use std::ops::Range;

/// `ReceiversPush` of crates/core/glsl/receiver_list.glsl.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ReceiversPush {
    /// First group of the dispatch, in the list of targets.
    pub target_begin: u32,
    /// One past the last group of the dispatch.
    pub target_end: u32,
    /// First source in range.
    pub source_begin: u32,
    /// One past the last source in range.
    pub source_end: u32,
    /// Group of the first source in range.
    pub group_begin: u32,
    /// First list of receivers in range.
    pub list_begin: u32,
    /// One past the last list of receivers in range.
    pub list_end: u32,
    /// Half of `near_field`: pairs with r² below this times the sum of their characteristic areas are close.
    pub half_range: f32,
    /// First index of the buffer of the sources' bins.
    pub target_page: u32,
    /// First index of the buffer of the sources' radiance.
    pub radiance_page: u32,
    /// First slot of the buffer of the receivers' bins.
    pub partner_page: u32,
    /// Lists in range of each group that earlier dispatches covered.
    pub skip: u32,
    /// Largest number of lists of each group that this dispatch covers.
    pub take: u32,
    /// Index of the first cluster if the sources are clusters, otherwise 0.
    pub clusters: u32,
    /// Index of the first moment in the buffer of the sources' radiance, three for each cluster.
    pub moments: u32,
}

/// Lists of a group per dispatch: lavapipe bounds the iterations of all loops of an invocation together by 65535, and a list takes
/// at most 32 · 20.
const TAKE: u32 = 64;

/// Sources, with the first indices of the pages that hold their bins and their radiance, and the slots of receivers, with that of
/// the page of their bins.
pub struct FromSources {
    pub sources: Range<u32>,
    pub bins_page: u32,
    pub radiance_page: u32,
    pub receivers: Range<u32>,
    pub receivers_page: u32,
}

impl Sweep {
    /// Runs the point-to-point kernel over the receivers of sources. The last buffer that the kernel binds lists the targets.
    ///
    /// # Errors
    /// Fails if the plan has no clusters or no gradients, if the device fails, or if the callback stops the
    /// pass.
    pub fn received(
        &mut self,
        context: &Context,
        of: FromSources,
        buffers: &[BufferSlice],
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        let clusters = plan.clusters().ok_or_else(|| TransportError::missing("clusters"))?;
        let lists = clusters.receivers().ok_or(TransportError::NotPlanned)?;
        let FromSources { sources, bins_page, radiance_page, receivers, receivers_page } = of;
        let range = receivers.start / LIST..receivers.end / LIST;
        let groups = lists.groups(&sources);
        let of_group = |group| (group, lists.count(group, &range));
        let mut targets: Vec<(u32, u32)> =
            groups.clone().map(of_group).filter(|(_, count)| *count > 0).collect();
        if targets.is_empty() {
            return Ok(());
        }
        // Those with long lists first, so that the ones that are not done yet are always the first.
        targets.sort_by_key(|(_, count)| Reverse(*count));
        let numbers: Vec<u32> = targets.iter().map(|(group, _)| *group).collect();
        let buffers = [buffers, &[scene.near_targets.whole()]].concat();
        let Self { far, far_pace, side_by_side, workgroups, bytes, shape, .. } = self;
        let mut bundle = Bundle::new(device, far_pace, monitor);
        bundle.add(0, 0, |batch| batch.update(&scene.near_targets, 0, bytemuck::cast_slice(&numbers)))?;
        let pairs_of = |lists: u32| u64::from(lists) * u64::from(LIST * SOURCES);
        for skip in (0..targets[0].1).step_by(TAKE as usize) {
            let end = targets.partition_point(|(_, count)| *count > skip) as u32;
            let mut begin = 0;
            while begin < end {
                let left = |(_, count): &(u32, u32)| (count - skip).min(TAKE);
                let rows = bundle.share(end - begin, pairs_of(left(&targets[begin as usize])));
                let part = &targets[begin as usize..(begin + rows) as usize];
                let push = ReceiversPush {
                    target_begin: begin,
                    target_end: begin + rows,
                    source_begin: sources.start,
                    source_end: sources.end,
                    group_begin: groups.start,
                    list_begin: range.start,
                    list_end: range.end,
                    half_range: 0.5 * plan.settings.near_field as f32,
                    target_page: bins_page,
                    radiance_page,
                    partner_page: receivers_page,
                    skip,
                    take: TAKE,
                    clusters: if sources.start >= clusters.first() { clusters.first() } else { 0 },
                    moments: plan.sources() - radiance_page,
                };
                let pairs = part.iter().map(|target| pairs_of(left(target))).sum();
                bundle.add(pairs, pairs, |batch| {
                    let workgroups = [rows.div_ceil(*side_by_side), *workgroups, 1];
                    batch.dispatch(far, shape, &buffers, bytes_of(&push), workgroups)
                })?;
                begin += rows;
            }
        }
        bundle.end()?;
        let pairs = targets.iter().map(|(_, count)| pairs_of(*count)).sum();
        device.credit(far.kernel(), shape, pairs, (pairs as f64 * bytes[0]) as u64);
        Ok(())
    }
}
