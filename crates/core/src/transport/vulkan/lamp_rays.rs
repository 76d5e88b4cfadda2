//! Rays from points to lamps, which tell what the points see of them: direct light, of receivers and of what a camera sees.

use super::real;
use super::scene_buffers::filled;
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

/// Traces rays of as many pairs at a time as there is room for.
pub struct LampRays {
    device: Device,
    precision: Precision,
    kernel: Pipeline,
    tolerance: f64,
    nodes: u32,
    boxes: Buffer,
    branches: Buffer,
    blockers: Buffer,
    lamps: Buffer,
    emitters: Buffer,
    ends: Buffer,
    pairs: Mutex<Pairs>,
}

/// What changes from one dispatch to the next.
struct Pairs {
    points: Buffer,
    wanted: Buffer,
    found: Buffer,
    pace: Pace,
}

impl fmt::Debug for LampRays {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        write!(f, "rays among {} nodes on {:?}", self.nodes, self.device)
    }
}

impl LampRays {
    /// Uploads a scene; its buffers, with staging buffers of their own, take no more than a plan counts.
    ///
    /// # Errors
    /// Fails if the device has no memory for it, or cannot compile the kernel.
    pub fn new(device: &Device, precision: Precision, scene: &RayScene) -> Result<Self, GpuError> {
        let device = device.scope(LAMP_STAGING);
        let RayScene { boxes, branches, blockers, lamps, tolerance } = scene;
        let reals = |values: &[f64]| real::filled(&device, LABEL, precision, values);
        let room = |of_each: u64| Buffer::new(&device, LABEL, LAMP_PAIRS * of_each, BufferKind::Storage);
        let nodes: Vec<[u32; 4]> =
            branches.iter().map(|&[next, first, count]| [next, first, count, 0]).collect();
        let corners: Vec<f64> = boxes.iter().flat_map(|corners| widened(*corners, *tolerance)).collect();
        let triangles = |of: &mut dyn Iterator<Item = &Flat>| of.flat_map(flat).collect::<Vec<f64>>();
        let of_lamps = || lamps.iter().flat_map(|lamp| &lamp.triangles);
        let mut begin = vec![0];
        begin.extend(lamps.iter().scan(0, |end, Surface { triangles, .. }| {
            *end += triangles.len() as u32;
            Some(*end)
        }));
        let ends: Vec<u32> = lamps.iter().flat_map(|lamp| lamp.ends.iter().copied()).collect();
        Ok(Self {
            kernel: Self::kernel(&device, precision)?,
            tolerance: *tolerance,
            nodes: nodes.len() as u32,
            boxes: reals(&corners)?,
            branches: filled(&device, LABEL, &nodes)?,
            blockers: reals(&triangles(&mut blockers.iter()))?,
            lamps: filled(&device, LABEL, &begin)?,
            emitters: reals(&triangles(&mut of_lamps()))?,
            ends: filled(&device, LABEL, &ends)?,
            pairs: Mutex::new(Pairs {
                points: room(REALS as u64 * precision.bytes())?,
                wanted: room(16)?,
                found: room(REALS as u64 * precision.bytes())?,
                pace: Pace::new(1e6),
            }),
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
    fn dispatch(&self, pairs: &Pairs, count: u32, rays: Range<u32>) -> Result<(), GpuError> {
        let Pairs { points, wanted, found, pace } = pairs;
        let buffers = [
            &self.boxes,
            &self.branches,
            &self.blockers,
            &self.lamps,
            &self.emitters,
            &self.ends,
            points,
            wanted,
            found,
        ];
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
                batch.dispatch(&self.kernel, "rays", &buffers.map(Buffer::whole), &push, groups)?;
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
        let pairs = self.pairs.lock().unwrap_or_else(PoisonError::into_inner);
        let mut all = Vec::with_capacity(looks.len());
        for (looks, rays) in looks.chunks(LAMP_PAIRS as usize).zip(rays.chunks(LAMP_PAIRS as usize)) {
            let point = |look: &Look| {
                let ([x, y, z], [nx, ny, nz]) = (look.point.to_array(), look.normal.to_array());
                [x, y, z, 0.0, nx, ny, nz, 0.0]
            };
            let points: Vec<f64> = looks.iter().flat_map(point).collect();
            let of_look = |(look, rays): (&Look, &Range<u32>)| [look.lamp as u32, rays.start, rays.end, 0];
            let wanted: Vec<[u32; 4]> = looks.iter().zip(rays).map(of_look).collect();
            real::upload(&self.device, &pairs.points, self.precision, &points)?;
            self.device.upload_slice(&pairs.wanted, 0, &wanted)?;
            let first = rays.iter().map(|rays| rays.start).min().unwrap_or_default();
            let end = rays.iter().map(|rays| rays.end).max().unwrap_or_default();
            self.dispatch(&pairs, looks.len() as u32, first..end)?;
            let values = real::download(&self.device, &pairs.found, self.precision, 0..points.len() as u64)?;
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
