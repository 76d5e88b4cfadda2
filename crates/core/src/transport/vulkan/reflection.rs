//! K and E: reflection of incident light, and emission.

use super::bundle::Bundle;
use super::bundle::PassMonitor;
use super::lobes::LobePush;
use super::residency::{Part, View};
use super::state::{State, page};
use super::{Context, WORKGROUP, bin_constants};
use crate::plan::{Piece, Plan};
use crate::shaders;
use crate::transport::TransportError;
use crate::transport::pace::Pace;
use antirad_gpu::{Batch, Bindings, BufferSlice, Device, GpuError, Pipeline};
use bytemuck::{Pod, Zeroable, bytes_of};
use std::ops::Range;

/// `ReflectPush` of crates/core/glsl/reflect.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct ReflectPush {
    /// Number of slots.
    pub count: u32,
    /// 1 to emit, 0 not to.
    pub emission: f32,
    /// 1 to reflect incident light, 0 not to.
    pub reflection: f32,
}

/// `GlossyPush` of crates/core/glsl/reflect_glossy.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct GlossyPush {
    /// First slot of the page.
    pub page: u32,
    /// The first triangle, among the slots by power.
    pub list: u32,
    /// The first pair of triangle and bin, from there on, that this dispatch computes.
    pub first: u32,
    /// Number of pairs of triangle and bin that this dispatch computes.
    pub count: u32,
}

/// `FirstBouncePush` of crates/core/glsl/first_bounce.comp.
#[repr(C)]
#[derive(Clone, Copy, Debug, Pod, Zeroable)]
pub struct FirstBouncePush {
    /// The first value for the piece.
    pub offset: u32,
    /// Number of values of the piece.
    pub count: u32,
    /// 1 to add to what is there, 0 to replace it.
    pub add: u32,
}

/// Workgroups of the kernel that adds the first bounce.
const FIRST_BOUNCE_GROUPS: u32 = 256;

pub struct Reflection {
    diffuse: Pipeline,
    /// Only where something glossy is lit by lamps.
    first_bounce: Option<Pipeline>,
    /// Whether specular radiance contains the first bounce of lamps.
    pub with_first_bounce: bool,
    /// Lobes pair by pair of bins. Only where something is glossy.
    glossy: Option<Pipeline>,
    /// Lobes by matrix. Only where some are planned.
    lobes: Option<Pipeline>,
    /// Paces of the two, in pairs of bins.
    pace: Pace,
    lobes_pace: Pace,
}

