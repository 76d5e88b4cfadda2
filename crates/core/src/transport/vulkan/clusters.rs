//! The light of clusters, gathered from their parts, group by group, and height by height.

use super::completion::Values;
use super::{Context, WORKGROUP, bin_constants};
use crate::model::{Class, ClusterRun, Clusters};
use crate::plan::Plan;
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::bin_shares::BinShares;
use antirad_gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError, Pipeline};
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `GatherPush` of crates/core/glsl/gather.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GatherPush {
    /// First cluster of the dispatch.
    pub begin: u32,
    /// One past the last cluster of the dispatch.
    pub end: u32,
    /// Index of the first cluster of all.
    pub clusters: u32,
    /// 1 if their parts are triangles.
    pub triangles: u32,
    /// Index of the first moment, three for each cluster.
    pub moments: u32,
}

/// `GatherBinsPush` of crates/core/glsl/gather_bins.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GatherBinsPush {
    /// First cluster of the dispatch.
    pub begin: u32,
    /// Index of the first cluster of all.
    pub clusters: u32,
    /// 1 if their parts are triangles.
    pub triangles: u32,
    /// Index of the first part in its page.
    pub from_page: u32,
    /// Index of the first cluster in its page.
    pub to_page: u32,
}

/// Workgroups that a dispatch may have on every device.
pub(super) const MOST_GROUPS: usize = 65_535;

/// Sources of one class with their bins in one page: the triangles or the clusters of a group.
pub struct Sources<'a> {
    pub class: Class,
    pub indices: Range<u32>,
    pub antiradiance: BufferSlice<'a>,
    pub specular: BufferSlice<'a>,
}

/// The light of the clusters of one group at a time.
pub struct ClusterLight {
    gather: Pipeline,
    gather_bins: Pipeline,
    /// Bins of the clusters of the group that has most of them.
    antiradiance: Option<Buffer>,
    specular: Option<Buffer>,
    /// Who computes bins, by group.
    shares: Vec<BinShares>,
}

