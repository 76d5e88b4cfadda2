//! What points see of lamps, by rays that a kernel traces for many of them at once: those of [`Sampling`](super::sampling::Sampling) from
//! points, and as many of them as accuracy needs.

use super::blockers::{Blockers, LEAF};
use super::lamps::Lamp;
use super::sampling::{OF_HALF, Share, Sums};
use super::surface::{Flat, Surface};
use crate::model::Facet;
use antirad_base::ranks::RankError;
use antirad_gpu::GpuError;
use glam::DVec3;
use std::fmt::Debug;
use std::ops::Range;
use std::sync::Arc;

/// Rays from a point to a lamp at most.
const MOST: f64 = 512.0;
/// Standard error up to which there are more, as a fraction of what the point would receive of the lamp, or of what is usual of all lamps if
/// that is more.
const TOLERANCE: f64 = 0.01;
/// Rays that tell whether anything stands between a point and a lamp: of a pixel, and of one of many points of a triangle.
pub const OF_PIXEL: u32 = 32;
pub const OF_SAMPLE: u32 = 16;

/// Why direct light could not be computed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DirectError {
    /// The device, or a call into it, failed.
    #[error(transparent)]
    Gpu(#[from] GpuError),
    /// Ranks can no longer work together.
    #[error(transparent)]
    Ranks(#[from] RankError),
}

/// What rays may meet, and where they end.
pub struct RayScene {
    /// A tree over what blocks light, in the order of a walk, each node before its branches: the two corners of the box of each.
    pub boxes: Vec<[DVec3; 2]>,
    /// Of each node, where the walk goes on behind its branches; of a leaf, its first blocker, and how many it has; of others 0.
    pub branches: Vec<[u32; 3]>,
    /// What blocks, in the order of the leaves.
    pub blockers: Vec<Flat>,
    /// Where rays end.
    pub lamps: Vec<Surface>,
    /// Height up to which a point counts as in a plane.
    pub tolerance: f64,
}

impl RayScene {
    pub(super) fn new(facets: &[Facet], blockers: &Blockers, lamps: &[Lamp]) -> Self {
        let (tree, triangles) = blockers.tree(facets);
        let branch = |node: &crate::model::Node| {
            let first = node.leaves.start * LEAF;
            let count = if node.is_leaf() { LEAF.min(triangles.len() - first) } else { 0 };
            [node.next, first, count].map(|number| number as u32)
        };
        Self {
            boxes: tree.nodes().iter().map(|node| [node.bounds.min, node.bounds.max]).collect(),
            branches: tree.nodes().iter().map(branch).collect(),
            blockers: triangles.iter().map(Flat::from).collect(),
            lamps: lamps.iter().map(|lamp| Surface::new(facets, lamp)).collect(),
            tolerance: blockers.tolerance(),
        }
    }
}

/// A point that looks at a lamp.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// In the engine's coordinates.
    pub point: DVec3,
    /// Unit normal of the surface there.
    pub normal: DVec3,
    /// Number of the lamp.
    pub lamp: usize,
}

/// What rays find of a lamp.
#[derive(Clone, Copy, Debug)]
pub struct Traced {
    /// Vector irradiance as if nothing stood in between, sr.
    pub unoccluded: DVec3,
    /// Weights of the rays.
    pub sums: Sums,
}

/// Traces rays among the triangles of a [`RayScene`].
pub trait Tracer: Debug + Send + Sync {
    /// What the rays of each look find, those with such numbers; `unoccluded` is zero unless number 0 is among them.
    ///
    /// # Errors
    /// Fails if the device does.
    fn trace(&self, looks: &[Look], rays: &[Range<u32>]) -> Result<Vec<Traced>, GpuError>;
}

/// What a point sees of a lamp.
#[derive(Clone, Copy, Debug)]
pub struct Lit {
    /// Vector irradiance, sr.
    pub phi: DVec3,
    /// Irradiance and its standard error, sr.
    pub irradiance: Share,
}

/// A tracer, and how many rays it is asked for.
#[derive(Clone, Debug)]
pub struct Tracing {
    tracer: Arc<dyn Tracer>,
    /// Radiance of each lamp, summed over channels.
    radiance: Vec<f64>,
    /// 2 for solids: half of the rays end on sides that cannot be seen.
    sides: Vec<u32>,
    /// Irradiance of all lamps that is usual in the scene, in the same unit, sr.
    usual: f64,
}

impl Tracing {
    pub fn new(tracer: Arc<dyn Tracer>, lamps: &[Lamp], radiance: &[DVec3], usual: &[f64]) -> Self {
        let radiance: Vec<f64> = radiance.iter().map(|rgb| rgb.element_sum()).collect();
        let usual = radiance.iter().zip(usual).map(|(l, usual)| l * usual).sum();
        let sides = lamps.iter().map(|lamp| 1 + u32::from(lamp.solid().is_some())).collect();
        Self { tracer, radiance, sides, usual }
    }

    /// What points see of lamps. Rays below the number `first` tell which of these are seen as a whole, or not at all; to others go more, as
    /// long as errors are larger than `coarser` times what is tolerated.
    ///
    /// # Errors
    /// Fails if the device does.
    pub fn light(&self, looks: &[Look], first: u32, coarser: f64) -> Result<Vec<Lit>, GpuError> {
        let mut rays: Vec<Range<u32>> = looks.iter().map(|look| 0..first * self.sides[look.lamp]).collect();
        let mut found = self.tracer.trace(looks, &rays)?;
        let more = |k: usize| (k, rays[k].end..self.needed(&looks[k], &found[k], coarser));
        let more = (0..looks.len()).map(more).filter(|(_, rays)| !rays.is_empty());
        let (unsure, again): (Vec<usize>, Vec<Range<u32>>) = more.unzip();
        let of_unsure: Vec<Look> = unsure.iter().map(|&k| looks[k]).collect();
        for ((k, again), more) in unsure.iter().zip(&again).zip(self.tracer.trace(&of_unsure, &again)?) {
            found[*k].sums += more.sums;
            rays[*k].end = again.end;
        }
        let lit = |((look, rays), Traced { unoccluded, sums }): ((&Look, &Range<u32>), Traced)| {
            let share = sums.share(rays.end / self.sides[look.lamp], 2.0).unwrap_or(Share::NOTHING);
            let all = unoccluded.dot(look.normal);
            let irradiance = Share { value: share.value * all, error: share.error * all };
            Lit { phi: share.value * unoccluded, irradiance }
        };
        Ok(looks.iter().zip(&rays).zip(found).map(lit).collect())
    }

    /// Rays that make the light of a lamp as accurate as is wanted, where some of it arrives and some does not.
    fn needed(&self, look: &Look, found: &Traced, coarser: f64) -> u32 {
        if !found.sums.is_in_part() {
            return 0;
        }
        let light = self.radiance[look.lamp] * found.unoccluded.dot(look.normal);
        let error = coarser * TOLERANCE * light.max(self.usual) / light.max(f64::MIN_POSITIVE);
        (OF_HALF / error).powf(4.0 / 3.0).min(MOST) as u32 * self.sides[look.lamp]
    }
}
