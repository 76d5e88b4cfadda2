//! The cotangents of the light of clusters, passed on to their parts from the top of the tree down.

use super::clusters::{GatherBinsPush, GatherPush, MOST_GROUPS, Sources, clusters_of, page};
use super::{Context, WORKGROUP, bin_constants};
use crate::model::{Class, Clusters};
use crate::plan::Plan;
use crate::shaders;
use crate::transport::TransportError;
use antirad_gpu::{Batch, Buffer, BufferKind, BufferSlice, Device, GpuError, Pipeline};
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `SharesPush` of crates/core/glsl/cluster_shares.comp.
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
    /// Index of the first moment in the cotangents of clusters, three for each cluster.
    pub cotangent_moments: u32,
}

/// The cotangents of the light of clusters. Those of bins are of one group at a time.
pub struct ClusterCotangents {
    scatter: Pipeline,
    scatter_bins: Pipeline,
    /// Kernels by class: of irradiance alone, blockers, glossy ones, and both. `None` unless geometry is
    /// differentiated.
    shares: Option<[Pipeline; 4]>,
    /// Cotangents of diffuse radiance, vec4 per cluster; then of its first moments, three per cluster.
    pub radiance: Buffer,
    /// Cotangents of H(b) behind the antiradiance, as in a state of the adjoint, and of specular radiance.
    /// Both have room for the group that has most clusters.
    antiradiance: Option<Buffer>,
    specular: Option<Buffer>,
}

