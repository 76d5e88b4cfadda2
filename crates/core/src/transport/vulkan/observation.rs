//! S: the radiance of each triangle towards a camera.

use super::bundle::PassMonitor;
use super::reflection::Reflection;
use super::residency::Part;
use super::state::State;
use super::{Context, WORKGROUP, bin_constants, real};
use crate::plan::Plan;
use crate::shaders;
use crate::transport::TransportError;
use antirad_gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use glam::DVec3;

pub struct Observation {
    /// Kernels of diffuse triangles, and of glossy ones.
    kernels: [Pipeline; 2],
    /// vec4 of reals per slot.
    colours: Buffer,
}

impl Observation {
    pub fn new(device: &Device, plan: &Plan) -> Result<Self, GpuError> {
        let bytes = u64::from(plan.layout.slots()) * plan.rgb_bytes();
        Ok(Self {
            kernels: Self::kernels(device, plan)?,
            colours: Buffer::new(device, "face colours", bytes, BufferKind::Storage)?,
        })
    }

    /// Compiles the kernels of diffuse triangles, and of glossy ones.
    ///
    /// # Errors
    /// Fails if the device cannot compile one.
    pub fn kernels(device: &Device, plan: &Plan) -> Result<[Pipeline; 2], GpuError> {
        let precision = plan.settings.precision;
        let kernel = |glossy: u32| {
            let constants = [&[(0, WORKGROUP), (8, glossy)][..], &bin_constants(plan)].concat();
            let push = real::push_bytes(precision, 3, 2);
            Pipeline::new(device, shaders::OBSERVE.of(precision), 5, push, &constants)
        };
        Ok([kernel(0)?, kernel(1)?])
    }

    /// The buffer for colours in transfer, vec4 per slot.
    pub fn colours(&self) -> &Buffer {
        &self.colours
    }

    /// Radiance of every slot towards `camera_position` (metres), RGB, W/(m² sr). `x` is the incident light of the
    /// current outgoing light.
    ///
    /// # Errors
    /// Fails if the device does, if another rank has ended, or if the callback stops the pass.
    pub fn run(
        &self,
        context: &Context,
        reflection: &mut Reflection,
        x: &State,
        camera_position: DVec3,
        monitor: &mut PassMonitor,
    ) -> Result<Vec<[f64; 4]>, TransportError> {
        let Context { device, plan, scene, outgoing } = context;
        let camera_position = plan.placement.apply(camera_position).to_array();
        // Each rank those that it holds the light of.
        for piece in plan.own_pieces() {
            let light = Part::of_piece(plan, &piece).filter(|_| piece.part.class.glossy);
            let light = light.map(|part| x.read(device, &part)).transpose()?;
            let slots = plan.layout.slots_of(&piece.part.tiles);
            let buffers = [
                scene.facets.whole(),
                outgoing.radiance.whole(),
                scene.no_bins.whole(),
                reflection.specular_under(context, &piece, light.as_ref(), monitor)?,
                self.colours.whole(),
            ];
            let push = real::push(plan.settings.precision, &camera_position, &[slots.start, slots.end]);
            let kernel = &self.kernels[usize::from(piece.part.class.glossy)];
            let groups = [(slots.len() as u32).div_ceil(WORKGROUP), 1, 1];
            let mut batch = device.batch()?;
            batch.dispatch(kernel, "all", &buffers, &push, groups)?;
            batch.defer()?;
        }
        context.complete_slots(&self.colours, plan.rgb_bytes())?;
        Ok(context.slots(&self.colours)?)
    }
}