impl ClusterLight {
    /// `None` where no clusters are planned.
    ///
    /// # Errors
    /// Fails if the device cannot compile a kernel, or has no memory for a buffer.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(clusters) = plan.clusters() else { return Ok(None) };
        let [gather, gather_bins] = Self::kernels(device, plan)?;
        Ok(Some(Self {
            gather,
            gather_bins,
            antiradiance: page(device, plan, "cluster antiradiance", |class| class.blocker)?,
            specular: page(device, plan, "cluster specular", |class| class.glossy)?,
            shares: clusters
                .runs()
                .iter()
                .enumerate()
                .map(|(group, run)| BinShares::of(plan, group, clusters, run))
                .collect(),
        }))
    }

    /// Compiles the kernels that gather the diffuse radiance of clusters, and their bins.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<[Pipeline; 2], GpuError> {
        let precision = plan.settings.precision;
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let (push, bins_push) = (size_of::<GatherPush>() as u32, size_of::<GatherBinsPush>() as u32);
        let (gather, gather_bins) = (shaders::GATHER.of(precision), shaders::GATHER_BINS.of(precision));
        Ok([
            Pipeline::new(device, gather, 3, push, &[(0, WORKGROUP)])?,
            Pipeline::new(device, gather_bins, 4, bins_push, &constants)?,
        ])
    }

    /// Computes the light of the clusters of a group from that of its triangles; with `backs`, of their backs, too. It replaces that of the
    /// group before.
    ///
    /// # Errors
    /// Fails if the plan has no clusters, if the device fails, or if another rank has ended.
    pub fn gather<'a>(
        &'a self,
        context: &'a Context,
        group: usize,
        triangles: &Sources<'a>,
        backs: bool,
    ) -> Result<Sources<'a>, TransportError> {
        let (clusters, run) = clusters_of(&context.plan, group)?;
        let none = context.scene.no_bins.whole();
        let of_class = |wanted: bool, page: &'a Option<Buffer>| match (wanted, page) {
            (false, _) => Ok(None),
            (true, Some(page)) => Ok(Some(page.whole())),
            (true, None) => Err(TransportError::missing("bins of clusters")),
        };
        let antiradiance = of_class(run.class.blocker && backs, &self.antiradiance)?;
        let specular = of_class(run.class.glossy, &self.specular)?;
        let mut batch = context.device.batch()?;
        for (height, of) in run.heights.iter().enumerate() {
            self.gather_radiance(context, clusters, of, height == 0, &mut batch)?;
        }
        batch.defer()?;
        let wanted = [(antiradiance, triangles.antiradiance), (specular, triangles.specular)];
        let wanted = wanted.into_iter().filter_map(|(to, from)| Some((to?, from)));
        let BinShares { by_rank, by_all } = &self.shares[group];
        for (to, from) in wanted {
            let page = [triangles.indices.start, run.range().start];
            if let Some(own) = by_rank.get(context.plan.options.rank as usize) {
                let own: Vec<_> = own.iter().map(|of| vec![of.clone()]).collect();
                self.gather_bins(context, clusters, &own, (from, to), page)?;
                for height in 0..run.heights.len() {
                    let values = Values { offset: 0, first: page[1], bytes: context.plan.bin_bytes() };
                    let shares: Vec<_> = by_rank.iter().map(|shares| shares[height].clone()).collect();
                    context.complete(to.buffer(), values, &shares)?;
                }
            }
            self.gather_bins(context, clusters, by_all, (from, to), page)?;
        }
        Ok(Sources {
            class: run.class,
            indices: run.range(),
            antiradiance: antiradiance.unwrap_or(none),
            specular: specular.unwrap_or(none),
        })
    }

    fn gather_radiance(
        &self,
        context: &Context,
        clusters: &Clusters,
        of: &Range<u32>,
        triangles: bool,
        batch: &mut Batch,
    ) -> Result<(), TransportError> {
        let Context { scene, outgoing, .. } = context;
        let push = GatherPush {
            begin: of.start,
            end: of.end,
            clusters: clusters.first(),
            triangles: u32::from(triangles),
            moments: context.plan.sources(),
        };
        let parts = scene.cluster_parts()?.whole();
        let buffers = [scene.facets.whole(), parts, outgoing.radiance.whole()];
        let groups = [(of.len() as u32).div_ceil(WORKGROUP), 1, 1];
        Ok(batch.dispatch(&self.gather, "radiance", &buffers, bytes_of(&push), groups)?)
    }

    /// The bins of some clusters, by height, from those of triangles in a page, and of clusters in the same page as the result. `pages`: the
    /// indices with which both begin.
    fn gather_bins(
        &self,
        context: &Context,
        clusters: &Clusters,
        heights: &[Vec<Range<u32>>],
        (from, to): (BufferSlice, BufferSlice),
        pages: [u32; 2],
    ) -> Result<(), TransportError> {
        let Context { device, scene, .. } = context;
        let mut batch = device.batch()?;
        for (height, of) in heights.iter().enumerate() {
            let (from, from_page) = if height == 0 { (from, pages[0]) } else { (to, pages[1]) };
            let buffers = [scene.facets.whole(), scene.cluster_parts()?.whole(), from, to];
            for of in of {
                for begin in of.clone().step_by(MOST_GROUPS) {
                    let push = GatherBinsPush {
                        begin,
                        clusters: clusters.first(),
                        triangles: u32::from(height == 0),
                        from_page,
                        to_page: pages[1],
                    };
                    let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
                    batch.dispatch(&self.gather_bins, "bins", &buffers, bytes_of(&push), groups)?;
                }
            }
        }
        batch.defer()?;
        Ok(())
    }
}

/// The clusters of the scene, and of one group.
pub(super) fn clusters_of(plan: &Plan, group: usize) -> Result<(&Clusters, &ClusterRun), TransportError> {
    let of = plan.clusters().and_then(|clusters| Some((clusters, clusters.runs().get(group)?)));
    of.ok_or_else(|| TransportError::missing("clusters"))
}

/// Room for the bins of the clusters of any group of some classes. `None` where there is none.
pub(super) fn page(
    device: &Device,
    plan: &Plan,
    label: &str,
    wanted: fn(&Class) -> bool,
) -> Result<Option<Buffer>, GpuError> {
    let bytes = plan.cluster_page_bytes(wanted);
    (bytes > 0).then(|| Buffer::new(device, label, bytes, BufferKind::Storage)).transpose()
}