impl Reflection {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let precision = plan.settings.precision;
        let any_glossy = plan.layout.groups.iter().any(|g| g.class.glossy);
        let constants = [&[(0, WORKGROUP)][..], &bin_constants(plan)].concat();
        let glossy = || {
            Pipeline::new(
                device,
                shaders::REFLECT_GLOSSY.of(precision),
                5,
                size_of::<GlossyPush>() as u32,
                &constants,
            )
        };
        let lobes = || {
            let bindings = Bindings { storage: 4, uniform: 1 };
            let push = size_of::<LobePush>() as u32;
            Pipeline::new(device, shaders::REFLECT_LOBES.of(precision), bindings, push, &constants)
        };
        let first_bounce = || {
            let push = size_of::<FirstBouncePush>() as u32;
            Pipeline::new(device, shaders::FIRST_BOUNCE.of(precision), 2, push, &[(0, WORKGROUP)])
        };
        let push = size_of::<ReflectPush>() as u32;
        Ok(Self {
            diffuse: Pipeline::new(device, shaders::REFLECT.of(precision), 3, push, &[(0, WORKGROUP)])?,
            first_bounce: plan.has_first_bounce().then(first_bounce).transpose()?,
            with_first_bounce: false,
            glossy: any_glossy.then(glossy).transpose()?,
            lobes: (plan.lobes.matrices > 0).then(lobes).transpose()?,
            pace: Pace::new(2e7),
            lobes_pace: Pace::new(2e8),
        })
    }

    /// The diffuse radiance of the fronts under `x`, or of their emission alone.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn diffuse(
        &self,
        context: &Context,
        x: Option<&State>,
        emission: bool,
    ) -> Result<(), TransportError> {
        let mut batch = context.device.batch()?;
        self.record_diffuse(context, x, emission, &mut batch)?;
        batch.defer()?;
        Ok(())
    }

    /// Records in `batch` the diffuse radiance of the fronts under `x`, or of their emission alone.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn record_diffuse(
        &self,
        context: &Context,
        x: Option<&State>,
        emission: bool,
        batch: &mut Batch,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let slots = plan.layout.slots();
        let push = ReflectPush {
            count: slots,
            emission: if emission { 1.0 } else { 0.0 },
            reflection: if x.is_some() { 1.0 } else { 0.0 },
        };
        // Something must be bound even without a state; it is not read.
        let irradiance = x.map(|x| x.show(device, &Part::irradiance(plan))).transpose()?;
        let incident = irradiance.map_or(scene.no_bins.whole(), |view| view.slice());
        let buffers = [scene.surfaces.whole(), incident, outgoing.radiance.whole()];
        let groups = [slots.div_ceil(WORKGROUP), 1, 1];
        Ok(batch.dispatch(&self.diffuse, "all", &buffers, bytes_of(&push), groups)?)
    }

    /// The specular radiance of a piece of the sources. All ranks call it.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if the callback stops the pass.
    pub fn specular<'a>(
        &mut self,
        context: &'a Context,
        piece: &Piece,
        x: Option<&State>,
        monitor: &mut PassMonitor,
    ) -> Result<BufferSlice<'a>, TransportError> {
        let part = Part::of_piece(&context.plan, piece).filter(|_| piece.part.class.glossy);
        let light = x.zip(part).map(|(x, part)| x.show(&context.device, &part)).transpose()?;
        self.specular_under(context, piece, light.as_ref(), monitor)
    }

    /// The specular radiance of a piece of the sources, computed by this rank alone from incident light that
    /// is already on the device. Where states live on the host, it replaces the radiance of the previous
    /// piece.
    ///
    /// # Errors
    /// Fails if the device does, or if the callback stops the pass.
    pub fn specular_under<'a>(
        &mut self,
        context: &'a Context,
        piece: &Piece,
        light: Option<&View>,
        monitor: &mut PassMonitor,
    ) -> Result<BufferSlice<'a>, TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        if !piece.part.class.glossy {
            return Ok(scene.no_bins.whole());
        }
        let specular = outgoing.specular_of(piece.group)?;
        let slots = plan.layout.slots_of(&piece.part.tiles);
        let Some(light) = light else {
            if !self.add_first_bounce(context, piece, false)? {
                View::resident(specular, slots.start, plan.page_bytes(&piece.part)).clear(device)?;
            }
            return Ok(specular.whole());
        };
        self.reflect(context, piece, &slots, light, monitor)?;
        self.add_first_bounce(context, piece, true)?;
        Ok(specular.whole())
    }

    /// Reflects the incident light of some slots of a glossy piece, specularly.
    fn reflect(
        &mut self,
        context: &Context,
        piece: &Piece,
        slots: &Range<u32>,
        light: &View,
        monitor: &mut PassMonitor,
    ) -> Result<(), TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let missing = || TransportError::missing("specular reflection");
        let kernel = self.glossy.as_ref().ok_or_else(missing)?;
        // The light may begin later than the piece.
        let page = light.first_slot;
        let begin = page - plan.layout.slots_of(&piece.part.tiles).start;
        let at = u64::from(begin) * plan.bin_bytes();
        let specular = outgoing.specular_of(piece.group)?.slice(at, plan.page_bytes(&piece.part) - at);
        let by_power = scene.lobes.slots(&scene.no_bins);
        let mut bundle = Bundle::new(device, &self.lobes_pace, monitor);
        for product in scene.lobes.products(plan, page, slots) {
            let kernel = self.lobes.as_ref().ok_or_else(missing)?;
            let buffers = [by_power, scene.surfaces.whole(), light.slice(), specular, product.forward];
            bundle.add(product.pairs(), 0, |batch| {
                batch.dispatch(kernel, "by matrix", &buffers, bytes_of(&product.push), product.groups())
            })?;
        }
        bundle.end()?;
        let buffers = [scene.surfaces.whole(), scene.bin_table.whole(), light.slice(), specular, by_power];
        let each = plan.bins.count() as u64;
        let direct = scene.lobes.direct(slots);
        let bins = direct.len() as u32 * plan.bins.count() as u32;
        let mut bundle = Bundle::new(device, &self.pace, monitor);
        let mut first = 0;
        while first < bins {
            let groups = bundle.share((bins - first).div_ceil(WORKGROUP), u64::from(WORKGROUP) * each);
            let count = (bins - first).min(groups * WORKGROUP);
            let push = GlossyPush { page, list: direct.start, first, count };
            bundle.add(u64::from(count) * each, 0, |batch| {
                batch.dispatch(kernel, "bins to bins", &buffers, bytes_of(&push), [groups, 1, 1])
            })?;
            first += count;
        }
        bundle.end()?;
        Ok(())
    }

    /// Adds what a piece reflects of the light of lamps, or replaces its radiance by that; false where there is none.
    fn add_first_bounce(&self, context: &Context, piece: &Piece, add: bool) -> Result<bool, TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let Some(kernel) = self.first_bounce.as_ref().filter(|_| self.with_first_bounce) else {
            return Ok(false);
        };
        let slots = plan.layout.slots_of(&piece.part.tiles);
        let first = plan.layout.slots_of(&plan.layout.groups[piece.group].tiles).start;
        let per_slot = plan.bins.count() as u32 * plan.channels;
        let push = FirstBouncePush {
            offset: (slots.start - first) * per_slot,
            count: slots.len() as u32 * per_slot,
            add: u32::from(add),
        };
        let page = page(&scene.first_bounce, piece.group)?;
        let buffers = [page.whole(), outgoing.specular_of(piece.group)?.whole()];
        let groups = push.count.div_ceil(WORKGROUP).min(FIRST_BOUNCE_GROUPS);
        let mut batch = device.batch()?;
        batch.dispatch(kernel, "all", &buffers, bytes_of(&push), [groups, 1, 1])?;
        batch.defer()?;
        Ok(true)
    }
}
