//! The intensities of volume clusters per bin. Twin of crates/core/glsl/volume_bins.comp and gather_bins.comp.

use super::clusters::Sources;
use super::completion::complete;
use super::pairs::{Facet, dot, times};
use super::real::Real;
use super::scene::{Context, SLOT, count};
use super::taps::{Layout, Taps, add};
use crate::backend::{Array, Cpu};
use crate::model::{Class, Clusters, VolumeParts, Volumes};
use crate::plan::Plan;
use antirad_base::parallel;
use antirad_base::ranks::RankError;
use antirad_base::usage::OverBudget;
use std::ops::Range;

/// Directions at a time.
const N: usize = 32;

/// The light of all volumes: net intensities per bin, below the horizon and above.
pub struct VolumeLight<T> {
    bins: [Array<T>; 2],
}

impl<T: Real> VolumeLight<T> {
    /// `None` where no volumes are planned.
    ///
    /// # Errors
    /// Fails if the memory budget of the CPU does not hold the bins.
    pub fn new(cpu: &Cpu, plan: &Plan) -> Result<Option<Self>, OverBudget> {
        let Some(volumes) = volumes_of(plan) else { return Ok(None) };
        let reals = volumes.parts().len() * count::<T>(plan.bin_bytes());
        Ok(Some(Self { bins: [cpu.array("volume bins", reals)?, cpu.array("volume bins", reals)?] }))
    }

    /// Sets the intensities of all volumes to zero.
    pub(crate) fn clear(&mut self) {
        self.bins.iter_mut().for_each(|bins| bins.fill(T::ZERO));
    }

    /// Adds what triangles of a page send, to the volumes of triangles that this rank computes; with `backs`, their backs, too.
    pub fn add(&mut self, context: &Context<T>, radiance: &[T], from: &Sources<T>, backs: bool) {
        let Context { plan, scene, layout, .. } = context;
        let Some(volumes) = volumes_of(plan).filter(|_| from.class.has_bins()) else { return };
        let shares = shares(plan, volumes);
        let Some(to) = shares.get(plan.options.rank as usize) else { return };
        let facets = &scene.facets;
        let slots = &from.indices;
        let sent = Sent {
            layout: *layout,
            class: Class { blocker: from.class.blocker && backs, ..from.class },
            first: slots.start,
            facets,
            radiance,
            antiradiance: from.antiradiance,
            specular: from.specular,
            bins: &scene.bin_table,
        };
        let first = volumes.run().range().start;
        let reals = context.bins();
        let add = |volume: usize, below: &mut [T], above: &mut [T]| {
            let VolumeParts::Triangles(at) = &volumes.parts()[volume] else { return };
            let all = &volumes.slots()[at.start as usize..at.end as usize];
            let before = |bound: u32| all.partition_point(|&slot| slot < bound);
            let all = &all[before(slots.start)..before(slots.end)];
            if !all.is_empty() {
                let area = Facet::read(facets, first + volume as u32).area;
                sent.add(all, T::ONE / area, below, above);
            }
        };
        let numbers = (to.start - first) as usize..(to.end - first) as usize;
        let part = numbers.start * reals..numbers.end * reals;
        let [below, above] = &mut self.bins;
        let [below, above] = [&mut below[part.clone()], &mut above[part]];
        let own = below.chunks_mut(reals).zip(above.chunks_mut(reals)).zip(numbers);
        parallel::each(own, |((below, above), volume)| add(volume, below, above));
    }

    /// Sums up volumes that consist of others, from those of triangles, of which each rank has a share.
    ///
    /// # Errors
    /// Fails if another rank has ended, or does not call it.
    pub fn sum(&mut self, context: &Context<T>) -> Result<(), RankError> {
        let Context { cpu, plan, scene, .. } = context;
        let Some(volumes) = volumes_of(plan) else { return Ok(()) };
        let (facets, reals) = (&scene.facets, context.bins());
        let first = volumes.run().range().start;
        for bins in &mut self.bins {
            complete(cpu.ranks(), bins, (first, reals), &shares(plan, volumes))?;
            for of in volumes.run().heights.iter().skip(1) {
                // Parts come before what they make up.
                let (before, own) = bins.split_at_mut((of.start - first) as usize * reals);
                let summed = |(own, index): (&mut [T], u32)| {
                    let VolumeParts::Volumes(both) = &volumes.parts()[(index - first) as usize] else {
                        return;
                    };
                    let area = Facet::read(facets, index).area;
                    let [a, b] = both.map(|part| Facet::read(facets, part).area / area);
                    let [one, other] = both.map(|part| &before[(part - first) as usize * reals..][..reals]);
                    for ((own, &one), &other) in own.iter_mut().zip(one).zip(other) {
                        *own = a * one + b * other;
                    }
                };
                parallel::each(own[..of.len() * reals].chunks_mut(reals).zip(of.clone()), summed);
            }
        }
        Ok(())
    }

