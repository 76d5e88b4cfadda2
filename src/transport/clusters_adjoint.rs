//! The cotangents of the light of clusters, passed on to their parts, height by height.

use super::clusters::{GatherBinsPush, GatherPush, MOST_GROUPS, Sources};
use super::watch::TransportError;
use super::{Context, WORKGROUP, bin_constants};
use crate::gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError, Pipeline};
use crate::model::{Class, Clusters};
use crate::plan::Plan;
use crate::shaders;
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `SharesPush` of glsl/cluster_shares.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct SharesPush {
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
    /// Index of the first moment in the radiance of sources, three for each cluster.
    pub moments: u32,
    /// The same in the cotangents of clusters.
    pub cotangent_moments: u32,
}

/// The cotangents of the bins of the clusters of one group.
pub struct RunCotangents {
    pub class: Class,
    pub indices: Range<u32>,
    /// Of H(b) behind the antiradiance, as in a state of the adjoint.
    pub antiradiance: Option<Buffer>,
    pub specular: Option<Buffer>,
    heights: Vec<Range<u32>>,
}

pub struct ClusterCotangents {
    scatter: Pipeline,
    scatter_bins: Pipeline,
    /// By class: of irradiance alone, blockers, glossy ones, and both. `None` unless geometry is differentiated.
    shares: Option<[Pipeline; 4]>,
    /// Of diffuse radiance, vec4 per cluster; then of its first moments, three per cluster.
    pub radiance: Buffer,
    pub runs: Vec<RunCotangents>,
}

