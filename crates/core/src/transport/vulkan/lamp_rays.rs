//! Rays from points to lamps, which tell what the points see of them: direct light, of receivers and of what a camera sees.

use super::real;
use crate::direct::{Flat, Look, RayScene, Sums, Surface, Traced, Tracer};
use crate::plan::{LAMP_PAIRS, LAMP_STAGING};
use crate::shaders;
use crate::transport::pace::Pace;
use antirad_gpu::{Buffer, BufferKind, Device, GpuError, Pipeline};
use antirad_scene::Precision;
use glam::DVec3;
use std::fmt;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Lanes of a workgroup, and of those the ones that share a pair of a point and a lamp: as in crates/core/glsl/lamp_rays.comp.
const WORKGROUP: u32 = 64;
const RAYS: u32 = 16;
/// Rays of a pair per dispatch: lavapipe bounds the iterations of all loops of an invocation together by 65535, of which a ray of each lane
/// takes as many as the nodes that it visits.
const TAKE: u32 = 8 * RAYS;
/// Reals of a pair: what is known of it, and what is found.
const REALS: usize = 8;

/// Buffers in the order of bindings that change from one dispatch to the next: points, the rays that are wanted, what is found.
const POINTS: usize = 6;
const WANTED: usize = 7;
const FOUND: usize = 8;

/// Traces rays of as many pairs at a time as there is room for.
pub struct LampRays {
    device: Device,
    precision: Precision,
    kernel: Pipeline,
    tolerance: f64,
    nodes: u32,
    work: Mutex<Work>,
}

/// What one thread at a time uses.
struct Work {
    /// In the order of bindings.
    buffers: Vec<Buffer>,
    pace: Pace,
}

impl fmt::Debug for LampRays {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "rays among {} nodes on {:?}", self.nodes, self.device)
    }
}

impl LampRays {
    /// Uploads a scene to buffers of the bytes that a plan counts, [`lamp_rays_room`](crate::plan::lamp_rays_room), and staging buffers of
    /// their own.
    ///
    /// # Errors
    /// Fails if the device has no memory for it, or cannot compile the kernel.
    pub fn new(
        device: &Device,
        precision: Precision,
        room: [u64; 9],
        scene: &RayScene,
    ) -> Result<Self, GpuError> {
        let device = device.scope(LAMP_STAGING);
        let RayScene { boxes, branches, blockers, lamps, tolerance } = scene;
        let nodes: Vec<u32> =
            branches.iter().flat_map(|&[next, first, count]| [next, first, count, 0]).collect();
        let corners: Vec<f64> = boxes.iter().flat_map(|corners| widened(*corners, *tolerance)).collect();
        let triangles = |of: &mut dyn Iterator<Item = &Flat>| of.flat_map(flat).collect::<Vec<f64>>();
        let blockers = triangles(&mut blockers.iter());
        let mut begin = vec![0];
        begin.extend(lamps.iter().scan(0, |end, Surface { triangles, .. }| {
            *end += triangles.len() as u32;
            Some(*end)
        }));
        let emitters = triangles(&mut lamps.iter().flat_map(|lamp| &lamp.triangles));
        let ends: Vec<u32> = lamps.iter().flat_map(|lamp| lamp.ends.iter().copied()).collect();
        let buffers: Vec<Buffer> = room
            .iter()
            .map(|&bytes| Buffer::new(&device, LABEL, bytes, BufferKind::Storage))
            .collect::<Result<_, _>>()?;
        for (binding, reals) in [(0, corners), (2, blockers), (4, emitters)] {
            real::upload(&device, &buffers[binding], precision, &reals)?;
        }
        for (binding, words) in [(1, nodes), (3, begin), (5, ends)] {
            device.upload_slice(&buffers[binding], 0, &words)?;
        }
        Ok(Self {
            kernel: Self::kernel(&device, precision)?,
            tolerance: *tolerance,
            nodes: branches.len() as u32,
            work: Mutex::new(Work { buffers, pace: Pace::new(1e6) }),
            device,
            precision,
        })
    }