    /// All volumes as sources.
    pub fn sources(&self, plan: &Plan) -> Option<Sources<'_, T>> {
        let run = volumes_of(plan)?.run();
        let [antiradiance, specular] = &self.bins;
        Some(Sources { class: run.class, indices: run.range(), antiradiance, specular })
    }
}

fn volumes_of(plan: &Plan) -> Option<&Volumes> {
    plan.clusters().and_then(Clusters::volumes)
}

/// The volumes of triangles that each rank computes, by its number: about as many triangles each.
fn shares(plan: &Plan, volumes: &Volumes) -> Vec<Range<u32>> {
    let of = volumes.run().heights.first().map_or(0..0, Range::clone);
    let ranks = u64::from(plan.options.ranks);
    let bound = |rank: u64| of.start + (of.len() as u64 * rank / ranks) as u32;
    (0..ranks).map(|rank| bound(rank)..bound(rank + 1)).collect()
}

/// What triangles of one class send, in memory; `first`: the slot with which their bins begin.
struct Sent<'a, T> {
    layout: Layout<T>,
    class: Class,
    first: u32,
    facets: &'a [T],
    radiance: &'a [T],
    antiradiance: &'a [T],
    specular: &'a [T],
    bins: &'a [T],
}

impl<T: Real> Sent<'_, T> {
    /// Adds what some of them send to the bins of their volume, times `factor`.
    fn add(&self, slots: &[u32], factor: T, below: &mut [T], above: &mut [T]) {
        let Layout { count, channels, .. } = self.layout;
        let mut taps = Taps::<T, N>::NONE;
        let (mut cosines, mut centres) = ([T::ZERO; N], [[T::ZERO; 3]; N]);
        for begin in (0..count).step_by(N) {
            let end = (begin + N).min(count);
            let mut sums = [[[T::ZERO; 4]; N]; 2];
            for k in 0..N {
                let at = (begin + k).min(count - 1) * SLOT;
                centres[k] = [self.bins[at], self.bins[at + 1], self.bins[at + 2]];
            }
            for &slot in slots {
                let facet = Facet::read(self.facets, slot);
                for k in 0..N {
                    cosines[k] = dot(facet.normal, centres[k]);
                }
                if self.class.has_bins() {
                    let sign = |k: usize| if cosines[k] > T::ZERO { T::ONE } else { -T::ONE };
                    taps.set(
                        &self.layout,
                        #[inline(always)]
                        |k| facet.in_frame(times(sign(k), centres[k])),
                    );
                }
                let radiance = &self.radiance[slot as usize * SLOT..][..3];
                let radiance = [radiance[0], radiance[1], radiance[2], T::ZERO];
                let [specular, antiradiance] =
                    [(self.class.glossy, self.specular), (self.class.blocker, self.antiradiance)].map(
                        |(has, bins)| {
                            has.then(|| {
                                &bins[(slot - self.first) as usize * count * channels..][..count * channels]
                            })
                        },
                    );
                for k in 0..end - begin {
                    let seen = cosines[k].magnitude() * facet.area;
                    let [up, down] = if cosines[k] > T::ZERO { [0, 1] } else { [1, 0] };
                    add(&mut sums[up][k], seen, radiance);
                    if let Some(specular) = specular {
                        add(&mut sums[up][k], seen, taps.gather(k, &self.layout, specular));
                    }
                    if let Some(antiradiance) = antiradiance {
                        add(&mut sums[down][k], -seen, taps.gather(k, &self.layout, antiradiance));
                    }
                }
            }
            for (k, bin) in (begin..end).enumerate() {
                for c in 0..channels {
                    above[bin * channels + c] += factor * sums[0][k][c];
                    below[bin * channels + c] += -factor * sums[1][k][c];
                }
            }
        }
    }
}