impl ClusterCotangents {
    /// `None` where no clusters are planned.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(clusters) = plan.clusters() else { return Ok(None) };
        let precision = plan.settings.precision;
        let buffer = |label: &str, bytes: u64| Buffer::new(device, label, bytes, BufferKind::Storage);
        let mut runs = Vec::new();
        for run in clusters.runs() {
            let bins = || buffer("cotangent: cluster bins", run.range().len() as u64 * plan.bin_bytes());
            runs.push(RunCotangents {
                class: run.class,
                indices: run.range(),
                antiradiance: run.class.blocker.then(bins).transpose()?,
                specular: run.class.glossy.then(bins).transpose()?,
                heights: run.heights.clone(),
            });
        }
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let (push, bins_push) = (size_of::<GatherPush>() as u32, size_of::<GatherBinsPush>() as u32);
        let (scatter, scatter_bins) = (shaders::SCATTER.of(precision), shaders::SCATTER_BINS.of(precision));
        let of_class = |blocker: u32, glossy: u32| {
            let constants = [&constants[..], &[(7, blocker), (8, glossy), (13, WORKGROUP)]].concat();
            let push = size_of::<SharesPush>() as u32;
            Pipeline::new(device, shaders::CLUSTER_SHARES.of(precision), 10, push, &constants, None)
        };
        let shares =
            || Ok::<_, GpuError>([of_class(0, 0)?, of_class(1, 0)?, of_class(0, 1)?, of_class(1, 1)?]);
        Ok(Some(Self {
            shares: plan.options.gradients.geometry().then(shares).transpose()?,
            scatter: Pipeline::new(device, scatter, 4, push, &[(0, WORKGROUP)], None)?,
            scatter_bins: Pipeline::new(device, scatter_bins, 4, bins_push, &constants, None)?,
            radiance: buffer("cotangent: clusters", 4 * u64::from(clusters.count()) * plan.rgb_bytes())?,
            runs,
        }))
    }

    /// Sets all to zero.
    pub fn clear(&self, device: &Device) -> Result<(), GpuError> {
        let bins = self.runs.iter().flat_map(|run| [&run.antiradiance, &run.specular]).flatten();
        let mut batch = device.batch()?;
        for buffer in bins.chain([&self.radiance]) {
            batch.fill(buffer, 0, buffer.bytes(), 0)?;
        }
        batch.submit()?;
        Ok(())
    }

    /// Adds to the cotangents of clusters those that come through the clusters they are part of.
    pub fn within<'a>(&'a self, context: &'a Context) -> Result<(), TransportError> {
        let Some(clusters) = context.plan.clusters() else { return Ok(()) };
        let mut batch = context.device.batch()?;
        for run in &self.runs {
            for of in run.heights.iter().skip(1).rev() {
                self.scatter_radiance(context, clusters, of, false, &mut batch)?;
                for bins in [&run.antiradiance, &run.specular].into_iter().flatten() {
                    let own = (bins.whole(), run.indices.start);
                    self.scatter_bins(context, clusters, of, own, None, &mut batch)?;
                }
            }
        }
        batch.submit()?;
        Ok(())
    }

    /// Sets the derivative by the share of each part in the light of its cluster, in `gradients`, and adds that by the centroids between
    /// which the first moment is taken; `sources` is the current light.
    pub fn shares(
        &self,
        context: &Context,
        sources: &[Sources],
        gradients: &Buffer,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let Some(shares) = &self.shares else { return Err(TransportError::missing("shares of clusters")) };
        let first = plan.layout.slots();
        let none = scene.no_bins.whole();
        let (triangles, of_clusters) = sources.split_at(plan.layout.groups.len());
        let mut batch = device.batch()?;
        for ((run, own), triangles) in self.runs.iter().zip(of_clusters).zip(triangles) {
            let kernel = &shares[usize::from(run.class.blocker) + 2 * usize::from(run.class.glossy)];
            for (height, of) in run.heights.iter().enumerate() {
                let from = if height == 0 { triangles } else { own };
                let buffers = [
                    scene.cluster_parts()?.whole(),
                    outgoing.radiance.whole(),
                    self.radiance.whole(),
                    from.antiradiance,
                    from.specular,
                    run.antiradiance.as_ref().map_or(none, Buffer::whole),
                    run.specular.as_ref().map_or(none, Buffer::whole),
                    scene.bin_table.whole(),
                    gradients.whole(),
                    scene.facets.whole(),
                ];
                for begin in of.clone().step_by(MOST_GROUPS) {
                    let push = SharesPush {
                        begin,
                        clusters: first,
                        triangles: u32::from(height == 0),
                        from_page: from.indices.start,
                        to_page: run.indices.start,
                        moments: plan.sources(),
                        cotangent_moments: plan.sources() - first,
                    };
                    let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
                    batch.dispatch(kernel, "all", &buffers, bytes_of(&push), groups)?;
                }
            }
        }
        batch.submit()?;
        Ok(())
    }

    /// Adds those of clusters of triangles to those of the triangles; `back` and `front` are the bins of a group.
    pub fn to_triangles<'a>(
        &'a self,
        context: &'a Context,
        back: impl Fn(usize) -> Result<BufferSlice<'a>, TransportError>,
        front: impl Fn(usize) -> Result<BufferSlice<'a>, TransportError>,
    ) -> Result<(), TransportError> {
        let Some(clusters) = context.plan.clusters() else { return Ok(()) };
        let mut batch = context.device.batch()?;
        let layout = &context.plan.layout;
        for (g, (run, group)) in self.runs.iter().zip(&layout.groups).enumerate() {
            let Some(of) = run.heights.first() else { continue };
            self.scatter_radiance(context, clusters, of, true, &mut batch)?;
            let page = layout.slots_of(&group.tiles).start;
            if let Some(bins) = &run.antiradiance {
                let (own, to) = ((bins.whole(), run.indices.start), Some((back(g)?, page)));
                self.scatter_bins(context, clusters, of, own, to, &mut batch)?;
            }
            if let Some(bins) = &run.specular {
                let (own, to) = ((bins.whole(), run.indices.start), Some((front(g)?, page)));
                self.scatter_bins(context, clusters, of, own, to, &mut batch)?;
            }
        }
        batch.submit()?;
        Ok(())
    }

    fn scatter_radiance<'a>(
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
            moments: clusters.count(),
        };
        let parts = scene.cluster_parts()?;
        let buffers = [scene.facets.whole(), parts.whole(), self.radiance.whole(), outgoing.radiance.whole()];
        let groups = [(of.len() as u32).div_ceil(WORKGROUP), 1, 1];
        Ok(batch.dispatch(&self.scatter, "radiance", &buffers, bytes_of(&push), groups)?)
    }

    /// From a page of clusters to that of triangles, or to the same page. Each with the index of its first.
    fn scatter_bins<'a>(
        &'a self,
        context: &'a Context,
        clusters: &Clusters,
        of: &Range<u32>,
        from: (BufferSlice<'a>, u32),
        triangles: Option<(BufferSlice<'a>, u32)>,
        batch: &mut Batch<'a>,
    ) -> Result<(), TransportError> {
        let (to, to_page) = triangles.unwrap_or(from);
        let scene = &context.scene;
        let buffers = [scene.facets.whole(), scene.cluster_parts()?.whole(), from.0, to];
        for begin in of.clone().step_by(MOST_GROUPS) {
            let push = GatherBinsPush {
                begin,
                clusters: clusters.first(),
                triangles: u32::from(triangles.is_some()),
                from_page: from.1,
                to_page,
            };
            let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
            batch.dispatch(&self.scatter_bins, "bins", &buffers, bytes_of(&push), groups)?;
        }
        Ok(())
    }
}
