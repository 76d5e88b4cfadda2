//! The light of volume clusters, from that of their triangles, page by page, and height by height.

use super::clusters::{GatherBinsPush, MOST_GROUPS, Sources};
use super::completion::Values;
use super::scene_buffers::filled;
use super::{Context, WORKGROUP, bin_constants};
use crate::model::{Class, VolumeParts, Volumes};
use crate::plan::Plan;
use crate::shaders;
use crate::transport::TransportError;
use antirad_gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `VolumePush` of crates/core/glsl/volume_bins.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct VolumePush {
    /// First volume of the dispatch.
    pub begin: u32,
    /// Index of the first volume of all.
    pub volumes: u32,
    /// First slot of the page of triangles.
    pub slot_begin: u32,
    /// One past the last slot of the page of triangles.
    pub slot_end: u32,
    /// 1 if backs send antiradiance.
    pub backs: u32,
}

/// The intensities of all volumes per bin, over ā.
pub struct VolumeLight {
    /// Kernels that gather intensities, by the class of the triangles.
    gather: Vec<(Class, Pipeline)>,
    sum: Pipeline,
    parts: Buffer,
    slots: Buffer,
    /// Below the horizon, as antiradiance of the opposite direction, and above.
    below: Buffer,
    above: Buffer,
}

impl VolumeLight {
    /// `None` where no volumes are planned.
    ///
    /// # Errors
    /// Fails if the device cannot compile a kernel, or has no memory for a buffer.
    pub fn new(device: &Device, plan: &Plan) -> Result<Option<Self>, GpuError> {
        let Some(volumes) = volumes_of(plan) else { return Ok(None) };
        let words: Vec<[u32; 2]> = volumes.parts().iter().map(words).collect();
        let bytes = volumes.parts().len() as u64 * plan.bin_bytes();
        let bins = || Buffer::new(device, "volume bins", bytes, BufferKind::Storage);
        let (shader, push) =
            (shaders::GATHER_BINS.of(plan.settings.precision), size_of::<GatherBinsPush>() as u32);
        Ok(Some(Self {
            gather: Self::kernels(device, plan)?,
            sum: Pipeline::new(device, shader, 4, push, &constants(plan))?,
            parts: filled(device, "volume parts", &words)?,
            slots: filled(device, "volume slots", volumes.slots())?,
            below: bins()?,
            above: bins()?,
        }))
    }