    /// Compiles the kernel.
    ///
    /// # Errors
    /// Fails if the device cannot.
    pub fn kernel(device: &Device, precision: Precision) -> Result<Pipeline, GpuError> {
        let push = real::push_bytes(precision, 1, 6);
        Pipeline::new(device, shaders::LAMP_RAYS.of(precision), 9, push, &[])
    }

    /// The rays of pairs that there is room for: those with such numbers, as far as each wants.
    fn dispatch(&self, work: &Work, count: u32, rays: Range<u32>) -> Result<(), GpuError> {
        let Work { buffers, pace } = work;
        let whole: Vec<_> = buffers.iter().map(Buffer::whole).collect();
        for first_ray in rays.clone().step_by(TAKE as usize) {
            let end_ray = rays.end.min(first_ray + TAKE);
            let each = u64::from(end_ray - first_ray);
            let mut begin = 0;
            while begin < count {
                let end = count.min(begin + pace.share(count - begin, each));
                let add = u32::from(first_ray > rays.start);
                let words = [begin, end, first_ray, end_ray, add, self.nodes];
                let push = real::push(self.precision, &[self.tolerance], &words);
                let groups = [(end - begin).div_ceil(WORKGROUP / RAYS), 1, 1];
                let mut batch = self.device.batch()?;
                batch.dispatch(&self.kernel, "rays", &whole, &push, groups)?;
                let seconds = batch.submit()?.wall_seconds;
                let rays = u64::from(end - begin) * each;
                pace.learn(pace.load(rays), seconds);
                self.device.credit(self.kernel.kernel(), "rays", rays, 0);
                begin = end;
            }
        }
        Ok(())
    }
}

impl Tracer for LampRays {
    fn trace(&self, looks: &[Look], rays: &[Range<u32>]) -> Result<Vec<Traced>, GpuError> {
        let work = self.work.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Vec::with_capacity(looks.len());
        for (looks, rays) in looks.chunks(LAMP_PAIRS as usize).zip(rays.chunks(LAMP_PAIRS as usize)) {
            let point = |look: &Look| {
                let ([x, y, z], [nx, ny, nz]) = (look.point.to_array(), look.normal.to_array());
                [x, y, z, 0.0, nx, ny, nz, 0.0]
            };
            let points: Vec<f64> = looks.iter().flat_map(point).collect();
            let of_look = |(look, rays): (&Look, &Range<u32>)| [look.lamp as u32, rays.start, rays.end, 0];
            let wanted: Vec<[u32; 4]> = looks.iter().zip(rays).map(of_look).collect();
            real::upload(&self.device, &work.buffers[POINTS], self.precision, &points)?;
            self.device.upload_slice(&work.buffers[WANTED], 0, &wanted)?;
            let first = rays.iter().map(|rays| rays.start).min().unwrap_or_default();
            let end = rays.iter().map(|rays| rays.end).max().unwrap_or_default();
            self.dispatch(&work, looks.len() as u32, first..end)?;
            let values =
                real::download(&self.device, &work.buffers[FOUND], self.precision, 0..points.len() as u64)?;
            let (found, _) = values.as_chunks::<REALS>();
            all.extend(found.iter().map(|&[x, y, z, all, arrive, ..]| Traced {
                unoccluded: DVec3::new(x, y, z),
                sums: Sums { all, arrive },
            }));
        }
        Ok(all)
    }
}

/// Label of all buffers.
const LABEL: &str = "lamp rays";

/// The corners of a box, wider by more than rounding moves them.
fn widened([low, high]: [DVec3; 2], by: f64) -> [f64; 8] {
    let (low, high) = (low - by, high + by);
    [low.x, low.y, low.z, 0.0, high.x, high.y, high.z, 0.0]
}

/// The corners of a triangle, with its normal in their fourth components.
fn flat(Flat { corners, normal }: &Flat) -> [f64; 12] {
    let [a, b, c] = corners;
    [a.x, a.y, a.z, normal.x, b.x, b.y, b.z, normal.y, c.x, c.y, c.z, normal.z]
}
