//! The light of clusters, gathered from their parts, height by height.

use super::residency::Part;
use super::state::State;
use super::watch::TransportError;
use super::{Context, WORKGROUP, bin_constants};
use crate::gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError, Pipeline};
use crate::model::{Class, ClusterRun, Clusters};
use crate::plan::Plan;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `GatherPush` of glsl/gather.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GatherPush {
    /// First cluster of the dispatch.
    pub begin: u32,
    /// One past the last.
    pub end: u32,
    /// Index of the first cluster of all.
    pub clusters: u32,
    /// 1 if their parts are triangles.
    pub triangles: u32,
    /// Index of the first moment, three for each cluster.
    pub moments: u32,
}

/// `GatherBinsPush` of glsl/gather_bins.comp.
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

/// The bins of the clusters of one group.
struct RunBins {
    antiradiance: Option<Buffer>,
    specular: Option<Buffer>,
}

pub struct ClusterLight {
    gather: Pipeline,
    gather_bins: Pipeline,
    bins: Vec<RunBins>,
}

impl ClusterLight {
    /// `None` where no clusters are planned.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(clusters) = plan.clusters() else { return Ok(None) };
        let precision = plan.settings.precision;
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let (push, bins_push) = (size_of::<GatherPush>() as u32, size_of::<GatherBinsPush>() as u32);
        let (gather, gather_bins) = (shaders::GATHER.of(precision), shaders::GATHER_BINS.of(precision));
        let run_bins = |run: &ClusterRun| {
            let bytes = run.range().len() as u64 * plan.bin_bytes();
            let buffer = |label: &str| Buffer::new(device, label, bytes, BufferKind::Storage);
            Ok(RunBins {
                antiradiance: run.class.blocker.then(|| buffer("cluster antiradiance")).transpose()?,
                specular: run.class.glossy.then(|| buffer("cluster specular")).transpose()?,
            })
        };
        Ok(Some(Self {
            gather: Pipeline::new(device, gather, 3, push, &[(0, WORKGROUP)], None)?,
            gather_bins: Pipeline::new(device, gather_bins, 4, bins_push, &constants, None)?,
            bins: clusters.runs().iter().map(run_bins).collect::<Result<_, GpuError>>()?,
        }))
    }

    /// Computes the light of all clusters from that of triangles, and lists all sources: triangles and clusters.
    pub fn gather<'a>(
        &'a self,
        context: &'a Context,
        x: Option<&'a State>,
    ) -> Result<Vec<Sources<'a>>, TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let Some(clusters) = plan.clusters() else { return Err(TransportError::missing("clusters")) };
        let none = scene.no_bins.whole();
        let mut sources = Vec::new();
        for (g, group) in plan.layout.groups.iter().enumerate() {
            let light = x.zip(Part::of_group(plan, g, group).filter(|_| group.class.blocker));
            let light = light.map(|(x, part)| x.show(device, &part)).transpose()?;
            sources.push(Sources {
                class: group.class,
                indices: plan.layout.slots_of(&group.tiles),
                antiradiance: light.map_or(none, |view| view.slice()),
                specular: if group.class.glossy { outgoing.specular_of(g)?.whole() } else { none },
            });
        }
        let mut batch = device.batch()?;
        for (g, (run, bins)) in clusters.runs().iter().zip(&self.bins).enumerate() {
            for (height, of) in run.heights.iter().enumerate() {
                self.gather_radiance(context, clusters, of, height == 0, &mut batch)?;
            }
            let antiradiance = bins.antiradiance.as_ref().filter(|_| x.is_some());
            let read = [
                (antiradiance, (|from: &Sources<'a>| from.antiradiance) as fn(&Sources<'a>) -> _),
                (bins.specular.as_ref(), |from: &Sources<'a>| from.specular),
            ];
            for (to, of_triangles) in read {
                let Some(to) = to.map(Buffer::whole) else { continue };
                let first = run.range().start;
                for (height, of) in run.heights.iter().enumerate() {
                    let triangles = (of_triangles(&sources[g]), sources[g].indices.start);
                    let from = (height == 0).then_some(triangles);
                    self.gather_bins(context, clusters, of, from, (to, first), &mut batch)?;
                }
            }
            sources.push(Sources {
                class: run.class,
                indices: run.range(),
                antiradiance: antiradiance.map_or(none, Buffer::whole),
                specular: bins.specular.as_ref().map_or(none, Buffer::whole),
            });
        }
        batch.submit()?;
        Ok(sources)
    }

    fn gather_radiance<'a>(
        &'a self,
        context: &'a Context,
        clusters: &Clusters,
        of: &Range<u32>,
        triangles: bool,
        batch: &mut Batch<'a>,
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

    /// From the bins of triangles in a page, or of clusters in the same page as the result.
    fn gather_bins<'a>(
        &'a self,
        context: &'a Context,
        clusters: &Clusters,
        of: &Range<u32>,
        from: Option<(BufferSlice<'a>, u32)>,
        to: (BufferSlice<'a>, u32),
        batch: &mut Batch<'a>,
    ) -> Result<(), TransportError> {
        let (bins, from_page) = from.unwrap_or(to);
        let scene = &context.scene;
        let buffers = [scene.facets.whole(), scene.cluster_parts()?.whole(), bins, to.0];
        for begin in of.clone().step_by(MOST_GROUPS) {
            let push = GatherBinsPush {
                begin,
                clusters: clusters.first(),
                triangles: u32::from(from.is_some()),
                from_page,
                to_page: to.1,
            };
            let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
            batch.dispatch(&self.gather_bins, "bins", &buffers, bytes_of(&push), groups)?;
        }
        Ok(())
    }
}