    /// Compiles the kernels that gather what triangles send, by class; none where no volumes are planned.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<Vec<(Class, Pipeline)>, GpuError> {
        let mut classes: Vec<Class> = plan.layout.groups.iter().map(|group| group.class).collect();
        classes.retain(|class| class.has_bins() && volumes_of(plan).is_some());
        classes.dedup();
        let of = |class: Class| {
            let own = [(7, u32::from(class.blocker)), (8, u32::from(class.glossy))];
            let constants = [&constants(plan)[..], &own].concat();
            let (shader, push) =
                (shaders::VOLUME_BINS.of(plan.settings.precision), size_of::<VolumePush>() as u32);
            Ok((class, Pipeline::new(device, shader, 9, push, &constants)?))
        };
        classes.into_iter().map(of).collect()
    }

    /// Sets all light to zero.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn clear(&self, context: &Context) -> Result<(), TransportError> {
        let mut batch = context.device.batch()?;
        for bins in [&self.below, &self.above] {
            batch.fill(bins, 0, bins.bytes(), 0)?;
        }
        batch.defer()?;
        Ok(())
    }

    /// Adds what triangles of a page send; with `backs`, their backs, too.
    ///
    /// # Errors
    /// Fails if the plan has no volumes, or if the device fails.
    pub fn add(&self, context: &Context, from: &Sources, backs: bool) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let volumes = volumes_of(plan).ok_or_else(|| TransportError::missing("volumes"))?;
        let Some((_, gather)) = self.gather.iter().find(|(class, _)| *class == from.class) else {
            // Such triangles are in no volume.
            return Ok(());
        };
        let facets = scene.facets.whole();
        let sent = [outgoing.radiance.whole(), from.antiradiance, from.specular, scene.bin_table.whole()];
        let shares = shares(plan, volumes);
        let Some(of) = shares.get(plan.options.rank as usize) else { return Ok(()) };
        let [radiance, antiradiance, specular, bin_table] = sent;
        let [parts, slots, below, above] =
            [&self.parts, &self.slots, &self.below, &self.above].map(Buffer::whole);
        let buffers = [facets, parts, slots, radiance, antiradiance, specular, bin_table, below, above];
        let run = volumes.run();
        let mut batch = device.batch()?;
        for begin in of.clone().step_by(MOST_GROUPS) {
            let push = VolumePush {
                begin,
                volumes: run.range().start,
                slot_begin: from.indices.start,
                slot_end: from.indices.end,
                backs: u32::from(backs),
            };
            let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
            batch.dispatch(gather, "intensities", &buffers, bytes_of(&push), groups)?;
        }
        batch.defer()?;
        Ok(())
    }

    /// Sums up volumes that consist of others, from those of triangles, of which each rank has a share.
    ///
    /// # Errors
    /// Fails if the plan has no volumes, if the device fails, or if another rank has ended.
    pub fn sum(&self, context: &Context) -> Result<(), TransportError> {
        let Context { device, plan, scene, .. } = context;
        let volumes = volumes_of(plan).ok_or_else(|| TransportError::missing("volumes"))?;
        let (run, facets) = (volumes.run(), scene.facets.whole());
        let first = run.range().start;
        for bins in [&self.below, &self.above] {
            let values = Values { offset: 0, first, bytes: plan.bin_bytes() };
            context.complete(bins, values, &shares(plan, volumes))?;
        }
        let mut batch = device.batch()?;
        for of in run.heights.iter().skip(1) {
            for own in [self.below.whole(), self.above.whole()] {
                let buffers = [facets, self.parts.whole(), own, own];
                for begin in of.clone().step_by(MOST_GROUPS) {
                    let push = GatherBinsPush {
                        begin,
                        clusters: first,
                        triangles: 0,
                        from_page: first,
                        to_page: first,
                    };
                    let groups = [(of.end - begin).min(MOST_GROUPS as u32), 1, 1];
                    batch.dispatch(&self.sum, "volumes", &buffers, bytes_of(&push), groups)?;
                }
            }
        }
        batch.defer()?;
        Ok(())
    }

    /// All volume clusters as sources.
    ///
    /// # Errors
    /// Fails if the plan has no volumes.
    pub fn sources(&self, plan: &Plan) -> Result<Sources<'_>, TransportError> {
        let run = volumes_of(plan).ok_or_else(|| TransportError::missing("volumes"))?.run();
        let [antiradiance, specular] = [self.below.whole(), self.above.whole()];
        Ok(Sources { class: run.class, indices: run.range(), antiradiance, specular })
    }
}

fn constants(plan: &Plan) -> Vec<(u32, u32)> {
    [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat()
}

fn volumes_of(plan: &Plan) -> Option<&Volumes> {
    plan.clusters()?.volumes()
}

fn words(parts: &VolumeParts) -> [u32; 2] {
    match parts {
        VolumeParts::Triangles(at) => [at.start, at.end],
        VolumeParts::Volumes(both) => *both,
    }
}

/// The volumes of triangles that each rank computes, by its number: about as many triangles each.
fn shares(plan: &Plan, volumes: &Volumes) -> Vec<Range<u32>> {
    let of = volumes.run().heights.first().map_or(0..0, Range::clone);
    let ranks = u64::from(plan.options.ranks);
    let bound = |rank: u64| of.start + (of.len() as u64 * rank / ranks) as u32;
    (0..ranks).map(|rank| bound(rank)..bound(rank + 1)).collect()
}