impl ClusterCotangents {
    /// `None` where no clusters are planned.
    ///
    /// # Errors
    /// Fails if the device cannot compile a kernel, or has no memory for a buffer.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(clusters) = plan.clusters() else { return Ok(None) };
        let shares = || Self::share_kernels(device, plan);
        let radiance = 4 * u64::from(clusters.count()) * plan.rgb_bytes();
        let bins = |wanted| page(device, plan, "cotangent: cluster bins", wanted);
        let [scatter, scatter_bins] = Self::kernels(device, plan)?;
        Ok(Some(Self {
            shares: plan.options.gradients.geometry().then(shares).transpose()?,
            scatter,
            scatter_bins,
            radiance: Buffer::new(device, "cotangent: clusters", radiance, BufferKind::Storage)?,
            antiradiance: bins(|class| class.blocker)?,
            specular: bins(|class| class.glossy)?,
        }))
    }

    /// Compiles the kernels that scatter cotangents of diffuse radiance to parts, and those of bins.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<[Pipeline; 2], GpuError> {
        let precision = plan.settings.precision;
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let (push, bins_push) = (size_of::<GatherPush>() as u32, size_of::<GatherBinsPush>() as u32);
        let (scatter, scatter_bins) = (shaders::SCATTER.of(precision), shaders::SCATTER_BINS.of(precision));
        Ok([
            Pipeline::new(device, scatter, 4, push, &[(0, WORKGROUP)])?,
            Pipeline::new(device, scatter_bins, 4, bins_push, &constants)?,
        ])
    }

    /// Compiles the kernels that differentiate by the shares of parts, by class: of irradiance alone,
    /// blockers, glossy ones, and both.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn share_kernels(device: &Device, plan: &Plan) -> Result<[Pipeline; 4], GpuError> {
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let of_class = |blocker: u32, glossy: u32| {
            let constants = [&constants[..], &[(7, blocker), (8, glossy), (13, WORKGROUP)]].concat();
            let (shader, push) = (&shaders::CLUSTER_SHARES, size_of::<SharesPush>() as u32);
            Pipeline::new(device, shader.of(plan.settings.precision), 10, push, &constants)
        };
        Ok([of_class(0, 0)?, of_class(1, 0)?, of_class(0, 1)?, of_class(1, 1)?])
    }

    /// The cotangents of the antiradiance and of the specular radiance of clusters of a class; `None` where
    /// it has none.
    pub fn bins(&self, class: Class) -> [Option<&Buffer>; 2] {
        [
            self.antiradiance.as_ref().filter(|_| class.blocker),
            self.specular.as_ref().filter(|_| class.glossy),
        ]
    }

    /// Sets the cotangents of the light of the clusters of a group to zero.
    ///
    /// # Errors
    /// Fails if the plan has no clusters, or if the device fails.
    pub fn clear(&self, context: &Context, group: usize) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let (clusters, run) = clusters_of(plan, group)?;
        let (first, count) = (u64::from(run.range().start - clusters.first()), run.range().len() as u64);
        let (all, rgb) = (u64::from(clusters.count()), plan.rgb_bytes());
        let mut batch = device.batch()?;
        batch.fill(&self.radiance, first * rgb, count * rgb, 0)?;
        batch.fill(&self.radiance, (all + 3 * first) * rgb, 3 * count * rgb, 0)?;
        for bins in self.bins(run.class).into_iter().flatten() {
            batch.fill(bins, 0, count * plan.bin_bytes(), 0)?;
        }
        batch.defer()?;
        Ok(())
    }

    /// Adds to the cotangents of the clusters of a group those of the clusters that contain them, from the
    /// top of the tree down.
    ///
    /// # Errors
    /// Fails if the plan has no clusters, or if the device fails.
    pub fn within<'a>(&'a self, context: &'a Context, group: usize) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let (clusters, run) = clusters_of(plan, group)?;
        let by_kernels: Vec<_> = self
            .bins(run.class)
            .into_iter()
            .flatten()
            .map(|bins| (bins.whole(), run.range().start))
            .collect();
        let mut batch = device.batch()?;
        for of in run.heights.iter().skip(1).rev() {
            self.scatter_radiance(context, clusters, of, false, &mut batch)?;
            for &own in &by_kernels {
                self.scatter_bins(context, clusters, of, own, None, &mut batch)?;
            }
        }
        batch.defer()?;
        Ok(())
    }

    /// Sets the derivative by the share of each part in the light of its cluster, in `gradients`, and adds that by the centroids between
    /// which the first moment is taken, for the clusters of a group; `triangles` and `own` are the current light of both.
    pub fn shares(
        &self,
        context: &Context,
        group: usize,
        [triangles, own]: [&Sources; 2],
        gradients: &Buffer,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let Some(shares) = &self.shares else { return Err(TransportError::missing("shares of clusters")) };
        let (clusters, run) = clusters_of(plan, group)?;
        let first = clusters.first();
        let kernel = &shares[usize::from(run.class.blocker) + 2 * usize::from(run.class.glossy)];
        let [back, front] = self.bins(run.class).map(|bins| bins.unwrap_or(&scene.no_bins).whole());
        let mut batch = device.batch()?;
        for (height, of) in run.heights.iter().enumerate() {
            let from = if height == 0 { triangles } else { own };
            let buffers = [
                scene.cluster_parts()?.whole(),
                outgoing.radiance.whole(),
                self.radiance.whole(),
                from.antiradiance,
                from.specular,
                back,
                front,
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
                    to_page: run.range().start,
                    moments: plan.sources(),
                    cotangent_moments: plan.sources() - first,
                };
                let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
                batch.dispatch(kernel, "all", &buffers, bytes_of(&push), groups)?;
            }
        }
        batch.defer()?;
        Ok(())
    }

    /// Adds those of clusters of triangles to those of this rank's triangles of a group; `back` and `front` are the bins of the latter,
    /// which begin with a slot.
    pub fn to_triangles<'a>(
        &'a self,
        context: &'a Context,
        group: usize,
        ([back, front], page): ([BufferSlice<'a>; 2], u32),
    ) -> Result<(), TransportError> {
        let Context { device, plan, .. } = context;
        let (clusters, run) = clusters_of(plan, group)?;
        let of = &clusters.of_triangles(run, &plan.layout.slots_of(&plan.own(group).tiles));
        let by_kernels: Vec<_> = self.bins(run.class).into_iter().zip([back, front]).collect();
        let mut batch = device.batch()?;
        self.scatter_radiance(context, clusters, of, true, &mut batch)?;
        for (own, to) in by_kernels {
            let Some(own) = own else { continue };
            let own = (own.whole(), run.range().start);
            self.scatter_bins(context, clusters, of, own, Some((to, page)), &mut batch)?;
        }
        batch.defer()?;
        Ok(())
    }

    fn scatter_radiance(
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
            moments: clusters.count(),
        };
        let parts = scene.cluster_parts()?;
        let buffers = [scene.facets.whole(), parts.whole(), self.radiance.whole(), outgoing.radiance.whole()];
        let groups = [(of.len() as u32).div_ceil(WORKGROUP), 1, 1];
        Ok(batch.dispatch(&self.scatter, "radiance", &buffers, bytes_of(&push), groups)?)
    }

    /// Scatters cotangents of bins from a page of clusters to that of triangles, or to the same page. Each
    /// page comes with the index of its first entry.
    fn scatter_bins(
        &self,
        context: &Context,
        clusters: &Clusters,
        of: &Range<u32>,
        from: (BufferSlice, u32),
        triangles: Option<(BufferSlice, u32)>,
        batch: &mut Batch,
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
